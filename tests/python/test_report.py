"""The report of a run: what is in it, that it cannot be broken by what it shows, and how browsers show it."""

from __future__ import annotations

import base64
import html
import json
import math
import re
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pytest
from matplotlib.image import imread
from numpy.typing import NDArray

import hexservo as hs
from browsers import chromium, in_browser
from hexservo import _core
from hexservo.draw.plots import paper_images
from hexservo.findings import sections
from hexservo.findings.evidence import Column, Curves, HeatMap, Line, Section, Table
from hexservo.findings.sections import Group, Source
from hexservo.findings.wording import cell_text
from hexservo.report import check_report
from hexservo.report.charts import curves, needed
from hexservo.report.documentation import is_page, page_html
from hexservo.report.evidence_html import page_text, section_html
from hexservo.report.figures import figures
from hexservo.report.html import TITLE, Html, element, json_script, paragraphs, sentence
from hexservo.report.page import _space, page
from hexservo.report.scene import scene
from hexservo.report.still import still
from hexservo.run.publish import OutputError
from hexservo.run.samples import parts
from hexservo.run.summary import summary_sentences
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.pixels import to_pixels
from hexservo.scenario.wording import apart, joules, number, percent_above, percent_below, percent_used, quantity
from test_leg_limits import METRICS as OF_LIMITS

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

ROOT = Path(__file__).resolve().parents[2]
EVIL = "</script><script>window.broken = 1</script><img src=x onerror='window.broken = 2'>"
SHOWN = "paper & <b>its</b> " + EVIL


def made_up_sections() -> list[Section]:
    """One of everything, with what could break the page in every text."""
    x = np.linspace(0, 5, 5001)
    grid_x, grid_y = np.linspace(1, 40, 60), np.linspace(0, 50, 50)
    z = np.exp((grid_x + grid_y[:, None]) / 40 - 1)
    z[:5, :5] = np.nan
    table = Table(
        f"Values {EVIL}",
        (Column("direction"), Column("value", "px/mm"), Column("count"), Column("holds")),
        [("along <x>", 1.23456, 123456, True), ("none", None, 7, None), ("far", -math.inf, 1, False)],
        note="A note & more.",
        page="docs/model.md",
    )
    lines = [
        Line("V", x, np.exp(-x) + 1e-6),
        Line(EVIL, x, np.exp(-2 * x) + 1e-7, "dashed"),
        Line("instants", x[::500], np.exp(-x[::500]), "points"),
    ]
    curves = Curves("V and its terms", "time [s]", "V [J]", lines, y_log=True, page="docs/model.md")
    point = Line("here", np.array([33.0]), np.array([33.0]), "points")
    heat = HeatMap("Radius", "period [ms]", "latency [ms]", "radius [1]", grid_x, grid_y, z, (1.0, 2.0), [point])
    return [
        Section("first", f"First {EVIL}", [f"The largest rise is 1.2e-9 J. {EVIL}", "More."], [curves, table], "good"),
        Section("map", "A map", ["The largest stable period is 41 ms."], [heat], "warning"),
        Section("open", "Not for this law", ["Does not apply."]),
    ]


@pytest.fixture(scope="module")
def result() -> hs.Result:
    return hs.simulate(hs.load_scenario("paper").updated({"description": SHOWN}))


@pytest.fixture(scope="module")
def text(result: hs.Result) -> str:
    """The page of a run with made-up findings: analyses are tested elsewhere."""
    with pytest.MonkeyPatch.context() as patch:
        groups = [
            Group(Source("certify", "Certificate", False, "What it is.", hs.certify), made_up_sections()),
            Group(
                Source("diagnose", "Diagnosis", False, "What it is.", hs.diagnose),
                (),
                f"expected another law, got {EVIL}",
            ),
        ]
        patch.setattr("hexservo.report.page.groups", lambda _: groups)
        return page(result)


