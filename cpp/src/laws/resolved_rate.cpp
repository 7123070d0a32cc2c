#include "hexservo/laws/resolved_rate.hpp"

#include "../check.hpp"

namespace hexservo {

void validate(const ResolvedRateGains<double, kAnyPoints>& gains, const std::string& key) {
  if (gains.adaptive && gains.gain_far > gains.gain)
    detail::refuse(key + "gain_far", detail::words("a gain of at most that at the goal (gain, ", gains.gain, " 1/s)"),
                   detail::words(gains.gain_far));
}

}  // namespace hexservo
