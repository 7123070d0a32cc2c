/// @file
/// The paper's scenario for tests, as docs/model.md (sections 4 and 5) gives it.
#pragma once

#include "hexservo/settings.hpp"

namespace hexservo::test {

/// Scenario `paper`; everything that is not set here is the core's own default.
template <class Law = Hybrid>
Settings paper_settings() {
  Settings settings = Settings::of<Law>();
  settings.target.initial_features << 30, 18, 65, -65, -44, 37, -10, -15;
  settings.target.desired_features << 10, 10, 45, -73, -64, 29, -30, -23;
  settings.uncertainty.inertia.setConstant(0.075);
  settings.uncertainty.coriolis.setConstant(0.125);
  settings.uncertainty.depth.setConstant(0.3);
  if constexpr (Law::traits.output == LawOutput::pose) {  // of no other machine
    settings.simulation.mode = LoopMode::sampled;
    settings.actuators.kind = ActuatorKind::position;
  }
  return settings;
}

/// The same without any error between estimates and plant.
inline Settings nominal_settings() {
  Settings settings = paper_settings();
  settings.uncertainty = {};
  return settings;
}

/// Checks gains as `loop_parameters` does, in that scenario.
template <class Law>
void validate_gains(const GainsOf<Law>& gains) {
  Settings settings = paper_settings<Law>();
  settings.gains<Law>() = gains;
  loop_parameters<Law>(settings);
}

/// What the derived brake takes from the weight at the first tick of a stretch, K_s chi-dot [N; N m].
/// @param gains of a controller
/// @param input its input at that tick
template <class Gains, class Input>
Vector6<double> brake_of(const Gains& gains, const Input& input) {
  const Vector6<double> rate = gains.safe.damping_rate * input.twist;
  return inertial_wrench(gains.body, rotation_matrix(input.pose.quaternion), rate);
}

}  // namespace hexservo::test
