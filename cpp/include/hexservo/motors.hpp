/// @file
/// Legs whose drives are motors that hold a position by their torque, and the platform that hangs on them, in `sampled`
/// mode (docs/model.md, section 7).
///
///     m = clip(kp (q* - q) - kv q-dot, -limit, limit)                      what a motor gives
///     D chi-ddot + C chi-dot + G = J^T (m - d q-dot + f - I_a q-ddot)      what moves the platform
///
/// f_i is dry friction: F against the motion of a leg, and within +-F whatever keeps a leg at rest that rests. J maps
/// the platform's twist to leg rates, so that I_a adds J^T I_a J to D. q* is the command of `actuators.delay` ticks
/// before, as a multiple of the drive's resolution.
///
/// The legs move in `kMotorSteps` steps for every Runge-Kutta step of the loop, each by the midpoint rule, where the
/// dry friction of a step is what brings the rates at its end to rest, or its largest: of second order while legs slide
/// or rest, and of first where one comes to rest within a step.
#pragma once

#include "hexservo/position_actuators.hpp"

namespace hexservo {

inline constexpr int kMotorSteps = 8;       ///< steps of the legs in a Runge-Kutta step of the loop
inline constexpr int kFrictionSweeps = 20;  ///< of projected Gauss-Seidel, from the friction of the step before

/// The platform without its legs at an instant, in B.
template <class S>
struct BodyDynamics {
  Matrix6<S> mass;    ///< D
  Vector6<S> wrench;  ///< what acts on it beside the legs, less C chi-dot + G [N; N m]
};

/// Six motors with the platform that they move.
template <class S>
class MotorLegs {
 public:
  /// @param step of the loop's Runge-Kutta method [s]
  /// @param positions where a run starts [m], or [rad]
  MotorLegs(const ActuatorParameters<S>& p, const Hexapod<S>& hexapod, double step, const Vector6<S>& positions)
      : motor_(p.motor),
        limit_(hexapod.force_limit),
        geometry_(hexapod),
        step_(step / kMotorSteps),
        bias_counts_(any(p.motor.armature > S(0.0)) || any(p.motor.friction > S(0.0))),
        commands_(p.delay, positions),
        wanted_(positions) {}

  /// A tick: takes over where the legs shall go.
  void command(const Vector6<S>& positions) noexcept {
    Vector6<S> possible;
    for (int i = 0; i < 6; ++i) possible(i) = quantise(positions(i), motor_.quantisation);
    wanted_ = commands_.pass(possible);
  }

  /// m, what the motors give [N], or [N m].
  Vector6<S> torques(const Vector6<S>& positions, const Vector6<S>& rates) const noexcept {
    Vector6<S> out;
    for (int i = 0; i < 6; ++i)
      out(i) = clip(S(motor_.kp * (wanted_(i) - positions(i)) - motor_.kv * rates(i)), S(-limit_), limit_);
    return out;
  }

  /// chi-ddot of a platform just after a command, (m/s^2; rad/s^2) in B.
  Vector6<S> acceleration(const BodyMotion<S>& body, const BodyDynamics<S>& dynamics) const noexcept {
    Vector6<S> friction = friction_;
    return accelerated(body, dynamics, twist_of(body), S(0.5 * step_), S(1.0), friction);
  }

  /// A Runge-Kutta step of the loop.
  /// @param dynamics from a time since the step's begin [s] and a motion of the platform: `BodyDynamics`
  template <class F>
  void advance(BodyMotion<S>& body, F&& dynamics) noexcept {
    const S h(step_), half(0.5 * step_);
    for (int step = 0; step < kMotorSteps; ++step) {
      const double start = step * step_;
      const Vector6<S> twist = twist_of(body);
      Vector6<S> friction = friction_;  // of half a step; that of the whole is kept
      const Vector6<S> first = accelerated(body, dynamics(start, body), twist, half, S(1.0), friction);
      const Vector6<S> between = twist + half * first;
      const BodyMotion<S> middle = displaced(body, quaternion_of(body), half, twist, between);
      const Vector6<S> second = accelerated(middle, dynamics(start + 0.5 * step_, middle), twist, h, S(0.5), friction_);
      const Vector6<S> end = twist + h * second, mean = S(0.5) * (twist + end);
      body = displaced(body, quaternion_of(middle), h, mean, end);
    }
  }

