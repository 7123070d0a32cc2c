"""Wheels: finished archives, bills of materials, recipes of make and of a release. `make wheel-test` builds wheels."""

from __future__ import annotations

import base64
import csv
import hashlib
import importlib.metadata
import json
import os
import re
import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import Any

import pytest

import build_wheels
import hexservo as hs
import try_wheels
from hexservo.scenario.yaml import load_yaml

ROOT = Path(__file__).parents[2]
INFO = "hexservo-9.9.9.dist-info"
METADATA = """Metadata-Version: 2.4
Name: hexservo
Version: 9.9.9
License-Expression: BSD-3-Clause
Requires-Dist: numpy>=1.24
Requires-Dist: control>=0.10; extra == "control"
"""
SECONDS = 1_780_000_000


def made(folder: Path, names: list[str]) -> Path:
    """A wheel with its entries in the order of the names."""
    folder.mkdir()
    contents = {
        "hexservo/__init__.py": "x = 1\n",
        "hexservo/_core.so": "machine code",
        f"{INFO}/METADATA": METADATA,
        f"{INFO}/compiled_in.json": '{"eigen": "3.4.0", "pybind11": "3.0.1"}\n',
        f"{INFO}/RECORD": "",
    }
    file = folder / "hexservo-9.9.9-cp311-cp311-manylinux_2_34_x86_64.whl"
    with zipfile.ZipFile(file, "w") as archive:
        for name in names or contents:
            info = zipfile.ZipInfo(name, (2026, 1, 1, 0, 0, len(names)))
            info.external_attr = (0o755 if name.endswith(".so") else 0o600) << 16
            archive.writestr(info, contents[name])
    return file


def names_of(file: Path) -> list[str]:
    with zipfile.ZipFile(file) as archive:
        return archive.namelist()


def test_a_finished_wheel_depends_on_its_contents_alone(tmp_path: Path) -> None:
    first = made(tmp_path / "a", [])
    other = made(tmp_path / "b", names_of(first)[::-1])
    out = [tmp_path / "out", tmp_path / "other"]
    for folder in out:
        folder.mkdir()
    files = [build_wheels.finish(file, folder, SECONDS) for file, folder in zip((first, other), out, strict=True)]
    assert first.read_bytes() != other.read_bytes()
    assert files[0].read_bytes() == files[1].read_bytes()


