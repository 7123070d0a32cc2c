// The law `composite` (docs/model.md, section 5): its pose error as the solution of a least-squares problem, its
// equations written out, and what its prior is for.
#include "hexservo/controller.hpp"

#include "allocations.hpp"
#include "compare.hpp"
#include "decompositions.hpp"
#include "laws.hpp"
#include "random.hpp"
#include "scenarios.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <string>
#include <utility>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

using Jacobian = Eigen::Matrix<double, 8, 6>;

constexpr double kPi = 3.14159265358979323846;
constexpr double kFocal = 581.816;

/// A law in the middle of its work: random gains, weights and sensor values of ordinary size.
struct Situation {
  ControlTask<double> task;
  CompositeGains<double> gains;
  FuzzyWeights<double> weights;
  Sensed<double> input;

  Composite::Evaluation<double> evaluate() const {
    return evaluate_law<Composite, double>(task, gains, weights, input);
  }
  ImageJacobian<double> jacobian() const {
    return ImageJacobian<double>(task.camera, task.jacobian_sign, input.image, input.pose.position, input.R_BE);
  }
  Vector<double, 8> feature_error() const { return task.desired_features - input.image.features; }
};

/// R of a quaternion by Eigen.
Matrix3<double> rotation_of(const Vector4<double>& quaternion) {
  const Vector4<double> q = quaternion.normalized();
  return Eigen::Quaterniond(q(0), q(1), q(2), q(3)).toRotationMatrix();
}

/// Quaternion (w, x, y, z) of a rotation vector [rad].
Vector4<double> quaternion_by(const Vector3<double>& turn) {
  const double angle = turn.stableNorm();
  const double half = 0.5 * angle;
  Vector4<double> q;
  q(0) = std::cos(half);
  q.tail<3>() = angle > 0.0 ? Vector3<double>(turn / angle * std::sin(half)) : Vector3<double>::Zero();
  return q;
}

Pose<double> random_pose(Random& random) {
  return {Vector3<double>(0.0, 0.0, -0.15) + random.matrix<3>(0.02), random.quaternion(0.5, 2.0)};
}

Situation random_situation(Random& random) {
  Situation s;
  s.task.camera = kFocal;
  s.task.jacobian_sign = random.uniform(-1.0, 1.0) < 0.0 ? -1.0 : 1.0;
  s.task.desired_features = random.matrix<8>(100.0);
  s.task.gravity_wrench = gravity_wrench(RigidBody<double>{});
  s.task.switching = {SwitchingKind::tanh, 1e-2};
  s.task.reference = random_pose(random);
  s.gains.kp = 1e-9 * (random.matrix<8>(0.5) + Vector<double, 8>::Ones());
  s.gains.kv = random.six(1e-3, 5e-5).cwiseAbs();
  s.gains.kt = random.six(6.0, 0.02).cwiseAbs();
  s.gains.kd = random.six(1.0, 3e-3).cwiseAbs();
  s.gains.drive = random.six(4.0, 4.0).cwiseAbs();
  s.gains.prior = random.six(5e3, 800.0) + linear_angular<double>(1e4, 1600.0);
  s.gains.fuzzy.adaptation = random.matrix<6>(4.0) + Vector6<double>::Constant(5.0);
  for (AxisVector<double>& w : s.weights) w = Vector6<double>(random.six(1e-2, 1e-3));
  s.input.image.features = random.matrix<8>(100.0);
  for (int i = 0; i < 4; ++i) s.input.image.depth(i) = random.uniform(-0.8, -0.3);
  s.input.pose = random_pose(random);
  s.input.R_BE = rotation_of(s.input.pose.quaternion);
  s.input.twist = random.six(0.02, 0.1);
  return s;
}

/// chi_ref - chi: positions, and Eigen's rotation vector of R_ref R^T.
Vector6<double> expected_by_prior(const Situation& s) {
  const Eigen::AngleAxisd turn(
      Matrix3<double>(rotation_of(s.task.reference.quaternion) * rotation_of(s.input.pose.quaternion).transpose()));
  Vector6<double> d;
  d << s.task.reference.position - s.input.pose.position, turn.angle() * turn.axis();
  return d;
}

/// Scenario `paper` with this law, and the gravity error that belongs to its mass error.
Settings gravity_settings() {
  const Settings paper = paper_settings();
  Settings settings = Settings::of<Composite>();
  settings.target = paper.target;
  settings.uncertainty = paper.uncertainty;
  settings.uncertainty.gravity.setConstant(0.075);
  return settings;
}

