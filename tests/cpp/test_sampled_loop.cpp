#include "compare.hpp"
#include "scenarios.hpp"

#include "hexservo/settings.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

/// Corners of docs/model.md, section 8.
template <class Law>
Settings corner(double gravity, double depth) {
  Settings settings = paper_settings<Law>();
  settings.uncertainty.gravity.setConstant(gravity);
  settings.uncertainty.depth.setConstant(depth);
  settings.simulation.mode = LoopMode::sampled;
  settings.controller.switching.kind = SwitchingKind::implicit;
  return settings;
}

struct Row {
  double settle, error, rms;
};

template <class Law>
Row run_of(const Settings& settings) {
  const LoopParameters<double, Law> p = loop_parameters<Law>(settings);
  SampledLoop<double, Law> loop(p);
  const long long steps = step_count(settings.simulation);
  while (loop.steps() < steps && loop.record().running()) loop.advance();
  const Metrics<double> m = loop.record().metrics().metrics();
  if (!loop.record().running()) return {kInfinity, kInfinity, kInfinity};
  return {m.settling_time, m.final_error, m.rms_error};
}

Row run(const Settings& settings) {
  return with_law(settings.law(), [&]<class Law>(std::type_identity<Law>) { return run_of<Law>(settings); });
}

Settings with_camera(Settings settings, double period, double latency, Prediction prediction, double noise) {
  settings.camera.period = period;
  settings.camera.latency = latency;
  settings.camera.prediction = prediction;
  settings.camera.noise = noise;
  return settings;
}

double median(std::vector<double> values) {
  std::ranges::sort(values);
  const std::size_t half = values.size() / 2;
  return values.size() % 2 == 1 ? values[half] : 0.5 * (values[half - 1] + values[half]);
}

/// Medians over 20 seeds.
Row run_noisy(Settings settings) {
  std::vector<double> settle, error, rms;
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    settings.seed = seed;
    const Row row = run(settings);
    settle.push_back(row.settle);
    error.push_back(row.error);
    rms.push_back(row.rms);
  }
  return {median(settle), median(error), median(rms)};
}

constexpr double kMs = 1e-3;

}  // namespace

TEST_CASE("known results of the sampled loop, hybrid") {
  const auto paper = corner<Hybrid>(0.0, 0.3);
  const Row ideal = run(paper);
  CHECK(ideal.settle == doctest::Approx(0.447).epsilon(0.03));
  CHECK(std::abs(ideal.error - 0.082) <= 0.02);
  CHECK(std::abs(ideal.rms - 0.054) <= 0.02);
  CHECK(run(with_camera(paper, 10 * kMs, 10 * kMs, Prediction::none, 0.0)).settle == kInfinity);

  const Row slow = run(with_camera(paper, 33 * kMs, 33 * kMs, Prediction::encoder, 0.0));
  CHECK(slow.settle == doctest::Approx(0.480).epsilon(0.03));
  CHECK(std::abs(slow.error - 0.087) <= 0.02);
  CHECK(std::abs(slow.rms - 0.055) <= 0.02);
  const Row slower = run(with_camera(paper, 66 * kMs, 66 * kMs, Prediction::encoder, 0.0));
  CHECK(slower.settle == doctest::Approx(0.513).epsilon(0.03));
  CHECK(std::abs(slower.error - 0.081) <= 0.02);
  CHECK(std::abs(slower.rms - 0.054) <= 0.02);
  MESSAGE("hybrid " << ideal.settle << ' ' << ideal.error << ' ' << ideal.rms << "; " << slow.settle << ' '
                    << slow.error << ' ' << slow.rms << "; " << slower.settle << ' ' << slower.error << ' '
                    << slower.rms);
  const Row noisy = run_noisy(with_camera(paper, 66 * kMs, 66 * kMs, Prediction::encoder, 0.2));
  MESSAGE("noisy " << noisy.settle << ' ' << noisy.rms);
  CHECK(noisy.settle == doctest::Approx(0.513).epsilon(0.03));
  CHECK(noisy.rms == doctest::Approx(0.121).epsilon(0.10));
}

TEST_CASE("known results of the sampled loop, hybrid: what does not converge in any corner") {
  for (const double gravity : {0.0, 0.075})
    for (const double second_depth : {0.3, -0.3}) {
      CAPTURE(gravity);
      CAPTURE(second_depth);
      auto settings = corner<Hybrid>(gravity, 0.3);
      settings.uncertainty.depth(1) = second_depth;
      CHECK(run(with_camera(settings, 10 * kMs, 10 * kMs, Prediction::none, 0.0)).settle == kInfinity);
      settings.gains<Hybrid>().fuzzy.enabled = false;  // a wrench that is held is negative damping
      CHECK(run(settings).settle == kInfinity);
    }
}

