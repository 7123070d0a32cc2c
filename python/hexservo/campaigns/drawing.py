"""The numbers of a run from its index alone: a counter-based generator, keyed by the campaign."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexservo.campaigns.distributions import SEED, Variation, uniform_of
from hexservo.run.variations import changes_of_run, label_of_varied
from hexservo.scenario.arrays import Array
from hexservo.scenario.keys import numeric_keys, value_at
from hexservo.scenario.scenario import Scenario

_BLOCK = 4  # numbers of 64 bits that one count of Philox gives


@dataclass(frozen=True)
class _Key:
    """How one key takes its numbers."""

    name: str
    variation: Variation
    start: int  # of its numbers among those of a run
    entries: NDArray[np.int64]  # in the key's own shape: which of its numbers each entry has
    base: Array | float  # that is added

    @property
    def count(self) -> int:
        return int(self.entries.max(initial=0)) + 1


PLACED = ("target.translation", "target.rotation")
"""Keys of `vary` that no scenario has: the target stands elsewhere, displaced as a rigid body.

Translation (3,) [m] and rotation vector (3,) [rad] about the centroid of the points, both in B: p' = R (p - c) + c + t.
"""


_UNITS = dict(zip(PLACED, ("m", "rad"), strict=True))


def with_unit(scenario: Scenario, name: str) -> str:
    """Return the name of a number that varies, as ``target.rotation[0]``, or of a key, with its unit."""
    unit = _UNITS.get(name.partition("[")[0])
    return f"{name} [{unit}]" if unit else label_of_varied(scenario, name)


class Drawing:
    """Draws the variations of runs.

    Run i takes the next w blocks of Philox 4x64 (Salmon et al. 2011) from counter i w on, w being as many as its
    numbers need, so that they depend on the key of the campaign and on i alone.
    """

    def __init__(self, scenario: Scenario, vary: Mapping[str, Variation], key: int) -> None:
        self._key = key
        self._law = scenario.controller.law
        self._keys: list[_Key] = []
        start = 0
        for name, variation in vary.items():
            one = _Key(name, variation, start, _entries(scenario, name, variation), _base(scenario, name, variation))
            self._keys.append(one)
            start += one.count
        self._width = -(-start // _BLOCK)
        self._points = points_of(scenario) if any(name in vary for name in PLACED) else None

    @property
    def base(self) -> dict[str, Any]:
        """What all runs change in the scenario, for `Scenario.updated`: the form of a target that stands elsewhere."""
        if self._points is None:
            return {}
        return {"target.initial_features": None, "target.depth": None, "target.points": self._points.tolist()}

    def numbers(self, first: int, last: int) -> dict[str, NDArray[Any]]:
        """Return what is drawn for the runs `first` to `last` - 1, by the keys of `vary`.

        Each is (n, ...) in the key's own shape and unit; seeds are uint64.
        """
        bits = self._bits(first, last)
        return {one.name: _values(one, bits[:, one.start : one.start + one.count]) for one in self._keys}

    def changes(self, run: int) -> dict[str, Any]:
        """Return what a run changes in the scenario, by dotted key, for `Scenario.updated`."""
        drawn = self.variations(self.numbers(run, run + 1))
        return self.base | changes_of_run(drawn, self._law)

    def _bits(self, first: int, last: int) -> NDArray[np.uint64]:
        """Return the random bits of runs, (n, m)."""
        count = last - first
        generator = np.random.Philox(key=self._key, counter=first * self._width)
        return generator.random_raw(count * self._width * _BLOCK).reshape(count, -1)

    @property
    def dimension(self) -> int:
        """Number of numbers that vary, without seeds."""
        return sum(one.count for one in self._keys if one.variation.kind != SEED)

    def shares(self, run: int) -> Array:
        """Return the place of a run in the box of the variations, (dimension,), 0 to 1 each; its ends for beyond."""
        return np.concatenate([np.empty(0), *(one.share_of(numbers) for one, numbers in self._drawn(run))])

    def outside(self, run: int) -> list[str]:
        """Return the `names` of the numbers of a run that lie outside the box of the variations."""
        beyond = [(numbers < one.box[0]) | (numbers > one.box[1]) for one, numbers in self._drawn(run)]
        return [name for name, is_beyond in zip(self.names, np.concatenate([[], *beyond]), strict=True) if is_beyond]

    def _drawn(self, run: int) -> list[tuple[Variation, Array]]:
        """Return each variation but that of seeds, with the numbers of a run."""
        bits = self._bits(run, run + 1)[0]
        return [
            (one.variation, one.variation.numbers(uniform_of(bits[one.start : one.start + one.count])))
            for one in self._keys
            if one.variation.kind != SEED
        ]

    def numbers_at(self, shares: Array, run: int) -> dict[str, NDArray[Any]]:
        """Return numbers as `numbers` does, for places in the box, (n, dimension), with the seed of a run."""
        seeds = [one for one in self._keys if one.variation.kind == SEED]
        bits = self._bits(run, run + 1)[0, seeds[0].start] if seeds else 0
        return self._laid_out(Variation.in_box, shares, np.full(len(shares), bits, dtype=np.uint64))

    def numbers_of(self, uniform: Array, seeds: NDArray[np.uint64]) -> dict[str, NDArray[Any]]:
        """Return numbers as `numbers` does, from uniform ones above 0 and below 1, (n, dimension), and seeds, (n,)."""
        return self._laid_out(Variation.numbers, uniform, seeds)

    def _laid_out(
        self, number_of: Callable[[Variation, Array], Array], columns: Array, seeds: NDArray[np.uint64]
    ) -> dict[str, NDArray[Any]]:
        start, found = 0, {}
        for one in self._keys:
            if one.variation.kind == SEED:
                found[one.name] = seeds
                continue
            drawn = number_of(one.variation, columns[:, start : start + one.count])
            found[one.name] = np.ascontiguousarray(one.base + drawn[:, one.entries])
            start += one.count
        return found

    @property
    def names(self) -> list[str]:
        """Names of the numbers that vary, (dimension) of them: ``target.rotation[0]``; seeds have none."""
        found = []
        for one in self._keys:
            if one.variation.kind == SEED:
                continue
            if one.count == 1:
                found.append(one.name)
                continue
            firsts = [tuple(np.argwhere(one.entries == number)[0]) for number in range(one.count)]
            found += [one.name + "".join(f"[{index}]" for index in place) for place in firsts]
        return found

    @property
    def has_seed(self) -> bool:
        """Whether every run has a seed of itself."""
        return any(one.variation.kind == SEED for one in self._keys)

    def variations(self, numbers: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return what `simulate_batch` varies: `numbers`, with points (n, p, 3) [m] for displacements of the target."""
        found = {name: values for name, values in numbers.items() if name not in PLACED}
        if self._points is not None:
            found["target.points"] = _displaced(self._points, *(numbers.get(name) for name in PLACED))
        return found


