"""Chunks of a campaign: Parquet files that carry the SHA-256 of their bytes."""

from __future__ import annotations

import hashlib
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hexservo.campaigns.refused import FEW_DRAWS, MOST_REFUSED
from hexservo.campaigns.requirements import COMPLETED, Requirement, ranks_of, run_margins
from hexservo.run.batch import BatchResult
from hexservo.run.metrics import stayed_within
from hexservo.run.sealed import ResultError
from hexservo.run.variations import columns_of
from hexservo.scenario.arrays import Array
from hexservo.scenario.scenario import Scenario

if TYPE_CHECKING:
    import pyarrow as pa

_IDENTITY, _SEAL = b"hexservo_chunk", b"hexservo_sha256"
_BLANK = b"0" * 64  # in place of the digest, while it is computed
_SEALED = re.compile(re.escape(_SEAL) + rb".{1,4}?(?P<digest>[0-9a-f]{64})", re.DOTALL)
_FOOTER = 1 << 20  # longer than the end of a file, which holds the seal
_WORST = 10  # runs of the smallest margins that a tally keeps
_NO_SPAN = (np.inf, -np.inf)  # smallest and largest value of no runs
_LARGEST = 1e100  # size of a value in a span: JSON has no infinity


# ---- Runs as a table ------------------------------------------------------------------------------------------------


def chunk_table(
    batch: BatchResult | None,
    numbers: Mapping[str, NDArray[Any]],
    indices: NDArray[np.int64],
    requirements: Sequence[Requirement],
    metrics: Sequence[str],
) -> pa.Table:
    """Return the runs of a batch as a table, with what was drawn for them, their indices, and these metrics.

    None is a batch without runs: a table without rows.

    Columns: ``index``; what varies, by dotted key, entries of arrays as ``controller.hybrid.kv[0]``; ``outcome``,
    ``end_time`` [s], every metric in its unit (`hs.METRICS`), and ``margin``, the smallest one of the requirements.
    """
    import pyarrow as pa

    none = np.empty(0)
    varied = {name: column for key, values in numbers.items() for name, column in columns_of(key, values).items()}
    return pa.table(
        {
            "index": indices,
            **varied,
            "outcome": pa.array([] if batch is None else batch.outcome.tolist(), pa.string()),
            "end_time": none if batch is None else batch.end_time,
            **(dict.fromkeys(metrics, none) if batch is None else batch.metrics),
            "margin": none if batch is None else batch_margins(batch, numbers, requirements).min(axis=1),
        }
    )


def batch_margins(
    batch: BatchResult, numbers: Mapping[str, NDArray[Any]], requirements: Sequence[Requirement]
) -> Array:
    """Return the margin of every run of a batch for every requirement, (n, r); `numbers` is what was drawn for it."""
    duration = numbers.get("simulation.duration", batch.scenario.simulation.duration)
    return run_margins(requirements, batch.outcome, batch.end_time, duration, batch.metrics)


@dataclass
class Tally:
    """Counts of runs, which add up chunk by chunk."""

    failed: list[int]  # by requirement
    runs: int = 0
    failures: int = 0  # runs that fail at least one requirement
    unmoved: int = 0  # completed runs that are settled from their start on
    valueless: Counter[str] = field(default_factory=Counter)  # completed runs, by required metric that has no value
    outcomes: Counter[str] = field(default_factory=Counter)
    worst: list[tuple[float, float, int]] = field(default_factory=list)  # `ranks_of` and index, the worst first
    spans: list[tuple[float, float]] = field(default_factory=list)  # by requirement: `_span_of` its metric
    refused: int = 0  # draws that are no valid scenario, and no runs
    first_refused: int | None = None  # index of the first of these
    refused_at: list[int] = field(default_factory=list)  # indices of a chunk; `add` keeps none, of millions of draws
    mostly_refused: tuple[int, int] | None = None  # how many of how many first draws, where that first is most of them

    def __post_init__(self) -> None:
        """Begin with the spans of no runs."""
        self.spans = self.spans or [_NO_SPAN] * len(self.failed)

    @property
    def drawn(self) -> int:
        """Number of draws: runs, and what is no valid scenario."""
        return self.runs + self.refused

    def add(self, other: Tally) -> None:
        """Add the counts of the runs that follow."""
        self.mostly_refused = self.mostly_refused or _mostly(self.refused, other.refused_at)
        self.failed = [one + more for one, more in zip(self.failed, other.failed, strict=True)]
        self.runs += other.runs
        self.failures += other.failures
        self.refused += other.refused
        self.first_refused = min(
            [one for one in (self.first_refused, other.first_refused) if one is not None], default=None
        )
        self.unmoved += other.unmoved
        self.valueless.update(other.valueless)
        self.outcomes.update(other.outcomes)
        self.worst = sorted(self.worst + other.worst)[:_WORST]
        pairs = zip(self.spans, other.spans, strict=True)
        self.spans = [(min(one[0], more[0]), max(one[1], more[1])) for one, more in pairs]


