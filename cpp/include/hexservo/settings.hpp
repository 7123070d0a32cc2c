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

/// Four points to look at, given by what the camera sees from home or by where they are, and where they shall appear.
struct Target {
  Vector<double, 2 * kPoints> initial_features = Vector<double, 2 * kPoints>::Zero();  ///< seen from home [px]
  Vector<double, kPoints> depth = Vector<double, kPoints>::Constant(0.5);  ///< |Z_i| seen from home [m], 0.5
  std::optional<Eigen::Matrix<double, 3, kPoints>> points_B;  ///< instead of the two above: the points in B [m]
  Vector<double, 2 * kPoints> desired_features = Vector<double, 2 * kPoints>::Zero();  ///< xi_d [px]
};

/// Relative errors between estimates and plant, docs/model.md, sections 3 and 4.
struct Uncertainty {
  DynamicsError<double> dynamics;                                   ///< delta_D, delta_C, delta_G [1], 0
  Vector<double, kPoints> depth = Vector<double, kPoints>::Zero();  ///< delta_Z,i [1], 0
};

/// The camera in `sampled` mode; every time is a whole number of servo periods.
struct CameraSampling {
  double period = 1e-3;                                      ///< between two exposures [s], 1e-3
  double latency = 0.0;                                      ///< from exposure to first use [s], 0
  double latency_jitter = 0.0;                               ///< most that the latency of a frame is longer [s], 0
  double timeout = std::numeric_limits<double>::infinity();  ///< oldest image that is used, by its exposure [s]
  FrameSettings<double> faults{};  ///< everything but its times, which follow from those above
};

/// How the controller knows pose and twist in `sampled` mode.
struct SensorSettings {
  PoseSource pose = PoseSource::truth;
  double period = 0.0;                 ///< between two readings of the encoders [s]; 0: every servo period
  EncoderParameters<double> encoders;  ///< everything but their period, which follows from the one above
};

/// The actuators in `sampled` mode.
struct ActuatorSettings {
  double delay = 0.0;                    ///< a whole number of servo periods [s], 0
  ActuatorParameters<double> actuators;  ///< everything but their delay, which follows from the one above
};

/// How the base moves in `sampled` mode.
struct BaseMotionSettings {
  BaseMotionParameters<double> motion;
  std::shared_ptr<const std::vector<double>> samples;  ///< recorded a_x, a_y, a_z, one after the other [m/s^2], or none
  double sample_period = 0.0;                          ///< of what is recorded, from t = 0 [s]
};

/// Time grid and logging of a run.
struct SimulationSettings {
  LoopMode mode = LoopMode::continuous;
  double step = 1e-3;       ///< h, or in `sampled` mode the servo period T_c [s], 1e-3
  long long substeps = 1;   ///< Runge-Kutta steps in a servo period, in `sampled` mode, 1
  double duration = 5.0;    ///< [s], 5; a whole number of steps
  long long log_every = 1;  ///< steps between logged samples, 1
};

/// A scenario for one law.
template <class Law>
struct Settings {
  RobotParameters robot;
  Camera<double> camera;
  CameraConvention convention = CameraConvention::eye_in_hand;
  CameraSampling sampling;
  SensorSettings sensors;
  ActuatorSettings actuators;
  BaseMotionSettings base_motion;
  LimitPolicy on_limit = LimitPolicy::report;
  JacobianConvention jacobian = JacobianConvention::consistent;
  Target target;
  Uncertainty uncertainty;
  Switching<double> switching;
  typename Law::template Gains<double> gains;
  SimulationSettings simulation;
  MetricsSettings<double> metrics;
  std::uint64_t seed = 0;  ///< of everything random
};

/// Number of steps of a run.
/// @throws std::invalid_argument naming the scenario key where step, duration or log_every make no grid
long long step_count(const SimulationSettings& simulation);

/// Validates a scenario and prepares it for the loop: joints, target points, initial image.
/// @param legs what `make_hexapod` made of `settings.robot`, where the caller has it: most of the work is there
/// @throws std::invalid_argument("key: expected ..., got ...") for the first thing that is wrong
template <class Law>
LoopParameters<double, Law> loop_parameters(const Settings<Law>& settings, const Hexapod<double>* legs = nullptr);

// One translation unit compiles the loops of each law (cpp/src/laws).
#define HEXSERVO_ELSEWHERE(Law)                   \
  extern template class ClosedLoop<double, Law>;  \
  extern template class SampledLoop<double, Law>; \
  extern template LoopParameters<double, Law> loop_parameters(const Settings<Law>&, const Hexapod<double>*);
HEXSERVO_FOR_EACH_LAW(HEXSERVO_ELSEWHERE)
#undef HEXSERVO_ELSEWHERE

}  // namespace hexservo
