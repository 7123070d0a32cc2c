#include "hexservo/settings.hpp"

#include "start_of_run.hpp"

namespace hexservo {

#define HEXSERVO_HERE(Law)                 \
  template class ClosedLoop<double, Law>;  \
  template class SampledLoop<double, Law>; \
  template detail::StartOfRun detail::start_of_run<Law, kPoints>(const LoopParameters<double, Law, kPoints>&);
HEXSERVO_FOR_EACH_LAW(HEXSERVO_HERE)
#undef HEXSERVO_HERE

}  // namespace hexservo
