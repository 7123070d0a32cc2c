"""Predictions are judged by legs that move: readings of one at rest are noise, or steps of an encoder."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from hexservo.findings.identification.drives import fit_drives
from hexservo.findings.identification.log import FITTED, Log, leg_moves, predicted_share, reading_noise
from hexservo.scenario.leg_units import LegUnits
from recorded_machines import Drive, record, wandering

Array = NDArray[np.float64]

METRES, SEED, TICKS, PERIOD, NOISE = LegUnits("m", "N"), 20283, 400, 0.01, 2e-5
FIRST = int(FITTED * TICKS)


def log_of(held: bool, resolution: float = 0.0) -> tuple[Log, Array]:
    """A log whose third leg is held from the last 30 % on, where the commands jump on, and its coordinates."""
    random = np.random.default_rng(SEED)
    commands = 0.2 + wandering(random, TICKS, PERIOD, 1e-3, 0.3)
    log = record(commands, PERIOD, [Drive(5.0, 0.9)] * 6, 0.0, random)
    true = log.joints.copy()
    if held:
        true[FIRST - 20 :, 2] = true[FIRST - 21, 2]
    joints = true + random.normal(0.0, NOISE, true.shape)
    return replace(log, joints=np.round(joints / resolution) * resolution if resolution else joints), true


@pytest.mark.parametrize("resolution", [0.0, 1e-4])
def test_the_true_motion_of_a_held_leg_is_not_judged_by_its_noise(resolution: float) -> None:
    log, true = log_of(held=True, resolution=resolution)
    apart = slice(FIRST, None)
    shares = [predicted_share(log.commands[:, leg], log.joints[:, leg], true[apart, leg], apart) for leg in range(6)]
    assert shares[2] is None
    assert all(share is not None and share > 0.96 for leg, share in enumerate(shares) if leg != 2)
    by_noise = 1.0 - np.mean((log.joints[apart, 2] - true[apart, 2]) ** 2) / (
        float(np.var(log.joints[apart, 2])) + 1e-30
    )
    assert by_noise < 0.5  # the model is the truth


def test_a_leg_that_moves_by_less_than_its_prediction_misses_is_judged() -> None:
    """The wrong sign is no noise."""
    log, true = log_of(held=False)
    apart = slice(FIRST, None)
    share = predicted_share(log.commands[:, 2], log.joints[:, 2], 0.4 - true[apart, 2], apart)
    assert share is not None
    assert share < 0.0


def test_a_leg_with_noise_alone_does_not_move() -> None:
    log, _ = log_of(held=False)
    still = np.random.default_rng(SEED).normal(0.2, NOISE, TICKS)
    assert reading_noise(still) == pytest.approx(NOISE, rel=0.2)
    assert leg_moves(log.commands[:, 0], log.joints[:, 0], slice(None))
    assert not leg_moves(log.commands[:, 0], still, slice(None))


def test_legs_that_are_not_judged_are_named() -> None:
    log, _ = log_of(held=True)
    found = fit_drives(log, METRES, delays=(0,))
    assert found.fits[2].explained is None
    assert found.explains
    (sentence,) = (words for words in found.section().sentences if "No prediction is judged" in words)
    assert "leg 3," in sentence
