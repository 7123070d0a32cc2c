// Platform dynamics (1)-(3): Property 1, the literal 6x6 equation, conservation, rotations, refusals.
#include "hexservo/rigid_body.hpp"
#include "hexservo/runge_kutta.hpp"

#include "compare.hpp"
#include "decompositions.hpp"
#include "random.hpp"

#include <Eigen/LU>

#include <algorithm>

using namespace hexservo;
using namespace hexservo::test;

namespace {

/// Rotation by `time * omega` [rad], made by Eigen.
Matrix3<double> turn(const Vector3<double>& omega, double time) {
  return Eigen::AngleAxisd(omega.norm() * time, omega.normalized()).toRotationMatrix();
}

RigidBody<double> random_body(Random& random) { return {random.uniform(0.02, 0.2), random.inertia()}; }

/// The same body described from another origin: its centre of mass is at c from there.
RigidBody<double> described_from(const RigidBody<double>& central, const Vector3<double>& c) {
  RigidBody<double> body = central;
  body.inertia_E += displaced_inertia(body.mass, c);
  body.centre_E = c;
  body.off_centre = true;
  return body;
}

/// Element-wise errors as (3) allows them: symmetric for D, anything for C and G.
DynamicsError<double> random_error(Random& random, double size) {
  DynamicsError<double> error;
  const Matrix6<double> any = random.matrix<6, 6>(size);
  error.inertia = (any + any.transpose()) / 2.0;
  error.coriolis = random.matrix<6, 6>(size);
  error.gravity = random.matrix<6>(size);
  return error;
}

/// RK4 over `steps` steps of h [s] under a wrench that does not change.
BodyState<double> integrate(const RigidBody<double>& body, const BodyState<double>& start,
                            const Vector6<double>& wrench, double h, int steps) {
  const Plant<double> plant(body, {});
  const auto rate_at = [&](const BodyMotion<double>& at) {
    return body_rate(plant, at, rotation_matrix(quaternion_of(at)), wrench);
  };
  BodyMotion<double> motion = BodyMotion<double>::of(start);
  for (int i = 0; i < steps; ++i) {
    runge_kutta_step(h, motion, rate_at);
    normalise_quaternion(motion);
  }
  return motion.state();
}

}  // namespace

TEST_CASE("Property 1 (2): y^T (D-dot - 2 C) y = 0, with D-dot by central differences along the motion") {
  Random random(7101);
  CAPTURE(random.seed());
  double largest_part = 0.0;
  for (int trial = 0; trial < 200; ++trial) {
    CAPTURE(trial);
    const RigidBody<double> central = random_body(random);
    const RigidBody<double> body = trial % 2 == 0 ? central : described_from(central, random.matrix<3>(0.05));
    const Matrix3<double> R_BE = random.rotation();
    const Vector3<double> omega = random.matrix<3>(5.0);
    const Vector6<double> twist = (Vector6<double>() << random.matrix<3>(), omega).finished();
    const Vector6<double> y = random.matrix<6>();
    const double h = 1e-5 / omega.norm();
    const Matrix6<double> D_rate =
        (mass_matrix<double>(body, turn(omega, h) * R_BE) - mass_matrix<double>(body, turn(omega, -h) * R_BE)) /
        (2.0 * h);
    const Matrix6<double> C = coriolis_matrix(body, R_BE, twist);
    // Each derivative of R I R^T brings at most a factor 2 |omega|, so the difference is off by (h |omega|)^2 8/6
    // = 1.3e-10 of |omega| |I|, and rounding adds a few eps/(h |omega|) = 2e-11 of m, which D holds beside I.
    // Off centre D has m [c]x as well, of which the same holds.
    const double turned = body.inertia_E.norm() + body.mass * body.centre_E.norm();
    const double size = omega.norm() * turned * y.squaredNorm();
    const double rounding = 8.0 * kEpsilon / 1e-5 * omega.norm() * y.squaredNorm() * turned;
    CHECK(std::abs(y.dot((D_rate - 2.0 * C) * y)) <= 2e-10 * size + rounding);
    largest_part = std::max(largest_part, std::abs(y.dot(D_rate * y)) / size);
  }
  CHECK(largest_part > 0.05);  // the two terms that cancel are not small themselves
}

