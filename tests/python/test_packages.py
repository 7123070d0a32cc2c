"""The packages of hexservo: imports go downwards only, and modules stay small."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence

import pytest

import hexservo as hs
from hexservo.findings.analysis import PARTS
from packages import PACKAGES, PICTURE, ROOT, SOURCES, Import, imports, module_name, package_of, picture, tree_of

MOST_LINES = 500
TOP = {"", "plots", "__main__"}  # the public names: hexservo itself and hexservo.plots


def level(module: str) -> int:
    """The public names stand above what they name, and below the commands, which use them as everybody does."""
    if module.startswith("_core"):
        return -1
    if package := package_of(module):
        return 2 * PACKAGES.index(package)
    assert module in TOP, f"{module} is in none of the packages {', '.join(PACKAGES)}"
    return 2 * len(PACKAGES) - (1 if module == "__main__" else 3)


def upward(found: Sequence[Import]) -> list[str]:
    return [
        f"{a.module}:{a.line}: imports {a.source}, a level above" for a in found if level(a.source) > level(a.module)
    ]


def test_imports_go_downwards() -> None:
    """Also those within functions, and those for type checkers: a reader of an annotation looks its class up."""
    assert upward(imports(SOURCES)) == []
    assert upward([Import("run.batch", "draw.batch", "batch_figure", 1)]), "the check finds nothing"


def circle(found: Sequence[Import]) -> list[str]:
    """A circle of imports between modules, or an empty list. Imports for type checkers alone run nowhere: two modules
    of one package may name each other's types."""
    below: dict[str, set[str]] = {}
    for each in found:
        if each.source != each.module and not each.for_types:
            below.setdefault(each.module, set()).add(each.source)
    done: set[str] = set()

    def walk(module: str, way: list[str]) -> list[str]:
        if module in way:
            return [*way[way.index(module) :], module]
        if module not in done:
            for source in sorted(below.get(module, ())):
                if around := walk(source, [*way, module]):
                    return around
            done.add(module)
        return []

    return next((around for module in sorted(below) if (around := walk(module, []))), [])


def test_no_import_circles() -> None:
    assert circle(imports(SOURCES)) == []
    pairs = [Import("a", "b", "", 1), Import("b", "c", "", 1), Import("c", "a", "", 1)]
    assert circle(pairs) == ["a", "b", "c", "a"]


def parts_of_findings() -> list[str]:
    """Modules with a class of base Part: the numbers of findings."""
    return [
        each.module
        for each in imports(SOURCES)
        if (each.source, each.name) == ("findings.part", "Part") and each.module.startswith("findings.")
    ]


def test_numbers_of_findings_do_not_depend_on_their_words() -> None:
    """`x` computes, `x_words` makes sentences of what it returns; nothing that `x` imports makes tables."""
    assert parts_of_findings()
    sources: dict[str, set[str]] = {}
    for each in imports(SOURCES):
        sources.setdefault(each.module, set()).add(each.source)
    for module in parts_of_findings():
        words, used = f"{module}_words", sources[module]
        assert module in sources[words], f"{words} does not import {module}"
        assert "section" in functions_of(words)
        assert not [source for source in used if source.endswith("words")]
        assert not used & wording(), f"{module} imports {used & wording()}, which make tables"


def wording() -> set[str]:
    return {each.module for each in imports(SOURCES) if each.source == "findings.evidence" and each.name == "Table"}


def test_only_words_make_tables() -> None:
    """Below the packages that draw: tables are made by modules of words."""
    assert {module for module in wording() if module.startswith("findings.")} - {"findings.wording"} == {
        f"{module}_words" for module in parts_of_findings()
    }


def test_every_analysis_has_numbers_and_words() -> None:
    assert {f"findings.analysis.{module}" for module, _ in PARTS.values()} <= set(parts_of_findings())


def functions_of(module: str) -> set[str]:
    tree = tree_of(SOURCES / f"{module.replace('.', '/')}.py")
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_no_private_name_leaves_its_module() -> None:
    private = [
        f"{each.module}:{each.line}: imports {each.source}.{each.name}"
        for each in imports(SOURCES)
        if any(part.startswith("_") for part in (*each.source.split("."), each.name) if not part.startswith("_core"))
        and not each.name.startswith("__")
    ]
    assert private == []


@pytest.mark.parametrize("package", ["", *PACKAGES])
def test_module_names_have_no_underscore_in_front(package: str) -> None:
    files = (SOURCES / package).glob("*.py") if not package else (SOURCES / package).rglob("*.py")
    names = [module_name(path) for path in files]
    assert not [name for name in names if any(p.startswith("_") for p in name.split(".")) and name != "__main__"]


def test_no_long_files() -> None:
    lengths = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in SOURCES.rglob("*.py")}
    assert {path.relative_to(SOURCES).as_posix(): n for path, n in lengths.items() if n > MOST_LINES} == {}


def test_tests_that_start_threads_run_under_the_thread_sanitizer() -> None:
    presets = json.loads((ROOT / "CMakePresets.json").read_text())
    targets = next(preset["targets"] for preset in presets["buildPresets"] if preset["name"] == "tsan")
    run = next(preset["filter"]["include"]["name"] for preset in presets["testPresets"] if preset["name"] == "tsan")
    starting = {path.stem for path in ROOT.glob("tests/cpp/test_*.cpp") if re.search(r"\bthreads\b", path.read_text())}
    assert set(targets) == starting
    assert run == f"^({'|'.join(targets)})$"


