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

#include "hexservo/types.hpp"

#include <array>
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
  Vector6<S> dead_zone = Vector6<S>::Zero();                  ///< drivers within +- this teach nothing [m/s; rad/s], 0
  bool restrained = false;  ///< whether these three act: found out by `loop_parameters`, not to be set

  template <class F, class A, class B>
  static void visit(F&& f, A& a, B& b) {
    f(a.enabled, b.enabled);
    f(a.adaptation, b.adaptation);
    f(a.error_scale, b.error_scale);
    f(a.rate_scale, b.rate_scale);
    f(a.initial_scale, b.initial_scale);
    f(a.table, b.table);
    f(a.bell_width, b.bell_width);
    f(a.bell_slope, b.bell_slope);
    f(a.leakage, b.leakage);
    f(a.weight_limit, b.weight_limit);
    f(a.dead_zone, b.dead_zone);
    f(a.restrained, b.restrained);
  }
};

/// The six systems side by side: they have the same shape, so every line below works on all of them at once.
template <class S>
using AxisVector = Vector<S, kAxes>;

/// Strengths of the seven terms [1], each for the six systems.
template <class S>
using TermStrengths = std::array<AxisVector<S>, kTerms>;

/// x^s for x >= 0.
template <class S>
AxisVector<S> bell_power(const AxisVector<S>& x, double slope) {
  using std::pow;
  AxisVector<S> result;
  for (int j = 0; j < kAxes; ++j) result(j) = pow(x(j), slope);
  return result;
}
/// x^s for a whole s by multiplication: the default slope never calls `pow`.
template <int slope, class S>
AxisVector<S> bell_power(const AxisVector<S>& x) {
  AxisVector<S> result = x;
  for (int i = 1; i < slope; ++i) result = result.cwiseProduct(x);
  return result;
}

/// 1/mu_k(x) = 1 + |(x - c_k)/w|^(2s): what the generalised bells of the seven terms divide by.
template <class S>
TermStrengths<S> bell_denominators(const AxisVector<S>& x, const S& width, double slope) {
  const S inverse_width = S(1.0) / width;
  const auto bells = [&](auto power) {
    TermStrengths<S> d;
    for (int k = 0; k < kTerms; ++k) {
      const AxisVector<S> distance = (x.array() - S(term_centre(k))).matrix() * inverse_width;
      const AxisVector<S> raised = power(AxisVector<S>(distance.cwiseProduct(distance)));
      d[static_cast<std::size_t>(k)] = (raised.array() + S(1.0)).matrix();
    }
    return d;
  };
  if (slope == 1.0) return bells([](const AxisVector<S>& x2) { return bell_power<1, S>(x2); });
  if (slope == 2.0) return bells([](const AxisVector<S>& x2) { return bell_power<2, S>(x2); });
  if (slope == 3.0) return bells([](const AxisVector<S>& x2) { return bell_power<3, S>(x2); });
  return bells([slope](const AxisVector<S>& x2) { return bell_power<S>(x2, slope); });
}

/// Generalised bells mu_k(x) = 1/(1 + |(x - c_k)/w|^(2s)) of the seven terms.
template <class S>
TermStrengths<S> memberships(const AxisVector<S>& x, const S& width, double slope) {
  TermStrengths<S> mu = bell_denominators(x, width, slope);
  for (AxisVector<S>& strength : mu) strength = strength.cwiseInverse();
  return mu;
}

/// Memberships divided by their sum: one factor of phi-bar.
///
/// With d_k = 1/mu_k this is the product of the other six d over the sum of seven such products: one division in place
/// of eight. `validate` keeps bells so steep that the products overflow out of the core.
template <class S>
TermStrengths<S> normalised_memberships(const AxisVector<S>& x, const S& width, double slope) {
  const TermStrengths<S> d = bell_denominators(x, width, slope);
  TermStrengths<S> mu;
  AxisVector<S> product = d[0];  // of the denominators before k
  mu[1] = product;
  for (std::size_t k = 2; k < kTerms; ++k) {
    product = product.cwiseProduct(d[k - 1]);
    mu[k] = product;
  }
  product = d[kTerms - 1];  // of the denominators after k
  AxisVector<S> sum = mu[kTerms - 1];
  for (std::size_t k = kTerms - 2; k > 0; --k) {
    mu[k] = mu[k].cwiseProduct(product);
    sum += mu[k];
    product = product.cwiseProduct(d[k]);
  }
  mu[0] = product;
  const AxisVector<S> inverse_sum = (sum + product).cwiseInverse();
  for (AxisVector<S>& strength : mu) strength = strength.cwiseProduct(inverse_sum);
  return mu;
}

