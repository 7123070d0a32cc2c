/// @file
/// A camera with a period, a latency and faults, and what a law sees of it between two frames
/// (docs/model.md, section 7).
///
/// Times are whole ticks. A frame is exposed at ticks 0, P, 2P, ... and used from the first tick at which it is due; of
/// two frames the one that was exposed later counts, whichever arrives first.
#pragma once

#include "hexservo/camera.hpp"
#include "hexservo/elementary.hpp"
#include "hexservo/random.hpp"
#include "hexservo/rigid_body.hpp"

#include <cmath>
#include <limits>
#include <vector>

namespace hexservo {

/// What stands for the features between two frames and over the latency.
enum class Prediction {
  none,    ///< the newest frame, as it is
  encoder  ///< its points, lifted with the pose of its exposure and Z-hat, projected again through the pose of each
           ///< tick
};

/// What a law does with a feature that the newest frame does not show.
enum class LostFeature {
  hold,     ///< its last image
  predict,  ///< its last image, lifted and projected again as `Prediction::encoder` does
  stop      ///< the run ends with `Outcome::feature_lost`
};

/// Timing and faults of the camera in `sampled` mode.
template <class S>
struct FrameSettings {
  long long period = 1;   ///< P, ticks between two exposures
  long long latency = 0;  ///< ticks from exposure to first use
  long long jitter = 0;   ///< most that the latency of a frame is longer, each of 0 ... jitter being as likely [ticks]
  Prediction prediction = Prediction::none;
  LostFeature on_lost = LostFeature::hold;
  S timeout = S(std::numeric_limits<double>::infinity());  ///< oldest image that is used, by its exposure [ticks]
  S noise{0.0};                ///< standard deviation of each coordinate, independent of the others [px], 0
  S quantisation{0.0};         ///< coordinates are multiples of it [px], 0: of nothing
  S dropout{0.0};              ///< probability that a frame never arrives [1], 0
  S outlier_probability{0.0};  ///< that a point of a frame is an outlier [1], 0
  S outlier_size{0.0};         ///< standard deviation of what is added to the noisy coordinates of an outlier [px], 0
  Vector2<S> image_size = Vector2<S>::Constant(S(std::numeric_limits<double>::infinity()));  ///< width, height [px]

  template <class F, class A, class B>
  static void visit(F&& f, A& a, B& b) {
    f(a.period, b.period);
    f(a.latency, b.latency);
    f(a.jitter, b.jitter);
    f(a.prediction, b.prediction);
    f(a.on_lost, b.on_lost);
    f(a.timeout, b.timeout);
    f(a.noise, b.noise);
    f(a.quantisation, b.quantisation);
    f(a.dropout, b.dropout);
    f(a.outlier_probability, b.outlier_probability);
    f(a.outlier_size, b.outlier_size);
    f(a.image_size, b.image_size);
  }
};

/// Frames on their way from the camera to the law; memory is taken once, at construction.
template <class S, int N = kPoints>
class Frames {
 public:
  /// @param first what stands in the image until the first frame comes; of no consequence but finite
  Frames(const FrameSettings<S>& settings, const S& focal_pixels, const SeedHalves<S>& seed, const Image<S, N>& first)
      : settings_(settings),
        f_(focal_pixels),
        noise_(seed, RandomSource::feature_noise),
        outliers_(seed, RandomSource::outliers),
        dropout_(seed, RandomSource::dropout),
        latency_(seed, RandomSource::latency),
        ring_(static_cast<std::size_t>((settings.latency + settings.jitter) / settings.period + 1)),
        held_(first) {
    points_B_.setZero();
    never_.setConstant(S(1.0));
    lost_.setZero();
  }

  /// Whether a tick has a frame.
  bool exposes(long long tick) const noexcept { return tick % settings_.period == 0; }

  /// Takes a frame, if it is time for one.
  /// @param image true features and measured depths
  /// @param pose that the joint sensors give now
  void expose(long long tick, const Image<S, N>& image, const Pose<S>& pose, const Matrix3<S>& R_BE) noexcept {
    if (!exposes(tick)) return;
    const auto event = static_cast<std::uint64_t>(tick / settings_.period);
    Frame& frame = ring_[static_cast<std::size_t>(exposed_ % static_cast<long long>(ring_.size()))];
    frame.tick = tick;
    frame.image = image;
    disturb(frame.image.features, event);
    frame.due = S(static_cast<double>(tick + settings_.latency));
    if (settings_.jitter > 0) {
      using std::floor;
      const S late = floor(S(latency_.template uniform<1>(event)(0) * S(static_cast<double>(settings_.jitter + 1))));
      frame.due += min(late, S(static_cast<double>(settings_.jitter)));
    }
    if (any(settings_.dropout > S(0.0)))
      frame.due = select(dropout_.template uniform<1>(event)(0) < settings_.dropout,
                         S(std::numeric_limits<double>::infinity()), frame.due);
    for (int i = 0; i < N; ++i) {
      using std::abs;
      const S x = frame.image.features(2 * i), y = frame.image.features(2 * i + 1);
      const Mask<S> seen = (abs(x) <= S(0.5) * settings_.image_size(0)) & (abs(y) <= S(0.5) * settings_.image_size(1));
      frame.seen(i) = select(seen, S(1.0), S(0.0));
      if (predicts())
        frame.points_B.col(i) =
            pose.position + rotate<S>(R_BE, back_project<S>(f_, Vector2<S>(x, y), frame.image.depth(i)));
    }
    ++exposed_;
  }

