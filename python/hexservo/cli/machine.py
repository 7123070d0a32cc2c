"""The command ``hexservo new``: questions about a machine, and the scenario file that the answers make."""

from __future__ import annotations

import math
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

import hexservo as hs
from hexservo.cli.cranks import ask_cranks
from hexservo.cli.dialogue import Check, Dialogue, one_number
from hexservo.cli.loop import ask_loop
from hexservo.cli.parts import problem_of_image, require_hold
from hexservo.cli.terminal import complain, errors_as_messages, interrupted, write
from hexservo.cli.units import DEGREE, LEAST_LENGTH, metres, radians, rounded
from hexservo.scenario.leg_travel import of_lengths
from hexservo.scenario.rules import LEAST_POINTS, MOST_POINTS, Name

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

    from hexservo.findings.analysis.workspace import Reach

_TITLE = "# Made by `hexservo new --machine`."
_TURN, _HALF_TURN = 360.0, 180.0  # [deg], magnitudes of an angle, and of a crank's travel
_APART = (0.001, 119.999)  # [deg], of two joints in a pair: at 120 they would meet those of the next ones
_RESOLUTION = 1e-9  # [mm] or [deg], of an encoder, at least
_OF_TRAVEL = 1e-4  # of the travel, resolution of an encoder that is not given
_MASS = 1e-4  # [kg], at least
_EFFORTS = (1e-9, 1e9)  # [N] or [N m]
_INERTIA = 1e10  # [kg m^2], at most
_POINT = 1e6  # [mm], magnitude of a coordinate of a point: as far as home, camera and distance together, and more
_RATES = (0.1, 1e4)  # [1/s], of the camera
_PRODUCTS = ([0, 0, 1], [1, 2, 2])  # places of xy, xz, yz in an inertia


def new(
    machine: Annotated[str, typer.Option("--machine", metavar="FILE", help="YAML file to write, a new file.")],
    force: Annotated[bool, typer.Option("--force", "-f", help="Replace a file of an earlier `hexservo new`.")] = False,
) -> None:
    """Write a scenario from the numbers of a data sheet.

    Asks for them one by one.

    Enter takes the answer in brackets. Each answer is checked at once, and answers that do not fit one another are
    asked again, with what was answered in the brackets. Without a terminal, answers are read from standard input, one
    a line, and the first that is wrong ends the command. The file appears whole or not at all.
    """
    with errors_as_messages():
        from hexservo.run.files import check_file, write_file

        name = _checked_name(machine)
        check_file(machine, _TITLE, "`hexservo new`", force=force)
        try:
            text = _fitting_text(Dialogue(sys.stdin is not None and sys.stdin.isatty()), name)
        except (EOFError, typer.Abort):
            raise hs.ScenarioError(["expected an answer to every question, got the end of standard input"]) from None
        except KeyboardInterrupt:
            interrupted(f"{machine} was not written")
        write_file(text, machine, _TITLE, "`hexservo new`", force=force)
        quoted = shlex.quote(machine)
        commands = f"hexservo check {quoted}\n  hexservo report {quoted} --out {shlex.quote(f'{name}.html')}"
        write(f"\n{machine} is written. Next:\n\n  {commands}\n")


def _checked_name(file: str) -> str:
    """Return the name of the scenario in a file, refused before the first question rather than after the last."""
    name, rule = Path(file).stem, Name()
    try:
        return rule.accept(name)
    except ValueError:
        raise hs.ScenarioError(
            [f'--machine: expected a file with {rule.expected} before the ending, got "{name}"']
        ) from None


def _fitting_text(dialogue: Dialogue, name: str) -> str:
    """Return the text of a file that loads; at a terminal the questions come again until the answers fit."""
    while True:
        try:
            return _scenario_text(dialogue, name)
        except hs.ScenarioError as error:
            if not dialogue.interactive:
                raise
            problem = str(error)
        complain(problem, head="Again")
        dialogue.say("\nThe questions again, with your answers in the brackets: Enter keeps one.\n")