TEST_CASE(
    "acceleration solves (3) with element-wise errors, against an independent solver of the assembled 6x6 equation") {
  Random random(7102);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 200; ++trial) {
    CAPTURE(trial);
    const RigidBody<double> body = random_body(random);
    const DynamicsError<double> error = random_error(random, 0.2);
    const Matrix3<double> R_BE = random.rotation();
    const Vector6<double> twist = random.six(0.5, 10.0), wrench = random.six(1.0, 0.1);

    const Matrix6<double> ones = Matrix6<double>::Ones();
    const Matrix6<double> D = (ones - error.inertia).cwiseProduct(mass_matrix(body, R_BE));
    const Matrix6<double> C = (ones - error.coriolis).cwiseProduct(coriolis_matrix<double>(body, R_BE, twist));
    const Vector6<double> G = (Vector6<double>::Ones() - error.gravity).cwiseProduct(gravity_wrench(body));
    const Vector6<double> expected = solve_by_lu(D, wrench - C * twist - G);
    const Vector6<double> result = acceleration(Plant<double>(body, error), R_BE, twist, wrench).vector();
    // Both blocks are well conditioned on their own (inertias differ by less than 20, errors leave more than 0.6).
    CHECK(relative_distance(result.head<3>(), expected.head<3>()) <= 100.0 * kEpsilon);
    CHECK(relative_distance(result.tail<3>(), expected.tail<3>()) <= 1000.0 * kEpsilon);
  }
}

TEST_CASE("acceleration off centre solves (3) with errors of all entries") {
  Random random(7107);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 200; ++trial) {
    CAPTURE(trial);
    const RigidBody<double> body = described_from(random_body(random), random.matrix<3>(0.05));
    const DynamicsError<double> error = random_error(random, 0.05);
    const Matrix3<double> R_BE = random.rotation();
    const Vector6<double> twist = random.six(0.5, 10.0), wrench = random.six(1.0, 0.1);
    const Matrix6<double> ones = Matrix6<double>::Ones();
    const Matrix6<double> D = (ones - error.inertia).cwiseProduct(mass_matrix(body, R_BE));
    const Matrix6<double> C = (ones - error.coriolis).cwiseProduct(coriolis_matrix<double>(body, R_BE, twist));
    const Vector6<double> G = (Vector6<double>::Ones() - error.gravity).cwiseProduct(gravity_wrench(body, R_BE));
    const Vector6<double> result = acceleration(Plant<double>(body, error), R_BE, twist, wrench).vector();
    // What is left of the equation, next to its terms.
    const Vector6<double> left = D * result + C * twist + G - wrench;
    const Vector6<double> terms = (D.cwiseAbs() * result.cwiseAbs()) + wrench.cwiseAbs() + G.cwiseAbs();
    for (int i = 0; i < 6; ++i) CHECK(std::abs(left(i)) <= 1000.0 * kEpsilon * terms(i));
  }
}

TEST_CASE("a body described from another origin than its centre of mass moves alike") {
  Random random(7108);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 5; ++trial) {
    CAPTURE(trial);
    const RigidBody<double> central = random_body(random);
    const Vector3<double> c = random.matrix<3>(0.05);
    const RigidBody<double> body = described_from(central, c);
    const Pose<double> pose{random.matrix<3>(0.1), random.quaternion()};
    const BodyState<double> start = body_state(pose, random.six(0.5, 3.0));
    const auto other_origin = [&](const BodyState<double>& s) {  // the state of the origin that has c from it
      const Vector3<double> arm = rotation_matrix(quaternion_of(s)) * c;
      Vector6<double> twist = twist_of(s);
      twist.head<3>() -= twist_of(s).tail<3>().cross(arm);
      return body_state<double>({position_of(s) - arm, quaternion_of(s)}, twist);
    };
    const BodyState<double> expected = other_origin(integrate(central, start, Vector6<double>::Zero(), 1e-3, 1000));
    const BodyState<double> end = integrate(body, other_origin(start), Vector6<double>::Zero(), 1e-3, 1000);
    // Both are off by some (h omega)^5/120 a step, below 1e-14 for |omega| below 10 rad/s.
    CHECK(distance(end, expected) <= 1e-9 * expected.norm());
    CHECK(distance(position_of(end), position_of(start)) > 1.0);
    // Energies of the two descriptions are the same.
    CHECK(kinetic_energy(body, rotation_matrix(quaternion_of(end)), twist_of(end)) ==
          doctest::Approx(
              kinetic_energy(central, rotation_matrix(quaternion_of(end)),
                             Vector6<double>(twist_of(integrate(central, start, Vector6<double>::Zero(), 1e-3, 1000)))))
              .epsilon(1e-9));
  }
}

