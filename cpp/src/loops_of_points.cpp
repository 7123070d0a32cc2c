#include "hexservo/settings.hpp"

#include "start_of_run.hpp"

namespace hexservo {

// Apart from the loops of four points, so that they stay as the compiler makes them alone.
#define HEXSERVO_HERE(Law)                              \
  template class ClosedLoop<double, Law, kMostPoints>;  \
  template class SampledLoop<double, Law, kMostPoints>; \
  template detail::StartOfRun detail::start_of_run<Law, kMostPoints>(const LoopParameters<double, Law, kMostPoints>&);
HEXSERVO_FOR_EACH_LAW(HEXSERVO_HERE)
#undef HEXSERVO_HERE

}  // namespace hexservo