TEST_CASE("known results of the sampled loop, composite") {
  const auto gravity = corner<Composite>(0.075, 0.3);
  const Row none = run(with_camera(gravity, 10 * kMs, 10 * kMs, Prediction::none, 0.0));
  CHECK(none.settle == doctest::Approx(0.515).epsilon(0.03));
  CHECK(std::abs(none.error - 0.052) <= 0.02);
  CHECK(std::abs(none.rms - 0.050) <= 0.02);
  struct Case {
    double ms;
    Prediction prediction;
    double settle, rms;
  };
  for (const Case& c : {Case{10, Prediction::none, 0.515, 0.057}, Case{33, Prediction::none, 0.434, 0.071},
                        Case{66, Prediction::encoder, 0.599, 0.095}}) {
    CAPTURE(c.ms);
    const Row row = run_noisy(with_camera(gravity, c.ms * kMs, c.ms * kMs, c.prediction, 0.2));
    MESSAGE("composite " << c.ms << ": " << row.settle << ' ' << row.rms);
    CHECK(row.settle == doctest::Approx(c.settle).epsilon(0.03));
    CHECK(row.rms == doctest::Approx(c.rms).epsilon(0.10));
  }
  auto mixed = gravity;
  mixed.uncertainty.depth(1) = -0.3;
  const Row row = run_noisy(with_camera(mixed, 33 * kMs, 33 * kMs, Prediction::encoder, 0.2));
  MESSAGE("mixed " << row.settle << ' ' << row.rms);
  CHECK(row.settle == doctest::Approx(0.626).epsilon(0.03));
  CHECK(row.rms == doctest::Approx(0.120).epsilon(0.10));
}

TEST_CASE("the implicit switching function brings the platform to rest; sign chatters") {
  auto settings = corner<Hybrid>(0.0, 0.3);
  const auto end = [](const Settings& s) {
    const LoopParameters<double, Hybrid> p = loop_parameters<Hybrid>(s);
    SampledLoop<double, Hybrid> loop(p);
    for (long long i = 0; i < step_count(s.simulation); ++i) loop.advance();
    REQUIRE(loop.record().running());
    return loop.record().sample().twist.cwiseAbs().maxCoeff();
  };
  CHECK(end(settings) <= 1e-12);
  settings.controller.switching.kind = SwitchingKind::implicit_coupled;
  CHECK(end(settings) <= 1e-12);
  settings.controller.switching.kind = SwitchingKind::sign;
  CHECK(end(settings) >= 1e-6);
}

TEST_CASE("the sampled loop tends to the continuous one at first order in the period") {
  auto settings = corner<Hybrid>(0.0, 0.3);
  settings.controller.switching = {SwitchingKind::tanh, 1e-2};
  settings.simulation.duration = 0.2;
  const auto end = [&settings](LoopMode mode, double step) {
    settings.simulation.mode = mode;
    settings.simulation.step = settings.camera.period = step;
    const LoopParameters<double, Hybrid> p = loop_parameters<Hybrid>(settings);
    const auto last_of = [&](auto&& loop) {
      for (long long i = 0; i < step_count(settings.simulation); ++i) loop.advance();
      REQUIRE(loop.record().running());
      return Vector<double, 8>(loop.record().sample().feature_error);
    };
    return mode == LoopMode::continuous ? last_of(ClosedLoop<double, Hybrid>(p))
                                        : last_of(SampledLoop<double, Hybrid>(p));
  };
  const Vector<double, 8> continuous = end(LoopMode::continuous, 1e-4);
  const double coarse = distance(end(LoopMode::sampled, 1e-4), continuous);
  const double middle = distance(end(LoopMode::sampled, 5e-5), continuous);
  const double fine = distance(end(LoopMode::sampled, 2.5e-5), continuous);
  CAPTURE(coarse);
  CAPTURE(middle);
  CAPTURE(fine);
  // An error e(h) = a h + b h^2 + ...: the ratio is 2 + (2 b/a) h, and what it is off 2 by halves with h.
  const double first = coarse / middle - 2.0, second = middle / fine - 2.0;
  CHECK(std::abs(second) <= 0.1);
  CHECK(second / first == doctest::Approx(0.5).epsilon(0.1));
}

