/// @file
/// What a tick of the controller's core is in the words of controller.hpp.
#pragma once

#include "hexservo/controller.hpp"

namespace hexservo::detail {

template <class Law, int N>
InputStatus status_of(const ServoTick<double, Law>& tick, const ServoState<double, Law, N>& state) noexcept {
  const Perceived<double, N>& seen = state.perception.now();
  if (tick.command.acts) return InputStatus::valid;
  if (!(seen.joints && seen.usable)) return InputStatus::unusable;
  bool known = seen.complete, recent = seen.fresh;
  if constexpr (kTracks<Law>)
    if (!tick.command.singular) {  // of what it sees it takes single frames
      known = known && state.tracking.target.known;
      recent = recent && state.tracking.recent;
    }
  if (!known) return InputStatus::missing_image;
  if (!recent) return InputStatus::stale_image;
  return seen.lost ? InputStatus::lost_feature : InputStatus::unusable;
}

template <class Law, int N>
ControllerOutput output_of(const ServoTick<double, Law>& tick, const ServoState<double, Law, N>& state) noexcept {
  ControllerOutput out{tick.command.wrench,    tick.command.leg_forces, tick.law.fuzzy_output,
                       status_of(tick, state), tick.command.saturated,  state.motion.legs};
  if constexpr (kTracks<Law>)
    if (!state.tracking.stamped) out.latency = state.tracking.latency_range;
  return out;
}

}  // namespace hexservo::detail
