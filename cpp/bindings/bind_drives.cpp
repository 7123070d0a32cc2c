#include "bindings.hpp"

#include "hexservo/latency_estimator.hpp"
#include "hexservo/motor_response.hpp"
#include "hexservo/position_actuators.hpp"
#include "hexservo/target_tracking.hpp"

#include <cmath>
#include <limits>
#include <vector>

namespace hexservo::bindings {

namespace {

/// One drive at the ticks of its commands, each read before the command is given.
py::array_t<double> drive_response(const py::array_t<double, py::array::c_style | py::array::forcecast>& commands,
                                   double position, double rate, double period, double bandwidth, double damping,
                                   double speed_limit, double acceleration_limit) {
  if (commands.ndim() != 1) throw py::value_error("commands: expected shape (n,)");
  const PositionResponse<double> drive{bandwidth, damping, speed_limit, acceleration_limit};
  const PositionedLeg<double> leg(drive, leg_steps(drive, period), period);
  rate = leg.first_rate(rate);
  const auto command = commands.unchecked<1>();
  py::array_t<double> response(commands.shape(0));
  auto out = response.mutable_unchecked<1>();
  for (py::ssize_t tick = 0; tick < command.shape(0); ++tick) {
    out(tick) = position;
    double way = position - command(tick);
    leg.advance(way, rate);
    position = command(tick) + way;
  }
  return response;
}

using Rows = Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::RowMajor>;

/// Six motors and their platform, likewise.
Rows six_motors(const Settings& settings, const Rows& commands, const Vector3<double>& position,
                const Vector4<double>& quaternion) {
  const ActuatorSettings& actuators = settings.actuators;
  std::vector<Vector6<double>> ticks;
  for (const auto& row : commands.rowwise()) ticks.emplace_back(row.transpose());
  const auto response = motor_response(settings.robot, actuators.motor, checked_pose(position, quaternion), ticks,
                                       std::llround(actuators.delay / settings.simulation.step),
                                       {settings.simulation.step, static_cast<int>(settings.simulation.substeps)});
  Rows out(commands.rows(), 6);
  for (std::size_t tick = 0; tick < response.size(); ++tick)
    out.row(static_cast<Eigen::Index>(tick)) = response[tick].transpose();
  return out;
}

/// Those that motors need at home.
double least_substeps(const Settings& settings) {
  const Hexapod<double> hexapod = make_hexapod(settings.robot);
  return motor_substeps(Plant<double>(plant_body(settings.robot), DynamicsError<double>{}), hexapod, home_pose(hexapod),
                        settings.actuators.motor, settings.simulation.step);
}

}  // namespace

void bind_drives(py::module_& m) {
  m.attr("MOTOR_STEPS") = kMotorSteps;
  m.attr("FEEDBACK_EASE") = kEase;
  m.attr("LONGEST_FRAME_GAP") = kLongestFrameGap;
  m.attr("LONGEST_PREDICTION") = kLongestPrediction;
  m.attr("MAX_ACTUATOR_DELAY") = kMaxActuatorDelay;
  m.def("drive_response", &drive_response, py::arg("commands"), py::arg("position"), py::arg("rate"), py::arg("period"),
        py::arg("bandwidth"), py::arg("damping"), py::arg("speed_limit"), py::arg("acceleration_limit"),
        "Coordinate of a drive that takes positions at each tick, (n,), before the tick's command (n,) is given; "
        "where it is before the first one, [m; m/s] or [rad; rad/s], is held.");
  m.attr("OFF_THE_LINE") = kOffTheLine;
  m.def(
      "all_within", [](double one, int axes) { return all_within<double>(one, axes); }, py::arg("one"), py::arg("axes"),
      "Square of the deviations within which all of so many numbers are as often as one is within `one`.");
  m.def("motor_response", &six_motors, py::arg("settings"), py::arg("commands"), py::arg("position"),
        py::arg("quaternion"),
        "Leg coordinates of a scenario's platform on motors at each tick, (n, 6) [m] or [rad], before the tick's "
        "commands (n, 6) are given; it starts at rest at a pose, with commands that hold its weight there.");
  m.def("motor_substeps", &least_substeps, py::arg("settings"),
        "Fewest substeps of a servo period with which the steps of a scenario's legs follow its motors at home.");
}

}  // namespace hexservo::bindings
