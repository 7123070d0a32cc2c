"""A base that turns, targets in the world and targets that move: against separate equations in the frame W."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo import _core
from hexservo.scenario.motion import displacements_of
from hexservo.scenario.parameters import core_parameters

Array = NDArray[np.float64]

TICK = 1e-3  # [s]
EXACT = {"inertia": 0.0, "coriolis": 0.0, "gravity": 0.0, "depth": 0.0}
PAYLOAD = {"mass": 0.02, "position": [0.012, -0.02, 0.015], "inertia": [4e-6, 3e-6, 5e-6]}
SWAY: dict[str, Any] = {
    "kind": "sinusoid",
    "amplitude": [0.4, -0.3, 0.5],
    "frequency": 1.3,
    "phase": 0.4,
    "rotation": {
        "kind": "sinusoid",
        "amplitude": [0.3, -0.2, 0.25],
        "frequency": [0.9, 1.6, 2.1],
        "phase": [0.2, -0.7, 1.1],
    },
}


@pytest.fixture(scope="module")
def sampled(paper: hs.Scenario) -> hs.Scenario:
    """The sampled loop without errors, in fine steps."""
    return paper.updated(
        {
            "name": "moving",
            "uncertainty": EXACT,
            "controller.switching.kind": "implicit",
            "simulation": {"mode": "sampled", "duration": 0.3, "substeps": 4},
        }
    )


def motion_of(scenario: hs.Scenario, time: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Place, attitude, rate, its change, and acceleration of the base, as the core has them."""
    probe = _core.Probe(core_parameters(scenario))
    return (*probe.base_motion(time), probe.base_acceleration(time))


def in_matrix(quaternion: Array) -> Array:
    return np.asarray(Rotation.from_quat(np.roll(quaternion, -1, axis=-1)).as_matrix())


# ---- Motion of B ----------------------------------------------------------------------------------------------------


class Swaying:
    """The motion `SWAY` in closed form: rotation vector, its right Jacobian, and the acceleration's integrals."""

    def __init__(self, scenario: hs.Scenario) -> None:
        base = scenario.base_motion
        self.amplitude, self.w, self.phase = np.array(base.amplitude), 2 * np.pi * base.frequency, base.phase
        turn = base.rotation
        self.turn, self.turn_w = np.array(turn.amplitude), 2 * np.pi * np.array(turn.frequency)
        self.turn_phase = np.array(turn.phase)

    def acceleration(self, t: float) -> Array:
        return np.asarray(self.amplitude * np.sin(self.w * t + self.phase))

    def velocity(self, t: float) -> Array:
        return np.asarray(-self.amplitude / self.w * np.cos(self.w * t + self.phase))

    def place(self, t: float) -> Array:
        return np.asarray(-self.amplitude / self.w**2 * np.sin(self.w * t + self.phase))

    def attitude(self, t: float) -> Array:
        vector = self.turn * np.sin(self.turn_w * t + self.turn_phase)
        return np.asarray(Rotation.from_rotvec(vector).as_matrix())

    def rate(self, t: float) -> Array:
        """Omega in B: J_r(r) r-dot."""
        r = self.turn * np.sin(self.turn_w * t + self.turn_phase)
        change = self.turn * self.turn_w * np.cos(self.turn_w * t + self.turn_phase)
        a = float(np.linalg.norm(r))
        cross = np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
        jacobian = np.eye(3) - (1 - np.cos(a)) / a**2 * cross + (a - np.sin(a)) / a**3 * cross @ cross
        return np.asarray(jacobian @ change)


def test_sinusoids_have_their_attitude_and_place(sampled: hs.Scenario) -> None:
    scenario = sampled.updated({"base_motion": SWAY})
    time = np.linspace(0.0, 3.0, 61)
    place, attitude, rate, _, acceleration = motion_of(scenario, time)
    expected = Swaying(scenario)
    for k, t in enumerate(time):
        np.testing.assert_allclose(place[k], expected.place(t), rtol=0, atol=1e-15)
        np.testing.assert_allclose(attitude[k], expected.attitude(t), rtol=0, atol=5e-15)
        np.testing.assert_allclose(rate[k], expected.rate(t), rtol=0, atol=5e-14)
        np.testing.assert_allclose(acceleration[k], expected.acceleration(t), rtol=0, atol=5e-15)


