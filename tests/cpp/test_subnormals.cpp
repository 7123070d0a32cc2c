// Subnormal numbers count as zero: in ticks, in runs, in packs; and the caller's floating-point mode is restored.
#include "hexservo/subnormals.hpp"

#include "hexservo/batch.hpp"
#include "hexservo/controller.hpp"
#include "random.hpp"
#include "scenarios.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cfenv>
#include <chrono>
#include <cmath>
#include <limits>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

constexpr double kPeriod = 1e-3;
constexpr int kBlocks = 201, kTicks = 10;
constexpr double kMost = 1.5;  // ratio of times; without the mode it is 2 to 100, by processor, and noise makes 1.2
constexpr double kSmallestNormal = std::numeric_limits<double>::min();

bool is_subnormal(double value) { return value != 0.0 && std::abs(value) < kSmallestNormal; }

/// A controller's image of its target from home [px; m], with a given twist in every component.
template <class Law>
ControllerInput input_at_home(const ControllerGains<Law>& gains, double twist) {
  ControllerInput input;
  input.pose = home_pose(gains.hexapod);
  input.frame = {0.0, take_image(gains.task.camera, input.pose.position, rotation_matrix(input.pose.quaternion),
                                 gains.task.target.points_T)};
  input.twist.setConstant(twist);
  return input;
}

/// A number that the compiler does not know to be subnormal or not.
double halved(double value, int times) {
  for (int i = 0; i < times; ++i) value *= 0.5;
  return value;
}

template <class Law>
Settings settings_of() {
  Settings settings = paper_settings<Law>();
  if constexpr (kHasFuzzySystems<Law>) {
    settings.gains<Law>().fuzzy.leakage.setConstant(0.5);
    settings.gains<Law>().fuzzy.initial_scale.setConstant(1e-3);
  }
  return settings;
}

template <class Weights>
void set_weights([[maybe_unused]] Weights& weights, [[maybe_unused]] double value) {
  if constexpr (std::is_same_v<Weights, FuzzyWeights<double>>)
    for (AxisVector<double>& of_rule : weights) of_rule = AxisVector<double>(Vector6<double>::Constant(value));
}

template <class Law>
double seconds_of_ticks(const ControllerGains<Law>& gains, const ControllerState<Law>& start,
                        const ControllerInput& input, int count) {
  ControllerState<Law> state = start;
  double sum = 0.0;
  const auto begin = std::chrono::steady_clock::now();
  for (int i = 0; i < count; ++i) sum += step(gains, state, input).wrench(2);
  const auto end = std::chrono::steady_clock::now();
  REQUIRE(std::isfinite(sum));
  return std::chrono::duration<double>(end - begin).count();
}

}  // namespace

TEST_CASE("the mode lasts as long as its object, and nothing else of the caller's mode changes") {
  volatile double smallest = kSmallestNormal;
  const auto half_is_zero = [&smallest] { return smallest * 0.5 == 0.0; };
  REQUIRE_FALSE(half_is_zero());
  REQUIRE(std::fesetround(FE_DOWNWARD) == 0);
  std::feclearexcept(FE_ALL_EXCEPT);
  {
    const FlushSubnormals flush;
    CHECK(half_is_zero() == kFlushesSubnormals);
    CHECK(std::fegetround() == FE_DOWNWARD);
    {
      const KeepSubnormals keep;
      CHECK_FALSE(half_is_zero());
      {
        const KeepSubnormals again;
        CHECK_FALSE(half_is_zero());
      }
      CHECK_FALSE(half_is_zero());
    }
    CHECK(half_is_zero() == kFlushesSubnormals);
    std::feraiseexcept(FE_DIVBYZERO);
  }
  CHECK_FALSE(half_is_zero());
  CHECK(std::fegetround() == FE_DOWNWARD);
  CHECK(std::fetestexcept(FE_DIVBYZERO) != 0);  // flags of what went on inside are not lost
  REQUIRE(std::fesetround(FE_TONEAREST) == 0);
}

TEST_CASE("a tick leaves the mode of its caller alone") {
  volatile double smallest = kSmallestNormal;
  const ControllerGains<Hybrid> gains = controller_gains<Hybrid>(paper_settings(), kPeriod);
  ControllerState<Hybrid> state = initial_state(gains);
  step(gains, state, input_at_home(gains, 1e-3));
  CHECK(smallest * 0.5 > 0.0);
  const FlushSubnormals flush;
  step(gains, state, input_at_home(gains, 1e-3));
  CHECK((smallest * 0.5 == 0.0) == kFlushesSubnormals);
}

#ifdef __GLIBC__
TEST_CASE("a tick and its gains do not trap where their caller's exceptions do, and they do again after them") {
  const int traps = FE_INVALID | FE_DIVBYZERO | FE_OVERFLOW;
  std::feclearexcept(FE_ALL_EXCEPT);
  const bool could = feenableexcept(traps) != -1 && fegetexcept() == traps;  // not every processor can
#ifdef __x86_64__
  REQUIRE(could);
#endif
  const ControllerGains<Hybrid> gains = controller_gains<Hybrid>(paper_settings(), kPeriod);
  ControllerState<Hybrid> state = initial_state(gains);
  ControllerInput input = input_at_home(gains, 1e-3);
  input.frame.exposure = std::numeric_limits<double>::quiet_NaN();  // no frame, which is compared
  const ControllerOutput output = step(gains, state, input);
  const int after = fegetexcept();
  std::feclearexcept(FE_ALL_EXCEPT);
  fedisableexcept(traps);
  CHECK(output.status == InputStatus::missing_image);
  CHECK(after == (could ? traps : 0));
}
#endif

