"""The numbers of a run from its index alone: a counter-based generator, keyed by the campaign."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexservo.campaigns.distributions import SEED, Variation, uniform_of
from hexservo.scenario.arrays import Array
from hexservo.scenario.keys import numeric_keys, value_at
from hexservo.scenario.scenario import Scenario

__all__ = ["Drawing"]

_BLOCK = 4  # numbers of 64 bits that one count of Philox gives


@dataclass(frozen=True)
class _Key:
    """How one key takes its numbers."""

    name: str
    distribution: Variation
    start: int  # of its numbers among those of a run
    entries: NDArray[np.int64]  # in the key's own shape: which of its numbers each entry has
    base: Array | float  # that is added

    @property
    def count(self) -> int:
        return int(self.entries.max(initial=0)) + 1


class Drawing:
    """Draws the variations of runs.

    Run i takes the next w blocks of Philox 4x64 (Salmon et al. 2011) from counter i w on, w being as many as its
    numbers need, so that they depend on the key of the campaign and on i alone.
    """

    def __init__(self, scenario: Scenario, vary: Mapping[str, Variation], key: int) -> None:
        self._key = key
        self._keys: list[_Key] = []
        start = 0
        for name, distribution in vary.items():
            one = _Key(
                name, distribution, start, _entries(scenario, name, distribution), _base(scenario, name, distribution)
            )
            self._keys.append(one)
            start += one.count
        self._width = -(-start // _BLOCK)

    def runs(self, first: int, last: int) -> dict[str, NDArray[Any]]:
        """Return the variations of the runs `first` to `last` - 1, for `simulate_batch`.

        Each is (n, ...) in the key's own shape and unit; seeds are uint64.
        """
        count = last - first
        generator = np.random.Philox(key=self._key, counter=first * self._width)
        bits = generator.random_raw(count * self._width * _BLOCK).reshape(count, -1)
        return {one.name: _values(one, bits[:, one.start : one.start + one.count]) for one in self._keys}


def _values(one: _Key, bits: NDArray[np.uint64]) -> NDArray[Any]:
    if one.distribution.kind == SEED:
        return np.ascontiguousarray(bits[:, 0])
    drawn = one.distribution.numbers(uniform_of(bits))
    return np.ascontiguousarray(one.base + drawn[:, one.entries])


def _entries(scenario: Scenario, name: str, distribution: Variation) -> NDArray[np.int64]:
    """Return which of its numbers each entry of a key has; 0-dimensional where the key takes one number."""
    shape = _shape(scenario, name, distribution)
    if not distribution.each:
        return np.zeros(shape, dtype=np.int64)
    places = np.arange(int(np.prod(shape, dtype=int)), dtype=np.int64).reshape(shape)
    if distribution.symmetric:
        return np.unique(np.minimum(places, places.T), return_inverse=True)[1].reshape(shape).astype(np.int64)
    return places


def _shape(scenario: Scenario, name: str, distribution: Variation) -> tuple[int, ...]:
    """Return the shape in which a key varies: a number where it takes one and nothing asks for entries."""
    shapes = numeric_keys(scenario.controller.law)[name].shapes
    present = np.shape(value_at(scenario, name))
    if distribution.symmetric:
        return max(shapes, key=len)
    if () in shapes and not distribution.each and not (distribution.add and present):
        return ()
    return present if present in shapes and present else max(shapes, key=len)


def _base(scenario: Scenario, name: str, distribution: Variation) -> Array | float:
    if not distribution.add:
        return 0.0
    value = np.asarray(value_at(scenario, name), dtype=float)
    shape = _shape(scenario, name, distribution)
    if value.shape != shape and value.ndim == 1 and len(shape) == 2:
        return np.diag(value)
    return np.broadcast_to(value, shape)
