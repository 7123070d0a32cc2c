"""The commands report, certify, analyse and diagnose: what they print and write, and their exit codes."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

import hexservo as hs
from hexservo.cli import commands as cli
from hexservo.cli.output import write_results
from hexservo.cli.print_sections import printed
from hexservo.findings.evidence import Column, Curves, Line, Section, Table, as_data
from hexservo.findings.sections import SOURCES
from hexservo.report.documentation import page_path
from hexservo.report.html import TITLE

SHORT = ["--set", "simulation.duration=0.02"]
COMMANDS = ["certify", "analyse", "diagnose"]


class Findings:
    """Findings of a made-up judge."""

    def __init__(self, judged: object) -> None:
        self.judged = judged

    def sections(self) -> list[Section]:
        columns = (Column("direction"), Column("value", "px/mm", ".3f"), Column("holds"))
        table = Table(
            "Values", columns, [("[red]along x", -1.5, True), ("none", None, False)], "A note.", "docs/model.md"
        )
        line = Line("V", np.arange(3.0), np.arange(3.0))
        curves = Curves("V over time", "time [s]", "V [J]", [line])
        return [
            Section(
                "one", "Theme one", [f"Judged: {type(self.judged).__name__}.", "More."], [table, curves], "warning"
            ),
            Section("two", "Theme two", ["Does not apply."]),
        ]

    def to_dict(self) -> dict[str, Any]:
        return {"one": as_data({"rise": np.float64(1.5), "none": np.nan, "per_axis": np.arange(2.0)})}


@pytest.fixture(autouse=True)
def made_up(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in COMMANDS:
        replace_judge(monkeypatch, name, Findings)


def replace_judge(monkeypatch: pytest.MonkeyPatch, name: str, find: Callable[[Any], Any]) -> None:
    monkeypatch.setitem(SOURCES, name, dataclasses.replace(SOURCES[name], find=find))


def invoke(*arguments: str | Path) -> tuple[int, str, str]:
    done = CliRunner().invoke(cli.app, [str(argument) for argument in arguments], prog_name="hexservo")
    assert done.exception is None or isinstance(done.exception, SystemExit)
    return done.exit_code, done.stdout, done.stderr


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hexservo.draw.plots.paper_images", lambda _: {})
        run = hs.simulate(hs.load_scenario("paper").updated({"simulation.duration": 0.02}))
        return write_results(run, tmp_path_factory.mktemp("saved") / "out") / "result.nc"


# ---- certify, analyse, diagnose -------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", COMMANDS)
def test_sections_are_printed_in_words_and_tables(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, error = invoke(command, "paper", *SHORT)
    assert (code, error) == (0, "")
    judged = "Scenario" if command == "analyse" else "Result"
    assert out.splitlines() == [
        "Theme one: warning",
        f"Judged: {judged}.",
        "More.",
        "",
        "Values",
        "                value",
        "direction     [px/mm]  holds",
        "[red]along x   -1.500  yes",
        "none                -  no",
        "A note.",
        f"Explained in {page_path('docs/model.md')}",
        "",
        "V over time: a figure, drawn in a notebook, and of a run by `hexservo report`",
        "",
        "Theme two: not applicable",
        "Does not apply.",
    ]


def test_results_that_nothing_judges_have_no_verdict() -> None:
    table = Table("Values", [Column("index")], [(0.5,)])
    heads = [str(next(printed([Section("one", "Theme", ["Words."], items)]))) for items in ([], [table])]
    assert heads == ["Theme: not applicable", "Theme"]


def test_the_page_that_explains_is_named_where_it_is_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    installed = page_path("docs/model.md")
    assert installed is not None
    assert installed.is_absolute()
    assert installed.read_text(encoding="utf-8").startswith("# ")
    monkeypatch.chdir(tmp_path)
    compared = invoke("compare", "--scenarios", "paper", "--laws", "hybrid", *SHORT)[1]
    assert f"columns are explained in {page_path('docs/compare.md')}\n" in compared
    monkeypatch.chdir(installed.parents[1])
    assert "Explained in docs/model.md" in invoke("analyse", "paper")[1].splitlines()
    assert page_path("docs/" + "missing.md") is None


@pytest.mark.parametrize("command", ["diagnose", "certify", "analyse"])
@pytest.mark.parametrize("name", ["log.csv", "a log.mcap"])
def test_a_log_without_its_machine_is_told_how_to_name_it(
    command: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path(name).write_text("time,command_1\n", encoding="utf-8")
    code, out, error = invoke(command, name)
    assert (code, out) == (2, "")
    quoted = name if " " not in name else f"'{name}'"
    told = f"{name}: this is a log; name its machine: hexservo diagnose {quoted} --machine SCENARIO"
    assert told in " ".join(error.split())
    assert "this is a log" not in invoke(command, "none.csv")[2]


@pytest.mark.parametrize("command", ["run", "check", "show"])
def test_a_saved_result_in_place_of_a_scenario_is_recognised(command: str, saved: Path) -> None:
    assert invoke(command, saved)[2] == (
        f"Error: {saved}: expected YAML, got a netCDF or HDF5 file; a saved result is read by report, certify, analyse "
        "and diagnose, and its scenario is scenario.yaml beside it\n"
    )


@pytest.mark.parametrize(
    ("command", "names"),
    [
        (["run"], "scenario.yaml"),
        (["check"], "scenario.yaml"),
        (["certify"], "scenario.yaml result.nc"),
        (["analyse"], "scenario.yaml result.nc"),
        (["certify", "--set", "camera.noise=1"], "scenario.yaml"),  # no saved result can be changed
        (["campaign", "--out", "new"], ""),
    ],
)
def test_of_the_folder_of_a_run_the_files_that_a_command_reads_are_named(
    command: list[str], names: str, saved: Path
) -> None:
    folder = saved.parent
    files = " or ".join(str(folder / name) for name in names.split())
    hint = f"; name a file in it: {files}" if files else ""
    assert invoke(command[0], folder, *command[1:])[2] == (
        f"Error: {folder}: cannot be read: expected a regular file, got a folder{hint}\n"
    )


def test_of_the_folder_of_a_run_a_result_is_loaded_from_its_file(saved: Path) -> None:
    with pytest.raises(hs.ResultError, match=f"got a folder; name a file in it: {re.escape(str(saved))}$"):
        hs.load_result(saved.parent)


@pytest.mark.parametrize("command", [*COMMANDS, "report"])
def test_help_lists_what_a_command_reads(command: str) -> None:
    shown = " ".join(word for word in invoke(command, "--help")[1].split() if word != "│")
    assert '"-" for a scenario on standard input' in shown
    assert ("a log (CSV or MCAP, with --machine)" in shown) == (command == "diagnose")


@pytest.mark.parametrize("command", COMMANDS)
def test_numbers_on_standard_output(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing else is there, for a pipe to another program, and they are those of a file."""
    monkeypatch.chdir(tmp_path)
    code, out, _ = invoke(command, "paper", *SHORT, "--json", "-")
    assert code == 0
    assert invoke(command, "paper", *SHORT, "--json", "numbers.json")[0] == 0
    assert out == Path("numbers.json").read_text(encoding="utf-8")
    assert not Path("-").exists()


