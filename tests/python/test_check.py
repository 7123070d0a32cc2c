"""`hexservo check`: what is legal and surely not meant, and keys without effect, each against runs or a hand sum."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import norm

import hexservo as hs
import rotary_machine
from hexservo import _core
from hexservo.findings.analysis.linear_law import NotFiniteError
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check import fastest_rate, has_sides_exchanged, unlikely
from hexservo.findings.check_forces import start_forces
from hexservo.findings.check_keys import keys_without_effect, needed_by, settings_needed
from hexservo.scenario.blocks import Robot
from hexservo.scenario.core_defaults import core_default
from hexservo.scenario.fitted import gains_written
from hexservo.scenario.keys import value_at
from hexservo.scenario.laws import LAWS, laws_with
from test_keys_with_effect import fingerprint
from without_runs import unlikely_without_runs

LINE = (-0.06, -0.02, 0.02, 0.06)  # [m]

NEAR_GOAL = "controller.law: runs of {} that begin within 4 px of the goal before a target at rest"

# What packaged scenarios are built to be, or come near to: the first words of each warning.
EXPECTED = {
    # whose outliers and lost frames let a point go for a while
    "dropouts": ["metrics.band: runs of composite that begin at the goal before a target at rest leave the band"],
    "fails-coarse-step": [
        "simulation.step: a servo period of 5 ms is coarser",
        f"{NEAR_GOAL.format('hybrid')} end early",
    ],
    "badly-spread-features": [
        "target: at the start 0.1 px of noise in one image makes the platform uncertain by 2.88 m"
    ],
    "fails-poor-image": [
        "target: at the start 0.3 px of noise in one image makes the platform uncertain by 712 mm",
        "controller.resolved_rate: the law needs 37.8 N of leg 3 at the start (375 mN, and 37.4 N for three",
        f"{NEAR_GOAL.format('resolved_rate')} are not settled",
    ],
    # whose load, high above the joints, couples the axes
    "moog-6dof2000e": ["controller.composite.auto.bandwidth: 0.8 Hz is fitted axis by axis, but the inertia couples"],
    "fails-leg-limits": ["target.desired_features: the goal is out of reach: leg 5 would be"],
    "fails-lost-features": [
        "target.desired_features: the goal is outside the image of 136 x 136 px (point 2)",
        f"{NEAR_GOAL.format('composite')} are not settled",
    ],
    "fails-saturation": [
        "robot.force_limit: 0.128 N is less than the 0.134 N that leg 1 needs",
        f"{NEAR_GOAL.format('composite')} end early",
    ],
    # which holds the goal when it comes from home, with weights that have grown
    "saturation": [f"{NEAR_GOAL.format('composite')} end early"],
    **{
        name: [f"{NEAR_GOAL.format('hybrid')} are not settled"]
        for name in ("fails-gravity", "fails-spring", "fails-stiction", "paper-gravity", "unknown-payload")
    },
    **{name: [f"{NEAR_GOAL.format('hybrid')} end early"] for name in ("fails-late-camera", "fails-wrong-sign")},
    "fails-stick-slip": ["controller.law: 1 of 4 runs of resolved_rate that begin within 5.8 px of the goal"],
    **{name: ["robot.stroke: 10 m either way is"] for name in hs.scenario_names() if name.startswith("textbook-")},
}


@pytest.mark.parametrize("name", hs.scenario_names())
def test_packaged_scenarios_have_the_warnings_they_are_made_for(name: str) -> None:
    scenario = hs.load_scenario(name)
    found = unlikely(scenario)
    expected = EXPECTED.get(name, [])
    assert len(found) == len(expected)
    for sentence, start in zip(found, expected, strict=True):
        assert sentence.startswith(start)
    assert keys_without_effect(scenario) == []


def test_gains_of_a_law_that_does_not_act_are_not_looked_at() -> None:
    coarse = hs.load_scenario("fails-coarse-step").updated({"camera.dropout": 1.0})
    assert [line.split(":")[0] for line in unlikely(coarse)] == ["camera.dropout", "simulation.step"]
    assert [line.split(":")[0] for line in unlikely(coarse, by_law=False)] == ["camera.dropout"]


@pytest.mark.parametrize(("off", "warned"), [(1e-4, True), (4e-2, False)])
def test_points_nearly_on_a_line_are_warned_of(off: float, warned: bool) -> None:
    """Four points at x = +-60 and +-20 mm, off that line in turn to either side by a distance [m]."""
    machine = hs.load_scenario("pi-h824-positions")
    points = [
        [x, sign * off, machine.robot.home_position[2] - 0.4] for x, sign in zip(LINE, (1, -1, 1, -1), strict=True)
    ]
    target = dict.fromkeys(("tag", "initial_features", "desired_features")) | {
        "points": points,
        "desired_pose": [3e-3, -2e-3, 2e-3, 0.0, 0.0, 0.0],
    }
    scenario = machine.updated({"target": target})
    found = [sentence for sentence in unlikely_without_runs(scenario) if sentence.startswith("target: at the start")]
    assert bool(found) == warned
    (section,) = hs.analyse(scenario, ["conditioning"]).sections()
    assert (section.verdict == "bad") == warned


def only(scenario: hs.Scenario, start: str) -> str:
    (sentence,) = (sentence for sentence in unlikely_without_runs(scenario) if sentence.startswith(start))
    return sentence


def test_the_weight_is_shared_by_the_legs(paper: hs.Scenario) -> None:
    """At home the legs' vertical parts carry m g (1 - delta): sum f_i u_z = weight, by the leg vectors themselves."""
    hexapod = _core.Hexapod(_core.robot_preset("micro"))
    way = np.array(hexapod.platform_joints) + np.array(hexapod.home_position) - np.array(hexapod.base_joints)
    vertical = np.abs(way[:, 2]) / np.linalg.norm(way, axis=1)
    for delta in (0.0, 0.5):
        share = paper.robot.mass * 9.8 * (1 - delta) / vertical.sum()
        heavy = {"uncertainty.gravity": delta}
        tight = paper.updated({**heavy, "robot.force_limit": 0.999 * share})
        assert "needs to carry the platform's weight at home" in only(tight, "robot.force_limit")
        carried = paper.updated({**heavy, "robot.force_limit": 1.001 * share})
        assert not any(sentence.startswith("robot.force_limit") for sentence in unlikely_without_runs(carried))


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("camera.latency", "no image arrives in the run"),
        ("camera.period", "the image exposed at the start is the only one of the run"),
        ("metrics.dwell", "no run that starts outside metrics.band settles"),
        ("metrics.rms_start", "the RMS error is averaged over nothing"),
    ],
)
def test_times_that_the_run_is_too_short_for(key: str, words: str) -> None:
    """Against what runs show: the exposures that a controller sees, the settling time, the RMS error."""
    scenario = hs.load_scenario("paper").updated({"simulation.mode": "sampled", "simulation.duration": 2.0})

    def seen(changes: dict[str, Any]) -> tuple[bool, ...]:
        exposures: set[float] = set()

        def still(now: hs.Observation) -> np.ndarray[Any, Any]:
            if now.exposure == now.exposure:
                exposures.add(now.exposure)
            return np.zeros(6)

        hs.simulate(scenario.updated(changes), controller=still)
        # the law reaches a band of 0.9 of the first error at once
        band = 0.9 * hs.metrics(hs.simulate(scenario))["peak_error"]
        found = hs.metrics(hs.simulate(scenario.updated({"metrics.band": band, **changes})))
        nans = [math.isnan(found[name]) for name in ("settling_time", "rms_error")]
        return (not exposures, len(exposures) == 1, *nans)

    place = ("camera.latency", "camera.period", "metrics.dwell", "metrics.rms_start").index(key)
    for time, happens in ((2.0, True), (33.0, True), (1.5, False)):
        found = [line for line in unlikely_without_runs(scenario.updated({key: time})) if "simulation.duration" in line]
        ends = time == 2.0 and key == "metrics.rms_start"  # the last sample is the first that counts
        then = "the RMS error is that of the last sample" if ends else words
        assert found == [f"{key}: {time:g} s is not shorter than simulation.duration, 2 s, so that {then}"] * happens
        if time != 2.0:
            assert seen({key: time})[place] == happens


