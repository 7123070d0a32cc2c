"""An adaptation that is too fast for the stiffness and the damping of its loop (docs/diagnosis/adaptation.md)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from hexservo.findings.diagnosis.environment import ideal, less, ordinary
from hexservo.findings.diagnosis.model import Alone, Case, Cause, Removal, in_scenario
from hexservo.scenario.arrays import Array
from hexservo.scenario.fitted import UPTAKE, fitted_adaptation, machine_of
from hexservo.scenario.laws import laws_with
from hexservo.scenario.wording import number

# times the fitted one: the loop bears 10 times the fitted drive, and the default 1/Psi is 19 times the fitted one
_FAST = {"drive": 4.0, "fuzzy.adaptation": 40.0}
_WORDS = {"drive": "a drive", "fuzzy.adaptation": "an adaptation"}


def _fitting(case: Case) -> dict[str, Array]:
    """Return what fits the law's own stiffness and damping of drive and adaptation that are too fast, by key."""
    scenario = case.scenario
    gains = scenario.controller.gains
    if scenario.controller.law not in laws_with("memory", "pose_error") or not gains.fuzzy.enabled:
        return {}
    try:
        inertia = machine_of(scenario).inertia
    except ValueError:  # of a machine that the core refuses
        return {}
    stiffness, damping = (np.broadcast_to(np.asarray(gain, dtype=float), 6) for gain in (gains.kt, gains.kd))
    if not (stiffness > 0.0).all():
        return {}
    with np.errstate(over="ignore", under="ignore", divide="ignore", invalid="ignore"):
        omega = np.sqrt(stiffness / inertia)
        zeta = 0.5 * np.maximum(damping / inertia / omega - UPTAKE, UPTAKE)
        fitted = fitted_adaptation(inertia, omega, zeta)
        own = {"drive": np.asarray(gains.drive), "fuzzy.adaptation": 1.0 / np.asarray(gains.fuzzy.adaptation)}
        most = {"drive": fitted["drive"], "fuzzy.adaptation": 1.0 / fitted["fuzzy.adaptation"]}
    return {
        key: value
        for key, value in fitted.items()
        if np.isfinite(value).all() and (own[key] > _FAST[key] * most[key]).any()
    }


def _changes(case: Case, fitting: dict[str, Array]) -> dict[str, Any]:
    return {f"controller.{case.scenario.controller.law}.{key}": value.tolist() for key, value in fitting.items()}


def _removals(case: Case) -> list[Removal]:
    fitting = _fitting(case)
    one_by_one = [{key: value} for key, value in fitting.items()]
    together = [fitting] if len(fitting) > 1 else []
    return [
        Removal(
            f"{' and '.join(_words(key, value) for key, value in some.items())} to fit stiffness and damping",
            _changes(case, some),
        )
        for some in one_by_one + together
    ]


def _words(key: str, value: Array) -> str:
    """Return the name of a setting; of the drive with its value [1/s]."""
    least, most = (number(float(end)) for end in (value.min(), value.max()))
    return f"{_WORDS[key]} of {least if least == most else f'{least} to {most}'} 1/s" if key == "drive" else _WORDS[key]


def _alone(case: Case) -> list[Alone]:
    """Try it in the law's own loop: default gains are of another rate, and bear another adaptation."""
    without = ideal(case.scenario)
    return [Alone({**without, **_changes(case, _fitting(case))}, without)]


def with_other_gains(keys: Iterable[str]) -> Callable[[Case], list[Alone]]:
    """Return how gains are tried alone: with an adaptation that fits them too, where theirs is too fast for them.

    Gains that fail only with an adaptation that is too fast are not the cause.

    Parameters
    ----------
    keys
        Of the cause.
    """

    def alone(case: Case) -> list[Alone]:
        without = {**ideal(case.scenario), **ordinary(case.scenario)}
        own = less(without, in_scenario(keys, case.scenario))
        fitting = _changes(case, _fitting(case))
        return [Alone(without, own), *([Alone(without, {**own, **fitting})] if fitting else [])]

    return alone


ADAPTATION = Cause(
    "fast_adaptation",
    "an adaptation that is too fast for the loop",
    frozenset({"LAW.drive", "LAW.fuzzy.adaptation"}),
    _removals,
    alone=_alone,
    kind="law",
)
