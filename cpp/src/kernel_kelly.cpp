#include "hexservo/laws/kelly.hpp"
#include "run_loop.hpp"

namespace hexservo::detail {

template RunStatus run_continuous<double, Kelly>(const RunRequest&);
template RunStatus run_continuous<Lanes<kWidth>, Kelly>(const RunRequest&);
template RunStatus run_sampled<double, Kelly>(const RunRequest&);
template RunStatus run_sampled<Lanes<kWidth>, Kelly>(const RunRequest&);

}  // namespace hexservo::detail
