/// @file
/// Targets that move, and targets that do not ride on the base: where the points are in B at any time
/// (docs/model.md, section 7).
///
///     P_B(t) = R_WB^T (P + d(t) - p_WB)   of a target in the world: P and d in W
///     P_B(t) = P + d(t)                   of one on the base
///
///     velocity  d = v t
///     sinusoid  d = amplitude sin(2 pi frequency t + phase)
///     recorded  cubic spline through the samples at 0, dt, 2 dt, ...; the last one stays
#pragma once

#include "hexservo/base_motion.hpp"

namespace hexservo {

/// What the target is fixed to, or moves in.
enum class TargetFrame {
  base,  ///< B
  world  ///< W, with which B agrees where it is displaced and turned by nothing
};

/// How the target moves in its frame.
enum class TargetMotionKind { none, velocity, sinusoid, recorded };

/// Motion of the target but for what is recorded.
template <class S>
struct TargetMotionParameters {
  TargetMotionKind kind = TargetMotionKind::none;  ///< which of the following act
  Vector3<S> velocity = Vector3<S>::Zero();        ///< [m/s], 0
  Vector3<S> amplitude = Vector3<S>::Zero();       ///< of the sinusoid [m], 0
  S frequency{1.0};                                ///< of the sinusoid [Hz], 1
  S phase{0.0};                                    ///< of the sinusoid at t = 0 [rad], 0

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"kind"}.of_pack().of_plant().in_sampled_mode(), self.kind...);
    v(Field{"velocity", "m/s"}.entrywise().of_plant().in_sampled_mode(), self.velocity...);
    v(Field{"amplitude", "m"}.entrywise().of_plant().in_sampled_mode(), self.amplitude...);
    v(Field{"frequency", "Hz", kNotNegative}.of_plant().in_sampled_mode(), self.frequency...);
    v(Field{"phase", "rad", kAngle}.of_plant().in_sampled_mode(), self.phase...);
  }
};

/// Place of the target's points in B at any time.
template <class S, int N>
class TargetPlace {
 public:
  /// @param points where they are without motion, 3xN in B or W [m]
  /// @param recorded of the target's motion; not kept
  TargetPlace(const Eigen::Matrix<S, 3, N>& points, TargetFrame frame, const TargetMotionParameters<S>& motion,
              const Recording& recorded)
      : points_(points), in_world_(frame == TargetFrame::world), p_(motion) {
    if (motion.kind == TargetMotionKind::recorded)
      recorded_ = {std::vector<double>(recorded.samples, recorded.samples + 3 * recorded.count), recorded.period};
  }

  /// Whether the points move in B.
  bool moves(const BaseMotion<S>& base) const noexcept {
    return p_.kind != TargetMotionKind::none || (in_world_ && base.moves());
  }

  /// d at t >= 0 [s], in the target's frame [m].
  Vector3<S> displacement(double time) const noexcept {
    constexpr double kTurnsPerRadian = 0.15915494309189535;
    switch (p_.kind) {
      case TargetMotionKind::velocity:
        return S(time) * p_.velocity;
      case TargetMotionKind::sinusoid:
        return p_.amplitude * sine_of_turns(S(p_.frequency * S(time) + p_.phase * S(kTurnsPerRadian)));
      case TargetMotionKind::recorded:
        return of_all_lanes<S>(recorded_.at(time)).value;
      case TargetMotionKind::none:
        break;
    }
    return Vector3<S>::Zero();
  }

  /// The points in B at t >= 0 [s], 3xN [m].
  /// @param base whose place was prepared where the target is in W
  Eigen::Matrix<S, 3, N> points(double time, const BaseMotion<S>& base) const noexcept {
    Eigen::Matrix<S, 3, N> points_B = points_.colwise() + displacement(time);
    if (!in_world_) return points_B;
    const Matrix3<S> R_WB = base.turning(time).R_WB;
    const Vector3<S> p_WB = base.place(time);
    for (int i = 0; i < N; ++i) points_B.col(i) = rotate_back<S>(R_WB, Vector3<S>(points_B.col(i) - p_WB));
    return points_B;
  }

 private:
  Eigen::Matrix<S, 3, N> points_;
  bool in_world_;
  TargetMotionParameters<S> p_;
  UniformSpline<3> recorded_;
};

}  // namespace hexservo
