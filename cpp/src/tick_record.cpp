#include "hexservo/tick_record.hpp"

#include "check.hpp"
#include "controller_output.hpp"
#include "hexservo/subnormals.hpp"

namespace hexservo {

namespace {

template <class Law>
std::vector<RecordedTick> record_ticks_of(const Settings& settings) {
  const LoopParameters<double, Law> parameters = loop_parameters<Law>(settings);
  const long long steps = step_count(settings.simulation);
  const FlushSubnormals flush;  // as runs and ticks do
  std::vector<RecordedTick> ticks;
  ticks.reserve(static_cast<std::size_t>(steps) + 1);
  SampledLoop<double, Law> loop(parameters);
  while (true) {
    const SensorInput<double>& sensed = loop.sensed();
    const double T = parameters.step;
    ticks.push_back(
        {{sensed.now * T, {sensed.frame.exposure * T, sensed.frame.image}, sensed.pose, sensed.twist, sensed.joints},
         detail::output_of(loop.tick(), loop.perceived())});
    if (loop.steps() == steps) return ticks;
    loop.advance();
    if (!loop.record().running()) return ticks;
  }
}

}  // namespace

std::vector<RecordedTick> record_ticks(const Settings& settings) {
  if (settings.simulation.mode != LoopMode::sampled)
    detail::refuse("simulation.mode", "sampled, whose controller has ticks", "continuous");
  return with_law(settings.law(), [&]<class Law>(std::type_identity<Law>) { return record_ticks_of<Law>(settings); });
}

}  // namespace hexservo
