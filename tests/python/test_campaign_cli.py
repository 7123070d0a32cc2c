"""The command `hexservo campaign`, its page, and the packaged campaigns in short form."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from scipy.stats import binom

import hexservo as hs
from hexservo.campaigns.plan import CampaignPlan, load_plan
from hexservo.scenario.yaml import load_yaml
from test_cli import environment
from test_readme import ROOT, examples, output_of
from test_terminal import assert_fit_for_a_terminal, invoke

PAGE = ROOT / "docs" / "campaigns.md"
RESULTS = ROOT / "docs" / "robustness.md"
SHORT = ["--set", "simulation.duration=0.6", "--set", "metrics.dwell=0.1", "--set", "metrics.band=1e-9"]
SHORT += ["--set", "metrics.rms_start=0.1", "--chunk-size", "50"]


def test_a_campaign_is_run_continued_and_enlarged(tmp_path: Path) -> None:
    arguments = ["campaign", "campaign-composite-30hz", "--out", str(tmp_path / "out"), *SHORT]
    code, out, err = invoke(*arguments, "--runs", "100")
    assert (code, err) == (0, "")
    assert_fit_for_a_terminal(out)
    assert "100 of 100 runs fail: the failure probability is between" in out
    assert "100 of 100 runs complete without a value of settling_time, since" in " ".join(out.split())
    assert f"hexservo run {tmp_path}/out/worst-run.yaml" in out
    assert invoke("run", str(tmp_path / "out" / "worst-run.yaml"), "--quiet")[0] == 0
    code, larger, _ = invoke(*arguments, "--runs", "150", "--threads", "1")
    assert (code, "150 of 150 runs fail" in larger, "Clopper" in larger) == (0, True, False)
    assert invoke(*arguments, "--runs", "150", "--quiet") == (0, "", "")


def test_the_command_of_the_worst_run_names_its_file_beside_a_changed_one(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    arguments = ["campaign", "campaign-composite-30hz", "--out", str(folder), *SHORT]
    assert invoke(*arguments, "--runs", "50", "--quiet")[0] == 0
    with (folder / "worst-run.yaml").open("a", encoding="utf-8") as file:
        file.write("# my note\n")
    code, out, _ = invoke(*arguments, "--runs", "100")
    assert code == 0
    named = re.search(r"the run with the smallest margin: hexservo run (\S+)\n", out)
    assert named is not None
    assert hs.load_scenario(named[1]) == hs.load_campaign(folder).worst(1)[0].scenario


@pytest.mark.parametrize(
    ("option", "name"), [("--worst", "worst-case.yaml"), ("--report", "report.html"), ("--pictures", "pictures/a.svg")]
)
def test_a_file_that_would_be_kept_is_refused_before_the_runs(tmp_path: Path, option: str, name: str) -> None:
    folder = tmp_path / "out"
    arguments = ["campaign", "campaign-composite-30hz", "--out", str(folder), *SHORT]
    assert invoke(*arguments, "--runs", "50", "--quiet")[0] == 0
    before = hs.load_campaign(folder).summary
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_text("mine", encoding="utf-8")
    code, out, err = invoke(*arguments, "--runs", "100", option)
    assert (code, out) == (2, "")
    assert name.partition("/")[0] in err
    assert hs.load_campaign(folder).summary == before, "no further run"
    assert (folder / name).read_text(encoding="utf-8") == "mine"
    assert invoke(*arguments, "--runs", "100", "--quiet")[0] == 0, "without the option"


def test_a_short_command_repeats_the_worst_run(tmp_path: Path) -> None:
    lines = "scenario: paper\nvary: {uncertainty.gravity: {uniform: [-0.1, 0.1]}}\nrequire: [outcome == completed]\n"
    (tmp_path / "mass.yaml").write_text(f"{lines}until: {{width_below: 0.9}}\nchunk_size: 2\n", encoding="utf-8")
    code, out, err = invoke("campaign", str(tmp_path / "mass.yaml"), "--out", str(tmp_path / "out"))
    assert (code, err) == (0, "")
    assert re.search(r"margin: hexservo run paper --set 'uncertainty.gravity=-?0\.\d+'\n", out)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["campaign-papr"], 'Error: "campaign-papr": no such file, and no packaged campaign has that name; packaged: '),
        (["campaign-paper", "--runs", "0"], "Error: campaign-paper: runs: expected an integer from 1 to"),
        (["campaign-paper", "--threads", "0"], "Error: threads: expected an integer from 1 to"),
        (["campaign-paper", "--set", "mass"], "Error: --set: expected KEY=VALUE"),
        (
            ["campaign-paper", "--set", "robot.mas=1"],
            'Error: --set: robot.mas: unknown key; did you mean "mass"?',
        ),
        (
            ["campaign-paper-gravity", "--set", "uncertainty.gravity=0.2"],
            "Error: --set: uncertainty.gravity: has no effect, since vary has the key too",
        ),
        (
            ["campaign-papr", "--set", "robot.mass=1"],
            'Error: "campaign-papr": no such file, and no packaged campaign has that name',
        ),
        (
            ["campaign-paper", "--set", "runs=5"],
            "Error: --set: runs: expected a key of the scenario, got one of the campaign; use --runs, or edit the file",
        ),
        (
            ["campaign-paper", "--set", "vary.robot.mass=1"],
            "Error: --set: vary.robot.mass: expected a key of the scenario, got one of the campaign; edit the file",
        ),
        (
            ["campaign-paper", "--set", "uncertainty.gravty=0.1"],
            'Error: --set: uncertainty.gravty: unknown key; did you mean "gravity"?',
        ),
        (
            ["campaign-paper", "--set", "controller.law=kelly", "--set", "controller.law=kely"],
            "controller.law: expected one of",
        ),
    ],
)
def test_bad_input(arguments: list[str], message: str, tmp_path: Path) -> None:
    code, out, err = invoke("campaign", *arguments, "--out", str(tmp_path / "out"))
    assert (code, out) == (2, "")
    assert message in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        (
            "tune.seed=1",
            "Error: --set: tune.seed: expected a key of the scenario, got one of the campaign; use --seed, ",
        ),
        ("robot.mas=1", "Error: --set: robot.mas: unknown key"),
    ],
)
def test_tune_names_the_setting_that_is_wrong(setting: str, message: str, tmp_path: Path) -> None:
    assert message in invoke("tune", "campaign-paper", "--set", setting, "--out", str(tmp_path / "out"))[2]


def test_a_file_that_is_wrong_without_the_settings_is_blamed_itself(tmp_path: Path) -> None:
    file = tmp_path / "wrong.yaml"
    file.write_text("scenario: {name: a}\nvary: {}\nrequire: [outcome == completed]\nruns: 2\n", encoding="utf-8")
    err = invoke("campaign", str(file), "--set", "simulation.duration=1", "--out", str(tmp_path / "out"))[2]
    assert err.startswith(f"Error: {file}: scenario: missing key: target")


def test_damage_is_a_warning(tmp_path: Path) -> None:
    arguments = [
        "campaign",
        "campaign-composite-30hz",
        "--out",
        str(tmp_path / "out"),
        *SHORT,
        "--runs",
        "100",
        "--quiet",
    ]
    assert invoke(*arguments) == (0, "", "")
    chunk = tmp_path / "out" / "chunks" / "000001.parquet"
    chunk.write_bytes(chunk.read_bytes()[:-1])
    code, _, err = invoke(*arguments)
    assert code == 0
    assert err.startswith("Warning: ")
    assert "000001.parquet" in err


def test_ctrl_c_ends_a_campaign_and_keeps_its_runs(tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "hexservo", "campaign", "campaign-composite-30hz", "--out", str(out)]
    process = subprocess.Popen(
        [*command, "--chunk-size", "20"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment()
    )
    limit = time.monotonic() + 120
    while len(list((out / "chunks").glob("*.parquet"))) < 2 and time.monotonic() < limit:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    kept = len(hs.load_campaign(out))
    assert err == f"Interrupted: {kept} of 3000000 runs are kept; the same command goes on\n"
    assert kept >= 40


def test_a_campaign_without_runs_names_the_files_that_are_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign = hs.campaign

    def interrupt(done: int, count: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(hs, "campaign", lambda *given, **options: campaign(*given, **options | {"progress": interrupt}))
    out = tmp_path / "out"
    code, shown, err = invoke("campaign", "campaign-composite-30hz", "--chunk-size", "100000", "--out", str(out))
    assert code == 130
    assert err.startswith("Interrupted: 0 of ")
    assert f"campaign.yaml and summary.json are in {out} (" in shown
    assert sorted(path.name for path in out.iterdir() if path.is_file()) == ["campaign.yaml", "summary.json"]


# ---- The page -------------------------------------------------------------------------------------------------------


def test_the_example_of_the_page_runs(tmp_path: Path) -> None:
    example, _ = examples(PAGE)
    verdict, *_, worst = output_of(example, tmp_path).splitlines()
    assert re.match(r"\d+ of 200 runs fail: the failure probability is between 0\.\d+ and 0\.\d+, ", verdict)
    assert re.match(r"-\d", worst)


@pytest.mark.slow
def test_the_example_of_estimates_runs(tmp_path: Path) -> None:
    _, example = examples(PAGE)
    estimate, most = output_of(example, tmp_path).splitlines()
    assert re.match(r"The failure probability is estimated as 0\.\d+, ", estimate)
    assert most.startswith("uncertainty.")


def test_the_file_of_the_page_is_valid(tmp_path: Path) -> None:
    (text,) = re.findall(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    document = load_yaml(text)
    assert isinstance(document, dict)
    changed = {**document, "scenario": hs.load_scenario("real-machine")}
    plan = CampaignPlan(**changed)
    assert set(plan.vary) == set(document["vary"])  # type: ignore[arg-type]


def test_the_page_has_the_keys_and_the_packaged_campaigns() -> None:
    page = PAGE.read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`.*?`) \|", page, re.MULTILINE)
    named = {name for row in rows for name in re.findall(r"`([\w-]+)`", row)}
    assert named >= set(CampaignPlan.model_fields) - {"record"}
    assert {name for name in named if name.startswith("campaign-")} == set(hs.campaign_names())


# ---- Packaged campaigns ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("runs", [200, pytest.param(10_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", hs.campaign_names())
def test_a_short_form_agrees_with_the_bounds_of_the_long_one(name: str, runs: int, tmp_path: Path) -> None:
    """Runs of a different stream, which the long campaign did not draw, against its interval in docs/robustness.md:
    each tail has a probability above 1e-4 somewhere in it."""
    text = RESULTS.read_text(encoding="utf-8")
    row = re.search(rf"^\| `{name}` \| ([\d ]+) \| ([\d ]+) \| (\S+) \.\.\. (\S+) \|", text, re.MULTILINE)
    assert row is not None, f"{RESULTS.name} has no row of {name}"
    low, high = float(row[3]), float(row[4])
    result = hs.campaign(load_plan(name).changed(stream=20261122, runs=runs), tmp_path / "out")
    assert set(result.summary["outcomes"]) == {"completed"}
    print(f"{name}: {result.failures} of {runs} runs fail; the long campaign has {low} ... {high}")
    assert binom.sf(result.failures - 1, runs, high) > 1e-4
    assert binom.cdf(result.failures, runs, low) > 1e-4


def test_names_of_campaigns_are_no_names_of_scenarios() -> None:
    assert not set(hs.campaign_names()) & set(hs.scenario_names())
