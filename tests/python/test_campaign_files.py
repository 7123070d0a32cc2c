"""Campaign files: what they accept, what they refuse, and which runs they stand for."""

from __future__ import annotations

import itertools
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo.campaigns.distributions import SEED, Variation, uniform_of
from hexservo.campaigns.drawing import Drawing
from hexservo.campaigns.names import campaign_names
from hexservo.campaigns.plan import CampaignPlan, load_plan
from hexservo.campaigns.requirements import distance_of, margin_of, ranks_of, requirement_of, run_margins
from hexservo.run.publish import OutputError
from hexservo.scenario.arrays import Array
from hexservo.scenario.yaml import load_yaml

FILE: dict[str, Any] = {
    "scenario": "composite-30hz",
    "vary": {
        "uncertainty.gravity": {"normal": [0.01, 0.03], "clip": [-0.05, 0.07]},
        "uncertainty.depth": {"uniform": [-0.3, 0.2], "each": True},
        "uncertainty.inertia": {"uniform": [-0.075, 0.075], "each": True, "symmetric": True},
        "camera.latency": {"choice": [0.02, 0.033, 0.05]},
        "camera.noise": {"log": [1e-3, 10.0]},
        "target.initial_features": {"normal": [0.0, 5.0], "add": True, "each": True},
        "controller.composite.kt": {"normal": [0.0, 0.01], "add": True},
        "seed": "each",
    },
    "require": ["outcome == completed", "settling_time <= 0.5"],
    "runs": 100,
}
PLAN = load_plan(FILE)
RUNS = 40_000
DRAWN = PLAN.drawing().numbers(0, RUNS)


# ---- Drawing --------------------------------------------------------------------------------------------------------


