// Leg geometry, kinematics both ways, wrench map, limits of what is accepted.
#include "hexservo/hexapod.hpp"
#include "hexservo/perception.hpp"

#include "compare.hpp"
#include "decompositions.hpp"
#include "random.hpp"

#include <functional>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

constexpr double kDegree = 3.14159265358979323846 / 180.0;

Legs<double> legs_at(const Hexapod<double>& hexapod, const Pose<double>& pose) {
  return inverse_kinematics<double>(hexapod, pose.position, rotation_matrix(pose.quaternion));
}

Pose<double> home_of(const Hexapod<double>& hexapod) { return {hexapod.home_position, Pose<double>{}.quaternion}; }

/// A pose that every leg reaches within its stroke.
Pose<double> pose_within_stroke(const Hexapod<double>& hexapod, Random& random) {
  for (;;) {
    const Vector3<double> turn = random.matrix<3>(0.25);
    const Eigen::Quaterniond q(Eigen::AngleAxisd(turn.norm(), turn.normalized()));
    const Pose<double> pose{hexapod.home_position + random.matrix<3>(0.025), {q.w(), q.x(), q.y(), q.z()}};
    if (distance(legs_at(hexapod, pose).lengths, hexapod.home_lengths) <= hexapod.stroke) return pose;
  }
}

/// Angle of the rotation from one attitude to another [rad], accurate for small ones.
double angle_between(const Pose<double>& a, const Pose<double>& b) {
  const Matrix3<double> R = rotation_matrix(a.quaternion).transpose() * rotation_matrix(b.quaternion);
  return (R - Matrix3<double>::Identity()).norm() / std::sqrt(2.0);
}

void for_each_preset(const std::function<void(const RobotParameters&, const Hexapod<double>&)>& check) {
  for (const std::string_view name : kRobotPresets) {
    CAPTURE(std::string(name));
    const RobotParameters robot = robot_preset(name);
    check(robot, make_hexapod(robot));
  }
}

}  // namespace

TEST_CASE("leg vectors are s = x_p + R p - b, with joints on circles") {
  Random random(7401);
  CAPTURE(random.seed());
  for_each_preset([&](const RobotParameters& robot, const Hexapod<double>& hexapod) {
    const Pose<double> pose = pose_within_stroke(hexapod, random);
    const Matrix3<double> R_BE = rotation_matrix(pose.quaternion);
    const Legs<double> legs = legs_at(hexapod, pose);
    for (int i = 0; i < 6; ++i) {
      CAPTURE(i);
      const Vector3<double> p(robot.platform_radius * std::cos(robot.platform_angles(i)),
                              robot.platform_radius * std::sin(robot.platform_angles(i)), 0.0);
      const Vector3<double> b(robot.base_radius * std::cos(robot.base_angles(i)),
                              robot.base_radius * std::sin(robot.base_angles(i)), 0.0);
      const Vector3<double> s = pose.position + R_BE * p - b;
      CHECK(distance(legs.directions_B.col(i) * legs.lengths(i), s) <= 10.0 * kEpsilon);
      CHECK(legs.directions_B.col(i).norm() == doctest::Approx(1.0).epsilon(4.0 * kEpsilon));
      CHECK(legs.lengths(i) > 0.0);
      CHECK(distance(legs.arms_B.col(i), R_BE * p) <= 10.0 * kEpsilon);
    }
    CHECK(distance(legs_at(hexapod, home_of(hexapod)).lengths, hexapod.home_lengths) == 0.0);
  });
}

TEST_CASE("leg rates are H^T chi-dot: central differences of the lengths at random poses") {
  Random random(7402);
  CAPTURE(random.seed());
  for_each_preset([&](const RobotParameters&, const Hexapod<double>& hexapod) {
    for (int trial = 0; trial < 200; ++trial) {
      CAPTURE(trial);
      const Pose<double> pose = pose_within_stroke(hexapod, random);
      const Vector6<double> twist = random.six(0.1, 1.0);
      const Matrix3<double> R_BE = rotation_matrix(pose.quaternion);
      const auto lengths_at = [&](double time) {
        const Vector3<double> turn = twist.tail<3>() * time;
        const Matrix3<double> R = Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix() * R_BE;
        return Vector6<double>(inverse_kinematics<double>(hexapod, pose.position + twist.head<3>() * time, R).lengths);
      };
      // Joints move at about 0.3 m/s on legs of 0.1 m: third derivatives stay below 30 m/s^3, so h = 3e-5 s is off by
      // h^2/6 30 = 5e-9 m/s at the very most, and by eps 0.2 m/h = 1e-12 m/s of rounding.
      const double h = 3e-5;
      const Vector6<double> difference = (lengths_at(h) - lengths_at(-h)) / (2.0 * h);
      const Legs<double> legs = legs_at(hexapod, pose);
      CHECK(relative_distance(difference, legs.rates(twist)) <= 1e-7);
      CHECK(relative_distance(legs.wrench_map().transpose() * twist, legs.rates(twist)) <= 10.0 * kEpsilon);
    }
  });
}