@pytest.mark.parametrize("kind", ["sinusoid", "noise", "road", "recorded"])
def test_rate_and_its_change_are_derivatives_of_the_attitude(sampled: hs.Scenario, kind: str) -> None:
    """By central differences over 2 h: an error of about h^2/6 of the third derivative, and rounding over h."""
    motion: dict[str, Any] = SWAY
    if kind == "noise":
        motion = {"rotation": {"kind": "noise", "level": 1e-3, "low_frequency": 0.5, "high_frequency": 4.0}}
    elif kind == "road":
        motion = {"kind": "road", "road": {"roughness": "E", "position": [1.0, 0.4, -0.8], "shortest": 2.0}}
    elif kind == "recorded":
        random = np.random.default_rng(20)
        turns = Rotation.from_rotvec(np.cumsum(random.normal(size=(40, 3)), axis=0) * 0.03)
        motion = {
            "kind": "recorded",
            "samples": random.normal(size=(40, 3)).tolist(),
            "attitudes": np.roll(turns.as_quat(), 1, axis=1).tolist(),
            "sample_period": 0.05,
        }
    scenario = sampled.updated({"base_motion": motion})
    h, time = 1e-5, np.linspace(0.01, 1.5, 50) + 0.00013
    place, attitude, rate, change, acceleration = motion_of(scenario, time)
    before, after = motion_of(scenario, time - h), motion_of(scenario, time + h)
    np.testing.assert_allclose(
        np.swapaxes(attitude, 1, 2) @ attitude, np.broadcast_to(np.eye(3), (50, 3, 3)), atol=1e-14
    )
    turning = np.swapaxes(attitude, 1, 2) @ (after[1] - before[1]) / (2 * h)
    found = np.stack([turning[:, 2, 1], turning[:, 0, 2], turning[:, 1, 0]], axis=1)
    largest = 1.0 + np.abs(change).max() * 40.0  # of the third derivative, at most 6 Hz
    np.testing.assert_allclose(found, rate, rtol=0, atol=1e-10 * largest)
    np.testing.assert_allclose((after[2] - before[2]) / (2 * h), change, rtol=0, atol=1e-9 * largest)
    if kind != "noise":
        second = (after[0] - 2 * place + before[0]) / h**2
        np.testing.assert_allclose(second, acceleration, rtol=0, atol=1e-4 * max(1.0, np.abs(acceleration).max()))


def test_recorded_attitudes_are_a_cubic_spline_of_quaternions(sampled: hs.Scenario) -> None:
    random = np.random.default_rng(21)
    turns = Rotation.from_rotvec(np.cumsum(random.normal(size=(25, 3)), axis=0) * 0.05)
    q = np.roll(turns.as_quat(), 1, axis=1)
    q[1:] *= np.cumprod(np.sign(np.sum(q[1:] * q[:-1], axis=1)))[:, None]
    given = q * random.choice([-1.0, 1.0], size=(25, 1))  # of either sign: the same attitudes
    samples = random.normal(size=(25, 3))
    motion = {"kind": "recorded", "samples": samples, "attitudes": given, "sample_period": 0.04}
    scenario = sampled.updated({"base_motion": motion})
    grid = 0.04 * np.arange(25)
    time = np.linspace(0.0, 0.96, 97)
    place, attitude, _, _, acceleration = motion_of(scenario, time)
    curve = CubicSpline(grid, q)(time)
    expected = in_matrix(curve / np.linalg.norm(curve, axis=1, keepdims=True))
    np.testing.assert_allclose(attitude, expected, rtol=0, atol=1e-13)
    np.testing.assert_allclose(
        acceleration, np.stack([np.interp(time, grid, a) for a in samples.T], axis=1), atol=1e-13
    )
    assert np.abs(place[[0, -1]]).max() <= 1e-15


# ---- Equations of motion --------------------------------------------------------------------------------------------


def integrated_in_world(result: hs.Result, base: Swaying, time: Array) -> tuple[Array, Array]:
    """Newton's and Euler's equations about the centre of mass in W, under the logged wrench that is held in B."""
    settings = core_parameters(result.scenario)
    body = settings.plant_body
    mass, c = body.mass, np.array(body.centre_of_mass)
    inertia = np.array(body.inertia) - mass * (c @ c * np.eye(3) - np.outer(c, c))  # about the centre of mass
    gravity = np.array(result.scenario.robot.gravity)  # in W
    of_b = base.attitude(0.0)
    turn = Rotation.from_matrix(of_b @ in_matrix(result.quaternion[0]))
    p, v, omega = result.position[0], result.twist[0, :3], result.twist[0, 3:]
    spin = of_b @ (base.rate(0.0) + omega)
    lever = turn.apply(c)
    velocity = base.velocity(0.0) + of_b @ (v + np.cross(base.rate(0.0), p)) + np.cross(spin, lever)
    centre = base.place(0.0) + of_b @ p + lever
    state = np.concatenate([centre, velocity, turn.as_quat(), spin])

    def rate(t: float, y: Array, wrench: Array) -> Array:
        attitude = Rotation.from_quat(y[6:10]).as_matrix()
        of_b = base.attitude(t)
        force = of_b @ wrench[:3]
        moment = of_b @ wrench[3:] - np.cross(attitude @ c, force)  # about the centre of mass
        inertia_w = attitude @ inertia @ attitude.T
        w = y[10:]
        x, y_, z, s = y[6:10]
        turning = 0.5 * np.array(
            [
                w[0] * s + w[1] * z - w[2] * y_,
                w[1] * s + w[2] * x - w[0] * z,
                w[2] * s + w[0] * y_ - w[1] * x,
                -w @ y[6:9],
            ]
        )
        return np.concatenate(
            [y[3:6], force / mass + gravity, turning, np.linalg.solve(inertia_w, moment - np.cross(w, inertia_w @ w))]
        )

    places, attitudes = [], []
    for k, t in enumerate(time):
        attitude = Rotation.from_quat(state[6:10]).as_matrix()
        of_b = base.attitude(t)
        places.append(of_b.T @ (state[:3] - attitude @ c - base.place(t)))
        attitudes.append(of_b.T @ attitude)
        if k + 1 < len(time):
            step = solve_ivp(
                rate, (t, time[k + 1]), state, method="DOP853", rtol=1e-13, atol=1e-15, args=(result.wrench[k],)
            )
            state = step.y[:, -1]
    return np.array(places), np.array(attitudes)


