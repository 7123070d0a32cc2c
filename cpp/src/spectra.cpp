#include "spectra.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/SVD>

namespace hexservo::detail {

Eigen::VectorXd singular_values(const Eigen::Ref<const Eigen::MatrixXd>& matrix) {
  return Eigen::JacobiSVD<Eigen::MatrixXd>(matrix).singularValues();
}

Eigen::VectorXd eigenvalues(const Eigen::Ref<const Eigen::MatrixXd>& symmetric) {
  return Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(symmetric, Eigen::EigenvaluesOnly).eigenvalues();
}

}  // namespace hexservo::detail