TEST_CASE("power is the same at both ends: wrench . twist = forces . rates; leg forces invert the wrench map") {
  Random random(7403);
  CAPTURE(random.seed());
  for_each_preset([&](const RobotParameters&, const Hexapod<double>& hexapod) {
    for (int trial = 0; trial < 200; ++trial) {
      CAPTURE(trial);
      const Legs<double> legs = legs_at(hexapod, pose_within_stroke(hexapod, random));
      const Vector6<double> forces = random.matrix<6>(), twist = random.six(1.0, 10.0);
      const double power = forces.cwiseAbs().dot(legs.rates(twist).cwiseAbs());
      CHECK(std::abs(legs.wrench(forces).dot(twist) - forces.dot(legs.rates(twist))) <= 50.0 * kEpsilon * power);
      CHECK(distance(legs.wrench_map() * forces, legs.wrench(forces)) <= 10.0 * kEpsilon);

      const WrenchMapSolver<double> solver(hexapod, legs);
      REQUIRE_FALSE(solver.failed());
      // H H^T has a condition number of about (1.9/0.7)^2 < 10 here
      CHECK(distance(solver.leg_forces(legs.wrench(forces)), forces) <= 1000.0 * kEpsilon);
      const Vector6<double> wrench = random.six(1.0, 0.1);
      CHECK(distance(legs.wrench(solver.leg_forces(wrench)), wrench) <= 1000.0 * kEpsilon);
      const Vector6<double> changes = random.matrix<6>(1e-3);
      CHECK(distance(legs.rates(solver.displacement(changes)), changes) <= 1000.0 * kEpsilon * 1e-3);
    }
  });
}

TEST_CASE("moments are taken about E's origin: forces along one leg push at its joint") {
  Random random(7404);
  CAPTURE(random.seed());
  for_each_preset([&](const RobotParameters&, const Hexapod<double>& hexapod) {
    const Legs<double> legs = legs_at(hexapod, pose_within_stroke(hexapod, random));
    for (int i = 0; i < 6; ++i) {
      const Vector6<double> wrench = legs.wrench(Vector6<double>::Unit(i));
      CHECK(distance(wrench.head<3>(), legs.directions_B.col(i)) == 0.0);
      const Vector3<double> arm = legs.arms_B.col(i), force = legs.directions_B.col(i);
      CHECK(distance(wrench.tail<3>(), arm.cross(force)) <= kEpsilon);
    }
  });
}

TEST_CASE("forward after inverse kinematics: every pose within the stroke is found again from home") {
  Random random(7405);
  CAPTURE(random.seed());
  for_each_preset([&](const RobotParameters&, const Hexapod<double>& hexapod) {
    for (int trial = 0; trial < 500; ++trial) {
      CAPTURE(trial);
      const Pose<double> pose = pose_within_stroke(hexapod, random);
      const ForwardKinematics<double> found =
          forward_kinematics(hexapod, legs_at(hexapod, pose).lengths, home_of(hexapod));
      CHECK(status(found) == KinematicsStatus::converged);
      CHECK(found.residual <= kKinematicsTolerance);
      // A residual of 1e-12 m in each of six legs is at most sqrt(6) 1e-12/sigma_min of pose, sigma_min > 0.5 here.
      CHECK(distance(found.pose.position, pose.position) <= 5e-12);
      CHECK(angle_between(found.pose, pose) <= 5e-12 / hexapod.platform_radius);
      CHECK(found.pose.quaternion.norm() == doctest::Approx(1.0).epsilon(4.0 * kEpsilon));
    }
  });
}

