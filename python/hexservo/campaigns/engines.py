"""Where the chunks of a campaign are computed: in this process, or on the workers of a Dask cluster."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from functools import lru_cache
from types import FrameType
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from hexservo.campaigns.chunks import Tally, chunk_bytes, chunk_table
from hexservo.campaigns.plan import CampaignPlan
from hexservo.campaigns.refused import refused_scenario, valid_rows
from hexservo.campaigns.store import Store, new_record
from hexservo.run.batch import simulate_batch, thread_count
from hexservo.run.publish import OutputError
from hexservo.run.variant import VariantError
from hexservo.scenario.wording import wrong_type

if TYPE_CHECKING:
    from distributed import Client

ENGINES = "local, dask, or the address of a Dask scheduler as tcp://host:port"
Chunk: TypeAlias = tuple[bytes | None, Tally]
"""A chunk's file, None where it is written already, and its counts."""

_IN_FLIGHT = 2  # chunks that are computed here or wait to be kept
_IN_FLIGHT_OF_WORKER = 4
_FOUND_WITHIN = 10.0  # [s], a scheduler at an address


class StoppedError(Exception):
    """The campaign ended while a chunk was computed."""


class Engine:
    """Computes chunks in this process, one at a time on all threads, while the one before is kept."""

    def __init__(self, store: Store, threads: int | None, executor: Executor) -> None:
        self.store = store
        self.threads = threads
        self.executor = executor
        self.done = 0  # runs of the chunk that is being computed
        self.stop = threading.Event()

    @property
    def in_flight(self) -> int:
        """Chunks to submit before one is kept."""
        return _IN_FLIGHT

    def submit(self, index: int) -> Future[Chunk]:
        """Have a chunk computed."""
        return self.executor.submit(self._compute, index)

    def _compute(self, index: int) -> Chunk:
        def look(done: int, count: int) -> None:
            self.done = done
            if self.stop.is_set():
                raise StoppedError

        look(0, 0)
        chunk = compute_chunk(self.store, index, self.threads, look)
        self.done = 0
        return chunk


class DaskEngine(Engine):
    """Computes chunks on the workers of a Dask cluster, each on as many threads as the worker has.

    With a folder that all of them share, each writes its own chunks there.
    """

    def __init__(self, store: Store, threads: int | None, client: Client, *, store_on_workers: bool) -> None:
        super().__init__(store, threads, client.get_executor(pure=False))
        self.client = client
        self._shared = os.fspath(store.folder.resolve()) if store_on_workers else None
        self._plan = json.dumps(store.plan.to_mapping(), allow_nan=False)

    @property
    def in_flight(self) -> int:
        """Chunks to submit before one is kept: some for each worker, of which there may be more or fewer later."""
        return _IN_FLIGHT_OF_WORKER * max(len(self.client.scheduler_info(n_workers=-1)["workers"]), 1)

    def submit(self, index: int) -> Future[Chunk]:
        """Have a chunk computed."""
        future: Future[Chunk] = self.executor.submit(
            compute_remotely,
            self._plan,
            self.store.record["campaign"],
            self.store.record["variant"],
            index,
            self.threads,
            self._shared,
        )
        return future


def compute_chunk(
    store: Store, index: int, threads: int | None, look: Callable[[int, int], None] | None = None
) -> Chunk:
    """Compute a chunk from its index: its file and its counts.

    Draws that are no valid scenario are left out of both.
    """
    plan = store.plan
    first, last = plan.runs_of_chunk(index)
    numbers, metrics = store.drawing.numbers(first, last), plan.kept_metrics()
    indices = np.arange(first, last, dtype=np.int64)
    batch = None
    while batch is None and len(indices):
        varied = store.drawing.variations(numbers)
        try:
            batch = simulate_batch(store.base, varied, "metrics", threads, look, metrics=metrics)
        except ValueError as error:
            if refused_scenario(error) is None:
                raise
            kept = valid_rows(store.base, varied, len(indices), look=look)  # without the one that the error names
            numbers, indices = {key: values[kept] for key, values in numbers.items()}, indices[kept]
    table = chunk_table(batch, numbers, indices, plan.require, metrics)
    return chunk_bytes(table, store.identity(index)), store.tally(index, table)