ControllerInput random_input(Random& random) {
  ControllerInput input;
  input.frame.exposure = 0.0;
  input.frame.image.features = random.matrix<8>(80.0);
  for (int i = 0; i < 4; ++i) input.frame.image.depth(i) = -random.uniform(0.3, 0.8);
  input.pose = {Vector3<double>(0.0, 0.0, -0.15) + random.matrix<3>(0.01), quaternion_by(random.matrix<3>(0.1))};
  input.twist = random.six(0.05, 0.2);
  return input;
}

}  // namespace

// ---- Rotation vectors -----------------------------------------------------------------------------------------------

TEST_CASE("rotation vector of a quaternion of any length and sign: Eigen's angle and axis, at most half a turn") {
  Random random(8801);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 1000; ++trial) {
    const Vector4<double> q = random.quaternion(0.1, 10.0);
    const Vector3<double> turn = rotation_vector(q);
    const Eigen::AngleAxisd eigen(rotation_of(q));
    CHECK(turn.norm() <= kPi + 4.0 * kEpsilon);
    // the axis of a matrix is known to eps/(pi - angle), that of a small turn to eps/angle: both lie in the product
    const double margin = std::min(eigen.angle(), kPi - eigen.angle());
    CHECK(distance(turn, eigen.angle() * eigen.axis()) <= 100.0 * kEpsilon / margin);
    CHECK(distance(rotation_vector<double>(-q), turn) == 0.0);
    CHECK(distance(rotation_vector<double>(0x1p+60 * q), turn) == 0.0);
  }
}

TEST_CASE("rotation vector: exact for tiny rotations and for those by 180 degrees, about any axis") {
  Random random(8802);
  CAPTURE(random.seed());
  CHECK(rotation_vector<double>({1.0, 0.0, 0.0, 0.0}) == Vector3<double>::Zero());
  CHECK(rotation_vector<double>({-2.0, 0.0, 0.0, 0.0}).cwiseAbs() == Vector3<double>::Zero());
  for (int trial = 0; trial < 100; ++trial) {
    const Vector3<double> axis = random.matrix<3>().normalized();
    for (const double angle : {1e-300, 1e-200, 1e-160, 1e-100, 1e-20, 1e-9, 0.9e-8, 1.1e-8, 2.2e-8, 1e-7, 1e-3, 0.1,
                               1.0, 3.0, kPi - 1e-3, kPi - 1e-8, kPi - 1e-14}) {
      CAPTURE(angle);
      const Vector3<double> turn = angle * axis;
      CHECK(relative_distance(rotation_vector(quaternion_by(turn)), turn) <= 8.0 * kEpsilon);
    }
    Vector4<double> half_turn;
    half_turn << 0.0, 3.0 * axis;
    CHECK(relative_distance(rotation_vector(half_turn), kPi * axis) <= 4.0 * kEpsilon);
  }
  CHECK(rotation_vector<double>(Vector4<double>::Zero()).hasNaN());
  for (int i = 0; i < 4; ++i) {
    Vector4<double> q = random.quaternion();
    q(i) = kNaN;
    CHECK(rotation_vector(q).hasNaN());
  }
}

TEST_CASE("a pose difference leads from one pose to the other, in B") {
  Random random(8803);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 200; ++trial) {
    const Pose<double> from = random_pose(random), to = random_pose(random);
    const Vector6<double> d = pose_difference(to, from);
    CHECK(d.head<3>() == to.position - from.position);
    const Matrix3<double> turned = rotation_of(quaternion_by(d.tail<3>())) * rotation_of(from.quaternion);
    CHECK(distance(turned, rotation_of(to.quaternion)) <= 20.0 * kEpsilon);
    CHECK(pose_difference(from, from).cwiseAbs().maxCoeff() <= 4.0 * kEpsilon);
  }
}

// ---- The pose error -------------------------------------------------------------------------------------------------

TEST_CASE("normal_matrix is the lower triangle of J^T J") {
  Random random(8804);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 100; ++trial) {
    const Situation s = random_situation(random);
    const Matrix6<double> normal = s.jacobian().normal_matrix();
    const Jacobian J = s.jacobian().matrix();
    CHECK(relative_distance(whole(normal), J.transpose() * J) <= 20.0 * kEpsilon);
  }
}

