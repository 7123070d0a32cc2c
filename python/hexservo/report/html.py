"""HTML from Python: text is escaped unless it is HTML already, so that scenario names cannot inject markup."""

from __future__ import annotations

import json
from html import escape
from typing import Any

TITLE = "<!DOCTYPE html><!-- hexservo report, format 1 -->"
"""First line of every report, which distinguishes it from other files."""


class Html(str):
    """Text that is HTML."""

    __slots__ = ()


def element(tag: str, *children: str, **attributes: str | bool) -> Html:
    """Return an element; children that are not `Html` are escaped, as are all attributes.

    ``class_`` means class, ``aria_label`` aria-label and so on; True gives an attribute without a value.
    """
    head = "".join(
        f" {name.rstrip('_').replace('_', '-')}" + ("" if isinstance(value, bool) else f'="{escape(value)}"')
        for name, value in attributes.items()
        if not isinstance(value, bool) or value
    )
    inside = "".join(child if isinstance(child, Html) else escape(child, quote=False) for child in children)
    return Html(f"<{tag}{head}>{inside}</{tag}>")


def paragraphs(*texts: str) -> Html:
    """Return one paragraph for each text that is not empty."""
    return Html("".join(element("p", sentence(text)) for text in texts if text))


def sentence(text: str) -> Html:
    """Return words of a finding; what stands between backticks is code."""
    parts = text.split("`")
    if len(parts) % 2 == 0:  # one without its other half
        return Html(escape(text, quote=False))
    return Html("".join(element("code", part) if i % 2 else escape(part, quote=False) for i, part in enumerate(parts)))


def json_script(value: Any, **attributes: str) -> Html:
    """Return plain data inside a script element that is not executed; no text in it can close the element."""
    text = json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return element("script", Html(text), type="application/json", **attributes)