def test_record_lists_every_file_with_its_digest(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    file = build_wheels.finish(made(tmp_path / "a", []), tmp_path / "out", SECONDS)
    with zipfile.ZipFile(file) as archive:
        assert archive.testzip() is None
        rows = list(csv.reader(archive.read(f"{INFO}/RECORD").decode().splitlines()))
        assert [name for name, _, _ in rows] == archive.namelist()
        assert rows[-1] == [f"{INFO}/RECORD", "", ""]
        for name, digest, size in rows[:-1]:
            content = archive.read(name)
            expected = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
            assert (digest, int(size)) == (f"sha256={expected}", len(content))


def test_bill_of_materials_names_what_is_compiled_in_and_what_is_required(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    file = build_wheels.finish(made(tmp_path / "a", []), tmp_path / "out", SECONDS)
    with zipfile.ZipFile(file) as archive:
        bill = json.loads(archive.read(f"{INFO}/sboms/hexservo.cdx.json"))
        assert f"{INFO}/compiled_in.json" not in archive.namelist()
    validation = pytest.importorskip("cyclonedx.validation.json")
    schema = pytest.importorskip("cyclonedx.schema")
    assert validation.JsonStrictValidator(schema.SchemaVersion.V1_6).validate_str(json.dumps(bill)) is None
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.6")
    assert bill["metadata"]["component"]["purl"] == "pkg:pypi/hexservo@9.9.9"
    parts = {part["name"]: (part.get("version"), part["scope"]) for part in bill["components"]}
    assert parts == {
        "eigen": ("3.4.0", "required"), "pybind11": ("3.0.1", "required"), "numpy": (None, "required"),
        "control": (None, "optional"),
    }  # fmt: skip


def test_wheel_and_page_have_the_texts_of_their_licences() -> None:
    """Exact copies: each is compared with what is installed here, where it is."""
    tomllib = pytest.importorskip("tomllib", reason="Python 3.11 brings it")
    given = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["license-files"]
    names = {file.relative_to(ROOT).as_posix() for pattern in given for file in ROOT.glob(pattern)}
    assert {"LICENSE", "licenses/MPL-2.0.txt", *(f"licenses/{part}.txt" for part in build_wheels.KNOWN_PARTS)} <= names
    assert {file.relative_to(ROOT).as_posix() for file in (ROOT / "licenses").iterdir()} <= names
    modules = ROOT / "build" / "explorer" / "npm" / "node_modules"
    originals = {
        "MPL-2.0": [Path("/usr/share/common-licenses/MPL-2.0")],
        "pybind11": [
            Path(str(file.locate()))
            for file in importlib.metadata.files("pybind11") or []
            if file.parts[-2:] == ("licenses", "LICENSE")
        ],
        "three": [modules / "three" / "LICENSE"],
        "uplot": [modules / "uplot" / "LICENSE"],
    }
    for name, files in originals.items():
        for file in files:
            if file.is_file():
                assert (ROOT / "licenses" / f"{name}.txt").read_bytes() == file.read_bytes(), file


def test_every_extra_is_tried_in_a_new_system_and_described_on_the_site() -> None:
    tomllib = pytest.importorskip("tomllib", reason="Python 3.11 brings it")
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    assert set(try_wheels.EXTRAS) == set(extras)
    described = (ROOT / "docs" / "site" / "install.md.in").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `pip install 'hexservo\[(\w+)\]'`", described, re.MULTILINE)) == set(extras)


def test_citation_names_this_version_and_those_who_hold_the_licence() -> None:
    citation: Any = load_yaml((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == hs.__version__
    assert f"*hexservo*, version {hs.__version__}." in (ROOT / "README.md").read_text(encoding="utf-8")
    package = importlib.metadata.metadata("hexservo")
    assert citation["license"] == package["License-Expression"]
    (author,) = citation["authors"]
    assert f"Copyright (c) 2026 {author['name']}" in (ROOT / "LICENSE").read_text(encoding="utf-8")
    required = {"cff-version", "message", "title", "authors"}  # of the format, and of what is referred to the last two
    assert required <= citation.keys()
    assert all({"type", "title", "authors"} <= reference.keys() for reference in citation["references"])


def test_commands_of_a_release_are_those_of_the_makefile() -> None:
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    commands = re.search(r"## A release\n.*?```sh\n(.*?)```", page, re.DOTALL)
    assert commands is not None
    targets = set(re.findall(r"^([\w-]+(?: [\w-]+)*):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    known = {name for line in targets for name in line.split()}
    for line in commands[1].splitlines():
        for words in re.findall(r"\bmake ([\w ,-]+?)(?= [A-Z]+=| &&|  |$)", line):
            assert set(words.split()) <= known, line
    for target in ("bench", "bench-peers"):  # whose tables name the version
        assert re.search(rf"\bmake {target}(?= )", commands[1]), target
    version = re.search(r"project\(hexservo VERSION ([\d.]+)", (ROOT / "CMakeLists.txt").read_text(encoding="utf-8"))
    assert version is not None
    assert version[1] == hs.__version__


# ---- Tools of other interpreters ------------------------------------------------------------------------------------


def test_tools_of_a_build_are_installed_again_where_others_are_wanted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    commands: list[tuple[str | Path, ...]] = []

    def run(*command: str | Path) -> None:
        commands.append(command)
        (tmp_path / "build" / "release" / "3.99").mkdir(parents=True, exist_ok=True)

    monkeypatch.setattr(build_wheels, "ROOT", tmp_path)
    monkeypatch.setattr(build_wheels, "run", run)
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    counts = []
    for text in (project, project, project + "# more\n", project.replace("pybind11>=3", "pybind11>=3.99")):
        (tmp_path / "pyproject.toml").write_text(text, encoding="utf-8")
        build_wheels.tools("3.99")
        counts.append(len(commands))
    assert counts == [3, 3, 3, 6]


# ---- Recipes of make ------------------------------------------------------------------------------------------------

PIP = """#!/bin/sh
case "$*" in
  "-c "*) echo works;;
  *" install "*) sleep 0.05; if [ -e saved ]; then mv saved cpp/core.cpp; touch cpp/core.cpp; fi; sleep 0.05;;
esac
"""


def tree(folder: Path) -> Path:
    """A folder with the Makefile, some sources, and an environment whose pip saves a source while it builds."""
    for name in ("CMakeLists.txt", "pyproject.toml", "README.md", "LICENSE", "cpp/core.cpp", "docs/model.md"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("", encoding="utf-8")
    shutil.copy(ROOT / "Makefile", folder)
    (folder / "python" / "hexservo").mkdir(parents=True)
    python = folder / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(PIP, encoding="utf-8")
    python.chmod(0o755)
    for name in ("venv", "build-tools"):
        (folder / ".venv" / f".stamp-{name}").touch()
    return folder


def make(folder: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run make without what a make above the tests has in the environment, and without a look at the system."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith(("MAKE", "MFLAGS"))} | environment
    command = ["make", "-o", "system", *arguments]
    return subprocess.run(command, cwd=folder, env=kept, capture_output=True, text=True, check=False)


def test_a_source_saved_during_the_build_is_built_the_next_time(tmp_path: Path) -> None:
    folder, stamp = tree(tmp_path), ".venv/.stamp-package"
    (folder / "saved").write_text("new", encoding="utf-8")
    for saved in (True, False):  # the second build saves nothing
        assert make(folder, "--question", stamp).returncode == 1
        found = make(folder, stamp)
        assert found.returncode == 0, found.stderr
        assert (folder / "cpp" / "core.cpp").read_text(encoding="utf-8") == "new"
        assert make(folder, "--question", stamp).returncode == (1 if saved else 0)


def test_an_explorer_of_an_earlier_build_is_not_packed_where_npm_is_missing(tmp_path: Path) -> None:
    folder = tree(tmp_path)
    page = folder / "python" / "hexservo" / "explorer.html"
    programs = folder / "programs"
    programs.mkdir()
    for name in ("bash", "make", "sh", "rm", "find", "touch", "mv", "sleep"):
        found = shutil.which(name)
        assert found is not None
        (programs / name).symlink_to(found)
    for target in ("wheel", "clean"):
        page.write_text("old", encoding="utf-8")
        made = make(folder, target, PATH=str(programs))
        assert made.returncode == 0, made.stderr
        assert ("a wheel without the explorer" in made.stdout) == (target == "wheel")
        assert not page.exists()
