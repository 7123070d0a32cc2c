/// @file
/// The six legs: inverse and forward kinematics, wrench map, leg rates and forces, limits, distance to singularity.
///
/// | paper / docs/model.md, 2 | here            |                                                             |
/// | ------------------------ | --------------- | ----------------------------------------------------------- |
/// | p_i, b_i                 | platform_joints_E, base_joints_B | joint positions [m], one column per leg    |
/// | s_i = x_p + R p_i - b_i  | leg vector      | from base joint to platform joint, in B [m]                 |
/// | l_i = |s_i|, c_i         | lengths, directions_B            | leg lengths [m], unit vectors              |
/// | H                        | wrench map      | 6x6, leg forces [N] to wrench in B; H^T: twist to leg rates |
///
/// A leg has a coordinate and an effort: its length and its force, or of a rotary leg the angle of its crank and the
/// torque there. With the lever arm w_i of a crank, W = diag(w_i), rates are W^-1 H^T chi-dot and the wrench is
/// H W^-1 m: c_i/w_i takes the place of c_i, and everything that is made of directions and lengths holds for both.
#pragma once

#include "hexservo/cholesky.hpp"
#include "hexservo/rigid_body.hpp"
#include "hexservo/side_by_side.hpp"

#include <array>
#include <optional>
#include <string>
#include <string_view>

namespace hexservo {

/// Six angles, given in degrees [rad].
inline Vector6<double> degrees(double a, double b, double c, double d, double e, double f) {
  return (Vector6<double>() << a, b, c, d, e, f).finished() * EIGEN_PI / 180.0;
}

/// What a leg beyond its stroke, its speed limit or its joint limit means, in `sampled` mode.
enum class LimitPolicy {
  report,  ///< an event, with time and peak
  stop     ///< the end of the run, with `Outcome::leg_limit`
};

/// Where six joints are, one in each row [m].
using Joints = Eigen::Matrix<double, 6, 3>;

/// A body that is fixed to the platform.
struct Payload {
  double mass = 0.0;                                   ///< [kg], 0: none
  Vector3<double> position = Vector3<double>::Zero();  ///< of its centre of mass in E [m], 0
  Matrix3<double> inertia = Matrix3<double>::Zero();   ///< about its centre of mass, in axes of E [kg m^2], 0
  bool known = true;                                   ///< to the controller; the plant has it in any case

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"mass", "kg", kMassOrZero}, self.mass...);
    v(Field{"position", "m", kCoordinate}.entrywise(), self.position...);
    v(Field{"inertia", "kg m^2", kInertia}.symmetric(), self.inertia...);
    v(Field{"known"}, self.known...);
  }
};

/// What drives a leg.
enum class LegKind {
  prismatic,  ///< its length
  rotary      ///< a crank at the base, with a rod of fixed length to the platform
};

/// The cranks of rotary legs, whose centres are the base joints: none where the legs are prismatic.
struct CrankParameters {
  double length = 0.0;         ///< r, from a crank's centre to its rod [m]
  double rod = 0.0;            ///< d, length of the rods [m]
  std::optional<Joints> axes;  ///< a_i, of rotation, unit vectors in B [1], one in each row
  std::optional<Joints> zero;  ///< e_i, of the crank at angle 0, unit vectors in B [1], at right angles to a_i
  std::optional<Vector6<double>> branch;  ///< sigma_i, +1 or -1: which of the two angles of a pose [1]

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"length", "m", kLengthOrZero}.of_legs(), self.length...);
    v(Field{"rod", "m", kLengthOrZero}.of_legs(), self.rod...);
    v(Field{"axes", "1"}.entrywise().of_legs(), self.axes...);
    v(Field{"zero", "1"}.entrywise().of_legs(), self.zero...);
    v(Field{"branch", "1", kSign}.entrywise().of_legs(), self.branch...);
  }
};

