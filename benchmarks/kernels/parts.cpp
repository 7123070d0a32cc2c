// The parts of one evaluation of the loop, each on its own: a number (`double`) and a pack (`Lanes<2>`, two scenarios).
#include "instants.hpp"

namespace hexservo::kernels {

namespace {

template <class S>
void image_jacobian_push(benchmark::State& state) {
  const ControlTask<S> task = control_task(parameters_of<S>());
  time_each<S>(state, [&](const Instant<S>& at) {
    const ImageJacobian<S> J(task.camera, task.jacobian_sign, at.image.features, at.inverse_depth, at.position,
                             at.R_BE);
    return J.push(at.twist);
  });
}

template <class S>
void image_jacobian_pull(benchmark::State& state) {
  const ControlTask<S> task = control_task(parameters_of<S>());
  time_each<S>(state, [&](const Instant<S>& at) {
    const ImageJacobian<S> J(task.camera, task.jacobian_sign, at.image.features, at.inverse_depth, at.position,
                             at.R_BE);
    return J.pull(at.error);
  });
}

template <class S>
std::vector<FuzzyRate<S>> rates() {
  const FuzzySystems<S> systems(parameters_of<S>().gains.fuzzy);
  const FuzzyWeights<S> weights = initial_weights(parameters_of<S>().gains.fuzzy);
  std::vector<FuzzyRate<S>> rates(kInstants);
  AxisVector<S> output;
  for (std::size_t i = 0; i < kInstants; ++i) {
    const Instant<S>& at = instants<S>()[i];
    respond<S>(systems, {&weights}, at.u, at.u_rate, AxisVector<S>(at.twist), rates[i], output);
  }
  return rates;
}

/// The six systems inside a stage, from their inputs: their weights, and the rank one that the stage before adds.
template <class S>
void fuzzy_systems(benchmark::State& state) {
  const std::vector<FuzzyRate<S>> of = rates<S>();
  FuzzyGains<S> gains = parameters_of<S>().gains.fuzzy;
  gains.initial_scale = Vector6<S>::Constant(S(0.1));
  const FuzzySystems<S> systems(gains);
  const FuzzyWeights<S> weights = initial_weights(gains);
  FuzzyRate<S> rate;
  std::size_t i = 0;
  for (auto _ : state) {
    const std::size_t before = i;
    i = (i + 1) % kInstants;
    const Instant<S>& at = instants<S>()[i];
    AxisVector<S> out;
    respond<S>(systems, {&weights, &of[before], S(5e-4)}, at.u, at.u_rate, AxisVector<S>(at.twist), rate, out);
    benchmark::DoNotOptimize(rate);
    benchmark::DoNotOptimize(out);
  }
}

/// All 294 weights at the end of a step, from four stages.
template <class S>
void weight_update(benchmark::State& state) {
  const std::vector<FuzzyRate<S>> of = rates<S>();
  FuzzyWeights<S> weights = initial_weights(parameters_of<S>().gains.fuzzy);
  // The same stages forward and then backward, so that the weights stay where a run has them.
  S scale(1e-3 / 6.0);
  std::size_t turn = 0;
  for (auto _ : state) {
    const std::size_t i = turn / 2 * 4;
    const std::array<const FuzzyRate<S>*, 4> four = {&of[i], &of[i + 1], &of[i + 2], &of[i + 3]};
    advance_weights(weights, four, std::array<S, 4>{scale, scale, scale, scale});
    benchmark::DoNotOptimize(weights);
    scale = -scale;
    turn = (turn + 1) % (kInstants / 2);
  }
}

template <class S>
void leg_forces(benchmark::State& state) {
  const Hexapod<S> hexapod = parameters_of<S>().hexapod;
  time_each<S>(state, [&](const Instant<S>& at) {
    return WrenchMapSolver<S>(hexapod, inverse_kinematics(hexapod, at.position, at.R_BE)).leg_forces(at.wrench);
  });
}

template <class S>
void dynamics(benchmark::State& state) {
  const LoopParameters<S, Hybrid> p = parameters_of<S>();
  const Plant<S> plant(p.body, p.dynamics_error);
  time_each<S>(state,
               [&](const Instant<S>& at) { return body_rate(plant, BodyMotion<S>::of(at.body), at.R_BE, at.wrench); });
}

}  // namespace

BENCHMARK(image_jacobian_push<double>);
BENCHMARK(image_jacobian_push<Lanes<2>>);
BENCHMARK(image_jacobian_pull<double>);
BENCHMARK(image_jacobian_pull<Lanes<2>>);
BENCHMARK(fuzzy_systems<double>);
BENCHMARK(fuzzy_systems<Lanes<2>>);
BENCHMARK(weight_update<double>);
BENCHMARK(weight_update<Lanes<2>>);
BENCHMARK(leg_forces<double>);
BENCHMARK(leg_forces<Lanes<2>>);
BENCHMARK(dynamics<double>);
BENCHMARK(dynamics<Lanes<2>>);

}  // namespace hexservo::kernels
