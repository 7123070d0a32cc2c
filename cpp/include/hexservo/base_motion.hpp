/// @file
/// Motion of the base, as of a vehicle: linear acceleration of the frame B, unknown to the controller
/// (docs/model.md, section 7).
///
/// B stays the frame of all quantities; it is then no longer inertial, and the inertial force -(1 - delta_D) m a acts
/// on the platform's actual mass. A function of time alone, so that every Runge-Kutta stage and every step sees the
/// same one.
///
///     sinusoid  a = amplitude sin(2 pi frequency t + phase)
///     recorded  linear between samples at 0, dt, 2 dt, ...; 0 after the last one
///     noise     a_x = sum_k sqrt(2 S df) sin(2 pi (f_k t + p_k)), k = 1 ... K, each axis with its own
///               phases p_k and frequencies f_k, f_k anywhere in the k-th of K cells of width df = (f_high - f_low)/K
///
/// Each wave of the noise carries S df of variance, the share of its cell in a one-sided power spectral density S: the
/// variance of an axis is S (f_high - f_low), and its expected spectrum is S from f_low to f_high and 0 elsewhere.
/// Frequencies at random in their cells never repeat, as equally spaced ones would after 1/df.
#pragma once

#include "hexservo/elementary.hpp"
#include "hexservo/random.hpp"
#include "hexservo/rigid_body.hpp"

#include <algorithm>
#include <array>

namespace hexservo {

/// How the base moves.
enum class BaseMotionKind { none, sinusoid, recorded, noise };

inline constexpr int kBaseMotionWaves = 32;  ///< K: waves of the noise of one axis

/// Base motion but for what is recorded.
template <class S>
struct BaseMotionParameters {
  BaseMotionKind kind = BaseMotionKind::none;  ///< which of the following act
  Vector3<S> amplitude = Vector3<S>::Zero();   ///< of the sinusoid, in B [m/s^2], 0
  S frequency{1.0};                            ///< of the sinusoid [Hz], 1
  S phase{0.0};                                ///< of the sinusoid at t = 0 [rad], 0
  Vector3<S> level = Vector3<S>::Zero();       ///< one-sided spectral density of the noise, by axis [(m/s^2)^2/Hz], 0
  S low_frequency{1.0};                        ///< where the noise begins [Hz], 1
  S high_frequency{10.0};                      ///< where the noise ends [Hz], 10

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"kind"}.of_pack().of_plant().in_sampled_mode(), self.kind...);
    v(Field{"amplitude", "m/s^2"}.entrywise().of_plant().in_sampled_mode(), self.amplitude...);
    v(Field{"frequency", "Hz", kNotNegative}.of_plant().in_sampled_mode(), self.frequency...);
    v(Field{"phase", "rad", kAngle}.of_plant().in_sampled_mode(), self.phase...);
    v(Field{"level", "(m/s^2)^2/Hz", kNotNegative}.of_plant().in_sampled_mode(), self.level...);
    v(Field{"low_frequency", "Hz", kNotNegative}.of_plant().in_sampled_mode(), self.low_frequency...);
    v(Field{"high_frequency", "Hz", kPositive}.of_plant().in_sampled_mode(), self.high_frequency...);
  }
};

/// Recorded accelerations, which belong to the caller and are shared by all lanes.
struct RecordedAcceleration {
  const double* samples = nullptr;  ///< a_x, a_y, a_z of each sample, one after the other, in B [m/s^2]
  long long count = 0;              ///< samples, >= 2
  double period = 1.0;              ///< time between two samples; the first is at 0 [s]
};

