"""Comparisons: rows equal the single runs; tables and plots; the command."""

from __future__ import annotations

import csv
import html
import io
import math
import re
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from typer.testing import CliRunner

import hexservo as hs
from hexservo.cli.commands import app
from hexservo.draw.compare import _thinned
from hexservo.draw.style import our_style
from hexservo.run import compare
from hexservo.run.comparison import COLUMNS, column_texts
from hexservo.run.files import MARKER
from hexservo.run.metrics import metric_unit, readable, unsettled
from hexservo.run.summary import summary_sentences
from hexservo.scenario.laws import ALL_LAWS, LAWS
from hexservo.scenario.wording import number as written

SHORT = {"simulation.duration": 0.3, "controller.switching.kind": "tanh"}  # smooth: a lane agrees with a single run


@pytest.fixture(scope="module")
def comparison() -> hs.Comparison:
    return hs.compare(["paper", "paper-gravity", "task-tilt"], ["hybrid", "composite"])


# ---- Rows -----------------------------------------------------------------------------------------------------------


def test_rows_are_the_runs_scenario_by_scenario() -> None:
    names, laws = ["paper-minus", "task-general"], ["composite", "hybrid"]
    compared = hs.compare(names, laws, SHORT)
    assert [(row.scenario.name, row.law) for row in compared.rows] == [(n, law) for n in names for law in laws]
    for row in compared.rows:
        scenario = hs.load_scenario(row.scenario.name).updated({**SHORT, "controller.law": row.law})
        assert row.scenario == scenario
        result = hs.simulate(scenario)
        assert (row.outcome, row.end_time, row.detail) == (result.outcome, result.end_time, result.detail)
        for name, value in hs.metrics(result).items():
            # a lane agrees with a single run to 1e-11 where it is smooth (docs/batch.md); sums over the run to less
            assert row.metrics[name] == pytest.approx(value, rel=1e-8, abs=1e-11, nan_ok=True), name
        np.testing.assert_array_equal(row.time, result.time)
        np.testing.assert_allclose(row.error, np.abs(result.feature_error).max(axis=1), rtol=0, atol=1e-8)


def test_a_row_does_not_depend_on_the_other_rows(comparison: hs.Comparison) -> None:
    for row in comparison.rows:
        (alone,) = hs.compare([row.scenario.name], [row.law]).rows
        assert repr(dict(alone.metrics)) == repr(dict(row.metrics))  # NaN is not itself
        assert alone.error.tobytes() == row.error.tobytes()


def test_scenarios_that_differ_in_numbers_alone_share_a_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    batches = []

    def watched(scenario: hs.Scenario, variations: Any, *rest: Any) -> hs.BatchResult:
        batches.append((scenario.controller.law, sorted(variations), len(next(iter(variations.values())))))
        return hs.simulate_batch(scenario, variations, *rest)

    monkeypatch.setattr(compare, "simulate_batch", watched)
    names = ["paper", "paper-minus", "task-general", "paper-no-fuzzy"]
    compared = hs.compare(names, ["hybrid"], {"simulation.duration": 0.01})
    assert [count for _, _, count in batches] == [3, 1]  # without the fuzzy systems it is another loop
    assert {"uncertainty.depth", "target.desired_features", "target.depth"} <= set(batches[0][1])
    depths = [row.scenario.uncertainty.depth for row in compared.rows]
    assert depths == [0.3, -0.3, 0.3, 0.3]


def test_numbers_and_arrays_of_a_key_share_a_batch(paper: hs.Scenario) -> None:
    changes: list[dict[str, Any]] = [
        {},
        {"uncertainty.depth": [0.1, 0.2, 0.3, 0.4], "robot.inertia": np.diag([2e-4, 1e-4, 2e-4]) + 1e-6},
        {"uncertainty.inertia": np.diag([0.1] * 6), "controller.hybrid.kp": [1e-6 * k for k in range(1, 9)]},
        {"simulation.mode": "sampled", "seed": 2**60},  # no float
    ]
    scenarios = [paper.updated({**SHORT, **change, "name": f"s{i}"}) for i, change in enumerate(changes)]
    compared = hs.compare(scenarios, ["hybrid"])
    for row, scenario in zip(compared.rows, scenarios, strict=True):
        expected = hs.metrics(hs.simulate(scenario))
        assert row.metrics["final_error"] == pytest.approx(expected["final_error"], rel=1e-8)


