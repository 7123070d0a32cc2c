// The servo tick, and one Runge-Kutta step of the closed loop, as a number and as a pack of two scenarios.
#include "instants.hpp"

#include <optional>

namespace hexservo::kernels {

namespace {

void servo_tick(benchmark::State& state) {
  const ControllerGains<Hybrid> gains = controller_gains<Hybrid>(test::paper_settings(), 1e-3);
  std::vector<ControllerInput> inputs;
  for (ClosedLoop<double, Hybrid> loop(parameters()); inputs.size() < 1000; loop.advance())
    inputs.push_back(input_of(loop.time(), loop.observe()));
  ControllerState<Hybrid> controller = initial_state(gains);
  std::size_t i = 0;
  for (auto _ : state) {
    ControllerOutput out = step(gains, controller, inputs[i]);
    benchmark::DoNotOptimize(out);
    if (out.invalid_input()) state.SkipWithError("a tick refused its input");
    if (++i == inputs.size()) {
      i = 0;
      controller = initial_state(gains);
    }
  }
}

/// Everything in it: four evaluations, the weights, leg forces, what stops a run, metrics. Restarts every 5 s.
template <class S>
void runge_kutta(benchmark::State& state) {
  constexpr long long kSteps = 5000;
  const LoopParameters<S, Hybrid> p = parameters_of<S>();
  std::optional<ClosedLoop<S, Hybrid>> loop(std::in_place, p);
  for (auto _ : state) {
    if (loop->steps() == kSteps) loop.emplace(p);
    loop->advance();
    benchmark::DoNotOptimize(*loop);
  }
  if (!all(loop->record().running())) state.SkipWithError("the run stopped");
  state.SetItemsProcessed(state.iterations() * kLanes<S>);
}

}  // namespace

BENCHMARK(servo_tick);
BENCHMARK(runge_kutta<double>);
BENCHMARK(runge_kutta<Lanes<2>>);

}  // namespace hexservo::kernels

BENCHMARK_MAIN();
