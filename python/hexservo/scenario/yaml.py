"""YAML in and out, as scenarios and the command line use it.

Reading is safe and predictable: only the YAML 1.2 core schema (``1e-6`` is a number, ``on`` is text, ``010`` is ten),
only plain data, and nothing that can surprise later: no duplicate keys, no aliases, no second document, no file over
`MAX_BYTES`. Writing is the inverse: what `dump_yaml` writes, `load_yaml` reads back equal, every float bit for bit.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import yaml

from hexservo.scenario.reading import HDF5, SCENARIO_OF_RUN, open_regular, path_text

Plain: TypeAlias = "bool | int | float | str | list[Plain] | dict[str, Plain] | None"
"""What a document holds: nothing but the types of the YAML core schema."""

MAX_BYTES = 4_000_000
"""Largest document that is parsed [bytes]; most scenarios need a few thousand, two recordings of the most samples with
all digits of their numbers 2.8 million."""

MAX_DEPTH = 32
"""Deepest nesting of lists and mappings that is read; a scenario needs seven."""

_MAX_INTEGER_CHARACTERS = 400  # no double is longer, and Python refuses to convert far longer ones

_NULL = "tag:yaml.org,2002:null"
_BOOL = "tag:yaml.org,2002:bool"
_INT = "tag:yaml.org,2002:int"
_FLOAT = "tag:yaml.org,2002:float"
_STR = "tag:yaml.org,2002:str"
_SEQ = "tag:yaml.org,2002:seq"
_MAP = "tag:yaml.org,2002:map"

_DECIMAL = r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?"

# YAML 1.2.2, section 10.3.2 (core schema), in the order of its table; with the characters a scalar may start with.
_CORE_SCHEMA: tuple[tuple[str, re.Pattern[str], list[str]], ...] = (
    (_NULL, re.compile(r"(?:null|Null|NULL|~|)\Z"), ["n", "N", "~", ""]),
    (_BOOL, re.compile(r"(?:true|True|TRUE|false|False|FALSE)\Z"), list("tTfF")),
    (_INT, re.compile(r"(?:[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)\Z"), list("-+0123456789")),
    (
        _FLOAT,
        re.compile(rf"(?:{_DECIMAL}|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))\Z"),
        list("-+.0123456789"),
    ),
)
_SCALAR_PATTERNS = {tag: pattern for tag, pattern, _ in _CORE_SCHEMA}


class ScenarioError(ValueError):
    """A scenario, or the file or text it comes from, is not valid.

    Its text has one line per problem: ``key.path: expected ..., got ...``, headed by the source if there is one.

    Attributes
    ----------
    problems
        One sentence per problem, without the source.
    source
        The file or the packaged name that was read, or None.
    """

    def __init__(self, problems: str | Sequence[str], source: str | None = None) -> None:
        lines = (problems,) if isinstance(problems, str) else problems
        self.problems: tuple[str, ...] = tuple(_printable(line) for line in lines)
        self.source = source
        super().__init__(self.problems, source)  # the arguments, so that copies and pickles are whole

    def __str__(self) -> str:
        """Return the problems, one a line, each after its source."""
        head = f"{_printable(self.source)}: " if self.source else ""
        return "\n".join(head + problem for problem in self.problems)


def _printable(text: str) -> str:
    """Escape what a terminal cannot show on one line, whatever a file had in it."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


if TYPE_CHECKING or not yaml.__with_libyaml__:

    class _Parser(yaml.reader.Reader, yaml.scanner.Scanner, yaml.parser.Parser):
        """Gives the events of a document."""

        def __init__(self, text: str) -> None:
            yaml.reader.Reader.__init__(self, text)
            yaml.scanner.Scanner.__init__(self)
            yaml.parser.Parser.__init__(self)

    from yaml import SafeDumper as _SafeDumper
else:
    from yaml.cyaml import CParser as _Parser  # the same by libyaml, about twenty times as fast
    from yaml.cyaml import CSafeDumper as _SafeDumper  # likewise, four times as fast


