"""Speed and joint limits of the legs: events, metrics, the end of a run, reach, check and diagnosis.

Rates and angles are computed from the logged poses, with SciPy's rotations and the joints of the geometry.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo import _core
from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check import unlikely
from hexservo.findings.diagnosis.causes import CAUSES
from hexservo.findings.diagnosis.evidence import SIGNATURES
from hexservo.findings.diagnosis.ranking import judged, make_cases
from hexservo.findings.diagnosis.runs import record_of
from hexservo.findings.diagnosis.words import misses
from hexservo.findings.evidence import Table
from hexservo.run.leg_limits import LimitUse, limits_of_motion, most_used
from hexservo.run.leg_motion import singular_passage
from hexservo.run.summary import summary_sentences
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.wording import number
from without_runs import unlikely_without_runs

Array = NDArray[np.float64]
KINDS = ("speed", "base_joint", "platform_joint")
JOINTS = (0.09, 0.12)  # [rad], at base and platform
METRICS = ("peak_leg_speed", "peak_base_joint", "peak_platform_joint")


def peaks(result: hs.Result) -> dict[str, Array]:
    """Kind -> (n, 6): leg rates [m/s] by H^T, and angles from home [rad], of the samples of a run.

    A rate is at least the mean since the sample before.
    """
    hexapod = _core.Hexapod(core_parameters(result.scenario).robot)

    def directions(position: Array, quaternion: Array) -> tuple[Array, Array, Array]:
        turn = Rotation.from_quat(np.roll(quaternion, -1))
        arms = turn.apply(hexapod.platform_joints)
        legs = position + arms - hexapod.base_joints
        legs /= np.linalg.norm(legs, axis=1)[:, None]
        return legs, turn.inv().apply(legs), arms

    def angles(a: Array, b: Array) -> Array:
        return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1)))

    home = directions(hexapod.home_position, hexapod.home_quaternion)
    rows: dict[str, list[Array]] = {kind: [] for kind in KINDS}
    for position, quaternion, twist in zip(result.position, result.quaternion, result.twist, strict=True):
        in_base, in_platform, arms = directions(position, quaternion)
        rows["speed"].append(np.abs((in_base * (twist[:3] + np.cross(twist[3:], arms))).sum(axis=1)))
        rows["base_joint"].append(angles(in_base, home[0]))
        rows["platform_joint"].append(angles(in_platform, home[1]))
    found = {kind: np.array(values) for kind, values in rows.items()}
    every = result.scenario.robot.limits_every
    lengths, time = result.leg_lengths[::every], result.time[::every]
    means = np.abs(np.diff(lengths, axis=0)) / np.diff(time)[:, None]
    found["speed"][every::every] = np.maximum(found["speed"][every::every], means)
    return found


@pytest.fixture(scope="module")
def short(paper: hs.Scenario) -> hs.Scenario:
    return paper.updated({"simulation.duration": 1.0, "robot.home_attitude": [0.05, -0.1, 0.3]})


@pytest.fixture(scope="module")
def free(short: hs.Scenario) -> dict[str, Array]:
    """The motion is that of the legs without limits."""
    return peaks(hs.simulate(short))


def limited(free: dict[str, Array], share: float) -> dict[str, Any]:
    largest = {kind: share * float(values.max()) for kind, values in free.items()}
    return {
        "robot.speed_limit": largest["speed"],
        "robot.joint_limit": [largest["base_joint"], largest["platform_joint"]],
    }


def test_events_and_metrics_are_those_of_the_samples(short: hs.Scenario, free: dict[str, Array]) -> None:
    scenario = short.updated(limited(free, 0.7))
    result = hs.simulate(scenario)
    reference = hs.simulate(short)
    np.testing.assert_array_equal(result.position, reference.position)  # limits are reported, not enforced
    assert [event.kind for event in result.events if event.kind not in KINDS] == [e.kind for e in reference.events]
    base, platform = scenario.robot.joint_limit or (0.0, 0.0)
    limits = {"speed": scenario.robot.speed_limit or 0.0, "base_joint": base, "platform_joint": platform}
    for kind, metric in zip(KINDS, METRICS, strict=True):
        values = free[kind]
        # a chord of unit vectors loses nothing near home: a dozen roundings of numbers below 1
        assert hs.metrics(result)[metric] == pytest.approx(values.max(), rel=1e-12, abs=1e-14)
        found = {event.leg: event for event in result.events if event.kind == kind}
        beyond = {leg + 1 for leg in range(6) if values[:, leg].max() > limits[kind]}
        assert found.keys() == beyond
        assert beyond
        for leg, event in found.items():
            assert event.time == result.time[np.argmax(values[:, leg - 1] > limits[kind])]
            assert event.peak == pytest.approx(values[:, leg - 1].max(), rel=1e-12, abs=1e-14)
            assert event.limit == pytest.approx(limits[kind], rel=1e-15)


def test_without_a_limit_there_is_neither_event_nor_metric(short: hs.Scenario, free: dict[str, Array]) -> None:
    result = hs.simulate(short)
    assert not [event for event in result.events if event.kind in KINDS]
    assert all(math.isnan(hs.metrics(result)[name]) for name in METRICS)
    wide = hs.simulate(short.updated({**limited(free, 1.0 + 1e-9), "robot.joint_limit": [math.pi, math.pi]}))
    assert not [event for event in wide.events if event.kind in KINDS]
    assert hs.metrics(wide)["peak_leg_speed"] == pytest.approx(free["speed"].max(), rel=1e-12)


def test_lanes_of_a_batch_have_the_metrics_of_single_runs(short: hs.Scenario, free: dict[str, Array]) -> None:
    speed = float(free["speed"].max())
    batch = hs.simulate_batch(short, {"robot.speed_limit": [speed, 0.5 * speed, 0.1 * speed]})
    np.testing.assert_allclose(batch.metrics["peak_leg_speed"], speed, rtol=1e-9)
    assert np.isnan(batch.metrics["peak_base_joint"]).all()


@pytest.fixture(scope="module")
def machine() -> hs.Scenario:
    return hs.load_scenario("real-machine").updated({"simulation.duration": 0.4})


@pytest.mark.parametrize("kind", KINDS)
def test_stop_ends_a_run_at_the_first_tick_beyond(machine: hs.Scenario, kind: str) -> None:
    values = peaks(hs.simulate(machine))[kind]
    limit = 0.6 * float(values.max())
    key = {"robot.speed_limit": limit} if kind == "speed" else {"robot.joint_limit": [limit, math.pi]}
    key = {"robot.joint_limit": [math.pi, limit]} if kind == "platform_joint" else key
    result = hs.simulate(machine.updated({**key, "robot.on_limit": "stop"}))
    first = int(np.argmax((values > limit).any(axis=1)))
    assert first > 1
    leg = int(values[first].argmax()) + 1
    words = {
        "speed": f"leg {leg} passed its speed limit",
        "base_joint": f"the base joint of leg {leg} passed its limit",
        "platform_joint": f"the platform joint of leg {leg} passed its limit",
    }
    assert result.outcome == "leg_limit"
    assert result.detail.startswith(words[kind])
    assert len(result.time) == first  # the last good sample is the one before
    batch = hs.simulate_batch(machine.updated({**key, "robot.on_limit": "stop"}), {"seed": [machine.seed] * 2})
    assert list(batch.outcome) == ["leg_limit"] * 2
    assert list(batch.limit_leg) == [leg] * 2
    assert batch.detail(1) == result.detail


@pytest.mark.parametrize("name", ["reachy-mini", "pi-h824-positions"])
def test_legs_that_are_fastest_between_two_ticks(name: str) -> None:
    """Fast drives stand still again where they are looked at: their way over a period shows how fast they were."""
    free = hs.load_scenario(name).updated({"actuators.position": {"bandwidth": 100.0, "damping": 1.0}})
    run = hs.simulate(free)
    means = np.abs(np.diff(run.leg_lengths, axis=0)).max(axis=1) / free.simulation.step
    fastest = float(means.max())
    slower = free.updated({"robot.speed_limit": 0.5 * fastest})
    beyond = hs.simulate(slower)
    assert hs.metrics(beyond)["peak_leg_speed"] >= fastest * (1.0 - 1e-9)
    first = min(event.time for event in beyond.events if event.kind == "speed")
    assert first <= run.time[1 + int((means > 0.5 * fastest * (1.0 + 1e-9)).argmax())]
    stopped = hs.simulate(slower.updated({"robot.on_limit": "stop"}))
    assert stopped.outcome != "completed"
    assert stopped.time[-1] == pytest.approx(first - free.simulation.step)


def test_legs_at_their_drives_own_limit_are_not_beyond_it() -> None:
    """A machine whose drives have the limit that is reported: rounding is no event."""
    machine = hs.load_scenario("pi-h824-positions")
    most = machine.actuators.position.speed_limit
    assert most is not None
    run = hs.simulate(machine.updated({"robot.speed_limit": most, "robot.on_limit": "stop"}))
    assert run.outcome == "completed"
    assert not [event for event in run.events if event.kind == "speed"]
    assert 0.9 * most <= hs.metrics(run)["peak_leg_speed"] <= most


@pytest.mark.parametrize("mode", ["continuous", "sampled"])
def test_limits_are_looked_at_in_every_so_many_steps(short: hs.Scenario, free: dict[str, Array], mode: str) -> None:
    """Events and metrics of the legs are those of every 7th sample, and nothing else changes."""
    each = short.updated({**limited(free, 0.7), "robot.force_limit": 0.1, "simulation.mode": mode})
    whole = hs.simulate(each)
    result = hs.simulate(each.updated({"robot.limits_every": 7}))
    for name in ("time", "position", "wrench", "leg_lengths", "leg_forces"):
        np.testing.assert_array_equal(getattr(result, name), getattr(whole, name))
    seen = {kind: values[::7] for kind, values in peaks(result).items()}
    seen |= {"force": np.abs(whole.leg_forces[::7])}
    base, platform = each.robot.joint_limit or (0.0, 0.0)
    limits = {"speed": each.robot.speed_limit or 0.0, "base_joint": base, "platform_joint": platform, "force": 0.1}
    found, all_found = hs.metrics(result), hs.metrics(whole)
    for kind, metric in zip((*KINDS, "force"), (*METRICS, "peak_leg_force"), strict=True):
        assert found[metric] == pytest.approx(seen[kind].max(), rel=1e-12, abs=1e-14)
        events = {event.leg: event.time for event in result.events if event.kind == kind}
        beyond = seen[kind] > limits[kind]
        times = {leg + 1: result.time[7 * np.argmax(beyond[:, leg])] for leg in range(6) if beyond[:, leg].any()}
        assert events == times
        assert times
    legs = {*METRICS, "peak_leg_force", "peak_leg_excursion"}
    assert all(found[name] == value or math.isnan(value) for name, value in all_found.items() if name not in legs)
    assert any(found[name] < all_found[name] for name in legs)
    batch = hs.simulate_batch(each, {"robot.limits_every": [1, 7, 7]}, "final")
    for index, single in enumerate((whole, result, result)):
        assert batch.metrics["peak_leg_force"][index] == pytest.approx(hs.metrics(single)["peak_leg_force"], rel=1e-9)
        np.testing.assert_allclose(batch.samples["leg_lengths"][index], whole.leg_lengths[-1], rtol=1e-9)
        np.testing.assert_allclose(batch.samples["leg_forces"][index], whole.leg_forces[-1], rtol=1e-9, atol=1e-9)


def test_stop_comes_at_the_first_look(machine: hs.Scenario) -> None:
    limit = 0.6 * float(peaks(hs.simulate(machine))["speed"].max())
    stop = machine.updated({"robot.speed_limit": limit, "robot.on_limit": "stop"})
    for every in (5, 9):
        values = peaks(hs.simulate(machine.updated({"robot.limits_every": every})))["speed"].max(axis=1)
        beyond = np.flatnonzero(values > limit)
        looks = beyond[beyond % every == 0]
        result = hs.simulate(stop.updated({"robot.limits_every": every}))
        assert len(looks)
        assert len(result.time) == looks[0]
        assert looks[0] > beyond[0]


def test_reachable_counts_joint_limits(paper: hs.Scenario) -> None:
    """Against a search on a grid: margins, the limit that binds, and a nearest pose that no grid pose beats."""
    scenario = paper.updated({"robot.joint_limit": list(JOINTS)})
    hexapod = _core.Hexapod(core_parameters(scenario).robot)
    random = np.random.default_rng(4)

    def used(pose: Array) -> Array:
        turn = Rotation.from_rotvec(pose[3:])
        legs = hexapod.home_position + pose[:3] + turn.apply(hexapod.platform_joints) - hexapod.base_joints
        home = hexapod.home_position + hexapod.platform_joints - hexapod.base_joints
        travel = np.abs(np.linalg.norm(legs, axis=1) - np.linalg.norm(home, axis=1)) / scenario.robot.stroke
        cosines = [(legs * home).sum(axis=1), (turn.inv().apply(legs) * home).sum(axis=1)]
        lengths = np.linalg.norm(legs, axis=1) * np.linalg.norm(home, axis=1)
        tilts = [np.arccos(np.minimum(c / lengths, 1.0)) / j for c, j in zip(cosines, JOINTS, strict=True)]
        return np.array([travel, *tilts])

    def smallest_singular_value(pose: Array) -> float:
        arms = Rotation.from_rotvec(pose[3:]).apply(hexapod.platform_joints)
        legs = hexapod.home_position + pose[:3] + arms - hexapod.base_joints
        units = legs / np.linalg.norm(legs, axis=1)[:, None]
        wrenches = np.hstack([units, np.cross(arms, units) / hexapod.platform_radius])
        return float(np.linalg.svd(wrenches, compute_uv=False).min())

    kinds = set()
    for _ in range(40):
        pose = random.normal(size=6) * np.array([6e-3, 6e-3, 6e-3, 0.06, 0.06, 0.06])
        found, shares = hs.reachable(scenario, pose), used(pose)
        row, leg = np.unravel_index(int(shares.argmax()), shares.shape)
        assert found.within == (shares.max() <= 1.0)
        limit = (scenario.robot.stroke, *JOINTS)[row]
        assert found.limit == ("stroke", "base_joint", "platform_joint")[row]
        assert found.leg == leg + 1
        assert found.margin == pytest.approx(limit * (1.0 - shares[row, leg]), abs=1e-9)
        assert found.singularity == pytest.approx(smallest_singular_value(pose), rel=1e-9)
        kinds.add((found.limit, found.within))
        assert used(found.nearest).max() <= 1.0 + 1e-8
        if not found.within:
            metric = np.repeat([1.0, hexapod.platform_radius], 3)
            near = found.nearest + random.normal(size=(300, 6)) * 0.03 * found.distance / metric
            better = [p for p in near if np.linalg.norm((p - pose) * metric) < (1.0 - 1e-3) * found.distance]
            assert all(used(p).max() > 1.0 for p in better)
    assert {kind for kind, _ in kinds} == {"stroke", "base_joint", "platform_joint"}
    assert {within for _, within in kinds} == {True, False}
    aside = np.array([0.03, 0.0, 0.0, 0.0, 0.0, 0.0])
    beyond, sentence = hs.reachable(scenario, aside), str(hs.reachable(scenario, aside))
    tilt = JOINTS[0] * (used(aside)[1].max() - 1.0)
    away = np.linalg.norm((beyond.nearest - aside) * np.repeat([1.0, hexapod.platform_radius], 3))
    assert f"the base joint of leg {beyond.leg} would be {1e3 * tilt:.3g} mrad beyond its limit" in sentence
    assert f"the nearest pose within is {1e3 * away:.3g} mm away" in sentence


def test_the_limit_that_is_used_most_is_that_of_the_largest_share(paper: hs.Scenario) -> None:
    """16 of 17 mm are more than 0.1 of 0.3 rad, and 1 of 17 mm are less."""
    scenario = paper.updated({"robot.joint_limit": [0.3, 0.3]})
    for travel, tilts, kind in ((0.016, (0.1, 0.1), "stroke"), (0.001, (0.1, 0.2), "platform_joint")):
        values = (travel, math.nan, *tilts)
        use = most_used(scenario, dict(zip(("peak_leg_excursion", *METRICS), values, strict=True)))
        assert use.limit.kind == kind


def test_check_finds_goals_and_starts_beyond(paper: hs.Scenario) -> None:
    assert not unlikely(paper)
    (beyond,) = unlikely(paper.updated({"robot.joint_limit": [0.01, 1.0]}))
    assert beyond.startswith("target.desired_features: the goal is out of reach: the base joint of leg ")
    moving = {"robot.speed_limit": 0.01, "simulation.start.twist": [0.0, 0.0, 0.05, 0.0, 0.0, 0.0]}
    (fast,) = unlikely(paper.updated(moving))
    assert fast.startswith("robot.speed_limit: 10 mm/s is less than the ")


def test_a_run_that_stops_at_a_limit_has_a_removal_and_a_remedy(machine: hs.Scenario) -> None:
    cause = next(cause for cause in CAUSES if cause.key == "leg_limits")
    speed = 0.5 * float(peaks(hs.simulate(machine))["speed"].max())
    scenario = machine.updated({"robot.speed_limit": speed, "robot.on_limit": "stop"})
    assert hs.simulate(scenario).outcome == "leg_limit"
    (case,) = make_cases([scenario])
    (removal,) = cause.removals(case)
    run = hs.simulate(scenario.updated(removal.changes))
    assert run.outcome == "completed"
    (remedy,) = cause.remedies(case, removal, record_of(run))
    assert set(remedy.changes) == {"robot.speed_limit"}
    assert hs.simulate(scenario.updated(remedy.changes)).outcome == "completed"


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_beyond_speed_or_joint_limits_fails(machine: hs.Scenario, kind: str) -> None:
    """With `on_limit: report`, as one beyond its stroke does; just within them it passes."""
    machine = machine.updated({"simulation.duration": 1.0})
    peak = float(peaks(hs.simulate(machine))[kind].max())

    def limit(share: float) -> dict[str, Any]:
        if kind == "speed":
            return {"robot.speed_limit": share * peak}
        return {"robot.joint_limit": [share * peak, 3.0] if kind == "base_joint" else [3.0, share * peak]}

    for share in (1.01, 0.5):
        scenario = machine.updated({**limit(share), "robot.on_limit": "report"})
        result = hs.simulate(scenario)
        judgement = judged(scenario, record_of(result))
        assert judgement.failed == (share < 1.0)
        metric = f"peak_{'leg_speed' if kind == 'speed' else kind}"
        assert judgement.limits[metric] == pytest.approx(1.0 / share, rel=1e-3)
        clauses = misses(result, record_of(result), judgement)
        assert len(clauses) == judgement.failed


def test_a_leg_just_beyond_its_stroke_is_not_written_as_at_its_stroke(paper: hs.Scenario) -> None:
    result = hs.simulate(paper.updated({"simulation.duration": 0.3}))
    beyond = replace(judged(result.scenario, record_of(result)), stroke=1 + 1e-6)
    assert "a leg goes 17.00002 mm, beyond its stroke of 17 mm" in misses(result, record_of(result), beyond)
    (stroke,) = (limit for limit in limits_of_motion(result.scenario) if limit.kind == "stroke")
    assert LimitUse(stroke, 0.017 * (1 + 1e-6)).excess == (
        "takes a leg 17.00002 mm from the middle of its travel, beyond its stroke of 17 mm"
    )
    # a run that `on_limit: stop` ends has its last sample just within
    assert LimitUse(stroke, 0.017 * (1 - 1e-6)).excess == "ends where a leg reaches its stroke of 17 mm"
    assert LimitUse(stroke, math.inf).excess == "ends early"


def test_a_goal_beyond_a_joint_limit_is_an_obstacle(machine: hs.Scenario) -> None:
    """Of a limit that even the nearest pose with the goal image exceeds, by 9 mrad."""
    (case,) = make_cases([machine.updated({"robot.joint_limit": [0.002, 3.0]})])
    assert case.obstacle is not None
    assert case.obstacle.beyond.startswith("the base joint of leg ")
    assert case.obstacle.leg_travel < machine.robot.stroke


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"robot.speed_limit": 0.0}, "robot.speed_limit: expected a number > 0 or null, got 0"),
        ({"robot.joint_limit": [0.1]}, "robot.joint_limit: expected 2 numbers > 0 and <= pi (radians)"),
        (
            {"robot.joint_limit": [0.1, 30.0]},
            "robot.joint_limit[1]: expected a number > 0 and <= pi (radians), got 30.0 (deg",
        ),
        ({"robot.joint_limit": [0.0, 0.1]}, "robot.joint_limit[0]: expected a number > 0 and <= pi (radians), got 0.0"),
    ],
)
def test_limits_that_are_none_are_refused(paper: hs.Scenario, changes: dict[str, Any], words: str) -> None:
    with pytest.raises(hs.ScenarioError) as error:
        paper.updated(changes)
    assert words in str(error.value)


def test_travel_is_counted_from_its_middle_in_every_sentence(paper: hs.Scenario) -> None:
    """With the middle 3 mm from home's length, the sentences have the travel from there."""
    scenario = paper.updated({"robot.stroke_centre": 0.003, "robot.stroke": 0.005, "simulation.duration": 1.0})
    goals = find_goals(scene_of(scenario))
    assert goals is not None
    pose = goals.best.view.pose
    legs = _core.Hexapod(core_parameters(scenario).robot)
    travel = np.abs(legs.leg_lengths(pose.position, pose.quaternion) - legs.home_lengths - 0.003)
    words = f"{number(1e3 * travel.max())} mm from the middle of its travel"
    (section,) = hs.analyse(scenario, ["workspace"]).sections()
    assert f"At the goal leg {travel.argmax() + 1} is {words}" in section.sentences[0]
    table = next(item for item in section.items if isinstance(item, Table))
    assert "Travel of the legs from its middle" in table.note
    result = hs.simulate(scenario)
    case = make_cases([scenario])[0]
    assert case.goal is not None
    assert case.goal.leg_travel == pytest.approx(travel.max(), rel=1e-9)
    evidence = SIGNATURES["leg_limits"](case, record_of(result), judged(scenario, record_of(result)))
    assert f"a leg is {words}" in evidence.sentence
    use = most_used(scenario, hs.metrics(result))
    taken = np.abs(result.leg_lengths - legs.home_lengths - 0.003).max()
    assert use.peak == pytest.approx(taken, rel=1e-9)
    assert use.excess.startswith(f"takes a leg {number(1e3 * taken)} mm from the middle of its travel")


