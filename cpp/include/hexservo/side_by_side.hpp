/// @file
/// Several numbers that go through the same equations, in as few registers as they fit.
///
/// The six fuzzy systems, the six legs, the points of an image have one shape each: in a single run (`double`) they lie
/// side by side in vector registers; in a pack each of them is a register already, and they stand one after another.
/// Code over `registers` and `part` is written once for both.
///
/// A vector load of numbers that were just written one by one has to wait for them: numbers from matrices are therefore
/// gathered one by one, unless the matrix was written by `store`.
#pragma once

#include "hexservo/types.hpp"

#include <array>
#include <bit>
#include <cstring>
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
/// Doubles in the registers for `count` numbers: no more than it takes.
constexpr int register_width(int count) {
  int width = 2;
  while (width < count && width < kNativeLanes) width *= 2;
  return width;
}

template <class S, int count>
struct Placement {
  using type = S;
  static constexpr int numbers = 1;
};
template <int count>
struct Placement<double, count> {
  using type = Lanes<register_width(count)>;
  static constexpr int numbers = register_width(count);
};
}  // namespace detail

/// What one line of code works on for K numbers of type S: W doubles, or one `Lanes<W>`.
template <class S, int K = kNativeLanes>
using RegisterOf = typename detail::Placement<S, K>::type;

/// K numbers of type S, side by side; places beyond K hold zeros until something is added to them.
template <class S, int K>
class SideBySide {
 public:
  using Register = RegisterOf<S, K>;
  static constexpr int per_register = detail::Placement<S, K>::numbers;
  static constexpr std::size_t registers = (K + per_register - 1) / per_register;

  SideBySide() = default;
  SideBySide(const Vector<S, K>& numbers) { fill(numbers, std::make_index_sequence<registers>{}); }  // NOLINT: the same

  /// Of K numbers, given one by one.
  template <class... Numbers>
    requires(sizeof...(Numbers) == static_cast<std::size_t>(K))
  static SideBySide of(const Numbers&... numbers) {
    SideBySide made;
    if constexpr (per_register == 1) {
      made.part = {numbers...};
    } else {
      const std::array<S, registers* static_cast<std::size_t>(per_register)> padded = {numbers...};
      made.take(padded, std::make_index_sequence<registers>{});
    }
    return made;
  }

