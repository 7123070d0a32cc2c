#include "hexservo/tick_record.hpp"

#include "check.hpp"
#include "controller_output.hpp"
#include "hexservo/subnormals.hpp"

namespace hexservo {

namespace {

template <class Law, int N>
std::vector<RecordedTick> record_ticks_of(const Settings& settings) {
  const LoopParameters<double, Law, N> parameters = loop_parameters<Law, N>(settings);
  const long long steps = step_count(settings.simulation);
  const FlushSubnormals flush;  // as runs and ticks do
  std::vector<RecordedTick> ticks;
  ticks.reserve(static_cast<std::size_t>(steps) + 1);
  SampledLoop<double, Law, N> loop(parameters);
  while (true) {
    const SensorInput<double, N>& sensed = loop.sensed();
    const double T = parameters.step;
    Image<double, kMostPoints> image;
    image.features.head<2 * N>() = sensed.frame.image.features;
    image.depth.head<N>() = sensed.frame.image.depth;
    fill_places<2>(image.features, parameters.points);
    fill_places<1>(image.depth, parameters.points);
    ticks.push_back({{sensed.now * T, {sensed.frame.exposure * T, image}, sensed.pose, sensed.twist, sensed.joints},
                     detail::output_of<Law, N>(loop.tick(), loop.servo_state())});
    if (loop.steps() == steps) return ticks;
    loop.advance();
    if (!loop.record().running()) return ticks;
  }
}

}  // namespace

std::vector<RecordedTick> record_ticks(const Settings& settings) {
  if (settings.simulation.mode != LoopMode::sampled)
    detail::refuse("simulation.mode", "sampled, whose controller has ticks", "continuous");
  return with_loop(settings, [&]<class Law, int N>(std::type_identity<Law>, std::integral_constant<int, N>) {
    return record_ticks_of<Law, N>(settings);
  });
}

}  // namespace hexservo
