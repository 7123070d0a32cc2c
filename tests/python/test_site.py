"""The site: code of the tutorials, lists of pages and names, and the check of links. `make docs` builds the whole."""

from __future__ import annotations

import dataclasses
import pydoc
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

import build_site
import gallery as gallery_module
import hexservo as hs
import reference_pages
from gallery import Shown, gallery
from hexservo.cli.commands import app
from hexservo.scenario.fields import field_names, fields_of
from hexservo.scenario.schema import all_keys
from hexservo.scenario.yaml import load_yaml
from test_docs import PAGES, ROOT, name_of
from test_readme import examples, output_of
from test_terminal import invoke

# Guides whose code is run here, and the packages that it takes.
GUIDES: dict[str, list[str]] = {
    "bridges": ["mujoco", "control", "gymnasium"],
    "camera": [],
    "compare": [],
    "fmu": ["fmpy"],
}
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
LAST_LINES = {
    "camera": r"settles in 0\.444 s",
    "campaign": r"\d+ of 400 runs fails?: the failure probability is between .*",
    "paper": r"0\.55 s",
    "robot": r"valid",
}


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=[pytest.mark.slow] if page.stem == "paper" else []) for page in TUTORIALS],
    ids=lambda page: page.stem,
)
def test_code_of_a_tutorial_runs_as_one_session(page: Path, tmp_path: Path) -> None:
    lines = output_of("\n".join(examples(page)), tmp_path).splitlines()
    assert re.fullmatch(LAST_LINES[page.stem], lines[-1]), lines


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_commands_of_a_tutorial_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for block in re.findall(r"```sh\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
        for line in block.splitlines():
            program, *arguments = shlex.split(line, comments=True)
            assert program == "hexservo"
            code, _, error = invoke(*arguments)
            assert code == 0, error


@pytest.mark.parametrize(("name", "needs"), GUIDES.items(), ids=lambda value: value if isinstance(value, str) else "")
def test_code_of_a_guide_runs_as_one_session(
    name: str, needs: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those of other pages are run by the tests of their subject. Files that a page exports are there."""
    for module in needs:
        pytest.importorskip(module)
    if name == "fmu" and not Path(hs.__file__).with_name("libhexservo.so").is_file():
        pytest.skip("the shared library of the C interface was not built")
    monkeypatch.chdir(tmp_path)
    page = ROOT / "docs" / f"{name}.md"
    for line in re.findall(r"^hexservo (export .*?)(?:#.*)?$", page.read_text(encoding="utf-8"), re.MULTILINE):
        code, _, error = invoke(*shlex.split(line))
        assert code == 0, error
    output_of("\n".join(examples(page)), tmp_path)


def test_keys_of_gains_that_fit_are_a_scenarios() -> None:
    (text,) = re.findall(r"```yaml\n(.*?)```", (ROOT / "docs" / "gains.md").read_text(encoding="utf-8"), re.DOTALL)
    keys = load_yaml(text)
    assert isinstance(keys, dict)
    scenario = hs.load_scenario("paper").updated(keys)
    assert scenario.controller.law == "composite"
    assert scenario.controller.composite.auto is not None


def test_reference_has_every_public_name() -> None:
    pages = build_site.api_pages()
    assert {f"api/{name}.md" for name in hs.__all__ if name != "__version__"} == set(pages) - {"api/index.md"}


def test_the_names_of_a_module_are_documented_one_by_one() -> None:
    """Those of hs.bridges are imported when they are first used: its members are not listed by itself."""
    pages = build_site.api_pages()
    for module in ("bridges", "plots"):
        named = re.findall(rf"autofunction:: hexservo\.{module}\.(\w+)", pages[f"api/{module}.md"])
        assert named == getattr(hs, module).__all__
    assert ":doc:`/keys`" in pages["api/Scenario.md"]


def test_poor_pages_of_the_reference_are_found(tmp_path: Path) -> None:
    good = '<dt class="sig sig-object">x</dt>'
    bad = {
        "address": f"{good}Rule object at 0x7f",
        "empty": "<p>x</p>",
        "numpy": f"{good}_SupportsArray",
        "property": f'{good}<dt class="field-odd">Type<span class="colon">:</span></dt>',
    }
    for name, text in {**bad, "good": good, "index": ""}.items():
        build_site.write(tmp_path / "api" / f"{name}.html", text)
    assert [line.split(".html: ")[0] for line in build_site.poor_pages(tmp_path)] == sorted(bad)


def test_the_page_of_commands_has_all_options() -> None:
    page = reference_pages.commands_page()
    group: Any = get_command(app)
    for name, command in group.commands.items():
        (section,) = re.findall(rf"^## {name}\n(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL)
        assert section.strip().startswith(f"```text\nhexservo {name}")
        for option in command.params:
            assert all(word in section for word in option.opts if word.startswith("--")), option.opts
    assert "`--out` writes figures" in page  # not as a dash
    assert r"path of a result.nc that `run --out` wrote" in page
    assert "`--scenarios NAMES`" in page
    assert r"\[required\]" in page
    assert "Exit codes: 0 done" in page


def test_the_page_of_headers_has_each_with_its_purpose(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = reference_pages.headers_page()
    files = [file.relative_to(ROOT).as_posix() for file in (ROOT / "cpp" / "include").rglob("*.h*")]
    assert sorted(re.findall(r"source:([\w/.]+)", page)) == sorted(files)
    assert "| All control laws. |" in page
    assert (
        "| The servo tick: what a robot's control computer calls at every period ([docs/model.md](docs/model.md), "
        in page
    )
    for heading in re.findall(r"(?:start-after|end-before): \"(.*)\"", page):
        assert f"\n{heading}\n" in (ROOT / "README.md").read_text(encoding="utf-8")
    monkeypatch.setattr(reference_pages, "ROOT", tmp_path)
    monkeypatch.setattr(reference_pages, "HEADERS", tmp_path)
    build_site.write(tmp_path / "new.hpp", "#pragma once\n")
    with pytest.raises(SystemExit, match=r"new\.hpp: expected a first comment"):
        reference_pages.headers_page()


def test_the_page_of_a_folder_leads_to_all_that_is_in_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("sphinx")
    import site_extension

    monkeypatch.setattr(site_extension, "ROOT", tmp_path / "repository")
    for name in ("a/b.hpp", "a/c/d e.hpp", "a/.hidden"):
        build_site.write(tmp_path / "repository" / name, "int x;\n")
    site = tmp_path / "site"
    build_site.write(site / "index.html", '<a href="source/a.html">a</a>')
    site_extension.write_source_pages(site, "a")
    written = sorted(file.relative_to(site).as_posix() for file in site.rglob("*.html"))
    assert written == [
        "index.html",
        "source/a.html",
        "source/a/b.hpp.html",
        "source/a/c.html",
        "source/a/c/d e.hpp.html",
    ]
    assert build_site.broken_links(site) == build_site.pages_apart(site) == []


def test_the_page_of_keys_has_all_of_them_with_their_meaning() -> None:
    page = build_site.keys_page()
    rows = re.findall(r"^\| `([\w.]+)`<br>([^|]+) \|", page.replace(build_site.BAR, "/"), re.MULTILINE)
    assert dict(rows) == {entry["key"]: entry["meaning"].replace("|", "/") for entry in all_keys()}
    assert "| number<br>1 | >= 0<br><= 1 | `0.0` | sampled |" in page
    assert '| choice<br>`paper`, `opencv` | | `"paper"` | any |' in re.sub(" +", " ", page)
    assert "| choice<br>`true`, `encoders` |" in page
    assert "`[1e-06, 1e-06, 1e-06, 1e-06, ...`" in page


PUBLIC = {name: getattr(hs, name) for name in hs.__all__}
WITH_FIELDS = {name: thing for name, thing in PUBLIC.items() if field_names(thing)}


@pytest.mark.parametrize("name", WITH_FIELDS)
def test_help_of_a_class_explains_its_fields(name: str) -> None:
    """Each has its text, arrays have their shapes, and those of a named tuple have it as their docstring."""
    kind = WITH_FIELDS[name]
    shown = pydoc.plain(pydoc.render_doc(kind))
    assert "Alias for field number" not in shown
    fields = fields_of(kind)
    assert tuple(field for field, _, _ in fields) == field_names(kind)
    words = shown.replace("|", "").split()  # pydoc has a bar at the left
    for field, annotation, text in fields:
        assert text, field
        assert annotation != "Array" or "(" in text, field
        entry = f"{field} : {annotation} {text}".replace("|", "").split()
        assert any(words[k : k + len(entry)] == entry for k in range(len(words))), field


def test_every_page_of_the_repository_is_in_a_list() -> None:
    names = [name_of(page) for page in PAGES]
    front = build_site.front_page(names, None)
    listed = set(re.findall(r"^(?:\w[\w ]*<)?([\w/-]+)>?$", front, re.MULTILINE))
    for group in build_site.GROUPS:
        assert group in listed
        listed |= set(build_site.group_page(group, names).splitlines())
    assert {name.removesuffix(".md") for name in names} <= listed


def test_words_of_the_field_lead_to_ours() -> None:
    """Readers search for the interaction matrix, and for the keys that stand for what they know from elsewhere."""
    model = (ROOT / "docs" / "model.md").read_text(encoding="utf-8")
    section = model[model.index("\n## 5.") : model.index("\n## 6.")]
    assert "image Jacobian (interaction matrix)" in section
    table = (ROOT / "docs" / "bridges.md").read_text(encoding="utf-8").split("\n## ")[1]
    gains = hs.load_scenario("paper").to_mapping()["controller"]["resolved_rate"]
    named = re.findall(r"`(?:controller\.resolved_rate)?\.?(gain\w*|adaptive|jacobian_at)`", table)
    assert len(named) == 5
    assert set(named) < set(gains)
    assert "(docs/bridges.md#names-signs-and-frames-elsewhere)" in build_site.front_page([], None)


def test_links_to_sources_become_pages_and_code_is_left_alone() -> None:
    text = "[a](../cpp/include/hexservo.h) [b](model.md) `[c](../Makefile)` [d](https://x.org/y)\n```\n[e](../Makefile)\n```\n"
    changed = text.replace("../cpp/include/hexservo.h", "source:cpp/include/hexservo.h")
    assert build_site.with_source_links(text, "docs/c-interface.md") == changed


def test_broken_links_of_a_site_are_found(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text('<a href="b.html#here">x</a><a href="https://x.org">y</a><p id="p"></p>')
    (tmp_path / "b.html").write_text('<a id="here"></a><a href="a.html#p">x</a>')
    assert build_site.broken_links(tmp_path) == []
    (tmp_path / "b.html").write_text('<img src="no.svg"><a href="../out.html"></a>')
    found = build_site.broken_links(tmp_path)
    assert [line.split(": ")[1] for line in found] == ["b.html#here", "no.svg", "../out.html"]


def test_pages_without_a_way_to_them_are_found(tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text('<a href="a.html#p">x</a><a href="https://x.org/c.html">y</a>')
    (tmp_path / "a.html").write_text('<a href="index.html">x</a><a href="explorer.html"></a><a href="gone.html"></a>')
    (tmp_path / "explorer.html").write_text('<a href="c.html">x</a>')
    assert build_site.pages_apart(tmp_path) == []
    for name in ("b.html", "c.html"):
        (tmp_path / name).write_text('<a href="b.html">x</a>')
    assert build_site.pages_apart(tmp_path) == ["b.html", "c.html"]


def test_the_site_is_made_where_it_is_asked_for() -> None:
    """The target has the name of a folder that the package depends on."""
    for target, makes in (("paper", False), ("docs", True)):
        told = subprocess.run(["make", "--dry-run", target], cwd=ROOT, capture_output=True, text=True, check=True)
        assert ("build_site.py" in told.stdout) == makes, target
        assert "Circular" not in told.stderr


@pytest.mark.parametrize("links", [False, True])
def test_only_an_earlier_site_is_replaced(links: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the folder that is asked for nor those beside it lose files that others made."""

    def built(out: Path) -> None:
        monkeypatch.setattr(sys, "argv", ["build_site.py", "--out", str(out), *(["--links"] if links else [])])
        build_site.main()

    begun: list[Path] = []
    monkeypatch.setattr(build_site, "stage", lambda folder, *_: begun.append(folder))
    failed: subprocess.CompletedProcess[str] = subprocess.CompletedProcess([], 7)
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: failed)  # Sphinx, which begins and does not end
    written = "public-links" if links else "public"
    for number, name in enumerate((written, "public-sources")):
        out = tmp_path / str(number) / "public"
        mine = out.with_name(name) / "mine.html"
        build_site.write(mine, "mine")
        with pytest.raises(
            SystemExit, match=re.escape(f"expected an empty folder or an earlier site, got {mine.parent}")
        ):
            built(out)
        assert mine.read_text(encoding="utf-8") == "mine"
        assert list(out.parent.iterdir()) == [mine.parent]
    assert begun == []

    out = tmp_path / "new" / "public"
    for _ in range(2):  # the second one replaces the first, which was interrupted
        with pytest.raises(SystemExit, match="7"):
            built(out)
        old = out.with_name(written) / "old.html"
        assert not old.exists()
        old.write_text("old", encoding="utf-8")
    assert begun == 2 * [out.with_name("public-sources")]


def test_a_page_of_another_version_is_not_part_of_the_site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "explorer.html"
    page.write_text('<meta name="hexservo" content="0.0.1 0">', encoding="utf-8")
    monkeypatch.setattr(sys, "argv", ["build_site.py", "--out", str(tmp_path / "site"), "--explorer", str(page)])
    with pytest.raises(SystemExit, match=f"explorer.html: explorer: expected the page of hexservo {hs.__version__}"):
        build_site.main()
    assert list(tmp_path.iterdir()) == [page]


def test_gallery_draws_a_scenario_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hs, "scenario_names", lambda: ("paper",))
    (first,) = gallery(tmp_path)
    assert (first.name, first.verdict, first.why) == ("paper", "settled", "within 2 px after 0.353 s")
    picture = tmp_path / "paper.svg"
    picture.write_text("kept")
    assert gallery(tmp_path) == [Shown(**dataclasses.asdict(first))]
    assert picture.read_text() == "kept"


def test_the_gallery_counts_no_features(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its scenarios have different numbers of points."""
    monkeypatch.setattr(build_site, "gallery", lambda _: [])
    assert len({hs.load_scenario(name).target.count for name in hs.scenario_names()}) > 1
    assert not re.search(r"\b(three|four|five)\b", build_site.gallery_page(tmp_path, tmp_path))


def test_gallery_draws_again_after_any_change_of_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Verdicts are made by hexservo.run, runs by the compiled modules of the processor's instruction sets."""
    paper, keys = hs.load_scenario("paper"), set()
    assert gallery_module.PACKAGE / "run" / "compare.py" in set(gallery_module.PACKAGE.rglob("*.py"))
    package = tmp_path / "package"
    monkeypatch.setattr(gallery_module, "PACKAGE", package)
    for text in ("a", "b"):
        for name in ("__init__.py", "run/compare.py", "_core.so", "_core_avx2.so"):
            build_site.write(package / name, text)
            gallery_module.code_of.cache_clear()
            keys.add(gallery_module.key_of(paper))
    assert len(keys) == 8
    gallery_module.code_of.cache_clear()
