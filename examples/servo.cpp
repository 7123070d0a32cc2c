// A servo loop at 1 kHz: read the sensors, take a tick, command the legs, sleep until the next period. No Python, no
// heap.
//
// Sensors and legs are simulated here by `Robot`; its two functions are what a real program would replace. The gains
// in gains.hpp were written by `hexservo export paper --header gains.hpp`.
//
//   servo [SECONDS]    how long to run, 1 s if not given; exit code 0 if the features reach their goal
#include "gains.hpp"

#include <hexservo/controller.hpp>
#include <hexservo/runge_kutta.hpp>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <thread>

namespace {

using hexservo::ControllerInput;
using hexservo::ControllerOutput;
using hexservo::Hybrid;

/// The scenario's robot, with the paper's errors: inertia and depths are not what the controller believes.
class Robot {
 public:
  Robot() : Robot(hexservo::loop_parameters(hexservo_paper::settings())) {}

  /// What camera and joint sensors say now.
  ControllerInput read_sensors() const {
    return {hexservo::measured_image(image(), depth_error_),
            {hexservo::position_of(body_), hexservo::quaternion_of(body_)},
            hexservo::twist_of(body_)};
  }

  /// The legs push with these forces [N] for a time [s].
  void push(const hexservo::Vector6<double>& leg_forces, double time) {
    hexservo::runge_kutta_step(time, body_, [&](const hexservo::BodyState<double>& body) {
      const auto R_BE = hexservo::rotation_matrix(hexservo::quaternion_of(body));
      const auto legs = hexservo::inverse_kinematics(hexapod_, hexservo::position_of(body), R_BE);
      return hexservo::body_rate(plant_, body, R_BE, legs.wrench(leg_forces));
    });
    hexservo::normalise_quaternion(body_);
  }

  /// Largest true feature error [px].
  double error(const hexservo::Vector<double, 8>& goal) const {
    return (goal - image().features).cwiseAbs().maxCoeff();
  }

 private:
  explicit Robot(const hexservo::LoopParameters<double, Hybrid>& p)
      : focal_pixels_(p.camera.focal_pixels()),
        points_B_(p.points_B),
        hexapod_(p.hexapod),
        plant_(p.body, errors()),
        body_(hexservo::body_state<double>({p.hexapod.home_position, {1.0, 0.0, 0.0, 0.0}},
                                           hexservo::Vector6<double>::Zero())) {
    depth_error_.setConstant(0.3);
  }

  static hexservo::DynamicsError<double> errors() {
    hexservo::DynamicsError<double> errors;
    errors.inertia.setConstant(0.075);
    errors.coriolis.setConstant(0.125);
    return errors;
  }

  hexservo::Image<double> image() const {
    return hexservo::take_image(focal_pixels_, hexservo::position_of(body_),
                                hexservo::rotation_matrix(hexservo::quaternion_of(body_)), points_B_);
  }

  double focal_pixels_;
  Eigen::Matrix<double, 3, 4> points_B_;
  hexservo::Hexapod<double> hexapod_;
  hexservo::Plant<double> plant_;
  hexservo::Vector4<double> depth_error_;
  hexservo::BodyState<double> body_;
};

}  // namespace

int main(int argc, char** argv) {
  using Clock = std::chrono::steady_clock;
  const double seconds = argc > 1 ? std::strtod(argv[1], nullptr) : 1.0;
  if (!(seconds > 0.0 && seconds <= 3600.0)) {
    std::fprintf(stderr, "servo: expected seconds > 0 and <= 3600, got \"%s\"\n", argv[1]);
    return 2;
  }

  const auto gains = hexservo_paper::controller_gains();  // may throw: before the loop, never in it
  auto state = hexservo::initial_state(gains);
  Robot robot;

  const auto period = std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(gains.period));
  const long ticks = static_cast<long>(seconds / gains.period + 0.5);
  Clock::duration slowest{};
  double settled_at = 0.0;
  long missed = 0, invalid = 0;
  Clock::time_point deadline = Clock::now();
  for (long tick = 0; tick < ticks; ++tick) {
    const ControllerInput input = robot.read_sensors();
    const Clock::time_point before = Clock::now();
    const ControllerOutput output = hexservo::step(gains, state, input);
    slowest = std::max(slowest, Clock::now() - before);
    robot.push(output.leg_forces, gains.period);

    invalid += output.invalid_input() ? 1 : 0;
    if (robot.error(gains.task.desired_features) > 2.0) settled_at = static_cast<double>(tick + 1) * gains.period;
    deadline += period;  // an absolute clock: a late tick does not move the later ones
    if (Clock::now() > deadline) ++missed;
    std::this_thread::sleep_until(deadline);
  }

  const double error = robot.error(gains.task.desired_features);
  const bool settled = error <= 2.0 && invalid == 0;
  std::printf("%ld ticks of %g ms; slowest tick %.2f us, deadlines missed %ld, invalid inputs %ld\n", ticks,
              1e3 * gains.period, 1e6 * std::chrono::duration<double>(slowest).count(), missed, invalid);
  if (settled)
    std::printf("features within 2 px from %.3f s on, %.3f px at the end\n", settled_at, error);
  else
    std::printf("features not settled: %.3f px at the end\n", error);
  return settled ? EXIT_SUCCESS : EXIT_FAILURE;
}
