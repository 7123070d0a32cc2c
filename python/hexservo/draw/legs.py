"""Travel, speeds and tilts of the legs over a run, with their limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, overload

from matplotlib.figure import Figure
from numpy.typing import NDArray

from hexservo.draw.panels import draw_over_time
from hexservo.draw.style import PAGE, styled
from hexservo.run.leg_motion import leg_motions
from hexservo.run.result import Result, require_run
from hexservo.run.time_panels import leg_panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_HEIGHT, _STEP = 1.3, 1.53  # of a panel, and from one to the next [in]
_BOTTOM, _TOP = 0.48, 0.29


@overload
def leg_limits(result: Result) -> Figure: ...


@overload
def leg_limits(result: Result, *, axes: Sequence[Axes] | NDArray[Any]) -> tuple[Axes, ...]: ...


@styled
def leg_limits(result: Result, *, axes: Sequence[Axes] | NDArray[Any] | None = None) -> Figure | tuple[Axes, ...]:
    """Draw what the robot limits of its legs: travel, and speeds and tilts where there are such limits.

    Travel is in mm from the middle of the stroke (of cranks in mrad), speeds in mm/s (mrad/s), tilts from home in mrad,
    at the base and at the platform. Dotted lines are the limits; one of which less than a quarter is used is only in
    the title.

    Parameters
    ----------
    axes
        As many axes as there are limits, 1 to 4, to draw the whole run into: travel, speeds, tilts at the base, tilts
        at the platform. None: a new figure.

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
    motions = leg_motions(result)
    shown = [replace(leg_panel(motion), title=f"{motion.title} (limit: {motion.limit.text})") for motion in motions]
    boxes = [(0.68, _BOTTOM + _STEP * number, 6.04, _HEIGHT) for number in reversed(range(len(shown)))]
    figure = Figure(figsize=(PAGE, _BOTTOM + _TOP + _HEIGHT + _STEP * (len(shown) - 1)))
    return draw_over_time(figure, result, shown, boxes, axes)
