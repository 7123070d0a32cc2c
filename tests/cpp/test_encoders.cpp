// Leg length encoders: truth without errors, bounds with them, and when they are read.
#include "hexservo/encoders.hpp"
#include "hexservo/outcome.hpp"
#include "hexservo/perception.hpp"

#include "allocations.hpp"
#include "compare.hpp"
#include "decompositions.hpp"
#include "random.hpp"

#include <Eigen/LU>

#include <bit>
#include <functional>
#include <limits>
#include <optional>

using namespace hexservo;
using namespace hexservo::test;

namespace {

constexpr double kTick = 1e-3;  // [s]

struct Motion {
  Pose<double> pose;
  Vector6<double> twist;
};

/// A smooth motion within the stroke of `micro`, at up to 0.1 m/s and 0.6 rad/s, with its exact twist.
Motion motion_at(const Hexapod<double>& hexapod, double t) {
  const Vector3<double> size(0.006, 0.004, 0.003), rate(9.0, 14.0, 19.0),
      axis = Vector3<double>(1.0, -2.0, 3.0).normalized();
  Motion motion;
  for (int i = 0; i < 3; ++i) {
    motion.pose.position(i) = hexapod.home_position(i) + size(i) * std::sin(rate(i) * t);
    motion.twist(i) = size(i) * rate(i) * std::cos(rate(i) * t);
  }
  const double angle = 0.05 * std::sin(12.0 * t);
  motion.pose.quaternion << std::cos(angle / 2.0), std::sin(angle / 2.0) * axis;
  motion.twist.tail<3>() = 0.6 * std::cos(12.0 * t) * axis;
  return motion;
}

/// Encoders, and what a controller makes of their readings.
template <class S>
class JointSensors {
 public:
  JointSensors(const EncoderParameters<S>& parameters, const Hexapod<S>& hexapod, const SeedHalves<S>& seed,
               double tick = kTick)
      : sensing_{hexapod, LegGeometry<S>(hexapod), S(1.0),     Lens<S>(), Vector<S, 8>::Zero(),
                 {},      PoseSource::encoders,    parameters, tick},
        encoders_(parameters, seed),
        perception_(sensing_) {}

  /// @param spoilt lanes whose second encoder gives no number
  /// @param clock the time that the tick is given [ticks]
  void observe(long long tick, const Pose<S>& pose, const Vector6<S>& twist, const Mask<S>& spoilt = Mask<S>(false),
               std::optional<double> clock = {}) {
    SensorInput<S> input;
    input.now = clock.value_or(static_cast<double>(tick));
    input.joints =
        encoders_.read(tick, inverse_kinematics(sensing_.legs, pose.position, rotation_matrix(pose.quaternion)), twist);
    input.joints.lengths(1) = select(spoilt, S(kNaN), input.joints.lengths(1));
    if (tick % sensing_.encoders.period == 0) lengths_ = input.joints.lengths;
    perception_.update(sensing_, input);
  }
  const Vector6<S>& lengths() const { return lengths_; }
  const Pose<S>& pose() const { return perception_.now().pose; }
  const Vector6<S>& twist() const { return perception_.now().twist; }
  const Mask<S>& failed() const { return perception_.now().unsensed; }
  const Mask<S>& usable() const { return perception_.now().joints; }
  const Mask<S>& timed() const { return perception_.now().usable; }

