// The one door into the core: every scenario that makes no sense is refused with its key, what was expected and what
// was got.
#include "hexservo/settings.hpp"
#include "hexservo/simulation.hpp"

#include "compare.hpp"
#include "random.hpp"
#include "scenarios.hpp"

#include <functional>
#include <numbers>
#include <string>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

using PaperSettings = Settings;
using Change = std::function<void(PaperSettings&)>;
using Points = Eigen::Matrix<double, 4, 3>;  // a point in each row

/// Message of the library for the paper's scenario with one change.
std::string verdict(const Change& change) {
  PaperSettings settings = paper_settings();
  change(settings);
  const std::string message = refusal([&] { loop_parameters<Hybrid>(settings); });
  const std::string checked = refusal([&] { check_settings(settings); });
  if (message != "(accepted)") CHECK(checked == message);  // both give the same message
  return checked;
}

/// The paper's points, given by their place.
Points paper_points() { return loop_parameters<Hybrid>(paper_settings()).points_T.transpose(); }

}  // namespace

TEST_CASE("the paper's scenario is accepted, in every convention and with every switching function") {
  CHECK(verdict([](PaperSettings&) {}) == "(accepted)");
  for (const auto camera : {CameraConvention::eye_in_hand, CameraConvention::as_printed})
    for (const auto jacobian : {JacobianConvention::consistent, JacobianConvention::printed})
      for (const auto kind : {SwitchingKind::sign, SwitchingKind::tanh, SwitchingKind::saturation})
        CHECK(verdict([&](PaperSettings& s) {
                s.camera.convention = camera;
                s.controller.jacobian = jacobian;
                s.controller.switching.kind = kind;
              }) == "(accepted)");
}

TEST_CASE("loop parameters are those of the settings") {
  const PaperSettings settings = paper_settings();
  const LoopParameters<double, Hybrid> p = loop_parameters<Hybrid>(settings);
  CHECK(p.initial_image.features == settings.target.initial_features);
  CHECK(p.initial_image.depth == Vector<double, 4>::Constant(-0.5));
  const double f = settings.camera.focal();
  const Image<double> seen =
      take_image(f, settings.robot.home_position, Matrix3<double>(Matrix3<double>::Identity()), p.points_T);
  CHECK(distance(seen.features, settings.target.initial_features) <= 1e-12);
  CHECK(distance(seen.depth, p.initial_image.depth) <= kEpsilon);
  CHECK(p.desired_features == settings.target.desired_features);
  CHECK(p.depth_error == settings.uncertainty.depth);
  CHECK(p.dynamics_error.inertia == settings.uncertainty.inertia);
  CHECK(p.body.mass == 0.06);
  CHECK(p.body.gravity == Vector3<double>(0.0, 0.0, 9.8));
  CHECK(p.gains.kp == Vector<double, 8>::Constant(1e-6));
  CHECK(p.step == 1e-3);
  CHECK(p.hexapod.home_position == settings.robot.home_position);
}

TEST_CASE("points and features define the same target") {
  Random random(7901);
  CAPTURE(random.seed());
  PaperSettings by_points = paper_settings();
  by_points.robot.home_position = Vector3<double>(0.003, -0.002, -0.151);
  PaperSettings by_features = by_points;
  for (int i = 0; i < 4; ++i) by_features.target.depth(i) = random.uniform(0.3, 0.8);
  by_points.target.points = loop_parameters<Hybrid>(by_features).points_T.transpose();
  by_points.target.initial_features.setConstant(kNaN);  // not used beside points
  by_points.target.depth.setConstant(kNaN);
  const LoopParameters<double, Hybrid> p = loop_parameters<Hybrid>(by_points);
  CHECK(distance(p.initial_image.features, by_features.target.initial_features) <= 1e-12);
  CHECK(distance(p.initial_image.depth, -by_features.target.depth) <= 4.0 * kEpsilon);
}

