"""Scenarios: what a run simulates, as immutable and completely validated data.

A `Scenario` is read from YAML (`load_scenario`) or built from a mapping. Everything wrong with it is reported at once,
in a `ScenarioError` with one line per problem. SI units and radians throughout; image quantities in pixels. Frames, the
symbols and the reasons for the defaults: docs/model.md. The defaults of the maths have one source, the C++ structs.
"""

from __future__ import annotations

import difflib
import math
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn, TypeAlias, cast, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, ValidationError, model_validator
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from hexservo import _core
from hexservo.scenario.recording import MAX_SAMPLES, read_recording
from hexservo.scenario.yaml import MAX_DEPTH, ScenarioError, dump_yaml, load_yaml, read_yaml

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = [
    "LAWS",
    "Actuators",
    "BaseMotion",
    "Camera",
    "Composite",
    "ComputedTorque",
    "Controller",
    "Fuzzy",
    "Hybrid",
    "Kelly",
    "Matrix",
    "Metrics",
    "NumericKey",
    "Pbvs",
    "ResolvedRate",
    "Robot",
    "Scenario",
    "ScenarioError",
    "Sensors",
    "Simulation",
    "Switching",
    "Target",
    "Uncertainty",
    "Vector",
    "acting_keys",
    "default_of",
    "keys_below",
    "load_scenario",
    "numeric_keys",
    "sampled_keys",
    "scenario_names",
    "value_at",
    "without_effect",
]

Vector: TypeAlias = tuple[float, ...]
Matrix: TypeAlias = tuple[Vector, ...]
SwitchingKind: TypeAlias = Literal["sign", "tanh", "saturation", "implicit", "implicit_coupled"]
Law: TypeAlias = Literal["hybrid", "composite", "kelly", "resolved_rate", "pbvs", "computed_torque"]
JacobianPoint: TypeAlias = Literal["current", "desired", "mean"]
LAWS: tuple[str, ...] = get_args(Law)

MAX_WHOLE_FLOAT = 2**53  # up to here a float holds every whole number
_DEFAULT_PRESET = "micro"
_DEFAULT_DEPTH = float(_core.Target().depth[0])  # [m], docs/model.md section 4
_MOST_PROBLEMS = 20  # said of a scenario; of more only their number
TERMS = dict(zip(("NB", "NM", "NS", "ZE", "PS", "PM", "PB"), _core.TERM_CENTRES, strict=True))


# ---- What a value may be --------------------------------------------------------------------------------------------


def _refusal(*problems: tuple[tuple[str | int, ...], str]) -> ValidationError:
    """Make the error that places each sentence at a location below the current one."""
    return ValidationError.from_exception_data(
        "scenario",
        [
            InitErrorDetails(type=PydanticCustomError("scenario", "{text}", {"text": text}), loc=place, input=None)
            for place, text in problems
        ],
    )


class _Rule(ABC):
    """Accepts a plain value or raises `_refusal`; strict: text is no number, a boolean is none either."""

    @property
    @abstractmethod
    def expected(self) -> str:
        """What is accepted, as it follows the word "expected"."""

    @abstractmethod
    def accept(self, value: Any) -> Any:
        """Return the value in its one canonical form, or raise `_refusal`."""

    def refuse(self, value: Any, place: tuple[int, ...] = (), hint: str = "") -> NoReturn:
        raise _refusal((place, f"expected {self.expected}, got {_shown(value)}{hint}"))

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.accept)


@dataclass(frozen=True)
class _Number(_Rule):
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
        if not _is_number(value):
            self.refuse(value)
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise _refusal(((), f"expected a finite number, got {_shown(value)}"))
        if (
            (self.above is not None and not number > self.above)
            or (self.at_least is not None and not number >= self.at_least)
            or (self.below is not None and not number < self.below)
            or (self.at_most is not None and not number <= self.at_most)
        ):
            self.refuse(value)
        return number


@dataclass(frozen=True)
class _Angle(_Number):
    """An angle in radians, at most one turn either way: more is somebody's degrees."""

    at_least: float | None = -2 * math.pi
    at_most: float | None = 2 * math.pi

    @property
    def bounds(self) -> str:
        return "within +-2 pi (radians)"

    def refuse(self, value: Any, place: tuple[int, ...] = (), hint: str = "") -> NoReturn:
        super().refuse(value, place, hint or (" (degrees? multiply by pi/180)" if _is_number(value) else ""))


@dataclass(frozen=True)
class _Array(_Rule):
    """Numbers of a fixed shape; as alternatives one number that stands for all of them, or null.

    Where one number is allowed, an array of equal numbers becomes that number: one meaning, one form.
    """

    shape: tuple[int, ...]
    element: _Number = _Number()
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
            if _is_number(value):
                return self.element.accept(value)
            self.refuse(value)
        numbers = _tuples(value, self.shape, self.element.accept, self.expected)
        return cast("float | Vector | Matrix", _collapsed(numbers) if self.or_number else numbers)


@dataclass(frozen=True)
class _Inertia(_Rule):
    """A symmetric 3x3 matrix; its diagonal where the rest is zero."""

    @property
    def expected(self) -> str:
        return "3 numbers (the diagonal) or 3x3 finite numbers (symmetric)"

    def accept(self, value: Any) -> Vector | Matrix:
        if not isinstance(value, list):
            self.refuse(value)
        if not any(isinstance(row, list) for row in value):
            return cast("Vector", _tuples(value, (3,), _Number().accept, self.expected))
        rows = cast("Matrix", _tuples(value, (3, 3), _Number().accept, self.expected))
        tolerance = 1e-9 * max(abs(number) for row in rows for number in row)
        uneven = [
            ((i, j), f"expected a symmetric matrix, got {rows[i][j]!r} here and {rows[j][i]!r} at [{j}][{i}]")
            for i, j in ((0, 1), (0, 2), (1, 2))
            if abs(rows[i][j] - rows[j][i]) > tolerance
        ]
        if uneven:
            raise _refusal(*uneven)
        return _diagonal_if_diagonal(tuple(tuple(rows[i][j] / 2 + rows[j][i] / 2 for j in range(3)) for i in range(3)))


@dataclass(frozen=True)
class _Table(_Rule):
    """A rule table: rows by the first input, columns by the second, from NB to PB; entries are output terms."""

    @property
    def expected(self) -> str:
        return f'"linear" or 7x7 numbers or terms ({" ".join(TERMS)})'

    def accept(self, value: Any) -> str | Matrix:
        if value == "linear":
            return "linear"
        if not isinstance(value, list):
            self.refuse(value)
        rows = cast("Matrix", _tuples(value, (7, 7), self._entry, self.expected))
        return "linear" if rows == _tupled(_core.FuzzyGains().table) else rows

    def _entry(self, value: Any) -> float:
        if isinstance(value, str):
            if value not in TERMS:
                raise _refusal(((), f"expected a number or one of {' '.join(TERMS)}, got {_shown(value)}"))
            return TERMS[value]
        return _Number().accept(value)


