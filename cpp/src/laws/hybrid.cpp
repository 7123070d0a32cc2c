#include "hexservo/laws/hybrid.hpp"

#include "../check.hpp"

namespace hexservo {

void validate(const HybridGains<double>& gains) {
  detail::require_positive("controller.hybrid.kp", gains.kp);
  detail::require_not_negative("controller.hybrid.kv", gains.kv);
  validate(gains.fuzzy, "controller.hybrid.fuzzy.");
}

}  // namespace hexservo
