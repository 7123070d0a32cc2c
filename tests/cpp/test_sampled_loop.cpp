#include "compare.hpp"
#include "scenarios.hpp"

#include "hexservo/settings.hpp"

#include <algorithm>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

/// Corners of docs/model.md, section 8.
template <class Law>
Settings<Law> corner(double gravity, double depth) {
  Settings<Law> settings = paper_settings<Law>();
  settings.uncertainty.dynamics.gravity.setConstant(gravity);
  settings.uncertainty.depth.setConstant(depth);
  settings.simulation.mode = LoopMode::sampled;
  settings.switching.kind = SwitchingKind::implicit;
  return settings;
}

struct Row {
  double settle, error, rms;
};

template <class Law>
Row run(const Settings<Law>& settings) {
  const LoopParameters<double, Law> p = loop_parameters(settings);
  SampledLoop<double, Law> loop(p);
  const long long steps = step_count(settings.simulation);
  while (loop.steps() < steps && loop.record().running()) loop.advance();
  const Metrics<double> m = loop.record().metrics().metrics();
  if (!loop.record().running()) return {kInfinity, kInfinity, kInfinity};
  return {m.settling_time, m.final_error, m.rms_error};
}

template <class Law>
Settings<Law> with_camera(Settings<Law> settings, double period, double latency, Prediction prediction, double noise) {
  settings.sampling.period = period;
  settings.sampling.latency = latency;
  settings.sampling.faults.prediction = prediction;
  settings.sampling.faults.noise = noise;
  return settings;
}

double median(std::vector<double> values) {
  std::ranges::sort(values);
  const std::size_t half = values.size() / 2;
  return values.size() % 2 == 1 ? values[half] : 0.5 * (values[half - 1] + values[half]);
}

/// Medians over 20 seeds.
template <class Law>
Row run_noisy(Settings<Law> settings) {
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
  const auto end = [](const Settings<Hybrid>& s) {
    const LoopParameters<double, Hybrid> p = loop_parameters(s);
    SampledLoop<double, Hybrid> loop(p);
    for (long long i = 0; i < step_count(s.simulation); ++i) loop.advance();
    REQUIRE(loop.record().running());
    return loop.record().sample().twist.cwiseAbs().maxCoeff();
  };
  CHECK(end(settings) <= 1e-12);
  settings.switching.kind = SwitchingKind::implicit_coupled;
  CHECK(end(settings) <= 1e-12);
  settings.switching.kind = SwitchingKind::sign;
  CHECK(end(settings) >= 1e-6);
}
