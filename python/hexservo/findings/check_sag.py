"""Motors that yield to the weight: where the law `tracking` rests beside its goal, and what integrates that away."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.motor_rest import BEGINS, motor_rest
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.check_tracking import ABOVE, off_reference
from hexservo.findings.leg_feedback import OF_MARGIN, integral_margin
from hexservo.scenario.arrays import Array
from hexservo.scenario.laws import Tracking
from hexservo.scenario.wording import above, below, number, quantity

_OF_LEAD = 0.61  # of the lead of legs at their speed limit: kReach of target_tracking.hpp
_OF_BAND = 0.25  # of the settling band, by which errors within the band of the integral move the image


@dataclass(frozen=True, eq=False)
class Sag:
    """Where motors rest under the weight at the goal, to first order, without friction and without an integral."""

    legs: Array  # (6,) [m], by which the legs are off, of cranks [rad]
    shift: Array  # (6,) [m; rad], by which the platform is off
    pixels: float  # largest coordinate of the image error [px]
    certain: float  # the same where friction takes its part of the weight
    lead: float  # of a command to the leg at rest that needs most, for the weight beyond the friction, as `legs`
    jacobian: Array  # (2p, 6) of the image at the goal [px/m; px/rad]

    def begins(self, band: Array) -> bool:
        """Return whether the offset makes an integral with a band (6,) [m; rad] begin."""
        return bool((np.abs(self.shift) > BEGINS * band).any())


def of_sag(scene: Scene) -> Iterator[str]:
    """Yield a sentence for motors that rest outside the settling band by the weight that they carry, or sink by it."""
    sag = sag_of(scene)
    if sag is None:
        return
    gains = scene.scenario.controller.gains
    assert isinstance(gains, Tracking)
    reach = _reach(scene, gains)
    if sag.lead > reach:
        unit, least = scene.units.coordinate, float(above(sag.lead / _lead_time(scene), 2))
        yield (
            f"controller.tracking.feedback: the weight at the goal needs a command {quantity(sag.lead, unit)} beside a "
            f"leg (its force over actuators.motor.kp), and with a feedback the law commands at most "
            f"{quantity(reach, unit)} beside the measured one (actuators.position.speed_limit), so that the platform "
            f"sinks; take a larger kp, a speed limit of {quantity(least, scene.units.rate)} or more, or a "
            "feedback of 0"
        )
    if sag.lead > reach or sag.certain <= scene.band:
        return
    rest = (
        f"so that the platform rests about {number(sag.pixels, 2)} px from the goal, outside of {number(scene.band)} px"
    )
    off = f"{quantity(float(np.abs(sag.legs).max()), scene.units.coordinate)}"
    fitted = fitted_integral(scene, sag)
    if gains.integral == 0.0:
        remedy = "controller.tracking.integral with a controller.tracking.band well below that offset"
        if fitted is not None:
            integral, band = fitted
            remedy = f"controller.tracking.integral: {number(integral)} with a controller.tracking.band of {both(band)}"
        yield (
            f"actuators.motor.kp: the weight at the goal moves a leg by {off} (its force over kp), {rest}, and no term "
            f"of the law corrects that; take a larger kp, or {remedy}"
        )
    elif not sag.begins(scene.settings["controller.tracking.band"]):
        yield (
            f"controller.tracking.band: the integral begins beyond twice the band, and the weight at the goal moves "
            f"the platform by {both(sag.shift)} only (a leg by {off}, its force over actuators.motor.kp), {rest}; take "
            + ("a larger actuators.motor.kp" if fitted is None else f"a band of {both(fitted[1])}")
        )


def _reach(scene: Scene, gains: Tracking) -> float:
    """Return how far from the measured legs the law commands them with a feedback [m], of cranks [rad]; or inf."""
    limit = scene.scenario.actuators.position.speed_limit
    return np.inf if gains.feedback == 0.0 or limit is None else limit * _lead_time(scene)


def _lead_time(scene: Scene) -> float:
    response = scene.scenario.actuators.position
    lag = response.damping / (math.pi * response.bandwidth)  # 2 zeta/w
    return _OF_LEAD * lag + scene.scenario.simulation.step


def both(motion: Array) -> str:
    """Return the largest shift and rotation of a motion (6,) with their units."""
    shift, turn = (float(np.abs(part).max()) for part in np.split(motion, 2))
    return f"{quantity(shift, 'm', 2)} and {quantity(turn, 'rad', 2)}"


def sag_of(scene: Scene) -> Sag | None:
    """Return the offset of the law `tracking` under the weight, without its integral; None for others."""
    scenario = scene.scenario
    gains = scenario.controller.gains
    of_law = isinstance(gains, Tracking) and gains.follow == "pose"
    if scenario.actuators.kind != "position_torque" or not of_law or scenario.target.motion.kind != "none":
        return None
    goals = find_goals(scene)
    if goals is None or not goals.reachable:
        return None
    view = goals.best.view
    rest = motor_rest(scene, view.pose)
    map_ = scene.wrench_maps(view.pose)
    shift, certain = (np.asarray(np.linalg.solve(map_.T, each)) for each in (rest.sag, rest.certain))
    pixels = [float(np.abs(view.jacobian @ each).max()) for each in (shift, certain)]
    lead = float(np.abs(rest.certain).max()) * (1.0 + gains.feedback)
    return Sag(rest.sag, shift, pixels[0], pixels[1], lead, view.jacobian)


def fitted_integral(scene: Scene, sag: Sag) -> tuple[float, Array] | None:
    """Return an integral [1/s] and its band (6,) [m; rad] that correct an offset; None where there are none.

    The integral is the scenario's own, or half of its margin where it has none or more. Errors within the band move the
    image by a quarter of the settling band, but it is no narrower than noise requires (`off_reference`). There is none
    where the offset does not make an integral with that band begin, or the whole band leaves the settling band.
    """
    gains = scene.scenario.controller.gains
    assert isinstance(gains, Tracking)
    most = OF_MARGIN * integral_margin(scene.scenario)
    integral = gains.integral if 0.0 < gains.integral <= most else most
    of_pixels = np.repeat([scene.depth, 1.0], 3)
    of_pixels *= _OF_BAND * scene.band / float((np.abs(sag.jacobian) @ of_pixels).max())
    band = np.maximum(of_pixels, ABOVE * off_reference(scene, gains))
    band = np.repeat([float(above(float(part.max()), 2)) for part in np.split(band, 2)], 3)
    settles = float((np.abs(sag.jacobian) @ band).max()) <= scene.band
    return (float(below(integral, 2)), band) if integral > 0.0 and settles and sag.begins(band) else None
