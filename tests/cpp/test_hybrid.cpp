// The paper's law (14), (15), (22) at single instants: against the equations written out, and its Lyapunov identity
// (23).
#include "hexservo/laws/hybrid.hpp"
#include "hexservo/rigid_body.hpp"

#include "compare.hpp"
#include "laws.hpp"
#include "random.hpp"
#include "scenarios.hpp"

#include <algorithm>
#include <functional>
#include <string>
#include <utility>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

/// A law in the middle of its work: random gains, weights and sensor values of ordinary size.
struct Situation {
  ControlTask<double> task;
  HybridGains<double> gains;
  FuzzyWeights<double> weights;
  Sensed<double> input;

  Hybrid::Evaluation<double> evaluate() const { return evaluate_hybrid(task, gains, weights, input); }
};

Situation random_situation(Random& random) {
  Situation s;
  s.task.camera = 581.816;
  s.task.jacobian_sign = random.uniform(-1.0, 1.0) < 0.0 ? -1.0 : 1.0;
  s.task.desired_features = random.matrix<8>(100.0);
  s.task.gravity_wrench = gravity_wrench(RigidBody<double>{});
  s.task.switching = {SwitchingKind::tanh, 1e-2};
  s.gains.kp = 1e-6 * (random.matrix<8>(0.5) + Vector<double, 8>::Ones());
  s.gains.kv = random.six(1e-3, 5e-5).cwiseAbs();
  s.gains.fuzzy.adaptation = random.matrix<6>(4.0) + Vector6<double>::Constant(5.0);
  for (AxisVector<double>& w : s.weights) w = Vector6<double>(random.six(1e-2, 1e-3));
  s.input.image.features = random.matrix<8>(100.0);
  for (int i = 0; i < 4; ++i) s.input.image.depth(i) = random.uniform(-0.8, -0.3);
  s.input.R_BE = random.rotation();
  s.input.twist = random.six(0.02, 0.1);
  return s;
}

/// The image Jacobian as a matrix; (8) itself is checked in test_camera.cpp.
Eigen::Matrix<double, 8, 6> jacobian_of(const Situation& s) {
  return ImageJacobian<double>(s.task.camera, s.task.jacobian_sign, s.input.image, s.input.pose.position, s.input.R_BE)
      .matrix();
}

}  // namespace

TEST_CASE(
    "tau = J^T K_p xi~ - K_v sgn(chi-dot) + G - tau_f (14), (15), with tau_f the 49-rule sum at u = a g, b g-dot") {
  Random random(7701);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 100; ++trial) {
    CAPTURE(trial);
    const Situation s = random_situation(random);
    const Hybrid::Evaluation<double> out = s.evaluate();

    const Eigen::Matrix<double, 8, 6> J = jacobian_of(s);
    const Eigen::Matrix<double, 8, 8> Kp = s.gains.kp.asDiagonal();
    const Vector6<double> g = J.transpose() * Kp * (s.task.desired_features - s.input.image.features);
    const Vector6<double> g_rate = -J.transpose() * Kp * J * s.input.twist;
    Vector6<double> tau_f, switched;
    for (int j = 0; j < 6; ++j) {
      const double u = std::clamp(s.gains.fuzzy.error_scale(j) * g(j), -1.0, 1.0);
      const double u_rate = std::clamp(s.gains.fuzzy.rate_scale(j) * g_rate(j), -1.0, 1.0);
      double weighted = 0.0, sum = 0.0;
      for (int row = 0; row < 7; ++row)
        for (int column = 0; column < 7; ++column) {
          const auto mu = [](double x, int k) { return 1.0 / (1.0 + std::pow(6.0 * (x - (k - 3) / 3.0), 4)); };
          const double strength = mu(u, row) * mu(u_rate, column);
          weighted += weight_matrix(s.weights, j)(row, column) * strength;
          sum += strength;
        }
      tau_f(j) = weighted / sum;
      switched(j) = s.gains.kv(j) * std::tanh(s.input.twist(j) / 1e-2);
    }
    CHECK(distance(out.fuzzy_output.head<3>(), tau_f.head<3>()) <= 1e-12 * 1e-2);  // weights are at most 1e-2 N
    CHECK(distance(out.fuzzy_output.tail<3>(), tau_f.tail<3>()) <= 1e-12 * 1e-3);
    const Vector6<double> tau = g - switched + s.task.gravity_wrench - tau_f;
    // g sums eight products of up to f/Z * Kp * 200 px
    CHECK(distance(out.wrench, tau) <= 1e-13 + 1e-12 * g.cwiseAbs().maxCoeff());
    CHECK(g.cwiseAbs().maxCoeff() > 1e-3);
    CHECK(tau_f.cwiseAbs().maxCoeff() > 1e-5);
  }
}

