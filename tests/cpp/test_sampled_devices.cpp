// Sensors, actuators and base of the sampled loop, each where it acts.
#include "hexservo/settings.hpp"
#include "hexservo/simulation.hpp"

#include "compare.hpp"
#include "random.hpp"
#include "scenarios.hpp"

#include <functional>
#include <memory>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

constexpr double kTick = 1e-3;  // [s]
constexpr double kTwoPi = 6.283185307179586;

/// The paper's scenario without errors, sampled; ready to be changed.
Settings sampled() {
  Settings settings = nominal_settings();
  settings.simulation.mode = LoopMode::sampled;
  settings.controller.switching.kind = SwitchingKind::implicit;
  return settings;
}

/// A plant that a test drives, tick by tick.
struct Driven {
  explicit Driven(const Settings& settings) : parameters(loop_parameters<Hybrid>(settings)), plant(parameters) {}

  /// @return whether it goes on
  bool tick(const Vector6<double>& wrench) {
    plant.command(wrench);
    return plant.advance();
  }
  const Sample<double>& sample() const { return plant.record().sample(); }
  Vector6<double> weight() const { return gravity_wrench(parameters.body); }
  Legs<double> legs() const {
    return inverse_kinematics(parameters.hexapod, sample().position, rotation_matrix(sample().quaternion));
  }

  LoopParameters<double, Hybrid> parameters;
  CommandedPlant<double> plant;
};

/// The loop after a time, or where it stopped.
std::unique_ptr<SampledLoop<double, Hybrid>> run(const LoopParameters<double, Hybrid>& parameters, double duration) {
  auto loop = std::make_unique<SampledLoop<double, Hybrid>>(parameters);
  while (loop->time() < duration - 0.5 * kTick && loop->record().running()) loop->advance();
  return loop;
}

}  // namespace

TEST_CASE("a free platform accelerates by -a under a sinusoid of the base, whatever its mass") {
  for (const double mass_error : {0.0, 0.3}) {
    for (const long long substeps : {1, 4}) {
      CAPTURE(mass_error);
      CAPTURE(substeps);
      Settings settings = sampled();
      settings.uncertainty.inertia.setConstant(mass_error);
      settings.simulation.substeps = substeps;
      auto& motion = settings.base_motion;
      motion.kind = BaseMotionKind::sinusoid;
      motion.amplitude << 0.5, -0.2, 0.3;
      motion.frequency = 3.0;
      motion.phase = 0.4;
      Driven driven(settings);
      for (int tick = 0; tick < 400; ++tick) REQUIRE(driven.tick(driven.weight()));
      driven.plant.command(driven.weight());
      const double t = driven.plant.plant().time(), omega = kTwoPi * motion.frequency;
      // twice the integral of -A sin(omega t + phase), from rest
      const double speed = (std::cos(omega * t + motion.phase) - std::cos(motion.phase)) / omega;
      const double way = (std::sin(omega * t + motion.phase) - std::sin(motion.phase)) / (omega * omega) -
                         std::cos(motion.phase) * t / omega;
      // Simpson's rule in each step: t/2880 A omega^4 h^4 = 1e-11 for the speed
      CHECK(distance(driven.sample().twist.head<3>(), motion.amplitude * speed) <= 1e-10);
      CHECK(distance(driven.sample().position, driven.parameters.hexapod.home_position + motion.amplitude * way) <=
            1e-10);
      CHECK(driven.sample().twist.tail<3>().norm() <= 1e-15);
    }
  }
}

TEST_CASE("a recorded base is the same for every step of the integration, and ends with its samples") {
  Settings settings = sampled();
  settings.base_motion.kind = BaseMotionKind::recorded;
  settings.base_motion.samples =
      std::make_shared<const std::vector<double>>(std::vector<double>{0.0, 0.1, -0.2, 0.3, 0.1, 0.2, 0.0, 0.0, 0.0});
  settings.base_motion.sample_period = 0.05;
  Driven driven(settings);
  for (int tick = 0; tick < 150; ++tick) REQUIRE(driven.tick(driven.weight()));
  driven.plant.command(driven.weight());
  // integrals of the straight lines: trapezoids; nothing moves the platform after 0.1 s
  CHECK(distance(driven.sample().twist.head<3>(), -0.05 * Vector3<double>(0.3, 0.15, 0.1)) <= 1e-14);
}

