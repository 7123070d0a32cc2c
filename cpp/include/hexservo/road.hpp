/// @file
/// A vehicle on a rough road: heave, pitch and roll of its body (docs/model.md, section 7).
///
/// ISO 8608:2016 classifies roads by the one-sided power spectral density of the height of a track,
///
///     G_d(n) = G_d(n_0) (n/n_0)^-2,   n_0 = 0.1 cycles/m,   G_d(n_0) = 16e-6 4^k m^3 for the classes A (k = 0) to H
///     (7)
///
/// The geometric means of the classes. The road is a sum of waves with that expected spectrum from the longest to the
/// shortest wavelength: cell k of the spatial frequencies, equal in log n, holds one wave with the variance of the
/// cell, and its n is drawn with a density in proportion to G_d. Left and right track are c + d and c - d, with shares
/// (1 + gamma)/2 and (1 - gamma)/2 of the variance, where gamma(n) = 2 pi n b K_1(2 pi n b) is the coherence of tracks
/// at the distance b on an isotropic surface.
///
/// Wheels touch the road in points at +-wheelbase/2 and +-track/2. With the mean heights h of pairs of wheels,
///
///     heave = mean of the four,   pitch = (h_front - h_rear)/wheelbase,   roll = (h_left - h_right)/track
///
/// and the body follows each of the three through (1 + 2 i zeta r)/(1 - r^2 + 2 i zeta r), r = f/f_n, the response of a
/// mass on spring and damper to the motion of its foot. B's x axis points ahead, y to the right, z down.
#pragma once

#include "hexservo/attitude.hpp"
#include "hexservo/random.hpp"
#include "hexservo/waves.hpp"

#include <cmath>
#include <complex>
#include <initializer_list>

namespace hexservo {

/// Roughness of a road, ISO 8608: A is a good motorway, E a bad track.
enum class RoadClass { A, B, C, D, E, F, G, H };

inline constexpr int kRoadWaves = 32;                 ///< of the tracks' mean, and as many of their difference
inline constexpr double kRoadReference = 0.1;         ///< n_0 [cycles/m]
inline constexpr double kRoadLeastRoughness = 16e-6;  ///< G_d(n_0) of class A [m^3]

/// A road, and the vehicle on it.
template <class S>
struct RoadParameters {
  RoadClass roughness = RoadClass::A;        ///< class of ISO 8608, A
  S speed{10.0};                             ///< of the vehicle [m/s], 10
  S wheelbase{2.7};                          ///< between the axles [m], 2.7
  S track{1.5};                              ///< b, between the wheels of an axle [m], 1.5
  S suspension{1.5};                         ///< f_n of the body on its springs [Hz], 1.5; infinite: rigid
  S damping{0.3};                            ///< zeta of the body on its springs [1], 0.3
  S longest{100.0};                          ///< wavelength of the road [m], 100
  S shortest{0.1};                           ///< wavelength of the road [m], 0.1
  Vector3<S> position = Vector3<S>::Zero();  ///< of B's origin from the middle of the wheels, in B [m], 0

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"roughness"}.of_pack().of_plant().in_sampled_mode(), self.roughness...);
    v(Field{"speed", "m/s", kPositive}.of_plant().in_sampled_mode(), self.speed...);
    v(Field{"wheelbase", "m", kPositive}.of_plant().in_sampled_mode(), self.wheelbase...);
    v(Field{"track", "m", kPositive}.of_plant().in_sampled_mode(), self.track...);
    v(Field{"suspension", "Hz", kPositiveOrNone}.of_plant().in_sampled_mode(), self.suspension...);
    v(Field{"damping", "1", kPositive}.of_plant().in_sampled_mode(), self.damping...);
    v(Field{"longest", "m", kPositive}.of_plant().in_sampled_mode(), self.longest...);
    v(Field{"shortest", "m", kPositive}.of_plant().in_sampled_mode(), self.shortest...);
    v(Field{"position", "m"}.entrywise().of_plant().in_sampled_mode(), self.position...);
  }
};

