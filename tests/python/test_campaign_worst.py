"""The worst case: the box of the variations, the search in it, and what is reported of it."""

from __future__ import annotations

import dataclasses
import itertools
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import hexservo as hs
from hexservo.campaigns import worst_case
from hexservo.campaigns.distributions import variation_of
from hexservo.campaigns.judging import Judge
from hexservo.campaigns.plan import load_plan
from hexservo.campaigns.requirements import requirement_of
from hexservo.campaigns.worst_case import WorstCase, smallest_in_box
from hexservo.findings.diagnosis import Diagnosis
from hexservo.scenario.arrays import Array
from test_terminal import invoke

FORMS: list[dict[str, Any]] = [
    {"uniform": [-2.0, 3.0]},
    {"normal": [1.0, 0.5]},
    {"normal": [1.0, 0.5], "clip": [0.8, 1.1]},
    {"log": [1e-3, 10.0]},
    {"uniform": [-2.0, 3.0], "clip": [-1.0, 9.0]},
    {"choice": [3.0, -1.0, 7.0]},
    {"normal": [1.0, 0.5], "clip": [-1.0, 4.5]},  # 4 and 7 standard deviations, which draws reach
    {"normal": [1.0, 0.5], "clip": [0.0, 100.0]},  # an upper limit that no draw reaches
    {"normal": [1.0, 0.5], "clip": [-100.0, 100.0]},
]
BOXES = [(-2, 3), (-0.5, 2.5), (0.8, 1.1), (1e-3, 10), (-1, 3), (-1, 7), (-1, 4.5), (0, 2.5), (-0.5, 2.5)]


@pytest.mark.parametrize(("form", "box"), list(zip(FORMS, BOXES, strict=True)))
def test_the_box_of_a_distribution(form: dict[str, Any], box: tuple[float, float]) -> None:
    variation = variation_of(form)
    assert variation.box == pytest.approx(box, rel=1e-12)
    shares = np.linspace(0, 1, 101)
    numbers = variation.in_box(shares)
    assert (numbers[0], numbers[-1]) == pytest.approx(box, rel=1e-12)
    assert (np.diff(numbers) >= 0).all()
    again = variation.in_box(variation.share_of(numbers))
    np.testing.assert_allclose(again, numbers, rtol=1e-12, atol=1e-15)
    beyond = variation.share_of(np.array([-1e9, 1e9]))
    assert set(beyond.tolist()) <= {0.0, 1.0} if "choice" not in form else beyond.min() >= 0


@pytest.mark.parametrize(
    ("form", "ends"),
    [
        ({"uniform": [0.0, 0.1]}, (0.0, 0.1)),
        ({"uniform": [-0.3, 0.3]}, (-0.3, 0.3)),
        ({"uniform": [0.0, 0.1], "clip": [-1.0, 0.07]}, (0.0, 0.07)),
        ({"log": [1e-3, 40.0]}, (1e-3, 40.0)),
        ({"log": [1e-3, 40.0], "clip": [2e-3, 50.0]}, (2e-3, 40.0)),
    ],
)
def test_ends_of_a_box_are_the_numbers_that_the_file_has(form: dict[str, Any], ends: tuple[float, float]) -> None:
    """And not the outermost draw, as 1.11e-17 in place of 0."""
    variation = variation_of(form)
    assert variation.box == variation.reach == ends
    assert variation.in_box(np.zeros(1)) == pytest.approx(ends[0], rel=1e-12, abs=0)


def test_a_box_without_width_has_places() -> None:
    variation = variation_of({"normal": [1e20, 1.0]})
    assert variation.box == (1e20, 1e20)
    np.testing.assert_array_equal(variation.share_of(np.array([1e19, 1e20, 1e21])), [0.0, 0.0, 1.0])


def test_a_run_is_found_at_its_place_in_the_box() -> None:
    plan = load_plan("campaign-real-machine")
    drawing = plan.drawing()
    for run in (0, 17, 4711):
        drawn, placed = drawing.numbers(run, run + 1), drawing.numbers_at(drawing.shares(run)[None], run)
        assert drawn.keys() == placed.keys()
        for key in drawn:
            if key == "seed":
                assert drawn[key] == placed[key]
            else:
                np.testing.assert_allclose(placed[key], drawn[key], rtol=1e-9, atol=1e-12)


