/// @file
/// A pack of lanes as an Eigen scalar, and the branch-free functions that the equations use on either scalar.
///
/// Every equation of the core is written once, templated on a scalar `S` that is `double` or `Lanes<W>` (W independent
/// numbers in one vector register). Comparisons of packs give a `LaneMask`, which does not convert to bool, so that a
/// branch on data does not compile; `select`, `clip`, `min` and `max` stand in for it and let NaN through, where the
/// processor's own minimum and maximum would swallow it.
#pragma once

#include <Eigen/Core>

#if defined(__SSE2__)
#include <immintrin.h>
#endif

#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <type_traits>
#include <utility>

namespace hexservo {

/// Vector registers of W doubles, and of the W truth values that their comparison gives (all bits set: true).
template <int W>
struct LaneRegister;
template <>
struct LaneRegister<2> {
  typedef double Values __attribute__((vector_size(16)));
  typedef std::int64_t Bits __attribute__((vector_size(16)));
};
template <>
struct LaneRegister<4> {
  typedef double Values __attribute__((vector_size(32)));
  typedef std::int64_t Bits __attribute__((vector_size(32)));
};
template <>
struct LaneRegister<8> {
  typedef double Values __attribute__((vector_size(64)));
  typedef std::int64_t Bits __attribute__((vector_size(64)));
};

/// W truth values, one per lane.
template <int W>
class LaneMask {
 public:
  using Register = typename LaneRegister<W>::Bits;

  LaneMask() = default;
  explicit LaneMask(bool value) : bits_(value ? ~Register{} : Register{}) {}
  explicit LaneMask(Register bits) : bits_(bits) {}

  bool operator[](int lane) const { return bits_[lane] != 0; }
  Register bits() const { return bits_; }

  friend LaneMask operator&(LaneMask a, LaneMask b) { return LaneMask(a.bits_ & b.bits_); }
  friend LaneMask operator|(LaneMask a, LaneMask b) { return LaneMask(a.bits_ | b.bits_); }
  friend LaneMask operator!(LaneMask a) { return LaneMask(~a.bits_); }

 private:
  Register bits_;
};

/// W independent doubles in one vector register: the Eigen scalar of batches.
template <int W>
class Lanes {
 public:
  static constexpr int width = W;
  using Mask = LaneMask<W>;
  using Register = typename LaneRegister<W>::Values;

  Lanes() = default;
  Lanes(double value) : values_(value - Register{}) {}  // NOLINT: implicit, as a scalar is; x - 0 keeps -0
  explicit Lanes(Register values) : values_(values) {}

  double operator[](int lane) const { return values_[lane]; }
  void set(int lane, double value) { values_[lane] = value; }
  Register values() const { return values_; }

  Lanes& operator+=(Lanes b) { return *this = *this + b; }
  Lanes& operator-=(Lanes b) { return *this = *this - b; }
  Lanes& operator*=(Lanes b) { return *this = *this * b; }
  Lanes& operator/=(Lanes b) { return *this = *this / b; }

  friend Lanes operator-(Lanes a) { return Lanes(-a.values_); }
  friend Lanes operator+(Lanes a, Lanes b) { return Lanes(a.values_ + b.values_); }
  friend Lanes operator-(Lanes a, Lanes b) { return Lanes(a.values_ - b.values_); }
  friend Lanes operator*(Lanes a, Lanes b) { return Lanes(a.values_ * b.values_); }
  friend Lanes operator/(Lanes a, Lanes b) { return Lanes(a.values_ / b.values_); }

  friend Mask operator<(Lanes a, Lanes b) { return Mask(a.values_ < b.values_); }
  friend Mask operator>(Lanes a, Lanes b) { return Mask(a.values_ > b.values_); }
  friend Mask operator<=(Lanes a, Lanes b) { return Mask(a.values_ <= b.values_); }
  friend Mask operator>=(Lanes a, Lanes b) { return Mask(a.values_ >= b.values_); }
  friend Mask operator==(Lanes a, Lanes b) { return Mask(a.values_ == b.values_); }
  friend Mask operator!=(Lanes a, Lanes b) { return Mask(a.values_ != b.values_); }

