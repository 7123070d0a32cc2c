/// @file
/// The pose error estimated from an image, alone or together with a prior (docs/model.md, section 5).
#pragma once

#include "hexservo/camera.hpp"
#include "hexservo/cholesky.hpp"

#include <limits>

namespace hexservo {

/// Six unknown numbers.
template <class S>
Vector6<S> unknown_six() {
  return Vector6<S>::Constant(S(std::numeric_limits<double>::quiet_NaN()));
}

/// Solution x of normal equations A x = b; all NaN where A is not positive definite.
template <class S>
Vector6<S> solve_normal_equations(const Matrix6<S>& A, const Vector6<S>& b) {
  const Cholesky<S, 6> solver(A);
  return select(solver.failed(), unknown_six<S>(), solver.solve(b));
}

/// e = (J^T W J + M)^-1 (J^T W xi-tilde + M (chi_ref - chi)): the most probable pose error, in B [m; rad].
///
/// The maximum a-posteriori estimate from the image (J e = xi-tilde, with noise) and from the prior (e = chi_ref - chi,
/// with noise); M holds the ratio of the two variances. All NaN where J^T W J + M is not positive definite.
/// @param prior diagonal of M, (sigma of a feature/sigma of a pose component)^2 [px^2/m^2; px^2/rad^2]
/// @param expected chi_ref - chi as `pose_difference` gives it [m; rad]
/// @param weights W, what each point counts
template <class S, int N>
Vector6<S> most_probable_pose_error(const ImageJacobian<S, N>& J, const Vector<S, 2 * N>& feature_error,
                                    const Vector6<S>& prior, const Vector6<S>& expected,
                                    const PointWeights<S, N>& weights = {}) {
  Matrix6<S> information = J.normal_matrix(weights);
  for (int j = 0; j < 6; ++j) information(j, j) += prior(j);
  return solve_normal_equations<S>(information,
                                   J.pull(weights.times(feature_error)).vector() + prior.cwiseProduct(expected));
}

}  // namespace hexservo
