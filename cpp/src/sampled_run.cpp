#include "hexservo/sampled_run.hpp"

#include "check.hpp"
#include "run_loop.hpp"
#include "trajectory_log.hpp"

namespace hexservo {

using detail::refuse;

struct SampledRun::Books {
  template <class Law>
  Books(const LoopParameters<double, Law>& parameters, std::shared_ptr<const Settings> settings)
      : kept(settings),
        hexapod(parameters.hexapod),
        step(parameters.step),
        plant(parameters),
        log(settings->simulation) {
    request.count = 1;
    request.steps = step_count(settings->simulation);
    request.log_every = settings->simulation.log_every;
    request.answers = &log.answer();
  }

  /// Until all ticks are commanded, the last one included.
  bool running() const noexcept { return !complete && plant.record().running(); }

  std::shared_ptr<const Settings> kept;  ///< a recorded base motion is shared, not copied
  Hexapod<double> hexapod;
  double step;
  CommandedPlant<double> plant;
  detail::TrajectoryLog log;
  RunRequest request{};
  NoState<double> no_weights;  ///< the scenario's law does not act
  std::optional<detail::Log<double, NoState<double>>> rows;
  bool complete = false;
};

SampledRun::SampledRun(const Settings& settings) {
  if (settings.simulation.mode != LoopMode::sampled)
    refuse("simulation.mode", "sampled for a custom controller", "continuous");
  auto kept = std::make_shared<const Settings>(settings);
  books_ = with_law(kept->law(), [&]<class Law>(std::type_identity<Law>) {
    return std::make_unique<Books>(loop_parameters<Law>(*kept), kept);
  });
}

SampledRun::SampledRun(SampledRun&&) noexcept = default;
SampledRun& SampledRun::operator=(SampledRun&&) noexcept = default;
SampledRun::~SampledRun() = default;

bool SampledRun::running() const noexcept { return books_->running(); }

SampledObservation SampledRun::observe() const {
  const SampledPlant<double>& plant = books_->plant.plant();
  const auto& seen = books_->plant.observe();
  SampledObservation observation{
      plant.ticks(), plant.time(), seen.newest * books_->step, {seen.image, seen.pose, seen.twist}};
  const double unknown = std::numeric_limits<double>::quiet_NaN();
  if (!(seen.newest >= 0.0)) observation.exposure = unknown;
  if (!seen.ready()) {
    observation.sensed.image.features.setConstant(unknown);
    observation.sensed.image.depth.setConstant(unknown);
  }
  return observation;
}

void SampledRun::command(const Vector6<double>& wrench) {
  if (!running()) throw std::logic_error("the run has ended: expected no further command");
  detail::require_finite("wrench", wrench);
  Books& b = *books_;
  const FlushSubnormals flush;
  b.plant.command(wrench);
  const long long tick = b.plant.plant().ticks();
  if (!b.rows)
    b.rows.emplace(b.request, b.plant.record(), b.no_weights);
  else if (tick % b.request.log_every == 0)
    b.rows->add();
  if (tick == b.request.steps)
    b.complete = true;
  else if (b.plant.record().running())
    b.plant.advance();
}

void SampledRun::command_legs(const Vector6<double>& leg_forces) {
  detail::require_finite("leg_forces", leg_forces);
  const auto& seen = books_->plant.observe();
  command(inverse_kinematics(books_->hexapod, seen.pose.position, seen.R_BE).wrench(leg_forces));
}

Trajectory SampledRun::finish() {
  Books& b = *books_;
  if (!b.rows) {  // nothing was commanded: the platform at its start
    b.plant.command(Vector6<double>::Zero());
    b.rows.emplace(b.request, b.plant.record(), b.no_weights);
  }
  detail::answer(b.plant.record(), b.no_weights, static_cast<double>(b.plant.plant().ticks()), !b.complete, 0,
                 b.request);
  b.rows->end(0);
  return b.log.finish(b.step, b.hexapod);
}

}  // namespace hexservo
