// What the controller believes of the target (docs/model.md, section 5): the pose that four features tell, and the
// goal.
#include "hexservo/target_model.hpp"

#include "compare.hpp"
#include "random.hpp"

#include <array>
#include <cmath>
#include <numbers>
#include <string>

using namespace hexservo;
using namespace hexservo::test;

namespace {

using Points = Eigen::Matrix<double, 3, 4>;
using Features = Vector<double, 8>;

constexpr double kFocal = 581.816;
const Pose<double> kHome{Vector3<double>(0.0, 0.0, -0.15), {1.0, 0.0, 0.0, 0.0}};

/// R of a quaternion by Eigen.
Matrix3<double> rotation_of(const Vector4<double>& quaternion) {
  const Vector4<double> q = quaternion.normalized();
  return Eigen::Quaterniond(q(0), q(1), q(2), q(3)).toRotationMatrix();
}

/// A pose turned by a rotation vector in B and moved.
Pose<double> displaced(const Pose<double>& pose, const Vector3<double>& move, const Vector3<double>& turn) {
  const Eigen::Quaterniond q(Eigen::AngleAxisd(turn.norm(), turn.stableNormalized()) *
                             Eigen::Quaterniond(rotation_of(pose.quaternion)));
  return {pose.position + move, {q.w(), q.x(), q.y(), q.z()}};
}

/// (4) written out for points in B, with no help of the core.
Features seen_from(const Pose<double>& pose, const Points& points_B) {
  Features features;
  for (int i = 0; i < 4; ++i) {
    const Vector3<double> p_E = rotation_of(pose.quaternion).transpose() * (points_B.col(i) - pose.position);
    features.segment<2>(2 * i) = -kFocal * p_E.head<2>() / p_E(2);
  }
  return features;
}

/// Four points spread like a square, each off its corner and its plane.
Points random_points(Random& random) {
  Points points;
  for (int i = 0; i < 4; ++i) {
    const double x = i < 2 ? 0.08 : -0.08, y = i % 2 == 0 ? 0.08 : -0.08;
    points.col(i) = kHome.position + Vector3<double>(x, y, -0.5) + random.matrix<3>(0.04);
  }
  return points;
}

/// Largest displacement from one pose to another [m; rad], by Eigen.
double far_from(const Pose<double>& a, const Pose<double>& b) {
  const Eigen::AngleAxisd turn(Matrix3<double>(rotation_of(a.quaternion) * rotation_of(b.quaternion).transpose()));
  return std::max((a.position - b.position).cwiseAbs().maxCoeff(), std::abs(turn.angle()));
}

}  // namespace

TEST_CASE("the pose estimator finds a known pose to 1e-9, from sensors that are 5 mm and 3 degrees off") {
  Random random(9101);
  CAPTURE(random.seed());
  double worst = 0.0;
  for (int trial = 0; trial < 2000; ++trial) {
    CAPTURE(trial);
    const Points points = random_points(random);
    const Pose<double> truth = displaced(kHome, random.matrix<3>(0.03), random.matrix<3>(0.2));
    Pose<double> start = displaced(truth, random.matrix<3>(0.005), random.matrix<3>(0.05));
    start.quaternion *= random.uniform(0.5, 2.0);  // its length has no meaning
    const PoseEstimate<double> found = estimate_pose<double, 4>(kFocal, points, seen_from(truth, points), start);
    REQUIRE_FALSE(found.failed);
    const double error = far_from(found.pose, truth);
    worst = std::max(worst, error);
    REQUIRE(error <= 1e-9);
    REQUIRE(std::abs(found.pose.quaternion.norm() - 1.0) <= 4.0 * kEpsilon);
  }
  CHECK(worst > 0.0);
}

TEST_CASE("also that of the paper's target, whose image hardly shows lateral from angular motion") {
  Random random(9102);
  CAPTURE(random.seed());
  Image<double> image;
  image.features << 30, 18, 65, -65, -44, 37, -10, -15;
  image.depth.setConstant(-0.5);
  const Points points = believed_points<double, 4>(kFocal, kHome, image, Vector4<double>::Zero());
  CHECK(distance(seen_from(kHome, points), image.features) <= 1e-12);
  for (int trial = 0; trial < 500; ++trial) {
    CAPTURE(trial);
    const Pose<double> truth = displaced(kHome, random.matrix<3>(0.015), random.matrix<3>(0.05));
    const Pose<double> start = displaced(truth, random.matrix<3>(0.002), random.matrix<3>(0.005));
    const PoseEstimate<double> found = estimate_pose<double, 4>(kFocal, points, seen_from(truth, points), start);
    REQUIRE_FALSE(found.failed);
    REQUIRE(far_from(found.pose, truth) <= 1e-9);
  }
}

TEST_CASE("where no pose explains the image, the estimate is stationary: J^T r = 0 by central differences") {
  Random random(9103);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 50; ++trial) {
    CAPTURE(trial);
    const Points points = random_points(random);
    const Pose<double> truth = displaced(kHome, random.matrix<3>(0.02), random.matrix<3>(0.1));
    const Features measured = seen_from(truth, points) + random.matrix<8>(1.0);
    const PoseEstimate<double> found = estimate_pose<double, 4>(kFocal, points, measured, truth, 30);
    REQUIRE_FALSE(found.failed);
    CHECK(found.step <= 1e-12);
    const Features residual = measured - seen_from(found.pose, points);
    REQUIRE(residual.norm() > 0.1);
    for (int j = 0; j < 6; ++j) {
      const double h = 1e-5;
      Vector6<double> d = Vector6<double>::Zero();
      d(j) = h;
      const Features column = (seen_from(displaced(found.pose, d.head<3>(), d.tail<3>()), points) -
                               seen_from(displaced(found.pose, -d.head<3>(), -d.tail<3>()), points)) /
                              (2.0 * h);
      CHECK(std::abs(column.dot(residual)) <= 1e-7 * column.norm() * residual.norm());  // h^2, and rounding over h
    }
  }
}

