// The fuzzy systems of (13) and (22): memberships, factorised basis, rule table, rank-one stages.
#include "hexservo/fuzzy.hpp"

#include "compare.hpp"
#include "laws.hpp"
#include "random.hpp"

#include <algorithm>
#include <string>
#include <vector>

using namespace hexservo;
using namespace hexservo::test;

namespace {

/// The default design with a given bell; slopes that are not whole go through pow.
FuzzyGains<double> design(double width = 1.0 / 6.0, double slope = 2.0) {
  FuzzyGains<double> gains;
  gains.bell_width = width;
  gains.bell_slope = slope;
  return gains;
}

/// A generalised bell, written out.
double bell(double x, int term, double width, double slope) {
  const double centre = -1.0 + term / 3.0;
  return 1.0 / (1.0 + std::pow(std::abs((x - centre) / width), 2.0 * slope));
}

/// (13) of one system as the paper prints it: 49 rules, each a product of two bells, normalised by the sum of all.
double literal_output(const Matrix7<double>& W, double u, double u_rate, double width, double slope) {
  double weighted = 0.0, sum = 0.0;
  for (int row = 0; row < 7; ++row)
    for (int column = 0; column < 7; ++column) {
      const double strength = bell(u, row, width, slope) * bell(u_rate, column, width, slope);
      weighted += W(row, column) * strength;
      sum += strength;
    }
  return weighted / sum;
}

FuzzyWeights<double> random_weights(Random& random) {
  FuzzyWeights<double> weights;
  for (AxisVector<double>& w : weights) w = Vector6<double>(random.matrix<6>());
  return weights;
}

/// tau_f of a stage at inputs.
Vector6<double> output_of(const FuzzyStage<double>& stage, const FuzzyGains<double>& gains, const Vector6<double>& u,
                          const Vector6<double>& u_rate) {
  FuzzyBasis<double> basis;
  AxisVector<double> share, output;
  fire<double>(Bells<double>(gains.bell_width, gains.bell_slope), stage, u, u_rate, basis, share, output);
  return output.vector();
}
Vector6<double> output_of(const FuzzyWeights<double>& weights, const FuzzyGains<double>& gains,
                          const Vector6<double>& u, const Vector6<double>& u_rate) {
  return output_of(FuzzyStage<double>{&weights}, gains, u, u_rate);
}

/// The normalised factors of phi-bar, and the share that makes it of the basis which is stored.
struct NormalisedBasis {
  FuzzyBasis<double> basis;
  AxisVector<double> share;
};
NormalisedBasis basis_and_share(const FuzzyGains<double>& gains, const Vector6<double>& u,
                                const Vector6<double>& u_rate) {
  const FuzzyWeights<double> none{};
  FuzzyBasis<double> basis;
  AxisVector<double> share, output;
  fire<double>(Bells<double>(gains.bell_width, gains.bell_slope), FuzzyStage<double>{&none}, u, u_rate, basis, share,
               output);
  return {{normalised(basis.error), normalised(basis.rate)}, share * sum_of(basis.error) * sum_of(basis.rate)};
}
FuzzyBasis<double> basis_at(const FuzzyGains<double>& gains, const Vector6<double>& u, const Vector6<double>& u_rate) {
  return basis_and_share(gains, u, u_rate).basis;
}

FuzzyRate<double> random_rate(const FuzzyGains<double>& gains, Random& random) {
  const FuzzyBasis<double> basis = basis_at(gains, random.matrix<6>(), random.matrix<6>());
  return {basis, Vector6<double>(random.matrix<6>())};
}

/// Normalised memberships at numbers.
TermStrengths<double> normalised_at(const Vector6<double>& x, double width, double slope) {
  FuzzyGains<double> gains;
  gains.bell_width = width;
  gains.bell_slope = slope;
  return basis_at(gains, x, x).error;
}

/// Weights plus scale times a rate, rule by rule: what a stage never forms.
void add(FuzzyWeights<double>& weights, const FuzzyRate<double>& rate, double scale) {
  for (int row = 0; row < 7; ++row)
    for (int column = 0; column < 7; ++column)
      for (int axis = 0; axis < 6; ++axis)
        weights[rule(row, column)].set(
            axis, weights[rule(row, column)](axis) + scale * rate.strength(axis) *
                                                         rate.basis.error[static_cast<std::size_t>(row)](axis) *
                                                         rate.basis.rate[static_cast<std::size_t>(column)](axis));
}

double distance(const FuzzyWeights<double>& a, const FuzzyWeights<double>& b) {
  double largest = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) largest = std::max(largest, hexservo::test::distance(a[i], b[i]));
  return largest;
}
using hexservo::test::distance;

