"""Travel, speeds and tilts of the legs with their limits, in figures, charts and the view in space.

Expected values are those of `test_leg_limits.peaks`: from the logged poses, with SciPy's rotations.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import hexservo as hs
import rotary_machine
from hexservo import plots
from hexservo.draw.plots import paper_images
from hexservo.report.figures import figures
from hexservo.report.scene import scene
from hexservo.report.still import still
from hexservo.run.leg_motion import leg_motions
from test_leg_limits import KINDS, peaks

LIMITS = {"robot.speed_limit": 0.05, "robot.joint_limit": [0.08, 0.5]}


@pytest.fixture(scope="module")
def result(paper: hs.Scenario) -> hs.Result:
    return hs.simulate(paper.updated({**LIMITS, "simulation.duration": 1.0}))


def shapes(result: hs.Result) -> dict[str, list[float]]:
    """Chart's title -> the levels that it draws, of the last figure of the report."""
    title, charts = figures(result)[-1]
    assert title == "Legs and their limits"
    found = {}
    for chart in charts:
        heading = re.search(r"<h4[^>]*>(.*?)</h4>", str(chart)) or re.search(r"<figcaption[^>]*>(.*?)<", str(chart))
        spec = json.loads(re.search(r"<script[^>]*>(.*?)</script>", str(chart), re.DOTALL)[1])  # type: ignore[index]
        assert heading is not None
        found[heading[1]] = [shape["y0"] for shape in spec["layout"].get("shapes", [])]
    return found


def test_what_is_drawn_is_what_is_limited(result: hs.Result) -> None:
    travel, *others = leg_motions(result)
    expected = peaks(result)
    for motion, kind in zip(others, KINDS, strict=True):
        np.testing.assert_allclose(1e-3 * np.abs(motion.values), expected[kind], rtol=1e-9, atol=1e-12)
        assert motion.limit.kind == kind
    home = result.leg_lengths[0]
    np.testing.assert_allclose(1e-3 * travel.values, result.leg_lengths - home, atol=1e-15)
    assert (others[0].values.min() < 0) == (others[0].levels[0] < 0)  # speeds have a sign, tilts have none
    assert [len(motion.levels) for motion in (travel, *others)] == [2, 2, 1, 1]
    some = leg_motions(result, np.array([5, 50]))
    for one, other in zip(some, (travel, *others), strict=True):
        np.testing.assert_array_equal(one.values, other.values[[5, 50]])


def test_charts_have_the_limits_that_are_used(result: hs.Result) -> None:
    assert shapes(result) == {
        "Travel of the legs from the middle of the stroke": [-17.0, 17.0],
        "Speeds of the legs": [-50.0, 50.0],
        "Tilts of the legs from home, at the base": pytest.approx([80.0]),
        "Tilts of the legs from home, at the platform": [],  # 500 mrad, of which less than a quarter is used
    }


def test_without_limits_there_is_the_travel_alone(paper: hs.Scenario) -> None:
    result = hs.simulate(paper.updated({"simulation.duration": 0.5}))
    assert list(shapes(result)) == ["Travel of the legs from the middle of the stroke"]
    assert len(plots.leg_limits(result).axes) in (1, 2)  # two where the time axis is broken


