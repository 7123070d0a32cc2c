"""Runs a scenario with a controller that is a Python function in place of a law of the core."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from hexservo import _core
from hexservo.scenario.arrays import Array, real_numbers
from hexservo.scenario.fields import described
from hexservo.scenario.laws import ALL_LAWS
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.pixels import assumed_pixels
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.yaml import ScenarioError


@described
class Observation(NamedTuple):
    """Input of a controller at a servo tick: measurements, never the plant's true values.

    Frames and orders: docs/model.md section 1; the sampled loop: section 7.
    """

    tick: int
    """Number of the tick, from 0; also 0 at the first call of every run."""
    time: float
    """Of the tick, ``tick * scenario.simulation.step`` [s]."""
    exposure: float
    """Time at which the newest frame was taken [s]; NaN before the first one has arrived."""
    features: Array
    """(2p,) of p points, from the newest frame or the prediction: (x, y) of each from the principal point, y up, as the
    pinhole of the controller's camera has them, lens and axes taken out [px]; NaN until every point has been seen
    once."""
    depth: Array
    """(p,), estimates of Z in the camera's frame C, negative in front of the camera [m]; NaN as the features."""
    position: Array
    """(3,), of E's origin in B, by the joint sensors [m]."""
    quaternion: Array
    """(4,), attitude of E in B, (w, x, y, z), by the joint sensors."""
    twist: Array
    """(6,), (velocity; angular velocity) in B, by the joint sensors [m/s; rad/s]."""
    leg_lengths: Array
    """(6,), as the encoders read them at this tick, where ``sensors.pose`` is ``encoders`` [m]; NaN at a tick without a
    reading, and without encoders."""
    leg_rates: Array
    """(6,), by the rate sensors beside the encoders, where ``sensors.rate`` is true [m/s]; NaN as `leg_lengths`."""
    pixels: Array
    """(2p,), `features` as `Controller.step` takes them: in pixels of the camera that the controller assumes, by
    ``camera.principal_point``, ``axes`` and ``distortion`` [px]; NaN as the features, and where the lens shows no such
    point."""
    leg_positions: Array
    """(6,), where the drives take positions: what they took last, at the first tick where the legs are, lengths [m] or
    angles of cranks [rad]; NaN where drives take forces."""


_measured_of = attrgetter(*Observation._fields[:-2])  # of what the core has seen, under equal names


@described
@dataclass(frozen=True, eq=False)
class LegForces:
    """Output of a controller that commands the legs individually."""

    forces: ArrayLike  # (6,), positive where they push the platform away from the base [N]


@described
@dataclass(frozen=True, eq=False)
class LegPositions:
    """Output of a controller of drives that take positions; ``Observation.leg_positions`` again: they stay as they are.

    Nothing takes their place where an image is missing or too old, and nothing keeps them within the stroke: a leg that
    passes its end is an event of the result, and ends the run with ``robot.on_limit: stop``.
    """

    positions: ArrayLike  # (6,), where each leg shall go to, lengths [m] or angles of cranks [rad]


OwnController: TypeAlias = Callable[[Observation], "ArrayLike | LegForces | LegPositions"]


def require_runnable(scenario: Scenario) -> None:
    """Check that a custom controller, which is called at every servo tick, can run a scenario.

    Raises
    ------
    ScenarioError
        For a scenario in continuous mode.
    """
    if not scenario.sampled:
        raise ScenarioError(["simulation.mode: expected sampled for a custom controller, got continuous"])


def run_with(scenario: Scenario, controller: OwnController) -> _core.Trajectory:
    """Call the controller at every tick, from the first to the last. Ctrl-C ends the run as ``interrupted``.

    Raises
    ------
    ScenarioError
        As `require_runnable`, before the first call.
    ValueError
        For a command that the drives do not take, of another shape or with numbers that are not finite, or leg forces
        whose wrench is not, with its tick.
    Exception
        What the controller raises, as it is; where the interpreter can (from Python 3.11 on), with a note that names
        the tick.
    """
    require_runnable(scenario)
    settings = core_parameters(scenario)
    run = _core.SampledRun(settings)
    pixels_of = assumed_pixels(scenario, settings)
    try:
        while run.running:
            seen = run.observe()
            observation = Observation._make((*_measured_of(seen), pixels_of(seen.features), seen.leg_positions))
            try:
                command = controller(observation)
            except Exception as error:
                if hasattr(error, "add_note"):
                    error.add_note(f"raised by the controller {_at(observation)}")
                raise
            _require_taken(command, observation, scenario.actuators.takes_positions)
            if isinstance(command, LegPositions):
                run.command_positions(_six("leg positions", command.positions, observation))
            elif isinstance(command, LegForces):
                _command_legs(run, command, observation)
            else:
                run.command(_six("a wrench", command, observation))
    except KeyboardInterrupt:
        pass  # what was computed is kept, and the trajectory is marked
    return run.finish()


def _require_taken(command: object, seen: Observation, take_positions: bool) -> None:
    """Refuse a command of another kind than the drives take: numbers of one are plausible as the other."""
    if isinstance(command, LegPositions) == take_positions:
        return
    raise ValueError(
        f"controller: expected {'hs.LegPositions' if take_positions else 'a wrench of 6 numbers, or hs.LegForces'}, "
        f"which drives with this actuators.kind take, {_at(seen)}, got {command!r:.60}"
    )


def _command_legs(run: _core.SampledRun, command: LegForces, seen: Observation) -> None:
    forces = _six("leg forces", command.forces, seen)
    try:
        run.command_legs(forces)
    except ValueError:  # finite numbers whose sum is not
        raise ValueError(f"controller: expected leg forces with a finite wrench {_at(seen)}, got {forces}") from None


def function_name(function: object) -> str:
    """Return the name under which results keep a custom controller: never that of a law."""
    name = str(getattr(function, "__qualname__", type(function).__qualname__))
    name = name if name.isprintable() else ascii(name)[1:-1]  # a file holds neither NUL nor half of a surrogate pair
    return f"{name}()" if name in ALL_LAWS else name


def _six(what: str, command: ArrayLike, seen: Observation) -> Array:
    numbers = real_numbers(command)
    if numbers is not None and numbers.shape == (6,) and np.isfinite(numbers).all():
        return numbers
    if numbers is None:
        got = f"{command!r:.60}"
    elif numbers.shape != (6,):
        got = f"an array of shape {numbers.shape}"
    else:
        got = str(numbers)
    raise ValueError(f"controller: expected {what} of 6 finite numbers {_at(seen)}, got {got}")


def _at(seen: Observation) -> str:
    return f"at tick {seen.tick} (t = {seen.time:.9g} s)"
