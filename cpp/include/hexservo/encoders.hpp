/// @file
/// Leg length encoders of the sampled loop: what they read of the true motion (docs/model.md, section 7). What the
/// controller makes of their readings is in perception.hpp.
///
/// Every `period` ticks the six lengths are read: the nearest multiple of the resolution to l_i + noise.
#pragma once

#include "hexservo/elementary.hpp"
#include "hexservo/hexapod.hpp"
#include "hexservo/random.hpp"

namespace hexservo {

/// Source of the controller's pose and twist, in `sampled` mode.
enum class PoseSource {
  truth,    ///< both are measured directly at every tick, in simulation exactly
  encoders  ///< from the lengths of the legs
};

/// Where the leg rates come from.
enum class RateSource {
  differences,  ///< of the readings, (l - l before)/period: the mean rate since the reading before; 0 at the first one
  true_rates    ///< H^T chi-dot of the true motion at the reading: an ideal rate sensor beside the encoders
};

/// What the encoders of all legs tell.
template <class S>
struct EncoderReadings {
  RateSource rate = RateSource::differences;  ///< what the twist is made of
  S resolution{0.0};                          ///< a reading is a multiple of it [m], 0 (none)
  S noise{0.0};                               ///< standard deviation before the rounding [m], 0

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"rate"}.of_pack().in_sampled_mode(), self.rate...);
    v(Field{"resolution", "m", kNotNegative}.of_plant().in_sampled_mode(), self.resolution...);
    v(Field{"noise", "m", kNotNegative}.of_plant().in_sampled_mode(), self.noise...);
  }
};

/// The same with their timing.
template <class S>
struct EncoderParameters : EncoderReadings<S> {
  long long period = 1;  ///< ticks between readings, 1

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    EncoderReadings<S>::visit(v, self...);
    v(Field{"period"}, self.period...);
  }
};

/// What the encoders hand over at a tick; NaN: nothing.
template <class S>
struct LegReading {
  Vector6<S> lengths = Vector6<S>::Constant(S(std::numeric_limits<double>::quiet_NaN()));  ///< l_i [m]
  Vector6<S> rates = Vector6<S>::Constant(S(std::numeric_limits<double>::quiet_NaN()));    ///< l-dot_i, measured [m/s]
};

/// Six encoders.
template <class S>
class Encoders {
 public:
  Encoders(const EncoderParameters<S>& parameters, const SeedHalves<S>& seed) noexcept
      : p_(parameters), stream_(seed, RandomSource::encoder_noise), noisy_(any(parameters.noise > S(0.0))) {}

  /// What is read at a tick, if it is one of theirs.
  /// @param legs at the true pose; @param twist true, in B [m/s; rad/s]
  LegReading<S> read(long long tick, const LegsSideBySide<S>& legs, const Vector6<S>& twist) const noexcept {
    LegReading<S> reading;
    if (tick % p_.period != 0) return reading;
    reading.lengths = legs.lengths.vector();
    if (noisy_) reading.lengths += p_.noise * stream_.template normal<6>(static_cast<std::uint64_t>(tick / p_.period));
    for (int i = 0; i < 6; ++i) reading.lengths(i) = quantise(reading.lengths(i), p_.resolution);
    if (p_.rate == RateSource::true_rates) reading.rates = Legs<S>::of(legs).rates(twist);
    return reading;
  }

 private:
  EncoderParameters<S> p_;
  RandomStream<S> stream_;
  bool noisy_;  ///< in any lane
};

}  // namespace hexservo
