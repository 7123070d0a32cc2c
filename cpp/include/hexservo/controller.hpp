/// @file
/// The servo tick: what a robot's control computer calls at every period (docs/model.md, section 7).
///
/// `step` is all of a law: image Jacobian, gradient and its rate, fuzzy systems and their adaptation, switching term,
/// wrench and leg forces. Fixed size, no heap, no exceptions; every valid tick is the same work, and an invalid one
/// solves the legs once more in place of the adaptation. Gains are const and shared, the state is a value, input and
/// output are plain structs.
#pragma once

#include "hexservo/settings.hpp"

namespace hexservo {

/// What the controller of one robot needs, prepared and validated by `controller_gains`.
template <class Law>
struct ControllerGains {
  Hexapod<double> hexapod;
  LegGeometry<double> legs;
  ControlTask<double> task;
  typename Law::template Constants<double> law;
  typename Law::template State<double> initial_law_state;
  double period;         ///< T_c, time between two ticks [s]
  double image_timeout;  ///< oldest image that is used [s]; infinite: any
};

/// What changes from tick to tick: the law's weights, and the last pose at which the legs could be solved.
template <class Law>
struct ControllerState {
  typename Law::template State<double> law;
  Pose<double> last_pose;  ///< home before the first valid input
};

/// What the sensors give at a tick; a number that is not known is NaN.
using ControllerInput = Measurement<double>;

/// Whether an input could be used, and if not, why; the first that applies.
enum class InputStatus {
  valid,
  missing_image,  ///< no feature is known: all are NaN
  stale_image,    ///< the image is older than `ControllerGains::image_timeout`, or of unknown age
  unusable        ///< a number is not finite or beyond its limit, or what follows from the input is
};

/// What a tick gives back.
struct ControllerOutput {
  Vector6<double> wrench;        ///< tau, about E's origin, in B [N; N m]
  Vector6<double> leg_forces;    ///< f_c with H f_c = tau, positive where they push [N]
  Vector6<double> fuzzy_output;  ///< tau_f [N; N m]
  /// Unless it is `valid`, the wrench is G, the leg forces give it at the last valid pose, the fuzzy output is zero and
  /// the state is unchanged.
  InputStatus status;

  bool invalid_input() const noexcept { return status != InputStatus::valid; }
};

/// Prepares the controller of a scenario: estimates only, no plant (the errors in `settings.uncertainty` do not enter).
/// @param period T_c, time between two ticks [s]
/// @throws std::invalid_argument as `loop_parameters`, or for a period that is not positive
template <class Law>
ControllerGains<Law> controller_gains(const Settings<Law>& settings, double period);

/// Exists in the library for its own memory layout only. Code that is compiled for another instruction set (-mavx,
/// -march=native) lays out gains and state differently, and does not link: give both the same flags.
template <int alignment>
void library_was_built_with_other_instruction_set_flags() noexcept;

/// State before the first tick.
template <class Law>
ControllerState<Law> initial_state(const ControllerGains<Law>& gains) {
  library_was_built_with_other_instruction_set_flags<EIGEN_MAX_ALIGN_BYTES>();
  return {gains.initial_law_state, home_pose(gains.hexapod)};
}

/// One tick of (14), (15) with (13); the weights then advance by forward Euler over the period, (22).
///
/// Inputs that are not finite, features or twist beyond the limits at which a run counts as diverged
/// (`kMaxFeatureError`, `kMaxTwist`), a quaternion without a length, a point that is not in front of the camera, a
/// singular pose, or forces that overflow make the output safe: see `ControllerOutput::status`.
template <class Law>
ControllerOutput step(const ControllerGains<Law>& gains, ControllerState<Law>& state,
                      const ControllerInput& input) noexcept;

#define HEXSERVO_ELSEWHERE(Law)                                                             \
  extern template ControllerGains<Law> controller_gains(const Settings<Law>&, double);      \
  extern template ControllerOutput step(const ControllerGains<Law>&, ControllerState<Law>&, \
                                        const ControllerInput&) noexcept;
HEXSERVO_FOR_EACH_LAW(HEXSERVO_ELSEWHERE)
#undef HEXSERVO_ELSEWHERE

}  // namespace hexservo