struct Bell {
  double width, slope;
};
constexpr Bell kBells[] = {{1.0 / 6.0, 2.0}, {0.25, 1.0}, {0.1, 3.0}, {0.3, 8.0}, {0.2, 1.5}, {0.2, 0.7}, {0.3, 9.0}};

}  // namespace

TEST_CASE("memberships are the bells, whole slopes by multiplication and others by pow") {
  Random random(7601);
  CAPTURE(random.seed());
  for (const auto& [width, slope] : kBells)
    for (int trial = 0; trial < 50; ++trial) {
      CAPTURE(width);
      CAPTURE(slope);
      const Vector6<double> x = random.matrix<6>(1.2);
      const TermStrengths<double> mu = memberships<double>(x, Bells<double>(width, slope));
      for (int k = 0; k < 7; ++k)
        for (int j = 0; j < 6; ++j)
          // a power of 2s amplifies a rounding of its argument 2s-fold, and pow and the product each add their own
          CHECK(mu[static_cast<std::size_t>(k)](j) ==
                doctest::Approx(bell(x(j), k, width, slope)).epsilon(10.0 * (slope + 1.0) * kEpsilon));
    }
}

TEST_CASE("a bell is 1 at its own centre, 1/2 one width away, symmetric, and falls with the distance") {
  for (int k = 0; k < 7; ++k) {
    CAPTURE(k);
    const auto term = static_cast<std::size_t>(k);
    const auto at = [&](double x, const Bell& b) {
      return memberships<double>(Vector6<double>(Vector6<double>::Constant(x)),
                                 Bells<double>(b.width, b.slope))[term](0);
    };
    for (const Bell& b : kBells) {
      CHECK(at(term_centre(k), b) == 1.0);
      CHECK(at(term_centre(k) + b.width, b) == doctest::Approx(0.5).epsilon(1e-13));
      CHECK(at(term_centre(k) - b.width, b) == doctest::Approx(0.5).epsilon(1e-13));
      double previous = 1.0;
      for (const double offset : {0.01, 0.1, 0.3, 0.7, 1.5}) {
        CHECK(at(term_centre(k) + offset, b) == doctest::Approx(at(term_centre(k) - offset, b)).epsilon(1e-12));
        CHECK(at(term_centre(k) + offset, b) <= previous);
        previous = at(term_centre(k) + offset, b);
      }
    }
    CHECK(term_centre(k) == doctest::Approx(-1.0 + k / 3.0).epsilon(kEpsilon));
    CHECK(term_centre(k) == -term_centre(6 - k));
  }
}

TEST_CASE("mirror symmetry: the term NB of x is the term PB of -x, and so on") {
  Random random(7603);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 50; ++trial) {
    const Vector6<double> x = random.matrix<6>();
    const TermStrengths<double> here = normalised_at(x, 1.0 / 6.0, 2.0);
    const TermStrengths<double> there = normalised_at(-x, 1.0 / 6.0, 2.0);
    for (std::size_t k = 0; k < 7; ++k) CHECK(distance(here[k], there[6 - k]) <= 20.0 * kEpsilon);
  }
}

TEST_CASE("partition of unity: the 49 rule strengths are positive and sum to one") {
  Random random(7604);
  CAPTURE(random.seed());
  for (const auto& [width, slope] : kBells)
    for (int trial = 0; trial < 50; ++trial) {
      const auto [basis, share] = basis_and_share(design(width, slope), random.matrix<6>(1.5), random.matrix<6>(1.5));
      CHECK(distance(share.vector(), Vector6<double>::Ones()) <= 50.0 * kEpsilon);
      Vector6<double> sum = Vector6<double>::Zero();
      for (std::size_t row = 0; row < 7; ++row)
        for (std::size_t column = 0; column < 7; ++column) {
          const Vector6<double> strength = (basis.error[row] * basis.rate[column]).vector();
          CHECK(strength.minCoeff() > 0.0);
          sum += strength;
        }
      CHECK(distance(sum, Vector6<double>::Ones()) <= 50.0 * kEpsilon);
    }
}

