#include "hexservo/simulation.hpp"

#include "check.hpp"

#include <algorithm>

namespace hexservo {

using detail::refuse;
using detail::words;

namespace {

constexpr long long kStepsBetweenQuestions = 2048;            // a few milliseconds of work between two looks at Ctrl-C
constexpr double kLoggedNumbers = 1 + 8 + 4 + 3 + 4 + 5 * 6;  // per sample: time, features, depth, pose, five 6-vectors

/// Samples that a run logs at most.
std::size_t sample_count(const SimulationSettings& simulation) {
  const auto every = static_cast<double>(simulation.log_every);
  const double samples =
      std::floor(static_cast<double>(step_count(simulation)) / every) + 2.0;  // the first, and the last good one
  const double bytes = samples * kLoggedNumbers * sizeof(double);
  if (bytes > kMaxLogBytes)
    refuse("simulation.log_every",
           words("a log of at most ", kMaxLogBytes / (1 << 30), " GiB (log_every of ",
                 std::ceil(every * bytes / kMaxLogBytes * 1.01), " or more fits)"),
           words(simulation.log_every, ", which makes ", bytes / (1 << 30), " GiB"));
  return static_cast<std::size_t>(samples);
}

template <int N>
void put(Column& column, std::size_t row, const Vector<double, N>& values) {
  std::copy_n(values.data(), N, column.data() + row * N);
}

void resize(Trajectory& log, std::size_t samples) {
  log.time.resize(samples);
  log.feature_error.resize(samples * 8);
  log.depth.resize(samples * 4);
  log.position.resize(samples * 3);
  log.quaternion.resize(samples * 4);
  for (auto* column : {&log.twist, &log.wrench, &log.fuzzy_output, &log.leg_lengths, &log.leg_forces})
    column->resize(samples * 6);
}

void put(Trajectory& log, std::size_t row, double time, const Sample<double>& sample) {
  log.time[row] = time;
  put(log.feature_error, row, sample.feature_error);
  put(log.depth, row, sample.depth);
  put(log.position, row, sample.position);
  put(log.quaternion, row, sample.quaternion);
  put(log.twist, row, sample.twist);
  put(log.wrench, row, sample.wrench);
  put(log.fuzzy_output, row, sample.fuzzy_output);
  put(log.leg_lengths, row, sample.leg_lengths);
  put(log.leg_forces, row, sample.leg_forces);
}

std::string describe(StopCause cause, double time) {
  const std::string at = words(" at t = ", time, " s");
  switch (cause) {
    case StopCause::not_finite:
      return "a number was no longer finite" + at;
    case StopCause::feature_error:
      return words("a feature error exceeded ", kMaxFeatureError, " px", at);
    case StopCause::twist:
      return words("the twist exceeded ", kMaxTwist, " m/s or rad/s", at);
    case StopCause::behind_camera:
      return "a target point came behind the camera" + at;
    case StopCause::singular:
      return "the legs came to a singular pose" + at;
    case StopCause::none:
      break;
  }
  return "ran to the end";
}

void add_events(std::vector<LimitEvent>& events, LimitEvent::Kind kind, const LegLimitMonitor<double>& monitor,
                double limit) {
  for (int leg = 0; leg < 6; ++leg)
    if (std::isfinite(monitor.first_time(leg)))
      events.push_back({kind, leg, monitor.first_time(leg), monitor.peak(leg), limit});
}

}  // namespace

template <class Law>
void check_settings(const Settings<Law>& settings) {
  loop_parameters(settings);
  sample_count(settings.simulation);
}

template void check_settings(const Settings<Hybrid>&);

template <class Law>
Trajectory simulate(const Settings<Law>& settings, const std::function<bool()>& stop_requested) {
  const LoopParameters<double, Law> parameters = loop_parameters(settings);
  const long long steps = step_count(settings.simulation);
  const long long log_every = settings.simulation.log_every;

  Trajectory log;
  resize(log, sample_count(settings.simulation));
  ClosedLoop<double, Law> loop(parameters);
  put(log, 0, 0.0, loop.sample());
  std::size_t rows = 1;
  long long until_logged = log_every;
  while (loop.steps() < steps && loop.running()) {
    if (stop_requested && loop.steps() % kStepsBetweenQuestions == 0 && stop_requested()) {
      log.outcome = Outcome::interrupted;
      break;
    }
    loop.advance();
    if (--until_logged > 0) continue;
    until_logged = log_every;
    if (loop.running()) put(log, rows++, loop.time(), loop.sample());
  }
  if (log.time[rows - 1] != loop.sample_time()) put(log, rows++, loop.sample_time(), loop.sample());
  resize(log, rows);

  log.end_time = loop.sample_time();
  log.steps = loop.steps();
  if (log.outcome == Outcome::interrupted) {
    log.detail = words("stopped on request at t = ", log.end_time, " s");
  } else {
    const auto cause = static_cast<StopCause>(static_cast<int>(loop.cause()));
    log.outcome = outcome_of(cause);
    log.detail = describe(cause, loop.time());
  }
  log.fuzzy_weights = loop.law_state();
  log.metrics = loop.metrics().metrics();
  add_events(log.events, LimitEvent::Kind::stroke, loop.metrics().stroke(), parameters.hexapod.stroke);
  add_events(log.events, LimitEvent::Kind::force, loop.metrics().force(), parameters.hexapod.force_limit);
  std::stable_sort(log.events.begin(), log.events.end(),
                   [](const LimitEvent& a, const LimitEvent& b) { return a.first_time < b.first_time; });
  return log;
}

template Trajectory simulate(const Settings<Hybrid>&, const std::function<bool()>&);

BodyState<double> drive_legs(const Hexapod<double>& hexapod, const RigidBody<double>& body,
                             const DynamicsError<double>& error, const BodyState<double>& start,
                             const Vector6<double>& leg_forces, double step, long long steps) {
  validate(body, error);
  detail::require_finite("start", start);
  detail::require_finite("leg_forces", leg_forces);
  detail::require_positive("step", step);
  if (steps < 1) refuse("steps", "a whole number >= 1", words(steps));
  if (!(start.segment<4>(3).norm() > 0.0)) refuse("start", "a quaternion that is not zero", "zero");

  BodyState<double> state = start;
  normalise_quaternion(state);
  const Plant<double> plant(body, error);
  const auto rate_at = [&](const BodyState<double>& s) {
    const Matrix3<double> R_BE = rotation_matrix(quaternion_of(s));
    return body_rate(plant, s, R_BE, inverse_kinematics(hexapod, position_of(s), R_BE).wrench(leg_forces));
  };
  for (long long i = 0; i < steps; ++i) {
    runge_kutta_step(step, state, rate_at);
    normalise_quaternion(state);
  }
  return state;
}

}  // namespace hexservo