TEST_CASE("substeps integrate the plant more finely and leave the law's ticks alone") {
  auto settings = corner<Hybrid>(0.0, 0.3);
  settings.controller.switching = {SwitchingKind::tanh, 1e-2};
  settings.simulation.duration = 0.2;
  settings.simulation.step = settings.camera.period = 4e-3;
  const auto end = [&settings](long long substeps) {
    settings.simulation.substeps = substeps;
    const LoopParameters<double, Hybrid> p = loop_parameters<Hybrid>(settings);
    SampledLoop<double, Hybrid> loop(p);
    while (loop.time() < 0.2 - 1e-9) loop.advance();
    CHECK(loop.steps() == 50);
    return Vector<double, 8>(loop.record().sample().feature_error);
  };
  const Vector<double, 8> exact = end(64);
  const double one = distance(end(1), exact), two = distance(end(2), exact), four = distance(end(4), exact);
  CAPTURE(one);
  CHECK(one <= 1e-4);                                      // the wrench is constant: next to nothing
  CHECK(one / two == doctest::Approx(16.0).epsilon(0.2));  // order four
  CHECK(two / four == doctest::Approx(16.0).epsilon(0.2));
}

TEST_CASE("before the first frame the wrench is G: the platform of the nominal model does not move") {
  auto settings = corner<Hybrid>(0.0, 0.3);
  settings.uncertainty = {};
  settings.camera.latency = 0.05;
  const LoopParameters<double, Hybrid> p = loop_parameters<Hybrid>(settings);
  SampledLoop<double, Hybrid> loop(p);
  for (int tick = 0; tick < 50; ++tick) {
    CHECK(loop.record().sample().wrench == gravity_wrench(p.body));
    CHECK(loop.record().sample().twist.cwiseAbs().maxCoeff() <= 1e-15);
    loop.advance();
  }
  CHECK(loop.record().sample().wrench != gravity_wrench(p.body));  // tick 50, on the frame of tick 0
}

TEST_CASE("an image that is lost in motion: the brake stops the platform, and G alone does not") {
  // 7.5 % of the weight is missing; the image goes where the platform moves at some 27 mm/s.
  for (const double gravity : {0.075, -0.075})
    for (const bool brake : {true, false})
      for (const bool encoders : {false, true}) {
        CAPTURE(gravity);
        CAPTURE(brake);
        CAPTURE(encoders);
        auto settings = corner<Composite>(gravity, 0.3);
        if (!brake) settings.controller.safe = {Vector6<double>::Zero(), Vector6<double>::Zero()};
        if (encoders) settings.sensors.pose = PoseSource::encoders;
        settings.camera.timeout = 5 * kMs;
        const LoopParameters<double, Composite> p = loop_parameters<Composite>(settings);
        const auto gains = servo_gains(p);
        auto state = ServoState<double, Composite>(gains);
        SampledPlant<double> plant(p);
        ServoTick<double, Composite> tick;
        bool blind = false;
        const auto take_tick = [&] {
          SensorInput<double> input = plant.sense();
          if (blind) input.frame.exposure = kNaN;
          evaluate(gains, state, input, tick);
          adapt(gains, state, tick, true);
          plant.command(tick.command, state.perception.now(), tick.law.fuzzy_output);
          REQUIRE(plant.advance());
        };
        const auto speed = [&] { return plant.record().sample().twist.head<3>().norm(); };
        while (plant.time() < 0.5 && !(speed() > 0.027)) take_tick();
        MESSAGE("image lost at " << 1e3 * speed() << " mm/s, t = " << plant.time() << " s");
        REQUIRE(speed() > 0.02);
        blind = true;
        while (tick.command.acts) take_tick();
        const Vector3<double> where = plant.record().sample().position;
        const double since = plant.time();
        double farthest = 0.0, late_speed = 0.0;
        while (plant.time() < since + 0.5) {
          take_tick();
          REQUIRE_FALSE(tick.command.acts);
          farthest = std::max(farthest, (plant.record().sample().position - where).norm());
          if (plant.time() > since + 0.05) late_speed = std::max(late_speed, speed());
        }
        MESSAGE("brake " << brake << ", encoders " << encoders << ": " << 1e3 * farthest << " mm, " << 1e3 * late_speed
                         << " mm/s after 50 ms");
        if (brake) {
          CHECK(farthest <= 2e-3);
          CHECK(late_speed <= 1e-3);
        } else {
          CHECK(farthest > 10e-3);
        }
      }
}

