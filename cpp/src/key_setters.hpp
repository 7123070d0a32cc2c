/// @file
/// The scenario keys that hold numbers, and where each goes in the settings.
#pragma once

#include "hexservo/settings.hpp"

#include <array>
#include <cstddef>
#include <functional>
#include <span>
#include <string>

namespace hexservo::detail {

/// What a key changes beside numbers of its own lane.
enum class Reach {
  lane,  ///< nothing
  pack,  ///< what must agree in all lanes of a pack
  legs   ///< what `make_hexapod` makes
};

/// One key of a scenario file.
template <class Law>
struct KeySetter {
  std::string key;
  std::array<std::size_t, 2> widths;  ///< numbers that it takes, in either form; 0: there is no second form
  Reach reach;
  /// @throws std::invalid_argument for numbers that the settings cannot hold
  std::function<void(Settings<Law>&, std::span<const double>)> set;

  bool takes(std::size_t width) const { return width != 0 && (width == widths[0] || width == widths[1]); }
};

/// The key of the random streams, which varies as whole numbers of 64 bits and has no setter.
inline constexpr const char* kSeedKey = "seed";

/// All keys of a law's settings that hold doubles, in the order of the scenario file.
template <class Law>
std::span<const KeySetter<Law>> key_setters();

#define HEXSERVO_ELSEWHERE(Law) extern template std::span<const KeySetter<Law>> key_setters<Law>();
HEXSERVO_FOR_EACH_LAW(HEXSERVO_ELSEWHERE)
#undef HEXSERVO_ELSEWHERE

}  // namespace hexservo::detail