/// A robot as a user describes it: leg geometry, mass properties and limits. The defaults are the preset `micro`.
struct RobotParameters {
  double platform_radius = 0.1;                                           ///< r_p [m], 0.1 (paper)
  double base_radius = 0.2;                                               ///< r_b [m], 0.2 (paper)
  Vector6<double> platform_angles = degrees(-50, 50, 70, 170, 190, 290);  ///< phi_i about z of E [rad], -50 ... 290 deg
  Vector6<double> base_angles = degrees(-10, 10, 110, 130, 230, 250);  ///< beta_i about z of B [rad], -10 ... 250 deg
  std::optional<Joints> platform_joints;                               ///< p_i in E [m], in place of radius and angles
  std::optional<Joints> base_joints;                                   ///< b_i in B [m], likewise
  Vector3<double> home_position = {0.0, 0.0, -0.15};                   ///< p_BE at home [m], (0, 0, -0.15)
  Vector3<double> home_attitude = {0.0, 0.0, 0.0};                     ///< rotation vector of R_BE at home [rad], 0
  LegKind legs = LegKind::prismatic;
  CrankParameters cranks;
  Vector3<double> gravity = RigidBody<double>{}.gravity;     ///< g in B [m/s^2], (0, 0, 9.8)
  double mass = RigidBody<double>{}.mass;                    ///< platform with camera [kg], 0.06 (paper)
  Matrix3<double> inertia = RigidBody<double>{}.inertia_E;   ///< about E's origin, in E [kg m^2], diag(1.5, 1.5, 3) e-4
  Vector3<double> centre_of_mass = Vector3<double>::Zero();  ///< of the platform without payload, in E [m], 0 (paper)
  Payload payload;
  /// The centre of mass may be elsewhere than in E's origin: where a batch varies it, in all its scenarios.
  bool off_centre = false;
  double stroke = 0.017;                                         ///< leg travel about its middle, each way [m], 0.017
  double stroke_centre = 0.0;                                    ///< middle of the travel, from the home length [m], 0
  double force_limit = 1.0;                                      ///< of each leg, each way [N], 1
  double speed_limit = std::numeric_limits<double>::infinity();  ///< of each leg, each way [m/s], infinity (none)
  /// Largest angle between a leg and its direction at home, seen from the base and from the platform [rad], none.
  std::optional<Vector2<double>> joint_limit;
  LimitPolicy on_limit = LimitPolicy::report;
  long long limits_every = 1;  ///< samples from one at which limits, and metrics of the legs, are looked at, 1

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"platform_radius", "m", kLength}.of_legs(), self.platform_radius...);
    v(Field{"base_radius", "m", kLength}.of_legs(), self.base_radius...);
    v(Field{"platform_angles", "rad", kAngle}.entrywise().of_legs(), self.platform_angles...);
    v(Field{"base_angles", "rad", kAngle}.entrywise().of_legs(), self.base_angles...);
    v(Field{"platform_joints", "m", kCoordinate}.entrywise().of_legs(), self.platform_joints...);
    v(Field{"base_joints", "m", kCoordinate}.entrywise().of_legs(), self.base_joints...);
    v(Field{"home_position", "m", kCoordinate}.entrywise().of_legs(), self.home_position...);
    v(Field{"home_attitude", "rad", kAngle}.entrywise().of_legs(), self.home_attitude...);
    v(Field{"legs"}.of_batch(), self.legs...);
    v(Field{"cranks"}, self.cranks...);
    v(Field{"gravity", "m/s^2"}.entrywise(), self.gravity...);
    v(Field{"mass", "kg", kMass}, self.mass...);
    v(Field{"inertia", "kg m^2", kInertia}.symmetric(), self.inertia...);
    v(Field{"centre_of_mass", "m", kCoordinate}.entrywise(), self.centre_of_mass...);
    v(Field{"payload"}, self.payload...);
    v(Field{"stroke", "m", kLength}.of_legs(), self.stroke...);
    v(Field{"stroke_centre", "m", kCoordinate}.of_legs(), self.stroke_centre...);
    v(Field{"force_limit", "N", kPositive}.of_legs(), self.force_limit...);
    v(Field{"speed_limit", "m/s", kPositiveOrNone}.of_legs().of_plant(), self.speed_limit...);
    v(Field{"joint_limit", "rad", kTilt}.entrywise().of_legs().of_plant(), self.joint_limit...);
    v(Field{"on_limit"}.of_pack().of_plant().in_sampled_mode(), self.on_limit...);
    v(Field{"limits_every", "1", {.least = 1.0, .most = 1e9}}.of_pack().of_run(), self.limits_every...);
  }
};

/// Names that `robot_preset` accepts.
inline constexpr std::array<std::string_view, 2> kRobotPresets = {"micro", "cubic"};

/// `micro` (the paper's radii) or `cubic` (neighbouring legs orthogonal), docs/model.md, section 2.
/// @throws std::invalid_argument for another name
RobotParameters robot_preset(std::string_view name);

/// Cranks and rods of rotary legs, ready for their inverse kinematics.
template <class S>
struct Cranks {
  S length;                ///< r [m]
  S rod;                   ///< d [m]
  Matrix36<S> axes_B;      ///< a_i, one column per leg [1]
  Matrix36<S> home_B;      ///< direction of the crank at home [1]
  Vector6<S> branch;       ///< sigma_i
  Vector6<S> home_angles;  ///< theta_i at home, within +-pi [rad]; angles are counted within +-pi of them

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"length", "m"}, self.length...);
    v(Field{"rod", "m"}, self.rod...);
    v(Field{"axes_B", "1"}, self.axes_B...);
    v(Field{"home_B", "1"}, self.home_B...);
    v(Field{"branch", "1"}, self.branch...);
    v(Field{"home_angles", "rad"}, self.home_angles...);
  }
};

