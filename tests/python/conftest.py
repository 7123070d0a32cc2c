"""What the tests share: reproducible property-based tests, and the scenario they all start from."""

from __future__ import annotations

import functools
import gc
import os
import signal
from collections import Counter

import pytest
import typer.testing
from hypothesis import settings

import hexservo as hs

# Matrices here are small: threads of NumPy's BLAS wait for each other at twice the processor time, on cores that other
# workers use. Before NumPy is imported; for the subprocesses too.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A run in the background (nohup, `&` in a script) ignores Ctrl-C, and so would every test of it and its subprocesses.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Tests end processes, not machines: what was written outlives a process without it. Searches for gains waited for disks
# in a twelfth of their time.
os.fsync = lambda descriptor: None  # type: ignore[assignment]

# Collecting makes millions of objects that stay: the garbage collector took an eighth of the time to go through them.
gc.disable()
gc.set_threshold(10_000)

# CliRunner makes all commands at every call, which takes longer than most of them.
typer.testing._get_command = functools.cache(typer.testing._get_command)  # type: ignore[attr-defined]

# The same examples in every run; a failure prints the line that repeats it. No time limits: machines differ.
settings.register_profile("hexservo", derandomize=True, print_blob=True, deadline=None)
settings.load_profile("hexservo")


# Files of few tests that take long.
LONG = {"test_campaign_cluster", "test_identified_motors", "test_recipes", "test_resting_legs"}


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put long files first, then those of most tests: no worker is alone with a long one at the end.

    As `make test` runs them, file by file in the order given.
    """
    counts = Counter(item.path for item in items)
    items.sort(key=lambda item: (item.path.stem not in LONG, -counts[item.path], item.path))


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session")
def paper() -> hs.Scenario:
    return hs.load_scenario("paper")
