"""The package with the lowest versions of what it depends on, as its metadata state them, from PyPI."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from importlib.metadata import requires
from pathlib import Path

import pytest

import hexservo as hs

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.version_info[:2] != (3, 11), reason="wheels of the lowest versions are for Python 3.11"),
]

CAMPAIGN = """
scenario: paper
runs: 20
vary:
  uncertainty.depth: {uniform: [-0.1, 0.1]}
require: [settling_time <= 1.0]
"""


def lowest() -> list[str]:
    """Return the requirements of no extra, with the lowest version of each."""
    found = [requirement for requirement in requires("hexservo") or [] if "extra ==" not in requirement]
    assert all(re.fullmatch(r"[\w-]+>=[\d.]+", requirement) for requirement in found)
    return [requirement.replace(">=", "==") for requirement in found]


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the interpreter of an environment that has these versions, and the installed package."""
    folder = tmp_path_factory.mktemp("lowest")
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    found = folder / "bin" / "python"
    subprocess.run([str(found), "-m", "pip", "install", "--quiet", "--only-binary", ":all:", *lowest()], check=True)
    package = Path(hs.__file__).parent
    shutil.copytree(package, folder / "lib" / "python3.11" / "site-packages" / "hexservo")
    return found


def run(python: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [str(python), "-m", "hexservo", *arguments]
    clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, env=clean)


@pytest.mark.parametrize(
    "command",
    [
        "check paper",
        "run paper --out run",
        "report slow-camera --out slow.html",
        "analyse pi-h824",
        "diagnose fails-gravity",
        "certify paper",
        "compare --scenarios paper --laws hybrid,pbvs --out compared",
        "campaign campaign.yaml --out campaign --report",
        "export paper --header gains.hpp",
        "schema",
    ],
)
def test_commands_work(python: Path, tmp_path: Path, command: str) -> None:
    (tmp_path / "campaign.yaml").write_text(CAMPAIGN, encoding="utf-8")
    done = run(python, tmp_path, *command.split())
    assert done.returncode == 0, done.stderr
    assert done.stderr == "" or "Traceback" not in done.stderr
    assert done.stdout
    for name in re.findall(r"--(?:out|header) (\S+)", command):
        assert (tmp_path / name).exists()


def test_bad_input_is_refused(python: Path, tmp_path: Path) -> None:
    """The exit code is 2; a command-line library that is too old for its parts ended with 0."""
    assert run(python, tmp_path, "nonsense").returncode == 2
    assert run(python, tmp_path, "check", "absent.yaml").returncode == 2
    for command in ("run", "tune", "campaign", "identify"):
        done = run(python, tmp_path, command, "--help")
        assert (done.returncode, done.stderr) == (0, "")
        assert "Usage:" in done.stdout
