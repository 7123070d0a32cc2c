"""Every table, curve and map of a certificate, an analysis or a diagnosis has a page that explains it, in full.

Works on files alone: what the sources hand over as `page` is read from their syntax trees.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from test_docs import ROOT, cpp_tests, links_in, prose_of, python_tests, tables_in

SOURCES = (
    "findings/analysis",
    "findings/certificate",
    "findings/diagnosis",
    "findings/identification",
    "report",
)  # packages of hexservo
FOLDERS = ("analysis", "certificate", "diagnosis")  # of docs/: nothing but pages of quantities, and an index
HEADINGS = ["What it is", "Formula", "Source", "Limits", "How it is tested"]
# May be named too; they have their own headings and tests.
GUIDES = ("docs/model.md", "docs/campaigns.md", "docs/tune.md", "docs/identification.md")
ITEMS = ("Table", "Curves", "HeatMap", "Bars")


# ---- What the sources name ------------------------------------------------------------------------------------------


def position_of_page(root: Path) -> dict[str, int]:
    """Where `page` stands among the positional arguments of a table, curves or a map."""
    tree = ast.parse((root / "python" / "hexservo" / "findings" / "evidence.py").read_text(encoding="utf-8"))
    fields = {
        node.name: [
            item.target.id
            for item in node.body
            if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)
        ]
        for node in tree.body
        if isinstance(node, ast.ClassDef) and node.name in ITEMS
    }
    return {name: fields[name].index("page") for name in ITEMS}


def _text_constants(tree: ast.Module) -> Iterator[tuple[str, str]]:
    for node in tree.body:
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        value = node.value if isinstance(node, ast.Assign | ast.AnnAssign) else None
        if isinstance(value, ast.Constant) and isinstance(value.value, str):
            yield from ((target.id, value.value) for target in targets if isinstance(target, ast.Name))


class _Pages(ast.NodeVisitor):
    """Collects the pages that a module names, and the places that name none."""

    def __init__(self, where: str, text: str, positions: dict[str, int]) -> None:
        tree = ast.parse(text)
        self.where = where
        self.positions = positions
        self.explained = "/report/" not in where  # a report also has tables of versions and settings
        self.pages: set[str] = set()
        self.problems: list[str] = []
        self.constants = dict(_text_constants(tree))
        # Also where a function of the module takes the page by position.
        self.pages.update(value for value in self.constants.values() if re.fullmatch(r"docs/[\w/.-]+\.md", value))
        self.parameters: list[set[str]] = []
        self.visit(tree)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        arguments = node.args
        self.parameters.append({a.arg for a in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)})
        self.generic_visit(node)
        self.parameters.pop()

    def visit_Call(self, node: ast.Call) -> None:
        name = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
        page = next((keyword.value for keyword in node.keywords if keyword.arg == "page"), None)
        place = f"{self.where}:{node.lineno}"
        if page is None and name in self.positions and len(node.args) > self.positions[name]:
            page = node.args[self.positions[name]]
        taken_off = name == "replace" and isinstance(page, ast.Constant) and page.value == ""  # a notebook has no links
        if page is not None and not taken_off:
            self.take(page, place)
        elif name in self.positions and self.explained:
            self.problems.append(f"{place}: expected a page for this {name}, got none")
        self.generic_visit(node)

    def take(self, page: ast.expr, place: str) -> None:
        match page:
            case ast.Constant(value=str(literal)):
                self.pages.add(literal)
            case ast.Name(id=name) if name in self.constants:
                self.pages.add(self.constants[name])
            case ast.Name(id=name) if any(name in names for names in self.parameters):
                pass  # the caller names the file
            case ast.Attribute(attr="page"):
                pass  # handed on from another item
            case _:
                self.problems.append(
                    f"{place}: expected a literal page, or a constant of this file, got {ast.unparse(page)}"
                )


def named_pages(root: Path) -> tuple[dict[str, set[str]], list[str]]:
    """Pages that the sources name, each with the files that name it; and what is wrong there."""
    positions = position_of_page(root)
    pages: dict[str, set[str]] = {}
    problems: list[str] = []
    for package in SOURCES:
        for file in sorted((root / "python" / "hexservo" / package).rglob("*.py")):
            found = _Pages(file.relative_to(root).as_posix(), file.read_text(encoding="utf-8"), positions)
            problems += found.problems
            for page in found.pages:
                pages.setdefault(page, set()).add(found.where)
    return pages, problems


# ---- What the pages hold --------------------------------------------------------------------------------------------


def sections_of(page: Path) -> list[tuple[str, str]]:
    """Second-level headings and the prose below each, code blocks left out."""
    parts = re.split(r"^## +(.+?) *$", prose_of(page), flags=re.MULTILINE)
    return list(zip(parts[1::2], parts[2::2], strict=True))


def has_a_sentence(text: str) -> bool:
    """Whether four words or more end as a sentence does; tables, headings and what is still to do are none."""
    prose = "\n".join(line for line in text.splitlines() if not line.lstrip().startswith(("|", "#", "<!--")))
    unfinished = re.search(r"\b(?:TODO|TBD|FIXME)\b", prose)
    return not unfinished and re.search(r"(?:\S+\s+){3,}\S*[.:!?][)\]*_`\"]*(?:\s|$)", prose) is not None


def named_tests(text: str) -> Iterator[tuple[str, str]]:
    """Tests that a page names: the file from the root, and the name in `file::name` or `file: name`, or nothing."""
    for path, name in re.findall(r"(?<![\w/.])(?:\.\./)*(tests/[\w./-]*\w\.\w+)(?:::(\w+(?:::\w+)*))?", text):
        yield path, name
    for link in links_in(text):  # [test_x.py::name](../../tests/python/test_x.py)
        path = re.sub(r"^(?:\.\./)*", "", link.target)
        _, _, name = link.text.replace("`", "").partition("::" if path.endswith(".py") else ": ")
        if path.startswith("tests/") and name:
            yield path, name


def problems_of_page(root: Path, name: str) -> Iterator[str]:
    """What a page of a quantity lacks."""
    page = root / name
    if not (name.startswith("docs/") and name.endswith(".md") and page.is_file()):
        yield f"{name}: expected a Markdown file of docs/, got none"
        return
    if name in GUIDES:
        return
    sections = sections_of(page)
    found = [heading for heading, _ in sections]
    if [heading for heading in found if heading in HEADINGS] != HEADINGS:
        yield f"{name}: expected the headings {HEADINGS} once and in this order, got {found}"
    for heading, text in sections:
        if heading in HEADINGS and not has_a_sentence(text):
            yield f"{name}: expected a sentence below {heading!r}, got {text.strip()!r}"
    tests = list(named_tests(prose_of(page)))
    if not any(named_tests(dict(sections).get(HEADINGS[-1], ""))):
        yield f"{name}: expected a test of tests/ below {HEADINGS[-1]!r}, got none"
    for path, test in tests:
        file = root / path
        if not file.is_file():
            yield f"{name}: names {path}, which does not exist"
        elif test and test not in (python_tests(file) if file.suffix == ".py" else cpp_tests(file)):
            yield f"{name}: names {path}::{test}, and the file has no such test"


def pages_of_quantities(root: Path) -> list[str]:
    """Pages that there are, whether a source names them or not."""
    pages = [page for folder in FOLDERS for page in sorted((root / "docs" / folder).rglob("*.md"))]
    return [page.relative_to(root).as_posix() for page in pages if page.name != "README.md"]


def reached_pages(root: Path, named: set[str]) -> set[str]:
    """Pages that readers come to: named by a source, or linked by an index, or by a page that they come to.

    An index is the README, a page directly in docs/, or a README further down.
    """
    docs = root / "docs"
    to_read = [root / "README.md", *docs.glob("*.md"), *docs.glob("*/README.md"), *(root / name for name in named)]
    reached: set[Path] = set()
    while to_read:
        page = to_read.pop().resolve()
        if page in reached or page.suffix != ".md" or not page.is_file():
            continue
        reached.add(page)
        to_read += [page.parent / link.target.partition("#")[0] for link in links_in(prose_of(page))]
    return {page.relative_to(root.resolve()).as_posix() for page in reached if page.is_relative_to(root.resolve())}


def problems_of(root: Path) -> list[str]:
    """Everything that is wrong, in sentences."""
    named, problems = named_pages(root)
    there = pages_of_quantities(root)
    for name in sorted({*named, *there}):
        problems += problems_of_page(root, name)
    for name in sorted(set(there) - reached_pages(root, set(named))):
        problems.append(f"{name}: no source names this page, and no index and no named page leads to it")
    return problems


# ---- This tree ------------------------------------------------------------------------------------------------------


def test_every_quantity_has_its_page() -> None:
    problems = problems_of(ROOT)
    assert not problems, "\n".join(problems)


def test_the_overview_has_every_page_and_says_what_kind_of_statement_it_makes() -> None:
    overview = ROOT / "docs" / "proof.md"
    kinds: set[str] = set()
    used: set[str] = set()
    for head, rows in tables_in(prose_of(overview)):
        if head[0] == "kind":
            kinds = {row[0] for row in rows}
        if head == ["question", "quantity", "kind", "page"]:
            used |= {row[2] for row in rows}
    assert used == kinds != set()
    linked = {(overview.parent / link.target).resolve() for link in links_in(prose_of(overview))}
    missing = [page for page in pages_of_quantities(ROOT) if (ROOT / page).resolve() not in linked]
    assert not missing, f"docs/proof.md has no link to {', '.join(missing)}"


# ---- What the test would find: a small tree, sound, and then broken in each way -------------------------------------

EVIDENCE = "python/hexservo/findings/evidence.py"
SOURCE = "python/hexservo/findings/analysis/part.py"
DOCS = "docs"  # apart, since these pages are made up: test_docs.py looks for every page that a source names
PAGE = f"{DOCS}/analysis/part.md"
OTHER = f"{DOCS}/analysis/other.md"
LOST = f"{DOCS}/diagnosis/lost.md"
INDEX = f"{DOCS}/index.md"
TREE_PAGE = """# Part

