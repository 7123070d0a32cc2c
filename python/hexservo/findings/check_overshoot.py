"""Laws that move a platform without mass faster than the legs' acceleration limit lets it stop at the goal."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hexservo.findings.analysis.conditioning import frames_noise, noise_in_words
from hexservo.findings.analysis.loop_of_scenario import rates_without_mass
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.check_gains import image_delay
from hexservo.findings.check_way import goal_of_way
from hexservo.findings.prior import legs_of_noise
from hexservo.scenario.fitted import auto_of, chosen_keys
from hexservo.scenario.laws import ResolvedRate
from hexservo.scenario.wording import apart, quantity

BRAKING = 0.6  # share of the limit, as of the law `tracking`: held commands ask more of the legs (docs/model.md)
_LITTLE = 0.15  # of the way, beyond the goal
_OF_CHANGES = 2.4  # largest of the six legs' changes by noise, over the deviation of one
_OF_RATE = frozenset(("gain", "kp", "kd"))  # what sets lambda where it is written
_DAMPED = 0.5  # lambda theta of a damping 1/(2 sqrt(lambda theta)) of 0.7


@dataclass(frozen=True)
class Stop:
    """Legs that follow -lambda times the way that is left, and change their rates by at most a limit.

    From rest they reach the rate v that the law asks for where v^2/(2 a) + v/k = s, with 1/k = 1/lambda - tau of an
    image that is late by tau, or cruise at their largest rate. From there they are at rest after v^2/(2 a), and at the
    goal after v/k: with x = k v/a they pass it, where x > 2, by x (x - 2) a/(2 k^2).

    Noise moves the rate that the law asks for by n = 2.4 lambda sigma. Where n is far above what the limit makes of it
    from frame to frame, the rate follows the law with the time constant theta = n/a, as of the mean of a sign under
    noise: lambda and theta make a second order with the damping 1/(2 sqrt(lambda theta)).
    """

    way: float  # s [m], of the leg that goes farthest; of cranks [rad]
    acceleration: float  # a [m/s^2]
    fastest: float  # largest rate [m/s]
    late: float  # tau [s]
    noise: float = 0.0  # sigma of a leg in the pose of an image [m]
    lag: float = 0.0  # of the legs behind their commands [s]

    @property
    def time(self) -> float:
        """Return how long the legs take to reach their largest rate on the way [s]."""
        return min(math.sqrt(self.way / self.acceleration), self.fastest / self.acceleration)

    def most(self, share: float = BRAKING) -> float:
        """Return the largest lambda [1/s] that stops with a share of the limit, and is damped by 0.7 under noise."""
        noisy = math.sqrt(_DAMPED / self._lag_of_noise(1.0)) if self.noise > 0.0 else math.inf
        return min(self.most_without_noise(share), noisy)

    def most_without_noise(self, share: float = BRAKING) -> float:
        """Return the largest lambda [1/s] that stops with a share of the limit."""
        limit = share * self.acceleration
        return 1.0 / (self.late + min(self.fastest / (2.0 * limit), 0.5 * math.sqrt(self.way / limit)))

    def beyond(self, rate: float) -> float:
        """Return how far beyond the goal lambda [1/s] takes the leg without noise, over its way."""
        lag = max(1.0 / rate - self.late, 1e-6 / rate)  # 1/k
        size = self.way / (self.acceleration * lag**2)
        x = min(math.sqrt(1.0 + 2.0 * size) - 1.0, self.fastest / (self.acceleration * lag))
        return max(x * (x - 2.0), 0.0) / (2.0 * size)

    def beyond_by_noise(self, rate: float) -> float:
        """Return how far beyond the goal the lag that noise makes takes the leg, over its way."""
        if self.noise == 0.0:
            return 0.0
        product = rate * self._lag_of_noise(rate)  # lambda theta
        return math.exp(-math.pi / math.sqrt(4.0 * product - 1.0)) if product > 0.25 else 0.0

    def _lag_of_noise(self, rate: float) -> float:
        return _OF_CHANGES * rate * self.noise / self.acceleration


def of_overshoot(scene: Scene) -> Iterator[str]:
    """Yield a sentence for gains with which a platform without mass passes its goal by more than 15 % of the way.

    For a goal at rest, of legs that take positions and have an acceleration limit; to first order, the way straight.

    Raises
    ------
    NoRestError
        The law cannot be evaluated at home.
    """
    scenario = scene.scenario
    found = stop_of(scene) if scenario.moves_without_mass else None
    if found is None:
        return
    stop, rate, leg = found
    share = stop.beyond(rate)
    if share > 0.0:  # noise alone scatters the legs as far without a limit
        share = max(share, stop.beyond_by_noise(rate))
    if share <= _LITTLE or stop.lag > stop.time:  # legs that slow do not follow a command beyond the goal
        return
    law, unit, factor = scenario.controller.law, scene.units.coordinate, stop.most() / rate
    gains = scenario.controller.gains
    if auto_of(scenario).bandwidth is not None and _OF_RATE.isdisjoint(chosen_keys(scenario)):
        value, most = apart(gains.auto.bandwidth, factor * gains.auto.bandwidth, 3, keeps=True)
        key, value, remedy = "auto.bandwidth", f"{value} Hz", f"{most} Hz"
    elif isinstance(gains, ResolvedRate) and not gains.adaptive:
        value, most = apart(gains.gain, factor * gains.gain, 3, keeps=True)
        key, value, remedy = "gain", f"{value} 1/s", f"{most} 1/s"
    else:
        key = "gain" if isinstance(gains, ResolvedRate) else "kp"
        several = "gain, gain_far and gain_slope" if key == "gain" else "kp"
        value, remedy = "these gains", f"{apart(1.0, factor, 3, keeps=True)[1]} times {several}"
    noise = stop.most() < stop.most_without_noise()
    of_noise = f"of which {noise_in_words(scenario)} takes a part by changes that the law asks for, " if noise else ""
    yield (
        f"controller.{law}.{key}: with {value} runs swing beyond the goal, leg {leg} by about {share:.0%} of its "
        f"{quantity(stop.way, unit)}, since actuators.position.acceleration_limit, "
        f"{quantity(stop.acceleration, f'{unit}/s^2')}, {of_noise}does not stop the legs as fast as the law slows "
        f"down; up to {remedy} they stop there"
    )


def stop_of(scene: Scene) -> tuple[Stop, float, int] | None:
    """Return the way to the goal, lambda [1/s] and the leg that goes farthest, 1 to 6; None where nothing limits it."""
    scenario = scene.scenario
    response, goal = scenario.actuators.position, goal_of_way(scene)
    if response.acceleration_limit is None or goal is None:
        return None
    legs, pose = goal[1], goal[2].view.pose
    shift = pose.displacement_from(scene.start)
    twist = -rates_without_mass(scenario, scene.home) @ shift
    straight, asked = (float(np.abs(scene.leg_rates(scene.start, each)).max()) for each in (shift, twist))
    if not (straight > 0.0 and asked > 0.0 and math.isfinite(asked)):
        return None
    way, rate, gains = float(np.abs(legs).max()), asked / straight, scenario.controller.gains
    if isinstance(gains, ResolvedRate):
        view, weights = scene.view(scene.start), scene.root_weights[:, 0]
        error = scene.desired - view.features
        # where the image leads from the start, which is farther than the goal for large rotations
        first = np.asarray(np.linalg.lstsq(weights[:, None] * view.jacobian, weights * error, rcond=None)[0])
        way = max(way, float(np.abs(scene.leg_rates(scene.start, first)).max()))
        if gains.adaptive and gains.gain > gains.gain_far:  # as half way, where legs begin to brake
            spread = gains.gain - gains.gain_far
            half = 0.5 * float(np.abs(error[weights > 0.0]).max())
            rate *= (gains.gain_far + spread * math.exp(-gains.gain_slope * half / spread)) / gains.gain
    stop = Stop(
        way=way,
        acceleration=response.acceleration_limit,
        fastest=math.inf if response.speed_limit is None else response.speed_limit,
        late=image_delay(scenario),
        noise=frames_noise(scenario) * float(np.nan_to_num(legs_of_noise(scene)).max()),
        lag=response.damping / (math.pi * response.bandwidth),
    )
    return stop, rate, int(np.abs(legs).argmax()) + 1
