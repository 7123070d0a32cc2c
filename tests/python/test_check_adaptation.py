"""Drives and adaptations that a loop does not bear: in `check`, by the cubic and by runs, and in `diagnose`."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis.loop_of_scenario import quiet
from hexservo.findings.analysis.scene import ALL_AXES, scene_of
from hexservo.findings.check_adaptation import of_adaptation
from hexservo.findings.diagnosis.adaptation import ADAPTATION
from hexservo.findings.diagnosis.model import Case
from without_runs import unlikely_without_runs

DRIVE, PSI = "controller.composite.drive", "controller.composite.fuzzy.adaptation"
FITTED = ("kp", "kt", "kd", "kv", "drive", "prior", "fuzzy.adaptation", "fuzzy.error_scale", "fuzzy.rate_scale")


def sentences(scenario: hs.Scenario) -> list[str]:
    return list(of_adaptation(scene_of(scenario)))


def largest_drive(sentence: str) -> float:
    found = re.search(r"times this drive, ([\d.]+) 1/s", sentence)
    assert found is not None, sentence
    return float(found[1])


def faster(name: str, times: float, changes: dict[str, Any] | None = None) -> hs.Scenario:
    """Return a scenario whose weights learn so many times as fast."""
    scenario = hs.load_scenario(name).updated(changes or {})
    psi = np.broadcast_to(np.asarray(scenario.controller.gains.fuzzy.adaptation, dtype=float), 6)
    return scenario.updated({PSI: (psi / times).tolist()})


def continuous(bandwidth: float) -> hs.Scenario:
    """Return a scenario with fitted gains in continuous mode, without what the cubic leaves out."""
    task = hs.load_scenario("paper").target
    target = {"initial_features": list(task.initial_features or ()), "desired_features": list(task.desired_features)}
    composite = {"auto": {"bandwidth": bandwidth}, "kp": 0.0, "prior": 0.0}
    return hs.Scenario(name="fitted", target=target, controller={"law": "composite", "composite": composite})


@pytest.mark.parametrize(("bandwidth", "of_kd"), [(1.0, 1.0), (3.0, 1.0), (1.0, 2.0)])
def test_the_largest_drive_is_that_of_the_cubic(bandwidth: float, of_kd: float) -> None:
    """s^3 + kd/D s^2 + (kt + A)/D s + Lambda A/D, by Hurwitz: kd (kt + A)/(D A), of fitted gains 5 omega."""
    scenario = continuous(bandwidth)
    omega = 2.0 * np.pi * bandwidth
    damping = of_kd * np.asarray(scenario.controller.gains.kd)
    (sentence,) = sentences(scenario.updated({"controller.composite.kd": damping.tolist(), DRIVE: 300.0 * bandwidth}))
    assert sentence.startswith(f"{DRIVE}: with ")
    assert largest_drive(sentence) == pytest.approx(5.0 * omega * of_kd, rel=0.01)  # with A = kt = omega^2 D


@pytest.mark.parametrize(
    ("name", "duration"),
    [("pi-h824", 10.0), ("moog-6dof2000e", 30.0), ("rubin-camera-hexapod", 40.0), ("composite-30hz", 2.0)],
)
def test_small_runs_decay_below_the_largest_drive_and_grow_above_it(name: str, duration: float) -> None:
    """From home, with a goal 1e-5 px away; of two platforms the centre of mass is off the origin: axes are coupled."""
    base = hs.load_scenario(name)
    sentence = sentences(base.updated({DRIVE: 1000.0}))[0]
    most = largest_drive(sentence)
    calm = quiet(base.updated({"controller.composite.kv": 0.0}))
    scene = scene_of(calm)
    goal = scene.view(scene.home).after(ALL_AXES * scene.unit, 1e-5)
    ratio = {}
    for share in (0.9, 1.1):
        changes = {DRIVE: share * most, "target.desired_features": goal.tolist(), "simulation.log_every": 1}
        result = hs.simulate(calm.updated({**changes, "simulation.duration": duration}))
        size = np.linalg.norm(result.twist * np.repeat([1.0, scene.platform_radius], 3), axis=1)
        thirds = np.array_split(size, 3)
        ratio[share] = float(thirds[2].max() / thirds[1].max())
    print(name, most, ratio)
    assert ratio[0.9] < 0.95
    assert ratio[1.1] > 1.5


@pytest.mark.parametrize(("name", "times"), [("pi-h824", 1000.0), ("composite-30hz", 1000.0)])
def test_an_adaptation_faster_than_the_servo_is_named_with_the_factor_that_runs_bear(name: str, times: float) -> None:
    scenario = faster(name, times)
    (sentence,) = (words for words in unlikely_without_runs(scenario) if words.startswith(PSI))
    found = re.search(r"stable from ([\d.]+) times these values on", sentence)
    assert found is not None
    slower = faster(name, times / (1.2 * float(found[1])))
    assert not sentences(slower)
    shaken, borne = (hs.metrics(hs.simulate(one)) for one in (scenario, slower))
    assert np.isfinite(borne["settling_time"])
    assert shaken["peak_leg_force"] > 5.0 * borne["peak_leg_force"]


@pytest.mark.parametrize("name", ["paper-composite", "composite-30hz", "pi-h824", "rubin-camera-hexapod"])
def test_an_adaptation_that_fits_is_not_named(name: str) -> None:
    assert not sentences(hs.load_scenario(name))


def test_laws_without_a_drive_have_no_such_sentence() -> None:
    assert not sentences(hs.load_scenario("paper"))
    assert not sentences(hs.load_scenario("pi-h824").updated({DRIVE: 1e3, "controller.composite.fuzzy.enabled": False}))


@pytest.mark.parametrize(
    "scenario",
    [
        hs.load_scenario("pi-h824").updated({"controller.composite.auto.bandwidth": 1.0, DRIVE: 45.0}),
        hs.load_scenario("composite-30hz").updated({DRIVE: 400.0}),
        faster("pi-h824", 1000.0, {"controller.composite.auto.bandwidth": 1.0, "simulation.step": 0.008}),
    ],
    ids=["a drive", "a drive of written gains", "an adaptation"],
)
def test_diagnose_names_an_adaptation_that_is_too_fast_and_not_the_gains(scenario: hs.Scenario) -> None:
    diagnosis = hs.diagnose(hs.simulate(scenario))
    assert [finding.cause for finding in diagnosis.named] == ["fast_adaptation"]
    (finding,) = diagnosis.named
    assert finding.without is not None
    assert set(finding.without.changes) <= {DRIVE, PSI}
    remedied = hs.simulate(scenario.updated(dict(finding.without.changes)))
    assert np.isfinite(hs.metrics(remedied)["settling_time"])


def test_an_adaptation_that_fits_has_no_removal() -> None:
    """Not that of default gains, nor that of a loop that is faster as a whole."""
    for name in ("paper-composite", "composite-30hz", "pi-h824"):
        assert not ADAPTATION.removals(Case(hs.load_scenario(name), None))
    quick = hs.load_scenario("pi-h824").updated({"controller.composite.auto.bandwidth": 20.0})
    assert not ADAPTATION.removals(Case(quick, None))
    assert ADAPTATION.removals(Case(quick.updated({DRIVE: 20.0 * 2.0 * np.pi * 5.0}), None))
