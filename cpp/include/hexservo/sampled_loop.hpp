/// @file
/// The closed loop as it would be built: a camera with a period and a latency, joint sensors, a servo that ticks,
/// actuators that hold between two ticks, a base and a target that may move (docs/model.md, section 7).
///
/// `SampledPlant` is everything but the controller: `sense` shows what its sensors give at a tick, `command` takes what
/// the controller commands, `advance` goes on to the next tick. `SampledLoop<S, Law>` joins it to the controller
/// (servo.hpp) and has the face of `ClosedLoop`; `CommandedPlant` takes a wrench in place of a law's.
#pragma once

#include "hexservo/loop_record.hpp"
#include "hexservo/motors.hpp"
#include "hexservo/servo.hpp"

#include <optional>

namespace hexservo {

/// Newton rounds that a platform follows its legs in, within a Runge-Kutta step: four find a pose 0.1 r_p and 0.1 rad
/// away.
inline constexpr int kFollowingRounds = 4;

/// Plant, sensors and actuators on the grid of the servo's ticks.
template <class S, int N = kPoints>
class SampledPlant {
 public:
  explicit SampledPlant(const SceneParameters<S, N>& p)
      : period_(p.step),
        substeps_(p.substeps),
        depth_error_(p.depth_error),
        stops_where_lost_(p.frames.on_lost == LostFeature::stop),
        base_(base_motion(p)),
        target_(p.points_T, p.target_frame, p.target_motion, p.recorded_target),
        base_moves_(base_.moves()),
        target_moves_(target_.moves(base_)),
        world_(p),
        state_(start(p)),
        leg_geometry_(p.hexapod),
        holds_leg_forces_(p.actuators.hold == ActuatorHold::leg_forces),
        frames_(p.frames, p.seed, Lens<S>(p.lens)),
        record_(p, state_) {
    sensed_.frame.image = state_.view.image;  // of no consequence until a frame arrives
    sensed_.pose = home_pose(p.hexapod);
    sensed_.twist.setZero();
    if (p.pose_source == PoseSource::encoders) encoders_.emplace(p.encoders, p.seed);
    if (p.actuators.kind == ActuatorKind::position_torque) {
      motors_.emplace(p.actuators, p.hexapod, period_ / static_cast<double>(substeps_),
                      legs_at(position_of(state_.body), state_.view.R_BE).lengths);
    } else if (p.actuators.kind == ActuatorKind::position) {
      const Legs<S> legs = legs_at(position_of(state_.body), state_.view.R_BE);
      positioned_.emplace(p.actuators, period_ / static_cast<double>(substeps_), legs.lengths,
                          legs.rates(twist_of(state_.body)));
    } else if (acts(p.actuators)) {
      const WrenchMapSolver<S> solver(leg_geometry_,
                                      inverse_kinematics(leg_geometry_, position_of(state_.body), state_.view.R_BE));
      actuators_.emplace(p.actuators, p.hexapod.force_limit, p.step,
                         solver.leg_forces(gravity_wrench(p.body, state_.view.R_BE)));
    }
    read_sensors();
  }

  /// What the sensors give at this tick.
  const SensorInput<S, N>& sense() const noexcept { return sensed_; }

  /// Takes the controller's command to the actuators.
  /// @param seen what the controller decided it from
  void command(const Command<S>& command, const Perceived<S, N>& seen, const Vector6<S>& fuzzy_output) noexcept {
    wrench_ = command.wrench;
    leg_forces_ = command.leg_forces;
    Vector6<S> lengths = command.lengths.vector();
    Mask<S> singular = command.singular;
    if (encoders_) {  // the controller's pose is not the platform's
      lengths = legs_.lengths.vector();
      singular = Mask<S>(false);
      const bool needed = record_.needs_legs() || actuators_;
      if (needed || any(seen.unsensed)) {  // a singular pose may be why
        const WrenchMapSolver<S> solver(leg_geometry_, legs_);
        singular = solver.failed() & (Mask<S>(needed) | seen.unsensed);
        leg_forces_ = solver.leg_forces(wrench_);
      }
    }
    if (actuators_) {
      const Actuation<S> actuation =
          actuators_->step(wrench_, command.leg_forces, legs_at(position_of(state_.body), state_.view.R_BE));
      wrench_ = actuation.wrench;
      leg_forces_ = select(actuation.untouched, leg_forces_, actuation.leg_forces);
    }
    if (stops_where_lost_) record_.stop(StopCause::feature_lost, seen.lost);
    if (any(command.law_failed)) record_.stop(StopCause::not_finite, command.law_failed);
    record_.accept(time(), state_, lengths, singular, wrench_, leg_forces_, fuzzy_output, seen.unsensed);
  }

