/// @file
/// A platform on motors that hold positions, driven by commands that are known: what an identification fits
/// (docs/identification.md). The plant is that of motors.hpp (docs/model.md, section 7).
#pragma once

#include "hexservo/motors.hpp"
#include "hexservo/settings.hpp"

#include <span>
#include <vector>

namespace hexservo {

/// How such a response is computed.
struct MotorResponseSteps {
  double period = 1e-3;  ///< between two commands [s]
  int substeps = 1;      ///< of the Runge-Kutta steps in it, each `kMotorSteps` steps of the legs
};

/// Leg coordinates at each tick before its command is given [m], or [rad].
///
/// The platform starts at rest with commands that hold its weight there without friction.
/// @param robot legs, body and `force_limit` of the motors
/// @param start of the platform
/// @param commands where the legs are sent [m], or [rad]
/// @param delay of a command [ticks], 0 to `kMaxActuatorDelay`
/// @throws std::invalid_argument for a robot that is wrong
inline std::vector<Vector6<double>> motor_response(const RobotParameters& robot, const MotorParameters<double>& motor,
                                                   const Pose<double>& start, std::span<const Vector6<double>> commands,
                                                   long long delay, const MotorResponseSteps& steps) {
  const Hexapod<double> hexapod = make_hexapod(robot);
  const LegGeometry<double> geometry(hexapod);
  const Plant<double> plant(plant_body(robot), DynamicsError<double>{});
  const auto free = [&](double /*time*/, const BodyMotion<double>& body) {
    const Matrix3<double> R_BE = rotation_matrix(quaternion_of(body));
    const Vector6<double> twist = twist_of(body);
    return BodyDynamics<double>{plant.mass_matrix_at(R_BE),
                                -(plant.weight_at(R_BE) + plant.coriolis_matrix_at(R_BE, twist) * twist)};
  };
  const auto legs_at = [&](const BodyMotion<double>& body) {
    return inverse_kinematics(geometry, position_of(body), Matrix3<double>(rotation_matrix(quaternion_of(body))));
  };
  BodyMotion<double> body = BodyMotion<double>::at_rest(start);
  const LegsSideBySide<double> at_start = legs_at(body);
  const Vector6<double> held = WrenchMapSolver<double>(geometry, at_start).leg_forces(-free(0.0, body).wrench);
  ActuatorParameters<double> actuators;
  actuators.motor = motor;
  actuators.delay = delay;
  MotorLegs<double> motors(actuators, hexapod, steps.period / steps.substeps,
                           at_start.lengths.vector() + held / motor.kp);
  std::vector<Vector6<double>> response;
  response.reserve(commands.size());
  for (const Vector6<double>& command : commands) {
    response.push_back(legs_at(body).lengths.vector());
    motors.command(command);
    for (int step = 0; step < steps.substeps; ++step) motors.advance(body, free);
  }
  return response;
}

}  // namespace hexservo
