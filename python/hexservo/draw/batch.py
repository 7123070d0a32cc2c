"""Figure of a batch for a notebook: settling time and final error of every run, or what else was measured."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from hexservo.draw.style import BLUE, PAGE, VERMILION, styled
from hexservo.run.metrics import metric_label
from hexservo.run.variations import label_of_varied

if TYPE_CHECKING:
    from hexservo.run.batch import BatchResult

_FIRST = ("settling_time", "final_error")  # those that are drawn, where they were measured


def drawn_metrics(batch: BatchResult) -> tuple[str, ...]:
    """Return the metrics that the figure shows, at most two; none where the batch measured none."""
    return tuple(name for name in _FIRST if name in batch.metrics) or tuple(batch.metrics)[:2]


@styled
def batch_figure(batch: BatchResult) -> Figure:
    """Draw `drawn_metrics`, of which there are some, over the varied key, or, if several vary, as shares of runs."""
    drawn = drawn_metrics(batch)
    figure = Figure(figsize=(PAGE, 2.4), layout="constrained")
    varied = [(key, values) for key, values in batch.variations.items() if len(values) > 1]
    over = varied[0] if len(varied) == 1 and varied[0][1].ndim == 1 else None
    done = batch.outcome == "completed"
    for axes, name in zip(figure.subplots(1, len(drawn), squeeze=False)[0], drawn, strict=True):
        values = batch.metrics[name]
        label = metric_label(name, batch.scenario.robot)
        if over is not None:
            key, places = over
            for shown, colour, text in ((done, BLUE, "completed"), (~done, VERMILION, "ended early")):
                if (shown & np.isfinite(values)).any():
                    axes.plot(places[shown], values[shown], ".", color=colour, markersize=3, label=text)
            axes.set_xlabel(label_of_varied(batch.scenario, key))
            axes.set_ylabel(label)
        else:
            known = np.sort(values[np.isfinite(values)])
            axes.step(known, np.arange(1, len(known) + 1) / len(batch), where="post", color=BLUE)
            axes.set_ylim(0, 1.02)
            axes.set_xlabel(label)
            axes.set_ylabel("share of runs below it")
        known = values[np.isfinite(values)]
        if name == "final_error" and len(known) and known.min() > 0 and known.max() > 100 * known.min():
            (axes.set_yscale if over is not None else axes.set_xscale)("log")
    if over is not None and not done.all():
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure
