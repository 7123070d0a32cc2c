#include "hexservo/frames.hpp"
#include "hexservo/perception.hpp"

#include "compare.hpp"

#include <array>
#include <set>
#include <utility>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

constexpr double kFocal = 581.816;

constexpr double kPerTick = 0.25;  // [px]

/// An image whose first feature is its tick in quarters of a pixel.
Image<double> image_of(long long tick) {
  Image<double> image;
  for (int i = 0; i < 8; ++i) image.features(i) = 10.0 * i + kPerTick * static_cast<double>(tick);
  image.depth.setConstant(-0.5);
  return image;
}

/// A camera, and the controller that looks through it with joint sensors of no error.
class Eye {
 public:
  explicit Eye(const FrameSettings<double>& settings, std::uint64_t seed = 1)
      : sensing_{hexapod_,
                 LegGeometry<double>(hexapod_),
                 kFocal,
                 Lens<double>(),
                 Vector<double, 8>::Zero(),
                 settings,
                 PoseSource::truth,
                 {},
                 1e-3},
        frames_(settings, seed_halves(seed)),
        perception_(sensing_) {}

  void tick(long long tick, const Image<double>& image, const Pose<double>& pose = {Vector3<double>::Zero()}) {
    SensorInput<double> input;
    input.now = static_cast<double>(tick);
    input.pose = pose;
    input.twist.setZero();
    frames_.expose(tick, image);
    frames_.deliver(tick, input.frame);
    perception_.update(sensing_, input);
  }
  const Perceived<double>& seen() const { return perception_.now(); }
  bool ready() const { return seen().ready(); }
  const Image<double>& image() const { return seen().image; }

 private:
  Hexapod<double> hexapod_ = make_hexapod(robot_preset("micro"));
  Sensing<double> sensing_;
  Frames<double> frames_;
  Perception<double> perception_;
};

/// Ticks of exposure that the law sees, tick by tick; -infinity before the first.
std::vector<double> seen(const FrameSettings<double>& settings, int ticks, std::uint64_t seed = 1) {
  Eye eye(settings, seed);
  std::vector<double> newest;
  for (int k = 0; k < ticks; ++k) {
    eye.tick(k, image_of(k));
    newest.push_back(eye.seen().newest);
    if (eye.ready())
      CHECK(eye.image().features(0) == kPerTick * newest.back());
    else
      CHECK(newest.back() == -kInfinity);
  }
  return newest;
}

FrameSettings<double> timing(long long period, long long latency, long long jitter = 0) {
  FrameSettings<double> settings;
  settings.period = period;
  settings.latency = latency;
  settings.jitter = jitter;
  return settings;
}

}  // namespace

TEST_CASE("a frame is used from the first tick at or after exposure and latency") {
  for (const long long period : {1, 2, 5, 33})
    for (const long long latency : {0, 1, 2, 7, 33, 66}) {
      CAPTURE(period);
      CAPTURE(latency);
      const std::vector<double> newest = seen(timing(period, latency), 200);
      for (long long k = 0; k < 200; ++k) {
        const double exposure = k < latency ? -kInfinity : static_cast<double>((k - latency) / period * period);
        REQUIRE(newest[static_cast<std::size_t>(k)] == exposure);
      }
    }
}

TEST_CASE("jitter delays each frame by a whole number of ticks, and an older frame never replaces a newer one") {
  const std::vector<double> newest = seen(timing(2, 3, 5), 4000);
  std::set<long long> delays;
  for (std::size_t k = 1; k < newest.size(); ++k) {
    CHECK(newest[k] >= newest[k - 1]);
    if (newest[k] >= 0.0) {
      const long long delay = static_cast<long long>(k) - static_cast<long long>(newest[k]);
      CHECK(delay >= 3);
      if (newest[k] != newest[k - 1]) delays.insert(delay);
    }
  }
  CHECK(delays == std::set<long long>{3, 4, 5, 6, 7, 8});
}

