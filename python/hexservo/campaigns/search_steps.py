"""The folder of a search for gains: what is simulated is kept step by step, and a search goes on by repeating it."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexservo.campaigns.differing import differences, of_both
from hexservo.campaigns.plan import CampaignPlan
from hexservo.campaigns.store import other_format
from hexservo.campaigns.writing import locked, make_folder, remove_drafts, require_empty, write_bytes, write_text
from hexservo.run.files import output_path
from hexservo.run.publish import OutputError, named
from hexservo.scenario.version import VERSION
from hexservo.scenario.yaml import ScenarioError, dump_yaml, read_yaml

FORMAT = 7
"""Of a search's folder: raised with every change of the order in which a search simulates, or of what a step keeps."""

PLAN = "tune.yaml"
_SEARCH = "search"  # key of the record: the SHA-256 of all that determines the steps
_FREE = ("runs", "until", "chunk_size", "confidence", "rare", "metrics", "variant")  # keys that may change
_DIGEST = 32  # bytes of SHA-256: of the rest of a file, then of the inputs


class SearchSteps:
    """The steps of a search, each a batch with its results, kept in the order in which they are asked for.

    A search is a function of its file and its seed. Asked for the same steps again, it takes those that are kept, whole
    and of the same inputs, and simulates the others: so it goes on where it was interrupted, bit for bit.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        plan: CampaignPlan,
        seed: int,
        generations: int,
        warn: Callable[[str], object],
    ) -> None:
        self.folder = output_path("folder", folder)
        self.plan = plan
        self.warn = warn
        self.count = 0  # steps that were asked for
        self.record: dict[str, Any] = {
            "format": FORMAT,
            "hexservo": VERSION,
            "variant": plan.required_variant(),
            "seed": seed,
            "generations": generations,
        }
        self.record[_SEARCH] = _digest_of(plan, self.record)

    @contextlib.contextmanager
    def opened(self) -> Iterator[None]:
        """Make the folder, or take it up again, as the only writer.

        Raises
        ------
        OutputError
            The folder holds something else, or a different search; a process writes there now; it cannot be written.
        """
        path = self.folder / PLAN
        with locked(self.folder):
            if path.exists():
                self._take_up(path)
            else:
                require_empty(self.folder, "a search")
            write_text(path, dump_yaml({**self.plan.to_mapping(), "record": self.record}))
            make_folder(self.folder / "steps")
            for folder in (self.folder, self.folder / "steps"):
                remove_drafts(folder)
            yield

    def _take_up(self, path: Path) -> None:
        """Check that the folder's search is this one."""
        try:
            document = read_yaml(path)
            record = document.get("record") if isinstance(document, dict) else None
            if not isinstance(record, dict) or record.get("format") != FORMAT:
                raise OutputError(other_format(path, "a search", FORMAT, record))
            there = CampaignPlan(**document)  # type: ignore[arg-type]
        except ScenarioError as error:
            raise OutputError(
                f"{named(path)}: expected the file of a search, got a different one: {error.problems[0]}; name a new "
                "folder"
            ) from None
        of_record = {key: record.get(key) for key in self.record if key != _SEARCH}
        if record.get(_SEARCH) != _digest_of(there, of_record) and of_record["hexservo"] == VERSION:
            raise OutputError(
                f"{named(path)}: expected the file as hexservo wrote it, got one that was changed since; undo the "
                "change, or search with a changed campaign file in a new folder"
            )
        if record.get(_SEARCH) == self.record[_SEARCH]:
            return
        differing = [
            of_both(key, value, self.record[key]) for key, value in of_record.items() if value != self.record[key]
        ]
        differing += differences(self.plan, there, _FREE)
        raise OutputError(
            f"{named(self.folder)}: expected a folder of this search, got one that differs in "
            f"{', '.join(differing) or 'the keys that scenarios had then'}; name a new folder"
        )

    def take(
        self, inputs: Mapping[str, NDArray[Any]], compute: Callable[[], Mapping[str, NDArray[Any]]]
    ) -> dict[str, NDArray[Any]]:
        """Return the results of the next step: those that are kept, or else computed and kept.

        Parameters
        ----------
        inputs
            All that the results depend on.
        compute
            Gives the results.

        Raises
        ------
        OutputError
            They cannot be written, or those that are kept not be read.
        """
        path = self.folder / "steps" / f"{self.count:06d}.step"
        self.count += 1
        digest = hashlib.sha256(f"{self.record['search']} {self.count}".encode())
        _enter(digest, inputs)
        place = digest.digest()
        if (kept := _read(path)) is not None:
            try:
                there, results = _unsealed(kept)
                if there == place:
                    return results
            except ValueError:  # else a step of a search of fewer rounds
                self.warn(
                    f"{named(path)}: expected the results of this step, got different bytes; they are computed again"
                )
        results = dict(compute())
        file = io.BytesIO()
        np.savez(file, **results)  # type: ignore[arg-type]
        content = file.getvalue()
        write_bytes(path, hashlib.sha256(place + content).digest() + place + content)
        return results


def _digest_of(plan: CampaignPlan, record: Mapping[str, Any]) -> str:
    """Return the SHA-256 of all that determines the steps of a search."""
    requirements = [requirement.to_plain() for requirement in plan.require]
    tune = None if plan.tune is None else plan.tune.to_plain()
    return hashlib.sha256(json.dumps([plan.digest(), requirements, tune, record]).encode()).hexdigest()


def _read(path: Path) -> bytes | None:
    """Return the bytes of a step; None where it is not kept."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise OutputError(
            f"{named(path)}: cannot be read: {error.strerror}; permit reading it, or move it away to have it simulated "
            "again"
        ) from None


def _enter(digest: Any, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Have arrays count in a digest, with names, types and shapes."""
    for name, values in sorted(arrays.items()):
        digest.update(f"{name} {values.dtype.str} {values.shape}".encode())
        digest.update(np.ascontiguousarray(values).tobytes())


def _unsealed(file: bytes) -> tuple[bytes, dict[str, NDArray[Any]]]:
    """Return the digest of a step's inputs, and its results.

    Raises
    ------
    ValueError
        The file is damaged.
    """
    seal, sealed = file[:_DIGEST], file[_DIGEST:]
    if seal != hashlib.sha256(sealed).digest():
        raise ValueError("the seal differs")
    with np.load(io.BytesIO(sealed[_DIGEST:]), allow_pickle=False) as arrays:
        return sealed[:_DIGEST], {name: arrays[name] for name in arrays.files}