TEST_CASE("two bodies joined have the momenta of both") {
  Random random(7109);
  CAPTURE(random.seed());
  const RigidBody<double> a = described_from(random_body(random), random.matrix<3>(0.05));
  const RigidBody<double> b = described_from(random_body(random), random.matrix<3>(0.1));
  const RigidBody<double> both = joined(a, b);
  for (int trial = 0; trial < 20; ++trial) {
    const Matrix3<double> R_BE = random.rotation();
    const Matrix6<double> sum = mass_matrix(a, R_BE) + mass_matrix(b, R_BE);
    CHECK(relative_distance(mass_matrix(both, R_BE), sum) <= 10.0 * kEpsilon);
    CHECK(relative_distance(gravity_wrench(both, R_BE), gravity_wrench(a, R_BE) + gravity_wrench(b, R_BE)) <=
          10.0 * kEpsilon);
  }
}

TEST_CASE("D and C are those of (1): blkdiag(m 1, R I R^T) and blkdiag(0, [omega]x R I R^T)") {
  Random random(7103);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 50; ++trial) {
    const RigidBody<double> body = random_body(random);
    const Matrix3<double> R_BE = random.rotation();
    const Vector6<double> twist = random.six(1.0, 5.0);
    const Vector3<double> omega = twist.tail<3>();
    const Matrix6<double> D = mass_matrix(body, R_BE), C = coriolis_matrix(body, R_BE, twist);
    CHECK(D.topLeftCorner<3, 3>() == body.mass * Matrix3<double>::Identity());
    CHECK(D.topRightCorner<3, 3>().isZero(0.0));
    CHECK(D.bottomLeftCorner<3, 3>().isZero(0.0));
    // turned back into E, the angular block is the inertia itself
    CHECK(relative_distance(R_BE.transpose() * D.bottomRightCorner<3, 3>() * R_BE, body.inertia_E) <= 20.0 * kEpsilon);
    CHECK(C.topRows<3>().isZero(0.0));
    CHECK(C.leftCols<3>().isZero(0.0));
    const Vector3<double> any = random.matrix<3>();
    CHECK(relative_distance(C.bottomRightCorner<3, 3>() * any, omega.cross(D.bottomRightCorner<3, 3>() * any)) <=
          50.0 * kEpsilon);
    // kinetic energy, written in E
    const Vector3<double> omega_E = R_BE.transpose() * twist.tail<3>();
    const double energy = 0.5 * body.mass * twist.head<3>().squaredNorm() + 0.5 * omega_E.dot(body.inertia_E * omega_E);
    CHECK(kinetic_energy(body, R_BE, twist) == doctest::Approx(energy).epsilon(20.0 * kEpsilon));
  }
}

TEST_CASE("z points down: a platform without actuators falls with +9.8 m/s^2 along z, and G holds it") {
  Random random(7104);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 20; ++trial) {
    const RigidBody<double> body{random.uniform(0.02, 0.2), random.inertia()};
    const Matrix3<double> R_BE = random.rotation();
    const Vector6<double> rest = Vector6<double>::Zero();
    Vector6<double> fall = rest;
    fall(2) = 9.8;
    const Plant<double> plant(body, {});
    CHECK(distance(acceleration(plant, R_BE, rest, rest).vector(), fall) <= 10.0 * kEpsilon * 9.8);
    CHECK(acceleration(plant, R_BE, rest, gravity_wrench(body)).vector().isZero(0.0));
    Vector6<double> printed = rest;  // m (0, 0, -9.8, 0, 0, 0) of (1)
    printed(2) = body.mass * -9.8;
    CHECK(gravity_wrench(body) == printed);
    // potential energy falls with the fall: its gradient is minus the weight
    const Vector3<double> p = random.matrix<3>(), up(0.0, 0.0, -1.0);
    CHECK(potential_energy<double>(body, p + up, R_BE) - potential_energy(body, p, R_BE) ==
          doctest::Approx(body.mass * 9.8));
  }
}

