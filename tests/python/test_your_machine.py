"""docs/your-machine.md: its code runs and prints what is written there, its numbers are those of the runs."""

from __future__ import annotations

import math
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo.scenario.fitted import auto_of
from test_terminal import invoke

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "your-machine.md").read_text(encoding="utf-8")
sys.path.insert(0, str(ROOT / "docs" / "tools"))


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def test_reach_prints_what_is_written(tmp_path: Path) -> None:
    first, _ = blocks("python")
    run = subprocess.run([sys.executable, "-c", first], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert [run.stdout] == blocks("text")


def test_a_tag_of_opencv_is_seen_where_opencv_sees_it(capsys: pytest.CaptureFixture[str]) -> None:
    _, second = blocks("python")
    place: dict[str, object] = {}
    exec(second, place)
    printed = np.array(eval(capsys.readouterr().out))
    # OpenCV's own projection of the corners that SOLVEPNP_IPPE_SQUARE takes, in its axes, without distortion
    corners = 0.04 * np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    rotation, shift = Rotation.from_rotvec(np.array(place["rvec"])), np.array(place["tvec"])
    seen = rotation.apply(corners) + shift
    scenario = place["scenario"]
    assert isinstance(scenario, hs.Scenario)
    fx = scenario.camera.focal_pixels
    u, v = (fx * seen[:, :2] / seen[:, 2:]).T  # less cx and cy
    features = np.column_stack([u, -v]).ravel()
    np.testing.assert_allclose(hs.project(scenario, np.zeros(6)), features, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(printed, np.round(features))


def test_the_commands_run_in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (commands,) = blocks("sh")
    for line in commands.splitlines():
        program, *arguments = shlex.split(line, comments=True)
        assert program == "hexservo"
        if arguments[0] == "report":  # of a machine that `new` has written: slow tests work out its findings
            monkeypatch.setattr("hexservo.report.page.groups", lambda _: [])
        code, _, error = invoke(*arguments, stdin="\n" * 60)
        assert code == 0, error
        assert "Warning" not in error
    assert (tmp_path / "mine.html").stat().st_size > 100_000


def test_the_gains_of_the_page_are_those_of_the_machine() -> None:
    from hexservo.scenario.yaml import load_yaml

    (block,) = [block for block in blocks("yaml") if "bandwidth" in block]
    document = load_yaml(block)
    assert isinstance(document, dict)
    machine = hs.load_scenario("pi-h824").updated({"controller.composite.auto.bandwidth": 9.0})
    assert machine.updated(document) == hs.load_scenario("pi-h824")


def test_the_table_has_the_numbers_of_the_runs() -> None:
    rows = re.findall(
        r"^\| `([\w-]+)` \| ([\d.]+) kg[^|]*\| ± ([\d.]+)( mm|°) \| ([\d.]+) Hz \| ([\d.]+) s \| ([\d.]+) px",
        PAGE,
        re.M,
    )
    assert len(rows) == 4
    for name, mass, stroke, unit, bandwidth, settles, rms in rows:
        scenario = hs.load_scenario(name)
        metrics = hs.metrics(hs.simulate(scenario))
        assert float(mass) == pytest.approx(scenario.robot.mass + scenario.robot.payload.mass, rel=2e-3)
        scale = 1e3 if unit == " mm" else math.degrees(1.0)
        assert float(stroke) == pytest.approx(scale * scenario.robot.stroke, rel=5e-3)
        assert float(bandwidth) == auto_of(scenario).bandwidth
        # variants of the kernel differ in the last digits, which may move the last crossing of the band by a frame
        assert float(settles) == pytest.approx(metrics["settling_time"], abs=2.0 * (scenario.camera.period or 0.0))
        assert float(rms) == pytest.approx(metrics["rms_error"], abs=0.01, rel=0.1)  # the coarse encoders' as drawn


def test_the_picture_is_up_to_date() -> None:
    from frames import PICTURE, picture

    assert PICTURE.read_text(encoding="utf-8") == picture(), "type: python docs/tools/frames.py"
