"""Legal but probably unintended settings of a scenario: for ``hexservo check``; keys without effect: `check_keys`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.linear_law import NoRestError, NotFiniteError, too_long_a_period
from hexservo.findings.analysis.loop_of_scenario import NotApplicableError
from hexservo.findings.analysis.reach import reach_of_start_and_goal
from hexservo.findings.analysis.scene import Scene, scene_of
from hexservo.findings.analysis.stiction_motors import rubs
from hexservo.findings.check_adaptation import of_adaptation
from hexservo.findings.check_base import of_base, of_drift
from hexservo.findings.check_brake import of_brake
from hexservo.findings.check_gains import of_gains
from hexservo.findings.check_gate import of_gate, of_gate_without_timeout
from hexservo.findings.check_hold import of_hold
from hexservo.findings.check_joints import of_joints
from hexservo.findings.check_keys import keys_without_effect
from hexservo.findings.check_lag import of_lag
from hexservo.findings.check_machine import of_machine
from hexservo.findings.check_motion import of_motion
from hexservo.findings.check_observability import of_observability
from hexservo.findings.check_overshoot import of_overshoot
from hexservo.findings.check_period import of_period, of_step
from hexservo.findings.check_points import of_points
from hexservo.findings.check_positions import of_positions
from hexservo.findings.check_prior import of_prior
from hexservo.findings.check_slow import of_slow
from hexservo.findings.check_target import of_target
from hexservo.findings.check_tracking import of_tracking
from hexservo.findings.check_view import of_plane, of_straight_way
from hexservo.findings.home_loop import poles_at_home
from hexservo.findings.misread import readings_of_goal
from hexservo.scenario.arrays import Array
from hexservo.scenario.goal_readings import question
from hexservo.scenario.keys import value_at
from hexservo.scenario.parameters import frame_period
from hexservo.scenario.pixels import points_outside
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import apart, number, quantity

_OFF_CENTRE = 0.15  # of the image, most that the principal point of a usual lens is off its centre
_OF_OTHER_SIZE = 0.05  # the same along both axes at once, where it is near the centre of an image of height x width
_NEARER = 0.5  # of its distance from the image's centre, most that it is then from the other one

_T = TypeVar("_T")


def unlikely(scenario: Scenario, *, by_law: bool = True) -> list[str]:
    """Return a sentence for each legal but probably unintended setting.

    Compares the weight at home with the force limits, home with the base, the stroke with the leg lengths, start and
    goal with stroke, joint limits and image, the start's twist with the speed limit, the principal point with the
    image, the points of the target with the noise (`of_points`), times of the camera and of the metrics with the
    duration, the recorded motions of base and target with what machines do (`of_motion`), tilt, rate and
    acceleration of a base with vehicles and the force limits (`of_base`), the period of frames with what finds
    an unknown latency, the gate with the noise and the target's motion (`of_gate`), the way to the goal with the image
    and the plane of the points (`of_straight_way`, `of_plane`), the way of a target with reach, image and frames
    (`of_target`), the machine with what is built (`of_machine`), limits and motors of legs that take positions
    with each other, duration and weight (`of_positions`), the servo period in sampled mode, or the step of the
    integration in continuous mode, with the loop of the gains, linearised at home with the switching term as in
    `linear_law`; gains with what the run needs (`of_slow`), what legs stop with (`of_overshoot`), duration, servo
    rate, delays, forces and noise (`of_gains`); delay and lag of drives of forces, and drive and adaptation of fuzzy
    systems, with the linear loop (`of_lag`, `of_adaptation`), the filter of `tracking` with the target's motion
    (`of_tracking`), what runs that begin at the goal leave of it, before a target at rest and before one that moves
    (`of_hold`), what encoders read with the image and the fuzzy inputs (`of_joints`). Gains with which numbers of that
    loop overflow have a sentence that names it.
    Simulates how the goal is kept and how a target in motion is followed, in a second or some.

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
    machine = (_of_legs, _of_drives, of_positions, of_machine)
    for check in (*machine, _of_goal, of_plane, of_points, of_gate, of_target, of_base):
        sentences += evaluated(check, scene)
    for of_scenario in (_of_image, _of_principal_point, _of_duration, _of_dropout, of_motion, _of_unknown_latency):
        sentences += evaluated(of_scenario, scenario)
    laws = (_of_rates, of_lag, of_adaptation, of_straight_way, of_tracking, of_hold, of_joints)
    for of_law in laws if by_law else ():
        sentences += evaluated(of_law, scene)
    return sentences


