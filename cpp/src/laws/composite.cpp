#include "../check.hpp"
#include "hexservo/settings.hpp"

namespace hexservo {

void validate(const CompositeGains<double>& gains) {
  const std::string key = "controller.composite.";
  detail::require_not_negative(key + "kp", gains.kp);
  detail::require_not_negative(key + "kv", gains.kv);
  detail::require_not_negative(key + "kt", gains.kt);
  detail::require_not_negative(key + "kd", gains.kd);
  detail::require_not_negative(key + "drive", gains.drive);
  detail::require_not_negative(key + "prior", gains.prior);
  validate(gains.fuzzy, key + "fuzzy.");
}

template class ClosedLoop<double, Composite>;
template class SampledLoop<double, Composite>;

}  // namespace hexservo