class _Loader(yaml.composer.Composer, _Parser, yaml.resolver.Resolver):
    """Composes nodes tagged by the core schema; refuses aliases and deep nesting before they cost anything."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012 (PyYAML's own attribute)

    def __init__(self, text: str) -> None:
        _Parser.__init__(self, text)
        yaml.composer.Composer.__init__(self)
        yaml.resolver.Resolver.__init__(self)
        self._depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent):
            raise _RefusedError(event, f"the alias *{event.anchor} is not supported; write the value out")
        if self._depth > MAX_DEPTH:
            raise _RefusedError(event, f"nested more than {MAX_DEPTH} levels deep")
        self._depth += 1
        try:
            return super().compose_node(parent, index)
        finally:
            self._depth -= 1


for _tag, _pattern, _first in _CORE_SCHEMA:
    _Loader.add_implicit_resolver(_tag, _pattern, _first)


class _RefusedError(Exception):
    """A construct outside what we read, with its line."""

    def __init__(self, place: yaml.Node | yaml.Event, problem: str) -> None:
        super().__init__(f"line {_line(place)}: {problem}")


def _line(place: yaml.Node | yaml.Event) -> int:
    return 0 if place.start_mark is None else place.start_mark.line + 1


def decimal(text: str) -> float | None:
    """Return the number that a text is in the decimal form of YAML, as 1, .5 or 1e-6; None for any other text.

    Python's own conversion reads more: 0_2 as 2, digits of every script, inf and nan. A number beyond double precision
    is infinite.
    """
    return float(text) if re.fullmatch(_DECIMAL, text) else None


def load_yaml(text: str, source: str | None = None) -> Plain:
    """Return the value of one YAML document.

    Parameters
    ----------
    text
        The document; a single scalar will do. Empty text is None.
    source
        Where the text comes from, for error messages.

    Raises
    ------
    ScenarioError
        It is not YAML or over `MAX_BYTES`, or it holds a duplicate key, a key that is no text, an alias, a tag outside
        the core schema, a second document, an integer of more than 400 characters, or too deep a nesting.
    """
    if len(text.encode("utf-8", "surrogatepass")) > MAX_BYTES:
        raise ScenarioError(f"expected at most {MAX_BYTES} bytes of YAML, got more", source)
    try:
        loader = _Loader(text)
        try:
            node = loader.get_single_node()
        finally:
            loader.dispose()
        return None if node is None else _value(node)
    except _RefusedError as refusal:
        raise ScenarioError(str(refusal), source) from None
    except yaml.YAMLError as error:
        raise ScenarioError(_in_words(error, text), source) from None
    except UnicodeEncodeError as error:
        raise ScenarioError(_no_character(ord(error.object[error.start]), error.start), source) from None
    except (ValueError, OverflowError):  # an escape that is no character, as "\\UFFFFFFFF"
        raise ScenarioError("not valid YAML: an escape that stands for no character", source) from None


def read_yaml(path: str | os.PathLike[str], in_folder: Sequence[str] = ()) -> Plain:
    """Return the value of the YAML document in a file, read as UTF-8; `in_folder` as for `open_regular`.

    Raises
    ------
    ScenarioError
        The file cannot be read, is no regular file, is over `MAX_BYTES` (which is checked before anything is parsed)
        or is not UTF-8; and as `load_yaml`.
    """
    source = path_text("path", path)
    text = read_text(path, "YAML", in_folder)
    return load_yaml(text, source)


def read_text(path: str | os.PathLike[str], kind: str, in_folder: Sequence[str] = ()) -> str:
    """Return the text of a file, UTF-8; `kind` is what its errors call it, `in_folder` as for `open_regular`.

    Raises
    ------
    ScenarioError
        The file cannot be read, is no regular file, is over `MAX_BYTES` or is not UTF-8.
    """
    source = path_text("path", path)
    try:
        content = _content(path, in_folder)
    except OSError as error:
        raise ScenarioError(f"cannot be read: {error.strerror or error}", source) from None
    except ValueError as error:  # no regular file, or a path with a NUL in it
        raise ScenarioError(f"cannot be read: {error}", source) from None
    return decoded(content, kind, source)


def decoded(content: bytes, kind: str, source: str) -> str:
    """Return what was read from a file or a stream as text, under the same rules as `read_text`."""
    if content.startswith(HDF5):
        raise ScenarioError(
            f"expected {kind}, got a netCDF or HDF5 file; a saved result is read by report, certify, analyse and "
            f"diagnose, and its scenario is {SCENARIO_OF_RUN} beside it",
            source,
        )
    if len(content) > MAX_BYTES:
        raise ScenarioError(f"expected at most {MAX_BYTES} bytes of {kind}, got more", source)
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ScenarioError(f"expected UTF-8 text, got a byte that is none at {error.start}", source) from None


def dump_yaml(value: Mapping[str, Any]) -> str:
    """Write one YAML document that `load_yaml` reads back equal, floats bit for bit.

    Numbers are written so that YAML 1.1 readers agree (``1.0e-06``), and text that either version would take for
    something else is quoted. Lists that hold no other list are written on one line.
    """
    return yaml.dump(value, Dumper=_Dumper, sort_keys=False, allow_unicode=True, default_flow_style=False, width=110)


def _content(path: str | os.PathLike[str], in_folder: Sequence[str]) -> bytes:
    """Return the bytes of a regular file, at most MAX_BYTES + 1."""
    with open_regular(path, in_folder) as file:
        return file.read(MAX_BYTES + 1) or b""  # None: a file of the system that has nothing now


def _value(node: yaml.Node) -> Plain:
    """Return the plain value of a composed node; its depth is bounded by the loader."""
    if isinstance(node, yaml.ScalarNode):
        return _scalar(node)
    if isinstance(node, yaml.SequenceNode) and node.tag == _SEQ:
        return [_value(item) for item in node.value]
    if isinstance(node, yaml.MappingNode) and node.tag == _MAP:
        return _mapping(node)
    raise _RefusedError(node, f"the tag {_short_tag(node.tag)} is not supported here")


def _mapping(node: yaml.MappingNode) -> dict[str, Plain]:
    mapping: dict[str, Plain] = {}
    lines: dict[str, int] = {}
    for key_node, value_node in node.value:
        if not isinstance(key_node, yaml.ScalarNode) or key_node.tag != _STR:
            got = key_node.value if isinstance(key_node, yaml.ScalarNode) else f"a {key_node.id}"
            raise _RefusedError(key_node, f"expected a key that is text, got {got[:60]}")
        key = key_node.value
        if key in mapping:
            raise _RefusedError(key_node, f'duplicate key "{key[:60]}" (first on line {lines[key]})')
        mapping[key] = _value(value_node)
        lines[key] = _line(key_node)
    return mapping


def _scalar(node: yaml.ScalarNode) -> bool | int | float | str | None:
    """Convert a scalar by its tag, which is implicit (from the core schema) or written (``!!float 1``)."""
    text: str = node.value
    if node.tag == _STR:
        return text
    pattern = _SCALAR_PATTERNS.get(node.tag)
    if pattern is None:
        raise _RefusedError(node, f"the tag {_short_tag(node.tag)} is not supported here")
    if not pattern.match(text):
        raise _RefusedError(node, f'expected text that fits the tag {_short_tag(node.tag)}, got "{text[:60]}"')
    if node.tag == _NULL:
        return None
    if node.tag == _BOOL:
        return text.lower() == "true"
    if node.tag == _INT:
        if len(text) > _MAX_INTEGER_CHARACTERS:
            raise _RefusedError(node, f"expected an integer of at most 400 characters, got {len(text)}")
        return int(text, {"0o": 8, "0x": 16}.get(text[:2], 10))
    return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))


def _short_tag(tag: str) -> str:
    return tag.replace("tag:yaml.org,2002:", "!!")[:60]


def _in_words(error: yaml.YAMLError, text: str) -> str:
    """Describe a syntax error in a text on one line, with its place."""
    if isinstance(error, yaml.MarkedYAMLError):
        if error.problem == "exceeded maximum nesting depth":  # libyaml reads ahead, and has a limit too
            return f"nested more than {MAX_DEPTH} levels deep"
        parts = [part for part in (error.context, error.problem) if part]
        mark = error.problem_mark or error.context_mark
        place = "" if mark is None else f"line {mark.line + 1}, column {mark.column + 1}: "
        if mark is not None and _indents_with_tab(text.removeprefix("\ufeff"), mark):
            return f"{place}not valid YAML: a tab; YAML indents with spaces"
        return f"{place}not valid YAML: {', '.join(parts)}"
    if isinstance(error, yaml.reader.ReaderError):
        return _no_character(error.character, error.position)
    return "not valid YAML: " + " ".join(str(error).split())


def _indents_with_tab(text: str, mark: yaml.Mark) -> bool:
    """Return whether a tab is at a mark with nothing but blanks and the dashes of lists before it on its line."""
    before = text[mark.index - mark.column : mark.index]
    return text[mark.index : mark.index + 1] == "\t" and not before.strip(" \t-")


def _no_character(code: int, position: int) -> str:
    return f"not valid YAML: the character U+{code:04X} at {position} is not allowed"


class _Dumper(_SafeDumper):
    """Writes block style with short lists in flow style, and no anchors."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

    def represent_number(self, value: float) -> yaml.ScalarNode:
        text = repr(value)
        if "e" in text and "." not in text:
            text = text.replace("e", ".0e")  # YAML 1.1 takes 1e-06 for text
        return self.represent_scalar(_FLOAT, {"inf": ".inf", "-inf": "-.inf", "nan": ".nan"}.get(text, text))

    def represent_text(self, value: str) -> yaml.ScalarNode:
        # Line breaks do not all survive the other styles.
        return self.represent_scalar(_STR, value, style=None if value.isprintable() else '"')

    def represent_rows(self, values: list[Any]) -> yaml.SequenceNode:
        nested = any(isinstance(value, list | dict) for value in values)
        return self.represent_sequence(_SEQ, values, flow_style=not nested)


_Dumper.add_representer(float, _Dumper.represent_number)
_Dumper.add_representer(str, _Dumper.represent_text)
_Dumper.add_representer(list, _Dumper.represent_rows)
for _tag, _pattern, _first in _CORE_SCHEMA:  # on top of those of YAML 1.1: text that either would convert is quoted
    _Dumper.add_implicit_resolver(_tag, _pattern, _first)
