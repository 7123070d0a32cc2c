"""The brake of the safe output: whether it is stable, compared with the forces that the legs have, and in a run."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from hexservo.findings.analysis.scene import Scene
from hexservo.findings.brake import Brake, BrakeLoop
from hexservo.run.result import Result
from hexservo.run.simulation import simulate
from hexservo.scenario.arrays import Array
from hexservo.scenario.keys import value_at
from hexservo.scenario.parameters import reading_ticks
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import below, number, quantity

_MOST_STEPS = 100_000  # of a run that is judged
_OF_FORCE = 0.8  # of what the legs have beside the weight: what the proposed gains need
_OF_BORDER = 0.99  # of the largest stable gains, so that they are still stable in three digits
_LATE = 1.5  # periods
_DAMPING, _HOLD = "controller.safe.damping", "controller.safe.hold"


def of_brake(scene: Scene, period: float | None = None) -> Iterator[str]:
    """Yield a sentence for a brake that is unstable, that ends a run, or that needs more of a leg than it has.

    Stability is that of the linear loop of the core's tick without an image and the plant, at home (`BrakeLoop`). A
    brake ends a run which the derived gains do not end. Forces are compared with `robot.force_limit` at the largest
    speed of the run, which is simulated, and at rest for one step of `sensors.resolution` in one reading, which rates
    by differences take for a speed. They are those of the tick without an image, at home. Gains that fit are slower
    ones of the form of the derived ones.

    Parameters
    ----------
    scene
        Of a scenario. Drives that take positions stop within their own limits, and a run that ends early with the
        derived gains too has no speed to compare.
    period
        Time between two ticks [s]; None: the scenario's ``simulation.step``.
    """
    scenario = scene.scenario
    if scenario.actuators.takes_positions:
        return
    period = scenario.simulation.step if period is None else period
    brake = Brake(scene, period)
    written = [key for key in (_DAMPING, _HOLD) if value_at(scenario, key) is not None]
    if any(np.any(value_at(scenario, key)) for key in written) or len(written) < 2:  # zeros only let the platform move
        loop = BrakeLoop(scene, brake)
        if not loop.stable:
            yield _unstable(scenario, loop, written, period)
            return
    run = judged_run(scenario)
    if run.outcome != "completed" and written:
        derived = judged_run(scenario.updated({_DAMPING: None, _HOLD: None}))
        if derived.outcome == "completed":
            yield (
                f"controller.safe: with these gains of the brake a run ends as {run.outcome} ({run.detail}), and with "
                f"the derived ones (null for {' and '.join(written)}) it does not"
            )
            run = derived
    yield from _of_forces(scene, brake, run)


def _unstable(scenario: Scenario, loop: BrakeLoop, written: list[str], period: float) -> str:
    """Return that a brake is unstable, with the largest share of the written gains that is not, as of a faster one."""
    powers = {_DAMPING: 1 if _DAMPING in written else 0, _HOLD: len(written) if _HOLD in written else 0}
    grows = (
        f"controller.safe: the brake is unstable: without an image a motion grows by "
        f"{number(100.0 * (loop.growth() - 1.0), 2)} % from one servo period, {quantity(period, 's')}, to the next"
    )
    if not written:
        return f"{grows}; its gains are those of the estimated inertia, of which uncertainty.inertia leaves too little"
    damping, hold = value_at(scenario, _DAMPING), value_at(scenario, _HOLD)
    undamped = damping is not None and np.any((np.asarray(damping) == 0.0) & (hold is None or np.asarray(hold) > 0.0))
    share = None if undamped else loop.largest_share(powers[_DAMPING], powers[_HOLD])
    if share is None:
        cause = "since a hold without damping is, " if undamped else ""
        return f"{grows}, {cause}with any share of these gains; null for {' and '.join(written)} derives stable ones"
    gains = {key: _OF_BORDER * share ** powers[key] * np.broadcast_to(value_at(scenario, key), 6) for key in written}
    return f"{grows}; stable up to about {_pasted(gains)}, and null derives gains with a margin"


def _pasted(gains: Mapping[str, Iterable[float]]) -> str:
    return " and ".join(f"{key}=[{','.join(number(each, 3) for each in values)}]" for key, values in gains.items())


def _of_forces(scene: Scene, brake: Brake, run: Result) -> Iterator[str]:
    scenario = scene.scenario
    limit, units = scenario.robot.force_limit, scene.units
    if np.abs(brake.weight).max() > limit:  # has its own sentence
        return
    moving, reading = _fastest_twists(brake, run), _twists_of_a_step(scene, brake.period)
    problems = []
    for twists, words in (
        (moving, "at the largest speed of a run, {}"),
        (reading, f"at rest for a sensors.resolution of {quantity(scenario.sensors.resolution, units.coordinate)}"),
    ):
        needed = np.abs(brake.forces(twists)).max(axis=0)
        leg = int(needed.argmax())
        if needed[leg] > limit:
            speed = quantity(float(np.abs(brake.rates(twists)).max()), units.rate)
            problems.append(f"{quantity(float(needed[leg]), units.effort)} of leg {leg + 1} {words.format(speed)}")
    if problems:
        yield (
            f"controller.safe: the brake needs {' and '.join(problems)}; a leg has {quantity(limit, units.effort)} "
            f"(robot.force_limit). {_remedy(scene, brake, moving, reading)}"
        )


def judged_run(scenario: Scenario) -> Result:
    """Return the run of a scenario, or its first 100 000 steps."""
    longest = _MOST_STEPS * scenario.simulation.step
    shorter = {"simulation.duration": longest} if scenario.simulation.duration > longest else {}
    return simulate(scenario.updated(shorter))


def _remedy(scene: Scene, brake: Brake, moving: Array, reading: Array) -> str:
    """Return gains of the brake that the legs have the forces for, as a sentence without its full stop."""
    inertia, units = scene.machine.mass, scene.units
    axes = np.diag(inertia)
    # A diagonal that is nowhere below the inertia: no motion of coupled axes is less than critically damped.
    axes = axes * float(np.linalg.eigvals(inertia / axes[:, None]).real.max())

    def gains(rate: float) -> dict[str, list[float]]:
        damping, hold = ([float(f"{each:.3g}") for each in values] for values in (2.0 * rate * axes, rate**2 * axes))
        return {_DAMPING: damping, _HOLD: hold}

    def fastest_pole(of: Brake) -> float:
        return float(np.abs(np.linalg.eigvals(np.linalg.solve(inertia, of.wrenches))).max())

    slow = Brake(scene, brake.period, gains(1.0))  # of 1 rad/s, to which damping and forces are in proportion
    both = (moving[:, None] + reading).reshape(-1, 6)
    share = _OF_FORCE * slow.share(both, scene.scenario.robot.force_limit)
    rate = float(below(min(share, fastest_pole(brake) / fastest_pole(slow)), 2))
    # of critically damped axes, after the time by which differences of readings and the tick are late
    way = float(np.abs(brake.rates(moving)).max()) * (1.0 / (math.e * rate) + _LATE * brake.period)
    if way > scene.stroke:
        return (
            f"Gains that need less stop the legs within {quantity(way, units.coordinate)}, and the stroke has "
            f"{quantity(scene.stroke, units.coordinate)} either way: take a slower law"
        )
    fitting = gains(rate)
    needed = float(np.abs(Brake(scene, brake.period, fitting).forces(both)).max())
    stops = f", and the legs stop within {quantity(way, units.coordinate, 2)}" if way > 0.0 else ""
    return f"With {_pasted(fitting)} it needs {quantity(needed, units.effort)}{stops}"


def _fastest_twists(brake: Brake, run: Result) -> Array:
    """Return those twists of a run at which a leg needs most, each way, (n, 6); rest where it ends early."""
    if run.outcome != "completed":
        return np.zeros((1, 6))
    twists = np.asarray(run.twist)
    forces = brake.forces(twists)
    return np.asarray(twists[np.unique([forces.argmax(axis=0), forces.argmin(axis=0)])])


def _twists_of_a_step(scene: Scene, period: float) -> Array:
    """Return the twists (n, 6) that rates by differences have for one step of one leg's reading; rest without."""
    sensors = scene.scenario.sensors
    if sensors.pose != "encoders" or sensors.rate is True:
        return np.zeros((1, 6))
    between = period * reading_ticks(scene.scenario, period)
    twists = np.linalg.inv(scene.wrench_maps(scene.home)) * sensors.resolution / between
    return np.vstack([twists, -twists])
