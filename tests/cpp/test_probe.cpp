// The parts of a loop at given states: the loop itself, bit for bit, and misuse.
#include "hexservo/probe.hpp"

#include "compare.hpp"
#include "random.hpp"
#include "scenarios.hpp"

#include <array>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

constexpr std::size_t kWeightCount = 6 * 7 * 7;

template <int k>
Rows rows(const Vector<double, k>& v) {
  return {v.data(), static_cast<std::size_t>(k)};
}
template <int k>
Column column(Vector<double, k>& v) {
  return {v.data(), static_cast<std::size_t>(k)};
}

std::vector<double> numbers_of(const FuzzyWeights<double>& weights) {
  std::vector<double> numbers;
  for (int axis = 0; axis < 6; ++axis)
    for (int row = 0; row < 7; ++row)
      for (int c = 0; c < 7; ++c) numbers.push_back(weights[rule(row, c)](axis));
  return numbers;
}

/// Room for the stages of one step.
struct Stages {
  std::vector<double> features = std::vector<double>(32), depth = std::vector<double>(16),
                      position = std::vector<double>(12), quaternion = std::vector<double>(16),
                      twist = std::vector<double>(24), wrench = std::vector<double>(24),
                      fuzzy_output = std::vector<double>(24), acceleration = std::vector<double>(24),
                      next_weights = std::vector<double>(kWeightCount);
  Vector<double, 8> next_features;
  Vector<double, 4> next_depth, next_quaternion;
  Vector3<double> next_position;
  Vector6<double> next_twist;

  ProbedStages out(bool fuzzy = true) {
    return {features,
            depth,
            position,
            quaternion,
            twist,
            wrench,
            fuzzy_output,
            acceleration,
            column(next_features),
            column(next_depth),
            column(next_position),
            column(next_quaternion),
            column(next_twist),
            fuzzy ? Column(next_weights) : Column{}};
  }
};

/// Whether the probe's numbers are the loop's, bit for bit. `pbvs` starts a fit where the last one ended, of which a
/// probe of one instant has none: there both are the same minimum, to the rounding of a fit.
template <class Law, class A, class B>
bool alike(const A& probed, const B& of_loop) {
  if constexpr (std::is_same_v<Law, Pbvs>) {
    using Numbers = Eigen::Map<const Eigen::VectorXd>;
    const Numbers a(std::data(probed), static_cast<Eigen::Index>(std::size(probed)));
    const Numbers b(std::data(of_loop), static_cast<Eigen::Index>(std::size(of_loop)));
    return (a - b).cwiseAbs().maxCoeff() <= 1e-10;
  } else {
    return probed == of_loop;
  }
}

/// Follows a loop for some steps, each of which the probe takes as well; the first that differs fails.
template <class Law>
void follow_law(const Settings& settings, int steps) {
  const LoopParameters<double, Law> p = loop_parameters<Law>(settings);
  ClosedLoop<double, Law> loop(p);
  const Probe probe(settings);
  constexpr bool fuzzy = requires { p.gains.fuzzy; };
  for (int i = 0; i < steps; ++i) {
    CAPTURE(i);
    const Sample<double> start = loop.record().sample();
    Vector<double, 8> features;
    Vector<double, 4> depth;
    probe.image(rows<3>(start.position), rows<4>(start.quaternion), column(features), column(depth));
    std::vector<double> weights;
    if constexpr (fuzzy) weights = numbers_of(loop.law_state());
    Stages s;
    probe.stages({rows(features), rows(depth), rows<3>(start.position), rows<4>(start.quaternion), rows<6>(start.twist),
                  weights},
                 s.out(fuzzy));
    const Vector6<double> wrench = Eigen::Map<Vector6<double>>(s.wrench.data());
    CHECK(alike<Law>(wrench, start.wrench));
    CHECK(Vector6<double>(Eigen::Map<Vector6<double>>(s.fuzzy_output.data())) == start.fuzzy_output);
    loop.advance();
    const Sample<double> end = loop.record().sample();
    REQUIRE(loop.record().running());
    CHECK(alike<Law>(s.next_position, end.position));
    CHECK(alike<Law>(s.next_quaternion, end.quaternion));
    CHECK(alike<Law>(s.next_twist, end.twist));
    CHECK(alike<Law>(s.next_depth, end.depth));
    const Vector<double, 8> error = p.desired_features - s.next_features;
    CHECK(alike<Law>(error, end.feature_error));
    if constexpr (fuzzy) CHECK(s.next_weights == numbers_of(loop.law_state()));
  }
}

