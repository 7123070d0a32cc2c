"""Points of a report with more of them than colours: dots that are visible, goals as squares, numbers beside paths."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pytest

import hexservo as hs
from browsers import chromium, in_browser
from hexservo.report.figures import figures
from hexservo.report.page import page
from hexservo.report.scene import SpaceView, scene
from hexservo.report.still import still

if TYPE_CHECKING:
    from playwright.sync_api import Browser

COLOURS = 6
FILLS = """kind => [...document.querySelectorAll(`${kind} .dot`)].map(dot => getComputedStyle(dot).fill)"""


@pytest.fixture(scope="module")
def result() -> hs.Result:
    """A run with 16 points, nearly three times the colours."""
    grid = {"rows": 4, "columns": 4, "spacing": 0.03, "pose": [0.0, 0.0, -0.6, 0.0, 0.0, 0.0]}
    goal = {"target.desired_features": None, "target.desired_pose": [0.004, -0.003, 0.002, 0.02, 0.0, 0.05]}
    bare = {"target.initial_features": None, "target.depth": None}
    changes = {"target.grid": grid, **goal, **bare, "simulation.duration": 0.2}
    return hs.simulate(hs.load_scenario("paper").updated(changes))


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as running:
        yield running


@in_browser
def test_every_dot_has_the_colour_of_its_point(
    result: hs.Result, browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the camera's image and in the still picture, on the screen in both schemes and on paper."""
    monkeypatch.setattr("hexservo.report.page.groups", lambda _: [])
    file = tmp_path / "report.html"
    file.write_text(page(result), encoding="utf-8")
    shown_as: tuple[tuple[Literal["light", "dark"], Literal["screen", "print"]], ...]
    shown_as = (("light", "screen"), ("dark", "screen"), ("light", "print"), ("dark", "print"))
    for scheme, media in shown_as:
        shown = browser.new_page(color_scheme=scheme)
        shown.goto(file.as_uri())
        shown.emulate_media(media=media)
        for kind, repeated in (("#image", 1), (".still", 2)):  # the still one has a dot at each target as well
            fills = shown.evaluate(FILLS, kind)
            assert len(fills) == 16 * repeated
            assert "none" not in fills
            assert len(set(fills)) == COLOURS
        shown.close()


def _at_goals(view: SpaceView) -> SpaceView:
    """Return a view whose features are at their goals."""
    return replace(view, image=np.broadcast_to(view.goals, view.image.shape))


def test_goals_are_squares_in_the_still_picture(result: hs.Result) -> None:
    view = scene(result)
    drawn = still(view)
    assert re.findall(r'<(\w+)[^>]*class="goal ', drawn) == ["rect"] * 16
    goals = np.array(re.findall(r'<rect x="([^"]*)" y="([^"]*)"[^>]*class="goal ', drawn), dtype=float)
    at_goals = still(_at_goals(view))
    ends = np.array(re.findall(r'<circle cx="([^"]*)" cy="([^"]*)" r="3"', at_goals), dtype=float)
    assert np.abs(ends - (goals + 5.0)).max() <= 0.11  # a dot at its goal is in the middle of its square


def _spec(chart: str) -> dict[str, Any]:
    """Return data and layout of a chart."""
    (script,) = re.findall(r"<script[^>]*>(.*?)</script>", chart, re.DOTALL)
    found: dict[str, Any] = json.loads(script)
    return found


def test_points_have_numbers_beside_their_paths(result: hs.Result) -> None:
    """Points of the same colour differ by them, as in the figures of a run."""
    charts = dict(figures(result))["Feature paths in the image"]
    spec = _spec(charts[-1])
    numbers = spec["layout"]["annotations"]
    assert [number["text"] for number in numbers] == [str(point) for point in range(1, 17)]
    places = np.array([[number["x"], number["y"]] for number in numbers])
    features = result.features.reshape(len(result.time), -1, 2)
    assert min(np.abs(places - features[row]).max() for row in (0, -1)) == 0.0
    low, high = np.array([spec["layout"][axis]["range"] for axis in ("xaxis", "yaxis")]).T
    shifts = np.array([[number["xshift"], number["yshift"]] for number in numbers])
    pixels = (550.0 if len(charts) == 1 else 390.0) / (high - low)[0]
    drawn = pixels * places + shifts
    apart = np.linalg.norm(drawn[:, None] - drawn, axis=2) + 100.0 * np.eye(16)
    assert apart.min() >= 14.0


def test_dashes_of_feature_errors_repeat_within_their_legend(result: hs.Result) -> None:
    """A legend of plotly.js has 30 px of a line: each dash pattern is there once at least, and begins again."""
    charts = dict(figures(result))["Feature errors"]
    spec = _spec(charts[0])
    # widths of the names of plotly.js for lines up to 3 px: multiples of 3 px
    named = {"solid": 0, "dot": 6, "dash": 18, "longdash": 30, "dashdot": 24, "longdashdot": 36}
    periods = [
        named[dash] if dash in named else sum(int(part[:-2]) for part in dash.split(","))
        for dash in (line["line"]["dash"] for line in spec["data"])
    ]
    assert len(periods) == 32
    assert max(periods) < 30
