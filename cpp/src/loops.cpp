#include "hexservo/settings.hpp"

#include "start_of_run.hpp"

namespace hexservo {

#define HEXSERVO_OF(Law, N)                   \
  template class ClosedLoop<double, Law, N>;  \
  template class SampledLoop<double, Law, N>; \
  template detail::StartOfRun detail::start_of_run<Law, N>(const LoopParameters<double, Law, N>&);
#define HEXSERVO_HERE(Law) HEXSERVO_OF(Law, kPoints) HEXSERVO_OF(Law, kMostPoints)
HEXSERVO_FOR_EACH_LAW(HEXSERVO_HERE)
#undef HEXSERVO_HERE
#undef HEXSERVO_OF

}  // namespace hexservo
