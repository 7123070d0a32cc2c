// Whole runs: what is logged, how runs end, metrics against the record, the platform alone under leg forces.
#include "hexservo/simulation.hpp"

#include "compare.hpp"
#include "random.hpp"
#include "scenarios.hpp"

#include <algorithm>
#include <string>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

/// Row `i` of a logged quantity.
template <int N>
Vector<double, N> row(const Column& column, std::size_t i) {
  REQUIRE(column.size() >= (i + 1) * N);
  return Eigen::Map<const Vector<double, N>>(column.data() + i * N);
}

Settings short_run(double duration) {
  Settings settings = paper_settings();
  settings.simulation.duration = duration;
  settings.metrics.rms_start = 0.1;
  return settings;
}

/// The controller's sign is wrong for the camera: positive feedback (docs/errata.md, 1).
Settings erratum(double duration) {
  Settings settings = short_run(duration);
  settings.controller.jacobian = JacobianConvention::printed;
  return settings;
}

bool same_metrics(const Metrics<double>& a, const Metrics<double>& b) {
  const auto same = [](double x, double y) { return x == y || (std::isnan(x) && std::isnan(y)); };
  return same(a.settling_time, b.settling_time) && same(a.final_error, b.final_error) &&
         same(a.rms_error, b.rms_error) && same(a.peak_error, b.peak_error) &&
         same(a.peak_displacement, b.peak_displacement) && same(a.peak_rotation, b.peak_rotation) &&
         same(a.final_linear_speed, b.final_linear_speed) && same(a.final_angular_speed, b.final_angular_speed) &&
         same(a.peak_control_force, b.peak_control_force) && same(a.peak_control_moment, b.peak_control_moment) &&
         same(a.peak_leg_force, b.peak_leg_force) && same(a.peak_leg_excursion, b.peak_leg_excursion) &&
         same(a.overshoot, b.overshoot) && same(a.relative_overshoot, b.relative_overshoot) &&
         same(a.peak_feature_distance, b.peak_feature_distance) && same(a.peak_line_deviation, b.peak_line_deviation) &&
         same(a.effort, b.effort) && same(a.chatter, b.chatter);
}

}  // namespace

TEST_CASE("a run logs its whole grid, from home at rest to the end") {
  const Settings settings = short_run(0.2);
  const Trajectory run = simulate(settings);
  CHECK(run.outcome == Outcome::completed);
  CHECK(run.steps == 200);
  CHECK(run.end_time == doctest::Approx(0.2));
  CHECK_FALSE(run.detail.empty());
  REQUIRE(run.time.size() == 201);
  CHECK(run.feature_error.size() == 201 * 8);
  CHECK(run.depth.size() == 201 * 4);
  CHECK(run.position.size() == 201 * 3);
  CHECK(run.quaternion.size() == 201 * 4);
  for (const auto* column : {&run.twist, &run.wrench, &run.fuzzy_output, &run.leg_lengths, &run.leg_forces})
    CHECK(column->size() == 201 * 6);
  for (std::size_t i = 0; i < run.time.size(); ++i)
    CHECK(run.time[i] == doctest::Approx(static_cast<double>(i) * 1e-3).epsilon(1e-14));
  // the image is the projection of points that were lifted from it
  CHECK(distance(row<8>(run.feature_error, 0), settings.target.desired_features - settings.target.initial_features) <=
        1e-12);
  CHECK(row<3>(run.position, 0) == settings.robot.home_position);
  CHECK(row<4>(run.quaternion, 0) == Vector4<double>(1.0, 0.0, 0.0, 0.0));
  CHECK(row<6>(run.twist, 0) == Vector6<double>::Zero());
  CHECK(row<4>(run.depth, 0) == Vector<double, 4>::Constant(-0.5));
}

