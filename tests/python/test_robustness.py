"""Bad input never gives a plausible number, and whatever is accepted runs to a result that keeps its promises."""

from __future__ import annotations

import itertools
import math
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from types import FrameType
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import hexservo as hs
from fuzz.promises import check
from packaged import ONE_OF_EACH_KIND, one_of_each_kind
from rescaled import rescaled
from widths import WIDTHS

INF, NAN = math.inf, math.nan
PAPER = hs.load_scenario("paper")
POINTS = np.column_stack(
    [0.5 * np.array(PAPER.target.initial_features, dtype=float).reshape(4, 2) / 581.816, np.full(4, -0.65)]
)


def refused(changes: dict[str, Any], key: str) -> str:
    """The refusal of the paper's scenario with these changes, which names the key."""
    with pytest.raises(hs.ScenarioError) as caught:
        PAPER.updated(changes)
    assert isinstance(caught.value, ValueError)
    assert any(line.startswith(key) for line in caught.value.problems), caught.value.problems
    return str(caught.value)


# ---- NaN and infinity anywhere --------------------------------------------------------------------------------------


def numeric_places(value: Any, place: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Places of all numbers in a resolved scenario."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from numeric_places(inner, (*place, key))
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from numeric_places(inner, (*place, index))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield place


def dotted(place: tuple[str | int, ...]) -> str:
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).removeprefix(".")


SCALES = np.linspace(0.95, 0.97, 6)  # 1 - error is of rank one, so that the actual inertia stays positive


def resolved(form: str) -> dict[str, Any]:
    """A scenario with every array written out, so that every number has a place."""
    arrays = {
        "robot.inertia": np.diag([1.5e-4, 1.6e-4, 3.0e-4]) + 1e-6,
        "uncertainty.inertia": 1 - np.outer(SCALES, SCALES),
        "uncertainty.coriolis": np.diag(np.linspace(0.05, 0.1, 6)),
        "uncertainty.gravity": np.linspace(0, 0.01, 6),
        "uncertainty.depth": [0.1, 0.2, 0.3, 0.3],
        "controller.hybrid.kp": np.linspace(1e-6, 2e-6, 8),
        **{
            f"controller.hybrid.fuzzy.{key}": np.linspace(1, 2, 6)
            for key in ("adaptation", "error_scale", "rate_scale", "initial_scale")
        },
        **{
            f"controller.composite.fuzzy.{key}": np.linspace(1, 2, 6)
            for key in ("leakage", "weight_limit", "dead_zone")
        },
        "controller.composite.kp": np.linspace(1e-9, 2e-9, 8),
        **{f"controller.composite.{key}": np.linspace(1, 2, 6) for key in ("kv", "kt", "kd", "drive", "prior")},
        "controller.hybrid.fuzzy.table": np.linspace(-1, 1, 49).reshape(7, 7),
        "controller.kelly.kp": np.linspace(1e-6, 2e-6, 8),
        **{
            f"controller.{key}": np.linspace(1, 2, 6)
            for key in (
                *("kelly.kd", "resolved_rate.ki", "resolved_rate.damping", "pbvs.kp", "pbvs.kd", "pbvs.prior"),
                *("computed_torque.kp", "computed_torque.kd", "computed_torque.prior"),
            )
        },
    }
    if form == "features":
        arrays["target.depth"] = [0.5, 0.51, 0.52, 0.53]
    else:
        arrays |= {"target.points": POINTS, "target.initial_features": None, "target.depth": None}
    return PAPER.updated(arrays).to_mapping()


