/// @file
/// What the controller of a simulated run was given and what it answered, tick by tick: a robot's program that is given
/// the same answers the same.
#pragma once

#include "hexservo/controller.hpp"

#include <vector>

namespace hexservo {

/// One tick of a simulated run.
struct RecordedTick {
  ControllerInputOf<kMostPoints> input;  ///< places behind the target's points hold its first one
  ControllerOutput output;
};

/// Runs a scenario in `sampled` mode, and keeps every tick; not the one at which a run stops early.
/// @throws std::invalid_argument as `simulate`, and for a scenario in `continuous` mode
std::vector<RecordedTick> record_ticks(const Settings& settings);

}  // namespace hexservo
