"""What figures and charts draw over the time: curves that share an axis, with the levels that are drawn across them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from hexservo.run.leg_motion import LegMotion
from hexservo.run.samples import OFF_AXIS, along_z, axis_range, moment_unit, turns_from_home, vertical
from hexservo.scenario.arrays import Array
from hexservo.scenario.leg_units import leg_units
from hexservo.scenario.parameters import core_parameters

if TYPE_CHECKING:
    from hexservo.run.result import Result

_OF_LEGS = tuple(f"leg {leg}" for leg in range(1, 7))


@dataclass(frozen=True, eq=False)
class TimePanel:
    """Curves over the time that share an axis."""

    title: str
    label: str  # of the axis, with its unit
    values: Array  # (n, k)
    names: Sequence[str]  # of the k curves
    of: Literal["axes", "legs"] = "axes"  # what has a curve each
    first: int = 0  # which of them has the first curve
    levels: tuple[float, ...] = ()  # that are drawn dotted, in the unit of the values
    kind: str = ""  # what the levels are
    named: Mapping[str, float] = field(default_factory=dict)  # levels with a name beside the curves
    widens: bool = False  # whether the axis covers the levels too
    note: str = ""  # about the levels; empty if there are none

    @property
    def covered(self) -> list[Array]:
        """What the axis covers."""
        return [self.values, np.array(self.levels)] if self.widens and self.levels else [self.values]


def motion_panels(result: Result) -> list[TimePanel]:
    """Return position and turn of the platform relative to home: figure 4."""
    displacement = 1e3 * (result.position - np.asarray(result.scenario.robot.home_position))
    turns = 1e3 * turns_from_home(result, result.quaternion)
    title = "Orientation relative to home: axis times angle, in B"
    return [
        TimePanel(f"Position relative to home, in B{vertical(result)}", "displacement [mm]", displacement, "xyz"),
        TimePanel(title, "rotation vector [mrad]", turns, ("θx", "θy", "θz")),
    ]


def wrench_panels(result: Result) -> list[TimePanel]:
    """Return forces along x and y, force along z, moments, and efforts of the legs: figure 5."""
    unit, per_newton_metre = moment_unit(result)
    moments = per_newton_metre * result.wrench[:, 3:]
    units, limit = leg_units(result.scenario.robot), result.scenario.robot.force_limit
    label, title = units.efforts
    low, high = axis_range(result.leg_forces)
    limits = tuple(level for level in (-limit, limit) if low < level < high)
    return [
        *_force_panels(result),
        TimePanel("Moment, in B", f"moment [{unit}]", moments, ("mx", "my", "mz")),
        TimePanel(
            title,
            label,
            result.leg_forces,
            _OF_LEGS,
            "legs",
            levels=limits,
            kind="limit force",
            named={"limit": limits[-1]} if limits else {},
            note=f"Dotted: limit of {limit:.4g} {units.effort}." if limits else "",
        ),
    ]


def _force_panels(result: Result) -> list[TimePanel]:
    """Return the forces along x and y, and along z, with the estimated weight on the axes along which it has a part."""
    weight = np.array(core_parameters(result.scenario).body.gravity_wrench[:3])
    is_along_z = along_z(weight)
    titles = (
        ("Horizontal force, in B", f"Vertical force, in B{vertical(result)}")
        if is_along_z
        else ("Force along x and y, in B", "Force along z, in B")
    )
    if not result.by_law:
        meaning = "the estimated weight"
    elif result.scenario.actuators.kind == "force":
        meaning = "the weight that the law feeds forward"
    else:
        meaning = "the estimated weight, which the law does not feed forward"
    panels = []
    for title, columns in zip(titles, (slice(0, 2), slice(2, 3)), strict=True):
        held = {
            axis: float(part)
            for axis, part in zip("xyz"[columns], weight[columns], strict=True)
            if abs(part) > OFF_AXIS * float(np.abs(weight).max())
        }
        levels = " and ".join(
            f"{level:.4g} N" + ("" if is_along_z else f" along {axis}") for axis, level in held.items()
        )
        panels.append(
            TimePanel(
                title,
                "force [N]",
                result.wrench[:, columns],
                [f"f{axis}" for axis in "xyz"[columns]],
                first=columns.start,
                levels=tuple(held.values()),
                kind="weight",
                named={"−mg" + ("" if is_along_z else axis): level for axis, level in held.items()},
                widens=True,
                note=f"Dotted: {levels}, {meaning}." if held else "",
            )
        )
    return panels


def leg_panel(motion: LegMotion) -> TimePanel:
    """Return what the legs do of one quantity that the robot limits, with the limit where it is in sight."""
    return TimePanel(
        motion.title,
        motion.label,
        motion.values,
        _OF_LEGS,
        "legs",
        levels=motion.in_sight,
        kind=f"limit {motion.limit.kind}",
        named={"limit": motion.in_sight[-1]} if motion.in_sight else {},
        widens=True,
        note=f"Dotted: limit of {motion.limit.text}."
        if motion.in_sight
        else f"The limit of {motion.limit.text} is outside the chart.",
    )
