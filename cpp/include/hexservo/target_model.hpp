/// @file
/// The controller's target model: where its points are in T (B, or E for a camera on the base), the pose estimated from
/// features, and the pose of the goal (docs/model.md, section 5).
#pragma once

#include "hexservo/camera.hpp"
#include "hexservo/cholesky.hpp"
#include "hexservo/rigid_body.hpp"

#include <limits>
#include <vector>

namespace hexservo {

/// Points that the controller takes the target for, and the goal that follows from them.
template <class S, int N = kPoints>
struct TargetModel {
  Eigen::Matrix<S, 3, N> points_T;  ///< P-hat_i in T [m]
  Pose<S> goal;                     ///< where P-hat give xi_d; home for laws that do not ask for it
  Vector<S, N> goal_inverse_depth;  ///< 1/Z of P-hat_i seen from `goal` [1/m]
};

/// P-hat_i: the image from home, lifted with the controller's depth estimates, (1 + delta_Z,i) Z_i, 3xN in T [m].
template <class S, int N>
Eigen::Matrix<S, 3, N> believed_points(const CameraView<S>& camera, const Pose<S>& home,
                                       const Image<S, N>& seen_from_home, const Vector<S, N>& depth_error) {
  const Image<S, N> measured = measured_image(seen_from_home, depth_error);
  const Matrix3<S> R_BE = rotation_matrix(home.quaternion);
  Eigen::Matrix<S, 3, N> points_T;
  for (int i = 0; i < N; ++i)
    points_T.col(i) =
        lift<S>(camera, home.position, R_BE, measured.features.template segment<2>(2 * i), measured.depth(i));
  return points_T;
}

/// Those points with the goal, and their depths there.
template <class S, int N>
TargetModel<S, N> target_model(const CameraView<S>& camera, const Eigen::Matrix<S, 3, N>& points_T,
                               const Pose<S>& goal) {
  TargetModel<S, N> model{points_T, goal, {}};
  Image<S, N> image;
  take_image<S, N>(camera, goal.position, rotation_matrix(goal.quaternion), Vectors3<S, N>(points_T), image,
                   model.goal_inverse_depth);
  return model;
}

inline constexpr int kPoseRounds = 6;         ///< of Levenberg-Marquardt from the start of an estimate
inline constexpr int kMirrorRounds = 4;       ///< of those from the mirror image of what they find
inline constexpr int kPolishRounds = 9;       ///< of those from the better of the two
inline constexpr double kPoseStep = 0.5;      ///< largest first-order step of a round, in mean depths and in rad
inline constexpr double kPoseDamping = 1e-6;  ///< after the first step that is refused, times the diagonal of J^T J [1]
/// A step whose square is below the rounding of a pose: the last one of Newton's method [mean depths; rad].
inline constexpr double kSettledFit = 1e-8;
/// One whose square is below what a choice between two poses and a prior's share need [mean depths; rad].
inline constexpr double kRoughFit = 1e-4;
inline constexpr double kStraightStep = 1e-3;  ///< below it no line search can gain [mean depths; rad]
inline constexpr int kNearRounds = 4;          ///< of Newton's method from a start close to a minimum
inline constexpr double kNearStart = 1e-2;     ///< a start is not close beyond such a step [mean depths; rad]
// Where the features' curvature does not change a step of Newton's method by more than rounding:
inline constexpr double kStillFit = 1e-11;     ///< steps below it [mean depths; rad]
inline constexpr double kStraightFit = 1e-13;  ///< steps that are below it times the residual [px]
inline constexpr double kExactFit = 1e-8;      ///< residuals below it [px]
/// Sums of squares r^2 cannot be compared below this times r: some hundred roundings of features of 1e3 px [px].
inline constexpr double kResidualRounding = 1e-11;
/// The mirror image replaces the pose that was found from the start where its squared residual is below this share [1].
inline constexpr double kMirrorShare = 0.04;
/// Standard deviation of the image where the prior of an estimate has half of its weight [px].
inline constexpr double kPriorNoise = 0.02;
/// Below this one the image counts as exact: it is more than the prior's own pull bends an image by, 15 mm from home
/// [px].
inline constexpr double kExactImage = 0.002;
inline constexpr double kLeastPrior = 1e-6;  ///< share of the prior's weight that stays without noise [1]

/// What is known of a pose beside the image.
template <class S>
struct PosePrior {
  Pose<S> pose;       ///< expected, in B; quaternion of unit length
  Vector6<S> weight;  ///< diagonal of M, (sigma of a feature/sigma of a pose component)^2 [px^2/m^2; px^2/rad^2]

  /// e = pose - p: difference of the positions, then twice the vector part of q_pose (x) conj(q_p), in B [m; rad].
  Vector6<S> error(const Pose<S>& p) const noexcept {
    const Vector3<S> u = p.quaternion.template tail<3>(), v = pose.quaternion.template tail<3>();
    const S cosine = pose.quaternion.dot(p.quaternion);
    const S twice = select(cosine < S(0.0), S(-2.0), S(2.0));
    Vector6<S> e;
    e.template head<3>() = pose.position - p.position;
    e.template tail<3>() = twice * (p.quaternion(0) * v - pose.quaternion(0) * u + cross<S>(u, v));
    return e;
  }

  /// Half of what e^T M e falls by along a displacement, per m and rad, to first order.
  Vector6<S> gradient(const Vector6<S>& e) const noexcept {
    using std::sqrt;
    Vector6<S> slope = weight.cwiseProduct(e);
    const Vector3<S> half = S(0.5) * e.template tail<3>(), moment = slope.template tail<3>();
    const S cosine = sqrt(larger(S(S(1.0) - half.squaredNorm()), S(0.0)));
    slope.template tail<3>() = cosine * moment - cross<S>(half, moment);
    return slope;
  }

