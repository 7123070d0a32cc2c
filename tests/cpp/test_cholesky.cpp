// The core's dense solver against Eigen's, and its failure mask.
#include "hexservo/cholesky.hpp"

#include "compare.hpp"
#include "decompositions.hpp"
#include "random.hpp"

#include <array>

using namespace hexservo;
using namespace hexservo::test;

namespace {

template <int N>
void check_against_eigen(Random& random) {
  for (const double condition : {1.0, 1e3, 1e6, 1e9})
    for (int trial = 0; trial < 50; ++trial) {
      CAPTURE(N);
      CAPTURE(condition);
      CAPTURE(trial);
      const double scale = std::pow(10.0, random.uniform(-6.0, 6.0));
      const Eigen::Matrix<double, N, N> A = scale * random.positive_definite<N>(condition);
      const Vector<double, N> b = random.matrix<N>();
      const Cholesky<double, N> solver(A);
      REQUIRE_FALSE(solver.failed());
      const Vector<double, N> x = solver.solve(b), expected = solve_by_cholesky(A, b);
      // Either solution is off by at most about 3 N eps times the condition number (Higham, theorem 10.4).
      CHECK(relative_distance(x, expected) <= 10.0 * N * kEpsilon * condition);
      // The residual is independent of the condition number.
      CHECK((A * x - b).norm() <= 20.0 * N * kEpsilon * A.norm() * x.norm());
    }
}

/// Positive definite but for one row and column, which are a combination of those before them.
///
/// The pivot there is pure rounding: a few eps times |w|^2 <= 6, since what comes before is well conditioned.
Matrix6<double> singular(Random& random, int row = 5) {
  Matrix6<double> A = random.positive_definite<6>(10.0);
  const Vector6<double> w = random.matrix<6>();
  for (int i = 0; i < 6; ++i) A(row, i) = A.row(i).head(row).dot(w.head(row));
  A(row, row) = A.row(row).head(row).dot(w.head(row));
  A.col(row) = A.row(row).transpose();
  return A;
}

Matrix6<double> indefinite(Random& random) {
  Matrix6<double> A = random.positive_definite<6>(10.0);
  A -= 0.5 * A.trace() * Matrix6<double>::Identity();
  A(0, 0) = 1.0;  // the first pivot alone does not fail
  return A;
}

}  // namespace

TEST_CASE("solutions are Eigen's on random symmetric positive definite matrices") {
  Random random(7201);
  CAPTURE(random.seed());
  check_against_eigen<3>(random);
  check_against_eigen<6>(random);
}

TEST_CASE("the units of a matrix do not matter: entries of 1e-25 and of 1e25 are solved as well as those of 1") {
  Random random(7205);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 50; ++trial) {
    const Matrix6<double> A = random.positive_definite<6>(1e6);
    const Vector6<double> b = random.matrix<6>();
    const Vector6<double> x = Cholesky<double, 6>(A).solve(b);
    for (const double scale : {std::ldexp(1.0, -83), std::ldexp(1.0, 83)}) {  // powers of two: no other rounding
      const Cholesky<double, 6> solver(Matrix6<double>(scale * A));
      REQUIRE_FALSE(solver.failed());
      CHECK(solver.solve(Vector6<double>(scale * b)) == x);
    }
  }
}

TEST_CASE("matrices that are not positive definite fail, and finite ones never silently") {
  Random random(7202);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 200; ++trial) {
    CAPTURE(trial);
    for (int row = 1; row < 6; ++row) CHECK(Cholesky<double, 6>(singular(random, row)).failed());
    CHECK(Cholesky<double, 6>(indefinite(random)).failed());
    CHECK(Cholesky<double, 6>(Matrix6<double>(-random.positive_definite<6>(10.0))).failed());
  }
  CHECK(Cholesky<double, 6>(Matrix6<double>::Zero()).failed());
  for (int j = 0; j < 6; ++j) {
    Matrix6<double> flat = Matrix6<double>::Identity(), negative = flat, tiny = flat, small = flat;
    flat(j, j) = 0.0;
    negative(j, j) = -1.0;
    tiny(j, j) = 0.1 * kPivotFloor;
    small(j, j) = 10.0 * kPivotFloor;
    CHECK(Cholesky<double, 6>(flat).failed());
    CHECK(Cholesky<double, 6>(negative).failed());
    CHECK(Cholesky<double, 6>(tiny).failed());
    CHECK_FALSE(Cholesky<double, 6>(small).failed());
  }
}

