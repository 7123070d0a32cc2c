"""Travel, speeds and tilts of the legs over a run, with their limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hexservo.draw.panels import describe, fill_panels, given_axes, note_outcome, place_panels, whole_run
from hexservo.draw.style import BLACK, LEG_INKS, PAGE, styled
from hexservo.run.leg_motion import leg_motions
from hexservo.run.result import Result, require_result

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
        For anything but a `Result`.
    ValueError
        For any other number of axes.
    """
    require_result(result)
    drawn = leg_motions(result)
    given = None if axes is None else given_axes(axes, len(drawn))
    figure = Figure(figsize=(PAGE, _BOTTOM + _TOP + _HEIGHT + _STEP * (len(drawn) - 1)))
    for number, motion in enumerate(drawn):
        last = number == len(drawn) - 1
        values = [motion.values, np.array(motion.in_sight)] if motion.in_sight else [motion.values]
        if given is None:
            bottom = _BOTTOM + _STEP * (len(drawn) - 1 - number)
            panels = place_panels(figure, result, (0.68, bottom, 6.04, _HEIGHT), values)
        else:
            panels = whole_run(given[number], result, values)
        for panel in panels:
            for level in motion.in_sight:
                panel.axes.axhline(level, color=BLACK, linewidth=1, linestyle=":", gid=f"limit {motion.limit.kind}")
        levels = {"limit": motion.in_sight[-1]} if motion.in_sight else {}
        fill_panels(panels, result, motion.values, [f"leg {leg}" for leg in range(1, 7)], LEG_INKS, 1, levels)
        describe(panels, motion.label, f"{motion.title} (limit: {motion.limit.text})", time=last)
    note_outcome(figure if given is None else given[-1], result)
    return figure if given is None else given
