"""Figures: what they show is what the run holds, they can be read, and they leave the user's matplotlib alone."""

from __future__ import annotations

import itertools
import math
import re
import subprocess
import sys
import threading
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo import plots as public
from hexservo.draw import plots
from hexservo.draw.panels import _spread
from hexservo.draw.paper_figures import paper_figures
from hexservo.draw.style import our_style
from hexservo.draw.wrench import control_wrench
from hexservo.report.figures import figures
from hexservo.run.files import MARKER
from hexservo.run.publish import OutputError
from hexservo.run.samples import (
    axis_range,
    image_views,
    initial_direction,
    parts,
    rotation_vectors,
    turns_from_home,
)
from hexservo.scenario.rotations import quaternions_of_matrices

Array = NDArray[np.float64]

NAMES = ["fig2a_rule_table", "fig2b_feature_errors", "fig3_feature_paths", "fig4_platform_motion", "fig5_wrench"]
TIME_FIGURES = [plots.feature_errors, plots.platform_motion, control_wrench]


def rule_table(result: hs.Result) -> Figure:
    return plots.rule_table(result.scenario)


ALL_FIGURES = [rule_table, plots.feature_paths, *TIME_FIGURES]
TERMS = ["NB", "NM", "NS", "ZE", "PS", "PM", "PB"]
SEED = 20260

RUNS: dict[str, dict[str, Any]] = {
    "paper": {},
    "slow": {"controller.hybrid.fuzzy.enabled": False, "simulation.duration": 10.0},
    "never settles": {"uncertainty.gravity": 0.075},
    "diverges": {"controller.jacobian": "printed"},
    "diverges at once": {"controller.hybrid.kp": 1e290},
    "smooth": {"controller.switching.kind": "tanh", "simulation.step": 5e-4, "simulation.duration": 1.0},
    "sparse": {"simulation.log_every": 50},
    "two samples": {"simulation.log_every": 5000},
    "one step": {"simulation.duration": 1e-3},
    "at the goal": {
        "target.desired_features": [30, 18, 65, -65, -44, 37, -10, -15],
        "controller.hybrid.kv": 0.0,
        "simulation.duration": 0.1,
    },
    "heavy": {"robot.mass": 1e6},
}


def run(**changes: Any) -> hs.Result:
    return hs.simulate(hs.load_scenario("paper").updated(changes))


@pytest.fixture(scope="module")
def paper() -> hs.Result:
    return run()


# Drawn as `paper` is, with other numbers; another test draws the first samples of a run.
ALIKE = ("slow", "smooth", "sparse", "two samples")


@pytest.fixture(
    scope="module",
    params=[pytest.param(name, marks=[pytest.mark.slow] if name in ALIKE else []) for name in RUNS],
)
def result(request: pytest.FixtureRequest) -> hs.Result:
    return run(**RUNS[request.param])


def first(result: hs.Result, count: int) -> hs.Result:
    """The first samples of a run."""
    arrays = [name for name, value in vars(result).items() if isinstance(value, np.ndarray) and name != "fuzzy_weights"]
    return replace(
        result, end_time=float(result.time[count - 1]), **{name: getattr(result, name)[:count] for name in arrays}
    )


def line(figure: Figure, name: str) -> Array:
    """The points (n, 2) of the line of that name, through all panels that show a part of it."""
    parts = [
        np.column_stack([np.asarray(drawn.get_xdata(), float), np.asarray(drawn.get_ydata(), float)])
        for axes in figure.axes
        for drawn in axes.lines
        if drawn.get_gid() == name
    ]
    assert parts, f"no line {name}"
    for before, after in itertools.pairwise(parts):
        np.testing.assert_array_equal(before[-1], after[0])  # panels share the sample at their border
    return np.concatenate([parts[0], *(part[1:] for part in parts[1:])])


def assert_shows(figure: Figure, names: list[str], time: Array, values: Array) -> None:
    """Every drawn point is a sample; all are drawn where they are few, else at least the extremes and both ends."""
    for name, column in zip(names, values.T, strict=True):
        points = line(figure, name)
        index = np.searchsorted(time, points[:, 0])
        np.testing.assert_array_equal(points[:, 0], time[index])
        np.testing.assert_array_equal(points[:, 1], column[index])
        assert np.all(np.diff(index) > 0)
        assert {0, len(time) - 1, int(column.argmin()), int(column.argmax())} <= set(index.tolist())
        if len(time) <= 1200:
            assert len(points) == len(time)


def render(figure: Figure) -> None:
    """Place everything as on a page of pixels; no test looks at the pixels, which take as long again."""
    FigureCanvasAgg(figure)
    figure.draw_without_rendering()


def labels(figure: Figure) -> set[str]:
    return {text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel()) if text}


# ---- Each figure shows the run --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [name for name in public.__all__ if name != "paper_figures"])
def test_anything_but_a_run_is_refused(name: str) -> None:
    expected = "scenario: expected a Scenario" if name == "rule_table" else "result: expected a Result"
    with pytest.raises(TypeError, match=f"{expected} .*, got NoneType"):
        getattr(public, name)(None)


@pytest.mark.parametrize(
    ("name", "argument"),
    [
        *((name, "ax") for name in ("rule_table", "feature_errors", "feature_paths")),
        *((name, "axes") for name in ("leg_limits", "platform_motion", "control_wrench")),
    ],
)
def test_anything_but_axes_is_refused(name: str, argument: str) -> None:
    of = run().scenario if name == "rule_table" else run()
    for wrong in (3, [3]):
        with pytest.raises(TypeError, match=rf"^{argument}: expected axes of matplotlib( or None)?, got (int|list)$"):
            getattr(public, name)(of, **{argument: wrong})


