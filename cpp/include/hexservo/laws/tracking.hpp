/// @file
/// Tracking: the legs of a machine that takes positions are sent to the pose that sees a target, which may move, as
/// desired (docs/model.md, section 5). The equations are in target_tracking.hpp: they need the pose of each frame's
/// exposure, which no other law asks for.
#pragma once

#include "hexservo/laws/law_without_fuzzy.hpp"
#include "hexservo/laws/pose_error.hpp"

namespace hexservo {

/// How the platform follows its target.
enum class Follow {
  pose,      ///< the pose of the camera relative to the target is the desired one: six degrees of freedom
  direction  ///< the ray of the desired features' middle points at the target's; the position stays that of home
};

/// Gains of the law `tracking`.
template <class S, int N = kPoints>
struct TrackingGains {
  Follow follow = Follow::pose;
  S bandwidth{2.5};                                       ///< of the motion towards the target [Hz], 2.5
  S noise{0.5};                                           ///< standard deviation of a measured coordinate [px], 0.5
  Vector6<S> acceleration = linear_angular<S>(0.5, 1.0);  ///< sigma_a of the target [m/s^2; rad/s^2], 0.5 x3, 1 x3
  Vector6<S> speed = linear_angular<S>(0.2, 0.4);  ///< sigma_v of a target just seen [m/s; rad/s], 0.2 x3, 0.4 x3
  S jump{6.0};       ///< standard deviations of what is expected, beyond which the target is somewhere else [1], 6
  S certainty{2.5};  ///< standard deviations that a velocity has to be of, to count [1], 2.5
  S lead{1.0};       ///< share of the legs' lag that the command leads by [1], 1
  S feedback{0.0};   ///< gain on how far the legs are behind the reference [1], 0
  S integral{0.0};   ///< rate at which the command makes up for where the legs come to rest [1/s], 0
  Vector6<S> band = linear_angular<S>(1e-4, 2e-3);  ///< of such a pose error that is left [m; rad], 1e-4 x3, 2e-3 x3

  /// The pose of the goal is followed, and of a direction the middle of the image alone.
  bool needs_goal() const { return follow == Follow::pose; }

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"follow"}.of_pack(), self.follow...);
    v(Field{"bandwidth", "Hz", kPositive}, self.bandwidth...);
    v(Field{"noise", "px", kPositive}, self.noise...);
    v(Field{"acceleration", "m/s^2; rad/s^2", kPositive}, self.acceleration...);
    v(Field{"speed", "m/s; rad/s", kPositive}, self.speed...);
    v(Field{"jump", "1", kPositive}, self.jump...);
    v(Field{"certainty", "1", kNotNegative}, self.certainty...);
    v(Field{"lead", "1", kNotNegative}, self.lead...);
    v(Field{"feedback", "1", kNotNegative}, self.feedback...);
    v(Field{"integral", "1/s", kNotNegative}, self.integral...);
    v(Field{"band", "m; rad", kPositive}, self.band...);
  }
};

/// The law as a policy of the loop.
struct Tracking : StatelessLaw<TrackingGains> {
  static constexpr LawTraits traits = {
      .name = "tracking", .type = "Tracking", .parts = {}, .output = LawOutput::pose, .points = true};

  /// There is no wrench of an instant: NaN. A machine whose legs do not take positions is refused.
  template <class S, int N, class Listener = NoListener>
  static void evaluate(const ControlTask<S, N>& /*task*/, const Constants<S, N>& /*gains*/, const Stage<S>& /*stage*/,
                       const LawInput<S, N>& /*input*/, Evaluation<S>& out,
                       const Listener& /*listener*/ = {}) noexcept {
    out.wrench = unknown_six<S>();
  }
};

}  // namespace hexservo