@pytest.mark.parametrize(
    ("form", "block"), [("features", ""), ("points", "target"), pytest.param("points", "", marks=pytest.mark.slow)]
)
def test_no_number_may_be_nan_or_infinite(form: str, block: str) -> None:
    mapping: Any = resolved(form)
    every = list(numeric_places(mapping))
    assert len(every) > 200
    places = [place for place in every if dotted(place).startswith(block)]
    assert len(places) > 12
    for index, place in enumerate(places):
        bad = (NAN, INF, -INF)[(index + len(form)) % 3]  # one of them for each place, another one with the other form
        inner = mapping
        for part in place[:-1]:
            inner = inner[part]
        good = inner[place[-1]]
        inner[place[-1]] = bad
        with pytest.raises(hs.ScenarioError) as caught:
            hs.Scenario.from_mapping(mapping)
        inner[place[-1]] = good
        lines = [line for line in caught.value.problems if line.startswith(f"{dotted(place)}: expected ")]
        assert len(lines) == 1, (place, caught.value.problems)
        assert lines[0].endswith(f"got {bad}"), lines
    assert hs.Scenario.from_mapping(mapping) == hs.Scenario.from_mapping(resolved(form))  # nothing else was wrong


# ---- Bodies, targets and geometries that do not exist ---------------------------------------------------------------


@pytest.mark.parametrize("mass", [0, -0.06, -1e300])
def test_a_mass_is_positive(mass: float) -> None:
    assert f"expected a number > 0 and < 1e+09, got {mass}" in refused({"robot.mass": mass}, "robot.mass")


@pytest.mark.parametrize(
    "inertia",
    [
        [0, 1e-4, 1e-4],
        [-1e-4, 1e-4, 1e-4],
        [1e-4, 1e-4, 2.1e-4],
        [[1e-4, 1e-4, 0], [1e-4, 1e-4, 0], [0, 0, 1e-4]],  # a rod without extent
        [[1e-4, 2e-4, 0], [2e-4, 1e-4, 0], [0, 0, 1e-4]],  # indefinite
        [[3e-4, 1e-4, 0], [1e-4, 1e-4, 0], [0, 0, 1e-4]],
    ],
)
def test_an_inertia_is_that_of_a_body(inertia: Any) -> None:
    refused({"robot.inertia": inertia}, "robot.inertia")


def test_a_thin_disc_is_a_body() -> None:
    """Its largest moment is the sum of the others: exactly on the triangle inequality, in any frame."""
    disc = np.diag([1.5e-4, 1.5e-4, 3.0e-4])
    trace = np.trace(disc)
    random = np.random.default_rng(0)
    for _ in range(100):
        rotation, _ = np.linalg.qr(random.normal(size=(3, 3)))
        tilted = rotation @ disc @ rotation.T
        PAPER.updated({"robot.inertia": (tilted + tilted.T) / 2})
    PAPER.updated({"robot.inertia": disc + np.diag([0, 0, 0.9e-9 * trace])})
    refused({"robot.inertia": disc + np.diag([0, 0, 1.1e-9 * trace])}, "robot.inertia")


def test_the_actual_inertia_stays_positive() -> None:
    error = np.zeros((6, 6))
    error[3, 4] = 0.1
    assert "symmetric" in refused({"uncertainty.inertia": error}, "uncertainty.inertia")
    error = np.zeros((6, 6))
    error[3:, 3:] = -0.9 * (1 - np.eye(3))  # 1 - error is indefinite
    assert "positive" in refused({"uncertainty.inertia": error}, "uncertainty.inertia")


def with_point(index: int, point: Any) -> dict[str, Any]:
    points = POINTS.copy()
    points[index] = point
    return {"target.points": points, "target.initial_features": None, "target.depth": None}


@pytest.mark.parametrize("z", [-0.15, -0.1, 0.0, 10.0])
def test_a_target_is_in_front_of_the_camera(z: float) -> None:
    for index in range(4):
        message = refused(with_point(index, [0.01, 0.02, z]), f"target.points[{index}]")
        assert "in front of the camera" in message
    refused({"target.depth": -0.5}, "target.depth")
    refused({"target.depth": [0.5, 0.5, 0.0, 0.5]}, "target.depth[2]")


def test_features_do_not_coincide() -> None:
    initial = list(PAPER.target.initial_features or ())
    desired = list(PAPER.target.desired_features)
    for first, second in itertools.combinations(range(4), 2):
        for key, features in (("initial_features", initial), ("desired_features", desired)):
            same = features.copy()
            same[2 * second : 2 * second + 2] = same[2 * first : 2 * first + 2]
            assert "4 different features" in refused({f"target.{key}": same}, f"target.{key}")
    # Two points on one ray from the camera's home look alike.
    centre = np.array(PAPER.robot.home_position)
    refused(with_point(3, centre + 1.5 * (POINTS[0] - centre)), "target.points")


