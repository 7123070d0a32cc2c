// Batches: lanes against single runs, independence of neighbours, threads, number and order, ends, refusals; and the
// border to the kernels.
#include "hexservo/batch.hpp"
#include "hexservo/scenario_keys.hpp"

#include "../../cpp/src/flatten.hpp"
#include "../../cpp/src/run_request.hpp"
#include "compare.hpp"
#include "scenarios.hpp"

#include <algorithm>
#include <cstring>
#include <numeric>
#include <string>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

template <class Law = Hybrid>
Settings smooth_run(double duration) {
  Settings settings = Settings::of<Law>();
  settings.target = paper_settings().target;
  settings.uncertainty = paper_settings().uncertainty;
  settings.controller.switching = {SwitchingKind::tanh, 1e-2};
  settings.simulation.duration = duration;
  settings.metrics.rms_start = 0.01;
  return settings;
}

/// Scenarios as rows of one or more keys, each in its own memory.
struct Rows {
  std::string key;
  std::size_t width;
  std::vector<double> values;

  operator Variation() const { return {key, values, width}; }  // NOLINT: implicit, for lists of variations
};

BatchResult run(const Settings& settings, const std::vector<Variation>& variations, std::size_t count,
                BatchLog log = BatchLog::last_sample, int threads = 2) {
  BatchOptions options;
  options.log = log;
  options.threads = threads;
  return simulate_batch(settings, std::span<const Variation>(variations), count, options);
}

std::vector<double> flattened(const LoopParameters<double, Hybrid>& parameters) {
  std::vector<double> row(static_cast<std::size_t>(detail::flat_size(parameters)));
  detail::flatten(parameters, row.data());
  return row;
}

double metric_of(const BatchResult& result, std::size_t metric, std::size_t i) {
  return result.metrics[metric * result.count + i];
}
Outcome outcome(const BatchResult& result, std::size_t i) { return static_cast<Outcome>(result.outcome[i]); }
StopCause cause(const BatchResult& result, std::size_t i) { return static_cast<StopCause>(result.cause[i]); }

std::vector<double> numbers_of(const Metrics<double>& metrics) {
  std::vector<double> numbers;
  Metrics<double>::visit([&](const char*, const double& value) { numbers.push_back(value); }, metrics);
  return numbers;
}

std::vector<std::span<const double>> columns_of(const Trajectory& log) {
  return {log.feature_error, log.depth,        log.position,    log.quaternion, log.twist,
          log.wrench,        log.fuzzy_output, log.leg_lengths, log.leg_forces};
}

bool same_bits(double a, double b) { return std::memcmp(&a, &b, sizeof a) == 0; }

/// Everything that a batch keeps of scenario `i`, in one row.
std::vector<double> kept(const BatchResult& result, std::size_t i) {
  std::vector<double> row = {static_cast<double>(result.outcome[i]), static_cast<double>(result.cause[i]),
                             result.end_time[i], result.stop_time[i]};
  const auto add = [&](const Buffer& buffer) {
    const std::size_t width = buffer.size() / result.count;
    row.insert(row.end(), buffer.data() + i * width, buffer.data() + (i + 1) * width);
  };
  for (std::size_t m = 0; m < kMetricNumbers; ++m) row.push_back(result.metrics[m * result.count + i]);
  for (const Buffer& samples : result.samples) add(samples);
  add(result.fuzzy_weights);
  return row;
}

bool same_bits(const std::vector<double>& a, const std::vector<double>& b) {
  return std::ranges::equal(a, b, [](double x, double y) { return same_bits(x, y); });
}