def test_an_rms_error_from_the_end_on_is_that_of_the_last_sample() -> None:
    scenario = hs.load_scenario("paper").updated({"simulation.duration": 2.0, "metrics.rms_start": 2.0})
    run = hs.simulate(scenario)
    assert hs.metrics(run)["rms_error"] == pytest.approx(np.sqrt(np.mean(run.feature_error[-1] ** 2)), rel=1e-12)


@pytest.mark.parametrize("name", ["composite-30hz", "pi-h824-positions"])
def test_drives_that_no_command_reaches_in_the_run(name: str) -> None:
    """Six periods of delay: in a run of so many the platform is held where it starts, in one of twelve it is not."""
    scenario = hs.load_scenario(name)
    tick = scenario.simulation.step
    late = {"actuators.delay": 6 * tick, "camera.latency": 0.0, "uncertainty.gravity": 0.0, "simulation.log_every": 1}
    for ticks, moves in ((6, False), (12, True)):
        short = scenario.updated({**late, "simulation.duration": ticks * tick})
        named = [line for line in unlikely(short) if line.startswith("actuators.delay") and "duration" in line]
        assert len(named) == (not moves)
        assert all(line.endswith("so that no command arrives in the run") for line in named)
        travel = np.abs(np.diff(hs.simulate(short).leg_lengths, axis=0)).max()
        assert (travel > 1e-9) == moves, travel


def test_frames_that_are_all_lost() -> None:
    lossy = hs.load_scenario("slow-camera").updated({"camera.dropout": 1.0})
    assert only(lossy, "camera.dropout") == "camera.dropout: 1 loses every frame, so that no image arrives in the run"
    assert unlikely(lossy.updated({"camera.dropout": 0.9})) == []


def test_a_size_that_is_not_that_of_the_calibration() -> None:
    """By hand: 630 px is 150.5 px from (960 - 1)/2 = 479.5 px, which is 15.7 % of 960 px."""
    scenario = hs.load_scenario("eye-to-hand")
    matrix = [[900.0, 0.0, 630.0], [0.0, 900.0, 470.0], [0.0, 0.0, 1.0]]
    swapped = scenario.updated({"camera": hs.camera_from_opencv(matrix, size=(960, 1280))})
    assert only(swapped, "camera.principal_point") == (
        "camera.principal_point: (630, 470) px is 13.4 px from the centre of an image of 1280 x 960 px, and 227 px "
        "from that of camera.image_size, 960 x 1280 px: the width comes first in it"
    )
    other = swapped.updated({"camera.principal_point": [630.0, 900.0]})
    assert "is more than 15% of the image from its centre, (479.5, 639.5) px" in only(other, "camera.principal_point")
    for changes in ({"camera.principal_point": [623.0, 600.0]}, {"camera.image_size": None}):
        assert not any("principal_point" in line for line in unlikely_without_runs(swapped.updated(changes)))


@pytest.mark.parametrize("size", [(1280, 1024), (2448, 2048), (640, 480), (1920, 1080)])
def test_exchanged_sides_of_an_image_are_found_whatever_its_shape(size: tuple[int, int]) -> None:
    """Of principal points that are off the centre by 2 % of the image, as of usual lenses (standard deviation)."""
    random, shape = np.random.default_rng(5), np.array(size, dtype=float)
    points = (shape - 1.0) / 2.0 + random.normal(0.0, 0.02, (1000, 2)) * shape
    assert sum(has_sides_exchanged(shape[::-1], point) for point in points) > 900
    assert not any(has_sides_exchanged(shape, point) for point in points)


def test_images_that_are_nearly_square_are_not_taken_for_exchanged_ones() -> None:
    """Of 100 000 usual ones, as many as normal errors of 2 % put beyond 5 % along both axes, on the right side."""
    random, found, count = np.random.default_rng(5), 0, 100_000
    for ratio in random.uniform(1.0, 1.3, count):
        shape = 1000.0 * np.array([ratio, 1.0])[:: random.choice([-1, 1])]
        point = (shape - 1.0) / 2.0 + random.normal(0.0, 0.02, 2) * shape
        found += has_sides_exchanged(shape, point)
    assert found <= 2 * count * norm.sf(2.5) ** 2


@pytest.mark.parametrize(
    ("reading", "frame", "mean"),
    [
        (9.8, "specific_force", "(0, 0, 19.6)"),  # the sign of an axis that points up
        (-9.8, "kinematic", "(0, 0, -9.8)"),
        (-9.8, "specific_force", None),
        (-8.0, "specific_force", None),  # a mean of 1.8 m/s^2
        (0.0, "kinematic", None),
    ],
)
def test_gravity_in_a_recording(reading: float, frame: str, mean: str | None) -> None:
    scenario = hs.load_scenario("slow-camera")
    assert scenario.robot.gravity == (0.0, 0.0, 9.8)
    motion = {
        "kind": "recorded",
        "samples": [[(-1.0) ** sample, 0.0, reading] for sample in range(50)],
        "sample_period": 0.1,
        "frame_of_acceleration": frame,
    }
    found = [line for line in unlikely(scenario.updated({"base_motion": motion})) if "base_motion" in line]
    assert len(found) == (mean is not None)
    for line in found:
        assert f"their mean acceleration is {mean} m/s^2, by which the base gains" in line
        assert "in 4.9 s; check the signs and base_motion.frame_of_acceleration" in line
        assert "specific_force has (0, 0, -9.8) m/s^2" in line


def test_specific_forces_that_were_read_with_another_gravity() -> None:
    """The difference of the two stays in them where the gravity is changed afterwards, and not where both are given."""
    scenario = hs.load_scenario("slow-camera")
    rest = {
        "kind": "recorded",
        "samples": [[0.0, 0.0, -9.8]] * 50,
        "sample_period": 0.1,
        "frame_of_acceleration": "specific_force",
    }
    afterwards = scenario.updated({"robot.gravity": [1.0, 2.0, 9.0], "base_motion": rest}).updated(
        {"robot.gravity": [0.0, 0.0, 9.8]}
    )
    (line,) = (line for line in unlikely(afterwards) if "base_motion" in line)
    assert "their mean acceleration is (1, 2, -0.8) m/s^2" in line
    assert "forces that were read before robot.gravity was changed hold the difference" in line
    assert not np.any(scenario.updated({"base_motion": rest}).base_motion.samples)


def recorded(scenario: hs.Scenario, period: float, turns: Any, **keys: Any) -> list[str]:
    """Return what is noted of a base with these rotation vectors (n, 3) [rad], without accelerations."""
    attitudes = np.roll(Rotation.from_rotvec(turns).as_quat(), 1, axis=1)
    motion = {"kind": "recorded", "attitudes": attitudes, "samples": np.zeros((len(turns), 3)), "sample_period": period}
    found = unlikely(scenario.updated({"base_motion": {**motion, **keys}}))
    return [line for line in found if line.startswith("base_motion")]


