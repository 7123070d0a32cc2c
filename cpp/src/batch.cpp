#include "hexservo/batch.hpp"

#include "check.hpp"
#include "hexservo/scenario_keys.hpp"
#include "run_request.hpp"
#include "workers.hpp"

#include <algorithm>
#include <map>
#include <mutex>
#include <optional>

namespace hexservo {

using detail::refuse;
using detail::words;

namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr std::size_t kCheckedTogether = 64;              // scenarios that a thread checks at a time
constexpr std::size_t kClearedTogether = 1024;            // scenarios that a thread clears at a time
constexpr double kMaxPreparedBytes = 64.0 * 1024 * 1024;  // of parameters that are kept from the check to the run

/// The scenarios of a batch: the base with one row of each variation.
class Scenarios {
 public:
  Scenarios(const Settings& base, std::span<const Variation> variations, std::size_t count)
      : base_(base), count_(count) {
    if (count == 0) refuse("variations", "at least one scenario", "none");
    for (const Variation& variation : variations) add(variation);
    // One set of equations for all scenarios: what shares a pack must not change their bits.
    base_.robot.off_centre |= std::ranges::any_of(items_, [](const Item& item) {
      return item.key->name == "robot.centre_of_mass" || item.key->name.starts_with("robot.payload.");
    });
    base_.target.weighted |=
        std::ranges::any_of(items_, [](const Item& item) { return item.key->name == "target.weights"; });
  }

  std::size_t count() const { return count_; }
  const Settings& base() const { return base_; }

  /// Puts scenario `i` into settings that started as the base.
  void set(Settings& settings, std::size_t i) const {
    for (const Item& item : items_) set_numbers(settings, *item.key, item.row(i));
    if (!seeds_.empty()) settings.seed = seeds_[seeds_.size() == 1 ? 0 : i];
  }

  /// What the scenarios of a pack must have in common, as numbers.
  std::vector<double> shared(std::size_t i) const {
    std::vector<double> numbers;
    for (const Item& item : items_)
      if (item.key->field.reach == Reach::pack) numbers.insert(numbers.end(), item.row(i).begin(), item.row(i).end());
    return numbers;
  }
  bool all_alike() const {
    return std::ranges::none_of(items_,
                                [](const Item& item) { return item.key->field.reach == Reach::pack && !item.for_all; });
  }
  /// The legs of every scenario are those of the base.
  bool same_legs() const {
    return std::ranges::none_of(items_, [](const Item& item) { return item.key->field.reach == Reach::legs; });
  }

 private:
  struct Item {
    const ScenarioKey* key;
    std::span<const double> values;
    std::size_t width;
    bool for_all;

    std::span<const double> row(std::size_t i) const { return values.subspan(for_all ? 0 : i * width, width); }
  };

  void add(const Variation& variation) {
    const std::vector<ScenarioKey>& keys = scenario_keys(base_.law());
    const auto key = std::ranges::find(keys, variation.key, &ScenarioKey::name);
    if (key != keys.end() && key->type == KeyType::seed) return add_seeds(variation);
    if (key == keys.end() || !key->varies()) refuse(variation.key, "a key that holds numbers", "one that does not");
    if (std::ranges::any_of(items_, [&](const Item& item) { return item.key == &*key; }))
      refuse(variation.key, "each key once", "a duplicate key");
    const std::vector<std::size_t> widths = key->widths(base_.target.count());
    if (std::ranges::find(widths, variation.width) == widths.end()) {
      std::string expected;
      for (const std::size_t width : widths) expected += words(expected.empty() ? "" : " or ", width);
      refuse(variation.key, expected + " per scenario", words(variation.width));
    }
    const std::size_t rows = variation.values.size() / variation.width;
    if (rows * variation.width != variation.values.size() || (rows != 1 && rows != count_))
      refuse(variation.key, words("1 or ", count_, " rows of ", variation.width),
             words(variation.values.size(), " numbers"));
    items_.push_back({&*key, variation.values, variation.width, rows == 1});
  }

