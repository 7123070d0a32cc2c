"""The packaged scenarios as parameters of a test: one of each kind in every run, the others behind `slow`."""

from __future__ import annotations

import pytest

import hexservo as hs

ONE_OF_EACH_KIND = (
    "composite-30hz",
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
"""Every law in the modes it is packaged in, and every kind of device, motion and start: see `kinds`."""


def kinds(scenario: hs.Scenario) -> set[tuple[object, ...]]:
    """Return what decides which branches of a run and of its findings a scenario reaches."""
    controller, camera = scenario.controller, scenario.camera
    return {
        ("law and mode", controller.law, scenario.simulation.mode),
        ("switching", controller.switching.kind),
        ("jacobian", controller.jacobian),
        ("legs", scenario.actuators.kind, scenario.robot.cranks is not None),
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