TEST_CASE("of frames that have arrived the newest one counts, also of those that arrive together") {
  FrameSettings<double> settings = timing(2, 3, 5);
  const RandomStream<double> stream(seed_halves(1), RandomSource::latency);
  for (const Prediction prediction : {Prediction::none, Prediction::encoder}) {  // which keeps poses for each of them
    settings.prediction = prediction;
    Eye eye(settings);
    std::vector<double> newest(400, -kInfinity);
    for (long long k = 0; k < 400; ++k) {
      if (k % 2 == 0) {
        const double late = std::floor(6.0 * stream.uniform<1>(static_cast<std::uint64_t>(k / 2))(0));
        for (auto due = static_cast<std::size_t>(k + 3) + static_cast<std::size_t>(late); due < 400; ++due)
          newest[due] = std::max(newest[due], static_cast<double>(k));
      }
      eye.tick(k, image_of(k));
      REQUIRE(eye.seen().newest == newest[static_cast<std::size_t>(k)]);
    }
  }
}

TEST_CASE("a frame shows the points within its image, wherever its pixels are counted from") {
  FrameSettings<double> settings = timing(1, 0);
  settings.image_size = {100.0, 60.0};
  settings.image_centre = {20.0, -300.0};
  Frames<double> frames(settings, seed_halves(1));
  for (int axis = 0; axis < 2; ++axis)
    for (const double side : {-1.0, 1.0}) {
      CAPTURE(axis);
      CAPTURE(side);
      Image<double> image;
      image.depth.setConstant(-0.5);
      for (int i = 0; i < 4; ++i) image.features.segment<2>(2 * i) = settings.image_centre;
      const double edge = settings.image_centre(axis) + side * 0.5 * settings.image_size(axis);
      image.features(axis) = edge;
      image.features(2 + axis) = edge + side * 1e-9;
      Frame<double> frame;
      const long long tick = 2 * axis + (side > 0.0 ? 1 : 0);
      frames.expose(tick, image);
      frames.deliver(tick, frame);
      for (int k = 0; k < 8; ++k) CHECK(std::isnan(frame.image.features(k)) == (k == 2 || k == 3));
    }
}

TEST_CASE("an image that is too old is none, until the next one comes") {
  FrameSettings<double> settings = timing(10, 2);
  settings.timeout = 7.0;
  Eye eye(settings);
  for (int k = 0; k < 60; ++k) {
    eye.tick(k, image_of(k));
    const int age = k < 2 ? 1000 : (k - 2) % 10 + 2;  // of the newest image
    REQUIRE(eye.ready() == (age <= 7));
  }
}

TEST_CASE("a share of the frames never arrives") {
  FrameSettings<double> settings = timing(1, 0);
  settings.dropout = 0.3;
  const int ticks = 20000;
  const std::vector<double> newest = seen(settings, ticks, 5);
  int arrived = 0;
  for (int k = 0; k < ticks; ++k) arrived += newest[static_cast<std::size_t>(k)] == k;
  CHECK(std::abs(arrived / double(ticks) - 0.7) <= 4.0 * std::sqrt(0.3 * 0.7 / ticks));  // four standard deviations
  settings.dropout = 1.0;
  CHECK(seen(settings, 50).back() == -kInfinity);
}

