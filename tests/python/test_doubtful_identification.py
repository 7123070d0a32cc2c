"""What a log does not give: values at the edge of what is tried, and models that do not predict it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import hexservo as hs
from hexservo.cli.commands import app
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.evidence import Table
from hexservo.findings.identification.changes import changes_of, faults_of, in_milliseconds
from hexservo.findings.identification.drives import MOST_DELAY, Drives, fit_drives
from hexservo.findings.identification.drives_words import with_interval
from hexservo.findings.identification.frames import CameraFit, fit_camera
from hexservo.findings.identification.interval import Interval
from hexservo.findings.identification.log import Log
from hexservo.findings.identification.one_drive import mean_of
from recorded_machines import Drive, record, wandering
from test_identification import METRES, SEED, seen_log, try_delays
from test_identified_camera import drives_of_seen_log


@pytest.mark.slow
def test_a_delay_beyond_what_is_tried_has_no_upper_end(paper: hs.Scenario) -> None:
    random = np.random.default_rng(SEED)
    commands = 0.205 + wandering(random, 200, 0.01, 0.004, 0.2)
    log = record(commands, 0.01, [Drive(5.0, 0.9, MOST_DELAY + 3)] * 6, 1e-6, random)
    found = hs.identify(log, paper)
    delay = found.drives.fits[0].delay
    assert delay is not None
    assert delay.value == MOST_DELAY
    assert delay.high == np.inf
    section = found.drives.section()
    assert section.verdict == "warning"
    assert any("8, the most that is tried" in sentence for sentence in section.sentences)
    assert "actuators.delay" not in found.changes
    assert found.scenario.actuators.delay == paper.actuators.delay
    assert found.sections()[-1].verdict == "warning"
    assert "as the log does" not in found.sections()[-1].sentences[0]


@pytest.mark.slow
def test_a_bandwidth_beyond_what_is_searched_has_no_upper_end(paper: hs.Scenario) -> None:
    """A drive that is at its command after a tick: any bandwidth from some on is it."""
    random = np.random.default_rng(SEED)
    commands = 0.2 + wandering(random, 200, 0.01, 0.004, 0.2)
    joints = np.concatenate([commands[:1], commands[:-1]]) + random.normal(0.0, 1e-6, commands.shape)
    log = Log(0.01 * np.arange(200.0), 0.01, commands, joints, None)
    found = fit_drives(log, METRES)
    bandwidth = found.fits[0].bandwidth
    assert bandwidth is not None
    assert bandwidth.high == np.inf
    assert "actuators.position.bandwidth" not in changes_of(log, paper, found, None)
    assert found.section().verdict != "good"


@pytest.fixture(scope="module")
def slow_legs() -> tuple[Log, Drives]:
    """A log of two legs with one slow pole, 2 zeta/omega = 0.25 s, whose noise hides the other pole."""
    random = np.random.default_rng(SEED)
    commands = np.full((250, 6), 0.2)
    commands[:, [1, 3]] += wandering(random, 250, 0.02, 0.004, 0.6)[:, [1, 3]]
    log = record(commands, 0.02, [Drive(8.0, np.pi * 8.0 * 0.25)] * 6, 3e-4, random)
    return log, fit_drives(log, METRES, delays=(0,))


def test_legs_with_a_slow_pole_give_a_pair_with_their_lag(paper: hs.Scenario, slow_legs: tuple[Log, Drives]) -> None:
    log, found = slow_legs
    assert not any(fit.response_is_known for fit in found.moved)
    identified = paper.updated(changes_of(log, paper, found, None)).actuators.position
    assert identified.damping / (np.pi * identified.bandwidth) == pytest.approx(0.25, rel=0.1)
    assert all(fit.lag is not None and fit.lag.low < 0.25 < fit.lag.high for fit in found.moved)
    section = found.section()
    assert section.verdict == "warning"
    assert any(
        "Only 2 zeta/omega, the lag of a slow leg, is determined of legs 2, 4: 0.2" in s for s in section.sentences
    )
    assert any("only stand for the mean lag of 0.2" in sentence for sentence in section.sentences)


def test_bandwidth_and_damping_are_keys_together_or_not_at_all(
    paper: hs.Scenario, slow_legs: tuple[Log, Drives]
) -> None:
    log, slow = slow_legs
    known, unknown = Interval(8.0, 7.0, 9.0), Interval(8.0, -np.inf, np.inf)

    def keys_of(bandwidth: Interval, damping: Interval, lag: Interval) -> dict[str, Any]:
        fits = [
            replace(fit, bandwidth=bandwidth, damping=damping, lag=lag) if fit.bandwidth else fit for fit in slow.fits
        ]
        changes = changes_of(log, paper, replace(slow, fits=tuple(fits)), None)
        return {key.split(".")[-1]: changes[key] for key in changes if key.endswith(("bandwidth", "damping"))}

    assert keys_of(known, known, unknown) == {"bandwidth": 8.0, "damping": 8.0}
    for one, other in [(known, unknown), (unknown, known), (unknown, unknown)]:
        assert keys_of(one, other, unknown) == {}
        pair = keys_of(one, other, Interval(0.25, 0.24, 0.26))
        assert pair["damping"] / (np.pi * pair["bandwidth"]) == pytest.approx(0.25, rel=1e-5)


def test_the_table_of_keys_names_what_the_log_does_not_determine(
    paper: hs.Scenario, slow_legs: tuple[Log, Drives], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a delay in ticks of 20 ms: 1.4, and at the most that is tried; and of a pair that no leg determines."""
    log, slow = slow_legs
    machine = paper.updated({"simulation.mode": "sampled", "simulation.step": 0.005, "actuators.delay": 0.035})
    known = Interval(1.0, 0.9, 1.1)
    unknown = Interval(1.0, -np.inf, np.inf)

    def rows_of(delay: Interval, response: Interval) -> dict[str, Any]:
        found = with_fits(slow, delay=[delay] * 6, bandwidth=[response] * 6, damping=[response] * 6, lag=[response] * 6)
        found = replace(found, fits=tuple(replace(fit, at_edge=not response.is_bounded) for fit in found.fits))
        monkeypatch.setattr("hexservo.findings.identification.fit_drives", lambda *_, **__: found)
        (table,) = hs.identify(log, machine).sections()[-1].items
        assert isinstance(table, Table)
        return {str(key): value for key, value, _ in table.rows}

    rows = rows_of(Interval(1.4, 1.3, 1.5), known)
    assert rows["actuators.delay"] == "0.02 (0.028 before rounding)"
    assert rows["actuators.position.bandwidth"] == "1"
    rows = rows_of(Interval(8.0, 7.5, np.inf), unknown)
    assert rows["actuators.delay"] == "0.04 (not determined, whole ticks)"
    assert rows["actuators.position.bandwidth"].endswith(" (not determined)")
    assert rows["actuators.position.damping"].endswith(" (not determined)")


