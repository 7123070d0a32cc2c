/// @file
/// A camera with pixels, a period, a latency and faults: the frames that it hands to a controller (docs/model.md,
/// section 7).
///
/// Times are whole ticks. A frame is exposed at ticks 0, P, 2P, ... and arrives at the first tick at which it is due;
/// of frames that arrive at the same tick the one exposed last is handed over.
#pragma once

#include "hexservo/camera.hpp"
#include "hexservo/elementary.hpp"
#include "hexservo/random.hpp"

#include <algorithm>
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
  stop      ///< none: the controller brakes, and a simulated run ends with `Outcome::feature_lost`
};

/// Faults of the camera in `sampled` mode, and what stands in for images.
template <class S>
struct FrameFaults {
  S noise{0.0};                ///< standard deviation of each coordinate, independent of the others [px], 0
  S quantisation{0.0};         ///< coordinates are multiples of it [px], 0: none
  S dropout{0.0};              ///< probability that a frame never arrives [1], 0
  S outlier_probability{0.0};  ///< that a point of a frame is an outlier [1], 0
  S outlier_size{0.0};         ///< standard deviation of what is added to the noisy coordinates of an outlier [px], 0
  S smoothing{0.0};            ///< time constant of a filter of the coordinates beside the camera [s], 0: none
  Vector2<S> image_size = Vector2<S>::Constant(S(std::numeric_limits<double>::infinity()));  ///< width, height [px]
  LostFeature on_lost = LostFeature::hold;
  Prediction prediction = Prediction::none;
  /// How far a point may be from where it is expected; one that is farther counts as not seen [px].
  S gate = S(std::numeric_limits<double>::infinity());

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"noise", "px", kNotNegative}.of_plant().in_sampled_mode(), self.noise...);
    v(Field{"quantisation", "px", kNotNegative}.of_plant().in_sampled_mode(), self.quantisation...);
    v(Field{"dropout", "1", kProbability}.of_plant().in_sampled_mode(), self.dropout...);
    v(Field{"outlier_probability", "1", kProbability}.of_plant().in_sampled_mode(), self.outlier_probability...);
    v(Field{"outlier_size", "px", kNotNegative}.of_plant().in_sampled_mode(), self.outlier_size...);
    v(Field{"smoothing", "s", kNotNegative}.of_plant().in_sampled_mode(), self.smoothing...);
    v(Field{"image_size", "px", kPositiveOrNone}.entrywise().of_plant().in_sampled_mode(), self.image_size...);
    v(Field{"on_lost"}.of_pack().in_sampled_mode(), self.on_lost...);
    v(Field{"prediction"}.of_pack().in_sampled_mode(), self.prediction...);
    v(Field{"gate", "px", kPositiveOrNone}.in_sampled_mode(), self.gate...);
  }
};

/// The same with its timing.
template <class S>
struct FrameSettings : FrameFaults<S> {
  long long period = 1;   ///< P, ticks between two exposures
  long long latency = 0;  ///< ticks from exposure to first use
  long long jitter = 0;   ///< most that the latency of a frame is longer, each of 0 ... jitter being as likely [ticks]
  S timeout = S(std::numeric_limits<double>::infinity());  ///< oldest image of a point that is used [ticks]
  Vector2<S> image_centre = Vector2<S>::Zero();            ///< middle of the image, as its pixels are counted [px]
  bool stamped = true;  ///< frames carry their exposure; otherwise the tick of their arrival stands for it
  long long early = 0;  ///< ticks by which the stamp of a frame is before its exposure: a latency assumed too long
  S kept{0.0};          ///< share of the coordinates before that `smoothing` keeps from exposure to exposure

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    FrameFaults<S>::visit(v, self...);
    v(Field{"period"}, self.period...);
    v(Field{"latency"}, self.latency...);
    v(Field{"jitter"}, self.jitter...);
    v(Field{"timeout"}, self.timeout...);
    v(Field{"image_centre"}, self.image_centre...);
    v(Field{"stamped"}, self.stamped...);
    v(Field{"early"}, self.early...);
    v(Field{"kept"}, self.kept...);
  }
};

/// What a camera hands to a controller at a tick.
template <class S, int N = kPoints>
struct Frame {
  /// When it was exposed [ticks]; NaN: no frame arrived.
  S exposure = S(std::numeric_limits<double>::quiet_NaN());
  /// Measured pixels of the points, NaN in both coordinates of one that the frame does not show, and depths Z-hat [m].
  Image<S, N> image;
};

