"""What settles, by trial: the search itself on known borders, and its answers against single runs of the core."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis import largest_start
from hexservo.findings.analysis.largest_start import Direction, LargestStart, _largest
from hexservo.findings.analysis.largest_start_words import _by_seeds, _others, _sentences, _timing_words, border_words
from hexservo.findings.analysis.largest_times import camera_times
from hexservo.findings.analysis.scene import Scene, scene_of
from hexservo.findings.analysis.settling_runs import SettlingRuns, border


@pytest.fixture(scope="module")
def found() -> LargestStart:
    return largest_start.analyse(hs.load_scenario("paper"))


@pytest.fixture(scope="module")
def trap() -> LargestStart:
    # With a stroke that no run leaves: only the image error decides.
    return largest_start.analyse(hs.load_scenario("false-equilibrium").updated({"robot.stroke": 0.2}))


def direction(result: LargestStart, name: str) -> Direction:
    (only,) = (d for d in result.directions if d.name == name)
    return only


def settles(scenario: hs.Scenario, duration: float) -> bool:
    """Repeat it with a single run: within 2 px during the last 0.2 s, and within the stroke all the way."""
    result = hs.simulate(scenario.updated({"simulation.duration": duration}))
    last = result.time >= duration - 0.2 - 1e-9
    within = hs.metrics(result)["peak_leg_excursion"] <= scenario.robot.stroke
    return result.outcome == "completed" and within and float(np.abs(result.feature_error[last]).max()) <= 2.0


def goal_at(scenario: hs.Scenario, way: Direction, size: float) -> hs.Scenario:
    return scenario.updated({"target.desired_features": hs.project(scenario, size * way.unit).tolist()})


def of_seeds(settled: int, duration: float = 2.0) -> str:
    """Return what the section states of runs with four other seeds, of a duration [s]."""
    runs = f"of 4 runs of {duration:g} s with other seeds "
    return runs + ["none settle", "1 settles", "2 settle", "3 settle", "all settle"][settled]


# ---- The border of what was tried -----------------------------------------------------------------------------------


def test_a_border_lies_below_the_smallest_that_fails() -> None:
    assert border({1.0: True, 2.0: True, 3.0: False}) == (2.0, 3.0)
    assert border({1.0: True, 2.0: False, 3.0: True}) == (1.0, 2.0)  # not monotone: the larger one does not count
    assert border({1.0: True, 2.0: True}) == (2.0, None)
    assert border({1.0: False, 2.0: True}) == (0.0, 1.0)
    assert border({}) == (0.0, None)


def test_goals_outside_the_image_are_not_possible() -> None:
    """The largest goal has a point at the border, half the size from the centre; shifts of it are known by hand."""
    scenario = hs.load_scenario("fails-lost-features")
    scene = scene_of(scenario)
    assert scenario.camera.image_size is not None
    half = np.array(scenario.camera.image_size) / 2.0
    limits = []
    for axis in range(6):
        for sign in (1.0, -1.0):
            unit = np.zeros(6)
            unit[axis] = sign
            largest, limit = _largest(scene, unit)
            border = np.abs(hs.project(scenario, largest * unit)).reshape(-1, 2)
            limits.append(limit)
            if limit == "image":
                assert (border / half).max() == pytest.approx(1.0, abs=1e-3)
                assert (border <= half).all()
            else:
                assert (border < half).all()
    assert limits == ["image", "image", "image", "stroke", "stroke", *["image"] * 7]
    start = hs.project(scenario, np.zeros(6)).reshape(-1, 2)
    depth = float(scene.view(scene.home).mean_depth)
    left = (half[0] - start[:, 0].max()) * depth / scene.settings.camera.focal_pixels
    nearer = min(_largest(scene, sign * np.eye(6)[0])[0] for sign in (1.0, -1.0))
    cell = 0.7 * depth / 200.0**2  # of the grid and the one in its cell
    assert left - cell <= nearer <= left
    wide, limit = _largest(scene_of(scenario.updated({"camera.image_size": None})), np.eye(6)[3])
    assert limit != "image"
    assert wide > _largest(scene, np.eye(6)[3])[0]


def test_numbers_of_seeds_that_settle_are_in_the_singular_and_plural(found: LargestStart) -> None:
    way = found.directions[0]
    for settled in range(5):
        seeds = (True,) * settled + (False,) * (4 - settled)
        assert _by_seeds(found, replace(way, reseeded=seeds)) == of_seeds(settled, found.duration)
    assert _by_seeds(found, replace(way, reseeded=())) == ""


def test_periods_that_a_run_does_not_show_are_not_tried() -> None:
    """500 servo periods of this machine are 10 s, and a run is of 2 s."""
    scenario = hs.load_scenario("reachy-mini").updated({"simulation.duration": 2.0})
    found = largest_start.analyse(scenario)
    times = {t.what: max(t.tried) for t in found.timings}
    assert 0.5 < times["period"] < 1.0
    assert 1.0 < times["latency"] < 2.0


def test_both_sides_of_a_border_are_printed_with_digits_that_differ() -> None:
    turn = Direction(
        "turn +z", np.array([0.0, 0, 0, 0, 0, math.radians(14.2)]), 1.0, "stroke", {}, {}, None, {}, 2.0, {}, ()
    )
    near = replace(turn, tried={0.8120: True, 0.8130: False})
    assert border_words(near) == ("11.53 deg", "11.54 deg")
    assert border_words(replace(turn, tried={0.5: True, 0.75: False})) == ("7.1 deg", "10.6 deg")


def test_a_border_that_is_known_by_hand() -> None:
    """A law without gain settles where it starts within 2 px: a shift of 2 px Z/f, a turn by 2 px about the axis."""
    weak = hs.load_scenario("paper-nominal").updated({"controller.law": "kelly", "controller.kelly.kp": 0.0})
    result = largest_start.analyse(weak)
    by_hand = 2.0 * 0.5 / (72727 * 0.008)
    for name in ("shift +x", "shift -x", "shift +y", "shift -y"):
        way = direction(result, name)
        assert way.fails_at is not None
        assert way.settles_to <= by_hand * (1 + 1e-12) <= way.fails_at
        # a grid of eighths, halves of them, and two rounds of quarters
        assert way.fails_at - way.settles_to <= way.largest / 16 / 16 * 1.001
        assert not way.settles_again
        assert way.settles_later is False
    turn = direction(result, "turn +z")
    # a point at (x, y) moves by angle times the other coordinate; 65 px is the largest
    assert turn.fails_at is not None
    assert turn.settles_to <= 2.0 / 65 * 1.01 < turn.fails_at * 1.01
    section = result.section()
    assert section.verdict == "bad"  # the task itself is 20 px away
    assert "camera times were not tried" in " ".join(section.sentences)


# ---- The paper ------------------------------------------------------------------------------------------------------


def test_the_papers_own_way_settles_to_the_end_of_the_stroke(found: LargestStart, paper: hs.Scenario) -> None:
    own = found.own
    assert own is not None
    assert own.fails_at is None
    assert own.limited_by == "stroke"
    np.testing.assert_allclose(own.unit, [*np.array([20, 8, 0]) * 0.5 / 581.816, 0, 0, 0], rtol=0, atol=1e-9)
    rest = Scene(paper)
    travel = rest.leg_travel(rest.home.moved((own.largest * own.unit)[None]))
    assert np.abs(travel).max() == pytest.approx(paper.robot.stroke, rel=1e-3)
    assert np.abs(travel).max() <= paper.robot.stroke
    assert 1.0 in own.tried
    assert found.section().verdict == "good"


def test_single_runs_agree(found: LargestStart, paper: hs.Scenario) -> None:
    """The largest that settles and the smallest that fails, of each way, repeated by `hs.simulate`."""
    assert found.duration == 2.0
    failing = 0
    for way in found.directions:
        assert settles(goal_at(paper, way, way.settles_to), found.duration)
        if way.fails_at is not None:
            failing += 1
            smaller = goal_at(paper, way, way.fails_at)
            assert not settles(smaller, found.duration)
            assert settles(smaller, paper.simulation.duration) == way.settles_later
    assert failing > 0
    assert found.longer == paper.simulation.duration


def test_single_runs_agree_for_a_camera_of_its_own_pixels() -> None:
    """Image off the optical axis, two focal lengths, and a principal point that the controller has wrong."""
    feature = hs.load_scenario("composite-30hz")
    centre = np.tile([70.0, 239.5], 4)
    scenario = feature.updated(
        {
            "camera.focal_length": None,
            "camera.pixel_scale": None,
            "camera.focal_pixels": [581.8, 500.0],
            "camera.principal_point": [70.0, 239.5],
            "camera.image_size": [640, 480],
            "target.initial_features": (np.array(feature.target.initial_features) + centre).tolist(),
            "target.desired_features": (np.array(feature.target.desired_features) + centre).tolist(),
            "uncertainty.principal_point": [5.0, -5.0],
            "simulation.duration": 1.5,
        }
    )
    analysis = hs.analyse(scenario, ["largest_start"])
    directions = analysis.largest_start.directions
    assert len(directions) == 13
    assert sum(way.fails_at is not None for way in directions) > 5
    for way in directions:
        assert settles(goal_at(scenario, way, way.settles_to), 1.5), way.name
        if way.fails_at is not None:
            assert not settles(goal_at(scenario, way, way.fails_at), 1.5), way.name
    (section,) = analysis.sections()
    assert not any("principal point" in sentence for sentence in section.sentences)  # nothing of it is left out


def test_the_papers_law_needs_a_fast_camera_or_prediction(found: LargestStart, paper: hs.Scenario) -> None:
    """docs/errata.md, 6: frames or latency of a few ms destabilise the loop."""
    sampled = paper.updated({"simulation.mode": "sampled", "controller.switching.kind": "implicit"})
    times = {(t.what, t.prediction): t for t in found.timings}
    assert set(times) == {(what, how) for what in ("period", "latency") for how in ("none", "encoder")}
    for (what, how), t in times.items():
        run = sampled.updated({"camera.prediction": how})
        for time, expected in ((t.settles_to, True), (t.fails_at, False)):
            if time is not None:
                assert settles(run.updated({f"camera.{what}": time}), found.duration) == expected, (what, how, time)
    assert times["period", "none"].fails_at == pytest.approx(0.003)
    assert times["latency", "none"].fails_at == pytest.approx(0.001)
    assert times["period", "encoder"].fails_at is None
    assert "implicit switching" in found.assumed


def timings_of(scenario: hs.Scenario) -> LargestStart:
    """Give the camera times alone."""
    trial = SettlingRuns(scenario)
    timings, assumed = camera_times(scenario, trial)
    return LargestStart(scenario.controller.law, "", (), timings, trial.duration, trial.longer, assumed=assumed)


def test_camera_times_that_are_only_slow_are_stated_as_slow() -> None:
    """A target of 2 mm/s: with a period of 160 ms it settles after 2.02 s, and runs are of 2 s."""
    scenario = hs.load_scenario("pi-h824-positions").updated(
        {"target.motion": {"kind": "velocity", "velocity": [0.002, 0.0, 0.0]}, "simulation.duration": 6.0}
    )
    found = timings_of(scenario)
    period = found.timings[0]
    assert period.fails_at == pytest.approx(0.16)
    assert period.settles_later
    late = scenario.updated({"camera.period": period.fails_at})
    assert not settles(late, 2.0)
    assert settles(late, 6.0)
    words = " ".join(_timing_words(found))
    assert "a period of 140 ms settles within 2 s" in words
    assert "160 ms is slower, but settles within 6 s" in words


def test_a_timeout_ends_the_search_of_camera_times_where_the_core_refuses_longer_ones() -> None:
    """60 ms less the other time and the jitter, 16 and 2 ms, is 42 ms for either."""
    scenario = hs.load_scenario("pi-h824").updated(
        {"camera.timeout": 0.06, "camera.latency_jitter": 0.002, "simulation.duration": 0.7}
    )
    found = timings_of(scenario)
    for timing in found.timings:
        assert timing.settles_to == timing.timeout == pytest.approx(0.042)
        hs.simulate(scenario.updated({f"camera.{timing.what}": 0.042, "simulation.duration": 0.1}))
        with pytest.raises(ValueError, match="period, latency and latency_jitter together"):
            hs.simulate(scenario.updated({f"camera.{timing.what}": 0.043, "simulation.duration": 0.1}))
    assert "up to 42 ms, the longest that camera.timeout has room for" in " ".join(_timing_words(found))
    assert timings_of(scenario.updated({"camera.timeout": 2.0})).timings[0].timeout is None


def test_a_limit_of_camera_times_in_noise_is_repeated_with_other_seeds() -> None:
    """Near its band the noise of one seed ends the search, and larger periods settle again, as single runs do."""
    scenario = hs.load_scenario("moog-6dof2000e")
    found = timings_of(scenario)
    period = found.timings[0]
    assert period.fails_at is not None
    assert period.settles_again is not None
    assert period.settles_again > period.fails_at
    assert period.tried[period.settles_again]
    late = scenario.updated({"camera.period": period.fails_at, "simulation.duration": 10.0})
    single = [np.isfinite(hs.metrics(hs.simulate(late.updated({"seed": seed})))["settling_time"]) for seed in range(5)]
    assert scenario.seed == 0
    assert list(period.reseeded) == single[1:]
    assert not single[0]
    words = " ".join(_timing_words(found))
    assert f"does not ({of_seeds(sum(single), 10.0)}; some larger ones settle, up to" in words


def test_a_limit_of_starting_errors_in_noise_is_repeated_with_other_seeds() -> None:
    """Noise of 0.5 px decides which sizes near a limit settle, as single runs do; without noise no seed matters."""
    scenario = hs.load_scenario("composite-30hz").updated({"camera.noise": 0.5})
    found = largest_start.analyse(scenario)
    scene = scene_of(scenario)
    random = [way for way in found.directions if len(set(way.reseeded)) == 2]
    assert len(random) >= 3
    for way in random:
        assert way.fails_at is not None
        goal = scene.pixels(scene.home.moved(way.fails_at * way.unit))
        base = scenario.updated({"target.desired_features": goal.ravel().tolist(), "simulation.duration": 2.0})
        ends = [hs.metrics(hs.simulate(base.updated({"seed": seed}))) for seed in range(1, 5)]
        within = [end["peak_leg_excursion"] <= scenario.robot.stroke for end in ends]
        settled = [bool(np.isfinite(end["settling_time"])) for end in ends]
        assert list(way.reseeded) == [both == (True, True) for both in zip(within, settled, strict=True)], way.name
    worst = next(way for way in random if border_words(way)[1] in _sentences(found)[1])
    assert f" ({of_seeds(sum(worst.reseeded))}), of " in _sentences(found)[1]
    calm = largest_start.analyse(scenario.updated({"camera.noise": 0.0}))
    assert any(way.fails_at is not None for way in calm.directions)
    assert all(way.reseeded == () for way in calm.directions)


def test_camera_times_are_searched_from_the_scenarios_own() -> None:
    """A slow law settles in 2 s with its own camera of 100 ms and 100 ms, and not with a faster one."""
    scenario = hs.load_scenario("reachy-mini").updated(
        {"camera.prediction": "none", "controller": {"law": "pbvs", "pbvs": {"auto": {"bandwidth": 0.5}}}}
    )
    found = timings_of(scenario)
    for timing in found.timings[:2]:
        assert timing.own == pytest.approx(0.1)
        assert timing.settles_to is not None
        assert timing.fails_at is not None
        assert timing.fails_below is not None
        assert timing.fails_below < timing.own <= timing.settles_to < timing.fails_at
        for time, good in ((timing.settles_to, True), (timing.fails_at, False), (timing.fails_below, False)):
            run = hs.simulate(scenario.updated({f"camera.{timing.what}": time, "simulation.duration": 2.0}))
            assert np.isfinite(hs.metrics(run)["settling_time"]) == good
    words = " ".join(_timing_words(found))
    assert "below the scenario's own, does not within 2 s" in words
    assert "no period that was tried settles within 2 s at a latency of 100 ms (20 ms is slower" in words


def test_a_task_that_leaves_the_band_after_the_short_runs_is_stated() -> None:
    """Outliers after 2 s, and a leg that drifts beyond its stroke; seeds and single runs of both durations."""
    scenario = hs.load_scenario("dropouts")
    found = largest_start.analyse(scenario)
    assert (found.duration, found.whole_duration) == (2.0, 5.0)
    short, whole = (
        [settled_after(scenario.updated({"simulation.duration": t, "seed": seed})) for seed in range(20)]
        for t in (2.0, 5.0)
    )
    assert np.nanmax(short) < 2.0 < whole[scenario.seed] < np.nanmax(whole) < 5.0
    assert found.whole_settling == whole[scenario.seed]
    section = found.section()
    words = " ".join(section.sentences)
    assert f"and leaves the band again: in a run of 5 s it is settled after {whole[scenario.seed]:.2f} s." in words
    assert "settles in runs of 2 s" in words
    assert "a longer one may leave the band again" in words
    assert section.data["task_settling_time"] == found.whole_settling
    drifting = hs.load_scenario("fails-unequal-depth")
    found = largest_start.analyse(drifting)
    assert np.isfinite(settled_after(drifting.updated({"simulation.duration": found.duration})))
    travel = hs.metrics(hs.simulate(drifting))["peak_leg_excursion"]
    assert travel > drifting.robot.stroke
    section = found.section()
    assert section.verdict == "bad"
    assert f"but in a run of 5 s takes a leg {1e3 * travel:.1f} mm" in " ".join(section.sentences)


def settled_after(scenario: hs.Scenario) -> float:
    return hs.metrics(hs.simulate(scenario))["settling_time"]


def test_factors_of_a_border_differ() -> None:
    """1.367 and 1.373 times the task, which are both 1.37."""
    way = Direction("own", np.array([1e-3, 0, 0, 0, 0, 0]), 2.0, "stroke", {}, {}, None, {}, 2.0, {}, ())
    near = replace(way, tried={1.367: True, 1.373: False})
    assert "up to 1.367 times the task" in " ".join(_sentences(LargestStart("pbvs", "", (near,), duration=2.0)))


def test_runs_are_counted(found: LargestStart) -> None:
    tried = sum(len(d.tried) for d in found.directions) + sum(len(t.tried) for t in found.timings)
    later = sum(d.settles_later is not None for d in found.directions)
    later += sum(t.settles_later is not None for t in found.timings)
    assert found.runs == tried + later + 2  # and the task itself, which decides the duration, and as long as it is


def test_smaller_sizes_than_the_border_were_tried(found: LargestStart) -> None:
    for way in found.directions:
        below = [size for size in way.tried if size <= way.settles_to]
        assert len(below) >= 2 * math.floor(8 * way.settles_to / way.largest + 1e-9)


# ---- Where a larger error settles again, and where the task fails ---------------------------------------------------


def test_a_border_need_not_be_the_only_one(trap: LargestStart) -> None:
    again = [d for d in trap.directions if d.settles_again]
    assert again
    for way in again:
        assert way.fails_at is not None
        assert any(good and size > way.fails_at for size, good in way.tried.items())
    assert "a larger error settles again" in " ".join(trap.section().sentences)


def test_the_task_that_ends_in_a_false_equilibrium_fails(trap: LargestStart) -> None:
    own = trap.own
    assert own is not None
    assert own.tried[1.0] is False
    assert own.fails_at is not None
    assert own.fails_at < 1.0
    assert trap.section().verdict == "bad"
    assert not trap.timings


def test_a_task_that_starts_at_its_goal_has_no_direction(paper: hs.Scenario) -> None:
    still = paper.updated(
        {
            "target.desired_features": list(paper.target.initial_features or ()),
            "controller.law": "resolved_rate",
            "simulation.duration": 0.25,
        }
    )
    result = largest_start.analyse(still)
    assert result.own is None
    assert len(result.directions) == 12
    assert "The goal image is that from home" in result.section().sentences[0]
    assert result.section().verdict == "open"
    features = np.array(paper.target.initial_features)
    features[0] += 1e-5
    nearly = largest_start.analyse(still.updated({"target.desired_features": features}))
    assert nearly.own is None
    assert "The goal image is that from home to 1e-05 px" in nearly.section().sentences[0]


def test_a_task_without_a_possible_goal_is_stated_as_such() -> None:
    """With a stroke that ends before the first pose of the grid: the goal image has a pose all the same."""
    short = hs.load_scenario("slow-camera").updated({"robot.stroke": 1e-6, "simulation.duration": 0.05})
    result = largest_start.analyse(short)
    assert result.directions == ()
    assert result.goal_error < 1e-6
    own, others = result.section().sentences[:2]
    assert own == "No goal in the direction of the task was found that the stroke allows: this direction was not tried."
    assert others == "Along no axis and about none was a possible goal found: none was tried."
    assert result.section().verdict == "open"


def test_a_goal_image_that_is_rounded_has_a_direction() -> None:
    """Of `fails-leg-limits` the best pose, a rotation by 18 degrees, leaves 3e-5 px."""
    result = largest_start.analyse(hs.load_scenario("fails-leg-limits").updated({"simulation.duration": 0.05}))
    assert result.own is not None
    assert 1e-5 < result.goal_error < 1e-4
    # [m; rad]: errors of 3e-5 px make the pose uncertain by 3e-5 * 173 mrad (1 sigma, of `conditioning`); 3 sigma
    np.testing.assert_allclose(result.own.unit, [0, 0, 0, 0, 0, -math.pi / 10], atol=1.6e-5)


def test_a_task_with_its_own_start_is_said_to_run_from_home(found: LargestStart, paper: hs.Scenario) -> None:
    for changes in (
        {"simulation.start.pose": [0.001, 0, 0, 0, 0, 0]},
        {"simulation.start.twist": [0, 0, 0, 0, 0, 0.1]},
    ):
        short = paper.updated({**changes, "simulation.duration": 0.01, "metrics.dwell": 0.001})
        assert largest_start.analyse(short).from_home
    assert not found.from_home
    assert any(text.startswith("The task itself,") for text in found.section().sentences)
    for other in (replace(found, from_home=True), replace(found, from_home=True, timings=())):
        texts = other.section().sentences
        assert not any(text.startswith("The task itself") for text in texts)
        assert any(text.startswith("The task's goal, from home at rest instead of the task's own") for text in texts)


def test_a_task_that_needs_longer_gets_longer() -> None:
    scenario = hs.load_scenario("paper-no-fuzzy")
    trial = SettlingRuns(scenario)
    assert trial.task_settles
    assert trial.duration == 10.0  # it settles after 5.06 s


def test_a_slow_machine_has_runs_as_long_as_it_needs() -> None:
    """A loop of 0.05 Hz settles after 18 s of 120 s: runs last twice that and the dwell time of 0.2 s."""
    scenario = hs.load_scenario("rubin-camera-hexapod").updated(
        {
            "controller.composite.auto.bandwidth": 0.05,
            "camera.period": 0.1,
            "camera.latency": 0.1,
            "simulation.duration": 120.0,
            "simulation.step": 0.01,
        }
    )
    settling = hs.metrics(hs.simulate(scenario))["settling_time"]
    assert 10.0 < settling < 30.0
    trial = SettlingRuns(scenario)
    assert trial.task_settles
    assert not trial.is_cut
    assert trial.duration == pytest.approx(2.0 * (settling + 0.2))
    assert trial.longer == trial.duration
    short = SettlingRuns(scenario.updated({"simulation.duration": 15.0}))
    assert not short.task_settles
    assert not short.is_cut  # within its own duration it does not settle


def test_a_task_whose_run_takes_too_many_steps_is_not_called_bad() -> None:
    """A law without gain never settles, which 100 000 of 101 000 steps do not prove."""
    weak = hs.load_scenario("paper-nominal").updated({"controller.law": "kelly", "controller.kelly.kp": 0.0})
    sections = [
        largest_start.analyse(weak.updated({"simulation.duration": duration})).section() for duration in (99.0, 101.0)
    ]
    assert [section.verdict for section in sections] == ["bad", "open"]
    decided, cut = (" ".join(section.sentences) for section in sections)
    assert "The task itself does not settle within 99 s and the stroke" in decided
    assert "does not settle within 100 s and the stroke" in cut
    assert "Longer runs take too many steps here: whether it settles is not known." in cut
    assert "is not known" not in decided


def test_a_goal_that_the_core_refuses_is_no_run(paper: hs.Scenario) -> None:
    trial = SettlingRuns(paper)
    before = trial.runs
    goals = np.tile(np.array(paper.target.desired_features), (3, 1))
    goals[1] += 2e4  # more than 1e4 px away
    ends = trial.ends({"target.desired_features": goals})
    np.testing.assert_array_equal(ends.ran, [True, False, True])
    np.testing.assert_array_equal(ends.settled, [True, False, True])
    assert np.isnan(ends.times[1])
    assert trial.runs == before + 2


def test_a_camera_as_printed_is_not_tried(paper: hs.Scenario) -> None:
    section = largest_start.analyse(paper.updated({"camera.convention": "as_printed"})).section()
    assert section.verdict == "open"
    assert section.data["applies"] is False


def test_every_text_is_marked_as_empirical(found: LargestStart, trap: LargestStart) -> None:
    for result in (found, trap):
        section = result.section()
        assert "empirical" in section.title
        assert "(empirical)" in section.sentences[0]
        assert f"{result.runs} runs" in section.sentences[-1]
        assert "not derived" in section.sentences[-1]
        assert section.data["empirical"] is True


def test_a_run_that_leaves_the_stroke_does_not_count_as_settled() -> None:
    """A late camera whose image error settles while a leg travels beyond its stroke: the stroke is what limits."""
    # without a brake nothing holds the platform before the first image
    scenario = hs.load_scenario("composite-30hz").updated({"controller.safe": {"damping": 0.0, "hold": 0.0}})
    found = largest_start.analyse(scenario)
    limited = [t for t in found.timings if t.limited_by == "stroke"]
    assert limited
    for timing in limited:
        assert timing.fails_at is not None
        late = scenario.updated(
            {
                f"camera.{timing.what}": timing.fails_at,
                "camera.prediction": timing.prediction,
                "simulation.duration": found.duration,
            }
        )
        travel = hs.metrics(hs.simulate(late))["peak_leg_excursion"]
        assert travel > scenario.robot.stroke
        assert timing.beyond[timing.fails_at].peak == pytest.approx(travel, rel=1e-6)
        assert not settles(late, found.duration)
    assert any("beyond its stroke" in sentence for sentence in found.section().sentences)


@pytest.mark.parametrize("kind", ["speed", "base_joint"])
def test_a_run_beyond_speed_or_joint_limits_does_not_count_as_settled(paper: hs.Scenario, kind: str) -> None:
    """The limit is half of what the task's own run uses: so the task fails for it alone, and smaller sizes settle."""
    metric = {"speed": "peak_leg_speed", "base_joint": "peak_base_joint"}[kind]
    watched = paper.updated({"robot.speed_limit": 10.0, "robot.joint_limit": [3.0, 3.0]})
    half = 0.5 * hs.metrics(hs.simulate(watched))[metric]
    key = {"robot.speed_limit": half} if kind == "speed" else {"robot.joint_limit": [half, 3.0]}
    scenario = watched.updated(key)
    own = largest_start.analyse(scenario).own
    assert own is not None
    if kind == "speed":
        assert own.beyond[1.0].limit.kind == kind
        assert not own.tried[1.0]
    else:  # the goal itself is out of reach
        assert own.limited_by == kind
        assert own.largest < 1.0
    goal = scene_of(scenario).home.moved(own.settles_to * own.unit)
    features, _ = scene_of(scenario).image(goal)
    assert 0.0 < own.settles_to < 1.0
    run = hs.metrics(hs.simulate(scenario.updated({"target.desired_features": features.tolist()})))
    assert run[metric] <= half