/// Scenario `i` of a batch that keeps the last sample is the single run, to rounding.
void check_same(const BatchResult& batch, std::size_t i, const Trajectory& single) {
  CHECK(outcome(batch, i) == single.outcome);
  CHECK(batch.end_time[i] == single.end_time);
  const std::vector<double> metrics = numbers_of(single.metrics);
  for (std::size_t m = 0; m < kMetricNumbers; ++m) {
    const double metric = batch.metrics[m * batch.count + i];
    CAPTURE(m);
    if (std::isnan(metrics[m]))  // no settling time
      CHECK(std::isnan(metric));
    else
      CHECK(metric == doctest::Approx(metrics[m]).epsilon(1e-11));
  }
  const auto columns = columns_of(single);
  for (std::size_t q = 0; q < columns.size(); ++q) {
    const auto width = static_cast<std::size_t>(sample_width(q, kPoints));
    const auto expected = columns[q].last(width);
    const double scale = std::abs(*std::ranges::max_element(columns[q], {}, [](double x) { return std::abs(x); }));
    for (std::size_t k = 0; k < width; ++k)
      CHECK(std::abs(batch.samples[q][i * width + k] - expected[k]) <= 1e-11 * scale);
  }
  double largest = 0.0, off = 0.0;
  for (int axis = 0; axis < 6; ++axis)
    for (int row = 0; row < 7; ++row)
      for (int column = 0; column < 7; ++column) {
        const double expected = single.fuzzy_weights[rule(row, column)](axis);
        const auto place = ((i * 6 + static_cast<std::size_t>(axis)) * 7 + static_cast<std::size_t>(row)) * 7 +
                           static_cast<std::size_t>(column);
        largest = std::max(largest, std::abs(expected));
        off = std::max(off, std::abs(batch.fuzzy_weights[place] - expected));
      }
  CHECK(largest > 0.0);
  CHECK(off <= 1e-11 * largest);
}

}  // namespace

TEST_CASE("flattening keeps every number, flag and mode") {
  Settings settings = paper_settings();
  settings.gains<Hybrid>().fuzzy.enabled = false;
  settings.controller.switching.kind = SwitchingKind::saturation;
  settings.controller.jacobian = JacobianConvention::printed;
  settings.metrics = {3.0, 0.1, 0.25};
  settings.simulation.step = 2e-3;
  const LoopParameters<double, Hybrid> p = loop_parameters<Hybrid>(settings);
  const std::vector<double> numbers = flattened(p);
  LoopParameters<double, Hybrid> q;
  detail::unflatten(q, numbers.data());
  CHECK(q.gains.fuzzy.enabled == false);
  CHECK(q.switching.kind == SwitchingKind::saturation);
  CHECK(q.jacobian == JacobianConvention::printed);
  CHECK(q.metrics == settings.metrics);
  CHECK(q.step == 2e-3);
  CHECK(q.hexapod.base_joints_B == p.hexapod.base_joints_B);
  CHECK(q.gains.fuzzy.table == p.gains.fuzzy.table);
  CHECK(same_bits(flattened(q), numbers));
  // every place of the row is read and written, none twice
  const auto is_mode = [&](std::size_t i) {
    std::vector<double> one = flattened(p);
    one[i] += 0.5;
    detail::unflatten(q, one.data());
    return flattened(q)[i] != one[i];
  };
  std::size_t modes = 0;
  for (std::size_t i = 0; i < numbers.size(); ++i) modes += is_mode(i) ? 1U : 0U;
  // Whole numbers, modes and flags; the others are real numbers. Both modes: convention, Jacobian, switching kind,
  // fuzzy on or off (4). Sampled: mode, substeps (2), frames (7), pose source, encoders (3), actuators (4), base,
  // limits (2), when they are looked at (1). Whether the centre of mass is off E's origin, as estimated and as it is
  // (2). Lenses, the true one and the controller's (2). Rotation of the base, road, frame and motion of the target (4).
  // Whether legs have cranks (1). How many points there are (1). What the two cameras are mounted on (2).
  CHECK(modes == 4 + 2 + 7 + 3 + 4 + 2 + 1 + 2 + 2 + 4 + 1 + 1 + 2);
}

