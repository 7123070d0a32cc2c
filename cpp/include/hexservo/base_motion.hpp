/// @file
/// Motion of the base, as of a vehicle, unknown to the controller: acceleration of the origin of the frame B, and its
/// attitude (docs/model.md, section 7).
///
/// B stays the frame of all quantities; it is then no longer inertial. W is the inertial frame with which B agrees
/// where it is displaced and turned by nothing. A function of time alone, so that every Runge-Kutta stage and every
/// step sees the same one.
///
///     sinusoid  a = amplitude sin(2 pi frequency t + phase)
///     recorded  linear between samples at 0, dt, 2 dt, ...; 0 after the last one
///     noise     a_x = sum_k sqrt(2 S df) sin(2 pi (f_k t + p_k)), k = 1 ... K, each axis with its own
///               phases p_k and frequencies f_k, f_k anywhere in the k-th of K cells of width df = (f_high - f_low)/K
///     road      of a vehicle on a rough road, with its attitude (road.hpp)
///
/// Each wave of the noise carries S df of variance, the share of its cell in a one-sided power spectral density S: the
/// variance of an axis is S (f_high - f_low), and its expected spectrum is S from f_low to f_high and 0 elsewhere.
/// Frequencies at random in their cells never repeat, as equally spaced ones would after 1/df.
///
/// Accelerations are along the axes of W, which are those of B while it does not turn. The rotation vector of B in W
/// has sinusoids or noise of the same form; recorded attitudes are joined by a cubic spline of their quaternions. Where
/// the place of B is needed (a target in W), it is the acceleration's integral with a mean of zero, for a recording the
/// one that starts and ends in W's origin.
#pragma once

#include "hexservo/recording.hpp"
#include "hexservo/road.hpp"

#include <algorithm>
#include <array>
#include <optional>

namespace hexservo {

/// How the base moves.
enum class BaseMotionKind { none, sinusoid, recorded, noise, road };

/// How the base turns, where neither a recording nor a road has an attitude.
enum class RotationKind { none, sinusoid, noise };

inline constexpr int kBaseMotionWaves = 32;  ///< K: waves of the noise of one axis

/// Rotation of the base: its rotation vector in W, axis by axis.
template <class S>
struct BaseRotationParameters {
  RotationKind kind = RotationKind::none;     ///< which of the following act
  Vector3<S> amplitude = Vector3<S>::Zero();  ///< of the sinusoids [rad], 0
  Vector3<S> frequency = Vector3<S>::Ones();  ///< of the sinusoids [Hz], 1
  Vector3<S> phase = Vector3<S>::Zero();      ///< of the sinusoids at t = 0 [rad], 0
  Vector3<S> level = Vector3<S>::Zero();      ///< one-sided spectral density of the noise [rad^2/Hz], 0
  S low_frequency{1.0};                       ///< where the noise begins [Hz], 1
  S high_frequency{10.0};                     ///< where the noise ends [Hz], 10

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"kind"}.of_pack().of_plant().in_sampled_mode(), self.kind...);
    v(Field{"amplitude", "rad"}.entrywise().of_plant().in_sampled_mode(), self.amplitude...);
    v(Field{"frequency", "Hz", kNotNegative}.of_plant().in_sampled_mode(), self.frequency...);
    v(Field{"phase", "rad", kAngle}.of_plant().in_sampled_mode(), self.phase...);
    v(Field{"level", "rad^2/Hz", kNotNegative}.of_plant().in_sampled_mode(), self.level...);
    v(Field{"low_frequency", "Hz", kNotNegative}.of_plant().in_sampled_mode(), self.low_frequency...);
    v(Field{"high_frequency", "Hz", kPositive}.of_plant().in_sampled_mode(), self.high_frequency...);
  }
};