TEST_CASE("leg forces that hold are those of a platform under constant leg forces") {
  Settings settings = sampled();
  settings.actuators.hold = ActuatorHold::leg_forces;
  Driven driven(settings), wrench_held(sampled());
  const Vector6<double> forces = (Vector6<double>() << -0.13, -0.15, -0.12, -0.14, -0.135, -0.125).finished();
  for (int tick = 0; tick < 100; ++tick) {
    const auto& seen = driven.plant.observe();
    const Legs<double> legs = inverse_kinematics(driven.parameters.hexapod, seen.pose.position, seen.R_BE);
    REQUIRE(driven.tick(legs.wrench(forces)));
    CHECK(distance(driven.sample().leg_forces, forces) <= 1e-14);
    REQUIRE(wrench_held.tick(wrench_held.legs().wrench(forces)));
  }
  driven.plant.command(driven.weight());
  wrench_held.plant.command(driven.weight());
  const LoopParameters<double, Hybrid>& p = driven.parameters;
  const BodyState<double> expected =
      drive_legs(p.hexapod, p.body, p.dynamics_error, body_state<double>(home_pose(p.hexapod), Vector6<double>::Zero()),
                 forces, kTick, 100);
  CHECK(distance(driven.sample().position, position_of(expected)) <= 1e-13);
  CHECK(distance(driven.sample().twist, twist_of(expected)) <= 1e-12);
  CHECK(distance(wrench_held.sample().twist, twist_of(expected)) >= 1e-6);  // the wrench turns with the legs
}

TEST_CASE("a delay of some ticks shifts what acts; before that the platform is held at rest") {
  Random random(7701);
  CAPTURE(random.seed());
  for (const int delay : {1, 3}) {
    CAPTURE(delay);
    Settings settings = sampled();
    settings.actuators.delay = delay * kTick;
    Driven driven(settings);
    std::vector<Vector6<double>> asked;
    for (int tick = 0; tick < 30; ++tick) {
      const auto& seen = driven.plant.observe();
      const Legs<double> legs = inverse_kinematics(driven.parameters.hexapod, seen.pose.position, seen.R_BE);
      const Vector6<double> wrench = driven.weight() + random.six(1e-2, 1e-3);
      asked.push_back(WrenchMapSolver<double>(driven.parameters.hexapod, legs).leg_forces(wrench));
      driven.plant.command(wrench);
      if (tick >= delay)
        CHECK(distance(driven.sample().leg_forces, asked[static_cast<std::size_t>(tick - delay)]) <= 1e-15);
      else
        CHECK(distance(driven.sample().wrench, driven.weight()) <= 1e-15);
      CHECK(distance(driven.sample().wrench, legs.wrench(driven.sample().leg_forces)) <= 1e-15);
      REQUIRE(driven.plant.advance());
    }
  }
}

TEST_CASE("saturated leg forces stay within the limit, and the weights wait") {
  Settings settings = sampled();
  settings.actuators.saturation = true;
  settings.robot.force_limit = 0.14;  // 0.1337 N hold the platform
  const LoopParameters<double, Hybrid> tight = loop_parameters<Hybrid>(settings);
  const auto limited = run(tight, 1.0);
  REQUIRE(limited->record().running());
  CHECK(limited->record().metrics().metrics().peak_leg_force <= 0.14);
  settings.actuators.saturation = false;
  const LoopParameters<double, Hybrid> open = loop_parameters<Hybrid>(settings);
  const auto unlimited = run(open, 1.0);
  CHECK(unlimited->record().metrics().metrics().peak_leg_force > 0.15);

  settings.actuators.saturation = true;
  settings.robot.force_limit = 0.13;  // never enough: nothing may be learned
  const LoopParameters<double, Hybrid> weak = loop_parameters<Hybrid>(settings);
  const auto falling = run(weak, 0.05);
  double learned = 0.0, forbidden = 0.0;
  for (int r = 0; r < kTerms * kTerms; ++r)
    for (int axis = 0; axis < kAxes; ++axis) {
      learned = std::max(learned, std::abs(limited->law_state()[static_cast<std::size_t>(r)](axis)));
      forbidden = std::max(forbidden, std::abs(falling->law_state()[static_cast<std::size_t>(r)](axis)));
    }
  CHECK(learned > 0.0);
  CHECK(forbidden == 0.0);
  CHECK(falling->record().sample().twist(2) > 0.01);  // it sinks
}

