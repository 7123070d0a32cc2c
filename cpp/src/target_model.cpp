#include "hexservo/target_model.hpp"

#include "check.hpp"

#include <algorithm>
#include <numbers>

namespace hexservo {

namespace {

constexpr int kGoalRounds = 60;        // from each start
constexpr double kGoalMinimum = 4e-6;  // a fit whose first-order step would still gain more is no minimum [px^2]
constexpr double kGoalShare = 4.0;     // minima with squared residuals within it of the least count as equal
constexpr double kSameMinimum = 1e-6;  // minima whose distances from home differ by less are one
constexpr double kExactGoal = 1e-12;   // squared residuals below it are rounding [px^2]

/// Where a search begins: home, and home turned, moved and tilted, with the camera still facing the points.
std::vector<Pose<double>> goal_starts(const CameraView<double>& camera, const Vector3<double>& centroid,
                                      const Pose<double>& home) {
  using Turn = Eigen::AngleAxisd;
  const Matrix3<double> R_BE = rotation_matrix(home.quaternion);
  if (camera.on_base()) {  // the target moves past the camera as the camera would past the target
    const Placement<double> at = camera.carried(home.position, R_BE);
    std::vector<Pose<double>> starts = goal_starts({camera.f, at}, home.position + R_BE * centroid, home);
    for (Pose<double>& start : starts) start = opposite_motion(home, start);
    return starts;
  }
  const Matrix3<double> R_BC = camera.attitude(R_BE);
  const Vector3<double> centre = camera.centre(home.position, R_BE), arm = centre - home.position;
  const Vector3<double> sight = centroid - centre;
  const Vector4<double>& q = home.quaternion;
  const Eigen::Quaterniond attitude(q(0), q(1), q(2), q(3));
  std::vector<Pose<double>> starts;
  const auto add = [&](const Eigen::Quaterniond& turn, double depth) {
    const Eigen::Quaterniond turned = turn * attitude;
    // about the points' centroid, so that they stay in view
    starts.push_back(
        {centroid - depth * (turn * sight) - turn * arm, {turned.w(), turned.x(), turned.y(), turned.z()}});
  };
  const Vector3<double> axis = R_BC.col(2);
  for (const int eighths : {0, 1, -1, 2, -2, 3, -3, 4}) {
    const Turn turn(eighths * std::numbers::pi / 4.0, axis);
    // a camera that turns about its own axis does not move
    const Eigen::Quaterniond turned = turn * attitude;
    starts.push_back({centre - turn * arm, {turned.w(), turned.x(), turned.y(), turned.z()}});
    for (const double depth : {0.6, 1.6}) add(Eigen::Quaterniond(turn), depth);
  }
  for (const Vector3<double>& tilt : {Vector3<double>::UnitX().eval(), Vector3<double>::UnitY().eval()})
    for (const double angle : {0.5, -0.5}) add(Eigen::Quaterniond(Turn(angle, R_BC * tilt)), 1.0);
  return starts;
}

}  // namespace

template <int N>
std::vector<GoalMinimum> goal_minima(const CameraView<double>& camera, const Eigen::Matrix<double, 3, N>& points_T,
                                     const Vector<double, 2 * N>& desired_features, const Pose<double>& home,
                                     const PointWeights<double, N>& weights) {
  using Fit = PoseFit<double, N>;
  const Vectors3<double, N> points(points_T);
  Vector3<double> centroid = Vector3<double>::Zero();
  if constexpr (N == kPoints)
    centroid = points_T.rowwise().mean();
  else
    for (int i = 0; i < N; ++i) centroid += weights.share(i) * points_T.col(i);
  const PosePrior<double> none{home, Vector6<double>::Zero()};
  std::vector<GoalMinimum> found;
  double least = std::numeric_limits<double>::infinity();
  const auto keep = [&](const Fit& fit) {
    const ImageJacobian<double, N> J(camera, -1.0, fit.features, fit.inverse_depth, fit.pose.position, fit.R_BE);
    const Cholesky<double, 6> solver(J.normal_matrix(weights));
    const Vector<double, 2 * N> residual = desired_features - fit.features;
    const Vector6<double> gradient = J.pull(weights.times(residual)).vector();
    if (!std::isfinite(fit.squared_residual) || solver.failed() ||
        !(gradient.dot(solver.solve(gradient)) <= kGoalMinimum))
      return;
    found.push_back({fit.pose, fit.squared_residual, weights.largest(residual)});
    least = std::min(least, fit.squared_residual);
  };
  for (const Pose<double>& start : goal_starts(camera, centroid, home)) {
    const Fit fit = fit_pose<double, N>(camera, points, desired_features, none, start, {kGoalRounds}, weights);
    keep(fit);
    if (least <= kExactGoal) break;
    keep(fit_pose<double, N>(camera, points, desired_features, none,
                             mirrored_pose<double, N>(camera, points_T, fit.pose, weights), {kGoalRounds}, weights));
  }
  return found;
}

template <int N>
Pose<double> goal_pose(const CameraView<double>& camera, const Eigen::Matrix<double, 3, N>& points_T,
                       const Vector<double, 2 * N>& desired_features, const Pose<double>& home,
                       const PointWeights<double, N>& weights) {
  const std::vector<GoalMinimum> found = goal_minima<N>(camera, points_T, desired_features, home, weights);
  if (found.empty())
    detail::refuse("target.desired_features",
                   "features that determine a pose where the controller assumes the points (not all on one line)",
                   "none from home, turned, moved or tilted");
  const auto by_residual = [](const GoalMinimum& a, const GoalMinimum& b) {
    return a.squared_residual < b.squared_residual;
  };
  const double least = std::min_element(found.begin(), found.end(), by_residual)->squared_residual;
  const GoalMinimum* goal = nullptr;
  double nearest = std::numeric_limits<double>::infinity();
  for (const GoalMinimum& minimum : found) {
    if (minimum.squared_residual > std::max(kGoalShare * least, kExactGoal)) continue;
    if (minimum.squared_residual > least && minimum.largest_residual > kGoalResidual) continue;
    const double far = pose_difference(minimum.pose, home).norm();
    if (far < (1.0 - kSameMinimum) * nearest) {  // of starts that end at one minimum the first
      goal = &minimum;
      nearest = far;
    }
  }
  if (!(goal->largest_residual <= kGoalResidual))
    detail::refuse("target.desired_features",
                   detail::words("features that some pose gives within ", kGoalResidual,
                                 " px, where the controller assumes the points"),
                   detail::words("a residual of ", goal->largest_residual, " px at the best pose found"));
  return goal->pose;
}

#define HEXSERVO_HERE(N)                                                                                          \
  template std::vector<GoalMinimum> goal_minima<N>(const CameraView<double>&, const Eigen::Matrix<double, 3, N>&, \
                                                   const Vector<double, 2 * (N)>&, const Pose<double>&,           \
                                                   const PointWeights<double, N>&);                               \
  template Pose<double> goal_pose<N>(const CameraView<double>&, const Eigen::Matrix<double, 3, N>&,               \
                                     const Vector<double, 2 * (N)>&, const Pose<double>&,                         \
                                     const PointWeights<double, N>&);
HEXSERVO_HERE(kPoints)
HEXSERVO_HERE(kMostPoints)
#undef HEXSERVO_HERE

}  // namespace hexservo