def test_no_two_classes_of_one_name() -> None:
    """But for the blocks of a scenario, which are named after their keys."""
    names = Counter(
        node.name
        for path in SOURCES.rglob("*.py")
        if path.name not in ("blocks.py", "drives.py", "laws.py") or path.parent.name != "scenario"
        for node in tree_of(path).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    assert {name for name, count in names.items() if count > 1} == set()


def test_no_two_functions_of_one_name() -> None:
    """Below the packages that draw. `analyse` and `section` are what every part of an analysis has."""
    names = Counter(
        node.name
        for package in PACKAGES[: PACKAGES.index("draw")]
        for path in (SOURCES / package).rglob("*.py")
        for node in tree_of(path).body
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_") and not node.decorator_list
    )
    assert {name for name, count in names.items() if count > 1} == {"analyse", "section"}


def test_array_types_have_one_home() -> None:
    """`Array`, `Complex` and `Mask` are defined in scenario/arrays.py and nowhere else."""
    aliases = {
        path.relative_to(SOURCES).as_posix()
        for path in SOURCES.rglob("*.py")
        for node in tree_of(path).body
        if isinstance(node, ast.Assign | ast.AnnAssign)
        and node.value is not None
        and ast.unparse(node.value).startswith("NDArray[")
    }
    assert aliases == {"scenario/arrays.py"}


def test_public_names_are_listed_once_and_there() -> None:
    """The names that `hexservo` lists, imports for type checkers, and imports when they are used are the same.

    mypy refuses comments that it does not need, so that type checkers refuse other names too.
    """
    tree = tree_of(SOURCES / "__init__.py")
    typed = {(each.source, each.name) for each in imports(SOURCES) if each.module == "" and each.for_types}
    table = ast.literal_eval(
        next(
            node.value
            for node in tree.body
            if isinstance(node, ast.Assign)
            and isinstance(node.targets[0], ast.Name)
            and node.targets[0].id == "_MODULES"
        )
    )
    assert typed == {(module, name) for module, names in table.items() for name in names} | {
        ("bridges", ""),
        ("plots", ""),
    }
    assert set(hs.__all__) == {name for _, name in typed if name} | {"bridges", "plots", "__version__"}
    assert all(getattr(hs, name) is not None for name in hs.__all__)
    with pytest.raises(AttributeError, match="no attribute 'simulat'"):
        hs.simulat  # type: ignore[attr-defined]  # noqa: B018
    with pytest.raises(AttributeError, match="no attribute 'mjfc'"):
        hs.bridges.mjfc  # type: ignore[attr-defined]  # noqa: B018


def test_importing_hexservo_imports_nothing_heavy() -> None:
    heavy = ("numpy", "pydantic", "scipy", "matplotlib", "xarray", "pandas", "typer", "yaml")
    program = f"import sys, hexservo; print([name for name in {heavy} if name in sys.modules])"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout == "[]\n"


def test_campaigns_and_searches_start_without_modules_that_few_of_them_need() -> None:
    """SciPy's optimisation is for anytime intervals, its rotations for targets that are displaced by one."""
    program = (
        "import sys, hexservo.campaigns.engine, hexservo.campaigns.tuning; "
        "print([name for name in ('scipy.optimize', 'scipy.spatial', 'scipy.stats') if name in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout == "[]\n"


# The process sends itself SIGINT when a module is first looked for: every moment is met exactly.
INTERRUPTED_AT = """
import os, signal, sys
WANTED = sys.argv[1]
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == WANTED:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
from hexservo.cli import main
sys.argv = ["hexservo", "version"]
main()
"""


@pytest.mark.parametrize(
    "module", ["hexservo.cli.commands", "typer", "hexservo.cli.evidence", "hexservo.scenario.laws", "numpy", "pydantic"]
)
def test_ctrl_c_while_the_command_line_is_imported(module: str) -> None:
    run = subprocess.run([sys.executable, "-c", INTERRUPTED_AT, module], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stdout, run.stderr) == (130, "", "Interrupted\n")


def test_ctrl_c_that_the_caller_ignores_stays_ignored() -> None:
    program = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\n" + INTERRUPTED_AT
    run = subprocess.run([sys.executable, "-c", program, "typer"], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout.startswith(f"hexservo:  {hs.__version__}")


def test_the_picture_is_that_of_the_sources() -> None:
    assert PICTURE.read_text(encoding="utf-8") == picture(SOURCES), "type: python docs/tools/packages.py"


def test_the_arrows_are_within_the_picture() -> None:
    """A cubic with its control points in one column goes 3/4 of the way to them."""
    text = picture(SOURCES)
    width = float(re.findall(r'viewBox="0 0 (\d+) ', text)[0])
    bows = [(float(start), float(bow)) for start, bow in re.findall(r"M([-\d.]+),[-\d.]+ C([-\d.]+),", text)]
    assert bows
    assert all(0.0 < start + 0.75 * (bow - start) < width for start, bow in bows)
