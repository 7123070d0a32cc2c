"""Numbers, quantities and foreign text in messages, and the errors of arguments."""

from __future__ import annotations

import decimal
import math
import operator
from collections.abc import Callable, Iterable, Sequence


def number(value: float, digits: int = 3) -> str:
    """Write a number with so many digits, and without an exponent below a million: "0.0123", "190", "28800"."""
    rounded = float(f"{value:.{digits}g}") + 0.0  # minus zero is zero
    return f"{rounded:.0f}" if 10.0**digits <= abs(rounded) < 1e6 else f"{rounded:.{digits}g}"


def below(value: float, digits: int = 3) -> str:
    """Write the lower end of an interval, as `number` but rounded down: the interval that is written has all of it."""
    return _rounded(value, digits, decimal.ROUND_FLOOR)


def above(value: float, digits: int = 3) -> str:
    """Write the upper end of an interval, as `number` but rounded up."""
    return _rounded(value, digits, decimal.ROUND_CEILING)


def _rounded(value: float, digits: int, direction: str) -> str:
    return number(float(decimal.Context(digits, direction).create_decimal(repr(float(value)))), digits)


_MOST_DIGITS = 8  # that two numbers are given to differ


def apart(value: float, limit: float, digits: int = 4, *, keeps: bool = False) -> tuple[str, str]:
    """Write a value and what it is compared with, as `number`, with as many digits as they need to differ.

    Numbers that 8 digits do not tell apart are "just above" or "just below" each other; equal ones have one text.
    With `keeps` the limit is rounded away from the value: the number that is written keeps the limit.
    """
    of_limit = (below if value > limit else above) if keeps else number
    for many in range(digits, _MOST_DIGITS + 1):
        texts = number(value, many), of_limit(limit, many)
        if texts[0] != texts[1]:
            return texts
    written = of_limit(limit, digits)
    return written if value == limit else f"just {'above' if value > limit else 'below'} {written}", written


def percent_above(share: float) -> str:
    """Write a positive share in whole percents, rounded up; what is less than one is "less than 1%"."""
    return _percent(share, math.ceil)


def percent_below(share: float) -> str:
    """Write a share in whole percents, as `percent_above` but rounded down."""
    return _percent(share, math.floor)


def percent_used(share: float) -> str:
    """Write the used share of a limit, to the nearest percent but "100%" only of all of it: "more than 99%" below.

    Just above, it is "more than 100%".
    """
    nearest = f"{share:.0%}"
    if nearest != "100%" or share == 1.0:
        return nearest
    return "more than 99%" if share < 1.0 else "more than 100%"


def _percent(share: float, whole: Callable[[float], int]) -> str:
    # 9 decimals: 100 (1 - 0.8) has an error of its last digits, which makes no percent
    return "less than 1%" if 0.0 < share < 0.01 else f"{whole(round(100.0 * share, 9))}%"


_PREFIXES = (("", 1.0), ("m", 1e3), ("u", 1e6), ("n", 1e9))


def counted(count: int, noun: str) -> str:
    """Write a count with its noun: "1 run", "3 runs"."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def first_of(names: Sequence[str], most: int) -> str:
    """Write the first names of a list, with a count of those left out: "a, b and 3 more"."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """Write a number with its SI unit, in thousandths, millionths or billionths where it is less than one.

    "17 mm", "4.87 m", "277 mrad": one to three digits stand before the point. What is less than a billionth has an
    exponent: "2.6e-22 J".
    """
    shown, scale = shown_unit(value, unit, digits)
    return f"{number(value * scale, digits)} {shown}"


def shown_unit(value: float, unit: str, digits: int = 3) -> tuple[str, float]:
    """Return the unit in which `quantity` writes a value, and how many of it make one of the given unit.

    The numbers of a column or an axis have that of the largest.
    """
    size = abs(float(f"{value:.{digits}g}"))
    prefix, scale = next((each for each in _PREFIXES if size * each[1] >= 1.0), _PREFIXES[0])
    return f"{prefix}{unit}", scale


def vector(values: Iterable[float]) -> str:
    """Write numbers in parentheses: "(0, 0, -9.8)"."""
    return f"({', '.join(map(number, values))})"


def joules(value: float, digits: int = 4, unit: str = "J") -> str:
    """Write an energy [J], or a power with the unit W."""
    return quantity(value, unit, digits)


def quoted(text: str) -> str:
    """Return a text in quotes on one line, whatever characters it has, and at most about 200 of them."""
    text = text if len(text) <= 200 else f"{text[:100]}...{text[-90:]}"
    return f'"{text}"' if text.isprintable() else ascii(text)


def wrong_type(name: str, expected: str, got: object) -> TypeError:
    """Return the error for an argument of another type: "name: expected ..., got int"."""
    return TypeError(f"{name}: expected {expected}, got {type(got).__name__}")


def several_names(name: str, value: object, expected: str) -> list[str]:
    """Return an argument that is several names; one text by itself is none of them.

    Raises
    ------
    TypeError
        For anything else; `expected` is what the caller accepts.
    """
    if isinstance(value, str | bytes) or not isinstance(value, Iterable):
        raise wrong_type(name, expected, value)
    names = list(value)
    for one in names:
        if not isinstance(one, str):
            raise wrong_type(name, expected, one)
    return names


def whole_number(name: str, value: object, at_least: int, at_most: int | None = None, kind: str = "an integer") -> int:
    """Return an argument that is an integer of Python or NumPy, within its limits.

    Parameters
    ----------
    name, value
        Of the argument.
    at_least, at_most
        Its limits; None: no upper one.
    kind
        What the caller accepts, for the message about another type: "an integer or None".

    Raises
    ------
    TypeError
        For anything else, as a float with a whole value, or a boolean.
    ValueError
        For an integer beyond the limits.
    """
    try:
        found = None if isinstance(value, bool) else operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        found = None
    if found is None:
        raise wrong_type(name, kind, value)
    if found < at_least or (at_most is not None and found > at_most):
        limits = f"of at least {at_least}" if at_most is None else f"from {at_least} to {at_most}"
        raise ValueError(f"{name}: expected an integer {limits}, got {found}")
    return found
