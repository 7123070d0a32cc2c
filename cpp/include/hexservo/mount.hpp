/// @file
/// Where the camera is on the platform: frame C of the camera in frame E, and what both have to do with each other
/// (docs/model.md, section 4).
///
/// | symbol     | here                   |                                                                 |
/// | ---------- | ---------------------- | --------------------------------------------------------------- |
/// | r          | Placement::p_EC        | centre of projection in E [m]                                   |
/// | R_EC       | Placement::R_EC        | turns C-coordinates into E-coordinates                          |
/// | J_E        | to_camera, to_platform | J_C [R_EC^T, -R_EC^T [r]x; 0, R_EC^T] of twists in E, and its transpose |
#pragma once

#include "hexservo/types.hpp"

namespace hexservo {

/// The camera's place on the platform as a scenario has it, or an error of it.
struct Mount {
  Vector3<double> position = Vector3<double>::Zero();  ///< of C's origin in E [m], 0
  Vector3<double> rotation = Vector3<double>::Zero();  ///< rotation vector of C in E, at most pi long [rad], 0

  /// Whether C is E.
  bool is_none() const { return position.isZero(0.0) && rotation.isZero(0.0); }

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"position", "m"}.entrywise(), self.position...);
    v(Field{"rotation", "rad"}.entrywise(), self.rotation...);
  }
};

/// Frame C in E, prepared.
template <class S>
struct Placement {
  Vector3<S> p_EC = Vector3<S>::Zero();      ///< r [m]
  Matrix3<S> R_EC = Matrix3<S>::Identity();  ///< turns C-coordinates into E-coordinates

  /// Whether C differs from E, in any lane.
  bool differs() const {
    Mask<S> moved(false);
    for (int i = 0; i < 3; ++i) {
      moved = moved | !(p_EC(i) == S(0.0));
      for (int j = 0; j < 3; ++j) moved = moved | !(R_EC(i, j) == S(i == j ? 1.0 : 0.0));
    }
    return any(moved);
  }

  /// Point in E of a point in C [m].
  Vector3<S> in_platform(const Vector3<S>& p_C) const noexcept {
    const Vector3<S> turned = rotate<S>(R_EC, p_C);
    return Vector3<S>(p_EC(0) + turned(0), p_EC(1) + turned(1), p_EC(2) + turned(2));
  }

  /// Velocity and angular velocity of the platform at E's origin, in E, become those of the camera, in C.
  void to_camera(Vector3<S>& v, Vector3<S>& w) const noexcept {
    const Vector3<S> lever = cross<S>(w, p_EC);
    v = rotate_back<S>(R_EC, Vector3<S>(v(0) + lever(0), v(1) + lever(1), v(2) + lever(2)));
    w = rotate_back<S>(R_EC, w);
  }

  /// Force and moment on the camera, about and in C, become those on the platform, about and in E.
  void to_platform(Vector3<S>& force, Vector3<S>& moment) const noexcept {
    force = rotate<S>(R_EC, force);
    const Vector3<S> turned = rotate<S>(R_EC, moment), lever = cross<S>(p_EC, force);
    moment = Vector3<S>(turned(0) + lever(0), turned(1) + lever(1), turned(2) + lever(2));
  }

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"p_EC", "m"}, self.p_EC...);
    v(Field{"R_EC", "1"}, self.R_EC...);
  }
};

/// Frame C of a mount in E.
/// @throws std::invalid_argument where the rotation vector is longer than pi
/// @param key of the mount in a scenario, "camera.mount"
Placement<double> placement(const Mount& mount, std::string_view key);

/// The mount that is assumed where the true one is `mount`: C-hat is off C by `error.position` in E, and by the
/// rotation vector `error.rotation` in C: R_EC-hat = R_EC exp([error.rotation]x).
Mount assumed_mount(const Mount& mount, const Mount& error);

}  // namespace hexservo