def test_attitudes_with_few_digits() -> None:
    """A roll of 2 deg at 0.5 Hz turns with 0.34 rad/s^2 at most; four digits at 100 Hz leave sqrt(12) 1e-4/h^2 RMS."""
    scenario = hs.load_scenario("slow-camera").updated({"simulation.duration": 1.0})
    time = np.linspace(0.0, 1.0, 101)
    turns = np.radians(2.0) * np.sin(np.pi * time)[:, None] * np.array([1.0, 0.0, 0.0])
    assert recorded(scenario, 0.01, turns) == []
    q = np.roll(Rotation.from_rotvec(turns).as_quat(), 1, axis=1).round(4)
    (line,) = recorded(scenario, 0.01, turns, attitudes=q)
    found = re.search(r"angular acceleration is ([\d.]+) rad/s\^2 \(RMS\), and ([\d.]+) rad/s\^2 from every", line)
    assert found is not None
    assert float(found[1]) == pytest.approx(np.sqrt(12.0), rel=0.3)  # of 200 draws
    assert float(found[2]) < 0.6
    signs = np.where(np.arange(101) % 2, -1.0, 1.0)[:, None]  # a quaternion and its negative are one attitude
    assert recorded(scenario, 0.01, turns, attitudes=signs * q) == [line]


def test_a_base_that_turns_in_degrees() -> None:
    scenario = hs.load_scenario("slow-camera").updated({"simulation.duration": 1.0})
    time = np.linspace(0.0, 1.0, 101)[:, None]
    tilted, turned = (np.array(axis) for axis in ([0.9, 0.0, 0.0], [0.0, 0.0, 1.9]))
    (line,) = recorded(scenario, 0.01, time * tilted)
    assert "the base tilts by 0.9 rad (52 deg); check that angles and rates in the file are in radians" in line
    assert recorded(scenario, 0.01, time * turned) == []  # a vehicle may head anywhere
    (line,) = recorded(scenario, 0.01, time * turned * 1.1)
    assert "the base turns by up to 2.09 rad/s (120 deg/s)" in line


def test_recordings_that_do_not_fit_the_run() -> None:
    scenario = hs.load_scenario("slow-camera").updated({"simulation.duration": 2.0})
    for block, what in (("base_motion", "base rests"), ("target.motion", "target stays where it is")):

        def noted(count: int, period: float, block: str = block) -> list[str]:
            motion = {"kind": "recorded", "samples": np.zeros((count, 3)), "sample_period": period}
            return [line for line in unlikely(scenario.updated({block: motion})) if line.startswith(block)]

        assert noted(10, 0.2) == []
        (line,) = noted(9, 0.2)
        assert f"lasts 1.6 s, and simulation.duration is 2 s: the {what} in the rest of the run" in line
        (line,) = noted(20, 10.0)  # times in ms
        assert "10 s is more than a tenth of simulation.duration, 2 s; check that times in the file are in s" in line


def test_a_base_whose_motion_is_unseen() -> None:
    """Legs that follow whatever it takes, and a target that rides along, have one pose and image on any base."""
    scenario = hs.load_scenario("pi-h824-positions").updated({"simulation.duration": 0.2})
    shaken = scenario.updated({"base_motion": {"kind": "sinusoid", "amplitude": [1.0, 0.0, 0.0], "frequency": 2.0}})
    one, other = hs.simulate(scenario), hs.simulate(shaken)
    np.testing.assert_array_equal(one.position, other.position)
    np.testing.assert_array_equal(one.feature_error, other.feature_error)
    assert np.abs(one.leg_forces - other.leg_forces).max() > 0.1
    assert "only on the efforts of the legs" in only(shaken, "base_motion: has no effect on pose and image here")
    assert not any(line.startswith("base_motion") for line in unlikely(shaken.updated({"target.frame": "world"})))


def test_home_below_the_base_and_a_stroke_beyond_a_leg(paper: hs.Scenario) -> None:
    below = paper.updated({"robot.home_position": [0.0, 0.0, 0.15]})
    assert "puts home below the base" in only(below, "robot.home_position")
    for gravity in ([9.81, 0.0, 0.0], [0.0, 0.0, 0.0]):  # then z is not vertical
        assert not [
            text
            for text in unlikely_without_runs(below.updated({"robot.gravity": gravity}))
            if "below the base" in text
        ]
    shortest = float(np.min(_core.Hexapod(_core.robot_preset("micro")).home_lengths))
    assert only(paper.updated({"robot.stroke": 1.01 * shortest}), "robot.stroke").endswith("at home")
    assert not any(
        found.startswith("robot.stroke") for found in unlikely_without_runs(paper.updated({"robot.stroke": shortest}))
    )


def test_start_and_goal_are_in_the_image_by_half_its_sides(paper: hs.Scenario) -> None:
    sampled = paper.updated({"simulation.mode": "sampled", "simulation.step": 5e-4})
    start = 2 * max(map(abs, paper.target.initial_features or ()))
    goal = 2 * max(map(abs, paper.target.desired_features))
    assert start < goal
    inside = sampled.updated({"camera.image_size": [goal + 1] * 2})
    assert not any("outside the image" in sentence for sentence in unlikely_without_runs(inside))
    between = sampled.updated({"camera.image_size": [goal - 1] * 2})
    assert "the goal is outside the image" in only(between, "target.desired_features")
    assert not any("the start" in sentence for sentence in unlikely_without_runs(between))
    assert "(point 2)" in only(sampled.updated({"camera.image_size": [start - 1] * 2}), "target: the start is outside")


def test_a_goal_that_no_pose_shows(paper: hs.Scenario) -> None:
    crossed = paper.updated({"target.desired_features": [10, 10, -64, 29, 45, -73, -30, -23]})
    none, question = (words for words in unlikely_without_runs(crossed) if words.startswith("target.desired_features"))
    assert "no pose with these features was found" in none
    assert "with its points in the order 1 3 2 4, the goal would be within reach" in question


def test_the_fastest_rate_of_a_twist_on_legs_that_take_positions_is_its_gain() -> None:
    """The goal is home, so v* is -gain times the displacement in the directions that M leaves; `ki` has no effect."""
    at_goal = {"target.desired_pose": [0.0] * 6, "target.desired_features": None}
    scenario = hs.load_scenario("reachy-mini").updated({**at_goal, "controller.resolved_rate.gain": 3.0})
    assert fastest_rate(scene_of(scenario)) == pytest.approx(3.0, rel=1e-3)  # M leaves 1e-4 of a shift


def test_the_fastest_rate_of_pbvs_on_legs_that_take_positions_is_its_stiffness_over_its_damping() -> None:
    """Both gains times 100 are the same law of a platform without mass; a thousandth of the damping is ten a tick."""
    law = {"controller.law": "pbvs", "simulation.step": 0.001, "actuators.delay": 0.0}
    base = hs.load_scenario("pi-h824-positions").updated(law)
    gains = base.controller.gains
    kp, kd = np.asarray(gains.kp), np.asarray(gains.kd)
    own = fastest_rate(scene_of(base))
    assert own == pytest.approx(float((kp / kd).max()), rel=1e-3)  # M
    both = base.updated({"controller.pbvs": {"kp": 100.0 * kp, "kd": 100.0 * kd}})
    assert fastest_rate(scene_of(both)) == pytest.approx(own, rel=1e-9)
    np.testing.assert_allclose(hs.simulate(both).position, hs.simulate(base).position, atol=1e-9)
    stiff = base.updated({"controller.pbvs.kd": 1e-3 * kd})
    only(stiff, "simulation.step: a servo period of 1 ms is coarser")


