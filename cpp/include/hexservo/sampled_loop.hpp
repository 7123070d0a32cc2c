/// @file
/// The closed loop as it would be built: a camera with a period and a latency, joint sensors, a servo that ticks,
/// actuators that hold between two ticks, a base that may move (docs/model.md, section 7).
///
/// `SampledPlant` is everything but the law: `observe` shows what the law sees at a tick, `command` takes its wrench,
/// `advance` goes on to the next tick. `SampledLoop<S, Law>` joins a law to it and has the face of `ClosedLoop`.
#pragma once

#include "hexservo/loop_record.hpp"

#include <optional>

namespace hexservo {

/// Plant, sensors and actuators on the grid of the servo's ticks, from home, at rest.
template <class S, int N = kPoints>
class SampledPlant {
 public:
  /// What a law sees at a tick.
  struct Observation {
    Image<S, N> image;  ///< features [px] and measured depths [m]
    Pose<S> pose;       ///< from the joint sensors, in B
    Matrix3<S> R_BE;    ///< attitude of `pose`
    Vector6<S> twist;   ///< from the joint sensors, in B [m/s; rad/s]
    S newest;           ///< tick at which the newest frame was exposed; -1 before the first
    Mask<S> ready;      ///< every point was seen, and the image is not too old; otherwise it has no meaning
  };

  template <class Law>
  explicit SampledPlant(const LoopParameters<S, Law, N>& p)
      : period_(p.step),
        substeps_(p.substeps),
        depth_error_(p.depth_error),
        rest_wrench_(gravity_wrench(p.body)),
        stops_where_lost_(p.frames.on_lost == LostFeature::stop),
        world_(p),
        state_(world_.start(p)),
        hexapod_(p.hexapod),
        leg_geometry_(p.hexapod),
        holds_leg_forces_(p.actuators.hold == ActuatorHold::leg_forces),
        base_moves_(p.base_motion.kind != BaseMotionKind::none),
        base_(p.base_motion, p.seed, p.recorded),
        frames_(p.frames, p.camera.focal_pixels(), p.seed, measured_image(state_.view.image, p.depth_error)),
        record_(p, state_),
        unsensed_(false),
        saturated_(false) {
    if (p.pose_source == PoseSource::encoders)
      encoders_.emplace(p.encoders, hexapod_, p.seed, p.step, home_pose(p.hexapod));
    if (acts(p.actuators)) {
      const WrenchMapSolver<S> solver(hexapod_, legs_at(position_of(state_.body), state_.view.R_BE));
      actuators_.emplace(p.actuators, hexapod_.force_limit, p.step, solver.leg_forces(rest_wrench_));
    }
    sense();
  }

  SampledPlant(const SampledPlant&) = delete;  // its encoders refer to its legs
  SampledPlant& operator=(const SampledPlant&) = delete;

  const Observation& observe() const noexcept { return seen_; }

  /// Takes the wrench in B that the law asks for [N; N m], or G where it does not see the image, to the actuators.
  void command(const Vector6<S>& wrench, const Vector6<S>& fuzzy_output) noexcept {
    wrench_ = select(seen_.ready, wrench, rest_wrench_);
    const LegsSideBySide<S> legs = inverse_kinematics(leg_geometry_, position_of(state_.body), state_.view.R_BE);
    const WrenchMapSolver<S> solver(leg_geometry_, legs);
    if (actuators_) {
      // The controller turns its wrench into leg forces with the legs that its sensors show.
      const Vector6<S> asked_forces =
          encoders_ ? WrenchMapSolver<S>(hexapod_, legs_at(seen_.pose.position, seen_.R_BE)).leg_forces(wrench_)
                    : solver.leg_forces(wrench_);
      const Actuation<S> actuation =
          actuators_->step(wrench_, asked_forces, legs_at(position_of(state_.body), state_.view.R_BE));
      wrench_ = actuation.wrench;
      leg_forces_ = actuation.leg_forces;
      saturated_ = actuation.saturated;
    } else {
      leg_forces_ = solver.leg_forces(wrench_);
    }
    record_.accept(time(), state_, legs.lengths.vector(), solver.failed(), wrench_, leg_forces_,
                   select(seen_.ready, fuzzy_output, Vector6<S>(Vector6<S>::Zero())), unsensed_);
  }

  /// To the next tick, in `substeps` Runge-Kutta steps.
  /// @return lanes that go on; the others stay as they are
  Mask<S> advance() noexcept {
    const double h = period_ / static_cast<double>(substeps_);
    WorldState<S, N> next = state_;
    S nearest = -S(std::numeric_limits<double>::infinity());
    for (long long step = 0; step < substeps_; ++step) {
      const WorldState<S, N> start = next;
      const double start_time = static_cast<double>(ticks_) * period_ + static_cast<double>(step) * h;
      const auto rate_at = [&](double later, const WorldState<S, N>& state) {
        WorldRate<S, N> rate;
        world_.rate(state, acting_wrench(start_time + later, state), rate);
        return rate;
      };
      runge_kutta_step(
          h, rate_at(0.0, start),
          [&](double scale, const WorldRate<S, N>& rate) {
            return rate_at(scale, world_.moved(start, S(scale), rate));
          },
          [&](const std::array<const WorldRate<S, N>*, 4>& rates) {
            next = world_.after(start, h, rates);
            nearest = max(nearest, nearest_depth(next, rates));
          });
    }
    ++ticks_;
    record_.judge(next, nearest);
    replace(state_, next, record_.running());
    sense();
    return record_.running();
  }

