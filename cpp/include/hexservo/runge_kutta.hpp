/// @file
/// The classic fourth-order Runge-Kutta method (docs/model.md, section 7), for states whose stages are never formed in
/// full.
#pragma once

#include <array>
#include <cstddef>

namespace hexservo {

/// b_k of the classic method: y(t + h) = y + h sum b_k k_k.
inline constexpr std::array<double, 4> kRungeKuttaWeights = {1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0};

/// One step of h [s]: works out the four stage derivatives and hands them to `combine`.
///
/// The caller combines them, so that a state with a cheap representation of its stages (rank-one weights) and a plain
/// vector go through the same method, and nothing is copied.
/// @param k1 derivative at the start of the step
/// @param derivative_at (scale, rate) -> derivative at y + scale rate
/// @param combine takes the four derivatives as one array of pointers, in the order of `kRungeKuttaWeights`
template <class Rate, class Function, class Combine>
void runge_kutta_step(double h, const Rate& k1, Function&& derivative_at, Combine&& combine) {
  const Rate k2 = derivative_at(0.5 * h, k1);
  const Rate k3 = derivative_at(0.5 * h, k2);
  const Rate k4 = derivative_at(h, k3);
  combine(std::array<const Rate*, 4>{&k1, &k2, &k3, &k4});
}

/// The same for a state that is a vector, which has sums and multiples: y becomes y(t + h).
/// @param rate_at state -> its time derivative
template <class State, class Function>
void runge_kutta_step(double h, State& y, Function&& rate_at) {
  const State start = y;
  runge_kutta_step(
      h, State(rate_at(start)),
      [&](double scale, const State& rate) { return State(rate_at(State(start + scale * rate))); },
      [&](const std::array<const State*, 4>& k) {
        for (std::size_t i = 0; i < 4; ++i) y = State(y + (h * kRungeKuttaWeights[i]) * *k[i]);
      });
}

}  // namespace hexservo