def test_a_run_that_settles_with_forces_beyond_the_limit_is_stated() -> None:
    """The law without gain holds the weight: runs settle where they start within the band, with 0.1337 N in a leg."""
    weak = hs.load_scenario("paper").updated(
        {
            "controller.law": "kelly",
            "controller.kelly.kp": 0.0,
            "metrics.band": 25.0,  # the task itself is 20 px away
            "simulation.duration": 0.3,
            "robot.force_limit": 0.13,
        }
    )
    limited = largest_start.analyse(weak)
    own = limited.own
    assert own is not None
    assert own.overloaded_from == min(own.settling)
    peak = hs.metrics(hs.simulate(weak))["peak_leg_force"]
    assert own.overloads[1.0].peak == pytest.approx(peak, rel=1e-9)
    assert all(timing.overloaded_from == min(timing.tried) for timing in limited.timings)
    section = limited.section()
    assert section.verdict != "good"
    (words,) = (
        sentence
        for sentence in section.sentences
        if sentence.startswith("Forces or torques of the legs are not limited")
    )
    assert "in the direction of the task at all sizes tried, the worst of which takes" in words
    assert f"takes a force of a leg of {peak:.3g} N, beyond the limit of 0.13 N; along 12 of 12 axes" in words
    assert "with a camera latency from 0 ms on, without prediction" in words
    assert section.data["directions"][0]["overloaded_from"] == own.overloaded_from


