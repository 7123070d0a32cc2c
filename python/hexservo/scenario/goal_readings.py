"""Other readings of a goal image, of which one may be meant: orders of its points, and pixels that count otherwise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import TYPE_CHECKING

import numpy as np

from hexservo import _core
from hexservo.scenario.arrays import Array
from hexservo.scenario.parameters import Settings, core_settings
from hexservo.scenario.rotations import conjugate, quaternion_product, unit_rotation_vectors
from hexservo.scenario.wording import number, quantity

if TYPE_CHECKING:
    from hexservo.scenario.blocks import Blocks, Camera

_ALL_ORDERS = 4  # points, of which every order is tried; of more those that go around
_MOST_TURNED = np.pi / 2.0  # [rad], from home: a goal that is meant shows the target's front
_ALIKE = 0.01  # [px], difference of two readings that fit alike
_FITS = 2.0  # [px], largest error of an image that counts as that of a pose: points are detected that well


@dataclass(frozen=True)
class Reading:
    """What the numbers of a goal image may mean, and the goal within the stroke that it has then."""

    words: str  # what is read otherwise
    pixels: Array  # (2p,) [px], as `target.desired_features`
    residual: float  # largest error at its pose [px]
    shift: float  # of the goal from home [m]
    turn: float  # likewise [rad]


def best_readings(scenario: Blocks) -> list[Reading]:
    """Return the readings of a goal image with which a pose within the stroke shows it best: none, or a few.

    Of one change, the order of the points or how pixels count, or of both where one alone finds none. A symmetric
    target may have two: the mirrored image of a square is the image of the square with its points mirrored.
    """
    target = scenario.target
    given = np.asarray(target.desired_features, dtype=float).reshape(-1, 2)
    if scenario.camera.convention != "eye_in_hand" or given.shape != (target.count, 2):
        return []
    counted, around = _counted(scenario.camera, given), _around(len(given))
    every = list(permutations(range(len(given)))) if len(given) <= _ALL_ORDERS else around
    both = [(f"{how} and {order}", pixels) for how, one in counted for order, pixels in _ordered(one, around)]
    for group in ([*counted, *_ordered(given, every)], both):
        found = [reading for words, pixels in group if (reading := _reading(scenario, words, pixels)) is not None]
        if found:
            least = min(reading.residual for reading in found)
            return [reading for reading in found if reading.residual <= least + _ALIKE]
    return []


def question(readings: Sequence[Reading]) -> str:
    """Return which of some readings may be meant, as a clause; the goal that they have is that of the first."""
    first = readings[0]
    return (
        f"{', or '.join(reading.words for reading in readings)}, the goal would be within reach, "
        f"{quantity(first.shift, 'm')} and {number(round(float(np.rad2deg(first.turn)), 9))} deg from home: "
        "do the points stand in the order of the target's, and do pixels count as docs/camera.md has it?"
    )


def _counted(camera: Camera, given: Array) -> list[tuple[str, Array]]:
    """Return the pixels (p, 2) as they would be if they counted otherwise than the camera's do, with what is taken."""
    down, up = "down (camera.axes: opencv)", "up (camera.axes: paper)"
    if camera.axes == "opencv":
        down, up = up, down
    flip = np.array([1.0, -1.0])
    if camera.principal_point is not None:
        middle = np.asarray(camera.principal_point)
        centred = [("counted from the principal point", given + middle)]
        found = [(f"with v pointing {down}", (given - middle) * flip + middle)]
        return [*found, *centred, (f"{centred[0][0]} with v pointing {down}", given * flip + middle)]
    found = [(f"with v pointing {down}", given * flip)]
    if camera.image_size is not None:
        off = given - (np.asarray(camera.image_size) - 1.0) / 2.0
        corner = "counted from the first pixel of the image"
        found += [(f"{corner} with v pointing {up}", off), (f"{corner} with v pointing {down}", off * flip)]
    return found


def _around(count: int) -> list[tuple[int, ...]]:
    """Return the orders of points that go around, either way."""
    return [tuple(np.roll(np.arange(count)[::step], shift).tolist()) for step in (1, -1) for shift in range(count)]


def _ordered(given: Array, orders: Sequence[tuple[int, ...]]) -> Iterator[tuple[str, Array]]:
    """Yield the pixels (p, 2) in other orders, with their words: the numbers are those of the given points."""
    for order in orders:
        if order != tuple(range(len(given))):
            yield f"with its points in the order {' '.join(str(1 + point) for point in order)}", given[list(order)]


def _reading(scenario: Blocks, words: str, pixels: Array) -> Reading | None:
    settings = core_settings(scenario)
    settings["target.desired_features"] = pixels.ravel()
    try:
        probe = _core.Probe(settings)
    except ValueError:  # no pose shows them, where the law needs one
        return None
    found = _nearest(settings, probe, settings.camera.features(pixels).ravel())
    return None if found is None else Reading(words, pixels.ravel(), *found)


def _nearest(settings: Settings, probe: _core.Probe, features: Array) -> tuple[float, float, float] | None:
    """Return residual [px], shift [m] and turn [rad] of the pose within the stroke that shows features best."""
    hexapod = _core.Hexapod(settings.robot)
    home = conjugate(np.asarray(hexapod.home_quaternion))
    best = None
    for position, quaternion in zip(*probe.goal_minima(), strict=True):
        image, depth = probe.image(position[None], quaternion[None])
        residual = float(np.abs(image[0] - features).max())
        travel = np.asarray(hexapod.leg_travel(position, quaternion))
        within = (np.abs(travel) <= settings["robot.stroke"]).all()
        turn = float(np.linalg.norm(unit_rotation_vectors(quaternion_product(quaternion, home))))
        if (depth < 0.0).all() and within and residual <= _FITS and turn < _MOST_TURNED:
            shift = float(np.linalg.norm(position - hexapod.home_position))
            best = min(best or (np.inf, 0.0, 0.0), (residual, shift, turn))
    return best
