/// @file
/// Leg length encoders of the sampled loop: what the controller knows of the pose and the twist (docs/model.md,
/// section 7).
///
/// Every `period` ticks the six lengths are read, with noise and resolution; forward kinematics, started at the pose
/// before or where the twist before led (`track_pose`), gives the pose, and the leg rates give the twist:
/// H^T chi-dot = l-dot with H at that pose. Both hold until the next reading.
///
/// | here        | meaning                                                          | unit        |
/// | ----------- | ---------------------------------------------------------------- | ----------- |
/// | lengths     | l_i as read: nearest multiple of the resolution to l_i + noise   | m           |
/// | pose        | forward kinematics of `lengths`, in B                            | m           |
/// | twist       | (H^T)^-1 l-dot, in B, H at `pose`                                | m/s; rad/s  |
#pragma once

#include "hexservo/elementary.hpp"
#include "hexservo/hexapod.hpp"
#include "hexservo/random.hpp"

#include <algorithm>
#include <cmath>

namespace hexservo {

/// Where the leg rates come from.
enum class RateSource {
  differences,  ///< of the readings, (l - l before)/period: the mean rate since the reading before; 0 at the first one
  true_rates    ///< H^T chi-dot of the true motion at the reading: an ideal rate sensor beside the encoders
};

/// The encoders of all legs.
template <class S>
struct EncoderParameters {
  S resolution{0.0};                           ///< a reading is a multiple of it [m], 0 (none)
  S noise{0.0};                                ///< standard deviation before the rounding [m], 0
  RateSource rates = RateSource::differences;  ///< what the twist is made of
  long long period = 1;                        ///< ticks between readings, 1

  template <class F, class A, class B>
  static void visit(F&& f, A& a, B& b) {
    f(a.resolution, b.resolution);
    f(a.noise, b.noise);
    f(a.rates, b.rates);
    f(a.period, b.period);
  }
};

inline constexpr int kEncoderRounds = 12;  ///< most Newton rounds of a reading: any motion without a singular pose

/// Newton rounds of a reading, 4 to `kEncoderRounds`: three, and one for every millisecond between two readings.
///
/// Four rounds find a pose that is 0.1 r_p and 0.1 rad from the start (100 r_p/s and 100 rad/s for 1 ms), eight one
/// that is r_p and 1 rad away. More than `kEncoderRounds` help only close to singular poses, where the lengths do not
/// tell one assembly mode from another. Since a reading takes `period`, no millisecond has more than four rounds.
/// @param period time between two readings [s]
inline int encoder_rounds(double period) noexcept {
  return 3 + static_cast<int>(std::ceil(std::min(1e3 * period - 1e-9, kEncoderRounds - 3.0)));
}

/// Forward kinematics of a reading, from what was known at the reading before.
///
/// Newton's method starts at the pose before, or at that pose moved on with the twist before, whichever has lengths
/// that are nearer to the reading: what the platform may do within a period is then limited by the change of its twist.
/// @param lengths of the legs, as read [m]
/// @param pose, twist at the reading before, in B [m/s; rad/s]; a twist that is not finite is not used
/// @param period time between the two readings [s]
template <class S>
ForwardKinematics<S> track_pose(const Hexapod<S>& hexapod, const Vector6<S>& lengths, const Pose<S>& pose,
                                const Vector6<S>& twist, double period) noexcept {
  const auto squared_distance = [&](const Pose<S>& from) {
    const Legs<S> legs = inverse_kinematics(hexapod, from.position, rotation_matrix(from.quaternion));
    return S((legs.lengths - lengths).squaredNorm());
  };
  const Vector6<S> motion = S(period) * twist;
  const Vector3<S> turn = motion.template tail<3>();
  const S tangent = S(1.0) + S(1.0 / 12.0) * turn.squaredNorm();  // of half the angle over it, to fourth order
  const Pose<S> moved{pose.position + motion.template head<3>(),
                      pose.quaternion + quaternion_rate<S>(pose.quaternion, tangent * turn)};
  const Mask<S> nearer = squared_distance(moved) < squared_distance(pose);
  const Pose<S> start{select(nearer, moved.position, pose.position), select(nearer, moved.quaternion, pose.quaternion)};
  return forward_kinematics(hexapod, lengths, start, encoder_rounds(period));
}

/// What six encoders say of a platform that starts at a known pose.
template <class S>
class Encoders {
 public:
  /// @param hexapod shared, not copied: it must outlive the encoders
  /// @param tick time between two ticks [s]
  /// @param start where forward kinematics starts the first time, in B
  Encoders(const EncoderParameters<S>& parameters, const Hexapod<S>& hexapod, const SeedHalves<S>& seed, double tick,
           const Pose<S>& start) noexcept
      : p_(parameters),
        hexapod_(hexapod),
        stream_(seed, RandomSource::encoder_noise),
        noisy_(any(parameters.noise > S(0.0))),
        seconds_(static_cast<double>(parameters.period) * tick),
        pose_(start),
        failed_(false) {}

  /// Reads the encoders if it is their tick; to be called at every tick, from 0.
  /// @param pose true, in B; @param twist true, in B [m/s; rad/s]
  void observe(long long tick, const Pose<S>& pose, const Vector6<S>& twist) noexcept {
    if (tick % p_.period != 0) return;
    const Legs<S> legs = legs_at(pose);
    Vector6<S> reading = legs.lengths;
    if (noisy_) reading += p_.noise * stream_.template normal<6>(static_cast<std::uint64_t>(tick / p_.period));
    for (int i = 0; i < 6; ++i) reading(i) = quantise(reading(i), p_.resolution);

    const ForwardKinematics<S> found = track_pose(hexapod_, reading, pose_, twist_, seconds_);
    failed_ = !found.converged;
    pose_.position = select(failed_, pose_.position, found.pose.position);
    pose_.quaternion = select(failed_, pose_.quaternion, found.pose.quaternion);

    Vector6<S> rates = Vector6<S>::Zero();
    if (p_.rates == RateSource::true_rates)
      rates = legs.rates(twist);
    else if (tick > 0)
      rates = (reading - lengths_) * S(1.0 / seconds_);
    twist_ = WrenchMapSolver<S>(hexapod_, legs_at(pose_)).twist(rates);
    lengths_ = reading;
  }

  const Vector6<S>& lengths() const noexcept { return lengths_; }
  const Pose<S>& pose() const noexcept { return pose_; }
  const Vector6<S>& twist() const noexcept { return twist_; }
  /// Where the newest readings belong to no pose near the one before, which then still stands.
  const Mask<S>& failed() const noexcept { return failed_; }

 private:
  Legs<S> legs_at(const Pose<S>& pose) const noexcept {
    return inverse_kinematics(hexapod_, pose.position, rotation_matrix(pose.quaternion));
  }

  EncoderParameters<S> p_;
  const Hexapod<S>& hexapod_;
  RandomStream<S> stream_;
  bool noisy_;      ///< in any lane
  double seconds_;  ///< between two readings
  Vector6<S> lengths_ = Vector6<S>::Zero();
  Pose<S> pose_;
  Vector6<S> twist_ = Vector6<S>::Zero();
  Mask<S> failed_;
};

}  // namespace hexservo
