/// @file
/// Actuators of the sampled loop that take forces: from the wrench that the law commands at a tick to what acts on the
/// platform until the next one (docs/model.md, section 7).
///
///     f = H^-1 tau          leg forces, H at the controller's pose
///     f <- nearest multiple of the quantisation, then clip(f, -limit, limit)
///     f <- the f of `delay` ticks before; before the first one the forces that hold the platform at rest, clipped too
///     f <- mean over the tick of the output of a first-order lag: y-dot = 2 pi bandwidth (f - y)
///     hold wrench: H f with H at the tick acts until the next tick; hold leg forces: f acts, through H as it changes
///
/// The lag is exact for forces that hold over a tick, and so is the impulse of its mean; an infinite bandwidth leaves
/// f as it is.
#pragma once

#include "hexservo/elementary.hpp"
#include "hexservo/hexapod.hpp"

#include <array>

namespace hexservo {

/// What the drives of the legs take.
enum class ActuatorKind {
  force,           ///< the force of each leg
  position,        ///< where each leg shall go: it gets there whatever it takes (position_actuators.hpp)
  position_torque  ///< the same, by a motor of limited torque with friction (motors.hpp)
};

inline constexpr bool takes_positions(ActuatorKind kind) noexcept { return kind != ActuatorKind::force; }

/// What stays the same between two ticks.
enum class ActuatorHold {
  wrench,     ///< tau, in B
  leg_forces  ///< f_c, while the legs turn
};

inline constexpr int kMaxActuatorDelay = 8;  ///< largest delay [ticks]

/// What the actuators of all legs make of a command. The defaults do nothing.
template <class S>
struct ActuatorResponse {
  ActuatorKind kind = ActuatorKind::force;               ///< what the drives take
  ActuatorHold hold = ActuatorHold::wrench;              ///< what stays the same between two ticks
  bool saturation = false;                               ///< whether leg forces are limited to +-force_limit
  S bandwidth{std::numeric_limits<double>::infinity()};  ///< of the first-order lag, > 0 [Hz], infinity (none)
  S quantisation{0.0};                                   ///< leg forces are multiples of it [N], 0 (none)

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"kind"}.of_pack().in_sampled_mode(), self.kind...);
    v(Field{"hold"}.of_pack().of_plant().in_sampled_mode(), self.hold...);
    v(Field{"saturation"}.of_pack().in_sampled_mode(), self.saturation...);
    v(Field{"bandwidth", "Hz", kPositiveOrNone}.in_sampled_mode(), self.bandwidth...);
    v(Field{"quantisation", "N", kNotNegative}.of_plant().in_sampled_mode(), self.quantisation...);
  }
};

/// How a leg whose drive takes positions follows its command.
template <class S>
struct PositionResponse {
  S bandwidth{20.0};                                       ///< w/(2 pi), undamped natural frequency of a leg [Hz], 20
  S damping{1.0};                                          ///< zeta [1], 1
  S speed_limit{std::numeric_limits<double>::infinity()};  ///< v_max [m/s], infinity (none)
  S acceleration_limit{std::numeric_limits<double>::infinity()};  ///< a_max [m/s^2], infinity (none)

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"bandwidth", "Hz", kPositive}.in_sampled_mode(), self.bandwidth...);
    v(Field{"damping", "1", kPositive}.in_sampled_mode(), self.damping...);
    v(Field{"speed_limit", "m/s", kPositiveOrNone}.in_sampled_mode(), self.speed_limit...);
    v(Field{"acceleration_limit", "m/s^2", kPositiveOrNone}.in_sampled_mode(), self.acceleration_limit...);
  }
};

/// A motor at each leg that holds a position by its torque, which is limited by `robot.force_limit`.
template <class S>
struct MotorParameters {
  S kp{1000.0};         ///< torque over the error of position [N/m], 1000
  S kv{10.0};           ///< torque over the rate, against it, within the limit [N s/m], 10
  S damping{0.0};       ///< viscous friction of the leg, beside the motor [N s/m], 0
  S friction{0.0};      ///< dry friction of the leg [N], 0
  S armature{0.0};      ///< inertia of motor, gear and crank, seen at the leg [kg], 0
  S quantisation{0.0};  ///< commanded positions are multiples of it [m], 0 (none)

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"kp", "N/m", kPositive}.of_plant().in_sampled_mode(), self.kp...);
    v(Field{"kv", "N s/m", kNotNegative}.of_plant().in_sampled_mode(), self.kv...);
    v(Field{"damping", "N s/m", kNotNegative}.of_plant().in_sampled_mode(), self.damping...);
    v(Field{"friction", "N", kNotNegative}.of_plant().in_sampled_mode(), self.friction...);
    v(Field{"armature", "kg", kNotNegative}.of_plant().in_sampled_mode(), self.armature...);
    v(Field{"quantisation", "m", kNotNegative}.of_plant().in_sampled_mode(), self.quantisation...);
  }
};

