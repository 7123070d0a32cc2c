"""Parts of the sections of a certificate."""

from __future__ import annotations

_SHOWN = 1500  # points of a curve, at most


def stride(count: int) -> slice:
    """Return every k-th of a number of samples, so that a curve has at most 1500 points."""
    return slice(None, None, -(-count // _SHOWN))
