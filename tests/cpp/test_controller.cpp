// The servo tick: the law by other means, safe output for whatever comes in, no allocation, and the loop it closes.
#include "hexservo/controller.hpp"

#include "../../examples/gains.hpp"
#include "allocations.hpp"
#include "compare.hpp"
#include "decompositions.hpp"
#include "laws.hpp"
#include "random.hpp"
#include "scenarios.hpp"

#include <array>
#include <bit>
#include <cstdint>
#include <string>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

using Gains = ControllerGains<Hybrid>;
using State = ControllerState<Hybrid>;

static_assert(noexcept(step(std::declval<const Gains&>(), std::declval<State&>(),
                            std::declval<const ControllerInput&>())));

constexpr double kPeriod = 1e-3;
#ifdef __SANITIZE_ADDRESS__
constexpr std::size_t kTicks = 64'000;  // slow there, and the same code
#else
constexpr std::size_t kTicks = 1'024'000;
#endif

/// The paper's gains, with weights that start away from zero.
Settings settings_for(SwitchingKind kind, bool fuzzy = true) {
  Settings settings = paper_settings();
  settings.controller.switching = {kind, 1e-3};
  settings.gains<Hybrid>().fuzzy.enabled = fuzzy;
  settings.gains<Hybrid>().fuzzy.initial_scale << 0.01, -0.01, 0.02, -1e-3, 1e-3, 2e-3;  // also weights of -0
  return settings;
}

/// A pose, twist and image of a robot at work.
template <class Law>
ControllerInput random_input(Random& random, const ControllerGains<Law>& gains) {
  ControllerInput input;
  input.frame.exposure = 0.0;
  input.frame.image.features = random.matrix<8>(80.0);
  for (int i = 0; i < 4; ++i) input.frame.image.depth(i) = -random.uniform(0.3, 0.8);
  input.pose.position = gains.hexapod.home_position + random.matrix<3>(0.02);
  input.pose.quaternion =
      Vector4<double>(1.0, random.uniform(-0.1, 0.1), random.uniform(-0.1, 0.1), random.uniform(-0.1, 0.1)) *
      random.uniform(0.5, 2.0);
  input.twist = random.six(0.02, 0.2);
  return input;
}

/// The same, with an image of the controller's target.
template <class Law>
ControllerInput seen_input(Random& random, const ControllerGains<Law>& gains) {
  ControllerInput input = random_input(random, gains);
  input.frame.image = take_image(gains.task.camera, input.pose.position, rotation_matrix(input.pose.quaternion),
                                 gains.task.target.points_T);
  return input;
}

/// Every number that an input holds.
std::array<double*, 25> entries(ControllerInput& input) {
  std::array<double*, 25> all{};
  std::size_t n = 0;
  const auto add = [&](auto& m) {
    for (Eigen::Index i = 0; i < m.size(); ++i) all[n++] = &m(i);
  };
  add(input.frame.image.features);
  add(input.frame.image.depth);
  add(input.pose.position);
  add(input.pose.quaternion);
  add(input.twist);
  REQUIRE(n == all.size());
  return all;
}

bool same_bits(double a, double b) { return std::bit_cast<std::uint64_t>(a) == std::bit_cast<std::uint64_t>(b); }

template <class A, class B>
bool same_bits(const Eigen::MatrixBase<A>& a, const Eigen::MatrixBase<B>& b) {
  for (Eigen::Index i = 0; i < a.size(); ++i)
    if (!same_bits(a(i), b(i))) return false;
  return true;
}

bool same_bits(const FuzzyWeights<double>& a, const FuzzyWeights<double>& b) {
  for (std::size_t r = 0; r < a.size(); ++r)
    if (!same_bits(a[r].vector(), b[r].vector())) return false;
  return true;
}

bool same_bits(const NoState<double>& /*a*/, const NoState<double>& /*b*/) { return true; }

bool same_bits(const PoseMemory<double>& a, const PoseMemory<double>& b) {
  return same_bits(a.rough.position, b.rough.position) && same_bits(a.rough.quaternion, b.rough.quaternion) &&
         same_bits(a.found.position, b.found.position) && same_bits(a.found.quaternion, b.found.quaternion);
}

template <class Law>
bool same_bits(const ControllerState<Law>& a, const ControllerState<Law>& b) {
  if (!same_bits(a.law, b.law)) return false;
  return same_bits(a.last_pose.position, b.last_pose.position) &&
         same_bits(a.last_pose.quaternion, b.last_pose.quaternion);
}

