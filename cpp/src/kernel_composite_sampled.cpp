#include "hexservo/laws/composite.hpp"
#include "run_loop.hpp"

namespace hexservo::detail {

template RunStatus run_sampled<double, Composite>(const RunRequest&);
template RunStatus run_sampled<Lanes<kWidth>, Composite>(const RunRequest&);

}  // namespace hexservo::detail
