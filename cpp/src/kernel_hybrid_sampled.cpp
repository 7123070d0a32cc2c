#include "hexservo/laws/hybrid.hpp"
#include "run_loop.hpp"

namespace hexservo::detail {

template RunStatus run_sampled<double, Hybrid>(const RunRequest&);
template RunStatus run_sampled<Lanes<kWidth>, Hybrid>(const RunRequest&);

}  // namespace hexservo::detail
