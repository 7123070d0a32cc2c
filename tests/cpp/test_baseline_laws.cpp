// The laws to compare with (docs/model.md, section 5), each against its formula written out on a finite-difference
// Jacobian with Eigen's decompositions, by hand where that is possible, and in the loop.
#include "hexservo/controller.hpp"
#include "hexservo/simulation.hpp"

#include "compare.hpp"
#include "decompositions.hpp"
#include "laws.hpp"
#include "random.hpp"
#include "scenarios.hpp"

#include <array>
#include <cmath>
#include <functional>
#include <string>

using namespace hexservo;
using namespace hexservo::test;

namespace {

using Jacobian = Eigen::Matrix<double, 8, 6>;
using Features = Vector<double, 8>;

constexpr double kFocal = 581.816;

/// R of a quaternion by Eigen.
Matrix3<double> rotation_of(const Vector4<double>& quaternion) {
  const Vector4<double> q = quaternion.normalized();
  return Eigen::Quaterniond(q(0), q(1), q(2), q(3)).toRotationMatrix();
}

/// A law in the middle of its work.
template <class Law>
struct Situation {
  ControlTask<double> task;
  typename Law::template Gains<double> gains;
  Sensed<double> input;

  Vector6<double> wrench() const { return evaluate_stateless<Law, double>(task, gains, input).wrench; }
  Features feature_error() const { return task.desired_features - input.image.features; }
};

/// d xi/d chi of points at given depths, by differences of fourth order; (4) written out.
Jacobian jacobian_by_differences(const Features& features, const Vector4<double>& depth, const Matrix3<double>& R) {
  const auto seen_after = [&](const Vector3<double>& move, const Vector3<double>& turn) {
    const Matrix3<double> turned = Eigen::AngleAxisd(turn.norm(), turn.stableNormalized()).toRotationMatrix() * R;
    Features out;
    for (int i = 0; i < 4; ++i) {
      const Vector3<double> p_E(-features(2 * i) * depth(i) / kFocal, -features(2 * i + 1) * depth(i) / kFocal,
                                depth(i));
      const Vector3<double> q_E = turned.transpose() * (R * p_E - move);
      out.segment<2>(2 * i) = -kFocal * q_E.head<2>() / q_E(2);
    }
    return out;
  };
  Jacobian J;
  for (int j = 0; j < 6; ++j) {
    const auto at = [&](double h) {
      Vector6<double> d = Vector6<double>::Zero();
      d(j) = h;
      return seen_after(d.head<3>(), d.tail<3>());
    };
    const double h = 1e-4;
    J.col(j) = (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h);
  }
  return J;
}

template <class Law>
Situation<Law> random_situation(Random& random) {
  Situation<Law> s;
  s.task.camera = kFocal;
  s.task.jacobian_sign = -1.0;
  s.task.gravity_wrench = gravity_wrench(RigidBody<double>{});
  s.task.body = RigidBody<double>{random.uniform(0.03, 0.1), random.inertia()};
  s.task.reference = {Vector3<double>(0.0, 0.0, -0.15), random.quaternion(0.5, 2.0)};
  for (int i = 0; i < 4; ++i) {  // one feature in each quarter of the image: well spread
    const double x = i < 2 ? 60.0 : -60.0, y = i % 2 == 0 ? 60.0 : -60.0;
    s.input.image.features.template segment<2>(2 * i) = Vector2<double>(x, y) + random.matrix<2>(40.0);
    s.input.image.depth(i) = -random.uniform(0.3, 0.8);
    s.task.target.goal_inverse_depth(i) = -1.0 / random.uniform(0.3, 0.8);
  }
  s.task.desired_features = s.input.image.features + random.matrix<8>(30.0);
  s.input.pose = {Vector3<double>(0.0, 0.0, -0.15) + random.matrix<3>(0.02), random.quaternion(0.5, 2.0)};
  s.input.R_BE = rotation_of(s.input.pose.quaternion);
  s.input.twist = random.six(0.05, 0.2);
  return s;
}

template <int N>
Vector<double, N> random_positive(Random& random, double size) {
  Vector<double, N> v;
  for (int i = 0; i < N; ++i) v(i) = random.uniform(0.2 * size, size);
  return v;
}

/// chi_a - chi_b in B, by Eigen's angle and axis.
Vector6<double> difference(const Pose<double>& a, const Pose<double>& b) {
  const Eigen::AngleAxisd turn(Matrix3<double>(rotation_of(a.quaternion) * rotation_of(b.quaternion).transpose()));
  Vector6<double> d;
  d << a.position - b.position, turn.angle() * turn.axis();
  return d;
}

template <class Law>
Settings paper_with(double gravity_error = 0.0) {
  Settings settings = paper_settings<Law>();
  settings.uncertainty.gravity.setConstant(gravity_error);
  return settings;
}

}  // namespace