def test_rule_table_shows_terms_and_numbers() -> None:
    table: list[list[Any]] = [[TERMS[max(0, min(6, row + column - 3))] for column in range(7)] for row in range(7)]
    table[1][5] = 0.25
    table[6][0] = -3
    scenario = hs.load_scenario("paper").updated({"controller.hybrid.fuzzy.table": table})
    figure = plots.rule_table(scenario)
    axes, bar = figure.axes
    (image,) = axes.images
    numbers = [[TERMS.index(entry) / 3 - 1 if isinstance(entry, str) else entry for entry in row] for row in table]
    np.testing.assert_allclose(np.asarray(image.get_array()), numbers, rtol=0, atol=1e-15)
    assert image.get_clim() == (-3, 3)
    shown = {(round(text.get_position()[1]), round(text.get_position()[0])): text.get_text() for text in axes.texts}
    expected = {(row, column): str(table[row][column]) for row in range(7) for column in range(7)}
    assert shown == {**expected, (6, 0): "-3"}
    assert [tick.get_text() for tick in axes.get_xticklabels()] == TERMS
    assert [tick.get_text() for tick in axes.get_yticklabels()] == TERMS
    assert axes.get_ylim() == (6.5, -0.5)  # row NB above
    assert labels(figure) == {"rate of u [1]", "u, the scaled image wrench [1]", "output [1]"}
    assert bar.get_ylim() == (-3, 3)
    composite = plots.rule_table(scenario.updated({"controller.law": "composite"}))
    assert "u, the scaled pose error [1]" in labels(composite)
    assert np.asarray(composite.axes[0].images[0].get_array()).min() == -1  # the table of that law's block


def test_rule_table_has_symmetric_limits_of_at_least_one() -> None:
    scenario = hs.load_scenario("paper").updated({"controller.hybrid.fuzzy.table": np.full((7, 7), 0.1)})
    assert plots.rule_table(scenario).axes[0].images[0].get_clim() == (-1, 1)


def test_feature_errors_show_the_run(result: hs.Result) -> None:
    figure = plots.feature_errors(result)
    assert_shows(figure, ["x₁", "y₁", "x₂", "y₂", "x₃", "y₃", "x₄", "y₄"], result.time, result.feature_error)
    assert labels(figure) == {"time [s]", "feature error [px]"}


def test_feature_errors_magnify_what_remains(paper: hs.Result) -> None:
    approach, rest = plots.feature_errors(paper).axes
    settled = hs.metrics(paper)["settling_time"]
    assert f"{settled:.3g} s" in approach.get_title(loc="left")
    assert settled < approach.get_xlim()[1] == rest.get_xlim()[0]
    assert rest.get_xlim()[1] == paper.time[-1]
    assert max(map(abs, rest.get_ylim())) < 0.1 < 20 < min(map(abs, approach.get_ylim()))
    for axes in (approach, rest):
        (band,) = axes.patches
        extents = band.get_extents().transformed(axes.transData.inverted())
        np.testing.assert_allclose([extents.y0, extents.y1], [-2, 2], rtol=0, atol=1e-12)


def test_feature_paths_show_the_run(result: hs.Result) -> None:
    figure = plots.feature_paths(result)
    (axes,) = figure.axes
    goals = np.asarray(result.scenario.target.desired_features).reshape(4, 2)
    for number in range(1, 5):
        path = result.features[:, 2 * number - 2 : 2 * number]
        drawn = line(figure, f"path {number}")
        if len(path) <= 1200:
            np.testing.assert_array_equal(drawn, path)
        np.testing.assert_array_equal(drawn[[0, -1]], path[[0, -1]])
        np.testing.assert_array_equal([drawn.min(axis=0), drawn.max(axis=0)], [path.min(axis=0), path.max(axis=0)])
        np.testing.assert_array_equal(line(figure, f"start {number}"), path[:1])
        np.testing.assert_array_equal(line(figure, f"end {number}"), path[-1:])
        np.testing.assert_array_equal(line(figure, f"goal {number}"), goals[number - 1 : number])
        everything = np.concatenate([path, goals])
        for limits, low, high in zip(
            (axes.get_xlim(), axes.get_ylim()), everything.min(0), everything.max(0), strict=True
        ):
            assert limits[0] < low <= high < limits[1]
    assert labels(figure) == {"image x [px]", "image y [px]"}
    assert {text.get_text() for text in axes.texts} == {"1", "2", "3", "4"}


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("paper", {}),
        ("paper", {"controller.jacobian": "printed"}),
        ("textbook-half-turn", {}),
        ("rough-road", {"simulation.duration": 2.0}),
        ("eye-to-hand", {"simulation.duration": 2.0}),
        ("textbook-general", {}),
    ],
)
def test_feature_paths_have_equal_axes_and_arrows_along_the_initial_motion(name: str, changes: dict[str, Any]) -> None:
    """Within 12 degrees of the mean of what the feature moves until it is 3 % of half the axes away.

    The mean weighs the samples in between, where paths of noise or of a bent way have turned by up to 10 degrees.
    """
    result = hs.simulate(hs.load_scenario(name).updated(changes))
    axes = plots.feature_paths(result).axes[-1]
    render(axes.figure)  # type: ignore[arg-type]
    origin, right, up = axes.transData.transform([(0, 0), (1, 0), (0, 1)])
    assert right[0] - origin[0] == pytest.approx(up[1] - origin[1], rel=1e-9)
    arrows = [drawn for drawn in axes.lines if str(drawn.get_gid()).startswith("direction")]
    assert len(arrows) == 4
    near = 0.03 * min(np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())) / 2
    for number, arrow in enumerate(arrows):
        away = result.features[:, 2 * number : 2 * number + 2] - result.features[0, 2 * number : 2 * number + 2]
        motion = away[1 : 1 + np.argmax(np.hypot(*away.T) >= near)].mean(axis=0)
        tip = vars(arrow)["_marker"].get_user_transform().transform((1, 0))
        head = arrow.get_transform().transform(arrow.get_xydata())[0] - axes.transData.transform(
            result.features[0, 2 * number : 2 * number + 2]
        )
        for drawn in (tip, head):
            assert drawn @ motion > np.cos(np.radians(12)) * np.hypot(*drawn) * np.hypot(*motion)
        if name == "textbook-half-turn":  # every feature moves towards the centre, and back
            np.testing.assert_allclose(np.abs(tip), np.hypot(*tip) / np.sqrt(2), rtol=1e-3)
            assert (np.sign(tip) == -np.sign(result.features[0, 2 * number : 2 * number + 2])).all()


