#include "hexservo/fuzzy.hpp"

#include "walk.hpp"

#include <algorithm>
#include <cmath>

namespace hexservo {

namespace {

constexpr double kMaxProductDigits = 290.0;  // decimal exponent that products of bell denominators may reach
constexpr double kLeastAdaptation = 1e-100;  // Psi
constexpr double kMaxLeakagePerStep = 1.0;   // sigma h; the method's error grows with its fourth power

}  // namespace

Matrix7<double> linear_rule_table() {
  Matrix7<double> table;
  for (int row = 0; row < kTerms; ++row)
    for (int column = 0; column < kTerms; ++column)
      table(row, column) = term_centre(std::clamp(row + column - 6, -3, 3) + 3);  // terms count from -3 (NB) to 3 (PB)
  return table;
}

void require_resolved(const FuzzyGains<double>& gains, const std::string& key, double step) {
  const double fastest = gains.leakage.maxCoeff();
  if (fastest * step > kMaxLeakagePerStep)
    detail::refuse(key + "leakage",
                   detail::words("at most ", kMaxLeakagePerStep / step, " 1/s for a step of ", step, " s"),
                   detail::words(fastest));
}

void validate(const FuzzyGains<double>& gains, const std::string& key) {
  detail::require_bounds(std::string_view(key).substr(0, key.size() - 1), gains);
  for (int j = 0; j < kAxes; ++j)  // 1/Psi and what it multiplies stay finite
    if (gains.adaptation(j) < kLeastAdaptation)
      detail::refuse(detail::words(key, "adaptation[", j, "]"), detail::words("a number >= ", kLeastAdaptation),
                     detail::words(gains.adaptation(j)));
  if (!(gains.initial_scale.cwiseAbs().maxCoeff() * gains.table.cwiseAbs().maxCoeff() <=
        std::numeric_limits<double>::max()))
    detail::refuse(key + "initial_scale", "a number whose products with the entries of the table are finite",
                   detail::words(gains.initial_scale.cwiseAbs().maxCoeff(), " with an entry of ",
                                 gains.table.cwiseAbs().maxCoeff()));
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