def _scenario_text(dialogue: Dialogue, name: str) -> str:
    """Return the text of a file that loads, from all answers."""
    from scipy.spatial.transform import Rotation

    from hexservo.scenario.yaml import dump_yaml

    dialogue.say("Lengths in mm, angles in degrees. z of the base frame points down: above the base it is negative.")
    robot = _robot(dialogue)
    camera, period, looks = _camera(dialogue)
    home = Rotation.from_rotvec(robot.get("home_attitude", [0.0] * 3))
    place = np.add(robot["home_position"], home.apply(camera["mount"]["position"]))
    focal = float(np.max(camera["focal_pixels"]))
    target = _target(dialogue, place, home * looks, camera["image_size"], focal)
    machine = {
        "name": name,
        "description": "A machine from its data sheet",
        "robot": robot,
        "camera": camera,
        "target": target,
    }
    loop = ask_loop(dialogue, period, rotary="cranks" in robot)
    machine["sensors"] = _encoders(dialogue, robot)
    document, scenario = loop.scenario(dialogue, machine)
    _explain(dialogue, scenario)
    return (
        f"{_TITLE}\n# Keys that are not here have their defaults, which `hexservo show` lists.\n{dump_yaml(document)}"
    )


def _robot(dialogue: Dialogue) -> dict[str, Any]:
    robot: dict[str, Any] = {}
    rotary = dialogue.choice("Legs: of variable length, or cranks with rods", ("prismatic", "rotary")) == "rotary"
    form = dialogue.choice("Joints of the legs: on circles, in pairs, or given one by one", ("circles", "joints"))
    if form == "circles":
        for side, radius, apart in (("platform", 100.0, 20.0), ("base", 150.0, 20.0)):
            robot[f"{side}_radius"] = 1e-3 * dialogue.number(
                f"Radius of the {side} joints' circle [mm]", radius, LEAST_LENGTH
            )
            angle = DEGREE * dialogue.number(f"Angle between the two {side} joints of a pair [deg]", apart, *_APART)
            robot[f"{side}_angles"] = [rounded(value) for value in _pairs(side, angle)]
        dialogue.say("Pairs of the base are about 0, 120 and 240 deg, pairs of the platform halfway between.")
    else:
        for side in ("platform", "base"):
            robot[f"{side}_joints"] = [
                metres(dialogue.numbers(f"Joint {leg} in the {side} frame: x y z [mm]", text, 3))
                for leg, text in enumerate(_default_joints(side), start=1)
            ]
    home = dialogue.numbers("Home of the platform frame in the base: x y z [mm]", "0 0 -160", 3)
    robot["home_position"] = metres(home)
    attitude = radians(
        dialogue.numbers("Its attitude there: about x y z, axis times angle [deg]", "0 0 0", 3, within=_TURN)
    )
    if any(attitude):
        robot["home_attitude"] = attitude
    if rotary:
        robot |= {"legs": "rotary", "cranks": ask_cranks(dialogue, robot)}
        require_hold(robot)
        travel = dialogue.numbers(
            "Travel of a crank from home: least largest [deg]", "-40 40", 2, _about_home, within=_HALF_TURN
        )
        robot["stroke"] = radians(travel)
    else:
        lengths = 1e3 * require_hold(robot)

        def fits(travel: list[float]) -> str | None:
            problem = _about_home(travel)
            return problem and problem + of_lengths(travel[0], travel[1], lengths, "mm")

        travel = dialogue.numbers("Travel of a leg from home: shortest longest [mm]", "-15 15", 2, fits)
        robot["stroke"] = metres(travel)
    robot["gravity"] = 9.81
    robot["mass"] = dialogue.number("Mass of the platform with the camera [kg]", 5.0, _MASS)
    centre = metres(dialogue.numbers("Its centre of mass in the platform frame: x y z [mm]", "0 0 0", 3))
    if any(centre):
        robot["centre_of_mass"] = centre
    robot["inertia"] = _inertia(dialogue, robot)
    load = dialogue.number("Mass of a load on it, 0: none [kg]", 0.0, _MASS, zero=True)
    if load > 0:
        place = dialogue.numbers("Centre of the load in the platform frame: x y z [mm]", "0 0 -50", 3)
        inertia = dialogue.numbers(
            "Inertia of the load about its centre, axes x y z [kg m^2]",
            "0 0 0",
            3,
            lambda values: _of_body(values, 0.0),
            within=_INERTIA,
        )
        known = dialogue.choice("Does the controller count on the load", ("yes", "no")) == "yes"
        robot["payload"] = {"mass": load, "position": metres(place), "inertia": inertia, "known": known}
    weight = (robot["mass"] + load) * robot["gravity"]
    if rotary:
        torque = float(f"{weight * robot['cranks']['length']:.2g}")
        robot["force_limit"] = dialogue.number("Largest torque of a crank [N m]", torque, *_EFFORTS)
    else:
        robot["force_limit"] = dialogue.number("Largest force of a leg [N]", float(f"{weight:.2g}"), *_EFFORTS)
    return robot


