/// @file
/// The adaptive fuzzy systems of (13) and (22): bell memberships, factorised basis, rule table, rank-one adaptation.
///
/// | paper    | here                 |                                                                              |
/// | -------- | -------------------- | ---------------------------------------------------------------------------- |
/// | phi-bar  | FuzzyBasis           | 49 = 7 x 7 normalised rule strengths, the outer product of two vectors of 7   |
/// | omega_f  | FuzzyWeights         | 7 x 7 per axis, row: term of u, column: term of u-dot [N or N m]              |
/// | tau_f    | FuzzyStage::output   | mu(u)^T W mu(u-dot)                                                          |
/// | Psi      | adaptation           | (22): omega-dot_j = chi-dot_j phi-bar_j/Psi_j                                |
///
/// The 49-rule sum factorises because rule (r, c) fires mu_r(u) mu_c(u-dot): its normaliser is the product of the two
/// sums. The adaptation is rank one, so a Runge-Kutta stage holds the weights as W + c (rank one) and never forms 294
/// numbers (docs/model.md, section 5).
#pragma once

#include "hexservo/side_by_side.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <type_traits>

namespace hexservo {

inline constexpr int kTerms = 7;  ///< NB NM NS ZE PS PM PB
inline constexpr int kAxes = 6;   ///< one fuzzy system for each component of the wrench

/// c_k = -1, -2/3, ..., 1: centres of the terms, of the inputs and of the rule table's output [1].
constexpr double term_centre(int term) { return (term - 3) / 3.0; }

/// The linear (MacVicar-Whelan) table: centre of the output term clamp(row + column, -3, 3) [1].
Matrix7<double> linear_rule_table();

/// Weights may be of any size.
template <class S>
Vector6<S> no_limit() {
  return Vector6<S>::Constant(S(std::numeric_limits<double>::infinity()));
}

/// Slopes beyond make steps of the bells.
inline constexpr Bound kBellSlopes = {.least = 0.0, .most = 16.0, .above = true};

/// Design of the six fuzzy systems.
template <class S>
struct FuzzyGains {
  bool enabled = true;                                        ///< false: no fuzzy output and no adaptation
  Vector6<S> adaptation = Vector6<S>::Constant(S(10.0));      ///< Psi_j [m/N; rad/(N m)], 10; small adapts fast
  Vector6<S> error_scale = linear_angular<S>(5.0, 10.0);      ///< a_j [1/N; 1/(N m)], 5 x3, 10 x3
  Vector6<S> rate_scale = Vector6<S>::Constant(S(0.5));       ///< b_j [s/N; s/(N m)], 0.5
  Vector6<S> initial_scale = Vector6<S>::Zero();              ///< s_0: weights start at s_0 times the table [N; N m], 0
  Matrix7<S> table = linear_rule_table().template cast<S>();  ///< rule table, row: u, column: u-dot [1], linear
  S bell_width{1.0 / 6.0};                                    ///< w, half width of the bells at 1/2 [1], 1/6
  double bell_slope = 2.0;                                    ///< s, exponent 2s of the bells [1], 2
  Vector6<S> leakage = Vector6<S>::Zero();                    ///< sigma_j [1/s], 0: no weight is forgotten
  Vector6<S> weight_limit = no_limit<S>();                    ///< largest |omega_j| [N; N m], infinite: none
  Vector6<S> dead_zone = Vector6<S>::Zero();                  ///< drivers within +- this have no effect [m/s; rad/s], 0

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"enabled"}.of_pack(), self.enabled...);
    v(Field{"adaptation", "m/N; rad/(N m)", kPositive}, self.adaptation...);
    v(Field{"error_scale", "1/N; 1/(N m)", kNotNegative}, self.error_scale...);
    v(Field{"rate_scale", "s/N; s/(N m)", kNotNegative}, self.rate_scale...);
    v(Field{"initial_scale", "N; N m"}, self.initial_scale...);
    v(Field{"table", "1"}.entrywise(), self.table...);
    v(Field{"bell_width", "1", kPositive}, self.bell_width...);
    v(Field{"bell_slope", "1", kBellSlopes}.of_pack(), self.bell_slope...);
    v(Field{"leakage", "1/s", kNotNegative}, self.leakage...);
    v(Field{"weight_limit", "N; N m", kPositiveOrNone}, self.weight_limit...);
    v(Field{"dead_zone", "m/s; rad/s", kNotNegative}, self.dead_zone...);
  }
};