def test_the_initial_direction_is_that_before_any_reversal() -> None:
    there_and_back = np.concatenate([np.linspace(0, 4, 41), np.linspace(4, -30, 341)])[:, None] * [0.6, 0.8]
    start = np.array([10.0, -20.0])
    for reach, expected in ((3.0, (0.6, 0.8)), (5.0, (-0.6, -0.8))):
        assert initial_direction(start + there_and_back, reach) == pytest.approx(expected, rel=1e-12)
    assert initial_direction(start + there_and_back, 31.0) is None
    assert initial_direction(start[None], 1e-9) is None


def test_platform_motion_shows_the_run(result: hs.Result) -> None:
    figure = plots.platform_motion(result)
    home = np.asarray(result.scenario.robot.home_position)
    assert_shows(figure, ["x", "y", "z"], result.time, 1e3 * (result.position - home))
    turns = np.column_stack([line(figure, name)[[0, -1], 1] for name in ("θx", "θy", "θz")]) / 1e3
    np.testing.assert_allclose(
        [rotation_matrix(turn) for turn in turns],
        [matrix_of_quaternion(quaternion) for quaternion in result.quaternion[[0, -1]]],
        rtol=0,
        atol=1e-12,
    )
    assert labels(figure) == {"time [s]", "displacement [mm]", "rotation vector [mrad]"}


def test_control_wrench_shows_the_run(result: hs.Result) -> None:
    figure = control_wrench(result)
    assert_shows(figure, ["fx", "fy", "fz"], result.time, result.wrench[:, :3])
    unit, scale = ("N m", 1.0) if np.abs(result.wrench[:, 3:]).max() >= 1.0 else ("mN m", 1e3)
    assert_shows(figure, ["mx", "my", "mz"], result.time, scale * result.wrench[:, 3:])
    assert_shows(figure, [f"leg {leg}" for leg in range(1, 7)], result.time, result.leg_forces)
    assert labels(figure) == {"time [s]", "force [N]", f"moment [{unit}]", "leg force [N]"}
    weights = [drawn for axes in figure.axes for drawn in axes.lines if drawn.get_gid() == "weight"]
    assert weights
    for drawn in weights:
        np.testing.assert_allclose(np.asarray(drawn.get_ydata()), -9.8 * result.scenario.robot.mass, rtol=1e-15)


@pytest.mark.parametrize("gravity", [[0, 0, 9.8], [0, 0, -9.8], [9.8, 0, 0], [3.0, -1e-17, 9.3], [0, 0, 0]])
def test_the_weight_is_a_line_along_each_axis_that_has_a_part_of_it(gravity: list[float]) -> None:
    """Where gravity is not along z no axis is called vertical (a machine on a wall, or tilted)."""
    changes = {"simulation.duration": 0.3, "robot.gravity": gravity, "robot.force_limit": 0.2}
    result = run(**changes)
    figure = control_wrench(result)
    assert_texts_can_be_read(figure)
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    displacement = plots.platform_motion(result).axes[0].get_title(loc="left")
    upright = not any(abs(part) > 1 for part in gravity[:2]) and gravity[2] != 0
    if upright:
        points = f"(z points {'down' if gravity[2] > 0 else 'up'})"
        assert titles[:2] == ["Horizontal force, in B", f"Vertical force, in B {points}"]
        assert displacement == f"Position relative to home, in B {points}"
    else:
        assert titles[:2] == ["Force along x and y, in B", "Force along z, in B"]
        assert displacement == "Position relative to home, in B"
    mass = result.scenario.robot.mass
    for axes, axis_parts in zip(figure.axes, (gravity[:2], gravity[2:]), strict=False):
        levels = [drawn for drawn in axes.lines if drawn.get_gid() == "weight"]
        drawn_at = [float(np.asarray(level.get_ydata())[0]) for level in levels]
        assert drawn_at == pytest.approx([-mass * part for part in axis_parts if abs(part) > 1])
    (limit,) = [text for text in figure.legends[0].get_texts() if "limit" in text.get_text()]
    assert limit.get_text() == "limit: 0.2 N"
    assert "limit" in [text.get_text() for axes in figure.axes for text in axes.texts]


@pytest.mark.parametrize(
    ("name", "what"), [("reachy-mini", "What the motion takes"), ("reachy-mini-motors", "What the legs give")]
)
def test_machines_that_take_positions_have_no_wrench_of_a_law(name: str, what: str) -> None:
    result = hs.simulate(hs.load_scenario(name).updated({"simulation.duration": 0.1}))
    figure = control_wrench(result)
    assert_texts_can_be_read(figure)
    assert [text.get_text() for text in figure.texts] == [
        f"{what}: the wrench as the mean of each tick, leg forces just after its command"
    ]


