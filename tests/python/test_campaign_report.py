"""The page of a campaign: its sentences and pictures, from the folder alone."""

from __future__ import annotations

import base64
import json
import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
import pytest
from scipy.stats import rankdata

import hexservo as hs
from browsers import chromium, in_browser
from hexservo.campaigns.drawing import with_unit
from hexservo.campaigns.intervals import anytime_interval
from hexservo.campaigns.pictures import campaign_sections, correlations, size_of_chance
from hexservo.draw.evidence import item_figure
from hexservo.draw.style import BLUE, VERMILION
from hexservo.findings.evidence import Bars, Curves, Line, Section, Share
from hexservo.report.charts import LINE_COLOURS, bars, curves
from hexservo.run.files import MARKER
from test_campaign_engine import FILE, RUNS
from test_campaign_search import SHORT
from test_terminal import invoke

arrow = hs.CampaignResult.to_arrow


def one_column(result: hs.CampaignResult, columns: Sequence[str] | None = None) -> pa.Table:
    """Return the margins, the only column of all runs that a page may have in memory."""
    assert columns == ["margin"]
    return arrow(result, columns)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> hs.CampaignResult:
    return hs.campaign(FILE, tmp_path_factory.mktemp("campaign") / "out")


@pytest.fixture(scope="module")
def more(tmp_path_factory: pytest.TempPathFactory) -> tuple[Section, ...]:
    """Sections of a search for a front, and of sensitivity: of few candidates, as a page shows a front of any size."""
    tune = SHORT["tune"] | {"minimise": ["rms_error", "peak_leg_force"], "over": 2}
    short = SHORT["scenario"].updated({"simulation.duration": 0.1, "metrics.rms_start": 0.05})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hexservo.campaigns.strategies._POPULATION", 8)
        file = SHORT | {"scenario": short, "tune": tune}
        found = hs.tune(file, tmp_path_factory.mktemp("tune") / "out", generations=2, rounds=1)
    return (*found.sections(), hs.sensitivity(SHORT, samples=32).section())


def curves_of(result: hs.CampaignResult) -> dict[str, Curves]:
    items = [item for section in campaign_sections(result) for item in section.items]
    return {item.title: item for item in items if isinstance(item, Curves)}


def test_the_curves_are_those_of_the_runs(result: hs.CampaignResult) -> None:
    table = result.to_dataframe()
    found = curves_of(result)
    assert list(found) == ["Failure probability", "Peak leg excursion", "Final error", "Runs in the plane of both"]
    upper, lower, share = found["Failure probability"].lines
    for n, high in zip(upper.x, upper.y, strict=True):
        failures = int((table.margin[: int(n)] < 0).sum())
        assert high == anytime_interval(failures, int(n))[1]
    assert (upper.x[-1], lower.y[-1], share.y[-1]) == (RUNS, result.interval[0], result.failures / RUNS)
    values, bound = found["Final error"].lines
    assert set(bound.x) == {1.5}
    for place in (0, 100, 399):
        at_most = (table.final_error <= values.x[place] + 1e-12).mean()
        assert at_most == pytest.approx(values.y[place], abs=1.5 / RUNS + 1 / 399)
    passes, fails = found["Runs in the plane of both"].lines
    assert (passes.name, fails.name) == ("passes", "fails")
    assert len(fails.x) == min(result.failures, 600)


def influential(result: hs.CampaignResult) -> list[tuple[str, float]]:
    """Return the two varied numbers that the margin depends on most, with the size of their rank correlation."""
    return correlations(pa.concat_tables(result.tables()))[:2]


def test_what_varies_has_its_unit(result: hs.CampaignResult, paper: hs.Scenario) -> None:
    plane = curves_of(result)["Runs in the plane of both"]
    names = [name for name, _ in influential(result)]
    assert [plane.x_label, plane.y_label] == [with_unit(result.plan.scenario, name) for name in names]
    page = hs.write_campaign_report(result).read_text(encoding="utf-8")
    for key in result.plan.vary:
        assert with_unit(result.plan.scenario, key) in page
    cranks = hs.load_scenario("reachy-mini-motors")
    for scenario, name, unit in (
        (paper, "robot.stroke", " [m]"),
        (cranks, "robot.stroke", " [rad]"),
        (paper, "camera.noise", " [px]"),
        (paper, "uncertainty.gravity[2]", " [1]"),
        (paper, "controller.hybrid.kv", " [N; N m]"),
        (paper, "controller.hybrid.kv[2]", " [N]"),
        (paper, "simulation.start.pose[3]", " [rad]"),
        (paper, "target.translation[0]", " [m]"),
        (paper, "target.rotation[0]", " [rad]"),
        (paper, "controller.hybrid.auto.bandwidth", " [Hz]"),
    ):
        assert with_unit(scenario, name) == name + unit


