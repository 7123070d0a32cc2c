/// @file
/// The law `tracking`: from frames and the pose of each one's exposure to where the legs shall go (docs/model.md,
/// section 5).
///
/// What is followed is estimated in B, by a filter that estimates its velocity too (target_filter.hpp). Its velocity
/// counts as far as it exceeds its own standard deviation; where it does not, the straight line through the frames
/// since is followed. What lies beyond `jump` standard deviations restarts the filter.
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

#include "hexservo/motion_command.hpp"
#include "hexservo/target_filter.hpp"

namespace hexservo {

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
  S settling{0.0};      ///< time after which the legs are where they were commanded [s]
  double jitter = 0.0;  ///< most that a latency no frame carries is longer for a frame [s]
  double delay = 0.0;   ///< of the legs [ticks]
  S timeout = S(std::numeric_limits<double>::infinity());  ///< age of the newest frame that was taken [ticks]
  S variance{0.0};                                         ///< R of a direction, over the depth squared [rad^2]
  Pose<S> home;
  Vector3<S> home_centre = Vector3<S>::Zero();  ///< of the camera at home, in B [m]
  Vector3<S> home_ray = Vector3<S>::Zero();     ///< to the desired middle, likewise [1]
  bool has_readings = false;                    ///< whether the pose is that of readings, which not every tick may have
  long long poses = 0;                          ///< that are kept [ticks]
};