def test_control_wrench_says_what_it_averages_over(paper: hs.Result) -> None:
    figure = control_wrench(paper)
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["samples", "mean over 7 ms"]
    for name, column in (("fy", paper.wrench[:, 1]), ("leg 4", paper.leg_forces[:, 3])):
        points = line(figure, f"mean {name}")
        index = np.searchsorted(paper.time, points[:, 0])
        expected = [column[max(0, centre - 3) : centre + 4].mean() for centre in index]
        np.testing.assert_allclose(points[:, 1], expected, rtol=0, atol=1e-12 * np.abs(column).sum())


def test_short_runs_are_not_averaged() -> None:
    figure = control_wrench(run(**{"controller.jacobian": "printed"}))
    shown = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert shown == ["limit: 1 N"]
    assert not [drawn for axes in figure.axes for drawn in axes.lines if str(drawn.get_gid()).startswith("mean")]


def test_a_long_run_is_thinned_without_loss_of_peaks() -> None:
    result = run(**{"simulation.duration": 40.0})
    wrench = result.wrench.copy()
    wrench[23456, 0] = 0.9  # one sample among forty thousand
    wrench[34567, 4] = -0.7
    result = replace(result, wrench=wrench)
    figure = control_wrench(result)
    assert line(figure, "fx")[:, 1].max() == 0.9
    assert line(figure, "my")[:, 1].min() == -700
    assert_shows(figure, ["fx", "fy", "fz"], result.time, wrench[:, :3])
    assert max(len(np.asarray(drawn.get_xdata())) for axes in figure.axes for drawn in axes.lines) <= 1202


@pytest.mark.parametrize("draw", ALL_FIGURES[1:])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_the_first_samples_can_be_drawn(draw: Callable[[hs.Result], Figure], count: int, paper: hs.Result) -> None:
    figure = draw(first(paper, count))
    render(figure)
    assert labels(figure)


def test_numbers_of_many_points_keep_apart() -> None:
    """Of 16 points whose starts lie on the goals of others: beside the marks, as in the run from start to goal."""
    grid = [[0.5 + 0.16 * (i - 1.5), 0.16 * (j - 1.5), -4.728] for i in range(4) for j in range(4)]
    goal = {"target.tag": None, "target.desired_features": None, "target.points": grid}
    pose = {"target.desired_pose": [0.08, 0.03, 0.04, 0.02, -0.02, 0.08], "simulation.duration": 2.0}
    run = hs.simulate(hs.load_scenario("moog-6dof2000e", {**goal, **pose, "metrics.rms_start": 0.0}))
    figure = plots.feature_paths(run)
    figure.canvas.draw()
    axes = figure.axes[-1]
    boxes = [text.get_window_extent().get_points() for text in axes.texts]
    assert [text.get_text() for text in axes.texts] == [str(number) for number in range(1, 17)]
    marks = axes.transData.transform(
        np.concatenate(
            [line(figure, f"{name} {number}") for name in ("start", "end", "goal") for number in range(1, 17)]
        )
    )
    radius = 2.5 * figure.dpi / 72.0  # of the marks of starts
    for box, other in itertools.combinations(boxes, 2):
        assert (box[0] > other[1]).any() or (other[0] > box[1]).any()
    for low, high in boxes:
        assert not ((marks > low - radius) & (marks < high + radius)).all(axis=1).any()


def test_numbers_of_points_stay_within_the_axes() -> None:
    """Of a machine whose points end beside the edge of the magnified view."""
    figure = plots.feature_paths(hs.simulate(hs.load_scenario("eye-to-hand").updated({"simulation.duration": 2.0})))
    figure.canvas.draw()
    axes = figure.axes[-1]
    assert len(axes.texts) == 4
    halo = 0.4 * figure.dpi / 72.0
    for text in axes.texts:
        low, high = text.get_window_extent().get_points()
        assert (axes.bbox.min < low - halo).all()
        assert (high + halo < axes.bbox.max).all()


@pytest.mark.parametrize("draw", [plots.feature_paths, *TIME_FIGURES])
def test_a_run_that_did_not_complete_says_so(draw: Callable[[hs.Result], Figure], paper: hs.Result) -> None:
    diverged = run(**{"controller.jacobian": "printed"})
    assert [text.get_text() for text in draw(diverged).texts] == ["diverged after 0.041 s"]
    assert not draw(paper).texts


