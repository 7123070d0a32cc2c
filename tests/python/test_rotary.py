"""Rotary legs: kinematics, rates and torques, both singularities, reach, loops and units.

The core is compared with the triangle of each crank (`rotary_machine`), with finite differences, with statics of the
rods, with MuJoCo's closed chains (test_rotary_mujoco.py) and with Pinocchio.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo import _core
from hexservo.cli.output import write_results
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.analysis.workspace import reach
from hexservo.findings.check import unlikely
from hexservo.run.export import gains_header
from hexservo.scenario.leg_units import stroke_length
from rotary_machine import (
    AXES,
    BRANCH,
    CENTRES,
    CRANK,
    HOME,
    JOINTS,
    ROD,
    UPRIGHT,
    ZERO,
    angles,
    hexapod,
    machine,
    quaternion,
    random_pose,
    robot,
    rods,
)
from without_runs import unlikely_without_runs

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def legs() -> _core.Hexapod:
    return hexapod()


@pytest.fixture(scope="module")
def head() -> hs.Scenario:
    return machine()


# ---- Kinematics -----------------------------------------------------------------------------------------------------


def test_home_has_the_printed_angles(legs: _core.Hexapod) -> None:
    assert legs.rotary
    np.testing.assert_allclose(legs.home_lengths, UPRIGHT, rtol=0, atol=np.deg2rad(0.01))  # two digits of a degree
    np.testing.assert_array_equal(legs.mid_lengths, legs.home_lengths)


def test_cranks_and_rods_close(legs: _core.Hexapod) -> None:
    random = np.random.default_rng(1)
    for _ in range(200):
        position, turn = random_pose(random)
        pose = (position, quaternion(turn))
        ends, unit, arm = rods(position, turn)
        np.testing.assert_allclose(legs.leg_lengths(*pose), angles(position, turn), rtol=0, atol=1e-13 / 0.1)
        np.testing.assert_allclose(legs.leg_feet(*pose), ends, rtol=0, atol=1e-14)
        np.testing.assert_allclose(legs.lever_arms(*pose), arm, rtol=1e-11)
        joints = position + turn.apply(JOINTS)
        np.testing.assert_allclose(np.linalg.norm(joints - legs.leg_feet(*pose), axis=1), ROD, rtol=1e-13)
        np.testing.assert_allclose(np.linalg.norm(legs.leg_feet(*pose) - CENTRES, axis=1), CRANK, rtol=1e-12)
        maps = np.vstack([unit.T, np.cross(turn.apply(JOINTS), unit).T]) / arm  # H W^-1
        np.testing.assert_allclose(legs.wrench_map(*pose), maps, rtol=0, atol=1e-9 / 0.03)


def test_the_stroke_of_a_crank_moves_its_end_along_a_circle(head: hs.Scenario) -> None:
    chord = 2.0 * CRANK * math.sin(head.robot.stroke / 2.0)
    assert stroke_length(head.robot) == pytest.approx(chord, rel=0.05)  # of angles below 1 rad


def test_rates_are_the_derivatives_of_the_angles(legs: _core.Hexapod) -> None:
    """Central differences of fourth order; their truncation and rounding are below 1e-9 of the rates."""
    random, h = np.random.default_rng(2), 2e-4
    for _ in range(50):
        position, turn = random_pose(random)
        twist = random.normal(size=6) * np.repeat([0.1, 1.0], 3)

        def at(time: float) -> Array:
            moved = Rotation.from_rotvec(time * twist[3:]) * turn  # noqa: B023
            return legs.leg_lengths(position + time * twist[:3], quaternion(moved))  # noqa: B023

        rates = (at(-2 * h) - 8 * at(-h) + 8 * at(h) - at(2 * h)) / (12 * h)
        found = np.asarray(legs.wrench_map(position, quaternion(turn))).T @ twist
        np.testing.assert_allclose(found, rates, rtol=0, atol=1e-8 * np.abs(rates).max())


def test_torques_balance_the_rods(legs: _core.Hexapod) -> None:
    """Statics: the force of each rod at the end of its crank has the crank's torque about the axis."""
    random = np.random.default_rng(3)
    for _ in range(50):
        position, turn = random_pose(random)
        wrench = random.normal(size=6) * np.repeat([1.0, 0.03], 3)
        torques = legs.leg_forces(position, quaternion(turn), wrench)
        ends, unit, _ = rods(position, turn)
        balance = np.vstack([unit.T, np.cross(turn.apply(JOINTS), unit).T])
        forces = np.linalg.solve(balance, wrench)  # that the rods push with
        about = (AXES * np.cross(ends - CENTRES, unit * forces[:, None])).sum(axis=1)
        np.testing.assert_allclose(torques, about, rtol=0, atol=1e-8 * np.abs(about).max())


