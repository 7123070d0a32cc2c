"""Friction from a log: how far from their commands legs rest, on drives with Coulomb friction outside of the core."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from hexservo.findings.identification.drives import fit_drives
from hexservo.findings.identification.log import Log
from hexservo.findings.identification.rests import find_rests, with_friction
from hexservo.scenario.leg_units import LegUnits
from recorded_machines import Drive, wandering

Array = NDArray[np.float64]
SEED = 20270402
PERIOD = 0.01
METRES = LegUnits("m", "N")
FINE = 40  # steps in a tick


def sticking(commands: Array, bandwidth: Array, damping: Array, edge: Array) -> Array:
    """Return coordinates (n, m) of m legs with Coulomb friction f = w^2 edge, read before the command of the tick.

    While a leg moves in one direction its motion is linear, and a step is exact. One in whose course it would turn
    around begins at rest, and a leg at rest stays while the drive pulls by less than the friction.
    """
    w, h = 2 * np.pi * bandwidth, PERIOD / FINE
    phi = np.stack([expm(h * np.array([[0.0, 1.0], [-a * a, -2 * z * a]])) for a, z in zip(w, damping, strict=True)])
    (to_place, by_rate), (of_place, of_rate) = phi.transpose(1, 2, 0)
    q, v = commands[0].copy(), np.zeros_like(commands[0])
    out = np.empty_like(commands)
    for tick, command in enumerate(commands):
        out[tick] = q
        for _ in range(FINE):
            for _again in range(2):
                away = command - q
                pulled = np.where(np.abs(away) > edge, np.sign(away), 0.0)
                direction = np.where(v != 0.0, np.sign(v), pulled)
                goal = np.where(direction != 0.0, command - edge * direction, q)
                away, before = q - goal, v
                rate = of_place * away + of_rate * v
                goes_on = rate * direction > 0.0
                v = np.where(goes_on, v, 0.0)  # it turns around in this step: from rest, then
                if np.array_equal(v, before):
                    break
            q, v = goal + (to_place * away + by_rate * v), np.where(goes_on, rate, 0.0)
    return out


def drives(
    legs: int, damping: tuple[float, float], hold: float = 1.2, ticks: int = 2400
) -> tuple[Array, Array, Array, Array]:
    """Commands and coordinates (n, m), edges of the friction (m,), and what the drives without friction do (n, m)."""
    random = np.random.default_rng(SEED)
    print(f"seed {SEED}")
    commands = 0.2 + np.hstack([wandering(random, ticks, PERIOD, 1e-3, hold) for _ in range(legs // 6)])
    bandwidth, zeta = random.uniform(4.0, 8.0, legs), random.uniform(*damping, legs)
    edge = random.uniform(2e-5, 3e-4, legs)
    joints = sticking(commands, bandwidth, zeta, edge) + random.normal(0.0, 2e-6, commands.shape)
    free = [Drive(bandwidth[leg], zeta[leg]).follow(commands[:, leg], PERIOD) for leg in range(legs)]
    return commands, joints, edge, np.stack(free, axis=1)


@pytest.mark.slow
def test_legs_without_overshoot_rest_at_the_edge_of_their_friction() -> None:
    """The stated intervals contain f/w^2 in at least 90 % of legs."""
    commands, joints, edge, _ = drives(120, (1.0, 1.4))
    hits, widths = [], []
    for leg in range(120):
        rests = find_rests(commands[:, leg], joints[:, leg])
        assert rests is not None
        hits.append(rests.short.low <= edge[leg] <= rests.short.high)
        widths.append((rests.short.high - rests.short.low) / edge[leg])
    print(f"{sum(hits)} of {len(hits)} intervals contain the edge; median width {np.median(widths):.3f} of it")
    assert np.mean(hits) >= 0.9
    assert np.median(widths) < 0.5


@pytest.mark.parametrize("count", [12, pytest.param(60, marks=pytest.mark.slow)])
def test_legs_that_overshoot_rest_within_their_friction(count: int) -> None:
    commands, joints, edge, _ = drives(count, (0.4, 0.8))
    for leg in range(count):
        rests = find_rests(commands[:, leg], joints[:, leg])
        assert rests is not None
        assert abs(rests.short.value) <= edge[leg] + 2e-6
        # `same` is estimated, and differs from 0 by a part of the edge where the rests are few
        assert 0.3 * edge[leg] < rests.farthest < 2.0 * edge[leg]


@pytest.mark.slow
def test_legs_without_friction_rest_on_their_commands() -> None:
    """Intervals contain 0 in at least 90 %. Steps of an encoder are no friction, and a weight is none."""
    commands, _, _, free = drives(120, (0.6, 1.2))
    random = np.random.default_rng(SEED + 1)
    noisy = free + random.normal(0.0, 2e-6, free.shape)
    sagging = noisy - 5e-5
    resolution = 2e-5
    counted = np.round(free / resolution) * resolution
    hits = []
    for leg in range(120):
        for joints in (noisy, sagging):
            rests = find_rests(commands[:, leg], joints[:, leg])
            assert rests is not None
            hits.append(rests.short.low <= 0.0 <= rests.short.high)
        rests = find_rests(commands[:, leg], counted[:, leg])
        assert rests is not None
        assert abs(rests.short.value) <= resolution / 2
        assert rests.farthest <= resolution
    print(f"{sum(hits)} of {len(hits)} intervals contain 0")
    assert np.mean(hits) >= 0.9


def test_a_leg_that_still_creeps_shows_no_friction() -> None:
    """A lag of 90 ms and jumps each second: exp(-t/tau) is left of each, on the side that the leg comes from."""
    commands = np.tile(np.repeat([0.0, 1e-3], 100), 8)
    joints = np.zeros(len(commands))
    for tick in range(1, len(commands)):
        joints[tick] = commands[tick - 1] + (joints[tick - 1] - commands[tick - 1]) * np.exp(-PERIOD / 0.09)
    rests = find_rests(commands, joints)
    assert rests is not None
    left = 1e-3 * np.exp(-np.arange(75, 100) * PERIOD / 0.09).mean()  # in the last quarter
    assert rests.short.value == pytest.approx(left, rel=1e-3)
    assert rests.short.low < 0.0
    assert (with_friction(commands, joints, rests) == commands).all()


def test_a_log_without_rests_does_not_show_friction() -> None:
    time = PERIOD * np.arange(1000)
    commands = 1e-3 * np.sin(2 * np.pi * time)
    assert find_rests(commands, commands) is None
    commands, joints, _, _ = drives(6, (1.0, 1.4), hold=0.05, ticks=500)  # it never arrives
    assert find_rests(commands[:, 0], joints[:, 0]) is None
    assert find_rests(np.zeros(100), np.zeros(100)) is None


METRES = LegUnits("m", "N")


def log_of(seed: int) -> tuple[Log, Array, Array]:
    """A log of a machine with friction in its drives, their bandwidths and dampings."""
    random = np.random.default_rng(seed)
    commands = 0.2 + wandering(random, 1500, PERIOD, 1e-3, 1.0)
    bandwidth, damping, edge = random.uniform(4, 8, 6), random.uniform(1.0, 1.4, 6), random.uniform(2e-5, 3e-4, 6)
    joints = sticking(commands, bandwidth, damping, edge) + random.normal(0, 2e-6, commands.shape)
    return Log(np.asarray(PERIOD * np.arange(1500)), PERIOD, commands, joints, None), bandwidth, damping


@pytest.mark.slow
def test_friction_no_longer_bends_the_response(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bandwidths and dampings are found to 1 %, and the part kept apart is predicted; without friction they are not."""
    log, bandwidth, damping = log_of(101)
    found = fit_drives(log, METRES, delays=(0, 1))
    for leg, fit in enumerate(found.fits):
        assert fit.rests is not None
        assert fit.bandwidth is not None
        assert fit.damping is not None
        assert fit.bandwidth.value == pytest.approx(bandwidth[leg], rel=0.01)
        assert fit.damping.value == pytest.approx(damping[leg], rel=0.01)
        assert fit.explained is not None
        assert fit.explained > 0.998
    (sentence,) = (words for words in found.section().sentences if "as friction leaves it" in words)
    assert "mm short of its command" in sentence
    monkeypatch.setattr("hexservo.findings.identification.drives.with_friction", lambda commands, *_: commands)
    bent = fit_drives(log, METRES, delays=(0, 1))
    assert max(abs(fit.bandwidth.value / bandwidth[fit.leg - 1] - 1) for fit in bent.fits if fit.bandwidth) > 0.1
    assert min(fit.explained for fit in bent.fits if fit.explained is not None) < 0.99


@pytest.mark.slow
def test_intervals_of_drives_with_friction_contain_the_true_values() -> None:
    hits = []
    for seed in range(200, 210):
        log, bandwidth, damping = log_of(seed)
        for leg, fit in enumerate(fit_drives(log, METRES).fits):
            if fit.rests is not None and fit.bandwidth is not None and fit.damping is not None:
                hits.append(fit.bandwidth.low <= bandwidth[leg] <= fit.bandwidth.high)
                hits.append(fit.damping.low <= damping[leg] <= fit.damping.high)
    print(f"{sum(hits)} of {len(hits)} intervals contain the true value")
    assert len(hits) > 100
    assert np.mean(hits) >= 0.9