def _pairs(side: str, apart: float) -> list[float]:
    """Return the six angles [rad] of joints in pairs, leg by leg, so that neighbouring legs lean to each other."""
    angles = []
    for corner in (0.0, 2.0 * math.pi / 3.0, 4.0 * math.pi / 3.0):
        for side_of_pair in (-1.0, 1.0):
            inward = corner + side_of_pair * math.pi / 3.0 - side_of_pair * apart / 2.0
            angles.append(corner + side_of_pair * apart / 2.0 if side == "base" else inward)
    return angles


def _default_joints(side: str) -> list[str]:
    radius = 150.0 if side == "base" else 100.0
    angles = _pairs(side, 20.0 * DEGREE)
    return [f"{radius * math.cos(angle):.1f} {radius * math.sin(angle):.1f} 0" for angle in angles]


def _inertia(dialogue: Dialogue, robot: dict[str, Any]) -> list[float] | list[list[float]]:
    """Return the platform's inertia about E's origin, as a diagonal or a matrix (3, 3)."""
    radius = robot.get("platform_radius") or max(math.hypot(*joint) for joint in robot["platform_joints"])
    disc = robot["mass"] * radius**2 / 4.0
    about_x = float(f"{disc:.3g}")  # no more than a body has, in these digits too
    centre = np.asarray(robot.get("centre_of_mass", [0.0] * 3))
    moved = robot["mass"] * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    matrix = np.diag([about_x, about_x, 2.0 * about_x]) + moved
    entries = [*matrix.diagonal(), *matrix[_PRODUCTS]]
    default = " ".join(f"{entry + 0.0:.15g}" for entry in entries[: 6 if any(entries[3:]) else 3])
    dialogue.say("The inertia in brackets is that of a disc as large as the platform's joints, with its centre there.")
    dialogue.say("Six numbers have the products too: xx yy zz xy xz yz of the matrix, where xy is the sum of -m x y.")

    def check(values: list[float]) -> str | None:
        problem = _of_body(np.linalg.eigvalsh(_tensor(values) - moved).tolist())
        if problem is None or not moved.any():
            return problem
        return f"of the principal moments about the centre of mass, less mass times distance squared: {problem}"

    values = dialogue.numbers(
        "Inertia about the platform frame's axes x y z [kg m^2]", default, (3, 6), check, within=_INERTIA
    )
    rows: list[list[float]] = _tensor(values).tolist()
    return values if len(values) == 3 else rows


def _tensor(values: list[float]) -> np.ndarray:
    """Return the matrix (3, 3) of its diagonal and, with six values, its products xy, xz, yz."""
    matrix = np.diag(values[:3])
    if len(values) > 3:
        matrix[_PRODUCTS] = values[3:]
        matrix.T[_PRODUCTS] = values[3:]
    return matrix


def _of_body(values: list[float], least: float = 1e-300) -> str | None:
    a, b, c = sorted(values)
    if a < least:
        return f"expected numbers {'above 0' if least > 0 else '>= 0'}"
    return None if c <= (a + b) * (1 + 1e-9) else "expected none larger than the sum of the other two"


