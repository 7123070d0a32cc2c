#include "kernel.hpp"

#include "hexservo/subnormals.hpp"
#include "hexservo/types.hpp"
#include "kernel_lanes.hpp"

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <new>

#ifndef HEXSERVO_KERNEL_FLAGS
#define HEXSERVO_KERNEL_FLAGS "unknown"
#endif

namespace hexservo {

namespace {

template <class S, class Law, int N>
RunStatus run_mode(const RunRequest& request) {
  return request.sampled ? detail::run_sampled<S, Law, N>(request) : detail::run_continuous<S, Law, N>(request);
}

template <class S, class Law>
RunStatus run_places(const RunRequest& request) {
  if (request.points < kLeastPoints || request.points > request.places) return RunStatus::unknown_places;
  if (request.places == kPoints) return run_mode<S, Law, kPoints>(request);
  if (request.places == kMostPoints) return run_mode<Lanes<detail::kWidth>, Law, kMostPoints>(request);
  return RunStatus::unknown_places;
}

template <class S>
RunStatus run_law(const RunRequest& request) noexcept try {
  const FlushSubnormals flush;
  switch (request.law) {
#define HEXSERVO_CASE(Law) \
  case LawId::Law:         \
    return run_places<S, Law>(request);
    HEXSERVO_FOR_EACH_LAW(HEXSERVO_CASE)
#undef HEXSERVO_CASE
  }
  return RunStatus::unknown_law;
} catch (const std::bad_alloc&) {
  return RunStatus::no_memory;
}

using detail::kWidth;

double fma_peak(double seconds) noexcept {
  using Clock = std::chrono::steady_clock;
  using Register = LaneRegister<kWidth>::Values;
  constexpr std::size_t kChains = 10;  // two units with a latency of four or five cycles, within 16 registers
  constexpr int kRounds = 20000;
  const Register factor = Lanes<kWidth>(0.999).values(), term = Lanes<kWidth>(0.0037).values();
  std::array<Register, kChains> chains;
  for (std::size_t i = 0; i < kChains; ++i) chains[i] = Lanes<kWidth>(0.1 + static_cast<double>(i)).values();

  double best = 0.0;
  const auto start = Clock::now();
  for (auto now = start; now - start < std::chrono::duration<double>(seconds);) {
    const auto begin = Clock::now();
    for (int round = 0; round < kRounds; ++round)
#pragma GCC unroll 10
      for (std::size_t i = 0; i < kChains; ++i) chains[i] = chains[i] * factor + term;
    now = Clock::now();
    const double operations = 2.0 * kRounds * kChains * kWidth;
    best = std::max(best, operations / std::chrono::duration<double>(now - begin).count());
  }
  Register sum = chains[0];
  for (std::size_t i = 1; i < kChains; ++i) sum += chains[i];
  volatile double used = sum[0];  // the chains must be worked out
  static_cast<void>(used);
  return best * 1e-9;
}

}  // namespace

const Kernel& built_in_kernel() noexcept {
  static constexpr Kernel kernel = {
      kKernelAbi, kWidth, HEXSERVO_KERNEL_NAME, HEXSERVO_KERNEL_FLAGS, run_law<double>, run_law<Lanes<kWidth>>,
      fma_peak};
  return kernel;
}

}  // namespace hexservo
