/// @file
/// The classic fourth-order Runge-Kutta method, for states whose stages are never formed in full.
#pragma once

#include <array>

namespace hexservo {

/// b_k of the classic method: y(t + h) = y + h sum b_k k_k.
inline constexpr std::array<double, 4> kRungeKuttaWeights = {1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0};

/// The four stage derivatives of one step of h [s].
///
/// The caller combines them, so that a state with a cheap representation of its stages (rank-one weights) and a plain
/// vector go through the same method.
/// @param first derivative at the start of the step
/// @param derivative_at (scale, rate) -> derivative at y + scale rate
template <class Rate, class Function>
std::array<Rate, 4> runge_kutta_stages(double h, const Rate& first, Function&& derivative_at) {
  std::array<Rate, 4> k;
  k[0] = first;
  k[1] = derivative_at(0.5 * h, k[0]);
  k[2] = derivative_at(0.5 * h, k[1]);
  k[3] = derivative_at(h, k[2]);
  return k;
}

}  // namespace hexservo
