/// @file
/// Parameter structs as rows of doubles, and back, by the `visit` that names their members.
#pragma once

#include "hexservo/parameters.hpp"

#include <Eigen/Core>

#include <type_traits>

namespace hexservo::detail {

/// Calls `f` with every number, flag, mode and matrix inside a struct, in the order of `visit`.
template <class T, class F>
void for_each_leaf(T& value, F&& f) {
  if constexpr (Visited<T>)
    std::remove_const_t<T>::visit([&f](const Field&, auto& member) { for_each_leaf(member, f); }, value);
  else
    f(value);
}

/// A leaf that is one number; the others are matrices.
template <class T>
inline constexpr bool is_number = std::is_arithmetic_v<T> || std::is_enum_v<T>;

/// How many doubles a struct takes.
template <class T>
long long flat_size(const T& value) {
  long long count = 0;
  for_each_leaf(value, [&count]<class Leaf>(const Leaf& leaf) {
    if constexpr (is_number<Leaf>)
      count += 1;
    else
      count += leaf.size();
  });
  return count;
}

/// Writes a struct to `flat_size` doubles.
template <class T>
void flatten(const T& value, double* to) {
  for_each_leaf(value, [&to]<class Leaf>(const Leaf& leaf) {
    if constexpr (is_number<Leaf>)
      *to++ = static_cast<double>(leaf);
    else
      for (Eigen::Index i = 0; i < leaf.size(); ++i) *to++ = leaf(i);
  });
}

/// Reads what `flatten` wrote.
template <class T>
void unflatten(T& value, const double* from) {
  for_each_leaf(value, [&from]<class Leaf>(Leaf& leaf) {
    if constexpr (std::is_enum_v<Leaf>)
      leaf = static_cast<Leaf>(static_cast<int>(*from++));
    else if constexpr (std::is_same_v<Leaf, bool>)
      leaf = *from++ != 0.0;
    else if constexpr (is_number<Leaf>)
      leaf = static_cast<Leaf>(*from++);
    else
      for (Eigen::Index i = 0; i < leaf.size(); ++i) leaf(i) = *from++;
  });
}

}  // namespace hexservo::detail