/// Leg geometry and limits, ready for the loop. Of rotary legs coordinates are angles [rad] in place of lengths [m],
/// efforts torques [N m] in place of forces [N].
template <class S>
struct Hexapod {
  Matrix36<S> platform_joints_E;  ///< p_i, one column per leg, in E [m]
  Matrix36<S> base_joints_B;      ///< b_i, one column per leg, in B [m]
  S platform_radius;              ///< r_p, the length that makes moments comparable with forces [m]
  Vector3<S> home_position;       ///< p_BE at home [m]
  Vector4<S> home_quaternion;     ///< of R_BE at home, of unit length
  Vector6<S> home_lengths;        ///< leg lengths at home [m]
  Vector6<S> mid_lengths;         ///< leg lengths in the middle of their travel [m]
  S stroke;                       ///< allowed |l - middle| [m]
  S force_limit;                  ///< allowed |leg force| [N]
  S speed_limit;                  ///< allowed |leg rate| [m/s]; infinity: any
  Vector2<S> joint_chords;        ///< allowed |c_i - c_i at home|, in B and in E [1]; infinity: any
  Matrix36<S> home_directions_B;  ///< c_i at home [1]
  Matrix36<S> home_directions_E;  ///< the same in E
  bool rotary = false;            ///< whether the legs have cranks
  Cranks<S> cranks;               ///< zeros where they have none

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"platform_joints_E", "m"}, self.platform_joints_E...);
    v(Field{"base_joints_B", "m"}, self.base_joints_B...);
    v(Field{"platform_radius", "m"}, self.platform_radius...);
    v(Field{"home_position", "m"}, self.home_position...);
    v(Field{"home_quaternion", "1"}, self.home_quaternion...);
    v(Field{"home_lengths", "m"}, self.home_lengths...);
    v(Field{"mid_lengths", "m"}, self.mid_lengths...);
    v(Field{"stroke", "m"}, self.stroke...);
    v(Field{"force_limit", "N"}, self.force_limit...);
    v(Field{"speed_limit", "m/s"}, self.speed_limit...);
    v(Field{"joint_chords", "1"}, self.joint_chords...);
    v(Field{"home_directions_B", "1"}, self.home_directions_B...);
    v(Field{"home_directions_E", "1"}, self.home_directions_E...);
    v(Field{"rotary"}, self.rotary...);
    v(Field{"cranks"}, self.cranks...);
  }
};

/// How far beyond its stroke a leg may be and still be at its end: rounding, as a share of the stroke.
inline constexpr double kStrokeTolerance = 1e-9;

/// Travel of legs from its middle [m]; of one beyond its stroke by rounding alone that is the stroke.
template <class S>
Vector6<S> leg_travel(const Vector6<S>& lengths, const Vector6<S>& middle, const S& stroke) noexcept {
  using std::abs;
  Vector6<S> travel = lengths - middle;
  for (int i = 0; i < 6; ++i) {
    const Mask<S> within = abs(travel(i)) <= S(1.0 + kStrokeTolerance) * stroke;
    travel(i) = select(within, clip(travel(i), S(-stroke), stroke), travel(i));
  }
  return travel;
}

/// Where leg travel is counted from, and where a run starts unless its scenario has another start.
template <class S>
Pose<S> home_pose(const Hexapod<S>& hexapod) {
  return {hexapod.home_position, hexapod.home_quaternion};
}

/// sigma_min/sigma_max of H at home below which joints do not hold a platform. The machines that are packaged have 0.09
/// and more; joints in reverse order, typed with four digits, have up to 5e-5.
inline constexpr double kLeastSingularRatio = 1e-4;

/// Builds the legs and checks that they can hold a platform.
///
/// r_p of joints that are given one by one is the RMS distance of the platform's from their mean.
/// @throws std::invalid_argument naming the scenario key: radii, stroke or force limit not positive, coinciding joints,
/// a leg of no length, or a geometry whose wrench map is singular at home (sigma_min/sigma_max below
/// `kLeastSingularRatio`), such as joints in another order than the legs, regular hexagons joined in cyclic order or a
/// platform similar to its base; cranks of prismatic legs; of rotary legs cranks that are not whole, do not close at
/// home or are in line with their rod there
Hexapod<double> make_hexapod(const RobotParameters& robot);

/// c of a rotary leg from c/w, whose sign is -sigma.
template <class S>
Vector3<S> rod_direction(const Vector3<S>& direction_over_arm, const S& branch) {
  using std::sqrt;
  return (-branch / sqrt(dot<S>(direction_over_arm, direction_over_arm))) * direction_over_arm;
}

/// One number for each leg, side by side.
template <class S>
using LegVector = SideBySide<S, 6>;

