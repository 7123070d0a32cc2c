// Metrics, streamed sample by sample, against their definitions over the whole record.
#include "hexservo/metrics.hpp"

#include "compare.hpp"
#include "random.hpp"

#include <algorithm>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

const Vector6<double> kGravity = gravity_wrench(RigidBody<double>{});
const Vector<double, 8> kDesired = (Vector<double, 8>() << 10, 10, 45, -73, -64, 29, -30, -23).finished();

/// A sample of ordinary size; feature errors are at most `error`.
Sample<double> random_sample(Random& random, double error) {
  Sample<double> s;
  s.feature_error = random.matrix<8>(error);
  s.depth = random.matrix<4>(0.1) - Vector<double, 4>::Constant(0.5);
  s.position = random.matrix<3>(0.02) + Vector3<double>(0.0, 0.0, -0.15);
  s.quaternion = random.quaternion();
  s.twist = random.six(0.1, 1.0);
  s.wrench = random.six(0.1, 0.01) + kGravity;
  s.fuzzy_output = random.six(0.01, 0.001);
  s.leg_lengths = make_hexapod({}).home_lengths + random.matrix<6>(0.03);
  s.leg_forces = random.matrix<6>(2.0);
  return s;
}

Metrics<double> metrics_of(const std::vector<Sample<double>>& samples, const MetricsSettings<double>& settings,
                           double step) {
  MetricsAccumulator<double> accumulator(settings, make_hexapod({}), RigidBody<double>{}, kDesired, samples.front());
  for (std::size_t i = 0; i < samples.size(); ++i) accumulator.add(static_cast<double>(i) * step, samples[i], true);
  return accumulator.metrics();
}

/// Samples whose largest error is the given one, in one component.
std::vector<Sample<double>> with_errors(const std::vector<double>& errors) {
  Random random(7801);
  std::vector<Sample<double>> samples;
  for (std::size_t i = 0; i < errors.size(); ++i) {
    samples.push_back(random_sample(random, 0.0));
    samples.back().feature_error(static_cast<int>(i % 8)) = (i % 2 == 0 ? 1.0 : -1.0) * errors[i];
  }
  return samples;
}

}  // namespace

