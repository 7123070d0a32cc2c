"""Drift with an image that is late, by its age or by the lag of legs that take positions: closed forms and runs."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

import hexservo as hs
from hexservo.findings.analysis import drift
from hexservo.findings.analysis.camera_margins import loop_margins
from hexservo.findings.analysis.camera_rate import clock_of_loop
from hexservo.findings.analysis.drift import Drift
from hexservo.findings.analysis.drift_loop import loop_under_errors
from hexservo.findings.analysis.drift_patterns import Pattern
from hexservo.findings.analysis.drift_rates import Lateness, exponential, late_rates
from hexservo.findings.analysis.loop_of_scenario import at_rest_at_home, loop_at_rest
from hexservo.findings.analysis.scene import ALL_AXES, scene_of

GAIN = 4.0


def slowest(eigenvalue: float, mean: float, hold: float) -> complex:
    """Rate of chi' = -GAIN (chi + (E - 1) u)."""
    moved, held = GAIN * np.eye(6)[None], GAIN * (eigenvalue - 1.0) * np.eye(6)[None]
    rates = late_rates(moved, held, Lateness(mean, hold, ""))[0]
    return complex(rates[rates.real.argmin()])


@pytest.mark.parametrize("eigenvalue", [3.0, 9.0])
def test_the_border_of_a_pure_delay(eigenvalue: float) -> None:
    """g tau = arccos(-1/k)/sqrt(k^2 - 1); images taken together are within 4 %, 1 % for large k."""
    k = eigenvalue - 1.0
    pace = GAIN * math.sqrt(k**2 - 1.0)
    border = math.acos(-1.0 / k) / pace
    assert slowest(eigenvalue, 0.96 * border, 1e-4).real > 0.0
    late = slowest(eigenvalue, 1.04 * border, 1e-4)
    assert late.real < 0.0
    assert abs(late.imag) == pytest.approx(pace, rel=0.05)


def test_no_delay_is_too_long_for_an_eigenvalue_below_two() -> None:
    assert slowest(1.9, 100.0, 0.1).real > 0.0


def test_the_border_of_images_that_are_held() -> None:
    """Used at once and held for P: exp(-g P) (1 + k) - k = -1; used a period later: k (1 - exp(-g P)) = 1."""
    k = 8.0
    at_once, later = math.log((k + 1.0) / (k - 1.0)) / GAIN, -math.log(1.0 - 1.0 / k) / GAIN
    for border, mean in ((at_once, 0.5), (later, 1.5)):
        for factor in (0.999, 1.001):
            period = factor * border
            assert (slowest(k + 1.0, mean * period, period).real > 0.0) == (factor < 1.0)


def test_creep_is_as_slow_as_a_late_image_makes_it() -> None:
    """g E/(1 + g tau (1 - E)), to the second order of the rate times tau: 0.09 * 0.3."""
    assert slowest(0.02, 0.3, 0.1).real == pytest.approx(0.08 / (1.0 + 1.2 * 0.98), rel=0.01)


def test_the_linear_loop_at_the_own_errors_serves_camera_rate_too() -> None:
    scenario = hs.load_scenario("slow-camera")
    loop_at_rest.cache_clear()
    assert hs.analyse(scenario, ["drift"]).drift.loop is not None
    assert loop_at_rest.cache_info().hits == 0
    assert hs.analyse(scenario, ["camera_rate"]).camera_rate.open is None
    assert loop_at_rest.cache_info().hits == 1


def test_growth_too_fast_for_images_is_that_without_them() -> None:
    moved = np.diag([-1e6, 1.0, 1.0, 1.0, 1.0, 1.0])[None]
    rates = late_rates(moved, np.ones((1, 6, 6)), Lateness(0.1, 0.1, ""))
    assert rates.real.min() == pytest.approx(-1e6)


@pytest.mark.parametrize("growth", [0.5, 5.0, 25.0])
def test_an_image_matters_however_fast_the_pose_grows_before_the_next(growth: float) -> None:
    """y' = a y - h u with u = y at each exposure, used at once: y grows by e^(a T) - h/a (e^(a T) - 1) in T."""
    hold, share = 0.1, 0.5  # T, and h/a
    a = growth / hold
    late = Lateness(0.5 * hold, hold, "")
    rates = late_rates(-a * np.eye(6)[None], share * a * np.eye(6)[None], late)[0]
    expected = math.log(math.exp(growth) - share * math.expm1(growth)) / hold
    assert -rates.real.min() == pytest.approx(expected, rel=1e-9)