  /// Hands over the frames that are due.
  void deliver(long long tick) noexcept {
    for (long long i = pending_; i < exposed_; ++i) {
      const Frame& frame = ring_[static_cast<std::size_t>(i % static_cast<long long>(ring_.size()))];
      if (frame.tick + settings_.latency > tick) break;
      take(frame, (frame.due <= S(static_cast<double>(tick))) & (S(static_cast<double>(frame.tick)) > newest_));
      if (i == pending_ && frame.tick + settings_.latency + settings_.jitter <= tick) ++pending_;
    }
  }

  /// Lanes whose law has seen every point at least once, and has an image that is not too old.
  Mask<S> ready(long long tick) const noexcept {
    return (!any_of(never_)) & (S(static_cast<double>(tick)) - newest_ <= settings_.timeout);
  }
  /// Lanes whose newest frame does not show every point.
  Mask<S> lost() const noexcept { return any_of(lost_); }
  /// Tick of exposure of the newest frame; -1 before the first.
  const S& newest() const noexcept { return newest_; }

  /// Features and measured depths that the law sees at a pose that the joint sensors give.
  Image<S, N> image(const Pose<S>& pose, const Matrix3<S>& R_BE) const noexcept {
    const bool predicting = settings_.prediction == Prediction::encoder;
    if (!predicts()) return held_;
    const Image<S, N> projected = take_image(f_, pose.position, R_BE, points_B_);
    if (predicting && settings_.on_lost != LostFeature::hold) return projected;
    Image<S, N> image;
    for (int i = 0; i < N; ++i) {
      const Mask<S> lost = lost_(i) > S(0.5);
      const Mask<S> fresh = predicting ? !lost : lost;
      for (int k = 2 * i; k < 2 * i + 2; ++k)
        image.features(k) = select(fresh, projected.features(k), held_.features(k));
      image.depth(i) = select(fresh, projected.depth(i), held_.depth(i));
    }
    return image;
  }

 private:
  struct Frame {
    long long tick;
    Image<S, N> image;                ///< as measured
    Eigen::Matrix<S, 3, N> points_B;  ///< where the law believes the points to be; only where it predicts [m]
    Vector<S, N> seen;                ///< 1 or 0
    S due;                            ///< first tick of use; infinite: never
  };

  /// Whether a law ever sees points that were lifted from a frame.
  bool predicts() const noexcept {
    return settings_.prediction == Prediction::encoder || settings_.on_lost == LostFeature::predict;
  }

  static Mask<S> any_of(const Vector<S, N>& flags) noexcept {
    S sum = flags(0);
    for (int i = 1; i < N; ++i) sum = sum + flags(i);
    return sum > S(0.5);
  }

  void disturb(Vector<S, 2 * N>& features, std::uint64_t event) const noexcept {
    if (any(settings_.noise > S(0.0))) features += settings_.noise * noise_.template normal<2 * N>(event);
    if (any(settings_.outlier_probability > S(0.0))) {
      const Vector<S, N> draw = outliers_.template uniform<N>(2 * event);
      const Vector<S, 2 * N> far = outliers_.template normal<2 * N>(2 * event + 1);
      for (int k = 0; k < 2 * N; ++k)
        features(k) = select(draw(k / 2) < settings_.outlier_probability,
                             S(features(k) + settings_.outlier_size * far(k)), features(k));
    }
    if (any(settings_.quantisation > S(0.0)))
      for (int k = 0; k < 2 * N; ++k) features(k) = quantise(features(k), settings_.quantisation);
  }

  void take(const Frame& frame, const Mask<S>& due) noexcept {
    if (!any(due)) return;
    newest_ = select(due, S(static_cast<double>(frame.tick)), newest_);
    for (int i = 0; i < N; ++i) {
      const Mask<S> seen = due & (frame.seen(i) > S(0.5));
      lost_(i) = select(due, S(S(1.0) - frame.seen(i)), lost_(i));
      never_(i) = select(seen, S(0.0), never_(i));
      for (int k = 2 * i; k < 2 * i + 2; ++k)
        held_.features(k) = select(seen, frame.image.features(k), held_.features(k));
      held_.depth(i) = select(seen, frame.image.depth(i), held_.depth(i));
      for (int k = 0; predicts() && k < 3; ++k) points_B_(k, i) = select(seen, frame.points_B(k, i), points_B_(k, i));
    }
  }

  FrameSettings<S> settings_;
  S f_;
  RandomStream<S> noise_, outliers_, dropout_, latency_;
  std::vector<Frame> ring_;
  long long exposed_ = 0, pending_ = 0;  ///< frames so far; the first that may still be due in some lane
  S newest_{-1.0};
  Image<S, N> held_;                 ///< last image of each point
  Eigen::Matrix<S, 3, N> points_B_;  ///< the same, lifted [m]
  Vector<S, N> never_, lost_;        ///< 1 where a point was never seen; where the newest frame does not show it
};

}  // namespace hexservo
