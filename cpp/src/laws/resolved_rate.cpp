#include "../check.hpp"
#include "hexservo/settings.hpp"

namespace hexservo {

void validate(const ResolvedRateGains<double>& gains) {
  const std::string key = "controller.resolved_rate.";
  detail::require_not_negative(key + "gain", gains.gain);
  detail::require_not_negative(key + "gain_far", gains.gain_far);
  detail::require_not_negative(key + "gain_slope", gains.gain_slope);
  if (gains.adaptive && gains.gain_far > gains.gain)
    detail::refuse(key + "gain_far", detail::words("a gain of at most that at the goal (gain, ", gains.gain, " 1/s)"),
                   detail::words(gains.gain_far));
  detail::require_not_negative(key + "ki", gains.ki);
  detail::require_not_negative(key + "damping", gains.damping);
}

template class ClosedLoop<double, ResolvedRate>;
template class SampledLoop<double, ResolvedRate>;

}  // namespace hexservo
