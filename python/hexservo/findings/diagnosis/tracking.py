"""Causes in the settings of the law `tracking`, and how each is removed from a scenario."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.diagnosis.environment import BASE_MOTIONS, differs, ideal, less
from hexservo.findings.diagnosis.gains import default_gains
from hexservo.findings.diagnosis.model import Alone, Case, Cause, Removal, removal_by
from hexservo.findings.leg_feedback import OF_MARGIN, feedback_margin, integral_margin
from hexservo.scenario.keys import keys_below, value_at
from hexservo.scenario.laws import Tracking

_LAW = "tracking"
_BLOCK = f"controller.{_LAW}"
_FILTER = ("noise", "acceleration", "speed", "jump", "certainty")
_LEAST_NOISE = 0.02  # [px], that the filter assumes for features without noise
# of what is led, followed and seen
_CONTEXT = ("actuators.position", "target.motion", "camera.period", "camera.latency", "camera.latency_jitter")

_DRIVES = ("actuators",)  # whose legs the feedback and the offset correct, as late as they are


def _of_the_law(changes: Callable[[Case], Mapping[str, Any]], words: str) -> Callable[[Case], list[Removal]]:
    def removals(case: Case) -> list[Removal]:
        if case.scenario.controller.law != _LAW:
            return []
        found = {key: value for key, value in changes(case).items() if differs(value_at(case.scenario, key), value)}
        return removal_by(words, found)

    return removals


def _alone(changes: Callable[[Case], Mapping[str, Any]], context: tuple[str, ...]) -> Callable[[Case], list[Alone]]:
    """Keep legs, motion, camera times and the law's other settings: what these settings do depends on them."""

    def alone(case: Case) -> list[Alone]:
        kept = {key for block in (*_CONTEXT, *context) for key in keys_below(block)}
        if case.scenario.target.frame == "world":  # which moves before the camera as the base does
            kept.update(BASE_MOTIONS)
        without = less(ideal(case.scenario), kept)
        return [Alone({**without, **changes(case)}, without)]

    return alone


def _led(case: Case) -> Mapping[str, Any]:
    return {f"{_BLOCK}.lead": Tracking().lead}


def _matched(case: Case) -> Mapping[str, Any]:
    """Return what suits the target's distance and the machine's size, with the noise that the features have."""
    defaults = default_gains(case.scenario)
    usual = {key: defaults[key] for key in (f"{_BLOCK}.{name}" for name in _FILTER)}
    return {**usual, f"{_BLOCK}.noise": max(scene_of(case.scenario).image_noise, _LEAST_NOISE)}


def _at_once(case: Case) -> Mapping[str, Any]:
    """Return the settings of `_matched` with a velocity that counts however uncertain it is."""
    return {**_matched(case), f"{_BLOCK}.certainty": 0.0}


def _filters(case: Case) -> list[Removal]:
    words = "the filter of the target at its defaults for the target's distance, and the noise that the features have"
    return [
        *_of_the_law(_matched, words)(case),
        *_of_the_law(_at_once, f"{words}, with every velocity counted (certainty 0)")(case),
    ]


def _within_margins(case: Case) -> Mapping[str, Any]:
    """Return feedback and integral of at most half their margins, that of the integral with this feedback."""
    own = {name: value_at(case.scenario, f"{_BLOCK}.{name}") for name in ("feedback", "integral")}
    if not any(own.values()):
        return {}
    feedback = {f"{_BLOCK}.feedback": min(own["feedback"], OF_MARGIN * feedback_margin(case.scenario))}
    most = OF_MARGIN * integral_margin(case.scenario.updated(feedback))
    return {**feedback, f"{_BLOCK}.integral": min(own["integral"], most)}


def legs_within_margins(case: Case) -> Mapping[str, Any]:
    """Return the changes to ideal devices but for the drives, with feedback and integral within their margins.

    {} where they are, and with another law.
    """
    if not _of_the_law(_within_margins, "")(case):
        return {}
    return _alone(_within_margins, _DRIVES)(case)[0].without


def well_set(case: Case) -> Mapping[str, Any]:
    """Return the settings of the law that suit legs and features; {} with another law, which has no such settings."""
    return {**_at_once(case), **_led(case)} if case.scenario.controller.law == _LAW else {}


def _pose(case: Case) -> Mapping[str, Any]:
    return {f"{_BLOCK}.follow": "pose"}


def _cause(
    key: str,
    title: str,
    names: tuple[str, ...],
    changes: Callable[[Case], Mapping[str, Any]],
    words: str,
    context: tuple[str, ...] = (),
) -> Cause:
    keys = frozenset(f"LAW.{name}" for name in names)
    return Cause(key, title, keys, _of_the_law(changes, words), alone=_alone(changes, context), kind="law")


TRACKING: tuple[Cause, ...] = (
    _cause("lag_not_led", "a lag of the legs that is not led", ("lead",), _led, "the lag of the legs led in full"),
    Cause(
        "target_filter",
        "a filter of the target that does not suit its motion",
        frozenset(f"LAW.{name}" for name in _FILTER),
        _filters,
        alone=_alone(_at_once, ()),
        kind="law",
    ),
    _cause("direction_alone", "a law that follows a direction alone", ("follow",), _pose, "the pose followed"),
    _cause(
        "leg_feedback",
        "a feedback or integral of the legs beyond its margin",
        ("feedback", "integral"),
        _within_margins,
        "feedback and integral of at most half their margins",
        _DRIVES,
    ),
)
