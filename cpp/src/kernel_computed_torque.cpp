#include "hexservo/laws/computed_torque.hpp"
#include "run_loop.hpp"

namespace hexservo::detail {

template RunStatus run_continuous<double, ComputedTorque>(const RunRequest&);
template RunStatus run_continuous<Lanes<kWidth>, ComputedTorque>(const RunRequest&);
template RunStatus run_sampled<double, ComputedTorque>(const RunRequest&);
template RunStatus run_sampled<Lanes<kWidth>, ComputedTorque>(const RunRequest&);

}  // namespace hexservo::detail
