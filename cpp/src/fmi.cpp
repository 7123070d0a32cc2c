/// Functional Mock-up Units for co-simulation, FMI 2.0 and 3.0, on the C interface (docs/fmu.md).
///
/// One library serves every unit: what it is stands in `resources/model.txt`, which `hexservo export --fmu` writes. Its
/// lines are
///
///     hexservo model 1
///     token TOKEN
///     what loop | plant | controller
///     time                                   one line per variable; the value reference counts from 0
///     parameter real | whole | flag | text KEY INDEX
///     input real NAME INDEX START
///     output real | whole NAME INDEX
///     scenario
///     KEY VALUE                              as `hexservo show --flat` prints them, to the end
#include "hexservo.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <functional>
#include <limits>
#include <locale>
#include <map>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

namespace {

constexpr double kWhole = 1e-6;      // of a tick: a communication step may be so far from a whole number of them
constexpr double kSameTime = 0.1;    // likewise: times that a caller has added up may be so far from those of the ticks
constexpr double kMostTicks = 1e15;  // of a communication step

enum class Role { time, parameter, input, output };
enum class Type { real, whole, flag, text };

struct Variable {
  Role role = Role::time;
  Type type = Type::real;
  std::string name;               ///< key of a parameter, else name of a signal
  std::size_t index = 0;          ///< in it
  double start = 0.0;             ///< of an input
  const double* place = nullptr;  ///< of an output, while the model exists
};

/// What FMI calls a failure of this call.
[[noreturn]] void fail(const std::string& text) { throw std::runtime_error(text); }

std::string with_numbers(const char* format, double first, double second) {
  char text[200];
  std::snprintf(text, sizeof text, format, first, second);
  return text;
}

template <auto Destroy>
struct Destroyer {
  template <class T>
  void operator()(T* handle) const noexcept {
    Destroy(handle);
  }
};
using Scenario = std::unique_ptr<hexservo_scenario, Destroyer<hexservo_scenario_destroy>>;
using Run = std::unique_ptr<hexservo_run, Destroyer<hexservo_run_destroy>>;
using Plant = std::unique_ptr<hexservo_plant, Destroyer<hexservo_plant_destroy>>;
using Gains = std::unique_ptr<hexservo_gains, Destroyer<hexservo_gains_destroy>>;
using State = std::unique_ptr<hexservo_state, Destroyer<hexservo_state_destroy>>;

void check(hexservo_status status, const Scenario& scenario) {
  if (status != HEXSERVO_OK) fail(hexservo_scenario_message(scenario.get()));
}

bool is_rotary(const Scenario& scenario) {
  const char* legs = "";
  check(hexservo_scenario_get_text(scenario.get(), "robot.legs", &legs), scenario);
  return std::string(legs) == "rotary";
}

double number_of(const Scenario& scenario, const char* key) {
  double number = 0.0;
  std::size_t count = 0;
  check(hexservo_scenario_get_numbers(scenario.get(), key, &number, 1, &count), scenario);
  return number;
}

/// Where the outputs of a model are, by name. They stay there.
using Places = std::map<std::string, const double*>;
using Inputs = std::map<std::string, std::vector<double>>;

/// Names of `hexservo_quantity` from 1.
constexpr std::array kQuantities = {"feature_error", "depth",        "position",    "quaternion", "twist",
                                    "wrench",        "fuzzy_output", "leg_lengths", "leg_forces"};

/// What a unit computes, from its parameters on.
class Model {
 public:
  Model() = default;
  virtual ~Model() = default;
  Model(const Model&) = delete;
  Model& operator=(const Model&) = delete;

  virtual Places places() const = 0;
  /// Goes on by `count` ticks from the tick `from`.
  /// @return empty, or why it cannot go on
  virtual std::string advance(std::int64_t from, std::int64_t count) = 0;
  /// Of the last good sample, since the start [s]; where a model ends by itself.
  virtual double time() const { return std::numeric_limits<double>::infinity(); }
};

/// Why a model that has this outcome cannot go on; empty where it can.
std::string end_of(hexservo_outcome outcome) {
  if (outcome == HEXSERVO_RUNNING || outcome == HEXSERVO_COMPLETED) return {};
  return std::string("the run has ended: ") + hexservo_outcome_name(outcome);
}

/// Plant and controller.
class Loop final : public Model {
 public:
  Loop(const Scenario& scenario, double start_time) : start_time_(start_time), is_rotary_(is_rotary(scenario)) {
    // No row of the log is read: it has its first and last ones alone.
    const double steps = number_of(scenario, "simulation.duration") / number_of(scenario, "simulation.step");
    if (std::isfinite(steps)) {  // otherwise the run is refused for its own reason
      const double rows_apart = std::clamp(std::round(steps), 1.0, 1e9);
      check(hexservo_scenario_set_number(scenario.get(), "simulation.log_every", rows_apart), scenario);
    }
    hexservo_run* run = nullptr;
    check(hexservo_run_create(scenario.get(), &run), scenario);
    run_.reset(run);
    look();
  }

