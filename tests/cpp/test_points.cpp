// Targets of any number of points: image Jacobian, pose estimate and laws with weights (docs/model.md, section 4).
#include "compare.hpp"
#include "hexservo/controller.hpp"
#include "random.hpp"
#include "scenarios.hpp"

#include <Eigen/QR>

#include <functional>

using namespace hexservo;
using namespace hexservo::test;

namespace {

constexpr int N = kMostPoints;

/// A scenario whose goal image is that of its points from a pose a few millimetres and degrees from home.
template <class Law>
Settings settings_of(const Eigen::Matrix<double, Eigen::Dynamic, 3>& points) {
  Settings settings = Settings::of<Law>();
  settings.target.points = PointRows(points);
  settings.target.desired_features = OfPoints<double, kAnyPoints, 2>::Zero(2 * points.rows());
  settings.uncertainty.depth = OfPoints<double, kAnyPoints>::Zero(1);
  if constexpr (requires { settings.gains<Law>().kp; })
    if (settings.gains<Law>().kp.size() == 8) settings.gains<Law>().kp = settings.gains<Law>().kp.head(1).eval();
  settings.target.desired_features =
      project_target(settings, (Vector6<double>() << 0.004, -0.003, 0.002, 0.02, -0.03, 0.05).finished());
  return settings;
}

/// Points about the optical axis, 0.5 m before the camera, none of them in a plane with the others.
Eigen::Matrix<double, Eigen::Dynamic, 3> scattered(int count, Random& random) {
  Eigen::Matrix<double, Eigen::Dynamic, 3> points(count, 3);
  for (int i = 0; i < count; ++i) {
    const double angle = 6.283185307179586 * i / count, radius = i % 2 == 0 ? 0.08 : 0.05;
    points.row(i) =
        Eigen::RowVector3d(radius * std::cos(angle), radius * std::sin(angle), -0.65) + random.matrix<1, 3>(0.02);
  }
  return points;
}

}  // namespace

TEST_CASE("the image Jacobian of 16 places is the derivative of the projection, and places behind the points repeat") {
  Random random(17001);
  CAPTURE(random.seed());
  for (const int count : {3, 5, 8, 16}) {
    CAPTURE(count);
    const auto p = loop_parameters<Kelly, N>(settings_of<Kelly>(scattered(count, random)));
    CHECK(p.points == count);
    const PlatformCamera<double> camera(p.camera);
    const Pose<double> home = home_pose(p.hexapod);
    const Matrix3<double> R_BE = rotation_matrix(home.quaternion);
    const ImageJacobian<double, N> J(camera, -1.0, p.initial_image, home.position, R_BE);
    const Eigen::Matrix<double, 2 * N, 6> matrix = J.matrix();
    constexpr double kStep = 1e-6;  // error of central differences: kStep^2 times the third derivative, about 1e-6 px
    for (int j = 0; j < 6; ++j) {
      Vector6<double> d = Vector6<double>::Zero();
      d(j) = kStep;
      const Pose<double> ahead = moved(home, d), behind = moved(home, Vector6<double>(-d));
      const auto seen = [&](const Pose<double>& pose) {
        return take_image<double, N>(camera, pose.position, rotation_matrix(pose.quaternion), p.points_T).features;
      };
      CHECK(distance((seen(ahead) - seen(behind)) / (2.0 * kStep), matrix.col(j)) <= 1e-4);
      CHECK(distance(J.push(d) / kStep, matrix.col(j)) <= 1e-9);
    }
    Vector<double, N> weight = Vector<double, N>::Zero();
    for (int i = 0; i < count; ++i) weight(i) = random.uniform(0.1, 2.0);
    const PointWeights<double, N> weights(weight);
    Eigen::Matrix<double, 6, 6> normal = Eigen::Matrix<double, 6, 6>::Zero();
    for (int i = 0; i < count; ++i)
      normal += weight(i) * matrix.middleRows<2>(2 * i).transpose() * matrix.middleRows<2>(2 * i);
    CHECK(relative_distance(whole(J.normal_matrix(weights)), normal) <= 1e-13);
    for (int i = count; i < N; ++i)
      CHECK(p.initial_image.features.segment<2>(2 * i) == p.initial_image.features.head<2>());
    CHECK(p.weights.tail(N - count).isZero(0.0));
  }
}

