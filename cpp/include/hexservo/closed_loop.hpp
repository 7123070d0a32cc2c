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

/// What the law of a loop knows of its task.
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
        law_(p_.gains),
        plant_(p_.body, p_.dynamics_error),
        inverse_depth_share_((Vector<S, N>::Ones() + p_.depth_error).cwiseInverse()),
        body_(body_state<S>(home_pose(p_.hexapod), Vector6<S>::Zero())),
        law_state_(Law::initial_state(p_.gains)),
        view_(printed_camera() ? View(p_.initial_image, rotation_matrix(quaternion_of(body_))) : view_of(body_)),
        now_(first_instant()),
        sample_(sample_now().sample),
        metrics_(p_.metrics, p_.hexapod, task_.gravity_wrench, sample_) {
    accept(sample_now());
  }

  ClosedLoop(const ClosedLoop&) = delete;  // refers into its parameters
  ClosedLoop& operator=(const ClosedLoop&) = delete;

  /// What the sensors give now.
  Measurement<S, N> observe() const noexcept {
    return {measured_image(view_.image, p_.depth_error), {position_of(body_), quaternion_of(body_)}, twist_of(body_)};
  }

  /// One Runge-Kutta step; lanes that have stopped stay as they are.
  void advance() noexcept {
    const double h = p_.step;
    const auto derivative_at = [this](double scale, const Instant& before) {
      const BodyState<S> body = body_ + S(scale) * before.body_rate;
      Instant instant;
      if (printed_camera()) {
        const Image<S, N> image{view_.image.features + S(scale) * before.printed_rate.features,
                                view_.image.depth + S(scale) * before.printed_rate.depth};
        evaluate(body, View(image, rotation_matrix(quaternion_of(body))),
                 LawStage{&law_state_, &before.law.rate, S(scale)}, instant);
      } else {
        evaluate(body, view_of(body), LawStage{&law_state_, &before.law.rate, S(scale)}, instant);
      }
      return instant;
    };
    runge_kutta_step(h, now_, derivative_at, [this, h](const std::array<const Instant*, 4>& k) { commit(h, k); });
    evaluate(body_, view_, LawStage{&law_state_}, now_);
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

  /// Attitude, and what the camera sees there.
  struct View {
    View() = default;
    View(const Image<S, N>& true_image, const Matrix3<S>& attitude)
        : R_BE(attitude), image(true_image), inverse_depth(true_image.depth.cwiseInverse()) {}

    Matrix3<S> R_BE;
    Image<S, N> image;           ///< true features and depth; integrated where the camera is as printed
    Vector<S, N> inverse_depth;  ///< [1/m]
  };

  /// How everything changes at one instant, and what the law does.
  struct Instant {
    LawEvaluation law;
    BodyState<S> body_rate;
    Image<S, N> printed_rate;  ///< of the image as (12) and (6) print it; unused by a camera that projects
    S nearest_depth;           ///< largest Z_i [m]
  };

  struct JudgedSample {
    Sample<S, N> sample;
    Mask<S> singular;
  };

  bool printed_camera() const noexcept { return p_.convention == CameraConvention::as_printed; }

  View view_of(const BodyState<S>& body) const noexcept {
    View view;
    view.R_BE = rotation_matrix(quaternion_of(body));
    view.image = take_image(task_.focal_pixels, position_of(body), view.R_BE, p_.points_B, view.inverse_depth);
    return view;
  }

  void evaluate(const BodyState<S>& body, const View& view, const LawStage& stage, Instant& out) const noexcept {
    const Vector6<S> twist = twist_of(body);
    const Vector<S, N> inverse_depth = inverse_depth_share_.cwiseProduct(view.inverse_depth);  // of (1 + delta_Z) Z
    const Pose<S> pose{position_of(body), quaternion_of(body)};
    Law::evaluate(task_, law_, stage, LawInput<S, N>{view.image.features, inverse_depth, view.R_BE, twist, pose},
                  out.law);
    out.body_rate = body_rate(plant_, body, view.R_BE, out.law.wrench);
    out.nearest_depth = nearest_depth(view.image);
    if (printed_camera()) {
      const ImageJacobian<S, N> J(task_.focal_pixels, S(plant_sign(p_.convention)), view.image, view.R_BE);
      out.printed_rate.features = J.push(twist);  // (12)
      out.printed_rate.depth = printed_depth_rate(task_.focal_pixels, view.image, view.R_BE, twist);
    }
  }

  Instant first_instant() const noexcept {
    Instant instant;
    evaluate(body_, view_, LawStage{&law_state_}, instant);
    return instant;
  }

  /// Ends a step: the new state where it is good, the old one where the lane stops or has stopped.
  void commit(double h, const std::array<const Instant*, 4>& k) noexcept {
    std::array<S, 4> scales;
    std::array<const LawRate*, 4> law_rates;
    BodyState<S> body = body_;
    for (std::size_t i = 0; i < 4; ++i) {
      scales[i] = S(h * kRungeKuttaWeights[i]);
      law_rates[i] = &k[i]->law.rate;
      body += scales[i] * k[i]->body_rate;
    }
    normalise_quaternion(body);
    View view;
    if (printed_camera()) {
      Image<S, N> image = view_.image;
      for (std::size_t i = 0; i < 4; ++i) {
        image.features += scales[i] * k[i]->printed_rate.features;
        image.depth += scales[i] * k[i]->printed_rate.depth;
      }
      view = View(image, rotation_matrix(quaternion_of(body)));
    } else {
      view = view_of(body);
    }

    ++steps_;
    stop(StopCause::not_finite, !(is_finite(body) & is_finite(view.image.features) & is_finite(view.image.depth)));
    stop(StopCause::feature_error,
         largest_abs<S, 2 * N, 1>(p_.desired_features - view.image.features) > S(kMaxFeatureError));
    stop(StopCause::twist, largest_abs<S, 6, 1>(twist_of(body)) > S(kMaxTwist));
    S nearest = nearest_depth(view.image);
    for (std::size_t i = 1; i < 4; ++i) nearest = max(nearest, k[i]->nearest_depth);  // a pole inside the step
    stop(StopCause::behind_camera, nearest >= S(0.0));

    const Mask<S> active = running();
    Law::advance(law_, law_state_, law_rates, scales, active);
    if (all(active)) {
      body_ = body;
      view_ = view;
    } else {
      body_ = select(active, body, body_);
      view_.R_BE = select(active, view.R_BE, view_.R_BE);
      view_.image.features = select(active, view.image.features, view_.image.features);
      view_.image.depth = select(active, view.image.depth, view_.image.depth);
      view_.inverse_depth = select(active, view.inverse_depth, view_.inverse_depth);
    }
  }

  JudgedSample sample_now() const noexcept {
    const Legs<S> legs = inverse_kinematics(p_.hexapod, position_of(body_), view_.R_BE);
    const WrenchMapSolver<S> solver(p_.hexapod, legs);
    return {{p_.desired_features - view_.image.features, view_.image.depth, position_of(body_), quaternion_of(body_),
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
  typename Law::template Constants<S> law_;
  Plant<S> plant_;
  Vector<S, N> inverse_depth_share_;  ///< 1/(1 + delta_Z,i) [1]
  BodyState<S> body_;
  LawState law_state_;
  View view_;
  Instant now_;
  Sample<S, N> sample_;
  MetricsAccumulator<S, N> metrics_;
  S sample_time_{0.0};
  S cause_{0.0};
  long long steps_ = 0;
};

}  // namespace hexservo
