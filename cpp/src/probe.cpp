#include "hexservo/probe.hpp"

#include "check.hpp"
#include "hexservo/closed_loop.hpp"
#include "weight_rows.hpp"

#include <algorithm>
#include <limits>

namespace hexservo {

using detail::refuse;
using detail::words;

namespace {

constexpr double kMinQuaternion = 1e-150, kMaxQuaternion = 1e150;
constexpr int kMemberships = kAxes * kTerms;
constexpr std::size_t kStages = kRungeKuttaWeights.size();
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// ---- Rows that are given --------------------------------------------------------------------------------------------

/// Checks that there are n rows.
void require_count(const char* name, Rows values, int width, std::size_t n) {
  const auto numbers = n * static_cast<std::size_t>(width);
  if (values.size() != numbers)
    refuse(name, words(numbers, " numbers, ", width, " for each of ", n, " states"), words(values.size()));
}

/// Checks that there are n rows of finite numbers; the first that is not is named with its row.
void require_rows(const char* name, Rows values, int width, std::size_t n) {
  require_count(name, values, width, n);
  for (std::size_t i = 0; i < values.size(); ++i)
    if (!std::isfinite(values[i]))
      detail::require_finite(words(name, "[", i / static_cast<std::size_t>(width), "]"), values[i]);
}

/// n, by the width of a quantity's rows.
std::size_t row_count(const char* name, Rows values, int width) {
  const auto w = static_cast<std::size_t>(width);
  if (values.size() % w != 0) refuse(name, words("rows of ", width, " numbers"), words(values.size(), " numbers"));
  return values.size() / w;
}

void require_quaternions(const char* name, Rows values, std::size_t n) {
  require_rows(name, values, 4, n);
  for (std::size_t i = 0; i < n; ++i) {
    const Eigen::Map<const Vector4<double>> q(values.data() + 4 * i);
    const double largest = q.cwiseAbs().maxCoeff();
    if (largest == 0.0) refuse(words(name, "[", i, "]"), "a quaternion that is not zero", "zero");
    if (!(largest >= kMinQuaternion && largest <= kMaxQuaternion))  // its square has to be a number that divides
      refuse(words(name, "[", i, "]"),
             words("a quaternion whose largest number is between ", kMinQuaternion, " and ", kMaxQuaternion),
             words(largest));
  }
}

void require_depths(Rows values, int points, std::size_t n) {
  require_rows("depth", values, points, n);
  for (std::size_t i = 0; i < values.size(); ++i)
    if (!(values[i] < 0.0))
      refuse(words("depth[", i / static_cast<std::size_t>(points), "]"), "numbers < 0, in front of the camera",
             words(values[i]));
}

void require_room(const char* name, Column values, int width, std::size_t n) {
  const std::size_t numbers = n * static_cast<std::size_t>(width);
  if (values.size() != numbers)
    refuse(name, words("room for ", numbers, " numbers"), words("room for ", values.size()));
}

/// Row i of k numbers.
template <int k>
Vector<double, k> row(Rows values, std::size_t i) {
  return Eigen::Map<const Vector<double, k>>(values.data() + static_cast<std::size_t>(k) * i);
}

/// K numbers of each point of row i, in N places.
template <int K, int N>
Vector<double, K * N> points_row(Rows values, std::size_t i, int points) {
  Vector<double, K * N> numbers;
  const std::size_t width = static_cast<std::size_t>(K * points);
  std::copy_n(values.data() + width * i, width, numbers.data());
  fill_places<K>(numbers, points);
  return numbers;
}

/// The same, written.
template <int K, int M>
void put_points(Column column, std::size_t i, const Vector<double, M>& numbers, int points) {
  const std::size_t width = static_cast<std::size_t>(K * points);
  std::copy_n(numbers.data(), width, column.data() + width * i);
}

template <class Derived>
void put(Column column, std::size_t i, const Eigen::MatrixBase<Derived>& numbers) {
  constexpr int k = Derived::SizeAtCompileTime;
  Eigen::Map<Vector<double, k>>(column.data() + static_cast<std::size_t>(k) * i) = numbers;
}

/// Row i of a matrix, its own rows one after another.
template <int rows, int columns>
void put_matrix(Column column, std::size_t i, const Eigen::Matrix<double, rows, columns>& m) {
  Eigen::Map<Eigen::Matrix<double, rows, columns, Eigen::RowMajor>>(column.data() +
                                                                    static_cast<std::size_t>(rows * columns) * i) = m;
}

/// Row i of memberships: axis, term.
void put_memberships(Column column, std::size_t i, const TermStrengths<double>& mu) {
  double* to = column.data() + static_cast<std::size_t>(kMemberships) * i;
  for (int axis = 0; axis < kAxes; ++axis)
    for (std::size_t term = 0; term < kTerms; ++term) *to++ = mu[term](axis);
}

BodyMotion<double> body_at(const Probe::Body& rows, std::size_t i) {
  return BodyMotion<double>::of(
      body_state<double>({row<3>(rows.position, i), row<4>(rows.quaternion, i)}, row<6>(rows.twist, i)));
}

void put_body(const BodyMotion<double>& body, std::size_t i, Column position, Column quaternion, Column twist) {
  put(position, i, position_of(body));
  put(quaternion, i, quaternion_of(body));
  put(twist, i, twist_of(body));
}

/// The rate of a platform whose acceleration is given; `body_rate` is the one of a plant.
BodyMotion<double> rate_at(const Probe::BodyStage& rows, std::size_t i) {
  const Vector6<double> twist = row<6>(rows.twist, i);
  return {SideBySide<double, 3>(Vector3<double>(twist.head<3>())),
          SideBySide<double, 4>(quaternion_rate<double>(row<4>(rows.quaternion, i), twist.tail<3>())),
          SideBySide<double, 6>(row<6>(rows.acceleration, i))};
}

std::size_t require_body(const Probe::Body& start) {
  const std::size_t n = row_count("position", start.position, 3);
  require_rows("position", start.position, 3, n);
  require_quaternions("quaternion", start.quaternion, n);
  require_rows("twist", start.twist, 6, n);
  return n;
}

void require_stages(const Probe::BodyStage& stage, std::size_t n) {
  require_quaternions("stage_quaternion", stage.quaternion, n);
  require_rows("stage_twist", stage.twist, 6, n);
  require_rows("stage_acceleration", stage.acceleration, 6, n);
}

void require_body_room(Column position, Column quaternion, Column twist, std::size_t n) {
  require_room("position", position, 3, n);
  require_room("quaternion", quaternion, 4, n);
  require_room("twist", twist, 6, n);
}

/// Keeps a row of what a law reports.
struct ProbeListener {
  const ProbedLaw& out;
  std::size_t row;

