#include "run_request.hpp"

#include "flatten.hpp"
#include "motion.hpp"

namespace hexservo::detail {

std::size_t flat_size(const Settings& settings) {
  return with_loop(settings, []<class Law, int N>(std::type_identity<Law>, std::integral_constant<int, N>) {
    return static_cast<std::size_t>(flat_size(LoopParameters<double, Law, N>{}));
  });
}

Prepared prepare(const Settings& settings, const Hexapod<double>* legs, double* to) {
  return with_loop(settings, [&]<class Law, int N>(std::type_identity<Law>, std::integral_constant<int, N>) {
    const LoopParameters<double, Law, N> parameters = loop_parameters<Law, N>(settings, legs);
    if (to != nullptr) flatten(parameters, to);
    return Prepared{parameters.hexapod, fuzzy_systems_act<Law>(parameters.gains)};
  });
}

RunRequest run_request(const Settings& settings, const SimulationSettings& simulation) {
  RunRequest request{};
  request.law = settings.law();
  request.points = settings.target.count();
  request.places = settings.target.places();
  request.sampled = simulation.mode == LoopMode::sampled;
  request.numbers = static_cast<long long>(flat_size(settings));
  request.steps = step_count(simulation);
  request.recorded = recording(settings.base_motion);
  request.recorded_target = recording(settings.target.motion);
  return request;
}

}  // namespace hexservo::detail
