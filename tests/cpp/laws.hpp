/// @file
/// A law at one instant, from a whole image.
#pragma once

#include "hexservo/laws/laws.hpp"

namespace hexservo::test {

/// What the sensors give, with the attitude as a matrix.
template <class S>
struct Sensed {
  Image<S> image;   ///< measured
  Matrix3<S> R_BE;  ///< need not be a rotation
  Vector6<S> twist;
  Pose<S> pose{};  ///< need not have the attitude R_BE
};

template <class Law, class S>
typename Law::template Evaluation<S> evaluate_law(const ControlTask<S>& task,
                                                  const typename Law::template Gains<S>& gains,
                                                  const FuzzyWeights<S>& weights, const Sensed<S>& sensed) {
  const Vector<S, kPoints> inverse_depth = sensed.image.depth.cwiseInverse();
  typename Law::template Evaluation<S> out;
  Law::template evaluate<S, kPoints>(task, typename Law::template Constants<S>(gains), FuzzyStage<S>{&weights},
                                     {sensed.image.features, inverse_depth, sensed.R_BE, sensed.twist, sensed.pose},
                                     out);
  return out;
}

/// A law that has no state.
template <class Law, class S>
typename Law::template Evaluation<S> evaluate_stateless(const ControlTask<S>& task,
                                                        const typename Law::template Gains<S>& gains,
                                                        const Sensed<S>& sensed) {
  const Vector<S, kPoints> inverse_depth = sensed.image.depth.cwiseInverse();
  const typename Law::template State<S> none;
  typename Law::template Evaluation<S> out;
  Law::template evaluate<S, kPoints>(
      task, typename Law::template Constants<S>(gains), typename Law::template Stage<S>(&none),
      {sensed.image.features, inverse_depth, sensed.R_BE, sensed.twist, sensed.pose}, out);
  return out;
}

template <class S>
Hybrid::Evaluation<S> evaluate_hybrid(const ControlTask<S>& task, const HybridGains<S>& gains,
                                      const FuzzyWeights<S>& weights, const Sensed<S>& sensed) {
  return evaluate_law<Hybrid, S>(task, gains, weights, sensed);
}

/// Puts numbers into one lane of a pack's.
template <int W>
void put_lane(AxisVector<Lanes<W>>& to, int lane, const AxisVector<double>& from) {
  for (int j = 0; j < kAxes; ++j) to.part[static_cast<std::size_t>(j)].set(lane, from(j));
}

}  // namespace hexservo::test