# ---- Into axes of the caller ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "result",
    [pytest.param(name, marks=[] if name in ("paper", "diverges") else pytest.mark.slow) for name in RUNS],
    indirect=True,
)
def test_figures_are_drawn_into_axes_of_the_caller(result: hs.Result) -> None:
    """With the same samples as in separate figures, the caller's axes returned, and nothing else added."""
    home = np.asarray(result.scenario.robot.home_position)
    figure = Figure(figsize=(9, 12), layout="constrained")
    (errors, paths), (upper, lower), (first, second), (third, fourth) = figure.subplots(4, 2)
    assert plots.feature_errors(result, ax=errors) is errors
    assert plots.feature_paths(result, ax=paths) is paths
    assert plots.platform_motion(result, axes=[upper, lower]) == (upper, lower)
    four = np.array([[first, second], [third, fourth]])
    assert control_wrench(result, axes=four) == (first, second, third, fourth)
    render(figure)
    assert len(figure.axes) == 8
    assert_shows(figure, ["x₁", "y₁", "x₂", "y₂", "x₃", "y₃", "x₄", "y₄"], result.time, result.feature_error)
    assert_shows(figure, ["x", "y", "z"], result.time, 1e3 * (result.position - home))
    assert_shows(figure, ["fx", "fy", "fz"], result.time, result.wrench[:, :3])
    unit, scale = ("N m", 1.0) if np.abs(result.wrench[:, 3:]).max() >= 1.0 else ("mN m", 1e3)
    assert_shows(figure, ["mx", "my", "mz"], result.time, scale * result.wrench[:, 3:])
    assert_shows(figure, [f"leg {leg}" for leg in range(1, 7)], result.time, result.leg_forces)
    assert [axes.get_ylabel() for axes in figure.axes] == [
        "feature error [px]", "image y [px]", "displacement [mm]", "rotation vector [mrad]",
        "force [N]", "force [N]", f"moment [{unit}]", "leg force [N]",
    ]  # fmt: skip
    for axes in figure.axes:
        legend = axes.get_legend()
        assert legend is not None
        assert 1 <= len(legend.get_texts()) <= 8
    ended = [text.get_text() for axes in figure.axes for text in axes.texts if text.get_text().startswith("diverged")]
    assert len(ended) == (4 if result.outcome == "diverged" else 0)


def test_the_rule_table_is_drawn_into_axes_of_the_caller(paper: hs.Result) -> None:
    figure = Figure(layout="constrained")
    ax, other = figure.subplots(1, 2)
    assert plots.rule_table(paper.scenario, ax=ax) is ax
    render(figure)
    assert np.asarray(ax.images[0].get_array()).shape == (7, 7)
    assert len(figure.axes) == 3  # with the colour bar
    assert not other.has_data()


def test_the_style_of_the_caller_holds_in_their_axes(paper: hs.Result) -> None:
    with matplotlib.rc_context({"lines.linewidth": 3.25, "axes.titlesize": 21}):
        ax = Figure().subplots()
        plots.feature_errors(paper, ax=ax)
    assert {drawn.get_linewidth() for drawn in ax.lines if drawn.get_gid() in ("x₁", "y₄")} == {3.25}
    assert ax.title.get_fontsize() == 21


@pytest.mark.parametrize(("draw", "count"), [(plots.platform_motion, 2), (control_wrench, 4)])
def test_another_number_of_axes_is_refused(draw: Any, count: int, paper: hs.Result) -> None:
    with pytest.raises(ValueError, match=f"axes: expected {count} axes, got 3"):
        draw(paper, axes=Figure().subplots(3, 1))


# ---- The border of the image ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [(640, 480), (200, 300), (150, 150)])
def test_axes_of_an_image_have_its_shape_and_its_border(size: tuple[int, int]) -> None:
    result = run(**{"camera.image_size": list(size), "simulation.mode": "sampled", "simulation.duration": 0.3})
    for axes in (plots.feature_paths(result).axes[0], plots.feature_paths(result, ax=Figure().subplots())):
        render(axes.figure)  # type: ignore[arg-type]
        box = axes.get_window_extent()
        assert box.width / box.height == pytest.approx(size[0] / size[1], rel=1e-6)
        (border,) = [patch for patch in axes.patches if patch.get_gid() == "border"]
        extents = border.get_extents().transformed(axes.transData.inverted())
        np.testing.assert_allclose(
            [extents.x0, extents.x1, extents.y0, extents.y1],
            [-size[0] / 2, size[0] / 2, -size[1] / 2, size[1] / 2],
            rtol=1e-9,
        )
        assert axes.get_xlim()[0] <= -size[0] / 2 <= size[0] / 2 <= axes.get_xlim()[1]


def test_paths_in_a_small_part_of_the_image_are_magnified_beside_it() -> None:
    changes = {"camera.image_size": [1280, 960], "simulation.mode": "sampled", "simulation.duration": 0.3}
    result = run(**changes)
    whole, magnified = plots.feature_paths(result).axes
    assert magnified.get_title(loc="left") == "Magnified"
    assert np.ptp(magnified.get_xlim()) < 0.4 * np.ptp(whole.get_xlim())
    assert np.ptp(magnified.get_xlim()) / np.ptp(magnified.get_ylim()) == pytest.approx(1280 / 960)
    for axes in (whole, magnified):
        for corner, (low, high) in enumerate((axes.get_xlim(), axes.get_ylim())):
            assert low < result.features.reshape(-1, 4, 2)[..., corner].min()
            assert result.features.reshape(-1, 4, 2)[..., corner].max() < high


def test_axes_have_a_margin_around_all_values() -> None:
    for values in (np.array([-3.0, 5.0]), np.array([7.0]), np.array([0.0, 1e-9])):
        low, high = axis_range(values)
        assert low < values.min()
        assert values.max() < high


@pytest.mark.parametrize(("settled", "split"), [(0.1, 0.2), (0.3, 0.6), (0.6, 0.8), (0.9, 0.95), (math.nan, None)])
def test_a_run_is_split_where_it_has_rested_as_long_again_or_half_of_what_is_left(
    paper: hs.Result, settled: float, split: float | None
) -> None:
    """Of 1 s; both parts have the sample of the split, rounded to a digit where that is after it has settled."""
    run = first(paper, 1001)
    found = parts(replace(run, streamed_metrics={**run.streamed_metrics, "settling_time": settled}))
    if split is None:
        assert found == [slice(0, 1001)]
    else:
        (before, after) = found
        assert (before.start, before.stop - 1, after.stop) == (0, after.start, 1001)
        assert run.time[after.start] == pytest.approx(split, abs=0.051)
        assert settled < run.time[after.start] < 1.0