bool same_bits(const ControllerOutput& a, const ControllerOutput& b) {
  return same_bits(a.wrench, b.wrench) && same_bits(a.leg_forces, b.leg_forces) &&
         same_bits(a.fuzzy_output, b.fuzzy_output) && a.status == b.status;
}

/// Leg forces by Eigen's pivoted LU of H itself, with no help of the core's solver.
Vector6<double> forces_by_lu(const Hexapod<double>& hexapod, const Pose<double>& pose, const Vector6<double>& wrench) {
  const Vector4<double> q = pose.quaternion.normalized();
  const Matrix3<double> R_BE = Eigen::Quaterniond(q(0), q(1), q(2), q(3)).toRotationMatrix();
  Matrix6<double> H;
  for (int i = 0; i < 6; ++i) {
    const Vector3<double> arm = R_BE * hexapod.platform_joints_E.col(i);
    const Vector3<double> c = (pose.position + arm - hexapod.base_joints_B.col(i)).normalized();
    H.col(i) << c, arm.cross(c);
  }
  return solve_by_lu(H, wrench);
}

/// How many of the `entries` are those of the image.
constexpr std::size_t kImageEntries = 12;

/// Requires the safe output for `input`, and that nothing is learned from it.
/// @param joints whether pose and twist can be used: the platform then brakes, and otherwise G holds it
template <class Law>
void require_safe(const ControllerGains<Law>& gains, const ControllerState<Law>& state, const ControllerInput& input,
                  bool joints) {
  ControllerState<Law> after = state;
  const ControllerOutput out = step(gains, after, input);
  REQUIRE(out.invalid_input());
  REQUIRE(same_bits(out.fuzzy_output, Vector6<double>::Zero()));
  const Vector6<double> weight = gravity_wrench(RigidBody<double>{});
  if (joints) {
    REQUIRE(distance(out.wrench, weight - brake_of(gains, input)) <= 1e-15);
    REQUIRE(same_bits(after.stop_pose.position, input.pose.position));
  } else {
    REQUIRE(same_bits(out.wrench, weight));
    REQUIRE(same_bits(after, state));
  }
  // H H^T is solved, so that errors grow with the square of H's condition: (20)^2 at the worst of these poses
  REQUIRE(relative_distance(out.leg_forces, forces_by_lu(gains.hexapod, joints ? input.pose : state.last_pose,
                                                         out.wrench)) <= 1000.0 * kEpsilon);
  REQUIRE(same_bits(after.law, state.law));
}

}  // namespace

TEST_CASE("a valid tick is the law at its input, forward Euler of all 294 weights, and leg forces by H itself") {
  for (const SwitchingKind kind : {SwitchingKind::sign, SwitchingKind::tanh, SwitchingKind::saturation})
    for (const bool fuzzy : {true, false}) {
      CAPTURE(static_cast<int>(kind));
      CAPTURE(fuzzy);
      const Settings settings = settings_for(kind, fuzzy);
      const Gains gains = controller_gains<Hybrid>(settings, kPeriod);
      const double f = settings.camera.focal();
      State state = initial_state(gains);
      Random random(71);
      CAPTURE(random.seed());
      double largest_change = 0.0;
      for (int tick = 0; tick < 200; ++tick) {
        CAPTURE(tick);
        const ControllerInput input = random_input(random, gains);
        const FuzzyWeights<double> weights = state.law;

        // the gains as the scenario has them, not as `controller_gains` passed them on
        const Vector4<double> q = input.pose.quaternion.normalized();
        const Matrix3<double> R_BE = Eigen::Quaterniond(q(0), q(1), q(2), q(3)).toRotationMatrix();
        ControlTask<double> task{};
        task.camera = f;
        task.jacobian_sign = -1.0;
        task.desired_features = settings.target.desired_features;
        task.gravity_wrench = gravity_wrench(RigidBody<double>{});
        task.switching = settings.controller.switching;
        const auto law = evaluate_hybrid<double>(task, gains.law, weights, {input.frame.image, R_BE, input.twist});
        const ControllerOutput out = step(gains, state, input);
        REQUIRE_FALSE(out.invalid_input());
        REQUIRE(relative_distance(out.wrench, law.wrench) <= 100.0 * kEpsilon);
        REQUIRE(distance(out.fuzzy_output, law.fuzzy_output) <= 100.0 * kEpsilon);
        REQUIRE(relative_distance(out.leg_forces, forces_by_lu(gains.hexapod, input.pose, out.wrench)) <=
                1000.0 * kEpsilon);
        REQUIRE(same_bits(state.last_pose.position, input.pose.position));
        REQUIRE(same_bits(state.last_pose.quaternion, input.pose.quaternion));

        const TermStrengths<double> u = normalised(law.rate.basis.error), u_rate = normalised(law.rate.basis.rate);
        for (int axis = 0; axis < kAxes; ++axis) {
          const Matrix7<double> before = weight_matrix(weights, axis), after = weight_matrix(state.law, axis);
          Matrix7<double> expected = before;
          if (fuzzy)
            for (int r = 0; r < kTerms; ++r)
              for (int c = 0; c < kTerms; ++c)
                expected(r, c) += kPeriod * (input.twist(axis) / settings.gains<Hybrid>().fuzzy.adaptation(axis)) *
                                  u[static_cast<std::size_t>(r)](axis) * u_rate[static_cast<std::size_t>(c)](axis);
          REQUIRE(distance(after, expected) <= 4.0 * kEpsilon * expected.cwiseAbs().maxCoeff());
          largest_change = std::max(largest_change, distance(after, before));
        }
      }
      CHECK((largest_change > 1e-7) == fuzzy);
    }
}

