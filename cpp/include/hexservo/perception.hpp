/// @file
/// Input of a controller at a tick: the image that its law uses, the pose and the twist of the platform, and whether
/// it may act on them (docs/model.md, section 7).
///
/// Frames arrive late, out of order and with points missing; each point keeps the newest image in which it was seen,
/// and its age counts from that exposure. Where points are predicted they are lifted with the pose that the joint
/// sensors gave at the exposure, and projected again through the pose of the tick. Encoders' lengths become a pose by
/// forward kinematics, started at the pose before or where the twist before led, and leg rates become a twist by H^T
/// chi-dot = l-dot with H at that pose.
///
/// Times are in ticks; those that lie between two ticks are as good.
#pragma once

#include "hexservo/encoders.hpp"
#include "hexservo/frames.hpp"
#include "hexservo/outcome.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory_resource>
#include <optional>
#include <vector>

namespace hexservo {

/// What the sensors give a controller at a tick; a number that is not known is NaN.
template <class S, int N = kPoints>
struct SensorInput {
  double now = 0.0;      ///< [ticks]
  Frame<S, N> frame;     ///< that arrived since the tick before, if any
  Pose<S> pose;          ///< in B, where the joint sensors give it directly; the quaternion need not be of unit length
  Vector6<S> twist;      ///< in B, from the same sensors [m/s; rad/s]
  LegReading<S> joints;  ///< where there are encoders
};

/// What a controller has to know to make use of its sensors.
template <class S, int N = kPoints>
struct Sensing {
  Hexapod<S> hexapod;
  LegGeometry<S> legs;
  PlatformCamera<S> camera;           ///< as it is assumed
  Lens<S> lens;                       ///< likewise
  Vector<S, 2 * N> desired_features;  ///< xi_d of the assumed pinhole [px]
  FrameSettings<S> frames;
  PoseSource pose_source;
  EncoderParameters<S> encoders;
  double period;                    ///< T_c, time between two ticks [s]
  int points = N;                   ///< of the target; what a frame shows in the places beyond them is not looked at
  PointWeights<S, N> weights = {};  ///< of the points: one that counts 0 need not be seen
};

/// How far a time may be off a tick, or an age off its limit, and still be at it: rounding [ticks].
inline constexpr double kTickTolerance = 1e-6;

/// How much later than twice their period readings of encoders may be [ticks]: no loop ticks exactly on time.
inline constexpr double kLateReading = 0.5;

/// Longest way of the clock from one tick to the next as the joints' readings count it [ticks]: of a sum that is
/// larger, rounding would leave no time between later readings.
inline constexpr double kLongestTick = 1e9;

/// Ticks on which a clock may stand still; one that does so for longer has stopped.
inline constexpr std::size_t kStandingTicks = 10;

/// Periods from one tick to the next that are too many for a clock in seconds, where it is so for more than
/// `kStandingTicks` ticks one after the other.
inline constexpr double kHurriedPeriods = 100.0;

/// Part of a period from one tick to the next that is too little for one, likewise: such a clock counts as one that
/// stands still. One in minutes goes on by a sixtieth.
inline constexpr double kCrawlingPeriods = 0.02;

/// How far from home a first pose may be that is measured as such, in lengths of the longest leg at home; later ones
/// may be one length from the pose before.
inline constexpr double kFarthestStart = 10.0;

/// Squared cosine of half the angle by which such a pose may be turned, from the pose before (90 deg) and of the first
/// one from home (150 deg): an attitude as (x, y, z, w) is about 180 deg off.
inline constexpr double kFarthestTurn = 0.5;
inline constexpr double kFarthestFirstTurn = 0.0669872981077807;

inline constexpr int kEncoderRounds = 12;  ///< most Newton rounds of a reading: any motion without a singular pose

/// Newton rounds of a reading, 4 to `kEncoderRounds`: three, and one for every millisecond between two readings.
///
/// Four rounds find a pose that is 0.1 r_p and 0.1 rad from the start (100 r_p/s and 100 rad/s for 1 ms), eight one
/// that is r_p and 1 rad away. More than `kEncoderRounds` help only close to singular poses, where the lengths do not
/// tell one assembly mode from another. Since a reading takes `period`, no millisecond has more than four rounds.
/// @param period time between two readings [s]
/// @return of which a fraction counts as one more
template <class S>
S encoder_rounds(const S& period) noexcept {
  return S(3.0) + min(S(S(1e3) * period - S(1e-9)), S(kEncoderRounds - 3.0));
}

/// Forward kinematics of a reading, from what was known at the reading before.
///
/// Where the reading is not close by, Newton's method starts at the pose before, or at that pose moved on with the
/// twist before, whichever has lengths that are nearer to the reading: what the platform may do within a period is then
/// limited by the change of its twist.
/// @param lengths of the legs, as read [m]
/// @param pose, twist at the reading before, in B [m/s; rad/s]; a twist that is not finite is not used
/// @param there legs and solver at that pose
/// @param period time between the two readings [s]
/// @param rounds of Newton's method
/// @param[out] found
template <class S>
void track_pose(const LegGeometry<S>& geometry, const Vector6<S>& lengths, const Pose<S>& pose, const Vector6<S>& twist,
                const SolvedLegs<S>& there, const S& period, const S& rounds, ForwardKinematics<S>& found) noexcept {
  const Mask<S> close = pose_close_by(geometry, lengths, pose, there, found);
  if (all(close)) return;
  const LegVector<S> goal(lengths);
  const bool mixed = any(close);
  ForwardKinematics<S> beside;
  ForwardKinematics<S>& far = mixed ? beside : found;
  go_to(geometry, goal, carried(pose, twist, period), far);
  const LegVector<S> from_moved = (goal - far.legs.lengths).padded(), from_start = (goal - there.legs.lengths).padded();
  const auto [moved_distance, start_distance] = dots(from_moved, from_moved, from_start, from_start);  // squared
  const Mask<S> nearer = moved_distance < start_distance;
  if (!all(nearer)) go_to(geometry, goal, select_pose(nearer, far.pose, pose), far);
  solve_pose(geometry, lengths, rounds, far);
  if (mixed) {
    found.pose = select_pose(close, found.pose, far.pose);
    found.legs = select(close, found.legs, far.legs);
    found.converged = close | far.converged;
  }
}

/// Largest ratio of the distances between four ticks that a cubic is laid through.
inline constexpr double kUnevenTicks = 2.0;

/// How far the square of a quaternion's length may be off 1 where it counts as 1.
inline constexpr double kUnitQuaternion = 1e-9;

/// Poses of the last ticks; memory is taken once, at construction.
template <class S>
class PoseHistory {
 public:
  /// @param capacity ticks that are kept; 0: none
  explicit PoseHistory(long long capacity, std::pmr::memory_resource* memory = std::pmr::get_default_resource())
      : entries_(static_cast<std::size_t>(capacity), memory) {}

