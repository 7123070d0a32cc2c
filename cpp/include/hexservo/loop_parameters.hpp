/// @file
/// Everything that a loop needs, prepared and validated by `loop_parameters` (settings.hpp).
#pragma once

#include "hexservo/actuators.hpp"
#include "hexservo/encoders.hpp"
#include "hexservo/frames.hpp"
#include "hexservo/laws/law.hpp"
#include "hexservo/metrics.hpp"
#include "hexservo/safe_output.hpp"
#include "hexservo/target_motion.hpp"

namespace hexservo {

/// How plant and law go together.
enum class LoopMode {
  continuous,  ///< the law acts inside every Runge-Kutta stage, as the paper simulates it
  sampled      ///< camera and servo have periods and latencies, and the wrench is held between two ticks
};

/// Numbers of one scenario, or of one per lane, but for what belongs to its law.
template <class S, int N = kPoints>
struct SceneParameters {
  Hexapod<S> hexapod;
  RigidBody<S> body;        ///< as the controller assumes it
  RigidBody<S> plant_body;  ///< what the platform carries, but for its relative errors
  DynamicsError<S> dynamics_error;
  CameraParameters<S> camera;          ///< the true one
  CameraParameters<S> assumed_camera;  ///< the controller's
  LensParameters<S> lens;              ///< of the true camera
  LensParameters<S> assumed_lens;      ///< of the controller's
  CameraConvention convention = CameraConvention::eye_in_hand;
  JacobianConvention jacobian = JacobianConvention::consistent;
  Eigen::Matrix<S, 3, N> points_T;    ///< target points in B, or in E for a camera on the base [m]; not `as_printed`
  Image<S, N> initial_image;          ///< seen from home [px; m]
  Vector<S, 2 * N> desired_features;  ///< xi_d [px]
  Vector<S, 2 * N> assumed_initial;   ///< what the controller's camera makes of the pixels of the initial image [px]
  Vector<S, 2 * N> assumed_desired;   ///< and of those of the desired one [px]
  Vector<S, N> depth_error;           ///< delta_Z,i [1]
  Vector<S, N> weights = Vector<S, N>::Ones();  ///< w_i; 0 in the places beyond the points
  int points = N;                               ///< of the target; the first one is in the places beyond them
  Pose<S> start;                                ///< of a run
  Vector6<S> start_twist;                       ///< likewise, in B [m/s; rad/s]
  Pose<S> goal;  ///< where the assumed points give xi_d; home for laws that do not use it
  Switching<S> switching;
  LoopMode mode = LoopMode::continuous;
  double step = 1e-3;       ///< h of the Runge-Kutta method; in `sampled` mode the servo period T_c [s]
  long long substeps = 1;   ///< Runge-Kutta steps in a servo period
  FrameSettings<S> frames;  ///< of the camera in `sampled` mode
  PoseSource pose_source = PoseSource::truth;
  EncoderParameters<S> encoders;                    ///< where they are the pose's source
  ActuatorParameters<S> actuators;                  ///< in `sampled` mode
  SafeGains<S> safe;                                ///< in `sampled` mode
  Vector6<S> virtual_damping = Vector6<S>::Zero();  ///< D_v, of machines that take positions [N s/m; N m s/rad]
  BaseMotionParameters<S> base_motion;              ///< in `sampled` mode
  TargetFrame target_frame = TargetFrame::base;
  TargetMotionParameters<S> target_motion;  ///< in `sampled` mode
  LimitPolicy on_limit = LimitPolicy::report;
  long long limits_every = 1;  ///< samples from one at which limits, and metrics of the legs, are looked at
  SeedHalves<S> seed;
  MetricsSettings<S> metrics;
  Recording recorded;         ///< of the base; not visited: it is shared, and no number
  Recording recorded_target;  ///< of the target; likewise
  MetricGroups measured;      ///< groups of metrics that are asked for
  bool samples_legs = true;   ///< whether every sample has its leg lengths and forces; else the last one alone

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"hexapod"}, self.hexapod...);
    v(Field{"body"}, self.body...);
    v(Field{"plant_body"}, self.plant_body...);
    v(Field{"dynamics_error"}, self.dynamics_error...);
    v(Field{"camera"}, self.camera...);
    v(Field{"assumed_camera"}, self.assumed_camera...);
    v(Field{"lens"}, self.lens...);
    v(Field{"assumed_lens"}, self.assumed_lens...);
    v(Field{"convention"}, self.convention...);
    v(Field{"jacobian"}, self.jacobian...);
    v(Field{"points_T"}, self.points_T...);
    v(Field{"initial_image"}, self.initial_image...);
    v(Field{"desired_features"}, self.desired_features...);
    v(Field{"assumed_initial"}, self.assumed_initial...);
    v(Field{"assumed_desired"}, self.assumed_desired...);
    v(Field{"depth_error"}, self.depth_error...);
    v(Field{"weights"}, self.weights...);
    v(Field{"points"}, self.points...);
    v(Field{"start"}, self.start...);
    v(Field{"start_twist"}, self.start_twist...);
    v(Field{"goal"}, self.goal...);
    v(Field{"switching"}, self.switching...);
    v(Field{"mode"}, self.mode...);
    v(Field{"step"}, self.step...);
    v(Field{"substeps"}, self.substeps...);
    v(Field{"frames"}, self.frames...);
    v(Field{"pose_source"}, self.pose_source...);
    v(Field{"encoders"}, self.encoders...);
    v(Field{"actuators"}, self.actuators...);
    v(Field{"safe"}, self.safe...);
    v(Field{"virtual_damping"}, self.virtual_damping...);
    v(Field{"base_motion"}, self.base_motion...);
    v(Field{"target_frame"}, self.target_frame...);
    v(Field{"target_motion"}, self.target_motion...);
    v(Field{"on_limit"}, self.on_limit...);
    v(Field{"limits_every"}, self.limits_every...);
    v(Field{"seed"}, self.seed...);
    v(Field{"metrics"}, self.metrics...);
  }
};