/// The geometry of a hexapod, ready for its inverse kinematics.
template <class S>
struct LegGeometry {
  explicit LegGeometry(const Hexapod<S>& hexapod)
      : platform_joints_E(hexapod.platform_joints_E),
        base_joints_B(hexapod.base_joints_B),
        inverse_radius(S(1.0) / hexapod.platform_radius),
        rotary(hexapod.rotary) {
    if (rotary) cranks = hexapod.cranks;
  }

  Vectors3<S, 6> platform_joints_E, base_joints_B;  ///< p_i, b_i [m]
  S inverse_radius;                                 ///< 1/r_p [1/m]
  bool rotary;                                      ///< whether the legs have cranks
  Cranks<S> cranks;                                 ///< of rotary legs; others have no use for it
};

/// The rows of H, each with one number per leg.
template <class S>
using WrenchMapRows = std::array<LegVector<S>, 6>;

/// The legs at one pose, side by side.
template <class S>
struct LegsSideBySide {
  LegVector<S> lengths;         ///< l_i [m], or theta_i [rad]
  Vectors3<S, 6> directions_B;  ///< c_i, from base to platform [1], or c_i/w_i [1/m]
  Vectors3<S, 6> arms_B;        ///< R p_i, from E's origin to the platform joints, in B [m]

  /// H (see `Legs::wrench_map`), with zeros beyond the legs.
  WrenchMapRows<S> wrench_map(const S& moment_scale) const {
    using R = typename LegVector<S>::Register;
    WrenchMapRows<S> H;
    for (std::size_t r = 0; r < LegVector<S>::registers; ++r) {
      const Vector3<R> c = directions_B.part(r), moment = cross<R>(arms_B.part(r), c);
      for (int i = 0; i < 3; ++i) {
        H[static_cast<std::size_t>(i)].part[r] = c(i);
        H[static_cast<std::size_t>(i + 3)].part[r] = moment(i) * R(moment_scale);
      }
    }
    for (LegVector<S>& row : H) row = row.padded();
    return H;
  }
};

/// In each lane one or the other.
template <int W>
LegsSideBySide<Lanes<W>> select(LaneMask<W> condition, const LegsSideBySide<Lanes<W>>& yes,
                                const LegsSideBySide<Lanes<W>>& no) {
  const auto choose = [&](const Vectors3<Lanes<W>, 6>& a, const Vectors3<Lanes<W>, 6>& b) {
    Vectors3<Lanes<W>, 6> chosen;
    chosen.x = select(condition, a.x, b.x);
    chosen.y = select(condition, a.y, b.y);
    chosen.z = select(condition, a.z, b.z);
    return chosen;
  };
  return {select(condition, yes.lengths, no.lengths), choose(yes.directions_B, no.directions_B),
          choose(yes.arms_B, no.arms_B)};
}

/// The legs at one pose.
template <class S>
struct Legs {
  Vector6<S> lengths;        ///< l_i [m], or theta_i [rad]
  Matrix36<S> directions_B;  ///< c_i, from base to platform, one column per leg [1], or c_i/w_i [1/m]
  Matrix36<S> arms_B;        ///< R p_i, from E's origin to the platform joints, in B [m]

  static Legs of(const LegsSideBySide<S>& legs) {
    return {legs.lengths.vector(), legs.directions_B.matrix(), legs.arms_B.matrix()};
  }

  LegsSideBySide<S> side_by_side() const {
    return {LegVector<S>(lengths), Vectors3<S, 6>(directions_B), Vectors3<S, 6>(arms_B)};
  }

  /// H: leg forces [N], positive where they push, to the wrench [N; N m] about E's origin, in B. H^T: twist to leg
  /// rates. Of rotary legs H W^-1, of torques [N m].
  /// @param moment_scale factor of the moments, 1; 1/r_p makes them comparable with forces
  Matrix6<S> wrench_map(const S& moment_scale = S(1.0)) const {
    const WrenchMapRows<S> rows = side_by_side().wrench_map(moment_scale);
    Matrix6<S> H;
    for (int i = 0; i < 6; ++i) H.row(i) = rows[static_cast<std::size_t>(i)].vector().transpose();
    return H;
  }

  /// H f_c of (1) without forming H.
  Vector6<S> wrench(const Vector6<S>& leg_forces) const {
    Vector6<S> tau = Vector6<S>::Zero();
    for (int i = 0; i < 6; ++i) {
      const Vector3<S> force = directions_B.col(i) * leg_forces(i), arm = arms_B.col(i);
      tau.template head<3>() += force;
      tau.template tail<3>() += arm.cross(force);
    }
    return tau;
  }

