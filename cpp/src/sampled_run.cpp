#include "hexservo/sampled_run.hpp"

#include "check.hpp"
#include "plant_in_steps.hpp"
#include "run_loop.hpp"
#include "trajectory_log.hpp"

#include <limits>
#include <string>

namespace hexservo {

/// A run of any number of points.
struct SampledRun::Books {
  virtual ~Books() = default;
  virtual bool running() const noexcept = 0;
  virtual SampledObservation observe() const = 0;
  virtual void command(const Vector6<double>& wrench) = 0;
  virtual void command_legs(const Vector6<double>& leg_forces) = 0;
  virtual void command_positions(const Vector6<double>& positions) = 0;
  virtual Trajectory finish() = 0;
};

template <int N>
struct SampledRun::BooksOf final : Books {
  template <class Law>
  BooksOf(const LoopParameters<double, Law, N>& parameters, std::shared_ptr<const Settings> settings)
      : kept(settings),
        hexapod(parameters.hexapod),
        step(parameters.step),
        plant(parameters),
        log(settings->simulation, parameters.points) {
    if (plant.takes_positions()) positions = plant.plant().leg_positions();
    request.count = 1;
    request.points = parameters.points;
    request.steps = step_count(settings->simulation);
    request.log_every = settings->simulation.log_every;
    request.answers = &log.answer();
  }

  /// Until all ticks are commanded, the last one included.
  bool running() const noexcept override { return !complete && plant.record().running(); }

  SampledObservation observe() const override {
    const auto& seen = plant.observe();
    const double unknown = std::numeric_limits<double>::quiet_NaN();
    SampledObservation observation{plant.plant().ticks(),
                                   plant.plant().time(),
                                   seen.newest * step,
                                   seen.image.features.head(2 * request.points),
                                   seen.image.depth.head(request.points),
                                   seen.pose,
                                   seen.twist,
                                   plant.plant().sense().joints,
                                   positions};
    if (!(seen.newest >= 0.0)) observation.exposure = unknown;
    if (!seen.ready()) {
      observation.features.setConstant(unknown);
      observation.depth.setConstant(unknown);
    }
    return observation;
  }

  void command(const Vector6<double>& wrench) override {
    require_drives(false, "a wrench or leg forces");
    detail::require_finite("wrench", wrench);
    const FlushSubnormals flush;
    plant.command(wrench);
    go_on();
  }

  void command_positions(const Vector6<double>& wanted) override {
    require_drives(true, "leg positions");
    detail::require_finite("positions", wanted);
    const FlushSubnormals flush;
    positions = wanted;
    plant.position(positions);
    go_on();
  }

  /// Refuses a command that the drives do not take. @param what it is
  void require_drives(bool take_positions, const char* what) const {
    if (!running()) throw std::logic_error("the run has ended: expected no further command");
    if (plant.takes_positions() != take_positions)
      throw std::invalid_argument(std::string(plant.takes_positions() ? "expected leg positions, which the drives take"
                                                                      : "expected a wrench or leg forces") +
                                  ", got " + what);
  }

  /// Keeps what the tick gave, and goes on to the next one.
  void go_on() {
    const long long tick = plant.plant().ticks();
    if (!rows)
      rows.emplace(request, plant.record(), no_weights);
    else if (tick % request.log_every == 0)
      rows->add();
    if (tick == request.steps)
      complete = true;
    else if (plant.record().running())
      plant.advance();
  }

  void command_legs(const Vector6<double>& leg_forces) override {
    detail::require_finite("leg_forces", leg_forces);
    const auto& seen = plant.observe();
    command(inverse_kinematics(hexapod, seen.pose.position, seen.R_BE).wrench(leg_forces));
  }

  Trajectory finish() override {
    if (!rows) {  // nothing was commanded: the platform at its start
      if (plant.takes_positions())
        plant.position(positions);
      else
        plant.command(Vector6<double>::Zero());
      rows.emplace(request, plant.record(), no_weights);
    }
    RunAnswer& answer = log.answer();
    detail::answer(plant.record(), static_cast<double>(plant.plant().ticks()), !complete, 0, request);
    // Also where only the command of the last tick is missing, whose step has been made.
    answer.interrupted = !complete && answer.cause == static_cast<int>(StopCause::none);
    rows->end(0);
    return log.finish(step, hexapod);
  }