// ---- Each law by its formula ----------------------------------------------------------------------------------------

TEST_CASE("kelly: tau = J^T K_p xi~ - K_d chi-dot + G") {
  Random random(9201);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 100; ++trial) {
    Situation<Kelly> s = random_situation<Kelly>(random);
    s.gains = {random_positive<8>(random, 1e-5), random_positive<6>(random, 1.0)};
    const Jacobian J = jacobian_by_differences(s.input.image.features, s.input.image.depth, s.input.R_BE);
    const Vector6<double> tau = J.transpose() * s.gains.kp.asDiagonal() * s.feature_error() -
                                s.gains.kd.asDiagonal() * s.input.twist + s.task.gravity_wrench;
    CHECK(relative_distance(s.wrench(), tau) <= 1e-10);
  }
}

TEST_CASE(
    "resolved_rate: tau = K_i (lambda J^+ xi~ - chi-dot) + G for each Jacobian, by a singular value decomposition") {
  Random random(9202);
  CAPTURE(random.seed());
  for (const JacobianPoint at : {JacobianPoint::current, JacobianPoint::desired, JacobianPoint::mean})
    for (const bool damped : {false, true})
      for (int trial = 0; trial < 50; ++trial) {
        CAPTURE(static_cast<int>(at));
        CAPTURE(damped);
        CAPTURE(trial);
        Situation<ResolvedRate> s = random_situation<ResolvedRate>(random);
        s.gains.gain = random.uniform(1.0, 10.0);
        s.gains.jacobian_at = at;
        s.gains.ki = random_positive<6>(random, 1.0);
        if (damped) s.gains.damping = random_positive<6>(random, 1e4);
        const Jacobian now = jacobian_by_differences(s.input.image.features, s.input.image.depth, s.input.R_BE);
        const Jacobian goal = jacobian_by_differences(s.task.desired_features,
                                                      s.task.target.goal_inverse_depth.cwiseInverse(), s.input.R_BE);
        const Jacobian J = at == JacobianPoint::current   ? now
                           : at == JacobianPoint::desired ? goal
                                                          : Jacobian((now + goal) / 2.0);
        // min |J v - xi~|^2 + |sqrt(M) v|^2
        Eigen::Matrix<double, 14, 6> A;
        Vector<double, 14> b;
        A << J, Matrix6<double>(s.gains.damping.cwiseSqrt().asDiagonal());
        b << s.feature_error(), Vector6<double>::Zero();
        const Vector6<double> velocity = s.gains.gain * least_squares(A, b);
        const Vector6<double> tau = s.gains.ki.asDiagonal() * (velocity - s.input.twist) + s.task.gravity_wrench;
        // normal equations square the condition, below 1e3 here; the differences are good to 1e-12
        const Vector6<double> sigma = singular_values(A);
        REQUIRE(sigma(0) / sigma(5) < 1e3);
        CHECK(relative_distance(s.wrench(), tau) <= 1e-6);
      }
}