TEST_CASE("the pose of 5 to 16 points is found exactly, and under noise it is the weighted least-squares one") {
  Random random(17002);
  CAPTURE(random.seed());
  for (const int count : {4, 5, 8, 16}) {
    CAPTURE(count);
    Settings settings = settings_of<Pbvs>(scattered(count, random));
    settings.target.weights.resize(count);
    for (int i = 0; i < count; ++i) settings.target.weights(i) = random.uniform(0.3, 3.0);
    const auto p = loop_parameters<Pbvs, N>(settings);
    const PlatformCamera<double> camera(p.camera);
    const PointWeights<double, N> weights(p.weights);
    const Pose<double> home = home_pose(p.hexapod);
    const Pose<double> truth = moved(home, Vector6<double>(random.six(0.004, 0.05)));
    Vector<double, 2 * N> features =
        take_image<double, N>(camera, truth.position, rotation_matrix(truth.quaternion), p.points_T).features;
    const Vector6<double> none = Vector6<double>::Zero();
    const auto exact = estimate_pose<double, N>(camera, p.points_T, features, home, none, weights);
    CHECK_FALSE(exact.failed);
    CHECK(pose_difference(exact.pose, truth).cwiseAbs().maxCoeff() <= 1e-12);

    for (int k = 0; k < 2 * count; ++k) features(k) += random.uniform(-0.5, 0.5);
    fill_places<2>(features, count);
    const auto noisy = estimate_pose<double, N>(camera, p.points_T, features, home, none, weights);
    const Matrix3<double> R_BE = rotation_matrix(noisy.pose.quaternion);
    const Image<double, N> image = take_image<double, N>(camera, noisy.pose.position, R_BE, p.points_T);
    const Eigen::Matrix<double, 2 * N, 6> J =
        ImageJacobian<double, N>(camera, -1.0, image, noisy.pose.position, R_BE).matrix();
    Vector6<double> slope = Vector6<double>::Zero();  // of the weighted residual: zero at its minimum
    for (int i = 0; i < count; ++i)
      slope += p.weights(i) * J.middleRows<2>(2 * i).transpose() * (features - image.features).segment<2>(2 * i);
    CHECK(slope.cwiseAbs().maxCoeff() <= 1e-6 * J.cwiseAbs().maxCoeff());
  }
}

TEST_CASE_TEMPLATE("a law takes a point that does not count for none, and two of half the weight for one", Law, Hybrid,
                   Composite, Kelly, ResolvedRate, Pbvs, ComputedTorque) {
  Random random(17003);
  CAPTURE(random.seed());
  const auto four = scattered(4, random);
  const Settings alone = settings_of<Law>(four);

  Eigen::Matrix<double, Eigen::Dynamic, 3> five(5, 3);
  five << four, Eigen::RowVector3d(0.03, -0.01, -0.6);
  Settings with_idle = settings_of<Law>(five);
  with_idle.target.weights = (Vector<double, 5>() << 1, 1, 1, 1, 0).finished();

  constexpr double kApart = 3e-9;  // [m]: two features must not be one; 3e-6 px apart
  Eigen::Matrix<double, Eigen::Dynamic, 3> eight(8, 3);
  eight << four.array() + kApart, four.array() - kApart;
  Settings doubled = settings_of<Law>(eight);
  doubled.target.weights = OfPoints<double, kAnyPoints>::Constant(1, 0.5);

  const auto wrench_of = [](const auto& p) { return ClosedLoop<double, Law, N>(p).record().sample().wrench; };
  const Vector6<double> wrench = ClosedLoop<double, Law>(loop_parameters<Law>(alone)).record().sample().wrench;
  const double size = (wrench - Vector6<double>(wrench.array().round())).cwiseAbs().maxCoeff() + 1e-3;
  CHECK(distance(wrench_of(loop_parameters<Law, N>(alone)), wrench) <= 1e-9 * size);
  CHECK(distance(wrench_of(loop_parameters<Law, N>(with_idle)), wrench) <= 1e-9 * size);
  CHECK(distance(wrench_of(loop_parameters<Law, N>(doubled)), wrench) <= 1e-5 * size);  // 6e-6 px of some px
}