TEST_CASE(
    "e is the most probable pose error: the least squares of image and prior, by Eigen's QR of the stacked rows") {
  Random random(8805);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 200; ++trial) {
    CAPTURE(trial);
    const Situation s = random_situation(random);
    const Vector6<double> prior_error = expected_by_prior(s);
    const Vector6<double> e = most_probable_pose_error(s.jacobian(), s.feature_error(), s.gains.prior, prior_error);

    // min |J e - xi~|^2 + |sqrt(M) (e - d)|^2
    Eigen::Matrix<double, 14, 6> A;
    Vector<double, 14> b;
    const Vector6<double> weight = s.gains.prior.cwiseSqrt();
    A << s.jacobian().matrix(), Matrix6<double>(weight.asDiagonal());
    b << s.feature_error(), weight.cwiseProduct(prior_error);
    const Vector6<double> by_reflections = least_squares(A, b);
    // Normal equations square the condition, which the prior bounds: 5e6 px^2/m^2 over 5e3, and some reserve.
    CHECK(relative_distance(e, by_reflections) <= 1e5 * kEpsilon);
    const Matrix6<double> normal = A.transpose() * A;
    CHECK(relative_distance(e, solve_by_cholesky(normal, A.transpose() * b)) <= 1e5 * kEpsilon);
  }
}

TEST_CASE("limits of e: a prior of great weight alone decides, one of no weight leaves the image's least squares") {
  Random random(8806);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 50; ++trial) {
    const Situation s = random_situation(random);
    const Vector6<double> d = expected_by_prior(s);
    const Vector6<double> certain =
        most_probable_pose_error(s.jacobian(), s.feature_error(), Vector6<double>::Constant(1e20).eval(), d);
    CHECK(relative_distance(certain, d) <= 1e-10);  // 1e7 px^2/m^2 over 1e20, with features of 100 px
    const Vector6<double> free =
        most_probable_pose_error(s.jacobian(), s.feature_error(), Vector6<double>::Zero().eval(), d);
    const Vector6<double> pseudo_inverse = least_squares(s.jacobian().matrix(), s.feature_error());
    CHECK(relative_distance(free, pseudo_inverse) <= 1e-6);  // condition of J up to 1e4, squared
  }
}

TEST_CASE("e is not a number where J^T J + M is not positive definite") {
  Random random(8807);
  CAPTURE(random.seed());
  Situation s = random_situation(random);
  s.gains.prior.setZero();
  for (int i = 1; i < 4; ++i) s.input.image.features.segment<2>(2 * i) = s.input.image.features.head<2>();
  s.input.image.depth.setConstant(s.input.image.depth(0));  // four times the same point: rank 2
  const Composite::Evaluation<double> out = s.evaluate();
  for (int j = 0; j < 6; ++j) CHECK(std::isnan(out.wrench(j)));
  s.gains.prior.setConstant(1.0);
  CHECK_FALSE(s.evaluate().wrench.hasNaN());
}

TEST_CASE(
    "at the goal, which the prior expects, e changes as -chi-dot: what the second fuzzy input takes for its rate") {
  Random random(8808);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 50; ++trial) {
    const Pose<double> goal{Vector3<double>(0.0, 0.0, -0.15) + random.matrix<3>(0.02), random.quaternion()};
    Eigen::Matrix<double, 3, 4> points_B;
    for (int i = 0; i < 4; ++i)
      points_B.col(i) = goal.position + rotation_of(goal.quaternion) * Vector3<double>(random.uniform(-0.1, 0.1),
                                                                                       random.uniform(-0.1, 0.1),
                                                                                       random.uniform(-0.7, -0.4));
    const Vector<double, 8> features =
        take_image(kFocal, goal.position, rotation_of(goal.quaternion), points_B).features;
    const Vector6<double> twist = random.six(0.02, 0.1);
    const auto error_at = [&](double time) {
      const Vector3<double> turn = time * twist.tail<3>();
      const Eigen::Quaterniond q(Eigen::AngleAxisd(turn.norm(), turn.normalized()) *
                                 Eigen::Quaterniond(rotation_of(goal.quaternion)));
      const Pose<double> pose{goal.position + time * twist.head<3>(), {q.w(), q.x(), q.y(), q.z()}};
      const Matrix3<double> R_BE = rotation_of(pose.quaternion);
      const Image<double> image = take_image(kFocal, pose.position, R_BE, points_B);
      return most_probable_pose_error<double, 4>(ImageJacobian<double>(kFocal, -1.0, image, pose.position, R_BE),
                                                 features - image.features, linear_angular<double>(1e4, 1600.0),
                                                 pose_difference(goal, pose));
    };
    const double h = 1e-3;
    const Vector6<double> rate = (error_at(h) - error_at(-h)) / (2.0 * h);
    const Vector6<double> finer = (error_at(h / 2.0) - error_at(-h / 2.0)) / h;
    CHECK(relative_distance(rate, -twist) <= 1e-3);
    CHECK(distance(finer, -twist) <= 0.3 * distance(rate, -twist) + 1e-9);  // second order in h, to rounding
  }
}

