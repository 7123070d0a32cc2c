#include "bindings.hpp"

namespace hexservo::bindings {

void bind_rigid_body(py::module_& m) {
  py::class_<RigidBody<double>>(m, "RigidBody", "Mass properties of the platform, docs/model.md section 3.")
      .def(py::init<>())
      .def_readwrite("mass", &RigidBody<double>::mass, "platform mass [kg]")
      .def_readwrite("inertia", &RigidBody<double>::inertia_E, "(3, 3) about E's origin, in E [kg m^2]")
      .def_readwrite("gravity", &RigidBody<double>::gravity, "(3,) acceleration in B [m/s^2]")
      .def_property(
          "centre_of_mass", [](const RigidBody<double>& b) { return b.centre_E; },
          [](RigidBody<double>& b, const Vector3<double>& centre) {
            b.centre_E = centre;
            b.off_centre = b.off_centre || centre != Vector3<double>::Zero();
          },
          "(3,) in E [m]")
      .def_property_readonly(
          "gravity_wrench", [](const RigidBody<double>& b) { return gravity_wrench<double>(b); },
          "(6,) G of (1) with the centre of mass in E's origin, in B [N; N m]")
      .def(
          "weight",
          [](const RigidBody<double>& b, const Vector4<double>& q) {
            return gravity_wrench<double>(b, rotation_matrix(checked_pose(Vector3<double>::Zero(), q).quaternion));
          },
          py::arg("quaternion"), "(6,) G of (1) at an attitude, what holds the platform at rest, in B [N; N m]");

  py::class_<DynamicsError<double>>(m, "DynamicsError", "Relative errors of the estimated dynamics, (3) of the paper.")
      .def(py::init<>())
      .def_readwrite("inertia", &DynamicsError<double>::inertia, "(6, 6) delta_D [1]")
      .def_readwrite("coriolis", &DynamicsError<double>::coriolis, "(6, 6) delta_C [1]")
      .def_readwrite("gravity", &DynamicsError<double>::gravity, "(6,) delta_G [1]");
}

}  // namespace hexservo::bindings
