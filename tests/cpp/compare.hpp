/// @file
/// Distances between arrays, and words for messages.
#pragma once

#include "hexservo/side_by_side.hpp"

#define DOCTEST_CONFIG_SUPER_FAST_ASSERTS  // assertions as function calls: they compile in half the time
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>
#include <stdexcept>
#include <string>

namespace hexservo::test {

inline constexpr double kEpsilon = std::numeric_limits<double>::epsilon();
inline constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
inline constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// max |a - b|; infinite where an entry is NaN, so that no bound holds for it.
template <class A, class B>
double distance(const Eigen::MatrixBase<A>& a, const Eigen::MatrixBase<B>& b) {
  const double d = (a - b).cwiseAbs().maxCoeff();
  return (a - b).hasNaN() ? kInfinity : d;
}

/// max |a - b| in units of the largest entry of either.
template <class A, class B>
double relative_distance(const Eigen::MatrixBase<A>& a, const Eigen::MatrixBase<B>& b) {
  const double size = std::max(a.cwiseAbs().maxCoeff(), b.cwiseAbs().maxCoeff());
  return size == 0.0 ? distance(a, b) : distance(a, b) / size;
}

/// The symmetric matrix of a lower triangle.
inline Matrix6<double> whole(const Matrix6<double>& lower) { return lower.selfadjointView<Eigen::Lower>(); }

/// One lane of a pack, or the number itself.
inline double lane_of(double x, int /*lane*/) { return x; }
template <int W>
double lane_of(const Lanes<W>& x, int lane) {
  return x[lane];
}
template <class S, int R, int C>
Eigen::Matrix<double, R, C> lane_of(const Eigen::Matrix<S, R, C>& m, int lane) {
  Eigen::Matrix<double, R, C> out;
  for (int i = 0; i < R * C; ++i) out(i) = lane_of(m(i), lane);
  return out;
}

template <class S, int K>
Vector<double, K> lane_of(const SideBySide<S, K>& numbers, int lane) {
  return lane_of(numbers.vector(), lane);
}

/// max |a - b| of numbers that lie side by side.
template <int K>
double distance(const SideBySide<double, K>& a, const SideBySide<double, K>& b) {
  return distance(a.vector(), b.vector());
}

/// A matrix for a message.
template <class A>
std::string text(const Eigen::MatrixBase<A>& m) {
  std::ostringstream out;
  out.precision(17);
  for (Eigen::Index i = 0; i < m.rows(); ++i)
    for (Eigen::Index k = 0; k < m.cols(); ++k) out << (k > 0 ? " " : i > 0 ? "; " : "") << m(i, k);
  return out.str();
}

/// What `action` refuses with, or that it did not refuse; another exception goes through and fails the test.
template <class Action>
std::string refusal(Action&& action) {
  try {
    action();
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "(accepted)";
}

/// True where a refusal names the key first, then the expected and the actual value.
inline bool is_about(const std::string& message, const std::string& key) {
  return message.rfind(key, 0) == 0 && message.find(": expected ") != std::string::npos &&
         message.find(", got ") != std::string::npos;
}

}  // namespace hexservo::test