@dataclass(frozen=True)
class _Integer(_Rule):
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
class _OptionalNumber(_Number):
    """A number, or null."""

    @property
    def expected(self) -> str:
        return f"{super().expected} or null"

    def accept(self, value: Any) -> float | None:  # type: ignore[override]
        return None if value is None else super().accept(value)


@dataclass(frozen=True)
class _SamplePeriod(_Rule):
    """A number or null; it belongs to a recording, which the scenarios of a batch share."""

    @property
    def expected(self) -> str:
        return _OptionalNumber(above=0).expected

    def accept(self, value: Any) -> float | None:
        return _OptionalNumber(above=0).accept(value)


@dataclass(frozen=True)
class _Samples(_Rule):
    """Rows of three numbers, or null: what was recorded, and no single number that may vary in a batch."""

    @property
    def expected(self) -> str:
        return f"2 to {MAX_SAMPLES} rows of 3 finite numbers, or null"

    def accept(self, value: Any) -> Matrix | None:
        if value is None:
            return None
        if not isinstance(value, list) or not 2 <= len(value) <= MAX_SAMPLES:
            self.refuse(value)
        return cast("Matrix", _tuples(value, (len(value), 3), _Number().accept, self.expected))


@dataclass(frozen=True)
class _File(_Rule):
    """The path of a file, or null."""

    @property
    def expected(self) -> str:
        return "the path of a file, or null"

    def accept(self, value: Any) -> str | None:
        if value is not None and not (isinstance(value, str) and value):
            self.refuse(value)
        return value


@dataclass(frozen=True)
class _Flag(_Rule):
    @property
    def expected(self) -> str:
        return "true or false"

    def accept(self, value: Any) -> bool:
        if not isinstance(value, bool):
            self.refuse(value)
        return value


@dataclass(frozen=True)
class _Choice(_Rule):
    """One of some words: those of the Literal it annotates, if it is not told others."""

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
            self.refuse(value, hint=_did_you_mean(value, self.choices))
        return value


@dataclass(frozen=True)
class _TrueOr(_Rule):
    """The plain ``true`` of YAML, for the true value of something, or the name of a stand-in for it."""

    name: str

    @property
    def expected(self) -> str:
        return f'true or "{self.name}"'

    def accept(self, value: Any) -> bool | str:
        if value is True or value == "true":
            return True
        if value != self.name or not isinstance(value, str):
            self.refuse(value, hint=_did_you_mean(value, (self.name,)))
        return value


@dataclass(frozen=True)
class _Name(_Rule):
    """Text that is safe as the name of a file on every system."""

    @property
    def expected(self) -> str:
        return 'a name of 1 to 60 letters, digits, "-", "_" and "." that starts with a letter or digit'

    def accept(self, value: Any) -> str:
        if not isinstance(value, str) or not 1 <= len(value) <= 60:
            self.refuse(value)
        if not (value[0].isalnum() and value[-1] != "." and all(c.isalnum() or c in "-_." for c in value)):
            self.refuse(value)
        return value


@dataclass(frozen=True)
class _Line(_Rule):
    @property
    def expected(self) -> str:
        return "one line of at most 200 printable characters"

    def accept(self, value: Any) -> str:
        if not isinstance(value, str) or len(value) > 200 or not value.isprintable():
            self.refuse(value)
        return value


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_number_text(value: str) -> bool:
    try:
        float(value)
    except ValueError:
        return False
    return True


def _tuples(value: list[Any], shape: tuple[int, ...], accept: Callable[[Any], float], expected: str) -> Any:
    """Turn an array into nested tuples, or refuse everything that is wrong in it, each at its index."""
    problems: list[tuple[tuple[str | int, ...], str]] = []

    def level(value: Any, place: tuple[int, ...]) -> Any:
        if len(place) == len(shape):
            try:
                return accept(value)
            except ValidationError as error:
                problems.extend((place, problem["msg"]) for problem in error.errors(include_url=False))
                return math.nan
        count = shape[len(place)]
        if not isinstance(value, list) or len(value) != count:
            wanted = f"a row of {count}" if place else expected
            got = f"a list of {len(value)}" if isinstance(value, list) else _shown(value)
            problems.append((place, f"expected {wanted}, got {got}"))
            return ()
        return tuple(level(item, (*place, index)) for index, item in enumerate(value))

    if len(shape) > 1 and not any(isinstance(item, list) for item in value):
        raise _refusal(((), f"expected {expected}, got {_shown(value)}"))
    result = level(value, ())
    if problems:
        raise _refusal(*problems)
    return result


def _tupled(array: Any) -> Any:
    """Turn an array of the core into nested tuples of floats."""
    values = np.asarray(array, dtype=float).tolist()
    return _map_lists(values, tuple)


def _map_lists(value: Any, make: Callable[[Iterable[Any]], Any]) -> Any:
    return make(_map_lists(item, make) for item in value) if isinstance(value, list | tuple) else value


def _collapsed(array: Any) -> Any:
    """Return one number where all numbers of an array are equal, else the array as nested tuples."""
    tuples = _tupled(array)
    numbers = set(np.ravel(tuples).tolist())
    return numbers.pop() if len(numbers) == 1 else tuples


def _diagonal_if_diagonal(matrix: Matrix) -> Vector | Matrix:
    off_diagonal = any(number for i, row in enumerate(matrix) for j, number in enumerate(row) if i != j)
    return matrix if off_diagonal else tuple(row[i] for i, row in enumerate(matrix))


def _shown(value: Any) -> str:
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
        return _shortened(f"a block with the keys {', '.join(list(value)[:8])}" if value else "an empty block")
    if isinstance(value, list):
        return _shortened(f"[{', '.join(_shown(item) for item in value[:12])}{', ...' if len(value) > 12 else ''}]")
    return repr(value) if isinstance(value, int | float) else f"a Python {type(value).__name__}"