def with_fits(found: Drives, **changed: list[Any]) -> Drives:
    """The same drives with other numbers of the six legs, taken from the first that moved."""
    one = found.moved[0]
    fits = [replace(one, leg=leg + 1, **{name: values[leg] for name, values in changed.items()}) for leg in range(6)]
    return replace(found, fits=tuple(fits))


def test_best_fits_that_agree_stand_for_what_no_leg_determines_by_itself(
    paper: hs.Scenario, slow_legs: tuple[Log, Drives]
) -> None:
    """As of soft legs that the platform couples; where they do not agree, or are at an edge, the keys are left."""
    log, slow = slow_legs
    open_ended = [Interval(value, -np.inf, np.inf) for value in (1.72, 1.76, 1.78, 1.81, 1.84, 1.89)]
    lags = [Interval(value, -np.inf, np.inf) for value in (0.110, 0.119, 0.121, 0.141, 0.146, 0.146)]
    agreeing = with_fits(slow, bandwidth=open_ended, damping=open_ended, lag=lags)
    changes = changes_of(log, paper, agreeing, None)
    found = [changes[f"actuators.position.{name}"] for name in ("bandwidth", "damping")]
    assert found[0] == pytest.approx(np.exp(np.mean(np.log([one.value for one in open_ended]))), rel=1e-5)
    assert found[1] / (np.pi * found[0]) == pytest.approx(
        np.exp(np.mean(np.log([lag.value for lag in lags]))), rel=1e-5
    )
    assert any("best fits, 0.13" in sentence and "agree" in sentence for sentence in agreeing.section().sentences)
    apart = [*lags[:-1], Interval(0.2, -np.inf, np.inf)]
    for unlike in (
        with_fits(slow, bandwidth=open_ended, damping=open_ended, lag=apart),
        with_fits(slow, bandwidth=open_ended, damping=open_ended, lag=lags, at_edge=[True] * 3 + [False] * 3),
    ):
        assert "actuators.position.bandwidth" not in changes_of(log, paper, unlike, None)
        assert any("are left as they are" in sentence for sentence in unlike.section().sentences)


