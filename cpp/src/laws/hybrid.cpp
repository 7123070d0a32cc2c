#include "../check.hpp"
#include "hexservo/settings.hpp"

namespace hexservo {

void validate(const HybridGains<double>& gains) {
  detail::require_positive("controller.hybrid.kp", gains.kp);
  detail::require_not_negative("controller.hybrid.kv", gains.kv);
  validate(gains.fuzzy, "controller.hybrid.fuzzy.");
}

template class ClosedLoop<double, Hybrid>;
template class SampledLoop<double, Hybrid>;

}  // namespace hexservo
