"""Wheels: finished archives, bills of materials, and the recipe of a release. `make wheel-test` builds wheels."""

from __future__ import annotations

import base64
import csv
import hashlib
import json
import re
import zipfile
from pathlib import Path

import pytest

import build_wheels
import hexservo as hs
import try_wheels

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


def test_every_extra_is_tried_in_a_new_system_and_described_on_the_site() -> None:
    tomllib = pytest.importorskip("tomllib", reason="Python 3.11 brings it")
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    assert set(try_wheels.EXTRAS) == set(extras)
    described = (ROOT / "docs" / "site" / "install.md.in").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `pip install 'hexservo\[(\w+)\]'`", described, re.MULTILINE)) == set(extras)


def test_commands_of_a_release_are_those_of_the_makefile() -> None:
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    commands = re.search(r"## A release\n.*?```sh\n(.*?)```", page, re.DOTALL)
    assert commands is not None
    targets = set(re.findall(r"^([\w-]+(?: [\w-]+)*):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    known = {name for line in targets for name in line.split()}
    for line in commands[1].splitlines():
        for words in re.findall(r"\bmake ([\w ,-]+?)(?= [A-Z]+=| &&|  |$)", line):
            assert set(words.split()) <= known, line
    version = re.search(r"project\(hexservo VERSION ([\d.]+)", (ROOT / "CMakeLists.txt").read_text(encoding="utf-8"))
    assert version is not None
    assert version[1] == hs.__version__