@pytest.fixture(scope="module")
def file(text: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(autouse=True)
def no_slow_findings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the findings that are worked out, but for the test that asks for them."""
    monkeypatch.setattr("hexservo.report.page.groups", lambda _: [])


def words_of(text: str) -> str:
    """What a reader reads: no script, no style, no tags."""
    text = re.sub(r"<(script|style)\b.*?</\1>", " ", text, flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", text)).split())


def specs(text: str) -> dict[str, dict[str, Any]]:
    """The charts of a page by their titles."""
    found = re.findall(
        r'<figcaption>([^<]*)</figcaption><div class="chart"[^>]*></div><script type="application/json">(.*?)</script>',
        text,
        re.DOTALL,
    )
    return {html.unescape(title): json.loads(spec) for title, spec in found}


def numbers(encoded: dict[str, str]) -> NDArray[np.float64]:
    assert encoded["dtype"] == "f4"
    return np.frombuffer(base64.b64decode(encoded["bdata"]), "<f4").astype(float)


# ---- What is in it --------------------------------------------------------------------------------------------------


def test_the_order_and_the_words(text: str) -> None:
    assert text.startswith(TITLE + "\n")
    heads = re.findall(r"<h2>([^<]*)</h2>", text)
    assert heads == [
        "Summary", "Figures", "The machine in space", "Certificate", "Diagnosis", "Metrics", "Scenario", "Versions",
        "Explanations",
    ]  # fmt: skip
    words = words_of(text)
    for part in (
        "The run completed: 5 s in continuous mode, controlled by the law hybrid.",
        "All features are within 2 px of their goals after 0.353 s.",
        "The largest feature error at the end is 0.07972 px; from 1 s on their RMS is 0.05187 px.",
        "At the end the platform is 18.2 mm and 36.3 mrad from the pose with the goal image; in the image the two "
        "nearly cancel.",
        "warning A map : The largest stable period is 41 ms.",
        "not applicable Not for this law : Does not apply.",
        "Not available for this run: expected another law",
        "value [px/mm]",
        "along <x> 1.235 123456 yes none – 7 – far −∞ 1 no",
        "Explained in docs/model.md",
        "plotly.js 4" if "plotly.js v4" in text else "plotly.js",
    ):
        assert part in words, part


def test_results_that_nothing_judges_have_no_badge() -> None:
    table = Table("Values", [Column("index")], [(0.5,)])
    heads = [re.findall("<h3>.*</h3>", section_html(Section("a", "Theme", [], items), "a")) for items in ([], [table])]
    assert heads == [['<h3>Theme <span class="badge open">not applicable</span></h3>'], ["<h3>Theme </h3>"]]


def test_metrics_versions_and_the_scenario_are_there(text: str, result: hs.Result) -> None:
    (scenario,) = re.findall(r"<pre tabindex[^>]*><code>(.*?)</code></pre>", text, re.DOTALL)
    assert hs.Scenario.from_yaml(html.unescape(scenario)) == result.scenario
    words = words_of(text)
    for name in hs.METRICS:
        of_a_limit = name in OF_LIMITS  # that the robot has not
        assert (name.replace("_", " ") in words) != of_a_limit
    assert f"simulated by hexservo {hs.__version__}" in words
    assert "seed 0" in words


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            {"controller.jacobian": "printed"},
            [
                "5 s ended early (diverged): a feature error exceeded 10000 px at t = 0.041 s.",
                "did not settle",
                "that is 564 times as much",
            ],
        ),
        ({"simulation.duration": 0.01}, ["completed", "px from the goal at the end, above 2 px"]),
        ({"target.desired_features": [30.5, 18, 65, -65, -44, 37, -10, -15]}, ["stayed within 2 px from the start"]),
        ({"robot.force_limit": 0.2}, ["0.3582 N of the 0.2 N allowed; that is 80% too much"]),
    ],
)
def test_the_summary_of_other_runs(changes: dict[str, Any], expected: list[str]) -> None:
    words = " ".join(summary_sentences(hs.simulate(hs.load_scenario("paper").updated(changes))))
    for part in expected:
        assert part in words


BEFORE_HOME = {"principal_point": [640.0, 480.0], "image_size": [1280.0, 960.0]}  # the scenario's pixels count from it


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"camera.dropout": 1.0}, "every frame was lost (camera.dropout: 1)"),
        ({"camera.latency": 0.1}, "no frame arrived in 100 ms (camera.latency: 100 ms)"),
        ({f"camera.{key}": value for key, value in BEFORE_HOME.items()}, "points 2, 3, 4 are outside of the camera's"),
        ({}, None),
    ],
)
def test_a_law_that_never_acts_is_noted(changes: dict[str, Any], reason: str | None) -> None:
    """The platform moves as it does without any frame, and otherwise not."""
    scenario = hs.load_scenario("slow-camera").updated({"simulation.duration": 0.1})
    run, blind = (hs.simulate(scenario.updated(each)) for each in (changes, {"camera.dropout": 1.0}))
    assert np.array_equal(run.position, blind.position) == (reason is not None)
    words = summary_sentences(run)[1]
    assert (f"The law did not act: {reason}" in words) if reason else "did not settle" in words


def test_a_custom_controller_is_named() -> None:
    scenario = hs.load_scenario("paper").updated({"simulation.mode": "sampled", "simulation.duration": 0.01})
    run = hs.simulate(scenario, controller=lambda observation: np.array([0, 0, -0.588, 0, 0, 0]))
    assert "controlled by the function" in summary_sentences(run)[0]


def test_charts_show_the_samples_of_the_run(text: str, result: hs.Result) -> None:
    charts = specs(text)
    first, rest = parts(result)
    for title, part in (("Until the run has settled", first), ("The rest, magnified", rest)):
        low, high = charts[title]["layout"]["yaxis"]["range"]
        for column, trace in enumerate(charts[title]["data"]):
            x, y = numbers(trace["x"]), numbers(trace["y"])
            expected = result.feature_error[part, column]
            at = np.searchsorted(result.time[part] + 1e-6, x)  # the time axis is in single precision
            np.testing.assert_allclose(y, expected[at], rtol=1e-6, atol=1e-9)
            no_peak_is_lost = pytest.approx((expected.max(), expected.min()), abs=1e-3 * (high - low))
            assert (y.max(), y.min()) == no_peak_is_lost
            if part is first:  # all samples are near the line, and few are needed for it
                np.testing.assert_allclose(np.interp(result.time[part], x, y), expected, atol=4e-4 * (high - low))
                assert len(x) < 400
    legs = [trace for trace in charts["Leg forces (positive: pushing)"]["data"] if trace.get("line", {})["width"] < 1]
    assert max(numbers(trace["y"]).max() for trace in legs) == pytest.approx(result.leg_forces.max(), abs=1e-3)
    weight = charts["Vertical force, in B (z points down)"]["layout"]["shapes"][0]["y0"]
    assert weight == pytest.approx(-9.8 * 0.06)
    table = charts["Output term of each rule"]["data"][0]
    assert table["text"][0] == ["NB", "NB", "NB", "NB", "NM", "NS", "ZE"]
    for trace, name, sample in zip(
        charts["Paths of the features"]["data"][4:6], ("start", "end of the run"), (0, -1), strict=True
    ):
        assert trace["name"] == name
        np.testing.assert_allclose(numbers(trace["x"]), result.features[sample, ::2], rtol=1e-6)


def test_the_chart_of_forces_says_what_holds_the_weight() -> None:
    """The law's feed-forward, along the axes of gravity, or of machines that take positions what their motion takes."""
    expected = {
        "paper": ("Wrench and leg forces", "Dotted: -0.18 N along x, the weight that the law feeds forward."),
        "reachy-mini": ("Wrench and leg forces that the motion takes", "the estimated weight, which the law does not"),
    }
    for name, (title, words) in expected.items():
        scenario = hs.load_scenario(name).updated({"simulation.duration": 0.1, "robot.gravity": [3.0, 0.0, 9.3]})
        drawn = dict(figures(hs.simulate(scenario)))
        assert words in str(drawn[title][0])
        assert "Force along x and y, in B" in str(drawn[title][0])
        assert "z points" not in "".join(map(str, drawn["Motion of the platform"]))


def test_the_attitude_of_the_base_is_drawn_in_milliradians() -> None:
    rotation = {"kind": "sinusoid", "amplitude": [0.01, 0.0, 0.0], "frequency": 5.0, "phase": math.pi / 2.0}
    changes = {"simulation.mode": "sampled", "simulation.duration": 0.1}
    run = hs.simulate(hs.load_scenario("paper").updated({**changes, "base_motion.rotation": rotation}))
    charts = specs("".join(str(each) for _, drawn in figures(run) for each in drawn))
    about_x = charts["Attitude of the base in the world: axis times angle"]["data"][0]
    assert numbers(about_x["y"])[0] == pytest.approx(10.0, rel=1e-6)


@pytest.mark.parametrize("what", ["law", "switched off", "custom"])
def test_figures_show_of_a_law_what_acted(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexservo.draw.plots.image_bytes", lambda *_: b"")  # which figures there are, not how they look
    changes = {"simulation.mode": "sampled", "simulation.duration": 0.005}
    scenario = hs.load_scenario("paper" if what != "switched off" else "paper-no-fuzzy").updated(changes)
    run = hs.simulate(scenario, controller=(lambda _: np.zeros(6)) if what == "custom" else None)
    drawn = dict(figures(run))
    images = paper_images(run)
    assert ("Rule table of the fuzzy systems" in drawn) == (what == "law")
    assert ("fig2a_rule_table.svg" in images) == (what == "law")
    assert ("weight that the law feeds forward" in str(drawn["Wrench and leg forces"])) == (what != "custom")
    assert ("Dotted: -0.588 N, the estimated weight." in str(drawn["Wrench and leg forces"])) == (what == "custom")


@pytest.mark.parametrize("seed", range(5))
def test_samples_that_are_left_out_lie_near_the_line(seed: int) -> None:
    generator = np.random.default_rng(seed)
    x = np.cumsum(generator.uniform(0.1, 1.0, 500))
    y = np.cumsum(generator.normal(size=500)) if seed else np.sin(x / 20)
    for tolerance in (1e-3, 0.1, 10.0):
        kept = needed(x, y, tolerance)
        assert (kept[0], kept[-1]) == (0, 499)
        assert (np.diff(kept) > 0).all()
        assert np.abs(np.interp(x, x[kept], y[kept]) - y).max() <= tolerance * (1 + 1e-9)
    assert len(needed(x, 2 * x, 1e-6)) == 2
    assert len(needed(x, np.sin(x / 20), 0.01)) < 60
    y[7] = np.nan
    np.testing.assert_array_equal(needed(x, y, 1.0), np.arange(500))
    np.testing.assert_array_equal(needed(np.zeros(3), np.zeros(3), 1.0), np.arange(3))


def test_lines_of_findings_are_thinned_as_their_axis_shows_them() -> None:
    def drawn(x: NDArray[np.float64], y: NDArray[np.float64], *, log: bool = False) -> Any:
        return specs(curves(Curves("c", "x", "y", [Line("l", x, y)], y_log=log)))["c"]["data"][0]

    x = np.linspace(0, 5, 5001)
    falling = 10.0 ** (-2 * x)
    assert len(numbers(drawn(x, falling, log=True)["x"])) == 2  # a straight line
    assert 5 < len(numbers(drawn(x, falling)["x"])) < 100
    turn = np.linspace(0, 2 * np.pi, 5001)
    circle = drawn(np.cos(turn), np.sin(turn))
    np.testing.assert_allclose(np.hypot(numbers(circle["x"]), numbers(circle["y"])), 1, rtol=1e-6)
    assert 500 < len(numbers(circle["x"])) < 2600
    for place in (0, 1, 2501, 5000):  # a gap stays one
        for log in (True, False):
            gap = numbers(drawn(x, np.where(np.arange(5001) == place, np.nan, falling), log=log)["y"])
            assert np.isnan(gap).sum() == 1
            assert len(gap) < 100
    assert len(numbers(drawn(x[:0], x[:0])["x"])) == 0
    assert np.isnan(numbers(drawn(x, np.full(5001, np.nan))["y"])).all()
    mixed = numbers(drawn(x, np.where(x > 2, 0.0, falling), log=True)["y"])
    np.testing.assert_allclose(mixed, [1, 1e-4, 0], atol=1e-7)


def test_charts_match_the_schema_of_the_library(text: str) -> None:
    """Every name and value is known to plotly's own description of charts."""
    import plotly.graph_objects as go

    def coloured(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: coloured(item) for name, item in value.items()}
        if isinstance(value, list):
            return [coloured(item) for item in value]
        return "#123456" if isinstance(value, str) and value.startswith("@") else value

    charts = specs(text)
    assert len(charts) == 13
    for spec in charts.values():
        layout = {name: value for name, value in spec["layout"].items() if name not in ("maxWidth", "aspect")}
        go.Figure(coloured(spec["data"]), coloured(layout))


def test_only_the_paper_s_scenario_has_the_numbers_of_its_figures(text: str) -> None:
    def numbered(name: str, changes: dict[str, Any]) -> int:
        run = hs.simulate(hs.load_scenario(name).updated({"simulation.duration": 0.02, **changes}))
        return len(re.findall(r"<h3>[^<]* \(figure \d[ab]?\)</h3>", page(run)))

    assert len(re.findall(r"<h3>[^<]* \(figure \d[ab]?\)</h3>", text)) == 5  # another description, every sample
    assert numbered("paper", {"simulation.duration": 5.0, "simulation.log_every": 50}) == 5
    assert numbered("paper", {"uncertainty.gravity": 0.01}) == 0
    assert numbered("paper-gravity", {}) == 0
    assert numbered("composite-30hz", {}) == 0


def test_the_chart_of_the_image_has_its_shape_and_its_border() -> None:
    run = hs.simulate(hs.load_scenario("real-machine").updated({"simulation.duration": 0.1}))
    charts = specs(page(run))
    layout = charts["Paths of the features"]["layout"]
    (border,) = layout["shapes"]
    assert border["path"] == "M320 240L-320 240L-320 -240L320 -240Z"
    assert layout["aspect"] == pytest.approx(480 / 640)
    for axis, half in (("xaxis", 320), ("yaxis", 240)):
        low, high = layout[axis]["range"]
        assert low < -half < half < high
    assert layout["xaxis"]["range"][1] / layout["yaxis"]["range"][1] == pytest.approx(640 / 480)
    magnified = charts["The same paths, magnified"]["layout"]
    assert np.ptp(magnified["xaxis"]["range"]) < 0.4 * np.ptp(layout["xaxis"]["range"])
    assert "Camera image (640 x 480 px, y up)" in words_of(page(run))
    plain = specs(page(hs.simulate(hs.load_scenario("paper").updated({"simulation.duration": 0.1}))))
    assert "shapes" not in plain["Paths of the features"]["layout"]
    assert "The same paths, magnified" not in plain


@pytest.mark.parametrize("lens", [{}, {"camera.distortion.brown_conrady": [0.1, 0.0, 0.001, -0.002, 0.0]}])
def test_the_border_of_an_image_is_where_its_lens_puts_it(lens: dict[str, Any]) -> None:
    """Principal point, two focal lengths, axes, distortion: in the view in space and in the chart of the paths."""
    run = hs.simulate(hs.load_scenario("reachy-mini").updated({"simulation.duration": 0.1, **lens}))
    view, text = scene(run), page(run)
    features = view.border[:, :2] * view.pixels_per_metre
    pixels = to_pixels(run.scenario, features)
    from_edge = np.abs(np.abs(pixels - [159.5, 89.5]) - [160, 90]).min(axis=1)
    np.testing.assert_allclose(from_edge, 0, atol=1e-9)
    np.testing.assert_allclose(
        to_pixels(run.scenario, view.corners[:, :2] * view.pixels_per_metre),
        [[319.5, 179.5], [-0.5, 179.5], [-0.5, -0.5], [319.5, -0.5]],
        atol=1e-9,
    )
    assert "Camera image (320 x 180 px, y up)" in words_of(text)
    layout = specs(text)["Paths of the features"]["layout"]
    line = [[float(number) for number in place.split()] for place in layout["shapes"][0]["path"][1:-1].split("L")]
    np.testing.assert_allclose(line, features, atol=1e-3)
    assert layout["aspect"] == pytest.approx(np.divide(*np.ptp(features, axis=0)[::-1]))


def test_a_view_of_features_alone_states_no_size_of_an_image() -> None:
    run = hs.simulate(hs.load_scenario("paper").updated({"simulation.duration": 0.02}))
    half = 1.2 * max(np.abs(run.features).max(), np.abs(np.asarray(run.scenario.target.desired_features)).max())
    assert f"Camera image (features, ±{half:.4g} px shown, y up)" in words_of(page(run))


# ---- Pages of the documentation -------------------------------------------------------------------------------------


def test_every_explanation_is_a_link_within_the_report(text: str) -> None:
    """Every "Explained in" is a link, and every link of the page leads to an element of it."""
    explained = re.findall(r"Explained in (<a href=\"#[^\"]+\"><code>[^<]+</code></a>|<code>)", text)
    assert len(explained) == 3
    assert "<code>" not in explained
    parser = Attributes()
    parser.feed(re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL))
    ids = [value for name, value in parser.found if name == "id"]
    assert len(ids) == len(set(ids))
    targets = {(value or "").removeprefix("#") for name, value in parser.found if name == "href"}
    assert targets <= set(ids)
    assert "page-model" in targets
    assert text.count('<details class="document">') == 1


def test_a_page_is_rendered_whole_and_its_links_stay_inside() -> None:
    names = ["docs/analysis/drift.md", "docs/model.md"]
    made = page_html(names[0], names)
    source = (ROOT / names[0]).read_text(encoding="utf-8")
    headings = re.findall(r"^## (.+)$", source, re.MULTILINE)
    assert headings
    assert [html.unescape(found) for found in re.findall(r"<h4[^>]*>(.*?)</h4>", made)] == headings
    assert re.findall(r'href="(?!#page-)', made) == []
    for name in sorted((ROOT / "docs").rglob("*.md")):
        known = name.relative_to(ROOT).as_posix()
        whole = page_html(known, [known])
        assert "<table>" not in whole.replace('<div class="scroll"><table>', "")
        assert "<img" not in whole
        assert not re.search(r'href="(?!#page-)', whole), known
        ids = set(re.findall(r' id="([^"]+)"', whole))
        assert {target for target in re.findall(r'href="#([^"]+)"', whole) if "--" in target} <= ids, known
    with pytest.raises(ValueError, match=r"expected a page of docs/, got 'docs/\.\./README\.md'"):
        page_html("docs/../README.md", [])


def test_pages_of_findings_are_in_the_source_tree_or_the_package() -> None:
    """Those that sources name, wherever hexservo was imported from."""
    named = set()
    for file in sorted((ROOT / "python" / "hexservo").rglob("*.py")):
        named |= set(re.findall(r'"(docs/[\w/-]+\.md)"', file.read_text(encoding="utf-8")))
    assert len(named) > 10
    assert [name for name in sorted(named) if not is_page(name)] == []


def test_a_law_without_fuzzy_systems_has_no_rule_table() -> None:
    run = hs.simulate(hs.load_scenario("paper").updated({"controller.law": "kelly", "simulation.duration": 0.02}))
    assert "Output term of each rule" not in specs(page(run))


def test_a_long_recording_is_cut(monkeypatch: pytest.MonkeyPatch, result: hs.Result) -> None:
    monkeypatch.setattr("hexservo.report.page._MAX_SCENARIO", 100)
    words = words_of(page(result))
    assert f"{len(result.scenario.to_yaml()) - 100} more characters are left out here." in words


@pytest.mark.parametrize(
    ("cell", "column", "expected"),
    [
        (-0.0, Column("c"), "0"),
        (-0.0001, Column("c", "", ".2f"), "0.00"),
        (-0.01, Column("c", "", ".2f"), "−0.01"),
        (1e-7, Column("c"), "1e−07"),
        (1234567, Column("c"), "1234567"),
        (28764.0, Column("c", "", ".3g"), "28800"),
        (-1.4e6, Column("c", "", ".3g"), "−1.4e+06"),
        (12, Column("c", "", ".1f"), "12.0"),
        (float("nan"), Column("c"), "–"),
        (None, Column("c"), "–"),
        (False, Column("c"), "no"),
        ("-5", Column("c"), "-5"),
    ],
)
def test_cells_as_people_read_them(cell: Any, column: Column, expected: str) -> None:
    assert page_text(cell, column) == expected
    if not isinstance(cell, str):  # terminals lack the signs of pages
        ascii_signs = str.maketrans({"−": "-", "–": "-"})
        assert cell_text(cell, column) == expected.translate(ascii_signs)


def test_numbers_below_a_million_have_no_exponent() -> None:
    assert [number(value, 2) for value in (190.4, 99.6, 0.0123, -0.0, 23456.0, 2e6)] == [
        *("190", "100", "0.012", "0", "23000", "2e+06"),
    ]
    assert number(999.6) == "1000"
    assert [joules(value) for value in (1.9e-4, 0.123456, 61.08, -17.18)] == [
        "190 uJ",
        "123.5 mJ",
        "61.08 J",
        "-17.18 J",
    ]
    assert joules(78.8, 3, "W") == "78.8 W"


def test_a_value_is_not_written_as_the_limit_from_which_it_differs() -> None:
    assert [apart(value, 4.0) for value in (4.0, 3.9999, 4.000012, 4.0 + 1e-12, 4.0 - 1e-12)] == [
        ("4", "4"),
        ("3.9999", "4"),
        ("4.00001", "4"),
        ("just above 4", "4"),
        ("just below 4", "4"),
    ]
    assert [percent_above(share) for share in (0.0, 1e-9, 0.5 + 1e-12, 0.501)] == ["0%", "less than 1%", "50%", "51%"]
    assert [percent_below(share) for share in (0.0, 1e-9, 1 - 0.8, 0.209)] == ["0%", "less than 1%", "20%", "20%"]
    used = [percent_used(share) for share in (0.0, 0.704, 0.9949, 0.9951, 1.0, 1.004, 1.3)]
    assert used == ["0%", "70%", "99%", "more than 99%", "100%", "more than 100%", "130%"]


def test_a_number_reads_alike_whatever_its_sign_and_a_unit_has_a_whole_one() -> None:
    assert [number(value) for value in (28_800.0, -28_800.0)] == ["28800", "-28800"]
    assert [quantity(value, "m") for value in (1.0, 1e-3, -1e-3)] == ["1 m", "1 mm", "-1 mm"]


def test_the_summary_begins_with_the_worst_finding(monkeypatch: pytest.MonkeyPatch, result: hs.Result) -> None:
    verdicts: tuple[Literal["open", "good", "bad", "warning"], ...] = ("open", "good", "bad", "warning", "bad")
    sections = [Section(f"s{place}", f"Title {place}", ["Words."], verdict=v) for place, v in enumerate(verdicts)]
    found = [
        Group(Source("certify", "Certificate", False, "", hs.certify), sections),
        Group(
            Source("diagnose", "Diagnosis", False, "", hs.diagnose),
            [Section("cause", "Cause", ["Words."], verdict="bad")],
        ),
    ]
    monkeypatch.setattr("hexservo.report.page.groups", lambda _: found)
    (listed,) = re.findall(r'<ul class="verdicts">(.*?)</ul>', page(result), re.DOTALL)
    assert re.findall(r"Title \d|Cause", listed) == ["Cause", "Title 2", "Title 4", "Title 3", "Title 1", "Title 0"]


def test_the_summary_has_the_warnings_of_check(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before the verdicts; of a run with a custom controller without those about gains that did not act."""
    monkeypatch.setattr("hexservo.report.page.groups", lambda _: [])
    short = {"simulation.duration": 0.1, "metrics.dwell": 0.01, "metrics.rms_start": 0.0}
    coarse = hs.load_scenario("fails-coarse-step").updated({**short, "robot.force_limit": 0.1})
    still = hs.simulate(coarse, controller=lambda _: np.zeros(6))
    by_law = ["robot.force_limit", "simulation.step", "controller.law"]
    for run, keys in ((hs.simulate(coarse), by_law), (still, ["robot.force_limit"])):
        (listed,) = re.findall(r'<ul class="verdicts">(.*?)</ul>', page(run), re.DOTALL)
        assert re.findall(r'<a href="#scenario">Scenario</a>: ([a-z_.]+): ', listed) == keys


def test_what_a_sentence_has_between_backticks_is_code() -> None:
    assert sentence("a < b: `hexservo run <file>` & go") == "a &lt; b: <code>hexservo run &lt;file&gt;</code> &amp; go"
    assert sentence("one ` alone") == "one ` alone"
    assert paragraphs("`a.b` is left") == "<p><code>a.b</code> is left</p>"


def test_a_limit_that_is_far_exceeded_is_a_multiple(result: hs.Result) -> None:
    for force, words in (
        (0.5, "50% of it is left"),
        (0.8049, "19% of it is left"),
        (1.0, "0% of it is left"),
        (1.5, "that is 50% too much"),
        (1747.0, "that is 1750 times as much"),
        (1 - 1e-6, "is 0.999999 N of the 1 N allowed; less than 1% of it is left"),
        (1 + 1e-6, "is 1.000001 N of the 1 N allowed; that is less than 1% too much"),
    ):
        measured = {**result.streamed_metrics, "peak_leg_force": force * result.scenario.robot.force_limit}
        assert words in summary_sentences(replace(result, streamed_metrics=measured))[-1]


# ---- The machine in space -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["paper", "task-general"])
def test_the_scene_is_where_the_core_puts_it(name: str) -> None:
    """Legs have the run's lengths, and targets and drawn image are exactly where the core's camera has the features."""
    result = hs.simulate(hs.load_scenario(name))
    view = scene(result)
    settings = core_parameters(result.scenario)
    chosen = np.searchsorted(result.time, view.time)
    assert 100 < len(chosen) <= 210
    assert (chosen[0], chosen[-1]) == (0, len(result.time) - 1)
    lengths = np.linalg.norm(view.joints - view.base, axis=-1)
    np.testing.assert_allclose(lengths, result.leg_lengths[chosen], rtol=1e-12)
    assert view.targets is not None
    assert len(view.targets) == 1
    for frame, sample in enumerate(chosen):
        pose = result.position[sample], result.quaternion[sample]
        rotation = view.rotation[frame]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        seen, depth = _core.take_image(settings.camera, *pose, view.targets[0])
        np.testing.assert_allclose(seen, result.features[sample], atol=1e-8)
        np.testing.assert_allclose(depth, result.depth[sample], atol=1e-12)
        drawn, _ = _core.take_image(settings.camera, *pose, view.placed(frame, view.image[frame]))
        np.testing.assert_allclose(drawn, result.features[sample], atol=1e-8)
        goals, _ = _core.take_image(settings.camera, *pose, view.placed(frame, view.goals))
        np.testing.assert_allclose(goals, result.scenario.target.desired_features, atol=1e-8)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("reachy-mini", {"target.motion": {"kind": "velocity", "velocity": [0.2, 0.0, 0.0]}}),
        ("hand-eye", {"target.motion": {"kind": "sinusoid", "amplitude": [0.01, 0.0, 0.0], "frequency": 2.0}}),
        (
            "paper-composite",
            {
                "target.frame": "world",
                "base_motion": {"kind": "sinusoid", "amplitude": [0.5, 0.0, 0.0], "frequency": 2.0},
            },
        ),
    ],
)
def test_a_moving_target_is_where_it_is_at_each_instant(name: str, changes: dict[str, Any]) -> None:
    """In the image of each sample by the core's camera, and in the box that the view shows."""
    result = hs.simulate(
        hs.load_scenario(name).updated({**changes, "simulation.mode": "sampled", "simulation.duration": 0.3})
    )
    view = scene(result)
    low, high = view.box()
    camera = core_parameters(result.scenario).camera
    assert view.targets is not None
    assert len(view.targets) == len(view.time)
    assert np.ptp(view.targets, axis=0).max() > 1e-3  # [m]
    for frame, sample in enumerate(np.searchsorted(result.time, view.time)):
        place = view.target(frame)
        assert place is not None
        assert ((low <= place) & (place <= high)).all()
        in_mount = view.targets[frame]
        seen, depth = _core.take_image(camera, result.position[sample], result.quaternion[sample], in_mount)
        np.testing.assert_allclose(seen, result.features[sample], atol=1e-8)
        np.testing.assert_allclose(depth, result.depth[sample], atol=1e-12)


def test_the_numbers_beside_the_view_are_from_home_in_their_units() -> None:
    start = {"simulation.start.pose": [0.001, 0.0, 0.0, 0.02, 0.0, 0.0], "simulation.duration": 0.1}
    result = hs.simulate(hs.load_scenario("paper").updated(start))
    plain = scene(result).to_plain()
    np.testing.assert_allclose(numbers(plain["displacement"])[:3], [1.0, 0.0, 0.0], rtol=0, atol=1e-6)  # [mm]
    np.testing.assert_allclose(numbers(plain["turn"])[:3], [20.0, 0.0, 0.0], rtol=0, atol=1e-5)  # [mrad]
    assert numbers(plain["error"])[0] == pytest.approx(np.abs(result.feature_error[0]).max(), rel=1e-6)  # [px]


def test_the_image_is_where_the_camera_is_mounted() -> None:
    for name, place in (
        ("paper", "at the centre of the platform"),
        ("hand-eye", "on the platform"),
        ("eye-to-hand", "on the base"),
    ):
        run = hs.simulate(hs.load_scenario(name).updated({"simulation.duration": 0.02}))
        assert f"In front of the camera, {place}, is its image:" in words_of(page(run))


@pytest.mark.parametrize(
    ("gravity", "expected"),
    [
        ([0.0, 0.0, 9.8], "points down; the view is upright."),
        ([0.0, 0.0, -9.8], "points up; the view is upright."),
        ([9.8, 0.0, 0.0], "is drawn downwards; it is not vertical."),
        ([9.8, 0.0, -1.0], "is drawn upwards; it is not vertical."),
        ([0.0, 0.0, 0.0], "is drawn downwards; it is not vertical."),
    ],
)
def test_the_view_is_upright_where_gravity_is_along_z(gravity: list[float], expected: str) -> None:
    run = hs.simulate(hs.load_scenario("paper").updated({"robot.gravity": gravity, "simulation.duration": 0.01}))
    assert f"The axis z of B {expected}" in words_of(_space(scene(run)))


@pytest.mark.parametrize(
    ("changes", "finer"),
    [
        ({}, True),
        ({"simulation.duration": 0.02}, False),  # it does not settle
        ({"simulation.log_every": 100}, False),  # every sample is an instant
    ],
)
def test_the_slider_takes_smaller_steps_where_there_is_a_transient_and_a_rest(
    changes: dict[str, Any], finer: bool
) -> None:
    view = scene(hs.simulate(hs.load_scenario("paper").updated(changes)))
    steps = np.diff(view.time)
    assert (steps[0] < 0.5 * steps[-1]) == finer
    assert ("The slider takes smaller steps until the run has settled." in words_of(_space(view))) == finer


def test_the_still_picture_has_no_line_where_a_feature_is_not_shown(result: hs.Result) -> None:
    view = scene(result)
    image = view.image.copy()
    image[10:20, 0] = np.nan
    gone = image[-1:, 1].copy()
    image[-1:, 1] = np.nan
    lines = re.findall(r'<polyline[^>]*class="path (\w+)"', still(replace(view, image=image)))
    assert np.isfinite(gone).all()
    assert [lines.count(colour) for colour in ("blue", "vermilion", "green")] == [2, 1, 1]
    dots = re.findall(r'<circle[^>]*r="3"[^>]*class="dot (\w+)"', still(replace(view, image=image)))
    assert "vermilion" not in dots


def test_a_plant_without_points_has_no_targets() -> None:
    run = hs.simulate(
        hs.load_scenario("paper").updated({"camera.convention": "as_printed", "simulation.duration": 0.05})
    )
    assert scene(run).targets is None
    assert "This plant has no targets in space." in words_of(page(run))


def test_features_far_outside_are_not_drawn() -> None:
    view = scene(hs.simulate(hs.load_scenario("paper").updated({"controller.jacobian": "printed"})))
    assert np.isnan(view.image).any()
    assert np.nanmax(np.abs(view.image[..., :2])) <= 0.2  # as far to the side as ahead
    assert "NaN" not in json.dumps(view.to_plain(), allow_nan=False)


# ---- Text cannot become markup --------------------------------------------------------------------------------------


def test_elements_escape_their_text_and_their_attributes() -> None:
    made = element("p", "<a>", Html("<b>x</b>"), "&", class_='"><i>', aria_label="x", hidden=True, inert=False)
    assert made == '<p class="&quot;&gt;&lt;i&gt;" aria-label="x" hidden>&lt;a&gt;<b>x</b>&amp;</p>'
    script = json_script({"</script>": "<!--\u2028&"})
    assert script.count("<") == 2
    assert json.loads(script[script.index(">") + 1 : script.rindex("<")]) == {"</script>": "<!--\u2028&"}


def test_no_text_of_a_scenario_or_finding_is_markup(text: str) -> None:
    assert "<script>window.broken" not in text
    assert "<img" not in text
    assert len(re.findall(r"<script\b", text)) == len(re.findall(r"</script\b", text))
    assert EVIL in words_of(text)


class Attributes(HTMLParser):
    """Collects the attributes of all elements."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, str | None]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += attrs


def test_nothing_refers_to_anything_outside(text: str) -> None:
    ours = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    parser = Attributes()
    parser.feed(ours)
    assert len(parser.found) > 200
    assert not {"src", "action", "data", "srcset", "poster", "xlink:href"} & {name for name, _ in parser.found}
    assert all((value or "").startswith("#") for name, value in parser.found if name == "href")
    assert "url(" not in ours
    assert "@import" not in ours
    assert "://" not in ours


# ---- The file -------------------------------------------------------------------------------------------------------


def test_the_file_is_whole_and_never_in_place_of_another(result: hs.Result, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    hs.write_report(result, path)
    first = path.read_bytes()
    assert first.startswith(TITLE.encode())
    with pytest.raises(OutputError, match="--force"):
        hs.write_report(result, path)
    hs.write_report(result, path, force=True)
    assert path.read_bytes() == first  # the same run gives the same bytes
    path.write_text("<!DOCTYPE html>\nmine")
    with pytest.raises(OutputError, match="was not written by `hexservo report`, so it is kept"):
        hs.write_report(result, path, force=True)
    assert path.read_text() == "<!DOCTYPE html>\nmine"
    with pytest.raises(OutputError, match="expected a folder that exists"):
        hs.write_report(result, tmp_path / "none" / "report.html")
    assert [item.name for item in tmp_path.iterdir()] == ["report.html"]
    with pytest.raises(TypeError, match="result: expected a Result"):
        hs.write_report("paper", path)  # type: ignore[arg-type]


@pytest.mark.slow
def test_the_report_of_the_paper_is_small_and_quick(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With all findings of certificate, analysis and diagnosis."""
    monkeypatch.setattr("hexservo.report.page.groups", sections.groups)
    scenario = hs.load_scenario("paper")
    started = time.process_time()
    result = hs.simulate(scenario, log_weights=True)
    for find in (hs.certify, hs.diagnose):
        find(result)
    hs.analyse(scenario)
    findings = time.process_time() - started
    started = time.process_time()
    hs.write_report(result, tmp_path / "0.html")
    assert time.process_time() - started <= 3.0 * findings  # most of it is for the findings
    assert (tmp_path / "0.html").stat().st_size <= 6_000_000


# ---- In a browser ---------------------------------------------------------------------------------------------------

PATIENCE = 120.0  # [s], with pages on a busy machine
GL = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]  # by the processor alone


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium(*GL) as running:
        yield running


class Visit:
    """A page, with everything that went wrong on it or was asked for over the network."""

    def __init__(self, browser: Browser, file: Path, **context: Any) -> None:
        self.context = browser.new_context(**context)
        self.context.set_default_timeout(PATIENCE * 1e3)
        self.page = self.context.new_page()
        self.problems: list[str] = []
        self.requests: list[str] = []
        self.page.on("console", lambda message: self.problems.append(message.text) if message.type == "error" else None)
        self.page.on("pageerror", lambda error: self.problems.append(str(error)))
        self.page.on("dialog", lambda dialog: self.problems.append(dialog.message))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.url = file.as_uri()

    def open(self) -> Page:
        self.page.goto(self.url)
        return self.page

    def to_view(self) -> Page:
        """Open the page and go to the view in space, drawn."""
        self.open()
        self.page.locator("#webgl").scroll_into_view_if_needed()
        self.page.wait_for_selector("#webgl[data-ready=yes]", state="attached")
        self.page.locator("#view").evaluate("view => view.scrollIntoView()")
        return self.page


@pytest.fixture
def visit(browser: Browser, file: Path) -> Iterator[Callable[..., Visit]]:
    made: list[Visit] = []

    def make(**context: Any) -> Visit:
        made.append(Visit(browser, file, **context))
        return made[-1]

    yield make
    for one in made:
        one.context.close()


def until(shown: Page, expression: str) -> None:
    """Wait for something to become true; playwright's own way needs `eval`, which the page's policy forbids."""
    give_up = time.monotonic() + PATIENCE
    while time.monotonic() < give_up:
        if shown.evaluate(expression):
            return
        shown.wait_for_timeout(50)
    raise AssertionError(f"never true: {expression}")


LAPTOP, PHONE = {"width": 1280, "height": 800}, {"width": 390, "height": 844}
DRAW_ALL = """async () => {
  for (const box of document.querySelectorAll(".chart")) {
    box.scrollIntoView();
    for (let wait = 0; wait < 2000 && !box.querySelector(".main-svg"); wait += 1) {
      await new Promise(requestAnimationFrame);
    }
  }
  return [...document.querySelectorAll(".chart")].map(box => box.querySelectorAll(".trace, .hm").length);
}"""


@pytest.mark.slow
@in_browser
def test_it_loads_without_an_error_or_a_request(visit: Callable[..., Visit]) -> None:
    seen = visit(viewport=LAPTOP)
    seen.to_view()
    drawn = seen.page.evaluate(DRAW_ALL)
    assert len(drawn) == 13
    assert all(drawn)
    assert seen.problems == []
    assert seen.requests == [seen.url]
    assert seen.page.evaluate("window.broken") is None
    assert seen.page.title() == "paper: hexservo report"
    assert seen.page.evaluate("document.documentElement.lang") == "en"
    assert seen.page.locator("img").count() == 0
    buttons = seen.page.evaluate(
        "[...new Set([...document.querySelectorAll('.modebar-btn')].map(b => b.dataset.title))]"
    )
    assert "Download plot as a PNG" in buttons
    assert not [button for button in buttons if re.search("share|send|cloud|edit", button, re.IGNORECASE)]
    seen.page.emulate_media(media="print")
    toolbars = "[...new Set([...document.querySelectorAll('.modebar')].map(bar => getComputedStyle(bar).display))]"
    assert seen.page.evaluate(toolbars) == ["none"]
    seen.page.emulate_media(media="screen")
    stopped = seen.page.evaluate(  # what a library might ask for
        """() => new Promise(resolve => {
          document.addEventListener("securitypolicyviolation", event => resolve(event.effectiveDirective));
          fetch("http://127.0.0.1:9/").catch(() => {});
        })"""
    )
    assert stopped == "connect-src"
    assert seen.requests == [seen.url]


def pixels(shown: Page) -> NDArray[np.float32]:
    return np.asarray(imread(BytesIO(shown.locator("#webgl").screenshot()), format="png"))


@pytest.mark.slow
@in_browser
def test_the_slider_moves_the_machine_and_the_button_plays(visit: Callable[..., Visit]) -> None:
    seen = visit(viewport=LAPTOP)
    shown = seen.to_view()
    end = pixels(shown)
    assert len(np.unique(end.reshape(-1, end.shape[-1]), axis=0)) > 50  # a picture, not an empty canvas
    np.testing.assert_array_equal(pixels(shown), end)  # it changes for no other reason
    assert "t = 5.000 s; largest feature error 0.07972 px;" in shown.locator("#readout").inner_text()
    shown.locator("#instant").focus()
    shown.keyboard.press("Home")
    until(shown, "document.getElementById('readout').textContent.startsWith('t = 0.000 s')")
    give_up = time.monotonic() + PATIENCE
    while (np.abs(pixels(shown) - end).max(axis=-1) > 0.1).sum() <= 20:
        assert time.monotonic() < give_up, "the picture does not change"
    assert "largest feature error 20 px" in shown.locator("#readout").inner_text()
    shown.keyboard.press("ArrowRight")
    until(shown, "document.getElementById('instant').getAttribute('aria-valuetext') !== 't = 0.000 s'")
    shown.locator("#play").click()
    until(shown, "Number(document.getElementById('instant').value) > 3")
    assert shown.locator("#play").inner_text() == "Stop"
    shown.locator("#play").click()
    assert shown.locator("#play").inner_text() == "Play"
    shown.wait_for_timeout(300)
    held = shown.locator("#instant").input_value()
    shown.wait_for_timeout(300)
    assert shown.locator("#instant").input_value() == held
    assert seen.problems == []


@pytest.mark.slow
@in_browser
@pytest.mark.parametrize("viewport", [PHONE, LAPTOP])
def test_nothing_of_the_view_in_space_is_cut_at_first(visit: Callable[..., Visit], viewport: dict[str, int]) -> None:
    """No line and no name of an axis reaches the edge of the picture."""
    shown = visit(viewport=viewport, color_scheme="light").to_view()
    picture = imread(BytesIO(shown.locator("#webgl").screenshot()))[..., :3]
    assert picture[5:-5, 5:-5].min() < 0.5  # it is drawn
    edges = [picture[:5], picture[-5:], picture[:, :5], picture[:, -5:]]
    assert min(float(edge.min()) for edge in edges) > 0.95


@pytest.mark.slow
@in_browser
@pytest.mark.parametrize("viewport", [PHONE, LAPTOP])
def test_the_page_does_not_scroll_sideways(visit: Callable[..., Visit], viewport: dict[str, int]) -> None:
    seen = visit(viewport=viewport, has_touch=viewport["width"] < 500)
    seen.open().evaluate(DRAW_ALL)
    width = viewport["width"]
    assert seen.page.evaluate("document.documentElement.scrollWidth") <= width
    outside = seen.page.evaluate(
        """width => [...document.querySelectorAll("body *")].filter(item => {
          const box = item.getBoundingClientRect();
          return box.width > 0 && box.right > width + 1 && !item.closest(".scroll, pre, .chart, #webgl");
        }).map(item => item.outerHTML.slice(0, 100))""",
        width,
    )
    assert outside == []
    charts = seen.page.evaluate(
        "[...document.querySelectorAll('.chart .main-svg')].map(svg => svg.getBoundingClientRect().right)"
    )
    assert max(charts) <= width
    assert seen.problems == []


# Names along an axis that overlap, in all charts; and tables of which more than a tenth of a row is empty space.
OVERLAPS = """() => [...document.querySelectorAll(".chart")].flatMap(chart => {
  const labels = [...chart.querySelectorAll(".xtick text, .x2tick text")];
  const boxes = labels.map(item => [item.textContent, item.getBoundingClientRect()]);
  return boxes.flatMap(([one, a], place) => boxes.slice(place + 1)
    .filter(([, b]) => Math.min(a.right, b.right) - Math.max(a.left, b.left) > 0
      && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 0)
    .map(([other]) => `${chart.getAttribute("aria-label")}: ${one} and ${other}`));
})"""
EMPTY = """() => [...document.querySelectorAll("main .scroll")].filter(box => {
  if (box.closest(".document") || getComputedStyle(box.querySelector("tr")).display !== "block") return false;
  return box.scrollWidth > box.clientWidth + 1 || [...box.querySelectorAll("td")].some(cell => {
    const shown = getComputedStyle(cell).display !== "none";
    return shown && ["", "–"].includes(cell.textContent);
  });
}).map(box => box.getAttribute("aria-label"))"""


@pytest.mark.slow
@in_browser
def test_on_a_phone_no_names_overlap_and_no_columns_are_empty(browser: Browser, tmp_path: Path) -> None:
    """With all findings of a run whose time axes are broken and whose tables are wide."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hexservo.report.page.groups", sections.groups)
        text = page(hs.simulate(hs.load_scenario("composite-30hz")))
    (tmp_path / "report.html").write_text(text, encoding="utf-8")
    seen = Visit(browser, tmp_path / "report.html", viewport=PHONE, has_touch=True)
    try:
        seen.open().evaluate(DRAW_ALL)
        assert seen.page.evaluate(OVERLAPS) == []
        assert seen.page.evaluate(EMPTY) == []
        assert seen.page.locator(".stacked").count() > 3
        tall = "[...document.querySelectorAll('main figure.table tr')].map(row => row.getBoundingClientRect().height)"
        assert max(seen.page.evaluate(tall)) < 600  # was more than one empty screen beside one column of words
        link = seen.page.locator("p.page a").first
        target = link.get_attribute("href")
        link.click()
        opened = f"document.querySelector('{target}').closest('details').open"
        until(seen.page, opened)
        assert seen.page.locator(str(target)).is_visible()
        assert seen.problems == []
    finally:
        seen.context.close()


COLOURS = """() => ({
  page: getComputedStyle(document.body).backgroundColor,
  words: getComputedStyle(document.body).color,
  ticks: getComputedStyle(document.querySelector(".chart .xtick text")).fill,
  line: getComputedStyle(document.querySelectorAll(".chart")[1].querySelector(".js-line")).stroke,
})"""


TWO_DRAWN = "[...document.querySelectorAll('.chart')].slice(0, 2).every(box => box.querySelector('.xtick text'))"


def brightness(colour: str) -> float:
    red, green, blue = map(int, re.findall(r"\d+", colour)[:3])
    return (red + green + blue) / 765


@pytest.mark.slow
@in_browser
def test_the_dark_scheme(visit: Callable[..., Visit]) -> None:
    seen = visit(viewport=LAPTOP, color_scheme="light")
    shown = seen.open()
    until(shown, TWO_DRAWN)
    light = shown.evaluate(COLOURS)
    shown.emulate_media(color_scheme="dark")  # while it is open
    until(shown, f"getComputedStyle(document.querySelector('.chart .xtick text')).fill !== '{light['ticks']}'")
    dark = shown.evaluate(COLOURS)
    assert brightness(light["page"]) > 0.95
    assert brightness(dark["page"]) < 0.15
    for name in ("words", "ticks"):
        assert brightness(light[name]) < 0.3
        assert brightness(dark[name]) > 0.7
    assert dark["line"] != light["line"]
    other = visit(viewport=LAPTOP, color_scheme="dark")  # from the start
    until(other.open(), TWO_DRAWN)
    assert other.page.evaluate(COLOURS) == dark
    assert seen.problems == other.problems == []


NO_WEBGL = """
const original = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
  return /webgl/.test(kind) ? null : original.call(this, kind, ...rest);
};
"""


@pytest.mark.slow
@in_browser
def test_the_image_has_no_line_where_a_feature_is_not_shown(
    browser: Browser, result: hs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A path begins again after each gap, in the picture beside the view in space."""
    view = scene(result)
    image = view.image.copy()
    image[10:20, 0] = np.nan
    monkeypatch.setattr("hexservo.report.page.scene", lambda _: replace(view, image=image))
    file = tmp_path / "report.html"
    file.write_text(page(result), encoding="utf-8")
    seen = Visit(browser, file, viewport=LAPTOP)
    paths = seen.to_view().locator("#image path.past")
    written = [paths.nth(point).get_attribute("d") or "" for point in range(4)]
    seen.context.close()
    assert [path.count("M") for path in written] == [2, 1, 1, 1]
    shown = np.isfinite(image[..., 0]).sum(axis=0)
    assert [path.count("M") + path.count("L") for path in written] == shown.tolist()


