/// @file
/// The parts of a scenario's closed loop at states that a caller gives, so that an analysis of runs or of poses copies
/// no equation.
///
/// | symbol              | here                          |                                                         |
/// | ------------------- | ----------------------------- | ------------------------------------------------------- |
/// | J, J-hat            | image_jacobian                | of the plant, and as the controller takes it            |
/// | Z-hat               | measured_depth                | (1 + delta_Z) Z [m]                                     |
/// | tau, tau_f, phi-bar | law                           | (13), (14), (15), (22), or another law's                |
/// | chi-ddot            | acceleration                  | of the actual plant (3)                                 |
/// | a                   | base_acceleration             | of the frame B, where the base moves                    |
/// | D, C, G (bars)      | inertia, estimated_wrenches   | of the estimate (1)                                     |
#pragma once

#include "hexservo/simulation.hpp"

#include <array>
#include <memory>
#include <span>
#include <vector>

namespace hexservo {

/// Given numbers of n states, row after row: a k-wide quantity has n k of them.
using Rows = std::span<const double>;

/// States at which a loop is looked at.
struct ProbeStates {
  Rows features;  ///< n x 2 p, of p points [px]
  Rows depth;  ///< n x p, negative in front of the camera; the controller's for `law`, the true ones for `stages` [m]
  Rows position;    ///< n x 3, p_BE [m]
  Rows quaternion;  ///< n x 4, (w, x, y, z) of any length but zero, 1e-150 to 1e150, used as it stands
  Rows twist;       ///< n x 6, in B [m/s; rad/s]
  Rows weights{};   ///< n x 6 x 7 x 7, axis, term of u, term of u-dot [N; N m]; empty: the scenario's initial ones
};

/// What a law gives; the memory is the caller's. All but the wrench may be empty: they are then not asked for.
struct ProbedLaw {
  Column wrench;               ///< n x 6, tau in B [N; N m]; NaN where the law has none
  Column fuzzy_output{};       ///< n x 6, tau_f [N; N m]; zero where no fuzzy systems act
  Column error_memberships{};  ///< n x 6 x 7, normalised, of u [1]
  Column rate_memberships{};   ///< n x 6 x 7, normalised, of u-dot [1]; phi-bar_rc is the product of r and c
  /// n x 6, a_j = driver_j/Psi_j with the dead zone [N/s; N m/s]: omega_j-dot = a_j phi-bar_j - sigma_j omega_j, and
  /// the limit then acts at the end of a step.
  Column adaptation{};
  /// n x 6 each by `LawPart`, in B [N; N m]: what the law's wrench is made of beside G; only those that the law has.
  std::array<Column, kLawParts> parts{};
  Column pose_error{};  ///< n x 6, that the law regulates, in B [m; rad]; only of a law that has one
};

/// The four stages of a Runge-Kutta step, and the state after it. Only next_weights may be empty, and is not asked for.
///
/// From the first stage on that has a point behind the camera, features, wrench, fuzzy_output and acceleration are NaN,
/// since the law does not see them; in the stages after it so are depth and body, which follow from that wrench.
struct ProbedStages {
  Column features, depth, position, quaternion, twist;  ///< n x 4 x 2 p, p, 3, 4, 6; true, the quaternion of any length
  Column wrench, fuzzy_output;                          ///< n x 4 x 6, in B [N; N m]
  Column acceleration;                                  ///< n x 4 x 6, in B [m/s^2; rad/s^2]
  /// n x 2 p, p, 3, 4, 6 and 6 x 7 x 7; NaN where a point comes behind the camera on the way.
  Column next_features, next_depth, next_position, next_quaternion, next_twist, next_weights{};
};

/// How the base moves; the memory is the caller's.
struct ProbedBase {
  Column position;           ///< n x 3, p_WB [m]; NaN where a sinusoid or noise has a frequency of 0
  Column attitude;           ///< n x 3 x 3, R_WB
  Column rate, rate_change;  ///< n x 3 each, Omega and Omega-dot in B [rad/s; rad/s^2]
};

/// Parts of the loop of one scenario. All functions are const, work row by row, and may run side by side.
///
/// @throws std::invalid_argument("name: expected ..., got ...") where rows are not n of their width, numbers are not
/// finite, a quaternion is zero (or beyond 1e-150 to 1e150) or a depth is not negative
class Probe {
 public:
  /// @throws std::invalid_argument as `loop_parameters`
  explicit Probe(const Settings& settings);
  Probe(Probe&&) noexcept;
  Probe& operator=(Probe&&) noexcept;
  ~Probe();