  template <class F>
  void part(LawPart part, const F& wrench) const noexcept {
    const Column to = out.parts[static_cast<std::size_t>(part)];
    if (!to.empty()) put(to, row, wrench());
  }
  template <class F>
  void pose_error(const F& error) const noexcept {
    if (!out.pose_error.empty()) put(out.pose_error, row, error());
  }
};

/// Checks states, and gives their number.
std::size_t require_states(const ProbeStates& states, int points, bool fuzzy) {
  const std::size_t n = row_count("features", states.features, 2 * points);
  require_rows("features", states.features, 2 * points, n);
  require_depths(states.depth, points, n);
  require_rows("position", states.position, 3, n);
  require_quaternions("quaternion", states.quaternion, n);
  require_rows("twist", states.twist, 6, n);
  if (!states.weights.empty() && !fuzzy)
    refuse("weights", "none, since no fuzzy systems act", words(states.weights.size(), " numbers"));
  if (!states.weights.empty()) require_rows("weights", states.weights, kWeightNumbers, n);
  return n;
}

/// The same where they are known, and NaN elsewhere.
template <class Derived>
auto known(bool where, const Eigen::MatrixBase<Derived>& numbers) {
  auto kept = numbers.eval();
  if (!where) kept.setConstant(kNaN);
  return kept;
}

}  // namespace

// ---- What depends on the law ----------------------------------------------------------------------------------------

struct Probe::Parts {
  template <class Law, int N>
  explicit Parts(const LoopParameters<double, Law, N>& p)
      : traits(Law::traits),
        points(p.points),
        estimate(p.body),
        plant(p.plant_body, p.dynamics_error),
        projects(p.convention == CameraConvention::eye_in_hand),
        on_base(p.camera.placement.on_base()),
        recorded(p.recorded.samples, p.recorded.samples + (p.recorded.samples ? 3 * p.recorded.count : 0)),
        base(p.mode == LoopMode::sampled ? p.base_motion : BaseMotionParameters<double>{}, p.seed,
             {recorded.data(), p.recorded.count, p.recorded.period, p.recorded.attitudes}),
        fuzzy(fuzzy_systems_act<Law>(p.gains)) {
    base.find_place();
    if constexpr (kHasFuzzySystems<Law>) weights = Law::initial_state(p.gains);
  }
  virtual ~Parts() = default;

