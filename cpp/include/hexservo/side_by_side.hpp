/// @file
/// Several numbers that go through the same equations, in as few registers as they fit.
///
/// The six fuzzy systems have one shape: in a single run (`double`) they lie side by side in vector registers; in a
/// pack each of them is a register already, and they stand one after another. Code over `registers` and `part` is
/// written once for both.
#pragma once

#include "hexservo/types.hpp"

#include <array>
#include <utility>

namespace hexservo {

/// Doubles in one vector register of the instruction set that this code is compiled for.
#if defined(__AVX512F__)
inline constexpr int kNativeLanes = 8;
#elif defined(__AVX__)
inline constexpr int kNativeLanes = 4;
#else
inline constexpr int kNativeLanes = 2;
#endif

namespace detail {
template <class S>
struct Placement {
  using type = S;
  static constexpr int numbers = 1;
};
template <>
struct Placement<double> {
  using type = Lanes<kNativeLanes>;
  static constexpr int numbers = kNativeLanes;
};
}  // namespace detail

/// What one line of code works on: W doubles, or one `Lanes<W>`.
template <class S>
using RegisterOf = typename detail::Placement<S>::type;

/// K numbers of type S, side by side; places beyond K hold zeros.
template <class S, int K>
class SideBySide {
 public:
  using Register = RegisterOf<S>;
  static constexpr int per_register = detail::Placement<S>::numbers;
  static constexpr std::size_t registers = (K + per_register - 1) / per_register;

  SideBySide() = default;
  SideBySide(const Vector<S, K>& numbers) { fill(numbers, std::make_index_sequence<registers>{}); }  // NOLINT: the same

  S operator()(int k) const {
    if constexpr (per_register == 1)
      return part[static_cast<std::size_t>(k)];
    else
      return part[static_cast<std::size_t>(k / per_register)][k % per_register];
  }
  void set(int k, const S& value) {
    if constexpr (per_register == 1)
      part[static_cast<std::size_t>(k)] = value;
    else
      part[static_cast<std::size_t>(k / per_register)].set(k % per_register, value);
  }
  Vector<S, K> vector() const {
    Vector<S, K> numbers;
    for (int k = 0; k < K; ++k) numbers(k) = (*this)(k);
    return numbers;
  }

  friend SideBySide operator*(const SideBySide& a, const SideBySide& b) {
    SideBySide product;
    for (std::size_t r = 0; r < registers; ++r) product.part[r] = a.part[r] * b.part[r];
    return product;
  }

  std::array<Register, registers> part;

 private:
  template <std::size_t... r>
  void fill(const Vector<S, K>& numbers, std::index_sequence<r...>) {
    ((part[r] = gather<static_cast<int>(r) * per_register>(
          numbers, std::make_index_sequence<static_cast<std::size_t>(per_register)>{})),
     ...);
  }
  /// Built from single numbers: a vector load of numbers that were just written one by one would have to wait.
  template <int first, std::size_t... i>
  static Register gather(const Vector<S, K>& numbers, std::index_sequence<i...>) {
    if constexpr (per_register == 1) {
      return numbers(first);
    } else {
      return Register(typename Register::Register{number<first + static_cast<int>(i)>(numbers)...});
    }
  }
  template <int k>
  static S number(const Vector<S, K>& numbers) {
    if constexpr (k < K)
      return numbers(k);
    else
      return S(0.0);
  }
};

}  // namespace hexservo