/// All numbers of one scenario, or of one per lane.
template <class S, class Law, int N = kPoints>
struct LoopParameters : SceneParameters<S, N> {
  typename Law::template Gains<S, N> gains;  ///< those of the image's coordinates have the weights in them

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    SceneParameters<S, N>::visit(v, scene(self)...);  // one function for the scenes of all laws
    v(Field{"gains"}, self.gains...);
  }

 private:
  template <class T, int M>
  static SceneParameters<T, M>& scene(SceneParameters<T, M>& p) {
    return p;
  }
  template <class T, int M>
  static const SceneParameters<T, M>& scene(const SceneParameters<T, M>& p) {
    return p;
  }
};

/// P-hat_i of a loop's controller, 3xN in T [m].
template <class S, int N>
Eigen::Matrix<S, 3, N> believed_points(const SceneParameters<S, N>& p) {
  const PlatformCamera<S> camera(p.assumed_camera);
  return believed_points<S, N>(camera, home_pose(p.hexapod), {p.assumed_initial, p.initial_image.depth}, p.depth_error);
}

/// The task of a loop's law: estimates, goal and reference.
template <class S, int N>
ControlTask<S, N> control_task(const SceneParameters<S, N>& p) {
  const PlatformCamera<S> camera(p.assumed_camera);
  const Pose<S> home = home_pose(p.hexapod);
  return {camera,
          S(controller_sign(p.convention, p.jacobian)),
          p.assumed_desired,
          gravity_wrench(p.body),
          p.switching,
          home,
          p.body,
          S(p.step),
          target_model<S, N>(camera, believed_points<S, N>(p), p.goal),
          PointWeights<S, N>(p.weights)};
}

}  // namespace hexservo
