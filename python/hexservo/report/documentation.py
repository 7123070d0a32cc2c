"""Pages of the documentation: where they are installed, and inside a report, so that "Explained in" always works."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from hexservo.report.html import Html, element

if TYPE_CHECKING:
    from markdown_it.token import Token

_FOLDER = "docs"


@cache
def page_path(name: str) -> Path | None:
    """Return where a page, such as "docs/model.md", is: in the installed package or the source tree; None: nowhere."""
    if not re.fullmatch(rf"{_FOLDER}/[\w/-]+\.md", name):
        return None
    roots = (Path(str(resources.files("hexservo"))), Path(__file__).resolve().parents[3])
    return next((root / name for root in roots if (root / name).is_file()), None)


def is_page(name: str) -> bool:
    """Return whether there is a page of this name."""
    return page_path(name) is not None


def anchor_of(name: str, heading: str = "") -> str:
    """Return the id of a page in the report, or of a heading of it that has this anchor in the page itself."""
    page = "page-" + name.removeprefix(f"{_FOLDER}/").removesuffix(".md").replace("/", "-")
    return f"{page}--{heading}" if heading else page


def page_html(name: str, included: Sequence[str]) -> Html:
    """Render a page as an element that opens when a link to it is followed.

    Links to pages that are `included` point to them; links to other files and to the network become plain text.

    Raises
    ------
    ValueError
        For a page that does not exist.
    """
    from markdown_it import MarkdownIt

    file = page_path(name)
    if file is None:
        raise ValueError(f"name: expected a page of {_FOLDER}/, got {name!r}")
    # HTML in a page is treated as text.
    renderer = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens = renderer.parse(re.sub(r"<!--.*?-->", "", file.read_text(encoding="utf-8"), flags=re.DOTALL))
    title = name
    seen: dict[str, int] = {}
    for token, inside in zip(tokens, [*tokens[1:], None], strict=True):
        if token.type == "heading_open" and inside is not None:
            plain = "".join(child.content for child in inside.children or [])
            if token.tag == "h1":
                title = plain
            token.attrSet("id", anchor_of(name, _slug(plain, seen)))
        if token.type in ("heading_open", "heading_close"):
            token.tag = f"h{min(6, int(token.tag[1]) + 2)}"  # below the report's own headings
        if token.children:
            token.children = [child for child in token.children if child.type != "image"]
            _relink(token.children, name, included)
    body = Html(renderer.renderer.render(tokens, renderer.options, {}))
    body = Html(body.replace("<table>", '<div class="scroll"><table>').replace("</table>", "</table></div>"))
    return element("details", element("summary", title), element("div", body, id=anchor_of(name)), class_="document")


def _slug(heading: str, seen: dict[str, int]) -> str:
    """Return a heading's anchor: lower case, no punctuation, hyphens for blanks, repeated ones numbered."""
    slug = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
    count = seen.get(slug, 0)
    seen[slug] = count + 1
    return f"{slug}-{count}" if count else slug


def _relink(tokens: list[Token], page: str, included: Sequence[str]) -> None:
    """Point the links of a paragraph into the report, or make them plain text."""
    kept: list[bool] = []
    for token in tokens:
        if token.type == "link_open":
            target, _, heading = str(token.attrGet("href") or "").partition("#")
            name = posixpath.normpath(posixpath.join(posixpath.dirname(page), target)) if target else page
            kept.append(name in included)
            token.attrs = {"href": f"#{anchor_of(name, heading)}"} if kept[-1] else {}
        if token.type in ("link_open", "link_close"):
            token.tag = "a" if kept[-1] else "span"
        if token.type == "link_close":
            kept.pop()