  static SideBySide Zero() {
    SideBySide zero;
    zero.part.fill(Register(0.0));
    return zero;
  }

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
    store(numbers.data());
    return numbers;
  }

  /// The same with zeros in the places beyond K, so that sums over all places are sums over the numbers.
  SideBySide padded() const {
    SideBySide clean = *this;
    if constexpr (rest != 0)
      clean.part[registers - 1] =
          first_lanes<rest>(part[registers - 1], std::make_integer_sequence<int, per_register>{});
    return clean;
  }

  /// K numbers that were written by `store`, or long ago.
  static SideBySide load(const S* numbers) {
    if constexpr (per_register > 1 && rest == 0) {
      SideBySide loaded;
      std::memcpy(&loaded.part, numbers, sizeof loaded.part);
      return loaded;
    } else {
      return SideBySide(Eigen::Map<const Vector<S, K>>(numbers));
    }
  }
  /// Writes K numbers, as many at a time as one store takes.
  void store(S* numbers) const {
    if constexpr (per_register == 1) {
      for (std::size_t k = 0; k < registers; ++k) numbers[k] = part[k];
    } else if constexpr (rest == 0) {
      std::memcpy(numbers, &part, sizeof part);
    } else {
      for (std::size_t r = 0; r + 1 < registers; ++r)
        std::memcpy(numbers + static_cast<int>(r) * per_register, &part[r], sizeof(Register));
      store_first<rest>(part[registers - 1], numbers + (K - rest));
    }
  }

  friend SideBySide operator+(const SideBySide& a, const SideBySide& b) {
    SideBySide sum;
    for (std::size_t r = 0; r < registers; ++r) sum.part[r] = a.part[r] + b.part[r];
    return sum;
  }
  friend SideBySide operator-(const SideBySide& a, const SideBySide& b) {
    SideBySide difference;
    for (std::size_t r = 0; r < registers; ++r) difference.part[r] = a.part[r] - b.part[r];
    return difference;
  }
  friend SideBySide operator*(const SideBySide& a, const SideBySide& b) {
    SideBySide product;
    for (std::size_t r = 0; r < registers; ++r) product.part[r] = a.part[r] * b.part[r];
    return product;
  }
  SideBySide& operator+=(const SideBySide& b) { return *this = *this + b; }
  /// One number times each of them.
  friend SideBySide operator*(const S& a, const SideBySide& b) {
    SideBySide product;
    for (std::size_t r = 0; r < registers; ++r) product.part[r] = Register(a) * b.part[r];
    return product;
  }

  /// Sum of the registers; its lanes' sum is that of the numbers where places beyond them hold zeros.
  Register lane_total() const {
    Register total = part[0];
#pragma GCC unroll 6
    for (std::size_t r = 1; r < registers; ++r) total += part[r];
    return total;
  }

  std::array<Register, registers> part;

 private:
  static constexpr int rest = K % per_register;  // numbers in the last register, where it is not full

  template <int count, int... i>
  static Register first_lanes(const Register& x, std::integer_sequence<int, i...>) {
    return detail::shuffle<(i < count ? i : per_register + i)...>(x, Register(0.0));
  }
  template <std::size_t... r>
  void take(const std::array<S, registers* static_cast<std::size_t>(per_register)>& padded, std::index_sequence<r...>) {
    ((part[r] = gather(padded, r * static_cast<std::size_t>(per_register),
                       std::make_index_sequence<static_cast<std::size_t>(per_register)>{})),
     ...);
  }
  template <std::size_t... i>
  static Register gather(const std::array<S, registers* static_cast<std::size_t>(per_register)>& padded,
                         std::size_t first, std::index_sequence<i...>) {
    return Register(typename Register::Register{padded[first + i]...});
  }
  template <int count, int W>
  static void store_first(const Lanes<W>& values, S* numbers) {
    if constexpr (count == 1) {
      *numbers = values[0];
    } else if constexpr (count == W) {
      std::memcpy(numbers, &values, sizeof values);
    } else if constexpr (count <= W / 2) {
      store_first<count>(low_half(values), numbers);
    } else {
      store_first<W / 2>(low_half(values), numbers);
      store_first<count - W / 2>(high_half(values), numbers + W / 2);
    }
  }

  template <std::size_t... r>
  void fill(const Vector<S, K>& numbers, std::index_sequence<r...>) {
    ((part[r] = gather<static_cast<int>(r) * per_register>(
          numbers, std::make_index_sequence<static_cast<std::size_t>(per_register)>{})),
     ...);
  }
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

/// True where every number is finite.
template <class S, int K>
Mask<S> is_finite(const SideBySide<S, K>& numbers) {
  const SideBySide<S, K> clean = numbers.padded();
  auto sum = clean.part[0] - clean.part[0];
#pragma GCC unroll 6
  for (std::size_t r = 1; r < SideBySide<S, K>::registers; ++r) sum += clean.part[r] - clean.part[r];
  if constexpr (std::is_same_v<S, typename SideBySide<S, K>::Register>)
    return sum == sum;
  else
    return all(sum == sum);
}

/// Entry by entry, where each lane has its own condition.
template <int W, int K>
SideBySide<Lanes<W>, K> select(LaneMask<W> condition, const SideBySide<Lanes<W>, K>& yes,
                               const SideBySide<Lanes<W>, K>& no) {
  SideBySide<Lanes<W>, K> out;
  for (std::size_t k = 0; k < out.part.size(); ++k) out.part[k] = select(condition, yes.part[k], no.part[k]);
  return out;
}

