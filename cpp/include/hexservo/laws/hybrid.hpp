/// @file
/// The paper's law: image-based controller (15), adaptive supervisory fuzzy systems (13), (22), and their sum (14).
///
/// | paper       | here                   |                                                                     |
/// | ----------- | ---------------------- | ------------------------------------------------------------------- |
/// | K_p, K_v    | kp, kv                 | diagonals, 8 and 6 (the paper prints 8 and 8: docs/errata.md, 2)     |
/// | xi-tilde    | feature_error          | xi_d - xi [px]                                                      |
/// | g           | image_wrench           | J-hat^T K_p xi-tilde [N; N m]                                       |
/// | g-dot       | image_wrench_rate      | -J-hat^T K_p J-hat chi-dot [N/s; N m/s]                             |
/// | tau_f       | fuzzy_output           | [N; N m]                                                            |
#pragma once

#include "hexservo/fuzzy.hpp"
#include "hexservo/laws/law.hpp"

namespace hexservo {

/// Gains of the law `hybrid`.
template <class S, int N = kPoints>
struct HybridGains {
  Vector<S, 2 * N> kp = Vector<S, 2 * N>::Constant(S(1e-6));  ///< diagonal of K_p [N m/px^2], 1e-6
  Vector6<S> kv = linear_angular<S>(2e-3, 1e-4);              ///< diagonal of K_v [N; N m], 2e-3 x3, 1e-4 x3
  FuzzyGains<S> fuzzy;

  template <class F, class A, class B>
  static void visit(F&& f, A& a, B& b) {
    f(a.kp, b.kp);
    f(a.kv, b.kv);
    f(a.fuzzy, b.fuzzy);
  }
};

/// The law as a policy of the loop: types of its gains and state, its evaluation, and how its state integrates.
struct Hybrid {
  static constexpr const char* name = "hybrid";

  template <class S>
  using Gains = HybridGains<S>;
  template <class S>
  using State = FuzzyWeights<S>;  ///< W_j, omega of (13)
  template <class S>
  using Stage = FuzzyStage<S>;
  template <class S>
  using Rate = FuzzyRate<S>;

  /// Wrench and adaptation at one instant.
  template <class S>
  struct Evaluation {
    Rate<S> rate;             ///< omega-dot of (22)
    Vector6<S> fuzzy_output;  ///< tau_f of (13) [N; N m]
    Vector6<S> wrench;        ///< tau of (14), in B [N; N m]
  };

  template <class S>
  static State<S> initial_state(const Gains<S>& gains) {
    return initial_weights(gains.fuzzy);
  }

  /// (14), (15) with (13) and (22): tau = g - K_v sgn(chi-dot) + G - tau_f.
  template <class S, int N>
  static Evaluation<S> evaluate(const ControlTask<S, N>& task, const Gains<S>& gains, const Stage<S>& weights,
                                const LawInput<S, N>& input) noexcept {
    const ImageJacobian<S, N> J(task.focal_pixels, task.jacobian_sign, input.image, input.R_BE);
    const Vector<S, 2 * N> feature_error = task.desired_features - input.image.features;
    const Vector6<S> image_wrench = J.pull(gains.kp.cwiseProduct(feature_error));

    const auto basis = [&] {
      const Vector6<S> image_wrench_rate = -J.pull(gains.kp.cwiseProduct(J.push(input.twist)));
      return fuzzy_basis<S>(gains.fuzzy, gains.fuzzy.error_scale.cwiseProduct(image_wrench),
                            gains.fuzzy.rate_scale.cwiseProduct(image_wrench_rate));
    };
    const bool fuzzy = gains.fuzzy.enabled;
    // Initialised in place: the basis is 84 numbers.
    Evaluation<S> out{{fuzzy ? basis() : zero_basis<S>(), input.twist.cwiseQuotient(gains.fuzzy.adaptation)},  // (22)
                      Vector6<S>::Zero(),
                      Vector6<S>::Zero()};
    if (fuzzy) out.fuzzy_output = weights.output(out.rate.basis);  // (13)
    if (gains.fuzzy.restrained) restrain(gains.fuzzy, weights.scale, input.twist, out.rate, out.fuzzy_output);
    out.wrench =
        image_wrench - gains.kv.cwiseProduct(task.switching(input.twist)) + task.gravity_wrench - out.fuzzy_output;
    return out;
  }

  template <class S, std::size_t K>
  static void advance(const Gains<S>& gains, State<S>& state, const std::array<const Rate<S>*, K>& rates,
                      const std::array<S, K>& scales, const Mask<S>& active) noexcept {
    advance_weights(state, rates, scales, active);
    if (gains.fuzzy.restrained) {
      S step{0.0};
      for (const S& scale : scales) step += scale;
      restrain(gains.fuzzy, step, state, active);
    }
  }
};

/// Checks gains as a user gives them.
/// @throws std::invalid_argument naming the scenario key
void validate(const HybridGains<double>& gains);

}  // namespace hexservo
