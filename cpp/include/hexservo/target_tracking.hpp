/// @file
/// The law `tracking`: from frames and the pose of each one's exposure to where the legs shall go (docs/model.md,
/// section 5).
///
/// What is followed is estimated in B: of `Follow::pose` the pose g of the platform from which the target looks as
/// desired, g = chi(t_e) o chi-hat^-1 o chi_goal, with the pose chi(t_e) that the joints had at the exposure and the
/// pose chi-hat that the image gives against the assumed points of the target; of `Follow::direction` the place of the
/// middle of the features. A Kalman filter with a constant velocity and the variance sigma_a^2 of the acceleration
/// between two frames smooths it, axis by axis; nothing is smoothed in the image, which the camera's own motion moves.
///
///     x' = x + dt v,  P' = A P A^T + sigma_a^2 [dt^4/4, dt^3/2; dt^3/2, dt^2],  K = (p_xx, p_xv)/(p_xx + R)
///
/// R is the variance of the features at the goal, and what the pose of the exposure may be off where the latency is not
/// known. A velocity counts as far as it exceeds its own standard deviation; where none does, the target rests, and the
/// mean of all frames since stands for it. What lies beyond `jump` standard deviations restarts it.
///
/// The reference moves to the target as predicted for now and the delay of the legs, with a critically damped double
/// pole at exp(-2 pi bandwidth T_c), within the limits of the legs. The command leads it by the legs' own response
/// turned around,
///
///     q* = q_r + (2 zeta/w - T_c/2) q-dot_r + q-ddot_r/w^2 + b + o
///
/// (T_c/2: the command is held). What that response lacks, such as friction, load and the coupling of the legs, is made
/// up for by b, `feedback` times how far the measured legs are behind the reference of this instant (with a lag where
/// one pole of the response is much slower than the other), and by o where they come to rest elsewhere.
#pragma once

#include "hexservo/latency_estimator.hpp"
#include "hexservo/laws/tracking.hpp"
#include "hexservo/loop_parameters.hpp"
#include "hexservo/motion_command.hpp"

namespace hexservo {

inline constexpr double kLongestPrediction = 1.0;  ///< of a target that is not seen any more [s]
inline constexpr double kRestingFrames = 200.0;    ///< frames in the mean of a target at rest
inline constexpr double kOffTheMean = 4.0;         ///< standard deviations at which that mean starts again [1]
inline constexpr int kPointingRounds = 6;          ///< of the camera's place in a direction
/// Share of the legs' acceleration limit that the reference brakes with: a command that is held asks more of them [1].
inline constexpr double kBraking = 0.6;
inline constexpr double kSettled = 4.0;  ///< lags after which the legs are at rest [1]
/// Share of the lead of legs at their speed limit that a command is ahead of the measured legs at most [1].
inline constexpr double kReach = 0.61;
/// Share of what the slow pole of legs is slower than the fast one, by which their feedback lags: where one motion of
/// the platform is slow, others are faster than the response that each leg has in the mean.
inline constexpr double kEase = 0.5;

/// What tracking needs, prepared.
template <class S, int N = kPoints>
struct TrackingPlan {
  Follow follow = Follow::pose;
  bool stamped = true;
  TrackingGains<S, N> gains;
  S approach{0.0}, braking{0.0};                         ///< (1 - p)^2/T_c [1/s] and 1 - p^2 of the double pole p
  S lead{0.0}, lead_change{0.0};                         ///< of the command [s], [s^2]
  S reach = S(std::numeric_limits<double>::infinity());  ///< of a command from the measured legs, with feedback
  S ease{1.0};                                           ///< share of its way that the feedback moves in a tick [1]
  S settling{0.0};                           ///< time after which the legs are where they were commanded [s]
  double jitter = 0.0;                       ///< most that a latency no frame carries is longer for a frame [s]
  double delay = 0.0;                        ///< of the legs [ticks]
  Vector6<S> variance = Vector6<S>::Zero();  ///< R of a pose [m^2; rad^2]; of a direction, of depth 1 m
  Pose<S> home;
  Vector3<S> home_centre = Vector3<S>::Zero();  ///< of the camera at home, in B [m]
  Vector3<S> home_ray = Vector3<S>::Zero();     ///< to the desired middle, likewise [1]
  long long poses = 0;                          ///< that are kept [ticks]
};

/// The target as it is followed, and what is known of it.
template <class S>
struct TrackedTarget {
  Mask<S> known = Mask<S>(false);                           ///< it has been seen
  S seen_at = S(-std::numeric_limits<double>::infinity());  ///< stamp of the newest frame that was taken [ticks]
  Pose<S> place;                                            ///< then, in B: x
  Vector6<S> twist = Vector6<S>::Zero();                    ///< v [m/s; rad/s]
  Vector6<S> xx = Vector6<S>::Zero(), xv = Vector6<S>::Zero(), vv = Vector6<S>::Zero();  ///< P, axis by axis
  Vector6<S> moving = Vector6<S>::Zero();                                                ///< share of v that counts [1]
  Pose<S> mean;                                                                          ///< of a target at rest
  Vector6<S> weight = Vector6<S>::Zero();  ///< of that mean, one over its variance
  Pose<S> view;                            ///< chi-hat of the newest frame

