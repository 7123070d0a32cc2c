/// @file
/// Attitude, angular velocity and angular acceleration of a frame of which a curve is known: its quaternion, or its
/// rotation vector. All three follow from the curve and its derivatives, so that they agree exactly (docs/model.md,
/// section 7).
#pragma once

#include "hexservo/rigid_body.hpp"
#include "hexservo/spline.hpp"

namespace hexservo {

/// How a frame turns at an instant: the moving frame B in the resting frame W.
template <class S>
struct Turning {
  Matrix3<S> R_WB = Matrix3<S>::Identity();       ///< turns B-coordinates into W-coordinates
  Vector3<S> rate_B = Vector3<S>::Zero();         ///< Omega in B [rad/s]
  Vector3<S> rate_change_B = Vector3<S>::Zero();  ///< Omega-dot in B: the derivative of its components there [rad/s^2]
};

/// Of a quaternion that need not be of unit length, with q = |q| (unit quaternion):
///
///     Omega = 2 Im(q* q-dot)/|q|^2,   Omega-dot = 2 (Im(q* q-ddot) - Omega (q . q-dot))/|q|^2
template <class S>
Turning<S> turning_of(const Curve<S, 4>& q) {
  const auto imaginary_product = [&q](const Vector4<S>& of) {  // Im(q* of)
    const Vector3<S> u(q.value(1), q.value(2), q.value(3)), v(of(1), of(2), of(3)), turned = cross<S>(u, v);
    return Vector3<S>(q.value(0) * v(0) - of(0) * u(0) - turned(0), q.value(0) * v(1) - of(0) * u(1) - turned(1),
                      q.value(0) * v(2) - of(0) * u(2) - turned(2));
  };
  const S scale = S(2.0) / q.value.squaredNorm();
  Turning<S> turning;
  turning.R_WB = rotation_matrix(q.value);
  turning.rate_B = scale * imaginary_product(q.rate);
  turning.rate_change_B = scale * (imaginary_product(q.acceleration) - q.value.dot(q.rate) * turning.rate_B);
  return turning;
}

/// Unit quaternion of a rotation vector r [rad] and its derivatives: (cos(|r|/2), sin(|r|/2) r/|r|). Both are series in
/// s = |r|^2/4, whose remainder is below 1e-16 for |r| up to 2 pi, so that nothing is singular at r = 0.
template <class S>
Curve<S, 4> quaternion_curve(const Curve<S, 3>& r) {
  constexpr int kSeriesTerms = 16;
  const S s = S(0.25) * r.value.squaredNorm(), s_rate = S(0.5) * r.value.dot(r.rate),
          s_acceleration = S(0.5) * (r.rate.squaredNorm() + r.value.dot(r.acceleration));
  // K(s) = sin(sqrt s)/sqrt s = sum_n (-s)^n/(2n + 1)! with K' and K''; C(s) = cos(sqrt s), C' = -K/2
  S K(0.0), first(0.0), half_second(0.0), C(0.0);
  double inverse_factorial = 1.0;
  std::array<double, kSeriesTerms> sine, cosine;
  for (std::size_t n = 0; n < kSeriesTerms; ++n) {
    const double sign = n % 2 == 0 ? 1.0 : -1.0;
    cosine[n] = sign * inverse_factorial;
    inverse_factorial /= static_cast<double>(2 * n + 1);
    sine[n] = sign * inverse_factorial;
    inverse_factorial /= static_cast<double>(2 * n + 2);
  }
  for (std::size_t n = kSeriesTerms; n-- > 0;) {
    half_second = half_second * s + first;
    first = first * s + K;
    K = K * s + S(sine[n]);
    C = C * s + S(cosine[n]);
  }
  const S second = S(2.0) * half_second, half(0.5);
  Curve<S, 4> q;
  q.value(0) = C;
  q.rate(0) = -half * K * s_rate;
  q.acceleration(0) = -half * (first * s_rate * s_rate + K * s_acceleration);
  for (int i = 0; i < 3; ++i) {
    q.value(i + 1) = half * K * r.value(i);
    q.rate(i + 1) = half * (first * s_rate * r.value(i) + K * r.rate(i));
    q.acceleration(i + 1) = half * ((second * s_rate * s_rate + first * s_acceleration) * r.value(i) +
                                    S(2.0) * first * s_rate * r.rate(i) + K * r.acceleration(i));
  }
  return q;
}

}  // namespace hexservo
