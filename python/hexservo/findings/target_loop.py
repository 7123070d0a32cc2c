"""How far a law leaves the image of a target that moves from its goal, by the linear loop."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.linear_law import NoRestError
from hexservo.findings.analysis.linear_loop import BORDER
from hexservo.findings.analysis.loop_of_scenario import (
    LoopAtRest,
    NotApplicableError,
    clock_of,
    loop_at_rest,
    loop_before_moving_target,
    rates_without_mass,
    side_of_target,
)
from hexservo.findings.analysis.scene import Scene, View
from hexservo.findings.target_path import TargetPath, path_at
from hexservo.scenario.arrays import Array
from hexservo.scenario.motion import moves
from hexservo.scenario.rotations import quaternions_of_matrices, unit_rotation_vectors

_MOST = 20_000  # patterns of the loop's clocks, or ticks, that are looked at
_PARTS = 8  # of a pattern, at which the image is looked at
_TURN = 0.2  # [rad] of the response of the legs in a step of its integration


@dataclass(frozen=True, eq=False)
class Left:
    """Features beyond the goal in a run that starts at the goal (n, 2p) [px], at times that are evenly apart."""

    followed: Array  # by the law
    still: Array  # by a platform that stays where it is


def left_of_target(scene: Scene) -> Left | None:
    """Return how far the image of a target that moves is from its goal; None where no linear loop is stable there.

    Of a machine that takes forces the loop is that of `loop_at_rest`, of one that takes positions that of a law whose
    output is a twist. Noise, faults and limits do not act.
    """
    scenario = scene.scenario
    try:
        if scenario.actuators.takes_positions:
            return _left_by_twist(scene) if scenario.moves_without_mass else None
        return _left_by_loop(scene, loop_at_rest(scenario))
    except (NotApplicableError, NoRestError):
        return None


def _left_by_loop(scene: Scene, at_rest: LoopAtRest) -> Left | None:
    """Return it at parts of each pattern of the loop's clocks; the wrench of a base that moves acts too, by its mean.

    Linear about the pose of rest, with K_v = 0 where it has no slope there.
    """
    clock, view = clock_of(at_rest.scenario), at_rest.rest.view
    loop = loop_before_moving_target(at_rest, np.eye(6))
    state_matrix, by_inputs = loop.driven(clock)
    if np.abs(np.linalg.eigvals(state_matrix)).max() > BORDER:
        return None
    seconds = loop.seconds(clock)
    count = min(int(scene.scenario.simulation.duration / seconds) + 1, _MOST)
    time = seconds / _PARTS * np.arange(_PARTS * count, dtype=float)
    wrench = np.zeros((len(time), 6))
    if moves(scene.scenario.base_motion):
        rest = view.pose.repeated(len(time))
        wrench = scene.probe.base_wrench(time, rest.position, rest.quaternion, wrench)
    moved = _displacement_about(path_at(scene, time), view.pose.position)
    driven = np.hstack([wrench.reshape(count, _PARTS, 6).mean(axis=1), moved[::_PARTS]]) @ by_inputs.T
    motion, state = np.empty((count, 12)), np.zeros(len(state_matrix))
    for instant, more in enumerate(driven):
        motion[instant] = state[:12]
        state = state_matrix @ state + more
    return _left(scene, view, _between(motion, seconds), moved[: _PARTS * (count - 1)])


def _between(motion: Array, seconds: float) -> Array:
    """Return displacements at parts of each pattern, by cubics, from displacement and rate at its ends, (n, 12)."""
    share = np.arange(_PARTS)[None, :, None] / _PARTS
    (x, v), (x_next, v_next) = (np.split(ends[:, None], 2, axis=2) for ends in (motion[:-1], motion[1:]))
    way, along = x_next - x, seconds * v
    bend = 3.0 * way - seconds * (2.0 * v + v_next)
    cubic = seconds * (v + v_next) - 2.0 * way
    return np.asarray(x + share * (along + share * (bend + share * cubic))).reshape(-1, 6)


def _left_by_twist(scene: Scene) -> Left | None:
    """Return it at the ticks, of a law that drives a platform without mass, which the legs follow.

    The target is where the newest frame has it; without prediction by the way of the legs since its exposure too
    (docs/model.md, section 7).
    """
    goals = find_goals(scene)
    if goals is None:
        return None
    view, rates = goals.best.view, rates_without_mass(scene.scenario, goals.best.view.pose)
    scenario, tick = scene.scenario, scene.scenario.simulation.step
    clock, response = clock_of(scenario), scenario.actuators.position
    delay, predicts = round(scenario.actuators.delay / tick), scenario.camera.prediction == "encoder"
    count = min(int(scenario.simulation.duration / tick) + 1, _MOST)
    moved = _displacement_about(path_at(scene, tick * np.arange(count, dtype=float)), view.pose.position)
    w = 2.0 * math.pi * response.bandwidth
    parts = math.ceil(w * tick / _TURN)
    commanded, reached = np.zeros((count, 6)), np.zeros((count, 6))
    legs, legs_rate = np.zeros(6), np.zeros(6)
    for k in range(count - 1):
        exposed = max(0, (k - clock.latency) // clock.period * clock.period)
        target = moved[exposed] if k >= clock.latency else moved[0]
        if not predicts:
            target = target + reached[k] - reached[exposed]
        commanded[k + 1] = commanded[k] + tick * (rates @ (commanded[k] - target))
        goal = commanded[max(0, k + 1 - delay)]
        for _ in range(parts):
            legs_rate = legs_rate + tick / parts * (w**2 * (goal - legs) - 2.0 * response.damping * w * legs_rate)
            legs = legs + tick / parts * legs_rate
        reached[k + 1] = legs
    return _left(scene, view, reached, moved)


def _left(scene: Scene, view: View, platform: Array, moved: Array) -> Left:
    target = side_of_target(scene.scenario) * moved
    return Left((platform - target) @ view.jacobian.T, -target @ view.jacobian.T)


def _displacement_about(path: TargetPath, origin: Array) -> Array:
    """Return the displacements of a target as a rigid body, in B about a point (3,), (n, 6) [m; rad]."""
    place = path.places(origin) - origin
    turn = unit_rotation_vectors(quaternions_of_matrices(path.attitude))
    return np.concatenate([place, -turn], axis=1)