def notes(scenario: Scenario) -> list[str]:
    """Return a sentence for each key without effect, on what an image and a prior leave of the pose, drift and brake.

    They are those of `of_observability`, `of_prior`, `of_drift` and `of_brake`; a gate without timeout is a note too.
    The brake (which simulates) acts in a run that has a timeout of the camera; on a robot it acts in any case, and
    `robot_notes` has its sentence.
    """
    scene = scene_of(scenario)
    found = [*keys_without_effect(scenario), *of_gate_without_timeout(scenario)]
    for check in (of_observability, of_prior, of_drift):
        found += evaluated(check, scene)
    brakes = scenario.sampled and scenario.camera.timeout is not None
    return found + (evaluated(of_brake, scene) if brakes else [])


def evaluated(check: Callable[[_T], Iterator[str]], of: _T) -> list[str]:
    """Return the sentences of a check, with one in place of those that extreme numbers of the scenario leave out."""
    sentences: list[str] = []
    try:
        with np.errstate(all="ignore"):
            sentences.extend(check(of))
    except (ValueError, np.linalg.LinAlgError) as error:
        sentences.append(f"scenario: a check cannot be evaluated, since numbers overflow ({error})")
    return sentences


def _of_rates(scene: Scene) -> Iterator[str]:
    poles = None
    if reason := too_long_a_period(scene.scenario):
        yield (
            f"simulation.step: {reason}, so that hs.Controller and exports refuse the scenario; simulations run. "
            "Take a shorter one for a machine"
        )
    try:
        poles = poles_at_home(scene)
    except NotFiniteError as error:
        law = scene.scenario.controller.law
        yield f"controller.{law}: the gains' bandwidth cannot be evaluated, since numbers overflow ({error})"
        return
    except (NoRestError, NotApplicableError):  # no law can be evaluated at home
        pass
    if poles is not None:
        yield from of_period(scene.scenario, float(np.abs(poles).max()))
        yield from of_step(scene.scenario, poles)
    yield from of_gains(scene)
    if poles is not None:
        yield from of_slow(scene)
        yield from of_overshoot(scene)


def _of_legs(scene: Scene) -> Iterator[str]:
    robot, forces = scene.scenario.robot, scene.resting_forces(scene.home)
    leg, unit = int(np.abs(forces).argmax()), scene.units.effort
    sticks = rubs(scene.scenario)
    needed = abs(forces[leg]) + (scene.scenario.actuators.motor.friction if sticks else 0.0)
    takes, has = apart(needed, robot.force_limit, 3)
    if not sticks and needed > robot.force_limit:
        yield (
            f"robot.force_limit: {has} {unit} is less than the {takes} {unit} that leg {leg + 1} needs to carry the "
            "platform's weight at home"
        )
    if sticks and needed >= robot.force_limit:
        yield (
            f"robot.force_limit: {has} {unit} does not move leg {leg + 1} against actuators.motor.friction and the "
            f"platform's weight at home, together {takes} {unit}"
        )
    z_down = robot.gravity[2] >= 0
    upward = -1.0 if z_down else 1.0
    sight = scene.settings.camera.in_mount(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0]]))
    in_hand = scene.scenario.camera.mount.on == "platform"  # one on the base looks where its platform hangs
    looks_up = in_hand and upward * float(np.diff(scene.home.carried(sight)[:, 2])[0]) > 0
    upright = abs(robot.gravity[2]) > math.hypot(*robot.gravity[:2])
    # a platform that hangs has a camera that looks down
    if upright and upward * robot.home_position[2] < 0 and looks_up:
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


