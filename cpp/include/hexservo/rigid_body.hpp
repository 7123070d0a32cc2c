/// @file
/// Platform dynamics (1), its Property 1 (2), and the actual dynamics with relative errors (3).
///
/// | paper          | here                     |                                                            |
/// | -------------- | ------------------------ | ---------------------------------------------------------- |
/// | m, I           | mass, inertia_E          | estimated mass, inertia about E's origin in E              |
/// | I' = R I R^T   | inertia_in_base          | the same in B                                              |
/// | D, C, G (bars) | mass_matrix, ...         | D chi-ddot + C chi-dot + G = tau, 6x6, 6x6, 6              |
/// | D_e, C_e, G_e  | DynamicsError            | delta_D D etc. with delta element-wise (docs/model.md, 3)  |
#pragma once

#include "hexservo/cholesky.hpp"
#include "hexservo/side_by_side.hpp"

#include <cmath>

namespace hexservo {

/// Mass properties of the platform with its camera, as the controller assumes them.
template <class S>
struct RigidBody {
  S mass{0.06};                                                            ///< platform mass [kg], 0.06 (paper)
  Matrix3<S> inertia_E = Vector3<S>(1.5e-4, 1.5e-4, 3.0e-4).asDiagonal();  ///< inertia about E's origin, in E [kg m^2]
  Vector3<S> gravity = Vector3<S>(S(0.0), S(0.0), S(9.8));  ///< acceleration g in B [m/s^2], 9.8 along +z (paper)
  Vector3<S> centre_E = Vector3<S>::Zero();                 ///< centre of mass in E [m], 0 (paper)
  bool off_centre = false;  ///< the centre of mass may be elsewhere than in E's origin; otherwise it is not looked at

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"mass", "kg"}, self.mass...);
    v(Field{"inertia_E", "kg m^2"}, self.inertia_E...);
    v(Field{"gravity", "m/s^2"}, self.gravity...);
    v(Field{"centre_E", "m"}, self.centre_E...);
    v(Field{"off_centre"}, self.off_centre...);
  }
};

/// One rigid body of two that are fixed to each other, with the gravity of the first.
RigidBody<double> joined(const RigidBody<double>& a, const RigidBody<double>& b);

/// What a mass at a place c in E adds to an inertia about E's origin, m (|c|^2 1 - c c^T) [kg m^2].
Matrix3<double> displaced_inertia(double mass, const Vector3<double>& centre);

/// Relative errors of the estimated dynamics: the actual matrices are (1 - delta) times the estimated ones, entry by
/// entry.
template <class S>
struct DynamicsError {
  Matrix6<S> inertia = Matrix6<S>::Zero();   ///< delta_D [1], 0; symmetric, leaves a positive inertia
  Matrix6<S> coriolis = Matrix6<S>::Zero();  ///< delta_C [1], 0
  Vector6<S> gravity = Vector6<S>::Zero();   ///< delta_G [1], 0

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"inertia", "1", kRelativeError}.of_plant(), self.inertia...);
    v(Field{"coriolis", "1", kRelativeError}.of_plant(), self.coriolis...);
    v(Field{"gravity", "1", kRelativeError}.of_plant(), self.gravity...);
  }
};

/// Position and attitude of the platform frame E in B.
template <class S>
struct Pose {
  Vector3<S> position = Vector3<S>::Zero();                            ///< p_BE [m]
  Vector4<S> quaternion = Vector4<S>(S(1.0), S(0.0), S(0.0), S(0.0));  ///< (w, x, y, z); need not be of unit length

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"position", "m"}, self.position...);
    v(Field{"quaternion", "1"}, self.quaternion...);
  }
};

/// R_BE of q/|q| (docs/model.md, section 1): no square root is needed.
template <class S>
[[gnu::always_inline]] inline Matrix3<S> rotation_matrix(const Vector4<S>& q) {
  const S w = q(0), x = q(1), y = q(2), z = q(3);
  const S s = S(2.0) / ((w * w + x * x) + (y * y + z * z));
  Matrix3<S> R_BE;
  R_BE(0, 0) = S(1.0) - s * (y * y + z * z);
  R_BE(0, 1) = s * (x * y - w * z);
  R_BE(0, 2) = s * (x * z + w * y);
  R_BE(1, 0) = s * (x * y + w * z);
  R_BE(1, 1) = S(1.0) - s * (x * x + z * z);
  R_BE(1, 2) = s * (y * z - w * x);
  R_BE(2, 0) = s * (x * z - w * y);
  R_BE(2, 1) = s * (y * z + w * x);
  R_BE(2, 2) = S(1.0) - s * (x * x + y * y);
  return R_BE;
}