/// Acceleration of B at any time.
template <class S>
class BaseMotion {
 public:
  /// @param seed of the noise
  /// @param recorded shared, not copied: its samples must outlive this
  BaseMotion(const BaseMotionParameters<S>& parameters, const SeedHalves<S>& seed,
             const RecordedAcceleration& recorded = {}) noexcept
      : p_(parameters), recorded_(recorded) {
    using std::sqrt;
    const S cell = (p_.high_frequency - p_.low_frequency) * S(1.0 / kBaseMotionWaves);
    for (int axis = 0; axis < 3; ++axis) wave_amplitude_(axis) = sqrt(S(S(2.0) * p_.level(axis) * cell));
    if (p_.kind != BaseMotionKind::noise) return;
    const RandomStream<S> stream(seed, RandomSource::base_motion);
    for (std::size_t i = 0; i < waves_.size(); ++i) {
      const Vector2<S> u = stream.template uniform<2>(i);
      const S cells_below(static_cast<double>(i % kBaseMotionWaves));
      waves_[i] = {p_.low_frequency + (cells_below + u(0)) * cell, u(1)};
    }
  }

  /// Acceleration of B at t >= 0 [s], in B [m/s^2].
  Vector3<S> acceleration(double time) const noexcept {
    constexpr double kTurnsPerRadian = 0.15915494309189535;
    switch (p_.kind) {
      case BaseMotionKind::sinusoid:
        return p_.amplitude * sine_of_turns(S(p_.frequency * S(time) + p_.phase * S(kTurnsPerRadian)));
      case BaseMotionKind::recorded:
        return recorded_at(time);
      case BaseMotionKind::noise:
        return noise_at(time);
      case BaseMotionKind::none:
        break;
    }
    return Vector3<S>::Zero();
  }

 private:
  struct Wave {
    S frequency{0.0};  ///< [Hz]
    S phase{0.0};      ///< at t = 0 [turns]
  };

  Vector3<S> noise_at(double time) const noexcept {
    Vector3<S> a;
    auto wave = waves_.begin();
    for (int axis = 0; axis < 3; ++axis) {
      S sum(0.0);
      for (int k = 0; k < kBaseMotionWaves; ++k, ++wave)
        sum += sine_of_turns(S(wave->frequency * S(time) + wave->phase));
      a(axis) = wave_amplitude_(axis) * sum;
    }
    return a;
  }

  Vector3<S> recorded_at(double time) const noexcept {
    const double place = time / recorded_.period;
    const double last = static_cast<double>(recorded_.count - 1);
    if (!(place >= 0.0 && place <= last * (1.0 + 1e-12))) return Vector3<S>::Zero();  // times of a grid are rounded
    const long long before = std::min(static_cast<long long>(place), recorded_.count - 2);
    const double share = place - static_cast<double>(before);
    const double* from = recorded_.samples + 3 * before;
    Vector3<S> a;
    for (int axis = 0; axis < 3; ++axis) a(axis) = S(from[axis] + share * (from[axis + 3] - from[axis]));
    return a;
  }

  BaseMotionParameters<S> p_;
  RecordedAcceleration recorded_;
  Vector3<S> wave_amplitude_;                     ///< sqrt(2 S df), by axis [m/s^2]
  std::array<Wave, 3 * kBaseMotionWaves> waves_;  ///< axis by axis
};

/// Wrench of the inertial force -(1 - delta_D) m a on the actual platform, in its centre of mass, in B [N; N m].
/// @param acceleration_B of the frame B, in B [m/s^2]
template <class S>
Vector6<S> inertial_wrench(const Plant<S>& plant, const Matrix3<S>& R_BE, const Vector3<S>& acceleration_B) {
  Vector6<S> wrench = Vector6<S>::Zero();
  if (plant.body.off_centre) {
    const Matrix6<S> D = plant.mass_matrix_at(R_BE);
    for (int j = 0; j < 3; ++j)
      for (int i = 0; i < 6; ++i) wrench(i) -= D(i, j) * acceleration_B(j);
    return wrench;
  }
  for (int i = 0; i < 3; ++i) wrench(i) = -acceleration_B(i) / plant.inverse_mass(i);
  return wrench;
}

}  // namespace hexservo
