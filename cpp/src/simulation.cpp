#include "hexservo/simulation.hpp"

#include "check.hpp"
#include "run_request.hpp"

#include <algorithm>
#include <exception>

namespace hexservo {

using detail::refuse;
using detail::words;

namespace {

constexpr long long kStepsBetweenQuestions = 2048;  // a few milliseconds of work between two looks at Ctrl-C
static_assert(kStepsBetweenQuestions % kQuestionEvery == 0);
constexpr int kLoggedNumbers = 1 + kSampleNumbers;  // per row

/// Samples that a run logs at most.
std::size_t sample_count(const SimulationSettings& simulation) {
  const auto every = static_cast<double>(simulation.log_every);
  const double samples =
      std::floor(static_cast<double>(step_count(simulation)) / every) + 2.0;  // the first, and the last good one
  const double bytes = samples * kLoggedNumbers * static_cast<double>(sizeof(double));
  if (bytes > kMaxLogBytes)
    refuse("simulation.log_every",
           words("a log of at most ", kMaxLogBytes / (1 << 30), " GiB (log_every of ",
                 std::ceil(every * bytes / kMaxLogBytes * 1.01), " or more fits)"),
           words(simulation.log_every, ", which makes ", bytes / (1 << 30), " GiB"));
  return static_cast<std::size_t>(samples);
}

/// The columns of a log, in the order of `Sample::visit`.
std::array<Column*, kQuantities> columns_of(Trajectory& log) {
  return {&log.feature_error, &log.depth,        &log.position,    &log.quaternion, &log.twist,
          &log.wrench,        &log.fuzzy_output, &log.leg_lengths, &log.leg_forces};
}

/// Lays out the columns for `samples` rows, one after another.
void allocate(Trajectory& log, std::size_t samples) {
  log.block = Buffer(samples * kLoggedNumbers);
  double* next = log.block.data();
  log.time = {next, samples};
  next += samples;
  const auto columns = columns_of(log);
  for (std::size_t i = 0; i < columns.size(); ++i) {
    *columns[i] = {next, samples * static_cast<std::size_t>(kSampleWidths[i])};
    next += columns[i]->size();
  }
}

void shorten(Trajectory& log, std::size_t rows) {
  log.time = log.time.first(rows);
  const auto columns = columns_of(log);
  for (std::size_t i = 0; i < columns.size(); ++i)
    *columns[i] = columns[i]->first(rows * static_cast<std::size_t>(kSampleWidths[i]));
}

/// Asks the caller between steps; what that throws waits until the kernel has returned.
struct Question {
  const std::function<bool()>& stop_requested;
  std::exception_ptr error;

  static bool ask(void* context, long long steps) {
    auto& question = *static_cast<Question*>(context);
    if (steps % kStepsBetweenQuestions != 0) return false;
    try {
      return question.stop_requested();
    } catch (...) {
      question.error = std::current_exception();
      return true;
    }
  }
};

void add_events(std::vector<LimitEvent>& events, LimitEvent::Kind kind, const double (&first_time)[6],
                const double (&peak)[6], double limit) {
  for (std::size_t leg = 0; leg < 6; ++leg)
    if (std::isfinite(first_time[leg]))
      events.push_back({kind, static_cast<int>(leg), first_time[leg], peak[leg], limit});
}

FuzzyWeights<double> weights_from(const double* numbers) {
  FuzzyWeights<double> weights;
  for (int axis = 0; axis < kAxes; ++axis)
    for (int row = 0; row < kTerms; ++row)
      for (int column = 0; column < kTerms; ++column) weights[rule(row, column)].set(axis, *numbers++);
  return weights;
}

}  // namespace

std::string describe(StopCause cause, double time, int leg) {
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
    case StopCause::feature_lost:
      return "a frame did not show every target point" + at;
    case StopCause::leg_limit:
      return words("leg ", leg + 1, " passed its stroke", at);
    case StopCause::solver_failed:
      return "the leg lengths that the encoders gave belong to no pose near the one before" + at;
    case StopCause::singular:
      return "the legs came to a singular pose" + at;
    case StopCause::none:
      break;
  }
  return "ran to the end";
}

template <class Law>
void check_settings(const Settings<Law>& settings) {
  loop_parameters(settings);
  sample_count(settings.simulation);
}

template <class Law>
Trajectory simulate(const Settings<Law>& settings, const std::function<bool()>& stop_requested, const Kernel& kernel) {
  const LoopParameters<double, Law> parameters = loop_parameters(settings);
  Trajectory log;
  allocate(log, sample_count(settings.simulation));

  std::array<double, kWeightNumbers> weights;
  RunAnswer answer{};
  answer.time = log.time.data();
  const auto columns = columns_of(log);
  for (std::size_t i = 0; i < columns.size(); ++i) answer.columns[i] = columns[i]->data();
  answer.weights = weights.data();

  const std::vector<double> numbers = detail::flattened(parameters);
  const double* scenario = numbers.data();
  Question question{stop_requested, nullptr};
  RunRequest request = detail::run_request<Law>(settings.simulation, settings.base_motion, numbers.size());
  request.count = 1;
  request.parameters = &scenario;
  request.log_every = settings.simulation.log_every;
  request.log_end = true;
  if (stop_requested) {
    request.stop = Question::ask;
    request.context = &question;
  }
  request.answers = &answer;
  detail::require_done(kernel.run_single(request));
  if (question.error) std::rethrow_exception(question.error);
  shorten(log, static_cast<std::size_t>(answer.rows));

  log.end_time = answer.end_time;
  log.steps = answer.steps;
  if (answer.interrupted) {
    log.outcome = Outcome::interrupted;
    log.detail = words("stopped on request at t = ", log.end_time, " s");
  } else {
    const auto cause = static_cast<StopCause>(answer.cause);
    log.outcome = outcome_of(cause);
    log.detail = describe(cause, static_cast<double>(log.steps) * parameters.step, answer.limit_leg);
  }
  log.fuzzy_weights = weights_from(weights.data());
  const double* metric = answer.metrics;
  Metrics<double>::visit([&metric](double& value, const double&) { value = *metric++; }, log.metrics, log.metrics);
  add_events(log.events, LimitEvent::Kind::stroke, answer.stroke_first_time, answer.stroke_peak,
             parameters.hexapod.stroke);
  add_events(log.events, LimitEvent::Kind::force, answer.force_first_time, answer.force_peak,
             parameters.hexapod.force_limit);
  std::stable_sort(log.events.begin(), log.events.end(),
                   [](const LimitEvent& a, const LimitEvent& b) { return a.first_time < b.first_time; });
  return log;
}

#define HEXSERVO_HERE(Law)                            \
  template void check_settings(const Settings<Law>&); \
  template Trajectory simulate(const Settings<Law>&, const std::function<bool()>&, const Kernel&);
HEXSERVO_FOR_EACH_LAW(HEXSERVO_HERE)
#undef HEXSERVO_HERE

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
