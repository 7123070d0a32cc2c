"""The machine of a scenario as an MJCF file, which MuJoCo reads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
from scipy.spatial.transform import Rotation

from hexservo import _core
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import Scene, scene_of
from hexservo.scenario.arrays import Array
from hexservo.scenario.block import SAMPLED_MODE
from hexservo.scenario.keys import default_of, keys_below, value_at
from hexservo.scenario.leg_units import leg_units
from hexservo.scenario.scenario import Scenario, require_scenario
from hexservo.scenario.version import VERSION
from hexservo.scenario.wording import apart

TITLE = "<!-- hexservo MJCF, format 1 -->"
"""First line of every exported model, which distinguishes it from other files."""

LEFT_OUT = (
    "robot.speed_limit", "robot.joint_limit", "robot.on_limit", "camera.distortion", "camera.period", "camera.latency",
    "camera.latency_jitter", "camera.noise", "camera.quantisation", "camera.dropout", "camera.outlier_probability",
    "camera.outlier_size", "camera.smoothing", "sensors", "actuators.bandwidth", "actuators.delay",
    "actuators.quantisation", "actuators.motor.quantisation", "base_motion", "target.frame", "target.motion",
    "uncertainty",
)  # fmt: skip
"""Blocks and keys of machine, camera, sensors and surroundings that no model has."""

_RESOLUTION = (640.0, 480.0)  # [px], of a camera without a border
_LIGHT = 3e-6  # inertia of a crank, of that of the platform as a mass at its end
# [kg m^2] about each axis, of a crank as a body: ten times what MuJoCo takes for zero and refuses. A platform of 1 g at
# the end of a crank of 1 mm has 1e-9.
_LEAST_INERTIA = 1e-14
_YIELD = 1e-6  # of a crank's length, by which rods may yield under the weight
_IMPEDANCE = 0.9999  # largest share of a constraint's acceleration that MuJoCo enforces
_SOLVER = ' solver="Newton" tolerance="0" iterations="100"'
_ROUNDING = 1e-14  # of a principal moment of inertia, as MuJoCo finds it
_PIXEL = 1e-5  # [m], width of a sensor's pixel, which has no effect on the image


def mjcf(scenario: Scenario) -> str:
    """Return the machine of a scenario as an MJCF model: legs with motors, platform, camera and target.

    The world frame is B, whose z points along gravity of the usual scenarios. The platform is a free body with mass
    and inertia of platform and payload. Each leg is a spatial tendon from a base joint to a platform joint, with a
    motor of gear 1: its control is the leg force [N], positive where it pushes, or where ``actuators.kind`` is
    position_torque the leg's commanded length [m] (of a crank its angle). Tendons have no mass, as the legs of
    the model (docs/model.md, section 3), and close the chain by their force alone: nothing is added to the machine, no
    leg mass and no equality constraint. The step is that of the scenario's plant and the integrator RK4, so that MuJoCo
    follows the plant to rounding under leg forces that are constant over a step. Where ``actuators.kind`` is
    position_torque the plant takes 8 steps in a substep, and so does the model.

    A rotary leg is a crank on a hinge, with a motor whose control is its torque [N m], and a rod: a tendon whose length
    an equality constraint keeps. MuJoCo takes neither cranks without inertia nor constraints that do not yield: the
    cranks have 3e-6 of the platform's inertia, and the step is a whole part of the one above, so short that rods
    yield by less than 1e-6 of a crank's length under the weight.

    Not in the model: the controller, the relative errors ``uncertainty``, ``sensors``, times and faults of the camera,
    distortion of the lens, ``actuators.bandwidth``, ``delay`` and ``quantisation``, motion of base and target, and the
    limits of speed and joints. `not_in_model` names those keys that a scenario sets. Strokes are written as ranges that
    do not act, since a leg beyond its stroke is an event in hexservo, no stop. Force limits act where
    ``actuators.saturation`` is set.

    Parameters
    ----------
    scenario
        With a camera that projects (`eye_in_hand`).

    Returns
    -------
    str
        The model. Names: body ``platform``; sites ``base1`` to ``base6`` (of rotary legs the ends of the cranks),
        ``platform1`` to ``platform6``, ``target1`` and so on; tendons and actuators ``leg1`` to ``leg6``; of rotary
        legs bodies and joints ``crank1`` to ``crank6``, whose coordinates are the angles of the cranks [rad], after
        those of the platform; camera ``camera``; sensors ``image1`` and so on, the pixels of the target's points from
        the top left corner of the image [px], where the principal point is the centre of the image: OpenCV, and
        hexservo where the scenario has a principal point, count from the centre of the first pixel, so subtract 0.5 for
        pixels as `Controller.step` takes them; keyframes ``home`` and ``start``, the
        start of the scenario's run, with the leg forces that hold the platform there, or the commands at which the
        motors of position_torque give these.

    Raises
    ------
    TypeError
        For anything but a `Scenario`.
    ValueError
        For legs that follow positions whatever it takes, for a camera ``as_printed``, and for what the core refuses.
    """
    require_scenario(scenario)
    if scenario.actuators.kind == "position":
        raise ValueError(
            "actuators.kind: expected force or position_torque for MJCF, whose motors give forces, got position; "
            "position_torque keeps the law, with the stiffness of your drives as actuators.motor.kp"
        )
    scene = scene_of(scenario)
    if not scene.has_points:
        raise ValueError(
            "camera.convention: expected eye_in_hand for MJCF, got as_printed, whose target has no points in space"
        )
    settings, hexapod, body = scene.settings, scene.hexapod, scene.settings.plant_body
    step = _step(settings)
    cranks = _Cranks(scene, step) if hexapod.rotary else None
    step = step if cranks is None else cranks.step
    c = np.array(body.centre_of_mass)
    inertia = _inertia(body)
    reach = hexapod.platform_radius
    # MuJoCo's sensor of an image does not know the principal point
    seen = 0 if _off_centre(scenario, _image_size(scenario)).any() else len(scene.points)
    targets = [_site(f"target{i}", p, reach / 20, "0.9 0.6 0 1") for i, p in enumerate(scene.points, 1)]
    of_base, of_platform = targets, [_camera(scenario, settings)]
    if scenario.camera.mount.on == "base":
        of_base, of_platform = of_platform, of_base
    name = escape(scenario.name, {'"': "&quot;"})
    lines = [
        TITLE,
        f"<!-- Written by `hexservo export` of hexservo {VERSION}. SI units and radians. World: frame B. -->",
        f'<mujoco model="{name}">',
        '  <compiler angle="radian" autolimits="false"/>',
        f'  <option timestep="{step!r}" integrator="RK4" gravity="{_text(body.gravity)}"'
        f"{'' if cranks is None else _SOLVER}/>",
        f'  <statistic center="{_text(scene.home.position)}" extent="{float(4 * reach)!r}"/>',
        "  <worldbody>",
        *(
            []
            if cranks
            else (f"    {_site(f'base{leg}', p, reach / 20)}" for leg, p in enumerate(hexapod.base_joints, 1))
        ),
        *(f"    {line}" for line in of_base),
        f'    <body name="platform" {_pose(scene.home)}>',
        "      <freejoint/>",
        f'      <inertial pos="{_text(c)}" mass="{float(body.mass)!r}" '
        f'fullinertia="{_text(inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])}"/>',
        *(f"      {_site(f'platform{leg}', p, reach / 20)}" for leg, p in enumerate(hexapod.platform_joints, 1)),
        *(f"      {line}" for line in of_platform),
        "    </body>",
        *([] if cranks is None else cranks.bodies(reach / 20)),
        "  </worldbody>",
        "  <tendon>",
        *(
            f'    <spatial name="leg{leg}" width="{float(reach / 40)!r}" limited="false" '
            f'range="{_text([middle - scene.stroke, middle + scene.stroke] if cranks is None else [0.0, 0.0])}"'
            f"{'' if cranks else _resistance(scenario, step)}>"
            f'<site site="base{leg}"/><site site="platform{leg}"/></spatial>'
            for leg, middle in enumerate(hexapod.mid_lengths, 1)
        ),
        "  </tendon>",
        *([] if cranks is None else ["  <equality>", *cranks.constraints(), "  </equality>"]),
        "  <actuator>",
        *(f"    {_motor(leg, settings, rotary=hexapod.rotary)}" for leg in range(1, 7)),
        "  </actuator>",
        "  <sensor>",
        *(f'    <camprojection name="image{i}" site="target{i}" camera="camera"/>' for i in range(1, seen + 1)),
        "  </sensor>",
        "  <keyframe>",
        *(f"    <!-- {note[0].upper()}{note[1:]}. -->" for note in _key_notes(scene)),
        *(_key_line(scene, key) for key in _keys(scene)),
        "  </keyframe>",
        "</mujoco>",
    ]
    return "\n".join(lines) + "\n"


def not_in_model(scenario: Scenario) -> list[str]:
    """Return the keys that a scenario sets, other than to their defaults, and its model leaves out (`LEFT_OUT`)."""
    keys = (key for name in LEFT_OUT for key in keys_below(name))
    return [key for key in keys if value_at(scenario, key) != default_of(key)]


def hold_notes(scenario: Scenario) -> list[str]:
    """Return a clause where runs hold something else over a tick than the motors of a scenario's model do."""
    actuators = scenario.actuators
    if not (scenario.sampled and actuators.kind == "force" and actuators.hold == "wrench"):
        return []
    return [
        "actuators.hold: the motors of the model hold leg forces over a tick, and a run of this scenario the wrench; "
        "leg forces of a run with actuators.hold: leg_forces move both alike"
    ]


