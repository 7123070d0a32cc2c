// Threads through the C interface: handles that each has for itself, scenarios and gains that all share. Under the
// thread sanitizer (`make tsan`) this shows that nothing is global.
#include "hexservo.h"

#include <doctest/doctest.h>

#include <array>
#include <cmath>
#include <cstring>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

namespace {

constexpr int kThreads = 4, kTicks = 100;

using Numbers = std::vector<double>;
using Scenario = std::unique_ptr<hexservo_scenario, decltype(&hexservo_scenario_destroy)>;

/// A scenario in sampled mode with a camera and encoders; null where a key was refused.
Scenario scenario_of(const char* law) {
  constexpr std::array<std::array<const char*, 2>, 7> values{
      {{"target.initial_features", "30 18 65 -65 -44 37 -10 -15"},
       {"target.desired_features", "10 10 45 -73 -64 29 -30 -23"},
       {"simulation.mode", "sampled"},
       {"seed", "5"},
       {"camera.period", "0.005"},
       {"camera.noise", "0.1"},
       {"sensors.pose", "encoders"}}};
  Scenario scenario(hexservo_scenario_create(), &hexservo_scenario_destroy);
  if (hexservo_scenario_set_text(scenario.get(), "controller.law", law) != HEXSERVO_OK) return {nullptr, nullptr};
  for (const auto& [key, value] : values)
    if (hexservo_scenario_set_text(scenario.get(), key, value) != HEXSERVO_OK) {
      FAIL_CHECK(std::string(hexservo_scenario_message(scenario.get())));
      return {nullptr, nullptr};
    }
  return scenario;
}

/// The last wrench and the metrics of a run of a copy; empty where it could not begin.
Numbers run(const hexservo_scenario* shared) {
  Numbers numbers;
  const Scenario scenario(hexservo_scenario_copy(shared), &hexservo_scenario_destroy);
  hexservo_run* run = nullptr;
  if (hexservo_run_create(scenario.get(), &run) != HEXSERVO_OK) return numbers;
  hexservo_run_advance(run, kTicks);
  const double *wrench = hexservo_run_newest(run, HEXSERVO_WRENCH), *metrics = hexservo_run_metrics(run);
  numbers.assign(wrench, wrench + 6);
  numbers.insert(numbers.end(), metrics, metrics + hexservo_metric_count());
  hexservo_run_destroy(run);
  return numbers;
}

/// The wrenches of a controller with these gains on a separate plant; empty where there is none.
Numbers servo(const hexservo_scenario* shared, const hexservo_gains* gains) {
  Numbers numbers;
  const Scenario scenario(hexservo_scenario_copy(shared), &hexservo_scenario_destroy);
  hexservo_plant* plant = nullptr;
  hexservo_state* state = hexservo_state_create(gains);
  if (state != nullptr && hexservo_plant_create(scenario.get(), &plant) == HEXSERVO_OK) {
    for (int tick = 0; tick < kTicks; ++tick) {
      hexservo_input input;
      hexservo_output output;
      hexservo_plant_sense(plant, &input);
      hexservo_tick(gains, state, &input, &output);
      numbers.insert(numbers.end(), output.wrench, output.wrench + 6);
      if (!hexservo_plant_command(plant, output.wrench)) break;
    }
    hexservo_plant_destroy(plant);
  }
  hexservo_state_destroy(state);
  return numbers;
}

/// Whether `work` gives these numbers, bit for bit, in each of several threads at the same time.
bool is_same_in_threads(const Numbers& expected, const std::function<Numbers()>& work) {
  std::array<Numbers, kThreads> found;
  std::vector<std::thread> threads;
  for (Numbers& numbers : found) threads.emplace_back([&work, &numbers] { numbers = work(); });
  for (std::thread& thread : threads) thread.join();
  for (const Numbers& numbers : found)
    if (numbers.size() != expected.size() ||
        std::memcmp(numbers.data(), expected.data(), expected.size() * sizeof(double)) != 0)
      return false;
  return true;
}

}  // namespace

TEST_CASE("threads with handles for each give what one thread gives, from scenarios and gains that they share") {
  for (const char* law : {"hybrid", "composite", "computed_torque"}) {
    CAPTURE(law);
    const Scenario scenario = scenario_of(law);
    REQUIRE(scenario);
    const Numbers alone = run(scenario.get());
    REQUIRE(alone.size() == 6 + hexservo_metric_count());
    for (int i = 0; i < 6; ++i) CHECK(std::isfinite(alone[static_cast<std::size_t>(i)]));
    CHECK(is_same_in_threads(alone, [&] { return run(scenario.get()); }));

    hexservo_gains* gains = nullptr;
    REQUIRE(hexservo_gains_create(scenario.get(), 0.0, &gains) == HEXSERVO_OK);
    const Numbers ticks = servo(scenario.get(), gains);
    REQUIRE(ticks.size() == 6 * kTicks);
    CHECK(is_same_in_threads(ticks, [&] { return servo(scenario.get(), gains); }));
    hexservo_gains_destroy(gains);
  }
}