TEST_CASE("defaults are those of docs/model.md, section 5") {
  const PaperSettings s;
  CHECK(s.gains<Hybrid>().kp == Vector<double, 8>::Constant(1e-6));
  CHECK(s.gains<Hybrid>().kv == (Vector6<double>() << 2e-3, 2e-3, 2e-3, 1e-4, 1e-4, 1e-4).finished());
  CHECK(s.gains<Hybrid>().fuzzy.enabled);
  CHECK(s.gains<Hybrid>().fuzzy.adaptation == Vector6<double>::Constant(10.0));
  CHECK(s.gains<Hybrid>().fuzzy.error_scale == (Vector6<double>() << 5, 5, 5, 10, 10, 10).finished());
  CHECK(s.gains<Hybrid>().fuzzy.rate_scale == Vector6<double>::Constant(0.5));
  CHECK(s.gains<Hybrid>().fuzzy.initial_scale == Vector6<double>::Zero());
  CHECK(s.gains<Hybrid>().fuzzy.table == linear_rule_table());
  CHECK(s.gains<Hybrid>().fuzzy.bell_width == 1.0 / 6.0);
  CHECK(s.gains<Hybrid>().fuzzy.bell_slope == 2.0);
  CHECK(s.controller.switching.kind == SwitchingKind::sign);
  CHECK(s.controller.switching.width == 1e-3);
  CHECK(s.simulation.step == 1e-3);
  CHECK(s.simulation.duration == 5.0);
  CHECK(s.simulation.log_every == 1);
  CHECK(s.target.depth == Vector<double, 4>::Constant(0.5));
  CHECK(s.metrics == MetricsSettings<double>{2.0, 0.2, 1.0});
  CHECK(s.camera.convention == CameraConvention::eye_in_hand);
  CHECK(s.controller.jacobian == JacobianConvention::consistent);
  CHECK(s.uncertainty.depth.isZero(0.0));
}

TEST_CASE("a number that is not finite is refused wherever it stands") {
  struct Place {
    std::string key;
    std::function<double&(PaperSettings&)> number;
  };
  std::vector<Place> places = {
      {"robot.platform_radius", [](PaperSettings& s) -> double& { return s.robot.platform_radius; }},
      {"robot.base_radius", [](PaperSettings& s) -> double& { return s.robot.base_radius; }},
      {"robot.mass", [](PaperSettings& s) -> double& { return s.robot.mass; }},
      {"robot.stroke", [](PaperSettings& s) -> double& { return s.robot.stroke; }},
      {"robot.force_limit", [](PaperSettings& s) -> double& { return s.robot.force_limit; }},
      {"camera.focal_length", [](PaperSettings& s) -> double& { return s.camera.focal_length; }},
      {"camera.pixel_scale", [](PaperSettings& s) -> double& { return s.camera.pixel_scale; }},
      {"controller.switching.width", [](PaperSettings& s) -> double& { return s.controller.switching.width; }},
      {"controller.hybrid.fuzzy.bell_width",
       [](PaperSettings& s) -> double& { return s.gains<Hybrid>().fuzzy.bell_width; }},
      {"controller.hybrid.fuzzy.bell_slope",
       [](PaperSettings& s) -> double& { return s.gains<Hybrid>().fuzzy.bell_slope; }},
      {"simulation.step", [](PaperSettings& s) -> double& { return s.simulation.step; }},
      {"simulation.duration", [](PaperSettings& s) -> double& { return s.simulation.duration; }},
      {"metrics.band", [](PaperSettings& s) -> double& { return s.metrics.band; }},
      {"metrics.dwell", [](PaperSettings& s) -> double& { return s.metrics.dwell; }},
      {"metrics.rms_start", [](PaperSettings& s) -> double& { return s.metrics.rms_start; }},
  };
  const auto add = [&places](const std::string& key, int count,
                             const std::function<double&(PaperSettings&, int)>& number) {
    for (int i = 0; i < count; ++i)
      places.push_back({key, [number, i](PaperSettings& s) -> double& { return number(s, i); }});
  };
  add("robot.platform_angles", 6, [](PaperSettings& s, int i) -> double& { return s.robot.platform_angles(i); });
  add("robot.base_angles", 6, [](PaperSettings& s, int i) -> double& { return s.robot.base_angles(i); });
  add("robot.home_position", 3, [](PaperSettings& s, int i) -> double& { return s.robot.home_position(i); });
  add("robot.inertia", 9, [](PaperSettings& s, int i) -> double& { return s.robot.inertia(i); });
  add("target.initial_features", 8, [](PaperSettings& s, int i) -> double& { return s.target.initial_features(i); });
  add("target.desired_features", 8, [](PaperSettings& s, int i) -> double& { return s.target.desired_features(i); });
  add("target.depth", 4, [](PaperSettings& s, int i) -> double& { return s.target.depth(i); });
  add("uncertainty.inertia", 36, [](PaperSettings& s, int i) -> double& { return s.uncertainty.inertia(i); });
  add("uncertainty.coriolis", 36, [](PaperSettings& s, int i) -> double& { return s.uncertainty.coriolis(i); });
  add("uncertainty.gravity", 6, [](PaperSettings& s, int i) -> double& { return s.uncertainty.gravity(i); });
  add("uncertainty.depth", 4, [](PaperSettings& s, int i) -> double& { return s.uncertainty.depth(i); });
  add("controller.hybrid.kp", 8, [](PaperSettings& s, int i) -> double& { return s.gains<Hybrid>().kp(i); });
  add("controller.hybrid.kv", 6, [](PaperSettings& s, int i) -> double& { return s.gains<Hybrid>().kv(i); });
  add("controller.hybrid.fuzzy.adaptation", 6,
      [](PaperSettings& s, int i) -> double& { return s.gains<Hybrid>().fuzzy.adaptation(i); });
  add("controller.hybrid.fuzzy.error_scale", 6,
      [](PaperSettings& s, int i) -> double& { return s.gains<Hybrid>().fuzzy.error_scale(i); });
  add("controller.hybrid.fuzzy.rate_scale", 6,
      [](PaperSettings& s, int i) -> double& { return s.gains<Hybrid>().fuzzy.rate_scale(i); });
  add("controller.hybrid.fuzzy.initial_scale", 6,
      [](PaperSettings& s, int i) -> double& { return s.gains<Hybrid>().fuzzy.initial_scale(i); });
  add("controller.hybrid.fuzzy.table", 49,
      [](PaperSettings& s, int i) -> double& { return s.gains<Hybrid>().fuzzy.table(i); });
  for (const Place& place : places)
    for (const double bad : {kNaN, kInfinity, -kInfinity}) {
      CAPTURE(place.key);
      CAPTURE(bad);
      const std::string message = verdict([&](PaperSettings& s) { place.number(s) = bad; });
      CAPTURE(message);
      CHECK(is_about(message, place.key));
    }
}

