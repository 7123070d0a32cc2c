/// @file
/// The latency of a camera whose frames carry no exposure, found while the loop runs (docs/model.md, section 5).
///
/// A frame is stamped when it arrives, an unknown but constant time L after its exposure. For each of `kLatencies`
/// candidates L_j the middle of the features is lifted with the pose that the joints had L_j before the stamp, and
/// gives a direction u_j in B. Of a target at rest or with a constant velocity the directions of three frames have the
/// second difference
///
///     r_j = (u_j - u_j') - rho (u_j' - u_j''),  rho = (t - t')/(t' - t'')
///
/// of zero for the true latency, but for noise; for another one the camera's own motion stays in it. So each candidate
/// has a cost, the sum of |r_j|^2 over its variance; what lies within `kLatencyCost` of the least cost is possible.
/// Without motion all candidates cost the same. Frames that no candidate explains (a target that jumps) count less, as
/// do those taken in a motion that a scatter of the latency, L ... L + jitter, leaves undecided.
#pragma once

#include "hexservo/camera.hpp"
#include "hexservo/perception.hpp"

#include <array>
#include <cmath>

namespace hexservo {

inline constexpr double kMaxLatency = 0.25;      ///< longest latency that is looked for [s]
inline constexpr int kLatencies = 51;            ///< candidates from 0 to `kMaxLatency`, 5 ms apart
inline constexpr double kLatencyCost = 9.0;      ///< over the least cost: three standard deviations [1]
inline constexpr double kLatencyMemory = 0.998;  ///< what of a cost stays from frame to frame [1]
/// Standard deviation of r_j by what lies between candidates and between ticks, over the largest |r_j - r_0| [1].
inline constexpr double kLatencyModelError = 0.03;
inline constexpr double kLongestFrameGap = 1.0;  ///< between frames that are compared [s]

/// Candidate j [s].
constexpr double candidate_latency(int j) { return kMaxLatency / (kLatencies - 1) * j; }

/// What is known of a latency [s]; all three are the same where frames carry their exposure.
template <class S>
struct LatencyRange {
  S estimate{0.0}, least{0.0}, most{0.0};
};

/// Costs of all candidates; fixed size.
template <class S>
class LatencyEstimator {
 public:
  LatencyEstimator() {
    cost_.setZero();
    for (auto& of_frame : directions_) of_frame.fill(Vector3<S>::Zero());
    seen_.setZero();
    stamps_.setZero();
    weigh();
  }

