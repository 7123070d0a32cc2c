// Legs that take positions: their response against the matrix exponential, its limits, and what turns carry into them.
#include "hexservo/position_actuators.hpp"

#include "compare.hpp"
#include "random.hpp"

#include <unsupported/Eigen/MatrixFunctions>

#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

constexpr double kStep = 1e-3;  // [s], of the loop
constexpr double kTurn = 6.283185307179586;

ActuatorParameters<double> parameters(const PositionResponse<double>& response, long long delay = 0,
                                      double step = kStep) {
  ActuatorParameters<double> p;
  p.kind = ActuatorKind::position;
  p.delay = delay;
  p.position = response;
  p.leg_steps = leg_steps(response, step);
  return p;
}

}  // namespace

TEST_CASE("a step is the exponential of the response's matrix, below, at and above critical damping") {
  for (const double damping : {0.05, 0.3, 0.999, 1.0 - 1e-7, 1.0, 1.0 + 1e-7, 1.001, 2.0, 20.0})
    for (const double bandwidth : {0.1, 5.0, 60.0, 900.0})
      for (const double step : {1e-4, 1e-3, 2e-2}) {
        CAPTURE(damping);
        CAPTURE(bandwidth);
        CAPTURE(step);
        const double w = kTurn * bandwidth;
        Eigen::Matrix2d rate;  // of w x and q-dot, so that both have one size
        rate << 0.0, w, -w, -2.0 * damping * w;
        const Eigen::Matrix2d exact = (rate * step).exp();
        const Vector4<double> found = leg_transition(bandwidth, damping, step);
        // The exponential's own scaling and squaring costs a rounding for each unit of the exponent.
        const double tolerance = 20.0 * kEpsilon * (1.0 + rate.norm() * step);
        CHECK(std::abs(found(0) - exact(0, 0)) <= tolerance);
        CHECK(std::abs(found(1) * w - exact(0, 1)) <= tolerance);
        CHECK(std::abs(found(2) / w - exact(1, 0)) <= tolerance);
        CHECK(std::abs(found(3) - exact(1, 1)) <= tolerance);
      }
}

TEST_CASE("without limits the way is that of the closed form, from the tick on at which a command arrives") {
  const PositionResponse<double> response{.bandwidth = 12.0, .damping = 0.4};
  const double w = kTurn * response.bandwidth, decay = response.damping * w, turn = std::sqrt(w * w - decay * decay);
  Vector6<double> start, goal;
  start << 0.2, 0.21, 0.19, 0.2, 0.2, 0.2;
  goal << 0.21, 0.2, 0.2, 0.19, 0.2, 0.23;
  constexpr int kDelay = 3;
  PositionedLegs<double> legs(parameters(response, kDelay), kStep, start, Vector6<double>::Zero());
  for (int tick = 0; tick < 300; ++tick) {
    const double t = std::max(0, tick - kDelay) * kStep;
    const double left = std::exp(-decay * t) * (std::cos(turn * t) + decay / turn * std::sin(turn * t));
    CHECK(distance(legs.positions(), goal + left * (start - goal)) <= 1e-13);
    legs.command(goal);
    legs.advance();
  }
}

TEST_CASE("limits hold, and the way to a far goal is ramp, cruise and end") {
  const PositionResponse<double> response{
      .bandwidth = 20.0, .damping = 1.0, .speed_limit = 0.05, .acceleration_limit = 0.5};
  const Vector6<double> start = Vector6<double>::Constant(0.2), goal = Vector6<double>::Constant(0.23);
  PositionedLegs<double> legs(parameters(response), kStep, start, Vector6<double>::Zero());
  double before = 0.0;
  for (int tick = 0; tick < 2000; ++tick) {
    legs.command(goal);
    legs.advance();
    const double t = (tick + 1) * kStep, speed = legs.rates()(0);
    CHECK(std::abs(speed) <= 0.05);
    CHECK(std::abs(speed - before) <= 0.5 * kStep * (1.0 + 1e-12));
    // 0.1 s to full speed; the way there is 2.5 mm, and all of it exact but for a rounding in each step.
    if (t <= 0.1)
      CHECK(std::abs(legs.positions()(0) - (0.2 + 0.25 * t * t)) <= 3e-13);
    else if (t <= 0.4)
      CHECK(std::abs(legs.positions()(0) - (0.2025 + 0.05 * (t - 0.1))) <= 3e-13);
    before = speed;
  }
  CHECK(distance(legs.positions(), goal) <= 1e-12);
}

