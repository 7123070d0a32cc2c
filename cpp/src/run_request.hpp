/// @file
/// How baseline code asks a kernel for runs.
#pragma once

#include "flatten.hpp"
#include "hexservo/settings.hpp"
#include "kernel.hpp"

#include <stdexcept>
#include <string>
#include <vector>

namespace hexservo::detail {

template <class Law>
std::vector<double> flattened(const LoopParameters<double, Law>& parameters) {
  std::vector<double> numbers(static_cast<std::size_t>(flat_size(parameters)));
  flatten(parameters, numbers.data());
  return numbers;
}

/// A request without its scenarios, log and questions.
/// @param numbers of each flattened scenario
/// @param base_motion what was recorded of it, which must outlive the request
template <class Law>
RunRequest run_request(const SimulationSettings& simulation, const BaseMotionSettings& base_motion,
                       std::size_t numbers) {
  RunRequest request{};
  request.law = law_id<Law>;
  request.sampled = simulation.mode == LoopMode::sampled;
  request.numbers = static_cast<long long>(numbers);
  request.steps = step_count(simulation);
  if (base_motion.samples) {
    request.recorded = base_motion.samples->data();
    request.recorded_count = static_cast<long long>(base_motion.samples->size() / 3);
    request.recorded_period = base_motion.sample_period;
  }
  return request;
}

/// @throws std::logic_error where caller and kernel do not belong together
inline void require_done(RunStatus status) {
  if (status != RunStatus::done)
    throw std::logic_error("kernel: expected one that was built with this core, got status " +
                           std::to_string(static_cast<int>(status)));
}

}  // namespace hexservo::detail
