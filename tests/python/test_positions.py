"""Machines that take positions: legs, efforts and laws, against SciPy, MuJoCo and finite differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import hexservo as hs
import rotary_machine
from hexservo import _core
from hexservo.run import variant
from hexservo.scenario.laws import LAWS
from hexservo.scenario.parameters import core_parameters

Array = NDArray[np.float64]
RESPONSE = "actuators.position"


def positioned(base: hs.Scenario, **changes: Any) -> hs.Scenario:
    """A scenario on a machine that takes positions; the changes' "__" stands for "."."""
    return base.updated(
        {
            "simulation.mode": "sampled",
            "controller.switching.kind": "implicit",
            "actuators.kind": "position",
            f"{RESPONSE}.bandwidth": 60.0,
            "metrics.rms_start": 0.0,
            **{key.replace("__", "."): value for key, value in changes.items()},
        }
    )


@pytest.fixture
def baseline(monkeypatch: pytest.MonkeyPatch) -> None:
    """The variant that the recorded ticks are of."""
    monkeypatch.setattr(variant, "_CHOSEN", variant.load_kernel("baseline"))


def commands(scenario: hs.Scenario) -> Array:
    return np.asarray(_core.recorded_ticks(core_parameters(scenario))["leg_positions"])


def followed(scenario: hs.Scenario, wanted: Array, start: Array) -> Array:
    """Where two of the legs are at every tick, by SciPy: limits begin and end to act at events, between which the
    motion is smooth: free, at a limit of the acceleration, or at one of the speed."""
    response, tick = scenario.actuators.position, scenario.simulation.step
    w, zeta = 2 * np.pi * response.bandwidth, response.damping
    fastest, most = response.speed_limit or np.inf, response.acceleration_limit or np.inf
    delay = round(scenario.actuators.delay / tick)
    out = np.tile(start, (len(wanted), 1))

    def segment(x: float, v: float, goal: float, left: float) -> tuple[float, float, float]:
        """Move until an event, or to the end of the tick; return position, speed and the time that was taken."""

        def free(y: Array) -> float:
            return float(w**2 * (goal - y[0]) - 2 * zeta * w * y[1])

        acceleration = free(np.array([x, v]))
        sign = np.sign(acceleration)
        # Where one way of moving changes into another, what the acceleration does next decides.
        jerk = -(w**2) * v - 2 * zeta * w * acceleration
        cruises = abs(v) >= fastest * (1 - 1e-12) and acceleration * np.sign(v) > 1e-9 * w**2
        over = abs(acceleration) / most - 1
        limited = over > 1e-9 or (over > -1e-9 and sign * jerk > 0)

        def rate(_: float, y: Array) -> list[float]:
            return [y[1], 0.0 if cruises else sign * most if limited else free(y)]

        def leaves_speed(_: float, y: Array) -> float:
            return float(sign * free(y))

        def reaches_speed(_: float, y: Array) -> float:
            return fastest - abs(float(y[1]))

        def crosses_limit(_: float, y: Array) -> float:
            return abs(free(y)) - most

        events: list[Any] = [leaves_speed] if cruises else []
        if not cruises and np.isfinite(fastest):
            events.append(reaches_speed)
        if not cruises and np.isfinite(most):
            events.append(crosses_limit)
        for event in events:
            event.terminal, event.direction = True, -1
        if not limited:
            crosses_limit.direction = 1  # type: ignore[attr-defined]
        run = solve_ivp(
            rate, (0.0, left), [x, v], method="DOP853", rtol=1e-11, atol=1e-15, events=events, max_step=tick / 16
        )
        return float(run.y[0, -1]), float(np.clip(run.y[1, -1], -fastest, fastest)), float(run.t[-1])

    for leg in (0, 3):
        x, v = start[leg], 0.0
        for k in range(len(wanted)):
            out[k, leg] = x
            goal = wanted[k - delay, leg] if k >= delay else start[leg]
            left = tick
            for _ in range(20):  # events of a tick
                x, v, taken = segment(x, v, goal, left)
                left -= taken
                if left <= 1e-15:
                    break
            assert left <= 1e-9
    return out