  /// l-dot = H^T chi-dot [m/s] without forming H.
  Vector6<S> rates(const Vector6<S>& twist) const {
    const Vector3<S> v = twist.template head<3>(), omega = twist.template tail<3>();
    Vector6<S> rates;
    for (int i = 0; i < 6; ++i) {
      const Vector3<S> c = directions_B.col(i), arm = arms_B.col(i);
      rates(i) = c.dot(v + omega.cross(arm));
    }
    return rates;
  }
};

/// Inverse kinematics of rotary legs, u_i = x_p + R p_i - b_i (docs/model.md, section 2):
///
///     A = 2 r u.h,  B = 2 r u.(a x h),  C = |u|^2 + r^2 - d^2,  D = sqrt(A^2 + B^2 - C^2)
///     theta = theta_home + atan2(B C + sigma A D, A C - sigma B D)
///     w = c.(a x k) = -sigma D/(2 d)
///
/// with h the crank's direction at home, k the crank and c = (u - k)/d the rod. NaN where the crank does not close.
template <class S>
[[gnu::noinline, gnu::cold]] LegsSideBySide<S> rotary_inverse_kinematics(const LegGeometry<S>& geometry,
                                                                         const Vector3<S>& p_BE,
                                                                         const Matrix3<S>& R_BE) {
  using std::atan2;
  using std::sqrt;
  const Cranks<S>& cranks = geometry.cranks;
  const Matrix36<S> joints_E = geometry.platform_joints_E.matrix(), centres_B = geometry.base_joints_B.matrix();
  Vector6<S> angles;
  Matrix36<S> directions, arms;
  for (int i = 0; i < 6; ++i) {
    const Vector3<S> arm = rotate<S>(R_BE, joints_E.col(i)), u = p_BE + arm - centres_B.col(i);
    const Vector3<S> home = cranks.home_B.col(i), across = cross<S>(cranks.axes_B.col(i), home);
    const S twice = S(2.0) * cranks.length, sign = cranks.branch(i);
    const S a = twice * dot<S>(u, home), b = twice * dot<S>(u, across);
    const S c = dot<S>(u, u) + cranks.length * cranks.length - cranks.rod * cranks.rod;
    const S reach = a * a + b * b, root = sqrt(S(reach - c * c));
    const S cosine = (a * c - sign * b * root) / reach, sine = (b * c + sign * a * root) / reach;
    const S scale = S(-2.0) * sign / root;  // of a rod as long as d: 1/(d w)
    for (int k = 0; k < 3; ++k)
      directions(k, i) = scale * (u(k) - cranks.length * (cosine * home(k) + sine * across(k)));
    angles(i) = cranks.home_angles(i) + atan2(sine, cosine);
    arms.col(i) = arm;
  }
  return {LegVector<S>(angles), Vectors3<S, 6>(directions), Vectors3<S, 6>(arms)};
}

/// Inverse kinematics: s_i = x_p + R p_i - b_i (docs/model.md, section 2).
/// @param[out] legs in place, since legs of a pack are 42 registers
template <class S>
void inverse_kinematics(const LegGeometry<S>& geometry, const Vector3<S>& p_BE, const Matrix3<S>& R_BE,
                        LegsSideBySide<S>& legs) {
  using std::sqrt;
  using R = typename LegVector<S>::Register;
  if (geometry.rotary) [[unlikely]] {
    legs = rotary_inverse_kinematics(geometry, p_BE, R_BE);
    return;
  }
  const Vector3<R> position = broadcast<R>(p_BE);
  const Matrix3<R> attitude = broadcast<R>(R_BE);
  for (std::size_t r = 0; r < LegVector<S>::registers; ++r) {
    const Vector3<R> arm = rotate<R>(attitude, geometry.platform_joints_E.part(r));
    const Vector3<R> base = geometry.base_joints_B.part(r);
    const R x = position(0) + arm(0) - base(0), y = position(1) + arm(1) - base(1), z = position(2) + arm(2) - base(2);
    const R length = sqrt(x * x + y * y + z * z), inverse_length = R(1.0) / length;
    legs.lengths.part[r] = length;
    legs.directions_B.set_part(r, Vector3<R>(x * inverse_length, y * inverse_length, z * inverse_length));
    legs.arms_B.set_part(r, arm);
  }
}
template <class S>
LegsSideBySide<S> inverse_kinematics(const LegGeometry<S>& geometry, const Vector3<S>& p_BE, const Matrix3<S>& R_BE) {
  LegsSideBySide<S> legs;
  inverse_kinematics(geometry, p_BE, R_BE, legs);
  return legs;
}
template <class S>
Legs<S> inverse_kinematics(const Hexapod<S>& hexapod, const Vector3<S>& p_BE, const Matrix3<S>& R_BE) {
  return Legs<S>::of(inverse_kinematics(LegGeometry<S>(hexapod), p_BE, R_BE));
}

