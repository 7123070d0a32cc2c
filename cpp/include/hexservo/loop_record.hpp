/// @file
/// What a loop keeps of its grid times: whether each lane goes on and why not, the newest good sample, the metrics
/// (docs/model.md, section 8).
#pragma once

#include "hexservo/outcome.hpp"
#include "hexservo/world.hpp"

#include <optional>

namespace hexservo {

/// Record of a run (`S = double`) or of a pack.
template <class S, int N = kPoints>
class LoopRecord {
 public:
  /// @param start where the run begins
  LoopRecord(const SceneParameters<S, N>& p, const WorldState<S, N>& start)
      : legs_(p.hexapod),
        mid_lengths_(p.hexapod.mid_lengths),
        stroke_(p.hexapod.stroke),
        desired_features_(p.desired_features),
        stops_at_limit_(p.mode == LoopMode::sampled && p.on_limit == LimitPolicy::stop),
        samples_legs_(p.samples_legs),
        measures_legs_(p.measured.has(MetricGroup::leg_lengths) || p.measured.has(MetricGroup::leg_forces) ||
                       p.measured.has(MetricGroup::leg_motion)),
        limits_every_(p.limits_every) {
    Sample<S, N>::visit([](const char*, auto& value) { value.setZero(); }, sample_);
    sample_.position = position_of(start.body);
    sample_.quaternion = quaternion_of(start.body);
    sample_.feature_error = desired_features_ - start.view.image.features;
    sample_.depth = start.view.image.depth;
    sample_.twist = twist_of(start.body);
    sample_.leg_lengths = inverse_kinematics(legs_, sample_.position, start.view.R_BE).lengths.vector();
    metrics_.emplace(p.metrics, p.hexapod, p.body, desired_features_, sample_, p.points, p.measured);
  }

  /// Lanes that go on.
  Mask<S> running() const noexcept { return cause_ == S(0.0); }
  /// StopCause of each lane, as a number.
  const S& cause() const noexcept { return cause_; }
  /// The newest good sample of each lane, and its time [s].
  const Sample<S, N>& sample() const noexcept { return sample_; }
  const S& sample_time() const noexcept { return sample_time_; }
  const MetricsAccumulator<S, N>& metrics() const noexcept { return *metrics_; }
  /// Leg that ended a lane, 0 to 5; -1 where none did.
  const S& limit_leg() const noexcept { return limit_leg_; }
  /// What that leg had there, in the unit of its limit; of a joint the chord of its tilt.
  const S& limit_value() const noexcept { return limit_value_; }

  /// Stops the lanes that may not go on to a state.
  /// @param nearest largest Z_i on the way there [m]
  void judge(const WorldState<S, N>& next, const S& nearest) noexcept {
    const Image<S, N>& image = next.view.image;
    const Vector<S, 2 * N> error = desired_features_ - image.features;
    const Vector6<S> twist = twist_of(next.body);
    // Where this sum is finite, each number is: then a maximum need not look for NaN.
    const Mask<S> finite = is_finite(S((image.features.sum() + image.depth.sum()) +
                                       (position_of(next.body).sum() + quaternion_of(next.body).sum()) + twist.sum()));
    const Mask<S> usual = (detail::largest_abs(error, detail::TakeAll{}) <= S(kMaxFeatureError)) &
                          (detail::largest_abs(twist, detail::TakeAll{}) <= S(kMaxTwist)) & (nearest < S(0.0));
    if (all(finite & usual)) return;
    stop(StopCause::not_finite, !(is_finite(next.body) & is_finite(image.features) & is_finite(image.depth)));
    stop(StopCause::feature_error, largest_abs(error) > S(kMaxFeatureError));
    stop(StopCause::twist, largest_abs(twist) > S(kMaxTwist));
    stop(StopCause::behind_camera, nearest >= S(0.0));
  }

  /// Whether legs, and whether their pose is singular, matter in the next sample.
  bool needs_legs() const noexcept { return samples_legs_ || ((measures_legs_ || stops_at_limit_) && is_limit_due()); }

  /// Takes over the sample of a state where it is good, and stops the lane where it is not.
  void accept(double time, const WorldState<S, N>& state, const Vector6<S>& wrench,
              const Vector6<S>& fuzzy_output) noexcept {
    if (!needs_legs()) {
      const Vector6<S> none = Vector6<S>::Zero();
      accept(time, state, none, Mask<S>(false), wrench, none, fuzzy_output, Mask<S>(false));
      return;
    }
    const LegsSideBySide<S> legs = inverse_kinematics(legs_, position_of(state.body), state.view.R_BE);
    const WrenchMapSolver<S> solver(legs_, legs);
    accept(time, state, legs.lengths.vector(), solver.failed(), wrench, solver.leg_forces(wrench), fuzzy_output,
           Mask<S>(false));
  }

