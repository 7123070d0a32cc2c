"""Requirements: what a run must keep to pass, and by how much it does."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexservo.run.metrics import METRICS
from hexservo.scenario.arrays import Array
from hexservo.scenario.rules import did_you_mean, is_number, refusal, shown_value
from hexservo.scenario.wording import above, below
from hexservo.scenario.yaml import decimal

COMPLETED = "completed"
_COMPARISONS = {"<=": operator.le, ">=": operator.ge, "<": operator.lt, ">": operator.gt}
_TEXT = re.compile(r"\s*(?P<name>\w+)\s*(?P<comparison><=|>=|==|!=|<|>)\s*(?P<bound>\S+)\s*\Z")
_EXPECTED = f'text such as "settling_time <= 0.5" or "outcome == {COMPLETED}"'
_LARGEST = 1e100  # magnitude of a distance: its square is finite too, for scales next to nothing
_FAILED_BY_NOTHING = -float(np.finfo(float).tiny)  # distance of a value at a bound that it may not reach
_ROUNDING = 1e-12  # part of a bound by which a value misses it through rounding: 283 steps of 1 ms are above 0.283 s
_WITHOUT_VALUE = -1.0  # margin of a completed run whose metric has no value
_FARTHEST = float(np.nextafter(_WITHOUT_VALUE, 0.0))  # margin of a value, however far from its bound


@dataclass(frozen=True)
class Requirement:
    """A bound on a metric, or that the run completes."""

    name: str  # of hs.METRICS, or "outcome"
    comparison: str = "=="  # <=, >=, <, >; == for the outcome
    bound: float = math.nan  # in the metric's unit; NaN for the outcome
    scale: float | None = None  # what a distance of 1 is, in the metric's unit; None: |bound|

    def __str__(self) -> str:
        """Write it as a file does."""
        if self.name == "outcome":
            return f"outcome == {COMPLETED}"
        return f"{self.name} {self.comparison} {self.bound!r}"

    def to_plain(self) -> Any:
        """Return what a campaign file writes for it."""
        return str(self) if self.scale is None else {"holds": str(self), "scale": self.scale}

    def distance(self, values: Array) -> Array:
        """Return the distances of runs that completed from the bound.

        Parameters
        ----------
        values
            (n,) of the metric, in its unit.

        Returns
        -------
        Array
            (n,), in parts of the scale: at least 0 where the requirement holds, else negative; at most 1e100 either
            way; NaN where the metric is. A value that equals the bound to rounding is at the bound.
        """
        with np.errstate(over="ignore"):
            values = np.where(np.abs(values - self.bound) <= _ROUNDING * abs(self.bound), self.bound, values)
            room = (self.bound - values if self._is_upper else values - self.bound) / self._unit
        room = np.clip(room, -_LARGEST, _LARGEST)
        holds = _COMPARISONS[self.comparison](values, self.bound)
        found = np.where(holds, np.maximum(room, 0.0), np.minimum(room, _FAILED_BY_NOTHING))
        return np.where(np.isnan(values), np.nan, found)

    def bound_at(self, distance: float) -> float:
        """Return the bound, in the metric's unit, that a run at this distance from the present one meets exactly."""
        return self.bound - (distance if self._is_upper else -distance) * self._unit

    def rounded_bound_at(self, distance: float, digits: int = 4) -> float:
        """Return `bound_at`, rounded to so many digits and outwards: what is written is kept by that run too."""
        bound = self.bound_at(distance)
        if self.comparison in ("<", ">"):  # which a value at the bound does not keep
            bound = math.nextafter(bound, math.inf if self._is_upper else -math.inf)
        return float((above if self._is_upper else below)(bound, digits))

    @property
    def undecided(self) -> str:
        """Why its bound judges no metric of `hs.METRICS`, none of which is negative; "" where it may."""
        if (self.bound < 0 and self._is_upper) or (self.bound == 0 and self.comparison == "<"):
            return f"{self.name}: expected a bound that a run can keep, as no metric is negative, got {self}"
        if self.bound < 0 or (self.bound == 0 and self.comparison == ">="):
            return (
                f"{self.name}: expected a bound that a run can miss, as no metric is negative, got {self}; "
                f'that a run completes is "outcome == {COMPLETED}"'
            )
        return ""

    def excludes(self, other: Requirement) -> bool:
        """Return whether this upper bound and another, lower one on the same metric leave no value between them."""
        if self.name != other.name or not self._is_upper or other.comparison not in (">=", ">"):
            return False
        strict = self.comparison == "<" or other.comparison == ">"
        return self.bound < other.bound or (self.bound == other.bound and strict)

    @property
    def _is_upper(self) -> bool:
        return self.comparison in ("<=", "<")

    @property
    def _unit(self) -> float:
        """What a distance of 1 is, in the metric's unit."""
        return abs(self.bound) if self.scale is None else self.scale


