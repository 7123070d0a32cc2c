// Where the law `tracking` sends its reference: ahead of what was seen, and with the camera's ray at a place.
#include "hexservo/target_tracking.hpp"

#include "compare.hpp"
#include "random.hpp"

#include <Eigen/Geometry>

using namespace hexservo;
using namespace hexservo::test;

namespace {

Matrix3<double> turn_of(const Vector3<double>& rotation) {
  return Eigen::AngleAxisd(rotation.norm(), rotation.normalized()).toRotationMatrix();
}

}  // namespace

TEST_CASE(
    "a pose is predicted over the age of its frame, the latency found, half of its jitter and the delay of legs") {
  Random random(8001);
  CAPTURE(random.seed());
  constexpr double kPeriod = 0.01;
  TrackingPlan<double> plan;
  plan.delay = 2.0;
  plan.jitter = 0.03;
  plan.poses = 1;
  plan.home = {Vector3<double>(0.0, 0.0, -0.15), {1.0, 0.0, 0.0, 0.0}};
  TrackingState<double> state(plan, std::pmr::get_default_resource());
  state.latency_range = {0.08, 0.06, 0.1};
  state.target.seen_at = 10.0;
  state.target.followed = {random.matrix<3>(0.1), random.quaternion()};
  state.target.followed_twist = random.six(0.1, 0.05);
  const Vector6<double> twist = state.target.followed_twist;
  struct Case {
    double now;  ///< [ticks]
    bool known;
    double ahead;  ///< [s]
    bool moves;
  };
  for (const Case& c : {Case{15.0, true, 0.07 + 0.08 + 0.015, true}, Case{98.0, true, 0.995, true},
                        Case{99.0, true, 1.0, false}, Case{500.0, true, 1.0, false}, Case{15.0, false, 0.0, true}}) {
    CAPTURE(c.now);
    state.target.known = c.known;
    Pose<double> pose;
    Vector6<double> rate;
    pose_ahead(plan, state, c.now, kPeriod, pose, rate);
    CHECK(distance(pose.position, state.target.followed.position + c.ahead * twist.head<3>()) <= 1e-14);
    const Matrix3<double> start = rotation_matrix(state.target.followed.quaternion);
    CHECK(distance(rotation_matrix(pose.quaternion), turn_of((c.ahead + 1e-300) * twist.tail<3>()) * start) <=
          1e-7);  // to fourth order
    CHECK(distance(rate, c.moves ? twist : Vector6<double>(Vector6<double>::Zero())) == 0.0);
  }
}

TEST_CASE("a camera on an arm is pointed at a place by the turn that does not roll it about its ray") {
  Random random(8002);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 100; ++trial) {
    CAPTURE(trial);
    TrackingPlan<double> plan;
    plan.home = {random.matrix<3>(0.2), random.quaternion()};
    plan.home_centre = plan.home.position + random.matrix<3>(0.2);
    plan.home_ray = random.matrix<3>(1.0).normalized();
    const Vector3<double> place = plan.home_centre + 1.5 * (plan.home_ray + random.matrix<3>(0.4));
    const Pose<double> pose = pointing(plan, place);
    CHECK(distance(pose.position, plan.home.position) == 0.0);
    const Eigen::AngleAxisd turn(
        Matrix3<double>(rotation_matrix(pose.quaternion) * rotation_matrix(plan.home.quaternion).transpose()));
    const Vector3<double> centre = plan.home.position + turn * Vector3<double>(plan.home_centre - plan.home.position);
    const Vector3<double> ray = turn * plan.home_ray, way = place - centre;
    CHECK(distance(ray, way.normalized()) <= 1e-12);
    CHECK(std::abs(turn.axis().dot(plan.home_ray)) <= 1e-9);
    // A place nearer than any point of the ray.
    const Vector3<double> arm = plan.home_centre - plan.home.position,
                          off = arm - arm.dot(plan.home_ray) * plan.home_ray;
    const Pose<double> past =
        pointing(plan, Vector3<double>(plan.home.position + 0.5 * off.norm() * random.rotation().col(0)));
    CHECK(past.quaternion.norm() == doctest::Approx(1.0).epsilon(1e-12));
  }
}
