#include "../check.hpp"
#include "hexservo/settings.hpp"

namespace hexservo {

void validate(const PbvsGains<double>& gains) {
  detail::require_not_negative("controller.pbvs.kp", gains.kp);
  detail::require_not_negative("controller.pbvs.kd", gains.kd);
}

template class ClosedLoop<double, Pbvs>;
template class SampledLoop<double, Pbvs>;

}  // namespace hexservo