@pytest.mark.parametrize("name", ["eye-to-hand", "noisy-camera"])
def test_joints_that_are_read_too_seldom_to_damp_the_loop_are_noted(name: str) -> None:
    """Without the sentence the run is that of readings at every tick; three times as far apart they end it."""
    scenario = hs.load_scenario(name)
    longest = 1e-3 * int(100.0 / fastest_rate(scene_of(scenario)))  # a tenth of the time constant, in whole ticks
    settled = float(hs.metrics(hs.simulate(scenario))["settling_time"])
    for period, noted in ((longest, False), (3.0 * longest, True)):
        seldom = scenario.updated({"sensors": {"pose": "encoders", "period": period}})
        assert any(words.startswith("sensors.period: one reading") for words in unlikely_without_runs(seldom)) == noted
        found = hs.metrics(hs.simulate(seldom))["settling_time"]
        assert np.isnan(found) if noted else found == pytest.approx(settled, rel=0.1)
    legs = hs.load_scenario("pi-h824-positions").updated({"controller.law": "composite", "sensors.period": 0.2})
    assert not [words for words in unlikely_without_runs(legs) if words.startswith("sensors.period: one reading")]


def test_the_fastest_rate_is_that_of_a_damper_by_hand(paper: hs.Scenario) -> None:
    """Kelly without stiffness: the poles are k_d/m and k_d/I of the actual plant, (1 - delta_D) of the estimate."""
    damped = {"controller.law": "kelly", "controller.kelly.kp": 0.0, "controller.kelly.kd": [0.5] * 3 + [1e-9] * 3}
    exact = {"uncertainty.inertia": 0.075}
    scene = scene_of(paper.updated({**damped, **exact}))
    assert fastest_rate(scene) == pytest.approx(0.5 / (0.925 * paper.robot.mass), rel=1e-3)
    limit = 0.2 / float(f"{fastest_rate(scene):.4g}")  # a fifth of the time constant, since kelly damps
    for factor, warned in ((0.9, False), (1.1, True)):
        steps = {"simulation.step": factor * limit, "simulation.duration": 100 * factor * limit}
        scenario = paper.updated({**damped, **exact, **steps, "simulation.mode": "sampled"})
        assert any(sentence.startswith("simulation.step") for sentence in unlikely_without_runs(scenario)) == warned
        continuous = scenario.updated({"simulation.mode": "continuous"})  # there a step is no servo period
        assert not any(sentence.startswith("simulation.step") for sentence in unlikely_without_runs(continuous))


def test_a_slope_of_the_switching_term_counts(paper: hs.Scenario) -> None:
    """K_v / width is a damping: 2e-3 N over 1e-6 m/s is 2000 N s/m."""
    steep = paper.updated({"controller.switching": {"kind": "tanh", "width": 1e-6}})
    rate = fastest_rate(scene_of(steep))
    assert rate > 0.5 * 2e-3 / 1e-6 / paper.robot.mass
    assert fastest_rate(scene_of(paper)) < 1e-2 * rate
    assert math.isfinite(rate)


def test_motors_that_do_not_overcome_their_friction() -> None:
    """0.1 N m of friction and 0.021 N m of weight: with a limit of 0.11 the head does not arrive, with 0.13 it does."""
    head = hs.load_scenario("reachy-mini-motors")
    start = "robot.force_limit: 0.11 N m does not move leg 6 against actuators.motor.friction and the platform's weight"
    for limit, arrives in ((0.11, False), (0.13, True)):
        scenario = head.updated({"robot.force_limit": limit})
        assert (hs.metrics(hs.simulate(scenario))["final_error"] < head.metrics.band) == arrives
        assert any(line.startswith(start) for line in unlikely_without_runs(scenario)) != arrives


@pytest.mark.parametrize(
    ("name", "friction", "legs"), [("paper", None, 0.133667), ("reachy-mini-motors", 0.5, 0.521034)]
)
def test_a_force_limit_and_what_exceeds_it_are_two_numbers(name: str, friction: float | None, legs: float) -> None:
    """A limit that is just too small is written with the digits that tell it from what the legs need."""
    scenario = hs.load_scenario(name)
    if friction is not None:
        scenario = scenario.updated({"actuators.motor.friction": friction})
    scene = scene_of(scenario)
    needed = float(np.abs(scene.resting_forces(scene.home)).max()) + (friction or 0.0)
    assert needed == pytest.approx(legs, rel=1e-4)
    for share in (0.999, 0.99999):
        line = next(
            each
            for each in unlikely_without_runs(scenario.updated({"robot.force_limit": share * needed}))
            if "limit" in each
        )
        limit, takes = (float(number) for number in re.findall(r"([\d.]+) N", line))
        assert limit < takes, line
        assert limit == pytest.approx(share * needed, rel=0.5 * (1.0 - share))
        assert takes == pytest.approx(needed, rel=0.5 * (1.0 - share))


def test_what_the_law_needs_and_what_a_leg_has_are_two_numbers() -> None:
    paper = hs.load_scenario("paper")
    needed = float(start_forces(scene_of(paper)).needed.max())
    line = next(
        each
        for each in unlikely_without_runs(paper.updated({"robot.force_limit": 0.99999 * needed}))
        if "at the start" in each
    )
    takes, has = (float(number) for number in re.findall(r"([\d.]+) mN", line))
    assert has < takes, line
    assert takes == pytest.approx(1e3 * needed, rel=2e-5)


@pytest.mark.parametrize(
    ("name", "key", "silent", "warned"),
    [
        ("paper", "actuators.quantisation", 0.26, 0.28),  # [N]; 0.134 N in a leg at rest
        ("reachy-mini-motors", "actuators.motor.quantisation", 0.75, 0.8),  # [rad]; the stroke is 0.77 rad
        ("reachy-mini-motors", "actuators.motor.kp", 0.14, 0.12),  # [N m/rad]; 0.1 N m over the stroke is 0.13
    ],
)
def test_drives_that_have_nothing_to_act_with(name: str, key: str, silent: float, warned: float) -> None:
    """Rounded to 0, to one place, or held by friction: beyond, the legs do not move as they are commanded to."""
    scenario = hs.load_scenario(name).updated({"simulation.mode": "sampled"})
    for value, is_warned in ((silent, False), (warned, True)):
        found = unlikely_without_runs(scenario.updated({key: value}))
        assert any(line.startswith(f"{key}: ") for line in found) == is_warned
    held = hs.simulate(scenario.updated({key: warned}))
    moves = hs.simulate(scenario)
    assert hs.metrics(held)["final_error"] > 10.0 * hs.metrics(moves)["final_error"]


def test_noise_that_the_filter_takes_for_a_jump() -> None:
    """Six numbers are beyond what six deviations allow, 50.2, in one of 2600 frames: chi-square/r^2 of 24.9, r of 1.42.

    As seldom as three deviations of one number are noise as assumed: 1 in 600 frames.
    """
    takes = {"controller.law": "tracking", "camera.prediction": "none", "actuators.kind": "position"}
    head = hs.load_scenario("reachy-mini-head").updated(takes)
    start = "controller.tracking.noise"
    assumed = head.controller.tracking.noise
    assert "readings of the joints" in only(head.updated({"camera.noise": 1.42 * assumed}), start)
    exact = {"camera.noise": 1.42 * assumed, "sensors.resolution": 0.0}
    assert not any(line.startswith(start) for line in unlikely_without_runs(head.updated(exact)))
    assert "set it to 0.715" in only(head.updated({"camera.noise": 1.43 * assumed}), start)
    rounded = {"camera.noise": 0.0, "camera.quantisation": 1.43 * assumed * math.sqrt(12.0)}  # as much
    assert "set it to 0.715" in only(head.updated(rounded), start)
    perfect = {"camera.noise": 0.0, "camera.quantisation": 0.0, "sensors.resolution": 0.0}
    assert not any(line.startswith(start) for line in unlikely_without_runs(head.updated(perfect)))
    jump = "controller.tracking.jump"
    as_assumed = {"camera.noise": assumed, jump: 3.0}
    assert "beyond 3 deviations up to once in 610 frames" in only(head.updated(as_assumed), jump)
    assert not any(line.startswith(jump) for line in unlikely_without_runs(head.updated({**as_assumed, jump: 4.0})))
    both = {"camera.noise": 1.01 * assumed, jump: 3.0}  # more noise assumed would not end it
    assert "beyond 3 deviations up to once in 610 frames" in only(head.updated(both), jump)
    assert "at nearly every frame" in only(head.updated({"camera.noise": 100.0 * assumed}), start)
    known = {"camera.noise": 1.1, start: 1.1}
    assert not any(line.startswith(start) for line in unlikely_without_runs(head.updated(known)))


