#include "../check.hpp"
#include "hexservo/settings.hpp"

namespace hexservo {

void validate(const KellyGains<double>& gains) {
  detail::require_not_negative("controller.kelly.kp", gains.kp);
  detail::require_not_negative("controller.kelly.kd", gains.kd);
}

template class ClosedLoop<double, Kelly>;
template class SampledLoop<double, Kelly>;

}  // namespace hexservo
