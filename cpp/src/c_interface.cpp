#include "hexservo.h"

#include "check.hpp"
#include "controller_output.hpp"
#include "hexservo/scenario_keys.hpp"
#include "hexservo/subnormals.hpp"
#include "plant_in_steps.hpp"
#include "run_in_steps.hpp"
#include "walk.hpp"

#include <charconv>
#include <cstring>
#include <memory>
#include <memory_resource>
#include <new>
#include <optional>
#include <utility>

#ifndef HEXSERVO_VERSION
#define HEXSERVO_VERSION "unknown"
#endif

using namespace hexservo;

namespace {

using detail::refuse;
using detail::words;

constexpr std::string_view kLawKey = "controller.law";
constexpr std::string_view kNone = "none";

/// A vector or a matrix, row by row.
template <class Derived, class Numbers>
void put_rows(const Eigen::MatrixBase<Derived>& from, Numbers&& to) {
  for (Eigen::Index row = 0; row < from.rows(); ++row)
    for (Eigen::Index column = 0; column < from.cols(); ++column) *to++ = from(row, column);
}
template <class Derived>
void put(const Eigen::MatrixBase<Derived>& from, double* to) {
  put_rows(from, to);
}

/// A number as text that reads back bit for bit.
void append(std::string& text, double number) {
  std::array<char, 32> digits;
  text.append(digits.data(), std::to_chars(digits.data(), digits.data() + digits.size(), number).ptr);
}

constexpr std::string_view kSpace = " \t\r\n";

/// Without space at the ends.
std::string_view trimmed(std::string_view text) {
  text.remove_prefix(std::min(text.find_first_not_of(kSpace), text.size()));
  return text.substr(0, text.find_last_not_of(kSpace) + 1);
}

/// What the text of a key's numbers has to be.
std::string expected_text(const ScenarioKey& key) {
  const std::string numbers = key.type == KeyType::flag                     ? "1 or 0"
                              : key.takes(1) && key.rows * key.columns == 1 ? "a number"
                                                                            : "numbers with spaces between";
  return numbers + (key.optional ? ", or none" : "");
}

/// Whether all numbers of a key are the one that the core has in place of none.
bool are_none(const ScenarioKey& key, std::span<const double> numbers) {
  return key.optional && !key.wrapped && !numbers.empty() &&
         std::ranges::all_of(numbers, [none = key.field.bound.none](double number) { return number == none; });
}

/// Sets what a caller gave: none is no numbers, not the one that stands for it in the core.
void set_given(Settings& settings, const ScenarioKey& key, std::span<const double> numbers) {
  if (are_none(key, numbers))
    refuse(key.name, detail::expected(key.field.bound, false) + ", or none", words(numbers[0]));
  set_numbers(settings, key, numbers);
}

/// Numbers with spaces between.
std::vector<double> numbers_in(const ScenarioKey& key, std::string_view text) {
  std::vector<double> numbers;
  while (true) {
    text = trimmed(text);
    if (text.empty()) return numbers;
    const std::string word(text.substr(0, text.find_first_of(kSpace)));
    text.remove_prefix(word.size());
    double number = 0.0;
#ifdef __wasm__  // whose library reads no double from characters, and has no locale but C
    char* end = nullptr;
    number = std::strtod(word.c_str(), &end);
    const bool whole = *end == '\0';
#else
    const char* last = word.data() + word.size();
    const auto [end, error] = std::from_chars(word.data() + (word[0] == '+'), last, number);
    const bool whole = end == last && error == std::errc{} && !word.starts_with("+-");
#endif
    if (!whole) refuse(key.name, expected_text(key), words('"', word, '"'));
    numbers.push_back(number);
  }
}

/// What the description of a law's key points to.
struct KeyTexts {
  std::string unit;
  std::vector<std::string> choices;
  std::vector<const char*> pointers;
};

/// Made once for all laws, then constant.
const std::vector<KeyTexts>& key_texts(LawId law) {
  static const auto all = [] {
    std::array<std::vector<KeyTexts>, kLawTraits.size()> texts;
    for (std::size_t i = 0; i < texts.size(); ++i)
      for (const ScenarioKey& key : scenario_keys(static_cast<LawId>(i))) {
        KeyTexts& to = texts[i].emplace_back();
        to.unit = key.unit;
        to.choices.assign(key.choices.begin(), key.choices.end());
        for (const std::string& choice : to.choices) to.pointers.push_back(choice.c_str());
      }
    return texts;
  }();
  return all[static_cast<std::size_t>(law)];
}

hexservo_type type_of(KeyType type) {
  switch (type) {
    case KeyType::number:
      return HEXSERVO_NUMBER;
    case KeyType::array:
      return HEXSERVO_ARRAY;
    case KeyType::whole:
      return HEXSERVO_WHOLE;
    case KeyType::flag:
      return HEXSERVO_FLAG;
    case KeyType::choice:
      return HEXSERVO_CHOICE;
    case KeyType::samples:
      return HEXSERVO_SAMPLES;
    case KeyType::seed:
      return HEXSERVO_SEED;
  }
  __builtin_unreachable();
}

hexservo_input_status status_of(InputStatus status) { return static_cast<hexservo_input_status>(status); }
static_assert(static_cast<int>(InputStatus::lost_feature) == HEXSERVO_LOST_FEATURE);
static_assert(static_cast<int>(Outcome::solver_failed) == HEXSERVO_SOLVER_FAILED);

/// Another law with its default gains; all that laws have in common stays.
void set_law(Settings& settings, std::string_view name) {
  const LawId law = law_named(name);
  if (law != settings.law()) settings.controller.gains = Settings::of(law).controller.gains;
}

void set_text(Settings& settings, std::string_view name, std::string_view given) {
  const std::string_view text = trimmed(given);
  if (name == kLawKey) return set_law(settings, text);
  const ScenarioKey& key = scenario_key(settings.law(), name);
  if (key.type == KeyType::choice) return set_choice(settings, key, text);
  if (key.type == KeyType::seed) {
    std::uint64_t seed = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), seed);
    if (text.empty() || end != text.data() + text.size() || error != std::errc{})
      refuse(key.name, "a whole number from 0 to 2^64 - 1", words('"', text, '"'));
    settings.seed = seed;
    return;
  }
  if (text == kNone) return set_numbers(settings, key, {});
  const std::vector<double> numbers = numbers_in(key, text);
  if (numbers.empty()) refuse(key.name, expected_text(key), "\"\"");
  set_given(settings, key, numbers);
}