def _shortened(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."


def _did_you_mean(value: Any, names: Iterable[str]) -> str:
    nearest = difflib.get_close_matches(value.lower(), list(names), 1) if isinstance(value, str) else []
    return f'; did you mean "{nearest[0]}"?' if nearest else ""


# ---- Keys that hold numbers -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class NumericKey:
    """What a key takes that holds numbers: the form of a batch's variations of it."""

    shapes: tuple[tuple[int, ...], ...]  # the key's own shape, in each form it may have; () is a number
    element: _Number
    whole: bool = False  # only integers
    symmetric: bool = False  # where it is a matrix

    @property
    def expected(self) -> str:
        """What each number is expected to be."""
        return f"an integer {self.element.bounds}" if self.whole else self.element.expected

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type that holds every number of the key: float64, unless it has larger whole numbers."""
        most = self.element.at_most
        return np.dtype(np.uint64 if self.whole and most is not None and most > MAX_WHOLE_FLOAT else np.float64)

    def within(self, numbers: NDArray[Any]) -> NDArray[np.bool_]:
        """Tell which numbers are allowed; NaN is not, nor, of whole numbers, floats that may have been rounded."""
        allowed = numbers == numbers
        if self.whole and numbers.dtype.kind == "f":
            allowed = (numbers == np.floor(numbers)) & (np.abs(numbers) <= MAX_WHOLE_FLOAT)
        for limit, holds in (
            (self.element.above, np.greater),
            (self.element.at_least, np.greater_equal),
            (self.element.below, np.less),
            (self.element.at_most, np.less_equal),
        ):
            if limit is not None:
                allowed = allowed & holds(numbers, limit)
        return np.asarray(allowed & np.isfinite(numbers))


@cache
def numeric_keys(law: str) -> dict[str, NumericKey]:
    """Return the dotted keys that hold numbers, in the order of a scenario file (not to be changed).

    The gains of other laws than `law` have no effect and are not among them.
    """
    keys = {}
    others = tuple(f"controller.{name}." for name in LAWS if name != law)
    for path, rule in _rules(Scenario):
        if path.startswith(others):
            continue
        if isinstance(rule, _Number):
            keys[path] = NumericKey(((),), rule)
        elif isinstance(rule, _Integer):
            keys[path] = NumericKey(((),), _Number(at_least=rule.at_least, at_most=rule.at_most), whole=True)
        elif isinstance(rule, _Array):
            keys[path] = NumericKey(((), rule.shape) if rule.or_number else (rule.shape,), rule.element)
        elif isinstance(rule, _Inertia):
            keys[path] = NumericKey(((3,), (3, 3)), _Number(), symmetric=True)
        elif isinstance(rule, _Table):
            keys[path] = NumericKey(((7, 7),), _Number())
    return keys


def _rules(block: type[BaseModel]) -> Iterator[tuple[str, _Rule]]:
    for path, field, _ in _leaves(block):
        yield from ((path, rule) for rule in field.metadata if isinstance(rule, _Rule))


# ---- The blocks of a scenario ---------------------------------------------------------------------------------------

_POSITIVE = _Number(above=0)
_NOT_NEGATIVE = _Number(at_least=0)
_RELATIVE_ERROR = _Number(above=-1, below=1)
_PROBABILITY = _Number(at_least=0, at_most=1)

_PositiveNumber = Annotated[float, _POSITIVE]
_NumberNotNegative = Annotated[float, _NOT_NEGATIVE]


class _Sampled:
    """Marks a key, or all keys of a block, as acting in sampled mode alone: `sampled_keys` collects them."""


_SAMPLED = _Sampled()
_SAMPLED_MODE = "sampled"


class _Block(BaseModel):
    """Immutable, and made by validation alone: pydantic's ways around it are closed."""

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
        """Refuse to make a block of values that nobody checked.

        Raises
        ------
        TypeError
            Always.
        """
        raise TypeError(f"{cls.__name__}: expected checked values; use {cls.__name__}(...) or scenario.updated(...)")

    construct = model_construct


class Robot(_Block):
    """The hexapod: its geometry, mass and limits.

    In a file, a preset fills in every key that is not given or null; without one (null, the default of a robot block)
    every key is required. A scenario without a robot block has the preset "micro". Frames B and E: docs/model.md
    section 1; legs: section 2.
    """

    preset: Annotated[str | None, _Choice(tuple(_core.ROBOT_PRESETS), or_null=True)] = None
    platform_radius: _PositiveNumber  # [m], circle of the platform joints
    base_radius: _PositiveNumber  # [m], circle of the base joints
    platform_angles: Annotated[Vector, _Array((6,), _Angle())]  # (6,) [rad], on that circle, in E
    base_angles: Annotated[Vector, _Array((6,), _Angle())]  # (6,) [rad], on that circle, in B
    home_position: Annotated[Vector, _Array((3,))]  # (3,) [m], of E's origin in B; z points down
    mass: _PositiveNumber  # [kg], of the platform
    inertia: Annotated[Vector | Matrix, _Inertia()]  # (3,) diagonal or (3, 3) [kg m^2], in E about its origin
    stroke: _PositiveNumber  # [m], each leg's travel either way from its home length
    force_limit: _PositiveNumber  # [N], magnitude of each leg's force
    # in sampled mode: what a leg beyond its stroke means, an event or the end of the run
    on_limit: Annotated[Literal["report", "stop"], _Choice(), _SAMPLED] = "report"

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        given = {key: value for key, value in data.items() if value is not None}
        preset = given.get("preset")
        if preset is None:
            return given
        # An unknown preset is reported at its own key; any values do to check the others.
        known = isinstance(preset, str) and preset in _core.ROBOT_PRESETS
        return {**_preset_values(preset if known else _DEFAULT_PRESET), **given}


class Camera(_Block):
    """The camera in the platform; docs/model.md section 4, (4)-(8).

    Times, faults and predictions act in `sampled` mode alone, where every time is a whole number of servo periods
    (``simulation.step``); docs/model.md section 7.
    """

    focal_length: _PositiveNumber = Field(default_factory=lambda: _core.Camera().focal_length)  # [m]
    pixel_scale: _PositiveNumber = Field(default_factory=lambda: _core.Camera().pixel_scale)  # [px/m]
    convention: Annotated[Literal["eye_in_hand", "as_printed"], _Choice()] = "eye_in_hand"
    # [s], between exposures; null: the servo period, which a scenario in sampled mode fills in
    period: Annotated[float | None, _OptionalNumber(above=0), _SAMPLED] = None
    latency: Annotated[_NumberNotNegative, _SAMPLED] = 0.0  # [s], from an exposure to its first use
    latency_jitter: Annotated[_NumberNotNegative, _SAMPLED] = 0.0  # [s], most that the latency of a frame is longer
    # [s], since its exposure: an older image is not used, and the wrench holds the platform; null: any is used
    timeout: Annotated[float | None, _OptionalNumber(above=0), _SAMPLED] = None
    noise: Annotated[_NumberNotNegative, _SAMPLED] = 0.0  # [px], standard deviation of each coordinate
    quantisation: Annotated[_NumberNotNegative, _SAMPLED] = 0.0  # [px], coordinates are multiples of it; 0: of nothing
    dropout: Annotated[float, _PROBABILITY, _SAMPLED] = 0.0  # probability that a frame never arrives
    outlier_probability: Annotated[float, _PROBABILITY, _SAMPLED] = 0.0  # that a point of a frame is an outlier
    # [px], standard deviation of what is added to an outlier's coordinates, beside the noise
    outlier_size: Annotated[_NumberNotNegative, _SAMPLED] = 0.0
    # (2,) [px], width and height; a feature outside is lost; null: no border
    image_size: Annotated[Vector | None, _Array((2,), _POSITIVE, or_null=True), _SAMPLED] = None
    # what a law does with a lost feature: its last image, that image carried along by the joint sensors, or no more
    on_lost: Annotated[Literal["hold", "predict", "stop"], _Choice(), _SAMPLED] = "hold"
    # between two frames: the newest one as it is, or carried along by the joint sensors
    prediction: Annotated[Literal["none", "encoder"], _Choice(), _SAMPLED] = "none"


class Sensors(_Block):
    """How the controller knows the platform's pose and twist, in `sampled` mode; docs/model.md section 7.

    The period is a whole number of servo periods (``simulation.step``).
    """

    # true: exactly; encoders: from the lengths of the legs, which alone have what follows
    pose: Annotated[Literal[True, "encoders"], _TrueOr("encoders")] = True
    # what the twist is made of: differences of readings over their period, or the true rates of the legs
    rate: Annotated[Literal[True, "differences"], _TrueOr("differences")] = "differences"
    resolution: _NumberNotNegative = 0.0  # [m], a length is a multiple of it; 0: of nothing
    noise: _NumberNotNegative = 0.0  # [m], standard deviation of each length
    period: Annotated[float | None, _OptionalNumber(above=0)] = None  # [s], between readings; null: every servo period


class Actuators(_Block):
    """The actuators of the legs, in `sampled` mode; docs/model.md section 7. The defaults only hold the wrench."""

    hold: Annotated[Literal["wrench", "leg_forces"], _Choice()] = "wrench"  # what stays the same between two ticks
    saturation: Annotated[bool, _Flag()] = False  # leg forces are limited to robot.force_limit
    bandwidth: Annotated[float | None, _OptionalNumber(above=0)] = None  # [Hz], of a first-order lag; null: none
    quantisation: _NumberNotNegative = 0.0  # [N], leg forces are multiples of it; 0: of nothing
    delay: _NumberNotNegative = 0.0  # [s], a whole number of servo periods, at most 8


class BaseMotion(_Block):
    """Linear acceleration of the base frame B, in `sampled` mode, of which the controller knows nothing.

    Only what the kind needs acts; docs/model.md section 7. A recording is given as a CSV file with the columns t, ax,
    ay, az [s, m/s^2], which is read at once: a scenario holds the samples, and its own ``file`` is null.
    """

    kind: Annotated[Literal["none", "sinusoid", "recorded", "noise"], _Choice()] = "none"
    amplitude: Annotated[Vector, _Array((3,))] = (0.0, 0.0, 0.0)  # (3,) [m/s^2], of the sinusoid, in B
    frequency: _NumberNotNegative = Field(default_factory=lambda: _core.BaseMotionParameters().frequency)  # [Hz]
    phase: Annotated[float, _Angle()] = 0.0  # [rad], of the sinusoid at t = 0
    # [(m/s^2)^2/Hz], one-sided spectral density of the noise, one for all axes or (3,)
    level: Annotated[float | Vector, _Array((3,), _NOT_NEGATIVE, or_number=True)] = 0.0
    # [Hz], where the noise begins and ends
    low_frequency: _NumberNotNegative = Field(default_factory=lambda: _core.BaseMotionParameters().low_frequency)
    high_frequency: _PositiveNumber = Field(default_factory=lambda: _core.BaseMotionParameters().high_frequency)
    file: Annotated[str | None, _File()] = None  # CSV to read, relative to the scenario's file
    samples: Annotated[Matrix | None, _Samples()] = None  # (n, 3) [m/s^2], recorded, in B
    sample_period: Annotated[float | None, _SamplePeriod()] = None  # [s], of the samples, from t = 0

    @model_validator(mode="before")
    @classmethod
    def _read(cls, data: Any) -> Any:
        if not isinstance(data, dict) or not isinstance(data.get("file"), str):
            return data
        try:
            period, samples = read_recording(data["file"])
        except ScenarioError as error:
            raise _refusal((("file",), str(error))) from None
        return {**data, "file": None, "samples": samples, "sample_period": period}

    @model_validator(mode="after")
    def _is_whole(self) -> BaseMotion:
        if (self.samples is None) != (self.sample_period is None):
            missing, given = ("sample_period", "samples") if self.samples is not None else ("samples", "sample_period")
            raise _refusal(((missing,), f"expected it beside {given}, got null"))
        if self.kind == "recorded" and self.samples is None:
            raise _refusal((("file",), 'expected the path of a CSV file for the kind "recorded", got null'))
        return self


class Target(_Block):
    """The four points that the camera sees, and where in the image they shall be.

    The points are given either by their image from the home pose and their depth, or by their place in B. Features are
    ordered (x1, y1, ..., x4, y4), in pixels.
    """

    initial_features: Annotated[Vector | None, _Array((8,), or_null=True)] = None  # (8,) [px], seen from home
    desired_features: Annotated[Vector, _Array((8,))]  # (8,) [px]
    # [m], distance |Z| along the optical axis from home: one for all points or (4,); 0.5 if not given
    depth: Annotated[float | Vector | None, _Array((4,), _POSITIVE, or_number=True, or_null=True)] = None
    points: Annotated[Matrix | None, _Array((4, 3), or_null=True)] = None  # (4, 3) [m], in B

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("initial_features") is not None and data.get("points") is None:
            return {**data, "depth": _DEFAULT_DEPTH if data.get("depth") is None else data["depth"]}
        return data

    @model_validator(mode="after")
    def _has_one_form(self) -> Target:
        forms = "expected either initial_features (8 numbers, px) with depth (m), or points (4x3 numbers, m, in B)"
        if self.initial_features is None and self.points is None:
            raise _refusal(((), f"{forms}, got neither"))
        if self.initial_features is not None and self.points is not None:
            raise _refusal(((), f"{forms}, got both; leave one out or set it to null"))
        if self.points is not None and self.depth is not None:
            raise _refusal((("depth",), f"expected no depth beside points, got {_shown(_map_lists(self.depth, list))}"))
        return self


class Uncertainty(_Block):
    """The relative errors delta of the controller's model, each above -1 and below 1; docs/model.md sections 3 and 4.

    The plant has (1 - delta) times the controller's inertia, Coriolis and gravity terms (3); the controller takes
    (1 + delta) times the true depth of a point. Arrays act element by element.
    """

    inertia: Annotated[float | Matrix, _Array((6, 6), _RELATIVE_ERROR, or_number=True)] = 0.0
    coriolis: Annotated[float | Matrix, _Array((6, 6), _RELATIVE_ERROR, or_number=True)] = 0.0
    gravity: Annotated[float | Vector, _Array((6,), _RELATIVE_ERROR, or_number=True)] = 0.0
    depth: Annotated[float | Vector, _Array((4,), _RELATIVE_ERROR, or_number=True)] = 0.0  # one for all points or (4,)


class Switching(_Block):
    """The switching term of the law, sgn or a smooth stand-in; docs/model.md section 6."""

    kind: Annotated[SwitchingKind, _Choice()] = Field(
        default_factory=lambda: cast("SwitchingKind", _core.Switching().kind.name)
    )
    # [m/s and rad/s], of tanh and saturation
    width: _PositiveNumber = Field(default_factory=lambda: _core.Switching().width)


class Safe(_Block):
    """The brake in sampled mode, where the law may not act: without an image, with an old one, with unusable numbers.

    docs/model.md section 7. A null gain is derived from the estimated inertia; zeros leave the platform to its weight's
    support alone.
    """

    # K_s, diagonal, [N s/m] x3, [N m s/rad] x3
    damping: Annotated[float | Vector | None, _Array((6,), _NOT_NEGATIVE, or_number=True, or_null=True)] = None
    # K_h, diagonal, [N/m] x3, [N m/rad] x3
    hold: Annotated[float | Vector | None, _Array((6,), _NOT_NEGATIVE, or_number=True, or_null=True)] = None


class Fuzzy(_Block):
    """The six fuzzy systems and their adaptation, (13) and (22); docs/model.md section 5.

    Where six numbers are allowed they are for x, y, z (N) and about x, y, z (N m). In the block of `composite` the
    inputs are a pose error and its rate: a [1/m, 1/rad], b [s/m, s/rad], with defaults of their own.
    """

    enabled: Annotated[bool, _Flag()] = Field(default_factory=lambda: _core.FuzzyGains().enabled)
    # Psi of (22): the larger, the slower the weights
    adaptation: Annotated[float | Vector, _Array((6,), _POSITIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.FuzzyGains().adaptation)
    )
    # a, scales g to the first input [1/N, 1/(N m)]
    error_scale: Annotated[float | Vector, _Array((6,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.FuzzyGains().error_scale)
    )
    # b, scales dg/dt to the second input [s/N, s/(N m)]
    rate_scale: Annotated[float | Vector, _Array((6,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.FuzzyGains().rate_scale)
    )
    # s0 [N, N m]: the weights start at s0 times the table; above 0 they oppose g, below 0 they help it
    initial_scale: Annotated[float | Vector, _Array((6,), or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.FuzzyGains().initial_scale)
    )
    # rows by the first input, columns by the second, NB to PB; terms stand for -1, -2/3, ..., 1
    table: Annotated[Literal["linear"] | Matrix, _Table()] = "linear"
    bell_width: _PositiveNumber = Field(default_factory=lambda: _core.FuzzyGains().bell_width)  # null: exactly 1/6
    bell_slope: Annotated[float, _Number(above=0, at_most=16)] = Field(
        default_factory=lambda: _core.FuzzyGains().bell_slope
    )
    # sigma, how fast the weights are forgotten [1/s]; at most one over the step
    leakage: Annotated[float | Vector, _Array((6,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.FuzzyGains().leakage)
    )
    # no weight, and so no output, is larger [N, N m]; null: no limit
    weight_limit: Annotated[float | Vector | None, _Array((6,), _POSITIVE, or_number=True, or_null=True)] = None
    # what drives the adaptation teaches nothing within this [m/s, rad/s]
    dead_zone: Annotated[float | Vector, _Array((6,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.FuzzyGains().dead_zone)
    )

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("bell_width", 0) is None:
            return {key: value for key, value in data.items() if key != "bell_width"}
        return data


class Hybrid(_Block):
    """Gains of the paper's law (14), (15); docs/model.md section 5."""

    # K_p, diagonal, one entry per feature coordinate [N m/px^2]
    kp: Annotated[float | Vector, _Array((8,), _POSITIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.HybridGains().kp)
    )
    # K_v, diagonal, [N] x3, [N m] x3; 0 takes the switching term, the law's only damping, away
    kv: Annotated[float | Vector, _Array((6,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.HybridGains().kv)
    )
    fuzzy: Fuzzy = Field(default_factory=Fuzzy)


@cache
def _composite_fuzzy() -> dict[str, Any]:
    """Return the defaults of the fuzzy systems that are not those of `Fuzzy`, as plain data (not to be changed)."""
    gains = _core.CompositeGains().fuzzy
    keys = ("adaptation", "error_scale", "rate_scale")
    return {key: _map_lists(_collapsed(getattr(gains, key)), list) for key in keys}


class Composite(_Block):
    """Gains of the law that regulates the most probable pose error; docs/model.md section 5.

    Its fuzzy systems see that error and its rate, so their scales have other units and other defaults.
    """

    # K_p, diagonal, one entry per feature coordinate [N m/px^2]
    kp: Annotated[float | Vector, _Array((8,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.CompositeGains().kp)
    )
    # K_v, diagonal, [N] x3, [N m] x3
    kv: Annotated[float | Vector, _Array((6,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.CompositeGains().kv)
    )
    # K_t, diagonal, stiffness against the pose error [N/m] x3, [N m/rad] x3
    kt: Annotated[float | Vector, _Array((6,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.CompositeGains().kt)
    )
    # K_d, diagonal, viscous damping [N s/m] x3, [N m s/rad] x3
    kd: Annotated[float | Vector, _Array((6,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.CompositeGains().kd)
    )
    # Lambda, diagonal: how fast the pose error drives the adaptation [1/s]
    drive: Annotated[float | Vector, _Array((6,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.CompositeGains().drive)
    )
    # M, diagonal: weight of the start pose against the image [px^2/m^2] x3, [px^2/rad^2] x3
    prior: Annotated[float | Vector, _Array((6,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.CompositeGains().prior)
    )
    fuzzy: Fuzzy = Field(default_factory=lambda: Fuzzy(**_composite_fuzzy()))

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("fuzzy"), dict):
            return {**data, "fuzzy": {**_composite_fuzzy(), **data["fuzzy"]}}
        return data


class Kelly(_Block):
    """Gains of the transpose Jacobian law with viscous damping; docs/model.md section 5."""

    # K_p, diagonal, one entry per feature coordinate [N m/px^2]
    kp: Annotated[float | Vector, _Array((8,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.KellyGains().kp)
    )
    # K_d, diagonal, viscous damping [N s/m] x3, [N m s/rad] x3
    kd: Annotated[float | Vector, _Array((6,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.KellyGains().kd)
    )


class ResolvedRate(_Block):
    """Gains of the classical pseudo-inverse law over a velocity loop; docs/model.md section 5."""

    # lambda [1/s]; where it adapts, its value at the goal
    gain: Annotated[float, _NOT_NEGATIVE] = Field(default_factory=lambda: _core.ResolvedRateGains().gain)
    adaptive: Annotated[bool, _Flag()] = Field(default_factory=lambda: _core.ResolvedRateGains().adaptive)
    # of the adaptive gain: its value far from the goal [1/s], at most `gain`, and its slope at the goal [1/(s px)]
    gain_far: Annotated[float, _NOT_NEGATIVE] = Field(default_factory=lambda: _core.ResolvedRateGains().gain_far)
    gain_slope: Annotated[float, _NOT_NEGATIVE] = Field(default_factory=lambda: _core.ResolvedRateGains().gain_slope)
    # current: measured features and depths; desired: those of the goal; mean: half the sum of the two Jacobians
    jacobian_at: Annotated[JacobianPoint, _Choice()] = Field(
        default_factory=lambda: cast("JacobianPoint", _core.ResolvedRateGains().jacobian_at.name)
    )
    # K_i, diagonal, of the velocity loop [N s/m] x3, [N m s/rad] x3
    ki: Annotated[float | Vector, _Array((6,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.ResolvedRateGains().ki)
    )
    # M, diagonal, damps the pseudo-inverse [px^2/m^2] x3, [px^2/rad^2] x3
    damping: Annotated[float | Vector, _Array((6,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.ResolvedRateGains().damping)
    )


class Pbvs(_Block):
    """Gains of the position-based law, which estimates its pose from the features; docs/model.md section 5."""

    # K_p, diagonal, stiffness against the pose error [N/m] x3, [N m/rad] x3
    kp: Annotated[float | Vector, _Array((6,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.PbvsGains().kp)
    )
    # K_d, diagonal, viscous damping [N s/m] x3, [N m s/rad] x3
    kd: Annotated[float | Vector, _Array((6,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.PbvsGains().kd)
    )


class ComputedTorque(_Block):
    """Gains of the law that turns the estimated dynamics around; docs/model.md section 5."""

    # K_p, diagonal [1/s^2]
    kp: Annotated[float | Vector, _Array((6,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.ComputedTorqueGains().kp)
    )
    # K_d, diagonal [1/s]
    kd: Annotated[float | Vector, _Array((6,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.ComputedTorqueGains().kd)
    )
    # M, diagonal: weight of the start pose against the image [px^2/m^2] x3, [px^2/rad^2] x3; 0: the image alone
    prior: Annotated[float | Vector, _Array((6,), _NOT_NEGATIVE, or_number=True)] = Field(
        default_factory=lambda: _collapsed(_core.ComputedTorqueGains().prior)
    )


class Controller(_Block):
    """The control law. Each law has a block of its own, and only the selected one acts."""

    law: Annotated[Law, _Choice()] = "hybrid"
    # consistent: the sign of the plant; printed: (8) as it stands
    jacobian: Annotated[Literal["consistent", "printed"], _Choice()] = "consistent"
    switching: Switching = Field(default_factory=Switching)
    safe: Annotated[Safe, _SAMPLED] = Field(default_factory=Safe)
    hybrid: Hybrid = Field(default_factory=Hybrid)
    composite: Composite = Field(default_factory=Composite)
    kelly: Kelly = Field(default_factory=Kelly)
    resolved_rate: ResolvedRate = Field(default_factory=ResolvedRate)
    pbvs: Pbvs = Field(default_factory=Pbvs)
    computed_torque: ComputedTorque = Field(default_factory=ComputedTorque)


class Simulation(_Block):
    """How long and how finely; the step divides the duration."""

    # continuous: the law acts in every stage of the integration; sampled: at the servo's ticks, on the camera's frames
    mode: Annotated[Literal["continuous", "sampled"], _Choice()] = "continuous"
    # [s], of the Runge-Kutta integration; in sampled mode the servo period
    step: _PositiveNumber = Field(default_factory=lambda: _core.SimulationSettings().step)
    # in sampled mode: Runge-Kutta steps in a servo period
    substeps: Annotated[int, _Integer(1, 10**6), _SAMPLED] = Field(
        default_factory=lambda: _core.SimulationSettings().substeps
    )
    duration: _PositiveNumber = Field(default_factory=lambda: _core.SimulationSettings().duration)  # [s]
    # steps per logged sample
    log_every: Annotated[int, _Integer(1, 10**9)] = Field(default_factory=lambda: _core.SimulationSettings().log_every)

    @model_validator(mode="after")
    def _step_divides_duration(self) -> Simulation:
        settings = _core.SimulationSettings()
        settings.step, settings.duration, settings.log_every = self.step, self.duration, self.log_every
        try:
            _core.step_count(settings)
        except ValueError as error:  # "simulation.step: expected ..., got ..."
            path, _, sentence = str(error).partition(": ")
            raise _refusal(((path.removeprefix("simulation."),), sentence)) from None
        return self


class Metrics(_Block):
    """What the metrics of a run are measured against; docs/model.md section 8."""

    # [px], of settling, overshoot and straight ways: every feature error is within it
    band: _PositiveNumber = Field(default_factory=lambda: _core.MetricsSettings().band)
    # [s]: a run is settled where it has been within the band for so long at its end
    dwell: _PositiveNumber = Field(default_factory=lambda: _core.MetricsSettings().dwell)
    # [s]: from here to the end the RMS error is taken; a run that is not longer has none
    rms_start: _NumberNotNegative = Field(default_factory=lambda: _core.MetricsSettings().rms_start)


class Scenario(_Block):
    """All that a run depends on. Immutable; a scenario that exists is one that can run.

    Two scenarios are equal when they mean the same: six equal gains are that gain, a table that equals the linear one
    is "linear", values that a preset fills in are as good as written ones.
    """

    name: Annotated[str, _Name()]
    description: Annotated[str, _Line()] = ""  # what it shows, for lists
    seed: Annotated[int, _Integer(0, 2**64 - 1), _SAMPLED] = 0  # of everything random
    robot: Robot = Field(default_factory=lambda: Robot.model_validate({"preset": _DEFAULT_PRESET}))
    camera: Camera = Field(default_factory=Camera)
    sensors: Annotated[Sensors, _SAMPLED] = Field(default_factory=Sensors)
    actuators: Annotated[Actuators, _SAMPLED] = Field(default_factory=Actuators)
    base_motion: Annotated[BaseMotion, _SAMPLED] = Field(default_factory=BaseMotion)
    target: Target
    uncertainty: Uncertainty = Field(default_factory=Uncertainty)
    controller: Controller = Field(default_factory=Controller)
    simulation: Simulation = Field(default_factory=Simulation)
    metrics: Metrics = Field(default_factory=Metrics)

    def __init__(self, /, **keys: Any) -> None:
        """Validate the keys of a scenario.

        Raises
        ------
        ScenarioError
            With one line for each problem.
        """
        try:
            super().__init__(**_plain(keys))
        except ValidationError as error:
            raise ScenarioError(list(_in_words(error))) from None

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, data: Any) -> Any:
        """Fill in the camera's period: the servo period in sampled mode, null in continuous mode, where it is none."""
        if not isinstance(data, dict):
            return data
        camera, simulation = data.get("camera", {}), data.get("simulation", {})
        if not isinstance(camera, dict) or not isinstance(simulation, dict):
            return data  # refused at its own place
        step = simulation.get("step", _core.SimulationSettings().step)
        if not _is_number(step):
            return data
        period = camera.get("period")
        sampled = simulation.get("mode") == _SAMPLED_MODE
        if sampled and period is None and step > 0:
            return {**data, "camera": {**camera, "period": step}}
        if not sampled and period == step:
            return {**data, "camera": {**camera, "period": None}}
        return data

    @model_validator(mode="after")
    def _can_run(self) -> Scenario:
        self._refuse_keys_without_effect()
        from hexservo.scenario.parameters import core_parameters  # it knows scenarios, so it is imported late

        core_parameters(self)
        return self

    def _refuse_keys_without_effect(self) -> None:
        if self.simulation.mode == _SAMPLED_MODE:
            return
        given = [key for key, default in sampled_keys().items() if value_at(self, key) != default]
        if given:
            raise ValueError(without_effect(given))

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any]) -> Scenario:
        """Make a scenario from nested mappings and lists; numpy arrays and scalars will do.

        Raises
        ------
        ScenarioError
            With one line for each problem.
        """
        return cls(**_as_block(_plain(mapping)))

    @classmethod
    def from_yaml(cls, text: str, source: str | None = None) -> Scenario:
        """Make a scenario from YAML text, as `to_yaml` writes it; `source` heads the errors.

        Raises
        ------
        ScenarioError
            With one line for each problem.
        """
        return _from_document(load_yaml(text, source), source)

    def updated(self, changes: Mapping[str, Any]) -> Scenario:
        """Return a copy with some keys changed, validated again.

        Parameters
        ----------
        changes
            Values by dotted key, as ``{"uncertainty.depth": -0.3}``. A mapping as the value of a block changes the
            keys it names and leaves the others alone. Changing ``robot.preset`` brings that preset's values, except
            where this scenario differs from its own preset. To give the target's points in the other form, set the
            keys of the first form to None.

        Raises
        ------
        ScenarioError
            With one line for each problem; an unknown key comes with the nearest known one.
        """
        keys = self._written()
        problems = [problem for path, value in _plain(changes).items() if (problem := _put(keys, path, value))]
        if problems:
            raise ScenarioError(problems)
        return type(self)(**keys)

    def to_mapping(self) -> dict[str, Any]:
        """Return the whole scenario, every default filled in, as dicts, lists, text and numbers."""
        return cast("dict[str, Any]", _plain(self))

    def to_yaml(self) -> str:
        """Return the whole scenario as YAML that loads to an equal one, floats bit for bit."""
        return dump_yaml(self.to_mapping())

    def _written(self) -> dict[str, Any]:
        """Return what a user has to write for this scenario: without the values that follow from others."""
        keys = self.to_mapping()
        if self.robot.preset is not None:
            preset = _preset_values(self.robot.preset)
            keys["robot"] = {key: value for key, value in keys["robot"].items() if preset.get(key) != value}
        if self.target.depth == _DEFAULT_DEPTH:
            del keys["target"]["depth"]
        if self.camera.period == self.simulation.step:
            del keys["camera"]["period"]
        return keys


@cache
def sampled_keys() -> dict[str, Any]:
    """Return the dotted keys that act in sampled mode alone, with their defaults (not to be changed).

    A scenario in continuous mode has these values; `updated` with them, before the mode is changed, drops the rest.
    """
    return {path: _default(field) for path, field, sampled in _leaves(Scenario) if sampled}


@cache
def acting_keys(law: str, mode: str) -> dict[str, NumericKey]:
    """Return those of the `numeric_keys` that act in a mode: what a batch of such scenarios may vary."""
    keys = numeric_keys(law)
    return keys if mode == _SAMPLED_MODE else {key: rule for key, rule in keys.items() if key not in sampled_keys()}


def without_effect(keys: Sequence[str]) -> str:
    """Say why these of the `sampled_keys` are refused in continuous mode."""
    has, them = ("has", "the key") if len(keys) == 1 else ("have", "these keys")
    return f"{', '.join(keys)}: {has} no effect in continuous mode; set simulation.mode: sampled, or drop {them}"


def _leaves(block: type[BaseModel], head: str = "", sampled: bool = False) -> Iterator[tuple[str, FieldInfo, bool]]:
    """Walk all keys that are no blocks: dotted key, field, whether it acts in sampled mode alone."""
    for key, field in block.model_fields.items():
        marked = sampled or _SAMPLED in field.metadata
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from _leaves(field.annotation, f"{head}{key}.", marked)
        else:
            yield head + key, field, marked


def _default(field: FieldInfo) -> Any:
    return field.get_default(call_default_factory=True)


@cache
def keys_below(name: str) -> tuple[str, ...]:
    """Return the dotted keys that a block holds, or the key itself."""
    return tuple(path for path, _, _ in _leaves(Scenario) if path == name or path.startswith(f"{name}."))


@cache
def default_of(key: str) -> Any:
    """Return the default of a dotted key whose blocks have defaults."""
    block, *inner = key.split(".")
    value = _default(Scenario.model_fields[block])
    for name in inner:
        value = getattr(value, name)
    return value


def value_at(scenario: Scenario, key: str) -> Any:
    """Return the value of a dotted key."""
    value: Any = scenario
    for name in key.split("."):
        value = getattr(value, name)
    return value


# ---- Scenarios by name or path --------------------------------------------------------------------------------------


def scenario_names() -> tuple[str, ...]:
    """Return the names of the packaged scenarios, in alphabetical order."""
    folder = resources.files("hexservo") / "scenarios"
    return tuple(sorted(item.name[:-5] for item in folder.iterdir() if item.name.endswith(".yaml")))


def load_scenario(name_or_path: str | os.PathLike[str]) -> Scenario:
    """Load a packaged scenario by its name, or one from a YAML file.

    Parameters
    ----------
    name_or_path
        One of `scenario_names`, or the path of a file. A packaged name wins over a file of the same name in the
        current folder, which is reached by ``./name`` or as a `pathlib.Path`.

    Raises
    ------
    ScenarioError
        No such scenario (with the nearest name), a file that cannot be read, or a scenario that is not valid: then
        with one line for each problem, headed by the file's name.
    """
    names = scenario_names()
    if isinstance(name_or_path, str):
        if name_or_path in names:
            text = (resources.files("hexservo") / "scenarios" / f"{name_or_path}.yaml").read_text(encoding="utf-8")
            return Scenario.from_yaml(text, name_or_path)
        if not os.path.lexists(name_or_path):
            stem = name_or_path.removesuffix(".yaml")
            what = "no such file"
            if stem == name_or_path and "/" not in stem:
                what = f"no packaged scenario has that name, and there is {what}"
            nearest = _did_you_mean(stem.rpartition("/")[2], names)
            raise ScenarioError(f'"{name_or_path}": {what}{nearest or "; `hexservo scenarios` lists what is packaged"}')
    path = os.fsdecode(name_or_path)
    return _from_document(read_yaml(name_or_path), path, Path(path).parent)


def _from_document(document: Any, source: str | None, folder: Path | None = None) -> Scenario:
    """Make a scenario; the path of a recording is relative to `folder`, else to the current one."""
    base_motion = document.get("base_motion") if isinstance(document, dict) else None
    if folder is not None and isinstance(base_motion, dict) and isinstance(base_motion.get("file"), str):
        file = str(folder / base_motion["file"])
        document = {**document, "base_motion": {**base_motion, "file": file}}
    try:
        return Scenario(**_as_block(document))
    except ScenarioError as error:
        raise ScenarioError(error.problems, source) from None


# ---- Plain data and errors in words ---------------------------------------------------------------------------------


@cache
def _preset_values(preset: str) -> dict[str, Any]:
    """Return what a preset puts in for each key of the robot block, as plain data (not to be changed)."""
    robot = _core.robot_preset(preset)
    values = {
        key: _map_lists(_tupled(getattr(robot, key)), list)
        for key in Robot.model_fields
        if key not in ("preset", "inertia", "on_limit")
    }
    return {**values, "inertia": _map_lists(_diagonal_if_diagonal(_tupled(robot.inertia)), list)}


def _plain(value: Any, place: str = "", depth: int = 0) -> Any:
    """Copy into dicts, lists, text, numbers, booleans and None; anything else stays, for a rule to refuse it."""
    if depth > MAX_DEPTH:
        raise ScenarioError(f"{place[:60]}...: expected at most {MAX_DEPTH} levels of nesting, got more")
    if isinstance(value, BaseModel):
        value = {key: getattr(value, key) for key in type(value).model_fields}
    if isinstance(value, Mapping):
        for key in value:
            if not isinstance(key, str) or not _is_unicode(key):
                raise ScenarioError(f"{place or 'the scenario'}: expected keys that are text, got {_shown(key)}")
        return {str(key): _plain(item, f"{place}.{key}".lstrip("."), depth + 1) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(item, place, depth + 1) for item in value]
    if isinstance(value, str) and not _is_unicode(value):
        raise ScenarioError(f"{place}: expected text of whole Unicode characters, got {_shown(value)}")
    for kind in (bool, int, float, str):  # numpy's float64 is a float, an enumeration may be text
        if isinstance(value, kind):
            return kind(value)
    return value


def _is_unicode(text: str) -> bool:
    """Tell whether text has no lone surrogates: they can neither be written nor shown."""
    return not any("\ud800" <= character <= "\udfff" for character in text)


def _as_block(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ScenarioError(f"expected a scenario: a mapping with the keys {_listing(Scenario)}; got {_shown(value)}")
    return value


def _put(keys: dict[str, Any], path: str, value: Any) -> str | None:
    """Change one value by its dotted path, or say what is wrong with the path. Unknown keys are found later."""
    *blocks, key = path.split(".")
    for index, name in enumerate(blocks):
        inner = keys.setdefault(name, {})
        if not isinstance(inner, dict):
            return f"{path}: unknown key; {'.'.join(blocks[: index + 1])} is a value and holds no keys"
        keys = inner
    if isinstance(value, dict) and isinstance(keys.get(key), dict):
        _merge(keys[key], value)
    else:
        keys[key] = value
    return None


def _merge(keys: dict[str, Any], changes: dict[str, Any]) -> None:
    for key, value in changes.items():
        if isinstance(value, dict) and isinstance(keys.get(key), dict):
            _merge(keys[key], value)
        else:
            keys[key] = value


def _in_words(error: ValidationError) -> Iterator[str]:
    """Say each problem that pydantic found in a line of its own, the first ones if there are many."""
    missing: dict[tuple[int | str, ...], list[str]] = {}
    problems = error.errors(include_url=False)
    for problem in problems[:_MOST_PROBLEMS]:
        place = problem["loc"]
        kind = problem["type"]
        if kind == "missing":
            missing.setdefault(place[:-1], []).append(str(place[-1]))
        elif kind == "extra_forbidden":
            yield f"{_path(place)}: {_unknown_key(place)}"
        elif kind == "value_error":  # from a check of the whole, which places its own lines
            yield from str(problem["ctx"]["error"]).splitlines()
        elif kind == "scenario":
            yield f"{_path(place)}: {problem['msg']}"
        else:  # a block that is none
            listing = _listing(_block(place))
            yield f"{_path(place)}: expected a block with the keys {listing}; got {_shown(problem['input'])}"
    for place, keys in missing.items():
        block = _block(place)
        head = f"{_path(place)}: " if place else ""
        hint = "; a preset would fill them in" if block is Robot else ""
        yield f"{head}missing {'key' if len(keys) == 1 else 'keys'}: {_described(block, keys)}{hint}"
    if (more := len(problems) - _MOST_PROBLEMS) > 0:
        yield f"and {more} more {'problem' if more == 1 else 'problems'}"


def _path(place: Sequence[int | str]) -> str:
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).removeprefix(".")


def _block(place: Sequence[int | str]) -> type[BaseModel]:
    """Find the block at a place in a scenario."""
    block: type[BaseModel] = Scenario
    for part in place:
        block = cast("type[BaseModel]", block.model_fields[str(part)].annotation)
    return block


def _listing(block: type[BaseModel]) -> str:
    return ", ".join(block.model_fields)


def _described(block: type[BaseModel], keys: Iterable[str]) -> str:
    """List keys with what each is expected to be."""
    texts = []
    for key in keys:
        rules = [rule.expected for rule in block.model_fields[key].metadata if isinstance(rule, _Rule)]
        texts.append(f"{key} ({rules[0]})" if rules else key)
    return ", ".join(texts)


def _unknown_key(place: Sequence[int | str]) -> str:
    block = _block(place[:-1])
    key = str(place[-1])
    nearest = _did_you_mean(key, block.model_fields)
    if not nearest:  # right key, wrong block
        paths = list(_paths(Scenario))
        names = difflib.get_close_matches(key.lower(), {path.rpartition(".")[2] for path in paths}, 1, 0.8)
        elsewhere = [f'"{path}"' for path in paths if names and path.rpartition(".")[2] == names[0]]
        nearest = f"; did you mean {' or '.join(elsewhere)}?" if elsewhere else ""
    return f"unknown key{nearest or ';'} known keys: {_listing(block)}"


def _paths(block: type[BaseModel], head: str = "") -> Iterator[str]:
    for key, field in block.model_fields.items():
        yield head + key
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from _paths(field.annotation, f"{head}{key}.")