@pytest.mark.parametrize("machine", ["prismatic", "rotary"])
@pytest.mark.parametrize(
    ("limits", "tolerance"),
    [
        ({}, 2e-11),  # exact; SciPy's own tolerance, in a coordinate of 0.2
        ({"speed_limit": 0.03, "acceleration_limit": 0.4}, 1e-8),  # of second order in a step of 1/32 ms
    ],
    ids=["free", "limits"],
)
@pytest.mark.usefixtures("baseline")
def test_legs_follow_their_commands_as_scipy_integrates_them(
    paper: hs.Scenario, machine: str, limits: dict[str, float], tolerance: float
) -> None:
    base = paper if machine == "prismatic" else rotary_machine.machine()
    scale = 1.0 if machine == "prismatic" else 20.0  # of angles against lengths
    scenario = positioned(
        base,
        simulation__duration=0.12,
        simulation__substeps=4,
        actuators__delay=0.002,
        actuators__position={
            "bandwidth": 25.0,
            "damping": 0.6,
            **{name: scale * limit for name, limit in limits.items()},
        },
    )
    result = hs.simulate(scenario)
    assert result.outcome == "completed"
    wanted = commands(scenario)
    expected = followed(scenario, wanted, result.leg_lengths[0])
    moved = float(np.abs(expected - expected[0]).max())
    error = float(np.abs(result.leg_lengths - expected)[:, [0, 3]].max())
    print(f"{machine}: legs move {moved:.3g}, error {error:.2g}")
    assert moved > 5e-4
    assert error <= tolerance * scale


@pytest.mark.usefixtures("baseline")
def test_a_leg_is_mujoco_s_position_actuator_on_a_mass() -> None:
    """kp = m w^2, kv = 2 zeta m w and a force range of m a_max, on six masses that slide."""
    mujoco = pytest.importorskip("mujoco")
    scenario = positioned(
        hs.load_scenario("paper"),
        simulation__duration=0.2,
        simulation__substeps=4,
        actuators__position={"bandwidth": 20.0, "damping": 0.7, "acceleration_limit": 0.5},
    )
    result, wanted = hs.simulate(scenario), commands(scenario)
    mass, w = 0.3, 2 * np.pi * 20.0
    bodies = "".join(
        f'<body pos="0 {leg} 0"><joint name="j{leg}" type="slide" axis="1 0 0"/>'
        f'<geom type="sphere" size="0.01" mass="{mass}" contype="0" conaffinity="0"/></body>'
        for leg in range(6)
    )
    drives = "".join(
        f'<position joint="j{leg}" kp="{mass * w**2!r}" kv="{2 * 0.7 * mass * w!r}" '
        f'forcerange="{-mass * 0.5!r} {mass * 0.5!r}"/>'
        for leg in range(6)
    )
    per_tick = 40
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option gravity="0 0 0" integrator="RK4" timestep="{1e-3 / per_tick!r}"/>'
        f"<worldbody>{bodies}</worldbody><actuator>{drives}</actuator></mujoco>"
    )
    data = mujoco.MjData(model)
    start = result.leg_lengths[0]
    error = 0.0
    for k in range(len(wanted)):
        error = max(error, float(np.abs(start + data.qpos - result.leg_lengths[k]).max()))
        data.ctrl[:] = wanted[k] - start
        for _ in range(per_tick):
            mujoco.mj_step(model, data)
    print(f"legs move {np.abs(result.leg_lengths - start).max():.3g} m, error {error:.2g} m")
    assert (
        error <= 1e-7
    )  # a command at every tick has two kinks; both meet them to second order, in steps of about 30 us


@pytest.mark.parametrize("machine", ["prismatic", "rotary"])
@pytest.mark.usefixtures("baseline")
def test_efforts_are_those_of_the_motion(machine: str) -> None:
    """D a + C v + G - base, with the plant's errors, where a is the difference quotient of the twists."""
    base = hs.load_scenario("paper") if machine == "prismatic" else rotary_machine.machine()
    scenario = positioned(
        base,
        simulation__duration=0.1,
        simulation__step=1e-4,
        simulation__substeps=1,
        actuators__position={"bandwidth": 8.0, "damping": 0.5},
        uncertainty__inertia=0.05,
        uncertainty__coriolis=-0.1,
        uncertainty__gravity=0.03,
        base_motion__kind="sinusoid",
        base_motion__amplitude=[0.3, -0.2, 0.4],
        base_motion__frequency=4.0,
    )
    run = hs.simulate(scenario)
    probe = _core.Probe(core_parameters(scenario))
    tick = scenario.simulation.step
    place = (run.position[:-1], run.quaternion[:-1], run.twist[:-1])
    base_wrench = probe.base_wrench(run.time[:-1], *place)
    acting = probe.acceleration(*place, run.wrench[:-1] + base_wrench)
    moved = np.diff(run.twist, axis=0) / tick
    error, largest = np.abs(acting - moved).max(axis=0), np.abs(acting).max(axis=0)
    print(f"{machine}: accelerations up to {largest}, error {error}")
    assert (error <= 0.01 * largest).all()  # of a pose that is that of the tick's beginning

    # Leg forces are those just after the command, where the legs' acceleration is that of the response.
    legs = _core.Hexapod(core_parameters(scenario).robot)
    wanted = commands(scenario)[: len(moved)]
    maps = np.array([legs.wrench_map(*pose) for pose in zip(*place[:2], strict=True)])
    rates = np.einsum("kij,ki->kj", maps, run.twist[:-1])
    w, zeta = 2 * np.pi * 8.0, 0.5
    crest = w**2 * (wanted - run.leg_lengths[:-1]) - 2 * zeta * w * rates
    mean = np.diff(np.einsum("kij,ki->kj", maps, run.twist[:-1]), axis=0) / tick
    after = probe.acceleration(*place, np.einsum("kij,kj->ki", maps, run.leg_forces[:-1]) + base_wrench)
    found = np.einsum("kij,ki->kj", maps, after - acting)[:-1]
    ripple = (crest[:-1] - mean)[1:]
    print(np.abs(ripple).max(), np.abs(found[1:] - ripple).max())
    np.testing.assert_allclose(found[1:], ripple, atol=0.1 * np.abs(ripple).max())