TEST_CASE(
    "resolved_rate by hand: a square turned about the optical axis makes the camera retreat, advance, or just turn") {
  for (const double theta : {0.1, 1.0, 2.0, 3.0})
    for (const double side : {20.0, 100.0}) {
      CAPTURE(theta);
      CAPTURE(side);
      const double depth = 0.5, lambda = 3.0;
      Situation<ResolvedRate> s{};
      s.task.camera = kFocal;
      s.task.jacobian_sign = -1.0;
      s.task.gravity_wrench.setZero();
      s.task.target.goal_inverse_depth.setConstant(-1.0 / depth);
      s.input.image.features << side, side, -side, side, -side, -side, side, -side;
      s.input.image.depth.setConstant(-depth);
      s.input.R_BE.setIdentity();
      s.input.twist.setZero();
      for (int i = 0; i < 4; ++i)
        s.task.desired_features.segment<2>(2 * i) =
            Eigen::Rotation2Dd(theta) * Vector2<double>(s.input.image.features.segment<2>(2 * i));
      s.gains.gain = lambda;
      s.gains.ki.setOnes();
      // xi_d - xi = (cos - 1) xi + sin xi', with xi' = (-y, x); -xi/|Z| is the image of v_z, -xi' that of omega_z, and
      // the square makes all other columns of J orthogonal to both. The smaller one separates lateral and angular
      // motion by x^2/f = 0.7 px of 1163 px per m: normal equations square a condition of some 2e3.
      const double tolerance = 2e3 * 2e3 * kEpsilon;
      const auto wrench = [&](JacobianPoint at) {
        s.gains.jacobian_at = at;
        return s.wrench();
      };
      const double back = lambda * depth * (1.0 - std::cos(theta));
      Vector6<double> expected = Vector6<double>::Zero();
      expected(2) = back;
      expected(5) = -lambda * std::sin(theta);
      CHECK(relative_distance(wrench(JacobianPoint::current), expected) <= tolerance);
      expected(2) = -back;
      CHECK(relative_distance(wrench(JacobianPoint::desired), expected) <= tolerance);
      expected(2) = 0.0;
      expected(5) = -lambda * 2.0 * std::tan(theta / 2.0);  // xi_d - xi = tan(theta/2) (xi + xi_d)'
      CHECK(relative_distance(wrench(JacobianPoint::mean), expected) <= tolerance);
    }
}

TEST_CASE(
    "the adaptive gain: lambda_0 at the goal with slope -s_0, lambda_inf far away, constant where they are equal") {
  ResolvedRateGains<double> gains;
  gains.gain = 8.0;
  gains.gain_far = 2.0;
  gains.gain_slope = 0.5;
  CHECK(velocity_gain(gains, 7.0) == 8.0);  // not adaptive
  gains.adaptive = true;
  for (const double x : {0.0, 1e-9, 0.1, 1.0, 10.0, 100.0, 1e4})
    CHECK(std::abs(velocity_gain(gains, x) - ((8.0 - 2.0) * std::exp(-0.5 / (8.0 - 2.0) * x) + 2.0)) <= 1e-14);
  CHECK(std::abs((velocity_gain(gains, 1e-6) - velocity_gain(gains, 0.0)) / 1e-6 + 0.5) <= 1e-6);
  CHECK(std::isnan(velocity_gain(gains, kNaN)));
  gains.gain_far = 8.0;
  CHECK(velocity_gain(gains, 0.0) == 8.0);
  CHECK(velocity_gain(gains, 100.0) == 8.0);
  CHECK(std::isnan(velocity_gain(gains, kNaN)));

  Random random(9203);
  CAPTURE(random.seed());
  Situation<ResolvedRate> s = random_situation<ResolvedRate>(random);
  s.input.twist.setZero();
  s.task.gravity_wrench.setZero();
  s.gains.gain = 1.0;
  const Vector6<double> unit = s.wrench();
  s.gains.adaptive = true;
  s.gains.gain = 8.0;
  s.gains.gain_far = 2.0;
  CHECK(relative_distance(s.wrench(), velocity_gain(s.gains, s.feature_error().cwiseAbs().maxCoeff()) * unit) <= 1e-13);
}

TEST_CASE("pbvs: tau = K_p (chi_goal - chi-hat) - K_d chi-dot + G, with chi-hat the pose estimated from the image") {
  Random random(9204);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 100; ++trial) {
    CAPTURE(trial);
    Situation<Pbvs> s = random_situation<Pbvs>(random);
    s.gains = {random_positive<6>(random, 20.0), random_positive<6>(random, 1.0), Vector6<double>::Zero()};
    s.task.target.goal = {Vector3<double>(0.01, 0.0, -0.15) + random.matrix<3>(0.02), random.quaternion(0.5, 2.0)};
    // the points are where the true pose sees them, and the sensors give a different pose
    const Pose<double> truth = s.input.pose;
    for (int i = 0; i < 4; ++i) {
      const double Z = s.input.image.depth(i);
      const Vector3<double> p_E(-s.input.image.features(2 * i) * Z / kFocal,
                                -s.input.image.features(2 * i + 1) * Z / kFocal, Z);
      s.task.target.points_T.col(i) = truth.position + s.input.R_BE * p_E;
    }
    s.input.pose.position += random.matrix<3>(0.003);
    s.input.pose.quaternion += random.matrix<4>(0.005);
    const Vector6<double> tau = s.gains.kp.asDiagonal() * difference(s.task.target.goal, truth) -
                                s.gains.kd.asDiagonal() * s.input.twist + s.task.gravity_wrench;
    CHECK(distance(s.wrench(), tau) <= 1e-7);  // the estimate is good to 1e-9
    // a prior whose least share outweighs the image: the pose of the sensors
    s.gains.prior.setConstant(1e16 / kLeastPrior);
    const Vector6<double> sensed = s.gains.kp.asDiagonal() * difference(s.task.target.goal, s.input.pose) -
                                   s.gains.kd.asDiagonal() * s.input.twist + s.task.gravity_wrench;
    CHECK(distance(s.wrench(), sensed) <= 1e-7);
  }
}

