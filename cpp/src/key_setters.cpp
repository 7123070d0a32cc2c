#include "key_setters.hpp"

#include "check.hpp"

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

using S = Settings<Hybrid>;
using V = Numbers;

// clang-format off
constexpr std::array kHybridKeys = {
    KeySetter<Hybrid>{"robot.platform_radius", {1}, Reach::legs, [](S& s, V v) { s.robot.platform_radius = v[0]; }},
    KeySetter<Hybrid>{"robot.base_radius", {1}, Reach::legs, [](S& s, V v) { s.robot.base_radius = v[0]; }},
    KeySetter<Hybrid>{"robot.platform_angles", {6}, Reach::legs, [](S& s, V v) { fill(s.robot.platform_angles, v); }},
    KeySetter<Hybrid>{"robot.base_angles", {6}, Reach::legs, [](S& s, V v) { fill(s.robot.base_angles, v); }},
    KeySetter<Hybrid>{"robot.home_position", {3}, Reach::legs, [](S& s, V v) { fill(s.robot.home_position, v); }},
    KeySetter<Hybrid>{"robot.mass", {1}, Reach::lane, [](S& s, V v) { s.robot.mass = v[0]; }},
    KeySetter<Hybrid>{"robot.inertia", {3, 9}, Reach::lane, [](S& s, V v) { fill_inertia(s.robot.inertia, v); }},
    KeySetter<Hybrid>{"robot.stroke", {1}, Reach::legs, [](S& s, V v) { s.robot.stroke = v[0]; }},
    KeySetter<Hybrid>{"robot.force_limit", {1}, Reach::legs, [](S& s, V v) { s.robot.force_limit = v[0]; }},
    KeySetter<Hybrid>{"camera.focal_length", {1}, Reach::lane, [](S& s, V v) { s.camera.focal_length = v[0]; }},
    KeySetter<Hybrid>{"camera.pixel_scale", {1}, Reach::lane, [](S& s, V v) { s.camera.pixel_scale = v[0]; }},
    KeySetter<Hybrid>{"target.initial_features", {8}, Reach::lane, [](S& s, V v) { fill(s.target.initial_features, v); }},
    KeySetter<Hybrid>{"target.desired_features", {8}, Reach::lane, [](S& s, V v) { fill(s.target.desired_features, v); }},
    KeySetter<Hybrid>{"target.depth", {1, 4}, Reach::lane, [](S& s, V v) { fill(s.target.depth, v); }},
    KeySetter<Hybrid>{"target.points", {12}, Reach::lane, [](S& s, V v) { fill_points(s.target, v); }},
    KeySetter<Hybrid>{"uncertainty.inertia", {1, 36}, Reach::lane, [](S& s, V v) { fill(s.uncertainty.dynamics.inertia, v); }},
    KeySetter<Hybrid>{"uncertainty.coriolis", {1, 36}, Reach::lane, [](S& s, V v) { fill(s.uncertainty.dynamics.coriolis, v); }},
    KeySetter<Hybrid>{"uncertainty.gravity", {1, 6}, Reach::lane, [](S& s, V v) { fill(s.uncertainty.dynamics.gravity, v); }},
    KeySetter<Hybrid>{"uncertainty.depth", {1, 4}, Reach::lane, [](S& s, V v) { fill(s.uncertainty.depth, v); }},
    KeySetter<Hybrid>{"controller.switching.width", {1}, Reach::lane, [](S& s, V v) { s.switching.width = v[0]; }},
    KeySetter<Hybrid>{"controller.hybrid.kp", {1, 8}, Reach::lane, [](S& s, V v) { fill(s.gains.kp, v); }},
    KeySetter<Hybrid>{"controller.hybrid.kv", {1, 6}, Reach::lane, [](S& s, V v) { fill(s.gains.kv, v); }},
    KeySetter<Hybrid>{"controller.hybrid.fuzzy.adaptation", {1, 6}, Reach::lane, [](S& s, V v) { fill(s.gains.fuzzy.adaptation, v); }},
    KeySetter<Hybrid>{"controller.hybrid.fuzzy.error_scale", {1, 6}, Reach::lane, [](S& s, V v) { fill(s.gains.fuzzy.error_scale, v); }},
    KeySetter<Hybrid>{"controller.hybrid.fuzzy.rate_scale", {1, 6}, Reach::lane, [](S& s, V v) { fill(s.gains.fuzzy.rate_scale, v); }},
    KeySetter<Hybrid>{"controller.hybrid.fuzzy.initial_scale", {1, 6}, Reach::lane, [](S& s, V v) { fill(s.gains.fuzzy.initial_scale, v); }},
    KeySetter<Hybrid>{"controller.hybrid.fuzzy.table", {49}, Reach::lane, [](S& s, V v) { fill(s.gains.fuzzy.table, v); }},
    KeySetter<Hybrid>{"controller.hybrid.fuzzy.bell_width", {1}, Reach::lane, [](S& s, V v) { s.gains.fuzzy.bell_width = v[0]; }},
    KeySetter<Hybrid>{"controller.hybrid.fuzzy.bell_slope", {1}, Reach::pack, [](S& s, V v) { s.gains.fuzzy.bell_slope = v[0]; }},
    KeySetter<Hybrid>{"simulation.step", {1}, Reach::pack, [](S& s, V v) { s.simulation.step = v[0]; }},
    KeySetter<Hybrid>{"simulation.duration", {1}, Reach::pack, [](S& s, V v) { s.simulation.duration = v[0]; }},
    KeySetter<Hybrid>{"simulation.log_every", {1}, Reach::pack, [](S& s, V v) { s.simulation.log_every = whole_number("simulation.log_every", v[0]); }},
};
// clang-format on

}  // namespace

template <>
std::span<const KeySetter<Hybrid>> key_setters<Hybrid>() {
  return kHybridKeys;
}

}  // namespace hexservo::detail