TEST_CASE(
    "adaptation (22): Psi_j omega-dot_j = chi-dot_j phi-bar_j, and tau_f = omega^T phi-bar with the same phi-bar") {
  Random random(7702);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 50; ++trial) {
    const Situation s = random_situation(random);
    const Hybrid::Evaluation<double> out = s.evaluate();
    const TermStrengths<double> error = normalised(out.rate.basis.error), rate = normalised(out.rate.basis.rate);
    for (int j = 0; j < 6; ++j) {
      double sum = 0.0, output = 0.0;
      for (std::size_t row = 0; row < 7; ++row)
        for (std::size_t column = 0; column < 7; ++column) {
          const double phi = error[row](j) * rate[column](j);
          const double weight_rate =
              out.rate.strength(j) * out.rate.basis.error[row](j) * out.rate.basis.rate[column](j);
          sum += weight_rate;
          output += weight_matrix(s.weights, j)(static_cast<int>(row), static_cast<int>(column)) * phi;
          // the sums of seven, in another order here, are most of the rounding
          CHECK(s.gains.fuzzy.adaptation(j) * weight_rate ==
                doctest::Approx(s.input.twist(j) * phi).epsilon(25.0 * kEpsilon));
        }
      CHECK(sum == doctest::Approx(s.input.twist(j) / s.gains.fuzzy.adaptation(j)).epsilon(1e-13));
      CHECK(std::abs(out.fuzzy_output(j) - output) <= 1e-15);
    }
  }
}

TEST_CASE(
    "Lyapunov identity (23): with a true Jacobian V falls by exactly K_v sgn(chi-dot) . chi-dot, whatever the "
    "weights") {
  // V = 1/2 chi-dot^T D chi-dot + 1/2 xi~^T K_p xi~ + 1/2 sum_j Psi_j |omega_j|^2, the paper's (16) with omega* = 0.
  // Along (1): V-dot = chi-dot . (tau - G) - xi~^T K_p J chi-dot + sum_j Psi_j omega_j . omega-dot_j (Property 1 used).
  Random random(7703);
  CAPTURE(random.seed());
  for (const SwitchingKind kind : {SwitchingKind::sign, SwitchingKind::tanh, SwitchingKind::saturation})
    for (int trial = 0; trial < 100; ++trial) {
      CAPTURE(trial);
      Situation s = random_situation(random);
      s.task.switching.kind = kind;
      const Hybrid::Evaluation<double> out = s.evaluate();
      const Vector6<double>& twist = s.input.twist;
      const Vector<double, 8> error = s.task.desired_features - s.input.image.features;
      const double kinetic = twist.dot(out.wrench - s.task.gravity_wrench);
      const double image = -error.dot(s.gains.kp.cwiseProduct(jacobian_of(s) * twist));
      double weights = 0.0;
      for (int j = 0; j < 6; ++j)
        for (std::size_t row = 0; row < 7; ++row)
          for (std::size_t column = 0; column < 7; ++column)
            weights += s.gains.fuzzy.adaptation(j) *
                       weight_matrix(s.weights, j)(static_cast<int>(row), static_cast<int>(column)) *
                       out.rate.strength(j) * out.rate.basis.error[row](j) * out.rate.basis.rate[column](j);
      const double dissipated = twist.dot(s.gains.kv.cwiseProduct(s.task.switching(twist)));
      CHECK(dissipated > 0.0);
      // four terms cancel; their parts are sums of at most 64 products
      const double parts = std::abs(kinetic) + std::abs(image) + std::abs(weights) + dissipated;
      CHECK(std::abs(kinetic + image + weights + dissipated) <= 1e-12 * parts);
    }
}

