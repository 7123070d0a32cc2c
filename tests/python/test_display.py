"""Results in a notebook and as text: short, with tables and figures, without a warning; tables of numbers; pickling."""

from __future__ import annotations

import base64
import copy
import json
import math
import pickle
import re
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread

import hexservo as hs
from hexservo.draw.batch import batch_figure
from hexservo.draw.evidence import item_figure
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.evidence import Curves, HeatMap, Line, Table

VARIED = {"uncertainty.gravity": np.array([0.0, 0.01, 0.02]), "controller.hybrid.kv": np.full((1, 6), 1e-3)}


@pytest.fixture(scope="module")
def returned(paper: hs.Scenario, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """One of everything that a function of hexservo returns."""
    short = paper.updated({"simulation.duration": 0.4})
    sampled = short.updated({"simulation.mode": "sampled", "controller.switching.kind": "implicit"})
    run = hs.simulate(short)
    tick = hs.Controller(sampled, period=1e-3)
    vary = {"uncertainty.gravity": {"uniform": [0.0, 0.02]}}
    file = {"scenario": short, "vary": vary, "require": ["final_error <= 1.0"], "runs": 8}
    folder = tmp_path_factory.mktemp("campaign")
    drawn = hs.campaign(file, folder / "out")
    ticks = np.asarray(0.01 * np.arange(60))
    swaying = 0.2 + 1e-3 * np.sign(np.sin(20 * ticks))[:, None] * np.ones(6)
    log = hs.Log(ticks, 0.01, swaying, np.roll(swaying, 1, axis=0), None)
    gains = {"variables": {"controller.hybrid.kp": {"log": [1e-7, 1e-5]}}, "minimise": "effort", "over": 2}
    return {
        "Scenario": short,
        "Result": run,
        "Result with weights": hs.simulate(short, log_weights=True),
        "Result with events": hs.simulate(short.updated({"robot.force_limit": 0.2})),
        "Result of a custom controller": hs.simulate(sampled, controller=lambda seen: np.zeros(6)),
        "BatchResult": hs.simulate_batch(short, VARIED, log="trajectory"),
        "BatchResult of metrics": hs.simulate_batch(short, VARIED, log="metrics"),
        "Comparison": hs.compare([short], ["hybrid", "kelly"]),
        "Analysis": hs.analyse(hs.load_scenario("composite-30hz"), ["conditioning", "workspace", "camera_rate"]),
        "Certificate": hs.certify(run),
        "Certificate of a sampled run": hs.certify(hs.simulate(sampled)),
        "BatchCertificate": hs.certify_batch(short, VARIED),
        "Check": hs.check(paper),
        "Diagnosis": hs.diagnose(hs.simulate(hs.load_scenario("fails-late-camera"))),
        "Diagnosis of a run that passes": hs.diagnose(hs.simulate(paper)),
        "Observation": hs.Observation(0, 0.0, math.nan, *(np.full(n, math.nan) for n in (8, 4, 3, 4, 6, 6, 6, 8, 6))),
        "LegForces": hs.LegForces(np.ones(6)),
        "LegPositions": hs.LegPositions(np.ones(6)),
        "ControllerOutput": tick.step(np.zeros(8), -0.5 * np.ones(4), [0, 0, -0.1], [1, 0, 0, 0], np.zeros(6)),
        "Reachability": hs.reachable(paper, [0.0] * 6),
        "Log": log,
        "Identification": hs.identify(log, paper),
        "CampaignResult": drawn,
        "WorstRuns": drawn.worst(1),
        "WorstCase": hs.worst_case(drawn, runs=20, restarts=1),
        "RareFailures": hs.estimate_rare_failures(file, samples=100),
        "Sensitivity": hs.sensitivity(file, samples=32),
        "TuneResult": hs.tune(file | {"tune": gains}, folder / "tuned", generations=1, rounds=1),
        "metrics": hs.metrics(run),
        "METRICS": hs.METRICS,
        "scenario_names": hs.scenario_names(),
    }


def assert_same(one: Any, other: Any, where: str = "") -> None:
    """Equal in type and bit for bit, whatever is inside."""
    assert type(one) is type(other), where
    if isinstance(one, np.ndarray):
        assert one.dtype == other.dtype, where
        np.testing.assert_array_equal(one, other, err_msg=where)
    elif isinstance(one, dict):
        assert list(one) == list(other), where
        for key in one:
            assert_same(one[key], other[key], f"{where}[{key!r}]")
    elif isinstance(one, list | tuple):
        assert len(one) == len(other), where
        for place, (a, b) in enumerate(zip(one, other, strict=True)):
            assert_same(a, b, f"{where}[{place}]")
    elif is_dataclass(one) and not isinstance(one, type):
        for member in fields(one):
            assert_same(getattr(one, member.name), getattr(other, member.name), f"{where}.{member.name}")
    elif isinstance(one, float) and math.isnan(one):
        assert math.isnan(other), where
    elif isinstance(one, Scene):  # of objects of the core, which follow from the scenario
        assert_same(one.scenario, other.scenario, where)
    else:
        assert one == other, where


# ---- Pickling -------------------------------------------------------------------------------------------------------


def test_everything_that_is_returned_can_be_pickled_and_copied(returned: dict[str, Any]) -> None:
    for name, value in returned.items():
        for protocol in (2, pickle.HIGHEST_PROTOCOL):
            assert_same(pickle.loads(pickle.dumps(value, protocol)), value, name)
        assert_same(copy.deepcopy(value), value, name)


def test_every_public_class_of_results_is_among_them(returned: dict[str, Any]) -> None:
    """Classes that are exported but only inside others count too: rows, events."""
    seen: set[type] = set()

    def walk(value: Any) -> None:
        seen.add(type(value))
        if isinstance(value, dict):
            for item in value.values():
                walk(item)
        elif isinstance(value, list | tuple):
            for item in value:
                walk(item)
        elif is_dataclass(value) and not isinstance(value, type):
            for member in fields(value):
                walk(getattr(value, member.name))

    walk(returned)
    public = {value for value in (getattr(hs, name) for name in hs.__all__) if isinstance(value, type)}
    missing = {item for item in public - seen if not issubclass(item, Exception)} - {hs.Controller}
    assert missing == set()


@pytest.mark.parametrize(
    "make",
    [
        lambda: hs.load_scenario("nothing-of-this-name"),
        lambda: hs.load_scenario("paper").updated({"robot.mass": -1.0, "camera.noise": "x"}),
        lambda: hs.load_result("nothing-of-this-name.nc"),
    ],
)
def test_errors_can_be_pickled(make: Callable[[], object]) -> None:
    with pytest.raises(ValueError, match=r".") as caught:
        make()
    again = pickle.loads(pickle.dumps(caught.value))
    assert type(again) is type(caught.value)
    assert str(again) == str(caught.value)
    assert vars(again) == vars(caught.value)


# ---- Text and HTML --------------------------------------------------------------------------------------------------

SHOWN = [
    "Result", "Result with weights", "BatchResult", "BatchResult of metrics", "Comparison", "Analysis", "Certificate",
    "Certificate of a sampled run", "BatchCertificate", "Diagnosis", "Diagnosis of a run that passes",
]  # fmt: skip


def test_text_is_a_few_lines(returned: dict[str, Any]) -> None:
    for name in SHOWN:
        lines = repr(returned[name]).split("\n")
        assert 2 <= len(lines) <= 16, (name, lines)
        assert max(map(len, lines)) <= 110, (name, lines)
        assert " array(" not in repr(returned[name]), name
    for part in returned["Analysis"].parts.values():
        assert len(repr(part).split("\n")) <= 8
    for row in returned["Comparison"].rows:
        assert len(repr(row)) < 300


def test_text_says_what_came_out(returned: dict[str, Any]) -> None:
    run = repr(returned["Result"])
    assert run.startswith('Result of "paper"\n')
    assert f"{hs.metrics(returned['Result'])['final_error']:.4g} px" in run
    assert "401 samples" in run
    batch = repr(returned["BatchResult"])
    assert batch.startswith('3 runs of "paper", law hybrid\n')
    assert "varied: uncertainty.gravity, controller.hybrid.kv" in batch
    assert "outcomes: 3 completed" in batch
    assert 'Diagnosis of "fails-late-camera"' in repr(returned["Diagnosis"])
    assert returned["Diagnosis"].causes[0].title in " ".join(repr(returned["Diagnosis"]).split())
    assert re.search(r"\n  kelly: 1 (not )?settled", repr(returned["Comparison"]))
    for name in ("Sensitivity", "RareFailures"):  # results that nothing judges
        assert "not applicable" not in repr(returned[name]) + returned[name]._repr_html_(), name


class Balanced(HTMLParser):
    """Collects tags, and whether every element is closed where it was opened."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.pictures: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag == "img":
            self.pictures.append(dict(attrs)["src"] or "")
        elif tag != "br":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_a_notebook_gets_tables_and_figures(returned: dict[str, Any]) -> None:
    for name in SHOWN:
        page = Balanced()
        page.feed(returned[name]._repr_html_())
        page.close()
        assert page.open == [], name
        if name != "Diagnosis of a run that passes":  # which has no more than a sentence
            assert "table" in page.tags, name
        if name not in ("Diagnosis of a run that passes", "BatchCertificate"):
            assert page.pictures, name
        for picture in page.pictures:
            content = base64.b64decode(picture.removeprefix("data:image/png;base64,"), validate=True)
            assert imread(BytesIO(content), format="png").std() > 0.02  # lines on a ground, not an empty sheet


@pytest.mark.slow
def test_what_a_notebook_shows_of_a_run_is_quick(returned: dict[str, Any]) -> None:
    """Far below the time of one figure at print quality and its files, of which a run has ten."""

    def taken(action: Callable[[], object]) -> float:
        best = math.inf
        for _ in range(3):
            started = time.process_time()
            action()
            best = min(best, time.process_time() - started)
        return best

    def all_figures() -> None:
        for draw in (
            hs.plots.feature_errors,
            hs.plots.feature_paths,
            hs.plots.platform_motion,
            hs.plots.control_wrench,
        ):
            draw(returned["Result"]).savefig(BytesIO(), format="svg")

    assert taken(returned["Result"]._repr_html_) < taken(all_figures)


def test_the_name_of_a_function_is_no_markup(returned: dict[str, Any]) -> None:
    page = returned["Result of a custom controller"]._repr_html_()
    assert "<lambda>" not in page
    assert "&lt;lambda&gt;" in page


def test_findings_are_drawn_as_they_are() -> None:
    x = np.linspace(0.1, 10, 5000)
    figure = item_figure(
        Curves("t", "x [s]", "y [px]", [Line("a", x, x**2), Line("b", x[::500], x[::500], "points")], True, True)
    )
    (axes,) = figure.axes
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [s]", "y [px]")
    first, second = axes.lines
    np.testing.assert_array_equal(np.asarray(first.get_ydata()), np.asarray(first.get_xdata()) ** 2)
    assert len(np.asarray(first.get_xdata())) < 3000
    np.testing.assert_array_equal(np.asarray(second.get_xdata()), x[::500])
    z = np.arange(12.0).reshape(3, 4)
    figure = item_figure(HeatMap("t", "x", "y", "z", np.arange(4.0), np.arange(3.0), z, (5.0,)))
    (mesh,) = [item for item in figure.axes[0].collections if type(item).__name__ == "QuadMesh"]
    np.testing.assert_array_equal(np.asarray(mesh.get_array()).reshape(3, 4), z)
    assert Table("t", (), ()).rows == ()


def test_importing_hexservo_imports_neither_pandas_nor_matplotlib() -> None:
    code = """
import sys
import hexservo as hs
result = hs.simulate(hs.load_scenario("paper").updated({"simulation.duration": 0.01}))
repr(result)
print([name for name in ("pandas", "xarray", "matplotlib", "IPython", "rich", "markdown_it") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "[]"


# ---- Files ----------------------------------------------------------------------------------------------------------


def test_a_saved_run_is_read_back_and_never_written_over_unasked(returned: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "result.nc"
    for name in ("Result with weights", "Result with events"):
        returned[name].save(path, force=True)
        assert_same(hs.load_result(path), returned[name])
    before = path.read_bytes()
    with pytest.raises(ValueError, match="exists"):
        returned["Result"].save(path)
    assert path.read_bytes() == before
    other = tmp_path / "notes.nc"
    other.write_text("mine")
    with pytest.raises(ValueError, match="kept"):
        returned["Result"].save(other, force=True)
    assert other.read_text() == "mine"


# ---- Tables of numbers ----------------------------------------------------------------------------------------------


def test_a_run_as_a_table_has_a_column_for_each_scalar(returned: dict[str, Any]) -> None:
    run: hs.Result = returned["Result"]
    table = run.to_dataframe()
    data = run.to_xarray()
    np.testing.assert_array_equal(table.index.to_numpy(), run.time)
    assert table.index.name == "time"
    names = [name for name in data.data_vars if "time" in data[name].dims]
    assert len(table.columns) == sum(data[name].shape[1] for name in names)
    for name in names:
        dimension = data[name].dims[1]
        for label in data[name][dimension].values.tolist():
            np.testing.assert_array_equal(
                table[f"{name}_{label}"].to_numpy(), data[name].sel({dimension: label}).to_numpy()
            )
    units = table.attrs["units"]
    assert set(units) == {"time", *table.columns}
    assert (units["feature_error_x1"], units["twist_vx"], units["twist_wx"]) == ("px", "m/s", "rad/s")
    assert (units["wrench_fz"], units["wrench_mz"], units["leg_forces_6"]) == ("N", "N m", "N")
    assert (table.attrs["scenario"], table.attrs["outcome"]) == ("paper", "completed")


@pytest.mark.parametrize("asked", [["final_error"], ["effort", "chatter", "overshoot"], []])
def test_a_batch_shows_what_it_measured(paper: hs.Scenario, asked: list[str]) -> None:
    short = paper.updated({"simulation.duration": 0.05})
    for varied in (
        {"uncertainty.depth": [0.0, 0.1, 0.2]},
        {"uncertainty.depth": [0.0, 0.1], "robot.mass": [0.06, 0.061]},
    ):
        batch = hs.simulate_batch(short, varied, "metrics", metrics=asked)
        html = batch._repr_html_()
        assert html.count("<img") == (1 if asked else 0)
        for name in hs.METRICS:
            assert (f"<td>{name}</td>" in html or f">{name}<" in html) == (name in asked), name
        assert "3 completed" in repr(batch) or "2 completed" in repr(batch)


@pytest.mark.parametrize(
    ("key", "values", "label"),
    [
        ("robot.mass", [0.06, 0.061], "robot.mass [kg]"),
        ("uncertainty.depth", [0.0, 0.1], "uncertainty.depth [1]"),
    ],
)
def test_the_figure_of_a_batch_has_the_unit_of_what_varies(
    paper: hs.Scenario, key: str, values: list[float], label: str
) -> None:
    batch = hs.simulate_batch(paper.updated({"simulation.duration": 0.02}), {key: values}, "metrics")
    assert {axes.get_xlabel() for axes in batch_figure(batch).axes} == {label}


def test_a_batch_as_a_table_has_a_row_for_each_run(returned: dict[str, Any]) -> None:
    batch: hs.BatchResult = returned["BatchResult"]
    table = batch.to_dataframe()
    assert list(table.index) == [0, 1, 2]
    assert list(table.columns[:8]) == [
        "uncertainty.gravity", *(f"controller.hybrid.kv[{axis}]" for axis in range(6)), "outcome",
    ]  # fmt: skip
    np.testing.assert_array_equal(table["uncertainty.gravity"], [0.0, 0.01, 0.02])
    assert (table["controller.hybrid.kv[5]"] == 1e-3).all()
    assert list(table["outcome"]) == ["completed"] * 3
    for name, (unit, _) in hs.METRICS.items():
        np.testing.assert_array_equal(table[name], batch.metrics[name])
        assert table.attrs["units"][name] == unit
    matrices = np.broadcast_to(np.diag([1e-5, 2e-5, 3e-5]), (2, 3, 3))
    varied = hs.simulate_batch(batch.scenario, {"robot.inertia": matrices}, log="metrics").to_dataframe()
    assert (varied["robot.inertia[1][1]"] == 2e-5).all()
    assert (varied["robot.inertia[0][1]"] == 0).all()


# ---- In a notebook --------------------------------------------------------------------------------------------------

NOTEBOOK = """
import warnings
warnings.simplefilter("error")
import hexservo as hs, numpy as np
paper = hs.load_scenario("paper").updated({"simulation.duration": 0.2})
---
hs.simulate(paper)
---
hs.simulate_batch(paper, {"uncertainty.depth": np.linspace(-0.1, 0.1, 20)}, log="metrics", progress=True)
---
hs.compare([paper], ["hybrid", "kelly"], progress=True)
---
hs.certify_batch(paper, {"uncertainty.depth": [0.0, 0.1]}, progress=True)
"""


@pytest.mark.slow
def test_in_a_real_notebook_there_is_html_and_no_warning() -> None:
    """A Jupyter kernel without ipywidgets, for which rich's own progress bar asks with a warning."""
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    cells = [nbformat.v4.new_code_cell(code.strip()) for code in NOTEBOOK.split("---\n")]
    book = nbformat.v4.new_notebook(cells=cells)
    nbclient.NotebookClient(book, timeout=300, kernel_name="python3").execute()
    outputs = [cell["outputs"] for cell in book.cells]
    text = json.dumps(outputs)
    assert "ipywidgets" not in text
    assert not [output for cell in outputs for output in cell if output["output_type"] in ("stream", "error")], text
    shown = [cell[-1]["data"] for cell in outputs[1:]]
    for data in shown:
        assert "<table" in data["text/html"]
        assert len(data["text/plain"].split("\n")) < 12
    for data in shown[:3]:
        assert "data:image/png;base64," in data["text/html"]
    assert "20 of 20 scenarios" in outputs[2][0]["data"]["text/html"]
    assert "million steps/s" in outputs[2][0]["data"]["text/html"]
    assert "2 of 2 runs certified" in outputs[4][0]["data"]["text/html"]
