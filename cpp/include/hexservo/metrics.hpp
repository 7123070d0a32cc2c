/// @file
/// Metrics of a run, streamed at every step, so that they do not depend on what is logged; and limits, reported on the
/// way. Definitions: docs/model.md, section 8.
#pragma once

#include "hexservo/leg_limits.hpp"

namespace hexservo {

/// What is measured, when and against what.
template <class S>
struct MetricsSettings {
  S band{2.0};             ///< of settling: every |xi-tilde_i| is within this [px], 2
  S dwell{0.2};            ///< how long a run must have stayed within the band at its end to be settled [s], 0.2
  double rms_start = 1.0;  ///< the RMS error is taken from here to the end [s], 1

  bool operator==(const MetricsSettings&) const = default;

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"band", "px", kPositive}.of_run(), self.band...);
    v(Field{"dwell", "s", kPositive}.of_run(), self.dwell...);
    v(Field{"rms_start", "s", kNotNegative}.of_pack().of_run(), self.rms_start...);
  }
};

/// Metrics that are measured together.
enum class MetricGroup {
  errors,       ///< of the features
  motion,       ///< of the platform
  control,      ///< what the wrench costs
  excursions,   ///< of the features from the straight ways to their goals
  leg_lengths,  ///< and whether a stroke is passed
  leg_forces,   ///< and whether the limit of force is passed
  leg_motion    ///< speeds and tilts, where they have limits
};

/// Groups that are asked for: all, unless some are left out. What is left out costs nothing, and has no meaning.
class MetricGroups {
 public:
  MetricGroups() = default;
  /// @param left_out a bit for each group, 1 << its number
  explicit constexpr MetricGroups(unsigned left_out) : left_out_(left_out) {}
  static constexpr MetricGroups none() { return MetricGroups(~0U); }

  constexpr bool has(MetricGroup group) const { return (left_out_ & bit(group)) == 0; }
  constexpr void add(MetricGroup group) { left_out_ &= ~bit(group); }
  /// As the constructor takes them.
  constexpr unsigned left_out() const { return left_out_; }

 private:
  static constexpr unsigned bit(MetricGroup group) { return 1U << static_cast<unsigned>(group); }

  unsigned left_out_ = 0;
};

/// Name of a metric, and what it is measured with.
struct MetricName {
  const char* name;
  MetricGroup group;

  constexpr operator const char*() const { return name; }  // NOLINT: a name, for those who ask for no more
};

/// One sample of the closed loop at a grid time.
template <class S, int N = kPoints>
struct Sample {
  Vector<S, 2 * N> feature_error;  ///< xi_d - xi, true [px]
  Vector<S, N> depth;              ///< Z_i, true [m]
  Vector3<S> position;             ///< p_BE [m]
  Vector4<S> quaternion;           ///< (w, x, y, z)
  Vector6<S> twist;                ///< in B [m/s; rad/s]
  Vector6<S> wrench;               ///< tau, in B [N; N m]
  Vector6<S> fuzzy_output;         ///< tau_f [N; N m]
  Vector6<S> leg_lengths;          ///< [m]
  Vector6<S> leg_forces;           ///< f_c [N]

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v("feature_error", self.feature_error...);
    v("depth", self.depth...);
    v("position", self.position...);
    v("quaternion", self.quaternion...);
    v("twist", self.twist...);
    v("wrench", self.wrench...);
    v("fuzzy_output", self.fuzzy_output...);
    v("leg_lengths", self.leg_lengths...);
    v("leg_forces", self.leg_forces...);
  }
};

