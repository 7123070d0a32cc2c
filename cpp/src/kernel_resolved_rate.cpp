#include "hexservo/laws/resolved_rate.hpp"
#include "run_loop.hpp"

namespace hexservo::detail {

template RunStatus run_continuous<double, ResolvedRate>(const RunRequest&);
template RunStatus run_continuous<Lanes<kWidth>, ResolvedRate>(const RunRequest&);
template RunStatus run_sampled<double, ResolvedRate>(const RunRequest&);
template RunStatus run_sampled<Lanes<kWidth>, ResolvedRate>(const RunRequest&);

}  // namespace hexservo::detail
