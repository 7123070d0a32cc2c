/// @file
/// What laws without fuzzy systems have in common, and what those that remember nothing have.
#pragma once

#include "hexservo/laws/law.hpp"

#include <array>
#include <cstddef>

namespace hexservo {

/// Base of a law whose gains are evaluated as they are, with a memory that an evaluation replaces.
template <template <class, int> class G, template <class> class Memory>
struct LawWithoutFuzzy {
  template <class S, int N = kPoints>
  using Gains = G<S, N>;

  /// The same gains, prepared for evaluation.
  template <class S, int N = kPoints>
  struct Constants : Gains<S, N> {
    explicit Constants(const Gains<S, N>& gains) : Gains<S, N>(gains) {}
  };

  template <class S>
  using State = Memory<S>;
  /// What an evaluation leaves to the next one.
  template <class S>
  using Rate = Memory<S>;

  /// The wrench at one instant.
  template <class S>
  struct Evaluation {
    Rate<S> rate;
    Vector6<S> fuzzy_output = Vector6<S>::Zero();  ///< stays zero [N; N m]
    Vector6<S> wrench;                             ///< tau, in B [N; N m]
  };

  template <class S, int N>
  static State<S> initial_state(const G<S, N>& /*gains*/) {
    return {};
  }
};

/// Memory of a law that has none.
template <class S>
struct NoState {};

/// What stands for that memory inside a Runge-Kutta stage.
template <class S>
struct NoStage {
  explicit NoStage(const NoState<S>* /*state*/, const NoState<S>* /*rate*/ = nullptr, const S& /*scale*/ = S(0.0)) {}
};

/// Base of a law that remembers nothing.
template <template <class, int> class G>
struct StatelessLaw : LawWithoutFuzzy<G, NoState> {
  template <class S>
  using Stage = NoStage<S>;

  template <class Prepared, class S, std::size_t K>
  static void advance(const Prepared& /*constants*/, NoState<S>& /*state*/,
                      const std::array<const NoState<S>*, K>& /*rates*/, const std::array<S, K>& /*scales*/,
                      const Mask<S>& /*active*/) noexcept {}
};

}  // namespace hexservo
