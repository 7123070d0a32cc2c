#include "bindings.hpp"

#include "hexservo/position_actuators.hpp"

#include <limits>

namespace hexservo::bindings {

namespace {

/// One drive at the ticks of its commands, each read before the command is given.
py::array_t<double> drive_response(const py::array_t<double, py::array::c_style | py::array::forcecast>& commands,
                                   double position, double rate, double period, double bandwidth, double damping,
                                   double speed_limit, double acceleration_limit) {
  if (commands.ndim() != 1) throw py::value_error("commands: expected shape (n,)");
  ActuatorParameters<double> parameters;
  parameters.position.speed_limit = speed_limit;
  parameters.position.acceleration_limit = acceleration_limit;
  parameters.position.bandwidth = bandwidth;
  parameters.position.damping = damping;
  parameters.transition = leg_transition(bandwidth, damping, period / kLegSteps);
  PositionedLegs<double> legs(parameters, period, Vector6<double>::Constant(position), Vector6<double>::Constant(rate));
  const auto command = commands.unchecked<1>();
  py::array_t<double> response(commands.shape(0));
  auto out = response.mutable_unchecked<1>();
  for (py::ssize_t tick = 0; tick < command.shape(0); ++tick) {
    out(tick) = legs.positions()(0);
    legs.command(Vector6<double>::Constant(command(tick)));
    legs.advance();
  }
  return response;
}

}  // namespace

void bind_drives(py::module_& m) {
  m.def("drive_response", &drive_response, py::arg("commands"), py::arg("position"), py::arg("rate"), py::arg("period"),
        py::arg("bandwidth"), py::arg("damping"), py::arg("speed_limit"), py::arg("acceleration_limit"),
        "Coordinate of a drive that takes positions at each tick, (n,), before the tick's command (n,) is given; "
        "where it is before the first one, [m; m/s] or [rad; rad/s], is held.");
}

}  // namespace hexservo::bindings
