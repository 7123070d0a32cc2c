"""Moving targets that the law `tracking` follows farther behind than the band, and what leaves less, by runs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from hexservo.findings.analysis.scene import Scene, scene_of
from hexservo.findings.check_gains import OF_SERVO_RATE
from hexservo.findings.tracking_runs import BANDWIDTH, CERTAINTY, LIMITS, MOVED, NOISE, Following, following_of
from hexservo.scenario.keys import value_at
from hexservo.scenario.laws import Tracking
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import number, quantity

_HELPS = 0.8  # of an error that a change has to leave at most, to be named
_ALIKE = 1.25  # times the least error, up to which a change of fewer settings is named in its place
_BANDWIDTHS = (0.125, 0.25, 0.5, 2.0, 4.0)  # times that of the scenario
_PERIODS = 2.0  # of a bandwidth, that a run has at least
_KEEPS = 0.9  # of a limit, that a slower motion takes
_HALF = 0.5  # of a motion's speed, where no limit is exceeded
_ROUNDING = 1.0 + 1e-9


@dataclass(frozen=True)
class _Remedy:
    """Settings of the law, and the error that runs with them leave [px]."""

    changes: Mapping[str, float]
    left: float

    @property
    def words(self) -> str:
        """What to set, and what is left then."""
        of_key = {
            CERTAINTY: f"{CERTAINTY} to 0, with which every velocity counts",
            NOISE: f"{NOISE} to {number(self.changes.get(NOISE, 0.0))} px, that of the features",
            BANDWIDTH: f"{BANDWIDTH} to {number(self.changes.get(BANDWIDTH, 0.0))} Hz",
        }
        return f"{', and '.join(of_key[key] for key in self.changes)}: about {number(self.left, 2)} px are left"


def of_runs(scene: Scene, gains: Tracking) -> Iterator[str]:
    """Yield a sentence for a target that runs follow farther behind than the band, with what leaves less in runs."""
    following = following_of(scene)
    if following is None or not following.within_reach:  # `check_target` names what is out of reach or sight
        return
    free: dict[str, Any] = dict.fromkeys(_limits(scene.scenario))
    now = following.now
    if not _matters(following, now):
        return
    remedies: list[_Remedy] = []
    for settings in _settings(scene, gains):  # more of them where those before leave more than the band
        remedies += map(_Remedy, settings, following.left(settings))
        chosen = _chosen(remedies, now, scene.band)
        if chosen is not None and chosen.left <= scene.band:
            break
    without_limits = following.left([free])[0] if free else now
    beyond = _beyond(following)
    if beyond or (chosen is None and without_limits < _HELPS * now):
        yield _of_limits(following, now, without_limits, chosen, beyond or next(iter(free)))
    elif chosen is not None:
        yield _of_remedy(following, gains, now, chosen, remedies)
    else:
        yield _of_motion(following, now)


def of_limits(scene: Scene) -> Iterator[str]:
    """Yield a sentence for a steady target that takes more of the legs than their limits allow."""
    if not _limits(scene.scenario):
        return
    following = following_of(scene)
    if following is None or not following.within_reach or not (beyond := _beyond(following)):
        return
    if _matters(following, following.now):
        yield _of_limits(following, following.now, following.left([dict.fromkeys(LIMITS)])[0], None, beyond)


def _limits(scenario: Scenario) -> dict[str, float]:
    """Return the limits of the legs that a scenario has [m/s, m/s^2; of cranks rad/s, rad/s^2]."""
    return {key: float(limit) for key in LIMITS if (limit := value_at(scenario, key)) is not None}


def _matters(following: Following, now: float) -> bool:
    """Return whether an error [px] is beyond the band, and of the motion; a run that ends early is no matter of it."""
    return max(following.scene.band, MOVED * following.resting) < now < math.inf


def noise_helps(scene: Scene, noise: float) -> bool:
    """Return whether runs in which the filter assumes that noise [px] leave less of a moving target's error."""
    following = following_of(scene)
    return following is not None and following.left([{NOISE: noise}])[0] < _HELPS * following.now


def less_noise(scene: Scene, gains: Tracking) -> float | None:
    """Return the noise of the features [px], to two digits, where the filter assumes more; None where it does not."""
    noise = float(number(scene.image_noise, 2))
    return noise if noise > 0.0 and gains.noise > _ROUNDING * noise else None


def _settings(scene: Scene, gains: Tracking) -> tuple[list[dict[str, float]], ...]:
    """Return the settings of the law that are tried: those of a single key, and those of certainty and bandwidth."""
    simulation = scene.scenario.simulation
    least, most = _PERIODS / simulation.duration, OF_SERVO_RATE / simulation.step
    bandwidths = [float(number(factor * gains.bandwidth, 2)) for factor in _BANDWIDTHS]
    of_bandwidth = [{BANDWIDTH: bandwidth} for bandwidth in bandwidths if least <= bandwidth <= most]
    noise = less_noise(scene, gains)
    single = [*of_bandwidth, *([] if noise is None else [{NOISE: noise}])]
    if gains.certainty == 0.0:
        return (single,)
    return [{CERTAINTY: 0.0}, *single], [{CERTAINTY: 0.0, **changes} for changes in of_bandwidth]


def _chosen(remedies: list[_Remedy], now: float, band: float) -> _Remedy | None:
    """Return what leaves nearly the least, or no more than the band [px], with the fewest changes.

    Certainty first; None where nothing helps.
    """
    least = min((remedy.left for remedy in remedies), default=now)
    if least >= _HELPS * now:
        return None
    good = [remedy for remedy in remedies if remedy.left <= min(max(_ALIKE * least, band), _HELPS * now)]
    return min(good, key=lambda remedy: (len(remedy.changes), CERTAINTY not in remedy.changes, remedy.left))