TEST_CASE("the length of the quaternion has no meaning") {
  const Gains gains = controller_gains<Hybrid>(settings_for(SwitchingKind::tanh), kPeriod);
  Random random(72);
  CAPTURE(random.seed());
  for (int i = 0; i < 100; ++i) {
    const ControllerInput input = random_input(random, gains);
    State first = initial_state(gains);
    const ControllerOutput expected = step(gains, first, input);
    REQUIRE_FALSE(expected.invalid_input());
    for (const double scale : {0x1p-400, 0x1p-1, -1.0, 0x1p+7, 0x1p+400}) {  // powers of two: not one bit changes
      CAPTURE(scale);
      ControllerInput scaled = input;
      scaled.pose.quaternion *= scale;
      State second = initial_state(gains);
      const ControllerOutput out = step(gains, second, scaled);
      REQUIRE(same_bits(out, expected));
      REQUIRE(same_bits(second.law[17].vector(), first.law[17].vector()));
    }
    ControllerInput scaled = input;
    scaled.pose.quaternion *= random.uniform(0.01, 100.0);
    State second = initial_state(gains);
    REQUIRE(relative_distance(step(gains, second, scaled).leg_forces, expected.leg_forces) <= 1000.0 * kEpsilon);
  }
}

TEST_CASE("NaN or infinity in any entry gives the safe output, by the last valid pose or home, and changes nothing") {
  for (const bool fuzzy : {true, false}) {
    CAPTURE(fuzzy);
    const Gains gains = controller_gains<Hybrid>(settings_for(SwitchingKind::sign, fuzzy), kPeriod);
    Random random(73);
    CAPTURE(random.seed());
    const State fresh = initial_state(gains);
    State used = fresh;
    ControllerInput last;
    for (int i = 0; i < 10; ++i) {
      last = random_input(random, gains);
      REQUIRE_FALSE(step(gains, used, last).invalid_input());
    }
    const ControllerInput good = random_input(random, gains);
    for (std::size_t entry = 0; entry < 25; ++entry) {
      CAPTURE(entry);
      const bool joints = entry < kImageEntries;
      for (const double value : {kNaN, kInfinity, -kInfinity}) {
        CAPTURE(value);
        ControllerInput bad = good;
        *entries(bad)[entry] = value;
        require_safe(gains, fresh, bad, joints);
        if (entry >= 8 || !std::isnan(value)) {
          require_safe(gains, used, bad, joints);
        } else {  // a point that lacks a coordinate was not seen: its last image is used
          State after = used;
          REQUIRE_FALSE(step(gains, after, bad).invalid_input());
        }
      }
    }
    ControllerInput nothing = good;
    for (double* entry : entries(nothing)) *entry = kNaN;
    require_safe(gains, used, nothing, false);
  }
}

