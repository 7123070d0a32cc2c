"""The documentation is checked against the tree: links, tests, headers, names, keys, values and section numbers.

Works on files alone, so that it also runs where the package is not built. The root is found from this file.
"""

from __future__ import annotations

import ast
import itertools
import re
from collections.abc import Iterator
from fnmatch import fnmatch
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import pytest

from hexservo.scenario.yaml import load_yaml

ROOT = Path(__file__).resolve().parents[2]
HEADERS = ROOT / "cpp" / "include" / "hexservo"
MODEL = ROOT / "docs" / "model.md"
ERRATA = ROOT / "docs" / "errata.md"
# The changelog is young; everything else that is named here has to be there.
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *(page for page in [ROOT / "CHANGELOG.md"] if page.exists()),
    MODEL,
    ERRATA,
]
PAGES += [page for page in sorted((ROOT / "docs").rglob("*.md")) if page not in PAGES]

PLACED = {"target.translation", "target.rotation"}  # keys of a campaign alone: docs/campaigns.md, section 2
PAPER_EQUATIONS = [f"({number})" for number in (*range(1, 16), 22)]
TABLE_HEAD = ["equation", "what it computes", "section", "code", "tests"]
NO_EQUATION = "Headers without an equation"
IDENTIFIER = re.compile(r"[A-Za-z_]\w*(?:::\w+)*", re.ASCII)


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


# ---- Markdown -------------------------------------------------------------------------------------------------------


@cache
def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


@cache
def prose_of(page: Path) -> str:
    """The page without fenced code blocks."""
    lines, fence = [], ""
    for line in text_of(page).splitlines():
        mark = re.match(r"\s*(```+|~~~+)", line)
        if mark and not fence:
            fence = mark[1]
        elif fence:
            if mark and line.strip() == fence:
                fence = ""
        else:
            lines.append(line)
    assert not fence, f"{name_of(page)}: a code block is not closed"
    return "\n".join(lines)


def without_code(text: str) -> str:
    """The text with dots in place of what its code spans hold: positions stay, brackets in code do not count."""
    return re.sub(r"(`+)(.+?)\1", lambda span: span[1] + "." * len(span[2]) + span[1], text)


def code_spans(text: str) -> list[str]:
    return [span[2].strip() for span in re.finditer(r"(`+)(.+?)\1", text)]


class Link(NamedTuple):
    text: str
    target: str


def links_in(text: str) -> list[Link]:
    """Inline links and images, nested ones too; HTML attributes; definitions of reference links."""
    masked = without_code(text)
    found = []
    for end in re.finditer(r"\]\(\s*<?([^()\s>]+)>?(?:\s+\"[^\"]*\")?\s*\)", masked):
        depth, start = 0, end.start()
        while depth >= 0 and start > 0:  # back to the bracket that this one closes
            start -= 1
            depth += {"]": 1, "[": -1}.get(masked[start], 0)
        found.append(Link(text[start + 1 : end.start()], end[1]))
    found += [Link("", match[1]) for match in re.finditer(r"\b(?:src|href|srcset)=\"([^\"]+)\"", masked)]
    found += [Link("", match[1]) for match in re.finditer(r"^\s{0,3}\[[^\]^]+\]:\s+<?([^\s>]+)", masked, re.MULTILINE)]
    return found


def heading_texts(page: Path) -> list[tuple[int, str]]:
    return [(len(m[1]), m[2]) for m in re.finditer(r"^(#{1,6})\s+(.+?)\s*#*$", prose_of(page), re.MULTILINE)]


@cache
def anchors_of(page: Path) -> frozenset[str]:
    """Anchors as GitHub makes them: lower case, no punctuation, hyphens for blanks, repeated ones numbered."""
    seen: dict[str, int] = {}
    anchors = set(re.findall(r"<a\s+(?:id|name)=\"([^\"]+)\"", prose_of(page)))
    for _, heading in heading_texts(page):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        slug = re.sub(r"[^\w\- ]", "", plain.lower()).replace(" ", "-")
        count = seen.get(slug, 0)
        seen[slug] = count + 1
        anchors.add(f"{slug}-{count}" if count else slug)
    return frozenset(anchors)