def test_features_determine_the_pose() -> None:
    refused({"target.initial_features": [0, 0, 10, 10, 20, 20, 30, 30]}, "target.initial_features")
    refused({"target.desired_features": [-5, 1, 0, 1, 7, 1, 30, 1]}, "target.desired_features")


def degrees(*angles: float) -> list[float]:
    return list(np.deg2rad(angles))


@pytest.mark.parametrize(
    ("platform", "base"),
    [
        (degrees(0, 60, 120, 180, 240, 300), degrees(0, 60, 120, 180, 240, 300)),
        (degrees(30, 90, 150, 210, 270, 330), degrees(0, 60, 120, 180, 240, 300)),  # cyclic order, turned
        (degrees(17, 77, 137, 197, 257, 317), degrees(0, 60, 120, 180, 240, 300)),
        (degrees(-10, 10, 110, 130, 230, 250), degrees(-10, 10, 110, 130, 230, 250)),  # similar to its base
        (degrees(0, 0, 120, 120, 240, 240), degrees(0, 0, 120, 120, 240, 240)),  # legs in pairs
        (degrees(0, 0, 0, 0, 0, 0), degrees(-10, 10, 110, 130, 230, 250)),
    ],
)
def test_a_geometry_that_is_singular_everywhere_is_refused(platform: list[float], base: list[float]) -> None:
    refused({"robot.platform_angles": platform, "robot.base_angles": base}, "robot.")


def test_a_singular_home_is_refused() -> None:
    refused({"robot.home_position": [0.0, 0.0, 0.0]}, "robot.home_position")  # all legs in one plane


# ---- The time grid --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", ["simulation.step", "simulation.duration"])
@pytest.mark.parametrize("value", [0, -1e-3, NAN, INF])
def test_step_and_duration_are_positive(key: str, value: float) -> None:
    refused({key: value}, f"{key}: expected a ")


@pytest.mark.parametrize(("step", "duration"), [(3e-3, 5.0), (1e-3, 0.9995), (2.0, 1.0), (0.7, 1.0), (1e-3, 1e-9)])
def test_a_step_divides_the_duration(step: float, duration: float) -> None:
    message = refused({"simulation.step": step, "simulation.duration": duration}, "simulation.step")
    assert "divides the duration" in message


TOO_LONG: list[tuple[dict[str, float], str]] = [
    ({"step": 1e-3, "duration": 1e6}, "simulation.log_every"),  # 400 GB
    ({"step": 1e-3, "duration": 1e5, "log_every": 10}, "simulation.log_every"),
    ({"step": 1e-6, "duration": 1e4}, "simulation.duration"),
    ({"step": 1e-12, "duration": 1e300}, "simulation.duration"),
]


def test_a_run_too_long_is_refused_before_memory_is_asked_for() -> None:
    """In a process that may not have 2 GiB more: asking for them would be a MemoryError."""
    for grid, key in TOO_LONG:
        refused({"simulation": grid}, key)
    lines = python(
        f"""
        import resource
        import hexservo as hs

        scenario = hs.load_scenario("paper")
        pages = int(open("/proc/self/statm").read().split()[0])
        resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + 2**30,) * 2)
        for grid, _ in {TOO_LONG!r}:
            try:
                scenario.updated({{"simulation": grid}})
            except ValueError as error:
                print(str(error).splitlines()[0])
        """
    )
    assert len(lines) == len(TOO_LONG)
    for line, (_, key) in zip(lines, TOO_LONG, strict=True):
        assert line.startswith(key)


def test_a_batch_that_finds_too_little_memory_raises_an_exception() -> None:
    """A camera of 10 kHz and 100 s of latency has a million frames under way, some 0.8 kB each in a pack of 8."""
    lines = python(
        """
        import resource
        import hexservo as hs

        camera = {"period": 1e-4, "latency": 100.0, "timeout": None, "prediction": "none"}
        time = {"step": 1e-4, "duration": 0.001}
        scenario = hs.load_scenario("composite-30hz").updated({"simulation": time, "camera": camera})
        pages = int(open("/proc/self/statm").read().split()[0])
        resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + 2**27,) * 2)
        try:
            hs.simulate_batch(scenario, {"uncertainty.gravity": [0.0] * 16})
        except MemoryError as error:
            print(type(error).__name__)
        """
    )
    assert lines == ["MemoryError"]