@pytest.mark.parametrize("payload", [{}, PAYLOAD], ids=["centred", "off-centre"])
def test_a_platform_on_a_moving_base_moves_as_newton_and_euler_have_it_in_the_world(
    sampled: hs.Scenario, payload: dict[str, Any]
) -> None:
    """Runge-Kutta steps of 0.25 ms at rates of 20/s leave (20 * 2.5e-4)^4, some 1e-10 of the motion."""
    start = {"pose": [1e-3, -2e-3, 1e-3, 0.02, 0.01, -0.03], "twist": [0.01, -0.02, 0.015, 0.3, -0.2, 0.4]}
    changes = {"base_motion": SWAY, "robot.payload": payload, "simulation.start": start, "simulation.duration": 0.2}
    scenario = sampled.updated(changes)
    weight = 9.8 * (scenario.robot.mass + payload.get("mass", 0.0))

    def pushing(seen: hs.Observation) -> Array:
        t = seen.time
        return np.array([0.02 * np.sin(9 * t), 0.01, -weight * 1.05, 2e-4, -1e-4 * np.cos(20 * t), 3e-4])

    result = hs.simulate(scenario, controller=pushing)
    assert result.outcome == "completed"
    places, attitudes = integrated_in_world(result, Swaying(scenario), result.time)
    assert np.abs(result.position - result.position[0]).max() > 2e-3
    np.testing.assert_allclose(result.position, places, rtol=0, atol=1e-9)
    np.testing.assert_allclose(in_matrix(result.quaternion), attitudes, rtol=0, atol=1e-9)


def test_a_free_body_in_a_turning_base_keeps_its_momentum_in_the_world(sampled: hs.Scenario) -> None:
    motion = {"rotation": SWAY["rotation"]}
    start = {"twist": [0.01, -0.02, 0.015, 0.3, -0.2, 0.4]}
    scenario = sampled.updated(
        {"base_motion": motion, "robot.gravity": 0.0, "robot.payload": PAYLOAD, "simulation.start": start}
    )
    result = hs.simulate(scenario, controller=lambda _: np.zeros(6))
    assert np.abs(result.wrench).max() == 0.0
    body = core_parameters(scenario).plant_body
    place, of_base, rate, _, _ = motion_of(scenario, result.time)
    assert not place.any()
    of_platform = in_matrix(result.quaternion)
    c = of_platform @ np.array(body.centre_of_mass)
    w = rate + result.twist[:, 3:]
    v = result.twist[:, :3] + np.cross(rate, result.position) + np.cross(w, c)  # of the centre of mass
    about_centre = np.array(body.inertia) - body.mass * (
        np.square(body.centre_of_mass).sum() * np.eye(3) - np.outer(body.centre_of_mass, body.centre_of_mass)
    )
    spin = np.einsum("nij,jk,nlk,nl->ni", of_platform, about_centre, of_platform, w)
    moment = spin + body.mass * np.cross(result.position + c, v)
    for vector in (body.mass * v, moment):
        in_world = np.einsum("nij,nj->ni", of_base, vector)
        np.testing.assert_allclose(in_world, np.broadcast_to(in_world[0], in_world.shape), rtol=0, atol=1e-11)


def test_a_tilted_base_tilts_the_weight(sampled: hs.Scenario) -> None:
    """At rest on a base tilted by a constant: what holds the platform is the weight in the axes of B."""
    tilt = [0.1, -0.05, 0.0]
    motion = {"rotation": {"kind": "sinusoid", "amplitude": tilt, "frequency": 0.0, "phase": np.pi / 2}}
    scenario = sampled.updated({"base_motion": motion, "simulation.duration": 0.05})
    down = Rotation.from_rotvec(tilt).as_matrix().T @ np.array([0.0, 0.0, 9.8])
    holding = np.concatenate([-scenario.robot.mass * down, np.zeros(3)])
    result = hs.simulate(scenario, controller=lambda _: holding)
    assert np.abs(result.twist).max() <= 1e-14


# ---- Recordings -----------------------------------------------------------------------------------------------------


