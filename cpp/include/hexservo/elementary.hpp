/// @file
/// Functions of one number that the standard library has for `double` alone, and with branches on data: here without a
/// branch, on any scalar, so that a servo tick takes the same time for all twists and a pack needs no scalar call
/// (`tanh` of the switching term: docs/model.md, section 6; rounding and waves of the sampled loop).
#pragma once

#include "hexservo/lanes.hpp"

namespace hexservo {

/// 2^n for a whole n in [-1022, 1023], by writing the exponent.
template <class S>
S power_of_two(const S& n) {
  // Added to 1.5 * 2^52, a small whole number stands in the lowest bits of the sum.
  const S shifted = n + S(6755399441055744.0 + 1023.0);
  if constexpr (std::is_same_v<S, double>) {
    return std::bit_cast<double>(std::bit_cast<std::uint64_t>(shifted) << 52);
  } else {
    using Bits = typename LaneRegister<S::width>::Bits;
    return S(std::bit_cast<typename S::Register>(std::bit_cast<Bits>(shifted.values()) << 52));
  }
}

/// exp(x) - 1 for x in [-708, 0], within 4 units in the last place.
///
/// x = n ln 2 + r with |r| <= ln(2)/2; Taylor's polynomial of degree 13 in r (its remainder is below 2^-56 of r), then
/// 2^n (1 + p) - 1 = 2^n p + (2^n - 1), which loses nothing for small x.
template <class S>
S expm1_of_negative(const S& x) {
  constexpr double kRounding = 6755399441055744.0;  // 1.5 * 2^52: sums with it are rounded to whole numbers
  constexpr double kLn2High = 0x1.62e42fee00000p-1, kLn2Low = 0x1.a39ef35793c76p-33;  // ln 2 in two parts
  const S n = (x * S(1.4426950408889634) + S(kRounding)) - S(kRounding);
  const S r = (x - n * S(kLn2High)) - n * S(kLn2Low);
  constexpr double kInverseFactorials[] = {1.0 / 6227020800.0, 1.0 / 479001600.0, 1.0 / 39916800.0, 1.0 / 3628800.0,
                                           1.0 / 362880.0,     1.0 / 40320.0,     1.0 / 5040.0,     1.0 / 720.0,
                                           1.0 / 120.0,        1.0 / 24.0,        1.0 / 6.0,        1.0 / 2.0};
  S tail(kInverseFactorials[0]);
  for (int i = 1; i < 12; ++i) tail = tail * r + S(kInverseFactorials[i]);
  const S p = r + r * r * tail;
  const S scale = power_of_two(n);
  return scale * p + (scale - S(1.0));
}

/// tanh(x) = -t/(t + 2) with t = exp(-2|x|) - 1, and the sign of x; NaN stays NaN. Within 4 units in the last place of
/// the standard library's.
template <class S>
S hyperbolic_tangent(const S& x) {
  using std::abs;
  constexpr double kFlat = 20.0;  // tanh rounds to 1 from 19.1 on
  const S size = abs(x);
  const S t = expm1_of_negative(S(S(-2.0) * select(size > S(kFlat), S(kFlat), size)));
  const S y = -t / (t + S(2.0));
  return select(x < S(0.0), S(-y), y);
}

/// The nearest whole number of |x| < 2^51, the even one of two; NaN and infinities stay.
template <class S>
S nearest_whole(const S& x) {
  const S rounding(6755399441055744.0);  // 1.5 * 2^52: sums with it are rounded to whole numbers
  return (x + rounding) - rounding;
}

/// The multiple of `step` that is nearest to x; x itself where the step is 0.
template <class S>
S quantise(const S& x, const S& step) {
  const Mask<S> coarse = step > S(0.0);
  const S divisor = select(coarse, step, S(1.0));
  return select(coarse, S(divisor * nearest_whole(S(x / divisor))), x);
}

/// sin(2 pi x) of x in turns, |x| < 2^51: within 5e-16 for the x that is given.
///
/// The turn is reduced exactly, then folded to a quarter on either side of zero, and Taylor's polynomial of degree 21
/// in the angle follows (its remainder is below 1e-17).
template <class S>
S sine_of_turns(const S& x) {
  using std::abs;
  constexpr double kTwoPi = 6.283185307179586;
  constexpr double kCoefficients[] = {1.0 / 51090942171709440000.0,
                                      -1.0 / 121645100408832000.0,
                                      1.0 / 355687428096000.0,
                                      -1.0 / 1307674368000.0,
                                      1.0 / 6227020800.0,
                                      -1.0 / 39916800.0,
                                      1.0 / 362880.0,
                                      -1.0 / 5040.0,
                                      1.0 / 120.0,
                                      -1.0 / 6.0};  // 1/21!, -1/19!, ... -1/3!
  const S r = x - nearest_whole(x);                 // [-1/2, 1/2]
  const S folded = select(abs(r) > S(0.25), S(select(r < S(0.0), S(-0.5), S(0.5)) - r), r);
  const S angle = S(kTwoPi) * folded, square = angle * angle;
  S tail(kCoefficients[0]);
  for (int i = 1; i < 10; ++i) tail = tail * square + S(kCoefficients[i]);
  return angle + angle * square * tail;
}

}  // namespace hexservo