  virtual std::vector<GoalMinimum> goal_minima() const = 0;
  virtual void image(Rows position, Rows quaternion, std::size_t n, Column features, Column depth) const = 0;
  virtual void image_jacobian(Rows features, Rows depth, Rows position, Rows quaternion, std::size_t n, bool controller,
                              Column jacobian) const = 0;
  virtual void measured_depth(Rows depth, std::size_t n, Column measured) const = 0;
  virtual void law(const ProbeStates& states, std::size_t n, const ProbedLaw& out) const = 0;
  virtual void stages(const ProbeStates& states, std::size_t n, const ProbedStages& out) const = 0;

  const LawTraits& traits;
  int points;                  ///< of the target
  RigidBody<double> estimate;  ///< of the platform
  Plant<double> plant;
  bool projects;                 ///< whether the camera has points
  bool on_base;                  ///< whether it is mounted on the base
  std::vector<double> recorded;  ///< samples of the base's acceleration, to which `base` refers
  BaseMotion<double> base;
  bool fuzzy;                         ///< whether fuzzy systems act
  FuzzyWeights<double> weights = {};  ///< initial ones
};

/// What depends on the places for points, and on no law.
template <int N>
struct Probe::Scene : Probe::Parts {
  template <class Law>
  explicit Scene(const LoopParameters<double, Law, N>& p)
      : Parts(p),
        camera(p.camera),
        assumed_camera(p.assumed_camera),
        plant_sign(hexservo::plant_sign(p.convention)),
        controller_sign(hexservo::controller_sign(p.convention, p.jacobian)),
        points_T(p.points_T),
        depth_error(p.depth_error),
        desired_features(p.desired_features),
        point_weights(p.weights),
        home(home_pose(p.hexapod)) {}

  std::vector<GoalMinimum> goal_minima() const override {
    return hexservo::goal_minima<N>(camera, points_T.matrix(), desired_features, home, point_weights);
  }

  void image(Rows position, Rows quaternion, std::size_t n, Column features, Column depth) const override {
    for (std::size_t i = 0; i < n; ++i) {
      Vector<double, N> inverse_depth;
      Image<double, N> seen;
      take_image<double, N>(camera, row<3>(position, i), rotation_matrix(row<4>(quaternion, i)), points_T, seen,
                            inverse_depth);
      for (int point = 0; point < N; ++point)
        if (!(seen.depth(point) < 0.0)) seen.features.template segment<2>(2 * point).setConstant(kNaN);
      put_points<2>(features, i, seen.features, points);
      put_points<1>(depth, i, seen.depth, points);
    }
  }

  void image_jacobian(Rows features, Rows depth, Rows position, Rows quaternion, std::size_t n, bool controller,
                      Column jacobian) const override {
    const double sign = controller ? controller_sign : plant_sign;
    const PlatformCamera<double>& taken = controller ? assumed_camera : camera;
    const auto numbers = static_cast<std::size_t>(2 * points * 6);
    for (std::size_t i = 0; i < n; ++i) {
      const Image<double, N> image{points_row<2, N>(features, i, points), points_row<1, N>(depth, i, points)};
      const Vector3<double> p_BE = position.empty() ? Vector3<double>::Zero() : row<3>(position, i);
      const Matrix3<double> R_BE = rotation_matrix(row<4>(quaternion, i));
      const Eigen::Matrix<double, 2 * N, 6, Eigen::RowMajor> J =
          ImageJacobian<double, N>(taken, sign, image, p_BE, R_BE).matrix();
      std::copy_n(J.data(), numbers, jacobian.data() + numbers * i);
    }
  }

