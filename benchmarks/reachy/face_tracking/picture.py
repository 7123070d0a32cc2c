"""A picture of trials: how far the head looks beside the face."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np

from face_tracking.scene import CASES
from face_tracking.table import Responses, Trial, record_of

__all__ = ["draw"]

_COLOURS = {"shipped": "tab:red", "fix": "tab:orange", "resolved_rate": "tab:blue", "tracking": "tab:green"}
_WORDS = {"shipped": "shipped law", "fix": "open fix"}


def draw(
    path: Path,
    laws: list[str],
    motors: list[str],
    cases: list[str],
    seeds: list[int],
    like: Trial,
    identified: Responses,
) -> None:
    """Draw errors over time, a panel for each of motors and cases, a line for each seed.

    `like` has rate, latency, limit and model.
    """
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(
        len(motors), len(cases), figsize=(4.2 * len(cases), 2.9 * len(motors)), squeeze=False, sharex="col", sharey=True
    )
    for line, motor in zip(panels, motors, strict=True):
        trial = replace(like, motors=motor, identified=identified.get((motor, like.limit), ()))
        for panel, name in zip(line, cases, strict=True):
            case = CASES[name]
            for law in laws:
                for seed in seeds:
                    record = record_of(replace(trial, law=law, case=name, seed=seed))
                    since = record.times >= case.since
                    along = record.errors[since][0] if not case.moves else np.array([-1.0, 0.0])
                    along = along / np.linalg.norm(along)
                    panel.plot(
                        record.times[since] - case.since,
                        record.errors[since] @ along,
                        color=_COLOURS.get(law),
                        linewidth=1.0,
                        alpha=0.8,
                        label=_WORDS.get(law, f"hexservo, {law}") if seed == seeds[0] else None,
                    )
            panel.axhspan(-1.0, 1.0, color="0.9", zorder=0)
            panel.set_title(f"{name}, motors {motor}", fontsize=10)
            panel.set_ylim(-30, 32)
            panel.grid(alpha=0.3)
        line[0].set_ylabel("face beside the axis [deg]")
    for panel in panels[-1]:
        panel.set_xlabel("time [s]")
    panels[0][-1].legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)
