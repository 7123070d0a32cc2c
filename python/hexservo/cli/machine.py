"""The command ``hexservo new``: questions about a machine, and the scenario file that the answers make."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

import hexservo as hs
from hexservo.cli.terminal import INTERRUPTED, complain, errors_as_messages, write
from hexservo.scenario.laws import GENERAL_LAW

__all__ = ["new"]

_TITLE = "# Made by `hexservo new --machine`."
_DEGREE = math.pi / 180.0
_TICKS = 150  # servo periods in one of the bandwidth, at least: more than `hexservo check` asks for
_PERIODS = 10  # of the bandwidth in a run

Check = Callable[[Any], str | None]


def new(
    machine: Annotated[str, typer.Option("--machine", metavar="FILE", help="YAML file to write, a new file.")],
    force: Annotated[bool, typer.Option("--force", "-f", help="Replace a file of an earlier `hexservo new`.")] = False,
) -> None:
    """Write a scenario from the numbers of a data sheet.

    Asks for them one by one.

    Enter takes the answer in brackets. Each answer is checked at once; without a terminal, answers are read from
    standard input, one a line, and the first that is wrong ends the command. The file appears whole or not at all.
    """
    with errors_as_messages():
        from hexservo.run.files import check_file, write_file

        check_file(machine, _TITLE, "`hexservo new`", force=force)
        try:
            text = _scenario_text(_Dialogue(sys.stdin is not None and sys.stdin.isatty()), Path(machine).stem)
        except (EOFError, typer.Abort):
            raise hs.ScenarioError(["expected an answer to every question, got the end of standard input"]) from None
        except KeyboardInterrupt:
            complain(f"{machine} was not written", head="Interrupted")
            raise typer.Exit(INTERRUPTED) from None
        write_file(text, machine, _TITLE, "`hexservo new`", force=force)
        commands = f"hexservo check {machine}\n  hexservo report {machine} --out {Path(machine).stem}.html"
        write(f"\n{machine} is written. Next:\n\n  {commands}\n")


class _Dialogue:
    """Questions and answers, with one check at each answer."""

    def __init__(self, interactive: bool) -> None:
        self._interactive = interactive

    def say(self, text: str) -> None:
        write(f"{text}\n")

    def ask(self, question: str, default: str, read: Callable[[str], Any], check: Check | None = None) -> Any:
        """Return the answer, once it is one; the end of the input, and without a terminal a wrong answer, raise."""
        while True:
            write(f"{question} [{default}]: ")
            line = sys.stdin.readline() if sys.stdin is not None else ""
            if not line:
                raise EOFError
            answer = line.strip() or default
            if not self._interactive:
                write(f"{answer}\n")
            try:
                value = read(answer)
                problem = None if check is None else check(value)
            except ValueError as error:
                problem = str(error)
            if problem is None:
                return value
            if not self._interactive:
                raise hs.ScenarioError([f'{question}: {problem}, got "{answer}"'])
            complain(f'{problem}, got "{answer}"', head="Again")

    def number(self, question: str, default: float, *, zero: bool = False) -> float:
        """Return a number above 0, or 0 where that is allowed."""

        def check(value: float) -> str | None:
            return None if value > 0 or (zero and value == 0) else f"expected a number {'>= 0' if zero else 'above 0'}"

        return float(self.ask(question, f"{default:g}", _number, check))

    def numbers(self, question: str, default: str, count: int, check: Check | None = None) -> list[float]:
        """Return several numbers, given with blanks or commas between."""
        return list(self.ask(question, default, lambda text: _numbers(text, count), check))

    def choice(self, question: str, choices: tuple[str, ...]) -> str:
        """Return one of some words; the first is the default."""

        def check(value: str) -> str | None:
            return None if value in choices else f"expected {' or '.join(choices)}"

        return str(self.ask(f"{question} ({', '.join(choices)})", choices[0], str, check))


def _number(text: str) -> float:
    return _numbers(text, 1)[0]


def _numbers(text: str, count: int) -> list[float]:
    expected = "a number" if count == 1 else f"{count} numbers"
    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        raise ValueError(f"expected {expected}") from None
    if len(values) != count or not all(map(math.isfinite, values)):
        raise ValueError(f"expected {expected}{'' if count == 1 else ' with blanks between'}")
    return values


def _scenario_text(dialogue: _Dialogue, name: str) -> str:
    """Return the text of a file that loads, from all answers."""
    from hexservo.scenario.yaml import dump_yaml

    dialogue.say("Lengths in mm, angles in degrees. z of the base frame points down: above the base it is negative.")
    robot = _robot(dialogue)
    camera, focal = _camera(dialogue)
    place = [_rounded(sum(both)) for both in zip(robot["home_position"], camera["mount"]["position"], strict=True)]
    target = _target(dialogue, place, camera["image_size"], focal)
    bandwidth = dialogue.number("Bandwidth of the loop [Hz]", 1.0)
    period = camera["period"]
    parts = max(1, math.ceil(period * _TICKS * bandwidth))
    step = period / parts  # not rounded: times are whole numbers of it
    dialogue.say(f"The servo period is {1e3 * step:.4g} ms, {f'1/{parts} of' if parts > 1 else ''} the frame period.")
    frames = math.ceil(_PERIODS / bandwidth / period)
    document: dict[str, Any] = {
        "name": name,
        "description": "A machine from its data sheet",
        "robot": robot,
        "camera": camera,
        "target": target,
        "controller": {
            "law": GENERAL_LAW,
            "switching": {"kind": "implicit"},
            GENERAL_LAW: {"auto": {"bandwidth": bandwidth}},
        },
        "sensors": {"pose": "encoders", "resolution": 1e-6},
        "simulation": {"mode": "sampled", "step": step, "duration": frames * period},
    }
    scenario = hs.Scenario.from_mapping(document)  # all that one answer alone does not tell
    _explain(dialogue, scenario)
    return (
        f"{_TITLE}\n# Keys that are not here have their defaults, which `hexservo show` lists.\n{dump_yaml(document)}"
    )


def _robot(dialogue: _Dialogue) -> dict[str, Any]:
    robot: dict[str, Any] = {}
    form = dialogue.choice("Joints of the legs: on circles, in pairs, or given one by one", ("circles", "joints"))
    if form == "circles":
        for side, radius, apart in (("platform", 100.0, 20.0), ("base", 150.0, 20.0)):
            robot[f"{side}_radius"] = 1e-3 * dialogue.number(f"Radius of the {side} joints' circle [mm]", radius)
            angle = _DEGREE * dialogue.number(f"Angle between the two {side} joints of a pair [deg]", apart)
            robot[f"{side}_angles"] = [_rounded(value) for value in _pairs(side, angle)]
        dialogue.say("Pairs of the base are about 0, 120 and 240 deg, pairs of the platform halfway between.")
    else:
        for side in ("platform", "base"):
            robot[f"{side}_joints"] = [
                _metres(dialogue.numbers(f"Joint {leg} in the {side} frame: x y z [mm]", text, 3))
                for leg, text in enumerate(_default_joints(side), start=1)
            ]
    home = dialogue.numbers("Home of the platform frame in the base: x y z [mm]", "0 0 -160", 3)
    robot["home_position"] = _metres(home)
    travel = dialogue.numbers("Travel of a leg from home: shortest longest [mm]", "-15 15", 2, _about_home)
    robot["stroke"] = _metres(travel)
    robot["gravity"] = 9.81
    robot["mass"] = dialogue.number("Mass of the platform with the camera [kg]", 5.0)
    robot["inertia"] = _inertia(dialogue, robot)
    load = dialogue.number("Mass of a load on it, 0: none [kg]", 0.0, zero=True)
    if load > 0:
        place = dialogue.numbers("Centre of the load in the platform frame: x y z [mm]", "0 0 -50", 3)
        robot["payload"] = {"mass": load, "position": _metres(place)}
        dialogue.say("The load is taken for a point, which the controller counts on: robot.payload has more.")
    weight = (robot["mass"] + load) * robot["gravity"]
    robot["force_limit"] = dialogue.number("Largest force of a leg [N]", float(f"{weight:.2g}"))
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
    angles = _pairs(side, 20.0 * _DEGREE)
    return [f"{radius * math.cos(angle):.1f} {radius * math.sin(angle):.1f} 0" for angle in angles]


def _inertia(dialogue: _Dialogue, robot: dict[str, Any]) -> list[float]:
    radius = robot.get("platform_radius") or max(math.hypot(*joint) for joint in robot["platform_joints"])
    disc = robot["mass"] * radius**2 / 4.0
    about_x = float(f"{disc:.3g}")
    default = f"{about_x:g} {about_x:g} {2 * about_x:g}"  # no more than a body has, in these digits too
    dialogue.say("The inertia in brackets is that of a disc as large as the platform's joints.")

    def check(values: list[float]) -> str | None:
        a, b, c = sorted(values)
        if a <= 0:
            return "expected numbers above 0"
        return None if c <= (a + b) * (1 + 1e-9) else "expected none larger than the sum of the other two"

    return dialogue.numbers("Inertia about the platform frame's axes x y z [kg m^2]", default, 3, check)


def _camera(dialogue: _Dialogue) -> tuple[dict[str, Any], float]:
    dialogue.say("The camera looks along -z of the platform frame: up, from a level platform.")
    place = _metres(dialogue.numbers("Camera in the platform frame: x y z [mm]", "0 0 0", 3))
    focal = dialogue.number("Focal length, fx of OpenCV's camera matrix [px]", 1500.0)
    size = dialogue.numbers("Image size: width height [px]", "1280 1024", 2, _positive)
    rate = dialogue.number("Frames per second [1/s]", 30.0)
    period = _rounded(round(1e3 / rate) * 1e-3 if rate <= 200.0 else 1.0 / rate)
    dialogue.say(f"The frame period is {1e3 * period:.4g} ms, and an image is used as long after its exposure.")
    noise = dialogue.number("Noise of a detected point, standard deviation [px]", 0.2, zero=True)
    camera = {
        "focal_pixels": focal,
        "image_size": size,
        "mount": {"position": place},
        "period": period,
        "latency": period,
        "noise": noise,
        "prediction": "encoder",
    }
    return camera, focal


def _about_home(travel: list[float]) -> str | None:
    return None if travel[0] <= 0 <= travel[1] and travel[0] < travel[1] else "expected a number <= 0, then one >= 0"


def _positive(values: list[float]) -> str | None:
    return None if min(values) > 0 else "expected numbers above 0"


def _target(dialogue: _Dialogue, camera_home: list[float], image: list[float], focal: float) -> dict[str, Any]:
    dialogue.say("The target is a square tag on the line of sight, facing the camera.")
    distance = 1e-3 * dialogue.number("Distance of the tag from the camera at home [mm]", 500.0)
    most = 0.8e3 * min(image) * distance / focal  # [mm], four fifths of the image

    def fits(side: float) -> str | None:
        return None if 0 < side <= most else f"expected a number above 0, and at most {most:.4g}: 80 % of the image"

    size = 1e-3 * float(
        dialogue.ask("Side of the tag [mm]", f"{min(100.0, float(f'{0.3 * most:.2g}')):g}", _number, fits)
    )
    dialogue.say(f"At home the tag's side is {focal * size / distance:.4g} px long.")
    goal = dialogue.numbers(
        "Goal, where the platform shall go from home: x y z [mm], turn about x y z [deg]", "3 -2 2 -0.5 -0.5 1", 6
    )
    return {
        "tag": {"size": size, "pose": [*camera_home[:2], _rounded(camera_home[2] - distance), 0.0, 0.0, 0.0]},
        "desired_pose": [_rounded(value * (1e-3 if place < 3 else _DEGREE)) for place, value in enumerate(goal)],
    }


def _explain(dialogue: _Dialogue, scenario: hs.Scenario) -> None:
    """Write what follows from the answers: travel along each axis, and warnings."""
    from hexservo.findings.check import unlikely

    dialogue.say("\nWhat follows: travel from home until a leg is at its end, one direction at a time")
    for axis, (label, unit, scale) in enumerate(
        [(f"{name}", "mm", 1e3) for name in "xyz"] + [(f"about {name}", "deg", 1.0 / _DEGREE) for name in "xyz"]
    ):
        ends = [scale * _travel(scenario, axis, sign) for sign in (-1.0, 1.0)]
        dialogue.say(f"  {label:8s} {-ends[0]:9.4g} to {ends[1]:.4g} {unit}")
    for sentence in unlikely(scenario):
        complain(sentence, head="Warning")


def _travel(scenario: hs.Scenario, axis: int, sign: float) -> float:
    """Return how far the platform goes along one axis [m or rad], by bisection."""
    low, high = 0.0, 1e-4
    pose = [0.0] * 6

    def inside(amount: float) -> bool:
        pose[axis] = sign * amount
        return hs.reachable(scenario, pose).margin >= 0

    while inside(high) and high < 3.0:
        low, high = high, 1.5 * high
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if inside(middle) else (low, middle)
    return low


def _metres(millimetres: list[float]) -> list[float]:
    return [_rounded(1e-3 * value) for value in millimetres]


def _rounded(value: float) -> float:
    return float(f"{value:.9g}")
