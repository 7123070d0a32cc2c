"""Runs campaigns: chunk by chunk, each computed from its index alone, kept as soon as it is whole."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from types import FrameType
from typing import Any, TypeAlias

from hexservo.campaigns.chunks import Tally
from hexservo.campaigns.engines import Chunk, Engine, engine_of
from hexservo.campaigns.intervals import runs_for_bound
from hexservo.campaigns.plan import CampaignPlan, load_plan
from hexservo.campaigns.result import CampaignResult, is_complete, scenario_of_run, summary_of, why_refused
from hexservo.campaigns.store import WORST, ShorterChunkError, Store, UnreadableError, new_record
from hexservo.run.progress import ProgressCallback, Report, reported
from hexservo.run.publish import OutputError, named
from hexservo.run.sealed import ResultError
from hexservo.scenario.wording import above, number, wrong_type
from hexservo.scenario.yaml import ScenarioError

_SUMMARISED = 5.0  # [s], between two summaries while a campaign runs
_WATCHED = 0.1  # [s], between two looks at what is computed

Warn: TypeAlias = Callable[[str], object]
"""Called with a sentence about something that needs no decision, such as a damaged chunk."""


def campaign(
    source: str | os.PathLike[str] | Mapping[str, Any] | CampaignPlan,
    out: str | os.PathLike[str],
    *,
    changes: Mapping[str, Any] | None = None,
    runs: int | None = None,
    chunk_size: int | None = None,
    threads: int | None = None,
    progress: bool | ProgressCallback | None = None,
    warn: Warn | None = None,
    engine: str = "local",
    store_on_workers: bool = False,
) -> CampaignResult:
    """Run a campaign, or go on with one (docs/campaigns.md).

    Chunks that the folder holds, whole and of this campaign, are kept; the others are computed. A run depends on the
    campaign and its index only, bit for bit: not on threads, chunks or interruptions.

    Parameters
    ----------
    source
        A packaged campaign, the path of a file, or what a file holds.
    out
        Folder: new, empty, or of the same campaign. That may have more runs, and a different `until`, `tune`, name or
        description of the scenario now.
    changes
        Of the scenario, as for `load_scenario`; of a `Scenario`, as for `Scenario.updated`.
    runs, chunk_size
        In place of those of the file.
    threads
        As for `simulate_batch`.
    progress
        True draws a bar on standard error; a function is called with (runs done, runs in all) in this thread.
    warn
        Called with a sentence for each damaged chunk, which is computed again, and for a changed ``worst-run.yaml``,
        which is kept (the worst run gets a file beside it); None: nothing is called.
    engine
        "local": this process. "dask": a local Dask cluster with one worker for each core; the calling script needs the
        guard ``if __name__ == "__main__"``. ``tcp://host:port``: an existing Dask scheduler. Dask is the extra
        ``hexservo[cluster]``.
    store_on_workers
        Every worker of a Dask cluster writes its chunks itself, into `out`, which has the same path on all machines.

    Returns
    -------
    CampaignResult
        Ctrl-C ends it within 0.3 s, as ``interrupted``: chunks that are whole stay, and the same call goes on.

    Raises
    ------
    TypeError
        For arguments of other types.
    ValueError
        For an engine that does not exist, or `store_on_workers` without a cluster.
    ScenarioError
        The campaign is not valid, or most of its draws are no valid scenarios; fewer are left out, and counted.
    OutputError
        The folder holds something else or a different campaign, is in use, or cannot be written (a `ValueError`); what
        is whole stays. Dask is not installed, or its scheduler does not answer or has ended.
    ResultError
        A chunk is there and cannot be read, as without permission.
    VariantError
        The folder's runs were computed by a compiled variant that this process, or a worker, does not use.
    """
    if warn is not None and not callable(warn):
        raise wrong_type("warn", "a function or None", warn)
    plan = load_plan(source, changes, runs=runs, chunk_size=chunk_size)
    store = Store(out, plan, new_record(plan))
    state = _State(store, warn or (lambda sentence: None))
    with (
        engine_of(engine, store, threads, store_on_workers=store_on_workers) as chosen,
        store.opened(),
        _reporting(progress) as report,
        _ctrl_c_noted() as asked,
    ):
        interrupted = False
        try:
            state.take_up(asked)
            _compute(state, chosen, report, asked)
        except KeyboardInterrupt:  # of a second Ctrl-C, or of a handler that is not Python's own
            interrupted = True
        return state.finish(interrupted=(interrupted or asked.is_set()) and not state.complete)


@contextlib.contextmanager
def _ctrl_c_noted() -> Iterator[threading.Event]:
    """Have Ctrl-C set an event, where it would raise an exception amid the counting; a second one does raise it."""
    asked = threading.Event()

    def note(signal_number: int, frame: FrameType | None) -> None:
        if asked.is_set():
            raise KeyboardInterrupt
        asked.set()

    ours = (
        threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    )
    if ours:
        signal.signal(signal.SIGINT, note)
    try:
        yield asked
    finally:
        if ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)


# ---- What is there --------------------------------------------------------------------------------------------------


class _State:
    """Chunks that are kept, and the counts of those from the first one on without a gap."""

    def __init__(self, store: Store, warn: Warn) -> None:
        self.store = store
        self.warn = warn
        self.plan = store.plan
        self.tally = Tally([0] * len(self.plan.require))
        self.counted = 0  # chunks in the tally
        self.waiting: dict[int, Tally] = {}  # counts of later ones
        self.complete = False
        self.fresh: set[int] = set()  # chunks that were computed by this call
        self._summarised = time.monotonic()

    @property
    def kept(self) -> int:
        """Runs that are kept, with the draws that are none."""
        return self.tally.drawn + sum(tally.drawn for tally in self.waiting.values())

    def take_up(self, asked: threading.Event) -> None:
        """Count the chunks that are there; damaged ones are set aside."""
        for index in self.store.indices():
            if self.complete or asked.is_set():
                break
            try:
                table = self.store.read(index)
            except ShorterChunkError:  # the last one of fewer runs
                continue
            except UnreadableError:
                raise
            except ResultError as error:
                aside = self.store.set_aside(index)
                self.warn(f"{error}; it is now {named(aside)}, and its runs are computed again")
                continue
            self.enter(index, self.store.tally(index, table))

    def enter(self, index: int, tally: Tally) -> None:
        """Count a chunk that is kept; the interval decides on chunks in their order alone."""
        self.waiting[index] = tally
        while not self.complete and self.counted in self.waiting:
            self.tally.add(self.waiting.pop(self.counted))
            self.counted += 1
            self._require_valid_draws()
            self.complete = is_complete(self.plan, self.tally)

    def _require_valid_draws(self) -> None:
        """Refuse distributions of which most draws are no valid scenario."""
        if self.tally.mostly_refused is not None:
            refused, drawn = self.tally.mostly_refused
            first = why_refused(self.plan, self.tally)
            raise ScenarioError(
                [
                    f"vary: expected distributions of which most draws are valid scenarios, got {refused} of the first "
                    f"{drawn} that are none; the first of these: {first}"
                ]
            )

    def missing(self) -> Iterator[int]:
        """Yield the indices of the chunks that are to be computed, in order."""
        present = set(self.waiting)
        for index in itertools.count(self.counted):
            if self.plan.chunk_count is not None and index >= self.plan.chunk_count:
                return
            if index not in present:
                yield index

    def summarise(self, *, now: bool = False) -> None:
        """Write the summary, from time to time while chunks are computed."""
        if now or time.monotonic() > self._summarised + _SUMMARISED:
            self._summarised = time.monotonic()
            self.store.write_summary(summary_of(self.plan, self.store.record, self.tally))

    def finish(self, *, interrupted: bool) -> CampaignResult:
        """Write summary and worst run, remove chunks after the one that decided, and return what is there."""
        if self.complete:  # what came too early of this call alone: earlier runs stay, for a different goal
            for index in sorted(self.fresh):
                if index >= self.counted:
                    self.store.remove(index)
        self.summarise(now=True)
        written = None
        if self.tally.worst:
            worst = scenario_of_run(self.plan, self.tally.worst[0][-1])
            written = self.store.write_worst(worst.to_yaml())
            if written.name != WORST:
                self.warn(
                    f"{named(self.store.folder / WORST)}: expected a file as hexservo wrote it, got a different one, "
                    f"which is kept; the worst run is in {named(written)}"
                )
        summary = summary_of(self.plan, self.store.record, self.tally)
        return CampaignResult(self.store.folder, self.plan, summary, interrupted, written)


# ---- What is computed -----------------------------------------------------------------------------------------------


def _compute(state: _State, engine: Engine, report: _Report, asked: threading.Event) -> None:
    """Have computed what is missing, and keep it as it comes."""
    missing = state.missing()
    flying: dict[Future[Chunk], int] = {}
    try:
        while not state.complete and not asked.is_set():
            for index in itertools.islice(missing, max(engine.in_flight - len(flying), 0)):
                flying[engine.submit(index)] = index
            for future in wait(flying, _WATCHED, FIRST_COMPLETED).done:
                index = flying.pop(future)
                content, tally = _result_of(future)
                if content is not None:
                    state.store.write_chunk(index, content)
                elif not state.store.path_of(index).exists():
                    raise OutputError(
                        f"{named(state.store.path_of(index))}: expected a folder that every worker shares, got one "
                        "without the chunk that a worker wrote; leave out store_on_workers"
                    )
                state.fresh.add(index)
                state.enter(index, tally)
                state.summarise()
            report(state, engine.done)
    finally:
        for future in flying:
            future.cancel()


def _result_of(future: Future[Chunk]) -> Chunk:
    try:
        return future.result()
    except (CancelledError, OSError) as error:  # a cluster whose scheduler ended
        raise OutputError(
            f"engine: expected a scheduler that runs, got: {type(error).__name__}; what is whole stays; the same "
            "command goes on"
        ) from error


# ---- Progress -------------------------------------------------------------------------------------------------------


_Report: TypeAlias = Callable[[_State, int], object]  # of what is kept, and how many runs of this chunk are done


@contextlib.contextmanager
def _reporting(progress: bool | ProgressCallback | None) -> Iterator[_Report]:
    begun: list[tuple[float, int]] = []

    def to_function(function: ProgressCallback) -> _Report:
        return lambda state, done: function(state.kept + done, _planned(state) or state.kept + done)

    def to_bar(draw: Report) -> _Report:
        def report(state: _State, done: int) -> None:
            now, runs = time.monotonic(), state.kept + done
            begun[:] = begun or [(now, runs)]
            elapsed = now - begun[0][0]
            rate = f"{number((runs - begun[0][1]) / elapsed)} runs/s, " if elapsed > 0 else ""
            failures = state.tally.failures
            high = state.plan.interval(failures, state.tally.runs)[1]
            needed = _planned(state)
            planned = max(needed or 0, runs)
            share = None if needed is None else runs / planned
            draw(runs, planned, share, f"{rate}{failures} failures, probability <= {above(high, 2)}")

        return report

    with reported(progress, "runs", to_function, to_bar) as report:
        yield (lambda state, done: None) if report is None else report


def _planned(state: _State) -> int | None:
    """Return the runs in all, None if unknown; for a probability, as many as it needs without another failure."""
    plan, until = state.plan, state.plan.until
    if until is None or until.kind != "probability_below":
        return plan.runs
    needed = runs_for_bound(until.value, state.tally.failures, plan.confidence, plan.mixture)
    needed += state.tally.refused
    needed = -(-needed // plan.chunk_size) * plan.chunk_size
    return needed if plan.runs is None else min(needed, plan.runs)
