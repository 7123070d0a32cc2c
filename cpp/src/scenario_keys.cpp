#include "hexservo/scenario_keys.hpp"

#include "walk.hpp"

#include <algorithm>

namespace hexservo {

using detail::Path;
using detail::refuse;
using detail::words;

namespace {

using Numbers = std::span<const double>;

constexpr double kMostWhole = 1e15;  // a double holds every whole number up to here

template <class T>
inline constexpr bool is_optional = false;
template <class T>
inline constexpr bool is_optional<std::optional<T>> = true;

/// What follows for a key from the type of its member.
template <class Member>
void describe(ScenarioKey& key) {
  if constexpr (is_optional<Member>) {
    describe<typename Member::value_type>(key);
    key.optional = key.wrapped = true;
  } else if constexpr (std::is_same_v<Member, double>) {
    key.type = KeyType::number;
  } else if constexpr (std::is_same_v<Member, bool>) {
    key.type = KeyType::flag;
  } else if constexpr (std::is_same_v<Member, long long>) {
    key.type = KeyType::whole;
  } else if constexpr (std::is_same_v<Member, std::uint64_t>) {
    key.type = KeyType::seed;
  } else if constexpr (std::is_same_v<Member, Samples>) {
    key.type = KeyType::samples;
    key.optional = true;
  } else if constexpr (std::is_enum_v<Member>) {
    key.type = KeyType::choice;
    key.choices = kNamesOf<Member>;
    key.choice_type = kTypeOf<Member>;
  } else {
    key.type = KeyType::array;
    key.columns = Member::ColsAtCompileTime;
    if constexpr (Member::RowsAtCompileTime == Eigen::Dynamic) {
      key.per_point = Member::MaxSizeAtCompileTime / kMostPoints;
      key.rows = kPoints * key.per_point / key.columns;
    } else {
      key.rows = Member::RowsAtCompileTime;
    }
  }
}

/// Calls `f(member)` with the member of a key.
template <class S, class F>
void at_key(S& settings, const ScenarioKey& key, F&& f) {
  std::size_t place = 0;
  detail::walk(Path{}, settings, [&](const Path&, const Field&, auto& member) {
    if (place++ == key.place) f(member);
  });
}

[[noreturn]] void refuse_count(const ScenarioKey& key, std::size_t count) {
  if (key.per_point > 0)
    refuse(key.name,
           words(key.widths().size() > 1 ? "1 or " : "", key.per_point, " for each of ", kLeastPoints, " to ",
                 kMostPoints, " points"),
           words(count, count == 1 ? " number" : " numbers"));
  std::string expected;
  for (const std::size_t width : key.widths()) expected += words(expected.empty() ? "" : " or ", width);
  refuse(key.name, words(expected, expected == "1" ? " number" : " numbers"), words(count));
}

template <int R, int C, int options, int max_rows>
void put(const ScenarioKey& key, Eigen::Matrix<double, R, C, options, max_rows, C>& to, Numbers from) {
  if constexpr (R == Eigen::Dynamic) {  // one number stands for all points, however many there are
    to.resize(static_cast<Eigen::Index>(from.size()) / C, C);
    for (Eigen::Index row = 0; row < to.rows(); ++row)
      for (int column = 0; column < C; ++column) to(row, column) = from[static_cast<std::size_t>(row * C + column)];
  } else if (from.size() == static_cast<std::size_t>(R * C)) {
    for (int row = 0; row < R; ++row)
      for (int column = 0; column < C; ++column) to(row, column) = from[static_cast<std::size_t>(row * C + column)];
  } else if (key.field.form == Form::symmetric) {
    to.setZero();
    for (int row = 0; row < R; ++row) to(row, std::min(row, C - 1)) = from[static_cast<std::size_t>(row)];
  } else {
    to.setConstant(from[0]);
  }
}

void put(const ScenarioKey& /*key*/, double& to, Numbers from) { to = from[0]; }
void put(const ScenarioKey& key, bool& to, Numbers from) {
  if (from[0] != 0.0 && from[0] != 1.0) refuse(key.name, "1 or 0", words(from[0]));
  to = from[0] == 1.0;
}
void put(const ScenarioKey& key, long long& to, Numbers from) {
  if (!(std::abs(from[0]) <= kMostWhole) || from[0] != std::floor(from[0]))
    refuse(key.name, detail::expected(key.field.bound, true), words(from[0]));
  to = static_cast<long long>(from[0]);
}
void put(const ScenarioKey& /*key*/, Samples& to, Numbers from) {
  to = std::make_shared<const std::vector<double>>(from.begin(), from.end());
}
template <class T>
void put(const ScenarioKey& key, std::optional<T>& to, Numbers from) {
  put(key, to.emplace(), from);
}
template <class T>
  requires(std::is_enum_v<T> || std::is_same_v<T, std::uint64_t>)
void put(const ScenarioKey& key, T& /*to*/, Numbers /*from*/) {
  refuse(key.name, "a key that holds numbers", "one that does not");
}

void clear(const ScenarioKey& /*key*/, Samples& to) { to.reset(); }
template <class T>
void clear(const ScenarioKey& /*key*/, std::optional<T>& to) {
  to.reset();
}
template <class T>
void clear(const ScenarioKey& key, T& to) {
  if constexpr (std::is_same_v<T, double>)
    to = key.field.bound.none;
  else if constexpr (requires { T::RowsAtCompileTime; })
    to.setConstant(key.field.bound.none);
}

template <int R, int C, int options, int max_rows>
std::vector<double> get(const Eigen::Matrix<double, R, C, options, max_rows, C>& from) {
  std::vector<double> numbers;
  for (Eigen::Index row = 0; row < from.rows(); ++row)
    for (int column = 0; column < C; ++column) numbers.push_back(from(row, column));
  return numbers;
}
std::vector<double> get(const Samples& from) { return from ? *from : std::vector<double>{}; }
template <class T>
std::vector<double> get(const std::optional<T>& from) {
  return from ? get(*from) : std::vector<double>{};
}
template <class T>
  requires std::is_arithmetic_v<T>
std::vector<double> get(T from) {
  return {static_cast<double>(from)};
}
template <class T>
  requires std::is_enum_v<T>
std::vector<double> get(T from) {
  return {static_cast<double>(static_cast<int>(from))};
}

std::vector<ScenarioKey> keys_of(LawId law) {
  std::vector<ScenarioKey> keys;
  const Settings settings = Settings::of(law);
  detail::walk(Path{}, settings, [&]<class Member>(const Path& path, const Field& field, const Member&) {
    ScenarioKey key{path.key(field.name), path.unit(field), field, KeyType::number};
    key.optional = !std::isnan(field.bound.none);
    describe<Member>(key);
    key.place = keys.size();
    keys.push_back(std::move(key));
  });
  return keys;
}

}  // namespace

LawId law_named(std::string_view name) {
  std::string known;
  for (std::size_t i = 0; i < kLawTraits.size(); ++i) {
    if (kLawTraits[i].name == name) return static_cast<LawId>(i);
    known += words(known.empty() ? "" : ", ", kLawTraits[i].name);
  }
  refuse("controller.law", "one of " + known, words('"', name, '"'));
}

bool ScenarioKey::takes(std::size_t width) const {
  for (int points = kLeastPoints; points <= (per_point > 0 ? kMostPoints : kLeastPoints); ++points) {
    const std::vector<std::size_t> all = widths(points);
    if (std::ranges::find(all, width) != all.end()) return true;
  }
  return false;
}

std::vector<std::size_t> ScenarioKey::widths(int points) const {
  const auto all = static_cast<std::size_t>(per_point > 0 ? per_point * points : rows * columns);
  if (all == 1 || field.form == Form::all) return {all};
  return {field.form == Form::symmetric ? static_cast<std::size_t>(rows) : 1, all};
}

bool ScenarioKey::varies() const {
  return field.reach != Reach::batch &&
         (type == KeyType::number || type == KeyType::array || type == KeyType::whole || type == KeyType::seed);
}

const std::vector<ScenarioKey>& scenario_keys(LawId law) {
  static const auto all = [] {
    std::array<std::vector<ScenarioKey>, kLawTraits.size()> keys;
    for (std::size_t i = 0; i < keys.size(); ++i) keys[i] = keys_of(static_cast<LawId>(i));
    return keys;
  }();
  return all[static_cast<std::size_t>(law)];
}

const ScenarioKey& scenario_key(LawId law, std::string_view name) {
  const std::vector<ScenarioKey>& keys = scenario_keys(law);
  const auto key = std::ranges::find(keys, name, &ScenarioKey::name);
  if (key == keys.end())
    refuse(std::string(name), words("one of the core's keys for the law ", law_traits(law).name),
           "another name; a key of scenario files alone is given by those that it leads to, which hexservo show --flat "
           "lists");
  return *key;
}

void set_numbers(Settings& settings, const ScenarioKey& key, Numbers numbers) {
  if (numbers.empty() && !key.optional) refuse(key.name, "a value", "none");
  const auto columns = static_cast<std::size_t>(key.field.columns);
  if (key.type == KeyType::samples && numbers.size() % columns != 0)
    refuse(key.name, words("rows of ", columns, " numbers"), words(numbers.size(), " numbers"));
  if (key.type != KeyType::samples && !numbers.empty() && !key.takes(numbers.size())) refuse_count(key, numbers.size());
  at_key(settings, key, [&](auto& member) { numbers.empty() ? clear(key, member) : put(key, member, numbers); });
}

void set_choice(Settings& settings, const ScenarioKey& key, std::string_view name) {
  at_key(settings, key, [&]<class Member>(Member& member) {
    if constexpr (std::is_enum_v<Member>) {
      std::string known;
      for (std::size_t i = 0; i < key.choices.size(); ++i) {
        known += words(known.empty() ? "" : ", ", key.choices[i]);
        if (key.choices[i] == name) return void(member = static_cast<Member>(i));
      }
      refuse(key.name, "one of " + known, words('"', name, '"'));
    } else {
      refuse(key.name, "numbers", words('"', name, '"'));
    }
  });
}

std::vector<double> numbers_of(const Settings& settings, const ScenarioKey& key) {
  std::vector<double> numbers;
  at_key(settings, key, [&](const auto& member) { numbers = get(member); });
  if (key.per_point > 0 && numbers.size() == 1)  // for all points
    numbers.resize(static_cast<std::size_t>(key.per_point * settings.target.count()), numbers[0]);
  return numbers;
}

std::string_view choice_of(const Settings& settings, const ScenarioKey& key) {
  if (key.type != KeyType::choice) refuse(key.name, "a choice", "a key that holds numbers");
  return key.choices[static_cast<std::size_t>(numbers_of(settings, key)[0])];
}

}  // namespace hexservo
