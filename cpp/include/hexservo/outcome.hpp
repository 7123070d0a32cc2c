/// @file
/// How a run ends (docs/model.md, section 8).
#pragma once

namespace hexservo {

/// How a run ended; where several apply at one instant the first of this list is reported.
enum class Outcome {
  completed,
  diverged,
  behind_camera,
  feature_lost,
  leg_limit,
  singular,
  solver_failed,
  interrupted
};

/// Why a run stopped before its end.
enum class StopCause {
  none,
  not_finite,
  feature_error,
  twist,
  behind_camera,
  feature_lost,
  leg_limit,
  singular,
  solver_failed,
  leg_speed,      ///< a leg beyond its speed limit
  base_joint,     ///< a leg that tilts too far at the base
  platform_joint  ///< or at the platform
};

/// The outcome that a cause stands for.
constexpr Outcome outcome_of(StopCause cause) {
  switch (cause) {
    case StopCause::not_finite:
    case StopCause::feature_error:
    case StopCause::twist:
      return Outcome::diverged;
    case StopCause::behind_camera:
      return Outcome::behind_camera;
    case StopCause::feature_lost:
      return Outcome::feature_lost;
    case StopCause::leg_limit:
    case StopCause::leg_speed:
    case StopCause::base_joint:
    case StopCause::platform_joint:
      return Outcome::leg_limit;
    case StopCause::singular:
      return Outcome::singular;
    case StopCause::solver_failed:
      return Outcome::solver_failed;
    case StopCause::none:
      break;
  }
  return Outcome::completed;
}

inline constexpr double kMaxFeatureError = 1e4;  ///< any |xi-tilde_i| beyond it is divergence [px]
inline constexpr double kMaxTwist = 1e3;         ///< any |chi-dot_j| beyond it is divergence [m/s; rad/s]

}  // namespace hexservo