def margin_of(distances: Array) -> Array:
    """Return the margins of distances from bounds, of any shape: the order of runs, from the best to the worst.

    A distance d that is not negative is the margin. Where a requirement is missed by x = -d the margin is -x/(1 + x):
    between -1 and 0, nearly d next to the bound, and falling with x. It is -1 where there is no distance (NaN), which
    is the limit of an infinite one: nothing that has a value is worse.
    """
    missed = np.minimum(distances, 0.0)
    found = np.where(distances < 0, np.maximum(missed / (1.0 - missed), _FARTHEST), distances)
    return np.where(np.isnan(distances), _WITHOUT_VALUE, found)


def distance_of(margin: float) -> float:
    """Return the distance of a margin above -1, the inverse of `margin_of`."""
    return margin / (1.0 + margin) if margin < 0 else margin


def run_margins(
    requirements: Sequence[Requirement],
    outcome: NDArray[np.str_],
    end_time: Array,
    duration: Array | float,
    metrics: Mapping[str, Array],
) -> Array:
    """Return the margin of every run for every requirement; a run passes where it is not negative.

    Parameters
    ----------
    requirements
        r of them, at least one.
    outcome, end_time
        (n,) as of `BatchResult`; times in s.
    duration
        (n,) or a number: the time that a run was to take [s].
    metrics
        Name of `hs.METRICS` to (n,), those of the requirements at least.

    Returns
    -------
    Array
        (n, r). A completed run has `margin_of` its distance: -1 or more. A run that ended early at t_end has
        -(1 + (T - t_end)/T) for every requirement, T being its duration: from -1 to -2.
    """
    early = -(1.0 + np.clip((duration - np.nan_to_num(end_time)) / duration, 0.0, 1.0))
    distances = run_distances(requirements, outcome, metrics)
    return np.where((outcome == COMPLETED)[:, None], margin_of(distances), early[:, None])


def ranks_of(margins: Array) -> Array:
    """Return by what runs are compared, (n, 2) of margins (n, r): the smallest one, then the sum of the negative ones.

    The run with the lexicographically least pair is the worst. All runs without a value have the same smallest margin:
    the sum orders them by what else they miss, whatever room other bounds have.
    """
    return np.stack([margins.min(axis=1), np.minimum(margins, 0.0).sum(axis=1)], axis=1)


def run_distances(
    requirements: Sequence[Requirement], outcome: NDArray[np.str_], metrics: Mapping[str, Array]
) -> Array:
    """Return the distance of every run from every bound, (n, r): `Requirement.distance`, and 1 for the outcome.

    NaN where the run ended early, or its metric has no value: no bound would change that. Arguments as for
    `run_margins`.
    """
    columns = [
        np.ones(len(outcome)) if requirement.name == "outcome" else requirement.distance(metrics[requirement.name])
        for requirement in requirements
    ]
    return np.where((outcome == COMPLETED)[:, None], np.stack(columns, axis=1), np.nan)


def requirement_of(value: Any, units: Mapping[str, str] | None = None) -> Requirement:
    """Return a requirement from its form in a file.

    Parameters
    ----------
    value
        Text, or a block with ``holds`` and ``scale``.
    units
        Name -> unit of what may be required; None: metrics of runs, and that they complete.

    Raises
    ------
    ValidationError
        With one problem.
    """
    known = {name: unit for name, (unit, _) in METRICS.items()} if units is None else units
    scale = None
    if isinstance(value, Mapping):
        if set(value) != {"holds", "scale"}:
            raise refusal(
                ((), f"expected {_EXPECTED}, or a block with holds and scale; got {shown_value(dict(value))}")
            )
        value, scale = value["holds"], value["scale"]
        if not is_number(scale) or not 0 < scale < math.inf:
            raise refusal((("scale",), f"expected a number > 0, got {shown_value(scale)}"))
    match = _TEXT.match(value) if isinstance(value, str) else None
    if match is None:
        raise refusal(((), f"expected {_EXPECTED}, got {shown_value(value)}"))
    name, comparison, text = match["name"], match["comparison"], match["bound"]
    if name == "outcome" and units is None:
        if (comparison, text, scale) != ("==", COMPLETED, None):
            raise refusal(((), f'expected "outcome == {COMPLETED}", the only requirement of an outcome, got "{value}"'))
        return Requirement("outcome")
    if name not in known:
        names = ("outcome", *known) if units is None else tuple(known)
        what = "metric" if units is None else "number of the loop"
        hint = did_you_mean(name, names) or ";"
        if units is not None and name in (*METRICS, "outcome"):
            hint = ", which is one of runs: add it to require;"
        raise refusal(((), f'unknown {what} "{name}"{hint} known: {", ".join(names)}'))
    if comparison not in _COMPARISONS:
        raise refusal(((), f'expected one of {" ".join(_COMPARISONS)} for a metric, got "{comparison}"'))
    bound = decimal(text)
    if bound is None or not math.isfinite(bound):
        unit = known[name]
        raise refusal(((), f'expected a finite bound [{unit}], got "{text}"'))
    if bound == 0 and scale is None:
        raise refusal(
            ((), f'expected a scale for a bound of 0, as {{holds: "{value}", scale: 1.0}}: a margin is a part of it')
        )
    return Requirement(name, comparison, bound, None if scale is None else float(scale))