def _mostly(before: int, refused_at: Sequence[int]) -> tuple[int, int] | None:
    """Return how many draws are refused of how many, where these first are most of at least `FEW_DRAWS`; None: nowhere.

    It looks at each draw by its index, so that the answer is that of any division into chunks.

    Parameters
    ----------
    before
        Draws of earlier chunks that are refused.
    refused_at
        Indices of those of this chunk.
    """
    for refused, index in enumerate(refused_at, before + 1):
        drawn = max(index + 1, FEW_DRAWS)
        if refused > MOST_REFUSED * drawn:
            return refused, drawn
    return None


def tally_of(table: pa.Table, drawn: range, requirements: Sequence[Requirement], scenario: Scenario) -> Tally:
    """Count the runs of a chunk.

    Parameters
    ----------
    table
        Of the runs.
    drawn
        Indices of all that were drawn: those that the table lacks are no valid scenarios.
    requirements
        That they are to keep.
    scenario
        Its duration and its band, where they do not vary.
    """
    columns = {name: _column(table, name) for name in ("index", "end_time")}
    outcome = np.array(table.column("outcome").to_pylist(), dtype=np.str_)
    metrics = {one.name: _column(table, one.name) for one in requirements if one.name != "outcome"}
    times = _column_or(table, "simulation.duration", scenario.simulation.duration)
    margins = run_margins(requirements, outcome, columns["end_time"], times, metrics)
    failed = margins < 0
    completed = outcome == COMPLETED
    valueless = {name: int((np.isnan(values) & completed).sum()) for name, values in metrics.items()}
    unmoved = stayed_within(
        _column_or(table, "settling_time", np.nan),
        _column_or(table, "peak_error", np.nan),
        _column_or(table, "metrics.band", scenario.metrics.band),
    )
    ranks = ranks_of(margins)
    refused = np.setdiff1d(np.arange(drawn.start, drawn.stop), columns["index"])
    worst = np.lexsort((ranks[:, 1], ranks[:, 0]))[:_WORST]
    return Tally(
        failed=[int(count) for count in failed.sum(axis=0)],
        runs=len(outcome),
        failures=int(failed.any(axis=1).sum()),
        unmoved=int((completed & unmoved).sum()),
        refused=len(refused),
        first_refused=int(refused[0]) if len(refused) else None,
        refused_at=refused.tolist(),
        valueless=Counter(valueless),
        outcomes=Counter(outcome.tolist()),
        worst=[(float(ranks[place, 0]), float(ranks[place, 1]), int(columns["index"][place])) for place in worst],
        spans=[_NO_SPAN if one.name == "outcome" else _span_of(metrics[one.name][completed]) for one in requirements],
    )


def _span_of(values: Array) -> tuple[float, float]:
    """Return the smallest and the largest value of a metric in runs that completed, (n,), without those of none."""
    found = np.clip(values[~np.isnan(values)], -_LARGEST, _LARGEST)
    return (float(found.min()), float(found.max())) if len(found) else _NO_SPAN


def _column_or(table: pa.Table, name: str, otherwise: float) -> Array | NDArray[Any]:
    return _column(table, name) if name in table.column_names else np.full(len(table), otherwise)


def _column(table: pa.Table, name: str) -> Array | NDArray[Any]:
    values: NDArray[Any] = table.column(name).to_numpy()
    return values


# ---- Tables as bytes ------------------------------------------------------------------------------------------------


def chunk_bytes(table: pa.Table, identity: Mapping[str, Any]) -> bytes:
    """Return a table as a Parquet file, the same bytes for the same table and version of pyarrow.

    Its metadata have the identity, and the SHA-256 of all bytes, computed with zeros in place of its digits.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    file = pa.BufferOutputStream()
    with pq.ParquetWriter(file, table.schema, use_dictionary=["outcome"], store_schema=False) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata({_IDENTITY: json.dumps(identity), _SEAL: _BLANK})
    content: bytes = file.getvalue().to_pybytes()
    start, end = _seal(content)
    return content[:start] + hashlib.sha256(content).hexdigest().encode() + content[end:]


def unsealed_chunk(content: bytes) -> tuple[pa.Table, dict[str, Any]]:
    """Return the table of a chunk's bytes, and its identity.

    Raises
    ------
    ResultError
        The bytes are not those that `chunk_bytes` gave; the text has the difference, without a place.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    start, end = _seal(content)
    blank = hashlib.sha256(content[:start])
    blank.update(_BLANK)
    blank.update(memoryview(content)[end:])
    if blank.hexdigest().encode() != content[start:end]:
        raise ResultError("the SHA-256 of its bytes differs from the recorded one")
    # In this thread alone: a thread of pyarrow's that still held a Python object at exit would end the process.
    file = pq.ParquetFile(pa.BufferReader(content), pre_buffer=False)
    return file.read(use_threads=False), dict(json.loads(file.metadata.metadata[_IDENTITY]))


def _seal(content: bytes) -> tuple[int, int]:
    """Return where the digits of the digest are."""
    begin = max(len(content) - _FOOTER, 0)
    found = list(_SEALED.finditer(content, begin))
    if not found or not content.startswith(b"PAR1") or not content.endswith(b"PAR1"):
        raise ResultError("it is cut off, or no Parquet file of hexservo")
    return found[-1].span("digest")
