"""What reaches a terminal: characters, numbers, widths, standard input and exit codes."""

from __future__ import annotations

import math
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

import hexservo as hs
from hexservo.cli import commands as cli
from hexservo.cli import terminal
from hexservo.findings.evidence import Table
from hexservo.scenario.wording import number, quantity
from hexservo.scenario.yaml import MAX_BYTES
from packaged import one_of_each_kind
from test_cli import environment

SHORT = ["--set", "simulation.duration=0.2"]
COMMANDS = ["run", "compare", "report", "certify", "analyse", "diagnose", "scenarios", "show", "check", "export"]
COMMANDS += ["campaign", "tune", "bench", "version"]
EXPONENT = re.compile(r"\de\+0[0-5]\b")  # a number below a million with an exponent
MINUS_ZERO = re.compile(r"(?<![\w.])-0(?:\.0*)?(?![\w.])")
TOO_LONG = re.compile(r"\b\d{4,}(?:\.\d+)? (?:u|n|m)(?:rad|m|s|N)\b")  # 277000 urad, 2100 mm
ANGLES = re.compile(r"\b[um]?rad\b(?!/)|\bdeg\b|°")


def invoke(*arguments: str, stdin: str | None = None) -> tuple[int, str, str]:
    result = CliRunner().invoke(cli.app, list(arguments), prog_name="hexservo", input=stdin)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


def assert_fit_for_a_terminal(text: str) -> None:
    text.encode("latin-1")
    for pattern in (EXPONENT, MINUS_ZERO, TOO_LONG):
        found = pattern.search(text)
        assert found is None, f"{pattern.pattern}: {text[max(0, found.start() - 60) : found.end() + 20]!r}"


# ---- Characters and numbers -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", one_of_each_kind())
def test_commands_on_every_packaged_scenario(name: str) -> None:
    for arguments in (["show", name], ["check", name], ["run", name, *SHORT], ["certify", name, *SHORT]):
        _, out, error = invoke(*arguments)
        (out + error).encode("latin-1")
        if arguments[0] != "show":  # YAML has its own number format
            assert_fit_for_a_terminal(error + out)


@pytest.mark.parametrize("columns", [80, pytest.param(10_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "arguments",
    [
        ["analyse", "paper", "--set", "robot.stroke=2e-3", "--set", "robot.force_limit=0.2"],
        *(pytest.param(["analyse", name], marks=pytest.mark.slow) for name in ("paper", "composite-30hz")),
        ["diagnose", "fails-late-camera"],
        pytest.param(["diagnose", "fails-leg-limits"], marks=pytest.mark.slow),
        ["certify", "paper-composite"],
        ["compare", "--scenarios", "paper,textbook-translation", "--laws", "hybrid,kelly", *SHORT],
    ],
    ids=lambda arguments: " ".join(arguments[:3]),
)
def test_findings_at_any_width(arguments: list[str], columns: int, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("terminal", "print_sections"):
        monkeypatch.setattr(f"hexservo.cli.{module}.width", lambda: columns)
    _, out, error = invoke(*arguments)
    assert_fit_for_a_terminal(error + out)
    assert "…" not in out


@pytest.mark.parametrize("name", ["paper"])
def test_a_table_has_one_unit_of_angles(name: str) -> None:
    scenario = hs.load_scenario(name)
    found = [*hs.analyse(scenario).sections(), *hs.certify(hs.simulate(scenario)).sections()]
    checked = 0
    for table in (item for section in found for item in section.items if isinstance(item, Table)):
        texts = [column.unit for column in table.columns]
        texts += [cell for row in table.rows for cell in row if isinstance(cell, str)]
        units = {unit for text in texts for unit in ANGLES.findall(text)}
        assert len(units) <= 1, (table.title, units)
        checked += len(units)
    assert checked > 3


@pytest.mark.parametrize("command", COMMANDS)
def test_help_and_errors(command: str) -> None:
    for arguments in ([command, "--help"], [command, "no such thing.yaml"], [command, "--no-such-option"]):
        _, out, error = invoke(*arguments)
        assert out + error
        (out + error).encode("latin-1")


def test_lists_and_refusals() -> None:
    for arguments in (["scenarios"], ["version"], ["--help"], ["run", "paper", "--set", "camera.noise=0.5"]):
        _, out, error = invoke(*arguments)
        (out + error).encode("latin-1")


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.017, "m", "17 mm"),
        (2.1, "m", "2.1 m"),
        (0.277, "rad", "277 mrad"),
        (0.0611, "rad", "61.1 mrad"),
        (0.99999, "m", "1 m"),
        (9.9999e-4, "s", "1 ms"),
        (2.6e-22, "J", "2.6e-22 J"),
        (28764.0, "N", "28800 N"),
        (-0.0, "m", "0 m"),
        (-0.0042, "J", "-4.2 mJ"),
    ],
)
def test_a_quantity_has_one_to_three_digits_before_the_point(value: float, unit: str, text: str) -> None:
    assert quantity(value, unit) == text