// ---- The law --------------------------------------------------------------------------------------------------------

TEST_CASE(
    "tau = J^T K_p xi~ + K_t e - K_d chi-dot - K_v sw(chi-dot) + G - tau_f, with tau_f the 49-rule sum at u = a e, -b "
    "chi-dot, and Psi omega-dot = (chi-dot - Lambda e) phi-bar") {
  Random random(8809);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 100; ++trial) {
    CAPTURE(trial);
    const Situation s = random_situation(random);
    const Composite::Evaluation<double> out = s.evaluate();

    const Jacobian J = s.jacobian().matrix();
    const Matrix6<double> M = s.gains.prior.asDiagonal();
    const Vector6<double> e =
        solve_by_cholesky(J.transpose() * J + M, J.transpose() * s.feature_error() + M * expected_by_prior(s));
    Vector6<double> tau = J.transpose() * s.gains.kp.asDiagonal() * s.feature_error() + s.task.gravity_wrench;
    for (int j = 0; j < 6; ++j) {
      const double twist = s.input.twist(j);
      const double u = std::clamp(s.gains.fuzzy.error_scale(j) * e(j), -1.0, 1.0);
      const double u_rate = std::clamp(-s.gains.fuzzy.rate_scale(j) * twist, -1.0, 1.0);
      const auto mu = [](double x, int k) { return 1.0 / (1.0 + std::pow(6.0 * (x - (k - 3) / 3.0), 4)); };
      double weighted = 0.0, sum = 0.0;
      for (int row = 0; row < 7; ++row)
        for (int column = 0; column < 7; ++column) {
          const double strength = mu(u, row) * mu(u_rate, column);
          weighted += weight_matrix(s.weights, j)(row, column) * strength;
          sum += strength;
        }
      const double fuzzy = weighted / sum;
      CHECK(std::abs(out.fuzzy_output(j) - fuzzy) <= 1e-9 * (j < 3 ? 1e-2 : 1e-3));  // weights; e to 1e-10
      tau(j) += s.gains.kt(j) * e(j) - s.gains.kd(j) * twist - s.gains.kv(j) * std::tanh(twist / 1e-2) - fuzzy;

      const double driver = twist - s.gains.drive(j) * e(j);
      for (int row = 0; row < 7; ++row)
        for (int column = 0; column < 7; ++column) {
          const double rate = out.rate.strength(j) * out.rate.basis.error[static_cast<std::size_t>(row)](j) *
                              out.rate.basis.rate[static_cast<std::size_t>(column)](j);
          const double phi = mu(u, row) * mu(u_rate, column) / sum;
          CHECK(std::abs(s.gains.fuzzy.adaptation(j) * rate - driver * phi) <= 1e-9 * (std::abs(driver) + 1.0));
        }
    }
    CHECK(distance(out.wrench, tau) <= 1e-9);
    CHECK((s.gains.kt.asDiagonal() * e).cwiseAbs().maxCoeff() > 1e-4);
  }
}

TEST_CASE("at the goal, at home, at rest, with zero fuzzy weights the law holds the weight only, and adapts nothing") {
  Random random(8810);
  CAPTURE(random.seed());
  Situation s = random_situation(random);
  s.task.desired_features = s.input.image.features;
  s.task.reference = s.input.pose = {s.input.pose.position, {1.0, 0.0, 0.0, 0.0}};
  s.input.R_BE.setIdentity();
  s.input.twist.setZero();
  s.weights.fill(Vector6<double>(Vector6<double>::Zero()));
  const Composite::Evaluation<double> out = s.evaluate();
  CHECK(out.wrench == s.task.gravity_wrench);
  CHECK(out.rate.strength.vector().isZero(0.0));
}

TEST_CASE("the fuzzy systems of `composite` are off where they are switched off, and start at s_0 times the table") {
  Random random(8811);
  CAPTURE(random.seed());
  Situation s = random_situation(random);
  const Composite::Evaluation<double> with = s.evaluate();
  s.gains.fuzzy.enabled = false;
  const Composite::Evaluation<double> without = s.evaluate();
  CHECK(without.fuzzy_output.isZero(0.0));
  CHECK(distance(without.wrench, with.wrench + with.fuzzy_output) <= 1e-15);
  s.gains.fuzzy.initial_scale << 1, 2, 3, 4, 5, 6;
  const FuzzyWeights<double> weights = Composite::initial_state(s.gains);
  for (int j = 0; j < 6; ++j) CHECK(weight_matrix(weights, j) == (j + 1.0) * linear_rule_table());
}

