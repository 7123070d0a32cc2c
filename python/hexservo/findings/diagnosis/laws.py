"""Causes in the settings of a law and of the run, and in the task, and how each is removed from a scenario."""

from __future__ import annotations

import math
from collections.abc import Container
from functools import partial
from typing import Any

import numpy as np

from hexservo import _core
from hexservo.findings.diagnosis.adaptation import ADAPTATION, with_other_gains
from hexservo.findings.diagnosis.environment import (
    FINE_STEP,
    IMAGE_ALONE,
    OPTICS,
    ORDINARY,
    alone_at_its_gains,
    ideal,
    less,
    ordinary,
)
from hexservo.findings.diagnosis.gains import GAIN_KEYS, damped, not_below_default, slower
from hexservo.findings.diagnosis.goal import spread_target
from hexservo.findings.diagnosis.model import Alone, Case, Cause, Removal, removal_by
from hexservo.findings.diagnosis.remedies import leg_limits_remedies, longer_run
from hexservo.findings.diagnosis.tracking import legs_within_margins
from hexservo.scenario.blocks import Metrics
from hexservo.scenario.laws import Fuzzy, laws_with
from hexservo.scenario.parameters import frame_period
from hexservo.scenario.pixels import to_pixels

_WITH_FRICTION = laws_with("switching")
_RICHER = 2.0  # a target counts as badly spread where a square would show the worst direction so many times better
_FACTORS = (4.0, 16.0, 64.0)  # by which a loop is made slower or faster
_SUBSTEPS = 8  # times as many are tried
_WEIGHTS = frozenset(name for name in Fuzzy.model_fields if name != "adaptation")
_SWITCHING = frozenset({"controller.switching.kind", "controller.switching.width"})
_OPTIONS = ("jacobian_at", "damping", "prior")


def _block(case: Case) -> Any:
    return case.scenario.controller.gains


def _law_key(case: Case, name: str) -> str:
    return f"controller.{case.scenario.controller.law}.{name}"


def _at_ordinary(case: Case, keys: Container[str], words: str) -> list[Removal]:
    """Return the removal by ordinary settings of the law, of some keys."""
    return removal_by(words, {key: value for key, value in ordinary(case.scenario).items() if key in keys})


# ---- Settings of a law ----------------------------------------------------------------------------------------------


def _stiction(case: Case) -> list[Removal]:
    if case.scenario.controller.law not in _WITH_FRICTION:
        return []
    gain = np.asarray(_block(case).kv, dtype=float)
    if not gain.any():
        return []
    key = _law_key(case, "kv")
    return [
        *(Removal(f"K_v divided by {factor:g}", {key: (gain / factor).tolist()}) for factor in (8.0, 32.0, 128.0)),
        Removal(
            "damping in place of friction, K_v tanh(v/0.3)",
            {"controller.switching.kind": "tanh", "controller.switching.width": 0.3},
        ),
    ]


def _spring(case: Case) -> list[Removal]:
    if case.scenario.controller.law not in _WITH_FRICTION or not _block(case).fuzzy.enabled:
        return []
    key, slowness = _law_key(case, "fuzzy.adaptation"), np.asarray(_block(case).fuzzy.adaptation, dtype=float)
    return [
        *(
            Removal(f"adaptation {factor:g} times as slow", {key: (factor * slowness).tolist()})
            for factor in (100.0, 10.0, 1000.0)
        ),
        Removal("no adaptation", {_law_key(case, "fuzzy.enabled"): False}),
    ]


def _weights(case: Case) -> list[Removal]:
    if case.scenario.controller.law not in _WITH_FRICTION:
        return []
    keys = {_law_key(case, f"fuzzy.{name}") for name in _WEIGHTS}
    return _at_ordinary(case, keys, "the other settings of the fuzzy systems at their defaults")


def _switching(case: Case) -> list[Removal]:
    if case.scenario.controller.law not in _WITH_FRICTION or not np.any(_block(case).kv):
        return []
    return _at_ordinary(case, _SWITCHING, "an ordinary switching term")


def _options(case: Case) -> list[Removal]:
    keys = {_law_key(case, name) for name in _OPTIONS}
    return _at_ordinary(case, keys, "the law's prior and Jacobian at their defaults")


