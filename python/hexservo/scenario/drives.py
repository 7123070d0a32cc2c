"""The blocks of the actuators: what the drives of the legs take, and how they follow it. docs/model.md section 7."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hexservo.scenario.block import Block, NumberNotNegative, PositiveNumber
from hexservo.scenario.rules import Choice, Flag, OptionalNumber


class PositionResponse(Block):
    """How legs whose drives take positions follow their command; docs/model.md section 7. Of cranks rad, not m."""

    bandwidth: PositiveNumber = 20.0  # [Hz], undamped natural frequency
    damping: PositiveNumber = 1.0  # [1], 1: critical
    speed_limit: Annotated[float | None, OptionalNumber(above=0)] = None  # [m/s], of each leg; null: none
    acceleration_limit: Annotated[float | None, OptionalNumber(above=0)] = None  # [m/s^2], of each leg; null: none


class Motors(Block):
    """Motors that hold positions of the legs by a torque within `robot.force_limit`; docs/model.md section 7.

    Of cranks rad, N m and kg m^2, not m, N and kg.
    """

    kp: PositiveNumber = 1000.0  # [N/m], torque over the error of position
    kv: NumberNotNegative = 10.0  # [N s/m], torque over the rate, against it
    damping: NumberNotNegative = 0.0  # [N s/m], viscous friction of the leg
    friction: NumberNotNegative = 0.0  # [N], dry friction of the leg
    armature: NumberNotNegative = 0.0  # [kg], inertia of motor, gear and crank, seen at the leg
    quantisation: NumberNotNegative = 0.0  # [m], commanded positions are multiples of it; 0: not rounded


class Actuators(Block):
    """The actuators of the legs, in `sampled` mode; docs/model.md section 7. The defaults only hold the wrench."""

    # what the drives take: forces of the legs, or positions, which they follow whatever it takes, or by motors
    kind: Annotated[Literal["force", "position", "position_torque"], Choice()] = "force"
    hold: Annotated[Literal["wrench", "leg_forces"], Choice()] = "wrench"  # what stays the same between two ticks
    saturation: Annotated[bool, Flag()] = False  # leg forces are limited to robot.force_limit
    bandwidth: Annotated[float | None, OptionalNumber(above=0)] = None  # [Hz], of a first-order lag; null: none
    quantisation: NumberNotNegative = 0.0  # [N], leg forces are multiples of it; 0: not rounded
    delay: NumberNotNegative = 0.0  # [s], a whole number of servo periods, at most 8
    position: PositionResponse = Field(default_factory=PositionResponse)  # of drives that take positions, as assumed
    motor: Motors = Field(default_factory=Motors)  # of position_torque

    @property
    def takes_positions(self) -> bool:
        """Whether the drives take positions."""
        return self.kind != "force"