  /// Takes the controller's command to legs whose drives take positions. A command is a step: the wrench of the record
  /// is the mean of the tick, leg forces are those just after it.
  /// @param positions q* [m], or [rad]
  [[gnu::noinline, gnu::cold]] void position(const Vector6<S>& positions, const Command<S>& command,
                                             const Perceived<S, N>& seen, const Vector6<S>& fuzzy_output) noexcept {
    if (motors_)
      motors_->command(positions);
    else
      positioned_->command(positions);
    const Vector3<S> p_BE = position_of(state_.body);
    const LegsSideBySide<S> found = inverse_kinematics(leg_geometry_, p_BE, state_.view.R_BE);
    const WrenchMapSolver<S> solver(leg_geometry_, found);
    const Legs<S> legs = Legs<S>::of(found);
    const Vector6<S> twist = twist_of(state_.body);
    const Vector6<S> base = base_wrench(time(), state_.body, state_.view.R_BE);
    if (motors_) {
      leg_forces_ = motors_->torques(legs.lengths, legs.rates(twist));
      const Vector6<S> at_once = motors_->acceleration(state_.body, free_dynamics(time(), state_.body));
      drive_legs();
      const Vector6<S> mean = (twist_of(driven_.body) - twist) / S(period_);
      wrench_ = world_.needed_wrench(state_.body, state_.view.R_BE, select(is_finite(mean), mean, at_once)) - base;
    } else {
      const Vector6<S> bias = leg_bias(leg_geometry_, legs, p_BE, twist);
      const auto needed = [&](const Vector6<S>& leg_accelerations) -> Vector6<S> {
        const Vector6<S> acceleration = solver.twist(leg_accelerations - bias);
        return world_.needed_wrench(state_.body, state_.view.R_BE, acceleration) - base;
      };
      wrench_ = needed(positioned_->mean_accelerations(substeps_, period_));
      leg_forces_ = solver.leg_forces(needed(positioned_->accelerations()));
    }
    if (stops_where_lost_) record_.stop(StopCause::feature_lost, seen.lost);
    if (any(command.law_failed)) record_.stop(StopCause::not_finite, command.law_failed);
    record_.accept(time(), state_, legs.lengths, solver.failed(), wrench_, leg_forces_, fuzzy_output, seen.unsensed);
  }

  /// After the last tick.
  void finish() noexcept {
    if (encoders_ && !actuators_ && !positioned_ && !motors_) record_.finish();
  }