void follow(const Settings& settings, int steps) {
  with_law(settings.law(), [&]<class Law>(std::type_identity<Law>) { follow_law<Law>(settings, steps); });
}

}  // namespace

TEST_CASE("stages: steps from the states of a loop are the loop's own, bit for bit, for all laws") {
  Settings hybrid = paper_settings();
  follow(hybrid, 200);
  hybrid.controller.switching = {SwitchingKind::tanh, 1e-3};
  hybrid.gains<Hybrid>().fuzzy.leakage.setConstant(3.0);
  hybrid.gains<Hybrid>().fuzzy.weight_limit.setConstant(1e-5);
  hybrid.gains<Hybrid>().fuzzy.dead_zone.setConstant(1e-3);
  follow(hybrid, 200);
  follow(paper_settings<Composite>(), 200);
  follow(paper_settings<Kelly>(), 100);
  follow(paper_settings<ResolvedRate>(), 100);
  follow(paper_settings<Pbvs>(), 100);
  follow(paper_settings<ComputedTorque>(), 100);
}

TEST_CASE("after and moved: four stages that are put together by hand are those of a step, bit for bit") {
  const Settings settings = paper_settings();
  const Probe probe(settings);
  Random random(71);
  CAPTURE(random.seed());
  const double h = settings.simulation.step;
  for (int i = 0; i < 50; ++i) {
    const Vector3<double> position = settings.robot.home_position + random.matrix<3>(0.01);
    const Vector4<double> quaternion = Vector4<double>(1.0, 0.0, 0.0, 0.0) + random.matrix<4>(0.1);
    const Vector6<double> twist = random.six(0.02, 0.2);
    Vector<double, 8> features;
    Vector<double, 4> depth;
    probe.image(rows(position), rows(quaternion), column(features), column(depth));
    Stages s;
    probe.stages({rows(features), rows(depth), rows(position), rows(quaternion), rows(twist)}, s.out());
    const Probe::Body start{rows(position), rows(quaternion), rows(twist)};
    for (std::size_t k = 0; k < 3; ++k) {
      Vector3<double> p;
      Vector4<double> q;
      Vector6<double> v;
      Probe::moved(start,
                   {Rows(s.quaternion).subspan(4 * k, 4), Rows(s.twist).subspan(6 * k, 6),
                    Rows(s.acceleration).subspan(6 * k, 6)},
                   k < 2 ? 0.5 * h : h, column(p), column(q), column(v));
      const auto at = [k](const std::vector<double>& values, std::size_t width) {
        return values.data() + width * (k + 1);
      };
      CHECK(p == Vector3<double>(Eigen::Map<const Vector3<double>>(at(s.position, 3))));
      CHECK(q == Vector4<double>(Eigen::Map<const Vector4<double>>(at(s.quaternion, 4))));
      CHECK(v == Vector6<double>(Eigen::Map<const Vector6<double>>(at(s.twist, 6))));
    }
    Vector3<double> p;
    Vector4<double> q;
    Vector6<double> v;
    Probe::after(start, {s.quaternion, s.twist, s.acceleration}, h, column(p), column(q), column(v));
    CHECK(p == s.next_position);
    CHECK(q == s.next_quaternion);
    CHECK(v == s.next_twist);
    CHECK(q.norm() == doctest::Approx(1.0).epsilon(4.0 * kEpsilon));
    // inside the step the quaternion keeps its length to first order, and is not scaled
    CHECK(std::abs(Eigen::Map<const Vector4<double>>(s.quaternion.data() + 12).norm() - quaternion.norm()) <= 1e-6);
  }
}

TEST_CASE("a step that takes a point behind the camera leaves no numbers") {
  const Settings settings = nominal_settings();
  const Probe probe(settings);
  const Vector3<double> home = settings.robot.home_position;
  const Vector4<double> upright(1.0, 0.0, 0.0, 0.0);
  Vector<double, 8> features;
  Vector<double, 4> depth;
  probe.image(rows(home), rows(upright), column(features), column(depth));
  for (const double speed : {-400.0, -600.0}) {  // towards the target, which is 0.5 m away, for 1 ms
    CAPTURE(speed);
    Vector6<double> twist = Vector6<double>::Zero();
    twist(2) = speed;
    Stages s;
    probe.stages({rows(features), rows(depth), rows(home), rows(upright), rows(twist)}, s.out());
    const bool seen = speed > -500.0;
    CHECK(s.next_position.hasNaN() != seen);
    CHECK(s.next_features.hasNaN() != seen);
    CHECK(std::isnan(s.next_weights[0]) != seen);
  }
}