def _of_drives(scene: Scene) -> Iterator[str]:
    """Find rounding and friction that leave the drives of a sampled scenario nothing to act with."""
    scenario, units = scene.scenario, scene.units
    if not scenario.sampled:
        return
    actuators, motor, stroke = scenario.actuators, scenario.actuators.motor, scenario.robot.stroke
    largest = float(np.abs(scene.resting_forces(scene.home)).max())
    if actuators.kind == "force" and 0.0 < largest < 0.5 * actuators.quantisation:
        yield (
            f"actuators.quantisation: {quantity(actuators.quantisation, units.effort)} rounds to 0 what the legs carry "
            f"the platform with at home, at most {quantity(largest, units.effort)}"
        )
    if actuators.kind != "position_torque":
        return
    if motor.quantisation > stroke:
        yield (
            f"actuators.motor.quantisation: {quantity(motor.quantisation, units.coordinate)} leaves a leg one or two "
            f"positions within its stroke, {quantity(stroke, units.coordinate)} either way"
        )
    if motor.friction > motor.kp * stroke:
        needed = quantity(motor.friction / motor.kp, units.coordinate)
        yield (
            f"actuators.motor.kp: a leg at rest overcomes actuators.motor.friction only for a command {needed} away, "
            f"beyond its stroke, {quantity(stroke, units.coordinate)} either way"
        )


def _of_goal(scene: Scene) -> Iterator[str]:
    reach = reach_of_start_and_goal(scene.scenario)
    if not reach.start.within:
        yield f"simulation.start.pose: the start is out of reach: {reach.start.beyond}"
    speed = float(np.abs(scene.leg_rates(scene.start, scene.settings["simulation.start.twist"])).max())
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
    if readings := readings_of_goal(scene):
        yield f"target.desired_features: {question(readings)}"
    if scene.settled_start is not None:
        yield (
            f"metrics.band: the start is within {number(scene.band)} px of the goal "
            f"({number(scene.settled_start)} px), so that a run that stays there counts as settled without a motion; "
            "a narrower band shows whether the law gets to the goal"
        )


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
    if has_sides_exchanged(size, point):
        width, height = (f"{side:.0f}" for side in size)
        other, given = (number(float(np.linalg.norm(point - one))) for one in (centre[::-1], centre))
        yield (
            f"camera.principal_point: ({number(point[0], 4)}, {number(point[1], 4)}) px is {other} px from the centre "
            f"of an image of {height} x {width} px, and {given} px from that of camera.image_size, {width} x {height} "
            "px: the width comes first in it"
        )
    elif (np.abs(point - centre) > _OFF_CENTRE * size).any():
        yield (
            f"camera.principal_point: ({number(point[0])}, {number(point[1])}) px is more than {_OFF_CENTRE:.0%} of "
            f"the image from its centre, ({number(centre[0], 4)}, {number(centre[1], 4)}) px; camera.image_size is "
            f"width and height of the calibrated image, here {size[0]:.0f} x {size[1]:.0f} px"
        )


def has_sides_exchanged(size: Array, point: Array) -> bool:
    """Return whether a principal point is rather that of an image whose width is the height of this one.

    It is off the centre along both axes by more than usual lenses are, and at most half as far from the other centre.

    Parameters
    ----------
    size
        (2,) width and height of the image [px].
    point
        (2,) principal point, from the centre of the first pixel [px].
    """
    off, of_other = point - (size - 1.0) / 2.0, point - (size[::-1] - 1.0) / 2.0
    unusual = bool((np.abs(off) > _OF_OTHER_SIZE * size).all())
    return unusual and float(np.linalg.norm(of_other)) < _NEARER * float(np.linalg.norm(off))


def _of_duration(scenario: Scenario) -> Iterator[str]:
    """Find times that a run is too short for. The first image is exposed at its start."""
    consequences = {
        "camera.latency": "no image arrives in the run",
        "camera.period": "the image exposed at the start is the only one of the run",
        "actuators.delay": "no command arrives in the run",
        "metrics.dwell": "no run that starts outside metrics.band settles",
        "metrics.rms_start": "the RMS error is averaged over nothing",
    }
    duration = scenario.simulation.duration
    for key, consequence in consequences.items():
        time = value_at(scenario, key)
        at_end = key == "metrics.rms_start" and time == duration
        if time is not None and time >= duration:
            yield (
                f"{key}: {quantity(time, 's')} is not shorter than simulation.duration, {quantity(duration, 's')}, so "
                f"that {'the RMS error is that of the last sample' if at_end else consequence}"
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


def known_rate(scenario: Scenario) -> float | None:
    """Return the `fastest_rate` of a scenario [1/s]; None where its law cannot be evaluated at home."""
    try:
        return fastest_rate(scene_of(scenario))
    except (NoRestError, NotApplicableError):  # `hexservo check` gives the reason
        return None


def fastest_rate(scene: Scene) -> float:
    """Return the largest magnitude of the `poles_at_home` [1/s], and raise as they do."""
    return float(np.abs(poles_at_home(scene)).max())
