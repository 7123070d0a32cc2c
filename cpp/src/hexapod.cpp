#include "hexservo/hexapod.hpp"

#include "spectra.hpp"
#include "walk.hpp"

namespace hexservo {

using detail::refuse;
using detail::words;

namespace {

constexpr double kUnit = 1e-6;  // what a unit vector's length, or a right angle's cosine, may be off

/// A few poses around home without symmetry: a geometry that is singular at all of them is singular everywhere.
std::array<Pose<double>, 3> generic_poses(const Hexapod<double>& hexapod) {
  constexpr double kSmall = 0.1;  // cranks that close at home nearly always close there
  const double r = 0.1 * hexapod.platform_radius;
  const auto near_home = [&](const Vector3<double>& shift, const Vector3<double>& turn) {
    return moved(home_pose(hexapod), (Vector6<double>() << kSmall * r * shift, kSmall * turn).finished());
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
    if (!hexapod.rotary && !(hexapod.home_lengths(i) > 1e-9 * hexapod.platform_radius))
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

/// Legs that hold the platform at home.
void require_hold(const Hexapod<double>& hexapod, const RobotParameters& robot) {
  const double at_home = condition(hexapod, home_pose(hexapod));
  if (at_home >= kLeastSingularRatio) return;
  double best = at_home;
  for (const Pose<double>& pose : generic_poses(hexapod)) best = std::max(best, condition(hexapod, pose));
  std::ostringstream ratio;
  ratio.precision(2);
  ratio << "(smallest/largest singular value " << at_home << ")";
  const std::string order = "the joints of platform and base in the order of the legs, both counted the same way round";
  if (best >= kLeastSingularRatio)
    refuse("robot.home_position", words("a home pose that is not singular, and ", order),
           words("a wrench map that is singular at home ", ratio.str()));
  refuse(joints_key(robot),
         words("legs that hold the platform in all six directions: ", order,
               " (regular hexagons joined in cyclic order, or a platform similar to its base, never hold)"),
         words("a wrench map that is singular at home and around it ", ratio.str()));
}

/// Unit vectors of a user, exactly of length 1.
Matrix36<double> unit_vectors(const std::string& key, const std::optional<Joints>& rows) {
  if (!rows) refuse(key, "six unit vectors for rotary legs", "null");
  Matrix36<double> columns = rows->transpose();
  for (int i = 0; i < 6; ++i) {
    const double length = columns.col(i).norm();
    if (!(std::abs(length - 1.0) <= kUnit))
      refuse(words(key, "[", i, "]"), "a unit vector", words("one of length ", length));
    columns.col(i) /= length;
  }
  return columns;
}

/// Cranks as a user describes them; their angles count from `zero` until those of home are known.
Cranks<double> described_cranks(const RobotParameters& robot) {
  const CrankParameters& given = robot.cranks;
  if (!(given.length > 0.0)) refuse("robot.cranks.length", "a number > 0 for rotary legs", "null");
  if (!(given.rod > 0.0)) refuse("robot.cranks.rod", "a number > 0 for rotary legs", "null");
  Cranks<double> cranks{given.length,
                        given.rod,
                        unit_vectors("robot.cranks.axes", given.axes),
                        unit_vectors("robot.cranks.zero", given.zero),
                        Vector6<double>::Ones(),
                        Vector6<double>::Zero()};
  if (!given.branch) refuse("robot.cranks.branch", "six numbers, each 1 or -1, for rotary legs", "null");
  cranks.branch = *given.branch;
  for (int i = 0; i < 6; ++i) {
    if (std::abs(cranks.branch(i)) != 1.0)
      refuse(words("robot.cranks.branch[", i, "]"), "1 or -1", words(cranks.branch(i)));
    const double along = cranks.axes_B.col(i).dot(cranks.home_B.col(i));
    if (!(std::abs(along) <= kUnit))
      refuse(words("robot.cranks.zero[", i, "]"), words("a vector at right angles to robot.cranks.axes[", i, "]"),
             words("one with the scalar product ", along));
    cranks.home_B.col(i) = (cranks.home_B.col(i) - along * cranks.axes_B.col(i)).normalized();
  }
  return cranks;
}

/// Counts the angles of cranks from home; `hexapod` has its joints and cranks with angles from `zero`.
void count_from_home(Hexapod<double>& hexapod, const Pose<double>& home) {
  const Matrix3<double> R_BE = rotation_matrix(home.quaternion);
  Cranks<double>& cranks = hexapod.cranks;
  const Vector6<double> angles = inverse_kinematics<double>(hexapod, home.position, R_BE).lengths;
  for (int i = 0; i < 6; ++i) {
    if (!std::isfinite(angles(i))) {
      const double distance =
          (home.position + R_BE * hexapod.platform_joints_E.col(i) - hexapod.base_joints_B.col(i)).norm();
      refuse("robot.cranks", "cranks and rods that close at home, and are not in line there",
             words("a crank of ", cranks.length, " m and a rod of ", cranks.rod, " m for leg ", i + 1,
                   ", whose platform joint is ", distance, " m from the crank's centre"));
    }
    const Vector3<double> zero = cranks.home_B.col(i);
    cranks.home_B.col(i) = std::cos(angles(i)) * zero + std::sin(angles(i)) * cranks.axes_B.col(i).cross(zero);
  }
  cranks.home_angles = angles;
}

/// Cranks of legs that have some, and no others.
void place_cranks(const RobotParameters& robot, Hexapod<double>& hexapod, const Pose<double>& home) {
  hexapod.rotary = robot.legs == LegKind::rotary;
  const CrankParameters& given = robot.cranks;
  if (hexapod.rotary) {
    hexapod.cranks = described_cranks(robot);
    count_from_home(hexapod, home);
    if (!(robot.stroke + std::abs(robot.stroke_centre) <= EIGEN_PI))
      refuse("robot.stroke", "angles within pi of home [rad] for rotary legs",
             words(robot.stroke + std::abs(robot.stroke_centre)));
    return;
  }
  if (given.length != 0.0 || given.rod != 0.0 || given.axes || given.zero || given.branch)
    refuse("robot.cranks", "null for prismatic legs, or robot.legs: rotary", "cranks");
  hexapod.cranks = {
      0.0, 0.0, Matrix36<double>::Zero(), Matrix36<double>::Zero(), Vector6<double>::Zero(), Vector6<double>::Zero()};
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
  place_cranks(robot, hexapod, home);
  const Matrix3<double> home_R_BE = rotation_matrix<double>(home.quaternion);
  const Legs<double> home_legs = inverse_kinematics<double>(hexapod, home.position, home_R_BE);
  hexapod.home_lengths = home_legs.lengths;
  hexapod.home_directions_B = home_legs.directions_B;
  if (hexapod.rotary)
    for (int i = 0; i < 6; ++i)
      hexapod.home_directions_B.col(i) = rod_direction<double>(home_legs.directions_B.col(i), hexapod.cranks.branch(i));
  hexapod.home_directions_E = home_R_BE.transpose() * hexapod.home_directions_B;
  hexapod.mid_lengths = hexapod.home_lengths.array() + robot.stroke_centre;
  require_distinct_legs(hexapod, robot);
  if (!(std::abs(robot.stroke_centre) <= robot.stroke))
    refuse("robot.stroke_centre", words("a middle of the travel within the stroke of ", robot.stroke, " m from home"),
           words(robot.stroke_centre, " m"));

  require_hold(hexapod, robot);
  return hexapod;
}

Vector6<double> wrench_map_singular_values(const Hexapod<double>& hexapod, const Pose<double>& pose) {
  Legs<double> legs = inverse_kinematics(hexapod, pose.position, rotation_matrix(pose.quaternion));
  if (hexapod.rotary) legs.directions_B.colwise().normalize();  // their signs leave singular values as they are
  Matrix6<double> H = legs.wrench_map();
  if (!H.allFinite()) return Vector6<double>::Zero();  // a crank that does not close
  H.bottomRows<3>() /= hexapod.platform_radius;
  return detail::singular_values(H);
}

Vector6<double> lever_arms(const Hexapod<double>& hexapod, const Pose<double>& pose) {
  if (!hexapod.rotary) return Vector6<double>::Ones();
  const Legs<double> legs = inverse_kinematics(hexapod, pose.position, rotation_matrix(pose.quaternion));
  return -hexapod.cranks.branch.cwiseQuotient(legs.directions_B.colwise().norm().transpose());
}

Matrix36<double> leg_feet(const Hexapod<double>& hexapod, const Pose<double>& pose) {
  if (!hexapod.rotary) return hexapod.base_joints_B;
  const Legs<double> legs = inverse_kinematics(hexapod, pose.position, rotation_matrix(pose.quaternion));
  Matrix36<double> feet;
  for (int i = 0; i < 6; ++i)
    feet.col(i) = pose.position + legs.arms_B.col(i) -
                  hexapod.cranks.rod * rod_direction<double>(legs.directions_B.col(i), hexapod.cranks.branch(i));
  return feet;
}

}  // namespace hexservo
