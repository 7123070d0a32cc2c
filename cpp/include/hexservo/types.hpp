/// @file
/// Fixed-size types, frames, units and orders that every header of the core shares.
///
/// | symbol     | meaning                                                                     | unit        |
/// | ---------- | --------------------------------------------------------------------------- | ----------- |
/// | B          | base frame, origin at the centre of the base joints, z points down          |             |
/// | E          | platform frame = camera frame, the camera looks along -Z_E                  |             |
/// | R_BE       | turns E-coordinates into B-coordinates                                      | 1           |
/// | p_BE       | position of E's origin in B (the paper's x_p)                               | m           |
/// | quaternion | attitude of E in B, (w, x, y, z)                                            | 1           |
/// | twist      | (velocity of E's origin; angular velocity), both in B (the paper's chi-dot) | m/s; rad/s  |
/// | wrench     | (force; moment about E's origin), both in B (the paper's tau)               | N; N m      |
/// | features   | (x1, y1, ..., xN, yN) from the image centre (the paper's xi)                | px          |
/// | depth      | Z_i of the points in E, negative in front of the camera                     | m           |
///
/// SI units and radians throughout; pixels for image quantities. Linear parts come before angular ones.
#pragma once

#include "hexservo/lanes.hpp"
#include "hexservo/parameters.hpp"

#include <Eigen/Core>
#include <Eigen/Geometry>

#include <array>
#include <limits>
#include <type_traits>

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "hexservo checks for numbers that are not finite: compile without -ffast-math and -ffinite-math-only"
#endif

namespace hexservo {

template <class S, int N>
using Vector = Eigen::Matrix<S, N, 1>;
template <class S>
using Vector2 = Vector<S, 2>;
template <class S>
using Vector3 = Vector<S, 3>;
template <class S>
using Vector4 = Vector<S, 4>;
template <class S>
using Vector6 = Vector<S, 6>;
template <class S>
using Matrix3 = Eigen::Matrix<S, 3, 3>;
template <class S>
using Matrix6 = Eigen::Matrix<S, 6, 6>;
template <class S>
using Matrix7 = Eigen::Matrix<S, 7, 7>;
template <class S>
using Matrix36 = Eigen::Matrix<S, 3, 6>;

/// What stands for a number that is not known.
inline constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();

/// (linear x3, angular x3): one value for each half of a wrench, twist or their gains.
template <class S>
Vector6<S> linear_angular(double linear, double angular) {
  Vector6<S> six;
  six.template head<3>().setConstant(S(linear));
  six.template tail<3>().setConstant(S(angular));
  return six;
}

/// Number of feature points of the paper.
inline constexpr int kPoints = 4;
/// Fewest and most points of a target.
inline constexpr int kLeastPoints = 3, kMostPoints = 16;
/// Stands for a number of points that is known when a program runs.
inline constexpr int kAnyPoints = 0;

/// K numbers of each point, one point after the other.
template <class S, int N, int K = 1>
using OfPoints = std::conditional_t<N == kAnyPoints, Eigen::Matrix<S, Eigen::Dynamic, 1, 0, K * kMostPoints, 1>,
                                    Eigen::Matrix<S, K * N, 1>>;

/// The same numbers for every point; where their count is not fixed they are those of four points.
template <class S, int N, int K = 1>
OfPoints<S, N, K> for_all_points(double value) {
  return OfPoints<S, N, K>::Constant(K * (N == kAnyPoints ? kPoints : N), S(value));
}

/// Numbers of points that loops are compiled for. A target with fewer points has its first one in the places that are
/// left, with a weight of 0: the largest error, the nearest point, the oldest image are then those of the points.
inline constexpr std::array kPlaces = {kPoints, kMostPoints};

/// Calls `function` with a std::integral_constant of one of `kPlaces`, and gives what it gives.
template <class F>
decltype(auto) with_places(int places, F&& function) {
  if (places == kPoints) return function(std::integral_constant<int, kPoints>{});
  return function(std::integral_constant<int, kMostPoints>{});
}

/// The first point in all places behind the points of a target.
/// @param numbers K of each of N places
/// @param points n of the target
template <int K, class S, int M>
void fill_places(Eigen::Matrix<S, M, 1>& numbers, int points) {
  for (int i = K * points; i < M; ++i) numbers(i) = numbers(i % K);
}

/// [a]x, so that [a]x b = a x b.
template <class S>
Matrix3<S> skew(const Vector3<S>& a) {
  Matrix3<S> m;
  m.col(0) = Vector3<S>(S(0.0), a(2), -a(1));
  m.col(1) = Vector3<S>(-a(2), S(0.0), a(0));
  m.col(2) = Vector3<S>(a(1), -a(0), S(0.0));
  return m;
}

/// R v, coefficient by coefficient: Eigen's packets of two do not fit three rows.
template <class S>
[[gnu::always_inline]] inline Vector3<S> rotate(const Matrix3<S>& R, const Vector3<S>& v) {
  return Vector3<S>(R(0, 0) * v(0) + R(0, 1) * v(1) + R(0, 2) * v(2),  //
                    R(1, 0) * v(0) + R(1, 1) * v(1) + R(1, 2) * v(2),  //
                    R(2, 0) * v(0) + R(2, 1) * v(1) + R(2, 2) * v(2));
}

/// a . b, coefficient by coefficient.
template <class S>
[[gnu::always_inline]] inline S dot(const Vector3<S>& a, const Vector3<S>& b) {
  return a(0) * b(0) + a(1) * b(1) + a(2) * b(2);
}

/// a x b, coefficient by coefficient.
template <class S>
[[gnu::always_inline]] inline Vector3<S> cross(const Vector3<S>& a, const Vector3<S>& b) {
  return Vector3<S>(a(1) * b(2) - a(2) * b(1), a(2) * b(0) - a(0) * b(2), a(0) * b(1) - a(1) * b(0));
}

/// R^T v.
template <class S>
[[gnu::always_inline]] inline Vector3<S> rotate_back(const Matrix3<S>& R, const Vector3<S>& v) {
  return Vector3<S>(R(0, 0) * v(0) + R(1, 0) * v(1) + R(2, 0) * v(2),  //
                    R(0, 1) * v(0) + R(1, 1) * v(1) + R(2, 1) * v(2),  //
                    R(0, 2) * v(0) + R(1, 2) * v(1) + R(2, 2) * v(2));
}

}  // namespace hexservo
