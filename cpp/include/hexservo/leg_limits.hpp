/// @file
/// Limits of the legs that few machines state: their speed, and how far they tilt at their joints
/// (docs/model.md, section 2); their first passing and peak are metrics (docs/model.md, section 8). Where a robot has
/// neither nothing is computed.
///
/// The tilt of a leg is the angle between its direction and the one at home, as the base sees them (c_i in B) and as
/// the platform does (R^T c_i); a crank carries the base's joint of its rod with it. It is compared by its chord |c -
/// c_home| = 2 sin(angle/2), which keeps its digits where the angle is small.
#pragma once

#include "hexservo/elementary.hpp"
#include "hexservo/hexapod.hpp"

#include <algorithm>
#include <cmath>

namespace hexservo {

/// Angle between two directions [rad] by the chord between their unit vectors.
inline double angle_of_chord(double chord) { return 2.0 * std::asin(std::min(0.5 * chord, 1.0)); }

/// What these limits are compared with, at one instant.
template <class S>
struct LegMotion {
  Vector6<S> lengths;          ///< l_i [m]
  Vector6<S> speeds;           ///< |l-dot_i| [m/s]
  Vector6<S> base_chords;      ///< |c_i - c_i at home| in B [1]
  Vector6<S> platform_chords;  ///< the same in E [1]
};

/// Speed and tilt of the legs of one robot, where it limits them.
template <class S>
class LegWatch {
 public:
  explicit LegWatch(const Hexapod<S>& hexapod)
      : legs_(hexapod),
        directions_B_(hexapod.home_directions_B),
        directions_E_(hexapod.home_directions_E),
        speed_limit_(hexapod.speed_limit),
        base_chord_(hexapod.joint_chords(0)),
        platform_chord_(hexapod.joint_chords(1)),
        acts_(any(speed_limit_ < none()) || any(base_chord_ < none()) || any(platform_chord_ < none())) {}

  /// Whether a limit is given, in any lane.
  bool acts() const noexcept { return acts_; }
  const S& speed_limit() const noexcept { return speed_limit_; }
  const S& base_chord() const noexcept { return base_chord_; }
  const S& platform_chord() const noexcept { return platform_chord_; }

  /// @param twist in B [m/s; rad/s]
  [[gnu::noinline]] LegMotion<S> at(const Vector3<S>& p_BE, const Vector4<S>& quaternion,
                                    const Vector6<S>& twist) const noexcept {
    using std::abs;
    const Matrix3<S> R_BE = rotation_matrix(quaternion);
    const Legs<S> legs = Legs<S>::of(inverse_kinematics(legs_, p_BE, R_BE));
    const Vector6<S> rates = legs.rates(twist);
    LegMotion<S> motion;
    motion.lengths = legs.lengths;
    for (int i = 0; i < 6; ++i) {
      Vector3<S> c = legs.directions_B.col(i), home = directions_B_.col(i);
      if (legs_.rotary) {
        c = rod_direction<S>(c, legs_.cranks.branch(i));
        home = turned(home, legs_.cranks.axes_B.col(i), S(legs.lengths(i) - legs_.cranks.home_angles(i)));
      }
      motion.speeds(i) = abs(rates(i));
      motion.base_chords(i) = distance(c, home);
      motion.platform_chords(i) = distance(rotate_back(R_BE, c), directions_E_.col(i));
    }
    return motion;
  }

 private:
  static S none() { return S(std::numeric_limits<double>::infinity()); }
  /// A vector after a rotation about a unit vector.
  static Vector3<S> turned(const Vector3<S>& v, const Vector3<S>& axis, const S& angle) {
    const S turns = S(1.0 / 6.283185307179586) * angle;
    const S sine = sine_of_turns(turns), cosine = sine_of_turns(S(turns + S(0.25)));
    const S along = (S(1.0) - cosine) * dot<S>(axis, v);
    const Vector3<S> across = cross<S>(axis, v);
    return Vector3<S>(cosine * v(0) + sine * across(0) + along * axis(0),
                      cosine * v(1) + sine * across(1) + along * axis(1),
                      cosine * v(2) + sine * across(2) + along * axis(2));
  }
  static S distance(const Vector3<S>& a, const Vector3<S>& b) {
    using std::sqrt;
    const Vector3<S> between = a - b;
    return sqrt(dot<S>(between, between));
  }

  LegGeometry<S> legs_;
  Matrix36<S> directions_B_, directions_E_;
  S speed_limit_, base_chord_, platform_chord_;
  bool acts_;
};

/// The speeds of the legs that a sample shows: at its time, and the mean since the sample before, which no motion has
/// without a speed as large in between. Legs that take positions are fastest between two ticks. What is beyond a limit
/// by rounding alone, as of legs whose drives have the same limit, is the limit.
template <class S>
class LegTravel {
 public:
  Vector6<S> speeds(double time, const LegMotion<S>& motion, const S& limit) noexcept {
    using std::abs;
    Vector6<S> fastest = motion.speeds;
    if (!is_first_)
      for (int i = 0; i < 6; ++i)
        fastest(i) = max(fastest(i), S(abs(S(motion.lengths(i) - lengths_(i))) / S(time - time_)));
    const S rounded = S(1.0 + kSpeedRounding) * limit;
    for (int i = 0; i < 6; ++i) fastest(i) = select((fastest(i) > limit) & (fastest(i) <= rounded), limit, fastest(i));
    is_first_ = false;
    time_ = time;
    lengths_ = motion.lengths;
    return fastest;
  }

 private:
  static constexpr double kSpeedRounding = 1e-9;  ///< of a difference of two lengths over a period

  bool is_first_ = true;
  double time_ = 0.0;
  Vector6<S> lengths_ = Vector6<S>::Zero();
};

/// Tilts of the legs from their directions at home, as the base (first row) and the platform see them [rad].
inline Eigen::Matrix<double, 2, 6> leg_tilts(const Hexapod<double>& hexapod, const Pose<double>& pose) {
  const LegMotion<double> motion =
      LegWatch<double>(hexapod).at(pose.position, pose.quaternion, Vector6<double>::Zero());
  Eigen::Matrix<double, 2, 6> tilts;
  tilts.row(0) = motion.base_chords.unaryExpr(&angle_of_chord).transpose();
  tilts.row(1) = motion.platform_chords.unaryExpr(&angle_of_chord).transpose();
  return tilts;
}

}  // namespace hexservo
