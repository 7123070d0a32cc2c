#include "hexservo/settings.hpp"

namespace hexservo {

template class ClosedLoop<double, Hybrid>;
template class ClosedLoop<double, Composite>;

}  // namespace hexservo