def written(path: Path, columns: dict[str, Array]) -> str:
    rows = zip(*columns.values(), strict=True)
    lines = [", ".join(columns), *(", ".join(repr(float(x)) for x in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return str(path)


def axes(names: str, rows: Array) -> dict[str, Array]:
    return dict(zip(names.split(), rows.T, strict=True))


@pytest.fixture(scope="module")
def ride(sampled: hs.Scenario) -> dict[str, Array]:
    """A second of `SWAY` every 5 ms: times, accelerations in W, attitudes and rates."""
    time = np.linspace(0.0, 1.0, 201)
    _, attitude, rate, _, acceleration = motion_of(sampled.updated({"base_motion": SWAY}), time)
    return {"t": time, "a": acceleration, "R": attitude, "w": rate}


def test_a_recording_with_gravity_is_the_kinematic_one(
    sampled: hs.Scenario, ride: dict[str, Array], tmp_path: Path
) -> None:
    turns = Rotation.from_matrix(ride["R"])
    attitude = axes("qw qx qy qz", np.roll(turns.as_quat(), 1, axis=1))
    gravity = np.array(sampled.robot.gravity)
    force = np.einsum("nji,nj->ni", ride["R"], ride["a"] - gravity)
    plain = written(tmp_path / "plain.csv", {"t": ride["t"], **axes("ax ay az", ride["a"]), **attitude})
    imu = written(tmp_path / "imu.csv", {"t": ride["t"], **axes("ax ay az", force), **attitude})
    vector = written(
        tmp_path / "vector.csv", {"t": ride["t"], **axes("ax ay az", ride["a"]), **axes("rx ry rz", turns.as_rotvec())}
    )
    kinematic = sampled.updated({"base_motion": {"kind": "recorded", "file": plain}})
    read = sampled.updated(
        {"base_motion": {"kind": "recorded", "file": imu, "frame_of_acceleration": "specific_force"}}
    )
    assert read.base_motion.frame_of_acceleration == "kinematic"
    assert hs.Scenario.from_yaml(read.to_yaml()) == read
    one, other = (np.array(s.base_motion.samples, dtype=float) for s in (read, kinematic))
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-14)
    first, plain_run = hs.simulate(read), hs.simulate(kinematic)
    third = hs.simulate(sampled.updated({"base_motion": {"kind": "recorded", "file": vector}}))
    for run in (first, third):
        np.testing.assert_allclose(run.position, plain_run.position, rtol=0, atol=1e-12)
        np.testing.assert_allclose(run.feature_error, plain_run.feature_error, rtol=0, atol=1e-8)
    # and near the motion itself, but for 5 ms between samples: (13/s * 5 ms)^2/8 of the acceleration, some 1e-3
    exact = hs.simulate(sampled.updated({"base_motion": SWAY}))
    assert (
        0.0
        < np.abs(exact.position - plain_run.position).max()
        <= 2e-3 * np.abs(exact.position - exact.position[0]).max()
    )


def test_recorded_rates_are_integrated(sampled: hs.Scenario, ride: dict[str, Array], tmp_path: Path) -> None:
    file = written(
        tmp_path / "gyro.csv", {"t": ride["t"], **axes("ax ay az", ride["a"]), **axes("wx wy wz", ride["w"])}
    )
    read = sampled.updated({"base_motion": {"kind": "recorded", "file": file}})
    attitudes = in_matrix(np.array(read.base_motion.attitudes))
    expected = ride["R"][0].T @ ride["R"]  # from the attitude at t = 0
    # fourth order: (13/s * 5 ms)^4/720 of half a radian a period, summed up; the ends' differences are of second order
    np.testing.assert_allclose(attitudes, expected, rtol=0, atol=2e-6)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("t,ax,ay,az,wx,wy\n0,0,0,0,0,0\n", "expected the names of the columns t, ax, ay, az (and, if it turns,"),
        (
            "t,ax,ay,az,qw,qx,qy,qz\n0,0,0,0,0,0,0,0\n1,0,0,0,1,0,0,0\n",
            "line 2: expected a quaternion of unit length, got",
        ),
        (
            "t,ax,ay,az,qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n1,0,0,0,2,0,0,0\n",
            "base_motion.attitudes[1]: expected a quaternion",
        ),
        (
            "t,ax,ay,az,rx,ry,rz\n0,0,0,0,0,0,0\n1,0,0,0,0.6,0,0\n",
            "base_motion.attitudes[1]: expected an attitude within",
        ),
        ("t,ax,ay,az,rx,ry,rz\n0,0,0,0,0,0,0\n0.1,0,0,0,7,0,0\n", "(radians), got one of 7"),
        (
            "t,ax,ay,az,wx,wy,wz\n0,0,0,0,0,0,0\n0.1,0,0,0,90,0,0\n",
            "line 3: expected an angular rate of at most pi in a",
        ),
        (
            "t,ax,ay,az,rx,ry,rz\n0,0,0,0,0,0,0\n0.1,0,0,0,0.1,0,0\n",
            "base_motion.samples: expected a recording of at least",
        ),
    ],
)
def test_bad_recordings_are_refused(sampled: hs.Scenario, tmp_path: Path, text: str, sentence: str) -> None:
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(hs.ScenarioError) as caught:
        sampled.updated({"base_motion": {"kind": "recorded", "file": str(tmp_path / "bad.csv")}})
    assert sentence in str(caught.value)


def test_a_bad_way_of_a_target_is_refused(sampled: hs.Scenario, tmp_path: Path) -> None:
    for text, sentence in (
        ("t,x,y\n0,0,0\n", "line 1: expected the names of the columns t, x, y, z, got 3 fields without z"),
        ("a,b\n0,0\n", "line 1: expected the names of the columns t, x, y, z, got 2 fields"),
        ("t,x,y,z\n0,0,0,0\n1,0,0,0\n3,0,0,0\n", "line 3: expected t = 1.5 (samples every 1.5 s"),
    ):
        (tmp_path / "bad.csv").write_text(text)
        with pytest.raises(hs.ScenarioError) as caught:
            sampled.updated({"target.motion": {"kind": "recorded", "file": str(tmp_path / "bad.csv")}})
        assert sentence in str(caught.value)


# ---- Targets --------------------------------------------------------------------------------------------------------


def seen_by(result: hs.Result, points: Callable[[float], Array]) -> Array:
    """Features of points in B that move, by (4), at the platform's poses."""
    f = result.scenario.camera.focal_length * result.scenario.camera.pixel_scale
    of_platform = in_matrix(result.quaternion)
    features = []
    for t, p, of_b in zip(result.time, result.position, of_platform, strict=True):
        seen = (points(t) - p) @ of_b
        features.append((-f * seen[:, :2] / seen[:, 2:]).ravel())
    return np.array(features)