def python(code: str) -> list[str]:
    """Lines that another Python prints; it has to end well."""
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,  # only to stop what hangs
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


# ---- Runs that do not reach their end -------------------------------------------------------------------------------


@pytest.mark.parametrize("log_every", [1, 7, 1000])
def test_a_run_that_diverges_keeps_what_it_computed(log_every: int) -> None:
    printed = PAPER.updated({"controller.jacobian": "printed", "simulation.log_every": log_every})
    result = hs.simulate(printed)
    check(result)
    assert result.outcome == "diverged"
    assert 0 < result.end_time < 0.05
    # The sentence has the time of the first bad step, one after the last good sample.
    assert result.detail.endswith(f"at t = {result.end_time + 1e-3:.6g} s")
    assert np.abs(result.feature_error[-1]).max() <= 1e4
    full = hs.simulate(printed.updated({"simulation.log_every": 1}))
    np.testing.assert_array_equal(result.wrench[-1], full.wrench[-1])
    assert same_metrics(result, full)


def test_a_target_that_comes_behind_the_camera_ends_the_run() -> None:
    """A platform a tenth as heavy as the law takes it for rises through its target."""
    narrow = {  # near the axis, so that no feature leaves the bound of divergence before
        "initial_features": 0.1 * np.array(PAPER.target.initial_features, dtype=float),
        "desired_features": 0.1 * np.array(PAPER.target.desired_features),
        "depth": 0.0202,
    }
    changes = {"target": narrow, "uncertainty.gravity": 0.9, "controller.hybrid.kp": 1e-12}
    result = hs.simulate(PAPER.updated(changes))
    check(result)
    assert result.outcome == "behind_camera"
    assert result.detail == f"a target point came behind the camera at t = {result.end_time + 1e-3:.6g} s"
    # 1 ms before the event the points are in front, and as far as the platform moves within that step.
    assert 0 < -result.depth[-1].max() < -result.twist[-1, 2] * 1e-3 * 1.1


def test_ctrl_c_ends_a_run_and_keeps_what_it_computed() -> None:
    lines = python(
        """
        import os, signal, threading, time
        import hexservo as hs

        scenario = hs.load_scenario("paper").updated({"simulation": {"duration": 1e6, "log_every": 1000}})

        def press():
            time.sleep(0.5)
            os.kill(os.getpid(), signal.SIGINT)

        simulate = hs.simulate  # imported before the clock goes
        threading.Thread(target=press).start()
        result = simulate(scenario)
        print(result.outcome, result.detail, sep="\\n")
        print(result.end_time, result.time[-1], len(result.time), hs.metrics(result)["final_error"])
        """
    )
    assert lines[0] == "interrupted"
    end_time, last, samples, error = map(float, lines[2].split())
    assert lines[1] == f"stopped on request at t = {end_time:.6g} s"
    assert 0 < end_time == last < 1e6  # all of it would take hours
    assert samples == math.floor(end_time + 1e-9) + (1 if abs(end_time - round(end_time)) < 1e-9 else 2)
    assert error < 20.1


class _SomethingElseError(Exception):
    pass


def test_exceptions_of_other_signal_handlers_reach_the_caller() -> None:
    def raises(number: int, frame: FrameType | None) -> None:
        raise _SomethingElseError

    before = signal.signal(signal.SIGALRM, raises)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.2)
        with pytest.raises(_SomethingElseError):
            hs.simulate(PAPER.updated({"simulation": {"duration": 1e6, "log_every": 10**6}}))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    check(hs.simulate(PAPER))  # nothing is left behind


# ---- The same run is the same run -----------------------------------------------------------------------------------


def same_metrics(one: hs.Result, other: hs.Result) -> bool:
    return all(
        a == b or (math.isnan(a) and math.isnan(b))
        for a, b in zip(hs.metrics(one).values(), hs.metrics(other).values(), strict=True)
    )


