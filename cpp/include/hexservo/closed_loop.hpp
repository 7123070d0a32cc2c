/// @file
/// The closed loop: plant, camera and law, in continuous time with the law inside every Runge-Kutta stage
/// (docs/model.md, section 7), and how a run ends (docs/model.md, section 8).
///
/// The only place where the parts meet. `ClosedLoop<S, Law>` is a stepper: parameters are const and shared, the state
/// is a value, nothing is allocated, and nothing branches on data, so that the same source runs one scenario (`double`)
/// or one per lane (`Lanes<W>`).
#pragma once

#include "hexservo/laws/law.hpp"
#include "hexservo/metrics.hpp"
#include "hexservo/runge_kutta.hpp"

#include <new>
#include <type_traits>

namespace hexservo {

/// How a run ended; where several apply at one instant the first of this list is reported.
enum class Outcome {
  completed,
  diverged,
  behind_camera,
  feature_lost,
  leg_limit,
  singular,
  solver_failed,
  interrupted
};

/// Why a run stopped before its end.
enum class StopCause { none, not_finite, feature_error, twist, behind_camera, singular };

/// The outcome that a cause stands for.
constexpr Outcome outcome_of(StopCause cause) {
  switch (cause) {
    case StopCause::not_finite:
    case StopCause::feature_error:
    case StopCause::twist:
      return Outcome::diverged;
    case StopCause::behind_camera:
      return Outcome::behind_camera;
    case StopCause::singular:
      return Outcome::singular;
    case StopCause::none:
      break;
  }
  return Outcome::completed;
}

inline constexpr double kMaxFeatureError = 1e4;  ///< any |xi-tilde_i| beyond it is divergence [px]
inline constexpr double kMaxTwist = 1e3;         ///< any |chi-dot_j| beyond it is divergence [m/s; rad/s]

/// Everything a run needs, prepared and validated; made by `loop_parameters` (settings.hpp).
template <class S, class Law, int N = kPoints>
struct LoopParameters {
  Hexapod<S> hexapod;
  RigidBody<S> body;
  DynamicsError<S> dynamics_error;
  Camera<S> camera;
  CameraConvention convention = CameraConvention::eye_in_hand;
  JacobianConvention jacobian = JacobianConvention::consistent;
  Eigen::Matrix<S, 3, N> points_B;    ///< target points [m]; not used by `as_printed`
  Image<S, N> initial_image;          ///< seen from home [px; m]
  Vector<S, 2 * N> desired_features;  ///< xi_d [px]
  Vector<S, N> depth_error;           ///< delta_Z,i [1]
  Switching<S> switching;
  typename Law::template Gains<S> gains;
  double step = 1e-3;  ///< h [s]
  MetricsSettings metrics;

  template <class F, class A, class B>
  static void visit(F&& f, A& a, B& b) {
    f(a.hexapod, b.hexapod);
    f(a.body, b.body);
    f(a.dynamics_error, b.dynamics_error);
    f(a.camera, b.camera);
    f(a.convention, b.convention);
    f(a.jacobian, b.jacobian);
    f(a.points_B, b.points_B);
    f(a.initial_image, b.initial_image);
    f(a.desired_features, b.desired_features);
    f(a.depth_error, b.depth_error);
    f(a.switching, b.switching);
    f(a.gains, b.gains);
    f(a.step, b.step);
    f(a.metrics, b.metrics);
  }
};

/// What the law of a loop knows.
template <class S, class Law, int N>
ControlTask<S, N> control_task(const LoopParameters<S, Law, N>& p) {
  return {p.camera.focal_pixels(),
          S(controller_sign(p.convention, p.jacobian)),
          p.desired_features,
          gravity_wrench(p.body),
          p.switching,
          home_pose(p.hexapod)};
}

/// Plant and law in continuous time, from home, at rest.
template <class S, class Law, int N = kPoints>
class ClosedLoop {
 public:
  using Parameters = LoopParameters<S, Law, N>;
  using LawState = typename Law::template State<S>;

  /// @param parameters shared, not copied: they must outlive the loop
  explicit ClosedLoop(const Parameters& parameters)
      : p_(parameters),
        task_(control_task(p_)),
        body_(body_state<S>(home_pose(p_.hexapod), Vector6<S>::Zero())),
        law_state_(Law::initial_state(p_.gains)),
        attitude_(rotation_matrix(quaternion_of(body_))),
        true_image_(printed_camera() ? p_.initial_image : image_of(body_, attitude_)),
        now_(*this, body_, attitude_, true_image_, LawStage{&law_state_}),
        sample_(sample_now().sample),
        metrics_(p_.metrics, p_.hexapod, task_.gravity_wrench, sample_) {
    accept(sample_now());
  }