  /// @param tick not before the one that was added last; the same one replaces it
  /// @param active lanes whose pose is known; the others keep the one before
  void add(double tick, const Pose<S>& pose, const Mask<S>& active) noexcept {
    const std::size_t last = count_ == 0 ? 0 : place(count_ - 1);
    const bool replaces = count_ > 0 && entries_[last].tick == tick;
    Entry& entry = entries_[replaces ? last : place(count_)];
    entry.tick = tick;
    if (all(active) || count_ == 0) {
      entry.pose = pose;
    } else {
      entry.pose = select_pose(active, pose, entries_[last].pose);
    }
    // Of unit length, since a longer one would count for more between two ticks; what rounding leaves does not count.
    using std::abs;
    const S squared = entry.pose.quaternion.squaredNorm();
    if (const Mask<S> longer = abs(S(squared - S(1.0))) > S(kUnitQuaternion); any(longer)) [[unlikely]]
      entry.pose = select_pose(longer, unit_pose(entry.pose), entry.pose);
    if (!replaces) ++count_;
  }

  /// The pose at a time: that of its tick, or between two ticks on the cubic through the four nearest ones, since a
  /// straight line cuts the bend of an accelerated motion; on the straight line where fewer are kept, or where one of
  /// their distances is more than `kUnevenTicks` times another. NaN where the time is not covered.
  Pose<S> at(const S& tick) const noexcept {
    return of_lanes(tick, [this](double one) { return between(one, true); });
  }