/// The six systems side by side: they have the same shape, so every line below works on all of them at once.
template <class S>
using AxisVector = SideBySide<S, kAxes>;

/// One number for each of the seven terms; `R` is a register of systems.
template <class R>
using Terms = std::array<R, kTerms>;

/// Strengths of the seven terms [1], each for the six systems.
template <class S>
using TermStrengths = std::array<AxisVector<S>, kTerms>;

/// Where the seven bells of an input are: q/mu_k(x) = q + |r (x - c_k)/w|^(2s) for term k, with q = r^(2s).
template <class R>
struct BellPlaces {
  R inverse_width;   ///< r/w [1]
  Terms<R> centres;  ///< r c_k/w [1]
  R one;             ///< q [1]

  BellPlaces(const R& inverse_width_, const R& one_) : inverse_width(inverse_width_), one(one_) {
    for (int k = 0; k < kTerms; ++k) centres[static_cast<std::size_t>(k)] = R(term_centre(k)) * inverse_width;
  }

  /// q/mu_k, what the bells divide by, at r x/w.
  /// @param power (r (x - c_k)/w)^2 -> its s-th power
  template <class Power>
  [[gnu::always_inline]] inline Terms<R> denominators(const R& scaled, const Power& power) const {
    Terms<R> d;
#pragma GCC unroll 7
    for (std::size_t k = 0; k < kTerms; ++k) {
      const R distance = scaled - centres[k];
      d[k] = power(distance * distance) + one;
    }
    return d;
  }
};

/// The power of two r that takes the far denominators of bells of slope 2 near 1, so that their products are near 1
/// too; those of wide bells are there already.
inline double denominator_scale(double width) { return std::min(1.0, std::exp2(std::round(std::log2(1.5 * width)))); }
template <int W>
Lanes<W> denominator_scale(Lanes<W> width) {
  return detail::map_lanes(width, [](double w) { return denominator_scale(w); });
}

/// The seven bells of an input, mu_k(x) = 1/(1 + |(x - c_k)/w|^(2s)).
template <class S>
struct Bells {
  using Register = RegisterOf<S>;

  Bells(const S& width, double bell_slope) : Bells(S(1.0) / width, denominator_scale(width), bell_slope) {}

  BellPlaces<Register> plain;  ///< r = 1, for any slope
  BellPlaces<Register> even;   ///< r = `denominator_scale`, for the usual slope 2
  double slope;                ///< s [1]
  int whole_slope;             ///< s where it is a whole number up to 64, else 0 [1]

 private:
  Bells(const S& inverse_width, const S& scale, double bell_slope)
      : plain(inverse_width, S(1.0)),
        even(S(scale * inverse_width), S((scale * scale) * (scale * scale))),
        slope(bell_slope),
        whole_slope(bell_slope <= 64.0 && bell_slope == std::floor(bell_slope) ? static_cast<int>(bell_slope) : 0) {}
};

/// The power of bells of the usual slope, 2.
struct SquarePower {
  static constexpr bool even = true;  ///< products of denominators are near 1

  template <class R>
  R operator()(const R& x2) const {
    return x2 * x2;
  }
};

/// That of any slope. A whole one never calls `pow`.
template <class S>
struct AnyPower {
  static constexpr bool even = false;

  const Bells<S>& bells;

  RegisterOf<S> operator()(const RegisterOf<S>& x2) const {
    if (bells.whole_slope == 0) return pow(x2, bells.slope);
    RegisterOf<S> power = x2;
    for (int i = 1; i < bells.whole_slope; ++i) power *= x2;
    return power;
  }
};