def points_of(scenario: Scenario) -> Array:
    """Return the target's points in B, (p, 3) [m]."""
    from hexservo.findings.analysis.scene import scene_of

    return scene_of(scenario).points


def _displaced(points: Array, translation: Array | None, rotation: Array | None) -> Array:
    """Displace points as a rigid body, entry by entry: the others of a batch change no bit of a run."""
    centre = points.mean(axis=0)
    moved = points[None] - centre
    if rotation is not None:
        from scipy.spatial.transform import Rotation  # takes a quarter of a second, where it is needed alone

        matrix = Rotation.from_rotvec(rotation).as_matrix()[:, None]
        moved = matrix[..., 0] * moved[..., :1] + matrix[..., 1] * moved[..., 1:2] + matrix[..., 2] * moved[..., 2:]
    return np.ascontiguousarray(moved + centre + (0.0 if translation is None else translation[:, None]))


def _values(one: _Key, bits: NDArray[np.uint64]) -> NDArray[Any]:
    if one.variation.kind == SEED:
        return np.ascontiguousarray(bits[:, 0])
    drawn = one.variation.numbers(uniform_of(bits))
    return np.ascontiguousarray(one.base + drawn[:, one.entries])


def _entries(scenario: Scenario, name: str, variation: Variation) -> NDArray[np.int64]:
    """Return which of its numbers each entry of a key has; 0-dimensional where the key takes one number."""
    shape = _shape(scenario, name, variation)
    if not variation.each:
        return np.zeros(shape, dtype=np.int64)
    places = np.arange(int(np.prod(shape, dtype=int)), dtype=np.int64).reshape(shape)
    if variation.symmetric:
        return np.unique(np.minimum(places, places.T), return_inverse=True)[1].reshape(shape).astype(np.int64)
    return places


def _shape(scenario: Scenario, name: str, variation: Variation) -> tuple[int, ...]:
    """Return the shape in which a key varies: a number where it takes one and nothing asks for entries."""
    if name in PLACED:
        return (3,)
    shapes = numeric_keys(scenario.controller.law, scenario.target.count)[name].shapes
    present = np.shape(value_at(scenario, name))
    if variation.symmetric:
        return max(shapes, key=len)
    if () in shapes and not variation.each and not (variation.add and present):
        return ()
    return present if present in shapes and present else max(shapes, key=len)


def _base(scenario: Scenario, name: str, variation: Variation) -> Array | float:
    if not variation.add:
        return 0.0
    value = np.asarray(value_at(scenario, name), dtype=float)
    shape = _shape(scenario, name, variation)
    if value.shape != shape and value.ndim == 1 and len(shape) == 2:
        return np.diag(value)
    return np.broadcast_to(value, shape)