@pytest.mark.parametrize("command", COMMANDS)
def test_numbers_as_json(command: str, tmp_path: Path) -> None:
    file = tmp_path / "numbers.json"
    assert invoke(command, "paper", *SHORT, "--json", file)[0] == 0
    written = file.read_text(encoding="utf-8")
    assert json.loads(written) == {
        f"hexservo {command}": 1,
        "version": hs.__version__,
        "one": {"rise": 1.5, "none": None, "per_axis": [0.0, 1.0]},
    }
    code, out, error = invoke(command, "paper", *SHORT, "--json", file)
    assert (code, out) == (2, "")  # reported before the work
    assert "the file exists" in error
    assert invoke(command, "paper", *SHORT, "--json", file, "--force")[0] == 0
    assert file.read_text(encoding="utf-8") == written
    file.write_text("{}")
    code, _, error = invoke(command, "paper", *SHORT, "--json", file, "--force")
    assert code == 2
    assert f"was not written by `hexservo {command}`, so it is kept" in error
    assert file.read_text() == "{}"


@pytest.mark.parametrize("command", COMMANDS)
def test_a_run_that_a_judge_refuses_is_bad_input(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: object) -> None:
        raise ValueError("controller.law: expected hybrid, got kelly")

    replace_judge(monkeypatch, command, refuse)
    code, out, error = invoke(command, "paper", *SHORT)
    assert (code, out, error) == (2, "", "Error: controller.law: expected hybrid, got kelly\n")


def test_a_saved_result_is_judged_too(saved: Path) -> None:
    for command in COMMANDS:
        code, out, _ = invoke(command, saved)
        assert code == 0
        assert f"Judged: {'Scenario' if command == 'analyse' else 'Result'}." in out


def test_the_weights_are_logged_for_the_judge(monkeypatch: pytest.MonkeyPatch) -> None:
    judged: list[hs.Result] = []

    def judge(result: hs.Result) -> Findings:
        judged.append(result)
        return Findings(result)

    replace_judge(monkeypatch, "certify", judge)
    invoke("certify", "paper", *SHORT)
    assert judged[0].weight_history is not None
    assert judged[0].weight_history.shape == (21, 6, 7, 7)