/// Generalised bells mu_k(x) = 1/(1 + |(x - c_k)/w|^(2s)) of the seven terms.
template <class S>
TermStrengths<S> memberships(const AxisVector<S>& x, const Bells<S>& bells) {
  TermStrengths<S> mu;
  for (std::size_t r = 0; r < AxisVector<S>::registers; ++r) {
    const Terms<RegisterOf<S>> d = bells.plain.denominators(x.part[r] * bells.plain.inverse_width, AnyPower<S>{bells});
    for (std::size_t k = 0; k < kTerms; ++k) mu[k].part[r] = RegisterOf<S>(1.0) / d[k];
  }
  return mu;
}

/// Memberships of the seven terms times a factor that they share, and their sum.
template <class R>
struct ScaledTerms {
  Terms<R> mu;
  R sum;

  /// Divides them by their sum.
  void normalise() {
    const R inverse_sum = R(1.0) / sum;
    for (R& term : mu) term = term * inverse_sum;
  }
};

/// Memberships from their denominators d_k = 1/mu_k without a division: the product of the other six d, which is the
/// product of all times mu_k.
///
/// The products go by pairs of mirrored terms, so that no chain of them is long. `validate` keeps bells so steep that
/// they overflow out of the core.
template <class R>
[[gnu::always_inline]] inline ScaledTerms<R> scaled_terms(const Terms<R>& d) {
  static_assert(kTerms == 7);
  const R outer = d[0] * d[6], middle = d[1] * d[5], inner = d[2] * d[4];
  const R without_outer = d[3] * (middle * inner), without_middle = d[3] * (outer * inner),
          without_inner = d[3] * (outer * middle);
  ScaledTerms<R> terms;
  Terms<R>& mu = terms.mu;
  mu[0] = without_outer * d[6];
  mu[6] = without_outer * d[0];
  mu[1] = without_middle * d[5];
  mu[5] = without_middle * d[1];
  mu[2] = without_inner * d[4];
  mu[4] = without_inner * d[2];
  mu[3] = (outer * middle) * inner;
  terms.sum = ((mu[0] + mu[6]) + (mu[1] + mu[5])) + ((mu[2] + mu[4]) + mu[3]);
  return terms;
}

/// The same of one register of x, which is limited to [-1, 1].
template <class S, class Power>
[[gnu::always_inline]] inline ScaledTerms<RegisterOf<S>> scaled_terms(const RegisterOf<S>& x, const Bells<S>& bells,
                                                                      const Power& power) {
  const BellPlaces<RegisterOf<S>>& places = Power::even ? bells.even : bells.plain;
  const RegisterOf<S> most = places.inverse_width;
  return scaled_terms(places.denominators(clip(RegisterOf<S>(x * most), -most, most), power));
}

/// True where leakage, limit or dead zone act in some lane; otherwise (22) stands as printed, to the last bit.
template <class S>
bool has_restraint(const FuzzyGains<S>& gains) {
  Mask<S> some = gains.leakage(0) > S(0.0);
  for (int j = 0; j < kAxes; ++j)
    some = some | (gains.leakage(j) > S(0.0)) | (gains.dead_zone(j) > S(0.0)) |
           (gains.weight_limit(j) < S(std::numeric_limits<double>::infinity()));
  return any(some);
}

/// The six systems of a design, ready for the loop.
template <class S>
struct FuzzySystems {
  explicit FuzzySystems(const FuzzyGains<S>& gains)
      : enabled(gains.enabled),
        bells(gains.bell_width, gains.bell_slope),
        inverse_adaptation(Vector6<S>(gains.adaptation.cwiseInverse())),
        error_scale(gains.error_scale),
        rate_scale(gains.rate_scale),
        restrained(has_restraint(gains)),
        leakage(gains.leakage),
        weight_limit(gains.weight_limit),
        dead_zone(gains.dead_zone) {}

