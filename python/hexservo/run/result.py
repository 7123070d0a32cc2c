"""Result of a run: plain arrays with their scenario, also as a labelled dataset."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from hexservo.run.display import result_text
from hexservo.run.drawn import html_of
from hexservo.run.metrics import readable_unit
from hexservo.run.quantities import WRENCH, Outcome, quantities
from hexservo.run.saving import require_data, save_result, saved_attributes
from hexservo.scenario.arrays import Array
from hexservo.scenario.fields import described
from hexservo.scenario.leg_units import unit_of
from hexservo.scenario.pixels import desired_features, to_pixels
from hexservo.scenario.rules import TERMS
from hexservo.scenario.version import VERSION
from hexservo.scenario.wording import apart, wrong_type

if TYPE_CHECKING:
    import pandas
    import xarray

    from hexservo.scenario.blocks import Robot
    from hexservo.scenario.scenario import Scenario

LimitKind: TypeAlias = Literal["stroke", "force", "speed", "base_joint", "platform_joint"]

# kind -> unit, what a leg exceeds
_LIMITS: dict[str, tuple[str, str]] = {
    "stroke": ("m", "leg {} exceeded its stroke"),
    "force": ("N", "leg {} exceeded its force limit"),
    "speed": ("m/s", "leg {} exceeded its speed limit"),
    "base_joint": ("rad", "the base joint of leg {} exceeded its limit"),
    "platform_joint": ("rad", "the platform joint of leg {} exceeded its limit"),
}


def leg_words(robot: Robot, name: str, meaning: str) -> str:
    """Return the meaning of a quantity for the legs that a robot has."""
    rotary = {"leg_lengths": "angles of the cranks", "leg_forces": "torques of the cranks"}
    return rotary.get(name, meaning) if robot.legs == "rotary" else meaning


def labelling(scenario: Scenario, name: str) -> tuple[dict[str, list[str] | list[int]], dict[str, str]]:
    """Return the labels of an array's dimensions beside time and scenarios, by dimension, and its unit and meaning."""
    if name in ("fuzzy_weights", "weight_history"):
        meaning = "weights of the fuzzy systems" + (" at the end" if name == "fuzzy_weights" else "")
        labels = {"wrench_component": list(WRENCH), "error_term": list(TERMS), "rate_term": list(TERMS)}
        return {**labels}, {"units": "N; N m", "long_name": meaning}
    robot = scenario.robot
    dimension, numbers, unit, meaning = quantities(scenario.target.count)[name]
    return {dimension: numbers}, {"units": unit_of(robot, name, unit), "long_name": leg_words(robot, name, meaning)}


@described
@dataclass(frozen=True)
class LimitEvent:
    """A leg beyond one of its limits, which a run reports; with ``robot.on_limit: stop`` it ends there."""

    kind: LimitKind  # stroke, force, speed, base_joint or platform_joint
    leg: int  # 1 to 6; column leg - 1 of the arrays
    time: float  # when it first exceeded the limit [s]
    # of the run: largest |length - middle of the travel| [m], |force| [N], |rate| [m/s] or tilt [rad]; where it ended
    # the run that of the step that failed, which no sample and no metric has
    peak: float
    limit: float  # in the same unit
    # of a rotary leg: angle [rad], torque [N m] and rate [rad/s] in place of the first three
    rotary: bool = field(default=False, repr=False)

    @property
    def shown(self) -> tuple[str, str]:
        """Peak and limit with the unit that people read: "17.02 mm", "17 mm"."""
        unit, scale = readable_unit(self.unit, self.limit)
        peak, limit = apart(self.peak * scale, self.limit * scale)
        return f"{peak} {unit}", f"{limit} {unit}"

    @property
    def unit(self) -> str:
        """SI unit of peak and limit."""
        unit = _LIMITS[self.kind][0]
        return {"m": "rad", "N": "N m", "m/s": "rad/s"}.get(unit, unit) if self.rotary else unit

    def __str__(self) -> str:
        """Return the event as a sentence."""
        what = _LIMITS[self.kind][1].format(self.leg)
        what = what.replace("force", "torque") if self.rotary else what
        peak, limit = self.shown
        return f"{what} of {limit} at t = {self.time:.4g} s (peak {peak})"


