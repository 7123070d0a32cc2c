#include "hexservo/settings.hpp"

namespace hexservo {

template class SampledLoop<double, Hybrid>;

}  // namespace hexservo