_FITTED = frozenset({"LAW.auto.bandwidth", "LAW.auto.damping"})  # act through the gains that they give


def _loop(case: Case, how: str, power: float) -> list[Removal]:
    """Return loops that are slower by some factors, or faster by them with a power of -1."""
    return [
        removal
        for factor in _FACTORS
        for removal in removal_by(f"the loop {factor:g} times as {how}", slower(case.scenario, factor**power))
    ]


def _gains_high(case: Case) -> list[Removal]:
    return [*_loop(case, "slow", 1.0), *removal_by("more damping", damped(case.scenario, 8.0))]


def _gains_low(case: Case) -> list[Removal]:
    raised = removal_by("stiffness and damping of at least the defaults", not_below_default(case.scenario))
    return [*_loop(case, "fast", -1.0), *raised]


def _coarse_step(case: Case) -> list[Removal]:
    simulation = case.scenario.simulation
    removals = []
    for factor in (2,) if simulation.step <= FINE_STEP else (4, 16):
        step = simulation.step / factor
        changes: dict[str, Any] = {"simulation.step": step}
        if case.sampled:
            if round(case.scenario.actuators.delay / step) > _core.MAX_ACTUATOR_DELAY:
                continue
            if math.isclose(frame_period(case.scenario), simulation.step):  # a frame at every tick, as before
                changes["camera.period"] = step
        what = "a servo period" if case.sampled else "a step"
        removals.append(Removal(f"{what} of {step * 1e3:.4g} ms", changes))
    if case.sampled:
        finer = _SUBSTEPS * simulation.substeps
        removals.append(Removal(f"{finer} steps of the integration in a servo period", {"simulation.substeps": finer}))
    return removals


def _coarse_step_alone(case: Case) -> list[Alone]:
    """Try legs within their margins too: a step that only a feedback beyond them does not bear is not the cause."""
    fine = {**ideal(case.scenario), **ordinary(case.scenario)}
    step, substeps = case.scenario.simulation.step, case.scenario.simulation.substeps
    if case.sampled:
        fine["simulation.substeps"] = _SUBSTEPS * substeps
        coarse = {"simulation.step": step, "simulation.substeps": substeps, "camera.period": step}
        pairs = [Alone(fine, {**fine, **coarse})]
        within = legs_within_margins(case)
        return [*pairs, Alone(fine, within)] if within else pairs
    return [Alone(fine, {**fine, "simulation.step": step})]


# ---- The task -------------------------------------------------------------------------------------------------------


def _poor_image(case: Case) -> list[Removal]:
    if case.goal is None or case.scenario.camera.convention != "eye_in_hand":
        return []
    changes, gain = spread_target(case.scenario, case.goal)
    if gain < _RICHER:
        return []
    count = "four" if case.scenario.target.count == 4 else case.scenario.target.count
    words = f"{count} features on a square, with the least observable direction {gain:.3g} times better"
    return [Removal(words, changes)]


def _poor_image_alone(case: Case) -> list[Alone]:
    """Reduce the noise to an ordinary level, with the law of the scenario and with an ordinary one."""
    assert case.goal is not None
    scenario = case.scenario
    changes, _ = spread_target(scenario, case.goal)
    changes.pop("camera.image_size", None)
    seen = less(ideal(scenario), ("camera.period", "camera.latency", "camera.latency_jitter", "camera.prediction"))
    usual = {**seen, **ordinary(scenario)}
    return [
        Alone({**seen, **changes}, seen),
        Alone({**usual, **changes}, usual),
        # where it fails with exact devices, it is the law that does not get there
        Alone({**usual, **_exact(case)}, usual, first_decides=True),
    ]


def _exact(case: Case) -> dict[str, Any]:
    """Return the changes that make devices of ordinary quality exact."""
    if not case.sampled:
        return {}
    return {key: 0.0 for key in ORDINARY if not key.startswith("uncertainty")}


def _leg_limits(case: Case) -> list[Removal]:
    robot = case.scenario.robot
    most = math.inf if robot.legs == "prismatic" else math.pi - abs(robot.stroke_centre)  # as far as a crank goes
    changes: dict[str, Any] = {"robot.stroke": min(1e3 * robot.stroke, most)}
    if robot.on_limit != "report":
        changes["robot.on_limit"] = "report"
    words = "legs of any length" + (" and speed" if robot.speed_limit is not None else "")
    words += " whose joints tilt by any angle" if robot.joint_limit is not None else ""
    return [Removal(words, changes, stroke_counts=False)]


