/// @file
/// How baseline code asks a kernel for runs.
#pragma once

#include "hexservo/settings.hpp"
#include "kernel.hpp"

#include <algorithm>
#include <new>
#include <stdexcept>
#include <string>

namespace hexservo::detail {

/// What of a prepared scenario its caller needs, beside its numbers.
struct Prepared {
  Hexapod<double> hexapod;
  bool fuzzy;  ///< whether fuzzy systems act
};

/// How many numbers a scenario takes on its way to a kernel.
std::size_t flat_size(const Settings& settings);

/// Validates a scenario, and writes its `flat_size` numbers.
/// @param legs as `loop_parameters` takes them
/// @param to null: the numbers are not asked for
/// @throws std::invalid_argument as `loop_parameters`
Prepared prepare(const Settings& settings, const Hexapod<double>* legs, double* to);

/// A request without its scenarios, log and questions.
/// @param settings their law, places of points and recorded base motion, which must outlive the request
/// @param simulation the mode and steps that they share
RunRequest run_request(const Settings& settings, const SimulationSettings& simulation);

/// Steps between two questions of a run whether to stop: few where a step has many substeps.
/// @param integration_steps that may pass between them
inline long long ask_every(const SimulationSettings& simulation, long long integration_steps) {
  return std::max(1LL, integration_steps / simulation.substeps);
}

/// @throws std::bad_alloc where the run found too little memory
/// @throws std::logic_error where caller and kernel do not belong together
inline void require_done(RunStatus status) {
  if (status == RunStatus::no_memory) throw std::bad_alloc();
  if (status != RunStatus::done)
    throw std::logic_error("kernel: expected one that was built with this core, got status " +
                           std::to_string(static_cast<int>(status)));
}

}  // namespace hexservo::detail
