"""Where what is tried with larger and larger sizes begins to fail."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

ROUNDS = 2
"""Of the search in quarters between the largest size that is good and the smallest that fails."""

_Size = TypeVar("_Size", int, float)


def bordering(tried: Mapping[_Size, bool]) -> tuple[_Size | None, _Size | None]:
    """Return the largest good size below the smallest that fails, and that one; None for none."""
    failed = min((size for size, good in tried.items() if not good), default=None)
    good = (size for size, is_good in tried.items() if is_good and (failed is None or size < failed))
    return max(good, default=None), failed


def outwards(tried: Mapping[_Size, bool], own: _Size) -> dict[_Size, bool]:
    """Return what was tried from a size on that is good; all where it is not."""
    return {size: good for size, good in tried.items() if size >= own or not tried.get(own, False)}


def quarters(tried: Mapping[int, bool]) -> list[int]:
    """Return whole numbers a quarter, a half and three quarters of the way between both; empty without one of them."""
    good, failed = bordering(tried)
    if good is None or failed is None:
        return []
    return [good + round(part * (failed - good)) for part in (0.25, 0.5, 0.75)]