  double time() const noexcept { return static_cast<double>(ticks_) * period_; }
  long long ticks() const noexcept { return ticks_; }
  const LoopRecord<S, N>& record() const noexcept { return record_; }
  /// Lanes whose newest command is beyond what the actuators give: integral action has to wait there.
  const Mask<S>& saturated() const noexcept { return saturated_; }

 private:
  /// Whether actuators do anything but hold the wrench, in any lane.
  static bool acts(const ActuatorParameters<S>& p) noexcept {
    return p.hold == ActuatorHold::leg_forces || p.saturation || p.delay > 0 || any(p.quantisation > S(0.0)) ||
           any(p.bandwidth < S(std::numeric_limits<double>::infinity()));
  }

  Legs<S> legs_at(const Vector3<S>& position, const Matrix3<S>& R_BE) const noexcept {
    return inverse_kinematics(hexapod_, position, R_BE);
  }

  /// What acts on the platform in a state on the way to the next tick, in B [N; N m].
  Vector6<S> acting_wrench(double time, const WorldState<S, N>& state) const noexcept {
    Vector6<S> wrench = wrench_;
    if (holds_leg_forces_) wrench = legs_at(position_of(state.body), state.view.R_BE).wrench(leg_forces_);
    if (base_moves_) wrench += world_.inertial_wrench(base_.acceleration(time));
    return wrench;
  }

  void sense() noexcept {
    seen_.pose = {position_of(state_.body), quaternion_of(state_.body)};
    seen_.R_BE = state_.view.R_BE;
    seen_.twist = twist_of(state_.body);
    if (encoders_) {
      encoders_->observe(ticks_, seen_.pose, seen_.twist);
      seen_.pose = encoders_->pose();
      seen_.R_BE = rotation_matrix(seen_.pose.quaternion);
      seen_.twist = encoders_->twist();
      unsensed_ = encoders_->failed();
    }
    if (frames_.exposes(ticks_))
      frames_.expose(ticks_, measured_image(state_.view.image, depth_error_), seen_.pose, seen_.R_BE);
    frames_.deliver(ticks_);
    seen_.image = frames_.image(seen_.pose, seen_.R_BE);
    seen_.newest = frames_.newest();
    seen_.ready = frames_.ready(ticks_);
    if (stops_where_lost_) record_.stop(StopCause::feature_lost, frames_.lost());
  }

  double period_;
  long long substeps_;
  Vector<S, N> depth_error_;
  Vector6<S> rest_wrench_;
  bool stops_where_lost_;
  World<S, N> world_;
  WorldState<S, N> state_;
  Hexapod<S> hexapod_;
  LegGeometry<S> leg_geometry_;
  bool holds_leg_forces_, base_moves_;
  BaseMotion<S> base_;
  std::optional<Encoders<S>> encoders_;    ///< where they are the pose's source
  std::optional<Actuators<S>> actuators_;  ///< where they do anything
  Frames<S, N> frames_;
  LoopRecord<S, N> record_;
  Observation seen_;
  Mask<S> unsensed_;       ///< where the leg lengths belong to no pose
  Mask<S> saturated_;      ///< where the newest command is beyond the actuators
  Vector6<S> wrench_;      ///< what acts at the tick
  Vector6<S> leg_forces_;  ///< the same in the legs [N]
  long long ticks_ = 0;
};

/// A law on a sampled plant: at every tick it sees, commands, and advances its state by forward Euler.
template <class S, class Law, int N = kPoints>
class SampledLoop {
 public:
  using Parameters = LoopParameters<S, Law, N>;
  using LawState = typename Law::template State<S>;

  /// @param parameters shared, not copied: they must outlive the loop
  explicit SampledLoop(const Parameters& parameters)
      : task_(control_task(parameters)),
        law_(parameters.gains),
        law_state_(Law::initial_state(parameters.gains)),
        period_(parameters.step),
        plant_(parameters) {
    act();
  }

  /// One servo tick; lanes that have stopped stay as they are.
  void advance() noexcept {
    const Mask<S> acting = plant_.observe().ready & !plant_.saturated();
    const Mask<S> running = plant_.advance();
    Law::advance(law_, law_state_, std::array<const LawRate*, 1>{&now_.rate}, std::array{S(period_)}, acting & running);
    act();
  }

  /// Time that was last asked for [s]; lanes that have stopped are behind it.
  double time() const noexcept { return plant_.time(); }
  long long steps() const noexcept { return plant_.ticks(); }
  const LoopRecord<S, N>& record() const noexcept { return plant_.record(); }
  const LawState& law_state() const noexcept { return law_state_; }

 private:
  using LawRate = typename Law::template Rate<S>;

  void act() noexcept {
    const auto& seen = plant_.observe();
    const Vector<S, N> inverse_depth = seen.image.depth.cwiseInverse();
    Law::evaluate(task_, law_, typename Law::template Stage<S>{&law_state_},
                  LawInput<S, N>{seen.image.features, inverse_depth, seen.R_BE, seen.twist, seen.pose}, now_);
    plant_.command(now_.wrench, now_.fuzzy_output);
  }

  ControlTask<S, N> task_;
  typename Law::template Constants<S> law_;
  LawState law_state_;
  double period_;
  SampledPlant<S, N> plant_;
  typename Law::template Evaluation<S> now_;
};

}  // namespace hexservo