  std::shared_ptr<const Settings> kept;  ///< a recorded base motion is shared, not copied
  Hexapod<double> hexapod;
  double step;
  CommandedPlant<double, N> plant;
  detail::TrajectoryLog log;
  RunRequest request{};
  NoState<double> no_weights;  ///< the scenario's law does not act
  std::optional<detail::Log<double, NoState<double>, N>> rows;
  bool complete = false;
  Vector6<double> positions =
      Vector6<double>::Constant(std::numeric_limits<double>::quiet_NaN());  ///< as commanded last
};

SampledRun::SampledRun(const Settings& settings) {
  detail::require_sampled(settings, "a custom controller");
  auto kept = std::make_shared<const Settings>(settings);
  books_ = with_loop(
      *kept, [&]<class Law, int N>(std::type_identity<Law>, std::integral_constant<int, N>) -> std::unique_ptr<Books> {
        return std::make_unique<BooksOf<N>>(loop_parameters<Law, N>(*kept), kept);
      });
}

SampledRun::SampledRun(SampledRun&&) noexcept = default;
SampledRun& SampledRun::operator=(SampledRun&&) noexcept = default;
SampledRun::~SampledRun() = default;

bool SampledRun::running() const noexcept { return books_->running(); }
SampledObservation SampledRun::observe() const { return books_->observe(); }
void SampledRun::command(const Vector6<double>& wrench) { books_->command(wrench); }
void SampledRun::command_legs(const Vector6<double>& leg_forces) { books_->command_legs(leg_forces); }
void SampledRun::command_positions(const Vector6<double>& positions) { books_->command_positions(positions); }
Trajectory SampledRun::finish() { return books_->finish(); }

namespace {

template <class Places>
auto& at(Places& places, int place) {
  if (place < 0 || static_cast<std::size_t>(place) >= places.size())
    throw std::out_of_range("place: expected 0 to " + std::to_string(places.size() - 1) + ", got " +
                            std::to_string(place));
  return places[static_cast<std::size_t>(place)];
}

}  // namespace

void SampledRuns::One::command(const Vector6<double>& wrench) {
  run.command(wrench);
  seen = run.observe();
}

void SampledRuns::start(int place, const Settings& settings) {
  detail::require_commanded(settings, "a custom controller");
  SampledRun run(settings);
  const SampledObservation first = run.observe();
  One one{std::move(run), first, estimated_body(settings.robot), step_count(settings.simulation)};
  while (one.running() && one.seen.features.hasNaN()) one.command(Vector6<double>::Zero());
  at(places_, place).emplace(std::move(one));
}

void SampledRuns::command(const Eigen::Ref<const Eigen::Matrix<double, 6, Eigen::Dynamic>>& wrenches) {
  if (wrenches.cols() != count())
    throw std::invalid_argument("wrenches: expected " + std::to_string(count()) + " of them, got " +
                                std::to_string(wrenches.cols()));
  if (!wrenches.allFinite()) throw std::invalid_argument("wrenches: expected finite numbers, got NaN or infinity");
  for (int i = 0; i < count(); ++i) {
    std::optional<One>& one = places_[static_cast<std::size_t>(i)];
    if (!one || !one->running()) continue;
    const Vector4<double>& q = one->seen.pose.quaternion;
    const Matrix3<double> R_BE = rotation_matrix<double>(q / q.stableNorm());
    one->command(gravity_wrench(one->body, R_BE) + wrenches.col(i));
  }
}

const SampledRuns::One& SampledRuns::one(int place) const {
  const std::optional<One>& found = at(places_, place);
  if (!found) throw std::logic_error("place " + std::to_string(place) + ": expected a run that was started, got none");
  return *found;
}

}  // namespace hexservo