TEST_CASE("logged quantities belong to one another: image, legs and wrench follow from pose and points") {
  const Settings settings = short_run(0.3);
  const Trajectory run = simulate(settings);
  const LoopParameters<double, Hybrid> p = loop_parameters<Hybrid>(settings);
  for (std::size_t i = 0; i < run.time.size(); i += 7) {
    CAPTURE(i);
    const Vector3<double> position = row<3>(run.position, i);
    const Matrix3<double> R_BE = rotation_matrix(row<4>(run.quaternion, i));
    CHECK(row<4>(run.quaternion, i).norm() == doctest::Approx(1.0).epsilon(4.0 * kEpsilon));
    const Image<double> image = take_image(p.camera.focal, position, R_BE, p.points_T);
    CHECK(distance(row<8>(run.feature_error, i), p.desired_features - image.features) <= 1e-11);
    CHECK(distance(row<4>(run.depth, i), image.depth) <= 1e-14);
    const Legs<double> legs = inverse_kinematics(p.hexapod, position, R_BE);
    CHECK(distance(row<6>(run.leg_lengths, i), legs.lengths) <= 1e-15);
    CHECK(distance(legs.wrench(row<6>(run.leg_forces, i)), row<6>(run.wrench, i)) <= 1e-13);
  }
}

TEST_CASE("a run whose metrics overflow has diverged, however finite its samples are") {
  Settings settings = short_run(5e-149);
  settings.simulation.step = 1e-150;  // so short that a force of 1e156 N hardly moves a mass
  settings.metrics.rms_start = 0.0;
  settings.robot.mass = 1e6;
  settings.gains<Hybrid>().kv.head<3>().setConstant(1e156);
  const Trajectory run = simulate(settings);
  CHECK(run.metrics.effort == std::numeric_limits<double>::infinity());
  for (const double force : run.leg_forces) CHECK(std::isfinite(force));
  CHECK(run.outcome == Outcome::diverged);
  settings.gains<Hybrid>().kv.head<3>() *= 1e-8;
  const Trajectory smaller = simulate(settings);
  CHECK(smaller.outcome == Outcome::completed);
  CHECK(smaller.metrics.effort > 1e140);
}

TEST_CASE("streamed metrics are the metrics of the record") {
  for (const double duration : {0.05, 0.6}) {
    CAPTURE(duration);
    const Settings settings = short_run(duration);
    const Trajectory run = simulate(settings);
    const LoopParameters<double, Hybrid> p = loop_parameters<Hybrid>(settings);
    double settling = 0.0, squares = 0.0, count = 0.0, peak = 0.0, displacement = 0.0, force = 0.0, moment = 0.0;
    double leg_force = 0.0, excursion = 0.0, rotation = 0.0;
    const Vector6<double> G = gravity_wrench(p.body);
    for (std::size_t i = 0; i < run.time.size(); ++i) {
      const Vector<double, 8> error = row<8>(run.feature_error, i);
      if (error.cwiseAbs().maxCoeff() > 2.0) settling = run.time[i];
      if (i >= 100) {
        squares += error.squaredNorm();
        count += 8.0;
      }
      peak = std::max(peak, error.cwiseAbs().maxCoeff());
      displacement = std::max(displacement, (row<3>(run.position, i) - row<3>(run.position, 0)).norm());
      const Vector4<double> q = row<4>(run.quaternion, i);
      rotation = std::max(rotation, 2.0 * std::atan2(q.tail<3>().norm(), std::abs(q(0))));
      const Vector6<double> control = row<6>(run.wrench, i) - G;
      force = std::max(force, control.head<3>().cwiseAbs().maxCoeff());
      moment = std::max(moment, control.tail<3>().cwiseAbs().maxCoeff());
      leg_force = std::max(leg_force, row<6>(run.leg_forces, i).cwiseAbs().maxCoeff());
      excursion = std::max(excursion, (row<6>(run.leg_lengths, i) - p.hexapod.home_lengths).cwiseAbs().maxCoeff());
    }
    const std::size_t last = run.time.size() - 1;
    const bool settled = row<8>(run.feature_error, last).cwiseAbs().maxCoeff() <= 2.0;
    CHECK(settled == (duration == 0.6));  // both cases occur
    if (settled)
      CHECK(run.metrics.settling_time == settling);
    else
      CHECK(std::isnan(run.metrics.settling_time));
    CHECK(run.metrics.final_error == row<8>(run.feature_error, last).cwiseAbs().maxCoeff());
    if (count > 0.0)
      CHECK(run.metrics.rms_error == doctest::Approx(std::sqrt(squares / count)).epsilon(1e-12));
    else
      CHECK(std::isnan(run.metrics.rms_error));
    CHECK(run.metrics.peak_error == peak);
    CHECK(run.metrics.peak_displacement == doctest::Approx(displacement).epsilon(1e-12));
    CHECK(run.metrics.peak_rotation == doctest::Approx(rotation).epsilon(1e-12));
    CHECK(run.metrics.final_linear_speed == doctest::Approx(row<6>(run.twist, last).head<3>().norm()).epsilon(1e-12));
    CHECK(run.metrics.final_angular_speed == doctest::Approx(row<6>(run.twist, last).tail<3>().norm()).epsilon(1e-12));
    CHECK(run.metrics.peak_control_force == force);
    CHECK(run.metrics.peak_control_moment == moment);
    CHECK(run.metrics.peak_leg_force == leg_force);
    CHECK(run.metrics.peak_leg_excursion == excursion);
  }
}