TEST_CASE("a step is limited, and what cannot be solved is marked") {
  Random random(9104);
  CAPTURE(random.seed());
  Points points = random_points(random);
  const Features good = seen_from(kHome, points);
  const PoseEstimate<double> far = estimate_pose<double, 4>(kFocal, points, 100.0 * good, kHome, 1);
  CHECK(far.step <= 0.5 * 1.01);  // mean depth of 0.5 m, or rad
  CHECK(far_from(far.pose, kHome) > 0.0);

  Features nothing = good;
  nothing(3) = kNaN;
  const PoseEstimate<double> lost = estimate_pose<double, 4>(kFocal, points, nothing, kHome);
  CHECK(lost.failed);

  points.col(1) = points.col(0);
  points.col(2) = points.col(0);
  points.col(3) = points.col(0);
  CHECK(estimate_pose<double, 4>(kFocal, points, seen_from(kHome, points), kHome).failed);  // rank 2

  points = random_points(random);
  points.row(2).array() += 1.0;  // behind the camera
  CHECK(estimate_pose<double, 4>(kFocal, points, good, kHome).failed);
}

TEST_CASE("a pack estimates as double does, lane by lane, and a lane without an estimate harms no other") {
  Random random(9105);
  CAPTURE(random.seed());
  using S = Lanes<4>;
  for (int trial = 0; trial < 50; ++trial) {
    Eigen::Matrix<S, 3, 4> points;
    Vector<S, 8> features;
    Pose<S> start;
    std::array<PoseEstimate<double>, 4> single;
    for (int lane = 0; lane < 4; ++lane) {
      Points own = random_points(random);
      const Pose<double> truth = displaced(kHome, random.matrix<3>(0.02), random.matrix<3>(0.1));
      const Features seen = seen_from(truth, own);
      const Pose<double> from = displaced(truth, random.matrix<3>(0.005), random.matrix<3>(0.05));
      if (lane == 2) own.setZero();
      set_lane(points, lane, own);
      set_lane(features, lane, seen);
      set_lane(start.position, lane, from.position);
      set_lane(start.quaternion, lane, from.quaternion);
      single[static_cast<std::size_t>(lane)] = estimate_pose<double, 4>(kFocal, own, seen, from);
    }
    const PoseEstimate<S> pack = estimate_pose<S, 4>(S(kFocal), points, features, start);
    for (const int lane : {0, 1, 3}) {
      CAPTURE(lane);
      const PoseEstimate<double>& expected = single[static_cast<std::size_t>(lane)];
      CHECK_FALSE(pack.failed[lane]);
      CHECK(relative_distance(lane_of(pack.pose.position, lane), expected.pose.position) <= 1e-12);
      CHECK(relative_distance(lane_of(pack.pose.quaternion, lane), expected.pose.quaternion) <= 1e-12);
    }
    CHECK(pack.failed[2]);
  }
}

TEST_CASE("the goal is where the believed points give the desired features: a shift, near and half turns") {
  Image<double> image;
  image.features << 30, 18, 65, -65, -44, 37, -10, -15;
  image.depth.setConstant(-0.5);
  Features desired;
  desired << 10, 10, 45, -73, -64, 29, -30, -23;
  const Points points = believed_points<double, 4>(kFocal, kHome, image, Vector4<double>::Constant(0.3));
  // every feature moves by (-20, -8) px at 0.65 m: a translation, by hand
  const Pose<double> shifted = goal_pose(kFocal, points, desired, kHome);
  CHECK(far_from(shifted, displaced(kHome, Vector3<double>(20.0, 8.0, 0.0) * 0.65 / kFocal, Vector3<double>::Zero())) <=
        1e-9);
  const TargetModel<double> model = target_model<double, 4>(kFocal, points, shifted);
  CHECK(distance(model.goal_inverse_depth, Vector4<double>::Constant(-1.0 / 0.65)) <= 1e-9);

  Random random(9106);
  CAPTURE(random.seed());
  for (const double turn : {0.1, 1.0, 2.0, 3.0, std::numbers::pi, -1.5, -3.1})
    for (int trial = 0; trial < 10; ++trial) {
      CAPTURE(turn);
      const Points others = random_points(random);
      const Pose<double> goal = displaced(displaced(kHome, Vector3<double>::Zero(), Vector3<double>(0.0, 0.0, turn)),
                                          random.matrix<3>(0.02), random.matrix<3>(0.05));
      const Pose<double> found = goal_pose(kFocal, others, seen_from(goal, others), kHome);
      CHECK(distance(seen_from(found, others), seen_from(goal, others)) <= 1e-6);
      CHECK(far_from(found, goal) <= 1e-6);
    }
}

TEST_CASE("a goal that no search settles on is refused in words") {
  Points points = Points::Zero();
  for (int i = 0; i < 4; ++i) points.col(i) = Vector3<double>(0.01 * i, 0.02 * i, -0.65);  // on one line
  const Features desired = seen_from(displaced(kHome, {0.01, 0.0, 0.0}, Vector3<double>::Zero()), points);
  CHECK(is_about(refusal([&] { goal_pose(kFocal, points, desired, kHome); }), "target.desired_features"));
}
