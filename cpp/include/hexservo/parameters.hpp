/// @file
/// The table of parameters: what a user may set is declared once, beside the member that holds it.
///
/// A struct names its members in one static function,
///
///     template <class V, class... Self>
///     static void visit(V&& v, Self&... self) {
///       v(Field{"width", "m/s; rad/s", kPositive}, self.width...);
///     }
///
/// which hands each field over with that member of every given object. A visit of two copies a scenario into a lane of
/// a pack; a visit of one flattens, checks, sets and reads by key (scenario_keys.hpp). A member that is itself such a
/// struct is a block, whose keys follow its name and a dot. Structs of prepared numbers are visited alike, and no key
/// leads to them; those of results hand over a name in place of a field.
#pragma once

#include <array>
#include <limits>
#include <span>
#include <string_view>
#include <type_traits>
#include <utility>

namespace hexservo {

/// What each number of a parameter may be; NaN never is.
struct Bound {
  double least = -std::numeric_limits<double>::infinity();
  double most = std::numeric_limits<double>::infinity();
  bool above = false;  ///< `least` itself is too small
  bool below = false;  ///< `most` itself is too large
  /// Number that stands for "none", null in a scenario; NaN: none does.
  double none = std::numeric_limits<double>::quiet_NaN();

  /// Whether a number is within.
  constexpr bool holds(double value) const {
    if (value == none) return true;
    const double largest = std::numeric_limits<double>::max();
    return value >= -largest && value <= largest && (above ? value > least : value >= least) &&
           (below ? value < most : value <= most);
  }
};

inline constexpr Bound kFinite = {};
inline constexpr Bound kPositive = {.least = 0.0, .above = true};
inline constexpr Bound kNotNegative = {.least = 0.0};
inline constexpr Bound kPositiveOrNone = {.least = 0.0, .above = true, .none = std::numeric_limits<double>::infinity()};
inline constexpr Bound kPositiveOrZero = {.least = 0.0, .above = true, .none = 0.0};
inline constexpr Bound kRelativeError = {.least = -1.0, .most = 1.0, .above = true, .below = true};

inline constexpr double kFullTurn = 6.283185307179586;  ///< 2 pi
/// An angle [rad]; larger ones are probably degrees.
inline constexpr Bound kAngle = {.least = -kFullTurn, .most = kFullTurn};
/// Longest rotation vector of a pose of six numbers [rad], likewise: pi, as people round it. A longer one has a shorter
/// one, which rotates the other way than who wrote it in degrees meant.
inline constexpr double kLongestTurn = 3.15;
/// An angle between two directions [rad].
inline constexpr Bound kTilt = {.least = 0.0, .most = 3.141592653589793, .above = true};
inline constexpr Bound kSign = {.least = -1.0, .most = 1.0};
inline constexpr Bound kProbability = {.least = 0.0, .most = 1.0};

// What no machine comes near, of nanometres or of 100 t. Far beyond it kernels, whose sums round differently, end a run
// differently.
inline constexpr double kMostLength = 1e6;    ///< [m]
inline constexpr double kMostMass = 1e9;      ///< [kg]
inline constexpr double kMostInertia = 1e12;  ///< [kg m^2]
/// Of a machine [m]; of its travel and of cranks, which may be angles [rad], too.
inline constexpr Bound kLength = {.least = 0.0, .most = kMostLength, .above = true, .below = true};
inline constexpr Bound kLengthOrZero = {.least = 0.0, .most = kMostLength, .above = true, .below = true, .none = 0.0};
inline constexpr Bound kCoordinate = {.least = -kMostLength, .most = kMostLength, .above = true, .below = true};
inline constexpr Bound kMass = {.least = 0.0, .most = kMostMass, .above = true, .below = true};
inline constexpr Bound kMassOrZero = {.least = 0.0, .most = kMostMass, .below = true};
inline constexpr Bound kInertia = {.least = -kMostInertia, .most = kMostInertia, .above = true, .below = true};

/// What a key of a batch changes besides the numbers of one lane.
enum class Reach {
  lane,  ///< nothing
  pack,  ///< what must agree in all lanes of a pack
  legs,  ///< what `make_hexapod` makes
  batch  ///< what all its scenarios share: such a key does not vary
};

/// Where a parameter has an effect.
enum class Concern {
  controller,  ///< a robot's program needs it
  plant,       ///< the machine and its faults, as a simulation has them
  run          ///< how a simulated run is taken and judged
};

/// Numbers that an array is given by.
enum class Form {
  one_or_all,  ///< one for all entries, or each
  all,         ///< each
  symmetric    ///< of a symmetric matrix its diagonal, or each
};

/// A unit that replaces the one of a block.
struct UnitOf {
  std::string_view name, unit;
};

/// One parameter, or one block of them.
struct Field {
  std::string_view name;  ///< of the key in its block; of a block without one: its keys stand in the block around it
  std::string_view unit = {};
  Bound bound = kFinite;
  Reach reach = Reach::lane;
  Concern concern = Concern::controller;
  Form form = Form::one_or_all;
  bool sampled = false;                ///< acts in `sampled` mode alone
  bool key = true;                     ///< false: prepared from others
  int columns = 3;                     ///< of samples, which have rows
  bool with_points = true;             ///< false: not used where the target's points are given
  std::span<const UnitOf> units = {};  ///< of a block: where its own do not hold

