"""The kernel programs: built by CMake, one executable per library, driven by text (serve.hpp)."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from problem import Array
from timing import Block

FOLDER = Path(__file__).resolve().parent
BUILD = FOLDER.parents[1] / "build" / "peers"
PROGRAMS = ("hexservo_functions", "fuzzylite_system", "visp_law")


class MissingError(Exception):
    """A peer is not installed; the text has how to install it."""


def build() -> None:
    """Build every program whose library is there.

    Raises
    ------
    MissingError
        Where not all of them could be built, with the last lines of the output of CMake or the compiler.
    """
    if shutil.which("cmake") is None:
        raise MissingError("no cmake: make bench-peers installs it")
    for program in PROGRAMS:  # what cannot be built now must not run either
        (BUILD / program).unlink(missing_ok=True)
    generator, keep_going = ("Ninja", ["-k", "0"]) if shutil.which("ninja") else ("Unix Makefiles", ["-k"])
    for command in (
        # The libraries are looked for each time: they may have come or gone.
        ["cmake", "-S", str(FOLDER), "-B", str(BUILD), "-U", "*_LIBRARY", "-U", "*_INCLUDE_DIR", "-G", generator],
        ["cmake", "--build", str(BUILD), "--", *keep_going],
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            last = "\n".join((done.stdout + done.stderr).splitlines()[-15:])
            raise MissingError(f"{' '.join(command[:2])} failed:\n{last}")


class Kernel:
    """A running kernel program with its parameters and inputs."""

    def __init__(self, program: str, mode: str | None, parameters: Array, inputs: Array, how_to_get: str) -> None:
        path = BUILD / program
        if not path.exists():
            raise MissingError(f"{program} was not built: {how_to_get}")
        self._process = subprocess.Popen(
            [str(path), *([mode] if mode else [])], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._name = " ".join([program, *([mode] if mode else [])])
        self._rows = len(inputs)
        self._send(_text(parameters))
        self._send(f"inputs {self._rows} {_text(inputs)}")

    def close(self) -> None:
        """Let the program end."""
        self._process.communicate()

    @property
    def version(self) -> str:
        """Library and compiler."""
        return self._ask("version")

    def answers(self) -> Array:
        """Give one row of numbers per row of input."""
        self._send("answers")
        return np.array([[float(word) for word in self._line().split()] for _ in range(self._rows)])

    def block(self, minimum: float, units_per_row: int = 1) -> Callable[[], Block]:
        """Give a timed block of about `minimum` seconds; per unit."""
        per_row = float(self._ask("time 1")) * 1e-9
        rounds = max(1, round(minimum / (per_row * self._rows)))
        return lambda: Block(float(self._ask(f"time {rounds}")) * 1e-9 / units_per_row)

    def _send(self, text: str) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(text + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            raise RuntimeError(f"{self._name} ended with code {self._process.wait()}") from None

    def _line(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"{self._name} ended with code {self._process.wait()}")
        return line

    def _ask(self, command: str) -> str:
        self._send(command)
        return self._line().strip()


@contextmanager
def running(program: str, mode: str | None, parameters: Array, inputs: Array, how_to_get: str) -> Iterator[Kernel]:
    """Start a kernel program, and end it afterwards.

    Raises
    ------
    MissingError
        Where it was not built; see `how_to_get`.
    """
    kernel = Kernel(program, mode, parameters, inputs, how_to_get)
    try:
        yield kernel
    finally:
        kernel.close()


def _text(numbers: Array) -> str:
    return " ".join(repr(float(number)) for number in np.ravel(numbers))