TEST_CASE("gains of the brake: as given, and derived from the estimated inertia and what is late") {
  auto settings = corner<Hybrid>(0.0, 0.3);
  const auto gains = [&] { return loop_parameters<Hybrid>(settings).safe; };
  CHECK(gains().hold_rate == doctest::Approx(1e4));  // of 100 rad/s
  CHECK(gains().damping_rate == doctest::Approx(200.0));
  CHECK(gains().hold.isZero(0.0));
  CHECK(gains().damping.isZero(0.0));
  settings.actuators.delay = 4 * kMs;  // 5 ms with the tick: 40 rad/s
  CHECK(gains().hold_rate == doctest::Approx(1600.0));
  settings.controller.safe.hold = Vector6<double>::Constant(7.0);
  CHECK(gains().hold(3) == 7.0);
  CHECK(gains().hold_rate == 0.0);
  CHECK(gains().damping_rate == doctest::Approx(80.0));
  settings.controller.safe.damping = Vector6<double>::Constant(-1.0);
  CHECK(is_about(refusal([&] { loop_parameters<Hybrid>(settings); }), "controller.safe.damping"));
}

TEST_CASE("the brake is critically damped wherever the centre of mass is") {
  // Of a platform whose brake had only the diagonal of the inertia, 2 w T_c would be 2.7 times too large for one
  // motion.
  auto settings = corner<Composite>(0.0, 0.0);
  settings.uncertainty = {};
  settings.simulation.step = settings.camera.period = 2 * kMs;
  const Vector3<double> centre(0.02, -0.03, 0.08);
  settings.robot.centre_of_mass = centre;
  settings.robot.inertia += displaced_inertia(settings.robot.mass, centre);
  settings.robot.gravity.setZero();
  settings.camera.dropout = 1.0;  // no image ever
  settings.simulation.start.twist = linear_angular<double>(2e-5, -1e-4);
  const LoopParameters<double, Composite> p = loop_parameters<Composite>(settings);
  SampledLoop<double, Composite> loop(p);
  const double w = 0.5 * p.safe.damping_rate;
  CHECK(w == doctest::Approx(100.0));
  // x = v0 t e^(-wt) of each component; the wrench that is held for T_c is late by half of it, a share of w T_c.
  const double peak = settings.simulation.start.twist.norm() / w * std::exp(-1.0);
  double farthest = 0.0;
  while (loop.time() < 0.3) {
    const auto& sample = loop.record().sample();
    const double t = loop.time();
    const Vector6<double> away =
        pose_difference(Pose<double>{sample.position, sample.quaternion}, home_pose(p.hexapod));
    const Vector6<double> expected = t * std::exp(-w * t) * settings.simulation.start.twist;
    farthest = std::max(farthest, away.norm());
    REQUIRE((away - expected).norm() <= 0.25 * peak);
    loop.advance();
    REQUIRE(loop.record().running());
  }
  MESSAGE("farthest " << farthest / peak << " of a critically damped response");
  CHECK(farthest == doctest::Approx(peak).epsilon(0.25));
  CHECK(loop.record().sample().twist.norm() <= 1e-9);
}

TEST_CASE("coupled implicit switching stops every platform; axis by axis it stops those of a diagonal inertia") {
  const auto late_speed = [](const Settings& s) {
    const LoopParameters<double, Hybrid> p = loop_parameters<Hybrid>(s);
    SampledLoop<double, Hybrid> loop(p);
    double largest = 0.0;
    for (long long i = 0; i < step_count(s.simulation); ++i) {
      loop.advance();
      REQUIRE(loop.record().running());
      if (i >= step_count(s.simulation) - 100)
        largest = std::max(largest, loop.record().sample().twist.cwiseAbs().maxCoeff());
    }
    return largest;
  };
  const auto turned = [](const Vector3<double>& principal, const Vector3<double>& rotation) {
    const Matrix3<double> R = Eigen::AngleAxisd(rotation.norm(), rotation.normalized()).toRotationMatrix();
    return Matrix3<double>(R * principal.asDiagonal() * R.transpose());
  };
  auto settings = corner<Hybrid>(0.0, 0.0);
  settings.uncertainty = {};
  settings.robot.gravity.setZero();
  settings.simulation.duration = 1.0;
  auto& gains = settings.gains<Hybrid>();
  settings.target.desired_features = settings.target.initial_features;
  gains.fuzzy.enabled = false;
  gains.kv = linear_angular<double>(0.1, 1e-3);
  settings.simulation.start.twist << 1e-3, -2e-3, 1e-3, 5e-3, -8e-3, 6e-3;
  auto tube = settings, skew = settings, heavy = settings;
  tube.robot.inertia = turned({0.5e-4, 2e-4, 2e-4}, {0.0, std::numbers::pi / 4.0, 0.0});
  skew.robot.inertia = turned({0.04e-4, 2e-4, 2e-4}, {0.6, 0.5, 0.4});
  heavy.robot.centre_of_mass = {0.02, 0.0, 0.06};
  heavy.robot.inertia += displaced_inertia(heavy.robot.mass, heavy.robot.centre_of_mass);
  CHECK(late_speed(settings) <= 1e-12);
  for (Settings of : {settings, tube, skew, heavy}) {
    of.controller.switching.kind = SwitchingKind::implicit_coupled;
    CHECK(late_speed(of) <= 1e-12);
  }
  CHECK(late_speed(tube) >= 1e-3);  // what `hexservo check` warns of
}

