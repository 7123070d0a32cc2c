/// @file
/// Computed torque: the estimated dynamics turned around, with an acceleration that regulates the pose error
/// (docs/model.md, section 5).
#pragma once

#include "hexservo/laws/law_without_fuzzy.hpp"
#include "hexservo/laws/pose_error.hpp"

namespace hexservo {

/// Gains of the law `computed_torque`.
template <class S, int N = kPoints>
struct ComputedTorqueGains {
  Vector6<S> kp = Vector6<S>::Constant(S(400.0));     ///< diagonal of K_p [1/s^2], 400
  Vector6<S> kd = Vector6<S>::Constant(S(40.0));      ///< diagonal of K_d [1/s], 40
  Vector6<S> prior = linear_angular<S>(1e4, 1600.0);  ///< diagonal of M [px^2/m^2; px^2/rad^2], 1e4 x3, 1600 x3

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"kp", "1/s^2", kNotNegative}, self.kp...);
    v(Field{"kd", "1/s", kNotNegative}, self.kd...);
    v(Field{"prior", "px^2/m^2; px^2/rad^2", kNotNegative}, self.prior...);
  }
};

/// The law as a policy of the loop.
struct ComputedTorque : StatelessLaw<ComputedTorqueGains> {
  static constexpr LawTraits traits = {.name = "computed_torque",
                                       .type = "ComputedTorque",
                                       .parts = {LawPart::damping, LawPart::pose_spring, LawPart::coriolis_feedforward},
                                       .inverse = "prior",
                                       .depth = true,
                                       .prior = true};

  /// tau = D (K_p e - K_d chi-dot) + C chi-dot + G with the estimates of (1), and e as in `composite`.
  template <class S, int N, class Listener = NoListener>
  static void evaluate(const ControlTask<S, N>& task, const Constants<S, N>& gains, const Stage<S>& /*stage*/,
                       const LawInput<S, N>& input, Evaluation<S>& out, const Listener& listener = {}) noexcept {
    const ImageJacobian<S, N> J(task.camera, task.jacobian_sign, input.features, input.inverse_depth,
                                input.pose.position, input.R_BE);
    const Vector<S, 2 * N> feature_error = task.desired_features - input.features;
    const Vector6<S> pose_error = most_probable_pose_error(J, feature_error, gains.prior,
                                                           pose_difference(task.reference, input.pose), task.weights);
    const Vector6<S> wanted = gains.kp.cwiseProduct(pose_error) - gains.kd.cwiseProduct(input.twist);  // chi-ddot
    if (task.body.off_centre) return off_centre<S, N>(task, gains, input, pose_error, wanted, out, listener);
    out.wrench = task.gravity_wrench;
    const Matrix3<S> inertia_B = inertia_in_base(task.body, input.R_BE);
    const Vector3<S> omega = input.twist.template tail<3>();
    out.wrench.template head<3>() += task.body.mass * wanted.template head<3>();
    out.wrench.template tail<3>() += rotate<S>(inertia_B, wanted.template tail<3>()) +
                                     omega.cross(rotate<S>(inertia_B, omega));  // [omega]x I' omega
    const auto inertial = [&](const Vector6<S>& acceleration) {
      Vector6<S> wrench;
      wrench << task.body.mass * acceleration.template head<3>(), rotate<S>(inertia_B, acceleration.template tail<3>());
      return wrench;
    };
    listener.pose_error([&] { return pose_error; });
    listener.part(LawPart::damping, [&] { return inertial(-gains.kd.cwiseProduct(input.twist)); });
    listener.part(LawPart::pose_spring, [&] { return inertial(gains.kp.cwiseProduct(pose_error)); });
    listener.part(LawPart::coriolis_feedforward, [&] {
      Vector6<S> wrench = Vector6<S>::Zero();
      wrench.template tail<3>() = omega.cross(rotate<S>(inertia_B, omega));
      return wrench;
    });
  }

 private:
  /// The same where all entries of D and C act.
  template <class S, int N, class Listener>
  static void off_centre(const ControlTask<S, N>& task, const Constants<S, N>& gains, const LawInput<S, N>& input,
                         const Vector6<S>& pose_error, const Vector6<S>& wanted, Evaluation<S>& out,
                         const Listener& listener) noexcept {
    const auto inertial = [&](const Vector6<S>& acceleration) {
      return inertial_wrench(task.body, input.R_BE, acceleration);
    };
    const Matrix6<S> C = coriolis_matrix(task.body, input.R_BE, input.twist);
    Vector6<S> coriolis = Vector6<S>::Zero();
    for (int j = 0; j < 6; ++j)
      for (int i = 0; i < 6; ++i) coriolis(i) += C(i, j) * input.twist(j);
    out.wrench = task.gravity_wrench + inertial(wanted) + coriolis;
    task.add_weight_moment(input.R_BE, out.wrench);
    listener.pose_error([&] { return pose_error; });
    listener.part(LawPart::damping, [&] { return inertial(-gains.kd.cwiseProduct(input.twist)); });
    listener.part(LawPart::pose_spring, [&] { return inertial(gains.kp.cwiseProduct(pose_error)); });
    listener.part(LawPart::coriolis_feedforward, [&] { return coriolis; });
  }
};

}  // namespace hexservo