def swapped(joints: Any, one: int, other: int) -> list[list[float]]:
    rows = np.array(joints)
    rows[[one, other]] = rows[[other, one]]
    return [[float(value) for value in row] for row in rows]


def test_legs_that_cross_at_home(paper: hs.Scenario) -> None:
    """Two legs of a pair with their feet exchanged lie in one plane; legs that share a joint do not cross."""
    hexapod = _core.Hexapod(_core.robot_preset("micro"))
    crossed = paper.updated({"robot.base_joints": swapped(hexapod.base_joints, 0, 1)})
    assert only(crossed, "robot: legs").startswith("robot: legs 1 and 2 cross at home; are the joints")
    assert any(line.startswith("robot: legs") for line in unlikely_without_runs(rotary_with_feet_exchanged()))
    joints = np.array(hexapod.base_joints)
    joints[[1, 3, 5]] = joints[[0, 2, 4]]
    shared = paper.updated({"robot.base_joints": joints.tolist()})
    assert not any(line.startswith("robot: legs") for line in unlikely_without_runs(shared))


def rotary_with_feet_exchanged() -> hs.Scenario:
    """A machine with cranks whose first two platform joints are those of each other's leg."""
    robot = rotary_machine.machine().robot
    assert robot.platform_joints is not None
    return rotary_machine.machine({"robot.platform_joints": swapped(robot.platform_joints, 0, 1)})


def test_a_focal_length_that_is_not_in_pixels() -> None:
    """1280 x 1024 px, whose diagonal is 1639 px: 120 degrees with 473 px, since tan 60 degrees is 1.73."""
    machine = hs.load_scenario("pi-h824")
    start = "camera.focal_pixels: 35 px sees 175 degrees"
    assert "the focal length divided by the pixel pitch" in only(machine.updated({"camera.focal_pixels": 35.0}), start)
    for focal, wide in ((472.0, True), (475.0, False)):
        found = [
            line
            for line in unlikely_without_runs(machine.updated({"camera.focal_pixels": focal}))
            if "degrees across" in line
        ]
        assert bool(found) is wide


def in_millimetres(robot: Robot) -> dict[str, Any]:
    lengths = ("platform_radius", "base_radius", "stroke")
    return {
        **{f"robot.{name}": 1e3 * getattr(robot, name) for name in lengths},
        "robot.home_position": [1e3 * z for z in robot.home_position],
    }


def test_lengths_of_a_machine_that_are_not_metres() -> None:
    """A machine in mm: by hand, sqrt(0.03 kg m^2 / 5 kg) = 77.5 mm, as of the machine in metres."""
    machine = hs.load_scenario("pi-h824")
    assert machine.target.points is not None
    points = [[1e3 * x for x in point] for point in machine.target.points]
    large = machine.updated({**in_millimetres(machine.robot), "target.points": points})
    assert only(large, "robot: joints 131 m from the middle, with home 159 m from the base").endswith(
        "lengths are in metres: in mm these would be 131 mm and 159 mm"
    )
    assert "a radius of gyration of 77.5 mm, less than 0.5% of the platform's radius, 100 m" in only(
        large, "robot.inertia: 0.03 kg m^2 with 5 kg is"
    )


def test_an_inertia_in_square_millimetres_is_named(paper: hs.Scenario) -> None:
    """By hand: sqrt(300 kg m^2 / 0.06 kg) = 70.7 m; ten times the radius of 0.1 m are at 0.06 kg m^2."""
    found = only(paper.updated({"robot.inertia": [150.0, 150.0, 300.0]}), "robot.inertia: 300 kg m^2 with 0.06 kg is")
    assert "of 70.7 m, more than 10 times the platform's radius, 100 mm" in found
    assert found.endswith("from kg mm^2 it would be 0.0003 kg m^2")
    for moment, warned in ((0.0599, False), (0.0601, True)):
        sentences = unlikely_without_runs(paper.updated({"robot.inertia": [moment] * 3}))
        assert any("radius of gyration" in text for text in sentences) is warned


def test_what_is_known_of_a_payload_counts_to_the_inertia(paper: hs.Scenario) -> None:
    light = paper.updated({"robot.inertia": [1e-9] * 3, "robot.payload.mass": 0.5})
    for known, together in (
        (True, f"{paper.robot.mass + 0.5:.3g} kg, of platform and payload, is a radius"),
        (False, f"{paper.robot.mass:.3g} kg is a radius"),
    ):
        found = unlikely_without_runs(light.updated({"robot.payload.known": known}))
        (line,) = (line for line in found if line.startswith("robot.inertia"))
        assert together in line


def test_a_home_that_is_not_in_metres(paper: hs.Scenario) -> None:
    """The joints of the base are 0.2 m from its middle, and 20 times that is 4 m."""
    far = "robot.home_position: 150 m from the base is more than 20 times the 200 mm from the middle to the joints"
    assert only(at_height(paper, 150.0), far).endswith("in mm it would be 150 mm")
    for height, found in ((3.9, False), (4.1, True)):
        lines = [
            line for line in unlikely_without_runs(at_height(paper, height)) if line.startswith("robot.home_position")
        ]
        assert bool(lines) is found


@pytest.mark.parametrize(("size", "named"), [(1e-3, "robot: joints 200 um from"), (2e-2, "robot.home_position: 150")])
def test_joints_a_thousand_times_too_small_are_named_in_place_of_home(
    paper: hs.Scenario, size: float, named: str
) -> None:
    """The joints of the base are 0.2 m from its middle: below 2 mm no machine with its home has them."""
    small = {f"robot.{name}": size * getattr(paper.robot, name) for name in ("platform_radius", "base_radius")}
    assert only(paper.updated(small), "robot: joints" if size < 1e-2 else "robot.home").startswith(named)


def at_height(scenario: hs.Scenario, height: float) -> hs.Scenario:
    return scenario.updated({"robot.home_position": [0.0, 0.0, -height]})


@pytest.mark.parametrize(
    ("key", "wrong", "words", "largest"),
    [
        ("rotation", 1.0, "1 rad is an error of 57.3 degrees; rotations are in rad: 1 degree is 0.0175 rad", 0.2),
        ("position", 5.0, "5 m is more than the 131 mm from the middle to the joints; lengths are in metres", 0.13),
    ],
)
def test_an_error_of_the_mount_in_degrees_or_millimetres(key: str, wrong: float, words: str, largest: float) -> None:
    machine = hs.load_scenario("pi-h824")
    name = f"uncertainty.mount.{key}"
    assert words in only(machine.updated({name: [0.0, wrong, 0.0]}), name)
    assert not any(
        line.startswith(name) for line in unlikely_without_runs(machine.updated({name: [0.0, 0.0, largest]}))
    )