/// Metrics of one run (`S = double`) or of a pack.
template <class S>
struct Metrics {
  S settling_time{0.0};        ///< last time any |xi-tilde_i| exceeds the band [s]; NaN where the run is not settled
  S final_error{0.0};          ///< max |xi-tilde_i| at the end [px]
  S rms_error{0.0};            ///< over all components of xi-tilde from rms_start on [px]; NaN where the run is shorter
  S peak_error{0.0};           ///< max |xi-tilde_i| of the run [px]
  S peak_displacement{0.0};    ///< max |x_p - x_p(0)| [m]
  S peak_rotation{0.0};        ///< max rotation angle from the start [rad]
  S final_linear_speed{0.0};   ///< |v| at the end [m/s]
  S final_angular_speed{0.0};  ///< |omega| at the end [rad/s]
  S peak_control_force{0.0};   ///< max |tau_j - G_j| of the force [N]
  S peak_control_moment{0.0};  ///< max |tau_j - G_j| of the moment [N m]
  S peak_leg_force{0.0};       ///< max |f_c,i| [N]
  S peak_leg_excursion{0.0};   ///< max |l_i - middle of its travel| [m]
  S overshoot{0.0};            ///< max excursion of a xi_i beyond its goal, seen from its start [px]
  S relative_overshoot{0.0};   ///< the same, each relative to |xi-tilde_i(0)| [1]
  S peak_feature_distance{0.0};  ///< max distance of a feature from the image centre [px]
  S peak_line_deviation{0.0};    ///< max distance of a feature from the line through its start and goal [px]
  S effort{0.0};                 ///< integral of |w|^2, w = tau - G with moments divided by the platform radius [N^2 s]
  S chatter{0.0};  ///< total variation of w, summed over its components, per second [N/s]; NaN for a single sample
  S peak_leg_speed{0.0};       ///< max |l-dot_i| [m/s]; NaN without a speed limit
  S peak_base_joint{0.0};      ///< max tilt of a leg seen from the base [rad]; NaN without a limit of it
  S peak_platform_joint{0.0};  ///< the same seen from the platform

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(MetricName{"settling_time", MetricGroup::errors}, self.settling_time...);
    v(MetricName{"final_error", MetricGroup::errors}, self.final_error...);
    v(MetricName{"rms_error", MetricGroup::errors}, self.rms_error...);
    v(MetricName{"peak_error", MetricGroup::errors}, self.peak_error...);
    v(MetricName{"peak_displacement", MetricGroup::motion}, self.peak_displacement...);
    v(MetricName{"peak_rotation", MetricGroup::motion}, self.peak_rotation...);
    v(MetricName{"final_linear_speed", MetricGroup::motion}, self.final_linear_speed...);
    v(MetricName{"final_angular_speed", MetricGroup::motion}, self.final_angular_speed...);
    v(MetricName{"peak_control_force", MetricGroup::control}, self.peak_control_force...);
    v(MetricName{"peak_control_moment", MetricGroup::control}, self.peak_control_moment...);
    v(MetricName{"peak_leg_force", MetricGroup::leg_forces}, self.peak_leg_force...);
    v(MetricName{"peak_leg_excursion", MetricGroup::leg_lengths}, self.peak_leg_excursion...);
    v(MetricName{"overshoot", MetricGroup::excursions}, self.overshoot...);
    v(MetricName{"relative_overshoot", MetricGroup::excursions}, self.relative_overshoot...);
    v(MetricName{"peak_feature_distance", MetricGroup::excursions}, self.peak_feature_distance...);
    v(MetricName{"peak_line_deviation", MetricGroup::excursions}, self.peak_line_deviation...);
    v(MetricName{"effort", MetricGroup::control}, self.effort...);
    v(MetricName{"chatter", MetricGroup::control}, self.chatter...);
    v(MetricName{"peak_leg_speed", MetricGroup::leg_motion}, self.peak_leg_speed...);
    v(MetricName{"peak_base_joint", MetricGroup::leg_motion}, self.peak_base_joint...);
    v(MetricName{"peak_platform_joint", MetricGroup::leg_motion}, self.peak_platform_joint...);
  }
};

namespace detail {
/// Accumulation of metrics where every lane runs and each number is finite: no selection by lane.
struct TakeAll {
  template <class S>
  S keep(const S& /*old*/, const S& next) const {
    return next;
  }
  template <class S>
  S larger(const S& a, const S& b) const {
    return hexservo::larger(a, b);
  }
};
/// The same anywhere: lanes that do not run keep their numbers, and no NaN is swallowed.
template <class M>
struct TakeWhere {
  M active;