TEST_CASE("a limit alone holds too, from the start on, and at the largest speed nothing accelerates") {
  constexpr double kUnlimited = std::numeric_limits<double>::infinity();
  const Vector6<double> start = Vector6<double>::Constant(0.2);
  for (const auto& [fastest, most] : {std::pair(0.05, kUnlimited), std::pair(kUnlimited, 0.5)}) {
    const PositionResponse<double> response{
        .bandwidth = 20.0, .damping = 0.7, .speed_limit = fastest, .acceleration_limit = most};
    PositionedLegs<double> legs(parameters(response), kStep, start, Vector6<double>::Constant(0.08));
    const Vector6<double> ways = (Vector6<double>() << 0.02, 0.021, 0.022, 0.023, 0.024, 0.025).finished();
    Vector6<double> before = Vector6<double>::Constant(std::min(0.08, fastest));
    CHECK(distance(legs.rates(), before) == 0.0);
    for (int tick = 0; tick < 400; ++tick) {
      legs.command(start + (tick % 200 < 100 ? 1.0 : -0.5) * ways);
      const Vector6<double> now = legs.accelerations(), mean = legs.mean_accelerations(2, 2.0 * kStep);
      Vector6<double> rates = before;
      for (int step = 0; step < 2; ++step) {
        legs.advance();
        CHECK(legs.rates().cwiseAbs().maxCoeff() <= fastest);
        CHECK(distance(legs.rates(), rates) <= most * kStep * (1.0 + 1e-12));
        rates = legs.rates();
      }
      CHECK(distance(mean, (rates - before) / (2.0 * kStep)) <= 1e-12 * (1.0 + mean.cwiseAbs().maxCoeff()));
      for (int leg = 0; leg < 6; ++leg) {
        CHECK(std::abs(now(leg)) <= most);
        if (before(leg) == fastest) CHECK(now(leg) <= 0.0);
      }
      before = rates;
    }
  }
}

TEST_CASE("where limits begin and end to act the way is of second order in the step") {
  const PositionResponse<double> response{
      .bandwidth = 15.0, .damping = 0.5, .speed_limit = 0.11, .acceleration_limit = 3.3};
  const Vector6<double> start = Vector6<double>::Constant(0.2);
  constexpr double kPeriod = 0.02;  // [s]
  const auto way = [&](int steps) {
    PositionedLegs<double> legs(parameters(response, 0, kPeriod / steps), kPeriod / steps, start,
                                Vector6<double>::Zero());
    std::vector<double> positions;
    for (int tick = 0; tick < 25; ++tick) {
      legs.command(Vector6<double>::Constant(0.2 + 0.006 * std::sin(0.37 * tick)));
      for (int step = 0; step < steps; ++step) legs.advance();
      positions.push_back(legs.positions()(0));
    }
    return positions;
  };
  const std::vector<double> exact = way(4096);
  const auto error = [&](int steps) {
    const std::vector<double> found = way(steps);
    double largest = 0.0;
    for (std::size_t i = 0; i < found.size(); ++i) largest = std::max(largest, std::abs(found[i] - exact[i]));
    return largest;
  };
  // Single kinks fall well or badly on a grid: the trend over a factor of 32 is asked for, of which 32^2 is the ideal.
  const double coarse = error(2), fine = error(64);
  MESSAGE("largest error ", coarse, " m with 2 steps, ", fine, " m with 64");
  CHECK(coarse <= 2e-4);
  CHECK(fine <= coarse / 300.0);
}

