"""The grid that numbers of a log are rounded to: pixels of a detector, times of a program that runs at ticks."""

from __future__ import annotations

import numpy as np

from hexservo.scenario.arrays import Array

_FEWEST = 20  # different numbers, for none to be on a grid by chance
_OF_DRIVER = 1e-9  # differences that are smaller are the arithmetic of a driver [px; s]
_ON_GRID = 1e-4  # of its step, by which a number on a grid may be off it


def grid_of(*columns: Array) -> float:
    """Return the step of the grid that numbers are on, 0 where they are on none.

    It is the smallest difference of two numbers of a column, if all differences are whole multiples of it. Each column
    may be off zero by its own part of a step, as pixels from the middle of an image are.

    Parameters
    ----------
    columns
        Numbers that share a step, in a unit of which 1e-9 is nothing.
    """
    gaps = [np.diff(np.unique(column)) for column in columns]
    steps = np.concatenate([gap[gap > _OF_DRIVER] for gap in gaps])
    if len(steps) < _FEWEST - 1:
        return 0.0
    step = float(np.median(steps[steps < 1.5 * steps.min()]))
    off = np.abs(steps / step - np.rint(steps / step))
    return step if float(off.max()) < max(_ON_GRID, 2.0 * _OF_DRIVER / step) else 0.0