/// Oldest exposure that a frame of a tick is stamped with [ticks before it].
template <class S>
long long oldest_stamp(const FrameSettings<S>& settings) noexcept {
  return settings.latency + settings.jitter + std::max(settings.early, 0LL);
}

/// Whether the controller needs the points that a frame shows, lifted to where they are.
template <class S>
bool lifts_points(const FrameSettings<S>& settings) noexcept {
  return settings.prediction == Prediction::encoder || settings.on_lost == LostFeature::predict;
}

/// Frames on their way from the camera to the controller; memory is taken once, at construction.
template <class S, int N = kPoints>
class Frames {
 public:
  Frames(const FrameSettings<S>& settings, const SeedHalves<S>& seed, const Lens<S>& lens = Lens<S>())
      : settings_(settings),
        lens_(lens),
        noise_(seed, RandomSource::feature_noise),
        outliers_(seed, RandomSource::outliers),
        dropout_(seed, RandomSource::dropout),
        latency_(seed, RandomSource::latency),
        ring_(static_cast<std::size_t>((settings.latency + settings.jitter) / settings.period + 1)) {}

  /// Whether a tick has a frame.
  bool exposes(long long tick) const noexcept { return tick % settings_.period == 0; }

  /// Takes a frame, if it is time for one.
  /// @param image true features and measured depths
  void expose(long long tick, const Image<S, N>& image) noexcept {
    if (!exposes(tick)) return;
    const auto event = static_cast<std::uint64_t>(tick / settings_.period);
    Exposed& frame = ring_[static_cast<std::size_t>(exposed_ % static_cast<long long>(ring_.size()))];
    frame.tick = tick;
    frame.image = image;
    if (lens_.converts()) frame.image.features = lens_.pixels(image.features);
    disturb(frame.image.features, event);
    if (any(settings_.kept > S(0.0))) smooth(frame.image.features);
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
      S &x = frame.image.features(2 * i), &y = frame.image.features(2 * i + 1);
      const Mask<S> shown = (abs(S(x - settings_.image_centre(0))) <= S(0.5) * settings_.image_size(0)) &
                            (abs(S(y - settings_.image_centre(1))) <= S(0.5) * settings_.image_size(1));
      x = select(shown, x, S(std::numeric_limits<double>::quiet_NaN()));
      y = select(shown, y, S(std::numeric_limits<double>::quiet_NaN()));
    }
    ++exposed_;
  }

  /// Hands over the frame that is due at a tick; to be called once per tick.
  void deliver(long long tick, Frame<S, N>& out) noexcept {
    out.exposure = S(std::numeric_limits<double>::quiet_NaN());
    const S now(static_cast<double>(tick));
    for (long long i = pending_; i < exposed_; ++i) {
      const Exposed& frame = ring_[static_cast<std::size_t>(i % static_cast<long long>(ring_.size()))];
      if (frame.tick + settings_.latency > tick) break;
      const Mask<S> due = frame.due == now;
      const S stamp(static_cast<double>(settings_.stamped ? std::max(frame.tick - settings_.early, 0LL) : tick));
      if (all(due)) {
        out.image = frame.image;
        out.exposure = stamp;
      } else if (any(due)) {
        out.image.features = select(due, frame.image.features, out.image.features);
        out.image.depth = select(due, frame.image.depth, out.image.depth);
        out.exposure = select(due, stamp, out.exposure);
      }
      if (i == pending_ && frame.tick + settings_.latency + settings_.jitter <= tick) ++pending_;
    }
  }

 private:
  struct Exposed {
    long long tick;
    Image<S, N> image;  ///< as measured
    S due;              ///< tick of arrival; infinite: never
  };

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

  /// Coordinates that were no numbers before begin again.
  void smooth(Vector<S, 2 * N>& features) noexcept {
    for (int k = 0; k < 2 * N; ++k) {
      const S filtered = features(k) + settings_.kept * (smoothed_(k) - features(k));
      const Mask<S> goes_on = (settings_.kept > S(0.0)) & is_finite(smoothed_(k));
      features(k) = smoothed_(k) = select(goes_on, filtered, features(k));
    }
  }

  FrameSettings<S> settings_;
  Lens<S> lens_;
  RandomStream<S> noise_, outliers_, dropout_, latency_;
  Vector<S, 2 * N> smoothed_ =  ///< coordinates of the newest exposure, filtered [px]
      Vector<S, 2 * N>::Constant(S(std::numeric_limits<double>::quiet_NaN()));
  std::vector<Exposed> ring_;
  long long exposed_ = 0, pending_ = 0;  ///< frames so far; the first that may still be due in some lane
};

}  // namespace hexservo
