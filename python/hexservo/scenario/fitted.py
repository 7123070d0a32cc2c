"""Gains that fit a machine: from a bandwidth and a damping to the gains of a law (docs/gains.md).

What the machine is comes from the core: its estimated inertia, its goal, and the image Jacobian there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from operator import attrgetter
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ValidationError

from hexservo import _core
from hexservo.scenario.arrays import Array
from hexservo.scenario.block import Block
from hexservo.scenario.blocks import SIDES, Blocks, circle_keys
from hexservo.scenario.core_defaults import core_default
from hexservo.scenario.keys import sampled_keys
from hexservo.scenario.laws import ALL_LAWS, LAWS, Auto
from hexservo.scenario.parameters import Settings, core_parameters
from hexservo.scenario.placing import read_target
from hexservo.scenario.plain import plain, put
from hexservo.scenario.rotations import quaternion_of, quaternion_product

# Dimensionless numbers of the formulas, docs/gains.md.
_PRIOR = 1.5e-3  # composite, computed_torque: weight of the prior over the image of one point
_NOISY_PRIOR = 0.05  # pbvs: the same under noise; an exact image releases it
UPTAKE = 0.5  # composite: rate at which the fuzzy systems take up a constant force, over omega
_CENTRE = 0.63  # composite: |phi-bar|^2 where both inputs are zero, with the default bells
_FULL_SCALE = 3.0  # composite: one over the pose error at which an input is at its limit, in distances and in rad
_STICTION = 3e-4  # composite: pose error at which K_t overcomes K_v, in distances and in rad
_IMAGE = 0.05  # composite: share of the stiffness that `kelly` has
_FAR, _SLOPE = 0.5, 58.6  # resolved_rate: gain far from the goal over the gain; slope over gain/s_omega
# hybrid: what the default gains are on the machine of the paper
_FRICTION = np.repeat([7.3e-4, 7.3e-5], 3)  # K_v over the wrench of one radian
_ERROR_SCALE = 13.7  # a times that wrench
_RATE_SCALE = np.repeat([131.0, 66.0], 3)  # b times that wrench and omega
_SPRING = np.repeat([0.0184, 0.0727], 3)  # 1/Psi over the stiffness of the image
_AGILITY, _SPEED = 1.0, 0.4  # tracking: the target's acceleration and speed, in distances and in rad, per s^2 and s

_SURE = 1e6  # weight of the pose sensors where the pose is known [px^2/m^2; px^2/rad^2]
_SAME = 1e-9  # relative difference of gains that are equal but for rounding
_BLOCKS = ("robot", "camera", "target")
_KEPT = 16  # machines: a scenario and its changes ask for one of them several times
# What the machine depends on, but for limits and devices.
_OF_MACHINE = ("robot.", "camera.", "target.")
_LIMITS = ("robot.stroke", "robot.force_limit")


@dataclass(frozen=True, eq=False)
class Machine:
    """What fitted gains depend on beside bandwidth and damping; docs/gains.md has the symbols."""

    inertia: Array  # (6,) D_j, diagonal of D-bar at the goal [kg] x3, [kg m^2] x3
    sight: Array  # (6,) s_v [px/m] x3, s_omega [px/rad] x3
    pointing: Array  # (2,) rho_x, rho_y [px^2/(N m s^2)]
    weights: Array  # (2p,) diagonal of W, what each coordinate of the p points counts [1]
    jacobian: Array  # (2p, 6) J at the goal, whatever its points count [px/m, px/rad]
    mass: Array  # (6, 6) D-bar there [kg; kg m^2]
    displacement: Array  # (6,) from home to the goal [m; rad]; NaN where no pose shows the goal image

    @property
    def points(self) -> float:
        """Return n, what all points count together: one of weight 2 is as two of weight 1 in its place."""
        return float(self.weights.sum() / 2.0)

    @property
    def common_pull(self) -> Array:
        """Return u^T W J/sqrt(n) for u that is 1 in every x, and in every y, (2, 6) [px/m, px/rad]."""
        return _common_pull(self.jacobian, self.weights)

    @property
    def information(self) -> Array:
        """Return J^T W J, (6, 6) [px^2/m^2; px^2/rad^2]."""
        return np.asarray(self.jacobian.T @ (self.weights[:, None] * self.jacobian))

    @property
    def distance(self) -> Array:
        """The unit of each pose component, (6,): s_omega/s_v [m], which is near the distance of the target; 1 [rad]."""
        return np.asarray(self.sight[5] / self.sight)


def machine_of(scenario: Blocks) -> Machine:
    """Return what the gains of a scenario depend on: not its uncertainties, nor its law and gains.

    The image Jacobian is that of the desired features at the pose that shows them, the goal of `pbvs`; where there is
    none (a camera `as_printed`, a goal image that no pose shows) the one with the attitude and the depths of home.

    Raises
    ------
    ValueError
        For what the core refuses, as `core_parameters`.
    """
    return _machine(scenario.robot, scenario.camera, scenario.target)


@lru_cache(_KEPT)
def _machine(*blocks: Block) -> Machine:
    settings = _nominal(blocks)
    probe = _core.Probe(settings)
    position, quaternion, depth, displacement = _goal(blocks, settings, probe)
    desired = settings.camera.features(settings["target.desired_features"].reshape(-1, 2)).ravel()
    jacobian = probe.image_jacobian(desired[None], depth, quaternion, position=position)[0]
    weights = np.repeat(settings["target.weights"], 2)
    inertia = probe.inertia(quaternion)[0]
    # in units of a power of two, so that no square overflows and no bit moves
    size = np.exp2(np.frexp(np.abs(jacobian).max())[1] - 1)
    squares = weights[:, None] * (jacobian / size) ** 2
    sight = size * np.sqrt(squares.reshape(-1, 2, 3).sum(axis=(0, 2)) / weights.sum())
    pull = _common_pull(jacobian, weights)
    pointing = np.einsum("ij,ji->i", pull, np.linalg.solve(inertia, pull.T))
    arrays = np.diag(inertia).copy(), np.repeat(sight, 3), pointing, weights, jacobian, inertia, displacement
    for array in arrays:
        array.flags.writeable = False  # several scenarios share them
    return Machine(*arrays)


def _common_pull(jacobian: Array, weights: Array) -> Array:
    common = np.tile(np.eye(2), len(weights) // 2) * weights
    return np.asarray(common @ jacobian / np.sqrt(weights.sum() / 2.0))


def machine_with(scenario: Blocks, changes: Mapping[str, Any]) -> Machine:
    """Return the machine of a scenario of which `changes`, by dotted key, differ (plain data).

    Raises
    ------
    ValueError
        As `machine_of`.
    """
    blocks = {name: plain(getattr(scenario, name)) for name in ("name", *_BLOCKS)}
    for side in SIDES:
        if f"robot.{side}_joints" in changes:
            blocks["robot"] |= dict.fromkeys(circle_keys(side))
    for key, value in changes.items():
        put(blocks, key, value)
    return machine_of(Blocks.model_validate(blocks))


def _nominal(blocks: tuple[Block, ...], law: str = "kelly", **gains: Any) -> Settings:
    """Return the core's settings of robot, camera and target, without uncertainties and devices."""
    known = dict(zip(_BLOCKS, blocks, strict=True))
    nominal = Blocks.model_validate({"name": "nominal", **known, "controller": {"law": law, law: gains}})
    read_target(nominal)
    return core_parameters(nominal)


