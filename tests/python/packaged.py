"""The packaged scenarios as parameters of a test: one of each kind in every run, the others behind `slow`."""

from __future__ import annotations

import pytest

import hexservo as hs

ONE_OF_EACH_KIND = (
    "composite-30hz",
    "dropouts",
    "eye-to-hand",
    "fails-coarse-step",
    "fails-face-tracking",
    "fails-stick-slip",
    "fails-unequal-depth",
    "fails-wrong-sign",
    "false-equilibrium",
    "moog-6dof2000e",
    "paper",
    "paper-composite",
    "pi-h824-positions",
    "reachy-mini-head",
    "real-machine",
    "rough-road",
)
"""Every law in the modes it is packaged in, every key of a device that is set, every kind of motion: see `kinds`."""


def kinds(scenario: hs.Scenario) -> set[tuple[object, ...]]:
    """Return what decides which branches of a run and of its findings a scenario reaches."""
    controller, camera = scenario.controller, scenario.camera
    devices = {
        ("device", name, key)
        for name in ("camera", "sensors", "actuators")
        for key, value in getattr(scenario, name)
        if value != getattr(type(getattr(scenario, name))(), key)
    }
    return devices | {
        ("law and mode", controller.law, scenario.simulation.mode),
        ("switching", controller.switching.kind),
        ("jacobian", controller.jacobian),
        ("legs", scenario.actuators.kind, scenario.robot.legs),
        ("pose", scenario.sensors.pose),
        ("base", scenario.base_motion.kind),
        ("target", scenario.target.motion.kind, scenario.target.frame),
        ("points", scenario.target.count),
        ("camera", camera.convention, camera.on_lost),
    }


def one_of_each_kind() -> list[object]:
    """Return the names of all packaged scenarios as parameters, those beyond one of each kind marked `slow`."""
    return [
        name if name in ONE_OF_EACH_KIND else pytest.param(name, marks=pytest.mark.slow) for name in hs.scenario_names()
    ]
