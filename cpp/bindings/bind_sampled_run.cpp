#include "bindings.hpp"

#include "hexservo/sampled_run.hpp"
#include "hexservo/tick_record.hpp"

#include <limits>

namespace hexservo::bindings {

namespace {

/// One column per number of a tick, by name.
py::dict recorded_ticks(const Settings& settings) {
  const std::vector<RecordedTick> ticks = record_ticks(settings);
  const py::ssize_t points = settings.target.count();
  const auto rows = static_cast<py::ssize_t>(ticks.size());
  py::dict columns;
  const auto put = [&](const char* name, py::ssize_t width, auto&& values_of) {
    py::array_t<double> column({rows, width});
    double* to = column.mutable_data();
    for (const RecordedTick& tick : ticks) {
      const auto values = values_of(tick);
      to = std::copy(values.data(), values.data() + width, to);
    }
    columns[name] = column;
  };
  using One = Vector<double, 1>;
  using T = const RecordedTick&;
  put("now", 1, [](T t) { return One(t.input.now); });
  put("exposure", 1, [](T t) { return One(t.input.frame.exposure); });
  put("features", 2 * points, [](T t) { return t.input.frame.image.features; });
  put("depth", points, [](T t) { return t.input.frame.image.depth; });
  put("position", 3, [](T t) { return t.input.pose.position; });
  put("quaternion", 4, [](T t) { return t.input.pose.quaternion; });
  put("twist", 6, [](T t) { return t.input.twist; });
  put("leg_lengths", 6, [](T t) { return t.input.joints.lengths; });
  put("leg_rates", 6, [](T t) { return t.input.joints.rates; });
  put("wrench", 6, [](T t) { return t.output.wrench; });
  put("leg_forces", 6, [](T t) { return t.output.leg_forces; });
  put("fuzzy_output", 6, [](T t) { return t.output.fuzzy_output; });
  put("status", 1, [](T t) { return One(static_cast<double>(static_cast<int>(t.output.status))); });
  put("saturated", 1, [](T t) { return One(t.output.saturated ? 1.0 : 0.0); });
  put("leg_positions", 6, [](T t) { return t.output.leg_positions; });
  put("latency", 3,
      [](T t) { return Vector3<double>(t.output.latency.estimate, t.output.latency.least, t.output.latency.most); });
  return columns;
}

/// What the sensors of all places gave last, a row each, by name; and which of them go on.
py::dict rows_of(const SampledRuns& runs) {
  py::dict rows;
  const auto put_numbers = [&](const char* name, auto&& values_of) {
    const auto width = static_cast<py::ssize_t>(values_of(runs.seen(0)).size());
    py::array_t<double> column({static_cast<py::ssize_t>(runs.count()), width});
    double* to = column.mutable_data();
    for (int i = 0; i < runs.count(); ++i) {
      const auto& values = values_of(runs.seen(i));
      if (values.size() != width) throw std::logic_error("targets: expected as many points in all runs");
      to = std::copy(values.data(), values.data() + width, to);
    }
    rows[name] = column;
  };
  const auto put_one = [&]<class T>(const char* name, T (*value_of)(const SampledRuns&, int)) {
    py::array_t<T> column(runs.count());
    for (int i = 0; i < runs.count(); ++i) column.mutable_at(i) = value_of(runs, i);
    rows[name] = column;
  };
  using Seen = const SampledObservation&;
  put_numbers("features", [](Seen s) -> const auto& { return s.features; });
  put_numbers("position", [](Seen s) -> const auto& { return s.pose.position; });
  put_numbers("quaternion", [](Seen s) -> const auto& { return s.pose.quaternion; });
  put_numbers("twist", [](Seen s) -> const auto& { return s.twist; });
  put_one.operator()<double>("time", [](const SampledRuns& all, int i) { return all.seen(i).time; });
  put_one.operator()<bool>("running", [](const SampledRuns& all, int i) { return all.running(i); });
  put_one.operator()<bool>("at_end", [](const SampledRuns& all, int i) { return all.at_end(i); });
  return rows;
}

/// Wrenches as an array with a row per run.
using Wrenches = Eigen::Ref<const Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::RowMajor>>;

}  // namespace

void bind_sampled_run(py::module_& m) {
  m.def("recorded_ticks", &recorded_ticks, py::arg("settings"),
        "What the controller of a run in sampled mode was given and answered, tick by tick, by name.");

  using Seen = SampledObservation;
  py::class_<Seen>(m, "SampledObservation", "What a controller sees at a tick.")
      .def_readonly("tick", &Seen::tick)
      .def_readonly("time", &Seen::time, "[s]")
      .def_readonly("exposure", &Seen::exposure, "time at which the newest frame was taken [s]; NaN before the first")
      .def_property_readonly(
          "features", [](const Seen& s) { return s.features; }, "(2 p,) of p points [px]; NaN before all were seen")
      .def_property_readonly(
          "depth", [](const Seen& s) { return s.depth; }, "(p,) estimated Z [m]; NaN before all were seen")
      .def_property_readonly(
          "position", [](const Seen& s) { return s.pose.position; }, "(3,) in B [m]")
      .def_property_readonly(
          "quaternion", [](const Seen& s) { return s.pose.quaternion; }, "(4,) w x y z")
      .def_property_readonly(
          "twist", [](const Seen& s) { return s.twist; }, "(6,) in B [m/s; rad/s]")
      .def_property_readonly(
          "leg_lengths", [](const Seen& s) { return s.joints.lengths; }, "(6,) of encoders [m]; NaN: no reading")
      .def_property_readonly(
          "leg_rates", [](const Seen& s) { return s.joints.rates; }, "(6,) of encoders [m/s]; NaN: no reading")
      .def_property_readonly(
          "leg_positions", [](const Seen& s) { return s.leg_positions; },
          "(6,) taken last by drives that take positions [m; rad]; NaN: others");

  py::class_<SampledRun> run(m, "SampledRun", "A run in sampled mode, commanded tick by tick.");
  run.def(py::init<const Settings&>(), py::arg("settings"));
  run.def_property_readonly("running", &SampledRun::running, "Whether there is a tick to command.")
      .def("observe", &SampledRun::observe)
      .def("command", &SampledRun::command, py::arg("wrench"), "A wrench (6,) in B [N; N m], and on to the next tick.")
      .def("command_legs", &SampledRun::command_legs, py::arg("leg_forces"),
           "Leg forces (6,) [N], and on to the next tick.")
      .def("command_positions", &SampledRun::command_positions, py::arg("positions"),
           "Leg positions (6,) [m; rad], and on to the next tick.")
      .def("finish", &SampledRun::finish, "The trajectory so far; once.");

  py::class_<SampledRuns>(m, "SampledRuns", "Runs side by side, commanded together.")
      .def(py::init([](int count) {
             if (count < 1) throw std::invalid_argument("count: expected at least 1, got " + std::to_string(count));
             return SampledRuns(count);
           }),
           py::arg("count"))
      .def("start", &SampledRuns::start, py::arg("place"), py::arg("settings"),
           "A run, and on to the tick of its first image.")
      .def(
          "command", [](SampledRuns& runs, const Wrenches& wrenches) { runs.command(wrenches.transpose()); },
          py::arg("wrenches"), py::call_guard<WithoutGil>(),
          "Wrenches (count, 6) in B beyond the estimated weight [N; N m], and on to the next tick.")
      .def("rows", &rows_of,
           "What the sensors gave last, a row per place: features [px], position [m], quaternion, twist [m/s; rad/s], "
           "time [s]; and running, at_end.");
}

}  // namespace hexservo::bindings
