/// @file
/// Prepares the motions of base and target.
#pragma once

#include "hexservo/settings.hpp"

namespace hexservo::detail {

/// What is recorded of the base; it refers to the settings.
Recording recording(const BaseMotionSettings& motion);
/// Likewise of the target.
Recording recording(const TargetMotionSettings& motion);

/// Validates and copies the motions; of each only what its kind needs has to fit.
/// @param p with the step, the substeps and the camera's convention of the scenario
/// @throws std::invalid_argument naming the scenario key
template <int N>
void prepare_motions(const Settings& settings, SceneParameters<double, N>& p);

}  // namespace hexservo::detail
