#include "key_setters.hpp"

#include "check.hpp"

#include <initializer_list>
#include <vector>

namespace hexservo::detail {

namespace {

using Numbers = std::span<const double>;

/// A number stands for every entry; an array is given row by row.
template <int R, int C>
void fill(Eigen::Matrix<double, R, C>& to, Numbers from) {
  if (from.size() == 1) {
    to.setConstant(from[0]);
    return;
  }
  for (int row = 0; row < R; ++row)
    for (int column = 0; column < C; ++column) to(row, column) = from[static_cast<std::size_t>(row * C + column)];
}

/// Numbers that a gain takes; 0 for a choice, and for fuzzy systems, which have keys of their own.
template <class Member>
constexpr std::size_t width_of() {
  if constexpr (std::is_same_v<Member, double>)
    return 1;
  else if constexpr (requires { Member::SizeAtCompileTime; })
    return static_cast<std::size_t>(Member::SizeAtCompileTime);
  else
    return 0;
}

template <class Member>
void put([[maybe_unused]] Member& to, [[maybe_unused]] Numbers from) {
  if constexpr (std::is_same_v<Member, double>)
    to = from[0];
  else if constexpr (width_of<Member>() > 0)
    fill(to, from);
}

void fill_inertia(Matrix3<double>& to, Numbers from) {
  if (from.size() == 3)
    to = Vector3<double>(from[0], from[1], from[2]).asDiagonal();
  else
    fill(to, from);
}

void fill_points(Target& target, Numbers from) {
  Eigen::Matrix<double, kPoints, 3> points;
  fill(points, from);
  target.points_B = points.transpose();
}

long long whole_number(const char* key, double value) {
  if (!(value >= 1.0 && value <= 1e15) || value != std::floor(value)) refuse(key, "a whole number >= 1", words(value));
  return static_cast<long long>(value);
}

using V = Numbers;

template <class Law>
using Keys = std::vector<KeySetter<Law>>;

template <class Law>
Keys<Law> joined(std::initializer_list<Keys<Law>> parts) {
  Keys<Law> all;
  for (const Keys<Law>& part : parts) all.insert(all.end(), part.begin(), part.end());
  return all;
}

// clang-format off
template <class Law>
Keys<Law> scene_keys() {
  using S = Settings<Law>;
  return {
      {"robot.platform_radius", {1}, Reach::legs, [](S& s, V v) { s.robot.platform_radius = v[0]; }},
      {"robot.base_radius", {1}, Reach::legs, [](S& s, V v) { s.robot.base_radius = v[0]; }},
      {"robot.platform_angles", {6}, Reach::legs, [](S& s, V v) { fill(s.robot.platform_angles, v); }},
      {"robot.base_angles", {6}, Reach::legs, [](S& s, V v) { fill(s.robot.base_angles, v); }},
      {"robot.home_position", {3}, Reach::legs, [](S& s, V v) { fill(s.robot.home_position, v); }},
      {"robot.mass", {1}, Reach::lane, [](S& s, V v) { s.robot.mass = v[0]; }},
      {"robot.inertia", {3, 9}, Reach::lane, [](S& s, V v) { fill_inertia(s.robot.inertia, v); }},
      {"robot.stroke", {1}, Reach::legs, [](S& s, V v) { s.robot.stroke = v[0]; }},
      {"robot.force_limit", {1}, Reach::legs, [](S& s, V v) { s.robot.force_limit = v[0]; }},
      {"camera.focal_length", {1}, Reach::lane, [](S& s, V v) { s.camera.focal_length = v[0]; }},
      {"camera.pixel_scale", {1}, Reach::lane, [](S& s, V v) { s.camera.pixel_scale = v[0]; }},
      {"camera.period", {1}, Reach::pack, [](S& s, V v) { s.sampling.period = v[0]; }},
      {"camera.latency", {1}, Reach::pack, [](S& s, V v) { s.sampling.latency = v[0]; }},
      {"camera.latency_jitter", {1}, Reach::pack, [](S& s, V v) { s.sampling.latency_jitter = v[0]; }},
      {"camera.timeout", {1}, Reach::lane, [](S& s, V v) { s.sampling.timeout = v[0]; }},
      {"camera.noise", {1}, Reach::lane, [](S& s, V v) { s.sampling.faults.noise = v[0]; }},
      {"camera.quantisation", {1}, Reach::lane, [](S& s, V v) { s.sampling.faults.quantisation = v[0]; }},
      {"camera.dropout", {1}, Reach::lane, [](S& s, V v) { s.sampling.faults.dropout = v[0]; }},
      {"camera.outlier_probability", {1}, Reach::lane, [](S& s, V v) { s.sampling.faults.outlier_probability = v[0]; }},
      {"camera.outlier_size", {1}, Reach::lane, [](S& s, V v) { s.sampling.faults.outlier_size = v[0]; }},
      {"camera.image_size", {2}, Reach::lane, [](S& s, V v) { fill(s.sampling.faults.image_size, v); }},
      {"sensors.resolution", {1}, Reach::lane, [](S& s, V v) { s.sensors.encoders.resolution = v[0]; }},
      {"sensors.noise", {1}, Reach::lane, [](S& s, V v) { s.sensors.encoders.noise = v[0]; }},
      {"sensors.period", {1}, Reach::pack, [](S& s, V v) { s.sensors.period = v[0]; }},
      {"actuators.bandwidth", {1}, Reach::lane, [](S& s, V v) { s.actuators.actuators.bandwidth = v[0]; }},
      {"actuators.quantisation", {1}, Reach::lane, [](S& s, V v) { s.actuators.actuators.quantisation = v[0]; }},
      {"actuators.delay", {1}, Reach::pack, [](S& s, V v) { s.actuators.delay = v[0]; }},
      {"base_motion.amplitude", {3}, Reach::lane, [](S& s, V v) { fill(s.base_motion.motion.amplitude, v); }},
      {"base_motion.frequency", {1}, Reach::lane, [](S& s, V v) { s.base_motion.motion.frequency = v[0]; }},
      {"base_motion.phase", {1}, Reach::lane, [](S& s, V v) { s.base_motion.motion.phase = v[0]; }},
      {"base_motion.level", {1, 3}, Reach::lane, [](S& s, V v) { fill(s.base_motion.motion.level, v); }},
      {"base_motion.low_frequency", {1}, Reach::lane, [](S& s, V v) { s.base_motion.motion.low_frequency = v[0]; }},
      {"base_motion.high_frequency", {1}, Reach::lane, [](S& s, V v) { s.base_motion.motion.high_frequency = v[0]; }},
      {"target.initial_features", {8}, Reach::lane, [](S& s, V v) { fill(s.target.initial_features, v); }},
      {"target.desired_features", {8}, Reach::lane, [](S& s, V v) { fill(s.target.desired_features, v); }},
      {"target.depth", {1, 4}, Reach::lane, [](S& s, V v) { fill(s.target.depth, v); }},
      {"target.points", {12}, Reach::lane, [](S& s, V v) { fill_points(s.target, v); }},
      {"uncertainty.inertia", {1, 36}, Reach::lane, [](S& s, V v) { fill(s.uncertainty.dynamics.inertia, v); }},
      {"uncertainty.coriolis", {1, 36}, Reach::lane, [](S& s, V v) { fill(s.uncertainty.dynamics.coriolis, v); }},
      {"uncertainty.gravity", {1, 6}, Reach::lane, [](S& s, V v) { fill(s.uncertainty.dynamics.gravity, v); }},
      {"uncertainty.depth", {1, 4}, Reach::lane, [](S& s, V v) { fill(s.uncertainty.depth, v); }},
      {"metrics.band", {1}, Reach::lane, [](S& s, V v) { s.metrics.band = v[0]; }},
      {"metrics.dwell", {1}, Reach::lane, [](S& s, V v) { s.metrics.dwell = v[0]; }},
      {"metrics.rms_start", {1}, Reach::pack, [](S& s, V v) { s.metrics.rms_start = v[0]; }},
      {"controller.switching.width", {1}, Reach::lane, [](S& s, V v) { s.switching.width = v[0]; }},
  };
}

template <class Law>
Keys<Law> fuzzy_keys()
  requires kHasFuzzySystems<Law>
{
  using S = Settings<Law>;
  const std::string fuzzy = std::string("controller.") + Law::name + ".fuzzy.";
  return {
      {fuzzy + "adaptation", {1, 6}, Reach::lane, [](S& s, V v) { fill(s.gains.fuzzy.adaptation, v); }},
      {fuzzy + "error_scale", {1, 6}, Reach::lane, [](S& s, V v) { fill(s.gains.fuzzy.error_scale, v); }},
      {fuzzy + "rate_scale", {1, 6}, Reach::lane, [](S& s, V v) { fill(s.gains.fuzzy.rate_scale, v); }},
      {fuzzy + "initial_scale", {1, 6}, Reach::lane, [](S& s, V v) { fill(s.gains.fuzzy.initial_scale, v); }},
      {fuzzy + "table", {49}, Reach::lane, [](S& s, V v) { fill(s.gains.fuzzy.table, v); }},
      {fuzzy + "bell_width", {1}, Reach::lane, [](S& s, V v) { s.gains.fuzzy.bell_width = v[0]; }},
      {fuzzy + "bell_slope", {1}, Reach::pack, [](S& s, V v) { s.gains.fuzzy.bell_slope = v[0]; }},
      {fuzzy + "leakage", {1, 6}, Reach::lane, [](S& s, V v) { fill(s.gains.fuzzy.leakage, v); }},
      {fuzzy + "weight_limit", {1, 6}, Reach::lane, [](S& s, V v) { fill(s.gains.fuzzy.weight_limit, v); }},
      {fuzzy + "dead_zone", {1, 6}, Reach::lane, [](S& s, V v) { fill(s.gains.fuzzy.dead_zone, v); }},
  };
}

template <class Law>
Keys<Law> fuzzy_keys() {
  return {};
}

template <class Law>
Keys<Law> simulation_keys() {
  using S = Settings<Law>;
  return {
      {"simulation.step", {1}, Reach::pack, [](S& s, V v) { s.simulation.step = v[0]; }},
      {"simulation.substeps", {1}, Reach::pack, [](S& s, V v) { s.simulation.substeps = whole_number("simulation.substeps", v[0]); }},
      {"simulation.duration", {1}, Reach::pack, [](S& s, V v) { s.simulation.duration = v[0]; }},
      {"simulation.log_every", {1}, Reach::pack, [](S& s, V v) { s.simulation.log_every = whole_number("simulation.log_every", v[0]); }},
  };
}
// clang-format on

/// Gains that hold numbers, by the names that the law's `Gains::keys` gives them in the order of their `visit`.
template <class Law>
Keys<Law> gain_keys() {
  using S = Settings<Law>;
  using G = typename Law::template Gains<double>;
  Keys<Law> keys;
  G gains;
  std::size_t count = 0;
  const auto add = [&]<class Member>(const Member&, const Member&) {
    const std::size_t index = count++;
    const auto set = [index](S& s, Numbers numbers) {
      std::size_t place = 0;
      G::visit([&](auto& member, auto&) { place++ == index ? put(member, numbers) : void(); }, s.gains, s.gains);
    };
    if (constexpr std::size_t width = width_of<Member>(); width > 0)
      keys.push_back(
          {words("controller.", Law::name, ".", G::keys[index]), {1, width > 1 ? width : 0}, Reach::lane, set});
  };
  G::visit(add, gains, gains);
  return keys;
}

}  // namespace

template <class Law>
std::span<const KeySetter<Law>> key_setters() {
  static const Keys<Law> keys =
      joined<Law>({scene_keys<Law>(), gain_keys<Law>(), fuzzy_keys<Law>(), simulation_keys<Law>()});
  return keys;
}

#define HEXSERVO_HERE(Law) template std::span<const KeySetter<Law>> key_setters<Law>();
HEXSERVO_FOR_EACH_LAW(HEXSERVO_HERE)
#undef HEXSERVO_HERE

}  // namespace hexservo::detail
