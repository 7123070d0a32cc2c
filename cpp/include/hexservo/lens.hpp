/// @file
/// From the features of a pinhole to the pixels of a real camera, and back (docs/model.md, section 4).
///
/// Laws work on the features of a pinhole with square pixels of focal length f. A real camera has a focal length for
/// each axis, a principal point and a lens that distorts; its pixels are those that a frame holds. Distortion acts on
/// n = (X/|Z|, -Y/|Z|), to the right and down, with the coefficients of OpenCV:
///
///     brown_conrady    n_d = n (1 + k1 r^2 + k2 r^4 + k3 r^6) + p,
///                      p = (2 p1 x y + p2 (r^2 + 2 x^2), p1 (r^2 + 2 y^2) + 2 p2 x y)
///     kannala_brandt   n_d = n theta_d/r,  theta_d = theta (1 + k1 theta^2 + ... + k4 theta^8),  theta = atan(r)
///     pixel            (u, v) = centre + (f_x x_d, f_y y_d)
#pragma once

#include "hexservo/types.hpp"

#include <limits>
#include <optional>

namespace hexservo {

/// Which distortion a lens has.
enum class LensModel { pinhole, brown_conrady, kannala_brandt };

/// Numbers of a camera's pixels, prepared.
template <class S>
struct LensParameters {
  S f{581.816};                                           ///< of the pinhole [px]
  Vector2<S> focal{S(581.816), S(-581.816)};              ///< f_x, f_y; f_y < 0 where pixels count upwards [px]
  Vector2<S> centre = Vector2<S>::Zero();                 ///< principal point [px]
  LensModel model = LensModel::pinhole;                   ///< the same in all lanes
  Vector<S, 5> coefficients = Vector<S, 5>::Zero();       ///< k1, k2, p1, p2, k3 or k1 ... k4 [1]
  S widest = S(std::numeric_limits<double>::infinity());  ///< largest |n|^2 that the lens shows [1]
  S steepest{0.0};                                        ///< |n| at which the distorted radius first grows fastest [1]

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"f", "px"}, self.f...);
    v(Field{"focal", "px"}, self.focal...);
    v(Field{"centre", "px"}, self.centre...);
    v(Field{"model"}, self.model...);
    v(Field{"coefficients", "1"}, self.coefficients...);
    v(Field{"widest", "1"}, self.widest...);
    v(Field{"steepest", "1"}, self.steepest...);
  }
};

inline constexpr int kRectificationRounds = 20;  ///< of Newton's method
/// A pixel that the rounds do not bring back within this is none of the lens [px].
inline constexpr double kRectificationResidual = 1e-6;

/// A point of the normalised image with its derivative: n_d, and d n_d/dn by rows.
template <class S>
struct Distorted {
  Vector2<S> point;
  S xx, xy, yx, yy;
};

/// The pixels of a camera and the features of its pinhole, one from the other.
template <class S>
class Lens {
 public:
  explicit Lens(const LensParameters<S>& p = {}) : p_(p) {
    differ_ = Mask<S>(p.model != LensModel::pinhole) |
              !((p.focal(0) == p.f) & (p.focal(1) == -p.f) & (p.centre(0) == S(0.0)) & (p.centre(1) == S(0.0)));
    converts_ = any(differ_);
  }

  /// Whether pixels differ from features, in any lane. Where they do not, both are left as they are, to the bit.
  bool converts() const noexcept { return converts_; }

  /// Distortion of n.
  Distorted<S> distorted(const Vector2<S>& n) const noexcept {
    using std::atan;
    using std::sqrt;
    const S x = n(0), y = n(1), s = x * x + y * y;
    const Vector<S, 5>& k = p_.coefficients;
    switch (p_.model) {
      case LensModel::brown_conrady: {
        const S radial = S(1.0) + s * (k(0) + s * (k(1) + s * k(4)));
        const S slope = S(2.0) * (k(0) + s * (S(2.0) * k(1) + s * S(3.0) * k(4)));  // of radial, per r dr
        const S p1 = k(2), p2 = k(3), mixed = x * y * slope + S(2.0) * (p1 * x + p2 * y);
        return {Vector2<S>(x * radial + S(2.0) * p1 * x * y + p2 * (s + S(2.0) * x * x),
                           y * radial + p1 * (s + S(2.0) * y * y) + S(2.0) * p2 * x * y),
                radial + x * x * slope + S(2.0) * p1 * y + S(6.0) * p2 * x, mixed, mixed,
                radial + y * y * slope + S(6.0) * p1 * y + S(2.0) * p2 * x};
      }
      case LensModel::kannala_brandt: {
        const S r = sqrt(s), theta = atan(r), t = theta * theta;
        const S even = S(1.0) + t * (k(0) + t * (k(1) + t * (k(2) + t * k(3))));
        const S odd = S(1.0) + t * (S(3.0) * k(0) + t * (S(5.0) * k(1) + t * (S(7.0) * k(2) + t * S(9.0) * k(3))));
        const Mask<S> far = s > S(1e-16);  // nearer to the axis both quotients are 1 to rounding
        const S radial = select(far, S(theta * even / r), S(1.0));
        const S along = odd / (S(1.0) + s);  // d theta_d/dr
        const S slope = select(far, S((along - radial) / s), S(0.0));
        return {Vector2<S>(x * radial, y * radial), radial + x * x * slope, x * y * slope, x * y * slope,
                radial + y * y * slope};
      }
      case LensModel::pinhole:
        break;
    }
    return {n, S(1.0), S(0.0), S(0.0), S(1.0)};
  }

