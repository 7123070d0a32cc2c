"""Counts in the pages: each is that of what is counted, in the code or on another page."""

from __future__ import annotations

import re

import pytest

import hexservo as hs
from hexservo.findings.diagnosis.causes import CAUSES
from packages import PACKAGES
from test_docs import ROOT, prose_of, tables_in

WORDS = {"four": 4, "six": 6, "seven": 7, "eight": 8, "ten": 10, "eleven": 11, "eighteen": 18, "twenty-one": 21}
RULES = hs.load_scenario("paper").updated({"simulation.duration": 0.001})
WEIGHTS = hs.simulate(RULES).fuzzy_weights  # (6, 7, 7)
RANKING = "docs/diagnosis/ranking.md"


def text_of(page: str) -> str:
    return prose_of(ROOT / page)


def measured() -> dict[str, list[int | None]]:
    """Rows of the table of random failures on the page of the ranking, by cause; "all" has their sums."""
    (table,) = (rows for head, rows in tables_in(text_of(RANKING)) if head[:2] == ["cause", "drawn"])
    return {row[0]: [int(cell) if cell.isdigit() else None for cell in row[1:]] for row in table}


def errata() -> int:
    return len(re.findall(r"^## \d+\. ", text_of("docs/errata.md"), re.MULTILINE))


def kinds() -> int:
    return next(len(rows) for head, rows in tables_in(text_of("docs/proof.md")) if head[0] == "kind")


SUMS = measured()["all"]
FAILED, BY_CHANCE = SUMS[1] or 0, SUMS[6] or 0  # with every seed; with some
DECIDING = sum(1 for cause, row in measured().items() if cause != "all" and (row[1] or row[6]))
COUNTS = [
    ("README.md", r"out of (\d+) causes", len(CAUSES)),
    (RANKING, r"fixed list of (\d+),", len(CAUSES)),
    ("README.md", r"(\d+) random failures of \d+ causes", FAILED + BY_CHANCE),
    ("README.md", r"random failures of (\d+) causes", DECIDING),
    ("README.md", r"of the (\d+) that fail, and pass without the fault", FAILED),
    (RANKING, r"All failures together: \d+ of (\d+)", FAILED + BY_CHANCE),
    ("README.md", r"(\w+) adaptive fuzzy systems of", WEIGHTS.shape[0]),
    ("README.md", r"fuzzy systems of (\d+) rules each", WEIGHTS[0].size),
    ("docs/claims.md", r"on all (\d+) of them", WEIGHTS.size),
    ("docs/errata.md", r"(\d+) rules", WEIGHTS[0].size),
    ("docs/model.md", r"the ([\w-]+) numbers of a run", len(hs.METRICS)),
    ("docs/model.md", r"(\d+) weights", WEIGHTS.size),
    ("README.md", r"lists (\w+) errors and gaps", errata()),
    ("CHANGELOG.md", r"The Python package has (\w+) parts", len(PACKAGES)),
    ("docs/proof.md", r"There are (\w+) kinds", kinds()),
]


@pytest.mark.parametrize(
    ("page", "pattern", "count"), COUNTS, ids=[f"{page}: {pattern}" for page, pattern, _ in COUNTS]
)
def test_counts_of_the_pages(page: str, pattern: str, count: int) -> None:
    found = re.findall(pattern, re.sub(r"\s+", " ", text_of(page)))
    assert found, f"{page}: nothing like {pattern}"
    for number in found:
        assert (WORDS.get(number) or int(number)) == count, f"{page}: {number}"


def test_sums_of_the_random_failures() -> None:
    rows = measured()
    total = rows.pop("all")
    assert set(rows) <= {cause.key for cause in CAUSES}
    for column in (0, 1, 2, 3, 4, 6, 7, 8):
        assert sum(row[column] or 0 for row in rows.values()) == total[column]