  /// Least 1/m_v and 1/m_theta of M: |v|^2 <= give_v |d|_M^2 of a displacement d = (v, theta), |theta|^2 likewise.
  Vector2<S> gives() const noexcept {
    const Vector6<S>& m = weight;
    return {S(1.0) / min(min(m(0), m(1)), m(2)), S(1.0) / min(min(m(3), m(4)), m(5))};
  }
};

/// Image predicted at a pose, and its distance from the measured image and from the prior.
template <class S, int N>
struct PoseFit {
  Pose<S> pose;                ///< in B; quaternion of unit length
  Matrix3<S> R_BE;             ///< of `pose`
  Vector<S, 2 * N> features;   ///< xi(pose) [px]
  Vector<S, N> inverse_depth;  ///< 1/Z_i [1/m]
  S squared_residual;      ///< |xi - xi(pose)|^2, weighed [px^2]; infinite where a point is not in front of the camera
  Vector6<S> prior_error;  ///< e of the prior [m; rad]
  S cost;                  ///< squared_residual + e^T M e [px^2]

  /// Takes over another fit in the lanes of `where`.
  void replace(const Mask<S>& where, const PoseFit& other) {
    pose = select_pose(where, other.pose, pose);
    R_BE = select(where, other.R_BE, R_BE);
    features = select(where, other.features, features);
    inverse_depth = select(where, other.inverse_depth, inverse_depth);
    squared_residual = select(where, other.squared_residual, squared_residual);
    prior_error = select(where, other.prior_error, prior_error);
    cost = select(where, other.cost, cost);
  }
};

/// The fit of one pose; NaN where a number is.
template <class S, int N>
PoseFit<S, N> pose_fit(const CameraView<S>& camera, const Vectors3<S, N>& points_T, const Vector<S, 2 * N>& measured,
                       const PosePrior<S>& prior, const Pose<S>& pose, const Matrix3<S>& R_BE,
                       const PointWeights<S, N>& weights = {}) noexcept {
  PoseFit<S, N> fit;
  fit.pose = pose;
  fit.R_BE = R_BE;
  Image<S, N> image;
  take_image<S, N>(camera, pose.position, fit.R_BE, points_T, image, fit.inverse_depth);
  S nearest = image.depth(0);
  for (int i = 1; i < N; ++i) nearest = max(nearest, image.depth(i));
  fit.features = image.features;
  const Vector<S, 2 * N> residual = measured - image.features;
  fit.squared_residual = select(nearest < S(0.0), S(weights.root_times(residual).squaredNorm()),
                                S(std::numeric_limits<double>::infinity()));
  fit.prior_error = prior.error(pose);
  fit.cost = fit.squared_residual + fit.prior_error.dot(prior.weight.cwiseProduct(fit.prior_error));
  return fit;
}

template <class S, int N>
PoseFit<S, N> pose_fit(const CameraView<S>& camera, const Vectors3<S, N>& points_T, const Vector<S, 2 * N>& measured,
                       const PosePrior<S>& prior, const Pose<S>& pose,
                       const PointWeights<S, N>& weights = {}) noexcept {
  return pose_fit<S, N>(camera, points_T, measured, prior, pose, rotation_matrix(pose.quaternion), weights);
}

/// A pose beside another one, and back: the difference number by number.
template <class S>
Pose<S> beside(const Pose<S>& pose, const Pose<S>& difference) noexcept {
  return {pose.position + difference.position, pose.quaternion + difference.quaternion};
}
template <class S>
Pose<S> from_to(const Pose<S>& from, const Pose<S>& to) noexcept {
  return {to.position - from.position, to.quaternion - from.quaternion};
}

/// Where along a displacement the residual is smallest, by the features' second-order model [1].
///
/// |r - t Jd - t^2/2 c|^2 is a quartic of t, whose minimum near 1 four rounds of a guarded Newton's method find.
/// @param r residual before [px]; @param Jd its first-order change; @param c second derivative of the features
template <class S, int M>
S quartic_line_search(const Vector<S, M>& r, const Vector<S, M>& Jd, const Vector<S, M>& c) noexcept {
  const S squared = Jd.squaredNorm(), slope = S(-2.0) * r.dot(Jd), bend = S(2.0) * (squared - r.dot(c)),
          third = S(3.0) * Jd.dot(c), fourth = c.squaredNorm();
  S t(1.0);
  for (int round = 0; round < 4; ++round) {
    const S first = slope + t * (bend + t * (third + t * fourth));
    const S second = larger(S(bend + t * (S(2.0) * third + t * S(3.0) * fourth)), S(S(0.3) * squared));
    t = clip(S(t - first / second), S(0.05), S(3.0));
  }
  return t;
}

/// Sum of r_i times the second derivative of feature i for a displacement (v, theta) in B: 6 x 6, its lower triangle.
///
/// With w = P_i - x_p, a displacement moves a point relative to the camera by -v - theta x w + theta x v
/// + theta x (theta x w)/2, in B. With g the gradient of the features, weighted by r, for a motion of the point, and
/// e_z the optical axis, their second derivative for that motion is -(g e_z^T + e_z g^T)/Z. Past a camera on the base
/// the points move the other way, by v + theta x w + theta x (theta x w)/2, without the mixed term.
/// @param r weights [px]
template <class S, int N>
Matrix6<S> feature_curvature(const CameraView<S>& camera, const PoseFit<S, N>& fit,
                             const Vector<S, 2 * N>& r) noexcept {
  using R = typename PointVector<S, N>::Register;
  const R f(camera.f);
  const bool on_base = camera.on_base();
  const Matrix3<S> attitude = camera.attitude_in_base(fit.R_BE);
  const Vector3<S> centre = camera.centre_in_base(fit.pose.position, fit.R_BE);
  const Matrix3<R> R_BC = broadcast<R>(attitude);
  const Vector3<R> axis = R_BC.col(2), arm = broadcast<R>(Vector3<S>(centre - fit.pose.position));
  const Pairs<S, N> features(fit.features), weights(r);
  const auto inverse_depths = PointVector<S, N>::load(fit.inverse_depth.data());
  Matrix6<R> sum = Matrix6<R>::Zero();
  for (std::size_t part = 0; part < PointVector<S, N>::registers; ++part) {
    const R x = features.x.part[part], y = features.y.part[part], rx = weights.x.part[part], ry = weights.y.part[part];
    const R inverse_depth = inverse_depths.part[part];
    const Vector3<R> g_C(R(-f * rx * inverse_depth), R(-f * ry * inverse_depth), R(-(x * rx + y * ry) * inverse_depth));
    const Vector3<R> g = rotate<R>(R_BC, g_C);
    const Vector3<R> w = arm + rotate<R>(R_BC, back_project<R>(f, Vector2<R>(x, y), R(R(1.0) / inverse_depth)));
    Vector6<R> a, b;
    a.template head<3>() = -g;
    a.template tail<3>() = cross<R>(g, w);
    b.template head<3>() = -inverse_depth * axis;
    b.template tail<3>() = inverse_depth * cross<R>(axis, w);
#pragma GCC unroll 6
    for (int column = 0; column < 6; ++column)
#pragma GCC unroll 6
      for (int row = column; row < 6; ++row) sum(row, column) -= a(row) * b(column) + b(row) * a(column);
    if (!on_base) {
      sum(4, 0) -= g(2);
      sum(5, 0) += g(1);
      sum(3, 1) += g(2);
      sum(5, 1) -= g(0);
      sum(3, 2) -= g(1);
      sum(4, 2) += g(0);
    }
    const R along = dot<R>(g, w);
#pragma GCC unroll 3
    for (int column = 0; column < 3; ++column) {
#pragma GCC unroll 3
      for (int row = column; row < 3; ++row)
        sum(3 + row, 3 + column) += R(0.5) * (g(row) * w(column) + w(row) * g(column));
      sum(3 + column, 3 + column) -= along;
    }
  }
  return lower_lane_sums<S>([&sum](int row, int column) { return sum(row, column); });
}

/// When a fit of a pose ends, beside its largest number of rounds.
template <class S>
struct FitEnd {
  int rounds;                 ///< at most
  double step = kSettledFit;  ///< a whole undamped step of Newton's method below it was the last one [mean depths; rad]
  S hopeless = S(std::numeric_limits<double>::infinity());  ///< a fit whose cost ends above it is of no use [px^2]
};

/// Levenberg-Marquardt on the reprojection error: the pose from which known points look as measured, in the least
/// squares, weighed against a prior: the minimum of C = |xi - xi(pose)|^2 + e^T M e, with the points' weights W. Never
/// worse than its start, but for `kResidualRounding`.
///
/// Each round solves (A + mu diag(A)) d = J^T (xi - xi(pose)) + M e, A = J^T J + M, for a small displacement d in B and
/// shortens it to `kPoseStep`. Where it is positive definite, Newton's matrix takes the place of A: it has the
/// `feature_curvature` of the residual as well, with which the last rounds converge quadratically. What the full step
/// changes beyond J d is the features' curvature along d, and `quartic_line_search` takes it into account where d is
/// longer than `kStraightStep`; the better of the two steps is applied if it lowers C. mu follows the ratio of actual
/// to expected decrease (Nielsen 1999), and is 0 after a decrease by what was expected, since it leaves a share of each
/// step. Where the expected decrease of C is below `kResidualRounding` sqrt(C), the costs differ by their rounding:
/// there the full step is applied, which follows the gradient alone, and the pose is found to rounding instead of its
/// square root.
///
/// A lane ends by itself (`FitEnd`), so that its pose does not depend on its neighbours; the rounds end with the last.
/// @param measured features [px], by a camera that projects (`CameraConvention::eye_in_hand`)
/// @param start its quaternion need not be of unit length
template <class S, int N>
PoseFit<S, N> fit_pose(const CameraView<S>& camera, const Vectors3<S, N>& points_T, const Vector<S, 2 * N>& measured,
                       const PosePrior<S>& prior, const Pose<S>& start, const FitEnd<S>& end,
                       const PointWeights<S, N>& weights = {}) noexcept {
  using std::abs;
  using std::sqrt;
  PoseFit<S, N> best = pose_fit<S, N>(camera, points_T, measured, prior, unit_pose(start), weights);
  S mu(0.0), growth(2.0);
  Mask<S> ended(false);
  for (int round = 0; round < end.rounds && !all(ended); ++round) {
    const ImageJacobian<S, N> J(camera, S(-1.0), best.features, best.inverse_depth, best.pose.position, best.R_BE);
    const Vector<S, 2 * N> residual = measured - best.features;
    const Vector6<S> gradient = J.pull(weights.times(residual)).vector() + prior.gradient(best.prior_error);
    Matrix6<S> A = J.normal_matrix(weights);
    A.diagonal() += prior.weight;
    const Mask<S> damped = mu > S(0.0);
    const Vector6<S> damping = mu * A.diagonal();
    A.diagonal() += damping;
    const Cholesky<S, 6> newton(Matrix6<S>(A - feature_curvature<S, N>(camera, best, weights.times(residual))));
    Vector6<S> d = newton.solve(gradient);
    Mask<S> unsolved = newton.failed();
    if (any(unsolved)) {
      const Cholesky<S, 6> gauss(A);
      d = select(unsolved, gauss.solve(gradient), d);
      unsolved = unsolved & gauss.failed();
    }

    S mean_depth(0.0);
    for (int i = 0; i < N; ++i) mean_depth += weights.share(i) / abs(best.inverse_depth(i));
    const S length = max(S(sqrt(S(d.template head<3>().squaredNorm())) / mean_depth),
                         S(sqrt(S(d.template tail<3>().squaredNorm()))));
    d *= select(length > S(kPoseStep), S(S(kPoseStep) / length), S(1.0));
    const PoseFit<S, N> full = pose_fit<S, N>(camera, points_T, measured, prior, stepped<S>(best.pose, d), weights);
    const S expected = larger(S(d.dot(damping.cwiseProduct(d) + gradient)), S(1e-300));
    const Mask<S> rounding = expected * expected < S(kResidualRounding * kResidualRounding) *
                                                       (best.cost + S(kResidualRounding * kResidualRounding));
    const Mask<S> straight = rounding | (length < S(kStraightStep));
    PoseFit<S, N> next = full;
    if (!all(straight | ended)) {
      const Vector<S, 2 * N> Jd = J.push(d), bend = S(2.0) * (full.features - best.features - Jd);
      const S t =
          quartic_line_search<S, 2 * N>(weights.root_times(residual), weights.root_times(Jd), weights.root_times(bend));
      const PoseFit<S, N> bent =
          pose_fit<S, N>(camera, points_T, measured, prior, stepped<S>(best.pose, t * d), weights);
      next.replace((bent.cost < full.cost) & !straight, bent);
    }

    const Mask<S> better = (rounding | (next.cost < best.cost)) & is_finite(next.cost) & !unsolved;
    const S surplus = S(2.0) * (best.cost - full.cost) / expected - S(1.0);
    const Mask<S> as_expected = rounding | (surplus > S(0.5)),
                  quadratic = better & straight & !newton.failed() & !damped;
    const Mask<S> hopeless =
        quadratic & as_expected & (expected < S(0.25) * best.cost) & (next.cost > S(2.0) * end.hopeless);
    best.replace(better & !ended, next);
    ended = ended | hopeless | (quadratic & (length < S(end.step)));
    const S slower = clip(S(S(1.0) - surplus * surplus * surplus), S(1.0 / 3.0), S(2.0)) * mu;
    mu = clip(select(better, select(as_expected, S(0.0), slower), S(larger(mu, S(kPoseDamping)) * growth)), S(0.0),
              S(1e8));
    growth = select(better, S(2.0), S(larger(S(1.0), S(S(2.0) * growth))));
  }
  return best;
}

/// X X'^-1 X of two poses: where a platform that carries the target is, if one that carries the camera from X to X'
/// gives the same image. Quaternions of unit length.
template <class S>
Pose<S> opposite_motion(const Pose<S>& from, const Pose<S>& to) noexcept {
  const Vector3<S> u = to.quaternion.template tail<3>(), v = from.quaternion.template tail<3>();
  const S cosine = from.quaternion.dot(to.quaternion);
  const Vector3<S> sine = to.quaternion(0) * v - from.quaternion(0) * u + cross<S>(u, v);  // of half the turn
  const Vector3<S> back =
      rotate_back<S>(rotation_matrix(to.quaternion), Vector3<S>(from.position - to.position));  // in E
  return {from.position + rotate<S>(rotation_matrix(from.quaternion), back),
          cosine * from.quaternion + S(2.0) * quaternion_rate<S>(from.quaternion, sine)};
}

/// The points in B of points fixed in E, at a pose of the platform.
template <class S, int N>
Eigen::Matrix<S, 3, N> carried_points(const Eigen::Matrix<S, 3, N>& points_E, const Pose<S>& pose) noexcept {
  const Matrix3<S> R_BE = rotation_matrix(pose.quaternion);
  Eigen::Matrix<S, 3, N> points_B;
  for (int i = 0; i < N; ++i) points_B.col(i) = pose.position + rotate<S>(R_BE, Vector3<S>(points_E.col(i)));
  return points_B;
}

template <class S, int N>
Pose<S> mirrored_pose(const CameraView<S>& camera, const Eigen::Matrix<S, 3, N>& points_T, const Pose<S>& pose,
                      const PointWeights<S, N>& weights = {}) noexcept;

namespace detail {

/// That of a camera on the base: the same for one that is carried, turned round.
template <class S, int N>
[[gnu::noinline, gnu::cold]] Pose<S> mirrored_target(const CameraView<S>& camera,
                                                     const Eigen::Matrix<S, 3, N>& points_E, const Pose<S>& pose,
                                                     const PointWeights<S, N>& weights) noexcept {
  const hexservo::Placement<S> at = camera.carried(pose.position, rotation_matrix(pose.quaternion));
  return opposite_motion<S>(pose,
                            mirrored_pose<S, N>({camera.f, at}, carried_points<S, N>(points_E, pose), pose, weights));
}

}  // namespace detail

/// The other pose of a planar target: the points turned about their centroid until their plane is mirrored about the
/// line of sight to it. To first order in their extent over their distance the image is the same.
///
/// The plane is that of the largest of their triangles (of many points: of those with their centroid and the point that
/// is farthest from it); NaN where they lie on a line.
template <class S, int N>
Pose<S> mirrored_pose(const CameraView<S>& camera, const Eigen::Matrix<S, 3, N>& points_T, const Pose<S>& pose,
                      const PointWeights<S, N>& weights) noexcept {
  using std::sqrt;
  if (camera.on_base()) [[unlikely]]
    return detail::mirrored_target<S, N>(camera, points_T, pose, weights);
  Vector3<S> centroid = Vector3<S>::Zero(), normal = Vector3<S>::Zero();
  for (int i = 0; i < N; ++i) centroid += weights.share(i) * points_T.col(i);
  const auto keep_larger = [&normal](const Vector3<S>& a, const Vector3<S>& b) {
    const Vector3<S> area = cross<S>(a, b);
    normal = select(area.squaredNorm() > normal.squaredNorm(), area, normal);
  };
  if constexpr (N == kPoints) {
    for (int i = 0; i < N; ++i)
      for (int j = 0; j < i; ++j)
        for (int k = 0; k < j; ++k) keep_larger(points_T.col(j) - points_T.col(i), points_T.col(k) - points_T.col(i));
  } else {
    Vector3<S> longest = Vector3<S>::Zero();
    for (int i = 0; i < N; ++i) {
      const Vector3<S> arm = points_T.col(i) - centroid;
      longest = select(arm.squaredNorm() > longest.squaredNorm(), arm, longest);
    }
    for (int i = 0; i < N; ++i) keep_larger(longest, points_T.col(i) - centroid);
  }
  normal /= sqrt(S(normal.squaredNorm()));
  Vector3<S> arm = Vector3<S>::Zero();  // from E's origin to C's, in B
  if (camera.placement != nullptr) arm = rotate<S>(rotation_matrix(pose.quaternion), camera.placement->p_MC);
  const Vector3<S> sight = centroid - pose.position - arm;
  const S along = dot<S>(sight, normal), inverse_distance = S(1.0) / sqrt(S(sight.squaredNorm()));
  // R_BE <- (1 - 2 n n^T) (1 - 2 s s^T) R_BE, which is a turn in B by twice the angle from s to n
  const S w = along * inverse_distance;
  const Vector3<S> v = inverse_distance * cross<S>(sight, normal), u = pose.quaternion.template tail<3>();
  Pose<S> mirrored;
  mirrored.position = centroid + sight - S(2.0) * along * normal;  // of the camera
  if (camera.placement != nullptr) {                               // the arm turns with it
    arm -= S(2.0) * inverse_distance * inverse_distance * dot<S>(arm, sight) * sight;
    mirrored.position -= arm - S(2.0) * dot<S>(arm, normal) * normal;
  }
  mirrored.quaternion(0) = w * pose.quaternion(0) - dot<S>(v, u);
  mirrored.quaternion.template tail<3>() = w * u + pose.quaternion(0) * v + cross<S>(v, u);
  return mirrored;
}

/// sigma^2 of the features as their fit shows it: the part of the residual that no displacement explains, which a prior
/// does not change to first order, over the 2 n - 6 degrees of freedom of the n points that count [px^2].
///
/// All of the residual counts where the image does not determine the pose.
/// @param measured features that were fitted [px]
/// @param information J^T W J of the fit
template <class S, int N>
S unexplained_variance(const CameraView<S>& camera, const PoseFit<S, N>& fit, const Vector<S, 2 * N>& measured,
                       const Matrix6<S>& information, const PointWeights<S, N>& weights = {}) noexcept {
  const ImageJacobian<S, N> J(camera, S(-1.0), fit.features, fit.inverse_depth, fit.pose.position, fit.R_BE);
  const Vector<S, 2 * N> residual = measured - fit.features;
  const Cholesky<S, 6> solver(information);
  // The vector first: a difference of squares would carry the rounding of the larger, explained part.
  const Vector<S, 2 * N> rest = residual - J.push(solver.solve(J.pull(weights.times(residual)).vector()));
  const Vector<S, 2 * N> unexplained = select(solver.failed(), residual, rest);
  return weights.root_times(unexplained).squaredNorm() * weights.per_freedom();
}

template <class S, int N>
S unexplained_variance(const CameraView<S>& camera, const PoseFit<S, N>& fit, const Vector<S, 2 * N>& measured,
                       const PointWeights<S, N>& weights = {}) noexcept {
  const ImageJacobian<S, N> J(camera, S(-1.0), fit.features, fit.inverse_depth, fit.pose.position, fit.R_BE);
  return unexplained_variance<S, N>(camera, fit, measured, J.normal_matrix(weights), weights);
}

/// Share of a prior's weight for a measured variance: s/(s + sigma_0^2) of its excess s over `kExactImage` squared,
/// with sigma_0 so that it is half at `kPriorNoise`; at least `kLeastPrior`.
///
/// In proportion to the excess, as M = sigma^2/sigma_pose^2, where that is small; limited where it is large.
template <class S>
S prior_share(const S& variance) noexcept {
  constexpr double kExact = kExactImage * kExactImage, kHalf = kPriorNoise * kPriorNoise - kExact;
  return larger(S(S(1.0) - S(kHalf) / (variance + S(kHalf - kExact))), S(kLeastPrior));  // 1 for an infinite variance
}

/// Whether the prior leaves no pose beside a fitted one whose cost is below `kMirrorShare` k of its cost C.
///
/// Its residual would be at most sqrt(k C), as would its distance from the prior's pose in that one's norm |d|_M, and
/// d, from the fitted pose to it, at most (1 + sqrt(k)) sqrt(C). With the second derivative of the weighed features
/// along d at most K |d|_M^2, the residual between them is at most R = max(|r|, sqrt(k C)) + K |d|_M^2/8. The cost,
/// which does not fall at the fitted pose, is convex between them where R K <= 1: then it is not below C at the other.
/// With Z the depth of a point, c >= 1 and at least its distance from E's origin over Z, n its normalised coordinates
/// and w its weight, that derivative along d = (v, theta) is at most 3 f c^2 sqrt(w (1 + |n|^2)) (|v|/Z + |theta|)^2
/// for each point, and (|v|/Z + |theta|)^2 <= |d|_M^2 (1/(m_v Z^2) + 1/m_theta) with the least weights m_v and m_theta
/// of M.
template <class S, int N>
Mask<S> prior_decides(const CameraView<S>& camera, const Eigen::Matrix<S, 3, N>& points_T, const PosePrior<S>& prior,
                      const PoseFit<S, N>& fit, const PointWeights<S, N>& weights = {}) noexcept {
  const Vector2<S> gives = prior.gives();
  const S give_v = gives(0), give_theta = gives(1);
  const S f = camera.f, inverse_f = S(1.0) / f;
  S squares(0.0);
  for (int i = 0; i < N; ++i) {
    Vector3<S> arm = points_T.col(i);
    if (!camera.on_base()) arm -= fit.pose.position;
    const S inverse_depth = fit.inverse_depth(i), closeness = inverse_depth * inverse_depth;
    const S x = inverse_f * fit.features(2 * i), y = inverse_f * fit.features(2 * i + 1);
    const S far = larger(S(closeness * arm.squaredNorm()), S(1.0));  // c^2
    const S bound = far * (closeness * give_v + give_theta);
    squares += weights.of_row(i, S((S(1.0) + x * x + y * y) * bound * bound));
  }
  using std::sqrt;
  constexpr double root = 0.2;  // of k
  static_assert(root * root > kMirrorShare - 1e-12 && root * root < kMirrorShare + 1e-12);
  const S K = S(3.0) * f * sqrt(squares), least = S(kMirrorShare) * fit.cost;
  const S R = sqrt(larger(fit.squared_residual, least)) + S((1.0 + root) * (1.0 + root) / 8.0) * K * fit.cost;
  return R * K <= S(1.0);
}

/// Whether no other pose explains the image clearly better than a fitted one: that one does to rounding, or the prior
/// decides.
template <class S, int N>
Mask<S> is_only_pose(const CameraView<S>& camera, const Eigen::Matrix<S, 3, N>& points_T, const PosePrior<S>& prior,
                     const PoseFit<S, N>& fit, const PointWeights<S, N>& weights = {}) noexcept {
  return (fit.cost < S(kResidualRounding * kResidualRounding)) |
         prior_decides<S, N>(camera, points_T, prior, fit, weights);
}

/// The fit from the mirror image of a fitted pose; it ends where its cost will not be below `kMirrorShare` of that.
template <class S, int N>
PoseFit<S, N> mirror_fit(const CameraView<S>& camera, const Eigen::Matrix<S, 3, N>& points_T,
                         const Vectors3<S, N>& points, const Vector<S, 2 * N>& measured, const PosePrior<S>& prior,
                         const PoseFit<S, N>& fit, const PointWeights<S, N>& weights) noexcept {
  return fit_pose<S, N>(camera, points, measured, prior, mirrored_pose<S, N>(camera, points_T, fit.pose, weights),
                        {kMirrorRounds, kRoughFit, S(S(kMirrorShare) * fit.cost)}, weights);
}

/// Pose estimated from an image.
template <class S>
struct PoseEstimate {
  Pose<S> pose;        ///< in B; quaternion of unit length
  S squared_residual;  ///< |xi - xi(pose)|^2 [px^2]
  S prior_share;       ///< of the given weight that the prior had in the end [1]
  Pose<S> rough;       ///< that with all of the prior's weight, from which it was found
  Mask<S> mirrored;    ///< it was found from the mirror image of the pose near the start
  Mask<S> failed;      ///< a point is not in front of the camera, or the image does not determine the pose
};

/// The pose from which known points look as measured, in the least squares, by `fit_pose` from the pose of the joint
/// sensors, which may be a prior as well: along what the image hardly constrains, its noise is then not followed.
///
/// A planar target has two poses that look alike. The mirror image of what is found from the start is followed as well
/// (`mirrored_pose`), and taken where its cost C is below `kMirrorShare` of the first one's: the pose near
/// the joint sensors' stays unless the other one explains the image clearly better, so that noise alone does not make
/// the estimate change sides from one image to the next. It need not be looked at where the first one explains the
/// image to rounding, or `prior_decides`.
///
/// The prior pulls the estimate towards the joint sensors even where the image is exact. So the first rounds have all
/// of its weight, and those from the better of the two poses the `prior_share` of the noise that is measured there
/// (`unexplained_variance`). The number of rounds is bounded, and C is never above that of the start.
/// @param points_T in T [m]
/// @param features measured [px], by a camera that projects (`CameraConvention::eye_in_hand`)
/// @param joints pose of the joint sensors: start, and centre of the prior; its quaternion need not be of unit length
/// @param prior_weight diagonal of M under noise [px^2/m^2; px^2/rad^2]; 0: the image alone
/// @param weights what each point counts
template <class S, int N>
PoseEstimate<S> estimate_pose(const CameraView<S>& camera, const Eigen::Matrix<S, 3, N>& points_T,
                              const Vector<S, 2 * N>& features, const Pose<S>& joints, const Vector6<S>& prior_weight,
                              const PointWeights<S, N>& weights = {}) noexcept {
  const Vectors3<S, N> points(points_T);
  PosePrior<S> prior{unit_pose(joints), prior_weight};
  PoseFit<S, N> fit = fit_pose<S, N>(camera, points, features, prior, joints, {kPoseRounds, kRoughFit}, weights);
  PoseEstimate<S> estimate;
  estimate.mirrored = Mask<S>(false);
  const Mask<S> one = is_only_pose<S, N>(camera, points_T, prior, fit, weights);
  if (!all(one)) {
    const PoseFit<S, N> mirror = mirror_fit<S, N>(camera, points_T, points, features, prior, fit, weights);
    estimate.mirrored = (!one) & (mirror.cost < S(kMirrorShare) * fit.cost);
    fit.replace(estimate.mirrored, mirror);
  }
  estimate.rough = fit.pose;
  estimate.prior_share = prior_share(unexplained_variance<S, N>(camera, fit, features, weights));
  prior.weight *= estimate.prior_share;
  fit = fit_pose<S, N>(camera, points, features, prior, fit.pose, {kPolishRounds}, weights);

  const ImageJacobian<S, N> J(camera, S(-1.0), fit.features, fit.inverse_depth, fit.pose.position, fit.R_BE);
  Matrix6<S> A = J.normal_matrix(weights);
  A.diagonal() += prior.weight;
  estimate.pose = fit.pose;
  estimate.squared_residual = fit.squared_residual;
  estimate.failed = Cholesky<S, 6>(A).failed() | !is_finite(fit.squared_residual);
  return estimate;
}

/// Where the two minima of an estimate are beside the pose of the joint sensors, number by number: a start for the next
/// one (`estimate_pose_near`). Zero: at that pose.
template <class S>
struct PoseMemory {
  Pose<S> rough{Vector3<S>::Zero(), Vector4<S>::Zero()};  ///< of the fit with all of the prior's weight
  Pose<S> found{Vector3<S>::Zero(), Vector4<S>::Zero()};  ///< of the fit with its share