def test_forward_kinematics_finds_every_pose_again(legs: _core.Hexapod) -> None:
    random = np.random.default_rng(4)
    seen = 0
    while seen < 300:
        position, turn = random_pose(random, 2.0)
        theta = legs.leg_lengths(position, quaternion(turn))
        if not np.abs(theta - legs.home_lengths).max() <= 0.6:
            continue
        seen += 1
        found = legs.forward_kinematics(theta, legs.home_position, legs.home_quaternion)
        assert found.status.name == "converged"
        np.testing.assert_allclose(found.position, position, rtol=0, atol=1e-11)
        np.testing.assert_allclose(np.abs(found.quaternion @ quaternion(turn)), 1.0, rtol=0, atol=1e-11)


def test_forward_kinematics_converges_close_to_dead_points(legs: _core.Hexapod) -> None:
    """Where a crank and its rod are nearly in line, a small step is not the last one: angles bend by 1/w^3."""
    random = np.random.default_rng(5)
    seen = 0
    while seen < 100:
        way, turn = random.normal(size=3) * 0.02, random.normal(size=3) * 0.3

        def pose_at(share: float, way: Array = way, turn: Array = turn) -> tuple[Array, Array]:
            return HOME + share * way, quaternion(Rotation.from_rotvec(share * turn))

        def arm_at(share: float) -> float:  # of the crank that is nearest to its dead point; NaN beyond it
            return float(np.abs(legs.lever_arms(*pose_at(share))).min() / CRANK)

        closes, beyond = 0.0, 8.0
        if np.isfinite(arm_at(beyond)):
            continue
        for _ in range(40):
            middle = 0.5 * (closes + beyond)
            closes, beyond = (middle, beyond) if arm_at(middle) > 0.005 else (closes, middle)
        pose = pose_at(closes * float(random.uniform(0.999, 1.0)))
        if legs.singular_values(*pose)[-1] < 0.1 or not np.isfinite(legs.lever_arms(*pose)).all():
            continue
        seen += 1
        start = pose[0] + random.uniform(-2e-10, 2e-10, 3)  # below 1e-8 of the platform's radius
        assert legs.forward_kinematics(legs.leg_lengths(*pose), start, pose[1]).status.name == "converged"


def test_angles_count_on_beyond_180_degrees() -> None:
    """With cranks that are at 175 deg at home, angles go beyond 180 deg without a jump."""
    turned = robot()
    shift = np.deg2rad(175.0) - UPRIGHT
    side = np.cross(AXES, ZERO)
    turned["cranks"]["zero"] = (np.cos(shift)[:, None] * ZERO - np.sin(shift)[:, None] * side).tolist()
    other, legs = hexapod(machine({"robot": turned})), hexapod()
    random, most = np.random.default_rng(5), 0.0
    for _ in range(100):
        position, turn = random_pose(random)
        pose = (position, quaternion(turn))
        np.testing.assert_allclose(other.leg_lengths(*pose) - legs.leg_lengths(*pose), shift, rtol=0, atol=1e-12)
        most = max(most, float(np.max(other.leg_lengths(*pose))))
    assert most > np.pi


# ---- Against Pinocchio ----------------------------------------------------------------------------------------------


