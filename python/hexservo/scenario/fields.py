"""Fields of data classes, named tuples and blocks: each has its text in the source alone, and `help` shows it."""

from __future__ import annotations

import dataclasses
import inspect
import re
import textwrap
from collections.abc import Iterator
from functools import cached_property
from typing import Any, TypeVar

from pydantic import BaseModel

__all__ = ["described", "field_names", "fields_of", "meanings_of"]

Kind = TypeVar("Kind", bound=type)
_WIDTH = 100  # of the lines of a field's text in `help`


def field_names(kind: Any) -> tuple[str, ...]:
    """Return the names of the fields of a data class or a named tuple; none of anything else."""
    if not inspect.isclass(kind):
        return ()
    if dataclasses.is_dataclass(kind):
        return tuple(field.name for field in dataclasses.fields(kind))
    return tuple(getattr(kind, "_fields", ())) if issubclass(kind, tuple) else ()


def fields_of(kind: type) -> list[tuple[str, str, str]]:
    """Return the fields of a class in order: name, type, and the comment beside or above it, or the string below it.

    Raises
    ------
    OSError
        Where the source is not there.
    """
    names = field_names(kind)
    return [field for field in _fields_in(inspect.getsource(kind)) if field[0] in names]


def meanings_of(block: type[BaseModel]) -> dict[str, str]:
    """Return what each key of a block of a scenario means, by its name: the text as of `fields_of`.

    Raises
    ------
    OSError
        Where the source is not there.
    """
    own = [kind for kind in reversed(block.__mro__) if issubclass(kind, BaseModel) and kind is not BaseModel]
    found = {name: text for kind in own for name, _, text in _fields_in(inspect.getsource(kind))}
    return {name: found[name] for name in block.model_fields}


def _fields_in(source: str) -> Iterator[tuple[str, str, str]]:
    """Find name, type and text of all that is declared in the source of a class."""
    lines = source.splitlines()
    for number, line in enumerate(lines):
        field = re.match(r"    (\w+): (.+?)(?:\s+=(?:\s.*?)?)?(?:\s+#\s*(.*))?$", line)
        if not field:
            continue
        beside = field[3]
        if not beside and line.endswith("(") and (inner := re.search(r"\s#\s*(.*)$", lines[number + 1])):
            beside = inner[1]  # of a default in brackets
        comment = [beside] if beside else []
        above = number - 1
        while above >= 0 and re.match(r"    # ", lines[above]):
            comment.insert(0, lines[above].strip("# "))
            above -= 1
        text = " ".join(comment)
        if not text and (below := re.match(r'    """(.*?)"""', "\n".join(lines[number + 1 :]), re.DOTALL)):
            text = " ".join(below[1].split())
        yield field[1], field[2].strip(), text


def described(kind: Kind) -> Kind:
    """Append the fields of a class to its docstring, as a section Attributes: a decorator.

    The source is read when the docstring is, not at import.
    """
    kind.__doc__ = _Docstring(kind)  # type: ignore[assignment]
    return kind


class _Docstring:
    """Docstring of a class with its fields; the first to read it also gives those of a named tuple theirs."""

    def __init__(self, kind: type) -> None:
        self._kind = kind
        self._own = kind.__doc__

    def __get__(self, instance: object, kind: type | None = None) -> str | None:
        return self._text

    @cached_property
    def _text(self) -> str | None:
        try:
            fields = fields_of(self._kind)
        except OSError:  # a package without its source
            return self._own
        if self._own is None:  # python -OO
            return None
        lines = [inspect.cleandoc(self._own), "", "Attributes", "----------"]
        for name, annotation, text in fields:
            lines += [
                f"{name} : {annotation}",
                *textwrap.wrap(text, _WIDTH, initial_indent=" " * 4, subsequent_indent=" " * 4),
            ]
            if not dataclasses.is_dataclass(self._kind):
                getattr(self._kind, name).__doc__ = text
        return "\n".join(lines)