TEST_CASE("every metric is its definition over the whole record") {
  Random random(7802);
  CAPTURE(random.seed());
  const Hexapod<double> hexapod = make_hexapod({});
  for (int trial = 0; trial < 20; ++trial) {
    CAPTURE(trial);
    std::vector<Sample<double>> samples;
    for (int i = 0; i <= 100; ++i) samples.push_back(random_sample(random, 5.0 * std::exp(-0.05 * i)));
    const MetricsSettings<double> settings{2.0, 0.02, 0.05};
    const Metrics<double> m = metrics_of(samples, settings, 1e-3);

    double settling = 0.0, squares = 0.0, count = 0.0, peak_error = 0.0, displacement = 0.0, rotation = 0.0;
    double force = 0.0, moment = 0.0, leg_force = 0.0, excursion = 0.0;
    double overshoot = 0.0, relative = 0.0, distance = 0.0, deviation = 0.0, effort = 0.0, variation = 0.0;
    const auto uniform = [&hexapod](const Sample<double>& s) {
      Vector6<double> w = s.wrench - kGravity;
      w.tail<3>() /= hexapod.platform_radius;
      return w;
    };
    const Vector<double, 8> start = samples.front().feature_error;
    const Matrix3<double> R0 = rotation_matrix(samples.front().quaternion);
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const Sample<double>& s = samples[i];
      const double time = static_cast<double>(i) * 1e-3, error = s.feature_error.cwiseAbs().maxCoeff();
      if (error > 2.0) settling = time;
      if (i >= 50) {
        squares += s.feature_error.squaredNorm();
        count += 8.0;
      }
      peak_error = std::max(peak_error, error);
      displacement = std::max(displacement, (s.position - samples.front().position).norm());
      rotation = std::max(rotation, Eigen::AngleAxisd(rotation_matrix(s.quaternion) * R0.transpose()).angle());
      force = std::max(force, (s.wrench - kGravity).head<3>().cwiseAbs().maxCoeff());
      moment = std::max(moment, (s.wrench - kGravity).tail<3>().cwiseAbs().maxCoeff());
      leg_force = std::max(leg_force, s.leg_forces.cwiseAbs().maxCoeff());
      excursion = std::max(excursion, (s.leg_lengths - hexapod.home_lengths).cwiseAbs().maxCoeff());
      for (int c = 0; c < 8; ++c) {
        if (std::abs(start(c)) <= 2.0) continue;
        const double beyond = start(c) > 0.0 ? -s.feature_error(c) : s.feature_error(c);
        overshoot = std::max(overshoot, beyond);
        relative = std::max(relative, beyond / std::abs(start(c)));
      }
      for (int p = 0; p < 8; p += 2) {
        distance = std::max(distance, (kDesired - s.feature_error).segment<2>(p).norm());
        const Eigen::Vector2d way = start.segment<2>(p), off = s.feature_error.segment<2>(p);
        if (way.norm() > 2.0) deviation = std::max(deviation, (off - way * way.dot(off) / way.squaredNorm()).norm());
      }
      if (i > 0) {
        effort += 1e-3 * uniform(samples[i - 1]).squaredNorm();
        variation += (uniform(s) - uniform(samples[i - 1])).cwiseAbs().sum();
      }
    }
    const Sample<double>& last = samples.back();
    REQUIRE(last.feature_error.cwiseAbs().maxCoeff() <= 2.0);
    CHECK(m.settling_time == settling);
    CHECK(m.final_error == last.feature_error.cwiseAbs().maxCoeff());
    CHECK(m.rms_error == doctest::Approx(std::sqrt(squares / count)).epsilon(1e-13));
    CHECK(m.peak_error == peak_error);
    CHECK(m.peak_displacement == doctest::Approx(displacement).epsilon(1e-13));
    CHECK(m.peak_rotation == doctest::Approx(rotation).epsilon(1e-6));  // near a half turn asin loses half the digits
    CHECK(m.final_linear_speed == doctest::Approx(last.twist.head<3>().norm()).epsilon(1e-14));
    CHECK(m.final_angular_speed == doctest::Approx(last.twist.tail<3>().norm()).epsilon(1e-14));
    CHECK(m.peak_control_force == force);
    CHECK(m.peak_control_moment == moment);
    CHECK(m.peak_leg_force == leg_force);
    CHECK(m.peak_leg_excursion == excursion);
    CHECK(m.overshoot == overshoot);
    CHECK(m.relative_overshoot == doctest::Approx(relative).epsilon(1e-14));
    CHECK(m.peak_feature_distance == doctest::Approx(distance).epsilon(1e-13));
    CHECK(m.peak_line_deviation == doctest::Approx(deviation).epsilon(1e-13));
    CHECK(m.effort == doctest::Approx(effort).epsilon(1e-12));
    CHECK(m.chatter == doctest::Approx(variation / 0.1).epsilon(1e-12));
  }
}

TEST_CASE("rotation from the start is accurate for small angles and blind to the sign of the quaternion") {
  Random random(7803);
  CAPTURE(random.seed());
  for (const double angle : {1e-12, 1e-8, 1e-3, 0.3, 2.0}) {
    CAPTURE(angle);
    std::vector<Sample<double>> samples = {random_sample(random, 1.0), random_sample(random, 1.0)};
    const Vector4<double> q0 = samples[0].quaternion;
    const Vector3<double> axis = random.matrix<3>().normalized();
    const Eigen::Quaterniond q =
        Eigen::Quaterniond(Eigen::AngleAxisd(angle, axis)) * Eigen::Quaterniond(q0(0), q0(1), q0(2), q0(3));
    for (const double sign : {1.0, -1.0}) {
      samples[1].quaternion = sign * Vector4<double>(q.w(), q.x(), q.y(), q.z());
      CHECK(std::abs(metrics_of(samples, {}, 1e-3).peak_rotation - angle) <= 20.0 * kEpsilon * std::max(1.0, angle));
    }
  }
}

