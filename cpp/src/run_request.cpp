#include "run_request.hpp"

#include "flatten.hpp"
#include "motion.hpp"

namespace hexservo::detail {

std::size_t flat_size(LawId law) {
  return with_law(law, []<class Law>(std::type_identity<Law>) {
    return static_cast<std::size_t>(flat_size(LoopParameters<double, Law>{}));
  });
}

Prepared prepare(const Settings& settings, const Hexapod<double>* legs, double* to) {
  return with_law(settings.law(), [&]<class Law>(std::type_identity<Law>) {
    const LoopParameters<double, Law> parameters = loop_parameters<Law>(settings, legs);
    if (to != nullptr) flatten(parameters, to);
    return Prepared{parameters.hexapod, fuzzy_systems_act<Law>(parameters.gains)};
  });
}

RunRequest run_request(const Settings& settings, const SimulationSettings& simulation) {
  RunRequest request{};
  request.law = settings.law();
  request.sampled = simulation.mode == LoopMode::sampled;
  request.numbers = static_cast<long long>(flat_size(settings.law()));
  request.steps = step_count(simulation);
  request.recorded = recording(settings.base_motion);
  request.recorded_target = recording(settings.target.motion);
  return request;
}

}  // namespace hexservo::detail
