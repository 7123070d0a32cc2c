// Every operation on a pack of lanes is the operation on double, lane by lane.
#include "hexservo/types.hpp"

#include "compare.hpp"
#include "random.hpp"

#include <algorithm>
#include <bit>
#include <type_traits>
#include <utility>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

// A branch on data must not compile.
template <class M>
concept CanDecideABranch = requires(M m) { m ? 1 : 0; };
template <class M>
concept HasShortCircuit = requires(M a, M b) { a && b; };
static_assert(CanDecideABranch<Mask<double>>);
static_assert(std::is_same_v<Mask<double>, bool>);
static_assert(std::is_same_v<Mask<Lanes<4>>, LaneMask<4>>);
static_assert(!CanDecideABranch<LaneMask<2>> && !CanDecideABranch<LaneMask<4>> && !CanDecideABranch<LaneMask<8>>);
static_assert(!std::is_convertible_v<LaneMask<4>, bool> && !std::is_constructible_v<bool, LaneMask<4>>);
static_assert(!std::is_convertible_v<LaneMask<4>, int> && !std::is_constructible_v<int, LaneMask<4>>);
static_assert(!std::is_convertible_v<bool, LaneMask<4>>, "a bool becomes a mask only where it is asked for");
static_assert(!HasShortCircuit<LaneMask<4>>);
static_assert(!std::is_convertible_v<Lanes<4>, double>);
static_assert(std::is_convertible_v<double, Lanes<4>>);
static_assert(std::is_trivially_copyable_v<Lanes<8>>);

/// Values at which arithmetic is delicate, and a few ordinary ones.
std::vector<double> delicate_values() {
  std::vector<double> values = {0.0,     -0.0,   1.0,   -1.0,   0.5,       -2.0,       3.0,  1e-300,
                                -1e-300, 5e-324, 1e300, -1e300, kInfinity, -kInfinity, kNaN, 1.0 + kEpsilon};
  Random random(7001);
  for (int i = 0; i < 8; ++i) values.push_back(random.uniform(-3.0, 3.0));
  return values;
}

/// The same bits; any NaN equals any NaN, whose sign and payload no standard fixes.
bool same(double a, double b) {
  if (std::isnan(a) || std::isnan(b)) return std::isnan(a) && std::isnan(b);
  return std::bit_cast<std::uint64_t>(a) == std::bit_cast<std::uint64_t>(b);
}

/// Walks through all pairs of delicate values, W at a time, each pair in its own lane.
template <class S, class Check>
void for_all_pairs(Check&& check) {
  const std::vector<double> values = delicate_values();
  std::vector<std::pair<double, double>> pairs;
  for (const double a : values)
    for (const double b : values) pairs.emplace_back(a, b);
  while (pairs.size() % static_cast<std::size_t>(S::width) != 0) pairs.emplace_back(1.0, 2.0);
  for (std::size_t first = 0; first < pairs.size(); first += static_cast<std::size_t>(S::width)) {
    S a, b;
    for (int lane = 0; lane < S::width; ++lane) {
      a.set(lane, pairs[first + static_cast<std::size_t>(lane)].first);
      b.set(lane, pairs[first + static_cast<std::size_t>(lane)].second);
    }
    check(a, b);
  }
}

