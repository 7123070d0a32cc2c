#include "motion.hpp"

#include "check.hpp"

namespace hexservo::detail {

namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kLargestTurn = 0.5;     // of a recording between two samples, which a spline joins [rad]
constexpr double kUnitTolerance = 0.01;  // of the length of a recorded quaternion [1]

/// Of a sine, which is zero at every step where it has two of them.
void require_below(const std::string& key, double frequency, double fastest) {
  if (!(frequency < fastest))
    refuse(key, words("a number from 0 to below ", fastest, " Hz (two steps of the integration)"), words(frequency));
}

/// Frequencies between which noise lies.
template <class Band>
void require_band(const std::string& key, const Band& band, double fastest) {
  if (!(band.low_frequency < band.high_frequency))
    refuse(key + ".low_frequency", words("a number from 0 to below high_frequency, ", band.high_frequency),
           words(band.low_frequency));
  if (!(band.high_frequency <= fastest))
    refuse(key + ".high_frequency", words("at most ", fastest, " Hz (two steps of the integration)"),
           words(band.high_frequency));
}

void require_samples(const std::string& key, const Samples& samples, double period) {
  if (!samples || samples->size() < 6 || samples->size() % 3 != 0)
    refuse(key + ".samples", "two or more samples of three numbers", words(samples ? samples->size() : 0, " numbers"));
  require_positive(key + ".sample_period", period);
}

void require_rotation(const BaseRotationParameters<double>& rotation, double fastest) {
  const std::string key = "base_motion.rotation";
  if (rotation.kind == RotationKind::sinusoid) {
    for (int axis = 0; axis < 3; ++axis)
      require_below(words(key, ".frequency[", axis, "]"), rotation.frequency(axis), fastest);
    if (!(rotation.amplitude.norm() <= kPi))
      refuse(key + ".amplitude", "a rotation vector of at most pi (radians)", words(rotation.amplitude.norm(), " rad"));
  } else if (rotation.kind == RotationKind::noise) {
    require_band(key, rotation, fastest);
    const double band = rotation.high_frequency - rotation.low_frequency;
    const double largest = std::sqrt(2.0 * kBaseMotionWaves * band * rotation.level.sum());  // were all waves in phase
    if (!(largest <= 2.0 * kPi))
      refuse(key + ".level",
             words("levels whose rotation vector stays within 2 pi (radians), at most ",
                   2.0 * kPi * kPi / (kBaseMotionWaves * band), " rad^2/Hz in all over this band"),
             words(rotation.level.sum(), " rad^2/Hz, of at most ", largest, " rad"));
  }
}

void require_attitudes(const BaseMotionSettings& motion) {
  const std::string key = "base_motion.attitudes";
  const std::vector<double>& q = *motion.attitudes;
  if (q.size() / 4 != motion.samples->size() / 3)
    refuse(key, words("a quaternion for each of the ", motion.samples->size() / 3, " samples"), words(q.size() / 4));
  for (std::size_t i = 0; i < q.size() / 4; ++i) {
    const Eigen::Map<const Vector4<double>> now(q.data() + 4 * i);
    if (!(std::abs(now.norm() - 1.0) <= kUnitTolerance))
      refuse(words(key, "[", i, "]"), "a quaternion (w, x, y, z) of unit length, to 1 %",
             words("one of length ", now.norm()));
    if (i == 0) continue;
    const Eigen::Map<const Vector4<double>> before(q.data() + 4 * (i - 1));
    const double turn = 2.0 * std::acos(std::min(1.0, std::abs(now.dot(before)) / (now.norm() * before.norm())));
    if (!(turn <= kLargestTurn))
      refuse(words(key, "[", i, "]"), words("an attitude within ", kLargestTurn, " rad of the sample before"),
             words("one ", turn, " rad from it; samples have to follow one another faster"));
  }
  if (motion.rotation.kind != RotationKind::none)
    refuse("base_motion.rotation.kind", "none beside a recorded attitude", "another kind");
}

/// @param seed of the road's waves
void require_road(const BaseMotionSettings& motion, const SeedHalves<double>& seed, double fastest) {
  const RoadParameters<double>& road = motion.road;
  if (motion.rotation.kind != RotationKind::none)
    refuse("base_motion.rotation.kind", "none beside a road, which turns the base itself", "another kind");
  if (!(road.shortest < road.longest))
    refuse("base_motion.road.shortest", words("a wavelength below the longest, ", road.longest, " m"),
           words(road.shortest));
  if (!(road.speed / road.shortest <= fastest))
    refuse("base_motion.road.shortest",
           words("at least ", road.speed / fastest, " m at ", road.speed,
                 " m/s: a wave that is shorter passes within two steps of the integration"),
           words(road.shortest));
  if (const double largest = RoadWaves<double>(road, seed).rotation.largest().norm(); !(largest <= 2.0 * kPi))
    refuse("base_motion.road",
           "a road that turns the vehicle by at most 2 pi (radians) where all waves are in phase: a smoother one, a "
           "longer wheelbase or a wider track, or springs and dampers whose resonance is lower",
           words("one that turns it by ", largest, " rad with this seed"));
}

void require_base(const BaseMotionSettings& motion, const SeedHalves<double>& seed, double fastest, double duration,
                  bool world) {
  require_rotation(motion.rotation, fastest);
  const bool attitudes = motion.attitudes && !motion.attitudes->empty();
  switch (motion.kind) {
    case BaseMotionKind::sinusoid:
      require_below("base_motion.frequency", motion.frequency, fastest);
      if (world && !(motion.frequency > 0.0))
        refuse("base_motion.frequency", "a number > 0 for a target in the world, from which the base would go away",
               "0");
      break;
    case BaseMotionKind::recorded:
      require_samples("base_motion", motion.samples, motion.sample_period);
      if (attitudes) require_attitudes(motion);
      if (const double end = motion.sample_period * static_cast<double>(motion.samples->size() / 3 - 1);
          (attitudes || world) && !(end >= duration * (1.0 - 1e-12)))
        refuse("base_motion.samples",
               words("a recording of at least simulation.duration, ", duration,
                     " s, where the base turns or the target is in the world"),
               words(end, " s"));
      break;
    case BaseMotionKind::noise:
      require_band("base_motion", motion, fastest);
      if (world && !(motion.low_frequency > 0.0))
        refuse("base_motion.low_frequency", "a number > 0 for a target in the world, from which the base would go away",
               "0");
      break;
    case BaseMotionKind::road:
      require_road(motion, seed, fastest);
      break;
    case BaseMotionKind::none:
      break;
  }
}

void require_target(const Target& target, const Camera& camera, CameraConvention convention, double fastest) {
  if (camera.mount.on == MountedOn::base) {
    const std::string rides = " where camera.mount.on is base, since the target then rides on the platform";
    if (target.frame != TargetFrame::base) refuse("target.frame", "base" + rides, "world");
    if (target.motion.kind != TargetMotionKind::none) refuse("target.motion.kind", "none" + rides, "another kind");
  }
  if (convention == CameraConvention::as_printed) {
    const std::string points = " for a camera as_printed, which has no points";
    if (target.frame != TargetFrame::base) refuse("target.frame", "base" + points, "world");
    if (target.motion.kind != TargetMotionKind::none) refuse("target.motion.kind", "none" + points, "another kind");
  }
  if (target.motion.kind == TargetMotionKind::sinusoid)
    require_below("target.motion.frequency", target.motion.frequency, fastest);
  if (target.motion.kind == TargetMotionKind::recorded)
    require_samples("target.motion", target.motion.samples, target.motion.sample_period);
}

}  // namespace

