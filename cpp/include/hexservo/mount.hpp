/// @file
/// Where the camera is: its frame C in the frame M that it is mounted on, the platform's E or the base's B, and what
/// both have to do with each other (docs/model.md, section 4).
///
/// | symbol     | here                   |                                                                 |
/// | ---------- | ---------------------- | --------------------------------------------------------------- |
/// | r          | Placement::p_MC        | centre of projection in M [m]                                   |
/// | R_MC       | Placement::R_MC        | turns C-coordinates into M-coordinates                          |
/// | J_M        | to_camera, to_mount    | J_C [R_MC^T, -R_MC^T [r]x; 0, R_MC^T] of twists of M in M; transpose |
#pragma once

#include "hexservo/types.hpp"

namespace hexservo {

/// What the camera is mounted on; the target's points are fixed to the other one.
enum class MountedOn {
  platform,  ///< M is E, eye in hand: the points are fixed in B
  base       ///< M is B, eye to hand: the points are fixed in E
};

/// The camera's place in M as a scenario has it, or an error of it.
struct Mount {
  Vector3<double> position = Vector3<double>::Zero();  ///< of C's origin in M [m], 0
  Vector3<double> rotation = Vector3<double>::Zero();  ///< rotation vector of C in M, at most pi long [rad], 0

  /// Whether C is M.
  bool is_none() const { return position.isZero(0.0) && rotation.isZero(0.0); }

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"position", "m", kCoordinate}.entrywise(), self.position...);
    v(Field{"rotation", "rad"}.entrywise(), self.rotation...);
  }
};

/// A mount with what it is on.
struct CameraMount : Mount {
  MountedOn on = MountedOn::platform;

  /// Whether C is E.
  bool is_none() const { return on == MountedOn::platform && Mount::is_none(); }

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    Mount::visit(v, self...);
    v(Field{"on"}.of_pack(), self.on...);
  }
};

/// Frame C in M, prepared.
template <class S>
struct Placement {
  Vector3<S> p_MC = Vector3<S>::Zero();      ///< r [m]
  Matrix3<S> R_MC = Matrix3<S>::Identity();  ///< turns C-coordinates into M-coordinates
  MountedOn on = MountedOn::platform;        ///< what M is

  bool on_base() const { return on == MountedOn::base; }

  /// Whether C differs from E, in any lane.
  bool differs() const {
    if (on_base()) return true;
    Mask<S> moved(false);
    for (int i = 0; i < 3; ++i) {
      moved = moved | !(p_MC(i) == S(0.0));
      for (int j = 0; j < 3; ++j) moved = moved | !(R_MC(i, j) == S(i == j ? 1.0 : 0.0));
    }
    return any(moved);
  }

  /// Point in M of a point in C [m].
  Vector3<S> in_mount(const Vector3<S>& p_C) const noexcept {
    const Vector3<S> turned = rotate<S>(R_MC, p_C);
    return Vector3<S>(p_MC(0) + turned(0), p_MC(1) + turned(1), p_MC(2) + turned(2));
  }

  /// Velocity and angular velocity of M at its origin, in M, become those of the camera, in C.
  void to_camera(Vector3<S>& v, Vector3<S>& w) const noexcept {
    const Vector3<S> lever = cross<S>(w, p_MC);
    v = rotate_back<S>(R_MC, Vector3<S>(v(0) + lever(0), v(1) + lever(1), v(2) + lever(2)));
    w = rotate_back<S>(R_MC, w);
  }

  /// Force and moment on the camera, about and in C, become those on M, about its origin and in it.
  void to_mount(Vector3<S>& force, Vector3<S>& moment) const noexcept {
    force = rotate<S>(R_MC, force);
    const Vector3<S> turned = rotate<S>(R_MC, moment), lever = cross<S>(p_MC, force);
    moment = Vector3<S>(turned(0) + lever(0), turned(1) + lever(1), turned(2) + lever(2));
  }

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"p_MC", "m"}, self.p_MC...);
    v(Field{"R_MC", "1"}, self.R_MC...);
    v(Field{"on"}, self.on...);
  }
};

/// Frame C of a mount in M; `on` is left to be set.
/// @throws std::invalid_argument where the rotation vector is longer than pi
/// @param key of the mount in a scenario, "camera.mount"
Placement<double> placement(const Mount& mount, std::string_view key);

/// The mount that is assumed where the true one is `mount`: C-hat is off C by `error.position` in M, and by the
/// rotation vector `error.rotation` in C: R_MC-hat = R_MC exp([error.rotation]x).
CameraMount assumed_mount(const CameraMount& mount, const Mount& error);

}  // namespace hexservo
