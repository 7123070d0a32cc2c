"""The recipes of CONTRIBUTING.md: the files that they name exist, and following them in a copied tree works.

A key and a law need a compiler, so for these the files of a present one are checked. A cause of a diagnosis and an
analysis are added to a copy of the tree; the tests fail for each step that is missing.
"""

from __future__ import annotations

import ast
import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import hexservo as hs
from hexservo.findings.diagnosis.causes import CAUSES
from test_docs import ROOT, tables_in

ROOTS = (ROOT, ROOT / "cpp" / "include", ROOT / "cpp" / "include" / "hexservo", ROOT / "python" / "hexservo")
RECIPES = dict(
    re.findall(
        r"^- \*\*An? ([\w ]+)\*\*: (.+?)(?=\n- \*\*|\n\n)",
        (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"),
        re.MULTILINE | re.DOTALL,
    )
)
PRESENT = {
    "key of a scenario": "latency_jitter",
    "law": "kelly",
    "metric": "peak_line_deviation",
    "cause of a diagnosis": "late_camera",
    "analysis": "workspace",
}


def named_files(recipe: str) -> list[str]:
    """Files and folders that a recipe names, with the name of its example in place of ``<name>`` or ``<law>``."""
    text = re.sub(r"<\w+>", PRESENT[recipe], RECIPES[recipe])
    return [name for name in re.findall(r"`([\w./]+(?:\.\w+|/))`", text) if "/" in name or (ROOT / name).exists()]


def texts_of(name: str) -> dict[Path, str]:
    """Return the contents of a file, or of the files below a folder."""
    places = {path.resolve() for root in ROOTS if (path := root / name).exists()}
    assert len(places) == 1, f"{name}: expected one such file, got {len(places)}"
    place = places.pop()
    files = [place] if place.is_file() else [path for path in place.rglob("*.*") if path.suffix not in (".pyc", ".so")]
    return {path: path.read_text(encoding="utf-8") for path in files}


def test_there_are_five_recipes() -> None:
    assert set(RECIPES) == set(PRESENT)


@pytest.mark.parametrize("recipe", PRESENT)
def test_files_that_a_recipe_names_have_its_example(recipe: str) -> None:
    """Each named file has the example by its name, with underscores or hyphens or in CamelCase."""
    example = PRESENT[recipe]
    names = {example, example.replace("_", "-"), example.replace("_", "").lower()}
    named = named_files(recipe)
    assert len(named) >= 3
    for file in named:
        texts = texts_of(file)
        found = any(name in path.name.lower() or name in text.lower() for path, text in texts.items() for name in names)
        assert found, f"the recipe for a {recipe} names {file}, which does not mention {example}"


def test_a_metric_has_its_rows() -> None:
    """The core's list, its binding and stub, Python's list, the specification and the values by hand name the same."""
    header = (ROOT / "cpp" / "include" / "hexservo" / "metrics.hpp").read_text(encoding="utf-8")
    block = header[header.index("struct Metrics {") :]
    line = r"v\(MetricName\{\"(\w+)\", MetricGroup::\w+\}, self\.\1\.\.\.\);"
    listed = re.findall(line, block[: block.index("\n};")])
    assert listed == list(hs.METRICS)
    binding = (ROOT / "cpp" / "bindings" / "bind_simulation.cpp").read_text(encoding="utf-8")
    stub = (ROOT / "python" / "hexservo" / "_core.pyi").read_text(encoding="utf-8")
    tree = ast.parse((ROOT / "tests" / "python" / "test_known_results.py").read_text(encoding="utf-8"))
    by_hand = {
        key.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Dict)
        for key in node.keys
        if isinstance(key, ast.Constant) and key.value in hs.METRICS
    }
    assert by_hand == set(hs.METRICS)
    rows = {
        row[0]: row for _, table in tables_in((ROOT / "docs" / "model.md").read_text(encoding="utf-8")) for row in table
    }
    for name, (unit, _) in hs.METRICS.items():
        assert f'"{name}"' in binding
        assert f"def {name}(self)" in stub
        written = rows[f"`{name}`"][-1].replace("\u00b2", "^2")
        assert written == unit, name