TEST_CASE("a tick with subnormal twist or weights takes as long as any other" * doctest::skip(!kFlushesSubnormals)) {
  Laws::for_each([]<class Law>(std::type_identity<Law>) {
    CAPTURE(Law::traits.name);
    const ControllerGains<Law> gains = controller_gains<Law>(settings_of<Law>(), kPeriod);
    const ControllerInput usual = input_at_home(gains, 1e-3);
    const ControllerState<Law> start = initial_state(gains);
    ControllerState<Law> tiny_weights = start;
    set_weights(tiny_weights.law, halved(kSmallestNormal, 4));
    struct Case {
      const char* name;
      ControllerInput input;
      const ControllerState<Law>* state;
    };
    const Case cases[] = {{"subnormal twist", input_at_home(gains, halved(kSmallestNormal, 4)), &start},
                          {"twist whose products are subnormal", input_at_home(gains, 1e-300), &start},
                          {"subnormal weights", usual, &tiny_weights},
                          {"subnormal twist and weights", input_at_home(gains, 1e-310), &tiny_weights}};
    for (const Case& c : cases) {
      CAPTURE(c.name);
      double plain = std::numeric_limits<double>::infinity(), small = plain;
      for (int block = 0; block < kBlocks; ++block) {  // in turn, and the shortest: other programs only add time
        plain = std::min(plain, seconds_of_ticks(gains, start, usual, kTicks));
        small = std::min(small, seconds_of_ticks(gains, *c.state, c.input, kTicks));
      }
      CHECK(small / plain < kMost);
    }
  });
}

TEST_CASE("a subnormal twist is a twist of zero; one that is normal is not") {
  Laws::for_each([]<class Law>(std::type_identity<Law>) {
    CAPTURE(Law::traits.name);
    const ControllerGains<Law> gains = controller_gains<Law>(settings_of<Law>(), kPeriod);
    ControllerState<Law> of_zero = initial_state(gains), of_subnormal = of_zero;
    const ControllerOutput zero = step(gains, of_zero, input_at_home(gains, 0.0));
    const ControllerOutput subnormal = step(gains, of_subnormal, input_at_home(gains, halved(kSmallestNormal, 1)));
    if (kFlushesSubnormals) CHECK(zero.wrench == subnormal.wrench);
    CHECK(zero.status == InputStatus::valid);
    CHECK(subnormal.status == InputStatus::valid);
  });
  // Increments of weights are proportional to a twist this small: those above 1e-300 keep all of their digits.
  Settings settings = paper_settings();
  const ControllerGains<Hybrid> gains = controller_gains<Hybrid>(settings, kPeriod);
  ControllerState<Hybrid> small = initial_state(gains), large = small;
  constexpr double kRatio = 0x1p-60;
  step(gains, large, input_at_home(gains, 0x1p-900));
  step(gains, small, input_at_home(gains, 0x1p-900 * kRatio));
  int compared = 0;
  for (int axis = 0; axis < kAxes; ++axis) {
    const Matrix7<double> a = weight_matrix(small.law, axis), b = weight_matrix(large.law, axis);
    for (Eigen::Index i = 0; i < a.size(); ++i) {
      if (std::abs(b(i) * kRatio) < 1e-300) continue;
      ++compared;
      CHECK(a(i) == b(i) * kRatio);
    }
  }
  CHECK(compared > 100);
}

TEST_CASE("weights that leak end at zero, in ticks, runs and packs" * doctest::skip(!kFlushesSubnormals)) {
  Settings settings = paper_settings();
  settings.gains<Hybrid>().fuzzy.leakage.setConstant(5.0);
  settings.gains<Hybrid>().fuzzy.initial_scale.setConstant(1e-307);  // 0.2 s to the smallest normal number
  settings.gains<Hybrid>().fuzzy.adaptation.setConstant(1e307);      // nothing is learned that is normal

  const ControllerGains<Hybrid> gains = controller_gains<Hybrid>(settings, kPeriod);
  ControllerState<Hybrid> state = initial_state(gains);
  REQUIRE(weight_matrix(state.law, 0)(0, 0) != 0.0);
  for (int tick = 0; tick < 1000; ++tick) step(gains, state, input_at_home(gains, 1e-3));
  for (int axis = 0; axis < kAxes; ++axis) CHECK(weight_matrix(state.law, axis).isZero(0.0));

  settings.simulation.duration = 0.6;
  for (const LoopMode mode : {LoopMode::continuous, LoopMode::sampled}) {
    settings.simulation.mode = mode;
    settings.controller.switching = {SwitchingKind::tanh, 1e-2};
    const Trajectory run = simulate(settings);
    for (int axis = 0; axis < kAxes; ++axis)
      CHECK_FALSE(weight_matrix(run.fuzzy_weights, axis).unaryExpr(&is_subnormal).any());
    const std::vector<double> depth = {0.1, 0.2, 0.3};
    const std::vector<Variation> variations = {{"uncertainty.depth", depth, 1}};
    const BatchResult batch = simulate_batch(settings, std::span<const Variation>(variations), 3, {});
    CHECK(std::none_of(batch.fuzzy_weights.data(), batch.fuzzy_weights.data() + batch.fuzzy_weights.size(),
                       is_subnormal));
  }
}
