/// @file
/// Singular values and eigenvalues of small matrices. Every size of a matrix compiles a decomposition again, which
/// takes longer than all else in most files: these are compiled once, for any size.
#pragma once

#include <Eigen/Core>

namespace hexservo::detail {

/// Singular values of a finite matrix, the largest first, as many as its smaller side.
Eigen::VectorXd singular_values(const Eigen::Ref<const Eigen::MatrixXd>& matrix);

/// Eigenvalues of a finite symmetric matrix, the smallest first; its lower triangle is read.
Eigen::VectorXd eigenvalues(const Eigen::Ref<const Eigen::MatrixXd>& symmetric);

}  // namespace hexservo::detail