/// In which steps a leg whose drive takes positions moves in a Runge-Kutta step of the loop (`leg_steps`).
template <class S>
struct LegSteps {
  S number{1.0};                          ///< of the parts that a leg near its limits takes
  Vector4<S> whole = Vector4<S>::Zero();  ///< `leg_transition` of the loop's step
  Vector4<S> part = Vector4<S>::Zero();   ///< the same of a part of it

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"number"}, self.number...);
    v(Field{"whole"}, self.whole...);
    v(Field{"part"}, self.part...);
  }
};

/// The same with their delay.
template <class S>
struct ActuatorParameters : ActuatorResponse<S> {
  long long delay = 0;  ///< [ticks], 0 to `kMaxActuatorDelay`, 0
  PositionResponse<S> position{};
  MotorParameters<S> motor{};
  LegSteps<S> leg_steps{};  ///< where drives take positions

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    ActuatorResponse<S>::visit(v, self...);
    v(Field{"delay"}, self.delay...);
    v(Field{"position"}, self.position...);
    v(Field{"motor"}, self.motor...);
    v(Field{"leg_steps"}, self.leg_steps...);
  }
};

/// Commands on their way to the legs, tick by tick.
template <class S>
class DelayLine {
 public:
  /// @param delay [ticks]; @param first what arrives before the first command
  DelayLine(long long delay, const Vector6<S>& first) noexcept : delay_(static_cast<std::size_t>(delay)) {
    commands_.fill(first);
  }

  /// A tick: takes a command, and gives the one that arrives.
  const Vector6<S>& pass(const Vector6<S>& command) noexcept {
    commands_[next_] = command;
    next_ = next_ == delay_ ? 0 : next_ + 1;
    return commands_[next_];  // the oldest: with no delay the one just written
  }

 private:
  std::size_t delay_;
  std::array<Vector6<S>, kMaxActuatorDelay + 1> commands_;
  std::size_t next_ = 0;
};

/// What acts from a tick to the next.
template <class S>
struct Actuation {
  Vector6<S> leg_forces;  ///< f_c, mean over the tick [N]
  Vector6<S> wrench;      ///< H f_c with H at the tick, in B [N; N m]
  Mask<S> saturated;      ///< where a commanded force of this tick, not yet delayed, is beyond the limit
  Mask<S> untouched;      ///< where the wrench is as commanded
};

/// The actuators with what they remember.
template <class S>
class Actuators {
 public:
  /// @param force_limit of each leg, each way [N]; without saturation not used
  /// @param tick time between two ticks [s]
  /// @param resting_forces what acts before the first command arrives [N]
  Actuators(const ActuatorParameters<S>& parameters, const S& force_limit, double tick,
            const Vector6<S>& resting_forces) noexcept
      : p_(parameters),
        limit_(parameters.saturation ? force_limit : S(std::numeric_limits<double>::infinity())),
        unchanged_((parameters.quantisation <= S(0.0)) &
                   (parameters.bandwidth == S(std::numeric_limits<double>::infinity()))),
        filtered_(clipped(resting_forces)),
        commands_(parameters.delay, filtered_) {
    const S ticks = S(6.283185307179586 * tick) * p_.bandwidth;  // over the time constant
    const S reached = -expm1_of_negative(max(S(-ticks), S(-700.0)));
    remaining_ = S(1.0) - reached;
    mean_remaining_ = reached / ticks;
  }

  /// One tick.
  /// @param wrench as commanded, in B [N; N m]
  /// @param leg_forces H^-1 wrench with H at the controller's pose [N]
  /// @param legs at the true pose of the tick
  Actuation<S> step(const Vector6<S>& wrench, const Vector6<S>& leg_forces, const Legs<S>& legs) noexcept {
    using std::abs;
    Actuation<S> out;
    Vector6<S> command;
    out.saturated = Mask<S>(false);
    for (int i = 0; i < 6; ++i) {
      out.saturated = out.saturated | (abs(leg_forces(i)) > limit_);
      command(i) = clip(quantise(leg_forces(i), p_.quantisation), S(-limit_), limit_);
    }
    const Vector6<S>& arrived = commands_.pass(command);

    for (int i = 0; i < 6; ++i) {
      const S missing = filtered_(i) - arrived(i);
      out.leg_forces(i) = clip(S(arrived(i) + mean_remaining_ * missing), S(-limit_), limit_);
      filtered_(i) = arrived(i) + remaining_ * missing;
    }
    out.wrench = legs.wrench(out.leg_forces);
    // Where nothing has changed the wrench, it takes no detour through the legs.
    const bool delayed = p_.delay > 0 || p_.hold == ActuatorHold::leg_forces;
    out.untouched = unchanged_ & !out.saturated & Mask<S>(!delayed);
    out.wrench = select(out.untouched, wrench, out.wrench);
    return out;
  }

 private:
  Vector6<S> clipped(Vector6<S> forces) const noexcept {
    for (int i = 0; i < 6; ++i) forces(i) = clip(forces(i), S(-limit_), limit_);
    return forces;
  }

  ActuatorParameters<S> p_;
  S limit_;            ///< [N]
  Mask<S> unchanged_;  ///< where neither quantisation nor lag act
  S remaining_;        ///< share of a difference that the lag leaves after a tick [1]
  S mean_remaining_;   ///< the same, mean over the tick [1]
  Vector6<S> filtered_;
  DelayLine<S> commands_;
};

}  // namespace hexservo