@pytest.mark.parametrize("depth", [0.0, 0.1])
def test_the_paper_s_law_settles_as_on_a_machine_that_takes_forces(paper: hs.Scenario, depth: float) -> None:
    """Its damping is Coulomb friction alone: the lag of the legs may not be in the loop."""
    sampled = {"simulation.mode": "sampled", "controller.switching.kind": "implicit", "uncertainty.depth": depth}
    force = hs.metrics(hs.simulate(paper.updated(sampled)))["settling_time"]
    times = {}
    for bandwidth in (30.0, 60.0, 120.0):
        scenario = positioned(paper, uncertainty__depth=depth, actuators__position={"bandwidth": bandwidth})
        times[bandwidth] = hs.metrics(hs.simulate(scenario))["settling_time"]
    print(f"force {force} s, positions {times} s")
    for bandwidth, time in times.items():
        assert time == pytest.approx(force, rel=0.1), bandwidth


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("machine", ["prismatic", "rotary"])
def test_every_law_settles(law: str, machine: str) -> None:
    base = hs.load_scenario("paper") if machine == "prismatic" else rotary_machine.machine()
    changes: dict[str, Any] = {"controller.law": law, "uncertainty.depth": 0.0, "simulation.duration": 5.0}
    if machine == "rotary":
        changes[f"controller.{law}.auto.bandwidth"] = 2.0
    scenario = positioned(base.updated(changes), actuators__delay=0.005)
    result = hs.simulate(scenario)
    assert result.outcome == "completed"
    assert hs.metrics(result)["final_error"] < 2.0


def test_a_commanded_twist_is_followed_without_a_gain_of_forces(paper: hs.Scenario) -> None:
    """With legs that follow at once the largest error of `resolved_rate` decays by e^(-lambda t)."""
    scenario = positioned(
        paper.updated({"controller.law": "resolved_rate", "uncertainty.depth": 0.0}),
        simulation__duration=0.4,
        actuators__position={"bandwidth": 400.0},
        controller__resolved_rate__gain=5.0,
    )
    run = hs.simulate(scenario)
    error = np.abs(run.feature_error).max(axis=1)
    rate = -np.gradient(np.log(error), run.time)[50:350]
    np.testing.assert_allclose(rate, 5.0, rtol=0.02)


@pytest.mark.parametrize("law", LAWS)
def test_commands_stay_within_what_the_legs_can_do(law: str) -> None:
    """Speed, acceleration and stroke of the commanded coordinates, where each acts."""
    fastest, most, stroke, tick = 0.02, 0.2, 0.004, 1e-3
    massless = law in ("resolved_rate", "pbvs")
    scenario = positioned(
        hs.load_scenario("paper").updated({"controller.law": law, "uncertainty.depth": 0.0}),
        simulation__duration=1.5,
        robot__stroke=stroke,
        actuators__position={"bandwidth": 30.0, "speed_limit": fastest, "acceleration_limit": most},
    )
    ticks = _core.recorded_ticks(core_parameters(scenario))
    wanted, home = ticks["leg_positions"], ticks["leg_positions"][0]
    speed = np.diff(wanted, axis=0) / tick
    # The map from twist to leg rates changes within a tick by about v^2/l and v a T/l: 1e-5 of these limits.
    assert np.abs(speed).max() <= fastest * 1.001
    assert np.abs(speed).max() >= 0.2 * fastest
    free = (np.abs(wanted[2:] - home) < 0.7 * stroke).all(axis=1)  # a stop at an end of the stroke takes 1 mm of 4
    # The limit is of the rate at the end of a tick: a tick that is not limited moves at the mean of two of them.
    assert np.abs(np.diff(speed, axis=0) / tick)[free].max() <= most * (1.02 if massless else 1.52)
    assert np.abs(wanted - home).max() <= stroke * (1 + 1e-12)
    assert np.abs(wanted - home).max() >= 0.8 * stroke
    assert ticks["saturated"].any()
    run = hs.simulate(scenario)
    assert np.abs(run.leg_lengths - home).max() <= 1.15 * stroke  # legs that follow late, and brake no harder