/// Numbers of a key; those that stand for none are none.
std::vector<double> numbers_or_none(const Settings& settings, const ScenarioKey& key) {
  std::vector<double> numbers = numbers_of(settings, key);
  if (are_none(key, numbers)) numbers.clear();
  return numbers;
}

std::string text_of(const Settings& settings, std::string_view name) {
  if (name == kLawKey) return std::string(law_traits(settings.law()).name);
  const ScenarioKey& key = scenario_key(settings.law(), name);
  if (key.type == KeyType::choice) return std::string(choice_of(settings, key));
  if (key.type == KeyType::seed) return std::to_string(settings.seed);
  const std::vector<double> numbers = numbers_or_none(settings, key);
  if (numbers.empty()) return std::string(kNone);
  std::string text;
  for (const double number : numbers) {
    if (!text.empty()) text += ' ';
    append(text, number);
  }
  return text;
}

std::string_view given(const char* text) { return text == nullptr ? std::string_view{} : std::string_view(text); }

}  // namespace

struct hexservo_scenario {
  Settings settings;
  std::string message;
  std::string text;
};

namespace {

/// A key that may hold numbers, as the law has none.
const ScenarioKey& numeric_key(const Settings& settings, const char* key) {
  if (given(key) == kLawKey) refuse(std::string(kLawKey), "text, which is the name of a law", "numbers");
  return scenario_key(settings.law(), given(key));
}

/// Calls `function`; what it throws becomes the scenario's message.
template <class F>
hexservo_status guarded(hexservo_scenario& scenario, F&& function) noexcept {
  const MaskTraps masked;
  try {
    scenario.message.clear();
    function();
    return HEXSERVO_OK;
  } catch (const std::bad_alloc&) {
    scenario.message = "no memory";  // which fits without taking any
    return HEXSERVO_NO_MEMORY;
  } catch (const std::length_error&) {  // more numbers than any memory holds
    scenario.message = "no memory";
    return HEXSERVO_NO_MEMORY;
  } catch (const std::exception& error) {
    try {
      scenario.message = error.what();
    } catch (...) {
      return HEXSERVO_NO_MEMORY;
    }
    return HEXSERVO_REFUSED;
  }
}

template <class T, class... Arguments>
T* made(Arguments&&... arguments) noexcept {
  try {
    return new T(std::forward<Arguments>(arguments)...);
  } catch (...) {
    return nullptr;
  }
}

}  // namespace