/// Each entry in all lanes of a register.
template <class R, class S, int rows, int columns>
Eigen::Matrix<R, rows, columns> broadcast(const Eigen::Matrix<S, rows, columns>& m) {
  Eigen::Matrix<R, rows, columns> registers;
#pragma GCC unroll 9
  for (int i = 0; i < rows * columns; ++i) registers(i) = R(m(i));
  return registers;
}

/// K vectors of three, side by side: a register for each coordinate.
template <class S, int K>
struct Vectors3 {
  SideBySide<S, K> x, y, z;

  Vectors3() = default;
  explicit Vectors3(const Eigen::Matrix<S, 3, K>& columns)
      : x(Vector<S, K>(columns.row(0).transpose())),
        y(Vector<S, K>(columns.row(1).transpose())),
        z(Vector<S, K>(columns.row(2).transpose())) {}

  Eigen::Matrix<S, 3, K> matrix() const {
    Eigen::Matrix<S, 3, K> columns;
    for (int k = 0; k < K; ++k) columns.col(k) = column(k);
    return columns;
  }

  using Register = typename SideBySide<S, K>::Register;
  static constexpr std::size_t registers = SideBySide<S, K>::registers;

  Vector3<S> column(int k) const { return Vector3<S>(x(k), y(k), z(k)); }

  /// One vector for each number of a register.
  Vector3<Register> part(std::size_t r) const { return Vector3<Register>(x.part[r], y.part[r], z.part[r]); }
  void set_part(std::size_t r, const Vector3<Register>& v) {
    x.part[r] = v(0);
    y.part[r] = v(1);
    z.part[r] = v(2);
  }
};

/// R v of each of K vectors.
template <class S, int K>
[[gnu::always_inline]] inline Vectors3<S, K> rotate(const Matrix3<S>& R, const Vectors3<S, K>& v) {
  using Register = typename Vectors3<S, K>::Register;
  const Matrix3<Register> turn = broadcast<Register>(R);
  Vectors3<S, K> rotated;
  for (std::size_t r = 0; r < Vectors3<S, K>::registers; ++r) rotated.set_part(r, rotate<Register>(turn, v.part(r)));
  return rotated;
}

/// Two vectors of three, one after the other: (x1, y1, z1, x2, y2, z2).
template <class S>
[[gnu::always_inline]] inline SideBySide<S, 6> stacked(const Vectors3<S, 2>& v) {
  SideBySide<S, 6> six;
  if constexpr (SideBySide<S, 2>::per_register == 1) {
    six.part = {v.x(0), v.y(0), v.z(0), v.x(1), v.y(1), v.z(1)};
  } else {
    const Lanes<2> x = v.x.part[0], y = v.y.part[0], z = v.z.part[0];
    const Lanes<2> first = detail::shuffle<0, 2>(x, y), middle = detail::shuffle<0, 3>(z, x),
                   last = detail::shuffle<1, 3>(y, z);
    if constexpr (SideBySide<S, 6>::per_register == 2) {
      six.part = {first, middle, last};
    } else {
      const Lanes<4> four = detail::shuffle<0, 1, 2, 3>(first, middle),
                     rest = detail::shuffle<0, 1, 2, 3>(last, Lanes<2>(0.0));
      if constexpr (SideBySide<S, 6>::per_register == 4)
        six.part = {four, rest};
      else
        six.part = {detail::shuffle<0, 1, 2, 3, 4, 5, 6, 7>(four, rest)};
    }
  }
  return six;
}

/// K pairs (x, y), side by side; in a vector they alternate: (x1, y1, x2, y2, ...).
template <class S, int K>
struct Pairs {
  SideBySide<S, K> x, y;