 private:
  Sensing<S> sensing_;
  Encoders<S> encoders_;
  Perception<S> perception_;
  Vector6<S> lengths_ = Vector6<S>::Zero();
};

JointSensors<double> encoders(const EncoderParameters<double>& parameters, const Hexapod<double>& hexapod,
                              std::uint64_t seed = 1) {
  return {parameters, hexapod, seed_halves(seed)};
}

Legs<double> legs_at(const Hexapod<double>& hexapod, const Pose<double>& pose) {
  return inverse_kinematics(hexapod, pose.position, rotation_matrix(pose.quaternion));
}

double pose_distance(const Pose<double>& a, const Pose<double>& b) { return pose_difference(a, b).norm(); }

/// Largest length of (H^T)^-1 x for |x_i| <= 1, with moments as they are: metres and radians.
double worst_gain(const Hexapod<double>& hexapod, const Pose<double>& pose) {
  return std::sqrt(6.0) / singular_values(legs_at(hexapod, pose).wrench_map())(5);
}

/// A pose turned by a rotation vector in B and moved, by Eigen.
Pose<double> displaced(const Pose<double>& pose, const Vector3<double>& move, const Vector3<double>& turn) {
  const Vector4<double>& p = pose.quaternion;
  const Eigen::Quaterniond q =
      Eigen::AngleAxisd(turn.norm(), turn.stableNormalized()) * Eigen::Quaterniond(p(0), p(1), p(2), p(3)).normalized();
  return {pose.position + move, {q.w(), q.x(), q.y(), q.z()}};
}

Vector3<double> direction(Random& random) { return random.matrix<3>().normalized(); }

/// Whether a straight way keeps to its assembly mode: the determinant of H keeps its sign, and the distance to
/// singularity stays above 0.2, a fifth or a quarter of what it is at home.
bool clear_of_singular_poses(const Hexapod<double>& hexapod, const Pose<double>& from, const Vector3<double>& move,
                             const Vector3<double>& turn) {
  const double start = legs_at(hexapod, from).wrench_map().determinant();
  for (int i = 0; i <= 20; ++i) {
    const Pose<double> pose = displaced(from, i / 20.0 * move, i / 20.0 * turn);
    if (!(start * legs_at(hexapod, pose).wrench_map().determinant() > 0.0) ||
        !(wrench_map_singular_values(hexapod, pose)(5) > 0.2))
      return false;
  }
  return true;
}

}  // namespace

TEST_CASE("ideal encoders give the true pose and, with true rates, the true twist") {
  const Hexapod<double> hexapod = make_hexapod(robot_preset("micro"));
  JointSensors<double> sensors = encoders({{.rate = RateSource::true_rates}, 1}, hexapod);
  for (long long tick = 0; tick < 1000; ++tick) {
    const Motion truth = motion_at(hexapod, static_cast<double>(tick) * kTick);
    sensors.observe(tick, truth.pose, truth.twist);
    REQUIRE_FALSE(sensors.failed());
    REQUIRE(pose_distance(sensors.pose(), truth.pose) <= 1e-12);
    REQUIRE(distance(sensors.twist(), truth.twist) <= 1e-12);
  }
}

TEST_CASE("a reading that is far from the one before still gives its pose, and is reported where there is none") {
  const Hexapod<double> hexapod = make_hexapod(robot_preset("micro"));
  const Pose<double> home = home_pose(hexapod);
  for (const double far : {0.01, 0.02, 0.03}) {
    CAPTURE(far);
    JointSensors<double> sensors = encoders({}, hexapod);
    sensors.observe(0, home, Vector6<double>::Zero());
    const Pose<double> pose{home.position + far * Vector3<double>(0.6, -0.64, 0.48), {0.995, 0.05, -0.04, 0.06}};
    sensors.observe(1, pose, Vector6<double>::Zero());
    CHECK_FALSE(sensors.failed());
    CHECK(pose_distance(sensors.pose(), pose) <= 1e-11);
  }
  JointSensors<double> sensors = encoders({}, hexapod);
  sensors.observe(0, home, Vector6<double>::Zero());
  sensors.observe(1, home, Vector6<double>::Zero(), true);
  CHECK(sensors.failed());
  CHECK(pose_distance(sensors.pose(), home) <= 1e-12);
  sensors.observe(2, home, Vector6<double>::Zero());
  CHECK_FALSE(sensors.failed());
}

