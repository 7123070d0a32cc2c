// Base motion: each kind against its definition, and the spectrum of the noise.
#include "hexservo/base_motion.hpp"

#include "allocations.hpp"
#include "compare.hpp"
#include "random.hpp"

#include <complex>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

constexpr double kTwoPi = 6.283185307179586;

const BaseMotionParameters<double> kNoise{
    .kind = BaseMotionKind::noise, .level = {0.02, 0.05, 0.0}, .low_frequency = 2.0, .high_frequency = 12.0};

BaseMotion<double> noise(std::uint64_t seed) { return {kNoise, seed_halves(seed)}; }

/// A body whose centre of mass is beside the platform's origin.
RigidBody<double> off_centre_body() {
  RigidBody<double> body;
  body.centre_E = {0.01, -0.02, 0.03};
  body.off_centre = true;
  return body;
}

}  // namespace

TEST_CASE("without base motion nothing accelerates") {
  const BaseMotion<double> motion({.amplitude = {1.0, 1.0, 1.0}, .level = {1.0, 1.0, 1.0}}, seed_halves(0));
  for (const double t : {0.0, 0.1, 7.0}) CHECK(motion.acceleration(t).norm() == 0.0);
}

TEST_CASE("a sinusoid is amplitude sin(2 pi f t + phase)") {
  const BaseMotionParameters<double> parameters{
      .kind = BaseMotionKind::sinusoid, .amplitude = {0.5, -0.2, 1.5}, .frequency = 3.7, .phase = 0.4};
  const BaseMotion<double> motion(parameters, seed_halves(0));
  for (int k = 0; k < 1000; ++k) {
    const double t = 0.0037 * k;
    const Vector3<double> expected =
        parameters.amplitude * std::sin(kTwoPi * parameters.frequency * t + parameters.phase);
    // rounding of the angle, up to 90 rad
    CHECK(distance(motion.acceleration(t), expected) <= 1.5 * 90.0 * 4.0 * kEpsilon);
  }
}

TEST_CASE("recorded samples are met, joined by straight lines, and followed by rest") {
  Random random(7601);
  CAPTURE(random.seed());
  constexpr long long kCount = 20;
  constexpr double kPeriod = 0.25;  // a power of two: sample times are exact
  const Eigen::Matrix<double, 3, 20> samples = random.matrix<3, 20>(2.0);
  const BaseMotion<double> motion({.kind = BaseMotionKind::recorded}, seed_halves(0),
                                  {samples.data(), kCount, kPeriod});
  for (int i = 0; i < kCount; ++i) {
    CHECK(distance(motion.acceleration(i * kPeriod), samples.col(i)) == 0.0);
    if (i + 1 == kCount) break;
    for (const double share : {0.125, 0.5, 0.875}) {
      const Vector3<double> expected = (1.0 - share) * samples.col(i) + share * samples.col(i + 1);
      CHECK(distance(motion.acceleration((i + share) * kPeriod), expected) <= 4.0 * kEpsilon);
    }
  }
  CHECK(motion.acceleration((kCount - 1) * kPeriod + 1e-9).norm() == 0.0);
  CHECK(motion.acceleration(1e9).norm() == 0.0);
}

TEST_CASE("the variance of the noise is the integral of its spectrum, axis by axis") {
  // Over a long time each wave carries A^2/2 = S df; a pair of waves that are delta apart adds about A^2/(2 pi delta T)
  // at most. The sum of those, over cells of 0.3 Hz at random places, is a few percent after 1000 s.
  constexpr double kStep = 0.01, kTime = 1000.0;
  for (const std::uint64_t seed : {1u, 2u, 3u}) {
    CAPTURE(seed);
    const BaseMotion<double> motion = noise(seed);
    Vector3<double> sum = Vector3<double>::Zero(), square = sum;
    double product = 0.0;
    const int count = static_cast<int>(kTime / kStep);
    for (int k = 0; k < count; ++k) {
      const Vector3<double> a = motion.acceleration(k * kStep);
      sum += a;
      square += a.cwiseAbs2();
      product += a(0) * a(1);
    }
    const Vector3<double> expected = kNoise.level * (kNoise.high_frequency - kNoise.low_frequency);
    CHECK(distance((square / count).head<2>().cwiseQuotient(expected.head<2>()), Vector2<double>::Ones()) <= 0.05);
    CHECK(square(2) == 0.0);
    CHECK((sum / count).norm() <= 0.01);  // no wave is slower than 2 Hz
    CHECK(std::abs(product / count) <= 0.05 * std::sqrt(expected(0) * expected(1)));
  }
}

