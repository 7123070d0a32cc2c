/// @file
/// What a tick of the controller's core is in the words of controller.hpp.
#pragma once

#include "hexservo/controller.hpp"

namespace hexservo::detail {

template <int N>
InputStatus status_of(const Perceived<double, N>& seen, bool acts) noexcept {
  if (acts) return InputStatus::valid;
  if (!(seen.joints && seen.usable)) return InputStatus::unusable;
  if (!seen.complete) return InputStatus::missing_image;
  if (!seen.fresh) return InputStatus::stale_image;
  return seen.lost ? InputStatus::lost_feature : InputStatus::unusable;
}

template <class Law, int N>
ControllerOutput output_of(const ServoTick<double, Law>& tick, const ServoState<double, Law, N>& state) noexcept {
  ControllerOutput out{tick.command.wrench,    tick.command.leg_forces,
                       tick.law.fuzzy_output,  status_of(state.perception.now(), tick.command.acts),
                       tick.command.saturated, state.motion.legs};
  if constexpr (kTracks<Law>) {
    if (!state.tracking.stamped) out.latency = state.tracking.latency_range;
    const Perceived<double, N>& seen = state.perception.now();
    if (out.status == InputStatus::unusable && seen.joints && seen.usable &&
        !tick.command.singular) {  // frames came, but none was taken
      if (!state.tracking.target.known)
        out.status = InputStatus::missing_image;
      else if (!state.tracking.recent)
        out.status = InputStatus::stale_image;
    }
  }
  return out;
}

}  // namespace hexservo::detail