TEST_CASE("a point that is not finite is refused with its place") {
  const Points good = paper_points();
  for (const double bad : {kNaN, kInfinity, -kInfinity})
    for (int i = 0; i < 12; ++i) {
      const std::string message = verdict([&](PaperSettings& s) {
        s.target.points = good;
        (*s.target.points)(i / 3, i % 3) = bad;
      });
      CAPTURE(message);
      CHECK(is_about(message, "target.points[" + std::to_string(i / 3) + "][" + std::to_string(i % 3) + "]"));
    }
}

TEST_CASE("numbers that must be positive, or within a range, are refused beyond it") {
  struct Case {
    std::string key;
    Change change;
  };
  std::vector<Case> cases = {
      {"uncertainty.depth", [](PaperSettings& s) { s.uncertainty.depth(2) = -1.0; }},
      {"uncertainty.depth", [](PaperSettings& s) { s.uncertainty.depth(0) = -1.7; }},
      {"uncertainty.inertia", [](PaperSettings& s) { s.uncertainty.inertia.setConstant(1.0); }},
      {"uncertainty.inertia", [](PaperSettings& s) { s.uncertainty.inertia(4, 3) += 0.1; }},
      {"robot.inertia", [](PaperSettings& s) { s.robot.inertia.diagonal() = Vector3<double>(1e-4, 1e-4, 3e-4); }},
      {"robot.inertia", [](PaperSettings& s) { s.robot.inertia(0, 1) = 1e-5; }},
      {"robot.platform_angles", [](PaperSettings& s) { s.robot.platform_angles = s.robot.base_angles; }},
      {"controller.hybrid.kv", [](PaperSettings& s) { s.gains<Hybrid>().kv(5) = -1e-9; }},
      {"simulation.log_every", [](PaperSettings& s) { s.simulation.log_every = 0; }},
      {"simulation.log_every", [](PaperSettings& s) { s.simulation.log_every = -3; }},
  };
  for (const double bad : {0.0, -1.0}) {
    const auto add = [&](const std::string& key, const std::function<double&(PaperSettings&)>& number) {
      cases.push_back({key, [number, bad](PaperSettings& s) { number(s) = bad; }});
    };
    add("robot.mass", [](PaperSettings& s) -> double& { return s.robot.mass; });
    add("robot.stroke", [](PaperSettings& s) -> double& { return s.robot.stroke; });
    add("robot.force_limit", [](PaperSettings& s) -> double& { return s.robot.force_limit; });
    add("camera.focal_length", [](PaperSettings& s) -> double& { return s.camera.focal_length; });
    add("camera.pixel_scale", [](PaperSettings& s) -> double& { return s.camera.pixel_scale; });
    add("target.depth[3]", [](PaperSettings& s) -> double& { return s.target.depth(3); });
    add("controller.switching.width", [](PaperSettings& s) -> double& { return s.controller.switching.width; });
    add("controller.hybrid.kp[6]", [](PaperSettings& s) -> double& { return s.gains<Hybrid>().kp(6); });
    add("controller.hybrid.fuzzy.adaptation[1]",
        [](PaperSettings& s) -> double& { return s.gains<Hybrid>().fuzzy.adaptation(1); });
    add("simulation.step", [](PaperSettings& s) -> double& { return s.simulation.step; });
    add("simulation.duration", [](PaperSettings& s) -> double& { return s.simulation.duration; });
    add("metrics.band", [](PaperSettings& s) -> double& { return s.metrics.band; });
    add("metrics.dwell", [](PaperSettings& s) -> double& { return s.metrics.dwell; });
  }
  for (const Case& c : cases) {
    const std::string message = verdict(c.change);
    CAPTURE(message);
    CAPTURE(c.key);
    CHECK(is_about(message, c.key));
  }
  CHECK(verdict([](PaperSettings& s) { s.uncertainty.depth(0) = -0.999; }) == "(accepted)");
}

