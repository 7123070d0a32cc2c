#include "hexservo/fuzzy.hpp"

#include "check.hpp"

#include <algorithm>
#include <cmath>

namespace hexservo {

namespace {

constexpr double kMaxProductDigits = 290.0;  // decimal exponent that products of bell denominators may reach

}  // namespace

Matrix7<double> linear_rule_table() {
  Matrix7<double> table;
  for (int row = 0; row < kTerms; ++row)
    for (int column = 0; column < kTerms; ++column)
      table(row, column) = term_centre(std::clamp(row + column - 6, -3, 3) + 3);  // terms count from -3 (NB) to 3 (PB)
  return table;
}

void validate(const FuzzyGains<double>& gains, const std::string& key) {
  detail::require_positive(key + "adaptation", gains.adaptation);
  detail::require_finite(key + "error_scale", gains.error_scale);
  detail::require_finite(key + "rate_scale", gains.rate_scale);
  detail::require_finite(key + "initial_scale", gains.initial_scale);
  detail::require_finite(key + "table", gains.table);
  detail::require_positive(key + "bell_width", gains.bell_width);
  detail::require_positive(key + "bell_slope", gains.bell_slope);
  // Six denominators of at most 1 + (2/w)^(2s) are multiplied; far from 1e308 the sum of seven products is safe as
  // well.
  const double largest = std::max(0.0, 2.0 * gains.bell_slope * std::log10(2.0 / gains.bell_width));
  if (6.0 * largest > kMaxProductDigits)
    detail::refuse(
        key + "bell_width",
        detail::words("bells with slope * log10(2/width) of at most ", kMaxProductDigits / 12.0,
                      " (a width of at least ", 2.0 / std::pow(10.0, kMaxProductDigits / (12.0 * gains.bell_slope)),
                      " for this slope)"),
        detail::words("width ", gains.bell_width, " and slope ", gains.bell_slope));
}

}  // namespace hexservo