def test_the_worst_case_is_searched_up_to_the_limits(tmp_path: Path) -> None:
    """The legs travel the farthest with the smallest mass, 6.7 standard deviations from the mean."""
    vary = {
        "uncertainty.gravity": {"normal": [0.0, 0.03], "clip": [-0.2, 0.15]},
        "uncertainty.depth": {"uniform": [0, 0.1]},
    }
    file = FILE | {"vary": vary, "require": ["peak_leg_excursion <= 0.006"]}
    case = hs.worst_case(hs.campaign(file, tmp_path / "out", runs=3), runs=60, restarts=1)
    assert case.scenario.uncertainty.gravity == -0.2
    assert [key for key, *_ in case.box] == ["uncertainty.gravity [1]", "uncertainty.depth [1]"]
    np.testing.assert_allclose([ends for _, *ends in case.box], [[-0.2, 0.15], [0.0, 0.1]], atol=1e-15)
    assert [table.title for table in case.section().items] == ["Smallest margin found", "Box that was searched"]
    assert case.section().data["box"] == case.box


# ---- The search -----------------------------------------------------------------------------------------------------


def planted(seed: int, dimension: int = 6) -> tuple[Callable[[Array], Array], float]:
    """A margin that is quadratic in the entries of the box, with every pair of them interacting, and its smallest value
    over the corners: where the diagonal is not positive, no other point has a smaller one."""
    random = np.random.default_rng(seed)
    slope, pairs = random.normal(size=dimension), 0.2 * random.normal(size=(dimension, dimension))
    pairs[np.diag_indices(dimension)] = np.abs(pairs.diagonal())

    def margin(shares: Array) -> Array:
        centred = 2 * shares - 1
        excess = centred @ slope + np.einsum("ni,ij,nj->n", centred, pairs, centred)
        return np.asarray(1 - excess / np.abs(slope).sum())

    corners = np.array(list(itertools.product((0.0, 1.0), repeat=dimension)))
    return margin, float(margin(corners).min())


@pytest.mark.slow
def test_a_planted_worst_case_is_found() -> None:
    """From the three worst of 300 random points, as a search begins from a campaign's worst runs."""
    found = []
    for seed in range(1, 31):
        margin, smallest = planted(seed)
        points = np.random.default_rng(1000 + seed).random((300, 6))
        calls: list[int] = []

        def counted(shares: Array, margin: Callable[[Array], Array] = margin, calls: list[int] = calls) -> Array:
            assert shares.min() >= 0
            assert shares.max() <= 1
            calls.append(len(shares))
            return margin(shares)

        starts = points[np.argsort(margin(points))[:3]]
        values = [smallest_in_box(counted, start, 333, seed) for start in starts]
        for place, value in values:
            assert margin(place[None])[0] == pytest.approx(value, abs=1e-12)  # sums of another order
        assert sum(calls) <= 1000
        found.append(min(value for _, value in values) - smallest)
    print(f"seeds 1 to 30: distances to the planted margin {np.round(sorted(found), 4).tolist()}")
    assert sum(distance <= 0.01 for distance in found) >= 29


@pytest.mark.parametrize("dimension", [1, 2, 70])
def test_a_search_keeps_to_its_evaluations_and_its_seed(dimension: int) -> None:
    calls: list[int] = []

    def parabola(shares: Array) -> Array:
        calls.append(len(shares))
        return np.asarray(((shares - 0.3) ** 2).sum(axis=1))

    start = np.full(dimension, 0.9)
    one, other = (smallest_in_box(parabola, start, 500, 5) for _ in range(2))
    assert sum(calls) <= 1000
    assert one[0].tobytes() == other[0].tobytes()
    assert one[1] < parabola(start[None])[0]
    assert one[1] < 1e-2 or dimension > 2


# ---- Of a campaign --------------------------------------------------------------------------------------------------