TEST_CASE("what follows from a stage behind the camera is NaN, and what comes before it is not") {
  const Settings settings = nominal_settings();
  const Probe probe(settings);
  const Vector3<double> home = settings.robot.home_position;
  const Vector4<double> upright(1.0, 0.0, 0.0, 0.0);
  Vector<double, 8> features;
  Vector<double, 4> depth;
  probe.image(rows(home), rows(upright), column(features), column(depth));
  struct Case {
    double speed;        // towards the target, which is 0.5 m away [m/s]
    std::size_t behind;  // first stage of a step of 1 ms that has it behind: the second is half way, the fourth its end
  };
  for (const auto [speed, behind] : {Case{-400.0, 4}, Case{-600.0, 3}, Case{-1200.0, 1}}) {
    CAPTURE(speed);
    Vector6<double> twist = Vector6<double>::Zero();
    twist(2) = speed;
    Stages s;
    probe.stages({rows(features), rows(depth), rows(home), rows(upright), rows(twist)}, s.out());
    for (std::size_t k = 0; k < 4; ++k) {
      CAPTURE(k);
      const auto finite = [k](const std::vector<double>& values) {
        const std::size_t width = values.size() / 4;
        std::size_t count = 0;
        for (std::size_t i = 0; i < width; ++i)
          if (std::isfinite(values[width * k + i])) ++count;
        REQUIRE((count == 0 || count == width));
        return count > 0;
      };
      for (const auto* values : {&s.features, &s.wrench, &s.fuzzy_output, &s.acceleration})
        CHECK(finite(*values) == (k < behind));
      for (const auto* values : {&s.depth, &s.position, &s.quaternion, &s.twist})
        CHECK(finite(*values) == (k <= behind));
      if (k <= behind) CHECK((s.depth[4 * k] >= 0.0) == (k == behind));
    }
    CHECK(s.next_twist.hasNaN() == (behind < 4));
  }
}

TEST_CASE("quaternions whose squares are no numbers to divide by are refused") {
  const Probe probe(paper_settings());
  const Vector3<double> home = Settings::of<Hybrid>().robot.home_position;
  Vector<double, 8> features, scaled;
  Vector<double, 4> depth;
  const Vector4<double> direction(1.4, 1.2, -0.3, 0.2);
  probe.image(rows(home), rows(direction), column(features), column(depth));
  for (const double length : {1e-170, 1e-160, 1e-151, 1e-150, 1e-100, 1e100, 5e149, 1e150, 1e154, 1e160}) {
    CAPTURE(length);
    const Vector4<double> quaternion = length * direction;
    const std::string answer =
        refusal([&] { probe.image(rows(home), rows(quaternion), column(scaled), column(depth)); });
    if (length >= 1e-150 && length <= 5e149) {
      CHECK(answer == "(accepted)");
      CHECK(distance(scaled, features) <= 1e-9);
    } else {
      CHECK(is_about(answer, "quaternion[0]"));
    }
  }
}

TEST_CASE("rows that do not fit are refused by name, and so are numbers without a meaning") {
  const Probe probe(paper_settings());
  Vector<double, 8> features = Vector<double, 8>::Constant(10.0);
  Vector<double, 4> depth = Vector<double, 4>::Constant(-0.5), quaternion(1.0, 0.0, 0.0, 0.0);
  Vector3<double> position(0.0, 0.0, -0.15);
  Vector6<double> twist = Vector6<double>::Zero(), wrench;
  const std::vector<double> weights(kWeightCount);
  const auto law = [&] {
    return refusal([&] {
      probe.law({rows(features), rows(depth), rows(position), rows(quaternion), rows(twist), weights},
                {.wrench = column(wrench)});
    });
  };
  CHECK(law() == "(accepted)");
  twist(3) = kNaN;
  CHECK(is_about(law(), "twist[0]"));
  twist.setZero();
  depth(2) = 0.0;
  CHECK(is_about(law(), "depth[0]"));
  depth(2) = -0.5;
  quaternion.setZero();
  CHECK(is_about(law(), "quaternion[0]"));
  quaternion(0) = 1.0;
  CHECK(is_about(refusal([&] {
                   probe.law({rows(features), rows(depth), Rows(position.data(), 2), rows(quaternion), rows(twist)},
                             {.wrench = column(wrench)});
                 }),
                 "position"));
  CHECK(is_about(refusal([&] {
                   probe.law({rows(features), rows(depth), rows(position), rows(quaternion), rows(twist)},
                             {.wrench = Column(wrench.data(), 5)});
                 }),
                 "wrench"));
  const Probe without(paper_settings<Kelly>());
  CHECK_FALSE(without.has_fuzzy_systems());
  CHECK(is_about(refusal([&] {
                   without.law({rows(features), rows(depth), rows(position), rows(quaternion), rows(twist), weights},
                               {.wrench = column(wrench)});
                 }),
                 "weights"));
  Settings sampled = paper_settings();
  sampled.simulation.mode = LoopMode::sampled;
  Stages s;
  CHECK(is_about(refusal([&] {
                   Probe(sampled).stages({rows(features), rows(depth), rows(position), rows(quaternion), rows(twist)},
                                         s.out());
                 }),
                 "simulation.mode"));
  Settings printed = paper_settings();
  printed.camera.convention = CameraConvention::as_printed;
  CHECK(is_about(
      refusal([&] { Probe(printed).image(rows(position), rows(quaternion), column(features), column(depth)); }),
      "camera.convention"));
}

