#include "bindings.hpp"

#include "hexservo/simulation.hpp"

#include <pybind11/native_enum.h>

namespace hexservo::bindings {

namespace {

using Points = Eigen::Matrix<double, kPoints, 3>;

std::optional<Points> points_of(const Target& target) {
  if (!target.points_B) return std::nullopt;
  return Points(target.points_B->transpose());
}

void set_points(Target& target, const std::optional<Points>& points) {
  target.points_B.reset();
  if (points) target.points_B = points->transpose();
}

using Samples = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;

std::optional<Samples> samples_of(const BaseMotionSettings& motion) {
  if (!motion.samples) return std::nullopt;
  return Samples(
      Eigen::Map<const Samples>(motion.samples->data(), static_cast<Eigen::Index>(motion.samples->size() / 3), 3));
}

void set_samples(BaseMotionSettings& motion, const std::optional<Samples>& samples) {
  motion.samples.reset();
  if (samples)
    motion.samples = std::make_shared<const std::vector<double>>(samples->data(), samples->data() + samples->size());
}

/// Sensors, actuators and base of the sampled loop.
void bind_devices(py::module_& m) {
  py::native_enum<PoseSource>(m, "PoseSource", "enum.Enum")
      .value("truth", PoseSource::truth)
      .value("encoders", PoseSource::encoders)
      .finalize();
  py::native_enum<RateSource>(m, "RateSource", "enum.Enum")
      .value("differences", RateSource::differences)
      .value("true_rates", RateSource::true_rates)
      .finalize();
  py::native_enum<ActuatorHold>(m, "ActuatorHold", "enum.Enum")
      .value("wrench", ActuatorHold::wrench)
      .value("leg_forces", ActuatorHold::leg_forces)
      .finalize();
  py::native_enum<BaseMotionKind>(m, "BaseMotionKind", "enum.Enum")
      .value("none", BaseMotionKind::none)
      .value("sinusoid", BaseMotionKind::sinusoid)
      .value("recorded", BaseMotionKind::recorded)
      .value("noise", BaseMotionKind::noise)
      .finalize();
  py::native_enum<LimitPolicy>(m, "LimitPolicy", "enum.Enum")
      .value("report", LimitPolicy::report)
      .value("stop", LimitPolicy::stop)
      .finalize();

  using E = EncoderParameters<double>;
  py::class_<E>(m, "EncoderParameters", "Leg length encoders.")
      .def(py::init<>())
      .def_readwrite("resolution", &E::resolution, "[m]; 0: none")
      .def_readwrite("noise", &E::noise, "standard deviation [m]")
      .def_readwrite("rates", &E::rates, "what the twist is made of");
  py::class_<SensorSettings>(m, "SensorSettings", "How the controller knows pose and twist in sampled mode.")
      .def(py::init<>())
      .def_readwrite("pose", &SensorSettings::pose)
      .def_readwrite("period", &SensorSettings::period, "between two readings [s]; 0: every servo period")
      .def_readwrite("encoders", &SensorSettings::encoders);

  using A = ActuatorParameters<double>;
  py::class_<A>(m, "ActuatorParameters", "The actuators of the legs.")
      .def(py::init<>())
      .def_readwrite("hold", &A::hold, "what stays the same between two ticks")
      .def_readwrite("saturation", &A::saturation, "whether leg forces are limited to the robot's force_limit")
      .def_readwrite("bandwidth", &A::bandwidth, "of a first-order lag [Hz]; infinite: none")
      .def_readwrite("quantisation", &A::quantisation, "[N]; 0: none");
  py::class_<ActuatorSettings>(m, "ActuatorSettings", "The actuators in sampled mode.")
      .def(py::init<>())
      .def_readwrite("delay", &ActuatorSettings::delay, "a whole number of servo periods [s]")
      .def_readwrite("actuators", &ActuatorSettings::actuators);

  using B = BaseMotionParameters<double>;
  py::class_<B>(m, "BaseMotionParameters", "Acceleration of the base, but for what is recorded.")
      .def(py::init<>())
      .def_readwrite("kind", &B::kind)
      .def_readwrite("amplitude", &B::amplitude, "(3,) of the sinusoid, in B [m/s^2]")
      .def_readwrite("frequency", &B::frequency, "of the sinusoid [Hz]")
      .def_readwrite("phase", &B::phase, "of the sinusoid at t = 0 [rad]")
      .def_readwrite("level", &B::level, "(3,) one-sided spectral density of the noise, in B [(m/s^2)^2/Hz]")
      .def_readwrite("low_frequency", &B::low_frequency, "where the noise begins [Hz]")
      .def_readwrite("high_frequency", &B::high_frequency, "where the noise ends [Hz]");
  py::class_<BaseMotionSettings>(m, "BaseMotionSettings", "How the base moves in sampled mode.")
      .def(py::init<>())
      .def_readwrite("motion", &BaseMotionSettings::motion)
      .def_property("samples", &samples_of, &set_samples, "(n, 3) recorded, in B [m/s^2]; or None")
      .def_readwrite("sample_period", &BaseMotionSettings::sample_period, "of what is recorded, from t = 0 [s]");
}

template <class Law>
void bind_settings_of(py::module_& m, const char* name, const char* text) {
  using S = Settings<Law>;
  py::class_<S>(m, name, text)
      .def(py::init<>())
      .def_readwrite("robot", &S::robot)
      .def_readwrite("camera", &S::camera)
      .def_readwrite("convention", &S::convention)
      .def_readwrite("sampling", &S::sampling)
      .def_readwrite("sensors", &S::sensors)
      .def_readwrite("actuators", &S::actuators)
      .def_readwrite("base_motion", &S::base_motion)
      .def_readwrite("on_limit", &S::on_limit)
      .def_readwrite("jacobian", &S::jacobian)
      .def_readwrite("target", &S::target)
      .def_readwrite("uncertainty", &S::uncertainty)
      .def_readwrite("switching", &S::switching)
      .def_readwrite("safe", &S::safe)
      .def_readwrite("gains", &S::gains)
      .def_readwrite("simulation", &S::simulation)
      .def_readwrite("metrics", &S::metrics)
      .def_readwrite("seed", &S::seed)
      .def(
          "validate", [](const S& s) { check_settings(s); },
          "ValueError('key: expected ..., got ...') for the first thing that is wrong.");
}

}  // namespace

void bind_settings(py::module_& m) {
  py::native_enum<SwitchingKind>(m, "SwitchingKind", "enum.Enum")
      .value("sign", SwitchingKind::sign)
      .value("tanh", SwitchingKind::tanh)
      .value("saturation", SwitchingKind::saturation)
      .value("implicit", SwitchingKind::implicit)
      .value("implicit_coupled", SwitchingKind::implicit_coupled)
      .finalize();
  py::native_enum<LoopMode>(m, "LoopMode", "enum.Enum")
      .value("continuous", LoopMode::continuous)
      .value("sampled", LoopMode::sampled)
      .finalize();
  py::native_enum<Prediction>(m, "Prediction", "enum.Enum")
      .value("none", Prediction::none)
      .value("encoder", Prediction::encoder)
      .finalize();
  py::native_enum<LostFeature>(m, "LostFeature", "enum.Enum")
      .value("hold", LostFeature::hold)
      .value("predict", LostFeature::predict)
      .value("stop", LostFeature::stop)
      .finalize();

  using Faults = FrameSettings<double>;
  py::class_<Faults>(m, "FrameSettings", "Faults of the camera in sampled mode, and what stands in for missing images.")
      .def(py::init<>())
      .def_readwrite("prediction", &Faults::prediction)
      .def_readwrite("on_lost", &Faults::on_lost)
      .def_readwrite("noise", &Faults::noise, "standard deviation [px]")
      .def_readwrite("quantisation", &Faults::quantisation, "[px]; 0: none")
      .def_readwrite("dropout", &Faults::dropout, "probability [1]")
      .def_readwrite("outlier_probability", &Faults::outlier_probability, "[1]")
      .def_readwrite("outlier_size", &Faults::outlier_size, "standard deviation [px]")
      .def_readwrite("image_size", &Faults::image_size, "(2,) width and height [px]; infinite: no border");

  py::class_<CameraSampling>(m, "CameraSampling", "The camera in sampled mode.")
      .def(py::init<>())
      .def_readwrite("period", &CameraSampling::period, "between two exposures [s]")
      .def_readwrite("latency", &CameraSampling::latency, "from exposure to first use [s]")
      .def_readwrite("latency_jitter", &CameraSampling::latency_jitter, "most that it is longer [s]")
      .def_readwrite("timeout", &CameraSampling::timeout, "oldest image that is used [s]; infinite: any")
      .def_readwrite("faults", &CameraSampling::faults);

  py::class_<Switching<double>>(m, "Switching", "Stand-in for sgn in (15) of the paper.")
      .def(py::init<>())
      .def_readwrite("kind", &Switching<double>::kind)
      .def_readwrite("width", &Switching<double>::width, "of tanh and saturation [m/s; rad/s]");

  py::class_<SafeSettings>(m, "SafeSettings", "The brake that acts where the law may not.")
      .def(py::init<>())
      .def_readwrite("damping", &SafeSettings::damping, "(6,) diagonal of K_s [N s/m; N m s/rad]; or None: derived")
      .def_readwrite("hold", &SafeSettings::hold, "(6,) diagonal of K_h [N/m; N m/rad]; or None: derived");

  py::class_<HybridGains<double>>(m, "HybridGains", "Gains of the law hybrid, (14), (15) of the paper.")
      .def(py::init<>())
      .def_readwrite("kp", &HybridGains<double>::kp, "(8,) diagonal of K_p [N m/px^2]")
      .def_readwrite("kv", &HybridGains<double>::kv, "(6,) diagonal of K_v [N; N m]")
      .def_readwrite("fuzzy", &HybridGains<double>::fuzzy);

  using Composed = CompositeGains<double>;
  py::class_<Composed>(m, "CompositeGains", "Gains of the law composite.")
      .def(py::init<>())
      .def_readwrite("kp", &Composed::kp, "(8,) diagonal of K_p [N m/px^2]")
      .def_readwrite("kv", &Composed::kv, "(6,) diagonal of K_v [N; N m]")
      .def_readwrite("kt", &Composed::kt, "(6,) diagonal of K_t [N/m; N m/rad]")
      .def_readwrite("kd", &Composed::kd, "(6,) diagonal of K_d [N s/m; N m s/rad]")
      .def_readwrite("drive", &Composed::drive, "(6,) diagonal of Lambda [1/s]")
      .def_readwrite("prior", &Composed::prior, "(6,) diagonal of M [px^2/m^2; px^2/rad^2]")
      .def_readwrite("fuzzy", &Composed::fuzzy, "error_scale [1/m; 1/rad], rate_scale [s/m; s/rad]");

  using KellyLaw = KellyGains<double>;
  py::class_<KellyLaw>(m, "KellyGains", "Gains of the law kelly.")
      .def(py::init<>())
      .def_readwrite("kp", &KellyLaw::kp, "(8,) diagonal of K_p [N m/px^2]")
      .def_readwrite("kd", &KellyLaw::kd, "(6,) diagonal of K_d [N s/m; N m s/rad]");

  py::native_enum<JacobianPoint>(m, "JacobianPoint", "enum.Enum")
      .value("current", JacobianPoint::current)
      .value("desired", JacobianPoint::desired)
      .value("mean", JacobianPoint::mean)
      .finalize();

  using Rate = ResolvedRateGains<double>;
  py::class_<Rate>(m, "ResolvedRateGains", "Gains of the law resolved_rate.")
      .def(py::init<>())
      .def_readwrite("gain", &Rate::gain, "lambda, or lambda_0 [1/s]")
      .def_readwrite("adaptive", &Rate::adaptive)
      .def_readwrite("gain_far", &Rate::gain_far, "lambda_inf [1/s]")
      .def_readwrite("gain_slope", &Rate::gain_slope, "s_0 [1/(s px)]")
      .def_readwrite("jacobian_at", &Rate::jacobian_at)
      .def_readwrite("ki", &Rate::ki, "(6,) diagonal of K_i [N s/m; N m s/rad]")
      .def_readwrite("damping", &Rate::damping, "(6,) diagonal of M [px^2/m^2; px^2/rad^2]");

  using PoseBased = PbvsGains<double>;
  py::class_<PoseBased>(m, "PbvsGains", "Gains of the law pbvs.")
      .def(py::init<>())
      .def_readwrite("kp", &PoseBased::kp, "(6,) diagonal of K_p [N/m; N m/rad]")
      .def_readwrite("kd", &PoseBased::kd, "(6,) diagonal of K_d [N s/m; N m s/rad]")
      .def_readwrite("prior", &PoseBased::prior, "(6,) diagonal of M [px^2/m^2; px^2/rad^2]");

  using Torque = ComputedTorqueGains<double>;
  py::class_<Torque>(m, "ComputedTorqueGains", "Gains of the law computed_torque.")
      .def(py::init<>())
      .def_readwrite("kp", &Torque::kp, "(6,) diagonal of K_p [1/s^2]")
      .def_readwrite("kd", &Torque::kd, "(6,) diagonal of K_d [1/s]")
      .def_readwrite("prior", &Torque::prior, "(6,) diagonal of M [px^2/m^2; px^2/rad^2]");

  py::class_<Target>(m, "Target", "Four points to look at, and where they shall appear.")
      .def(py::init<>())
      .def_readwrite("initial_features", &Target::initial_features, "(8,) seen from home [px]")
      .def_readwrite("depth", &Target::depth, "(4,) |Z| seen from home [m]")
      .def_property("points", &points_of, &set_points, "(4, 3) in B [m], instead of the two above; or None")
      .def_readwrite("desired_features", &Target::desired_features, "(8,) [px]");

  py::class_<Uncertainty>(m, "Uncertainty", "Relative errors between estimates and plant.")
      .def(py::init<>())
      .def_readwrite("dynamics", &Uncertainty::dynamics)
      .def_readwrite("depth", &Uncertainty::depth, "(4,) delta_Z [1]");

  py::class_<SimulationSettings>(m, "SimulationSettings", "Time grid and logging.")
      .def(py::init<>())
      .def_readwrite("mode", &SimulationSettings::mode)
      .def_readwrite("step", &SimulationSettings::step, "of the integration, or in sampled mode the servo period [s]")
      .def_readwrite("substeps", &SimulationSettings::substeps, "Runge-Kutta steps in a servo period")
      .def_readwrite("duration", &SimulationSettings::duration, "[s], a whole number of steps")
      .def_readwrite("log_every", &SimulationSettings::log_every, "steps between logged samples");

  m.def("step_count", &step_count, py::arg("simulation"), "Steps of a run; ValueError where they make no grid.");

  using Measured = MetricsSettings<double>;
  py::class_<Measured>(m, "MetricsSettings", "What is measured, when and against what.")
      .def(py::init<>())
      .def_readwrite("band", &Measured::band, "settled: every feature error is within this [px]")
      .def_readwrite("dwell", &Measured::dwell, "settled: and has been for this long at the end [s]")
      .def_readwrite("rms_start", &Measured::rms_start, "from here to the end the RMS error is taken [s]");

  bind_devices(m);
  bind_settings_of<Hybrid>(m, "HybridSettings", "A scenario for the law hybrid, as numbers.");
  bind_settings_of<Composite>(m, "CompositeSettings", "A scenario for the law composite, as numbers.");
  bind_settings_of<Kelly>(m, "KellySettings", "A scenario for the law kelly, as numbers.");
  bind_settings_of<ResolvedRate>(m, "ResolvedRateSettings", "A scenario for the law resolved_rate, as numbers.");
  bind_settings_of<Pbvs>(m, "PbvsSettings", "A scenario for the law pbvs, as numbers.");
  bind_settings_of<ComputedTorque>(m, "ComputedTorqueSettings", "A scenario for the law computed_torque, as numbers.");
}

}  // namespace hexservo::bindings