TEST_CASE("NaN in any sensor value or gain of `composite` comes out as NaN, never as a plausible wrench") {
  Random random(8812);
  CAPTURE(random.seed());
  const std::vector<std::pair<std::string, std::function<void(Situation&)>>> places = {
      {"feature", [](Situation& s) { s.input.image.features(3) = kNaN; }},
      {"depth", [](Situation& s) { s.input.image.depth(2) = kNaN; }},
      {"attitude", [](Situation& s) { s.input.R_BE(1, 2) = kNaN; }},
      {"position", [](Situation& s) { s.input.pose.position(1) = kNaN; }},
      {"quaternion", [](Situation& s) { s.input.pose.quaternion(2) = kNaN; }},
      {"reference", [](Situation& s) { s.task.reference.position(0) = kNaN; }},
      {"twist", [](Situation& s) { s.input.twist(4) = kNaN; }},
      {"desired feature", [](Situation& s) { s.task.desired_features(7) = kNaN; }},
      {"weight", [](Situation& s) { s.weights[11].set(5, kNaN); }},
      {"kp", [](Situation& s) { s.gains.kp(0) = kNaN; }},
      {"kt", [](Situation& s) { s.gains.kt(1) = kNaN; }},
      {"kd", [](Situation& s) { s.gains.kd(5) = kNaN; }},
      {"kv", [](Situation& s) { s.gains.kv(1) = kNaN; }},
      {"prior", [](Situation& s) { s.gains.prior(4) = kNaN; }},
  };
  for (const auto& [place, spoil] : places) {
    CAPTURE(place);
    Situation s = random_situation(random);
    REQUIRE_FALSE(s.evaluate().wrench.hasNaN());
    spoil(s);
    CHECK(s.evaluate().wrench.hasNaN());
  }
}

TEST_CASE("a pack evaluates the law as double does, lane by lane, and a lane without a solution harms no other") {
  Random random(8813);
  CAPTURE(random.seed());
  using S = Lanes<4>;
  ControlTask<S> task;
  CompositeGains<S> gains;
  FuzzyWeights<S> weights;
  Sensed<S> input;
  std::array<Situation, 4> situations;
  for (int lane = 0; lane < 4; ++lane) {
    Situation& s = situations[static_cast<std::size_t>(lane)];
    s = random_situation(random);
    if (lane == 2) s.input.pose.quaternion = s.task.reference.quaternion;  // no turn
    if (lane == 3) {                                                       // no solution
      s.gains.prior.setZero();
      s.input.image.features.setZero();
    }
    set_lane(task.camera.focal, lane, s.task.camera.focal);
    set_lane(task.jacobian_sign, lane, s.task.jacobian_sign);
    set_lane(task.desired_features, lane, s.task.desired_features);
    set_lane(task.gravity_wrench, lane, s.task.gravity_wrench);
    set_lane(task.switching, lane, s.task.switching);
    set_lane(task.reference.position, lane, s.task.reference.position);
    set_lane(task.reference.quaternion, lane, s.task.reference.quaternion);
    set_lane(gains, lane, s.gains);
    for (std::size_t r = 0; r < weights.size(); ++r) put_lane(weights[r], lane, s.weights[r]);
    set_lane(input.image, lane, s.input.image);
    set_lane(input.R_BE, lane, s.input.R_BE);
    set_lane(input.twist, lane, s.input.twist);
    set_lane(input.pose.position, lane, s.input.pose.position);
    set_lane(input.pose.quaternion, lane, s.input.pose.quaternion);
  }
  const Composite::Evaluation<S> out = evaluate_law<Composite, S>(task, gains, weights, input);
  for (int lane = 0; lane < 3; ++lane) {
    CAPTURE(lane);
    const Composite::Evaluation<double> single = situations[static_cast<std::size_t>(lane)].evaluate();
    CHECK(relative_distance(lane_of(out.wrench, lane), single.wrench) <= 1e-11);
    CHECK(relative_distance(lane_of(out.fuzzy_output, lane), single.fuzzy_output) <= 1e-11);
    CHECK(relative_distance(lane_of(out.rate.strength, lane), single.rate.strength.vector()) <= 1e-11);
  }
  CHECK(lane_of(out.wrench, 3).hasNaN());
}

