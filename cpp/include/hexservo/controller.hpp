/// @file
/// The servo tick: what a robot's control computer calls at every period (docs/model.md, section 7).
///
/// `step` is all of the controller of the sampled loop: frames with their times of exposure, prediction between them,
/// lost points and old images, the pose of the joint sensors, the law with its fuzzy systems and their adaptation, the
/// switching term, leg forces, and a safe output wherever the law may not act. Simulation and Python run the same code
/// (servo.hpp). Fixed size, no heap, no exceptions, bounded time; gains are const and shared, the state is a value,
/// input and output are plain structs.
#pragma once

#include "hexservo/servo.hpp"
#include "hexservo/settings.hpp"

#include <span>
#include <vector>

namespace hexservo {

/// What the controller of one robot needs, prepared and validated by `controller_gains`.
/// @tparam N places for points, one of `kPlaces`: four points that count 1 each have the smaller controller, and
/// all other targets the larger one (`Target::places`)
template <class Law, int N = kPoints>
using ControllerGains = ServoGains<double, Law, N>;

/// What changes from tick to tick: the law's weights, poses and images that are kept, the pose at which it brakes.
template <class Law, int N = kPoints>
using ControllerState = ServoState<double, Law, N>;

/// A frame of the camera.
template <int N>
struct CameraFrameOf {
  /// When it was exposed, by the clock of `ControllerInput::now` [s]; NaN: no frame arrived since the last tick. Of two
  /// frames the one that was exposed later counts, whichever arrives first. Where `camera.latency_known` is false: when
  /// it arrived, or any other time that lies the same unknown time after its exposure.
  double exposure = kUnknown;
  /// Measured pixels of the points as the scenario's camera counts them, NaN for a point that the frame does not show,
  /// and depths Z-hat at the exposure, negative in front of the camera [m]. The tick rectifies them. Places behind the
  /// target's points are not looked at.
  Image<double, N> image = {Vector<double, 2 * N>::Constant(kUnknown), Vector<double, N>::Constant(kUnknown)};
};
using CameraFrame = CameraFrameOf<kPoints>;

/// What the sensors give at a tick; a number that is not known is NaN.
template <int N>
struct ControllerInputOf {
  double now = 0.0;  ///< time of the tick, by a clock that never goes back and started within days [s]
  CameraFrameOf<N> frame;
  /// Where `sensors.pose` is true: pose from the leg lengths, in B; the quaternion need not be of unit length.
  Pose<double> pose = {Vector3<double>::Constant(kUnknown), Vector4<double>::Constant(kUnknown)};
  Vector6<double> twist = Vector6<double>::Constant(kUnknown);  ///< [m/s; rad/s]
  /// Where `sensors.pose` is `encoders`: lengths of the legs [m], or nothing at a tick without a reading; and their
  /// rates [m/s] where `sensors.rate` is true, otherwise differences of the lengths are taken.
  LegReading<double> joints;
};
using ControllerInput = ControllerInputOf<kPoints>;

/// An input of sensors without delay: image, pose and twist are those of the tick.
template <int N>
ControllerInputOf<N> input_of(double now, const Measurement<double, N>& seen) {
  return {now, {now, seen.image}, seen.pose, seen.twist, {}};
}
inline ControllerInput input_of(double now, const Measurement<double>& seen) { return input_of<kPoints>(now, seen); }

/// Whether the law acts at a tick, and if not, why; the first that applies.
enum class InputStatus {
  valid,
  unusable,       ///< a number is not finite or beyond its limit, the clock went back, or what follows is not finite
  missing_image,  ///< a point has never been seen
  stale_image,    ///< a point was not seen for longer than `camera.timeout`
  lost_feature    ///< the newest frame does not show every point, and `camera.on_lost` is `stop`
};

/// What a tick gives back.
struct ControllerOutput {
  Vector6<double> wrench;        ///< tau, about E's origin, in B [N; N m]
  Vector6<double> leg_forces;    ///< f_c with H f_c = tau, positive where they push [N]
  Vector6<double> fuzzy_output;  ///< tau_f [N; N m]
  /// Unless it is `valid`, the wrench brakes and holds the platform (safe_output.hpp), the fuzzy output is zero and
  /// nothing is learned.
  InputStatus status;
  bool
      saturated;  ///< a leg force is beyond `robot.force_limit` where `actuators.saturation` is set: nothing is learned
  /// Where `actuators.kind` is `position`: q*, what each leg shall go to, lengths [m] or angles of cranks [rad]; NaN
  /// before the joints have been known once, and for machines that take forces. Wrench and leg forces are then what the
  /// estimated platform needs to move so, and `saturated` is set where the legs cannot move as the law would.
  Vector6<double> leg_positions;
  /// Where `camera.latency_known` is false: what the latency was found to be, and the shortest and the longest that it
  /// may be [s]; NaN where frames carry their exposure.
  LatencyRange<double> latency = {kUnknown, kUnknown, kUnknown};