TEST_CASE("the factorised output is the literal sum over 49 rules (13), for each of the six systems") {
  Random random(7605);
  CAPTURE(random.seed());
  for (const auto& [width, slope] : kBells)
    for (int trial = 0; trial < 50; ++trial) {
      CAPTURE(width);
      CAPTURE(slope);
      const FuzzyWeights<double> weights = random_weights(random);
      const Vector6<double> u = random.matrix<6>(), u_rate = random.matrix<6>();
      const Vector6<double> output = output_of(weights, design(width, slope), u, u_rate);
      for (int axis = 0; axis < 6; ++axis) {
        const double expected = literal_output(weight_matrix(weights, axis), u(axis), u_rate(axis), width, slope);
        CHECK(std::abs(output(axis) - expected) <= 20.0 * (slope + 2.0) * kEpsilon);  // weights are at most 1
      }
    }
}

TEST_CASE("a system with equal weights gives that weight, whatever its inputs") {
  Random random(7606);
  CAPTURE(random.seed());
  FuzzyWeights<double> weights;
  const Vector6<double> value = random.matrix<6>();
  weights.fill(value);
  for (int trial = 0; trial < 20; ++trial) {
    const Vector6<double> output = output_of(weights, design(), random.matrix<6>(3.0), random.matrix<6>(3.0));
    CHECK(distance(output, value) <= 50.0 * kEpsilon);
  }
}

TEST_CASE("inputs beyond +-1 count as +-1, inputs within are not changed") {
  Random random(7607);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 50; ++trial) {
    const Vector6<double> u = random.matrix<6>(4.0), u_rate = random.matrix<6>(4.0);
    const FuzzyBasis<double> basis = basis_at(design(), u, u_rate);
    const FuzzyBasis<double> limited =
        basis_at(design(), u.cwiseMax(-1.0).cwiseMin(1.0), u_rate.cwiseMax(-1.0).cwiseMin(1.0));
    for (std::size_t k = 0; k < 7; ++k) {
      CHECK(distance(basis.error[k], limited.error[k]) == 0.0);
      CHECK(distance(basis.rate[k], limited.rate[k]) == 0.0);
    }
  }
}

TEST_CASE("the linear table is MacVicar-Whelan's: term numbers add up and stop at NB and PB") {
  const Matrix7<double> table = linear_rule_table();
  for (int row = -3; row <= 3; ++row)
    for (int column = -3; column <= 3; ++column)
      CHECK(table(row + 3, column + 3) == doctest::Approx(std::clamp(row + column, -3, 3) / 3.0).epsilon(kEpsilon));
  CHECK(table == table.transpose());
  CHECK(table.reverse() == -table);
}

TEST_CASE("a custom table is data: weights start at s_0 times it, for each system with its own s_0") {
  Random random(7608);
  CAPTURE(random.seed());
  FuzzyGains<double> gains = design();
  gains.table = random.matrix<7, 7>();
  gains.initial_scale = random.matrix<6>();
  const FuzzyWeights<double> weights = initial_weights(gains);
  for (int axis = 0; axis < 6; ++axis) CHECK(weight_matrix(weights, axis) == gains.initial_scale(axis) * gains.table);
  gains.initial_scale.setZero();
  for (const AxisVector<double>& w : initial_weights(gains)) CHECK(w.vector().isZero(0.0));
}

TEST_CASE("the default table makes tau_f an odd function that grows with both inputs") {
  FuzzyGains<double> gains = design();
  gains.initial_scale.setOnes();
  const FuzzyWeights<double> weights = initial_weights(gains);
  const auto output = [&](double u, double u_rate) {
    return output_of(weights, gains, Vector6<double>::Constant(u), Vector6<double>::Constant(u_rate))(2);
  };
  CHECK(std::abs(output(0.0, 0.0)) <= 10.0 * kEpsilon);
  for (const double u : {0.1, 0.4, 0.9}) {
    CHECK(output(u, 0.2) == doctest::Approx(-output(-u, -0.2)).epsilon(1e-13));
    CHECK(output(u, 0.0) > 0.0);
    CHECK(output(0.0, u) > 0.0);
    CHECK(output(u, 0.0) == doctest::Approx(output(0.0, u)).epsilon(1e-13));
  }
  CHECK(output(0.6, 0.0) > output(0.3, 0.0));
}

