/// @file
/// Eigen's decompositions for tests, compiled once for matrices of any size: in a test they would take longer to
/// compile than all else.
#pragma once

#include <Eigen/Core>

namespace hexservo::test {

using AnyMatrix = Eigen::Ref<const Eigen::MatrixXd>;

/// x of least |A x - b|, by Householder reflections with column pivoting.
Eigen::MatrixXd least_squares(const AnyMatrix& A, const AnyMatrix& b);

/// x of A x = b, by LU with full pivoting.
Eigen::MatrixXd solve_by_lu(const AnyMatrix& A, const AnyMatrix& b);

/// x of A x = b with a positive definite A, by Cholesky.
Eigen::MatrixXd solve_by_cholesky(const AnyMatrix& A, const AnyMatrix& b);

/// Singular values, the largest first.
Eigen::VectorXd singular_values(const AnyMatrix& A);

/// Eigenvalues of a symmetric matrix, the smallest first.
Eigen::VectorXd symmetric_eigenvalues(const AnyMatrix& A);

/// Smallest real part of an eigenvalue of a square matrix.
double smallest_real_part(const AnyMatrix& A);

}  // namespace hexservo::test