def _camera(dialogue: Dialogue) -> tuple[dict[str, Any], float, Rotation]:
    """Return the camera, without its times, and its frame period [s].

    The third value is the attitude in the platform frame of a camera that looks along its -z with y up.
    """
    from scipy.spatial.transform import Rotation

    dialogue.say("Without a rotation the camera looks along -z of the platform frame: up, from a level platform.")
    place = metres(dialogue.numbers("Camera in the platform frame: x y z [mm]", "0 0 0", 3))
    turn = dialogue.numbers("Its rotation there: about x y z, axis times angle [deg]", "0 0 0", 3, within=_TURN)
    looks = Rotation.from_rotvec(radians(turn))
    camera = _intrinsics(dialogue)
    camera["mount"] = {"position": place, **({"rotation": _vector(looks)} if any(turn) else {})}
    rate = dialogue.number("Frames per second [1/s]", 30.0, *_RATES)
    period = 1.0 / rate  # not rounded: the rate is the one that was asked for
    dialogue.say(f"The frame period is {1e3 * period:.4g} ms.")
    noise = dialogue.number("Noise of a detected point, standard deviation [px]", 0.2, 1e-3, 1e3, zero=True)
    return {**camera, "noise": noise}, period, looks


def _intrinsics(dialogue: Dialogue) -> dict[str, Any]:
    """Return focal length, image size and lens, of numbers or of a calibration file."""
    from hexservo.scenario.calibration import camera_from_file

    def read(path: str) -> dict[str, Any]:
        if not path:
            raise ValueError("expected the name of a file")
        camera = camera_from_file(path)  # its error is a ValueError
        problem = None if camera["image_size"] is None else problem_of_image(camera)
        if problem is not None:
            raise ValueError(problem)
        return camera

    if dialogue.choice("Camera matrix: numbers, or a calibration file of OpenCV", ("numbers", "file")) == "file":
        camera: dict[str, Any] = dialogue.ask("Calibration file (YAML)", "", read)
    else:
        camera = {"focal_pixels": dialogue.number("Focal length, fx of OpenCV's camera matrix [px]", 1500.0, 1.0)}
    if camera.get("image_size") is None:

        def fits(size: list[float]) -> str | None:
            return _image(size) or problem_of_image({**camera, "image_size": size})

        camera["image_size"] = dialogue.numbers("Image size: width height [px]", "1280 1024", 2, fits)
    if "distortion" not in camera:

        def shows(lens: list[float]) -> str | None:
            return problem_of_image({**camera, "distortion": {"brown_conrady": lens}})

        lens = dialogue.numbers("Distortion, as OpenCV has it: k1 k2 p1 p2 k3", "0 0 0 0 0", 5, shows)
        if any(lens):
            camera["distortion"] = {"brown_conrady": lens}
    return camera


def _about_home(travel: list[float]) -> str | None:
    fits = travel[0] <= 0 <= travel[1] and travel[0] < travel[1]
    return None if fits else "expected a number <= 0, then one >= 0, not both 0"


def _image(size: list[float]) -> str | None:
    return None if min(size) >= 1 else "expected numbers of at least 1"


def _goal(pose: list[float]) -> str | None:
    return None if max(map(abs, pose[3:])) <= _TURN else f"expected turns within +-{_TURN:g}"


