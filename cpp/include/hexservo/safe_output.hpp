/// @file
/// What a controller commands where its law may not act: it brakes, and holds the platform where it stopped
/// (docs/model.md, section 7).
///
///     tau = G - K_s chi-dot - K_h (chi (-) chi_stop)
///
/// K_s and K_h are diagonal as given, and multiples of D-bar where they are derived: with its diagonal alone the brake
/// of a platform whose centre of mass is far off E's origin is unstable. chi_stop is the first measured pose of
/// the stretch; the second one, where the third shows that the first was wrong by itself. Where pose or twist are not
/// known either, tau = G, with the leg forces of the last pose that was.
#pragma once

#include "hexservo/commanded_motion.hpp"
#include "hexservo/perception.hpp"

namespace hexservo {

/// Gains of the brake: K_s = diag(damping) + damping_rate D-bar, K_h = diag(hold) + hold_rate D-bar, D-bar the
/// estimated inertia at the pose. Zeros leave G alone.
template <class S>
struct SafeGains {
  Vector6<S> damping = Vector6<S>::Zero();  ///< [N s/m; N m s/rad]
  Vector6<S> hold = Vector6<S>::Zero();     ///< [N/m; N m/rad]
  S damping_rate{0.0};                      ///< [1/s]
  S hold_rate{0.0};                         ///< [1/s^2]

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"damping", "N s/m; N m s/rad"}, self.damping...);
    v(Field{"hold", "N/m; N m/rad"}, self.hold...);
    v(Field{"damping_rate", "1/s"}, self.damping_rate...);
    v(Field{"hold_rate", "1/s^2"}, self.hold_rate...);
  }
};

/// What it takes to decide on a command, besides a law.
template <class S, int N = kPoints>
struct SafetyGains : Sensing<S, N> {
  RigidBody<S> body;  ///< as estimated
  SafeGains<S> safe;
  S saturation_limit;     ///< leg force beyond which integral action waits [N]; infinite where nothing limits it
  MotionGains<S> motion;  ///< of a machine that takes positions (motion_command.hpp)
};

/// What that takes from tick to tick.
template <class S, int N = kPoints>
struct SafetyState {
  explicit SafetyState(const SafetyGains<S, N>& gains,
                       std::pmr::memory_resource* memory = std::pmr::get_default_resource())
      : perception(gains, memory), last_pose(home_pose(gains.hexapod)), stop_pose(last_pose), later_pose(last_pose) {
    motion.acts = gains.motion.acts;
    motion.pose = last_pose;
  }

  Perception<S, N> perception;
  Pose<S> last_pose;   ///< the last one that was known and not singular; home before the first
  Pose<S> stop_pose;   ///< chi_stop
  Pose<S> later_pose;  ///< the second measured pose of a stretch without the law
  S braked{0.0};       ///< measured poses of that stretch; 0 where the law acts
  CommandedMotion<S> motion;
  Perceived<S, N> carried{};  ///< what a virtual platform sees, where there is one; computed at each tick

  /// Calls `f` with each member, always in the same order.
  template <class F>
  void for_each_member(F&& f) {
    perception.for_each_member(f);
    f.finite(last_pose.position);
    f.finite(last_pose.quaternion);
    f.finite(stop_pose.position);
    f.finite(stop_pose.quaternion);
    f.finite(later_pose.position);
    f.finite(later_pose.quaternion);
    f.finite(braked);
    motion.for_each_member(f);
  }
};

/// What goes to the actuators at a tick.
template <class S>
struct Command {
  Vector6<S> wrench;      ///< tau, about E's origin, in B [N; N m]
  Vector6<S> leg_forces;  ///< f_c with H f_c = tau, H at the pose of the joint sensors [N]
  LegVector<S> lengths;   ///< l_i at that pose [m]
  Mask<S> acts;           ///< the wrench is the law's; otherwise it is the safe one
  Mask<S> law_failed;     ///< the law's wrench or its leg forces are not finite although all it was given is
  Mask<S> singular;       ///< the pose of the joint sensors is singular
  Mask<S> saturated;      ///< a leg force is beyond `SafetyGains::saturation_limit`
};

/// How many times as far as from the second pose without the law to the third one it may be from the first to the
/// second: from tick to tick a platform that brakes goes less far, but not as much less.
inline constexpr double kStopJump = 3.0;
inline constexpr double kLeastStopJump = 1e-9;  ///< [m; rad]: what is less is rounding

