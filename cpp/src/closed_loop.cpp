#include "hexservo/settings.hpp"

namespace hexservo {

template class ClosedLoop<double, Hybrid>;

}  // namespace hexservo