TEST_CASE("every law: NaN or infinity in any entry gives the safe output, and good input a finite one") {
  Laws::for_each([]<class Law>(std::type_identity<Law>) {
    if constexpr (Law::traits.output == LawOutput::pose) return;  // whose legs stop and stay
    CAPTURE(Law::traits.name);
    const ControllerGains<Law> gains = controller_gains<Law>(paper_settings<Law>(), kPeriod);
    Random random(80);
    CAPTURE(random.seed());
    ControllerState<Law> state = initial_state(gains);
    ControllerInput last;
    for (int i = 0; i < 10; ++i) {
      last = seen_input(random, gains);
      const ControllerOutput out = step(gains, state, last);
      REQUIRE_FALSE(out.invalid_input());
      REQUIRE(is_finite(out.wrench));
      REQUIRE(is_finite(out.leg_forces));
    }
    const ControllerInput good = seen_input(random, gains);
    for (std::size_t entry = 0; entry < 25; ++entry) {
      CAPTURE(entry);
      for (const double value : {kNaN, kInfinity, -kInfinity}) {
        CAPTURE(value);
        ControllerInput bad = good;
        *entries(bad)[entry] = value;
        const bool joints = entry < kImageEntries;
        require_safe(gains, initial_state(gains), bad, joints);
        if (entry >= 8 || !std::isnan(value)) require_safe(gains, state, bad, joints);
      }
    }
  });
}

TEST_CASE("a reading that is wrong by itself is not held, whichever of the first ones without the law it is") {
  Settings settings = settings_for(SwitchingKind::tanh);
  settings.controller.safe.hold = (Vector6<double>() << 200.0, 200.0, 200.0, 2.0, 2.0, 2.0).finished();
  const Gains gains = controller_gains<Hybrid>(settings, kPeriod);
  for (int trial = 0; trial < 15; ++trial)
    for (int ticks_of_one = 1; ticks_of_one <= 3; ++ticks_of_one) {  // a slower sensor repeats its poses
      const int wrong = trial % 5;
      const bool aside = trial / 5 != 1, turned = trial / 5 != 2;  // both, the attitude alone, the position alone
      CAPTURE(wrong);
      CAPTURE(aside);
      CAPTURE(turned);
      CAPTURE(ticks_of_one);
      Random random(79);
      CAPTURE(random.seed());
      State state = initial_state(gains);
      ControllerInput input = seen_input(random, gains);
      input.now = input.frame.exposure = 0.0;
      input.twist.setZero();
      REQUIRE_FALSE(step(gains, state, input).invalid_input());
      const Pose<double> rest = input.pose;
      const Vector6<double> weight = gravity_wrench(gains.body);
      for (int tick = 0; tick < 30; ++tick) {
        CAPTURE(tick);
        const int reading = tick / ticks_of_one;
        if (tick % ticks_of_one == 0) {
          input.pose = rest;
          input.pose.position += random.matrix<3>(1e-7);  // noise
          if (reading == wrong) {                         // off by 50 mm, and turned the other way about
            if (aside) input.pose.position(0) += 0.05;
            if (turned) input.pose.quaternion(1) *= -1.0;
          }
        }
        input.now = input.frame.exposure = tick + 1.0;
        input.frame.image.depth(0) = 1.0;  // behind the camera
        const ControllerOutput out = step(gains, state, input);
        REQUIRE(out.invalid_input());
        if (reading >= 3 && reading != wrong) CHECK(distance(out.wrench, weight) <= 2.0 * 200.0 * 2e-7);
      }
    }
}

TEST_CASE("each stretch without the law is held where it begins, with the gains as given: G - K_s v - K_h away") {
  Settings settings = settings_for(SwitchingKind::tanh);
  settings.controller.safe.damping = (Vector6<double>() << 1.0, 2.0, 3.0, 0.04, 0.05, 0.06).finished();
  settings.controller.safe.hold = (Vector6<double>() << 100.0, 200.0, 300.0, 4.0, 5.0, 6.0).finished();
  const Gains gains = controller_gains<Hybrid>(settings, kPeriod);
  Random random(81);
  CAPTURE(random.seed());
  State state = initial_state(gains);
  const Vector6<double> weight = gravity_wrench(gains.body);
  for (int stretch = 0; stretch < 3; ++stretch) {
    CAPTURE(stretch);
    ControllerInput input = seen_input(random, gains);
    REQUIRE_FALSE(step(gains, state, input).invalid_input());
    input.frame.image.depth(0) = 1.0;  // behind the camera
    const Pose<double> begin = input.pose = unit_pose(input.pose);
    for (int tick = 0; tick < 3; ++tick) {
      CAPTURE(tick);
      const Vector6<double> away = static_cast<double>(tick) * random.six(1e-3, 1e-2);
      input.pose = moved(begin, away);
      input.twist = random.six(0.02, 0.2);
      const Vector6<double> expected = weight - settings.controller.safe.damping->cwiseProduct(input.twist) -
                                       settings.controller.safe.hold->cwiseProduct(away);
      const ControllerOutput out = step(gains, state, input);
      REQUIRE(out.invalid_input());
      CHECK(distance(out.wrench, expected) <= 1e-12);
    }
    const Pose<double> last = input.pose;
    input.twist(0) = kNaN;  // the joints are not known any more: the weight is held as at the last pose that was
    const ControllerOutput out = step(gains, state, input);
    CHECK(same_bits(out.wrench, weight));
    CHECK(relative_distance(out.leg_forces, forces_by_lu(gains.hexapod, last, weight)) <= 1000.0 * kEpsilon);
  }
}