def test_the_most_influential_number_is_found(tmp_path: Path) -> None:
    """Of an error that matters whatever its sign, and one that does not matter."""
    file = {
        "scenario": hs.load_scenario("paper").updated({"simulation.duration": 0.3}),
        "vary": {"metrics.band": {"uniform": [0.5, 2.0]}, "uncertainty.gravity": {"normal": [0.0, 0.1]}},
        "require": ["peak_leg_excursion <= 0.02"],
        "runs": 200,
    }
    names = influential(hs.campaign(file, tmp_path / "out"))
    assert [name for name, _ in names] == ["uncertainty.gravity", "metrics.band"]
    assert names[0][1] > 0.8 > 0.3 > names[1][1]


@pytest.mark.parametrize(("bound", "kind", "colour", "symbol"), [(0.1, "passes", 0, 0), (1e-9, "fails", 1, 1)])
def test_runs_of_one_kind_have_its_colour_and_symbol(
    tmp_path: Path, bound: float, kind: str, colour: int, symbol: int
) -> None:
    """Where no run is of the other kind too."""
    varied = {"uncertainty.gravity": {"normal": [0.0, 0.1]}, "metrics.band": {"uniform": [0.5, 2.0]}}
    short = hs.load_scenario("paper").updated({"simulation.duration": 0.02})
    require = [f"peak_leg_excursion <= {bound}"]
    found = hs.campaign({"scenario": short, "vary": varied, "require": require, "runs": 20}, tmp_path / "out")
    plane = curves_of(found)["Runs in the plane of both"]
    assert [line.name for line in plane.lines] == [kind]
    (script,) = re.findall(r"<script[^>]*>(.*?)</script>", curves(plane), re.DOTALL)
    markers = json.loads(script)["data"][0]["marker"]
    assert (markers["color"], markers["symbol"]) == (LINE_COLOURS[colour], ("circle", "square")[symbol])
    (dots,) = item_figure(plane).axes[0].lines
    assert (dots.get_color(), dots.get_marker()) == ((BLUE, VERMILION)[colour], "os"[symbol])


def test_a_campaign_of_one_run_is_in_the_singular(tmp_path: Path) -> None:
    file = {
        "scenario": hs.load_scenario("paper").updated({"simulation.duration": 0.02}),
        "vary": {"uncertainty.gravity": {"normal": [0.0, 0.1]}},
        "require": ["peak_leg_excursion <= 0.02"],
        "runs": 1,
    }
    found = {
        section.name: " ".join(section.sentences) for section in campaign_sections(hs.campaign(file, tmp_path / "out"))
    }
    assert found["interval"].startswith("After 1 run it is")
    assert found["failures"] == "One run shows no influence of a number: that takes several runs."


def test_one_number_for_several_entries_is_named_once(tmp_path: Path) -> None:
    file = {
        "scenario": hs.load_scenario("paper").updated({"simulation.duration": 0.2, "metrics.rms_start": 0.0}),
        "vary": {"target.translation": {"uniform": [-5e-3, 5e-3]}, "uncertainty.gravity": {"normal": [0.0, 0.1]}},
        "require": ["peak_leg_excursion <= 0.02"],
        "runs": 50,
    }
    names = [name for name, _ in influential(hs.campaign(file, tmp_path / "out"))]
    assert {name.partition("[")[0] for name in names} == {"target.translation", "uncertainty.gravity"}
    seeds = {"scenario": "slow-camera", "vary": {"seed": "each"}, "require": ["final_error <= 9"], "runs": 3}
    found = campaign_sections(hs.campaign(seeds, tmp_path / "seeds"))[-1]
    assert found.sentences == ["Nothing but seeds varies."]


