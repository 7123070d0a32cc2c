"""Legal but probably unintended settings of a scenario, and keys without effect: for ``hexservo check``."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.linear_law import NoRestError, NotFiniteError, linear_law, linear_plant
from hexservo.findings.analysis.loop_of_scenario import NotApplicableError, quiet
from hexservo.findings.analysis.reach import reach_of_start_and_goal
from hexservo.findings.analysis.scene import Scene, scene_of
from hexservo.findings.check_gains import of_gains
from hexservo.findings.check_gate import of_gate, predicts
from hexservo.findings.check_machine import of_machine
from hexservo.findings.check_motion import of_motion
from hexservo.findings.check_period import of_period
from hexservo.findings.check_points import of_points
from hexservo.findings.check_target import of_target
from hexservo.findings.check_tracking import of_tracking
from hexservo.scenario.arrays import Array
from hexservo.scenario.blocks import Robot, preset_values
from hexservo.scenario.fitted import auto_of, chosen_keys, fitted_keys, gains_written, idle_gains
from hexservo.scenario.keys import default_of, keys_below, value_at
from hexservo.scenario.laws import ALL_LAWS, LAWS, SMOOTH_KINDS, Controller, laws_with
from hexservo.scenario.motion import Road, moves
from hexservo.scenario.parameters import frame_period
from hexservo.scenario.pixels import on_pinhole, points_outside
from hexservo.scenario.plain import plain
from hexservo.scenario.presets import ROBOT_PRESETS
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import number, quantity

_OFF_CENTRE = 0.15  # of the image, most that the principal point of a usual lens is off its centre

_T = TypeVar("_T")


def unlikely(scenario: Scenario, *, by_law: bool = True) -> list[str]:
    """Return a sentence for each legal but probably unintended setting.

    Compares the weight at home with the force limits, home with the base, the stroke with the leg lengths, start and
    goal with stroke, joint limits and image, the start's twist with the speed limit, the principal point with the
    image, the points of the target with the noise (`of_points`), times of the camera and of the metrics with the
    duration, the motions of base and target with what machines do (`of_motion`), the period of frames with what finds
    an unknown latency, the gate with the target's motion (`of_gate`), the way of a target with reach, image and frames
    (`of_target`), the machine with what is built (`of_machine`), and in sampled mode the servo period with the loop of
    the gains, linearised at home with the switching term as in `linear_law`; gains with duration, servo rate, delays,
    forces and noise (`of_gains`); the filter of `tracking` with the target's motion (`of_tracking`). Gains with which
    numbers of that loop overflow have a sentence that names it.
    Does not simulate.

    Parameters
    ----------
    scenario
        What is checked.
    by_law
        False: a custom controller has the platform, so that servo period and gains of the law are not looked at. The
        gate is, since it acts on what any controller sees; an unknown latency is for legs that take positions alone,
        which no custom controller moves.
    """
    scene = scene_of(scenario)
    sentences: list[str] = []
    for check in (_of_legs, of_machine, _of_goal, of_points, of_gate, of_target):
        sentences += _evaluated(check, scene)
    for of_scenario in (_of_image, _of_principal_point, _of_duration, _of_dropout, of_motion, _of_unknown_latency):
        sentences += _evaluated(of_scenario, scenario)
    return sentences + (_evaluated(_of_rates, scene) + _evaluated(of_tracking, scene) if by_law else [])


def _evaluated(check: Callable[[_T], Iterator[str]], of: _T) -> list[str]:
    """Return the sentences of a check, with one in place of those that extreme numbers of the scenario leave out."""
    sentences: list[str] = []
    try:
        with np.errstate(all="ignore"):
            sentences.extend(check(of))
    except (ValueError, np.linalg.LinAlgError) as error:
        sentences.append(f"scenario: a check cannot be evaluated, since numbers overflow ({error})")
    return sentences


def _of_rates(scene: Scene) -> Iterator[str]:
    fastest = None
    try:
        fastest = fastest_rate(scene)
    except NotFiniteError as error:
        law = scene.scenario.controller.law
        yield f"controller.{law}: the gains' bandwidth cannot be evaluated, since numbers overflow ({error})"
        return
    except (NoRestError, NotApplicableError):  # no law can be evaluated at home
        pass
    yield from of_period(scene.scenario, fastest)
    yield from of_gains(scene, fastest)


def _of_legs(scene: Scene) -> Iterator[str]:
    robot = scene.scenario.robot
    share = 1.0 - np.array(scene.settings["uncertainty.gravity"])
    weight = share * scene.settings.plant_body.weight(scene.home.quaternion)
    forces = scene.hexapod.leg_forces(scene.home.position, scene.home.quaternion, weight)
    leg, unit = int(np.abs(forces).argmax()), scene.units.effort
    friction = scene.scenario.actuators.motor.friction
    rubs = scene.scenario.actuators.kind == "position_torque" and friction > 0.0
    if not rubs and abs(forces[leg]) > robot.force_limit:
        yield (
            f"robot.force_limit: {number(robot.force_limit)} {unit} is less than the {number(abs(forces[leg]))} {unit} "
            f"that leg {leg + 1} needs to carry the platform's weight at home"
        )
    if rubs and robot.force_limit <= friction + abs(forces[leg]):
        yield (
            f"robot.force_limit: {number(robot.force_limit)} {unit} does not move leg {leg + 1} against "
            f"actuators.motor.friction, {number(friction)} {unit}, and the {number(abs(forces[leg]))} {unit} of the "
            "platform's weight at home"
        )
    z_down = robot.gravity[2] >= 0
    upward = -1.0 if z_down else 1.0
    sight = scene.settings.camera.in_mount(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0]]))
    in_hand = scene.scenario.camera.mount.on == "platform"  # one on the base looks where its platform hangs
    looks_up = in_hand and upward * float(np.diff(scene.home.carried(sight)[:, 2])[0]) > 0
    if upward * robot.home_position[2] < 0 and looks_up:  # a platform that hangs has a camera that looks down
        above = "negative" if z_down else "positive"
        yield (
            f"robot.home_position: z = {quantity(robot.home_position[2], 'm')} puts home below the base, with a camera "
            f"that looks up at it, since z points {'down' if z_down else 'up'}; above the base z is {above}"
        )
    shortest = float(np.min(scene.hexapod.home_lengths))
    if robot.stroke > shortest and not scene.hexapod.rotary:
        yield (
            f"robot.stroke: {quantity(robot.stroke, 'm')} either way is longer than a leg, of "
            f"{quantity(shortest, 'm')} at home"
        )


def _of_goal(scene: Scene) -> Iterator[str]:
    reach = reach_of_start_and_goal(scene.scenario)
    if not reach.start.within:
        yield f"simulation.start.pose: the start is out of reach: {reach.start.beyond}"
    speed = _start_speed(scene)
    limit, rate = scene.scenario.robot.speed_limit, scene.units.rate
    if limit is not None and speed > limit:
        yield (
            f"robot.speed_limit: {quantity(limit, rate)} is less than the {quantity(speed, rate)} of a leg at the "
            "start (simulation.start.twist)"
        )
    if reach.residual > scene.band:
        yield (
            "target.desired_features: no pose with these features was found; the best one leaves "
            f"{number(reach.residual)} px"
        )
    elif reach.goal_within is False and reach.nearest is not None:
        yield f"target.desired_features: the goal is out of reach: {reach.nearest.beyond}"
    if scene.settled_start is not None:
        yield (
            f"metrics.band: the start is within {number(scene.band)} px of the goal "
            f"({number(scene.settled_start)} px), so that a run that stays there counts as settled without a motion; "
            "a narrower band shows whether the law gets to the goal"
        )


def _start_speed(scene: Scene) -> float:
    """Return the largest leg rate at the start [m/s]."""
    return float(np.abs(scene.leg_rates(scene.start, scene.settings["simulation.start.twist"])).max())


def _of_image(scenario: Scenario) -> Iterator[str]:
    if scenario.camera.image_size is None:
        return
    width, height = scenario.camera.image_size
    scene = scene_of(scenario)
    seen = {
        "target.desired_features: the goal": scene.desired,
        "target: the start": scene.view(scene.start).features,
    }
    for what, features in seen.items():
        outside = np.flatnonzero(points_outside(scenario, features)) + 1
        if len(outside):
            points = f"point{'s' if len(outside) > 1 else ''} {', '.join(map(str, outside))}"
            yield f"{what} is outside the image of {width:.0f} x {height:.0f} px ({points})"


def _of_principal_point(scenario: Scenario) -> Iterator[str]:
    """Find a size that is not that of the calibrated image, such as height and width in the wrong order."""
    camera = scenario.camera
    if camera.image_size is None or camera.principal_point is None:
        return
    size, point = np.asarray(camera.image_size), np.asarray(camera.principal_point)
    centre = (size - 1.0) / 2.0
    if (np.abs(point - centre) > _OFF_CENTRE * size).any():
        yield (
            f"camera.principal_point: ({number(point[0])}, {number(point[1])}) px is more than {_OFF_CENTRE:.0%} of "
            f"the image from its centre, ({number(centre[0], 4)}, {number(centre[1], 4)}) px; camera.image_size is "
            f"width and height of the calibrated image, here {size[0]:.0f} x {size[1]:.0f} px"
        )


def _of_duration(scenario: Scenario) -> Iterator[str]:
    """Find times that a run is too short for. The first image is exposed at its start."""
    consequences = {
        "camera.latency": "no image arrives in the run",
        "camera.period": "the image exposed at the start is the only one of the run",
        "metrics.dwell": "no run that starts outside metrics.band settles",
        "metrics.rms_start": "the RMS error is averaged over nothing",
    }
    duration = scenario.simulation.duration
    for key, consequence in consequences.items():
        time = value_at(scenario, key)
        if time is not None and time >= duration:
            yield (
                f"{key}: {quantity(time, 's')} is not shorter than simulation.duration, {quantity(duration, 's')}, so "
                f"that {consequence}"
            )
    steps = round(duration / scenario.simulation.step)
    if scenario.robot.limits_every > steps:
        yield (
            f"robot.limits_every: {scenario.robot.limits_every} is more than the {steps} steps of the run, so that "
            "limits and metrics of the legs are looked at where it starts and nowhere else"
        )


def _of_dropout(scenario: Scenario) -> Iterator[str]:
    if scenario.camera.dropout == 1.0:
        yield "camera.dropout: 1 loses every frame, so that no image arrives in the run"


def _of_unknown_latency(scenario: Scenario) -> Iterator[str]:
    if scenario.camera.latency_known or scenario.controller.traits.output != "pose":
        return
    period = frame_period(scenario)
    if period > _core.LONGEST_FRAME_GAP:
        yield (
            f"camera.latency_known: false with a frame every {quantity(period, 's')}: the latency is never found, "
            f"since frames more than {quantity(_core.LONGEST_FRAME_GAP, 's')} apart are not compared"
        )


def fastest_rate(scene: Scene) -> float:
    """Return the largest magnitude of the poles of law and plant [1/s], in continuous time, linear at home.

    The law is that of the servo tick with a fresh image (`linear_law`), the plant the actual one (`linear_plant`); the
    weights of the fuzzy systems are constant. `tanh` and `saturation` have their slope at rest; otherwise
    K_v = 0, since dry friction has no pole. Where drives take positions, a law whose output is a twist moves at it,
    and a law whose output is a pose has the double pole of its reference.

    Raises
    ------
    NoRestError
        The law cannot be evaluated at home.
    NotFiniteError
        A `NoRestError`: the gains are so large that the law or the loop overflows.
    """
    controller = scene.scenario.controller
    if controller.traits.output == "pose":
        return 2.0 * math.pi * float(controller.gains.bandwidth)
    calm = on_pinhole(quiet(scene.scenario))  # the linear law is of features
    if calm.legs_follow_twists:
        weightless = calm.updated({"robot.gravity": [0.0, 0.0, 0.0]})  # the twist carries no weight
        law = linear_law(weightless, scene_of(weightless), scene.home)
        return _largest(lambda: np.asarray(np.linalg.solve(-law.twist, law.frame[:, :6] + law.pose)))
    law = linear_law(calm, scene_of(calm), scene.home, smooth=_has_slope(scene.scenario))
    push = linear_plant(calm, scene.home).acceleration

    def state_matrix() -> Array:
        by_pose, by_twist = push @ (law.frame[:, :6] + law.pose), push @ law.twist
        return np.asarray(np.block([[np.zeros((6, 6)), np.eye(6)], [by_pose, by_twist]]))

    return _largest(state_matrix)


def _largest(rates: Callable[[], Array]) -> float:
    """Return the largest magnitude of the eigenvalues of a matrix, the poles of a loop [1/s]."""
    largest = math.inf
    with np.errstate(over="ignore", invalid="ignore"), contextlib.suppress(np.linalg.LinAlgError):  # refused below
        largest = float(np.abs(np.linalg.eigvals(rates())).max())
    if not math.isfinite(largest):
        raise NotFiniteError("controller: expected gains that give finite poles, got poles that are not finite")
    return largest


# ---- Keys without effect --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Condition:
    """Keys that act only under a condition."""

    keys: tuple[str, ...]  # blocks or keys
    acts: Callable[[Scenario], bool]
    when: str  # the condition, as it follows "they act"
    can_be_met: bool = True  # by other settings of the scenario


def _switches(scenario: Scenario) -> bool:
    return scenario.controller.law in laws_with("switching")


def _has_slope(scenario: Scenario) -> bool:
    return _switches(scenario) and scenario.controller.switching.kind in SMOOTH_KINDS


def _uses_exposures(scenario: Scenario) -> bool:
    return predicts(scenario) or scenario.camera.timeout is not None or scenario.controller.law not in LAWS


def _with(keys: Iterable[str], setting: str, value: str) -> _Condition:
    return _Condition(
        tuple(keys), lambda scenario: value_at(scenario, setting) == value, f"only with {setting}: {value}"
    )


def _above_zero(key: str, setting: str) -> _Condition:
    return _Condition((key,), lambda scenario: value_at(scenario, setting) > 0, f"only with {setting} above 0")


def _of_fuzzy(law: str) -> _Condition:
    block = f"controller.{law}.fuzzy"

    def enabled(scenario: Scenario) -> bool:
        return scenario.controller.law != law or value_at(scenario, f"{block}.enabled") is True

    return _Condition((block,), enabled, f"only with {block}.enabled: true")


def _of_auto(law: str) -> tuple[_Condition, ...]:
    block = f"controller.{law}.auto"

    def fits(scenario: Scenario) -> bool:
        if scenario.controller.law != law or auto_of(scenario).bandwidth is None:
            return True
        follow = set(fitted_keys(law)).difference(chosen_keys(scenario), idle_gains(scenario))
        return bool(follow if _adapts(scenario, law) else follow.difference(_ADAPTIVE))

    def has_bandwidth(scenario: Scenario) -> bool:
        return scenario.controller.law != law or auto_of(scenario).bandwidth is not None

    bandwidth = _Condition((block,), fits, f"only where one of {', '.join(fitted_keys(law))} acts and is not given")
    if law not in LAWS:  # whose fitted gains have no damping
        when = f"only in the blocks of other laws, since the motion of {law} is critically damped"
        return bandwidth, _Condition(
            (f"{block}.damping",), lambda scenario: scenario.controller.law != law, when, False
        )
    return bandwidth, _Condition((f"{block}.damping",), has_bandwidth, f"only with {block}.bandwidth")


_ADAPTIVE = ("gain_far", "gain_slope")


def _adapts(scenario: Scenario, law: str) -> bool:
    return scenario.controller.law != law or getattr(scenario.controller.gains, "adaptive", True) is True


def _of_adaptive_gain(law: str) -> _Condition:
    block = f"controller.{law}"
    keys = tuple(f"{block}.{name}" for name in _ADAPTIVE)
    return _Condition(keys, lambda scenario: _adapts(scenario, law), f"only with {block}.adaptive: true")


def _of_motion(block: str, keys: str, kind: str) -> _Condition:
    return _with((f"{block}.{key}" for key in keys.split()), f"{block}.kind", kind)


_CONDITIONS = (
    *(_with((f"controller.{law}",), "controller.law", law) for law in ALL_LAWS),
    *map(_of_fuzzy, laws_with("memory")),
    *(condition for law in ALL_LAWS for condition in _of_auto(law)),
    *(_of_adaptive_gain(law) for law in ALL_LAWS if hasattr(getattr(Controller(), law), "adaptive")),
    _Condition(("controller.switching.kind",), _switches, f"only with the laws {' and '.join(laws_with('switching'))}"),
    _Condition(("controller.switching.width",), _has_slope, "only where the switching term is tanh or saturation"),
    _above_zero("robot.payload.known", "robot.payload.mass"),
    _above_zero("camera.outlier_size", "camera.outlier_probability"),
    _above_zero("camera.outlier_probability", "camera.outlier_size"),
    _Condition(
        ("uncertainty.latency",),
        _uses_exposures,
        "only where an exposure counts: with camera.prediction: encoder, camera.on_lost: predict, camera.timeout, or "
        f"the law {' or '.join(law for law in ALL_LAWS if law not in LAWS)}",
    ),
    _Condition(
        ("camera.on_lost",),
        lambda scenario: (
            scenario.camera.image_size is not None or (scenario.camera.gate is not None and predicts(scenario))
        ),
        "only with camera.image_size or an acting camera.gate",
    ),
    _Condition(("camera.gate",), predicts, "only with camera.prediction: encoder or camera.on_lost: predict"),
    _with((f"sensors.{key}" for key in ("rate", "resolution", "noise", "period")), "sensors.pose", "encoders"),
    _of_motion("base_motion", "amplitude frequency phase", "sinusoid"),
    _of_motion("base_motion", "level low_frequency high_frequency", "noise"),
    _of_motion("base_motion", "samples attitudes sample_period", "recorded"),
    _of_motion("base_motion", " ".join(f"road.{key}" for key in Road.model_fields), "road"),
    _of_motion("base_motion.rotation", "amplitude frequency phase", "sinusoid"),
    _of_motion("base_motion.rotation", "level low_frequency high_frequency", "noise"),
    _of_motion("target.motion", "velocity", "velocity"),
    _of_motion("target.motion", "amplitude frequency phase", "sinusoid"),
    _of_motion("target.motion", "samples sample_period", "recorded"),
    _Condition(
        ("target.frame",), lambda scenario: moves(scenario.base_motion), "only where the base moves (base_motion.kind)"
    ),
)


_OF_PRESETS = (  # in which machines differ
    *(f"{side}_{what}" for side in ("platform", "base") for what in ("radius", "angles", "joints")),
    *("home_position", "mass", "inertia", "stroke", "force_limit"),
)


def _of_preset(robot: Robot) -> Iterator[str]:
    """Find a preset that gives a machine next to nothing, as where only its name was changed in a resolved file."""
    if robot.preset is None:
        return
    given = plain(robot)
    equal = {
        name: [given[key] == value for key in _OF_PRESETS if (value := preset_values(name)[key]) is not None]
        for name in ROBOT_PRESETS
    }
    other = next((name for name in ROBOT_PRESETS if name != robot.preset and all(equal[name])), None)
    if other is not None or sum(equal[robot.preset]) <= 1:
        whose = "" if other is None else f', those of "{other}"'
        yield (
            f'robot.preset: "{robot.preset}" has no effect here, since other values of the machine are given{whose}; '
            "drop those keys, and the preset gives them"
        )


def keys_without_effect(scenario: Scenario) -> list[str]:
    """Return a sentence for each group of keys that differ from their defaults and have no effect.

    So does a preset of the robot whose keys have, nearly all, other values.

    They are legal: a scenario keeps them when its law is replaced in a comparison or its outliers are switched off.
    """
    sentences = list(_of_preset(scenario.robot))
    for condition in _CONDITIONS:
        if condition.acts(scenario):
            continue
        keys = [key for name in condition.keys for key in keys_below(name) if not key.endswith(".enabled")]
        keys = [key for key in keys if value_at(scenario, key) != default_of(key)]
        if keys:
            has, acts = ("has", "it acts") if len(keys) == 1 else ("have", "they act")
            sentences.append(f"{', '.join(keys)}: {has} no effect here; {acts} {condition.when}")
    return sentences


def needed_by(key: str, scenarios: Iterable[Scenario]) -> str:
    """Return what a key needs to act, and what to do, as it follows "it acts"; "" where it acts in one of scenarios.

    A bandwidth of `auto` is looked at as if the scenarios had one: in a campaign they do.
    """
    bandwidths = _SOME_BANDWIDTHS if key.endswith(".auto.bandwidth") else ()
    given = [[scenario.updated({key: each}) for each in bandwidths] or [scenario] for scenario in scenarios]
    for condition in _CONDITIONS:
        below = any(f"{key}.".startswith(f"{name}.") for name in condition.keys)
        if below and not any(condition.acts(scenario) for scenario, *_ in given):
            return f"{condition.when}; {_MEET_OR_DROP if condition.can_be_met else 'drop the key'}"
    if bandwidths and all(gains_written(one) == gains_written(other) for one, other in given):
        return f"only where a gain that follows from it acts and is not given; {_MEET_OR_DROP}"
    return ""


_MEET_OR_DROP = "set that in the scenario, or drop the key"
_SOME_BANDWIDTHS = (1.0, 2.0)  # [Hz]; any two differ in every gain that depends on it
