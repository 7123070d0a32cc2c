"""What acts in runs from small starts that a linear loop does not describe: the runs repeated without it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from hexservo.findings.analysis.camera_runs import StartRun, start_runs, with_perfect_camera
from hexservo.findings.analysis.linear_loop import Clock
from hexservo.scenario.scenario import Scenario

Removal: TypeAlias = Literal["switching", "fuzzy", "camera"]


@dataclass(frozen=True)
class Repeat:
    """The runs from small starts without K_v, without fuzzy systems, or with a frame at every tick and no latency."""

    without: Removal
    runs: tuple[StartRun, ...]

    @property
    def rests(self) -> bool:
        """Whether all come to rest."""
        return all(run.rests for run in self.runs)


def repeated_starts(home: Scenario, slowest: float, clock: Clock, *, learns: bool, rest: bool) -> tuple[Repeat, ...]:
    """Repeat runs from small starts without what may be the cause of their ending, and with a perfect camera.

    Parameters
    ----------
    home
        With the image of rest as its goal, seen from home.
    slowest
        Time constant of the slowest mode of its linear loop [s].
    clock
        Of its camera.
    learns
        Whether fuzzy systems act; they are only removed where K_v is not the cause.
    rest
        Whether its own runs come to rest: the camera is no reason for that.
    """
    law = home.controller.law
    found = []
    if home.controller.traits.switching and np.any(np.asarray(home.controller.gains.kv)):
        found.append(Repeat("switching", start_runs(home.updated({f"controller.{law}.kv": 0.0}), slowest)))
    if learns and not any(repeat.rests != rest for repeat in found):
        found.append(Repeat("fuzzy", start_runs(home.updated({f"controller.{law}.fuzzy.enabled": False}), slowest)))
    if not rest and clock != Clock(1, 0):
        found.append(Repeat("camera", start_runs(with_perfect_camera(home), slowest)))
    return tuple(found)