def points_of(scenario: hs.Scenario) -> Array:
    """The points as they are given: seen from home."""
    f = scenario.camera.focal_length * scenario.camera.pixel_scale
    xy = np.array(scenario.target.initial_features, dtype=float).reshape(4, 2)
    depth = -np.broadcast_to(np.asarray(scenario.target.depth), 4)[:, None]
    return np.asarray(np.array(scenario.robot.home_position) + np.hstack([-depth * xy / f, depth]))


@pytest.mark.parametrize("kind", ["turning", "road"])
def test_a_target_in_the_world_stays_there(sampled: hs.Scenario, kind: str) -> None:
    motion = {"rotation": SWAY["rotation"]} if kind == "turning" else {"kind": "road", "road": {"roughness": "D"}}
    if kind == "turning":
        motion["rotation"] = {**SWAY["rotation"], "amplitude": [0.03, -0.02, 0.025]}
    scenario = sampled.updated({"base_motion": motion, "target.frame": "world"})
    result = hs.simulate(scenario)
    points = points_of(scenario)

    def place(t: float) -> Array:
        where, of_base, _, _, _ = motion_of(scenario, np.array([t]))
        if kind == "turning":
            of_base = Swaying(sampled.updated({"base_motion": {**SWAY, **motion}})).attitude(t)[None]
        return np.asarray((points - where[0]) @ of_base[0])

    desired = np.array(scenario.target.desired_features)
    np.testing.assert_allclose(result.feature_error, desired - seen_by(result, place), rtol=0, atol=1e-9)
    riding = hs.simulate(scenario.updated({"target.frame": "base"}))
    np.testing.assert_allclose(riding.feature_error, desired - seen_by(riding, lambda _: points), rtol=0, atol=1e-9)
    assert np.abs(result.feature_error - riding.feature_error).max() > 1.0


def test_targets_move_as_they_are_told(sampled: hs.Scenario, tmp_path: Path) -> None:
    time = np.linspace(0.0, 0.4, 21)
    way = np.stack([0.01 * np.sin(8 * time), 0.02 * time, -0.01 * time**2], axis=1)
    file = written(tmp_path / "way.csv", {"t": time, **axes("x y z", way)})
    spline = CubicSpline(time, way)
    motions: list[tuple[dict[str, Any], Callable[[float], Array]]] = [
        ({"kind": "velocity", "velocity": [0.02, -0.01, 0.03]}, lambda t: t * np.array([0.02, -0.01, 0.03])),
        (
            {"kind": "sinusoid", "amplitude": [0.01, 0.0, -0.02], "frequency": 2.0, "phase": 0.3},
            lambda t: np.sin(4 * np.pi * t + 0.3) * np.array([0.01, 0.0, -0.02]),
        ),
        ({"kind": "recorded", "file": file}, spline),
    ]
    for every in (20, 10, 5):  # 2, 3 and 5 samples: a straight line, a parabola, and two cubics
        few = {"kind": "recorded", "samples": way[:21:every].tolist(), "sample_period": 0.02 * every}
        motions.append((few, CubicSpline(time[:21:every], way[:21:every])))
    for motion, way_at in motions:
        scenario = sampled.updated({"target.motion": motion})
        assert hs.Scenario.from_yaml(scenario.to_yaml()) == scenario
        result = hs.simulate(scenario)
        points = points_of(scenario)
        expected = seen_by(result, lambda t, way_at=way_at, points=points: points + way_at(t))  # type: ignore[misc]
        desired = np.array(scenario.target.desired_features)
        np.testing.assert_allclose(result.feature_error, desired - expected, rtol=0, atol=1e-9)


def test_displacements_in_python_are_those_of_the_core(sampled: hs.Scenario) -> None:
    motion = {"kind": "sinusoid", "amplitude": [0.01, 0.0, -0.02], "frequency": 2.0, "phase": 0.3}
    scenario = sampled.updated({"target.motion": motion})
    result, points = hs.simulate(scenario), points_of(scenario)
    expected = seen_by(result, lambda t: points + displacements_of(scenario.target.motion, np.array([t])))
    desired = np.array(scenario.target.desired_features)
    np.testing.assert_allclose(result.feature_error, desired - expected, rtol=0, atol=1e-9)


def test_a_road_that_would_roll_the_vehicle_over_is_refused(sampled: hs.Scenario) -> None:
    """Its attitude is a series of the rotation vector, good to 2 pi."""
    road = {"seed": 29, "base_motion": {"kind": "road", "road": {"roughness": "H", "damping": 0.0005}}}  # in resonance
    with pytest.raises(
        ValueError, match=r"base_motion\.road: .* at most 2 pi .*got one that turns it by 16\.\d+ rad with this seed"
    ):
        hs.simulate(sampled.updated(road))
    hs.simulate(sampled.updated({"base_motion": {"kind": "road", "road": {"roughness": "H"}}}))


# ---- Roads ----------------------------------------------------------------------------------------------------------


ROAD: dict[str, Any] = {"speed": 12.0, "wheelbase": 1e-3, "track": 1e-3, "suspension": None}


def heights(sampled: hs.Scenario, roughness: str, seed: int, time: Array) -> Array:
    """Of a rigid vehicle as short as a wheel, which follows its track [m]."""
    road = {"kind": "road", "road": {**ROAD, "roughness": roughness}}
    scenario = sampled.updated({"base_motion": road, "seed": seed})
    return -_core.Probe(core_parameters(scenario)).base_motion(time)[0][:, 2]


