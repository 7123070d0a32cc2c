"""Random scenarios: every key of the schema, within its bounds and at them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache
from typing import Any, get_args

import numpy as np
from numpy.random import Generator

import hexservo as hs
import rotary_machine
from hexservo.scenario import keys
from hexservo.scenario import rules as kinds
from hexservo.scenario.laws import ALL_LAWS, LAWS
from hexservo.scenario.plain import plain as as_plain
from hexservo.scenario.pose_rules import DisplacementRule
from hexservo.scenario.tag import GridRule, TagRule

__all__ = ["Drawn", "draw", "inclusive_bounds", "rules"]

EXTREMES = (5e-324, 1e-300, 1e-150, 1e-30, 1e30, 1e150, 1e300, 1.7e308)
TEXTS = ("paper", "0", "a.b-c_d", "Ä1", "x" * 60, "-x", "", "x.", "a b", "日本")
LINES = ("", "ξ and 'quotes': #", "x" * 200, "x" * 201, "two\nlines", "null")
POSITIONS = "reachy-mini"  # a machine that takes positions, as others do not
OF_POSITIONS = "tracking"  # the law of such machines alone
GRID = ("simulation.step", "simulation.duration", "simulation.substeps", "simulation.mode")
IN_STEPS = {  # what is a whole number of servo periods: most of them that are drawn
    "camera.period": 40,
    "camera.latency": 20,
    "camera.latency_jitter": 5,
    "sensors.period": 10,
    "actuators.delay": 8,
}


@dataclass
class Drawn:
    """What was drawn: the changes, and the scenario, or why there is none."""

    changes: dict[str, Any]
    scenario: hs.Scenario | None = None
    refusal: str = ""
    at_bounds: set[tuple[str, float]] = field(default_factory=set)


@cache
def rules() -> dict[str, kinds.Rule]:
    """Give all keys of a scenario that hold a value, with their rules."""
    return dict(keys.rules(hs.Scenario))


def inclusive_bounds(rule: kinds.Rule) -> list[float]:
    """Give the bounds that a value may have."""
    if isinstance(rule, kinds.ArrayRule):
        return inclusive_bounds(rule.element)
    if isinstance(rule, kinds.Number | kinds.Integer):
        return [bound for bound in (rule.at_least, rule.at_most) if bound is not None]
    return []


def draw(
    random: Generator,
    *,
    steps: int = 120,
    budget: int = 4000,
    million: bool = True,
    at: tuple[str, float] | None = None,
) -> Drawn:
    """Draw a scenario: a packaged one on another grid, with some keys changed.

    Parameters
    ----------
    random
        Decides everything.
    steps
        Most steps of the simulation.
    budget
        Most Runge-Kutta steps.
    at
        A key and a bound of it that it shall have.
    million
        Whether one scenario in 100 has the most substeps there are, a million.
    """
    base = hs.load_scenario(POSITIONS if random.random() < 0.1 else _one(random, hs.scenario_names()))
    changes = _grid(random, base, steps, budget, million)
    drawn = Drawn(changes)
    is_sampled = changes["simulation.mode"] == "sampled"
    if not is_sampled:
        changes |= {key: _plain(value) for key, value in keys.sampled_keys().items()}
    elif random.random() < 0.9:
        changes |= _clocks(random, changes["simulation.step"])
    open_keys = [
        key
        for key in rules()
        if key not in (*GRID, "base_motion.file", "target.motion.file", "controller.law")
        and (is_sampled or key not in keys.sampled_keys())
    ]
    law = _one(random, LAWS) if random.random() < 0.5 else base.controller.law
    if base.name == POSITIONS and random.random() < 0.7:
        law = OF_POSITIONS
        changes["camera.prediction"] = "none"  # it predicts by itself
    changes["controller.law"] = law
    others = tuple(f"controller.{name}." for name in ALL_LAWS if name != law)
    mattering = [key for key in open_keys if not key.startswith(others)]
    seldom = [key for key in mattering if law == OF_POSITIONS and key.startswith(f"controller.{law}.")]
    if at is not None:
        _set_bound(random, drawn, base, *at)
    for _ in range(int(random.geometric(0.3)) if at is None else 0):
        key = _one(random, mattering if random.random() < 0.8 else open_keys)
        if seldom and random.random() < 0.3:  # the law is drawn less often than others
            key = _one(random, seldom)
        if key in IN_STEPS and random.random() < 0.9:
            continue  # drawn with the other times
        if random.random() < 0.4 and (bounds := inclusive_bounds(rules()[key])):
            _set_bound(random, drawn, base, key, _one(random, bounds))
        else:
            changes[key] = _value(random, key, _current(base, key))
    _repair(random, changes, base)
    try:
        drawn.scenario = base.updated(changes)
    except hs.ScenarioError as error:
        drawn.refusal = str(error)
    return drawn


def _set_bound(random: Generator, drawn: Drawn, base: hs.Scenario, key: str, bound: float) -> None:
    """Put a value, or one entry of an array that is never a number, at a bound."""
    rule = rules()[key]
    value: Any = int(bound) if isinstance(rule, kinds.Integer) else bound
    if isinstance(rule, kinds.ArrayRule) and not rule.or_number:
        entries = np.array(_current(base, key), dtype=float)
        if entries.shape != rule.shape:
            return
        entries.flat[random.integers(entries.size)] = bound
        value = entries.tolist()
    if key == "simulation.substeps":  # the costly one: a single step
        drawn.changes |= {"simulation.mode": "sampled", "simulation.duration": drawn.changes["simulation.step"]}
        drawn.changes |= _clocks(random, drawn.changes["simulation.step"])
    elif key in keys.sampled_keys():
        drawn.changes["simulation.mode"] = "sampled"
    if key == "camera.image_size":
        return
    drawn.changes[key] = value
    drawn.at_bounds.add((key, bound))


# ---- What belongs together ------------------------------------------------------------------------------------------


def _grid(random: Generator, base: hs.Scenario, steps: int, budget: int, million: bool) -> dict[str, Any]:
    step = float(_one(random, [1e-3, 1e-3, 2e-3, 10.0 ** random.uniform(-5, -1.5)]))
    count = int(_one(random, [1, 2, int(random.integers(1, steps + 1)), steps]))
    substeps = (
        10**6 if random.random() < 0.01 and million else int(_one(random, [1, 1, 2, 4, int(random.integers(1, 20))]))
    )
    if substeps == 10**6:
        count = 1
    elif count * substeps > budget:
        substeps = 1
    mode = "sampled" if random.random() < (0.97 if base.name == POSITIONS else 0.6) else "continuous"
    return {
        "simulation.mode": mode,
        "simulation.step": step,
        "simulation.duration": count * step,
        "simulation.log_every": int(_one(random, [1, 1, 7, 10**9])),
        "simulation.substeps": substeps if mode == "sampled" else 1,
    }


def _clocks(random: Generator, step: float) -> dict[str, Any]:
    """Draw times that are whole numbers of servo periods, with a timeout that allows them."""
    ticks = {key: int(_one(random, [0, 1, int(random.integers(0, most + 1)), most])) for key, most in IN_STEPS.items()}
    times: dict[str, Any] = {key: count * step for key, count in ticks.items()}
    for key in ("camera.period", "sensors.period"):
        times[key] = times[key] or None
    times["uncertainty.latency"] = step * _one(random, [0, int(random.integers(-ticks["camera.latency"], 11))])
    oldest = max(ticks["camera.period"], 1) + ticks["camera.latency"] + ticks["camera.latency_jitter"]
    times["camera.timeout"] = _one(random, [None, (oldest + int(random.integers(0, 30))) * step])
    finest = 0.5 / step
    times["base_motion.frequency"] = finest * float(_one(random, [0.0, 0.999, random.random()]))
    times["base_motion.high_frequency"] = finest * float(_one(random, [0.999, random.uniform(0.1, 1)]))
    times["base_motion.low_frequency"] = times["base_motion.high_frequency"] * random.uniform(0, 0.9)
    times["base_motion.rotation.frequency"] = finest * random.random()
    times["base_motion.rotation.high_frequency"] = finest * random.uniform(0.1, 1)
    times["base_motion.rotation.low_frequency"] = times["base_motion.rotation.high_frequency"] * random.uniform(0, 0.9)
    times["target.motion.frequency"] = finest * random.random()
    times["base_motion.road.shortest"] = 0.1
    times["base_motion.road.speed"] = min(30.0, 0.1 * finest) * random.uniform(0.1, 1)
    return times


def _repair(random: Generator, changes: dict[str, Any], base: hs.Scenario) -> None:
    """Give what is in pairs both of them, mostly: the rest of the draws is there to be refused."""
    if random.random() < 0.05:
        return
    for block, size in (("base_motion", 1.0), ("target.motion", 1e-3)):
        samples, period = f"{block}.samples", f"{block}.sample_period"
        if (changes.get(samples) is None) != (changes.get(period) is None):
            changes[samples] = (size * random.normal(size=(int(random.integers(2, 50)), 3))).tolist()
            changes[period] = 10.0 ** random.uniform(-4, 0)
        if changes.get(f"{block}.kind") == "recorded" and changes.get(samples) is None:
            changes[samples] = (size * random.normal(size=(20, 3))).tolist()
            changes[period] = 0.01
    recorded = changes.get("base_motion.samples")
    if recorded is None:
        changes.pop("base_motion.frame_of_acceleration", None)
    if changes.get("base_motion.attitudes") is not None and recorded is None:
        changes["base_motion.samples"] = random.normal(size=(20, 3)).tolist()
        changes["base_motion.sample_period"] = 0.1
    if changes.get("base_motion.attitudes") is not None:
        turns = np.cumsum(0.02 * random.normal(size=(len(changes["base_motion.samples"]), 4)), axis=0) + np.array(
            [3.0, 0.0, 0.0, 0.0]
        )
        changes["base_motion.attitudes"] = (turns / np.linalg.norm(turns, axis=1, keepdims=True)).tolist()
    if changes.get("target.tag") is not None or changes.get("target.grid") is not None:
        changes |= {"target.initial_features": None, "target.depth": None, "target.points": None}
    elif changes.get("target.points") is not None:
        changes |= {"target.initial_features": None, "target.depth": None}
    elif changes.get("target.initial_features") is not None:
        changes["target.points"] = None
    placed = any(changes.get(f"target.{key}") is not None for key in ("points", "tag", "grid"))
    moving = changes.get("target.frame") == "world" or changes.get("target.motion.kind", "none") != "none"
    if placed or moving or base.target.initial_features is None:  # points in B, for a camera on the platform
        changes.pop("camera.mount.on", None)
    if changes.get("camera.focal_pixels") is not None:
        changes |= {"camera.focal_length": None, "camera.pixel_scale": None}
    if changes.get("camera.distortion.kannala_brandt") is not None:
        changes["camera.distortion.brown_conrady"] = None
    if changes.get("camera.principal_point") is not None:
        changes |= {"camera.principal_point": [320.0, 240.0], "camera.image_size": [640.0, 480.0]}
        changes["simulation.mode"] = "sampled"
    if changes.get("target.grid") is not None:  # whose points are others than those of the goal image
        changes |= {"target.tag": None, "target.desired_pose": [0.003] * 3 + [0.02] * 3}
        changes |= {"target.weights": 1.0, "uncertainty.depth": 0.1}
    if changes.get("target.weights") == 0.0:  # of one point: some have to count
        changes["target.weights"] = [0.0, *[1.0] * (len(base.target.desired_features) // 2 - 1)]
    if changes.get("target.desired_pose") is not None:
        changes["target.desired_features"] = None
    for side in ("platform", "base"):
        if changes.get(f"robot.{side}_joints") is not None:
            changes |= {f"robot.{side}_radius": None, f"robot.{side}_angles": None}
    if any(key.startswith(("robot.legs", "robot.cranks.")) for key in changes):
        for key in [key for key in changes if key.startswith("robot.")]:
            del changes[key]
        machine = rotary_machine.robot()
        cranks = machine.pop("cranks")
        changes |= {f"robot.{key}": value for key, value in machine.items()}
        changes |= {f"robot.cranks.{key}": value for key, value in cranks.items()}
        changes["robot.cranks.length"] *= random.uniform(0.9, 1.1)
    if any(key.startswith("robot.payload.") for key in changes) and changes.get("robot.payload.mass", 0.0) == 0.0:
        changes["robot.payload.mass"] = 0.01
    if "robot.centre_of_mass" in changes:
        changes["robot.inertia"] = [1e-3] * 3
    _repair_kind(random, changes, base)
    switching = changes.get("controller.switching.kind", base.controller.switching.kind)
    if str(switching).startswith("implicit") and changes["simulation.mode"] != "sampled":
        changes["controller.switching.kind"] = "tanh"


def _repair_kind(random: Generator, changes: dict[str, Any], base: hs.Scenario) -> None:
    """Leave to a machine that takes positions the keys that act on it."""
    own = ("actuators.position.", "controller.virtual_platform.")
    if changes["simulation.mode"] == "sampled" and any(key.startswith(own) for key in changes):
        changes["actuators.kind"] = "position"
    if changes["simulation.mode"] == "sampled" and any(key.startswith("actuators.motor.") for key in changes):
        changes["actuators.kind"] = "position_torque"
    kind = changes.get("actuators.kind", base.actuators.kind)
    if kind != "position_torque" and base.actuators.kind == "position_torque":
        changes |= {key: value for key, value in keys.sampled_keys().items() if key.startswith("actuators.motor.")}
    if kind == "force":
        return
    if kind == "position_torque":
        changes["simulation.substeps"] = max(20, changes["simulation.substeps"])
    others = ("hold", "saturation", "bandwidth", "quantisation")
    changes |= {f"actuators.{key}": keys.sampled_keys()[f"actuators.{key}"] for key in others}
    changes |= {"controller.safe.damping": None, "controller.safe.hold": None, "camera.convention": "eye_in_hand"}
    if "controller.virtual_platform.damping" in changes:
        massless = changes["controller.law"] in ("resolved_rate", "pbvs")
        changes["controller.virtual_platform.damping"] = 0.0 if massless else 1e-5 * random.random()


# ---- One value ------------------------------------------------------------------------------------------------------


SMALL = {  # sizes of what is refused, or beyond all reach, as a rule where it is larger
    "robot.home_attitude": 0.1,
    "robot.stroke_centre": 1e-3,
    "robot.centre_of_mass": 5e-3,
    "robot.payload.position": 0.02,
    "camera.mount.position": 0.02,
    "camera.mount.rotation": 0.1,
    "camera.distortion.brown_conrady": 0.02,
    "camera.distortion.kannala_brandt": 0.02,
    "uncertainty.focal_length": 0.02,
    "uncertainty.principal_point": 2.0,
    "uncertainty.mount.position": 5e-3,
    "uncertainty.mount.rotation": 0.02,
    "base_motion.rotation.amplitude": 0.05,
    "target.motion.velocity": 0.01,
    "target.motion.amplitude": 1e-3,
    "simulation.start.pose": 3e-3,
    "simulation.start.twist": 0.05,
}


def _value(random: Generator, key: str, current: Any) -> Any:
    """Draw a value for a key; most of them are legal."""
    rule = rules()[key]
    if key in SMALL and random.random() < 0.9:
        return (SMALL[key] * random.normal(size=keys.numeric_keys("hybrid")[key].shapes[-1])).tolist()
    if key in ("robot.platform_joints", "robot.base_joints"):
        radius, start = (0.1, -50.0) if key == "robot.platform_joints" else (0.2, -10.0)
        turn = np.deg2rad(start + np.array([0.0, 100.0, 120.0, 220.0, 240.0, 340.0]))  # as those of the preset micro
        circle = radius * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(6)])
        return _one(random, [None, (circle + 0.02 * random.normal(size=(6, 3))).tolist()])
    if isinstance(rule, kinds.Number):
        if isinstance(rule, kinds.OptionalNumber) and random.random() < 0.2:
            return None
        return _number(random, rule, current if isinstance(current, float) else 0.0)
    if isinstance(rule, kinds.SamplePeriod):
        return _one(random, [None, 10.0 ** random.uniform(-4, 0)])
    if isinstance(rule, kinds.Samples):
        return _one(random, [None, random.normal(size=(int(random.integers(2, 50)), rule.columns)).tolist()])
    if isinstance(rule, kinds.ArrayRule):
        return _array(random, rule, current)
    if isinstance(rule, kinds.Inertia):
        return _inertia(random, 10.0 ** random.uniform(-7, 1) if random.random() < 0.3 else 3e-4)
    if isinstance(rule, kinds.TableRule):
        table = random.uniform(-1, 1, (7, 7)).tolist()
        return _one(random, ["linear", table, np.full((7, 7), _one(random, ["NB", "ZE", "PB"])).tolist()])
    if isinstance(rule, kinds.Integer):
        return int(_one(random, [rule.at_least, rule.at_most, _integer(random, rule.at_least, rule.at_most)]))
    if isinstance(rule, kinds.Flag):
        return bool(random.random() < 0.5)
    if isinstance(rule, kinds.Choice):
        return _one(random, [*(rule.choices or _words()[key]), *[None] * rule.or_null])
    if isinstance(rule, kinds.TrueOr):
        return _one(random, [True, rule.name])
    if isinstance(rule, kinds.Name):
        return _one(random, TEXTS)
    if isinstance(rule, kinds.LineRule):
        return _one(random, LINES)
    if isinstance(rule, DisplacementRule):
        return _one(random, [None, (0.02 * random.normal(size=6)).tolist()])
    if isinstance(rule, TagRule):
        pose = [*(0.05 * random.normal(size=2)), -0.65, *(0.5 * random.normal(size=3))]
        return _one(random, [None, {"size": 10.0 ** random.uniform(-3, 0), "pose": [float(x) for x in pose]}])
    if isinstance(rule, GridRule):
        pose = [*(0.05 * random.normal(size=2)), -0.65, *(0.5 * random.normal(size=3))]
        shape = {"rows": 2, "columns": int(random.integers(2, 9)), "spacing": 10.0 ** random.uniform(-3, -1)}
        return _one(random, [None, {**shape, "pose": [float(x) for x in pose]}])
    raise NotImplementedError(f"the fuzzer has no values of a {type(rule).__name__}")


@cache
def _words() -> dict[str, tuple[str, ...]]:
    """Give the words of the keys that have them as their type."""
    return {path: get_args(info.annotation) for path, info, _ in keys.leaves(hs.Scenario)}


def _number(random: Generator, rule: kinds.Number, current: float) -> float:
    lowest = rule.at_least if rule.at_least is not None else rule.above
    highest = rule.at_most if rule.at_most is not None else rule.below
    kind = random.random()
    if kind < 0.5 and current != 0.0:
        value = current * 10.0 ** random.normal(0, 0.5)
    elif kind < 0.6:
        value = float(_one(random, EXTREMES))
    elif lowest is not None and highest is not None:
        value = random.uniform(lowest, highest)
    else:
        value = 10.0 ** random.uniform(-9, 6)
    if lowest is None and random.random() < 0.5:
        value = -value
    low = -math.inf if lowest is None else lowest if rule.at_least is not None else math.nextafter(lowest, math.inf)
    high = math.inf if highest is None else highest if rule.at_most is not None else math.nextafter(highest, -math.inf)
    return float(min(max(value, low), high))


def _array(random: Generator, rule: kinds.ArrayRule, current: Any) -> Any:
    if rule.or_null and random.random() < 0.2:
        return None
    if rule.or_number and random.random() < 0.5:
        return _number(random, rule.element, current if isinstance(current, float) else 0.0)
    shape = np.shape(current) or rule.shape  # of a target whose points are not four, its own
    near = np.broadcast_to(0.0 if current is None else np.asarray(current, dtype=float), shape)
    if random.random() < 0.6 and np.any(near):  # all of them somewhat different
        scale = 10.0 ** random.uniform(-6, 0)
        values = near * (1 + scale * random.uniform(-1, 1, shape))
        if shape == (6, 6):
            values = (values + values.T) / 2
        return values.tolist()
    return np.reshape([_number(random, rule.element, float(item)) for item in near.flat], shape).tolist()


def _inertia(random: Generator, moment: float) -> Any:
    """Draw the inertia of a body: of points, of a flat disc, which is at the border, or a diagonal."""
    if random.random() < 0.3:
        return [moment, moment, 2 * moment]
    points = random.normal(size=(int(random.integers(3, 8)), 3))
    inertia = sum(np.dot(p, p) * np.eye(3) - np.outer(p, p) for p in points)
    return (moment / np.trace(inertia) * inertia).tolist()


def _integer(random: Generator, low: int, high: int) -> int:
    return low + int((high - low) * 10.0 ** random.uniform(-6, 0) * random.random())


def _current(base: hs.Scenario, key: str) -> Any:
    value: Any = base
    for part in key.split("."):
        value = getattr(value, part)
    return value


def _one(random: Generator, items: Any) -> Any:
    return items[int(random.integers(len(items)))]


def _plain(value: Any) -> Any:
    return as_plain(value)
