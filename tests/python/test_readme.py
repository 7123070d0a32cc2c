"""The examples of README, docs/batch.md and docs/compare.md run as they stand and say what is written beside them."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"


def examples(page: Path) -> list[str]:
    return re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


def output_of(example: str, folder: Path) -> str:
    run = subprocess.run([sys.executable, "-c", example], cwd=folder, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return run.stdout


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
        example for example in examples(README)[1:] if "simulate(" in example and "diagnose(" not in example
    )
    without, with_prediction = output_of(prediction, tmp_path).splitlines()
    assert re.fullmatch(r"none diverged \d+\.\d\d px", without)
    assert re.fullmatch(r"encoder completed 0\.\d\d px", with_prediction)
    assert output_of(own, tmp_path) == "ran to the end\n"


def test_the_first_example_runs(tmp_path: Path) -> None:
    example = examples(README)[0]
    output = output_of(example, tmp_path)
    outcome, settled, drift = output.splitlines()
    assert outcome.startswith("completed")
    claims = README.read_text(encoding="utf-8")
    (settling_time,) = re.findall(r"(\d\.\d{3}) s$", settled)
    assert f"{settling_time} s, 0.080 px at 5 s" in claims
    (error,) = re.findall(r"is (\d+\.\d) px$", drift)
    assert f"{error} px, 197 mm at 5 s" in claims
    figures = sorted(file.name for file in (tmp_path / "out" / "figures").iterdir())
    assert len(figures) == 10
    assert all((tmp_path / "out" / "figures" / name).stat().st_size > 0 for name in figures)


def test_the_examples_of_comparisons_run(tmp_path: Path) -> None:
    (of_readme,) = (example for example in examples(README) if "hs.compare(" in example)
    (of_page,) = examples(ROOT / "docs" / "compare.md")
    lines = output_of(of_readme, tmp_path).splitlines()
    assert lines[0] == "paper hybrid settled - within 2 px from 0.353 s on"
    assert len(lines) == 6
    assert (tmp_path / "out" / "comparison" / "comparison.svg").stat().st_size > 0
    *table, _, last = output_of(of_page, tmp_path).splitlines()
    assert len(table) == 6
    assert last.startswith("settled within 2 px from 0.552 s on ")
    assert (tmp_path / "comparison.png").stat().st_size > 0


def test_the_example_of_what_is_known_runs(tmp_path: Path) -> None:
    (example,) = (example for example in examples(README) if "diagnose(" in example)
    cause, remedy, conditioning, stiction, *certified = output_of(example, tmp_path).splitlines()
    assert cause == "latency or rate of the camera"
    assert "camera.prediction=encoder" in remedy
    assert "mm" in conditioning
    assert "px" in stiction
    assert [line.split(" - ")[0] for line in certified] == ["warning", "warning", "good"]
    assert (tmp_path / "report.html").stat().st_size > 0