TEST_CASE("rank-one stages: the output with a rate is the output of weights to which the rate was added") {
  Random random(7609);
  CAPTURE(random.seed());
  const FuzzyGains<double> gains = design();
  for (int trial = 0; trial < 100; ++trial) {
    CAPTURE(trial);
    const FuzzyWeights<double> weights = random_weights(random);
    const FuzzyRate<double> rate = random_rate(gains, random);
    const double scale = random.uniform(-1.0, 1.0);
    FuzzyWeights<double> added = weights;
    add(added, rate, scale);
    const Vector6<double> u = random.matrix<6>(), u_rate = random.matrix<6>();
    CHECK(distance(output_of(FuzzyStage<double>{&weights, &rate, scale}, gains, u, u_rate),
                   output_of(added, gains, u, u_rate)) <= 50.0 * kEpsilon);
  }
}

TEST_CASE("advance_weights adds all rates, rule by rule, and nothing where a lane is not active") {
  Random random(7610);
  CAPTURE(random.seed());
  const FuzzyGains<double> gains = design();
  for (int trial = 0; trial < 50; ++trial) {
    CAPTURE(trial);
    FuzzyWeights<double> weights = random_weights(random);
    const FuzzyWeights<double> before = weights;
    std::array<FuzzyRate<double>, 4> rates = {random_rate(gains, random), random_rate(gains, random),
                                              random_rate(gains, random), random_rate(gains, random)};
    std::array<const FuzzyRate<double>*, 4> pointers;
    std::array<double, 4> scales;
    FuzzyWeights<double> expected = weights;
    for (std::size_t i = 0; i < 4; ++i) {
      pointers[i] = &rates[i];
      scales[i] = random.uniform(-1.0, 1.0);
      add(expected, rates[i], scales[i]);
    }
    advance_weights(weights, pointers, scales, true);
    CHECK(distance(weights, expected) <= 20.0 * kEpsilon);

    FuzzyWeights<double> still = before;
    for (FuzzyRate<double>& rate : rates) rate.strength = Vector6<double>(Vector6<double>::Constant(kNaN));
    advance_weights(still, pointers, scales, false);
    CHECK(distance(still, before) == 0.0);
  }
}

TEST_CASE("in a pack each lane has its own weights, and a frozen lane keeps them even beside NaN") {
  Random random(7611);
  CAPTURE(random.seed());
  using S = Lanes<4>;
  const FuzzyGains<double> gains = design();
  FuzzyWeights<S> pack;
  std::array<FuzzyWeights<double>, 4> weights_of;
  FuzzyRate<S> rate;
  std::array<FuzzyRate<double>, 4> rate_of;
  for (int lane = 0; lane < 4; ++lane) {
    const auto i = static_cast<std::size_t>(lane);
    weights_of[i] = random_weights(random);
    rate_of[i] = random_rate(gains, random);
    if (lane == 2) rate_of[i].strength = Vector6<double>(Vector6<double>::Constant(kNaN));
    const auto put = [lane](AxisVector<S>& to, const AxisVector<double>& from) {
      for (int j = 0; j < 6; ++j) to.part[static_cast<std::size_t>(j)].set(lane, from(j));
    };
    for (std::size_t r = 0; r < pack.size(); ++r) put(pack[r], weights_of[i][r]);
    put(rate.strength, rate_of[i].strength);
    for (std::size_t k = 0; k < 7; ++k) {
      put(rate.basis.error[k], rate_of[i].basis.error[k]);
      put(rate.basis.rate[k], rate_of[i].basis.rate[k]);
    }
  }
  S decider = 1.0;
  decider.set(2, 0.0);
  advance_weights(pack, std::array<const FuzzyRate<S>*, 1>{&rate}, std::array<S, 1>{S(0.3)}, decider > S(0.5));
  for (int lane = 0; lane < 4; ++lane) {
    CAPTURE(lane);
    const auto i = static_cast<std::size_t>(lane);
    if (lane != 2) add(weights_of[i], rate_of[i], 0.3);
    for (std::size_t r = 0; r < pack.size(); ++r)
      CHECK(distance(lane_of(pack[r], lane), weights_of[i][r].vector()) <= (lane == 2 ? 0.0 : 4.0 * kEpsilon));
  }
}

