/// @file
/// A scenario as plain numbers, and the one place that turns it into the validated parameters of a loop.
#pragma once

#include "hexservo/closed_loop.hpp"
#include "hexservo/laws/laws.hpp"
#include "hexservo/sampled_loop.hpp"

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

namespace hexservo {

/// Rows of numbers, one after the other, or none.
using Samples = std::shared_ptr<const std::vector<double>>;

/// How the target moves in `sampled` mode.
struct TargetMotionSettings : TargetMotionParameters<double> {
  Samples samples;             ///< recorded displacements of the points from their places, in their frame [m]
  double sample_period = 0.0;  ///< of what is recorded, from t = 0 [s]

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    TargetMotionParameters<double>::visit(v, self...);
    v(Field{"samples", "m"}.of_batch().of_plant().in_sampled_mode(), self.samples...);
    v(Field{"sample_period", "s", kPositiveOrZero}.of_batch().of_plant().in_sampled_mode(), self.sample_period...);
  }
};

/// Points in B or W, one in each row [m].
using PointRows = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::ColMajor, kMostPoints, 3>;

/// Three to sixteen points to look at, given by their image from home or by their positions, and their desired image.
///
/// What there is for each point has as many numbers as points are desired, or one number for all of them where an entry
/// may stand for all: depth, weights.
struct Target {
  TargetFrame frame = TargetFrame::base;  ///< in which the points rest, or move
  OfPoints<double, kAnyPoints, 2> initial_features = for_all_points<double, kAnyPoints, 2>(0.0);  ///< from home [px]
  OfPoints<double, kAnyPoints, 2> desired_features = for_all_points<double, kAnyPoints, 2>(0.0);  ///< xi_d [px]
  OfPoints<double, kAnyPoints> depth = for_all_points<double, kAnyPoints>(0.5);  ///< |Z_i| seen from home [m], 0.5
  /// In place of the initial features and their depth: a point in each row, in B or W [m].
  std::optional<PointRows> points;
  TargetMotionSettings motion;
  /// w_i, what each point counts in the controller's sums over the image [1], 1; as 1/w_i times the variance of its
  /// noise.
  OfPoints<double, kAnyPoints> weights = OfPoints<double, kAnyPoints>::Ones(1);
  bool weighted = false;  ///< prepare for other weights than 1 even where there are none; no key

  /// n, how many there are.
  int count() const { return static_cast<int>(desired_features.size()) / 2; }

  /// Number of points that a loop has to be compiled for, one of `kPlaces`. Four points that count 1 have the
  /// smaller loops.
  int places() const {
    return count() == kPoints && !weighted && (weights.array() == 1.0).all() ? kPoints : kMostPoints;
  }

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"initial_features", "px"}.entrywise().without_points(), self.initial_features...);
    v(Field{"desired_features", "px"}.entrywise(), self.desired_features...);
    v(Field{"depth", "m", kPositive}.without_points(), self.depth...);
    v(Field{"points", "m"}.entrywise(), self.points...);
    v(Field{"weights", "1", kNotNegative}, self.weights...);
    v(Field{"frame"}.of_pack().of_plant().in_sampled_mode(), self.frame...);
    v(Field{"motion"}, self.motion...);
  }
};

/// Errors between estimates and plant, relative but for the mount, docs/model.md, sections 3 and 4.
struct Uncertainty : DynamicsError<double> {
  OfPoints<double, kAnyPoints> depth = for_all_points<double, kAnyPoints>(0.0);  ///< delta_Z,i, or one for all [1], 0
  double focal_length = 0.0;                                                     ///< of the controller's camera [1], 0
  Vector2<double> principal_point = Vector2<double>::Zero();  ///< what that of its camera is off [px], 0
  double latency = 0.0;                                       ///< what the latency that it assumes is off [s], 0
  Mount mount;  ///< what the controller's mount is off: position in E, rotation vector in C, `assumed_mount`

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    DynamicsError<double>::visit(v, self...);
    v(Field{"depth", "1", kRelativeError}, self.depth...);  // the controller's own: what it takes the target for
    v(Field{"focal_length", "1", kRelativeError}.in_sampled_mode(), self.focal_length...);  // and its camera
    v(Field{"principal_point", "px"}.entrywise().in_sampled_mode(), self.principal_point...);
    v(Field{"latency", "s"}.of_pack().in_sampled_mode(), self.latency...);
    v(Field{"mount"}, self.mount...);
  }
};

