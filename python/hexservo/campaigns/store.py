"""The folder of a campaign: every chunk is there whole or not at all, whatever ends the process that writes."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexservo.campaigns.chunks import Tally, tally_of, unsealed_chunk
from hexservo.campaigns.differing import differences, of_both
from hexservo.campaigns.plan import CampaignPlan
from hexservo.campaigns.writing import (
    free_place,
    locked,
    make_folder,
    refusing,
    remove_drafts,
    require_empty,
    write_beside_kept,
    write_bytes,
)
from hexservo.run.files import output_path
from hexservo.run.publish import OutputError, named
from hexservo.run.sealed import ResultError
from hexservo.scenario.reading import EMPTY_PATH, path_text
from hexservo.scenario.rules import shown_value
from hexservo.scenario.version import VERSION
from hexservo.scenario.yaml import ScenarioError, dump_yaml, read_yaml

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["PLAN", "Store", "contents", "read_plan"]

FORMAT = 3
"""Of a campaign's folder: raised with every change of what a chunk holds."""

PLAN, SUMMARY, WORST = "campaign.yaml", "summary.json", "worst-run.yaml"
_SEAL = "sha256"  # key of the digest of what a file holds beside it
_CHUNK = re.compile(r"(?P<index>[0-9]{6}|[1-9][0-9]{6,})\.parquet")  # as `Store.path_of` names them
_MAY_CHANGE = (
    "runs",
    "until",
    "tune",
)  # in the same campaign: its interval holds at any stop, a search is no part of it


class ShorterChunkError(ResultError):
    """A chunk has fewer runs than it should: the last one of a campaign that has more runs now."""


class UnreadableError(ResultError):
    """A chunk is there and cannot be read: it may be whole."""


