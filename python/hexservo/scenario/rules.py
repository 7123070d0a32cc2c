"""Rules for the values of keys, and their messages."""

from __future__ import annotations

import difflib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, NoReturn, TypeAlias, cast, get_args

import numpy as np
from pydantic import GetCoreSchemaHandler, ValidationError
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from hexservo import _core
from hexservo.scenario.recording import MAX_SAMPLES
from hexservo.scenario.yaml import decimal

__all__ = ["Matrix", "Vector"]

Vector: TypeAlias = tuple[float, ...]
Matrix: TypeAlias = tuple[Vector, ...]
Problem: TypeAlias = tuple[tuple[str | int, ...], str]  # place of a value, below the current one, and a sentence
LEAST_POINTS, MOST_POINTS = _core.LEAST_POINTS, _core.MOST_POINTS  # of a target
_POINTS = f"{LEAST_POINTS} to {MOST_POINTS}"
TERMS = dict(zip(("NB", "NM", "NS", "ZE", "PS", "PM", "PB"), _core.TERM_CENTRES, strict=True))


def refusal(*problems: Problem) -> ValidationError:
    """Return the error with each sentence at a location below the current one."""
    return ValidationError.from_exception_data(
        "scenario",
        [
            InitErrorDetails(type=PydanticCustomError("scenario", "{text}", {"text": text}), loc=place, input=None)
            for place, text in problems
        ],
    )


class Rule(ABC):
    """Accepts a plain value or raises `refusal`; strict: text is no number, a boolean is none either."""

    @property
    @abstractmethod
    def expected(self) -> str:
        """What is accepted, as it follows the word "expected"."""

    @abstractmethod
    def accept(self, value: Any) -> Any:
        """Return the value in its one canonical form, or raise `refusal`."""

    def refuse(self, value: Any, place: tuple[int, ...] = (), hint: str = "") -> NoReturn:
        raise refusal((place, f"expected {self.expected}, got {shown_value(value)}{hint}"))

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.accept)


@dataclass(frozen=True)
class Number(Rule):
    above: float | None = None
    at_least: float | None = None
    below: float | None = None
    at_most: float | None = None

    @property
    def bounds(self) -> str:
        limits = ((">", self.above), (">=", self.at_least), ("<", self.below), ("<=", self.at_most))
        return " and ".join(f"{sign} {bound:g}" for sign, bound in limits if bound is not None)

    def several(self, count: str) -> str:
        return f"{count} numbers {self.bounds}" if self.bounds else f"{count} finite numbers"

    @property
    def expected(self) -> str:
        return f"a number {self.bounds}" if self.bounds else "a finite number"

    def accept(self, value: Any) -> float:
        if isinstance(value, str) and _is_number_text(value):
            self.refuse(value, hint=" (text: a number stands without quotes)")
        if not is_number(value):
            self.refuse(value)
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise refusal(((), f"expected a finite number, got {shown_value(value)}"))
        if (
            (self.above is not None and not number > self.above)
            or (self.at_least is not None and not number >= self.at_least)
            or (self.below is not None and not number < self.below)
            or (self.at_most is not None and not number <= self.at_most)
        ):
            self.refuse(value)
        return number


@dataclass(frozen=True)
class Angle(Number):
    """An angle in radians, at most 2 pi in magnitude: larger values are probably degrees."""

    at_least: float | None = -_core.FULL_TURN
    at_most: float | None = _core.FULL_TURN

    @property
    def bounds(self) -> str:
        return "within +-2 pi (radians)"

    def refuse(self, value: Any, place: tuple[int, ...] = (), hint: str = "") -> NoReturn:
        super().refuse(value, place, hint or (" (degrees? multiply by pi/180)" if is_number(value) else ""))


@dataclass(frozen=True)
class HalfTurn(Angle):
    """An angle between two directions, above 0 and at most pi."""

    above: float | None = 0.0
    at_least: float | None = None
    at_most: float | None = math.pi

    @property
    def bounds(self) -> str:
        return "> 0 and <= pi (radians)"

    def refuse(self, value: Any, place: tuple[int, ...] = (), hint: str = "") -> NoReturn:
        if is_number(value) and value <= 0:  # in no unit
            Number.refuse(self, value, place, hint)
        super().refuse(value, place, hint)