  Places places() const override {
    Places places = {{"metrics", hexservo_run_metrics(run_.get())}, {"outcome", &outcome_}, {"end_time", &end_time_}};
    for (std::size_t i = 0; i < kQuantities.size(); ++i)
      places[kQuantities[i]] = hexservo_run_newest(run_.get(), static_cast<hexservo_quantity>(i + 1));
    return places;
  }

  std::string advance(std::int64_t, std::int64_t count) override {
    hexservo_run_advance(run_.get(), count);
    look();
    const hexservo_outcome outcome = hexservo_run_outcome(run_.get());
    const std::string end = end_of(outcome);
    return end.empty() ? end
                       : end + ": " + hexservo_run_detail(run_.get()) + (outcome == HEXSERVO_LEG_LIMIT ? value() : "");
  }

  double time() const override { return hexservo_run_time(run_.get()); }

 private:
  /// What the leg that ended the run had, and what its limit allows.
  std::string value() const {
    hexservo_limit_event event{};
    const std::size_t count = hexservo_run_event_count(run_.get());
    if (count == 0 || hexservo_run_event(run_.get(), count - 1, &event) == 0) return {};
    const char* unit = "rad";
    if (event.limit == HEXSERVO_STROKE && !is_rotary_) unit = "m";
    if (event.limit == HEXSERVO_SPEED) unit = is_rotary_ ? "rad/s" : "m/s";
    return with_numbers(" (%.6g of %.6g ", event.peak, event.largest) + unit + ")";
  }

  void look() {
    outcome_ = static_cast<double>(hexservo_run_outcome(run_.get()));
    end_time_ = start_time_ + hexservo_run_time(run_.get());
  }

  Run run_;
  double start_time_, outcome_ = 0.0, end_time_ = 0.0;
  bool is_rotary_;
};

/// Everything but the controller.
class Machine final : public Model {
 public:
  Machine(const Scenario& scenario, double start_time, const Inputs& inputs)
      : start_time_(start_time),
        points_(hexservo_scenario_points(scenario.get())),
        command_(inputs.begin()->second.data()) {  // wrench, or leg_positions
    features_.resize(2 * points_);
    depth_.resize(points_);
    hexservo_plant* plant = nullptr;
    check(hexservo_plant_create(scenario.get(), &plant), scenario);
    plant_.reset(plant);
    look();
  }

  Places places() const override {
    return {{"features", features_.data()},
            {"depth", depth_.data()},
            {"exposure", &exposure_},
            {"position", sensed_.position},
            {"quaternion", sensed_.quaternion},
            {"twist", sensed_.twist},
            {"leg_lengths", sensed_.leg_lengths},
            {"leg_rates", sensed_.leg_rates},
            {"feature_error", hexservo_plant_newest(plant_.get(), HEXSERVO_FEATURE_ERROR)},
            {"leg_forces", hexservo_plant_newest(plant_.get(), HEXSERVO_LEG_FORCES)},
            {"outcome", &outcome_}};
  }

  std::string advance(std::int64_t, std::int64_t count) override {
    int goes_on = 1;
    for (; count > 0 && goes_on; --count) {
      goes_on = hexservo_plant_command(plant_.get(), command_);
      look();
    }
    return end_of(hexservo_plant_outcome(plant_.get()));
  }

  double time() const override { return *hexservo_plant_newest(plant_.get(), HEXSERVO_TIME); }

 private:
  void look() {
    hexservo_plant_sense(plant_.get(), &sensed_);
    outcome_ = static_cast<double>(hexservo_plant_outcome(plant_.get()));
    if (!(sensed_.exposure >= 0.0)) return;  // no frame has arrived
    exposure_ = start_time_ + sensed_.exposure;
    std::copy_n(sensed_.features, 2 * points_, features_.begin());
    std::copy_n(sensed_.depth, points_, depth_.begin());
  }

