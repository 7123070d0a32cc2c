// The table of parameters: every key is set and read where it belongs, and no number beyond its bound is accepted.
#include "hexservo/scenario_keys.hpp"
#include "hexservo/simulation.hpp"

#include "compare.hpp"
#include "scenarios.hpp"

#include <algorithm>
#include <set>
#include <string>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

/// A scenario in sampled mode, so that every key acts.
Settings sampled_settings(LawId law) {
  Settings settings = Settings::of(law);
  settings.target = paper_settings().target;
  settings.simulation.mode = LoopMode::sampled;
  if (law_traits(law).output == LawOutput::pose) settings.actuators.kind = ActuatorKind::position;
  return settings;
}

bool same(const std::vector<double>& a, const std::vector<double>& b) {
  return std::ranges::equal(a, b, [](double x, double y) { return x == y; });
}

}  // namespace

TEST_CASE("names are unique, places count, and laws differ in their gains alone") {
  std::vector<std::string> common;
  for (std::size_t i = 0; i < kLawTraits.size(); ++i) {
    const auto law = static_cast<LawId>(i);
    CHECK(law_named(kLawTraits[i].name) == law);
    const std::string head = "controller." + std::string(kLawTraits[i].name) + ".";
    std::set<std::string> names;
    std::vector<std::string> others;
    for (const ScenarioKey& key : scenario_keys(law)) {
      CHECK(key.place == names.size());
      CHECK(names.insert(key.name).second);
      CHECK(&scenario_key(law, key.name) == &key);
      if (!key.name.starts_with(head)) others.push_back(key.name);
    }
    if (i == 0) common = others;
    CHECK(others == common);
    CHECK(names.size() > others.size());
  }
  CHECK(is_about(refusal([] { law_named("pid"); }), "controller.law"));
  CHECK(is_about(refusal([] { scenario_key(law_id<Kelly>, "controller.hybrid.kp"); }), "controller.hybrid.kp"));
}

TEST_CASE("what is set is read, in the struct's own member and nowhere else") {
  Laws::for_each([]<class Law>(std::type_identity<Law>) {
    const std::vector<ScenarioKey>& keys = scenario_keys(law_id<Law>);
    for (const ScenarioKey& key : keys) {
      if (key.type == KeyType::seed) continue;
      CAPTURE(key.name);
      Settings settings = Settings::of<Law>();
      const Settings before = settings;
      if (key.type == KeyType::choice) {
        set_choice(settings, key, key.choices.back());
        CHECK(choice_of(settings, key) == key.choices.back());
      } else {
        const std::size_t count = key.type == KeyType::samples ? 12 : key.widths().back();
        std::vector<double> numbers(count);
        for (std::size_t i = 0; i < count; ++i) numbers[i] = 3.0 + static_cast<double>(i);
        if (key.type == KeyType::flag) numbers[0] = numbers_of(before, key)[0] == 0.0 ? 1.0 : 0.0;
        set_numbers(settings, key, numbers);
        CHECK(same(numbers_of(settings, key), numbers));
      }
      std::size_t changed = 0;
      for (const ScenarioKey& other : keys)
        if (other.type != KeyType::seed)
          changed += same(numbers_of(settings, other), numbers_of(before, other)) ? 0U : 1U;
      CHECK(changed == (same(numbers_of(settings, key), numbers_of(before, key)) ? 0U : 1U));
    }
  });
  Settings settings;
  set_numbers(settings, scenario_key(law_id<Hybrid>, "camera.noise"), std::vector<double>{0.25});
  CHECK(settings.camera.noise == 0.25);
  set_numbers(settings, scenario_key(law_id<Hybrid>, "robot.inertia"), std::vector<double>{1.0, 2.0, 3.0});
  CHECK(settings.robot.inertia == Matrix3<double>(Vector3<double>(1.0, 2.0, 3.0).asDiagonal()));
  set_numbers(settings, scenario_key(law_id<Hybrid>, "controller.safe.hold"), std::vector<double>{7.0});
  CHECK(settings.controller.safe.hold == Vector6<double>::Constant(7.0));
  set_numbers(settings, scenario_key(law_id<Hybrid>, "controller.safe.hold"), {});
  CHECK_FALSE(settings.controller.safe.hold.has_value());
  set_choice(settings, scenario_key(law_id<Hybrid>, "sensors.pose"), "encoders");
  CHECK(settings.sensors.pose == PoseSource::encoders);
}

TEST_CASE("another count, a fraction of a whole number and unknown choices are refused with the key") {
  Settings settings;
  const auto refused = [&settings](const char* name, const std::vector<double>& numbers) {
    return is_about(refusal([&] { set_numbers(settings, scenario_key(settings.law(), name), numbers); }), name);
  };
  CHECK(refused("camera.noise", {1.0, 2.0}));
  CHECK(refused("camera.noise", {}));
  CHECK(refused("target.desired_features", {1.0}));
  CHECK(refused("controller.hybrid.kp", std::vector<double>(7, 1.0)));
  CHECK(refused("controller.hybrid.kp", std::vector<double>(34, 1.0)));
  CHECK(refused("base_motion.samples", {1.0, 2.0}));
  CHECK(refused("simulation.substeps", {1.5}));
  CHECK(refused("actuators.saturation", {0.5}));
  CHECK(refused("actuators.saturation", {kNaN}));
  CHECK(refused("camera.convention", {1.0}));
  CHECK(is_about(refusal([&] { set_choice(settings, scenario_key(settings.law(), "camera.on_lost"), "wait"); }),
                 "camera.on_lost"));
  CHECK(is_about(refusal([&] { set_choice(settings, scenario_key(settings.law(), "camera.noise"), "stop"); }),
                 "camera.noise"));
}

TEST_CASE("numbers beyond their bounds are refused with key and place; those of sampled mode do not act in the other") {
  Laws::for_each([]<class Law>(std::type_identity<Law>) {
    const auto verdict = [](const Settings& settings) { return refusal([&] { check_settings(settings); }); };
    REQUIRE(verdict(sampled_settings(law_id<Law>)) == "(accepted)");
    for (const ScenarioKey& key : scenario_keys(law_id<Law>)) {
      if (key.type != KeyType::number && key.type != KeyType::array) continue;
      const Bound& bound = key.field.bound;
      std::vector<double> bad = {kNaN, -kInfinity};
      if (bound.none != kInfinity) bad.push_back(kInfinity);
      if (std::isfinite(bound.least))
        bad.push_back(bound.above && bound.none != bound.least ? bound.least : bound.least - 1e-3);
      if (std::isfinite(bound.most)) bad.push_back(bound.below ? bound.most : bound.most + 1e-3);
      for (const double number : bad) {
        CAPTURE(key.name);
        CAPTURE(number);
        Settings settings = sampled_settings(law_id<Law>);
        std::vector<double> numbers = numbers_of(settings, key);
        if (numbers.empty()) numbers.assign(key.widths().back(), 1.0);
        numbers.back() = number;
        set_numbers(settings, key, numbers);
        if (key.name == "target.points") settings.target.points->leftCols<2>().setRandom();
        CHECK(verdict(settings).starts_with(key.name));
        if (!key.field.sampled || Law::traits.output == LawOutput::pose) continue;  // which has no other mode
        settings.simulation.mode = LoopMode::continuous;
        CHECK(verdict(settings) == "(accepted)");
      }
    }
  });
}
