/// @file
/// Many scenarios at once: one per lane of a vector register, packs of lanes on all cores (docs/batch.md).
#pragma once

#include "hexservo/simulation.hpp"

#include <array>
#include <cstdint>
#include <optional>

namespace hexservo {

/// A scenario key with its values: `width` numbers per scenario, or `width` numbers that hold for all of them.
struct Variation {
  std::string key;                 ///< dotted, as in a scenario file: "uncertainty.depth"
  std::span<const double> values;  ///< row after row
  std::size_t width;               ///< 1 where a number stands for a whole array
  /// In place of `values` for the key `seed`: a double holds whole numbers up to 2^53 only.
  std::span<const std::uint64_t> seeds = {};
};

/// What is kept of each run; outcome, times and metrics always are.
enum class BatchLog {
  metrics,      ///< nothing more
  last_sample,  ///< the last good sample and the weights
  trajectory    ///< every `log_every`-th sample on one time grid, and the weights at the end
};

/// How far a batch is.
struct BatchProgress {
  std::size_t done, count;       ///< scenarios
  long long steps, total_steps;  ///< steps of scenarios taken and to be taken; those of runs that stop early are not
};

/// How a batch is to run.
struct BatchOptions {
  BatchLog log = BatchLog::last_sample;
  std::optional<std::vector<std::string>> metrics;  ///< by their names in `Metrics`; none: all
  int threads = 1;
  std::function<bool()> stop_requested;                ///< asked every 50 ms by the calling thread; true ends the batch
  std::function<void(const BatchProgress&)> progress;  ///< called every 50 ms, and at the end, by the calling thread
};

/// What a batch gives back; the scenario is the first axis of everything but `metrics` and `time`.
struct BatchResult {
  std::size_t count = 0;               ///< n
  std::size_t rows = 0;                ///< m, samples of each trajectory
  int points = kPoints;                ///< of the target
  std::vector<std::uint8_t> outcome;   ///< n, Outcome
  std::vector<std::uint8_t> cause;     ///< n, StopCause
  std::vector<std::int8_t> limit_leg;  ///< n, leg that ended a run, 0 to 5; -1: none did
  Buffer end_time;                     ///< n, of the last good sample; NaN where interrupted [s]
  Buffer stop_time;                    ///< n, of the step at which the run stopped; NaN where interrupted [s]
  Buffer metrics;                      ///< 21 x n, in the order of `Metrics`; NaN where interrupted or not asked for
  Buffer time;                         ///< m, of the trajectories [s]
  /// In the order of `Sample`: n x k, or n x m x k with NaN where a run had stopped; NaN where interrupted.
  std::array<Buffer, 9> samples;
  Buffer fuzzy_weights;  ///< n x 6 x 7 x 7 like Trajectory::fuzzy_weights; NaN where interrupted [N; N m]
};

/// Bytes that the result of one batch may take; more is refused before it is allocated.
inline constexpr double kMaxBatchBytes = kMaxLogBytes;

/// Runs `count` scenarios, each the base with its row of every variation.
///
/// All scenarios are checked before the first one runs. A run depends on its own scenario and on the kernel alone: not
/// on the other scenarios, their number or order, or on the number of threads.
/// @throws std::invalid_argument("scenario 17: key: expected ..., got ...") for the first bad one, without "scenario"
/// for keys, widths, counts and metrics; where the result would not fit into `kMaxBatchBytes`; for trajectories on
/// different time grids
BatchResult simulate_batch(const Settings& base, std::span<const Variation> variations, std::size_t count,
                           const BatchOptions& options, const Kernel& kernel = built_in_kernel());

}  // namespace hexservo