def philox(counter: int, key: int) -> list[int]:
    """Philox 4x64 with 10 rounds, from the paper of Salmon, Moraes, Dror and Shaw (2011), in integers."""
    word = 2**64
    c = [counter >> 64 * i & word - 1 for i in range(4)]
    k = [key & word - 1, key >> 64]
    for _ in range(10):
        first, second = 0xD2E7470EE14C6C93 * c[0], 0xCA5A826395121157 * c[2]
        c = [second // word ^ c[1] ^ k[0], second % word, first // word ^ c[3] ^ k[1], first % word]
        k = [(k[0] + 0x9E3779B97F4A7C15) % word, (k[1] + 0xBB67AE8584CAA73B) % word]
    return c


def test_a_seed_is_a_number_of_the_counter_and_the_key_alone() -> None:
    known = [0x16554D9ECA36314C, 0xDB20FE9D672D0FDC, 0xD7E772CEE186176B, 0x7E68B68AEC7BA23B]
    assert philox(0, 0) == known, "the known answer of Random123 for counter 0 and key 0"
    # 1 gravity, 4 depths, 21 of a symmetric inertia, latency, noise, 8 features, 1 for all of kt: the seed is number 37
    width = 10  # blocks of 4 that hold 38 numbers
    key = int(PLAN.digest()[:32], 16)
    for run in (0, 1, 7, 12_345, 10**11):
        block = philox(run * width + 37 // 4 + 1, key)  # NumPy counts before it draws
        assert PLAN.drawing().numbers(run, run + 1)["seed"].tolist() == [block[37 % 4]]


def test_runs_take_no_more_blocks_than_their_numbers_need() -> None:
    """Four numbers are one block of the counter."""
    vary = {f"uncertainty.{name}": Variation("uniform", (0.0, 0.1)) for name in ("gravity", "inertia", "coriolis")}
    drawing = Drawing(hs.load_scenario("paper"), {**vary, "seed": Variation(SEED)}, 5)
    for run in (0, 1, 7):
        assert drawing.numbers(run, run + 1)["seed"].tolist() == [philox(run + 1, 5)[3]]


def test_uniform_numbers_are_within_their_ends() -> None:
    """Of which a normal distribution has none."""
    bits = np.array([0, 2**64 - 1], dtype=np.uint64)
    low, high = uniform_of(bits)
    assert 0.0 < low < high < 1.0
    assert low + high == 1.0


@pytest.mark.parametrize("sizes", [[1] * 50, [7, 13, 30], [50]])
def test_numbers_do_not_depend_on_how_runs_are_grouped(sizes: list[int]) -> None:
    ends = np.cumsum([0, *sizes])
    parts = [PLAN.drawing().numbers(int(first), int(last)) for first, last in itertools.pairwise(ends)]
    for key, values in DRAWN.items():
        assert np.concatenate([part[key] for part in parts]).tobytes() == values[:50].tobytes()


@pytest.mark.parametrize(
    ("change", "same"),
    [
        ({"runs": 7, "chunk_size": 3, "confidence": 0.9, "rare": True}, True),
        ({"require": ["rms_error <= 1"]}, True),
        ({"scenario": hs.load_scenario("composite-30hz").updated({"name": "a", "description": "b"})}, True),
        ({"stream": 1}, False),
        ({"scenario": hs.load_scenario("composite-30hz").updated({"camera.period": 0.04})}, False),
        ({"vary": FILE["vary"] | {"seed": "each", "camera.noise": {"log": [1e-3, 11.0]}}}, False),
    ],
)
def test_numbers_depend_on_scenario_vary_and_stream(change: dict[str, Any], same: bool) -> None:
    other = PLAN.changed(**change).drawing().numbers(0, 5)
    assert (other["seed"].tobytes() == DRAWN["seed"][:5].tobytes()) is same


def kolmogorov(sample: Array, distribution: Any) -> float:
    """Scaled distance of the empirical distribution: above 1.95 in one of 1000 samples that are right."""
    return float(stats.ks_1samp(sample, distribution.cdf).statistic * math.sqrt(len(sample)))


def test_numbers_have_their_distributions() -> None:
    base = hs.load_scenario("composite-30hz")
    shift = DRAWN["target.initial_features"] - np.array(base.target.initial_features)
    found = {
        "uniform": kolmogorov(DRAWN["uncertainty.depth"].ravel(), stats.uniform(-0.3, 0.5)),
        "log": kolmogorov(np.log10(DRAWN["camera.noise"]), stats.uniform(-3, 4)),
        "normal": kolmogorov(shift.ravel(), stats.norm(0, 5)),
        "seed": kolmogorov(DRAWN["seed"].astype(float), stats.uniform(0, 2.0**64)),
    }
    print(f"stream {PLAN.stream}, {RUNS} runs, scaled Kolmogorov distances (1.95: 0.1 %): {found}")
    assert max(found.values()) < 1.95
    counts = [int((DRAWN["camera.latency"] == value).sum()) for value in (0.02, 0.033, 0.05)]
    assert sum(counts) == RUNS
    assert stats.chisquare(counts).pvalue > 1e-3
    clipped = DRAWN["uncertainty.gravity"]
    assert (clipped.min(), clipped.max()) == (-0.05, 0.07)
    for end in (-0.05, 0.07):  # each holds the probability of a tail beyond 2 standard deviations
        assert stats.binomtest(int((clipped == end).sum()), RUNS, stats.norm.sf(2)).pvalue > 1e-3
    rank = abs(stats.spearmanr(shift[:, :4]).statistic - np.eye(4)).max()
    assert rank < 4.5 / math.sqrt(RUNS), "entries are independent: each has the variance 1/n"


def test_shapes_of_what_varies() -> None:
    inertia = DRAWN["uncertainty.inertia"]
    assert inertia.shape == (RUNS, 6, 6)
    assert (inertia == inertia.transpose(0, 2, 1)).all()
    assert len(np.unique(inertia[0])) == 21
    assert DRAWN["uncertainty.gravity"].shape == DRAWN["camera.noise"].shape == (RUNS,)
    added = DRAWN["controller.composite.kt"] - np.array(hs.load_scenario("composite-30hz").controller.composite.kt)
    assert added.shape == (RUNS, 6)
    # one number for all entries; adding it to 98 rounds by 98 * 2^-53, and taking that away again rounds again
    np.testing.assert_allclose(added, np.broadcast_to(added[:, -1:], added.shape), rtol=0, atol=4 * 98 * 2.0**-53)


def test_a_displaced_target_is_the_same_body() -> None:
    """Rotation about the centroid by a vector, then translation; checked against SciPy, run by run."""
    vary = {
        "target.translation": {"normal": [0.0, 0.01], "each": True},
        "target.rotation": {"uniform": [-1, 1], "each": True},
    }
    plan = load_plan(FILE | {"vary": vary})
    drawing = plan.drawing()
    drawn = drawing.numbers(0, 200)
    assert {key: values.shape for key, values in drawn.items()} == dict.fromkeys(vary, (200, 3))
    found = drawing.variations(drawn)["target.points"]
    base = np.array(drawing.base["target.points"])
    focal, camera = (
        plan.scenario.camera.focal_length * plan.scenario.camera.pixel_scale,
        base - plan.scenario.robot.home_position,
    )
    seen = focal * camera[:, :2] / np.abs(camera[:, 2:])  # the camera looks along -z of E, which is at home
    np.testing.assert_allclose(seen.ravel(), np.array(plan.scenario.target.initial_features), rtol=0, atol=1e-10)
    for index, points in enumerate(found):
        turn = Rotation.from_rotvec(drawn["target.rotation"][index])
        expected = turn.apply(base - base.mean(axis=0)) + base.mean(axis=0) + drawn["target.translation"][index]
        np.testing.assert_allclose(points, expected, rtol=0, atol=1e-15)
    alone = [drawing.variations(drawing.numbers(run, run + 1))["target.points"] for run in range(200)]
    assert np.concatenate(alone).tobytes() == found.tobytes()


# ---- Requirements ---------------------------------------------------------------------------------------------------


def test_margins_by_hand() -> None:
    nan = math.nan
    requirements = [
        requirement_of(text)
        for text in (
            "outcome == completed",
            "settling_time <= 0.5",
            "rms_error >= 2",
            {"holds": "overshoot < 0", "scale": 4},
        )
    ]
    outcome = np.array(["completed", "completed", "diverged", "completed", "diverged"])
    metrics = {
        "settling_time": np.array([0.4, 0.75, 0.1, nan, 0.1]),
        "rms_error": np.array([3.0, 2.0, 9.0, 1.0, nan]),
        "overshoot": np.array([-2.0, 2.0, -1.0, 0.0, nan]),
    }
    found = run_margins(requirements, outcome, np.array([5.0, 5.0, 3.75, 5.0, nan]), 5.0, metrics)
    tiny = -float(np.finfo(float).tiny)
    third = -1 / 3  # half of the scale beyond the bound: -0.5/1.5
    expected: list[list[float]] = [
        [1.0, 0.2, 0.5, 0.5],
        [1, third, 0, third],
        [-1.25] * 4,
        [1, -1, third, tiny],
        [-2] * 4,
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-15, atol=0)


@pytest.mark.parametrize("text", ["settling_time <= 0.5", {"holds": "settling_time <= 0.5", "scale": 1e-300}])
def test_runs_are_ordered_from_those_that_pass_to_those_that_end_first(text: Any) -> None:
    """A late value is better than none, which is better than an early end, whatever the scale."""
    settles = np.array([0.4, 0.5, 0.6, 4.7, math.nan, math.nan, math.nan])
    outcome = np.array(["completed"] * 5 + ["diverged"] * 2)
    end_time = np.array([5.0, 5.0, 5.0, 5.0, 5.0, 4.9, 0.05])
    requirements = [requirement_of("outcome == completed"), requirement_of(text)]
    margins = run_margins(requirements, outcome, end_time, 5.0, {"settling_time": settles}).min(axis=1)
    assert (np.diff(margins[[1, 2, 4, 5, 6]]) < 0).all()
    assert margins[2] >= margins[3] > margins[4] == -1.0
    assert ((margins >= 0) == [True] * 2 + [False] * 5).all()
    assert margins[6] == pytest.approx(-1.99)


def test_runs_of_the_same_margin_are_ordered_by_what_else_they_miss() -> None:
    """Not by the room of the bounds that they keep: the first run misses the error more, with a smaller force."""
    requirements = [requirement_of(f"{name} <= 1") for name in ("settling_time", "final_error", "peak_leg_force")]
    metrics = {
        "settling_time": np.array([math.nan] * 3),
        "final_error": np.array([10.0, 2.0, 0.5]),
        "peak_leg_force": np.array([0.1, 0.9, 0.9]),
    }
    margins = run_margins(requirements, np.array(["completed"] * 3), np.ones(3), 1.0, metrics)
    np.testing.assert_allclose(ranks_of(margins), [[-1.0, -1.9], [-1.0, -1.5], [-1.0, -1.0]])


@given(distance=st.floats(-1e100, 1e100))
def test_a_margin_has_the_sign_of_its_distance_and_no_value_is_below_none(distance: float) -> None:
    (margin, without) = margin_of(np.array([distance, math.nan]))
    assert (margin >= 0) == (distance >= 0)
    assert margin > without == -1.0
    if distance > -1e6:
        assert distance_of(margin) == pytest.approx(distance, rel=1e-9)


@given(
    value=st.floats(allow_nan=False),
    bound=st.floats(-1e9, 1e9).filter(bool),
    text=st.sampled_from(["<=", "<", ">=", ">"]),
)
def test_a_margin_is_negative_where_the_requirement_fails(value: float, bound: float, text: str) -> None:
    seen = bound if abs(value - bound) <= 1e-12 * abs(bound) else value  # a difference of rounding is none
    holds = {"<=": seen <= bound, "<": seen < bound, ">=": seen >= bound, ">": seen > bound}[text]
    margin = margin_of(requirement_of(f"effort {text} {bound!r}").distance(np.array([value])))
    assert (margin[0] >= 0) == holds


@pytest.mark.parametrize("step", [1e-3, 5e-4, 1e-4])
def test_a_time_of_whole_steps_is_at_the_bound_that_is_written_for_it(step: float) -> None:
    """283 steps of 1 ms are 0.28300000000000003 s."""
    counts = np.arange(1, 3000)
    written = [repr(round(float(time), 6)) for time in counts * step]
    assert np.mean(counts * step > np.array(written, dtype=float)) > 0.1
    for text, is_kept in (("<=", True), (">=", True), ("<", False), (">", False)):
        for count, bound in zip(counts, written, strict=True):
            distance = requirement_of(f"settling_time {text} {bound}").distance(np.array([count * step]))[0]
            assert distance == 0 if is_kept else distance < 0
            later = requirement_of(f"settling_time {text} {bound}").distance(np.array([(count + 1) * step]))[0]
            assert (later > 0) == (text in (">=", ">"))


# ---- Files ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "required", ["peak_leg_excursion <= 1e-320", "rms_error >= 1e308", {"holds": "overshoot <= 0", "scale": 1e-320}]
)
def test_a_distance_is_finite_whatever_its_scale(required: Any) -> None:
    one = requirement_of(required)
    found = one.distance(np.array([0.0, 1e-3, 1e300, math.inf, math.nan]))
    assert np.isfinite(found[:-1]).all()
    assert np.isfinite(found[:-1] ** 2).all()
    assert ((found[:-1] >= 0) == ([False] * 3 + [True] if one.comparison == ">=" else [True] + [False] * 3)).all()
    assert math.isnan(found[-1])


def test_a_resolved_file_is_the_same_campaign() -> None:
    plan = PLAN.changed(
        require=["rms_error <= 1", {"holds": "overshoot <= 0", "scale": 4.0}], until={"width_below": 1e-3}
    )
    again = CampaignPlan(**load_yaml(plan.to_yaml()))  # type: ignore[arg-type]
    assert again == plan
    assert again.digest() == PLAN.digest()


def test_a_scenario_is_found_beside_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.yaml").write_text(hs.load_scenario("composite-30hz").to_yaml(), encoding="utf-8")
    lines = "vary: {seed: each}\nrequire: [outcome == completed]\nruns: 2\n"
    (tmp_path / "campaign.yaml").write_text(f"scenario: mine.yaml\n{lines}", encoding="utf-8")
    monkeypatch.chdir("/")
    assert load_plan(tmp_path / "campaign.yaml").scenario == hs.load_scenario("composite-30hz")


def test_a_scenario_is_found_in_a_folder_whose_name_is_no_text(tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"mine-\xff")
    folder.mkdir()
    (folder / "mine.yaml").write_text(hs.load_scenario("composite-30hz").to_yaml(), encoding="utf-8")
    lines = "vary: {seed: each}\nrequire: [outcome == completed]\nruns: 2\n"
    (folder / "campaign.yaml").write_text(f"scenario: mine.yaml\n{lines}", encoding="utf-8")
    assert load_plan(folder / "campaign.yaml").scenario == hs.load_scenario("composite-30hz")
    changed = load_plan(folder / "campaign.yaml", {"robot.mass": 0.4}).scenario
    assert changed == hs.load_scenario("composite-30hz", {"robot.mass": 0.4})
    (folder / "mine.yaml").unlink()
    with pytest.raises(hs.ScenarioError, match=r"scenario: .*: no such file"):
        load_plan(folder / "campaign.yaml")
    keys = hs.load_scenario("composite-30hz").to_mapping() | {"name": "\udcff"}
    with pytest.raises(hs.ScenarioError, match=r"^scenario.name: expected text of whole Unicode characters"):
        CampaignPlan(**{**FILE, "scenario": keys})


@pytest.mark.parametrize("name", campaign_names())
def test_packaged_campaigns_are_valid(name: str) -> None:
    assert load_plan(name).runs


VARIED = {"uncertainty.gravity": {"uniform": [-0.1, 0.1]}}
SHORT_LIVED = hs.load_scenario("paper").updated({"simulation.duration": 0.04})
HALF_A_SECOND = hs.load_scenario("paper").updated({"simulation.duration": 0.5})
REFUSED = [
    (
        {"vary": {"uncertainty.gravty": {"uniform": [0, 1]}}},
        'vary.uncertainty.gravty: unknown key; did you mean "uncertainty.gravity"',
    ),
    (
        {"vary": {"controller.law": {"choice": [1]}}},
        "vary.controller.law: expected a numeric key, got one that is not numeric and cannot vary within a campaign; "
        "run one campaign for each value, or hs.compare with the laws",
    ),
    (
        {"vary": {"simulation.start.pose": {"uniform": [-45, 45], "each": True}}},
        "vary.simulation.start.pose: expected a rotation vector at most pi long .*, which it reaches; clip it or",
    ),
    ({"vary": {"robot.payload": {"choice": [1]}}}, "expected a numeric key, got a block; name a key below it"),
    (
        {"vary": {"controller.hybrid.kp": {"uniform": [0, 1]}}},
        "vary.controller.hybrid.kp: expected a key of the scenario's",
    ),
    ({"vary": {}}, "vary: expected a block of dotted keys with their variations, got an empty block"),
    ({"vary": {"camera.noise": 3}}, r"vary.camera.noise: expected one of \{normal: .*; got 3"),
    ({"vary": {"camera.noise": {"clip": [0, 1]}}}, "vary.camera.noise: expected one of .*; got none of them"),
    ({"vary": {"camera.noise": {"normal": [0, 1], "log": [1, 2]}}}, "got 2 of them: normal, log"),
    ({"vary": {"camera.noise": {"normall": [0, 1]}}}, 'vary.camera.noise.normall: unknown key; did you mean "normal"'),
    (
        {"vary": {"camera.noise": {"normal": [1, 0]}}},
        r"vary.camera.noise.normal: expected \[mean, standard deviation > 0\]",
    ),
    ({"vary": {"camera.noise": {"uniform": [1, 1]}}}, r"vary.camera.noise.uniform: expected \[low, high\], low < high"),
    ({"vary": {"camera.noise": {"log": [0, 1]}}}, r"vary.camera.noise.log: expected \[low, high\], 0 < low < high"),
    ({"vary": {"camera.noise": {"choice": []}}}, "vary.camera.noise.choice: expected a list of at least one number"),
    ({"vary": {"camera.noise": {"uniform": [0, "1"]}}}, 'vary.camera.noise.uniform: expected .*, got "1" in it'),
    ({"vary": {"camera.noise": {"uniform": [0, math.inf]}}}, "vary.camera.noise: expected a finite number, got inf"),
    (
        {"vary": {"camera.noise": {"choice": [0, 1], "clip": [0, 2]}}},
        "vary.camera.noise.clip: expected none beside choice",
    ),
    (
        {"vary": {"camera.noise": {"uniform": [0, 1], "clip": [2, 3]}}},
        "vary.camera.noise.clip: expected limits that leave",
    ),
    (
        {"vary": {"uncertainty.gravity": {"normal": [0.0, 0.02], "clip": [0.07, 0.12]}}},
        r"vary.uncertainty.gravity.clip: expected limits that leave something of -0.06 ... 0.06, mean \+- 3 standard "
        r"deviations, got \[0.07, 0.12\]",
    ),
    (
        {"vary": {"uncertainty.gravity": {"normal": [0.0, 0.02], "clip": [-0.12, -0.06]}}},
        "vary.uncertainty.gravity.clip: expected limits that leave something of -0.06",
    ),
    (
        {"vary": {"camera.noise": {"uniform": [0, 1], "clip": [1, 0]}}},
        r"vary.camera.noise.clip: expected \[low, high\]",
    ),
    ({"vary": {"camera.noise": {"uniform": [0, 1], "add": 1}}}, "vary.camera.noise: expected true or false, got 1"),
    (
        {"vary": {"camera.noise": {"normal": [0, 1]}}},
        "vary.camera.noise: expected a number >= 0, but it reaches -8.21 ",
    ),
    (
        {"vary": {"camera.noise": {"uniform": [0, 1], "each": True}}},
        "vary.camera.noise: each: expected a key that holds",
    ),
    (
        {"vary": {"camera.timeout": {"uniform": [0, 1], "add": True}}},
        "vary.camera.timeout: add: expected a scenario whose",
    ),
    (
        {"vary": {"uncertainty.depth": {"uniform": [0, 1], "symmetric": True}}},
        "symmetric: expected each: true beside it",
    ),
    (
        {"vary": {"uncertainty.depth": {"uniform": [0, 0.1], "symmetric": True, "each": True}}},
        "vary.uncertainty.depth: symmetric: expected a key that holds a square matrix",
    ),
    ({"vary": {"seed": {"choice": [0, 1]}}}, "vary.seed: expected each, other noise in each run; for the noise of one"),
    (
        {"vary": {"camera.latency": {"uniform": [0, 0.1]}}},
        r"vary.camera.latency: expected {choice: \[...\]} of times that are whole",
    ),
    (
        {"vary": {"simulation.log_every": {"choice": [1, 1.5]}}},
        "vary.simulation.log_every: choice: expected an integer",
    ),
    ({"vary": {"target.rotation": {"uniform": [0, 1], "add": True}}}, "vary.target.rotation: expected neither add nor"),
    ({"vary": {"target.rotation": 3}}, "vary.target.rotation: expected one of"),
    (
        {"vary": {"target.rotation": {"normal": [0.0, 2.0], "each": True}}},
        r"rotation: expected a rotation vector at most pi long .radians., got one of 28\.\d+ .degrees. multiply by",
    ),
    (
        {"vary": {"target.rotation": {"uniform": [-3, 1]}}},
        r"got one of 5\.19615 .*, which it reaches; clip it or narrow",
    ),
    (
        {"vary": {"target.rotation": {"uniform": [0, 0.1]}, "target.depth": {"uniform": [0.4, 0.5]}}},
        "vary.target.depth: expected nothing that places the points beside target.translation and target.rotation",
    ),
    (
        {
            "scenario": hs.load_scenario("paper").updated({"camera.convention": "as_printed"}),
            "vary": {"target.rotation": {"uniform": [0, 1]}},
        },
        "vary.target.rotation: expected a scenario with camera.convention eye_in_hand",
    ),
    ({"scenario": "paper", "vary": {"seed": "each"}}, "vary: seed: has no effect in continuous mode"),
    ({"scenario": "papr"}, 'scenario: "papr": .*did you mean "paper"'),
    ({"scenario": 3}, "scenario: expected a packaged scenario, the path of a file, or the scenario itself, got 3"),
    ({"scenario": {"name": "a"}}, "scenario: missing key: target"),
    ({"require": []}, "require: expected a list of at least one requirement"),
    ({"require": ["setling_time <= 1"]}, r'require\[0\]: unknown metric "setling_time"; did you mean "settling_time"'),
    ({"require": ["settling_time == 1"]}, r'require\[0\]: expected one of <= >= < > for a metric, got "=="'),
    ({"require": ["settling_time <= 0_2"]}, r'require\[0\]: expected a finite bound \[s\], got "0_2"'),
    ({"require": ["settling_time <= \u0662"]}, r"require\[0\]: expected a finite bound \[s\]"),
    ({"require": ["settling_time <= fast"]}, r'require\[0\]: expected a finite bound \[s\], got "fast"'),
    ({"require": ["outcome == diverged"]}, r'require\[0\]: expected "outcome == completed"'),
    ({"require": ["overshoot <= 0"]}, r"require\[0\]: expected a scale for a bound of 0"),
    ({"require": [{"holds": "overshoot <= 0", "scale": 0}]}, r"require\[0\].scale: expected a number > 0, got 0"),
    ({"require": ["settling_time <= -1"]}, r"require\[0\]: settling_time: expected a bound that a run can keep, as no"),
    (
        {"require": [{"holds": "overshoot < 0", "scale": 1}]},
        "overshoot: expected a bound that a run can keep, .*got over",
    ),
    ({"require": ["final_error >= -1"]}, "final_error: expected a bound that a run can miss, as no metric is negative"),
    ({"require": ["final_error > -1"]}, "final_error: expected a bound that a run can miss"),
    (
        {"require": [{"holds": "effort >= 0", "scale": 1}]},
        'got effort >= 0.0; that a run completes is "outcome == comp',
    ),
    (
        {"require": ["rms_error >= 0.2", "effort <= 1", "rms_error <= 0.01"]},
        r"require\[2\]: rms_error: expected bounds with a value between, got rms_error <= 0.01, rms_error >= 0.2",
    ),
    ({"require": ["rms_error > 0.2", "rms_error <= 0.2"]}, "expected bounds with a value between"),
    ({"require": ["rms_error >= 0.2", "rms_error < 0.2"]}, "expected bounds with a value between"),
    ({"require": ["effort <= 1", "effort <= 1.0"]}, 'require: "effort <= 1.0": duplicate requirement'),
    (
        {"require": ["effort <= 1", "peak_leg_speed <= 0.2"]},
        r"require\[1\]: peak_leg_speed: expected robot.speed_limit in the scenario",
    ),
    ({"require": ["peak_base_joint <= 0.2"]}, r"require\[0\]: peak_base_joint: expected robot.joint_limit"),
    (
        {"scenario": SHORT_LIVED, "require": ["rms_error <= 2"]},
        r"require\[0\]: rms_error: expected metrics.rms_start within the 0.04 s of a run, got 1 s",
    ),
    (
        {"scenario": SHORT_LIVED, "require": ["settling_time <= 2"]},
        r"require\[0\]: settling_time: expected metrics.dwell within the 0.04 s of a run, got 0.2 s",
    ),
    (
        {"scenario": HALF_A_SECOND, "require": ["effort <= 1", "settling_time <= 0.4"]},
        r"require\[1\]: settling_time: expected a bound of at most 0.3 s, as a run of 0.5 s can settle no later "
        r"\(simulation.duration - metrics.dwell\), got 0.4 s; lower the bound or lengthen the run",
    ),
    (
        {
            "scenario": HALF_A_SECOND,
            "vary": {"metrics.dwell": {"uniform": [0.1, 0.2]}},
            "require": ["settling_time <= 0.45"],
        },
        r"require\[0\]: settling_time: expected a bound of at most 0.4 s",
    ),
    ({"runs": None}, "runs: expected a number of runs, or until, got neither"),
    ({"runs": 0}, "runs: expected an integer from 1 to"),
    ({"until": {"probability": 1}}, r"until: expected \{probability_below: p\}"),
    ({"until": {"probability_below": 1}}, "until.probability_below: expected a number > 0 and < 1, got 1"),
    ({"confidence": 1}, "confidence: expected a number > 0 and < 1, got 1"),
    ({"chunk_size": 0}, "chunk_size: expected an integer from 1 to"),
    ({"metrics": ["eforts"]}, "metrics: expected all, or a list of metrics, which hs.METRICS describes"),
    ({"metrics": "effort"}, "metrics: expected all, or a list of metrics"),
    ({"variant": "sse"}, "variant: expected avx512, avx2, baseline or null"),
    ({"confidenc": 0.9}, 'confidenc: unknown key; did you mean "confidence"'),
]


def test_a_campaign_keeps_the_metrics_that_it_names_and_those_it_requires(tmp_path: Path) -> None:
    file = {"scenario": "composite-30hz", "vary": VARIED, "require": ["effort <= 1", "outcome == completed"], "runs": 3}
    everything = hs.campaign(file, tmp_path / "all").to_dataframe()
    named = hs.campaign({**file, "metrics": ["final_error"]}, tmp_path / "named")
    some = named.to_dataframe()
    assert [name for name in some if name in hs.METRICS] == ["final_error", "effort"]
    for name in some:
        assert (some[name] == everything[name]).all(), name
    assert load_plan(tmp_path / "named" / "campaign.yaml").kept_metrics() == ("final_error", "effort")
    with pytest.raises(OutputError, match="got one that differs in metrics"):
        hs.campaign(file, tmp_path / "named")


@pytest.mark.parametrize(
    ("key", "needed"),
    [
        ("base_motion.level", "base_motion.kind: noise"),
        ("base_motion.amplitude", "base_motion.kind: sinusoid"),
        ("target.motion.frequency", "target.motion.kind: sinusoid"),
        ("camera.outlier_size", "camera.outlier_probability above 0"),
    ],
)
def test_a_key_without_effect_is_refused(key: str, needed: str) -> None:
    varied = {"vary": {"seed": "each", key: {"uniform": [1.0, 2.0]}}}
    message = f"^vary.{key}: has no effect here; it acts only with {needed}; set that in the scenario, or drop the key$"
    with pytest.raises(hs.ScenarioError, match=message):
        load_plan(FILE | varied)
    kind, _, value = needed.partition(": ")
    if value:
        load_plan(FILE | varied, {kind: value})


@pytest.mark.parametrize(
    ("scenario", "key", "needed"),
    [
        ("composite-30hz", "controller.composite.auto.bandwidth", "where one of kp, .* acts and is not given"),
        ("reachy-mini-motors", "controller.tracking.auto.bandwidth", "where a gain that follows from it acts and is"),
        ("pi-h824-positions", "controller.tracking.auto.damping", "in the blocks of other laws, since the motion of"),
    ],
)
def test_what_fits_no_gain_is_refused(scenario: str, key: str, needed: str) -> None:
    file = {"scenario": scenario, "require": ["outcome == completed"], "runs": 3}
    message = f"{key}: has no effect here; it acts only {needed}"
    with pytest.raises(hs.ScenarioError, match=f"^vary.{message}"):
        load_plan(file | {"vary": {key: {"uniform": [0.5, 2.0]}}})
    tune = {"variables": {key: {"uniform": [0.5, 2.0]}}}
    with pytest.raises(hs.ScenarioError, match=f"^tune.variables.{message}") as refused:
        load_plan(file | {"vary": {"seed": "each"}, "tune": tune})
    # no setting gives a damping to the law that has none
    assert ("set that in the scenario" in str(refused.value)) == (key != "controller.tracking.auto.damping")
    assert str(refused.value).endswith("drop the key")


@pytest.mark.parametrize("scenario", ["paper-composite", "pi-h824"])
def test_a_bandwidth_that_gains_follow_varies_whether_it_is_given_or_not(scenario: str) -> None:
    vary = {f"controller.composite.auto.{key}": {"uniform": [1.0, 2.0]} for key in ("bandwidth", "damping")}
    load_plan({"scenario": scenario, "vary": vary, "require": ["outcome == completed"], "runs": 3})


def test_a_key_may_vary_beside_the_one_that_makes_it_act() -> None:
    both = {"camera.outlier_size": {"uniform": [0.0, 5.0]}, "camera.outlier_probability": {"choice": [0.1, 0.0]}}
    load_plan(FILE | {"vary": both})


SOURCES: dict[str, dict[str, Any]] = {
    "none": {},
    "noise": {"camera.noise": 0.1},
    "dropout": {"camera.dropout": 0.3},
    "outliers": {"camera.outlier_probability": 0.3, "camera.outlier_size": 5.0},
    "jitter": {"camera.latency_jitter": 0.002},
    "encoders": {"sensors.pose": "encoders", "sensors.noise": 1e-5},
    "exact encoders": {"sensors.pose": "encoders"},
    "base": {"base_motion.kind": "noise", "base_motion.level": 1e-3},
    "rotation": {"base_motion.rotation.kind": "noise", "base_motion.rotation.level": 1e-6},
    "road": {"base_motion.kind": "road"},
    "a sinusoid": {"base_motion.kind": "sinusoid", "base_motion.amplitude": [0.1, 0.0, 0.0]},
}


@pytest.mark.parametrize("source", SOURCES)
def test_noise_that_all_runs_share_is_known(source: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is there exactly where another seed changes a run, and `seed` does not vary."""
    times = {"camera.period": 0.002, "camera.latency": 0.002, "simulation.duration": 0.02}
    still = hs.load_scenario("composite-30hz").updated({"camera.noise": 0.0, "seed": 7, **times})
    scenario = still.updated(SOURCES[source])
    one, other = (hs.simulate(scenario.updated({"seed": seed})).position for seed in (7, 8))
    differs = not np.array_equal(one, other)
    assert differs == (source not in ("none", "exact encoders", "a sinusoid"))
    vary = {"uncertainty.gravity": {"uniform": [-0.1, 0.1]}}
    file = {"scenario": scenario, "vary": vary, "require": ["outcome == completed"], "runs": 10}
    plan = load_plan(file)
    assert plan.common_noise == (7 if differs else None)
    with monkeypatch.context() as patch:  # a summary of every chunk has it: it is found once
        patch.setattr("hexservo.campaigns.plan.is_random", None)
        assert plan.common_noise == (7 if differs else None)
    assert ("seed" in plan.with_own_noise().vary) == differs
    assert load_plan(file | {"vary": vary | {"seed": "each"}}).common_noise is None


def test_noise_that_varies_from_none_on_is_shared_too() -> None:
    still = hs.load_scenario("composite-30hz").updated({"camera.noise": 0.0})
    file = {"scenario": still, "vary": {"camera.noise": {"uniform": [0.0, 0.2]}}, "require": ["outcome == completed"]}
    assert load_plan(file | {"runs": 10}).common_noise == 0


@pytest.mark.parametrize("other", [{}, {"target.translation": {"uniform": [-1.0, 0.55]}}])
def test_noise_is_found_between_listed_values_and_beside_an_end_that_is_not_valid(other: dict[str, Any]) -> None:
    """The upper end of the translation has the target behind the camera, which is no scenario."""
    still = hs.load_scenario("composite-30hz").updated({"camera.noise": 0.0})
    file = {"scenario": still, "require": ["outcome == completed"], "runs": 10}
    assert load_plan(file | {"vary": {"camera.noise": {"choice": [0.0, 0.2, 0.0]}, **other}}).common_noise == 0
    assert load_plan(file | {"vary": {"camera.noise": {"choice": [0.0, 0.0]}, **other}}).common_noise is None


def test_the_file_of_the_page_is_valid() -> None:
    page = Path(__file__).parents[2] / "docs" / "campaigns.md"
    first = page.read_text(encoding="utf-8").split("```yaml\n")[1].split("```")[0]
    load_plan(load_yaml(first))  # type: ignore[arg-type]


@pytest.mark.parametrize(("change", "message"), REFUSED)
def test_refusals(change: dict[str, Any], message: str) -> None:
    file = {"scenario": "composite-30hz", "vary": VARIED, "require": ["effort <= 1"], "runs": 1}
    with pytest.raises(hs.ScenarioError, match=message):
        CampaignPlan(**{**file, **change})


@pytest.mark.parametrize(
    "change",
    [
        {"require": ["settling_time <= 0.3"]},  # 0.5 - 0.2 is 0.3 but for rounding
        {"vary": {"simulation.duration": {"choice": [0.4, 0.6]}}, "require": ["settling_time <= 0.4"]},
        {"vary": {"metrics.dwell": {"uniform": [0.1, 0.2]}}, "require": ["settling_time <= 0.4"]},
        {"vary": {"metrics.dwell": {"uniform": [-0.1, 0.0], "add": True}}, "require": ["settling_time <= 0.4"]},
        {
            "scenario": SHORT_LIVED,  # but no run is as short
            "vary": {"simulation.duration": {"choice": [0.4, 0.6]}, "metrics.rms_start": {"choice": [0.1]}},
            "require": ["settling_time <= 0.3", "rms_error <= 2"],
        },
    ],
)
def test_a_bound_that_some_run_can_reach_is_accepted(change: dict[str, Any]) -> None:
    CampaignPlan(**{"scenario": HALF_A_SECOND, "vary": VARIED, "runs": 1, **change})


@pytest.mark.parametrize(
    "require",
    [
        [{"holds": "overshoot <= 0", "scale": 1.0}],
        [{"holds": "overshoot > 0", "scale": 1.0}],
        ["rms_error >= 0.2", "rms_error <= 0.2"],
        ["rms_error <= 0.2", "final_error >= 0.3"],
    ],
)
def test_a_bound_that_some_run_keeps_and_another_misses_is_accepted(require: list[Any]) -> None:
    CampaignPlan(scenario="composite-30hz", vary=VARIED, require=require, runs=1)


def test_no_such_campaign() -> None:
    with pytest.raises(hs.ScenarioError, match='"campaign-papr": no such file, and no packaged campaign has that name'):
        load_plan("campaign-papr")
    with pytest.raises(hs.ScenarioError, match="expected a campaign: a block with scenario, vary and require; got"):
        load_plan(Path(__file__).parents[2] / "python" / "hexservo" / "py.typed")
    with pytest.raises(TypeError, match="source: expected the name or path of a campaign, or a mapping, got int"):
        load_plan(3)  # type: ignore[arg-type]
    with pytest.raises(hs.ScenarioError, match="runs: expected an integer"):
        load_plan(FILE, runs=-1)
    with pytest.raises(hs.ScenarioError, match=r"camera\.period: expected"):
        load_plan(FILE, {"camera.period": -1})


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"uncertainty.gravity": 0.2}, "uncertainty.gravity"),
        ({"seed": 5}, "seed"),
        ({"uncertainty": {"depth": 0.1, "coriolis": 0.0}}, "uncertainty.depth"),
    ],
)
def test_a_change_of_what_varies_is_refused(changes: dict[str, Any], named: str) -> None:
    message = f"{named}: has no effect, since vary has the key too, and every run draws its own value; drop the"
    with pytest.raises(hs.ScenarioError) as refused:
        load_plan(FILE, changes)
    assert [problem.startswith(message) for problem in refused.value.problems] == [True]


def test_a_mass_that_varies_is_refused_where_gains_are_fitted_to_that_of_each_run() -> None:
    scenario = hs.load_scenario("paper-composite").updated({"controller.composite.auto.bandwidth": 1.0})
    file = {"scenario": scenario, "vary": {"robot.mass": {"uniform": [1, 2]}}, "require": ["effort <= 1"], "runs": 1}
    assert load_plan(file, {"uncertainty.gravity": 0.1}).scenario.uncertainty.gravity == 0.1
    with pytest.raises(hs.ScenarioError, match=r"^robot.mass: has no effect"):
        load_plan(file, {"robot.mass": 1.5, "uncertainty.gravity": 0.1})


def test_a_change_to_which_a_drawn_number_is_added_counts() -> None:
    changed = load_plan(FILE, {"controller.composite.kt": 2.0, "uncertainty": {"coriolis": 0.0}})
    drawn = changed.drawing().numbers(0, 50)["controller.composite.kt"]
    np.testing.assert_allclose(drawn, 2.0, rtol=0, atol=0.1)


def test_changes_that_are_no_mapping_are_refused() -> None:
    with pytest.raises(TypeError, match="changes: expected a mapping of dotted keys, or None, got int"):
        load_plan(FILE, 3)  # type: ignore[arg-type]


def test_a_machine_without_the_variant_refuses() -> None:
    from hexservo.run.variant import available_variants, chosen_kernel

    chosen = chosen_kernel().name
    assert PLAN.required_variant() == PLAN.changed(variant=chosen).required_variant() == chosen
    for variant in {"avx512", "avx2", "baseline"} - {chosen}:
        remedy = f"HEXSERVO_VARIANT={variant}" if variant in available_variants() else "run it elsewhere"
        with pytest.raises(hs.VariantError, match=f"expected {variant}.*, got {chosen}; .*{remedy}"):
            PLAN.changed(variant=variant).required_variant()


def test_a_plan_has_its_chunks_and_no_others() -> None:
    plan = PLAN.changed(runs=7, chunk_size=3, until=None)
    assert [plan.runs_of_chunk(index) for index in range(3)] == [(0, 3), (3, 6), (6, 7)]
    for index in (-1, 3):
        with pytest.raises(
            IndexError, match=rf"^index: expected a chunk of the campaign, counted from 0, got {index}$"
        ):
            plan.runs_of_chunk(index)
    with pytest.raises(ValueError, match=r"^failures: expected an integer from 0 to 5, got 6$"):
        plan.interval(6, 5)
