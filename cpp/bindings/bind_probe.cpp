#include "bindings.hpp"

#include "hexservo/probe.hpp"
#include "hexservo/runge_kutta.hpp"

#include <optional>
#include <string_view>
#include <vector>

namespace hexservo::bindings {

namespace {

using Array = py::array_t<double, py::array::c_style | py::array::forcecast>;
using Shape = std::vector<py::ssize_t>;

const Shape kFour = {4}, kThree = {3}, kThreeByThree = {3, 3}, kSix = {6}, kWeightShape = {6, kTerms, kTerms};
const Shape kMembershipShape = {6, kTerms}, kInertiaShape = {6, 6};

/// Shapes of what there is for each point of the target: features and depths.
Shape two_each(const Probe& probe) { return {2 * probe.points()}; }
Shape one_each(const Probe& probe) { return {probe.points()}; }

constexpr auto kStages = static_cast<py::ssize_t>(kRungeKuttaWeights.size());

/// A shape as Python writes it; the first extent may be unknown.
std::string shape_text(const Shape& shape) {
  std::string out = "(";
  for (std::size_t i = 0; i < shape.size(); ++i) {
    if (i > 0) out += ", ";
    out += shape[i] < 0 ? "n" : std::to_string(shape[i]);
  }
  return out + (shape.size() == 1 ? ",)" : ")");
}

Shape prefixed(py::ssize_t first, const Shape& rest) {
  Shape shape = {first};
  shape.insert(shape.end(), rest.begin(), rest.end());
  return shape;
}
Shape staged(const Shape& rest) { return prefixed(kStages, rest); }

/// An array of doubles; nothing where there are no real numbers.
Array real_numbers(const py::object& value) {
  const py::array given = py::array::ensure(value);
  const bool real = given && !holds_no_real_numbers(given);
  return real ? Array::ensure(given) : py::reinterpret_steal<Array>(py::handle());
}

/// Rows that were given, and keep their memory.
class Given {
 public:
  /// @param n rows that are expected; -1: any number of them
  Given(const char* name, const py::object& value, const Shape& row, py::ssize_t n = -1) : array_(real_numbers(value)) {
    const Shape expected = prefixed(n, row);
    const auto refuse = [&](const std::string& got) {
      throw std::invalid_argument(std::string(name) + ": expected numbers of shape " + shape_text(expected) + ", got " +
                                  got);
    };
    if (!array_) refuse(kind_of(value));
    const Shape shape(array_.shape(), array_.shape() + array_.ndim());
    bool fits = shape.size() == expected.size();
    for (std::size_t i = 0; fits && i < shape.size(); ++i) fits = shape[i] == expected[i] || (i == 0 && n < 0);
    if (!fits) refuse("shape " + shape_text(shape));
  }

  py::ssize_t count() const { return array_.shape(0); }
  Rows rows() const { return {array_.data(), static_cast<std::size_t>(array_.size())}; }

 private:
  Array array_;
};

/// Rows to be filled in.
class Made {
 public:
  Made(py::ssize_t n, const Shape& row) : array_(prefixed(n, row)) {}

  Column column() { return {array_.mutable_data(), static_cast<std::size_t>(array_.size())}; }
  py::array_t<double> array() const { return array_; }

 private:
  py::array_t<double> array_;
};

/// The same, or nothing.
Column column_or_none(std::optional<Made>& made) { return made ? made->column() : Column{}; }
py::object array_or_none(const std::optional<Made>& made) {
  if (!made) return py::none();
  return made->array();
}

/// What a law gives, as arrays.
struct LawProbe {
  py::array_t<double> wrench, fuzzy_output;
  py::object error_memberships, rate_memberships, adaptation, pose_error;
  py::dict parts;
};

/// The stages of steps, as arrays.
struct StageProbe {
  py::array_t<double> features, depth, position, quaternion, twist, wrench, fuzzy_output, acceleration;
  py::array_t<double> next_features, next_depth, next_position, next_quaternion, next_twist;
  py::object next_weights;
};

/// States of a law or of a loop.
struct States {
  Given features, depth, position, quaternion, twist;
  std::optional<Given> weights;