class Store:
    """A campaign's folder, of which this process is the only writer while `opened` lasts."""

    def __init__(self, folder: str | os.PathLike[str], plan: CampaignPlan, record: dict[str, Any]) -> None:
        self.folder = output_path("folder", folder)
        self.plan = plan
        self.record = record
        self.drawing = plan.drawing()
        self.base = plan.scenario.updated(self.drawing.base)  # what a batch varies

    # ---- Reading ----------------------------------------------------------------------------------------------------

    def path_of(self, index: int) -> Path:
        """Return the path of a chunk."""
        return self.folder / "chunks" / f"{index:06d}.parquet"

    def indices(self) -> list[int]:
        """Return the indices of the chunks that are there, in order, without those of more runs than the campaign has.

        Such are left where `until` alone ended a campaign that has fewer runs now.
        """
        try:
            names = os.listdir(self.folder / "chunks")  # noqa: PTH208 (names only)
        except FileNotFoundError:
            return []
        found = sorted(int(match["index"]) for name in names if (match := _CHUNK.fullmatch(name)))
        count = self.plan.chunk_count
        return found if count is None else [index for index in found if index < count]

    def identity(self, index: int) -> dict[str, Any]:
        """Return what identifies a chunk of this campaign."""
        first, last = self.plan.runs_of_chunk(index)
        return {"campaign": self.record["campaign"], "first": first, "last": last}

    def read(self, index: int) -> pa.Table:
        """Return a chunk.

        Raises
        ------
        ResultError
            It is damaged, or holds other runs than it should. A chunk of a different campaign is an `OutputError`.
        UnreadableError
            The system does not give its bytes.
        """
        path = self.path_of(index)
        try:
            table, found = unsealed_chunk(path.read_bytes())
        except ResultError as error:
            raise ResultError(
                f"{named(path)}: expected a chunk as hexservo wrote it, got a different file: {error}"
            ) from None
        except FileNotFoundError as error:
            raise ResultError(f"{named(path)}: cannot be read: {error.strerror}") from None
        except OSError as error:
            raise UnreadableError(
                f"{named(path)}: cannot be read: {error.strerror}; permit reading it, or move it away to have its runs "
                "computed again"
            ) from None
        expected = self.identity(index)
        if found.get("campaign") != expected["campaign"]:
            raise OutputError(
                f"{named(path)}: expected a chunk of this campaign, got one of a different campaign; move it away"
            )
        if found["first"] == expected["first"] and found["last"] > expected["last"]:
            raise OutputError(
                f"{named(self.folder)}: expected at least the {found['last']} runs that it has, got {self.plan.runs}; "
                "name a new folder"
            )
        if found != expected:
            kind = ShorterChunkError if found["first"] == expected["first"] else ResultError
            raise kind(
                f"{named(path)}: expected the runs {expected['first']} to {expected['last'] - 1}, "
                f"got {found['first']} to {found['last'] - 1}"
            )
        return table

    def tally(self, index: int, table: pa.Table) -> Tally:
        """Return the counts of a chunk."""
        return tally_of(table, range(*self.plan.runs_of_chunk(index)), self.plan.require, self.plan.scenario)

    # ---- Writing ----------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def opened(self) -> Iterator[None]:
        """Make the folder, or take it up again, as the only writer.

        Raises
        ------
        OutputError
            The folder holds something else, or a different campaign; a process writes there now; it cannot be written.
        """
        with locked(self.folder):
            with refusing(self.folder):
                self._begin()
            yield

    def _begin(self) -> None:
        plan = self.folder / PLAN
        if plan.exists():
            self._take_up()
        else:
            require_empty(self.folder, "a campaign")
        written = plan_text(self.plan, self.record)
        if not plan.exists() or plan.read_text(encoding="utf-8") != written:
            write_bytes(plan, written.encode())
        make_folder(self.folder / "chunks")
        for folder in (self.folder, self.folder / "chunks"):
            remove_drafts(folder)

    def _take_up(self) -> None:
        """Check that the folder's campaign is this one, and keep its record."""
        there, record = read_plan(self.folder)
        self.plan.changed(variant=record["variant"]).required_variant()
        differing = [] if record["hexservo"] == VERSION else [of_both("hexservo", record["hexservo"], VERSION)]
        differing += differences(self.plan, there, _MAY_CHANGE)
        if differing:
            raise OutputError(
                f"{named(self.folder)}: expected a folder of this campaign, got one that differs in "
                f"{', '.join(differing)}; name a new folder"
            )
        if self.plan.runs is not None and there.runs is not None and self.plan.runs < there.runs:
            raise OutputError(
                f"{named(self.folder)}: expected at least {there.runs} runs, got {self.plan.runs}; name a new folder"
            )
        if (self.plan.runs, self.plan.until) != (there.runs, there.until):
            self.record["fixed_runs"] = None  # their number was changed after a look at the results
        else:
            self.record["fixed_runs"] = record["fixed_runs"]

    def write_chunk(self, index: int, content: bytes) -> None:
        """Write a chunk.

        Raises
        ------
        OutputError
            It cannot be written; the other ones stay.
        """
        write_bytes(self.path_of(index), content)

    def require_own_folder(self) -> None:
        """Refuse a folder that another process opened for a different campaign, or that is not there.

        Raises
        ------
        OutputError
            It is not the campaign's.
        """
        try:
            found = read_plan(self.folder)[1]["campaign"]
        except ResultError:
            found = None
        if found != self.record["campaign"]:
            raise OutputError(
                f"{named(self.folder)}: expected a folder that every worker shares, got none of this campaign on "
                f"{socket.gethostname()}; leave out store_on_workers"
            )

    def set_aside(self, index: int) -> Path:
        """Move a damaged chunk to the folder ``damaged``, out of the way of readers, and return its path."""
        path = self.path_of(index)
        damaged = self.folder / "damaged"
        with refusing(damaged):
            damaged.mkdir(exist_ok=True)
            aside = free_place(damaged / path.name)
            path.rename(aside)
        return aside

    def remove(self, index: int) -> None:
        """Remove a chunk."""
        with refusing(self.path_of(index)):
            self.path_of(index).unlink(missing_ok=True)

    def write_summary(self, summary: dict[str, Any]) -> None:
        """Write ``summary.json``, with the SHA-256 of the rest."""
        sealed = {**summary, _SEAL: _digest(summary)}
        text = json.dumps(sealed, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
        write_bytes(self.folder / SUMMARY, text.encode())

    def read_summary(self) -> dict[str, Any] | None:
        """Return the summary of this campaign; None where there is none as hexservo wrote it."""
        try:
            summary = json.loads((self.folder / SUMMARY).read_text(encoding="utf-8"))
            is_whole = summary.pop(_SEAL) == _digest(summary)
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None
        return summary if is_whole and summary["campaign"] == self.record["campaign"] else None

    def write_worst(self, text: str) -> Path:
        """Write ``worst-run.yaml``, or ``worst-run-1.yaml`` beside one that a user changed, and return its path."""
        return write_beside_kept(self.folder / WORST, text)


def contents(folder: Path) -> list[str]:
    """Return the names of what a campaign's folder has, chunks as a pattern: before the first run not all is there."""
    return [name for name in (PLAN, SUMMARY, WORST, "chunks/*.parquet") if any(folder.glob(name))]


def new_record(plan: CampaignPlan) -> dict[str, Any]:
    """Return what a folder records of a campaign that begins now, beside its file."""
    variant = plan.required_variant()
    return {
        "format": FORMAT,
        "hexservo": VERSION,
        "variant": variant,
        "digest": plan.digest(),
        "campaign": _campaign_digest(plan, VERSION, variant),
        "fixed_runs": plan.runs if plan.until is None else None,
    }


def _campaign_digest(plan: CampaignPlan, version: Any, variant: Any) -> str:
    """Return the SHA-256 of all that determines the chunks of a campaign."""
    requirements = [requirement.to_plain() for requirement in plan.require]
    return _digest([plan.digest(), requirements, list(plan.kept_metrics()), FORMAT, version, variant])


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value).encode()).hexdigest()