TEST_CASE("settling time is the last time outside, where the dwell time follows it") {
  const MetricsSettings<double> settings{2.0, 0.2, 0.0};
  const auto time_of = [&settings](const std::vector<double>& errors) {
    return metrics_of(with_errors(errors), settings, 0.1).settling_time;
  };
  CHECK(time_of({1.0, 1.5, 2.0, 0.5}) == 0.0);  // on the border of the band is within
  CHECK(time_of({5.0, 1.0, 1.0, 1.0}) == 0.0);
  CHECK(time_of({5.0, 3.0, 1.0, 2.5, 1.0, 0.1, 0.1}) == doctest::Approx(0.3));
  CHECK(time_of({5.0, 3.0, 1.0, 2.5, 1.0, 0.1, 0.1, 0.1}) == doctest::Approx(0.3));
  CHECK(std::isnan(time_of({5.0, 1.0, 1.0, 2.1})));
  CHECK(std::isnan(time_of({5.0, 1.0, 1.0, kNaN})));
  CHECK(std::isnan(time_of({5.0})));
  // within the band at the end, but not yet for 0.2 s
  CHECK(std::isnan(time_of({5.0, 3.0, 1.0, 2.5, 1.0, 0.1})));
  CHECK(std::isnan(time_of({5.0, 0.1, 0.1})));
  // shorter than the dwell time: settled only where it never left the band
  CHECK(time_of({1.0, 0.1}) == 0.0);
  CHECK(std::isnan(time_of({5.0, 0.1})));
  CHECK(std::isnan(time_of({1.0})));  // of no duration
}

TEST_CASE("no dwell time is so short that the last sample alone settles a run") {
  for (const double dwell : {1e-300, 1e-9, 0.05, 0.1}) {
    CAPTURE(dwell);
    const MetricsSettings<double> settings{2.0, dwell, 0.0};
    CHECK(std::isnan(metrics_of(with_errors({5.0, 3.0, 3.0, 0.1}), settings, 0.1).settling_time));
    CHECK(metrics_of(with_errors({5.0, 3.0, 3.0, 0.1, 0.1}), settings, 0.1).settling_time == doctest::Approx(0.2));
  }
}

TEST_CASE("a stay that equals the dwell time counts, whatever the rounding of the grid") {
  for (const double step : {1e-3, 0.1, 1.0 / 3.0, 7e-4}) {
    CAPTURE(step);
    for (const int before : {1, 3, 10, 333, 4800}) {
      CAPTURE(before);
      std::vector<double> errors(static_cast<std::size_t>(before), 5.0);
      errors.insert(errors.end(), 201, 1.0);
      const std::vector<Sample<double>> samples = with_errors(errors);
      CHECK(metrics_of(samples, {2.0, 200 * step, 0.0}, step).settling_time == (before - 1) * step);
      CHECK(std::isnan(metrics_of(samples, {2.0, 200.5 * step, 0.0}, step).settling_time));
    }
  }
}

TEST_CASE("the RMS error starts at rms_start, and is NaN where the run is shorter") {
  const std::vector<Sample<double>> samples = with_errors({8.0, 4.0, 2.0, 1.0});
  CHECK(metrics_of(samples, {2.0, 0.2, 0.0}, 0.1).rms_error ==
        doctest::Approx(std::sqrt((64.0 + 16.0 + 4.0 + 1.0) / 32.0)));
  CHECK(metrics_of(samples, {2.0, 0.2, -1.0}, 0.1).rms_error == metrics_of(samples, {2.0, 0.2, 0.0}, 0.1).rms_error);
  CHECK(metrics_of(samples, {2.0, 0.2, 0.2}, 0.1).rms_error == doctest::Approx(std::sqrt(5.0 / 16.0)));
  CHECK(metrics_of(samples, {2.0, 0.2, 0.3}, 0.1).rms_error ==
        doctest::Approx(std::sqrt(1.0 / 8.0)));  // 3 * 0.1 is not 0.3
  CHECK(metrics_of(samples, {2.0, 0.2, 0.3 * (1.0 + 3e-16)}, 0.1 * (1.0 - 3e-16)).rms_error ==
        doctest::Approx(std::sqrt(1.0 / 8.0)));  // and may be less than it
  CHECK(std::isnan(metrics_of(samples, {2.0, 0.2, 0.31}, 0.1).rms_error));
}

TEST_CASE("overshoot is the excursion of a coordinate beyond its goal, in px and relative to its initial error") {
  // x1 from +10 to -3; y1 from -40 to +6; x2 from 2.0, on the threshold, to -9: it has no side; y2 from 50, short of
  // it.
  std::vector<Sample<double>> samples = with_errors({0.0, 0.0, 0.0, 0.0});
  for (Sample<double>& s : samples) s.feature_error.setZero();
  samples[0].feature_error.head<4>() << 10.0, -40.0, 2.0, 50.0;
  samples[1].feature_error.head<4>() << 30.0, -60.0, -9.0, 20.0;
  samples[2].feature_error.head<4>() << -3.0, 6.0, -1.0, 5.0;
  samples[3].feature_error.head<4>() << -1.0, -2.0, 0.0, 1.0;
  const Metrics<double> m = metrics_of(samples, {2.0, 0.2, 0.0}, 0.1);
  CHECK(m.overshoot == 6.0);
  CHECK(m.relative_overshoot == doctest::Approx(0.3).epsilon(1e-15));
  samples.resize(2);
  CHECK(metrics_of(samples, {2.0, 0.2, 0.0}, 0.1).overshoot == 0.0);
  for (Sample<double>& s : samples) s.feature_error.setConstant(-0.5);  // none has a side
  const Metrics<double> none = metrics_of(samples, {2.0, 0.2, 0.0}, 0.1);
  CHECK_FALSE(std::signbit(none.overshoot));
  CHECK_FALSE(std::signbit(none.relative_overshoot));
}