TEST_CASE("gains of `composite` that make no sense are refused, with the key and the place") {
  const auto verdict = [](const std::function<void(GainsOf<Composite>&)>& change) {
    GainsOf<Composite> gains;
    change(gains);
    return refusal([&] { validate_gains<Composite>(gains); });
  };
  using Gains = GainsOf<Composite>;
  CHECK(verdict([](Gains&) {}) == "(accepted)");
  CHECK(verdict([](Gains& g) {
          g.kp.setZero();
          for (auto* gain : {&g.kv, &g.kt, &g.kd, &g.drive, &g.prior}) gain->setZero();
        }) == "(accepted)");
  for (const double bad : {kNaN, kInfinity, -1e-6}) {
    CHECK(is_about(verdict([&](Gains& g) { g.kp(7) = bad; }), "controller.composite.kp[7]"));
    const std::array<std::pair<std::string, Vector6<double> Gains::*>, 5> gains = {{{"kv", &Gains::kv},
                                                                                    {"kt", &Gains::kt},
                                                                                    {"kd", &Gains::kd},
                                                                                    {"drive", &Gains::drive},
                                                                                    {"prior", &Gains::prior}}};
    for (const auto& [name, member] : gains)
      for (int j = 0; j < 6; ++j)
        CHECK(is_about(verdict([&, m = member](Gains& g) { (g.*m)(j) = bad; }),
                       "controller.composite." + name + "[" + std::to_string(j) + "]"));
  }
  CHECK(is_about(verdict([](Gains& g) { g.fuzzy.adaptation(3) = 0.0; }), "controller.composite.fuzzy.adaptation[3]"));
  CHECK(is_about(verdict([](Gains& g) { g.fuzzy.bell_width = 0.0; }), "controller.composite.fuzzy.bell_width"));
}

// ---- The servo tick -------------------------------------------------------------------------------------------------

TEST_CASE("a tick of `composite` is the law at its input, and allocates nothing, valid or not") {
  const ControllerGains<Composite> gains = controller_gains<Composite>(gravity_settings(), 1e-3);
  ControllerState<Composite> state = initial_state(gains);
  CHECK(gains.task.reference.position == Vector3<double>(0.0, 0.0, -0.15));
  CHECK(gains.task.reference.quaternion == Vector4<double>(1.0, 0.0, 0.0, 0.0));
  Random random(8814);
  CAPTURE(random.seed());
  std::array<ControllerInput, 64> inputs;
  for (ControllerInput& input : inputs) input = random_input(random);
  for (const ControllerInput& input : inputs) {
    Situation s;
    s.task = gains.task;
    s.weights = state.law;
    s.input = {input.frame.image, rotation_of(input.pose.quaternion), input.twist, input.pose};
    const Composite::Evaluation<double> law = s.evaluate();
    const ControllerOutput out = step(gains, state, input);
    REQUIRE_FALSE(out.invalid_input());
    CHECK(relative_distance(out.wrench, law.wrench) <= 1e-11);
    for (std::size_t row = 0; row < 7; ++row)
      for (std::size_t column = 0; column < 7; ++column) {
        const std::size_t r = rule(static_cast<int>(row), static_cast<int>(column));
        const Vector6<double> change =
            1e-3 * (law.rate.strength * law.rate.basis.error[row] * law.rate.basis.rate[column]).vector();
        REQUIRE(distance(state.law[r].vector(), s.weights[r].vector() + change) <= 1e-11);
      }
  }
  inputs[7].twist(2) = kNaN;
  inputs[11].pose.position(0) = kInfinity;
  const long long before = allocations;
  int invalid = 0;
  for (int round = 0; round < 1000; ++round)
    for (const ControllerInput& input : inputs) invalid += step(gains, state, input).invalid_input() ? 1 : 0;
  CHECK(allocations == before);
  CHECK(invalid == 2000);
}

