"""Custom controllers of machines whose drives take positions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.linalg import expm

import hexservo as hs
from hexservo.scenario.arrays import Array

# A frame at every tick, without latency: the tick is given what the law of the scenario is.
PROMPT = {
    "camera": {"period": 0.02, "latency": 0.0, "noise": 0.0},
    "sensors": {"resolution": 0.0},
    "simulation": {"duration": 1.0, "log_every": 1},
    "metrics": {"rms_start": 0.5},
}
MACHINES = ["pi-h824-positions", "reachy-mini", "reachy-mini-motors"]  # lengths, cranks, motors


def short(name: str) -> hs.Scenario:
    return hs.load_scenario(name).updated({"simulation.duration": 0.4, "metrics.rms_start": 0.2})


def stay(seen: hs.Observation) -> hs.LegPositions:
    return hs.LegPositions(seen.leg_positions)


def as_function(scenario: hs.Scenario) -> Callable[[hs.Observation], hs.LegPositions]:
    tick = hs.Controller(scenario)

    def step(seen: hs.Observation) -> hs.LegPositions:
        pose = (seen.position, seen.quaternion, seen.twist)
        out = tick.step(seen.pixels, seen.depth, *pose, leg_lengths=seen.leg_lengths, leg_rates=seen.leg_rates)
        return hs.LegPositions(out.leg_positions)

    return step


@pytest.mark.parametrize("law", ["tracking", "pbvs"])
def test_the_packaged_controller_as_a_function_is_the_law_itself(law: str) -> None:
    scenario = hs.load_scenario("pi-h824-positions").updated(PROMPT).updated({"controller.law": law})
    own, core = hs.simulate(scenario, controller=as_function(scenario)), hs.simulate(scenario)
    assert np.ptp(core.leg_lengths, axis=0).max() > 1e-3
    np.testing.assert_allclose(own.leg_lengths, core.leg_lengths, rtol=0, atol=1e-12)
    np.testing.assert_allclose(own.wrench, core.wrench, rtol=0, atol=1e-8)
    assert hs.metrics(own) == pytest.approx(hs.metrics(core), rel=1e-7, nan_ok=True)


@pytest.mark.parametrize("name", MACHINES)
def test_legs_that_are_sent_where_they_are_stay(name: str) -> None:
    scenario = short(name).updated({"actuators.delay": 0.0})
    seen: list[hs.Observation] = []

    def watch(observation: hs.Observation) -> hs.LegPositions:
        seen.append(observation)
        return stay(observation)

    result = hs.simulate(scenario, controller=watch)
    assert result.outcome == "completed"
    assert len(seen) == len(result.time)
    for observation in seen:
        assert np.array_equal(observation.leg_positions, seen[0].leg_positions)
    np.testing.assert_allclose(seen[0].leg_positions, result.leg_lengths[0], rtol=0, atol=1e-12)
    sag = 0.1 if name == "reachy-mini-motors" else 1e-9  # motors yield to the weight
    assert np.abs(result.leg_lengths - result.leg_lengths[0]).max() < sag


@pytest.mark.parametrize("delay", [0.0, 0.06])
def test_a_leg_follows_its_command_as_the_response_does(delay: float) -> None:
    """One leg is sent 0.1 mm away; the response of second order is that of `expm`, `delay` later."""
    scenario = short("pi-h824-positions").updated({"actuators.delay": delay, "simulation.log_every": 1})

    def one_leg(seen: hs.Observation) -> hs.LegPositions:
        return hs.LegPositions(start + 1e-4 * np.eye(6)[0])

    start = np.array(hs.simulate(scenario, controller=stay).leg_lengths[0])
    result = hs.simulate(scenario, controller=one_leg)
    response = scenario.actuators.position
    w = 2.0 * np.pi * response.bandwidth
    rate = np.array([[0.0, 1.0], [-w * w, -2.0 * response.damping * w]])
    expected = [1e-4 + (expm(rate * max(t - delay, 0.0)) @ [-1e-4, 0.0])[0] for t in result.time]
    np.testing.assert_allclose(result.leg_lengths[:, 0] - start[0], expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(result.leg_lengths[:, 1:], np.tile(start[1:], (len(result.time), 1)), rtol=0, atol=1e-12)


def test_what_it_gives_acts_without_an_image_too() -> None:
    """Where a wrench would be replaced by a safe one: a drive has no other place to go to."""
    scenario = short("pi-h824-positions").updated({"camera.latency": 0.2, "actuators.delay": 0.0})
    blind: list[bool] = []

    def moves(seen: hs.Observation) -> hs.LegPositions:
        blind.append(bool(np.isnan(seen.features).any()))
        return hs.LegPositions(seen.leg_positions + 1e-5)

    result = hs.simulate(scenario, controller=moves)
    assert blind[:10] == [True] * 10
    assert not blind[-1]
    assert result.leg_lengths[9, 0] - result.leg_lengths[0, 0] > 5e-5


@pytest.mark.parametrize(("on_limit", "outcome"), [("report", "completed"), ("stop", "leg_limit")])
def test_a_leg_that_is_sent_beyond_its_stroke_is_an_event(on_limit: str, outcome: str) -> None:
    scenario = short("pi-h824-positions").updated(
        {"robot.on_limit": on_limit, "actuators.position.speed_limit": None, "simulation.duration": 2.0}
    )

    def away(seen: hs.Observation) -> hs.LegPositions:
        return hs.LegPositions(seen.leg_positions + 2e-4 * np.eye(6)[0])

    result = hs.simulate(scenario, controller=away)
    assert result.outcome == outcome
    assert [(event.leg, event.kind) for event in result.events] == [(1, "stroke")]


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (np.zeros(6), "expected hs.LegPositions, which drives with this actuators.kind take, at tick 0"),
        (hs.LegForces(np.zeros(6)), "expected hs.LegPositions, .* got LegForces"),
        (None, "expected hs.LegPositions, .* got None"),
        (hs.LegPositions(np.full(6, np.nan)), "expected leg positions of 6 finite numbers at tick 0"),
        (hs.LegPositions([0.1] * 5), r"expected leg positions of 6 finite numbers at tick 0 \(t = 0 s\), got .*\(5,\)"),
        (hs.LegPositions([True] * 6), "expected leg positions of 6 finite numbers"),
    ],
)
@pytest.mark.parametrize("name", MACHINES)
def test_what_the_drives_do_not_take_is_refused(name: str, command: object, words: str) -> None:
    with pytest.raises(ValueError, match=f"^controller: {words}"):
        hs.simulate(short(name), controller=lambda seen: command)  # type: ignore[arg-type, return-value]


def test_positions_are_refused_by_drives_that_take_forces(paper: hs.Scenario) -> None:
    sampled = paper.updated({"simulation.mode": "sampled", "controller.switching.kind": "implicit"})
    observed: list[Array] = []

    def wrong(seen: hs.Observation) -> hs.LegPositions:
        observed.append(seen.leg_positions)
        return hs.LegPositions(np.full(6, 0.1))

    with pytest.raises(ValueError, match=r"^controller: expected a wrench of 6 numbers, or hs\.LegForces, .*tick 0"):
        hs.simulate(sampled, controller=wrong)
    assert np.isnan(observed[0]).all()


def test_in_batches_and_comparisons() -> None:
    scenario = short("pi-h824-positions")
    bandwidths = np.array([5.0, 10.0])

    def nods(seen: hs.Observation) -> hs.LegPositions:
        return hs.LegPositions(seen.leg_positions + 2e-6 * np.cos(seen.time))

    varied = {"actuators.position.bandwidth": bandwidths}
    batch = hs.simulate_batch(scenario, varied, controller=nods, log="trajectory")
    for index, bandwidth in enumerate(bandwidths):
        alone = hs.simulate(scenario.updated({"actuators.position.bandwidth": bandwidth}), controller=nods)
        assert np.array_equal(batch.samples["leg_lengths"][index], alone.leg_lengths)
    row = hs.compare([scenario], [], controllers={"nods": nods}).row("nods", scenario.name)
    assert row.outcome == "completed"
    failed = hs.compare([scenario], [], controllers={"forces": lambda seen: np.zeros(6)}).row("forces", scenario.name)
    assert failed.outcome == "failed"
    assert "expected hs.LegPositions" in failed.why


def test_ctrl_c_before_the_first_command_leaves_the_machine_at_its_start() -> None:
    def presses(seen: hs.Observation) -> hs.LegPositions:
        raise KeyboardInterrupt

    result = hs.simulate(short("pi-h824-positions"), controller=presses)
    assert result.outcome == "interrupted"
    assert len(result.time) == 1
    assert np.isfinite(result.leg_lengths).all()
    assert np.isfinite(result.wrench).all()
