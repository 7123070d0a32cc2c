"""The linearised plant and loop of a scenario as ``control.StateSpace`` (docs/bridges.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from hexservo.bridges.extras import extra
from hexservo.findings.analysis.linear_law import linear_plant, rest_of
from hexservo.findings.analysis.loop_of_scenario import (
    LoopAtRest,
    clock_of,
    loop_at_rest,
    loop_before_moving_target,
    quiet,
    require_forces,
    side_of_target,
    with_features,
)
from hexservo.findings.analysis.scene import scene_of
from hexservo.scenario.arrays import Array
from hexservo.scenario.scenario import Scenario, require_scenario
from hexservo.scenario.wording import wrong_type

if TYPE_CHECKING:
    from control import StateSpace

    from hexservo.findings.analysis.linear_law import LinearPlant, RestPose

_AXES = ("x", "y", "z", "rx", "ry", "rz")
_WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
_INPUTS = (
    *(f"wrench_{axis}" for axis in _WRENCH),
    *(f"base_acceleration_{axis}" for axis in "xyz"),
    *(f"target_{axis}" for axis in _AXES),
)


def control(scenario: Scenario, of: Literal["loop", "plant"] = "loop", *, sampled: bool | None = None) -> StateSpace:
    """Return a scenario's linearised plant, or its closed loop, for python-control.

    It is the linearisation of `hexservo analyse`, by differences of the core about the pose at which the loop rests:
    its matrices, and so its eigenvalues, are those of the analysis. Where the switching term has a slope at rest
    (``tanh``, ``saturation``) it acts with that, else K_v = 0. Then the response of the loop is that to disturbances
    well above K_v: of smaller ones the switching term takes most away.

    Parameters
    ----------
    scenario
        Any whose machine takes forces, with a law of viscous damping and a camera that projects. Noise, faults and
        limits do not act, nor does ``uncertainty.gravity``.
    of
        "loop": inputs are disturbances; "plant": the platform without a law, whose inputs are wrench and base
        acceleration.
    sampled
        True: a system with ``dt``; of the plant one tick (``simulation.step``), with inputs that are constant over it;
        of the loop one pattern of all clocks (servo, camera, joint sensors), with disturbances that are constant over
        it. False: a continuous one, which a loop has only without latencies, periods and devices. None: as the
        scenario's mode is.

    Returns
    -------
    control.StateSpace
        Inputs ``wrench_fx`` ... ``wrench_mz`` [N; N m], beyond the weight, and ``base_acceleration_x`` ... [m/s^2], in
        B, of a base that carries the target along, and ``target_x`` ... ``target_rz`` [m; rad], displacement of the
        target as a rigid body, in B, about the platform's origin at rest: of a camera on the platform ``pose`` is equal
        to it where the features are at rest again. Outputs ``feature_1x``, ``feature_1y``, ... [px] and ``pose_x`` ...
        ``pose_rz`` [m; rad], displacement from rest in B. States begin with ``x_...`` (displacement) and ``v_...``
        (twist); those of the loop go on with the fuzzy systems that learn, sensors, commands and frames under way, each
        with the sensors' error there where the law predicts.

    Raises
    ------
    ImportError
        Without python-control; the extra ``control`` installs it.
    TypeError
        For anything but a `Scenario`, and for `sampled` that is neither a boolean nor None.
    ValueError
        Where the linear analysis does not apply, with the reason, and for a continuous loop with latencies, periods
        or devices.
    """
    library = extra("control", "control")
    require_scenario(scenario)
    if of not in ("loop", "plant"):
        raise ValueError(f"of: expected loop or plant, got {of!r}")
    if sampled is not None and not isinstance(sampled, bool | np.bool_):
        raise wrong_type("sampled", "True, False or None", sampled)
    discrete = scenario.sampled if sampled is None else sampled
    if of == "plant":
        rest, plant, tick = _resting(scenario)
        a, b = _plant(plant)
        names = _state_names(12)
        if discrete:
            # the double integrator under constant inputs, exactly
            a, b = _held(a, b, tick)
        dt = tick if discrete else 0.0
    else:
        at_rest = loop_at_rest(scenario)
        rest = at_rest.rest
        a, b, dt = _sampled_loop(at_rest) if discrete else _continuous_loop(at_rest)
        names = _state_names(len(a))
    c = np.zeros((len(rest.view.features) + 6, len(a)))
    c[:-6, :6] = rest.view.jacobian
    c[-6:, :6] = np.eye(6)
    d = np.zeros((len(c), len(_INPUTS)))
    d[:-6, -6:] = -side_of_target(scenario) * rest.view.jacobian
    points = len(rest.view.features) // 2
    outputs = [f"feature_{i}{axis}" for i in range(1, points + 1) for axis in "xy"] + [f"pose_{axis}" for axis in _AXES]
    return library.ss(
        a,
        b,
        c,
        d,
        dt,
        inputs=list(_INPUTS),
        outputs=outputs,
        states=names,
        name=f"{scenario.name} {of}".replace(".", "_"),
        remove_useless_states=False,
    )


def _resting(scenario: Scenario) -> tuple[RestPose, LinearPlant, float]:
    require_forces(scenario)
    scenario = with_features(scenario)
    calm = quiet(scenario)
    rest = rest_of(calm, scene_of(scenario))
    return rest, linear_plant(calm, rest.view.pose), float(calm.simulation.step)


def _disturbance(acceleration: Array) -> Array:
    """Return the wrench of each input but the target's, (6, 9): an accelerating base acts as a weight does."""
    return np.hstack([np.eye(6), -np.linalg.inv(acceleration)[:, :3]])