FILE: dict[str, Any] = {
    "scenario": hs.load_scenario("paper-composite").updated({"simulation.duration": 0.8}),
    "vary": {
        "uncertainty.gravity": {"normal": [0.0, 0.03]},
        "uncertainty.depth": {"uniform": [-0.3, 0.3], "each": True},
    },
    "require": ["outcome == completed", "peak_error <= 80", "peak_leg_excursion <= 0.006"],
    "runs": 100,
}


def test_the_worst_case_of_a_campaign(tmp_path: Path) -> None:
    result = hs.campaign(FILE, tmp_path / "out")
    case = hs.worst_case(result, runs=150, seed=3)
    assert case.margin == min(margin for _, margin in case.margins)
    assert [name for name, _ in case.margins] == ["peak_error <= 80.0", "peak_leg_excursion <= 0.006"]
    assert case.runs <= 3 * 150
    uncertainty = case.scenario.uncertainty
    assert abs(float(np.max(uncertainty.gravity))) <= 0.09
    assert np.abs(uncertainty.depth).max() <= 0.3
    again = hs.simulate(hs.load_scenario(case.path))
    assert again.scenario == case.scenario
    peak = hs.metrics(again)["peak_leg_excursion"]  # a single run agrees with a lane to rounding (docs/batch.md)
    assert min(1 - peak / 0.006, 1 - hs.metrics(again)["peak_error"] / 80) == pytest.approx(case.margin, abs=1e-6)
    sentences = case.section().sentences
    assert "which proves no bound" in sentences[1]
    assert not any("same noise" in sentence for sentence in sentences)  # none is random
    shared = dataclasses.replace(case, common_noise=7).section()
    assert shared.sentences[2].startswith(
        "All runs have the same noise (seed 7): it is the worst case for that noise alone; "
    )
    assert shared.data["common_noise"] == 7
    same = hs.worst_case(result, runs=150, seed=3)
    assert (same.scenario, same.margin) == (case.scenario, case.margin)


@pytest.mark.parametrize(
    ("require", "searches"),
    [(FILE["require"][1:2], 1), (FILE["require"][:2], 1), (FILE["require"][1:], 3), (FILE["require"], 3)],
)
def test_a_search_for_each_metric_needs_two(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, require: list[str], searches: int
) -> None:
    """Beside the outcome alone the search for a metric is that for all requirements: the same runs again."""
    result = hs.campaign(FILE | {"require": require}, tmp_path / "out", runs=3)
    begun: list[int] = []

    def counted(function: Callable[[Array], Array], start: Array, evaluations: int, seed: int) -> None:
        function(start[None])
        begun.append(seed)

    monkeypatch.setattr(worst_case, "smallest_in_box", counted)
    monkeypatch.setattr(worst_case, "_diagnosed", lambda *of_run: None)
    case = hs.worst_case(result, runs=9, restarts=2)
    assert len(begun) == 2 * searches
    assert len(case.margins) == sum(not one.startswith("outcome") for one in require if len(require) > 1)