  void measured_depth(Rows depth, std::size_t n, Column measured) const override {
    for (std::size_t i = 0; i < n; ++i) {
      const Image<double, N> image{Vector<double, 2 * N>::Zero(), points_row<1, N>(depth, i, points)};
      put_points<1>(measured, i, measured_image(image, depth_error).depth, points);
    }
  }

  PlatformCamera<double> camera, assumed_camera;
  double plant_sign, controller_sign;
  Vectors3<double, N> points_T;
  Vector<double, N> depth_error;
  Vector<double, 2 * N> desired_features;
  PointWeights<double, N> point_weights;
  Pose<double> home;
};

template <class Law, int N>
struct Probe::PartsOf final : Probe::Scene<N> {
  using Probe::Parts::points;
  using State = typename Law::template State<double>;
  using Stage = typename Law::template Stage<double>;
  using Equations = LoopEquations<double, Law, N>;
  using Instant = typename Equations::Instant;

  explicit PartsOf(LoopParameters<double, Law, N> parameters)
      : Probe::Scene<N>(parameters),
        mode(parameters.mode),
        step(parameters.step),
        initial(Law::initial_state(parameters.gains)),
        equations(parameters) {}

  State state_at(const ProbeStates& states, std::size_t i) const {
    if constexpr (kHasFuzzySystems<Law>)
      if (!states.weights.empty()) return detail::weights_from(states.weights.data() + i * kWeightNumbers);
    return initial;
  }

  void law(const ProbeStates& states, std::size_t n, const ProbedLaw& out) const override {
    typename Law::template Evaluation<double> now;
    for (std::size_t i = 0; i < n; ++i) {
      const State state = state_at(states, i);
      const Pose<double> pose{row<3>(states.position, i), row<4>(states.quaternion, i)};
      const Matrix3<double> R_BE = rotation_matrix(pose.quaternion);
      const Vector<double, 2 * N> features = points_row<2, N>(states.features, i, points);
      const Vector<double, N> inverse_depth = points_row<1, N>(states.depth, i, points).cwiseInverse();
      const Vector6<double> twist = row<6>(states.twist, i);
      equations.evaluate(Stage{&state}, LawInput<double, N>{features, inverse_depth, R_BE, twist, pose}, now,
                         ProbeListener{out, i});
      put(out.wrench, i, now.wrench);
      if (!out.fuzzy_output.empty()) put(out.fuzzy_output, i, now.fuzzy_output);
      if constexpr (kHasFuzzySystems<Law>) {
        if (!out.error_memberships.empty()) put_memberships(out.error_memberships, i, normalised(now.rate.basis.error));
        if (!out.rate_memberships.empty()) put_memberships(out.rate_memberships, i, normalised(now.rate.basis.rate));
        if (!out.adaptation.empty()) {
          const FuzzyBasis<double>& basis = now.rate.basis;
          put(out.adaptation, i, (now.rate.strength * sum_of(basis.error) * sum_of(basis.rate)).vector());
        }
      }
    }
  }

  void stages(const ProbeStates& states, std::size_t n, const ProbedStages& out) const override {
    if (mode != LoopMode::continuous)
      refuse("simulation.mode", "continuous for the stages of a step, which hold the law", "sampled");
    for (std::size_t i = 0; i < n; ++i) {
      State law_state = state_at(states, i);
      const Image<double, N> image{points_row<2, N>(states.features, i, points),
                                   points_row<1, N>(states.depth, i, points)};
      const BodyMotion<double> body = body_at({states.position, states.quaternion, states.twist}, i);
      const WorldState<double, N> start{body, View<double, N>(image, rotation_matrix(quaternion_of(body)))};
      Instant first;
      equations.evaluate(start, Stage{&law_state}, first);
      std::size_t place = kStages * i;
      bool seen = put_stage(start, first, true, place, out);
      const auto derivative_at = [&](double scale, const Instant& before) {
        Instant now;
        const WorldState<double, N> state = equations.stage(start, law_state, scale, before, now);
        seen = put_stage(state, now, seen, ++place, out);
        return now;
      };
      runge_kutta_step(step, first, derivative_at, [&](const typename Equations::Instants& k) {
        double nearest;
        const WorldState<double, N> next = equations.after(start, step, k, nearest);
        equations.advance(law_state, step, k, true);
        put_next(next, law_state, nearest < 0.0, i, out);
      });
    }
  }

