/// @file
/// What a controller commands to a machine that takes positions: the motion of a platform that it keeps itself
/// (docs/model.md, section 7).
#pragma once

#include "hexservo/hexapod.hpp"

#include <limits>

namespace hexservo {

/// How a law's wrench becomes a commanded motion.
template <class S>
struct MotionGains {
  bool acts = false;                          ///< the machine takes positions: of others nothing else is looked at
  bool massless = false;                      ///< the motion is the law's own, at which its wrench is its weight
  Vector6<S> viscosity = Vector6<S>::Ones();  ///< of the law of a massless platform [N s/m; N m s/rad]
  Vector6<S> damping = Vector6<S>::Zero();    ///< D_v of one with its mass [N s/m; N m s/rad]
  S speed_limit{std::numeric_limits<double>::infinity()};         ///< of a leg [m/s]
  S acceleration_limit{std::numeric_limits<double>::infinity()};  ///< of a leg [m/s^2]
};

/// The virtual platform, whose pose is the command.
template <class S>
struct CommandedMotion {
  bool acts = false;                      ///< whether there is one
  Mask<S> begun = Mask<S>(false);         ///< where the joints have been known once
  Pose<S> pose;                           ///< in B
  Vector6<S> twist = Vector6<S>::Zero();  ///< in B [m/s; rad/s]
  Vector6<S> legs = Vector6<S>::Constant(S(std::numeric_limits<double>::quiet_NaN()));  ///< q* [m], or [rad]

  /// Calls `f` with each member that is kept from tick to tick, always in the same order.
  template <class F>
  void for_each_member(F&& f) {
    if (!acts) return;
    f(begun);
    f.finite(pose.position);
    f.finite(pose.quaternion);
    f.finite(twist);
    f(legs);
  }
};

}  // namespace hexservo