TEST_CASE("at the goal, at rest, with zero fuzzy weights the law holds the weight only") {
  Random random(7704);
  CAPTURE(random.seed());
  Situation s = random_situation(random);
  s.task.desired_features = s.input.image.features;
  s.input.twist.setZero();
  s.weights.fill(Vector6<double>(Vector6<double>::Zero()));
  for (const SwitchingKind kind : {SwitchingKind::sign, SwitchingKind::tanh, SwitchingKind::saturation}) {
    s.task.switching.kind = kind;
    const Hybrid::Evaluation<double> out = s.evaluate();
    CHECK(out.wrench == s.task.gravity_wrench);
    CHECK(out.rate.strength.vector().isZero(0.0));
  }
}

TEST_CASE("without fuzzy systems there is no tau_f and no adaptation, and the rest of the law is the same") {
  Random random(7705);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 20; ++trial) {
    Situation s = random_situation(random);
    const Hybrid::Evaluation<double> with = s.evaluate();
    s.gains.fuzzy.enabled = false;
    const Hybrid::Evaluation<double> without = s.evaluate();
    CHECK(without.fuzzy_output.isZero(0.0));
    CHECK(distance(without.wrench, with.wrench + with.fuzzy_output) <= 1e-15);
    FuzzyWeights<double> weights = s.weights;
    Hybrid::advance<double>(Hybrid::Constants<double>(s.gains), weights,
                            std::array<const FuzzyRate<double>*, 1>{&without.rate}, std::array<double, 1>{1.0}, true);
    for (std::size_t i = 0; i < weights.size(); ++i) CHECK(distance(weights[i], s.weights[i]) == 0.0);
  }
}

TEST_CASE("the initial state of the law is s_0 times the table") {
  HybridGains<double> gains;
  gains.fuzzy.initial_scale << 1, 2, 3, 4, 5, 6;
  const FuzzyWeights<double> weights = Hybrid::initial_state(gains);
  for (int j = 0; j < 6; ++j) CHECK(weight_matrix(weights, j) == (j + 1.0) * linear_rule_table());
}

TEST_CASE("NaN in any sensor value or gain comes out as NaN, never as a plausible wrench") {
  Random random(7706);
  CAPTURE(random.seed());
  const std::vector<std::pair<std::string, std::function<void(Situation&)>>> places = {
      {"feature", [](Situation& s) { s.input.image.features(3) = kNaN; }},
      {"depth", [](Situation& s) { s.input.image.depth(2) = kNaN; }},
      {"attitude", [](Situation& s) { s.input.R_BE(1, 2) = kNaN; }},
      {"twist", [](Situation& s) { s.input.twist(4) = kNaN; }},
      {"desired feature", [](Situation& s) { s.task.desired_features(7) = kNaN; }},
      {"weight", [](Situation& s) { s.weights[11].set(5, kNaN); }},
      {"kp", [](Situation& s) { s.gains.kp(0) = kNaN; }},
      {"kv", [](Situation& s) { s.gains.kv(1) = kNaN; }},
  };
  for (const auto& [place, spoil] : places)
    for (const SwitchingKind kind : {SwitchingKind::sign, SwitchingKind::tanh, SwitchingKind::saturation}) {
      CAPTURE(place);
      Situation s = random_situation(random);
      s.task.switching.kind = kind;
      REQUIRE_FALSE(s.evaluate().wrench.hasNaN());
      spoil(s);
      CHECK(s.evaluate().wrench.hasNaN());
    }
}