TEST_CASE_TEMPLATE("weights that change places with their points change nothing", Law, Hybrid, Composite, Kelly,
                   ResolvedRate, Pbvs, ComputedTorque) {
  Random random(17004);
  CAPTURE(random.seed());
  const auto points = scattered(6, random);
  Settings settings = settings_of<Law>(points);
  settings.target.weights = (Vector<double, 6>() << 0.2, 1.0, 3.0, 0.0, 0.7, 1.4).finished();
  Settings turned = settings;
  for (int i = 0; i < 6; ++i) {
    const int from = (i + 2) % 6;
    turned.target.points->row(i) = settings.target.points->row(from);
    turned.target.desired_features.segment<2>(2 * i) = settings.target.desired_features.segment<2>(2 * from);
    turned.target.weights(i) = settings.target.weights(from);
  }
  const Vector6<double> a = ClosedLoop<double, Law, N>(loop_parameters<Law, N>(settings)).record().sample().wrench;
  const Vector6<double> b = ClosedLoop<double, Law, N>(loop_parameters<Law, N>(turned)).record().sample().wrench;
  CHECK(distance(a, b) <= 1e-9);
}

TEST_CASE("what does not fit a target is refused with its key") {
  Random random(17005);
  const Settings good = settings_of<Hybrid>(scattered(5, random));
  const auto verdict = [&](const std::function<void(Settings&)>& change) {
    Settings settings = good;
    change(settings);
    return refusal([&] { loop_parameters<Hybrid, N>(settings); });
  };
  CHECK(verdict([](Settings&) {}) == "(accepted)");
  CHECK(is_about(verdict([](Settings& s) { s.target.desired_features.conservativeResize(8); }), "target.points"));
  CHECK(is_about(verdict([](Settings& s) { s.target.desired_features.conservativeResize(4); }),
                 "target.desired_features"));
  CHECK(is_about(verdict([](Settings& s) { s.target.weights = OfPoints<double, kAnyPoints>::Ones(4); }),
                 "target.weights"));
  CHECK(is_about(verdict([](Settings& s) { s.target.weights = OfPoints<double, kAnyPoints>::Zero(1); }),
                 "target.weights"));
  CHECK(is_about(verdict([](Settings& s) { s.target.weights = OfPoints<double, kAnyPoints>::Constant(1, kNaN); }),
                 "target.weights"));
  CHECK(is_about(verdict([](Settings& s) { s.target.weights = OfPoints<double, kAnyPoints>::Constant(1, -1.0); }),
                 "target.weights"));
  CHECK(is_about(verdict([](Settings& s) { s.uncertainty.depth = OfPoints<double, kAnyPoints>::Zero(4); }),
                 "uncertainty.depth"));
  CHECK(
      is_about(verdict([](Settings& s) { s.gains<Hybrid>().kp = OfPoints<double, kAnyPoints, 2>::Constant(8, 1e-6); }),
               "controller.hybrid.kp"));
  CHECK(is_about(verdict([](Settings& s) { s.target.points->row(4) = s.target.points->row(0); }), "target.points"));
  CHECK(is_about(refusal([&] { loop_parameters<Hybrid>(good); }), "target"));

  Settings three = settings_of<Kelly>(scattered(3, random));
  CHECK(refusal([&] { loop_parameters<Kelly, N>(three); }) == "(accepted)");
  Settings pbvs = settings_of<Pbvs>(scattered(4, random));
  pbvs.target.weights = (Vector<double, 4>() << 1, 1, 1, 0).finished();
  CHECK(is_about(refusal([&] { loop_parameters<Pbvs, N>(pbvs); }), "target.weights"));
}

TEST_CASE_TEMPLATE("a tick does not look at places behind the points", Law, Hybrid, Composite, Kelly, ResolvedRate,
                   Pbvs, ComputedTorque) {
  Random random(17006);
  CAPTURE(random.seed());
  const Settings settings = settings_of<Law>(scattered(5, random));
  const auto gains = controller_gains<Law, N>(settings);
  auto first = initial_state(gains), second = first;
  ControllerInputOf<N> input;
  const auto p = loop_parameters<Law, N>(settings);
  input.frame = {0.0, p.initial_image};
  input.pose = p.start;
  input.twist.setZero();
  const ControllerOutput expected = step(gains, first, input);
  CHECK(expected.status == InputStatus::valid);
  input.frame.image.features.tail<2 * (N - 5)>().setConstant(kNaN);
  input.frame.image.depth.tail<N - 5>().setConstant(1e300);
  CHECK(step(gains, second, input).wrench == expected.wrench);
  CHECK(distance(ClosedLoop<double, Law, N>(p).record().sample().wrench, expected.wrench) <= 1e-12);
}