  /// Likewise, always on the straight line: how far it is from `at` bounds what the ticks leave open between them.
  Pose<S> on_line(const S& tick) const noexcept {
    return of_lanes(tick, [this](double one) { return between(one, false); });
  }

  bool empty() const noexcept { return count_ == 0; }
  /// The latest tick that is kept; there has to be one.
  double newest() const noexcept { return entries_[place(count_ - 1)].tick; }
  /// The earliest tick that is kept; there has to be one.
  double oldest() const noexcept {
    return entries_[place(count_ > entries_.size() ? count_ - entries_.size() : 0)].tick;
  }

  /// Calls `f` with each member that is kept from tick to tick, always in the same order.
  template <class F>
  void for_each_member(F&& f) {
    for (Entry& entry : entries_) {
      f.finite(entry.tick);
      f.finite(entry.pose.position);
      f.finite(entry.pose.quaternion);
    }
    f(count_);
  }

 private:
  struct Entry {
    double tick = 0.0;
    Pose<S> pose;
  };

  std::size_t place(std::size_t index) const noexcept { return index % entries_.size(); }

  /// Poses whose times may differ from lane to lane.
  template <class F>
  Pose<S> of_lanes(const S& tick, F&& pose_at) const noexcept {
    const double first = of_lane(tick, 0);
    if (all(tick == S(first))) return pose_at(first);
    Pose<S> pose;
    for (int lane = 0; lane < kLanes<S>; ++lane) {
      const Pose<S> found = pose_at(of_lane(tick, lane));
      S one(0.0);
      set_lane(one, lane, 1.0);
      const Mask<S> here = one > S(0.5);
      pose = select_pose(here, found, pose);
    }
    return pose;
  }

  Pose<S> between(double tick, bool curved) const noexcept {
    const std::size_t kept = std::min(count_, entries_.size()), oldest = count_ - kept;
    std::size_t low = oldest, high = count_;
    if (kept == 0 || !(tick >= entries_[place(low)].tick && tick <= entries_[place(high - 1)].tick))
      return {Vector3<S>::Constant(S(kUnknown)), Vector4<S>::Constant(S(kUnknown))};
    while (high - low > 1) {  // as many rounds as the capacity has bits
      const std::size_t middle = low + (high - low) / 2;
      (entries_[place(middle)].tick <= tick ? low : high) = middle;
    }
    if (entries_[place(low)].tick == tick) return entries_[place(low)].pose;
    if (curved && kept >= 4) {
      const std::size_t first = std::clamp(low, oldest + 1, count_ - 3) - 1;
      if (evenly_spaced(first)) return through<4>(first, tick);
    }
    return through<2>(low, tick);
  }

  /// Whether four ticks are spaced so that the cubic through them can be trusted: one that is close to its neighbour
  /// makes a slope of the noise.
  bool evenly_spaced(std::size_t first) const noexcept {
    double shortest = std::numeric_limits<double>::infinity(), longest = 0.0;
    for (std::size_t i = first; i < first + 3; ++i) {
      const double distance = entries_[place(i + 1)].tick - entries_[place(i)].tick;
      shortest = std::min(shortest, distance);
      longest = std::max(longest, distance);
    }
    return longest <= kUnevenTicks * shortest;
  }

  /// On the polynomial through some ticks (Lagrange).
  template <std::size_t kTicks>
  Pose<S> through(std::size_t first, double tick) const noexcept {
    Pose<S> pose{Vector3<S>::Zero(), Vector4<S>::Zero()};
    for (std::size_t i = first; i < first + kTicks; ++i) {
      double weight = 1.0;
      for (std::size_t j = first; j < first + kTicks; ++j)
        if (j != i) weight *= (tick - entries_[place(j)].tick) / (entries_[place(i)].tick - entries_[place(j)].tick);
      const Pose<S>& here = entries_[place(i)].pose;
      const S cosine = here.quaternion.dot(entries_[place(first)].pose.quaternion);  // q and -q are one attitude
      pose.position += S(weight) * here.position;
      pose.quaternion += select(cosine < S(0.0), S(-weight), S(weight)) * here.quaternion;
    }
    return pose;
  }