/// Base motion but for what is recorded.
template <class S>
struct BaseMotionParameters {
  BaseMotionKind kind = BaseMotionKind::none;  ///< which of the following act
  Vector3<S> amplitude = Vector3<S>::Zero();   ///< of the sinusoid, in W [m/s^2], 0
  S frequency{1.0};                            ///< of the sinusoid [Hz], 1
  S phase{0.0};                                ///< of the sinusoid at t = 0 [rad], 0
  Vector3<S> level = Vector3<S>::Zero();       ///< one-sided spectral density of the noise, by axis [(m/s^2)^2/Hz], 0
  S low_frequency{1.0};                        ///< where the noise begins [Hz], 1
  S high_frequency{10.0};                      ///< where the noise ends [Hz], 10
  BaseRotationParameters<S> rotation{};
  RoadParameters<S> road{};

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"kind"}.of_pack().of_plant().in_sampled_mode(), self.kind...);
    v(Field{"amplitude", "m/s^2"}.entrywise().of_plant().in_sampled_mode(), self.amplitude...);
    v(Field{"frequency", "Hz", kNotNegative}.of_plant().in_sampled_mode(), self.frequency...);
    v(Field{"phase", "rad", kAngle}.of_plant().in_sampled_mode(), self.phase...);
    v(Field{"level", "(m/s^2)^2/Hz", kNotNegative}.of_plant().in_sampled_mode(), self.level...);
    v(Field{"low_frequency", "Hz", kNotNegative}.of_plant().in_sampled_mode(), self.low_frequency...);
    v(Field{"high_frequency", "Hz", kPositive}.of_plant().in_sampled_mode(), self.high_frequency...);
    v(Field{"rotation"}, self.rotation...);
    v(Field{"road"}, self.road...);
  }
};

/// How the base moves at an instant.
template <class S>
struct BaseState {
  Turning<S> turning;         ///< of B in W
  Vector3<S> acceleration_B;  ///< of B's origin, along B's axes [m/s^2]
};

/// Motion of B at any time.
template <class S>
class BaseMotion {
 public:
  /// @param seed of the noise
  /// @param recorded shared, not copied: its samples must outlive this
  BaseMotion(const BaseMotionParameters<S>& parameters, const SeedHalves<S>& seed, const Recording& recorded = {})
      : p_(parameters), recorded_(recorded) {
    using std::sqrt;
    const S cell = (p_.high_frequency - p_.low_frequency) * S(1.0 / kBaseMotionWaves);
    for (int axis = 0; axis < 3; ++axis) wave_amplitude_(axis) = sqrt(S(S(2.0) * p_.level(axis) * cell));
    if (p_.kind == BaseMotionKind::noise)
      draw_noise(RandomStream<S>(seed, RandomSource::base_motion), p_,
                 [&](std::size_t i, const S& frequency, const S& phase) { waves_[i] = {frequency, phase}; });
    if (p_.kind == BaseMotionKind::road) road_.emplace(p_.road, seed);
    if (p_.kind == BaseMotionKind::recorded && recorded.attitudes != nullptr) attitudes_ = attitude_spline(recorded);
    turns_ = p_.rotation.kind != RotationKind::none || road_ || attitudes_.count() > 0;
    if (turns_) turn(seed);
  }

  /// Whether B does anything but rest, in any lane.
  bool moves() const noexcept { return p_.kind != BaseMotionKind::none || turns_; }
  /// Whether B may turn, in any lane.
  bool turns() const noexcept { return turns_; }

  /// Acceleration of B's origin at t >= 0 [s], in W [m/s^2].
  Vector3<S> acceleration(double time) const noexcept {
    switch (p_.kind) {
      case BaseMotionKind::sinusoid:
        return p_.amplitude * sinusoid_at(time);
      case BaseMotionKind::recorded:
        return recorded_at(time);
      case BaseMotionKind::noise:
        return noise_at(time);
      case BaseMotionKind::road:
        return road_acceleration(road_->place.at(time), turning(time));
      case BaseMotionKind::none:
        break;
    }
    return Vector3<S>::Zero();
  }

  /// Attitude of B in W at t >= 0 [s], and how it changes.
  Turning<S> turning(double time) const noexcept {
    if (attitudes_.count() > 0) return turning_of(of_all_lanes<S>(attitudes_.at(time)));
    if (!turns_) return {};
    return turning_of(quaternion_curve(road_ ? road_->rotation.at(time) : rotation_.at(time)));
  }

  /// Everything of an instant t >= 0 [s].
  BaseState<S> state(double time) const noexcept {
    const Turning<S> turned = turning(time);
    const Vector3<S> a = road_ ? road_acceleration(road_->place.at(time), turned) : acceleration(time);
    return {turned, rotate_back<S>(turned.R_WB, a)};
  }

  /// Prepares `place`, which nothing else needs.
  void find_place() {
    if (p_.kind == BaseMotionKind::recorded) place_ = place_spline(recorded_);
  }