@in_browser
def test_without_webgl_a_still_picture_stands_in(visit: Callable[..., Visit]) -> None:
    """And the rest of the page is there, without an error or a request; slow tests draw all of it."""
    seen = visit(viewport=LAPTOP, color_scheme="light")
    seen.context.add_init_script(NO_WEBGL)
    shown = seen.open()
    until(shown, TWO_DRAWN)
    picture = shown.locator("svg.still")
    assert picture.is_visible()
    assert picture.bounding_box()["height"] > 300  # type: ignore[index]
    assert picture.locator("polyline.leg").count() == 6
    assert "no WebGL" in shown.locator("#webgl-missing").inner_text()
    for hidden in ("#webgl", "#play", "#instant"):
        assert not shown.locator(hidden).is_visible()
    light = shown.evaluate(COLOURS)
    shown.emulate_media(color_scheme="dark")
    until(shown, f"getComputedStyle(document.querySelector('.chart .xtick text')).fill !== '{light['ticks']}'")
    assert brightness(light["page"]) > 0.95 > 0.15 > brightness(shown.evaluate(COLOURS)["page"])
    assert shown.evaluate("document.documentElement.scrollWidth") <= LAPTOP["width"]
    assert seen.problems == []
    assert seen.requests == [seen.url]
    assert shown.evaluate("window.broken") is None