TEST_CASE("the parts that a law reports sum to its wrench, and those that it does not have are refused by name") {
  Random random(83);
  CAPTURE(random.seed());
  Laws::for_each([&]<class Law>(std::type_identity<Law>) {
    if constexpr (Law::traits.output == LawOutput::pose) return;  // there is no wrench of an instant
    CAPTURE(Law::traits.name);
    const Settings settings = paper_settings<Law>();
    const Probe probe(settings);
    CHECK(probe.traits().name == Law::traits.name);
    const Vector3<double> position = settings.robot.home_position + random.matrix<3>(0.01);
    const Vector4<double> quaternion = Vector4<double>(1.0, 0.0, 0.0, 0.0) + random.matrix<4>(0.1);
    const Vector6<double> twist = random.six(0.02, 0.2);
    Vector<double, 8> features;
    Vector<double, 4> depth;
    probe.image(rows(position), rows(quaternion), column(features), column(depth));
    const ProbeStates at{rows(features), rows(depth), rows(position), rows(quaternion), rows(twist)};
    Vector6<double> wrench;
    std::array<Vector6<double>, kLawParts> parts;
    ProbedLaw out{.wrench = column(wrench)};
    for (std::size_t part = 0; part < kLawParts; ++part) {
      const std::string name(kNamesOf<LawPart>[part]);
      const bool has = Law::traits.parts.has(static_cast<LawPart>(part));
      parts[part].setZero();
      ProbedLaw one{.wrench = column(wrench)};
      one.parts[part] = column(parts[part]);
      CHECK((has ? refusal([&] { probe.law(at, one); }) == "(accepted)"
                 : is_about(refusal([&] { probe.law(at, one); }), "parts." + name)));
      if (has) out.parts[part] = column(parts[part]);
    }
    probe.law(at, out);
    Vector6<double> sum = probe.gravity(), scale = probe.gravity().cwiseAbs();
    for (const Vector6<double>& part : parts) {
      sum += part;
      scale += part.cwiseAbs();
    }
    // ten roundings of the largest
    for (int j = 0; j < 6; ++j) CHECK(std::abs(sum(j) - wrench(j)) <= 10.0 * kEpsilon * scale(j));

    Vector6<double> error;
    ProbedLaw with_error{.wrench = column(wrench)};
    with_error.pose_error = column(error);
    CHECK((Law::traits.pose_error() ? refusal([&] { probe.law(at, with_error); }) == "(accepted)"
                                    : is_about(refusal([&] { probe.law(at, with_error); }), "pose_error")));
  });
}

TEST_CASE("acceleration of the base: that of its motion, at times that are not negative, and none in continuous mode") {
  Settings settings = paper_settings();
  settings.base_motion.kind = BaseMotionKind::noise;
  settings.base_motion.level.setConstant(0.01);
  const std::array<double, 2> times = {0.0, 0.1234};
  std::array<double, 6> found;
  Probe(settings).base_acceleration(times, found);
  for (const double a : found) CHECK(a == 0.0);
  settings.simulation.mode = LoopMode::sampled;
  const LoopParameters<double, Hybrid> p = loop_parameters<Hybrid>(settings);
  const BaseMotion<double> base(p.base_motion, p.seed);
  Probe(settings).base_acceleration(times, found);
  for (std::size_t i = 0; i < 2; ++i)
    for (int axis = 0; axis < 3; ++axis)
      CHECK(found[3 * i + static_cast<std::size_t>(axis)] == base.acceleration(times[i])(axis));
  CHECK(found[0] != 0.0);
  const std::array<double, 2> before = {0.0, -1e-3};
  CHECK(is_about(refusal([&] { Probe(settings).base_acceleration(before, found); }), "time[1]"));
}
