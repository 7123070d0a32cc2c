/// @file
/// Everything that a loop needs, prepared and validated by `loop_parameters` (settings.hpp).
#pragma once

#include "hexservo/actuators.hpp"
#include "hexservo/base_motion.hpp"
#include "hexservo/encoders.hpp"
#include "hexservo/frames.hpp"
#include "hexservo/laws/law.hpp"
#include "hexservo/metrics.hpp"
#include "hexservo/safe_output.hpp"

namespace hexservo {

/// How plant and law go together.
enum class LoopMode {
  continuous,  ///< the law acts inside every Runge-Kutta stage, as the paper simulates it
  sampled      ///< camera and servo have periods and latencies, and the wrench is held between two ticks
};

/// What a leg beyond its stroke means, in `sampled` mode.
enum class LimitPolicy {
  report,  ///< an event, with time and peak
  stop     ///< the end of the run, with `Outcome::leg_limit`
};

/// Numbers of one scenario, or of one per lane.
template <class S, class Law, int N = kPoints>
struct LoopParameters {
  Hexapod<S> hexapod;
  RigidBody<S> body;
  DynamicsError<S> dynamics_error;
  Camera<S> camera;
  CameraConvention convention = CameraConvention::eye_in_hand;
  JacobianConvention jacobian = JacobianConvention::consistent;
  Eigen::Matrix<S, 3, N> points_B;    ///< target points [m]; not used by `as_printed`
  Image<S, N> initial_image;          ///< seen from home [px; m]
  Vector<S, 2 * N> desired_features;  ///< xi_d [px]
  Vector<S, N> depth_error;           ///< delta_Z,i [1]
  Pose<S> goal;                       ///< where the assumed points give xi_d; home for laws that do not use it
  Switching<S> switching;
  typename Law::template Gains<S> gains;
  LoopMode mode = LoopMode::continuous;
  double step = 1e-3;       ///< h of the Runge-Kutta method; in `sampled` mode the servo period T_c [s]
  long long substeps = 1;   ///< Runge-Kutta steps in a servo period
  FrameSettings<S> frames;  ///< of the camera in `sampled` mode
  PoseSource pose_source = PoseSource::truth;
  EncoderParameters<S> encoders;        ///< where they are the pose's source
  ActuatorParameters<S> actuators;      ///< in `sampled` mode
  SafeGains<S> safe;                    ///< in `sampled` mode
  BaseMotionParameters<S> base_motion;  ///< in `sampled` mode
  LimitPolicy on_limit = LimitPolicy::report;
  SeedHalves<S> seed;
  MetricsSettings<S> metrics;
  RecordedAcceleration recorded;  ///< of the base; not visited: it is shared, and no number

  template <class F, class A, class B>
  static void visit(F&& f, A& a, B& b) {
    f(a.hexapod, b.hexapod);
    f(a.body, b.body);
    f(a.dynamics_error, b.dynamics_error);
    f(a.camera, b.camera);
    f(a.convention, b.convention);
    f(a.jacobian, b.jacobian);
    f(a.points_B, b.points_B);
    f(a.initial_image, b.initial_image);
    f(a.desired_features, b.desired_features);
    f(a.depth_error, b.depth_error);
    f(a.goal, b.goal);
    f(a.switching, b.switching);
    f(a.gains, b.gains);
    f(a.mode, b.mode);
    f(a.step, b.step);
    f(a.substeps, b.substeps);
    f(a.frames, b.frames);
    f(a.pose_source, b.pose_source);
    f(a.encoders, b.encoders);
    f(a.actuators, b.actuators);
    f(a.safe, b.safe);
    f(a.base_motion, b.base_motion);
    f(a.on_limit, b.on_limit);
    f(a.seed, b.seed);
    f(a.metrics, b.metrics);
  }
};

/// The task of a loop's law: estimates, goal and reference.
template <class S, class Law, int N>
ControlTask<S, N> control_task(const LoopParameters<S, Law, N>& p) {
  const S f = p.camera.focal_pixels();
  const Pose<S> home = home_pose(p.hexapod);
  return {f,
          S(controller_sign(p.convention, p.jacobian)),
          p.desired_features,
          gravity_wrench(p.body),
          p.switching,
          home,
          p.body,
          S(p.step),
          target_model(f, believed_points(f, home, p.initial_image, p.depth_error), p.goal)};
}

}  // namespace hexservo
