#include "hexservo/laws/laws.hpp"
#include "run_loop.hpp"

namespace hexservo::detail {

// Apart from the loops of four points, so that they stay as the compiler makes them alone. A single run is a pack of
// which one lane is asked for: loops of single numbers would take as long to compile again.
#define HEXSERVO_HERE(Law)                                                               \
  template RunStatus run_continuous<Lanes<kWidth>, Law, kMostPoints>(const RunRequest&); \
  template RunStatus run_sampled<Lanes<kWidth>, Law, kMostPoints>(const RunRequest&);
HEXSERVO_FOR_EACH_LAW(HEXSERVO_HERE)
#undef HEXSERVO_HERE

}  // namespace hexservo::detail
