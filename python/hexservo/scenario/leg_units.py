"""Units of the legs' coordinates and efforts: lengths and forces, or angles and torques of cranks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hexservo.scenario.blocks import Robot


@dataclass(frozen=True)
class LegUnits:
    """SI units of what the legs of a robot do."""

    coordinate: str  # m or rad
    effort: str  # N or N m

    @property
    def rate(self) -> str:
        """Of the coordinate per second."""
        return f"{self.coordinate}/s"

    @property
    def small(self) -> str:
        """Thousandths of the coordinate's unit, in which people read travel."""
        return f"m{self.coordinate}"

    @property
    def name(self) -> str:
        """What the coordinate is."""
        return "length" if self.coordinate == "m" else "angle"

    @property
    def effort_name(self) -> str:
        """What the effort is."""
        return "force" if self.effort == "N" else "torque"

    @property
    def efforts(self) -> tuple[str, str]:
        """Label and title of a figure of the efforts."""
        if self.effort == "N":
            return "leg force [N]", "Leg forces (positive: pushing)"
        return "crank torque [N m]", "Torques of the cranks (positive: about their axes)"

    def of(self, unit: str) -> str:
        """Return the unit of a number of the legs, given that of prismatic ones."""
        return {
            "m": self.coordinate,
            "N": self.effort,
            "m/s": self.rate,
            "m/s^2": f"{self.rate}^2",
            **({} if self.coordinate == "m" else {"N/m": "N m/rad", "N s/m": "N m s/rad", "kg": "kg m^2"}),
        }.get(unit, unit)


_PRISMATIC = LegUnits("m", "N")
_ROTARY = LegUnits("rad", "N m")
OF_LEGS = frozenset(  # keys, metrics and quantities whose unit is made of those of a coordinate and an effort
    {
        "robot.stroke",
        "robot.stroke_centre",
        "robot.force_limit",
        "robot.speed_limit",
        "sensors.resolution",
        "sensors.noise",
        "actuators.quantisation",
        "actuators.position.speed_limit",
        "actuators.position.acceleration_limit",
        *(f"actuators.motor.{key}" for key in ("kp", "kv", "damping", "friction", "armature", "quantisation")),
        "peak_leg_force",
        "peak_leg_excursion",
        "peak_leg_speed",
        "leg_lengths",
        "leg_forces",
        "stroke",
        "force",
        "speed",
    }
)


def leg_units(robot: Robot) -> LegUnits:
    """Return the units of a robot's legs."""
    return _ROTARY if robot.legs == "rotary" else _PRISMATIC


def unit_of(robot: Robot, name: str, unit: str) -> str:
    """Return the unit of a key, metric, quantity or limit of `OF_LEGS` for a robot, given that of prismatic legs."""
    return leg_units(robot).of(unit) if name in OF_LEGS else unit


def stroke_length(robot: Robot) -> float:
    """Return about how far the stroke moves a platform joint [m]: of a crank, how far its end goes."""
    length = robot.cranks.length
    return robot.stroke if length is None else robot.stroke * length


def unit_of_entry(unit: str, index: int) -> str:
    """Return the unit of an entry: "linear; angular" is about six numbers, three of each; others have one for all."""
    units = unit.split("; ")
    return units[index // 3] if len(units) > 1 else unit
