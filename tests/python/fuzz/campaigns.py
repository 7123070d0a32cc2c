"""The campaigns: scenarios through everything, hostile ticks, mutated results, batches against single runs."""

from __future__ import annotations

import inspect
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import h5py
import numpy as np
from numpy.random import Generator

import hexservo as hs
from fuzz.batches import batch_and_single_run
from fuzz.campaign import Trial
from fuzz.promises import check
from fuzz.scenarios import draw
from hexservo.findings.check import unlikely
from hexservo.run.controller import InputStatus
from hexservo.run.saving import result_bytes, save_result

__all__ = ["CAMPAIGNS"]

PARTS = ("conditioning", "workspace", "stiction", "equilibria", "drift", "camera_rate", "largest_start")


def refused_in_words(act: Callable[[], Any]) -> Any:
    """Give what a function returns; None where it refuses with a sentence, the only other thing it may do."""
    try:
        return act()
    except ValueError as error:
        if type(error) not in (ValueError, hs.ScenarioError) or "expected" not in str(error):
            raise  # as LinAlgError, UnicodeError, and errors of numpy about arrays
        return None


# ---- Scenarios ------------------------------------------------------------------------------------------------------


def scenario_runs(random: Generator, folder: Path) -> str:
    """Run a scenario: the result keeps its promises, reads back from YAML and from a file, and can be certified."""
    scenario = draw(random).scenario
    if scenario is None:
        return "refused"
    assert hs.Scenario.from_yaml(scenario.to_yaml()) == scenario
    result = hs.simulate(scenario)
    check(result)
    if random.random() < 0.2:
        save_result(result, folder / "result.nc")
        loaded = hs.load_result(folder / "result.nc")
        assert loaded.wrench.tobytes() == result.wrench.tobytes()
        assert loaded.scenario == scenario
    return result.outcome


def scenario_is_certified(random: Generator, folder: Path) -> str:
    """Certify a run."""
    return _judged(random, hs.certify)


def scenario_is_diagnosed(random: Generator, folder: Path) -> str:
    """Diagnose a run."""
    return _judged(random, hs.diagnose)


def _judged(random: Generator, judge: Callable[[hs.Result], Any]) -> str:
    scenario = draw(random, budget=400, million=False).scenario
    if scenario is None:
        return "refused"
    result = hs.simulate(scenario)
    found = refused_in_words(lambda: judge(result))
    if found is None:
        return "refused with a message"
    found.sections()
    found.to_dict()
    return result.outcome


def scenario_is_analysed(random: Generator, folder: Path) -> str:
    """Check a scenario, and analyse one part of it."""
    part = PARTS[random.integers(len(PARTS))]
    scenario = draw(random, budget=400, million=False).scenario
    if scenario is None:
        return "refused"
    unlikely(scenario)
    found = refused_in_words(lambda: hs.analyse(scenario, [part]))
    if found is None:
        return "refused with a message"
    found.sections()
    found.to_dict()
    return part


# ---- Ticks ----------------------------------------------------------------------------------------------------------

_HOSTILE = (math.nan, math.inf, -math.inf, 0.0, -0.0, 5e-324, -1e-310, 1e-300, 1e150, 1e300, -1.7e308, 1e17)
_TIMES = ("exposure", "now")


def hostile_ticks(random: Generator, folder: Path) -> str:
    """Give a controller what no sensor should: its output stays finite, and its state whatever a valid tick makes."""
    scenario = draw(random, million=False).scenario
    if scenario is None:
        return "refused"
    controller = refused_in_words(lambda: hs.Controller(scenario))
    if controller is None:
        return "refused with a message"
    start = hs.simulate(scenario.updated({"simulation.duration": scenario.simulation.step}))
    usual: dict[str, Any] = {
        "features": start.features[0],
        "depth": start.depth[0],
        "position": start.position[0],
        "quaternion": start.quaternion[0],
        "twist": np.zeros(6),
        "leg_lengths": start.leg_lengths[0],
        "leg_rates": np.zeros(6),
    }
    names = list(inspect.signature(controller.step).parameters)
    assert set(names) <= {*usual, *_TIMES}, names
    statuses = set()
    for tick in range(40):
        arguments = {name: usual[name] for name in names if name in usual}
        for name in names:
            if random.random() < 0.3:
                arguments[name] = _spoilt(random, usual.get(name, tick * controller.period))
        before = controller.fuzzy_weights.tobytes()
        output = controller.step(**arguments)
        commanded = scenario.actuators.kind == "force" or np.isfinite(output.leg_positions).all()
        for vector in (output.wrench, output.leg_forces, output.fuzzy_output):
            assert vector.shape == (6,)
            # a machine that takes positions has no motion to need forces for before its joints were known once
            assert np.isfinite(vector).all() or (vector is output.leg_forces and not commanded), (
                tick,
                arguments,
                output,
            )
        assert commanded or output.invalid_input, (tick, arguments, output)
        assert output.status in get_args(InputStatus)
        assert output.invalid_input == (output.status != "valid")
        if output.invalid_input:
            assert controller.fuzzy_weights.tobytes() == before, (tick, arguments)
        assert np.isfinite(controller.fuzzy_weights).all()
        statuses.add(output.status)
    return "valid and other ticks" if len(statuses) > 1 else f"only {statuses.pop()} ticks"


