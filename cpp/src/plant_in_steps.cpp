#include "plant_in_steps.hpp"

#include "check.hpp"
#include "run_loop.hpp"

#include <utility>

namespace hexservo::detail {

namespace {

template <int N>
class PlantOf final : public PlantInSteps {
 public:
  template <class Law>
  PlantOf(const Settings& given, const LoopParameters<double, Law, N>& p)
      : PlantInSteps(given), period_(p.step), encoders_(p.pose_source == PoseSource::encoders), plant_(p) {
    keep();
  }

  void command(const Vector6<double>& command) override {
    const FlushSubnormals flush;
    if (plant_.takes_positions())
      plant_.position(command);
    else
      plant_.command(command);
    if (plant_.record().running()) plant_.advance();
    keep();
  }

 private:
  /// Takes over what sensors and record have now.
  void keep() {
    const SensorInput<double, N>& raw = plant_.plant().sense();
    const Perceived<double, N>& seen = plant_.observe();
    sensed.now = plant_.plant().time();
    sensed.frame.exposure = raw.frame.exposure * period_;
    sensed.frame.image.features.template head<2 * N>() = raw.frame.image.features;
    sensed.frame.image.depth.template head<N>() = raw.frame.image.depth;
    sensed.pose = encoders_ ? seen.pose : raw.pose;
    sensed.twist = encoders_ ? seen.twist : raw.twist;
    if (encoders_) sensed.joints = raw.joints;
    double* next = sample.data();
    write_sample(plant_.record().sample(), points, 0,
                 [&](std::size_t quantity) { return std::exchange(next, next + sample_width(quantity, points)); });
    time = plant_.record().sample_time();
    cause = static_cast<StopCause>(plant_.record().cause());
  }

  double period_;
  bool encoders_;
  CommandedPlant<double, N> plant_;
};

}  // namespace

void require_sampled(const Settings& settings, const std::string& by) {
  if (settings.simulation.mode != LoopMode::sampled) refuse("simulation.mode", "sampled for " + by, "continuous");
}

void require_commanded(const Settings& settings, const std::string& by) {
  require_sampled(settings, by);
  if (takes_positions(settings.actuators.kind))
    refuse("actuators.kind", words("force for ", by, ", whose wrench acts on the platform"),
           "one that takes positions");
}

std::unique_ptr<PlantInSteps> commanded_plant(const Settings& settings) {
  require_sampled(settings, "a plant that is commanded");
  return with_loop(
      settings,
      [&]<class Law, int N>(std::type_identity<Law>, std::integral_constant<int, N>) -> std::unique_ptr<PlantInSteps> {
        const FlushSubnormals flush;
        return std::make_unique<PlantOf<N>>(settings, loop_parameters<Law, N>(settings));
      });
}

}  // namespace hexservo::detail
