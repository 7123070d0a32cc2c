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
