#include "bindings.hpp"

#include "hexservo/controller.hpp"

#include <pybind11/native_enum.h>

#include <span>
#include <utility>
#include <variant>
#include <vector>

namespace hexservo::bindings {

namespace {

/// A masked array as an array with NaN, a number that is not known, in the place of what it masks; else the object.
py::object without_mask(const py::object& value) {
  const auto* plain = py::detail::npy_api::get().PyArray_Type_;
  const bool may_have_mask = py::isinstance<py::array>(value) && Py_TYPE(value.ptr()) != plain;  // of a derived type
  if (!may_have_mask || !py::hasattr(value, "mask") || !py::hasattr(value, "filled")) return value;
  return value.attr("astype")("float64").attr("filled")(std::numeric_limits<double>::quiet_NaN());
}

/// A vector of N numbers, of any values; ValueError where there are not N, or where they are no numbers.
template <int N>
Vector<double, N> numbers(const char* name, const py::object& value) {
  const auto array = py::array_t<double, py::array::c_style | py::array::forcecast>::ensure(without_mask(value));
  const auto refuse = [&](const std::string& got) {
    throw std::invalid_argument(std::string(name) + ": expected " + std::to_string(N) + " numbers, got " + got);
  };
  if (!array) {
    PyErr_Clear();
    refuse("something else (" + std::string(py::str(py::type::of(value).attr("__name__"))) + ")");
  }
  if (array.ndim() != 1 || array.shape(0) != N) refuse("shape " + std::string(py::str(array.attr("shape"))));
  return Eigen::Map<const Vector<double, N>>(array.data());
}

/// Gains of a law with the state that belongs to them.
template <class Law>
struct LawController {
  ControllerGains<Law> gains;
  ControllerState<Law> state;

  LawController(const Settings& settings, double period)
      : gains(controller_gains<Law>(settings, period)), state(initial_state(gains)) {}
};

/// The controller of any law.
struct Controller {
  using OfLaw = Laws::Map<std::variant, LawController>;

  OfLaw of_law;

  Controller(const Settings& settings, double period)
      : of_law(with_law(settings.law(), [&]<class Law>(std::type_identity<Law>) -> OfLaw {
          return LawController<Law>(settings, period);
        })) {}

  template <class F>
  auto visit(F&& function) {
    return std::visit(std::forward<F>(function), of_law);
  }
};

/// The same, or N unknown numbers for None.
template <int N>
Vector<double, N> numbers_or_none(const char* name, const py::object& value) {
  if (value.is_none()) return Vector<double, N>::Constant(std::numeric_limits<double>::quiet_NaN());
  return numbers<N>(name, value);
}

py::tuple step_once(Controller& controller, const py::object& features, const py::object& depth,
                    const py::object& position, const py::object& quaternion, const py::object& twist,
                    const py::object& leg_lengths, const py::object& leg_rates, double exposure, double now) {
  const ControllerInput input{
      now,
      {exposure, {numbers_or_none<2 * kPoints>("features", features), numbers_or_none<kPoints>("depth", depth)}},
      {numbers_or_none<3>("position", position), numbers_or_none<4>("quaternion", quaternion)},
      numbers_or_none<6>("twist", twist),
      {numbers_or_none<6>("leg_lengths", leg_lengths), numbers_or_none<6>("leg_rates", leg_rates)}};
  const ControllerOutput out = controller.visit([&](auto& c) { return step(c.gains, c.state, input); });
  return py::make_tuple(out.wrench, out.leg_forces, out.fuzzy_output, out.status, out.saturated);
}

}  // namespace

void bind_controller(py::module_& m) {
  py::native_enum<InputStatus>(m, "InputStatus", "enum.Enum")
      .value("valid", InputStatus::valid)
      .value("unusable", InputStatus::unusable)
      .value("missing_image", InputStatus::missing_image)
      .value("stale_image", InputStatus::stale_image)
      .value("lost_feature", InputStatus::lost_feature)
      .finalize();
  py::class_<Controller>(m, "Controller", "The servo tick of a law, with its state.")
      .def(py::init<const Settings&, double>(), py::arg("settings"), py::arg("period"),
           "ValueError('key: expected ..., got ...') for a bad scenario or period [s].")
      .def("step", &step_once, py::arg("features"), py::arg("depth"), py::arg("position"), py::arg("quaternion"),
           py::arg("twist"), py::arg("leg_lengths") = py::none(), py::arg("leg_rates") = py::none(),
           py::arg("exposure") = 0.0, py::arg("now") = 0.0,
           "One tick: wrench (6,), leg forces (6,), fuzzy output (6,), status of the input, whether it is saturated.")
      .def(
          "reset", [](Controller& self) { self.visit([](auto& c) { c.state = initial_state(c.gains); }); },
          "Back to the state before the first tick.")
      .def(
          "state",
          [](Controller& self) {
            const std::vector<double> numbers = self.visit([](auto& c) { return stored(c.state); });
            return py::array_t<double>(static_cast<py::ssize_t>(numbers.size()), numbers.data());
          },
          "(n,) every number that is kept from tick to tick; n depends on law, camera and period.")
      .def(
          "restore",
          [](Controller& self, const py::object& state) {
            const auto array = py::array_t<double, py::array::c_style | py::array::forcecast>::ensure(state);
            if (!array || array.ndim() != 1) {
              PyErr_Clear();
              throw std::invalid_argument("state: expected a vector of numbers, got something else");
            }
            const std::span<const double> numbers(array.data(), static_cast<std::size_t>(array.size()));
            self.visit([&](auto& c) { restore(c.state, numbers); });
          },
          py::arg("state"), "Continues from what `state` gave; ValueError for a state of another controller.")
      .def_property_readonly(
          "period", [](Controller& self) { return self.visit([](auto& c) { return c.gains.period; }); }, "[s]")
      .def_property_readonly(
          "fuzzy_weights",
          [](Controller& self) { return self.visit([](auto& c) { return weight_array(c.state.law); }); },
          "(6, 7, 7) [N; N m]");
}

}  // namespace hexservo::bindings