TEST_CASE("the spectrum of the noise is flat between its frequencies, and nothing is outside") {
  // One-sided periodogram 2 dt/n |sum a exp(-i 2 pi f t)|^2 over 20.48 s, mean over 64 seeds. A bin of 1/20.48 Hz sees
  // about one wave: its power is about as scattered as an exponential variable, so the mean of a band of B bins over
  // 64 seeds has a relative standard deviation of about 1/sqrt(64 B). A Hann window keeps the sides clean.
  constexpr int kCount = 1024, kSeeds = 64;
  constexpr double kStep = 0.02;
  std::vector<std::complex<double>> turns(kCount);
  std::vector<double> window(kCount);
  double window_power = 0.0;
  for (int i = 0; i < kCount; ++i) {
    const auto k = static_cast<std::size_t>(i);
    turns[k] = std::polar(1.0, -kTwoPi * i / kCount);
    window[k] = 0.5 - 0.5 * std::cos(kTwoPi * i / kCount);
    window_power += window[k] * window[k];
  }
  std::vector<double> power(kCount / 2, 0.0);
  for (std::uint64_t seed = 0; seed < kSeeds; ++seed) {
    const BaseMotion<double> motion = noise(100 + seed);
    std::vector<double> a(kCount);
    for (int i = 0; i < kCount; ++i) a[static_cast<std::size_t>(i)] = motion.acceleration(3.0 + i * kStep)(1);
    for (std::size_t bin = 0; bin < power.size(); ++bin) {
      std::complex<double> sum = 0.0;
      for (std::size_t i = 0; i < kCount; ++i) sum += window[i] * a[i] * turns[bin * i % kCount];
      power[bin] += 2.0 * kStep / window_power * std::norm(sum) / kSeeds;
    }
  }
  const auto mean = [&](double from, double to, int& bins) {
    double sum = 0.0;
    bins = 0;
    for (std::size_t bin = 0; bin < power.size(); ++bin) {
      const double f = static_cast<double>(bin) / (kCount * kStep);
      if (f < from || f >= to) continue;
      sum += power[bin];
      ++bins;
    }
    return sum / bins;
  };
  int bins = 0;
  for (const double from : {2.2, 3.2, 5.2, 7.0, 9.0, 11.0}) {
    CAPTURE(from);
    const double level = mean(from, from + 0.8, bins);
    CAPTURE(level);
    CHECK(std::abs(level / kNoise.level(1) - 1.0) <= 5.0 / std::sqrt(static_cast<double>(kSeeds * bins)));
  }
  CHECK(mean(0.0, 1.7, bins) <= 1e-3 * kNoise.level(1));
  CHECK(mean(12.3, 25.0, bins) <= 1e-3 * kNoise.level(1));
}

TEST_CASE("noise is a function of seed and time, and never repeats where equally spaced waves would") {
  const BaseMotion<double> motion = noise(5), same = noise(5), other = noise(6);
  double repeated = 0.0, different = 0.0;
  const double period = kBaseMotionWaves / (kNoise.high_frequency - kNoise.low_frequency);
  for (int k = 0; k < 100; ++k) {
    const double t = 0.01 * k;
    CHECK(distance(motion.acceleration(t), same.acceleration(t)) == 0.0);
    different = std::max(different, distance(motion.acceleration(t), other.acceleration(t)));
    repeated = std::max(repeated, distance(motion.acceleration(t), motion.acceleration(t + period)));
  }
  CHECK(different > 0.1);
  CHECK(repeated > 0.1);
}

TEST_CASE(
    "the acceleration of the base is the second derivative of its place, and a recorded place ends where it began") {
  Random random(7604);
  CAPTURE(random.seed());
  constexpr double kSamplePeriod = 0.25, kStep = 1e-3;  // [s]
  const Eigen::Matrix<double, 3, 9> samples = random.matrix<3, 9>(2.0);
  using enum BaseMotionKind;
  for (const BaseMotionKind kind : {sinusoid, recorded, noise, road}) {
    CAPTURE(static_cast<int>(kind));
    BaseMotionParameters<double> parameters = kNoise;
    parameters.kind = kind;
    parameters.amplitude = {1.0, -0.5, 2.0};
    parameters.frequency = 2.0;
    parameters.phase = 0.4;
    parameters.road = {.speed = 10.0, .shortest = 5.0, .position = {1.0, 0.5, -0.3}};  // waves of 2 Hz at most
    BaseMotion<double> motion(parameters, seed_halves(3), {samples.data(), 9, kSamplePeriod});
    motion.find_place();
    for (int i = 1; i < 16; ++i) {  // at the samples, and between them
      const double t = 0.5 * i * kSamplePeriod;
      CAPTURE(t);
      const Vector3<double> change = motion.place(t + kStep) - 2.0 * motion.place(t) + motion.place(t - kStep),
                            a = motion.acceleration(t);
      CHECK(distance(change / (kStep * kStep), a) <= 0.01 * (1.0 + a.norm()));
    }
    if (kind == recorded) {
      CHECK(motion.place(0.0).norm() == 0.0);
      CHECK(motion.place(8.0 * kSamplePeriod).norm() <= 1e-15);
    }
  }
}