TEST_CASE("NaN in either input never comes out as a number, and stays in its own system") {
  Random random(7612);
  CAPTURE(random.seed());
  const FuzzyWeights<double> weights = random_weights(random);
  for (const auto& [width, slope] : kBells)
    for (int axis = 0; axis < 6; ++axis)
      for (const bool in_rate : {false, true}) {
        Vector6<double> u = random.matrix<6>(), u_rate = random.matrix<6>();
        (in_rate ? u_rate : u)(axis) = kNaN;
        const Vector6<double> output = output_of(weights, design(width, slope), u, u_rate);
        for (int j = 0; j < 6; ++j) CHECK(std::isnan(output(j)) == (j == axis));
      }
}

TEST_CASE("bells are either refused as too steep, or give a partition of unity everywhere, also between the centres") {
  int refused = 0, accepted = 0;
  std::vector<double> widths = {1e308, 1e200, 1e77};
  for (double width = 10.0; width > 1e-12; width /= 3.0) widths.push_back(width);
  for (const double slope : {0.5, 1.0, 2.0, 2.5, 8.0, 16.0})
    for (const double width : widths) {
      CAPTURE(slope);
      CAPTURE(width);
      const FuzzyGains<double> gains = design(width, slope);
      const std::string verdict = refusal([&] { validate(gains, "controller.hybrid.fuzzy."); });
      if (verdict != "(accepted)") {
        ++refused;
        CHECK(is_about(verdict, "controller.hybrid.fuzzy.bell_width"));
        continue;
      }
      ++accepted;
      for (const double x : {-1.0, -0.5, 0.0, 1e-9, 1.0 / 6.0, 0.5, 0.99, 1.0}) {
        const FuzzyBasis<double> basis = basis_at(gains, Vector6<double>::Constant(x), Vector6<double>::Constant(-x));
        Vector6<double> sum = Vector6<double>::Zero(), sum_rate = sum;
        for (std::size_t k = 0; k < 7; ++k) {
          sum += basis.error[k].vector();
          sum_rate += basis.rate[k].vector();
        }
        CHECK(distance(sum, Vector6<double>::Ones()) <= 50.0 * kEpsilon);
        CHECK(distance(sum_rate, Vector6<double>::Ones()) <= 50.0 * kEpsilon);
      }
    }
  CHECK(refused > 0);
  CHECK(accepted > 20);
}

TEST_CASE("an adaptation whose inverse would overflow what it multiplies is refused") {
  FuzzyGains<double> gains;
  for (const double bad : {5e-324, 1e-300, 1e-101}) {
    gains.adaptation(4) = bad;
    CHECK(is_about(refusal([&] { validate(gains, "controller.hybrid.fuzzy."); }),
                   "controller.hybrid.fuzzy.adaptation[4]"));
  }
}

TEST_CASE("designs that make no sense are refused, with the key and the place") {
  const auto verdict = [](auto&& change) {
    FuzzyGains<double> gains;
    change(gains);
    return refusal([&] { validate(gains, "controller.hybrid.fuzzy."); });
  };
  const std::string key = "controller.hybrid.fuzzy.";
  CHECK(verdict([](FuzzyGains<double>&) {}) == "(accepted)");
  for (const double bad : {kNaN, kInfinity, -kInfinity, 0.0, -1.0}) {
    CAPTURE(bad);
    for (int j = 0; j < 6; ++j)
      CHECK(is_about(verdict([&](FuzzyGains<double>& g) { g.adaptation(j) = bad; }),
                     key + "adaptation[" + std::to_string(j) + "]"));
    CHECK(is_about(verdict([&](FuzzyGains<double>& g) { g.bell_width = bad; }), key + "bell_width"));
    CHECK(is_about(verdict([&](FuzzyGains<double>& g) { g.bell_slope = bad; }), key + "bell_slope"));
    if (std::isfinite(bad)) continue;
    for (int j = 0; j < 6; ++j) {
      const std::string place = "[" + std::to_string(j) + "]";
      CHECK(is_about(verdict([&](FuzzyGains<double>& g) { g.error_scale(j) = bad; }), key + "error_scale" + place));
      CHECK(is_about(verdict([&](FuzzyGains<double>& g) { g.rate_scale(j) = bad; }), key + "rate_scale" + place));
      CHECK(is_about(verdict([&](FuzzyGains<double>& g) { g.initial_scale(j) = bad; }), key + "initial_scale" + place));
      CHECK(is_about(verdict([&](FuzzyGains<double>& g) { g.table(j, 6) = bad; }), key + "table" + place + "[6]"));
    }
  }
}

// ---- Options of the adaptation --------------------------------------------------------------------------------------

