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

}  // namespace hexservo::detail