TEST_CASE("inverse after forward kinematics: all leg lengths within the stroke belong to a pose") {
  Random random(7406);
  CAPTURE(random.seed());
  for_each_preset([&](const RobotParameters&, const Hexapod<double>& hexapod) {
    for (int trial = 0; trial < 500; ++trial) {
      CAPTURE(trial);
      Vector6<double> lengths = hexapod.home_lengths + random.matrix<6>(hexapod.stroke);
      if (trial < 64)  // all corners of the workspace first
        for (int i = 0; i < 6; ++i)
          lengths(i) = hexapod.home_lengths(i) + ((trial >> i) % 2 == 0 ? 1.0 : -1.0) * hexapod.stroke;
      const ForwardKinematics<double> found = forward_kinematics(hexapod, lengths, home_of(hexapod));
      CHECK(status(found) == KinematicsStatus::converged);
      CHECK(distance(legs_at(hexapod, found.pose).lengths, lengths) <= kKinematicsTolerance);
      CHECK(found.residual == distance(legs_at(hexapod, found.pose).lengths, lengths));
    }
  });
}

TEST_CASE("forward kinematics accepts a start quaternion of any length") {
  const Hexapod<double> hexapod = make_hexapod(robot_preset("micro"));
  Pose<double> start = home_of(hexapod);
  start.quaternion *= 17.0;
  const ForwardKinematics<double> found = forward_kinematics(hexapod, hexapod.home_lengths, start);
  CHECK(status(found) == KinematicsStatus::converged);
  CHECK(distance(found.pose.position, hexapod.home_position) <= 5e-12);
}

TEST_CASE("forward kinematics reports where it finds no pose") {
  const Hexapod<double> hexapod = make_hexapod(robot_preset("micro"));
  const Pose<double> home = home_of(hexapod);

  Vector6<double> impossible = hexapod.home_lengths;
  impossible(0) += 1.0;  // neighbouring joints are 35 mm apart: no pose has such lengths
  CHECK(status(forward_kinematics(hexapod, impossible, home)) != KinematicsStatus::converged);
  Vector6<double> stretched = hexapod.home_lengths;
  stretched(0) += 0.1;
  const ForwardKinematics<double> far = forward_kinematics(hexapod, stretched, home);
  CHECK(status(far) != KinematicsStatus::converged);
  CHECK(far.residual > kKinematicsTolerance);

  const Vector6<double> negative = -hexapod.home_lengths;
  CHECK(status(forward_kinematics(hexapod, negative, home)) != KinematicsStatus::converged);

  for (const double bad : {kNaN, kInfinity}) {
    Vector6<double> lengths = hexapod.home_lengths;
    lengths(3) = bad;
    const ForwardKinematics<double> result = forward_kinematics(hexapod, lengths, home);
    CHECK(status(result) != KinematicsStatus::converged);
    CHECK_FALSE(result.residual <= kKinematicsTolerance);
  }

  // A platform that lies in the plane of its base: legs without any vertical part.
  const Pose<double> flat{Vector3<double>(0.01, 0.0, 0.0), home.quaternion};
  const ForwardKinematics<double> stuck = forward_kinematics(hexapod, hexapod.home_lengths, flat);
  CHECK(status(stuck) == KinematicsStatus::singular);
  CHECK(distance(stuck.pose.position, flat.position) == 0.0);  // the last pose before the singular one
}

TEST_CASE("both failures of forward kinematics occur and are distinguished") {
  // Random lengths that contradict each other: Newton wanders, and never reports a pose that does not fit.
  Random random(7407);
  CAPTURE(random.seed());
  const Hexapod<double> hexapod = make_hexapod(robot_preset("micro"));
  int converged = 0, wandering = 0;
  for (int trial = 0; trial < 300; ++trial) {
    CAPTURE(trial);
    const Vector6<double> lengths = hexapod.home_lengths + random.matrix<6>(0.15);
    const ForwardKinematics<double> result = forward_kinematics(hexapod, lengths, home_of(hexapod));
    if (status(result) == KinematicsStatus::converged) {
      ++converged;
      CHECK(distance(legs_at(hexapod, result.pose).lengths, lengths) <= kKinematicsTolerance);
    } else {
      if (status(result) == KinematicsStatus::not_converged) ++wandering;
      CHECK((result.singular || result.residual > kKinematicsTolerance));
    }
  }
  CHECK(converged > 0);
  CHECK(wandering > 0);
}

