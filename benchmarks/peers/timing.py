"""Timing in turns: a peer and hexservo alternate, so that what disturbs one disturbs the other."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["Block", "Comparison", "alternate", "core_count", "python_block"]


@dataclass(frozen=True)
class Block:
    """One timed block: seconds per unit of work, and processor seconds per second (None: not measured)."""

    seconds: float
    cores: float | None = None


@dataclass(frozen=True)
class Comparison:
    """Medians over the rounds; `ratio` is the median of the rounds' own ratios, `spread` their quartiles.

    What belongs to hexservo is None where it has nothing to compare with.
    """

    peer: float  # [s] per unit
    hexservo: float | None  # [s] per unit
    ratio: float | None
    spread: tuple[float, float] | None
    peer_cores: float | None
    hexservo_cores: float | None
    rounds: int


def python_block(function: Callable[[], object], units: int, minimum: float) -> Callable[[], Block]:
    """Give a timed block that calls `function`, which does `units` units of work, for about `minimum` seconds or once.

    The number of calls is settled here, by calls that also warm everything up.
    """
    function()
    start = time.perf_counter()
    function()
    calls = max(1, round(minimum / max(time.perf_counter() - start, 1e-9)))

    def block() -> Block:
        processor, start = time.process_time(), time.perf_counter()
        for _ in range(calls):
            function()
        seconds, processor = time.perf_counter() - start, time.process_time() - processor
        return Block(seconds / (calls * units), processor / seconds)

    return block


def alternate(peer: Callable[[], Block], hexservo: Callable[[], Block] | None, rounds: int) -> Comparison:
    """Time both in turns, the order changing from round to round; the first round only warms up."""
    if hexservo is None:
        alone = [peer() for _ in range(rounds + 1)][1:]
        middle = statistics.median(block.seconds for block in alone)
        return Comparison(middle, None, None, None, _cores(alone), None, rounds)
    peers: list[Block] = []
    own: list[Block] = []
    for turn in range(rounds + 1):
        both = [(peer, peers), (hexservo, own)]
        for block, blocks in both if turn % 2 else both[::-1]:
            blocks.append(block())
    del peers[0], own[0]
    ratios = [p.seconds / h.seconds for p, h in zip(peers, own, strict=True)]
    quartiles = statistics.quantiles(ratios, n=4, method="inclusive") if rounds > 1 else [ratios[0]] * 3
    return Comparison(
        peer=statistics.median(block.seconds for block in peers),
        hexservo=statistics.median(block.seconds for block in own),
        ratio=statistics.median(ratios),
        spread=(quartiles[0], quartiles[2]),
        peer_cores=_cores(peers),
        hexservo_cores=_cores(own),
        rounds=rounds,
    )


def _cores(blocks: list[Block]) -> float | None:
    known = [block.cores for block in blocks if block.cores is not None]
    return statistics.median(known) if known else None


def core_count() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0))