  template <class S>
  S keep(const S& old, const S& next) const {
    return select(active, next, old);
  }
  template <class S>
  S larger(const S& a, const S& b) const {
    return max(a, b);
  }
};

/// Largest absolute entry.
template <class S, int N, class Take>
S largest_abs(const Vector<S, N>& values, const Take& take) {
  using std::abs;
  S result = abs(values(0));
  for (int i = 1; i < N; ++i) result = take.larger(result, S(abs(values(i))));
  return result;
}
}  // namespace detail

/// How far the features leave the straight ways to their goals. Coordinates and features that start within the settling
/// band of their goal have no side to overshoot to and no line: they count for the distance alone.
template <class S, int N>
class FeatureExcursions {
 public:
  FeatureExcursions(const S& band, const Vector<S, 2 * N>& desired, const Vector<S, 2 * N>& first_error)
      : desired_(desired), limit_(band) {
    for (int i = 0; i < 2 * N; ++i) {
      start_(i) = first_error(i);
      side_(i) = select(abs_of(start_(i)) > limit_, select(start_(i) > S(0.0), S(-1.0), S(1.0)), S(0.0));
    }
    for (int i = 0; i < N; ++i) {
      using std::sqrt;
      const S x = start_(2 * i), y = start_(2 * i + 1), length = sqrt(S(x * x + y * y));
      const Mask<S> has_line = length > limit_;
      normal_(2 * i) = select(has_line, -y / length, S(0.0));
      normal_(2 * i + 1) = select(has_line, x / length, S(0.0));
    }
  }

  template <class Take>
  void add(const Vector<S, 2 * N>& error, const Take& take) {
    for (int i = 0; i < 2 * N; ++i) beyond_(i) = take.keep(beyond_(i), take.larger(beyond_(i), S(side_(i) * error(i))));
    S distance = distance_squared_, deviation = deviation_;
    for (int i = 0; i < N; ++i) {
      const int x = 2 * i, y = x + 1;
      const S u = desired_(x) - error(x), v = desired_(y) - error(y);
      distance = take.larger(distance, S(u * u + v * v));
      deviation = take.larger(deviation, abs_of(S(normal_(x) * error(x) + normal_(y) * error(y))));
    }
    distance_squared_ = take.keep(distance_squared_, distance);
    deviation_ = take.keep(deviation_, deviation);
  }

  void write(Metrics<S>& m) const {
    using std::sqrt;
    m.peak_feature_distance = sqrt(distance_squared_);
    m.peak_line_deviation = deviation_;
    for (int i = 0; i < 2 * N; ++i) {
      const S beyond = beyond_(i) + S(0.0);  // -0 is 0
      m.overshoot = max(m.overshoot, beyond);
      m.relative_overshoot =
          max(m.relative_overshoot, select(abs_of(start_(i)) > limit_, S(beyond / abs_of(start_(i))), S(0.0)));
    }
  }

 private:
  static S abs_of(const S& value) {
    using std::abs;
    return abs(value);
  }

  Vector<S, 2 * N> desired_, start_;
  S limit_;
  Vector<S, 2 * N> side_;    ///< -sgn(xi-tilde_i(0)), or 0: times xi-tilde_i it is how far beyond the goal i is
  Vector<S, 2 * N> normal_;  ///< of each feature's line, a unit vector or 0
  Vector<S, 2 * N> beyond_ = Vector<S, 2 * N>::Zero();
  S distance_squared_{0.0}, deviation_{0.0};
};

/// What control costs: w = tau - G, with moments divided by the platform radius, so that all six are forces.
template <class S>
class ControlCost {
 public:
  explicit ControlCost(const S& platform_radius) : per_radius_(S(1.0) / platform_radius) {}