TEST_CASE("a pack of poses goes through both kinematics as single ones do, whatever a neighbour does") {
  Random random(7408);
  CAPTURE(random.seed());
  using S = Lanes<4>;
  const Hexapod<double> hexapod = make_hexapod(robot_preset("micro"));
  Hexapod<S> pack;
  Vector6<S> lengths;
  Pose<S> start;
  std::array<Vector6<double>, 4> lengths_of;
  std::array<Pose<double>, 4> start_of;
  for (int lane = 0; lane < 4; ++lane) {
    const auto i = static_cast<std::size_t>(lane);
    set_lane(pack, lane, hexapod);
    start_of[i] = home_of(hexapod);
    if (lane == 1) start_of[i].position = Vector3<double>(0.01, 0.0, 0.0);  // singular
    lengths_of[i] = legs_at(hexapod, pose_within_stroke(hexapod, random)).lengths;
    if (lane == 2) lengths_of[i](0) += 1.0;  // no pose
    set_lane(lengths, lane, lengths_of[i]);
    set_lane(start.position, lane, start_of[i].position);
    set_lane(start.quaternion, lane, start_of[i].quaternion);
  }
  const ForwardKinematics<S> found = forward_kinematics(pack, lengths, start);
  for (int lane = 0; lane < 4; ++lane) {
    CAPTURE(lane);
    const auto i = static_cast<std::size_t>(lane);
    const ForwardKinematics<double> single = forward_kinematics(hexapod, lengths_of[i], start_of[i]);
    CHECK(found.converged[lane] == single.converged);
    CHECK(found.converged[lane] == (lane == 0 || lane == 3));
    CHECK((found.singular[lane] && lane == 1) == (lane == 1));
    if (single.converged) {
      CHECK(distance(lane_of(found.pose.position, lane), single.pose.position) <= 5e-12);
      CHECK(distance(lane_of(found.pose.quaternion, lane), single.pose.quaternion) <= 5e-11);
    }
    Vector6<S> same_lengths;
    Pose<S> same_start;
    for (int other = 0; other < 4; ++other) {
      set_lane(same_lengths, other, lengths_of[i]);
      set_lane(same_start.position, other, start_of[i].position);
      set_lane(same_start.quaternion, other, start_of[i].quaternion);
    }
    const ForwardKinematics<S> alike = forward_kinematics(pack, same_lengths, same_start);  // ends when this lane does
    CHECK(lane_of(alike.pose.position, 0) == lane_of(found.pose.position, lane));
    CHECK(lane_of(alike.pose.quaternion, 0) == lane_of(found.pose.quaternion, lane));
  }
}

TEST_CASE("the last Newton step is the one whose square is below rounding: two find a pose from close by") {
  Random random(7409);
  CAPTURE(random.seed());
  for (const std::string_view preset : kRobotPresets) {
    CAPTURE(preset);
    const Hexapod<double> hexapod = make_hexapod(robot_preset(preset));
    for (int trial = 0; trial < 100; ++trial) {
      const Pose<double> pose = pose_within_stroke(hexapod, random);
      const Vector6<double> lengths = legs_at(hexapod, pose).lengths;
      const Pose<double> start = stepped(pose, random.six(1e-5 * hexapod.platform_radius, 1e-5));
      const ForwardKinematics<double> twice = forward_kinematics(LegGeometry<double>(hexapod), lengths, start, 2);
      const ForwardKinematics<double> all = forward_kinematics(hexapod, lengths, start);
      CHECK(twice.converged);
      CHECK(all.pose.position == twice.pose.position);
      CHECK(all.pose.quaternion == twice.pose.quaternion);
    }
  }
}

TEST_CASE("curvature is the second order of the leg lengths: what it leaves falls by eight where the step is halved") {
  Random random(7412);
  CAPTURE(random.seed());
  for_each_preset([&](const RobotParameters&, const Hexapod<double>& hexapod) {
    const LegGeometry<double> geometry(hexapod);
    for (int trial = 0; trial < 50; ++trial) {
      const Pose<double> pose = pose_within_stroke(hexapod, random);
      const LegsSideBySide<double> legs = legs_at(hexapod, pose).side_by_side();
      const Vector6<double> d = random.six(0.02 * hexapod.platform_radius, 0.02);
      const auto left = [&](const Vector6<double>& step) {
        const Legs<double> there = legs_at(hexapod, stepped(pose, step));
        const Legs<double> here = Legs<double>::of(legs);
        return (there.lengths - here.lengths - here.rates(step) - curvature(legs, step).vector()).norm();
      };
      const double whole = left(d), half = left(0.5 * d);
      CHECK(whole <= 0.2 * curvature(legs, d).vector().norm());  // a joint's way over a leg is 0.06 at most
      CHECK(whole / half == doctest::Approx(8.0).epsilon(0.25));
    }
  });
}

