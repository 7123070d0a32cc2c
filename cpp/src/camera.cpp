#include "hexservo/camera.hpp"

#include "check.hpp"

#include <cmath>

namespace hexservo {

using detail::refuse;
using detail::words;

namespace {

constexpr double kWidest = 11.0;      // |n| of a ray 85 degrees off the axis: beyond it a pinhole has no use
constexpr double kLeastSlope = 0.05;  // of the distorted radius: nearer to its fold a pixel determines no ray
constexpr double kRadiusStep = 1.0 / 2048.0;

/// Notes up to which |n| the distorted radius grows, and where it first grows fastest.
/// @return whether it grows at all
bool note_reach(LensParameters<double>& lens) {
  if (lens.model == LensModel::pinhole) return true;
  LensParameters<double> centred = lens;  // without decentring, which is small
  if (lens.model == LensModel::brown_conrady) centred.coefficients(2) = centred.coefficients(3) = 0.0;
  const Lens<double> along(centred);
  const auto slope = [&along](double r) { return along.distorted({r, 0.0}).xx; };
  double radius = 0.0, before = slope(0.0);
  bool rises = true;  // up to the first inflection: a pixel from beyond it is reached from there as well
  for (double r = kRadiusStep; r < kWidest; r += kRadiusStep) {
    const double now = slope(r);
    // of a fisheye per angle: its radius grows ever less with |n|, but its pixels determine the angle
    if (!(now * (lens.model == LensModel::kannala_brandt ? 1.0 + r * r : 1.0) >= kLeastSlope)) break;
    radius = r;
    rises = rises && now > before;
    if (rises) lens.steepest = r;
    before = now;
  }
  lens.widest = radius * radius;
  return radius > 0.0;
}

}  // namespace

CameraParameters<double> Camera::parameters(std::string_view key) const {
  CameraParameters<double> found{focal(), placement(mount, words(key, ".mount"))};
  found.placement.on = mount.on;
  if (axes == CameraAxes::opencv) found.placement.R_MC.rightCols<2>() *= -1.0;
  return found;
}

LensParameters<double> Camera::lens(std::string_view key) const {
  LensParameters<double> found;
  found.f = focal();
  found.focal = focal_pixels.value_or(Vector2<double>(found.f, found.f));
  if (!principal_point && axes == CameraAxes::paper) found.focal(1) *= -1.0;  // pixels count upwards
  found.centre = principal_point.value_or(Vector2<double>::Zero()) + image_offset;
  if (distortion.brown_conrady && distortion.kannala_brandt)
    refuse(words(key, ".distortion"), "one of brown_conrady and kannala_brandt", "both");
  if (distortion.brown_conrady) {
    found.model = LensModel::brown_conrady;
    found.coefficients = *distortion.brown_conrady;
  } else if (distortion.kannala_brandt) {
    found.model = LensModel::kannala_brandt;
    found.coefficients.head<4>() = *distortion.kannala_brandt;
  }
  if (!note_reach(found)) refuse(words(key, ".distortion"), "numbers that leave an image", "a lens that shows no ray");
  return found;
}

}  // namespace hexservo