def test_geometry_and_rates_are_those_of_pinocchio(legs: _core.Hexapod) -> None:
    """The chains of hinges and the free platform there: distances, and rates that keep them."""
    pin = pytest.importorskip("pinocchio", reason="Pinocchio is not installed (pip install pin)")
    model = pin.Model()
    tips = []
    for leg in range(6):
        frame = np.column_stack([ZERO[leg], np.cross(AXES[leg], ZERO[leg]), AXES[leg]])
        hinge = model.addJoint(0, pin.JointModelRZ(), pin.SE3(frame, CENTRES[leg]), f"crank{leg}")
        tip = pin.SE3(np.eye(3), np.array([CRANK, 0.0, 0.0]))
        tips.append(model.addFrame(pin.Frame(f"tip{leg}", hinge, 0, tip, pin.FrameType.OP_FRAME)))
    free = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "platform")
    joints = [
        model.addFrame(pin.Frame(f"joint{leg}", free, 0, pin.SE3(np.eye(3), JOINTS[leg]), pin.FrameType.OP_FRAME))
        for leg in range(6)
    ]
    data, random = model.createData(), np.random.default_rng(6)
    for _ in range(30):
        position, turn = random_pose(random)
        theta = legs.leg_lengths(position, quaternion(turn))
        q = np.concatenate([theta, position, turn.as_quat()])
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        along = np.array([data.oMf[b].translation - data.oMf[a].translation for a, b in zip(tips, joints, strict=True)])
        np.testing.assert_allclose(np.linalg.norm(along, axis=1), ROD, rtol=1e-12)
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        rows = np.array(
            [
                way
                @ (pin.getFrameJacobian(model, data, b, frame)[:3] - pin.getFrameJacobian(model, data, a, frame)[:3])
                for way, a, b in zip(along, tips, joints, strict=True)
            ]
        )
        # d|rod|/dt = 0; the free joint's velocity is in the platform's frame
        rates = -np.linalg.solve(rows[:, :6], rows[:, 6:])
        into = np.kron(np.eye(2), turn.as_matrix().T)
        np.testing.assert_allclose(np.asarray(legs.wrench_map(position, quaternion(turn))).T, rates @ into, rtol=1e-9)


# ---- Singularities and reach ----------------------------------------------------------------------------------------


def test_cranks_in_line_with_their_rods(legs: _core.Hexapod) -> None:
    """Upwards the first crank and its rod come in line at a height that its plane gives; beyond, it does not close."""
    between = JOINTS - CENTRES
    shadow = np.sqrt(ROD**2 - (between * AXES).sum(axis=1) ** 2)  # of a rod in the plane of its crank
    across = (between * ZERO).sum(axis=1)
    heights = np.sqrt((CRANK + shadow) ** 2 - across**2)
    leg = int(heights.argmin())
    near, beyond = (np.array([0.0, 0.0, -(heights[leg] + way)]) for way in (-1e-9, 1e-9))
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    arms = np.abs(legs.lever_arms(near, upright)) / CRANK
    # (r + s)^2 - distance^2 = r s angle^2 of crank and shadow s, close to it, and w/r = (s/d) angle
    left = 1e-9 * heights[leg] / (CRANK + shadow[leg])
    angle = math.sqrt(2 * (CRANK + shadow[leg]) * left / (CRANK * shadow[leg]))
    assert arms.min() == pytest.approx(shadow[leg] / ROD * angle, rel=1e-3)
    assert np.asarray(legs.singular_values(near, upright))[-1] > 5e-3  # that of the rods is another
    assert np.isnan(legs.leg_lengths(beyond, upright)).any()
    assert np.isnan(legs.lever_arms(beyond, upright)).any()
    assert np.asarray(legs.singular_values(beyond, upright))[-1] == 0.0
    with pytest.raises(ValueError, match="not singular"):
        legs.leg_forces(beyond, upright, np.ones(6))


def test_rods_that_depend_on_one_another() -> None:
    """Six rods that meet one line in space resist no turn about it, whatever the cranks do."""
    legs = hexapod()
    random = np.random.default_rng(8)
    for _ in range(20):
        position, turn = random_pose(random)
        _, unit, _ = rods(position, turn)
        arms = turn.apply(JOINTS) / legs.platform_radius
        values = np.linalg.svd(np.vstack([unit.T, np.cross(arms, unit).T]), compute_uv=False)
        np.testing.assert_allclose(legs.singular_values(position, quaternion(turn)), values, rtol=1e-10)