TEST_CASE(
    "computed_torque: tau = D (K_p e - K_d chi-dot) + C chi-dot + G, with e by least squares, with and without prior") {
  Random random(9205);
  CAPTURE(random.seed());
  for (const bool prior : {true, false})
    for (int trial = 0; trial < 100; ++trial) {
      CAPTURE(prior);
      CAPTURE(trial);
      Situation<ComputedTorque> s = random_situation<ComputedTorque>(random);
      s.gains = {random_positive<6>(random, 400.0), random_positive<6>(random, 40.0), Vector6<double>::Zero()};
      if (prior) s.gains.prior = random_positive<6>(random, 1e4);
      const Jacobian J = jacobian_by_differences(s.input.image.features, s.input.image.depth, s.input.R_BE);
      const Vector6<double> weight = s.gains.prior.cwiseSqrt();
      Eigen::Matrix<double, 14, 6> A;
      Vector<double, 14> b;
      A << J, Matrix6<double>(weight.asDiagonal());
      b << s.feature_error(), weight.cwiseProduct(difference(s.task.reference, s.input.pose));
      const Vector6<double> e = least_squares(A, b);
      const Matrix3<double>& R = s.input.R_BE;
      const Matrix3<double> I = R * s.task.body.inertia_E * R.transpose();
      const Vector3<double> omega = s.input.twist.tail<3>();
      Matrix6<double> D = Matrix6<double>::Zero(), C = Matrix6<double>::Zero();
      D.topLeftCorner<3, 3>() = s.task.body.mass * Matrix3<double>::Identity();
      D.bottomRightCorner<3, 3>() = I;
      for (int j = 0; j < 3; ++j) C.col(3 + j).tail<3>() = omega.cross(I.col(j));
      const Vector6<double> tau = D * (s.gains.kp.asDiagonal() * e - s.gains.kd.asDiagonal() * s.input.twist) +
                                  C * s.input.twist + s.task.gravity_wrench;
      CHECK(relative_distance(s.wrench(), tau) <= 1e-6);  // as for resolved_rate
    }
}

// ---- What all of them share -----------------------------------------------------------------------------------------

TEST_CASE_TEMPLATE(
    "a pack evaluates the law as double does, lane by lane, and a lane without a solution harms no other", Law, Kelly,
    ResolvedRate, Pbvs, ComputedTorque) {
  Random random(9206);
  CAPTURE(random.seed());
  CAPTURE(Law::traits.name);
  using S = Lanes<4>;
  ControlTask<S> task;
  typename Law::template Gains<S> gains;
  Sensed<S> input;
  std::array<Situation<Law>, 4> situations;
  for (int lane = 0; lane < 4; ++lane) {
    Situation<Law>& s = situations[static_cast<std::size_t>(lane)];
    s = random_situation<Law>(random);
    for (int i = 0; i < 4; ++i)
      s.task.target.points_T.col(i) =
          s.input.pose.position + s.input.R_BE * back_project<double>(kFocal,
                                                                      s.input.image.features.template segment<2>(2 * i),
                                                                      s.input.image.depth(i));
    s.task.target.goal = s.task.reference;
    if (lane == 3) {  // four times the same point
      s.input.image.features.setZero();
      s.task.target.points_T.setZero();
      if constexpr (requires { s.gains.prior; }) s.gains.prior.setZero();
    }
    set_lane(task.camera.focal, lane, s.task.camera.focal);
    set_lane(task.jacobian_sign, lane, s.task.jacobian_sign);
    set_lane(task.desired_features, lane, s.task.desired_features);
    set_lane(task.gravity_wrench, lane, s.task.gravity_wrench);
    set_lane(task.reference, lane, s.task.reference);
    set_lane(task.body, lane, s.task.body);
    set_lane(task.target.points_T, lane, s.task.target.points_T);
    set_lane(task.target.goal, lane, s.task.target.goal);
    set_lane(task.target.goal_inverse_depth, lane, s.task.target.goal_inverse_depth);
    set_lane(gains, lane, s.gains);
    set_lane(input.image, lane, s.input.image);
    set_lane(input.R_BE, lane, s.input.R_BE);
    set_lane(input.twist, lane, s.input.twist);
    set_lane(input.pose, lane, s.input.pose);
  }
  const auto out = evaluate_stateless<Law, S>(task, gains, input);
  for (int lane = 0; lane < 3; ++lane) {
    CAPTURE(lane);
    const Vector6<double> single = situations[static_cast<std::size_t>(lane)].wrench();
    CHECK_FALSE(single.hasNaN());
    CHECK(relative_distance(lane_of(out.wrench, lane), single) <= 1e-12);
    CHECK(lane_of(out.fuzzy_output, lane) == Vector6<double>::Zero());
  }
  CHECK(lane_of(out.wrench, 3).hasNaN() != std::is_same_v<Law, Kelly>);
}

