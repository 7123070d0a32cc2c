"""Examples of README, docs/camera.md, docs/batch.md and docs/compare.md run and print what is written beside them."""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo import _core
from hexservo.scenario.laws import LAWS

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"


def examples(page: Path) -> list[str]:
    return re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


def output_of(example: str, folder: Path) -> str:
    """What an example prints; it has its names to itself."""
    printed = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(printed):
        patch.chdir(folder)
        exec(compile(example, "<example>", "exec"), {"__name__": "__main__"})
    return printed.getvalue()


@pytest.mark.slow
def test_the_examples_of_batches_run(tmp_path: Path) -> None:
    (of_readme,) = (example for example in examples(README) if "simulate_batch" in example)
    (of_page,) = examples(ROOT / "docs" / "batch.md")
    runs, worst = output_of(of_readme, tmp_path).splitlines()
    assert runs == "1000 runs: 1000 completed"
    assert re.fullmatch(r"worst error at 5 s: \d+\.\d px, at a mass error of -?\d+\.\d%", worst)
    completed, settling_time = map(float, output_of(of_page, tmp_path).split())
    assert completed == 1.0
    assert 0.3 < settling_time < 1.0


def test_the_examples_of_a_real_camera_run(tmp_path: Path) -> None:
    prediction, own = (
        example
        for example in examples(README)[1:]
        if "simulate(" in example and "diagnose(" not in example and "campaign(" not in example
    )
    without, with_prediction = output_of(prediction, tmp_path).splitlines()
    assert re.fullmatch(r"none diverged \d+\.\d\d px", without)
    assert re.fullmatch(r"encoder completed 0\.\d\d px", with_prediction)
    assert output_of(own, tmp_path) == "ran to the end\n"


def test_the_pixels_of_opencv_become_features(tmp_path: Path) -> None:
    (example,) = (example for example in examples(ROOT / "docs" / "camera.md") if "cv2.undistort" in example)
    initial = hs.load_scenario("paper").target.initial_features
    assert output_of(example, tmp_path) == f"{list(initial or ())}\n"

    # OpenCV's projection, by its own formula (x right, y down, z ahead), from random poses with the seed below.
    random = np.random.default_rng(4)
    camera = _core.Camera()
    for _ in range(100):
        place: dict[str, Any] = {}
        exec(example.replace("print(", "("), place)
        attitude = Rotation.from_rotvec(random.normal(0, 1, 3))
        position = random.normal(0, 1, 3)
        seen = np.column_stack([random.uniform(-0.3, 0.3, (4, 2)), random.uniform(0.3, 2, 4)])  # in OpenCV's axes
        points = position + seen @ (attitude.as_matrix() @ np.diag([1.0, -1.0, -1.0])).T
        u = camera.focal_pixels * seen[:, 0] / seen[:, 2] + place["cx"]
        v = camera.focal_pixels * seen[:, 1] / seen[:, 2] + place["cy"]
        line = re.findall(r"^features = (.*?)  #", example, re.MULTILINE)[0]
        converted = eval(line, {**place, "u": u, "v": v})
        quaternion = attitude.as_quat()[[3, 0, 1, 2]]
        features, depth = _core.take_image(camera, position, quaternion, points)
        np.testing.assert_allclose(features, converted, rtol=0, atol=1e-9)
        np.testing.assert_allclose(depth, -seen[:, 2], rtol=1e-12)


FORCES = {
    "hybrid": ("kp", "kv"),
    "composite": ("kp", "kv", "kt", "kd"),
    "kelly": ("kp", "kd"),
    "resolved_rate": ("ki",),
    "pbvs": ("kp", "kd"),
    "computed_torque": (),
}


@pytest.mark.parametrize("law", LAWS)
def test_gains_scale_with_the_mass_as_written(law: str) -> None:
    scale = 3.0
    smooth = {"simulation.duration": 0.3, "controller.switching.kind": "tanh", "controller.law": law}
    light = hs.load_scenario("paper").updated(smooth)
    gains = light.to_mapping()["controller"][law]
    factors = {f"controller.{law}.{key}": (gains[key], scale) for key in FORCES[law]}
    factors |= {f"robot.{key}": (getattr(light.robot, key), scale) for key in ("mass", "inertia")}
    divided = {"hybrid": ("adaptation", "error_scale", "rate_scale"), "composite": ("adaptation",)}.get(law, ())
    factors |= {f"controller.{law}.fuzzy.{key}": (gains["fuzzy"][key], 1.0 / scale) for key in divided}
    heavy = light.updated({key: (np.asarray(value) * factor).tolist() for key, (value, factor) in factors.items()})
    one, other = hs.simulate(light), hs.simulate(heavy)
    # The pseudo-inverse of resolved_rate amplifies rounding by its condition squared, some 1e7 (docs/batch.md); the
    # estimate of pbvs from an exact image, which releases its prior, likewise.
    tolerance = 1e-9 if law in ("resolved_rate", "pbvs") else 1e-12
    np.testing.assert_allclose(other.position, one.position, rtol=0, atol=tolerance)
    np.testing.assert_allclose(
        other.wrench, scale * one.wrench, rtol=0, atol=10 * tolerance * np.abs(other.wrench).max()
    )