def test_reach_against_a_grid(head: hs.Scenario) -> None:
    legs = hexapod(head)
    side = np.sign(np.linalg.det(legs.wrench_map(legs.home_position, legs.home_quaternion)))
    random, kinds = np.random.default_rng(9), set()
    for _ in range(60):
        pose = random.normal(size=6) * np.repeat([0.012, 0.25], 3)
        found, turn = hs.reachable(head, pose), Rotation.from_rotvec(pose[3:])
        with np.errstate(invalid="ignore"):
            travel = np.abs(
                (angles(HOME + pose[:3], turn) - angles(HOME, Rotation.identity()) + np.pi) % (2 * np.pi) - np.pi
            )
        closes = np.isfinite(travel).all()
        within = closes and travel.max() <= 0.6
        if within:
            within = np.sign(np.linalg.det(legs.wrench_map(HOME + pose[:3], quaternion(turn)))) == side
        assert found.within == within
        kinds.add((bool(closes), bool(within)))
        if closes:
            assert found.margin == pytest.approx(0.6 - travel.max(), abs=1e-9)
            _, _, arm = rods(HOME + pose[:3], turn)
            assert found.lever_arm == pytest.approx(np.abs(arm).min() / CRANK, rel=1e-9)
        else:
            assert found.margin == -math.inf
            assert found.lever_arm == 0.0
            assert "does not reach it" in str(found)
        assert hs.reachable(head, 0.999 * found.nearest).within
    assert kinds == {(True, True), (True, False), (False, False)}
    assert "mrad of its travel left" in str(hs.reachable(head, np.zeros(6)))


def reaches(scenario: hs.Scenario, pose: Array) -> bool:
    """Whether the legs reach a displacement of home, by the core's inverse kinematics."""
    legs = hexapod(scenario)
    there = (legs.home_position + pose[:3], quaternion(Rotation.from_rotvec(pose[3:]) * attitude(legs)))
    used = [np.abs(legs.leg_lengths(*there) - legs.mid_lengths) / scenario.robot.stroke]
    if scenario.robot.joint_limit is not None:
        used += list(legs.leg_tilts(*there) / np.array(scenario.robot.joint_limit)[:, None])
    if not np.max(used) <= 1.0 + 1e-8:  # NaN where a crank does not close
        return False
    home = np.linalg.det(legs.wrench_map(legs.home_position, legs.home_quaternion))
    return bool(np.linalg.det(legs.wrench_map(*there)) * home > 0.0)


def attitude(legs: _core.Hexapod) -> Rotation:
    return Rotation.from_quat(np.roll(legs.home_quaternion, -1))


@pytest.mark.parametrize("which", ["head", "limited", "reachy-mini-head"])
def test_no_pose_near_the_nearest_one_is_nearer(head: hs.Scenario, which: str) -> None:
    """Of random poses about the nearest one, up to a fifth of the distance away, none within reach is nearer."""
    scenario = hs.load_scenario(which) if which == "reachy-mini-head" else head
    if which == "limited":
        scenario = head.updated({"robot.joint_limit": [0.15, 0.2]})
    metric = np.repeat([1.0, hexapod(scenario).platform_radius], 3)
    for seed in (2, 15, 36, 121):  # some of them end at a singular pose, some where crank and rod are in line
        print("seed", seed)
        random = np.random.default_rng(seed)
        wanted = random.normal(size=6) * np.repeat([0.06, 0.9], 3)
        found = hs.reachable(scenario, wanted)
        assert not found.within
        assert reaches(scenario, found.nearest)
        turn = Rotation.from_rotvec(wanted[3:])

        def distance(pose: Array, turn: Rotation = turn, wanted: Array = wanted) -> float:
            between = (turn * Rotation.from_rotvec(pose[3:]).inv()).as_rotvec()
            return float(np.linalg.norm(metric * np.concatenate([wanted[:3] - pose[:3], between])))

        assert found.distance == pytest.approx(distance(found.nearest), rel=1e-9)
        for size in (0.003, 0.03, 0.2):
            for _ in range(60):
                ball = random.normal(size=6)
                ball *= found.distance * random.uniform() ** (1 / 6) / np.linalg.norm(ball)
                near = found.nearest + size * (wanted + ball / metric - found.nearest)
                if distance(near) < 0.9999 * found.distance:
                    assert not reaches(scenario, near), (seed, size)


def test_a_pose_known_to_be_within_is_not_nearer() -> None:
    """Straight aside from home a crank stops closing, far from the nearest pose."""
    scenario = hs.load_scenario("reachy-mini-head")
    legs, wanted = hexapod(scenario), np.array([0.0, 0.10, 0.0, 0.0, 0.0, 0.0])
    known = hs.reachable(scenario, [0.0, 0.08, 0.0, 0.0, 0.0, 0.0]).nearest
    metric = np.repeat([1.0, legs.platform_radius], 3)
    assert hs.reachable(scenario, wanted).distance <= np.linalg.norm(metric * (known - wanted)) + 1e-9