/// Compares a result per lane with the same expression on doubles.
#define CHECK_LANES(pack, single)                         \
  do {                                                    \
    const auto result = (pack);                           \
    for (int lane = 0; lane < S::width; ++lane) {         \
      const double x = a[lane], y = b[lane];              \
      static_cast<void>(y);                               \
      CAPTURE(lane);                                      \
      CAPTURE(x);                                         \
      CAPTURE(y);                                         \
      CHECK_MESSAGE(same(result[lane], (single)), #pack); \
    }                                                     \
  } while (false)
#define CHECK_MASK(pack, single)                      \
  do {                                                \
    const auto result = (pack);                       \
    for (int lane = 0; lane < S::width; ++lane) {     \
      const double x = a[lane], y = b[lane];          \
      static_cast<void>(y);                           \
      CAPTURE(x);                                     \
      CAPTURE(y);                                     \
      CHECK_MESSAGE(result[lane] == (single), #pack); \
    }                                                 \
  } while (false)

#define ALL_WIDTHS Lanes<2>, Lanes<4>, Lanes<8>

}  // namespace

TEST_CASE_TEMPLATE("a broadcast number is in every lane, bit for bit", S, ALL_WIDTHS) {
  for (const double value : delicate_values()) {
    const S pack = value;
    for (int lane = 0; lane < S::width; ++lane) CHECK(same(pack[lane], value));
  }
}

TEST_CASE_TEMPLATE("arithmetic is double's, lane by lane", S, ALL_WIDTHS) {
  for_all_pairs<S>([](const S& a, const S& b) {
    CHECK_LANES(a + b, x + y);
    CHECK_LANES(a - b, x - y);
    CHECK_LANES(a * b, x * y);
    CHECK_LANES(a / b, x / y);
    CHECK_LANES(-a, -x);
    CHECK_LANES(a + 2.5, x + 2.5);
    CHECK_LANES(2.5 / a, 2.5 / x);
    S c = a;
    CHECK_LANES(c += b, x + y);
    c = a;
    CHECK_LANES(c -= b, x - y);
    c = a;
    CHECK_LANES(c *= b, x * y);
    c = a;
    CHECK_LANES(c /= b, x / y);
  });
}

TEST_CASE_TEMPLATE("functions are double's, lane by lane", S, ALL_WIDTHS) {
  for_all_pairs<S>([](const S& a, const S& b) {
    CHECK_LANES(sqrt(a), std::sqrt(x));
    CHECK_LANES(abs(a), std::abs(x));
    CHECK_LANES(pow(a, 2.5), std::pow(x, 2.5));
    CHECK_LANES(pow(a, 3.0), std::pow(x, 3.0));
  });
}

TEST_CASE_TEMPLATE("comparisons are double's, lane by lane, and false for NaN", S, ALL_WIDTHS) {
  for_all_pairs<S>([](const S& a, const S& b) {
    CHECK_MASK(a < b, x < y);
    CHECK_MASK(a > b, x > y);
    CHECK_MASK(a <= b, x <= y);
    CHECK_MASK(a >= b, x >= y);
    CHECK_MASK(a == b, x == y);
    CHECK_MASK(a != b, x != y);
    CHECK_MASK(!(a < b), !(x < y));
    CHECK_MASK((a < b) & (a > 0.0), x < y && x > 0.0);
    CHECK_MASK((a < b) | (a > 0.0), x < y || x > 0.0);
  });
}

TEST_CASE_TEMPLATE("select, min, max, clip, sign and is_finite are the same function of either scalar", S, ALL_WIDTHS) {
  for_all_pairs<S>([](const S& a, const S& b) {
    CHECK_LANES(select(a < b, a, b), select(x < y, x, y));
    CHECK_LANES(max(a, b), max(x, y));
    CHECK_LANES(min(a, b), min(x, y));
    CHECK_LANES(clip(a, S(-1.0), S(1.0)), clip(x, -1.0, 1.0));
    CHECK_LANES(sign(a), sign(x));
    CHECK_MASK(is_finite(a), is_finite(x));
  });
}

TEST_CASE("min, max, clip and sign are those of std on numbers, and propagate NaN from either side") {
  for (const double x : delicate_values()) {
    CAPTURE(x);
    CHECK(is_finite(x) == std::isfinite(x));
    CHECK(std::isnan(clip(x, -1.0, 1.0)) == std::isnan(x));
    CHECK(std::isnan(sign(x)) == std::isnan(x));
    if (!std::isnan(x)) {
      CHECK(clip(x, -1.0, 1.0) == std::clamp(x, -1.0, 1.0));
      CHECK(sign(x) == static_cast<double>((x > 0.0) - (x < 0.0)));
    }
    for (const double y : delicate_values()) {
      CAPTURE(y);
      if (std::isnan(x) || std::isnan(y)) {
        CHECK(std::isnan(max(x, y)));
        CHECK(std::isnan(min(x, y)));
      } else {
        CHECK(max(x, y) == std::max(x, y));
        CHECK(min(x, y) == std::min(x, y));
      }
    }
  }
}

TEST_CASE_TEMPLATE("masks: constants, any and all", S, ALL_WIDTHS) {
  using M = typename S::Mask;
  CHECK(all(M(true)));
  CHECK(any(M(true)));
  CHECK_FALSE(all(M(false)));
  CHECK_FALSE(any(M(false)));
  for (int chosen = 0; chosen < S::width; ++chosen) {
    S x = 0.0;
    x.set(chosen, 1.0);
    const M one = x > S(0.5);
    CHECK(any(one));
    CHECK_FALSE(all(one));
    CHECK(all(!one) == false);
    CHECK(any(!one));
    CHECK(all(one | !one));
    CHECK_FALSE(any(one & !one));
    for (int lane = 0; lane < S::width; ++lane) CHECK(one[lane] == (lane == chosen));
  }
  CHECK(any(true));
  CHECK_FALSE(any(false));
  CHECK(all(true));
  CHECK_FALSE(all(false));
}

TEST_CASE_TEMPLATE("a matrix is selected and judged as a whole", S, ALL_WIDTHS) {
  Random random(7002);
  CAPTURE(random.seed());
  Eigen::Matrix<S, 3, 2> yes, no;
  std::vector<Eigen::Matrix<double, 3, 2>> yes_of, no_of;
  S decider;
  for (int lane = 0; lane < S::width; ++lane) {
    yes_of.push_back(random.matrix<3, 2>());
    no_of.push_back(random.matrix<3, 2>());
    set_lane(yes, lane, yes_of.back());
    set_lane(no, lane, no_of.back());
    decider.set(lane, random.uniform(-1.0, 1.0));
  }
  const Eigen::Matrix<S, 3, 2> chosen = select(decider > S(0.0), yes, no);
  for (int lane = 0; lane < S::width; ++lane)
    CHECK(lane_of(chosen, lane) == (decider[lane] > 0.0 ? yes_of : no_of)[static_cast<std::size_t>(lane)]);

  for (const double bad : {kNaN, kInfinity, -kInfinity})
    for (int entry = 0; entry < 6; ++entry) {
      Eigen::Matrix<S, 3, 2> m = yes;
      m(entry).set(S::width - 1, bad);
      const auto finite = is_finite(m);
      for (int lane = 0; lane < S::width; ++lane) CHECK(finite[lane] == (lane != S::width - 1));
      Eigen::Matrix<double, 3, 2> single = yes_of[0];
      CHECK(is_finite(single));
      single(entry) = bad;
      CHECK_FALSE(is_finite(single));
    }
  // two infinities of opposite sign must not cancel
  Eigen::Matrix<double, 3, 2> opposite = yes_of[0];
  opposite(0) = kInfinity;
  opposite(5) = -kInfinity;
  CHECK_FALSE(is_finite(opposite));
}

TEST_CASE_TEMPLATE("Eigen's expressions on packs are those on doubles", S, ALL_WIDTHS) {
  Random random(7003);
  CAPTURE(random.seed());
  Vector6<S> a, b;
  Matrix6<S> A, B;
  Vector3<S> u, v;
  std::vector<Vector6<double>> a_of, b_of;
  std::vector<Matrix6<double>> A_of, B_of;
  std::vector<Vector3<double>> u_of, v_of;
  for (int lane = 0; lane < S::width; ++lane) {
    set_lane(a, lane, a_of.emplace_back(random.matrix<6>()));
    set_lane(b, lane, b_of.emplace_back(random.matrix<6>()));
    set_lane(A, lane, A_of.emplace_back(random.matrix<6, 6>()));
    set_lane(B, lane, B_of.emplace_back(random.matrix<6, 6>()));
    set_lane(u, lane, u_of.emplace_back(random.matrix<3>()));
    set_lane(v, lane, v_of.emplace_back(random.matrix<3>()));
  }
  const S dot = a.dot(b), norm = a.squaredNorm();
  const Vector3<S> cross = u.cross(v);
  const Vector6<S> product = A * b, transposed = A.transpose() * b,
                   combined = S(0.5) * a.cwiseProduct(b) - a.cwiseQuotient(b);
  const Matrix6<S> matrix = A * B.transpose();
  // Sums of n = 6 products of numbers <= 1 may be added in another order: n eps n on either side.
  const double bound = 2.0 * 36.0 * kEpsilon;
  for (int lane = 0; lane < S::width; ++lane) {
    CAPTURE(lane);
    const auto i = static_cast<std::size_t>(lane);
    CHECK(std::abs(dot[lane] - a_of[i].dot(b_of[i])) <= bound);
    CHECK(std::abs(norm[lane] - a_of[i].squaredNorm()) <= bound);
    CHECK(distance(lane_of(cross, lane), u_of[i].cross(v_of[i])) <= bound);
    CHECK(distance(lane_of(product, lane), A_of[i] * b_of[i]) <= bound);
    CHECK(distance(lane_of(transposed, lane), A_of[i].transpose() * b_of[i]) <= bound);
    CHECK(distance(lane_of(matrix, lane), A_of[i] * B_of[i].transpose()) <= bound);
    const Vector6<double> expected = 0.5 * a_of[i].cwiseProduct(b_of[i]) - a_of[i].cwiseQuotient(b_of[i]);
    CHECK(relative_distance(lane_of(combined, lane), expected) <= 4.0 * kEpsilon);
  }
}

namespace {

/// A parameter struct as the core writes them, with members of every sort.
template <class S>
struct Parameters {
  S number{0.0};
  Vector3<S> vector = Vector3<S>::Zero();
  bool flag = true;
  double step = 1e-3;
  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"number"}, self.number...);
    v(Field{"vector"}, self.vector...);
    v(Field{"flag"}, self.flag...);
    v(Field{"step"}, self.step...);
  }
};

}  // namespace