def _goal(blocks: tuple[Block, ...], settings: Settings, probe: _core.Probe) -> tuple[Array, Array, Array, Array]:
    """Return pose (1, 3), (1, 4), depths Z (1, n) [m] and displacement (6,) of the goal; home's and NaN without one.

    What the law `pbvs` regulates at home is the displacement from there to the goal.
    """
    home = _core.Hexapod(settings.robot)
    position, quaternion = np.array(home.home_position)[None], np.array(home.home_quaternion)[None]
    if settings["camera.convention"] == "as_printed":
        return position, quaternion, -settings["target.depth"][None], np.full(6, np.nan)
    features, depth = probe.image(position, quaternion)
    try:
        asked = _core.Probe(_nominal(blocks, "pbvs", kp=1.0, kd=0.0, prior=_SURE))
    except ValueError:  # no pose shows the goal image
        return position, quaternion, depth, np.full(6, np.nan)
    still = np.zeros((1, 6))
    error = asked.law(features, depth, position, quaternion, still, None).pose_error
    assert error is not None
    displacement = error[0]
    shift, turn = np.split(displacement, 2)
    quaternion = quaternion_product(quaternion_of(turn), quaternion)
    position = position + shift
    return position, quaternion, probe.image(position, quaternion)[1], displacement


# ---- Formulas -------------------------------------------------------------------------------------------------------


