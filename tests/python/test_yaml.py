"""The YAML reader: the core schema of YAML 1.2, what is refused, and the writer as its inverse."""

from __future__ import annotations

import contextlib
import copy
import errno
import math
import os
import pickle
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from hexservo.scenario.yaml import MAX_BYTES, MAX_DEPTH, ScenarioError, dump_yaml, load_yaml, read_yaml

# The examples and counter-examples of YAML 1.2.2, sections 10.2 and 10.3, and what YAML 1.1 took for something else.
CORE_SCHEMA = [
    ("", None),
    ("~", None),
    ("null", None),
    ("Null", None),
    ("NULL", None),
    ("nULL", "nULL"),
    ("true", True),
    ("True", True),
    ("TRUE", True),
    ("false", False),
    ("False", False),
    ("FALSE", False),
    ("tRUE", "tRUE"),
    ("on", "on"),
    ("off", "off"),
    ("yes", "yes"),
    ("No", "No"),
    ("y", "y"),
    ("0", 0),
    ("-19", -19),
    ("+12", 12),
    ("010", 10),
    ("08", 8),
    ("0o7", 7),
    ("0o17", 15),
    ("0o8", "0o8"),
    ("0x3A", 58),
    ("0xff", 255),
    ("-0x1", "-0x1"),
    ("0b1", "0b1"),
    ("1_000", "1_000"),
    ("190:20:30", "190:20:30"),
    ("1:30", "1:30"),
    ("0.", 0.0),
    ("-0.0", -0.0),
    (".5", 0.5),
    ("5.", 5.0),
    ("+12e03", 12000.0),
    ("-2E+05", -2e5),
    ("1e-6", 1e-6),
    ("1.5e3", 1500.0),
    ("1e400", math.inf),
    (".inf", math.inf),
    ("-.Inf", -math.inf),
    ("+.INF", math.inf),
    ("inf", "inf"),
    ("nan", "nan"),
    (".", "."),
    ("e5", "e5"),
    ("1e", "1e"),
    ("1.2.3", "1.2.3"),
    ("2001-12-14", "2001-12-14"),
    ("2001-12-14t21:59:43.10-05:00", "2001-12-14t21:59:43.10-05:00"),
    ("<<", "<<"),
    ("=", "="),
    ("'1'", "1"),
    ('"true"', "true"),
    ("!!str 1", "1"),
    ("!!float 1", 1.0),
    ("!!int '7'", 7),
    ("&anchor 3", 3),
    ("\ufeffa", "a"),
    ("[1, a, {b: 2}]", [1, "a", {"b": 2}]),
    ("<<: {a: 1}", {"<<": {"a": 1}}),
    ("%YAML 1.1\n---\non", "on"),
]


@pytest.mark.parametrize(("text", "value"), CORE_SCHEMA, ids=[repr(text) for text, _ in CORE_SCHEMA])
def test_core_schema(text: str, value: object) -> None:
    read = load_yaml(text)
    assert read == value
    assert type(read) is type(value)
    if isinstance(value, float) and isinstance(read, float):
        assert math.copysign(1, read) == math.copysign(1, value)


@pytest.mark.parametrize("text", [".nan", ".NaN", ".NAN"])
def test_not_a_number_is_a_float(text: str) -> None:
    value = load_yaml(text)
    assert isinstance(value, float)
    assert math.isnan(value)


