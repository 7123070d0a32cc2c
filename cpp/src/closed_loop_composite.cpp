#include "hexservo/settings.hpp"

namespace hexservo {

// One file per law: with two in one the compiler inlines less of each.
template class ClosedLoop<double, Composite>;

}  // namespace hexservo
