// Numbers side by side in registers: the same numbers as before, with zeros beyond the last.
#include "hexservo/side_by_side.hpp"

#include "compare.hpp"
#include "random.hpp"

using namespace hexservo;
using namespace hexservo::test;

TEST_CASE("numbers go in, come out and multiply one by one, and the places beyond them are zero") {
  Random random(7651);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 20; ++trial) {
    const Vector6<double> a = random.matrix<6>(), b = random.matrix<6>();
    const SideBySide<double, 6> x(a), y(b);
    CHECK(x.vector() == a);
    CHECK((x * y).vector() == a.cwiseProduct(b));
    for (int k = 0; k < 6; ++k) CHECK(x(k) == a(k));
    for (int k = 6; k < static_cast<int>(SideBySide<double, 6>::registers) * kNativeLanes; ++k)
      CHECK(x.part[static_cast<std::size_t>(k / kNativeLanes)][k % kNativeLanes] == 0.0);
    SideBySide<double, 6> z = x;
    z.set(4, 7.0);
    for (int k = 0; k < 6; ++k) CHECK(z(k) == (k == 4 ? 7.0 : a(k)));
  }
}

TEST_CASE("packs of lanes stand one after another, one register each") {
  using S = Lanes<4>;
  static_assert(SideBySide<S, 6>::registers == 6);
  Random random(7652);
  CAPTURE(random.seed());
  Vector6<S> a;
  for (int k = 0; k < 6; ++k)
    for (int lane = 0; lane < 4; ++lane) a(k).set(lane, random.uniform(-1.0, 1.0));
  const SideBySide<S, 6> x(a);
  for (int lane = 0; lane < 4; ++lane) {
    CHECK(lane_of(x, lane) == lane_of(a, lane));
    CHECK(lane_of(x * x, lane) == lane_of(a, lane).cwiseProduct(lane_of(a, lane)));
  }
}

namespace {

/// A number, or one number for each lane.
template <class S>
S any_number(Random& random) {
  if constexpr (std::is_same_v<S, double>) {
    return random.uniform(-1.0, 1.0);
  } else {
    S x(0.0);
    for (int lane = 0; lane < S::width; ++lane) x.set(lane, random.uniform(-1.0, 1.0));
    return x;
  }
}
template <class S, int rows, int columns = 1>
Eigen::Matrix<S, rows, columns> any_matrix(Random& random) {
  Eigen::Matrix<S, rows, columns> m;
  for (int i = 0; i < rows * columns; ++i) m(i) = any_number<S>(random);
  return m;
}

template <int K, class S>
void check_places(Random& random) {
  const Vector<S, K> a = any_matrix<S, K>(random), b = any_matrix<S, K>(random);
  const SideBySide<S, K> x(a), y = SideBySide<S, K>::load(b.data());
  const S factor = any_number<S>(random);
  // Written between two marks, so that a store beyond its numbers shows.
  Vector<S, K + 2> written = Vector<S, K + 2>::Constant(S(7.0));
  x.store(written.data() + 1);
  for (int lane = 0; lane < 2; ++lane) {
    CHECK(lane_of(y, lane) == lane_of(b, lane));
    CHECK(lane_of(x + y, lane) == lane_of(a, lane) + lane_of(b, lane));
    CHECK(lane_of(x - y, lane) == lane_of(a, lane) - lane_of(b, lane));
    CHECK(lane_of(factor * x, lane) == lane_of(factor, lane) * lane_of(a, lane));
    const Vector<double, K + 2> marked = lane_of(written, lane);
    CHECK(marked(0) == 7.0);
    CHECK(marked(K + 1) == 7.0);
    CHECK(Vector<double, K>(marked.template segment<K>(1)) == lane_of(a, lane));
  }

  // Places beyond the numbers do not count, whatever stands there.
  SideBySide<S, K> dirty = x;
  if constexpr (SideBySide<S, K>::per_register > 1)
    for (int k = K; k < static_cast<int>(dirty.part.size()) * SideBySide<S, K>::per_register; ++k) dirty.set(k, kNaN);
  const SideBySide<S, K> clean = dirty.padded();
  const auto [ab, bb] = dots(clean, y, y, y);
  CHECK(lane_of(ab, 1) == doctest::Approx(lane_of(a, 1).dot(lane_of(b, 1))).epsilon(1e-14));
  CHECK(lane_of(bb, 1) == doctest::Approx(lane_of(b, 1).squaredNorm()).epsilon(1e-14));
  if constexpr (std::is_same_v<S, double>) {
    CHECK(is_finite(dirty));
    for (int k = 0; k < K; ++k) {
      SideBySide<S, K> broken = x;
      broken.set(k, k % 2 == 0 ? kNaN : kInfinity);
      CHECK(!is_finite(broken));
    }
  }
}

template <class S>
void check_pairs_and_vectors(Random& random) {
  const Vector<S, 8> alternating = any_matrix<S, 8>(random);
  const Pairs<S, 4> pairs(alternating);
  const Eigen::Matrix<S, 3, 6> columns = any_matrix<S, 3, 6>(random);
  const Vectors3<S, 6> vectors(columns);
  for (int lane = 0; lane < 2; ++lane) {
    for (int k = 0; k < 4; ++k) {
      CHECK(lane_of(pairs.x(k), lane) == lane_of(alternating(2 * k), lane));
      CHECK(lane_of(pairs.y(k), lane) == lane_of(alternating(2 * k + 1), lane));
    }
    CHECK(lane_of(pairs.vector(), lane) == lane_of(alternating, lane));
    CHECK(lane_of((pairs * pairs - pairs).vector(), lane) ==
          Vector<double, 8>(lane_of(alternating, lane).cwiseProduct(lane_of(alternating, lane)) -
                            lane_of(alternating, lane)));
    CHECK(lane_of(vectors.matrix(), lane) == lane_of(columns, lane));
  }
}

}  // namespace

