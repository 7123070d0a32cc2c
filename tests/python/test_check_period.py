"""Warnings about the servo period, by runs with shorter ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.check import known_rate, unlikely

COARSE = "simulation.step: a servo period of"


def settling(name: str, law: str, share: float) -> tuple[float, list[str]]:
    """Return the settling time [s] of a law with a servo period that is a share of its time constant, and what of it.

    The image is that of every tick.
    """
    scenario = hs.load_scenario(name, {"controller.law": law, "simulation.mode": "sampled"})
    rate = known_rate(scenario)
    assert rate is not None
    period = float(f"{share / rate:.4g}")
    changes: dict[str, Any] = {
        "camera": {"period": period, "latency": 0.0},
        "simulation": {"step": period, "duration": round(4.0 / period) * period, "substeps": 1 + int(20.0 * share)},
    }
    sampled = scenario.updated(changes)
    run = hs.simulate(sampled)
    assert run.outcome == "completed"
    return hs.metrics(run)["settling_time"], [words for words in unlikely(sampled) if words.startswith(COARSE)]


@pytest.mark.parametrize("law", ["composite", "pbvs", "resolved_rate", "computed_torque"])
def test_a_fifth_of_the_time_constant_is_short_enough_for_laws_with_viscous_damping(law: str) -> None:
    """Without a sentence a run settles within a fifth of the time of one with a fiftieth."""
    fine, none = settling("paper", law, 0.02)
    near, unnamed = settling("paper", law, 0.19)
    _, (named,) = settling("paper", law, 0.21)
    assert none == unnamed == []
    assert near == pytest.approx(fine, rel=0.2)
    assert "coarser than a fifth of the gains' shortest time constant" in named


def test_from_a_third_on_a_law_may_settle_far_later() -> None:
    fine, _ = settling("paper", "composite", 0.02)
    coarse, (named,) = settling("paper", "composite", 0.33)
    assert named
    assert coarse > 2.0 * fine


def test_friction_and_adaptation_alone_need_a_tenth() -> None:
    """`hybrid` has no viscous damping: what a fifth leaves of it settles in more than 1.4 times the time."""
    fine, unnamed = settling("paper", "hybrid", 0.09)
    coarse, (named,) = settling("paper", "hybrid", 0.2)
    assert unnamed == []
    assert "coarser than a tenth of the gains' shortest time constant" in named
    assert np.isfinite(coarse)
    assert coarse > 1.4 * fine
