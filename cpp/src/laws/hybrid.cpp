#include "hexservo/laws/hybrid.hpp"

#include "../check.hpp"

namespace hexservo {

void validate(const HybridGains<double>& gains) {
  for (int i = 0; i < gains.kp.size(); ++i)
    detail::require_positive(detail::words("controller.hybrid.kp[", i, "]"), gains.kp(i));
  detail::require_finite("controller.hybrid.kv", gains.kv);
  if (gains.kv.minCoeff() < 0.0)
    detail::refuse("controller.hybrid.kv", "numbers >= 0", detail::words(gains.kv.minCoeff()));
  validate(gains.fuzzy);
}

}  // namespace hexservo
