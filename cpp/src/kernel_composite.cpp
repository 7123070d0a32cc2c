#include "hexservo/laws/composite.hpp"
#include "run_loop.hpp"

namespace hexservo::detail {

template RunStatus run_continuous<double, Composite>(const RunRequest&);
template RunStatus run_continuous<Lanes<kWidth>, Composite>(const RunRequest&);

}  // namespace hexservo::detail