def test_the_smallest_margins_are_those_of_all_searches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With margins at random the search for all requirements finds smaller ones of some than the search for each."""
    result = hs.campaign(FILE, tmp_path / "out", runs=3)
    random, tried = np.random.default_rng(5), []

    def judged(self: Judge, numbers: dict[str, Array]) -> tuple[NDArray[np.intp], Array, None]:
        tried.append(random.random((len(numbers["uncertainty.gravity"]), 3)))
        return np.arange(len(tried[-1])), tried[-1], None

    monkeypatch.setattr(Judge, "judged_where_valid", judged)
    for seed in range(3):
        tried.clear()
        case = hs.worst_case(result, runs=60, seed=seed)
        least = np.concatenate(tried).min(axis=0)
        assert case.margin == least.min()
        assert [margin for _, margin in case.margins] == least[1:].tolist()  # none of completion


def test_a_worse_run_outside_the_box_has_its_reason(tmp_path: Path) -> None:
    vary = {"target.translation": {"normal": [0.0, 1.0], "each": True}}
    drawing = load_plan(FILE | {"vary": vary | {"uncertainty.gravity": {"uniform": [-0.1, 0.1]}}}).drawing()
    beyond = np.abs(drawing.numbers(0, 500)["target.translation"]) > 3.0
    assert 1 <= beyond.any(axis=1).sum() <= 20  # 4 of 500 on average
    for run in (*np.flatnonzero(beyond.any(axis=1)), *range(20)):
        assert drawing.outside(int(run)) == [f"target.translation[{axis}]" for axis in np.flatnonzero(beyond[run])]
    case = hs.worst_case(hs.campaign(FILE, tmp_path / "out", runs=3), runs=6, restarts=1)
    assert not any("outside of the box" in sentence for sentence in case.section().sentences)
    worse = dataclasses.replace(case, drawn_margin=case.margin - 1, outside=("uncertainty.gravity",))
    assert worse.section().sentences[2] == (
        "worst-run.yaml has the campaign's own worst run, which is worse: outside of the box that is searched lies its "
        "uncertainty.gravity."
    )


@pytest.mark.parametrize("common_noise", [None, 7])
@pytest.mark.parametrize(
    ("margin", "drawn", "verdict", "ends"),
    [
        (0.00125, -0.00125, "bad", "passes: its margin is 0.00125; the smallest one of the campaign's own runs is "
         "-0.00125, which fails."),
        (-0.1, 0.1, "bad", "fails: its margin is -0.1; the smallest one of the campaign's own runs is 0.1."),
        (0.1, 0.2, "open", "passes: its margin is 0.1; the smallest one of the campaign's own runs is 0.2."),
    ],
)  # fmt: skip
def test_a_search_proves_no_good_verdict(
    margin: float, drawn: float, verdict: str, ends: str, common_noise: int | None
) -> None:
    scenario = FILE["scenario"]
    case = WorstCase(scenario, Path("x"), margin, (), drawn, (), 10, 0, common_noise, "")
    assert case.section().verdict == verdict
    assert case.section().sentences[0] == f"The worst case found {ends}"


@pytest.mark.parametrize(
    ("margin", "drawn", "failures", "verdict"),
    [
        (-0.1, 0.1, 2, "warning"),
        (-0.1, -0.1, 50, "warning"),
        (-0.1, 0.1, 51, "bad"),
        (-0.1, 0.1, 0, "warning"),
        (0.1, -0.1, 0, "warning"),
        (0.1, 0.1, 1, "warning"),
        (0.1, 0.1, 0, "open"),
    ],
)
def test_other_seeds_decide_the_verdict(margin: float, drawn: float, failures: int, verdict: str) -> None:
    case = WorstCase(
        FILE["scenario"], Path("x"), margin, (), drawn, (), 10, 0, None, "", None, 0, "", (), 100, failures
    )
    assert case.section().verdict == verdict
    assert case.section().sentences[1] == f"With other noise this case fails in {failures} of 100 runs (other seeds)."
    noise = "; with the noise of the campaign's worst runs"
    assert case.section().sentences[2].endswith(f"of a search (seed 0{noise}), which proves no bound.")
    one_noise = dataclasses.replace(case, common_noise=7)
    assert noise not in " ".join(one_noise.section().sentences)


@pytest.mark.parametrize("vary", [{"seed": "each"}, {}])
def test_a_case_is_repeated_with_other_noise(vary: dict[str, Any], tmp_path: Path) -> None:
    """The share of other seeds that fail is that of independent ones: about a third of all runs is above the bound."""
    noisy = hs.load_scenario("noisy-camera", {"simulation.duration": 0.3, "metrics.rms_start": 0.1})
    bound = float(np.quantile(of_seeds(noisy, range(1000, 1400)), 0.7))
    require = [f"peak_leg_force <= {bound}"]
    vary = {"uncertainty.gravity": {"uniform": [-1e-9, 1e-9], "add": True}} | vary
    case = hs.worst_case(
        hs.campaign({"scenario": noisy, "vary": vary, "require": require, "runs": 20}, tmp_path / "out"), runs=8
    )
    assert case.other_seeds == 100
    assert case.runs <= 8
    expected = (of_seeds(case.scenario, range(400)) > bound).mean()
    print(f"{case.other_failures} of 100 other seeds fail, {expected:.3f} of 400 independent ones")
    assert 0.2 < expected < 0.4
    assert stats.binomtest(case.other_failures, 100, expected).pvalue > 1e-3
    assert case.section().verdict == "warning"


def of_seeds(scenario: hs.Scenario, seeds: range) -> Array:
    """Return the largest leg force [N] of runs with other seeds."""
    batch = hs.simulate_batch(scenario, {"seed": np.array(seeds, dtype=np.uint64)}, "metrics")
    return np.asarray(batch.metrics["peak_leg_force"])


def test_a_worst_case_keeps_the_noise_that_all_runs_share(tmp_path: Path) -> None:
    noisy = hs.load_scenario("noisy-camera", {"simulation.duration": 0.3, "seed": 7})
    file = FILE | {"scenario": noisy, "runs": 2}
    result = hs.campaign(file, tmp_path / "out")
    assert result.plan.common_noise == 7
    assert hs.worst_case(result, runs=4, restarts=1).common_noise == 7


def test_a_worst_case_that_fails_has_a_diagnosis(tmp_path: Path) -> None:
    file = FILE | {"scenario": "fails-gravity", "vary": {"uncertainty.depth": {"uniform": [0.0, 0.1]}}, "runs": 2}
    file["require"] = ["final_error <= 2"]
    case = hs.worst_case(hs.campaign(file, tmp_path / "out"), runs=20, restarts=1)
    assert case.margin < 0
    assert case.diagnosis is not None
    assert case.section().verdict == "bad"
    assert case.section().sentences[2] == case.diagnosis.section().sentences[0]
    assert case.section().sentences[2].startswith("The most likely cause is ")
    unnamed = tuple(dataclasses.replace(cause, named=False) for cause in case.diagnosis.causes)
    other = dataclasses.replace(case, diagnosis=dataclasses.replace(case.diagnosis, causes=unnamed))
    assert other.section().sentences[2].startswith("Not explained")


TOO_SHORT = FILE["scenario"].updated(
    {"simulation.duration": 0.5, "uncertainty.gravity": 0.09, "uncertainty.depth": -0.3}
)


@pytest.fixture(scope="module")
def too_short() -> Diagnosis:
    """Of a run that is too short to settle: 2 s are enough, in which the legs travel farther."""
    found = hs.diagnose(hs.simulate(TOO_SHORT))
    longer = hs.metrics(hs.simulate(TOO_SHORT.updated({"simulation.duration": 2.0})))
    assert (found.too_short, found.cures) == (2.0, ({"simulation.duration": 2.0},))
    assert found.leg_travel < 0.0055 < longer["peak_leg_excursion"]
    assert longer["final_error"] < 2.0
    return found


@pytest.mark.parametrize(
    ("require", "explained"),
    [
        (["final_error <= 2"], True),
        (["outcome == completed", "final_error <= 2", "peak_leg_excursion <= 0.0155"], True),
        (["final_error <= 2", "peak_leg_excursion <= 0.0055"], False),  # kept by the short run alone
        (["peak_leg_excursion <= 0.0045"], False),  # not what fails by the criteria of a diagnosis
        (["final_error <= 100", "peak_leg_force <= 0.01"], False),
    ],
)
def test_a_diagnosis_is_given_where_its_cure_keeps_the_requirements(
    too_short: Diagnosis, require: list[str], explained: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worst_case, "diagnose", lambda run: too_short)
    found = worst_case._diagnosed(TOO_SHORT, [requirement_of(one) for one in require])
    assert found is (too_short if explained else None)


def test_the_changes_that_a_diagnosis_states_as_cures(too_short: Diagnosis) -> None:
    unnamed = [dataclasses.replace(cause, named=False) for cause in too_short.causes if cause.without is not None]
    two = tuple(cause for cause in unnamed if cause.without is not None and cause.without.works)[:2]
    assert len(two) == 2
    changes = tuple(cause.without.changes for cause in two if cause.without is not None)
    pair = dataclasses.replace(too_short, causes=two)
    assert pair.cures == changes[:1], "the most effective change, where no cause is named"
    pair = dataclasses.replace(pair, together=tuple(cause.cause for cause in two))
    assert pair.cures == changes
    assert two[1].without is not None
    failing = dataclasses.replace(two[1], without=dataclasses.replace(two[1].without, works=False))
    assert dataclasses.replace(pair, causes=(two[0], failing)).cures == ({**changes[0], **changes[1]},)
    assert dataclasses.replace(pair, causes=(failing,), together=()).cures == ()
    assert dataclasses.replace(too_short, causes=()).cures == ()


def test_what_has_no_worst_case(tmp_path: Path) -> None:
    only_seeds = {"scenario": "slow-camera", "vary": {"seed": "each"}, "require": ["outcome == completed"], "runs": 1}
    result = hs.campaign(only_seeds, tmp_path / "out")
    with pytest.raises(ValueError, match="more than seed varies; got one in which seed alone varies"):
        hs.worst_case(result)
    with pytest.raises(TypeError, match=r"result: expected a CampaignResult \(see hs.campaign\), got dict"):
        hs.worst_case(only_seeds)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="seed: expected an integer, got NoneType"):
        hs.worst_case(result, seed=None)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="restarts: expected an integer of at least 1, got 0"):
        hs.worst_case(result, restarts=0)


def campaign_of(folder: Path, *changes: str) -> list[str]:
    """Return the command for the file c.yaml of a folder, into its folder out."""
    sets = [word for change in changes for word in ("--set", change)]
    return ["campaign", str(folder / "c.yaml"), "--out", str(folder / "out"), *sets]


def test_a_worst_case_of_seeds_alone_is_refused_before_the_runs(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(
        "scenario: slow-camera\nvary: {seed: each}\nrequire: [outcome == completed]\nruns: 2\n", encoding="utf-8"
    )
    arguments = campaign_of(tmp_path, "simulation.duration=0.3")
    code, out, err = invoke(*arguments, "--worst", "--report")
    assert (code, out) == (2, "")
    assert err.startswith("Error: --worst: expected more that varies than seed")
    assert not (tmp_path / "out").exists()
    assert invoke(*arguments, "--report")[0] == 0


def test_the_command_searches_the_worst_case(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(
        "scenario: paper-composite\nvary: {uncertainty.gravity: {uniform: [-0.05, 0.05]}}\n"
        "require: [settling_time <= 0.04]\nruns: 20\n",
        encoding="utf-8",
    )
    arguments = campaign_of(tmp_path, "simulation.duration=0.05", "metrics.dwell=0.01")
    code, out, err = invoke(*arguments, "--worst")
    assert (code, err) == (0, "")
    assert f"the worst case found: hexservo run {tmp_path}/out/worst-case.yaml" in out
    assert "without the file" not in out, "no packaged scenario has these changes"
    assert hs.load_scenario(tmp_path / "out" / "worst-case.yaml").simulation.duration == 0.05


def test_the_worst_case_of_a_packaged_scenario_has_a_command_without_its_file(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(
        "scenario: paper-composite\nvary:\n  uncertainty.gravity: {uniform: [-0.05, 0.05]}\n"
        "  simulation.duration: {choice: [0.04, 0.05]}\n  metrics.dwell: {choice: [0.01]}\n"
        "  metrics.rms_start: {choice: [0.01]}\nrequire: [peak_leg_force <= 1]\nruns: 4\n",
        encoding="utf-8",
    )
    code, out, err = invoke("campaign", str(tmp_path / "c.yaml"), "--out", str(tmp_path / "out"), "--worst")
    assert (code, err) == (0, "")
    (command,) = re.findall(r"^the same without the file: (hexservo run paper-composite .*)$", out, re.MULTILINE)
    settings = (text.split("=") for text in shlex.split(command)[3:] if text != "--set")
    case = hs.load_scenario(tmp_path / "out" / "worst-case.yaml")
    assert hs.load_scenario("paper-composite", {key: float(value) for key, value in settings}) == case
