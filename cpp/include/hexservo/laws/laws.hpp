/// @file
/// All control laws.
#pragma once

#include "hexservo/laws/composite.hpp"
#include "hexservo/laws/computed_torque.hpp"
#include "hexservo/laws/hybrid.hpp"
#include "hexservo/laws/kelly.hpp"
#include "hexservo/laws/list.hpp"
#include "hexservo/laws/pbvs.hpp"
#include "hexservo/laws/resolved_rate.hpp"
#include "hexservo/laws/tracking.hpp"

#include <array>
#include <variant>

namespace hexservo {

/// Traits of all laws, in the order of `LawId`.
#define HEXSERVO_TRAITS(Law) Law::traits,
inline constexpr std::array kLawTraits = {HEXSERVO_FOR_EACH_LAW(HEXSERVO_TRAITS)};
#undef HEXSERVO_TRAITS

/// Those of one.
constexpr const LawTraits& law_traits(LawId law) { return kLawTraits[static_cast<std::size_t>(law)]; }

/// The law of a name.
/// @throws std::invalid_argument for a name that no law has
LawId law_named(std::string_view name);

/// Gains of a law as a user gives them, for any number of points.
template <class Law>
using GainsOf = typename Law::template Gains<double, kAnyPoints>;

/// Gains of one of the laws; their type is that of the law.
using LawGains = Laws::Map<std::variant, GainsOf>;

}  // namespace hexservo