def keyframe_notes(scenario: Scenario) -> list[str]:
    """Return which keyframes of a scenario's model need more than the range of its actuators, a clause each."""
    return _key_notes(scene_of(scenario))


class _Cranks:
    """Rotary legs: bodies on hinges, rods of constant length, and the step that they need."""

    def __init__(self, scene: Scene, step: float) -> None:
        self.scene = scene
        body, home, hexapod = scene.settings.plant_body, scene.home, scene.hexapod
        given = scene.scenario.robot.cranks
        self.axes, self.length, self.rod = np.asarray(given.axes), float(given.length or 0.0), float(given.rod or 0.0)
        self.angles = np.asarray(hexapod.home_lengths)
        self.feet = np.asarray(hexapod.leg_feet(home.position, home.quaternion))
        # the lightest motion of the platform, in terms of a mass at its joints
        lightest = min(body.mass, float(np.linalg.eigvalsh(body.inertia)[0]) / scene.platform_radius**2)
        self.inertia = _LIGHT * lightest * self.length**2  # [kg m^2], of a crank about its axis
        # Without its rod the torque that carries the weight accelerates the end of a crank by a; with it, by the
        # share of a that a constraint lets pass. The rod yields by that over the constraint's stiffness, 1/step^2.
        torques = hexapod.leg_forces(home.position, home.quaternion, body.weight(home.quaternion))
        end = float(np.abs(torques).max()) / self.inertia * self.length
        longest = np.sqrt(_YIELD * self.length / max((1.0 - _IMPEDANCE) * end, 1e-300))
        self.step = step / int(np.ceil(step / longest))

    def bodies(self, size: float) -> list[str]:
        """Return a crank each, in its place at home."""
        return [
            f'    <body name="crank{leg}" pos="{_text(centre)}">'
            f'<joint name="crank{leg}" type="hinge" axis="{_text(axis)}" ref="{float(angle)!r}" '
            f'armature="{self.inertia + self.scene.scenario.actuators.motor.armature!r}" limited="false" '
            f'range="{_text([middle - self.scene.stroke, middle + self.scene.stroke])}"'
            f"{_resistance(self.scene.scenario, self.step, armature=False)}/>"
            f'<inertial pos="0 0 0" mass="{self.inertia / self.length**2!r}" '
            f'diaginertia="{_text([max(1e-6 * self.inertia, _LEAST_INERTIA)] * 3)}"/>'
            f'<geom type="capsule" fromto="{_text([0, 0, 0, *(foot - centre)])}" size="{size / 2!r}" mass="0" '
            f'contype="0" conaffinity="0"/>{_site(f"base{leg}", foot - centre, size)}</body>'
            for leg, centre, axis, angle, middle, foot in zip(
                range(1, 7),
                np.asarray(self.scene.hexapod.base_joints),
                self.axes,
                self.angles,
                self.scene.hexapod.mid_lengths,
                self.feet,
                strict=True,
            )
        ]

    def constraints(self) -> list[str]:
        """Return the equalities that keep the rods as long as at home, critically damped."""
        reference = f"{-(self.step**-2)!r} {-2.0 / self.step!r}"
        return [
            f'    <tendon name="rod{leg}" tendon1="leg{leg}" polycoef="0 0 0 0 0" solref="{reference}" '
            f'solimp="{_IMPEDANCE!r} {_IMPEDANCE!r} 0.001"/>'
            for leg in range(1, 7)
        ]