REFUSED = [
    ("a: 1\nb: 2\na: 3", 'line 3: duplicate key "a" (first on line 1)'),
    ("{x: {a: 1, a: 1}}", 'duplicate key "a"'),
    ("a: &x 1\nb: *x", "line 2: the alias *x"),
    ("a: &x [*x]", "the alias *x"),
    ("1: a", "expected a key that is text, got 1"),
    ("true: a", "expected a key that is text, got true"),
    ("~: a", "expected a key that is text, got ~"),
    ("? [a, b]\n: c", "expected a key that is text, got a sequence"),
    ("a: 1\n---\nb: 2", "line 2, column 1: not valid YAML: expected a single document"),
    ("!!python/object/apply:os.getcwd []", "the tag !!python/object/apply:os.getcwd"),
    ("a: !local 1", "line 1: the tag !local"),
    ("!!binary aGk=", "the tag !!binary"),
    ("!!set {a}", "the tag !!set"),
    ("!!timestamp 2001-12-14", "the tag !!timestamp"),
    ("!!map [1]", "the tag !!map"),
    ("!!int x", 'expected text that fits the tag !!int, got "x"'),
    ("!!bool 1", "fits the tag !!bool"),
    ("!!float a", "fits the tag !!float"),
    ("a: 1\nb: !!float 0x10", 'line 2: expected text that fits the tag !!float, got "0x10"'),
    ("!!float 0o17", 'line 1: expected text that fits the tag !!float, got "0o17"'),
    ("a: b: c", "line 1, column 5: not valid YAML"),
    ("a: [1, 2", "not valid YAML: while parsing a flow sequence"),
    ("a: 'b", "not valid YAML"),
    ("\ta: 1", "line 1, column 1: not valid YAML: a tab; YAML indents with spaces"),
    ("\ufeffb: é\r\na:\r\n\tb: 1", "line 3, column 1: not valid YAML: a tab; YAML indents with spaces"),
    ("a:\n  b: 1\n\tc: 2", "line 3, column 1: not valid YAML: a tab; YAML indents with spaces"),
    ("- -\t- a: 1", "line 1, column 4: not valid YAML: a tab; YAML indents with spaces"),
    ("a: &\tx", "line 1, column 5: not valid YAML: while scanning an anchor"),
    ("a: 1\nb: @\t", "line 2, column 4: not valid YAML: while scanning"),
    ("a: \0", "the character U+0000 at 3"),
    ("a: \x1b[31m", "the character U+001B"),
    ("a: \ud800", "the character U+D800"),
    ('"\\UFFFFFFFF"', "escape"),
    ("%YAML 2.0\n---\na", "not valid YAML"),
    ("9" * 401, "expected an integer of at most 400 characters, got 401"),
    ("-" + "9" * 5000, "got 5001"),
    ("0x" + "f" * 10_000, "got 10002"),
    ("[" * (MAX_DEPTH + 2) + "]" * (MAX_DEPTH + 2), f"nested more than {MAX_DEPTH} levels"),
    ("[" * 100_000, "nested more than"),
    ("- " * 5_000, "nested more than"),
    ("{a: " * 5_000, "nested more than"),
    ("#" * (MAX_BYTES + 1), f"at most {MAX_BYTES} bytes"),
    ("é" * (MAX_BYTES // 2 + 1), f"at most {MAX_BYTES} bytes"),
]


@pytest.mark.parametrize(("text", "words"), REFUSED, ids=[repr(text[:24]) for text, _ in REFUSED])
def test_refused(text: str, words: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        load_yaml(text, "some.yaml")
    assert words in str(caught.value)
    assert str(caught.value).startswith("some.yaml: ")
    assert len(str(caught.value).splitlines()) == 1


def test_limits_are_reached() -> None:
    text = "[" * MAX_DEPTH + "1" + "]" * MAX_DEPTH
    value = load_yaml(text)
    for _ in range(MAX_DEPTH):
        assert isinstance(value, list)
        (value,) = value
    assert value == 1
    assert load_yaml("9" * 400) == 10**400 - 1
    assert load_yaml("1" + "#" * (MAX_BYTES - 1)) == "1" + "#" * (MAX_BYTES - 1)


def test_a_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "ü.yaml"
    path.write_bytes("\ufeffname: größe\r\nstep: 1e-6\r\n".encode())
    assert read_yaml(path) == {"name": "größe", "step": 1e-6}
    assert read_yaml(str(path)) == read_yaml(path)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    large = tmp_path / "large.yaml"
    large.write_bytes(b"a" * (MAX_BYTES + 1))
    latin = tmp_path / "latin.yaml"
    latin.write_bytes(b"name: gr\xf6\xdfe")
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    cases: list[tuple[str | Path, str]] = [
        (tmp_path / "absent.yaml", "cannot be read: No such file"),
        (tmp_path, "expected a regular file"),
        (pipe, "expected a regular file"),  # and reading does not wait for a writer
        ("/dev/zero", "expected a regular file"),
        ("a\0b", "cannot be read: embedded null"),
        (latin / "below", "cannot be read: Not a directory"),
        (large, f"at most {MAX_BYTES} bytes"),
        (latin, "expected UTF-8 text, got a byte that is none at 8"),
    ]
    for path, words in cases:
        with pytest.raises(ScenarioError) as caught:
            read_yaml(path)
        assert words in str(caught.value)


def test_a_file_without_permission(tmp_path: Path) -> None:
    path = tmp_path / "closed.yaml"
    path.write_text("a: 1")
    path.chmod(0)
    if os.access(path, os.R_OK):
        pytest.skip("this user may read every file")
    with pytest.raises(ScenarioError, match="Permission denied"):
        read_yaml(path)


def test_a_folder_that_may_not_be_searched_is_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The refusal of the system is made here, since root may search any folder."""
    stat = os.stat

    def guarded(path: str | Path, **options: bool) -> os.stat_result:
        if Path(path).parent == tmp_path:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return stat(path, **options)

    monkeypatch.setattr(os, "stat", guarded)
    with pytest.raises(ScenarioError, match=r"cannot be read: expected a regular file, got a folder$"):
        read_yaml(tmp_path, ["scenario.yaml"])


def test_the_error_has_one_line_per_problem_and_survives_copies() -> None:
    error = ScenarioError(["a: expected\none", "b: \x1b[31mred \ud800"], "f\n.yaml")
    assert str(error) == "f\\n.yaml: a: expected\\none\nf\\n.yaml: b: \\x1b[31mred \\ud800"
    for twin in (pickle.loads(pickle.dumps(error)), copy.copy(error)):
        assert (twin.problems, twin.source, str(twin)) == (error.problems, error.source, str(error))
    assert isinstance(error, ValueError)


# A carriage return or another line break may stand in text too; surrogates cannot be written as UTF-8.
TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=40)
TRICKY = st.sampled_from([text for text, _ in CORE_SCHEMA] + ["a: b", "# c", "- d", "{", "&e", "*f", "!g", "%h", "@i"])
SCALARS = st.none() | st.booleans() | st.integers(-(10**30), 10**30) | st.floats(allow_nan=False) | TEXT | TRICKY
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(TEXT | TRICKY, inner, max_size=5),
    max_leaves=8,
)


def same(one: object, other: object) -> bool:
    """Equal with equal types and bits, so that 1, 1.0 and True differ, and 0.0 and -0.0."""
    if isinstance(one, dict) and isinstance(other, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(same(a, b) for a, b in zip(one, other, strict=True))
    return type(one) is type(other) and repr(one) == repr(other)


@settings(deadline=None, derandomize=True, max_examples=100)
@given(st.dictionaries(TEXT | TRICKY, VALUES, max_size=5))
def test_what_is_written_is_read_back(value: dict[str, object]) -> None:
    assert same(load_yaml(dump_yaml(value)), value)


@settings(deadline=None, derandomize=True, max_examples=100)
@given(st.lists(st.floats(allow_nan=False, width=64), min_size=1))
def test_a_reader_of_yaml_1_1_agrees_on_floats(numbers: list[float]) -> None:
    assert same(yaml.safe_load(dump_yaml({"numbers": numbers})), {"numbers": numbers})


@settings(deadline=None, derandomize=True, max_examples=300)
@given(st.text(max_size=60) | st.text(alphabet="[]{}:,-?&*!|>'\"%@`# \n\ta1.", max_size=60))
def test_any_text_gives_a_value_or_the_error(text: str) -> None:
    with contextlib.suppress(ScenarioError):  # anything else would fail
        assert same(load_yaml(text), load_yaml(text, "again"))


def test_lists_of_numbers_stand_on_one_line() -> None:
    text = dump_yaml({"rows": [[1.0, 2e-6], [3.0, 4.0]], "empty": [], "same": [1.0] * 2})
    assert text == "rows:\n- [1.0, 2.0e-06]\n- [3.0, 4.0]\nempty: []\nsame: [1.0, 1.0]\n"


def test_values_that_occur_twice_are_written_twice() -> None:
    shared = [1.0, 2.0]
    assert load_yaml(dump_yaml({"a": shared, "b": shared})) == {"a": shared, "b": shared}
