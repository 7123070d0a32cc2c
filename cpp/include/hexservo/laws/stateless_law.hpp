/// @file
/// What laws without a state have in common: nothing integrates, and there are no fuzzy systems.
#pragma once

#include "hexservo/laws/law.hpp"

#include <array>
#include <cstddef>

namespace hexservo {

/// State of a law that has none, and its rate.
template <class S>
struct NoState {};

/// What stands for that state inside a Runge-Kutta stage.
template <class S>
struct NoStage {
  explicit NoStage(const NoState<S>* /*state*/, const NoState<S>* /*rate*/ = nullptr, const S& /*scale*/ = S(0.0)) {}
};

/// Base of a law that remembers nothing.
template <template <class, int> class G>
struct StatelessLaw {
  template <class S, int N = kPoints>
  using Gains = G<S, N>;

  /// The same gains, prepared for evaluation.
  template <class S, int N = kPoints>
  struct Constants : Gains<S, N> {
    explicit Constants(const Gains<S, N>& gains) : Gains<S, N>(gains) {}
  };

  template <class S>
  using State = NoState<S>;
  template <class S>
  using Stage = NoStage<S>;
  template <class S>
  using Rate = NoState<S>;

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

  template <class S, int N, std::size_t K>
  static void advance(const Constants<S, N>& /*constants*/, State<S>& /*state*/,
                      const std::array<const Rate<S>*, K>& /*rates*/, const std::array<S, K>& /*scales*/,
                      const Mask<S>& /*active*/) noexcept {}
};

}  // namespace hexservo
