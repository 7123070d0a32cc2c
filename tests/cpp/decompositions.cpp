#include "decompositions.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <Eigen/QR>
#include <Eigen/SVD>

namespace hexservo::test {

Eigen::MatrixXd least_squares(const AnyMatrix& A, const AnyMatrix& b) {
  return Eigen::ColPivHouseholderQR<Eigen::MatrixXd>(A).solve(b);
}

Eigen::MatrixXd solve_by_lu(const AnyMatrix& A, const AnyMatrix& b) {
  return Eigen::FullPivLU<Eigen::MatrixXd>(A).solve(b);
}

Eigen::MatrixXd solve_by_cholesky(const AnyMatrix& A, const AnyMatrix& b) {
  return Eigen::LLT<Eigen::MatrixXd>(A).solve(b);
}

Eigen::VectorXd singular_values(const AnyMatrix& A) { return Eigen::JacobiSVD<Eigen::MatrixXd>(A).singularValues(); }

Eigen::VectorXd symmetric_eigenvalues(const AnyMatrix& A) {
  return Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(A, Eigen::EigenvaluesOnly).eigenvalues();
}

double smallest_real_part(const AnyMatrix& A) {
  return Eigen::EigenSolver<Eigen::MatrixXd>(A, false).eigenvalues().real().minCoeff();
}

}  // namespace hexservo::test