  template <class Take>
  void add(double time, const Vector6<S>& control, const Take& take) {
    using std::abs;
    const S lasted(is_first_ ? 0.0 : time - time_);
    S square(0.0), change(0.0);
    for (int j = 0; j < 6; ++j) {
      const S w = j < 3 ? control(j) : S(control(j) * per_radius_);
      square += w * w;
      change += abs(S(w - last_(j)));
      last_(j) = w;
    }
    // what was applied since the last sample is the last sample's; a lane that has stopped needs no right `last_`
    effort_ = take.keep(effort_, S(effort_ + square_ * lasted));
    if (!is_first_) variation_ = take.keep(variation_, S(variation_ + change));
    duration_ = take.keep(duration_, S(duration_ + lasted));
    square_ = square;
    time_ = time;
    is_first_ = false;
  }

  void write(Metrics<S>& m) const {
    m.effort = effort_;
    m.chatter = variation_ / duration_;
  }

 private:
  S per_radius_;
  Vector6<S> last_ = Vector6<S>::Zero();
  S square_{0.0}, effort_{0.0}, variation_{0.0}, duration_{0.0};
  double time_ = 0.0;
  bool is_first_ = true;
};

/// First time each leg passed a limit (infinity: never) and its largest value.
template <class S>
struct LegLimitMonitor {
  Vector6<S> first_time = Vector6<S>::Constant(S(std::numeric_limits<double>::infinity()));  ///< [s]
  Vector6<S> peak = Vector6<S>::Zero();                                                      ///< in the limit's unit

  void add(double time, const Vector6<S>& values, const S& limit, const Mask<S>& active) {
    add(time, values, limit, detail::TakeWhere<Mask<S>>{active});
  }
  template <class Take>
  void add(double time, const Vector6<S>& values, const S& limit, const Take& take) {
    using std::abs;
    for (int i = 0; i < 6; ++i) peak(i) = take.keep(peak(i), take.larger(peak(i), S(abs(values(i)))));
    if (!any(detail::largest_abs(values, take) > limit)) return;
    for (int i = 0; i < 6; ++i) {
      const S since = select(abs(values(i)) > limit, min(first_time(i), S(time)), first_time(i));
      first_time(i) = take.keep(first_time(i), since);
    }
  }
};

/// When the largest feature error came within the settling band to stay (docs/model.md, section 8).
template <class S>
class Settling {
 public:
  Settling(const S& band, const S& dwell) : band_(band), dwell_(dwell) {}

  /// @param error largest |xi-tilde_i| [px]; NaN is outside
  template <class Take>
  void add(double time, const S& error, const Take& take) {
    const Mask<S> outside = !(error <= band_);
    last_outside_ = take.keep(last_outside_, select(outside, S(time), last_outside_));
    entered_ = take.keep(entered_, select(outside, S(kNever), min(entered_, S(time))));
    end_ = take.keep(end_, S(time));
  }

  /// The last sample outside the band, where those after it span the dwell time; 0 where none was outside, however
  /// short the run; NaN otherwise. A single sample spans no time, so the last one alone never settles a run.
  S time() const {
    const S stay = end_ - entered_, least = min(dwell_, end_);
    const S rounding = S(1e-12) * end_;  // of differences of grid times
    return select((stay >= least - rounding) & (stay > S(0.0)), last_outside_,
                  S(std::numeric_limits<double>::quiet_NaN()));
  }

 private:
  static constexpr double kNever = std::numeric_limits<double>::infinity();

  S band_, dwell_;
  S last_outside_{0.0};
  S entered_{kNever};  ///< first sample within the band since then
  S end_{0.0};
};

/// Collects metrics and limit events sample by sample; lanes that are not active keep theirs.
template <class S, int N = kPoints>
class MetricsAccumulator {
 public:
  MetricsAccumulator(const MetricsSettings<S>& settings, const Hexapod<S>& hexapod, const RigidBody<S>& body,
                     const Vector<S, 2 * N>& desired_features, const Sample<S, N>& first, int points = N,
                     MetricGroups groups = {})
      : points_(points),
        groups_(groups),
        rms_start_(settings.rms_start),
        hexapod_(hexapod),
        body_(body),
        gravity_wrench_(gravity_wrench(body)),
        start_position_(first.position),
        start_quaternion_(first.quaternion),
        features_(settings.band, desired_features, first.feature_error),
        settling_(settings.band, settings.dwell),
        cost_(hexapod.platform_radius),
        watch_(hexapod) {}