def test_the_size_that_chance_reaches_is_kept_in_95_of_100_campaigns() -> None:
    """Numbers that have no influence, with their distances from the median."""
    random = np.random.default_rng(20261128)
    for runs, inputs in ((30, 62), (300, 62), (30, 1)):
        margins = random.random((400, runs))
        largest = []
        for margin in margins:
            values = random.random((inputs, runs))
            parts = np.concatenate([values, np.abs(values - np.median(values, axis=1, keepdims=True))])
            ranks = rankdata(parts, axis=1) - (runs + 1) / 2
            own = rankdata(margin) - (runs + 1) / 2
            largest.append(float(np.abs(ranks @ own / (own @ own)).max()))
        share = float(np.mean(np.array(largest) <= size_of_chance(runs, inputs)))
        print(f"{inputs} numbers, {runs} runs: at most {size_of_chance(runs, inputs):.3f} in {share:.1%}")
        assert 0.92 <= share < 1.0  # Bonferroni's inequality is close to an equality; 400 campaigns give +-1.1 %


def test_numbers_without_influence_are_not_named(tmp_path: Path) -> None:
    """Of thirty runs in which noise decides, and of runs that all have the same margin."""
    base = hs.load_scenario("composite-30hz").updated({"simulation.duration": 0.3, "metrics.rms_start": 0.2})
    vary = {"uncertainty.coriolis": {"uniform": [-0.1, 0.1], "each": True}, "seed": "each"}
    file = {"scenario": base, "vary": vary, "require": ["rms_error <= 5.0"], "runs": 30}
    section = campaign_sections(hs.campaign(file, tmp_path / "noise"))[-1]
    assert section.title == "What the margin depends on"
    print(section.sentences)
    assert re.match(
        r"No number shows an influence: the largest rank .*; in 30 runs the largest of 36 ", section.sentences[0]
    )
    assert section.sentences[-1].startswith("Seeds are left out")
    equal = hs.campaign(file | {"require": ["outcome == completed"]}, tmp_path / "equal")
    assert campaign_sections(equal)[-1].sentences == ["All runs have the same margin, 1: no number shows an influence."]
    ties = {"scenario": base.updated({"robot.on_limit": "stop"}), "require": ["outcome == completed"], "runs": 60}
    some = hs.campaign(ties | {"vary": {"robot.stroke": {"uniform": [0.001, 0.1]}}}, tmp_path / "ties")
    ended = int((some.margin() < 0).sum())
    found = campaign_sections(some)[-1]
    print(found.sentences)
    assert 0 < ended < 30
    assert (found.title, found.sentences[-1]) == (
        "Where the failures lie",
        f"{60 - ended} of 60 runs have the same margin, 1: no rank orders them.",
    )
    assert found.sentences[0].startswith("Largest rank correlation of the margin, ")