  bool invalid_input() const noexcept { return status != InputStatus::valid; }
};

inline constexpr double kMaxServoPeriod = 1.0;  ///< longest time between two ticks [s]

/// Prepares the controller of a scenario: estimates only, no plant. Of `settings.uncertainty` it takes over what
/// the controller itself assumes wrongly: focal length, principal point, mount, depth where the law has a model of the
/// target's points, and the latency of `sampled` mode. For a real machine these are 0, unless its estimates are known
/// to be wrong by so much.
///
/// A scenario in `sampled` mode brings its camera, its joint sensors and the limits of its actuators; one in
/// `continuous` mode has a frame and a pose at every tick.
/// @param period T_c, time between two ticks [s]; the camera's times have to be whole numbers of it
/// @throws std::invalid_argument as `loop_parameters`, or for a period that is not within 0 and `kMaxServoPeriod`
template <class Law, int N = kPoints>
ControllerGains<Law, N> controller_gains(const Settings& settings, double period);
/// The same with the scenario's own period.
template <class Law, int N = kPoints>
ControllerGains<Law, N> controller_gains(const Settings& settings) {
  return controller_gains<Law, N>(settings, settings.simulation.step);
}

/// State before the first tick; takes the memory that the ticks need.
/// @param memory where the poses are kept that belong to frames under way; a copy of the state has the default one
/// @throws what `memory` throws where there is too little
template <class Law, int N>
ControllerState<Law, N> initial_state(const ControllerGains<Law, N>& gains,
                                      std::pmr::memory_resource* memory = std::pmr::get_default_resource()) {
  return ControllerState<Law, N>(gains, memory);
}

/// One tick of (14), (15) with (13); the weights then advance by forward Euler over the period, (22).
///
/// Inputs that are not finite, features or twist beyond the limits at which a run counts as diverged
/// (`kMaxFeatureError`, `kMaxTwist`), a quaternion without a length, a pose farther from the one before than a leg is
/// long, leg lengths that belong to no pose near that, a point that is not in front of the camera, a frame from the
/// future, a singular pose, or forces that overflow make the output safe: see `ControllerOutput::status`.
template <class Law, int N>
ControllerOutput step(const ControllerGains<Law, N>& gains, ControllerState<Law, N>& state,
                      const std::type_identity_t<ControllerInputOf<N>>& input) noexcept;

/// All numbers of a state, to store it: its size depends on law and camera alone.
template <class Law, int N>
std::vector<double> stored(ControllerState<Law, N> state);

/// Continues from a state that was stored by a controller of the same scenario and period.
/// @param state of the same gains; unchanged where this throws
/// @throws std::invalid_argument for another number of numbers than `stored` gives, or one that no state has
template <class Law, int N>
void restore(ControllerState<Law, N>& state, std::span<const double> numbers);

#define HEXSERVO_OF(Law, N)                                                                                     \
  extern template ControllerGains<Law, (N)> controller_gains<Law, (N)>(const Settings&, double);                \
  extern template std::vector<double> stored<Law, (N)>(ControllerState<Law, (N)>);                              \
  extern template void restore<Law, (N)>(ControllerState<Law, (N)>&, std::span<const double>);                  \
  extern template ControllerOutput step<Law, (N)>(const ControllerGains<Law, (N)>&, ControllerState<Law, (N)>&, \
                                                  const ControllerInputOf<(N)>&) noexcept;
#define HEXSERVO_ELSEWHERE(Law) HEXSERVO_OF(Law, kPoints) HEXSERVO_OF(Law, kMostPoints)
HEXSERVO_FOR_EACH_LAW(HEXSERVO_ELSEWHERE)
#undef HEXSERVO_ELSEWHERE
#undef HEXSERVO_OF

}  // namespace hexservo