  /// @param reached whether the stages before have all points in front of the camera: otherwise there is no such stage
  /// @return the same with this one; what follows from a point behind the camera means nothing
  bool put_stage(const WorldState<double, N>& state, const Instant& now, bool reached, std::size_t place,
                 const ProbedStages& out) const {
    const bool seen = reached && now.world.nearest_depth < 0.0;
    put_points<1>(out.depth, place, known(reached, state.view.image.depth), points);
    put(out.position, place, known(reached, position_of(state.body)));
    put(out.quaternion, place, known(reached, quaternion_of(state.body)));
    put(out.twist, place, known(reached, twist_of(state.body)));
    put_points<2>(out.features, place, known(seen, state.view.image.features), points);
    put(out.wrench, place, known(seen, now.law.wrench));
    put(out.fuzzy_output, place, known(seen, now.law.fuzzy_output));
    put(out.acceleration, place, known(seen, now.world.body.twist.vector()));
    return seen;
  }

  /// @param seen whether the points stay in front of the camera on the way: otherwise a loop ends here
  void put_next(const WorldState<double, N>& next, const State& law_state, bool seen, std::size_t i,
                const ProbedStages& out) const {
    put_points<2>(out.next_features, i, known(seen, next.view.image.features), points);
    put_points<1>(out.next_depth, i, known(seen, next.view.image.depth), points);
    put(out.next_position, i, known(seen, position_of(next.body)));
    put(out.next_quaternion, i, known(seen, quaternion_of(next.body)));
    put(out.next_twist, i, known(seen, twist_of(next.body)));
    if (out.next_weights.empty()) return;
    double* to = out.next_weights.data() + i * kWeightNumbers;
    detail::write_weights(law_state, 0, to);
    if (!seen) std::fill_n(to, kWeightNumbers, kNaN);
  }