TEST_CASE("every lane is the single run, to rounding, on the smooth loop; short packs too") {
  const Settings base = smooth_run(0.5);
  const Rows depth{"uncertainty.depth", 1, {0.3, -0.3, 0.0, 0.1, -0.55}};
  const Rows gains{"controller.hybrid.kv", 6, {}};
  std::vector<double> kv;
  for (int i = 0; i < 5; ++i)
    for (int j = 0; j < 6; ++j) kv.push_back((j < 3 ? 2e-3 : 1e-4) * (1.0 + 0.1 * i + 0.01 * j));
  const BatchResult batch = run(base, {depth, Variation{"controller.hybrid.kv", kv, 6}}, 5);
  for (std::size_t i = 0; i < 5; ++i) {
    CAPTURE(i);
    Settings settings = base;
    settings.uncertainty.depth.setConstant(depth.values[i]);
    settings.gains<Hybrid>().kv = Eigen::Map<const Vector6<double>>(kv.data() + 6 * i);
    const Trajectory single = simulate(settings);
    check_same(batch, i, single);
  }
}

TEST_CASE("every lane is the single run with the law `composite`, to rounding") {
  const Settings base = smooth_run<Composite>(0.5);
  const Rows depth{"uncertainty.depth", 1, {0.3, -0.3, 0.0, 0.1, -0.55}};
  const Rows kt{"controller.composite.kt", 6, [] {
                  std::vector<double> values;
                  for (int i = 0; i < 5; ++i)
                    for (int j = 0; j < 6; ++j) values.push_back((j < 3 ? 6.0 : 0.015) * (1.0 + 0.1 * i + 0.01 * j));
                  return values;
                }()};
  const Rows drive{"controller.composite.drive", 1, {4.0, 3.0, 5.0, 4.5, 0.0}};
  const Rows prior{"controller.composite.prior", 1, {1600.0, 3000.0, 5000.0, 1e4, 2e4}};
  const BatchResult batch = run(base, {depth, kt, drive, prior}, 5);
  for (std::size_t i = 0; i < 5; ++i) {
    CAPTURE(i);
    Settings settings = base;
    settings.uncertainty.depth.setConstant(depth.values[i]);
    settings.gains<Composite>().kt = Eigen::Map<const Vector6<double>>(kt.values.data() + 6 * i);
    settings.gains<Composite>().drive.setConstant(drive.values[i]);
    settings.gains<Composite>().prior.setConstant(prior.values[i]);
    check_same(batch, i, simulate(settings));
  }
}

TEST_CASE_TEMPLATE("options of the weights in a batch: the single run, and nothing to a neighbour without them", Law,
                   Hybrid, Composite) {
  const Settings base = smooth_run<Law>(0.3);
  const std::string fuzzy = "controller." + std::string(Law::traits.name) + ".fuzzy.";
  const Rows leakage{fuzzy + "leakage", 1, {0.0, 2.0, 0.0, 0.0, 5.0}};
  const Rows limit{fuzzy + "weight_limit", 1, {kInfinity, kInfinity, 1e-5, kInfinity, 2e-3}};
  const Rows zone{fuzzy + "dead_zone", 1, {0.0, 0.0, 0.0, 1e-3, 2e-3}};
  const BatchResult batch = run(base, {leakage, limit, zone}, 5);
  for (std::size_t i = 0; i < 5; ++i) {
    CAPTURE(i);
    Settings settings = base;
    settings.gains<Law>().fuzzy.leakage.setConstant(leakage.values[i]);
    settings.gains<Law>().fuzzy.weight_limit.setConstant(limit.values[i]);
    settings.gains<Law>().fuzzy.dead_zone.setConstant(zone.values[i]);
    check_same(batch, i, simulate(settings));
    if (i > 0) CHECK_FALSE(same_bits(kept(batch, i), kept(batch, 0)));
  }
  const BatchResult alone = run(base, {Rows{"uncertainty.depth", 1, {0.3}}}, 1);
  CHECK(same_bits(kept(alone, 0), kept(batch, 0)));
}