def test_the_march_ends_at_the_first_limit(head: hs.Scenario) -> None:
    scene, random = scene_of(head), np.random.default_rng(11)
    for _ in range(6):
        direction = random.normal(size=6) * np.repeat([1.0, 20.0], 3)
        end = reach(scene, direction)
        used = np.abs(
            scene.leg_travel(scene.home.moved(np.linspace(0.0, 1.0, 400)[:, None] * end.distance * direction))
        )
        assert used.max() <= scene.stroke * (1.0 + 1e-9)
        # within the step that bisection leaves, a crank is at its stroke, or no longer closes
        beyond = np.abs(scene.leg_travel(scene.home.moved(end.distance * (1 + 1e-6) * direction)))
        assert int(beyond.argmax()) + 1 == end.leg
        assert beyond.max() > scene.stroke


def test_joint_limits_turn_with_the_crank(head: hs.Scenario) -> None:
    legs, random = hexapod(head), np.random.default_rng(10)
    home = rods(HOME, Rotation.identity())[1]
    start = angles(HOME, Rotation.identity())
    for _ in range(50):
        position, turn = random_pose(random)
        _, unit, _ = rods(position, turn)
        carried = Rotation.from_rotvec((angles(position, turn) - start)[:, None] * AXES).inv().apply(unit)
        expected = np.arctan2(np.linalg.norm(np.cross(carried, home), axis=1), (carried * home).sum(axis=1))
        own = turn.inv().apply(unit)
        other = np.arctan2(np.linalg.norm(np.cross(own, home), axis=1), (own * home).sum(axis=1))
        tilts = legs.leg_tilts(position, quaternion(turn))
        np.testing.assert_allclose(tilts, [expected, other], rtol=0, atol=1e-13)


# ---- Loops ----------------------------------------------------------------------------------------------------------


