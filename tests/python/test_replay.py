"""What is simulated is what runs: exported headers, compiled, answer as the simulated controllers did, bit for bit."""

from __future__ import annotations

import contextlib
import copy
import pickle
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

import hexservo as hs
from hexservo.run import variant
from hexservo.run.export import gains_header
from hexservo.scenario.laws import ALL_LAWS, LAWS
from points import GOAL, scattered, with_points
from recorded_ticks import step, ticks_of

ROOT = Path(__file__).resolve().parents[2]
GIVEN = {
    "now": 1,
    "exposure": 1,
    "features": 8,  # of four points
    "depth": 4,
    "position": 3,
    "quaternion": 4,
    "twist": 6,
    "leg_lengths": 6,
    "leg_rates": 6,
}
ANSWERED = {
    "wrench": 6,
    "leg_forces": 6,
    "fuzzy_output": 6,
    "status": 1,
    "saturated": 1,
    "leg_positions": 6,
    "latency": 3,
}
POSITIONS = {
    "actuators.kind": "position",
    "actuators.delay": 0.002,
    "actuators.position": {"bandwidth": 30.0, "damping": 0.8, "speed_limit": 0.05, "acceleration_limit": 1.0},
}

# Reads recorded inputs of the scenario that it is asked for, and writes what the exported controller answers.
PROGRAM = """
#include <cstdio>
#include <cstring>
#include <vector>

template <class Law, int N>
int replay(const hexservo::ServoGains<double, Law, N>& gains) {
  auto state = hexservo::initial_state(gains);
  std::vector<double> row(27 + 3 * gains.points);
  while (std::fread(row.data(), row.size() * sizeof(double), 1, stdin) == 1) {
    hexservo::ControllerInputOf<N> input;
    input.now = row[0];
    input.frame.exposure = row[1];
    const double* from = row.data() + 2;
    const auto take = [&from](auto&& to) {
      for (Eigen::Index i = 0; i < to.size(); ++i) to(i) = *from++;
    };
    take(input.frame.image.features.head(2 * gains.points));
    take(input.frame.image.depth.head(gains.points));
    take(input.pose.position);
    take(input.pose.quaternion);
    take(input.twist);
    take(input.joints.lengths);
    take(input.joints.rates);
    const hexservo::ControllerOutput out = hexservo::step(gains, state, input);
    double answer[29];
    std::copy_n(out.wrench.data(), 6, answer);
    std::copy_n(out.leg_forces.data(), 6, answer + 6);
    std::copy_n(out.fuzzy_output.data(), 6, answer + 12);
    answer[18] = static_cast<int>(out.status);
    answer[19] = out.saturated;
    std::copy_n(out.leg_positions.data(), 6, answer + 20);
    const double latency[3] = {out.latency.estimate, out.latency.least, out.latency.most};
    std::copy_n(latency, 3, answer + 26);
    std::fwrite(answer, sizeof answer, 1, stdout);
  }
  return 0;
}

int main(int, char** argv) {
CASES  return 2;
}
"""


def sampled_scenarios() -> Iterator[hs.Scenario]:
    """Every packaged scenario in sampled mode, with every law that accepts it."""
    for name in hs.scenario_names():
        scenario = hs.load_scenario(name)
        if scenario.simulation.mode != "sampled":
            continue
        for law in ALL_LAWS:
            with contextlib.suppress(hs.ScenarioError):  # a law may have no pose of the goal
                yield scenario.updated({"name": f"{name}-{law}", "controller.law": law})
    for law in LAWS:
        changes = {"name": f"positions-{law}", "controller.law": law, "simulation.duration": 0.5, **POSITIONS}
        yield hs.load_scenario("composite-30hz").updated({**changes, "metrics.rms_start": 0.0})
    for known in (True, False):
        changes = {
            "name": f"tracking-{known}",
            "controller.law": "tracking",
            "camera.latency_known": known,
            **POSITIONS,
        }
        changes |= {"camera.prediction": "none", "simulation.duration": 1.0, "metrics.rms_start": 0.0}
        yield hs.load_scenario("composite-30hz").updated(changes)
    wrong = {
        "uncertainty.latency": 0.02,
        "camera.smoothing": 0.01,
        "metrics.rms_start": 0.0,
        "simulation.duration": 0.5,
    }
    yield hs.load_scenario("composite-30hz").updated({"name": "wrong-latency", **wrong})
    early = {"uncertainty.latency": 0.06, "camera.period": 0.033, "metrics.rms_start": 0.0, "simulation.duration": 0.5}
    yield hs.load_scenario("composite-30hz").updated({"name": "early-stamps", **early})
    for count in (3, 5, 8, 16):
        for law in LAWS:
            if count > 3 or law != "pbvs":
                changes = {"name": f"points-{count}-{law}", "controller.law": law, "simulation.duration": 0.1}
                changes["metrics.rms_start"] = 0.0
                yield with_points(hs.load_scenario("real-machine"), scattered(count), **changes)