def test_no_number_is_minus_zero_or_has_a_small_exponent() -> None:
    for exponent in range(-12, 6):
        for digits in (2, 3, 4):
            for sign in (1, -1):
                text = number(sign * 2.0999 * 10.0**exponent, digits)
                assert not EXPONENT.search(text)
                assert float(text) == pytest.approx(sign * 2.0999 * 10.0**exponent, rel=10.0 ** (1 - digits))
    assert number(-0.0) == "0"
    assert number(-1e-320, 3) != "-0"


# ---- Widths ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("columns", [30, 80, 120, 170, 10_000])
def test_a_comparison_fits_the_terminal_whole(columns: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(terminal, "width", lambda: columns)
    arguments = ["compare", "--scenarios", "paper,textbook-translation", "--laws", "hybrid,resolved_rate", *SHORT]
    code, out, _ = invoke(*arguments)
    assert code == 0
    assert "…" not in out
    assert max(map(len, out.splitlines())) <= columns
    words = " ".join(out.split())
    comparison = hs.compare(
        ["paper", "textbook-translation"], ["hybrid", "resolved_rate"], {"simulation.duration": 0.2}
    )
    for row in comparison.rows:
        assert words.count(row.law) >= 2
        assert number(row.metrics["final_error"]) in words
    for head in ("settles", "residual", "overshoot", "off line", "leg force", "stroke"):
        assert head in words
    heads = [line.split() for line in out.splitlines() if line.startswith("scenario")]
    assert len(heads) == {30: 0, 10_000: 1}.get(columns, len(heads))
    assert columns not in (80, 120) or len(heads) > 1


# ---- Standard input and exit codes ----------------------------------------------------------------------------------


def test_a_scenario_may_come_from_standard_input(paper: hs.Scenario) -> None:
    text = paper.updated({"simulation.duration": 1.5, "name": "piped"}).to_yaml()
    code, out, error = invoke("check", "-", stdin=text)
    assert (code, error) == (0, "")
    assert out.startswith('standard input: valid (scenario "piped"')
    assert "piped: completed, 1.5 s" in invoke("run", "-", stdin=text)[1]
    assert invoke("show", "-", "--set", "name=other", stdin=text)[1].startswith("name: other")
    code, _, error = invoke("check", "-", stdin=text + "sed: 1\n")
    assert code == 2
    assert error.startswith('Error: standard input: sed: unknown key; did you mean "seed"?')
    code, _, error = invoke("run", "-", stdin="a: " + "x" * MAX_BYTES)
    assert (code, error) == (2, f"Error: standard input: expected at most {MAX_BYTES} bytes of YAML, got more\n")


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("--out", ["run", "paper", "--out", "-"]),
        ("--out", ["report", "paper", "-o", "-"]),
        ("--out", ["compare", "--scenarios", "paper", "--out", "-"]),
        ("--out", ["explore", "--out", "-"]),
        ("--out", ["bench", "--out", "-"]),
        ("--out", ["campaign", "paper-bounds", "--out", "-"]),
        ("--out", ["tune", "tune.yaml", "--out", "-"]),
        ("--out", ["identify", "log.csv", "-m", "paper", "--out", "-"]),
        ("--camera", ["run", "paper", "--camera", "-"]),
        ("--header", ["export", "paper", "--header", "-"]),
        ("--mjcf", ["export", "paper", "--mjcf", "-"]),
        ("--fmu", ["export", "paper", "--fmu", "-"]),
        ("CAMPAIGN", ["campaign", "-", "--out", "runs"]),
        ("CAMPAIGN", ["tune", "-", "--out", "runs"]),
        ("LOG", ["identify", "-", "-m", "paper"]),
    ],
)
def test_a_dash_is_no_file(name: str, arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, error = invoke(*arguments)
    assert code == terminal.BAD_INPUT
    assert f'{name}: expected a path, got "-"; one of that name is "./-"' in error
    assert not list(tmp_path.iterdir())


def test_a_missing_file_is_called_that() -> None:
    assert invoke("run", "nofile.yaml")[2] == (
        'Error: "nofile.yaml": no such file; `hexservo scenarios` lists what is packaged\n'
    )
    assert invoke("check", "papr.yaml")[2] == 'Error: "papr.yaml": no such file; did you mean "paper"?\n'


def test_a_run_that_has_to_settle_and_does_not_ends_with_4() -> None:
    assert invoke("run", "paper", "-q")[0] == 0
    assert invoke("run", "paper", "-q", "--require-settled")[0] == 0
    assert invoke("run", "paper-gravity", "-q")[0] == 0
    code, _, error = invoke("run", "paper-gravity", "-q", "--require-settled")
    assert code == 4
    assert error == "Not settled: paper-gravity: 37.58 px from the goal at the end, above 2 px\n"
    code, _, error = invoke("run", "paper", "-q", "--require-settled", "--set", "metrics.dwell=100")
    assert (code, error) == (4, "Not settled: paper: within 2 px at the end, but for less than 100 s\n")
    diverging = ["run", "paper", "-q", "--set", "controller.jacobian=printed"]
    assert invoke(*diverging)[0] == invoke(*diverging, "--require-settled")[0] == 3


def test_the_meaning_of_the_effort_has_how_moments_count() -> None:
    assert "moments divided by the platform radius" in hs.METRICS["effort"][1]  # docs/model.md section 8


def test_a_comparison_that_has_to_settle_counts_the_runs_that_do_not() -> None:
    arguments = ["compare", "--scenarios", "paper,paper-gravity", "--laws", "hybrid,composite", "-q"]
    assert invoke(*arguments)[0] == 0
    code, _, error = invoke(*arguments, "--require-settled")
    assert (code, error) == (4, "Not settled: 1 of 4 runs\n")
    assert invoke("compare", "--scenarios", "paper", "--laws", "hybrid", "-q", "--require-settled")[0] == 0


@pytest.mark.parametrize("moment", ["loading", "preparing"])
def test_a_comparison_that_is_interrupted_early_counts_its_runs(moment: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    target = "hexservo.cli.commands.load" if moment == "loading" else "hexservo.run.compare._prepared"
    monkeypatch.setattr(target, interrupted)
    code, _, error = invoke("compare", "--scenarios", "paper,paper-gravity", "-q")
    assert (code, error) == (130, "Interrupted: 0 of 12 runs were finished\n")


def test_a_comparison_that_is_interrupted_counts_its_runs(tmp_path: Path) -> None:
    what = ["--scenarios", "unequal-depth-60s,paper,task-*", "--laws", "composite,hybrid,kelly"]
    changes = ["--set", "simulation.duration=3600", "--set", "simulation.log_every=1000"]
    with subprocess.Popen(
        [sys.executable, "-m", "hexservo", "compare", *what, *changes],
        cwd=tmp_path,
        env=environment(OPENBLAS_NUM_THREADS="1"),  # threads of NumPy would be taken for those of the runs
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as run:
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:  # until the runs have begun: its threads are there
            threads = Path(f"/proc/{run.pid}/task")
            if not threads.exists() or len(list(threads.iterdir())) > 1:
                break
            time.sleep(0.05)
        time.sleep(0.2)
        run.send_signal(signal.SIGINT)
        _, error = run.communicate(timeout=60)
    assert run.returncode == 130
    assert re.search(r"^Interrupted: \d+ of 18 runs were finished$", error, re.MULTILINE)


def test_settled_is_one_thing(paper: hs.Scenario) -> None:
    """The row of a comparison and the exit code go by the same metric."""
    row = hs.compare([paper], ["hybrid"]).rows[0]
    assert row.settled == (not math.isnan(hs.metrics(hs.simulate(paper))["settling_time"]))