/// Rotation vector of q: axis times angle [rad], at most pi long, for a quaternion of any length.
template <class S>
Vector3<S> rotation_vector(const Vector4<S>& q) {
  using std::abs;
  using std::atan;
  using std::sqrt;
  const Vector3<S> v = q.template tail<3>();
  const S cosine = abs(q(0)), squared_sine = v.squaredNorm();  // of half the angle, times |q|
  const S sine = sqrt(squared_sine);
  // 2 atan(x)/x is 2 to rounding for small x, where its quotient would be 0/0.
  const S scale =
      select(squared_sine > S(1e-16) * cosine * cosine, S(S(2.0) * atan(S(sine / cosine)) / sine), S(S(2.0) / cosine));
  return select(q(0) < S(0.0), S(-scale), scale) * v;
}

/// How to get from one pose to another: difference of the positions, then the rotation vector of R_to R_from^T, both in
/// B [m; rad].
template <class S>
Vector6<S> pose_difference(const Pose<S>& to, const Pose<S>& from) {
  const Vector3<S> v = from.quaternion.template tail<3>(), v_to = to.quaternion.template tail<3>();
  Vector4<S> turn;  // q_to (x) conj(q_from)
  turn(0) = to.quaternion.dot(from.quaternion);
  turn.template tail<3>() = from.quaternion(0) * v_to - to.quaternion(0) * v + v.cross(v_to);
  Vector6<S> difference;
  difference.template head<3>() = to.position - from.position;
  difference.template tail<3>() = rotation_vector(turn);
  return difference;
}

/// The pose after a finite displacement (m; rad): the position moves by its first three numbers, and the attitude turns
/// by the rotation vector of the others, R <- exp([r]x) R, both in B. Inverse of `pose_difference`.
inline Pose<double> moved(const Pose<double>& pose, const Vector6<double>& displacement) {
  const Vector3<double> r = displacement.tail<3>();
  const double angle = r.norm(), half = 0.5 * angle;
  // sin(x)/x is 1 to rounding for small x, where its quotient would be 0/0.
  const Vector3<double> v = (angle > 1e-8 ? std::sin(half) / angle : 0.5) * r;
  const double w = std::cos(half);
  const Vector4<double>& q = pose.quaternion;
  const Vector3<double> u = q.tail<3>();
  Pose<double> next;
  next.position = pose.position + displacement.head<3>();
  next.quaternion(0) = w * q(0) - v.dot(u);
  next.quaternion.tail<3>() = w * u + q(0) * v + v.cross(u);
  return next;
}

/// q-dot = 1/2 (0, omega) (x) q with omega in B [rad/s] and q as it stands (docs/model.md, section 1).
template <class S>
[[gnu::always_inline]] inline Vector4<S> quaternion_rate(const Vector4<S>& q, const Vector3<S>& omega_B) {
  const Vector3<S> v(q(1), q(2), q(3)), half(S(0.5) * omega_B(0), S(0.5) * omega_B(1), S(0.5) * omega_B(2));
  const Vector3<S> turn = cross<S>(half, v);
  return Vector4<S>(-dot<S>(half, v), q(0) * half(0) + turn(0), q(0) * half(1) + turn(1), q(0) * half(2) + turn(2));
}

/// One of two poses in each lane.
template <class S>
Pose<S> select_pose(const Mask<S>& where, const Pose<S>& yes, const Pose<S>& no) {
  return {select(where, yes.position, no.position), select(where, yes.quaternion, no.quaternion)};
}

/// The same pose with a quaternion of unit length.
template <class S>
Pose<S> unit_pose(const Pose<S>& pose) noexcept {
  using std::sqrt;
  return {pose.position, Vector4<S>(pose.quaternion * S(S(1.0) / sqrt(S(pose.quaternion.squaredNorm()))))};
}

