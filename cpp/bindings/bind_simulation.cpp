#include "kernel_handle.hpp"

#include "hexservo/simulation.hpp"

#include <pybind11/functional.h>
#include <pybind11/native_enum.h>

namespace hexservo::bindings {

namespace {

using Member = Column Trajectory::*;

/// A logged quantity as an (n, width) array that shares the trajectory's memory and keeps it alive.
template <Member column, int width>
py::array_t<double> rows(const py::object& self) {
  const Column values = self.cast<const Trajectory&>().*column;
  const auto n = static_cast<py::ssize_t>(values.size()) / width;
  if constexpr (width == 1) return py::array_t<double>({n}, values.data(), self);
  return py::array_t<double>({n, static_cast<py::ssize_t>(width)}, values.data(), self);
}

/// The same with numbers of each point.
template <Member column, int each>
py::array_t<double> point_rows(const py::object& self) {
  const auto& log = self.cast<const Trajectory&>();
  const auto width = static_cast<py::ssize_t>(each * log.points), n = static_cast<py::ssize_t>(log.time.size());
  return py::array_t<double>({n, width}, (log.*column).data(), self);
}

}  // namespace

std::function<bool()> interrupt_question() {
  const bool is_main = or_stand_still([] {
    const auto threading = py::module_::import("threading");
    return threading.attr("get_ident")().equal(threading.attr("main_thread")().attr("ident"));
  });
  if (!is_main) return {};
  return [] {
    const py::gil_scoped_acquire gil;
    if (PyErr_CheckSignals() == 0) return false;
    if (PyErr_ExceptionMatches(PyExc_KeyboardInterrupt) == 0) throw py::error_already_set();
    PyErr_Clear();
    return true;
  };
}

void bind_simulate(py::module_& m) {
  m.def(
      "simulate",
      [](const Settings& settings, const KernelHandle& kernel, bool log_weights) {
        const auto question = interrupt_question();
        const WithoutGil no_gil;
        return simulate(settings, question, kernel.table(), log_weights);
      },
      py::arg("settings"), py::arg("kernel"), py::arg("log_weights") = false,
      "Runs a scenario; ValueError for a bad one, a trajectory with its outcome otherwise. Ctrl-C ends it with "
      "`interrupted`.");
}

void bind_simulation(py::module_& m) {
  py::native_enum<Outcome>(m, "Outcome", "enum.Enum")
      .value("completed", Outcome::completed)
      .value("diverged", Outcome::diverged)
      .value("behind_camera", Outcome::behind_camera)
      .value("feature_lost", Outcome::feature_lost)
      .value("leg_limit", Outcome::leg_limit)
      .value("singular", Outcome::singular)
      .value("solver_failed", Outcome::solver_failed)
      .value("interrupted", Outcome::interrupted)
      .finalize();

  py::native_enum<LimitEvent::Kind>(m, "LimitKind", "enum.Enum")
      .value("stroke", LimitEvent::Kind::stroke)
      .value("force", LimitEvent::Kind::force)
      .value("speed", LimitEvent::Kind::speed)
      .value("base_joint", LimitEvent::Kind::base_joint)
      .value("platform_joint", LimitEvent::Kind::platform_joint)
      .finalize();

  py::class_<LimitEvent>(m, "LimitEvent", "A leg beyond one of its limits.")
      .def_readonly("kind", &LimitEvent::kind)
      .def_readonly("leg", &LimitEvent::leg, "0 to 5")
      .def_readonly("first_time", &LimitEvent::first_time, "[s]")
      .def_readonly("peak", &LimitEvent::peak, "largest excursion [m], force [N], speed [m/s] or tilt [rad] of the run")
      .def_readonly("limit", &LimitEvent::limit, "likewise");

  using M = Metrics<double>;
  py::class_<M>(m, "Metrics", "Metrics of a run, streamed at every step.")
      .def_readonly("settling_time", &M::settling_time, "[s], NaN where the run ends above the threshold")
      .def_readonly("final_error", &M::final_error, "[px]")
      .def_readonly("rms_error", &M::rms_error, "[px], NaN where the run is too short")
      .def_readonly("peak_error", &M::peak_error, "[px]")
      .def_readonly("peak_displacement", &M::peak_displacement, "[m]")
      .def_readonly("peak_rotation", &M::peak_rotation, "[rad]")
      .def_readonly("final_linear_speed", &M::final_linear_speed, "[m/s]")
      .def_readonly("final_angular_speed", &M::final_angular_speed, "[rad/s]")
      .def_readonly("peak_control_force", &M::peak_control_force, "[N]")
      .def_readonly("peak_control_moment", &M::peak_control_moment, "[N m]")
      .def_readonly("peak_leg_force", &M::peak_leg_force, "[N]")
      .def_readonly("peak_leg_excursion", &M::peak_leg_excursion, "[m]")
      .def_readonly("overshoot", &M::overshoot, "[px]")
      .def_readonly("relative_overshoot", &M::relative_overshoot, "[1]")
      .def_readonly("peak_feature_distance", &M::peak_feature_distance, "from the image centre [px]")
      .def_readonly("peak_line_deviation", &M::peak_line_deviation, "[px]")
      .def_readonly("effort", &M::effort, "[N^2 s]")
      .def_readonly("chatter", &M::chatter, "[N/s], NaN for a single sample")
      .def_readonly("peak_leg_speed", &M::peak_leg_speed, "[m/s], NaN without a limit")
      .def_readonly("peak_base_joint", &M::peak_base_joint, "[rad], NaN without a limit")
      .def_readonly("peak_platform_joint", &M::peak_platform_joint, "[rad], NaN without a limit");

  py::class_<Trajectory>(m, "Trajectory", "Logged samples of a run; arrays share its memory.")
      .def_property_readonly("time", &rows<&Trajectory::time, 1>, "(n,) [s]")
      .def_property_readonly("feature_error", &point_rows<&Trajectory::feature_error, 2>,
                             "(n, 2 p) of p points, true [px]")
      .def_property_readonly("depth", &point_rows<&Trajectory::depth, 1>, "(n, p) true [m]")
      .def_property_readonly("position", &rows<&Trajectory::position, 3>, "(n, 3) in B [m]")
      .def_property_readonly("quaternion", &rows<&Trajectory::quaternion, 4>, "(n, 4) w x y z")
      .def_property_readonly("twist", &rows<&Trajectory::twist, 6>, "(n, 6) in B [m/s; rad/s]")
      .def_property_readonly("wrench", &rows<&Trajectory::wrench, 6>, "(n, 6) in B [N; N m]")
      .def_property_readonly("fuzzy_output", &rows<&Trajectory::fuzzy_output, 6>, "(n, 6) [N; N m]")
      .def_property_readonly("leg_lengths", &rows<&Trajectory::leg_lengths, 6>, "(n, 6) [m]")
      .def_property_readonly("leg_forces", &rows<&Trajectory::leg_forces, 6>, "(n, 6) [N]")
      .def_property_readonly(
          "fuzzy_weights", [](const Trajectory& log) { return weight_array(log.fuzzy_weights); },
          "(6, 7, 7) at the end [N; N m]")
      .def_property_readonly(
          "weight_history",
          [](const py::object& self) -> py::object {
            const Column values = self.cast<const Trajectory&>().weight_history;
            if (values.empty()) return py::none();
            const auto n = static_cast<py::ssize_t>(values.size()) / kWeightNumbers;
            return py::array_t<double>({n, py::ssize_t{kAxes}, py::ssize_t{kTerms}, py::ssize_t{kTerms}}, values.data(),
                                       self);
          },
          "(n, 6, 7, 7) [N; N m], or None where it was not logged")
      .def_readonly("outcome", &Trajectory::outcome)
      .def_readonly("detail", &Trajectory::detail)
      .def_readonly("end_time", &Trajectory::end_time, "time of the last good sample [s]")
      .def_readonly("stop_time", &Trajectory::stop_time, "time of the step that failed, else of the end [s]")
      .def_readonly("steps", &Trajectory::steps)
      .def_readonly("events", &Trajectory::events)
      .def_readonly("metrics", &Trajectory::metrics);

  bind_simulate(m);

  m.def(
      "drive_legs",
      [](const Hexapod<double>& hexapod, const RigidBody<double>& body, const DynamicsError<double>& error,
         const Vector3<double>& position, const Vector4<double>& quaternion, const Vector6<double>& twist,
         const Vector6<double>& leg_forces, double step, long long steps) {
        const BodyState<double> end =
            drive_legs(hexapod, body, error, body_state<double>(checked_pose(position, quaternion), twist), leg_forces,
                       step, steps);
        return py::make_tuple(Vector3<double>(position_of(end)), Vector4<double>(quaternion_of(end)),
                              Vector6<double>(twist_of(end)));
      },
      py::arg("hexapod"), py::arg("body"), py::arg("error"), py::arg("position"), py::arg("quaternion"),
      py::arg("twist"), py::arg("leg_forces"), py::arg("step"), py::arg("steps"),
      "The platform alone under constant leg forces (6,) [N]: position, quaternion and twist after `steps` of `step` "
      "[s].");
}

}  // namespace hexservo::bindings