  void add_seeds(const Variation& variation) {
    const std::size_t rows = variation.seeds.size();
    if (!seeds_.empty()) refuse(variation.key, "each key once", "a duplicate key");
    if (rows == 0 || !variation.values.empty())
      refuse(variation.key, "whole numbers of 64 bits", "numbers of another type");
    if (rows != 1 && rows != count_) refuse(variation.key, words("1 or ", count_, " seeds"), words(rows));
    seeds_ = variation.seeds;
  }

  Settings base_;
  std::size_t count_;
  std::vector<Item> items_;
  std::span<const std::uint64_t> seeds_;  // one for all, one for each, or empty: that of the base
};

/// Steps and logging that a group of scenarios shares.
struct Grid {
  SimulationSettings simulation;
  long long steps;
};

/// Scenarios that may share a pack, by what they have in common; each group in the order of its scenarios.
struct Group {
  Grid grid;
  std::vector<std::size_t> members;
};

std::vector<Group> grouped(const Scenarios& scenarios) {
  std::map<std::vector<double>, std::size_t> places;
  std::vector<Group> groups;
  for (std::size_t i = 0; i < scenarios.count(); ++i) {
    std::size_t place = 0;
    if (!scenarios.all_alike()) place = places.try_emplace(scenarios.shared(i), groups.size()).first->second;
    if (place == groups.size()) {
      Settings settings = scenarios.base();
      scenarios.set(settings, i);
      groups.push_back({{settings.simulation, step_count(settings.simulation)}, {}});
    }
    groups[place].members.push_back(i);
  }
  return groups;
}

constexpr long long kPackStepsBetweenQuestions = 256;  // of a pack

/// Samples on the grid: every `log_every`-th step, and the end.
std::size_t grid_rows(const Grid& grid) {
  const long long every = grid.simulation.log_every;
  return static_cast<std::size_t>(grid.steps / every + 1 + (grid.steps % every != 0 ? 1 : 0));
}

std::string described(const Grid& grid) {
  return words(grid.steps, " steps of ", grid.simulation.step, " s with log_every ", grid.simulation.log_every);
}

void require_one_grid(const std::vector<Group>& groups) {
  const Grid& first = groups.front().grid;
  for (const Group& group : groups) {
    const Grid& grid = group.grid;
    if (grid.steps != first.steps || grid.simulation.step != first.simulation.step ||
        grid.simulation.log_every != first.simulation.log_every)
      refuse("log", "one time grid for all trajectories",
             words(described(first), " of scenario 0 and ", described(grid), " of scenario ", group.members.front()));
  }
}

/// Outcome, cause and leg of a run: a byte each, and the names that Python makes of two of them.
inline constexpr double kOutcomeBytes = 3.0 + 4.0 * (13 + 14);

void require_memory(std::size_t count, std::size_t rows, int points, BatchLog log) {
  const double per_scenario =
      kOutcomeBytes + 8.0 * (2.0 + kMetricNumbers + static_cast<double>(rows) * sample_numbers(points) +
                             (log == BatchLog::metrics ? 0.0 : kWeightNumbers));
  const double bytes = per_scenario * static_cast<double>(count);
  if (bytes <= kMaxBatchBytes) return;
  const double gib = 1024.0 * 1024.0 * 1024.0;
  refuse("log",
         words("a result of at most ", kMaxBatchBytes / gib, " GiB",
               log == BatchLog::metrics      ? ""
               : log == BatchLog::trajectory ? " (fewer scenarios, a larger simulation.log_every, or log \"metrics\")"
                                             : " (fewer scenarios, or log \"metrics\")"),
         words(count, " scenarios of ", per_scenario, " bytes, which make ", std::ceil(bytes / gib * 100.0) / 100.0,
               " GiB"));
}

BatchResult allocate(std::size_t count, std::size_t rows, int points, BatchLog log) {
  BatchResult result;
  result.count = count;
  result.points = points;
  result.outcome.assign(count, static_cast<std::uint8_t>(Outcome::interrupted));
  result.cause.assign(count, static_cast<std::uint8_t>(StopCause::none));
  result.limit_leg.assign(count, std::int8_t{-1});
  result.end_time = Buffer(count);
  result.stop_time = Buffer(count);
  result.metrics = Buffer(count * kMetricNumbers);
  for (const Buffer& buffer : {result.end_time, result.stop_time, result.metrics})
    std::ranges::fill(buffer.span(), kNaN);
  if (log == BatchLog::metrics) return result;
  result.rows = log == BatchLog::trajectory ? rows : 0;
  for (std::size_t q = 0; q < result.samples.size(); ++q)
    result.samples[q] = Buffer(count * rows * static_cast<std::size_t>(sample_width(q, points)));
  result.fuzzy_weights = Buffer(count * kWeightNumbers);
  return result;
}

/// Metrics that are asked for, and the groups that they are measured with.
struct Measured {
  std::array<bool, kMetricNumbers> asked{};
  MetricGroups groups;
};

/// @throws std::invalid_argument for a name that is no metric
Measured measured(const std::optional<std::vector<std::string>>& names) {
  Measured result;
  if (!names) {
    result.asked.fill(true);
    return result;
  }
  std::vector<MetricName> metrics;
  Metrics<double>::visit([&metrics](const MetricName& metric) { metrics.push_back(metric); });
  result.groups = MetricGroups::none();
  for (const std::string& name : *names) {
    const auto found = std::ranges::find_if(metrics, [&name](const MetricName& metric) { return name == metric.name; });
    if (found == metrics.end()) refuse("metrics", "names of metrics", words("\"", name, "\""));
    result.asked[static_cast<std::size_t>(found - metrics.begin())] = true;
    result.groups.add(found->group);
  }
  return result;
}

/// One batch under way.
class Batch {
 public:
  Batch(const Scenarios& scenarios, const BatchOptions& options, const Kernel& kernel)
      : scenarios_(scenarios), options_(options), kernel_(kernel), measured_(measured(options.metrics)) {
    numbers_ = detail::flat_size(scenarios.base());
    const double bytes = static_cast<double>(scenarios.count()) * static_cast<double>(numbers_) * 8.0;
    if (scenarios.same_legs()) legs_ = make_hexapod(scenarios.base().robot);
    if (bytes <= kMaxPreparedBytes) prepared_ = Buffer(scenarios.count() * numbers_);
  }