TEST_CASE("the wrench of motors is the mean of a tick, and moves the platform; leg forces are those after a command") {
  Random random(7703);
  CAPTURE(random.seed());
  for (const bool moving : {false, true}) {
    Settings settings = sampled();
    settings.actuators.kind = ActuatorKind::position_torque;
    settings.actuators.motor.kp = 2e4;  // a step of the command is made up for within a tick
    settings.actuators.motor.kv = 60.0;
    settings.actuators.motor.friction = 0.02;
    settings.actuators.motor.armature = 0.01;
    settings.simulation.substeps = 10;
    settings.robot.force_limit = 5.0;
    if (moving) {
      settings.base_motion.kind = BaseMotionKind::sinusoid;
      settings.base_motion.amplitude << 0.5, -0.3, 0.4;
    }
    Driven driven(settings);
    Vector6<double> wanted = driven.plant.plant().leg_positions();
    const Vector6<double> home = wanted;
    double gross = 0.0, crest = 0.0;
    for (int tick = 0; tick < 30; ++tick) {
      wanted = home + random.six(1e-4, 1e-4);
      driven.plant.position(wanted);
      const Sample<double> before = driven.sample();
      const Vector6<double> given = settings.actuators.motor.kp * (wanted - before.leg_lengths) -
                                    settings.actuators.motor.kv * driven.legs().rates(before.twist);
      CHECK(distance(before.leg_forces, given) <= 1e-9);
      const double time = driven.plant.plant().time();
      REQUIRE(driven.plant.advance());
      const Vector6<double> after = driven.plant.observe().twist;
      const Matrix3<double> R_BE = rotation_matrix(before.quaternion);
      const RigidBody<double>& body = driven.parameters.body;
      Vector6<double> needed = mass_matrix(body, R_BE) * (after - before.twist) / kTick +
                               coriolis_matrix(body, R_BE, before.twist) * before.twist + gravity_wrench(body, R_BE);
      if (moving)
        needed.head<3>() +=
            body.mass * settings.base_motion.amplitude * std::sin(kTwoPi * settings.base_motion.frequency * time);
      CHECK(distance(before.wrench, needed) <= 1e-9);
      gross = std::max(gross, (before.wrench - gravity_wrench(body)).norm());
      crest = std::max(crest, (driven.legs().wrench(before.leg_forces) - gravity_wrench(body)).norm());
    }
    CHECK(crest > 2.0 * gross);
  }
}

TEST_CASE("a leg beyond its stroke ends the run if so configured, with the leg and the time that are reported") {
  Settings settings = sampled();
  const Vector6<double> push = (Vector6<double>() << 0.1, 0.05, 0.02, 0.0, 0.0, 0.0).finished();
  Driven reporting(settings);
  settings.robot.on_limit = LimitPolicy::stop;
  Driven stopping(settings);
  int ticks = 0;
  while (ticks < 1000 && stopping.tick(stopping.weight() + push)) {
    REQUIRE(reporting.tick(reporting.weight() + push));
    ++ticks;
    stopping.plant.command(stopping.weight() + push);
    if (!stopping.plant.record().running()) break;
  }
  for (int i = 0; i < 2; ++i) REQUIRE(reporting.tick(reporting.weight() + push));
  const LoopRecord<double>& record = stopping.plant.record();
  REQUIRE(record.cause() == static_cast<double>(StopCause::leg_limit));
  const auto leg = static_cast<int>(record.limit_leg());
  REQUIRE(leg >= 0);
  const LegLimitMonitor<double>& stroke = reporting.plant.record().metrics().stroke();
  CHECK(stroke.first_time(leg) == doctest::Approx(stopping.plant.plant().time()).epsilon(1e-12));
  CHECK(stroke.first_time.minCoeff() == stroke.first_time(leg));
  // the last good sample is within the stroke, one tick before
  const Hexapod<double>& hexapod = stopping.parameters.hexapod;
  CHECK(distance(stopping.sample().leg_lengths, hexapod.home_lengths) <= hexapod.stroke);
  CHECK(record.sample_time() == doctest::Approx(stopping.plant.plant().time() - kTick).epsilon(1e-9));
  CHECK(reporting.plant.record().running());
  CHECK(reporting.plant.record().limit_leg() == -1.0);
}