def _step(settings: _core.Settings) -> float:
    """Return the step in which the scenario's plant moves [s]."""
    steps = settings["simulation.substeps"] if settings["simulation.mode"] == SAMPLED_MODE else 1
    if settings["actuators.kind"] == "position_torque":
        steps *= _core.MOTOR_STEPS  # with one of a substep, motors that the core follows would be unstable
    return float(settings["simulation.step"]) / steps


def _inertia(body: _core.RigidBody) -> Array:
    """Return a body's inertia about its centre of mass (3, 3) [kg m^2], so that MuJoCo takes it.

    The core lets the largest principal moment exceed the sum of the other two by rounding, as that of a flat body may;
    MuJoCo does not. There all three are larger by what is missing.
    """
    c = np.array(body.centre_of_mass)
    inertia = body.inertia - body.mass * (c @ c * np.eye(3) - np.outer(c, c))
    least, middle, largest = np.linalg.eigvalsh(inertia)
    missing = largest - middle - least + _ROUNDING * largest
    return np.asarray(inertia + max(0.0, missing) * np.eye(3))


def _text(numbers: Any) -> str:
    return " ".join(repr(float(number)) for number in np.ravel(numbers))


def _pose(pose: Poses) -> str:
    return f'pos="{_text(pose.position)}" quat="{_text(pose.quaternion)}"'