  bool enabled;
  Bells<S> bells;
  AxisVector<S> inverse_adaptation;  ///< 1/Psi_j [N/m; N m/rad]
  AxisVector<S> error_scale;         ///< a_j [1/N; 1/(N m)]
  AxisVector<S> rate_scale;          ///< b_j [s/N; s/(N m)]
  bool restrained;                   ///< whether the next three act
  AxisVector<S> leakage;             ///< sigma_j [1/s]
  AxisVector<S> weight_limit;        ///< largest |omega_j| [N; N m]
  AxisVector<S> dead_zone;           ///< [m/s; rad/s]
};

/// phi-bar of the six systems as the two factors of its outer product, but for the sum of its 49 rules, by which it is
/// not divided yet.
template <class S>
struct FuzzyBasis {
  TermStrengths<S> error;  ///< memberships of u, times a factor of each system
  TermStrengths<S> rate;   ///< memberships of u-dot, likewise
};

template <class S>
AxisVector<S> sum_of(const TermStrengths<S>& terms) {
  AxisVector<S> sum = terms[0];
  for (std::size_t k = 1; k < kTerms; ++k) sum += terms[k];
  return sum;
}

/// Memberships divided by their sum: one factor of phi-bar.
template <class S>
TermStrengths<S> normalised(const TermStrengths<S>& scaled) {
  const AxisVector<S> sum = sum_of(scaled);
  TermStrengths<S> mu;
  for (std::size_t k = 0; k < kTerms; ++k)
    for (std::size_t r = 0; r < AxisVector<S>::registers; ++r) mu[k].part[r] = scaled[k].part[r] / sum.part[r];
  return mu;
}

/// Weights of the six systems, the law's state: entry `rule(row, column)` holds the rule's weight for each axis.
template <class S>
using FuzzyWeights = std::array<AxisVector<S>, kTerms * kTerms>;

/// Place of the rule (term of u, term of u-dot) in the weights.
constexpr std::size_t rule(int row, int column) { return static_cast<std::size_t>(column * kTerms + row); }

/// W_j of one system as a 7 x 7 matrix, row: term of u, column: term of u-dot [N or N m].
template <class S>
Matrix7<S> weight_matrix(const FuzzyWeights<S>& weights, int axis) {
  Matrix7<S> W;
  for (int row = 0; row < kTerms; ++row)
    for (int column = 0; column < kTerms; ++column) W(row, column) = weights[rule(row, column)](axis);
  return W;
}

/// omega(0) = s_0 times the rule table, projected on the interval of the limit [N; N m].
template <class S>
FuzzyWeights<S> initial_weights(const FuzzyGains<S>& gains) {
  FuzzyWeights<S> weights;
  for (int row = 0; row < kTerms; ++row)
    for (int column = 0; column < kTerms; ++column) {
      Vector6<S> weight = gains.initial_scale * gains.table(row, column);
      for (int j = 0; j < kAxes; ++j) weight(j) = clip(weight(j), S(-gains.weight_limit(j)), gains.weight_limit(j));
      weights[rule(row, column)] = AxisVector<S>(weight);
    }
  return weights;
}

/// Time derivative of the weights, of rank one for each axis: strength * basis.error * basis.rate^T.
template <class S>
struct FuzzyRate {
  FuzzyBasis<S> basis;     ///< of no meaning where the systems are switched off
  AxisVector<S> strength;  ///< chi-dot_j/Psi_j of (22), over the sum of the basis
};

/// Weights inside a Runge-Kutta stage: the step's weights plus `scale` times the previous stage's rate, never formed.
template <class S>
struct FuzzyStage {
  const FuzzyWeights<S>* weights;
  const FuzzyRate<S>* rate = nullptr;  ///< null at the start of a step
  S scale{0.0};                        ///< [s]

