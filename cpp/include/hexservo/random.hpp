/// @file
/// Counter-based random numbers: Philox 4x32-10 (Salmon, Moraes, Dror, Shaw: "Parallel random numbers: as easy as 1, 2,
/// 3", SC 2011; docs/model.md, section 7).
///
/// A number is a function of (seed, source, event, component) alone: no state is carried along, so that
/// more draws of one source change no other source, and neither the lane nor the thread that asks changes a bit. Every
/// sum below is one of whole numbers, so that a fused multiply-add cannot change a bit either.
#pragma once

#include "hexservo/types.hpp"

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

namespace hexservo {

/// What random numbers are drawn for. Their numbers are part of what a seed means: never renumber.
enum class RandomSource {
  feature_noise = 0,  ///< noise of the measured features
  outliers = 1,       ///< which features are outliers, and where they go
  dropout = 2,        ///< which frames never arrive
  latency = 3,        ///< jitter of the latency
  encoder_noise = 4,  ///< noise of the leg length encoders
  base_motion = 5,    ///< phases of band-limited base motion
  base_rotation = 6,  ///< those of its rotation
  road = 7            ///< waves of a road
};

namespace detail {

/// Output, counter and key words of Philox 4x32, least significant word first.
using PhiloxBlock = std::array<std::uint32_t, 4>;
using PhiloxKey = std::array<std::uint32_t, 2>;

/// Ten rounds of Philox 4x32: a bijection of the counter for every key.
constexpr PhiloxBlock philox(PhiloxBlock counter, PhiloxKey key) noexcept {
  constexpr std::uint64_t kMultiplier0 = 0xD2511F53, kMultiplier1 = 0xCD9E8D57;
  constexpr std::uint32_t kWeyl0 = 0x9E3779B9, kWeyl1 = 0xBB67AE85;  // golden ratio, sqrt(3) - 1
  for (int round = 0; round < 10; ++round) {
    const std::uint64_t product0 = kMultiplier0 * counter[0], product1 = kMultiplier1 * counter[2];
    counter = {static_cast<std::uint32_t>(product1 >> 32) ^ counter[1] ^ key[0], static_cast<std::uint32_t>(product1),
               static_cast<std::uint32_t>(product0 >> 32) ^ counter[3] ^ key[1], static_cast<std::uint32_t>(product0)};
    key = {key[0] + kWeyl0, key[1] + kWeyl1};
  }
  return counter;
}

/// Two words to a double in (0, 1): the middle of one of 2^52 equal cells, exactly; 1 - u is as likely as u.
constexpr double open_uniform(std::uint32_t low, std::uint32_t high) noexcept {
  const std::uint64_t bits = (static_cast<std::uint64_t>(high) << 32 | low) >> 11;
  return static_cast<double>(bits | 1) * 0x1p-53;
}

}  // namespace detail

/// A seed as two whole numbers below 2^32: parameters travel as doubles, which hold no 63 bits.
template <class S>
struct SeedHalves {
  S high{0.0};  ///< bits 32 to 63 [1], 0
  S low{0.0};   ///< bits 0 to 31 [1], 0

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"high", "1"}, self.high...);
    v(Field{"low", "1"}, self.low...);
  }
};

/// The halves of a seed.
inline SeedHalves<double> seed_halves(std::uint64_t seed) noexcept {
  return {static_cast<double>(seed >> 32), static_cast<double>(seed & 0xFFFFFFFF)};
}

/// The random numbers of one source; in a pack every lane has its own seed, and the numbers of its single run.
///
/// An event (a frame, a sample, a tick) has numbered components. The components of `uniform` and of `normal` are made
/// of the same bits: a source uses one of the two for an event. A smaller K gives the first components of a larger one.
template <class S>
class RandomStream {
 public:
  RandomStream(const SeedHalves<S>& seed, RandomSource source) noexcept {
    // Philox itself mixes seed and source into 64 bits of key: neighbouring seeds and sources have nothing in common.
    for (int lane = 0; lane < kLanes<S>; ++lane) {
      const detail::PhiloxBlock mixed = detail::philox(
          {static_cast<std::uint32_t>(source), 0, 0, 0},
          {static_cast<std::uint32_t>(of_lane(seed.low, lane)), static_cast<std::uint32_t>(of_lane(seed.high, lane))});
      keys_[static_cast<std::size_t>(lane)] = {mixed[0], mixed[1]};
    }
  }

  /// K independent numbers, uniform in the open interval (0, 1).
  template <int K>
  Vector<S, K> uniform(std::uint64_t event) const noexcept {
    return draw<K>(event, [](double u, double v) { return std::array{u, v}; });
  }

  /// K independent standard normal numbers, by the method of Box and Muller.
  template <int K>
  Vector<S, K> normal(std::uint64_t event) const noexcept {
    return draw<K>(event, [](double u, double v) {
      constexpr double kTwoPi = 6.283185307179586;
      const double radius = std::sqrt(-2.0 * std::log(u)), angle = kTwoPi * v;
      return std::array{radius * std::cos(angle), radius * std::sin(angle)};
    });
  }

 private:
  /// Components by pairs, each pair made of one block.
  template <int K, class Pair>
  Vector<S, K> draw(std::uint64_t event, Pair&& pair) const noexcept {
    Vector<S, K> numbers;
    for (int lane = 0; lane < kLanes<S>; ++lane)
      for (int k = 0; k < K; k += 2) {
        const detail::PhiloxBlock words =
            detail::philox({static_cast<std::uint32_t>(event), static_cast<std::uint32_t>(event >> 32),
                            static_cast<std::uint32_t>(k / 2), 0},
                           keys_[static_cast<std::size_t>(lane)]);
        const std::array<double, 2> two =
            pair(detail::open_uniform(words[0], words[1]), detail::open_uniform(words[2], words[3]));
        set_lane(numbers(k), lane, two[0]);
        if (k + 1 < K) set_lane(numbers(k + 1), lane, two[1]);
      }
    return numbers;
  }

  std::array<detail::PhiloxKey, static_cast<std::size_t>(kLanes<S>)> keys_;
};

}  // namespace hexservo
