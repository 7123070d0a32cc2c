#include "../check.hpp"
#include "hexservo/settings.hpp"

namespace hexservo {

void validate(const ComputedTorqueGains<double>& gains) {
  const std::string key = "controller.computed_torque.";
  detail::require_not_negative(key + "kp", gains.kp);
  detail::require_not_negative(key + "kd", gains.kd);
  detail::require_not_negative(key + "prior", gains.prior);
}

template class ClosedLoop<double, ComputedTorque>;
template class SampledLoop<double, ComputedTorque>;

}  // namespace hexservo
