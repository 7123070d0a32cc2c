#include "hexservo/hexapod.hpp"

#include "walk.hpp"

#include <Eigen/SVD>

namespace hexservo {

using detail::refuse;
using detail::words;

namespace {

constexpr double kSingularRatio = 1e-9;  // sigma_min/sigma_max of H below which a geometry cannot hold a platform

/// A few poses around home without symmetry: a geometry that is singular at all of them is singular everywhere.
std::array<Pose<double>, 3> generic_poses(const Hexapod<double>& hexapod) {
  const double r = 0.1 * hexapod.platform_radius;
  const auto near_home = [&](const Vector3<double>& shift, const Vector3<double>& turn) {
    return moved(home_pose(hexapod), (Vector6<double>() << r * shift, turn).finished());
  };
  return {near_home({0.31, -0.53, 0.71}, {0.14, -0.22, 0.26}), near_home({-0.67, 0.23, 0.41}, {-0.26, 0.10, -0.34}),
          near_home({0.47, 0.59, -0.37}, {0.06, 0.18, -0.10})};
}

double condition(const Hexapod<double>& hexapod, const Pose<double>& pose) {
  const Vector6<double> sigma = wrench_map_singular_values(hexapod, pose);
  return sigma(5) / sigma(0);
}

Matrix36<double> joints(double radius, const Vector6<double>& angles) {
  Matrix36<double> points;
  for (int i = 0; i < 6; ++i) points.col(i) = radius * Vector3<double>(std::cos(angles(i)), std::sin(angles(i)), 0.0);
  return points;
}

/// Joints where a user has placed them, or on their circle.
Matrix36<double> placed(const std::optional<Joints>& points, double radius, const Vector6<double>& angles) {
  return points ? Matrix36<double>(points->transpose()) : joints(radius, angles);
}

/// RMS distance of points from their mean.
double spread(const Matrix36<double>& points) {
  return std::sqrt((points.colwise() - points.rowwise().mean()).squaredNorm() / 6.0);
}

/// Key that a user has placed the platform's joints with.
std::string joints_key(const RobotParameters& robot) {
  return robot.platform_joints ? "robot.platform_joints" : "robot.platform_angles";
}

void require_distinct_legs(const Hexapod<double>& hexapod, const RobotParameters& robot) {
  const double base_radius = robot.base_joints ? spread(hexapod.base_joints_B) : robot.base_radius;
  for (int i = 0; i < 6; ++i) {
    if (!(hexapod.home_lengths(i) > 1e-9 * hexapod.platform_radius))
      refuse("robot.home_position", "legs of some length at home",
             words("a length of ", hexapod.home_lengths(i), " m for leg ", i + 1));
    for (int k = 0; k < i; ++k) {
      const double platform = (hexapod.platform_joints_E.col(i) - hexapod.platform_joints_E.col(k)).norm();
      const double base = (hexapod.base_joints_B.col(i) - hexapod.base_joints_B.col(k)).norm();
      if (platform < 1e-9 * hexapod.platform_radius && base < 1e-9 * base_radius)
        refuse(joints_key(robot), "six different legs", words("legs ", k + 1, " and ", i + 1, " that coincide"));
    }
  }
}

}  // namespace

RobotParameters robot_preset(std::string_view name) {
  if (name == "micro") return {};
  if (name == "cubic") {
    RobotParameters robot;
    robot.platform_radius = robot.base_radius = 0.1;
    robot.base_angles = degrees(0, 0, 120, 120, 240, 240);
    robot.platform_angles = degrees(-60, 60, 60, 180, 180, 300);
    robot.home_position = {0.0, 0.0, -robot.platform_radius / std::sqrt(2.0)};
    return robot;
  }
  std::string known;
  for (const std::string_view preset : kRobotPresets) known += words(known.empty() ? "" : ", ", preset);
  refuse("robot.preset", words("one of ", known), words('"', name, '"'));
}

Hexapod<double> make_hexapod(const RobotParameters& robot) {
  detail::require_bounds("robot", robot);

  Hexapod<double> hexapod;
  hexapod.platform_joints_E = placed(robot.platform_joints, robot.platform_radius, robot.platform_angles);
  hexapod.base_joints_B = placed(robot.base_joints, robot.base_radius, robot.base_angles);
  hexapod.platform_radius = robot.platform_joints ? spread(hexapod.platform_joints_E) : robot.platform_radius;
  if (!(hexapod.platform_radius > 0.0))
    refuse("robot.platform_joints", "joints at different places", "six at the same one");
  const Pose<double> home = moved({robot.home_position, Pose<double>{}.quaternion},
                                  (Vector6<double>() << 0.0, 0.0, 0.0, robot.home_attitude).finished());
  hexapod.home_position = home.position;
  hexapod.home_quaternion = home.quaternion;
  hexapod.stroke = robot.stroke;
  hexapod.force_limit = robot.force_limit;
  hexapod.speed_limit = robot.speed_limit;
  for (int side = 0; side < 2; ++side)
    hexapod.joint_chords(side) =
        robot.joint_limit ? 2.0 * std::sin(0.5 * (*robot.joint_limit)(side)) : std::numeric_limits<double>::infinity();
  const Matrix3<double> home_R_BE = rotation_matrix<double>(home.quaternion);
  const Legs<double> home_legs = inverse_kinematics<double>(hexapod, home.position, home_R_BE);
  hexapod.home_lengths = home_legs.lengths;
  hexapod.home_directions_B = home_legs.directions_B;
  hexapod.home_directions_E = home_R_BE.transpose() * home_legs.directions_B;
  hexapod.mid_lengths = hexapod.home_lengths.array() + robot.stroke_centre;
  require_distinct_legs(hexapod, robot);
  if (!(std::abs(robot.stroke_centre) <= robot.stroke))
    refuse("robot.stroke_centre", words("a middle of the travel within the stroke of ", robot.stroke, " m from home"),
           words(robot.stroke_centre, " m"));

  double best = 0.0;
  for (const Pose<double>& pose : generic_poses(hexapod)) best = std::max(best, condition(hexapod, pose));
  if (!(best >= kSingularRatio))
    refuse(joints_key(robot),
           "legs that hold the platform in all six directions (regular hexagons joined in cyclic order, or a platform "
           "similar to its "
           "base, never do)",
           words("a wrench map that is singular at every pose (smallest/largest singular value ", best, ")"));
  const double at_home = condition(hexapod, home);
  if (!(at_home >= kSingularRatio))
    refuse("robot.home_position", "a home pose that is not singular",
           words("a wrench map with smallest/largest singular value ", at_home));
  return hexapod;
}

Vector6<double> wrench_map_singular_values(const Hexapod<double>& hexapod, const Pose<double>& pose) {
  Matrix6<double> H = inverse_kinematics(hexapod, pose.position, rotation_matrix(pose.quaternion)).wrench_map();
  H.bottomRows<3>() /= hexapod.platform_radius;
  return Eigen::JacobiSVD<Matrix6<double>>(H).singularValues();
}

}  // namespace hexservo