def test_a_turn_from_a_home_that_is_turned_is_in_b() -> None:
    home, turn = [0.02, -0.03, 0.3], np.array([0.4, 0.0, 0.0])
    result = run(**{"robot.home_attitude": home, "simulation.duration": 0.01})
    attitude = (Rotation.from_rotvec(turn) * Rotation.from_rotvec(home)).as_quat()[None, [3, 0, 1, 2]]
    np.testing.assert_allclose(turns_from_home(result, attitude), turn[None], atol=1e-15)


def test_a_magnified_view_has_the_whole_of_narrow_paths() -> None:
    changes = {"camera.image_size": [900, 900], "simulation.mode": "sampled", "simulation.duration": 0.3}
    corners = np.array([[30, 5], [30, -5], [-30, -5], [-30, 5]])
    target = {
        "target.initial_features": corners.ravel(),
        "target.desired_features": (corners + np.array([2, 0])).ravel(),
    }
    result = run(**changes, **target)
    _, magnified = image_views(result)
    places = result.features.reshape(-1, 2)
    assert (np.array(magnified.limits)[:, 0] < places.min(axis=0)).all()
    assert (places.max(axis=0) < np.array(magnified.limits)[:, 1]).all()


def test_paths_that_leave_the_image_stay_within_the_axes() -> None:
    result = run(**{"camera.image_size": [140, 160], "simulation.mode": "sampled", "controller.jacobian": "printed"})
    (axes,) = plots.feature_paths(result).axes
    assert np.abs(result.features).max() > 80
    assert axes.get_xlim()[1] > np.abs(result.features[:, ::2]).max()
    assert axes.get_ylim()[1] > np.abs(result.features[:, 1::2]).max()
    assert axes.get_xlim()[1] / axes.get_ylim()[1] == pytest.approx(140 / 160)


# ---- Figures can be read --------------------------------------------------------------------------------------------


def texts(figure: Figure) -> list[Text]:
    """All text that is seen."""
    found: list[Text] = figure.findobj(lambda artist: isinstance(artist, Text))  # type: ignore[assignment]
    hidden = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            for tick in axis.get_major_ticks():
                if not low <= float(tick.get_loc()) <= high:
                    hidden |= {id(tick.label1), id(tick.label2)}
    return [text for text in found if text.get_visible() and text.get_text().strip() and id(text) not in hidden]


def test_text_of_the_rule_table_is_whole(paper: hs.Result) -> None:
    """It is drawn of the scenario, and so alike for all runs."""
    assert_texts_can_be_read(rule_table(paper))


@pytest.mark.parametrize("draw", ALL_FIGURES[1:])
def test_text_is_whole_and_does_not_overlap(draw: Callable[[hs.Result], Figure], result: hs.Result) -> None:
    # Numbers of paths that end close together may touch.
    assert_texts_can_be_read(draw(result), may_touch=draw is plots.feature_paths and result.outcome == "diverged")


def assert_texts_can_be_read(figure: Figure, *, may_touch: bool = False) -> None:
    """All texts, those of the figure and its legends among them, are on the page and none lies over another."""
    render(figure)
    boxes = [(text.get_text(), text.get_window_extent()) for text in texts(figure)]
    assert len(boxes) > 10
    page = figure.bbox
    for text, box in boxes:
        assert page.x0 <= box.x0 <= box.x1 <= page.x1, text
        assert page.y0 <= box.y0 <= box.y1 <= page.y1, text
    if may_touch:
        return
    for (one, a), (other, b) in itertools.combinations(boxes, 2):
        across, up = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
        # A box has the height of a line, 20 dots and more; letters leave a fifth of it free.
        assert across <= 0 or up <= 4, f"{one} and {other} overlap by {across:.0f} x {up:.0f} dots"


@pytest.mark.parametrize("draw", ALL_FIGURES)
def test_text_is_large_enough_for_print(draw: Callable[[hs.Result], Figure], paper: hs.Result) -> None:
    figure = draw(paper)
    assert min(float(text.get_fontsize()) for text in texts(figure)) >= 7
    assert figure.get_size_inches()[0] in (3.5, 7.16)


@pytest.mark.parametrize(
    ("draw", "axes_names"),
    [
        (plots.platform_motion, [["x", "y", "z"], ["θx", "θy", "θz"]]),
        (control_wrench, [["mx", "my", "mz"]]),
    ],
)
def test_lines_differ_in_colour_and_dashes(draw: Callable[[hs.Result], Figure], axes_names: list[list[str]]) -> None:
    figure = draw(run(**{"simulation.log_every": 50}))  # no means: the samples carry the dashes
    for names in axes_names:
        drawn = {
            str(curve.get_gid()): curve for axes in figure.axes for curve in axes.lines if curve.get_gid() in names
        }
        assert len({str(curve.get_color()) for curve in drawn.values()}) == len(names)
        assert len({str(vars(curve)["_unscaled_dash_pattern"]) for curve in drawn.values()}) == len(names)


