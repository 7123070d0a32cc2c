"""Comparisons of parts: the plant alone, one fuzzy system, image Jacobian and control law."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

import hexservo as hs
from hexservo import _core
from hexservo.scenario.parameters import core_parameters
from kernels import running
from problem import Array
from rows import Row, WrongAnswerError, attempt, largest_difference, require, version_of
from timing import alternate, python_block

MINIMUM = 0.05  # [s] of a timed block
BUILT = "see the output of CMake at the start"
FUZZYLITE = "on Debian, apt-get install libfuzzylite-dev gives the library"
VISP = "on Debian, apt-get install libvisp-vs-dev gives the library"
HOME_ATTITUDE = np.array([1.0, 0.0, 0.0, 0.0])


def _plant(row: Row, rounds: int) -> None:
    from mujoco_plant import CorePlant, MujocoPlant

    step, steps = 1e-4, 3000
    robot = _core.robot_preset("micro")
    hexapod = _core.Hexapod(robot)
    weight = np.array([0.0, 0.0, -9.8 * robot.mass, 0.0, 0.0, 0.0])
    unequal = 1e-3 * np.array([20.0, 9.0, 19.0, 12.0, 20.0, 4.0])  # [N], so that the platform moves and turns
    forces = hexapod.leg_forces(hexapod.home_position, HOME_ATTITUDE, weight) + unequal
    peer, own = MujocoPlant(robot, forces, step, steps), CorePlant(robot, forces, step, steps)
    row.version = version_of("mujoco")
    require(row, largest_difference(peer.run(), own.run()), 1e-8, "m and quaternion, after 0.3 s")
    row.comparison = alternate(python_block(peer.run, steps, MINIMUM), python_block(own.run, steps, MINIMUM), rounds)


def _fuzzy(row: Row, rounds: int) -> None:
    random = np.random.default_rng(1)
    weights = random.uniform(-1, 1, 49)
    inputs = random.uniform(-1, 1, (960, 2))
    bells = np.array([1 / 6, 2.0])
    with (
        running("fuzzylite_system", None, np.concatenate([bells, weights]), inputs, FUZZYLITE) as peer,
        running("hexservo_functions", "fuzzy", weights, inputs.reshape(160, 12), BUILT) as own,
    ):
        row.version = peer.version
        difference = largest_difference(peer.answers().ravel(), own.answers().ravel())
        require(row, difference, 1e-12, "(weights up to 1)")
        row.comparison = alternate(peer.block(MINIMUM), own.block(MINIMUM, units_per_row=6), rounds)


def _images(scenario: hs.Scenario, count: int) -> tuple[Array, Array]:
    """Features (count, 4, 2) [px] and depths (count, 4) [m] near those of the scenario."""
    random = np.random.default_rng(2)
    start = np.reshape(np.asarray(scenario.target.initial_features, dtype=float), (4, 2))
    return start + random.uniform(-10, 10, (count, 4, 2)), random.uniform(-0.55, -0.45, (count, 4))


# ViSP's camera looks along +z. Rotating E by 180 degrees about x gives it: (X, Y, Z) -> (X, -Y, -Z), so that its
# normalised coordinates are (x, -y)/f, its depth -Z, and its twists have four signs changed.
IMAGE_SIGNS = np.array([1.0, -1.0])
TWIST_SIGNS = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
GAIN = 0.5  # lambda [1/s]


def _visp_inputs(scenario: hs.Scenario, features: Array, depth: Array) -> tuple[Array, Array]:
    """Parameters and rows of visp/law.cpp."""
    focal = core_parameters(scenario).camera.focal_pixels
    desired = np.reshape(np.asarray(scenario.target.desired_features, dtype=float), (4, 2)) * IMAGE_SIGNS / focal
    rows = np.concatenate([features * IMAGE_SIGNS / focal, -depth[:, :, None]], axis=2).reshape(len(features), 12)
    return np.concatenate([[GAIN], desired.ravel()]), rows


def _jacobian(row: Row, rounds: int) -> None:
    scenario = hs.load_scenario("paper")
    features, depth = _images(scenario, 200)
    parameters, rows = _visp_inputs(scenario, features, depth)
    focal = core_parameters(scenario).camera.focal_pixels
    desired = np.broadcast_to(np.asarray(scenario.target.desired_features, dtype=float), (len(rows), 8))
    own_rows = np.concatenate([features, depth[:, :, None]], axis=2).reshape(len(rows), 12)
    with (
        running("visp_law", "jacobian", parameters, rows, VISP) as peer,
        running(
            "hexservo_functions", "jacobian", np.array([focal]), np.concatenate([own_rows, desired], axis=1), BUILT
        ) as own,
    ):
        row.version = peer.version
        theirs, ours = peer.answers(), own.answers()
        signs = np.tile(IMAGE_SIGNS, 4)
        J = ours[:, :48].reshape(-1, 8, 6)  # noqa: N806
        expected = signs[:, None] * J * TWIST_SIGNS / focal
        require(row, largest_difference(theirs[:, :48].reshape(-1, 8, 6), expected), 1e-12, "of L (normalised image)")
        # s - s* is minus our feature error
        require(row, largest_difference(theirs[:, 48:], -signs * ours[:, 48:] / focal), 1e-14, "of s - s*")
        row.comparison = alternate(peer.block(MINIMUM), own.block(MINIMUM), rounds)


def _law(row: Row, rounds: int) -> None:
    scenario = hs.load_scenario("paper")
    settings = core_parameters(scenario)
    features, depth = _images(scenario, 200)
    count = len(features)
    parameters, rows = _visp_inputs(scenario, features, depth)
    random = np.random.default_rng(3)
    position = settings["robot.home_position"] + random.uniform(-5e-3, 5e-3, (count, 3))
    quaternion = HOME_ATTITUDE + random.uniform(-0.05, 0.05, (count, 4))
    twist = random.uniform(-0.05, 0.05, (count, 6))
    seen = features.reshape(count, 8)
    goals = np.concatenate([settings["target.desired_features"], settings["target.initial_features"]])
    with (
        running("visp_law", "velocity", parameters, rows, VISP) as peer,
        running(
            "hexservo_functions",
            "tick",
            goals,
            np.concatenate([seen, depth, position, quaternion, twist], axis=1),
            BUILT,
        ) as own,
    ):
        row.version = peer.version
        # In E, v = lambda pinv(J) (xi_d - xi) with our J: ViSP's law on our Jacobian.
        expected = np.array(
            [
                GAIN
                * np.linalg.pinv(_core.image_jacobian(settings.camera, xi, z, HOME_ATTITUDE))
                @ (settings["target.desired_features"] - xi)
                for xi, z in zip(seen, depth, strict=True)
            ]
        )
        scale = float(np.abs(expected).max())
        difference = largest_difference(peer.answers() * TWIST_SIGNS, expected) / scale
        require(row, difference, 1e-9, "of the largest velocity, from pinv(J) of our J")
        controller = _core.Controller(settings, 1e-3)
        wrenches = np.array(
            [controller.step(*numbers)[0] for numbers in zip(seen, depth, position, quaternion, twist, strict=True)]
        )
        if not largest_difference(own.answers(), wrenches) <= 1e-12:
            raise WrongAnswerError("the timed tick and hs.Controller differ")
        row.comparison = alternate(peer.block(MINIMUM), own.block(MINIMUM), rounds)


def part_rows(rounds: int) -> Iterator[Row]:
    """Compare the parts with their peers."""
    yield attempt(
        Row("plant alone", "step", "MuJoCo", "spatial tendons, RK4, one mj_step for all", "_core.drive_legs, RK4"),
        partial(_plant, rounds=rounds),
        "make bench-peers installs it (pip install --group peers)",
    )
    yield attempt(
        Row(
            "one fuzzy system, 49 rules",
            "system",
            "fuzzylite",
            "Engine::process",
            "fuzzy_basis and output, six at once, / 6",
        ),
        partial(_fuzzy, rounds=rounds),
        BUILT,
    )
    yield attempt(
        Row(
            "image Jacobian and error",
            "evaluation",
            "ViSP",
            "computeInteractionMatrix, computeError",
            "ImageJacobian::matrix",
        ),
        partial(_jacobian, rounds=rounds),
        BUILT,
    )
    yield attempt(
        Row(
            "control law",
            "evaluation",
            "ViSP",
            "computeControlLaw: velocity by pseudo-inverse",
            "step: the whole tick, wrench, fuzzy systems and leg forces included",
        ),
        partial(_law, rounds=rounds),
        BUILT,
    )
