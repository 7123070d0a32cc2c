"""Which keys that vary, or gains that a search chooses, act in none of the runs of a plan."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from hexservo.findings.check_keys import needed_by
from hexservo.run.variations import changes_of_run
from hexservo.scenario.keys import value_at
from hexservo.scenario.rules import Problem
from hexservo.scenario.scenario import Scenario

if TYPE_CHECKING:
    from hexservo.campaigns.plan import CampaignPlan

_LOG_EVERY = "simulation.log_every"


def _limits_forces(scenario: Scenario) -> bool:
    return scenario.actuators.saturation or scenario.actuators.kind == "position_torque"


def _ends_runs(scenario: Scenario) -> bool:
    return scenario.robot.on_limit == "stop"


_STOPS = "robot.on_limit: stop"
_LIMITS: dict[str, tuple[Callable[[Scenario], bool], str, str]] = {
    "robot.force_limit": (
        _limits_forces,
        "actuators.saturation: true or actuators.kind: position_torque",
        "peak_leg_force",
    ),
    "robot.stroke": (
        lambda scenario: _ends_runs(scenario) or scenario.actuators.takes_positions,
        f"{_STOPS} or drives that take positions (actuators.kind)",
        "peak_leg_excursion",
    ),
    "robot.speed_limit": (_ends_runs, _STOPS, "peak_leg_speed"),
    "robot.joint_limit": (_ends_runs, _STOPS, "peak_base_joint or peak_platform_joint"),
}
"""Limits of the legs -> whether one changes a run, with what it does, and the metrics to bound in its place."""


def keys_that_never_act(plan: CampaignPlan) -> Iterator[Problem]:
    """Find keys that vary, or gains to search, that act in none of the runs, or change no number of a run."""
    variables = {} if plan.tune is None else plan.tune.variables
    places: list[tuple[str, ...]] = [("vary", key) for key in plan.vary]
    places += [("tune", "variables", key) for key in variables]
    given = {place[-1] for place in places}
    idle = [place for place in places if needed_by(place[-1], [plan.scenario], given)]
    runs = [plan.scenario, *scenarios_at_the_ends(plan)] if idle else []  # a key may make another one act
    for place in places:
        if sentence := _changes_no_number(plan.scenario, place[-1]):
            yield place, sentence
        elif place in idle and (needed := needed_by(place[-1], runs, given)):
            yield place, f"has no effect here; it acts {needed}"


def _changes_no_number(scenario: Scenario, key: str) -> str:
    """Return why no metric of a run depends on a key, though a log or a report does; "" where one may."""
    if key == _LOG_EVERY:
        return "has no effect here; no metric of a run depends on it; drop the key"
    if key not in _LIMITS or value_at(scenario, key) is None:  # where it is null, a number gives its metric a value
        return ""
    acts, when, metric = _LIMITS[key]
    if acts(scenario):
        return ""
    return f"has no effect here; it acts only with {when}; bound {metric} in require instead, or drop the key"


def scenarios_at_the_ends(plan: CampaignPlan) -> Iterator[Scenario]:
    """Return scenarios with all that varies, and with each key by itself, at both ends, where they are valid."""
    drawing, law = plan.drawing(), plan.scenario.controller.law
    base = plan.scenario.updated(drawing.base)
    single = {} if plan.tune is None else plan.tune.variables
    for end in (0, 1):
        drawn = drawing.variations(drawing.numbers_at(np.full((1, drawing.dimension), float(end)), 0))
        changes: dict[str, Any] = changes_of_run(drawn, law)
        changes |= {key: one.variation.box[end] for key, one in single.items() if one.groups == (0,)}
        for some in (changes, *({key: value} for key, value in changes.items())):
            with contextlib.suppress(ValueError):
                yield base.updated(some)
