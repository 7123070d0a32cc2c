"""Types of NumPy arrays, and what counts as real numbers."""

from __future__ import annotations

from numbers import Real
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Complex: TypeAlias = NDArray[np.complex128]
Mask: TypeAlias = NDArray[np.bool_]


def real_numbers(given: Any) -> Array | None:
    """Return a copy of real numbers as an array of floats, of any shape.

    None for text, booleans, complex, ragged and masked ones: NumPy itself takes the text "1" and True for 1, the real
    part of a complex number, and what is under a mask.
    """
    if holds_no_number(given):
        return None
    try:
        found = np.asarray(given)
        if found.dtype.kind == "O" and not all(_is_number(item) for item in found.flat):
            return None
        return found.astype(float) if found.dtype.kind in "iufO" else None
    except (TypeError, ValueError, OverflowError):  # ragged, or an integer beyond the floats
        return None


def holds_no_number(given: Any) -> bool:
    """Return whether lists hold, or this is, a boolean or a masked value: NumPy would make 0, 1 or NaN of it."""
    if isinstance(given, list | tuple):
        return any(holds_no_number(item) for item in given)
    if isinstance(given, np.ndarray):
        return given.dtype.kind == "b" or bool(np.ma.is_masked(given))
    return isinstance(given, bool | np.bool_)


def _is_number(item: object) -> bool:
    return isinstance(item, Real) and not isinstance(item, bool)