namespace {

const AxisVector<double> kOne = Vector6<double>(Vector6<double>::Ones());  // share of a normalised basis

/// One Runge-Kutta step of W-dot = strength phi-bar - sigma W with a driver that depends on time, as a loop takes it.
template <class Driver>
void restrained_step(const FuzzySystems<double>& systems, const FuzzyBasis<double>& basis, double t, double h,
                     Driver&& driver, FuzzyWeights<double>& weights) {
  std::array<FuzzyRate<double>, 4> k;
  const std::array<double, 4> times = {0.0, 0.5 * h, 0.5 * h, h};
  for (std::size_t i = 0; i < 4; ++i) {
    k[i].basis = basis;
    restrain<double>(systems, times[i], Vector6<double>(driver(t + times[i])), kOne, k[i], AxisVector<double>::Zero());
  }
  advance_weights<double, 4>(weights, {&k[0], &k[1], &k[2], &k[3]}, {h / 6.0, h / 3.0, h / 3.0, h / 6.0}, true);
  restrain(systems, h, weights, true);
}

}  // namespace

TEST_CASE("leakage: weights follow W-dot = d(driver) phi-bar/Psi - sigma W to fourth order, and decay exactly alone") {
  Random random(4410);
  CAPTURE(random.seed());
  FuzzyGains<double> gains;
  gains.adaptation = random.matrix<6>(4.0) + Vector6<double>::Constant(5.0);
  gains.leakage << 0.0, 0.5, 1.0, 2.0, 5.0, 10.0;
  const FuzzyBasis<double> basis = basis_at(gains, random.matrix<6>(), random.matrix<6>());
  FuzzyWeights<double> start;
  for (auto& w : start) w = Vector6<double>(random.six(1e-2, 1e-3));

  const FuzzySystems<double> systems(gains);
  FuzzyWeights<double> alone = start;
  for (int i = 0; i < 10; ++i)
    restrained_step(systems, basis, 0.0, 0.1, [](double) { return Vector6<double>::Zero(); }, alone);
  for (std::size_t r = 0; r < start.size(); ++r)
    for (int j = 0; j < 6; ++j)
      CHECK(alone[r](j) == doctest::Approx(start[r](j) * std::exp(-gains.leakage(j))).epsilon(1e-13));

  // driver cos(3 t): W(1) = e^-s W(0) + strength (s cos 3 + 3 sin 3 - s e^-s)/(s^2 + 9)
  const auto error_of = [&](int steps) {
    FuzzyWeights<double> weights = start;
    const double h = 1.0 / steps;
    for (int i = 0; i < steps; ++i)
      restrained_step(
          systems, basis, i * h, h, [](double t) { return Vector6<double>::Constant(std::cos(3.0 * t)); }, weights);
    double error = 0.0;
    for (int row = 0; row < 7; ++row)
      for (int column = 0; column < 7; ++column)
        for (int j = 0; j < 6; ++j) {
          const double s = gains.leakage(j), decay = std::exp(-s);
          const double phi = basis.error[static_cast<std::size_t>(row)](j) *
                             basis.rate[static_cast<std::size_t>(column)](j) / gains.adaptation(j);
          const double exact = decay * start[rule(row, column)](j) +
                               phi * (s * std::cos(3.0) + 3.0 * std::sin(3.0) - s * decay) / (s * s + 9.0);
          error = std::max(error, std::abs(weights[rule(row, column)](j) - exact));
        }
    return error;
  };
  const double coarse = error_of(20), fine = error_of(40);
  CHECK(fine < 1e-7);
  CHECK(std::log2(coarse / fine) == doctest::Approx(4.0).epsilon(0.05));
}