/// The camera, with its timing in `sampled` mode, where every time is a whole number of servo periods.
struct CameraSettings : Camera, FrameFaults<double> {
  CameraConvention convention = CameraConvention::eye_in_hand;
  double period = 0.0;                                       ///< between two exposures [s]; 0: the servo period
  double latency = 0.0;                                      ///< from exposure to first use [s], 0
  double latency_jitter = 0.0;                               ///< most that the latency of a frame is longer [s], 0
  bool latency_known = true;                                 ///< frames carry their exposure; else their arrival
  double timeout = std::numeric_limits<double>::infinity();  ///< oldest image that is used, by its exposure [s]

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    Camera::visit(v, self...);
    v(Field{"convention"}.of_pack(), self.convention...);
    v(Field{"period", "s", kPositiveOrZero}.of_pack().in_sampled_mode(), self.period...);
    v(Field{"latency", "s", kNotNegative}.of_pack().in_sampled_mode(), self.latency...);
    v(Field{"latency_jitter", "s", kNotNegative}.of_pack().in_sampled_mode(), self.latency_jitter...);
    v(Field{"latency_known"}.of_pack().in_sampled_mode(), self.latency_known...);
    v(Field{"timeout", "s", kPositiveOrNone}.in_sampled_mode(), self.timeout...);
    FrameFaults<double>::visit(v, self...);
  }
};

/// Source of the controller's pose and twist in `sampled` mode.
struct SensorSettings : EncoderReadings<double> {
  PoseSource pose = PoseSource::truth;
  double period = 0.0;  ///< between two readings of the encoders [s]; 0: every servo period

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"pose"}.of_pack().in_sampled_mode(), self.pose...);
    EncoderReadings<double>::visit(v, self...);
    v(Field{"period", "s", kPositiveOrZero}.of_pack().in_sampled_mode(), self.period...);
  }
};

/// The actuators in `sampled` mode.
struct ActuatorSettings : ActuatorResponse<double> {
  double delay = 0.0;  ///< a whole number of servo periods [s], 0
  PositionResponse<double> position;
  MotorParameters<double> motor;

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    ActuatorResponse<double>::visit(v, self...);
    v(Field{"delay", "s", kNotNegative}.of_pack().in_sampled_mode(), self.delay...);
    v(Field{"position"}, self.position...);
    v(Field{"motor"}, self.motor...);
  }
};

/// How the base moves in `sampled` mode.
struct BaseMotionSettings : BaseMotionParameters<double> {
  Samples samples;             ///< recorded a_x, a_y, a_z in W [m/s^2]
  Samples attitudes;           ///< recorded quaternions (w, x, y, z) of B in W, of a base that turns
  double sample_period = 0.0;  ///< of what is recorded, from t = 0 [s]

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    BaseMotionParameters<double>::visit(v, self...);
    v(Field{"samples", "m/s^2"}.of_batch().of_plant().in_sampled_mode(), self.samples...);
    v(Field{"attitudes", "1"}.of_columns(4).of_batch().of_plant().in_sampled_mode(), self.attitudes...);
    v(Field{"sample_period", "s", kPositiveOrZero}.of_batch().of_plant().in_sampled_mode(), self.sample_period...);
  }
};

/// What the controller does in `sampled` mode where its law may not act: it brakes, and holds where it stopped.
struct SafeSettings {
  std::optional<Vector6<double>> damping;  ///< diagonal of K_s [N s/m; N m s/rad]; none: `safe_gains` derives it
  std::optional<Vector6<double>> hold;     ///< diagonal of K_h [N/m; N m/rad]; none: likewise

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"damping", "N s/m; N m s/rad", kNotNegative}.in_sampled_mode(), self.damping...);
    v(Field{"hold", "N/m; N m/rad", kNotNegative}.in_sampled_mode(), self.hold...);
  }
};

/// The platform that a law's wrench moves inside the controller of a machine that takes positions.
struct VirtualPlatformSettings {
  Vector6<double> damping = Vector6<double>::Zero();  ///< diagonal of D_v [N s/m; N m s/rad], 0

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"damping", "N s/m; N m s/rad", kNotNegative}.in_sampled_mode(), self.damping...);
  }
};

/// The control law, and what all laws have in common.
struct ControllerSettings {
  JacobianConvention jacobian = JacobianConvention::consistent;
  Switching<double> switching;
  SafeSettings safe;
  VirtualPlatformSettings virtual_platform;
  LawGains gains;  ///< of the law that acts: they tell which one it is