@dataclass(frozen=True)
class ArrayRule(Rule):
    """Numbers of a fixed shape; as alternatives one number that stands for all of them, or null.

    Where one number is allowed, an array of equal numbers becomes that number: one meaning, one form.
    """

    shape: tuple[int, ...]
    element: Number = Number()
    or_number: bool = False
    or_null: bool = False

    @property
    def expected(self) -> str:
        count = "x".join(map(str, self.shape))
        return f"{self.element.expected} or {count} of them" if self.or_number else self.element.several(count)

    def accept(self, value: Any) -> float | Vector | Matrix | None:
        if value is None and self.or_null:
            return None
        if not isinstance(value, list):
            if not self.or_number:
                self.refuse(value)
            if is_number(value):
                return self.element.accept(value)
            self.refuse(value)
        numbers = _tuples(value, self.shape, self.element.accept, self)
        return cast("float | Vector | Matrix", collapsed(numbers) if self.or_number else numbers)


@dataclass(frozen=True)
class PointsRule(ArrayRule):
    """Numbers of each point of a target, a row of three or some in one list; for 3 to 16 points."""

    each: int = 1  # numbers of a point
    rows: bool = False  # those of a point stand in a list of themselves

    @property
    def expected(self) -> str:
        number = self.element.expected
        if self.rows:
            return f"{_POINTS} points of {self.each} finite numbers"
        several = f"{self.element.several(str(self.each))} for each of {_POINTS} points"
        if not self.or_number:
            return several
        return f"{number}, or {several if self.each > 1 else f'one for each of {_POINTS} points'}"

    def shape_for(self, points: int) -> tuple[int, ...]:
        """Return the shape of the numbers of so many points."""
        return (points, self.each) if self.rows else (self.each * points,)

    def accept(self, value: Any) -> float | Vector | Matrix | None:
        if not isinstance(value, list):
            return super().accept(value)
        if not self.rows and any(value) and all(isinstance(item, list) for item in value):
            one = f"{self.element.expected}, or " if self.or_number else ""
            order = "x1, y1, x2, y2, ... of" if self.each == 2 else "of a number for each of"
            each = len(value[0]) if len({len(item) for item in value}) == 1 else "several lengths"
            got = f"{len(value)} list{'s' if len(value) > 1 else ''} of {each}"
            text = f"expected {one}a flat list {order} {_POINTS} points, got {got}; write their numbers in one list"
            raise refusal(((), text))
        points, rest = divmod(len(value), 1 if self.rows else self.each)
        if rest or not LEAST_POINTS <= points <= MOST_POINTS:
            raise refusal(((), f"expected {self.expected}, got a list of {len(value)}"))
        numbers = _tuples(value, self.shape_for(points), self.element.accept, self)
        return cast("float | Vector | Matrix", collapsed(numbers) if self.or_number else numbers)


@dataclass(frozen=True)
class GravityRule(ArrayRule):
    """The acceleration of gravity in B; a number is its magnitude, along +z, which points down."""

    shape: tuple[int, ...] = (3,)
    expected = "3 finite numbers (in B), or a number >= 0 (along +z)"

    def accept(self, value: Any) -> Vector:
        if is_number(value):
            return (0.0, 0.0, Number(at_least=0).accept(value))
        return cast("Vector", super().accept(value))


class Inertia(Rule):
    """A symmetric 3x3 matrix; its diagonal where the rest is zero."""

    element = Number(above=-_core.MOST_INERTIA, below=_core.MOST_INERTIA)
    expected = "3 numbers (the diagonal) or 3x3 finite numbers (symmetric)"

    def accept(self, value: Any) -> Vector | Matrix:
        if not isinstance(value, list):
            self.refuse(value)
        if not any(isinstance(row, list) for row in value):
            return cast("Vector", _tuples(value, (3,), self.element.accept, self))
        rows = cast("Matrix", _tuples(value, (3, 3), self.element.accept, self))
        tolerance = 1e-9 * max(abs(number) for row in rows for number in row)
        uneven = [
            ((i, j), f"expected a symmetric matrix, got {rows[i][j]!r} here and {rows[j][i]!r} at [{j}][{i}]")
            for i, j in ((0, 1), (0, 2), (1, 2))
            if abs(rows[i][j] - rows[j][i]) > tolerance
        ]
        if uneven:
            raise refusal(*uneven)
        return diagonal_if_diagonal(tuple(tuple(rows[i][j] / 2 + rows[j][i] / 2 for j in range(3)) for i in range(3)))


