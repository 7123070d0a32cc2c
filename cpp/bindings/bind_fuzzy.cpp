#include "bindings.hpp"

#include "hexservo/fuzzy.hpp"

namespace hexservo::bindings {

void bind_fuzzy(py::module_& m) {
  py::tuple centres(kTerms);
  for (int term = 0; term < kTerms; ++term) centres[static_cast<std::size_t>(term)] = term_centre(term);
  m.attr("TERM_CENTRES") = centres;

  py::class_<FuzzyGains<double>>(m, "FuzzyGains", "Design of the six fuzzy systems, (13) and (22) of the paper.")
      .def(py::init<>())
      .def_readwrite("enabled", &FuzzyGains<double>::enabled, "false: no fuzzy output and no adaptation")
      .def_readwrite("adaptation", &FuzzyGains<double>::adaptation, "(6,) Psi [m/N; rad/(N m)]")
      .def_readwrite("error_scale", &FuzzyGains<double>::error_scale, "(6,) a [1/N; 1/(N m)]")
      .def_readwrite("rate_scale", &FuzzyGains<double>::rate_scale, "(6,) b [s/N; s/(N m)]")
      .def_readwrite("initial_scale", &FuzzyGains<double>::initial_scale, "(6,) s_0 [N; N m]")
      .def_readwrite("table", &FuzzyGains<double>::table, "(7, 7) rule table, row: u, column: u-dot [1]")
      .def_readwrite("bell_width", &FuzzyGains<double>::bell_width, "w [1]")
      .def_readwrite("bell_slope", &FuzzyGains<double>::bell_slope, "s, exponent 2s [1]")
      .def_readwrite("leakage", &FuzzyGains<double>::leakage, "(6,) sigma [1/s]")
      .def_readwrite("weight_limit", &FuzzyGains<double>::weight_limit, "(6,) [N; N m], infinite: none")
      .def_readwrite("dead_zone", &FuzzyGains<double>::dead_zone, "(6,) of what drives the adaptation [m/s; rad/s]");
}

}  // namespace hexservo::bindings
