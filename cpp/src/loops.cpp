#include "hexservo/settings.hpp"

namespace hexservo {

#define HEXSERVO_HERE(Law)                \
  template class ClosedLoop<double, Law>; \
  template class SampledLoop<double, Law>;
HEXSERVO_FOR_EACH_LAW(HEXSERVO_HERE)
#undef HEXSERVO_HERE

}  // namespace hexservo