def _impossible_goal(case: Case) -> list[Removal]:
    if case.obstacle is None or case.obstacle.kind != "image":
        return []
    words = f"the nearest image that belongs to a pose, {case.obstacle.residual:.3g} px away"
    return [Removal(words, {"target.desired_features": to_pixels(case.scenario, case.obstacle.nearest_image).tolist()})]


def _false_equilibrium(case: Case) -> list[Removal]:
    scenario = case.scenario
    if scenario.controller.law not in IMAGE_ALONE or scenario.camera.convention != "eye_in_hand":
        return []
    return [
        Removal(f"the law {law}, which regulates the pose", {"controller.law": law})
        for law in laws_with("points", "prior")
    ]


def _duration(case: Case) -> list[Removal]:
    removals = [longer_run(case)]
    usual = Metrics().dwell
    if case.scenario.metrics.dwell > usual:
        removals.append(Removal(f"a dwell time of {usual:g} s", {"metrics.dwell": usual}))
    return removals


def _band(case: Case) -> list[Removal]:
    usual = Metrics().band
    if case.scenario.metrics.band >= usual:
        return []
    return [Removal(f"a settling band of {usual:g} px", {"metrics.band": usual})]


LAWS: tuple[Cause, ...] = (
    Cause(
        "coarse_step",
        "a step that is too coarse",
        frozenset({"simulation.step", "simulation.substeps"}),
        _coarse_step,
        alone=_coarse_step_alone,
        kind="law",
    ),
    Cause(
        "spring",
        "adaptation that acts as a spring",
        frozenset({"LAW.fuzzy.adaptation"}),
        _spring,
        alone=partial(alone_at_its_gains, name="fuzzy.adaptation", power=1.0),
        kind="law",
    ),
    ADAPTATION,
    Cause(
        "stiction",
        "stiction: K_v is too large",
        frozenset({"LAW.kv"}),
        _stiction,
        alone=partial(alone_at_its_gains, name="kv", power=-1.0),
        kind="law",
    ),
    Cause(
        "switching",
        "a switching term that does not suit the loop",
        _SWITCHING,
        _switching,
        kind="law",
    ),
    Cause(
        "weights",
        "settings of the fuzzy systems",
        frozenset(f"LAW.fuzzy.{name}" for name in _WEIGHTS),
        _weights,
        context=frozenset({"uncertainty.gravity"}),
        kind="law",
    ),
    Cause("prior", "prior or Jacobian of the law", frozenset(f"LAW.{name}" for name in _OPTIONS), _options, kind="law"),
    Cause(
        "gains_high",
        "gains that are too high, or too little damped",
        GAIN_KEYS | _FITTED,
        _gains_high,
        alone=with_other_gains(GAIN_KEYS | _FITTED),
        kind="law",
    ),
    Cause("gains_low", "gains that are too low", GAIN_KEYS, _gains_low, alone=with_other_gains(GAIN_KEYS), kind="law"),
)

TASKS: tuple[Cause, ...] = (
    Cause(
        "impossible_goal",
        "a goal image that belongs to no pose",
        frozenset({"target.desired_features"}),
        _impossible_goal,
        kind="task",
    ),
    Cause("band", "a settling band that is too narrow", frozenset({"metrics.band"}), _band, kind="task"),
    Cause(
        "false_equilibrium",
        "a false equilibrium of the law",
        frozenset({"controller.law"}),
        _false_equilibrium,
        kind="task",
    ),
    Cause(
        "duration",
        "a run that is too short for its dwell time",
        frozenset({"simulation.duration", "metrics.dwell"}),
        _duration,
        kind="task",
    ),
    Cause(
        "poor_image",
        "a poorly observable target",
        OPTICS | {"target.initial_features", "target.points", "target.depth"},
        _poor_image,
        alone=_poor_image_alone,
        kind="task",
    ),
    Cause(
        "leg_limits",
        "limits of the legs",
        frozenset({"robot.stroke", "robot.speed_limit", "robot.joint_limit", "robot.on_limit"}),
        _leg_limits,
        leg_limits_remedies,
        kind="task",
    ),
)