/// A pose after a small displacement (m; rad, in B): q <- normalised (1, d_theta/2) (x) q, to second order.
template <class S>
Pose<S> stepped(const Pose<S>& pose, const Vector6<S>& d) noexcept {
  return unit_pose<S>({pose.position + d.template head<3>(),
                       pose.quaternion + quaternion_rate<S>(pose.quaternion, d.template tail<3>())});
}

/// A pose after a period at a twist, to fourth order in the angle.
template <class S>
Pose<S> carried(const Pose<S>& pose, const Vector6<S>& twist, const S& period) {
  Vector6<S> way = period * twist;
  const Vector3<S> turn = way.template tail<3>();
  const S tangent = S(1.0) + S(1.0 / 12.0) * turn.squaredNorm();  // of half the angle, over it
  for (int i = 3; i < 6; ++i) way(i) *= tangent;
  return stepped(pose, way);
}

/// State of a body for the integrator: p_BE (3), quaternion (4), twist (6).
template <class S>
using BodyState = Vector<S, 13>;

template <class S>
BodyState<S> body_state(const Pose<S>& pose, const Vector6<S>& twist) {
  BodyState<S> state;
  state << pose.position, pose.quaternion, twist;
  return state;
}
template <class S>
Vector3<S> position_of(const BodyState<S>& state) {
  return state.template head<3>();
}
template <class S>
Vector4<S> quaternion_of(const BodyState<S>& state) {
  return state.template segment<4>(3);
}
template <class S>
Vector6<S> twist_of(const BodyState<S>& state) {
  return state.template tail<6>();
}

/// The same state, or its rate, in registers: what a loop adds up at every stage.
template <class S>
struct BodyMotion {
  SideBySide<S, 3> position;
  SideBySide<S, 4> quaternion;
  SideBySide<S, 6> twist;

  static BodyMotion of(const BodyState<S>& state) {
    return {SideBySide<S, 3>(Vector3<S>(position_of(state))), SideBySide<S, 4>(Vector4<S>(quaternion_of(state))),
            SideBySide<S, 6>(Vector6<S>(twist_of(state)))};
  }
  static BodyMotion at_rest(const Pose<S>& pose) { return of(body_state<S>(pose, Vector6<S>::Zero())); }
  BodyState<S> state() const { return body_state<S>({position.vector(), quaternion.vector()}, twist.vector()); }

  friend BodyMotion operator+(const BodyMotion& a, const BodyMotion& b) {
    return {a.position + b.position, a.quaternion + b.quaternion, a.twist + b.twist};
  }
  friend BodyMotion operator*(const S& a, const BodyMotion& b) {
    return {a * b.position, a * b.quaternion, a * b.twist};
  }
};
template <class S>
Vector3<S> position_of(const BodyMotion<S>& motion) {
  return Vector3<S>(motion.position(0), motion.position(1), motion.position(2));
}
template <class S>
Vector4<S> quaternion_of(const BodyMotion<S>& motion) {
  return motion.quaternion.vector();
}
template <class S>
Vector6<S> twist_of(const BodyMotion<S>& motion) {
  return motion.twist.vector();
}
template <class S>
Mask<S> is_finite(const BodyMotion<S>& motion) {
  return is_finite(motion.position) & is_finite(motion.quaternion) & is_finite(motion.twist);
}
template <int W>
BodyMotion<Lanes<W>> select(LaneMask<W> condition, const BodyMotion<Lanes<W>>& yes, const BodyMotion<Lanes<W>>& no) {
  return {select(condition, yes.position, no.position), select(condition, yes.quaternion, no.quaternion),
          select(condition, yes.twist, no.twist)};
}

/// Scales the quaternion to unit length, once per step and never inside its stages (docs/model.md, section 1).
template <class S>
void normalise_quaternion(BodyMotion<S>& motion) {
  using std::sqrt;
  const SideBySide<S, 4>& q = motion.quaternion;
  const S squared_length = dots(q, q, q, q)[0];
  motion.quaternion = S(S(1.0) / sqrt(squared_length)) * q;
}

