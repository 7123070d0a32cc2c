/// @file
/// From the wrench of a law to the coordinates that the legs of a machine that takes positions are commanded
/// (docs/model.md, section 7).
///
/// The controller keeps a virtual platform: with its mass it obeys the estimated dynamics (1) under the law's wrench,
///
///     D v-dot + (C + D_v) v = tau - G
///
/// in one Runge-Kutta step over the period, as the real one of a machine that takes forces; a law whose output is a
/// twist drives one without mass, which moves at that twist: where the law's wrench is G. The law sees pose and twist
/// of the virtual platform and the image from there: points are lifted with the real pose and the measured depths, and
/// projected again, so that the lag of the legs is not in the loop but for the errors of these depths. Where a law may
/// not act the virtual platform stops, and stays.
///
/// It moves as the legs can. Of the leg rates over the period, all are scaled to the speed limit, then their change to
/// the acceleration limit; those of legs near an end of their stroke are bounded so that they stop there.
#pragma once

#include "hexservo/safe_output.hpp"
#include "hexservo/world.hpp"

namespace hexservo {

/// A commanded motion starts, at rest, where the joints are known for the first time.
template <class S, int N>
void begin_motion(const SafetyGains<S, N>& gains, const Perceived<S, N>& seen, CommandedMotion<S>& motion) noexcept {
  const Mask<S> starts = seen.joints & (!motion.begun);
  if (any(starts)) {
    motion.pose = select_pose(starts, unit_pose(seen.pose), motion.pose);
    const LegsSideBySide<S> legs = inverse_kinematics(gains.legs, seen.pose.position, seen.R_BE);
    motion.legs = select(starts, legs.lengths.vector(), motion.legs);
    motion.begun = motion.begun | starts;
  }
}

/// What the virtual platform sees.
template <class S, int N>
[[gnu::noinline, gnu::cold]] void see_from_command(const SafetyGains<S, N>& gains, SafetyState<S, N>& state) noexcept {
  const Perceived<S, N>& seen = state.perception.now();
  CommandedMotion<S>& motion = state.motion;
  begin_motion(gains, seen, motion);
  Perceived<S, N>& carried = state.carried;
  carried = seen;
  carried.pose = motion.pose;
  carried.legs.reset();
  carried.R_BE = rotation_matrix(motion.pose.quaternion);
  carried.twist = motion.twist;
  Eigen::Matrix<S, 3, N> points_B;
  for (int i = 0; i < N; ++i)
    points_B.col(i) = lift<S>(gains.camera, seen.pose.position, seen.R_BE,
                              seen.image.features.template segment<2>(2 * i), seen.image.depth(i));
  carried.image = take_image<S, N>(gains.camera, carried.pose.position, carried.R_BE, points_B);
  for (int i = 0; i < N; ++i) carried.usable = carried.usable & (carried.image.depth(i) < S(0.0));
}

/// Leg rates that the legs can have over a period [m/s].
/// @param rates as wanted; @param before of the period before; @param legs where they are
template <class S, int N>
Vector6<S> feasible_rates(const SafetyGains<S, N>& gains, Vector6<S> rates, const Vector6<S>& before,
                          const Vector6<S>& legs) noexcept {
  using std::abs;
  using std::sqrt;
  const S period(gains.period), acceleration = min(gains.motion.acceleration_limit, S(1e300));
  const S fastest = largest_abs(rates);
  rates *= select(fastest > gains.motion.speed_limit, S(gains.motion.speed_limit / fastest), S(1.0));
  const Vector6<S> change = rates - before;
  const S most = acceleration * period, largest = largest_abs(change);
  rates = select(largest > most, Vector6<S>(before + S(most / largest) * change), rates);
  const auto bound = [&](const S& room) {  // the fastest that stops in time; back where a leg is beyond its stroke
    const S left = abs(room);
    const S rate = min(S(left / period), min(S(sqrt(S(S(2.0) * acceleration * left))), gains.motion.speed_limit));
    return select(room < S(-kStrokeTolerance) * gains.hexapod.stroke, S(-rate), select(room > S(0.0), rate, S(0.0)));
  };
  for (int i = 0; i < 6; ++i) {
    const S from_middle = legs(i) - gains.hexapod.mid_lengths(i);
    const S down = bound(S(gains.hexapod.stroke + from_middle)), up = bound(S(gains.hexapod.stroke - from_middle));
    rates(i) = clip(rates(i), S(-down), up);
  }
  return rates;
}

/// Commands of legs, none of which leaves its stroke, or goes further where it is commanded beyond [m]. They end short
/// of it by `kStrokeTolerance`, so that a leg that rests there is not beyond it by the rounding of its length.
/// @param held what each leg is commanded so far [m]
template <class S>
Vector6<S> within_stroke(const Hexapod<S>& hexapod, const Vector6<S>& held, Vector6<S> command) noexcept {
  const S travel = S(1.0 - kStrokeTolerance) * hexapod.stroke;
  for (int i = 0; i < 6; ++i) {
    const S low = hexapod.mid_lengths(i) - travel, high = hexapod.mid_lengths(i) + travel;
    command(i) = clip(command(i), min(low, held(i)), max(high, held(i)));
  }
  return command;
}

/// The estimated platform after a period under a law's wrench.
/// @param net the wrench without what carries the weight [N; N m]
template <class S>
BodyMotion<S> virtual_motion(const RigidBody<S>& body, const Vector6<S>& damping, double period, const Pose<S>& pose,
                             const Vector6<S>& twist, const Vector6<S>& net) noexcept {
  RigidBody<S> weightless = body;
  weightless.gravity.setZero();
  const Plant<S> plant(weightless, DynamicsError<S>{});
  const BodyMotion<S> start = BodyMotion<S>::of(body_state<S>(pose, twist));
  const auto rate_at = [&](const BodyMotion<S>& motion) {
    const Vector6<S> wrench = net - damping.cwiseProduct(twist_of(motion));
    return body_rate(plant, motion, rotation_matrix(quaternion_of(motion)), wrench);
  };
  BodyMotion<S> end = start;
  runge_kutta_step(
      period, rate_at(start),
      [&](double scale, const BodyMotion<S>& rate) {
        BodyMotion<S> stage;
        move_body(start, S(scale), rate, stage);
        return rate_at(stage);
      },
      [&](const std::array<const BodyMotion<S>*, 4>& rates) { end = body_after<S>(start, period, rates); });
  return end;
}

/// D a + C v + G of the estimate (1) [N; N m].
template <class S>
Vector6<S> wrench_of_motion(const RigidBody<S>& body, const Matrix3<S>& R_BE, const Vector6<S>& twist,
                            const Vector6<S>& acceleration) noexcept {
  const Matrix6<S> D = mass_matrix(body, R_BE), C = coriolis_matrix(body, R_BE, twist);
  Vector6<S> wrench = gravity_wrench(body, R_BE);
  for (int j = 0; j < 6; ++j)
    for (int i = 0; i < 6; ++i) wrench(i) += D(i, j) * acceleration(j) + C(i, j) * twist(j);
  return wrench;
}

/// Moves the virtual platform over a period, and commands the legs to where it then is.
/// @param wrench of the law [N; N m]; may be anything where the law may not act
/// @param out the wrench is what moves the virtual platform; `saturated` where the legs could not move as it would
template <class S, int N>
[[gnu::noinline, gnu::cold]] void command_motion(const SafetyGains<S, N>& gains, SafetyState<S, N>& state,
                                                 const Vector6<S>& wrench, Command<S>& out) noexcept {
  const Perceived<S, N>&seen = state.perception.now(), &from_command = state.carried;
  const MotionGains<S>& law = gains.motion;
  CommandedMotion<S>& motion = state.motion;
  const LegsSideBySide<S> seen_legs = inverse_kinematics(gains.legs, seen.pose.position, seen.R_BE);
  out.lengths = seen_legs.lengths;
  out.singular = WrenchMapSolver<S>(gains.legs, seen_legs).failed();

  const Matrix3<S>& R_BE = from_command.R_BE;
  const LegsSideBySide<S> found = inverse_kinematics(gains.legs, motion.pose.position, R_BE);
  const WrenchMapSolver<S> solver(gains.legs, found);
  const Legs<S> legs = Legs<S>::of(found);

  const Vector6<S> net = wrench - gravity_wrench(gains.body, R_BE);
  const Mask<S> may_act = from_command.ready() & (!out.singular) & motion.begun & (!solver.failed());
  const Mask<S> finite = is_finite(S(net.sum()));
  out.law_failed = may_act & (!finite);
  out.acts = may_act & finite;
  Vector6<S> wanted = motion.twist + net.cwiseQuotient(law.viscosity);
  Pose<S> pose;
  if (!law.massless) {
    const BodyMotion<S> moved = virtual_motion(gains.body, law.damping, gains.period, motion.pose, motion.twist, net);
    wanted = twist_of(moved);
    pose = {position_of(moved), quaternion_of(moved)};
  }
  wanted = select(out.acts, wanted, Vector6<S>(Vector6<S>::Zero()));

  const Vector6<S> rates = legs.rates(wanted), before = legs.rates(motion.twist);
  const Vector6<S> feasible = feasible_rates(gains, rates, before, legs.lengths);
  const Mask<S> limited = largest_abs(Vector6<S>(feasible - rates)) > S(0.0);
  Vector6<S> twist = select(limited, solver.twist(feasible), wanted);
  const Pose<S> as_legs_can = carried(motion.pose, twist, S(gains.period));
  const Mask<S> as_it_moves = out.acts & (!limited) & Mask<S>(!law.massless);
  pose = select_pose(as_it_moves, pose, as_legs_can);

  const Vector6<S> target =
      inverse_kinematics(gains.legs, pose.position, rotation_matrix(pose.quaternion)).lengths.vector();
  const Mask<S> reachable = motion.begun & is_finite(S(target.sum())) & is_finite(S(twist.sum()));
  twist = select(reachable, twist, Vector6<S>(Vector6<S>::Zero()));
  out.saturated = out.acts & (limited | (!reachable));
  out.wrench =
      wrench_of_motion(gains.body, R_BE, motion.twist, Vector6<S>((twist - motion.twist) * (S(1.0) / S(gains.period))));
  out.leg_forces = solver.leg_forces(out.wrench);
  motion.twist = twist;
  motion.legs = select(reachable, within_stroke(gains.hexapod, motion.legs, target), motion.legs);
  motion.pose = select_pose(reachable, pose, motion.pose);
}

}  // namespace hexservo