TEST_CASE("noise, outliers and quantisation disturb the features as set, each from its own random stream") {
  FrameSettings<double> settings = timing(1, 0);
  const auto features = [&settings](long long ticks) {
    Eye eye(settings, 7);
    Eigen::MatrixXd all(8, ticks);
    for (long long k = 0; k < ticks; ++k) {
      eye.tick(k, image_of(0));
      all.col(k) = eye.image().features - image_of(0).features;
    }
    return all;
  };
  CHECK(features(10).isZero(0.0));
  const long long n = 5000;
  settings.noise = 0.2;
  const Eigen::MatrixXd noise = features(n);
  const double count = 8.0 * static_cast<double>(n);
  CHECK(std::abs(noise.mean()) <= 4.0 * 0.2 / std::sqrt(count));
  CHECK(std::abs(noise.squaredNorm() / count / 0.04 - 1.0) <= 4.0 * std::sqrt(2.0 / count));

  settings.dropout = 0.5;  // another source: what arrives has the noise that it had
  const Eigen::MatrixXd some = features(n);
  int same = 0;
  for (long long k = 0; k < n; ++k) same += some.col(k) == noise.col(k);
  CHECK(std::abs(same / static_cast<double>(n) - 0.5) <= 4.0 * std::sqrt(0.25 / static_cast<double>(n)));
  settings.dropout = 0.0;

  settings.quantisation = 0.5;
  const Eigen::MatrixXd steps = features(100);
  CHECK(distance(steps / 0.5, (steps / 0.5).array().round().matrix()) == 0.0);
  CHECK(distance(steps, noise.leftCols(100)) <= 0.25);
  settings.quantisation = 0.0;

  settings.outlier_probability = 0.1;
  settings.outlier_size = 20.0;
  const Eigen::MatrixXd wild = features(n);
  int outliers = 0, pairs = 0;
  Vector<double, 8> sums = Vector<double, 8>::Zero(), squares = sums;  // of what is added, coordinate by coordinate
  for (long long k = 0; k < n; ++k) {
    int in_frame = 0;
    for (int i = 0; i < 4; ++i) {
      const bool out = wild(2 * i, k) != noise(2 * i, k);
      CHECK(out == (wild(2 * i + 1, k) != noise(2 * i + 1, k)));  // a point as a whole
      in_frame += out;
    }
    outliers += in_frame;
    pairs += in_frame * (in_frame - 1) / 2;
    const Vector<double, 8> added = wild.col(k) - noise.col(k);
    sums += added;
    squares += added.cwiseAbs2();
  }
  CHECK(std::abs(outliers / (4.0 * n) - 0.1) <= 4.0 * std::sqrt(0.09 / (4.0 * n)));
  CHECK(std::abs(pairs / (6.0 * n) - 0.01) <= 4.0 * std::sqrt(0.01 * 0.99 / (6.0 * n)));  // points for themselves
  const double of_one = 0.1 * n;
  CHECK(sums.cwiseAbs().maxCoeff() <= 5.0 * 20.0 * std::sqrt(of_one));
  CHECK((squares / (400.0 * of_one) - Vector<double, 8>::Ones()).cwiseAbs().maxCoeff() <=
        5.0 * std::sqrt((2.0 + 0.9) / of_one));  // the variance of a square, and that of how many there are
}

TEST_CASE("smoothed coordinates follow a step as a first-order filter and a ramp with its lag") {
  for (const long long period : {1, 10}) {
    CAPTURE(period);
    FrameSettings<double> settings = timing(period, 0);
    settings.kept = std::exp(-static_cast<double>(period) / 40.0);  // a time constant of 40 ticks
    Eye stepped(settings), ramped(settings);
    for (long long k = 0; k <= 2000; ++k) {
      stepped.tick(k, image_of(k == 0 ? 0 : 400));  // 100 px
      ramped.tick(k, image_of(k));
      const double exposures = static_cast<double>(k / period);
      CHECK(stepped.image().features(0) == doctest::Approx(100.0 * (1.0 - std::pow(settings.kept, exposures))));
    }
    // In the steady state what is kept of the error, kept (e + step), is the error: step kept/(1 - kept).
    const double lag = kPerTick * static_cast<double>(period) * settings.kept / (1.0 - settings.kept);
    CHECK(image_of(2000).features(0) - ramped.image().features(0) == doctest::Approx(lag));
  }
  // A point that the lens does not show for a while begins again.
  FrameSettings<double> gone = timing(1, 0);
  gone.kept = 0.9;
  Eye interrupted(gone);
  for (long long k = 0; k < 10; ++k) {
    Image<double> image = image_of(400 * k);
    if (k == 5) image.features(0) = kNaN;
    interrupted.tick(k, image);
    if (k == 6) CHECK(interrupted.image().features(0) == image.features(0));
    if (k == 9) CHECK(interrupted.image().features(0) < image.features(0));
    if (k == 9) CHECK(std::isfinite(interrupted.image().features(0)));
  }
  // A filter that keeps nothing is none, to the last bit.
  Eye plain(timing(3, 1));
  FrameSettings<double> settings = timing(3, 1);
  settings.kept = 0.0;
  Eye filtered(settings);
  for (long long k = 0; k < 50; ++k) {
    plain.tick(k, image_of(k));
    filtered.tick(k, image_of(k));
    CHECK((plain.image().features.array() == filtered.image().features.array()).all());
  }
}

