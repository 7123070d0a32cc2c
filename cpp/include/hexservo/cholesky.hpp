/// @file
/// The core's one dense solver: unpivoted L D L^T of a symmetric positive definite matrix, on any scalar.
///
/// Eigen's own decompositions pivot and branch on data and do not compile on a pack of lanes. Here a pivot that is not
/// above `kPivotFloor` times the largest diagonal entry of its three rows raises the lane's failure mask and the other
/// lanes go on. Three rows each are linear and angular: entries of a Jacobian are in pixels per metre and per radian,
/// whose squares differ by 1e14 on a machine of a millimetre (that units do not matter to the elimination itself: van
/// der Sluis, Numerische Mathematik 14, 1969).
///
/// No division waits for another one: elimination without fractions (Bareiss, Mathematics of Computation 22, 1968)
/// carries minors of A, and what is left of A is them over the minor before, whose reciprocal is ready by then.
/// Each step's rounding is that of a division first. Minors are products of up to N entries, which may be within
/// 1e-25 and 1e25.
#pragma once

#include "hexservo/types.hpp"

namespace hexservo {

/// Pivots below this share of the largest diagonal entry of the same unit are rounding noise [1].
inline constexpr double kPivotFloor = 1e-14;

/// A = L D L^T with unit lower triangular L.
template <class S, int N>
class Cholesky {
  static constexpr int kAxes = 3;
  static_assert(N % kAxes == 0);

 public:
  /// @param A its lower triangle is read
  explicit Cholesky(const Eigen::Matrix<S, N, N>& A) {
    // One by one, since that is how they were written: a wider load would have to wait.
#pragma GCC unroll 6
    for (int j = 0; j < N; ++j)
#pragma GCC unroll 6
      for (int i = j; i < N; ++i) L_(i, j) = A(i, j);
    Vector<S, N / kAxes> largest;  // diagonal entry of each three rows
#pragma GCC unroll 2
    for (int i = 0; i < N; i += kAxes) largest(i / kAxes) = max(max(A(i, i), A(i + 1, i + 1)), A(i + 2, i + 2));
    S minor_before(1.0), inverse_before(1.0);  // leading principal minors
#pragma GCC unroll 6
    for (int j = 0; j < N; ++j) {
      const S minor = L_(j, j);
      // The pivot, times the minor before. An entry that is no number makes the minors of the rows after it none.
      const Mask<S> good = minor > S(kPivotFloor) * largest(j / kAxes) * minor_before;
      failed_ = j > 0 ? Mask<S>(failed_ | !good) : Mask<S>(!good);
      const S inverse = select(good, S(S(1.0) / minor), S(1.0));
#pragma GCC unroll 6
      for (int i = j + 1; i < N; ++i)
#pragma GCC unroll 6
        for (int k = j + 1; k <= i; ++k) {
          L_(i, k) = minor * L_(i, k) - L_(i, j) * L_(k, j);
          if (j > 0) L_(i, k) *= inverse_before;
        }
#pragma GCC unroll 6
      for (int i = j + 1; i < N; ++i) L_(i, j) *= inverse;
      inverse_D_(j) = j > 0 ? S(inverse * minor_before) : inverse;
      minor_before = minor;
      inverse_before = inverse;
    }
  }

  /// Where the matrix was not positive definite; what `solve` gives there has no meaning.
  Mask<S> failed() const { return failed_; }

  /// x with A x = b.
  Vector<S, N> solve(Vector<S, N> b) const {
#pragma GCC unroll 6
    for (int i = 1; i < N; ++i)
#pragma GCC unroll 6
      for (int k = 0; k < i; ++k) b(i) -= L_(i, k) * b(k);
#pragma GCC unroll 6
    for (int i = 0; i < N; ++i) b(i) *= inverse_D_(i);
#pragma GCC unroll 6
    for (int i = N - 2; i >= 0; --i)
#pragma GCC unroll 6
      for (int k = N - 1; k > i; --k) b(i) -= L_(k, i) * b(k);  // the one that is known last at the end
    return b;
  }

  /// Column k of the lower triangle whose product with its own transpose A is.
  Vector<S, N> column(int k) const {
    using std::sqrt;
    Vector<S, N> out = Vector<S, N>::Zero();
    out(k) = S(1.0) / sqrt(inverse_D_(k));
    for (int i = k + 1; i < N; ++i) out(i) = out(k) * L_(i, k);
    return out;
  }

 private:
  Eigen::Matrix<S, N, N> L_;
  Vector<S, N> inverse_D_;
  Mask<S> failed_;
};

}  // namespace hexservo
