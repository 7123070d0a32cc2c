"""Metrics of a run, with their units: `METRICS` maps each name to its unit and what it is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from hexservo.scenario.arrays import Mask
from hexservo.scenario.leg_units import unit_of
from hexservo.scenario.rules import did_you_mean
from hexservo.scenario.wording import above, apart, number, several_names, shown_unit, wrong_type

if TYPE_CHECKING:
    from hexservo.run.result import Result
    from hexservo.scenario.blocks import Metrics, Robot

# name -> (unit, what it is), of legs that change their length; of a robot: `metric_unit`, `metric_meaning`
METRICS: dict[str, tuple[str, str]] = {
    "settling_time": ("s", "last time any feature error exceeds the settling band"),
    "final_error": ("px", "largest feature error at the end"),
    "rms_error": ("px", "RMS of all feature errors from metrics.rms_start on"),
    "peak_error": ("px", "largest feature error of the run"),
    "peak_displacement": ("m", "largest distance of the platform from its start"),
    "peak_rotation": ("rad", "largest rotation of the platform from its start"),
    "final_linear_speed": ("m/s", "speed of the platform at the end"),
    "final_angular_speed": ("rad/s", "angular speed of the platform at the end"),
    "peak_control_force": ("N", "largest force component beyond the estimated weight"),
    "peak_control_moment": ("N m", "largest moment component beyond the estimated weight"),
    "peak_leg_force": ("N", "largest leg force"),
    "peak_leg_excursion": ("m", "largest leg travel from the middle of its stroke, which is the home length as a rule"),
    "overshoot": ("px", "largest excursion of a feature coordinate beyond its goal"),
    "relative_overshoot": ("1", "overshoot as a fraction of the initial error of the component"),
    "peak_feature_distance": ("px", "largest distance of a feature from the principal point, in pixels of the pinhole"),
    "peak_line_deviation": ("px", "largest distance of a feature from its straight way"),
    "effort": (
        "N^2 s",
        "integral of the squared wrench beyond the estimated weight, moments divided by the platform radius",
    ),
    "chatter": ("N/s", "total variation of that wrench per second"),
    "peak_leg_speed": ("m/s", "largest speed of a leg, where robot.speed_limit is given"),
    "peak_base_joint": ("rad", "largest tilt of a leg at the base from home, where robot.joint_limit is given"),
    "peak_platform_joint": ("rad", "largest tilt of a leg at the platform from home, where robot.joint_limit is given"),
}
# Of rotary legs: name -> (as people read it, what it is).
OF_CRANKS: dict[str, tuple[str, str]] = {
    "peak_leg_force": ("peak crank torque", "largest torque of a crank"),
    "peak_leg_excursion": (
        "peak crank excursion",
        "largest angle of a crank from the middle of its travel, which is the home angle as a rule",
    ),
    "peak_leg_speed": ("peak crank speed", "largest angular speed of a crank, where robot.speed_limit is given"),
    "peak_base_joint": (
        "peak base joint",
        "largest tilt of a rod at its crank from home, where robot.joint_limit is given",
    ),
    "peak_platform_joint": (
        "peak platform joint",
        "largest tilt of a rod at the platform from home, where robot.joint_limit is given",
    ),
}
OF_LIMITS = {
    "peak_leg_speed": "robot.speed_limit",
    "peak_base_joint": "robot.joint_limit",
    "peak_platform_joint": "robot.joint_limit",
}
"""Metrics of limits that not every robot has -> their keys, without which they are NaN."""

_WITH_PREFIX = ("m", "rad", "m/s", "rad/s", "N m")  # units that people read in thousandths and so on, by size

# Unit of a metric -> what is less is rounding: a double leaves about a ten-thousandth of these, and no goal of a run
# is as small.
_FLOORS = {"px": 1e-6, "m": 1e-9, "rad": 1e-9, "1": 1e-8}


def asked_metrics(names: Any) -> tuple[str, ...]:
    """Return the names of metrics that are asked for, in the order of `METRICS`; "all" is all of them.

    Raises
    ------
    TypeError
        For anything but "all" and names.
    ValueError
        For a name that no metric has.
    """
    if isinstance(names, str) and names == "all":
        return tuple(METRICS)
    wanted = '"all" or names of hs.METRICS'
    asked = several_names("metrics", names, wanted)
    for name in asked:
        if name not in METRICS:
            raise ValueError(f'metrics: expected {wanted}, got "{name}"{did_you_mean(name, METRICS)}')
    return tuple(name for name in METRICS if name in asked)


def metrics(result: Result) -> dict[str, float]:
    """Return the metrics of a run by name, in SI units and pixels; `METRICS` describes each.

    The core streams them at every step, so they do not depend on ``simulation.log_every``. NaN stands where a number
    has no meaning (docs/model.md section 8): ``settling_time`` of a run that is not settled, ``rms_error`` of one that
    ends before ``metrics.rms_start``, ``chatter`` of one that ends where it starts, peaks of a speed or a joint that
    the robot does not limit.

    Raises
    ------
    TypeError
        For anything but a `Result`.
    """
    if not hasattr(result, "streamed_metrics"):  # whose module imports this one
        raise wrong_type("result", "a Result (see hs.simulate)", result)
    return dict(result.streamed_metrics)


def stayed_within(settling_time: Any, peak_error: Any, band: Any) -> Any:
    """Return whether no sample of a run left the settling band, of numbers or arrays of runs.

    A settling time of 0 alone has two meanings: of a run whose first sample is its only one outside it is 0 too.

    Parameters
    ----------
    settling_time, peak_error
        Metrics of the run [s], [px].
    band
        Its ``metrics.band`` [px].
    """
    return (settling_time == 0.0) & (peak_error <= band)


def since_settling(values: Mapping[str, float], measured: Metrics, digits: int = 4) -> str:
    """Return from when on a settled run is within the band: "after 0.353 s", rounded up.

    The settling time is the last time outside, so that it is not yet one within. Arguments as for `unsettled`.
    """
    settled = values["settling_time"]
    if settled > 0:
        return f"after {above(float(f'{settled:.12g}'), digits)} s"  # a grid time without its rounding
    within = stayed_within(settled, values["peak_error"], measured.band)
    return "from the start on" if within else "after the first sample"


def is_settled(outcome: Any, settling_time: Any) -> Mask:
    """Return whether runs completed and have a settling time: docs/model.md, section 8; of one run or of many.

    Parameters
    ----------
    outcome
        (n,) of `Result.outcome`, or one.
    settling_time
        The metric, (n,) [s], or one; NaN: the run is not within the band at its end.
    """
    return np.asarray((np.asarray(outcome) == "completed") & np.isfinite(settling_time))


def run_settles(result: Result) -> bool:
    """Return whether a run is settled: `is_settled` of its outcome and its settling time."""
    return bool(is_settled(result.outcome, metrics(result)["settling_time"]))


def unsettled(values: Mapping[str, float], measured: Metrics) -> str:
    """Return why a run of a scenario with these settings has no settling time: how far it is at the end, or how long.

    Parameters
    ----------
    values
        Its metrics by name.
    measured
        The block ``metrics`` of its scenario.
    """
    if values["final_error"] <= measured.band:
        return f"within {measured.band:g} px at the end, but for less than {measured.dwell:g} s"
    left, band = left_and_band(values, measured)
    return f"{left} px from the goal at the end, above {band} px"


def left_and_band(values: Mapping[str, float], measured: Metrics) -> tuple[str, str]:
    """Return the largest feature error at the end and the band, in px, as `apart`; arguments as for `unsettled`.

    An error that is rounding reads as in a table, "<1e-6", unless the band itself is as small.
    """
    left, band = apart(values["final_error"], measured.band)
    if values["final_error"] < _FLOORS["px"] <= measured.band:
        left = shown_number(values["final_error"], "px")
    return left, band


def shown_metrics(result: Result) -> dict[str, float]:
    """Return the metrics of a run without those of limits that its robot does not have."""
    found = metrics(result)
    return {name: value for name, value in found.items() if name not in OF_LIMITS or value == value}


def metric_unit(name: str, robot: Robot) -> str:
    """Return the unit of a metric for a robot: rotary legs have angles and torques."""
    return unit_of(robot, name, METRICS[name][0])


def metric_name(name: str, robot: Robot) -> str:
    """Return the name of a metric as people read it, for a robot: rotary legs are cranks, with torques."""
    plain = name.replace("_", " ")
    return OF_CRANKS.get(name, (plain, ""))[0] if robot.legs == "rotary" else plain


def metric_meaning(name: str, robot: Robot) -> str:
    """Return what a metric of a robot is."""
    plain = METRICS[name][1]
    return OF_CRANKS.get(name, ("", plain))[1] if robot.legs == "rotary" else plain


def metric_label(name: str, robot: Robot) -> str:
    """Return the label of an axis for a robot's metric, with its unit."""
    return f"{metric_name(name, robot)} [{metric_unit(name, robot)}]"


