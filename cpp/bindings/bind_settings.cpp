#include "bindings.hpp"

#include "hexservo/scenario_keys.hpp"
#include "hexservo/simulation.hpp"

#include <optional>
#include <string_view>

namespace hexservo::bindings {

namespace {

/// Names of enumerators, of the types in this file.
template <class E>
std::string_view name_of(E value) {
  return kNamesOf<E>[static_cast<std::size_t>(value)];
}

/// Shape of an array as NumPy has it; () is one number.
py::tuple shape_of(const ScenarioKey& key) {
  if (key.type == KeyType::samples) return py::make_tuple(py::none(), key.field.columns);
  if (key.rows * key.columns == 1) return py::tuple();
  return key.columns == 1 ? py::tuple(py::make_tuple(key.rows)) : py::tuple(py::make_tuple(key.rows, key.columns));
}

std::optional<double> finite(double value) { return std::isfinite(value) ? std::optional(value) : std::nullopt; }

py::object value_of(const Settings& settings, const std::string& name) {
  const ScenarioKey& key = scenario_key(settings.law(), name);
  if (key.type == KeyType::seed) return py::int_(settings.seed);
  if (key.type == KeyType::choice) return text(choice_of(settings, key));
  const std::vector<double> numbers = numbers_of(settings, key);
  if (numbers.empty()) return py::none();
  if (key.type == KeyType::flag) return py::bool_(numbers[0] != 0.0);
  if (key.type == KeyType::whole) return py::int_(static_cast<long long>(numbers[0]));
  if (key.type == KeyType::number) return py::float_(numbers[0]);
  const bool rows = key.type == KeyType::samples;
  const py::ssize_t columns = rows ? key.field.columns : key.columns;
  std::vector<py::ssize_t> shape = {static_cast<py::ssize_t>(numbers.size()) / columns};
  if (rows || columns > 1) shape.push_back(columns);
  return py::array_t<double>(shape, numbers.data());
}

void set_value(Settings& settings, const std::string& name, const py::object& value) {
  const ScenarioKey& key = scenario_key(settings.law(), name);
  if (key.type == KeyType::seed) {
    settings.seed = value.cast<std::uint64_t>();
  } else if (py::isinstance<py::str>(value)) {
    set_choice(settings, key, value.cast<std::string>());
  } else if (value.is_none()) {
    set_numbers(settings, key, {});
  } else {
    const auto array = py::array_t<double, py::array::c_style | py::array::forcecast>::ensure(value);
    if (!array) throw std::invalid_argument(name + ": expected numbers, got something else");
    set_numbers(settings, key, {array.data(), static_cast<std::size_t>(array.size())});
  }
}

/// Gains that may use the assumed points tell whether they do.
bool needs_goal(const Settings& settings) {
  return std::visit(
      [](const auto& gains) {
        if constexpr (requires { gains.needs_goal(); })
          return gains.needs_goal();
        else
          return false;
      },
      settings.controller.gains);
}

void bind_keys(py::module_& m) {
  using K = ScenarioKey;
  py::class_<K>(m, "ScenarioKey", "One key of a scenario file.")
      .def_readonly("name", &K::name, "dotted")
      .def_property_readonly(
          "unit", [](const K& k) { return text(k.unit); }, "linear; angular; empty: none")
      .def_property_readonly(
          "type", [](const K& k) { return text(name_of(k.type)); },
          "number, array, whole, flag, choice, samples or seed")
      .def_property_readonly("shape", &shape_of, "() is one number")
      .def_readonly("optional", &K::optional, "may be None")
      .def_property_readonly(
          "none",
          [](const K& k) { return std::isnan(k.field.bound.none) ? std::nullopt : std::optional(k.field.bound.none); },
          "the number that stands for none, or None")
      .def_readonly("wrapped", &K::wrapped, "held in a std::optional")
      .def_readonly("per_point", &K::per_point,
                    "numbers of each point, of which shape and widths are those of four; or 0")
      .def_property_readonly(
          "widths", [](const K& k) { return k.widths(); }, "numbers that it takes, row by row")
      .def_property_readonly("varies", &K::varies, "scenarios of a batch may differ in it")
      .def_property_readonly(
          "least", [](const K& k) { return finite(k.field.bound.least); }, "of each number, or None")
      .def_property_readonly(
          "most", [](const K& k) { return finite(k.field.bound.most); }, "of each number, or None")
      .def_property_readonly(
          "above", [](const K& k) { return k.field.bound.above; }, "least itself is too small")
      .def_property_readonly(
          "below", [](const K& k) { return k.field.bound.below; }, "most itself is too large")
      .def_property_readonly(
          "form", [](const K& k) { return text(name_of(k.field.form)); }, "one_or_all, all or symmetric")
      .def_property_readonly(
          "choices",
          [](const K& k) {
            py::tuple names(k.choices.size());
            for (std::size_t i = 0; i < k.choices.size(); ++i) names[i] = text(k.choices[i]);
            return names;
          },
          "of a choice")
      .def_property_readonly(
          "choice_type", [](const K& k) { return text(k.choice_type); }, "of a choice, in C++")
      .def_property_readonly(
          "reach", [](const K& k) { return text(name_of(k.field.reach)); },
          "what must agree where it varies in a batch: lane, pack, legs or batch")
      .def_property_readonly(
          "concern", [](const K& k) { return text(name_of(k.field.concern)); }, "controller, plant or run")
      .def_property_readonly("sampled", [](const K& k) { return k.field.sampled; }, "acts in sampled mode alone");
  m.def(
      "scenario_keys", [](const std::string& law) { return scenario_keys(law_named(law)); }, py::arg("law"),
      "All keys of a law in the order of a scenario file; ValueError for an unknown law.");
}

void bind_traits(py::module_& m) {
  using T = LawTraits;
  py::class_<T>(m, "LawTraits", "Properties of a law besides its equation.")
      .def_property_readonly("name", [](const T& t) { return text(t.name); })
      .def_property_readonly(
          "type", [](const T& t) { return text(t.type); }, "its name in C++")
      .def_property_readonly(
          "output", [](const T& t) { return text(name_of(t.output)); }, "wrench, twist or pose")
      .def_property_readonly(
          "parts",
          [](const T& t) {
            py::list parts;
            for (std::size_t part = 0; part < kLawParts; ++part)
              if (t.parts.has(static_cast<LawPart>(part))) parts.append(text(kNamesOf<LawPart>[part]));
            return py::tuple(parts);
          },
          "what its wrench is made of beside the weight's, by name")
      .def_property_readonly("memory", &T::memory, "fuzzy systems, whose weights change from tick to tick")
      .def_property_readonly("viscous", &T::viscous, "damping in proportion to the twist")
      .def_property_readonly("switching", &T::switching, "the friction-like term")
      .def_property_readonly("pose_error", &T::pose_error, "a pose error that it regulates")
      .def_property_readonly(
          "inverse", [](const T& t) { return text(t.inverse); },
          "gain M of (J^T J + M)^-1, which takes an image error to a pose error; empty: none")
      .def_property_readonly(
          "viscosity", [](const T& t) { return text(t.viscosity); },
          "gain K of chi-dot + K^-1 (tau - G), how a platform without mass takes positions; empty: it has its mass")
      .def_readonly("points", &T::points, "gains may ask for the assumed points")
      .def_readonly("depth", &T::depth, "the measured depths enter")
      .def_readonly("prior", &T::prior, "the pose of the joint sensors, weighed by the gain prior")
      .def_readonly("theorem", &T::theorem, "the paper's theorem is of this law");
  py::dict traits;
  for (const LawTraits& law : kLawTraits) traits[text(law.name)] = py::cast(law);
  m.attr("LAW_TRAITS") = traits;
  m.attr("FULL_TURN") = kFullTurn;
  m.attr("LONGEST_TURN") = kLongestTurn;
  m.attr("MOST_LENGTH") = kMostLength;
  m.attr("MOST_MASS") = kMostMass;
  m.attr("MOST_INERTIA") = kMostInertia;
  m.attr("LEAST_POINTS") = kLeastPoints;
  m.attr("MOST_POINTS") = kMostPoints;
}

}  // namespace

void bind_settings(py::module_& m) {
  bind_keys(m);
  bind_traits(m);
  py::class_<Settings>(m, "Settings", "A scenario as numbers, by the dotted keys of its file.")
      .def(py::init([](const std::string& law) { return Settings::of(law_named(law)); }), py::arg("law"),
           "The defaults of a law; ValueError for an unknown one.")
      .def_property_readonly("law", [](const Settings& s) { return text(law_traits(s.law()).name); })
      .def_property_readonly("needs_goal", &needs_goal,
                             "The law, with its gains, uses the assumed target points and the pose of their goal.")
      .def_property_readonly(
          "robot", [](const Settings& s) { return s.robot; }, "a copy")
      .def_property_readonly(
          "points", [](const Settings& s) { return s.target.count(); }, "p, of the target")
      .def_property_readonly(
          "places", [](const Settings& s) { return s.target.places(); }, "for points, of the loop that takes them")
      .def_property_readonly(
          "body", [](const Settings& s) { return estimated_body(s.robot); }, "mass properties as estimated, a copy")
      .def_property_readonly(
          "plant_body", [](const Settings& s) { return plant_body(s.robot); },
          "mass properties of what the platform carries, but for relative errors, a copy")
      .def_property_readonly(
          "camera", [](const Settings& s) { return Camera(s.camera); }, "a copy")
      .def_property_readonly(
          "assumed_camera", [](const Settings& s) { return assumed_camera(s); }, "the controller's, a copy")
      .def_property_readonly(
          "dynamics_error", [](const Settings& s) { return DynamicsError<double>(s.uncertainty); }, "a copy")
      .def("__getitem__", &value_of, py::arg("key"), "Value of a key: a copy.")
      .def("__setitem__", &set_value, py::arg("key"), py::arg("value"),
           "Set a key; None where it is optional. Bounds are not checked.")
      .def(
          "validate", [](const Settings& s) { check_settings(s); },
          "ValueError('key: expected ..., got ...') for the first thing that is wrong.");

  m.def("project_target", &project_target, py::arg("settings"), py::arg("displacement"),
        "(2 p,) image of the target's p points from a displacement of home (6,), in B [m; rad]; the goal's image is "
        "not used. "
        "ValueError where a point is not in front of the camera.");
  m.def(
      "step_count",
      [](double step, double duration, long long log_every) {
        SimulationSettings simulation;
        simulation.step = step;
        simulation.duration = duration;
        simulation.log_every = log_every;
        return step_count(simulation);
      },
      py::arg("step"), py::arg("duration"), py::arg("log_every") = 1,
      "Steps of a run of `duration` [s]; ValueError where they make no grid.");
}

}  // namespace hexservo::bindings