def _plant(plant: LinearPlant) -> tuple[Array, Array]:
    a, b = np.zeros((12, 12)), np.zeros((12, len(_INPUTS)))
    a[:6, 6:] = np.eye(6)
    b[6:, :-6] = plant.acceleration @ _disturbance(plant.acceleration)
    return a, b


def _held(a: Array, b: Array, tick: float) -> tuple[Array, Array]:
    return np.eye(12) + tick * a, tick * b + 0.5 * tick**2 * a @ b


def _sampled_loop(at_rest: LoopAtRest) -> tuple[Array, Array, float]:
    loop, clock = (
        loop_before_moving_target(at_rest, _disturbance(at_rest.free.acceleration)),
        clock_of(at_rest.scenario),
    )
    return *loop.driven(clock), loop.seconds(clock)


def _continuous_loop(at_rest: LoopAtRest) -> tuple[Array, Array, float]:
    """Return the loop whose law acts at every time: the limit of short ticks."""
    wrenches = _disturbance(at_rest.free.acceleration)
    loop, clock = loop_before_moving_target(at_rest, wrenches), clock_of(at_rest.scenario)
    if not at_rest.as_if_sampled and (clock.period > 1 or clock.latency > 0 or loop.has_devices):
        raise ValueError(
            "sampled: expected True for a loop with latencies, periods or devices, got False; "
            "its continuous limit is another loop"
        )
    axes, n = list(loop.axes), 6
    m = len(axes)
    a = np.zeros((2 * n + m, 2 * n + m))
    a[:n, n : 2 * n] = np.eye(n)
    command = np.zeros((n, 2 * n + m))
    command[:, :n] = loop.frame[:, :n] + loop.pose
    command[:, n : 2 * n] = loop.twist
    command[axes, range(2 * n, 2 * n + m)] = -1.0
    a[n : 2 * n] = loop.acceleration @ command
    a[2 * n :, :n] = (loop.drive_frame[:, :n] + loop.drive_pose) / loop.tick
    a[2 * n :, n : 2 * n] = loop.drive_twist / loop.tick
    a[range(2 * n, 2 * n + m), range(2 * n, 2 * n + m)] = (loop.decay - 1.0) / loop.tick
    b = np.zeros((len(a), len(_INPUTS)))
    b[n : 2 * n, :-n] = loop.acceleration @ wrenches
    by_target = [
        side_of_target(at_rest.scenario) * ((part[:, n:] if part.shape[1] > n else 0.0) - part[:, :n])
        for part in (loop.frame, loop.drive_frame)
    ]
    b[n : 2 * n, -n:] = loop.acceleration @ by_target[0]
    b[2 * n :, -n:] = by_target[1] / loop.tick
    return a, b, 0.0


def _state_names(count: int) -> list[str]:
    first = [*(f"x_{axis}" for axis in _AXES), *(f"v_{axis}" for axis in _AXES)]
    return first + [f"loop_{i}" for i in range(1, count - len(first) + 1)]
