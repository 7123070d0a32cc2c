/// @file
/// Times the servo tick on the machine that it will run on: one tick after another, or paced by an absolute clock
/// (BENCHMARKS.md).
///
/// The inputs are those of a recorded run, so that they change from tick to tick as a robot's do.
#pragma once

#include "hexservo/controller.hpp"

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace hexservo {

/// Which ticks are timed, and how.
struct TickBenchmarkOptions {
  long long periods = 1'000'000;  ///< ticks, or periods of the clock, 1000000
  double rate = 0.0;              ///< of the clock [Hz]; 0: one tick after another, 0
  bool realtime = false;          ///< ask for SCHED_FIFO and for locked memory, no
  /// Asked every few milliseconds, between two ticks; true ends the measurement.
  std::function<bool()> stop_requested;
};

/// What came out. A period whose tick has not ended when the next one begins is missed; periods that have passed by
/// then get no tick and are missed too.
struct TickTimes {
  std::vector<std::uint32_t> latency;   ///< of each tick, with one reading of the clock [ns]
  std::vector<std::uint32_t> lateness;  ///< of each wake-up behind its time [ns]; empty without a clock
  long long periods = 0;                ///< that have passed
  long long missed = 0;                 ///< of these
  double clock_cost = 0.0;              ///< median of a reading of the clock [ns]
  long long invalid = 0;                ///< ticks that refused their input
  bool reproduced = true;               ///< every complete replay gave the same outputs, bit for bit
  double wrench_difference = 0.0;       ///< largest, between a tick and the run that was recorded [N; N m]
  std::string scheduling;               ///< what the system granted, as text
  std::string memory;                   ///< likewise
  bool interrupted = false;             ///< stopped on request
};

inline constexpr long long kMaxTimedPeriods = 100'000'000;  ///< 400 MB of times
inline constexpr double kMaxTickRate = 1e6;                 ///< [Hz]

/// Records the scenario's run, then replays its measurements through `step` and times every tick. No heap, no lock and
/// no system call but the clock's between the first tick and the last.
/// @throws std::invalid_argument as `controller_gains`, for a number of periods or a rate out of range, or for a run
/// that does not go to its end
TickTimes time_ticks(const Settings& settings, const TickBenchmarkOptions& options);

}  // namespace hexservo
