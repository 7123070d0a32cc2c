// Counter-based random numbers: known answers, statistics, and what they may depend on.
#include "hexservo/random.hpp"

#include "allocations.hpp"
#include "compare.hpp"

#include <array>
#include <bit>
#include <cstdint>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

constexpr std::array kSources = {RandomSource::feature_noise, RandomSource::outliers,      RandomSource::dropout,
                                 RandomSource::latency,       RandomSource::encoder_noise, RandomSource::base_motion};
constexpr std::uint64_t kLargestSeed = 0x7FFFFFFFFFFFFFFF;
constexpr int kEvents = 125'000;     // of eight components: a million numbers
constexpr double kDeviations = 5.0;  // fixed seeds: a bound of five standard deviations either holds or never does

RandomStream<double> stream(std::uint64_t seed, RandomSource source = RandomSource::feature_noise) {
  return {seed_halves(seed), source};
}

/// Components of consecutive events, one after the other.
template <class Draw>
std::vector<double> numbers(Draw&& draw) {
  std::vector<double> all;
  all.reserve(8 * kEvents);
  for (std::uint64_t event = 0; event < kEvents; ++event) {
    const Vector<double, 8> eight = draw(event);
    all.insert(all.end(), eight.data(), eight.data() + 8);
  }
  return all;
}
std::vector<double> normals(std::uint64_t seed, RandomSource source = RandomSource::feature_noise) {
  return numbers([s = stream(seed, source)](std::uint64_t event) { return s.normal<8>(event); });
}
std::vector<double> uniforms(std::uint64_t seed, RandomSource source = RandomSource::feature_noise) {
  return numbers([s = stream(seed, source)](std::uint64_t event) { return s.uniform<8>(event); });
}

double moment(const std::vector<double>& x, int power, double about = 0.0) {
  double sum = 0.0;
  for (const double v : x) sum += std::pow(v - about, power);
  return sum / static_cast<double>(x.size());
}

/// Mean of a_i b_(i+lag): of independent normal numbers it has mean 0 and standard deviation 1/sqrt(n).
double correlation(const std::vector<double>& a, const std::vector<double>& b, std::size_t lag = 0) {
  double sum = 0.0;
  for (std::size_t i = 0; i + lag < a.size(); ++i) sum += a[i] * b[i + lag];
  return sum / static_cast<double>(a.size() - lag);
}

template <int K>
bool same_bits(const Vector<double, K>& a, const Vector<double, K>& b) {
  for (int i = 0; i < K; ++i)
    if (std::bit_cast<std::uint64_t>(a(i)) != std::bit_cast<std::uint64_t>(b(i))) return false;
  return true;
}

template <int W>
void check_lanes() {
  CAPTURE(W);
  using S = Lanes<W>;
  std::array<std::uint64_t, 8> seeds = {0, 1, 2, kLargestSeed, 1ull << 32, (1ull << 53) + 1, 12345678901234567, 7};
  SeedHalves<S> pack;
  for (int lane = 0; lane < W; ++lane) set_lane(pack, lane, seed_halves(seeds[static_cast<std::size_t>(lane)]));
  for (const RandomSource source : kSources) {
    const RandomStream<S> together(pack, source);
    for (const std::uint64_t event : {0ull, 1ull, 999ull, 1ull << 32, ~0ull})
      for (int lane = 0; lane < W; ++lane) {
        CAPTURE(lane);
        const RandomStream<double> alone = stream(seeds[static_cast<std::size_t>(lane)], source);
        CHECK(same_bits<8>(lane_of(together.template normal<8>(event), lane), alone.normal<8>(event)));
        CHECK(same_bits<5>(lane_of(together.template uniform<5>(event), lane), alone.uniform<5>(event)));
      }
  }
}

}  // namespace

TEST_CASE("Philox 4x32-10 gives the known answers of its authors (kat_vectors of Random123)") {
  using detail::philox;
  using detail::PhiloxBlock;
  CHECK(philox({0, 0, 0, 0}, {0, 0}) == PhiloxBlock{0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8});
  constexpr std::uint32_t kOnes = 0xffffffff;
  CHECK(philox({kOnes, kOnes, kOnes, kOnes}, {kOnes, kOnes}) ==
        PhiloxBlock{0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd});
  CHECK(philox({0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344}, {0xa4093822, 0x299f31d0}) ==
        PhiloxBlock{0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1});
}

TEST_CASE("words become numbers in the open interval, symmetric about its middle") {
  constexpr std::uint32_t kOnes = 0xffffffff;
  CHECK(detail::open_uniform(0, 0) == 0x1p-53);
  CHECK(detail::open_uniform(kOnes, kOnes) == 1.0 - 0x1p-53);
  for (const std::uint32_t high : {0u, 1u, 12345678u, 0x80000000u, kOnes})
    for (const std::uint32_t low : {0u, 0x800u, 0x1000u, 0xabcdef01u, kOnes}) {
      CAPTURE(high);
      CAPTURE(low);
      CHECK(detail::open_uniform(low, high) + detail::open_uniform(~low, ~high) == 1.0);
    }
}