def test_one_value_of_all_legs_is_that_of_those_that_know_it() -> None:
    """Each counts by the inverse of its variance: three that know 1 to a factor of 2, and one 2 to 1 %."""
    legs = [Interval(1.0, 0.5, 2.0)] * 3 + [Interval(2.0, 2.0 / 1.01, 2.0 * 1.01)]
    weights = np.array([3.0 / np.log(2.0) ** 2, 1.0 / np.log(1.01) ** 2])
    expected = np.exp(weights[1] * np.log(2.0) / weights.sum())
    assert mean_of(legs) == pytest.approx(expected, rel=1e-12)
    assert expected == pytest.approx(2.0, rel=1e-3)
    assert mean_of([*legs[:3], None]) is None


def test_no_key_is_taken_from_legs_of_which_little_is_predicted(
    paper: hs.Scenario, slow_legs: tuple[Log, Drives]
) -> None:
    log, slow = slow_legs
    bandwidths = [Interval(8.0, 7.9, 8.1)] * 5 + [Interval(2.0, 1.99, 2.01)]
    damping = [Interval(1.0, 0.9, 1.1)] * 6

    def with_shares(*explained: float) -> Drives:
        return with_fits(slow, bandwidth=bandwidths, damping=damping, explained=list(explained))

    found = with_shares(0.9, 0.9, 0.8, 0.7, 0.6, 0.4)
    assert changes_of(log, paper, found, None)["actuators.position.bandwidth"] == pytest.approx(8.0)
    section = found.section()
    assert section.verdict == "warning"
    assert any("Less than half of the motion of leg 6 is predicted" in sentence for sentence in section.sentences)
    for useless in (with_shares(0.9, 0.9, 0.9, 0.9, 0.9, -0.1), with_shares(0.9, 0.9, 0.9, 0.4, 0.4, 0.4)):
        assert not any(key.startswith("actuators") for key in changes_of(log, paper, useless, None))
        assert useless.section().verdict == "bad"


@pytest.mark.parametrize(("name", "reached"), [("speed_limit", "fastest"), ("acceleration_limit", "hardest")])
def test_a_limit_that_the_log_does_not_determine_is_the_one_that_is_given(
    slow_legs: tuple[Log, Drives], name: str, reached: str
) -> None:
    log, slow = slow_legs
    key = f"actuators.position.{name}"
    machine = hs.load_scenario("pi-h824-positions", {key: 0.02})
    known = [Interval(8.0, 7.9, 8.1)] * 6
    limit, none = Interval(0.02, 0.0199, 0.0201), None

    def found(limits: list[Interval | None], most: list[float]) -> tuple[dict[str, Any], Any]:
        numbers: dict[str, list[Any]] = {name: limits, reached: most}
        drives = with_fits(slow, bandwidth=known, damping=known, **numbers)
        return changes_of(log, machine, drives, None), drives.section()

    changes, section = found([none] * 6, [0.004] * 6)
    assert key not in changes
    assert section.verdict == "good"
    for most in ([0.03] * 6, [0.03] + 5 * [0.004]):  # legs that are too slow for the limit do not show that it acts
        assert found([none] * 6, most)[0][key] is None
    assert key not in found([none] * 6, [0.0215] * 6)[0]  # it would act for a moment only
    changes, section = found([limit] * 3 + [none] * 3, [0.02] * 3 + [0.08] * 3)
    assert key not in changes
    assert section.verdict == "warning"
    assert any(f"A limit of the {name.split('_')[0]} is seen in legs 1, 2, 3: too few" in s for s in section.sentences)
    assert found([limit] * 2 + [none] * 4, [0.02] * 2 + [0.08] * 4)[0][key] is None
    unknown = Interval(0.02, -np.inf, np.inf)
    assert key not in found([unknown] * 6, [0.02] * 6)[0]
    changes, section = found([limit] * 4 + [none] * 2, [0.02] * 4 + [0.02, 0.08])
    assert changes[key] == 0.02
    assert section.verdict == "warning"
    assert any("theirs; leg 6 went beyond it" in sentence for sentence in section.sentences)


