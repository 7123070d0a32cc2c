// Pixels of a camera and features of its pinhole (docs/camera.md): the inverse, the derivative, lanes.
#include "hexservo/camera.hpp"
#include "hexservo/frames.hpp"

#include "compare.hpp"
#include "random.hpp"

#include <cmath>

using namespace hexservo;
using namespace hexservo::test;

namespace {

/// A lens as it is sold: distortion of some ten percent at the corner.
Camera random_camera(Random& random, LensModel model) {
  Camera camera;
  camera.focal_pixels = Vector2<double>(random.uniform(500.0, 1500.0), random.uniform(500.0, 1500.0));
  camera.principal_point = Vector2<double>(random.uniform(300.0, 700.0), random.uniform(200.0, 500.0));
  if (model == LensModel::brown_conrady)
    camera.distortion.brown_conrady =
        (Vector<double, 5>() << random.uniform(-0.3, 0.2), random.uniform(-0.05, 0.1), random.uniform(-1e-3, 1e-3),
         random.uniform(-1e-3, 1e-3), random.uniform(-0.02, 0.02))
            .finished();
  if (model == LensModel::kannala_brandt)
    camera.distortion.kannala_brandt = (Vector<double, 4>() << random.uniform(-0.05, 0.1), random.uniform(-0.02, 0.02),
                                        random.uniform(-0.01, 0.01), random.uniform(-2e-3, 2e-3))
                                           .finished();
  return camera;
}

constexpr std::array kModels = {LensModel::pinhole, LensModel::brown_conrady, LensModel::kannala_brandt};

}  // namespace

TEST_CASE("a pixel of every feature that the lens shows is brought back, with a residual below 1e-9 px") {
  Random random(15201);
  CAPTURE(random.seed());
  for (const LensModel model : kModels)
    for (int trial = 0; trial < 300; ++trial) {
      CAPTURE(trial);
      const Camera camera = random_camera(random, model);
      const Lens<double> lens(camera.lens());
      CHECK(lens.converts());
      const double reach = model == LensModel::kannala_brandt ? 3.0 : 0.6;  // |n|: 72 and 31 degrees off the axis
      for (int i = 0; i < 20; ++i) {
        const double angle = random.uniform(0.0, 6.28), radius = camera.focal() * random.uniform(0.0, reach);
        const Vector2<double> feature(radius * std::cos(angle), radius * std::sin(angle));
        const Vector2<double> pixel = lens.pixel(feature), back = lens.feature(pixel);
        CHECK(distance(lens.pixel(back), pixel) <= 1e-9);
        CHECK(distance(back, feature) <= 1e-8 * (1.0 + radius));  // the radius may grow by a hundredth of the angle
      }
    }
}

TEST_CASE("a lens that grows ever steeper brings back every pixel of its image") {
  // A pincushion of 0.7 % at the corner, and one of 1.2 %: far beyond the image both are steeper by powers of ten.
  for (const auto& [k1, k2, k3] : {std::array{0.05, 0.0, 1.0}, std::array{0.1, -0.5, 5.0}}) {
    Camera camera;
    camera.focal_pixels = Vector2<double>(2400.0, 2400.0);
    camera.principal_point = Vector2<double>(640.0, 480.0);
    camera.distortion.brown_conrady = (Vector<double, 5>() << k1, k2, 0.0, 0.0, k3).finished();
    const Lens<double> lens(camera.lens());
    for (double u = -0.5; u < 1280.0; u += 40.0)
      for (double v = -0.5; v < 960.0; v += 40.0)
        CHECK(distance(lens.pixel(lens.feature({u, v})), Vector2<double>(u, v)) <= 1e-9);
  }
}

TEST_CASE("the derivative of the distortion, by central differences") {
  Random random(15202);
  CAPTURE(random.seed());
  const double h = 1e-6;  // third derivatives of some 10 h^2, and rounding of 1e-16/h
  for (const LensModel model : kModels)
    for (int trial = 0; trial < 100; ++trial) {
      const Lens<double> lens(random_camera(random, model).lens());
      const Vector2<double> n = random.matrix<2>(0.7), right(h, 0.0), up(0.0, h);
      const Distorted<double> found = lens.distorted(n);
      const Vector2<double> x = (lens.distorted(n + right).point - lens.distorted(n - right).point) / (2.0 * h);
      const Vector2<double> y = (lens.distorted(n + up).point - lens.distorted(n - up).point) / (2.0 * h);
      CHECK(distance(x, Vector2<double>(found.xx, found.yx)) <= 1e-9);
      CHECK(distance(y, Vector2<double>(found.xy, found.yy)) <= 1e-9);
    }
}

TEST_CASE("lanes give the pixels and features of single cameras") {
  Random random(15203);
  CAPTURE(random.seed());
  using S = Lanes<4>;
  for (const LensModel model : kModels) {
    std::array<LensParameters<double>, 4> single;
    LensParameters<S> together;
    for (int lane = 0; lane < 4; ++lane) {
      single[static_cast<std::size_t>(lane)] = random_camera(random, model).lens();
      set_lane(together, lane, single[static_cast<std::size_t>(lane)]);
    }
    const Lens<S> lens(together);
    const Vector2<double> feature = random.matrix<2>(200.0);
    const Vector2<S> pixel = lens.pixel(Vector2<S>(S(feature(0)), S(feature(1)))), back = lens.feature(pixel);
    for (int lane = 0; lane < 4; ++lane) {
      const Lens<double> one(single[static_cast<std::size_t>(lane)]);
      CHECK(distance(lane_of(pixel, lane), one.pixel(feature)) <= 1e-10);
      CHECK(distance(lane_of(back, lane), feature) <= 1e-9);
    }
  }
}

TEST_CASE("without a lens pixels are features; folded pixels and distortions of two kinds are refused") {
  CHECK_FALSE(Lens<double>(Camera{}.lens()).converts());
  CHECK_FALSE(Lens<double>().converts());
  for (int axis = 0; axis < 2; ++axis) {  // any number of the camera that is another one counts
    LensParameters<double> shifted, scaled;
    shifted.centre(axis) = 3.0;
    scaled.focal(axis) *= 1.5;
    Vector2<double> pixel(10.0, -20.0);
    pixel(axis) += 3.0;
    CHECK(distance(Lens<double>(shifted).pixels<2>({10.0, -20.0}), pixel) <= 1e-13);
    pixel(axis) = 1.5 * (pixel(axis) - 3.0);
    CHECK(distance(Lens<double>(scaled).pixels<2>({10.0, -20.0}), pixel) <= 1e-13);
  }
  Camera both;
  both.distortion.brown_conrady = Vector<double, 5>::Zero();
  both.distortion.kannala_brandt = Vector<double, 4>::Zero();
  CHECK(is_about(refusal([&] { both.lens(); }), "camera.distortion"));
  Camera folds;
  folds.distortion.brown_conrady = (Vector<double, 5>() << -0.3, 0.0, 0.0, 0.0, 0.0).finished();
  const Lens<double> lens(folds.lens());
  // r - 0.3 r^3 grows up to r = 1.054, by a twentieth up to 1.027
  CHECK(std::isfinite(lens.pixel({1.02 * folds.focal(), 0.0})(0)));
  CHECK(std::isnan(lens.pixel({1.04 * folds.focal(), 0.0})(0)));
  CHECK(std::isnan(lens.feature({0.71 * folds.focal(), 0.0})(0)));  // beyond the largest distorted radius, 0.703
}