  std::pmr::vector<Entry> entries_;
  std::size_t count_ = 0;
};

/// What a controller makes of its sensors at a tick.
template <class S, int N = kPoints>
struct Perceived {
  Image<S, N> image;  ///< that the law uses: features [px] and measured depths [m]; no meaning unless `ready`
  Pose<S> pose;       ///< in B
  Matrix3<S> R_BE;    ///< attitude of `pose`
  Vector6<S> twist;   ///< in B [m/s; rad/s]
  S newest;           ///< exposure of the newest frame [ticks]; -infinity before the first
  Mask<S> unsensed;   ///< the newest leg lengths belong to no pose near the one before, which then still stands
  Mask<S> joints;     ///< pose and twist are numbers to act on
  Mask<S> read;       ///< of the leg lengths of this tick; not where the pose is measured as such
  Mask<S> complete;   ///< every point has been seen at least once
  Mask<S> fresh;      ///< no point's image is older than the timeout
  Mask<S> whole;      ///< the newest frame shows every point
  Mask<S> lost;       ///< it does not, and no image may stand for it
  Mask<S> usable;     ///< clock and frame of this tick and the image to be used are numbers to act on
  /// At `pose`, where the forward kinematics of the newest reading has them: nothing that this pose does not give.
  std::optional<SolvedLegs<S>> legs;
  Mask<S> ready() const noexcept { return complete & fresh & (!lost) & usable & joints; }
};

/// What is known of image and joints, tick by tick.
template <class S, int N = kPoints>
class Perception {
 public:
  /// @param memory of the poses that are kept, taken here alone
  explicit Perception(const Sensing<S, N>& sensing,
                      std::pmr::memory_resource* memory = std::pmr::get_default_resource())
      : reach_(leg_reach(sensing.hexapod)),
        history_(lifts_points(sensing.frames) ? 2 + oldest_stamp(sensing.frames) + sensing.frames.period : 0, memory) {
    now_.image.features.setZero();  // of no consequence but finite
    now_.image.depth.setConstant(S(-1.0));
    now_.pose = home_pose(sensing.hexapod);
    now_.twist.setZero();
    now_.newest = S(-kInfinity);
    // Not used before the first tick; but a state may be copied before it, and a mask without a value may not.
    now_.R_BE.setIdentity();
    now_.unsensed = now_.joints = now_.read = now_.complete = now_.fresh = now_.whole = now_.lost = now_.usable =
        Mask<S>(false);
    held_ = now_.image;
    seen_at_.setConstant(S(-kInfinity));
    lost_.setZero();
    points_T_.setZero();
    candidate_at_.setConstant(S(-kInfinity));
    candidates_T_.setZero();
    lengths_.setZero();
  }

  /// Takes over what the sensors gave.
  void update(const Sensing<S, N>& sensing, const SensorInput<S, N>& input) noexcept {
    follow_clock(sensing, input.now);
    sense_joints(sensing, input);
    if (lifts_points(sensing.frames) && any(now_.usable & now_.joints))
      history_.add(input.now, now_.pose, now_.usable & now_.joints);
    receive(sensing, input);
    show(sensing);

    S oldest(kInfinity), lost(0.0);
    for (int i = 0; i < N; ++i) {
      oldest = min(oldest, sensing.weights.where_counted(i, seen_at_(i), oldest));
      lost += sensing.weights.where_counted(i, lost_(i), S(0.0));
    }
    now_.complete = oldest > S(-kInfinity);
    now_.fresh = S(input.now) - oldest <= sensing.frames.timeout + S(kTickTolerance);
    now_.whole = lost < S(0.5);
    now_.lost = Mask<S>(sensing.frames.on_lost == LostFeature::stop) & !now_.whole;
  }

