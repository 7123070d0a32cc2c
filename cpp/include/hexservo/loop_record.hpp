/// @file
/// What a loop keeps of its grid times: whether each lane goes on and why not, the newest good sample, the metrics
/// (docs/model.md, section 8).
#pragma once

#include "hexservo/outcome.hpp"
#include "hexservo/world.hpp"

#include <optional>

namespace hexservo {

/// The books of a run (`S = double`) or of a pack.
template <class S, int N = kPoints>
class LoopRecord {
 public:
  /// @param start where the run begins
  template <class Law>
  LoopRecord(const LoopParameters<S, Law, N>& p, const WorldState<S, N>& start)
      : legs_(p.hexapod), desired_features_(p.desired_features) {
    Sample<S, N>::visit([](auto& value, const auto&) { value.setZero(); }, sample_, sample_);
    sample_.position = position_of(start.body);
    sample_.quaternion = quaternion_of(start.body);
    metrics_.emplace(p.metrics, p.hexapod, gravity_wrench(p.body), sample_);
  }

  /// Lanes that go on.
  Mask<S> running() const noexcept { return cause_ == S(0.0); }
  /// StopCause of each lane, as a number.
  const S& cause() const noexcept { return cause_; }
  /// The newest good sample of each lane, and its time [s].
  const Sample<S, N>& sample() const noexcept { return sample_; }
  const S& sample_time() const noexcept { return sample_time_; }
  const MetricsAccumulator<S, N>& metrics() const noexcept { return *metrics_; }

  /// Stops the lanes that may not go on to a state.
  /// @param nearest largest Z_i on the way there [m]
  void judge(const WorldState<S, N>& next, const S& nearest) noexcept {
    const Image<S, N>& image = next.view.image;
    stop(StopCause::not_finite, !(is_finite(next.body) & is_finite(image.features) & is_finite(image.depth)));
    stop(StopCause::feature_error, largest_abs<S, 2 * N, 1>(desired_features_ - image.features) > S(kMaxFeatureError));
    stop(StopCause::twist, largest_abs<S, 6, 1>(twist_of(next.body)) > S(kMaxTwist));
    stop(StopCause::behind_camera, nearest >= S(0.0));
  }

  /// Takes over the sample of a state where it is good, and stops the lane where it is not.
  void accept(double time, const WorldState<S, N>& state, const Vector6<S>& wrench,
              const Vector6<S>& fuzzy_output) noexcept {
    const LegsSideBySide<S> legs = inverse_kinematics(legs_, position_of(state.body), state.view.R_BE);
    const WrenchMapSolver<S> solver(legs_, legs);
    const Sample<S, N> next{desired_features_ - state.view.image.features,
                            state.view.image.depth,
                            position_of(state.body),
                            quaternion_of(state.body),
                            twist_of(state.body),
                            wrench,
                            fuzzy_output,
                            legs.lengths.vector(),
                            solver.leg_forces(wrench)};
    const Mask<S> finite = is_finite(next.wrench) & is_finite(next.fuzzy_output) & is_finite(next.leg_forces);
    const Mask<S> regular = !solver.failed();  // leg forces of a singular pose have no meaning
    stop(StopCause::not_finite, (!finite) & regular);
    stop(StopCause::singular, solver.failed());
    const Mask<S> good = running();
    Sample<S, N>::visit([&good](auto& value, const auto& from) { value = select(good, from, value); }, sample_, next);
    sample_time_ = select(good, S(time), sample_time_);
    metrics_->add(time, sample_, good);
  }

  /// Notes the first cause of each lane.
  void stop(StopCause cause, const Mask<S>& where) noexcept {
    cause_ = select(where & running(), S(static_cast<double>(cause)), cause_);
  }

 private:
  LegGeometry<S> legs_;
  Vector<S, 2 * N> desired_features_;
  Sample<S, N> sample_;
  std::optional<MetricsAccumulator<S, N>> metrics_;
  S sample_time_{0.0};
  S cause_{0.0};
};

}  // namespace hexservo