 private:
  /// A platform that has moved for so long at a twist, and moves at another one.
  /// @param attitude where the quaternion's rate is taken
  static BodyMotion<S> displaced(const BodyMotion<S>& body, const Vector4<S>& attitude, const S& time,
                                 const Vector6<S>& twist, const Vector6<S>& reached) noexcept {
    const Vector4<S> turned = quaternion_rate<S>(attitude, Vector3<S>(twist.template tail<3>()));
    BodyMotion<S> moved = BodyMotion<S>::of(body_state<S>(
        {position_of(body) + time * twist.template head<3>(), Vector4<S>(quaternion_of(body) + time * turned)},
        reached));
    normalise_quaternion(moved);
    return moved;
  }

  /// chi-ddot over a step.
  /// @param body where the forces are taken; @param before twist at the step's begin; @param time of the step
  /// @param bias share of J-dot chi-dot over the step that J at `body` does not have yet
  /// @param friction f, from that of another step
  Vector6<S> accelerated(const BodyMotion<S>& body, const BodyDynamics<S>& dynamics, const Vector6<S>& before,
                         const S& time, const S& bias, Vector6<S>& friction) const noexcept {
    const Vector3<S> p_BE = position_of(body);
    const Vector6<S> twist = twist_of(body);
    const Legs<S> legs =
        Legs<S>::of(inverse_kinematics(geometry_, p_BE, Matrix3<S>(rotation_matrix(quaternion_of(body)))));
    const Matrix6<S> H = legs.wrench_map();  // J^T
    const Vector6<S> rates = legs.rates(twist), motors = torques(legs.lengths, rates);
    Vector6<S> turning = Vector6<S>::Zero();  // J-dot chi-dot
    if (bias_counts_) turning = leg_bias(geometry_, legs, p_BE, twist);

    Matrix6<S> mass = dynamics.mass;
    Vector6<S> wrench = dynamics.wrench;
    for (int leg = 0; leg < 6; ++leg) {
      const S effort = motors(leg) - motor_.damping * rates(leg) - motor_.armature * turning(leg);
      for (int j = 0; j < 6; ++j) {
        wrench(j) += H(j, leg) * effort;
        for (int i = j; i < 6; ++i) mass(i, j) += motor_.armature * H(i, leg) * H(j, leg);
      }
    }
    const Cholesky<S, 6> inverse(mass);
    Vector6<S> acceleration = inverse.solve(wrench);
    if (!any(motor_.friction > S(0.0))) return acceleration;

    Matrix6<S> pushed;  // chi-ddot from a unit effort of each leg
    for (int leg = 0; leg < 6; ++leg) pushed.col(leg) = inverse.solve(Vector6<S>(H.col(leg)));
    Vector6<S> end = legs.rates(Vector6<S>(before + time * acceleration)) + (time * bias) * turning;
    Matrix6<S> reached;  // q-dot at the end from a unit effort of each leg
    for (int leg = 0; leg < 6; ++leg) {
      reached.col(leg) = time * legs.rates(Vector6<S>(pushed.col(leg)));
      end += friction(leg) * Vector6<S>(reached.col(leg));
    }
    for (int sweep = 0; sweep < kFrictionSweeps; ++sweep)
      for (int leg = 0; leg < 6; ++leg) {
        const S held = clip(S(friction(leg) - end(leg) / reached(leg, leg)), S(-motor_.friction), motor_.friction);
        const S more = held - friction(leg);
        friction(leg) = held;
        for (int i = 0; i < 6; ++i) end(i) += more * reached(i, leg);
      }
    for (int leg = 0; leg < 6; ++leg) acceleration += friction(leg) * Vector6<S>(pushed.col(leg));
    return acceleration;
  }

  MotorParameters<S> motor_;
  S limit_;
  LegGeometry<S> geometry_;
  double step_;       ///< of a leg [s]
  bool bias_counts_;  ///< whether anything depends on J-dot chi-dot
  DelayLine<S> commands_;
  Vector6<S> wanted_;                         ///< q*
  Vector6<S> friction_ = Vector6<S>::Zero();  ///< f of the last step
};

}  // namespace hexservo