  /// Takes a frame.
  /// @param poses of the joints by tick; before the first one the platform was where it is there
  /// @param taken lanes that have a new frame; @param stamp when it arrived [ticks]; @param period of a tick [s]
  /// @param middle of the features [px], at a depth [m]; @param home centre of the camera at home, in B [m]
  /// @param noise standard deviation of a component of a direction [rad]
  /// @param jitter most that the latency of a frame is longer [s]
  void update(const PoseHistory<S>& poses, const CameraView<S>& camera, const Mask<S>& taken, const S& stamp,
              double period, const Vector2<S>& middle, const S& depth, const Vector3<S>& home, const S& noise,
              double jitter) noexcept {
    using std::sqrt;
    const S gap = stamp - stamps_(0), before = stamps_(0) - stamps_(1);
    const Mask<S> counts = taken & (seen_(0) >= S(2.0)) & (gap > S(0.0)) & (before > S(0.0)) &
                           (gap * S(period) <= S(kLongestFrameGap)) & (before * S(period) <= S(kLongestFrameGap));
    const S ratio = select(counts, S(gap / before), S(1.0));
    Vector<S, kLatencies> squares;
    Vector3<S> first = Vector3<S>::Zero();
    S least(0.0), spread(0.0), scatter(0.0);
    const int apart = static_cast<int>(std::ceil(jitter / candidate_latency(1)));
    for (int j = 0; j < kLatencies; ++j) {
      const auto place = static_cast<std::size_t>(j);
      const S tick = max(S(stamp - S(candidate_latency(j) / period)), S(poses.oldest()));
      const Pose<S> pose = poses.at(tick);
      const Vector3<S> point = lift<S>(camera, pose.position, rotation_matrix(pose.quaternion), middle, depth) - home;
      const Vector3<S> direction = point * (S(1.0) / sqrt(point.squaredNorm()));
      const Vector3<S>&last = directions_[0][place], &older = directions_[1][place];
      const Vector3<S> r = (direction - last) - ratio * (last - older);
      squares(j) = r.squaredNorm();
      if (j == 0) first = r;
      least = j == 0 ? squares(0) : min(least, squares(j));
      spread = max(spread, S(Vector3<S>(r - first).squaredNorm()));
      if (j >= apart && apart > 0) {
        const Vector3<S>& sooner = directions_[0][static_cast<std::size_t>(j - apart)];  // of this frame already
        scatter = max(scatter, S(Vector3<S>(direction - sooner).squaredNorm()));
      }
      directions_[1][place] = select(taken, last, older);
      directions_[0][place] = select(taken, direction, last);
    }
    const S variance = noise * noise * (S(1.0) + (S(1.0) + ratio) * (S(1.0) + ratio) + ratio * ratio) +
                       S(kLatencyModelError * kLatencyModelError) * spread + scatter;
    const S share = S(1.0) / (variance + S(1.0 / kLatencyCost) * least);  // of a triple that some candidate explains
    const Mask<S> good = counts & is_finite(S(squares.sum()));
    for (int j = 0; j < kLatencies; ++j)
      cost_(j) = select(good, S(S(kLatencyMemory) * cost_(j) + (squares(j) - least) * share), cost_(j));
    stamps_(1) = select(taken, stamps_(0), stamps_(1));
    stamps_(0) = select(taken, stamp, stamps_(0));
    seen_(0) = select(taken, min(S(seen_(0) + S(1.0)), S(2.0)), seen_(0));
    weigh();
  }

  /// Estimate and interval [s].
  const LatencyRange<S>& range() const noexcept { return range_; }

  /// Calls `f` with each member that is kept from frame to frame, always in the same order.
  template <class F>
  void for_each_member(F&& f) {
    f.finite(cost_);
    for (auto& of_frame : directions_)
      for (Vector3<S>& direction : of_frame) f.finite(direction);
    f.finite(stamps_);
    f.finite(seen_);
    weigh();
  }

 private:
  /// The candidates that are possible, and their mean, each with the weight (1 - excess/kLatencyCost)^2.
  void weigh() noexcept {
    S lowest = cost_(0);
    for (int j = 1; j < kLatencies; ++j) lowest = min(lowest, cost_(j));
    S weights(0.0), sum(0.0), least(kMaxLatency), most(0.0);
    for (int j = 0; j < kLatencies; ++j) {
      const S left = max(S(S(1.0) - (cost_(j) - lowest) * S(1.0 / kLatencyCost)), S(0.0)), weight = left * left;
      const S latency(candidate_latency(j));
      weights += weight;
      sum += weight * latency;
      least = select(left > S(0.0), min(least, latency), least);
      most = select(left > S(0.0), max(most, latency), most);
    }
    range_.estimate = sum / weights;
    range_.least = max(S(least - S(candidate_latency(1))), S(0.0));
    range_.most = min(S(most + S(candidate_latency(1))), S(kMaxLatency));
  }

  Vector<S, kLatencies> cost_;                                    ///< over that of the best candidate of each frame [1]
  std::array<std::array<Vector3<S>, kLatencies>, 2> directions_;  ///< u_j' and u_j''
  Vector2<S> stamps_;                                             ///< of the last two frames [ticks]
  Vector<S, 1> seen_;                                             ///< frames so far, up to two
  LatencyRange<S> range_;
};

}  // namespace hexservo