def _site(name: str, position: Array, size: float, colour: str = "0.3 0.3 0.3 1") -> str:
    return f'<site name="{name}" pos="{_text(position)}" size="{float(size)!r}" rgba="{colour}"/>'


def _is_limited(settings: _core.Settings) -> bool:
    """Return whether the legs have no more than `robot.force_limit` in the model."""
    motors = settings["actuators.kind"] == "position_torque"
    return bool(motors or (settings["simulation.mode"] == SAMPLED_MODE and settings["actuators.saturation"]))


def _motor(leg: int, settings: _core.Settings, *, rotary: bool) -> str:
    limit = float(settings["robot.force_limit"])
    moves = f'joint="crank{leg}"' if rotary else f'tendon="leg{leg}"'
    if settings["actuators.kind"] == "position_torque":
        return (
            f'<position name="leg{leg}" {moves} kp="{settings["actuators.motor.kp"]!r}" '
            f'kv="{settings["actuators.motor.kv"]!r}" ctrllimited="false" forcelimited="true" '
            f'forcerange="{-limit!r} {limit!r}"/>'
        )
    return (
        f'<motor name="leg{leg}" {moves} gear="1" ctrllimited="{str(_is_limited(settings)).lower()}" '
        f'ctrlrange="{-limit!r} {limit!r}"/>'
    )


def _resistance(scenario: Scenario, step: float, *, armature: bool = True) -> str:
    """Return the attributes of what resists a leg's motion beside its motor, from a blank on."""
    motor = scenario.actuators.motor
    if scenario.actuators.kind != "position_torque":
        return ""
    inertia = f' armature="{motor.armature!r}"' if armature and motor.armature else ""
    # a leg that friction holds creeps by the share of its acceleration that a constraint lets pass, over this rate
    friction = f' solreffriction="{2.0 * step!r} 1" solimpfriction="{_IMPEDANCE!r} {_IMPEDANCE!r} 0.001"'
    return f'{inertia} damping="{motor.damping!r}" frictionloss="{motor.friction!r}"{friction}'


def _image_size(scenario: Scenario) -> Array:
    size = scenario.camera.image_size
    return np.round(np.asarray(_RESOLUTION if size is None else size, dtype=float))


def _off_centre(scenario: Scenario, size: Array) -> Array:
    """Return where the principal point is from the image centre, u right and v down (2,) [px]."""
    given = scenario.camera.principal_point
    return np.zeros(2) if given is None else np.asarray(given) - (size - 1.0) / 2.0


