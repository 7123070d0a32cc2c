/// @file
/// The law of this project: regulates the most probable pose error and adapts on it (docs/model.md, section 5).
///
/// The adaptation of the paper's law is driven by velocity alone: it stops wherever the platform sticks. Here it is
/// driven by the pose error as well, so that the fuzzy systems integrate until the error is gone. Image and joint
/// sensors both measure that error; in poorly observable directions of the image the joint sensors' pose decides.
///
/// | symbol      | here           |                                                                              |
/// | ----------- | -------------- | ---------------------------------------------------------------------------- |
/// | xi-tilde    | feature_error  | xi_d - xi [px]                                                               |
/// | e           | pose_error     | most probable displacement to the goal, in B [m; rad]                        |
/// | chi_ref     | task.reference | pose that the prior expects: home                                            |
/// | M           | prior          | diagonal, (sigma of a feature/sigma of a pose component)^2 [px^2/m^2; px^2/rad^2] |
/// | Lambda      | drive          | how fast the pose error drives the adaptation [1/s]                          |
/// | tau_f       | fuzzy_output   | [N; N m]                                                                     |
#pragma once

#include "hexservo/laws/fuzzy_law.hpp"
#include "hexservo/laws/pose_error.hpp"

namespace hexservo {

/// Design of the fuzzy systems of `composite`: their inputs are a pose error and its rate, so the scales differ.
template <class S>
FuzzyGains<S> composite_fuzzy_gains() {
  FuzzyGains<S> gains;
  gains.adaptation = linear_angular<S>(0.01, 3.0);
  gains.error_scale = linear_angular<S>(20.0, 10.0);
  gains.rate_scale.setConstant(S(1.0));
  return gains;
}

/// Units of the inputs of its fuzzy systems.
inline constexpr std::array<UnitOf, 2> kPoseErrorUnits{{{"error_scale", "1/m; 1/rad"}, {"rate_scale", "s/m; s/rad"}}};

/// Gains of the law `composite`.
template <class S, int N = kPoints>
struct CompositeGains {
  OfPoints<S, N, 2> kp = for_all_points<S, N, 2>(1e-9);  ///< diagonal of K_p [N m/px^2], 1e-9
  Vector6<S> kv = linear_angular<S>(2e-3, 1e-4);         ///< diagonal of K_v [N; N m], 2e-3 x3, 1e-4 x3
  Vector6<S> kt{S(6.0),   S(6.0),   S(6.0),
                S(0.015), S(0.015), S(0.03)};  ///< diagonal of K_t [N/m; N m/rad], 6 x3, 0.015 x2, 0.03
  Vector6<S> kd{S(1.2),  S(1.2),  S(1.2),
                S(3e-3), S(3e-3), S(6e-3)};           ///< diagonal of K_d [N s/m; N m s/rad], 1.2 x3, 3e-3 x2, 6e-3
  Vector6<S> drive = Vector6<S>::Constant(S(4.0));    ///< diagonal of Lambda [1/s], 4
  Vector6<S> prior = linear_angular<S>(1e4, 1600.0);  ///< diagonal of M [px^2/m^2; px^2/rad^2], 1e4 x3, 1600 x3
  FuzzyGains<S> fuzzy = composite_fuzzy_gains<S>();   ///< a [1/m; 1/rad], b [s/m; s/rad]: 20 x3, 10 x3; 1

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"kp", "N m/px^2", kNotNegative}, self.kp...);
    v(Field{"kv", "N; N m", kNotNegative}, self.kv...);
    v(Field{"kt", "N/m; N m/rad", kNotNegative}, self.kt...);
    v(Field{"kd", "N s/m; N m s/rad", kNotNegative}, self.kd...);
    v(Field{"drive", "1/s", kNotNegative}, self.drive...);
    v(Field{"prior", "px^2/m^2; px^2/rad^2", kNotNegative}, self.prior...);
    v(Field{"fuzzy"}.with_units(kPoseErrorUnits), self.fuzzy...);
  }
};

/// The law as a policy of the loop.
struct Composite : FuzzyLaw<CompositeGains> {
  static constexpr LawTraits traits = {
      .name = "composite",
      .type = "Composite",
      .parts = {LawPart::switching, LawPart::damping, LawPart::pose_spring, LawPart::fuzzy, LawPart::image_spring},
      .inverse = "prior",
      .depth = true,
      .prior = true};

  /// tau = J^T K_p xi-tilde + K_t e - K_d chi-dot - K_v sw(chi-dot) + G - tau_f.
  /// @param out what the law gives; filled in place, since the basis is 84 numbers
  template <class S, int N, class Listener = NoListener>
  static void evaluate(const ControlTask<S, N>& task, const Constants<S, N>& constants, const Stage<S>& weights,
                       const LawInput<S, N>& input, Evaluation<S>& out, const Listener& listener = {}) noexcept {
    const ImageJacobian<S, N> J(task.camera, task.jacobian_sign, input.features, input.inverse_depth,
                                input.pose.position, input.R_BE);
    const Vector<S, 2 * N> feature_error = task.desired_features - input.features;
    const Vector6<S> pose_error = most_probable_pose_error(J, feature_error, constants.prior,
                                                           pose_difference(task.reference, input.pose), task.weights);
    if (constants.systems.enabled) {
      const FuzzySystems<S>& systems = constants.systems;
      const Vector6<S> driver = input.twist - constants.drive.cwiseProduct(pose_error);
      // The goal stands still: the pose error's rate is minus the twist.
      AxisVector<S> fuzzy_output;
      respond(systems, weights, systems.error_scale * AxisVector<S>(pose_error),
              systems.rate_scale * AxisVector<S>(Vector6<S>(-input.twist)), AxisVector<S>(driver), out.rate,
              fuzzy_output);
      fuzzy_output.store(out.fuzzy_output.data());
    } else {
      out.fuzzy_output.setZero();
    }
    const Vector<S, 2 * N> image_force = constants.kp.cwiseProduct(feature_error);
    const Vector6<S> image_wrench = J.pull(image_force).vector();
    const Vector6<S> others = image_wrench + constants.kt.cwiseProduct(pose_error) -
                              constants.kd.cwiseProduct(input.twist) - out.fuzzy_output;
    const Vector6<S> switched = task.switching_wrench(constants.kv, input, others).vector();
    out.wrench = others - switched + task.gravity_wrench;
    task.add_weight_moment(input.R_BE, out.wrench);
    listener.pose_error([&] { return pose_error; });
    listener.part(LawPart::switching, [&] { return Vector6<S>(-switched); });
    listener.part(LawPart::damping, [&] { return Vector6<S>(-constants.kd.cwiseProduct(input.twist)); });
    listener.part(LawPart::pose_spring, [&] { return Vector6<S>(constants.kt.cwiseProduct(pose_error)); });
    listener.part(LawPart::fuzzy, [&] { return Vector6<S>(-out.fuzzy_output); });
    listener.part(LawPart::image_spring, [&] { return image_wrench; });
  }
};

}  // namespace hexservo
