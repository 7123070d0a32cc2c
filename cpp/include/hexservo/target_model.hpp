/// @file
/// What the controller believes of the target: where its points are in B, the pose that four features tell, and the
/// pose of the goal (docs/model.md, section 5).
#pragma once

#include "hexservo/camera.hpp"
#include "hexservo/cholesky.hpp"
#include "hexservo/rigid_body.hpp"

namespace hexservo {

/// Points that the controller takes the target for, and the goal that follows from them.
template <class S, int N = kPoints>
struct TargetModel {
  Eigen::Matrix<S, 3, N> points_B;  ///< P-hat_i in B [m]
  Pose<S> goal;                     ///< where P-hat give xi_d; home for laws that do not ask for it
  Vector<S, N> goal_inverse_depth;  ///< 1/Z of P-hat_i seen from `goal` [1/m]
};

/// P-hat_i: the image from home, lifted with the depths that the controller knows, (1 + delta_Z,i) Z_i, 3xN in B [m].
template <class S, int N>
Eigen::Matrix<S, 3, N> believed_points(const S& f, const Pose<S>& home, const Image<S, N>& seen_from_home,
                                       const Vector<S, N>& depth_error) {
  const Image<S, N> measured = measured_image(seen_from_home, depth_error);
  const Matrix3<S> R_BE = rotation_matrix(home.quaternion);
  Eigen::Matrix<S, 3, N> points_B;
  for (int i = 0; i < N; ++i)
    points_B.col(i) = home.position + rotate<S>(R_BE, back_project<S>(f, measured.features.template segment<2>(2 * i),
                                                                      measured.depth(i)));
  return points_B;
}

/// Those points with the goal, and their depths there.
template <class S, int N>
TargetModel<S, N> target_model(const S& f, const Eigen::Matrix<S, 3, N>& points_B, const Pose<S>& goal) {
  TargetModel<S, N> model{points_B, goal, {}};
  Image<S, N> image;
  take_image(f, goal.position, rotation_matrix(goal.quaternion), Vectors3<S, N>(points_B), image,
             model.goal_inverse_depth);
  return model;
}

inline constexpr int kPoseRounds = 6;     ///< of the estimate in a law, which starts near its solution
inline constexpr double kPoseStep = 0.5;  ///< largest step of a round, in mean depths and in rad

/// Pose that an image tells.
template <class S>
struct PoseEstimate {
  Pose<S> pose;    ///< in B; quaternion of unit length
  S step;          ///< length of the last correction, the larger of move and turn [m; rad]
  Mask<S> failed;  ///< a round could not be solved, or ended with a point that is not in front of the camera
};

/// Gauss-Newton on the reprojection error: the pose from which known points look as measured, in the least squares.
///
/// Always the same number of rounds. Each solves J^T J d = J^T (xi - xi(pose)) for a small displacement d in B,
/// shortens it to `kPoseStep`, and applies it (q <- q + 1/2 (0, d_theta) (x) q, normalised).
/// @param points_B in B [m]
/// @param features measured [px], by a camera that projects (`CameraConvention::eye_in_hand`)
/// @param start near the solution; its quaternion need not be of unit length
template <class S, int N>
PoseEstimate<S> estimate_pose(const S& f, const Eigen::Matrix<S, 3, N>& points_B, const Vector<S, 2 * N>& features,
                              const Pose<S>& start, int rounds = kPoseRounds) noexcept {
  using std::abs;
  using std::sqrt;
  PoseEstimate<S> estimate{start, S(0.0), Mask<S>(false)};
  Pose<S>& pose = estimate.pose;
  const Vectors3<S, N> points(points_B);
  for (int round = 0; round < rounds; ++round) {
    const Matrix3<S> R_BE = rotation_matrix(pose.quaternion);
    Vector<S, N> inverse_depth;
    Image<S, N> image;
    take_image(f, pose.position, R_BE, points, image, inverse_depth);
    const ImageJacobian<S, N> J(f, S(-1.0), image.features, inverse_depth, R_BE);
    const Cholesky<S, 6> solver(J.normal_matrix());
    Vector6<S> d = solver.solve(J.pull(features - image.features));

    S mean_depth(0.0), nearest = image.depth(0);
    for (int i = 0; i < N; ++i) {
      mean_depth += abs(image.depth(i)) * S(1.0 / N);
      nearest = max(nearest, image.depth(i));
    }
    const S move = sqrt(S(d.template head<3>().squaredNorm())), turn = sqrt(S(d.template tail<3>().squaredNorm()));
    const S length = max(S(move / mean_depth), turn);
    const S share = select(length > S(kPoseStep), S(S(kPoseStep) / length), S(1.0));
    d *= share;
    pose.position += d.template head<3>();
    pose.quaternion += quaternion_rate<S>(pose.quaternion, d.template tail<3>());
    pose.quaternion /= sqrt(S(pose.quaternion.squaredNorm()));
    estimate.failed = estimate.failed | solver.failed() | !(nearest < S(0.0));
    estimate.step = share * max(move, turn);
  }
  return estimate;
}

/// Pose where the believed points give the desired features, in the least squares; searched from home, and from home
/// turned about the optical axis, with as many rounds as it takes.
/// @throws std::invalid_argument where no start leads to one
Pose<double> goal_pose(double f, const Eigen::Matrix<double, 3, kPoints>& points_B,
                       const Vector<double, 2 * kPoints>& desired_features, const Pose<double>& home);

}  // namespace hexservo
