#include "hexservo/settings.hpp"

#include "hexservo/position_actuators.hpp"
#include "hexservo/simulation.hpp"
#include "motion.hpp"
#include "spectra.hpp"
#include "start_of_run.hpp"
#include "walk.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>

namespace hexservo {

using detail::refuse;
using detail::words;

namespace {

using Features = OfPoints<double, kAnyPoints, 2>;

constexpr double kCoincident = 1e-6;     // features closer than this are one [px]
constexpr double kRankDeficient = 1e-9;  // sigma_min/sigma_max of the image Jacobian with lengths in units of the depth
constexpr double kFastestBrake = 100.0;  // of the brake's response: at rest within 50 ms [rad/s]
constexpr double kBrakePhase = 0.2;      // of the same, lost to delays [rad]: next to no damping is lost
constexpr double kPi = 3.14159265358979323846;
constexpr double kMaxSteps = 1e9;  // a run of hours on one core: surely a slip

void require_apart(const std::string& key, const Features& features) {
  for (int i = 0; 2 * i < features.size(); ++i)
    for (int k = 0; k < i; ++k)
      if ((features.segment<2>(2 * i) - features.segment<2>(2 * k)).norm() < kCoincident)
        refuse(key, words(features.size() / 2, " different features"),
               words("features ", k + 1, " and ", i + 1, " at the same place"));
}

/// Features on one line, for example, leave a direction that is not observable; only points that count are asked for.
template <int N>
void require_full_rank(const std::string& key, double f, const Image<double, N>& image,
                       const Vector<double, N>& weights) {
  const Pose<double> at_camera;
  const Matrix3<double> R_BE = Matrix3<double>::Identity();
  Eigen::Matrix<double, 2 * N, 6> J = ImageJacobian<double, N>(f, -1.0, image, at_camera.position, R_BE).matrix();
  if constexpr (N == kPoints) {
    J.template leftCols<3>() *= image.depth.cwiseAbs().mean();
  } else {
    J.template leftCols<3>() *= image.depth.cwiseAbs().dot(weights) / weights.sum();
    for (int i = 0; i < N; ++i)
      if (weights(i) == 0.0) J.template middleRows<2>(2 * i).setZero();
  }
  if (!J.allFinite())  // of such a matrix the decomposition computes nothing, and returns what the memory held
    refuse(key, "features and depths with a finite image Jacobian", "one that overflows");
  const Vector6<double> sigma = detail::singular_values(J);
  if (!(sigma(5) > kRankDeficient * sigma(0)))
    refuse(key,
           "features that determine the pose (not all on one line, nor three whose circle has the camera on the "
           "cylinder over it)",
           words("an image Jacobian with smallest/largest singular value ", sigma(5) / sigma(0)));
}

/// What a camera's pinhole would have in place of pixels.
Features rectified(const std::string& key, const LensParameters<double>& lens, const Features& pixels) {
  const Lens<double> pinhole(lens);
  Features features = pixels;
  for (int i = 0; pinhole.converts() && i < features.size(); i += 2)
    features.segment<2>(i) = pinhole.feature(Vector2<double>(pixels.segment<2>(i)));
  for (int i = 0; i < features.size(); ++i)
    if (!std::isfinite(features(i)))
      refuse(words(key, "[", i, "]"), "a pixel that the camera's lens shows (camera.distortion)",
             words("(", pixels(i - i % 2), ", ", pixels(i - i % 2 + 1), ") px"));
  return features;
}

/// Numbers of n points in N places, the first point's in those behind them.
/// @param numbers K of each point, or one number for all
template <int N, int K>
Vector<double, K * N> in_places(const OfPoints<double, kAnyPoints, K>& numbers, int points) {
  Vector<double, K * N> out;
  if (numbers.size() == 1) return Vector<double, K * N>::Constant(numbers(0));
  out.head(K * points) = numbers;
  fill_places<K>(out, points);
  return out;
}

/// Those of the points alone.
template <int M>
Features of_points(const Vector<double, M>& numbers, int points) {
  return numbers.head(2 * points);
}

/// Checks how many numbers there are for each point.
/// @param each numbers of a point; @param one whether a single number stands for all
void require_count(const std::string& key, Eigen::Index size, int points, int each, bool one) {
  if (size == each * points || (one && size == 1)) return;
  refuse(key,
         words(one ? "1 or " : "", each * points, " numbers for the ", points, " points of target.desired_features"),
         words(size));
}

/// How many points there are, and whether all that is given for each of them fits.
void require_counts(const Settings& settings) {
  const Target& target = settings.target;
  const int points = target.count();
  if (target.desired_features.size() % 2 != 0 || points < kLeastPoints || points > kMostPoints)
    refuse("target.desired_features", words("two numbers for each of ", kLeastPoints, " to ", kMostPoints, " points"),
           words(target.desired_features.size(), " numbers"));
  if (target.points) {
    if (target.points->rows() != points)
      refuse("target.points", words(points, " points, as target.desired_features has"), words(target.points->rows()));
  } else {
    require_count("target.initial_features", target.initial_features.size(), points, 2, false);
    require_count("target.depth", target.depth.size(), points, 1, true);
  }
  require_count("target.weights", target.weights.size(), points, 1, true);
  require_count("uncertainty.depth", settings.uncertainty.depth.size(), points, 1, true);
}

/// w_i of N places, 0 behind the points.
/// @throws std::invalid_argument where fewer points count than a law needs
template <int N>
Vector<double, N> place_weights(const Target& target) {
  Vector<double, N> weights = in_places<N, 1>(target.weights, target.count());
  for (int i = target.count(); i < N; ++i) weights(i) = 0.0;
  const auto counted = (weights.array() > 0.0).count();
  if (counted < kLeastPoints)
    refuse("target.weights", words("at least ", kLeastPoints, " points that count"),
           words(counted, counted == 1 ? " number > 0" : " numbers > 0"));
  return weights;
}

/// Initial image and, for a camera that projects, the points in B, or in E for one on the base.
template <int N>
void place_target(const Target& target, CameraConvention convention, const CameraView<double>& camera,
                  const LensParameters<double>& lens, const Pose<double>& home, Image<double, N>& image,
                  Eigen::Matrix<double, 3, N>& points_T) {
  const Matrix3<double> R_BE = rotation_matrix(home.quaternion);
  if (target.points) {
    if (convention == CameraConvention::as_printed)
      refuse("target.points", "initial_features and depth, since a camera as_printed integrates them and has no points",
             "points");
    for (int i = 0; i < N; ++i) points_T.col(i) = target.points->row(i < target.count() ? i : 0).transpose();
    image = take_image<double, N>(camera, home.position, R_BE, points_T);
    const Vector3<double> at = camera.centre(home.position, R_BE), along = -camera.attitude(R_BE).col(2);
    const std::string frame = camera.on_base() ? "platform's frame, in which they are" : "base frame";
    for (int i = 0; i < target.count(); ++i)
      if (!(image.depth(i) < 0.0))
        refuse(words("target.points[", i, "]"),
               words("a point in front of the camera, which at home is at (", at(0), ", ", at(1), ", ", at(2),
                     ") m and looks along (", along(0), ", ", along(1), ", ", along(2), ") of the ", frame,
                     " (camera.mount, camera.axes)"),
               words("one ", image.depth(i), " m behind it"));
  } else {
    image = {in_places<N, 2>(rectified("target.initial_features", lens, target.initial_features), target.count()),
             -in_places<N, 1>(target.depth, target.count())};
    for (int i = 0; i < N; ++i)
      points_T.col(i) =
          lift<double>(camera, home.position, R_BE, image.features.template segment<2>(2 * i), image.depth(i));
  }
}

/// Checks every number that acts by the bounds of its field.
void require_acting_bounds(const Settings& settings) {
  const bool sampled = settings.simulation.mode == LoopMode::sampled;
  const bool points = settings.target.points.has_value();
  detail::walk(detail::Path{}, settings, [&](const detail::Path& path, const Field& field, const auto& member) {
    if ((sampled || !field.sampled) && (field.with_points || !points)) detail::require_within(path, field, member);
  });
}

/// A time on the grid of the servo's ticks.
/// @param at_least fewest ticks
long long ticks(const char* key, double time, double period, long long at_least) {
  const double most = 1e6 * period;  // frames in flight are kept
  if (!(time >= 0.0 && time <= most)) refuse(key, words("a time from 0 to ", most, " s"), words(time));
  const double ratio = time / period, whole = std::round(ratio);
  const double fewest = static_cast<double>(at_least);
  if (whole < fewest || std::abs(ratio - whole) > 1e-9 * std::max(whole, 1.0)) {
    const double below = std::max(std::floor(ratio), fewest), above = std::max(std::ceil(ratio), fewest);
    refuse(key,
           words("a whole number of servo periods (simulation.step, ", period, " s)",
                 at_least > 0 ? ", at least one" : ""),
           words(time, "; nearest: ", below * period, above > below ? words(" or ", above * period) : ""));
  }
  return static_cast<long long>(whole);
}

/// A principal point within the image, and a lens that shows all of it.
void require_an_image(const CameraSettings& camera, const FrameSettings<double>& frames) {
  if (std::isfinite(camera.image_size(0)) != std::isfinite(camera.image_size(1)))
    refuse("camera.image_size", "two finite numbers, or none",
           words(camera.image_size(0), " and ", camera.image_size(1)));
  if (!camera.image_size.allFinite()) return;
  if (camera.principal_point)
    for (int axis = 0; axis < 2; ++axis)
      if (const double at = (*camera.principal_point)(axis);
          std::abs(at - frames.image_centre(axis)) > 0.5 * camera.image_size(axis))
        refuse(words("camera.principal_point[", axis, "]"),
               words("a pixel of the image, from ", frames.image_centre(axis) - 0.5 * camera.image_size(axis), " to ",
                     frames.image_centre(axis) + 0.5 * camera.image_size(axis)),
               words(at));
  const Lens<double> lens(camera.lens());
  if (!lens.converts()) return;
  constexpr int kSamples = 64;
  for (int side = 0; side < 4; ++side)
    for (int i = 0; i <= kSamples; ++i) {
      Vector2<double> along(side % 2 == 0 ? 1.0 : -1.0, 2.0 * i / kSamples - 1.0);
      if (side >= 2) std::swap(along(0), along(1));
      const Vector2<double> pixel = frames.image_centre + 0.5 * along.cwiseProduct(camera.image_size);
      if (!lens.feature(pixel).allFinite())
        refuse("camera.distortion",
               words("a lens that shows all of an image of ", camera.image_size(0), " x ", camera.image_size(1), " px"),
               words("one whose image folds, or ends, before the pixel (", pixel(0), ", ", pixel(1), ")"));
    }
}

/// Timing and faults of the camera.
/// @param late what the latency that the controller assumes is off [s]
FrameSettings<double> frame_settings(const CameraSettings& camera, double late, double period) {
  FrameSettings<double> frames;
  static_cast<FrameFaults<double>&>(frames) = camera;
  frames.stamped = camera.latency_known;
  frames.period = camera.period == 0.0 ? 1 : ticks("camera.period", camera.period, period, 1);
  frames.latency = ticks("camera.latency", camera.latency, period, 0);
  frames.jitter = ticks("camera.latency_jitter", camera.latency_jitter, period, 0);
  if (late != 0.0 && !camera.latency_known)
    refuse("uncertainty.latency", "0 where camera.latency_known is false: no latency is assumed there", words(late));
  frames.early = (late < 0.0 ? -1 : 1) * ticks("uncertainty.latency", std::abs(late), period, 0);
  if (frames.early < -frames.latency)
    refuse("uncertainty.latency", words("at least ", 0.0 - camera.latency, " s, so that none below 0 is assumed"),
           words(late));
  if (camera.smoothing > 0.0) frames.kept = std::exp(-static_cast<double>(frames.period) * period / camera.smoothing);
  // In ticks, since the sum of three rounded times may be more than a timeout that equals it; infinite: never too old.
  const auto oldest = static_cast<double>(frames.period + oldest_stamp(frames));
  if (!(std::round(camera.timeout / period) >= oldest))
    refuse("camera.timeout",
           words("at least period, latency and latency_jitter together",
                 frames.early > 0 ? ", and uncertainty.latency" : "", ", ", oldest * period, " s"),
           words(camera.timeout));
  frames.timeout = std::isfinite(camera.timeout)
                       ? static_cast<double>(ticks("camera.timeout", camera.timeout, period, 1))
                       : camera.timeout;
  if (camera.principal_point && camera.image_size.allFinite())  // then the first pixel's centre is (0, 0)
    frames.image_centre = 0.5 * (camera.image_size - Vector2<double>::Ones());
  require_an_image(camera, frames);
  return frames;
}

EncoderParameters<double> encoder_parameters(const SensorSettings& sensors, double period) {
  return {sensors, sensors.period == 0.0 ? 1 : ticks("sensors.period", sensors.period, period, 1)};
}

/// Refuses numbers of a block that another kind of actuators would use.
/// @param key what its keys begin with; @param wanted the kind that uses them
/// @param is_other whether a key of the block is one of them
template <class T, class F>
void require_defaults(std::string_view key, const T& block, std::string_view wanted, F&& is_other) {
  const T unset{};
  T::visit(
      [&]<class M>(const Field& field, const M& value, const M& usual) {
        if constexpr (!Visited<M>)
          if (is_other(field.name) && !(value == usual))
            refuse(words(key, ".", field.name),
                   words("its default where actuators.kind is not ", wanted, ", since it has no effect there"),
                   "another value");
      },
      block, unset);
}

/// What of the scenario's keys has no effect on its kind of actuators is refused.
void require_keys_with_effect(const Settings& settings) {
  const ActuatorSettings& actuators = settings.actuators;
  const auto any_key = [](std::string_view) { return true; };
  if (actuators.kind != ActuatorKind::position_torque)
    require_defaults("actuators.motor", actuators.motor, "position_torque", any_key);
  if (actuators.kind == ActuatorKind::force) {
    constexpr std::string_view kWanted = "position or position_torque";
    require_defaults("actuators.position", actuators.position, kWanted, any_key);
    require_defaults("controller.virtual_platform", settings.controller.virtual_platform, kWanted, any_key);
    return;
  }
  const auto of_forces = [](std::string_view name) { return name != "kind" && name != "delay"; };
  require_defaults("actuators", actuators, "force", of_forces);
  if (settings.controller.safe.damping || settings.controller.safe.hold)
    refuse(settings.controller.safe.damping ? "controller.safe.damping" : "controller.safe.hold",
           "none where actuators.kind is not force: there the legs stop and stay", "numbers");
  if (settings.camera.convention == CameraConvention::as_printed)
    refuse("camera.convention", "eye_in_hand where actuators.kind is not force: the image follows from the pose",
           "as_printed");
}

/// That a scenario has what a law that tracks needs; to find the latency of a camera is for such a law alone.
template <class Law>
void require_tracking(const Settings& settings) {
  const CameraSettings& camera = settings.camera;
  const bool sampled = settings.simulation.mode == LoopMode::sampled;
  const std::string law = words("with the law ", Law::traits.name);
  if constexpr (!kTracks<Law>) {
    if (sampled && !camera.latency_known)
      refuse("camera.latency_known", words("true ", law, ": the law tracking alone finds the latency"), "false");
  } else {
    if (!sampled)
      refuse("simulation.mode", words("sampled ", law, ", which lives on frames and their exposures"), "continuous");
    if (!takes_positions(settings.actuators.kind))
      refuse("actuators.kind", words("position ", law, ", which gives where the legs shall go and no forces"), "force");
    if (camera.mount.on == MountedOn::base)
      refuse("camera.mount.on", words("platform ", law, ", which looks for a target beside the machine"), "base");
    if (camera.prediction != Prediction::none)
      refuse("camera.prediction", words("none ", law, ", which predicts the target itself"), "encoder");
    if (camera.on_lost == LostFeature::predict)
      refuse("camera.on_lost", words("hold or stop ", law, ", which takes frames that show every point"), "predict");
    if (settings.controller.virtual_platform.damping != Vector6<double>::Zero())
      refuse("controller.virtual_platform.damping", words("0 ", law, ", whose reference has no mass"), "other numbers");
    if (!camera.latency_known && camera.latency + camera.latency_jitter > kMaxLatency)
      refuse("camera.latency", words("at most ", kMaxLatency, " s, with latency_jitter, where latency_known is false"),
             words(camera.latency + camera.latency_jitter));
  }
}

/// That the timeout of a law that tracks has room for frames which wait for a reading of the joints.
template <class Law, int N>
void require_time_to_wait(const LoopParameters<double, Law, N>& p) {
  if (!kTracks<Law> || p.pose_source != PoseSource::encoders) return;
  const auto oldest = static_cast<double>(p.frames.period + oldest_stamp(p.frames) + p.encoders.period - 1);
  if (!(p.frames.timeout >= oldest))
    refuse("camera.timeout",
           words("at least period, latency and latency_jitter together, and sensors.period less a tick, ",
                 oldest * p.step, " s, with the law ", Law::traits.name, ", whose frames wait for a reading"),
           words(p.frames.timeout * p.step));
}

/// That the virtual platform's steps follow its damping.
template <int N>
void require_damping(const SceneParameters<double, N>& p) {
  constexpr double kStable = 2.5;  // of the Runge-Kutta method on the negative axis, 2.78
  const Matrix3<double> R_BE = rotation_matrix(home_pose(p.hexapod).quaternion);
  const Matrix6<double> mobility = mass_matrix(p.body, R_BE).inverse();
  for (int i = 0; i < 6; ++i) {
    const double most = kStable / (mobility(i, i) * p.step);  // of this one alone
    if (!(p.virtual_damping(i) <= most))
      refuse(words("controller.virtual_platform.damping[", i, "]"),
             words("at most ", most, ", that of a motion which lasts longer than a servo period"),
             words(p.virtual_damping(i)));
  }
  const Vector6<double> root = p.virtual_damping.cwiseSqrt();
  const Matrix6<double> rates = root.asDiagonal() * mobility * root.asDiagonal();
  const double fastest = detail::eigenvalues(rates)(5) * p.step;
  if (!(fastest <= kStable))  // entries that are coupled by the inertia are faster together
    refuse("controller.virtual_platform.damping",
           words("at most ", kStable / fastest,
                 " of these numbers, which together make a motion last less than a servo ", "period"),
           words(fastest, " per period"));
}

/// What of a law's keys has no effect on legs that take positions, and that there is a motion which its wrench stands
/// for.
template <class Law, int N>
void require_motion(const Settings& settings, const LoopParameters<double, Law, N>& p) {
  if (p.mode != LoopMode::sampled || !takes_positions(p.actuators.kind)) return;
  const std::string block = words("controller.", Law::traits.name, ".");
  if constexpr (!Law::traits.viscosity.empty()) {
    if (!(Law::viscosity(p.gains).minCoeff() > 0.0))
      refuse(words(block, Law::traits.viscosity),
             "numbers > 0 where actuators.kind is not force: the commanded twist is what the law adds, over them",
             words(Law::viscosity(p.gains).minCoeff()));
    if (settings.controller.virtual_platform.damping != Vector6<double>::Zero())
      refuse("controller.virtual_platform.damping",
             words("0 with the law ", Law::traits.name, ", whose platform moves at a commanded twist, without mass"),
             "other numbers");
  }
  require_damping(p);
}

/// That the legs' steps follow their motors.
template <int N>
void require_steps_for_motors(const SceneParameters<double, N>& p) {
  if (p.mode != LoopMode::sampled || p.actuators.kind != ActuatorKind::position_torque) return;
  const double substeps =
      motor_substeps(Plant<double>(p.plant_body, p.dynamics_error), p.hexapod, p.start, p.actuators.motor, p.step);
  if (!(static_cast<double>(p.substeps) >= substeps))
    refuse("simulation.substeps",
           words("at least ", substeps, ", with which the steps of the legs follow their motors and what these move"),
           words(p.substeps));
}

ActuatorParameters<double> actuator_parameters(const Settings& scenario, double period) {
  require_keys_with_effect(scenario);
  const ActuatorSettings& settings = scenario.actuators;
  ActuatorParameters<double> actuators{settings, ticks("actuators.delay", settings.delay, period, 0), settings.position,
                                       settings.motor, LegSteps<double>{}};
  if (actuators.kind == ActuatorKind::position)
    actuators.leg_steps = leg_steps(settings.position, period / static_cast<double>(scenario.simulation.substeps));
  if (actuators.delay > kMaxActuatorDelay)
    refuse("actuators.delay",
           words("at most ", kMaxActuatorDelay, " servo periods (", kMaxActuatorDelay * period, " s)"),
           words(settings.delay));
  return actuators;
}

/// The step and the durations nearest to a pair that makes no grid.
std::string nearest_grid(double step, double duration) {
  const double ratio = duration / step;
  const double below = std::floor(ratio), above = std::max(std::ceil(ratio), 1.0);
  const bool both = below >= 1.0;
  const double steps = both && std::abs(duration / below - step) < std::abs(duration / above - step) ? below : above;
  return words("nearest: step ", duration / steps, ", or duration ", both ? words(below * step, " or ") : "",
               above * step);
}

/// That a run would not stop before its first step.
template <class Law, int N>
void require_running_start(const LoopParameters<double, Law, N>& p) {
  const auto [cause, leg] = detail::start_of_run(p);
  if (cause == StopCause::none) return;
  const std::string why = "one where " + describe(cause, 0.0, leg);
  if (cause == StopCause::solver_failed)
    refuse("sensors", "encoders whose first readings belong to a pose (noise, resolution)", why);
  if (cause == StopCause::feature_lost)
    refuse("camera.image_size", "an image that shows every point at the start, where camera.on_lost is stop", why);
  if (cause == StopCause::singular || outcome_of(cause) == Outcome::leg_limit)
    refuse("simulation.start", "a start from which the run goes on", why);
  refuse("controller", "gains that give a finite wrench at the start", "a wrench that is not finite");
}

}  // namespace

double motor_substeps(const Plant<double>& plant, const Hexapod<double>& hexapod, const Pose<double>& pose,
                      const MotorParameters<double>& motor, double period) {
  const Matrix3<double> R_BE = rotation_matrix(pose.quaternion);
  const Matrix6<double> H = inverse_kinematics(hexapod, pose.position, R_BE).wrench_map();
  const Matrix6<double> mass = plant.mass_matrix_at(R_BE) + motor.armature * H * H.transpose();
  const Matrix6<double> mobility = H.transpose() * mass.ldlt().solve(H);
  const double a = detail::eigenvalues(mobility)(5);
  const double rate = std::max((motor.kv + motor.damping) * a, 2.0 * std::sqrt(motor.kp * a));  // times a step: up to 1
  return std::ceil(rate * period / kMotorSteps);
}

Camera assumed_camera(const Settings& settings) {
  Camera camera = settings.camera;
  camera.mount = assumed_mount(camera.mount, settings.uncertainty.mount);
  if (settings.simulation.mode == LoopMode::continuous) return camera;  // whose law has features without pixels
  const double scale = 1.0 + settings.uncertainty.focal_length;
  if (camera.focal_pixels)
    *camera.focal_pixels *= scale;
  else
    camera.focal_length *= scale;
  camera.image_offset += settings.uncertainty.principal_point;
  return camera;
}

long long step_count(const SimulationSettings& simulation) {
  detail::require_positive("simulation.step", simulation.step);
  detail::require_positive("simulation.duration", simulation.duration);
  if (simulation.log_every < 1) refuse("simulation.log_every", "a whole number >= 1", words(simulation.log_every));
  const double ratio = simulation.duration / simulation.step;
  if (!(ratio <= kMaxSteps))
    refuse("simulation.duration", words("at most ", kMaxSteps, " steps"), words(ratio, " steps"));
  const double steps = std::round(ratio);
  if (steps < 1.0 || std::abs(ratio - steps) > 1e-9 * steps)
    refuse("simulation.step", words("a step that divides the duration ", simulation.duration),
           words(simulation.step, "; ", nearest_grid(simulation.step, simulation.duration)));
  return static_cast<long long>(steps);
}

SafeGains<double> safe_gains(const SafeSettings& settings, double delay) {
  detail::require_bounds("controller.safe", settings);
  const double w = std::min(kFastestBrake, kBrakePhase / delay);
  SafeGains<double> gains;
  if (settings.damping)
    gains.damping = *settings.damping;
  else
    gains.damping_rate = 2.0 * w;
  if (settings.hold)
    gains.hold = *settings.hold;
  else
    gains.hold_rate = w * w;
  return gains;
}

namespace {

/// The platform with its payload, or without.
RigidBody<double> body_of(const RobotParameters& robot, bool with_payload) {
  const Payload& load = robot.payload;
  RigidBody<double> platform{robot.mass, robot.inertia, robot.gravity, robot.centre_of_mass};
  const bool loaded = load.mass > 0.0 && load.position != Vector3<double>::Zero();
  platform.off_centre = robot.off_centre || loaded || robot.centre_of_mass != Vector3<double>::Zero();
  if (!with_payload || load.mass == 0.0) return platform;
  return joined(platform, {load.mass, load.inertia + displaced_inertia(load.mass, load.position), robot.gravity,
                           load.position, platform.off_centre});
}

}  // namespace

RigidBody<double> estimated_body(const RobotParameters& robot) { return body_of(robot, robot.payload.known); }

RigidBody<double> plant_body(const RobotParameters& robot) { return body_of(robot, true); }

namespace {

template <int N>
Features project_target_in(const Settings& settings, const Vector6<double>& displacement) {
  const Hexapod<double> hexapod = make_hexapod(settings.robot);
  const PlatformCamera<double> camera(settings.camera.parameters());
  Image<double, N> image;
  Eigen::Matrix<double, 3, N> points_T;
  place_target<N>(settings.target, settings.camera.convention, camera, settings.camera.lens(), home_pose(hexapod),
                  image, points_T);
  if (settings.camera.convention == CameraConvention::as_printed)
    refuse("target.desired_pose", "desired_features, since a camera as_printed has no points", "a pose");
  detail::require_finite("target.desired_pose", displacement);
  detail::require_turn("target.desired_pose", displacement);
  const Pose<double> pose = moved(home_pose(hexapod), displacement);
  image = take_image<double, N>(camera, pose.position, rotation_matrix(pose.quaternion), points_T);
  if (!(image.depth.maxCoeff() < 0.0))
    refuse("target.desired_pose", "a pose from which every point is in front of the camera",
           words("one with a point ", image.depth.maxCoeff(), " m behind it"));
  return of_points<2 * N>(Lens<double>(settings.camera.lens()).pixels(image.features), settings.target.count());
}

}  // namespace

Features project_target(const Settings& settings, const Vector6<double>& displacement) {
  require_counts(settings);
  require_acting_bounds(settings);
  return with_places(settings.target.places(), [&]<int N>(std::integral_constant<int, N>) {
    return project_target_in<N>(settings, displacement);
  });
}

namespace {

/// The controller's goal: where the assumed points give the desired features.
template <int N>
Pose<double> believed_goal(const SceneParameters<double, N>& p, std::string_view law) {
  if (const auto counted = (p.weights.head(p.points).array() > 0.0).count(); counted < kPoints)
    refuse("target.weights",
           words("at least ", kPoints, " points that count for the law ", law,
                 " with these gains, which needs the pose of the goal: three points have several"),
           words(counted));
  if (p.convention == CameraConvention::as_printed)
    refuse("camera.convention",
           words("eye_in_hand for the law ", law,
                 " with these gains, since a camera as_printed has no points and so no pose of the goal"),
           "as_printed");
  const PlatformCamera<double> camera(p.assumed_camera);
  return goal_pose<N>(camera, believed_points(p), p.assumed_desired, home_pose(p.hexapod),
                      PointWeights<double, N>(p.weights));
}

/// Devices of the sampled loop.
template <int N>
void prepare_devices(const Settings& settings, SceneParameters<double, N>& p) {
  p.frames = frame_settings(settings.camera, settings.uncertainty.latency, p.step);
  if (p.convention == CameraConvention::as_printed &&
      (p.frames.prediction != Prediction::none || p.frames.on_lost == LostFeature::predict))
    refuse("camera.convention", "eye_in_hand where features are predicted, since a camera as_printed has no points",
           "as_printed");
  p.pose_source = settings.sensors.pose;
  p.encoders = encoder_parameters(settings.sensors, p.step);
  p.actuators = actuator_parameters(settings, p.step);
  p.virtual_damping = settings.controller.virtual_platform.damping;
  // Until a motion acts on the platform again; a lag that is infinitely fast adds nothing.
  const double delay = p.step * static_cast<double>((p.pose_source == PoseSource::encoders ? p.encoders.period : 1) +
                                                    p.actuators.delay) +
                       1.0 / (2.0 * kPi * p.actuators.bandwidth);
  p.safe = safe_gains(settings.controller.safe, delay);
  detail::prepare_motions(settings, p);
  p.on_limit = settings.robot.on_limit;
  p.seed = seed_halves(settings.seed);
}

/// Image of the target where the run starts.
template <int N>
void require_view_at_start(const SceneParameters<double, N>& p) {
  const Pose<double> home = home_pose(p.hexapod);
  const std::string key = "simulation.start.pose";
  if (p.start.position == home.position && p.start.quaternion == home.quaternion) return;
  if (p.convention == CameraConvention::as_printed)
    refuse(key, "zeros, since a camera as_printed has no points that it could see from elsewhere than from home",
           "other numbers");
  const PlatformCamera<double> camera(p.camera);
  const Image<double, N> image =
      take_image<double, N>(camera, p.start.position, rotation_matrix(p.start.quaternion), p.points_T);
  if (!(image.depth.maxCoeff() < 0.0))
    refuse(key, "a pose from which every point is in front of the camera",
           words("one with a point ", image.depth.maxCoeff(), " m behind it"));
  const double error = (p.desired_features - image.features).cwiseAbs().maxCoeff();
  if (!(error <= kMaxFeatureError))
    refuse(key, words("a pose that shows the features within ", kMaxFeatureError, " px of the goal"),
           words(error, " px"));
  if (!lever_arms(p.hexapod, p.start).allFinite())
    refuse(key, "a pose where every crank reaches its platform joint (robot.cranks)", "one beyond");
  const Vector6<double> sigma = wrench_map_singular_values(p.hexapod, p.start);
  if (!(sigma(5) > kRankDeficient * sigma(0)))
    refuse(key, "a pose that is not singular",
           words("a wrench map with smallest/largest singular value ", sigma(5) / sigma(0)));
}

/// Image of a target that moves in B where the run starts.
template <int N>
void require_view_of_moving_target(const SceneParameters<double, N>& p) {
  if (p.target_motion.kind == TargetMotionKind::none && p.target_frame == TargetFrame::base) return;
  BaseMotion<double> base(p.base_motion, p.seed, p.recorded);
  const TargetPlace<double, N> target(p.points_T, p.target_frame, p.target_motion, p.recorded_target);
  if (!target.moves(base)) return;
  base.find_place();
  const PlatformCamera<double> camera(p.camera);
  const Image<double, N> image =
      take_image<double, N>(camera, p.start.position, rotation_matrix(p.start.quaternion), target.points(0.0, base));
  const double error = (p.desired_features - image.features).cwiseAbs().maxCoeff();
  if (!(image.depth.maxCoeff() < 0.0 && error <= kMaxFeatureError))
    refuse("target.motion", "base and target that leave the points in front of the camera at the start of the run",
           words("one ", image.depth.maxCoeff(), " m behind it, features ", error, " px from the goal"));
}

void validate_payload(const Payload& load) {
  if (load.mass == 0.0 && (load.position != Vector3<double>::Zero() || load.inertia != Matrix3<double>::Zero()))
    refuse("robot.payload.mass", "a mass > 0 for a payload with a position or an inertia", "0");
  if (load.mass == 0.0) return;
  if ((load.inertia - load.inertia.transpose()).cwiseAbs().maxCoeff() > 1e-12 * load.inertia.cwiseAbs().maxCoeff())
    refuse("robot.payload.inertia", "a symmetric 3x3 matrix", "one that is not");
  const Vector3<double> principal = detail::eigenvalues(load.inertia);
  if (!(principal(0) >= 0.0) || principal(2) - principal(0) - principal(1) > 1e-9 * principal.sum())
    refuse("robot.payload.inertia", "principal moments >= 0 none of which exceeds the sum of the other two",
           words(principal(0), ", ", principal(1), ", ", principal(2), " kg m^2"));
}

/// The true camera and the one that the controller assumes.
template <int N>
void place_cameras(const Settings& settings, SceneParameters<double, N>& p) {
  for (const auto& [key, is_none] : {std::pair{"camera.mount", settings.camera.mount.is_none()},
                                     std::pair{"uncertainty.mount", settings.uncertainty.mount.is_none()}})
    if (p.convention == CameraConvention::as_printed && !is_none)
      refuse(key, "no mount for a camera as_printed, whose equations are those of a camera at the platform's origin",
             "one");
  p.camera = settings.camera.parameters();
  placement(settings.uncertainty.mount, "uncertainty.mount");
  const Camera assumed = assumed_camera(settings);
  p.assumed_camera = assumed.parameters();
  if (p.convention == CameraConvention::as_printed && settings.camera.axes != CameraAxes::paper)
    refuse("camera.axes", "paper for a camera as_printed, which looks along -z of the platform", "opencv");
  p.lens = settings.camera.lens();
  p.assumed_lens = assumed.lens();
}

/// All that no law enters.
template <int N>
SceneParameters<double, N> scene_parameters(const Settings& settings, const Hexapod<double>* legs) {
  SceneParameters<double, N> p;
  require_counts(settings);
  const Target& target = settings.target;
  if (N < target.places())
    refuse("target", words("one with ", N, " points that count 1 each, for which this controller is compiled"),
           words("one with ", target.count(), " points, or with other weights"));
  p.points = target.count();
  require_acting_bounds(settings);
  p.weights = place_weights<N>(target);
  step_count(settings.simulation);
  p.hexapod = legs != nullptr ? *legs : make_hexapod(settings.robot);
  p.body = estimated_body(settings.robot);
  p.dynamics_error = settings.uncertainty;
  p.plant_body = plant_body(settings.robot);
  validate(body_of(settings.robot, false), p.dynamics_error);
  validate_payload(settings.robot.payload);
  if (settings.robot.payload.mass > 0.0) validate(p.plant_body, p.dynamics_error);  // errors apply to both together
  p.convention = settings.camera.convention;
  place_cameras(settings, p);
  p.jacobian = settings.controller.jacobian;

  const PlatformCamera<double> camera(p.camera);
  place_target<N>(target, p.convention, camera, p.lens, home_pose(p.hexapod), p.initial_image, p.points_T);
  p.desired_features = in_places<N, 2>(rectified("target.desired_features", p.lens, target.desired_features), p.points);
  const std::string source = target.points ? "target.points" : "target.initial_features";
  for (const auto& [key, image] :
       {std::pair{source, p.initial_image}, std::pair{std::string("target.desired_features"),
                                                      Image<double, N>{p.desired_features, p.initial_image.depth}}}) {
    require_apart(key, of_points(image.features, p.points));
    require_full_rank<N>(key, p.camera.focal, image, p.weights);
    const double error = (p.desired_features - image.features).cwiseAbs().maxCoeff();
    if (!(error <= kMaxFeatureError))
      refuse(key, words("features within ", kMaxFeatureError, " px of the goal"), words(error, " px"));
  }
  const Features start = target.points
                             ? of_points<2 * N>(Lens<double>(p.lens).pixels(p.initial_image.features), p.points)
                             : target.initial_features;
  p.assumed_initial = in_places<N, 2>(rectified(source, p.assumed_lens, start), p.points);
  p.assumed_desired =
      in_places<N, 2>(rectified("target.desired_features", p.assumed_lens, target.desired_features), p.points);
  p.depth_error = in_places<N, 1>(settings.uncertainty.depth, p.points);
  p.switching = settings.controller.switching;
  p.goal = home_pose(p.hexapod);
  detail::require_turn("simulation.start.pose", settings.simulation.start.pose);
  p.start = moved(p.goal, settings.simulation.start.pose);
  p.start_twist = settings.simulation.start.twist;
  if (!(p.start_twist.cwiseAbs().maxCoeff() <= kMaxTwist))
    refuse("simulation.start.twist", words("numbers within ", kMaxTwist, ", beyond which a run counts as diverged"),
           words(p.start_twist.cwiseAbs().maxCoeff()));
  require_view_at_start(p);
  p.step = settings.simulation.step;
  p.mode = settings.simulation.mode;
  p.substeps = settings.simulation.substeps;
  p.limits_every = settings.robot.limits_every;
  if (p.mode == LoopMode::sampled)
    prepare_devices(settings, p);
  else if (is_implicit(p.switching.kind))
    refuse("controller.switching.kind", "sign, tanh or saturation in continuous mode (implicit needs a servo period)",
           "implicit");
  if (p.mode == LoopMode::sampled) require_view_of_moving_target(p);
  p.metrics = settings.metrics;
  return p;
}

/// Gains for N places from those of any number of points; the weights go into those of the image's coordinates.
/// @param key that the gains' keys begin with, "controller.kelly."
template <int N, class To, class From>
To gains_in_places(const std::string& key, const From& from, const Vector<double, N>& weights, int points) {
  To to;
  To::visit(
      [&](const Field& field, auto& here, const auto& there) {
        if constexpr (std::is_same_v<std::remove_cvref_t<decltype(there)>, Features>) {
          require_count(key + std::string(field.name), there.size(), points, 2, true);
          here = in_places<N, 2>(there, points);
          if constexpr (N != kPoints)
            for (int k = 0; k < 2 * N; ++k) here(k) *= weights(k / 2);
        } else {
          here = there;
        }
      },
      to, from);
  return to;
}

}  // namespace

template <class Law, int N>
LoopParameters<double, Law, N> loop_parameters(const Settings& settings, const Hexapod<double>* legs) {
  static_assert(Law::traits.memory() == kHasFuzzySystems<Law>);
  const std::string block = words("controller.", Law::traits.name);
  require_tracking<Law>(settings);
  LoopParameters<double, Law, N> p{scene_parameters<N>(settings, legs), {}};
  const GainsOf<Law>& gains = settings.gains<Law>();
  p.gains = gains_in_places<N, typename Law::template Gains<double, N>>(block + ".", gains, p.weights, p.points);
  if constexpr (requires { validate(gains, block + "."); }) validate(gains, block + ".");
  if constexpr (Law::traits.points)
    if (gains.needs_goal()) p.goal = believed_goal(p, Law::traits.name);
  if constexpr (kHasFuzzySystems<Law>) {
    validate(p.gains.fuzzy, block + ".fuzzy.");
    require_resolved(p.gains.fuzzy, block + ".fuzzy.", p.step);
  }
  require_motion(settings, p);
  require_time_to_wait(p);
  require_steps_for_motors(p);
  require_running_start(p);
  return p;
}

#define HEXSERVO_OF(Law, N) \
  template LoopParameters<double, Law, (N)> loop_parameters<Law, (N)>(const Settings&, const Hexapod<double>*);
#define HEXSERVO_HERE(Law) HEXSERVO_OF(Law, kPoints) HEXSERVO_OF(Law, kMostPoints)
HEXSERVO_FOR_EACH_LAW(HEXSERVO_HERE)
#undef HEXSERVO_HERE
#undef HEXSERVO_OF

template <int alignment, int static_alignment, int storage_order, std::size_t settings, std::size_t vector, bool fuses>
bool library_was_built_with_other_flags() noexcept {
  return false;
}
template bool library_was_built_with_other_flags<HEXSERVO_LAYOUT>() noexcept;

}  // namespace hexservo
