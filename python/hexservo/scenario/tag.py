"""Targets whose points follow from a few numbers: the corners of a square tag, a plane grid; and how many there are."""

from __future__ import annotations

import math
from functools import cache
from typing import Any, TypeAlias, TypeGuard

import numpy as np
from pydantic import ValidationError

from hexservo import _core
from hexservo.scenario.pose_rules import PoseRule
from hexservo.scenario.rules import MOST_POINTS, Integer, Matrix, Number, Rule, Vector, refusal

__all__ = ["Grid", "Tag", "rotation_matrix"]

Tag: TypeAlias = tuple[float, Vector]
"""Side of the square [m]; its pose (6,): centre in B [m], rotation vector [rad]."""

Grid: TypeAlias = tuple[int, int, float, Vector]
"""Rows and columns of points; distance of neighbours [m]; pose (6,): centre in B [m], rotation vector [rad]."""

_KEYS = ("size", "pose")
_GRID_KEYS = ("rows", "columns", "spacing", "pose")
# Seen from the front, with x to the right and y up: the order of ArUco and of IPPE_SQUARE in OpenCV.
CORNERS = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])


class TagRule(Rule):
    """A mapping with the tag's size and pose, or null."""

    expected = "size (a number > 0, m) and pose (6 numbers, m and rad), or null"

    def accept(self, value: Any) -> Tag | None:
        if value is None:
            return None
        if not isinstance(value, dict) or set(value) != set(_KEYS):
            self.refuse(value)
        return Number(above=0).accept(value["size"]), _pose(value["pose"])


class GridRule(Rule):
    """A mapping with the grid's rows, columns, spacing and pose, or null."""

    expected = (
        "rows and columns (integers >= 2, of at most 16 points), spacing (a number > 0, m) and pose (6 numbers, m "
        "and rad), or null"
    )

    def accept(self, value: Any) -> Grid | None:
        if value is None:
            return None
        if not isinstance(value, dict) or set(value) != set(_GRID_KEYS):
            self.refuse(value)
        most = Integer(2, MOST_POINTS // 2)
        rows, columns = most.accept(value["rows"]), most.accept(value["columns"])
        if rows * columns > MOST_POINTS:
            raise refusal(
                (("columns",), f"expected at most {MOST_POINTS} points, got {rows} rows of {columns}, {rows * columns}")
            )
        return rows, columns, Number(above=0).accept(value["spacing"]), _pose(value["pose"])


def _pose(value: Any) -> Vector:
    try:
        return PoseRule().accept(value)
    except ValidationError as error:
        raise refusal(*((("pose", *problem["loc"]), problem["msg"]) for problem in error.errors())) from None


def require_counts(target: dict[str, Any]) -> None:
    """Refuse lists of a target, as it is written, that are not of one number of points; single numbers fit any."""
    per_point = {"points": 1, "initial_features": 2, "desired_features": 2, "depth": 1, "weights": 1}
    points, source = point_count(target)
    problems = [
        ((key,), f"expected {each * points} numbers for the {points} points of {source}, got a list of {len(value)}")
        for key, each in per_point.items()
        if points and key != source and _is_flat(value := target.get(key)) and len(value) != each * points
    ]
    if problems:
        raise refusal(*problems)


def _is_flat(value: Any) -> TypeGuard[list[Any]]:
    """Return whether a value is a list without lists in it, whose length is one of numbers."""
    return isinstance(value, list) and not any(isinstance(item, list) for item in value)


def require_counts_elsewhere(scenario: dict[str, Any]) -> None:
    """Refuse lists of other blocks of a scenario, as it is written, that are not of the target's number of points."""
    blocks = {name: scenario.get(name) for name in ("target", "uncertainty", "controller")}
    if not isinstance(blocks["target"], dict):
        return
    points, source = point_count(blocks["target"])
    uncertainty, controller = (block if isinstance(block, dict) else {} for block in list(blocks.values())[1:])
    found = [("uncertainty", "depth", uncertainty.get("depth"), 1)]
    found += [
        (f"controller.{law}", "kp", gains.get("kp"), 2) for law, gains in controller.items() if _has_pairs(law, gains)
    ]
    problems = [
        (
            (*block.split("."), key),
            f"expected a number or {each * points} for the {points} points of target.{source}, "
            f"got a list of {len(value)}",
        )
        for block, key, value, each in found
        if points and _is_flat(value) and len(value) != each * points
    ]
    if problems:
        raise refusal(*problems)


def _has_pairs(law: str, gains: Any) -> bool:
    """Return whether a block holds gains of a law whose ``kp`` has two numbers for each point."""
    if law not in _core.LAW_TRAITS or not isinstance(gains, dict):
        return False
    return _law_has_pairs(law)


@cache
def _law_has_pairs(law: str) -> bool:
    return any(key.name == f"controller.{law}.kp" and key.per_point for key in _core.scenario_keys(law))


def point_count(target: dict[str, Any]) -> tuple[int, str]:
    """Return how many points a target, as it is written, has, and by which key; 0 without one."""
    for key, each in (("points", 1), ("initial_features", 2), ("desired_features", 2)):
        value = target.get(key)
        if isinstance(value, list) and _is_flat(value) == (key != "points") and len(value) % each == 0:
            return len(value) // each, key
        if value is not None:
            return 0, key  # refused at its own place
        if key == "points" and target.get("tag") is not None:
            return len(CORNERS), "tag"
        grid = target.get("grid")
        if key == "points" and isinstance(grid, dict):
            rows, columns = grid.get("rows"), grid.get("columns")
            return (rows * columns if isinstance(rows, int) and isinstance(columns, int) else 0), "grid"
    return 0, ""


def corners(tag: Tag) -> Matrix:
    """Return the tag's corners in B, (4, 3) [m]: top left, top right, bottom right, bottom left from the front."""
    size, pose = tag
    points = np.array(pose[:3]) + size * CORNERS @ rotation_matrix(pose[3:]).T
    return tuple(tuple(map(float, point)) for point in points)


def nodes(grid: Grid) -> Matrix:
    """Return the grid's points in B, (n, 3) [m]: row by row from the top left, as a viewer of its front sees them."""
    rows, columns, spacing, pose = grid
    y, x = np.mgrid[0:rows, 0:columns]
    flat = np.stack([x - (columns - 1) / 2, (rows - 1) / 2 - y, np.zeros((rows, columns))], axis=-1).reshape(-1, 3)
    points = np.array(pose[:3]) + spacing * flat @ rotation_matrix(pose[3:]).T
    return tuple(tuple(map(float, point)) for point in points)


def normal(pose: Vector) -> Vector:
    """Return the normal in B, (3,), of a tag or grid at a pose; it points to the viewer of the front."""
    return tuple(map(float, rotation_matrix(pose[3:])[:, 2]))


def rotation_matrix(vector: Vector) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the rotation matrix of a rotation vector [rad] (Rodrigues)."""
    x, y, z = vector
    angle = math.sqrt(x * x + y * y + z * z)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    first = float(np.sinc(angle / np.pi))  # sin(angle)/angle
    second = 0.5 * float(np.sinc(0.5 * angle / np.pi)) ** 2  # (1 - cos(angle))/angle^2
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)
