"""How much feedback and integral of their readings legs bear (docs/model.md, section 5): closed forms and runs."""

from __future__ import annotations

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.check import unlikely
from test_tracking import TICK, head


@pytest.mark.parametrize(("bandwidth", "damping"), [(1e-3, 1.88), (1e-4, 1.0001), (1e-4, 10.0)])
def test_the_margin_of_legs_far_slower_than_the_servo_is_that_of_their_lags(bandwidth: float, damping: float) -> None:
    """By Routh, with the dead time of delay and hold as one more lag: a1 (a2 a3 - a1 a4) = a3^2 (1 + k)."""
    w, dead = 2.0 * np.pi * bandwidth, 1.5 * TICK
    lag = np.sqrt(max(damping**2 - 1.0, 0.0)) / w
    polynomial = np.polymul(np.polymul([1.0 / w**2, 2.0 * damping / w, 1.0], [lag, 1.0]), [dead, 1.0])
    a4, a3, a2, a1, _ = polynomial
    expected = a1 * (a2 * a3 - a1 * a4) / a3**2 - 1.0
    legs = {"actuators.delay": TICK, "actuators.position": {"bandwidth": bandwidth, "damping": damping}}
    margin = hs.feedback_margin(head(0.0).updated(legs))
    print(f"{margin:.6g}, expected {expected:.6g}")
    assert margin == pytest.approx(expected, rel=2e-3)


def test_legs_that_hardly_move_are_checked() -> None:
    slow = head(0.0, gains={"feedback": 0.1}).updated({"actuators.position": {"bandwidth": 1e-3, "damping": 2.0}})
    assert not [words for words in unlikely(slow) if words.startswith("controller.tracking.feedback")]