TEST_CASE("any motion between two readings is followed that keeps clear of singular poses, whatever the period") {
  // At 100 r_p/s and 100 rad/s, but at most by r_p and by 1 rad, since a longer way passes singular poses.
  Random random(9301);
  CAPTURE(random.seed());
  for (const std::string_view preset : kRobotPresets)
    for (const long long period : {1, 2, 3, 5, 7, 9, 20, 50}) {
      const Hexapod<double> hexapod = make_hexapod(robot_preset(preset));
      const double reach = std::min(100.0 * static_cast<double>(period) * kTick, 1.0);
      CAPTURE(preset);
      CAPTURE(period);
      int clear = 0;
      double worst = 0.0;
      for (int trial = 0; trial < 250; ++trial) {
        CAPTURE(trial);
        const Pose<double> before =
            displaced(home_pose(hexapod), random.matrix<3>(0.15 * hexapod.platform_radius), random.matrix<3>(0.15));
        const Vector3<double> move = random.uniform(0.0, reach) * hexapod.platform_radius * direction(random),
                              turn = random.uniform(0.0, reach) * direction(random);
        if (!clear_of_singular_poses(hexapod, before, move, turn)) continue;
        ++clear;
        const Pose<double> now = displaced(before, move, turn);
        JointSensors<double> sensors({{}, period}, hexapod, seed_halves(1));
        sensors.observe(0, before, Vector6<double>::Zero());
        sensors.observe(period, now, Vector6<double>::Zero());
        REQUIRE_FALSE(sensors.failed());
        REQUIRE(distance(legs_at(hexapod, sensors.pose()).lengths, sensors.lengths()) <= kKinematicsTolerance);
        worst = std::max(worst, pose_distance(sensors.pose(), now));
        REQUIRE(pose_distance(sensors.pose(), now) <= kKinematicsTolerance * worst_gain(hexapod, now));
      }
      CHECK(clear >= 100);
      CHECK(worst > 0.0);
    }
}

TEST_CASE(
    "a twist of up to 1e3 rad/s is followed at readings of 1 ms whose mean rate is within 50 rad/s and 5 m/s of it") {
  Random random(9302);
  CAPTURE(random.seed());
  const Hexapod<double> hexapod = make_hexapod(robot_preset("micro"));
  int clear = 0;
  for (int trial = 0; trial < 500; ++trial) {
    CAPTURE(trial);
    const Pose<double> before = displaced(home_pose(hexapod), random.matrix<3>(0.01), random.matrix<3>(0.1));
    Vector6<double> twist;
    twist << random.uniform(0.0, 1e2) * direction(random), random.uniform(0.0, kMaxTwist) * direction(random);
    const Vector3<double> move = (twist.head<3>() + 5.0 * direction(random)) * kTick,
                          turn = (twist.tail<3>() + 50.0 * direction(random)) * kTick;
    if (!clear_of_singular_poses(hexapod, before, move, turn)) continue;
    ++clear;
    const Pose<double> now = displaced(before, move, turn);
    JointSensors<double> sensors({{.rate = RateSource::true_rates}, 1}, hexapod, seed_halves(1));
    sensors.observe(0, before, twist);
    sensors.observe(1, now, twist);
    REQUIRE_FALSE(sensors.failed());
    REQUIRE(pose_distance(sensors.pose(), now) <= kKinematicsTolerance * worst_gain(hexapod, now));
  }
  CHECK(clear >= 200);
}

TEST_CASE("more rounds for longer periods, from the periods alone, and never more than four in a millisecond") {
  CHECK(std::ceil(encoder_rounds(1e-4)) == 4);
  CHECK(std::ceil(encoder_rounds(1e-3)) == 4);
  CHECK(std::ceil(encoder_rounds(2e-3)) == 5);
  CHECK(std::ceil(encoder_rounds(2.5e-3)) == 6);
  CHECK(std::ceil(encoder_rounds(9e-3)) == kEncoderRounds);
  CHECK(std::ceil(encoder_rounds(1e6)) == kEncoderRounds);
  for (int k = 1; k < 100; ++k) CHECK(std::ceil(encoder_rounds(k * 1e-3)) <= 4 * k);
}