TEST_CASE("distances of features: from the image centre, and from the line through start and goal") {
  // Feature 1 (goal (10, 10)) starts at error (30, 40), so its line has the direction (3, 4)/5 and the normal (-4,
  // 3)/5. At the error (6, 0) it is 24/5 off that line and at (10, 10) - (6, 0); the others are at their goals.
  std::vector<Sample<double>> samples = with_errors({0.0, 0.0, 0.0});
  for (Sample<double>& s : samples) s.feature_error.setZero();
  samples[0].feature_error.head<2>() << 30.0, 40.0;
  samples[1].feature_error.head<2>() << 6.0, 0.0;
  CHECK(metrics_of(samples, {2.0, 0.2, 0.0}, 0.1).peak_line_deviation == doctest::Approx(4.8).epsilon(1e-15));
  CHECK(metrics_of(samples, {50.0, 0.0}, 0.1).peak_line_deviation == 0.0);  // starts within the threshold: no line
  // the farthest goal is (45, -73); then feature 4 (goal (-30, -23)) leaves to (-150, 200): a 3-4-5 triangle
  CHECK(metrics_of(samples, {2.0, 0.2, 0.0}, 0.1).peak_feature_distance == doctest::Approx(std::hypot(45.0, 73.0)));
  samples[2].feature_error.tail<2>() << 120.0, -223.0;
  CHECK(metrics_of(samples, {2.0, 0.2, 0.0}, 0.1).peak_feature_distance == doctest::Approx(250.0).epsilon(1e-15));
}

TEST_CASE("effort and chatter: 2 N, then 3 N along x and 0.4 N m about z, at a platform radius of 0.1 m") {
  std::vector<Sample<double>> samples = with_errors({0.0, 0.0, 0.0, 0.0});
  for (Sample<double>& s : samples) s.wrench = kGravity;
  samples[0].wrench(0) += 2.0;
  samples[1].wrench(0) += 3.0;
  samples[1].wrench(5) += 0.4;
  samples[3].wrench(2) -= 7.0;  // at the end: it changes the wrench and has lasted no time
  const Metrics<double> m = metrics_of(samples, {2.0, 0.2, 0.0}, 0.5);
  CHECK(m.effort == doctest::Approx(0.5 * 4.0 + 0.5 * (9.0 + 16.0)).epsilon(1e-13));
  CHECK(m.chatter == doctest::Approx((1.0 + 4.0 + 3.0 + 4.0 + 7.0) / 1.5).epsilon(1e-13));
  samples.resize(1);
  CHECK(metrics_of(samples, {2.0, 0.2, 0.0}, 0.5).effort == 0.0);
  CHECK(std::isnan(metrics_of(samples, {2.0, 0.2, 0.0}, 0.5).chatter));
}

TEST_CASE("control is the wrench without the weight, which turns with a body whose centre of mass is aside") {
  Random random(7805);
  CAPTURE(random.seed());
  RigidBody<double> body;
  body.centre_E = {0.01, -0.02, 0.03};
  body.off_centre = true;
  Vector6<double> control;
  control << 0.3, -0.2, 0.1, 0.004, -0.005, 0.002;
  Sample<double> sample = random_sample(random, 1.0);
  MetricsAccumulator<double> accumulator({}, make_hexapod({}), body, kDesired, sample);
  for (int i = 0; i < 5; ++i) {
    sample.quaternion = random.quaternion();
    const Vector3<double> weight = -body.mass * body.gravity;
    sample.wrench << weight, (rotation_matrix(sample.quaternion) * body.centre_E).cross(weight);
    sample.wrench += control;
    accumulator.add(1e-3 * i, sample, true);
  }
  CHECK(accumulator.metrics().peak_control_force == doctest::Approx(0.3).epsilon(1e-12));
  CHECK(accumulator.metrics().peak_control_moment == doctest::Approx(0.005).epsilon(1e-12));
  CHECK(accumulator.metrics().chatter <= 1e-9);
}

