#include "hexservo/laws/pbvs.hpp"
#include "run_loop.hpp"

namespace hexservo::detail {

template RunStatus run_continuous<double, Pbvs>(const RunRequest&);
template RunStatus run_continuous<Lanes<kWidth>, Pbvs>(const RunRequest&);
template RunStatus run_sampled<double, Pbvs>(const RunRequest&);
template RunStatus run_sampled<Lanes<kWidth>, Pbvs>(const RunRequest&);

}  // namespace hexservo::detail