def _camera(scenario: Scenario, settings: _core.Settings) -> str:
    """Return the camera: MuJoCo's looks along its -z with y up, as that of the model."""
    camera, given = settings.camera, scenario.camera
    origin, *ends = camera.in_mount(np.vstack([np.zeros(3), np.eye(3)]))
    x, y, _ = (end - origin for end in ends)
    size = _image_size(scenario)
    focal = np.full(2, camera.focal_pixels)
    if given.focal_pixels is not None:
        focal = np.broadcast_to(np.asarray(given.focal_pixels, dtype=float), (2,))
    off = _off_centre(scenario, size)
    at = f'name="camera" pos="{_text(origin)}" xyaxes="{_text([x, y])}" resolution="{size[0]:.0f} {size[1]:.0f}"'
    if focal[0] == focal[1] and not off.any():
        return f'<camera {at} fovy="{float(np.rad2deg(2.0 * np.arctan(size[1] / 2.0 / focal[1])))!r}"/>'
    return (
        f'<camera {at} sensorsize="{_text(size * _PIXEL)}" focalpixel="{_text(focal)}" principalpixel="{_text(-off)}"/>'
    )


@dataclass(frozen=True)
class _Key:
    """A keyframe at rest or in motion, with the efforts of the legs that hold the platform there."""

    name: str
    pose: Poses
    twist: Array  # (6,), in B [m/s; rad/s]
    efforts: Array  # (6,) [N], of cranks [N m]


def _keys(scene: Scene) -> list[_Key]:
    def key(name: str, pose: Poses, twist: Array) -> _Key:
        weight = scene.settings.plant_body.weight(pose.quaternion)
        return _Key(name, pose, twist, scene.hexapod.leg_forces(pose.position, pose.quaternion, weight))

    moving = np.asarray(scene.settings["simulation.start.twist"])
    return [key("home", scene.home, np.zeros(6)), key("start", scene.start, moving)]


def _key_line(scene: Scene, key: _Key) -> str:
    hexapod, actuators, pose, twist = scene.hexapod, scene.scenario.actuators, key.pose, key.twist
    # MuJoCo's angular velocity is in the body's frame
    spin = Rotation.from_quat(pose.quaternion[[1, 2, 3, 0]]).inv().apply(twist[3:])
    at = pose.position, pose.quaternion
    lengths, rates = hexapod.leg_lengths(*at), hexapod.wrench_map(*at).T @ twist
    control = key.efforts
    if actuators.takes_positions:  # the command at which the motors give these forces
        control = lengths + (control + actuators.motor.kv * rates) / actuators.motor.kp
    of_cranks = (lengths, rates) if hexapod.rotary else ((), ())
    return (
        f'    <key name="{key.name}" qpos="{_text([*pose.position, *pose.quaternion, *of_cranks[0]])}" '
        f'qvel="{_text([*twist[:3], *spin, *of_cranks[1]])}" ctrl="{_text(control)}"/>'
    )


def _key_notes(scene: Scene) -> list[str]:
    return [note for key in _keys(scene) if (note := _key_note(scene, key))]


def _key_note(scene: Scene, key: _Key) -> str:
    """Return that a keyframe needs more than the actuators' range, and whether that acts; empty where it needs less."""
    limit, unit = float(scene.settings["robot.force_limit"]), leg_units(scene.scenario.robot).effort
    legs = [str(leg) for leg, effort in enumerate(np.abs(key.efforts), 1) if effort > limit]
    if not legs:
        return ""
    which = {1: f"leg {legs[0]} takes", 6: "the legs take up to"}.get(len(legs), f"legs {', '.join(legs)} take up to")
    largest, allowed = apart(float(np.abs(key.efforts).max()), limit)
    acts = (
        "MuJoCo limits them to it, and the platform does not stay there"
        if _is_limited(scene.settings)
        else ("it does not act in this model, whose legs do not saturate")
    )
    return (
        f"keyframe {key.name}: {which} {largest} {unit} to hold the platform, beyond the actuators' range of "
        f"{allowed} {unit} (robot.force_limit): {acts}"
    )