TEST_CASE("an image may be as old as period, latency and jitter together, however their sum is rounded") {
  const auto with_timeout = [](double timeout) {
    return verdict([timeout](PaperSettings& s) {
      s.simulation.mode = LoopMode::sampled;
      s.camera.period = 0.1;
      s.camera.latency = 0.1;
      s.camera.latency_jitter = 0.1;
      s.camera.timeout = timeout;
    });
  };
  REQUIRE(0.1 + 0.1 + 0.1 > 0.3);
  CHECK(with_timeout(0.3) == "(accepted)");
  CHECK(with_timeout(0.1 + 0.1 + 0.1) == "(accepted)");
  CHECK(with_timeout(kInfinity) == "(accepted)");
  for (const double bad : {0.299, 0.0, -1.0, 0.3005, kNaN}) {
    CAPTURE(bad);
    CHECK(is_about(with_timeout(bad), "camera.timeout"));
  }
}

TEST_CASE("targets that no camera can use are refused") {
  const Points good = paper_points();
  CHECK(verdict([&](PaperSettings& s) { s.target.points = good; }) == "(accepted)");
  struct Case {
    std::string what, key;
    Change change;
  };
  const std::vector<Case> cases = {
      {"point behind the camera", "target.points[1]",
       [&](PaperSettings& s) {
         s.target.points = good;
         (*s.target.points)(1, 2) = 0.1;
       }},
      {"point in the camera's own plane", "target.points[3]",
       [&](PaperSettings& s) {
         s.target.points = good;
         (*s.target.points)(3, 2) = s.robot.home_position(2);
       }},
      {"initial features that coincide", "target.initial_features",
       [](PaperSettings& s) { s.target.initial_features.segment<2>(4) = s.target.initial_features.segment<2>(0); }},
      {"desired features that coincide", "target.desired_features",
       [](PaperSettings& s) { s.target.desired_features.segment<2>(6) = s.target.desired_features.segment<2>(2); }},
      {"points behind one another", "target.points",
       [&](PaperSettings& s) {
         s.target.points = good;
         const Vector3<double> home = s.robot.home_position, ray = good.row(0).transpose() - home;
         s.target.points->row(2) = (home + 1.5 * ray).transpose();
       }},
      {"initial features on one line", "target.initial_features",
       [](PaperSettings& s) { s.target.initial_features << 10, 20, 20, 40, 30, 60, -5, -10; }},
      {"initial features on a line beside the centre", "target.initial_features",
       [](PaperSettings& s) { s.target.initial_features << 10, 7, 20, 7, 30, 7, -5, 7; }},
      {"desired features on one line", "target.desired_features",
       [](PaperSettings& s) { s.target.desired_features << 10, 20, 20, 40, 30, 60, -5, -10; }},
      {"a goal out of reach", "target.initial_features", [](PaperSettings& s) { s.target.desired_features(0) = 2e4; }},
      {"points for a camera that has none", "target.points",
       [&](PaperSettings& s) {
         s.target.points = good;
         s.camera.convention = CameraConvention::as_printed;
       }},
  };
  for (const Case& c : cases) {
    CAPTURE(c.what);
    const std::string message = verdict(c.change);
    CAPTURE(message);
    CHECK(is_about(message, c.key));
  }
}