struct hexservo_run {
  std::unique_ptr<detail::RunInSteps> steps;
  std::optional<Trajectory> result;  ///< once it has ended

  const RunAnswer& answer() const { return steps->answer(); }
  int points() const { return steps->request.points; }
};

namespace {

/// Turns the answer of a run that has ended into its result; without memory for words, into one without any.
void finish(hexservo_run& run) noexcept {
  try {
    run.result = run.steps->log.finish(run.steps->settings.simulation.step, run.steps->hexapod());
  } catch (...) {
    run.result.emplace().outcome = outcome_of(static_cast<StopCause>(run.answer().cause));
  }
}

/// Where a quantity stands in the newest sample.
const double* place_in(const double* sample, const double& time, hexservo_quantity quantity, int points) {
  if (quantity == HEXSERVO_TIME) return &time;
  const auto index = static_cast<size_t>(quantity) - 1;
  if (index >= kQuantities) return nullptr;
  for (size_t before = 0; before < index; ++before) sample += sample_width(before, points);
  return sample;
}

}  // namespace

struct hexservo_plant {
  std::unique_ptr<detail::PlantInSteps> steps;
};

/// Gains of any law and any number of points.
struct hexservo_gains {
  explicit hexservo_gains(int count) : points(count) {}
  virtual ~hexservo_gains() = default;
  virtual hexservo_state* state() const = 0;
  virtual size_t state_size() const = 0;
  virtual hexservo_state* state(void* memory, size_t size) const = 0;
  virtual double period() const noexcept = 0;
  virtual ControllerOutput tick(hexservo_state& state, const ControllerInputOf<kMostPoints>& input) const noexcept = 0;

  int points;  ///< of the target
};

/// State of any law.
struct hexservo_state {
  virtual ~hexservo_state() = default;
};

namespace {

template <class Law, int N>
struct StateOf final : hexservo_state {
  explicit StateOf(const ControllerGains<Law, N>& gains,
                   std::pmr::memory_resource* memory = std::pmr::get_default_resource())
      : state(initial_state(gains, memory)) {}
  ControllerState<Law, N> state;
};

/// Counts what is taken.
class Counted final : public std::pmr::memory_resource {
 public:
  size_t bytes = 0;

