"""A picture of trials: how far the head looks beside the face."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np

from face_tracking.scene import CASES
from face_tracking.table import Responses, Trial, record_of
from hexservo.draw.style import BLACK, BLUE, DASH_DOT, DASHED, ORANGE, VERMILION, Ink

__all__ = ["draw"]

SHOWN = ("yaw", "moving", "jump")
"""Cases that have a row of panels; the others look alike."""
_INKS = {
    "shipped": Ink(ORANGE),
    "fix": Ink(VERMILION, DASHED),
    "resolved_rate": Ink(BLUE, DASH_DOT),
    "tracking": Ink(BLACK),
}
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

    `like` has rate, latency, limit and model. Of several cases those of `SHOWN` are drawn, where they are among them.
    """
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    drawn = [name for name in cases if name in SHOWN] or cases
    figure, panels = plt.subplots(
        len(drawn), len(motors), figsize=(4.4 * len(motors), 2.4 * len(drawn) + 0.4), squeeze=False, sharey=True
    )
    for motor, column in zip(motors, panels.T, strict=True):
        trial = replace(like, motors=motor, identified=identified.get((motor, like.limit), ()))
        for panel, name in zip(column, drawn, strict=True):
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
                        color=_INKS[law].colour,
                        linestyle=_INKS[law].dashes,
                        linewidth=1.2 if law == "tracking" else 0.8,
                        label=_WORDS.get(law, f"hexservo, {law}") if seed == seeds[0] else None,
                    )
            panel.axhspan(-1.0, 1.0, color="0.9", zorder=0)
            panel.set_title(f"{name}, motors {motor}", fontsize=10)
            panel.set_ylim(-30, 32)
            panel.grid(alpha=0.3)
        column[-1].set_xlabel("time [s]")
    for panel in panels[:, 0]:
        panel.set_ylabel("face beside the axis [deg]", fontsize=9)
    handles, names = panels[0][0].get_legend_handles_labels()
    figure.tight_layout(rect=(0.0, 0.0, 1.0, 1.0 - 0.35 / figure.get_figheight()))
    figure.legend(handles, names, loc="upper center", ncols=len(laws), fontsize=9, frameon=False)
    figure.savefig(path, dpi=110)
    plt.close(figure)
