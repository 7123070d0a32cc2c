#include "bindings.hpp"

#include "hexservo/camera.hpp"

#include <pybind11/native_enum.h>

#include <algorithm>

namespace hexservo::bindings {

namespace {

using Pixels = Eigen::Matrix<double, Eigen::Dynamic, 2>;
using Numbers = Eigen::VectorXd;

/// Calls `function` with the first of every `kPoints` points, and how many of them there are.
template <class F>
void for_blocks(Eigen::Index points, F&& function) {
  for (Eigen::Index first = 0; first < points; first += kPoints)
    function(first, std::min<Eigen::Index>(kPoints, points - first));
}

void require_image(const Numbers& features, const Numbers& depth) {
  require_finite("features", features);
  require_finite("depth", depth);
  if (features.size() != 2 * depth.size())
    throw std::invalid_argument("depth: expected " + std::to_string(features.size() / 2) +
                                " numbers, one for two of the features, got " + std::to_string(depth.size()));
}

}  // namespace

void bind_camera(py::module_& m) {
  py::native_enum<CameraConvention>(m, "CameraConvention", "enum.Enum")
      .value("eye_in_hand", CameraConvention::eye_in_hand)
      .value("as_printed", CameraConvention::as_printed)
      .finalize();

  py::native_enum<MountedOn>(m, "MountedOn", "enum.Enum")
      .value("platform", MountedOn::platform)
      .value("base", MountedOn::base)
      .finalize();

  py::class_<CameraMount>(m, "Mount", "Frame C of the camera in E, or in B.")
      .def(py::init<>())
      .def_readwrite("on", &CameraMount::on, "the camera is fixed to; the target's points are fixed to the other one")
      .def_readwrite("position", &CameraMount::position, "of C's origin in E or B [m]")
      .def_readwrite("rotation", &CameraMount::rotation, "rotation vector of C in E or B [rad]");

  py::class_<Camera>(m, "Camera", "Pinhole camera, (4) of the paper.")
      .def(py::init<>())
      .def_readwrite("focal_length", &Camera::focal_length, "lambda [m]")
      .def_readwrite("pixel_scale", &Camera::pixel_scale, "alpha [px/m]")
      .def_readwrite("mount", &Camera::mount, "C in E, or in B")
      .def_property_readonly("focal_pixels", &Camera::focal, "f of the pinhole [px]")
      .def(
          "features",
          [](const Camera& camera, const Pixels& pixels) {
            const Lens<double> lens(camera.lens());
            Pixels features(pixels.rows(), 2);
            for (Eigen::Index i = 0; i < pixels.rows(); ++i)
              features.row(i) = lens.features(Vector2<double>(pixels.row(i).transpose())).transpose();
            return features;
          },
          py::arg("pixels"), "Features (n, 2) of the pinhole [px] of pixels (n, 2); NaN where the lens shows none.")
      .def(
          "pixels",
          [](const Camera& camera, const Pixels& features) {
            const Lens<double> lens(camera.lens());
            Pixels pixels(features.rows(), 2);
            for (Eigen::Index i = 0; i < features.rows(); ++i)
              pixels.row(i) = lens.pixels(Vector2<double>(features.row(i).transpose())).transpose();
            return pixels;
          },
          py::arg("features"), "Pixels (n, 2) of features (n, 2) of the pinhole [px]; NaN where the lens shows none.")
      .def(
          "in_mount",
          [](const Camera& camera, const Eigen::Matrix<double, Eigen::Dynamic, 3>& points) {
            const Placement<double> at = camera.parameters().placement;
            Eigen::Matrix<double, Eigen::Dynamic, 3> moved(points.rows(), 3);
            for (Eigen::Index i = 0; i < points.rows(); ++i)
              moved.row(i) = at.in_mount(points.row(i).transpose()).transpose();
            return moved;
          },
          py::arg("points"), "Points (n, 3) in C [m] in E, or in B for a camera mounted there.");

  m.def(
      "take_image",
      [](const Camera& camera, const Vector3<double>& position, const Vector4<double>& quaternion,
         const Eigen::Matrix<double, Eigen::Dynamic, 3>& points) {
        require_finite("points", points);
        const Pose<double> pose = checked_pose(position, quaternion);
        const PlatformCamera<double> mounted(camera.parameters());
        const Matrix3<double> R_BE = rotation_matrix(pose.quaternion);
        Numbers features(2 * points.rows()), depth(points.rows());
        for_blocks(points.rows(), [&](Eigen::Index first, Eigen::Index count) {
          Eigen::Matrix<double, 3, kPoints> block;
          for (int i = 0; i < kPoints; ++i)
            block.col(i) = points.row(first + std::min<Eigen::Index>(i, count - 1)).transpose();
          const Image<double> image = take_image<double, kPoints>(mounted, pose.position, R_BE, block);
          features.segment(2 * first, 2 * count) = image.features.head(2 * count);
          depth.segment(first, count) = image.depth.head(count);
        });
        return py::make_tuple(features, depth);
      },
      py::arg("camera"), py::arg("position"), py::arg("quaternion"), py::arg("points"),
      "(4): features (2 p,) [px] and depth Z (p,) [m], negative in front, of points (p, 3) in B [m], or in E "
      "for a camera on the base.");

  m.def(
      "lift",
      [](const Camera& camera, const Vector3<double>& position, const Vector4<double>& quaternion,
         const Numbers& features, const Numbers& depth) {
        require_image(features, depth);
        const Pose<double> pose = checked_pose(position, quaternion);
        const PlatformCamera<double> mounted(camera.parameters());
        const Matrix3<double> R_BE = rotation_matrix(pose.quaternion);
        Eigen::Matrix<double, Eigen::Dynamic, 3> points(depth.size(), 3);
        for (Eigen::Index i = 0; i < depth.size(); ++i)
          points.row(i) = lift<double>(mounted, pose.position, R_BE, features.segment<2>(2 * i), depth(i)).transpose();
        return points;
      },
      py::arg("camera"), py::arg("position"), py::arg("quaternion"), py::arg("features"), py::arg("depth"),
      "Inverse of take_image: points (p, 3) in B, or in E [m].");

  m.def(
      "image_jacobian",
      [](const Camera& camera, const Numbers& features, const Numbers& depth, const Vector4<double>& quaternion,
         CameraConvention convention, const std::optional<Vector3<double>>& position) {
        require_image(features, depth);
        if ((depth.array() == 0.0).any())
          throw std::invalid_argument("depth: expected numbers that are not zero, got zero");
        if (camera.mount.on == MountedOn::base && !position)
          throw std::invalid_argument("position: expected that of the platform for a camera on the base, got None");
        const Pose<double> pose = checked_pose(position.value_or(Vector3<double>::Zero()), quaternion);
        const Matrix3<double> R_BE = rotation_matrix(pose.quaternion);
        const PlatformCamera<double> mounted(camera.parameters());
        Eigen::Matrix<double, Eigen::Dynamic, 6> J(features.size(), 6);
        for_blocks(depth.size(), [&](Eigen::Index first, Eigen::Index count) {
          Image<double> image;
          for (int i = 0; i < kPoints; ++i) {
            const Eigen::Index at = first + std::min<Eigen::Index>(i, count - 1);
            image.features.segment<2>(2 * i) = features.segment<2>(2 * at);
            image.depth(i) = depth(at);
          }
          J.middleRows(2 * first, 2 * count) =
              ImageJacobian<double>(mounted, plant_sign(convention), image, pose.position, R_BE)
                  .matrix()
                  .topRows(2 * count);
        });
        return J;
      },
      py::arg("camera"), py::arg("features"), py::arg("depth"), py::arg("quaternion"),
      py::arg("convention") = CameraConvention::eye_in_hand, py::arg("position") = py::none(),
      "J of (12), (2 p, 6): twist in B (m/s; rad/s) to image velocity [px/s], for features (2 p,) and depth (p,). A "
      "camera on the base needs the platform's position (3,) in B [m].");
}

}  // namespace hexservo::bindings