/// x K_1(x) of the modified Bessel function K_1, x > 0, within 1e-6 (Abramowitz and Stegun, 9.8.3, 9.8.7 and 9.8.8).
inline double bessel_coherence(double x) noexcept {
  const auto polynomial = [](double t, std::initializer_list<double> coefficients) {  // the highest power first
    double sum = 0.0;
    for (const double c : coefficients) sum = sum * t + c;
    return sum;
  };
  if (x > 2.0)
    return std::sqrt(x) * std::exp(-x) *
           polynomial(2.0 / x, {-0.00068245, 0.00325614, -0.00780353, 0.01504268, -0.03655620, 0.23498619, 1.25331414});
  const double first_kind = polynomial(x * x / (3.75 * 3.75), {0.00032411, 0.00301532, 0.02658733, 0.15084934,
                                                               0.51498869, 0.87890594, 0.5});  // I_1(x)/x
  return x * x * std::log(0.5 * x) * first_kind +
         polynomial(0.25 * x * x, {-0.00004686, -0.00110404, -0.01919402, -0.18156897, -0.67278579, 0.15443144, 1.0});
}

/// Waves of the middle of the wheels and of the attitude that follows.
template <class S>
struct RoadWaves {
  Waves<S> place;     ///< of the middle of the wheels in W [m]: heave is along -z
  Waves<S> rotation;  ///< rotation vector (roll, pitch, 0) of B in W [rad]

  RoadWaves(const RoadParameters<S>& road, const SeedHalves<S>& seed) {
    const RandomStream<S> stream(seed, RandomSource::road);
    for (std::uint64_t k = 0; k < 2 * kRoadWaves; ++k) {
      const Vector2<S> u = stream.template uniform<2>(k);
      Wave<S> heave, pitch, roll;
      for (int lane = 0; lane < kLanes<S>; ++lane)
        set(road, k, of_lane(u(0), lane), of_lane(u(1), lane), lane, heave, pitch, roll);
      if (k < kRoadWaves) {
        place.add(2, heave);
        rotation.add(1, pitch);
      } else {
        rotation.add(0, roll);
      }
    }
  }

 private:
  /// Wave k of one lane: of the tracks' mean, and behind those of their difference.
  /// @param u where the wave is in its cell, of 1/n; @param phase of the road at the middle of the wheels [turns]
  static void set(const RoadParameters<S>& road, std::uint64_t k, double u, double phase, int lane, Wave<S>& heave,
                  Wave<S>& pitch, Wave<S>& roll) {
    constexpr double kPi = 3.141592653589793;
    const double longest = of_lane(road.longest, lane), shortest = of_lane(road.shortest, lane);
    const double speed = of_lane(road.speed, lane), base = of_lane(road.wheelbase, lane),
                 track = of_lane(road.track, lane);
    const double ratio = shortest / longest, cell = static_cast<double>(k % kRoadWaves);
    const double above = longest * std::pow(ratio, cell / kRoadWaves),
                 below = longest * std::pow(ratio, (cell + 1.0) / kRoadWaves);
    const double n = 1.0 / (below + u * (above - below)), f = n * speed;
    const double level = kRoadLeastRoughness * std::pow(4.0, static_cast<double>(road.roughness));
    const double coherence = bessel_coherence(2.0 * kPi * n * track);
    const double share = 0.5 * (k < kRoadWaves ? 1.0 + coherence : 1.0 - coherence);
    const double amplitude = std::sqrt(2.0 * share * level * kRoadReference * kRoadReference * (above - below));
    const double r = f / of_lane(road.suspension, lane);
    const std::complex<double> damper(1.0, 2.0 * of_lane(road.damping, lane) * r), response = damper / (damper - r * r);
    const double gain = amplitude * std::abs(response), lag = std::arg(response) / (2.0 * kPi);
    const auto put = [lane](Wave<S>& wave, double a, double frequency, double at) {
      set_lane(wave.amplitude, lane, a);
      set_lane(wave.frequency, lane, frequency);
      set_lane(wave.phase, lane, at);
    };
    put(heave, -gain * std::cos(kPi * n * base), f, phase + lag);
    put(pitch, gain * 2.0 / base * std::sin(kPi * n * base), f, phase + lag + 0.25);
    put(roll, gain * 2.0 / track * std::cos(kPi * n * base), f, phase + lag);
  }
};

}  // namespace hexservo
