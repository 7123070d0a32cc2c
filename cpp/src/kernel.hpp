/// @file
/// The border between baseline code and a kernel, the run loop compiled for one instruction set.
///
/// A kernel may live in a separate module that was compiled with other flags (docs/batch.md). The same templates
/// compiled with different flags share weak symbols and differ in alignment, so nothing but the plain data below
/// crosses the border, and no kernel is ever linked with another.
#pragma once

#include "hexservo/laws/list.hpp"
#include "hexservo/recording.hpp"

#include <array>

namespace hexservo {

inline constexpr int kKernelAbi = 15;                        ///< changes with everything below
inline constexpr char kKernelCapsule[] = "hexservo.kernel";  ///< name of the Python capsule that carries a Kernel

inline constexpr int kMetricNumbers = 21;         ///< of `Metrics`, in the order of its `visit`
inline constexpr int kWeightNumbers = 6 * 7 * 7;  ///< axis, term of u, term of u-dot
inline constexpr int kQuantities = 9;             ///< of `Sample`, in the order of its `visit`

/// Numbers of a quantity of a sample of `points` points.
constexpr int sample_width(std::size_t quantity, int points) {
  constexpr std::array<int, kQuantities> kWidths = {2, 1, 3, 4, 6, 6, 6, 6, 6};  // of the first two for each point
  return quantity < 2 ? kWidths[quantity] * points : kWidths[quantity];
}
/// All of them.
constexpr int sample_numbers(int points) {
  int sum = 0;
  for (std::size_t quantity = 0; quantity < kQuantities; ++quantity) sum += sample_width(quantity, points);
  return sum;
}
inline constexpr int kMostSampleNumbers = sample_numbers(16);

/// What a run gives back, for one scenario; the pointers are the caller's.
struct RunAnswer {
  double* time;                              ///< in: a row of the log takes one [s]; null: not asked for
  std::array<double*, kQuantities> columns;  ///< in: a row takes `sample_width`; null: not asked for
  double* weights;                           ///< in: `kWeightNumbers` at the end; null: not asked for
  double* weight_rows;                       ///< in: a row takes `kWeightNumbers`; null: not asked for
                                             ///< asked for, it has room for one row beyond `rows`

  double sample[kMostSampleNumbers];                            ///< the last good one
  double metrics[kMetricNumbers];                               ///< of the whole run
  double stroke_first_time[6], stroke_peak[6];                  ///< per leg, infinity: never passed [s]; [m]
  double force_first_time[6], force_peak[6];                    ///< [s]; [N]
  double speed_first_time[6], speed_peak[6];                    ///< [s]; [m/s]
  double base_joint_first_time[6], base_joint_peak[6];          ///< [s]; chord of the tilt [1]
  double platform_joint_first_time[6], platform_joint_peak[6];  ///< likewise
  double end_time;                                              ///< of the last good sample [s]
  long long steps;                                              ///< steps taken; the one that failed counts
  long long rows;                                               ///< of the log
  int cause;                                                    ///< StopCause as a number
  int limit_leg;                                                ///< leg that ended the run, 0 to 5; -1: none did
  double limit_value;                                           ///< what it had there, as `LoopRecord::limit_value`
  bool interrupted;                                             ///< stopped on request before its end
};

/// Scenarios that run together, at most one per lane.
struct RunRequest {
  LawId law;                        ///< laws/list.hpp
  int points;                       ///< of the target
  int places;                       ///< for points that the loop is compiled for, which hold them
  bool sampled;                     ///< mode of the scenarios
  int count;                        ///< of scenarios
  const double* const* parameters;  ///< one flattened LoopParameters (flatten.hpp) each
  long long numbers;                ///< of each of them, as a check
  Recording recorded;               ///< of the base, of all of them
  Recording recorded_target;        ///< of the target, likewise
  long long steps;
  long long log_every;  ///< steps between two rows of the log; 0: no log
  unsigned unmeasured;  ///< groups of metrics that are not asked for, `MetricGroups::left_out`
  bool log_end;         ///< also log the last good sample of a run that stops early, off the grid
  /// Asked every `ask_every` steps with the steps taken so far; true stops the run. May be null; does not throw.
  bool (*stop)(void* context, long long steps);
  void* context;
  long long ask_every;  ///< 1 or more where there is something to ask
  RunAnswer* answers;   ///< `count` of them
};

enum class RunStatus : int { done, unknown_law, other_layout, not_uniform, unknown_places, no_memory };

/// One instruction set's run loop.
struct Kernel {
  int abi;                                              ///< kKernelAbi
  int lanes;                                            ///< scenarios that `run_pack` takes
  const char* name;                                     ///< baseline, avx2 or avx512
  const char* flags;                                    ///< of the compiler
  RunStatus (*run_single)(const RunRequest&) noexcept;  ///< one scenario, in plain doubles
  RunStatus (*run_pack)(const RunRequest&) noexcept;    ///< one scenario per lane; missing ones repeat the last
  double (*fma_peak)(double seconds) noexcept;          ///< GFLOP/s of one core: independent chains of vector a b + c
};

/// The kernel that was compiled together with the caller.
const Kernel& built_in_kernel() noexcept;

}  // namespace hexservo