def test_the_law_of_machines_that_take_positions_runs_where_a_scenario_has_it() -> None:
    short = {"simulation.duration": 1.0, "metrics.rms_start": 0.0}
    comparison = hs.compare(["pi-h824-positions", "paper-nominal"], changes=short)
    assert comparison.laws == (*LAWS, "tracking")
    rows = {(row.scenario.name, row.law): row for row in comparison.rows}
    assert rows["pi-h824-positions", "tracking"].metrics["settling_time"] < 0.5
    refused = rows["paper-nominal", "tracking"]
    assert refused.outcome == "refused"
    assert "sampled" in refused.detail
    assert hs.compare(["paper-nominal"], changes=short).laws == LAWS


def test_long_runs_keep_a_thinned_error(paper: hs.Scenario) -> None:
    (row,) = hs.compare([paper.updated({"simulation.duration": 12.3})], ["hybrid"]).rows
    assert 2500 < len(row.time) <= 5001
    assert row.time[-1] == pytest.approx(12.3)
    assert row.error[-1] == row.metrics["final_error"]


def test_verdicts_say_why(comparison: hs.Comparison) -> None:
    row = comparison.row("hybrid", "paper")
    assert row.settled
    assert (row.verdict, row.why, row.passed_limits) == ("settled", "within 2 px after 0.353 s", ())
    row = comparison.row("hybrid", "paper-gravity")
    assert not row.settled
    assert (row.verdict, row.passed_limits) == ("not settled", ("stroke",))
    assert row.why == "37.58 px from the goal at the end, above 2 px; a leg exceeded its stroke of 17 mm"
    wrong_sign = hs.compare(["paper"], ["hybrid"], {"controller.jacobian": "printed"}).rows[0]
    assert wrong_sign.verdict == "diverged"
    assert wrong_sign.why.startswith(wrong_sign.detail)
    assert wrong_sign.end_time == pytest.approx(0.04, abs=0.002)
    assert len(wrong_sign.error) == round(wrong_sign.end_time / 1e-3) + 1
    with pytest.raises(KeyError, match="a pair that was compared"):
        comparison.row("hybrid", "paper-minus")


def test_an_error_just_above_the_band_is_not_written_as_the_band(paper: hs.Scenario) -> None:
    result = hs.simulate(paper.updated({"simulation.duration": 0.02}))
    left = hs.metrics(result)["final_error"]
    near = result.scenario.updated({"metrics.band": left * (1 - 1e-6)})
    text = unsettled(hs.metrics(result), near.metrics)
    words = re.fullmatch(r"(.*) px from the goal at the end, above (.*) px", text)
    assert words is not None
    error, band = words.groups()
    assert float(error) > float(band)
    assert f"The largest feature error at the end is {error} px." in summary_sentences(replace(result, scenario=near))


def test_columns_have_the_unit_of_their_largest_number(comparison: hs.Comparison) -> None:
    row = comparison.row("hybrid", "paper")
    column = next(column for column in COLUMNS if column.metric == "peak_displacement")
    large, small, rounding, none = (
        replace(row, metrics={**row.metrics, "peak_displacement": value}) for value in (1.5, 2e-6, 1e-12, math.nan)
    )
    assert column_texts([large, small, rounding, none], column) == ("m", ["1.5", "2e-06", "<1e-9", "-"])
    assert column_texts([small, rounding], column) == ("um", ["2", "<0.001"])
    assert column_texts([small, none], column, with_units=True) == ("", ["2 um", "-"])


def test_a_metric_has_the_unit_of_its_size(comparison: hs.Comparison) -> None:
    robot = comparison.row("hybrid", "paper").scenario.robot
    assert readable("peak_control_moment", 1032.4, robot) == ("1032", "N m")
    assert readable("peak_displacement", 3.087e-4, robot) == ("308.7", "um")
    assert readable("peak_leg_force", 0.3582, robot) == ("0.3582", "N")


def test_rounding_is_not_written_as_a_result(comparison: hs.Comparison) -> None:
    row = comparison.row("hybrid", "paper")
    tiny = replace(row, metrics={**row.metrics, "final_error": 1.14e-13, "relative_overshoot": 1.55e-14})
    by_name = {column.metric: column_texts([tiny], column)[1][0] for column in COLUMNS}
    assert (by_name["final_error"], by_name["relative_overshoot"]) == ("<1e-6", "<1e-6")
    assert "1.14e-13" in replace(comparison, rows=(tiny,)).to_csv()
    robot = row.scenario.robot
    assert readable("peak_line_deviation", 1.421e-14, robot) == ("<1e-6", "px")
    assert readable("peak_rotation", 7.95e-14, robot) == ("<1", "nrad")
    assert readable("peak_rotation", 7.95e-14, robot, largest=0.02) == ("<1e-6", "mrad")
    assert readable("peak_displacement", 7.95e-14, robot, largest=2e-5) == ("<0.001", "um")
    assert [readable("final_error", value, robot)[0] for value in (0.0, 1e-6)] == ["0", "1e-06"]
    assert readable("peak_leg_force", 1e-12, robot) == ("1e-12", "N")
    result = hs.simulate(hs.load_scenario("paper").updated({"simulation.duration": 0.02}))
    rest = replace(result, streamed_metrics={**result.streamed_metrics, "final_error": 1e-13, "rms_error": 1e-14})
    assert any(
        re.fullmatch(r"The .* is less than 1e-6 px; from 1 s on their RMS is less than 1e-6 px\.", sentence)
        for sentence in summary_sentences(rest)
    )