TEST_CASE("a clock that stands still for long stops a law that predicts") {
  Settings settings = settings_for(SwitchingKind::sign);
  settings.simulation.mode = LoopMode::sampled;
  settings.camera.prediction = Prediction::encoder;
  const Gains gains = controller_gains<Hybrid>(settings, kPeriod);
  State state = initial_state(gains);
  Random random(80);
  CAPTURE(random.seed());
  ControllerInput input = random_input(random, gains);
  input.now = input.frame.exposure = 5.0;
  for (std::size_t tick = 0; tick < 40; ++tick)
    REQUIRE(step(gains, state, input).invalid_input() == (tick > kStandingTicks));
  input.now = 6.0;
  REQUIRE_FALSE(step(gains, state, input).invalid_input());
}

TEST_CASE("what a fresh input does not have is not known") {
  const Gains gains = controller_gains<Hybrid>(settings_for(SwitchingKind::sign), kPeriod);
  Random random(81);
  CAPTURE(random.seed());
  const ControllerInput good = random_input(random, gains);
  for (int part = 0; part < 4; ++part) {
    State state = initial_state(gains);
    ControllerInput input;
    input.now = input.frame.exposure = good.now;
    input.frame.image = good.frame.image;
    input.twist = good.twist;
    input.pose = good.pose;
    if (part == 1) input.frame.image = ControllerInput{}.frame.image;
    if (part == 2) input.pose = ControllerInput{}.pose;
    if (part == 3) input.frame.image.features.tail<2>() = ControllerInput{}.frame.image.features.tail<2>();
    const InputStatus expected[] = {InputStatus::valid, InputStatus::missing_image, InputStatus::unusable,
                                    InputStatus::missing_image};
    CHECK(step(gains, state, input).status == expected[part]);
  }
}

TEST_CASE("errors of the camera that act in sampled mode alone do not change the tick of a continuous scenario") {
  const Settings settings = settings_for(SwitchingKind::saturation);
  Settings wrong = settings;
  wrong.uncertainty.focal_length = 0.05;
  wrong.uncertainty.principal_point << 3.0, -2.0;
  Settings sampled = settings, sampled_wrong = wrong;
  sampled.simulation.mode = sampled_wrong.simulation.mode = LoopMode::sampled;
  Random random(75);
  CAPTURE(random.seed());
  const Gains gains = controller_gains<Hybrid>(settings, kPeriod);
  const ControllerInput input = random_input(random, gains);
  const auto wrench = [&](const Settings& of) {
    const Gains prepared = controller_gains<Hybrid>(of, kPeriod);
    State state = initial_state(prepared);
    return step(prepared, state, input).wrench;
  };
  CHECK(same_bits(wrench(wrong), wrench(settings)));
  CHECK_FALSE(same_bits(wrench(sampled_wrong), wrench(sampled)));
}