@pytest.mark.parametrize(
    ("name", "law", "goal"),
    [
        ("reachy-mini", "resolved_rate", [0.5, 0.5, 0.5]),
        ("pi-h824-positions", "pbvs", [0.0, 0.3, 0.0]),
        ("pi-h824-positions", "tracking", [0.0, 0.3, 0.0]),
    ],
)
def test_a_goal_out_of_reach_leaves_commands_and_legs_within_the_stroke(name: str, law: str, goal: list[float]) -> None:
    """Legs slide along the ends of their stroke, where rounding alone would take them beyond."""
    scenario = hs.load_scenario(name).updated({"controller.law": law, "simulation.duration": 2.0})
    pixels = hs.project(scenario, np.array([0.0, 0.0, 0.0, *goal]))
    scenario = scenario.updated({"target.desired_features": pixels.tolist()})
    settings = core_parameters(scenario)
    ticks = _core.recorded_ticks(settings)
    middle, stroke = _core.Hexapod(settings.robot).mid_lengths, scenario.robot.stroke
    away = np.abs(ticks["leg_positions"] - middle)
    assert away.max() <= stroke
    assert (away.max(axis=0) >= 0.99 * stroke).any()  # one at least is at an end of its stroke
    run = hs.simulate(scenario.updated({"robot.on_limit": "stop"}))
    assert (run.outcome, hs.metrics(run)["peak_leg_excursion"] <= stroke) == ("completed", True)


def test_without_an_image_the_legs_stop_and_stay() -> None:
    scenario = positioned(hs.load_scenario("composite-30hz"), controller__switching__kind="sign")
    ticks = _core.recorded_ticks(core_parameters(scenario.updated({"simulation.duration": 0.2})))
    controller = hs.Controller(scenario)
    moved = []
    for k in range(150):
        frame = bool(np.isfinite(ticks["exposure"][k, 0])) and k < 80
        image = {"features": ticks["features"][k], "depth": ticks["depth"][k]} if frame else {}
        still = {name: ticks[name][k] for name in ("position", "quaternion", "twist")}
        if k == 100:
            still["twist"] = np.full(6, np.nan)  # which no law may act on
        out = controller.step(
            **image,
            **still,
            exposure=float(ticks["exposure"][k, 0]) if frame else None,
            now=float(ticks["now"][k, 0]),
            leg_lengths=ticks["leg_lengths"][k],
            leg_rates=ticks["leg_rates"][k],
        )
        moved.append(out.leg_positions)
        if k == 100:
            assert out.invalid_input
            np.testing.assert_array_equal(moved[100], moved[99])
    assert np.isfinite(moved).all()


def test_a_controller_that_has_seen_no_joints_commands_nothing() -> None:
    controller = hs.Controller(positioned(hs.load_scenario("paper")))
    out = controller.step()
    assert out.status == "unusable"
    assert np.isnan(out.leg_positions).all()
    assert np.isnan(hs.Controller(hs.load_scenario("paper")).step().leg_positions).all()


