#include "hexservo/laws/hybrid.hpp"
#include "run_loop.hpp"

namespace hexservo::detail {

template RunStatus run_continuous<double, Hybrid>(const RunRequest&);
template RunStatus run_continuous<Lanes<kWidth>, Hybrid>(const RunRequest&);

}  // namespace hexservo::detail