def test_a_start_within_the_settling_band(paper: hs.Scenario) -> None:
    """Such a run passes without a motion; where something moves or the weight is wrong, staying is a result."""
    goal = paper.to_mapping()["target"]["desired_features"]
    near = paper.updated({"target.initial_features": [feature + 0.09 for feature in goal]})
    sentence = only(near, "metrics.band: the start is within 2 px")
    assert "(0.09 px), so that a run that stays there counts as settled" in sentence
    diagnosis = hs.diagnose(hs.simulate(near.updated({"simulation.duration": 0.5})))
    assert diagnosis.failed is False
    assert diagnosis.section().verdict == "warning"
    assert "0.09 px of 2 px from the goal, and so passes without a motion" in diagnosis.section().sentences[0]
    for change in (
        {"metrics.band": 0.08},
        {"uncertainty.gravity": 0.075},
        {"robot.payload": {"mass": 0.01, "known": False}},
        {"simulation.mode": "sampled", "base_motion.kind": "sinusoid", "base_motion.amplitude": [0.1] * 3},
    ):
        assert not any(line.startswith("metrics.band") for line in unlikely(near.updated(change)))


def test_a_load_that_the_controller_does_not_know(paper: hs.Scenario) -> None:
    for mass, known, large in ((0.21, False, True), (0.19, False, False), (0.21, True, False)):
        load = {"mass": mass * paper.robot.mass, "known": known}
        found = [
            line
            for line in unlikely_without_runs(paper.updated({"robot.payload": load}))
            if line.startswith("robot.payload")
        ]
        assert bool(found) is large


def test_legs_that_follow_whatever_it_takes_feel_no_load() -> None:
    load = {"robot.payload": {"mass": 5.0, "known": False}}
    positions = hs.load_scenario("pi-h824-positions")
    assert not [line for line in unlikely_without_runs(positions.updated(load)) if line.startswith("robot.payload")]
    (sentence,) = [
        line for line in unlikely_without_runs(hs.load_scenario("pi-h824").updated(load)) if "payload" in line
    ]
    assert "a load of 5 kg" in sentence
    weightless = hs.load_scenario("paper").updated(
        {"robot.gravity": [0.0, 0.0, 0.0], "robot.payload": load["robot.payload"]}
    )
    assert not [line for line in unlikely_without_runs(weightless) if line.startswith("robot.payload")]


def test_limits_that_are_looked_at_once(paper: hs.Scenario) -> None:
    """It is legal, since controllers and analyses of the same scenario have shorter runs."""
    once = paper.updated({"robot.limits_every": 5001})
    assert "is more than the 5000 steps of the run" in only(once, "robot.limits_every")
    assert not unlikely(paper.updated({"robot.limits_every": 5000}))
    assert hs.Controller(once).period == paper.simulation.step


@pytest.mark.parametrize("law", _core.LAW_TRAITS)
def test_a_start_elsewhere_is_checked_with_every_law(paper: hs.Scenario, law: str) -> None:
    changes = {"controller.law": law, "simulation.start.pose": [0.001, 0.0, 5e-4, 0.01, 0.0, 0.01]}
    machine = hs.load_scenario("pi-h824-positions") if law not in LAWS else paper
    assert all(isinstance(sentence, str) for sentence in unlikely(machine.updated(changes)))


@pytest.mark.parametrize(("name", "depth"), [("noisy-camera", 1e-300), ("paper", 1e300)])
def test_a_check_that_overflows_has_a_sentence(name: str, depth: float) -> None:
    found = unlikely(hs.load_scenario(name).updated({"target.depth": depth}))
    assert any("a check cannot be evaluated, since numbers overflow" in line for line in found)


# A tilt of 0.035 rad before a target 3 m away, which a shift of 0.1 m shows nearly as well.
TILTED = {"target.tag.pose": [0.0, 0.0, -3.0, 0.0, 0.0, 0.0], "target.desired_pose": [0.0, 0.0, 0.0, 0.035, 0.0, 0.0]}


@pytest.mark.parametrize("law", ["composite", "computed_torque"])
def test_a_prior_that_first_moves_the_legs_out_of_reach(law: str) -> None:
    """Half of the tilt becomes a shift of theta z/2, as in a run; with M of shifts 10 times as large, theta z/11."""
    calm = {"camera.noise": 0.0, "controller.law": law, f"controller.{law}.auto.bandwidth": 2.0}
    tilted = hs.load_scenario("pi-h824", {**TILTED, **calm})
    sentence = only(tilted, f"controller.{law}.prior: the law first goes to a pose")
    goes, beyond = (float(sentence.split(end)[0].split()[-1]) for end in (" m and", " mm beyond its stroke"))
    assert goes == pytest.approx(0.035 * scene_of(tilted).depth / 2.0, rel=0.02)
    found = hs.metrics(hs.simulate(tilted))
    assert found["peak_displacement"] == pytest.approx(goes, rel=0.1)
    assert found["peak_leg_excursion"] - tilted.robot.stroke == pytest.approx(1e-3 * beyond, rel=0.1)
    prior = np.array(getattr(tilted.controller, law).prior)
    firm = tilted.updated({f"controller.{law}.prior": (prior * np.repeat([10.0, 1.0], 3)).tolist()})
    assert not any("first goes to" in line for line in unlikely_without_runs(firm))
    assert hs.metrics(hs.simulate(firm))["peak_leg_excursion"] < firm.robot.stroke


def test_a_prior_that_pulls_a_run_off_its_goal(paper: hs.Scenario) -> None:
    """A start on the goal, 8 mm from home: the run goes to where the note has it."""
    still = {"controller.law": "composite", "uncertainty.depth": 0.0, "uncertainty.gravity": 0.0}
    away = paper.updated({**still, "simulation.start.pose": [0.008, 0.0, 0.0, 0.0, 0.0, 0.0]})
    scene = scene_of(away)
    on_goal = away.updated({"target.desired_features": scene.view(scene.start).features.tolist()})
    sentence = only(on_goal, "controller.composite.prior: the start is nearer to the goal image")
    pixels, shift = (float(sentence.split(end)[0].split()[-1]) for end in (" px and", " mm and"))
    found = hs.metrics(hs.simulate(on_goal.updated({"simulation.duration": 10.0})))
    assert found["final_error"] == pytest.approx(pixels, rel=0.15)
    assert found["peak_displacement"] == pytest.approx(1e-3 * shift, rel=0.15)
    for other in (away, on_goal.updated({"simulation.start.pose": [0.0] * 6})):
        assert not any("the start is nearer" in line for line in unlikely_without_runs(other))
    fitted = on_goal.updated({"controller.composite.auto.bandwidth": 5.0})
    assert "px and" in only(fitted, "controller.composite.prior")


def test_a_damped_inverse_that_first_moves_the_legs_out_of_reach() -> None:
    """With the numbers of the prior as its damping, and none without it."""
    prior = hs.load_scenario("pi-h824", TILTED).controller.composite.prior
    rate = {"controller.law": "resolved_rate", "controller.resolved_rate.auto.bandwidth": 2.0}
    damped = hs.load_scenario("pi-h824", {**TILTED, **rate, "controller.resolved_rate.damping": prior})
    assert "a smaller damping" in only(damped, "controller.resolved_rate.damping: the law first goes")
    undamped = damped.updated({"controller.resolved_rate.damping": 0.0})
    assert not any("first goes to" in line for line in unlikely_without_runs(undamped))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("name", "changes", "reason"),
    [
        ("paper", {"controller.hybrid.kp": 1e300}, "finite poles"),
        ("reachy-mini", {"controller.resolved_rate.gain": 1e300}, "finite poles"),  # beside it no twist counts
        ("pi-h824", {"controller.composite.kp": 1e308}, "a finite wrench at the start"),
    ],
)
def test_gains_with_which_the_loop_overflows(name: str, changes: dict[str, Any], reason: str) -> None:
    scenario = hs.load_scenario(name, changes)
    law = scenario.controller.law
    assert f"cannot be evaluated, since numbers overflow (controller: expected gains that give {reason}" in only(
        scenario, f"controller.{law}: the gains' bandwidth"
    )
    with pytest.raises(NotFiniteError):
        fastest_rate(scene_of(scenario))


