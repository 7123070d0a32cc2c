/// @file
/// Sums of sine waves with their derivatives: sinusoids, band-limited noise and roads are made of them.
#pragma once

#include "hexservo/elementary.hpp"
#include "hexservo/spline.hpp"
#include "hexservo/types.hpp"

#include <array>
#include <vector>

namespace hexservo {

/// One sine wave: amplitude sin(2 pi (frequency t + phase)).
template <class S>
struct Wave {
  S amplitude{0.0};
  S frequency{0.0};  ///< [Hz]
  S phase{0.0};      ///< at t = 0 [turns]
};

/// A vector of three sums of waves.
template <class S>
class Waves {
 public:
  void add(int axis, const Wave<S>& wave) { waves_[static_cast<std::size_t>(axis)].push_back(wave); }

  /// Sums and their derivatives at a time [s].
  Curve<S, 3> at(double time) const noexcept {
    constexpr double kTwoPi = 6.283185307179586;
    Curve<S, 3> curve;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      S value(0.0), rate(0.0), acceleration(0.0);
      for (const Wave<S>& wave : waves_[axis]) {
        const S turns = wave.frequency * S(time) + wave.phase, w = S(kTwoPi) * wave.frequency;
        const S sine = wave.amplitude * sine_of_turns(turns);
        value += sine;
        rate += w * wave.amplitude * sine_of_turns(S(turns + S(0.25)));
        acceleration -= w * w * sine;
      }
      curve.value(static_cast<int>(axis)) = value;
      curve.rate(static_cast<int>(axis)) = rate;
      curve.acceleration(static_cast<int>(axis)) = acceleration;
    }
    return curve;
  }

  /// Each sum where all its waves are in phase.
  Vector3<S> largest() const {
    using std::abs;
    Vector3<S> sums = Vector3<S>::Zero();
    for (std::size_t axis = 0; axis < 3; ++axis)
      for (const Wave<S>& wave : waves_[axis]) sums(static_cast<int>(axis)) += abs(wave.amplitude);
    return sums;
  }

 private:
  std::array<std::vector<Wave<S>>, 3> waves_;
};

}  // namespace hexservo
