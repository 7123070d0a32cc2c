#include "bindings.hpp"

#include "hexservo/leg_limits.hpp"

#include <pybind11/native_enum.h>

namespace hexservo::bindings {

namespace {

Legs<double> legs_at(const Hexapod<double>& hexapod, const Vector3<double>& position,
                     const Vector4<double>& quaternion) {
  const Pose<double> pose = checked_pose(position, quaternion);
  return inverse_kinematics(hexapod, pose.position, rotation_matrix(pose.quaternion));
}

}  // namespace

void bind_hexapod(py::module_& m) {
  py::class_<CrankParameters>(m, "CrankParameters", "Cranks of rotary legs, docs/model.md section 2.")
      .def(py::init<>())
      .def_readwrite("length", &CrankParameters::length, "[m], 0: none")
      .def_readwrite("rod", &CrankParameters::rod, "[m], 0: none")
      .def_readwrite("axes", &CrankParameters::axes, "(6, 3) unit vectors in B, or None")
      .def_readwrite("zero", &CrankParameters::zero, "(6, 3) unit vectors in B, or None")
      .def_readwrite("branch", &CrankParameters::branch, "(6,) 1 or -1, or None");

  py::class_<RobotParameters>(m, "RobotParameters",
                              "A robot as a user describes it, docs/model.md section 2; default: micro.")
      .def(py::init<>())
      .def_readwrite("platform_radius", &RobotParameters::platform_radius, "[m]")
      .def_readwrite("base_radius", &RobotParameters::base_radius, "[m]")
      .def_readwrite("platform_angles", &RobotParameters::platform_angles, "(6,) about z of E [rad]")
      .def_readwrite("base_angles", &RobotParameters::base_angles, "(6,) about z of B [rad]")
      .def_readwrite("platform_joints", &RobotParameters::platform_joints, "(6, 3) in E, or None: on a circle [m]")
      .def_readwrite("base_joints", &RobotParameters::base_joints, "(6, 3) in B, or None: on a circle [m]")
      .def_readwrite("home_position", &RobotParameters::home_position, "(3,) in B [m]")
      .def_readwrite("home_attitude", &RobotParameters::home_attitude, "(3,) rotation vector of E in B at home [rad]")
      .def_property(
          "legs", [](const RobotParameters& r) { return text(kNamesOf<LegKind>[static_cast<std::size_t>(r.legs)]); },
          [](RobotParameters& r, const std::string& name) {
            for (std::size_t kind = 0; kind < kNamesOf<LegKind>.size(); ++kind)
              if (kNamesOf<LegKind>[kind] == name) {
                r.legs = static_cast<LegKind>(kind);
                return;
              }
            throw std::invalid_argument("legs: expected prismatic or rotary, got \"" + name + "\"");
          },
          "prismatic or rotary")
      .def_readwrite("cranks", &RobotParameters::cranks, "of rotary legs")
      .def_readwrite("gravity", &RobotParameters::gravity, "(3,) acceleration in B [m/s^2]")
      .def_readwrite("mass", &RobotParameters::mass, "[kg]")
      .def_readwrite("inertia", &RobotParameters::inertia, "(3, 3) about E's origin, in E [kg m^2]")
      .def_readwrite("centre_of_mass", &RobotParameters::centre_of_mass,
                     "(3,) of the platform without payload, in E [m]")
      .def_readwrite("stroke", &RobotParameters::stroke, "leg travel about its middle, each way [m]")
      .def_readwrite("stroke_centre", &RobotParameters::stroke_centre, "middle of the travel, from the home length [m]")
      .def_readwrite("force_limit", &RobotParameters::force_limit, "of each leg, each way [N]")
      .def_readwrite("speed_limit", &RobotParameters::speed_limit, "of each leg, each way [m/s]; infinity: none")
      .def_readwrite("joint_limit", &RobotParameters::joint_limit,
                     "(2,) tilt of a leg from its direction at home, seen from base and platform [rad], or None");

  m.def("robot_preset", &robot_preset, py::arg("name"), "Preset of that name; ValueError lists the known ones.");
  py::tuple presets(kRobotPresets.size());
  for (std::size_t i = 0; i < kRobotPresets.size(); ++i)
    presets[i] = py::str(kRobotPresets[i].data(), kRobotPresets[i].size());
  m.attr("ROBOT_PRESETS") = presets;

  py::native_enum<KinematicsStatus>(m, "KinematicsStatus", "enum.Enum")
      .value("converged", KinematicsStatus::converged)
      .value("not_converged", KinematicsStatus::not_converged)
      .value("singular", KinematicsStatus::singular)
      .finalize();

  py::class_<ForwardKinematics<double>>(m, "ForwardKinematics", "Pose found from leg lengths.")
      .def_property_readonly(
          "position", [](const ForwardKinematics<double>& r) { return r.pose.position; }, "(3,) in B [m]")
      .def_property_readonly(
          "quaternion", [](const ForwardKinematics<double>& r) { return r.pose.quaternion; }, "(4,) w x y z")
      .def_readonly("residual", &ForwardKinematics<double>::residual, "largest leg length error [m]")
      .def_property_readonly("status", &status, "converged (residual within 1e-12 m), not_converged or singular");

  py::class_<Hexapod<double>>(m, "Hexapod", "Legs of a robot; poses are (position in B [m], quaternion w x y z).")
      .def(py::init(&make_hexapod), py::arg("robot"), "ValueError where the legs cannot hold a platform.")
      .def_readonly("home_position", &Hexapod<double>::home_position, "(3,) in B [m]")
      .def_readonly("home_quaternion", &Hexapod<double>::home_quaternion, "(4,) w x y z, of E in B")
      .def_readonly("platform_radius", &Hexapod<double>::platform_radius,
                    "that moments are divided by; of joints given one by one the RMS distance from their mean [m]")
      .def_readonly("home_lengths", &Hexapod<double>::home_lengths, "(6,) [m]")
      .def_readonly("mid_lengths", &Hexapod<double>::mid_lengths, "(6,) in the middle of their travel [m]")
      .def_property_readonly(
          "platform_joints",
          [](const Hexapod<double>& h) { return Eigen::Matrix<double, 6, 3>(h.platform_joints_E.transpose()); },
          "(6, 3) in E [m]")
      .def_property_readonly(
          "base_joints",
          [](const Hexapod<double>& h) { return Eigen::Matrix<double, 6, 3>(h.base_joints_B.transpose()); },
          "(6, 3) in B [m]")
      .def(
          "leg_lengths",
          [](const Hexapod<double>& h, const Vector3<double>& p, const Vector4<double>& q) {
            return legs_at(h, p, q).lengths;
          },
          py::arg("position"), py::arg("quaternion"),
          "Inverse kinematics: (6,) lengths [m], or crank angles [rad], NaN where a crank does not close.")
      .def(
          "leg_travel",
          [](const Hexapod<double>& h, const Vector3<double>& p, const Vector4<double>& q) {
            return leg_travel<double>(legs_at(h, p, q).lengths, h.mid_lengths, h.stroke);
          },
          py::arg("position"), py::arg("quaternion"),
          "(6,) from the middle of the stroke [m], or [rad]; its end where a leg is beyond it by rounding alone, NaN "
          "where a crank does not close.")
      .def(
          "leg_tilts",
          [](const Hexapod<double>& h, const Vector3<double>& p, const Vector4<double>& q) {
            return leg_tilts(h, checked_pose(p, q));
          },
          py::arg("position"), py::arg("quaternion"),
          "(2, 6) angles between the legs and their directions at home, seen from base and platform [rad].")
      .def(
          "wrench_map",
          [](const Hexapod<double>& h, const Vector3<double>& p, const Vector4<double>& q) {
            return legs_at(h, p, q).wrench_map();
          },
          py::arg("position"), py::arg("quaternion"),
          "H, (6, 6): leg forces [N] to wrench about E's origin in B [N; N m]; H^T: twist to leg rates. Of rotary legs "
          "H W^-1: torques [N m] to wrench.")
      .def(
          "leg_forces",
          [](const Hexapod<double>& h, const Vector3<double>& p, const Vector4<double>& q,
             const Vector6<double>& wrench) {
            require_finite("wrench", wrench);
            const WrenchMapSolver<double> solver(h, legs_at(h, p, q));
            if (solver.failed())
              throw std::invalid_argument("position: expected a pose that is not singular, got a singular one");
            return solver.leg_forces(wrench);
          },
          py::arg("position"), py::arg("quaternion"), py::arg("wrench"), "(6,) f_c with H f_c = wrench [N].")
      .def(
          "forward_kinematics",
          [](const Hexapod<double>& h, const Vector6<double>& lengths, const Vector3<double>& p,
             const Vector4<double>& q) {
            require_finite("lengths", lengths);
            if (!h.rotary && !(lengths.minCoeff() > 0.0))
              throw std::invalid_argument("lengths: expected numbers > 0, got " + std::to_string(lengths.minCoeff()));
            return forward_kinematics(h, lengths, checked_pose(p, q));
          },
          py::arg("lengths"), py::arg("start_position"), py::arg("start_quaternion"),
          "Pose near the start with these leg lengths (6,) [m], or crank angles [rad], by Newton's method.")
      .def(
          "singular_values",
          [](const Hexapod<double>& h, const Vector3<double>& p, const Vector4<double>& q) {
            return wrench_map_singular_values(h, checked_pose(p, q));
          },
          py::arg("position"), py::arg("quaternion"),
          "(6,) of H with moments divided by the platform radius, largest first [1]; the last is the distance to "
          "singularity. Of rotary legs H is that of the rods; 0 where a crank does not close.")
      .def_readonly("rotary", &Hexapod<double>::rotary, "whether the legs have cranks")
      .def(
          "lever_arms",
          [](const Hexapod<double>& h, const Vector3<double>& p, const Vector4<double>& q) {
            return lever_arms(h, checked_pose(p, q));
          },
          py::arg("position"), py::arg("quaternion"),
          "(6,) w_i of rotary legs [m], 0 where crank and rod are in line, NaN where a crank does not close; else 1.")
      .def(
          "leg_feet",
          [](const Hexapod<double>& h, const Vector3<double>& p, const Vector4<double>& q) {
            return Eigen::Matrix<double, 6, 3>(leg_feet(h, checked_pose(p, q)).transpose());
          },
          py::arg("position"), py::arg("quaternion"),
          "(6, 3) ends of the cranks in B [m]; of prismatic legs the base joints.");
}

}  // namespace hexservo::bindings
