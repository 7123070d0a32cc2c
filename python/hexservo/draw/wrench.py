"""Wrench and leg forces over a run, figure 5."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from hexservo.draw.panels import (
    describe,
    draw_legend,
    fill_panels,
    given_axes,
    note_outcome,
    place_panels,
    whole_run,
)
from hexservo.draw.style import AXES_INKS, BLACK, FAINT, GREY, LEG_INKS, PAGE, THIN, styled
from hexservo.run.result import Result, require_result
from hexservo.run.samples import force_panels, mean_samples, moment_unit
from hexservo.scenario.leg_units import leg_units

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@overload
def control_wrench(result: Result) -> Figure: ...


@overload
def control_wrench(result: Result, *, axes: Sequence[Axes] | NDArray[Any]) -> tuple[Axes, ...]: ...


@styled
def control_wrench(result: Result, *, axes: Sequence[Axes] | NDArray[Any] | None = None) -> Figure | tuple[Axes, ...]:
    """Draw the wrench in N and mN m, in B, and the six leg forces in N (of cranks torques in N m), figure 5.

    Moments of 1 N m and more are in N m.

    Thin lines are the samples; thick lines, if there are enough samples, are their moving means, since the samples
    chatter due to the switching term. The dotted line is the weight in Ḡ that the law feeds forward (1), (15), on each
    axis along which gravity has a part; at the legs it is their force limit, where it is within what they do.
    With `actuators.kind` `position` wrench and leg forces are what the motion takes, and no law feeds the weight
    forward; the dotted line is then the estimated weight.

    Parameters
    ----------
    axes
        Four axes to draw the whole run into: forces along x and y, force along z, moment, leg forces. None: a new
        figure.

    Returns
    -------
    Figure or tuple of Axes
        The new figure, or `axes`.

    Raises
    ------
    TypeError
        For anything but a `Result`.
    ValueError
        For any other number of axes.
    """
    require_result(result)
    forces = force_panels(result)
    unit, per_newton_metre = moment_unit(result)
    moment = per_newton_metre * result.wrench[:, 3:]
    mean = mean_samples(result.time)
    drawn = [[result.wrench[:, panel.columns], *map(np.array, panel.weights.values())] for panel in forces]
    shown = [*drawn, [moment], [result.leg_forces]]
    figure = Figure(figsize=(PAGE, 4.68))
    given = None if axes is None else given_axes(axes, 4)
    if given is None:
        boxes = [*((0.68, bottom, 2.4, 1.1) for bottom in (3.16, 1.82, 0.48)), (4.2, 0.48, 2.5, 3.78)]
        *rows, legs = (place_panels(figure, result, box, values) for box, values in zip(boxes, shown, strict=True))
    else:
        *rows, legs = (whole_run(place, result, values) for place, values in zip(given, shown, strict=True))
    for panels, force in zip(rows, forces, strict=False):  # below them is the moment
        for panel in panels:
            for weight in force.weights.values():
                panel.axes.axhline(weight, color=BLACK, linewidth=1, linestyle=":", gid="weight")
        values, inks = result.wrench[:, force.columns], AXES_INKS[force.columns]
        fill_panels(panels, result, values, force.names, inks, mean, force.weights)
        describe(panels, "force [N]", force.title)
    fill_panels(rows[2], result, moment, ["mx", "my", "mz"], AXES_INKS, mean)
    describe(rows[2], f"moment [{unit}]", "Moment, in B", time=True)
    limit, units = result.scenario.robot.force_limit, leg_units(result.scenario.robot)
    low, high = legs[0].axes.get_ylim()
    limits = [level for level in (-limit, limit) if low < level < high]
    for panel in legs:
        for level in limits:
            panel.axes.axhline(level, color=BLACK, linewidth=1, linestyle=":", gid="limit force")
    names = [f"leg {leg}" for leg in range(1, 7)]
    fill_panels(legs, result, result.leg_forces, names, LEG_INKS, mean, {"limit": limits[-1]} if limits else {})
    describe(legs, *units.efforts, time=True)
    if given is None:
        explained = {}
        if mean > 1:
            period = 1e3 * mean * float(np.median(np.diff(result.time)))
            explained["samples"] = Line2D([], [], color=GREY, linewidth=THIN, alpha=FAINT)
            explained[f"mean over {period:.3g} ms"] = Line2D([], [], color=GREY)
        if limits:
            explained[f"limit: {limit:.4g} {units.effort}"] = Line2D([], [], color=BLACK, linestyle=":")
        if explained:
            draw_legend(figure, explained)
        if result.scenario.actuators.kind == "position":
            figure.text(
                0.01, 0.985, "What the motion takes; the law commands positions", fontsize=7, va="top", color=GREY
            )
    note_outcome(figure if given is None else given[-1], result)
    return figure if given is None else given
