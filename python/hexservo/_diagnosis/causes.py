"""The causes that a failure may have: how each is taken out of a scenario, by itself, and what helps against it.

A removal makes one thing ideal and leaves the rest as it is; whether the run still fails then tells more than anything
that can be read off the run itself. A remedy is what one would change on the machine or in its controller.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexservo._diagnosis.criterion import Record
from hexservo._diagnosis.goal import Goal, spread_target
from hexservo._parameters import frame_period
from hexservo._scenario import Scenario

__all__ = ["CAUSES", "Case", "Cause", "Removal"]

_FINE = 1.0e-3  # [s]: a step up to here is only halved; a coarser one is divided further
_MAX_DELAY = 8  # ticks of the actuators, docs/model.md section 7
_RICHER = 2.0  # a target counts as badly spread where a square would show the worst direction so many times better


@dataclass(frozen=True, eq=False)
class Case:
    """What is diagnosed: a scenario, and what is known of it."""

    scenario: Scenario
    goal: Goal | None  # None: no pose was found that shows the goal


@dataclass(frozen=True, eq=False)
class Removal:
    """Changes that take one cause out of a scenario, or help against it."""

    words: str  # what is changed, as it follows "with"
    changes: Mapping[str, Any]  # by dotted key
    stroke_counts: bool = True  # whether a leg beyond its stroke still is a failure


@dataclass(frozen=True)
class Cause:
    """One entry of the list."""

    key: str
    title: str
    removals: Callable[[Case], list[Removal]]  # empty: the scenario has nothing of it
    remedies: Callable[[Case, Removal, Record], list[Removal]]  # after the removal that helped most, with its run
    also_cures: frozenset[str]  # causes whose failures its removal cures by side effect


def _sampled(case: Case) -> bool:
    return case.scenario.simulation.mode == "sampled"


def _same(case: Case, removal: Removal, record: Record) -> list[Removal]:
    return [removal]


# ---- One after another ----------------------------------------------------------------------------------------------


def _sign(case: Case) -> list[Removal]:
    scenario = case.scenario
    if scenario.controller.jacobian != "printed" or scenario.camera.convention != "eye_in_hand":
        return []
    if scenario.controller.law == "pbvs":  # the sign does not enter
        return []
    return [Removal("the sign of the image Jacobian that the camera has", {"controller.jacobian": "consistent"})]


def _poor_image(case: Case) -> list[Removal]:
    if case.goal is None or case.scenario.camera.convention != "eye_in_hand":
        return []
    changes, gain = spread_target(case.scenario, case.goal)
    if gain < _RICHER:
        return []
    words = f"four features on a square, which show the worst direction {gain:.3g} times better"
    return [Removal(words, changes)]


def _late_camera(case: Case) -> list[Removal]:
    camera, step, period = case.scenario.camera, case.scenario.simulation.step, frame_period(case.scenario)
    if not _sampled(case) or (period <= step and camera.latency == 0.0 and camera.latency_jitter == 0.0):
        return []
    changes: dict[str, Any] = {"camera.period": step, "camera.latency": 0.0, "camera.latency_jitter": 0.0}
    words = "a frame at every servo tick, without latency"
    if camera.dropout and period > step:  # many frames would make up for lost ones: the same wait for lost ones
        wait = camera.dropout / (1.0 - camera.dropout) * period / step if camera.dropout < 1.0 else math.inf
        changes["camera.dropout"] = wait / (1.0 + wait) if math.isfinite(wait) else 1.0
        words += ", and so many more of them lost that the wait for lost ones is the same"
    return [Removal(words, changes)]


def _late_camera_remedies(case: Case, removal: Removal, record: Record) -> list[Removal]:
    remedies = []
    if case.scenario.camera.convention == "eye_in_hand" and case.scenario.camera.prediction == "none":
        remedies.append(
            Removal("features carried along by the joint sensors between frames", {"camera.prediction": "encoder"})
        )
    return [*remedies, removal]


def _stiction(case: Case) -> list[Removal]:
    law = case.scenario.controller.law
    if law not in ("hybrid", "composite"):
        return []
    gain = np.asarray(getattr(case.scenario.controller, law).kv, dtype=float)
    if not gain.any():
        return []
    key = f"controller.{law}.kv"
    return [
        *(Removal(f"K_v divided by {factor:g}", {key: (gain / factor).tolist()}) for factor in (8.0, 3.0, 32.0)),
        *(
            Removal(
                f"damping in place of friction, K_v tanh(v/{width:g})",
                {"controller.switching.kind": "tanh", "controller.switching.width": width},
            )
            for width in (0.1, 0.5)
        ),
    ]


def _spring(case: Case) -> list[Removal]:
    law = case.scenario.controller.law
    if law not in ("hybrid", "composite"):
        return []
    fuzzy = getattr(case.scenario.controller, law).fuzzy
    if not fuzzy.enabled:
        return []
    key, slowness = f"controller.{law}.fuzzy.adaptation", np.asarray(fuzzy.adaptation, dtype=float)
    return [
        Removal(f"adaptation {factor:g} times as slow", {key: (factor * slowness).tolist()})
        for factor in (100.0, 10.0, 1000.0)
    ] + [Removal("no adaptation", {f"controller.{law}.fuzzy.enabled": False})]


def _gravity(case: Case) -> list[Removal]:
    if np.broadcast_to(case.scenario.uncertainty.gravity, 6)[2] == 0.0:  # the weight has no other entry
        return []
    return [
        Removal(
            "the weight and the inertia that the controller believes in",
            {"uncertainty.gravity": 0.0, "uncertainty.inertia": 0.0},
        )
    ]


def _gravity_remedies(case: Case, removal: Removal, record: Record) -> list[Removal]:
    robot, model = case.scenario.robot, case.scenario.uncertainty
    remedies = []
    if isinstance(model.gravity, float) and isinstance(model.inertia, float) and isinstance(model.coriolis, float):
        # The same plant, told to the controller: its terms are (1 - delta) times the estimated ones.
        share = 1.0 - model.gravity
        changes = {
            "robot.mass": share * robot.mass,
            "robot.inertia": (share * np.asarray(robot.inertia)).tolist(),
            "uncertainty.gravity": 0.0,
            "uncertainty.inertia": 1.0 - (1.0 - model.inertia) / share,
            "uncertainty.coriolis": 1.0 - (1.0 - model.coriolis) / share,
        }
        if all(-1.0 < changes[f"uncertainty.{name}"] < 1.0 for name in ("inertia", "coriolis")):
            remedies.append(Removal(f"the platform weighed, and {share * robot.mass:.4g} kg told to the law", changes))
    if case.scenario.controller.law != "composite":
        remedies.append(Removal("the law composite, which integrates a wrong weight", {"controller.law": "composite"}))
    return [*remedies, removal]


def _unequal_depth(case: Case) -> list[Removal]:
    errors = np.asarray(case.scenario.uncertainty.depth, dtype=float)
    if errors.ndim == 0 or not np.ptp(errors):
        return []
    mean = float(errors.mean())
    return [Removal(f"the same depth error of {mean:.3g} for all points", {"uncertainty.depth": mean})]


def _unequal_depth_remedies(case: Case, removal: Removal, record: Record) -> list[Removal]:
    remedies = []
    if case.scenario.controller.law != "composite":
        remedies.append(Removal("the law composite, whose prior bounds the drift", {"controller.law": "composite"}))
    return [removal, *remedies]


def _saturation(case: Case) -> list[Removal]:
    if not _sampled(case) or not case.scenario.actuators.saturation:
        return []
    return [Removal("legs that give any force", {"actuators.saturation": False})]


def _saturation_remedies(case: Case, removal: Removal, record: Record) -> list[Removal]:
    needed = _rounded_up(1.1 * record.metrics["peak_leg_force"])
    return [Removal(f"legs that give {needed:g} N", {"robot.force_limit": needed})]


def _lost_features(case: Case) -> list[Removal]:
    camera = case.scenario.camera
    if not _sampled(case) or (camera.image_size is None and camera.dropout == 0.0 and camera.timeout is None):
        return []
    changes: dict[str, Any] = {}
    if camera.image_size is not None:
        changes["camera.image_size"] = None
    if camera.dropout:
        changes["camera.dropout"] = 0.0
    if camera.timeout is not None:
        changes["camera.timeout"] = None
    return [Removal("an image without a border, of which no frame is lost", changes)]


def _lost_features_remedies(case: Case, removal: Removal, record: Record) -> list[Removal]:
    remedies = []
    camera = case.scenario.camera
    if camera.image_size is not None:
        width = _rounded_up(2.2 * record.metrics["peak_feature_distance"])
        size = [max(side, width) for side in camera.image_size]
        remedies.append(
            Removal(f"an image of {size[0]:.0f} x {size[1]:.0f} px", {**removal.changes, "camera.image_size": size})
        )
    if camera.convention == "eye_in_hand" and camera.prediction == "none":
        remedies.append(Removal("lost images carried along by the joint sensors", {"camera.prediction": "encoder"}))
    return [*remedies, removal]


def _coarse_step(case: Case) -> list[Removal]:
    simulation = case.scenario.simulation
    factors = (2,) if simulation.step <= _FINE else (4, 16)
    removals = []
    for factor in factors:
        step = simulation.step / factor
        changes: dict[str, Any] = {"simulation.step": step}
        if _sampled(case):
            if round(case.scenario.actuators.delay / step) > _MAX_DELAY:
                continue
            if math.isclose(frame_period(case.scenario), simulation.step):  # a frame at every tick, as before
                changes["camera.period"] = step
        what = "a servo period" if _sampled(case) else "a step"
        removals.append(Removal(f"{what} of {step * 1e3:.4g} ms", changes))
    return removals


def _leg_limits(case: Case) -> list[Removal]:
    changes: dict[str, Any] = {"robot.stroke": 1e3 * case.scenario.robot.stroke}
    if case.scenario.robot.on_limit != "report":
        changes["robot.on_limit"] = "report"
    return [Removal("legs of any length", changes, stroke_counts=False)]


def _leg_limits_remedies(case: Case, removal: Removal, record: Record) -> list[Removal]:
    stroke = _rounded_up(1.05 * record.metrics["peak_leg_excursion"])
    return [Removal(f"legs with a stroke of {stroke * 1e3:.3g} mm", {"robot.stroke": stroke})]


def _rounded_up(number: float) -> float:
    """Round up to two digits."""
    unit = 10.0 ** (math.floor(math.log10(number)) - 1)
    return float(f"{math.ceil(number / unit) * unit:.6g}")


# ---- The list -------------------------------------------------------------------------------------------------------

_ALL = frozenset(
    {
        "wrong_sign",
        "poor_image",
        "late_camera",
        "stiction",
        "spring",
        "gravity",
        "unequal_depth",
        "saturation",
        "lost_features",
        "coarse_step",
        "leg_limits",
    }
)

CAUSES: tuple[Cause, ...] = (
    Cause("wrong_sign", "the sign of the image Jacobian", _sign, _same, frozenset()),
    Cause("coarse_step", "a step that is too coarse", _coarse_step, _same, frozenset()),
    Cause("saturation", "saturation of the actuators", _saturation, _saturation_remedies, frozenset()),
    Cause("lost_features", "lost features", _lost_features, _lost_features_remedies, frozenset()),
    Cause("gravity", "a wrong weight", _gravity, _gravity_remedies, frozenset()),
    Cause("unequal_depth", "unequal depth errors", _unequal_depth, _unequal_depth_remedies, frozenset()),
    Cause(
        "spring",
        "adaptation that acts as a spring",
        _spring,
        _same,
        frozenset({"coarse_step", "late_camera", "lost_features"}),
    ),
    Cause("stiction", "stiction: K_v is too large", _stiction, _same, frozenset({"coarse_step", "late_camera"})),
    Cause(
        "late_camera",
        "latency or rate of the camera",
        _late_camera,
        _late_camera_remedies,
        frozenset({"lost_features"}),
    ),
    # A target that is seen better makes every law stiffer, and depth errors matter less.
    Cause(
        "poor_image",
        "a target that the image shows badly",
        _poor_image,
        _same,
        frozenset({"gravity", "unequal_depth", "stiction", "spring", "lost_features", "late_camera"}),
    ),
    # Without limits nothing that the legs do is a failure.
    Cause("leg_limits", "limits of the legs", _leg_limits, _leg_limits_remedies, _ALL - {"leg_limits"}),
)
"""In an order in which ties are broken."""
