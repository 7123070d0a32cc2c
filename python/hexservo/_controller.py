"""The servo tick, for teaching and tests: the function that a robot calls in C++."""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexservo import _core
from hexservo._parameters import core_parameters
from hexservo._scenario import Scenario

__all__ = ["Controller", "ControllerOutput"]

InputStatus: TypeAlias = Literal["valid", "missing_image", "stale_image", "unusable"]


class ControllerOutput(NamedTuple):
    """What a tick gives back; vectors are in the base frame B (docs/model.md, section 7)."""

    wrench: NDArray[np.float64]
    """(6,), force and moment about E's origin [N; N m]."""
    leg_forces: NDArray[np.float64]
    """(6,), positive where they push the platform away from the base [N]."""
    fuzzy_output: NDArray[np.float64]
    """(6,), output of the fuzzy systems, already subtracted in `wrench` [N; N m]."""
    invalid_input: bool
    """The input could not be used: the wrench only holds the platform, and the controller's state is unchanged."""
    status: InputStatus
    """``valid``, or why not: ``missing_image`` (no feature is known), ``stale_image`` (older than the scenario's
    ``camera.timeout``, or of unknown age), ``unusable``."""


class Controller:
    """The controller of a scenario, one tick at a time (docs/model.md, section 7).

    It knows what the scenario's controller knows: robot, camera, goal and gains, not ``uncertainty``, which belongs to
    the plant.

    For teaching and tests. A call from Python costs several times the tick itself, most of it for the conversion of
    five arrays in and three out: about 7 times as much as the same tick called from C++ (medians of 100 blocks of 1000
    calls, numpy arrays as arguments, one core, the same compiler and flags), and more with lists. A robot's program
    includes the header that ``hexservo export`` writes and calls ``hexservo::step``.

    Parameters
    ----------
    scenario
        Its law, robot, camera and target.
    period
        Time between two ticks [s].

    Raises
    ------
    TypeError
        For anything but a `Scenario`.
    ValueError
        For a period that is not a finite number > 0.
    """

    def __init__(self, scenario: Scenario, period: float = 1e-3) -> None:
        if not isinstance(scenario, Scenario):
            raise TypeError(f"scenario: expected a Scenario (see hs.load_scenario), got {type(scenario).__name__}")
        self._scenario = scenario
        self._core = _core.Controller(core_parameters(scenario), period)

    def __repr__(self) -> str:
        """Show the scenario's name and the period."""
        return f"Controller({self._scenario.name!r}, period={self.period!r})"

    @property
    def scenario(self) -> Scenario:
        """What the controller was made from."""
        return self._scenario

    @property
    def period(self) -> float:
        """Time between two ticks [s]."""
        return self._core.period

    @property
    def fuzzy_weights(self) -> NDArray[np.float64]:
        """Weights of the six fuzzy systems now, (6, 7, 7), row: term of u, column: term of its rate [N; N m]."""
        return self._core.fuzzy_weights

    def reset(self) -> None:
        """Go back to the state before the first tick."""
        self._core.reset()

    def step(
        self,
        features: ArrayLike,
        depth: ArrayLike,
        position: ArrayLike,
        quaternion: ArrayLike,
        twist: ArrayLike,
        image_age: float = 0.0,
    ) -> ControllerOutput:
        """Take one tick: (13), (14), (15), leg forces, and the adaptation (22) over one period.

        Numbers that are not finite are accepted, as sensors give them; they make the output safe (`invalid_input`).
        So do features more than 1e4 px from the goal, twists beyond 1e3, points that are not in front of the camera, a
        quaternion without a length, and singular poses. The leg forces then hold the platform at the last valid pose.

        Parameters
        ----------
        features
            (8,), measured (x1, y1, ..., x4, y4) from the image centre [px].
        depth
            (4,), measured z of the points in E, negative in front of the camera [m].
        position
            (3,), of E's origin, in B [m].
        quaternion
            (4,), attitude of E in B, (w, x, y, z) of any length but zero.
        twist
            (6,), velocity of E's origin and angular velocity, in B [m/s; rad/s].
        image_age
            Time since the image was exposed [s]; beyond ``camera.timeout`` of the scenario the image is not used.

        Raises
        ------
        ValueError
            "name: expected 8 numbers, got ..." for an argument of another shape or of no numbers.
        """
        wrench, leg_forces, fuzzy_output, status = self._core.step(
            features, depth, position, quaternion, twist, image_age
        )
        return ControllerOutput(
            wrench, leg_forces, fuzzy_output, status != _core.InputStatus.valid, cast("InputStatus", status.name)
        )
