#include "hexservo/laws/laws.hpp"
#include "run_loop.hpp"

namespace hexservo::detail {

#define HEXSERVO_HERE(Law)                                                           \
  template RunStatus run_continuous<double, Law, kPoints>(const RunRequest&);        \
  template RunStatus run_continuous<Lanes<kWidth>, Law, kPoints>(const RunRequest&); \
  template RunStatus run_sampled<double, Law, kPoints>(const RunRequest&);           \
  template RunStatus run_sampled<Lanes<kWidth>, Law, kPoints>(const RunRequest&);
HEXSERVO_FOR_EACH_LAW(HEXSERVO_HERE)
#undef HEXSERVO_HERE

// Those of more points are in kernel_loops_of_points.cpp alone: here they would be instantiated again where kernel.cpp,
// which is compiled together with this, calls them, and functions that both share would be inlined in neither.
#define HEXSERVO_HERE(Law)                                                                      \
  extern template RunStatus run_continuous<Lanes<kWidth>, Law, kMostPoints>(const RunRequest&); \
  extern template RunStatus run_sampled<Lanes<kWidth>, Law, kMostPoints>(const RunRequest&);
HEXSERVO_FOR_EACH_LAW(HEXSERVO_HERE)
#undef HEXSERVO_HERE

}  // namespace hexservo::detail