 private:
  void* do_allocate(size_t size, size_t alignment) override {
    bytes += size + alignment - 1;
    return std::pmr::new_delete_resource()->allocate(size, alignment);
  }
  void do_deallocate(void* taken, size_t size, size_t alignment) override {
    std::pmr::new_delete_resource()->deallocate(taken, size, alignment);
  }
  bool do_is_equal(const memory_resource& other) const noexcept override { return this == &other; }
};

/// A state with all its memory in one place, which the caller gave: it is never destroyed.
template <class Law, int N>
struct Placed {
  Placed(const ControllerGains<Law, N>& gains, void* rest, size_t size)
      : memory(rest, size, std::pmr::null_memory_resource()), state(gains, &memory) {}
  std::pmr::monotonic_buffer_resource memory;
  StateOf<Law, N> state;
};

/// Bytes that hold a T wherever they begin.
template <class T>
constexpr size_t kRoom = sizeof(T) + alignof(T) - 1;

template <class Law, int N>
struct GainsFor final : hexservo_gains {
  GainsFor(const Settings& settings, double period)
      : hexservo_gains(settings.target.count()), gains(controller_gains<Law, N>(settings, period)) {}
  hexservo_state* state() const override { return made<StateOf<Law, N>>(gains); }
  size_t state_size() const override {
    Counted taken;
    const StateOf<Law, N> one(gains, &taken);
    return kRoom<Placed<Law, N>> + taken.bytes;
  }
  hexservo_state* state(void* memory, size_t size) const override {
    using Whole = Placed<Law, N>;
    if (std::align(alignof(Whole), sizeof(Whole), memory, size) == nullptr) return nullptr;
    void* rest = static_cast<char*>(memory) + sizeof(Whole);
    return &(new (memory) Whole(gains, rest, size - sizeof(Whole)))->state;
  }
  double period() const noexcept override { return gains.period; }
  ControllerOutput tick(hexservo_state& state, const ControllerInputOf<kMostPoints>& input) const noexcept override {
    return step(gains, static_cast<StateOf<Law, N>&>(state).state,
                {input.now,
                 {input.frame.exposure, {input.frame.image.features.head<2 * N>(), input.frame.image.depth.head<N>()}},
                 input.pose,
                 input.twist,
                 input.joints});
  }
  ControllerGains<Law, N> gains;
};

/// A key that acts on the controller in `sampled` mode alone guards nothing in another one.
void require_effect(const Settings& settings) {
  if (settings.simulation.mode == LoopMode::sampled) return;
  const Settings defaults = Settings::of(settings.law());
  for (const ScenarioKey& key : scenario_keys(settings.law())) {
    if (!key.field.sampled || key.field.concern != Concern::controller) continue;
    const bool is_default = key.type == KeyType::choice ? choice_of(settings, key) == choice_of(defaults, key)
                                                        : numbers_of(settings, key) == numbers_of(defaults, key);
    if (!is_default)
      refuse(key.name, "its default in continuous mode, where it has no effect on the controller",
             "another value: set simulation.mode to sampled");
  }
}

/// Gains of any law, on the heap where there is no memory for them.
hexservo_gains* gains_of(const Settings& settings, double period, void* memory, size_t size) {
  require_effect(settings);
  const double chosen = period == 0.0 ? settings.simulation.step : period;
  return with_loop(settings,
                   [&]<class Law, int N>(std::type_identity<Law>, std::integral_constant<int, N>) -> hexservo_gains* {
                     using Gains = GainsFor<Law, N>;
                     if (memory == nullptr) return new Gains(settings, chosen);
                     return new (std::align(alignof(Gains), sizeof(Gains), memory, size)) Gains(settings, chosen);
                   });
}

/// N numbers, the first of them from where they are; unknown where there are none.
template <int N>
Vector<double, N> read(const double* from, int count = N) noexcept {
  Vector<double, N> numbers = Vector<double, N>::Constant(std::numeric_limits<double>::quiet_NaN());
  if (from != nullptr) std::copy_n(from, count, numbers.data());
  return numbers;
}

}  // namespace

