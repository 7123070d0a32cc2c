"""What people read is in the field's English: pages, docstrings, comments and messages hold none of these phrases.

Each pattern has the wording that replaces it. A word that is right in one place (a quotation, a command's name) is an
exception with its reason, and an exception that nothing needs any more is an error.
"""

from __future__ import annotations

import io
import re
import tokenize
from collections.abc import Iterator

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

# Exceptions: file from the root, phrase, why it is right there.
EXCEPTIONS: set[tuple[str, str]] = set()

PAGES = [
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    *sorted(page.relative_to(ROOT).as_posix() for page in (ROOT / "docs").rglob("*.md")),
]
SOURCES = sorted(file.relative_to(ROOT).as_posix() for file in (ROOT / "python" / "hexservo").rglob("*.py"))


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


def found_in(text: str) -> Iterator[tuple[int, str, str]]:
    """Yield the line, the phrase and what to write instead; a phrase may go over the end of a line."""
    for pattern, instead in FORBIDDEN.items():
        spaced = pattern.replace(" ", r"(?:\s|#)+")
        for match in re.finditer(rf"\b(?:{spaced})\b", text, re.IGNORECASE):
            yield text.count("\n", 0, match.start()) + 1, " ".join(match[0].split()), instead


def problems_of(name: str, text: str) -> list[str]:
    return [
        f"{name}:{line}: {phrase!r}: write {instead}"
        for line, phrase, instead in found_in(text)
        if (name, phrase.lower()) not in EXCEPTIONS
    ]


@pytest.mark.parametrize("name", PAGES)
def test_pages_hold_no_forbidden_phrase(name: str) -> None:
    problems = problems_of(name, readable_of_page(prose_of(ROOT / name)))
    assert not problems, "\n".join(problems)


@pytest.mark.parametrize("name", SOURCES)
def test_sources_hold_no_forbidden_phrase(name: str) -> None:
    problems = problems_of(name, readable_of_source((ROOT / name).read_text(encoding="utf-8")))
    assert not problems, "\n".join(problems)


def test_every_exception_is_needed() -> None:
    for name, phrase in EXCEPTIONS:
        text = (ROOT / name).read_text(encoding="utf-8")
        readable = readable_of_page(text) if name.endswith(".md") else readable_of_source(text)
        assert phrase in {found.lower() for _, found, _ in found_in(readable)}, f"{name}: {phrase!r} is not there"


def test_a_forbidden_phrase_would_be_found() -> None:
    page = "A law of one's\nown. `tells` and [test_x.py::test_what_it_tells](x.py) quote.\n"
    assert [(line, phrase) for line, phrase, _ in found_in(readable_of_page(page))] == [(1, "of one's own")]
    source = '"""Find what it\n\nhardly shows."""\ntold = f"{known} is the likeliest"  # swings\n# through zero\n'
    assert sorted(phrase for _, phrase, _ in found_in(readable_of_source(source))) == [
        "hardly shows",
        "likeliest",
        "swings # through",
    ]