def test_a_law_that_refuses_a_scenario_is_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = "controller.law: expected a law for this camera, got composite"
    updated = hs.Scenario.updated

    def refusing(self: hs.Scenario, changes: Any) -> hs.Scenario:
        if changes.get("controller.law") == "composite" and self.camera.convention == "as_printed":
            raise hs.ScenarioError([problem])
        return updated(self, changes)

    monkeypatch.setattr(hs.Scenario, "updated", refusing)
    changes = {"camera.convention": "as_printed", "simulation.duration": 0.05}
    compared = hs.compare(["paper"], ["composite", "hybrid"], changes)
    refused, ran = compared.rows
    assert (refused.outcome, refused.detail, refused.why) == ("refused", problem, problem)
    assert not refused.settled
    assert not refused.metrics
    assert ran.outcome == "completed"
    assert not compared.interrupted
    assert "| paper | composite | refused | - |" in compared.to_markdown()
    figure = compared.figure()
    assert "refused" in [text.get_text() for axes in figure.axes for text in axes.texts]


def test_a_run_that_fits_no_batch_is_simulated_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    together = hs.compare(["paper", "paper-minus"], ["hybrid"], SHORT)

    def refused(*arguments: Any) -> hs.BatchResult:
        raise ValueError("simulation.mode: expected continuous, got another")

    monkeypatch.setattr(compare, "simulate_batch", refused)
    alone = hs.compare(["paper", "paper-minus"], ["hybrid"], SHORT)
    for one, other in zip(together.rows, alone.rows, strict=True):
        assert one.detail == other.detail
        assert one.metrics["final_error"] == pytest.approx(other.metrics["final_error"], rel=1e-8)


def test_ctrl_c_keeps_what_is_finished(monkeypatch: pytest.MonkeyPatch) -> None:
    batch = hs.simulate_batch
    calls = []

    def interrupted(scenario: hs.Scenario, *rest: Any) -> hs.BatchResult:
        calls.append(scenario.controller.law)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return batch(scenario, *rest)

    monkeypatch.setattr(compare, "simulate_batch", interrupted)
    compared = hs.compare(["paper"], ["composite", "hybrid"], SHORT)
    assert compared.interrupted
    assert compared.finished == 1
    assert [row.outcome for row in compared.rows] == ["completed", "interrupted"]
    assert compared.row("hybrid", "paper").why == "not begun"
    assert [row["settled"] for row in csv.DictReader(io.StringIO(compared.to_csv()))] == ["no", ""]
    compared.figure()


def test_progress_counts_runs() -> None:
    class Told(list[tuple[int, int]]):  # which is false as long as it is empty
        def __call__(self, done: int, count: int) -> None:
            self.append((done, count))

    told = Told()
    hs.compare(["paper", "paper-no-fuzzy"], None, SHORT, progress=told)
    assert told[-1] == (2 * len(LAWS), 2 * len(LAWS))
    assert [done for done, _ in told] == sorted(done for done, _ in told)


def test_what_the_progress_function_raises_ends_the_comparison() -> None:
    told = []

    def stop(done: int, count: int) -> None:
        told.append(done)
        if done:
            raise ValueError("enough")

    with pytest.raises(ValueError, match=r"^enough$"):
        hs.compare(["paper", "paper-minus"], ["hybrid"], SHORT, progress=stop)
    assert len([done for done in told if done]) == 1


@pytest.mark.parametrize("threads", [0, -3, 5000])
def test_threads_are_checked_before_any_run(threads: int) -> None:
    with pytest.raises(ValueError, match=rf"^threads: expected an integer from 1 to 1024, got {threads}$"):
        hs.compare(["paper"], ["hybrid"], SHORT, threads=threads)


@pytest.mark.parametrize(
    ("scenarios", "laws", "words"),
    [
        ([], ["hybrid"], "scenarios: expected at least one, of different names, got none"),
        (
            ["paper", "paper"],
            ["hybrid"],
            "scenarios: expected at least one, of different names, got paper more than once",
        ),
        (["paper"], [], "laws: expected at least one, each once, got none"),
        (["paper"], ["hybrid", "hybrid"], "got hybrid, hybrid"),
        (["paper"], ["pid"], f"laws: expected some of {', '.join(ALL_LAWS)}, got 'pid'"),
        (["papers"], None, 'did you mean "paper"?'),
    ],
)
def test_bad_choices_are_refused(scenarios: list[str], laws: list[str] | None, words: str) -> None:
    with pytest.raises(ValueError, match=re.escape(words)):
        hs.compare(scenarios, laws)


