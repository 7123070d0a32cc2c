#include "bindings.hpp"

#include "hexservo/camera.hpp"

#include <pybind11/native_enum.h>

namespace hexservo::bindings {

void bind_camera(py::module_& m) {
  py::native_enum<CameraConvention>(m, "CameraConvention", "enum.Enum")
      .value("eye_in_hand", CameraConvention::eye_in_hand)
      .value("as_printed", CameraConvention::as_printed)
      .finalize();

  py::class_<Camera<double>>(m, "Camera", "Pinhole camera, (4) of the paper.")
      .def(py::init<>())
      .def_readwrite("focal_length", &Camera<double>::focal_length, "lambda [m]")
      .def_readwrite("pixel_scale", &Camera<double>::pixel_scale, "alpha [px/m]")
      .def_property_readonly("focal_pixels", &Camera<double>::focal_pixels, "f = alpha lambda [px]");

  m.def(
      "take_image",
      [](const Camera<double>& camera, const Vector3<double>& position, const Vector4<double>& quaternion,
         const Eigen::Matrix<double, kPoints, 3>& points) {
        require_finite("points", points);
        const Pose<double> pose = checked_pose(position, quaternion);
        const Image<double> image = take_image<double, kPoints>(camera.focal_pixels(), pose.position,
                                                                rotation_matrix(pose.quaternion), points.transpose());
        return py::make_tuple(image.features, image.depth);
      },
      py::arg("camera"), py::arg("position"), py::arg("quaternion"), py::arg("points"),
      "(4): features (8,) [px] and depth Z (4,) [m], negative in front, of points (4, 3) in B [m].");

  m.def(
      "image_jacobian",
      [](const Camera<double>& camera, const Vector<double, 2 * kPoints>& features,
         const Vector<double, kPoints>& depth, const Vector4<double>& quaternion, CameraConvention convention) {
        require_finite("features", features);
        require_finite("depth", depth);
        if ((depth.array() == 0.0).any())
          throw std::invalid_argument("depth: expected numbers that are not zero, got zero");
        const Matrix3<double> R_BE = rotation_matrix(checked_pose(Vector3<double>::Zero(), quaternion).quaternion);
        const Image<double> image{features, depth};
        return ImageJacobian<double>(camera.focal_pixels(), plant_sign(convention), image, R_BE).matrix();
      },
      py::arg("camera"), py::arg("features"), py::arg("depth"), py::arg("quaternion"),
      py::arg("convention") = CameraConvention::eye_in_hand,
      "J of (12), (8, 6): twist in B (m/s; rad/s) to image velocity [px/s].");
}

}  // namespace hexservo::bindings
