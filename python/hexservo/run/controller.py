"""The servo tick, for education and tests: the function that a robot calls in C++."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal, NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike

from hexservo import _core
from hexservo.scenario.arrays import Array, holds_no_number, real_numbers
from hexservo.scenario.block import SAMPLED_MODE
from hexservo.scenario.fields import described
from hexservo.scenario.parameters import Settings, core_parameters
from hexservo.scenario.scenario import Scenario, require_scenario
from hexservo.scenario.wording import wrong_type

InputStatus: TypeAlias = Literal["valid", "unusable", "missing_image", "stale_image", "lost_feature"]

# Time that was given last [s], and periods from it to the next tick: counted, since a sum of periods drifts away from
# the exposures, and frames then seem to come from the future.
_START = (0.0, 0)

_MEASURED = ("features", "depth", "position", "quaternion", "twist", "leg_lengths", "leg_rates")

_SEEN_FROM_HOME = ("target.initial_features", "target.depth")  # in place of points
_OF_POSITIONS = ("actuators.position.", "controller.virtual_platform.")  # the core refuses them beside forces
# and these beside positions
OF_FORCES = ("actuators.hold", "actuators.saturation", "actuators.bandwidth", "actuators.quantisation",
              "controller.safe.")  # fmt: skip


@described
class ControllerOutput(NamedTuple):
    """Output of a tick; vectors are in the base frame B (docs/model.md, section 7)."""

    wrench: Array
    """(6,), force and moment about E's origin [N; N m]."""
    leg_forces: Array
    """(6,), positive where they push the platform away from the base [N]; may be NaN where `leg_positions` are, of a
    machine that takes positions."""
    fuzzy_output: Array
    """(6,), output of the fuzzy systems, already subtracted in `wrench` [N; N m]."""
    invalid_input: bool
    """The law could not act: the wrench brakes and holds the platform, and nothing is learned."""
    status: InputStatus
    """``valid``, or why not, the first that applies: ``unusable`` (a number that is not finite, or beyond its limit),
    ``missing_image`` (a point has never been seen), ``stale_image`` (a point was not seen for longer than
    ``camera.timeout``), ``lost_feature`` (``camera.on_lost`` is ``stop``)."""
    saturated: bool
    """A leg force is beyond ``robot.force_limit`` where ``actuators.saturation`` is set, or the legs cannot move as the
    law would where ``actuators.kind`` is ``position``: nothing is learned."""
    leg_positions: Array
    """(6,), where ``actuators.kind`` is ``position``: what each leg shall go to, lengths [m] or angles of cranks [rad].
    NaN before the joints have been known once, and where drives take forces. `wrench` and `leg_forces` are then what
    the estimated platform needs to move so."""
    latency: Array
    """(3,), where ``camera.latency_known`` is false: what the latency was found to be, the shortest and the longest
    that it may be [s]. NaN where frames carry their exposure."""


