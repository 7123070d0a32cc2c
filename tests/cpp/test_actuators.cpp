// Actuators: nothing where nothing is asked for, and each of their faults as it is defined.
#include "hexservo/actuators.hpp"

#include "allocations.hpp"
#include "compare.hpp"
#include "random.hpp"

#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

constexpr double kTick = 1e-3;  // [s]

struct Place {
  explicit Place(const Pose<double>& pose, const std::string& preset = "micro")
      : hexapod(make_hexapod(robot_preset(preset))),
        legs(inverse_kinematics(hexapod, pose.position, rotation_matrix(pose.quaternion))),
        solver(hexapod, legs) {}

  Hexapod<double> hexapod;
  Legs<double> legs;
  WrenchMapSolver<double> solver;
};

/// Somewhere off home.
Place place() { return Place({Vector3<double>(0.004, -0.003, -0.152), {0.999, 0.02, -0.03, 0.01}}); }

const Vector6<double> kResting = Vector6<double>::Constant(-0.13);

Actuation<double> step(Actuators<double>& actuators, const Place& at, const Vector6<double>& wrench) {
  return actuators.step(wrench, at.solver.leg_forces(wrench), at.legs);
}

}  // namespace

TEST_CASE("with everything off the wrench passes bit for bit") {
  Random random(7501);
  CAPTURE(random.seed());
  const Place at = place();
  for (const bool saturation : {false, true}) {  // a limit that nothing reaches is no limit
    Actuators<double> actuators({{.saturation = saturation}, 0}, 1e3, kTick, kResting);
    for (int trial = 0; trial < 100; ++trial) {
      const Vector6<double> wrench = random.six(1.0, 0.1);
      const Actuation<double> out = step(actuators, at, wrench);
      CHECK(distance(out.wrench, wrench) == 0.0);
      CHECK(distance(out.leg_forces, at.solver.leg_forces(wrench)) == 0.0);
      CHECK_FALSE(out.saturated);
    }
  }
}

TEST_CASE("before the first command arrives drives hold the platform with what they have, and lag from there on") {
  const Place at = place();
  const double limit = 0.1, bandwidth = 10.0;  // of the 0.13 N of `kResting`
  Actuators<double> actuators({{.saturation = true, .bandwidth = bandwidth}, 2}, limit, kTick, kResting);
  double level = -limit;
  for (int tick = 0; tick < 20; ++tick) {
    const double arrived = tick < 2 ? -limit : 0.0, ticks = 6.283185307179586 * bandwidth * kTick;
    const double mean = arrived + (level - arrived) * -std::expm1(-ticks) / ticks;
    const Actuation<double> out = actuators.step(Vector6<double>::Zero(), Vector6<double>::Zero(), at.legs);
    CHECK(distance(out.leg_forces, Vector6<double>::Constant(mean)) <= 1e-15);
    level = arrived + (level - arrived) * std::exp(-ticks);
  }
}

TEST_CASE("holding leg forces, they and their wrench belong together") {
  Random random(7502);
  CAPTURE(random.seed());
  const Place at = place();
  Actuators<double> actuators({{.hold = ActuatorHold::leg_forces}, 0}, 1.0, kTick, kResting);
  const Vector6<double> wrench = random.six(1.0, 0.1);
  const Actuation<double> out = step(actuators, at, wrench);
  CHECK(distance(out.leg_forces, at.solver.leg_forces(wrench)) == 0.0);
  CHECK(distance(out.wrench, at.legs.wrench(out.leg_forces)) == 0.0);
  CHECK(distance(out.wrench, wrench) <= 1000.0 * kEpsilon);
}

TEST_CASE("saturation is never exceeded, cuts leg by leg, and is reported exactly where a command is beyond it") {
  Random random(7503);
  CAPTURE(random.seed());
  const Place at = place();
  constexpr double kLimit = 0.99;
  int saturated = 0;
  for (const double bandwidth : {kInfinity, 2000.0, 20.0})
    for (const double quantisation : {0.0, 0.5}) {  // a rounded 0.99 would be 1
      CAPTURE(bandwidth);
      CAPTURE(quantisation);
      Actuators<double> actuators({{.saturation = true, .bandwidth = bandwidth, .quantisation = quantisation}, 0},
                                  kLimit, kTick, kResting);
      for (int trial = 0; trial < 300; ++trial) {
        const Vector6<double> wrench = random.six(2.0, 0.2), command = at.solver.leg_forces(wrench);
        const Actuation<double> out = step(actuators, at, wrench);
        REQUIRE(out.leg_forces.cwiseAbs().maxCoeff() <= kLimit);
        CHECK(out.saturated == (command.cwiseAbs().maxCoeff() > kLimit));
        saturated += out.saturated ? 1 : 0;
        if (bandwidth != kInfinity || quantisation > 0.0) continue;
        CHECK(distance(out.leg_forces, command.cwiseMax(-kLimit).cwiseMin(kLimit)) == 0.0);
        if (out.saturated) CHECK(distance(out.wrench, at.legs.wrench(out.leg_forces)) == 0.0);
      }
    }
  CHECK(saturated > 100);
  CHECK(saturated < 1700);
}