def test_exponentials_are_those_of_scipy() -> None:
    matrices = np.random.default_rng(1).normal(size=(3, 8, 8)) * np.array([0.01, 1.0, 5.0])[:, None, None]
    for mine, theirs in zip(exponential(matrices), (expm(matrix) for matrix in matrices), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=0.0, atol=1e-11 * np.abs(theirs).max())
    assert (exponential(np.zeros((2, 3, 3))) == np.eye(3)).all()


# ---- Legs that take positions ---------------------------------------------------------------------------------------


def at_home(depth: list[float], times: float, bandwidth: float, prediction: str = "encoder") -> hs.Scenario:
    """The goal is home; period and latency of the camera are `times`."""
    scenario = hs.load_scenario("pi-h824-positions")
    return scenario.updated(
        {
            "controller": {"law": "resolved_rate", "resolved_rate": {"gain": GAIN}},
            "camera": {"prediction": prediction, "latency": times, "period": times, "noise": 0.0},
            "sensors.resolution": 0.0,
            "uncertainty.depth": depth,
            "target.desired_features": np.array(hs.project(scenario, np.zeros(6))).ravel().tolist(),
            "actuators": {"delay": 0.02, "position": {"bandwidth": bandwidth, "speed_limit": None}},
        }
    )


def own_of(found: Drift) -> Pattern:
    assert found.own is not None
    return found.own


def distances(scenario: hs.Scenario, start: np.ndarray, duration: float) -> np.ndarray:
    """Return how far the platform is from home [m], at every tick."""
    run = hs.simulate(scenario.updated({"simulation.start.pose": start.tolist(), "simulation.duration": duration}))
    assert run.outcome == "completed"
    return np.asarray(np.linalg.norm(run.position - np.array(scenario.robot.home_position), axis=1))


@pytest.mark.parametrize(
    ("bandwidth", "prediction"), [(10.0, "encoder"), (3.0, "encoder"), (1.0, "encoder"), (1.0, "none")]
)
def test_a_run_drifts_away_as_slowly_as_its_legs_lag(bandwidth: float, prediction: str) -> None:
    """Growth over 8 s after 6 s. Along the drift E, P and the pose change with the distance, 20 to 160 um."""
    scenario = at_home([-0.3, -0.3, 0.3, -0.3], 0.02, bandwidth, prediction)
    own = own_of(drift.analyse(scenario))
    gone = distances(scenario, own.direction * 2e-5 / np.linalg.norm(own.direction[:3]), 14.0)
    ticks = round(8.0 / scenario.simulation.step)
    assert math.log(gone[-1] / gone[-1 - ticks]) / 8.0 == pytest.approx(-own.rate, rel=0.02)
    assert own.frequency == 0.0