def fitted_gains(law: str, machine: Machine, bandwidth: ArrayLike, damping: ArrayLike) -> dict[str, Array]:
    """Return the gains of a law that fit a machine, by their keys in the law's block (docs/gains.md).

    Parameters
    ----------
    law
        One of `ALL_LAWS`.
    machine
        From `machine_of`.
    bandwidth, damping
        f [Hz] and zeta, numbers or arrays (m,): then axis 0 of every gain.
    """
    omega, zeta = np.broadcast_arrays(2.0 * np.pi * np.asarray(bandwidth, dtype=float), np.asarray(damping, float))
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # refused by the rules of the keys
        return _FORMULAS[law](machine, omega[..., None], zeta[..., None])


def _prior(machine: Machine, omega: Array, share: float = _PRIOR) -> Array:
    return share * machine.sight**2 * np.ones_like(omega)


def _image_stiffness(machine: Machine, omega: Array) -> Array:
    """Return K_p of `kelly` and `hybrid`, (..., 2p) [N m/px^2]."""
    return np.tile(omega**2 / machine.pointing, len(machine.weights) // 2)


def _hybrid(machine: Machine, omega: Array, zeta: Array) -> dict[str, Array]:
    kp = machine.points * omega**2 / np.sqrt(machine.pointing.prod())  # of all points [N m/px^2]
    of_radian = kp * machine.sight[5] * machine.sight
    return {
        "kp": _image_stiffness(machine, omega),
        "kv": zeta * _FRICTION * of_radian,
        "fuzzy.adaptation": 1.0 / (_SPRING * kp * machine.sight**2),
        "fuzzy.error_scale": _ERROR_SCALE / of_radian,
        "fuzzy.rate_scale": _RATE_SCALE / (of_radian * omega),
    }


def fitted_adaptation(inertia: Array, omega: Array, zeta: Array) -> dict[str, Array]:
    """Return drive and adaptation of `composite` for a pose error with omega [1/s] and zeta, by key: (..., 6) each."""
    return {
        "drive": omega / (2.0 * zeta) * np.ones(6),
        "fuzzy.adaptation": _CENTRE / (2.0 * zeta * omega * (UPTAKE * omega) * inertia),
    }


def _composite(machine: Machine, omega: Array, zeta: Array) -> dict[str, Array]:
    stiffness, uptake = omega**2 * machine.inertia, UPTAKE * omega
    return {
        "kp": _IMAGE * _image_stiffness(machine, omega),
        "kv": _STICTION * stiffness * machine.distance,
        "kt": stiffness,
        "kd": (2.0 * zeta * omega + uptake) * machine.inertia,
        "prior": _prior(machine, omega),
        **fitted_adaptation(machine.inertia, omega, zeta),
        "fuzzy.error_scale": _FULL_SCALE / machine.distance * np.ones_like(omega),
        "fuzzy.rate_scale": _FULL_SCALE / (machine.distance * omega),
    }


def _kelly(machine: Machine, omega: Array, zeta: Array) -> dict[str, Array]:
    return {"kp": _image_stiffness(machine, omega), "kd": 2.0 * zeta * omega * machine.inertia}


def _resolved_rate(machine: Machine, omega: Array, zeta: Array) -> dict[str, Array]:
    gain = (omega / (2.0 * zeta))[..., 0]
    return {
        "gain": gain,
        "gain_far": _FAR * gain,
        "gain_slope": _SLOPE * gain / machine.sight[5],
        "ki": 2.0 * zeta * omega * machine.inertia,
    }


def _pbvs(machine: Machine, omega: Array, zeta: Array) -> dict[str, Array]:
    return {
        "kp": omega**2 * machine.inertia,
        "kd": 2.0 * zeta * omega * machine.inertia,
        "prior": _prior(machine, omega, _NOISY_PRIOR),
    }


def _computed_torque(machine: Machine, omega: Array, zeta: Array) -> dict[str, Array]:
    six = np.ones(6)
    return {"kp": omega**2 * six, "kd": 2.0 * zeta * omega * six, "prior": _prior(machine, omega)}


def _tracking(machine: Machine, omega: Array, zeta: Array) -> dict[str, Array]:
    filtered = {key: value * np.ones_like(omega) for key, value in target_filter(machine).items()}
    return {"bandwidth": (omega / (2.0 * np.pi))[..., 0], **filtered}  # zeta: the motion is critically damped anyway


def target_filter(machine: Machine) -> dict[str, Array]:
    """Return what the filter of `tracking` takes for a target's motion, by key: (6,) [m/s^2; rad/s^2], [m/s; rad/s].

    It does not follow the bandwidth: how a target moves belongs to the world, not to the machine.
    """
    return {"acceleration": _AGILITY * machine.distance, "speed": _SPEED * machine.distance}


_FORMULAS: dict[str, Callable[[Machine, Array, Array], dict[str, Array]]] = {
    "hybrid": _hybrid,
    "composite": _composite,
    "kelly": _kelly,
    "resolved_rate": _resolved_rate,
    "pbvs": _pbvs,
    "computed_torque": _computed_torque,
    "tracking": _tracking,
}

_FUZZY = ("fuzzy.adaptation", "fuzzy.error_scale", "fuzzy.rate_scale")
_KEYS = {
    "hybrid": ("kp", "kv", *_FUZZY),
    "composite": ("kp", "kv", "kt", "kd", "drive", "prior", *_FUZZY),
    "kelly": ("kp", "kd"),
    "resolved_rate": ("gain", "gain_far", "gain_slope", "ki"),
    "pbvs": ("kp", "kd", "prior"),
    "computed_torque": ("kp", "kd", "prior"),
    "tracking": ("bandwidth", "acceleration", "speed"),
}


def fitted_keys(law: str) -> tuple[str, ...]:
    """Return the keys of a law's block that `auto` fills in."""
    return _KEYS[law]


# ---- In a scenario --------------------------------------------------------------------------------------------------


def auto_of(scenario: Blocks) -> Auto:
    """Return the block `auto` of the scenario's law."""
    return cast("Auto", getattr(scenario.controller, scenario.controller.law).auto)


def idle_gains(scenario: Blocks) -> frozenset[str]:
    """Return names of the law's gains that have no effect on the machine; all but their defaults are refused."""
    return frozenset({"ki"} if scenario.legs_follow_twists else ())


def acts_on_gains(key: str) -> bool:
    """Return whether fitted gains depend on a dotted key, beside bandwidth and damping."""
    return key.startswith(_OF_MACHINE) and key not in _LIMITS and key not in sampled_keys()


def with_fitted_gains(data: dict[str, Any]) -> dict[str, Any]:
    """Fill in the gains that a scenario, as plain data, leaves to `auto` of its law: what is given, and not null, wins.

    Data with a problem return as they are, for the rule at its place to report.
    """
    controller = data.get("controller")
    if not isinstance(controller, dict):
        return data
    law = controller.get("law", LAWS[0])
    block = controller.get(law) if law in ALL_LAWS else None
    if not isinstance(block, dict) or not isinstance(block.get("auto"), dict):
        return data
    try:
        auto = Auto.model_validate(block["auto"])
        if auto.bandwidth is None:
            return data
        others = {key: value for key, value in data.items() if key != "controller"}
        machine = machine_of(Blocks.model_validate(others))
    except (ValidationError, ValueError):
        return data
    filled = _plain_gains(law, machine, auto)
    return {**data, "controller": {**controller, law: _over(filled, block)}}


def _plain_gains(law: str, machine: Machine, auto: Auto) -> dict[str, Any]:
    assert auto.bandwidth is not None
    return {key: value.tolist() for key, value in fitted_gains(law, machine, auto.bandwidth, auto.damping).items()}


def _over(filled: dict[str, Any], block: dict[str, Any]) -> dict[str, Any]:
    """Return a block with gains filled in where it has none or null."""
    merged = dict(block)
    for path, value in filled.items():
        *blocks, key = path.split(".")
        place = merged
        for name in blocks:
            inner = place.get(name, {})
            if not isinstance(inner, dict):
                return block  # refused at its own place
            place[name] = place = dict(inner)
        if place.get(key) is None:
            place[key] = value
    return merged


def chosen_keys(scenario: Blocks) -> tuple[str, ...]:
    """Return the keys of the law's block that do not follow: neither from `auto`, nor as defaults where it is off."""
    law = scenario.controller.law
    follow = _follow(scenario, law)
    own = getattr(scenario.controller, law)
    return tuple(key for key in fitted_keys(law) if not _same(attrgetter(key)(own), follow[key]))


def gains_are_defaults(scenario: Blocks, law: str) -> bool:
    """Return whether a law's block leaves all gains that `auto` would fit to their defaults, without a bandwidth."""
    own = getattr(scenario.controller, law)
    defaults = ((key, core_default(f"controller.{law}.{key}")) for key in fitted_keys(law))
    return own.auto == Auto() and all(_same(attrgetter(key)(own), default) for key, default in defaults)


def gains_written(scenario: Blocks) -> dict[str, Any]:
    """Return the changes, by dotted key, that keep the gains that `auto` fits whatever else changes; empty without it.

    They are numbers from then on, as if a user had written them.
    """
    if auto_of(scenario).bandwidth is None:
        return {}
    law = scenario.controller.law
    own = getattr(scenario.controller, law)
    acting = [path for path in fitted_keys(law) if path not in idle_gains(scenario)]
    gains = {f"controller.{law}.{path}": attrgetter(path)(own) for path in acting}
    return {f"controller.{law}.auto.bandwidth": None, **gains}


def without_fitted_gains(scenario: Blocks, keys: dict[str, Any]) -> None:
    """Take out of a scenario's plain data (changed in place) all gains that follow: by `auto`, or as defaults."""
    for law in ALL_LAWS:
        follow, own = _follow(scenario, law), getattr(scenario.controller, law)
        for path in fitted_keys(law):
            if _same(attrgetter(path)(own), follow[path]):
                *blocks, key = path.split(".")
                place = keys["controller"][law]
                for name in blocks:
                    place = place[name]
                del place[key]


def _follow(scenario: Blocks, law: str) -> dict[str, Any]:
    """Return the gains of a law's block where none is written."""
    auto = getattr(scenario.controller, law).auto
    if law != scenario.controller.law or auto.bandwidth is None:
        return {key: core_default(f"controller.{law}.{key}") for key in fitted_keys(law)}
    return dict(fitted_gains(law, machine_of(scenario), auto.bandwidth, auto.damping))


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, float | tuple) and type(one) is type(other) and one == other:  # most are, and NumPy takes longer
        return True
    return bool(np.allclose(one, other, rtol=_SAME, atol=0.0))