TEST_CASE("quantised leg forces are multiples, at most half a step off") {
  Random random(7504);
  CAPTURE(random.seed());
  const Place at = place();
  constexpr double kStep = 0.01;
  Actuators<double> actuators({{.quantisation = kStep}, 0}, 1.0, kTick, kResting);
  for (int trial = 0; trial < 100; ++trial) {
    const Vector6<double> wrench = random.six(1.0, 0.1);
    const Actuation<double> out = step(actuators, at, wrench);
    CHECK(distance(out.leg_forces, at.solver.leg_forces(wrench)) <= 0.5 * kStep * (1.0 + 1e-12));
    for (int i = 0; i < 6; ++i) CHECK(out.leg_forces(i) == kStep * std::nearbyint(out.leg_forces(i) / kStep));
    CHECK(distance(out.wrench, at.legs.wrench(out.leg_forces)) == 0.0);
  }
}

TEST_CASE("a delay shifts the leg forces by its ticks; before the first command the resting forces act") {
  Random random(7505);
  CAPTURE(random.seed());
  const Place at = place();
  for (long long delay = 0; delay <= kMaxActuatorDelay; ++delay) {
    CAPTURE(delay);
    Actuators<double> actuators({{.saturation = true}, delay}, 0.5, kTick, kResting);
    std::vector<Vector6<double>> commands;
    for (long long tick = 0; tick < 40; ++tick) {
      const Vector6<double> wrench = random.six(1.0, 0.1), command = at.solver.leg_forces(wrench);
      commands.push_back(command.cwiseMax(-0.5).cwiseMin(0.5));
      const Actuation<double> out = step(actuators, at, wrench);
      const Vector6<double> expected = tick < delay ? kResting : commands[static_cast<std::size_t>(tick - delay)];
      CHECK(distance(out.leg_forces, expected) == 0.0);
      CHECK(out.saturated == (command.cwiseAbs().maxCoeff() > 0.5));  // of the command of this tick
      if (delay > 0) CHECK(distance(out.wrench, at.legs.wrench(expected)) == 0.0);
    }
  }
}

TEST_CASE(
    "bandwidth: impulses of a step response are those of the exact lag, for any ratio of tick and time constant") {
  const Place at = place();
  const Vector6<double> wrench = (Vector6<double>() << 0.2, -0.1, -0.6, 0.01, 0.02, -0.01).finished();
  const Vector6<double> target = at.solver.leg_forces(wrench);
  for (const double bandwidth : {0.1, 10.0, 100.0, 1000.0, 1e5}) {
    CAPTURE(bandwidth);
    Actuators<double> actuators({{.bandwidth = bandwidth}, 0}, 1.0, kTick, kResting);
    const double omega = 6.283185307179586 * bandwidth;
    Vector6<double> impulse = Vector6<double>::Zero();
    for (int tick = 1; tick <= 100; ++tick) {
      const Actuation<double> out = step(actuators, at, wrench);
      impulse += kTick * out.leg_forces;
      // integral of target + (resting - target) exp(-omega t)
      const double t = tick * kTick;
      const Vector6<double> expected = target * t - (kResting - target) * std::expm1(-omega * t) / omega;
      CHECK(distance(impulse, expected) <= 1e-13 * t);
      CHECK(distance(out.wrench, at.legs.wrench(out.leg_forces)) == 0.0);
    }
  }
}

TEST_CASE("a pack of actuators acts as single ones do") {
  constexpr int kWidth = 4;
  using S = Lanes<kWidth>;
  Random random(7506);
  CAPTURE(random.seed());
  const Place at = place();
  Legs<S> legs;
  ActuatorParameters<S> parameters;
  S limit;
  Vector6<S> resting;
  std::vector<Actuators<double>> singles;
  for (int lane = 0; lane < kWidth; ++lane) {
    const ActuatorParameters<double> single{
        {.saturation = true, .bandwidth = lane == 1 ? 50.0 : kInfinity, .quantisation = lane == 2 ? 0.02 : 0.0}, 0};
    set_lane(parameters, lane, single);
    limit.set(lane, lane == 3 ? 0.3 : 1.0);
    set_lane(resting, lane, kResting);
    set_lane(legs.lengths, lane, at.legs.lengths);
    set_lane(legs.directions_B, lane, at.legs.directions_B);
    set_lane(legs.arms_B, lane, at.legs.arms_B);
    singles.emplace_back(single, lane == 3 ? 0.3 : 1.0, kTick, kResting);
  }
  Actuators<S> pack(parameters, limit, kTick, resting);
  for (int tick = 0; tick < 100; ++tick) {
    const Vector6<double> wrench = random.six(1.0, 0.1), forces = at.solver.leg_forces(wrench);
    const Vector6<S> wrenches = wrench.cast<S>(), commands = forces.cast<S>();
    const long long before = allocations;
    const Actuation<S> out = pack.step(wrenches, commands, legs);
    CHECK(allocations == before);
    for (int lane = 0; lane < kWidth; ++lane) {
      CAPTURE(lane);
      const Actuation<double> single = singles[static_cast<std::size_t>(lane)].step(wrench, forces, at.legs);
      CHECK(distance(lane_of(out.leg_forces, lane), single.leg_forces) <= kEpsilon);
      CHECK(distance(lane_of(out.wrench, lane), single.wrench) <= 10.0 * kEpsilon);
      CHECK(out.saturated[lane] == single.saturated);
      if (lane == 0 && !single.saturated) CHECK(distance(lane_of(out.wrench, lane), wrench) == 0.0);
    }
  }
}