@pytest.mark.slow
def test_a_road_has_the_spectrum_of_its_class(sampled: hs.Scenario) -> None:
    """G(f) = G_d(f/v)/v, G_d(n) = G_d(0.1) (n/0.1)^-2, of class C.

    The mean over 160 seeds of the power in a band of spatial frequencies against its integral: within 9 %. The wave of
    a cell that an end of the band cuts, with the share p of the cell's power C inside, is in the band in p of the
    seeds, with all of C. So the standard deviation of a seed is the root of the sum of C^2 p (1 - p) over both ends,
    0.14 to 0.24 of the band's power; of the mean it is 0.24/sqrt(160), 1.9 %, and nearly five of them are allowed.
    """
    speed, seeds, bands, level = ROAD["speed"], 160, np.array([0.02, 0.05, 0.1, 0.3, 1.0, 3.0]), 256e-6
    count, step = 1 << 14, 1.0 / 240.0  # [s]; 68 s, 819 m
    time = np.linspace(0.0, step * (count - 1), count)
    window = np.hanning(count)
    n = np.fft.rfftfreq(count, step) / speed  # [cycles/m]
    power = np.zeros(len(n))
    for seed in range(seeds):
        height = heights(sampled, "C", seed, time)
        power += 2 * step * speed / np.square(window).sum() * np.abs(np.fft.rfft(window * height)) ** 2 / seeds
    for low, high in itertools.pairwise(bands):
        inside = (n >= low) & (n < high)
        found = power[inside].sum() * (n[1] - n[0])
        expected = level * 0.01 * (1 / low - 1 / high)
        assert found == pytest.approx(expected, rel=0.09), (low, high)


@pytest.mark.parametrize(("roughness", "level"), [("A", 16e-6), ("B", 64e-6), ("F", 16e-6 * 4**5)])
def test_classes_of_roads_differ_by_their_level(sampled: hs.Scenario, roughness: str, level: float) -> None:
    time = np.linspace(0.0, 5.0, 200)
    of_c = heights(sampled, "C", 3, time)
    np.testing.assert_allclose(heights(sampled, roughness, 3, time), np.sqrt(level / 256e-6) * of_c, rtol=1e-12)


def test_a_vehicle_follows_the_road_through_its_springs(sampled: hs.Scenario) -> None:
    """Variances against integrals over the road's spectrum, with the geometry and the response as they are documented.

    K waves of random phase: over 120 seeds and a random time each the sample variance of a Gaussian sum has a relative
    standard deviation of sqrt(2/(120 * 8)), 4.6 %, with 8 independent times each; five of them are allowed.
    """
    from scipy.special import k1

    road = {"roughness": "C", "speed": 15.0, "wheelbase": 2.5, "track": 1.6, "suspension": 1.4, "damping": 0.25}
    samples = []
    for seed in range(120):
        scenario = sampled.updated({"base_motion": {"kind": "road", "road": road}, "seed": 1000 + seed})
        place, attitude, _, _, acceleration = motion_of(scenario, np.linspace(40.0, 721.1, 8))
        vector = Rotation.from_matrix(attitude).as_rotvec()
        samples.append(np.column_stack([place[:, 2], acceleration[:, 2], vector]))
    variance = np.square(np.concatenate(samples)).mean(axis=0)

    n = np.geomspace(0.01, 10.0, 200_001)
    density = 256e-6 * 0.01 / n**2
    f = 15.0 * n
    r = f / 1.4
    follows = (1 + 0.25j * 2 * r) / (1 - r**2 + 0.25j * 2 * r)
    passed = density * np.abs(follows) ** 2
    x = 2 * np.pi * n * 1.6
    both, apart = 0.5 * (1 + x * k1(x)), 0.5 * (1 - x * k1(x))
    along = np.pi * n * 2.5
    expected = [
        np.trapezoid(passed * both * np.cos(along) ** 2, n),
        np.trapezoid(passed * both * np.cos(along) ** 2 * (2 * np.pi * f) ** 4, n),
        np.trapezoid(passed * apart * np.cos(along) ** 2 * (2 / 1.6) ** 2, n),
        np.trapezoid(passed * both * np.sin(along) ** 2 * (2 / 2.5) ** 2, n),
    ]
    np.testing.assert_allclose(variance[:4], expected, rtol=0.23)
    assert variance[4] <= 1e-30  # a vehicle that follows its lane does not yaw


def test_a_place_on_the_vehicle_is_carried_by_its_rotation(sampled: hs.Scenario) -> None:
    position = np.array([1.2, -0.3, -0.9])
    time = np.linspace(0.0, 2.0, 41)
    road: dict[str, Any] = {"roughness": "E", "speed": 8.0}
    middle = motion_of(sampled.updated({"base_motion": {"kind": "road", "road": road}}), time)
    road["position"] = position.tolist()
    there = motion_of(sampled.updated({"base_motion": {"kind": "road", "road": road}}), time)
    np.testing.assert_array_equal(there[1], middle[1])
    np.testing.assert_allclose(there[0], middle[0] + middle[1] @ position - position, rtol=0, atol=1e-15)


