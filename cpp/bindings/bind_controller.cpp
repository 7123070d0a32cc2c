#include "bindings.hpp"

#include "hexservo/controller.hpp"

#include <pybind11/native_enum.h>

#include <memory>
#include <span>
#include <utility>
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

/// `count` numbers of any values at the beginning of `to`; ValueError where there are others.
void take_numbers(const char* name, const py::object& value, py::ssize_t count, double* to) {
  const auto given = py::array::ensure(without_mask(value));
  using Doubles = py::array_t<double, py::array::c_style | py::array::forcecast>;
  const auto array =
      given && !holds_no_real_numbers(given) ? Doubles::ensure(given) : py::reinterpret_steal<Doubles>(py::handle());
  const auto refuse = [&](const std::string& got) {
    throw std::invalid_argument(std::string(name) + ": expected " + std::to_string(count) + " numbers, got " + got);
  };
  if (!array) {
    PyErr_Clear();
    refuse(kind_of(value));
  }
  if (array.ndim() != 1 || array.shape(0) != count) refuse("shape " + std::string(py::str(array.attr("shape"))));
  std::copy_n(array.data(), count, to);
}

/// A vector of N numbers whose first ones are given, or N unknown numbers for None.
template <int N>
Vector<double, N> numbers_or_none(const char* name, const py::object& value, py::ssize_t count = N) {
  Vector<double, N> numbers = Vector<double, N>::Constant(std::numeric_limits<double>::quiet_NaN());
  if (!value.is_none()) take_numbers(name, value, count, numbers.data());
  return numbers;
}

/// The controller of any law and any number of points, with its state.
class Controller {
 public:
  using Input = ControllerInputOf<kMostPoints>;

  Controller(const Settings& settings, double period)
      : points_(settings.target.count()),
        of_loop_(with_loop(settings, [&]<class Law, int N>(std::type_identity<Law>, std::integral_constant<int, N>) {
          return std::unique_ptr<OfAny>(std::make_unique<Of<Law, N>>(settings, period));
        })) {}

  int points() const { return points_; }
  ControllerOutput step(const Input& input) { return of_loop_->step(input); }
  void reset() { of_loop_->reset(); }
  std::vector<double> state() const { return of_loop_->state(); }
  void restore(std::span<const double> numbers) { of_loop_->restore(numbers); }
  double period() const { return of_loop_->period(); }
  py::array_t<double> weights() const { return of_loop_->weights(); }

 private:
  struct OfAny {
    virtual ~OfAny() = default;
    virtual ControllerOutput step(const Input& input) = 0;
    virtual void reset() = 0;
    virtual std::vector<double> state() const = 0;
    virtual void restore(std::span<const double> numbers) = 0;
    virtual double period() const = 0;
    virtual py::array_t<double> weights() const = 0;
  };

  template <class Law, int N>
  struct Of final : OfAny {
    Of(const Settings& settings, double period)
        : gains(controller_gains<Law, N>(settings, period)), now(initial_state(gains)) {}

    ControllerOutput step(const Input& input) override {
      return hexservo::step(
          gains, now,
          {input.now,
           {input.frame.exposure, {input.frame.image.features.head<2 * N>(), input.frame.image.depth.head<N>()}},
           input.pose,
           input.twist,
           input.joints});
    }
    void reset() override { now = initial_state(gains); }
    std::vector<double> state() const override { return stored(now); }
    void restore(std::span<const double> numbers) override { hexservo::restore(now, numbers); }
    double period() const override { return gains.period; }
    py::array_t<double> weights() const override { return weight_array(now.law); }

    ControllerGains<Law, N> gains;
    ControllerState<Law, N> now;
  };

  int points_;
  std::unique_ptr<OfAny> of_loop_;
};

py::tuple step_once(Controller& controller, const py::object& features, const py::object& depth,
                    const py::object& position, const py::object& quaternion, const py::object& twist,
                    const py::object& leg_lengths, const py::object& leg_rates, double exposure, double now) {
  const Controller::Input input{
      now,
      {exposure,
       {numbers_or_none<2 * kMostPoints>("features", features, 2 * controller.points()),
        numbers_or_none<kMostPoints>("depth", depth, controller.points())}},
      {numbers_or_none<3>("position", position), numbers_or_none<4>("quaternion", quaternion)},
      numbers_or_none<6>("twist", twist),
      {numbers_or_none<6>("leg_lengths", leg_lengths), numbers_or_none<6>("leg_rates", leg_rates)}};
  const ControllerOutput out = controller.step(input);
  return py::make_tuple(out.wrench, out.leg_forces, out.fuzzy_output, out.status, out.saturated, out.leg_positions,
                        Vector3<double>(out.latency.estimate, out.latency.least, out.latency.most));
}

}  // namespace

void bind_controller(py::module_& m) {
  m.attr("LONGEST_SERVO_PERIOD") = kMaxServoPeriod;
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
           "One tick: wrench (6,), leg forces (6,), fuzzy output (6,), status of the input, whether it is saturated, "
           "leg positions (6,), latency (3,): estimate, shortest, longest.")
      .def("reset", &Controller::reset, "Back to the state before the first tick.")
      .def(
          "state",
          [](Controller& self) {
            const std::vector<double> numbers = self.state();
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
            self.restore(numbers);
          },
          py::arg("state"), "Continues from what `state` gave; ValueError for a state of another controller.")
      .def_property_readonly("period", &Controller::period, "[s]")
      .def_property_readonly("fuzzy_weights", &Controller::weights, "(6, 7, 7) [N; N m]");
}

}  // namespace hexservo::bindings