  /// The gains are a block with the name of their law.
  template <class V, class Self>
  static void visit(V&& v, Self& self) {
    v(Field{"jacobian"}.of_pack(), self.jacobian);
    v(Field{"switching"}, self.switching);
    v(Field{"safe"}, self.safe);
    v(Field{"virtual_platform"}, self.virtual_platform);
    std::visit([&](auto& gains) { v(Field{kLawTraits[self.gains.index()].name}, gains); }, self.gains);
  }
};

/// How a run starts.
struct StartSettings {
  Vector6<double> pose = Vector6<double>::Zero();   ///< displacement from home, as of `moved`, in B [m; rad], 0
  Vector6<double> twist = Vector6<double>::Zero();  ///< in B [m/s; rad/s], 0

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"pose", "m; rad"}.entrywise().of_run(), self.pose...);
    v(Field{"twist", "m/s; rad/s"}.entrywise().of_run(), self.twist...);
  }
};

/// Time grid, start and logging of a run.
struct SimulationSettings {
  LoopMode mode = LoopMode::continuous;
  double step = 1e-3;       ///< h, or in `sampled` mode the servo period T_c [s], 1e-3
  long long substeps = 1;   ///< Runge-Kutta steps in a servo period, in `sampled` mode, 1
  double duration = 5.0;    ///< [s], 5; a whole number of steps
  long long log_every = 1;  ///< steps between logged samples, 1
  StartSettings start;

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"mode"}.of_pack(), self.mode...);
    v(Field{"step", "s", kPositive}.of_pack(), self.step...);
    v(Field{"substeps", "1", {.least = 1.0, .most = 1e6}}.of_pack().of_run().in_sampled_mode(), self.substeps...);
    v(Field{"duration", "s", kPositive}.of_pack().of_run(), self.duration...);
    v(Field{"log_every", "1", {.least = 1.0, .most = 1e9}}.of_pack().of_run(), self.log_every...);
    v(Field{"start"}, self.start...);
  }
};

/// A scenario, block by block as its file has it. All keys of one law: scenario_keys.hpp.
struct Settings {
  std::uint64_t seed = 0;  ///< of everything random
  RobotParameters robot;
  CameraSettings camera;
  SensorSettings sensors;
  ActuatorSettings actuators;
  BaseMotionSettings base_motion;
  Target target;
  Uncertainty uncertainty;
  ControllerSettings controller;
  SimulationSettings simulation;
  MetricsSettings<double> metrics;

  /// The defaults of a law.
  template <class Law>
  static Settings of() {
    Settings settings;
    settings.controller.gains.emplace<GainsOf<Law>>();
    return settings;
  }
  static Settings of(LawId law) {
    return with_law(law, []<class Law>(std::type_identity<Law>) { return of<Law>(); });
  }

  /// The law that acts.
  LawId law() const noexcept { return static_cast<LawId>(controller.gains.index()); }

  /// Gains of the law that acts.
  /// @throws std::bad_variant_access where it is another one
  template <class Law>
  GainsOf<Law>& gains() {
    return std::get<GainsOf<Law>>(controller.gains);
  }
  template <class Law>
  const GainsOf<Law>& gains() const {
    return std::get<GainsOf<Law>>(controller.gains);
  }

  template <class V, class Self>
  static void visit(V&& v, Self& self) {
    v(Field{"seed", "1"}.of_run().in_sampled_mode(), self.seed);
    v(Field{"robot"}, self.robot);
    v(Field{"camera"}, self.camera);
    v(Field{"sensors"}, self.sensors);
    v(Field{"actuators"}, self.actuators);
    v(Field{"base_motion"}, self.base_motion);
    v(Field{"target"}, self.target);
    v(Field{"uncertainty"}, self.uncertainty);
    v(Field{"controller"}, self.controller);
    v(Field{"simulation"}, self.simulation);
    v(Field{"metrics"}, self.metrics);
  }
};

/// The controller's camera: that of the scenario with the errors of `uncertainty`.
Camera assumed_camera(const Settings& settings);

/// Number of steps of a run.
/// @throws std::invalid_argument naming the scenario key where step, duration or log_every make no grid
long long step_count(const SimulationSettings& simulation);

/// The brake of a scenario: what is given, and for the rest a critically damped response of the estimated inertia,
///
///     K_h = w^2 D,  K_s = 2 w D,  w = min(100 rad/s, 0.2/delay)
///
/// with the estimated inertia D, 6x6, and as delay the time between two readings of the joints plus what the actuators
/// are late.
/// @param delay [s]
/// @throws std::invalid_argument for a gain that is negative or not finite
SafeGains<double> safe_gains(const SafeSettings& settings, double delay);

