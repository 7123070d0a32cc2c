"""The README's example runs as it stands and says what the README says."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

README = Path(__file__).resolve().parents[2] / "README.md"


def test_the_example_runs(tmp_path: Path) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    run = subprocess.run([sys.executable, "-c", example], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    outcome, settled, drift = run.stdout.splitlines()
    assert outcome.startswith("completed")
    claims = README.read_text(encoding="utf-8")
    (settling_time,) = re.findall(r"(\d\.\d{3}) s$", settled)
    assert f"{settling_time} s, 0.080 px at 5 s" in claims
    (error,) = re.findall(r"is (\d+\.\d) px$", drift)
    assert f"{error} px, 197 mm at 5 s" in claims
    figures = sorted(file.name for file in (tmp_path / "out" / "figures").iterdir())
    assert len(figures) == 10
    assert all((tmp_path / "out" / "figures" / name).stat().st_size > 0 for name in figures)
