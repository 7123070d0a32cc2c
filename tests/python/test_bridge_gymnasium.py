"""Gymnasium environments: the plants of hexservo bit for bit, Gymnasium's checkers, its three modes of reset."""

from __future__ import annotations

import copy
import pickle
import sys
import warnings
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo import _core
from hexservo.bridges.environment import _following
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.pixels import has_pixels

gym = pytest.importorskip("gymnasium", reason="Gymnasium is not installed (extra `gymnasium`)")

SHORT = {"simulation.mode": "sampled", "simulation.duration": 0.05}
SPREAD = [1e-3] * 3 + [1e-2] * 3


@pytest.fixture
def scenario() -> hs.Scenario:
    return hs.load_scenario("paper-nominal").updated(SHORT)


@pytest.mark.parametrize("name", ["paper-nominal", "real-machine", "slow-camera"])
def test_a_step_is_a_tick_of_a_run_with_a_custom_controller(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The observation after each action is what a custom controller sees."""
    monkeypatch.setenv("HEXSERVO_VARIANT", "baseline")
    scenario = hs.load_scenario(name).updated({**SHORT, "simulation.duration": 0.3})  # cameras are late
    body, desired = core_parameters(scenario).body, core_parameters(scenario)["target.desired_features"]
    env = hs.bridges.gymnasium(scenario, 2)
    random = np.random.default_rng(3)
    actions = random.uniform(-1e-2, 1e-2, (50, 6))
    observed, _ = env.reset(seed=11)
    # the episode's seed is the first number of its generator
    seed = int(np.random.default_rng(11).integers(2**63))
    seen: list[np.ndarray[Any, Any]] = []
    waited = []

    def controller(o: hs.Observation) -> Any:
        if not seen and np.isnan(o.features).any():
            waited.append(o.tick)
            return np.zeros(6)
        at = o.tick - len(waited)
        seen.append(
            np.concatenate(
                [desired.ravel() - o.features, o.position, o.quaternion * (1 if o.quaternion[0] >= 0 else -1), o.twist]
            )
        )
        if at >= len(actions):
            return np.zeros(6)
        return body.weight(o.quaternion) + np.float32(actions[at]) * env.action_scale

    hs.simulate(scenario.updated({"seed": seed}), controller=controller)
    rows = [observed[0]]
    for action in actions:
        both = np.tile(action.astype(np.float32), (2, 1))
        observed, _, terminated, truncated, _ = env.step(both)
        rows.append(observed[0])
        if terminated.any() or truncated.any():
            break
    assert len(rows) > 20
    if not has_pixels(scenario.camera):
        np.testing.assert_array_equal(np.array(rows), np.array(seen)[: len(rows)])


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"uncertainty.principal_point": [10.0, 0.0]},
        {"uncertainty.focal_length": 0.05, "camera.distortion.brown_conrady": [-0.2, 0.05, 1e-3, -1e-3, 0.0]},
        {"camera.principal_point": [650.0, 500.0], "camera.axes": "opencv", "uncertainty.principal_point": [-4.0, 7.0]},
    ],
)
def test_the_error_at_the_goal_is_zero_whatever_the_controller_assumes(wrong: dict[str, Any]) -> None:
    """Desired and seen features go through the same assumed camera: where their pixels are equal, so are they."""
    packaged = hs.load_scenario("pi-h824")
    goal = [0.004, -0.003, 0.002, -0.01, -0.015, 0.02]  # the packaged scenario's target.desired_pose
    camera = {"camera.noise": 0.0, "camera.image_size": None, **wrong}
    if camera.get("camera.axes") == "opencv":  # which looks along its +z
        camera["camera.mount.rotation"] = [np.pi, 0.0, 0.0]
    target = {"target.desired_pose": goal, "target.desired_features": None}
    scenario = packaged.updated({**SHORT, **camera, **target, "simulation.start.pose": goal, "sensors.resolution": 0.0})
    env = hs.bridges.gymnasium(scenario, 1)
    observed, _ = env.reset(seed=0)
    np.testing.assert_allclose(observed[0, :8], 0.0, rtol=0, atol=1e-9)  # pixels of 1e3 to rounding
    observed, rewards, *_ = env.step(np.zeros((1, 6), np.float32))
    assert rewards[0] == pytest.approx(0.0, abs=1e-12)
    away = hs.bridges.gymnasium(scenario.updated({"simulation.start.pose": [0.0] * 6}), 1)
    away.reset(seed=0)
    _, rewards, *_ = away.step(np.zeros((1, 6), np.float32))
    assert rewards[0] == pytest.approx(-scenario.simulation.step, rel=1e-9)  # e is e_0 at home


def test_the_unit_of_the_error_is_a_pixel_where_the_goal_is_home(scenario: hs.Scenario) -> None:
    """Features that are given are reached to rounding alone, which is no unit."""
    away = {"target.desired_features": scenario.target.initial_features, "simulation.start.pose": [1e-3] + [0.0] * 5}
    env = hs.bridges.gymnasium(scenario.updated(away), 1)
    observed, _ = env.reset(seed=0)
    _, rewards, *_ = env.step(np.zeros((1, 6), np.float32))
    error = np.sqrt(np.mean(observed[0, :8] ** 2))
    assert rewards[0] == pytest.approx(-scenario.simulation.step * error, rel=1e-12)


@pytest.mark.parametrize("action", ["wrench", "twist"])
def test_the_checker_of_gymnasium_passes(scenario: hs.Scenario, action: Any) -> None:
    from gymnasium.utils.env_checker import check_env

    env = hs.bridges.gymnasium(scenario, action=action, start_spread=SPREAD)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*infinity.*")  # errors and poses have no bounds
        warnings.filterwarnings("ignore", message=".*no spec.*|.*not have a spec.*")
        check_env(env, skip_render_check=True)


@pytest.mark.parametrize("autoreset", ["next_step", "same_step", "disabled"])
def test_the_vector_environment_keeps_the_rules_of_gymnasium(scenario: hs.Scenario, autoreset: Any) -> None:
    env = hs.bridges.gymnasium(scenario, 3, autoreset=autoreset, start_spread=SPREAD)
    assert env.metadata["autoreset_mode"] is gym.vector.AutoresetMode[autoreset.upper()]
    observed, _ = env.reset(seed=5)
    assert observed in env.observation_space
    assert env.observation_space.shape == (3, 21)
    zero = np.zeros((3, 6), np.float32)
    ticks = round(scenario.simulation.duration / scenario.simulation.step)
    for tick in range(1, ticks + 1):
        last = observed
        observed, rewards, terminated, truncated, info = env.step(zero)
        assert observed in env.observation_space
        assert rewards.shape == terminated.shape == truncated.shape == (3,)
        assert not terminated.any()
        assert truncated.all() == (tick == ticks)
        assert (rewards < 0).all()
    if autoreset == "same_step":
        assert info["_final_obs"].all()
        assert info["final_info"]["time"] == pytest.approx(scenario.simulation.duration)
        assert np.abs(info["final_obs"][0] - last[0]).max() < np.abs(observed[0] - last[0]).max()
        assert (info["time"] == 0).all()
        return
    assert info["time"] == pytest.approx(scenario.simulation.duration)
    if autoreset == "next_step":
        observed, rewards, terminated, truncated, info = env.step(zero + 1)
        assert (rewards == 0).all()
        assert not (terminated | truncated).any()
    else:
        before = env.step(zero)
        assert (before[1] == 0).all()
        assert before[3].all()  # the flags of the end
        assert not before[2].any()
        observed, info = env.reset(options={"reset_mask": np.array([True, False, True])})
        assert info["time"] == pytest.approx([0, scenario.simulation.duration, 0])
        return
    assert (info["time"] == 0).all()


def test_seeds_repeat_episodes_and_differ_from_each_other(scenario: hs.Scenario) -> None:
    env = hs.bridges.gymnasium(scenario, 4, start_spread=SPREAD)
    first, _ = env.reset(seed=7)
    second, _ = env.reset()
    again, _ = env.reset(seed=7)
    np.testing.assert_array_equal(first, again)
    assert len({row.tobytes() for row in np.vstack([first, second])}) == 8
    shifted, _ = env.reset(seed=[8, 7, 9, 10])
    np.testing.assert_array_equal(shifted[1], first[0])
    np.testing.assert_array_equal(shifted[0], first[1])


def test_a_failed_run_terminates_its_episode_alone_and_costs_what_is_left(scenario: hs.Scenario) -> None:
    # A thousand times the largest wrench of the legs throws the target out of view; the others hold.
    env = hs.bridges.gymnasium(scenario, 2, action_scale=1e3, autoreset="disabled")
    env.reset(seed=1)
    actions = np.array([[1.0] * 6, [0.0] * 6], np.float32)
    for _ in range(40):
        _, rewards, terminated, _, info = env.step(actions)
        if terminated.any():
            break
    assert terminated.tolist() == [True, False]
    left = scenario.simulation.duration - info["time"]
    assert rewards[0] < -10 * left[0] < rewards[1] < 0
    assert rewards[0] > -10 * left[0] - 1.0  # and the error of a tick
    assert left[0] < 0.8


def test_a_finished_episode_repeats_its_flags(scenario: hs.Scenario) -> None:
    for push, flags in ((1.0, (True, False)), (0.0, (False, True))):  # thrown out of view, or held to the end
        env, action = hs.bridges.gymnasium(scenario, action_scale=1e3), np.full(6, push, np.float32)
        env.reset(seed=1)
        ended = False
        while not ended:
            _, _, terminated, truncated, _ = env.step(action)
            ended = terminated or truncated
        assert (terminated, truncated) == flags
        assert env.step(action)[1:4] == (0.0, *flags)


def test_a_start_from_which_the_target_is_not_seen_is_drawn_again() -> None:
    """With this spread a few of 100 starts look past the target, until the run is over."""
    scenario = hs.load_scenario("real-machine").updated({"simulation.duration": 0.2})
    env = hs.bridges.gymnasium(scenario, 16, start_spread=[2e-3] * 3 + [0.35] * 3)
    for seed in range(0, 160, 16):
        observed, info = env.reset(seed=seed)
        assert (info["time"] < 0.15).all()
        assert (np.abs(observed[:, :8]).max(axis=1) > 1e-3).all()  # at the goal it would be 0
        again, _ = env.reset(seed=seed)
        np.testing.assert_array_equal(observed, again)


def test_a_start_beyond_the_machine_is_drawn_again_in_training(scenario: hs.Scenario) -> None:
    stops = scenario.updated({"robot.on_limit": "stop", "simulation.duration": 0.01})
    env = hs.bridges.gymnasium(stops, 4, start_spread=[4e-3] * 3 + [0.1] * 3)
    env.reset(seed=0)
    for _ in range(300):
        env.step(np.zeros((4, 6), np.float32))


@pytest.mark.parametrize(
    ("changes", "spread", "text"),
    [
        ({"camera.dropout": 1.0}, 0.0, r"got none in 100 draws \(runs end before an image of the target arrives\)"),
        ({"camera.latency": 0.06}, SPREAD, r"got none in 100 draws \(runs end before an image of the target arrives\)"),
        ({"robot.on_limit": "stop"}, 3.0, r"got none in 100 draws \(simulation\.start"),
    ],
)
def test_no_start_that_gives_an_episode(scenario: hs.Scenario, changes: Any, spread: Any, text: str) -> None:
    with pytest.raises(ValueError, match=rf"^start_spread: expected starts .*{text}.*; choose a smaller start_spread"):
        hs.bridges.gymnasium(scenario.updated(changes), 2, start_spread=spread)


def test_a_machine_that_takes_positions_is_refused_at_once() -> None:
    with pytest.raises(ValueError, match=r"^actuators\.kind: expected force .*, got one that takes positions"):
        hs.bridges.gymnasium(hs.load_scenario("pi-h824-positions"), 2)


@pytest.mark.parametrize("centre_of_mass", [[0.0, 0.0, 0.0], [0.05, 0.0, -0.3]])
def test_twists_are_followed_wherever_the_centre_of_mass_is(centre_of_mass: list[float]) -> None:
    """A tenth of the difference is taken away in a tick, along each axis: after k ticks 0.9^k of it is left."""
    inertia = [[0.47, 0.0, 0.075], [0.0, 0.49, 0.0], [0.075, 0.0, 0.04]]  # about the platform's origin
    machine = {"robot.mass": 5.0, "robot.centre_of_mass": centre_of_mass, "robot.inertia": inertia}
    sensors = {"sensors.pose": True, "camera.noise": 0.0, "camera.dropout": 0.0, "actuators.saturation": False}
    scenario = hs.load_scenario("pi-h824", {**machine, **sensors, "simulation.duration": 0.2})
    env = hs.bridges.gymnasium(scenario, 1, action="twist")
    # with rotation, what the motion within a tick changes of inertia and Coriolis terms: 1.2e-4 rad/s, of second order
    for wanted, off in (([0.2, -0.1, 0.1, 0.0, 0.0, 0.0], 1e-9), ([0.2, -0.1, 0.1, 0.05, 0.1, -0.1], 2e-4)):
        env.reset(seed=0)
        for ticks in range(1, 41):
            observed, *_ = env.step([wanted])
            followed = np.array(wanted) * env.action_scale * (1.0 - 0.9**ticks)
            np.testing.assert_allclose(observed[0, -6:], followed, rtol=0, atol=off)


def test_the_servo_of_twists_takes_coriolis_terms_away(scenario: hs.Scenario) -> None:
    """A tenth of the difference in a tick of 1 ms: 100 1/s of it, also of rates about axes of unequal inertia."""
    exact = {f"uncertainty.{name}": 0.0 for name in ("inertia", "coriolis", "gravity")}
    settings = core_parameters(scenario.updated({"robot.inertia": [1e-3, 2e-3, 3e-3], **exact}))
    probe, rates = _core.Probe(settings), np.array([[0.0, 0.0, 0.0, 1.0, 2.0, 3.0]])
    home, upright = np.array([scenario.robot.home_position]), np.array([[1.0, 0.0, 0.0, 0.0]])
    wrench = _following(probe, np.zeros((1, 6)), {"quaternion": upright, "twist": rates}, 1e-3)
    found = probe.acceleration(home, upright, rates, wrench + settings.body.weight(upright[0]))
    np.testing.assert_allclose(found, -100.0 * rates, rtol=1e-12, atol=1e-9)


def test_the_scalar_part_of_an_observed_attitude_is_not_negative(scenario: hs.Scenario) -> None:
    """The other sign of all four is the same attitude, which a platform that goes on rotating comes to."""
    env = hs.bridges.gymnasium(scenario, 1)
    observed, _ = env.reset(seed=0)
    env._states["quaternion"] = -env._states["quaternion"]
    np.testing.assert_array_equal(env._observed(), np.asarray(observed, dtype=float))
    assert observed[0, 11] > 0.9


def test_statistics_of_gymnasium_wrap_it(scenario: hs.Scenario) -> None:
    env = gym.wrappers.vector.RecordEpisodeStatistics(hs.bridges.gymnasium(scenario, 2))
    env.reset(seed=0)
    ticks = round(scenario.simulation.duration / scenario.simulation.step)
    for _ in range(ticks):
        *_, info = env.step(env.action_space.sample() * 0)
    assert info["episode"]["l"].tolist() == [ticks, ticks]
    assert (info["episode"]["r"] < 0).all()


def test_runs_side_by_side_are_single_runs(scenario: hs.Scenario) -> None:
    """Each row is what a run by itself gives under the same wrenches, the estimated weight among them."""
    settings = core_parameters(scenario)
    together = _core.SampledRuns(2)
    alone = []
    for place, seed in enumerate((3, 4)):
        settings["seed"] = seed
        together.start(place, settings)
        alone.append(_core.SampledRun(settings))
    wrenches = np.random.default_rng(8).uniform(-1e-2, 1e-2, (20, 2, 6))
    for both in wrenches:
        together.command(both)
        for run, wrench in zip(alone, both, strict=True):
            run.command(settings.body.weight(run.observe().quaternion) + wrench)
    rows = together.rows()
    assert rows["running"].all()
    for name in ("features", "position", "quaternion", "twist", "time"):
        np.testing.assert_array_equal(rows[name], [getattr(run.observe(), name) for run in alone])


def test_what_runs_side_by_side_refuse(scenario: hs.Scenario) -> None:
    with pytest.raises(ValueError, match="count: expected at least 1, got 0"):
        _core.SampledRuns(0)
    runs = _core.SampledRuns(2)
    with pytest.raises(RuntimeError, match="place 0: expected a run that was started, got none"):
        runs.rows()
    for place in (-1, 2):
        with pytest.raises(IndexError, match=f"place: expected 0 to 1, got {place}"):
            runs.start(place, core_parameters(scenario))
    for wrenches in (np.zeros((1, 6)), np.full((2, 6), np.inf)):
        with pytest.raises(ValueError, match=r"wrenches: expected (2 of them, got 1|finite numbers)"):
            runs.command(wrenches)


def test_a_scale_of_zero_locks_an_axis(scenario: hs.Scenario) -> None:
    """A push along the axes that are locked changes nothing, along another one it does."""
    env = hs.bridges.gymnasium(scenario, action_scale=[1e-2, 0.0, 0.0, 0.0, 0.0, 0.0])
    seen = []
    for push in (np.zeros(6), np.array([0.0, 1, 1, 1, 1, 1]), np.array([1.0, 0, 0, 0, 0, 0])):
        env.reset(seed=0)
        seen.append(env.step(push)[0])
    np.testing.assert_array_equal(seen[0], seen[1])
    assert not np.array_equal(seen[0], seen[2])


@pytest.mark.parametrize(
    ("action", "text"),
    [
        (np.zeros(5), r"shape \(6,\), got \(5,\)"),
        (0.0, r"shape \(6,\), got \(\)"),
        (np.zeros((1, 6)), r"shape \(6,\), got \(1, 6\)"),
        (None, r"real numbers of shape \(6,\), got None"),
        (np.full(6, True), r"real numbers of shape \(6,\), got array"),
        (np.full(6, np.nan), "numbers, got NaN"),
    ],
)
def test_a_single_environment_names_its_own_action(scenario: hs.Scenario, action: Any, text: str) -> None:
    env = hs.bridges.gymnasium(scenario)
    env.reset(seed=0, options={})
    with pytest.raises(ValueError, match=rf"^action: expected {text}"):
        env.step(action)
    with pytest.raises(ValueError, match=r"^options: expected none, got reset_mask$"):
        env.reset(options={"reset_mask": np.array([True])})


def test_refusals(scenario: hs.Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    for options, text in (
        ({"action": "force"}, "action: expected wrench or twist"),
        ({"autoreset": "later"}, "autoreset: expected one of next_step, same_step, disabled"),
        ({"start_spread": -1.0}, "start_spread: expected one or 6 finite numbers"),
        ({"action_scale": [1.0, 2.0]}, "action_scale: expected one or 6"),
        ({"action_scale": 0.0}, "action_scale: expected a number above 0 for at least one axis, got zeros"),
        ({"action_scale": True}, "action_scale: expected one or 6 finite numbers"),
        ({"start_spread": np.full(6, True)}, "start_spread: expected one or 6 finite numbers"),
        ({"num_envs": 0}, "num_envs: expected at least 1"),
    ):
        given: dict[str, Any] = {"num_envs": 1, **options}
        with pytest.raises(ValueError, match=text):
            hs.bridges.gymnasium(scenario, **given)
    env = hs.bridges.gymnasium(scenario, 2)
    with pytest.raises(gym.error.ResetNeeded):
        env.step(np.zeros((2, 6)))
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"actions: expected shape \(2, 6\)"):
        env.step(np.zeros((3, 6)))
    with pytest.raises(ValueError, match="actions: expected numbers, got NaN"):
        env.step(np.full((2, 6), np.nan))
    for mask in (np.array([0.5, np.nan]), np.array([1, 0]), ["yes", "no"]):
        with pytest.raises(TypeError, match=r"^reset_mask: expected booleans, got an array of (float64|int64|<U3)$"):
            env.reset(options={"reset_mask": mask})
    with pytest.raises(ValueError, match=r"^options: expected reset_mask, got reset_masks$"):
        env.reset(options={"reset_masks": np.array([True, False])})
    with pytest.raises(TypeError, match=r"^options: expected a dict or None, got list$"):
        env.reset(options=["reset_mask"])
    with pytest.raises(ValueError, match="seed: expected one number or 2"):
        env.reset(seed=[1, 2, 3])
    for numbers in ([["1"] * 6] * 2, np.full((2, 6), 1j)):
        with pytest.raises(ValueError, match=r"actions: expected real numbers of shape \(2, 6\), got "):
            env.step(numbers)
    for several in (env, hs.bridges.gymnasium(scenario)):
        for seed in (-1, 1.5, "one", True):
            with pytest.raises(ValueError, match=r"^seed: expected one number.*, whole and not negative, got "):
                several.reset(seed=seed)
    with pytest.raises(ValueError, match=r"^action_scale: expected one or 6 finite numbers"):
        hs.bridges.gymnasium(scenario, action_scale=["1"] * 6)
    for count in (2.5, "2", True):
        with pytest.raises(TypeError, match=r"^num_envs: expected an integer or None, got "):
            hs.bridges.gymnasium(scenario, count)  # type: ignore[arg-type]
    for mode in ("disabled", "nonsense"):
        with pytest.raises(ValueError, match=r"^autoreset: expected num_envs beside it"):
            hs.bridges.gymnasium(scenario, autoreset=mode)  # type: ignore[arg-type]
    monkeypatch.delitem(sys.modules, "hexservo.bridges.environment")
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    monkeypatch.delattr(hs.bridges, "gymnasium")
    with pytest.raises(ImportError, match=r"pip install 'hexservo\[gymnasium\]'"):
        hs.bridges.gymnasium(scenario)


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, pickle.dumps])
@pytest.mark.parametrize("count", [None, 2])
def test_an_environment_is_not_copied(duplicate: Any, count: int | None) -> None:
    environment = hs.bridges.gymnasium(hs.load_scenario("paper"), count)
    with pytest.raises(TypeError, match=r"expected no copy and no pickling of an environment.* function that makes it"):
        duplicate(environment)