  /// tau_f = mu(u)^T W mu(u-dot), (13), of one register of systems [N; N m].
  /// @param r the register
  /// @param error, error_rate memberships of u and u-dot, each times some factor, which the output then has too
  [[gnu::always_inline]] inline RegisterOf<S> output(std::size_t r, const Terms<RegisterOf<S>>& error,
                                                     const Terms<RegisterOf<S>>& error_rate) const {
    using R = RegisterOf<S>;
    R total(0.0), others(0.0);  // of the first columns, and of the last ones: neither waits for the other
#pragma GCC unroll 7
    for (std::size_t column = 0; column < kTerms; ++column) {
      const auto weight = [&](std::size_t row) {
        return (*weights)[rule(static_cast<int>(row), static_cast<int>(column))].part[r];
      };
      R sum = error[0] * weight(0);
#pragma GCC unroll 7
      for (std::size_t row = 1; row < kTerms; ++row) sum += error[row] * weight(row);
      if (column < kTerms / 2)
        total += sum * error_rate[column];
      else
        others += sum * error_rate[column];
    }
    total += others;
    if (rate != nullptr) {
      // in this order, no product is larger than two sums of memberships
      const R reach = R(scale) * rate->strength.part[r] * inner(error, rate->basis.error, r);
      total += reach * inner(error_rate, rate->basis.rate, r);
    }
    return total;
  }

 private:
  [[gnu::always_inline]] static inline RegisterOf<S> inner(const Terms<RegisterOf<S>>& a, const TermStrengths<S>& b,
                                                           std::size_t r) {
    RegisterOf<S> sum = a[0] * b[0].part[r];
#pragma GCC unroll 7
    for (std::size_t k = 1; k < kTerms; ++k) sum += a[k] * b[k].part[r];
    return sum;
  }
};

namespace detail {
/// Adds to `rows` rows of one register of systems: the factors of several rows stay in registers for all columns.
template <std::size_t first_row, std::size_t rows, class S, std::size_t K>
void advance_rows(FuzzyWeights<S>& weights, const std::array<const FuzzyRate<S>*, K>& rates,
                  const std::array<RegisterOf<S>, K>& factor, std::size_t r) {
  using R = RegisterOf<S>;
  std::array<std::array<R, rows>, K> left;
  std::array<const FuzzyBasis<S>*, K> basis;  // read once: the compiler must assume that a weight may alias a pointer
#pragma GCC unroll 4
  for (std::size_t k = 0; k < K; ++k) {
    basis[k] = &rates[k]->basis;
#pragma GCC unroll 4
    for (std::size_t i = 0; i < rows; ++i) left[k][i] = factor[k] * basis[k]->error[first_row + i].part[r];
  }
#pragma GCC unroll 7
  for (std::size_t column = 0; column < kTerms; ++column) {
    std::array<R, rows> sum;
#pragma GCC unroll 4
    for (std::size_t i = 0; i < rows; ++i)
      sum[i] = weights[rule(static_cast<int>(first_row + i), static_cast<int>(column))].part[r];
#pragma GCC unroll 4
    for (std::size_t k = 0; k < K; ++k) {
      const R right = basis[k]->rate[column].part[r];
#pragma GCC unroll 4
      for (std::size_t i = 0; i < rows; ++i) sum[i] += left[k][i] * right;
    }
#pragma GCC unroll 4
    for (std::size_t i = 0; i < rows; ++i)
      weights[rule(static_cast<int>(first_row + i), static_cast<int>(column))].part[r] = sum[i];
  }
}
}  // namespace detail

/// W += sum over stages of scale_k * rate_k: the end of a step, one update of rank K.
template <class S, std::size_t K>
void advance_weights(FuzzyWeights<S>& weights, const std::array<const FuzzyRate<S>*, K>& rates,
                     const std::array<S, K>& scales) {
  using R = RegisterOf<S>;
  for (std::size_t r = 0; r < AxisVector<S>::registers; ++r) {
    std::array<R, K> factor;
    for (std::size_t k = 0; k < K; ++k) factor[k] = R(scales[k]) * rates[k]->strength.part[r];
    detail::advance_rows<0, 2, S, K>(weights, rates, factor, r);
    detail::advance_rows<2, 2, S, K>(weights, rates, factor, r);
    detail::advance_rows<4, 3, S, K>(weights, rates, factor, r);
  }
}