TEST_CASE("log_every thins the log and changes nothing else; the last sample is always logged") {
  Settings settings = short_run(0.3);
  const Trajectory full = simulate(settings);
  for (const long long every : {2LL, 7LL, 300LL, 1000LL}) {
    CAPTURE(every);
    settings.simulation.log_every = every;
    const Trajectory thin = simulate(settings);
    CHECK(same_metrics(thin.metrics, full.metrics));
    CHECK(thin.steps == full.steps);
    CHECK(thin.end_time == full.end_time);
    CHECK(thin.outcome == full.outcome);
    for (std::size_t r = 0; r < thin.fuzzy_weights.size(); ++r)
      CHECK(distance(thin.fuzzy_weights[r], full.fuzzy_weights[r]) == 0.0);
    CHECK(thin.time.back() == full.time.back());
    const std::size_t regular = 300 / static_cast<std::size_t>(every) + 1;
    CHECK(thin.time.size() == (300 % every == 0 ? regular : regular + 1));
    for (std::size_t i = 0; i < thin.time.size(); ++i) {
      const std::size_t of_full = std::min(i * static_cast<std::size_t>(every), full.time.size() - 1);
      CHECK(thin.time[i] == full.time[of_full]);
      CHECK(row<8>(thin.feature_error, i) == row<8>(full.feature_error, of_full));
      CHECK(row<6>(thin.leg_forces, i) == row<6>(full.leg_forces, of_full));
    }
  }
}

TEST_CASE("a run is a function of its scenario: twice the same, bit for bit") {
  const Trajectory a = simulate(short_run(0.2)), b = simulate(short_run(0.2));
  CHECK(std::ranges::equal(a.feature_error, b.feature_error));
  CHECK(std::ranges::equal(a.wrench, b.wrench));
  CHECK(std::ranges::equal(a.leg_forces, b.leg_forces));
}