  /// @param legs whether they are looked at
  void add(double time, const Sample<S, N>& sample, const Mask<S>& active, bool legs = true) {
    add(time, sample, legs, detail::TakeWhere<Mask<S>>{active});
  }
  /// The same where every lane is active and each number is finite.
  void add_finite(double time, const Sample<S, N>& sample, bool legs = true) {
    add(time, sample, legs, detail::TakeAll{});
  }

  /// Metrics of what was added so far.
  Metrics<S> metrics() const {
    using std::sqrt;
    const S nan(std::numeric_limits<double>::quiet_NaN());
    Metrics<S> m;
    m.settling_time = settling_.time();
    m.final_error = final_error_;
    m.rms_error = select(square_count_ > S(0.0), S(sqrt(S(square_sum_ / square_count_))), nan);
    m.peak_error = peak_error_;
    m.peak_displacement = sqrt(peak_displacement_squared_);
    m.peak_rotation = rotation_angle(min(S(sqrt(peak_half_sine_squared_)), S(1.0)));
    m.final_linear_speed = sqrt(linear_speed_squared_);
    m.final_angular_speed = sqrt(angular_speed_squared_);
    m.peak_control_force = peak_control_force_;
    m.peak_control_moment = peak_control_moment_;
    m.peak_leg_force = largest_abs(force_.peak);
    m.peak_leg_excursion = largest_abs(stroke_.peak);
    features_.write(m);
    cost_.write(m);
    const S none(std::numeric_limits<double>::infinity());
    m.peak_leg_speed = select(watch_.speed_limit() < none, largest_abs(speed_.peak), nan);
    m.peak_base_joint = select(watch_.base_chord() < none, tilt(largest_abs(base_joint_.peak)), nan);
    m.peak_platform_joint = select(watch_.platform_chord() < none, tilt(largest_abs(platform_joint_.peak)), nan);
    return m;
  }

  const LegLimitMonitor<S>& stroke() const { return stroke_; }
  const LegLimitMonitor<S>& force() const { return force_; }
  /// Of the limits that few robots have; tilts by their chords, see `LegWatch`.
  const LegLimitMonitor<S>& speed() const { return speed_; }
  const LegLimitMonitor<S>& base_joint() const { return base_joint_; }
  const LegLimitMonitor<S>& platform_joint() const { return platform_joint_; }
  const LegWatch<S>& watch() const { return watch_; }

 private:
  template <class Take>
  void add(double time, const Sample<S, N>& sample, bool legs, const Take& take) {
    if (groups_.has(MetricGroup::errors)) add_errors(time, sample, take);
    if (groups_.has(MetricGroup::motion)) add_body_motion(sample, take);
    if (groups_.has(MetricGroup::control)) add_control(time, sample, take);
    if (groups_.has(MetricGroup::excursions)) features_.add(sample.feature_error, take);
    if (!legs) return;
    if (groups_.has(MetricGroup::leg_lengths))
      stroke_.add(time, leg_travel<S>(sample.leg_lengths, hexapod_.mid_lengths, hexapod_.stroke), hexapod_.stroke,
                  take);
    if (groups_.has(MetricGroup::leg_forces)) force_.add(time, sample.leg_forces, hexapod_.force_limit, take);
    if (watch_.acts() && groups_.has(MetricGroup::leg_motion)) add_leg_motion(time, sample, take);
  }

  template <class Take>
  static void keep(const Take& take, S& value, const S& next) {
    value = take.keep(value, next);
  }
  template <class Take>
  static void peak(const Take& take, S& value, const S& next) {
    value = take.keep(value, take.larger(value, next));
  }