@cache
def sections_of(page: Path) -> dict[int, str]:
    """Numbered second-level sections: number -> text, heading included."""
    sections: dict[int, str] = {}
    for part in re.split(r"^(?=## )", prose_of(page), flags=re.MULTILINE)[1:]:
        number = re.match(r"## (\d+)\. ", part)
        if number:
            assert int(number[1]) not in sections, f"{name_of(page)}: two sections {number[1]}"
            sections[int(number[1])] = part
    return sections


def tables_in(text: str) -> Iterator[tuple[list[str], list[list[str]]]]:
    """Tables: their head and their rows, as lists of cells."""
    for block in re.findall(r"(?:^\|.*\n?)+", text, re.MULTILINE):
        rows = [
            [cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line.strip().strip("|"))]
            for line in block.splitlines()
        ]
        for row in rows:
            assert len(row) == len(rows[0]), f"a row of {len(row)} cells in a table of {len(rows[0])}: {row}"
        yield rows[0], rows[2:]


# ---- The tree -------------------------------------------------------------------------------------------------------


@cache
def python_tests(file: Path) -> frozenset[str]:
    """Tests of a file, as pytest names them without parameters: function or Class::method."""

    def walk(body: list[ast.stmt], prefix: str = "") -> Iterator[str]:
        for node in body:
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.startswith("test_"):
                yield prefix + node.name
            elif isinstance(node, ast.ClassDef) and node.name.startswith("Test"):
                yield from walk(node.body, f"{prefix}{node.name}::")

    return frozenset(walk(ast.parse(file.read_text(encoding="utf-8")).body))