TEST_CASE("at every tick the image is that of the target where it then is, whatever drives the platform") {
  for (const ActuatorKind kind : {ActuatorKind::force, ActuatorKind::position, ActuatorKind::position_torque}) {
    CAPTURE(static_cast<int>(kind));
    Settings settings = sampled();
    settings.actuators.kind = kind;
    settings.simulation.substeps = 4;
    LoopParameters<double, Hybrid> p = loop_parameters<Hybrid>(settings);
    const Vector3<double> velocity(0.05, -0.02, 0.03);
    p.target_motion = {.kind = TargetMotionKind::velocity, .velocity = velocity};
    SampledLoop<double, Hybrid> loop(p);
    for (int tick = 0; tick < 5; ++tick) {
      const Sample<double>& sample = loop.record().sample();
      const Eigen::Matrix<double, 3, 4> points = p.points_T.colwise() + loop.time() * velocity;
      const Image<double> image = take_image<double, 4>(CameraView<double>(p.camera.focal), sample.position,
                                                        rotation_matrix(sample.quaternion), points);
      CHECK(distance(p.desired_features - sample.feature_error, image.features) <= 1e-10);
      loop.advance();
      REQUIRE(loop.record().running());
    }
  }
}

TEST_CASE("the first cause ends a run; of several at one instant the first of the list, and the leg farthest beyond") {
  Settings settings = sampled();
  settings.robot.on_limit = LimitPolicy::stop;
  const LoopParameters<double, Hybrid> p = loop_parameters<Hybrid>(settings);
  const WorldState<double> state = World<double>(p).start(p);
  const Vector6<double> home = p.hexapod.home_lengths, zero = Vector6<double>::Zero(),
                        unknown = Vector6<double>::Constant(kNaN);
  Vector6<double> beyond = home;
  beyond(1) += p.hexapod.stroke + 1e-3;
  beyond(4) -= p.hexapod.stroke + 3e-3;
  struct Case {
    Vector6<double> lengths;
    bool singular;
    Vector6<double> forces;  // of a singular pose without meaning
    bool unsensed;
    StopCause cause;
  };
  for (const Case& c : std::initializer_list<Case>{{home, false, zero, false, StopCause::none},
                                                   {beyond, false, unknown, true, StopCause::not_finite},
                                                   {beyond, true, unknown, true, StopCause::leg_limit},
                                                   {home, true, unknown, true, StopCause::singular},
                                                   {home, false, zero, true, StopCause::solver_failed}}) {
    CAPTURE(static_cast<int>(c.cause));
    LoopRecord<double> record(p, state);
    record.accept(0.001, state, home, false, zero, zero, zero, false);
    record.judge(state, -1e-9);
    record.accept(0.002, state, c.lengths, c.singular, zero, c.forces, zero, c.unsensed);
    CHECK(record.cause() == static_cast<double>(c.cause));
    CHECK(record.sample_time() == (c.cause == StopCause::none ? 0.002 : 0.001));
    if (c.cause == StopCause::none) {
      record.judge(state, 0.0);  // a point in the plane of the camera
      CHECK(record.cause() == static_cast<double>(StopCause::behind_camera));
      continue;
    }
    const bool limit = c.cause == StopCause::leg_limit;
    record.accept(0.003, state, home + (beyond - home).reverse(), false, zero, zero, zero, false);
    CHECK(record.cause() == static_cast<double>(c.cause));
    CHECK(record.limit_leg() == (limit ? 4.0 : -1.0));
    CHECK(record.limit_value() == doctest::Approx(limit ? p.hexapod.stroke + 3e-3 : 0.0).epsilon(1e-12));
  }
}

