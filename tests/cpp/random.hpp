/// @file
/// Random inputs from a fixed seed, the same numbers on every machine; where an expression draws twice, the compiler
/// chooses which comes first. A test writes `CAPTURE(random.seed())`, so that a failure prints it.
#pragma once

#include "hexservo/types.hpp"

#include <cmath>
#include <cstdint>
#include <random>

namespace hexservo::test {

class Random {
 public:
  explicit Random(std::uint64_t seed) : seed_(seed), engine_(seed) {}

  std::uint64_t seed() const { return seed_; }

  /// Uniform in [low, high).
  double uniform(double low, double high) {
    const double unit = static_cast<double>(engine_() >> 11) * 0x1p-53;  // std's distributions differ between libraries
    return low + (high - low) * unit;
  }

  /// Entries uniform in [-size, size).
  template <int R, int C = 1>
  Eigen::Matrix<double, R, C> matrix(double size = 1.0) {
    Eigen::Matrix<double, R, C> m;
    for (int i = 0; i < R * C; ++i) m(i) = uniform(-size, size);
    return m;
  }

  /// A vector whose first half is within `first` and whose second half is within `second`: twists and wrenches.
  Vector6<double> six(double first, double second) {
    Vector6<double> v;
    v << matrix<3>(first), matrix<3>(second);
    return v;
  }

  /// Rotation by at most `angle` [rad] about a random axis, made by Eigen and not by the core.
  Matrix3<double> rotation(double angle = 3.14159265358979323846) {
    Vector3<double> axis;
    do axis = matrix<3>();
    while (axis.norm() < 0.1 || axis.norm() > 1.0);
    return Eigen::AngleAxisd(uniform(-angle, angle), axis.normalized()).toRotationMatrix();
  }

  /// Quaternion (w, x, y, z) whose length is between the given ones; every attitude is possible.
  Vector4<double> quaternion(double shortest = 1.0, double longest = 1.0) {
    Vector4<double> q;
    do q = matrix<4>();
    while (q.norm() < 0.1 || q.norm() > 1.0);
    return q.normalized() * uniform(shortest, longest);
  }

  /// Symmetric positive definite with eigenvalues between 1/condition and 1.
  template <int N>
  Eigen::Matrix<double, N, N> positive_definite(double condition) {
    Eigen::Matrix<double, N, N> A = Eigen::Matrix<double, N, N>::Zero();
    for (int i = 0; i < N; ++i) A(i, i) = std::pow(condition, -uniform(0.0, 1.0));
    for (int i = 0; i < N; ++i) {  // N reflections make generic axes
      const Vector<double, N> v = matrix<N>().normalized();
      A -= 2.0 * v * (v.transpose() * A);
      A -= 2.0 * (A * v) * v.transpose();
    }
    return (A + A.transpose()) / 2.0;
  }

  /// Inertia of a body [kg m^2] in random axes: moments that obey the triangle inequality with some reserve.
  Matrix3<double> inertia(double size = 3e-4) {
    const Vector3<double> second_moments(uniform(0.1, 1.0), uniform(0.1, 1.0), uniform(0.1, 1.0));  // of x^2, y^2, z^2
    const Vector3<double> principal = (Vector3<double>::Constant(second_moments.sum()) - second_moments) * (size / 2.0);
    const Matrix3<double> R = rotation();
    const Matrix3<double> I = R * principal.asDiagonal() * R.transpose();
    return (I + I.transpose()) / 2.0;
  }

 private:
  std::uint64_t seed_;
  std::mt19937_64 engine_;
};

}  // namespace hexservo::test
