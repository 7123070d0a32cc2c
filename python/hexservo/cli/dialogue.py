"""Questions and answers at a terminal, or from standard input."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any

import hexservo as hs
from hexservo.cli.terminal import complain, write

Check = Callable[[Any], str | None]
_FARTHEST = 1e5  # magnitude of one of several numbers, where no other bound is given


class Dialogue:
    """Questions and answers, with one check at each answer.

    Without a terminal the answers are echoed, and the first wrong one raises a `ScenarioError`; the end of the input
    raises an `EOFError`. A question that is asked again later offers what was answered to it.
    """

    def __init__(self, interactive: bool) -> None:
        self.interactive = interactive
        self._given: dict[str, str] = {}  # accepted answers by question, without those that were a default

    def say(self, text: str) -> None:
        """Write a line."""
        write(f"{text}\n")

    def ask(self, question: str, default: str, read: Callable[[str], Any], check: Check | None = None) -> Any:
        """Return the answer, once it is one; the end of the input, and without a terminal a wrong answer, raise."""
        while True:
            offered = self._given.get(question, default)
            write(f"{question} [{offered}]: ")
            line = sys.stdin.readline() if sys.stdin is not None else ""
            if not line:
                raise EOFError
            answer = line.strip() or offered
            if not self.interactive:
                write(f"{answer}\n")
            try:
                value = read(answer)
                problem = None if check is None else check(value)
            except ValueError as error:
                problem = str(error)
            if problem is None:
                if line.strip():
                    self._given[question] = answer
                return value
            if not self.interactive:
                raise hs.ScenarioError([f'{question}: {problem}, got "{answer}"'])
            complain(f'{problem}, got "{answer}"', head="Again")
            if not line.strip():  # what was answered before does not fit other answers any more
                self._given.pop(question, None)

    def number(
        self, question: str, default: float, least: float, most: float = _FARTHEST, *, zero: bool = False
    ) -> float:
        """Return a number from `least` to `most`, or 0 where that is allowed."""

        def check(value: float) -> str | None:
            if least <= value <= most or (zero and value == 0):
                return None
            return f"expected {'0, or ' if zero else ''}a number from {least:.9g} to {most:.9g}"

        return float(self.ask(question, f"{default:g}", one_number, check))

    def numbers(
        self,
        question: str,
        default: str,
        count: int | tuple[int, ...],
        check: Check | None = None,
        *,
        within: float = _FARTHEST,
    ) -> list[float]:
        """Return several numbers, as many as `count` or one of these, given with blanks or commas between.

        None is larger in magnitude than `within`.
        """
        counts = (count,) if isinstance(count, int) else count

        def check_all(values: list[float]) -> str | None:
            if max(map(abs, values)) > within:
                return f"expected numbers within +-{within:.9g}"
            return None if check is None else check(values)

        return list(self.ask(question, default, lambda text: _numbers(text, *counts), check_all))

    def choice(self, question: str, choices: tuple[str, ...], others: str = "") -> str:
        """Return one of some words; the first is the default. `others` states what to do where none of them holds."""

        def check(value: str) -> str | None:
            if value in choices:
                return None
            return f"expected {' or '.join(choices)}{f' ({others})' if others else ''}"

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