def assert_same(one: hs.Result, other: hs.Result) -> None:
    """Bit for bit."""
    assert (one.outcome, one.end_time, one.detail, one.events) == (
        other.outcome,
        other.end_time,
        other.detail,
        other.events,
    )
    for name in ("time", "fuzzy_weights", *WIDTHS):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), name
    assert same_metrics(one, other)


@pytest.mark.parametrize("name", one_of_each_kind())
def test_two_runs_are_equal_bit_for_bit(name: str) -> None:
    assert_same(hs.simulate(hs.load_scenario(name)), hs.simulate(hs.load_scenario(name)))


def test_threads_do_not_disturb_each_other() -> None:
    scenarios = [hs.load_scenario(name) for name in ONE_OF_EACH_KIND]
    alone = [hs.simulate(scenario) for scenario in scenarios]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(hs.simulate, scenarios))
    for one, other in zip(alone, together, strict=True):
        assert_same(one, other)


@pytest.mark.parametrize("call", ["simulate(long)", "simulate_batch(long, {'uncertainty.depth': [0.0] * 64})"])
def test_a_program_ends_while_another_thread_simulates(call: str) -> None:
    """A run in a daemon thread waits for no lock of an interpreter that has ended, whenever it ends itself."""
    ends = python(
        f"""
        import os, sys, threading, time
        import hexservo as hs
        def run():
            while True:
                hs.{call}
        long = hs.load_scenario("paper").updated({{"simulation.duration": 20.0, "simulation.log_every": 1000}})
        for _ in range(3):
            child = os.fork()  # which ends as a program does that has imported the same
            if child == 0:
                threading.Thread(target=run, daemon=True).start()
                time.sleep(0.2)
                sys.exit()
            print(os.waitpid(child, 0)[1], flush=True)
        """
    )
    assert ends == ["0"] * 3


def test_other_threads_run_while_the_core_does() -> None:
    """The interpreter's lock is free: this thread wakes up while another one simulates."""
    scenario = PAPER.updated({"simulation": {"duration": 500.0, "log_every": 1000}})
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(hs.simulate, scenario)
        wakes = 0
        while not running.done():
            time.sleep(1e-3)
            wakes += 1
    assert running.result().outcome == "completed"
    assert wakes > 10


@pytest.mark.parametrize("name", ["paper", "paper-gravity"])
@pytest.mark.parametrize("log_every", [7, 1000, 10**9])
def test_metrics_and_events_do_not_depend_on_what_is_logged(name: str, log_every: int) -> None:
    scenario = hs.load_scenario(name)
    full, thin = hs.simulate(scenario), hs.simulate(scenario.updated({"simulation.log_every": log_every}))
    assert same_metrics(full, thin)
    assert full.events == thin.events
    np.testing.assert_array_equal(full.fuzzy_weights, thin.fuzzy_weights)


# ---- Anything at all ------------------------------------------------------------------------------------------------