/// Mass properties as the controller assumes them: of the platform, with its payload if that is known.
RigidBody<double> estimated_body(const RobotParameters& robot);

/// What the platform carries, known or not, but for the relative errors of its dynamics.
RigidBody<double> plant_body(const RobotParameters& robot);

/// Fewest Runge-Kutta steps in a servo period with which the steps of the legs follow motors that hold positions.
///
/// The midpoint rule is stable for (kv + damping) a h < 2 and for an oscillation only as long as it is resolved, a
/// being the largest mobility of the legs with their armature.
/// @param pose of the platform
/// @param period of the servo [s]
double motor_substeps(const Plant<double>& plant, const Hexapod<double>& hexapod, const Pose<double>& pose,
                      const MotorParameters<double>& motor, double period);

/// Image of the target from a displacement (m; rad) of home, as of `moved`, 2 n [px]; the goal's image is not used.
/// @throws std::invalid_argument naming the scenario key: robot, camera or target that are wrong, a camera
/// `as_printed`, a displacement that is not finite, or that has a point behind the camera
OfPoints<double, kAnyPoints, 2> project_target(const Settings& settings, const Vector6<double>& displacement);

/// Validates a scenario and prepares it for the loop of its law: joints, target points, initial image.
/// @tparam Law the one that acts
/// @tparam N one of `kPlaces`, which must hold the target: `Target::places`, or `kMostPoints` for any
/// @param legs what `make_hexapod` made of `settings.robot`, where the caller has it: most of the work is there
/// @throws std::invalid_argument("key: expected ..., got ...") for the first thing that is wrong
template <class Law, int N = kPoints>
LoopParameters<double, Law, N> loop_parameters(const Settings& settings, const Hexapod<double>* legs = nullptr);

/// Calls `function` with std::type_identity of a scenario's law and std::integral_constant of its `places`.
template <class F>
decltype(auto) with_loop(const Settings& settings, F&& function) {
  return with_law(settings.law(), [&]<class Law>(std::type_identity<Law> law) -> decltype(auto) {
    return with_places(settings.target.places(), [&](auto places) -> decltype(auto) { return function(law, places); });
  });
}

// One translation unit compiles the loops of each law.
#define HEXSERVO_OF(Law, N)                            \
  extern template class ClosedLoop<double, Law, (N)>;  \
  extern template class SampledLoop<double, Law, (N)>; \
  extern template LoopParameters<double, Law, (N)> loop_parameters<Law, (N)>(const Settings&, const Hexapod<double>*);
#define HEXSERVO_ELSEWHERE(Law) HEXSERVO_OF(Law, kPoints) HEXSERVO_OF(Law, kMostPoints)
HEXSERVO_FOR_EACH_LAW(HEXSERVO_ELSEWHERE)
#undef HEXSERVO_ELSEWHERE
#undef HEXSERVO_OF

/// Whether Eigen fuses products and sums by itself; on 64-bit ARM it does not with `-U__ARM_FEATURE_FMA`.
#if defined(__aarch64__) && defined(__ARM_FEATURE_FMA)
inline constexpr bool kEigenFuses = true;
#else
inline constexpr bool kEigenFuses = false;
#endif

/// Exists in the library for its own memory layout only. Code that is compiled with other flags for the instruction set
/// (-mavx, -march=native), for Eigen (EIGEN_MAX_STATIC_ALIGN_BYTES, EIGEN_DEFAULT_TO_ROW_MAJOR) or for the standard
/// library (_GLIBCXX_DEBUG) lays out settings, gains and state differently, and does not link: give both the same
/// flags. Nor does code that rounds otherwise.
template <int alignment, int static_alignment, int storage_order, std::size_t settings, std::size_t vector, bool fuses>
bool library_was_built_with_other_flags() noexcept;
#define HEXSERVO_LAYOUT                                                                           \
  EIGEN_MAX_ALIGN_BYTES, EIGEN_MAX_STATIC_ALIGN_BYTES, EIGEN_DEFAULT_MATRIX_STORAGE_ORDER_OPTION, \
      sizeof(hexservo::Settings), sizeof(std::pmr::vector<double>), hexservo::kEigenFuses
[[maybe_unused]] static const bool kOtherLayout = library_was_built_with_other_flags<HEXSERVO_LAYOUT>();

}  // namespace hexservo
