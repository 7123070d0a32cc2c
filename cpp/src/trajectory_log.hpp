/// @file
/// A trajectory in the making: memory for the log of a run, and what becomes of a kernel's answer.
#pragma once

#include "hexservo/simulation.hpp"
#include "kernel.hpp"

namespace hexservo::detail {

/// Samples that a run logs at most.
/// @param points of the target
/// @param log_weights whether the weights of the fuzzy systems are in each
/// @throws std::invalid_argument where their log would not fit into `kMaxLogBytes`
std::size_t sample_count(const SimulationSettings& simulation, int points, bool log_weights = false);

/// Where a run writes, and what is made of that. The answer refers to the log's memory: it stays where it is made.
class TrajectoryLog {
 public:
  /// @throws std::invalid_argument as `sample_count`
  TrajectoryLog(const SimulationSettings& simulation, int points, bool log_weights = false);

  TrajectoryLog(const TrajectoryLog&) = delete;
  TrajectoryLog& operator=(const TrajectoryLog&) = delete;

  /// For the kernel to fill in.
  RunAnswer& answer() { return answer_; }

  /// Result of the run, once it is complete.
  /// @param step of the time grid [s]
  /// @param hexapod whose limits may have been passed
  Trajectory finish(double step, const Hexapod<double>& hexapod);

 private:
  Trajectory trajectory_;
  std::array<double, kWeightNumbers> weights_{};
  RunAnswer answer_{};
};

}  // namespace hexservo::detail