  /// Checks every scenario; the first bad one in their order is reported, whichever thread finds it.
  void check() {
    std::mutex mutex;
    std::size_t first_bad = scenarios_.count();
    std::string problem;
    const std::size_t blocks = (scenarios_.count() + kCheckedTogether - 1) / kCheckedTogether;
    const auto check_block = [&](std::size_t block) {
      Settings settings = scenarios_.base();
      const std::size_t end = std::min((block + 1) * kCheckedTogether, scenarios_.count());
      for (std::size_t i = block * kCheckedTogether; i < end; ++i) {
        try {
          prepare(settings, i, prepared_.empty() ? nullptr : prepared_.data() + i * numbers_);
        } catch (const std::invalid_argument& error) {
          const std::lock_guard lock(mutex);
          if (i < first_bad) {
            first_bad = i;
            problem = error.what();
          }
          no_further_ = true;
          return;
        }
      }
    };
    // Blocks start in their order, so that every block before a bad one has started when the flag is set.
    detail::run_blocks(blocks, options_.threads, no_further_, check_block, [this] { return watch(); });
    if (first_bad < scenarios_.count()) throw std::invalid_argument(words("scenario ", first_bad, ": ", problem));
  }

  BatchResult run() {
    const std::vector<Group> groups = grouped(scenarios_);
    if (options_.log == BatchLog::trajectory) require_one_grid(groups);
    const std::size_t rows = options_.log == BatchLog::metrics       ? 0
                             : options_.log == BatchLog::last_sample ? 1
                                                                     : grid_rows(groups.front().grid);
    const int points = scenarios_.base().target.count();
    require_memory(scenarios_.count(), rows, points, options_.log);
    BatchResult result = allocate(scenarios_.count(), rows, points, options_.log);
    if (options_.log == BatchLog::trajectory) result.time = grid_times(groups.front().grid, rows);

    std::vector<Pack> packs;
    const auto width = static_cast<std::size_t>(kernel_.lanes);
    for (const Group& group : groups) {
      total_steps_ += static_cast<long long>(group.members.size()) * group.grid.steps;
      const std::span<const std::size_t> members = group.members;
      for (std::size_t i = 0; i < members.size(); i += width)
        packs.push_back({&group.grid, members.subspan(i, std::min(width, members.size() - i))});
    }
    if (!no_further_)
      detail::run_blocks(
          packs.size(), options_.threads, no_further_, [&](std::size_t i) { run_pack(packs[i], result); },
          [this] { return watch(); });
    finish(result);
    return result;
  }