  const Perceived<S, N>& now() const noexcept { return now_; }

  /// Calls `f` with each member that is kept from tick to tick, always in the same order: `f.finite` with those that
  /// are always finite, `f.time` with times, which are -infinity where there was none yet. The rest of `now` is
  /// computed at each tick.
  template <class F>
  void for_each_member(F&& f) {
    f.finite(now_.pose.position);
    f.finite(now_.pose.quaternion);
    f(now_.twist);  // of rates that may be NaN
    f.time(now_.newest);
    f(now_.unsensed);
    f.time(clock_);
    f(standing_);
    f(hurried_);
    f(clock_failed_);
    f.finite(joint_time_);
    history_.for_each_member(f);
    f.finite(held_.features);
    f.finite(held_.depth);
    f.finite(points_T_);
    f.time(seen_at_);
    f.finite(lost_);
    f.finite(candidates_T_);
    f.time(candidate_at_);
    f.finite(lengths_);
    f.time(read_at_);
    now_.legs.reset();  // of the pose before
  }

 private:
  static constexpr double kInfinity = std::numeric_limits<double>::infinity();

  /// The joints are read at every tick, whether or not the clock is usable: where it fails, and where it comes back, a
  /// period has passed since the tick before. One that stands still, or is not in seconds, fails where a rate, an age
  /// or a prediction depends on it.
  void follow_clock(const Sensing<S, N>& sensing, double now) noexcept {
    const bool first = clock_ == -kInfinity;
    const bool advances = std::isfinite(now) && now > clock_, stands = now == clock_ && !first;
    const bool crawls = !first && advances && now - clock_ < kCrawlingPeriods;
    const double missed = clock_failed_ ? 1.0 : static_cast<double>(standing_) + 1.0;  // ticks that it did not count
    standing_ = stands || crawls ? std::min(standing_ + 1, kStandingTicks + 1) : 0;
    const bool hurries = !first && advances && now - clock_ > kHurriedPeriods;
    hurried_ = hurries ? std::min(hurried_ + 1, kStandingTicks + 1) : 0;
    const bool counts = sensing.pose_source == PoseSource::encoders || lifts_points(sensing.frames) ||
                        any(sensing.frames.timeout < S(kInfinity));
    const bool usable = (advances || stands) && (!counts || std::max(standing_, hurried_) <= kStandingTicks);
    joint_time_ += !usable || clock_failed_ ? missed : first ? 0.0 : std::min(now - clock_, kLongestTick);
    clock_failed_ = !usable;
    if (advances) clock_ = now;
    now_.usable = Mask<S>(usable);
  }

  void sense_joints(const Sensing<S, N>& sensing, const SensorInput<S, N>& input) noexcept {
    now_.read = Mask<S>(false);
    const Mask<S> known = sensing.pose_source == PoseSource::truth ? taken(input) : read(sensing, input);
    now_.R_BE = rotation_matrix(now_.pose.quaternion);
    now_.joints = known & (largest_abs(now_.twist) <= S(kMaxTwist));
  }

  /// A pose that is measured as such. One that the platform cannot have come to since the one before is none: in
  /// millimetres, with its quaternion in another order, or wrong by itself.
  /// @return whether it is one
  Mask<S> taken(const SensorInput<S, N>& input) noexcept {
    const Mask<S> first = read_at_ == S(-kInfinity);
    const S reach = select(first, S(S(kFarthestStart) * reach_), reach_);
    const S turn = select(first, S(kFarthestFirstTurn), S(kFarthestTurn));
    const S squared_length = input.pose.quaternion.squaredNorm();
    const S both = input.pose.quaternion.dot(now_.pose.quaternion);
    const Mask<S> near = (Vector3<S>(input.pose.position - now_.pose.position).squaredNorm() <= reach * reach) &
                         (both * both >= turn * squared_length * now_.pose.quaternion.squaredNorm());
    const Mask<S> known = near & is_finite(squared_length) & (squared_length > S(0.0));
    if (all(known)) {
      now_.pose = input.pose;
    } else {
      now_.pose = select_pose(known, input.pose, now_.pose);
    }
    now_.twist = input.twist;
    read_at_ = select(known, S(joint_time_), read_at_);
    return known;
  }