TEST_CASE("energy and angular momentum are conserved without control: tumbling and falling for 10 s at 1 ms") {
  Random random(7105);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 3; ++trial) {
    CAPTURE(trial);
    const Matrix3<double> axes = random.rotation();
    RigidBody<double> body;
    body.inertia_E = axes * Vector3<double>(1.2e-4, 2.0e-4, 3.0e-4).asDiagonal() * axes.transpose();
    const Pose<double> pose{random.matrix<3>(0.1), random.quaternion()};
    BodyState<double> start = body_state(pose, random.six(0.5, 1.0));
    start.tail<3>() *= 3.0 / start.tail<3>().norm();  // [rad/s]
    BodyState<double> end = start;
    double largest_turn = 0.0;  // of the angular velocity in B
    for (int part = 0; part < 100; ++part) {
      end = integrate(body, end, Vector6<double>::Zero(), 1e-3, 100);
      largest_turn = std::max(largest_turn, distance(twist_of(end).tail<3>(), twist_of(start).tail<3>()));
    }

    const auto spin_energy = [&](const BodyState<double>& s) {
      Vector6<double> spin = twist_of(s);
      spin.head<3>().setZero();
      return kinetic_energy(body, rotation_matrix(quaternion_of(s)), spin);
    };
    const auto energy = [&](const BodyState<double>& s) {
      return kinetic_energy(body, rotation_matrix(quaternion_of(s)), twist_of(s)) +
             potential_energy(body, position_of(s), rotation_matrix(quaternion_of(s)));
    };
    const auto spin = [&](const BodyState<double>& s) {
      return Vector3<double>(inertia_in_base(body, rotation_matrix(quaternion_of(s))) * twist_of(s).tail<3>());
    };
    // A step of RK4 is off by (h omega)^5/120 < 1e-15 for |omega| < 4 rad/s; 10^4 of them stay below 1e-11.
    CHECK(std::abs(spin_energy(end) - spin_energy(start)) <= 1e-10 * spin_energy(start));
    CHECK(distance(spin(end), spin(start)) <= 1e-10 * spin(start).norm());
    const double exchanged = potential_energy(body, position_of(start), rotation_matrix(quaternion_of(start))) -
                             potential_energy(body, position_of(end), rotation_matrix(quaternion_of(end)));
    CHECK(exchanged > 10.0);  // [J]: some 490 m
    CHECK(std::abs(energy(end) - energy(start)) <= 1e-10 * exchanged);
    // it really tumbled: the angular velocity is not constant in B
    CHECK(largest_turn > 0.1 * twist_of(start).tail<3>().norm());
    // and the fall is the closed form, which RK4 integrates exactly
    const Vector3<double> expected =
        position_of(start) + 10.0 * twist_of(start).head<3>() + Vector3<double>(0.0, 0.0, 490.0);
    CHECK(relative_distance(position_of(end), expected) <= 1e-12);
  }
}

TEST_CASE("work of a constant wrench becomes energy") {
  // The power wrench . twist is integrated by quadrature on a fine grid (Simpson), so only its own error counts.
  Random random(7106);
  CAPTURE(random.seed());
  const RigidBody<double> body = random_body(random);
  BodyState<double> state = body_state<double>({random.matrix<3>(0.1), random.quaternion()}, random.six(0.1, 1.0));
  const Vector6<double> wrench = gravity_wrench(body) + random.six(0.05, 1e-3);
  const auto energy = [&] {
    return kinetic_energy(body, rotation_matrix(quaternion_of(state)), twist_of(state)) +
           potential_energy(body, position_of(state), rotation_matrix(quaternion_of(state)));
  };
  const double h = 1e-3;
  const int steps = 400;
  const double before = energy();
  double work = wrench.dot(twist_of(state)) * h / 3.0;
  for (int i = 1; i <= steps; ++i) {
    state = integrate(body, state, wrench, h, 1);
    work += wrench.dot(twist_of(state)) * h / 3.0 * (i == steps ? 1.0 : i % 2 == 1 ? 4.0 : 2.0);
  }
  CHECK(std::abs(work) > 1e-4);
  CHECK(std::abs(energy() - before - work) <= 1e-9 * std::abs(work));
}

