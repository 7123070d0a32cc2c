/// @file
/// Transpose Jacobian control with viscous damping and gravity compensation, after Kelly et al. (docs/model.md,
/// section 5): the potential energy of an image spring, and nothing else but damping.
#pragma once

#include "hexservo/laws/stateless_law.hpp"

namespace hexservo {

/// Gains of the law `kelly`.
template <class S, int N = kPoints>
struct KellyGains {
  Vector<S, 2 * N> kp = Vector<S, 2 * N>::Constant(S(1e-6));  ///< diagonal of K_p [N m/px^2], 1e-6
  Vector6<S> kd{S(1.2),   S(1.2),   S(1.2),
                S(0.024), S(0.024), S(0.048)};  ///< diagonal of K_d [N s/m; N m s/rad], 1.2 x3, 0.024 x2, 0.048

  static constexpr const char* keys[] = {"kp", "kd"};  ///< of the scenario's block, as `visit` has them

  template <class F, class A, class B>
  static void visit(F&& f, A& a, B& b) {
    f(a.kp, b.kp);
    f(a.kd, b.kd);
  }
};

/// The law as a policy of the loop.
struct Kelly : StatelessLaw<KellyGains> {
  static constexpr const char* name = "kelly";

  /// tau = J^T K_p xi-tilde - K_d chi-dot + G.
  template <class S, int N>
  static void evaluate(const ControlTask<S, N>& task, const Constants<S>& gains, const Stage<S>& /*stage*/,
                       const LawInput<S, N>& input, Evaluation<S>& out) noexcept {
    const ImageJacobian<S, N> J(task.focal_pixels, task.jacobian_sign, input.features, input.inverse_depth, input.R_BE);
    const Vector<S, 2 * N> feature_error = task.desired_features - input.features;
    out.wrench =
        J.pull(gains.kp.cwiseProduct(feature_error)) - gains.kd.cwiseProduct(input.twist) + task.gravity_wrench;
  }
};

/// Checks gains as a user gives them.
/// @throws std::invalid_argument naming the scenario key
void validate(const KellyGains<double>& gains);

}  // namespace hexservo
