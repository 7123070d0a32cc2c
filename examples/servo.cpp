// A servo loop: read the sensors, take a tick, command the legs, sleep until the next period. No Python, no heap.
//
// Camera, joint sensors and legs are simulated here by `Robot`; its two functions are what a real program would
// replace. gains.hpp is written by `hexservo export SCENARIO --header gains.hpp` and found in the folders that the
// compiler is given (-I, or GAINS of CMakeLists.txt); the one beside this file is the paper's. The header of any
// machine will do, whatever number of points its target has: drives that take forces are commanded `leg_forces`, those
// that take positions `leg_positions` (docs/position-machines.md).
//
//   servo [SECONDS]    how long to run, 1 s if not given; exit code 0 if the features settle at their goal
#include <gains.hpp>

#include <hexservo/controller.hpp>
#include <hexservo/position_actuators.hpp>
#include <hexservo/runge_kutta.hpp>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <thread>

namespace {

namespace exported = HEXSERVO_GAINS;
using exported::Law;
using hexservo::ControllerOutput;

/// The scenario's robot, with errors: inertia and depths are not what the controller estimates. Drives that take
/// positions follow them by the response and the delay of the scenario, whatever the inertia.
/// @tparam N places for points, those of the header's gains
template <int N>
class Robot {
 public:
  explicit Robot(const hexservo::ControllerGains<Law, N>& gains)
      : gains_(gains),
        parameters_(hexservo::loop_parameters<Law, N>(exported::settings())),
        points_B_(parameters_.points_T),
        plant_(gains.task.body, errors()),
        body_(hexservo::BodyMotion<double>::at_rest(hexservo::home_pose(gains.hexapod))),
        camera_(gains.frames, {}),
        encoders_(gains.encoders, {}) {
    depth_error_.setConstant(0.3);
    if (!gains.motion.acts) return;
    parameters_.actuators.leg_steps = hexservo::leg_steps(parameters_.actuators.position, gains.period);
    drives_.emplace(parameters_.actuators, gains.period, legs(body_).lengths, hexservo::Vector6<double>::Zero());
  }

  /// What camera and joint sensors give at a tick; a frame arrives with the latency of the scenario.
  hexservo::ControllerInputOf<N> read_sensors(long tick) {
    hexservo::ControllerInputOf<N> input;
    input.now = static_cast<double>(tick) * gains_.period;  // on a robot its clock, since periods may be dropped
    hexservo::Image<double, N> seen = hexservo::measured_image(image(), depth_error_);
    seen.features = gains_.lens.pixels(seen.features);  // a frame holds pixels of the camera
    camera_.expose(tick, seen);
    camera_.deliver(tick, frame_);
    input.frame = {frame_.exposure * gains_.period, frame_.image};
    if (gains_.pose_source == hexservo::PoseSource::encoders) {
      input.joints = encoders_.read(tick, legs(body_).side_by_side(), hexservo::twist_of(body_));
    } else {
      input.pose = {hexservo::position_of(body_), hexservo::quaternion_of(body_)};
      input.twist = hexservo::twist_of(body_);
    }
    return input;
  }

  /// The drives do for a period what the controller commands: they push, or go to positions.
  void command(const ControllerOutput& output) {
    if (drives_)
      go_to(output.leg_positions);
    else
      push(output.leg_forces);
  }

  /// Largest true feature error [px].
  double error() const { return (gains_.desired_features - image().features).cwiseAbs().maxCoeff(); }

 private:
  /// The legs push with these forces [N].
  void push(const hexservo::Vector6<double>& leg_forces) {
    hexservo::runge_kutta_step(gains_.period, body_, [&](const hexservo::BodyMotion<double>& body) {
      return hexservo::body_rate(plant_, body, attitude(body), legs(body).wrench(leg_forces));
    });
    hexservo::normalise_quaternion(body_);
  }

