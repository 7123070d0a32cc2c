"""Distributions of what a campaign varies: how a file writes them, and how random bits become their numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import exp10, ndtri

from hexservo.scenario.arrays import Array
from hexservo.scenario.rules import Flag, Number, did_you_mean, is_number, refusal, shown_value

SEED = "each"
"""What the key ``seed`` has in place of a distribution: 64 random bits in each run."""

_KINDS = {
    "normal": "[mean, standard deviation > 0]",
    "uniform": "[low, high], low < high",
    "log": "[low, high], 0 < low < high",
    "choice": "a list of at least one number",
}
_FLAGS = ("add", "each", "symmetric")
_EXPECTED = "one of " + ", ".join(f"{{{kind}: {form}}}" for kind, form in _KINDS.items())
_SIGMAS = 3.0  # of a normal distribution within a box, where no limit ends it
_SMALLEST = 0.5**53  # smallest uniform number; the largest is 1 - this


@dataclass(frozen=True)
class Variation:
    """How one key of a scenario varies (docs/campaigns.md, section 2).

    The drawn number is in the unit of its key: SI units, radians and pixels.
    """

    kind: str  # normal, uniform, log, choice, or SEED
    parameters: tuple[float, ...] = ()  # as the file writes them
    clip: tuple[float, float] | None = None  # what is drawn beyond these becomes the nearer one
    add: bool = False  # the number is added to that of the scenario
    each: bool = False  # every entry of an array has a separate number
    symmetric: bool = False  # with `each`: entries (i, j) and (j, i) have the same number

    def numbers(self, uniform: Array) -> Array:
        """Return the drawn numbers that belong to uniform ones.

        Parameters
        ----------
        uniform
            Numbers above 0 and below 1, of any shape; the result has the same shape.
        """
        if self.kind == "choice":
            return _entry(self.parameters, uniform)
        first, last = self.parameters
        drawn = first + last * ndtri(uniform) if self.kind == "normal" else self._between(first, last, uniform)
        return np.asarray(drawn if self.clip is None else np.clip(drawn, *self.clip), dtype=float)

    @property
    def reach(self) -> tuple[float, float]:
        """The smallest and the largest number that is drawn, ends included; of a normal one 8.2 standard deviations."""
        if self.kind == "normal":
            low, high = self.numbers(np.array([_SMALLEST, 1.0 - _SMALLEST]))
        else:
            low, high = min(self.parameters), max(self.parameters)
            if self.clip is not None:
                low, high = np.clip((low, high), *self.clip)
        return float(low), float(high)

    @property
    def box(self) -> tuple[float, float]:
        """The smallest and the largest number that a search for the worst case tries.

        A limit that draws reach is an end of the box. An end of a normal distribution without one, or with one that is
        farther than all draws and so changes none, is 3 standard deviations from the mean.
        """
        if self.kind != "normal" or self.clip is None:
            return self._within_sigmas
        (near, far), (least, largest) = self._within_sigmas, replace(self, clip=None).reach
        return (
            self.clip[0] if self.clip[0] >= least else near,
            self.clip[1] if self.clip[1] <= largest else far,
        )

    @property
    def _within_sigmas(self) -> tuple[float, float]:
        """What is drawn, of a normal distribution the mean +- 3 standard deviations without its limits."""
        if self.kind != "normal":
            return self.reach
        mean, sigma = self.parameters
        return mean - _SIGMAS * sigma, mean + _SIGMAS * sigma

    def in_box(self, share: Array) -> Array:
        """Return numbers by their place in the box, from 0 to 1; the places of `log` and `choice` are of equal size.

        0 has the least number and 1 the largest one: those of `choice` are in ascending order.
        """
        return _entry(sorted(self.parameters), share) if self.kind == "choice" else self._between(*self.box, share)

    def _between(self, low: float, high: float, share: Array) -> Array:
        """Return the numbers at shares of the way between two: of `log` in their logarithms."""
        start, end = (np.log10(low), np.log10(high)) if self.kind == "log" else (low, high)
        found = start + (end - start) * share
        return np.asarray(np.clip(exp10(found) if self.kind == "log" else found, low, high))  # rounding may pass an end

    def share_of(self, numbers: Array) -> Array:
        """Return the places of numbers in the box, the inverse of `in_box`; 0 or 1 beyond its ends."""
        low, high = self.box
        if self.kind == "choice":
            places = np.abs(numbers[..., None] - np.sort(self.parameters)).argmin(axis=-1)
            return np.asarray((places + 0.5) / len(self.parameters))
        if self.kind == "log":
            low, high, numbers = np.log(low), np.log(high), np.log(np.maximum(numbers, low))
        width = (high - low) or 1.0  # rounding may leave none, as of [1e20, 1.0]: then every place has the same number
        return np.asarray(np.clip((numbers - low) / width, 0.0, 1.0))

    def to_plain(self) -> Any:
        """Return what a campaign file writes for it."""
        if self.kind == SEED:
            return SEED
        plain: dict[str, Any] = {self.kind: list(self.parameters)}
        if self.clip is not None:
            plain["clip"] = list(self.clip)
        return plain | {flag: True for flag in _FLAGS if getattr(self, flag)}


def _entry(listed: Sequence[float], share: Array) -> Array:
    """Return those of listed numbers that are at shares of the way, from 0 to 1, along the list."""
    count = len(listed)
    return np.array(listed, dtype=float)[np.minimum((share * count).astype(np.int64), count - 1)]


def uniform_of(bits: NDArray[np.uint64]) -> Array:
    """Return numbers above 0 and below 1, the middles of 2^52 equal cells, from the upper 52 of 64 random bits."""
    return np.asarray(((bits >> np.uint64(12)).astype(float) + 0.5) * 0.5**52)  # all of them are exact


def between_ends(uniform: Array) -> Array:
    """Return uniform numbers from 0 to 1 with both ends, which no distribution has a number for, moved inside."""
    return np.asarray(np.clip(uniform, _SMALLEST, 1.0 - _SMALLEST))


def variation_of(value: Any) -> Variation:
    """Return a distribution from its form in a file.

    Raises
    ------
    ValidationError
        One problem for each part that is wrong, at its place.
    """
    if not isinstance(value, Mapping):
        raise refusal(((), f"expected {_EXPECTED}; got {shown_value(value)}"))
    unknown = [key for key in value if key not in (*_KINDS, "clip", *_FLAGS)]
    kinds = [kind for kind in _KINDS if kind in value]
    if unknown:
        known = (*_KINDS, "clip", *_FLAGS)
        raise refusal(
            *(
                ((key,), f"unknown key{did_you_mean(key, known) or ';'} known keys: {', '.join(known)}")
                for key in unknown
            )
        )
    if len(kinds) != 1:
        got = f"{len(kinds)} of them: {', '.join(kinds)}" if kinds else "none of them"
        raise refusal(((), f"expected {_EXPECTED}; got {got}"))
    kind = kinds[0]
    parameters = _numbers(value[kind], (kind,), _KINDS[kind], None if kind == "choice" else 2)
    first, last = parameters[0], parameters[-1]
    if (
        (kind == "normal" and last <= 0)
        or (kind in ("uniform", "log") and first >= last)
        or (kind == "log" and first <= 0)
    ):
        raise refusal(((kind,), f"expected {_KINDS[kind]}, got {shown_value(value[kind])}"))
    clip = None
    if "clip" in value and kind == "choice":
        raise refusal(
            (("clip",), f"expected none beside choice, whose numbers are listed, got {shown_value(value['clip'])}")
        )
    if "clip" in value:
        low, high = _numbers(value["clip"], ("clip",), "[low, high], low < high", 2)
        if low >= high:
            raise refusal((("clip",), f"expected [low, high], low < high, got {shown_value(value['clip'])}"))
        clip = (low, high)
    flags = {flag: Flag().accept(value[flag]) for flag in _FLAGS if flag in value}
    found = Variation(kind, parameters, None, **flags)
    if found.symmetric and not found.each:
        raise refusal((("symmetric",), "expected each: true beside it, got none"))
    if clip is not None:
        low, high = found.box  # of a normal one 3 sigma: limits beyond would make nearly all runs equal
        if clip[1] <= low or clip[0] >= high:
            what = f", mean +- {_SIGMAS:g} standard deviations" if kind == "normal" else ""
            raise refusal(
                (("clip",), f"expected limits that leave something of {low:g} ... {high:g}{what}, got {list(clip)}")
            )
    return Variation(kind, parameters, clip, **flags)


def _numbers(value: Any, place: tuple[str, ...], expected: str, count: int | None) -> tuple[float, ...]:
    if not isinstance(value, list | tuple) or not value or (count is not None and len(value) != count):
        raise refusal((place, f"expected {expected}, got {shown_value(value)}"))
    wrong = next((item for item in value if not is_number(item)), None)
    if wrong is not None:
        raise refusal((place, f"expected {expected}, got {shown_value(wrong)} in it"))
    return tuple(Number().accept(item) for item in value)
