"""Analyses before a run: limits that follow from the geometry, gains and timing of a scenario."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from typing import Any, TypeVar

import numpy as np

from hexservo.findings.analysis.loop_of_scenario import with_features, with_gains
from hexservo.findings.analysis.not_computed import NotComputed, not_computed
from hexservo.findings.display import Findings
from hexservo.findings.evidence import Section
from hexservo.scenario.fields import described
from hexservo.scenario.motion import moves
from hexservo.scenario.pixels import WRONG_CAMERA, has_camera_wrong
from hexservo.scenario.scenario import Scenario, require_scenario
from hexservo.scenario.wording import several_names, wrong_type

__all__ = ["PARTS", "Analysis", "NotComputed", "analyse"]

_Found = TypeVar("_Found")

_OF_RUNS = ("largest_start",)  # whose runs are those of the scenario, with its motion and its camera
_OF_PIXELS = ("conditioning", *_OF_RUNS)  # whose noise and border are those of the camera's pixels
_OF_KNOWN_CAMERA = ("camera_rate",)  # is open where the controller has the camera wrong
_RIGHT_CAMERA = (
    "The controller's focal length and principal point are taken as those of the camera, also in short runs; in this "
    f"scenario they differ ({' and '.join(WRONG_CAMERA)})."
)

# name -> (module of this package, its subject). A module has analyse(scenario), which returns a `Part`; the module
# beside it, with _words after its name, has section(part).
PARTS: dict[str, tuple[str, str]] = {
    "conditioning": ("conditioning", "pose observability from one image"),
    "workspace": ("workspace", "reach, singularities and loads of the legs"),
    "stiction": ("stiction", "stiction: residual errors held by the switching term"),
    "equilibria": ("equilibria", "where a transpose law comes to rest, and whether a false equilibrium attracts"),
    "drift": ("drift", "creep or drift of a law with a pose error under unequal depth errors"),
    "camera_rate": (
        "camera_rate",
        "largest stable camera period and latency of the linear loop, gain and delay margins",
    ),
    "largest_start": ("largest_start", "largest starting error and slowest camera that settle, from runs"),
}


@described
@dataclass(frozen=True, eq=False, repr=False)
class Analysis(Findings):
    """Analysis of a scenario before a run: one result per part, by the part's name.

    A part whose numbers leave the range of double precision, or whose matrices are singular, is a `NotComputed`.
    """

    scenario: Scenario  # that was analysed
    parts: dict[str, Any]  # name of a part, such as "conditioning" -> its findings, or a `NotComputed`

    def __getattr__(self, name: str) -> Any:
        """Return a part by its name, as in ``analysis.conditioning``."""
        parts = self.__dict__.get("parts", {})  # none yet while it is unpickled or copied
        if name not in parts:
            raise AttributeError(f"this analysis has no part {name!r}; it has {', '.join(parts) or 'none'}")
        return parts[name]

    def sections(self) -> tuple[Section, ...]:
        """Return sentences, tables and figures of all parts, in their order."""
        return tuple(self._section(name, part) for name, part in self.parts.items())

    def _section(self, name: str, part: Any) -> Section:
        found: Section | NotComputed = _computed(self.scenario, name, part.section)
        section = found.section() if isinstance(found, NotComputed) else found
        if not section.data.get("applies", True):  # no numbers were computed
            return section
        taken = _about_motion(self.scenario, name in _OF_RUNS)
        if has_camera_wrong(self.scenario) and name not in (*_OF_RUNS, *_OF_KNOWN_CAMERA):
            taken.append(_RIGHT_CAMERA)
        return replace(section, sentences=(*section.sentences, *taken)) if taken else section

    def to_dict(self) -> dict[str, Any]:
        """Return verdicts, sentences and all numbers for strict JSON, by part, in SI units and pixels."""
        return {section.name: section.to_dict() for section in self.sections()}


def analyse(
    scenario: Scenario, parts: Sequence[str] | None = None, *, progress: Callable[[str], object] | None = None
) -> Analysis:
    """Analyse a scenario before a run (docs/analysis/).

    Parameters
    ----------
    scenario
        Nothing of it is run but for short checks of a result.
    parts
        Names of `PARTS`, in any order; None for all.
    progress
        Called with a part's name before it begins.

    Returns
    -------
    Analysis
        A part that cannot be computed, since a number leaves the range of double precision or a matrix is singular,
        is a `NotComputed`: its section gives the reason and names the scenario's extreme values.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C, also while something runs.
    TypeError
        For anything but a `Scenario`, names of parts, and a function.
    ValueError
        For parts that there are not, and for one text in place of a list.
    """
    require_scenario(scenario)
    if isinstance(parts, str):
        raise ValueError(f"parts: expected a list of names, got the text {parts!r}; write [{parts!r}]")
    asked = list(PARTS) if parts is None else several_names("parts", parts, "a list of names, or None")
    if progress is not None and not callable(progress):
        raise wrong_type("progress", "a function or None", progress)
    if unknown := [part for part in asked if part not in PARTS]:
        raise ValueError(f"parts: expected some of {', '.join(PARTS)}, got {', '.join(map(repr, unknown))}")
    found = {}
    written = with_gains(scenario)  # parts change the goal, to which gains of `auto` would be fitted again
    pinhole = with_features(written)
    for name, (module, _) in PARTS.items():
        if name in asked:
            if progress is not None:
                progress(name)
            part = import_module(f"hexservo.findings.analysis.{module}").analyse
            own = name in _OF_PIXELS or (name in _OF_KNOWN_CAMERA and has_camera_wrong(scenario))
            of = written if own else pinhole
            found[name] = _computed(scenario, name, partial(part, of))
    return Analysis(scenario, found)


def _about_motion(scenario: Scenario, of_runs: bool) -> list[str]:
    """Return what a part takes of the motion of base and target, of which runs have all."""
    base, target = moves(scenario.base_motion), scenario.target.motion.kind != "none"
    if not (base or target):
        return []
    one = "base" if base else "target"
    if of_runs:
        what = "base and target move" if base and target else f"the {one} moves"
        return [f"In all runs {what} as in the scenario."]
    if base and target:
        return ["Base and target are taken at rest; in this scenario both move."]
    return [f"The {one} is taken at rest; in this scenario it moves."]


def _computed(scenario: Scenario, name: str, of: Callable[[], _Found]) -> _Found | NotComputed:
    """Return the result of a function, or the reason why it cannot be computed, such as an overflow."""
    try:
        with np.errstate(over="raise", invalid="raise", divide="raise", under="ignore"):
            return of()
    except (ArithmeticError, ValueError) as error:  # LinAlgError is a ValueError, FloatingPointError an ArithmeticError
        return not_computed(scenario, name, PARTS[name][1], error)
