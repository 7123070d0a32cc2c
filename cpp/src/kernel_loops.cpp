#include "hexservo/laws/laws.hpp"
#include "run_loop.hpp"

namespace hexservo::detail {

#define HEXSERVO_HERE(Law)                                                  \
  template RunStatus run_continuous<double, Law>(const RunRequest&);        \
  template RunStatus run_continuous<Lanes<kWidth>, Law>(const RunRequest&); \
  template RunStatus run_sampled<double, Law>(const RunRequest&);           \
  template RunStatus run_sampled<Lanes<kWidth>, Law>(const RunRequest&);
HEXSERVO_FOR_EACH_LAW(HEXSERVO_HERE)
#undef HEXSERVO_HERE

}  // namespace hexservo::detail
