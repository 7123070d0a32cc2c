#include "hexservo/controller.hpp"

#include "check.hpp"
#include "hexservo/subnormals.hpp"

namespace hexservo {

namespace {

/// Numbers that a law can be evaluated with: all finite, and within the limits where a run counts as diverged.
bool usable(const ControllerInput& input, const ControlTask<double>& task) noexcept {
  // A comparison with NaN is false, and so is each of these.
  const double squared_length = input.pose.quaternion.squaredNorm();
  return ((task.desired_features - input.image.features).array().abs() <= kMaxFeatureError).all() &
         (input.image.depth.array() < 0.0).all() & is_finite(input.image.depth) & is_finite(input.pose.position) &
         (squared_length > 0.0) & is_finite(squared_length) & (input.twist.array().abs() <= kMaxTwist).all();
}

/// What is wrong with an input that cannot be used.
InputStatus why(const ControllerInput& input, bool fresh) noexcept {
  if (input.image.features.array().isNaN().all()) return InputStatus::missing_image;
  return fresh ? InputStatus::unusable : InputStatus::stale_image;
}

/// Leg forces that give a wrench at a pose [N].
Vector6<double> forces_at(const LegGeometry<double>& geometry, const Pose<double>& pose,
                          const Vector6<double>& wrench) noexcept {
  const auto legs = inverse_kinematics(geometry, pose.position, rotation_matrix(pose.quaternion));
  return WrenchMapSolver<double>(geometry, legs).leg_forces(wrench);
}

}  // namespace

template <class Law>
ControllerGains<Law> controller_gains(const Settings<Law>& settings, double period) {
  detail::require_positive("period", period);
  Settings<Law> ticking = settings;  // on the tick's own grid, and without what belongs to the plant and its sensors
  ticking.uncertainty = {};
  ticking.simulation = {LoopMode::sampled, period, 1, period, 1};
  ticking.sampling = {period};
  ticking.sensors = {};
  ticking.actuators = {};
  ticking.base_motion = {};
  const LoopParameters<double, Law> p = loop_parameters(ticking);
  if constexpr (kHasFuzzySystems<Law>)
    require_resolved(p.gains.fuzzy, detail::words("controller.", Law::name, ".fuzzy."), period);
  return {p.hexapod,
          LegGeometry<double>(p.hexapod),
          control_task(p),
          typename Law::template Constants<double>(p.gains),
          Law::initial_state(p.gains),
          period,
          settings.sampling.timeout};
}

template <int alignment>
void library_was_built_with_other_instruction_set_flags() noexcept {}

template void library_was_built_with_other_instruction_set_flags<EIGEN_MAX_ALIGN_BYTES>() noexcept;

template <class Law>
ControllerOutput step(const ControllerGains<Law>& gains, ControllerState<Law>& state,
                      const ControllerInput& input) noexcept {
  const FlushSubnormals flush;
  // Any number may go through this; what comes of unusable ones is not taken over.
  const Matrix3<double> R_BE = rotation_matrix(input.pose.quaternion);
  const Vector<double, kPoints> inverse_depth = input.image.depth.cwiseInverse();
  typename Law::template Evaluation<double> law;
  Law::evaluate(gains.task, gains.law, typename Law::template Stage<double>{&state.law},
                LawInput<double>{input.image.features, inverse_depth, R_BE, input.twist, input.pose}, law);
  const WrenchMapSolver<double> solver(gains.legs, inverse_kinematics(gains.legs, input.pose.position, R_BE));
  const Vector6<double> leg_forces = solver.leg_forces(law.wrench);
  // Forces that are finite come of a wrench that is.
  const bool valid = usable(input, gains.task) & !solver.failed() & is_finite(leg_forces);
  const bool fresh = input.image_age <= gains.image_timeout;  // not where it is NaN

  if (!(valid & fresh)) {
    const Vector6<double>& wrench = gains.task.gravity_wrench;
    return {wrench, forces_at(gains.legs, state.last_pose, wrench), Vector6<double>::Zero(), why(input, fresh)};
  }
  Law::advance(gains.law, state.law, std::array<const typename Law::template Rate<double>*, 1>{&law.rate},
               std::array{gains.period}, true);
  state.last_pose = input.pose;
  return {law.wrench, leg_forces, law.fuzzy_output, InputStatus::valid};
}

#define HEXSERVO_HERE(Law)                                                      \
  template ControllerGains<Law> controller_gains(const Settings<Law>&, double); \
  template ControllerOutput step(const ControllerGains<Law>&, ControllerState<Law>&, const ControllerInput&) noexcept;
HEXSERVO_FOR_EACH_LAW(HEXSERVO_HERE)
#undef HEXSERVO_HERE

}  // namespace hexservo
