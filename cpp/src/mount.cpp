#include "hexservo/mount.hpp"

#include "check.hpp"

#include <numbers>

namespace hexservo {

namespace {

constexpr double kHalfTurn = std::numbers::pi * (1.0 + 1e-12);  // as far as a rotation vector reaches [rad]

Eigen::AngleAxisd turn_of(const Vector3<double>& rotation) {
  const double angle = rotation.norm();
  return {angle, angle > 0.0 ? Vector3<double>(rotation / angle) : Vector3<double>::UnitZ()};
}

}  // namespace

Placement<double> placement(const Mount& mount, std::string_view key) {
  const double angle = mount.rotation.norm();
  if (!(angle <= kHalfTurn))
    detail::refuse(detail::words(key, ".rotation"), "a rotation vector at most 3.14159 rad long",
                   detail::words("one of ", angle, " rad", angle > 2.0 * kHalfTurn ? " (degrees?)" : ""));
  Placement<double> found;
  found.p_MC = mount.position;
  if (angle > 0.0) found.R_MC = turn_of(mount.rotation).toRotationMatrix();
  return found;
}

CameraMount assumed_mount(const CameraMount& mount, const Mount& error) {
  CameraMount assumed = mount;
  assumed.position += error.position;
  if (error.rotation.isZero(0.0)) return assumed;
  const Eigen::AngleAxisd turn(Eigen::Quaterniond(turn_of(mount.rotation)) *
                               Eigen::Quaterniond(turn_of(error.rotation)));
  assumed.rotation = turn.angle() * turn.axis();
  return assumed;
}

}  // namespace hexservo