TEST_CASE_TEMPLATE("each key that may vary changes the settings, and none is there twice", Law, Hybrid, Composite) {
  std::vector<std::string> names;
  std::size_t gain_numbers = 1;  // gains are: enabled, and all that may vary
  const auto gains_of = [](const Settings& s) {
    std::vector<double> row(static_cast<std::size_t>(detail::flat_size(s.gains<Law>())));
    detail::flatten(s.gains<Law>(), row.data());
    return row;
  };
  for (const ScenarioKey& key : scenario_keys(law_id<Law>)) {
    if (!key.varies() || key.type == KeyType::seed) continue;
    CAPTURE(key.name);
    names.push_back(key.name);
    const bool gain = key.name.starts_with("controller." + std::string(Law::traits.name) + ".");
    Settings settings = smooth_run<Law>(0.5);
    const Settings before = settings;
    std::vector<double> numbers(key.per_point > 0 ? key.widths().back() : key.widths().front());
    for (std::size_t i = 0; i < numbers.size(); ++i) numbers[i] = (gain ? 2.5 : 2.0) + static_cast<double>(i);
    if (key.name == "metrics.band") numbers[0] = 3.0;
    set_numbers(settings, key, numbers);
    CHECK_FALSE(same_bits(numbers_of(settings, key), numbers_of(before, key)));
    CHECK(same_bits(gains_of(settings), gains_of(before)) != gain);
    const std::vector<double> after = gains_of(settings), start = gains_of(before);
    std::size_t changed = 0;
    for (std::size_t i = 0; i < after.size(); ++i) changed += same_bits(after[i], start[i]) ? 0U : 1U;
    if (!gain) continue;
    CHECK(changed == key.widths().back());  // a number stands for a whole array
    gain_numbers += key.widths().back();
  }
  std::ranges::sort(names);
  CHECK(std::ranges::adjacent_find(names) == names.end());
  CHECK(gain_numbers == gains_of(Settings::of<Law>()).size());
}

TEST_CASE("a run depends on its own scenario only, bit for bit: not on threads, number, order or neighbours") {
  const Settings base = [] {
    Settings settings = paper_settings();
    settings.simulation.duration = 0.1;
    return settings;
  }();
  // A focal length this long throws the image of a slightly moved platform far off: those scenarios diverge.
  std::vector<double> depth, kp;
  for (int i = 0; i < 11; ++i) {
    depth.push_back(0.09 * (i - 5));
    kp.push_back(i % 4 == 1 ? 1.0 : 1e-6 * (1 + i));
  }
  const auto batch_of = [&](const std::vector<std::size_t>& which, int threads) {
    Rows d{"uncertainty.depth", 1, {}}, k{"controller.hybrid.kp", 1, {}};
    for (const std::size_t i : which) {
      d.values.push_back(depth[i]);
      k.values.push_back(kp[i]);
    }
    return run(base, {d, k}, which.size(), BatchLog::last_sample, threads);
  };
  std::vector<std::size_t> all(11);
  std::iota(all.begin(), all.end(), std::size_t{0});
  const BatchResult reference = batch_of(all, 1);
  CHECK(outcome(reference, 0) == Outcome::completed);
  CHECK(outcome(reference, 1) == Outcome::diverged);  // beside 0 in a pack

  std::vector<std::size_t> turned = all;
  std::ranges::reverse(turned);
  for (const auto& which : {all, turned, {0}, {2, 0}, {0, 1, 2}, {1}, {3, 3, 1, 0, 0}, {5, 4, 3, 2}}) {
    for (const int threads : {1, 3}) {
      const BatchResult batch = batch_of(which, threads);
      for (std::size_t i = 0; i < which.size(); ++i) CHECK(same_bits(kept(batch, i), kept(reference, which[i])));
    }
  }
}

