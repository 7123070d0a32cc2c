"""What a Runge-Kutta step of the closed loop costs, by part: instructions of each kind, loads, stores, misses and time.

`make bench-step` runs it. It compiles the kernel of AVX2, the widest that valgrind emulates, as the package does but
with line tables, and runs `paper` there, alone and in a pack. Callgrind counts what is executed, with a model of the
processor's first-level cache; perf, where it is there, samples where the time goes. An instruction belongs to the
innermost of the functions inlined around it that is of a part.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from tables import ROOT, replace_block, table

import hexservo as hs
from hexservo import _core
from hexservo.run.machine import describe_machine
from hexservo.scenario.parameters import core_parameters

VARIANT = "avx2"
COUNTED_STEPS = 400  # what begins and ends a run is less than 1 % of them
TIMED_SECONDS = 4.0

# part -> pattern of a function, with all that is inlined into it
FUNCTIONS = {"weights, end of a step": r"\badvance_(rows|weights|systems)\b"}
# part -> pattern of a file, of the innermost function that is of a part
FILES = {
    "fuzzy systems": r"/fuzzy\.hpp$",
    "camera": r"/(camera|mount|lens)\.hpp$",
    "legs": r"/(hexapod|cholesky)\.hpp$",
    "metrics": r"/(metrics|leg_limits)\.hpp$",
    "verdict, samples, masks": r"/loop_record\.hpp$",
    "law": r"/laws/\w+\.hpp$",
    "plant": r"/(rigid_body|world)\.hpp$",
    "loop": r"/(closed_loop|runge_kutta|run_loop)\.hpp$",
}
KINDS = {  # of instructions
    "arithmetic": re.compile(r"v(fn?m(add|sub)\w*|mul|h?add|sub|max|min|cmp\w*|u?comi)[ps]d"),
    "divisions": re.compile(r"v(div|sqrt)[ps]d"),
    "moves": re.compile(r"v?mov\w*|vbroadcast\w*|vperm\w*|vunpck\w*|vinsert\w*|vextract\w*|vshuf\w*|vblend\w*"),
}


@dataclass
class Cost:
    """Of one part in one step, for all lanes together."""

    kinds: Counter[str] = field(default_factory=Counter)  # of instructions
    loads: int = 0
    stores: int = 0
    misses: int = 0  # of the first-level cache, as modelled
    samples: int = 0  # of time


def build() -> Path:
    """Compile the kernel with line tables, and return its module."""
    folder = ROOT / "build" / "step-cost"
    configure = ["cmake", "-S", str(ROOT), "-B", str(folder), "-G", "Ninja", "-DHEXSERVO_PYTHON=ON"]
    pybind11 = subprocess.check_output([sys.executable, "-m", "pybind11", "--cmakedir"], text=True).strip()
    configure += [f"-Dpybind11_DIR={pybind11}", f"-DPython_EXECUTABLE={sys.executable}", "-DCMAKE_CXX_FLAGS=-g1"]
    subprocess.run(configure, check=True, stdout=subprocess.DEVNULL)
    subprocess.run(["cmake", "--build", str(folder), "--target", f"_core_{VARIANT}"], check=True)
    (module,) = folder.glob(f"_core_{VARIANT}.*.so")
    return module


def work(module: Path, lanes: int, seconds: float) -> None:
    """Run `paper` in a kernel: alone for one lane, else in a pack."""
    spec = importlib.util.spec_from_file_location(f"_core_{VARIANT}", module)
    if spec is None or spec.loader is None:
        raise ValueError(f"expected a compiled module, got {module}")
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    kernel = _core.Kernel(loaded.kernel)
    scenario = hs.load_scenario("paper").updated({"simulation.duration": seconds, "metrics.rms_start": 0.0})
    if lanes == 1:
        outcomes = {_core.simulate(core_parameters(scenario), kernel).outcome}
    else:
        depth = np.linspace(-0.3, 0.3, lanes).reshape(-1, 1)
        rows = [("uncertainty.depth", depth)]
        batch = _core.simulate_batch(core_parameters(scenario), rows, lanes, _core.BatchLog.metrics, 1, kernel)
        outcomes = {_core.Outcome(code) for code in batch.outcome.tolist()}
    if outcomes != {_core.Outcome.completed}:
        raise ValueError(f"expected completed runs, got {outcomes}")


def mnemonics(module: Path) -> dict[int, str]:
    """Return the instruction at each address of a module."""
    listing = subprocess.check_output(["objdump", "-d", "--no-show-raw-insn", str(module)], text=True)
    return {int(m[1], 16): m[2] for m in re.finditer(r"^\s*([0-9a-f]+):\t(\S+)", listing, re.MULTILINE)}


def parts_of(module: Path, addresses: Iterable[int]) -> dict[int, str]:
    """Return the part that the code at each address of a module is of."""
    command = ["addr2line", "-i", "-f", "-C", "-a", "-e", str(module)]
    asked = "\n".join(map(hex, addresses))
    lines = iter(subprocess.run(command, input=asked, capture_output=True, text=True, check=True).stdout.splitlines())
    frames: dict[int, list[str]] = {}
    place = 0
    for line in lines:
        if re.fullmatch(r"0x[0-9a-f]+", line):
            place = int(line, 16)
            frames[place] = []
        else:  # a function, then its file and line
            frames[place].append(f"{line}\n{next(lines).partition(':')[0]}")
    return {place: _part(of) for place, of in frames.items()}


def _part(frames: list[str]) -> str:
    for part, pattern in FUNCTIONS.items():
        if any(re.search(pattern, frame) for frame in frames):
            return part
    for frame in frames:  # the innermost first
        for part, pattern in FILES.items():
            if re.search(pattern, frame):
                return part
    return "other"


def counted(module: Path, lanes: int, folder: Path) -> dict[int, list[int]]:
    """Count with callgrind: address -> instructions, loads, stores, misses, of `COUNTED_STEPS` steps."""
    out = folder / f"callgrind.{lanes}"
    command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={out}", "--dump-instr=yes", "--cache-sim=yes"]
    command += ["--collect-atstart=no", "--toggle-collect=*hexservo::detail::run<*"]
    run = [sys.executable, __file__, "--work", str(module), str(lanes), f"{COUNTED_STEPS * 1e-3:.6g}"]
    subprocess.run([*command, *run], check=True, capture_output=True, env=_environment())
    return dict(_callgrind_lines(out, module))


def _callgrind_lines(out: Path, module: Path) -> Iterator[tuple[int, list[int]]]:
    """Yield what the file of callgrind has of a module; an address may come more than once."""
    costs: defaultdict[int, list[int]] = defaultdict(lambda: [0, 0, 0, 0])
    names: dict[str, str] = {}
    events: list[str] = []
    current, address, is_call = "", 0, False
    for line in out.read_text(encoding="utf-8").splitlines():
        if line.startswith("events: "):
            events = line.split()[1:]
        elif m := re.match(r"(c?ob)=\((\d+)\)(?: (.*))?$", line):
            if m[3]:
                names[m[2]] = m[3]
            current = names[m[2]] if m[1] == "ob" else current
        elif line.startswith("calls="):
            is_call = True  # the next line is what was called
        elif m := re.match(r"(0x[0-9a-f]+|[+-]\d+|\*) (?:[+-]?\d+|\*)((?: \d+)*)$", line):
            step = m[1]
            address = int(step, 16) if step[0] == "0" else address + (0 if step == "*" else int(step))
            if is_call:
                is_call = False
                continue
            if current != str(module):
                continue
            of = dict(zip(events, map(int, m[2].split()), strict=False))
            added = (of.get("Ir", 0), of.get("Dr", 0), of.get("Dw", 0), of.get("D1mr", 0) + of.get("D1mw", 0))
            costs[address] = [a + b for a, b in zip(costs[address], added, strict=True)]
    if not costs:
        raise ValueError(f"expected counts of {module}, got none: see {out}")
    yield from costs.items()


def sampled(module: Path, lanes: int, folder: Path) -> Counter[int] | None:
    """Sample with perf: address -> samples; None where there is no perf, or it may not be used."""
    if shutil.which("perf") is None:
        return None
    out = folder / f"perf.{lanes}"
    run = [sys.executable, __file__, "--work", str(module), str(lanes), f"{TIMED_SECONDS * (30 if lanes > 1 else 60)}"]
    command = ["perf", "record", "-q", "-e", "cpu-clock", "-F", "4000", "-o", str(out), *run]
    if subprocess.run(command, check=False, capture_output=True, env=_environment()).returncode != 0:
        return None
    script = ["perf", "script", "-i", str(out), "--show-mmap-events", "-F", "comm,ip,event"]
    text = subprocess.run(script, check=True, capture_output=True, text=True).stdout
    maps = [
        (int(m[1], 16), int(m[2], 16), int(m[3], 16))
        for m in re.finditer(
            rf"MMAP2?.*\[0x([0-9a-f]+)\(0x([0-9a-f]+)\) @ (?:0x)?([0-9a-f]+).*\]: r-xp {re.escape(str(module))}", text
        )
    ]
    found: Counter[int] = Counter()
    for m in re.finditer(r"cpu-clock[^:]*:\s+([0-9a-f]+)\s*$", text, re.MULTILINE):
        ip = int(m[1], 16)
        found.update(ip - start + offset for start, size, offset in maps if start <= ip < start + size)
    return found or None


def _environment() -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def kind_of(mnemonic: str) -> str:
    """Return which of `KINDS` an instruction is, or others."""
    return next((kind for kind, pattern in KINDS.items() if pattern.fullmatch(mnemonic)), "others")


def costs(module: Path, lanes: int) -> dict[str, Cost]:
    """Return the cost of a step by part, the dearest first."""
    with tempfile.TemporaryDirectory() as name:
        counts = counted(module, lanes, Path(name))
        samples = sampled(module, lanes, Path(name)) or Counter()
    kinds = mnemonics(module)
    parts = parts_of(module, [*counts, *samples])
    found: defaultdict[str, Cost] = defaultdict(Cost)
    for address, (instructions, loads, stores, misses) in counts.items():
        cost = found[parts[address]]
        cost.kinds[kind_of(kinds[address])] += instructions
        cost.loads += loads
        cost.stores += stores
        cost.misses += misses
    for address, count in samples.items():
        found[parts[address]].samples += count
    return dict(sorted(found.items(), key=lambda item: -item[1].kinds.total()))


def lines_of(found: dict[str, Cost], lanes: int) -> list[str]:
    """Give the table of the costs of a step per scenario."""
    samples = sum(cost.samples for cost in found.values())
    per = COUNTED_STEPS * lanes
    total = Cost()
    rows = []
    for part, cost in found.items():
        rows.append([part, *_numbers(cost, per, samples)])
        total.kinds.update(cost.kinds)
        for name in ("loads", "stores", "misses", "samples"):
            setattr(total, name, getattr(total, name) + getattr(cost, name))
    rows.append(["**all**", *_numbers(total, per, samples)])
    head = " | ".join(["part", "instructions:", *(f"{kind}:" for kind in (*KINDS, "others"))])
    return table(f"{head} | loads: | stores: | misses: | time:", rows)


def _numbers(cost: Cost, per: int, samples: int) -> list[str]:
    counts = [cost.kinds.total(), *(cost.kinds[kind] for kind in (*KINDS, "others"))]
    counts += [cost.loads, cost.stores, cost.misses]
    return [*(f"{count / per:.0f}" for count in counts), f"{cost.samples / samples:.0%}" if samples else "–"]


def main() -> int:
    """Measure, print and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", nargs=3, metavar=("MODULE", "LANES", "SECONDS"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.work:
        module, lanes, seconds = arguments.work
        work(Path(module), int(lanes), float(seconds))
        return 0
    missing = [name for name in ("valgrind", "objdump", "addr2line") if shutil.which(name) is None]
    if missing:
        print(f"step cost: expected {', '.join(missing)} (packages valgrind, binutils), not found", file=sys.stderr)
        return 1
    print("Compiling the kernel with line tables: some minutes")
    module = build()
    here = describe_machine()
    lines = ["", f"{here['date'][:10]}; {here['cpu']}; {here['core']['compiler']}; law `hybrid`, per scenario.", ""]
    for lanes, name in ((1, "One run (`double`)"), (4, "A pack of four (`Lanes<4>`)")):
        print(f"{name}: counting and sampling")
        lines += [f"{name}:", "", *lines_of(costs(module, lanes), lanes), ""]
    print("\n".join(lines))
    replace_block(ROOT / "BENCHMARKS.md", "step", "\n".join([*lines, ""]))
    print("written: the tables of a step in BENCHMARKS.md")
    return 0


if __name__ == "__main__":
    sys.exit(main())
