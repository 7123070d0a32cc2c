/// @file
/// The servo tick: what a robot's control computer calls at every period (docs/model.md, section 7).
///
/// `step` is all of a law: image Jacobian, gradient and its rate, fuzzy systems and their adaptation, switching term,
/// wrench and leg forces. Fixed size, no heap, no exceptions, no branch whose cost depends on data. Gains are const and
/// shared, the state is a value, input and output are plain structs.
#pragma once

#include "hexservo/settings.hpp"

namespace hexservo {

/// What the controller of one robot needs, prepared and validated by `controller_gains`.
template <class Law>
struct ControllerGains {
  Hexapod<double> hexapod;
  ControlTask<double> task;
  typename Law::template Gains<double> law;
  double period = 1e-3;  ///< T_c, time between two ticks [s], 1e-3
};

/// What changes from tick to tick: the law's weights, and the last pose at which the legs could be solved.
template <class Law>
struct ControllerState {
  typename Law::template State<double> law;
  Pose<double> last_pose;  ///< home before the first valid input
};

/// What the sensors give at a tick.
struct ControllerInput {
  Image<double> image;    ///< measured features [px] and depths Z-hat, negative in front of the camera [m]
  Pose<double> pose;      ///< from the leg lengths, in B; the quaternion need not be of unit length
  Vector6<double> twist;  ///< chi-dot from the leg rates, in B [m/s; rad/s]
};

/// What a tick gives back.
struct ControllerOutput {
  Vector6<double> wrench;        ///< tau, about E's origin, in B [N; N m]
  Vector6<double> leg_forces;    ///< f_c with H f_c = tau, positive where they push [N]
  Vector6<double> fuzzy_output;  ///< tau_f [N; N m]
  /// The input, or what follows from it, was not usable: wrench G, leg forces at the last valid pose, state unchanged.
  bool invalid_input;
};

/// Prepares the controller of a scenario: estimates only, no plant.
/// @throws std::invalid_argument as `loop_parameters`, or for a period that is not positive
template <class Law>
ControllerGains<Law> controller_gains(const Settings<Law>& settings, double period);

extern template ControllerGains<Hybrid> controller_gains(const Settings<Hybrid>&, double);

/// State before the first tick.
template <class Law>
ControllerState<Law> initial_state(const ControllerGains<Law>& gains) {
  return {Law::initial_state(gains.law), {gains.hexapod.home_position, Pose<double>{}.quaternion}};
}

/// One tick; weights advance by forward Euler over the period.
///
/// Inputs that are not finite, a quaternion of no length, a point that is not in front of the camera, a singular pose,
/// or a wrench that overflows make the output safe: see `ControllerOutput::invalid_input`.
template <class Law>
ControllerOutput step(const ControllerGains<Law>& gains, ControllerState<Law>& state,
                      const ControllerInput& input) noexcept;

extern template ControllerOutput step(const ControllerGains<Hybrid>&, ControllerState<Hybrid>&,
                                      const ControllerInput&) noexcept;

}  // namespace hexservo