TEST_CASE("quaternion rate: d/dt R = [omega]x R by central differences, for quaternions of any length") {
  Random random(7107);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 200; ++trial) {
    CAPTURE(trial);
    const Vector4<double> q = random.quaternion(0.2, 5.0);
    const Vector3<double> omega = random.matrix<3>(3.0);
    const Vector4<double> rate = quaternion_rate(q, omega);
    const double h = 1e-5 / omega.norm();
    const Matrix3<double> derivative =
        (rotation_matrix<double>(q + h * rate) - rotation_matrix<double>(q - h * rate)) / (2.0 * h);
    // q + h q-dot turns by 2 atan(h omega/2): off by (h omega)^2/12, beside (h omega)^2/6 of the difference; and
    // rounding
    CHECK(distance(derivative, skew(omega) * rotation_matrix(q)) <= (1e-10 + 10.0 * kEpsilon / 1e-5) * omega.norm());
    CHECK(std::abs(rate.dot(q)) <= 10.0 * kEpsilon * q.norm() * rate.norm());  // the length does not change
    CHECK(rate.norm() == doctest::Approx(0.5 * omega.norm() * q.norm()).epsilon(10.0 * kEpsilon));
  }
}

TEST_CASE("rotation_matrix is orthonormal, right-handed, Eigen's, and blind to length and sign of the quaternion") {
  Random random(7108);
  CAPTURE(random.seed());
  const auto check = [](const Vector4<double>& q) {
    const Matrix3<double> R = rotation_matrix(q);
    const Vector4<double> u = q.normalized();
    CHECK(distance(R * R.transpose(), Matrix3<double>::Identity()) <= 10.0 * kEpsilon);
    CHECK(R.determinant() == doctest::Approx(1.0).epsilon(10.0 * kEpsilon));
    CHECK(distance(R, Eigen::Quaterniond(u(0), u(1), u(2), u(3)).toRotationMatrix()) <= 10.0 * kEpsilon);
    CHECK(distance(R, rotation_matrix<double>(-3.7 * q)) <= 10.0 * kEpsilon);
  };
  check({1.0, 0.0, 0.0, 0.0});
  check({0.0, 0.0, 1.0, 0.0});
  check({1.0, 1e-8, -1e-8, 1e-8});
  for (int trial = 0; trial < 200; ++trial) check(random.quaternion(1e-3, 1e3));
  CHECK(rotation_matrix<double>({1.0, 0.0, 0.0, 0.0}) == Matrix3<double>::Identity());
}

TEST_CASE("skew and solve3 are the cross product and the inverse") {
  Random random(7109);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 100; ++trial) {
    const Vector3<double> a = random.matrix<3>(), b = random.matrix<3>();
    CHECK(distance(skew(a) * b, a.cross(b)) <= 4.0 * kEpsilon);
    CHECK(skew(a).transpose() == -skew(a));
    const Matrix3<double> A = random.positive_definite<3>(100.0);
    CHECK(relative_distance(A * solve3(A, b), b) <= 100.0 * 20.0 * kEpsilon);
  }
}

TEST_CASE("state: parts go in and come out") {
  Random random(7110);
  CAPTURE(random.seed());
  const Pose<double> pose{random.matrix<3>(), random.quaternion(2.0, 3.0)};
  const Vector6<double> twist = random.six(1.0, 1.0);
  const BodyState<double> state = body_state(pose, twist);
  CHECK(position_of(state) == pose.position);
  CHECK(quaternion_of(state) == pose.quaternion);
  CHECK(twist_of(state) == twist);
  BodyMotion<double> motion = BodyMotion<double>::of(state);
  CHECK(motion.state() == state);
  normalise_quaternion(motion);
  CHECK(quaternion_of(motion).norm() == doctest::Approx(1.0).epsilon(4.0 * kEpsilon));
  CHECK(distance(quaternion_of(motion), pose.quaternion.normalized()) <= 4.0 * kEpsilon);
  CHECK(position_of(motion) == pose.position);
  CHECK(twist_of(motion) == twist);
}

// --- what is refused
// --------------------------------------------------------------------------------------------------

namespace {

std::string verdict(const RigidBody<double>& body, const DynamicsError<double>& error = {}) {
  return refusal([&] { validate(body, error); });
}

RigidBody<double> body_with_moments(double a, double b, double c,
                                    const Matrix3<double>& R = Matrix3<double>::Identity()) {
  RigidBody<double> body;
  const Matrix3<double> I = R * Vector3<double>(a, b, c).asDiagonal() * R.transpose();
  body.inertia_E = (I + I.transpose()) / 2.0;
  return body;
}

}  // namespace