TEST_CASE("a lane that diverges is frozen with cause, time and last good sample") {
  const Settings base = smooth_run(0.2);
  const BatchResult batch = run(base, {Rows{"controller.hybrid.kp", 1, {1e-6, 1.0, 1e-6}}}, 3);
  Settings settings = base;
  settings.gains<Hybrid>().kp.setConstant(1.0);
  const Trajectory single = simulate(settings);
  REQUIRE(single.outcome == Outcome::diverged);
  CHECK(outcome(batch, 1) == Outcome::diverged);
  CHECK(batch.end_time[1] == single.end_time);
  CHECK(batch.stop_time[1] == doctest::Approx(static_cast<double>(single.steps) * 1e-3).epsilon(1e-14));
  CHECK(describe(cause(batch, 1), batch.stop_time[1]) == single.detail);
  for (std::size_t k = 0; k < 8; ++k) {
    const double expected = single.feature_error[single.feature_error.size() - 8 + k];
    CHECK(batch.samples[0][8 + k] == doctest::Approx(expected).epsilon(1e-11));
  }
  for (const std::size_t i : {0U, 2U}) {
    CHECK(outcome(batch, i) == Outcome::completed);
    CHECK(cause(batch, i) == StopCause::none);
    CHECK(batch.stop_time[i] == doctest::Approx(0.2));
  }
}

TEST_CASE("scenarios that differ in time grid or bell slope are kept out of each other's packs") {
  const Settings base = smooth_run(0.1);
  const Rows step{"simulation.step", 1, {1e-3, 5e-4, 1e-3, 2e-3, 5e-4, 1e-3, 1e-3}};
  const Rows duration{"simulation.duration", 1, {0.1, 0.1, 0.2, 0.1, 0.1, 0.1, 0.1}};
  const Rows slope{"controller.hybrid.fuzzy.bell_slope", 1, {2.0, 2.0, 2.0, 2.0, 2.5, 1.0, 2.0}};
  const BatchResult batch = run(base, {step, duration, slope}, 7);
  for (std::size_t i = 0; i < 7; ++i) {
    CAPTURE(i);
    Settings settings = base;
    settings.simulation.step = step.values[i];
    settings.simulation.duration = duration.values[i];
    settings.gains<Hybrid>().fuzzy.bell_slope = slope.values[i];
    const Trajectory single = simulate(settings);
    CHECK(batch.end_time[i] == single.end_time);
    CHECK(batch.metrics[7 + i] == doctest::Approx(single.metrics.final_error).epsilon(1e-11));
    CHECK(batch.metrics[2 * 7 + i] == doctest::Approx(single.metrics.rms_error).epsilon(1e-11));
  }
}

TEST_CASE("trajectories lie on one grid with the end, and are NaN from where a run stopped") {
  Settings base = smooth_run(0.1);
  base.simulation.log_every = 30;  // 100 steps: rows at 0, 30, 60, 90 and at the end
  const BatchResult batch = run(base, {Rows{"controller.hybrid.kp", 1, {1e-6, 1.0, 2e-6}}}, 3, BatchLog::trajectory);
  REQUIRE(batch.rows == 5);
  const std::vector<double> times = {0.0, 0.03, 0.06, 0.09, 0.1};
  for (std::size_t r = 0; r < 5; ++r) CHECK(batch.time[r] == doctest::Approx(times[r]));
  for (const std::size_t i : {0U, 2U}) {
    Settings settings = base;
    settings.gains<Hybrid>().kp.setConstant(i == 0 ? 1e-6 : 2e-6);
    const Trajectory single = simulate(settings);
    REQUIRE(single.time.size() == 5);
    const auto columns = columns_of(single);
    for (std::size_t q = 0; q < columns.size(); ++q)
      for (std::size_t k = 0; k < columns[q].size(); ++k)
        CHECK(batch.samples[q][i * columns[q].size() + k] == doctest::Approx(columns[q][k]).epsilon(1e-10));
  }
  CHECK(outcome(batch, 1) == Outcome::diverged);
  for (std::size_t r = 0; r < 5; ++r) {
    const bool ran = times[r] <= batch.end_time[1] + 1e-12;
    CHECK(std::isfinite(batch.samples[0][(5 + r) * 8]) == ran);
  }
  CHECK(batch.end_time[1] < 0.09);  // the case occurs

  CHECK(refusal([&] {
          run(base, {Rows{"simulation.step", 1, {1e-3, 5e-4}}}, 2, BatchLog::trajectory);
        }).starts_with("log: expected one time grid for all trajectories, got "));
}