def decades(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers spread evenly over decades, so that extremes are as likely as what is usual."""
    return st.floats(low, high).map(lambda exponent: 10.0**exponent)


def numbers(element: st.SearchStrategy[float], count: int) -> st.SearchStrategy[Any]:
    return element | st.lists(element, min_size=count, max_size=count)


def exactly(count: int, element: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.lists(element, min_size=count, max_size=count)


def block(**keys: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, Any]]:
    """A block with any of its keys."""
    return st.fixed_dictionaries({}, optional=keys)


ANGLE = st.floats(-2 * math.pi, 2 * math.pi)
ERROR = st.sampled_from([-0.999, -0.3, 0.0, 0.3, 0.999]) | st.floats(-0.99, 0.99)
FEATURE = st.floats(-400, 400)
RULES = st.sampled_from(["NB", "ZE", "PM"]) | st.floats(-10, 10)
SYMMETRIC = exactly(6, st.floats(0.5, 1.4)).map(lambda scales: 1 - np.outer(scales, scales)) | exactly(
    36, st.floats(-0.2, 0.2)
).map(lambda entries: (np.reshape(entries, (6, 6)) + np.reshape(entries, (6, 6)).T) / 2)

ROBOTS = st.fixed_dictionaries(
    {"preset": st.sampled_from(["micro", "cubic"])},
    optional={
        "platform_radius": decades(-4, 2),
        "base_radius": decades(-4, 2),
        "platform_angles": exactly(6, ANGLE),
        "base_angles": exactly(6, ANGLE),
        "home_position": st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-2, 2)).map(list),
        "mass": decades(-9, 6),
        "inertia": decades(-12, 3).map(lambda moment: [moment, moment, 2 * moment])
        | st.lists(decades(-6, -3), min_size=3, max_size=3),
        "stroke": decades(-9, 3),
        "force_limit": decades(-9, 3),
    },
)
CAMERAS = block(
    focal_length=decades(-6, 3), pixel_scale=decades(0, 9), convention=st.sampled_from(["eye_in_hand", "as_printed"])
)
SHIFTED = st.tuples(exactly(8, FEATURE), exactly(8, st.floats(-50, 50))).map(
    lambda pair: {"initial_features": pair[0], "desired_features": list(np.add(*pair))}
)
TARGETS = (
    st.tuples(SHIFTED, numbers(decades(-3, 3), 4)).map(lambda pair: {**pair[0], "depth": pair[1]})
    | block(initial_features=exactly(8, FEATURE), desired_features=exactly(8, FEATURE), depth=decades(-2, 1))
    | exactly(4, st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-5, 0)).map(list)).map(
        lambda points: {"points": points, "initial_features": None, "depth": None}
    )
)
FUZZY = block(
    enabled=st.booleans(),
    adaptation=numbers(decades(-12, 12), 6),
    error_scale=numbers(st.just(0.0) | decades(-9, 9), 6),
    rate_scale=numbers(st.just(0.0) | decades(-9, 9), 6),
    initial_scale=numbers(st.floats(-10, 10), 6),
    table=st.just("linear") | exactly(7, exactly(7, RULES)),
    bell_width=st.none() | decades(-9, 6),
    bell_slope=decades(-3, math.log10(16)) | st.sampled_from([1, 2, 16]),
    leakage=numbers(st.just(0.0) | decades(-9, 3), 6),
    weight_limit=st.none() | numbers(decades(-9, 9), 6),
    dead_zone=numbers(st.just(0.0) | decades(-9, 3), 6),
)
GAINS = numbers(st.just(0.0) | decades(-12, 9), 6)
CONTROLLERS = block(
    law=st.sampled_from(["hybrid", "composite", "kelly", "resolved_rate", "pbvs", "computed_torque"]),
    jacobian=st.sampled_from(["consistent", "printed"]),
    switching=block(kind=st.sampled_from(["sign", "tanh", "saturation"]), width=decades(-15, 6)),
    hybrid=block(kp=numbers(decades(-15, 3), 8), kv=numbers(st.just(0.0) | decades(-12, 3), 6), fuzzy=FUZZY),
    composite=block(
        kp=numbers(st.just(0.0) | decades(-15, 3), 8),
        **dict.fromkeys(("kv", "kt", "kd", "drive", "prior"), GAINS),
        fuzzy=FUZZY,
    ),
    kelly=block(kp=numbers(st.just(0.0) | decades(-15, 3), 8), kd=GAINS),
    resolved_rate=block(
        **dict.fromkeys(("gain", "gain_far", "gain_slope"), st.just(0.0) | decades(-6, 6)),
        adaptive=st.booleans(),
        jacobian_at=st.sampled_from(["current", "desired", "mean"]),
        ki=GAINS,
        damping=GAINS,
    ),
    pbvs=block(kp=GAINS, kd=GAINS, prior=GAINS),
    computed_torque=block(kp=GAINS, kd=GAINS, prior=GAINS),
)
UNCERTAINTIES = block(
    inertia=ERROR | SYMMETRIC,
    coriolis=ERROR | exactly(6, exactly(6, ERROR)),
    gravity=numbers(ERROR, 6),
    depth=numbers(ERROR, 4),
)


@st.composite
def grids(draw: st.DrawFn) -> dict[str, Any]:
    """At most 0.2 s and 2000 steps."""
    step = draw(decades(-5, -2))
    steps = draw(st.integers(1, min(2000, int(0.2 / step))))
    return {"step": step, "duration": steps * step, "log_every": draw(st.integers(1, 50) | st.just(10**9))}


SCENARIOS = st.fixed_dictionaries(
    {"simulation": grids()},
    optional={
        "robot": ROBOTS,
        "camera": CAMERAS,
        "target": TARGETS,
        "uncertainty": UNCERTAINTIES,
        "controller": CONTROLLERS,
    },
)


@pytest.mark.slow
@settings(max_examples=120)  # the fuzzer goes on
@given(SCENARIOS)
def test_any_scenario_runs_or_is_refused(changes: dict[str, Any]) -> None:
    try:
        scenario = PAPER.updated(changes)
    except hs.ScenarioError:
        return
    check(hs.simulate(scenario))
    assert hs.Scenario.from_yaml(scenario.to_yaml()) == scenario


KEYS = sorted({str(part) for place in numeric_places(PAPER.to_mapping()) for part in place if isinstance(part, str)})
SCALARS = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=8)
    | st.binary(max_size=3)
    | st.complex_numbers()
    | st.sampled_from(["linear", "micro", "tanh", "1e-6", ".nan", 10**400])
)
GARBAGE = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=8)
        | st.dictionaries(st.sampled_from(KEYS) | st.text(max_size=6) | st.integers(), inner, max_size=5)
        | st.tuples(inner, inner)
    ),
    max_leaves=20,
)
PATHS = sorted({dotted(place).partition("[")[0] for place in numeric_places(resolved("features"))})


@settings(max_examples=300)
@given(GARBAGE)
@example({})
@example({"target": {}})
@example({"name": "x", "target": None})
def test_garbage_is_refused(garbage: Any) -> None:
    with pytest.raises(hs.ScenarioError):
        hs.Scenario.from_mapping(garbage)


@pytest.mark.slow
@settings(max_examples=300)
@given(st.dictionaries(st.sampled_from(PATHS) | st.text(max_size=12), GARBAGE, max_size=3))
def test_a_garbage_change_is_refused_or_leaves_a_scenario(changes: dict[str, Any]) -> None:
    try:
        scenario = PAPER.updated(changes)
    except hs.ScenarioError:
        return
    assert hs.Scenario.from_mapping(scenario.to_mapping()) == scenario


@settings(max_examples=300)
@given(st.text() | st.lists(st.sampled_from(list(":-[]{},#&*!|>'\"%@` \n\tab01.~")), max_size=40).map("".join))
@example("")
@example("- a\n- b")
@example("name: paper")
@example("{name: &x a, description: *x}")
def test_garbage_text_is_refused(text: str) -> None:
    with pytest.raises(hs.ScenarioError):
        hs.Scenario.from_yaml(text)


@settings(max_examples=200)
@given(st.data())
def test_a_damaged_file_is_refused_or_is_a_scenario(data: st.DataObject) -> None:
    text = data.draw(st.sampled_from(TEXTS))
    at = data.draw(st.integers(0, len(text)))
    until = at + data.draw(st.integers(0, 20))
    damaged = text[:at] + data.draw(st.text(max_size=5)) + text[until:]
    try:
        scenario = hs.Scenario.from_yaml(damaged)
    except hs.ScenarioError:
        return
    assert hs.Scenario.from_yaml(scenario.to_yaml()) == scenario


TEXTS = [PAPER.to_yaml(), hs.Scenario.from_mapping(resolved("points")).to_yaml()]


@pytest.mark.parametrize("size", [2.0**-12, 2.0**4])
def test_a_pose_is_found_in_the_image_whatever_the_size_of_the_machine(size: float) -> None:
    """The information of an image is in px/m and px/rad. Powers of two change no digit of a product or a sum."""
    scenario = hs.load_scenario("fails-poor-image")
    found, expected = (hs.simulate(one) for one in (rescaled(scenario, size, size**3), scenario))
    assert found.outcome == expected.outcome == "completed"
    np.testing.assert_array_equal(found.feature_error, expected.feature_error)
