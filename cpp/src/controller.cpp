#include "hexservo/controller.hpp"

#include "check.hpp"
#include "controller_output.hpp"
#include "hexservo/subnormals.hpp"

namespace hexservo {

namespace {

/// A time in ticks; at a tick exactly where it is that but for rounding.
double in_ticks(double time, double period) noexcept {
  const double ticks = time / period, whole = std::nearbyint(ticks);
  return std::abs(ticks - whole) <= kTickTolerance ? whole : ticks;
}

SensorInput<double> in_ticks(const ControllerInput& input, double period) noexcept {
  return {in_ticks(input.now, period),
          {in_ticks(input.frame.exposure, period), input.frame.image},
          input.pose,
          input.twist,
          input.joints};
}

}  // namespace

template <class Law>
ControllerGains<Law> controller_gains(const Settings<Law>& settings, double period) {
  if (!(period > 0.0 && period <= kMaxServoPeriod))
    detail::refuse("period", detail::words("a time above 0 and up to ", kMaxServoPeriod, " s"), detail::words(period));
  Settings<Law> ticking = settings;  // on the tick's own grid, and without what belongs to the plant
  ticking.uncertainty = {};
  ticking.uncertainty.depth = settings.uncertainty.depth;  // the controller's own: what it takes the target for
  ticking.simulation = {LoopMode::sampled, period, 1, period, 1};
  ticking.base_motion = {};
  ticking.sensors.encoders.noise = 0.0;  // of the real encoders, not of those that a scenario simulates
  ticking.sensors.encoders.resolution = 0.0;
  if (settings.simulation.mode == LoopMode::continuous) {
    ticking.sampling = {period};
    ticking.sensors = {};
    ticking.actuators = {};
  }
  return servo_gains(loop_parameters(ticking));
}

template <int alignment>
void library_was_built_with_other_instruction_set_flags() noexcept {}

template void library_was_built_with_other_instruction_set_flags<EIGEN_MAX_ALIGN_BYTES>() noexcept;

template <class Law>
ControllerOutput step(const ControllerGains<Law>& gains, ControllerState<Law>& state,
                      const ControllerInput& input) noexcept {
  const FlushSubnormals flush;
  ServoTick<double, Law> tick;
  evaluate(gains, state, in_ticks(input, gains.period), tick);
  adapt(gains, state, tick, true);
  return detail::output_of(tick, state.perception.now());
}

#define HEXSERVO_HERE(Law)                                                      \
  template ControllerGains<Law> controller_gains(const Settings<Law>&, double); \
  template ControllerOutput step(const ControllerGains<Law>&, ControllerState<Law>&, const ControllerInput&) noexcept;
HEXSERVO_FOR_EACH_LAW(HEXSERVO_HERE)
#undef HEXSERVO_HERE

}  // namespace hexservo