  /// The same with leg lengths and forces that are known.
  /// @param singular where the legs are at a singular pose
  /// @param unsensed where the sensors of the legs give no pose
  void accept(double time, const WorldState<S, N>& state, const Vector6<S>& lengths, const Mask<S>& singular,
              const Vector6<S>& wrench, const Vector6<S>& leg_forces, const Vector6<S>& fuzzy_output,
              const Mask<S>& unsensed) noexcept {
    const bool limits = is_limit_due();
    until_limits_ = limits ? limits_every_ - 1 : until_limits_ - 1;
    const auto fill = [&](Sample<S, N>& sample) {
      sample.feature_error = desired_features_ - state.view.image.features;
      sample.depth = state.view.image.depth;
      sample.position = position_of(state.body);
      sample.quaternion = quaternion_of(state.body);
      sample.twist = twist_of(state.body);
      sample.wrench = wrench;
      sample.fuzzy_output = fuzzy_output;
      sample.leg_lengths = lengths;
      sample.leg_forces = leg_forces;
    };
    // What `judge` let pass is finite already.
    const Mask<S> finite = is_finite(S((wrench.sum() + fuzzy_output.sum()) + (leg_forces.sum() + lengths.sum())));
    if (!stops_at_limit_ && all(running() & finite & (!singular) & !unsensed)) {
      fill(sample_);
      sample_time_ = S(time);
      metrics_->add_finite(time, sample_, limits);
      return;
    }
    const Mask<S> regular = !singular;  // leg forces of a singular pose have no meaning
    stop(StopCause::not_finite, (!(is_finite(wrench) & is_finite(fuzzy_output) & is_finite(leg_forces))) & regular);
    if (stops_at_limit_ && limits) stop_at_limit(time, state.body, lengths);
    stop(StopCause::singular, singular);
    stop(StopCause::solver_failed, unsensed);
    const Mask<S> good = running();
    Sample<S, N> next;
    fill(next);
    Sample<S, N>::visit([&good](const char*, auto& value, const auto& from) { value = select(good, from, value); },
                        sample_, next);
    sample_time_ = select(good, S(time), sample_time_);
    metrics_->add(time, sample_, good, limits);
  }

  /// Ends a run: legs that its last step has not looked at get into the newest sample, which may turn out to be at a
  /// singular pose.
  void finish() noexcept {
    if (samples_legs_ || ((measures_legs_ || stops_at_limit_) && limits_every_ == 1)) return;
    const LegsSideBySide<S> legs =
        inverse_kinematics(legs_, sample_.position, Matrix3<S>(rotation_matrix(sample_.quaternion)));
    const WrenchMapSolver<S> solver(legs_, legs);
    sample_.leg_lengths = legs.lengths.vector();
    const Vector6<S> unknown = Vector6<S>::Constant(S(std::numeric_limits<double>::quiet_NaN()));
    sample_.leg_forces = select(solver.failed(), unknown, solver.leg_forces(sample_.wrench));
    stop(StopCause::singular, solver.failed());
  }

  /// Notes the first cause of each lane.
  void stop(StopCause cause, const Mask<S>& where) noexcept {
    cause_ = select(where & running(), S(static_cast<double>(cause)), cause_);
  }

 private:
  /// Whether limits, and metrics of the legs, are looked at in the next sample.
  bool is_limit_due() const noexcept { return until_limits_ == 0; }

  /// Stops lanes with a leg beyond its stroke, its speed limit or its joint limit.
  void stop_at_limit(double time, const BodyMotion<S>& body, const Vector6<S>& lengths) noexcept {
    stop_beyond(StopCause::leg_limit, leg_travel<S>(lengths, mid_lengths_, stroke_), stroke_);
    const LegWatch<S>& watch = metrics_->watch();
    if (!watch.acts()) return;
    const LegMotion<S> motion = watch.at(position_of(body), quaternion_of(body), twist_of(body));
    stop_beyond(StopCause::leg_speed, travel_.speeds(time, motion, watch.speed_limit()), watch.speed_limit());
    stop_beyond(StopCause::base_joint, motion.base_chords, watch.base_chord());
    stop_beyond(StopCause::platform_joint, motion.platform_chords, watch.platform_chord());
  }

  /// Stops lanes with a leg beyond a limit; of several legs the one that is farthest beyond is named.
  void stop_beyond(StopCause cause, const Vector6<S>& values, const S& limit) noexcept {
    using std::abs;
    S farthest = limit, leg(-1.0);
    for (int i = 0; i < 6; ++i) {
      const S value = abs(values(i));
      leg = select(value > farthest, S(static_cast<double>(i)), leg);
      farthest = max(farthest, value);
    }
    const Mask<S> beyond = leg >= S(0.0);
    limit_leg_ = select(beyond & running(), leg, limit_leg_);
    limit_value_ = select(beyond & running(), farthest, limit_value_);
    stop(cause, beyond);
  }

  LegGeometry<S> legs_;
  LegTravel<S> travel_;
  Vector6<S> mid_lengths_;
  S stroke_;
  Vector<S, 2 * N> desired_features_;
  Sample<S, N> sample_;
  std::optional<MetricsAccumulator<S, N>> metrics_;
  S sample_time_{0.0};
  S cause_{0.0};
  S limit_leg_{-1.0};
  S limit_value_{0.0};
  bool stops_at_limit_;
  bool samples_legs_;   ///< in every sample, whether they are looked at or not
  bool measures_legs_;  ///< whether a metric does
  long long limits_every_;
  long long until_limits_ = 0;  ///< samples
};

}  // namespace hexservo