/// I' = R I R^T, the inertia in B [kg m^2].
template <class S>
[[gnu::always_inline]] inline Matrix3<S> inertia_in_base(const RigidBody<S>& body, const Matrix3<S>& R_BE) {
  const Matrix3<S>&R = R_BE, &I = body.inertia_E;
  Matrix3<S> RI, I_B;
#pragma GCC unroll 3
  for (int j = 0; j < 3; ++j)
#pragma GCC unroll 3
    for (int i = 0; i < 3; ++i) RI(i, j) = R(i, 0) * I(0, j) + R(i, 1) * I(1, j) + R(i, 2) * I(2, j);
#pragma GCC unroll 3
  for (int j = 0; j < 3; ++j)
#pragma GCC unroll 3
    for (int i = 0; i <= j; ++i) {
      I_B(i, j) = RI(i, 0) * R(j, 0) + RI(i, 1) * R(j, 1) + RI(i, 2) * R(j, 2);
      I_B(j, i) = I_B(i, j);
    }
  return I_B;
}

/// D of (1), 6x6: maps acceleration (m/s^2; rad/s^2, in B) to wrench.
template <class S>
Matrix6<S> mass_matrix(const RigidBody<S>& body, const Matrix3<S>& R_BE) {
  Matrix6<S> D = Matrix6<S>::Zero();
  D.diagonal().template head<3>().setConstant(body.mass);
  D.template bottomRightCorner<3, 3>() = inertia_in_base(body, R_BE);
  if (body.off_centre) {
    const Matrix3<S> first_moment = body.mass * skew(rotate<S>(R_BE, body.centre_E));  // m [c]x
    D.template bottomLeftCorner<3, 3>() = first_moment;
    D.template topRightCorner<3, 3>() = -first_moment;
  }
  return D;
}

/// D a of (1) [N; N m].
/// @param acceleration a, in B [m/s^2; rad/s^2]
template <class S>
Vector6<S> inertial_wrench(const RigidBody<S>& body, const Matrix3<S>& R_BE, const Vector6<S>& acceleration) {
  const Matrix6<S> D = mass_matrix(body, R_BE);
  Vector6<S> wrench = Vector6<S>::Zero();
  for (int j = 0; j < 6; ++j)
    for (int i = 0; i < 6; ++i) wrench(i) += D(i, j) * acceleration(j);
  return wrench;
}

/// C of (1), 6x6: maps twist to the gyroscopic wrench, [omega]x I' in the lower right block. Off centre it has
/// -m [omega]x [c]x, m [omega]x [c]x, and m [c x v]x beside I', so that Property 1 holds for every vector.
template <class S>
Matrix6<S> coriolis_matrix(const RigidBody<S>& body, const Matrix3<S>& R_BE, const Vector6<S>& twist) {
  const Vector3<S> v = twist.template head<3>(), omega_B = twist.template tail<3>();
  Matrix6<S> C = Matrix6<S>::Zero();
  C.template bottomRightCorner<3, 3>() = skew(omega_B) * inertia_in_base(body, R_BE);
  if (body.off_centre) {
    const Vector3<S> c = rotate<S>(R_BE, body.centre_E);
    const Matrix3<S> turning = body.mass * (skew(omega_B) * skew(c));
    C.template topRightCorner<3, 3>() = -turning;
    C.template bottomLeftCorner<3, 3>() = turning;
    C.template bottomRightCorner<3, 3>() += body.mass * skew(cross<S>(c, v));
  }
  return C;
}

/// G of (1): the wrench that holds the platform at rest, (-m g; 0) [N; N m]; m (0, 0, -g, 0, 0, 0) where z points down.
template <class S>
Vector6<S> gravity_wrench(const RigidBody<S>& body) {
  Vector6<S> G = Vector6<S>::Zero();
  for (int i = 0; i < 3; ++i) G(i) = S(0.0) - body.mass * body.gravity(i);  // 0, not -0, where there is none
  return G;
}
/// The same at an attitude: (-m g; -c x m g), where the centre of mass may be off E's origin.
template <class S>
Vector6<S> gravity_wrench(const RigidBody<S>& body, const Matrix3<S>& R_BE) {
  Vector6<S> G = gravity_wrench(body);
  if (body.off_centre)
    G.template tail<3>() = cross<S>(rotate<S>(R_BE, body.centre_E), Vector3<S>(G.template head<3>()));
  return G;
}

