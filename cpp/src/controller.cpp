#include "hexservo/controller.hpp"

#include "check.hpp"

namespace hexservo {

namespace {

/// Numbers that a law can be evaluated with.
bool usable(const ControllerInput& input) noexcept {
  return is_finite(input.image.features) & is_finite(input.image.depth) & is_finite(input.pose.position) &
         is_finite(input.pose.quaternion) & is_finite(input.twist) & (input.pose.quaternion.squaredNorm() > 0.0) &
         (input.image.depth.maxCoeff() < 0.0);
}

}  // namespace

template <class Law>
ControllerGains<Law> controller_gains(const Settings<Law>& settings, double period) {
  detail::require_positive("period", period);
  const LoopParameters<double, Law> p = loop_parameters(settings);
  return {p.hexapod, control_task(p), p.gains, period};
}

template ControllerGains<Hybrid> controller_gains(const Settings<Hybrid>&, double);

template <class Law>
ControllerOutput step(const ControllerGains<Law>& gains, ControllerState<Law>& state,
                      const ControllerInput& input) noexcept {
  // A tick with an unusable input does the same work on harmless numbers, and its results are then not chosen.
  const bool usable_input = usable(input);
  const Image<double> image{select(usable_input, input.image.features, gains.task.desired_features),
                            select(usable_input, input.image.depth, Vector4<double>(Vector4<double>::Constant(-1.0)))};
  Pose<double> pose{select(usable_input, input.pose.position, state.last_pose.position),
                    select(usable_input, input.pose.quaternion, state.last_pose.quaternion)};
  const Vector6<double> twist = select(usable_input, input.twist, Vector6<double>(Vector6<double>::Zero()));

  const Matrix3<double> R_BE = rotation_matrix(pose.quaternion);
  const auto law = Law::evaluate(gains.task, gains.law, typename Law::template Stage<double>{&state.law},
                                 LawInput<double>{image, R_BE, twist});
  const WrenchMapSolver<double> solver(gains.hexapod, inverse_kinematics(gains.hexapod, pose.position, R_BE));
  const bool valid = usable_input & !solver.failed() & is_finite(law.wrench);

  ControllerOutput out;
  out.wrench = select(valid, law.wrench, gains.task.gravity_wrench);
  out.fuzzy_output = select(valid, law.fuzzy_output, Vector6<double>(Vector6<double>::Zero()));
  out.invalid_input = !valid;
  out.leg_forces = solver.leg_forces(out.wrench);
  if (solver.failed()) {  // never in a workspace that keeps its distance from singular poses
    const Matrix3<double> R_last = rotation_matrix(state.last_pose.quaternion);
    out.leg_forces =
        WrenchMapSolver<double>(gains.hexapod, inverse_kinematics(gains.hexapod, state.last_pose.position, R_last))
            .leg_forces(out.wrench);
  }

  Law::advance(state.law, std::array{&law.rate}, std::array{gains.period}, valid);
  state.last_pose.position = select(valid, pose.position, state.last_pose.position);
  state.last_pose.quaternion = select(valid, pose.quaternion, state.last_pose.quaternion);
  return out;
}

template ControllerOutput step(const ControllerGains<Hybrid>&, ControllerState<Hybrid>&,
                               const ControllerInput&) noexcept;

}  // namespace hexservo
