#include "hexservo/settings.hpp"

namespace hexservo {

template class SampledLoop<double, Composite>;

}  // namespace hexservo