/// Solves with H whose moments are divided by r_p, so that a metre and a radian weigh alike, by way of H H^T.
template <class S>
class WrenchMapSolver {
 public:
  WrenchMapSolver(const LegGeometry<S>& geometry, const LegsSideBySide<S>& legs)
      : inverse_radius_(geometry.inverse_radius), H_(legs.wrench_map(inverse_radius_)), gram_(gram(H_)) {}
  WrenchMapSolver(const Hexapod<S>& hexapod, const Legs<S>& legs)
      : WrenchMapSolver(LegGeometry<S>(hexapod), legs.side_by_side()) {}

  /// Where the pose is singular (sigma_min/sigma_max of H near 1e-7 or below).
  Mask<S> failed() const { return gram_.failed(); }

  /// f_c with H f_c = tau [N], tau in B.
  Vector6<S> leg_forces(Vector6<S> wrench) const {
    for (int i = 3; i < 6; ++i) wrench(i) *= inverse_radius_;
    const Vector6<S> weights = gram_.solve(wrench);
    LegVector<S> forces = weights(0) * H_[0];
    for (int i = 1; i < 6; ++i) forces += weights(i) * H_[static_cast<std::size_t>(i)];
    return forces.vector();
  }

  /// chi-dot (m/s; rad/s, in B) with H^T chi-dot = leg rates [m/s].
  Vector6<S> twist(const Vector6<S>& leg_rates) const { return displacement(LegVector<S>(leg_rates)); }

  /// Small displacement (m; rad, in B) with H^T d = leg length changes [m].
  Vector6<S> displacement(const LegVector<S>& changes) const {
    Vector6<S> b;
    for (std::size_t i = 0; i < 6; i += 2) {
      const auto [first, second] = dots(H_[i], changes, H_[i + 1], changes);
      b(static_cast<int>(i)) = first;
      b(static_cast<int>(i) + 1) = second;
    }
    Vector6<S> d = gram_.solve(b);
    for (int i = 3; i < 6; ++i) d(i) *= inverse_radius_;
    return d;
  }

 private:
  /// Lower triangle of H H^T; the solver reads no more.
  static Matrix6<S> gram(const WrenchMapRows<S>& H) {
    return lower_lane_sums<S>(
        [&H](int i, int j) { return (H[static_cast<std::size_t>(i)] * H[static_cast<std::size_t>(j)]).lane_total(); });
  }

  S inverse_radius_;
  WrenchMapRows<S> H_;
  Cholesky<S, 6> gram_;
};

/// The solver as the matrix of Newton's method: one piece of code, so that a lane has the same bits where its
/// neighbours have the matrix of another round.
template <class S>
class NewtonMatrix : public WrenchMapSolver<S> {
 public:
  [[gnu::noinline]] NewtonMatrix(const LegGeometry<S>& geometry, const LegsSideBySide<S>& legs)
      : WrenchMapSolver<S>(geometry, legs) {}

  [[gnu::noinline]] Vector6<S> step(const LegVector<S>& left) const { return this->displacement(left); }
};

/// Legs at a pose of a unit quaternion: one piece of code too, for who keeps them and who computes them again.
template <class S>
[[gnu::noinline]] void place_legs(const LegGeometry<S>& geometry, const Pose<S>& pose, LegsSideBySide<S>& legs) {
  inverse_kinematics(geometry, pose.position, rotation_matrix(pose.quaternion), legs);
}

/// Legs at a pose, and the solver there.
template <class S>
struct SolvedLegs {
  SolvedLegs(const LegGeometry<S>& geometry, const LegsSideBySide<S>& there) : legs(there), solver(geometry, legs) {}
  SolvedLegs(const LegGeometry<S>& geometry, const Pose<S>& pose)
      : legs(placed(geometry, pose)), solver(geometry, legs) {}
  LegsSideBySide<S> legs;
  NewtonMatrix<S> solver;

 private:
  static LegsSideBySide<S> placed(const LegGeometry<S>& geometry, const Pose<S>& pose) {
    LegsSideBySide<S> legs;
    place_legs(geometry, pose, legs);
    return legs;
  }
};

/// How forward kinematics ended.
enum class KinematicsStatus { converged, not_converged, singular };

/// Pose found from leg lengths, with what is left.
template <class S>
struct ForwardKinematics {
  Pose<S> pose;                        ///< platform pose in B, unit quaternion
  LegsSideBySide<S> legs;              ///< there
  S residual{0.0};                     ///< max |l(pose) - l| [m]
  Mask<S> converged = Mask<S>(false);  ///< residual within `kKinematicsTolerance`
  Mask<S> singular = Mask<S>(false);   ///< a Newton matrix was singular on the way; the pose is the last one before it
};