Recording recording(const BaseMotionSettings& motion) {
  if (!motion.samples) return {};
  const bool attitudes = motion.attitudes && !motion.attitudes->empty();
  return {motion.samples->data(), static_cast<long long>(motion.samples->size() / 3), motion.sample_period,
          attitudes ? motion.attitudes->data() : nullptr};
}

Recording recording(const TargetMotionSettings& motion) {
  if (!motion.samples) return {};
  return {motion.samples->data(), static_cast<long long>(motion.samples->size() / 3), motion.sample_period};
}

template <int N>
void prepare_motions(const Settings& settings, SceneParameters<double, N>& p) {
  const double fastest = 0.5 * static_cast<double>(p.substeps) / p.step;  // the integration would not see more
  require_base(settings.base_motion, seed_halves(settings.seed), fastest, settings.simulation.duration,
               settings.target.frame == TargetFrame::world);
  require_target(settings.target, settings.camera, p.convention, fastest);
  p.base_motion = settings.base_motion;
  p.target_frame = settings.target.frame;
  p.target_motion = settings.target.motion;
  p.recorded = recording(settings.base_motion);
  p.recorded_target = recording(settings.target.motion);
}

template void prepare_motions(const Settings&, SceneParameters<double, kPoints>&);
template void prepare_motions(const Settings&, SceneParameters<double, kMostPoints>&);

}  // namespace hexservo::detail
