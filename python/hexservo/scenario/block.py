"""Base of all blocks of a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import InitErrorDetails, PydanticCustomError

from hexservo import _core
from hexservo.scenario.rules import HalfTurn, Number

if TYPE_CHECKING:
    from typing_extensions import Self

POSITIVE = Number(above=0)
NOT_NEGATIVE = Number(at_least=0)
RELATIVE_ERROR = Number(above=-1, below=1)
PROBABILITY = Number(at_least=0, at_most=1)
MASS = Number(above=0, below=_core.MOST_MASS)  # [kg]
LENGTH = Number(above=0, below=_core.MOST_LENGTH)  # [m], of a machine
COORDINATE = Number(above=-_core.MOST_LENGTH, below=_core.MOST_LENGTH)  # [m], likewise
HALF_TURN = HalfTurn()  # [rad], an angle between two directions

PositiveNumber = Annotated[float, POSITIVE]
NumberNotNegative = Annotated[float, NOT_NEGATIVE]


class _Sampled:
    """Marks a key, or all keys of a block, as acting in sampled mode alone: `sampled_keys` collects them."""


SAMPLED = _Sampled()
SAMPLED_MODE = "sampled"


def together(*errors: ValidationError) -> ValidationError:
    """Return errors of one block as one, so that all problems are reported together."""
    details: list[InitErrorDetails] = []
    for problem in [problem for error in errors for problem in error.errors(include_url=False)]:
        kind: Any = problem["type"]
        context = problem.get("ctx", {})
        if kind == "scenario":  # a sentence of `refusal`
            kind = PydanticCustomError(kind, "{text}", context)
        details.append({"type": kind, "loc": problem["loc"], "input": problem["input"], "ctx": context})
    return ValidationError.from_exception_data("scenario", details)


class Block(BaseModel):
    """Immutable and always validated: pydantic's methods that skip validation are disabled."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Copy, without changes: pydantic would not check them.

        Raises
        ------
        TypeError
            For an `update`.
        """
        if update:
            raise TypeError(
                f"update: expected none, got {', '.join(map(str, update))}: a copy is not checked; "
                'use scenario.updated({"block.key": value}), which is'
            )
        return super().model_copy(deep=deep)

    copy = model_copy  # type: ignore[assignment]

    @classmethod
    def model_construct(cls, _fields_set: set[str] | None = None, **values: Any) -> Self:
        """Refuse to make a block of unvalidated values.

        Raises
        ------
        TypeError
            Always.
        """
        raise TypeError(f"{cls.__name__}: expected checked values; use {cls.__name__}(...) or scenario.updated(...)")

    construct = model_construct
