#include "hexservo/controller.hpp"

#include "check.hpp"
#include "controller_output.hpp"
#include "hexservo/subnormals.hpp"
#include "weight_rows.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace hexservo {

namespace {

/// A time in ticks; at a tick exactly where it is that but for rounding.
double in_ticks(double time, double period) noexcept {
  const double ticks = time / period, whole = std::nearbyint(ticks);
  return std::abs(ticks - whole) <= kTickTolerance ? whole : ticks;
}

template <int N>
SensorInput<double, N> in_ticks(const ControllerInputOf<N>& input, double period) noexcept {
  return {in_ticks(input.now, period),
          {in_ticks(input.frame.exposure, period), input.frame.image},
          input.pose,
          input.twist,
          input.joints};
}

/// Visits every number of a state as a double; masks and counts are whole numbers.
struct NumberWriter {
  std::vector<double>& numbers;

  void operator()(double number) { numbers.push_back(number); }
  void operator()(bool mask) { numbers.push_back(mask ? 1.0 : 0.0); }
  void operator()(std::size_t count) { numbers.push_back(static_cast<double>(count)); }
  template <int R, int C>
  void operator()(const Eigen::Matrix<double, R, C>& matrix) {
    numbers.insert(numbers.end(), matrix.data(), matrix.data() + matrix.size());
  }
  void operator()(const FuzzyWeights<double>& weights) {
    numbers.resize(numbers.size() + kWeightNumbers);
    detail::write_weights(weights, 0, numbers.data() + numbers.size() - kWeightNumbers);
  }
  void operator()(PoseMemory<double>& memory) { memory.for_each_member(*this); }
  void operator()(const NoState<double>& /*law*/) {}
  void time(auto& numbers_of) { (*this)(numbers_of); }
  void finite(auto& numbers_of) { (*this)(numbers_of); }
};

/// The same numbers, back to where they came from.
struct NumberReader {
  const double* next;

  void operator()(double& number) { number = *next++; }
  void operator()(bool& mask) { mask = whole(1.0) != 0.0; }
  void operator()(std::size_t& count) { count = static_cast<std::size_t>(whole(0x1p53)); }
  template <int R, int C>
  void operator()(Eigen::Matrix<double, R, C>& matrix) {
    matrix = Eigen::Map<const Eigen::Matrix<double, R, C>>(next);
    next += matrix.size();
  }
  void operator()(FuzzyWeights<double>& weights) {
    require(kWeightNumbers, "a finite number", [](double number) { return std::isfinite(number); });
    weights = detail::weights_from(next);
    next += kWeightNumbers;
  }
  void operator()(PoseMemory<double>& memory) { memory.for_each_member(*this); }
  void operator()(NoState<double>& /*law*/) {}

  /// A time, or several; -infinity where there was none yet.
  void time(auto& times) {
    require(count(times), "a time", [](double number) { return number < std::numeric_limits<double>::infinity(); });
    (*this)(times);
  }
  void finite(auto& numbers) {
    require(count(numbers), "a finite number", [](double number) { return std::isfinite(number); });
    (*this)(numbers);
  }

  static std::size_t count(double /*number*/) { return 1; }
  template <int R, int C>
  static std::size_t count(const Eigen::Matrix<double, R, C>& matrix) {
    return static_cast<std::size_t>(matrix.size());
  }
  void require(std::size_t numbers, const char* what, bool (*is_one)(double)) const {
    const double* found = std::find_if_not(next, next + numbers, is_one);
    if (found != next + numbers) detail::refuse("state", detail::words(what, " in this place"), detail::words(*found));
  }

  double whole(double most) {
    const double number = *next++;
    if (!(number >= 0.0 && number <= most && number == std::floor(number)))
      detail::refuse("state", detail::words("a whole number from 0 to ", most, " in the place of a mask or a count"),
                     detail::words(number));
    return number;
  }
};

}  // namespace

template <class Law, int N>
ControllerGains<Law, N> controller_gains(const Settings& settings, double period) {
  const MaskTraps masked;
  if (!(period > 0.0 && period <= kMaxServoPeriod))
    detail::refuse("period", detail::words("a time above 0 and up to ", kMaxServoPeriod, " s"), detail::words(period));
  Settings ticking = settings;  // on the tick's own grid, and without what belongs to the plant
  ticking.uncertainty = {};
  ticking.uncertainty.depth = settings.uncertainty.depth;  // the controller's own: what it takes the target for
  ticking.uncertainty.mount = settings.uncertainty.mount;
  ticking.simulation = {LoopMode::sampled, period, 1, period, 1, {}};
  ticking.base_motion = {};
  ticking.target.frame = TargetFrame::base;
  ticking.target.motion = {};
  if (takes_positions(ticking.actuators.kind)) {  // the motors are the plant's
    ticking.actuators.kind = ActuatorKind::position;
    ticking.actuators.motor = {};
  }
  ticking.sensors.noise = 0.0;  // of the real encoders, not of those that a scenario simulates
  ticking.sensors.resolution = 0.0;
  if (settings.simulation.mode == LoopMode::sampled) {
    ticking.uncertainty.focal_length = settings.uncertainty.focal_length;  // what it takes its camera for
    ticking.uncertainty.principal_point = settings.uncertainty.principal_point;
    ticking.uncertainty.latency = settings.uncertainty.latency;  // stamps come so early: poses are kept that long
  } else {
    ticking.camera = {settings.camera, {}, settings.camera.convention};
    ticking.sensors = {};
    ticking.actuators = {};
  }
  return servo_gains(loop_parameters<Law, N>(ticking));
}

template <class Law, int N>
ControllerOutput step(const ControllerGains<Law, N>& gains, ControllerState<Law, N>& state,
                      const std::type_identity_t<ControllerInputOf<N>>& input) noexcept {
  const FlushSubnormals flush;
  ServoTick<double, Law> tick;
  evaluate(gains, state, in_ticks(input, gains.period), tick);
  adapt(gains, state, tick, true);
  return detail::output_of<Law, N>(tick, state);
}

template <class Law, int N>
std::vector<double> stored(ControllerState<Law, N> state) {
  std::vector<double> numbers;
  NumberWriter write{numbers};
  state.for_each_member(write);
  return numbers;
}

template <class Law, int N>
void restore(ControllerState<Law, N>& state, std::span<const double> numbers) {
  const std::size_t expected = stored<Law, N>(state).size();
  if (numbers.size() != expected)
    detail::refuse("state", detail::words(expected, " numbers, those of this scenario and period"),
                   detail::words(numbers.size()));
  ControllerState<Law, N> restored = state;
  restored.for_each_member(NumberReader{numbers.data()});
  state = std::move(restored);
}

#define HEXSERVO_OF(Law, N)                                                                              \
  template ControllerGains<Law, (N)> controller_gains<Law, (N)>(const Settings&, double);                \
  template std::vector<double> stored<Law, (N)>(ControllerState<Law, (N)>);                              \
  template void restore<Law, (N)>(ControllerState<Law, (N)>&, std::span<const double>);                  \
  template ControllerOutput step<Law, (N)>(const ControllerGains<Law, (N)>&, ControllerState<Law, (N)>&, \
                                           const ControllerInputOf<(N)>&) noexcept;
#define HEXSERVO_HERE(Law) HEXSERVO_OF(Law, kPoints) HEXSERVO_OF(Law, kMostPoints)
HEXSERVO_FOR_EACH_LAW(HEXSERVO_HERE)
#undef HEXSERVO_HERE
#undef HEXSERVO_OF

}  // namespace hexservo