TEST_CASE("ideal encoders with true rates change nothing; differences delay, and noise disturbs") {
  Settings settings = sampled();
  settings.uncertainty = paper_settings().uncertainty;
  const LoopParameters<double, Hybrid> truth = loop_parameters<Hybrid>(settings);
  settings.sensors.pose = PoseSource::encoders;
  settings.sensors.rate = RateSource::true_rates;
  const LoopParameters<double, Hybrid> ideal = loop_parameters<Hybrid>(settings);
  const auto a = run(truth, 0.3), b = run(ideal, 0.3);
  REQUIRE(b->record().running());
  // what the two poses differ by, 1e-15 m and rad, through 300 ticks of a loop that damps
  CHECK(distance(a->record().sample().position, b->record().sample().position) <= 1e-11);
  CHECK(distance(a->record().sample().feature_error, b->record().sample().feature_error) <= 1e-7);
  settings.sensors.rate = RateSource::differences;
  const LoopParameters<double, Hybrid> late = loop_parameters<Hybrid>(settings);
  CHECK(distance(run(late, 0.05)->record().sample().position, run(truth, 0.05)->record().sample().position) > 1e-9);
}

TEST_CASE("encoders whose readings belong to no pose end the run") {
  Settings settings = sampled();
  settings.sensors.pose = PoseSource::encoders;
  settings.sensors.noise = 0.05;
  const auto verdict = [&] { return refusal([&] { loop_parameters<Hybrid>(settings); }); };
  bool refused = false;
  while (verdict() != "(accepted)" &&
         settings.seed < 100) {  // where the first reading is one of them, it does not start
    refused = true;
    CHECK(is_about(verdict(), "sensors"));
    ++settings.seed;
  }
  CHECK(refused);
  Driven driven(settings);
  int ticks = 0;
  while (ticks < 100 && driven.tick(driven.weight())) ++ticks;
  driven.plant.command(driven.weight());
  CHECK(driven.plant.record().cause() == static_cast<double>(StopCause::solver_failed));
  CHECK(outcome_of(StopCause::solver_failed) == Outcome::solver_failed);
  CHECK(describe(StopCause::leg_limit, 0.25, 2) == "leg 3 passed its stroke at t = 0.25 s");
}

TEST_CASE("a source of noise changes the numbers of no other") {
  Settings settings = sampled();
  settings.camera.noise = 0.5;
  Driven quiet(settings);
  settings.sensors.pose = PoseSource::encoders;
  settings.sensors.noise = 1e-6;
  Driven noisy(settings);
  settings.seed = 1;
  Driven other(settings);
  Random random(7702);
  CAPTURE(random.seed());
  for (int tick = 0; tick < 50; ++tick) {
    CHECK(distance(quiet.plant.observe().image.features, noisy.plant.observe().image.features) == 0.0);
    CHECK(distance(quiet.plant.observe().image.features, other.plant.observe().image.features) > 0.0);
    CHECK(distance(quiet.plant.observe().pose.position, noisy.plant.observe().pose.position) > 0.0);
    const Vector6<double> wrench = quiet.weight() + random.six(1e-2, 1e-3);
    REQUIRE(quiet.tick(wrench));
    REQUIRE(noisy.tick(wrench));
    REQUIRE(other.tick(wrench));
  }
}