TEST_CASE(
    "differences are the mean rate between two readings, zero at the first, and tend to the rate at first order") {
  const Hexapod<double> hexapod = make_hexapod(robot_preset("micro"));
  JointSensors<double> sensors = encoders({}, hexapod);
  const Motion start = motion_at(hexapod, 0.0);
  sensors.observe(0, start.pose, start.twist);
  CHECK(sensors.twist().norm() == 0.0);
  const Motion next = motion_at(hexapod, kTick);
  sensors.observe(1, next.pose, next.twist);
  const Vector6<double> rates = (legs_at(hexapod, next.pose).lengths - legs_at(hexapod, start.pose).lengths) / kTick;
  // rounding of the lengths over the tick, through H
  CHECK(distance(legs_at(hexapod, next.pose).rates(sensors.twist()), rates) <= 100.0 * kEpsilon / kTick);

  const auto error_of = [&](double tick) {
    JointSensors<double> s({}, hexapod, seed_halves(1), tick);
    double worst = 0.0;
    for (long long k = 0; k < 100; ++k) {
      const Motion truth = motion_at(hexapod, 0.2 + static_cast<double>(k) * tick);
      s.observe(k, truth.pose, truth.twist);
      if (k > 0) worst = std::max(worst, distance(s.twist(), truth.twist));
    }
    return worst;
  };
  // about half a tick late; the motion of a quarter of the ticks covers a quarter of the time, hence the tolerance
  const double ratio = error_of(4e-4) / error_of(1e-4);
  CHECK(ratio > 3.0);
  CHECK(ratio < 5.0);
}

TEST_CASE("resolution: readings are multiples, at most half a step off, and so are pose and rates within bounds") {
  const Hexapod<double> hexapod = make_hexapod(robot_preset("micro"));
  constexpr double kResolution = 1e-5;
  JointSensors<double> sensors = encoders({{.resolution = kResolution}, 1}, hexapod), ideal = encoders({}, hexapod);
  double worst = 0.0;
  for (long long tick = 0; tick < 1000; ++tick) {
    const Motion truth = motion_at(hexapod, static_cast<double>(tick) * kTick);
    sensors.observe(tick, truth.pose, truth.twist);
    ideal.observe(tick, truth.pose, truth.twist);
    REQUIRE_FALSE(sensors.failed());
    const Vector6<double> steps = sensors.lengths() / kResolution;
    for (int i = 0; i < 6; ++i) REQUIRE(std::abs(steps(i) - std::nearbyint(steps(i))) <= 1e-9);
    const double off = distance(sensors.lengths(), legs_at(hexapod, truth.pose).lengths);
    worst = std::max(worst, off);
    REQUIRE(off <= 0.5 * kResolution * (1.0 + 1e-9));
    // to first order in the resolution; a tenth for what H changes on the way
    const double gain = 1.1 * worst_gain(hexapod, truth.pose);
    REQUIRE(pose_distance(sensors.pose(), truth.pose) <= 0.5 * kResolution * gain);
    // two readings, each half a step off
    const Vector6<double> rate_error =
        legs_at(hexapod, sensors.pose()).rates(sensors.twist()) - legs_at(hexapod, ideal.pose()).rates(ideal.twist());
    REQUIRE(rate_error.cwiseAbs().maxCoeff() <= kResolution / kTick * (1.0 + 1e-9));
  }
  CHECK(worst > 0.4 * kResolution);

  // Of noise beside it the noise comes first.
  JointSensors<double> both = encoders({{.resolution = kResolution, .noise = kResolution}, 1}, hexapod);
  for (long long tick = 0; tick < 100; ++tick) {
    const Motion truth = motion_at(hexapod, static_cast<double>(tick) * kTick);
    both.observe(tick, truth.pose, truth.twist);
    const Vector6<double> steps = both.lengths() / kResolution;
    for (int i = 0; i < 6; ++i) CHECK(std::abs(steps(i) - std::nearbyint(steps(i))) <= 1e-9);
  }
}