@pytest.mark.parametrize("period", [_core.LONGEST_SERVO_PERIOD, np.nextafter(_core.LONGEST_SERVO_PERIOD, 2.0)])
def test_a_servo_period_that_no_controller_takes_is_no_overflow(paper: hs.Scenario, period: float) -> None:
    """The bound is that of the core."""
    slow = paper.updated(
        {
            "simulation.mode": "sampled",
            "controller.switching.kind": "implicit",
            "simulation.step": period,
            "simulation.duration": 100.0 * period,
        }
    )
    found = unlikely(slow)
    assert not any("overflow" in line for line in found)
    assert any("hs.Controller and exports refuse the scenario" in line for line in found) == (period > 1.0)
    if period > _core.LONGEST_SERVO_PERIOD:
        with pytest.raises(ValueError, match="period: expected a time above 0 and up to 1 s"):
            hs.Controller(slow)
    else:
        assert hs.Controller(slow).period == period


# ---- Keys without effect --------------------------------------------------------------------------------------------


def test_a_preset_without_effect_is_noted(paper: hs.Scenario) -> None:
    """Its name alone was changed in a resolved file: every value of the machine is that of the other preset."""
    keys = paper.to_mapping()
    assert keys["robot"]["preset"] == "micro"
    for preset in ("cubic", "pi_h824", "reachy_mini"):
        changed = hs.Scenario.from_mapping({**keys, "robot": {**keys["robot"], "preset": preset}})
        assert changed.robot.mass == paper.robot.mass
        assert sum(f'robot.preset: "{preset}" has no effect here' in note for note in keys_without_effect(changed)) == 1
        assert not any("robot.preset" in note for note in keys_without_effect(paper.updated({"robot.preset": preset})))
    for name in hs.scenario_names():
        assert not any("robot.preset" in note for note in keys_without_effect(hs.load_scenario(name)))


RATE = "controller.resolved_rate"
ADAPTIVE = {f"{RATE}.adaptive": True}
RATE_GAIN = core_default(f"{RATE}.gain")
BRIDGED = {"camera.prediction": "encoder", "camera.latency": 0.02, "camera.gate": 50.0, "camera.timeout": 0.1}
POSITIONS = {
    "simulation.mode": "sampled",
    "actuators.kind": "position",
    "camera.noise": 0.01,
    "controller.tracking.noise": 0.01,
    "target.motion": {"kind": "velocity", "velocity": [0.3, 0.0, 0.0]},
}
WITHOUT_EFFECT: list[tuple[dict[str, Any], dict[str, Any]]] = [
    ({"controller.law": "composite"}, {"controller.hybrid.kp": 2e-6}),
    ({}, {"controller.composite.fuzzy.leakage": 0.1}),
    ({}, {"controller.kelly.kd": 1.0, "controller.pbvs.kp": 1.0}),
    ({"controller.hybrid.fuzzy.enabled": False}, {"controller.hybrid.fuzzy.adaptation": 20.0}),
    ({"controller.law": "kelly"}, {"controller.hybrid.fuzzy.enabled": False}),
    ({"controller.law": "resolved_rate"}, {"controller.resolved_rate.gain_far": 2.0}),
    ({"controller.law": "resolved_rate", **ADAPTIVE, f"{RATE}.gain_slope": 0.0}, {f"{RATE}.gain_far": 1.0}),
    ({"controller.law": "resolved_rate", **ADAPTIVE, f"{RATE}.gain_far": RATE_GAIN}, {f"{RATE}.gain_slope": 3.0}),
    (
        {"controller.law": "composite", "controller.composite.fuzzy.enabled": False},
        {"controller.composite.drive": 9.0, "controller.composite.fuzzy.leakage": 0.1},
    ),
    ({}, {"controller.hybrid.fuzzy.table": np.full((7, 7), 0.5).tolist()}),
    ({"controller.law": "pbvs"}, {"controller.jacobian": "printed"}),
    ({"controller.law": "pbvs", "simulation.mode": "sampled", **BRIDGED}, {"controller.jacobian": "printed"}),
    ({"controller.law": "tracking", **POSITIONS}, {"controller.jacobian": "printed"}),
    ({"controller.law": "tracking", **POSITIONS}, {"controller.tracking.band": 1e-5}),
    ({"controller.law": "kelly"}, {"controller.switching.kind": "tanh"}),
    ({}, {"controller.switching.width": 0.01}),
    ({"simulation.mode": "sampled"}, {"camera.outlier_size": 5.0}),
    ({"simulation.mode": "sampled"}, {"camera.outlier_probability": 0.5}),
    ({"simulation.mode": "sampled"}, {"camera.on_lost": "predict"}),
    ({"simulation.mode": "sampled"}, {"camera.gate": 5.0}),
    ({"simulation.mode": "sampled"}, {"camera.gate": 5.0, "camera.on_lost": "stop"}),
    (
        {"simulation.mode": "sampled", "actuators.kind": "position_torque", "simulation.substeps": 10},
        {"actuators.position.bandwidth": 2.0, "actuators.position.damping": 0.3},
    ),
    ({"simulation.mode": "sampled"}, {"sensors.noise": 1e-5, "sensors.period": 0.002, "sensors.rate": True}),
    ({"simulation.mode": "sampled"}, {"sensors.resolution": 1e-5}),
    ({"simulation.mode": "sampled"}, {"base_motion.amplitude": [1.0, 0.0, 0.0], "base_motion.frequency": 3.0}),
    ({"simulation.mode": "sampled"}, {"base_motion.level": 1.0, "base_motion.high_frequency": 20.0}),
    ({"simulation.mode": "sampled"}, {"base_motion.rotation.amplitude": [0.1, 0.0, 0.0], "target.frame": "world"}),
    ({"simulation.mode": "sampled"}, {"base_motion.rotation.level": 1.0, "base_motion.road.speed": 20.0}),
    ({"simulation.mode": "sampled"}, {"target.motion.velocity": [0.1, 0.0, 0.0], "target.motion.frequency": 3.0}),
]


@pytest.mark.parametrize(("base", "idle"), WITHOUT_EFFECT)
def test_keys_that_are_noted_change_no_run(paper: hs.Scenario, base: dict[str, Any], idle: dict[str, Any]) -> None:
    scenario = paper.updated({**base, "simulation.duration": 0.05})
    assert keys_without_effect(scenario) == []
    changed = scenario.updated(idle)
    noted = keys_without_effect(changed)
    assert sorted(key for sentence in noted for key in sentence.partition(":")[0].split(", ")) == sorted(idle)
    assert all("no effect here; " in sentence for sentence in noted)
    assert fingerprint(changed) == fingerprint(scenario)


def test_what_keys_need_of_others_is_what_their_conditions_check(paper: hs.Scenario) -> None:
    needs = settings_needed()
    assert needs["controller.switching.width"] == {
        "controller.law": laws_with("switching"),
        "controller.switching.kind": ("tanh", "saturation"),
    }
    enabled = "controller.hybrid.fuzzy.enabled"
    assert needs["controller.hybrid.fuzzy.adaptation"] == {"controller.law": ("hybrid",), enabled: (True,)}
    assert needs[enabled] == {"controller.law": ("hybrid",)}
    assert needs["target.motion.velocity"] == {"target.motion.kind": ("velocity",)}
    assert not {"controller.law", "camera.outlier_size"} & set(needs)
    for scenario in (paper, paper.updated({enabled: False})):
        unmet = {
            key for key, each in needs.items() if any(value_at(scenario, other) not in each[other] for other in each)
        }
        assert all(needed_by(key, [scenario]) for key in unmet)
        assert not any(needed_by(key, [scenario]) for key in ("controller.switching.kind", "controller.jacobian"))