def test_text_in_place_of_a_list_is_refused() -> None:
    with pytest.raises(TypeError, match="scenarios: expected a sequence"):
        hs.compare("paper")
    with pytest.raises(TypeError, match="scenarios: expected a sequence of scenarios, names or paths, got NoneType"):
        hs.compare(None)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="laws: expected a sequence"):
        hs.compare(["paper"], "hybrid")
    with pytest.raises(TypeError, match="laws: expected a sequence of names or None, got int"):
        hs.compare(["paper"], 3)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="progress: expected"):
        hs.compare(["paper"], ["hybrid"], SHORT, progress=3)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="controllers: expected names that are text, got int"):
        hs.compare(["paper"], ["hybrid"], SHORT, controllers={5: lambda seen: np.zeros(6)})  # type: ignore[dict-item]


def test_laws_may_come_from_an_iterator() -> None:
    changes = {"simulation.duration": 0.01}
    assert hs.compare(["paper"], (law for law in ["composite", "hybrid"]), changes).laws == ("composite", "hybrid")
    with pytest.raises(ValueError, match="laws: expected at least one, each once, got none"):
        hs.compare(["paper"], iter([]))


# ---- Tables and pictures --------------------------------------------------------------------------------------------


def test_csv_has_every_metric_to_the_last_bit(comparison: hs.Comparison) -> None:
    rows = list(csv.DictReader(io.StringIO(comparison.to_csv())))
    assert len(rows) == len(comparison.rows)
    for text, row in zip(rows, comparison.rows, strict=True):
        assert (text["scenario"], text["law"], text["outcome"]) == (row.scenario.name, row.law, row.outcome)
        assert text["settled"] == ("yes" if row.settled else "no")
        assert text["why"] == row.why
        for name, (unit, _) in hs.METRICS.items():
            written = text[f"{name} [{unit}]"]
            value = row.metrics[name]
            assert (written == "") if math.isnan(value) else (float(written) == value)


def test_the_table_of_pandas_has_every_metric_and_its_unit(comparison: hs.Comparison) -> None:
    unsettled, overloaded = comparison.row("hybrid", "paper-gravity"), comparison.row("composite", "paper")
    refused = replace(unsettled, outcome="refused", detail="of the law", metrics={}, end_time=math.nan)
    rows = (unsettled, overloaded, refused)
    table = replace(comparison, rows=rows).to_dataframe()
    assert table["scenario"].tolist() == ["paper-gravity", "paper", "paper-gravity"]
    for column in ("law", "outcome", "settled", "why"):
        assert table[column].tolist() == [getattr(row, column) for row in rows]
    assert table["limits"].tolist() == ["stroke", "", ""]
    assert table["settled"].dtype == bool
    for name, (unit, _) in hs.METRICS.items():
        expected = [row.metrics.get(name, math.nan) for row in rows]
        np.testing.assert_array_equal(table[name], expected, err_msg=name)
        assert table.attrs["units"][name] == unit
    np.testing.assert_array_equal(table["end_time"], [row.end_time for row in rows])
    assert table.attrs["units"]["end_time"] == "s"


def test_markdown_is_one_table(comparison: hs.Comparison) -> None:
    lines = comparison.to_markdown().splitlines()
    assert len(lines) == 2 + len(comparison.rows)
    assert {line.count(" | ") for line in lines} == {len(COLUMNS) + 3}
    assert "| paper | hybrid | settled | 0.353 |" in lines[2]
    assert "| paper-gravity | hybrid | not settled | never |" in lines[4]


def test_a_limit_that_is_exceeded_has_a_mark(comparison: hs.Comparison) -> None:
    """In Markdown as in the terminal and in a notebook."""
    heads, _, *lines = (line.split(" | ") for line in comparison.to_markdown().splitlines())
    stroke, force = heads.index("stroke [mm]"), heads.index("leg force [N]")
    for cells, row in zip(lines, comparison.rows, strict=True):
        assert cells[stroke].endswith("!") == ("stroke" in row.passed_limits)
        assert cells[force].endswith("!") == ("force" in row.passed_limits)
    excursion = written(1e3 * comparison.row("hybrid", "paper-gravity").metrics["peak_leg_excursion"])
    assert f"| {excursion}! |" in comparison.to_markdown()
    assert f">{excursion}!<" in comparison._repr_html_()


CRANKS, LEGS = "reachy-mini-motors", "paper"
UNITS = {CRANKS: ("mN m", 1e3, "rad"), LEGS: ("N", 1.0, "m")}  # of the peaks of effort and travel