TEST_CASE_TEMPLATE("set_lane fills one lane and leaves the others", S, ALL_WIDTHS) {
  Random random(7004);
  CAPTURE(random.seed());
  Parameters<S> pack;
  std::vector<Parameters<double>> singles;
  for (int lane = 0; lane < S::width; ++lane) {
    singles.push_back({random.uniform(-1.0, 1.0), random.matrix<3>(), false, 5e-4});
    set_lane(pack, lane, singles.back());
  }
  CHECK(pack.flag == false);
  CHECK(pack.step == 5e-4);
  for (int lane = 0; lane < S::width; ++lane) {
    CHECK(pack.number[lane] == singles[static_cast<std::size_t>(lane)].number);
    CHECK(lane_of(pack.vector, lane) == singles[static_cast<std::size_t>(lane)].vector);
  }
}

TEST_CASE_TEMPLATE("set_lane refuses flags and time grids that differ between lanes", S, ALL_WIDTHS) {
  Parameters<S> pack;
  const Parameters<double> first;
  set_lane(pack, 0, first);
  Parameters<double> other_flag, other_step;
  other_flag.flag = false;
  other_step.step = 2e-3;
  CHECK_THROWS_AS(set_lane(pack, 1, other_flag), std::invalid_argument);
  CHECK_THROWS_AS(set_lane(pack, 1, other_step), std::invalid_argument);
  CHECK(refusal([&] { set_lane(pack, 1, other_step); }).rfind("pack: expected ", 0) == 0);
  CHECK_NOTHROW(set_lane(pack, 1, first));
}