/// phi-bar of the six systems, as the two factors of its outer product.
template <class S>
struct FuzzyBasis {
  TermStrengths<S> error;  ///< normalised memberships of u
  TermStrengths<S> rate;   ///< normalised memberships of u-dot
};

/// phi-bar at the scaled inputs u, u-dot, which are limited to [-1, 1].
template <class S>
FuzzyBasis<S> fuzzy_basis(const FuzzyGains<S>& gains, const AxisVector<S>& u, const AxisVector<S>& u_rate) {
  const auto limited = [](const AxisVector<S>& x) {
    AxisVector<S> out;
    for (int j = 0; j < kAxes; ++j) out(j) = clip(x(j), S(-1.0), S(1.0));
    return out;
  };
  return {normalised_memberships(limited(u), gains.bell_width, gains.bell_slope),
          normalised_memberships(limited(u_rate), gains.bell_width, gains.bell_slope)};
}

/// The basis of systems that are switched off: no output and no adaptation.
template <class S>
FuzzyBasis<S> zero_basis() {
  FuzzyBasis<S> basis;
  basis.error.fill(AxisVector<S>::Zero());
  basis.rate.fill(AxisVector<S>::Zero());
  return basis;
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

/// omega(0) = s_0 times the rule table [N; N m].
template <class S>
FuzzyWeights<S> initial_weights(const FuzzyGains<S>& gains) {
  FuzzyWeights<S> weights;
  for (int row = 0; row < kTerms; ++row)
    for (int column = 0; column < kTerms; ++column)
      weights[rule(row, column)] = gains.initial_scale * gains.table(row, column);
  return weights;
}

/// Time derivative of the weights, of rank one for each axis: strength * basis.error * basis.rate^T.
template <class S>
struct FuzzyRate {
  FuzzyBasis<S> basis;
  AxisVector<S> strength;  ///< chi-dot_j/Psi_j of (22)
};

/// Weights inside a Runge-Kutta stage: the step's weights plus `scale` times the previous stage's rate, never formed.
template <class S>
struct FuzzyStage {
  const FuzzyWeights<S>* weights;
  const FuzzyRate<S>* rate = nullptr;  ///< null at the start of a step
  S scale{0.0};                        ///< [s]

  /// tau_f = mu(u)^T W mu(u-dot) of the six systems, (13) [N; N m].
  AxisVector<S> output(const FuzzyBasis<S>& basis) const {
    AxisVector<S> result = AxisVector<S>::Zero();
    for (int column = 0; column < kTerms; ++column) {
      AxisVector<S> sum = AxisVector<S>::Zero();
      for (int row = 0; row < kTerms; ++row)
        sum += basis.error[static_cast<std::size_t>(row)].cwiseProduct((*weights)[rule(row, column)]);
      result += sum.cwiseProduct(basis.rate[static_cast<std::size_t>(column)]);
    }
    if (rate != nullptr) {
      const AxisVector<S> overlap =
          inner(basis.error, rate->basis.error).cwiseProduct(inner(basis.rate, rate->basis.rate));
      result += scale * rate->strength.cwiseProduct(overlap);
    }
    return result;
  }

 private:
  static AxisVector<S> inner(const TermStrengths<S>& a, const TermStrengths<S>& b) {
    AxisVector<S> sum = a[0].cwiseProduct(b[0]);
    for (std::size_t k = 1; k < kTerms; ++k) sum += a[k].cwiseProduct(b[k]);
    return sum;
  }
};

/// W += sum over stages of scale_k * rate_k: the end of a step, one update of rank K.
/// @param active lanes that take part; the others keep their weights
template <class S, std::size_t K>
void advance_weights(FuzzyWeights<S>& weights, const std::array<const FuzzyRate<S>*, K>& rates,
                     const std::array<S, K>& scales, const Mask<S>& active) {
  std::array<TermStrengths<S>, K> left;
  std::array<const TermStrengths<S>*, K> right;
  for (std::size_t k = 0; k < K; ++k) {
    const AxisVector<S> factor = scales[k] * rates[k]->strength;
    for (std::size_t term = 0; term < kTerms; ++term) left[k][term] = factor.cwiseProduct(rates[k]->basis.error[term]);
    right[k] = &rates[k]->basis.rate;
  }
  std::array<TermStrengths<S>, K> masked;
  if constexpr (std::is_same_v<Mask<S>, bool>) {
    if (!active) return;
  } else {
    const AxisVector<S> zero = AxisVector<S>::Zero();
    for (std::size_t k = 0; k < K; ++k) {
      for (std::size_t term = 0; term < kTerms; ++term) {
        left[k][term] = select(active, left[k][term], zero);
        masked[k][term] = select(active, (*right[k])[term], zero);
      }
      right[k] = &masked[k];
    }
  }
  for (std::size_t column = 0; column < kTerms; ++column) {
    std::array<AxisVector<S>, K> rate;
    for (std::size_t k = 0; k < K; ++k) rate[k] = (*right[k])[column];
#pragma GCC unroll 7
    for (std::size_t row = 0; row < kTerms; ++row) {
      AxisVector<S> sum = left[0][row].cwiseProduct(rate[0]);
      for (std::size_t k = 1; k < K; ++k) sum += left[k][row].cwiseProduct(rate[k]);
      weights[rule(static_cast<int>(row), static_cast<int>(column))] += sum;
    }
  }
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

/// Leakage and dead zone inside a stage: omega-dot_j = d(driver_j) phi-bar_j/Psi_j - sigma_j omega_j.
///
/// With V = exp(sigma t) W, t from the start of the step, V-dot = exp(sigma t) (rank one): the stage stays of rank one.
/// So `rate` becomes that of V, and the output that of W = exp(-sigma t) V.
/// @param elapsed t [s]
/// @param driver what drives the adaptation, chi-dot in (22) [m/s; rad/s]
template <class S>
void restrain(const FuzzyGains<S>& gains, const S& elapsed, const Vector6<S>& driver, FuzzyRate<S>& rate,
              AxisVector<S>& output) {
  using std::exp;
  for (int j = 0; j < kAxes; ++j) {
    const S growth = exp(S(gains.leakage(j) * elapsed));
    const S driven = driver(j) - clip(driver(j), S(-gains.dead_zone(j)), gains.dead_zone(j));
    rate.strength(j) = driven / gains.adaptation(j) * growth;
    output(j) /= growth;
  }
}

/// Leakage and limit at the end of a step: from V back to W, each weight then projected on its interval.
/// @param step length of the step [s]
/// @param active lanes that take part; the others keep their weights
template <class S>
void restrain(const FuzzyGains<S>& gains, const S& step, FuzzyWeights<S>& weights, const Mask<S>& active) {
  using std::exp;
  AxisVector<S> growth;
  for (int j = 0; j < kAxes; ++j) growth(j) = exp(S(gains.leakage(j) * step));
  for (AxisVector<S>& weight : weights)
    for (int j = 0; j < kAxes; ++j) {
      const S& limit = gains.weight_limit(j);
      weight(j) = select(active, clip(S(weight(j) / growth(j)), S(-limit), limit), weight(j));
    }
}

/// Checks that leakage is slow enough for a step to resolve it.
/// @param key what the scenario's keys start with, "controller.hybrid.fuzzy."
/// @param step of the integration, or period of the servo tick [s]
/// @throws std::invalid_argument naming the scenario key
void require_resolved(const FuzzyGains<double>& gains, const std::string& key, double step);

/// Checks a design as a user gives it.
/// @param key what the scenario's keys start with, "controller.hybrid.fuzzy."
/// @throws std::invalid_argument naming the scenario key: Psi, bell width or slope not positive, bells too steep to
/// normalise, anything not finite
void validate(const FuzzyGains<double>& gains, const std::string& key);

}  // namespace hexservo
