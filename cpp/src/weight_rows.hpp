/// @file
/// The weights of the fuzzy systems as a row of numbers: axis, term of u, term of u-dot.
#pragma once

#include "hexservo/fuzzy.hpp"
#include "hexservo/lanes.hpp"
#include "hexservo/laws/law_without_fuzzy.hpp"
#include "kernel.hpp"

#include <algorithm>

namespace hexservo::detail {

/// Visits all weights in the order of a row; each is given by its rule and its axis.
template <class Function>
void for_each_weight(Function&& at) {
  for (int axis = 0; axis < kAxes; ++axis)
    for (int row = 0; row < kTerms; ++row)
      for (int column = 0; column < kTerms; ++column) at(rule(row, column), axis);
}

/// Writes the weights of one lane to `kWeightNumbers` places.
template <class S>
void write_weights(const FuzzyWeights<S>& weights, int lane, double* to) {
  for_each_weight([&](auto rule, int axis) { *to++ = of_lane(weights[rule](axis), lane); });
}

/// A law without weights has zeros.
template <class State>
void write_weights(const State& /*no_weights*/, int /*lane*/, double* to) {
  std::fill_n(to, kWeightNumbers, 0.0);
}

/// Weights from such a row.
inline FuzzyWeights<double> weights_from(const double* numbers) {
  FuzzyWeights<double> weights{};
  for_each_weight([&](auto rule, int axis) { weights[rule].set(axis, *numbers++); });
  return weights;
}

}  // namespace hexservo::detail
