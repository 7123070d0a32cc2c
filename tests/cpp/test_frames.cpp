#include "hexservo/frames.hpp"

#include "compare.hpp"

#include <set>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

constexpr double kFocal = 581.816;

/// An image that tells its tick, seen from home.
Image<double> image_of(long long tick) {
  Image<double> image;
  for (int i = 0; i < 8; ++i) image.features(i) = 10.0 * i + static_cast<double>(tick);
  image.depth.setConstant(-0.5);
  return image;
}

/// Ticks of exposure that the law sees, tick by tick; -1 before the first.
std::vector<double> seen(const FrameSettings<double>& settings, int ticks, std::uint64_t seed = 1) {
  Frames<double> frames(settings, kFocal, seed_halves(seed), image_of(0));
  std::vector<double> newest;
  for (int k = 0; k < ticks; ++k) {
    frames.expose(k, image_of(k), {}, Matrix3<double>::Identity());
    frames.deliver(k);
    newest.push_back(frames.newest());
    if (frames.ready(k))
      CHECK(frames.image({}, Matrix3<double>::Identity()).features(0) == frames.newest());
    else
      CHECK(frames.newest() == -1.0);
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
        const long long exposure = k < latency ? -1 : (k - latency) / period * period;
        REQUIRE(newest[static_cast<std::size_t>(k)] == static_cast<double>(exposure));
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

TEST_CASE("an image that is too old is none, until the next one comes") {
  FrameSettings<double> settings = timing(10, 2);
  settings.timeout = 7.0;
  Frames<double> frames(settings, kFocal, {}, image_of(0));
  for (int k = 0; k < 60; ++k) {
    frames.expose(k, image_of(k), {}, Matrix3<double>::Identity());
    frames.deliver(k);
    const int age = k < 2 ? 1000 : (k - 2) % 10 + 2;  // of the newest image
    REQUIRE(frames.ready(k) == (age <= 7));
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
  CHECK(seen(settings, 50).back() == -1.0);
}

TEST_CASE("noise, outliers and quantisation disturb the features as told, each by its own stream") {
  FrameSettings<double> settings = timing(1, 0);
  const auto features = [&settings](long long ticks) {
    Frames<double> frames(settings, kFocal, seed_halves(7), image_of(0));
    Eigen::MatrixXd all(8, ticks);
    for (long long k = 0; k < ticks; ++k) {
      frames.expose(k, image_of(0), {}, Matrix3<double>::Identity());
      frames.deliver(k);
      all.col(k) = frames.image({}, Matrix3<double>::Identity()).features - image_of(0).features;
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
  int outliers = 0;
  for (long long k = 0; k < n; ++k)
    for (int i = 0; i < 4; ++i) {
      const bool out = wild(2 * i, k) != noise(2 * i, k);
      CHECK(out == (wild(2 * i + 1, k) != noise(2 * i + 1, k)));  // a point as a whole
      outliers += out;
    }
  CHECK(std::abs(outliers / (4.0 * n) - 0.1) <= 4.0 * std::sqrt(0.09 / (4.0 * n)));
}

TEST_CASE("prediction: a platform that moves sees the points where they are, as long as the depth is true") {
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
  Frames<double> frames(settings, kFocal, {}, image);
  for (int k = 0; k <= 5; ++k) {
    frames.expose(k, image, {start, {1.0, 0.0, 0.0, 0.0}}, Matrix3<double>::Identity());
    frames.deliver(k);
  }
  const Image<double> predicted = frames.image(later, R);
  CHECK(distance(predicted.features, truth.features) <= 1e-11);
  CHECK(distance(predicted.depth, truth.depth) <= 1e-14);
  settings.prediction = Prediction::none;
  CHECK(distance(image.features, truth.features) > 1.0);
}

TEST_CASE("a feature outside of the image is lost: held, predicted, and told") {
  const Matrix3<double> level = Matrix3<double>::Identity();
  for (const LostFeature policy : {LostFeature::hold, LostFeature::predict}) {
    FrameSettings<double> settings = timing(1, 0);
    settings.image_size = {100.0, 100.0};
    settings.on_lost = policy;
    Frames<double> frames(settings, kFocal, {}, image_of(0));
    Image<double> image;
    image.features << 10, 10, 49, 0, -20, 20, 0, -30;
    image.depth.setConstant(-0.5);
    frames.expose(0, image, {}, level);
    frames.deliver(0);
    CHECK(frames.ready(0));
    CHECK_FALSE(frames.lost());
    // The platform moves 10 mm along x: every feature goes by -f 0.01/0.5 px, and the image shows point 2 beyond its
    // edge.
    image.features(2) = 51;
    const Pose<double> moved{Vector3<double>(0.01, 0.0, 0.0), {1.0, 0.0, 0.0, 0.0}};
    frames.expose(1, image, moved, level);
    frames.deliver(1);
    CHECK(frames.ready(0));
    CHECK(frames.lost());
    const Image<double> seen = frames.image(moved, level);
    CHECK(seen.features(0) == 10.0);
    CHECK(seen.features(2) ==
          doctest::Approx(policy == LostFeature::hold ? 49.0 : 49.0 - kFocal * 0.01 / 0.5).epsilon(1e-12));
    image.features(2) = 40;
    frames.expose(2, image, moved, level);
    frames.deliver(2);
    CHECK_FALSE(frames.lost());
    CHECK(frames.image(moved, level).features(2) == 40.0);
  }
}

TEST_CASE("a point that was never seen leaves the law without an image") {
  FrameSettings<double> settings = timing(1, 0);
  settings.image_size = {100.0, 100.0};
  Frames<double> frames(settings, kFocal, {}, image_of(0));
  Image<double> image = image_of(0);  // the last point is at (60, 70) px
  frames.expose(0, image, {}, Matrix3<double>::Identity());
  frames.deliver(0);
  CHECK_FALSE(frames.ready(0));
  image.features(6) = 50.0;
  image.features(7) = -50.0;  // on the edge
  frames.expose(1, image, {}, Matrix3<double>::Identity());
  frames.deliver(1);
  CHECK(frames.ready(0));
}