  Plant plant_;
  double start_time_;
  std::size_t points_;
  const double* command_;
  hexservo_input sensed_;
  std::vector<double> features_, depth_;  ///< of the newest frame
  double exposure_ = -1.0, outcome_ = 0.0;
};

/// The controller's tick, from sensors to the wrench.
class Controller final : public Model {
 public:
  Controller(const Scenario& scenario, double start_time, const Inputs& inputs)
      : start_time_(start_time), inputs_(inputs) {
    hexservo_gains* gains = nullptr;
    check(hexservo_gains_create(scenario.get(), 0.0, &gains), scenario);
    gains_.reset(gains);
    state_ = initial_state();
    // Before the first tick the outputs are those of a tick without a frame, which leaves no trace.
    const State trial = initial_state();
    tick(trial, 0, false);
    show();
  }

  Places places() const override {
    return {{"wrench", output_.wrench},  {"leg_forces", output_.leg_forces}, {"fuzzy_output", output_.fuzzy_output},
            {"status", &status_},        {"saturated", &saturated_},         {"leg_positions", output_.leg_positions},
            {"latency", output_.latency}};
  }

  std::string advance(std::int64_t from, std::int64_t count) override {
    for (std::int64_t place = from; place < from + count; ++place) tick(state_, place, true);
    show();
    return {};
  }

 private:
  State initial_state() const {
    State state(hexservo_state_create(gains_.get()));
    if (!state) fail("no memory");
    return state;
  }

  /// @param looks whether a frame that has not been seen is one of this tick
  void tick(const State& state, std::int64_t place, bool looks) {
    hexservo_input input;
    hexservo_input_clear(&input);
    input.now = start_time_ + static_cast<double>(place) * hexservo_gains_period(gains_.get());
    if (looks && *exposure_ >= 0.0 && *exposure_ != last_) {
      input.exposure = last_ = *exposure_;
      input.features = features_;
      input.depth = depth_;
    }
    std::copy_n(position_, 3, input.position);
    std::copy_n(quaternion_, 4, input.quaternion);
    std::copy_n(twist_, 6, input.twist);
    std::copy_n(leg_lengths_, 6, input.leg_lengths);
    std::copy_n(leg_rates_, 6, input.leg_rates);
    hexservo_tick(gains_.get(), state.get(), &input, &output_);
  }

  void show() {
    status_ = static_cast<double>(output_.status);
    saturated_ = static_cast<double>(output_.saturated);
  }

  const double* of(const char* name) const { return inputs_.at(name).data(); }

  double start_time_;
  const Inputs& inputs_;
  Gains gains_;
  State state_;
  const double *exposure_ = of("exposure"), *features_ = of("features"), *depth_ = of("depth"),
               *position_ = of("position"), *quaternion_ = of("quaternion"), *twist_ = of("twist"),
               *leg_lengths_ = of("leg_lengths"), *leg_rates_ = of("leg_rates");
  double last_ = std::numeric_limits<double>::quiet_NaN();  ///< exposure of the newest frame [s]
  hexservo_output output_{};
  double status_ = 0.0, saturated_ = 0.0;
};

/// One instance of a unit.
class Unit {
 public:
  using Log = std::function<void(bool failed, const char* message)>;

  /// @param may_return_early from a step within which the run ends
  Unit(const std::string& folder, const std::string& token, Log log, bool may_return_early)
      : log_(std::move(log)), may_return_early_(may_return_early) {
    const std::string path = folder + "/model.txt";
    std::ifstream file(path);
    if (!file) fail(path + ": expected the model of this unit, but the file cannot be read");
    std::string line;
    std::getline(file, line);
    if (line != "hexservo model 1") fail(path + ": expected \"hexservo model 1\" first, got \"" + line + '"');
    initial_.reset(hexservo_scenario_create());
    if (!initial_) fail("no memory");
    while (std::getline(file, line) && line != "scenario") read(line, token);
    while (std::getline(file, line)) {
      const std::size_t space = line.find(' ');
      if (space == std::string::npos) continue;
      check(hexservo_scenario_set_text(initial_.get(), line.substr(0, space).c_str(), line.c_str() + space + 1),
            initial_);
    }
    reset();
  }

  void log(bool failed, const std::string& message) const {
    if (log_) log_(failed, message.c_str());
  }

  /// As after its making.
  void reset() {
    model_.reset();
    scenario_.reset(hexservo_scenario_copy(initial_.get()));
    if (!scenario_) fail("no memory");
    stage_ = Stage::made;
    ended_ = false;
    ticks_ = 0;
    start_time_ = 0.0;
    for (const Variable& variable : variables_)
      if (variable.role == Role::input) {
        std::vector<double>& signal = inputs_[variable.name];
        signal.resize(std::max(signal.size(), variable.index + 1));
        signal[variable.index] = variable.start;
      }
  }

