#include "hexservo/settings.hpp"

#include "check.hpp"

#include <Eigen/SVD>

namespace hexservo {

using detail::refuse;
using detail::words;

namespace {

using Features = Vector<double, 2 * kPoints>;

constexpr double kCoincident = 1e-6;     // features closer than this are one [px]
constexpr double kRankDeficient = 1e-9;  // sigma_min/sigma_max of the image Jacobian with lengths in units of the depth
constexpr double kFastestBrake = 100.0;  // of the brake's response: at rest within 50 ms [rad/s]
constexpr double kBrakePhase = 0.2;      // of the same, lost to delays [rad]: next to no damping is lost
constexpr double kPi = 3.14159265358979323846;
constexpr double kMaxSteps = 1e9;  // a run of hours on one core: surely a slip

void require_apart(const std::string& key, const Features& features) {
  for (int i = 0; i < kPoints; ++i)
    for (int k = 0; k < i; ++k)
      if ((features.segment<2>(2 * i) - features.segment<2>(2 * k)).norm() < kCoincident)
        refuse(key, "four different features", words("features ", k + 1, " and ", i + 1, " at the same place"));
}

/// Four features on one line, for example, leave a direction that no image shows.
void require_full_rank(const std::string& key, double f, const Image<double>& image) {
  const Matrix3<double> R_BE = Matrix3<double>::Identity();
  Eigen::Matrix<double, 2 * kPoints, 6> J = ImageJacobian<double>(f, -1.0, image, R_BE).matrix();
  J.leftCols<3>() *= image.depth.cwiseAbs().mean();
  const auto sigma = Eigen::JacobiSVD<Eigen::Matrix<double, 2 * kPoints, 6>>(J).singularValues();
  if (!(sigma(5) > kRankDeficient * sigma(0)))
    refuse(key, "features that determine the pose (not all on one line)",
           words("an image Jacobian with smallest/largest singular value ", sigma(5) / sigma(0)));
}

/// Initial image and, for a camera that projects, the points in B.
void place_target(const Target& target, CameraConvention convention, double f, const Vector3<double>& home,
                  Image<double>& image, Eigen::Matrix<double, 3, kPoints>& points_B) {
  const Matrix3<double> R_BE = Matrix3<double>::Identity();
  if (target.points_B) {
    if (convention == CameraConvention::as_printed)
      refuse("target.points", "initial_features and depth, since a camera as_printed integrates them and has no points",
             "points");
    points_B = *target.points_B;
    detail::require_finite("target.points", Eigen::Matrix<double, kPoints, 3>(points_B.transpose()));
    for (int i = 0; i < kPoints; ++i) {
      const double Z = points_B(2, i) - home(2);
      if (!(Z < 0.0))
        refuse(words("target.points[", i, "]"),
               words("a point in front of the camera, which looks along -z from home (z < ", home(2), " m)"),
               words("z = ", points_B(2, i), " m"));
    }
    image = take_image(f, home, R_BE, points_B);
  } else {
    detail::require_finite("target.initial_features", target.initial_features);
    for (int i = 0; i < kPoints; ++i) detail::require_positive(words("target.depth[", i, "]"), target.depth(i));
    image = {target.initial_features, -target.depth};
    for (int i = 0; i < kPoints; ++i)
      points_B.col(i) = home + R_BE * back_project<double>(f, image.features.segment<2>(2 * i), image.depth(i));
  }
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

void require_probability(const char* key, double value) {
  if (!(value >= 0.0 && value <= 1.0)) refuse(key, "a probability from 0 to 1", words(value));
}

/// Timing and faults of the camera, checked.
FrameSettings<double> frame_settings(const CameraSampling& sampling, double period) {
  FrameSettings<double> frames = sampling.faults;
  frames.period = ticks("camera.period", sampling.period, period, 1);
  frames.latency = ticks("camera.latency", sampling.latency, period, 0);
  frames.jitter = ticks("camera.latency_jitter", sampling.latency_jitter, period, 0);
  // In ticks, since the sum of three rounded times may be more than a timeout that equals it; infinite: never too old.
  const auto oldest = static_cast<double>(frames.period + frames.latency + frames.jitter);
  if (!(std::round(sampling.timeout / period) >= oldest))
    refuse("camera.timeout", words("at least period, latency and latency_jitter together, ", oldest * period, " s"),
           words(sampling.timeout));
  frames.timeout = std::isfinite(sampling.timeout)
                       ? static_cast<double>(ticks("camera.timeout", sampling.timeout, period, 1))
                       : sampling.timeout;
  detail::require_not_negative("camera.noise", frames.noise);
  detail::require_not_negative("camera.quantisation", frames.quantisation);
  detail::require_not_negative("camera.outlier_size", frames.outlier_size);
  require_probability("camera.dropout", frames.dropout);
  require_probability("camera.outlier_probability", frames.outlier_probability);
  for (int i = 0; i < 2; ++i)  // infinite: every feature is seen
    if (!(frames.image_size(i) > 0.0))
      refuse(words("camera.image_size[", i, "]"), "a number > 0", words(frames.image_size(i)));
  return frames;
}

/// Leg length encoders, checked.
EncoderParameters<double> encoder_parameters(const SensorSettings& sensors, double period) {
  EncoderParameters<double> encoders = sensors.encoders;
  encoders.period = sensors.period == 0.0 ? 1 : ticks("sensors.period", sensors.period, period, 1);
  detail::require_not_negative("sensors.resolution", encoders.resolution);
  detail::require_not_negative("sensors.noise", encoders.noise);
  return encoders;
}

ActuatorParameters<double> actuator_parameters(const ActuatorSettings& settings, double period) {
  ActuatorParameters<double> actuators = settings.actuators;
  actuators.delay = ticks("actuators.delay", settings.delay, period, 0);
  if (actuators.delay > kMaxActuatorDelay)
    refuse("actuators.delay",
           words("at most ", kMaxActuatorDelay, " servo periods (", kMaxActuatorDelay * period, " s)"),
           words(settings.delay));
  if (!(actuators.bandwidth > 0.0)) refuse("actuators.bandwidth", "a number > 0", words(actuators.bandwidth));
  detail::require_not_negative("actuators.quantisation", actuators.quantisation);
  return actuators;
}

/// Motion of the base, checked; only what its kind needs.
/// @param step of the integration [s]
BaseMotionParameters<double> base_motion_parameters(const BaseMotionSettings& settings, double step) {
  const BaseMotionParameters<double>& motion = settings.motion;
  const double fastest = 0.5 / step;  // a sine wave of two steps: the integration would not see more
  switch (motion.kind) {
    case BaseMotionKind::sinusoid:
      detail::require_finite("base_motion.amplitude", motion.amplitude);
      detail::require_finite("base_motion.phase", motion.phase);
      if (!(motion.frequency >= 0.0 && motion.frequency <= fastest))
        refuse("base_motion.frequency", words("a number from 0 to ", fastest, " Hz (two steps of the integration)"),
               words(motion.frequency));
      break;
    case BaseMotionKind::recorded:
      if (!settings.samples || settings.samples->size() < 6 || settings.samples->size() % 3 != 0)
        refuse("base_motion.samples", "two or more samples of three numbers",
               words(settings.samples ? settings.samples->size() : 0, " numbers"));
      for (std::size_t i = 0; i < settings.samples->size(); ++i)
        detail::require_finite(words("base_motion.samples[", i / 3, "][", i % 3, "]"), (*settings.samples)[i]);
      detail::require_positive("base_motion.sample_period", settings.sample_period);
      break;
    case BaseMotionKind::noise:
      detail::require_not_negative("base_motion.level", motion.level);
      if (!(motion.low_frequency >= 0.0 && motion.low_frequency < motion.high_frequency))
        refuse("base_motion.low_frequency", words("a number from 0 to below high_frequency, ", motion.high_frequency),
               words(motion.low_frequency));
      if (!(motion.high_frequency <= fastest))
        refuse("base_motion.high_frequency", words("at most ", fastest, " Hz (two steps of the integration)"),
               words(motion.high_frequency));
      break;
    case BaseMotionKind::none:
      break;
  }
  return motion;
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

/// Why a run would stop before its first step.
template <class Law>
StopCause cause_at_start(const LoopParameters<double, Law>& p) {
  const double cause = p.mode == LoopMode::sampled ? SampledLoop<double, Law>(p).record().cause()
                                                   : ClosedLoop<double, Law>(p).record().cause();
  return static_cast<StopCause>(static_cast<int>(cause));
}

}  // namespace

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

SafeGains<double> safe_gains(const SafeSettings& settings, const RigidBody<double>& body, double delay) {
  if (settings.damping) detail::require_not_negative("controller.safe.damping", *settings.damping);
  if (settings.hold) detail::require_not_negative("controller.safe.hold", *settings.hold);
  const double w = std::min(kFastestBrake, kBrakePhase / delay);
  Vector6<double> inertia;
  inertia << Vector3<double>::Constant(body.mass), body.inertia_E.diagonal();
  return {settings.damping.value_or(2.0 * w * inertia), settings.hold.value_or(w * w * inertia)};
}

template <class Law>
LoopParameters<double, Law> loop_parameters(const Settings<Law>& settings, const Hexapod<double>* legs) {
  LoopParameters<double, Law> p;
  step_count(settings.simulation);
  p.hexapod = legs != nullptr ? *legs : make_hexapod(settings.robot);
  p.body = {settings.robot.mass, settings.robot.inertia, RigidBody<double>{}.gravity};
  p.dynamics_error = settings.uncertainty.dynamics;
  validate(p.body, p.dynamics_error);

  detail::require_positive("camera.focal_length", settings.camera.focal_length);
  detail::require_positive("camera.pixel_scale", settings.camera.pixel_scale);
  p.camera = settings.camera;
  p.convention = settings.convention;
  p.jacobian = settings.jacobian;

  const double f = settings.camera.focal_pixels();
  place_target(settings.target, settings.convention, f, settings.robot.home_position, p.initial_image, p.points_B);
  p.desired_features = settings.target.desired_features;
  detail::require_finite("target.desired_features", p.desired_features);
  const std::string source = settings.target.points_B ? "target.points" : "target.initial_features";
  for (const auto& [key, image] :
       {std::pair{source, p.initial_image},
        std::pair{std::string("target.desired_features"), Image<double>{p.desired_features, p.initial_image.depth}}}) {
    require_apart(key, image.features);
    require_full_rank(key, f, image);
    const double error = (p.desired_features - image.features).cwiseAbs().maxCoeff();
    if (!(error <= kMaxFeatureError))
      refuse(key, words("features within ", kMaxFeatureError, " px of the goal"), words(error, " px"));
  }

  p.depth_error = settings.uncertainty.depth;
  detail::require_finite("uncertainty.depth", p.depth_error);
  if (p.depth_error.minCoeff() <= -1.0)
    refuse("uncertainty.depth", "errors > -1 (the measured depth is (1 + error) times the true one)",
           words(p.depth_error.minCoeff()));

  p.switching = settings.switching;
  detail::require_positive("controller.switching.width", p.switching.width);
  p.gains = settings.gains;
  validate(p.gains);
  p.goal = home_pose(p.hexapod);
  if constexpr (requires { p.gains.needs_goal(); })
    if (p.gains.needs_goal()) {
      if (p.convention == CameraConvention::as_printed)
        refuse("camera.convention",
               words("eye_in_hand for the law ", Law::name,
                     " with these gains, since a camera as_printed has no points and so no pose of the goal"),
               "as_printed");
      const Pose<double> home = p.goal;
      p.goal = goal_pose(f, believed_points(f, home, p.initial_image, p.depth_error), p.desired_features, home);
    }
  p.step = settings.simulation.step;
  p.mode = settings.simulation.mode;
  if (settings.simulation.substeps < 1)
    refuse("simulation.substeps", "a whole number >= 1", words(settings.simulation.substeps));
  p.substeps = settings.simulation.substeps;
  if (p.mode == LoopMode::sampled) {
    p.frames = frame_settings(settings.sampling, p.step);
    if (p.convention == CameraConvention::as_printed &&
        (p.frames.prediction != Prediction::none || p.frames.on_lost == LostFeature::predict))
      refuse("camera.convention", "eye_in_hand where features are predicted, since a camera as_printed has no points",
             "as_printed");
    p.pose_source = settings.sensors.pose;
    p.encoders = encoder_parameters(settings.sensors, p.step);
    p.actuators = actuator_parameters(settings.actuators, p.step);
    // Until a motion acts on the platform again; a lag that is infinitely fast adds nothing.
    const double delay = p.step * static_cast<double>((p.pose_source == PoseSource::encoders ? p.encoders.period : 1) +
                                                      p.actuators.delay) +
                         1.0 / (2.0 * kPi * p.actuators.bandwidth);
    p.safe = safe_gains(settings.safe, p.body, delay);
    p.base_motion = base_motion_parameters(settings.base_motion, p.step / static_cast<double>(p.substeps));
    if (settings.base_motion.samples)
      p.recorded = {settings.base_motion.samples->data(),
                    static_cast<long long>(settings.base_motion.samples->size() / 3),
                    settings.base_motion.sample_period};
    p.on_limit = settings.on_limit;
    p.seed = seed_halves(settings.seed);
  } else if (is_implicit(p.switching.kind)) {
    refuse("controller.switching.kind", "sign, tanh or saturation in continuous mode (implicit needs a servo period)",
           "implicit");
  }
  if constexpr (kHasFuzzySystems<Law>)
    require_resolved(p.gains.fuzzy, words("controller.", Law::name, ".fuzzy."), p.step);
  detail::require_positive("metrics.band", settings.metrics.band);
  detail::require_positive("metrics.dwell", settings.metrics.dwell);
  detail::require_not_negative("metrics.rms_start", settings.metrics.rms_start);
  p.metrics = settings.metrics;

  const StopCause cause = cause_at_start(p);
  if (cause == StopCause::solver_failed)
    refuse("sensors.noise", "encoders whose first readings belong to a pose", words(p.encoders.noise, " m"));
  if (cause != StopCause::none)
    refuse("controller", "gains that give a finite wrench at the start", "a wrench that is not finite");
  return p;
}

#define HEXSERVO_HERE(Law) \
  template LoopParameters<double, Law> loop_parameters(const Settings<Law>&, const Hexapod<double>*);
HEXSERVO_FOR_EACH_LAW(HEXSERVO_HERE)
#undef HEXSERVO_HERE

}  // namespace hexservo