TEST_CASE("numbers are written, read, added and summed for every count, in doubles and in lanes") {
  Random random(7653);
  CAPTURE(random.seed());
  check_places<2, double>(random);
  check_places<3, double>(random);
  check_places<4, double>(random);
  check_places<5, double>(random);
  check_places<6, double>(random);
  check_places<13, double>(random);
  check_places<3, Lanes<2>>(random);
  check_places<6, Lanes<4>>(random);
}

TEST_CASE("pairs and vectors of three come out as they went in") {
  Random random(7654);
  CAPTURE(random.seed());
  check_pairs_and_vectors<double>(random);
  check_pairs_and_vectors<Lanes<2>>(random);
  check_pairs_and_vectors<Lanes<4>>(random);
}

TEST_CASE("lanes are summed two registers at a time, halved and interleaved, for every width") {
  const auto check = []<int W>(Lanes<W> a) {
    Lanes<W> b(0.0);
    double sum_a = 0.0, sum_b = 0.0;
    for (int i = 0; i < W; ++i) {
      a.set(i, 1.0 + i);
      b.set(i, 100.0 * (1.0 + i));
      sum_a += a[i];
      sum_b += b[i];
    }
    const Lanes<2> sums = lane_sums(a, b);
    CHECK(sums[0] == sum_a);
    CHECK(sums[1] == sum_b);
    const Lanes<W> low = alternate_low(a, b), high = alternate_high(a, b);
    for (int i = 0; i < W; ++i) {
      CHECK(low[i] == (i % 2 == 0 ? a : b)[i / 2]);
      CHECK(high[i] == (i % 2 == 0 ? a : b)[W / 2 + i / 2]);
      CHECK(even_lanes(low, high)[i] == a[i]);
      CHECK(odd_lanes(low, high)[i] == b[i]);
    }
    if constexpr (W > 2)
      for (int i = 0; i < W / 2; ++i) {
        CHECK(low_half(a)[i] == a[i]);
        CHECK(high_half(a)[i] == a[W / 2 + i]);
      }
  };
  check(Lanes<2>(0.0));
  check(Lanes<4>(0.0));
  check(Lanes<8>(0.0));
}