TEST_CASE_TEMPLATE("gains that make no sense are refused, with the key and the place", Law, Kelly, ResolvedRate, Pbvs,
                   ComputedTorque) {
  using Gains = GainsOf<Law>;
  const std::string head = "controller." + std::string(Law::traits.name) + ".";
  CHECK(refusal([] { validate_gains<Law>({}); }) == "(accepted)");
  std::size_t count = 0;
  Gains gains;
  Gains::visit(
      [&](const Field& field, auto& member) {
        ++count;
        const auto check = [&](double& number, const std::string& place) {
          const double good = number;
          for (const double bad : {kNaN, kInfinity, -1e-6}) {
            number = bad;
            CHECK(is_about(refusal([&] { validate_gains<Law>(gains); }), head + std::string(field.name) + place));
          }
          number = good;
        };
        if constexpr (std::is_same_v<std::remove_cvref_t<decltype(member)>, double>)
          check(member, "");
        else if constexpr (requires { member.size(); })
          check(member(member.size() - 1), "[" + std::to_string(member.size() - 1) + "]");
      },
      gains);
  REQUIRE(count >= 2);
}

TEST_CASE("an adaptive gain that grows with the distance is refused; gain_far has no effect on a constant one") {
  GainsOf<ResolvedRate> gains;
  gains.gain_far = 2.0 * gains.gain;
  CHECK(refusal([&] { validate_gains<ResolvedRate>(gains); }) == "(accepted)");
  gains.adaptive = true;
  CHECK(is_about(refusal([&] { validate_gains<ResolvedRate>(gains); }), "controller.resolved_rate.gain_far"));
}

TEST_CASE("a camera as printed has no points: laws that need the goal's pose are refused, the others run") {
  Settings pbvs = paper_with<Pbvs>();
  pbvs.camera.convention = CameraConvention::as_printed;
  CHECK(is_about(refusal([&] { loop_parameters<Pbvs>(pbvs); }), "camera.convention"));
  Settings rate = paper_with<ResolvedRate>();
  rate.camera.convention = CameraConvention::as_printed;
  CHECK(refusal([&] { loop_parameters<ResolvedRate>(rate); }) == "(accepted)");
  rate.gains<ResolvedRate>().jacobian_at = JacobianPoint::mean;
  CHECK(is_about(refusal([&] { loop_parameters<ResolvedRate>(rate); }), "camera.convention"));
}

TEST_CASE("the target points of a controller follow from its depth estimates: in simulation and on a robot") {
  const LoopParameters<double, Pbvs> loop = loop_parameters<Pbvs>(paper_with<Pbvs>());
  const ControlTask<double> task = control_task(loop);
  const ControllerGains<Pbvs> gains = controller_gains<Pbvs>(paper_with<Pbvs>(), 1e-3);
  CHECK(gains.task.target.points_T == task.target.points_T);
  CHECK(gains.task.target.goal.position == task.target.goal.position);
  Settings settings = paper_with<Pbvs>();
  settings.uncertainty = {};
  const ControllerGains<Pbvs> nominal = controller_gains<Pbvs>(settings, 1e-3);
  CHECK(distance(gains.task.target.points_T.row(2), nominal.task.target.points_T.row(2)) > 0.1);  // 30 % of 0.5 m
}
