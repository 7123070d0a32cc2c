/// @file
/// What laws with adaptive fuzzy systems have in common: all but gains and equation.
#pragma once

#include "hexservo/fuzzy.hpp"
#include "hexservo/laws/law.hpp"

namespace hexservo {

/// Base of a law whose state is the weights of its six fuzzy systems.
/// @tparam G gains with a member `fuzzy`
template <template <class, int> class G>
struct FuzzyLaw {
  template <class S, int N = kPoints>
  using Gains = G<S, N>;

  /// The same gains, prepared for evaluation.
  template <class S, int N = kPoints>
  struct Constants : Gains<S, N> {
    explicit Constants(const Gains<S, N>& gains) : Gains<S, N>(gains), systems(gains.fuzzy) {}

    FuzzySystems<S> systems;
  };

  template <class S>
  using State = FuzzyWeights<S>;  ///< W_j, omega of (13)
  template <class S>
  using Stage = FuzzyStage<S>;
  template <class S>
  using Rate = FuzzyRate<S>;

  /// Wrench and adaptation at one instant.
  template <class S>
  struct Evaluation {
    Rate<S> rate;             ///< omega-dot, of (22) or with another driver
    Vector6<S> fuzzy_output;  ///< tau_f of (13) [N; N m]
    Vector6<S> wrench;        ///< tau, in B [N; N m]
  };

  template <class S, int N>
  static State<S> initial_state(const G<S, N>& gains) {
    return initial_weights(gains.fuzzy);
  }

  template <class S, int N, std::size_t K>
  static void advance(const Constants<S, N>& constants, State<S>& state, const std::array<const Rate<S>*, K>& rates,
                      const std::array<S, K>& scales, const Mask<S>& active) noexcept {
    advance_systems(constants.systems, state, rates, scales, active);
  }
};

}  // namespace hexservo