@cache
def cpp_tests(file: Path) -> frozenset[str]:
    """Names of the doctest cases of a file; a name may be split over several literals."""
    cases = re.findall(
        r"^\s*TEST_CASE(?:_TEMPLATE|_FIXTURE)?\s*\(\s*(?:\w+\s*,\s*)?((?:\"(?:[^\"\\]|\\.)*\"\s*)+)",
        file.read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    return frozenset(
        "".join(ast.literal_eval(part) for part in re.findall(r"\"(?:[^\"\\]|\\.)*\"", case)) for case in cases
    )


@cache
def public_headers() -> dict[str, str]:
    """Headers below include/hexservo: relative name -> text."""
    return {str(file.relative_to(HEADERS)): file.read_text(encoding="utf-8") for file in sorted(HEADERS.rglob("*.hpp"))}


def code_part(header: str) -> str:
    return re.sub(r"//.*", "", public_headers()[header])


def comment_part(header: str) -> str:
    """Comments as running text, with continued lines joined."""
    return " ".join(line.strip("/<* ") for line in re.findall(r"//.*", public_headers()[header]))


@cache
def source_files() -> tuple[Path, ...]:
    """Everything of ours that may cite the documentation."""
    suffixes = {".hpp", ".cpp", ".py", ".pyi", ".yaml", ".yml", ".toml", ".txt", ".json", ".cmake"}
    files = [
        file
        for folder in ("cpp", "python", "tests", "benchmarks")
        for file in sorted((ROOT / folder).rglob("*"))
        if file.suffix in suffixes and file != Path(__file__).resolve()  # this file is about citations
    ]
    return (*files, *(ROOT / name for name in ("Makefile", "CMakeLists.txt", "CMakePresets.json", "pyproject.toml")))


class Row(NamedTuple):
    """A row of the table of equations."""

    equation: str
    section: int
    code: list[tuple[str, list[str]]]  # header and names in it
    tests: list[Link]


@cache
def equation_rows() -> tuple[Row, ...]:
    tables = [rows for head, rows in tables_in(sections_of(MODEL)[10]) if head == TABLE_HEAD]
    assert len(tables) == 1, f"expected one table with the head {TABLE_HEAD} in section 10, got {len(tables)}"
    result = []
    for equation, _, section, code, tests in tables[0]:
        (section_link,) = links_in(section)
        headers = []
        for part in re.split(r"(?=\[[\w/]+\.hpp\]\()", code)[1:]:
            (link,) = links_in(part)
            headers.append((link.target.removeprefix("../cpp/include/hexservo/"), code_spans(part)))
        result.append(Row(equation, int(section_link.text), headers, links_in(tests)))
    return tuple(result)


def named_test(page: Path, link: Link) -> str:
    """Check a link to a test file: its text names the file and an existing test of it. Give the test's name."""
    file = (page.parent / link.target).resolve()
    where = f"{name_of(page)}: [{link.text}]({link.target})"
    separator, tests = ("::", python_tests) if file.suffix == ".py" else (": ", cpp_tests)
    stem, found, name = link.text.replace("`", "").partition(separator)
    assert found, f"{where}: expected the text {file.name}{separator}<name of a test>"
    assert stem == file.name, f"{where}: text and target name different files"
    assert file.exists(), f"{where}: no such file"
    assert name in tests(file), f"{where}: no such test; the file has {sorted(tests(file))}"
    return name


def is_test_file(link: Link) -> bool:
    return re.search(r"(^|/)tests/(python|cpp)/test_\w+\.(py|cpp)$", link.target) is not None


# ---- Links ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_resolve(page: Path) -> None:
    broken = []
    for link in links_in(prose_of(page)):
        if re.match(r"[a-z][a-z0-9+.-]*:", link.target):
            if not link.target.startswith(("https://", "mailto:")):
                broken.append(f"{link.target}: expected https or a relative path")
            continue
        path, _, anchor = unquote(link.target).partition("#")
        file = (page.parent / path).resolve() if path else page
        if not file.is_relative_to(ROOT):
            broken.append(f"{link.target}: leaves the repository")
        elif not file.exists():
            broken.append(f"{link.target}: no such file")
        elif anchor and file.suffix != ".md":
            broken.append(f"{link.target}: anchors into sources rot; name what is meant")
        elif anchor and anchor not in anchors_of(file):
            broken.append(f"{link.target}: no such heading; there are {sorted(anchors_of(file))}")
    assert not broken, "\n".join([name_of(page), *broken])


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_reference_links_are_defined(page: Path) -> None:
    masked = without_code(prose_of(page))
    defined = {label.lower() for label in re.findall(r"^\s{0,3}\[([^\]^]+)\]:", masked, re.MULTILINE)}
    used = {label.lower() for label in re.findall(r"\]\[([^\[\]]+)\]", masked)}
    assert used <= defined, f"{name_of(page)}: reference links without a definition: {sorted(used - defined)}"


def test_a_broken_link_would_be_found() -> None:
    text = '[a](x.md) `[no](code.md)` [![i](p.svg)](y.md "title")\n[r]: z.md\n<img src="q.png">\n[`f(x)[1]`](w.hpp)'
    assert [link.target for link in links_in(text)] == ["x.md", "p.svg", "y.md", "w.hpp", "q.png", "z.md"]
    assert links_in(text)[0].text == "a"
    assert links_in(text)[3].text == "`f(x)[1]`"


# ---- Tests that the documentation names -----------------------------------------------------------------------------


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_named_tests_exist(page: Path) -> None:
    for link in links_in(prose_of(page)):
        if is_test_file(link):
            named_test(page, link)
    # also where a test is named without a link, code blocks included
    of_python, of_cpp = list(ROOT.glob("tests/python/test_*.py")), list(ROOT.glob("tests/cpp/test_*.cpp"))
    files = {file.stem for file in (*of_python, *of_cpp)}  # some are of both
    functions = {name.rpartition("::")[2] for file in of_python for name in python_tests(file)}
    case_names = " ".join(name for file in of_cpp for name in cpp_tests(file))
    unknown = {
        word
        for word in re.findall(r"\btest_\w+", text_of(page))
        if word not in files and word not in functions and word not in case_names
    }
    assert not unknown, f"{name_of(page)}: neither a test nor a file of tests: {sorted(unknown)}"


# ---- The table of equations -----------------------------------------------------------------------------------------


def test_every_equation_has_one_row() -> None:
    rows = [row.equation for row in equation_rows()]
    assert len(set(rows)) == len(rows), f"equations with two rows: {sorted(e for e in rows if rows.count(e) > 1)}"
    assert [equation for equation in rows if equation.startswith("(")] == PAPER_EQUATIONS


def test_rows_name_headers_functions_and_tests() -> None:
    problems = []
    for row in equation_rows():
        if row.section not in sections_of(MODEL):
            problems.append(f"{row.equation}: no section {row.section}")
        if not row.code or not row.tests:
            problems.append(f"{row.equation}: expected a header and a test")
        problems += [f"{row.equation}: {link.target} is no test" for link in row.tests if not is_test_file(link)]
        for header, names in row.code:
            if header not in public_headers():
                problems.append(f"{row.equation}: no header {header}; there are {sorted(public_headers())}")
            elif not names:
                problems.append(f"{row.equation}: expected names of functions or types after {header}")
            else:
                words = set(re.findall(r"\w+", code_part(header)))
                problems += [
                    f"{row.equation}: {header} has no {name}"
                    for name in names
                    if not words.issuperset(name.split("::"))
                ]
    assert not problems, "\n".join(problems)


def test_headers_name_their_equations_or_sections() -> None:
    """The way back: from a header to the equation, or to the section of docs/model.md."""
    problems = []
    for row in equation_rows():
        for header, _ in row.code:
            comments = comment_part(header)
            equations = {int(number) for number in re.findall(r"\((\d+)\)", comments)}
            for first, last in re.findall(r"\((\d+)\)-\((\d+)\)", comments):
                equations |= set(range(int(first), int(last) + 1))
            named = row.equation.startswith("(") and int(row.equation.strip("()")) in equations
            if not named and row.section not in cited_sections(comments, "model"):
                problems.append(f'{header}: no comment names {row.equation} or "docs/model.md, section {row.section}"')
    assert not problems, "\n".join(problems)


def test_every_public_header_is_documented() -> None:
    with_equation = {header for row in equation_rows() for header, _ in row.code}
    listed = sections_of(MODEL)[10].partition(f"### {NO_EQUATION}")[2]
    targets = {link.target.removeprefix("../cpp/include/hexservo/") for link in links_in(listed)}
    without_equation = {target for target in targets if target.endswith(".hpp")}
    assert not with_equation & without_equation, "a header is in the table and in the list of those without an equation"
    assert with_equation | without_equation == set(public_headers())


# ---- Names and keys -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", [MODEL, ERRATA], ids=name_of)
def test_names_in_code_spans_occur_in_the_sources(page: Path) -> None:
    words: set[str] = set()
    for file in source_files():
        if not file.is_relative_to(ROOT / "tests"):
            words.update(re.findall(r"[A-Za-z_]\w*", file.read_text(encoding="utf-8"), re.ASCII))
            words.add(file.stem)
    scenarios = {file.stem for file in (ROOT / "python" / "hexservo" / "scenarios").glob("*.yaml")}
    prose = prose_of(page)
    for link in links_in(prose):
        if is_test_file(link):
            prose = prose.replace(link.text, "")
    unknown = [
        span
        for span in code_spans(prose)
        if IDENTIFIER.fullmatch(span) and span not in scenarios and not words.issuperset(span.split("::"))
    ]
    assert not unknown, f"{name_of(page)}: names that no source has: {unknown}"


@cache
def scenario_keys() -> frozenset[str]:
    """Dotted paths of all scenario keys, read from the classes that define them."""
    folder = ROOT / "python" / "hexservo" / "scenario"
    texts = [(folder / name).read_text(encoding="utf-8") for name in ("blocks.py", "drives.py", "laws.py", "motion.py")]

    def kind_of(annotation: ast.expr) -> str:  # the name of a block, Annotated[Block, ...] or not
        if isinstance(annotation, ast.Subscript) and isinstance(annotation.slice, ast.Tuple):
            annotation = annotation.slice.elts[0]
        return annotation.id if isinstance(annotation, ast.Name) else ""

    fields: dict[str, dict[str, str]] = {"Block": {}}
    for node in (node for text in texts for node in ast.parse(text).body):
        if isinstance(node, ast.ClassDef):
            bases = [base.id for base in node.bases if isinstance(base, ast.Name) and base.id in fields]
            if bases:  # with the fields of a block that it extends
                fields[node.name] = {key: kind for base in bases for key, kind in fields[base].items()} | {
                    item.target.id: kind_of(item.annotation)
                    for item in node.body
                    if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)
                }

    def paths(block: str, head: str = "") -> Iterator[str]:
        for key, kind in fields[block].items():
            if kind in fields:
                yield from paths(kind, f"{head}{key}.")
            else:
                yield head + key

    keys = frozenset(paths("Blocks"))
    assert "controller.hybrid.fuzzy.bell_width" in keys  # the classes are where this test looks for them
    return keys


