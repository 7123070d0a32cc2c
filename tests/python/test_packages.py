"""The packages of hexservo: imports go downwards only, and modules stay small."""

from __future__ import annotations

import pytest

from packages import PACKAGES, PICTURE, SOURCES, Import, imports, module_name, package_of, picture

MOST_LINES = 500
TOP = {"", "plots", "__main__"}  # the public names: hexservo itself and hexservo.plots
IMPORTS = imports()


def level(module: str) -> int:
    """The public names stand above what they name, and below the commands, which use them as everybody does."""
    if module.startswith("_core"):
        return -1
    if package := package_of(module):
        return 2 * PACKAGES.index(package)
    assert module in TOP, f"{module} is in none of the packages {', '.join(PACKAGES)}"
    return 2 * len(PACKAGES) - (1 if module == "__main__" else 3)


def upward(found: list[Import]) -> list[str]:
    return [
        f"{a.module}:{a.line}: imports {a.source}, a level above" for a in found if level(a.source) > level(a.module)
    ]


def test_imports_go_downwards() -> None:
    """Also those within functions, and those for type checkers: whoever reads an annotation looks its class up."""
    assert upward(IMPORTS) == []
    assert upward([Import("run.batch", "draw.batch", "batch_figure", 1)]), "the check finds nothing"


def circle(found: list[Import]) -> list[str]:
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
    assert circle(IMPORTS) == []
    pairs = [Import("a", "b", "", 1), Import("b", "c", "", 1), Import("c", "a", "", 1)]
    assert circle(pairs) == ["a", "b", "c", "a"]


def test_no_private_name_leaves_its_module() -> None:
    private = [
        f"{each.module}:{each.line}: imports {each.source}.{each.name}"
        for each in IMPORTS
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


def test_the_picture_is_that_of_the_sources() -> None:
    assert PICTURE.read_text(encoding="utf-8") == picture(), "type: python docs/tools/packages.py"
