// What legs that take positions are commanded at most: rates that they can have, and places within their stroke.
#include "hexservo/motion_command.hpp"
#include "hexservo/servo.hpp"

#include "compare.hpp"
#include "random.hpp"
#include "scenarios.hpp"

using namespace hexservo;
using namespace hexservo::test;

namespace {

constexpr double kUnlimited = std::numeric_limits<double>::infinity();

/// Limits of the legs of the paper's machine, with ticks of 1 ms.
SafetyGains<double> limited(double fastest, double most) {
  const LoopParameters<double, Pbvs> p = loop_parameters<Pbvs>(paper_settings<Pbvs>());
  MotionGains<double> motion;
  motion.speed_limit = fastest;
  motion.acceleration_limit = most;
  return safety_gains<double, kPoints>(p, motion);
}

}  // namespace

TEST_CASE("rates are scaled together to the speed limit, and their change to that of the acceleration") {
  Random random(7701);
  CAPTURE(random.seed());
  const SafetyGains<double> fast = limited(0.02, kUnlimited), both = limited(0.02, 0.5);
  const Vector6<double> middle = fast.hexapod.mid_lengths, zero = Vector6<double>::Zero();
  for (int trial = 0; trial < 20; ++trial) {
    Vector6<double> wanted = random.six(1.0, 1.0);
    wanted *= 0.03 / wanted.cwiseAbs().maxCoeff();
    CHECK(distance(feasible_rates(fast, wanted, zero, middle), 2.0 / 3.0 * wanted) <= 1e-16);
    CHECK(distance(feasible_rates(fast, Vector6<double>(0.5 * wanted), zero, middle), 0.5 * wanted) == 0.0);
    Vector6<double> before = random.six(1.0, 1.0);
    before *= 0.015 / before.cwiseAbs().maxCoeff();
    const Vector6<double> change = 2.0 / 3.0 * wanted - before;
    const double share = 0.5 * both.period / change.cwiseAbs().maxCoeff();
    REQUIRE(share < 1.0);
    CHECK(distance(feasible_rates(both, wanted, before, middle), before + share * change) <= 1e-16);
  }
}

TEST_CASE("a leg near an end of its stroke is no faster than it can be stopped there, and beyond it comes back") {
  const double fastest = 0.02, most = 0.5;
  const SafetyGains<double> gains = limited(fastest, most);
  const double stroke = gains.hexapod.stroke;
  for (const double side : {-1.0, 1.0})
    for (const double room : {-1e-3, -1e-5, 0.0, 1e-9, 1e-6, 1e-5, 1e-4, 1e-3}) {
      CAPTURE(side);
      CAPTURE(room);
      Vector6<double> legs = gains.hexapod.mid_lengths, outwards = Vector6<double>::Constant(0.01);
      legs(2) += side * (stroke - room);
      outwards(2) = side * fastest;
      const double way = std::abs(room), bound = std::min({way / gains.period, std::sqrt(2.0 * most * way), fastest});
      const Vector6<double> rates = feasible_rates(gains, outwards, outwards, legs);
      CHECK(rates(2) == doctest::Approx(side * std::copysign(bound, room)).epsilon(1e-6));
      for (const int other : {0, 1, 3, 4, 5}) CHECK(rates(other) == 0.01);
      const Vector6<double> inwards = -outwards;
      CHECK(feasible_rates(gains, inwards, inwards, legs)(2) == -side * fastest);
    }
}

TEST_CASE("commands end within the stroke, and a leg that is held beyond it goes no further and does not jump") {
  const SafetyGains<double> gains = limited(kUnlimited, kUnlimited);
  const Hexapod<double>& hexapod = gains.hexapod;
  const Vector6<double> middle = hexapod.mid_lengths, way = Vector6<double>::Constant(hexapod.stroke);
  for (const double side : {-1.0, 1.0}) {
    const Vector6<double> beyond = middle + 1.1 * side * way, far = middle + 1.2 * side * way,
                          inside = middle + 0.3 * side * way;
    const Vector6<double> end = within_stroke(hexapod, middle, far);
    CHECK(leg_travel<double>(end, middle, hexapod.stroke).cwiseAbs().maxCoeff() < hexapod.stroke);
    CHECK(distance(end, middle + side * way) <= 1e-8 * hexapod.stroke);
    CHECK(distance(within_stroke(hexapod, middle, inside), inside) == 0.0);
    CHECK(distance(within_stroke(hexapod, beyond, far), beyond) == 0.0);
    CHECK(distance(within_stroke(hexapod, beyond, Vector6<double>(middle + 1.05 * side * way)),
                   middle + 1.05 * side * way) == 0.0);
    CHECK(distance(within_stroke(hexapod, beyond, inside), inside) == 0.0);
  }
}

TEST_CASE("the wrench of a tick moves the virtual platform as it moves, and none does where a point is behind it") {
  Settings settings = paper_settings();
  settings.simulation.mode = LoopMode::sampled;
  settings.actuators.kind = ActuatorKind::position;
  const LoopParameters<double, Hybrid> p = loop_parameters<Hybrid>(settings);
  const SafetyGains<double> gains = safety_gains<double, kPoints>(p, motion_gains(p));
  SafetyState<double> state(gains);
  SensorInput<double> input;
  input.pose = home_pose(p.hexapod);
  input.twist.setZero();
  input.frame.exposure = 0.0;
  input.frame.image = World<double>(p).start(p).view.image;
  state.perception.update(gains, input);
  see_from_command(gains, state);
  REQUIRE(state.carried.ready());
  const Vector6<double> weight = gravity_wrench(gains.body), wrench = weight + linear_angular<double>(0.1, 1e-3);
  Command<double> out;
  command_motion(gains, state, wrench, out);
  REQUIRE(out.acts);
  CHECK(distance(out.wrench, wrench) <= 0.02 * (wrench - weight).norm());  // its damping over a tick
  state.motion.pose.position(2) += 2.0 * input.frame.image.depth(0);       // beyond the target
  see_from_command(gains, state);
  CHECK_FALSE(state.carried.ready());
}