  States(const Probe& probe, const py::object& f, const py::object& z, const py::object& p, const py::object& q,
         const py::object& v, const py::object& w)
      : features("features", f, two_each(probe)),
        depth("depth", z, one_each(probe), count()),
        position("position", p, kThree, count()),
        quaternion("quaternion", q, kFour, count()),
        twist("twist", v, kSix, count()) {
    if (!w.is_none()) weights.emplace("weights", w, kWeightShape, count());
  }

  py::ssize_t count() const { return features.count(); }
  ProbeStates rows() const {
    return {features.rows(),   depth.rows(), position.rows(),
            quaternion.rows(), twist.rows(), weights ? weights->rows() : Rows{}};
  }
};

py::tuple image(const Probe& probe, const py::object& p, const py::object& q) {
  const Given position("position", p, kThree), quaternion("quaternion", q, kFour, position.count());
  Made features(position.count(), two_each(probe)), depth(position.count(), one_each(probe));
  {
    const Column to_features = features.column(), to_depth = depth.column();
    const WithoutGil no_gil;
    probe.image(position.rows(), quaternion.rows(), to_features, to_depth);
  }
  return py::make_tuple(features.array(), depth.array());
}

py::tuple goal_minima(const Probe& probe) {
  const std::vector<GoalMinimum> found = probe.goal_minima();
  const auto n = static_cast<py::ssize_t>(found.size());
  Made position(n, kThree), quaternion(n, kFour);
  for (std::size_t i = 0; i < found.size(); ++i) {
    std::copy_n(found[i].pose.position.data(), 3, position.column().data() + 3 * i);
    std::copy_n(found[i].pose.quaternion.data(), 4, quaternion.column().data() + 4 * i);
  }
  return py::make_tuple(position.array(), quaternion.array());
}

py::array_t<double> base_acceleration(const Probe& probe, const py::object& t) {
  const Given time("time", t, {});
  Made made(time.count(), kThree);
  probe.base_acceleration(time.rows(), made.column());
  return made.array();
}

py::tuple base_motion(const Probe& probe, const py::object& t) {
  const Given time("time", t, {});
  Made position(time.count(), kThree), attitude(time.count(), kThreeByThree), rate(time.count(), kThree),
      rate_change(time.count(), kThree);
  probe.base_motion(time.rows(), {position.column(), attitude.column(), rate.column(), rate_change.column()});
  return py::make_tuple(position.array(), attitude.array(), rate.array(), rate_change.array());
}

py::array_t<double> base_wrench(const Probe& probe, const py::object& t, const py::object& p, const py::object& q,
                                const py::object& twists) {
  const Given time("time", t, {}), position("position", p, kThree, time.count()),
      quaternion("quaternion", q, kFour, time.count()), twist("twist", twists, kSix, time.count());
  Made made(time.count(), kSix);
  probe.base_wrench(time.rows(), position.rows(), quaternion.rows(), twist.rows(), made.column());
  return made.array();
}

py::array_t<double> image_jacobian(const Probe& probe, const py::object& f, const py::object& z, const py::object& q,
                                   bool controller, const py::object& p) {
  const Given features("features", f, two_each(probe)), depth("depth", z, one_each(probe), features.count()),
      quaternion("quaternion", q, kFour, features.count());
  std::optional<Given> position;
  if (!p.is_none()) position.emplace("position", p, kThree, features.count());
  Made jacobian(features.count(), {2 * probe.points(), 6});
  {
    const Column to = jacobian.column();
    const WithoutGil no_gil;
    probe.image_jacobian(features.rows(), depth.rows(), position ? position->rows() : Rows{}, quaternion.rows(),
                         controller, to);
  }
  return jacobian.array();
}

py::array_t<double> measured_depth(const Probe& probe, const py::object& z) {
  const Given depth("depth", z, one_each(probe));
  Made measured(depth.count(), one_each(probe));
  probe.measured_depth(depth.rows(), measured.column());
  return measured.array();
}

LawProbe law(const Probe& probe, const py::object& f, const py::object& z, const py::object& p, const py::object& q,
             const py::object& v, const py::object& w) {
  const States states(probe, f, z, p, q, v, w);
  const py::ssize_t n = states.count();
  Made wrench(n, kSix), fuzzy_output(n, kSix);
  std::optional<Made> error, rate, adaptation, pose_error;
  if (probe.has_fuzzy_systems()) {
    error.emplace(n, kMembershipShape);
    rate.emplace(n, kMembershipShape);
    adaptation.emplace(n, kSix);
  }
  if (probe.traits().pose_error()) pose_error.emplace(n, kSix);
  ProbedLaw out{wrench.column(),           fuzzy_output.column(),      column_or_none(error),
                column_or_none(rate),      column_or_none(adaptation), {},
                column_or_none(pose_error)};
  py::dict parts;
  for (std::size_t part = 0; part < kLawParts; ++part) {
    if (!probe.traits().parts.has(static_cast<LawPart>(part))) continue;
    Made made(n, kSix);
    out.parts[part] = made.column();
    parts[text(kNamesOf<LawPart>[part])] = made.array();
  }
  {
    const WithoutGil no_gil;
    probe.law(states.rows(), out);
  }
  return {wrench.array(),
          fuzzy_output.array(),
          array_or_none(error),
          array_or_none(rate),
          array_or_none(adaptation),
          array_or_none(pose_error),
          parts};
}

py::array_t<double> acceleration(const Probe& probe, const py::object& p, const py::object& q, const py::object& v,
                                 const py::object& tau) {
  const Given position("position", p, kThree);
  const py::ssize_t n = position.count();
  const Given quaternion("quaternion", q, kFour, n), twist("twist", v, kSix, n), wrench("wrench", tau, kSix, n);
  Made made(n, kSix);
  {
    const Column to = made.column();
    const WithoutGil no_gil;
    probe.acceleration(position.rows(), quaternion.rows(), twist.rows(), wrench.rows(), to);
  }
  return made.array();
}

py::tuple estimated_wrenches(const Probe& probe, const py::object& q, const py::object& v, const py::object& a) {
  const Given quaternion("quaternion", q, kFour);
  const py::ssize_t n = quaternion.count();
  const Given twist("twist", v, kSix, n), given("acceleration", a, kSix, n);
  Made inertial(n, kSix), coriolis(n, kSix);
  {
    const Column to_inertial = inertial.column(), to_coriolis = coriolis.column();
    const WithoutGil no_gil;
    probe.estimated_wrenches(quaternion.rows(), twist.rows(), given.rows(), to_inertial, to_coriolis);
  }
  return py::make_tuple(inertial.array(), coriolis.array(), probe.gravity());
}

py::array_t<double> inertia(const Probe& probe, const py::object& q) {
  const Given quaternion("quaternion", q, kFour);
  Made made(quaternion.count(), kInertiaShape);
  probe.inertia(quaternion.rows(), made.column());
  return made.array();
}

StageProbe stages(const Probe& probe, const py::object& f, const py::object& z, const py::object& p,
                  const py::object& q, const py::object& v, const py::object& w) {
  const States states(probe, f, z, p, q, v, w);
  const py::ssize_t n = states.count();
  Made features(n, staged(two_each(probe))), depth(n, staged(one_each(probe))), position(n, staged(kThree)),
      quaternion(n, staged(kFour));
  Made twist(n, staged(kSix)), wrench(n, staged(kSix)), fuzzy_output(n, staged(kSix)), rate(n, staged(kSix));
  Made next_features(n, two_each(probe)), next_depth(n, one_each(probe)), next_position(n, kThree),
      next_quaternion(n, kFour);
  Made next_twist(n, kSix);
  std::optional<Made> next_weights;
  if (probe.has_fuzzy_systems()) next_weights.emplace(n, kWeightShape);
  {
    const ProbedStages out{features.column(),      depth.column(),
                           position.column(),      quaternion.column(),
                           twist.column(),         wrench.column(),
                           fuzzy_output.column(),  rate.column(),
                           next_features.column(), next_depth.column(),
                           next_position.column(), next_quaternion.column(),
                           next_twist.column(),    column_or_none(next_weights)};
    const WithoutGil no_gil;
    probe.stages(states.rows(), out);
  }
  return {features.array(),      depth.array(),
          position.array(),      quaternion.array(),
          twist.array(),         wrench.array(),
          fuzzy_output.array(),  rate.array(),
          next_features.array(), next_depth.array(),
          next_position.array(), next_quaternion.array(),
          next_twist.array(),    array_or_none(next_weights)};
}

/// A body at the start of a step.
struct Start {
  Given position, quaternion, twist;