  Pairs() = default;
  /// @param alternating written by `vector`, or long ago
  Pairs(const Vector<S, 2 * K>& alternating) {  // NOLINT: the same
    if constexpr (width > 1 && K % width == 0) {
      for (std::size_t r = 0; r < SideBySide<S, K>::registers; ++r) {
        std::array<typename SideBySide<S, K>::Register, 2> two;
        std::memcpy(&two, alternating.data() + 2 * width * static_cast<int>(r), sizeof two);
        x.part[r] = even_lanes(two[0], two[1]);
        y.part[r] = odd_lanes(two[0], two[1]);
      }
    } else {
      for (int k = 0; k < static_cast<int>(SideBySide<S, K>::registers) * width; ++k) {
        x.set(k, k < K ? alternating(2 * k) : S(0.0));
        y.set(k, k < K ? alternating(2 * k + 1) : S(0.0));
      }
    }
  }

  Vector<S, 2 * K> vector() const {
    Vector<S, 2 * K> alternating;
    store(alternating.data());
    return alternating;
  }
  /// Writes 2 K numbers.
  void store(S* alternating) const {
    if constexpr (width > 1 && K % width == 0) {
      for (std::size_t r = 0; r < SideBySide<S, K>::registers; ++r) {
        const std::array two = {alternate_low(x.part[r], y.part[r]), alternate_high(x.part[r], y.part[r])};
        std::memcpy(alternating + 2 * width * static_cast<int>(r), &two, sizeof two);
      }
    } else {
      for (int k = 0; k < K; ++k) {
        alternating[2 * k] = x(k);
        alternating[2 * k + 1] = y(k);
      }
    }
  }

  friend Pairs operator-(const Pairs& a, const Pairs& b) { return {a.x - b.x, a.y - b.y}; }
  friend Pairs operator*(const Pairs& a, const Pairs& b) { return {a.x * b.x, a.y * b.y}; }

 private:
  static constexpr int width = SideBySide<S, K>::per_register;

  Pairs(const SideBySide<S, K>& x_, const SideBySide<S, K>& y_) : x(x_), y(y_) {}
};

/// Sums over the lanes of two registers of numbers S.
template <class S, class R>
SideBySide<S, 2> lane_sums(const R& a, const R& b) {
  SideBySide<S, 2> sums;
  if constexpr (std::is_same_v<S, R>)
    sums.part = {a, b};
  else
    sums.part = {lane_sums(a, b)};
  return sums;
}

/// Lower triangle of a symmetric matrix of lane sums, and zeros.
/// @param entry (row, column) -> register whose lanes are summed; two at a time
template <class S, class Entry>
[[gnu::always_inline]] inline Matrix6<S> lower_lane_sums(const Entry& entry) {
  Matrix6<S> sums = Matrix6<S>::Zero();
#pragma GCC unroll 6
  for (int j = 0; j < 6; ++j)
#pragma GCC unroll 6
    for (int i = j; i < 6; i += 2) {
      const int next = i + 1 < 6 ? i + 1 : i;
      const SideBySide<S, 2> two = lane_sums<S>(entry(i, j), entry(next, j));
      sums(i, j) = two(0);
      sums(next, j) = two(1);
    }
  return sums;
}

/// a . b and c . d; places beyond the numbers must hold zeros in a and c, or in b and d, and finite numbers in the
/// others.
template <class S, int K>
std::array<S, 2> dots(const SideBySide<S, K>& a, const SideBySide<S, K>& b, const SideBySide<S, K>& c,
                      const SideBySide<S, K>& d) {
  auto first = a.part[0] * b.part[0], second = c.part[0] * d.part[0];
#pragma GCC unroll 6
  for (std::size_t r = 1; r < SideBySide<S, K>::registers; ++r) {
    first += a.part[r] * b.part[r];
    second += c.part[r] * d.part[r];
  }
  const SideBySide<S, 2> sums = lane_sums<S>(first, second);
  return {sums(0), sums(1)};
}

}  // namespace hexservo