TEST_CASE("noise has its standard deviation, in every leg, and is a function of the seed and the reading") {
  const Hexapod<double> hexapod = make_hexapod(robot_preset("micro"));
  constexpr double kNoise = 2e-5;
  constexpr int kReadings = 4000;
  const Pose<double> home = home_pose(hexapod);
  JointSensors<double> sensors = encoders({{.noise = kNoise}, 1}, hexapod),
                       other = encoders({{.noise = kNoise}, 1}, hexapod, 2);
  Vector6<double> sum = Vector6<double>::Zero(), square = sum;
  for (long long tick = 0; tick < kReadings; ++tick) {
    sensors.observe(tick, home, Vector6<double>::Zero());
    other.observe(tick, home, Vector6<double>::Zero());
    REQUIRE_FALSE(sensors.failed());
    const Vector6<double> noise = (sensors.lengths() - hexapod.home_lengths) / kNoise;
    sum += noise;
    square += noise.cwiseAbs2();
    REQUIRE(distance(sensors.lengths(), other.lengths()) > 0.0);
    // the pose belongs to the readings
    REQUIRE(distance(legs_at(hexapod, sensors.pose()).lengths, sensors.lengths()) <= kKinematicsTolerance);
  }
  // five standard deviations
  CHECK((sum / kReadings).cwiseAbs().maxCoeff() <= 5.0 * std::sqrt(1.0 / kReadings));
  CHECK(distance(square / kReadings, Vector6<double>::Ones()) <= 5.0 * std::sqrt(2.0 / kReadings));
  const Vector6<double> first = encoders({}, hexapod).lengths();
  JointSensors<double> again = encoders({{.noise = kNoise}, 1}, hexapod);
  again.observe(kReadings - 1, home, Vector6<double>::Zero());
  CHECK(distance(again.lengths(), sensors.lengths()) == 0.0);
  CHECK(first.norm() == 0.0);
}

TEST_CASE("between readings everything holds, and differences are taken over the period") {
  const Hexapod<double> hexapod = make_hexapod(robot_preset("micro"));
  constexpr long long kPeriod = 5;
  JointSensors<double> sensors = encoders({{}, kPeriod}, hexapod);
  Motion read;
  Vector6<double> lengths = Vector6<double>::Zero(), twist = lengths;
  for (long long tick = 0; tick < 40; ++tick) {
    const Motion truth = motion_at(hexapod, static_cast<double>(tick) * kTick);
    sensors.observe(tick, truth.pose, truth.twist);
    if (tick % kPeriod == 0) {
      const Vector6<double> now = legs_at(hexapod, truth.pose).lengths;
      const Vector6<double> rates = (now - lengths) / (kPeriod * kTick);
      read = truth;
      if (tick > 0) CHECK(distance(legs_at(hexapod, truth.pose).rates(sensors.twist()), rates) <= 1e-11);
      lengths = now;
      twist = sensors.twist();
    }
    CHECK(pose_distance(sensors.pose(), read.pose) <= 1e-12);
    CHECK(distance(sensors.twist(), twist) == 0.0);
  }
}

