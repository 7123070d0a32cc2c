"""Encoders too coarse or too noisy for a law that steers the legs, and damps those that take forces, by them."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hexservo.findings.analysis.scene import Scene
from hexservo.scenario.parameters import reading_ticks
from hexservo.scenario.wording import number, quantity

_DEVIATIONS = 3.0  # of the features that metrics.band should hold
_OF_RANGE = 0.1  # of a fuzzy input, deviation of its noise from which on the weights follow it
_AMPLIFIED = 10.0  # times the readings in the image that the features then move, in runs 1.4 to 22 times, once 60


def of_joints(scene: Scene) -> Iterator[str]:
    """Yield a sentence for readings that move the image beyond `metrics.band`.

    In runs of six machines the features' deviation is 0.2 to 2.5 times that of the readings in the image, 0.3 times
    where they are noisy and about once where they are rounded, until the rates are too noisy for fuzzy inputs. Legs
    that take positions rest up to once the rounding away from the goal, and noise hardly moves them.
    """
    scenario, law = scene.scenario, scene.scenario.controller.law
    if not scenario.sampled or scene.joint_noise == 0.0:
        return
    if scenario.actuators.takes_positions:
        yield from _of_rounding(scene)
        return
    fuzzy, pixels = _fuzzy_noise(scene), scene.joint_noise
    head = f"{_keys(scene)}: readings of the joints are {number(pixels, 2)} px in the image (standard deviation)"
    band = f"metrics.band, {number(scene.band)} px"
    if fuzzy > _OF_RANGE and _DEVIATIONS * _AMPLIFIED * pixels > scene.band:
        yield (
            f"{head}, and their rates, differences over {quantity(_between(scene), 's')}, are {number(fuzzy, 2)} in "
            f"the second fuzzy input of {law}, which ranges from -1 to 1: the weights follow that noise, which may "
            f"move the image by ten times the readings and out of {band}; take finer encoders, or "
            f"controller.{law}.fuzzy.enabled: false"
        )
    elif _DEVIATIONS * pixels > scene.band:
        yield (
            f"{head}, and the law steers and damps by them: the image moves by a fifth of that to twice as much, and "
            f"may not stay within {band}; take finer encoders"
        )


def _of_rounding(scene: Scene) -> Iterator[str]:
    """Find readings so coarse that legs which take positions rest outside the band."""
    sensors = scene.scenario.sensors
    pixels = scene.joint_rounding
    if pixels > scene.band:
        yield (
            f"sensors.resolution of {quantity(sensors.resolution, scene.units.coordinate)}: readings of the joints are "
            f"rounded by {number(pixels, 2)} px in the image (standard deviation): legs rest up to about that far from "
            f"the goal, beyond metrics.band, {number(scene.band)} px; take finer encoders"
        )


def _keys(scene: Scene) -> str:
    sensors, unit = scene.scenario.sensors, scene.units.coordinate
    keys = [
        f"sensors.{key} of {quantity(value, unit)}"
        for key in ("resolution", "noise")
        if (value := getattr(sensors, key))
    ]
    return " and ".join(keys)


def _between(scene: Scene) -> float:
    return reading_ticks(scene.scenario) * scene.scenario.simulation.step


def _fuzzy_noise(scene: Scene) -> float:
    """Return the largest deviation of a second fuzzy input by readings, whose differences are the twist; 0 without.

    Of laws whose fuzzy systems have the rate of a pose error, which is the twist.
    """
    controller = scene.scenario.controller
    if not (controller.traits.pose_error and controller.traits.memory and controller.gains.fuzzy.enabled):
        return 0.0
    if scene.scenario.sensors.rate is True:
        return 0.0
    rates = math.sqrt(2.0) / _between(scene) * np.linalg.norm(scene.pose_noise, axis=1)
    return float((scene.settings[f"controller.{controller.law}.fuzzy.rate_scale"] * rates).max())