TEST_CASE("a latency that is assumed wrong shifts the stamps, and nothing else") {
  for (const long long early : {-3, 4, 60}) {
    CAPTURE(early);
    FrameSettings<double> settings = timing(5, 3);
    settings.prediction = Prediction::encoder;
    Eye exact(settings);
    settings.early = early;
    Eye wrong(settings);
    for (long long k = 0; k < 200; ++k) {
      exact.tick(k, image_of(k));
      wrong.tick(k, image_of(k));
      const double stamp = exact.seen().newest - static_cast<double>(early);
      CHECK(wrong.seen().newest == (exact.ready() ? std::max(stamp, 0.0) : exact.seen().newest));
      CHECK(exact.ready() == wrong.ready());
      if (!exact.ready()) continue;
      CHECK((exact.image().features - wrong.image().features).norm() <= 1e-9);  // the platform is at rest
    }
  }
}

TEST_CASE("prediction: the features of a moving platform are exact as long as the depth is true") {
  const Vector3<double> start(0.0, 0.0, -0.15);
  Image<double> image;
  image.features << 30, 18, 65, -65, -44, 37, -10, -15;
  image.depth << -0.5, -0.52, -0.48, -0.5;
  Eigen::Matrix<double, 3, 4> points;
  for (int i = 0; i < 4; ++i)
    points.col(i) = start + back_project<double>(kFocal, image.features.segment<2>(2 * i), image.depth(i));
  Pose<double> later{Vector3<double>(0.004, -0.003, -0.152), Vector4<double>(1.0, 0.01, -0.02, 0.015)};
  const Matrix3<double> R = rotation_matrix(later.quaternion);
  const Image<double> truth = take_image<double, 4>(kFocal, later.position, R, points);

  FrameSettings<double> settings = timing(10, 5);
  settings.prediction = Prediction::encoder;
  Eye eye(settings);
  const Pose<double> home{start, {1.0, 0.0, 0.0, 0.0}};
  for (int k = 0; k <= 5; ++k) eye.tick(k, image, k < 5 ? home : later);
  const Image<double>& predicted = eye.image();
  CHECK(distance(predicted.features, truth.features) <= 1e-11);
  CHECK(distance(predicted.depth, truth.depth) <= 1e-14);
  settings.prediction = Prediction::none;
  CHECK(distance(image.features, truth.features) > 1.0);
}

TEST_CASE("a feature outside of the image is lost: it is held, predicted or ends the run, and is reported") {
  for (const Prediction prediction : {Prediction::none, Prediction::encoder})
    for (const LostFeature policy : {LostFeature::hold, LostFeature::predict, LostFeature::stop}) {
      FrameSettings<double> settings = timing(1, 0);
      settings.image_size = {100.0, 100.0};
      settings.on_lost = policy;
      settings.prediction = prediction;
      Eye eye(settings);
      Image<double> image;
      image.features << 10, 10, 49, 0, -20, 20, 0, -30;
      image.depth.setConstant(-0.5);
      eye.tick(0, image);
      CHECK(eye.ready());
      // The platform moves 10 mm along x: every feature goes by -f 0.01/0.5 px, and point 2 appears beyond the image's
      // edge.
      image.features(2) = 51;
      const Pose<double> moved{Vector3<double>(0.01, 0.0, 0.0), {1.0, 0.0, 0.0, 0.0}};
      eye.tick(1, image, moved);
      CHECK(eye.ready() == (policy != LostFeature::stop));
      CHECK(eye.seen().lost == (policy == LostFeature::stop));
      CHECK(eye.image().features(0) == doctest::Approx(10.0).epsilon(1e-12));
      if (policy != LostFeature::stop)
        CHECK(eye.image().features(2) ==
              doctest::Approx(policy == LostFeature::predict ? 49.0 - kFocal * 0.01 / 0.5 : 49.0).epsilon(1e-12));
      image.features(2) = 40;
      eye.tick(2, image, moved);
      CHECK(eye.ready());
      CHECK(eye.image().features(2) == doctest::Approx(40.0).epsilon(1e-12));
    }
}

