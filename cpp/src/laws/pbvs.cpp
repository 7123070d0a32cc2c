#include "../check.hpp"
#include "hexservo/settings.hpp"

namespace hexservo {

void validate(const PbvsGains<double>& gains) {
  const std::string key = "controller.pbvs.";
  detail::require_not_negative(key + "kp", gains.kp);
  detail::require_not_negative(key + "kd", gains.kd);
  detail::require_not_negative(key + "prior", gains.prior);
}

template class ClosedLoop<double, Pbvs>;
template class SampledLoop<double, Pbvs>;

}  // namespace hexservo