TEST_CASE("leakage inside a stage: the output is that of weights that have decayed since the start of the step") {
  Random random(4411);
  CAPTURE(random.seed());
  FuzzyGains<double> gains;
  gains.leakage = random.matrix<6>(2.0).cwiseAbs();
  FuzzyWeights<double> weights;
  for (auto& w : weights) w = Vector6<double>(random.six(1e-2, 1e-3));
  const FuzzyBasis<double> before = basis_at(gains, random.matrix<6>(), random.matrix<6>());
  const Vector6<double> u = random.matrix<6>(), u_rate = random.matrix<6>();
  const FuzzyBasis<double> basis = basis_at(gains, u, u_rate);
  const Vector6<double> driver = random.six(0.02, 0.1);
  const double since = 0.05, elapsed = 0.1;  // the previous stage, and this one

  const FuzzySystems<double> systems(gains);
  FuzzyRate<double> rate{before, {}};
  restrain<double>(systems, since, driver, kOne, rate, AxisVector<double>::Zero());
  FuzzyRate<double> own;
  AxisVector<double> output;
  respond<double>(systems, {&weights, &rate, elapsed}, u, u_rate, driver, own, output);

  for (int j = 0; j < 6; ++j) {
    const double decay = std::exp(-gains.leakage(j) * elapsed);
    const double decay_of_rate = std::exp(-gains.leakage(j) * (elapsed - since));
    double expected = 0.0;
    for (int row = 0; row < 7; ++row)
      for (int column = 0; column < 7; ++column) {
        const auto r = static_cast<std::size_t>(row), c = static_cast<std::size_t>(column);
        const double weight = decay * weights[rule(row, column)](j) + elapsed * decay_of_rate * driver(j) /
                                                                          gains.adaptation(j) * before.error[r](j) *
                                                                          before.rate[c](j);
        expected += weight * basis.error[r](j) * basis.rate[c](j);
      }
    CHECK(output(j) == doctest::Approx(expected).epsilon(1e-12));
  }
}

TEST_CASE("dead zone: a driver within it changes no weight, one beyond it acts by its excess, without a jump") {
  FuzzyGains<double> gains;
  gains.dead_zone << 0.01, 0.02, 0.03, 0.1, 0.2, 0.0;
  const auto strength = [&](const Vector6<double>& driver) {
    FuzzyRate<double> rate{};
    restrain<double>(FuzzySystems<double>(gains), 1e-3, driver, kOne, rate, AxisVector<double>::Zero());
    return Vector6<double>(rate.strength.vector().cwiseProduct(gains.adaptation));
  };
  for (const double sign : {-1.0, 1.0}) {
    CHECK(strength(sign * gains.dead_zone).isZero(0.0));
    CHECK(strength(sign * 0.5 * gains.dead_zone).isZero(0.0));
    CHECK(distance(strength(sign * 3.0 * gains.dead_zone), sign * 2.0 * gains.dead_zone) <= 1e-16);
    CHECK(strength(Vector6<double>::Constant(sign))(5) == sign);  // no zone
  }
  CHECK(strength(Vector6<double>::Constant(kNaN)).array().isNaN().all());
}

TEST_CASE("projection: the weights of the start are those of the table within the limit, in every lane") {
  FuzzyGains<double> gains;
  gains.initial_scale << 0.05, -0.05, 0.002, 0.0, 1e-4, 0.3;
  const FuzzyWeights<double> free = initial_weights(gains);
  gains.weight_limit << 0.01, 0.02, 0.01, 1e-4, kInfinity, kInfinity;
  const FuzzyWeights<double> weights = initial_weights(gains);
  double largest = 0.0;
  for (std::size_t r = 0; r < weights.size(); ++r)
    for (int j = 0; j < 6; ++j) {
      CHECK(weights[r](j) == std::clamp(free[r](j), -gains.weight_limit(j), gains.weight_limit(j)));
      largest = std::max(largest, std::abs(free[r](j)) / gains.weight_limit(j));
    }
  CHECK(largest > 1.0);
}

TEST_CASE("projection: no weight, and so no output, is beyond its limit after a step; the others are untouched") {
  Random random(4412);
  CAPTURE(random.seed());
  FuzzyGains<double> gains;
  CHECK_FALSE(has_restraint(gains));
  gains.weight_limit << 1e-3, 2e-3, 3e-3, 1e-4, 2e-4, kInfinity;
  CHECK(has_restraint(gains));
  FuzzyWeights<double> weights;
  for (auto& w : weights) w = Vector6<double>(random.six(5e-3, 5e-4));
  FuzzyWeights<double> limited = weights;
  const FuzzySystems<double> systems(gains);
  CHECK(systems.restrained);
  restrain(systems, 1e-3, limited, true);
  for (std::size_t r = 0; r < weights.size(); ++r)
    for (int j = 0; j < 6; ++j)
      CHECK(limited[r](j) == std::clamp(weights[r](j), -gains.weight_limit(j), gains.weight_limit(j)));
  const Vector6<double> output = output_of(limited, gains, random.matrix<6>(), random.matrix<6>());
  CHECK(((output.cwiseAbs() - gains.weight_limit).array() <= 0.0).all());
  FuzzyWeights<double> idle = weights;
  restrain(systems, 1e-3, idle, false);
  for (std::size_t r = 0; r < weights.size(); ++r) CHECK(distance(idle[r], weights[r]) == 0.0);
}