def _beyond(following: Following) -> str:
    """Return the key of the limit that a leg exceeds most where it is with the target at every frame, or nothing."""
    limits, needed = _limits(following.scenario), dict(zip(LIMITS, following.leg_rates, strict=True))
    shares = {key: needed[key] / limit for key, limit in limits.items()}
    key = max(shares, key=lambda name: shares[name], default="")
    return key if key and shares[key] > _ROUNDING else ""


def _of_limits(following: Following, now: float, free: float, chosen: _Remedy | None, key: str) -> str:
    scene, limit = following.scene, float(value_at(following.scenario, key))
    needed = following.leg_rates[LIMITS.index(key)]
    unit = (scene.units.rate, f"{scene.units.coordinate}/s^2")[LIMITS.index(key)]
    if needed > limit:
        how = "turn" if following.directs else "shift"
        what = ("moves", "accelerates")[LIMITS.index(key)]
        takes = (
            f"to {how} with target.motion a leg {what} at up to {quantity(needed, unit)}, more than the "
            f"limit of {quantity(limit, unit)}"
        )
    else:
        takes = f"{quantity(limit, unit)} is enough for target.motion, but not for what the law makes up for"
    remedies = []
    if free < _HELPS * now:
        remedies.append(f"without limits of the legs about {number(free, 2)} px are left")
    if chosen is not None:
        remedies.append(f"set {chosen.words}{_beside_still(following, chosen)}")
    remedies += _slower(following, now, _KEEPS * limit / needed if needed > limit else _HALF)
    ways = "; ".join(remedies) or "no setting that was tried leaves much less"
    return f"{key}: {takes}: {_left(following, now)}; {ways}"


def _of_remedy(following: Following, gains: Tracking, now: float, chosen: _Remedy, remedies: list[_Remedy]) -> str:
    why = ""
    if CERTAINTY in chosen.changes:
        lines = "in the mean of earlier frames" if gains.follow == "direction" else "in pieces of straight lines"
        why = (
            f", since noise of {number(gains.noise)} px leaves so much in the velocity of the law's filter that not "
            f"all of it counts, and the target is followed {lines}"
        )
    helping = [remedy for remedy in remedies if remedy.left < _HELPS * now and len(remedy.changes) == 1]
    alone = [remedy for remedy in helping if CERTAINTY in remedy.changes and len(chosen.changes) > 1]
    less = [remedy for remedy in helping if NOISE in remedy.changes and remedy is not chosen]
    ways = [
        f"set {chosen.words}{_beside_still(following, chosen)}",
        *(f"or set {other.words}" for other in alone + less),
    ]
    if chosen.left > _HELPS * following.still:
        ways += _slower(following, now, _HALF)
    return f"{next(iter(chosen.changes))}: {_left(following, now)}{why}; {'; '.join(ways)}"


def _beside_still(following: Following, remedy: _Remedy) -> str:
    """Return that a platform that stands still would do about as well, or better, where it does."""
    share = remedy.left / following.still
    if share <= _HELPS:
        return ""
    return f", {'about as much as' if share < _ALIKE else 'more than'} a platform that stands still leaves"


def _of_motion(following: Following, now: float) -> str:
    """Return the sentence where no setting of the law helps: what a slower motion or a shorter latency leaves."""
    camera = following.scenario.camera
    ways = _slower(following, now, _HALF)
    left = following.left([{"camera.latency": 0.0}])[0] if camera.latency > 0.0 else now
    if left < _HELPS * now:
        ways.append(f"without camera.latency ({quantity(camera.latency, 's')}) about {number(left, 2)} px are left")
    of = "target.motion.frequency" if following.scenario.target.motion.kind == "sinusoid" else "target.motion"
    tried = "no other certainty, bandwidth or noise of controller.tracking that was tried leaves much less"
    return f"{of}: {'; '.join([_left(following, now), tried, *ways])}"


def _slower(following: Following, now: float, factor: float) -> list[str]:
    """Return what a motion leaves that is slower by a factor, where that helps."""
    scenario = following.scene.scenario
    motion = scenario.target.motion
    if motion.kind == "sinusoid":
        slower: dict[str, Any] = {"frequency": float(number(factor * motion.frequency, 2))}
        what = f"a motion at {number(slower['frequency'])} Hz"
    elif motion.kind == "velocity":
        slower = {"velocity": [factor * component for component in motion.velocity]}
        what = f"{number(factor, 2)} times that velocity"
    else:
        assert motion.sample_period is not None
        slower = {"sample_period": motion.sample_period / factor}
        what = f"a target.motion.sample_period of {quantity(slower['sample_period'], 's')}"
    again = following_of(scene_of(scenario.updated({f"target.motion.{key}": value for key, value in slower.items()})))
    left = now if again is None else again.left([{}])[0]
    return [f"{what} leaves about {number(left, 2)} px"] if left < _HELPS * now else []


def _left(following: Following, now: float) -> str:
    """Return the error of runs, beside that of a platform that stands still."""
    motion = following.scenario.target.motion
    at = f" at {number(motion.frequency)} Hz" if motion.kind == "sinusoid" else ""
    still = f", a platform that stands still {number(following.still, 2)} px" if motion.kind != "velocity" else ""
    return (
        f"runs with target.motion{at} have errors of up to about {number(now, 2)} px{still} (metrics.band: "
        f"{number(following.scene.band)} px)"
    )
