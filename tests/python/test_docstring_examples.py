"""The examples of the package's docstrings give what they print."""

from __future__ import annotations

import doctest
from importlib import import_module
from pathlib import Path

import pytest

import hexservo as hs

PACKAGE = Path(hs.__file__).parent


def module_name(source: Path) -> str:
    parts = source.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = [module_name(source) for source in sorted(PACKAGE.rglob("*.py")) if "\n    >>> " in source.read_text("utf-8")]


@pytest.mark.parametrize("name", ["hexservo", *MODULES])
def test_examples_give_what_they_print(name: str) -> None:
    module = import_module(name)
    found = doctest.testmod(module, extraglobs={} if module is hs else {"hs": hs})
    assert found.attempted > 0
    assert found.failed == 0
