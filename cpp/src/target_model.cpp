#include "hexservo/target_model.hpp"

#include "check.hpp"

#include <numbers>

namespace hexservo {

namespace {

constexpr int kGoalRounds = 200;
constexpr double kGoalStep = 1e-9;      // a last correction below it is convergence [m; rad]
constexpr double kGoalResidual = 1e-6;  // no other start can do better than this [px]

}  // namespace

Pose<double> goal_pose(double f, const Eigen::Matrix<double, 3, kPoints>& points_B,
                       const Vector<double, 2 * kPoints>& desired_features, const Pose<double>& home) {
  Pose<double> best = home;
  double least = std::numeric_limits<double>::infinity(), last_step = least;
  for (const int eighths : {0, 1, -1, 2, -2, 3, -3, 4}) {  // Newton alone does not find half a turn
    const double half = eighths * std::numbers::pi / 8.0;
    Pose<double> start = home;
    start.quaternion = Vector4<double>(std::cos(half), 0.0, 0.0, std::sin(half));
    const PoseEstimate<double> found = estimate_pose(f, points_B, desired_features, start, kGoalRounds);
    const Image<double> image = take_image(f, found.pose.position, rotation_matrix(found.pose.quaternion), points_B);
    const double residual = (desired_features - image.features).cwiseAbs().maxCoeff();
    if (eighths == 0) last_step = found.step;
    const bool converged = !found.failed && found.step <= kGoalStep && image.depth.maxCoeff() < 0.0;
    if (!converged || !(residual < least)) continue;
    best = found.pose;
    least = residual;
    if (residual <= kGoalResidual) break;
  }
  if (!std::isfinite(least))
    detail::refuse(
        "target.desired_features",
        "features that the points show from some pose, where the controller believes them (Newton's method "
        "settles)",
        detail::words("none from home in ", kGoalRounds, " rounds, the last one of ", last_step, " m or rad"));
  return best;
}

}  // namespace hexservo
