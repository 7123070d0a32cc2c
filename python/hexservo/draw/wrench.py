"""Wrench and leg forces over a run, figure 5."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, overload

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from hexservo.draw.panels import draw_legend, draw_over_time
from hexservo.draw.style import BLACK, FAINT, GREY, PAGE, THIN, styled
from hexservo.run.result import Result, require_run
from hexservo.run.samples import mean_period, mean_samples
from hexservo.run.time_panels import wrench_panels
from hexservo.scenario.leg_units import leg_units

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_SHOWN = "the wrench as the mean of each tick, leg forces just after its command"
_OF_POSITIONS = {"position": f"What the motion takes: {_SHOWN}", "position_torque": f"What the legs give: {_SHOWN}"}


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
    With `actuators.kind` `position` wrench and leg forces are what the motion takes. Neither there nor under a custom
    controller does a law feed the weight forward; the dotted line is then the estimated weight.

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
        For anything but a `Result`, and for axes that are none.
    ValueError
        For any other number of axes, and where the data are not those of a run (see `Result.save`).
    """
    require_run(result)
    shown = wrench_panels(result)
    mean = mean_samples(result.time)
    robot = result.scenario.robot
    figure = Figure(figsize=(PAGE, 4.68))
    explained = {}
    if mean > 1:
        explained["samples"] = Line2D([], [], color=GREY, linewidth=THIN, alpha=FAINT)
        explained[f"mean over {mean_period(result.time, mean)}"] = Line2D([], [], color=GREY)
    if shown[-1].levels:
        limit = f"limit: {robot.force_limit:.4g} {leg_units(robot).effort}"
        explained[limit] = Line2D([], [], color=BLACK, linestyle=":")
    if explained:
        draw_legend(figure, explained)
    if result.scenario.actuators.takes_positions:
        figure.text(0.01, 0.985, _OF_POSITIONS[result.scenario.actuators.kind], fontsize=7, va="top", color=GREY)
    boxes = [*((0.68, bottom, 2.4, 1.1) for bottom in (3.16, 1.82, 0.48)), (4.2, 0.48, 2.5, 3.78)]
    return draw_over_time(figure, result, shown, boxes, axes, mean)