extern "C" {

int hexservo_interface(void) { return HEXSERVO_INTERFACE; }
const char* hexservo_version(void) { return HEXSERVO_VERSION; }

// --- scenarios

hexservo_scenario* hexservo_scenario_create(void) { return made<hexservo_scenario>(); }

hexservo_scenario* hexservo_scenario_copy(const hexservo_scenario* scenario) {
  try {
    return new hexservo_scenario{scenario->settings, {}, {}};
  } catch (...) {
    return nullptr;
  }
}

void hexservo_scenario_destroy(hexservo_scenario* scenario) { delete scenario; }

const char* hexservo_scenario_message(const hexservo_scenario* scenario) { return scenario->message.c_str(); }

size_t hexservo_scenario_key_count(const hexservo_scenario* scenario) {
  try {
    return scenario_keys(scenario->settings.law()).size();
  } catch (...) {  // too little memory for the table
    return 0;
  }
}

int hexservo_scenario_key(const hexservo_scenario* scenario, size_t index, hexservo_key* key) try {
  const LawId law = scenario->settings.law();
  const std::vector<ScenarioKey>& keys = scenario_keys(law);
  if (index >= keys.size()) return 0;
  const ScenarioKey& from = keys[index];
  const KeyTexts& texts = key_texts(law)[index];
  const Bound& bound = from.field.bound;
  *key = {from.name.c_str(), texts.unit.c_str(),    type_of(from.type),   from.rows,  from.columns,
          from.optional,     from.field.sampled,    bound.least,          bound.most, bound.above,
          bound.below,       texts.pointers.size(), texts.pointers.data()};
  if (from.type == KeyType::samples) key->rows = 0, key->columns = from.field.columns;
  if (from.per_point > 0) key->rows = from.per_point * scenario->settings.target.count() / from.columns;
  return 1;
} catch (...) {  // too little memory for the table
  return 0;
}

size_t hexservo_scenario_points(const hexservo_scenario* scenario) {
  return static_cast<size_t>(scenario->settings.target.count());
}

hexservo_status hexservo_scenario_set_numbers(hexservo_scenario* scenario, const char* key, const double* numbers,
                                              size_t count) {
  return guarded(*scenario, [&] {
    if (numbers == nullptr && count > 0) refuse(std::string(given(key)), words(count, " numbers"), "a null pointer");
    set_given(scenario->settings, numeric_key(scenario->settings, key), {numbers, count});
  });
}

hexservo_status hexservo_scenario_set_number(hexservo_scenario* scenario, const char* key, double number) {
  return hexservo_scenario_set_numbers(scenario, key, &number, 1);
}

hexservo_status hexservo_scenario_set_text(hexservo_scenario* scenario, const char* key, const char* text) {
  return guarded(*scenario, [&] { set_text(scenario->settings, given(key), given(text)); });
}

hexservo_status hexservo_scenario_get_numbers(hexservo_scenario* scenario, const char* key, double* numbers,
                                              size_t room, size_t* count) {
  if (count != nullptr) *count = 0;
  return guarded(*scenario, [&] {
    const ScenarioKey& asked = numeric_key(scenario->settings, key);
    if (asked.type == KeyType::seed || asked.type == KeyType::choice)
      refuse(asked.name, "a key that holds numbers (its text can be asked for)", "one that does not");
    const std::vector<double> found = numbers_or_none(scenario->settings, asked);
    if (count != nullptr) *count = found.size();
    if (numbers != nullptr) std::copy_n(found.begin(), std::min(room, found.size()), numbers);
  });
}

hexservo_status hexservo_scenario_get_text(hexservo_scenario* scenario, const char* key, const char** text) {
  *text = nullptr;
  return guarded(*scenario, [&] {
    scenario->text = text_of(scenario->settings, given(key));
    *text = scenario->text.c_str();
  });
}

hexservo_status hexservo_scenario_validate(hexservo_scenario* scenario) {
  return guarded(*scenario, [&] { check_settings(scenario->settings); });
}

// --- runs

hexservo_status hexservo_run_create(hexservo_scenario* scenario, hexservo_run** run) {
  *run = nullptr;
  return guarded(*scenario, [&] { *run = new hexservo_run{detail::started(scenario->settings), {}}; });
}

void hexservo_run_destroy(hexservo_run* run) { delete run; }

int64_t hexservo_run_advance(hexservo_run* run, int64_t steps) {
  if (!run->result && !run->steps->advance(steps < 0 ? run->steps->request.steps : steps)) finish(*run);
  return run->answer().steps;
}

hexservo_outcome hexservo_run_outcome(const hexservo_run* run) {
  return run->result ? static_cast<hexservo_outcome>(run->result->outcome) : HEXSERVO_RUNNING;
}

const char* hexservo_outcome_name(hexservo_outcome outcome) {
  switch (outcome) {
    case HEXSERVO_RUNNING:
      return "running";
    case HEXSERVO_COMPLETED:
      return "completed";
    case HEXSERVO_DIVERGED:
      return "diverged";
    case HEXSERVO_BEHIND_CAMERA:
      return "behind_camera";
    case HEXSERVO_FEATURE_LOST:
      return "feature_lost";
    case HEXSERVO_LEG_LIMIT:
      return "leg_limit";
    case HEXSERVO_SINGULAR:
      return "singular";
    case HEXSERVO_SOLVER_FAILED:
      return "solver_failed";
  }
  return "";
}

const char* hexservo_run_detail(const hexservo_run* run) { return run->result ? run->result->detail.c_str() : ""; }

double hexservo_run_time(const hexservo_run* run) { return run->answer().end_time; }

size_t hexservo_run_rows(const hexservo_run* run) { return static_cast<size_t>(run->answer().rows); }

size_t hexservo_run_width(const hexservo_run* run, hexservo_quantity quantity) {
  if (quantity == HEXSERVO_TIME) return 1;
  const auto index = static_cast<size_t>(quantity) - 1;
  return index < kQuantities ? static_cast<size_t>(sample_width(index, run->points())) : 0;
}

const double* hexservo_run_samples(const hexservo_run* run, hexservo_quantity quantity) {
  const RunAnswer& answer = run->answer();
  if (quantity == HEXSERVO_TIME) return answer.time;
  const auto index = static_cast<size_t>(quantity) - 1;
  return index < kQuantities ? answer.columns[index] : nullptr;
}

const double* hexservo_run_newest(const hexservo_run* run, hexservo_quantity quantity) {
  const RunAnswer& answer = run->answer();
  return place_in(answer.sample, answer.end_time, quantity, run->points());
}

size_t hexservo_metric_count(void) { return kMetricNumbers; }

const char* hexservo_metric_name(size_t index) {
  const char* found = nullptr;
  size_t place = 0;
  Metrics<double>::visit([&](const char* name) { found = place++ == index ? name : found; });
  return found;
}

const double* hexservo_run_metrics(const hexservo_run* run) { return run->answer().metrics; }

size_t hexservo_run_event_count(const hexservo_run* run) { return run->result ? run->result->events.size() : 0; }

int hexservo_run_event(const hexservo_run* run, size_t index, hexservo_limit_event* event) {
  if (index >= hexservo_run_event_count(run)) return 0;
  const LimitEvent& from = run->result->events[index];
  *event = {static_cast<hexservo_limit>(from.kind), from.leg, from.first_time, from.peak, from.limit};
  return 1;
}

void hexservo_run_scene(const hexservo_run* run, hexservo_scene* scene) {
  const Hexapod<double>& hexapod = run->steps->hexapod();
  const PlatformCamera<double> mounted(run->steps->camera());
  put(hexapod.base_joints_B.transpose(), scene->base_joints[0]);
  put(hexapod.platform_joints_E.transpose(), scene->platform_joints[0]);
  put(hexapod.home_position, scene->home_position);
  put(hexapod.home_quaternion, scene->home_quaternion);
  put(mounted.placement.p_MC, scene->camera_position);
  put(mounted.placement.R_MC, scene->camera_attitude[0]);
  scene->focal = mounted.focal;
  scene->camera_on_base = mounted.placement.on_base() ? 1 : 0;
}

void hexservo_run_target(const hexservo_run* run, double* points) { run->steps->write_points(points); }

void hexservo_run_goal(const hexservo_run* run, double* features) { run->steps->write_goal(features); }

// --- the controller's tick

hexservo_status hexservo_gains_create(hexservo_scenario* scenario, double period, hexservo_gains** gains) {
  *gains = nullptr;
  return guarded(*scenario, [&] { *gains = gains_of(scenario->settings, period, nullptr, 0); });
}

void hexservo_gains_destroy(hexservo_gains* gains) { delete gains; }

double hexservo_gains_period(const hexservo_gains* gains) { return gains->period(); }

size_t hexservo_gains_points(const hexservo_gains* gains) { return static_cast<size_t>(gains->points); }

size_t hexservo_gains_size(const hexservo_scenario* scenario) {
  return with_loop(scenario->settings, []<class Law, int N>(std::type_identity<Law>, std::integral_constant<int, N>) {
    static_assert(kRoom<GainsFor<Law, N>> <= sizeof(hexservo_gains_memory));
    return kRoom<GainsFor<Law, N>>;
  });
}

hexservo_status hexservo_gains_place(hexservo_scenario* scenario, double period, void* memory, size_t size,
                                     hexservo_gains** gains) {
  *gains = nullptr;
  return guarded(*scenario, [&] {
    if (memory == nullptr) refuse("memory", "a place for the gains", "a null pointer");
    const size_t needed = hexservo_gains_size(scenario);
    if (size < needed) refuse("size", words(needed, " bytes for the gains of this scenario"), words(size));
    *gains = gains_of(scenario->settings, period, memory, size);
  });
}

hexservo_state* hexservo_state_create(const hexservo_gains* gains) { return gains->state(); }

size_t hexservo_state_size(const hexservo_gains* gains) {
  try {
    return gains->state_size();
  } catch (...) {
    return 0;
  }
}

hexservo_state* hexservo_state_place(const hexservo_gains* gains, void* memory, size_t size) {
  try {
    return gains->state(memory, size);
  } catch (...) {  // too little memory
    return nullptr;
  }
}

void hexservo_state_destroy(hexservo_state* state) { delete state; }

void hexservo_input_clear(hexservo_input* input) {
  *input = {};
  input->now = input->exposure = kUnknown;
  for (double* numbers : {input->twist, input->leg_lengths, input->leg_rates}) std::fill_n(numbers, 6, kUnknown);
  std::fill_n(input->position, 3, kUnknown);
  std::fill_n(input->quaternion, 4, kUnknown);
}

void hexservo_tick(const hexservo_gains* gains, hexservo_state* state, const hexservo_input* input,
                   hexservo_output* output) {
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();  // no frame
  const ControllerInputOf<kMostPoints> taken{
      input->now,
      {input->features != nullptr ? input->exposure : kNone,
       {read<2 * kMostPoints>(input->features, 2 * gains->points), read<kMostPoints>(input->depth, gains->points)}},
      {read<3>(input->position), read<4>(input->quaternion)},
      read<6>(input->twist),
      {read<6>(input->leg_lengths), read<6>(input->leg_rates)}};
  const ControllerOutput out = gains->tick(*state, taken);
  put(out.wrench, output->wrench);
  put(out.leg_forces, output->leg_forces);
  put(out.fuzzy_output, output->fuzzy_output);
  put(out.leg_positions, output->leg_positions);
  put(Vector3<double>(out.latency.estimate, out.latency.least, out.latency.most), output->latency);
  output->status = status_of(out.status);
  output->saturated = out.saturated ? 1 : 0;
}

// --- a plant without its controller

hexservo_status hexservo_plant_create(hexservo_scenario* scenario, hexservo_plant** plant) {
  *plant = nullptr;
  return guarded(*scenario, [&] { *plant = new hexservo_plant{detail::commanded_plant(scenario->settings)}; });
}

void hexservo_plant_destroy(hexservo_plant* plant) { delete plant; }

void hexservo_plant_sense(const hexservo_plant* plant, hexservo_input* input) {
  const ControllerInputOf<kMostPoints>& sensed = plant->steps->sensed;
  input->now = sensed.now;
  input->exposure = sensed.frame.exposure;
  input->features = sensed.frame.image.features.data();
  input->depth = sensed.frame.image.depth.data();
  put(sensed.pose.position, input->position);
  put(sensed.pose.quaternion, input->quaternion);
  put(sensed.twist, input->twist);
  put(sensed.joints.lengths, input->leg_lengths);
  put(sensed.joints.rates, input->leg_rates);
}

int hexservo_plant_command(hexservo_plant* plant, const double* numbers) {
  detail::PlantInSteps& steps = *plant->steps;
  if (steps.cause == StopCause::none) {
    const Vector6<double> command = read<6>(numbers);
    if (command.allFinite())
      steps.command(command);
    else
      steps.cause = StopCause::not_finite;
  }
  return steps.cause == StopCause::none ? 1 : 0;
}

hexservo_outcome hexservo_plant_outcome(const hexservo_plant* plant) {
  if (plant->steps->cause == StopCause::none) return HEXSERVO_RUNNING;
  return static_cast<hexservo_outcome>(outcome_of(plant->steps->cause));
}

const double* hexservo_plant_newest(const hexservo_plant* plant, hexservo_quantity quantity) {
  const detail::PlantInSteps& steps = *plant->steps;
  return place_in(steps.sample.data(), steps.time, quantity, steps.points);
}

}  // extern "C"
