// The classic Runge-Kutta method: exact where it must be, of order four elsewhere.
#include "hexservo/runge_kutta.hpp"

#include "compare.hpp"
#include "random.hpp"

#include <array>
#include <cmath>
#include <numeric>

using namespace hexservo;
using namespace hexservo::test;

namespace {

/// One step for a plain vector; the state carries its own time where it needs one.
template <class State, class Function>
State step(const State& y, double h, Function&& rate_at) {
  State next = y;
  runge_kutta_step(h, next, rate_at);
  return next;
}

}  // namespace

TEST_CASE("the weights sum to one and are symmetric") {
  CHECK(std::accumulate(kRungeKuttaWeights.begin(), kRungeKuttaWeights.end(), 0.0) ==
        doctest::Approx(1.0).epsilon(kEpsilon));
  CHECK(kRungeKuttaWeights[0] == kRungeKuttaWeights[3]);
  CHECK(kRungeKuttaWeights[1] == kRungeKuttaWeights[2]);
}

TEST_CASE("cubic polynomials of time are integrated exactly, quintic ones are not") {
  Random random(7301);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 50; ++trial) {
    const Vector4<double> c = random.matrix<4>();
    const double t0 = random.uniform(-1.0, 1.0), h = random.uniform(0.1, 2.0);
    using State = Vector2<double>;  // (t, y)
    const auto integral = [&c](double t) { return t * (c(0) + t * (c(1) / 2.0 + t * (c(2) / 3.0 + t * c(3) / 4.0))); };
    const State end = step(State(t0, 0.0), h, [&c](const State& s) {
      const double t = s(0);
      return State(1.0, c(0) + t * (c(1) + t * (c(2) + t * c(3))));
    });
    CHECK(std::abs(end(1) - (integral(t0 + h) - integral(t0))) <= 200.0 * kEpsilon);
    const State quintic =
        step(State(0.0, 0.0), 1.0, [](const State& s) { return State(1.0, 5.0 * std::pow(s(0), 4)); });
    CHECK(std::abs(quintic(1) - 1.0) > 1e-3);
  }
}

TEST_CASE("a linear equation is integrated as the Taylor polynomial of degree four") {
  // All four order conditions of a linear problem at once: y1 = (1 + z + z^2/2 + z^3/6 + z^4/24) y0.
  Random random(7302);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 50; ++trial) {
    const Matrix3<double> A = random.matrix<3, 3>();
    const Vector3<double> y0 = random.matrix<3>();
    const double h = random.uniform(0.05, 1.0);
    const Matrix3<double> Z = h * A, Z2 = Z * Z;
    const Vector3<double> expected = y0 + Z * y0 + Z2 * y0 / 2.0 + Z2 * Z * y0 / 6.0 + Z2 * Z2 * y0 / 24.0;
    CHECK(distance(step(y0, h, [&A](const Vector3<double>& y) { return Vector3<double>(A * y); }), expected) <=
          100.0 * kEpsilon);
  }
}

TEST_CASE("a nonlinear equation is integrated with order four") {
  // The pendulum; its energy is not used: errors against a run with steps 64 times as small.
  using State = Vector2<double>;
  const auto pendulum = [](const State& s) { return State(s(1), -std::sin(s(0))); };
  const auto run = [&pendulum](int steps) {
    State s(1.5, 0.3);
    for (int i = 0; i < steps; ++i) s = step(s, 4.0 / steps, pendulum);
    return s;
  };
  const State truth = run(64 * 256);
  double previous = (run(32) - truth).norm();
  for (const int steps : {64, 128, 256}) {
    const double error = (run(steps) - truth).norm();
    CAPTURE(steps);
    CAPTURE(previous / error);
    CHECK(previous / error > 14.0);
    CHECK(previous / error < 18.0);
    previous = error;
  }
}

TEST_CASE("stages are asked for at h/2, h/2 and h, each from the one before") {
  std::array<double, 3> scales{};
  std::size_t count = 0;
  runge_kutta_step(
      0.2, 1.0,
      [&](double scale, double rate) {
        scales.at(count++) = scale;
        return rate + 1.0;
      },
      [](const auto& k) {
        for (std::size_t i = 0; i < 4; ++i) CHECK(*k[i] == 1.0 + static_cast<double>(i));
      });
  CHECK(count == 3);
  CHECK(scales == std::array<double, 3>{0.1, 0.1, 0.2});
}
