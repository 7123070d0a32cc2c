#include "kernel_handle.hpp"

#include "hexservo/batch.hpp"

#include <pybind11/functional.h>
#include <pybind11/native_enum.h>

#include <optional>
#include <variant>

namespace hexservo::bindings {

namespace {

using Values = std::variant<py::array_t<std::uint64_t, py::array::c_style>, py::array_t<double, py::array::c_style>>;
using Shape = std::vector<py::ssize_t>;

/// An array that shares the result's memory and keeps it alive; None where nothing was kept.
template <class T>
py::object shared(const py::object& self, const T* data, std::size_t size, Shape shape) {
  if (size == 0) return py::none();
  return py::array_t<T>(std::move(shape), data, self);
}

py::ssize_t signed_size(std::size_t size) { return static_cast<py::ssize_t>(size); }

template <Buffer BatchResult::* buffer>
py::object numbers(const py::object& self) {
  const auto& result = self.cast<const BatchResult&>();
  const Buffer& values = result.*buffer;
  return shared(self, values.data(), values.size(), {signed_size(values.size())});
}

template <auto codes>
py::object code_array(const py::object& self) {
  const auto& values = self.cast<const BatchResult&>().*codes;
  return shared(self, values.data(), values.size(), {signed_size(values.size())});
}

/// Quantities of `Sample` by name: (n, k), or (n, m, k) of trajectories.
py::dict samples(const py::object& self) {
  constexpr std::array<const char*, kQuantities> kNames = {"feature_error", "depth",       "position",
                                                           "quaternion",    "twist",       "wrench",
                                                           "fuzzy_output",  "leg_lengths", "leg_forces"};
  const auto& result = self.cast<const BatchResult&>();
  py::dict out;
  for (std::size_t q = 0; q < kNames.size(); ++q) {
    Shape shape = {signed_size(result.count), py::ssize_t{sample_width(q, result.points)}};
    if (result.rows > 0) shape.insert(shape.begin() + 1, signed_size(result.rows));
    const Buffer& values = result.samples[q];
    if (!values.empty()) out[kNames[q]] = shared(self, values.data(), values.size(), std::move(shape));
  }
  return out;
}

BatchResult run(const Settings& settings, const std::vector<std::pair<std::string, Values>>& variations,
                std::size_t count, BatchLog log, int threads, const KernelHandle& kernel, const py::object& progress,
                std::optional<std::vector<std::string>> metrics) {
  std::vector<Variation> rows;
  for (const auto& [key, numbers] : variations)
    std::visit(
        [&rows, &key](const auto& values) {
          if (values.ndim() != 2) throw std::invalid_argument(key + ": expected rows of numbers, got another shape");
          Variation variation{key, {}, static_cast<std::size_t>(values.shape(1)), {}};
          const std::span all(values.data(), static_cast<std::size_t>(values.size()));
          if constexpr (std::is_same_v<decltype(values.data()), const std::uint64_t*>)
            variation.seeds = all;
          else
            variation.values = all;
          rows.push_back(variation);
        },
        numbers);
  BatchOptions options;
  options.log = log;
  options.metrics = std::move(metrics);
  options.threads = threads;
  bool interrupted = false;
  options.stop_requested = [&interrupted, ctrl_c = interrupt_question()] {
    return interrupted || (ctrl_c && ctrl_c());
  };
  if (!progress.is_none())
    options.progress = [&progress, &interrupted](const BatchProgress& p) {
      or_stand_still([&] {
        const py::gil_scoped_acquire gil;
        try {
          progress(p.done, p.count, p.steps, p.total_steps);
        } catch (const py::error_already_set& error) {
          if (!error.matches(PyExc_KeyboardInterrupt)) throw;
          interrupted = true;  // Ctrl-C while the function ran
        }
      });
    };
  const WithoutGil no_gil;
  return simulate_batch(settings, rows, count, options, kernel.table());
}

}  // namespace

void bind_batch(py::module_& m) {
  py::native_enum<BatchLog>(m, "BatchLog", "enum.Enum")
      .value("metrics", BatchLog::metrics)
      .value("last_sample", BatchLog::last_sample)
      .value("trajectory", BatchLog::trajectory)
      .finalize();

  py::native_enum<StopCause>(m, "StopCause", "enum.Enum")
      .value("none", StopCause::none)
      .value("not_finite", StopCause::not_finite)
      .value("feature_error", StopCause::feature_error)
      .value("twist", StopCause::twist)
      .value("behind_camera", StopCause::behind_camera)
      .value("feature_lost", StopCause::feature_lost)
      .value("leg_limit", StopCause::leg_limit)
      .value("singular", StopCause::singular)
      .value("solver_failed", StopCause::solver_failed)
      .value("leg_speed", StopCause::leg_speed)
      .value("base_joint", StopCause::base_joint)
      .value("platform_joint", StopCause::platform_joint)
      .finalize();

  py::class_<BatchResult>(m, "BatchResult", "What a batch gives back; arrays share its memory. The scenario is axis 0.")
      .def_property_readonly("outcome", &code_array<&BatchResult::outcome>, "(n,) values of Outcome")
      .def_property_readonly("cause", &code_array<&BatchResult::cause>, "(n,) values of StopCause")
      .def_property_readonly("limit_leg", &code_array<&BatchResult::limit_leg>, "(n,) leg that ended a run, or -1")
      .def_property_readonly("end_time", &numbers<&BatchResult::end_time>, "(n,) of the last good sample [s]")
      .def_property_readonly("stop_time", &numbers<&BatchResult::stop_time>,
                             "(n,) of the step that stopped the run [s]")
      .def_property_readonly(
          "metrics",
          [](const py::object& self) {
            const auto& result = self.cast<const BatchResult&>();
            return shared(self, result.metrics.data(), result.metrics.size(),
                          {py::ssize_t{kMetricNumbers}, signed_size(result.count)});
          },
          "(21, n), in the order of Metrics; NaN where not asked for")
      .def_property_readonly("time", &numbers<&BatchResult::time>, "(m,) of trajectories [s], or None")
      .def_property_readonly("samples", &samples, "by name: (n, k), or (n, m, k) of trajectories; empty for metrics")
      .def_property_readonly(
          "fuzzy_weights",
          [](const py::object& self) {
            const auto& result = self.cast<const BatchResult&>();
            return shared(self, result.fuzzy_weights.data(), result.fuzzy_weights.size(),
                          {signed_size(result.count), kAxes, kTerms, kTerms});
          },
          "(n, 6, 7, 7) at the end [N; N m], or None");

  m.def("simulate_batch", &run, py::arg("settings"), py::arg("variations"), py::arg("count"), py::arg("log"),
        py::arg("threads"), py::arg("kernel"), py::arg("progress") = py::none(), py::arg("metrics") = py::none(),
        "Runs `count` scenarios: variations are (key, (n or 1, width) array), of 64-bit whole "
        "numbers without a sign for seed and of doubles for all others. progress(done, count, steps, total_steps) "
        "is called every 50 ms. ValueError for a bad scenario; Ctrl-C ends it and keeps what is finished.");

  m.def("describe", &describe, py::arg("cause"), py::arg("time"), py::arg("leg") = -1,
        "One sentence on how a run ended; `leg`, 0 to 5, is the one that ended it.");
}

}  // namespace hexservo::bindings