def test_depth_errors_of_one_per_cent_oscillate_with_a_late_image() -> None:
    """E is 9 at 0.9 %; the border that is found, 0.747 %, is that of runs to 3 %."""
    signs = np.array([1.0, -1.0, 1.0, -1.0])
    start = np.array([2e-5, 2e-5, 0.0, -5e-5, 5e-5, 0.0])
    found = drift.analyse(at_home((0.009 * signs).tolist(), 0.1, 10.0))
    assert found.limit_start is not None
    assert found.limit_start == pytest.approx(0.00747, rel=0.01)
    for share in (0.97, 1.03):
        scenario = at_home((share * found.limit_start * signs).tolist(), 0.1, 10.0)
        gone = distances(scenario, start, 12.0)
        ticks = round(1.0 / scenario.simulation.step)
        grows = gone[-ticks:].max() > gone[len(gone) // 2 :][:ticks].max()
        assert grows == (share > 1.0) == (own_of(drift.analyse(scenario)).rate < 0.0)
    section = found.section()
    assert section.verdict == "bad"
    assert min(own_of(found).start, own_of(found).goal) > 0.5
    assert "oscillates at 2.0" in section.sentences[1]
    assert any("drifts away or oscillates" in text for text in section.sentences)
    fresh = [replace(pattern, late_alone=False) for pattern in found.sizes[0].patterns]
    without = replace(found, own=fresh[0], sizes=(replace(found.sizes[0], patterns=tuple(fresh)),))
    for each, stated in ((found, True), (without, False)):
        assert any("with a late image" in text for text in each.section().sentences) == stated


def test_a_law_of_a_filtered_pose_has_no_drift_of_any_target() -> None:
    """Four points or five: the reason is the law."""
    scenario = hs.load_scenario("pi-h824-positions")
    points = scenario.target.points
    assert points is not None
    added = [*points, np.mean(points, axis=0).tolist()]
    five = scenario.updated({"target": {"points": added, "desired_features": None, "desired_pose": [0.0] * 6}})
    reasons = {drift.analyse(each).open_because for each in (scenario, five)}
    assert len(reasons) == 1
    assert "filters" in reasons.pop()


# ---- What a late image alone does ------------------------------------------------------------------------------------


def worst_of(name: str, signs: list[float]) -> tuple[Pattern, Pattern]:
    """Return exact depths, and errors of 30 %."""
    exact, worst = drift._Worker(hs.load_scenario(name)).patterns(np.array([[0.0] * 4, [0.3 * sign for sign in signs]]))
    return exact, worst


def test_a_complex_rate_of_a_pose_error_that_decays_is_no_frequency() -> None:
    """`pi-h824`: those of exact depths are 5 +- 2.5i 1/s; the worst pattern has E = -0.02 and no eigenvalue above 1."""
    exact, worst = worst_of("pi-h824", [1.0, -1.0, 1.0, -1.0])
    assert exact.slowest > 0.0 > worst.slowest
    assert exact.frequency == worst.frequency == 0.0
    assert not exact.late_alone
    assert not worst.late_alone


def test_growth_that_a_fresh_image_has_too_is_not_that_of_a_late_one() -> None:
    """`eye-to-hand`: E = -0.001 +- 0.019i of the worst pattern oscillates without prediction as well."""
    _, worst = worst_of("eye-to-hand", [-1.0, 1.0, 1.0, -1.0])
    assert worst.slowest < 0.0 < worst.frequency
    assert not worst.late_alone


def test_depth_errors_of_one_per_cent_grow_by_a_late_image_alone() -> None:
    errors = np.array([[0.009, -0.009, 0.009, -0.009], [0.3, 0.3, -0.3, 0.3]])
    large, negative = drift._Worker(at_home([0.0] * 4, 0.1, 10.0)).patterns(errors)
    assert large.slowest < 0.0
    assert negative.slowest < 0.0
    assert large.late_alone
    assert not negative.late_alone


# ---- Legs that take forces: the linear loop decides ------------------------------------------------------------------

SIGNS = np.array([1.0, -1.0, 1.0, -1.0])
FORCES = {"controller.law": "resolved_rate", "camera.period": 0.1, "camera.latency": 0.1, "sensors.resolution": 0.0}


def with_forces(size: float) -> hs.Scenario:
    """Its written gains have a mode of 0.25 Hz that decays at 0.12 1/s: not fast beside rates of 2 1/s."""
    return hs.load_scenario("pi-h824").updated({**FORCES, "uncertainty.depth": (size * SIGNS).tolist()})


@pytest.mark.slow
def test_a_loop_that_is_no_faster_than_the_drift_decides() -> None:
    """All rates are positive up to 0.61 %, and runs oscillate away beyond 0.40 %."""
    found = drift.analyse(with_forces(0.005))
    assert found.loop is not None
    assert found.loop.limit is not None
    assert found.limit_start is not None
    assert own_of(found).slowest > 0.0
    assert own_of(found).errors.max() < found.limit_start
    section = found.section()
    assert section.verdict == "bad"
    assert not any("drifts away or oscillates" in text for text in section.sentences)
    assert sum("camera_rate" in text for text in section.sentences) == 2
    for share in (0.92, 1.08):
        scenario = with_forces(share * found.loop.limit)
        home = np.array(hs.project(scenario, np.zeros(6))).ravel().tolist()
        scenario = scenario.updated({"camera.noise": 0.0, "target.desired_features": home})
        gone = distances(scenario, np.array([2e-5, 2e-5, 0.0, -5e-5, 5e-5, 0.0]), 40.0)
        ticks = round(4.0 / scenario.simulation.step)
        assert (gone[-ticks:].max() > gone[2 * ticks : 3 * ticks].max()) == (share > 1.0)


def test_the_loop_is_stable_with_small_errors_and_grows_with_larger_ones() -> None:
    """Its border is 0.40 %: with half of that nothing grows."""
    found = loop_under_errors(with_forces(0.0), 0.005 * SIGNS, SIGNS[None], 0.002)
    assert found is not None
    assert not found.own.stable
    assert found.own.rate > 0.0
    assert found.limit is None
    assert not found.grows_at(0.002)


@pytest.mark.parametrize("gain", [999.4, 1399.0, 1938.84])
def test_a_limit_far_below_that_of_the_drift_is_found(gain: float) -> None:
    """0.031 %, 0.0098 % and 0.00098 %, where no rate is negative up to 0.6 %: stable with exact depths and up to it."""
    base = with_forces(0.0).updated({"controller.resolved_rate.gain": gain})
    found = drift.analyse(base)
    assert found.loop is not None
    assert found.limit_start is not None
    limit, signs = found.loop.limit, found.loop.signs
    assert limit is not None
    assert 0.0 < limit < 0.06 * found.limit_start
    for share, stable in ((0.0, True), (0.999, True), (1.003, False)):
        at_rest = loop_at_rest(base.updated({"uncertainty.depth": (share * limit * signs).tolist()}))
        radius = scene_of(at_rest.scenario).platform_radius
        assert loop_margins(at_rest.free, clock_of_loop(at_rest), radius, borders=False).stable == stable
    last = found.section().sentences[-1]
    assert f"with the signs (-,+,-,+) from {100 * limit:.3g} % on" in last


def test_a_loop_that_grows_with_exact_depths_is_stated_to() -> None:
    found = drift.analyse(with_forces(0.0).updated({"controller.resolved_rate.gain": 2500.0}))
    assert found.loop is not None
    assert not found.loop.stable_if_exact
    section = found.section()
    assert section.sentences[-1] == "The linear loop grows with exact depths too: see the part camera_rate."
    assert section.verdict == "bad"


def test_a_loop_that_is_not_linearised_is_stated_not_to_be() -> None:
    scenario = with_forces(0.0).updated({"uncertainty.latency": 0.001})
    assert loop_under_errors(scenario, 0.0 * SIGNS, SIGNS[None], 0.002) is None


def test_of_all_signs_that_with_which_the_loop_grows_first_is_found() -> None:
    """`eye-to-hand`: all rates are positive up to 9.9 %, runs grow beyond 7.3 % with one of sixteen signs alone."""
    scenario = hs.load_scenario("eye-to-hand")
    found = drift.analyse(scenario)
    assert found.loop is not None
    assert found.loop.limit is not None
    assert found.limit_start is not None
    assert found.loop.limit < 0.9 * found.limit_start
    assert any("with the signs (-,+,+,-) from 7.32 % on" in text for text in found.section().sentences)

    def growth_of(signs: tuple[float, ...], share: float) -> float:
        """Return the growth [1/s] of the twist of a run without K_v from 1e-4 px, over the last two thirds of 100 s."""
        assert found.loop is not None
        assert found.loop.limit is not None
        errors = [share * found.loop.limit * sign for sign in signs]
        changes = {"uncertainty.depth": errors, "controller.composite.kv": 0.0}
        home = at_rest_at_home(loop_at_rest(scenario.updated(changes)))
        scene = scene_of(home)
        goal = scene.view(scene.home).after(ALL_AXES * scene.unit, 1e-4)
        long = {"simulation.duration": 100.0, "simulation.log_every": 10}
        run = hs.simulate(home.updated({"target.desired_features": goal.tolist(), **long}))
        fast = np.linalg.norm(run.twist * np.repeat([1.0, scene.platform_radius], 3), axis=1)
        _, middle, last = (float(part.max()) for part in np.array_split(fast, 3))
        return math.log(last / middle) * 3.0 / 100.0

    grows = {signs: growth_of(signs, 1.15) for signs in itertools.product((1.0, -1.0), repeat=4)}
    assert {signs for signs, rate in grows.items() if rate > 0.01} == {tuple(found.loop.signs)}
    assert growth_of(tuple(found.loop.signs), 0.9) < -0.01
