// hexservo gains, format 1
// The controller of the scenario "paper", written by `hexservo export` of hexservo 0.2.0.
// Not to be edited: change the scenario and run `hexservo export --force` again.
// clang-format off
#pragma once

#include <hexservo/controller.hpp>

#include <limits>

#ifndef HEXSERVO_GAINS  // for a program that takes whatever header it is given
#define HEXSERVO_GAINS hexservo_paper
#endif

#ifdef HEXSERVO_GAINS_OF_hexservo_paper
#error "two headers of hexservo export with the namespace hexservo_paper: rename one of the scenarios"
#endif
#define HEXSERVO_GAINS_OF_hexservo_paper

namespace hexservo_paper {
inline namespace contents_347b6de10d7525cd {  // no other header has these symbols

using Law = hexservo::Hybrid;

inline constexpr const char* scenario_name = "paper";

/// T_c, time between two ticks [s].
inline constexpr double period = 0.001;

/// Robot, camera, sensors, goal, gains, settling; vectors of six: forces x y z, then moments x y z.
inline hexservo::Settings settings() {
  hexservo::Settings s = hexservo::Settings::of<Law>();
  hexservo::GainsOf<Law>& gains = s.gains<Law>();
  s.robot.platform_radius = 0.1;  // [m]
  s.robot.base_radius = 0.2;  // [m]
  s.robot.platform_angles << -0.8726646259971648, 0.8726646259971648, 1.2217304763960306, 2.9670597283903604, 3.3161255787892263, 5.061454830783555;  // [rad]
  s.robot.base_angles << -0.17453292519943295, 0.17453292519943295, 1.9198621771937625, 2.2689280275926285, 4.014257279586958, 4.363323129985823;  // [rad]
  s.robot.home_position << 0.0, 0.0, -0.15;  // [m]
  s.robot.home_attitude << 0.0, 0.0, 0.0;  // [rad]
  s.robot.legs = hexservo::LegKind::prismatic;
  s.robot.gravity << 0.0, 0.0, 9.8;  // [m/s^2]
  s.robot.mass = 0.06;  // [kg]
  s.robot.inertia <<  // [kg m^2]
      0.00015, 0.0, 0.0,
      0.0, 0.00015, 0.0,
      0.0, 0.0, 0.0003;
  s.robot.centre_of_mass << 0.0, 0.0, 0.0;  // [m]
  s.robot.payload.mass = 0.0;  // [kg]
  s.robot.payload.position << 0.0, 0.0, 0.0;  // [m]
  s.robot.payload.inertia <<  // [kg m^2]
      0.0, 0.0, 0.0,
      0.0, 0.0, 0.0,
      0.0, 0.0, 0.0;
  s.robot.payload.known = true;
  s.robot.stroke = 0.017;  // [m]
  s.robot.stroke_centre = 0.0;  // [m]
  s.robot.force_limit = 1.0;  // [N]
  s.camera.focal_length = 0.008;  // [m]
  s.camera.pixel_scale = 72727.0;  // [px/m]
  s.camera.axes = hexservo::CameraAxes::paper;
  s.camera.mount.position << 0.0, 0.0, 0.0;  // [m]
  s.camera.mount.rotation << 0.0, 0.0, 0.0;  // [rad]
  s.camera.mount.on = hexservo::MountedOn::platform;
  s.camera.convention = hexservo::CameraConvention::eye_in_hand;
  s.target.initial_features << 30.0, 18.0, 65.0, -65.0, -44.0, 37.0, -10.0, -15.0;  // [px]
  s.target.desired_features << 10.0, 10.0, 45.0, -73.0, -64.0, 29.0, -30.0, -23.0;  // [px]
  s.target.depth << 0.5, 0.5, 0.5, 0.5;  // [m]
  s.uncertainty.depth << 0.3, 0.3, 0.3, 0.3;  // [1]
  s.uncertainty.mount.position << 0.0, 0.0, 0.0;  // [m]
  s.uncertainty.mount.rotation << 0.0, 0.0, 0.0;  // [rad]
  s.controller.jacobian = hexservo::JacobianConvention::consistent;
  s.controller.switching.kind = hexservo::SwitchingKind::sign;
  s.controller.switching.width = 0.001;  // [m/s; rad/s]
  gains.kp << 1e-06, 1e-06, 1e-06, 1e-06, 1e-06, 1e-06, 1e-06, 1e-06;  // [N m/px^2]
  gains.kv << 0.002, 0.002, 0.002, 0.0001, 0.0001, 0.0001;  // [N; N m]
  gains.fuzzy.enabled = true;
  gains.fuzzy.adaptation << 10.0, 10.0, 10.0, 10.0, 10.0, 10.0;  // [m/N; rad/(N m)]
  gains.fuzzy.error_scale << 5.0, 5.0, 5.0, 10.0, 10.0, 10.0;  // [1/N; 1/(N m)]
  gains.fuzzy.rate_scale << 0.5, 0.5, 0.5, 0.5, 0.5, 0.5;  // [s/N; s/(N m)]
  gains.fuzzy.initial_scale << 0.0, 0.0, 0.0, 0.0, 0.0, 0.0;  // [N; N m]
  gains.fuzzy.table <<  // [1]
      -1.0, -1.0, -1.0, -1.0, -0.6666666666666666, -0.3333333333333333, 0.0,
      -1.0, -1.0, -1.0, -0.6666666666666666, -0.3333333333333333, 0.0, 0.3333333333333333,
      -1.0, -1.0, -0.6666666666666666, -0.3333333333333333, 0.0, 0.3333333333333333, 0.6666666666666666,
      -1.0, -0.6666666666666666, -0.3333333333333333, 0.0, 0.3333333333333333, 0.6666666666666666, 1.0,
      -0.6666666666666666, -0.3333333333333333, 0.0, 0.3333333333333333, 0.6666666666666666, 1.0, 1.0,
      -0.3333333333333333, 0.0, 0.3333333333333333, 0.6666666666666666, 1.0, 1.0, 1.0,
      0.0, 0.3333333333333333, 0.6666666666666666, 1.0, 1.0, 1.0, 1.0;
  gains.fuzzy.bell_width = 0.16666666666666666;  // [1]
  gains.fuzzy.bell_slope = 2.0;  // [1]
  gains.fuzzy.leakage << 0.0, 0.0, 0.0, 0.0, 0.0, 0.0;  // [1/s]
  gains.fuzzy.weight_limit << std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity();  // [N; N m]
  gains.fuzzy.dead_zone << 0.0, 0.0, 0.0, 0.0, 0.0, 0.0;  // [m/s; rad/s]
  s.simulation.mode = hexservo::LoopMode::continuous;
  s.simulation.step = 0.001;  // [s]
  s.metrics.band = 2.0;  // [px]
  s.metrics.dwell = 0.2;  // [s]
  return s;
}

/// What `hexservo::step` needs.
inline hexservo::ControllerGains<Law> controller_gains() {
  return hexservo::controller_gains<Law>(settings(), period);
}

}  // namespace contents_347b6de10d7525cd
}  // namespace hexservo_paper
