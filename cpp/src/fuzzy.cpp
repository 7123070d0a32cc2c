#include "hexservo/fuzzy.hpp"

#include "check.hpp"

#include <algorithm>

namespace hexservo {

Matrix7<double> linear_rule_table() {
  Matrix7<double> table;
  for (int row = 0; row < kTerms; ++row)
    for (int column = 0; column < kTerms; ++column)
      table(row, column) = term_centre(std::clamp(row + column - 6, -3, 3) + 3);  // terms count from -3 (NB) to 3 (PB)
  return table;
}

void validate(const FuzzyGains<double>& gains) {
  const std::string key = "controller.hybrid.fuzzy.";
  for (int j = 0; j < kAxes; ++j)
    detail::require_positive(detail::words(key, "adaptation[", j, "]"), gains.adaptation(j));
  detail::require_finite(key + "error_scale", gains.error_scale);
  detail::require_finite(key + "rate_scale", gains.rate_scale);
  detail::require_finite(key + "initial_scale", gains.initial_scale);
  detail::require_finite(key + "table", gains.table);
  detail::require_positive(key + "bell_width", gains.bell_width);
  detail::require_positive(key + "bell_slope", gains.bell_slope);
}

}  // namespace hexservo