  /// To the next tick, in `substeps` Runge-Kutta steps.
  /// @return lanes that go on; the others stay as they are
  Mask<S> advance() noexcept {
    if (positioned_) [[unlikely]]
      return follow_legs();
    if (motors_) [[unlikely]] {  // `position` has driven them
      end_tick(driven_, nearest_);
      return record_.running();
    }
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
            if (target_moves_) place_target(start_time + scale);
            return rate_at(scale, world_.moved(start, S(scale), rate));
          },
          [&](const std::array<const WorldRate<S, N>*, 4>& rates) {
            if (target_moves_) place_target(start_time + h);
            next = world_.after(start, h, rates);
            nearest = max(nearest, nearest_depth(next, rates));
          });
    }
    end_tick(next, nearest);
    return record_.running();
  }

  double time() const noexcept { return static_cast<double>(ticks_) * period_; }
  long long ticks() const noexcept { return ticks_; }
  const LoopRecord<S, N>& record() const noexcept { return record_; }
  /// The legs' coordinates now [m], or [rad].
  Vector6<S> leg_positions() const noexcept { return legs_at(position_of(state_.body), state_.view.R_BE).lengths; }

 private:
  /// Whether actuators do anything but hold the wrench, in any lane.
  static bool acts(const ActuatorParameters<S>& p) noexcept {
    return p.hold == ActuatorHold::leg_forces || p.saturation || p.delay > 0 || any(p.quantisation > S(0.0)) ||
           any(p.bandwidth < S(std::numeric_limits<double>::infinity()));
  }

  static BaseMotion<S> base_motion(const SceneParameters<S, N>& p) {
    BaseMotion<S> base(p.base_motion, p.seed, p.recorded);
    if (p.target_frame == TargetFrame::world) base.find_place();
    return base;
  }

  WorldState<S, N> start(const SceneParameters<S, N>& p) noexcept {
    if (target_moves_) place_target(0.0);
    return world_.start(p);
  }

  /// To the next tick behind legs that take positions: forward kinematics from the pose before, at a fixed cost.
  [[gnu::noinline, gnu::cold]] Mask<S> follow_legs() noexcept {
    const double h = period_ / static_cast<double>(substeps_);
    WorldState<S, N> next = state_;
    S nearest = -S(std::numeric_limits<double>::infinity());
    Mask<S> followed(true);
    for (long long step = 0; step < substeps_; ++step) {
      positioned_->advance();
      if (target_moves_) place_target(static_cast<double>(ticks_) * period_ + static_cast<double>(step + 1) * h);
      const ForwardKinematics<S> found =
          forward_kinematics(leg_geometry_, positioned_->positions(),
                             Pose<S>{position_of(next.body), quaternion_of(next.body)}, kFollowingRounds);
      followed = followed & found.converged;
      const WrenchMapSolver<S> solver(leg_geometry_, found.legs);
      next = world_.seen_from(BodyMotion<S>::of(body_state<S>(found.pose, solver.twist(positioned_->rates()))));
      nearest = max(nearest, nearest_depth(next.view.image));
    }
    record_.stop(StopCause::solver_failed, !followed);
    end_tick(next, nearest);
    return record_.running();
  }

  /// Moves the platform to the next tick on legs whose motors take positions: to where `advance` goes on.
  void drive_legs() noexcept {
    const double h = period_ / static_cast<double>(substeps_);
    driven_ = state_;
    nearest_ = -S(std::numeric_limits<double>::infinity());
    for (long long step = 0; step < substeps_; ++step) {
      const double start = time() + static_cast<double>(step) * h;
      BodyMotion<S> body = driven_.body;
      motors_->advance(body, [&](double later, const BodyMotion<S>& at) { return free_dynamics(start + later, at); });
      if (target_moves_) place_target(start + h);
      driven_ = world_.seen_from(body);
      nearest_ = max(nearest_, nearest_depth(driven_.view.image));
    }
  }

  /// The platform without its legs.
  BodyDynamics<S> free_dynamics(double time, const BodyMotion<S>& body) const noexcept {
    const Matrix3<S> R_BE = rotation_matrix(quaternion_of(body));
    return {world_.mass_matrix(R_BE),
            base_wrench(time, body, R_BE) - world_.needed_wrench(body, R_BE, Vector6<S>(Vector6<S>::Zero()))};
  }

  /// Takes over the state at the end of a tick, where it is good.
  [[gnu::always_inline]] void end_tick(const WorldState<S, N>& next, const S& nearest) noexcept {
    ++ticks_;
    record_.judge(next, nearest);
    replace(state_, next, record_.running());
    read_sensors();
  }

  [[gnu::noinline]] void place_target(double time) noexcept { world_.place_target(target_.points(time, base_)); }

  Legs<S> legs_at(const Vector3<S>& position, const Matrix3<S>& R_BE) const noexcept {
    return Legs<S>::of(inverse_kinematics(leg_geometry_, position, R_BE));
  }

  /// What acts on the platform in a state on the way to the next tick, in B [N; N m].
  Vector6<S> acting_wrench(double time, const WorldState<S, N>& state) const noexcept {
    Vector6<S> wrench = wrench_;
    if (holds_leg_forces_) wrench = legs_at(position_of(state.body), state.view.R_BE).wrench(leg_forces_);
    if (base_moves_) wrench += base_wrench(time, state.body, state.view.R_BE);
    return wrench;
  }

  /// What the motion of the base adds to it.
  Vector6<S> base_wrench(double time, const BodyMotion<S>& body, const Matrix3<S>& R_BE) const noexcept {
    if (!base_moves_) return Vector6<S>::Zero();
    if (base_.turns()) return world_.moving_base_wrench(body, R_BE, base_.state(time));
    return world_.inertial_wrench(R_BE, base_.acceleration(time));
  }

  void read_sensors() noexcept {
    sensed_.now = static_cast<double>(ticks_);
    if (encoders_) {
      inverse_kinematics(leg_geometry_, position_of(state_.body), state_.view.R_BE, legs_);
      sensed_.joints = encoders_->read(ticks_, legs_, twist_of(state_.body));
    } else {
      sensed_.pose = {position_of(state_.body), quaternion_of(state_.body)};
      sensed_.twist = twist_of(state_.body);
    }
    if (frames_.exposes(ticks_)) frames_.expose(ticks_, measured_image(state_.view.image, depth_error_));
    frames_.deliver(ticks_, sensed_.frame);
  }

  double period_;
  long long substeps_;
  Vector<S, N> depth_error_;
  bool stops_where_lost_;
  BaseMotion<S> base_;
  TargetPlace<S, N> target_;
  bool base_moves_, target_moves_;
  World<S, N> world_;
  WorldState<S, N> state_;
  LegGeometry<S> leg_geometry_;
  bool holds_leg_forces_;
  std::optional<Encoders<S>> encoders_;          ///< where they are the pose's source
  LegsSideBySide<S> legs_;                       ///< where encoders are
  std::optional<Actuators<S>> actuators_;        ///< where they do anything
  std::optional<PositionedLegs<S>> positioned_;  ///< where they take positions
  std::optional<MotorLegs<S>> motors_;           ///< where motors do
  WorldState<S, N> driven_;                      ///< at the next tick, where these have moved the platform
  S nearest_;                                    ///< largest Z_i on the way there [m]
  Frames<S, N> frames_;
  LoopRecord<S, N> record_;
  SensorInput<S, N> sensed_;
  Vector6<S> wrench_;      ///< what acts at the tick
  Vector6<S> leg_forces_;  ///< the same in the legs [N]
  long long ticks_ = 0;
};