## What it is

The part of a whole that a sum leaves.

## Formula

```text
a + b = c
```

Here c is the whole [m].

## Source

Textbooks have it.
It is not claimed.

## Limits

It does not hold for wholes without parts.

## How it is tested

By hand: [test_part.py::test_of_part](../../tests/python/test_part.py),
`tests/python/test_part.py::TestPart::test_deep`, and
[test_part.cpp: a case](../../tests/cpp/test_part.cpp) of tests/cpp/test_part.cpp.
"""
TREE = {
    SOURCE: f"""
_PAGE = "{PAGE}"

def section(item, rows):
    table = Table("Title", (), rows, "A note.", _PAGE)
    return [table, Curves("Title", "x", "y", (), page="{PAGE}"), replace(item, page=item.page)]

def helper(page):
    return _evidence.HeatMap("Title", "x", "y", "z", 1, 2, 3, page=page)
""",
    PAGE: TREE_PAGE,
    OTHER: TREE_PAGE.replace("# Part", "# Other"),
    INDEX: "# Index\n\nSee [the other page](analysis/other.md#other).\n",
    "tests/python/test_part.py": "def test_of_part(): pass\n\nclass TestPart:\n    def test_deep(self): pass\n",
    "tests/cpp/test_part.cpp": 'TEST_CASE("a case") {}\n',
}
HOW = TREE_PAGE.partition("## How it is tested\n")[2]


def write_tree(root: Path, changed: dict[str, str]) -> None:
    evidence = (ROOT / EVIDENCE).read_text(encoding="utf-8")
    for name, text in {EVIDENCE: evidence, **TREE, **changed}.items():
        file = root / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")


def test_a_sound_tree_is_accepted(tmp_path: Path) -> None:
    write_tree(tmp_path, {})
    assert named_pages(tmp_path) == ({PAGE: {SOURCE}}, [])
    assert problems_of(tmp_path) == []


def replaced(name: str, old: str, new: str) -> dict[str, str]:
    assert TREE[name].count(old) >= 1, old
    return {name: TREE[name].replace(old, new)}


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        (replaced(SOURCE, '"A note.", _PAGE)', '"A note.")'), "part.py:5: expected a page for this Table, got none"),
        (replaced(SOURCE, "3, page=page)", "3)"), "part.py:9: expected a page for this HeatMap, got none"),
        (
            replaced(SOURCE, 'note.", _PAGE', 'note.", f"docs/{rows}.md"'),
            "part.py:5: expected a literal page, or a constant",
        ),
        (
            replaced(SOURCE, "analysis/part", "analysis/parts"),
            "analysis/parts.md: expected a Markdown file",
        ),
        (
            replaced(SOURCE, PAGE, "tests/cpp/test_part.cpp"),
            "test_part.cpp: expected a Markdown file of docs",
        ),
        (
            replaced(PAGE, "## Limits\n\nIt does not hold for wholes without parts.\n", ""),
            "part.md: expected the headings",
        ),
        (replaced(PAGE, "## Source", "### Source"), "part.md: expected the headings"),
        (replaced(PAGE, "## Source", "## Formula"), "part.md: expected the headings"),
        (replaced(PAGE, "It does not hold for wholes without parts.", ""), "expected a sentence below 'Limits'"),
        (replaced(PAGE, "It does not hold for wholes without parts.", "None."), "expected a sentence below 'Limits'"),
        (
            replaced(PAGE, "It does not hold for wholes", "TODO: it does not hold for wholes"),
            "expected a sentence below 'Limits'",
        ),
        (replaced(PAGE, "Here c is the whole [m].", ""), "expected a sentence below 'Formula'"),
        (replaced(PAGE, HOW, "\nBy hand, and with much care.\n"), "expected a test of tests/ below 'How it is tested'"),
        (
            replaced(PAGE, "test_of_part", "test_of_nothing"),
            "test_part.py::test_of_nothing, and the file has no such test",
        ),
        (replaced(PAGE, "TestPart::test_deep", "test_deep"), "test_part.py::test_deep, and the file has no such test"),
        (
            replaced(PAGE, "test_part.cpp: a case", "test_part.cpp: another"),
            "test_part.cpp::another, and the file has no such",
        ),
        (
            replaced(PAGE, "of tests/cpp/test_part.cpp", "of tests/cpp/test_gone.cpp"),
            "names tests/cpp/test_gone.cpp, which",
        ),
        (replaced(INDEX, "analysis/other.md", "analysis/part.md"), "other.md: no source names this page"),
        ({LOST: TREE_PAGE}, "lost.md: no source names this page"),
        ({OTHER: "# Other\n"}, "other.md: expected the headings"),
    ],
)
def test_whatever_is_missing_is_found(tmp_path: Path, changed: dict[str, str], expected: str) -> None:
    write_tree(tmp_path, changed)
    problems = problems_of(tmp_path)
    assert any(expected in problem for problem in problems), problems


def test_a_page_may_be_led_to_by_another_one(tmp_path: Path) -> None:
    linking = replaced(PAGE, "It is not claimed.", "It is half of [the other part](other.md).")
    write_tree(tmp_path, linking | {INDEX: "# Index\n"})
    assert problems_of(tmp_path) == []


def test_a_report_may_show_tables_that_need_no_page(tmp_path: Path) -> None:
    write_tree(tmp_path, {"python/hexservo/report/page.py": 'Table("Versions", (), ())\n'})
    assert problems_of(tmp_path) == []