  ClosedLoop(const ClosedLoop&) = delete;  // refers into its parameters
  ClosedLoop& operator=(const ClosedLoop&) = delete;

  /// What the law sees now.
  LawInput<S, N> observe() const noexcept { return input_at(body_, now_.R_BE, now_.image); }

  /// One Runge-Kutta step; lanes that have stopped stay as they are.
  void advance() noexcept {
    const double h = p_.step;
    const auto derivative_at = [this](double scale, const Instant& before) {
      const BodyState<S> body = body_ + S(scale) * before.body_rate;
      const Matrix3<S> R_BE = rotation_matrix(quaternion_of(body));
      Image<S, N> image;
      if (printed_camera()) {
        image.features = now_.image.features + S(scale) * before.printed_rate.features;
        image.depth = now_.image.depth + S(scale) * before.printed_rate.depth;
      } else {
        image = image_of(body, R_BE);
      }
      return Instant(*this, body, R_BE, image, LawStage{&law_state_, &before.law.rate, S(scale)});
    };
    runge_kutta_step(h, now_, derivative_at, [this, h](const std::array<const Instant*, 4>& k) { commit(h, k); });
    // Built in place: the object is large, and everything in it is trivially destructible.
    ::new (&now_) Instant(*this, body_, attitude_, true_image_, LawStage{&law_state_});
    accept(sample_now());
  }

  /// Time that was last asked for [s]; lanes that have stopped are behind it.
  double time() const noexcept { return static_cast<double>(steps_) * p_.step; }
  long long steps() const noexcept { return steps_; }
  /// The newest good sample of each lane, and its time [s].
  const Sample<S, N>& sample() const noexcept { return sample_; }
  const S& sample_time() const noexcept { return sample_time_; }
  /// Lanes that go on.
  Mask<S> running() const noexcept { return cause_ == S(0.0); }
  /// StopCause of each lane, as a number.
  const S& cause() const noexcept { return cause_; }
  const LawState& law_state() const noexcept { return law_state_; }
  const MetricsAccumulator<S, N>& metrics() const noexcept { return metrics_; }

 private:
  using LawStage = typename Law::template Stage<S>;
  using LawRate = typename Law::template Rate<S>;
  using LawEvaluation = typename Law::template Evaluation<S>;

  /// Everything that follows from a state: what is seen, what the law does, and how all of it changes.
  struct Instant {
    Matrix3<S> R_BE;
    Image<S, N> image;  ///< true features and depth
    LawEvaluation law;
    BodyState<S> body_rate;
    Image<S, N> printed_rate;  ///< of the image as (12) and (6) print it; unused by a camera that projects

    /// @param attitude R_BE of the body
    /// @param true_image projected, or integrated where the camera is as printed
    Instant(const ClosedLoop& loop, const BodyState<S>& body, const Matrix3<S>& attitude, const Image<S, N>& true_image,
            const LawStage& stage) noexcept
        : R_BE(attitude),
          image(true_image),
          law(Law::evaluate(loop.task_, loop.p_.gains, stage, loop.input_at(body, R_BE, image))),
          body_rate(hexservo::body_rate(loop.p_.body, loop.p_.dynamics_error, body, R_BE, law.wrench)) {
      if (loop.printed_camera()) {
        const ImageJacobian<S, N> J(loop.task_.focal_pixels, S(plant_sign(loop.p_.convention)), image, R_BE);
        printed_rate.features = J.push(twist_of(body));  // (12)
        printed_rate.depth = printed_depth_rate(loop.task_.focal_pixels, image, R_BE, twist_of(body));
      }
    }
  };
  static_assert(std::is_trivially_destructible_v<Instant>);

  struct JudgedSample {
    Sample<S, N> sample;
    Mask<S> singular;
  };

  bool printed_camera() const noexcept { return p_.convention == CameraConvention::as_printed; }

  Image<S, N> image_of(const BodyState<S>& body, const Matrix3<S>& R_BE) const noexcept {
    return take_image(task_.focal_pixels, position_of(body), R_BE, p_.points_B);
  }

