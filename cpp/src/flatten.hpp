/// @file
/// Parameter structs as rows of doubles, and back, by the `visit` that names their members.
#pragma once

#include "hexservo/parameters.hpp"

#include <Eigen/Core>

#include <type_traits>

namespace hexservo::detail {

template <class T, class F>
void for_each_leaf(T& value, F& f);

/// Visitor that goes on to the leaves: like the functions below a separate type, so that a block is compiled once for
/// all that contain it.
template <class F>
struct LeafVisitor {
  F& f;
  void operator()(const Field& /*field*/, auto& member) const { for_each_leaf(member, f); }
};

/// Calls `f` with every number, flag, mode and matrix inside a struct, in the order of `visit`.
template <class T, class F>
void for_each_leaf(T& value, F& f) {
  if constexpr (Visited<T>)
    std::remove_const_t<T>::visit(LeafVisitor<F>{f}, value);
  else
    f(value);
}

/// A leaf that is one number; the others are matrices.
template <class T>
inline constexpr bool is_number = std::is_arithmetic_v<T> || std::is_enum_v<T>;

struct LeafCounter {
  long long count = 0;
  template <class Leaf>
  void operator()(const Leaf& leaf) {
    if constexpr (is_number<Leaf>)
      count += 1;
    else
      count += leaf.size();
  }
};

struct LeafWriter {
  double* to;
  template <class Leaf>
  void operator()(const Leaf& leaf) {
    if constexpr (is_number<Leaf>)
      *to++ = static_cast<double>(leaf);
    else
      for (Eigen::Index i = 0; i < leaf.size(); ++i) *to++ = leaf(i);
  }
};

struct LeafReader {
  const double* from;
  template <class Leaf>
  void operator()(Leaf& leaf) {
    if constexpr (std::is_enum_v<Leaf>)
      leaf = static_cast<Leaf>(static_cast<int>(*from++));
    else if constexpr (std::is_same_v<Leaf, bool>)
      leaf = *from++ != 0.0;
    else if constexpr (is_number<Leaf>)
      leaf = static_cast<Leaf>(*from++);
    else
      for (Eigen::Index i = 0; i < leaf.size(); ++i) leaf(i) = *from++;
  }
};

/// How many doubles a struct takes.
template <class T>
long long flat_size(const T& value) {
  LeafCounter counter;
  for_each_leaf(value, counter);
  return counter.count;
}

/// Writes a struct to `flat_size` doubles.
template <class T>
void flatten(const T& value, double* to) {
  LeafWriter writer{to};
  for_each_leaf(value, writer);
}

/// Reads what `flatten` wrote.
template <class T>
void unflatten(T& value, const double* from) {
  LeafReader reader{from};
  for_each_leaf(value, reader);
}

}  // namespace hexservo::detail