  template <class F>
  void for_each_member(F&& f) {
    f(known);
    f.time(seen_at);
    for (Pose<S>* pose : {&place, &mean, &view}) {
      f.finite(pose->position);
      f.finite(pose->quaternion);
    }
    for (Vector6<S>* six : {&twist, &xx, &xv, &vv, &moving, &weight}) f.finite(*six);
  }
};

/// What tracking keeps from tick to tick.
template <class S>
struct TrackingState {
  template <int N>
  TrackingState(const TrackingPlan<S, N>& plan, std::pmr::memory_resource* memory)
      : stamped(plan.stamped), poses(plan.poses, memory) {
    target.place = target.mean = target.view = plan.home;
    if (stamped) latency_range = {};
  }

  bool stamped = true;
  PoseHistory<S> poses;
  TrackedTarget<S> target;
  LatencyEstimator<S> latency;  ///< where frames carry no exposure
  LatencyRange<S> latency_range = latency.range();
  Vector6<S> offset = Vector6<S>::Zero();  ///< o [m], or [rad]
  Vector6<S> behind = Vector6<S>::Zero();  ///< b, likewise
  Vector6<S> reading = unknown_six<S>();   ///< legs of the newest reading
  S still{0.0};                            ///< time since the reference came to rest [s]
  Mask<S> integrating = Mask<S>(false);