  constexpr Field with(Reach value) const { return changed(&Field::reach, value); }
  constexpr Field of_pack() const { return with(Reach::pack); }
  constexpr Field of_legs() const { return with(Reach::legs); }
  constexpr Field of_batch() const { return with(Reach::batch); }
  constexpr Field of_plant() const { return changed(&Field::concern, Concern::plant); }
  constexpr Field of_run() const { return changed(&Field::concern, Concern::run); }
  constexpr Field entrywise() const { return changed(&Field::form, Form::all); }
  constexpr Field symmetric() const { return changed(&Field::form, Form::symmetric); }
  constexpr Field in_sampled_mode() const { return changed(&Field::sampled, true); }
  constexpr Field of_columns(int value) const { return changed(&Field::columns, value); }
  constexpr Field prepared() const { return changed(&Field::key, false); }
  constexpr Field without_points() const { return changed(&Field::with_points, false); }
  constexpr Field with_units(std::span<const UnitOf> value) const { return changed(&Field::units, value); }

 private:
  template <class T>
  constexpr Field changed(T Field::* member, T value) const {
    Field out = *this;
    out.*member = value;
    return out;
  }
};

/// A struct that names its members.
template <class T>
concept Visited = requires(T& value) { std::remove_const_t<T>::visit([](const Field&, auto&) {}, value); };

namespace detail {

/// Name of an enumerator with its type, as the compiler writes it: "hexservo::LoopMode::sampled".
template <auto value>
constexpr std::string_view enumerator() {
  const std::string_view text = __PRETTY_FUNCTION__;
  const std::size_t start = text.find("value = ") + 8;
  return text.substr(start, text.find_first_of(";]", start) - start);
}

/// Enumerators count from 0 without a gap.
template <class E, int count = 0>
constexpr int enumerators() {
  if constexpr (enumerator<static_cast<E>(count)>().front() == '(')
    return count;
  else
    return enumerators<E, count + 1>();
}

template <class E, int... index>
constexpr auto enumerator_names(std::integer_sequence<int, index...>) {
  return std::array<std::string_view, sizeof...(index)>{
      [](std::string_view text) { return text.substr(text.rfind(':') + 1); }(enumerator<static_cast<E>(index)>())...};
}

}  // namespace detail

/// Names of the values of an enumeration, as a scenario has them.
template <class E>
inline constexpr auto kNamesOf =
    detail::enumerator_names<E>(std::make_integer_sequence<int, detail::enumerators<E>()>());

/// Name of its type in C++: "hexservo::LoopMode".
template <class E>
inline constexpr std::string_view kTypeOf =
    detail::enumerator<E{}>().substr(0, detail::enumerator<E{}>().rfind(':') - 1);

}  // namespace hexservo
