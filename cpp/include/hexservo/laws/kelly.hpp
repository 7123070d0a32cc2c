/// @file
/// Transpose Jacobian control with viscous damping and gravity compensation, after Kelly et al. (docs/model.md,
/// section 5): the potential energy of an image spring, and nothing else but damping.
#pragma once

#include "hexservo/laws/law_without_fuzzy.hpp"

namespace hexservo {

/// Gains of the law `kelly`.
template <class S, int N = kPoints>
struct KellyGains {
  OfPoints<S, N, 2> kp = for_all_points<S, N, 2>(1e-6);  ///< diagonal of K_p [N m/px^2], 1e-6
  Vector6<S> kd{S(1.2),   S(1.2),   S(1.2),
                S(0.024), S(0.024), S(0.048)};  ///< diagonal of K_d [N s/m; N m s/rad], 1.2 x3, 0.024 x2, 0.048

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"kp", "N m/px^2", kNotNegative}, self.kp...);
    v(Field{"kd", "N s/m; N m s/rad", kNotNegative}, self.kd...);
  }
};

/// The law as a policy of the loop.
struct Kelly : StatelessLaw<KellyGains> {
  static constexpr LawTraits traits = {
      .name = "kelly", .type = "Kelly", .parts = {LawPart::damping, LawPart::image_spring}, .depth = true};

  /// tau = J^T K_p xi-tilde - K_d chi-dot + G.
  template <class S, int N, class Listener = NoListener>
  [[gnu::always_inline]] static void evaluate(const ControlTask<S, N>& task, const Constants<S, N>& gains,
                                              const Stage<S>& /*stage*/, const LawInput<S, N>& input,
                                              Evaluation<S>& out, const Listener& listener = {}) noexcept {
    const ImageJacobian<S, N> J(task.camera, task.jacobian_sign, input.features, input.inverse_depth,
                                input.pose.position, input.R_BE);
    const Vector<S, 2 * N> image_force = gains.kp.cwiseProduct(task.desired_features - input.features);
    const Vector6<S> image_wrench = J.pull(image_force).vector();
    out.wrench = image_wrench - gains.kd.cwiseProduct(input.twist) + task.gravity_wrench;
    task.add_weight_moment(input.R_BE, out.wrench);
    listener.part(LawPart::damping, [&] { return Vector6<S>(-gains.kd.cwiseProduct(input.twist)); });
    listener.part(LawPart::image_spring, [&] { return image_wrench; });
  }
};

}  // namespace hexservo
