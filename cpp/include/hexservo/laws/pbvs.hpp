/// @file
/// Position-based visual servoing: a pose from the features and assumed points, then a Cartesian law
/// (docs/model.md, section 5).
#pragma once

#include "hexservo/laws/pose_error.hpp"
#include "hexservo/laws/stateless_law.hpp"

namespace hexservo {

/// Gains of the law `pbvs`.
template <class S, int N = kPoints>
struct PbvsGains {
  Vector6<S> kp{S(24.0), S(24.0), S(24.0),
                S(0.06), S(0.06), S(0.12)};  ///< diagonal of K_p [N/m; N m/rad], 24 x3, 0.06 x2, 0.12
  Vector6<S> kd{S(2.4),  S(2.4),  S(2.4),
                S(6e-3), S(6e-3), S(1.2e-2)};  ///< diagonal of K_d [N s/m; N m s/rad], 2.4 x3, 6e-3 x2, 1.2e-2

  /// Diagonal of M under noise [px^2/m^2; px^2/rad^2], 1e5 x3, 16000 x3
  Vector6<S> prior = linear_angular<S>(1e5, 16000.0);

  /// The task has to hold the pose of the goal.
  static constexpr bool needs_goal() { return true; }

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"kp", "N/m; N m/rad", kNotNegative}, self.kp...);
    v(Field{"kd", "N s/m; N m s/rad", kNotNegative}, self.kd...);
    v(Field{"prior", "px^2/m^2; px^2/rad^2", kNotNegative}, self.prior...);
  }
};

/// The law as a policy of the loop.
struct Pbvs : StatelessLaw<PbvsGains> {
  static constexpr LawTraits traits = {
      .name = "pbvs", .type = "Pbvs", .parts = {LawPart::damping, LawPart::pose_spring}, .points = true, .prior = true};

  /// What the wrench changes with the twist by: at K_d^-1 K_p (chi_goal - chi-hat) it is G.
  template <class S, int N>
  static const Vector6<S>& viscosity(const PbvsGains<S, N>& gains) {
    return gains.kd;
  }

  /// tau = K_p (chi_goal - chi-hat) - K_d chi-dot + G, with chi-hat from the features by `estimate_pose`, started at
  /// the pose of the joint sensors and, with M > 0, weighed against it as far as the image is noisy. NaN where there is
  /// no estimate.
  template <class S, int N, class Listener = NoListener>
  static void evaluate(const ControlTask<S, N>& task, const Constants<S, N>& gains, const Stage<S>& /*stage*/,
                       const LawInput<S, N>& input, Evaluation<S>& out, const Listener& listener = {}) noexcept {
    const PoseEstimate<S> estimate =
        estimate_pose<S, N>(task.camera, task.target.points_T, input.features, input.pose, gains.prior, task.weights);
    const Vector6<S> error =
        select(estimate.failed, unknown_six<S>(), pose_difference(task.target.goal, estimate.pose));
    out.wrench = gains.kp.cwiseProduct(error) - gains.kd.cwiseProduct(input.twist) + task.gravity_wrench;
    task.add_weight_moment(input.R_BE, out.wrench);
    listener.pose_error([&] { return error; });
    listener.part(LawPart::damping, [&] { return Vector6<S>(-gains.kd.cwiseProduct(input.twist)); });
    listener.part(LawPart::pose_spring, [&] { return Vector6<S>(gains.kp.cwiseProduct(error)); });
  }
};

}  // namespace hexservo
