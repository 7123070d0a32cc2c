#include "trajectory_log.hpp"

#include "check.hpp"
#include "weight_rows.hpp"

#include <algorithm>

namespace hexservo::detail {

namespace {

/// Per row of a log.
std::size_t logged_numbers(int points, bool log_weights) {
  return static_cast<std::size_t>(1 + sample_numbers(points)) +
         (log_weights ? std::size_t{kWeightNumbers} : std::size_t{0});
}

/// The columns of a log, in the order of `Sample::visit`.
std::array<Column*, kQuantities> columns_of(Trajectory& log) {
  return {&log.feature_error, &log.depth,        &log.position,    &log.quaternion, &log.twist,
          &log.wrench,        &log.fuzzy_output, &log.leg_lengths, &log.leg_forces};
}

/// Lays out the columns for `samples` rows, one after another.
void allocate(Trajectory& log, std::size_t samples, bool log_weights) {
  log.block = Buffer(samples * logged_numbers(log.points, log_weights));
  double* next = log.block.data();
  log.time = {next, samples};
  next += samples;
  const auto columns = columns_of(log);
  for (std::size_t i = 0; i < columns.size(); ++i) {
    *columns[i] = {next, samples * static_cast<std::size_t>(sample_width(i, log.points))};
    next += columns[i]->size();
  }
  if (log_weights) log.weight_history = {next, samples * kWeightNumbers};
}

void shorten(Trajectory& log, std::size_t rows) {
  log.time = log.time.first(rows);
  const auto columns = columns_of(log);
  for (std::size_t i = 0; i < columns.size(); ++i)
    *columns[i] = columns[i]->first(rows * static_cast<std::size_t>(sample_width(i, log.points)));
  if (!log.weight_history.empty()) log.weight_history = log.weight_history.first(rows * kWeightNumbers);
}

void add_events(std::vector<LimitEvent>& events, LimitEvent::Kind kind, const double (&first_time)[6],
                const double (&peak)[6], double limit) {
  for (std::size_t leg = 0; leg < 6; ++leg)
    if (std::isfinite(first_time[leg]))
      events.push_back({kind, static_cast<int>(leg), first_time[leg], peak[leg], limit});
}

/// The same where tilts are given by their chords.
void add_tilt_events(std::vector<LimitEvent>& events, LimitEvent::Kind kind, const double (&first_time)[6],
                     const double (&chord)[6], double limit) {
  double peak[6];
  for (std::size_t leg = 0; leg < 6; ++leg) peak[leg] = angle_of_chord(chord[leg]);
  add_events(events, kind, first_time, peak, angle_of_chord(limit));
}

/// The leg beyond a limit that ended a run.
LimitEvent stop_event(StopCause cause, const RunAnswer& answer, double time, const Hexapod<double>& hexapod) {
  const auto event = [&](LimitEvent::Kind kind, double peak, double limit) {
    return LimitEvent{kind, answer.limit_leg, time, peak, limit};
  };
  const double value = answer.limit_value;
  switch (cause) {
    case StopCause::leg_speed:
      return event(LimitEvent::Kind::speed, value, hexapod.speed_limit);
    case StopCause::base_joint:
      return event(LimitEvent::Kind::base_joint, angle_of_chord(value), angle_of_chord(hexapod.joint_chords(0)));
    case StopCause::platform_joint:
      return event(LimitEvent::Kind::platform_joint, angle_of_chord(value), angle_of_chord(hexapod.joint_chords(1)));
    default:
      return event(LimitEvent::Kind::stroke, value, hexapod.stroke);
  }
}

}  // namespace

std::size_t sample_count(const SimulationSettings& simulation, int points, bool log_weights) {
  const auto every = static_cast<double>(simulation.log_every);
  const double samples =
      std::floor(static_cast<double>(step_count(simulation)) / every) + 2.0;  // the first, and the last good one
  const double bytes = samples * static_cast<double>(logged_numbers(points, log_weights) * sizeof(double));
  if (bytes > kMaxLogBytes)
    refuse("simulation.log_every",
           words("a log of at most ", kMaxLogBytes / (1 << 30), " GiB (log_every of ",
                 std::ceil(every * bytes / kMaxLogBytes * 1.01), " or more fits)"),
           words(simulation.log_every, ", which makes ", bytes / (1 << 30), " GiB"));
  return static_cast<std::size_t>(samples);
}

TrajectoryLog::TrajectoryLog(const SimulationSettings& simulation, int points, bool log_weights) {
  trajectory_.points = points;
  allocate(trajectory_, sample_count(simulation, points, log_weights), log_weights);
  answer_.time = trajectory_.time.data();
  const auto columns = columns_of(trajectory_);
  for (std::size_t i = 0; i < columns.size(); ++i) answer_.columns[i] = columns[i]->data();
  answer_.weights = weights_.data();
  if (log_weights) answer_.weight_rows = trajectory_.weight_history.data();
}

Trajectory TrajectoryLog::finish(double step, const Hexapod<double>& hexapod) {
  Trajectory& log = trajectory_;
  shorten(log, static_cast<std::size_t>(answer_.rows));
  log.end_time = answer_.end_time;
  log.steps = answer_.steps;
  log.stop_time = log.end_time;
  if (answer_.interrupted) {
    log.outcome = Outcome::interrupted;
    log.detail = words("stopped on request at t = ", log.end_time, " s");
  } else {
    const auto cause = static_cast<StopCause>(answer_.cause);
    log.outcome = outcome_of(cause);
    log.stop_time = static_cast<double>(log.steps) * step;
    log.detail = describe(cause, log.stop_time, answer_.limit_leg);
    if (log.outcome == Outcome::leg_limit) log.events.push_back(stop_event(cause, answer_, log.stop_time, hexapod));
  }
  log.fuzzy_weights = weights_from(weights_.data());
  const double* metric = answer_.metrics;
  Metrics<double>::visit([&metric](const char*, double& value) { value = *metric++; }, log.metrics);
  add_events(log.events, LimitEvent::Kind::stroke, answer_.stroke_first_time, answer_.stroke_peak, hexapod.stroke);
  add_events(log.events, LimitEvent::Kind::force, answer_.force_first_time, answer_.force_peak, hexapod.force_limit);
  add_events(log.events, LimitEvent::Kind::speed, answer_.speed_first_time, answer_.speed_peak, hexapod.speed_limit);
  add_tilt_events(log.events, LimitEvent::Kind::base_joint, answer_.base_joint_first_time, answer_.base_joint_peak,
                  hexapod.joint_chords(0));
  add_tilt_events(log.events, LimitEvent::Kind::platform_joint, answer_.platform_joint_first_time,
                  answer_.platform_joint_peak, hexapod.joint_chords(1));
  std::stable_sort(log.events.begin(), log.events.end(),
                   [](const LimitEvent& a, const LimitEvent& b) { return a.first_time < b.first_time; });
  return std::move(log);
}

}  // namespace hexservo::detail