def check_legs(result: hs.Result) -> None:
    legs = hexapod(result.scenario)
    for row in range(0, len(result.time), max(1, len(result.time) // 50)):
        pose = (result.position[row], result.quaternion[row])
        np.testing.assert_allclose(result.leg_lengths[row], legs.leg_lengths(*pose), rtol=0, atol=1e-13)
        torques = legs.leg_forces(*pose, result.wrench[row])
        np.testing.assert_allclose(result.leg_forces[row], torques, rtol=0, atol=1e-9 * np.abs(torques).max())


def test_a_run_settles_with_angles_and_torques(head: hs.Scenario) -> None:
    result = hs.simulate(head)
    assert result.outcome == "completed"
    assert hs.metrics(result)["settling_time"] < 1.5
    check_legs(result)
    metrics = hs.metrics(result)
    travel = np.abs(result.leg_lengths - result.leg_lengths[0])
    assert metrics["peak_leg_excursion"] == pytest.approx(travel.max(), rel=1e-12)
    assert metrics["peak_leg_force"] == pytest.approx(np.abs(result.leg_forces).max(), rel=1e-12)


DEVICES = {
    "simulation.mode": "sampled",
    "simulation.step": 2e-3,
    "sensors.pose": "encoders",
    "sensors.rate": True,
    "actuators.hold": "leg_forces",
}


def test_encoders_read_angles(head: hs.Scenario) -> None:
    sampled = head.updated({**DEVICES, "actuators.hold": "wrench"})
    read, known = hs.simulate(sampled), hs.simulate(sampled.updated({"sensors.pose": True}))
    # Newton's method leaves 1e-12 rad, which the switching term may enlarge
    np.testing.assert_allclose(read.position, known.position, rtol=0, atol=1e-6)
    check_legs(read)
    coarse = hs.simulate(sampled.updated({"sensors.resolution": 2 * np.pi / 4096, "sensors.noise": 1e-4}))
    assert coarse.outcome == "completed"
    assert not np.array_equal(coarse.position, read.position)


def test_torques_hold_between_two_ticks_and_saturate(head: hs.Scenario) -> None:
    limit = 0.9 * float(np.abs(hs.simulate(head).leg_forces[0]).max())
    held = hs.simulate(head.updated({**DEVICES, "actuators.saturation": True, "robot.force_limit": limit}))
    assert held.outcome in ("completed", "singular")
    assert np.abs(held.leg_forces).max() <= limit * (1 + 1e-12)
    check_legs(held)


def test_lanes_agree_with_single_runs(head: hs.Scenario) -> None:
    sampled = head.updated({**DEVICES, "robot.speed_limit": 1.0, "robot.joint_limit": [0.2, 0.2]})
    sampled = sampled.updated({"simulation.duration": 0.2})
    lengths = np.array([0.040, 0.0405, 0.0395, 0.041, 0.0398])
    batch = hs.simulate_batch(sampled, {"robot.cranks.length": lengths})
    for index, length in enumerate(lengths):
        single = hs.simulate(sampled.updated({"robot.cranks.length": float(length)}))
        for name, value in hs.metrics(single).items():
            np.testing.assert_allclose(batch.metrics[name][index], value, rtol=1e-6, atol=1e-9, err_msg=name)
    assert len(set(batch.metrics["peak_leg_speed"])) == 5


def test_a_run_ends_where_a_crank_no_longer_closes(head: hs.Scenario) -> None:
    up = {"simulation.start.twist": [0.0, 0.0, -3.0, 0.0, 0.0, 0.0], "robot.stroke": 3.0}
    assert hs.simulate(head.updated(up)).outcome == "singular"
    stopped = hs.simulate(
        head.updated({**up, "robot.stroke": 0.6, "simulation.mode": "sampled", "robot.on_limit": "stop"})
    )
    assert stopped.outcome == "leg_limit"


# ---- Units ----------------------------------------------------------------------------------------------------------


def test_units_follow_the_legs(head: hs.Scenario, tmp_path: Path) -> None:
    scenario = head.updated({"robot.stroke": 0.02, "robot.force_limit": 0.02, "robot.speed_limit": 0.1})
    result = hs.simulate(scenario.updated({"simulation.duration": 0.3}))
    dataset = result.to_xarray()
    assert dataset["leg_lengths"].attrs == {"units": "rad", "long_name": "angles of the cranks"}
    assert dataset["leg_forces"].attrs == {"units": "N m", "long_name": "torques of the cranks"}
    units = result.to_dataframe().attrs["units"]
    assert (units["leg_lengths_1"], units["leg_forces_6"], units["position_x"]) == ("rad", "N m", "m")
    words = {event.kind: str(event) for event in result.events}
    assert "exceeded its stroke of 20 mrad" in words["stroke"]
    assert "exceeded its torque limit of 20 mN m" in words["force"]
    assert "exceeded its speed limit of 100 mrad/s" in words["speed"]
    result.save(tmp_path / "run.nc")
    again = hs.load_result(tmp_path / "run.nc")
    assert again.events == result.events
    assert again.scenario == result.scenario
    batch = hs.simulate_batch(scenario.updated({"simulation.duration": 0.01}), {"robot.mass": [0.28, 0.3]})
    assert batch.to_dataframe().attrs["units"]["peak_leg_force"] == "N m"
    whole = hs.simulate_batch(scenario.updated({"simulation.duration": 0.01}), {"robot.mass": [0.28]}, log="trajectory")
    of_batch = whole.to_xarray()
    for name in ("leg_lengths", "leg_forces", "position"):
        assert of_batch[name].attrs == dataset[name].attrs
    header = gains_header(scenario)
    assert "s.robot.legs = hexservo::LegKind::rotary;" in header
    assert "s.robot.stroke = 0.02;  // [rad]" in header
    assert "s.robot.force_limit = 0.02;  // [N m]" in header
    assert "s.robot.cranks.axes.emplace() <<" in header
    assert "cranks" not in gains_header(hs.load_scenario("paper"))


def test_check_speaks_of_torques(head: hs.Scenario) -> None:
    assert not unlikely(head)
    (weak,) = [
        line
        for line in unlikely_without_runs(head.updated({"robot.force_limit": 1e-3}))
        if line.startswith("robot.force")
    ]
    assert weak.startswith("robot.force_limit: 0.001 N m is less than the ")


# ---- What is refused ------------------------------------------------------------------------------------------------


def changed(name: str, rows: Array) -> dict[str, Any]:
    block = robot()
    block["cranks"][name] = rows.tolist()
    return {"robot": block}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (changed("axes", 1.1 * AXES), "robot.cranks.axes[0]: expected a unit vector, got one of length 1.1"),
        (changed("zero", 0.5 * ZERO), "robot.cranks.zero[0]: expected a unit vector, got one of length 0.5"),
        (changed("zero", AXES), "robot.cranks.zero[0]: expected a vector at right angles to robot.cranks.axes[0], got"),
        (changed("branch", 0.5 * BRANCH), "robot.cranks.branch[0]: expected 1 or -1, got -0.5"),
        (changed("branch", 2.0 * BRANCH), "robot.cranks.branch[0]: expected a number >= -1 and <= 1, got -2"),
        *(
            ({f"robot.cranks.{name}": None}, f"robot.cranks.{name}: expected {words}, got null")
            for name, words in {
                "length": "a number > 0 for rotary legs",
                "rod": "a number > 0 for rotary legs",
                "axes": "six unit vectors for rotary legs",
                "zero": "six unit vectors for rotary legs",
                "branch": "six numbers, each 1 or -1, for rotary legs",
            }.items()
        ),
        ({"robot.cranks.rod": 0.05}, "robot.cranks: expected cranks and rods that close at home"),
        ({"robot.cranks.length": 0.4}, "robot.cranks: expected cranks and rods that close at home"),
        (
            {"robot.legs": "prismatic"},
            "robot.cranks: expected null for prismatic legs, or robot.legs: rotary, got cranks",
        ),
        (
            {"robot.stroke": 3.2},
            "robot.stroke: expected angles within pi of home [rad] for rotary legs, got 3.2",
        ),
        ({"robot.legs": "screws"}, "robot.legs: expected"),
        (
            {"simulation.start.pose": [0, 0, -0.03, 0, 0, 0]},
            "simulation.start.pose: expected a pose where every crank reaches its platform joint (robot.cranks), got",
        ),
    ],
)
def test_what_no_machine_has_is_refused(head: hs.Scenario, changes: dict[str, Any], words: str) -> None:
    with pytest.raises(hs.ScenarioError) as error:
        head.updated(changes)
    assert words in str(error.value)


