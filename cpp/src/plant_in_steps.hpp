/// @file
/// A plant in `sampled` mode whose caller is the controller: sensors, a command, and its newest sample.
#pragma once

#include "hexservo/controller.hpp"
#include "kernel.hpp"

#include <memory>

namespace hexservo::detail {

/// A plant of any number of points.
class PlantInSteps {
 public:
  explicit PlantInSteps(const Settings& given) : settings(given), points(given.target.count()) {}
  virtual ~PlantInSteps() = default;
  PlantInSteps(const PlantInSteps&) = delete;
  PlantInSteps& operator=(const PlantInSteps&) = delete;

  /// Commands what the drives take for this tick, and goes on to the next one: a wrench [N; N m], or leg positions [m],
  /// of cranks [rad].
  virtual void command(const Vector6<double>& command) = 0;

  Settings settings;                      ///< a recorded motion is shared with the plant
  int points;                             ///< of the target
  ControllerInputOf<kMostPoints> sensed;  ///< at this tick, times in seconds
  StopCause cause = StopCause::none;
  std::array<double, kMostSampleNumbers> sample{};  ///< the newest good one
  double time = 0.0;                                ///< of it [s]
};

/// Refuses scenarios in continuous mode, which have no ticks to command.
/// @param by who commands
void require_sampled(const Settings& settings, const std::string& by);

/// Refuses scenarios whose plant no wrench of a caller can command: in continuous mode, or with legs that take
/// positions.
/// @param by whose wrench it is, or what takes it
void require_commanded(const Settings& settings, const std::string& by);

/// @throws std::invalid_argument as `simulate` and `require_sampled`
std::unique_ptr<PlantInSteps> commanded_plant(const Settings& settings);

}  // namespace hexservo::detail
