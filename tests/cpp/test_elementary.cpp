// Functions without a branch: against the standard library, and the same on every scalar.
#include "hexservo/elementary.hpp"

#include "compare.hpp"
#include "random.hpp"

#include <bit>
#include <cstdint>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

/// Distance in units of the last place of `expected`.
double ulps(double value, double expected) {
  if (value == expected) return 0.0;
  const double size = std::abs(expected);
  return std::abs(value - expected) / (std::nextafter(size, kInfinity) - size);
}

/// From the smallest to the largest sizes, densely where tanh bends.
std::vector<double> arguments() {
  std::vector<double> x = {5e-324, 1e-310, 1e-300, 1e-100, 1e-20, 1e-8,  0.5,  1.0,
                           19.0,   19.1,   20.0,   20.1,   100.0, 709.0, 1e10, 1e300};
  for (double v = 1e-6; v < 25.0; v *= 1.001) x.push_back(v);
  for (double v = 0.0005; v < 22.0; v += 0.0005) x.push_back(v);
  return x;
}

}  // namespace

TEST_CASE("hyperbolic_tangent is std::tanh within 4 units in the last place, odd, and never beyond 1") {
  double worst = 0.0;
  for (const double x : arguments()) {
    CAPTURE(x);
    const double y = hyperbolic_tangent(x);
    worst = std::max(worst, ulps(y, std::tanh(x)));
    CHECK(y <= 1.0);
    CHECK(hyperbolic_tangent(-x) == -y);
  }
  CAPTURE(worst);
  CHECK(worst <= 4.0);
  CHECK(hyperbolic_tangent(0.0) == 0.0);
  CHECK(hyperbolic_tangent(-0.0) == 0.0);
  CHECK(hyperbolic_tangent(kInfinity) == 1.0);
  CHECK(hyperbolic_tangent(-kInfinity) == -1.0);
  CHECK(std::isnan(hyperbolic_tangent(kNaN)));
}

TEST_CASE("expm1_of_negative is std::expm1 within 4 units in the last place") {
  double worst = 0.0;
  for (const double x : arguments())
    if (x <= 708.0) worst = std::max(worst, ulps(expm1_of_negative(-x), std::expm1(-x)));
  CAPTURE(worst);
  CHECK(worst <= 4.0);
}

TEST_CASE("power_of_two writes every exponent") {
  for (int n = -1022; n <= 1023; ++n) CHECK(power_of_two(static_cast<double>(n)) == std::ldexp(1.0, n));
}

TEST_CASE("a pack gives the bits of double in every lane") {
  const std::vector<double> x = arguments();
  const auto check = [&](auto pack) {
    using S = decltype(pack);
    for (std::size_t i = 0; i + S::width <= x.size(); i += S::width) {
      S a = 0.0;
      for (int lane = 0; lane < S::width; ++lane)
        a.set(lane, (lane % 2 == 0 ? 1.0 : -1.0) * x[i + static_cast<std::size_t>(lane)]);
      const S y = hyperbolic_tangent(a);
      for (int lane = 0; lane < S::width; ++lane)
        REQUIRE(std::bit_cast<std::uint64_t>(y[lane]) == std::bit_cast<std::uint64_t>(hyperbolic_tangent(a[lane])));
    }
    S a = 1.0;
    a.set(1, kNaN);
    const S y = hyperbolic_tangent(a);
    CHECK(std::isnan(y[1]));
    CHECK(y[0] == hyperbolic_tangent(1.0));
  };
  check(Lanes<2>());
  check(Lanes<4>());
  check(Lanes<8>());
}

TEST_CASE("nearest_whole and quantise are the nearest multiple, on any scalar") {
  Random random(7305);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 1000; ++trial) {
    const double x = random.uniform(-1e6, 1e6), step = std::pow(10.0, random.uniform(-6.0, 1.0));
    CAPTURE(x);
    CAPTURE(step);
    CHECK(nearest_whole(x) == std::nearbyint(x));
    const double q = quantise(x, step);
    CHECK(q == step * std::nearbyint(x / step));
    CHECK(std::abs(q - x) <= step * (0.5 + 1e-15) + kEpsilon * std::abs(x));
    CHECK(quantise(x, 0.0) == x);
    Lanes<4> steps(step);
    steps.set(2, 0.0);
    const Lanes<4> lanes = quantise(Lanes<4>(x), steps);
    CHECK(lanes[0] == q);
    CHECK(lanes[2] == x);
  }
  CHECK(nearest_whole(0.5) == 0.0);
  CHECK(nearest_whole(1.5) == 2.0);
  CHECK(std::isnan(quantise(kNaN, 0.1)));
  CHECK(quantise(kInfinity, 0.1) == kInfinity);
}

TEST_CASE("sine_of_turns is the sine of 2 pi x within 5e-16, at any number of turns, on any scalar") {
  Random random(7306);
  CAPTURE(random.seed());
  constexpr long double kTwoPi = 6.283185307179586476925286766559L;
  double worst = 0.0;
  for (int trial = 0; trial < 100'000; ++trial) {
    const double x = random.uniform(-2.0, 2.0) * std::pow(10.0, random.uniform(-9.0, 6.0));
    const long double turns = static_cast<long double>(x) - std::nearbyint(static_cast<long double>(x));  // exact
    const double error =
        std::abs(static_cast<double>(static_cast<long double>(sine_of_turns(x)) - std::sin(kTwoPi * turns)));
    worst = std::max(worst, error);
    if (trial % 100 == 0) CHECK(sine_of_turns(Lanes<4>(x))[3] == sine_of_turns(x));
  }
  CAPTURE(worst);
  CHECK(worst <= 5e-16);
  CHECK(sine_of_turns(0.0) == 0.0);
  CHECK(sine_of_turns(0.25) == 1.0);
  CHECK(sine_of_turns(-12345.75) == 1.0);
  CHECK(sine_of_turns(0.5) == 0.0);
  CHECK(std::isnan(sine_of_turns(kNaN)));
}