def test_lines_of_many_points_differ_and_the_worst_are_named() -> None:
    points = [[0.5 + 0.16 * (i - 1.5), 0.16 * (j - 1.5), -4.728] for i in range(4) for j in range(4)]
    changes = {"target.tag": None, "target.desired_features": None, "target.points": points}
    pose = {"target.desired_pose": [0.08, 0.03, 0.04, 0.02, -0.02, 0.08], "simulation.duration": 0.1}
    result = hs.simulate(hs.load_scenario("moog-6dof2000e", {**changes, **pose}))
    figure = plots.feature_errors(result)
    render(figure)
    (axes,) = figure.axes
    curves = [drawn for drawn in axes.lines if str(drawn.get_gid())[0] in "xy"]
    looks = {(str(drawn.get_color()), str(vars(drawn)["_unscaled_dash_pattern"])) for drawn in curves}
    assert len(looks) == len(curves) == 32
    worst = np.argsort(-np.abs(result.feature_error[-1]))[:2]
    assert {text.get_text() for text in axes.texts} == {str(curves[line].get_gid()) for line in worst}
    assert_texts_can_be_read(figure)
    (chart,) = dict(figures(result))["Feature errors"]
    drawn = re.findall(r'"line": ?({[^}]*"dash"[^}]*})', str(chart))
    assert len(set(drawn)) == 32


# ---- The rotation vector --------------------------------------------------------------------------------------------


def matrix_of_quaternion(quaternion: Array) -> Array:
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def rotation_matrix(vector: Array) -> Array:
    """Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def quaternion_of(axis: Array, angle: float) -> Array:
    return np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis)])


AXIS = np.array([2.0, -3.0, 6.0]) / 7


@pytest.mark.parametrize("angle", [0.0, 1e-200, 1e-16, 1e-8, 1e-3, 1.0, np.pi / 2, 3.0, np.pi - 1e-8, np.pi])
@pytest.mark.parametrize("scale", [1.0, -1.0, 1.001])
def test_rotation_vector_of_a_known_turn(angle: float, scale: float) -> None:
    vector = rotation_vectors(scale * quaternion_of(AXIS, angle)[None])[0]
    if angle == np.pi and vector @ AXIS < 0:  # half a turn either way is the same
        vector = -vector
    np.testing.assert_allclose(vector, angle * AXIS, rtol=4e-16 * 8, atol=0)


def test_quaternions_of_matrices_are_those_of_scipy() -> None:
    """Of random attitudes, and of half turns, whose scalar part is zero, about each axis."""
    halves = Rotation.from_rotvec(np.pi * np.vstack([np.eye(3), np.ones(3) / np.sqrt(3.0)]))
    attitudes = Rotation.concatenate([Rotation.random(50, rng=np.random.default_rng(SEED)), halves])
    found = Rotation.from_quat(quaternions_of_matrices(attitudes.as_matrix()), scalar_first=True)
    np.testing.assert_allclose((found * attitudes.inv()).magnitude(), 0.0, atol=1e-7)


def test_rotation_vector_takes_the_shorter_way() -> None:
    vector = rotation_vectors(quaternion_of(AXIS, 1.5 * np.pi)[None])[0]
    np.testing.assert_allclose(vector, -0.5 * np.pi * AXIS, rtol=1e-15 * 8)


def test_rotation_vector_of_random_quaternions_gives_their_rotation() -> None:
    print(f"seed {SEED}")
    quaternions = np.random.default_rng(SEED).normal(size=(500, 4))
    vectors = rotation_vectors(quaternions)
    assert vectors.shape == (500, 3)
    assert np.linalg.norm(vectors, axis=1).max() <= np.pi
    for quaternion, vector in zip(quaternions, vectors, strict=True):
        np.testing.assert_allclose(rotation_matrix(vector), matrix_of_quaternion(quaternion), rtol=0, atol=4e-15)


# ---- Labels keep their distance -------------------------------------------------------------------------------------


def test_spread_labels_keep_their_distance_and_their_order() -> None:
    print(f"seed {SEED}")
    generator = np.random.default_rng(SEED)
    for _ in range(200):
        places = generator.uniform(0, 1, size=generator.integers(1, 9)) ** 3
        spread = _spread(places, 0.1)
        order = np.argsort(places)
        assert np.all(np.diff(spread[order]) >= 0.1 - 1e-12)
        assert spread.min() >= 0
        assert spread.max() <= 1 + 1e-12


def test_spread_labels_stay_where_there_is_room_and_share_the_way_where_there_is_none() -> None:
    np.testing.assert_array_equal(_spread(np.array([0.9, 0.1, 0.5]), 0.2), [0.9, 0.1, 0.5])
    np.testing.assert_allclose(_spread(np.array([0.5, 0.5, 0.5]), 0.1), [0.4, 0.5, 0.6], rtol=1e-14)


# ---- Files ----------------------------------------------------------------------------------------------------------

FEW_FILES = ("paper", "diverges at once", "one step")  # a run that takes legs beyond their stroke has all figures


@pytest.fixture
def quick_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two small files in place of the figures, where it matters what becomes of files."""
    names = ("fig3_feature_paths.svg", "fig4_platform_motion.svg")
    monkeypatch.setattr("hexservo.draw.paper_figures.paper_images", lambda _: dict.fromkeys(names, b"drawn"))


@pytest.mark.parametrize("name", ["diverges", *(pytest.param(name, marks=pytest.mark.slow) for name in FEW_FILES)])
def test_paper_figures_writes_each_figure_twice(name: str, tmp_path: Path) -> None:
    result = run(**RUNS[name])
    paths = paper_figures(result, tmp_path / "new" / "out")
    names = [*NAMES, "legs"] if name == "diverges" else NAMES  # that run takes legs beyond their stroke
    assert paths == [tmp_path / "new" / "out" / f"{name}.{kind}" for name in names for kind in ("svg", "png")]
    assert sorted([*paths, tmp_path / "new" / "out" / MARKER]) == sorted((tmp_path / "new" / "out").iterdir())
    for path in paths:
        assert path.stat().st_size < 1_000_000
        if path.suffix == ".svg":
            root = ElementTree.fromstring(path.read_bytes())
            assert root.tag == "{http://www.w3.org/2000/svg}svg"
            assert len(list(root.iter("{http://www.w3.org/2000/svg}path"))) > 20
            assert not list(root.iter("{http://www.w3.org/2000/svg}text"))  # needs no font
        else:
            content = path.read_bytes()
            assert content.startswith(b"\x89PNG\r\n\x1a\n")
            assert content.endswith(b"IEND\xaeB`\x82")
            width, height = (int.from_bytes(content[start : start + 4], "big") for start in (16, 20))
            assert width in (700, 1432)  # a column or a page at 200 dpi
            assert height > 400