  /// Pixel of a feature of the pinhole [px]; NaN where the lens does not show it.
  Vector2<S> pixel(const Vector2<S>& feature) const noexcept {
    const S scale = S(1.0) / p_.f;
    const Vector2<S> n(scale * feature(0), -scale * feature(1));
    const S x = n(0), y = n(1);
    const Mask<S> shown = x * x + y * y <= p_.widest;
    const Vector2<S> seen = distorted(n).point;
    const S none(std::numeric_limits<double>::quiet_NaN());
    return Vector2<S>(select(shown, S(p_.centre(0) + p_.focal(0) * seen(0)), none),
                      select(shown, S(p_.centre(1) + p_.focal(1) * seen(1)), none));
  }

  /// Feature of the pinhole of a pixel [px], by a fixed number of Newton's rounds; NaN where no ray that the lens shows
  /// has it.
  Vector2<S> feature(const Vector2<S>& pixel) const noexcept {
    using std::abs;
    const Vector2<S> target(S((pixel(0) - p_.centre(0)) / p_.focal(0)), S((pixel(1) - p_.centre(1)) / p_.focal(1)));
    Vector2<S> n = target;
    Mask<S> found(true);
    if (p_.model != LensModel::pinhole) {
      n = start(target);
      for (int round = 0; round < kRectificationRounds; ++round) {
        const Distorted<S> d = distorted(n);
        const S x = target(0) - d.point(0), y = target(1) - d.point(1);
        const S inverse = S(1.0) / (d.xx * d.yy - d.xy * d.yx);
        n(0) += inverse * (d.yy * x - d.xy * y);
        n(1) += inverse * (d.xx * y - d.yx * x);
        keep_within(n);
      }
      const Vector2<S> again = distorted(n).point;
      found = (abs(S(p_.focal(0) * (again(0) - target(0)))) <= S(kRectificationResidual)) &
              (abs(S(p_.focal(1) * (again(1) - target(1)))) <= S(kRectificationResidual));
    }
    const S x = n(0), y = n(1), none(std::numeric_limits<double>::quiet_NaN());
    found = found & (x * x + y * y <= S(1.0 + 1e-9) * p_.widest);
    return Vector2<S>(select(found, S(p_.f * x), none), select(found, S(-p_.f * y), none));
  }

  /// The same of all points.
  template <int M>
  Vector<S, M> pixels(const Vector<S, M>& features) const noexcept {
    if (!converts_) return features;
    Vector<S, M> out;
    for (int i = 0; i < M; i += 2) {
      const Vector2<S> same = features.template segment<2>(i);
      out.template segment<2>(i) = select(differ_, pixel(same), same);
    }
    return out;
  }
  template <int M>
  Vector<S, M> features(const Vector<S, M>& pixels) const noexcept {
    if (!converts_) return pixels;
    Vector<S, M> out;
    for (int i = 0; i < M; i += 2) {
      const Vector2<S> same = pixels.template segment<2>(i);
      out.template segment<2>(i) = select(differ_, feature(same), same);
    }
    return out;
  }

 private:
  /// On the ray of a pixel, where the distorted radius first grows fastest: from its inflection Newton's method is
  /// monotonic. Up to there it grows at least as fast as the radius, so that a pixel nearer than that is as well
  /// reached from its own radius, in fewer rounds.
  Vector2<S> start(const Vector2<S>& target) const noexcept {
    using std::sqrt;
    const S x = target(0), y = target(1), s = x * x + y * y;
    return target * select(s > S(0.0), min(S(p_.steepest / sqrt(s)), S(1.0)), S(0.0));
  }

  /// Brings n back to the rim of what the lens shows: beyond it the derivative is that of the fold.
  void keep_within(Vector2<S>& n) const noexcept {
    using std::sqrt;
    const S x = n(0), y = n(1), s = x * x + y * y;
    n *= select(s > p_.widest, S(sqrt(S(p_.widest / s))), S(1.0));
  }

  LensParameters<S> p_;
  Mask<S> differ_;
  bool converts_ = false;
};

}  // namespace hexservo