class Controller:
    """The controller of a scenario, one tick at a time (docs/model.md, section 7).

    It is the controller of the sampled loop, all of it, and the one that ``hexservo export`` takes to a robot: frames
    with their times of exposure, prediction, lost points, timeout, the pose of the encoders, the law, the wait of the
    weights under saturation, and the safe output. A scenario in ``continuous`` mode has a frame and a pose at every
    tick.

    Of ``uncertainty`` it has what the controller itself assumes wrongly: focal length, principal point, mount, depth of
    the target's points where the law has a model of them, and the latency of ``sampled`` mode, of which poses are kept
    the longer. Set these to 0 for a real robot, unless its estimates are known to be wrong by so much. Errors of
    inertia, Coriolis terms and weight belong to the plant and have no effect here.

    For education and tests. A call from Python costs several times the tick itself, most of it for the conversion of
    arrays. A robot's program includes the header that ``hexservo export`` writes and calls ``hexservo::step``.

    Parameters
    ----------
    scenario
        Its law, robot, camera, sensors and target.
    period
        Time between two ticks [s], at most 1 s; the camera's times have to be whole numbers of it.
        None: the scenario's ``simulation.step``.

    Raises
    ------
    TypeError
        For anything but a `Scenario`, and a period that is no number.
    ValueError
        For a period that is out of range, or does not fit the camera's times.
    """

    def __init__(self, scenario: Scenario, period: float | None = None) -> None:
        require_scenario(scenario)
        self._scenario = scenario
        settings, seconds = controller_arguments(scenario, period)
        self._core = _core.Controller(settings, seconds)
        self._reads_legs = _reads_legs(settings)
        self._clock = _START

    def __getstate__(self) -> dict[str, Any]:
        """Return scenario, period and all that is kept from tick to tick: copies and pickles go on from here."""
        return {"scenario": self._scenario, "period": self.period, "clock": self._clock, "state": self._core.state()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Continue where `__getstate__` was called."""
        self.__init__(state["scenario"], state["period"])  # type: ignore[misc]
        self._core.restore(state["state"])
        self._clock = state["clock"]

    def __repr__(self) -> str:
        """Show the scenario's name and the period."""
        return f"Controller({self._scenario.name!r}, period={self.period!r})"

    @property
    def scenario(self) -> Scenario:
        """Scenario of the controller."""
        return self._scenario

    @property
    def period(self) -> float:
        """Time between two ticks [s]."""
        return self._core.period

    @property
    def fuzzy_weights(self) -> Array:
        """Weights of the six fuzzy systems now, (6, 7, 7), row: term of u, column: term of its rate [N; N m]."""
        return self._core.fuzzy_weights

    def reset(self) -> None:
        """Reset to the state before the first tick, at time 0."""
        self._core.reset()
        self._clock = _START

    def step(
        self,
        features: ArrayLike | None = None,
        depth: ArrayLike | None = None,
        position: ArrayLike | None = None,
        quaternion: ArrayLike | None = None,
        twist: ArrayLike | None = None,
        *,
        exposure: float | None = None,
        now: float | None = None,
        leg_lengths: ArrayLike | None = None,
        leg_rates: ArrayLike | None = None,
    ) -> ControllerOutput:
        """Run one tick: sensors, (13), (14), (15), leg forces, and the adaptation (22) over one period.

        Numbers that are not finite are accepted, as sensors give them; they make the output safe (`invalid_input`).
        So do features more than 1e4 px from the goal, twists beyond 1e3, points that are not in front of the camera, a
        quaternion without a length, a frame from the future, a clock that goes back, and singular poses.

        Parameters
        ----------
        features
            (2p,) of p points, measured pixels (x1, y1, ..., xp, yp) as the scenario's camera counts them [px], those of
            `project`, `Result.pixels` and `Observation.pixels`: by ``camera.principal_point``, ``axes`` and
            ``distortion``, which the tick takes out. Features of the pinhole, as in `Observation.features`, are
            others wherever the camera has one of these; no status reports that. NaN for a point that the frame does
            not show. None: no frame arrived since the last tick, whatever `depth` is, and the one before is used, or
            predicted.
        depth
            (p,), measured Z of the points at the exposure, along the axis of the camera, which is that of E unless it
            has a ``camera.mount``; negative in front of the camera, with either of ``camera.axes`` [m]. None: not
            known, as NaN, and a frame that shows a point is ``unusable``.
        position
            (3,), of E's origin, in B [m]. Not used where ``sensors.pose`` is ``encoders``.
        quaternion
            (4,), attitude of E in B, (w, x, y, z) of any length but zero. Likewise.
        twist
            (6,), velocity of E's origin and angular velocity, in B [m/s; rad/s]. Likewise.
        exposure
            Time at which the frame was exposed [s]; of two frames the one exposed later counts. None: `now`. Where
            ``camera.latency_known`` is false: when it arrived.
        now
            Time of the tick [s]; never less than before. None: a period after the last tick, the first one at 0.
        leg_lengths
            (6,), where ``sensors.pose`` is ``encoders`` [m]. NaN, or None without a pose: no reading at this tick, and
            the last one holds, for twice ``sensors.period`` at most.
        leg_rates
            (6,), where ``sensors.rate`` is true [m/s].

        Raises
        ------
        TypeError
            For times that are no numbers.
        ValueError
            "name: expected 8 numbers, got ..." for an argument of another shape or of no numbers, such as booleans. For
            a pose or twist without `leg_lengths` where ``sensors.pose`` is ``encoders``.
        """
        _refuse_booleans(features, depth, position, quaternion, twist, leg_lengths, leg_rates)
        if self._reads_legs and leg_lengths is None:
            _refuse_pose(position=position, quaternion=quaternion, twist=twist)
        given, periods = self._clock if now is None else (_seconds("now", now), 0)
        time = given + periods * self.period
        exposed = np.nan if features is None else time if exposure is None else _seconds("exposure", exposure)
        wrench, leg_forces, fuzzy_output, status, saturated, leg_positions, latency = self._core.step(
            features, depth, position, quaternion, twist, leg_lengths, leg_rates, exposed, time
        )
        if np.isfinite(time):
            self._clock = given, periods + 1
        return ControllerOutput(
            wrench,
            leg_forces,
            fuzzy_output,
            status != _core.InputStatus.valid,
            cast("InputStatus", status.name),
            saturated,
            leg_positions,
            latency,
        )


def controller_arguments(scenario: Scenario, period: float | None) -> tuple[Settings, float]:
    """Return the core's settings of a scenario's controller and its period, the scenario's unless one is given."""
    return core_parameters(scenario), scenario.simulation.step if period is None else _seconds("period", period)


def controller_keys(settings: Settings) -> Iterator[_core.ScenarioKey]:
    """Yield the keys that a scenario's controller is made from: of its law, mode, legs, drives and kind of target.

    The machine and the target are among them whole, also where the tick does not use them all.
    """
    sampled = settings["simulation.mode"] == SAMPLED_MODE
    unused: tuple[str, ...] = OF_FORCES if _takes_positions(settings) else _OF_POSITIONS
    if settings["target.points"] is not None:
        unused += _SEEN_FROM_HOME
    if settings["robot.legs"] == "prismatic":
        unused += ("robot.cranks.",)
    for key in _core.scenario_keys(settings.law):
        acts = not key.sampled or sampled or key.name.startswith("controller.safe.")
        if key.concern == "controller" and acts and not key.name.startswith(unused):
            yield key


def unused_by_law(name: str) -> tuple[str, ...]:
    """Return the beginnings of keys that have no effect with a law, or one value alone, whatever other keys are."""
    law = _core.LAW_TRAITS[name]
    unused: tuple[str, ...] = () if law.output == "wrench" else ("controller.virtual_platform.",)
    if law.output == "pose":  # positions, by a law that predicts its target itself
        unused += ("camera.prediction", "camera.gate", "camera.convention", "camera.mount.on", *OF_FORCES)
    else:
        unused += ("camera.latency_known",)
    if not law.switching:
        unused += ("controller.switching.",)
    if not law.depth:  # no image Jacobian
        unused += ("controller.jacobian",)
    return unused


def tick_keys(settings: Settings) -> Iterator[_core.ScenarioKey]:
    """Yield those of `controller_keys` that the tick depends on, or may once others have changed.

    Law, mode, legs and kind of drives stay as they are.
    """
    law, positions = _core.LAW_TRAITS[settings.law], _takes_positions(settings)
    unused = unused_by_law(settings.law)
    if positions:
        unused += ("robot.force_limit", "camera.convention")
    else:
        unused += ("robot.stroke", "robot.stroke_centre")
        if settings["simulation.mode"] != SAMPLED_MODE:  # its drives do not saturate
            unused += ("robot.force_limit",)
    if positions and law.output != "pose":
        unused += ("actuators.delay", "actuators.position.bandwidth", "actuators.position.damping")
    if not law.points:
        unused += ("target.points", *_SEEN_FROM_HOME, "uncertainty.depth")
    return (key for key in controller_keys(settings) if not key.name.startswith(unused))


def _takes_positions(settings: Settings) -> bool:
    return bool(settings["simulation.mode"] == SAMPLED_MODE and settings["actuators.kind"] != "force")


def _reads_legs(settings: Settings) -> bool:
    return bool(settings["simulation.mode"] == SAMPLED_MODE and settings["sensors.pose"] == "encoders")


def _refuse_pose(**given: ArrayLike | None) -> None:
    """Refuse a pose in place of the readings of encoders: it has no effect, and the law would never act."""
    names = [name for name, values in given.items() if values is not None]
    if names:
        raise ValueError(
            "leg_lengths: expected 6 lengths, since sensors.pose is encoders in the scenario, got None, and "
            f"{', '.join(names)} in their place, which would have no effect; add leg_lengths, such as "
            "Observation.leg_lengths of a custom controller, NaN at a tick without a reading"
        )


def _refuse_booleans(*given: ArrayLike | None) -> None:
    """Refuse lists with booleans among numbers as arguments of a tick: the core would get 0 and 1."""
    for name, values in zip(_MEASURED, given, strict=True):
        if isinstance(values, list | tuple) and holds_no_number(values):
            raise ValueError(f"{name}: expected numbers, got {values!r:.60}")


def _seconds(name: str, given: object) -> float:
    """Return one real number; a boolean is none."""
    if isinstance(given, float):  # of every tick
        return given
    number = real_numbers(given)
    if number is None or number.ndim:
        raise wrong_type(name, "a number of seconds", given)
    return float(number)