def test_only_the_product_of_focal_length_and_pixel_scale_acts() -> None:
    paper = hs.load_scenario("paper").updated({"simulation.duration": 0.3})
    other = paper.updated({"camera.focal_length": 0.016, "camera.pixel_scale": paper.camera.pixel_scale / 2})
    assert hs.simulate(other).position.tobytes() == hs.simulate(paper).position.tobytes()


def test_the_first_example_runs(tmp_path: Path) -> None:
    example = examples(README)[0]
    output = output_of(example, tmp_path)
    outcome, settled, drift = output.splitlines()
    assert outcome.startswith("completed")
    claims = README.read_text(encoding="utf-8")
    (settling_time,) = re.findall(r"(\d\.\d{3}) s$", settled)
    assert f"{settling_time} s, 0.080 px at 5 s" in claims
    (error,) = re.findall(r"is (\d+\.\d) px$", drift)
    path = hs.simulate(hs.load_scenario("paper-gravity")).position
    assert f"{error} px, {1e3 * np.linalg.norm(path[-1] - path[0]):.0f} mm at 5 s" in claims
    assert path[-1, 2] < path[0, 2]  # z points down: it rises
    figures = sorted(file.name for file in (tmp_path / "out" / "figures").glob("fig*"))
    assert len(figures) == 10
    assert all((tmp_path / "out" / "figures" / name).stat().st_size > 0 for name in figures)


def test_the_examples_of_comparisons_run(tmp_path: Path) -> None:
    (of_readme,) = (example for example in examples(README) if "hs.compare(" in example)
    (of_page,) = (example for example in examples(ROOT / "docs" / "compare.md") if "comparison.png" in example)
    lines = output_of(of_readme, tmp_path).splitlines()
    assert lines[0] == "paper hybrid settled - within 2 px after 0.353 s"
    assert len(lines) == 6
    assert (tmp_path / "out" / "comparison" / "comparison.svg").stat().st_size > 0
    *table, _, verdict, head, _, first, second = output_of(of_page, tmp_path).splitlines()
    assert len(table) == 6
    assert verdict.startswith("settled within 2 px after 0.552 s ")
    assert head.split() == ["law", "composite", "hybrid"]  # of pandas
    assert (first.split()[0], second.split()[::2]) == ("paper", ["paper-gravity", "NaN"])
    assert (tmp_path / "comparison.png").stat().st_size > 0


@pytest.mark.parametrize("name", ["slow-camera", "real-machine"])
def test_the_example_of_a_custom_controller_runs_with_and_without_encoders(name: str, tmp_path: Path) -> None:
    """On real-machine every tick was unusable without the lengths of the legs, and the run diverged."""
    (example,) = (example for example in examples(README) if "hs.Observation" in example)
    assert "slow-camera" in example
    assert output_of(example.replace("slow-camera", name), tmp_path) == "ran to the end\n"


def test_the_example_of_campaigns_runs(tmp_path: Path) -> None:
    (example,) = (example for example in examples(README) if "hs.campaign(" in example)
    verdict, settling_time = output_of(example, tmp_path).splitlines()
    assert re.match(r"\d+ of 500 runs fails?: the failure probability is between ", verdict)
    assert 0.1 < float(settling_time) < 0.2


@pytest.mark.slow
def test_the_example_of_a_full_report_runs(tmp_path: Path) -> None:
    (example,) = (example for example in examples(README) if "diagnose(" in example)
    cause, remedy, conditioning, stiction, *certified = output_of(example, tmp_path).splitlines()
    assert cause == "latency or rate of the camera"
    assert "camera.prediction=encoder" in remedy
    assert "mm" in conditioning
    assert "px" in stiction
    assert [line.split(" - ")[0] for line in certified] == ["warning", "warning", "good"]
    assert (tmp_path / "report.html").stat().st_size > 0
