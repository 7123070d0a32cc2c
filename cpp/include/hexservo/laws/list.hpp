/// @file
/// The one list of control laws. What exists once per law (numbers, explicit instantiations, bindings) follows from it.
///
/// A new law is a header with its gains, traits and equation beside this one, its name here, its line in laws.hpp (this
/// file is read where no law's equation is), and a block of gains in scenario/laws.py.
#pragma once

#include <type_traits>

/// Applies a macro to the name of every law, in the order of `LawId`.
#define HEXSERVO_FOR_EACH_LAW(apply) \
  apply(Hybrid) apply(Composite) apply(Kelly) apply(ResolvedRate) apply(Pbvs) apply(ComputedTorque) apply(Tracking)

namespace hexservo {

#define HEXSERVO_DECLARE(Law) struct Law;
HEXSERVO_FOR_EACH_LAW(HEXSERVO_DECLARE)
#undef HEXSERVO_DECLARE

/// Number of each law, on its way to a kernel.
enum class LawId : int {
#define HEXSERVO_NUMBER(Law) Law,
  HEXSERVO_FOR_EACH_LAW(HEXSERVO_NUMBER)
#undef HEXSERVO_NUMBER
};

template <class Law>
inline constexpr LawId law_id{};
#define HEXSERVO_NUMBER(Law) \
  template <>                \
  inline constexpr LawId law_id<Law> = LawId::Law;
HEXSERVO_FOR_EACH_LAW(HEXSERVO_NUMBER)
#undef HEXSERVO_NUMBER

/// Calls `function` with the std::type_identity of a law, and gives what it gives.
template <class F>
decltype(auto) with_law(LawId law, F&& function) {
  switch (law) {
#define HEXSERVO_CASE(Law) \
  case LawId::Law:         \
    return function(std::type_identity<Law>{});
    HEXSERVO_FOR_EACH_LAW(HEXSERVO_CASE)
#undef HEXSERVO_CASE
  }
  __builtin_unreachable();
}

/// Laws as a type.
template <class... Law>
struct LawList {
  /// Calls `function` with a std::type_identity of each law.
  template <class F>
  static void for_each(F&& function) {
    (function(std::type_identity<Law>{}), ...);
  }
  /// `To<Of<Law>...>`.
  template <template <class...> class To, template <class> class Of>
  using Map = To<Of<Law>...>;
};

namespace detail {
template <class Nothing, class... Law>
struct ListedLaws {
  using type = LawList<Law...>;
};
}  // namespace detail

/// All of them.
#define HEXSERVO_LISTED(Law) , Law
using Laws = detail::ListedLaws<void HEXSERVO_FOR_EACH_LAW(HEXSERVO_LISTED)>::type;
#undef HEXSERVO_LISTED

}  // namespace hexservo