TEST_CASE("a pose close by is found with the solver of the one before, to rounding, and not where it is not close by") {
  Random random(7413);
  CAPTURE(random.seed());
  for_each_preset([&](const RobotParameters&, const Hexapod<double>& hexapod) {
    const LegGeometry<double> geometry(hexapod);
    for (const double size : {0.0, 1e-9, 1e-7, 1e-5, 5e-5, 1e-3, 0.1}) {
      CAPTURE(size);
      for (int trial = 0; trial < 100; ++trial) {
        const Pose<double> start = pose_within_stroke(hexapod, random);
        // The turn counts half, and a size is that of the larger part: between one and sqrt(3) times `size`.
        Vector6<double> d = random.six(size * hexapod.platform_radius, 0.5 * size);
        d(0) = size * hexapod.platform_radius;
        const Pose<double> pose = stepped(start, d);
        const SolvedLegs<double> there(geometry, start);
        ForwardKinematics<double> found;
        const bool is_found = pose_close_by(geometry, legs_at(hexapod, pose).lengths, start, there, found);
        CHECK(is_found == (size < kCloseBy));
        if (!is_found) continue;
        CHECK(found.converged);
        CHECK(found.residual <= kRoundingOfLengths);
        // A residual of 1e-14 m in each leg, over sigma_min > 0.5, and the rounding of lengths of 0.2 m.
        CHECK(distance(found.pose.position, pose.position) <= 1e-13);
        CHECK(angle_between(found.pose, pose) <= 1e-13 / hexapod.platform_radius);
        CHECK(distance(Legs<double>::of(found.legs).lengths, legs_at(hexapod, found.pose).lengths) <=
              kRoundingOfLengths);
      }
    }
    const Pose<double> home = home_of(hexapod);
    const SolvedLegs<double> there(geometry, home);
    ForwardKinematics<double> found;
    for (const double bad : {kNaN, kInfinity}) {
      Vector6<double> lengths = hexapod.home_lengths;
      lengths(2) = bad;
      CHECK_FALSE(pose_close_by(geometry, lengths, home, there, found));
    }
  });
  const Hexapod<double> micro = make_hexapod(robot_preset("micro"));
  const Pose<double> flat{Vector3<double>(0.01, 0.0, 0.0), Pose<double>{}.quaternion};
  const SolvedLegs<double> singular(LegGeometry<double>(micro), flat);
  ForwardKinematics<double> found;
  CHECK_FALSE(pose_close_by(LegGeometry<double>(micro), legs_at(micro, flat).lengths, flat, singular, found));
}

TEST_CASE("lanes of readings close by and far away are tracked as if they were alone") {
  Random random(7414);
  CAPTURE(random.seed());
  using S = Lanes<4>;
  const Hexapod<double> hexapod = make_hexapod(robot_preset("micro"));
  Hexapod<S> pack;
  for (int lane = 0; lane < 4; ++lane) set_lane(pack, lane, hexapod);
  const LegGeometry<S> geometry(pack);
  for (int trial = 0; trial < 50; ++trial) {
    const std::array<double, 4> sizes = {1e-8, 1e-2, 3e-5, 0.0};
    std::array<Vector6<S>, 5> lengths, twist;  // all lanes, and each one alone
    std::array<Pose<S>, 5> start;
    for (int lane = 0; lane < 4; ++lane) {
      const Pose<double> from = pose_within_stroke(hexapod, random);
      const Vector6<double> d = random.six(sizes[static_cast<std::size_t>(lane)] * hexapod.platform_radius,
                                           sizes[static_cast<std::size_t>(lane)]);
      const Vector6<double> there = legs_at(hexapod, stepped(from, d)).lengths;
      const Vector6<double> rate = 1e3 * d + random.six(1e-3, 1e-2);
      const auto put = [&](std::size_t set, int place) {
        set_lane(lengths[set], place, there);
        set_lane(twist[set], place, rate);
        set_lane(start[set].position, place, from.position);
        set_lane(start[set].quaternion, place, from.quaternion);
      };
      put(4, lane);
      for (int place = 0; place < 4; ++place) put(static_cast<std::size_t>(lane), place);
    }
    const auto track = [&](std::size_t set) {
      ForwardKinematics<S> found;
      track_pose(geometry, lengths[set], start[set], twist[set], SolvedLegs<S>(geometry, start[set]), S(1e-3), S(4.0),
                 found);
      return found;
    };
    const ForwardKinematics<S> together = track(4);
    for (int lane = 0; lane < 4; ++lane) {
      CAPTURE(lane);
      const ForwardKinematics<S> alone = track(static_cast<std::size_t>(lane));
      CHECK(together.converged[lane]);
      CHECK(lane_of(together.pose.position, lane) == lane_of(alone.pose.position, 0));
      CHECK(lane_of(together.pose.quaternion, lane) == lane_of(alone.pose.quaternion, 0));
      CHECK(lane_of(together.legs.lengths.vector(), lane) == lane_of(alone.legs.lengths.vector(), 0));
    }
  }
}