  /// Of the law.
  const LawTraits& traits() const noexcept;
  /// p, of the target.
  int points() const noexcept;
  /// Whether the law has fuzzy systems that act: otherwise it has neither weights nor memberships.
  bool has_fuzzy_systems() const noexcept;
  /// omega(0); of no meaning without fuzzy systems [N; N m].
  const FuzzyWeights<double>& initial_weights() const noexcept;

  /// Image of the target, (4).
  /// @param features n x 2 p [px]; NaN for a point that is not in front of the camera
  /// @param depth n x p, true Z_i [m]
  /// @throws std::invalid_argument also for a camera `as_printed`, which has no points
  void image(Rows position, Rows quaternion, Column features, Column depth) const;

  /// Poses from which the true points look nearest to the desired features, as `goal_minima` finds them from home.
  /// @throws std::invalid_argument as `image`
  std::vector<GoalMinimum> goal_minima() const;

  /// J of (12): twist in B (m/s; rad/s) to feature rates [px/s].
  /// @param depth as the Jacobian shall take it: the true ones, or the controller's [m]
  /// @param position, quaternion pose of the platform; no positions: for a camera on the platform they do not matter
  /// @param controller the controller's sign and camera instead of the plant's
  /// @param jacobian n x 2 p x 6
  void image_jacobian(Rows features, Rows depth, Rows position, Rows quaternion, bool controller,
                      Column jacobian) const;

  /// Z-hat of the controller for true Z, n x p [m].
  void measured_depth(Rows depth, Column measured) const;

  /// The law at one instant each; in `sampled` mode as at a servo tick, without sensors, frames and actuators.
  void law(const ProbeStates& states, const ProbedLaw& out) const;

  /// chi-ddot of the actual plant under a wrench, (3), n x 6 [m/s^2; rad/s^2].
  /// @param position it is the same at each, but only finite ones are states
  void acceleration(Rows position, Rows quaternion, Rows twist, Rows wrench, Column acceleration) const;

  /// Acceleration of the frame B at times >= 0 [s], n x 3 in W [m/s^2]; zero in continuous mode, whose base stands.
  void base_acceleration(Rows time, Column acceleration) const;

  /// Where B is in W at times >= 0 [s], and how it turns.
  void base_motion(Rows time, const ProbedBase& out) const;

  /// What the motion of the base adds to the wrench on the actual platform at times >= 0 [s], n x 6 in B [N; N m].
  void base_wrench(Rows time, Rows position, Rows quaternion, Rows twist, Column wrench) const;

  /// D-bar chi-ddot and C-bar chi-dot of the estimated dynamics (1), n x 6 each [N; N m].
  void estimated_wrenches(Rows quaternion, Rows twist, Rows acceleration, Column inertial, Column coriolis) const;
  /// G-bar of (1) [N; N m].
  Vector6<double> gravity() const noexcept;

  /// D-bar of (1), n x 6 x 6: acceleration in B (m/s^2; rad/s^2) to wrench.
  void inertia(Rows quaternion, Column inertia) const;

  /// All of a step of a loop in continuous mode, as `ClosedLoop` takes it from a state: both are `LoopEquations`.
  /// Whether the loop would stop there for another reason than a point behind the camera is not asked.
  /// @param states with the true depths; image and pose are used as given, whether or not they agree
  /// @throws std::invalid_argument also in `sampled` mode, where the law is not in the stages
  void stages(const ProbeStates& states, const ProbedStages& out) const;

  /// Where a platform starts a step: n x 3, 4, 6.
  struct Body {
    Rows position, quaternion, twist;
  };
  /// What makes the rate of stages, its quaternion, twist and acceleration: one row of each for every body in `moved`,
  /// four in `after`.
  struct BodyStage {
    Rows quaternion, twist, acceleration;
  };

  /// A Runge-Kutta stage of the platform, start + scale times the rate of an earlier stage (docs/model.md, section 7).
  /// The quaternion is not normalised inside a step.
  /// @param stage n x 4, 6, 6: the earlier one
  /// @param scale h/2, h/2, h for the second to the fourth stage [s]
  static void moved(const Body& start, const BodyStage& stage, double scale, Column position, Column quaternion,
                    Column twist);

  /// The platform after a step, its quaternion normalised, from the four stages.
  /// @param stages n x 4 x 4, 6, 6
  /// @param step h [s]
  static void after(const Body& start, const BodyStage& stages, double step, Column position, Column quaternion,
                    Column twist);

 private:
  void require_points() const;

  struct Parts;
  template <int N>
  struct Scene;
  template <class Law, int N>
  struct PartsOf;
  std::unique_ptr<const Parts> parts_;
};

}  // namespace hexservo