TEST_CASE(
    "options of the adaptation in the lanes of a pack: each lane has its own, and an idle one keeps its weights") {
  Random random(4413);
  CAPTURE(random.seed());
  using S = Lanes<4>;
  FuzzyGains<S> pack;
  std::array<FuzzyGains<double>, 4> single;
  FuzzyWeights<S> weights;
  std::array<FuzzyWeights<double>, 4> start;
  LaneMask<4> active(true);
  for (int lane = 0; lane < 4; ++lane) {
    auto& gains = single[static_cast<std::size_t>(lane)];
    if (lane > 0) {  // the first has none
      gains.leakage = random.matrix<6>(2.0).cwiseAbs();
      gains.weight_limit = random.six(5e-3, 5e-4).cwiseAbs();
      gains.dead_zone = random.six(0.01, 0.05).cwiseAbs();
    }
    set_lane(pack, lane, gains);
    for (std::size_t r = 0; r < 49; ++r) {
      start[static_cast<std::size_t>(lane)][r] = Vector6<double>(random.six(1e-2, 1e-3));
      put_lane(weights[r], lane, start[static_cast<std::size_t>(lane)][r]);
    }
  }
  S idle(0.0);
  idle.set(2, 1.0);
  active = idle == S(0.0);
  CHECK(has_restraint(pack));
  const Vector6<double> driver = random.six(0.02, 0.1), output = random.six(1e-2, 1e-3);
  FuzzyRate<S> rate{};
  const FuzzySystems<S> systems(pack);
  const AxisVector<S> outputs = restrain<S>(systems, S(0.01), Vector6<S>(driver.cast<S>()),
                                            Vector6<S>(Vector6<S>::Ones()), rate, Vector6<S>(output.cast<S>()));
  restrain<S>(systems, S(0.02), weights, active);
  for (int lane = 0; lane < 4; ++lane) {
    CAPTURE(lane);
    const auto l = static_cast<std::size_t>(lane);
    FuzzyRate<double> one{};
    const FuzzySystems<double> its_systems(single[l]);
    const AxisVector<double> its_output = restrain<double>(its_systems, 0.01, driver, kOne, one, output);
    FuzzyWeights<double> expected = start[l];
    restrain(its_systems, 0.02, expected, lane != 2);
    CHECK(distance(lane_of(rate.strength, lane), one.strength.vector()) <= 1e-17);
    CHECK(distance(lane_of(outputs, lane), its_output.vector()) <= 1e-17);
    for (std::size_t r = 0; r < 49; ++r) CHECK(distance(lane_of(weights[r], lane), expected[r].vector()) <= 1e-17);
  }
}

TEST_CASE("options of the adaptation that make no sense are refused, with their key") {
  const auto verdict = [](auto&& change) {
    FuzzyGains<double> gains;
    change(gains);
    return refusal([&] { validate(gains, "controller.composite.fuzzy."); });
  };
  using Gains = FuzzyGains<double>;
  CHECK(verdict([](Gains& g) { g.weight_limit.setConstant(1e-3); }) == "(accepted)");
  for (const double bad : {kNaN, kInfinity, -1e-3}) {
    CHECK(is_about(verdict([&](Gains& g) { g.leakage(2) = bad; }), "controller.composite.fuzzy.leakage[2]"));
    CHECK(is_about(verdict([&](Gains& g) { g.dead_zone(5) = bad; }), "controller.composite.fuzzy.dead_zone[5]"));
  }
  for (const double bad : {kNaN, 0.0, -1e-3})
    CHECK(is_about(verdict([&](Gains& g) { g.weight_limit(1) = bad; }), "controller.composite.fuzzy.weight_limit[1]"));
  Gains gains;
  gains.leakage(4) = 100.0;
  CHECK(refusal([&] { require_resolved(gains, "controller.hybrid.fuzzy.", 0.01); }) == "(accepted)");
  CHECK(is_about(refusal([&] { require_resolved(gains, "controller.hybrid.fuzzy.", 0.0101); }),
                 "controller.hybrid.fuzzy.leakage"));
}
