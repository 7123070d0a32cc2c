#include "hexservo/simulation.hpp"

#include "check.hpp"
#include "run_request.hpp"
#include "trajectory_log.hpp"

#include <exception>

namespace hexservo {

using detail::refuse;
using detail::words;

namespace {

constexpr long long kStepsBetweenQuestions = 2048;  // a few milliseconds of work between two looks at Ctrl-C

/// Asks the caller between steps; what that throws waits until the kernel has returned.
struct Question {
  const std::function<bool()>& stop_requested;
  std::exception_ptr error;

  static bool ask(void* context, long long /*steps*/) {
    auto& question = *static_cast<Question*>(context);
    try {
      return question.stop_requested();
    } catch (...) {
      question.error = std::current_exception();
      return true;
    }
  }
};

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
    case StopCause::leg_speed:
      return words("leg ", leg + 1, " passed its speed limit", at);
    case StopCause::base_joint:
      return words("the base joint of leg ", leg + 1, " passed its limit", at);
    case StopCause::platform_joint:
      return words("the platform joint of leg ", leg + 1, " passed its limit", at);
    case StopCause::solver_failed:
      return "the leg lengths that the encoders gave belong to no pose near the one before" + at;
    case StopCause::singular:
      return "the legs came to a singular pose" + at;
    case StopCause::none:
      break;
  }
  return "ran to the end";
}

void check_settings(const Settings& settings) {
  with_loop(settings, [&]<class Law, int N>(std::type_identity<Law>, std::integral_constant<int, N>) {
    loop_parameters<Law, N>(settings);
  });
  detail::sample_count(settings.simulation, settings.target.count());
}

Trajectory simulate(const Settings& settings, const std::function<bool()>& stop_requested, const Kernel& kernel,
                    bool log_weights) {
  std::vector<double> numbers(detail::flat_size(settings));
  const detail::Prepared prepared = detail::prepare(settings, nullptr, numbers.data());
  detail::TrajectoryLog log(settings.simulation, settings.target.count(), log_weights && prepared.fuzzy);
  const double* scenario = numbers.data();
  Question question{stop_requested, nullptr};
  RunRequest request = detail::run_request(settings, settings.simulation);
  request.count = 1;
  request.parameters = &scenario;
  request.log_every = settings.simulation.log_every;
  request.log_end = true;
  if (stop_requested) {
    request.stop = Question::ask;
    request.context = &question;
    request.ask_every = detail::ask_every(settings.simulation, kStepsBetweenQuestions);
  }
  request.answers = &log.answer();
  detail::require_done(kernel.run_single(request));
  if (question.error) std::rethrow_exception(question.error);
  return log.finish(settings.simulation.step, prepared.hexapod);
}

BodyState<double> drive_legs(const Hexapod<double>& hexapod, const RigidBody<double>& body,
                             const DynamicsError<double>& error, const BodyState<double>& start,
                             const Vector6<double>& leg_forces, double step, long long steps) {
  validate(body, error);
  detail::require_finite("start", start);
  detail::require_finite("leg_forces", leg_forces);
  detail::require_positive("step", step);
  if (steps < 1) refuse("steps", "a whole number >= 1", words(steps));
  if (!(start.segment<4>(3).norm() > 0.0)) refuse("start", "a quaternion that is not zero", "zero");

  BodyMotion<double> motion = BodyMotion<double>::of(start);
  normalise_quaternion(motion);
  const Plant<double> plant(body, error);
  const auto rate_at = [&](const BodyMotion<double>& at) {
    const Matrix3<double> R_BE = rotation_matrix(quaternion_of(at));
    return body_rate(plant, at, R_BE, inverse_kinematics(hexapod, position_of(at), R_BE).wrench(leg_forces));
  };
  for (long long i = 0; i < steps; ++i) {
    runge_kutta_step(step, motion, rate_at);
    normalise_quaternion(motion);
  }
  return motion.state();
}

}  // namespace hexservo