TEST_CASE("lanes run as their single runs do, each with its own seed and camera") {
  using S = Lanes<4>;
  LoopParameters<S, Composite> pack;
  std::vector<LoopParameters<double, Composite>> single;
  for (int lane = 0; lane < 4; ++lane) {
    auto settings = corner<Composite>(0.075, 0.3);
    settings.controller.switching.kind = lane < 4 ? SwitchingKind::implicit_coupled : SwitchingKind::sign;
    settings.seed = 40 + static_cast<std::uint64_t>(lane);
    settings.camera.period = 5 * kMs;
    settings.camera.latency = 8 * kMs;
    settings.camera.latency_jitter = 3 * kMs;
    settings.camera.noise = 0.1 * lane;
    settings.camera.dropout = 0.1 * lane;
    settings.camera.outlier_probability = 0.05 * lane;
    settings.camera.outlier_size = 1.0;
    settings.camera.quantisation = 0.01 * lane;
    settings.camera.image_size = {150.0, 130.0};  // two points start outside
    settings.camera.on_lost = LostFeature::predict;
    settings.camera.timeout = 20 * kMs;  // two lost frames, and a lane brakes while others go on
    single.push_back(loop_parameters<Composite>(settings));
    set_lane(pack, lane, single.back());
  }
  SampledLoop<S, Composite> lanes(pack);
  for (int i = 0; i < 300; ++i) lanes.advance();
  for (int lane = 0; lane < 4; ++lane) {
    CAPTURE(lane);
    SampledLoop<double, Composite> loop(single[static_cast<std::size_t>(lane)]);
    for (int i = 0; i < 300; ++i) loop.advance();
    CHECK(lanes.record().running()[lane] == loop.record().running());
    CHECK(distance(lane_of(lanes.record().sample().feature_error, lane), loop.record().sample().feature_error) <= 1e-8);
    CHECK(distance(lane_of(lanes.record().sample().wrench, lane), loop.record().sample().wrench) <= 1e-9);
  }
}

TEST_CASE("times that are not on the grid of the ticks are refused, with the nearest ones") {
  const auto refused = [](auto&& change) {
    auto settings = corner<Hybrid>(0.0, 0.3);
    change(settings);
    return refusal([&] { loop_parameters<Hybrid>(settings); });
  };
  const std::string latency = refused([](auto& s) { s.camera.latency = 2.4e-3; });
  CHECK(is_about(latency, "camera.latency"));
  CHECK(latency.find("nearest: 0.002 or 0.003") != std::string::npos);
  CHECK(is_about(refused([](auto& s) { s.camera.period = 0.4e-3; }), "camera.period"));
  CHECK(refused([](auto& s) { s.camera.period = 0.4e-3; }).find("nearest: 0.001") != std::string::npos);
  CHECK(is_about(refused([](auto& s) { s.camera.latency_jitter = -1e-3; }), "camera.latency_jitter"));
  CHECK(is_about(refused([](auto& s) { s.camera.noise = kNaN; }), "camera.noise"));
  CHECK(is_about(refused([](auto& s) { s.camera.dropout = 1.1; }), "camera.dropout"));
  CHECK(is_about(refused([](auto& s) { s.camera.image_size(1) = 0.0; }), "camera.image_size[1]"));
  CHECK(is_about(refused([](auto& s) { s.simulation.substeps = 0; }), "simulation.substeps"));
  CHECK(is_about(refused([](auto& s) {
                   s.camera.convention = CameraConvention::as_printed;
                   s.camera.prediction = Prediction::encoder;
                 }),
                 "camera.convention"));
  CHECK(is_about(refused([](auto& s) { s.simulation.mode = LoopMode::continuous; }), "controller.switching.kind"));
}