TEST_CASE("a run that fails reports how and when, keeps what it computed, and logs the last good sample") {
  const Trajectory full = simulate(erratum(5.0));
  CHECK((full.outcome == Outcome::diverged || full.outcome == Outcome::behind_camera));
  CHECK(full.end_time < 0.05);  // docs/model.md, section 9, item 1
  CHECK(full.detail.find("t = ") != std::string::npos);
  CHECK(full.time.back() == full.end_time);
  CHECK(full.time.size() == static_cast<std::size_t>(full.steps));  // the step that failed is not logged
  for (const auto* column : {&full.feature_error, &full.depth, &full.position, &full.quaternion, &full.twist,
                             &full.wrench, &full.fuzzy_output, &full.leg_lengths, &full.leg_forces})
    for (const double value : *column) CHECK(std::isfinite(value));
  for (std::size_t i = 0; i < full.time.size(); ++i) {
    CHECK(row<4>(full.depth, i).maxCoeff() < 0.0);
    CHECK(row<8>(full.feature_error, i).cwiseAbs().maxCoeff() <= kMaxFeatureError);
    CHECK(row<6>(full.twist, i).cwiseAbs().maxCoeff() <= kMaxTwist);
  }
  for (const auto& weights : full.fuzzy_weights) CHECK(is_finite(weights.vector()));

  for (const long long every : {5LL, 1000LL}) {
    CAPTURE(every);
    Settings settings = erratum(5.0);
    settings.simulation.log_every = every;
    const Trajectory thin = simulate(settings);
    CHECK(thin.time.back() == full.end_time);
    CHECK(row<8>(thin.feature_error, thin.time.size() - 1) == row<8>(full.feature_error, full.time.size() - 1));
    CHECK(same_metrics(thin.metrics, full.metrics));
    CHECK(thin.detail == full.detail);
  }
}

TEST_CASE("erratum 1: (8) as printed diverges over a real projection, and not over the camera as printed") {
  Settings settings = erratum(1.0);
  CHECK(simulate(settings).outcome != Outcome::completed);
  settings.camera.convention = CameraConvention::as_printed;
  const Trajectory printed = simulate(settings);
  CHECK(printed.outcome == Outcome::completed);
  CHECK(printed.metrics.final_error < 2.0);
  settings.camera.convention = CameraConvention::eye_in_hand;
  settings.controller.jacobian = JacobianConvention::consistent;
  const Trajectory physical = simulate(settings);
  CHECK(physical.outcome == Outcome::completed);
  CHECK(physical.metrics.final_error < 2.0);
}

TEST_CASE("a stop request ends a run as interrupted, with what there is") {
  Settings settings = short_run(20.0);
  int questions = 0;
  const Trajectory run = simulate(settings, [&questions] { return ++questions == 3; });
  CHECK(run.outcome == Outcome::interrupted);
  CHECK(questions == 3);
  CHECK(run.steps > 0);
  CHECK(run.steps < 20000);
  CHECK(run.time.size() == static_cast<std::size_t>(run.steps) + 1);
  CHECK(run.time.back() == run.end_time);
  CHECK(run.end_time == doctest::Approx(static_cast<double>(run.steps) * 1e-3));
  CHECK_FALSE(run.detail.empty());

  const Trajectory at_once = simulate(settings, [] { return true; });
  CHECK(at_once.outcome == Outcome::interrupted);
  CHECK(at_once.steps == 0);
  CHECK(at_once.time.size() == 1);

  settings.simulation.log_every = 999;
  questions = 0;
  const Trajectory thin = simulate(settings, [&questions] { return ++questions == 3; });
  CHECK(thin.time.back() == run.end_time);
  CHECK(row<8>(thin.feature_error, thin.time.size() - 1) == row<8>(run.feature_error, run.time.size() - 1));

  const Trajectory not_asked = simulate(short_run(0.2), [] { return false; });
  CHECK(not_asked.outcome == Outcome::completed);
}

TEST_CASE("a run of many substeps is asked as often as its integration goes on, not its ticks") {
  Settings settings = short_run(0.05);
  settings.simulation.mode = LoopMode::sampled;
  settings.simulation.substeps = 300;
  int questions = 0;
  const Trajectory run = simulate(settings, [&] {
    ++questions;
    return false;
  });
  CHECK(run.steps == 50);
  CHECK(questions >= 50 * 300 / 2048);
}