# ---- Copies of the tree ---------------------------------------------------------------------------------------------


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A copy of the tree, with links to the compiled modules."""
    root = tmp_path / "tree"
    for name in ("python", "docs", "tests", "examples", "cpp"):
        shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("*.so", "__pycache__", "fuzz"))
    for file in ROOT.glob("*.*"):
        if file.is_file():
            shutil.copy(file, root)
    core = importlib.util.find_spec("hexservo._core")
    assert core is not None
    assert core.origin is not None
    for module in Path(core.origin).parent.glob("_core*.so"):
        (root / "python" / "hexservo" / module.name).symlink_to(module.resolve())
    return root


def python(tree: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Python with the copied package."""
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree / "python"), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


def failures(tree: Path, *tests: str) -> str:
    """Run tests of the copied tree; return what they print, empty if all pass."""
    run = python(tree, "-m", "pytest", "-q", "-p", "no:cacheprovider", *(f"tests/python/{test}" for test in tests))
    assert run.returncode in (0, 1), run.stdout + run.stderr
    return run.stdout if run.returncode else ""


def assert_passes(tree: Path, *tests: str) -> None:
    found = failures(tree, *tests)
    assert not found, "\n".join(line for line in found.splitlines() if line.startswith(("E ", "FAILED")))


def insert(file: Path, after: str, text: str) -> None:
    """Insert text behind the only place of another."""
    content = file.read_text(encoding="utf-8")
    assert content.count(after) == 1, f"{file}: {after!r}"
    file.write_text(content.replace(after, after + text), encoding="utf-8")


DOCS = "docs"  # apart, since the page of this analysis is made up: test_docs.py looks for every page that is cited
PAGE = """# {title}

## What it is

The {what} of a scenario, as an example of a page.

## Formula

It is what the core returns.

## Source

The example is *ours*.

## Limits

It has no meaning beyond this test.

## How it is tested

The numbers of the core are compared with those by hand: [{test}](../../tests/python/{file}).
"""

LEGS = '''"""Lengths of the legs at home (DOCS/analysis/legs.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hexservo.findings.part import Part
from hexservo.findings.analysis.scene import scene_of
from hexservo.scenario.arrays import Array
from hexservo.scenario.scenario import Scenario


@dataclass(frozen=True, eq=False, repr=False)
class Legs(Part):
    """Lengths of the legs at home."""

    lengths: Array  # (6,) [m]


def analyse(scenario: Scenario) -> Legs:
    """Return the lengths of the legs at home."""
    return Legs(np.array(scene_of(scenario).hexapod.home_lengths))
'''

LEGS_WORDS = '''"""The lengths of the legs at home as a sentence and a table (DOCS/analysis/legs.md)."""

from __future__ import annotations

from hexservo.findings.analysis.legs import Legs
from hexservo.findings.analysis.words import numbers
from hexservo.findings.evidence import Column, Section, Table


def section(found: Legs) -> Section:
    """Return the lengths of the legs at home as a sentence and a table."""
    table = Table("Legs at home", [Column("length", "m")], [[x] for x in found.lengths], page="DOCS/analysis/legs.md")
    sentence = f"At home the legs are {numbers(1e3 * found.lengths)} mm long."
    return Section("legs", "Legs at home", [sentence], [table], "good", {"lengths": found.lengths})
'''

LEGS_TEST = '''"""Lengths of the legs at home, by hand."""

import numpy as np
import pytest

import hexservo as hs


def test_lengths_by_hand() -> None:
    """A leg of `micro` is sqrt(r_p^2 + r_b^2 - 2 r_p r_b cos(angle between its joints) + z^2) long."""
    scenario = hs.load_scenario("paper")
    robot = scenario.robot
    angle = np.array(robot.platform_angles) - np.array(robot.base_angles)
    p, b, z = robot.platform_radius, robot.base_radius, robot.home_position[2]
    lengths = np.sqrt(p**2 + b**2 - 2 * p * b * np.cos(angle) + z**2)
    assert hs.analyse(scenario, ["legs"]).legs.lengths == pytest.approx(lengths, rel=1e-12)
'''


