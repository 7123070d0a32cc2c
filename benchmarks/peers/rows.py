"""One row of the table: a peer, its answer against hexservo's, and its time against hexservo's."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from kernels import MissingError
from problem import Array
from timing import Comparison

__all__ = ["Difference", "Row", "WrongAnswerError", "attempt", "largest_difference", "require", "version_of"]

Status = Literal["measured", "missing", "wrong answer", "failed"]


@dataclass(frozen=True)
class Difference:
    """How far the peer's answer is from what it should be."""

    largest: float
    allowed: float
    unit: str


class WrongAnswerError(Exception):
    """A peer's answer is too far from hexservo's to compare times."""


@dataclass
class Row:
    """What was compared and what came out."""

    work: str
    unit: str  # of work, for which times are given
    peer: str
    form: str  # how the peer does it
    hexservo: str  # what of hexservo it is compared with
    status: Status = "measured"
    detail: str = ""
    version: str = ""
    differences: list[Difference] = field(default_factory=list)
    comparison: Comparison | None = None


def largest_difference(answer: Array, expected: Array) -> float:
    """Give the largest absolute difference; infinite where shapes differ or a number is not finite."""
    if answer.shape != expected.shape or not np.isfinite(answer).all():
        return float("inf")
    return float(np.abs(answer - expected).max())


def require(row: Row, largest: float, allowed: float, unit: str) -> None:
    """Note a difference in the row.

    Raises
    ------
    WrongAnswerError
        Where it is larger than allowed.
    """
    row.differences.append(Difference(largest, allowed, unit))
    if not largest <= allowed:
        raise WrongAnswerError(f"differs by {largest:.2g} {unit}, allowed are {allowed:.2g}")


def version_of(package: str) -> str:
    """Name and version of an installed Python package."""
    return f"{package} {importlib.metadata.version(package)}"


def attempt(row: Row, fill: Callable[[Row], None], how_to_get: str) -> Row:
    """Fill a row in; whatever goes wrong becomes its status, and the run goes on."""
    try:
        fill(row)
    except ImportError as error:
        row.status, row.detail = "missing", f"{error}; {how_to_get}"
    except MissingError as error:
        row.status, row.detail = "missing", str(error)
    except WrongAnswerError as error:
        row.status, row.detail = "wrong answer", str(error)
    except Exception as error:  # of whatever kind: the other rows are still wanted
        row.status, row.detail = "failed", f"{type(error).__name__}: {error}"
    return row
