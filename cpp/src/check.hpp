/// @file
/// Words for misuse: "key: expected ..., got ...".
#pragma once

#include "hexservo/parameters.hpp"

#include <Eigen/Core>

#include <cmath>
#include <sstream>
#include <stdexcept>
#include <string>

namespace hexservo::detail {

/// Joins text and numbers; a number as a reader would type it.
template <class... Parts>
std::string words(const Parts&... parts) {
  std::ostringstream out;
  out.precision(12);
  (out << ... << parts);
  return out.str();
}

[[noreturn]] inline void refuse(const std::string& key, const std::string& expected, const std::string& got) {
  throw std::invalid_argument(words(key, ": expected ", expected, ", got ", got));
}

inline void require_finite(const std::string& key, double value) {
  if (!std::isfinite(value)) refuse(key, "a finite number", words(value));
}

inline void require_positive(const std::string& key, double value) {
  if (!(std::isfinite(value) && value > 0.0)) refuse(key, "a finite number > 0", words(value));
}

/// Names the first entry that is not finite, counted from 0 along the storage order of a vector or (row, column) of a
/// matrix.
template <class Derived>
void require_finite(const std::string& key, const Eigen::MatrixBase<Derived>& m) {
  for (Eigen::Index row = 0; row < m.rows(); ++row)
    for (Eigen::Index column = 0; column < m.cols(); ++column) {
      if (std::isfinite(m(row, column))) continue;
      const std::string index = m.cols() == 1 ? words("[", row, "]") : words("[", row, "][", column, "]");
      require_finite(key + index, m(row, column));
    }
}

/// Names the first entry of a vector that is not positive, counted from 0.
template <int N>
void require_positive(const std::string& key, const Eigen::Matrix<double, N, 1>& v) {
  for (int i = 0; i < N; ++i) require_positive(words(key, "[", i, "]"), v(i));
}

/// Refuses a displacement (m; rad) whose rotation vector is longer than `kLongestTurn`.
inline void require_turn(const std::string& key, const Eigen::Matrix<double, 6, 1>& displacement) {
  const double turn = displacement.tail<3>().stableNorm();
  if (!(turn <= kLongestTurn))
    refuse(key, "a rotation vector at most pi long (radians)",
           words("one of ", turn, " (degrees? multiply by pi/180)"));
}

inline void require_not_negative(const std::string& key, double value) {
  require_finite(key, value);
  if (value < 0.0) refuse(key, "a number >= 0", words(value));
}
template <int N>
void require_not_negative(const std::string& key, const Eigen::Matrix<double, N, 1>& v) {
  require_finite(key, v);
  for (int i = 0; i < N; ++i)
    if (v(i) < 0.0) refuse(words(key, "[", i, "]"), "a number >= 0", words(v(i)));
}

}  // namespace hexservo::detail
