"""What is random in a run: whether it draws numbers, which follow from `seed`."""

from __future__ import annotations

from hexservo.scenario.block import SAMPLED_MODE
from hexservo.scenario.blocks import Blocks

_OF_CAMERA = ("noise", "dropout", "outlier_probability", "latency_jitter")  # keys that draw numbers


def is_random(scenario: Blocks) -> bool:
    """Return whether a run draws random numbers, so that another `seed` gives another run."""
    return scenario.simulation.mode == SAMPLED_MODE and (
        any(getattr(scenario.camera, name) > 0.0 for name in _OF_CAMERA)
        or (scenario.sensors.pose == "encoders" and scenario.sensors.noise > 0.0)
        or scenario.base_motion.kind in ("noise", "road")
        or scenario.base_motion.rotation.kind == "noise"
    )