TEST_CASE("a leg is as fast as it is now, or was in the mean since the last sample; rounding passes no limit") {
  LegTravel<double> travel;
  LegMotion<double> motion{};
  motion.speeds = Vector6<double>::Constant(0.01);
  motion.lengths = Vector6<double>::Constant(0.2);
  CHECK(travel.speeds(0.0, motion, 0.02).maxCoeff() == 0.01);
  motion.lengths(1) -= 0.015 * 0.5;
  motion.lengths(2) += 0.02 * 0.5 * (1.0 + 5e-10);
  motion.lengths(3) += 0.02 * 0.5 * (1.0 + 2e-9);
  const Vector6<double> speeds = travel.speeds(0.5, motion, 0.02);
  CHECK(speeds(0) == 0.01);
  CHECK(speeds(1) == doctest::Approx(0.015).epsilon(1e-12));
  CHECK(speeds(2) == 0.02);
  CHECK(speeds(3) > 0.02);
}

TEST_CASE("limits are noted with their first time and their peak, for each leg alone") {
  LegLimitMonitor<double> monitor;
  const auto values = [](double leg1, double leg4) {
    Vector6<double> v = Vector6<double>::Zero();
    v(1) = leg1;
    v(4) = leg4;
    return v;
  };
  monitor.add(0.0, values(0.5, 0.0), 1.0, true);
  monitor.add(0.1, values(1.0, -1.5), 1.0, true);  // on the limit is not beyond it
  monitor.add(0.2, values(9.0, -9.0), 1.0, false);
  monitor.add(0.3, values(-1.2, 0.0), 1.0, true);
  monitor.add(0.4, values(-1.1, -3.0), 1.0, true);
  CHECK(monitor.first_time(1) == 0.3);
  CHECK(monitor.first_time(4) == 0.1);
  CHECK(monitor.first_time(0) == kInfinity);
  CHECK(monitor.peak(1) == 1.2);
  CHECK(monitor.peak(4) == 3.0);
  CHECK(monitor.peak(0) == 0.0);
}

TEST_CASE("in a pack each lane has its own metrics, and a lane that is not active keeps its own") {
  Random random(7804);
  CAPTURE(random.seed());
  using S = Lanes<4>;
  const Hexapod<double> hexapod = make_hexapod({});
  // lane by lane another band and dwell time; the last lane enters its band too late
  const std::array<MetricsSettings<double>, 4> settings{
      {{2.0, 0.02, 0.01}, {2.0, 0.02, 0.01}, {3.0, 0.005, 0.01}, {0.4, 0.04, 0.01}}};
  MetricsSettings<S> pack_settings;
  constexpr int kSamples = 60, kFrozenFrom = 30, kFrozenLane = 2;
  Hexapod<S> pack_hexapod;
  std::array<std::vector<Sample<double>>, 4> samples;
  std::vector<Sample<S>> packs(std::size_t{kSamples});
  for (int lane = 0; lane < 4; ++lane) {
    const auto l = static_cast<std::size_t>(lane);
    set_lane(pack_hexapod, lane, hexapod);
    set_lane(pack_settings, lane, settings[l]);
    for (int i = 0; i < kSamples; ++i) {
      samples[l].push_back(random_sample(random, lane == 1 ? 5.0 : 5.0 * std::exp(-0.1 * i)));
      if (lane == kFrozenLane && i >= kFrozenFrom) samples[l].back().feature_error.setConstant(kNaN);
      set_lane(packs[static_cast<std::size_t>(i)], lane, samples[l].back());
    }
    samples[l].resize(static_cast<std::size_t>(lane == kFrozenLane ? kFrozenFrom : kSamples));
  }
  MetricsAccumulator<S> accumulator(pack_settings, pack_hexapod, RigidBody<S>{}, kDesired.cast<S>(), packs.front());
  S is_frozen = 0.0;
  is_frozen.set(kFrozenLane, 1.0);
  for (int i = 0; i < kSamples; ++i)
    accumulator.add(i * 1e-3, packs[static_cast<std::size_t>(i)],
                    i < kFrozenFrom ? Mask<S>(true) : is_frozen == S(0.0));
  const Metrics<S> m = accumulator.metrics();
  for (int lane = 0; lane < 4; ++lane) {
    CAPTURE(lane);
    const auto l = static_cast<std::size_t>(lane);
    const Metrics<double> single = metrics_of(samples[l], settings[l], 1e-3);
    CHECK(std::isnan(single.settling_time) == (lane == 1 || lane == 3));
    const auto agree = [&](const S& pack, double value) {
      return std::isnan(value) ? std::isnan(pack[lane]) : std::abs(pack[lane] - value) <= 1e-13 * std::abs(value);
    };
    CHECK(agree(m.settling_time, single.settling_time));
    CHECK(agree(m.final_error, single.final_error));
    CHECK(agree(m.rms_error, single.rms_error));
    CHECK(agree(m.peak_error, single.peak_error));
    CHECK(agree(m.peak_displacement, single.peak_displacement));
    CHECK(std::abs(m.peak_rotation[lane] - single.peak_rotation) <= 1e-6);
    CHECK(agree(m.final_linear_speed, single.final_linear_speed));
    CHECK(agree(m.final_angular_speed, single.final_angular_speed));
    CHECK(agree(m.peak_control_force, single.peak_control_force));
    CHECK(agree(m.peak_control_moment, single.peak_control_moment));
    CHECK(agree(m.peak_leg_force, single.peak_leg_force));
    CHECK(agree(m.peak_leg_excursion, single.peak_leg_excursion));
    CHECK(agree(m.overshoot, single.overshoot));
    CHECK(agree(m.relative_overshoot, single.relative_overshoot));
    CHECK(agree(m.peak_feature_distance, single.peak_feature_distance));
    CHECK(agree(m.peak_line_deviation, single.peak_line_deviation));
    CHECK(agree(m.effort, single.effort));
    CHECK(agree(m.chatter, single.chatter));
  }
}

