/// @file
/// What every control law sees and gives, and the switching functions (docs/model.md, sections 5 and 6).
#pragma once

#include "hexservo/camera.hpp"
#include "hexservo/rigid_body.hpp"

namespace hexservo {

/// Stand-ins for sgn in the friction-like term -K_v sgn(chi-dot) of (15).
enum class SwitchingKind {
  sign,       ///< as printed, sgn(0) = 0
  tanh,       ///< tanh(x/width)
  saturation  ///< x/width limited to [-1, 1], a boundary layer
};

/// Switching term of a law.
template <class S>
struct Switching {
  SwitchingKind kind = SwitchingKind::sign;
  S width{1e-3};  ///< of `tanh` and `saturation` [m/s; rad/s], 1e-3

  /// sgn of the paper, or what replaces it, for each component of a twist.
  Vector6<S> operator()(const Vector6<S>& twist) const {
    using std::tanh;
    Vector6<S> out;
    for (int j = 0; j < 6; ++j) {
      switch (kind) {
        case SwitchingKind::sign:
          out(j) = sign(twist(j));
          break;
        case SwitchingKind::tanh:
          out(j) = tanh(S(twist(j) / width));
          break;
        case SwitchingKind::saturation:
          out(j) = clip(S(twist(j) / width), S(-1.0), S(1.0));
          break;
      }
    }
    return out;
  }

  template <class F, class A, class B>
  static void visit(F&& f, A& a, B& b) {
    f(a.kind, b.kind);
    f(a.width, b.width);
  }
};

/// What a law knows of robot, camera and goal: estimates, never the plant's own values.
template <class S, int N = kPoints>
struct ControlTask {
  S focal_pixels;                     ///< f [px]
  S jacobian_sign;                    ///< sign of the controller's image Jacobian relative to (8)
  Vector<S, 2 * N> desired_features;  ///< xi_d [px]
  Vector6<S> gravity_wrench;          ///< G of (1) [N; N m], in B
  Switching<S> switching;
  Pose<S> reference;  ///< chi_ref, the pose that the prior of `composite` expects: home
};

/// What the sensors give a law.
template <class S, int N = kPoints>
struct LawInput {
  Image<S, N> image;  ///< measured features [px] and depth Z-hat [m]
  Matrix3<S> R_BE;    ///< attitude from the joint sensors
  Vector6<S> twist;   ///< chi-dot from the joint sensors, in B [m/s; rad/s]
  Pose<S> pose;       ///< from the joint sensors; its attitude is R_BE
};

}  // namespace hexservo