/// The same where only some lanes take part: the others keep their weights, whatever their rates are.
template <class S, std::size_t K>
void advance_weights(FuzzyWeights<S>& weights, const std::array<const FuzzyRate<S>*, K>& rates,
                     const std::array<S, K>& scales, const Mask<S>& active) {
  if (all(active)) return advance_weights(weights, rates, scales);
  if (!any(active)) return;
  const FuzzyWeights<S> before = weights;
  advance_weights(weights, rates, scales);
  if constexpr (!std::is_same_v<Mask<S>, bool>)
    for (std::size_t i = 0; i < before.size(); ++i)
      for (std::size_t r = 0; r < AxisVector<S>::registers; ++r)
        weights[i].part[r] = select(active, weights[i].part[r], before[i].part[r]);
}

/// Leakage and dead zone inside a stage: omega-dot_j = d(driver_j) phi-bar_j/Psi_j - sigma_j omega_j.
///
/// With V = exp(sigma t) W, t from the start of the step, V-dot = exp(sigma t) (rank one): the stage stays of rank one.
/// So `rate` becomes that of V, and the output that of W = exp(-sigma t) V.
/// @param elapsed t [s]
/// @param driver what drives the adaptation, chi-dot in (22) [m/s; rad/s]
/// @param share as of `fire`
/// @return the output of W [N; N m]
template <class S>
[[gnu::noinline]] AxisVector<S> restrain(const FuzzySystems<S>& systems, const S& elapsed, const AxisVector<S>& driver,
                                         const AxisVector<S>& share, FuzzyRate<S>& rate, AxisVector<S> output) {
  using R = RegisterOf<S>;
  using std::exp;
  for (std::size_t r = 0; r < AxisVector<S>::registers; ++r) {
    const R growth = exp(R(systems.leakage.part[r] * R(elapsed)));
    const R zone = systems.dead_zone.part[r];
    const R driven = driver.part[r] - clip(driver.part[r], -zone, zone);
    rate.strength.part[r] = systems.inverse_adaptation.part[r] * driven * growth * share.part[r];
    output.part[r] = output.part[r] / growth;
  }
  return output;
}

/// Leakage and limit at the end of a step: from V back to W, each weight then projected on its interval.
/// @param step length of the step [s]
/// @param active lanes that take part; the others keep their weights
template <class S>
void restrain(const FuzzySystems<S>& systems, const S& step, FuzzyWeights<S>& weights, const Mask<S>& active) {
  using R = RegisterOf<S>;
  using std::exp;
  if (!any(active)) return;
  for (std::size_t r = 0; r < AxisVector<S>::registers; ++r) {
    const R growth = exp(R(systems.leakage.part[r] * R(step))), limit = systems.weight_limit.part[r];
    for (AxisVector<S>& weight : weights) {
      const R limited = clip(R(weight.part[r] / growth), -limit, limit);
      if constexpr (std::is_same_v<Mask<S>, bool>)
        weight.part[r] = limited;
      else
        weight.part[r] = select(active, limited, weight.part[r]);
    }
  }
}

namespace detail {
/// See `fire`; a register of systems at a time, from inputs to output: what its rules fire with stays in registers.
template <class S, class Power>
[[gnu::always_inline]] inline void fire_with(const Bells<S>& bells, const Power& power, const FuzzyStage<S>& weights,
                                             const AxisVector<S>& u, const AxisVector<S>& u_rate, FuzzyBasis<S>& basis,
                                             AxisVector<S>& share, AxisVector<S>& output) {
  using R = RegisterOf<S>;
  for (std::size_t r = 0; r < AxisVector<S>::registers; ++r) {
    ScaledTerms<R> error = scaled_terms<S>(u.part[r], bells, power);
    ScaledTerms<R> rate = scaled_terms<S>(u_rate.part[r], bells, power);
    if constexpr (Power::even) {
      share.part[r] = R(1.0) / (error.sum * rate.sum);
    } else {  // products of two sums may overflow
      error.normalise();
      rate.normalise();
      share.part[r] = R(1.0);
    }
    output.part[r] = weights.output(r, error.mu, rate.mu) * share.part[r];
#pragma GCC unroll 7
    for (std::size_t k = 0; k < kTerms; ++k) {
      basis.error[k].part[r] = error.mu[k];
      basis.rate[k].part[r] = rate.mu[k];
    }
  }
}
/// For bells of any slope; out of line, so that the usual ones stay in registers.
template <class S>
[[gnu::noinline, gnu::cold]] void fire_at_any_slope(const Bells<S>& bells, const FuzzyStage<S>& weights,
                                                    const AxisVector<S>& u, const AxisVector<S>& u_rate,
                                                    FuzzyBasis<S>& basis, AxisVector<S>& share, AxisVector<S>& output) {
  fire_with(bells, AnyPower<S>{bells}, weights, u, u_rate, basis, share, output);
}
}  // namespace detail

