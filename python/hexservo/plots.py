"""The paper's figures 2 to 5, and the legs with their limits: the public name of `hexservo.draw.plots`."""

from __future__ import annotations

from hexservo.draw.legs import leg_limits
from hexservo.draw.paper_figures import paper_figures
from hexservo.draw.plots import (
    feature_errors,
    feature_paths,
    platform_motion,
    rule_table,
)
from hexservo.draw.wrench import control_wrench

__all__ = [
    "control_wrench",
    "feature_errors",
    "feature_paths",
    "leg_limits",
    "paper_figures",
    "platform_motion",
    "rule_table",
]