def readable(name: str, value: float, robot: Robot, largest: float | None = None) -> tuple[str, str]:
    """Return the text of a robot's metric and the unit that people read.

    Parameters
    ----------
    name, value, robot
        The metric, in its unit.
    largest
        Of the values beside it, which have one unit; None: it stands alone.
    """
    if value != value:
        return "never" if name == "settling_time" else "none", ""  # NaN: docs/model.md section 8
    unit = metric_unit(name, robot)
    shown, scale = readable_unit(unit, value if largest is None else largest)
    return shown_number(value, unit, scale), shown


def shown_number(value: float, unit: str, scale: float = 1.0, digits: int = 4) -> str:
    """Write a value of a table for people, as `number`; what rounding leaves of zero is less than a floor: "<1e-6".

    Parameters
    ----------
    value
        In the unit of its metric.
    unit
        The unit of its metric, which has the floor.
    scale
        How many of the unit that is shown make one of it.
    digits
        Of the number.
    """
    if is_rounding(value, unit):
        return f"<{_FLOORS[unit] * scale:g}".replace("e-0", "e-")
    return number(value * scale, digits)


def is_rounding(value: float, unit: str) -> bool:
    """Return whether a value above 0, in the unit of its metric, is what rounding leaves of zero."""
    return 0.0 < value < _FLOORS.get(unit, 0.0)


def readable_unit(unit: str, largest: float, digits: int = 4) -> tuple[str, float]:
    """Return the unit that people read in place of a metric's unit, and how many of it make one.

    It is that of the largest value that is shown, as `shown_unit`; what is rounding has that of the floor.
    """
    if unit == "1":
        return "%", 100.0
    if unit not in _WITH_PREFIX:
        return unit, 1.0
    return shown_unit(max(largest, _FLOORS.get(unit, 0.0)) if largest > 0.0 else 0.0, unit, digits)
