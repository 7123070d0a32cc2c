/// @file
/// A law at one instant, from a whole image.
#pragma once

#include "hexservo/laws/hybrid.hpp"

namespace hexservo::test {

/// What the sensors give, with the attitude as a matrix.
template <class S>
struct Sensed {
  Image<S> image;   ///< measured
  Matrix3<S> R_BE;  ///< need not be a rotation
  Vector6<S> twist;
};

template <class S>
Hybrid::Evaluation<S> evaluate_hybrid(const ControlTask<S>& task, const HybridGains<S>& gains,
                                      const FuzzyWeights<S>& weights, const Sensed<S>& sensed) {
  const Vector<S, kPoints> inverse_depth = sensed.image.depth.cwiseInverse();
  Hybrid::Evaluation<S> out;
  Hybrid::evaluate<S, kPoints>(task, HybridConstants<S>(gains), FuzzyStage<S>{&weights},
                               {sensed.image.features, inverse_depth, sensed.R_BE, sensed.twist}, out);
  return out;
}

}  // namespace hexservo::test