def test_forces_within_the_limit_are_not_mentioned(found: LargestStart) -> None:
    within = replace(found, directions=tuple(way for way in found.directions if way.overloaded_from is None))
    assert within.own is not None
    assert not any("Forces" in sentence for sentence in within.section().sentences)


def test_a_task_needs_a_margin_to_the_force_limit(found: LargestStart, paper: hs.Scenario) -> None:
    """Its verdict is that of a size that does not settle: good from 1.25 times the task on."""
    own = found.own
    assert own is not None
    tight = paper.updated({"robot.force_limit": 0.9 * hs.metrics(hs.simulate(paper))["peak_leg_force"]})
    goal = {"target.desired_features": np.array([paper.target.desired_features])}
    (more,) = SettlingRuns(tight).ends(goal).overloads
    assert more is not None
    for size, verdict in ((1.0, "warning"), (1.3, "good")):
        overloaded = replace(own, tried={**own.tried, size: True}, overloads={size: more})
        section = replace(found, directions=(overloaded, *found.directions[1:])).section()
        assert section.verdict == verdict
        assert f"in the direction of the task from {size:.3g} times the task on (" in str(section)


def test_a_start_that_is_merely_slower_is_no_warning(found: LargestStart) -> None:
    """How long the runs are follows from `metrics.dwell`, and judges nothing: a shorter one has no other verdict."""
    own = found.own
    assert own is not None
    for later, verdict in ((False, "warning"), (None, "warning"), (True, "good")):
        near = replace(own, tried={1.0: True, 1.1: False}, settles_later=later, overloads={}, beyond={})
        section = replace(found, directions=(near, *found.directions[1:])).section()
        assert section.verdict == verdict


def test_one_direction_is_in_the_singular() -> None:
    settles, fails = ({1.0: True, 2.0: True}, {1.0: True, 2.0: False})
    unit = np.array([1e-3, 0, 0, 0, 0, 0])

    def way(name: str, tried: dict[float, bool]) -> Direction:
        return Direction(name, unit, 2.0, "stroke", tried, {}, None, {}, 2.0, {}, ())

    def words(*ways: Direction) -> str:
        return _others(LargestStart("kelly", "", ways, duration=2.0))

    assert words(way("+x", fails)).startswith("The other direction, +x, has goals that do not settle within 2 s: up to")
    assert words(way("+x", settles)).startswith("The other direction, +x: every goal tried settles within 2 s")
    assert words(way("+x", fails), way("-x", settles)).startswith("Of 2 axes and rotations 1 has goals")
    assert words(way("+x", fails), way("-x", fails)).startswith("Of 2 axes and rotations 2 have goals")
