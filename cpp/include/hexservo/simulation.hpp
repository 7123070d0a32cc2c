/// @file
/// Runs one scenario and logs it.
#pragma once

#include "hexservo/buffer.hpp"
#include "hexservo/settings.hpp"

#include <functional>
#include <span>
#include <string>
#include <vector>

namespace hexservo {

struct Kernel;
/// The run loop that was compiled into this library; hexservo's Python package has others (docs/batch.md).
const Kernel& built_in_kernel() noexcept;

/// A leg beyond one of its limits, which is reported, and ends the run with `LimitPolicy::stop`.
struct LimitEvent {
  enum class Kind { stroke, force, speed, base_joint, platform_joint };
  Kind kind;
  int leg;            ///< 0 to 5
  double first_time;  ///< [s]
  double peak;        ///< of the run: |l - middle of the travel| [m], |force| [N], |rate| [m/s] or tilt [rad];
                      ///< where it ended the run that of the step that failed, which no metric has
  double limit;       ///< likewise
};

/// One logged quantity, row after row.
using Column = std::span<double>;

/// Logged samples of a run, row after row: `time` has n entries, a k-wide quantity n k. All columns lie in one block.
///
/// A sample is judged with the weights that belong to it: where a leg limit, a singular pose, sensors without a pose or
/// a wrench that is not finite end a run, `fuzzy_weights` are one step ahead of the last row.
struct Trajectory {
  Buffer block;
  int points = kPoints;                ///< p, of the target
  Column time;                         ///< [s]
  Column feature_error;                ///< n x 2 p, xi_d - xi, true [px]
  Column depth;                        ///< n x p, true Z_i [m]
  Column position;                     ///< n x 3, p_BE [m]
  Column quaternion;                   ///< n x 4, (w, x, y, z)
  Column twist;                        ///< n x 6, in B [m/s; rad/s]
  Column wrench;                       ///< n x 6, in B [N; N m]
  Column fuzzy_output;                 ///< n x 6 [N; N m]
  Column leg_lengths;                  ///< n x 6 [m]
  Column leg_forces;                   ///< n x 6 [N]
  Column weight_history;               ///< n x 6 x 7 x 7, axis, term of u, term of u-dot [N or N m]; empty: not logged
  FuzzyWeights<double> fuzzy_weights;  ///< after the last step, which may be one beyond the last sample [N or N m]

  Outcome outcome = Outcome::completed;
  std::string detail;              ///< one sentence
  double end_time = 0.0;           ///< time of the last good sample [s]
  double stop_time = 0.0;          ///< time of the step that failed, else `end_time` [s]
  long long steps = 0;             ///< steps taken
  std::vector<LimitEvent> events;  ///< in the order of their first times
  Metrics<double> metrics;
};

/// Bytes that the log of one run may take; more is refused before it is allocated.
inline constexpr double kMaxLogBytes = 2.0 * 1024 * 1024 * 1024;

/// Checks everything that `simulate` checks, without running.
/// @throws std::invalid_argument as `simulate`
void check_settings(const Settings& settings);

/// Runs a scenario from home, at rest. The last good sample is always logged.
/// @param stop_requested asked every few milliseconds; true ends the run with `Outcome::interrupted`
/// @param kernel the instruction set to run with
/// @param log_weights whether to log the weights of the fuzzy systems too; where none act there is no `weight_history`
/// @throws std::invalid_argument as `loop_parameters`, or where the log would not fit into `kMaxLogBytes`
Trajectory simulate(const Settings& settings, const std::function<bool()>& stop_requested = {},
                    const Kernel& kernel = built_in_kernel(), bool log_weights = false);

/// One sentence on how a run that was not interrupted ended.
/// @param time of the step at which it stopped [s]
/// @param leg that ended it, 0 to 5, where one did
std::string describe(StopCause cause, double time, int leg = -1);

/// The platform alone under constant leg forces, without camera or controller (RK4).
/// @param leg_forces [N], positive where they push
/// @param steps number of steps of `step` [s]
/// @return body state (p_BE, quaternion, twist) at the end
/// @throws std::invalid_argument for inputs that are not finite or not positive
BodyState<double> drive_legs(const Hexapod<double>& hexapod, const RigidBody<double>& body,
                             const DynamicsError<double>& error, const BodyState<double>& start,
                             const Vector6<double>& leg_forces, double step, long long steps);

}  // namespace hexservo