TEST_CASE("a pivot fails below its share of the diagonal entries, whatever the unit of the linear or angular rows") {
  // Of [[1, c], [c, 1]] the second pivot is 1 - c^2, which doubles hold to 1e-16: the floor is 90 times that.
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < i; ++j)
      for (const double unit : {1.0, 1e-9, 1e9}) {
        Matrix6<double> below = Matrix6<double>::Identity(), above = below;
        below(i, j) = below(j, i) = std::sqrt(1.0 - 0.1 * kPivotFloor);
        above(i, j) = above(j, i) = std::sqrt(1.0 - 10.0 * kPivotFloor);
        for (Matrix6<double>* A : {&below, &above}) {
          A->middleRows<3>(i / 3 * 3) *= unit;
          A->middleCols<3>(i / 3 * 3) *= unit;
        }
        CHECK(Cholesky<double, 6>(below).failed());
        CHECK_FALSE(Cholesky<double, 6>(above).failed());
      }
}

TEST_CASE("a pose problem of any size of machine is solved as well: rows in pixels per metre and per radian") {
  Random random(7206);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 50; ++trial) {
    CAPTURE(trial);
    const Matrix6<double> A = random.positive_definite<6>(1e6);
    const Vector6<double> b = random.matrix<6>();
    const Vector6<double> x = Cholesky<double, 6>(A).solve(b);
    for (const int power : {-27, -13, 13, 27}) {  // a machine up to 1e8 times as small or large
      Vector6<double> unit = Vector6<double>::Ones();
      unit.head<3>().setConstant(std::ldexp(1.0, power));
      const Cholesky<double, 6> solver(Matrix6<double>(unit.asDiagonal() * A * unit.asDiagonal()));
      REQUIRE_FALSE(solver.failed());
      CHECK(unit.asDiagonal() * solver.solve(Vector6<double>(unit.asDiagonal() * b)) == x);
    }
  }
}

TEST_CASE("a number that is not finite fails, wherever it is") {
  Random random(7203);
  CAPTURE(random.seed());
  for (const double bad : {kNaN, kInfinity, -kInfinity})
    for (int i = 0; i < 6; ++i)
      for (int k = 0; k <= i; ++k) {
        CAPTURE(bad);
        CAPTURE(i);
        CAPTURE(k);
        Matrix6<double> A = random.positive_definite<6>(10.0);
        A(i, k) = A(k, i) = bad;
        CHECK(Cholesky<double, 6>(A).failed());
      }
}

TEST_CASE("a pack solves each lane as double does, and a failing lane disturbs no neighbour") {
  Random random(7204);
  CAPTURE(random.seed());
  using S = Lanes<4>;
  for (int trial = 0; trial < 50; ++trial) {
    CAPTURE(trial);
    std::array<Matrix6<double>, 4> A_of = {random.positive_definite<6>(1e4), singular(random),
                                           random.positive_definite<6>(1e4), Matrix6<double>::Constant(kNaN)};
    Matrix6<S> A;
    Vector6<S> b;
    std::array<Vector6<double>, 4> b_of;
    for (int lane = 0; lane < 4; ++lane) {
      b_of[static_cast<std::size_t>(lane)] = random.matrix<6>();
      set_lane(A, lane, A_of[static_cast<std::size_t>(lane)]);
      set_lane(b, lane, b_of[static_cast<std::size_t>(lane)]);
    }
    const Cholesky<S, 6> solver(A);
    const Vector6<S> x = solver.solve(b);
    for (int lane = 0; lane < 4; ++lane) {
      CAPTURE(lane);
      const Cholesky<double, 6> single(A_of[static_cast<std::size_t>(lane)]);
      CHECK(solver.failed()[lane] == single.failed());
      CHECK(solver.failed()[lane] == (lane % 2 == 1));
      if (lane % 2 == 0)
        CHECK(relative_distance(lane_of(x, lane), single.solve(b_of[static_cast<std::size_t>(lane)])) <=
              60.0 * kEpsilon * 1e4);
    }
  }
}
