/// @file
/// A run in `sampled` mode one tick at a time, for a controller that is not one of the core's laws
/// (docs/model.md, section 7).
#pragma once

#include "hexservo/simulation.hpp"

#include <memory>
#include <optional>
#include <vector>

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
  LegReading<double> joints;                 ///< what encoders gave at this tick; NaN where there is no reading
  Vector6<double> leg_positions;  ///< what drives that take positions took last, at first where they are; NaN otherwise
};

/// Plant, sensors and actuators of a scenario, with its log; the scenario's own law does not act.
///
/// `observe`, then `command` or `command_legs`, or `command_positions` where the drives take positions, until `running`
/// is false; then `finish`.
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
  /// @throws std::invalid_argument for numbers that are not finite, and for drives that take positions;
  /// std::logic_error where the run has ended
  void command(const Vector6<double>& wrench);
  /// Commands the forces of the legs, positive where they push [N]: the wrench that they give at this tick's pose.
  void command_legs(const Vector6<double>& leg_forces);
  /// Commands where each leg shall go [m], or cranks [rad], and goes on to the next tick. No safe output takes its
  /// place: drives hold what they took last.
  /// @throws std::invalid_argument as `command`, and for drives that take forces; std::logic_error likewise
  void command_positions(const Vector6<double>& positions);

  /// The trajectory so far; a run with ticks left is `interrupted`. To be called once.
  Trajectory finish();

 private:
  struct Books;
  template <int N>
  struct BooksOf;
  std::unique_ptr<Books> books_;
};

/// Runs side by side, commanded together by wrenches beyond the estimated weight.
class SampledRuns {
 public:
  /// @param count of places, which are empty until `start`
  explicit SampledRuns(int count) : places_(static_cast<std::size_t>(count)) {}

  int count() const noexcept { return static_cast<int>(places_.size()); }
  /// Starts a run at a place, and takes it to the tick of its first image, until which the safe output acts.
  /// @throws std::invalid_argument as `SampledRun`, and for drives that take positions; std::out_of_range for a place
  /// that there is not
  void start(int place, const Settings& settings);
  /// Commands wrenches (6, count) to the runs that go on [N; N m], and takes those to their next tick.
  /// @throws std::invalid_argument for another count or numbers that are not finite, before any run is commanded
  void command(const Eigen::Ref<const Eigen::Matrix<double, 6, Eigen::Dynamic>>& wrenches);

  /// What the sensors of a place gave last.
  /// @throws std::logic_error where none was started
  const SampledObservation& seen(int place) const { return one(place).seen; }
  /// Whether a place has come to the end of its duration.
  bool at_end(int place) const { return one(place).at_end(); }
  /// Whether a place takes commands.
  bool running(int place) const { return one(place).running(); }

 private:
  struct One {
    SampledRun run;
    SampledObservation seen;
    RigidBody<double> body;  ///< as estimated
    long long steps;

    bool at_end() const noexcept { return run.running() && seen.tick >= steps; }
    bool running() const noexcept { return run.running() && seen.tick < steps; }
    void command(const Vector6<double>& wrench);
  };
  const One& one(int place) const;

  std::vector<std::optional<One>> places_;
};

}  // namespace hexservo