def test_the_lag_of_a_fast_leg_at_an_edge_is_not_determined() -> None:
    """Its true bandwidth may be beyond what is searched, and the lag of that is shorter."""
    random = np.random.default_rng(SEED)
    commands = np.full((200, 6), 0.2)
    commands[:, 3] += wandering(random, 200, 0.01, 0.004, 0.2)[:, 3]
    joints = np.concatenate([commands[:1], commands[:-1]]) + random.normal(0.0, 1e-6, commands.shape)
    log = Log(0.01 * np.arange(200.0), 0.01, commands, joints, None)
    found = fit_drives(log, METRES, delays=(0,))
    assert found.moved[0].lag is not None
    assert not found.moved[0].lag.is_bounded
    sentences = found.section().sentences
    assert any("and not 2 zeta/omega either" in sentence for sentence in sentences)
    assert any("are left as they are" in sentence for sentence in sentences)


@pytest.mark.parametrize("change", ["opposite", "exchanged"])
def test_joints_that_do_not_follow_the_commands_give_no_drive(paper: hs.Scenario, change: str) -> None:
    random = np.random.default_rng(SEED)
    commands = np.full((200, 6), 0.2)
    commands[:, 3] += wandering(random, 200, 0.01, 0.004, 0.2)[:, 3]
    log = record(commands, 0.01, [Drive(2.0, 0.9, 1)] * 6, 1e-6, random)
    if change == "opposite":
        log = replace(log, joints=0.4 - log.joints)
    else:
        log = replace(log, joints=log.commands, commands=log.joints)
    found = fit_drives(log, METRES, delays=(0, 1))
    assert not found.explains
    section = found.section()
    assert section.verdict == "bad"
    reason = "exchanged, or of opposite sign" if change == "opposite" else "they are exchanged in the log"
    assert reason in section.sentences[0]
    assert "predicts at least" not in section.sentences[0]
    assert not any(key.startswith("actuators") for key in changes_of(log, paper, found, None))


def test_exchanged_commands_and_joints_give_no_key_and_no_error_of_exposure_times(paper: hs.Scenario) -> None:
    """Quick drives answer so soon that a ringing response to the joints predicts more than half of the commands."""
    random = np.random.default_rng(SEED)
    commands = np.full((250, 6), 0.2)
    commands[:, 3] += wandering(random, 250, 0.02, 0.004, 0.5)[:, 3]
    log = record(commands, 0.02, [Drive(10.0, 1.0)] * 6, 1e-6, random)
    log = replace(log, joints=log.commands, commands=log.joints, frames=seen_log(paper, 0.05, stamps=0.0).frames)
    found = fit_drives(log, METRES, delays=(0,))
    assert found.worst is not None
    assert found.worst.explained is not None
    assert 0.5 < found.worst.explained < 0.95
    section = found.section()
    assert section.verdict == "bad"
    assert "they are exchanged in the log" in section.sentences[0]
    camera = fit_camera(log, Scene(paper), found)
    assert "exchanged" in camera.section().sentences[0]
    assert set(changes_of(log, paper, found, camera)) == {"simulation.mode", "simulation.step"}
    wrong = CameraFit(100, explained=1.0, stamps=Interval(0.05, 0.049, 0.051))
    scenario = hs.load_scenario("pi-h824-positions")
    assert faults_of(scenario, drives_of_seen_log(), wrong)
    assert faults_of(scenario, found, wrong) == {}