TEST_CASE("overflow, values beyond the limits of divergence and points behind the camera give the safe output") {
  const Gains gains = controller_gains<Hybrid>(settings_for(SwitchingKind::saturation), kPeriod);
  Random random(74);
  CAPTURE(random.seed());
  State state = initial_state(gains);
  const ControllerInput last = random_input(random, gains);
  REQUIRE_FALSE(step(gains, state, last).invalid_input());
  const ControllerInput good = random_input(random, gains);
  const auto require_refused = [&](const std::string& what, auto&& change) {
    CAPTURE(what);
    ControllerInput bad = good;
    change(bad);
    require_safe(gains, state, bad, what == "feature" || what == "depth");
  };

  for (int i = 0; i < 8; ++i) {
    CAPTURE(i);
    const double goal = gains.task.desired_features(i);
    for (const double value : {1e308, -1e308, goal + 1.001 * kMaxFeatureError, goal - 1.001 * kMaxFeatureError})
      require_refused("feature", [&](ControllerInput& bad) { bad.frame.image.features(i) = value; });
  }
  for (int i = 0; i < 6; ++i) {
    CAPTURE(i);
    for (const double value : {1e308, -1e308, 1.001 * kMaxTwist, -1.001 * kMaxTwist})
      require_refused("twist", [&](ControllerInput& bad) { bad.twist(i) = value; });
  }
  for (int i = 0; i < 3; ++i) {
    CAPTURE(i);
    for (const double value : {1e308, -1e308, 1e150, 1e12})
      require_refused("position", [&](ControllerInput& bad) { bad.pose.position(i) = value; });
  }
  for (int i = 0; i < 4; ++i) {
    CAPTURE(i);
    for (const double value : {1e308, 1.0, 1e-300, 0.0, -0.0, -1e-320, -1e-308})  // the last two: 1/Z overflows
      require_refused("depth", [&](ControllerInput& bad) { bad.frame.image.depth(i) = value; });
    require_refused("quaternion", [&](ControllerInput& bad) { bad.pose.quaternion(i) = 1e308; });
  }
  require_refused("no quaternion", [](ControllerInput& bad) { bad.pose.quaternion.setZero(); });
  require_refused("one without a length", [](ControllerInput& bad) { bad.pose.quaternion *= 1e-170; });
  require_refused("one whose length overflows", [](ControllerInput& bad) {
    bad.pose.quaternion << 1.2e154, 1.2e154, 0.0, 0.0;  // its squares do not
  });

  // a point far away is one
  ControllerInput far = good;
  far.frame.image.depth(2) = -1e308;
  CHECK_FALSE(step(gains, state, far).invalid_input());
}

TEST_CASE("a frame from the future is refused, but for rounding") {
  for (const Prediction prediction : {Prediction::none, Prediction::encoder}) {
    Settings settings = settings_for(SwitchingKind::tanh);
    settings.simulation.mode = LoopMode::sampled;
    settings.camera.prediction = prediction;
    const Gains gains = controller_gains<Hybrid>(settings, kPeriod);
    Random random(82);
    CAPTURE(random.seed());
    State state = initial_state(gains);
    ControllerInput input = seen_input(random, gains);
    for (const double ahead : {0.0, 1e-7, 2e-6, 1.0}) {  // [ticks]
      CAPTURE(ahead);
      input.now += kPeriod;
      input.frame.exposure = input.now + ahead * kPeriod;
      const ControllerOutput out = step(gains, state, input);
      CHECK(out.status == (ahead > 1e-6 ? InputStatus::unusable : InputStatus::valid));
      CHECK(out.wrench.allFinite());
    }
  }
}

TEST_CASE("a singular pose and forces that overflow give the safe output") {
  Settings settings = settings_for(SwitchingKind::sign);
  Gains gains = controller_gains<Hybrid>(settings, kPeriod);
  Random random(75);
  CAPTURE(random.seed());
  const ControllerInput last = random_input(random, gains);
  State state = initial_state(gains);
  REQUIRE_FALSE(step(gains, state, last).invalid_input());

  ControllerInput singular = last;
  singular.pose.position << 0.0, 0.0, 0.0;  // platform in the plane of the base: no leg pushes along z
  singular.pose.quaternion << 1.0, 0.0, 0.0, 0.0;
  REQUIRE(wrench_map_singular_values(gains.hexapod, singular.pose)(5) < 1e-12);
  require_safe(gains, state, singular, false);

  // a quarter turn about z, singular in another way
  singular.pose.position = gains.hexapod.home_position;
  singular.pose.quaternion << std::sqrt(0.5), 0.0, 0.0, std::sqrt(0.5);
  REQUIRE(wrench_map_singular_values(gains.hexapod, singular.pose)(5) < 1e-12);
  require_safe(gains, state, singular, false);

  int overflows = 0;
  for (double exponent = 300.0; exponent < 308.0; exponent += 0.01) {  // up to wrench or leg forces, and beyond
    CAPTURE(exponent);
    gains.law.kp.setConstant(std::pow(10.0, exponent));
    State after = state;
    const ControllerOutput out = step(gains, after, last);
    REQUIRE(is_finite(out.wrench));
    REQUIRE(is_finite(out.leg_forces));
    if (!out.invalid_input()) continue;
    require_safe(gains, state, last, true);
    ++overflows;
  }
  CHECK(overflows > 100);
  CHECK(overflows < 700);
}

