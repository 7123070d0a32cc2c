"""Whether a log is of the machine's legs: what is out of their reach is in another unit, order, or of other legs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hexservo import _core
from hexservo.findings.identification.log import Log
from hexservo.scenario.arrays import Array
from hexservo.scenario.leg_units import leg_units
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import number
from hexservo.scenario.yaml import ScenarioError

_FARTHEST = 3.0  # strokes from the middle of the travel at any tick
# The same at half of the ticks. Cranks, whose travel is a good part of a rotation, exceed it by little.
_USUALLY = {"m": 2.0, "rad": 1.0}


def require_reach(log: Log, machine: Scenario, source: str | None = None) -> None:
    """Refuse a log whose legs are not within reach of the machine's; real ones may exceed their stroke a little.

    Parameters
    ----------
    log
        Commanded and measured coordinates of the legs.
    machine
        Its legs: where they are at home, and their travel.
    source
        File of the log, for messages.

    Raises
    ------
    ScenarioError
        Commands or joints beyond 3 strokes from the middle of the travel at any tick, or beyond 2 (cranks: 1) at half
        of them; lengths that are not above zero. The text has what was expected, and what these numbers may be.
    """
    hexapod, units = _core.Hexapod(core_parameters(machine).robot), leg_units(machine.robot)
    middle, home = np.asarray(hexapod.mid_lengths), np.asarray(hexapod.home_lengths)
    stroke = machine.robot.stroke
    problems = []
    for name in ("commands", "joints"):
        values: Array = getattr(log, name)
        usual = np.median(values, axis=0)
        strokes = np.abs(values - middle) / stroke
        often = np.median(strokes, axis=0)
        leg = int(np.argmax(often))
        if often[leg] > _USUALLY[units.coordinate]:
            got = f"got {number(usual[leg])} (median)"
            guess = next(_guesses(usual, middle, home, stroke, units.coordinate))
        elif strokes.max() > _FARTHEST or (units.coordinate == "m" and values.min() <= 0.0):
            tick, leg = divmod(int(np.argmax(strokes if strokes.max() > _FARTHEST else -values)), 6)
            got = f"got {number(values[tick, leg])} {log.time[tick]:.6g} s after the first tick"
            guess = "is the reading wrong? Take it out, or interpolate it"
        else:
            continue
        problems.append(
            f"{name}: expected {units.name}s of leg {leg + 1} near {number(middle[leg])} {units.coordinate} (travel "
            f"+-{number(stroke)} {units.coordinate}), {got}: {guess}"
        )
    if problems:
        raise ScenarioError(problems, source)


def _guesses(usual: Array, middle: Array, home: Array, stroke: float, unit: str) -> Iterator[str]:
    """Yield what six numbers (6,) may be that are no coordinates of these legs, the likely ones first."""

    def fit(read: Array) -> bool:
        return bool((np.abs(read - middle) <= stroke).all())

    size = float(np.abs(usual).max())
    smaller, name, large = (1e-3, "mm", 10.0 * middle.max()) if unit == "m" else (np.pi / 180.0, "degrees", np.pi)
    if size > large and fit(smaller * usual):
        yield f"are they in {name}?"
    if fit(-usual):
        yield "are their signs reversed?"
    if (np.abs(np.sort(usual) - np.sort(middle)) <= stroke).all():
        yield "are the legs in another order?"
    if unit == "rad" and (usual > 0.0).all() and np.ptp(usual) < 0.5 * size:
        yield "are they lengths in m? The scenario has cranks (robot.legs)"
    if fit(home + usual):
        yield "are they counted from home? The whole coordinate is expected"
    if unit == "m" and (usual < 0.0).any() and size <= np.pi:
        yield "are they angles of cranks? The scenario has prismatic legs (robot.legs)"
    if fit(home + smaller * usual) and not middle.max() / 3.0 < size < 3.0 * middle.max():
        yield f"are they in {name}, and counted from home?"
    yield f"is this a log of the machine in the scenario, in {unit}?"