TEST_CASE("samples that are known to be finite give the same metrics and limits, to the last bit") {
  Random random(7806);
  CAPTURE(random.seed());
  const Hexapod<double> hexapod = make_hexapod({});
  std::vector<Sample<double>> samples;
  for (int i = 0; i <= 200; ++i) samples.push_back(random_sample(random, 5.0 * std::exp(-0.02 * i)));
  const MetricsSettings<double> settings{2.0, 0.02, 0.05};
  MetricsAccumulator<double> any(settings, hexapod, RigidBody<double>{}, kDesired, samples.front()), finite = any;
  for (std::size_t i = 0; i < samples.size(); ++i) {
    any.add(static_cast<double>(i) * 1e-3, samples[i], true);
    finite.add_finite(static_cast<double>(i) * 1e-3, samples[i]);
  }
  const Metrics<double> a = any.metrics(), b = finite.metrics();
  const auto same = [](double x, double y) {
    return x == y || (std::isnan(x) && std::isnan(y));
  };  // no such limit: NaN
  Metrics<double>::visit([&](const char*, double x, double y) { CHECK(same(x, y)); }, a, b);
  CHECK(any.stroke().peak == finite.stroke().peak);
  CHECK(any.stroke().first_time == finite.stroke().first_time);
  CHECK(any.force().peak == finite.force().peak);
  CHECK(any.force().first_time == finite.force().first_time);
  CHECK(any.stroke().peak.maxCoeff() > hexapod.stroke);  // limits were passed
}

TEST_CASE("NaN in a sample is not swallowed by a peak") {
  Random random(7805);
  CAPTURE(random.seed());
  std::vector<Sample<double>> samples = {random_sample(random, 1.0), random_sample(random, 1.0)};
  samples[1].feature_error(3) = kNaN;
  samples[1].leg_forces(2) = kNaN;
  const Metrics<double> m = metrics_of(samples, {2.0, 0.2, 0.0}, 1e-3);
  CHECK(std::isnan(m.peak_error));
  CHECK(std::isnan(m.final_error));
  CHECK(std::isnan(m.rms_error));
  CHECK(std::isnan(m.peak_leg_force));
  CHECK(std::isnan(m.peak_feature_distance));
  CHECK(std::isnan(m.peak_line_deviation));
  CHECK(largest_abs(Vector3<double>(1.0, -3.0, 2.0)) == 3.0);
  CHECK(std::isnan(largest_abs(Vector3<double>(kNaN, -3.0, 2.0))));
  CHECK(std::isnan(largest_abs(Vector3<double>(1.0, -3.0, kNaN))));
}