  /// p_WB: place of B's origin at t >= 0 [s], in W [m]. A sinusoid or noise with a frequency of 0 has none: NaN.
  Vector3<S> place(double time) const noexcept {
    constexpr double kTwoPi = 6.283185307179586;
    switch (p_.kind) {
      case BaseMotionKind::sinusoid: {
        const S w = S(kTwoPi) * p_.frequency, scale = -sinusoid_at(time) / (w * w);
        return p_.amplitude * scale;
      }
      case BaseMotionKind::recorded:
        return of_all_lanes<S>(place_.at(time)).value;
      case BaseMotionKind::noise: {
        Vector3<S> p;
        auto wave = waves_.begin();
        for (int axis = 0; axis < 3; ++axis) {
          S sum(0.0);
          for (int k = 0; k < kBaseMotionWaves; ++k, ++wave) {
            const S w = S(kTwoPi) * wave->frequency;
            sum -= sine_of_turns(S(wave->frequency * S(time) + wave->phase)) / (w * w);
          }
          p(axis) = wave_amplitude_(axis) * sum;
        }
        return p;
      }
      case BaseMotionKind::road: {  // the body turns about the middle of the wheels
        const Vector3<S> lever = rotate<S>(turning(time).R_WB, p_.road.position);
        return road_->place.at(time).value + lever - p_.road.position;
      }
      case BaseMotionKind::none:
        break;
    }
    return Vector3<S>::Zero();
  }

 private:
  struct NoiseWave {
    S frequency{0.0};  ///< [Hz]
    S phase{0.0};      ///< at t = 0 [turns]
  };

  static constexpr double kTurnsPerRadian = 0.15915494309189535;

  /// Calls `put(i, frequency, phase)` for each of the waves of three axes, K after K.
  template <class Band, class Put>
  static void draw_noise(const RandomStream<S>& stream, const Band& band, Put&& put) {
    const S cell = (band.high_frequency - band.low_frequency) * S(1.0 / kBaseMotionWaves);
    for (std::size_t i = 0; i < 3 * kBaseMotionWaves; ++i) {
      const Vector2<S> u = stream.template uniform<2>(i);
      const S cells_below(static_cast<double>(i % kBaseMotionWaves));
      put(i, S(band.low_frequency + (cells_below + u(0)) * cell), u(1));
    }
  }

  /// Waves of the rotation vector.
  [[gnu::noinline]] void turn(const SeedHalves<S>& seed) {
    using std::sqrt;
    const BaseRotationParameters<S>& r = p_.rotation;
    if (r.kind == RotationKind::sinusoid)
      for (int axis = 0; axis < 3; ++axis)
        rotation_.add(axis, {r.amplitude(axis), r.frequency(axis), S(r.phase(axis) * S(kTurnsPerRadian))});
    if (r.kind != RotationKind::noise) return;
    const S cell = (r.high_frequency - r.low_frequency) * S(1.0 / kBaseMotionWaves);
    draw_noise(RandomStream<S>(seed, RandomSource::base_rotation), r,
               [&](std::size_t i, const S& frequency, const S& phase) {
                 const int axis = static_cast<int>(i / kBaseMotionWaves);
                 rotation_.add(axis, {S(sqrt(S(S(2.0) * r.level(axis) * cell))), frequency, phase});
               });
  }

  /// In W, of B's origin on a vehicle whose wheels' middle moves like this.
  Vector3<S> road_acceleration(const Curve<S, 3>& middle, const Turning<S>& turned) const noexcept {
    const Vector3<S>& w = turned.rate_B;
    const Vector3<S> along = cross<S>(w, p_.road.position);
    return middle.acceleration +
           rotate<S>(turned.R_WB, Vector3<S>(cross<S>(turned.rate_change_B, p_.road.position) + cross<S>(w, along)));
  }

  /// Quaternions of unit length and of one sign: q and -q are the same attitude.
  static UniformSpline<4> attitude_spline(const Recording& recorded) {
    std::vector<double> rows(recorded.attitudes, recorded.attitudes + 4 * recorded.count);
    Eigen::Map<Eigen::Matrix<double, 4, Eigen::Dynamic>> q(rows.data(), 4, recorded.count);
    for (long long i = 0; i < recorded.count; ++i) {
      q.col(i).normalize();
      if (i > 0 && q.col(i).dot(q.col(i - 1)) < 0.0) q.col(i) *= -1.0;
    }
    return {std::move(rows), recorded.period};
  }

