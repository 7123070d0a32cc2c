#include "bindings.hpp"

#include "hexservo/fuzzy.hpp"

namespace hexservo::bindings {

void bind_fuzzy(py::module_& m) {
  py::tuple centres(kTerms);
  for (int term = 0; term < kTerms; ++term) centres[static_cast<std::size_t>(term)] = term_centre(term);
  m.attr("TERM_CENTRES") = centres;

  py::tuple table(kTerms);  // no array: the import of this module would be that of NumPy
  for (int row = 0; row < kTerms; ++row) {
    py::tuple entries(kTerms);
    for (int column = 0; column < kTerms; ++column)
      entries[static_cast<std::size_t>(column)] = linear_rule_table()(row, column);
    table[static_cast<std::size_t>(row)] = entries;
  }
  m.attr("LINEAR_RULE_TABLE") = table;
}

}  // namespace hexservo::bindings