@pytest.fixture(scope="module")
def written(paper: hs.Result, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The files of the paper's run, which no test changes."""
    return paper_figures(paper, tmp_path_factory.mktemp("written") / "out")


@pytest.mark.usefixtures("quick_figures")
def test_paper_figures_replace_older_ones_on_request_and_no_other_files(paper: hs.Result, tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "fig3_feature_paths.svg").write_text("mine")
    for force in (False, True):
        with pytest.raises(OutputError, match="holds files that are not results of hexservo"):
            paper_figures(paper, mine, force=force)
    assert [path.name for path in mine.iterdir()] == ["fig3_feature_paths.svg"]
    assert (mine / "fig3_feature_paths.svg").read_text() == "mine"
    paths = paper_figures(paper, str(tmp_path / "ours"))
    with pytest.raises(OutputError, match=r"holds results already; replace them with --force \(force=True in Python\)"):
        paper_figures(paper, tmp_path / "ours")
    assert paper_figures(run(), tmp_path / "ours", force=True) == paths
    (tmp_path / "ours" / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"did not write, so it is kept: notes\.txt"):
        paper_figures(paper, tmp_path / "ours", force=True)


def test_paper_figures_take_a_result_only(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match=r"^result: expected a Result .* got str$"):
        paper_figures("paper", tmp_path)  # type: ignore[arg-type]


def test_files_have_ordinary_permissions(written: list[Path], tmp_path: Path) -> None:
    (tmp_path / "plain").touch()
    for path in written:
        assert path.stat().st_mode == (tmp_path / "plain").stat().st_mode


@pytest.mark.parametrize(
    "make",
    [
        lambda folder: folder / "file",
        lambda folder: folder / "file" / "below",
        lambda folder: folder / "null\0character",
        lambda folder: folder / ("x" * 300),
    ],
    ids=["a file", "below a file", "a null character", "a long name"],
)
def test_an_unusable_folder_is_refused_with_a_message(
    make: Callable[[Path], Path], paper: hs.Result, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("kept")
    with pytest.raises(OutputError, match=r": (expected a folder|File name too long)"):
        paper_figures(paper, make(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_text() == "kept"


@pytest.mark.usefixtures("quick_figures")
def test_nothing_appears_when_a_file_cannot_be_written(
    paper: hs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = Path.write_bytes

    def full_disk(path: Path, content: bytes) -> int:
        if "fig4" in path.name:
            write(path, content[:100])
            raise OSError(28, "No space left on device")
        return write(path, content)

    monkeypatch.setattr(Path, "write_bytes", full_disk)
    with pytest.raises(OutputError, match="No space left on device"):
        paper_figures(paper, tmp_path / "figures")
    assert not list(tmp_path.iterdir())


# ---- The user's matplotlib ------------------------------------------------------------------------------------------


def test_the_same_run_has_the_same_bytes_and_settings_of_the_user_are_neither_changed_nor_used(
    written: list[Path], tmp_path: Path
) -> None:
    ours = [path.read_bytes() for path in written]
    assert not any(b"dc:date" in content for content in ours)
    theirs = {"font.size": 30, "svg.fonttype": "none", "savefig.dpi": 10, "savefig.bbox": "tight", "lines.linewidth": 9}
    with matplotlib.rc_context(theirs):  # type: ignore[arg-type]
        before = dict(matplotlib.rcParams)
        again = paper_figures(run(), tmp_path / "again")
        assert dict(matplotlib.rcParams) == before
    for path, content in zip(again, ours, strict=True):
        assert path.read_bytes() == content, path.name


def test_pyplot_is_never_imported_and_the_backend_is_not_chosen() -> None:
    code = """
import sys, tempfile
import matplotlib
before = dict.__getitem__(matplotlib.rcParams, "backend")
import hexservo as hs
result = hs.simulate(hs.load_scenario("paper").updated({"simulation.duration": 0.1}))
with tempfile.TemporaryDirectory() as folder:
    hs.plots.paper_figures(result, folder)
assert "matplotlib.pyplot" not in sys.modules
assert dict.__getitem__(matplotlib.rcParams, "backend") is before
"""
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


def test_an_error_while_drawing_leaves_the_settings_alone() -> None:
    before = dict(matplotlib.rcParams)
    with pytest.raises(TypeError):
        plots.feature_errors(None)  # type: ignore[call-overload]
    assert dict(matplotlib.rcParams) == before


def test_threads_draw_in_our_style_one_after_the_other() -> None:
    """The settings are those of the whole process: the first to leave would take the style from the other."""
    before = dict(matplotlib.rcParams)
    entered, first_is_done = threading.Event(), threading.Event()

    def draw() -> None:
        with our_style():
            entered.set()
            first_is_done.wait(5.0)

    other = threading.Thread(target=draw)
    with our_style(), our_style():  # drawing functions call one another
        other.start()
        assert not entered.wait(0.2)
    first_is_done.set()
    other.join()
    assert entered.is_set()
    assert dict(matplotlib.rcParams) == before
