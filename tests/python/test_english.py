"""What people read is in the field's English: pages, docstrings, comments and messages contain none of these phrases.

Pages are Markdown; sources are the Python and C++ files of package, core, tests, examples, benchmarks and tools.

Each pattern has the wording that replaces it. A word that is right in one place (a quotation, a command's name) is an
exception with its reason, and an exception that nothing needs any more is an error.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

from test_docs import ROOT, prose_of

# Pattern: what to write instead. Words have borders on both sides; case does not matter.
FORBIDDEN = {
    # code is no person: it estimates, uses, measures, returns, reports
    r"believe[sd]?|believing": "assumes; estimates",
    r"tells|told": "gives; reports; returns; decides",
    r"knows(?! of a)": "uses; has",
    r"wants": "needs; requires",
    r"answers to": "proportional to; depends on",
    r"says?|said|saying": "states; reports; gives",
    r"speaks? of": "is about; covers",
    r"taught|teach(?:es|ing)?": "changes (the weights); adapts",
    r"nobody|somebody|anybody|whoever": "(name the person or program)",
    r"(?:image|camera|target|picture)s? (?:hardly )?(?:shows?|tells?|sees?)": "is observable from; constrains",
    # observability
    r"hardly shows?|shows? badly|seen (?:worst|badly)": "poorly observable, weakly constrained",
    r"that a turn (?:undoes|about)": "barely distinguishable from rotation",
    r"turns times": "rotations scaled by",
    r"(?:a|the|small|tiny|random) turns?(?= about| of| and|,|\.)": "rotation",
    # paraphrases of a term of the field
    r"of (?:one's|its|their|his|her|my|your) own": "custom; user-defined; separate",
    r"all that is known": "full report",
    r"switching term holds": "stiction: residual errors held by the switching term",
    r"how things stand|what ends the set": "limit; limited by",
    r"as it was|as they were": "original; unchanged",
    r"without turning": "without oscillation",
    r"swings? through": "crosses",
    r"(?:keeps? the|the|how) books": "accumulates metrics; metrics accumulation",
    r"has nothing of|of nothing": "not present in this scenario",
    r"by 1/e": "has a time constant of",
    r"looks alone": "from the recorded signals alone",
    r"falls off on the way": "is a by-product",
    r"stands? (?:beside|against)|goes with": "is compared with",
    r"likeliest": "most likely",
    r"a good deal|a great many|nothing to judge": "(the number); not applicable",
    r"another one than|other than this one": "a different ... from",
    r"once more|anew": "again; repeated",
    r"in words": "with a message",
    r"what else is missing": "whatever else is missing",
    r"got it twice": "duplicate key",
    r"gone afterwards": "reset",
}

# A phrase may go over the end of a line.
SPACED = {pattern: pattern.replace(" ", r"(?:\s|#)+") for pattern in FORBIDDEN}
ANY = re.compile(rf"\b(?:{'|'.join(SPACED.values())})\b")  # of text in lower case: 14 times as fast as one by one

# Verbs that say less than Return, Compute, Check, Search, Classify.
CHATTY = {"Give", "Gives", "Tell", "Tells", "Say", "Says", "Ask", "Judge", "Know", "Look", "Work", "Go"}

# Exceptions: file from the root, phrase, the reason.
EXCEPTIONS = {
    ("python/hexservo/run/bench.py", "say"),  # name of a parameter
}

PAGES = [
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    *sorted(page.relative_to(ROOT).as_posix() for page in (ROOT / "docs").rglob("*.md")),
]
FOLDERS = ("python/hexservo", "cpp", "tests", "examples", "benchmarks", "docs/tools")
ENDINGS = (".py", ".cpp", ".hpp", ".in", ".yaml", ".js", ".txt")
SOURCES = [
    "CMakeLists.txt",
    "Makefile",
    *sorted(
        file.relative_to(ROOT).as_posix()
        for folder in FOLDERS
        for file in (ROOT / folder).rglob("*")
        if file.suffix in ENDINGS and file != Path(__file__).resolve()  # this file has the patterns
    ),
]


def readable_of_page(text: str) -> str:
    """Return the prose without code spans and without the names of tests, which links quote as they are."""
    text = re.sub(r"\[[^\[\]]*test_\w+\.(?:py|cpp)[^\]]*\](?=\()", "", text)
    return re.sub(r"(`+)(.+?)\1", "", text)


def readable_of_source(text: str) -> str:
    """Return comments and strings of a Python file, f-strings included, each on the line where it begins."""
    lines: dict[int, list[str]] = {}
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        name = tokenize.tok_name[token.type]
        if name in ("COMMENT", "STRING", "FSTRING_MIDDLE"):
            for offset, line in enumerate(token.string.splitlines()):
                lines.setdefault(token.start[0] + offset, []).append(line)
    return "\n".join(" ".join(lines.get(number, [])) for number in range(1, max(lines, default=0) + 1))


def readable_of_cpp(text: str) -> str:
    """Return comments and strings of a C++ file, each on the line where it begins."""
    parts, end = [], 0
    for found in re.finditer(r'//[^\n]*|/\*.*?\*/|R"(\w*)\(.*?\)\1"|"(?:\\.|[^"\\\n])*"', text, re.DOTALL):
        parts += ["\n" * text.count("\n", end, found.start()), found[0], " "]
        end = found.end()
    return re.sub(r"\n[ \t]*///?", "\n#", "".join(parts))  # a phrase may go over the end of a line


def readable(name: str) -> str:
    """Return what a person reads in a file of the project."""
    if name.endswith(".md"):
        return readable_of_page(prose_of(ROOT / name))
    text = (ROOT / name).read_text(encoding="utf-8")
    if name.endswith((".cpp", ".hpp", ".in", ".js")):
        return readable_of_cpp(text)
    return readable_of_source(text) if name.endswith(".py") else text


def found_in(text: str) -> Iterator[tuple[int, str, str]]:
    """Yield the line, the phrase and what to write instead; a phrase may go over the end of a line."""
    if not ANY.search(text.lower()):
        return
    for pattern, instead in FORBIDDEN.items():
        for match in re.finditer(rf"\b(?:{SPACED[pattern]})\b", text, re.IGNORECASE):
            yield text.count("\n", 0, match.start()) + 1, " ".join(match[0].split()), instead


@pytest.mark.parametrize("name", [*PAGES, *SOURCES])
def test_no_forbidden_phrase(name: str) -> None:
    problems = [
        f"{name}:{line}: {phrase!r}: write {instead}"
        for line, phrase, instead in found_in(readable(name))
        if (name, phrase.lower()) not in EXCEPTIONS
    ]
    assert not problems, "\n".join(problems)


@pytest.mark.parametrize("name", [name for name in SOURCES if name.startswith("python/") and name.endswith(".py")])
def test_docstrings_begin_with_a_plain_verb(name: str) -> None:
    """Return, Compute, Check; not Give, Tell, Say."""
    tree = ast.parse((ROOT / name).read_text(encoding="utf-8"))
    first = [
        (node.name, (ast.get_docstring(node) or "-").split()[0])
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    assert [each for each in first if each[1] in CHATTY] == []


def test_every_exception_is_needed() -> None:
    for name, phrase in EXCEPTIONS:
        assert phrase in {found.lower() for _, found, _ in found_in(readable(name))}, f"{name}: {phrase!r} is not there"


def test_a_forbidden_phrase_would_be_found() -> None:
    assert all(pattern == pattern.lower() for pattern in FORBIDDEN)
    page = "A law of one's\nown. `tells` and [test_x.py::test_what_it_tells](x.py) quote.\n"
    assert [(line, phrase) for line, phrase, _ in found_in(readable_of_page(page))] == [(1, "of one's own")]
    source = '"""Find what it\n\nhardly shows."""\ntold = f"{known} is the likeliest"  # swings\n# through zero\n'
    assert sorted(phrase for _, phrase, _ in found_in(readable_of_source(source))) == [
        "hardly shows",
        "likeliest",
        "swings # through",
    ]
    code = 'auto knows = f();  // what it\n// hardly shows\n/* told */ throw Error("got it \\"twice\\", anew");\n'
    assert sorted(phrase for _, phrase, _ in found_in(readable_of_cpp(code))) == ["anew", "hardly shows", "told"]