def shown_legs(row: hs.ComparisonRow, *, with_unit: bool) -> list[str]:
    """What the two columns of the legs show, without marks."""
    effort, scale, _ = UNITS[row.scenario.name]
    excursion = row.metrics["peak_leg_excursion"]
    travel, per_unit = travel_unit(row)
    numbers = (
        written(scale * row.metrics["peak_leg_force"]),
        "<1" if excursion < 1e-9 else written(per_unit * excursion),
    )
    return [f"{text} {unit}" if with_unit else text for text, unit in zip(numbers, (effort, travel), strict=True)]


def travel_unit(row: hs.ComparisonRow) -> tuple[str, float]:
    """The unit in which a row alone shows its travel, and how many of it make one of the metric's."""
    excursion = row.metrics["peak_leg_excursion"]
    prefix, scale = ("m", 1e3) if excursion >= 1e-3 else ("u", 1e6) if excursion >= 1e-6 else ("n", 1e9)
    return f"{prefix}{UNITS[row.scenario.name][2]}", scale


@pytest.mark.parametrize("names", [[CRANKS], [LEGS], [CRANKS, LEGS]])
def test_units_follow_the_legs(names: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """One unit in the head; of machines of both kinds, a unit beside each number."""
    from hexservo.cli import terminal

    comparison = hs.compare(names, ["pbvs"], {"simulation.duration": 0.4})
    mixed = len(names) > 1
    heads = ["leg force, crank torque", "stroke"]
    if not mixed:
        of_efforts = "crank torque" if names == [CRANKS] else "leg force"
        heads = [f"{of_efforts} [{UNITS[names[0]][0]}]", f"stroke [{travel_unit(comparison.rows[0])[0]}]"]
    first, _, *lines = (line.split(" | ") for line in comparison.to_markdown().splitlines())
    places = [first.index(head) for head in heads]
    for cells, row in zip(lines, comparison.rows, strict=True):
        assert [cells[place].rstrip("!") for place in places] == shown_legs(row, with_unit=mixed)
    page = comparison._repr_html_()
    for row in comparison.rows:
        assert all(f">{html.escape(text)}" in page for text in shown_legs(row, with_unit=mixed))

    rows = list(csv.DictReader(io.StringIO(comparison.to_csv())))
    for text, row in zip(rows, comparison.rows, strict=True):
        for name in ("peak_leg_force", "peak_leg_excursion", "peak_displacement"):
            unit = metric_unit(name, row.scenario.robot)
            of_legs = mixed and name.startswith("peak_leg")
            assert float(text[name] if of_legs else text[f"{name} [{unit}]"]) == row.metrics[name]
            assert not of_legs or text[f"{name} unit"] == unit
    table = comparison.to_dataframe()
    for name in ("peak_leg_force", "peak_leg_excursion", "peak_displacement"):
        units = [metric_unit(name, row.scenario.robot) for row in comparison.rows]
        of_legs = mixed and name.startswith("peak_leg")
        assert table.attrs["units"].get(name) == (None if of_legs else units[0])
        assert (f"{name} unit" in table) == of_legs
        assert not of_legs or table[f"{name} unit"].tolist() == units

    for width in (30, 10_000):
        monkeypatch.setattr(terminal, "width", lambda width=width: width)
        arguments = ["compare", "--scenarios", ",".join(names), "--laws", "pbvs", "--set", "simulation.duration=0.4"]
        shown = " ".join(CliRunner().invoke(app, arguments).stdout.replace("!", "").split())
        for row in comparison.rows:
            assert all(text in shown for text in shown_legs(row, with_unit=mixed or width == 30))
        assert ("[mN m]" in shown) == (width > 30 and names == [CRANKS])


def test_the_figure_shows_every_run(comparison: hs.Comparison) -> None:
    figure = comparison.figure()
    figure.canvas.draw()
    panels = {axes.get_title(loc="left"): axes for axes in figure.axes}
    for scenario in comparison.scenarios:
        drawn = {line.get_gid() for line in panels[scenario.name].lines}
        assert {f"error {law}" for law in comparison.laws} <= drawn
    cells = [text.get_text() for text in panels["Settling time [s]"].texts]
    assert cells == ["0.353", "0.551", "never!", "0.552", "0.499", "0.781"]
    assert len({line.get_gid() for line in panels["Residual"].lines} - {None}) >= len(comparison.rows)
    line = next(line for line in panels["paper"].lines if line.get_gid() == "error hybrid")
    row = comparison.row("hybrid", "paper")
    drawn_errors = np.asarray(line.get_ydata())
    assert drawn_errors[-1] == row.error[-1]
    assert drawn_errors.max() == row.error[row.time >= 0.01].max()


def test_a_curve_of_few_points_keeps_its_peaks() -> None:
    """Of 20000 samples, of which 300 are drawn: one that is ten times as large as the others about it."""
    time, error = np.linspace(0.0, 10.0, 20_001), np.ones(20_001)
    error[13_337], error[-1] = 10.0, 0.5
    drawn, values = _thinned(time, error, 1e-2, 10.0)
    assert len(drawn) < 310
    assert values.max() == 10.0
    assert drawn[values.argmax()] == time[13_337]
    assert (drawn[-1], values[-1]) == (10.0, 0.5)


def test_names_are_drawn_as_they_are_written(paper: hs.Scenario) -> None:
    r"""Two dollar signs make no formula of them, which need not be one: \q is an error."""
    names = [r"costs $\q$", r"one $ and \$ one", "plain"]
    scenario = paper.updated({"simulation.mode": "sampled", "simulation.duration": 0.01})
    compared = hs.compare([scenario], [], controllers=dict.fromkeys(names, lambda seen: np.zeros(6)))
    figure = compared.figure()
    FigureCanvasAgg(figure).draw()  # type: ignore[no-untyped-call]
    texts: list[Any] = figure.findobj(Text)
    drawn = {text._preprocess_math(text.get_text()) for text in texts}
    assert {(name, False) for name in names} <= drawn
    assert all(text.startswith("$10^") for text, is_formula in drawn if is_formula)


def test_the_end_of_a_run_is_marked_unlike_every_law() -> None:
    compared = hs.compare(["fails-late-camera", "pi-h824-positions"], None, {"simulation.duration": 0.2})
    early = {row.law for row in compared.rows[:7] if len(row.time) and row.outcome != "completed"}
    assert 0 < len(early) < len(compared.laws) == 7
    figure = compared.figure()
    lines = {str(line.get_gid()): line for line in figure.axes[0].lines}
    looks = [(lines[f"error {law}"].get_color(), lines[f"error {law}"].get_marker()) for law in compared.laws[:-1]]
    (legend,) = figure.legends
    laws, marks = [text.get_text() for text in legend.get_texts()], legend.get_lines()
    assert laws == [*compared.laws, "ended early"]  # tracking is refused, and has no line
    assert len({mark.get_color() for mark in marks[:-1]}) == len({mark.get_marker() for mark in marks[:-1]}) == 7
    assert looks == [(mark.get_color(), mark.get_marker()) for mark in marks[:-2]]
    assert not {mark.get_marker() for mark in marks} & {"X", "P", "+"}
    assert {gid.removeprefix("end ") for gid in lines if gid.startswith("end ")} == early
    for law in early:
        assert lines[f"end {law}"].get_marker() == marks[-1].get_marker() == "x"
        assert not lines[f"end {law}"].get_clip_on()  # it is at the border, where half of it would be missing
        assert lines[f"end {law}"].get_color() == lines[f"error {law}"].get_color()
        assert np.asarray(lines[f"end {law}"].get_xdata())[0] == np.asarray(lines[f"error {law}"].get_xdata())[-1]
    completed = hs.compare(["paper"], ["hybrid"], {"simulation.duration": 0.02}).figure()
    assert [text.get_text() for text in completed.legends[0].get_texts()] == ["hybrid"]


def test_words_of_the_settling_times_are_inside_of_their_cells() -> None:
    figure = hs.compare(["fails-late-camera"], None, {"simulation.duration": 0.2}).figure()
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    (table,) = [axes for axes in figure.axes if axes.patches and axes.texts]
    assert "diverged!" in [text.get_text() for text in table.texts]
    for text, cell in zip(table.texts, table.patches, strict=True):
        inside, outside = text.get_window_extent(canvas.get_renderer()), cell.get_window_extent()
        assert outside.x0 <= inside.x0 < inside.x1 <= outside.x1, text.get_text()


@pytest.mark.slow
def test_no_texts_of_the_figure_overlap() -> None:
    """Neither words of the table, titles and labels of neighbours, nor ticks, with all scenarios that are packaged."""
    assert_texts_can_be_read(hs.compare(list(hs.scenario_names()), None, {"simulation.duration": 0.02}).figure())


def test_many_laws_with_long_names_and_the_footnote_have_room(paper: hs.Scenario) -> None:
    scenario = paper.updated({"simulation.duration": 0.02, "robot.stroke": 1e-5, "metrics.band": 1e-4})
    long = {f"c{number}_{'of_my_own_' * 6}": lambda seen: np.zeros(6) for number in range(4)}
    compared = hs.compare([scenario], ["hybrid", "composite", "kelly", "pbvs", "resolved_rate"], controllers=long)
    figure = compared.figure()
    assert_texts_can_be_read(figure)
    (footnote,) = figure.texts
    assert "!: a leg exceeded a limit, see the table." in footnote.get_text()


def assert_texts_can_be_read(figure: Figure) -> None:
    """All are on the page, and none lies over another."""
    boxes = []
    canvas = FigureCanvasAgg(figure)  # one renderer for all texts, not one for each: the figure is large
    with our_style():
        canvas.draw()  # type: ignore[no-untyped-call]
        renderer = canvas.get_renderer()  # type: ignore[no-untyped-call]
        (legend,) = figure.legends
        of_page = [*figure.texts, *legend.get_texts(), legend.get_title()]
        boxes += [(text.get_text(), text.get_window_extent(renderer)) for text in of_page]
        for axes in figure.axes:
            texts = [*axes.texts, axes.xaxis.label, axes.yaxis.label, axes._left_title]  # type: ignore[attr-defined]
            for axis in (axes.xaxis, axes.yaxis):
                low, high = sorted(axis.get_view_interval())
                ticks = axis.get_major_ticks()
                texts += [tick.label1 for tick in ticks if low <= tick.get_loc() <= high]  # others are not drawn
            slanted = [text for text in texts if text.get_rotation() % 90 != 0]
            for text in slanted:
                box = text.get_window_extent(renderer)
                assert box.x0 >= 0, text
                assert not any(box.overlaps(other.get_window_extent(renderer)) for other in of_page), text
            for first, second in pairwise(slanted):  # their boxes overlap, lines of text at one angle need not
                assert first.get_rotation() == second.get_rotation()
                apart = second.get_transform().transform(second.get_position())
                apart = apart - first.get_transform().transform(first.get_position())
                across = abs(apart[0] * math.sin(math.radians(first.get_rotation())))
                assert across > first.get_fontsize() / 72 * figure.dpi, (first.get_text(), second.get_text())
            boxes += [
                (t.get_text(), t.get_window_extent(renderer))
                for t in texts
                if t.get_text() and t.get_visible() and t not in slanted
            ]
    width, height = figure.bbox.size
    for number, (text, box) in enumerate(boxes):
        assert box.x0 >= 0, text
        assert box.y0 >= 0, text
        assert box.x1 <= width, text
        assert box.y1 <= height, text
        for other_text, other in boxes[number + 1 :]:
            assert not box.overlaps(other), (text, other_text)


# ---- The command ----------------------------------------------------------------------------------------------------


def invoke(*arguments: str) -> Any:
    return CliRunner().invoke(app, ["compare", *arguments])


QUICK = ("--set", "simulation.duration=0.05")


def test_the_command_prints_and_writes(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "out"
    run = invoke("--scenarios", "paper,paper-m*", "--laws", "hybrid, composite", *QUICK, "--out", str(folder))
    assert run.exit_code == 0, run.output
    assert {path.name for path in folder.iterdir()} == {
        MARKER,
        "comparison.md",
        "comparison.csv",
        "comparison.svg",
        "comparison.png",
        "paper.yaml",
        "paper-minus.yaml",
    }
    for head in ("settles", "residual", "chatter"):
        assert head in run.stdout
    assert "paper, hybrid: not settled" in run.stdout
    assert hs.load_scenario(folder / "paper.yaml").simulation.duration == 0.05
    again = invoke("--scenarios", "paper", "--laws", "hybrid", *QUICK, "--out", str(folder))
    assert again.exit_code == 2
    assert "holds results already" in again.stderr
    assert invoke("--scenarios", "paper", "--laws", "hybrid", *QUICK, "--out", str(folder), "--force").exit_code == 0
    assert not (folder / "paper-minus.yaml").exists()


def test_all_laws_are_the_default(monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = []
    whole = hs.compare

    def watched(scenarios: Any, laws: Any, **more: Any) -> hs.Comparison:
        chosen.append(laws)
        return whole(scenarios, ["hybrid"], **more)

    monkeypatch.setattr(hs, "compare", watched)
    assert invoke("--scenarios", "paper", *QUICK).exit_code == 0
    assert invoke("--scenarios", "paper", "--laws", "all", *QUICK).exit_code == 0
    assert chosen == [None, None]
    shown = " ".join(invoke("--help").stdout.split())
    assert "[default: all]" in shown


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--scenarios", "paper", "--laws", "pid"), "laws: expected some of"),
        (("--scenarios", "nothing-*"), "expected a pattern that matches one of"),
        (("--scenarios", ","), "expected names with commas between"),
        (("--scenarios", "paper", "--set", "uncertainty.depth=2"), "uncertainty.depth"),
        (("--scenarios", "paperr"), 'did you mean "paper"?'),
    ],
)
def test_bad_input_is_reported(arguments: tuple[str, ...], words: str) -> None:
    run = invoke(*arguments)
    assert run.exit_code == 2
    assert words in run.stderr
    assert run.stdout == ""


def test_ctrl_c_is_reported_and_finished_runs_are_written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def interrupted(*arguments: Any) -> hs.BatchResult:
        raise KeyboardInterrupt

    monkeypatch.setattr(compare, "simulate_batch", interrupted)
    run = invoke("--scenarios", "paper", "--laws", "hybrid", "--out", str(tmp_path / "out"))
    assert run.exit_code == 130
    assert "0 of 1 runs were finished" in run.stderr
    assert "\n0 of 1 run in " in run.stdout
    assert "interrupted" in (tmp_path / "out" / "comparison.md").read_text(encoding="utf-8")


def test_a_narrow_terminal_gets_two_tables() -> None:
    program = (
        "import sys, hexservo.cli.commands as cli; cli.terminal.width = lambda: 100; sys.argv[1:] = "
        "['compare', '--scenarios', 'paper', '--set', 'simulation.duration=0.01']; cli.main()"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout.count("scenario") >= 2
    assert max(map(len, run.stdout.splitlines()[:4])) <= 100


def test_residuals_below_what_is_drawn_are_marked() -> None:
    """Exact models settle to rounding with a law without switching, far below the axis of the residuals."""
    exact = hs.load_scenario("paper-nominal").updated({"simulation.duration": 3.0})
    found = hs.compare([exact], ["pbvs", "hybrid"])
    pbvs, hybrid = (found.row(law, exact.name).metrics["final_error"] for law in ("pbvs", "hybrid"))
    assert pbvs < 1e-3 < hybrid
    figure = found.figure()
    (mark,) = [text for axes in figure.axes for text in axes.texts if text.get_text() == "<"]
    lines = [line for axes in figure.axes for line in axes.lines]
    (drawn,) = [line for line in lines if str(line.get_gid()).startswith("final_error pbvs")]
    place = [np.asarray(drawn.get_xdata())[0], np.asarray(drawn.get_ydata())[0]]
    np.testing.assert_array_equal(np.asarray(vars(mark)["xy"]), place)
    assert place[0] == 1e-3
    assert "Errors below 0.001 px are drawn at that value, residuals with a <." in figure.texts[-1].get_text()
    above = hs.compare([exact.updated({"simulation.duration": 0.5})], ["hybrid"])
    assert "Errors below" not in "".join(text.get_text() for text in above.figure().texts)


def test_changes_are_read_before_the_goal_pose() -> None:
    changes = {"camera.focal_pixels": 900.0, "simulation.duration": 0.05}
    of_name = hs.compare(["pi-h824"], ["pbvs"], changes=changes)
    assert of_name.scenarios == (hs.load_scenario("pi-h824", changes),)
    of_scenario = hs.compare([hs.load_scenario("pi-h824")], ["pbvs"], changes=changes)
    assert of_scenario.scenarios == (hs.load_scenario("pi-h824").updated(changes),)
    assert of_name.scenarios != of_scenario.scenarios


def test_an_interrupted_comparison_leaves_earlier_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = ["compare", "--scenarios", "paper", "--laws", "hybrid", *QUICK, "--out", str(tmp_path / "out")]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    whole = hs.compare

    def interrupted(*given: Any, **more: Any) -> hs.Comparison:
        comparison = whole(*given, **more)
        return replace(comparison, rows=tuple(replace(row, outcome="interrupted") for row in comparison.rows))

    monkeypatch.setattr(hs, "compare", interrupted)
    found = CliRunner().invoke(app, [*arguments, "--force"])
    assert found.exit_code == 130
    assert found.stderr == (
        f"Interrupted: 0 of 1 runs were finished; the earlier results in {tmp_path / 'out'} are kept\n"
    )
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before


def test_a_change_that_one_of_several_scenarios_refuses_names_it(tmp_path: Path) -> None:
    words = "seed: has no effect in continuous mode"
    mine = tmp_path / "mine.yaml"
    mine.write_text(hs.load_scenario("paper").updated({"name": "other"}).to_yaml(), encoding="utf-8")
    for refuses in ("paper", str(mine)):
        run = invoke("--scenarios", f"composite-30hz,{refuses}", "--laws", "composite", "--set", "seed=3")
        assert run.exit_code == 2
        assert f"Error: {refuses}: --set: {words}" in " ".join(run.stderr.split())
    alone = invoke("--scenarios", "paper", "--set", "seed=3")
    assert f"Error: --set: {words}" in alone.stderr
    malformed = invoke("--scenarios", "composite-30hz,paper", "--set", "seed")
    assert "Error: --set: expected KEY=VALUE" in malformed.stderr