TEST_CASE("the inertial force of a platform acts in its centre of mass") {
  Random random(7605);
  CAPTURE(random.seed());
  const RigidBody<double> body = off_centre_body();
  DynamicsError<double> error;
  error.inertia.setConstant(0.1);
  const Plant<double> plant(body, error);
  const Matrix3<double> R_BE = rotation_matrix<double>(random.matrix<4>(1.0));
  const Vector3<double> a = random.matrix<3>(3.0), force = -0.9 * body.mass * a;
  const Vector6<double> wrench = inertial_wrench<double>(plant, R_BE, a);
  CHECK(distance(wrench.head<3>(), force) <= 1e-15);
  CHECK(distance(wrench.tail<3>(), (R_BE * body.centre_E).cross(force)) <= 1e-15);
}

TEST_CASE("the inertial wrench gives the actual platform the acceleration -a, whatever its mass error") {
  Random random(7602);
  CAPTURE(random.seed());
  DynamicsError<double> error;
  error.inertia.diagonal() << 0.1, -0.05, 0.2, 0.0, 0.0, 0.0;
  const Plant<double> plant(RigidBody<double>{}, error);
  const Vector3<double> a = random.matrix<3>(3.0);
  const Vector6<double> gain =
      acceleration<double>(plant, Matrix3<double>::Identity(), Vector6<double>(Vector6<double>::Zero()),
                           plant.weight + inertial_wrench<double>(plant, Matrix3<double>::Identity(), a))
          .vector();
  CHECK(distance(gain.head<3>(), -a) <= 100.0 * kEpsilon);
  CHECK(gain.tail<3>().norm() == 0.0);
  CHECK(inertial_wrench<double>(plant, Matrix3<double>::Identity(), a)(1) ==
        doctest::Approx(-1.05 * 0.06 * a(1)).epsilon(1e-14));
}

TEST_CASE("a pack moves as single ones do, each lane with its own seed and numbers") {
  constexpr int kWidth = 4;
  using S = Lanes<kWidth>;
  const Eigen::Matrix<double, 3, 3> samples = Matrix3<double>::Identity();
  const Eigen::Matrix<double, 4, 3> attitudes{{1.0, 0.98, 0.95}, {0.0, 0.1, 0.1}, {0.0, 0.1, 0.2}, {0.0, -0.1, 0.1}};
  using enum BaseMotionKind;
  for (const auto& [kind, rotation] : {std::pair{none, RotationKind::sinusoid},
                                       {sinusoid, RotationKind::noise},
                                       {recorded, RotationKind::none},
                                       {noise, RotationKind::none},
                                       {road, RotationKind::none}}) {
    CAPTURE(static_cast<int>(kind));
    const Recording recorded{samples.data(), 3, 0.5, attitudes.data()};
    BaseMotionParameters<S> parameters;
    SeedHalves<S> seeds;
    std::vector<BaseMotion<double>> singles;
    for (int lane = 0; lane < kWidth; ++lane) {
      BaseMotionParameters<double> single = kNoise;
      single.kind = kind;
      single.rotation = {.kind = rotation,
                         .amplitude = {0.1 * lane, 0.2, -0.1},
                         .frequency = {1.0, 2.0 + lane, 3.0},
                         .level = {1e-3, 1e-4 * lane, 1e-3}};
      single.road.speed = 5.0 + lane;
      single.road.position = {1.0, 0.5, -0.1 * lane};
      single.amplitude = {0.1 * lane, 1.0, -0.5};
      single.frequency = 1.0 + lane;
      single.level(0) = 0.1 * lane;
      single.high_frequency = 15.0 + lane;
      set_lane(parameters, lane, single);
      set_lane(seeds, lane, seed_halves(static_cast<std::uint64_t>(lane)));
      singles.emplace_back(single, seed_halves(static_cast<std::uint64_t>(lane)), recorded);
      singles.back().find_place();
    }
    BaseMotion<S> pack(parameters, seeds, recorded);
    pack.find_place();
    CHECK(pack.turns() == (kind != noise));
    for (const double t : {0.0, 0.3, 0.9, 100.0}) {
      const long long before = allocations;
      const Vector3<S> a = pack.acceleration(t), place = pack.place(t);
      const BaseState<S> state = pack.state(t);
      CHECK(allocations == before);
      for (int lane = 0; lane < kWidth; ++lane) {
        const BaseMotion<double>& single = singles[static_cast<std::size_t>(lane)];
        const BaseState<double> expected = single.state(t);
        const double largest = 1.0 + expected.acceleration_B.norm();
        CHECK(distance(lane_of(a, lane), single.acceleration(t)) <= 1e-12 * largest);
        CHECK(distance(lane_of(place, lane), single.place(t)) <= 1e-12);
        CHECK(distance(lane_of(state.acceleration_B, lane), expected.acceleration_B) <= 1e-12 * largest);
        CHECK(distance(lane_of(state.turning.R_WB, lane), expected.turning.R_WB) <= 1e-12);
        CHECK(distance(lane_of(state.turning.rate_B, lane), expected.turning.rate_B) <= 1e-10);
        CHECK(distance(lane_of(state.turning.rate_change_B, lane), expected.turning.rate_change_B) <= 1e-9 * largest);
      }
    }
  }
}

