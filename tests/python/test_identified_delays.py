"""Delays between whole ticks and zeros of encoders, found from logs of drives by SciPy."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import cont2discrete

import hexservo as hs
from hexservo.findings.identification.changes import changes_of
from hexservo.findings.identification.drive_models import LegRecord
from hexservo.findings.identification.drives import Drives, fit_drives
from hexservo.findings.identification.log import Log
from hexservo.scenario.leg_units import LegUnits
from recorded_machines import wandering
from test_identification import within

Array = NDArray[np.float64]

METRES = LegUnits("m", "N")
SEED, TICK, BANDWIDTH, DAMPING = 20281, 0.02, 8.0, 0.9
NOISE, PARTS = 5e-6, 20


def response(commands: Array, delay: float, damping: float = DAMPING) -> Array:
    """Coordinates (n, m) of drives that get their commands (n, m) a multiple of 1/20 of a tick late, read before it."""
    late = round(delay * PARTS)
    fine = np.concatenate([np.repeat(commands[:1], late, axis=0), np.repeat(commands, PARTS, axis=0)])
    w = 2 * np.pi * BANDWIDTH
    a, b = np.array([[0.0, 1.0], [-w * w, -2 * damping * w]]), np.array([[0.0], [w * w]])
    after, by, *_ = cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), TICK / PARTS)
    state, out = np.stack([commands[0], np.zeros_like(commands[0])]), []
    for command in fine[: PARTS * len(commands)]:
        out.append(state[0])
        state = after @ state + by * command
    return np.array(out)[::PARTS]


def log_of(delay: float, offset: float = 0.0, noise: float = NOISE, ticks: int = 300) -> Log:
    random = np.random.default_rng(SEED)
    commands = 0.2 + wandering(random, ticks, TICK, 1e-3, 0.4)
    offsets = offset * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 0.5])
    joints = response(commands, delay) + offsets + random.normal(0.0, noise, commands.shape)
    return Log(np.asarray(TICK * np.arange(ticks)), TICK, commands, joints, None)


def fitted(log: Log) -> Drives:
    return fit_drives(log, METRES, delays=(1, 2))


@cache
def fitted_to(delay: float) -> tuple[Log, Drives]:
    log = log_of(delay)
    return log, fitted(log)


@pytest.mark.parametrize("delay", [0.0, 0.35, 1.0, 1.5, 2.85])
@pytest.mark.parametrize("damping", [0.4, 0.9, 2.0])
def test_a_response_with_any_delay_is_scipy_s(delay: float, damping: float) -> None:
    """To 1e-5 of the jumps: a pole of 30 Hz, of 8 Hz with damping 2, is followed to less between parts of 2.5 ms."""
    commands = 0.2 + wandering(np.random.default_rng(SEED), 200, TICK, 1e-3, 0.2)[:, :1]
    record = LegRecord(commands[:, 0], commands[:, 0], TICK, 140, np.ones(len(commands), dtype=bool))
    first = commands[0, 0]
    values = np.array([BANDWIDTH, damping, np.inf, np.inf, first, 0.0, first, 0.0, delay])
    true = response(commands, delay, damping)[:, 0]
    for base in {int(np.floor(delay)), int(np.ceil(delay))}:
        np.testing.assert_allclose(record.response(values, base), true, rtol=0, atol=1e-8)
        between = record.response(values, base, finer=3)
        np.testing.assert_allclose(between[::3], true, rtol=0, atol=1e-8)
        shifted = values.copy()
        shifted[-1] += 2.0 / 3.0  # later by two of three steps
        if abs(shifted[-1] - base) <= 1.0:
            np.testing.assert_allclose(record.response(shifted, base)[1:], between[1::3][:-1], rtol=0, atol=1e-8)


@pytest.mark.parametrize("delay", [1.4, 1.7])
def test_a_delay_between_ticks_bends_no_other_value(delay: float) -> None:
    """Of 18 intervals of 95 % at least 14 contain the true values (99.8 %, binomial), and no limit is seen."""
    _, found = fitted_to(delay)
    true = {"bandwidth": BANDWIDTH, "damping": DAMPING, "delay": delay}
    kept = sum(within(getattr(fit, name), value) for fit in found.fits for name, value in true.items())
    print(f"seed {SEED}, delay {delay}: {kept} of 18 intervals contain the true values")
    assert kept >= 14
    for fit in found.fits:
        assert fit.speed_limit is None
        assert fit.acceleration_limit is None
        assert fit.correlated < 1.3
        assert fit.delay is not None
        assert fit.delay.value == pytest.approx(delay, abs=0.02)
        assert fit.bandwidth is not None
        assert fit.bandwidth.value == pytest.approx(BANDWIDTH, rel=0.02)


def test_what_whole_ticks_move_the_response_by_is_stated() -> None:
    """Half a tick off is a warning; a whole delay has no word."""
    (log, late), (_, whole) = fitted_to(1.4), fitted_to(1.0)
    off = np.sqrt(((response(log.commands, 1.0) - response(log.commands, 1.4)) ** 2).mean(axis=0))
    motion = response(log.commands, 1.4).std(axis=0)
    assert (off > 0.05 * motion).all()
    for fit in late.fits:
        assert fit.rounded == pytest.approx(off[fit.leg - 1], rel=0.05)
    section = late.section()
    assert section.verdict == "warning"
    (sentence,) = (words for words in section.sentences if "in whole ones" in words)
    assert "with 1, the response" in sentence
    machine = hs.load_scenario("pi-h824-positions").updated({"actuators.position.speed_limit": None})
    changes = changes_of(log, machine, late, None)
    assert changes["actuators.delay"] == TICK
    assert changes["actuators.position.bandwidth"] == pytest.approx(BANDWIDTH, rel=0.01)
    assert "actuators.position.acceleration_limit" not in changes
    assert whole.section().verdict == "good"
    assert not any("in whole ones" in words for words in whole.section().sentences)


@pytest.mark.parametrize("offset", [6e-5, 7e-4])
def test_the_zeros_of_encoders_do_not_bend_the_response(offset: float) -> None:
    """All numbers are those of the log without offsets, and the offsets are stated."""
    (_, plain), moved = fitted_to(1.0), fitted(log_of(1.0, offset))
    for one, other in zip(plain.fits, moved.fits, strict=True):
        assert one.bandwidth is not None
        assert other.bandwidth is not None
        assert other.bandwidth.value == pytest.approx(one.bandwidth.value, rel=1e-4)
        assert one.offset is not None
        assert other.offset is not None
        share = (1.0, -1.0, 1.0, 1.0, -1.0, 0.5)[one.leg - 1]
        assert other.offset.value - one.offset.value == pytest.approx(share * offset, abs=1e-8)
        assert within(other.offset, share * offset) or abs(other.offset.value - share * offset) < NOISE
    (sentence,) = (words for words in moved.section().sentences if "beyond their commands" in words)
    stated = re.search(r"leg 2 by (-[0-9.]+)", sentence)
    assert stated is not None
    assert float(stated[1]) == pytest.approx(-1e3 * offset, rel=0.05)
    assert not any("beyond their commands" in words for words in plain.section().sentences)


def test_an_offset_that_friction_comes_with_is_the_whole_one() -> None:
    """The commands of a leg with friction are fitted without what its rests have on both sides."""
    log = log_of(1.0, 3e-4, noise=1e-6, ticks=600)
    place, held = log.commands[0].copy(), np.empty_like(log.commands)
    for tick, command in enumerate(log.commands):  # play of the command of 0.1 mm to both sides
        place = np.clip(place, command - 1e-4, command + 1e-4)
        held[tick] = place
    joints = log.joints - response(log.commands, 1.0) + response(held, 1.0)
    found = fitted(replace(log, joints=joints))
    for fit in found.fits:
        assert fit.rests is not None
        assert fit.rests.short.low > 0.0
        assert fit.offset is not None
        assert fit.offset.value == pytest.approx(3e-4 * (1.0, -1.0, 1.0, 1.0, -1.0, 0.5)[fit.leg - 1], abs=2e-6)
