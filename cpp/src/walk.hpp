/// @file
/// Walks over the parameters that a struct names by its `visit`, block by block.
#pragma once

#include "check.hpp"
#include "hexservo/parameters.hpp"

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

namespace hexservo::detail {

/// Where a walk is: its text is made on demand.
struct Path {
  const Path* around = nullptr;
  std::string_view block{};            ///< name that its keys begin with, without a dot
  std::span<const UnitOf> units = {};  ///< that hold here in place of a field's own

  std::string key(std::string_view name) const {
    const std::string head = around != nullptr ? around->key(block) : std::string(block);
    return head.empty() ? std::string(name) : head + "." + std::string(name);
  }
  std::string_view unit(const Field& field) const {
    for (const UnitOf& other : units)
      if (other.name == field.name) return other.unit;
    return field.unit;
  }
};

/// Calls `f(path, field, member)` with every parameter of a block and of the blocks in it.
template <class T, class F>
void walk(const Path& path, T& block, F&& f) {
  std::remove_const_t<T>::visit(
      [&](const Field& field, auto& member) {
        if (!field.key) return;
        if constexpr (Visited<std::remove_reference_t<decltype(member)>>)
          walk(Path{&path, field.name, field.units}, member, f);
        else
          f(path, field, member);
      },
      block);
}

/// Describes what a bound requires.
inline std::string expected(const Bound& bound, bool whole) {
  const bool low = std::isfinite(bound.least), high = std::isfinite(bound.most);
  if (bound.least == 0.0 && bound.above && !high && std::isnan(bound.none)) return "a finite number > 0";
  if (bound.least == 0.0 && bound.most == 1.0 && !bound.above && !bound.below) return "a probability from 0 to 1";
  if (low && high && !bound.above && !bound.below)
    return words(whole ? "a whole number from " : "a number from ", bound.least, " to ", bound.most);
  std::string text = !low && !high ? "a finite number" : "a number";
  if (low) text += words(bound.above ? " > " : " >= ", bound.least);
  if (high) text += words(low ? " and" : "", bound.below ? " < " : " <= ", bound.most);
  return text;
}

[[noreturn]] inline void refuse_number(const std::string& key, const Bound& bound, double value) {
  if (!std::isfinite(value) && !(bound.none > 0.0) && !bound.above) refuse(key, expected(kFinite, false), words(value));
  refuse(key, expected(bound, false), words(value));
}

inline void require_within(const Path& path, const Field& field, double value) {
  if (!field.bound.holds(value)) refuse_number(path.key(field.name), field.bound, value);
}
inline void require_within(const Path& path, const Field& field, long long value) {
  if (!field.bound.holds(static_cast<double>(value)))
    refuse(path.key(field.name), expected(field.bound, true), words(value));
}
/// Names the first entry that is out of bounds, counted from 0: [row] of a vector, [row][column] of a matrix.
template <int R, int C, int options, int max_rows>
void require_within(const Path& path, const Field& field,
                    const Eigen::Matrix<double, R, C, options, max_rows, C>& value) {
  for (Eigen::Index row = 0; row < value.rows(); ++row)
    for (int column = 0; column < C; ++column)
      if (!field.bound.holds(value(row, column)))
        refuse_number(words(path.key(field.name), "[", row, "]", C > 1 ? words("[", column, "]") : ""), field.bound,
                      value(row, column));
}
template <class T>
void require_within(const Path& path, const Field& field, const std::optional<T>& value) {
  if (value) require_within(path, field, *value);
}
inline void require_within(const Path& path, const Field& field,
                           const std::shared_ptr<const std::vector<double>>& samples) {
  const auto columns = static_cast<std::size_t>(field.columns);
  for (std::size_t i = 0; samples && i < samples->size(); ++i)
    if (!field.bound.holds((*samples)[i]))
      refuse_number(words(path.key(field.name), "[", i / columns, "][", i % columns, "]"), field.bound, (*samples)[i]);
}
template <class T>
  requires(std::is_enum_v<T> || std::is_same_v<T, bool> || std::is_same_v<T, std::uint64_t>)
void require_within(const Path& /*path*/, const Field& /*field*/, T /*value*/) {}

/// Checks a block by the bounds of its fields.
/// @param name what its keys begin with, "robot"
/// @throws std::invalid_argument naming the scenario key
template <class T>
void require_bounds(std::string_view name, const T& block) {
  walk(Path{nullptr, name}, block,
       [](const Path& path, const Field& field, const auto& member) { require_within(path, field, member); });
}

}  // namespace hexservo::detail