 private:
  struct Pack {
    const Grid* grid;
    std::span<const std::size_t> members;
  };

  /// Reports of a kernel on its pack while it runs.
  struct Witness {
    Batch* batch;
    long long scenarios;
    long long counted = 0;  // steps of scenarios

    static bool ask(void* context, long long steps) {
      auto& witness = *static_cast<Witness*>(context);
      witness.count(steps * witness.scenarios);
      return witness.batch->no_further_;
    }
    void count(long long steps) {
      batch->steps_ += steps - counted;
      counted = steps;
    }
  };

  void prepare(Settings& settings, std::size_t i, double* to) const {
    scenarios_.set(settings, i);
    detail::prepare(settings, legs_ ? &*legs_ : nullptr, to);
  }

  void run_pack(const Pack& pack, BatchResult& result) {
    const std::size_t n = pack.members.size();
    std::vector<double> own;
    if (prepared_.empty()) {
      own.resize(n * numbers_);
      Settings settings = scenarios_.base();
      for (std::size_t k = 0; k < n; ++k) prepare(settings, pack.members[k], own.data() + k * numbers_);
    }
    std::vector<const double*> parameters(n);
    std::vector<RunAnswer> answers(n);
    for (std::size_t k = 0; k < n; ++k) {
      const std::size_t i = pack.members[k];
      parameters[k] = prepared_.empty() ? own.data() + k * numbers_ : prepared_.data() + i * numbers_;
      answers[k] = {};
      if (options_.log == BatchLog::metrics) continue;
      answers[k].weights = result.fuzzy_weights.data() + i * kWeightNumbers;
      for (std::size_t q = 0; q < result.samples.size(); ++q)
        answers[k].columns[q] = result.samples[q].data() + i * stride(result, q);
    }
    Witness witness{this, static_cast<long long>(n)};
    RunRequest request = detail::run_request(scenarios_.base(), pack.grid->simulation);
    request.count = static_cast<int>(n);
    request.parameters = parameters.data();
    request.log_every = options_.log == BatchLog::trajectory ? pack.grid->simulation.log_every : 0;
    request.unmeasured = measured_.groups.left_out();
    request.stop = Witness::ask;
    request.context = &witness;
    request.ask_every = detail::ask_every(pack.grid->simulation, kPackStepsBetweenQuestions);
    request.answers = answers.data();
    detail::require_done(kernel_.run_pack(request));

    long long steps = 0;
    std::size_t finished = 0;
    for (std::size_t k = 0; k < n; ++k) {
      steps += answers[k].steps;
      if (answers[k].interrupted) continue;
      ++finished;
      skipped_steps_ += request.steps - answers[k].steps;
      keep(answers[k], pack.members[k], pack.grid->simulation.step, result);
    }
    witness.count(steps);
    done_ += finished;
  }