def test_short_cranks_that_close_near_home_alone_are_a_machine(head: hs.Scenario) -> None:
    """Cranks of 20 mm on rods of 150 mm: regular at home, and out of reach at a tenth of a radius and 0.3 rad."""
    at = np.deg2rad([-12.5, 12.5, 107.5, 132.5, 227.5, 252.5])
    radial, tangential = (
        np.column_stack([x, y, np.zeros(6)]) for x, y in ((np.cos(at), np.sin(at)), (-np.sin(at), np.cos(at)))
    )
    short = {
        "preset": None,
        "base_radius": 0.09,
        "base_angles": at.tolist(),
        "platform_radius": 0.07,
        "platform_angles": np.deg2rad([-45, 45, 75, 165, 195, 285]).tolist(),
        "home_position": [0.0, 0.0, -0.15],
        "cranks": {
            "length": 0.02,
            "rod": 0.15,
            "axes": radial.tolist(),
            "zero": (np.tile([-1.0, 1.0], 3)[:, None] * tangential).tolist(),
            "branch": BRANCH.tolist(),
        },
    }
    block = {**robot(), "platform_joints": None, "base_joints": None, **short}
    legs = hexapod(head.updated({"robot": block, "controller.composite.auto.bandwidth": None}))
    sigma = legs.singular_values(np.array(legs.home_position), np.array([1.0, 0.0, 0.0, 0.0]))
    assert sigma[5] / sigma[0] > 0.1
    far = legs.singular_values(
        np.array([0.002, -0.004, -0.145]), Rotation.from_rotvec([0.14, -0.22, 0.26]).as_quat()[[3, 0, 1, 2]]
    )
    np.testing.assert_array_equal(far, np.zeros(6))


def test_files_of_a_run_have_the_units(head: hs.Scenario, tmp_path: Path) -> None:
    result = hs.simulate(head.updated({"robot.stroke": 0.02, "simulation.duration": 0.2}))
    data = json.loads((write_results(result, tmp_path / "out") / "metrics.json").read_text(encoding="utf-8"))
    assert data["events"][0]["peak"]["unit"] == "rad"
    assert data["metrics"]["peak_leg_force"]["unit"] == "N m"
    assert data["metrics"]["peak_leg_excursion"]["unit"] == "rad"