  void set_start_time(double time) {
    if (is_initialised()) fail("the unit is initialised already: expected a reset before another start time");
    if (!(time >= 0.0 && std::isfinite(time)))
      fail("start time: expected 0 s or later, since exposures before 0 stand for no frame");
    model_.reset();
    start_time_ = time;
  }

  void begin_initialisation() {
    if (stage_ != Stage::made) fail("the unit is initialised already: expected a reset first");
    stage_ = Stage::initialising;
  }

  /// Parameters are fixed from here on.
  void start() {
    if (stage_ != Stage::initialising) fail("expected the beginning of an initialisation before its end");
    prepare();
    stage_ = Stage::stepping;
  }

  void terminate() { stage_ = Stage::terminated; }

  /// Goes on by a time, a whole number of ticks.
  /// @param from where the caller is [s]
  /// @return whether it goes on after that
  bool advance(double from, double time) {
    if (!is_initialised()) fail("expected the initialisation before a step");
    if (stage_ == Stage::terminated) fail("the unit is terminated: expected a reset before another step");
    if (ended_) fail("the run has ended: expected no further step");
    if (!(std::abs(from - this->time()) <= kSameTime * period_))
      fail(with_numbers("communication point: expected that of the unit, %.17g s, got %.17g s", this->time(), from));
    const double ticks = time / period_;
    const double whole = std::round(ticks);
    if (!(whole >= 1.0 && whole <= kMostTicks && std::abs(ticks - whole) <= kWhole))
      fail(with_numbers("communication step: expected a whole number of simulation.step, %.17g s each, got %.17g s",
                        period_, time));
    const auto count = static_cast<std::int64_t>(whole);
    const std::string end = model_->advance(ticks_, count);
    ticks_ += count;
    ended_ = !end.empty();
    if (ended_) {
      ticks_ = std::min(ticks_, static_cast<std::int64_t>(std::llround(model_->time() / period_)));
      log(false, end);
    }
    return !ended_;
  }

  bool ended() const noexcept { return ended_; }
  bool may_return_early() const noexcept { return may_return_early_; }
  double time() const noexcept { return start_time_ + static_cast<double>(ticks_) * period_; }

  double number(unsigned reference, Type type) {
    const Variable& variable = variable_at(reference, type);
    switch (variable.role) {
      case Role::time:
        return time();
      case Role::parameter:
        return parameter(variable)[variable.index];
      case Role::input:
        return inputs_[variable.name][variable.index];
      case Role::output:
        break;
    }
    if (!model_) prepare();
    return *variable.place;
  }

  void set_number(unsigned reference, Type type, double number) {
    const Variable& variable = variable_at(reference, type);
    if (variable.role == Role::input) {
      inputs_[variable.name][variable.index] = number;
      if (!is_initialised()) model_.reset();  // whose outputs depend on it
      return;
    }
    require_free(variable);
    std::vector<double> numbers = parameter(variable);
    if (numbers[variable.index] == number) return;  // a tool may set what is there: a number that stands for none, too
    numbers[variable.index] = number;
    check(hexservo_scenario_set_numbers(scenario_.get(), variable.name.c_str(), numbers.data(), numbers.size()),
          scenario_);
    model_.reset();
  }

  /// Holds until the next call with this unit.
  const char* text(unsigned reference) {
    const char* found = nullptr;
    const Variable& variable = variable_at(reference, Type::text);
    check(hexservo_scenario_get_text(scenario_.get(), variable.name.c_str(), &found), scenario_);
    return (texts_[variable.name] = found).c_str();
  }

  void set_text(unsigned reference, const char* text) {
    const Variable& variable = variable_at(reference, Type::text);
    require_free(variable);
    check(hexservo_scenario_set_text(scenario_.get(), variable.name.c_str(), text), scenario_);
    model_.reset();
  }

 private:
  void read(const std::string& line, const std::string& token) {
    std::istringstream words(line);
    words.imbue(std::locale::classic());  // whatever the program around has chosen
    std::string first, type;
    words >> first;
    if (first == "token") {
      words >> type;
      if (type != token) fail("expected the instantiation token " + type + ", got " + token);
      return;
    }
    if (first == "what") {
      words >> what_;
      return;
    }
    Variable variable;
    if (first == "time") {
      variable.name = first;
    } else {
      variable.role = first == "parameter" ? Role::parameter : first == "input" ? Role::input : Role::output;
      words >> type >> variable.name >> variable.index;
      variable.type = type == "real"    ? Type::real
                      : type == "whole" ? Type::whole
                      : type == "flag"  ? Type::flag
                                        : Type::text;
      if (variable.role == Role::input) words >> variable.start;
      if (!words) fail("model.txt: expected a variable, got \"" + line + '"');
    }
    variables_.push_back(variable);
  }