TEST_CASE("known numbers of the presets (docs/model.md, section 2)") {
  const auto forces_at_rest = [](const RobotParameters& robot, const Hexapod<double>& hexapod) {
    const RigidBody<double> body{robot.mass, robot.inertia};
    return WrenchMapSolver<double>(hexapod, legs_at(hexapod, home_of(hexapod))).leg_forces(gravity_wrench(body));
  };
  struct Known {
    std::string preset;
    double length, force, largest, smallest;
  };
  for (const Known& known :
       {Known{"micro", 0.204593, 0.1337, 1.7959, 0.9576}, Known{"cubic", 0.122474, 0.1697, 1.7321, 0.7962}}) {
    CAPTURE(known.preset);
    const RobotParameters robot = robot_preset(known.preset);
    const Hexapod<double> hexapod = make_hexapod(robot);
    const Vector6<double> forces = forces_at_rest(robot, hexapod),
                          sigma = wrench_map_singular_values(hexapod, home_of(hexapod));
    // half a unit of the last printed digit
    CHECK(distance(hexapod.home_lengths, Vector6<double>::Constant(known.length)) <= 0.5e-6);
    CHECK(distance(forces, Vector6<double>::Constant(known.force)) <= 0.5e-4);
    CHECK(std::abs(sigma(0) - known.largest) <= 0.5e-4);
    CHECK(std::abs(sigma(5) - known.smallest) <= 0.5e-4);
    CHECK(hexapod.stroke == 0.017);
    CHECK(hexapod.force_limit == 1.0);
  }
}

TEST_CASE("singular values of the wrench map are the roots of the eigenvalues of H H^T, with moments divided by r_p") {
  Random random(7409);
  CAPTURE(random.seed());
  for_each_preset([&](const RobotParameters&, const Hexapod<double>& hexapod) {
    for (int trial = 0; trial < 20; ++trial) {
      const Pose<double> pose = pose_within_stroke(hexapod, random);
      Matrix6<double> H = legs_at(hexapod, pose).wrench_map();
      H.bottomRows<3>() /= hexapod.platform_radius;
      const Vector6<double> expected = symmetric_eigenvalues(H * H.transpose()).reverse().cwiseSqrt();
      CHECK(distance(wrench_map_singular_values(hexapod, pose), expected) <= 100.0 * kEpsilon);
    }
  });
}

TEST_CASE("neighbouring legs of the cubic preset are orthogonal at home") {
  const Hexapod<double> hexapod = make_hexapod(robot_preset("cubic"));
  const Legs<double> legs = legs_at(hexapod, home_of(hexapod));
  for (int i = 0; i < 6; ++i) {
    CAPTURE(i);
    CHECK(std::abs(legs.directions_B.col(i).dot(legs.directions_B.col((i + 1) % 6))) <= 10.0 * kEpsilon);
  }
}

// --- what is refused
// --------------------------------------------------------------------------------------------------

namespace {

std::string verdict(const std::function<void(RobotParameters&)>& change) {
  RobotParameters robot;
  change(robot);
  return refusal([&] { make_hexapod(robot); });
}

}  // namespace