TEST_CASE("a point beyond the gate from where the joints expect it is lost, until its last image is too old") {
  const Pose<double> moved{Vector3<double>(0.01, 0.0, 0.0), {1.0, 0.0, 0.0, 0.0}};
  const double shift = -kFocal * 0.01 / 0.5;  // of every feature, far beyond the gate
  for (const LostFeature policy : {LostFeature::hold, LostFeature::predict, LostFeature::stop}) {
    CAPTURE(static_cast<int>(policy));
    FrameSettings<double> settings = timing(1, 0);
    settings.prediction = Prediction::encoder;
    settings.on_lost = policy;
    settings.gate = 5.0;
    settings.timeout = 6.0;
    Eye eye(settings);
    Image<double> image;
    image.features << 10, 10, 40, 0, -20, 20, 0, -30;
    image.depth.setConstant(-0.5);
    const auto exchanged_in = [](Image<double> right) {
      right.features.segment<2>(0).swap(right.features.segment<2>(2));
      return right;
    };
    eye.tick(0, exchanged_in(image));  // one image by itself is not taken
    REQUIRE_FALSE(eye.seen().complete);
    eye.tick(1, image);
    REQUIRE_FALSE(eye.seen().complete);
    REQUIRE_FALSE(eye.seen().lost);
    for (int i = 0; i < 4; ++i) image.features(2 * i) += shift;
    image.features(0) += 4.9;  // within it
    eye.tick(2, image, moved);
    REQUIRE(eye.ready());
    REQUIRE(distance(eye.image().features, image.features) <= 1e-12);

    const Image<double> exchanged = exchanged_in(image);
    for (int tick = 3; tick <= 8; ++tick) {
      CAPTURE(tick);
      eye.tick(tick, exchanged, moved);
      REQUIRE(eye.ready() == (policy != LostFeature::stop));
      REQUIRE_FALSE(eye.seen().whole);
      REQUIRE(distance(eye.image().features, image.features) <= 1e-12);
    }
    eye.tick(9, exchanged, moved);
    REQUIRE(eye.ready());
    REQUIRE(distance(eye.image().features, exchanged.features) <= 1e-12);
  }
}

TEST_CASE("an image is confirmed by a later one alone, and within the timeout") {
  FrameSettings<double> settings = timing(1, 0);
  settings.prediction = Prediction::encoder;
  settings.gate = 5.0;
  settings.timeout = 6.0;
  Image<double> image, none;
  image.features << 10, 10, 40, 0, -20, 20, 0, -30;
  image.depth.setConstant(-0.5);
  none.features.setConstant(kNaN);
  none.depth.setConstant(-0.5);
  Eye eye(settings);
  eye.tick(0, image);
  eye.tick(0, image);  // the same again
  REQUIRE_FALSE(eye.seen().complete);
  for (int tick = 1; tick < 7; ++tick) eye.tick(tick, none);
  eye.tick(7, image);
  REQUIRE_FALSE(eye.seen().complete);
  for (int tick = 8; tick < 13; ++tick) eye.tick(tick, none);
  eye.tick(13, image);
  REQUIRE(eye.ready());
}

TEST_CASE("a point that was never seen leaves the law without an image") {
  FrameSettings<double> settings = timing(1, 0);
  settings.image_size = {100.0, 100.0};
  Eye eye(settings);
  Image<double> image = image_of(0);  // the last point is at (60, 70) px
  eye.tick(0, image);
  CHECK_FALSE(eye.ready());
  image.features(6) = 50.0;
  image.features(7) = -50.0;  // on the edge
  eye.tick(1, image);
  CHECK(eye.ready());
}

TEST_CASE("the age of a feature counts from the exposure in which it was seen, not from frames that do not show it") {
  FrameSettings<double> settings = timing(2, 1);
  settings.image_size = {100.0, 100.0};
  settings.timeout = 9.0;
  for (const int hidden : {1, 4}) {  // points that are outside, from tick 10 to 39
    Eye eye(settings);
    for (int k = 0; k < 60; ++k) {
      CAPTURE(k);
      Image<double> image = image_of(0);
      image.features << 10, 10, 40, 0, -20, 20, 0, -30;
      if (k >= 10 && k < 40)
        for (int i = 0; i < hidden; ++i) image.features(2 * i) = 300.0;
      eye.tick(k, image);
      const double age = k < 11 ? 0.0 : k < 41 ? k - 8.0 : 1.0;  // of the oldest point; last seen in frame 8
      REQUIRE(eye.ready() == (k >= 1 && age <= 9.0));
      if (k >= 1) REQUIRE(eye.seen().newest == (k - 1) / 2 * 2);  // frames do arrive
    }
  }
}