TEST_CASE("seeds are whole numbers of 64 bits: neighbours beyond 2^53 give different runs") {
  Settings base = smooth_run<Composite>(0.05);
  base.simulation.mode = LoopMode::sampled;
  base.camera.noise = 0.5;
  constexpr std::uint64_t kLarge = (std::uint64_t{1} << 63) + 1;
  const std::vector<std::uint64_t> seeds = {kLarge, kLarge + 1, std::numeric_limits<std::uint64_t>::max(), 1};
  const BatchResult batch = run(base, {Variation{"seed", {}, 1, seeds}}, seeds.size());
  for (std::size_t i = 0; i < seeds.size(); ++i) {
    CAPTURE(i);
    base.seed = seeds[i];
    CHECK(metric_of(batch, 1, i) == doctest::Approx(simulate(base).metrics.final_error).epsilon(1e-9));
    for (std::size_t k = 0; k < i; ++k) CHECK(metric_of(batch, 1, i) != metric_of(batch, 1, k));
  }
  base.seed = 1;
  const std::vector<std::uint64_t> one = {seeds[3]};
  const std::vector<double> depth = {0.0, 0.0}, whole = {1.0, 2.0};
  const BatchResult alike = run(base, {Variation{"seed", {}, 1, one}, Variation{"uncertainty.depth", depth, 1}}, 2);
  CHECK(metric_of(alike, 1, 0) == metric_of(alike, 1, 1));
  CHECK(refusal([&] { run(base, {Variation{"seed", whole, 1}}, 2); }) ==
        "seed: expected whole numbers of 64 bits, got numbers of another type");
  CHECK(refusal([&] { run(base, {Variation{"seed", {}, 1, seeds}, Variation{"uncertainty.depth", depth, 1}}, 2); }) ==
        "seed: expected 1 or 2 seeds, got 4");
}

TEST_CASE("the first bad scenario is reported before anything runs, whatever the threads") {
  Settings base = paper_settings();
  std::vector<double> depth(1000, 0.1);
  for (const std::size_t i : {317U, 318U, 500U, 999U}) depth[i] = -2.0;
  const Variation variation{"uncertainty.depth", depth, 1};
  for (const int threads : {1, 2, 5})
    for (int repeat = 0; repeat < 5; ++repeat)
      CHECK(refusal([&] {
              run(base, {variation}, 1000, BatchLog::metrics, threads);
            }).starts_with("scenario 317: uncertainty.depth[0]: expected a number > -1 and < 1"));
  CHECK(refusal([&] { run(base, {Rows{"simulation.step", 1, {1e-3, 0.3, 1e-3}}}, 3); }).starts_with("scenario 1: sim"));
  CHECK(refusal([&] { run(base, {Rows{"simulation.log_every", 1, {2.0, 1.5}}}, 2); }).starts_with("scenario 1: sim"));
}

TEST_CASE("keys, widths, counts and results of the wrong size are refused with a message") {
  const Settings base = paper_settings();
  CHECK(refusal([&] { run(base, {Rows{"robot.colour", 1, {1.0}}}, 1); }) ==
        "robot.colour: expected a key that holds numbers, got one that does not");
  CHECK(refusal([&] { run(base, {Rows{"controller.hybrid.kp", 7, std::vector<double>(7)}}, 1); }) ==
        "controller.hybrid.kp: expected 1 or 8 per scenario, got 7");
  CHECK(refusal([&] { run(base, {Rows{"robot.mass", 1, {0.1, 0.1, 0.1}}}, 2); }) ==
        "robot.mass: expected 1 or 2 rows of 1, got 3 numbers");
  const Rows mass{"robot.mass", 1, {0.1}};
  CHECK(refusal([&] { run(base, {mass, mass}, 1); }) == "robot.mass: expected each key once, got a duplicate key");
  CHECK(refusal([&] { run(base, {mass}, 0); }) == "variations: expected at least one scenario, got none");
  CHECK(refusal([&] { run(base, {mass}, 1, BatchLog::metrics, 0); }) == "threads: expected a whole number >= 1, got 0");
  CHECK(refusal([&] { run(base, {mass}, 2'000'000); }).starts_with("log: expected a result of at most 2 GiB"));
  CHECK(refusal([&] { run(base, {mass}, 2000, BatchLog::trajectory); }).starts_with("log: expected a result of at m"));
}