@pytest.mark.slow
def test_an_analysis_is_added_by_its_recipe(tree: Path) -> None:
    folder = tree / "python" / "hexservo" / "findings" / "analysis"
    (folder / "legs.py").write_text(LEGS.replace("DOCS", DOCS), encoding="utf-8")
    insert(
        folder / "__init__.py",
        '"workspace": ("workspace", "reach, singularities and loads of the legs"),\n',
        '    "legs": ("legs", "lengths of the legs at home"),\n',
    )
    order = "test_packages.py::test_numbers_of_findings_do_not_depend_on_their_words"
    assert "legs_words" in failures(tree, order)
    (folder / "legs_words.py").write_text(LEGS_WORDS.replace("DOCS", DOCS), encoding="utf-8")
    assert_passes(tree, order)

    assert f"{DOCS}/analysis/legs.md" in failures(tree, "test_evidence_pages.py")
    test = "test_analysis_legs.py"
    page = PAGE.format(title="Legs at home", what="lengths", test=f"{test}::test_lengths_by_hand", file=test)
    (tree / "docs" / "analysis" / "legs.md").write_text(page, encoding="utf-8")
    assert test in failures(tree, "test_evidence_pages.py")
    (tree / "tests" / "python" / test).write_text(LEGS_TEST, encoding="utf-8")
    assert "docs/proof.md has no link" in failures(tree, "test_evidence_pages.py")
    insert(
        tree / "docs" / "proof.md",
        "| question | quantity | kind | page |\n| --- | --- | --- | --- |\n| How observable",
        " is the pose from one image? | | exact computation | [legs](analysis/legs.md) |\n| How observable",
    )
    assert_passes(tree, "test_evidence_pages.py", test, "test_packages.py::test_imports_go_downwards")

    shown = python(tree, "-m", "hexservo", "analyse", "paper").stdout
    assert "At home the legs are" in shown
    assert "Legs at home" in shown


CAUSE = """
    Cause("exposure", "frames that are too rare", _keys("camera.period"), _exposure),"""

FAULT = """    "exposure": (
        Fault({"camera.period": Choice((0.020, 0.033))}, laws=("hybrid",), cameras=("every_tick",)),
    ),
"""

EXPOSURE = """
def _exposure(case: Case) -> list[Removal]:
    step = case.scenario.simulation.step
    if not case.sampled or frame_period(case.scenario) <= step:
        return []
    return [Removal("a frame at every servo tick", {"camera.period": step})]


"""


@pytest.mark.slow
def test_a_cause_is_added_by_its_recipe(tree: Path) -> None:
    devices = tree / "python" / "hexservo" / "findings" / "diagnosis" / "devices.py"
    text = devices.read_text(encoding="utf-8")
    text = text.replace("\n\ndef _late_camera", f"\n{EXPOSURE}def _late_camera", 1)
    devices.write_text(text, encoding="utf-8")
    insert(devices, "DEVICES: tuple[Cause, ...] = (", CAUSE)
    tests = (
        "test_diagnosis.py::test_faults_are_drawn_from_ranges_and_repeat_by_their_seed",
        "test_diagnosis.py::test_each_cause_has_a_page",
        "test_diagnosis.py::test_each_page_has_its_headings",
        "test_counts.py",
    )
    found = failures(tree, *tests)
    assert "4 failed" in found, found

    insert(
        tree / "tests" / "python" / "diagnosis_faults.py",
        "FAULTS: dict[str, tuple[Fault, ...]] = {\n",
        FAULT,
    )
    assert_passes(tree, tests[0])
    page = "# Cause: frames that are too rare\n" + PAGE.format(
        title="", what="camera period", test="test_diagnosis.py::test_each_cause_has_a_page", file="test_diagnosis.py"
    ).removeprefix("# \n")
    (tree / "docs" / "diagnosis" / "exposure.md").write_text(page, encoding="utf-8")
    insert(
        tree / "docs" / "diagnosis" / "ranking.md",
        "| cause | title | kind | page |\n| --- | --- | --- | --- |\n",
        "| `exposure` | frames that are too rare | device | [exposure](exposure.md) |\n",
    )
    assert_passes(tree, *tests[:3])
    for name in ("README.md", "docs/diagnosis/ranking.md"):
        file = tree / name
        counted = re.sub(rf"\b{len(CAUSES)}\b(?= causes|, with)", str(len(CAUSES) + 1), file.read_text("utf-8"))
        file.write_text(counted, encoding="utf-8")
    assert_passes(tree, *tests)

    program = (
        "import hexservo as hs; found = hs.diagnose(hs.simulate(hs.load_scenario('fails-late-camera')));"
        "print([finding.cause for finding in found.causes])"
    )
    assert "'exposure'" in python(tree, "-c", program).stdout
