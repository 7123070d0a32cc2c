/// @file
/// The dotted keys of a scenario: which a law has, what each takes, and how it is set and read.
#pragma once

#include "hexservo/settings.hpp"

#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace hexservo {

/// What a key holds.
enum class KeyType {
  number,   ///< a double
  array,    ///< doubles of a fixed shape, row by row
  whole,    ///< a whole number
  flag,     ///< true or false: 1 or 0
  choice,   ///< one of several names
  samples,  ///< rows of three numbers, as many as there are
  seed      ///< a whole number of 64 bits, which a double does not hold: `Settings::seed`
};

/// One key of a scenario file.
struct ScenarioKey {
  std::string name;       ///< dotted, "camera.noise"
  std::string_view unit;  ///< "px"; of angles and what is linear beside them "N; N m"; empty: none
  Field field;            ///< bound, reach, and when and whom it concerns
  KeyType type;
  bool optional = false;      ///< may be none: null in a scenario
  bool wrapped = false;       ///< its member is a std::optional
  int rows = 1, columns = 1;  ///< of an array; of one that has numbers of each point they are those of four points
  int per_point = 0;          ///< numbers of each point; 0: their count does not depend on the target
  std::span<const std::string_view> choices = {};
  std::string_view choice_type = {};  ///< of C++
  std::size_t place = 0;              ///< among all keys of its law

  /// Whether it takes that many doubles: one number, each entry, or of a symmetric matrix its diagonal; numbers of each
  /// point for any number of points that a target may have.
  bool takes(std::size_t width) const;
  /// The same for a target of `points` points, as a list.
  std::vector<std::size_t> widths(int points = kPoints) const;
  /// Whether scenarios of a batch may differ in it: what holds numbers.
  bool varies() const;
};

/// All keys of a law, in the order of a scenario file; the gains of other laws are none of them.
const std::vector<ScenarioKey>& scenario_keys(LawId law);

/// @throws std::invalid_argument for a name that is no key of the law
const ScenarioKey& scenario_key(LawId law, std::string_view name);

/// Sets what is no choice: as many numbers as the key takes, or none where it is optional. Bounds are not checked.
/// @throws std::invalid_argument for another count, or where a whole number is expected
void set_numbers(Settings& settings, const ScenarioKey& key, std::span<const double> numbers);

/// @throws std::invalid_argument for a name that is none of the choices
void set_choice(Settings& settings, const ScenarioKey& key, std::string_view name);

/// Numbers that a key holds, row by row; empty: none.
std::vector<double> numbers_of(const Settings& settings, const ScenarioKey& key);

/// Name that a choice has.
std::string_view choice_of(const Settings& settings, const ScenarioKey& key);

}  // namespace hexservo
