"""Poses of the platform, one or many at once, and displacements between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.rotations import conjugate, quaternion_of, quaternion_product, unit_rotation_vectors


@dataclass(frozen=True, eq=False)
class Poses:
    """Position and attitude of E in B: one pose, or many along the leading axes of both arrays.

    A displacement is a shift [m] and a rotation vector [rad], (..., 6), both in B; the platform turns about E's origin.
    """

    position: Array  # (..., 3) [m]
    quaternion: Array  # (..., 4) w x y z, of unit length

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.position)

    def __getitem__(self, rows: int | np.int_ | slice | Mask | NDArray[np.int_] | list[int]) -> Poses:
        """Return the selected rows."""
        return Poses(self.position[rows], self.quaternion[rows])

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the leading axes: () for one pose."""
        return self.position.shape[:-1]

    @property
    def rows(self) -> Poses:
        """The same poses, one per row."""
        return Poses(self.position.reshape(-1, 3), self.quaternion.reshape(-1, 4))

    def carried(self, points: Array) -> Array:
        """Return points in B, (..., n, 3) [m], that are fixed to the platform at (n, 3) in E [m]."""
        q = self.quaternion[..., None, :]
        pure = np.column_stack([np.zeros(len(points)), points])
        turned = quaternion_product(quaternion_product(q, pure), conjugate(q)) / (q * q).sum(-1, keepdims=True)
        return np.asarray(self.position[..., None, :] + turned[..., 1:])

    def moved(self, displacement: Array) -> Poses:
        """Return the poses after displacements: one per row, or one for all."""
        if displacement.ndim == 1 and not displacement.any():
            return self
        quaternion = quaternion_product(quaternion_of(displacement[..., 3:]), self.quaternion)
        length = np.sqrt((quaternion * quaternion).sum(axis=-1, keepdims=True))
        return Poses(self.position + displacement[..., :3], quaternion / length)

    def displacement_from(self, other: Poses) -> Array:
        """Return the displacements from other poses to these, (..., 6) [m; rad], as of `moved`; rotation at most pi."""
        turn = quaternion_product(self.quaternion, conjugate(other.quaternion))
        return np.concatenate([self.position - other.position, unit_rotation_vectors(turn)], axis=-1)

    def repeated(self, count: int) -> Poses:
        """Return one pose repeated, as rows."""
        return Poses(np.tile(self.position, (count, 1)), np.tile(self.quaternion, (count, 1)))

    def chosen(self, rows: Mask, others: Poses) -> Poses:
        """Return the other's pose in the rows that are True, this one elsewhere."""
        return Poses(
            np.where(rows[:, None], others.position, self.position),
            np.where(rows[:, None], others.quaternion, self.quaternion),
        )

    @staticmethod
    def joined(*parts: Poses) -> Poses:
        """Concatenate poses as rows."""
        return Poses(np.vstack([p.position for p in parts]), np.vstack([p.quaternion for p in parts]))


def by_displacement(values: Callable[[Poses], Array], poses: Poses, steps: Array) -> Array:
    """Return the derivative of a function of the pose by a displacement, (..., k, 6), by central differences.

    Parameters
    ----------
    values
        Of poses (..., 12) at once, (..., 12, k).
    poses
        Where.
    steps
        (6,) [m; rad].
    """
    moves = np.vstack([np.diag(steps), -np.diag(steps)])
    around = Poses(poses.position[..., None, :], poses.quaternion[..., None, :]).moved(moves)
    found = values(around)
    slope: Array = (found[..., :6, :] - found[..., 6:, :]) / (2.0 * steps[:, None])
    return slope.swapaxes(-1, -2)


def without_sign(directions: Array) -> Array:
    """Return directions (..., 6) of arbitrary sign with the sign for which the first large entry is positive.

    Large is what has at least 0.9 of the largest, so that rounding does not choose between two that are equal.
    """
    size = np.abs(directions)
    first = (size >= 0.9 * size.max(axis=-1, keepdims=True)).argmax(axis=-1)[..., None]
    return np.asarray(directions * np.sign(np.take_along_axis(directions, first, axis=-1)))