TEST_CASE("a stop keeps what is finished and leaves nothing of the rest") {
  const Settings base = smooth_run(1.0);
  const std::size_t count = 4000;  // seconds of work
  const std::vector<double> depth(count, 0.1);
  std::vector<BatchProgress> told;
  for (const BatchLog log : {BatchLog::last_sample, BatchLog::metrics}) {
    BatchOptions options;
    options.log = log;
    options.threads = 2;
    options.progress = [&](const BatchProgress& p) { told.push_back(p); };
    options.stop_requested = [&] { return told.back().done >= 4; };
    told.clear();
    const Variation variation{"uncertainty.depth", depth, 1};
    const BatchResult batch = simulate_batch(base, {&variation, 1}, count, options);
    std::size_t finished = 0;
    for (std::size_t i = 0; i < count; ++i) {
      const bool done = outcome(batch, i) == Outcome::completed;
      finished += done ? 1 : 0;
      CHECK((done || outcome(batch, i) == Outcome::interrupted));
      CHECK(std::isnan(batch.end_time[i]) == !done);
      CHECK(std::isnan(batch.metrics[count + i]) == !done);
      if (log == BatchLog::metrics) continue;
      CHECK(std::isnan(batch.samples[0][i * 8]) == !done);
      CHECK(std::isnan(batch.fuzzy_weights[i * 294 + 293]) == !done);
    }
    CHECK(finished >= 4);
    CHECK(finished < count);
    CHECK(told.back().done == finished);
    CHECK(told.back().count == count);
    CHECK(told.back().steps <= told.back().total_steps);
    CHECK(told.back().total_steps == static_cast<long long>(count) * 1000);
    for (std::size_t i = 1; i < told.size(); ++i) CHECK(told[i].steps >= told[i - 1].steps);
  }
}

TEST_CASE("what the caller's own functions throw comes out, after all threads have ended") {
  const std::vector<double> depth(2000, 0.1);
  const Variation variation{"uncertainty.depth", depth, 1};
  BatchOptions options;
  options.progress = [](const BatchProgress&) { throw std::runtime_error("enough"); };
  CHECK_THROWS_WITH(simulate_batch(smooth_run(1.0), {&variation, 1}, 2000, options), "enough");
}

TEST_CASE("a kernel refuses what it cannot run") {
  const Kernel& kernel = built_in_kernel();
  CHECK(kernel.abi == kKernelAbi);
  CHECK(kernel.lanes >= 2);
  const Settings base = smooth_run(0.1);
  Settings other = base;
  other.gains<Hybrid>().fuzzy.bell_slope = 3.0;
  const std::vector<double> a = flattened(loop_parameters<Hybrid>(base)), b = flattened(loop_parameters<Hybrid>(other));
  const std::array<const double*, 2> scenarios = {a.data(), b.data()};
  std::array<RunAnswer, 2> answers{};
  RunRequest request = detail::run_request(base, base.simulation);
  request.parameters = scenarios.data();
  request.answers = answers.data();
  request.count = 2;
  CHECK(kernel.run_pack(request) == RunStatus::not_uniform);
  request.count = 1;
  CHECK(kernel.run_pack(request) == RunStatus::done);
  CHECK(answers[0].steps == 100);
  request.numbers -= 1;
  CHECK(kernel.run_single(request) == RunStatus::other_layout);
  CHECK_THROWS_AS(detail::require_done(RunStatus::other_layout), std::logic_error);
  request.numbers += 1;
  request.law = static_cast<LawId>(99);
  CHECK(kernel.run_single(request) == RunStatus::unknown_law);
}

TEST_CASE("the measured peak is a rate that a processor can have") {
  const double peak = built_in_kernel().fma_peak(0.02);
  CHECK(peak > 0.1);
  CHECK(peak < 1000.0);
}