class Core(NamedTuple):
    """The static library of the core, and with what a program with it is compiled and run."""

    library: Path
    compiler: tuple[str, ...]
    emulator: tuple[str, ...] = ()


def built(preset: str, folder: Path, *options: str) -> Path:
    """The static library of a preset: the tests' own where it is there and new, otherwise built here."""
    there = ROOT / "build" / preset / "libhexservo_core.a"
    sources = [path for path in (ROOT / "cpp").rglob("*") if path.suffix in (".hpp", ".cpp")]
    if there.exists() and there.stat().st_mtime >= max(path.stat().st_mtime for path in sources):
        return there
    made = ["cmake", "-S", str(ROOT), "-B", str(folder), "-DCMAKE_BUILD_TYPE=Release", *options]
    subprocess.run(made, check=True, capture_output=True)
    build = ["cmake", "--build", str(folder), "--target", "hexservo_core", "-j2"]
    subprocess.run(build, check=True, capture_output=True)
    return folder / "libhexservo_core.a"


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Core:
    return Core(built("dev", tmp_path_factory.mktemp("core")), ("g++",))


@pytest.fixture(scope="module")
def on_arm(tmp_path_factory: pytest.TempPathFactory) -> Core:
    """For 64-bit ARM, as the installed package has it compiled."""
    compiler, emulator = "aarch64-linux-gnu-g++", "qemu-aarch64"
    if shutil.which(compiler) is None or shutil.which(emulator) is None:
        pytest.skip("needs a compiler for 64-bit ARM and qemu-user, which make aarch64 installs")
    options = ["-DCMAKE_SYSTEM_NAME=Linux", "-DCMAKE_SYSTEM_PROCESSOR=aarch64", f"-DCMAKE_CXX_COMPILER={compiler}"]
    core = built("aarch64", tmp_path_factory.mktemp("arm"), *options)
    return Core(core, (compiler, "-U__ARM_FEATURE_FMA", "-static"), (emulator,))


