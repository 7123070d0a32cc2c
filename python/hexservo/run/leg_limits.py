"""Limits of the legs that a robot has, each with the metric that is compared with it."""

from __future__ import annotations

from dataclasses import dataclass

from hexservo.run.metrics import metric_unit, readable_unit
from hexservo.scenario.leg_units import leg_units
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import number

__all__ = ["LegLimit", "leg_limits"]


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
        unit, scale = readable_unit(self.unit)
        return f"{number(self.value * scale, 4)} {unit}"


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
