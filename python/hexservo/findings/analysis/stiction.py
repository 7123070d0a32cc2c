"""Stiction, the residual errors held by the switching term: the set of K_v (docs/analysis/stiction.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from hexservo.findings.analysis.goal import Goals, find_goals
from hexservo.findings.analysis.loop_of_scenario import NotApplicableError
from hexservo.findings.analysis.rest import Rest, RestLaw
from hexservo.findings.analysis.scene import Scene, scene_of
from hexservo.findings.analysis.stiction_creep import Creep, creep_of
from hexservo.findings.analysis.stiction_motors import HeldLegs, held_legs, rubs
from hexservo.findings.analysis.stiction_runs import Runs, run
from hexservo.findings.analysis.stiction_set import Extremes, RestSet, confirmed, extremes
from hexservo.findings.part import Part
from hexservo.scenario.arrays import Array
from hexservo.scenario.laws import SMOOTH_KINDS, laws_with
from hexservo.scenario.parameters import gains_of
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import number

Kind: TypeAlias = Literal["set", "creep", "integrated", "motors", "none", "open"]


@dataclass(frozen=True, eq=False)
class StictionCase:
    """The set for one case of the law."""

    name: str
    rest: RestSet
    ends: Extremes | None  # None: no pose within the stroke is held
    # [px]: the largest image error of a pose at which the core's law and legs were checked; None where none was found
    confirmed: float | None


@dataclass(frozen=True, eq=False, repr=False)
class Stiction(Part):
    """The set of poses held by the switching term, compared with short runs."""

    scene: Scene
    kind: Kind
    reason: str  # why it is of that kind, in a sentence
    kv: Array  # (6,) [N; N m]; zeros for a law without
    gravity_error: Array  # delta_G G-bar, (6,) [N; N m]
    cases: tuple[StictionCase, ...] = ()
    around_home: StictionCase | None = None  # the set that the runs are compared with
    runs: tuple[Runs, ...] = ()
    creep: Creep | None = None
    # (6,) [N; N m], what fuzzy systems driven by the twist alone take up on the straight way to the goal
    straight_way: Array | None = None
    prior_error: float | None = None  # [px], of the pose that an integrating law goes to
    legs: HeldLegs | None = None  # by the dry friction of motors; None without, and where there is no goal pose

    @property
    def focal_pixels(self) -> float:
        """Return f [px]."""
        return float(self.scene.camera.focal_pixels)


def analyse(scenario: Scenario) -> Stiction:
    """Compute the poses at which K_v holds the platform, and compare with short runs.

    Of a law without K_v on motors with dry friction, how far from the goal image that holds the legs.
    Applies to `hybrid`, and to `composite` where its fuzzy systems do not integrate, with `sign`, `implicit` or
    `implicit_coupled`; without fuzzy systems also to `tanh` and `saturation`. Other cases have a sentence only.
    """
    scene = scene_of(scenario)
    kind, reason = _kind(scene)
    nothing = np.zeros(6)
    if kind in ("none", "open"):
        return Stiction(scene, kind, reason, nothing, nothing)
    goals = find_goals(scene)
    assert goals is not None  # a camera without points is open
    if kind == "motors":
        if (unusable := _no_goal(scene, goals)) is not None:
            return Stiction(scene, "open", unusable, nothing, nothing)
        return Stiction(scene, kind, reason, nothing, nothing, legs=held_legs(scene, goals.best.view))
    if (unusable := _unusable(scene, goals)) is not None:
        return Stiction(scene, "open", unusable, nothing, nothing)
    law = RestLaw(scene)
    gains = gains_of(scene.settings)
    kv = gains.kv
    if kind == "integrated":
        return Stiction(scene, kind, reason, kv, law.gravity_error, prior_error=_prior_error(scene, goals))
    cases = [_case(scene, law, goals, "J-hat, with the depth error", -kv, kv)]
    if kind == "creep":
        goal = goals.best.view.pose
        try:
            creep = creep_of(scene, cases[0].rest, goal, law.stiffness(goal))
        except NotApplicableError as error:
            return Stiction(scene, "open", f"Open: {reason[:-1]}, and {error}.", nothing, nothing)
        return Stiction(scene, kind, reason, kv, law.gravity_error, tuple(cases), creep=creep)
    if np.any(np.asarray(scenario.uncertainty.depth) != 0):
        cases.append(_case(scene, RestLaw(scene, exact_depth=True), goals, "J, exact depths", -kv, kv))
    way = None
    if _driven_by_rate(scene):
        way = _straight_way(gains.fuzzy, goals)
        low, high = np.minimum(way, 0.0) - kv, np.maximum(way, 0.0) + kv
        cases.append(_case(scene, law, goals, "J-hat, with the output of the fuzzy systems", low, high))
    home = _around_home(scene, law, kv)
    runs: tuple[Runs, ...] = ()
    if home.ends is not None and (kv > 0).all():
        settings = [False, True] if gains.fuzzy.enabled else [False]
        runs = tuple(run(scene, law, home.rest, home.ends, kv, fuzzy) for fuzzy in settings)
    return Stiction(scene, kind, reason, kv, law.gravity_error, tuple(cases), home, runs, straight_way=way)


def _no_goal(scene: Scene, goals: Goals) -> str | None:
    """Return that no pose shows the goal image; None where one does."""
    if goals.best.largest_residual > scene.band:
        return (
            f"Open: no pose with the goal image was found (the best leaves {number(goals.best.largest_residual)} "
            "px), so there is no goal pose for the set."
        )
    return None


def _unusable(scene: Scene, goals: Goals) -> str | None:
    """Return why there is no goal pose with a set around it; None where there is one."""
    if (without := _no_goal(scene, goals)) is not None:
        return without
    try:
        for goal in (goals.best, goals.nearest):
            RestLaw(scene).stiffness(goal.view.pose)
    except ValueError as refusal:
        return f"Open: the law cannot be evaluated at the pose of the goal ({refusal})."
    return None


def _kind(scene: Scene) -> tuple[Kind, str]:
    """Return which case of the analysis applies to a law, and the reason."""
    scenario = scene.scenario
    law = scenario.controller.law
    if law not in laws_with("switching"):
        if not rubs(scenario):
            return "none", f"The law {law} has no switching term: nothing holds the platform off its equilibrium."
        return "motors", f"The law {law} has no switching term, but its legs are held by dry friction of the motors"
    if scenario.actuators.takes_positions:
        return (
            "open",
            "Open: the legs of this machine follow positions (actuators.kind); K_v holds the virtual platform of the "
            "controller, whose set is not analysed."
            + (
                " Nor is the dry friction of the motors (actuators.motor.friction), which holds the legs too."
                if rubs(scenario)
                else ""
            ),
        )
    if scenario.camera.convention == "as_printed":
        return "open", "Open: a camera as printed has no points in space, so the set has no poses."
    if reason := scene.unusual_body:
        return "open", f"Open: {reason}"
    gains = gains_of(scene.settings)
    switching = scenario.controller.switching
    smooth = switching.kind in SMOOTH_KINDS
    if scenario.controller.traits.pose_error and gains.fuzzy.enabled:
        fuzzy = gains.fuzzy
        restrained = ((fuzzy.leakage > 0) | (fuzzy.dead_zone > 0) | np.isfinite(fuzzy.weight_limit)).any()
        if (gains.drive > 0).all() and not restrained:
            return "integrated", (
                "There is no stiction set: the pose error e drives the fuzzy systems until their output exceeds K_v, "
                "so the platform creeps or slips on until e = 0."
            )
        if (gains.drive > 0).any():
            return "open", (
                "Open: the pose error drives the fuzzy systems in part of the axes only, or leakage, dead zone or "
                "limit bound their output; the set is then not that of K_v alone."
            )
    kv = gains.kv
    if smooth and (kv > 0).all():
        if _driven_by_rate(scene):
            return "open", (
                f"Open: {switching.kind} is zero at rest, so within K_v the platform creeps, and the twist alone "
                "drives the fuzzy systems: their output is a spring towards the start, which the creep ends at."
            )
        reason = f"There is no stiction set: {switching.kind} is zero at rest, so within K_v the platform creeps."
        return "creep", reason
    if smooth and (kv > 0).any():
        return "open", "Open: a smooth switching term that acts on some axes only."
    if (kv == 0).all():
        return "set", (
            "K_v = 0: the set is a point, where the law's wrench balances the gravity error"
            + ("." if scenario.controller.traits.viscous else ", and the motion about it is undamped.")
        )
    if switching.kind == "sign":
        return "set", ""
    return "set", f"With {switching.kind} a platform in the set is at rest exactly."


def _driven_by_rate(scene: Scene) -> bool:
    """Return whether the twist alone drives the fuzzy systems: their output is then a spring towards the start."""
    gains = gains_of(scene.settings)
    by_pose = scene.scenario.controller.traits.pose_error and (gains.drive > 0).any()
    return bool(gains.fuzzy.enabled and not by_pose)


def _case(scene: Scene, law: RestLaw, goals: Goals, name: str, low: Array, high: Array) -> StictionCase:
    point = (high == low).all()  # then it is the goal itself, but for a gravity error
    rest = RestSet.at(scene, law, (goals.best if point else goals.nearest).view, low, high)
    ends = extremes(rest)
    if ends is None:
        return StictionCase(name, rest, None, None)
    found = confirmed(scene, law, rest, ends.displacements[0]) if (high > low).all() else None
    return StictionCase(name, rest, ends, None if found is None else found[1])


def _around_home(scene: Scene, law: RestLaw, box: Array) -> StictionCase:
    home = scene.view(scene.home)
    rest = RestSet.at(scene, law.aimed_at(home.features), home, -box, box)
    return StictionCase("around home", rest, extremes(rest), None)


def _straight_way(fuzzy: Any, goals: Goals) -> Array:
    """Return the output of one rule that fires alone on the way to the goal: displacement/Psi, within the limit."""
    way = goals.nearest.displacement / fuzzy.adaptation
    return np.asarray(np.clip(way, -fuzzy.weight_limit, fuzzy.weight_limit))


def _prior_error(scene: Scene, goals: Goals) -> float | None:
    """Return the image error where the pose error e of `composite` vanishes [px], near the goal; None if not found."""
    rest = Rest(scene.scenario)
    poses, found = rest.settled(goals.nearest.view.pose.rows, rounds=30, of=rest.pose_error)
    return float(rest.residual(poses)[0]) if found[0] else None