@pytest.mark.usefixtures("baseline")
@pytest.mark.parametrize("law", LAWS)
def test_a_batch_is_its_single_runs(law: str) -> None:
    scenario = positioned(
        hs.load_scenario("paper").updated({"controller.law": law}), simulation__duration=0.2, actuators__delay=0.002
    )
    variations: dict[str, Any] = {
        f"{RESPONSE}.bandwidth": [10.0, 30.0, 80.0],
        f"{RESPONSE}.damping": [0.5, 1.0, 1.5],
        f"{RESPONSE}.speed_limit": [0.05, 0.02, 0.03],
        f"{RESPONSE}.acceleration_limit": [0.5, 2.0, 1.0],
    }
    batch = hs.simulate_batch(scenario, variations)
    for index in range(3):
        single = hs.simulate(scenario.updated({key: values[index] for key, values in variations.items()}))
        for name, value in hs.metrics(single).items():
            # A rounding of a leg's length of 0.2 m, over 1 ms and 0.1 m, is 2e-13 rad/s; a second-order drive passes on
            # some tens of them.
            atol = 1e-11 if name.endswith("speed") else 1e-12
            np.testing.assert_allclose(batch.metrics[name][index], value, rtol=1e-9, atol=atol, err_msg=name)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"actuators.hold": "leg_forces"}, "actuators.hold"),
        ({"actuators.saturation": True}, "actuators.saturation"),
        ({"actuators.bandwidth": 100.0}, "actuators.bandwidth"),
        ({"actuators.quantisation": 1e-3}, "actuators.quantisation"),
        ({"controller.safe.damping": 1.0}, "controller.safe.damping"),
        ({"controller.safe.hold": 1.0}, "controller.safe.hold"),
        ({"camera.convention": "as_printed"}, "camera.convention"),
        ({"controller.virtual_platform.damping": 1e4}, "controller.virtual_platform.damping[0]"),
        (  # E's x, of half the inertia of z, lies along B's z
            {"robot.home_attitude": [0.0, 1.5707963, 0.0], "controller.virtual_platform.damping": [0.0] * 5 + [0.5]},
            "controller.virtual_platform.damping[5]",
        ),
        (  # each may act alone
            {
                "robot.inertia": [[3e-4, 0, 1.4e-4], [0, 3e-4, 0], [1.4e-4, 0, 3e-4]],
                "controller.virtual_platform.damping": [0.0, 0.0, 0.0, 0.5, 0.0, 0.5],
            },
            "controller.virtual_platform.damping: expected at most",
        ),
        (
            {"controller.law": "pbvs", "uncertainty.depth": 0.0, "controller.virtual_platform.damping": 1.0},
            "controller.virtual_platform.damping",
        ),
        ({"controller.law": "pbvs", "uncertainty.depth": 0.0, "controller.pbvs.kd": 0.0}, "controller.pbvs.kd"),
        ({"actuators.kind": "force"}, f"{RESPONSE}.bandwidth"),
        (
            {"actuators.kind": "force", f"{RESPONSE}.bandwidth": 20.0, "controller.virtual_platform.damping": 1.0},
            "controller.virtual_platform.damping",
        ),
        ({"actuators.delay": 0.0005}, "actuators.delay"),
        (
            {"controller.law": "resolved_rate", "uncertainty.depth": 0.0, "controller.resolved_rate.ki": 5.0},
            "controller.resolved_rate.ki",
        ),
    ],
)
def test_settings_without_effect_are_refused(changes: dict[str, Any], key: str) -> None:
    scenario = positioned(hs.load_scenario("paper"))
    with pytest.raises(hs.ScenarioError) as refused:
        scenario.updated(changes)
    assert str(refused.value).split(" ", 2)[-1].find(key) >= 0 or key in str(refused.value)


def test_virtual_damping_damps_the_law(paper: hs.Scenario) -> None:
    overshoot = [
        hs.metrics(hs.simulate(positioned(paper, controller__virtual_platform__damping=damping)))["overshoot"]
        for damping in ([0.0] * 6, [0.5, 0.5, 0.5, 1e-3, 1e-3, 1e-3])
    ]
    assert overshoot[1] < 0.9 * overshoot[0]


def test_what_does_not_apply_says_so(paper: hs.Scenario) -> None:
    scenario = positioned(paper.updated({"controller.law": "composite"}), simulation__duration=0.5)
    result = hs.simulate(scenario)
    certificate = hs.certify(result)
    assert certificate.energy is None
    assert "follow positions (actuators.kind)" in certificate.open_questions["energy"]
    analysis = hs.analyse(scenario, parts=["stiction", "camera_rate", "conditioning"])
    for name in ("stiction", "camera_rate"):
        assert "follow positions" in str({section.name: section for section in analysis.sections()}[name])
    hybrid = hs.simulate(positioned(paper, simulation__duration=0.5))
    assert "ledger" not in hs.certify(hybrid).open_questions["lyapunov"]  # which is not certified either


@pytest.mark.parametrize(
    ("cause", "changes"),
    [
        ("position_lag", {f"{RESPONSE}.bandwidth": 0.05, f"{RESPONSE}.damping": 0.3}),
        ("leg_rates", {f"{RESPONSE}.speed_limit": 0.0005}),
    ],
)
def test_slow_legs_are_diagnosed(cause: str, changes: dict[str, Any]) -> None:
    base = hs.load_scenario("composite-30hz").updated({"simulation.duration": 3.0})
    result = hs.simulate(positioned(base, **{key.replace(".", "__"): value for key, value in changes.items()}))
    diagnosis = hs.diagnose(result)
    assert diagnosis.failed
    assert [finding.cause for finding in diagnosis.causes][:1] == [cause]