def test_diagnose_names_what_the_log_does_not_give(paper: hs.Scenario, tmp_path: Path) -> None:
    random = np.random.default_rng(SEED)
    commands = np.full((60, 6), 0.2)
    commands[:, 3] += wandering(random, 60, 0.01, 0.004, 0.1)[:, 3]
    log = record(commands, 0.01, [Drive(5.0, 0.9)] * 6, 1e-6, random)
    names = ["time", *(f"{kind}_{leg}" for kind in ("command", "joint") for leg in range(1, 7))]
    table = np.column_stack([log.time, commands, 0.4 - log.joints])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=",".join(names), comments="")
    arguments = ["--machine", "paper", "--set", "simulation.duration=0.1"]
    done = CliRunner().invoke(app, ["diagnose", str(tmp_path / "log.csv"), *arguments])
    assert "Drives of the legs: Fitted to" in done.stderr
    assert "no key of the drives is taken over" in done.stderr


@pytest.mark.slow
def test_a_leg_that_rests_in_the_part_kept_apart_is_not_judged_there() -> None:
    """What is predicted is stated of the legs that move there alone, and rounded down."""
    random = np.random.default_rng(SEED)
    commands = 0.2 + wandering(random, 200, 0.01, 0.004, 0.2)
    commands[120:, 2] = commands[120, 2]
    found = fit_drives(record(commands, 0.01, [Drive(5.0, 0.9)] * 6, 5e-6, random), METRES)
    assert found.fits[2].bandwidth is not None
    assert found.fits[2].explained is None
    first = found.section().sentences[0]
    assert "at least 99.99 % of the motion of each of legs 1, 2, 4, 5, 6 in" in first
    assert found.worst is not None
    assert found.worst.explained is not None
    assert found.worst.explained >= 0.9999
    rests = replace(found, fits=tuple(replace(fit, explained=None) for fit in found.fits))
    assert "what the model predicts is not known" in rests.section().sentences[0]
    assert rests.section().verdict == "warning"


def test_intervals_without_an_end_are_written_with_the_other_one() -> None:
    assert with_interval(Interval(8.0, 8.0, np.inf)) == "at least 8"
    assert with_interval(Interval(8.0, 7.0, np.inf)) == "8 (7 or more)"
    assert with_interval(Interval(0.2, -np.inf, 0.3)) == "0.2 (0.3 or less)"
    assert with_interval(Interval(4.214, -np.inf, np.inf)) == "4.21 (not determined)"


def test_a_number_known_to_a_factor_of_100_is_not_determined() -> None:
    assert Interval.of_logarithm(2.0, np.log(9.9) / 1.96).is_bounded
    assert Interval.of_logarithm(2.0, np.log(10.1) / 1.96) == Interval(2.0, -np.inf, np.inf)
    assert Interval.of_logarithm(2.0, np.inf) == Interval(2.0, -np.inf, np.inf)
    assert Interval(2.0, 1.9, np.inf).determined() == Interval(2.0, 1.9, np.inf)
    assert Interval(2.0, 1e-15, np.inf).determined() == Interval(2.0, -np.inf, np.inf)


@pytest.mark.parametrize("stamps", [None, 0.2])
def test_a_latency_beyond_what_is_searched_has_no_upper_end(paper: hs.Scenario, stamps: float | None) -> None:
    log = seen_log(paper, 0.3, stamps=stamps)
    camera = fit_camera(log, Scene(paper))
    assert camera.at_edge
    assert camera.latency is not None
    assert camera.latency.low < 0.3
    assert camera.latency.high == np.inf
    section = camera.section()
    assert section.verdict == "warning"
    assert "at least" in section.sentences[0]
    assert "does not tell" not in section.sentences[0]
    changes = changes_of(log, paper, drives_of_seen_log(), camera)
    assert "camera.period" in changes
    assert not {"camera.latency", "camera.latency_jitter", "camera.noise"} & set(changes)


def test_exposure_times_that_are_far_too_early_have_no_lower_end(paper: hs.Scenario) -> None:
    camera = fit_camera(seen_log(paper, 0.01, stamps=-0.2), Scene(paper))
    assert camera.stamps is not None
    assert camera.stamps.low == -np.inf
    assert np.isfinite(camera.stamps.high)
    assert "after what they state" in camera.section().sentences[0]