def compiled(folder: Path, core: Core, source: str, *headers: tuple[str, str]) -> Path:
    for name, text in headers:
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "main.cpp").write_text(source, encoding="utf-8")
    command = [*core.compiler, "-std=c++20", "-O1", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror", "-Wno-psabi"]
    eigen = next(path for path in map(Path, ("/usr/include/eigen3", "/usr/local/include/eigen3")) if path.exists())
    includes = ["-I", str(ROOT / "cpp" / "include"), "-isystem", str(eigen), "-I", str(folder)]
    program = folder / "program"
    subprocess.run(
        [*command, *includes, str(folder / "main.cpp"), str(core.library), "-lpthread", "-o", str(program)], check=True
    )
    return program


def rows(ticks: dict[str, NDArray[np.float64]], columns: dict[str, int]) -> NDArray[np.float64]:
    if "features" in columns:
        columns = {**columns, "features": ticks["features"].shape[1], "depth": ticks["features"].shape[1] // 2}
    assert {name: ticks[name].shape[1] for name in columns} == columns
    return np.hstack([ticks[name] for name in columns])


pytestmark = pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++, as building does")


@pytest.mark.slow
def test_every_exported_program_answers_as_the_simulated_controller_did(tmp_path: Path, library: Core) -> None:
    scenarios = list(sampled_scenarios())
    sampled = [name for name in hs.scenario_names() if hs.load_scenario(name).simulation.mode == "sampled"]
    assert len(scenarios) >= 0.9 * len(sampled) * len(LAWS)
    assert {f"{name}-{hs.load_scenario(name).controller.law}" for name in sampled} <= {s.name for s in scenarios}
    acted, braked = replayed(scenarios, tmp_path, library)
    assert acted > 10_000
    assert braked > 100


@pytest.mark.slow
def test_an_exported_program_answers_on_arm_as_the_simulated_controller_did(tmp_path: Path, on_arm: Core) -> None:
    """The same on another processor: where results are rounded is up to the source alone."""
    acted, braked = replayed(of_each_kind(), tmp_path, on_arm)
    assert acted > 5_000
    assert braked > 20


def test_an_exported_program_answers_as_the_simulated_controller_did(tmp_path: Path, library: Core) -> None:
    acted, braked = replayed(of_each_kind(), tmp_path, library)
    assert acted > 5_000
    assert braked > 20


def of_each_kind() -> list[hs.Scenario]:
    """Every law, legs that take positions, dropouts, a lens, other numbers of points."""
    kinds = {f"dropouts-{law}" for law in LAWS} | {"eye-to-hand-hybrid", "positions-composite", "tracking-True"}
    kinds |= {"wrong-latency", "early-stamps", "points-3-hybrid", "points-16-composite"}
    scenarios = [scenario for scenario in sampled_scenarios() if scenario.name in kinds]
    assert {scenario.name for scenario in scenarios} == kinds
    return scenarios


def replayed(scenarios: list[hs.Scenario], tmp_path: Path, core: Core) -> tuple[int, int]:
    """Compare one program of all headers with the simulated controllers; return ticks of a law and of the brake."""
    headers, cases = [], []
    for index, scenario in enumerate(scenarios):
        text = gains_header(scenario)
        namespace = text.split("#define HEXSERVO_GAINS ")[1].split("\n")[0]
        headers.append((f"gains{index}.hpp", text))
        cases.append(f'  if (!std::strcmp(argv[1], "{index}")) return replay({namespace}::controller_gains());\n')
    includes = "#include <algorithm>\n" + "".join(f'#include "{name}"\n' for name, _ in headers)
    program = compiled(tmp_path, core, includes + PROGRAM.replace("CASES", "".join(cases)), *headers)
    acted = braked = 0
    for index, scenario in enumerate(scenarios):
        ticks = ticks_of(scenario)
        given = np.ascontiguousarray(rows(ticks, GIVEN))
        run = subprocess.run(
            [*core.emulator, program, str(index)], input=given.tobytes(), capture_output=True, check=True
        )
        answers = np.frombuffer(run.stdout).reshape(-1, sum(ANSWERED.values()))
        expected = rows(ticks, ANSWERED)
        differing = np.flatnonzero((answers.view(np.int64) != expected.view(np.int64)).any(axis=1))
        assert differing.size == 0, f"{scenario.name}: first at tick {differing[0]} of {len(expected)}"
        acted += int((ticks["status"] == 0).sum())
        braked += int((ticks["status"] != 0).sum())
    print(f"{len(scenarios)} runs: {acted} ticks of a law, {braked} of the safe output")
    return acted, braked


@pytest.mark.parametrize("law", LAWS)
def test_the_recorded_run_is_the_simulated_one(law: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ticks are recorded from the very loop that `hs.simulate` runs, and `hs.Controller` answers them the same."""
    scenario = hs.load_scenario("composite-30hz").updated({"controller.law": law, "simulation.duration": 0.5})
    ticks = ticks_of(scenario)
    monkeypatch.setattr(variant, "_CHOSEN", variant.load_kernel("baseline"))  # the others fuse products and sums
    result = hs.simulate(scenario)
    n = len(result.time)
    np.testing.assert_array_equal(ticks["fuzzy_output"][:n], result.fuzzy_output)
    controller = hs.Controller(scenario)
    for k in range(len(ticks["now"])):
        out = step(controller, ticks, k)
        np.testing.assert_array_equal(out.wrench, ticks["wrench"][k])
        np.testing.assert_array_equal(out.leg_forces, ticks["leg_forces"][k])


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    "changes",
    [
        {},  # prediction, late frames
        {"sensors.pose": "encoders", "camera.dropout": 0.4, "camera.on_lost": "hold"},
        {"camera.prediction": "none", "camera.dropout": 0.4, "camera.timeout": 0.08},  # brakes now and then
        POSITIONS,
    ],
    ids=["prediction", "encoders", "timeout", "positions"],
)
def test_a_pickled_controller_continues_bit_for_bit(law: str, changes: dict[str, object]) -> None:
    scenario = hs.load_scenario("composite-30hz").updated(
        {"controller.law": law, "simulation.duration": 0.3, **changes}
    )
    ticks = ticks_of(scenario)

    original = hs.Controller(scenario)
    count = len(ticks["now"])
    for k in range(count // 2):
        step(original, ticks, k)
    continued = [pickle.loads(pickle.dumps(original)), copy.deepcopy(original)]
    fresh = hs.Controller(scenario)
    differs = False
    for k in range(count // 2, count):
        expected = step(original, ticks, k)
        for other in continued:
            assert_equal(step(other, ticks, k), expected)
        differs |= not np.array_equal(step(fresh, ticks, k).wrench, expected.wrench)
    np.testing.assert_array_equal(continued[0].fuzzy_weights, original.fuzzy_weights)
    assert differs, "a controller without the state gave the same: nothing was tested"


def test_a_controller_that_is_set_back_repeats_itself() -> None:
    """Nothing that it keeps beside its stored state, as legs at the newest pose, is left of the ticks in between."""
    scenario = hs.load_scenario("composite-30hz").updated(
        {"sensors.pose": "encoders", "sensors.period": 0.002, "sensors.noise": 1e-6, "simulation.duration": 0.2}
    )
    ticks = ticks_of(scenario)
    controller = hs.Controller(scenario)
    count = len(ticks["now"])
    for k in range(count // 2):
        step(controller, ticks, k)
    state, clock = controller._core.state(), controller._clock
    expected = [step(controller, ticks, k) for k in range(count // 2, count)]
    controller._core.restore(state)
    controller._clock = clock
    for k, once in zip(range(count // 2, count), expected, strict=True):
        assert_equal(step(controller, ticks, k), once)


def assert_equal(one: hs.ControllerOutput, other: hs.ControllerOutput) -> None:
    for name in one._fields:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_a_state_of_another_controller_is_refused() -> None:
    scenario = hs.load_scenario("composite-30hz")
    one = hs.Controller(scenario)._core
    other = hs.Controller(scenario.updated({"controller.law": "kelly"}))._core
    with pytest.raises(ValueError, match=r"^state: expected \d+ numbers, those of this scenario and period, got \d+$"):
        one.restore(other.state())
    state = one.state()
    one.restore(state)
    for wrong in ("text", [[1.0]], None):
        with pytest.raises(ValueError, match=r"^state: expected a vector of numbers"):
            one.restore(wrong)
    with pytest.raises(ValueError, match="in the place of a mask or a count"):
        one.restore(np.full_like(state, 0.5))
    np.testing.assert_array_equal(one.state(), state)


@pytest.mark.parametrize(
    "name", ["composite-30hz", "real-machine", "slow-camera", "pi-h824-positions", "reachy-mini-motors"]
)
def test_a_state_with_a_number_that_none_has_is_refused_or_harmless(name: str) -> None:
    """Leg rates may be NaN, and so a twist; legs are before they are first read or commanded. No other number is, since
    the law would never act again.
    """
    scenario = hs.load_scenario(name)
    scenario = scenario.updated({"simulation.duration": 120 * scenario.simulation.step})  # the first image is there
    ticks = ticks_of(scenario)
    controller = hs.Controller(scenario)
    count = len(ticks["now"])
    for k in range(count - 5):
        step(controller, ticks, k)
    state, clock = controller._core.state(), controller._clock
    taken = 0
    for place in range(len(state)):
        spoilt, before = state.copy(), taken
        spoilt[place] = np.nan
        with contextlib.suppress(ValueError):
            controller._core.restore(spoilt)
            taken += 1
        if taken == before:
            continue
        controller._clock = clock
        outputs = [step(controller, ticks, k) for k in range(count - 5, count)]
        assert [output.status for output in outputs] == ["valid"] * 5, place
        assert np.isfinite(outputs[-1].leg_positions).all() == (scenario.controller.law == "tracking"), place
    assert taken <= (18 if scenario.controller.law == "tracking" else 6)


@pytest.mark.parametrize("clock", [lambda now: now - 1.0, lambda now: np.nan], ids=["back", "nan"])
def test_a_clock_that_fails_leaves_the_brake_of_a_controller_that_has_lost_its_camera(clock: Any) -> None:
    """The legs are read without a usable clock too: a moving platform brakes."""
    scenario = hs.load_scenario("real-machine").updated({"simulation.duration": 0.12, "camera.timeout": 0.08})
    ticks = ticks_of(scenario)
    faulty, healthy = hs.Controller(scenario), hs.Controller(scenario)
    count = len(ticks["now"])
    for k in range(count - 10):
        step(faulty, ticks, k)
        step(healthy, ticks, k)
    moved = 0.0
    for k in range(count - 10, count):
        now, legs = float(ticks["now"][k, 0]), ticks["leg_lengths"][k]
        brake = healthy.step(leg_lengths=legs, now=now + 0.08)  # beyond the timeout
        output = faulty.step(leg_lengths=legs, now=clock(now))
        assert output.status == "unusable"
        if k == count - 10:  # the readings of `healthy` are late once
            continue
        assert brake.status == "stale_image"
        moved = max(moved, np.abs(brake.wrench - brake.wrench[2] * np.eye(6)[2]).max())
        np.testing.assert_allclose(output.wrench, brake.wrench, rtol=1e-6, atol=1e-9)
    assert moved > 1e-3  # it brakes


@pytest.mark.parametrize("jump", [1e9, 1e13, 1.7e18, 1e300])
def test_a_clock_that_once_jumps_ahead_leaves_the_brake_its_damping(jump: float) -> None:
    """Readings go on being a period apart: of a sum of ticks beyond 2^53 nothing would be left between two of them."""
    scenario = hs.load_scenario("composite-30hz").updated({"sensors.pose": "encoders", "simulation.duration": 0.02})
    ticks = ticks_of(scenario)
    controller = hs.Controller(scenario)
    rate = np.array([0.02, -0.01, 0.03, 0.01, -0.02, 0.01])  # of the legs [m/s]
    for k in range(15):
        now = float(ticks["now"][k, 0])
        legs = ticks["leg_lengths"][0] + rate * now
        output = controller.step(leg_lengths=legs, now=jump if k == 5 else now)
    assert output.status == "unusable"
    still = hs.Controller(scenario)  # its readings stay where the others end
    for k in range(3):
        at_rest = still.step(leg_lengths=legs, now=1e-3 * k)
    damping = np.abs(output.leg_forces - at_rest.leg_forces)
    assert damping.min() > 0.0
    expected = hs.Controller(scenario)
    for k in range(15):
        braking = expected.step(leg_lengths=ticks["leg_lengths"][0] + rate * float(ticks["now"][k, 0]), now=1e-3 * k)
    np.testing.assert_allclose(output.wrench, braking.wrench, rtol=1e-6)


GRID = {
    "target.initial_features": None,
    "target.depth": None,
    "target.grid": {"rows": 3, "columns": 3, "spacing": 0.05, "pose": [0.0, 0.0, -0.65, 0.0, 0.0, 0.0]},
    "target.desired_features": None,
    "target.desired_pose": GOAL,
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("real-machine", {"controller.law": "pbvs", "target.weights": [1.0, 1.0, 1.0, 0.5]}),
        ("slow-camera", {"controller.law": "composite", **GRID}),
    ],
    ids=["pbvs and weights", "composite and a grid"],
)
def test_the_example_compiles_with_any_header(
    tmp_path: Path, library: Core, name: str, changes: dict[str, Any]
) -> None:
    text = gains_header(hs.load_scenario(name).updated(changes))
    example = (ROOT / "examples" / "servo.cpp").read_text(encoding="utf-8")
    program = compiled(tmp_path, library, example, ("gains.hpp", text))
    run = subprocess.run([program, "0.2"], capture_output=True, text=True, check=False)
    assert run.stdout.startswith(f'gains of the scenario "{name}"\n')
    assert "ticks of 1 ms" in run.stdout
    assert run.stderr == ""


@pytest.mark.slow
def test_the_example_settles_with_a_lens(tmp_path: Path, library: Core) -> None:
    """Its frames hold pixels of the camera, which has a principal point and distorts; the band is the scenario's."""
    text = gains_header(hs.load_scenario("eye-to-hand").updated({"metrics.band": 2.5}))
    example = (ROOT / "examples" / "servo.cpp").read_text(encoding="utf-8")
    program = compiled(tmp_path, library, example, ("gains.hpp", text))
    run = subprocess.run([program, "1.2"], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout
    assert "features within 2.5 px" in run.stdout


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["position", "position_torque"])
def test_the_example_commands_positions_where_the_drives_take_them(tmp_path: Path, library: Core, kind: str) -> None:
    """It settles when the simulation does: wrong depths do not matter to a law that has the points of the target."""
    scenario = hs.load_scenario("pi-h824-positions")
    example = (ROOT / "examples" / "servo.cpp").read_text(encoding="utf-8")
    header = gains_header(scenario.updated({"actuators.kind": kind}))
    program = compiled(tmp_path, library, example, ("gains.hpp", header))
    run = subprocess.run([program, "1.5"], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    settled = re.search(r"features within 2 px from ([\d.]+) s on", run.stdout)
    assert settled
    simulated = hs.simulate(scenario.updated({"camera.noise": 0.0}))
    time = hs.metrics(simulated)["settling_time"]
    assert float(settled[1]) == pytest.approx(time, abs=1.01 * scenario.simulation.step)


def test_what_was_lost_on_the_way_to_a_robot() -> None:
    """Timeout, prediction and the wait of the weights act in the tick as in the simulation."""
    late = hs.load_scenario("paper").updated(
        {
            "simulation.mode": "sampled",
            "controller.switching.kind": "implicit",
            "camera": {"period": 0.033, "latency": 0.033, "prediction": "encoder"},
        }
    )
    assert hs.metrics(hs.simulate(late))["settling_time"] == pytest.approx(0.480, rel=0.03)
    header = gains_header(late.updated({"camera.timeout": 0.2}))
    assert "s.camera.timeout = 0.2;" in header
    assert "hexservo::Prediction::encoder" in header
    assert "s.actuators.saturation = false;" in header


def test_a_timeout_costs_no_stroke() -> None:
    """With 40 % of the frames lost, braking on old images does not use more stroke than acting on them."""
    scenario = hs.load_scenario("dropouts").updated({"camera.dropout": 0.4})
    for seed in range(5):
        strokes = {}
        for timeout in (None, 0.066):
            run = hs.simulate(scenario.updated({"camera.timeout": timeout, "seed": seed}))
            assert run.outcome == "completed"
            strokes[timeout] = hs.metrics(run)["peak_leg_excursion"]
        print(f"seed {seed}: stroke {1e3 * strokes[None]:.2f} mm, with a timeout {1e3 * strokes[0.066]:.2f} mm")
        assert strokes[0.066] <= strokes[None] * 1.001