def plan_text(plan: CampaignPlan, record: dict[str, Any]) -> str:
    """Return the text of ``campaign.yaml``, whose record has the SHA-256 of the rest."""
    return dump_yaml({**plan.to_mapping(), "record": {**record, _SEAL: _digest([plan.to_mapping(), record])}})


def read_plan(folder: str | os.PathLike[str]) -> tuple[CampaignPlan, dict[str, Any]]:
    """Return the campaign of a folder, and its record.

    Raises
    ------
    ResultError
        There is no campaign, one that was changed since, or one of a format that this version does not read.
    """
    place = path_text("folder", folder)
    if not place:
        raise ResultError(f"folder: {EMPTY_PATH}")
    path = Path(place) / PLAN
    if not path.is_file():
        raise ResultError(f"{named(path.parent)}: expected the folder of a campaign, got one without {PLAN}")
    try:
        document = read_yaml(path)
        record = document.get("record") if isinstance(document, dict) else None
        if not isinstance(record, dict) or record.get("format") != FORMAT:
            raise ResultError(other_format(path, "a campaign", FORMAT, record))
        plan = CampaignPlan(**document)  # type: ignore[arg-type]
    except ScenarioError as error:
        raise ResultError(
            f"{named(path)}: expected a campaign that this version reads, got: {error.problems[0]}"
        ) from None
    seal = record.pop(_SEAL, None)
    whole = seal in (None, _digest([plan.to_mapping(), record]))  # a folder of an earlier version has none
    if not whole or record.get("campaign") != _campaign_digest(plan, record.get("hexservo"), record.get("variant")):
        raise ResultError(
            f"{named(path)}: expected the file as hexservo wrote it, got one that was changed since, or that hexservo "
            f"{record.get('hexservo')} reads differently; undo the change, or run a changed copy in a new folder"
        )
    return plan, record


def other_format(path: Path, what: str, expected: int, record: Any) -> str:
    """Return the message for a file whose record has a different format than this version reads, or none."""
    found = record.get("format") if isinstance(record, dict) else None
    got = "a file that names no format" if found is None else f"one of format {shown_value(found)}"
    return f"{named(path)}: expected {what} of format {expected}, got {got}; run it again in a new folder"
