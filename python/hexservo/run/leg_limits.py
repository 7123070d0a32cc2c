"""Limits of the legs that a robot has, each with the metric that is compared with it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from hexservo.run.metrics import metric_unit, readable_unit
from hexservo.scenario.leg_units import leg_units
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import apart, number

_NAMES = {
    "stroke": "its stroke",
    "force": "the limit",
    "speed": "its speed limit",
    "base_joint": "its joint limit",
    "platform_joint": "its joint limit",
}  # by the kind of the limit


KIND_OF_CAUSE = {
    "leg_limit": "stroke",
    "leg_speed": "speed",
    "base_joint": "base_joint",
    "platform_joint": "platform_joint",
}
"""`BatchResult.cause` of a run that a leg's limit ended -> kind of that limit."""


@dataclass(frozen=True)
class LegLimit:
    """One limit of all legs."""

    kind: str  # as of `LimitEvent`
    metric: str  # of hs.METRICS, largest of a run
    value: float  # in the metric's unit
    of_leg: str  # what is limited
    exceeded: str  # the excess, as a clause
    unit: str  # SI unit of the value

    @property
    def text(self) -> str:
        """The limit in the unit that people read."""
        unit, scale = self.shown_unit
        return f"{number(self.value * scale, 4)} {unit}"

    @property
    def shown_unit(self) -> tuple[str, float]:
        """The unit that people read, of the limit and of what is compared with it, and how many of it make one."""
        return readable_unit(self.unit, self.value)


@dataclass(frozen=True)
class LimitUse:
    """A limit of the legs, and how much of it a run uses."""

    limit: LegLimit
    peak: float  # largest value of the run, in the limit's unit

    @property
    def share(self) -> float:
        """Of the limit, above 1 beyond it; infinite where the run has no such number."""
        return math.inf if math.isnan(self.peak) else self.peak / self.limit.value

    @property
    def excess(self) -> str:
        """What a run does that exceeds the limit or is stopped at it, as a clause that follows its subject."""
        unit, scale = self.limit.shown_unit
        if not math.isfinite(self.peak):
            return "ends early"
        if self.share <= 1.0:  # of a run that is stopped at the limit the last good sample is within
            return f"ends where a leg reaches {_NAMES[self.limit.kind]} of {self.limit.text}"
        peak, allowed = apart(self.peak * scale, self.limit.value * scale, 3)
        value = f"{peak} {unit}"
        return {
            "stroke": f"takes a leg {value} from the middle of its travel",
            "force": f"takes a {self.limit.of_leg} of {value}",
            "speed": f"moves a leg at {value}",
            "base_joint": f"tilts a leg by {value} at the base",
            "platform_joint": f"tilts a leg by {value} at the platform",
        }[self.limit.kind] + f", beyond {_NAMES[self.limit.kind]} of {allowed} {unit}"


def leg_limits(scenario: Scenario) -> tuple[LegLimit, ...]:
    """Return the limits that the robot of a scenario has, in the order of the kinds of `LimitEvent`."""
    robot = scenario.robot
    base, platform = robot.joint_limit or (None, None)
    effort = leg_units(robot).effort_name
    rows = (
        ("stroke", "peak_leg_excursion", robot.stroke, "travel of a leg", "a leg exceeded its stroke"),
        ("force", "peak_leg_force", robot.force_limit, f"{effort} of a leg", f"a leg exceeded its {effort} limit"),
        ("speed", "peak_leg_speed", robot.speed_limit, "speed of a leg", "a leg exceeded its speed limit"),
        ("base_joint", "peak_base_joint", base, "tilt of a leg at the base", "a base joint exceeded its limit"),
        (
            "platform_joint",
            "peak_platform_joint",
            platform,
            "tilt of a leg at the platform",
            "a platform joint exceeded its limit",
        ),
    )
    return tuple(
        LegLimit(kind, metric, value, of_leg, exceeded, metric_unit(metric, robot))
        for kind, metric, value, of_leg, exceeded in rows
        if value is not None
    )


def limits_of_motion(scenario: Scenario) -> tuple[LegLimit, ...]:
    """Return those that a motion may not exceed: all but that of the efforts, which saturation and motors enforce."""
    return tuple(limit for limit in leg_limits(scenario) if limit.kind != "force")


def overload(scenario: Scenario, metrics: Mapping[str, float]) -> LimitUse | None:
    """Return the limit of the efforts where a run takes more, None where it does not; metrics as for `most_used`."""
    (limit,) = (limit for limit in leg_limits(scenario) if limit.kind == "force")
    peak = float(metrics[limit.metric])
    return LimitUse(limit, peak) if peak > limit.value else None


def exceeded_limits(scenario: Scenario, metrics: Mapping[str, float]) -> tuple[LegLimit, ...]:
    """Return the limits that a run exceeded, given its metrics by their names in `hs.METRICS`."""
    return tuple(limit for limit in leg_limits(scenario) if metrics.get(limit.metric, math.nan) > limit.value)


def most_used(scenario: Scenario, metrics: Mapping[str, float], stopped_by: str = "") -> LimitUse:
    """Return the limit of the motion that ended a run, else that of which it uses the largest share.

    Parameters
    ----------
    scenario
        Of the run.
    metrics
        By their names in `hs.METRICS`; of a run that was stopped at a limit those of the last good sample, which may be
        just within.
    stopped_by
        Kind of the limit that ended the run; "": none did.
    """
    uses = [LimitUse(limit, float(metrics[limit.metric])) for limit in limits_of_motion(scenario)]
    return max(uses, key=lambda use: (use.limit.kind == stopped_by, use.share))