TEST_CASE("rear wheels pass what the front wheels passed, and the body follows as a mass on spring and damper") {
  RoadParameters<double> road{.speed = 12.0, .suspension = std::numeric_limits<double>::infinity()};
  const RoadWaves<double> rigid(road, seed_halves(5));
  road.suspension = 1.5;
  const RoadWaves<double> sprung(road, seed_halves(5));
  const double w = kTwoPi * road.suspension, late = road.wheelbase / road.speed;
  const auto height = [&](double time, double ahead) {  // of a pair of wheels; z points down
    return ahead * rigid.rotation.at(time).value(1) - rigid.place.at(time).value(2);
  };
  for (double t = 0.0; t < 3.0; t += 0.137) {
    CAPTURE(t);
    const double front = height(t, 0.5 * road.wheelbase), rear = height(t + late, -0.5 * road.wheelbase);
    CHECK(std::abs(front - rear) <= 1e-12);
    for (const bool turns : {false, true}) {
      const Curve<double, 3> foot = turns ? rigid.rotation.at(t) : rigid.place.at(t),
                             body = turns ? sprung.rotation.at(t) : sprung.place.at(t);
      const Vector3<double> force =
          2.0 * road.damping * w * (foot.rate - body.rate) + w * w * (foot.value - body.value);
      CHECK(distance(body.acceleration, force) <= 1e-9 * (1.0 + force.norm()));
    }
  }
}

TEST_CASE("the coherence of two tracks is x K_1(x)") {
  for (double x = 1e-6; x < 60.0; x *= 1.3) {
    CAPTURE(x);
    CHECK(std::abs(bessel_coherence(x) - x * std::cyl_bessel_k(1.0, x)) <= 1e-6);
  }
}

TEST_CASE("a base that turns by nothing adds the wrench of one that does not turn") {
  Random random(7603);
  CAPTURE(random.seed());
  const RigidBody<double> body = off_centre_body();
  DynamicsError<double> error;
  error.inertia.diagonal().setConstant(0.1);
  error.coriolis.setConstant(0.2);
  error.gravity.setConstant(-0.1);
  const Plant<double> plant(body, error);
  const Matrix3<double> R_BE = rotation_matrix<double>(random.matrix<4>(1.0));
  const Vector3<double> a = random.matrix<3>(3.0), p = random.matrix<3>(0.3);
  const Vector6<double> twist = random.matrix<6>(2.0);
  const Vector6<double> expected = inertial_wrench<double>(plant, R_BE, a);
  CHECK(distance(moving_base_wrench<double>(plant, p, R_BE, twist, {{}, a}), expected) <= 1e-15);

  // One that is tilted tilts the weight alone, with the error that the weight has.
  BaseState<double> tilted{{}, Vector3<double>::Zero()};
  tilted.turning.R_WB = random.rotation(0.5);
  const auto weight = [&](const Vector3<double>& gravity) {
    Vector6<double> wrench;
    wrench << -body.mass * gravity, (R_BE * body.centre_E).cross(-body.mass * gravity);
    return wrench;
  };
  const Vector3<double> change = tilted.turning.R_WB.transpose() * body.gravity - body.gravity;
  CHECK(distance(moving_base_wrench<double>(plant, p, R_BE, Vector6<double>::Zero(), tilted), -1.1 * weight(change)) <=
        1e-14);
}