/// Solves A x = b for a regular 3x3 matrix by Cramer's rule.
template <class S>
[[gnu::always_inline]] inline Vector3<S> solve3(const Matrix3<S>& A, const Vector3<S>& b) {
  const Vector3<S> a0(A(0, 0), A(1, 0), A(2, 0)), a1(A(0, 1), A(1, 1), A(2, 1)), a2(A(0, 2), A(1, 2), A(2, 2));
  const Vector3<S> a1xa2 = cross<S>(a1, a2), a2xa0 = cross<S>(a2, a0), a0xa1 = cross<S>(a0, a1);
  const S inverse_det = S(1.0) / dot<S>(a0, a1xa2);
  return Vector3<S>(dot<S>(b, a1xa2) * inverse_det, dot<S>(b, a2xa0) * inverse_det, dot<S>(b, a0xa1) * inverse_det);
}

/// The actual platform (3), with what does not change in a run worked out.
template <class S>
struct Plant {
  /// @param nominal of which the error is relative
  Plant(const RigidBody<S>& nominal, const DynamicsError<S>& error) : body(nominal), dynamics_error(error) {
    const Vector6<S> G = gravity_wrench(nominal);
    for (int i = 0; i < 3; ++i) {
      inverse_mass(i) = S(1.0) / (body.mass - error.inertia(i, i) * body.mass);
      for (int j = 0; j < 3; ++j) {
        inertia_share(i, j) = S(1.0) - error.inertia(i + 3, j + 3);
        coriolis_share(i, j) = S(1.0) - error.coriolis(i + 3, j + 3);
      }
    }
    weight = G - error.gravity.cwiseProduct(G);
  }

  /// (1 - delta_D) o D at an attitude, 6x6.
  Matrix6<S> mass_matrix_at(const Matrix3<S>& R_BE) const {
    return (Matrix6<S>::Ones() - dynamics_error.inertia).cwiseProduct(mass_matrix(body, R_BE));
  }
  /// (1 - delta_C) o C at an attitude and a twist, 6x6.
  Matrix6<S> coriolis_matrix_at(const Matrix3<S>& R_BE, const Vector6<S>& twist) const {
    return (Matrix6<S>::Ones() - dynamics_error.coriolis).cwiseProduct(coriolis_matrix(body, R_BE, twist));
  }
  /// (1 - delta_G) o G at an attitude [N; N m].
  Vector6<S> weight_at(const Matrix3<S>& R_BE) const {
    if (!body.off_centre) return weight;
    const Vector6<S> G = gravity_wrench(body, R_BE);
    return G - dynamics_error.gravity.cwiseProduct(G);
  }

  RigidBody<S> body;                ///< without the errors
  DynamicsError<S> dynamics_error;  ///< looked at off centre alone: what follows has the rest
  Vector3<S> inverse_mass;          ///< of the three linear directions [1/kg]
  Matrix3<S> inertia_share;         ///< 1 - delta_D of the angular block, D being block-diagonal [1]
  Matrix3<S> coriolis_share;        ///< 1 - delta_C of the angular block, the only one of C that is not zero [1]
  Vector6<S> weight;                ///< (1 - delta_G) G [N; N m]
};

/// chi-ddot of a body whose centre of mass is off E's origin: all entries of D and C act.
template <class S>
[[gnu::noinline, gnu::cold]] SideBySide<S, 6> acceleration_off_centre(const Plant<S>& plant, const Matrix3<S>& R_BE,
                                                                      const Vector6<S>& twist,
                                                                      const Vector6<S>& wrench) {
  const Matrix6<S> C = plant.coriolis_matrix_at(R_BE, twist);
  Vector6<S> rest = wrench - plant.weight_at(R_BE);
  for (int j = 0; j < 6; ++j)
    for (int i = 0; i < 6; ++i) rest(i) -= C(i, j) * twist(j);
  return SideBySide<S, 6>(Cholesky<S, 6>(plant.mass_matrix_at(R_BE)).solve(rest));
}

