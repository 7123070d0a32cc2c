/// @file
/// Cubic splines through evenly spaced samples, for recorded motions: value, rate and acceleration of one curve, so
/// that what is computed from the three agrees (docs/model.md, section 7).
#pragma once

#include <Eigen/Core>

#include <algorithm>
#include <vector>

namespace hexservo {

/// Value of a curve in D dimensions with its first and second derivative by time.
template <class S, int D>
struct Curve {
  Eigen::Matrix<S, D, 1> value = Eigen::Matrix<S, D, 1>::Zero();
  Eigen::Matrix<S, D, 1> rate = Eigen::Matrix<S, D, 1>::Zero();          ///< [1/s]
  Eigen::Matrix<S, D, 1> acceleration = Eigen::Matrix<S, D, 1>::Zero();  ///< [1/s^2]
};

/// The same curve for all lanes of a pack.
template <class S, int D>
Curve<S, D> of_all_lanes(const Curve<double, D>& curve) noexcept {
  Curve<S, D> all;
  for (int i = 0; i < D; ++i) {
    all.value(i) = S(curve.value(i));
    all.rate(i) = S(curve.rate(i));
    all.acceleration(i) = S(curve.acceleration(i));
  }
  return all;
}

/// Curve through samples at 0, h, 2h, ..., whose second derivative is continuous and linear between two of them; after
/// the last sample it stays there. Memory is taken once, at construction.
template <int D>
class UniformSpline {
 public:
  UniformSpline() = default;

  /// The cubic spline of the samples; it has no knot at the second and at the last but one ("not-a-knot").
  /// @param samples D numbers each
  /// @param period h [s]
  UniformSpline(std::vector<double> samples, double period) : values_(std::move(samples)), period_(period) {
    find_curvatures();
  }

  /// The curve of samples that are known with their second derivatives [1/s^2].
  UniformSpline(std::vector<double> samples, std::vector<double> curvatures, double period)
      : values_(std::move(samples)), curvatures_(std::move(curvatures)), period_(period) {}

  /// At a time >= 0 [s].
  Curve<double, D> at(double time) const noexcept {
    Curve<double, D> curve;
    const long long last = count() - 1;
    const double place = time / period_;
    if (!(place <= static_cast<double>(last) * (1.0 + 1e-12))) {  // times of a grid are rounded
      curve.value = row(values_, last);
      return curve;
    }
    const long long i = std::clamp(static_cast<long long>(place), 0LL, last - 1);
    const double b = place - static_cast<double>(i), a = 1.0 - b;
    const auto y0 = row(values_, i), y1 = row(values_, i + 1), m0 = row(curvatures_, i), m1 = row(curvatures_, i + 1);
    curve.value = a * y0 + b * y1 + period_ * period_ / 6.0 * ((a * a - 1.0) * a * m0 + (b * b - 1.0) * b * m1);
    curve.rate = (y1 - y0) / period_ + period_ / 6.0 * ((3.0 * b * b - 1.0) * m1 - (3.0 * a * a - 1.0) * m0);
    curve.acceleration = a * m0 + b * m1;
    return curve;
  }

  long long count() const noexcept { return static_cast<long long>(values_.size()) / D; }

 private:
  using Row = Eigen::Map<const Eigen::Matrix<double, D, 1>>;
  static Row row(const std::vector<double>& rows, long long i) noexcept { return Row(rows.data() + D * i); }

  /// m_{i-1} + 4 m_i + m_{i+1} = 6 (y_{i-1} - 2 y_i + y_{i+1})/h^2; without a knot at the second sample m_0 - 2 m_1 +
  /// m_2 = 0, which leaves m_1, and likewise at the other end. Three samples have a parabola, two a straight line.
  void find_curvatures() {
    const long long n = count();
    curvatures_.assign(values_.size(), 0.0);
    if (n < 3) return;
    Eigen::Map<Eigen::Matrix<double, D, Eigen::Dynamic>> m(curvatures_.data(), D, n);
    const Eigen::Map<const Eigen::Matrix<double, D, Eigen::Dynamic>> y(values_.data(), D, n);
    const auto second_difference = [&](long long i) -> Eigen::Matrix<double, D, 1> {
      return ((y.col(i - 1) - y.col(i)) + (y.col(i + 1) - y.col(i))) / (period_ * period_);
    };
    m.col(1) = second_difference(1);
    m.col(n - 2) = second_difference(n - 2);
    std::vector<double> below(static_cast<std::size_t>(n), 0.0);  // m_i + below_i m_{i+1} = m of the elimination
    for (long long i = 2; i < n - 2; ++i) {
      const auto k = static_cast<std::size_t>(i);
      below[k] = 1.0 / (4.0 - below[k - 1]);
      m.col(i) = below[k] * (6.0 * second_difference(i) - m.col(i - 1));
    }
    for (long long i = n - 3; i > 1; --i) m.col(i) -= below[static_cast<std::size_t>(i)] * m.col(i + 1);
    if (n == 3) {
      m.col(0) = m.col(2) = m.col(1);
      return;
    }
    m.col(0) = 2.0 * m.col(1) - m.col(2);
    m.col(n - 1) = 2.0 * m.col(n - 2) - m.col(n - 3);
  }

  std::vector<double> values_, curvatures_;
  double period_ = 1.0;
};

}  // namespace hexservo