/// All rules at the scaled inputs u, u-dot, which are limited to [-1, 1].
/// @param basis filled in place, since it is 84 numbers
/// @param share one over the sum of its 49 products, which makes it phi-bar; filled in
/// @param output tau_f of (13) [N; N m]; filled in
template <class S>
[[gnu::always_inline]] inline void fire(const Bells<S>& bells, const FuzzyStage<S>& weights, const AxisVector<S>& u,
                                        const AxisVector<S>& u_rate, FuzzyBasis<S>& basis, AxisVector<S>& share,
                                        AxisVector<S>& output) {
  if (bells.whole_slope == 2) [[likely]]
    detail::fire_with(bells, SquarePower{}, weights, u, u_rate, basis, share, output);
  else
    detail::fire_at_any_slope(bells, weights, u, u_rate, basis, share, output);
}

/// Output and adaptation at one instant: (13), and (22) with another driver.
///
/// Inline, since a law is evaluated in every stage.
/// @param u, u_rate scaled inputs, limited to [-1, 1] here
/// @param driver what drives the adaptation, chi-dot in (22) [m/s; rad/s]
/// @param rate filled in
/// @param output tau_f [N; N m]; filled in
template <class S>
[[gnu::always_inline]] inline void respond(const FuzzySystems<S>& systems, const FuzzyStage<S>& weights,
                                           const AxisVector<S>& u, const AxisVector<S>& u_rate,
                                           const AxisVector<S>& driver, FuzzyRate<S>& rate, AxisVector<S>& output) {
  AxisVector<S> share;
  fire(systems.bells, weights, u, u_rate, rate.basis, share, output);
  rate.strength = systems.inverse_adaptation * driver * share;
  if (systems.restrained) [[unlikely]] {
    const AxisVector<S> driven = driver, shared = share;  // copies, so that the others stay in registers
    output = restrain(systems, weights.scale, driven, shared, rate, AxisVector<S>(output));
  }
}

/// The end of a step: the weights advance by its stages, then leakage and limit act.
template <class S, std::size_t K>
void advance_systems(const FuzzySystems<S>& systems, FuzzyWeights<S>& weights,
                     const std::array<const FuzzyRate<S>*, K>& rates, const std::array<S, K>& scales,
                     const Mask<S>& active) {
  if (!systems.enabled) return;
  advance_weights(weights, rates, scales, active);
  if (systems.restrained) {
    S step{0.0};
    for (const S& scale : scales) step += scale;
    restrain(systems, step, weights, active);
  }
}

/// Checks that leakage is slow enough for a step to resolve it.
/// @param key what the scenario's keys start with, "controller.hybrid.fuzzy."
/// @param step of the integration, or period of the servo tick [s]
/// @throws std::invalid_argument naming the scenario key
void require_resolved(const FuzzyGains<double>& gains, const std::string& key, double step);

/// Checks a design as a user gives it.
/// @param key what the scenario's keys start with, "controller.hybrid.fuzzy."
/// @throws std::invalid_argument naming the scenario key: Psi below 1e-100, bell width or slope not
/// positive, bells too steep to normalise, anything not finite
void validate(const FuzzyGains<double>& gains, const std::string& key);

}  // namespace hexservo