/// What tracking keeps from tick to tick.
template <class S>
struct TrackingState {
  template <int N>
  TrackingState(const TrackingPlan<S, N>& plan, std::pmr::memory_resource* memory)
      : stamped(plan.stamped), poses(plan.poses, memory) {
    target.place = target.mean = target.followed = target.view = plan.home;
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
  Vector6<S> change = Vector6<S>::Zero();  ///< of a tick, up to it
  S still{0.0};                            ///< time since the reference came to rest [s]
  Mask<S> integrating = Mask<S>(false);
  Mask<S> recent = Mask<S>(false);  ///< at this tick: the newest frame that was taken is not older than the timeout

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
    f.finite(change);
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

/// The home pose with the desired ray, from the camera on its arm, turned the shortest way so that it meets a place in
/// B [m].
///
/// The ray meets the sphere around home's position on which the place lies at one point in front of the camera. That is
/// turned to the place, and then about it, until the axis of both turns together is perpendicular to the ray. A place
/// nearer than any point of the ray is looked past as closely as can be.
template <class S, int N>
Pose<S> pointing(const TrackingPlan<S, N>& plan, const Vector3<S>& place) {
  using std::sqrt;
  const Vector3<S> arm = plan.home_centre - plan.home.position, to = place - plan.home.position;
  const S along = dot<S>(arm, plan.home_ray), room = along * along - arm.squaredNorm() + to.squaredNorm();
  const Vector3<S> meeting = arm + plan.home_ray * (sqrt(max(room, S(0.0))) - along);
  // quaternions but for their lengths: (w, v) to the place, (c, s to) about it
  const S w = sqrt(meeting.squaredNorm() * to.squaredNorm()) + dot<S>(meeting, to);
  const Vector3<S> v = cross<S>(meeting, to), about = to * w + cross<S>(to, v);
  const S c = dot<S>(about, plan.home_ray), s = dot<S>(v, plan.home_ray);
  Vector4<S> turn;
  turn(0) = c * w;
  turn.template tail<3>() = v * c - about * s;
  turn *= S(1.0) / sqrt(turn.squaredNorm());
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
  plan.timeout = p.frames.timeout;
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
  plan.variance = p.gains.noise * p.gains.noise * squares / (task.camera.focal * task.camera.focal);
  const double latest = p.frames.stamped ? static_cast<double>(oldest_stamp(p.frames)) : kMaxLatency / p.step;
  plan.has_readings = p.pose_source == PoseSource::encoders;
  plan.poses = 3 + static_cast<long long>(std::ceil(latest)) + p.frames.period;
  return plan;
}

/// Takes over a new frame, once the joints have been read at its exposure or later.
/// @param known of which tick the reading before this one was
template <class S, int N>
void take_frame(const SafetyGains<S, N>& gains, const ControlTask<S, N>& task, const TrackingPlan<S, N>& plan,
                const Perceived<S, N>& seen, const SensorInput<S, N>& input, double known,
                TrackingState<S>& state) noexcept {
  TrackedTarget<S>& target = state.target;
  const S stamp = min(seen.newest, S(input.now));  // which it may be ahead of by rounding; poses are not
  const Mask<S> due = ((input.frame.exposure == seen.newest) | (stamp > S(known))) & (stamp <= S(state.poses.newest()));
  const Mask<S> fresh = seen.usable & seen.joints & seen.complete & seen.whole & (seen.newest > target.seen_at) & due;
  if (!any(fresh)) return;

  Vector2<S> middle = Vector2<S>::Zero();
  S depth(0.0);
  for (int i = 0; i < N; ++i) {
    middle += task.weights.share(i) * seen.image.features.template segment<2>(2 * i);
    depth += task.weights.share(i) * seen.image.depth(i);
  }
  if (!plan.stamped) {
    using std::sqrt;
    S squares(0.0);
    for (int i = 0; i < N; ++i) squares += task.weights.share(i) * task.weights.share(i);
    state.latency.update(state.poses, task.camera, fresh, stamp, gains.period, middle, depth, plan.home_centre,
                         S(plan.gains.noise * sqrt(squares) / task.camera.focal), plan.jitter);
    state.latency_range = state.latency.range();
  }
  const bool directs = plan.follow == Follow::direction;
  const S period(gains.period), first(state.poses.oldest());
  const LatencyRange<S>& latency = state.latency_range;
  const auto pose_at = [&](const S& latency_of_frame) {
    const S tick = stamp - latency_of_frame / period;
    return unit_pose<S>(state.poses.at(plan.stamped ? tick : max(tick, first)));
  };
  const Pose<S> at = pose_at(S(latency.estimate + S(0.5 * plan.jitter)));

  // A reading with what the pose of the exposure may be off: by the ends of the interval of the latency, or, where that
  // is known, by what a straight line between two readings of the joints is off.
  const auto with_exposure = [&](TargetReading<S> reading, const auto& followed_from) {
    const auto add = [&](const Pose<S>& first_end, const Pose<S>& last_end) {
      const Vector6<S> one = pose_difference<S>(followed_from(first_end), reading.place),
                       other = pose_difference<S>(followed_from(last_end), reading.place);
      if (directs) {
        for (int j = 0; j < 3; ++j) reading.variance(j, j) += max(S(one(j) * one(j)), S(other(j) * other(j)));
        return;
      }
      // Of a pose alike along all axes of B: shifts and rotations each.
      const S shift = max(S(one.template head<3>().squaredNorm()), S(other.template head<3>().squaredNorm())),
              turn = max(S(one.template tail<3>().squaredNorm()), S(other.template tail<3>().squaredNorm()));
      for (int j = 0; j < 6; ++j) reading.variance(j, j) += j < 3 ? shift : turn;
    };
    if (plan.stamped) {
      const Pose<S> on_line = unit_pose<S>(state.poses.on_line(stamp));
      add(on_line, on_line);
      if (!directs) {  // a pose is seen better than joints are read in time: so much within a tick
        const S least = max(S(stamp - S(1.0)), first), most = min(S(stamp + S(1.0)), S(state.poses.newest()));
        add(unit_pose<S>(state.poses.at(least)), unit_pose<S>(state.poses.at(most)));
      }
    } else {
      add(pose_at(latency.least), pose_at(S(latency.most + S(plan.jitter))));
    }
    return reading;
  };
  const S dt = select(target.known, S((seen.newest - target.seen_at) * period), S(0.0));
  if (directs) {
    const auto followed_from = [&](const Pose<S>& pose) {
      return Pose<S>{lift<S>(task.camera, pose.position, rotation_matrix(pose.quaternion), middle, depth),
                     plan.home.quaternion};
    };
    TargetReading<S> reading;
    reading.place = followed_from(at);
    reading.of_the_image = S(plan.variance * depth * depth) * Matrix6<S>::Identity();
    reading.variance = reading.of_the_image;
    reading = with_exposure(reading, followed_from);
    const auto read = [&](const Pose<S>& expected, const Matrix6<S>*) {
      reading.off = pose_difference<S>(reading.place, expected);
      return reading;
    };
    filter_target<S, N>(plan.gains, 3, dt, fresh, seen.newest, read, [&] { return reading; }, target);
    return;
  }
  const auto read = [&](const Pose<S>& expected, const Matrix6<S>* doubt) {
    const TargetReading<S> reading = read_pose<S, N>(task, seen.image.features, plan.gains.noise, at, expected, doubt);
    const Pose<S> view = pose_to_follow<S>(task.target.goal, reading.place, at);
    return with_exposure(reading, [&](const Pose<S>& pose) { return pose_to_follow<S>(pose, view, task.target.goal); });
  };
  const auto read_alone = [&] {
    const auto estimate_from = [&](const Pose<S>& start) {
      return estimate_pose<S, N>(task.camera, task.target.points_T, seen.image.features, start, Vector6<S>::Zero(),
                                 task.weights);
    };
    // From where it was seen last, or, where a bad frame left that far away, from the platform's own pose.
    const PoseEstimate<S> last = estimate_from(select_pose<S>(target.known, target.view, seen.pose)),
                          own = estimate_from(seen.pose);
    const Mask<S> by_own = (!own.failed) & (last.failed | (S(4.0) * own.squared_residual < last.squared_residual));
    const Pose<S> view = select_pose<S>(by_own, own.pose, last.pose);
    TargetReading<S> reading = read(pose_to_follow<S>(at, view, task.target.goal), nullptr);
    reading.failed = reading.failed | ((!by_own) & last.failed);
    return reading;
  };
  filter_target<S, N>(plan.gains, 6, dt, fresh, seen.newest, read, read_alone, target);
  const Mask<S> taken = fresh & (target.seen_at == seen.newest);
  target.view = select_pose<S>(taken, unit_pose<S>(pose_to_follow<S>(task.target.goal, target.place, at)), target.view);
}

/// Pose that the reference goes to, for now and the legs' delay, and its twist: at the end of the period the reference
/// is where the target then is.
template <class S, int N>
void pose_ahead(const TrackingPlan<S, N>& plan, const TrackingState<S>& state, double now, const S& period,
                Pose<S>& pose, Vector6<S>& twist) noexcept {
  const TrackedTarget<S>& target = state.target;
  const S age = (S(now + plan.delay) - target.seen_at) * period + state.latency_range.estimate + S(0.5 * plan.jitter);
  const S ahead = min(age, S(kLongestPrediction));
  twist = target.followed_twist;
  pose = carried<S>(target.followed, twist, select(target.known, ahead, S(0.0)));
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
  const Mask<S> sensed = seen.usable & seen.joints, read = sensed & (seen.read | Mask<S>(!plan.has_readings));
  const LegsSideBySide<S> seen_legs = inverse_kinematics(gains.legs, seen.pose.position, seen.R_BE);
  begin_motion(gains, seen, motion);
  const double known = state.poses.empty() ? -std::numeric_limits<double>::infinity() : state.poses.newest();
  if (any(read)) state.poses.add(input.now, seen.pose, read);
  if (any(sensed) && !state.poses.empty()) take_frame(gains, task, plan, seen, input, known, state);
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
  state.recent = S(input.now) - state.target.seen_at <= plan.timeout + S(kTickTolerance);
  const Mask<S> followed = state.target.known & state.recent;
  const Mask<S> may_act = seen.ready() & (!out.singular) & motion.begun & followed & (!solver.failed());
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
  Mask<S> near = out.acts, off(false), far(false);
  for (int j = 0; j < 6; ++j) {
    near = near & (abs(error(j)) <= plan.gains.band(j)) & (plan.settling * abs(goal_twist(j)) <= plan.gains.band(j));
    off = off | (abs(aside(j)) > plan.gains.band(j));
    far = far | (abs(aside(j)) > S(2.0) * plan.gains.band(j));
  }
  state.still = select(near, S(state.still + period), S(0.0));
  const Mask<S> settled = state.still > plan.settling;
  state.integrating = settled & ((state.integrating & off) | far);
  const S rate = plan.gains.integral * period;
  const Vector6<S> seen_lengths = seen_legs.lengths.vector();
  const Mask<S> corrected = out.acts & sensed & (plan.gains.feedback > S(0.0)) & is_finite(S(seen_lengths.sum()));
  const Mask<S> follows = corrected & read & ((!settled) | state.integrating);  // at rest what was added stays
  for (int i = 0; i < 6; ++i) {
    const S moved = clip(S(state.offset(i) + rate * (legs.lengths(i) - seen_lengths(i))), S(-gains.hexapod.stroke),
                         gains.hexapod.stroke);
    state.offset(i) = select(state.integrating, moved, state.offset(i));  // not a reading that is no number
    const S due = legs.lengths(i) - S(plan.delay) * period * before(i);   // where the legs should be by now
    const S pull = plan.gains.feedback * (due - seen_lengths(i));
    state.behind(i) = select(follows, S(state.behind(i) + plan.ease * (pull - state.behind(i))), state.behind(i));
  }

  Vector6<S> command;
  const double newest = state.poses.empty() ? input.now : state.poses.newest();
  const S between(newest > known && std::isfinite(known) ? newest - known : 1.0), age(input.now - newest);
  for (int i = 0; i < 6; ++i) {
    const S wanted = reference(i) + plan.lead * feasible(i) + plan.lead_change * (feasible(i) - before(i)) / period +
                     state.behind(i) + state.offset(i);
    const S change = (seen_lengths(i) - state.reading(i)) / between;
    state.change(i) = select(read, select(is_finite(change), change, S(0.0)), state.change(i));
    const S acted_on = seen_lengths(i) + (S(plan.delay + 0.5) + age) * state.change(i);
    command(i) = select(corrected, clip(wanted, S(acted_on - plan.reach), S(acted_on + plan.reach)), wanted);
    state.reading(i) = select(read, seen_lengths(i), state.reading(i));
  }
  out.wrench = wrench_of_motion(gains.body, R_BE, motion.twist, Vector6<S>((twist - motion.twist) * (S(1.0) / period)));
  out.leg_forces = solver.leg_forces(out.wrench);
  motion.twist = twist;
  motion.legs = select(reachable, within_stroke(gains.hexapod, motion.legs, command), motion.legs);
  motion.pose = select_pose<S>(reachable, next, motion.pose);
}

}  // namespace hexservo