TEST_CASE("time grids: a step that divides the duration to rounding, neither empty nor endless") {
  const auto count = [](double step, double duration) {
    return step_count({LoopMode::continuous, step, 1, duration, 1, {}});
  };
  CHECK(count(1e-3, 5.0) == 5000);
  CHECK(count(1e-3, 0.1) == 100);  // neither is a binary fraction
  CHECK(count(1e-3, 1e-3) == 1);
  CHECK(count(1.0 / 3.0, 1.0) == 3);
  CHECK(count(0.1, 0.3) == 3);
  CHECK(count(1e-6, 900.0) == 900000000);
  Random random(7902);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 200; ++trial) {
    const double step = std::pow(10.0, random.uniform(-6.0, -1.0));
    const auto steps = static_cast<long long>(random.uniform(1.0, 1e5));
    CHECK(count(step, step * static_cast<double>(steps)) == steps);
  }
  const auto refused = [&](double step, double duration) { return refusal([&] { count(step, duration); }); };
  CHECK(is_about(refused(3e-3, 1.0), "simulation.step"));
  CHECK(is_about(refused(2.0, 1.0), "simulation.step"));
  CHECK(is_about(refused(1e-3, 1.0005), "simulation.step"));
  CHECK(is_about(refused(1.0, 1e-3), "simulation.step"));
  CHECK(is_about(refused(1e-9, 10.0), "simulation.duration"));
  CHECK(is_about(refused(1e-300, 1e300), "simulation.duration"));
  CHECK(is_about(refused(5e-324, 1.0), "simulation.duration"));
  // the message names grids that work
  const std::string message = refused(3e-3, 1.0);
  CAPTURE(message);
  CHECK(message.find("nearest") != std::string::npos);
}

TEST_CASE("a log that would not fit into memory is refused before it is allocated, and thinning it helps") {
  const auto long_run = [](long long log_every) {
    return verdict([log_every](PaperSettings& s) {
      s.simulation.step = 1e-6;
      s.simulation.duration = 900.0;
      s.simulation.log_every = log_every;
    });
  };
  CHECK(is_about(long_run(1), "simulation.log_every"));
  CHECK(long_run(1000) == "(accepted)");
  PaperSettings settings = paper_settings();
  settings.simulation = {LoopMode::continuous, 1e-6, 1, 900.0, 1, {}};
  CHECK(is_about(refusal([&] { simulate(settings); }), "simulation.log_every"));
}