TEST_CASE("the presets are accepted, other names are refused with the known ones") {
  for_each_preset([](const RobotParameters&, const Hexapod<double>&) {});
  const std::string message = refusal([] { robot_preset("stewart"); });
  CHECK(is_about(message, "robot.preset"));
  CHECK(message.find("micro") != std::string::npos);
  CHECK(message.find("cubic") != std::string::npos);
  CHECK(message.find("stewart") != std::string::npos);
}

TEST_CASE("geometries that cannot hold a platform are refused") {
  struct Case {
    std::string what, key;
    std::function<void(RobotParameters&)> change;
  };
  const auto hexagon = degrees(0, 60, 120, 180, 240, 300);
  const std::vector<Case> cases = {
      {"regular hexagons in cyclic order", "robot.platform_angles",
       [&](RobotParameters& r) { r.platform_angles = r.base_angles = hexagon; }},
      {"regular hexagons in cyclic order, turned against each other", "robot.platform_angles",
       [&](RobotParameters& r) {
         r.base_angles = hexagon;
         r.platform_angles = hexagon + Vector6<double>::Constant(23.0 * kDegree);
       }},
      {"platform similar to its base", "robot.platform_angles",
       [](RobotParameters& r) { r.platform_angles = r.base_angles; }},
      {"platform similar to its base, turned", "robot.platform_angles",
       [](RobotParameters& r) { r.platform_angles = r.base_angles + Vector6<double>::Constant(30.0 * kDegree); }},
      {"legs that coincide", "robot.platform_angles",
       [](RobotParameters& r) {
         r.platform_angles(1) = r.platform_angles(0);
         r.base_angles(1) = r.base_angles(0);
       }},
      {"legs that coincide after a full turn", "robot.platform_angles",
       [](RobotParameters& r) {
         r.platform_angles(3) = r.platform_angles(2) + 360.0 * kDegree;
         r.base_angles(3) = r.base_angles(2) - 360.0 * kDegree;
       }},
      {"all legs at one platform joint", "robot.platform_angles",
       [](RobotParameters& r) { r.platform_angles.setConstant(0.3); }},
      {"platform joints in reverse order, typed to 0.1 mm", "robot.home_position",
       [](RobotParameters& r) {
         Joints reversed;
         for (int leg = 0; leg < 6; ++leg) {
           const double angle = r.platform_angles(5 - leg);
           reversed.row(leg) << 1e-4 * std::round(1e3 * std::cos(angle)), 1e-4 * std::round(1e3 * std::sin(angle)), 0.0;
         }
         r.platform_joints = reversed;
       }},
      {"a platform in the plane of its base", "robot.home_position",
       [](RobotParameters& r) { r.home_position.setZero(); }},
      {"legs of no length", "robot.home_position",
       [](RobotParameters& r) {
         r.base_radius = r.platform_radius;
         r.base_angles = degrees(-50, 10, 110, 130, 230, 250);
         r.home_position.setZero();
       }},
  };
  for (const Case& c : cases) {
    CAPTURE(c.what);
    const std::string message = verdict(c.change);
    CAPTURE(message);
    CHECK(is_about(message, c.key));
  }
}

TEST_CASE("numbers that are not finite or not positive are refused, with the key and the place") {
  for (const double bad : {kNaN, kInfinity, -kInfinity, 0.0, -0.1}) {
    CAPTURE(bad);
    CHECK(is_about(verdict([bad](RobotParameters& r) { r.platform_radius = bad; }), "robot.platform_radius"));
    CHECK(is_about(verdict([bad](RobotParameters& r) { r.base_radius = bad; }), "robot.base_radius"));
    CHECK(is_about(verdict([bad](RobotParameters& r) { r.stroke = bad; }), "robot.stroke"));
    CHECK(is_about(verdict([bad](RobotParameters& r) { r.force_limit = bad; }), "robot.force_limit"));
    if (std::isfinite(bad)) continue;
    for (int i = 0; i < 6; ++i) {
      const std::string place = "[" + std::to_string(i) + "]";
      CHECK(is_about(verdict([bad, i](RobotParameters& r) { r.platform_angles(i) = bad; }),
                     "robot.platform_angles" + place));
      CHECK(is_about(verdict([bad, i](RobotParameters& r) { r.base_angles(i) = bad; }), "robot.base_angles" + place));
      if (i < 3)
        CHECK(is_about(verdict([bad, i](RobotParameters& r) { r.home_position(i) = bad; }),
                       "robot.home_position" + place));
    }
  }
}