TEST_CASE("switching functions: odd, limited to +-1, dissipative, and sgn in the limit") {
  Random random(7707);
  CAPTURE(random.seed());
  for (const SwitchingKind kind : {SwitchingKind::sign, SwitchingKind::tanh, SwitchingKind::saturation}) {
    const Switching<double> wide{kind, 1e-2}, narrow{kind, 1e-9};
    CHECK(wide(Vector6<double>::Zero()) == Vector6<double>::Zero());
    for (int trial = 0; trial < 100; ++trial) {
      const Vector6<double> x = random.matrix<6>(0.05);
      const Vector6<double> y = wide(x);
      CHECK(wide(-x) == -y);
      CHECK(y.cwiseAbs().maxCoeff() <= 1.0);
      CHECK(x.cwiseProduct(y).minCoeff() > 0.0);
      CHECK(distance(narrow(x), x.cwiseSign()) <= kEpsilon);
      for (int j = 0; j < 6; ++j) {
        if (kind == SwitchingKind::sign) CHECK(y(j) == (x(j) > 0.0 ? 1.0 : -1.0));
        if (kind == SwitchingKind::tanh) CHECK(y(j) == doctest::Approx(std::tanh(x(j) / 1e-2)).epsilon(4.0 * kEpsilon));
        if (kind == SwitchingKind::saturation) CHECK(y(j) == std::clamp(x(j) / 1e-2, -1.0, 1.0));
      }
    }
    CHECK(wide(Vector6<double>::Constant(kNaN)).hasNaN());
    CHECK(wide(Vector6<double>::Constant(kInfinity)) == Vector6<double>::Ones());
  }
}

TEST_CASE("a pack evaluates each lane as double does") {
  Random random(7708);
  CAPTURE(random.seed());
  using S = Lanes<4>;
  ControlTask<S> task;
  HybridGains<S> gains;
  FuzzyWeights<S> weights;
  Sensed<S> input;
  std::array<Situation, 4> situations;
  for (int lane = 0; lane < 4; ++lane) {
    Situation& s = situations[static_cast<std::size_t>(lane)];
    s = random_situation(random);
    set_lane(task.camera.focal, lane, s.task.camera.focal);
    set_lane(task.jacobian_sign, lane, s.task.jacobian_sign);
    set_lane(task.desired_features, lane, s.task.desired_features);
    set_lane(task.gravity_wrench, lane, s.task.gravity_wrench);
    set_lane(task.switching, lane, s.task.switching);
    set_lane(gains, lane, s.gains);
    for (std::size_t r = 0; r < weights.size(); ++r)
      for (int j = 0; j < 6; ++j) weights[r].part[static_cast<std::size_t>(j)].set(lane, s.weights[r](j));
    set_lane(input.image, lane, s.input.image);
    set_lane(input.R_BE, lane, s.input.R_BE);
    set_lane(input.twist, lane, s.input.twist);
  }
  const Hybrid::Evaluation<S> out = evaluate_hybrid(task, gains, weights, input);
  for (int lane = 0; lane < 4; ++lane) {
    CAPTURE(lane);
    const Hybrid::Evaluation<double> single = situations[static_cast<std::size_t>(lane)].evaluate();
    CHECK(distance(lane_of(out.wrench, lane), single.wrench) <= 1e-14);
    CHECK(distance(lane_of(out.fuzzy_output, lane), single.fuzzy_output) <= 1e-15);
    const Vector6<double> strength = single.rate.strength.vector();
    CHECK(distance(lane_of(out.rate.strength, lane), strength) <= 4.0 * kEpsilon * strength.cwiseAbs().maxCoeff());
  }
}

TEST_CASE("gains that make no sense are refused, with the key and the place") {
  const auto verdict = [](const std::function<void(GainsOf<Hybrid>&)>& change) {
    GainsOf<Hybrid> gains;
    change(gains);
    return refusal([&] { validate_gains<Hybrid>(gains); });
  };
  CHECK(verdict([](GainsOf<Hybrid>&) {}) == "(accepted)");
  CHECK(verdict([](GainsOf<Hybrid>& g) { g.kv.setZero(); }) == "(accepted)");
  for (const double bad : {kNaN, kInfinity, 0.0, -1e-6})
    for (int i = 0; i < 8; ++i)
      CHECK(is_about(verdict([&](GainsOf<Hybrid>& g) { g.kp(i) = bad; }),
                     "controller.hybrid.kp[" + std::to_string(i) + "]"));
  for (const double bad : {kNaN, kInfinity, -1e-6})
    for (int j = 0; j < 6; ++j)
      CHECK(is_about(verdict([&](GainsOf<Hybrid>& g) { g.kv(j) = bad; }), "controller.hybrid.kv"));
  CHECK(is_about(verdict([](GainsOf<Hybrid>& g) { g.fuzzy.bell_width = 0.0; }), "controller.hybrid.fuzzy.bell_width"));
}
