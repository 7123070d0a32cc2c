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

#include "hexservo/laws/fuzzy_law.hpp"

namespace hexservo {

/// Gains of the law `hybrid`.
template <class S, int N = kPoints>
struct HybridGains {
  OfPoints<S, N, 2> kp = for_all_points<S, N, 2>(1e-6);  ///< diagonal of K_p [N m/px^2], 1e-6
  Vector6<S> kv = linear_angular<S>(2e-3, 1e-4);         ///< diagonal of K_v [N; N m], 2e-3 x3, 1e-4 x3
  FuzzyGains<S> fuzzy;

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"kp", "N m/px^2", kPositive}, self.kp...);
    v(Field{"kv", "N; N m", kNotNegative}, self.kv...);
    v(Field{"fuzzy"}, self.fuzzy...);
  }
};

/// The law as a policy of the loop.
struct Hybrid : FuzzyLaw<HybridGains> {
  static constexpr LawTraits traits = {.name = "hybrid",
                                       .type = "Hybrid",
                                       .parts = {LawPart::switching, LawPart::fuzzy, LawPart::image_spring},
                                       .depth = true,
                                       .theorem = true};

  /// (14), (15) with (13) and (22): tau = g - K_v sgn(chi-dot) + G - tau_f.
  /// @param out what the law gives; filled in place, since the basis is 84 numbers
  template <class S, int N, class Listener = NoListener>
  static void evaluate(const ControlTask<S, N>& task, const Constants<S, N>& constants, const Stage<S>& weights,
                       const LawInput<S, N>& input, Evaluation<S>& out, const Listener& listener = {}) noexcept {
    const ImageJacobian<S, N> J(task.camera, task.jacobian_sign, input.features, input.inverse_depth,
                                input.pose.position, input.R_BE);
    const Pairs<S, N> kp(constants.kp);
    const Pairs<S, N> feature_error = Pairs<S, N>(task.desired_features) - Pairs<S, N>(input.features);
    const AxisVector<S> image_wrench = J.pull(kp * feature_error);
    AxisVector<S> fuzzy_output;
    if (constants.systems.enabled) {
      const FuzzySystems<S>& systems = constants.systems;
      // The goal stands still: the error's rate is minus the image's.
      const AxisVector<S> image_wrench_rate = S(-1.0) * J.pull(kp * J.push_pairs(input.twist));
      respond(systems, weights, systems.error_scale * image_wrench, systems.rate_scale * image_wrench_rate,
              AxisVector<S>(input.twist), out.rate, fuzzy_output);  // (13), (22)
    } else {
      fuzzy_output = AxisVector<S>::Zero();
    }
    const AxisVector<S> others = image_wrench - fuzzy_output;
    const AxisVector<S> switched = task.switching_wrench(AxisVector<S>(constants.kv), input, others);
    ((AxisVector<S>(task.gravity_wrench) - switched) + others).store(out.wrench.data());
    task.add_weight_moment(input.R_BE, out.wrench);
    fuzzy_output.store(out.fuzzy_output.data());
    listener.part(LawPart::switching, [&] { return Vector6<S>(-switched.vector()); });
    listener.part(LawPart::fuzzy, [&] { return Vector6<S>(-out.fuzzy_output); });
    listener.part(LawPart::image_spring, [&] { return image_wrench.vector(); });
  }
};

}  // namespace hexservo
