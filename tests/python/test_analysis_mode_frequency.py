"""Frequencies of the linear sampled loop, which a camera of half of them does not resolve: against runs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hexservo as hs
from hexservo.findings.analysis.camera_margins import crossing, exponents, loop_margins
from hexservo.findings.analysis.linear_loop import Clock, SampledLoop
from hexservo.findings.analysis.loop_of_scenario import at_rest_at_home, clock_of, loop_at_rest, scaled
from hexservo.findings.analysis.scene import ALL_AXES, scene_of
from hexservo.findings.evidence import Table

Array = NDArray[np.float64]


def spectrum_peak(samples: Array, step: float) -> float:
    """Return the frequency [Hz] of the largest line of samples (n, k), whose mean and trend are taken out."""
    window = np.hanning(len(samples))[:, None]
    lines = np.linalg.norm(np.fft.rfft(window * (samples - samples.mean(axis=0)), axis=0), axis=1)
    return float(np.fft.rfftfreq(len(samples), step)[int(np.argmax(lines))])


def oscillator(frequency: float, tick: float) -> SampledLoop:
    """Give a unit mass on a damped spring that the joint sensors measure; the image of it has no effect."""
    stiffness, one = (2.0 * np.pi * frequency) ** 2, np.eye(1)
    return SampledLoop(tick, one, frame=0.0 * one, pose=-stiffness * one, twist=-0.5 * one)


@pytest.mark.parametrize("period", [1, 20, 33, 50, 66, 500])
@pytest.mark.parametrize("frequency", [0.3, 7.0, 36.0, 60.0])
def test_an_oscillation_has_its_frequency_with_any_camera_period(period: int, frequency: float) -> None:
    """By hand sqrt(k - d^2/4): what a frame rate of 2 to 1000 Hz makes of it is an alias."""
    tick = 1e-3
    found = [exponents(oscillator(frequency, tick), Clock(period, 7))[at] for at in (0, 1)]
    expected = np.sqrt((2.0 * np.pi * frequency) ** 2 - 0.5**2 / 4.0)
    assert sorted(np.sign(each.imag) for each in found) == [-1.0, 1.0]
    for each in found:  # of first order in the tick
        assert abs(each.imag) == pytest.approx(expected, rel=0.6 * expected * tick)
        same = exponents(oscillator(frequency, tick), Clock(1, 7))[0]
        assert each.real == pytest.approx(same.real, abs=1e-9)
        assert abs(each.imag) == pytest.approx(abs(same.imag), rel=1e-9)


@pytest.mark.parametrize(
    ("name", "changes", "alias"),
    [
        ("composite-30hz", {"camera.period": 0.01}, None),
        ("composite-30hz", {"camera.period": 0.02}, 13.97),
        ("composite-30hz", {"camera.period": 0.033}, 5.73),
        ("composite-30hz", {"camera.period": 0.05}, 3.97),
        ("composite-30hz", {"camera.period": 0.066}, 5.73),
        ("pi-h824", {}, 26.8),
        ("slow-camera", {}, 7.33),
        ("hand-eye", {}, None),
    ],
)
def test_the_frequency_of_the_mode_at_the_gain_limit_is_that_of_a_run(
    name: str, changes: dict[str, Any], alias: float | None
) -> None:
    """A run at 1.07 times the limit: K_v = 0, from 1e-6 px. The spectrum of its twist has a resolution of 0.2 Hz."""
    home = at_rest_at_home(loop_at_rest(hs.load_scenario(name).updated(changes)))
    loop, clock = loop_at_rest(home).free, clock_of(home)
    margins = loop_margins(loop, clock, 0.1)
    assert margins.gain[1] is not None
    beyond = 1.07 * margins.gain[1]
    stated = abs(exponents(replace(loop, gain=beyond), clock)[0].imag) / (2.0 * np.pi)
    law = home.controller.law
    start = scene_of(home).view(scene_of(home).home).after(ALL_AXES * scene_of(home).unit, 1e-6)
    run = hs.simulate(
        scaled(home, beyond).updated(
            {
                f"controller.{law}.kv": 0.0,
                "target.desired_features": start.tolist(),
                "simulation.duration": 8.0,
                "simulation.log_every": 1,
            }
        )
    )
    measured = spectrum_peak(run.twist[3000:], home.simulation.step)
    assert stated == pytest.approx(measured, abs=0.25)
    # 7 % farther the frequency has hardly changed, and is not that of an alias.
    assert margins.border_frequency == pytest.approx(stated, rel=0.04)
    if alias is not None:
        period = home.camera.period
        assert abs(margins.border_frequency - alias) > 0.3
        turns = np.array([margins.border_frequency - alias, margins.border_frequency + alias]) * period
        assert np.abs(turns - turns.round()).min() < 0.02


def test_the_part_states_the_frequency_of_the_run() -> None:
    """Sentence, table and data: 36 Hz, of which a camera of 30 Hz has 5.7 Hz."""
    section = hs.analyse(hs.load_scenario("composite-30hz"), ["camera_rate"]).camera_rate.section()
    assert any("then a mode begins to grow at 36 Hz" in sentence for sentence in section.sentences)
    (margins, _) = (item for item in section.items if isinstance(item, Table))
    (row,) = (row for row in margins.rows if row[0] == "frequency of the mode at the limit")
    assert row[2] == pytest.approx(36.03, abs=0.1)
    assert section.data["without_kv"]["border_frequency"] == pytest.approx(36.03, abs=0.1)


def test_the_mode_inside_a_limit_is_that_outside_with_a_late_image() -> None:
    """Their frequency changes by 2 Hz within 10 % of the gain: of the alias, 5.7 Hz, that is more than a third."""
    scenario = hs.load_scenario("composite-30hz").updated({"camera.latency": 0.1})
    home = at_rest_at_home(loop_at_rest(scenario))
    loop, clock = loop_at_rest(home).free, clock_of(home)
    limit = loop_margins(loop, clock, 0.1).gain[1]
    assert limit is not None
    inside, outside = ((replace(loop, gain=limit * (1.0 + part)), clock) for part in (-0.05, 0.05))
    decays, grows = crossing(inside, outside)
    assert decays.real == pytest.approx(-0.623, abs=0.01)
    assert grows.real == pytest.approx(0.621, abs=0.01)
    assert abs(decays.imag) == pytest.approx(abs(grows.imag), rel=0.06)


@pytest.mark.parametrize(
    ("name", "changes", "offset"),
    [
        ("composite-30hz", {"camera.latency": 0.1}, 1e-6),
        ("composite-30hz", {"camera.prediction": "none", "camera.latency": 0.01, "controller.composite.kv": 0.0}, 1e-6),
        ("dropouts", {}, 1e-6),  # from 0.01 px the weights learn, and the growth falls
        ("real-machine", {}, 1e-6),
        ("slow-camera", {}, 0.01),  # 7.82 Hz: half the frame rate is 7.58 Hz
    ],
)
def test_runs_near_the_limit_grow_as_predicted(name: str, changes: dict[str, Any], offset: float) -> None:
    found = hs.analyse(hs.load_scenario(name).updated(changes), ["camera_rate"]).camera_rate
    for run in found.runs:
        assert run.offset == offset
        assert run.measured == pytest.approx(run.predicted, rel=0.03)
    assert len(found.runs) == 2
    words = " ".join(found.section().sentences)
    assert "another size" not in words
    assert ("this far from its goal the loop is not linear" in words) == (offset < 0.01)


def test_runs_that_grow_differently_from_the_smallest_start_are_not_explained_by_it() -> None:
    """A growth of another size from 1e-6 px too is no matter of the size of the start."""
    found = hs.analyse(hs.load_scenario("dropouts"), ["camera_rate"]).camera_rate
    runs = tuple(replace(run, measured=0.5 * run.predicted) for run in found.runs)
    words = " ".join(replace(found, runs=runs).section().sentences)
    assert "it has the predicted sign, and another size" in words
    assert "this far from its goal" not in words
    short = tuple(replace(run, duration=1.0) for run in runs)  # a factor of 1.3: of no size
    assert "another size" not in " ".join(replace(found, runs=short).section().sentences)