TEST_CASE("legs beyond a limit are reported with time and peak, and the run goes on") {
  Settings settings = short_run(0.5);
  CHECK(simulate(settings).events.empty());
  settings.robot.stroke = 1e-3;
  settings.robot.force_limit = 0.1;  // holding the platform takes 0.1337 N
  const Trajectory run = simulate(settings);
  CHECK(run.outcome == Outcome::completed);
  const LoopParameters<double, Hybrid> p = loop_parameters<Hybrid>(settings);
  int stroke_events = 0, force_events = 0;
  double previous = 0.0;
  for (const LimitEvent& event : run.events) {
    CAPTURE(event.leg);
    const bool stroke = event.kind == LimitEvent::Kind::stroke;
    (stroke ? stroke_events : force_events) += 1;
    CHECK(event.limit == (stroke ? 1e-3 : 0.1));
    CHECK(event.first_time >= previous);
    previous = event.first_time;
    double first = kInfinity, peak = 0.0;
    for (std::size_t i = 0; i < run.time.size(); ++i) {
      const double value = stroke ? std::abs(row<6>(run.leg_lengths, i)(event.leg) - p.hexapod.home_lengths(event.leg))
                                  : std::abs(row<6>(run.leg_forces, i)(event.leg));
      peak = std::max(peak, value);
      if (value > event.limit) first = std::min(first, run.time[i]);
    }
    CHECK(event.first_time == first);
    CHECK(event.peak == peak);
  }
  CHECK(force_events == 6);
  CHECK(stroke_events > 0);
  // limits are not enforced: the motion is the same without them
  const Trajectory again = simulate(short_run(0.5));
  CHECK(std::ranges::equal(again.feature_error, run.feature_error));
}

// --- the platform alone
// -----------------------------------------------------------------------------------------------

namespace {

BodyState<double> home_state(const RobotParameters& robot) {
  return body_state<double>({robot.home_position, Pose<double>{}.quaternion}, Vector6<double>::Zero());
}

}  // namespace

TEST_CASE("without leg forces the platform falls freely: the closed form") {
  Random random(8001);
  CAPTURE(random.seed());
  const RobotParameters robot;
  BodyState<double> start = home_state(robot);
  start.segment<3>(7) = random.matrix<3>(0.3);
  const BodyState<double> end = drive_legs(make_hexapod(robot), {}, {}, start, Vector6<double>::Zero(), 1e-3, 500);
  const Vector3<double> fall(0.0, 0.0, 0.5 * 9.8 * 0.25);
  CHECK(distance(position_of(end), position_of(start) + 0.5 * start.segment<3>(7) + fall) <= 1e-13);
  CHECK(quaternion_of(end) == quaternion_of(start));
}

TEST_CASE("leg forces that carry the weight hold the platform at home, with the actual mass") {
  const RobotParameters robot;
  const Hexapod<double> hexapod = make_hexapod(robot);
  const RigidBody<double> body{robot.mass, robot.inertia};
  const Legs<double> legs = inverse_kinematics<double>(hexapod, robot.home_position, Matrix3<double>::Identity());
  for (const double error : {0.0, 0.075}) {
    DynamicsError<double> uncertainty;
    uncertainty.inertia.setConstant(error);
    uncertainty.gravity.setConstant(error);
    const Vector6<double> forces =
        WrenchMapSolver<double>(hexapod, legs).leg_forces((1.0 - error) * gravity_wrench(body));
    const BodyState<double> end = drive_legs(hexapod, body, uncertainty, home_state(robot), forces, 1e-3, 100);
    // Standing on legs is unstable: rounding grows like exp(t sqrt(g/l)), less than tenfold in 0.1 s.
    CHECK(distance(end, home_state(robot)) <= 1e-12);
  }
}