  void keep(const RunAnswer& answer, std::size_t i, double step, BatchResult& result) const {
    const auto cause = static_cast<StopCause>(answer.cause);
    result.outcome[i] = static_cast<std::uint8_t>(outcome_of(cause));
    result.cause[i] = static_cast<std::uint8_t>(cause);
    result.end_time[i] = answer.end_time;
    result.limit_leg[i] = static_cast<std::int8_t>(answer.limit_leg);
    result.stop_time[i] = static_cast<double>(answer.steps) * step;
    for (std::size_t m = 0; m < kMetricNumbers; ++m)
      if (measured_.asked[m]) result.metrics[m * result.count + i] = answer.metrics[m];
    const double* sample = answer.sample;
    for (std::size_t q = 0; options_.log == BatchLog::last_sample && q < result.samples.size(); ++q) {
      std::copy_n(sample, sample_width(q, result.points), answer.columns[q]);
      sample += sample_width(q, result.points);
    }
    for (std::size_t q = 0; options_.log == BatchLog::trajectory && q < result.samples.size(); ++q)
      std::fill(answer.columns[q] + answer.rows * sample_width(q, result.points), answer.columns[q] + stride(result, q),
                kNaN);
  }

  /// Nothing of a run that did not end stays.
  void finish(BatchResult& result) const {
    if (options_.progress) options_.progress(progress());
    if (options_.log == BatchLog::metrics || done_ == result.count) return;
    const auto clear_block = [&](std::size_t block) {
      const std::size_t end = std::min((block + 1) * kClearedTogether, result.count);
      for (std::size_t i = block * kClearedTogether; i < end; ++i)
        if (result.outcome[i] == static_cast<std::uint8_t>(Outcome::interrupted)) clear(i, result);
    };
    detail::StopFlag never = false;
    detail::run_blocks((result.count + kClearedTogether - 1) / kClearedTogether, options_.threads, never, clear_block,
                       [] { return false; });
  }

  void clear(std::size_t i, BatchResult& result) const {
    for (std::size_t q = 0; q < result.samples.size(); ++q)
      std::fill_n(result.samples[q].data() + i * stride(result, q), stride(result, q), kNaN);
    std::fill_n(result.fuzzy_weights.data() + i * kWeightNumbers, kWeightNumbers, kNaN);
  }

  /// Numbers of quantity `q` per scenario.
  std::size_t stride(const BatchResult& result, std::size_t q) const {
    return std::max<std::size_t>(result.rows, 1) * static_cast<std::size_t>(sample_width(q, result.points));
  }

  static Buffer grid_times(const Grid& grid, std::size_t rows) {
    Buffer time(rows);
    for (std::size_t row = 0; row < rows; ++row)
      time[row] = static_cast<double>(std::min(static_cast<long long>(row) * grid.simulation.log_every, grid.steps)) *
                  grid.simulation.step;
    return time;
  }

  BatchProgress progress() const { return {done_, scenarios_.count(), steps_, total_steps_ - skipped_steps_}; }

  bool watch() const {
    if (options_.progress) options_.progress(progress());
    return options_.stop_requested && options_.stop_requested();
  }

  const Scenarios& scenarios_;
  const BatchOptions& options_;
  const Kernel& kernel_;
  Measured measured_;
  std::optional<Hexapod<double>> legs_;  // of all scenarios, where they share them
  std::size_t numbers_ = 0;              // of a flattened scenario
  Buffer prepared_;                      // all flattened scenarios, or empty where they would take too much
  detail::StopFlag no_further_ = false;
  std::atomic<std::size_t> done_ = 0;
  std::atomic<long long> steps_ = 0, skipped_steps_ = 0;
  long long total_steps_ = 0;
};

}  // namespace

BatchResult simulate_batch(const Settings& base, std::span<const Variation> variations, std::size_t count,
                           const BatchOptions& options, const Kernel& kernel) {
  if (options.threads < 1) refuse("threads", "a whole number >= 1", words(options.threads));
  const Scenarios scenarios(base, variations, count);
  require_memory(count, options.log == BatchLog::metrics ? 0 : 1, base.target.count(),
                 options.log);  // before anything takes long
  Batch batch(scenarios, options, kernel);
  batch.check();
  return batch.run();
}

}  // namespace hexservo