@pytest.mark.parametrize("change", ["y up", "another order"])
def test_images_that_the_joints_do_not_predict_give_no_camera(paper: hs.Scenario, change: str) -> None:
    log = seen_log(paper, 0.05, stamps=None)
    assert log.frames is not None
    points = log.frames.features.reshape(-1, 4, 2)
    wrong = points * [1.0, -1.0] if change == "y up" else points[:, [1, 0, 2, 3]]
    camera = fit_camera(replace(log, frames=replace(log.frames, features=wrong.reshape(-1, 8))), Scene(paper))
    assert not camera.explains
    section = camera.section()
    assert section.verdict == "bad"
    assert "another order of the points" in section.sentences[0]
    assert "y up in place of down" in section.sentences[0]
    changes = changes_of(log, paper, drives_of_seen_log(), camera)
    assert not any(key.startswith("camera") for key in changes)


@pytest.mark.parametrize("stamps", [None, -0.02])
def test_a_timeout_that_measured_times_exceed_is_raised_and_named(
    stamps: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By as little as the core takes; frames that are stamped too early are older for the controller."""
    try_delays(monkeypatch, 1)
    machine = hs.load_scenario("pi-h824-positions", {"camera.timeout": 0.1, "camera.latency": 0.0})
    log = seen_log(machine, 0.15, stamps=stamps)
    found = hs.identify(log, machine)
    assert found.changes["camera.timeout"] == pytest.approx(0.18 if stamps is None else 0.2)
    assert found.as_logged.camera.timeout == found.scenario.camera.timeout
    timeout = found.scenario.camera.timeout
    assert timeout is not None
    with pytest.raises(ValueError, match=r"camera\.timeout"):
        found.as_logged.updated({"camera.timeout": timeout - 0.01})
    section = found.sections()[-1]
    assert section.verdict == "warning"
    assert any("`camera.timeout` of 100 ms conflicts" in sentence for sentence in section.sentences)
    room = hs.identify(log, machine.updated({"camera.timeout": 0.2}))
    assert "camera.timeout" not in room.changes


def test_times_in_milliseconds_that_are_possible_seconds_are_named(
    paper: hs.Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A loop of 2 kHz has ticks of 0.5 ms, and a log with 0.5 s between ticks is not refused."""
    machine = hs.load_scenario("pi-h824-positions")  # whose drives have 10 Hz
    random = np.random.default_rng(SEED)
    commands = np.full((2500, 6), 0.2)
    commands[:, 3] += wandering(random, 2500, 0.5, 1e-3, 200.0)[:, 3]
    in_ms = record(commands, 0.5, [Drive(0.01, 0.8, 4)] * 6, 1e-7, random)  # 10 Hz and 1.25 s in ms
    found = fit_drives(in_ms, METRES, delays=(4,))
    named = in_milliseconds(machine, found)
    assert named is not None
    assert list(named) == [pytest.approx(0.01, rel=0.01), 10.0, pytest.approx(1250.0)]
    as_slow = machine.updated({"actuators.position.bandwidth": 0.02})
    for other in (as_slow, paper):  # the legs of the latter take forces
        assert in_milliseconds(other, found) is None
    assert in_milliseconds(machine, replace(found, fitted=70.0, apart=30.0)) is None  # a slow machine in 100 s

    monkeypatch.setattr("hexservo.findings.identification.fit_drives", lambda *_, **__: found)
    monkeypatch.setattr("hexservo.findings.identification.require_reach", lambda *_: None)
    section = hs.identify(in_ms, machine).sections()[-1]
    assert section.verdict == "warning"
    assert section.sentences[0] == (
        "Are the times of the log in ms? As seconds it has 1250 s, and drives of 0.01 Hz, 1000 times slower than those "
        "that were given (actuators.position.bandwidth, 10 Hz). If so, divide the times by 1000, arrival and exposure "
        "too."
    )
    assert not any("in ms?" in words for words in hs.identify(in_ms, as_slow).sections()[-1].sentences)