def _spoilt(random: Generator, usual: Any) -> Any:
    """Spoil some entries, or scale all, or draw others."""
    count = np.size(usual)
    if np.ndim(usual) == 0:
        return float(random.choice([*_HOSTILE, usual, random.normal()]))
    values = np.array(usual, dtype=float)
    kind = random.integers(3)
    if kind == 0:
        values[random.random(count) < 0.3] = random.choice(_HOSTILE)
    elif kind == 1:
        with np.errstate(over="ignore"):  # infinities are hostile too
            values *= 10.0 ** random.uniform(-320, 300)
    else:
        values = random.normal(size=count) * 10.0 ** random.uniform(-3, 5)
    return values


# ---- Saved results --------------------------------------------------------------------------------------------------


def mutated_results(random: Generator, folder: Path) -> str:
    """Damage a saved result: it is refused with a message, and only a file with all its bytes gives the result."""
    content = _content()
    path = folder / "result.nc"
    kind = ("flips", "zeros", "cut", "inserted", "moved", "appended", "attribute")[random.integers(7)]
    damaged = bytearray(content)
    at, until = sorted(int(place) for place in random.integers(len(content), size=2))
    until = min(until, at + int(random.choice([1, 8, 512, 4096])))
    if kind == "flips":
        for place in random.integers(len(content), size=random.integers(1, 20)):
            damaged[place] ^= int(random.integers(1, 256))
    elif kind == "zeros":
        damaged[at:until] = bytes(until - at)
    elif kind == "cut":
        del damaged[at : until if random.random() < 0.5 else None]
    elif kind == "inserted":
        damaged[at:at] = random.bytes(until - at + 1)
    elif kind == "moved":
        damaged[at:until] = content[-(until - at) - 300 : -300]
    elif kind == "appended":
        damaged += random.bytes(until - at + 1)
    path.write_bytes(damaged)
    if kind == "attribute":  # what HDF5 itself writes
        with h5py.File(path, "a") as file:
            file.attrs["note"] = "x" * int(random.integers(1, 1000))
    refusal = _refusal(hs.load_result, path, hs.ResultError)
    if refusal is None:
        assert path.read_bytes() == content, "a damaged file was read"
        return "unchanged"
    assert str(path) in refusal
    assert "expected" in refusal
    assert "\n" not in refusal
    return f"refused ({kind})"


def _refusal(read: Callable[[Path], Any], path: Path, error: type[ValueError]) -> str | None:
    """Give the words with which a file is refused; None where it is read."""
    try:
        read(path)
    except error as caught:
        return str(caught)
    return None


_CONTENT: list[bytes] = []


def _content() -> bytes:
    if not _CONTENT:
        _CONTENT.append(
            bytes(result_bytes(hs.simulate(hs.load_scenario("paper").updated({"simulation.duration": 1.0}))))
        )
    return _CONTENT[0]


def special_files(random: Generator, folder: Path) -> str:
    """Name what is no regular file, or an odd one, to everything that reads: it is refused at once, with a message."""
    path = folder / "x"
    kind = ("pipe", "folder", "device", "sparse", "loop", "random", "text", "proc")[random.integers(8)]
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "device":
        path = Path(str(random.choice(["/dev/zero", "/dev/full", "/dev/random", "/dev/tty", "/dev/null"])))
    elif kind == "sparse":
        path.touch()
        os.truncate(path, int(10 ** random.uniform(0, 11)))
    elif kind == "loop":
        path.symlink_to("x")
    elif kind == "random":
        path.write_bytes(random.bytes(int(10 ** random.uniform(0, 5))))
    elif kind == "text":
        path.write_text("".join(random.choice(list(":-[]{}#&*!|>'\"% \n\tab01.~,"), size=int(random.integers(200)))))
    else:
        path = Path(str(random.choice(["/proc/self/mem", "/proc/self/environ", "/proc/kmsg", "/proc/self/status"])))
    for read, error in (
        (hs.load_result, hs.ResultError),
        (hs.load_scenario, hs.ScenarioError),
        (_load_recording, hs.ScenarioError),
        (_load_way, hs.ScenarioError),
    ):
        assert _refusal(read, path, error), f"{path} was read"
    return kind


def _load_recording(path: Path) -> None:
    hs.load_scenario("rough-road").updated({"base_motion": {"kind": "recorded", "file": str(path)}})


def _load_way(path: Path) -> None:
    hs.load_scenario("rough-road").updated({"target.motion": {"kind": "recorded", "file": str(path)}})


CAMPAIGNS: dict[str, Trial] = {
    "runs": scenario_runs,
    "certify": scenario_is_certified,
    "analyse": scenario_is_analysed,
    "diagnose": scenario_is_diagnosed,
    "batch": batch_and_single_run,
    "ticks": hostile_ticks,
    "results": mutated_results,
    "special": special_files,
}