def test_exit_codes_are_those_of_a_run() -> None:
    diverging = ["paper", "--set", "controller.jacobian=printed"]
    for command in ("certify", "diagnose"):
        code, out, error = invoke(command, *diverging)
        assert code == 3
        assert "Theme one" in out
        assert error == "Ended early: paper: diverged: a feature error exceeded 10000 px at t = 0.041 s\n"
    assert invoke("analyse", *diverging)[0] == 0  # nothing was run


def test_a_section_in_a_narrow_terminal_is_not_cut() -> None:
    from rich.console import Console

    console = Console(width=30, record=True, file=None, color_system=None)
    with console.capture() as capture:
        for part in printed(Findings(None).sections()):
            console.print(part)
    text = capture.get()
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= 30


# ---- report ---------------------------------------------------------------------------------------------------------


def test_a_table_too_wide_for_the_terminal_is_a_list(monkeypatch: pytest.MonkeyPatch) -> None:
    columns = (Column("direction"), Column("smallest eigenvalue", "1/s^2", ".4g"), Column("reachable"))
    table = Table("Values", columns, [("force x", -0.000264, True), ("moment y", None, False)])
    wide = len("direction") + 2 + len("eigenvalue") + 2 + len("reachable")
    for columns_there, lines in (
        (wide, ["direction [1/s^2] reachable", "force x -0.000264 yes"]),
        (
            wide - 1,
            ["direction: force x", "  smallest eigenvalue: -0.000264 1/s^2", "  reachable: yes", "direction: moment y"],
        ),
    ):
        monkeypatch.setattr("hexservo.cli.print_sections.width", lambda there=columns_there: there)
        console = Console(width=45, file=(shown_there := StringIO()))
        for part in printed([Section("one", "Theme", ["Words."], [table])]):
            console.print(part)
        shown = [" ".join(line.split()) for line in shown_there.getvalue().splitlines()]
        assert {" ".join(line.split()) for line in lines} <= set(shown), shown


def test_a_report_of_a_scenario_and_of_its_result_are_the_same(saved: Path, tmp_path: Path) -> None:
    code, out, error = invoke("report", "paper", *SHORT, "--out", tmp_path / "a.html")
    assert (code, error) == (0, "")
    assert out.startswith(f"{tmp_path / 'a.html'}: report of paper, made in ")
    assert invoke("report", saved, "--out", tmp_path / "b.html")[0] == 0
    first = (tmp_path / "a.html").read_bytes()
    assert first == (tmp_path / "b.html").read_bytes()
    assert first.startswith(TITLE.encode())
    assert b"Theme one" in first


def test_a_report_is_replaced_with_force_alone(saved: Path, tmp_path: Path) -> None:
    out = tmp_path / "r.html"
    out.write_text("mine")
    for more in ([], ["--force"]):
        code, _, error = invoke("report", saved, "--out", out, *more)
        assert code == 2
        assert "was not written by `hexservo report`" in error
        assert out.read_text() == "mine"
    out.unlink()
    assert invoke("report", saved, "--out", out)[0] == 0
    assert invoke("report", saved, "--out", out)[0] == 2
    assert invoke("report", saved, "--out", out, "--force")[0] == 0


def test_a_report_that_cannot_be_written_is_reported_before_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hs, "simulate", lambda *_, **__: pytest.fail("it ran"))
    code, _, error = invoke("report", "paper", "--out", tmp_path / "none" / "r.html")
    assert code == 2
    assert "expected a folder that exists" in error


def test_a_run_that_ends_early_is_reported(tmp_path: Path) -> None:
    code, out, error = invoke("report", "paper", "--set", "controller.jacobian=printed", "-o", tmp_path / "r.html")
    assert code == 3
    assert "report of paper" in out
    assert error.startswith("Ended early: paper: diverged")
    assert "diverged" in (tmp_path / "r.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("command", ["report", *COMMANDS])
def test_bad_input(command: str, saved: Path, tmp_path: Path) -> None:
    more: list[str | Path] = ["--out", tmp_path / "r.html"] if command == "report" else []
    code, out, error = invoke(command, saved, "--set", "seed=1", *more)
    assert (code, out) == (2, "")
    assert "--set: expected a scenario, got a saved result" in error
    (tmp_path / "x.nc").write_bytes(b"none")
    code, out, error = invoke(command, tmp_path / "x.nc", *more)
    assert (code, out) == (2, "")
    assert "expected a result that hexservo saved, got another kind of file" in error
    code, out, error = invoke(command, "papr", *more)
    assert (code, out) == (2, "")
    assert "paper" in error
    assert not (tmp_path / "r.html").exists()
