"""Draws the packages of hexservo with the imports between them, read from the sources: docs/figures/packages.svg.

Run it as ``python docs/tools/packages.py`` in the source tree. An arrow points from the package that imports to the one
that is imported.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "python" / "hexservo"
PICTURE = ROOT / "docs" / "figures" / "packages.svg"

PACKAGES = ("scenario", "run", "findings", "campaigns", "bridges", "draw", "report", "cli")
"""From the lowest one up: each may import itself and those before it."""


class Import(NamedTuple):
    """One name that a module of hexservo imports from another one."""

    module: str  # that imports, below hexservo: "run.batch", "" for hexservo itself
    source: str  # that is imported
    name: str  # imported from it; empty for the module itself
    line: int
    for_types: bool = False  # below ``if TYPE_CHECKING``: it never runs


def module_name(path: Path, root: Path = SOURCES) -> str:
    """Return a file's module below hexservo: "run.batch", and "run" for the ``__init__`` of a package."""
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def tree_of(path: Path) -> ast.Module:
    """Read a file's syntax tree."""
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


@cache
def imports(root: Path = SOURCES) -> tuple[Import, ...]:
    """Read every import of a module of hexservo, those within functions and for type checkers alone included."""
    files = {module_name(path, root): path for path in sorted(root.rglob("*.py"))}
    return tuple(found for module, path in files.items() for found in _imports_of(module, path, files))


def _imports_of(module: str, path: Path, files: dict[str, Path]) -> Iterator[Import]:
    tree = tree_of(path)
    never_run = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.partition(".")[0] == "hexservo":
                    yield Import(module, alias.name.partition(".")[2], "", node.lineno, node in never_run)
        elif isinstance(node, ast.ImportFrom):
            if node.level:
                raise ValueError(f"{path}:{node.lineno}: expected an import by its whole name, got a relative one")
            package, _, source = (node.module or "").partition(".")
            if package == "hexservo":
                for alias in node.names:
                    inner = f"{source}.{alias.name}".lstrip(".")
                    is_module = inner in files or inner.startswith("_core")
                    found = (inner, "") if is_module else (source, alias.name)
                    yield Import(module, *found, node.lineno, node in never_run)


def package_of(module: str) -> str:
    """Return the package of a module; for one of none (hexservo itself and its public names) the empty text."""
    package = module.partition(".")[0]
    return package if package in PACKAGES else ""


def lines_of(package: str, root: Path = SOURCES) -> int:
    """Count the lines of a package's Python files."""
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in (root / package).rglob("*.py"))


def arrows(root: Path = SOURCES) -> list[tuple[str, str]]:
    """Return the pairs of packages of which the first imports the second."""
    pairs = {(package_of(found.module), package_of(found.source)) for found in imports(root)}
    return sorted(pair for pair in pairs if all(pair) and pair[0] != pair[1])


# ---- The picture ----------------------------------------------------------------------------------------------------

_WIDTH, _HEIGHT, _GAP = 400, 46, 30  # of a box and between boxes [px]
_TOP, _CURVE = 16, 34  # above the column of boxes, and how far an arrow bows per package that it skips
_LEFT = 3 * _CURVE * (len(PACKAGES) - 1) // 4 + 12  # of the column: a curve goes 3/4 of the way to its control points


def picture(root: Path = SOURCES) -> str:
    """Return the picture as SVG: the packages in a column, cli on top, every arrow downwards."""
    place = {name: index for index, name in enumerate(reversed(PACKAGES))}
    height = _TOP * 2 + len(PACKAGES) * (_HEIGHT + _GAP) - _GAP
    width = 2 * _LEFT + _WIDTH
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
        'font-family="sans-serif" font-size="13" text-anchor="middle">',
        "<title>The packages of hexservo: an arrow points from the one that imports to the one imported</title>",
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
        '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0,0 L8,4 L0,8 Z" fill="#0072B2"/></marker></defs>',
    ]
    parts += [_arrow(place[upper], place[lower]) for upper, lower in arrows(root)]
    for name, index in place.items():
        x, y = _LEFT + _WIDTH // 2, _TOP + index * (_HEIGHT + _GAP)
        parts += [
            f'<rect x="{_LEFT}" y="{y}" width="{_WIDTH}" height="{_HEIGHT}" rx="6" fill="#eef4fa" stroke="#444444"/>',
            f'<text x="{x}" y="{y + 20}" font-weight="bold">{name}</text>',
            f'<text x="{x}" y="{y + 37}" fill="#555555" font-size="11">{_meaning(root / name)}</text>',
        ]
    return "\n".join([*parts, "</svg>", ""])


def _meaning(package: Path) -> str:
    """Return the first line of a package's docstring."""
    docstring = ast.get_docstring(ast.parse((package / "__init__.py").read_text(encoding="utf-8"))) or ""
    return docstring.partition("\n")[0]


def _arrow(start: int, end: int) -> str:
    """Draw straight to the next box, else in a bow: to the right over an odd number of packages, else to the left."""
    skipped = end - start - 1
    from_y, to_y = (_TOP + index * (_HEIGHT + _GAP) for index in (start, end))
    if skipped == 0:
        x = _LEFT + _WIDTH // 2
        way = f"M{x},{from_y + _HEIGHT} L{x},{to_y}"
    else:
        side = 1 if skipped % 2 else -1
        x = _LEFT + (_WIDTH if side > 0 else 0)
        bow = x + side * _CURVE * (skipped + 1)
        first, last = from_y + _HEIGHT // 2 + 3 * skipped, to_y + _HEIGHT // 2 - 3 * skipped
        way = f"M{x},{first} C{bow},{first} {bow},{last} {x},{last}"
    return f'<path d="{way}" fill="none" stroke="#0072B2" stroke-width="1.3" marker-end="url(#head)"/>'


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
    print(f"{PICTURE.relative_to(ROOT)} is written")
    for name in PACKAGES:
        print(f"{name:<9}{lines_of(name):>6} lines")