# ---- Runs, batches, seeds and what is refused ------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["sinusoid", "noise", "road"])
def test_batches_and_runs_agree(sampled: hs.Scenario, kind: str) -> None:
    motion: dict[str, Any] = SWAY
    if kind == "noise":
        motion = {"kind": "noise", "level": 1e-3, "rotation": {"kind": "noise", "level": 1e-5}}
    elif kind == "road":
        motion = {"kind": "road", "road": {"roughness": "B"}}
    scenario = sampled.updated({"base_motion": motion, "target.frame": "world", "simulation.duration": 0.05})
    seeds = np.arange(7, dtype=np.uint64)
    speed = np.linspace(5.0, 20.0, 7)
    varied = {"seed": seeds, "base_motion.road.speed": speed}
    batch = hs.simulate_batch(scenario, varied, threads=1)
    errors = []
    for index in range(7):
        run = hs.simulate(scenario.updated({"seed": index, "base_motion.road.speed": float(speed[index])}))
        assert batch.metrics["final_error"][index] == pytest.approx(hs.metrics(run)["final_error"], rel=1e-9)
        errors.append(hs.metrics(run)["final_error"])
    assert (len(set(errors)) == 1) == (kind == "sinusoid")


def test_the_rough_road_is_as_rough_as_it_is_described() -> None:
    """RMS of B's acceleration along x, y and z [m/s^2], and of its tilt [deg], as means over 40 seeds."""
    scenario, time = hs.load_scenario("rough-road"), np.linspace(0.0, 5.0, 501)
    squares = []
    for seed in range(40):
        _, attitude, _, _, acceleration = motion_of(scenario.updated({"seed": seed}), time)
        tilt = np.degrees(np.arccos(np.clip(attitude[:, 2, 2], -1.0, 1.0)))
        squares.append(np.mean(np.square(np.column_stack([acceleration, tilt])), axis=0))
    *accelerations, tilt = re.findall(r"\d\.\d+", scenario.description)
    found = np.sqrt(squares).mean(axis=0)
    assert [f"{value:.2f}" for value in found] == [*accelerations, tilt]