@pytest.mark.parametrize("name", ["paper", "unknown-payload"])
def test_a_singular_pose_between_two_samples_is_named(name: str) -> None:
    """By the sign of the determinant of the legs' unit vectors and moments, formed here from the joints."""
    result = hs.simulate(hs.load_scenario(name))
    hexapod = _core.Hexapod(core_parameters(result.scenario).robot)
    arms = np.einsum(
        "nij,kj->nki",
        Rotation.from_quat(np.roll(result.quaternion, -1, axis=1)).as_matrix(),
        np.asarray(hexapod.platform_joints),
    )
    legs = result.position[:, None] + arms - np.asarray(hexapod.base_joints)
    units = legs / np.linalg.norm(legs, axis=2, keepdims=True)
    signs = np.sign(np.linalg.det(np.concatenate([units, np.cross(arms, units)], axis=2)))
    turned = np.flatnonzero(signs != signs[0])
    sentences = [sentence for sentence in summary_sentences(result) if "singular" in sentence]
    if name == "paper":
        assert len(turned) == 0
        assert singular_passage(result) is None
        assert not sentences
    else:
        assert singular_passage(result) == result.time[turned[0]]
        assert f"{result.time[turned[0]]:.4g} s" in sentences[0]


@pytest.mark.parametrize("travel", [*([0.0, 1e-3 * most] for most in (10, 17, 25, 30, 31)), [-0.03, 0.0]])
def test_a_machine_at_the_end_of_its_travel_is_within_it(travel: list[float]) -> None:
    """Home is the end, and the platform stays there: rounding alone puts legs beyond it, by 1e-17 m."""
    nominal = hs.load_scenario("paper-nominal")
    scenario = nominal.updated(
        {
            "controller.law": "kelly",
            "robot.stroke": travel,
            "robot.on_limit": "stop",
            "simulation.mode": "sampled",
            "simulation.duration": 0.02,
            "target.desired_features": hs.project(nominal, np.zeros(6)).tolist(),
        }
    )
    reached = hs.reachable(scenario, np.zeros(6))
    assert (reached.within, reached.margin) == (True, 0.0)
    assert not [words for words in unlikely_without_runs(scenario) if "out of reach" in words]
    run = hs.simulate(scenario)
    middle = _core.Hexapod(core_parameters(scenario).robot).mid_lengths
    away = np.abs(run.leg_lengths - middle) - scenario.robot.stroke
    assert np.abs(away).max() < 1e-14
    assert (run.outcome, run.events) == ("completed", ())