/// The safe wrench where the law's does not act.
/// @param wrench of the law [N; N m]
/// @param solver at the pose of the joint sensors
template <class S, int N>
[[gnu::noinline, gnu::cold]] void stop_safely(const SafetyGains<S, N>& gains, SafetyState<S, N>& state,
                                              const Vector6<S>& wrench, const WrenchMapSolver<S>& solver,
                                              Command<S>& out) noexcept {
  const Perceived<S, N>& seen = state.perception.now();
  const Mask<S> known = seen.joints & (!out.singular);
  // A pose that stays as it is between two readings is measured once.
  const Pose<S> measured = select_pose(state.braked < S(1.5), state.stop_pose, state.later_pose);
  const Mask<S> differs = (seen.pose.position - measured.position).squaredNorm() +
                              (seen.pose.quaternion - measured.quaternion).squaredNorm() >
                          S(0.0);
  const Mask<S> begins = !(state.braked > S(0.5));
  const Mask<S> counts = known & (!out.acts) & (begins | seen.read | differs);
  state.braked = select(out.acts, S(0.0), select(counts, S(state.braked + S(1.0)), state.braked));
  const auto is_tick = [&](double count) { return counts & (state.braked == S(count)); };
  state.stop_pose = select_pose(is_tick(1.0), seen.pose, state.stop_pose);
  state.later_pose = select_pose(is_tick(2.0), seen.pose, state.later_pose);
  if (const Mask<S> third = is_tick(3.0); any(third)) {
    const Vector6<S> first = pose_difference(state.stop_pose, state.later_pose);
    const Vector6<S> next = pose_difference(state.later_pose, seen.pose);
    const auto is_wrong = [&](const auto& way, const auto& next_way) {
      return third & (way.squaredNorm() > S(kLeastStopJump * kLeastStopJump)) &
             (way.squaredNorm() > S(kStopJump * kStopJump) * next_way.squaredNorm());
    };
    state.stop_pose.position = select(is_wrong(first.template head<3>(), next.template head<3>()),
                                      state.later_pose.position, state.stop_pose.position);
    state.stop_pose.quaternion = select(is_wrong(first.template tail<3>(), next.template tail<3>()),
                                        state.later_pose.quaternion, state.stop_pose.quaternion);
  }
  const Vector6<S> weight = gravity_wrench(gains.body, seen.R_BE);
  const Vector6<S> away = pose_difference(state.stop_pose, seen.pose);
  const Vector6<S> wanted = gains.safe.hold_rate * away - gains.safe.damping_rate * seen.twist;  // chi-ddot
  const Vector6<S> brake = weight + gains.safe.hold.cwiseProduct(away) - gains.safe.damping.cwiseProduct(seen.twist) +
                           inertial_wrench(gains.body, seen.R_BE, wanted);
  const Vector6<S> brake_forces = solver.leg_forces(brake);
  const Mask<S> brakes = known & (!out.acts) & is_finite(S(brake_forces.sum()));

  // Before this tick's pose replaces it.
  const Matrix3<S> last_R_BE = rotation_matrix(state.last_pose.quaternion);
  const WrenchMapSolver<S> last(gains.legs, inverse_kinematics(gains.legs, state.last_pose.position, last_R_BE));
  const Vector6<S> rest = gravity_wrench(gains.body, last_R_BE);
  const Vector6<S> rest_forces = last.leg_forces(rest);
  out.wrench = select(out.acts, wrench, select(brakes, brake, rest));
  out.leg_forces = select(out.acts, out.leg_forces, select(brakes, brake_forces, rest_forces));
  const Mask<S> here = out.acts | brakes;
  state.last_pose = select_pose(here, seen.pose, state.last_pose);
}

/// The law's wrench where it may act, and the safe one elsewhere, with legs and solver at the pose of the joint
/// sensors.
template <class S, int N>
void decide_at(const SafetyGains<S, N>& gains, SafetyState<S, N>& state, const Vector6<S>& wrench,
               const LegsSideBySide<S>& legs, const WrenchMapSolver<S>& solver, Command<S>& out) noexcept {
  const Perceived<S, N>& seen = state.perception.now();
  out.lengths = legs.lengths;
  out.singular = solver.failed();
  out.wrench = wrench;
  out.leg_forces = solver.leg_forces(wrench);
  const Mask<S> may_act = seen.ready() & (!out.singular);
  // Forces that are finite come of a wrench that is.
  const Mask<S> finite = is_finite(S(out.leg_forces.sum()));
  out.law_failed = may_act & (!finite);
  out.acts = may_act & finite;
  if (all(out.acts)) {
    state.last_pose = seen.pose;
    state.braked = S(0.0);
  } else {
    stop_safely(gains, state, wrench, solver, out);
  }
  out.saturated = largest_abs(out.leg_forces) > gains.saturation_limit;
}

/// The law's wrench where it may act, and the safe one elsewhere.
/// @param wrench of the law [N; N m]; may be anything where the law may not act
template <class S, int N>
void decide(const SafetyGains<S, N>& gains, SafetyState<S, N>& state, const Vector6<S>& wrench,
            Command<S>& out) noexcept {
  const Perceived<S, N>& seen = state.perception.now();
  if (seen.legs) {
    decide_at(gains, state, wrench, seen.legs->legs, seen.legs->solver, out);
  } else {
    const LegsSideBySide<S> legs = inverse_kinematics(gains.legs, seen.pose.position, seen.R_BE);
    decide_at(gains, state, wrench, legs, WrenchMapSolver<S>(gains.legs, legs), out);
  }
}

}  // namespace hexservo
