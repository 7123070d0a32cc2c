/// @file
/// A run that the caller takes on step by step, with its log and answer as those of a kernel.
#pragma once

#include "hexservo/settings.hpp"
#include "kernel.hpp"
#include "trajectory_log.hpp"

#include <memory>

namespace hexservo::detail {

/// A run of any law, mode and number of points.
class RunInSteps {
 public:
  explicit RunInSteps(const Settings& given);
  virtual ~RunInSteps() = default;
  RunInSteps(const RunInSteps&) = delete;
  RunInSteps& operator=(const RunInSteps&) = delete;

  /// Takes `count` steps at most, and answers.
  /// @return whether it goes on
  virtual bool advance(long long count) = 0;
  virtual const Hexapod<double>& hexapod() const = 0;
  virtual const CameraParameters<double>& camera() const = 0;
  virtual void write_points(double* to) const = 0;  ///< of the target, in T, three numbers each [m]
  virtual void write_goal(double* to) const = 0;    ///< desired features, two numbers each [px]

  const RunAnswer& answer() const { return *request.answers; }

  Settings settings;  ///< a recorded motion is shared with the loop
  TrajectoryLog log;
  RunRequest request{};
};

/// @throws std::invalid_argument as `simulate`
std::unique_ptr<RunInSteps> started(const Settings& settings);

}  // namespace hexservo::detail