TEST_CASE("constant leg forces do work: energy gained is force times travel") {
  // Each leg's force is constant along its own length, so the work of the legs is exactly sum f_i (l_i(end) -
  // l_i(start)).
  Random random(8002);
  CAPTURE(random.seed());
  const RobotParameters robot;
  const Hexapod<double> hexapod = make_hexapod(robot);
  const RigidBody<double> body{robot.mass, robot.inertia};
  const Legs<double> legs = inverse_kinematics<double>(hexapod, robot.home_position, Matrix3<double>::Identity());
  const Vector6<double> holding = WrenchMapSolver<double>(hexapod, legs).leg_forces(gravity_wrench(body));
  for (int trial = 0; trial < 5; ++trial) {
    CAPTURE(trial);
    const Vector6<double> forces = holding + random.matrix<6>(0.02);
    const BodyState<double> start = home_state(robot);
    const BodyState<double> end = drive_legs(hexapod, body, {}, start, forces, 1e-4, 3000);
    const Matrix3<double> R_BE = rotation_matrix(quaternion_of(end));
    const Vector6<double> lengths = inverse_kinematics<double>(hexapod, position_of(end), R_BE).lengths;
    const double gained = kinetic_energy(body, R_BE, twist_of(end)) +
                          potential_energy(body, position_of(end), rotation_matrix(quaternion_of(end))) -
                          potential_energy(body, position_of(start), rotation_matrix(quaternion_of(start)));
    const double work = forces.dot(lengths - hexapod.home_lengths);
    CHECK(distance(lengths, hexapod.home_lengths) > 1e-3);
    const double exchanged = forces.cwiseAbs().dot((lengths - hexapod.home_lengths).cwiseAbs());
    CHECK(std::abs(gained - work) <= 1e-10 * exchanged);
  }
}

TEST_CASE("drive_legs converges with order four") {
  const RobotParameters robot;
  const Hexapod<double> hexapod = make_hexapod(robot);
  Vector6<double> forces;
  forces << 0.15, 0.12, 0.14, 0.13, 0.12, 0.14;
  BodyState<double> start = home_state(robot);
  start.tail<3>() << 1.0, -2.0, 1.5;
  const auto end = [&](int steps) { return drive_legs(hexapod, {}, {}, start, forces, 0.2 / steps, steps); };
  const BodyState<double> truth = end(1600);
  double previous = (end(25) - truth).norm();
  for (const int steps : {50, 100}) {
    const double error = (end(steps) - truth).norm();
    CAPTURE(previous / error);
    CHECK(previous / error > 14.0);
    CHECK(previous / error < 18.0);
    previous = error;
  }
}

TEST_CASE("drive_legs refuses what makes no sense") {
  const RobotParameters robot;
  const Hexapod<double> hexapod = make_hexapod(robot);
  const auto verdict = [&](const BodyState<double>& start, const Vector6<double>& forces, double step, long long steps,
                           const RigidBody<double>& body = {}) {
    return refusal([&] { drive_legs(hexapod, body, {}, start, forces, step, steps); });
  };
  const BodyState<double> start = home_state(robot);
  const Vector6<double> forces = Vector6<double>::Constant(0.1);
  CHECK(verdict(start, forces, 1e-3, 1) == "(accepted)");
  for (const double bad : {kNaN, kInfinity, 0.0, -1e-3}) CHECK(is_about(verdict(start, forces, bad, 1), "step"));
  CHECK(is_about(verdict(start, forces, 1e-3, 0), "steps"));
  CHECK(is_about(verdict(start, forces, 1e-3, -1), "steps"));
  for (int i = 0; i < 13; ++i) {
    BodyState<double> broken = start;
    broken(i) = kNaN;
    CHECK(is_about(verdict(broken, forces, 1e-3, 1), "start"));
  }
  BodyState<double> no_attitude = start;
  no_attitude.segment<4>(3).setZero();
  CHECK(is_about(verdict(no_attitude, forces, 1e-3, 1), "start"));
  for (int i = 0; i < 6; ++i) {
    Vector6<double> broken = forces;
    broken(i) = kInfinity;
    CHECK(is_about(verdict(start, broken, 1e-3, 1), "leg_forces"));
  }
  RigidBody<double> weightless;
  weightless.mass = 0.0;
  CHECK(is_about(verdict(start, forces, 1e-3, 1, weightless), "robot.mass"));
}
