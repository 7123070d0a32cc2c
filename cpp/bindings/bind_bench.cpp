#include "bindings.hpp"

#include "hexservo/tick_benchmark.hpp"

namespace hexservo::bindings {

namespace {

/// An array that shares the memory of the times and keeps it alive.
template <std::vector<std::uint32_t> TickTimes::* member>
py::array_t<std::uint32_t> shared(const py::object& self) {
  const auto& values = self.cast<const TickTimes&>().*member;
  return py::array_t<std::uint32_t>({static_cast<py::ssize_t>(values.size())}, values.data(), self);
}

}  // namespace

void bind_bench(py::module_& m) {
  py::class_<TickTimes>(m, "TickTimes", "Times of servo ticks; arrays share its memory.")
      .def_property_readonly("latency", &shared<&TickTimes::latency>, "(n,) of each tick [ns]")
      .def_property_readonly("lateness", &shared<&TickTimes::lateness>,
                             "(n,) of each wake-up [ns]; (0,) without a clock")
      .def_readonly("periods", &TickTimes::periods, "of the clock that have passed")
      .def_readonly("missed", &TickTimes::missed, "periods whose tick did not end in time")
      .def_readonly("clock_cost", &TickTimes::clock_cost, "of one reading of the clock [ns]")
      .def_readonly("invalid", &TickTimes::invalid, "ticks that refused their input")
      .def_readonly("reproduced", &TickTimes::reproduced, "every replay gave the same outputs, bit for bit")
      .def_readonly("wrench_difference", &TickTimes::wrench_difference, "to the recorded run, largest [N; N m]")
      .def_readonly("scheduling", &TickTimes::scheduling, "what the system granted")
      .def_readonly("memory", &TickTimes::memory, "what the system granted")
      .def_readonly("interrupted", &TickTimes::interrupted, "ended by Ctrl-C");

  m.def(
      "time_ticks",
      [](const Settings& settings, long long periods, double rate, bool realtime) {
        const TickBenchmarkOptions options{periods, rate, realtime, interrupt_question()};
        const WithoutGil no_gil;
        return time_ticks(settings, options);
      },
      py::arg("settings"), py::arg("periods"), py::arg("rate") = 0.0, py::arg("realtime") = false,
      "Times `periods` ticks that replay a recorded run; rate [Hz], 0: one after another. Ctrl-C ends it.");
}

}  // namespace hexservo::bindings