@in_browser
def test_without_scripts_words_tables_and_the_still_picture_remain(visit: Callable[..., Visit]) -> None:
    seen = visit(viewport=PHONE, java_script_enabled=False)
    shown = seen.open()
    assert shown.locator("svg.still").is_visible()
    assert "JavaScript is off: there are no charts." in shown.locator("noscript").inner_text()
    assert shown.get_by_text("along <x>").is_visible()
    assert not shown.locator("#play").is_visible()


# ---- On paper -------------------------------------------------------------------------------------------------------

PAGE_WIDTH, PAGE_HEIGHT = 688, 1016  # px of A4 within its margins


@pytest.mark.slow
@in_browser
def test_it_prints_to_readable_pages(visit: Callable[..., Visit], tmp_path: Path) -> None:
    seen = visit(viewport=LAPTOP, color_scheme="dark")
    content = seen.open().pdf(format="A4", prefer_css_page_size=True, path=tmp_path / "report.pdf")
    boxes = re.findall(rb"/MediaBox\s*\[\s*0 0 ([\d.]+) ([\d.]+)\s*\]", content)
    pages = len(re.findall(rb"/Type\s*/Page\b", content))
    assert 6 <= pages <= 14
    assert len(boxes) == pages
    assert {(round(float(width)), round(float(height))) for width, height in boxes} == {(596, 843)}  # A4, upright
    assert seen.problems == []
    if shutil.which("pdftotext") is not None:
        told = subprocess.run(
            ["pdftotext", "-layout", tmp_path / "report.pdf", "-"], capture_output=True, text=True, check=True
        ).stdout
        words = " ".join(told.split())
        for part in ("All features are within 2 px", "time [s]", "platform", "docs/model.md"):
            assert part in words
        assert all(len(sheet.split()) > 10 for sheet in told.split("\f")[:pages])