  /// Calls `f` with each member, always in the same order.
  template <class F>
  void for_each_member(F&& f) {
    poses.for_each_member(f);
    target.for_each_member(f);
    if (!stamped) {
      latency.for_each_member(f);
      latency_range = latency.range();
    }
    f.finite(offset);
    f.finite(behind);
    f(reading);  // NaN before the first one
    f.finite(still);
    f(integrating);
  }
};

/// Nothing, of all other laws.
template <class S>
struct NoTracking {
  template <class Plan>
  NoTracking(const Plan& /*plan*/, std::pmr::memory_resource* /*memory*/) {}
  template <class F>
  void for_each_member(F&& /*f*/) {}
};
struct NoTrackingPlan {};

/// Whether a law gives where the legs shall go.
template <class Law>
inline constexpr bool kTracks = Law::traits.output == LawOutput::pose;
template <class S, class Law, int N>
using TrackingPlanOf = std::conditional_t<kTracks<Law>, TrackingPlan<S, N>, NoTrackingPlan>;
template <class S, class Law>
using TrackingStateOf = std::conditional_t<kTracks<Law>, TrackingState<S>, NoTracking<S>>;

/// a (x) b.
template <class S>
Vector4<S> quaternion_product(const Vector4<S>& a, const Vector4<S>& b) {
  const Vector3<S> u = a.template tail<3>(), v = b.template tail<3>();
  Vector4<S> out;
  out(0) = a(0) * b(0) - dot<S>(u, v);
  out.template tail<3>() = a(0) * v + b(0) * u + cross<S>(u, v);
  return out;
}

/// chi o chi-hat^-1 o goal: where the platform sees the target as from `goal` if it sees it as from `view` at `at`.
template <class S>
Pose<S> pose_to_follow(const Pose<S>& at, const Pose<S>& view, const Pose<S>& goal) {
  Vector4<S> back = view.quaternion;
  back.template tail<3>() = -back.template tail<3>();
  const Vector4<S> turn = quaternion_product<S>(at.quaternion, back);
  const Matrix3<S> R = rotation_matrix(turn);
  return {at.position + rotate<S>(R, Vector3<S>(goal.position - view.position)),
          quaternion_product<S>(turn, goal.quaternion)};
}

/// The home pose turned the shortest way so that the desired ray points at a place in B [m].
template <class S, int N>
Pose<S> pointing(const TrackingPlan<S, N>& plan, const Vector3<S>& place) {
  using std::sqrt;
  Vector3<S> centre = plan.home_centre;
  const Vector3<S> arm = centre - plan.home.position;
  Vector4<S> turn;
  for (int round = 0; round < kPointingRounds; ++round) {
    const Vector3<S> to = place - centre;
    const Vector3<S> ray = to * (S(1.0) / sqrt(to.squaredNorm()));
    turn(0) = S(1.0) + dot<S>(plan.home_ray, ray);
    turn.template tail<3>() = cross<S>(plan.home_ray, ray);
    turn *= S(1.0) / sqrt(turn.squaredNorm());
    centre = plan.home.position + rotate<S>(rotation_matrix(turn), arm);
  }
  return {plan.home.position, quaternion_product<S>(turn, plan.home.quaternion)};
}

/// Prepares tracking for a scenario, estimates only.
template <class S, int N>
TrackingPlan<S, N> tracking_plan(const LoopParameters<S, Tracking, N>& p, const ControlTask<S, N>& task) {
  using std::sqrt;
  constexpr double kTurn = 6.283185307179586;
  TrackingPlan<S, N> plan;
  plan.gains = p.gains;
  plan.follow = p.gains.follow;
  plan.stamped = p.frames.stamped;
  const S period(p.step), left = S(1.0) + expm1_of_negative(max(S(S(-kTurn) * p.gains.bandwidth * period), S(-700.0)));
  plan.approach = (S(1.0) - left) * (S(1.0) - left) / period;
  plan.braking = S(1.0) - left * left;
  const S w = S(kTurn) * p.actuators.position.bandwidth, lag = S(2.0) * p.actuators.position.damping / w;
  plan.lead = p.gains.lead * lag - S(0.5) * period;
  plan.lead_change = p.gains.lead / (w * w);
  plan.jitter = p.frames.stamped ? 0.0 : static_cast<double>(p.frames.jitter) * p.step;
  plan.delay = static_cast<double>(p.actuators.delay);
  plan.settling = S(kSettled) * lag / (S(1.0) + p.gains.feedback) + S((plan.delay + 2.0) * p.step);
  const S slower = S(2.0) * sqrt(max(S(p.actuators.position.damping * p.actuators.position.damping - S(1.0)), S(0.0)));
  plan.ease =
      S(-1.0) * expm1_of_negative(max(S(S(-1.0) * period * w / max(S(S(kEase) * slower), S(1e-300))), S(-700.0)));
  const S reach = (S(kReach) * lag + period) * p.actuators.position.speed_limit;
  plan.reach = select(is_finite(reach), reach, plan.reach);
  plan.home = home_pose(p.hexapod);
  const Matrix3<S> R_BE = rotation_matrix(plan.home.quaternion);
  plan.home_centre = CameraView<S>(task.camera).centre(plan.home.position, R_BE);
  Vector2<S> middle = Vector2<S>::Zero();
  S squares(0.0);
  for (int i = 0; i < N; ++i) {
    middle += task.weights.share(i) * task.desired_features.template segment<2>(2 * i);
    squares += task.weights.share(i) * task.weights.share(i);
  }
  const Vector3<S> ahead = lift<S>(task.camera, plan.home.position, R_BE, middle, S(-1.0)) - plan.home_centre;
  plan.home_ray = ahead * (S(1.0) / sqrt(ahead.squaredNorm()));
  const S variance = p.gains.noise * p.gains.noise;
  if (plan.follow == Follow::direction) {
    plan.variance.setConstant(S(variance * squares / (task.camera.focal * task.camera.focal)));
  } else {
    const Matrix3<S> R_goal = rotation_matrix(task.target.goal.quaternion);
    const ImageJacobian<S, N> J(task.camera, S(-1.0), task.desired_features, task.target.goal_inverse_depth,
                                task.target.goal.position, R_goal);
    const Cholesky<S, 6> solver(J.normal_matrix(task.weights));
    for (int j = 0; j < 6; ++j) {
      Vector6<S> unit = Vector6<S>::Zero();
      unit(j) = S(1.0);
      plan.variance(j) = variance * solver.solve(unit)(j);
    }
  }
  const double latest = p.frames.stamped ? static_cast<double>(oldest_stamp(p.frames)) : kMaxLatency / p.step;
  plan.poses = 3 + static_cast<long long>(std::ceil(latest)) + p.frames.period;
  return plan;
}

/// Takes over the frame of a tick, if there is a new one.
template <class S, int N>
void take_frame(const SafetyGains<S, N>& gains, const ControlTask<S, N>& task, const TrackingPlan<S, N>& plan,
                const Perceived<S, N>& seen, const SensorInput<S, N>& input, TrackingState<S>& state) noexcept {
  TrackedTarget<S>& target = state.target;
  const Mask<S> fresh = seen.usable & seen.joints & seen.complete & seen.whole & (seen.newest > target.seen_at) &
                        (input.frame.exposure == seen.newest);
  if (!any(fresh)) return;
  const S stamp = min(seen.newest, S(input.now));  // which it may be ahead of by rounding; poses are not

  Vector2<S> middle = Vector2<S>::Zero();
  S depth(0.0);
  for (int i = 0; i < N; ++i) {
    middle += task.weights.share(i) * seen.image.features.template segment<2>(2 * i);
    depth += task.weights.share(i) * seen.image.depth(i);
  }
  const bool directs = plan.follow == Follow::direction;
  Vector6<S> variance = plan.variance;
  if (directs) variance *= depth * depth;
  if (!plan.stamped) {
    using std::sqrt;
    S squares(0.0);
    for (int i = 0; i < N; ++i) squares += task.weights.share(i) * task.weights.share(i);
    state.latency.update(state.poses, task.camera, fresh, stamp, gains.period, middle, depth, plan.home_centre,
                         S(plan.gains.noise * sqrt(squares) / task.camera.focal), plan.jitter);
    state.latency_range = state.latency.range();
  }
  Mask<S> good = fresh;
  if (!directs) {
    const PoseEstimate<S> estimate =
        estimate_pose<S, N>(task.camera, task.target.points_T, seen.image.features,
                            select_pose<S>(target.known, target.view, seen.pose), Vector6<S>::Zero(), task.weights);
    good = good & (!estimate.failed);
    target.view = select_pose<S>(good, estimate.pose, target.view);
  }
  const S period(gains.period), first(state.poses.oldest());
  const auto followed_from = [&](const Pose<S>& interpolated) {
    const Pose<S> at = unit_pose<S>(interpolated);
    if (!directs) return pose_to_follow<S>(at, target.view, task.target.goal);
    return Pose<S>{lift<S>(task.camera, at.position, rotation_matrix(at.quaternion), middle, depth),
                   plan.home.quaternion};
  };
  const auto followed = [&](const S& latency) {
    const S tick = stamp - latency / period;
    return followed_from(state.poses.at(plan.stamped ? tick : max(tick, first)));
  };
  const LatencyRange<S>& latency = state.latency_range;
  const Pose<S> measured = followed(S(latency.estimate + S(0.5 * plan.jitter)));
  if (plan.stamped) {  // its latency is 0, its exposure may be between two readings of the joints
    const Vector6<S> bend = pose_difference<S>(followed_from(state.poses.on_line(stamp)), measured);
    for (int j = 0; j < 6; ++j) variance(j) += bend(j) * bend(j);
  } else {
    const Vector6<S> late = pose_difference<S>(followed(latency.least), measured),
                     soon = pose_difference<S>(followed(S(latency.most + S(plan.jitter))), measured);
    for (int j = 0; j < 6; ++j) variance(j) += max(S(late(j) * late(j)), S(soon(j) * soon(j)));
  }
  good = good & is_finite(S(measured.position.sum())) & is_finite(S(measured.quaternion.sum()));

  // Predicted, compared, corrected.
  const S dt = select(target.known, S((seen.newest - target.seen_at) * period), S(0.0));
  const Pose<S> expected = carried<S>(target.place, target.twist, dt);
  const Vector6<S> innovation = pose_difference<S>(measured, expected);
  Vector6<S> xx, xv, vv, correction, change, speed2;
  Mask<S> begins = !target.known;
  for (int j = 0; j < 6; ++j) {
    const S a2 = plan.gains.acceleration(j) * plan.gains.acceleration(j);
    vv(j) = target.vv(j) + a2 * dt * dt;
    xv(j) = target.xv(j) + dt * target.vv(j) + S(0.5) * a2 * dt * dt * dt;
    xx(j) = target.xx(j) + dt * (S(2.0) * target.xv(j) + dt * target.vv(j)) + S(0.25) * a2 * dt * dt * dt * dt;
    const S all_of_it = xx(j) + variance(j);
    begins = begins | (innovation(j) * innovation(j) > plan.gains.jump * plan.gains.jump * all_of_it);
    const S gain = xx(j) / all_of_it, gain_v = xv(j) / all_of_it;
    correction(j) = gain * innovation(j);
    change(j) = gain_v * innovation(j);
    vv(j) -= gain_v * xv(j);
    xv(j) -= gain * xv(j);
    xx(j) -= gain * xx(j);
    speed2(j) = plan.gains.speed(j) * plan.gains.speed(j);
  }
  const Pose<S> corrected = carried<S>(expected, correction, S(1.0));
  const Vector6<S> zero = Vector6<S>::Zero();
  const Pose<S> place = select_pose<S>(begins, measured, corrected);
  const Vector6<S> twist = select(begins, zero, Vector6<S>(target.twist + change));
  xx = select(begins, variance, xx);
  xv = select(begins, zero, xv);
  vv = select(begins, speed2, vv);

  // What of the velocity counts, and the mean of a target at rest.
  Vector6<S> moving;
  Mask<S> rests(true), restarts = begins;
  for (int block = 0; block < 6; block += 3) {
    S square(0.0), expectation(0.0);
    for (int j = block; j < block + 3; ++j) {
      square += twist(j) * twist(j);
      expectation += vv(j);
    }
    const S doubt = plan.gains.certainty * plan.gains.certainty * expectation;
    const S ratio = doubt / square;
    const S share = select(square > doubt, S(S(1.0) - ratio * ratio), S(0.0));
    for (int j = block; j < block + 3; ++j) moving(j) = share;
    rests = rests & (!(share > S(0.0)));
  }
  const Vector6<S> off = pose_difference<S>(place, target.mean);
  for (int j = 0; j < 6; ++j)
    restarts = restarts | (off(j) * off(j) > S(kOffTheMean * kOffTheMean) * xx(j)) | (!(target.weight(j) > S(0.0)));
  Vector6<S> weight, step;
  const Vector6<S> aside = pose_difference<S>(measured, target.mean);
  for (int j = 0; j < 6; ++j) {
    const S one = S(1.0) / variance(j);
    const S before = min(target.weight(j), S(S(kRestingFrames) * one));
    weight(j) = select(restarts, S(S(1.0) / xx(j)), S(before + one));
    step(j) = aside(j) * one / (before + one);
  }
  const Pose<S> mean = select_pose<S>(restarts, place, carried<S>(target.mean, step, S(1.0)));
  target.mean = select_pose<S>(good, mean, target.mean);
  target.weight = select(good, select(rests, weight, zero), target.weight);
  target.place = select_pose<S>(good, place, target.place);
  target.twist = select(good, twist, target.twist);
  target.moving = select(good, moving, target.moving);
  target.xx = select(good, xx, target.xx);
  target.xv = select(good, xv, target.xv);
  target.vv = select(good, vv, target.vv);
  target.seen_at = select(good, seen.newest, target.seen_at);
  target.known = target.known | good;
}

/// Pose that the reference goes to, for now and the legs' delay, and its twist: at the end of the period the reference
/// is where the target then is.
template <class S, int N>
void pose_ahead(const TrackingPlan<S, N>& plan, const TrackingState<S>& state, double now, const S& period,
                Pose<S>& pose, Vector6<S>& twist) noexcept {
  const TrackedTarget<S>& target = state.target;
  const S age = (S(now + plan.delay) - target.seen_at) * period + state.latency_range.estimate + S(0.5 * plan.jitter);
  const S ahead = min(age, S(kLongestPrediction));
  twist = target.twist.cwiseProduct(target.moving);
  const Mask<S> rests = largest_abs(target.moving) == S(0.0);
  pose = select_pose<S>(rests, target.mean, carried<S>(target.place, twist, select(target.known, ahead, S(0.0))));
  twist *= select(age > S(kLongestPrediction), S(0.0), S(1.0));  // what is followed stands still from there on
  if (plan.follow == Follow::pose) {
    pose = unit_pose<S>(pose);
    return;
  }
  const Vector3<S> place = pose.position, later = place + period * twist.template head<3>();
  pose = pointing<S>(plan, place);
  twist = pose_difference<S>(pointing<S>(plan, later), pose) * (S(1.0) / period);
}

/// One tick of the law: what the legs are commanded.
template <class S, int N>
[[gnu::noinline, gnu::cold]] void track(const SafetyGains<S, N>& gains, const ControlTask<S, N>& task,
                                        const TrackingPlan<S, N>& plan, const SensorInput<S, N>& input,
                                        SafetyState<S, N>& safety, TrackingState<S>& state, Command<S>& out) noexcept {
  using std::abs;
  using std::sqrt;
  const Perceived<S, N>& seen = safety.perception.now();
  CommandedMotion<S>& motion = safety.motion;
  const S period(gains.period);
  const Mask<S> sensed = seen.usable & seen.joints;
  const LegsSideBySide<S> seen_legs = inverse_kinematics(gains.legs, seen.pose.position, seen.R_BE);
  begin_motion(gains, seen, motion);
  if (any(sensed)) {
    state.poses.add(input.now, seen.pose, sensed);
    take_frame(gains, task, plan, seen, input, state);
  }
  Pose<S> goal;
  Vector6<S> goal_twist;
  pose_ahead(plan, state, input.now, period, goal, goal_twist);

  out.lengths = seen_legs.lengths;
  out.singular = WrenchMapSolver<S>(gains.legs, seen_legs).failed();
  const Matrix3<S> R_BE = rotation_matrix(motion.pose.quaternion);
  const LegsSideBySide<S> found = inverse_kinematics(gains.legs, motion.pose.position, R_BE);
  const WrenchMapSolver<S> solver(gains.legs, found);
  const Legs<S> legs = Legs<S>::of(found);

  const Vector6<S> zero = Vector6<S>::Zero(), error = pose_difference<S>(goal, motion.pose);
  const Vector6<S> freely = motion.twist + plan.approach * error + plan.braking * Vector6<S>(goal_twist - motion.twist);
  const Mask<S> may_act = seen.ready() & (!out.singular) & motion.begun & state.target.known & (!solver.failed());
  const Mask<S> finite = is_finite(S(freely.sum()));
  out.law_failed = may_act & (!finite);
  out.acts = may_act & finite;

  // No faster than what the legs can be braked from on the way that is left.
  const S acceleration = S(kBraking) * min(gains.motion.acceleration_limit, S(1e300));
  const Vector6<S> along = legs.rates(goal_twist), way = legs.rates(error);
  Vector6<S> rates = legs.rates(freely) - along;
  S share(1.0);
  for (int i = 0; i < 6; ++i) {
    const S half = S(0.5) * acceleration * period;
    const S bound = sqrt(S(half * half + S(2.0) * acceleration * abs(way(i)))) - half;
    share = min(share, select(abs(rates(i)) > bound, S(bound / abs(rates(i))), S(1.0)));
  }
  rates = select(out.acts, Vector6<S>(along + share * rates), zero);
  const Vector6<S> before = legs.rates(motion.twist);
  const Vector6<S> feasible = feasible_rates(gains, rates, before, legs.lengths);
  const Mask<S> limited = out.acts & (largest_abs(Vector6<S>(feasible - rates)) > S(0.0));
  Vector6<S> twist = solver.twist(feasible);
  const Pose<S> next = carried<S>(motion.pose, twist, period);
  const Vector6<S> reference =
      inverse_kinematics(gains.legs, next.position, rotation_matrix(next.quaternion)).lengths.vector();
  const Mask<S> reachable = motion.begun & is_finite(S(reference.sum())) & is_finite(S(twist.sum()));
  twist = select(reachable, twist, zero);
  out.saturated = out.acts & (limited | (!reachable));

  // The offset of legs that come to rest elsewhere.
  const Vector6<S> aside = pose_difference<S>(motion.pose, seen.pose);
  Mask<S> near = out.acts & (largest_abs(state.target.moving) == S(0.0)), off(false), far(false);
  for (int j = 0; j < 6; ++j) {
    near = near & (abs(error(j)) <= plan.gains.band(j));
    off = off | (abs(aside(j)) > plan.gains.band(j));
    far = far | (abs(aside(j)) > S(2.0) * plan.gains.band(j));
  }
  state.still = select(near, S(state.still + period), S(0.0));
  const Mask<S> settled = state.still > plan.settling;
  state.integrating = settled & ((state.integrating & off) | far);
  const S rate = plan.gains.integral * period;
  const Vector6<S> seen_lengths = seen_legs.lengths.vector();
  const Mask<S> corrected = out.acts & sensed & (plan.gains.feedback > S(0.0)) & is_finite(S(seen_lengths.sum()));
  const Mask<S> follows = corrected & ((!settled) | state.integrating);  // at rest what was added stays
  for (int i = 0; i < 6; ++i) {
    const S moved = clip(S(state.offset(i) + rate * (legs.lengths(i) - seen_lengths(i))), S(-gains.hexapod.stroke),
                         gains.hexapod.stroke);
    state.offset(i) = select(state.integrating, moved, state.offset(i));  // not a reading that is no number
    const S due = legs.lengths(i) - S(plan.delay) * period * before(i);   // where the legs should be by now
    const S pull = plan.gains.feedback * (due - seen_lengths(i));
    state.behind(i) = select(follows, S(state.behind(i) + plan.ease * (pull - state.behind(i))), state.behind(i));
  }

  Vector6<S> command;
  for (int i = 0; i < 6; ++i) {
    const S wanted = reference(i) + plan.lead * feasible(i) + plan.lead_change * (feasible(i) - before(i)) / period +
                     state.behind(i) + state.offset(i);
    const S change = seen_lengths(i) - state.reading(i);
    const S acted_on = seen_lengths(i) + S(plan.delay + 0.5) * select(is_finite(change), change, S(0.0));
    const S near_legs = select(corrected, clip(wanted, S(acted_on - plan.reach), S(acted_on + plan.reach)), wanted);
    state.reading(i) = select(sensed, seen_lengths(i), state.reading(i));
    const S middle = gains.hexapod.mid_lengths(i);
    command(i) = clip(near_legs, S(middle - gains.hexapod.stroke), S(middle + gains.hexapod.stroke));
  }
  out.wrench = wrench_of_motion(gains.body, R_BE, motion.twist, Vector6<S>((twist - motion.twist) * (S(1.0) / period)));
  out.leg_forces = solver.leg_forces(out.wrench);
  motion.twist = twist;
  motion.legs = select(reachable, command, motion.legs);
  motion.pose = select_pose<S>(reachable, next, motion.pose);
}

}  // namespace hexservo