def _target(
    dialogue: Dialogue, camera: np.ndarray, looks: Rotation, image: list[float], focal: float
) -> dict[str, Any]:
    """Return the target; `camera` (3,) is where the camera is at home [m], `looks` its attitude, both in B."""
    kind = dialogue.choice("Target: a square tag, a grid of points, or points one by one", ("tag", "grid", "points"))
    dialogue.say("Tag and grid are on the line of sight from home, facing the camera.")
    distance = 1e-3 * dialogue.number("Distance of the target from the camera at home [mm]", 500.0, 1.0)
    most = 0.8e3 * min(image) * distance / focal  # [mm], four fifths of the image
    middle = camera + looks.apply([0.0, 0.0, -distance])
    pose = [*(rounded(value) for value in middle.tolist()), *_vector(looks)]

    def fits(spaces: int) -> Check:
        largest = most / spaces

        def check(size: float) -> str | None:
            good = 0 < size <= largest
            return None if good else f"expected a number above 0, and at most {largest:.4g}: 80 % of the image"

        return check

    def ask(question: str, spaces: int) -> float:
        default = float(f"{0.3 * most / spaces:.2g}")
        return 1e-3 * float(dialogue.ask(question, f"{default:g}", one_number, fits(spaces)))

    target: dict[str, Any]
    if kind == "tag":
        size = ask("Side of the tag [mm]", 1)
        dialogue.say(f"At home the tag's side is {focal * size / distance:.4g} px long.")
        target = {"tag": {"size": size, "pose": pose}}
    elif kind == "grid":
        rows, columns = map(int, dialogue.numbers("Rows and columns of the grid, at most 16 points", "3 4", 2, _grid))
        spacing = ask("Distance between neighbouring points [mm]", max(rows, columns) - 1)
        target = {"grid": {"rows": rows, "columns": columns, "spacing": spacing, "pose": pose}}
    else:
        count = int(dialogue.ask("Number of points", "4", one_number, _count))
        half = 0.15e-3 * most  # [m]
        angles = np.pi / 4 + 2.0 * np.pi * np.arange(count) / count
        plane = half * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(count)])
        texts = [" ".join(f"{value:.5g}" for value in row) for row in 1e3 * (middle + looks.apply(plane)) + 0.0]
        target = {
            "points": [
                metres(dialogue.numbers(f"Point {number} in the base frame: x y z [mm]", text, 3, within=_POINT))
                for number, text in enumerate(texts, start=1)
            ]
        }
    goal = dialogue.numbers(
        "Goal, where the platform shall go from home: x y z [mm], turn about x y z [deg]",
        "3 -2 2 -0.5 -0.5 1",
        6,
        _goal,
    )
    return {**target, "desired_pose": [*metres(goal[:3]), *radians(goal[3:])]}


def _whole(values: list[float]) -> bool:
    return all(value == round(value) for value in values)


def _grid(values: list[float]) -> str | None:
    good = _whole(values) and min(values) >= 2 and values[0] * values[1] <= MOST_POINTS
    return None if good else "expected two whole numbers of at least 2, whose product is at most 16"


def _count(value: float) -> str | None:
    fits = _whole([value]) and LEAST_POINTS <= value <= MOST_POINTS
    return None if fits else f"expected a whole number of {LEAST_POINTS} to {MOST_POINTS}"


def _encoders(dialogue: Dialogue, robot: dict[str, Any]) -> dict[str, Any]:
    """Return the joint sensors: the resolution in brackets is at most 1/10000 of the travel, in one digit."""
    unit, scale, most = ("deg", DEGREE, 0.006) if "cranks" in robot else ("mm", 1e-3, 0.001)
    travel = float(np.ptp(robot["stroke"])) / scale
    resolution = dialogue.number(
        f"Resolution of a leg's encoder, 0: not rounded [{unit}]",
        min(most, float(f"{_OF_TRAVEL * travel:.1g}")),
        _RESOLUTION,
        travel,
        zero=True,
    )
    return {"pose": "encoders", "resolution": rounded(scale * resolution)}


def _explain(dialogue: Dialogue, scenario: hs.Scenario) -> None:
    """Write what follows from the answers: travel along each axis, warnings and notes."""
    from hexservo.findings.analysis.scene import scene_of
    from hexservo.findings.analysis.workspace import reaches

    dialogue.say("\nWhat follows: travel from home to a leg's end or a singular pose, one direction at a time")
    axes = [(name, "mm") for name in "xyz"] + [(f"about {name}", "deg") for name in "xyz"]
    ends = [_end(reached) for reached in reaches(scene_of(scenario), np.vstack([-np.eye(6), np.eye(6)]))]
    for (label, unit), below, above in zip(axes, ends[:6], ends[6:], strict=True):
        dialogue.say(f"  {label:8s} {-below:9.4g} to {above:.4g} {unit}")
    found = hs.check(scenario)
    complain(*found.warnings, head="Warning")
    complain(*found.notes, head="Note")


def _end(reached: Reach) -> float:
    """Return how far the platform goes along an axis [mm] or about it [deg]; at most half a turn is looked at."""
    if np.any(reached.direction[3:]):
        return min(reached.distance, math.pi) / DEGREE
    return 1e3 * reached.distance


def _vector(rotation: Rotation) -> list[float]:
    return [rounded(value) + 0.0 for value in rotation.as_rotvec().tolist()]