TEST_CASE("a frame with numbers that are none is refused and harms no later one") {
  FrameSettings<double> settings = timing(1, 0);
  for (const Prediction prediction : {Prediction::none, Prediction::encoder}) {
    settings.prediction = prediction;
    Eye eye(settings);
    eye.tick(0, image_of(0));
    REQUIRE(eye.ready());
    const auto refuses = [&](int k, auto&& change) {
      Image<double> bad = image_of(k);
      change(bad);
      eye.tick(k, bad);
      CHECK_FALSE(eye.ready());
      CHECK(eye.seen().newest == k - 1);
      eye.tick(k, image_of(k));
      CHECK(eye.ready());
      CHECK(eye.image().features(0) == doctest::Approx(kPerTick * k).epsilon(1e-12));
    };
    refuses(1, [](Image<double>& bad) { bad.depth(2) = kNaN; });
    refuses(2, [](Image<double>& bad) { bad.depth(2) = 0.5; });
    refuses(3, [](Image<double>& bad) { bad.depth(0) = -1e-320; });
    refuses(4, [](Image<double>& bad) { bad.features(5) = 1.1e4; });
    // a point without numbers is one that was not seen: its depth has no meaning
    Image<double> without = image_of(5);
    without.features.segment<2>(2).setConstant(kNaN);
    without.depth(1) = kNaN;
    eye.tick(5, without);
    CHECK(eye.ready());
  }
}

TEST_CASE("poses of the past: between two ticks at fourth order in their distance, on the line at second") {
  const auto attitude = [](double time) {
    const double half = 0.5 * std::sin(1.3 * time);
    return Vector4<double>(std::cos(half), 0.0, std::sin(half), 0.0);
  };
  // The largest errors over a history's whole length, that is at its ends as well.
  const auto errors = [&](double period) {
    PoseHistory<double> history(12);
    for (int tick = 0; tick < 20; ++tick) {
      const double sign = tick % 2 == 0 ? 1.0 : -1.0;  // q and -q are one attitude
      const double time = 0.4 + period * (tick - 14);
      history.add(tick, {Vector3<double>(std::exp(time), 0.0, std::sin(3.0 * time)), sign * attitude(time)}, true);
    }
    double curve = 0.0, line = 0.0;
    for (double tick = 8.25; tick < 19.0; tick += 0.25) {
      const double time = 0.4 + period * (tick - 14);
      const Vector3<double> place(std::exp(time), 0.0, std::sin(3.0 * time));
      const auto error = [&](const Pose<double>& found) {
        const double cosine = std::abs(found.quaternion.dot(attitude(time)));
        return (found.position - place).norm() + std::acos(std::min(1.0, cosine / found.quaternion.norm()));
      };
      curve = std::max(curve, error(history.at(tick)));
      line = std::max(line, error(history.on_line(tick)));
    }
    return std::pair(curve, line);
  };
  const auto [curve, line] = errors(0.02);
  const auto [half_curve, half_line] = errors(0.01);
  CAPTURE(curve);
  CAPTURE(line);
  CAPTURE(half_curve);
  CAPTURE(half_line);
  CHECK(std::log2(curve / half_curve) == doctest::Approx(4.0).epsilon(0.05));
  CHECK(std::log2(line / half_line) == doctest::Approx(2.0).epsilon(0.05));
}

TEST_CASE("poses of the past: the cubic is that of the four nearest ticks, and the last pose of a tick counts") {
  const std::array<double, 10> weights{0.0, 0.0, 0.0, -1.0 / 16.0, 9.0 / 16.0, 9.0 / 16.0, -1.0 / 16.0, 0.0, 0.0, 0.0};
  const auto place = [](double x) { return Pose<double>{Vector3<double>(x, 0.0, 0.0), {1.0, 0.0, 0.0, 0.0}}; };
  for (int aside = 0; aside < 10; ++aside) {
    CAPTURE(aside);
    PoseHistory<double> history(10);
    for (int tick = 0; tick < 10; ++tick) {
      history.add(tick, place(5.0), true);  // another pose of the same tick takes no room
      history.add(tick, place(tick == aside ? 1.0 : 0.0), true);
    }
    CHECK(history.oldest() == 0.0);
    CHECK(history.at(aside).position(0) == 1.0);
    CHECK(history.at(4.5).position(0) == doctest::Approx(weights[static_cast<std::size_t>(aside)]).epsilon(1e-14));
  }
}