TEST_CASE("after bad ticks the next good one gives, bit for bit, what it would have given without them") {
  for (const SwitchingKind kind : {SwitchingKind::sign, SwitchingKind::tanh, SwitchingKind::saturation}) {
    CAPTURE(static_cast<int>(kind));
    const Gains gains = controller_gains<Hybrid>(settings_for(kind), kPeriod);
    Random random(76);
    CAPTURE(random.seed());
    State clean = initial_state(gains), disturbed = clean;
    int bad_ticks = 0;
    for (int i = 0; i < 500; ++i) {
      CAPTURE(i);
      const ControllerInput input = random_input(random, gains);
      while (random.uniform(0.0, 1.0) < 0.4) {
        ControllerInput bad = random_input(random, gains);
        const auto entry = static_cast<std::size_t>(random.uniform(0.0, 25.0));
        // NaN in a feature is a point that was not seen
        *entries(bad)[entry] = entry >= 8 && random.uniform(0.0, 1.0) < 0.5 ? kNaN : 1e308;
        bad.frame.image.depth(0) = std::abs(bad.frame.image.depth(0));  // also where 1e308 m of depth would do
        REQUIRE(step(gains, disturbed, bad).invalid_input());
        ++bad_ticks;
      }
      const ControllerOutput expected = step(gains, clean, input);
      REQUIRE_FALSE(expected.invalid_input());
      REQUIRE(same_bits(step(gains, disturbed, input), expected));
      REQUIRE(same_bits(disturbed, clean));
    }
    CHECK(bad_ticks > 200);
  }
}

TEST_CASE("a million ticks allocate nothing, valid or not, in every switching mode, with and without fuzzy systems") {
  const long long at_start = allocations;
  std::vector<int> probe(1);  // the counter counts
  REQUIRE(allocations > at_start);
  REQUIRE(probe.size() == 1);

  struct Mode {
    SwitchingKind switching;
    bool fuzzy;
    double slope;
  };
  using enum SwitchingKind;
  for (const Mode& mode :
       {Mode{sign, true, 2.0}, Mode{tanh, true, 2.0}, Mode{saturation, true, 2.0}, Mode{sign, false, 2.0},
        Mode{tanh, false, 2.0}, Mode{saturation, false, 2.0}, Mode{sign, true, 1.5}}) {  // the last one with pow
    Settings settings = settings_for(mode.switching, mode.fuzzy);
    settings.gains<Hybrid>().fuzzy.bell_slope = mode.slope;
    const Gains gains = controller_gains<Hybrid>(settings, kPeriod);
    Random random(77);
    std::array<ControllerInput, 64> inputs;
    for (ControllerInput& input : inputs) input = random_input(random, gains);
    inputs[13].twist(4) = kNaN;
    inputs[31].pose.position.setZero();
    inputs[31].pose.quaternion << 1.0, 0.0, 0.0, 0.0;  // singular

    std::size_t invalid = 0;
    const long long before = allocations;
    State state = initial_state(gains);
    for (std::size_t i = 0; i < kTicks; ++i) invalid += step(gains, state, inputs[i % 64]).invalid_input() ? 1U : 0U;
    const long long made = allocations - before;
    CAPTURE(static_cast<int>(mode.switching));
    CAPTURE(mode.fuzzy);
    CAPTURE(mode.slope);
    CHECK(made == 0);
    CHECK(invalid == 2 * kTicks / 64);
  }
}

TEST_CASE("no law allocates in a tick, valid or not") {
  Laws::for_each([]<class Law>(std::type_identity<Law>) {
    CAPTURE(Law::traits.name);
    const ControllerGains<Law> gains = controller_gains<Law>(paper_settings<Law>(), kPeriod);
    Random random(81);
    std::array<ControllerInput, 64> inputs;
    for (ControllerInput& input : inputs) input = seen_input(random, gains);
    inputs[13].twist(4) = kNaN;
    constexpr std::size_t kRounds = kTicks / 16 / 64;  // all 64 inputs each: the number of ticks need not be
    std::size_t invalid = 0;
    ControllerState<Law> state = initial_state(gains);  // which takes the memory that a law needs
    const long long before = allocations;
    for (std::size_t i = 0; i < kRounds * 64; ++i)
      invalid += step(gains, state, inputs[i % 64]).invalid_input() ? 1U : 0U;
    CHECK(allocations - before == 0);
    CHECK(invalid == kRounds);
  });
}