def compute_remotely(
    plan: str, campaign: str, variant: str, index: int, threads: int | None, shared: str | None
) -> Chunk:
    """Compute a chunk on a worker, and write it into the campaign's folder if that is shared.

    Raises
    ------
    VariantError
        The worker uses a different compiled variant, or a different version of hexservo.
    OutputError
        The shared folder is not that of the campaign, or cannot be written.
    """
    store = _store_of(plan, campaign, variant, shared or os.curdir)  # where nothing is shared, of no folder's use
    if shared is not None:
        store.require_own_folder()
    content, tally = compute_chunk(store, index, threads or _threads_of_worker())
    if shared is None or content is None:
        return content, tally
    store.write_chunk(index, content)
    return None, tally


@lru_cache(maxsize=2)
def _store_of(text: str, campaign: str, variant: str, folder: str) -> Store:
    plan = CampaignPlan(**json.loads(text))
    plan.changed(variant=variant).required_variant()
    record = new_record(plan)
    if record["campaign"] != campaign:
        raise VariantError(
            f"worker: expected the version of hexservo that began the campaign, got {record['hexservo']}; "
            "install the same one there"
        )
    return Store(folder, plan, record)


def _threads_of_worker() -> int:
    from distributed import get_worker

    return int(get_worker().state.nthreads)


@contextlib.contextmanager
def engine_of(name: str, store: Store, threads: int | None, *, store_on_workers: bool = False) -> Iterator[Engine]:
    """Start an engine, and end what it computes.

    Raises
    ------
    TypeError
        For anything but a name.
    ValueError
        There is no such engine, or it has no workers that could write.
    OutputError
        Dask is not installed, or no scheduler answers at the address.
    """
    thread_count(threads)
    if not isinstance(name, str):
        raise wrong_type("engine", f"one of {ENGINES}", name)
    if name == "local" and store_on_workers:
        raise ValueError("store_on_workers: expected the engine dask or tcp://host:port, got local")
    if name == "local":
        with ThreadPoolExecutor(1, "campaign") as executor:
            engine = Engine(store, threads, executor)
            try:
                yield engine
            finally:
                engine.stop.set()
                with _ctrl_c_afterwards():
                    executor.shutdown(wait=True, cancel_futures=True)
        return
    if name != "dask" and "://" not in name:
        raise ValueError(f"engine: expected {ENGINES}; got {name!r}")
    with _client(name) as client:
        yield DaskEngine(store, threads, client, store_on_workers=store_on_workers)


@contextlib.contextmanager
def _ctrl_c_afterwards() -> Iterator[None]:
    """Have Ctrl-C count at the end of a short wait for a thread.

    Python takes a thread for ended where Ctrl-C interrupts the wait for it, and an interpreter that ends while the
    thread still computes ends with an abort.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    pressed: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda *given: pressed.append(given))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if pressed:
        before(*pressed[0])


@contextlib.contextmanager
def _client(name: str) -> Iterator[Any]:
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise OutputError('engine: expected an installation with Dask: pip install "hexservo[cluster]"') from None
    with contextlib.ExitStack() as held:
        if name == "dask":
            cluster = held.enter_context(
                LocalCluster(n_workers=thread_count(None), threads_per_worker=1, dashboard_address=None)
            )
            name = cluster.scheduler_address
        try:
            client = held.enter_context(Client(name, timeout=_FOUND_WITHIN, set_as_default=False))
        except (OSError, ValueError) as error:
            raise OutputError(f"engine: expected a Dask scheduler at {name}, got: {error}; start one") from None
        yield client