  LoopMode mode;
  double step;
  State initial;
  Equations equations;
};

// ---- The face -------------------------------------------------------------------------------------------------------

Probe::Probe(const Settings& settings)
    : parts_(with_loop(settings, [&]<class Law, int N>(std::type_identity<Law>, std::integral_constant<int, N>) {
        return std::unique_ptr<const Parts>(std::make_unique<PartsOf<Law, N>>(loop_parameters<Law, N>(settings)));
      })) {}

Probe::Probe(Probe&&) noexcept = default;
Probe& Probe::operator=(Probe&&) noexcept = default;
Probe::~Probe() = default;

const LawTraits& Probe::traits() const noexcept { return parts_->traits; }
int Probe::points() const noexcept { return parts_->points; }
bool Probe::has_fuzzy_systems() const noexcept { return parts_->fuzzy; }
const FuzzyWeights<double>& Probe::initial_weights() const noexcept { return parts_->weights; }
Vector6<double> Probe::gravity() const noexcept { return gravity_wrench(parts_->estimate); }

void Probe::require_points() const {
  if (!parts_->projects)
    refuse("camera.convention", "eye_in_hand, since a camera as_printed has no points", "as_printed");
}

std::vector<GoalMinimum> Probe::goal_minima() const {
  require_points();
  return parts_->goal_minima();
}

void Probe::base_acceleration(Rows time, Column acceleration) const {
  require_rows("time", time, 1, time.size());
  require_room("acceleration", acceleration, 3, time.size());
  for (std::size_t i = 0; i < time.size(); ++i) {
    if (time[i] < 0.0) refuse(words("time[", i, "]"), "a time >= 0", words(time[i]));
    put(acceleration, i, parts_->base.acceleration(time[i]));
  }
}

void Probe::base_motion(Rows time, const ProbedBase& out) const {
  require_rows("time", time, 1, time.size());
  const std::size_t n = time.size();
  require_room("position", out.position, 3, n);
  require_room("attitude", out.attitude, 9, n);
  require_room("rate", out.rate, 3, n);
  require_room("rate_change", out.rate_change, 3, n);
  for (std::size_t i = 0; i < n; ++i) {
    if (time[i] < 0.0) refuse(words("time[", i, "]"), "a time >= 0", words(time[i]));
    const Turning<double> turning = parts_->base.turning(time[i]);
    put(out.position, i, parts_->base.place(time[i]));
    Vector<double, 9> rows;
    for (int k = 0; k < 9; ++k) rows(k) = turning.R_WB(k / 3, k % 3);
    put(out.attitude, i, rows);
    put(out.rate, i, turning.rate_B);
    put(out.rate_change, i, turning.rate_change_B);
  }
}

void Probe::base_wrench(Rows time, Rows position, Rows quaternion, Rows twist, Column wrench) const {
  require_rows("time", time, 1, time.size());
  const std::size_t n = time.size();
  require_rows("position", position, 3, n);
  require_rows("quaternion", quaternion, 4, n);
  require_quaternions("quaternion", quaternion, n);
  require_rows("twist", twist, 6, n);
  require_room("wrench", wrench, 6, n);
  const BaseMotion<double>& base = parts_->base;
  for (std::size_t i = 0; i < n; ++i) {
    if (time[i] < 0.0) refuse(words("time[", i, "]"), "a time >= 0", words(time[i]));
    const Matrix3<double> R_BE = rotation_matrix(row<4>(quaternion, i));
    put(wrench, i,
        base.turns()
            ? moving_base_wrench(parts_->plant, row<3>(position, i), R_BE, row<6>(twist, i), base.state(time[i]))
            : inertial_wrench(parts_->plant, R_BE, base.acceleration(time[i])));
  }
}

void Probe::image(Rows position, Rows quaternion, Column features, Column depth) const {
  require_points();
  const std::size_t n = row_count("position", position, 3);
  require_rows("position", position, 3, n);
  require_quaternions("quaternion", quaternion, n);
  require_room("features", features, 2 * parts_->points, n);
  require_room("depth", depth, parts_->points, n);
  parts_->image(position, quaternion, n, features, depth);
}

void Probe::image_jacobian(Rows features, Rows depth, Rows position, Rows quaternion, bool controller,
                           Column jacobian) const {
  const int width = 2 * parts_->points;
  const std::size_t n = row_count("features", features, width);
  require_rows("features", features, width, n);
  require_depths(depth, parts_->points, n);
  if (!position.empty())
    require_rows("position", position, 3, n);
  else if (parts_->on_base && n > 0)
    refuse("position", "that of the platform, since camera.mount.on is base", "none");
  require_quaternions("quaternion", quaternion, n);
  require_room("jacobian", jacobian, width * 6, n);
  parts_->image_jacobian(features, depth, position, quaternion, n, controller, jacobian);
}

void Probe::measured_depth(Rows depth, Column measured) const {
  const std::size_t n = row_count("depth", depth, parts_->points);
  require_depths(depth, parts_->points, n);
  require_room("measured", measured, parts_->points, n);
  parts_->measured_depth(depth, n, measured);
}

void Probe::law(const ProbeStates& states, const ProbedLaw& out) const {
  const std::size_t n = require_states(states, parts_->points, parts_->fuzzy);
  require_room("wrench", out.wrench, 6, n);
  if (!out.fuzzy_output.empty()) require_room("fuzzy_output", out.fuzzy_output, 6, n);
  if (!parts_->fuzzy && !(out.error_memberships.empty() && out.rate_memberships.empty() && out.adaptation.empty()))
    refuse("error_memberships", "none, since no fuzzy systems act", "room for some");
  if (!out.error_memberships.empty()) require_room("error_memberships", out.error_memberships, kMemberships, n);
  if (!out.rate_memberships.empty()) require_room("rate_memberships", out.rate_memberships, kMemberships, n);
  if (!out.adaptation.empty()) require_room("adaptation", out.adaptation, 6, n);
  for (std::size_t part = 0; part < kLawParts; ++part) {
    if (out.parts[part].empty()) continue;
    const std::string name = words("parts.", kNamesOf<LawPart>[part]);
    if (!parts_->traits.parts.has(static_cast<LawPart>(part)))
      refuse(name, words("none, since the law ", parts_->traits.name, " has no such part"), "room for some");
    require_room(name.c_str(), out.parts[part], 6, n);
  }
  if (!out.pose_error.empty()) {
    if (!parts_->traits.pose_error())
      refuse("pose_error", words("none, since the law ", parts_->traits.name, " regulates none"), "room for some");
    require_room("pose_error", out.pose_error, 6, n);
  }
  parts_->law(states, n, out);
}

void Probe::acceleration(Rows position, Rows quaternion, Rows twist, Rows wrench, Column acceleration) const {
  const std::size_t n = row_count("position", position, 3);
  require_rows("position", position, 3, n);
  require_quaternions("quaternion", quaternion, n);
  require_rows("twist", twist, 6, n);
  require_rows("wrench", wrench, 6, n);
  require_room("acceleration", acceleration, 6, n);
  for (std::size_t i = 0; i < n; ++i)
    put(acceleration, i,
        hexservo::acceleration(parts_->plant, rotation_matrix(row<4>(quaternion, i)), row<6>(twist, i),
                               row<6>(wrench, i))
            .vector());
}

void Probe::estimated_wrenches(Rows quaternion, Rows twist, Rows acceleration, Column inertial, Column coriolis) const {
  const std::size_t n = row_count("twist", twist, 6);
  require_quaternions("quaternion", quaternion, n);
  require_rows("twist", twist, 6, n);
  require_rows("acceleration", acceleration, 6, n);
  require_room("inertial", inertial, 6, n);
  require_room("coriolis", coriolis, 6, n);
  for (std::size_t i = 0; i < n; ++i) {
    const Matrix3<double> R_BE = rotation_matrix(row<4>(quaternion, i));
    const Vector6<double> chi_rate = row<6>(twist, i);
    put(inertial, i, mass_matrix(parts_->estimate, R_BE) * row<6>(acceleration, i));
    put(coriolis, i, coriolis_matrix<double>(parts_->estimate, R_BE, chi_rate) * chi_rate);
  }
}

void Probe::inertia(Rows quaternion, Column inertia) const {
  const std::size_t n = row_count("quaternion", quaternion, 4);
  require_quaternions("quaternion", quaternion, n);
  require_room("inertia", inertia, 36, n);
  for (std::size_t i = 0; i < n; ++i)
    put_matrix(inertia, i, mass_matrix(parts_->estimate, rotation_matrix(row<4>(quaternion, i))));
}

void Probe::stages(const ProbeStates& states, const ProbedStages& out) const {
  const std::size_t n = require_states(states, parts_->points, parts_->fuzzy);
  require_room("features", out.features, 2 * parts_->points, kStages * n);
  require_room("depth", out.depth, parts_->points, kStages * n);
  require_body_room(out.position, out.quaternion, out.twist, kStages * n);
  require_room("wrench", out.wrench, 6, kStages * n);
  require_room("fuzzy_output", out.fuzzy_output, 6, kStages * n);
  require_room("acceleration", out.acceleration, 6, kStages * n);
  require_room("next_features", out.next_features, 2 * parts_->points, n);
  require_room("next_depth", out.next_depth, parts_->points, n);
  require_body_room(out.next_position, out.next_quaternion, out.next_twist, n);
  if (!parts_->fuzzy && !out.next_weights.empty())
    refuse("next_weights", "none, since no fuzzy systems act", "room for some");
  if (!out.next_weights.empty()) require_room("next_weights", out.next_weights, kWeightNumbers, n);
  parts_->stages(states, n, out);
}

void Probe::moved(const Body& start, const BodyStage& stage, double scale, Column position, Column quaternion,
                  Column twist) {
  const std::size_t n = require_body(start);
  require_stages(stage, n);
  detail::require_finite("scale", scale);
  require_body_room(position, quaternion, twist, n);
  for (std::size_t i = 0; i < n; ++i) {
    BodyMotion<double> body;
    move_body(body_at(start, i), scale, rate_at(stage, i), body);
    put_body(body, i, position, quaternion, twist);
  }
}

void Probe::after(const Body& start, const BodyStage& stages, double step, Column position, Column quaternion,
                  Column twist) {
  const std::size_t n = require_body(start);
  require_stages(stages, kStages * n);
  detail::require_positive("step", step);
  require_body_room(position, quaternion, twist, n);
  for (std::size_t i = 0; i < n; ++i) {
    std::array<BodyMotion<double>, kStages> rates;
    std::array<const BodyMotion<double>*, kStages> each;
    for (std::size_t s = 0; s < kStages; ++s) {
      rates[s] = rate_at(stages, kStages * i + s);
      each[s] = &rates[s];
    }
    put_body(body_after(body_at(start, i), step, each), i, position, quaternion, twist);
  }
}

}  // namespace hexservo