def test_keys_whose_condition_is_met_are_not_noted_and_change_the_run(paper: hs.Scenario) -> None:
    """Each of the keys above whose condition is met by a setting beside it: the note would be wrong."""
    table = {"controller.hybrid.fuzzy.table": np.full((7, 7), 0.5).tolist()}
    met: list[tuple[dict[str, Any], dict[str, Any]]] = [
        ({"controller.law": "composite"}, {"controller.composite.drive": 9.0}),
        ({"controller.hybrid.fuzzy.initial_scale": [0, 0, 0, 0, 0, 1e-4]}, table),
        ({"controller.law": "resolved_rate", **ADAPTIVE}, {f"{RATE}.gain_far": 1.0, f"{RATE}.gain_slope": 3.0}),
        *(({"controller.law": law}, {"controller.jacobian": "printed"}) for law in laws_with("depth")),
        (
            {"controller.law": "tracking", **POSITIONS, "controller.tracking.integral": 5.0},
            {"controller.tracking.band": 1e-6},
        ),
        (
            {"controller.law": "tracking", **POSITIONS},
            {"controller.tracking.acceleration": [0.5, 0.5, 0.5, 9.0, 9.0, 9.0]},
        ),
    ]
    for base, acting in met:
        scenario = paper.updated({**base, "simulation.duration": 0.05})
        changed = scenario.updated(acting)
        assert keys_without_effect(changed) == []
        if "controller.tracking.band" not in acting:  # which acts where legs come to rest
            assert fingerprint(changed) != fingerprint(scenario), acting


def test_a_direction_is_followed_by_the_last_three_numbers_of_no_filter(paper: hs.Scenario) -> None:
    """One number is written for the first three too, and gains that `auto` fits are not written."""
    direction = {"controller.law": "tracking", "controller.tracking.follow": "direction", **POSITIONS}
    scenario = paper.updated({**direction, "simulation.duration": 0.05})
    written = {f"controller.tracking.{key}": [0.7, 0.7, 0.7, 9.0, 9.0, 9.0] for key in ("acceleration", "speed")}
    shorter = scenario.updated({key: [*values[:3], 1.0, 1.0, 1.0] for key, values in written.items()})
    changed = scenario.updated(written)
    assert keys_without_effect(changed) == [
        "controller.tracking.acceleration, controller.tracking.speed: the last 3 numbers have no effect here; they act "
        "only with controller.tracking.follow: pose"
    ]
    assert fingerprint(changed) == fingerprint(shorter) != fingerprint(scenario)
    for change in ({"controller.tracking.acceleration": 0.7}, {"controller.tracking.auto.bandwidth": 2.0}):
        assert keys_without_effect(scenario.updated(change)) == []


def test_fitted_gains_without_effect_are_not_noted_but_written_ones_are(paper: hs.Scenario) -> None:
    fitted = paper.updated({"controller.law": "composite", "controller.composite.auto.bandwidth": 4.0})
    idle = fitted.updated({"controller.composite.fuzzy.enabled": False})
    assert idle.controller.composite.drive != paper.controller.composite.drive
    assert keys_without_effect(idle) == []
    (sentence,) = keys_without_effect(idle.updated({"controller.composite.drive": 9.0}))
    assert sentence == (
        "controller.composite.drive: has no effect here; it acts only with controller.composite.fuzzy.enabled: true"
    )
    acting = ("kp", "kv", "kt", "kd", "prior")
    given = idle.updated({f"controller.composite.{key}": 1.0 for key in acting})  # what is fitted idles
    (sentence,) = keys_without_effect(given)
    assert sentence.startswith("controller.composite.auto.bandwidth: has no effect here")


def test_a_damping_that_fits_no_gain_is_noted() -> None:
    scenario = hs.load_scenario("pi-h824-positions")
    assert keys_without_effect(scenario) == []
    changed = scenario.updated({"controller.tracking.auto.damping": 0.5})
    assert keys_without_effect(changed) == [
        "controller.tracking.auto.damping: has no effect here; it acts only in the blocks of other laws, since the "
        "motion of tracking is critically damped"
    ]
    assert gains_written(changed) == gains_written(scenario)


def test_switching_axis_by_axis_is_noted_where_the_inertia_couples_the_axes(paper: hs.Scenario) -> None:
    """v+ = (1 - D^-1 diag D) v; of principal moments 1:r that are turned by 45 degrees the factor is (r - 1)/2."""
    start = "controller.switching.kind: implicit stops axis by axis"
    coupled = hs.load_scenario("rubin-camera-hexapod")
    axiswise = coupled.updated({"controller.switching.kind": "implicit"})
    (sentence,) = (words for words in unlikely_without_runs(axiswise) if words.startswith(start))
    assert "changes by 5.4" in sentence
    assert not any(words.startswith(start) for words in unlikely_without_runs(coupled))
    assert not any(
        words.startswith(start) for words in unlikely_without_runs(axiswise.updated({"controller.composite.kv": 0.0}))
    )
    sampled = paper.updated({"simulation.mode": "sampled", "controller.switching.kind": "implicit"})
    for ratio, noted in ((2.5, False), (3.5, True)):
        mean, product = 0.5e-4 * (ratio + 1.0), 0.5e-4 * (ratio - 1.0)
        inertia = [[mean, 0.0, product], [0.0, 2.0 * mean, 0.0], [product, 0.0, mean]]
        tilted = sampled.updated({"robot.inertia": inertia})
        assert any(words.startswith(start) for words in unlikely_without_runs(tilted)) == noted


@pytest.mark.parametrize(
    ("auto", "written", "words"),
    [
        (1.0, 30.0, "controller.tracking.bandwidth: 30 Hz is above 12.5 Hz"),
        (1.0, 0.005, "controller.tracking.bandwidth: 0.005 Hz is below 0.0"),
        (30.0, 1.0, None),
        (30.0, None, "controller.tracking.auto.bandwidth: 30 Hz is above 12.5 Hz"),
    ],
)
def test_a_written_bandwidth_is_judged_in_place_of_the_fitted_one(
    auto: float, written: float | None, words: str | None
) -> None:
    """The other keys that `auto` fills in, those of the target's motion, still follow it."""
    scenario = hs.load_scenario("pi-h824-positions").updated({"controller.tracking.auto.bandwidth": auto})
    if written is not None:
        scenario = scenario.updated({"controller.tracking.bandwidth": written})
    found = [
        words for words in unlikely_without_runs(scenario) if words.startswith("controller.") and "bandwidth" in words
    ]
    assert [sentence.startswith(words or "none") for sentence in found] == ([True] if words else [])


def test_written_gains_of_a_law_are_judged_without_the_fitted_bandwidth() -> None:
    """`pbvs` of 1 Hz whose kp and kd are written: only its prior still follows."""
    slow = hs.load_scenario("pi-h824-positions").updated(
        {"controller": {"law": "pbvs", "pbvs": {"auto": {"bandwidth": 1.0}}}}
    )
    own = gains_written(slow)
    kept = {key: own[key] for key in ("controller.pbvs.kp", "controller.pbvs.kd")}
    both = slow.updated({**kept, "controller.pbvs.auto.bandwidth": 30.0})
    assert not [sentence for sentence in unlikely_without_runs(both) if "30 Hz" in sentence]
    assert [
        sentence
        for sentence in unlikely_without_runs(slow.updated({"controller.pbvs.auto.bandwidth": 30.0}))
        if "30 Hz" in sentence
    ]
