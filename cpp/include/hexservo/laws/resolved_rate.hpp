/// @file
/// Classical image-based visual servoing: a velocity from the pseudo-inverse of the image Jacobian, and an inner loop
/// that makes the platform follow it (docs/model.md, section 5).
#pragma once

#include "hexservo/elementary.hpp"
#include "hexservo/laws/law_without_fuzzy.hpp"
#include "hexservo/laws/pose_error.hpp"

namespace hexservo {

/// Where the image Jacobian of `resolved_rate` is taken.
enum class JacobianPoint {
  current,  ///< at the measured features and depths
  desired,  ///< at the desired features, with the assumed points' depths seen from the goal
  mean      ///< half the sum of the two
};

/// Gains of the law `resolved_rate`.
template <class S, int N = kPoints>
struct ResolvedRateGains {
  S gain{10.0};           ///< lambda; of the adaptive gain its value lambda_0 at the goal [1/s], 10
  bool adaptive = false;  ///< false: lambda is constant
  S gain_far{5.0};        ///< lambda_inf, adaptive gain far from the goal [1/s], 5; at most `gain`
  S gain_slope{1.0};      ///< s_0, how steeply the adaptive gain falls at the goal [1/(s px)], 1
  JacobianPoint jacobian_at = JacobianPoint::current;
  Vector6<S> ki{S(3.0),    S(3.0),    S(3.0),
                S(7.5e-3), S(7.5e-3), S(0.015)};  ///< diagonal of K_i [N s/m; N m s/rad], 3 x3, 7.5e-3 x2, 0.015
  Vector6<S> damping = Vector6<S>::Zero();        ///< diagonal of M [px^2/m^2; px^2/rad^2], 0: the plain pseudo-inverse

  /// The task has to hold the pose of the goal.
  bool needs_goal() const { return jacobian_at != JacobianPoint::current; }

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"gain", "1/s", kNotNegative}, self.gain...);
    v(Field{"adaptive"}.of_pack(), self.adaptive...);
    v(Field{"gain_far", "1/s", kNotNegative}, self.gain_far...);
    v(Field{"gain_slope", "1/(s px)", kNotNegative}, self.gain_slope...);
    v(Field{"jacobian_at"}.of_pack(), self.jacobian_at...);
    v(Field{"ki", "N s/m; N m s/rad", kNotNegative}, self.ki...);
    v(Field{"damping", "px^2/m^2; px^2/rad^2", kNotNegative}, self.damping...);
  }
};

/// Checks how gains go together.
/// @param key what the scenario's keys start with, "controller.resolved_rate."
/// @throws std::invalid_argument naming the scenario key
void validate(const ResolvedRateGains<double, kAnyPoints>& gains, const std::string& key);

/// lambda(x) = (lambda_0 - lambda_inf) exp(-s_0 x/(lambda_0 - lambda_inf)) + lambda_inf [1/s], or lambda.
/// @param x largest |xi-tilde_i| [px]
template <class S, int N>
S velocity_gain(const ResolvedRateGains<S, N>& gains, const S& x) {
  if (!gains.adaptive) return gains.gain;
  constexpr double kFlat = -700.0;  // exp rounds to nothing against 1 long before
  const S spread = gains.gain - gains.gain_far;
  const Mask<S> spreads = spread > S(0.0);
  const S exponent = -gains.gain_slope * x / select(spreads, spread, S(1.0));
  const S fall = spread * expm1_of_negative(S(clip(exponent, S(kFlat), S(0.0))));
  return gains.gain + select(spreads, fall, S(S(0.0) * x));  // NaN stays NaN
}

/// The law as a policy of the loop.
struct ResolvedRate : StatelessLaw<ResolvedRateGains> {
  static constexpr LawTraits traits = {.name = "resolved_rate",
                                       .type = "ResolvedRate",
                                       .parts = {LawPart::reference, LawPart::damping},
                                       .output = LawOutput::twist,
                                       .inverse = "damping",
                                       .viscosity = "ki",
                                       .points = true,
                                       .depth = true};

  /// What the wrench changes with the twist by: at v* it is G.
  template <class S, int N>
  static const Vector6<S>& viscosity(const ResolvedRateGains<S, N>& gains) {
    return gains.ki;
  }

  /// v* = lambda (J^T W J + M)^-1 J^T W xi-tilde, tau = K_i (v* - chi-dot) + G. NaN where J^T W J + M is not
  /// positive definite.
  template <class S, int N, class Listener = NoListener>
  static void evaluate(const ControlTask<S, N>& task, const Constants<S, N>& gains, const Stage<S>& /*stage*/,
                       const LawInput<S, N>& input, Evaluation<S>& out, const Listener& listener = {}) noexcept {
    const Vector<S, 2 * N> feature_error = task.desired_features - input.features;
    const Vector<S, 2 * N>&features = input.features, &desired = task.desired_features;
    const Vector<S, N>&depths = input.inverse_depth, &goal_depths = task.target.goal_inverse_depth;
    // That of the goal is turned into B by today's attitude, as that of now is.
    const bool at_goal = gains.jacobian_at == JacobianPoint::desired;
    const ImageJacobian<S, N> J(task.camera, task.jacobian_sign, at_goal ? desired : features,
                                at_goal ? goal_depths : depths, input.pose.position, input.R_BE);
    const Pairs<S, N> weighed(task.weights.times(feature_error));
    Matrix6<S> information;
    Vector6<S> pulled;
    if (gains.jacobian_at == JacobianPoint::mean) {
      const ImageJacobian<S, N> goal(task.camera, task.jacobian_sign, desired, goal_depths, input.pose.position,
                                     input.R_BE);
      information = J.normal_matrix(mean(J.rows(task.weights), goal.rows(task.weights)));
      pulled = S(0.5) * (J.pull(weighed) + goal.pull(weighed)).vector();
    } else {
      information = J.normal_matrix(task.weights);
      pulled = J.pull(weighed).vector();
    }
    for (int j = 0; j < 6; ++j) information(j, j) += gains.damping(j);
    const S lambda = velocity_gain(gains, task.weights.largest(feature_error));
    const Vector6<S> pose_error = solve_normal_equations<S>(information, pulled);
    const Vector6<S> velocity = lambda * pose_error;
    out.wrench = gains.ki.cwiseProduct(velocity - input.twist) + task.gravity_wrench;
    task.add_weight_moment(input.R_BE, out.wrench);
    listener.pose_error([&] { return pose_error; });
    listener.part(LawPart::reference, [&] { return Vector6<S>(gains.ki.cwiseProduct(velocity)); });
    listener.part(LawPart::damping, [&] { return Vector6<S>(-gains.ki.cwiseProduct(input.twist)); });
  }
};

}  // namespace hexservo