  /// Calls `f` with each member, always in the same order.
  template <class F>
  void for_each_member(F&& f) {
    f(rough.position), f(rough.quaternion), f(found.position), f(found.quaternion);
  }

  void replace(const Mask<S>& where, const PoseMemory& other) {
    rough = select_pose(where, other.rough, rough);
    found = select_pose(where, other.found, found);
  }
};

namespace detail {

/// The estimates of the lanes that have none yet, from the joint sensors' pose; out of line, since they are rare.
template <class S, int N>
[[gnu::noinline, gnu::cold]] void estimate_pose_afresh(const CameraView<S>& camera,
                                                       const Eigen::Matrix<S, 3, N>& points_T,
                                                       const Vector<S, 2 * N>& features, const Pose<S>& joints,
                                                       const Vector6<S>& prior_weight,
                                                       const PointWeights<S, N>& weights, const Mask<S>& known,
                                                       Pose<S>& pose, PoseMemory<S>& memory) noexcept {
  const PoseEstimate<S> found = estimate_pose<S, N>(camera, points_T, features, joints, prior_weight, weights);
  const Pose<S> from = unit_pose(joints);
  PoseMemory<S> next;
  next.replace(!(found.failed | found.mirrored), {from_to<S>(from, found.rough), from_to<S>(from, found.pose)});
  memory.replace(!known, next);
  const S unknown(std::numeric_limits<double>::quiet_NaN()), none = select(found.failed, unknown, S(0.0));
  pose.position = select(known, pose.position, Vector3<S>(found.pose.position + Vector3<S>::Constant(none)));
  pose.quaternion = select(known, pose.quaternion, Vector4<S>(found.pose.quaternion + Vector4<S>::Constant(none)));
}

/// Whether the mirror image of a fit is clearly better; out of line, since the question is rare.
template <class S, int N>
[[gnu::noinline, gnu::cold]] Mask<S> is_mirrored(const CameraView<S>& camera, const Eigen::Matrix<S, 3, N>& points_T,
                                                 const Vector<S, 2 * N>& features, const PosePrior<S>& prior,
                                                 const PoseFit<S, N>& fit, const PointWeights<S, N>& weights) noexcept {
  const Vectors3<S, N> points(points_T);
  return mirror_fit<S, N>(camera, points_T, points, features, prior, fit, weights).cost < S(kMirrorShare) * fit.cost;
}

}  // namespace detail

/// A minimum found by Newton's method.
template <class S, int N>
struct SettledFit {
  PoseFit<S, N> fit;       ///< at most `kSettledFit` from it
  Matrix6<S> information;  ///< J^T W J of `fit`
  Pose<S> pose;            ///< the minimum, to rounding
  Mask<S> settled;         ///< otherwise there is no meaning
};

/// Newton's method for the minimum of `fit_pose` from a start close to it, without damping and comparisons: whole steps
/// until one is below `kSettledFit`. It gives up where one is above `kNearStart`. The features' curvature is left out
/// where it does not matter (`kStillFit`, `kStraightFit`, `kExactFit`).
///
/// A `coarse` fit, of which the pose itself is not asked, takes no step where the prior alone keeps it below
/// `kSettledFit`, and leaves the curvature out of a first step that is below it.
///
/// A lane ends by itself, so that its pose does not depend on its neighbours; the rounds end with the last.
/// @param start its quaternion need not be of unit length
template <bool coarse, class S, int N>
SettledFit<S, N> settle_pose(const CameraView<S>& camera, const Vectors3<S, N>& points_T,
                             const Vector<S, 2 * N>& measured, const PosePrior<S>& prior, const Pose<S>& start,
                             const PointWeights<S, N>& weights = {}) noexcept {
  constexpr double kLast = kSettledFit * kSettledFit, kFar = kNearStart * kNearStart;
  SettledFit<S, N> out;
  // The attitude does not wait for the length of the quaternion.
  out.fit =
      pose_fit<S, N>(camera, points_T, measured, prior, unit_pose(start), rotation_matrix(start.quaternion), weights);
  out.pose = out.fit.pose;
  out.settled = Mask<S>(false);
  Mask<S> going(true);
  for (int round = 0; round < kNearRounds; ++round) {
    const PoseFit<S, N>& fit = out.fit;
    const ImageJacobian<S, N> J(camera, S(-1.0), fit.features, fit.inverse_depth, fit.pose.position, fit.R_BE);
    const Vector<S, 2 * N> residual = weights.times(measured - fit.features);
    const Vector6<S> gradient = J.pull(residual).vector() + prior.gradient(fit.prior_error);
    out.information = J.normal_matrix(weights);
    S closeness(0.0);
    for (int i = 0; i < N; ++i) closeness += weights.share(i) * fit.inverse_depth(i);
    going = going & is_finite(fit.squared_residual);
    if (coarse && round == 0) {  // |d|_M^2 <= g^T M^-1 g
      const Vector2<S> gives = prior.gives();
      const S most =
          gives(0) * gradient.template head<3>().squaredNorm() + gives(1) * gradient.template tail<3>().squaredNorm();
      const Mask<S> held = going & (max(S(closeness * closeness * gives(0)), gives(1)) * most < S(kLast));
      out.settled = held;
      going = going & !held;
      if (!any(going)) break;
    }
    const auto squared_length = [&closeness](const Vector6<S>& d) {
      return max(S(closeness * closeness * d.template head<3>().squaredNorm()), S(d.template tail<3>().squaredNorm()));
    };
    Matrix6<S> A = out.information;
    A.diagonal() += prior.weight;
    Mask<S> straight = fit.squared_residual < S(kExactFit * kExactFit), failed(false);
    Vector6<S> d = Vector6<S>::Zero();
    if (round == 0 || any(straight)) {
      const Cholesky<S, 6> gauss(A);
      d = gauss.solve(gradient);
      failed = gauss.failed();
      if (round == 0) {
        const S length = squared_length(d);
        straight = straight | (length < S(coarse ? kLast : kStillFit * kStillFit)) |
                   (length * fit.squared_residual < S(kStraightFit * kStraightFit));
      }
    }
    if (!all(straight | !going)) {
      const Cholesky<S, 6> newton(Matrix6<S>(A - feature_curvature<S, N>(camera, fit, residual)));
      d = select(straight, d, newton.solve(gradient));
      failed = (failed & straight) | (newton.failed() & !straight);
    }
    const S length = squared_length(d);
    going = going & !failed & (length < S(kFar));
    const Mask<S> last = going & (length < S(kLast));
    const Pose<S> next = stepped<S>(fit.pose, d);
    out.pose = select_pose(going, next, out.pose);
    out.settled = out.settled | last;
    going = going & !last;
    if (!any(going)) break;
    out.fit.replace(going, pose_fit<S, N>(camera, points_T, measured, prior, next, weights));
  }
  return out;
}

/// `estimate_pose` started where the last one ended, relative to the joint sensors' pose, and the same minimum to
/// rounding: `memory` changes what it takes and not what it gives.
///
/// The two fits are those of `estimate_pose`, by `settle_pose` from `memory`. Where one does not settle, or the mirror
/// image of the first one is clearly better, the estimate is that of `estimate_pose`.
/// @param memory of the last estimate, becomes that of this one
/// @return NaN where there is no estimate
template <class S, int N>
Pose<S> estimate_pose_near(const CameraView<S>& camera, const Eigen::Matrix<S, 3, N>& points_T,
                           const Vector<S, 2 * N>& features, const Pose<S>& joints, const Vector6<S>& prior_weight,
                           PoseMemory<S>& memory, const PointWeights<S, N>& weights = {}) noexcept {
  const Vectors3<S, N> points(points_T);
  PosePrior<S> prior{unit_pose(joints), prior_weight};
  const SettledFit<S, N> rough =
      settle_pose<true, S, N>(camera, points, features, prior, beside<S>(prior.pose, memory.rough), weights);
  Mask<S> near = rough.settled;
  const Mask<S> one = is_only_pose<S, N>(camera, points_T, prior, rough.fit, weights) | !near;
  if (!all(one))
    near = near & (one | !detail::is_mirrored<S, N>(camera, points_T, features, prior, rough.fit, weights));
  Pose<S> pose = rough.pose;
  if (any(near)) {
    // A branch, which a processor predicts, so that the fit does not wait for the variance.
    const S share = prior_share(unexplained_variance<S, N>(camera, rough.fit, features, rough.information, weights));
    if (all(share <= S(kLeastPrior))) [[likely]]
      prior.weight *= S(kLeastPrior);
    else
      prior.weight *= share;
    const SettledFit<S, N> found =
        settle_pose<false, S, N>(camera, points, features, prior, beside<S>(prior.pose, memory.found), weights);
    near = near & found.settled;
    pose = found.pose;
    memory.rough = from_to<S>(prior.pose, rough.pose);
    memory.found = from_to<S>(prior.pose, found.pose);
  }
  if (!all(near)) [[unlikely]]
    detail::estimate_pose_afresh<S, N>(camera, points_T, features, joints, prior_weight, weights, near, pose, memory);
  return pose;
}

/// A pose with a local minimum of the distance between the image of given points and a desired one.
struct GoalMinimum {
  Pose<double> pose;        ///< in B; quaternion of unit length
  double squared_residual;  ///< |xi_d - xi(pose)|^2 [px^2]
  double largest_residual;  ///< of its coordinates [px]
};

/// Those found by `fit_pose` from home, from home turned about the optical axis, moved along it and tilted, and from
/// the mirror image of each pose that it finds, in this order; the search ends at the first that shows the desired
/// features to (1e-6 px)^2. Empty where the features determine no pose.
template <int N = kPoints>
std::vector<GoalMinimum> goal_minima(const CameraView<double>& camera, const Eigen::Matrix<double, 3, N>& points_T,
                                     const Vector<double, 2 * N>& desired_features, const Pose<double>& home,
                                     const PointWeights<double, N>& weights = {});

/// The goal is refused where no pose gives the desired features within this, in every coordinate [px].
inline constexpr double kGoalResidual = 1.0;

/// Pose where the assumed points give the desired features, in the least squares.
///
/// Of `goal_minima` whose squared residual is within four times the smallest one, or below (1e-6 px)^2, that nearest to
/// home is the goal.
/// @throws std::invalid_argument where the largest residual of a coordinate is beyond `kGoalResidual`, or the features
/// do not determine a pose
template <int N = kPoints>
Pose<double> goal_pose(const CameraView<double>& camera, const Eigen::Matrix<double, 3, N>& points_T,
                       const Vector<double, 2 * N>& desired_features, const Pose<double>& home,
                       const PointWeights<double, N>& weights = {});

}  // namespace hexservo
