"""What Sphinx lacks for the site: pages of source files, and the fields of classes with their units in a table.

A link to ``source:cpp/include/hexservo/camera.hpp`` (docs/tools/build_site.py writes them) leads to a page that has
the file.
"""

from __future__ import annotations

import html
import posixpath
import re
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

from docutils import nodes
from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexers import TextLexer, get_lexer_for_filename
from pygments.util import ClassNotFound
from sphinx.application import Sphinx

from hexservo.scenario.fields import field_names, fields_of

ROOT = Path(__file__).resolve().parents[2]
SCHEME = "source:"
FOLDER = "source"  # of the pages, in the site
PROPERTIES: dict[str, list[str]] = {}  # docstrings by name, while Napoleon has them

PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{name}</title><style>
:root {{ color-scheme: light dark }}
body {{ margin: 1rem auto; max-width: 75rem; padding: 0 1rem; font-family: sans-serif }}
pre {{ overflow-x: auto; font-size: 0.85rem; line-height: 1.4 }}
.highlight {{ background: none }}
{light}
@media (prefers-color-scheme: dark) {{ {dark} .highlight {{ background: none }} }}
</style><p><a href="{home}">hexservo</a> / {name}</p>
{text}
"""


def source_page(path: str) -> str:
    """Return the page of a file or folder of the repository, as HTML."""
    file = ROOT / path
    home = "../" * (path.count("/") + 1) + "index.html"
    if file.is_dir():
        links = (
            f'<li><a href="{quote(f"{file.name}/{name}")}.html">{html.escape(name)}</a></li>' for name in inside(file)
        )
        text = f"<ul>{''.join(links)}</ul>"
    else:
        try:
            lexer = get_lexer_for_filename(file.name)
        except ClassNotFound:
            lexer = TextLexer()
        text = highlight(file.read_text(encoding="utf-8"), lexer, HtmlFormatter())
    styles = [HtmlFormatter(style=style).get_style_defs(".highlight") for style in ("default", "monokai")]
    return PAGE.format(name=html.escape(path), home=home, light=styles[0], dark=styles[1], text=text)


def inside(folder: Path) -> list[str]:
    """Return the names of the files and folders in a folder of the repository."""
    return sorted(each.name for each in folder.iterdir() if not each.name.startswith((".", "__pycache__")))


@cache
def write_source_pages(site: Path, path: str) -> None:
    """Write the page of a file or folder, and those of all that is in a folder."""
    written = site / FOLDER / f"{path}.html"
    written.parent.mkdir(parents=True, exist_ok=True)
    written.write_text(source_page(path), encoding="utf-8")
    if (ROOT / path).is_dir():
        for name in inside(ROOT / path):
            write_source_pages(site, f"{path}/{name}")


def point_to_sources(app: Sphinx, tree: nodes.document, page: str) -> None:
    """Turn links to source files into links to their pages, which are written here."""
    for link in tree.findall(nodes.reference):
        if not link.get("refuri", "").startswith(SCHEME):
            continue
        path = link["refuri"].removeprefix(SCHEME)
        name = f"{FOLDER}/{path}.html"
        if app.builder.format == "html":
            write_source_pages(Path(app.outdir), path)
        link["refuri"] = posixpath.relpath(name, posixpath.dirname(page) or ".")
        link["internal"] = True


def own_fields(kind: Any) -> list[tuple[str, str, str]]:
    """Return the fields of a data class or a named tuple, and none of anything else."""
    return fields_of(kind) if field_names(kind) else []


def before_napoleon(app: Sphinx, what: str, name: str, kind: Any, options: Any, lines: list[str]) -> None:
    """Cut the section of the fields off: the site has them in a table. Keep a copy of what a property has."""
    if what == "property":
        PROPERTIES[name] = list(lines)
    if own_fields(kind) and "Attributes" in lines:
        del lines[lines.index("Attributes") :]


def edit_docstring(app: Sphinx, what: str, name: str, kind: Any, options: Any, lines: list[str]) -> None:
    """Link the pages that a docstring names, and append the fields of a class as a table.

    A property has its own text again: Napoleon takes what is before a colon in its first line for a type.
    """
    if what == "property":
        lines[:] = PROPERTIES.pop(name)
    lines[:] = [re.sub(r"(?<![`/\w])docs/([\w/-]+)\.md", page_link, line) for line in lines]
    fields = own_fields(kind) if what in ("class", "exception") else []
    if fields:
        lines += ["", ".. list-table::", "   :header-rows: 1", "", "   * - field", "     - type", "     - "]
    for field, annotation, comment in fields:
        plain = re.sub(r"([*|]|_\b)", r"\\\1", comment)  # a comment has no markup but code in backticks
        lines += [f"   * - ``{field}``", f"     - ``{annotation}``", f"     - {plain}"]


def page_link(name: re.Match[str]) -> str:
    """Return a link to a page of the site, or the text unchanged where there is no such page."""
    return f":doc:`{name[0]} </docs/{name[1]}>`" if (ROOT / name[0]).is_file() else name[0]


def drop_signature(
    app: Sphinx, what: str, name: str, kind: Any, options: Any, signature: str | None, returned: str | None
) -> tuple[str, str] | None:
    """Leave the signature of a class with fields out: users read them, from the table, and make no such object.

    Nor do they make a scenario by its keys, which have a page.
    """
    return ("", "") if own_fields(kind) or hasattr(kind, "model_fields") else None


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect the parts to Sphinx."""
    app.connect("doctree-resolved", point_to_sources)
    app.connect("autodoc-process-docstring", before_napoleon, priority=400)
    app.connect("autodoc-process-docstring", edit_docstring, priority=600)  # after Napoleon
    app.connect("autodoc-process-signature", drop_signature)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