TEST_CASE("whatever the clock does, pose and twist are those of the legs, and the law may not act") {
  const Hexapod<double> hexapod = make_hexapod(robot_preset("micro"));
  struct Fault {
    const char* name;
    std::function<double(double)> clock;  // from the tick on at which it fails
  };
  constexpr long long kFails = 40, kEnds = 90;
  for (const Fault& fault : std::initializer_list<Fault>{
           {"back by 1000 ticks", [](double t) { return t - 1000.0; }},
           {"one tick of far ahead, then as before", [](double t) { return t == kFails ? t + 1000.0 : t; }},
           {"NaN", [](double) { return kNaN; }},
           {"infinity", [](double) { return std::numeric_limits<double>::infinity(); }},
           {"stands still, then NaN", [](double t) { return t < kFails + 5 ? kFails - 1.0 : kNaN; }},
           {"stands still", [](double) { return kFails - 1.0; }}}) {
    CAPTURE(fault.name);
    JointSensors<double> healthy = encoders({{}, 1}, hexapod), faulty = healthy;
    long long refused = 0;
    for (long long tick = 0; tick < kEnds + 40; ++tick) {
      const Motion truth = motion_at(hexapod, static_cast<double>(tick) * kTick);
      const double time = static_cast<double>(tick);
      const bool fails = tick >= kFails && tick < kEnds;
      healthy.observe(tick, truth.pose, truth.twist);
      faulty.observe(tick, truth.pose, truth.twist, false, fails ? fault.clock(time) : time);
      REQUIRE(pose_distance(faulty.pose(), truth.pose) <= 1e-12);
      refused += faulty.timed() ? 0 : 1;
      // One that has run ahead is behind for as long; one that stands is found out after some ticks, then counted
      // again.
      const bool counts = faulty.timed() ? !fails : true;
      if (counts && tick != kFails) {
        REQUIRE(faulty.usable());
        const double change = fails && tick <= kFails + static_cast<long long>(kStandingTicks) ? 0.2 : 1e-9;
        CHECK(distance(faulty.twist(), healthy.twist()) <= change);  // of up to 0.6 rad/s
      }
    }
    CHECK(refused >= kEnds - kFails - static_cast<long long>(kStandingTicks) - 1);
  }
  JointSensors<double> healthy = encoders({{}, 1}, hexapod), set_late = healthy;  // after the first tick, and by far
  for (long long tick = 0; tick < 10; ++tick) {
    const Motion truth = motion_at(hexapod, static_cast<double>(tick) * kTick);
    healthy.observe(tick, truth.pose, truth.twist);
    set_late.observe(tick, truth.pose, truth.twist, false, tick == 0 ? -1e17 : static_cast<double>(tick));
    if (tick > 1) CHECK(distance(set_late.twist(), healthy.twist()) <= 1e-6);
  }
}

TEST_CASE("a pack of encoders reads as single ones do, and a lane without a pose harms no other") {
  constexpr int kWidth = 4;
  using S = Lanes<kWidth>;
  const Hexapod<double> hexapod = make_hexapod(robot_preset("micro"));
  Hexapod<S> hexapods;
  EncoderParameters<S> parameters;
  SeedHalves<S> seeds;
  std::vector<JointSensors<double>> singles;
  for (int lane = 0; lane < kWidth; ++lane) {
    const EncoderParameters<double> single{{.resolution = lane == 1 ? 1e-6 : 0.0, .noise = 1e-6 * lane}, 2};
    set_lane(hexapods, lane, hexapod);
    set_lane(parameters, lane, single);
    set_lane(seeds, lane, seed_halves(static_cast<std::uint64_t>(lane)));
    singles.push_back(encoders(single, hexapod, static_cast<std::uint64_t>(lane)));
  }
  JointSensors<S> pack(parameters, hexapods, seeds);
  for (long long tick = 0; tick < 50; ++tick) {
    Pose<S> pose;
    Vector6<S> twist;
    for (int lane = 0; lane < kWidth; ++lane) {
      const Motion truth = motion_at(hexapod, static_cast<double>(tick) * kTick + 0.1 * lane);
      set_lane(pose.position, lane, truth.pose.position);
      set_lane(pose.quaternion, lane, truth.pose.quaternion);
      set_lane(twist, lane, truth.twist);
      singles[static_cast<std::size_t>(lane)].observe(tick, truth.pose, truth.twist, lane == 3 && tick == 20);
    }
    S last(0.0);
    set_lane(last, 3, tick == 20 ? 1.0 : 0.0);
    const long long before = allocations;
    pack.observe(tick, pose, twist, last > S(0.5));
    CHECK(allocations == before);
    for (int lane = 0; lane < kWidth; ++lane) {
      CAPTURE(lane);
      const JointSensors<double>& single = singles[static_cast<std::size_t>(lane)];
      CHECK(pack.failed()[lane] == single.failed());
      CHECK(pack.failed()[lane] == (lane == 3 && (tick == 20 || tick == 21)));
      CHECK(distance(lane_of(pack.pose().position, lane), single.pose().position) <= 1e-15);
      if (lane == 3 && tick >= 20 && tick <= 23) continue;  // the one without numbers holds until the next
      CHECK(distance(lane_of(pack.lengths(), lane), single.lengths()) <= kEpsilon);
      CHECK(distance(lane_of(pack.twist(), lane), single.twist()) <= 1e-12);
    }
  }
}