 private:
  Register values_;
};

/// What a comparison of two `S` gives: bool, or one truth value per lane.
template <class S>
using Mask = decltype(std::declval<S>() < std::declval<S>());

/// True where the lane's condition holds, chosen lane by lane; both sides are evaluated.
template <class T>
T select(bool condition, const T& yes, const T& no) {
  return condition ? yes : no;
}
template <int W>
Lanes<W> select(LaneMask<W> condition, Lanes<W> yes, Lanes<W> no) {
  return Lanes<W>(condition.bits() ? yes.values() : no.values());
}
/// The same, entry by entry of a matrix (one condition for all entries).
template <int W, int R, int C>
Eigen::Matrix<Lanes<W>, R, C> select(LaneMask<W> condition, const Eigen::Matrix<Lanes<W>, R, C>& yes,
                                     const Eigen::Matrix<Lanes<W>, R, C>& no) {
  Eigen::Matrix<Lanes<W>, R, C> out;
  for (int i = 0; i < R * C; ++i) out(i) = select(condition, yes(i), no(i));
  return out;
}

inline bool any(bool mask) { return mask; }
inline bool all(bool mask) { return mask; }
template <int W>
bool any(LaneMask<W> mask) {
#if defined(__SSE2__)
  if constexpr (W == 2) return _mm_movemask_pd(std::bit_cast<__m128d>(mask.bits())) != 0;
#endif
#if defined(__AVX__)
  if constexpr (W == 4) return _mm256_movemask_pd(std::bit_cast<__m256d>(mask.bits())) != 0;
#endif
#if defined(__AVX512F__)
  if constexpr (W == 8) {
    const __m512i bits = std::bit_cast<__m512i>(mask.bits());
    return _mm512_test_epi64_mask(bits, bits) != 0;
  }
#endif
  bool result = false;
  for (int i = 0; i < W; ++i) result = result || mask[i];
  return result;
}
template <int W>
bool all(LaneMask<W> mask) {
  return !any(!mask);
}

namespace detail {
/// Lanes i... of the 2 W of a and b together.
template <int... i, int W>
Lanes<sizeof...(i)> shuffle(Lanes<W> a, Lanes<W> b) {
  return Lanes<sizeof...(i)>(__builtin_shufflevector(a.values(), b.values(), i...));
}

/// a0 b0 a2 b2 ..., and a1 b1 a3 b3 ... for `first` = 1.
template <int first, int W, int... pair>
Lanes<W> every_other(Lanes<W> a, Lanes<W> b, std::integer_sequence<int, pair...>) {
  return shuffle<(pair % 2 == 0 ? pair + first : W + pair - 1 + first)...>(a, b);
}
template <int first, int W, int... i>
Lanes<W> from_step_two(Lanes<W> a, Lanes<W> b, std::integer_sequence<int, i...>) {
  return shuffle<(2 * i + first)...>(a, b);
}
template <int first, int W, int... i>
Lanes<W> alternate(Lanes<W> a, Lanes<W> b, std::integer_sequence<int, i...>) {
  return shuffle<(first + i / 2 + (i % 2) * W)...>(a, b);
}
template <int first, int W, int... i>
Lanes<W / 2> half(Lanes<W> x, std::integer_sequence<int, i...>) {
  return shuffle<(first + i)...>(x, x);
}
template <int W>
using Indices = std::make_integer_sequence<int, W>;
}  // namespace detail

/// The even lanes of a, then those of b.
template <int W>
Lanes<W> even_lanes(Lanes<W> a, Lanes<W> b) {
  return detail::from_step_two<0>(a, b, detail::Indices<W>{});
}
/// The odd lanes of a, then those of b.
template <int W>
Lanes<W> odd_lanes(Lanes<W> a, Lanes<W> b) {
  return detail::from_step_two<1>(a, b, detail::Indices<W>{});
}
/// The first W of a0 b0 a1 b1 ...
template <int W>
Lanes<W> alternate_low(Lanes<W> a, Lanes<W> b) {
  return detail::alternate<0>(a, b, detail::Indices<W>{});
}
/// The last W of a0 b0 a1 b1 ...
template <int W>
Lanes<W> alternate_high(Lanes<W> a, Lanes<W> b) {
  return detail::alternate<W / 2>(a, b, detail::Indices<W>{});
}
/// First and last half of the lanes.
template <int W>
Lanes<W / 2> low_half(Lanes<W> x) {
  return detail::half<0>(x, detail::Indices<W / 2>{});
}
template <int W>
Lanes<W / 2> high_half(Lanes<W> x) {
  return detail::half<W / 2>(x, detail::Indices<W / 2>{});
}

/// Sum over the lanes of a, and that of b.
template <int W>
Lanes<2> lane_sums(Lanes<W> a, Lanes<W> b) {
  const Lanes<W> pairs =
      detail::every_other<0>(a, b, detail::Indices<W>{}) + detail::every_other<1>(a, b, detail::Indices<W>{});
  if constexpr (W == 2)
    return pairs;
  else if constexpr (W == 4)
    return low_half(pairs) + high_half(pairs);
  else {
    const Lanes<4> four = low_half(pairs) + high_half(pairs);
    return low_half(four) + high_half(four);
  }
}

namespace detail {
/// A function of one double, applied lane by lane.
template <int W, class F>
Lanes<W> map_lanes(Lanes<W> x, F&& function) {
  Lanes<W> out;
  for (int i = 0; i < W; ++i) out.set(i, function(x[i]));
  return out;
}
}  // namespace detail

/// Scenarios in one scalar: 1, or the lanes of a pack.
template <class S>
inline constexpr int kLanes = 1;
template <int W>
inline constexpr int kLanes<Lanes<W>> = W;

/// One lane of a pack, or the number itself.
inline double of_lane(double value, int) { return value; }
inline bool of_lane(bool value, int) { return value; }
template <int W>
double of_lane(Lanes<W> value, int lane) {
  return value[lane];
}
template <int W>
bool of_lane(LaneMask<W> mask, int lane) {
  return mask[lane];
}

/// Square root of a register: one instruction where the instruction set has it.
template <int W>
Lanes<W> sqrt(Lanes<W> x) {
#if defined(__SSE2__)
  if constexpr (W == 2)
    return Lanes<W>(std::bit_cast<typename Lanes<W>::Register>(_mm_sqrt_pd(std::bit_cast<__m128d>(x.values()))));
#endif
#if defined(__AVX__)
  if constexpr (W == 4)
    return Lanes<W>(std::bit_cast<typename Lanes<W>::Register>(_mm256_sqrt_pd(std::bit_cast<__m256d>(x.values()))));
#endif
#if defined(__AVX512F__)
  if constexpr (W == 8)
    return Lanes<W>(std::bit_cast<typename Lanes<W>::Register>(_mm512_sqrt_pd(std::bit_cast<__m512d>(x.values()))));
#endif
  return detail::map_lanes(x, [](double v) { return std::sqrt(v); });
}
template <int W>
Lanes<W> atan(Lanes<W> x) {
  return detail::map_lanes(x, [](double v) { return std::atan(v); });
}
template <int W>
Lanes<W> atan2(Lanes<W> y, Lanes<W> x) {
  Lanes<W> out;
  for (int i = 0; i < W; ++i) out.set(i, std::atan2(y[i], x[i]));
  return out;
}
template <int W>
Lanes<W> exp(Lanes<W> x) {
  return detail::map_lanes(x, [](double v) { return std::exp(v); });
}
template <int W>
Lanes<W> pow(Lanes<W> x, double exponent) {
  return detail::map_lanes(x, [exponent](double v) { return std::pow(v, exponent); });
}
template <int W>
Lanes<W> floor(Lanes<W> x) {
  return detail::map_lanes(x, [](double v) { return std::floor(v); });
}
template <int W>
Lanes<W> abs(Lanes<W> x) {
  constexpr std::int64_t kAllButTheSign = std::numeric_limits<std::int64_t>::max();
  using Bits = typename LaneRegister<W>::Bits;
  return Lanes<W>(std::bit_cast<typename Lanes<W>::Register>(std::bit_cast<Bits>(x.values()) & kAllButTheSign));
}

/// Larger of two; NaN if either is NaN.
template <class S>
S max(const S& a, const S& b) {
  return select(a > b, a, select(a != a, a, b));
}
/// Smaller of two; NaN if either is NaN.
template <class S>
S min(const S& a, const S& b) {
  return select(a < b, a, select(a != a, a, b));
}
/// Larger of two, of which neither is NaN, or NaN does not matter: one instruction.
template <class S>
S larger(const S& a, const S& b) {
  return select(a > b, a, b);
}
/// x limited to [low, high]; NaN stays NaN. Two instructions, the processor's own minimum and maximum.
template <class S>
S clip(const S& x, const S& low, const S& high) {
  const S below = select(x > high, high, x);
  return select(low > below, low, below);
}
/// -1, 0 or 1 with sgn(0) = 0; NaN stays NaN.
template <class S>
S sign(const S& x) {
  return select(x > S(0.0), S(1.0), select(x < S(0.0), S(-1.0), x));
}
/// True where x is neither infinite nor NaN.
template <class S>
Mask<S> is_finite(const S& x) {
  const S zero = x - x;  // NaN for NaN and for either infinity
  return zero == zero;
}
/// True where every entry is finite.
template <class S, int R, int C>
Mask<S> is_finite(const Eigen::Matrix<S, R, C>& m) {
  S sum = m(0) - m(0);
  for (int i = 1; i < R * C; ++i) sum += m(i) - m(i);
  return sum == sum;
}

/// Largest absolute entry; NaN if any entry is.
template <class S, int R, int C>
S largest_abs(const Eigen::Matrix<S, R, C>& m) {
  using std::abs;
  S result = abs(m(0));
  for (int i = 1; i < R * C; ++i) result = max(result, S(abs(m(i))));
  return result;
}

/// Copies the scenario `source` (all doubles) into one lane of the pack `target`.
///
/// Works on numbers, fixed-size matrices, and on parameter structs, which name their members once in a
/// static `visit`. A member that has the same type on both sides (a flag, a mode, a time grid) must be uniform in a
/// pack.
template <class T>
void set_lane(T& target, int lane, const T& source) {
  if (lane == 0) {
    target = source;
  } else if (!(target == source)) {
    throw std::invalid_argument("pack: expected flags, modes and time grids that agree in all lanes");
  }
}
template <int W>
void set_lane(Lanes<W>& target, int lane, double source) {
  target.set(lane, source);
}
template <int W, int R, int C>
void set_lane(Eigen::Matrix<Lanes<W>, R, C>& target, int lane, const Eigen::Matrix<double, R, C>& source) {
  for (int i = 0; i < R * C; ++i) target(i).set(lane, source(i));
}
template <class Pack, class Single>
  requires(!std::is_same_v<Pack, Single>)
void set_lane(Pack& target, int lane, const Single& source);

namespace detail {
/// Sets one lane of what a visit names: a separate type, so that a block is compiled once for all that contain it.
struct LaneSetter {
  int lane;
  void operator()(const auto& /*field*/, auto& to, const auto& from) const { set_lane(to, lane, from); }
};
}  // namespace detail

template <class Pack, class Single>
  requires(!std::is_same_v<Pack, Single>)
void set_lane(Pack& target, int lane, const Single& source) {
  Pack::visit(detail::LaneSetter{lane}, target, source);
}

}  // namespace hexservo

namespace Eigen {
template <int W>
struct NumTraits<hexservo::Lanes<W>> {
  using Real = hexservo::Lanes<W>;
  using NonInteger = Real;
  using Nested = Real;
  using Literal = Real;
  enum {
    IsComplex = 0,
    IsInteger = 0,
    IsSigned = 1,
    RequireInitialization = 0,
    ReadCost = 1,
    AddCost = 1,
    MulCost = 1
  };
  static Real epsilon() { return std::numeric_limits<double>::epsilon(); }
  static Real dummy_precision() { return 1e-12; }
  static Real highest() { return std::numeric_limits<double>::max(); }
  static Real lowest() { return std::numeric_limits<double>::lowest(); }
  static int digits10() { return std::numeric_limits<double>::digits10; }
};
}  // namespace Eigen