TEST_CASE("poses of the past: ticks of uneven distances are joined by straight lines") {
  for (const double third : {2.0, 2.9, 3.1}) {  // distances 1, third - 1, 1
    PoseHistory<double> history(4);
    double place = 0.0;
    for (const double tick : {0.0, 1.0, third, third + 1.0}) {
      history.add(tick, {Vector3<double>(place, 0.0, 0.0), {1.0, 0.0, 0.0, 0.0}}, true);
      place = place == 0.0 ? 1.0 : 0.0;
    }
    const double asked = 0.5 * (1.0 + third);
    CHECK(history.on_line(asked).position(0) == doctest::Approx(0.5).epsilon(1e-14));
    CHECK(history.at(asked).position(0) == doctest::Approx(0.5).epsilon(1e-14));  // of odd symmetry about there
    const double curved = std::abs(history.at(0.5).position(0) - history.on_line(0.5).position(0));
    CHECK((curved > 0.01) == (third < 3.0));
  }
  PoseHistory<double> close(4);
  for (const double tick : {0.0, 1.0, 1.001, 2.0})
    close.add(tick, {Vector3<double>(tick == 1.0 ? 1e-3 : 0.0, 0.0, 0.0), {1.0, 0.0, 0.0, 0.0}}, true);
  CHECK(close.at(0.5).position(0) == doctest::Approx(5e-4).epsilon(1e-12));
}

TEST_CASE("poses of the past: each tick's own to the last bit, between two of them on the way, none beyond") {
  PoseHistory<double> history(4);
  CHECK(std::isnan(history.at(0.0).position(0)));
  const auto pose_of = [](double tick) {
    const Vector4<double> attitude(1.0, 0.01 * tick, 0.0, -0.02);
    return Pose<double>{Vector3<double>(0.1 * tick, 1.0 / (1.0 + tick), -0.15), attitude.normalized()};
  };
  for (int tick = 0; tick < 10; ++tick) {
    history.add(tick, pose_of(tick), true);
    for (int asked = 0; asked <= tick + 1; ++asked) {
      const bool kept = asked <= tick && asked > tick - 4;
      CHECK(std::isnan(history.at(asked).position(0)) == !kept);
      if (kept) {
        CHECK(history.on_line(asked).position == pose_of(asked).position);
        CHECK(history.at(asked).position == pose_of(asked).position);
        CHECK(history.at(asked).quaternion == pose_of(asked).quaternion);
      }
    }
  }
  const Pose<double> between = history.at(8.25);
  CHECK(between.position(0) == doctest::Approx(0.825).epsilon(1e-14));
  CHECK(between.quaternion(1) / between.quaternion(0) == doctest::Approx(0.0825).epsilon(1e-6));
  Pose<double> turned = pose_of(10);
  turned.quaternion *= -1.0;  // the same attitude
  history.add(10, turned, true);
  const Vector4<double> halfway = history.at(9.5).quaternion;
  CHECK(halfway(1) / halfway(0) == doctest::Approx(0.095).epsilon(1e-6));
}

TEST_CASE("poses of the past: the lengths of quaternions count for nothing between two ticks") {
  PoseHistory<double> history(6), stretched(6);
  for (int tick = 0; tick < 6; ++tick) {
    const double half = 0.05 * tick;
    Pose<double> pose{Vector3<double>(0.01 * tick, 0.0, 0.0), {std::cos(half), 0.0, std::sin(half), 0.0}};
    history.add(tick, pose, true);
    pose.quaternion *= tick % 2 == 0 ? 1.0 : 100.0;
    stretched.add(tick, pose, true);
  }
  for (double asked = 0.0; asked <= 5.0; asked += 0.25) {
    CHECK((history.at(asked).quaternion - stretched.at(asked).quaternion).norm() <= 1e-14);
    CHECK((history.on_line(asked).quaternion - stretched.on_line(asked).quaternion).norm() <= 1e-14);
  }
}