def test_the_seed_draws_the_road(sampled: hs.Scenario) -> None:
    road = sampled.updated({"base_motion": {"kind": "road"}, "seed": 5})
    time = np.linspace(0.0, 1.0, 11)
    one, same = motion_of(road, time), motion_of(road.updated({"camera.noise": 0.5}), time)
    for a, b in zip(one, same, strict=True):
        np.testing.assert_array_equal(a, b)
    assert np.abs(motion_of(road.updated({"seed": 6}), time)[0] - one[0]).max() > 1e-4


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"base_motion.rotation": {"kind": "sinusoid", "amplitude": [4, 0, 0]}}, "of at most pi (radians), got 4 rad"),
        ({"base_motion.rotation": {"kind": "sinusoid", "frequency": 2001.0}}, "base_motion.rotation.frequency[0]"),
        (  # a sine of half the step rate is zero at every step
            {"target.motion": {"kind": "sinusoid", "frequency": 2000.0}},
            "target.motion.frequency: expected a number from 0 to below 2000 Hz",
        ),
        ({"base_motion.rotation": {"kind": "noise", "low_frequency": 20}}, "base_motion.rotation.low_frequency: exp"),
        (
            {"base_motion.rotation": {"kind": "noise", "high_frequency": 3.5, "level": [0, 0, 1]}},
            "base_motion.rotation.level: expected levels whose rotation vector stays within 2 pi (radians), at most 0.",
        ),
        ({"base_motion": {"kind": "road", "rotation": {"kind": "noise"}}}, "base_motion.rotation.kind: expected none"),
        ({"base_motion": {"kind": "road", "road": {"speed": 300.0}}}, "base_motion.road.shortest: expected at least"),
        ({"base_motion": {"kind": "road", "road": {"shortest": 200.0}}}, "base_motion.road.shortest: expected a wave"),
        ({"base_motion.road.roughness": "I"}, 'base_motion.road.roughness: expected one of "A"'),
        ({"base_motion": {"kind": "sinusoid", "frequency": 0}, "target.frame": "world"}, "base_motion.frequency: "),
        ({"base_motion": {"kind": "noise", "low_frequency": 0}, "target.frame": "world"}, "base_motion.low_frequency"),
        (
            {"camera.convention": "as_printed", "target.frame": "world"},
            "target.frame: expected base for a camera as_pri",
        ),
        (
            {"camera.convention": "as_printed", "target.motion.kind": "velocity"},
            "target.motion.kind: expected none for",
        ),
        ({"target.motion": {"kind": "recorded"}}, "target.motion.file: expected the path of a CSV file"),
        ({"target.motion": {"kind": "sinusoid", "amplitude": [0, 0, 2.0], "phase": 1.57}}, "target.motion: expected"),
        ({"base_motion.attitudes": [[1, 0, 0, 0], [1, 0, 0, 0]]}, "base_motion.samples: expected accelerations beside"),
        ({"base_motion.frame_of_acceleration": "specific_force"}, "base_motion.frame_of_acceleration: expected"),
    ],
)
def test_what_is_refused(sampled: hs.Scenario, changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(hs.ScenarioError) as caught:
        sampled.updated(changes)
    assert sentence in str(caught.value)


def test_specific_forces_of_a_base_that_turns_need_its_attitudes(sampled: hs.Scenario, tmp_path: Path) -> None:
    time = np.arange(0.0, 1.0, 0.01)
    file = written(tmp_path / "rest.csv", {"t": time, **axes("ax ay az", np.tile([0.0, 0.0, -9.8], (len(time), 1)))})
    still = {"kind": "recorded", "file": file, "frame_of_acceleration": "specific_force"}
    assert not np.any(sampled.updated({"base_motion": still}).base_motion.samples)
    turning = {**still, "rotation": {"kind": "sinusoid", "amplitude": [0.1, 0.0, 0.0], "frequency": 0.5}}
    with pytest.raises(hs.ScenarioError, match=r"^base_motion\.frame_of_acceleration: expected kinematic"):
        sampled.updated({"base_motion": turning})


def test_what_a_recording_is_has_to_be_told_again_with_another_one(sampled: hs.Scenario, tmp_path: Path) -> None:
    """What was read is kinematic, so that neither a new file's frame nor a second removal of gravity is guessed."""
    time = np.arange(0.0, 1.0, 0.01)
    file = written(tmp_path / "rest.csv", {"t": time, **axes("ax ay az", np.tile([0.0, 0.0, -9.8], (len(time), 1)))})
    force = {"base_motion.frame_of_acceleration": "specific_force"}
    at_rest = sampled.updated({"base_motion": {"kind": "recorded", "file": file}, **force})
    for again in ({"base_motion.file": file}, {"base_motion": {"file": file}}):
        with pytest.raises(hs.ScenarioError, match=r"frame_of_acceleration: expected it beside base_motion\.file"):
            at_rest.updated(again)
        assert at_rest.updated({**again, **force}) == at_rest
    kinematic = {"base_motion.samples": [[1.0, 0.0, 0.0]] * 100}
    with pytest.raises(hs.ScenarioError, match=r"frame_of_acceleration: expected it beside base_motion\.samples"):
        at_rest.updated(kinematic)
    assert at_rest.updated({**kinematic, "base_motion.frame_of_acceleration": "kinematic"}) != at_rest
    with pytest.raises(hs.ScenarioError, match="gravity would be taken out twice"):
        at_rest.updated(force)


def test_continuous_mode_refuses_motion(paper: hs.Scenario) -> None:
    for key, value in (("target.frame", "world"), ("target.motion.kind", "velocity"), ("base_motion.kind", "road")):
        with pytest.raises(hs.ScenarioError, match=f"{key}: has no effect in continuous mode"):
            paper.updated({key: value})


@pytest.mark.parametrize(
    ("changes", "at_rest", "in_runs"),
    [
        ({}, [], []),
        (
            {"base_motion": SWAY},
            ["The base is taken at rest; in this scenario it moves."],
            ["In all runs the base moves as in the scenario."],
        ),
        (
            {"target.motion.kind": "velocity"},
            ["The target is taken at rest; in this scenario it moves."],
            ["In all runs the target moves as in the scenario."],
        ),
        (
            {"base_motion": SWAY, "target.motion.kind": "velocity"},
            ["Base and target are taken at rest; in this scenario both move."],
            ["In all runs base and target move as in the scenario."],
        ),
    ],
)
def test_analyses_state_what_they_take_at_rest(
    changes: dict[str, object], at_rest: list[str], in_runs: list[str], sampled: hs.Scenario
) -> None:
    scenario = sampled.updated({**changes, "simulation.duration": 0.02})
    found = hs.analyse(
        scenario.updated({"controller.law": "composite"}), ["conditioning", "equilibria", "largest_start"]
    )
    stated = {
        section.name: [
            sentence for sentence in section.sentences if "in this scenario" in sentence or "In all" in sentence
        ]
        for section in found.sections()
    }
    assert stated["conditioning"] == at_rest
    assert stated["equilibria"] == []  # not for this law: nothing was computed
    assert stated["largest_start"] == in_runs


def test_a_diagnosis_names_the_motion_that_makes_a_run_fail(sampled: hs.Scenario) -> None:
    rolling = {"kind": "sinusoid", "amplitude": [0.3, 0.2, 0.0], "frequency": 1.5}
    away = {"kind": "velocity", "velocity": [0.05, 0.0, 0.0]}
    for changes, cause in (
        ({"base_motion.rotation": rolling}, "base_motion"),
        ({"target.motion": away}, "target_motion"),
        ({"base_motion.rotation": {**rolling, "amplitude": [0.03, 0.02, 0.0]}, "target.frame": "world"}, "base_motion"),
    ):
        result = hs.simulate(sampled.updated({**changes, "simulation": {"duration": 2.0, "substeps": 1}}))
        assert hs.diagnose(result).causes[0].cause == cause


def test_a_small_acceleration_is_ordinary_only_where_the_target_rides_on_the_base(sampled: hs.Scenario) -> None:
    """0.05 m/s^2 at 0.1 Hz is 0.13 m either way, by which a base leaves a target in the world behind."""
    slow = {"kind": "sinusoid", "amplitude": [0.05, 0.0, 0.0], "frequency": 0.1}
    scenario = sampled.updated({"base_motion": slow, "simulation": {"duration": 2.0, "substeps": 1}})
    assert not hs.diagnose(hs.simulate(scenario)).failed
    diagnosis = hs.diagnose(hs.simulate(scenario.updated({"target.frame": "world"})))
    assert [finding.cause for finding in diagnosis.named] == ["base_motion"]


def test_a_moving_target_has_no_certificate(sampled: hs.Scenario) -> None:
    for changes in ({"target.motion": {"kind": "velocity"}}, {"target.frame": "world", "base_motion": SWAY}):
        certificate = hs.certify(hs.simulate(sampled.updated({**changes, "simulation.duration": 0.02})))
        assert "not certified: the target" in str(certificate).lower()
