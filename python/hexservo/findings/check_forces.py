"""Gains that need more of a leg at the start than it has: by the law, by the run's start, by noise."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hexservo.findings.analysis.scene import Scene
from hexservo.findings.bisection import last_that_holds
from hexservo.scenario.arrays import Array
from hexservo.scenario.fitted import auto_of
from hexservo.scenario.parameters import reading_ticks
from hexservo.scenario.pixels import feature_noise
from hexservo.scenario.wording import apart, below, number, quantity, shown_unit

_DEVIATIONS = 3.0  # of the force that noise causes, which a leg should have besides
_HALVINGS = 12  # of the bandwidth, in search of one for which the legs are strong enough
_BISECTIONS = 14  # of the interval of a factor 2 with that bandwidth in it
_SEEN = 0.005  # of a force: a share below it is not named
_ROUNDING = 1.0 + 1e-9
_TWIST = "simulation.start.twist"


class StartForces(NamedTuple):
    """What the legs need at the start, (6,) each [N], of cranks [N m]."""

    weight: Array  # what carries the estimated weight
    law: Array  # what the law commands besides, without noise
    noise: Array  # standard deviation of what noise of camera and joint sensors adds

    @property
    def needed(self) -> Array:
        """Return what each leg needs: the largest force without noise, and three deviations of the noise."""
        return np.asarray(np.abs(self.weight + self.law) + _DEVIATIONS * self.noise)


def of_fitted_forces(scene: Scene, key: str) -> Iterator[str]:
    """Find a bandwidth for which the legs are too weak, and the largest one for which they are not.

    Parameters
    ----------
    scene
        Of a scenario whose motion follows its bandwidth.
    key
        The bandwidth as a sentence names it.
    """
    forces, limit = start_forces(scene), scene.scenario.robot.force_limit
    if forces.needed.max() <= limit:
        return
    bandwidth = auto_of(scene.scenario).bandwidth
    assert bandwidth is not None
    needs = f"{key} {_needed(scene, forces)}"
    most = _largest_bandwidth(scene, bandwidth)
    cause = _cause(scene)
    if most > 0.0:
        besides = f", or for {number(bandwidth)} Hz {cause}" if cause else ""
        yield f"{needs}: enough for {below(most * _ROUNDING)} Hz{besides}"
    else:
        besides = f"; {cause} it is enough" if cause else ""
        yield f"{needs}: too little for any bandwidth{besides}"


def of_written_forces(scene: Scene) -> Iterator[str]:
    """Find gains, defaults or written ones, that need more than the legs have, where nothing limits the forces.

    A true weight that the legs do not carry at home has its own sentence.
    """
    if scene.scenario.actuators.saturation:
        return
    forces, limit = start_forces(scene), scene.scenario.robot.force_limit
    if not _carries_at_home(scene) or not limit < forces.needed.max():
        return
    key = f"controller.{scene.scenario.controller.law}"
    if cause := _cause(scene):
        remedy = f"{cause} it is enough"
    elif weight := of_weight(scene, forces):
        remedy = weight
    elif np.abs(forces.weight + forces.law).max() <= limit:
        remedy = "take lower gains, or less noise of the camera and the joint sensors"
    else:
        remedy = f"{key}.auto.bandwidth fits its gains to the machine"
    yield f"{key}: the law {_needed(scene, forces)}; {remedy}"


@lru_cache(maxsize=8)  # several sentences ask
def start_forces(scene: Scene) -> StartForces:
    """Return the leg forces of the first tick, and how far noise of a frame and of the joints' readings moves them.

    Each source of noise (a coordinate of a feature, a leg's reading, and the one before, of whose difference the twist
    is) moves alone by three deviations either way, since a law is linear neither in its switching term nor in its fuzzy
    inputs. A filter of the camera takes nothing away: it begins with the first frame.
    """
    view, pose = scene.view(scene.start), scene.start
    depth, twist = scene.probe.measured_depth(view.depth[None]), scene.settings[_TWIST]
    moved_features, moved_poses, moved_twist = _noisy(scene, len(view.features))
    count = 1 + 2 * len(moved_features)

    def rows(moves: Array) -> Array:
        return np.concatenate([np.zeros((1, moves.shape[1])), moves, -moves])

    at = pose.moved(rows(moved_poses))
    given = scene.probe.law(
        view.features + rows(moved_features),
        np.repeat(depth, count, axis=0),
        at.position,
        at.quaternion,
        twist + rows(moved_twist),
        None,
    ).wrench
    weight = np.asarray(scene.hexapod.leg_forces(pose.position, pose.quaternion, scene.body.weight(pose.quaternion)))
    whole = np.array([scene.hexapod.leg_forces(pose.position, pose.quaternion, wrench) for wrench in given])
    up, down = np.split(whole[1:], 2)
    deviation = np.linalg.norm((up - down) / (2.0 * _DEVIATIONS), axis=0)
    return StartForces(weight, np.nan_to_num(whole[0] - weight), np.nan_to_num(deviation))


def of_weight(scene: Scene, forces: StartForces) -> str:
    """Return how much the assumed weight takes, and a remedy, as a clause; empty where the legs have it."""
    effort, limit = scene.units.effort, scene.scenario.robot.force_limit
    leg = int(np.abs(forces.weight).argmax())
    assumed, true = (float(abs(of[leg])) for of in (forces.weight, scene.resting_forces(scene.start)))
    if assumed <= limit:
        return ""
    unit, scale = shown_unit(assumed, effort)  # of the larger one
    takes = f"alone takes {apart(assumed * scale, limit * scale, 3)[0]} {unit} of leg {leg + 1}"
    if true > limit:
        return f"the weight {takes} there: take stronger legs{', or another start' if _carries_at_home(scene) else ''}"
    return (
        f"the weight that the law assumes {takes}, the true one {quantity(true, effort)} (uncertainty.gravity): take "
        "stronger legs, or a robot.mass nearer to the true one"
    )


def _carries_at_home(scene: Scene) -> bool:
    return bool(np.abs(scene.resting_forces(scene.home)).max() <= scene.scenario.robot.force_limit)


def _noisy(scene: Scene, coordinates: int) -> tuple[Array, Array, Array]:
    """Return three deviations of each source of noise as moves of features, pose and twist, a row for each source.

    No rows in continuous mode, whose loop has no noise.
    """
    scenario = scene.scenario
    if not scenario.sampled:
        return np.zeros((0, coordinates)), np.zeros((0, 6)), np.zeros((0, 6))
    of_camera = feature_noise(scenario.camera) * np.eye(coordinates)
    of_joints = scene.pose_noise.T  # a row for each leg
    by_time = 0.0 if scenario.sensors.rate is True else 1.0 / (reading_ticks(scenario) * scenario.simulation.step)
    none = np.zeros((6, 6))
    features = np.concatenate([of_camera, np.zeros((12, coordinates))])
    poses = np.concatenate([np.zeros((coordinates, 6)), of_joints, none])
    twists = np.concatenate([np.zeros((coordinates, 6)), by_time * of_joints, -by_time * of_joints])
    return _DEVIATIONS * features, _DEVIATIONS * poses, _DEVIATIONS * twists


def _largest_bandwidth(scene: Scene, bandwidth: float) -> float:
    """Return the largest bandwidth below a given one for which the legs are strong enough; 0 where there is none.

    Searched, since the parts of a force grow with different powers of the bandwidth: the weight and the initial fuzzy
    weights with none, the damping of the start's twist with the first, the spring with the second.
    """
    key, limit = f"controller.{scene.scenario.controller.law}.auto.bandwidth", scene.scenario.robot.force_limit

    def enough(value: float) -> bool:
        try:
            slower = Scene(scene.scenario.updated({key: value}))
        except ValueError:  # a gain, or the bandwidth itself, that no key allows
            return False
        return bool(start_forces(slower).needed.max() <= limit)

    most = bandwidth
    for _ in range(_HALVINGS):
        most, least = 0.5 * most, most
        if enough(most):
            break
    else:
        return 0.0
    return last_that_holds(enough, most, least, _BISECTIONS, logarithmic=True)


def _cause(scene: Scene) -> str:
    """Return the start of the run without which the legs are strong enough, as a clause; empty where there is none."""
    scenario = scene.scenario
    initial = f"controller.{scenario.controller.law}.fuzzy.initial_scale"
    changes = {_TWIST: [0.0] * 6}
    if scenario.controller.traits.memory:
        changes[initial] = [0.0] * 6
    for key, none in changes.items():
        if not np.any(scene.settings[key]):
            continue
        rest = start_forces(Scene(scenario.updated({key: none})))
        if rest.needed.max() <= scenario.robot.force_limit:
            return f"with {key}: 0"
    return ""


def _needed(scene: Scene, forces: StartForces) -> str:
    """Return what the leg that lacks most needs, with the part that noise has in it, and what it has."""
    limit, leg = scene.scenario.robot.force_limit, int(forces.needed.argmax())
    force, noise = float(forces.needed[leg]), _DEVIATIONS * float(forces.noise[leg])
    unit, scale = shown_unit(force, scene.units.effort)  # of the larger one
    needed, available = apart(force * scale, limit * scale, 3)
    parts = ""
    if noise > _SEEN * force:
        alone, besides = (quantity(part, scene.units.effort) for part in (force - noise, noise))
        parts = f" ({alone}, and {besides} for three standard deviations of the noise)"
    return f"needs {needed} {unit} of leg {leg + 1} at the start{parts}, which has {available} {unit}"