  /// Longest distance between the joints of a leg at home [m].
  static S leg_reach(const Hexapod<S>& hexapod) {
    using std::sqrt;
    const Matrix3<S> R_BE = rotation_matrix(hexapod.home_quaternion);
    S longest(0.0);
    for (int i = 0; i < 6; ++i) {
      const Vector3<S> leg =
          hexapod.home_position + R_BE * hexapod.platform_joints_E.col(i) - hexapod.base_joints_B.col(i);
      longest = max(longest, leg.squaredNorm());
    }
    return sqrt(longest);
  }

  /// Pose and twist of six lengths, where there are some.
  /// @return whether the pose is one to act on: where a reading never comes it is of long ago
  Mask<S> read(const Sensing<S, N>& sensing, const SensorInput<S, N>& input) noexcept {
    read_lengths(sensing, input);
    const S squared_length = now_.pose.quaternion.squaredNorm();
    return is_finite(now_.pose.position) & is_finite(squared_length) & (squared_length > S(0.0)) & (!now_.unsensed) &
           (S(joint_time_) - read_at_ <= S(2.0 * static_cast<double>(sensing.encoders.period) + kLateReading));
  }
  void read_lengths(const Sensing<S, N>& sensing, const SensorInput<S, N>& input) noexcept {
    const Vector6<S>& lengths = input.joints.lengths;
    Mask<S> reads = lengths(0) == lengths(0);
    for (int i = 1; i < 6; ++i) reads = reads | (lengths(i) == lengths(i));
    if (!any(reads)) return;
    const Mask<S> first = read_at_ == S(-kInfinity);
    const S elapsed = select(first, S(0.0), S((S(joint_time_) - read_at_) * S(sensing.period)));
    // A platform may start anywhere; after that it moves.
    const S rounds = select(first, S(static_cast<double>(kKinematicsRounds)), encoder_rounds(elapsed));
    if (!now_.legs) now_.legs.emplace(sensing.legs, now_.pose);
    ForwardKinematics<S> found;
    track_pose(sensing.legs, lengths, now_.pose, now_.twist, *now_.legs, elapsed, rounds, found);
    const Mask<S> known = reads & found.converged;
    now_.unsensed = (now_.unsensed & (!reads)) | (reads & (!found.converged));
    now_.pose = select_pose(known, found.pose, now_.pose);
    now_.read = known;

    Vector6<S> rates = input.joints.rates;
    Mask<S> rated = known;
    if (sensing.encoders.rate == RateSource::differences) {
      rates = select(first, Vector6<S>(Vector6<S>::Zero()), Vector6<S>((lengths - lengths_) * (S(1.0) / elapsed)));
      rated = known & (first | (elapsed > S(0.0)));  // the same time again gives no rate
    }
    now_.legs.emplace(sensing.legs, found.legs);
    now_.twist = select(rated, now_.legs->solver.twist(rates), now_.twist);
    if (!all(known)) [[unlikely]]
      now_.legs.emplace(sensing.legs, now_.pose);
    lengths_ = select(rated, lengths, lengths_);
    read_at_ = select(known, S(joint_time_), read_at_);
  }