/// A sampled plant that is commanded from outside at every tick, with the sensors and the safe output of the
/// controller.
template <class S, int N = kPoints>
class CommandedPlant {
 public:
  template <class Law>
  explicit CommandedPlant(const LoopParameters<S, Law, N>& p)
      : gains_(safety_gains<S, N>(p, motion_gains(p))), state_(gains_), plant_(p) {
    state_.perception.update(gains_, plant_.sense());
  }

  /// Input of a controller at this tick.
  const Perceived<S, N>& observe() const noexcept { return state_.perception.now(); }

  /// Commands a wrench in B [N; N m]; where a controller may not act the safe output takes its place.
  void command(const Vector6<S>& wrench) noexcept {
    Command<S> command;
    decide(gains_, state_, wrench, command);
    plant_.command(command, observe(), Vector6<S>::Zero());
  }

  /// Whether the drives take positions: `position` commands them, and otherwise `command`.
  bool takes_positions() const noexcept { return gains_.motion.acts; }

  /// Commands drives that take positions, as they are: drives hold what they took last, which is the safe output here.
  /// @param positions q* [m], or [rad]
  void position(const Vector6<S>& positions) noexcept {
    Command<S> command{};
    command.law_failed = Mask<S>(false);
    plant_.position(positions, command, observe(), Vector6<S>::Zero());
  }

  /// To the next tick.
  /// @return lanes that go on; the others stay as they are
  Mask<S> advance() noexcept {
    const Mask<S> running = plant_.advance();
    state_.perception.update(gains_, plant_.sense());
    return running;
  }

  const SampledPlant<S, N>& plant() const noexcept { return plant_; }
  const LoopRecord<S, N>& record() const noexcept { return plant_.record(); }

 private:
  SafetyGains<S, N> gains_;
  SafetyState<S, N> state_;
  SampledPlant<S, N> plant_;
};

/// The controller on a sampled plant: at every tick it senses, commands, and advances its state by forward Euler.
template <class S, class Law, int N = kPoints>
class SampledLoop {
 public:
  using Parameters = LoopParameters<S, Law, N>;
  using LawState = typename Law::template State<S>;

  explicit SampledLoop(const Parameters& parameters)
      : gains_(servo_gains(parameters)), state_(gains_), plant_(parameters) {
    act();
  }

  /// One servo tick; lanes that have stopped stay as they are.
  void advance() noexcept {
    const Mask<S> running = plant_.advance();
    adapt(gains_, state_, now_, running);
    act();
  }

  /// After the last tick.
  void finish() noexcept { plant_.finish(); }

  /// Time that was last asked for [s]; lanes that have stopped are behind it.
  double time() const noexcept { return plant_.time(); }
  long long steps() const noexcept { return plant_.ticks(); }
  const LoopRecord<S, N>& record() const noexcept { return plant_.record(); }
  const LawState& law_state() const noexcept { return state_.law; }
  /// What the sensors gave at this tick, what the controller made of it, and what it commanded.
  const SensorInput<S, N>& sensed() const noexcept { return plant_.sense(); }
  const ServoState<S, Law, N>& servo_state() const noexcept { return state_; }
  const ServoTick<S, Law>& tick() const noexcept { return now_; }

 private:
  void act() noexcept {
    evaluate(gains_, state_, plant_.sense(), now_);
    if (gains_.motion.acts) [[unlikely]]
      plant_.position(state_.motion.legs, now_.command, state_.perception.now(), now_.law.fuzzy_output);
    else
      plant_.command(now_.command, state_.perception.now(), now_.law.fuzzy_output);
  }

  ServoGains<S, Law, N> gains_;
  ServoState<S, Law, N> state_;
  SampledPlant<S, N> plant_;
  ServoTick<S, Law> now_;
};

}  // namespace hexservo