  Start(const py::object& p, const py::object& q, const py::object& v)
      : position("position", p, kThree),
        quaternion("quaternion", q, kFour, position.count()),
        twist("twist", v, kSix, position.count()) {}

  py::ssize_t count() const { return position.count(); }
  Probe::Body rows() const { return {position.rows(), quaternion.rows(), twist.rows()}; }
};

/// From one stage, or from four, to a body.
template <bool end>
py::tuple move(const py::object& p, const py::object& q, const py::object& v, const py::object& stage_q,
               const py::object& stage_v, const py::object& stage_a, double scale) {
  const Start start(p, q, v);
  const py::ssize_t n = start.count();
  const Given quaternion("stage_quaternion", stage_q, end ? staged(kFour) : kFour, n),
      twist("stage_twist", stage_v, end ? staged(kSix) : kSix, n),
      given("stage_acceleration", stage_a, end ? staged(kSix) : kSix, n);
  Made to_position(n, kThree), to_quaternion(n, kFour), to_twist(n, kSix);
  const Probe::BodyStage stage{quaternion.rows(), twist.rows(), given.rows()};
  (end ? Probe::after : Probe::moved)(start.rows(), stage, scale, to_position.column(), to_quaternion.column(),
                                      to_twist.column());
  return py::make_tuple(to_position.array(), to_quaternion.array(), to_twist.array());
}

}  // namespace

void bind_probe(py::module_& m) {
  py::class_<LawProbe>(m, "LawProbe", "What a law gives at n states.")
      .def_readonly("wrench", &LawProbe::wrench, "(n, 6) tau in B [N; N m]; NaN where the law has none")
      .def_readonly("fuzzy_output", &LawProbe::fuzzy_output, "(n, 6) tau_f [N; N m]; zero where no fuzzy systems act")
      .def_readonly("error_memberships", &LawProbe::error_memberships,
                    "(n, 6, 7) normalised, of u [1]; None where no fuzzy systems act")
      .def_readonly("rate_memberships", &LawProbe::rate_memberships,
                    "(n, 6, 7) normalised, of u-dot [1], or None; phi-bar[i, j, r, c] = error[i, j, r] rate[i, j, c]")
      .def_readonly("adaptation", &LawProbe::adaptation,
                    "(n, 6) a_j = driver_j/Psi_j, the dead zone taken off [N/s; N m/s], or None: omega_j-dot = a_j "
                    "phi-bar_j - sigma_j omega_j; the limit acts at the end of a step")
      .def_readonly("pose_error", &LawProbe::pose_error,
                    "(n, 6) that the law regulates, in B [m; rad]; None for a law that regulates none")
      .def_readonly("parts", &LawProbe::parts,
                    "by name, (n, 6) in B [N; N m]: `LawTraits.parts`, which sum to the wrench together with G-bar");

  py::class_<StageProbe>(m, "StageProbe", "The four Runge-Kutta stages of n steps, and the states after them.")
      .def_readonly("features", &StageProbe::features, "(n, 4, 2 p) of p points, true [px]")
      .def_readonly("depth", &StageProbe::depth, "(n, 4, p) true Z [m]")
      .def_readonly("position", &StageProbe::position, "(n, 4, 3) in B [m]")
      .def_readonly("quaternion", &StageProbe::quaternion, "(n, 4, 4) w x y z, not normalised inside the step")
      .def_readonly("twist", &StageProbe::twist, "(n, 4, 6) in B [m/s; rad/s]")
      .def_readonly("wrench", &StageProbe::wrench, "(n, 4, 6) in B [N; N m]")
      .def_readonly("fuzzy_output", &StageProbe::fuzzy_output, "(n, 4, 6) [N; N m]")
      .def_readonly("acceleration", &StageProbe::acceleration, "(n, 4, 6) in B [m/s^2; rad/s^2]")
      .def_readonly("next_features", &StageProbe::next_features, "(n, 2 p) [px]; NaN behind the camera, as all of next")
      .def_readonly("next_depth", &StageProbe::next_depth, "(n, p) [m]")
      .def_readonly("next_position", &StageProbe::next_position, "(n, 3) [m]")
      .def_readonly("next_quaternion", &StageProbe::next_quaternion, "(n, 4) w x y z")
      .def_readonly("next_twist", &StageProbe::next_twist, "(n, 6) [m/s; rad/s]")
      .def_readonly("next_weights", &StageProbe::next_weights,
                    "(n, 6, 7, 7) [N; N m]; None where no fuzzy systems act");

  py::class_<Probe> probe(m, "Probe", "The parts of a scenario's loop at given states, one per row.");
  probe.def(py::init<const Settings&>(), py::arg("settings"));
  const auto features = py::arg("features"), depth = py::arg("depth"), position = py::arg("position"),
             quaternion = py::arg("quaternion"), twist = py::arg("twist");
  probe.def_property_readonly("points", &Probe::points, "p, of the target")
      .def_property_readonly("has_fuzzy_systems", &Probe::has_fuzzy_systems,
                             "Whether the law has fuzzy systems that act.")
      .def_property_readonly(
          "initial_weights",
          [](const Probe& p) -> py::object {
            if (!p.has_fuzzy_systems()) return py::none();
            return weight_array(p.initial_weights());
          },
          "(6, 7, 7) omega(0) [N; N m]; None where no fuzzy systems act")
      .def("image", &image, position, quaternion,
           "(4): true features (n, 2 p) [px] and Z (n, p) [m]; features are NaN for a point that is not in front. "
           "ValueError for a camera as_printed.")
      .def("goal_minima", &goal_minima,
           "Poses from which the true points look nearest to the desired features, position (m, 3) [m] and quaternion "
           "(m, 4): minima of the image error found from home. ValueError for a camera as_printed.")
      .def("image_jacobian", &image_jacobian, features, depth, quaternion, py::arg("controller") = false,
           py::arg("position") = py::none(),
           "J of (12), (n, 2 p, 6): twist in B (m/s; rad/s) to feature rates [px/s], with the depths as given and the "
           "plant's sign, or the controller's. A camera on the base needs the platform's position (n, 3) in B [m].")
      .def("measured_depth", &measured_depth, depth, "Z-hat (n, p) of the controller for true Z (n, p) [m].")
      .def("law", &law, features, depth, position, quaternion, twist, py::arg("weights") = py::none(),
           "Output of the law: depth (n, p) as the controller estimates it [m], weights (n, 6, 7, 7) [N; N m] or the "
           "scenario's initial ones.")
      .def("acceleration", &acceleration, position, quaternion, twist, py::arg("wrench"),
           "chi-ddot (n, 6) of the actual plant, (3) [m/s^2; rad/s^2]; it is the same at every position.")
      .def("base_acceleration", &base_acceleration, py::arg("time"),
           "Acceleration of B (n, 3) in W [m/s^2] at times (n,) >= 0 [s]; zero in continuous mode, whose base stands.")
      .def(
          "base_motion", &base_motion, py::arg("time"),
          "Position p_WB (n, 3) [m], attitude R_WB (n, 3, 3), rate Omega (n, 3) [rad/s] and its change (n, 3) "
          "[rad/s^2], both in B, at times (n,) >= 0 [s]. NaN positions where a sinusoid or noise has a frequency of 0.")
      .def("base_wrench", &base_wrench, py::arg("time"), position, quaternion, twist,
           "What the motion of the base adds to the wrench on the actual platform (n, 6), in B [N; N m], at times (n,) "
           ">= 0 [s].")
      .def("estimated_wrenches", &estimated_wrenches, quaternion, twist, py::arg("acceleration"),
           "D-bar chi-ddot (n, 6), C-bar chi-dot (n, 6) and G-bar (6,) of (1), in B [N; N m].")
      .def("inertia", &inertia, quaternion, "D-bar of (1), (n, 6, 6): acceleration in B to wrench.")
      .def("stages", &stages, features, depth, position, quaternion, twist, py::arg("weights") = py::none(),
           "A Runge-Kutta step of the loop in continuous mode from each state; depth (n, p) is the true one [m].")
      .def_static("moved", &move<false>, position, quaternion, twist, py::arg("stage_quaternion"),
                  py::arg("stage_twist"), py::arg("stage_acceleration"), py::arg("scale"),
                  "Start + scale [s] times the rate of a stage: position, quaternion (not normalised), twist.")
      .def_static(
          "after", &move<true>, position, quaternion, twist, py::arg("stage_quaternion"), py::arg("stage_twist"),
          py::arg("stage_acceleration"), py::arg("step"),
          "The body after a step [s] from its four stages (n, 4, k): position, quaternion (normalised), twist.");
}

}  // namespace hexservo::bindings