  /// Double integral of straight lines between accelerations: a cubic spline whose second derivatives are those. Its
  /// first and its last place are 0.
  static UniformSpline<3> place_spline(const Recording& recorded) {
    const double h = recorded.period;
    std::vector<double> accelerations(recorded.samples, recorded.samples + 3 * recorded.count);
    std::vector<double> places(accelerations.size(), 0.0);
    const Eigen::Map<const Eigen::Matrix<double, 3, Eigen::Dynamic>> a(accelerations.data(), 3, recorded.count);
    Eigen::Map<Eigen::Matrix<double, 3, Eigen::Dynamic>> p(places.data(), 3, recorded.count);
    Vector3<double> v = Vector3<double>::Zero();
    for (long long i = 0; i + 1 < recorded.count; ++i) {
      p.col(i + 1) = p.col(i) + h * v + h * h / 6.0 * (2.0 * a.col(i) + a.col(i + 1));
      v += 0.5 * h * (a.col(i) + a.col(i + 1));
    }
    const Vector3<double> end = p.col(recorded.count - 1) / static_cast<double>(recorded.count - 1);
    for (long long i = 0; i < recorded.count; ++i) p.col(i) -= static_cast<double>(i) * end;
    return {std::move(places), std::move(accelerations), h};
  }

  S sinusoid_at(double time) const noexcept {
    return sine_of_turns(S(p_.frequency * S(time) + p_.phase * S(kTurnsPerRadian)));
  }

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
  Recording recorded_;
  Vector3<S> wave_amplitude_;                          ///< sqrt(2 S df), by axis [m/s^2]
  std::array<NoiseWave, 3 * kBaseMotionWaves> waves_;  ///< axis by axis
  bool turns_ = false;
  Waves<S> rotation_;  ///< rotation vector of B in W [rad]
  std::optional<RoadWaves<S>> road_;
  UniformSpline<4> attitudes_;  ///< recorded
  UniformSpline<3> place_;      ///< of a recording, where it is needed
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

/// What a base that turns adds to the wrench on the actual platform, in B [N; N m]: of the motion relative to B
///
///     D chi-ddot + C chi-dot + G = tau + wrench
///     wrench = -D (a + Omega-dot x p + Omega x (Omega x p + 2 v); Omega-dot + Omega x omega)
///              - C(v; omega + Omega) (v; omega + Omega) + C(v; omega) (v; omega) - G(R_WB^T g) + G(g)
///
/// with D, C and G each (1 - delta) times the nominal ones, entry by entry as on a base that rests.
/// @param p_BE of E's origin [m]; @param twist of the motion relative to B
template <class S>
[[gnu::noinline]] Vector6<S> moving_base_wrench(const Plant<S>& plant, const Vector3<S>& p_BE, const Matrix3<S>& R_BE,
                                                const Vector6<S>& twist, const BaseState<S>& base) {
  const Vector3<S>& rate = base.turning.rate_B;
  const Vector3<S> v = twist.template head<3>(), omega = twist.template tail<3>();
  const Vector3<S> carried = cross<S>(rate, p_BE);
  Vector6<S> acceleration, total = twist;
  acceleration.template head<3>() = base.acceleration_B + cross<S>(base.turning.rate_change_B, p_BE) +
                                    cross<S>(rate, Vector3<S>(carried + S(2.0) * v));
  acceleration.template tail<3>() = base.turning.rate_change_B + cross<S>(rate, omega);
  total.template tail<3>() += rate;
  const auto gyroscopic = [&](const Vector6<S>& y) {
    const Matrix6<S> C =
        (Matrix6<S>::Ones() - plant.dynamics_error.coriolis).cwiseProduct(coriolis_matrix(plant.body, R_BE, y));
    return Vector6<S>(C * y);
  };
  RigidBody<S> tilted = plant.body;
  tilted.gravity = rotate_back<S>(base.turning.R_WB, plant.body.gravity);
  const Vector6<S> G = gravity_wrench(tilted, R_BE) - gravity_wrench(plant.body, R_BE);
  return -(plant.mass_matrix_at(R_BE) * acceleration) - (gyroscopic(total) - gyroscopic(twist)) -
         (G - plant.dynamics_error.gravity.cwiseProduct(G));
}

}  // namespace hexservo