  /// Takes over a frame that is newer than the one before, or the same again.
  void receive(const Sensing<S, N>& sensing, const SensorInput<S, N>& input) noexcept {
    if constexpr (N == kPoints) {
      if (!sensing.lens.converts()) return receive(sensing, input, input.frame);
    }
    Frame<S, N> prepared = input.frame;
    if constexpr (N != kPoints) {
      fill_places<2>(prepared.image.features, sensing.points);
      fill_places<1>(prepared.image.depth, sensing.points);
    }
    if (sensing.lens.converts())  // a pixel that no ray has is not shown
      prepared.image.features = sensing.lens.features(Vector<S, 2 * N>(prepared.image.features));
    receive(sensing, input, prepared);
  }
  /// @param frame of the input, with features of the pinhole
  void receive(const Sensing<S, N>& sensing, const SensorInput<S, N>& input, const Frame<S, N>& frame) noexcept {
    using std::abs;
    const Mask<S> arrived = now_.usable & (frame.exposure >= now_.newest);  // not where there is none
    if (!any(arrived)) return;
    Mask<S> good = frame.exposure <= S(input.now + kTickTolerance);  // one from the future means a wrong clock
    std::array<Mask<S>, static_cast<std::size_t>(N)> shown;
    for (int i = 0; i < N; ++i) {
      const S &x = frame.image.features(2 * i), &y = frame.image.features(2 * i + 1), &depth = frame.image.depth(i);
      Mask<S>& here = shown[static_cast<std::size_t>(i)];
      here = (x == x) & (y == y);
      good = good & ((!here) | usable(sensing, i, x, y, depth));
    }
    Eigen::Matrix<S, 3, N> points_T;
    Mask<S> covered = arrived;  // by the poses that are kept: an older frame is of no use, as one older than the newest
    if (lifts_points(sensing.frames)) {
      const Pose<S> pose = history_.at(min(frame.exposure, S(input.now)));
      covered = covered & is_finite(S(pose.position.sum()));
      const Matrix3<S> R_BE = rotation_matrix(pose.quaternion);
      for (int i = 0; i < N; ++i) {
        points_T.col(i) = lift<S>(sensing.camera, pose.position, R_BE, frame.image.features.template segment<2>(2 * i),
                                  frame.image.depth(i));
        good = good & ((!shown[static_cast<std::size_t>(i)]) | is_finite(Vector3<S>(points_T.col(i))));
      }
      if (any(sensing.frames.gate < S(kInfinity)))
        leave_out_strangers(sensing, frame, covered & good, pose, R_BE, points_T, shown);
    }
    now_.usable = now_.usable & (good | (!covered));
    const Mask<S> taken = covered & good;
    now_.newest = select(taken, frame.exposure, now_.newest);
    for (int i = 0; i < N; ++i) {
      const Mask<S> seen = taken & shown[static_cast<std::size_t>(i)];
      // An image of a point that was never seen, and is still to be confirmed, is not the loss of one.
      const Mask<S> waits = (candidate_at_(i) == frame.exposure) & (seen_at_(i) == S(-kInfinity));
      lost_(i) = select(taken, select(seen | waits, S(0.0), S(1.0)), lost_(i));
      seen_at_(i) = select(seen, frame.exposure, seen_at_(i));
      for (int k = 2 * i; k < 2 * i + 2; ++k)
        held_.features(k) = select(seen, frame.image.features(k), held_.features(k));
      held_.depth(i) = select(seen, frame.image.depth(i), held_.depth(i));
      if (lifts_points(sensing.frames))
        for (int k = 0; k < 3; ++k) points_T_(k, i) = select(seen, points_T(k, i), points_T_(k, i));
    }
  }

  /// Takes a point for not seen that is beyond the gate from where its last image expects it, as the joints have
  /// carried that since. Where there is none, or it is older than the timeout, the first image that confirms the one
  /// before is taken: an image by itself may be that of something else.
  /// @param pose, R_BE, points_T of the frame; @param shown which points it shows
  void leave_out_strangers(const Sensing<S, N>& sensing, const Frame<S, N>& frame, const Mask<S>& taken,
                           const Pose<S>& pose, const Matrix3<S>& R_BE, const Eigen::Matrix<S, 3, N>& points_T,
                           std::array<Mask<S>, static_cast<std::size_t>(N)>& shown) noexcept {
    const Image<S, N> expected = take_image<S, N>(sensing.camera, pose.position, R_BE, points_T_);
    const Image<S, N> proposed = take_image<S, N>(sensing.camera, pose.position, R_BE, candidates_T_);
    for (int i = 0; i < N; ++i) {
      const auto is_near = [&](const Image<S, N>& image) {
        const S x = frame.image.features(2 * i) - image.features(2 * i);
        const S y = frame.image.features(2 * i + 1) - image.features(2 * i + 1);
        return Mask<S>(x * x + y * y <= sensing.frames.gate * sensing.frames.gate);
      };
      const auto is_recent = [&](const S& exposure) {
        return Mask<S>((exposure > S(-kInfinity)) &
                       (frame.exposure - exposure <= sensing.frames.timeout + S(kTickTolerance)));
      };
      const Mask<S> expects = is_recent(seen_at_(i));
      const Mask<S> confirms = is_recent(candidate_at_(i)) & (frame.exposure > candidate_at_(i)) & is_near(proposed);
      const Mask<S> known =
          (expects & is_near(expected)) | ((!expects) & confirms) | (!(sensing.frames.gate < S(kInfinity)));
      Mask<S>& here = shown[static_cast<std::size_t>(i)];
      const Mask<S> is_candidate = taken & here & (!known);
      candidate_at_(i) = select(is_candidate, frame.exposure, candidate_at_(i));
      for (int k = 0; k < 3; ++k) candidates_T_(k, i) = select(is_candidate, points_T(k, i), candidates_T_(k, i));
      here = here & known;
    }
  }

