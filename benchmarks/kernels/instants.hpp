/// @file
/// What the kernels are timed on: a run of scenario `paper`, instant by instant, as numbers and as packs.
#pragma once

#include "hexservo/controller.hpp"

#include "scenarios.hpp"

#include <benchmark/benchmark.h>

#include <vector>

namespace hexservo::kernels {

/// Everything that the parts of a step need at one instant.
template <class S>
struct Instant {
  Image<S> image;
  Vector<S, kPoints> inverse_depth;
  Matrix3<S> R_BE;
  Vector3<S> position;
  BodyState<S> body;
  Vector6<S> twist;
  Vector6<S> wrench;
  Vector<S, 2 * kPoints> error;
  AxisVector<S> u, u_rate;  ///< scaled inputs of the fuzzy systems
};

/// Copies an instant into a lane; a number has one lane.
inline void put(Instant<double>& to, int, const Instant<double>& from) { to = from; }
template <int W>
void put(Instant<Lanes<W>>& to, int lane, const Instant<double>& from) {
  set_lane(to.image, lane, from.image);
  set_lane(to.inverse_depth, lane, from.inverse_depth);
  set_lane(to.R_BE, lane, from.R_BE);
  set_lane(to.position, lane, from.position);
  set_lane(to.body, lane, from.body);
  set_lane(to.twist, lane, from.twist);
  set_lane(to.wrench, lane, from.wrench);
  set_lane(to.error, lane, from.error);
  for (int axis = 0; axis < kAxes; ++axis) {
    Lanes<W> u = to.u(axis), u_rate = to.u_rate(axis);
    set_lane(u, lane, from.u(axis));
    set_lane(u_rate, lane, from.u_rate(axis));
    to.u.set(axis, u);
    to.u_rate.set(axis, u_rate);
  }
}

inline constexpr std::size_t kInstants = 256;  ///< they fit into a second-level cache, as a robot's own data do

inline const LoopParameters<double, Hybrid>& parameters() {
  static const LoopParameters<double, Hybrid> p = loop_parameters<Hybrid>(test::paper_settings());
  return p;
}

/// Every fourth instant of the first second of the run.
inline std::vector<Instant<double>> recorded() {
  const LoopParameters<double, Hybrid>& p = parameters();
  const ControlTask<double> task = control_task(p);
  ClosedLoop<double, Hybrid> loop(p);
  std::vector<Instant<double>> instants(kInstants);
  for (Instant<double>& at : instants) {
    const Measurement<double> seen = loop.observe();
    at.image = seen.image;
    at.inverse_depth = seen.image.depth.cwiseInverse();
    at.R_BE = rotation_matrix(seen.pose.quaternion);
    at.position = seen.pose.position;
    at.body = body_state<double>(seen.pose, seen.twist);
    at.twist = seen.twist;
    at.wrench = loop.record().sample().wrench;
    at.error = p.gains.kp.cwiseProduct(loop.record().sample().feature_error);
    const ImageJacobian<double> J(task.camera, task.jacobian_sign, at.image, at.position, at.R_BE);
    const Vector<double, 2 * kPoints> rate = -p.gains.kp.cwiseProduct(J.push(at.twist));
    at.u = AxisVector<double>(Vector6<double>(p.gains.fuzzy.error_scale.cwiseProduct(J.pull(at.error).vector())));
    at.u_rate = AxisVector<double>(Vector6<double>(p.gains.fuzzy.rate_scale.cwiseProduct(J.pull(rate).vector())));
    for (int step = 0; step < 4; ++step) loop.advance();
  }
  return instants;
}

/// The same, each lane at another part of the run.
template <class S>
const std::vector<Instant<S>>& instants() {
  static const std::vector<Instant<S>> packs = [] {
    const std::vector<Instant<double>> from = recorded();
    std::vector<Instant<S>> to(kInstants);
    for (std::size_t i = 0; i < kInstants; ++i)
      for (int lane = 0; lane < kLanes<S>; ++lane)
        put(to[i], lane, from[(i + static_cast<std::size_t>(lane) * kInstants / 2) % kInstants]);
    return to;
  }();
  return packs;
}

/// The scenario's parameters, in all lanes.
template <class S, class T>
T in_all_lanes(const auto& value) {
  if constexpr (kLanes<S> == 1) {
    return value;
  } else {
    T packed;
    for (int lane = 0; lane < kLanes<S>; ++lane) set_lane(packed, lane, value);
    return packed;
  }
}
template <class S>
LoopParameters<S, Hybrid> parameters_of() {
  return in_all_lanes<S, LoopParameters<S, Hybrid>>(parameters());
}

/// Times a function of an instant, the instants in turn.
template <class S, class Function>
void time_each(benchmark::State& state, Function&& function) {
  const std::vector<Instant<S>>& at = instants<S>();
  std::size_t i = 0;
  for (auto _ : state) {
    auto result = function(at[i]);
    benchmark::DoNotOptimize(result);
    i = (i + 1) % kInstants;
  }
}

}  // namespace hexservo::kernels
