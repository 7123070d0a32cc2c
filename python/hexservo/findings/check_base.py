"""Motions of the base that are legal and probably unintended: its tilt and rate, and what its acceleration takes."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hexservo.findings.analysis.scene import Scene
from hexservo.scenario.arrays import Array
from hexservo.scenario.motion import BaseMotion, moves
from hexservo.scenario.wording import number, quantity, vector

_INSTANTS = 2000  # of a run, that are looked at
_TILT = math.radians(45.0)  # of the base: more is seldom meant
_RATE = 2.0  # [rad/s], of the base: more is seldom meant
_START = 1e-3  # of the samples' period, after which the place of a recording has the velocity of its beginning
_NONE = 1e-3  # of the largest component of a velocity, what is written as 0


def of_base(scene: Scene) -> Iterator[str]:
    """Yield a sentence for a base that tilts or turns by more than vehicles do, and for one that legs cannot hold on.

    Before a target in the world legs need not follow the base, so that their forces are looked at on a base that
    carries the target along.
    """
    base = scene.scenario.base_motion
    if moves(base):
        yield from _of_turns(scene, base)
        yield from _of_forces(scene)


def _of_turns(scene: Scene, base: BaseMotion) -> Iterator[str]:
    """Find degrees and other axes."""
    _, attitude, rate, _ = scene.probe.base_motion(_instants(scene, base))
    tilt = float(np.arccos(np.clip(attitude[:, 2, 2], -1.0, 1.0)).max())
    fastest = float(np.linalg.norm(rate, axis=1).max())
    key, radians, axes = _of_rotation(base)
    if tilt > _TILT:
        yield f"{key}: the base tilts by {number(tilt)} rad ({math.degrees(tilt):.0f} deg); check {radians}{axes}"
    elif fastest > _RATE:
        yield (
            f"{key}: the base turns by up to {number(fastest)} rad/s ({math.degrees(fastest):.0f} deg/s); "
            f"check {radians}"
        )


def _of_rotation(base: BaseMotion) -> tuple[str, str, str]:
    """Return the key that turns a base, what to check of it, and what else where it tilts."""
    if base.kind == "road":
        road = "roughness, speed and dimensions of the vehicle (base_motion.road)"
        return "base_motion.road", road, ""
    if base.kind == "recorded" and base.attitudes is not None:
        return (
            "base_motion.attitudes", "that angles and rates in the file are in radians",
            ", and that z points as that of B does",
        )  # fmt: skip
    if base.rotation.kind == "noise":
        return "base_motion.rotation.level", "that it is in rad^2/Hz, and the band of frequencies", ""
    degree = number(math.radians(1.0))
    return "base_motion.rotation.amplitude", f"that it is in radians (1 degree is {degree} rad), and the frequency", ""


def _instants(scene: Scene, base: BaseMotion) -> Array:
    """Return the times at which a base is looked at (n,) [s]: those of the samples of a recording, or of the run."""
    if base.kind == "recorded" and base.samples is not None and base.sample_period is not None:
        return base.sample_period * np.arange(len(base.samples), dtype=float)
    return np.linspace(0.0, scene.scenario.simulation.duration, _INSTANTS + 1)


def _of_forces(scene: Scene) -> Iterator[str]:
    """Find accelerations of the base at which legs at their limit no longer hold the platform at home."""
    limit, unit = scene.scenario.robot.force_limit, scene.units.effort
    if scene.scenario.target.frame == "world" or np.abs(scene.resting_forces(scene.home)).max() > limit:
        return
    time = np.linspace(0.0, scene.scenario.simulation.duration, _INSTANTS + 1)
    home = scene.home.repeated(len(time))
    added = scene.probe.base_wrench(time, home.position, home.quaternion, np.zeros((len(time), 6)))
    wrench = scene.true_weight(scene.home) - added
    by_wrench = np.linalg.inv(scene.wrench_maps(scene.home))
    forces = wrench @ by_wrench.T
    instant, leg = np.unravel_index(int(np.abs(forces).argmax()), forces.shape)
    largest = float(np.abs(forces).max())
    if largest > limit:
        acceleration = float(np.linalg.norm(scene.probe.base_acceleration(time), axis=1).max())
        yield (
            f"robot.force_limit: {number(limit)} {unit} is less than the {number(largest)} {unit} that leg {leg + 1} "
            f"needs to hold the platform at home on the base that moves (base_motion, accelerations of up to "
            f"{number(acceleration)} m/s^2), at {quantity(float(time[instant]), 's')}"
        )


def of_drift(scene: Scene) -> Iterator[str]:
    """Yield a sentence for a recorded base whose double integral ends elsewhere than it began, by more than the band.

    The place of a recording starts and ends in W's origin (docs/model.md, section 7).
    """
    base = scene.scenario.base_motion
    if base.kind != "recorded" or scene.scenario.target.frame != "world" or not scene.has_points:
        return
    if base.samples is None or base.sample_period is None:
        return
    first, short = np.asarray(base.samples[0], dtype=float), _START * base.sample_period
    length = (len(base.samples) - 1) * base.sample_period
    # a base that is at rest at t = 0 has the place a t^2/2 there
    place = scene.probe.base_motion(np.array([short]))[0][0]
    velocity = np.asarray(place / short - first * short / 2.0)
    velocity[np.abs(velocity) < _NONE * np.abs(velocity).max()] = 0.0
    moved = float(np.abs(scene.view(scene.start).jacobian[:, :3] @ velocity).max()) * length
    if moved > scene.band:
        yield (
            f"base_motion.samples: from rest their double integral ends {vector(-1e3 * length * velocity)} mm away, "
            "and the simulated base is made to end where it began (docs/model.md, section 7): "
            f"{vector(1e3 * velocity)} mm/s is added to its velocity in the whole run, which moves the image of the "
            f"target in the world by {number(moved, 2)} px in {quantity(length, 's')}; record until the "
            "base is back where it began, and take out the bias of the accelerometer"
        )