  template <class Take>
  void add_errors(double time, const Sample<S, N>& sample, const Take& take) {
    const S error = detail::largest_abs(sample.feature_error, take);
    settling_.add(time, error, take);
    keep(take, final_error_, error);
    peak(take, peak_error_, error);
    if (time < rms_start_ * (1.0 - 1e-12)) return;
    keep(take, square_sum_, S(square_sum_ + squares(sample.feature_error)));
    keep(take, square_count_, S(square_count_ + S(2.0 * (N == kPoints ? N : points_))));
  }

  template <class Take>
  void add_body_motion(const Sample<S, N>& sample, const Take& take) {
    peak(take, peak_displacement_squared_, S((sample.position - start_position_).squaredNorm()));
    // vector part of q conj(q_0): its square is sin^2 of half the rotation angle
    const Vector3<S> v = sample.quaternion.template tail<3>(), v0 = start_quaternion_.template tail<3>();
    const Vector3<S> half = start_quaternion_(0) * v - sample.quaternion(0) * v0 + v0.cross(v);
    peak(take, peak_half_sine_squared_, S(half.squaredNorm()));
    keep(take, linear_speed_squared_, S(sample.twist.template head<3>().squaredNorm()));
    keep(take, angular_speed_squared_, S(sample.twist.template tail<3>().squaredNorm()));
  }

  template <class Take>
  void add_control(double time, const Sample<S, N>& sample, const Take& take) {
    Vector6<S> control = sample.wrench - gravity_wrench_;
    if (body_.off_centre) control = sample.wrench - gravity_wrench(body_, rotation_matrix(sample.quaternion));
    peak(take, peak_control_force_, detail::largest_abs<S, 3>(control.template head<3>(), take));
    peak(take, peak_control_moment_, detail::largest_abs<S, 3>(control.template tail<3>(), take));
    cost_.add(time, control, take);
  }

  template <class Take>
  [[gnu::noinline]] void add_leg_motion(double time, const Sample<S, N>& sample, const Take& take) {
    const LegMotion<S> motion = watch_.at(sample.position, sample.quaternion, sample.twist);
    speed_.add(time, travel_.speeds(time, motion, watch_.speed_limit()), watch_.speed_limit(), take);
    base_joint_.add(time, motion.base_chords, watch_.base_chord(), take);
    platform_joint_.add(time, motion.platform_chords, watch_.platform_chord(), take);
  }

  /// Angle between two directions [rad] by their chord.
  static S tilt(const S& chord) { return rotation_angle(min(S(S(0.5) * chord), S(1.0))); }

  /// Sum over the target's points.
  S squares(const Vector<S, 2 * N>& error) const {
    if constexpr (N == kPoints) return error.squaredNorm();
    S sum(0.0);
    for (int i = 0; i < 2 * points_; ++i) sum += error(i) * error(i);
    return sum;
  }

  static double rotation_angle(double half_sine) { return 2.0 * std::asin(half_sine); }
  template <int W>
  static Lanes<W> rotation_angle(Lanes<W> half_sine) {
    return detail::map_lanes(half_sine, [](double v) { return rotation_angle(v); });
  }

  int points_;  ///< of the target
  MetricGroups groups_;
  double rms_start_;
  Hexapod<S> hexapod_;
  RigidBody<S> body_;  ///< as estimated
  Vector6<S> gravity_wrench_;
  Vector3<S> start_position_;
  Vector4<S> start_quaternion_;
  FeatureExcursions<S, N> features_;
  Settling<S> settling_;
  ControlCost<S> cost_;
  S final_error_{0.0}, peak_error_{0.0}, square_sum_{0.0}, square_count_{0.0};
  S peak_displacement_squared_{0.0}, peak_half_sine_squared_{0.0}, linear_speed_squared_{0.0},
      angular_speed_squared_{0.0};
  S peak_control_force_{0.0}, peak_control_moment_{0.0};
  LegLimitMonitor<S> stroke_, force_;
  LegWatch<S> watch_;
  LegTravel<S> travel_;
  LegLimitMonitor<S> speed_, base_joint_, platform_joint_;
};

}  // namespace hexservo