/// chi-ddot of the actual dynamics (3): (1 - delta_D) D chi-ddot + (1 - delta_C) C chi-dot + (1 - delta_G) G = tau.
/// @return (m/s^2; rad/s^2), in B
template <class S>
[[gnu::always_inline]] inline SideBySide<S, 6> acceleration(const Plant<S>& plant, const Matrix3<S>& R_BE,
                                                            const std::type_identity_t<SideBySide<S, 6>>& twist,
                                                            const Vector6<S>& wrench) {
  if (plant.body.off_centre) [[unlikely]] {
    const Matrix3<S> attitude = R_BE;  // copies, so that those of the other way stay in registers
    const Vector6<S> motion = twist.vector(), force = wrench;
    return acceleration_off_centre<S>(plant, attitude, motion, force);
  }
  const Vector3<S> omega(twist(3), twist(4), twist(5));
  const Matrix3<S> I_B = inertia_in_base(plant.body, R_BE);

  // (1 - delta_C) o ([omega]x I') omega, column by column, taken from the moment
  Matrix3<S> actual_inertia;
  Vector3<S> rest(-plant.weight(3), -plant.weight(4), -plant.weight(5));
#pragma GCC unroll 3
  for (int j = 0; j < 3; ++j) {
    const Vector3<S> inertia(I_B(0, j), I_B(1, j), I_B(2, j));
    const Vector3<S> coriolis = cross<S>(omega, inertia);
#pragma GCC unroll 3
    for (int i = 0; i < 3; ++i) {
      actual_inertia(i, j) = plant.inertia_share(i, j) * inertia(i);
      rest(i) -= plant.coriolis_share(i, j) * coriolis(i) * omega(j);
    }
  }
  const Vector3<S> moment(wrench(3) + rest(0), wrench(4) + rest(1), wrench(5) + rest(2));
  const Vector3<S> angular = solve3<S>(actual_inertia, moment);
  return SideBySide<S, 6>::of(
      (wrench(0) - plant.weight(0)) * plant.inverse_mass(0), (wrench(1) - plant.weight(1)) * plant.inverse_mass(1),
      (wrench(2) - plant.weight(2)) * plant.inverse_mass(2), angular(0), angular(1), angular(2));
}

/// Time derivative of the platform's state under a wrench in B [N; N m].
template <class S>
BodyMotion<S> body_rate(const Plant<S>& plant, const BodyMotion<S>& motion, const Matrix3<S>& R_BE,
                        const Vector6<S>& wrench) {
  const SideBySide<S, 6>& twist = motion.twist;
  const SideBySide<S, 4>& q = motion.quaternion;
  const Vector4<S> turning =
      quaternion_rate<S>(Vector4<S>(q(0), q(1), q(2), q(3)), Vector3<S>(twist(3), twist(4), twist(5)));
  return {SideBySide<S, 3>::of(twist(0), twist(1), twist(2)),
          SideBySide<S, 4>::of(turning(0), turning(1), turning(2), turning(3)),
          acceleration(plant, R_BE, twist, wrench)};
}

/// Kinetic energy 1/2 chi-dot^T D chi-dot [J].
template <class S>
S kinetic_energy(const RigidBody<S>& body, const Matrix3<S>& R_BE, const Vector6<S>& twist) {
  return S(0.5) * twist.dot(mass_matrix(body, R_BE) * twist);
}

/// Potential energy -m g . (p_BE + c) [J], zero at B's origin.
template <class S>
S potential_energy(const RigidBody<S>& body, const Vector3<S>& p_BE, const Matrix3<S>& R_BE) {
  return -body.mass * dot<S>(body.gravity, Vector3<S>(p_BE + rotate<S>(R_BE, body.centre_E)));
}

/// Checks mass, inertia and errors as a user gives them.
/// @throws std::invalid_argument naming the scenario key: a mass that is not positive, an inertia that is not
/// symmetric, not positive definite, or that breaks the triangle inequality by more than 1e-9 of its trace; errors that
/// leave no positive inertia.
void validate(const RigidBody<double>& body, const DynamicsError<double>& error);

}  // namespace hexservo