@pytest.mark.slow
@in_browser
def test_nothing_is_cut_on_paper(visit: Callable[..., Visit]) -> None:
    """What the printer gets, laid out on the width of a page: no chart is wider or taller than it."""
    seen = visit(viewport={"width": PAGE_WIDTH, "height": PAGE_HEIGHT}, color_scheme="dark")
    shown = seen.open()
    shown.emulate_media(media="print")
    shown.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert shown.evaluate("document.documentElement.scrollWidth") <= PAGE_WIDTH
    boxes = shown.evaluate(
        """() => [...document.querySelectorAll("figure.plot, #view")].map(item => {
          const inside = [...item.querySelectorAll(".main-svg, svg.still")].map(svg => svg.getBoundingClientRect());
          return [item.getBoundingClientRect().height, Math.max(...inside.map(box => box.right)), inside.length];
        })"""
    )
    assert len(boxes) == 14
    for height, right, count in boxes:
        assert height < PAGE_HEIGHT
        assert right <= PAGE_WIDTH
        assert count > 0
    legends = shown.evaluate(
        """() => [...document.querySelectorAll(".chart")].map(box => {
          const legend = box.querySelector(".legend"), plot = box.querySelector(".plot, .cartesianlayer .plot");
          return legend && plot ? plot.getBoundingClientRect().top - legend.getBoundingClientRect().bottom : 0;
        })"""
    )
    assert min(legends) > -12  # a legend stands above its chart, not over it
    assert shown.locator("svg.still").is_visible()
    assert not shown.locator("#webgl").is_visible()
    ticks = shown.evaluate("getComputedStyle(document.querySelector('.chart .xtick text')).fill")
    assert brightness(ticks) < 0.3  # dark ink on white paper, whatever the screen's scheme
    shown.emulate_media(media="screen")
    shown.evaluate("dispatchEvent(new Event('afterprint'))")
    ticks = shown.evaluate("getComputedStyle(document.querySelector('.chart .xtick text')).fill")
    assert brightness(ticks) > 0.7
    assert seen.problems == []


@pytest.mark.slow
@in_browser
def test_no_toolbars_cover_the_charts_where_nothing_hovers(visit: Callable[..., Visit]) -> None:
    seen = visit(viewport=LAPTOP)  # as a browser that only makes a PDF: no pointer, fine or coarse
    seen.page.add_init_script(
        "const asked = matchMedia; matchMedia = query => /hover|pointer/.test(query) ? {matches: false} : asked(query);"
    )
    seen.open().wait_for_selector(".chart .main-svg", state="attached")
    assert seen.page.locator(".modebar-btn").count() == 0
    assert seen.problems == []


@pytest.mark.parametrize("name", ["run.pdf", "run.html.txt"])
def test_a_report_is_not_written_into_a_name_of_another_kind(tmp_path: Path, name: str) -> None:
    with pytest.raises(OutputError, match=r"ending in \.html"):
        check_report(tmp_path / name)
    for good in ("run.html", "run.HTM", "run"):
        check_report(tmp_path / good)