  /// Makes the model of the parameters as they are. Outputs can be asked for before these are fixed.
  void prepare() {
    if (model_) return;
    period_ = number_of(scenario_, "simulation.step");
    if (what_ == "loop")
      model_ = std::make_unique<Loop>(scenario_, start_time_);
    else if (what_ == "plant")
      model_ = std::make_unique<Machine>(scenario_, start_time_, inputs_);
    else
      model_ = std::make_unique<Controller>(scenario_, start_time_, inputs_);
    const Places places = model_->places();
    for (Variable& variable : variables_)
      if (variable.role == Role::output) variable.place = places.at(variable.name) + variable.index;
  }

  const Variable& variable_at(unsigned reference, Type type) const {
    if (reference >= variables_.size() || variables_[reference].type != type)
      fail("value reference " + std::to_string(reference) + ": no variable of this type has it");
    return variables_[reference];
  }

  void require_free(const Variable& variable) const {
    if (variable.role != Role::parameter) fail(variable.name + ": expected a parameter or an input to set");
    if (is_initialised()) fail(variable.name + ": expected before the end of the initialisation, for it is fixed");
  }

  bool is_initialised() const noexcept { return stage_ == Stage::stepping || stage_ == Stage::terminated; }

  std::vector<double> parameter(const Variable& variable) const {
    std::size_t count = 0;
    check(hexservo_scenario_get_numbers(scenario_.get(), variable.name.c_str(), nullptr, 0, &count), scenario_);
    std::vector<double> numbers(std::max(count, variable.index + 1), std::numeric_limits<double>::quiet_NaN());
    check(hexservo_scenario_get_numbers(scenario_.get(), variable.name.c_str(), numbers.data(), count, &count),
          scenario_);
    return numbers;
  }

  Log log_;
  bool may_return_early_;
  std::string what_;
  std::vector<Variable> variables_;
  Scenario initial_, scenario_;
  Inputs inputs_;
  std::unique_ptr<Model> model_;
  std::map<std::string, std::string> texts_;
  enum class Stage { made, initialising, stepping, terminated } stage_ = Stage::made;
  bool ended_ = false;
  double period_ = 0.0, start_time_ = 0.0;
  std::int64_t ticks_ = 0;
};

/// fmi2Status and fmi3Status alike.
enum Status : int { ok = 0, warning = 1, discard = 2, error = 3 };

/// Calls `function`, which may return a status; what it throws goes to the log.
template <class F>
Status guarded(void* instance, F&& function) noexcept {
  auto* unit = static_cast<Unit*>(instance);
  if (unit == nullptr) return error;
  try {
    if constexpr (std::is_same_v<std::invoke_result_t<F, Unit&>, Status>) {
      return function(*unit);
    } else {
      function(*unit);
      return ok;
    }
  } catch (const std::exception& caught) {
    try {
      unit->log(true, caught.what());
    } catch (...) {
    }
    return error;
  } catch (...) {
    return error;
  }
}

using Reference = unsigned int;

template <class T>
Status get(void* instance, Type type, const Reference* references, std::size_t count, T* values) {
  return guarded(instance, [&](Unit& unit) {
    for (std::size_t i = 0; i < count; ++i) values[i] = static_cast<T>(unit.number(references[i], type));
  });
}

template <class T>
Status set(void* instance, Type type, const Reference* references, std::size_t count, const T* values) {
  return guarded(instance, [&](Unit& unit) {
    for (std::size_t i = 0; i < count; ++i) unit.set_number(references[i], type, static_cast<double>(values[i]));
  });
}

Status get_texts(void* instance, const Reference* references, std::size_t count, const char** values) {
  return guarded(instance, [&](Unit& unit) {
    for (std::size_t i = 0; i < count; ++i) values[i] = unit.text(references[i]);
  });
}

Status set_texts(void* instance, const Reference* references, std::size_t count, const char* const* values) {
  return guarded(instance, [&](Unit& unit) {
    for (std::size_t i = 0; i < count; ++i) unit.set_text(references[i], values[i]);
  });
}

/// The path of a URI file:///path or file:/path, with its %20 and the like; what is no such URI as it stands.
std::string path_of(const char* uri) {
  std::string text = uri == nullptr ? "" : uri;
  if (text.starts_with("file://"))
    text.erase(0, std::min(text.find('/', 7), text.size()));  // with the host
  else if (text.starts_with("file:"))
    text.erase(0, 5);
  else
    return text;
  std::string path;
  for (std::size_t i = 0; i < text.size(); ++i) {
    unsigned char byte = 0;
    const char* const digits = text.data() + i + 1;
    if (text[i] == '%' && i + 2 < text.size() && std::from_chars(digits, digits + 2, byte, 16).ptr == digits + 2) {
      path += static_cast<char>(byte);
      i += 2;
    } else {
      path += text[i];
    }
  }
  return path;
}

/// Null with a message where it cannot be made.
void* made(const std::string& folder, const char* token, const Unit::Log& log, bool may_return_early) noexcept {
  try {
    return new Unit(folder, token == nullptr ? "" : token, log, may_return_early);
  } catch (const std::exception& caught) {
    if (log) log(true, caught.what());
    return nullptr;
  }
}

struct Fmi2Callbacks {
  void (*logger)(void* environment, const char* name, int status, const char* category, const char* message, ...);
  void* (*allocate)(std::size_t, std::size_t);
  void (*release)(void*);
  void (*step_finished)(void*, int);
  void* environment;
};

using Fmi3Log = void (*)(void* environment, int status, const char* category, const char* message);

Unit::Log log_by(Fmi3Log logger, void* environment) {
  if (logger == nullptr) return {};
  return [logger, environment](bool failed, const char* message) {
    logger(environment, failed ? error : warning, failed ? "logStatusError" : "logStatusWarning", message);
  };
}

/// Null in place of an instance of a kind that a unit is not.
void* refused(const Unit::Log& log, const char* message) {
  if (log) log(true, message);
  return nullptr;
}
constexpr const char* kCoSimulationAlone = "expected co-simulation, which is all that this unit has";

}  // namespace