TEST_CASE("a pack with devices runs as single loops do, each lane with its own numbers") {
  constexpr int kWidth = 4;
  using S = Lanes<kWidth>;
  std::vector<LoopParameters<double, Hybrid>> singles;
  LoopParameters<S, Hybrid> pack;
  for (int lane = 0; lane < kWidth; ++lane) {
    Settings settings = sampled();
    settings.controller.switching.kind = SwitchingKind::tanh;  // smooth: what rounding changes does not grow
    settings.controller.switching.width = 1e-2;
    settings.seed = static_cast<std::uint64_t>(lane);
    settings.sensors.pose = PoseSource::encoders;
    settings.sensors.noise = 1e-7 * lane;
    settings.actuators.hold = ActuatorHold::leg_forces;
    settings.actuators.saturation = true;
    settings.actuators.bandwidth = lane == 1 ? 200.0 : kInfinity;
    settings.actuators.delay = kTick;
    settings.base_motion.kind = BaseMotionKind::noise;
    settings.base_motion.level.setConstant(1e-4 * lane);
    settings.robot.force_limit = 0.2 + 0.1 * lane;
    singles.push_back(loop_parameters<Hybrid>(settings));
    set_lane(pack, lane, singles.back());
  }
  SampledLoop<S, Hybrid> together(pack);
  for (int tick = 0; tick < 100; ++tick) together.advance();
  for (int lane = 0; lane < kWidth; ++lane) {
    CAPTURE(lane);
    const auto alone = run(singles[static_cast<std::size_t>(lane)], 0.1);
    REQUIRE(alone->record().running());
    CHECK(lane_of(together.record().cause(), lane) == 0.0);
    CHECK(distance(lane_of(together.record().sample().position, lane), alone->record().sample().position) <= 1e-12);
    CHECK(distance(lane_of(together.record().sample().leg_forces, lane), alone->record().sample().leg_forces) <= 1e-9);
  }
}

TEST_CASE("settings of devices are refused with their key, the nearest valid times, and only where they act") {
  const auto verdict = [](const std::function<void(Settings&)>& change) {
    Settings settings = sampled();
    change(settings);
    return refusal([&] { loop_parameters<Hybrid>(settings); });
  };
  CHECK(is_about(verdict([](auto& s) { s.sensors.period = 2.5e-3; }), "sensors.period"));
  CHECK(verdict([](auto& s) { s.sensors.period = 2.5e-3; }).find("nearest: 0.002 or 0.003") != std::string::npos);
  CHECK(is_about(verdict([](auto& s) { s.sensors.resolution = -1.0; }), "sensors.resolution"));
  CHECK(is_about(verdict([](auto& s) { s.sensors.noise = kNaN; }), "sensors.noise"));
  CHECK(is_about(verdict([](auto& s) { s.actuators.delay = 1.5e-3; }), "actuators.delay"));
  CHECK(is_about(verdict([](auto& s) { s.actuators.delay = 9e-3; }), "actuators.delay"));
  CHECK(is_about(verdict([](auto& s) { s.actuators.bandwidth = 0.0; }), "actuators.bandwidth"));
  CHECK(is_about(verdict([](auto& s) { s.actuators.quantisation = -0.1; }), "actuators.quantisation"));
  const auto with_kind = [&](BaseMotionKind kind, const std::function<void(BaseMotionSettings&)>& change) {
    return verdict([&](auto& s) {
      s.base_motion.kind = kind;
      change(s.base_motion);
    });
  };
  using B = BaseMotionSettings;
  CHECK(is_about(with_kind(BaseMotionKind::sinusoid, [](B& b) { b.frequency = 600.0; }), "base_motion.frequency"));
  CHECK(is_about(with_kind(BaseMotionKind::sinusoid, [](B& b) { b.amplitude(1) = kNaN; }), "base_motion.amplitude[1]"));
  CHECK(is_about(with_kind(BaseMotionKind::recorded, [](B&) {}), "base_motion.samples"));
  CHECK(is_about(with_kind(BaseMotionKind::noise, [](B& b) { b.low_frequency = 10.0; }), "base_motion.low_frequency"));
  CHECK(
      is_about(with_kind(BaseMotionKind::noise, [](B& b) { b.high_frequency = 501.0; }), "base_motion.high_frequency"));
  CHECK(is_about(with_kind(BaseMotionKind::noise, [](B& b) { b.level(2) = -1.0; }), "base_motion.level[2]"));
  Settings continuous = nominal_settings();
  continuous.sensors.period = 2.5e-3;
  CHECK(refusal([&] { loop_parameters<Hybrid>(continuous); }) == "(accepted)");
}