  /// What a law can be evaluated with: within the limits where a run counts as diverged.
  static Mask<S> usable(const Sensing<S, N>& sensing, int i, const S& x, const S& y, const S& depth) noexcept {
    using std::abs;
    return (abs(S(sensing.desired_features(2 * i) - x)) <= S(kMaxFeatureError)) &
           (abs(S(sensing.desired_features(2 * i + 1) - y)) <= S(kMaxFeatureError)) & (depth < S(0.0)) &
           is_finite(depth) & is_finite(S(S(1.0) / depth));
  }

  /// The image of this tick: what is held, or projected again.
  void show(const Sensing<S, N>& sensing) noexcept {
    if (!lifts_points(sensing.frames)) {
      now_.image = held_;
      return;
    }
    const bool predicting = sensing.frames.prediction == Prediction::encoder;
    const Image<S, N> projected = take_image<S, N>(sensing.camera, now_.pose.position, now_.R_BE, points_T_);
    for (int i = 0; i < N; ++i) {
      const Mask<S> lost = lost_(i) > S(0.5), never = seen_at_(i) == S(-kInfinity);
      const Mask<S> again =
          (!never) & (predicting ? (!lost) | Mask<S>(sensing.frames.on_lost != LostFeature::hold) : lost);
      for (int k = 2 * i; k < 2 * i + 2; ++k)
        now_.image.features(k) = select(again, projected.features(k), held_.features(k));
      now_.image.depth(i) = select(again, projected.depth(i), held_.depth(i));
      now_.usable = now_.usable & (never | usable(sensing, i, now_.image.features(2 * i),
                                                  now_.image.features(2 * i + 1), now_.image.depth(i)));
    }
  }

  Perceived<S, N> now_;
  S reach_;                    ///< longest distance between the joints of a leg at home [m]
  double clock_ = -kInfinity;  ///< newest time [ticks]
  std::size_t standing_ = 0;   ///< ticks for which it has stood still
  std::size_t hurried_ = 0;    ///< ticks for which it has gone on by more than `kHurriedPeriods`
  bool clock_failed_ = false;  ///< at the tick before
  double joint_time_ = 0.0;    ///< since the first tick, without what a clock fails [ticks]
  PoseHistory<S> history_;
  Image<S, N> held_;                     ///< last image of each point
  Eigen::Matrix<S, 3, N> points_T_;      ///< the same, lifted [m]
  Vector<S, N> seen_at_;                 ///< its exposure [ticks]; -infinity where a point was never seen
  Vector<S, N> lost_;                    ///< 1 where the newest frame does not show a point
  Eigen::Matrix<S, 3, N> candidates_T_;  ///< newest images that the gate left out, lifted [m]
  Vector<S, N> candidate_at_;            ///< their exposures [ticks]; -infinity where there is none
  Vector6<S> lengths_;                   ///< newest reading of the encoders [m]
  S read_at_ = S(-kInfinity);            ///< its time, or that of the newest pose that was measured, of `joint_time_`
};

}  // namespace hexservo