inline constexpr double kKinematicsTolerance = 1e-12;  ///< residual of a converged forward kinematics [m]
inline constexpr int kKinematicsRounds = 30;           ///< Newton rounds from anywhere

/// What of a Newton step rotary legs follow: it is halved until the cranks close and their angles come nearer.
template <class S>
[[gnu::noinline, gnu::cold]] S followed_share(const LegGeometry<S>& geometry, const Pose<S>& pose, const Vector6<S>& d,
                                              const Vector6<S>& angles) {
  constexpr int kHalvings = 10;
  const auto distance = [&](const S& share) {
    const Pose<S> next = stepped(pose, Vector6<S>(share * d));
    const LegsSideBySide<S> legs = inverse_kinematics(geometry, next.position, rotation_matrix(next.quaternion));
    return S((legs.lengths.vector() - angles).squaredNorm());
  };
  const S before = distance(S(0.0));
  S share(1.0);
  for (int i = 0; i < kHalvings; ++i) share = select(distance(share) <= before, share, S(S(0.5) * share));
  return share;
}

inline constexpr double kLargestTurn = 0.5;  ///< of a Newton step [rad]
/// Size of a Newton step, over r_p or 0.5 rad, whose square is below rounding: the last one.
inline constexpr double kLastNewtonStep = 1e-8;
/// Size of one whose third power is: with what the lengths are curved along it, the last one too.
inline constexpr double kSmallNewtonStep = 1e-5;
/// Size of one whose fourth power is.
inline constexpr double kCloseBy = 1e-4;
inline constexpr double kRoundingOfLengths = 0.01 * kKinematicsTolerance;  ///< residual of a last step [m]

/// What of the lengths of prismatic legs is of second order in a displacement (m; rad, in B) [m].
///
/// With m = v + w x a the way of a joint, l + c.m + (|m|^2 - (c.m)^2)/(2 l) + c.(w x (w x a))/2 is the length. Places
/// beyond the legs are zero: their l is |p_BE|, which may be 0.
template <class S>
LegVector<S> curvature(const LegsSideBySide<S>& legs, const Vector6<S>& d) {
  using R = typename LegVector<S>::Register;
  const Vector3<R> shift = broadcast<R>(Vector3<S>(d.template head<3>()));
  const Vector3<R> turn = broadcast<R>(Vector3<S>(d.template tail<3>()));
  LegVector<S> change;
  for (std::size_t r = 0; r < LegVector<S>::registers; ++r) {
    const Vector3<R> c = legs.directions_B.part(r), across = cross<R>(turn, legs.arms_B.part(r)), way = shift + across;
    const R along = dot<R>(c, way);
    change.part[r] =
        R(0.5) * ((dot<R>(way, way) - along * along) / legs.lengths.part[r] + dot<R>(c, cross<R>(turn, across)));
  }
  return change.padded();
}

/// Square of the size of a Newton step, over r_p or 0.5 rad.
template <class S>
S squared_step_size(const LegGeometry<S>& geometry, const Vector6<S>& d) {
  return max(S(d.template head<3>().squaredNorm() * (geometry.inverse_radius * geometry.inverse_radius)),
             S(d.template tail<3>().squaredNorm() * S(1.0 / (kLargestTurn * kLargestTurn))));
}

/// Newton's step d on, by what the lengths of prismatic legs are curved along it (Chebyshev's method).
template <class S>
[[gnu::noinline]] Vector6<S> curved_step(const NewtonMatrix<S>& matrix, const LegsSideBySide<S>& legs,
                                         const Vector6<S>& d) {
  return d - matrix.step(curvature(legs, d));
}

/// Goes to a pose, and measures there.
template <class S>
void go_to(const LegGeometry<S>& geometry, const LegVector<S>& goal, const Pose<S>& pose,
           ForwardKinematics<S>& result) {
  result.pose = pose;
  place_legs(geometry, pose, result.legs);
  result.residual = largest_abs((goal - result.legs.lengths).vector());
}

