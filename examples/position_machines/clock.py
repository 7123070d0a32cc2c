"""The clock of a program: the computer's, or one that goes only while the program waits."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Iterator
from typing import Protocol

__all__ = ["Clock", "RealClock", "SimulatedClock", "interrupts"]


class Clock(Protocol):
    """What a program needs of a clock."""

    def now(self) -> float:
        """Return the time [s]."""

    def wait_until(self, time: float, stop: threading.Event) -> None:
        """Return at that time [s], or when the event is set."""


class RealClock:
    """The computer's monotonic clock."""

    def now(self) -> float:
        """Return the time since some start [s]."""
        return time.monotonic()

    def wait_until(self, time: float, stop: threading.Event) -> None:
        """Return at that time [s], or when the event is set."""
        left = time - self.now()
        if left > 0.0:
            stop.wait(left)


class SimulatedClock:
    """A clock that jumps to the end of every wait: simulated minutes pass in seconds, and always alike."""

    def __init__(self) -> None:
        self._now = 0.0

    def now(self) -> float:
        """Return the simulated time [s]."""
        return self._now

    def wait_until(self, time: float, stop: threading.Event) -> None:
        """Jump there, unless the event is set."""
        if not stop.is_set():
            self._now = max(self._now, time)


@contextlib.contextmanager
def interrupts() -> Iterator[threading.Event]:
    """Set an event at Ctrl-C, SIGTERM or SIGHUP, so that the loop ends where it can stop the machine.

    A second Ctrl-C ends the program at once; the other two may come twice by themselves, as when a terminal closes. A
    SIGHUP that is ignored, as under nohup, stays so. For the main thread.
    """
    event = threading.Event()
    numbers = [signal.SIGINT, signal.SIGTERM]
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    before = {number: signal.getsignal(number) for number in numbers}

    def interrupt(number: int, _: object) -> None:
        event.set()
        if number == signal.SIGINT:
            signal.signal(number, signal.SIG_DFL)

    for number in before:
        signal.signal(number, interrupt)
    try:
        yield event
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