TEST_CASE("NaN in any entry gives the safe output of `composite`, and changes nothing") {
  const ControllerGains<Composite> gains = controller_gains<Composite>(gravity_settings(), 1e-3);
  ControllerState<Composite> state = initial_state(gains);
  Random random(8815);
  CAPTURE(random.seed());
  const ControllerInput good = random_input(random);
  REQUIRE_FALSE(step(gains, state, good).invalid_input());
  const auto require_safe = [&](bool image, const std::function<double&(ControllerInput&)>& entry) {
    for (const double value : {kNaN, kInfinity, -kInfinity}) {
      ControllerInput bad = good;
      entry(bad) = value;
      ControllerState<Composite> after = image ? initial_state(gains) : state;
      const FuzzyWeights<double> before = after.law;
      const ControllerOutput out = step(gains, after, bad);
      REQUIRE(out.invalid_input());
      const Vector6<double> brake = (image ? 1.0 : 0.0) * brake_of(gains, good);
      REQUIRE(distance(out.wrench, gravity_wrench(RigidBody<double>{}) - brake) <= 1e-15);
      REQUIRE(out.fuzzy_output.isZero(0.0));
      REQUIRE(is_finite(out.leg_forces));
      for (std::size_t r = 0; r < before.size(); ++r) REQUIRE(distance(after.law[r], before[r]) == 0.0);
    }
  };
  for (int i = 0; i < 8; ++i)
    require_safe(true, [i](ControllerInput& in) -> double& { return in.frame.image.features(i); });
  for (int i = 0; i < 4; ++i)
    require_safe(true, [i](ControllerInput& in) -> double& { return in.frame.image.depth(i); });
  for (int i = 0; i < 3; ++i) require_safe(false, [i](ControllerInput& in) -> double& { return in.pose.position(i); });
  for (int i = 0; i < 4; ++i)
    require_safe(false, [i](ControllerInput& in) -> double& { return in.pose.quaternion(i); });
  for (int i = 0; i < 6; ++i) require_safe(false, [i](ControllerInput& in) -> double& { return in.twist(i); });
}

// ---- The loop -------------------------------------------------------------------------------------------------------

namespace {

/// The law without its prior's expectation: M stays in the inverse, M (chi_ref - chi) is zero.
struct WithoutExpectation : Composite {
  template <class S, int N>
  static void evaluate(const ControlTask<S, N>& task, const Constants<S, N>& constants, const Stage<S>& weights,
                       const LawInput<S, N>& input, Evaluation<S>& out) noexcept {
    const LawInput<S, N> at_reference{input.features, input.inverse_depth, input.R_BE, input.twist, task.reference};
    Composite::evaluate(task, constants, weights, at_reference, out);
  }
};

/// First time at which a leg is beyond its stroke [s], or infinity.
template <class Law>
double stroke_reached(const LoopParameters<double, Composite>& parameters, double duration) {
  LoopParameters<double, Law> p;
  LoopParameters<double, Law>::visit([](const Field&, auto& to, const auto& from) { to = from; }, p, parameters);
  ClosedLoop<double, Law> loop(p);
  while (loop.record().running() && loop.time() < duration) {
    loop.advance();
    if ((loop.record().sample().leg_lengths - p.hexapod.home_lengths).cwiseAbs().maxCoeff() > p.hexapod.stroke)
      return loop.time();
  }
  REQUIRE(loop.record().running());
  return kInfinity;
}

}  // namespace

TEST_CASE(
    "what the prior is for: without its expectation, depth errors of 5 % (+,-,-,+) drift to the end of the stroke") {
  Settings settings = gravity_settings();
  settings.uncertainty.depth << 0.05, -0.05, -0.05, 0.05;
  const LoopParameters<double, Composite> p = loop_parameters<Composite>(settings);
  CHECK(stroke_reached<WithoutExpectation>(p, 10.0) == doctest::Approx(5.9).epsilon(0.01));  // as printed, 5.9 s
  CHECK(stroke_reached<Composite>(p, 10.0) == kInfinity);
}

TEST_CASE("the drift's cause: eigenvalues of (J-hat^T J-hat)^-1 J-hat^T J below zero, which the prior lifts above it") {
  const LoopParameters<double, Composite> p = loop_parameters<Composite>(gravity_settings());
  const Matrix6<double> M = p.gains.prior.asDiagonal();
  const double f = p.camera.focal;
  const Vector3<double> p_BE = Vector3<double>::Zero();
  const Matrix3<double> R_BE = Matrix3<double>::Identity();
  const auto smallest = [](const Matrix6<double>& A, const Matrix6<double>& B) {
    return smallest_real_part(solve_by_cholesky(A, B));
  };
  // where the run starts, and the goal reached by translation
  for (const bool at_goal : {false, true}) {
    CAPTURE(at_goal);
    const Image<double> image{at_goal ? p.desired_features : p.initial_image.features, p.initial_image.depth};
    const Jacobian J = ImageJacobian<double>(f, -1.0, image, p_BE, R_BE).matrix();
    for (const double size : {0.05, 0.3}) {
      CAPTURE(size);
      int negative = 0;
      double worst = kInfinity;
      for (int pattern = 1; pattern < 15; ++pattern) {  // 0 and 15 have one sign
        Vector<double, 4> error;
        for (int i = 0; i < 4; ++i) error(i) = (pattern >> i & 1) == 1 ? -size : size;
        const Image<double> measured = measured_image(image, error);
        const Jacobian known = ImageJacobian<double>(f, -1.0, measured, p_BE, R_BE).matrix();
        negative += smallest(known.transpose() * known, known.transpose() * J) < 0.0 ? 1 : 0;
        worst = std::min(worst, smallest(known.transpose() * known + M, known.transpose() * J + M));
      }
      CHECK(negative == (at_goal ? 13 : 11));
      CHECK(worst > 0.0);
      if (size == 0.3 && !at_goal) CHECK(worst == doctest::Approx(0.0055).epsilon(0.01));
    }
  }
}

