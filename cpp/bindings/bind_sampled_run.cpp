#include "bindings.hpp"

#include "hexservo/sampled_run.hpp"

namespace hexservo::bindings {

void bind_sampled_run(py::module_& m) {
  using Seen = SampledObservation;
  py::class_<Seen>(m, "SampledObservation", "What a controller sees at a tick.")
      .def_readonly("tick", &Seen::tick)
      .def_readonly("time", &Seen::time, "[s]")
      .def_readonly("exposure", &Seen::exposure, "time at which the newest frame was taken [s]; NaN before the first")
      .def_property_readonly(
          "features", [](const Seen& s) { return s.sensed.image.features; }, "(8,) [px]; NaN before all were seen")
      .def_property_readonly(
          "depth", [](const Seen& s) { return s.sensed.image.depth; }, "(4,) estimated Z [m]; NaN before all were seen")
      .def_property_readonly(
          "position", [](const Seen& s) { return s.sensed.pose.position; }, "(3,) in B [m]")
      .def_property_readonly(
          "quaternion", [](const Seen& s) { return s.sensed.pose.quaternion; }, "(4,) w x y z")
      .def_property_readonly("twist", [](const Seen& s) { return s.sensed.twist; }, "(6,) in B [m/s; rad/s]");

  py::class_<SampledRun> run(m, "SampledRun", "A run in sampled mode, commanded tick by tick.");
  Laws::for_each(
      [&run]<class Law>(std::type_identity<Law>) { run.def(py::init<const Settings<Law>&>(), py::arg("settings")); });
  run.def_property_readonly("running", &SampledRun::running, "Whether there is a tick to command.")
      .def("observe", &SampledRun::observe)
      .def("command", &SampledRun::command, py::arg("wrench"), "A wrench (6,) in B [N; N m], and on to the next tick.")
      .def("command_legs", &SampledRun::command_legs, py::arg("leg_forces"),
           "Leg forces (6,) [N], and on to the next tick.")
      .def("finish", &SampledRun::finish, "The trajectory so far; once.");
}

}  // namespace hexservo::bindings