TEST_CASE("gains whose wrench overflows at the start are refused: a finite wrench is expected") {
  const std::string huge = verdict([](PaperSettings& s) { s.gains<Hybrid>().kp.setConstant(1e307); });
  CAPTURE(huge);
  CHECK(is_about(huge, "controller"));
  CHECK(huge.find("finite wrench") != std::string::npos);
  const std::string weights = verdict([](PaperSettings& s) {
    s.gains<Hybrid>().fuzzy.initial_scale.setConstant(1e308);
    s.gains<Hybrid>().fuzzy.table.setConstant(1e10);
  });
  CAPTURE(weights);
  CHECK(is_about(weights, "controller.hybrid.fuzzy.initial_scale"));
  const std::string unused = verdict([](PaperSettings& s) {
    s.gains<Hybrid>().fuzzy.enabled = false;  // they would be logged all the same
    s.gains<Hybrid>().fuzzy.initial_scale.setConstant(1e308);
    s.gains<Hybrid>().fuzzy.table.setConstant(1e10);
  });
  CHECK(unused == weights);
}

TEST_CASE("a start from which a run would stop at once is refused with its cause") {
  const auto refused = [](const Change& change) {
    PaperSettings settings = paper_settings();
    settings.simulation.mode = LoopMode::sampled;
    change(settings);
    return refusal([&] { check_settings(settings); });
  };
  const std::string beyond = refused([](PaperSettings& s) {
    s.robot.on_limit = LimitPolicy::stop;
    s.simulation.start.pose(2) = 0.03;  // some 22 mm of leg travel
  });
  CHECK(is_about(beyond, "simulation.start"));
  CHECK(beyond.find("passed its stroke") != std::string::npos);
  const std::string fast = refused([](PaperSettings& s) {
    s.robot.on_limit = LimitPolicy::stop;
    s.robot.speed_limit = 0.01;
    s.simulation.start.twist(2) = 0.1;
  });
  CHECK(is_about(fast, "simulation.start"));
  CHECK(fast.find("passed its speed limit") != std::string::npos);
  const std::string hidden = refused([](PaperSettings& s) {
    s.camera.on_lost = LostFeature::stop;
    s.camera.image_size = Vector2<double>(100.0, 100.0);
  });
  CHECK(is_about(hidden, "camera.image_size"));
}

TEST_CASE("the brake is that of the machine, however its platform's frame is turned") {
  Random random(9301);
  CAPTURE(random.seed());
  const Vector3<double> rod(1e-5, 1.5e-4, 1.5e-4);
  PaperSettings plain = paper_settings(), turned = paper_settings();
  plain.simulation.mode = turned.simulation.mode = LoopMode::sampled;
  plain.robot.inertia = rod.asDiagonal();
  turned.robot.inertia = Vector3<double>(rod(1), rod(0), rod(2)).asDiagonal();  // E turned by 90 degrees about z
  turned.robot.home_attitude = {0.0, 0.0, std::numbers::pi / 2.0};
  turned.robot.platform_angles.array() -= std::numbers::pi / 2.0;
  const auto expected = loop_parameters<Hybrid>(plain), found = loop_parameters<Hybrid>(turned);
  const auto legs = [](const auto& p) {
    return inverse_kinematics(p.hexapod, p.hexapod.home_position, rotation_matrix(home_pose(p.hexapod).quaternion));
  };
  REQUIRE(distance(legs(found).lengths, legs(expected).lengths) <= 1e-15);  // the same machine
  Vector6<double> wanted;
  wanted << 1.0, -2.0, 3.0, 30.0, 20.0, -10.0;
  const auto wrench = [&wanted](const auto& p) {
    return inertial_wrench(p.body, rotation_matrix(home_pose(p.hexapod).quaternion), wanted);
  };
  CHECK(found.safe.hold_rate == expected.safe.hold_rate);
  CHECK(found.safe.damping_rate == expected.safe.damping_rate);
  CHECK(relative_distance(wrench(found), wrench(expected)) <= 1e-14);
  CHECK(wrench(expected)(3) < 0.2 * wrench(expected)(4));
}

TEST_CASE("simulate refuses what check_settings refuses, with the same words") {
  for (const Change& change : std::vector<Change>{[](PaperSettings& s) { s.robot.mass = 0.0; },
                                                  [](PaperSettings& s) { s.target.depth(0) = kNaN; },
                                                  [](PaperSettings& s) { s.simulation.step = 0.3; }}) {
    PaperSettings settings = paper_settings();
    change(settings);
    const std::string checked = refusal([&] { check_settings(settings); });
    CHECK(checked != "(accepted)");
    CHECK(refusal([&] { simulate(settings); }) == checked);
  }
}
