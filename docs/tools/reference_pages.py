"""Pages of the reference that are made from the commands of the command line and from the C++ headers."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from typer.main import get_command

from hexservo.cli.commands import app

ROOT = Path(__file__).resolve().parents[2]
HEADERS = ROOT / "cpp" / "include"


def commands_page() -> str:
    """Return the reference of the command line: what ``--help`` of each command prints."""
    group: Any = get_command(app)
    text = [
        "# Commands\n",
        f"{in_markdown(group.help)}\n",
        f"{in_markdown(group.epilog)} The [README](README.md#command-line) has examples.\n",
    ]
    for name, command in group.commands.items():
        context = command.make_context(name, [], resilient_parsing=True)
        usage = " ".join(
            ["hexservo", name, *(re.sub("[{}]", "", piece) for piece in command.collect_usage_pieces(context))]
        )
        text += [f"## {name}\n", f"```text\n{usage}\n```\n", f"{in_markdown(inspect.cleandoc(command.help))}\n"]
        records = [record for each in command.params if (record := each.get_help_record(context))]
        if records:
            text += ["| argument or option | |", "| --- | --- |"]
            text += [f"| `{head.replace(' <str>', '')}` | {in_markdown(meaning)} |" for head, meaning in records]
            text.append("")
    return "\n".join(text)


def in_markdown(text: str) -> str:
    """Return plain text as Markdown: options as code, pages as links, the rest as it is; code is left alone."""

    def marked(found: re.Match[str]) -> str:
        piece = found[0]
        if piece.startswith("docs/"):
            return f"[{piece}]({piece})" if (ROOT / piece).is_file() else piece
        if piece.startswith("`"):
            return piece
        return f"`{piece}`" if piece.startswith("--") else f"\\{piece}"

    return re.sub(r"`[^`]*`|(?<!\w)--[a-z][a-z-]*|docs/[\w/-]+\.md|[|*<\[\]]", marked, text)


def headers_page() -> str:
    """Return the list of the C++ headers: the README's table of questions, and all of them with what they are for."""
    text = [
        "# C++ headers\n",
        "The core is a library of headers, of which each equation is in one. They are documented in their comments.",
        "Programs in C and in other languages use [the C interface](docs/c-interface.md).\n",
        "## Where the equations live\n",
        '```{include} README.md\n:start-after: "## Where the equations live"\n:end-before: "## How to cite"\n```\n',
        "## Every header\n",
        "| header | |",
        "| --- | --- |",
        *(f"| [`{name}`](source:cpp/include/{name}) | {in_markdown(purpose)} |" for name, purpose in headers()),
    ]
    return "\n".join([*text, ""])


def headers() -> Iterator[tuple[str, str]]:
    """Yield the headers by their names as they are included, each with the first sentence of its comment.

    Raises
    ------
    SystemExit
        For a header without one.
    """
    for file in sorted(HEADERS.rglob("*.h*")):
        lines = file.read_text(encoding="utf-8").splitlines()
        comment = re.match(r"/// @file\n((?:/// .+\n)+)|/\*\* @file\n((?: \* .+\n)+)", "\n".join([*lines, ""]))
        if comment is None:
            raise SystemExit(
                f"{file.relative_to(ROOT)}: expected a first comment with @file and a sentence, got {lines[:2]}"
            )
        words = " ".join(line.lstrip("/* ") for line in (comment[1] or comment[2]).splitlines())
        yield file.relative_to(HEADERS).as_posix(), re.split(r"(?<=\.)\s", words)[0]