class TableRule(Rule):
    """A rule table: rows by the first input, columns by the second, from NB to PB; entries are output terms."""

    expected = f'"linear" or 7x7 numbers or terms ({" ".join(TERMS)})'

    def accept(self, value: Any) -> str | Matrix:
        if value == "linear":
            return "linear"
        if not isinstance(value, list):
            self.refuse(value)
        rows = cast("Matrix", _tuples(value, (7, 7), self._entry, self))
        return "linear" if rows == _core.LINEAR_RULE_TABLE else rows

    def _entry(self, value: Any) -> float:
        if isinstance(value, str):
            if value not in TERMS:
                raise refusal(((), f"expected a number or one of {' '.join(TERMS)}, got {shown_value(value)}"))
            return TERMS[value]
        return Number().accept(value)


@dataclass(frozen=True)
class Integer(Rule):
    at_least: int
    at_most: int

    @property
    def expected(self) -> str:
        return f"an integer from {self.at_least} to {self.at_most}"

    def accept(self, value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not self.at_least <= value <= self.at_most:
            self.refuse(value)
        return value


@dataclass(frozen=True)
class OptionalNumber(Number):
    """A number, or null."""

    @property
    def expected(self) -> str:
        return f"{super().expected} or null"

    def accept(self, value: Any) -> float | None:  # type: ignore[override]
        return None if value is None else super().accept(value)


class SamplePeriod(Rule):
    """A number or null; it belongs to a recording, which the scenarios of a batch share."""

    expected = OptionalNumber(above=0).expected

    def accept(self, value: Any) -> float | None:
        return OptionalNumber(above=0).accept(value)


@dataclass(frozen=True)
class Samples(Rule):
    """Rows of so many numbers, or null: what was recorded, and no single number that may vary in a batch."""

    columns: int = 3

    @property
    def expected(self) -> str:
        return f"2 to {MAX_SAMPLES} rows of {self.columns} finite numbers, or null"

    def accept(self, value: Any) -> Matrix | None:
        if value is None:
            return None
        if not isinstance(value, list) or not 2 <= len(value) <= MAX_SAMPLES:
            self.refuse(value)
        return cast("Matrix", _tuples(value, (len(value), self.columns), Number().accept, self))


class File(Rule):
    """The path of a file, or null."""

    expected = "the path of a file, or null"

    def accept(self, value: Any) -> str | None:
        if value is not None and not (isinstance(value, str) and value):
            self.refuse(value)
        return value


class Flag(Rule):
    expected = "true or false"

    def accept(self, value: Any) -> bool:
        if not isinstance(value, bool):
            self.refuse(value)
        return value


@dataclass(frozen=True)
class Choice(Rule):
    """One of several words: by default those of the annotated Literal."""

    choices: tuple[str, ...] = ()
    or_null: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        told = self if self.choices else replace(self, choices=get_args(source))
        return core_schema.no_info_plain_validator_function(told.accept)

    @property
    def expected(self) -> str:
        names = [f'"{choice}"' for choice in self.choices] + ["null"] * self.or_null
        return names[0] if len(names) == 1 else f"one of {', '.join(names)}"

    def accept(self, value: Any) -> str | None:
        if value is None and self.or_null:
            return None
        if not isinstance(value, str) or value not in self.choices:
            self.refuse(value, hint=did_you_mean(value, self.choices))
        return value


@dataclass(frozen=True)
class TrueOr(Rule):
    """The plain ``true`` of YAML, for the true value of something, or the name of a stand-in for it."""

    name: str

    @property
    def expected(self) -> str:
        return f'true or "{self.name}"'

    def accept(self, value: Any) -> bool | str:
        if value is True or value == "true":
            return True
        if value != self.name or not isinstance(value, str):
            self.refuse(value, hint=did_you_mean(value, (self.name,)))
        return value


class Name(Rule):
    """Text that is safe as the name of a file on every system."""

    expected = 'a name of 1 to 60 letters, digits, "-", "_" and "." that starts with a letter or digit'

    def accept(self, value: Any) -> str:
        if not isinstance(value, str) or not 1 <= len(value) <= 60:
            self.refuse(value)
        if not (value[0].isalnum() and value[-1] != "." and all(c.isalnum() or c in "-_." for c in value)):
            self.refuse(value)
        return value


class LineRule(Rule):
    expected = "one line of at most 200 printable characters"

    def accept(self, value: Any) -> str:
        if not isinstance(value, str) or len(value) > 200 or not value.isprintable():
            self.refuse(value)
        return value


def is_number(value: Any) -> bool:
    # The first decides for most values, in a third of the time.
    return type(value) is float or (isinstance(value, int | float) and not isinstance(value, bool))


def _is_number_text(value: str) -> bool:
    return decimal(value.strip()) is not None


def _tuples(value: list[Any], shape: tuple[int, ...], accept: Callable[[Any], float], rule: Rule) -> Any:
    """Turn an array of a rule into nested tuples, or refuse everything that is wrong in it, each at its index."""
    problems: list[Problem] = []

    def level(value: Any, place: tuple[int, ...]) -> Any:
        if len(place) == len(shape):
            try:
                return accept(value)
            except ValidationError as error:
                problems.extend((place, problem["msg"]) for problem in error.errors(include_url=False))
                return math.nan
        count = shape[len(place)]
        if not isinstance(value, list) or len(value) != count:
            wanted = f"a row of {count}" if place else rule.expected
            got = f"a list of {len(value)}" if isinstance(value, list) else shown_value(value)
            problems.append((place, f"expected {wanted}, got {got}"))
            return ()
        return tuple(level(item, (*place, index)) for index, item in enumerate(value))

    if len(shape) > 1 and not any(isinstance(item, list) for item in value):
        raise refusal(((), f"expected {rule.expected}, got {shown_value(value)}"))
    result = level(value, ())
    if problems:
        raise refusal(*problems)
    return result


def tupled(array: Any) -> Any:
    """Turn an array of the core into nested tuples of floats; None stays."""
    values = None if array is None else np.asarray(array, dtype=float).tolist()
    return map_lists(values, tuple)


def map_lists(value: Any, make: Callable[[Iterable[Any]], Any]) -> Any:
    return make(map_lists(item, make) for item in value) if isinstance(value, list | tuple) else value


def collapsed(array: Any) -> Any:
    """Return one number where all numbers of an array are equal, else the array as nested tuples."""
    tuples = tupled(array)
    numbers = set(np.ravel(tuples).tolist())
    return numbers.pop() if len(numbers) == 1 else tuples


def diagonal_if_diagonal(matrix: Matrix) -> Vector | Matrix:
    off_diagonal = any(number for i, row in enumerate(matrix) for j, number in enumerate(row) if i != j)
    return matrix if off_diagonal else tuple(row[i] for i, row in enumerate(matrix))


def shown_value(value: Any) -> str:
    """Show a value as YAML has it, shortened to about 60 characters."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int) and abs(value) > 10**40:
        return f"an integer of {value.bit_length()} bits"
    if isinstance(value, str):
        return f'"{value}"' if len(value) <= 58 else f'"{value[:55]}..."'
    if isinstance(value, dict):
        keys = [key or '""' for key in list(value)[:8]]
        return _shortened(f"a block with the keys {', '.join(keys)}" if keys else "an empty block")
    if isinstance(value, list):
        return _shortened(
            f"[{', '.join(shown_value(item) for item in value[:12])}{', ...' if len(value) > 12 else ''}]"
        )
    return repr(value) if isinstance(value, int | float) else f"a Python {type(value).__name__}"


def _shortened(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."


def term_text(value: float) -> str:
    """Return the term of the fuzzy output that has this centre, such as "PS"; the number where none has."""
    return next((term for term, centre in TERMS.items() if abs(value - centre) < 1e-9), f"{value:.2g}")


def did_you_mean(value: Any, names: Iterable[str]) -> str:
    nearest = difflib.get_close_matches(value.lower(), list(names), 1) if isinstance(value, str) else []
    return f'; did you mean "{nearest[0]}"?' if nearest else ""
