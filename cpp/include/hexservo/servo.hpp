/// @file
/// The controller of the sampled loop, all of it: sensors, law, safe output, adaptation (docs/model.md, section 7).
/// Simulation, `hs.Controller` and a robot's program run this code; controller.hpp is its face for programs.
#pragma once

#include "hexservo/loop_parameters.hpp"
#include "hexservo/motion_command.hpp"
#include "hexservo/target_tracking.hpp"

#include <array>

namespace hexservo {

/// What the controller of one robot needs; const and shared.
template <class S, class Law, int N = kPoints>
struct ServoGains : SafetyGains<S, N> {
  ControlTask<S, N> task;
  typename Law::template Constants<S, N> law;
  typename Law::template State<S> initial_law_state;
  [[no_unique_address]] TrackingPlanOf<S, Law, N> tracking{};
};

/// What changes from tick to tick.
template <class S, class Law, int N = kPoints>
struct ServoState : SafetyState<S, N> {
  explicit ServoState(const ServoGains<S, Law, N>& gains,
                      std::pmr::memory_resource* memory = std::pmr::get_default_resource())
      : SafetyState<S, N>(gains, memory), law(gains.initial_law_state), tracking(gains.tracking, memory) {}

  typename Law::template State<S> law;
  [[no_unique_address]] TrackingStateOf<S, Law> tracking;

  /// Calls `f` with each member, always in the same order.
  template <class F>
  void for_each_member(F&& f) {
    SafetyState<S, N>::for_each_member(f);
    f(law);
    tracking.for_each_member(f);
  }
};

/// One tick: what the law gives, and what is commanded.
template <class S, class Law>
struct ServoTick {
  typename Law::template Evaluation<S> law;
  Command<S> command;
};

/// How the law of a scenario moves a platform that takes positions.
template <class S, class Law, int N>
MotionGains<S> motion_gains(const LoopParameters<S, Law, N>& p) {
  MotionGains<S> motion;
  motion.acts = p.mode == LoopMode::sampled && takes_positions(p.actuators.kind);
  if constexpr (!Law::traits.viscosity.empty()) {
    motion.massless = true;
    motion.viscosity = Law::viscosity(p.gains);
  }
  motion.damping = p.virtual_damping;
  motion.speed_limit = p.actuators.position.speed_limit;
  motion.acceleration_limit = p.actuators.position.acceleration_limit;
  return motion;
}

/// What decides on a command for a scenario, estimates only.
template <class S, int N>
SafetyGains<S, N> safety_gains(const SceneParameters<S, N>& p, const MotionGains<S>& motion) {
  return {{p.hexapod, LegGeometry<S>(p.hexapod), p.assumed_camera, Lens<S>(p.assumed_lens), p.assumed_desired, p.frames,
           p.pose_source, p.encoders, p.step, p.points, PointWeights<S, N>(p.weights)},
          p.body,
          p.safe,
          p.actuators.saturation ? p.hexapod.force_limit : S(std::numeric_limits<double>::infinity()),
          motion};
}

/// The controller of a scenario.
template <class S, class Law, int N>
ServoGains<S, Law, N> servo_gains(const LoopParameters<S, Law, N>& p) {
  ServoGains<S, Law, N> gains{safety_gains<S, N>(p, motion_gains(p)),
                              control_task<S, N>(p),
                              typename Law::template Constants<S, N>(p.gains),
                              Law::initial_state(p.gains),
                              {}};
  if constexpr (kTracks<Law>) gains.tracking = tracking_plan(p, gains.task);
  return gains;
}

/// Takes over what the sensors gave, evaluates the law, and decides on a command.
template <class S, class Law, int N>
void evaluate(const ServoGains<S, Law, N>& gains, ServoState<S, Law, N>& state, const SensorInput<S, N>& input,
              ServoTick<S, Law>& tick) noexcept {
  state.perception.update(gains, input);
  if constexpr (kTracks<Law>) {
    track(gains, gains.task, gains.tracking, input, state, state.tracking, tick.command);
    tick.law.wrench = tick.command.wrench;
    return;
  }
  if (gains.motion.acts) [[unlikely]]
    see_from_command(gains, state);
  const Perceived<S, N>& seen = gains.motion.acts ? state.carried : state.perception.now();
  const Vector<S, N> inverse_depth = seen.image.depth.cwiseInverse();
  // Any number may go through this; what comes of unusable ones is not taken over.
  Law::evaluate(gains.task, gains.law, typename Law::template Stage<S>{&state.law},
                LawInput<S, N>{seen.image.features, inverse_depth, seen.R_BE, seen.twist, seen.pose}, tick.law);
  if (gains.motion.acts) [[unlikely]]
    command_motion(gains, state, tick.law.wrench, tick.command);
  else
    decide(gains, state, tick.law.wrench, tick.command);
  if (!all(tick.command.acts))
    tick.law.fuzzy_output = select(tick.command.acts, tick.law.fuzzy_output, Vector6<S>(Vector6<S>::Zero()));
}

inline constexpr double kLargestStrength = 1e280;  ///< of an adaptation that is taken over

/// Advances the law's memory over a period by forward Euler, (22); it waits where the law does not act, and where its
/// command is more than the legs can give or follow.
/// @param where lanes to advance
template <class S, class Law, int N>
void adapt(const ServoGains<S, Law, N>& gains, ServoState<S, Law, N>& state, const ServoTick<S, Law>& tick,
           const Mask<S>& where) noexcept {
  Mask<S> learns = where & tick.command.acts & (!tick.command.saturated);
  if constexpr (requires { gains.law.systems.enabled; }) {  // weights stay finite, however extreme a gain is
    if (!gains.law.systems.enabled) return;
    const Vector6<S> strength = tick.law.rate.strength.vector();
    learns = learns & is_finite(S(strength.sum())) & (largest_abs(strength) <= S(kLargestStrength));
  }
  Law::advance(gains.law, state.law, std::array<const typename Law::template Rate<S>*, 1>{&tick.law.rate},
               std::array{S(gains.period)}, learns);
}

}  // namespace hexservo
