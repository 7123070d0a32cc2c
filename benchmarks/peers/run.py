"""Entry of `make bench-peers`: hexservo and its peers, in the same run, on the same work, with the answers compared.

The method is in BENCHMARKS.md, section "Peers". A peer that is not installed is reported, and the run goes on.
Exit code 1 where a kernel program does not compile, a peer breaks or its answer is wrong, or where the ratio to NumPy
is below what is asserted.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path

import kernels
from hexservo.run.machine import describe_machine
from loops import batch_rows, numpy_row, single_rows
from parts import part_rows
from report import markdown, sentence, update_block, write_json
from rows import Row

ROOT = Path(__file__).resolve().parents[2]
NUMPY_RATIO = 100.0  # a single loop is at least this many times faster than NumPy's
QUICK_DURATION, QUICK_ROUNDS = 2.5, 7


def _measured(rows: Iterable[Row]) -> list[Row]:
    """Compute the rows one by one, and print each when it is done."""
    done = []
    for row in rows:
        print(sentence(row), flush=True)
        done.append(row)
    return done


def _built() -> list[str]:
    """Build the kernel programs; return what failed. A library that is not there is no failure."""
    try:
        kernels.build()
    except kernels.MissingError as error:
        print(f"Some kernel programs are missing: {error}", file=sys.stderr)
        return [f"kernel programs: {str(error).splitlines()[0]} (see the start of the output)"]
    return []


def _full(rounds: int) -> list[Row]:
    return _measured(single_rows(rounds)) + _measured(batch_rows(rounds)) + _measured(part_rows(rounds))


def main() -> int:
    """Measure, print, and write JSON and the block of a Markdown file."""
    parser = argparse.ArgumentParser(description="hexservo and its peers: same run, same work, answers compared")
    parser.add_argument("--quick", action="store_true", help=f"NumPy alone; fails below {NUMPY_RATIO:g} x")
    parser.add_argument("--rounds", type=int, default=9, help="timed rounds of each comparison (9)")
    parser.add_argument("--json", type=Path, default=ROOT / "out" / "bench-peers" / "peers.json")
    parser.add_argument("--markdown", type=Path, help="a file whose block between the peers markers is replaced")
    arguments = parser.parse_args()
    if arguments.rounds < 2:
        parser.error(f"--rounds: expected a whole number of at least 2, got {arguments.rounds}")

    machine = describe_machine()
    problems = [] if arguments.quick else _built()
    rows = _measured([numpy_row(QUICK_DURATION, QUICK_ROUNDS)]) if arguments.quick else _full(arguments.rounds)
    write_json(arguments.json, machine, rows)
    print(f"written: {arguments.json}")
    if arguments.markdown:
        update_block(arguments.markdown, markdown(machine, rows))
        print(f"written: the table of {arguments.markdown}")

    problems += [sentence(row) for row in rows if row.status in ("wrong answer", "failed")]
    comparison = rows[0].comparison  # NumPy is always there
    if comparison is None or comparison.ratio is None:
        problems.append(f"NumPy: expected a measurement, got: {sentence(rows[0])}")
    elif comparison.ratio < NUMPY_RATIO:
        problems.append(f"ratio to NumPy: expected at least {NUMPY_RATIO:g}, got {comparison.ratio:.1f}")
    for problem in problems:
        print(problem, file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