TEST_CASE("a response much faster than the loop's step keeps its limits, and its way") {
  constexpr double kPeriod = 0.02;  // [s]
  constexpr double kJump = 0.01;    // [m]
  constexpr int kFine = 500, kTicks = 60;
  Random random(7602);
  CAPTURE(random.seed());
  std::vector<double> commands;
  for (int tick = 0; tick < kTicks; ++tick)
    commands.push_back(tick < 20   ? kJump
                       : tick < 40 ? -0.4 * kJump
                                   : commands.back() + random.uniform(-0.3, 0.3) * kJump);
  for (const double turns : {0.1, 0.5, 2.0, 10.0})  // of the response in a step
    for (const double damping : {0.3, 1.0, 2.0})
      for (const double share : {0.03, 0.1, 0.3, 0.9}) {  // of what a jump of the command would have without limits
        CAPTURE(turns);
        CAPTURE(damping);
        CAPTURE(share);
        const double w = kTurn * turns / kPeriod;
        const PositionResponse<double> response{.bandwidth = turns / kPeriod,
                                                .damping = damping,
                                                .speed_limit = share * kJump * w,
                                                .acceleration_limit = share * kJump * w * w};
        const auto moved = [&](int steps) {
          const PositionedLeg<double> leg(response, leg_steps(response, kPeriod / steps), kPeriod / steps);
          std::vector<double> positions;
          double position = 0.0, rate = 0.0;
          for (const double command : commands) {
            const double from = position;
            for (int step = 0; step < steps; ++step) {
              const double before = rate;
              double x = position - command;
              leg.advance(x, rate);
              position = command + x;
              CHECK(std::abs(rate - before) <= response.acceleration_limit * kPeriod / steps * (1.0 + 1e-9));
            }
            // Within a part of a step that is free at its ends the speed may be beyond the limit by (0.1)^2/8 of it.
            CHECK(std::abs(position - from) <= response.speed_limit * kPeriod * (1.0 + 0.01 / 8.0));
            positions.push_back(position);
          }
          return positions;
        };
        const std::vector<double> coarse = moved(1), fine = moved(kFine);
        for (std::size_t i = 0; i < fine.size(); ++i) CHECK(std::abs(coarse[i] - fine[i]) <= 0.01 * kJump);
      }
}

TEST_CASE("lanes move as single legs do") {
  constexpr int kWidth = 4;
  using S = Lanes<kWidth>;
  Random random(7601);
  CAPTURE(random.seed());
  ActuatorParameters<S> pack;
  std::vector<PositionedLegs<double>> singles;
  const Vector6<double> start = Vector6<double>::Constant(0.2);
  for (int lane = 0; lane < kWidth; ++lane) {
    PositionResponse<double> response{.bandwidth = 10.0 + 10.0 * lane, .damping = 0.5 + 0.4 * lane};
    if (lane == 1) response.speed_limit = 0.02;
    if (lane == 2) response.acceleration_limit = 2.0;
    if (lane == 3) response = {.bandwidth = 300.0, .damping = 0.4, .speed_limit = 0.3, .acceleration_limit = 500.0};
    const ActuatorParameters<double> single = parameters(response, 2);
    set_lane(pack, lane, single);
    singles.emplace_back(single, kStep, start, Vector6<double>::Zero());
  }
  Vector6<S> starts;
  for (int lane = 0; lane < kWidth; ++lane) set_lane(starts, lane, start);
  PositionedLegs<S> legs(pack, kStep, starts, Vector6<S>(Vector6<S>::Zero()));
  for (int tick = 0; tick < 200; ++tick) {
    const Vector6<double> goal = start + 0.002 * random.six(1.0, 1.0);
    legs.command(goal.cast<S>());
    legs.advance();
    for (int lane = 0; lane < kWidth; ++lane) {
      auto& single = singles[static_cast<std::size_t>(lane)];
      single.command(goal);

      single.advance();
      CHECK(distance(lane_of(legs.positions(), lane), single.positions()) <= 1e-15);
      CHECK(distance(lane_of(legs.rates(), lane), single.rates()) <= 1e-13);
    }
  }
}