def leaves(block: dict[str, Any], head: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in block.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{head}{key}.")
        else:
            yield head + key, value


def plain(value: Any) -> Any:
    """One form for a value: numbers as floats."""
    if isinstance(value, list):
        return [plain(item) for item in value]
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else value


def test_every_scenario_key_is_explained_and_no_other() -> None:
    first_cells = {
        spans[0]
        for head, rows in tables_in(prose_of(MODEL))
        if head[0] in ("key", "robot key")
        for row in rows
        if (spans := code_spans(row[0]))
    }
    assert first_cells == scenario_keys()
    blocks = {key.partition(".")[0] for key in scenario_keys() if "." in key}
    for page in PAGES:
        mentioned = {
            span.partition(":")[0].partition(" =")[0].strip().removesuffix(".*")
            for span in code_spans(prose_of(page))
            if span.partition(".")[0] in blocks and re.match(r"\w+\.\w", span) and span != "metrics.json"
        }
        known = (
            scenario_keys() | PLACED | {".".join(key.split(".")[:n]) for key in scenario_keys() for n in range(1, 4)}
        )
        assert mentioned <= known, f"{name_of(page)}: unknown keys {sorted(mentioned - known)}"


def test_values_in_the_key_tables_are_those_of_the_scenario_paper() -> None:
    file = ROOT / "python" / "hexservo" / "scenarios" / "paper.yaml"
    written: Any = load_yaml(file.read_text(encoding="utf-8"))
    expected = dict(leaves(written))
    shown = {
        code_spans(row[0])[0]: load_yaml(code_spans(row[-1])[0])
        for head, rows in tables_in(prose_of(MODEL))
        if head[0] == "key" and head[-1] == "`paper`"
        for row in rows
    }
    assert {key: plain(value) for key, value in shown.items()} == {key: plain(value) for key, value in expected.items()}


# ---- Citations of the documentation ---------------------------------------------------------------------------------


def cited_sections(text: str, page: str) -> set[int]:
    """Section numbers in "docs/model.md, sections 3 and 4", "docs/model.md section 3 to 6", "docs/errata.md, 2"."""
    joined = re.sub(r"\s*\n\s*(?:///?<?|#|\*)?\s*", " ", text)
    cited: set[int] = set()
    for match in re.finditer(
        rf"docs/{page}\.md`*[,:]?\s*\(?(?:sections?\s+)?((?:\d+(?:\s*(?:,|and|to|-)\s*(?=\d))?)+)", joined
    ):
        cited.update(int(number) for number in re.findall(r"\d+", match[1]))
        for first, last in re.findall(r"(\d+)\s*(?:to|-)\s*(\d+)", match[1]):
            cited.update(range(int(first), int(last) + 1))
    return cited


def test_the_list_of_packaged_scenarios_names_all_of_them() -> None:
    page = (ROOT / "docs" / "scenarios.md").read_text(encoding="utf-8")
    part = page.partition("The packaged scenarios are:")[2].partition("`hexservo scenarios` lists them")[0]
    named = [name.replace("...", "*") for name in re.findall(r"`([\w.-]+)`", part)]
    files = [path.stem for path in (ROOT / "python" / "hexservo" / "scenarios").glob("*.yaml")]
    assert len(files) > 40
    assert [one for one in files if not any(fnmatch(one, name) for name in named)] == []


def test_citations_are_read_in_all_their_forms() -> None:
    text = "docs/model.md, sections 3 and 4; docs/model.md section 6; (docs/model.md, 2 | x); docs/model.md.\n 9 apples"
    assert cited_sections(text, "model") == {2, 3, 4, 6}
    text = "# see docs/model.md\n    # section 5 or docs/model.md sections 7 to 9"
    assert cited_sections(text, "model") == {5, 7, 8, 9}
    assert cited_sections("(docs/errata.md, 1), docs/model.md, 2", "errata") == {1}


@pytest.mark.parametrize("page", [MODEL, ERRATA], ids=name_of)
def test_cited_sections_exist(page: Path) -> None:
    sections = set(sections_of(page))
    wrong = {}
    cited: set[int] = set()
    for file in source_files():
        here = cited_sections(file.read_text(encoding="utf-8"), page.stem)
        cited |= here
        if here - sections:
            wrong[name_of(file)] = sorted(here - sections)
    assert not wrong, f"{name_of(page)} has no such sections: {wrong}"
    assert cited, f"no source cites {name_of(page)}: is it still called so?"


def test_cited_pages_exist() -> None:
    for file in source_files():
        for name in re.findall(r"\bdocs/[\w./-]*\w\.md\b", file.read_text(encoding="utf-8")):
            assert (ROOT / name).exists(), f"{name_of(file)} cites {name}, which does not exist"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_no_heading_skips_a_level(page: Path) -> None:
    """The site's builder takes a heading of level 4 below one of level 2 for an error."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    levels = [len(marks) for marks in re.findall(r"^(#+) ", text, re.MULTILINE)]
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels)), levels


def test_sections_are_numbered_without_gaps() -> None:
    assert list(sections_of(MODEL)) == list(range(1, len(sections_of(MODEL)) + 1))
    assert list(sections_of(ERRATA)) == list(range(1, 12))


# ---- Errata ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", range(1, 12))
def test_every_erratum_is_complete_and_has_a_test(number: int) -> None:
    entry = sections_of(ERRATA)[number]
    for part in ("**Printed:**", "**Evidence:**", "**Here:**", "**Test"):
        assert part in entry, f"erratum {number} has no part {part}"
    assert "**Wrong:**" in entry or "**Open:**" in entry
    named = {named_test(ERRATA, link) for link in links_in(entry) if is_test_file(link)}
    tests = python_tests(ROOT / "tests" / "python" / "test_errata.py")
    own = {name for name in tests if name.startswith(f"test_erratum_{number}_")}
    assert own, f"tests/python/test_errata.py has no test_erratum_{number}_..."
    assert own <= named, f"erratum {number} does not name {sorted(own - named)}"


def test_files_named_in_the_guide_for_contributors_are_there() -> None:
    roots = (ROOT, ROOT / "cpp" / "include", ROOT / "cpp" / "include" / "hexservo", ROOT / "python" / "hexservo")
    spans = re.findall(r"`([\w./]+(?:\.(?:hpp|cpp|py|pyi|yaml|md|txt)|/))`", prose_of(ROOT / "CONTRIBUTING.md"))
    assert len(spans) > 30
    # short names stand for files beside the one named before them
    folders = {path.parent for path in ROOT.joinpath("python", "hexservo").rglob("*.py")}
    missing = [name for name in spans if not any((folder / name).exists() for folder in (*roots, *folders))]
    assert not missing
