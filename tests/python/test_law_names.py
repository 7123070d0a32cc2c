"""A law's name stands in its own files, in the list of laws, in prose and in scenarios: nowhere else.

Code that has to know something of a law asks its traits (`_core.LAW_TRAITS`) or its gains, so that a new law needs its
header, its place in the list, its block of gains and their formulas.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from hexservo.scenario.laws import LAWS
from test_docs import ROOT

SCENARIO = ROOT / "python" / "hexservo" / "scenario"
OWN = (SCENARIO / "laws.py", SCENARIO / "fitted.py")  # the blocks of gains, and the gains that fit a machine
NAME = re.compile(rf"\b(?:{'|'.join(LAWS)})\b")
TYPES = re.compile(rf"\b(?:{'|'.join(law.title().replace('_', '') for law in LAWS)})\b")


def docstrings(tree: ast.AST) -> set[int]:
    """Return the identities of the nodes that are docstrings."""
    bodies = (body for node in ast.walk(tree) if isinstance(body := getattr(node, "body", None), list))
    return {
        id(statement.value)
        for body in bodies
        for statement in body
        if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
    }


def named_in_code(source: str) -> Iterator[tuple[int, str]]:
    """Return lines and names of laws in the code of a module; comments and docstrings are prose."""
    tree = ast.parse(source)
    prose = docstrings(tree)
    for node in ast.walk(tree):
        text = ""
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in prose:
            text = node.value
        elif isinstance(node, ast.Attribute):
            text = node.attr
        elif isinstance(node, ast.Name):
            text = node.id
        elif isinstance(node, ast.keyword):
            text = node.arg or ""
        if found := NAME.search(text):
            yield getattr(node, "lineno", 0), found.group()


def test_the_check_finds_names() -> None:
    law = LAWS[0]
    for line in (f"x.controller.{law}.kv", f"law == '{law}'", f"f'controller.{law}.{{key}}'", f"Controller({law}=1)"):
        assert list(named_in_code(line)) == [(1, law)], line
    assert not list(named_in_code(f'"""Of the law `{law}`."""\nx = 1  # {law}\nx_{law} = 2\n'))


def test_python_names_no_law_outside_its_block() -> None:
    named = [
        f"{path.relative_to(ROOT)}:{line}: {name}"
        for path in sorted((ROOT / "python").rglob("*.py"))
        if path not in OWN
        for line, name in named_in_code(path.read_text(encoding="utf-8"))
    ]
    assert not named, f"expected code that asks the traits of a law, got names in {named}"


def test_the_core_names_no_law_outside_the_list() -> None:
    def code(path: Path) -> str:
        return re.sub(r"//.*", "", path.read_text(encoding="utf-8"))

    files = [path for path in sorted((ROOT / "cpp").rglob("*.?pp")) if "laws" not in path.parts]
    assert len(files) > 50
    named = [str(path.relative_to(ROOT)) for path in files if TYPES.search(code(path)) or NAME.search(code(path))]
    assert not named, f"expected code for every law of the list, got names in {named}"