TEST_CASE("four scenarios in the lanes of a pack run in the loop of `composite` as they do alone") {
  using S = Lanes<4>;
  LoopParameters<S, Composite> pack;
  std::array<LoopParameters<double, Composite>, 4> single;
  for (int lane = 0; lane < 4; ++lane) {
    Settings settings = gravity_settings();
    settings.controller.switching.kind = SwitchingKind::tanh;
    settings.uncertainty.depth.setConstant(0.3 - 0.2 * lane);
    settings.gains<Composite>().prior *= 1.0 + lane;
    single[static_cast<std::size_t>(lane)] = loop_parameters<Composite>(settings);
    set_lane(pack, lane, single[static_cast<std::size_t>(lane)]);
  }
  ClosedLoop<S, Composite> lanes(pack);
  for (int i = 0; i < 300; ++i) lanes.advance();
  for (int lane = 0; lane < 4; ++lane) {
    CAPTURE(lane);
    ClosedLoop<double, Composite> loop(single[static_cast<std::size_t>(lane)]);
    for (int i = 0; i < 300; ++i) loop.advance();
    CHECK(distance(lane_of(lanes.record().sample().feature_error, lane), loop.record().sample().feature_error) <= 1e-8);
    CHECK(distance(lane_of(lanes.record().sample().position, lane), loop.record().sample().position) <= 1e-12);
    CHECK(distance(lane_of(lanes.record().sample().fuzzy_output, lane), loop.record().sample().fuzzy_output) <= 1e-10);
  }
}

TEST_CASE("options of the weights in the loop: bounded by their limit, decaying by leakage, unchanged in a dead zone") {
  const auto largest_weight = [](const Settings& settings, int axis) {
    const LoopParameters<double, Composite> p = loop_parameters<Composite>(settings);
    ClosedLoop<double, Composite> loop(p);
    while (loop.record().running() && loop.time() < 2.0) loop.advance();
    REQUIRE(loop.record().running());
    return weight_matrix(loop.law_state(), axis).cwiseAbs().maxCoeff();
  };
  const Settings settings = gravity_settings();  // the vertical system carries the missing weight
  const double free = largest_weight(settings, 2);
  CHECK(free > 0.02);
  Settings limited = settings;
  limited.gains<Composite>().fuzzy.weight_limit(2) = 0.01;
  CHECK(largest_weight(limited, 2) == 0.01);
  Settings leaking = settings;
  leaking.gains<Composite>().fuzzy.leakage(2) = 20.0;
  CHECK(largest_weight(leaking, 2) < 0.7 * free);
  Settings deaf = settings;
  deaf.gains<Composite>().fuzzy.dead_zone.setConstant(10.0);
  CHECK(largest_weight(deaf, 2) == 0.0);
  Settings too_fast = settings;
  too_fast.gains<Composite>().fuzzy.leakage(0) = 1001.0;
  CHECK(is_about(refusal([&] { loop_parameters<Composite>(too_fast); }), "controller.composite.fuzzy.leakage"));
  CHECK(is_about(refusal([&] { controller_gains<Composite>(leaking, 0.1); }), "controller.composite.fuzzy.leakage"));
}

TEST_CASE("with leakage the loop keeps its fourth order") {
  Settings settings = gravity_settings();
  settings.controller.switching = {SwitchingKind::tanh, 0.05};  // wide: smooth at these steps
  settings.gains<Composite>().fuzzy.leakage << 1.0, 2.0, 5.0, 1.0, 2.0, 5.0;
  const auto end = [&](double step) {
    settings.simulation.step = step;
    const LoopParameters<double, Composite> p = loop_parameters<Composite>(settings);
    ClosedLoop<double, Composite> loop(p);
    const long long steps = std::llround(0.2 / step);
    for (long long i = 0; i < steps; ++i) loop.advance();
    return loop.record().sample().feature_error;
  };
  const Vector<double, 8> reference = end(6.25e-5);
  const double coarse = distance(end(1e-3), reference), fine = distance(end(5e-4), reference);
  CAPTURE(coarse);
  CAPTURE(fine);
  CHECK(std::log2(coarse / fine) == doctest::Approx(4.0).epsilon(0.08));
}