  LawInput<S, N> input_at(const BodyState<S>& body, const Matrix3<S>& R_BE, const Image<S, N>& image) const noexcept {
    return {measured_image(image, p_.depth_error), R_BE, twist_of(body), {position_of(body), quaternion_of(body)}};
  }

  /// Ends a step: the new state where it is good, the old one where the lane stops or has stopped.
  void commit(double h, const std::array<const Instant*, 4>& k) noexcept {
    std::array<S, 4> scales;
    std::array<const LawRate*, 4> law_rates;
    BodyState<S> body = body_;
    Image<S, N> image = now_.image;
    for (std::size_t i = 0; i < 4; ++i) {
      scales[i] = S(h * kRungeKuttaWeights[i]);
      law_rates[i] = &k[i]->law.rate;
      body += scales[i] * k[i]->body_rate;
      if (printed_camera()) {
        image.features += scales[i] * k[i]->printed_rate.features;
        image.depth += scales[i] * k[i]->printed_rate.depth;
      }
    }
    normalise_quaternion(body);
    const Matrix3<S> R_BE = rotation_matrix(quaternion_of(body));
    if (!printed_camera()) image = image_of(body, R_BE);

    ++steps_;
    stop(StopCause::not_finite, !(is_finite(body) & is_finite(image.features) & is_finite(image.depth)));
    stop(StopCause::feature_error,
         largest_abs<S, 2 * N, 1>(p_.desired_features - image.features) > S(kMaxFeatureError));
    stop(StopCause::twist, largest_abs<S, 6, 1>(twist_of(body)) > S(kMaxTwist));
    S nearest = nearest_depth(image);
    for (std::size_t i = 1; i < 4; ++i) nearest = max(nearest, nearest_depth(k[i]->image));  // a pole inside the step
    stop(StopCause::behind_camera, nearest >= S(0.0));

    const Mask<S> active = running();
    Law::advance(p_.gains, law_state_, law_rates, scales, active);
    body_ = select(active, body, body_);
    attitude_ = select(active, R_BE, attitude_);
    true_image_.features = select(active, image.features, now_.image.features);
    true_image_.depth = select(active, image.depth, now_.image.depth);
  }

  JudgedSample sample_now() const noexcept {
    const Legs<S> legs = inverse_kinematics(p_.hexapod, position_of(body_), now_.R_BE);
    const WrenchMapSolver<S> solver(p_.hexapod, legs);
    return {{p_.desired_features - now_.image.features, now_.image.depth, position_of(body_), quaternion_of(body_),
             twist_of(body_), now_.law.wrench, now_.law.fuzzy_output, legs.lengths, solver.leg_forces(now_.law.wrench)},
            solver.failed()};
  }

  /// Takes over a sample where it is good, stops the lane where it is not.
  void accept(const JudgedSample& next) noexcept {
    const Mask<S> finite =
        is_finite(next.sample.wrench) & is_finite(next.sample.fuzzy_output) & is_finite(next.sample.leg_forces);
    const Mask<S> regular = !next.singular;  // leg forces of a singular pose have no meaning
    stop(StopCause::not_finite, (!finite) & regular);
    stop(StopCause::singular, next.singular);
    const Mask<S> good = running();
    Sample<S, N>::visit([&good](auto& value, const auto& from) { value = select(good, from, value); }, sample_,
                        next.sample);
    sample_time_ = select(good, S(time()), sample_time_);
    metrics_.add(time(), sample_, good);
  }

  /// Records the first cause of each lane.
  void stop(StopCause cause, const Mask<S>& where) noexcept {
    cause_ = select(where & running(), S(static_cast<double>(cause)), cause_);
  }

  static S nearest_depth(const Image<S, N>& image) noexcept {
    S nearest = image.depth(0);
    for (int i = 1; i < N; ++i) nearest = max(nearest, image.depth(i));
    return nearest;
  }

  const Parameters& p_;
  ControlTask<S, N> task_;
  BodyState<S> body_;
  LawState law_state_;
  Matrix3<S> attitude_;     ///< R_BE of the body
  Image<S, N> true_image_;  ///< what the camera sees there
  Instant now_;
  Sample<S, N> sample_;
  MetricsAccumulator<S, N> metrics_;
  S sample_time_{0.0};
  S cause_{0.0};
  long long steps_ = 0;
};

}  // namespace hexservo
