"""docs/position-machines.md: each of its commands runs, one after the other, and prints what is written beside it."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import hexservo as hs
from test_docs import ROOT

PAGE = ROOT / "docs" / "position-machines.md"
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?")


def blocks() -> list[tuple[str, str]]:
    """Code of the page."""
    return re.findall(r"```(sh|text|yaml|python)\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def output_of(line: str, folder: Path) -> str:
    program, *arguments = shlex.split(line, comments=True)
    return output_of_program(program, arguments, folder)


def output_of_program(program: str, arguments: list[str], folder: Path) -> str:
    if program == "python":
        command = [sys.executable, *arguments]
    else:
        assert program == "hexservo"
        command = [sys.executable, "-m", "hexservo", *arguments]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*sys.path, str(ROOT / "examples")]), "COLUMNS": "500"}
    run = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert run.returncode == 0, f"{program} {arguments}: {run.returncode}\n{run.stdout}\n{run.stderr}"
    return run.stdout


def alike(written: str, printed: str) -> bool:
    """The same words, and numbers within a tenth: kernels of other processors round differently."""
    one, other = (" ".join(text.split()) for text in (written, printed))
    if NUMBER.sub("#", one) != NUMBER.sub("#", other)[: len(NUMBER.sub("#", one))]:
        return False
    pairs = zip(NUMBER.findall(one), NUMBER.findall(other), strict=False)
    return all(float(a) == pytest.approx(float(b), rel=0.1, abs=0.01) for a, b in pairs)


def require_printed(text: str, printed: list[str]) -> None:
    for line in text.splitlines():
        assert any(alike(line, row) for row in printed), "\n".join(["not printed:", line, "printed:", *printed])


def test_the_law_in_python_runs(tmp_path: Path) -> None:
    (place,) = (index for index, (kind, _) in enumerate(blocks()) if kind == "python")
    (_, program), (kind, text) = blocks()[place : place + 2]
    assert kind == "text"
    require_printed(text, output_of_program("python", ["-c", program], tmp_path).splitlines())


@pytest.mark.slow
def test_commands_of_the_page_run(tmp_path: Path) -> None:
    printed: list[str] = []
    for kind, text in blocks():
        if kind == "yaml":
            name = re.match(r"# ([\w-]+\.yaml)\n", text)
            assert name, text
            (tmp_path / name[1]).write_text(text, encoding="utf-8")
        elif kind == "sh":
            printed = [row for line in text.splitlines() for row in output_of(line, tmp_path).splitlines()]
        elif kind == "python":
            printed = output_of_program("python", ["-c", text], tmp_path).splitlines()
        else:
            require_printed(text, printed)
    head = hs.load_scenario(tmp_path / "head.yaml", {"controller.pbvs.auto.bandwidth": 4.0})
    for stamped, least, most in ((0.0, 0.0, 4.0), (-0.02, 14.0, 24.0)):
        for depth in (-0.2, 0.0, 0.2):
            run = hs.metrics(hs.simulate(head.updated({"uncertainty": {"depth": depth, "latency": stamped}})))
            assert least <= run["overshoot"] <= most
            assert run["settling_time"] < (0.7 if stamped == 0.0 else 1.0)


def test_numbers_are_compared_with_a_tolerance() -> None:
    assert alike("camera.latency 0.2 0.033", "  camera.latency   0.201  0.033  ")
    assert not alike("camera.latency 0.2 0.033", "camera.latency 0.3 0.033")
    assert not alike("settling time 1.5 s", "settled time 1.5 s")
    assert len(blocks()) == 19
