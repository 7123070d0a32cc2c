/// @file
/// A run in `sampled` mode one tick at a time, for a controller that is not one of the core's laws
/// (docs/model.md, section 7).
#pragma once

#include "hexservo/simulation.hpp"

#include <memory>

namespace hexservo {

/// What a controller sees at a tick.
struct SampledObservation {
  long long tick;                            ///< k
  double time;                               ///< k T_c [s]
  double exposure;                           ///< time at which the newest frame was taken; NaN before the first [s]
  OfPoints<double, kAnyPoints, 2> features;  ///< measured; NaN where a law may not act on them [px]
  OfPoints<double, kAnyPoints> depth;        ///< Z-hat, negative in front of the camera; NaN likewise [m]
  Pose<double> pose;                         ///< from the joint sensors, in B
  Vector6<double> twist;                     ///< from the joint sensors, in B [m/s; rad/s]
};

/// Plant, sensors and actuators of a scenario, with its log; the scenario's own law does not act.
///
/// `observe`, then `command` or `command_legs`, until `running` is false; then `finish`.
class SampledRun {
 public:
  /// @throws std::invalid_argument as `simulate`, and for a scenario that is not in sampled mode
  explicit SampledRun(const Settings& settings);
  SampledRun(SampledRun&&) noexcept;
  SampledRun& operator=(SampledRun&&) noexcept;
  ~SampledRun();

  /// Whether there is a tick to command.
  bool running() const noexcept;
  SampledObservation observe() const;

  /// Commands a wrench in B about E's origin [N; N m], and goes on to the next tick.
  ///
  /// As for the core's laws, the safe output acts while an image is missing or too old.
  /// @throws std::invalid_argument for numbers that are not finite; std::logic_error where the run has ended
  void command(const Vector6<double>& wrench);
  /// Commands the forces of the legs, positive where they push [N]: the wrench that they give at this tick's pose.
  void command_legs(const Vector6<double>& leg_forces);

  /// The trajectory so far; a run with ticks left is `interrupted`. To be called once.
  Trajectory finish();

 private:
  struct Books;
  template <int N>
  struct BooksOf;
  std::unique_ptr<Books> books_;
};

}  // namespace hexservo