@pytest.fixture
def empty_images(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files of figures without their pictures, where names are what matters."""
    monkeypatch.setattr("hexservo.draw.plots.image_bytes", lambda figure, extension: b"")


@pytest.mark.usefixtures("empty_images")
def test_the_figure_has_a_panel_for_each_limit(result: hs.Result, tmp_path: Path) -> None:
    figure = plots.leg_limits(result)
    levels: dict[str, set[float]] = {}
    for axes in figure.axes:
        for line in axes.lines:
            if str(line.get_gid()).startswith("limit "):
                levels.setdefault(str(line.get_gid()), set()).update(np.asarray(line.get_ydata(), dtype=float))
    assert levels == {"limit stroke": {-17.0, 17.0}, "limit speed": {-50.0, 50.0}, "limit base_joint": {80.0}}
    titles = [axes.get_title(loc="left") for axes in figure.axes if axes.get_title(loc="left")]
    assert titles[-1] == "Tilts of the legs from home, at the platform (limit: 500 mrad)"
    with pytest.raises(ValueError, match="axes: expected 4 axes, got 3"):
        plots.leg_limits(result, axes=Figure().subplots(3, 1))
    four = Figure().subplots(4, 1)
    assert plots.leg_limits(result, axes=four) == tuple(four)
    written = {path.name for path in hs.plots.paper_figures(result, tmp_path)}
    assert {"legs.svg", "legs.png"} <= written


@pytest.mark.usefixtures("empty_images")
def test_a_stroke_that_is_exceeded_or_ends_a_run_is_drawn(paper: hs.Scenario) -> None:
    quick = paper.updated({"simulation.duration": 0.05, "robot.force_limit": 10.0})
    short = hs.simulate(quick.updated({"robot.stroke": 1e-3}))
    assert "legs.png" in paper_images(short)
    assert [text.get_text() for text in plots.leg_limits(short).texts] == ["a leg exceeded its stroke"]
    (axes,) = plots.leg_limits(short, axes=[Figure().subplots()])
    assert "a leg exceeded its stroke" in [text.get_text() for text in axes.texts]
    weak = hs.simulate(quick.updated({"robot.stroke": 1e-3, "robot.force_limit": 0.05}))
    assert [text.get_text() for text in plots.leg_limits(weak).texts] == ["2 limits of the legs were exceeded"]
    fine = hs.simulate(quick)
    assert "legs.png" not in paper_images(fine)
    assert not plots.leg_limits(fine).texts
    ended = hs.simulate(hs.load_scenario("fails-leg-limits"))
    assert ended.outcome == "leg_limit"
    assert "legs.png" in paper_images(ended)


@pytest.mark.parametrize("share", [0.5, 2.0])
def test_a_force_limit_that_is_reached_is_a_line(paper: hs.Scenario, share: float) -> None:
    free = hs.simulate(paper.updated({"simulation.duration": 0.5}))
    limit = share * float(np.abs(free.leg_forces).max())
    result = hs.simulate(paper.updated({"simulation.duration": 0.5, "robot.force_limit": limit}))
    drawn = [
        line for axes in plots.control_wrench(result).axes for line in axes.lines if line.get_gid() == "limit force"
    ]
    assert bool(drawn) == (share < 1.0)
    (forces,) = [chart for title, charts in figures(result) for chart in charts if "Leg forces" in str(chart)]
    assert (f"limit of {limit:.4g} N" in str(forces)) == (share < 1.0)


def test_the_view_in_space_knows_the_limits(result: hs.Result) -> None:
    view = scene(result)
    expected = peaks(result)
    chosen = np.searchsorted(result.time, view.time)
    robot = result.scenario.robot
    shares = np.array(
        [
            np.abs(result.leg_lengths - result.leg_lengths[0]) / robot.stroke,
            *(expected[kind] / limit for kind, limit in zip(KINDS, (0.05, 0.08, 0.5), strict=True)),
            np.abs(result.leg_forces) / robot.force_limit,
        ]
    )[:, chosen]
    np.testing.assert_allclose(view.used, shares.max(axis=0), rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(view.limit, shares.argmax(axis=0))
    assert (view.used > 1).any()
    assert len(view.limits) == len(shares)
    assert view.limits[1] == "speed limit"


def test_rotary_legs_are_cranks_and_rods_in_the_still_picture() -> None:
    changes: dict[str, Any] = {"simulation.duration": 0.3, "robot.stroke": 1e-3}  # all beyond it, a little later
    result = hs.simulate(rotary_machine.machine(changes))
    view = scene(result)
    assert view.feet is not None
    np.testing.assert_allclose(np.linalg.norm(view.feet - view.base, axis=-1), rotary_machine.CRANK, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(view.joints - view.feet, axis=-1), rotary_machine.ROD, rtol=1e-12)
    drawn = str(still(view))
    assert len(re.findall(r'class="leg crank', drawn)) == len(re.findall(r'class="leg rod', drawn)) == 6
    beyond = int((view.used[-1] > 1).sum())
    assert beyond > 0
    assert len(re.findall("beyond", drawn)) == 2 * beyond