def test_a_page_of_many_runs_has_a_sample_of_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Failures in the plane are those of all runs."""
    result = hs.campaign(FILE | {"chunk_size": 50}, tmp_path / "out")
    whole = curves_of(result)
    monkeypatch.setattr("hexservo.campaigns.pictures._SAMPLE", 100)
    monkeypatch.setattr(hs.CampaignResult, "to_arrow", one_column)
    sampled = curves_of(result)
    stated = f"Of a random sample of 100 of the {RUNS} runs."
    assert sampled["Final error"].note.endswith(stated)
    assert stated in campaign_sections(result)[-1].sentences
    assert whole["Final error"].note == sampled["Final error"].note.removesuffix(stated).strip() == ""
    medians = [float(np.median(each["Final error"].lines[0].x)) for each in (whole, sampled)]
    assert medians[0] != medians[1] == pytest.approx(medians[0], rel=0.5)
    for before, after in zip(*(each["Failure probability"].lines for each in (whole, sampled)), strict=True):
        np.testing.assert_array_equal(before.y, after.y)
    points = [len(line.x) for line in sampled["Runs in the plane of both"].lines]
    assert points == [min(RUNS - result.failures, 600), result.failures]


def test_a_run_that_ends_early_is_not_within_the_bound(tmp_path: Path) -> None:
    """Every second run leaves its stroke at once; what it has reached until then is below the bound."""
    short = hs.load_scenario("composite-30hz").updated({"simulation.duration": 0.2, "robot.on_limit": "stop"})
    file = {
        "scenario": short,
        "vary": {"robot.stroke": {"choice": [1e-5, 0.5]}},
        "require": ["peak_leg_force <= 1e9", {"holds": "overshoot <= 0", "scale": 5.0}, "peak_leg_force >= 1e-9"],
        "runs": 40,
    }
    result = hs.campaign(file, tmp_path / "out")
    ended = int((result.to_dataframe().outcome != "completed").sum())
    assert 0 < ended < 40
    (section,) = (one for one in campaign_sections(result) if one.name == "distributions")
    force, overshoot, _ = (item for item in section.items if isinstance(item, Curves))
    assert force.lines[0].y.max() == pytest.approx(1 - ended / 40)
    assert force.note == f"{ended} of 40 runs ended early or have no value."
    assert not overshoot.x_log  # its bound is 0
    hs.write_campaign_report(result, pictures=True)
    names = {path.name for path in (result.folder / "pictures").glob("distributions-*.svg")}
    assert names == {f"distributions-{name}.svg" for name in ("peak-leg-force", "overshoot", "peak-leg-force-2")}


def test_an_axis_within_one_decade_is_linear() -> None:
    """There a logarithmic axis may have a single label."""
    upper = Line("upper", np.array([1.0, 400.0]), np.array([0.7, 0.5]))
    for low, kind in ((0.2, None), (0.01, "log")):
        lines = [upper, Line("lower", np.array([1.0]), np.array([low]))]
        found = str(curves(Curves("Failure probability", "runs", "probability", lines, x_log=True, y_log=True)))
        (spec,) = re.findall(r"<script[^>]*>(\{.*?\})</script>", found)
        layout = json.loads(spec)["layout"]
        assert layout["yaxis"].get("type") == kind
        assert layout["yaxis"].get("tickformat") == ("~g" if kind else None)  # else 0.02 and 0.2 are both labelled "2"
        assert layout["xaxis"]["type"] == "log"


def test_an_error_matters_by_its_distance_from_the_median_too() -> None:
    """The margin falls to both sides of 5, and so correlates neither with the value nor with its size."""
    value = np.random.default_rng(3).uniform(0.0, 10.0, 400)
    margin = 1.0 - np.abs(value - np.median(value))
    table = pa.table({"index": np.arange(400), "mass": value, "outcome": ["completed"] * 400, "margin": margin})
    ((name, size),) = correlations(table)
    assert name == "mass"
    assert size == pytest.approx(1.0)


def test_a_bar_without_an_interval_has_none_in_the_page() -> None:
    share = Share("first order", np.zeros(2), np.array([[np.nan, np.nan], [0.0, 0.1]]))
    assert "chart" in str(bars(Bars("Indices", "share", ["a", "b"], [share])))


def test_the_interval_of_a_bar_is_drawn_from_its_end() -> None:
    """plotly.js has it as lengths above and below the value."""
    share = Share("first order", np.array([0.25]), np.array([[0.125, 0.75]]))
    page = str(bars(Bars("Indices", "share", ["a"], [share])))
    for name, length in (("array", 0.5), ("arrayminus", 0.125)):
        (coded,) = re.findall(rf'"{name}":\s*{{[^}}]*"bdata":\s*"([^"]+)"', page)
        assert np.frombuffer(base64.b64decode(coded), "<f4").tolist() == [length]


def test_a_campaign_without_runs_and_without_failures(tmp_path: Path) -> None:
    never = hs.campaign(FILE | {"require": ["outcome == completed"]}, tmp_path / "never", runs=30)
    assert [section.name for section in campaign_sections(never)] == ["campaign", "interval", "failures"]
    assert all(np.isfinite(line.y).any() for curves in curves_of(never).values() for line in curves.lines)
    shutil.rmtree(tmp_path / "never" / "chunks")
    (tmp_path / "never" / "summary.json").unlink()
    empty = hs.load_campaign(tmp_path / "never")
    assert len(empty) == 0
    page = hs.write_campaign_report(empty).read_text(encoding="utf-8")
    assert "0 of 0 runs fail" in page


def test_the_page_states_what_the_summary_states(result: hs.CampaignResult) -> None:
    path = hs.write_campaign_report(result)
    content = path.read_bytes()
    assert hs.write_campaign_report(result).read_bytes() == content
    page = content.decode()
    for text in (
        result.section().sentences[0],
        "final_error &lt;= 1.5",
        "normal: [0.0, 0.003], each: true",
        "Explanations",
    ):
        assert text in page, text
    assert page.count('class="chart"') == 4
    assert not re.search(r"<(?:script|link|img)[^>]+(?:src|href)=.https?:", page)


@pytest.mark.slow
def test_every_picture_is_a_file_too(result: hs.CampaignResult, more: tuple[Section, ...]) -> None:
    hs.write_campaign_report(result, more, pictures=True)
    folder = result.folder / "pictures"
    contents = {path.name: path.read_bytes() for path in folder.iterdir()}
    names = {
        "interval-failure-probability",
        "distributions-peak-leg-excursion",
        "distributions-final-error",
        "failures-runs-in-the-plane-of-both",
        "tuning_history-margin-of-the-best-candidate",
        "tuning_history-least-rms-error-of-feasible-candidates",
        "tuning_history-least-peak-leg-force-of-feasible-candidates",
        "tuning_front-largest-values-of-both-metrics",
        "sensitivity-sobol-indices-of-the-margin",
    }
    assert contents.keys() == {MARKER, *(f"{name}.{kind}" for name in names for kind in ("svg", "png"))}
    for name in contents.keys() - {MARKER}:
        content = contents[name]
        assert content.startswith(b"\x89PNG" if name.endswith("png") else b"<?xml"), name
    hs.write_campaign_report(result, more, pictures=True)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == contents


def test_anything_but_a_campaign_is_refused() -> None:
    with pytest.raises(TypeError, match=r"result: expected a CampaignResult .*, got NoneType"):
        hs.write_campaign_report(None)  # type: ignore[arg-type]


@pytest.mark.slow
def test_the_bars_are_the_indices(more: tuple[Section, ...]) -> None:
    section = more[-1]
    (bars,) = (item for item in section.items if isinstance(item, Bars))
    first, total = bars.shares
    places = [section.data["inputs"].index(name) for name in bars.names]
    np.testing.assert_array_equal(first.values, section.data["margin"]["first"][places])
    np.testing.assert_array_equal(total.values, section.data["margin"]["total"][places])
    assert (np.diff(total.values) <= 0).all(), "the largest on top"
    axes = item_figure(bars).axes[0]
    assert [text.get_text() for text in axes.get_yticklabels()] == list(bars.names)
    drawn = [patch.get_width() for container in axes.containers for patch in getattr(container, "patches", [])]
    np.testing.assert_allclose(drawn, [*first.values, *total.values])


@in_browser
@pytest.mark.parametrize(
    ("width", "scheme"), [pytest.param(1280, "light", marks=pytest.mark.slow), (390, "dark")], ids=["laptop", "phone"]
)
def test_the_page_in_a_browser(
    result: hs.CampaignResult, more: tuple[Section, ...], width: int, scheme: Literal["light", "dark"]
) -> None:
    """Printed too."""
    path = hs.write_campaign_report(result, more)
    problems: list[str] = []
    with chromium() as browser:
        page = browser.new_page(viewport={"width": width, "height": 800}, color_scheme=scheme)
        page.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.goto(path.as_uri())
        charts = page.locator(".chart")
        for place in range(charts.count()):
            charts.nth(place).scroll_into_view_if_needed()
            charts.nth(place).locator(".main-svg").first.wait_for(state="attached")
        assert charts.count() == 9
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        page.pdf()
    assert problems == []


def test_the_command_writes_the_page(tmp_path: Path) -> None:
    arguments = ["campaign", "campaign-composite-30hz", "--out", str(tmp_path / "out"), "--runs", "20", "--pictures"]
    shorter = ("simulation.duration=0.51", "metrics.rms_start=0.05", "metrics.dwell=0.01", "metrics.band=1e-9")
    code, out, err = invoke(*arguments, *(word for change in shorter for word in ("--set", change)))
    assert (code, err) == (0, "")
    assert f"report: {tmp_path}/out/report.html" in out
    assert "20 of 20 runs fail" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert (tmp_path / "out" / "pictures" / "interval-failure-probability.svg").is_file()


def test_the_command_names_the_page_that_draws_the_indices(tmp_path: Path) -> None:
    file = tmp_path / "mass.yaml"
    lines = "scenario: paper\nvary: {uncertainty.gravity: {uniform: [-0.1, 0.1]}}\nrequire: [peak_leg_excursion <= 1]\n"
    file.write_text(f"{lines}runs: 2\n", encoding="utf-8")
    arguments = ["campaign", str(file), "--out", str(tmp_path / "out"), "--set", "simulation.duration=0.02"]
    code, out, err = invoke(*arguments, "--sensitivity")
    assert (code, err) == (0, "")
    assert f"The same command with --report draws the indices in {tmp_path}/out/report.html." in out
