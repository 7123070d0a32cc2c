"""What a diagnosis states beside the cause: runs that are too short, and what is left where nothing is named."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.diagnosis.devices import DEVICES
from hexservo.findings.diagnosis.environment import faultless
from hexservo.findings.diagnosis.gains import by_bandwidth, slower
from hexservo.findings.diagnosis.ranking import make_cases
from hexservo.scenario.keys import value_at
from hexservo.scenario.laws import LAWS
from test_diagnosis_scales import in_pixels, in_time

BANDWIDTH = "controller.composite.auto.bandwidth"
DURATION = "simulation.duration"
SLOW = {"actuators.position.speed_limit": 0.0005}
SLOWER = {"actuators.position.speed_limit": 0.0006, "controller.tracking.bandwidth": 0.1}


def slow(changes: dict[str, float]) -> hs.Scenario:
    return hs.load_scenario("pi-h824-positions").updated(changes)


@pytest.mark.parametrize(
    ("changes", "named", "together"), [(SLOW, {"leg_rates"}, set()), (SLOWER, set(), {"leg_rates", "gains_low"})]
)
def test_a_slow_run_that_a_longer_one_settles_is_called_too_short(
    changes: dict[str, float], named: set[str], together: set[str]
) -> None:
    """Beside the cause that makes it slow; the time is that of the run with the stated duration."""
    scenario = slow(changes)
    diagnosis = hs.diagnose(hs.simulate(scenario))
    assert {finding.cause for finding in diagnosis.named} == named
    assert set(diagnosis.together) == together
    later = diagnosis.settles_later
    assert later is not None
    assert set(later.changes) == {DURATION}
    settled = hs.metrics(hs.simulate(scenario.updated(later.changes)))["settling_time"]
    assert later.settling_time == pytest.approx(settled, abs=2 * scenario.simulation.step)
    assert settled > scenario.simulation.duration
    sentences = diagnosis.section().sentences
    duration = later.changes[DURATION]
    expected = f"It is also too short for that: with simulation.duration={duration:g} and no other change it is settled"
    assert len([words for words in sentences if words.startswith(expected)]) == 1
    assert not [words for words in sentences if "a run of" in words and "not the cause" in words]
    assert diagnosis.too_short is None  # what a program takes for the cause


def test_a_run_that_is_only_too_short_is_called_so_where_no_cause_is_named() -> None:
    """As with a cause that small random changes cure as well."""
    diagnosis = hs.diagnose(hs.simulate(slow(SLOW)))
    unnamed = dataclasses.replace(
        diagnosis, causes=tuple(dataclasses.replace(finding, named=False) for finding in diagnosis.causes)
    )
    first, *others = unnamed.section().sentences
    assert unnamed.too_short is not None
    assert first.startswith("The run is too short: it has up to ")
    assert f"with simulation.duration={unnamed.too_short:g} and no other change it is settled after t = " in first
    assert unnamed.cures == ({DURATION: unnamed.too_short},)
    assert not [words for words in others if "too short" in words]


def test_a_longer_run_that_settles_at_its_end_alone_is_none() -> None:
    """Noise at the border of the band leaves it for some dwell times now and then."""
    diagnosis = hs.diagnose(hs.simulate(slow(SLOW)))
    (found,) = (finding for finding in diagnosis.causes if finding.cause == "duration")
    assert found.without is not None
    for share, counts in ((0.4, False), (0.6, True)):
        time = found.without.changes[DURATION] - share * diagnosis.result.scenario.simulation.duration
        late = dataclasses.replace(found, without=dataclasses.replace(found.without, settling_time=time))
        causes = tuple(late if finding is found else finding for finding in diagnosis.causes)
        assert (dataclasses.replace(diagnosis, causes=causes).settles_later is not None) == counts


def test_a_wrong_weight_of_a_slow_machine_is_named_with_its_low_gains() -> None:
    """A slower loop has less K_v too: with the ordinary one alone it would hold the weight."""
    scenario = in_time(hs.load_scenario("fails-gravity"), 8.0)
    diagnosis = hs.diagnose(hs.simulate(scenario))
    assert not diagnosis.named
    assert set(diagnosis.together) == {"gravity", "gains_low"}


THREE = {
    "controller.jacobian": "printed",
    "actuators.bandwidth": 0.5,
    "sensors": {"pose": "encoders", "noise": 2e-4, "resolution": 1e-4},
    "uncertainty.gravity": 0.08,
}


def test_a_diagnosis_that_names_nothing_states_what_it_tried_and_what_is_left() -> None:
    """Whether the task is possible at all, and by which keys the run differs from one that passes."""
    scenario = hs.load_scenario("fails-late-camera").updated(THREE)
    diagnosis = hs.diagnose(hs.simulate(scenario))
    assert not diagnosis.named
    assert not diagnosis.together
    without = hs.simulate(scenario.updated(faultless(scenario)))
    assert diagnosis.faultless is math.isfinite(hs.metrics(without)["settling_time"]) is True
    words = " ".join(diagnosis.section().sentences)
    assert "Removed one at a time, and in pairs of those whose settings are unusual: " in words
    for finding in diagnosis.causes:
        assert finding.title in words
    keys = words.partition("change back one key at a time, of ")[2]
    assert {"actuators.bandwidth", "controller.jacobian"} <= set(keys.replace(" and", ",").split(", "))
    assert diagnosis.to_dict()["faultless"] is True
    impossible = dataclasses.replace(diagnosis, faultless=False)
    assert "What is left is the task (start, goal, metrics.band" in " ".join(impossible.section().sentences)


def test_what_is_left_is_asked_only_where_nothing_is_named() -> None:
    for scenario in (hs.load_scenario("fails-stiction"), hs.load_scenario("paper")):
        diagnosis = hs.diagnose(hs.simulate(scenario))
        assert diagnosis.faultless is None
        assert "What is left" not in " ".join(diagnosis.section().sentences)


@pytest.mark.parametrize("pixels", [1 / 64, 64.0])
def test_divergence_has_the_same_cause_in_other_pixels(pixels: float) -> None:
    """Though a run diverges beyond 1e4 px, however many of them a radian has."""
    scenario = hs.load_scenario("fails-wrong-sign")
    found = [hs.diagnose(hs.simulate(each)) for each in (scenario, in_pixels(scenario, pixels))]
    assert {tuple(finding.cause for finding in one.named) for one in found} == {("wrong_sign",)}
    scores, others = ({finding.cause: finding.score for finding in one.causes} for one in found)
    assert others.keys() - scores.keys() <= {"band"}  # below the 2 px that are ordinary for any camera
    assert {cause: others[cause] for cause in scores} == pytest.approx(scores, abs=0.05)


def drifting(**changes: Any) -> hs.Scenario:
    """Return a scenario whose depth errors make the pose error grow, in tens of seconds, and whose run is of 5 s."""
    of_camera = {"camera.latency": 0.06, "camera.period": 0.033, "camera.noise": 0.05}
    errors = {"uncertainty.depth": [0.25, -0.27, -0.28, -0.29], BANDWIDTH: 0.5}
    return hs.load_scenario("noisy-camera").updated({**of_camera, **errors, "robot.stroke": 0.017, **changes})


def test_a_drift_that_the_run_is_too_short_for_is_stated_of_the_run_and_of_a_remedy() -> None:
    """With the remedy the run passes, a longer one leaves the stroke, and the rate is that of the part `drift`."""
    diagnosis = hs.diagnose(hs.simulate(drifting()))
    (finding,) = diagnosis.named
    remedy = finding.remedy
    assert remedy is not None
    assert remedy.works
    assert remedy.changes == {BANDWIDTH: 2.0}
    remedied = drifting(**remedy.changes)
    own = hs.analyse(remedied, ["drift"]).drift.own
    assert own is not None
    assert own.slowest < 0.0
    assert remedy.grows_in == pytest.approx(-1.0 / own.slowest, rel=1e-6)
    words = f"the pose error grows e-fold in {-1.0 / own.slowest:.3g} s by unequal depth errors"
    sentences = diagnosis.section().sentences
    assert words in sentences[0]
    assert sum(words in sentence for sentence in sentences if sentence.startswith("Against gains")) == 1
    passing = hs.diagnose(hs.simulate(remedied)).section()
    assert passing.verdict == "warning"
    assert words in passing.sentences[0]
    short, long = (
        hs.metrics(hs.simulate(remedied.updated({DURATION: duration})))["peak_leg_excursion"]
        for duration in (5.0, 60.0)
    )
    assert short < 0.5 * remedied.robot.stroke < 1.5 * remedied.robot.stroke < long
    equal = hs.diagnose(hs.simulate(remedied.updated({"uncertainty.depth": -0.1475})))
    assert equal.section().verdict == "good"


@pytest.mark.parametrize("law", LAWS)
def test_a_loop_in_another_time_is_stated_by_the_bandwidth_that_its_gains_follow(law: str) -> None:
    """Where all of them follow it: with one that is written, the gains are stated one by one."""
    changes = {"controller.law": law, f"controller.{law}.auto.bandwidth": 1.5}
    scenario = hs.load_scenario("pi-h824-positions" if law == "tracking" else "pi-h824").updated(changes)
    for factor in (4.0, 0.25):
        gains = slower(scenario, factor)
        assert by_bandwidth(scenario, gains) == {f"controller.{law}.auto.bandwidth": 1.5 / factor}
        name = next(key for key in gains if np.any(value_at(scenario, key)))
        written = scenario.updated({name: (1.1 * np.asarray(value_at(scenario, name))).tolist()})
        gains = slower(written, factor)
        assert by_bandwidth(written, gains) == gains
    assert by_bandwidth(scenario, {"camera.noise": 0.0}) == {"camera.noise": 0.0}


def test_depth_errors_that_cancel_have_the_mean_zero() -> None:
    """Their sum in floating point is -1.4e-17, which was stated as the depth error of the remedy."""
    errors = [0.08, 0.15, -0.25, 0.02]
    assert sum(errors) != 0.0
    case = make_cases([hs.load_scenario("rubin-camera-hexapod").updated({"uncertainty.depth": errors})])[0]
    removals = {cause.key: cause.removals(case) for cause in DEVICES}
    (equal,) = removals["unequal_depth"]
    assert equal.changes == {"uncertainty.depth": 0.0}
    assert "depth error of 0 for all" in equal.words
    assert not removals["common_depth"]
    shifted = case.scenario.updated({"uncertainty.depth": [0.1 + error for error in errors]})
    (common,) = next(cause for cause in DEVICES if cause.key == "common_depth").removals(make_cases([shifted])[0])
    assert common.changes == {"uncertainty.depth": errors}