@described
@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """Samples of one run, on the grid that ``simulation.log_every`` asks for; the last good sample is always there.

    Frames and orders: docs/model.md section 1. Arrays are C-contiguous and are all that the run has: copy what is to be
    changed, such as units. (They are writable since SciPy's rotations take no others.)
    """

    scenario: Scenario  # that was run
    controller: str  # the law that acted, or the name of the function that stood in its place
    # completed, diverged, behind_camera, feature_lost, leg_limit, singular, solver_failed or interrupted
    outcome: Outcome
    end_time: float  # time of the last good sample [s]
    detail: str  # one sentence: how the run ended
    events: tuple[LimitEvent, ...]  # exceeded limits, by time
    time: Array  # (n,) [s]
    feature_error: Array  # (n, 2p) [px] of p points, desired minus true (x1, y1, ..., xp, yp)
    depth: Array  # (n, p) [m], true Z of the points in the camera's frame C, negative in front of the camera
    position: Array  # (n, 3) [m], in B
    quaternion: Array  # (n, 4) w x y z
    twist: Array  # (n, 6) [m/s, rad/s], in B
    wrench: Array  # (n, 6) [N, N m], in B
    fuzzy_output: Array  # (n, 6) [N, N m]
    leg_lengths: Array  # (n, 6) [m]; of rotary legs crank angles [rad]
    leg_forces: Array  # (n, 6) [N]; of rotary legs torques [N m]
    # (6, 7, 7) [N, N m], row: term of u, column: term of its rate; after the last step, which is one beyond the last
    # sample where leg_limit, singular or solver_failed ended the run (docs/model.md, section 8)
    fuzzy_weights: Array
    streamed_metrics: dict[str, float] = field(repr=False)  # read them through hs.metrics(result)
    weight_history: Array | None = field(default=None, repr=False)  # (n, 6, 7, 7) like fuzzy_weights, where logged
    version: str = field(default=VERSION, repr=False)  # of hexservo that ran it

    def __repr__(self) -> str:
        """Return the run in a few lines."""
        return result_text(self)

    def _repr_html_(self) -> str:
        """Return summary, metrics and figures for a notebook."""
        return html_of(self)

    @property
    def by_law(self) -> bool:
        """Whether a law of the scenario controlled the run; False for a custom controller."""
        return self.controller == self.scenario.controller.law

    @property
    def stop_time(self) -> float:
        """Time at which the run ended [s]: of the step that failed, one after ``end_time``, else ``end_time``."""
        if self.outcome in ("completed", "interrupted"):
            return self.end_time
        # the outcome of a metric that overflowed is that of the end of the run
        grid = self.scenario.simulation
        steps = min(round(self.end_time / grid.step) + 1, round(grid.duration / grid.step))
        return steps * grid.step

    @property
    def stop_event(self) -> LimitEvent | None:
        """The leg beyond a limit that ended the run (``robot.on_limit: stop``); None: none did."""
        last = self.events[-1] if self.events else None
        return last if last is not None and last.time > self.end_time else None

    @property
    def stopped_by(self) -> str:
        """Kind of the leg's limit that ended the run, as of `LimitEvent`; "": none did."""
        return "" if self.stop_event is None else self.stop_event.kind

    @property
    def features(self) -> Array:
        """True features of the camera's pinhole, (n, 2p) [px]; `pixels` are those of its image."""
        return desired_features(self.scenario) - self.feature_error

    @property
    def pixels(self) -> Array:
        """True pixels of the points, (n, 2p) [px], as the scenario's camera counts them, without noise.

        They differ from `features` where the camera has a lens, a principal point or axes of OpenCV; NaN where the
        lens does not show a point.
        """
        return to_pixels(self.scenario, self.features)

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> None:
        """Write the run into a netCDF file that `hs.load_result` reads back bit for bit.

        Parameters
        ----------
        path
            A name in a folder that exists, such as ``result.nc``. The file appears whole or not at all.
        force
            Replace an earlier result; no other file is ever replaced.

        Raises
        ------
        OutputError
            The file exists, is no result, or cannot be written (a `ValueError`).
        ValueError
            Arrays, ``end_time``, outcome or metrics are not those of a run (another shape or type, NaN): nothing is
            written.
        """
        save_result(self, path, force=force)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return the run as a flat table: a row for each sample, a column for each scalar.

        The index is the time [s]. Columns are named after array and component, such as ``feature_error_x1``,
        ``twist_wz`` and ``leg_forces_6``; ``attrs["units"]`` maps each to its unit, and ``attrs`` also holds scenario,
        controller and outcome. Weights of the fuzzy systems are no columns: `to_xarray` has them.
        """
        import pandas as pd

        columns: dict[str, Array] = {}
        units: dict[str, str] = {}
        for name, (_, labels, plain, _meaning) in quantities(self.scenario.target.count).items():
            unit = unit_of(self.scenario.robot, name, plain)
            of_force, _, of_moment = unit.partition("; ")
            for number, label in enumerate(labels):
                column = f"{name}_{label}"
                columns[column] = getattr(self, name)[:, number]
                units[column] = of_moment if of_moment and number >= 3 else of_force
        table = pd.DataFrame(columns, index=pd.Index(self.time, name="time"))
        table.attrs = {
            "scenario": self.scenario.name,
            "controller": self.controller,
            "outcome": self.outcome,
            "units": {"time": "s", **units},
        }
        return table

    def to_xarray(self) -> xarray.Dataset:
        """Return the run as a dataset with labelled dimensions and units.

        Attributes hold text and numbers only: the outcome, the metrics (``metric_...``), the events in sentences
        (``events``) and as numbers (``event_table``: seconds, and metres or newtons), and the scenario as one YAML
        string (``scenario``), so that every netCDF reader can open the file. `load_result` reads the files that
        ``hexservo run --out`` writes, which have a digest of their bytes at the end. The dataset shares no memory with
        the result.
        """
        import xarray

        data: dict[str, Any] = {"time": ("time", self.time, {"units": "s", "long_name": "time"})}
        history = [] if self.weight_history is None else ["weight_history"]
        for name in (*quantities(self.scenario.target.count), "fuzzy_weights", *history):
            labels, attributes = labelling(self.scenario, name)
            data |= {dimension: (dimension, numbers) for dimension, numbers in labels.items()}
            data[name] = ([*([] if name == "fuzzy_weights" else ["time"]), *labels], getattr(self, name), attributes)
        attributes = {
            "title": f"hexservo run of {self.scenario.name}",
            "events": "\n".join(map(str, self.events)),
            **saved_attributes(self),
        }
        dataset = xarray.Dataset(data, attrs=attributes)
        return dataset.copy(deep=True)  # xarray keeps the arrays it is given, and a dataset may be changed in place


def require_result(result: object) -> None:
    """Refuse an argument that is no result of a run.

    Raises
    ------
    TypeError
        "result: expected a Result (see hs.simulate), got str".
    """
    if not isinstance(result, Result):
        raise wrong_type("result", "a Result (see hs.simulate)", result)


def require_run(result: Result) -> None:
    """Refuse an argument that is no result, or has what no run has.

    Raises
    ------
    TypeError
        As `require_result`.
    ValueError
        As `require_data`.
    """
    require_result(result)
    require_data(result)