  /// The legs go towards these lengths [m], or angles of cranks [rad], and the platform follows.
  void go_to(const hexservo::Vector6<double>& leg_positions) {
    if (!leg_positions.allFinite()) return;  // before the joints have been read once
    drives_->command(leg_positions);
    drives_->advance();
    const hexservo::Pose<double> before{hexservo::position_of(body_), hexservo::quaternion_of(body_)};
    const auto found = hexservo::forward_kinematics(gains_.legs, drives_->positions(), before);
    const hexservo::WrenchMapSolver<double> solver(gains_.legs, found.legs);
    body_ = hexservo::BodyMotion<double>::of(hexservo::body_state<double>(found.pose, solver.twist(drives_->rates())));
  }

  static hexservo::DynamicsError<double> errors() {
    hexservo::DynamicsError<double> errors;
    errors.inertia.setConstant(0.075);
    errors.coriolis.setConstant(0.125);
    return errors;
  }

  static hexservo::Matrix3<double> attitude(const hexservo::BodyMotion<double>& body) {
    return hexservo::rotation_matrix(hexservo::quaternion_of(body));
  }
  hexservo::Legs<double> legs(const hexservo::BodyMotion<double>& body) const {
    return hexservo::inverse_kinematics(gains_.hexapod, hexservo::position_of(body), attitude(body));
  }
  hexservo::Image<double, N> image() const {
    return hexservo::take_image(gains_.camera, hexservo::position_of(body_), attitude(body_), points_B_);
  }

  const hexservo::ControllerGains<Law, N>& gains_;
  hexservo::LoopParameters<double, Law, N> parameters_;
  Eigen::Matrix<double, 3, N> points_B_;
  hexservo::Plant<double> plant_;
  hexservo::Vector<double, N> depth_error_;
  hexservo::BodyMotion<double> body_;
  std::optional<hexservo::PositionedLegs<double>> drives_;  ///< where they take positions
  hexservo::Frames<double, N> camera_;
  hexservo::Frame<double, N> frame_;
  hexservo::Encoders<double> encoders_;
};

}  // namespace

int main(int argc, char** argv) {
  using Clock = std::chrono::steady_clock;
  const double seconds = argc > 1 ? std::strtod(argv[1], nullptr) : 1.0;
  if (!(seconds > 0.0 && seconds <= 3600.0)) {
    std::fprintf(stderr, "servo: expected seconds > 0 and <= 3600, got \"%s\"\n", argv[1]);
    return 2;
  }

  std::printf("gains of the scenario \"%s\"\n", exported::scenario_name);
  const auto gains = exported::controller_gains();  // may throw: before the loop, never in it
  auto state = hexservo::initial_state(gains);      // takes the memory that the ticks need
  Robot robot(gains);
  const auto settling = exported::settings().metrics;

  const auto period = std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(gains.period));
  const long ticks = static_cast<long>(seconds / gains.period + 0.5);
  Clock::duration slowest{};
  double within_since = 0.0;
  long missed = 0, invalid = 0;
  Clock::time_point deadline = Clock::now();
  for (long tick = 0; tick < ticks; ++tick) {
    const auto input = robot.read_sensors(tick);
    const Clock::time_point before = Clock::now();
    const ControllerOutput output = hexservo::step(gains, state, input);
    slowest = std::max(slowest, Clock::now() - before);
    robot.command(output);

    invalid += output.invalid_input() ? 1 : 0;
    if (!(robot.error() <= settling.band)) within_since = static_cast<double>(tick + 1) * gains.period;
    deadline += period;  // an absolute clock: a tick that begins late does not move the later ones
    if (const Clock::time_point now = Clock::now(); now > deadline) {
      ++missed;
      deadline = now + period;  // periods that passed are dropped: a burst of commands would move the legs too fast
    }
    std::this_thread::sleep_until(deadline);
  }

  const double error = robot.error(), end = static_cast<double>(ticks) * gains.period;
  const bool settled = error <= settling.band && end - within_since >= std::min(settling.dwell, end);
  std::printf("%ld ticks of %g ms; slowest tick %.2f us, deadlines missed %ld, ticks without the law %ld\n", ticks,
              1e3 * gains.period, 1e6 * std::chrono::duration<double>(slowest).count(), missed, invalid);
  if (settled)
    std::printf("features within %g px from %.3f s on, %.3f px at the end\n", settling.band, within_since, error);
  else
    std::printf("features not settled: %.3f px at the end\n", error);
  return settled ? EXIT_SUCCESS : EXIT_FAILURE;
}