#define FMI __attribute__((visibility("default"), used))
// What a unit for co-simulation need not have. Arguments beyond the first are left where the caller put them.
#define NOT_THERE(name)                                                                  \
  FMI int name(void* instance) {                                                         \
    return guarded(instance, [](Unit&) { fail(#name ": this unit does not have it"); }); \
  }

extern "C" {

// --- FMI 2.0

FMI const char* fmi2GetTypesPlatform() { return "default"; }
FMI const char* fmi2GetVersion() { return "2.0"; }
FMI int fmi2SetDebugLogging(void*, int, std::size_t, const char* const*) { return ok; }

FMI void* fmi2Instantiate(const char* name, int type, const char* guid, const char* resources,
                          const Fmi2Callbacks* callbacks, int, int) try {
  Unit::Log log;
  if (callbacks != nullptr && callbacks->logger != nullptr)
    log = [logger = callbacks->logger, environment = callbacks->environment,
           given = std::string(name == nullptr ? "" : name)](bool failed, const char* message) {
      logger(environment, given.c_str(), failed ? error : warning, failed ? "logStatusError" : "logStatusWarning", "%s",
             message);
    };
  if (type != 1) return refused(log, kCoSimulationAlone);
  return made(path_of(resources), guid, log, false);
} catch (...) {
  return nullptr;
}
FMI void fmi2FreeInstance(void* instance) { delete static_cast<Unit*>(instance); }

FMI int fmi2SetupExperiment(void* instance, int, double, double start, int, double) {
  return guarded(instance, [&](Unit& unit) { unit.set_start_time(start); });
}
FMI int fmi2EnterInitializationMode(void* instance) {
  return guarded(instance, [](Unit& unit) { unit.begin_initialisation(); });
}
FMI int fmi2ExitInitializationMode(void* instance) {
  return guarded(instance, [](Unit& unit) { unit.start(); });
}
FMI int fmi2Terminate(void* instance) {
  return guarded(instance, [](Unit& unit) { unit.terminate(); });
}
FMI int fmi2Reset(void* instance) {
  return guarded(instance, [](Unit& unit) { unit.reset(); });
}

FMI int fmi2GetReal(void* c, const Reference* r, std::size_t n, double* v) { return get(c, Type::real, r, n, v); }
FMI int fmi2GetInteger(void* c, const Reference* r, std::size_t n, int* v) { return get(c, Type::whole, r, n, v); }
FMI int fmi2GetBoolean(void* c, const Reference* r, std::size_t n, int* v) { return get(c, Type::flag, r, n, v); }
FMI int fmi2GetString(void* c, const Reference* r, std::size_t n, const char** v) { return get_texts(c, r, n, v); }
FMI int fmi2SetReal(void* c, const Reference* r, std::size_t n, const double* v) { return set(c, Type::real, r, n, v); }
FMI int fmi2SetInteger(void* c, const Reference* r, std::size_t n, const int* v) {
  return set(c, Type::whole, r, n, v);
}
FMI int fmi2SetBoolean(void* c, const Reference* r, std::size_t n, const int* v) { return set(c, Type::flag, r, n, v); }
FMI int fmi2SetString(void* c, const Reference* r, std::size_t n, const char* const* v) {
  return set_texts(c, r, n, v);
}

// A run that fails on the way is no error of the unit: "discard", and the status fmi2Terminated is true.
FMI int fmi2DoStep(void* instance, double point, double step, int) {
  return guarded(instance, [&](Unit& unit) { return unit.advance(point, step) ? ok : discard; });
}
FMI int fmi2GetRealStatus(void* instance, int kind, double* value) {
  return guarded(instance, [&](Unit& unit) {
    if (kind != 2) fail("fmi2GetRealStatus: expected fmi2LastSuccessfulTime");
    *value = unit.time();
  });
}
FMI int fmi2GetBooleanStatus(void* instance, int kind, int* value) {
  return guarded(instance, [&](Unit& unit) {
    if (kind != 3) fail("fmi2GetBooleanStatus: expected fmi2Terminated");
    *value = unit.ended() ? 1 : 0;
  });
}

NOT_THERE(fmi2GetFMUstate)
NOT_THERE(fmi2SetFMUstate)
NOT_THERE(fmi2FreeFMUstate)
NOT_THERE(fmi2SerializedFMUstateSize)
NOT_THERE(fmi2SerializeFMUstate)
NOT_THERE(fmi2DeSerializeFMUstate)
NOT_THERE(fmi2GetDirectionalDerivative)
NOT_THERE(fmi2SetRealInputDerivatives)
NOT_THERE(fmi2GetRealOutputDerivatives)
NOT_THERE(fmi2CancelStep)
NOT_THERE(fmi2GetStatus)
NOT_THERE(fmi2GetIntegerStatus)
NOT_THERE(fmi2GetStringStatus)

// --- FMI 3.0

FMI const char* fmi3GetVersion() { return "3.0"; }
FMI int fmi3SetDebugLogging(void*, bool, std::size_t, const char* const*) { return ok; }

FMI void* fmi3InstantiateCoSimulation(const char*, const char* token, const char* resources, bool, bool,
                                      bool has_events, bool early, const Reference*, std::size_t, void* environment,
                                      Fmi3Log logger, void*) try {
  const Unit::Log log = log_by(logger, environment);
  if (has_events) return refused(log, "expected eventModeUsed = false: this unit has no event mode");
  return made(resources == nullptr ? "" : resources, token, log, early);
} catch (...) {
  return nullptr;
}
FMI void* fmi3InstantiateModelExchange(const char*, const char*, const char*, bool, bool, void* environment,
                                       Fmi3Log logger) try {
  return refused(log_by(logger, environment), kCoSimulationAlone);
} catch (...) {
  return nullptr;
}
FMI void* fmi3InstantiateScheduledExecution(const char*, const char*, const char*, bool, bool, void* environment,
                                            Fmi3Log logger, void*, void*, void*) try {
  return refused(log_by(logger, environment), kCoSimulationAlone);
} catch (...) {
  return nullptr;
}
FMI void fmi3FreeInstance(void* instance) { delete static_cast<Unit*>(instance); }

FMI int fmi3EnterInitializationMode(void* instance, bool, double, double start, bool, double) {
  return guarded(instance, [&](Unit& unit) {
    unit.set_start_time(start);
    unit.begin_initialisation();
  });
}
FMI int fmi3ExitInitializationMode(void* instance) {
  return guarded(instance, [](Unit& unit) { unit.start(); });
}
FMI int fmi3Terminate(void* instance) {
  return guarded(instance, [](Unit& unit) { unit.terminate(); });
}
FMI int fmi3Reset(void* instance) {
  return guarded(instance, [](Unit& unit) { unit.reset(); });
}

FMI int fmi3GetFloat64(void* c, const Reference* r, std::size_t n, double* v, std::size_t) {
  return get(c, Type::real, r, n, v);
}
FMI int fmi3GetInt32(void* c, const Reference* r, std::size_t n, int* v, std::size_t) {
  return get(c, Type::whole, r, n, v);
}
FMI int fmi3GetBoolean(void* c, const Reference* r, std::size_t n, bool* v, std::size_t) {
  return guarded(c, [&](Unit& unit) {
    for (std::size_t i = 0; i < n; ++i) v[i] = unit.number(r[i], Type::flag) != 0.0;
  });
}
FMI int fmi3GetString(void* c, const Reference* r, std::size_t n, const char** v, std::size_t) {
  return get_texts(c, r, n, v);
}
FMI int fmi3SetFloat64(void* c, const Reference* r, std::size_t n, const double* v, std::size_t) {
  return set(c, Type::real, r, n, v);
}
FMI int fmi3SetInt32(void* c, const Reference* r, std::size_t n, const int* v, std::size_t) {
  return set(c, Type::whole, r, n, v);
}
FMI int fmi3SetBoolean(void* c, const Reference* r, std::size_t n, const bool* v, std::size_t) {
  return set(c, Type::flag, r, n, v);
}
FMI int fmi3SetString(void* c, const Reference* r, std::size_t n, const char* const* v, std::size_t) {
  return set_texts(c, r, n, v);
}

FMI int fmi3DoStep(void* instance, double point, double step, bool, bool* event, bool* terminate, bool* early,
                   double* last) {
  return guarded(instance, [&](Unit& unit) {
    *event = *terminate = *early = false;
    *last = unit.time();
    const double end = *last + step;
    *terminate = !unit.advance(point, step);
    *last = unit.time();
    *early = unit.may_return_early() && unit.ended() && *last < end;
  });
}

NOT_THERE(fmi3EnterEventMode)
NOT_THERE(fmi3GetFloat32)
NOT_THERE(fmi3GetInt8)
NOT_THERE(fmi3GetUInt8)
NOT_THERE(fmi3GetInt16)
NOT_THERE(fmi3GetUInt16)
NOT_THERE(fmi3GetUInt32)
NOT_THERE(fmi3GetInt64)
NOT_THERE(fmi3GetUInt64)
NOT_THERE(fmi3GetBinary)
NOT_THERE(fmi3GetClock)
NOT_THERE(fmi3SetFloat32)
NOT_THERE(fmi3SetInt8)
NOT_THERE(fmi3SetUInt8)
NOT_THERE(fmi3SetInt16)
NOT_THERE(fmi3SetUInt16)
NOT_THERE(fmi3SetUInt32)
NOT_THERE(fmi3SetInt64)
NOT_THERE(fmi3SetUInt64)
NOT_THERE(fmi3SetBinary)
NOT_THERE(fmi3SetClock)
NOT_THERE(fmi3GetNumberOfVariableDependencies)
NOT_THERE(fmi3GetVariableDependencies)
NOT_THERE(fmi3GetFMUState)
NOT_THERE(fmi3SetFMUState)
NOT_THERE(fmi3FreeFMUState)
NOT_THERE(fmi3SerializedFMUStateSize)
NOT_THERE(fmi3SerializeFMUState)
NOT_THERE(fmi3DeserializeFMUState)
NOT_THERE(fmi3GetDirectionalDerivative)
NOT_THERE(fmi3GetAdjointDerivative)
NOT_THERE(fmi3EnterConfigurationMode)
NOT_THERE(fmi3ExitConfigurationMode)
NOT_THERE(fmi3GetIntervalDecimal)
NOT_THERE(fmi3GetIntervalFraction)
NOT_THERE(fmi3GetShiftDecimal)
NOT_THERE(fmi3GetShiftFraction)
NOT_THERE(fmi3SetIntervalDecimal)
NOT_THERE(fmi3SetIntervalFraction)
NOT_THERE(fmi3SetShiftDecimal)
NOT_THERE(fmi3SetShiftFraction)
NOT_THERE(fmi3EvaluateDiscreteStates)
NOT_THERE(fmi3UpdateDiscreteStates)
NOT_THERE(fmi3EnterContinuousTimeMode)
NOT_THERE(fmi3CompletedIntegratorStep)
NOT_THERE(fmi3SetTime)
NOT_THERE(fmi3SetContinuousStates)
NOT_THERE(fmi3GetContinuousStateDerivatives)
NOT_THERE(fmi3GetEventIndicators)
NOT_THERE(fmi3GetContinuousStates)
NOT_THERE(fmi3GetNominalsOfContinuousStates)
NOT_THERE(fmi3GetNumberOfEventIndicators)
NOT_THERE(fmi3GetNumberOfContinuousStates)
NOT_THERE(fmi3EnterStepMode)
NOT_THERE(fmi3GetOutputDerivatives)
NOT_THERE(fmi3ActivateModelPartition)

}  // extern "C"
