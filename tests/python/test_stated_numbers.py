"""Numbers that analyses, certificates and campaigns state, against closed forms and runs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.campaigns.distributions import Variation
from hexservo.campaigns.plan import load_plan
from hexservo.campaigns.rare import Levels, RareFailures, _correlation
from hexservo.campaigns.requirements import ranks_of
from hexservo.findings.analysis import equilibria
from hexservo.findings.analysis.camera_margins import loop_margins
from hexservo.findings.analysis.linear_loop import Clock
from hexservo.findings.analysis.loop_of_scenario import loop_at_rest
from hexservo.findings.certificate.lyapunov import lyapunov_of
from hexservo.findings.certificate.replay import Plant, replay
from hexservo.findings.certificate.uncertainty import assumption_of, uncertainty_of
from test_analysis_camera_rate import one_axis
from test_analysis_equilibria import on_the_axis
from test_certificate_energy import tumbling

# ---- Analyses -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("period", [1, 20])
def test_the_spectral_radius_is_over_one_camera_period(period: int) -> None:
    """It is the largest multiplier of a period, and exp(Re lambda P T) of the continuous loop with short delays."""
    stiffness, damping, tick = 100.0, 30.0, 1e-4
    loop = one_axis(stiffness, damping, tick)
    clock = Clock(period, 0)
    found = loop_margins(loop, clock, borders=False)
    assert found.radius == pytest.approx(np.abs(loop.multipliers(clock)).max(), rel=1e-9)
    slowest = np.roots([1.0, damping, stiffness]).real.max()
    assert math.log(found.radius) / (period * tick) == pytest.approx(slowest, rel=2e-3 * period)


@pytest.mark.parametrize("error", [-0.3, 0.0, 0.3])
def test_the_stiffness_at_the_goal_is_that_of_the_image_whatever_the_inertia_is_thought_to_be(error: float) -> None:
    """On the axis 8 K_p (h/Z)^2: a force per shift, though it is computed from accelerations."""
    found = equilibria.analyse(on_the_axis(0.01).updated({"uncertainty.inertia": error}))
    assert found.gravity_stiffness == pytest.approx(8 * 1e-4 * (120 / 0.15) ** 2, rel=1e-6)


@pytest.mark.parametrize("leakage", [0.0, 0.2])
def test_the_loop_rests_where_a_run_without_noise_ends(leakage: float) -> None:
    """Without K_v and an error of the weight, of which rest has none; with leakage fuzzy systems hold less."""
    changes = {"controller.composite.fuzzy.leakage": leakage, "uncertainty.gravity": 0.0}
    scenario = hs.load_scenario("slow-camera").updated(changes)
    devices = ("camera.noise", "camera.quantisation", "camera.dropout", "sensors.noise", "sensors.resolution")
    calm: dict[str, Any] = dict.fromkeys(devices, 0.0)
    calm |= {"controller.composite.kv": 0.0, "simulation.duration": 16.0}
    run = hs.simulate(scenario.updated(calm))
    residual = loop_at_rest(scenario).rest.residual
    assert residual > 0.0
    assert residual == pytest.approx(np.abs(run.feature_error[-1]).max(), rel=1e-6)


# ---- Certificates ---------------------------------------------------------------------------------------------------


def test_gyroscopic_work_is_of_the_rotation(paper: hs.Scenario) -> None:
    """Body and errors couple no force with a rotation: C and dD/dt have entries of the rotation alone."""
    inertia = np.zeros((6, 6))
    inertia[3:, 3:] = np.diag([0.1, -0.1, 0.05])
    coriolis = np.zeros((6, 6))
    coriolis[3, 4] = coriolis[4, 5] = 0.3
    _, ledger = tumbling(paper, inertia=inertia.tolist(), coriolis=coriolis.tolist())
    by_axis, whole = ledger.by_axis["coriolis"], float(ledger.works["coriolis"].sum())
    assert abs(whole) > 1e-3 * ledger.energy[-1]
    np.testing.assert_allclose(by_axis[:3], 0.0, rtol=0, atol=1e-9 * abs(whole))
    assert by_axis[3:].sum() == pytest.approx(whole, rel=1e-9)


def test_rises_are_put_down_to_the_largest_power_of_their_axis(paper: hs.Scenario) -> None:
    """By hand gamma = Delta-tau - tau_f*: what the best weights' output adds is (gamma - Delta-tau) times the rate."""
    run = replay(hs.simulate(paper.updated({"simulation.duration": 1.0})))
    found = uncertainty_of(run, Plant.of(run))
    assumption = assumption_of(run, found)
    rises = lyapunov_of(run, found, assumption).rises
    output = found.total - assumption.gamma
    by_output = [rise for rise in rises if rise.term.startswith("best weights' output")]
    assert by_output
    for rise in rises:
        near = np.flatnonzero((run.time >= rise.first) & (run.time <= rise.last))
        (at,) = near[assumption.gamma[near, rise.axis] == rise.gamma]
        rate = run.twist[at, rise.axis]
        powers = {name: rate * part[at, rise.axis] for name, part in found.parts.items()}
        powers["output"] = -rate * output[at, rise.axis]
        assert sum(powers.values()) == pytest.approx(rate * rise.gamma, abs=1e-9 * max(map(abs, powers.values())))
        assert rise.power >= max(powers.values())
        if rise in by_output:
            assert rise.power == powers["output"]


# ---- Campaigns ------------------------------------------------------------------------------------------------------


def test_chains_that_never_move_count_as_one_run_each() -> None:
    """Each of L states equals the first: 1 + gamma = L, so that L states have the variance of one."""
    for length in (2, 5, 10):
        inside = np.tile([True, False, False, True], (length, 1))
        assert _correlation(inside) == pytest.approx(length - 1, rel=1e-12)


def test_the_variation_of_two_repetitions_is_half_their_difference_over_the_mean() -> None:
    """The standard error of the mean of a and b is |a - b|/2."""
    plan = load_plan({"scenario": "slow-camera", "vary": {"seed": "each"}, "require": ["final_error <= 1"], "runs": 2})
    levels = tuple(Levels(each, 0.1, (1.0, -1.0), 100) for each in (0.001, 0.003))
    assert RareFailures(plan, levels, 0).variation == pytest.approx(0.5, rel=1e-12)


def test_runs_of_one_smallest_margin_are_ordered_by_what_else_they_miss() -> None:
    """Room of another bound makes up for nothing."""
    margins = np.array([[-1.0, -0.2, 5.0], [-1.0, -0.1, 0.0], [-1.0, 0.3, 9.0], [0.5, 0.1, 2.0]])
    np.testing.assert_allclose(ranks_of(margins), [[-1.0, -1.2], [-1.0, -1.1], [-1.0, -1.0], [0.1, 0.0]], rtol=1e-15)


def test_a_choice_has_its_place_in_the_middle_of_its_share() -> None:
    kind = Variation("choice", (4.0, 1.0, 2.0))
    np.testing.assert_allclose(kind.share_of(np.array([1.0, 2.0, 4.0])), [1 / 6, 1 / 2, 5 / 6], rtol=1e-15)
    places = np.array([0.1, 0.5, 0.9])
    np.testing.assert_array_equal(kind.in_box(kind.share_of(kind.in_box(places))), kind.in_box(places))
