"""What the legs do over a run, with the limits that the robot has for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hexservo import _core
from hexservo.run.leg_limits import LegLimit, limits_of_motion
from hexservo.scenario.arrays import Array
from hexservo.scenario.leg_units import leg_units
from hexservo.scenario.parameters import core_parameters

if TYPE_CHECKING:
    from hexservo.run.result import Result

_ROWS = 4096  # of a log that are looked at together
_IN_SIGHT = 4.0  # times what the legs do: a limit farther out is no line of the chart


@dataclass(frozen=True, eq=False)
class LegMotion:
    """One quantity of the legs that the robot limits."""

    limit: LegLimit
    title: str
    label: str  # of its axis, with the unit of `values`
    values: Array  # (n, 6), in thousandths of the limit's SI unit
    levels: tuple[float, ...]  # of the limit, in the same unit: both signs, or one of what has no sign

    @property
    def in_sight(self) -> tuple[float, ...]:
        """The levels that a chart draws; empty where the legs use less than a quarter of the limit."""
        return self.levels if self.levels[-1] <= _IN_SIGHT * float(np.abs(self.values).max()) else ()


def leg_motions(result: Result, rows: NDArray[np.intp] | None = None) -> tuple[LegMotion, ...]:
    """Return travel, and where the robot limits them speed and tilts of the legs, in the order of `limits_of_motion`.

    Parameters
    ----------
    result
        Of the run.
    rows
        Samples to take; None: all.

    Returns
    -------
    tuple of LegMotion
        Travel from the middle of the stroke and speed with signs, as `abs(l - l_mid)` and `abs(J_q nu)` are limited,
        where the mean since the sample before is not faster; tilts from home as base and platform see them, which have
        none.
    """
    scenario = result.scenario
    hexapod, units = _core.Hexapod(core_parameters(scenario).robot), leg_units(scenario.robot)
    chosen = np.arange(len(result.time)) if rows is None else rows
    poses = list(zip(result.position[chosen], result.quaternion[chosen], strict=True))
    twists = result.twist[chosen]
    limits = limits_of_motion(scenario)
    kinds = {limit.kind for limit in limits}
    values = {"stroke": result.leg_lengths[chosen] - hexapod.mid_lengths}
    if "speed" in kinds:
        rates = np.array([hexapod.wrench_map(*pose).T @ twist for pose, twist in zip(poses, twists, strict=True)])
        means = _mean_rates(result)[chosen]
        values["speed"] = np.where(np.abs(means) > np.abs(rates), means, rates)
    if "base_joint" in kinds:
        tilts = np.array([hexapod.leg_tilts(*pose) for pose in poses]).reshape(-1, 2, 6)
        values |= {"base_joint": tilts[:, 0], "platform_joint": tilts[:, 1]}
    words = {
        "stroke": ("Travel of the legs from the middle of the stroke", f"travel [{units.small}]"),
        "speed": ("Speeds of the legs", f"speed [{units.small}/s]"),
        "base_joint": ("Tilts of the legs from home, at the base", "tilt [mrad]"),
        "platform_joint": ("Tilts of the legs from home, at the platform", "tilt [mrad]"),
    }
    return tuple(
        LegMotion(
            limit,
            *words[limit.kind],
            1e3 * values[limit.kind],
            (-1e3 * limit.value, 1e3 * limit.value) if limit.kind in ("stroke", "speed") else (1e3 * limit.value,),
        )
        for limit in limits
    )


def _mean_rates(result: Result) -> Array:
    """Return the mean rates of the legs since the sample before, (n, 6), 0 at the first."""
    means = np.zeros_like(result.leg_lengths)
    means[1:] = np.diff(result.leg_lengths, axis=0) / np.diff(result.time)[:, None]
    return means


def singular_passage(result: Result) -> float | None:
    """Return by when the legs have passed a singular pose: a run ends as ``singular`` only where a sample meets one.

    Parameters
    ----------
    result
        Of the run.

    Returns
    -------
    float or None
        Time of the first sample at which det H has another sign than at the start [s]; None: of no sample.
    """
    hexapod = _core.Hexapod(core_parameters(result.scenario).robot)
    first = 0.0
    for begin in range(0, len(result.time), _ROWS):
        rows = slice(begin, begin + _ROWS)
        maps = [hexapod.wrench_map(*pose) for pose in zip(result.position[rows], result.quaternion[rows], strict=True)]
        signs, _ = np.linalg.slogdet(np.array(maps))
        first = first or signs[0]
        turned = signs * first < 0.0
        if turned.any():
            return float(result.time[rows][turned.argmax()])
    return None