/// Newton's method on l(pose) = lengths; steps are limited to r_p and 0.5 rad.
///
/// Each lane ends at its last step, whatever its neighbours do: one whose square is below rounding, or of prismatic
/// legs, which follow the curvature too, one whose third power is; as long as the lengths are met. Cranks close to a
/// dead point need more.
/// @param rounds Newton rounds >= 0 at most, of which a fraction counts as one
/// @param result pose of a unit quaternion to start from, with legs and residual there
template <class S>
void solve_pose(const LegGeometry<S>& geometry, const Vector6<S>& lengths, const S& rounds,
                ForwardKinematics<S>& result) {
  using std::sqrt;
  const LegVector<S> goal(lengths);
  result.singular = Mask<S>(false);
  Mask<S> moves(true);  // which lanes go on
  for (int round = 0;; ++round) {
    moves = moves & (S(static_cast<double>(round)) < rounds);
    if (!any(moves)) break;
    const NewtonMatrix<S> matrix(geometry, result.legs);
    Vector6<S> d = matrix.step(goal - result.legs.lengths);
    result.singular = result.singular | (moves & matrix.failed());
    moves = moves & !result.singular;
    const S squared_size = squared_step_size(geometry, d);
    const Mask<S> too_large = squared_size > S(1.0);
    if (any(too_large)) [[unlikely]]
      d *= select(too_large, S(S(1.0) / sqrt(squared_size)), S(1.0));
    Mask<S> last = squared_size <= S(kLastNewtonStep * kLastNewtonStep);
    if (geometry.rotary) [[unlikely]] {
      d *= followed_share(geometry, result.pose, d, lengths);
    } else {
      const Mask<S> small = squared_size <= S(kSmallNewtonStep * kSmallNewtonStep);
      if (any(moves & small & !last)) d = select(small & !last, curved_step(matrix, result.legs, d), d);
      last = small;
    }
    go_to(geometry, goal, select_pose(moves, stepped(result.pose, d), result.pose), result);
    moves = moves & !(last & (result.residual <= S(kRoundingOfLengths)));
  }
  result.converged = (result.residual <= S(kKinematicsTolerance)) & !result.singular;
}

/// Forward kinematics of prismatic legs close to a pose whose solver is known, which serves all steps.
///
/// Two steps at most: Newton's with what the lengths are curved along it, and where that does not do, another one,
/// whose error is the fourth power of the first one's size.
/// @param[out] result where it is found
/// @return which lanes are found, whatever their neighbours are
template <class S>
Mask<S> pose_close_by(const LegGeometry<S>& geometry, const Vector6<S>& lengths, const Pose<S>& start,
                      const SolvedLegs<S>& there, ForwardKinematics<S>& result) {
  if (geometry.rotary) return Mask<S>(false);
  const LegVector<S> goal(lengths);
  const Vector6<S> d = there.solver.step(goal - there.legs.lengths);
  const Mask<S> close = (squared_step_size(geometry, d) <= S(kCloseBy * kCloseBy)) & !there.solver.failed();
  if (!any(close)) return close;
  go_to(geometry, goal, stepped(start, curved_step(there.solver, there.legs, d)), result);
  const Mask<S> done = result.residual <= S(kRoundingOfLengths);
  if (any(close & !done)) {
    const Vector6<S> rest = there.solver.step(goal - result.legs.lengths);
    go_to(geometry, goal, select_pose(done, result.pose, stepped(result.pose, rest)), result);
  }
  const Mask<S> found = close & (result.residual <= S(kRoundingOfLengths));
  result.converged = found;
  result.singular = Mask<S>(false);
  return found;
}

/// Forward kinematics by Newton's method from a start pose.
///
/// A hexapod has up to 40 poses for the same lengths; Newton finds one near `start`. The number of rounds bounds the
/// time.
/// @param rounds Newton rounds >= 0, at most; four find a pose within 0.1 r_p and 0.1 rad, as of one sample ago
template <class S>
ForwardKinematics<S> forward_kinematics(const LegGeometry<S>& geometry, const Vector6<S>& lengths, const Pose<S>& start,
                                        int rounds = kKinematicsRounds) {
  ForwardKinematics<S> from;
  go_to(geometry, LegVector<S>(lengths), unit_pose(start), from);
  solve_pose(geometry, lengths, S(static_cast<double>(rounds)), from);
  return from;
}
template <class S>
ForwardKinematics<S> forward_kinematics(const Hexapod<S>& hexapod, const Vector6<S>& lengths, const Pose<S>& start) {
  return forward_kinematics(LegGeometry<S>(hexapod), lengths, start);
}

/// Status of the forward kinematics of one robot.
inline KinematicsStatus status(const ForwardKinematics<double>& result) {
  if (result.converged) return KinematicsStatus::converged;
  return result.singular ? KinematicsStatus::singular : KinematicsStatus::not_converged;
}

/// Singular values of H with the moments divided by r_p, largest first [1]; the last is the distance to singularity.
/// Of rotary legs H is that of the rods; a crank in line with its rod is another singularity, see `lever_arms`.
Vector6<double> wrench_map_singular_values(const Hexapod<double>& hexapod, const Pose<double>& pose);

/// w_i [m] of rotary legs: their torque over the force of the rod, 0 where crank and rod are in line; of others 1.
/// NaN where a crank does not close.
Vector6<double> lever_arms(const Hexapod<double>& hexapod, const Pose<double>& pose);

/// Where the rods of rotary legs begin, b_i + k_i, one column per leg, in B [m]; of prismatic legs the base joints.
Matrix36<double> leg_feet(const Hexapod<double>& hexapod, const Pose<double>& pose);

}  // namespace hexservo