TEST_CASE(
    "a thin disc is exactly on the triangle inequality and accepted, in any axes; 1e-9 of the trace beyond is "
    "refused") {
  Random random(7111);
  CAPTURE(random.seed());
  CHECK(verdict({}) == "(accepted)");
  const double trace = 6e-4;
  for (int trial = 0; trial < 50; ++trial) {
    const Matrix3<double> R = random.rotation();
    CHECK(verdict(body_with_moments(1.5e-4, 1.5e-4, 3e-4, R)) == "(accepted)");
    CHECK(verdict(body_with_moments(1.5e-4, 1.5e-4, 3e-4 + 0.99e-9 * trace, R)) == "(accepted)");
    CHECK(is_about(verdict(body_with_moments(1.5e-4, 1.5e-4, 3e-4 + 1.01e-9 * trace, R)), "robot.inertia"));
    CHECK(is_about(verdict(body_with_moments(1e-4, 1e-4, 3e-4, R)), "robot.inertia"));
    CHECK(is_about(verdict(body_with_moments(3e-4, 1e-4, 1e-4, R)), "robot.inertia"));
  }
}

TEST_CASE("masses and inertias that no body has are refused") {
  for (const double bad : {0.0, -0.06, kNaN, kInfinity, -kInfinity}) {
    CAPTURE(bad);
    RigidBody<double> body;
    body.mass = bad;
    CHECK(is_about(verdict(body), "robot.mass"));
  }
  for (const double bad : {kNaN, kInfinity, -kInfinity}) {
    CAPTURE(bad);
    RigidBody<double> body;
    body.gravity(1) = bad;
    CHECK(is_about(verdict(body), "robot.gravity"));
    for (int entry = 0; entry < 9; ++entry) {
      CAPTURE(entry);
      RigidBody<double> other;
      other.inertia_E(entry) = bad;
      CHECK(is_about(verdict(other), "robot.inertia"));
    }
  }
  RigidBody<double> lopsided;
  lopsided.inertia_E(0, 1) = 1e-5;
  CHECK(is_about(verdict(lopsided), "robot.inertia"));
  CHECK(is_about(verdict(body_with_moments(0.0, 0.0, 0.0)), "robot.inertia"));
  CHECK(is_about(verdict(body_with_moments(-1e-4, -1e-4, -1e-4)), "robot.inertia"));
  CHECK(is_about(verdict(body_with_moments(1e-4, 1e-4, -1e-5)), "robot.inertia"));
}

TEST_CASE("errors that are not numbers are refused, whichever entry they are in") {
  for (const double bad : {kNaN, kInfinity, -kInfinity})
    for (int entry = 0; entry < 36; ++entry) {
      CAPTURE(entry);
      DynamicsError<double> inertia, coriolis, gravity;
      inertia.inertia(entry) = bad;
      coriolis.coriolis(entry) = bad;
      gravity.gravity(entry % 6) = bad;
      CHECK(is_about(verdict({}, inertia), "uncertainty.inertia"));
      CHECK(is_about(verdict({}, coriolis), "uncertainty.coriolis"));
      CHECK(is_about(verdict({}, gravity), "uncertainty.gravity"));
    }
}

TEST_CASE("inertia errors: what is accepted leaves a positive definite D at every attitude, and the rest is refused") {
  DynamicsError<double> lopsided, total;
  lopsided.inertia(3, 4) = 0.1;
  total.inertia.setConstant(1.0);
  CHECK(is_about(verdict({}, lopsided), "uncertainty.inertia"));
  CHECK(is_about(verdict({}, total), "uncertainty.inertia"));

  Random random(7112);
  CAPTURE(random.seed());
  int accepted = 0, refused = 0;
  for (int trial = 0; trial < 400; ++trial) {
    CAPTURE(trial);
    const RigidBody<double> body = random_body(random);
    const DynamicsError<double> error = random_error(random, random.uniform(0.0, 2.0));
    if (verdict(body, error) != "(accepted)") {
      ++refused;
      continue;
    }
    ++accepted;
    for (int pose = 0; pose < 20; ++pose) {
      const Matrix6<double> D =
          (Matrix6<double>::Ones() - error.inertia).cwiseProduct(mass_matrix<double>(body, random.rotation()));
      CHECK(symmetric_eigenvalues(D.bottomRightCorner<3, 3>())(0) > 0.0);
      CHECK(D.diagonal().minCoeff() > 0.0);
    }
  }
  CHECK(accepted > 20);
  CHECK(refused > 20);
}
