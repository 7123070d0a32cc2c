"""Acceleration of a moving base, measured by a platform that another law holds at rest."""

from __future__ import annotations

import numpy as np

from hexservo.findings.certificate.replay import Replay
from hexservo.run.simulation import simulate
from hexservo.scenario.arrays import Array
from hexservo.scenario.scenario import Scenario

__all__ = ["base_accelerations"]


def base_accelerations(run: Replay) -> Array | None:
    """Return the acceleration of B at start, middle and end of every step of the integration, (m, 3, 3) [m/s^2].

    The core has no function for it, so it is measured: a platform without model errors and with nothing but
    viscous damping runs on the same base. Its velocity changes in a step by what its wrench, which is logged, and the
    base do; what is left is the mean of the acceleration over the step, as the integration takes it. From the means of
    neighbouring steps follow the three values, to fourth order in the step where the acceleration is smooth, and with
    the mean that was measured.

    None where the base stands still.

    Raises
    ------
    ArithmeticError
        Where that platform does not stay in the camera's view to the end.
    """
    scenario = run.scenario
    if scenario.base_motion.kind == "none" or len(run.time) < 2:
        return None
    step = run.step / scenario.simulation.substeps
    mass = scenario.robot.mass
    damping = 0.5 * mass / step  # far from the border of stability, 2 m/T, and little motion
    whole = scenario.to_mapping()
    measuring = Scenario(
        **{key: whole[key] for key in ("name", "seed", "robot", "target", "base_motion")},
        camera={"period": step, **{key: whole["camera"][key] for key in ("focal_length", "pixel_scale")}},
        controller={"law": "kelly", "kelly": {"kp": 0.0, "kd": damping}},
        simulation={"mode": "sampled", "step": step, "duration": scenario.simulation.duration},
    )
    measured = simulate(measuring)
    if measured.outcome == "interrupted":
        raise KeyboardInterrupt
    steps = (len(run.time) - 1) * scenario.simulation.substeps
    if len(measured.time) < steps + 1:
        raise ArithmeticError(f"the platform that measures the base's motion ended early: {measured.detail}")
    force = (
        measured.wrench[:, :3]
        - run.probe.estimated_wrenches(measured.quaternion[:1], np.zeros((1, 6)), np.zeros((1, 6)))[2][:3]
    )
    means = force[:-1] / mass - np.diff(measured.twist[:, :3], axis=0) / step
    return _from_means(means)[:steps]


def _from_means(means: Array) -> Array:
    """Return values at start, middle and end of n cells, (n, 3, k), from a function's Simpson means there, (n, k)."""
    first = 2 * means[0] - means[min(1, len(means) - 1)]  # straight on, beyond both ends
    last = 2 * means[-1] - means[max(len(means) - 2, 0)]
    padded = np.concatenate([[2 * first - means[0], first], means, [last, 2 * last - means[-1]]])
    borders = (7 * (padded[1:-2] + padded[2:-1]) - (padded[:-3] + padded[3:])) / 12  # of the four cells around each
    middles = (6 * means - borders[:-1] - borders[1:]) / 4
    return np.stack([borders[:-1], middles, borders[1:]], axis=1)
