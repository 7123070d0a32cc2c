"""Numbers of a machine that are legal and probably not its own: units, crossed legs, a camera's view, a large load."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from hexservo.findings.analysis.scene import Scene
from hexservo.scenario.arrays import Array
from hexservo.scenario.unit_slips import far_home, joint_radius
from hexservo.scenario.wording import number, quantity

_CROSSED = 1e-3  # of the shortest leg, a distance of two legs that no two legs with a width have
_INSIDE = 0.01  # of its length from its ends, a place inside a leg: at the ends legs may share a joint
_WIDEST = 120.0  # [deg], view across the diagonal of a lens that is no fisheye
_LOAD = 0.2  # of the weight that the controller assumes, a load that it does not know
_MICROSCOPIC = 2e-3  # [m]: no platform with its home is that small
_GIGANTIC = 20.0  # [m]: no joints are that far from the middle, and no platform from its base
_COMPACT = 0.005  # of the platform's radius, a radius of gyration of a body that is no point between its joints
_DENSE = 0.03  # of the same, one that a body with a mass of 1000 times has, as one in g
_AT_ONCE = 0.02  # [s], in which no leg of a machine crosses its whole travel
_SPREAD = 10.0  # times the platform's radius, a radius of gyration that no body on its joints has
_TURNED = 0.2  # [rad], an attitude of the camera that is wrong by more than a hand-eye calibration leaves


def of_machine(scene: Scene) -> Iterator[str]:
    """Yield a sentence for each number of the machine that is probably not meant.

    Parameters
    ----------
    scene
        Of the scenario.
    """
    yield from _of_size(scene)
    yield from _of_inertia(scene)
    yield from _of_speed_limits(scene)
    yield from _of_mount_errors(scene)
    yield from _of_crossed_legs(scene)
    yield from _of_view(scene)
    yield from _of_load(scene)


def _of_size(scene: Scene) -> Iterator[str]:
    """Find metres that were given for millimetres, and millimetres for metres."""
    radius, height = scene.platform_radius, float(np.linalg.norm(scene.home.position))
    joints = joint_radius(scene.scenario.robot)
    if max(radius, height) < _MICROSCOPIC:
        yield (
            f"robot: a platform of {quantity(radius, 'm')} radius, {quantity(height, 'm')} from the base at home, is "
            "very small; are its numbers in the unit that is asked for (metres in a file, mm in `hexservo new`)?"
        )
    far = far_home(scene.scenario.robot)
    if far is not None and joints < _MICROSCOPIC:
        yield (
            f"robot: joints {quantity(joints, 'm')} from the middle, with home {quantity(height, 'm')} from the base, "
            "are very near to it; are they in the unit that is asked for (metres in a file, mm in `hexservo new`)?"
        )
    elif far is not None:
        yield f"robot.home_position: {far}"
    elif max(joints, height) > _GIGANTIC:
        yield (
            f"robot: joints {quantity(joints, 'm')} from the middle, with home {quantity(height, 'm')} from the base, "
            f"are a very large machine; lengths are in metres: in mm these would be {quantity(joints / 1e3, 'm')} and "
            f"{quantity(height / 1e3, 'm')}"
        )


def _of_inertia(scene: Scene) -> Iterator[str]:
    """Find lengths and moments of inertia in units that do not belong together."""
    body, radius = scene.body, scene.platform_radius
    moments = np.linalg.eigvalsh(np.asarray(body.inertia))
    smallest, largest = float(moments.min()), float(moments.max())
    gyration, widest = (float(np.sqrt(max(moment, 0.0) / body.mass)) for moment in (smallest, largest))
    payload = scene.scenario.robot.payload
    together = ", of platform and payload," if payload.known and payload.mass > 0.0 else ""
    limit = scene.scenario.robot.force_limit
    carried = float(np.abs(scene.resting_forces(scene.home)).max())
    if _COMPACT * radius <= gyration < _DENSE * radius and 1e-3 * carried < limit < carried:
        yield (
            f"robot.mass: {number(body.mass)} kg{together} with {number(smallest)} kg m^2 is a radius of gyration of "
            f"{quantity(gyration, 'm')}, {gyration / radius:.1%} of the platform's radius, and more than "
            f"robot.force_limit carries; masses are in kg: in g it would be {number(1e-3 * body.mass)} kg"
        )
    if gyration < _COMPACT * radius:
        yield (
            f"robot.inertia: {number(smallest)} kg m^2 with {number(body.mass)} kg{together} is a radius of gyration "
            f"of {quantity(gyration, 'm')}, less than {_COMPACT:.1%} of the platform's radius, "
            f"{quantity(radius, 'm')}; lengths are in metres, masses in kg, moments of inertia in kg m^2"
        )
    if widest > _SPREAD * radius:
        yield (
            f"robot.inertia: {number(largest)} kg m^2 with {number(body.mass)} kg{together} is a radius of gyration "
            f"of {quantity(widest, 'm')}, more than {_SPREAD:.0f} times the platform's radius, "
            f"{quantity(radius, 'm')}; moments of inertia are in kg m^2: from kg mm^2 it would be "
            f"{number(1e-6 * largest)} kg m^2"
        )


def _of_speed_limits(scene: Scene) -> Iterator[str]:
    """Find speeds in mm/s or degrees per second."""
    robot, units, small = scene.scenario.robot, scene.units, "mm/s"
    scale = 1e-3
    if scene.hexapod.rotary:
        small, scale = "deg/s", float(np.deg2rad(1.0))
    limits = {"robot.speed_limit": robot.speed_limit}
    if scene.scenario.actuators.kind != "force":
        limits["actuators.position.speed_limit"] = scene.scenario.actuators.position.speed_limit
    travel = 2.0 * scene.stroke
    for key, limit in limits.items():
        if limit is not None and limit * _AT_ONCE > travel:
            yield (
                f"{key}: with {quantity(limit, units.rate)} a leg crosses its whole travel, "
                f"{quantity(travel, units.coordinate)}, in {quantity(travel / limit, 's')}; speeds are in "
                f"{units.rate}: in {small} it would be {quantity(scale * limit, units.rate)}"
            )


def _of_mount_errors(scene: Scene) -> Iterator[str]:
    """Find errors of the hand-eye calibration in degrees or millimetres."""
    error, joints = scene.scenario.uncertainty.mount, joint_radius(scene.scenario.robot)
    turn, shift = (float(np.linalg.norm(vector)) for vector in (error.rotation, error.position))
    if turn > _TURNED:
        yield (
            f"uncertainty.mount.rotation: {number(turn)} rad is an error of {number(np.rad2deg(turn))} degrees; "
            f"rotations are in rad: 1 degree is {number(np.deg2rad(1.0))} rad"
        )
    if shift > joints:
        yield (
            f"uncertainty.mount.position: {quantity(shift, 'm')} is more than the {quantity(joints, 'm')} from the "
            f"middle to the joints; lengths are in metres: in mm it would be {quantity(shift / 1e3, 'm')}"
        )


def _of_crossed_legs(scene: Scene) -> Iterator[str]:
    home = scene.home
    feet = np.asarray(scene.hexapod.leg_feet(home.position, home.quaternion))
    ways = home.carried(np.asarray(scene.hexapod.platform_joints)) - feet  # of rotary legs the rods
    shortest = float(np.linalg.norm(ways, axis=1).min())
    crossed = [
        f"{one + 1} and {other + 1}"
        for one, other in combinations(range(6), 2)
        if _crossing(feet[one], ways[one], feet[other], ways[other]) < _CROSSED * shortest
    ]
    if crossed:
        yield (
            f"robot: legs {', '.join(crossed)} cross at home; are the joints of base and platform with the same number "
            "those of the same leg?"
        )


def _crossing(foot: Array, way: Array, other_foot: Array, other_way: Array) -> float:
    """Return the distance of two segments [m] where they are nearest inside of both; infinite where they are not."""
    normal = np.cross(way, other_way)
    square = float(normal @ normal)
    if square <= 1e-24 * float(way @ way) * float(other_way @ other_way):  # parallel
        return np.inf
    between = other_foot - foot
    places = np.array([np.cross(between, other_way) @ normal, np.cross(between, way) @ normal]) / square
    inside = (places > _INSIDE).all() and (places < 1.0 - _INSIDE).all()
    return float(abs(between @ normal) / np.sqrt(square)) if inside else np.inf


def _of_view(scene: Scene) -> Iterator[str]:
    """Find a focal length in other units than pixels."""
    camera = scene.scenario.camera
    if camera.image_size is None or camera.distortion.kannala_brandt is not None:
        return
    given = camera.focal_pixels
    focal = np.broadcast_to(scene.camera.focal_pixels if given is None else given, 2)
    view = float(np.rad2deg(2.0 * np.arctan(np.linalg.norm(np.asarray(camera.image_size) / (2.0 * focal)))))
    if view > _WIDEST:
        key = "camera.focal_length" if given is None else "camera.focal_pixels"
        yield (
            f"{key}: {number(focal[0])} px sees {number(view)} degrees across the image's diagonal; fx of a camera "
            "matrix is in pixels, the focal length divided by the pixel pitch"
        )


def _of_load(scene: Scene) -> Iterator[str]:
    if not scene.scenario.has_unknown_payload or not np.any(scene.scenario.robot.gravity):
        return
    if scene.scenario.actuators.kind == "position":  # legs that follow whatever it takes
        return
    load, known = scene.scenario.robot.payload.mass, scene.body.mass
    if load > _LOAD * known:
        yield (
            f"robot.payload.known: false with a load of {number(load)} kg, {load / known:.0%} of the "
            f"{number(known)} kg that the controller assumes; its weight is an error that the law has to hold"
        )