TEST_CASE("a million uniform numbers have the moments and the histogram of the uniform distribution") {
  const std::vector<double> u = uniforms(1);
  const double n = static_cast<double>(u.size());
  CHECK(std::abs(moment(u, 1) - 0.5) <= kDeviations * std::sqrt(1.0 / 12.0 / n));
  // variance of (u - 1/2)^2: 1/80 - 1/144
  CHECK(std::abs(moment(u, 2, 0.5) - 1.0 / 12.0) <= kDeviations * std::sqrt(1.0 / 180.0 / n));

  constexpr std::size_t kCells = 64;
  std::array<double, kCells> counts{};
  for (const double v : u) {
    REQUIRE(v > 0.0);
    REQUIRE(v < 1.0);
    counts[static_cast<std::size_t>(v * kCells)] += 1.0;
  }
  double chi_squared = 0.0;
  for (const double count : counts) chi_squared += (count - n / kCells) * (count - n / kCells) / (n / kCells);
  CHECK(std::abs(chi_squared - (kCells - 1)) <= kDeviations * std::sqrt(2.0 * (kCells - 1)));
}

TEST_CASE("a million normal numbers have the moments and the tails of the normal distribution") {
  const std::vector<double> z = normals(2);
  const double n = static_cast<double>(z.size());
  // variances of z, z^2, z^3 and z^4: 1, 2, 15 and 96
  CHECK(std::abs(moment(z, 1)) <= kDeviations * std::sqrt(1.0 / n));
  CHECK(std::abs(moment(z, 2) - 1.0) <= kDeviations * std::sqrt(2.0 / n));
  CHECK(std::abs(moment(z, 3)) <= kDeviations * std::sqrt(15.0 / n));
  CHECK(std::abs(moment(z, 4) - 3.0) <= kDeviations * std::sqrt(96.0 / n));
  for (const double limit : {0.5, 1.0, 2.0, 3.0, 4.0}) {
    CAPTURE(limit);
    double beyond = 0.0;
    for (const double v : z) beyond += std::abs(v) > limit ? 1.0 : 0.0;
    const double p = std::erfc(limit / std::sqrt(2.0));
    CHECK(std::abs(beyond / n - p) <= kDeviations * std::sqrt(p * (1.0 - p) / n));
  }
}

TEST_CASE("components, events, sources and seeds are independent of each other") {
  const std::vector<double> z = normals(3);
  const double bound = kDeviations / std::sqrt(static_cast<double>(z.size()));
  for (std::size_t lag = 1; lag <= 16; ++lag) {  // a lag of 8 is the same component of the next event
    CAPTURE(lag);
    CHECK(std::abs(correlation(z, z, lag)) <= bound);
  }
  std::vector<double> squares(z.size());  // neither do the sizes of a pair depend on each other
  for (std::size_t i = 0; i < z.size(); ++i) squares[i] = (z[i] * z[i] - 1.0) / std::sqrt(2.0);
  CHECK(std::abs(correlation(squares, squares, 1)) <= bound);

  for (const RandomSource source : kSources)
    if (source != RandomSource::feature_noise) {
      CAPTURE(static_cast<int>(source));
      CHECK(std::abs(correlation(z, normals(3, source))) <= bound);
    }
  for (const std::uint64_t seed : {std::uint64_t{0}, std::uint64_t{2}, std::uint64_t{4},
                                   std::uint64_t{3} + (std::uint64_t{1} << 32), kLargestSeed}) {
    CAPTURE(seed);
    CHECK(std::abs(correlation(z, normals(seed))) <= bound);
  }
}

TEST_CASE("every bit of a seed matters, and random streams of different sources differ") {
  std::vector<Vector<double, 2>> seen;
  for (const RandomSource source : kSources) seen.push_back(stream(0, source).normal<2>(0));
  for (int bit = 0; bit < 63; ++bit) seen.push_back(stream(1ull << bit).normal<2>(0));
  for (std::size_t i = 0; i < seen.size(); ++i)
    for (std::size_t k = 0; k < i; ++k) {
      CAPTURE(i);
      CAPTURE(k);
      CHECK(distance(seen[i], seen[k]) > 1e-6);  // 69 pairs of normals: closer ones have a chance of about 1e-9
    }
}

TEST_CASE("a number depends on its event and component alone, not on what was drawn before or beside it") {
  const RandomStream<double> s = stream(99);
  const Vector<double, 8> first = s.normal<8>(17);
  for (std::uint64_t event = 0; event < 100; ++event) (void)s.normal<6>(event);
  CHECK(same_bits<8>(s.normal<8>(17), first));
  CHECK(same_bits<3>(s.normal<3>(17), Vector<double, 3>(first.head<3>())));
  CHECK(same_bits<1>(s.uniform<1>(17), Vector<double, 1>(s.uniform<8>(17).head<1>())));
  CHECK_FALSE(same_bits<8>(s.normal<8>(18), first));
  CHECK_FALSE(same_bits<8>(s.normal<8>(17 + (1ull << 32)), first));
}

TEST_CASE("a seed is recovered from its two halves") {
  for (const std::uint64_t seed : {std::uint64_t{0}, std::uint64_t{1}, (std::uint64_t{1} << 53) + 1, kLargestSeed}) {
    const SeedHalves<double> halves = seed_halves(seed);
    CHECK((static_cast<std::uint64_t>(halves.high) << 32 | static_cast<std::uint64_t>(halves.low)) == seed);
  }
}

TEST_CASE("a lane has the numbers of its single run, bit for bit") {
  check_lanes<2>();
  check_lanes<4>();
  check_lanes<8>();
}

TEST_CASE("drawing allocates nothing") {
  const RandomStream<Lanes<4>> s(SeedHalves<Lanes<4>>{}, RandomSource::encoder_noise);
  const long long before = allocations;
  const Vector<Lanes<4>, 8> numbers = s.normal<8>(5);
  CHECK(allocations == before);
  CHECK(all(is_finite(numbers)));
}
