/// @file
/// How a run is before its first step: compiled once, with the loops, since every file that includes their templates
/// compiles them again.
#pragma once

#include "hexservo/settings.hpp"

namespace hexservo::detail {

/// Why a run stops before its first step, if it does.
struct StartOfRun {
  StopCause cause;
  int leg;  ///< that is beyond a limit, where that is why
};

/// Prepares a run, and looks at its first sample.
template <class Law, int N>
StartOfRun start_of_run(const LoopParameters<double, Law, N>& p) {
  const auto seen = [](const LoopRecord<double, N>& record) {
    return StartOfRun{static_cast<StopCause>(static_cast<int>(record.cause())), static_cast<int>(record.limit_leg())};
  };
  if constexpr (!kTracks<Law>)
    if (p.mode == LoopMode::continuous) return seen(ClosedLoop<double, Law, N>(p).record());
  return seen(SampledLoop<double, Law, N>(p).record());
}

#define HEXSERVO_ELSEWHERE(Law)                                                                       \
  extern template StartOfRun start_of_run<Law, kPoints>(const LoopParameters<double, Law, kPoints>&); \
  extern template StartOfRun start_of_run<Law, kMostPoints>(const LoopParameters<double, Law, kMostPoints>&);
HEXSERVO_FOR_EACH_LAW(HEXSERVO_ELSEWHERE)
#undef HEXSERVO_ELSEWHERE

}  // namespace hexservo::detail
