// The latency that frames do not carry: costs, interval and estimate by the formulas of docs/model.md, section 5.
#include "hexservo/latency_estimator.hpp"

#include "compare.hpp"
#include "random.hpp"

#include <Eigen/Geometry>

#include <array>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

constexpr double kPeriod = 0.005;  // [s], so that each candidate is a tick later than the one before
constexpr double kFocal = 1000.0;
using Costs = Vector<double, kLatencies>;

/// Reads the costs of an estimator, or replaces them: the first of its members.
struct CostsOf {
  Costs costs = Costs::Zero();
  bool replaces = false;

  template <class M>
  void finite(M& member) {
    if constexpr (std::is_same_v<M, Costs>) (replaces ? member : costs) = replaces ? costs : member;
  }
};

Costs costs_of(LatencyEstimator<double>& estimator) {
  CostsOf reader;
  estimator.for_each_member(reader);
  return reader.costs;
}

LatencyRange<double> range_of(const Costs& costs) {
  LatencyEstimator<double> estimator;
  CostsOf writer{costs, true};
  estimator.for_each_member(writer);
  return estimator.range();
}

Pose<double> pose_at(double tick) {
  const Eigen::Quaterniond turn(
      Eigen::AngleAxisd(0.2 * std::sin(0.05 * tick), Eigen::Vector3d(1.0, 2.0, -1.0).normalized()));
  return {Vector3<double>(0.02 * std::sin(0.03 * tick), 0.01 * std::cos(0.04 * tick), -0.15),
          {turn.w(), turn.x(), turn.y(), turn.z()}};
}

}  // namespace

TEST_CASE("costs of candidates are those of the second difference of three directions, over its variance") {
  const Vector3<double> home(0.03, -0.02, -0.12);
  constexpr double kNoise = 2e-3, kFirst = 20.0;  // [rad], tick of the first pose
  for (const double jitter : {0.0, 0.012}) {      // 0, or three candidates
    CAPTURE(jitter);
    Random random(7901);
    CAPTURE(random.seed());
    PoseHistory<double> poses(600);
    double tick = kFirst - 1.0;
    LatencyEstimator<double> estimator;
    Costs expected = Costs::Zero();
    std::array<std::array<Vector3<double>, kLatencies>, 3> u;  // of the newest frame, and of those before
    std::array<double, 3> t{};
    int frames = 0;
    for (const double stamp : {40.0, 52.0, 60.0, 75.0, 83.0, 284.0, 290.0, 310.0, 317.0}) {  // one gap of 1.005 s
      CAPTURE(stamp);
      while (tick < stamp) {
        tick += 1.0;
        poses.add(tick, pose_at(tick), true);
      }
      const Vector2<double> middle = random.matrix<2>(50.0);
      const double depth = -random.uniform(0.5, 0.6);
      u[2] = u[1], u[1] = u[0], t[2] = t[1], t[1] = t[0], t[0] = stamp, ++frames;
      for (int j = 0; j < kLatencies; ++j) {
        const Pose<double> pose = pose_at(std::max(stamp - j, kFirst));
        const Vector4<double>& q = pose.quaternion;
        const Eigen::Vector3d ray(-middle(0) / kFocal, -middle(1) / kFocal, 1.0);
        const Vector3<double> point = pose.position + Eigen::Quaterniond(q(0), q(1), q(2), q(3)) * (depth * ray);
        u[0][static_cast<std::size_t>(j)] = (point - home).normalized();
      }
      if (frames > 2 && t[0] - t[1] <= 200.0 && t[1] - t[2] <= 200.0) {
        const double rho = (t[0] - t[1]) / (t[1] - t[2]);
        std::vector<Vector3<double>> r;
        for (std::size_t j = 0; j < kLatencies; ++j) r.push_back((u[0][j] - u[1][j]) - rho * (u[1][j] - u[2][j]));
        double least = kInfinity, spread = 0.0, scatter = 0.0;
        for (std::size_t j = 0; j < kLatencies; ++j) {
          least = std::min(least, r[j].squaredNorm());
          spread = std::max(spread, (r[j] - r[0]).squaredNorm());
          if (jitter > 0.0 && j >= 3) scatter = std::max(scatter, (u[0][j] - u[0][j - 3]).squaredNorm());
        }
        const double variance =
            kNoise * kNoise * (1.0 + (1.0 + rho) * (1.0 + rho) + rho * rho) + 9e-4 * spread + scatter + least / 9.0;
        for (std::size_t j = 0; j < kLatencies; ++j) {
          double& cost = expected(static_cast<int>(j));
          cost = 0.998 * cost + (r[j].squaredNorm() - least) / variance;
        }
      }
      estimator.update(poses, CameraView<double>(kFocal), true, stamp, kPeriod, middle, depth, home, kNoise, jitter);
      CHECK(distance(costs_of(estimator), expected) <= 1e-9 * (1.0 + expected.maxCoeff()));
    }
    CHECK(expected.maxCoeff() > 1.0);
  }
}

TEST_CASE("the interval is a candidate wider than what costs less than 9, and the estimate its weighted mean") {
  const LatencyRange<double> nothing = range_of(Costs::Constant(3.0));
  CHECK(nothing.least == 0.0);
  CHECK(nothing.most == kMaxLatency);
  CHECK(nothing.estimate == doctest::Approx(0.5 * kMaxLatency).epsilon(1e-12));
  Costs costs = Costs::Constant(100.0);
  costs(20) = 5.0;  // the least; 9 more are no longer possible
  costs(21) = 8.0;
  costs(23) = 13.9;
  costs(24) = 14.1;
  const LatencyRange<double> range = range_of(costs);
  CHECK(range.least == doctest::Approx(0.095).epsilon(1e-12));
  CHECK(range.most == doctest::Approx(0.120).epsilon(1e-12));
  const double second = 4.0 / 9.0, third = (0.1 / 9.0) * (0.1 / 9.0);
  CHECK(range.estimate ==
        doctest::Approx((0.1 + second * 0.105 + third * 0.115) / (1.0 + second + third)).epsilon(1e-12));
}
