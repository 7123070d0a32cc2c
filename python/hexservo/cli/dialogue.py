"""Questions and answers at a terminal, or from standard input."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any

import hexservo as hs
from hexservo.cli.terminal import complain, write

__all__ = ["Check", "Dialogue"]

Check = Callable[[Any], str | None]


class Dialogue:
    """Questions and answers, with one check at each answer.

    Without a terminal the answers are echoed, and the first wrong one raises a `ScenarioError`; the end of the input
    raises an `EOFError`.
    """

    def __init__(self, interactive: bool) -> None:
        self._interactive = interactive

    def say(self, text: str) -> None:
        """Write a line."""
        write(f"{text}\n")

    def ask(self, question: str, default: str, read: Callable[[str], Any], check: Check | None = None) -> Any:
        """Return the answer, once it is one; the end of the input, and without a terminal a wrong answer, raise."""
        while True:
            write(f"{question} [{default}]: ")
            line = sys.stdin.readline() if sys.stdin is not None else ""
            if not line:
                raise EOFError
            answer = line.strip() or default
            if not self._interactive:
                write(f"{answer}\n")
            try:
                value = read(answer)
                problem = None if check is None else check(value)
            except ValueError as error:
                problem = str(error)
            if problem is None:
                return value
            if not self._interactive:
                raise hs.ScenarioError([f'{question}: {problem}, got "{answer}"'])
            complain(f'{problem}, got "{answer}"', head="Again")

    def number(self, question: str, default: float, *, zero: bool = False) -> float:
        """Return a number above 0, or 0 where that is allowed."""

        def check(value: float) -> str | None:
            return None if value > 0 or (zero and value == 0) else f"expected a number {'>= 0' if zero else 'above 0'}"

        return float(self.ask(question, f"{default:g}", one_number, check))

    def numbers(
        self, question: str, default: str, count: int | tuple[int, ...], check: Check | None = None
    ) -> list[float]:
        """Return several numbers, as many as `count` or one of these, given with blanks or commas between."""
        counts = (count,) if isinstance(count, int) else count
        return list(self.ask(question, default, lambda text: _numbers(text, *counts), check))

    def choice(self, question: str, choices: tuple[str, ...]) -> str:
        """Return one of some words; the first is the default."""

        def check(value: str) -> str | None:
            return None if value in choices else f"expected {' or '.join(choices)}"

        return str(self.ask(f"{question} ({', '.join(choices)})", choices[0], str, check))


def one_number(text: str) -> float:
    """Read one number; a comma after it does no harm. Raises ValueError for anything else."""
    return _numbers(text, 1)[0]


def _numbers(text: str, *counts: int) -> list[float]:
    expected = "a number" if counts == (1,) else f"{' or '.join(map(str, counts))} numbers"
    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        raise ValueError(f"expected {expected}") from None
    if len(values) not in counts or not all(map(math.isfinite, values)):
        raise ValueError(f"expected {expected}{'' if counts == (1,) else ' with blanks between'}")
    return values