TEST_CASE("a tick in a loop with the plant tends to the continuous loop, at first order in the period") {
  constexpr double kDuration = 0.1;
  Settings settings = paper_settings();
  settings.controller.switching = {SwitchingKind::tanh, 1.0};  // smooth over a step, as in the loop's own test of order
  settings.gains<Hybrid>().fuzzy.error_scale *= 0.1;           // no input of a fuzzy system at its limit
  settings.gains<Hybrid>().fuzzy.rate_scale *= 0.1;
  settings.simulation.step = 1e-4;
  settings.simulation.duration = kDuration;
  const LoopParameters<double, Hybrid> p = loop_parameters<Hybrid>(settings);
  ClosedLoop<double, Hybrid> continuous(p);
  for (int i = 0; i < 1000; ++i) continuous.advance();
  REQUIRE(continuous.record().running());
  const Sample<double>& truth = continuous.record().sample();
  const BodyState<double> true_body = body_state<double>({truth.position, truth.quaternion}, truth.twist);

  std::array<double, 2> previous{};
  for (const int ticks : {200, 400, 800, 1600}) {
    CAPTURE(ticks);
    const double period = kDuration / ticks;
    const Gains gains = controller_gains<Hybrid>(settings, period);
    State state = initial_state(gains);
    const Plant<double> plant(p.body, p.dynamics_error);
    BodyMotion<double> body = BodyMotion<double>::at_rest({p.hexapod.home_position, {1.0, 0.0, 0.0, 0.0}});
    for (int tick = 0; tick < ticks; ++tick) {
      const Matrix3<double> R_BE = rotation_matrix(quaternion_of(body));
      const Image<double> image = take_image(p.camera.focal, position_of(body), R_BE, p.points_T);
      const ControllerInput input =
          input_of(tick * period,
                   {measured_image(image, p.depth_error), {position_of(body), quaternion_of(body)}, twist_of(body)});
      const ControllerOutput out = step(gains, state, input);
      REQUIRE_FALSE(out.invalid_input());
      // the wrench of a tick holds until the next one, and is what the leg forces give
      runge_kutta_step(period, body, [&](const BodyMotion<double>& b) {
        return body_rate(plant, b, rotation_matrix(quaternion_of(b)), out.wrench);
      });
      normalise_quaternion(body);
    }
    double weight_error = 0.0;
    for (std::size_t r = 0; r < state.law.size(); ++r)
      weight_error = std::max(weight_error, distance(state.law[r], continuous.law_state()[r]));
    const std::array<double, 2> error = {(body.state() - true_body).norm(), weight_error};
    for (std::size_t i = 0; i < 2; ++i) {
      CAPTURE(i);
      CAPTURE(error[i]);
      if (ticks > 200) {
        CHECK(previous[i] / error[i] > 1.8);
        CHECK(previous[i] / error[i] < 2.2);
      }
      CHECK(error[i] > 0.0);
    }
    previous = error;
  }
}

TEST_CASE("gains carry the estimates alone: errors between estimates and plant do not enter") {
  Settings settings = settings_for(SwitchingKind::sign);
  const Gains gains = controller_gains<Hybrid>(settings, kPeriod);
  settings.uncertainty = {};
  settings.uncertainty.gravity.setConstant(0.2);
  const Gains others = controller_gains<Hybrid>(settings, kPeriod);
  Random random(78);
  CAPTURE(random.seed());
  State first = initial_state(gains), second = initial_state(others);
  for (int i = 0; i < 20; ++i) {
    const ControllerInput input = random_input(random, gains);
    REQUIRE(same_bits(step(gains, first, input), step(others, second, input)));
  }
}

TEST_CASE("the exported gains of the example are those of the scenario, bit for bit") {
  const Gains exported = hexservo_paper::controller_gains();
  CHECK(exported.period == 1e-3);
  const Gains gains = controller_gains<Hybrid>(paper_settings(), 1e-3);
  CHECK(exported.hexapod.stroke == gains.hexapod.stroke);
  CHECK(exported.hexapod.force_limit == gains.hexapod.force_limit);
  Random random(79);
  CAPTURE(random.seed());
  State first = initial_state(exported), second = initial_state(gains);
  CHECK(same_bits(first, second));
  for (int i = 0; i < 100; ++i) {
    const ControllerInput input = random_input(random, gains);
    REQUIRE(same_bits(step(exported, first, input), step(gains, second, input)));
  }
  CHECK(same_bits(first, second));
}

TEST_CASE("misuse is refused where the gains are made") {
  for (const double period : {0.0, -1e-3, kNaN, kInfinity})
    CHECK(is_about(refusal([&] { controller_gains<Hybrid>(paper_settings(), period); }), "period"));
  Settings settings = paper_settings();
  settings.gains<Hybrid>().kp(3) = -1.0;
  CHECK(is_about(refusal([&] { controller_gains<Hybrid>(settings, kPeriod); }), "controller.hybrid.kp"));
}
