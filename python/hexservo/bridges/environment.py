"""Scenarios as Gymnasium environments (docs/bridges.md)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexservo import _core
from hexservo.bridges.extras import extra
from hexservo.findings.analysis.scene import Scene, scene_of
from hexservo.scenario.arrays import Array, Mask, real_numbers
from hexservo.scenario.parameters import Settings, core_parameters
from hexservo.scenario.scenario import Scenario, require_scenario
from hexservo.scenario.wording import wrong_type

if TYPE_CHECKING:
    import gymnasium as gym
    from gymnasium import vector as _vector
else:
    gym = extra("gymnasium", "gymnasium")
    _vector = gym.vector

_FAILURE = 10.0  # cost of a second that a failed run is short of its duration, in those of a second with error e_0
_DRAWS = 100  # of an episode's start, until one is such that the target is seen
_SHARE = 0.1  # of a twist error that the velocity servo takes away in a tick
_LEAST_ERROR = 1e-6  # [px] between images of home and goal that differ by more than rounding
_TWIST_SCALE = np.repeat([0.1, 0.5], 3)  # [m/s; rad/s]
_MODES = {"next_step": "NEXT_STEP", "same_step": "SAME_STEP", "disabled": "DISABLED"}


class _Uncopied:
    """An environment whose plants are of the core, so that a copy would move those of the first."""

    def __reduce_ex__(self, protocol: object) -> NoReturn:
        """Refuse `copy` and `pickle`, which ask for it."""
        raise TypeError(
            f"{type(self).__name__}: expected no copy and no pickling of an environment, whose plants are of the core; "
            "make another one, or hand over a function that makes it: lambda: hs.bridges.gymnasium(scenario)"
        )


class HexapodVectorEnv(_Uncopied, _vector.VectorEnv):  # type: ignore[misc]
    """Runs of one scenario side by side as a Gymnasium vector environment; `gymnasium` describes it."""

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        *,
        action: Literal["wrench", "twist"] = "wrench",
        action_scale: ArrayLike | None = None,
        start_spread: ArrayLike = 0.0,
        autoreset: Literal["next_step", "same_step", "disabled"] = "next_step",
    ) -> None:
        require_scenario(scenario)
        if isinstance(num_envs, bool) or not isinstance(num_envs, int | np.integer):
            raise wrong_type("num_envs", "an integer or None", num_envs)
        if num_envs < 1:
            raise ValueError(f"num_envs: expected at least 1, got {num_envs}")
        if action not in ("wrench", "twist"):
            raise ValueError(f"action: expected wrench or twist, got {action!r}")
        if autoreset not in _MODES:
            raise ValueError(f"autoreset: expected one of {', '.join(_MODES)}, got {autoreset!r}")
        steps = max(1, round(scenario.simulation.duration / scenario.simulation.step))
        self.scenario = scenario.updated({"simulation.mode": "sampled", "simulation.log_every": steps})
        self.num_envs = int(num_envs)
        scene = scene_of(self.scenario)
        self._settings = core_parameters(self.scenario)
        self._start: Array = np.array(self._settings["simulation.start.pose"])
        self._spread = _six("start_spread", start_spread)
        # as the controller rectifies them, with the camera that it assumes: so are the features that it sees
        self._desired = _rectified(self._settings, self._settings["target.desired_features"])
        self._tick, self._duration = self.scenario.simulation.step, self.scenario.simulation.duration
        error = np.ones(1)
        if scene.has_points:
            error = self._desired - _rectified(self._settings, scene.camera.pixels(_points(scene.image(scene.home)[0])))
        at_home = float(np.sqrt(np.mean(error**2)))
        self._error_unit = at_home if at_home > _LEAST_ERROR else 1.0
        self._servo = scene.probe if action == "twist" else None
        if action_scale is None:
            action_scale = _TWIST_SCALE if action == "twist" else _wrench_scale(scene)
        self.action_scale = _six("action_scale", action_scale)
        if not self.action_scale.any():
            raise ValueError("action_scale: expected a number above 0 for at least one axis, got zeros")
        self._mode = autoreset
        mode = _vector.AutoresetMode[_MODES[autoreset]]
        self.metadata = {"render_modes": [], "autoreset_mode": mode}
        self.render_mode = None
        size = len(self._desired) + 13
        self.single_observation_space = gym.spaces.Box(-np.inf, np.inf, (size,), np.float64)
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (6,), np.float32)
        batched = _vector.utils.batch_space
        self.observation_space = batched(self.single_observation_space, num_envs)
        self.action_space = batched(self.single_action_space, num_envs)
        _core.SampledRuns(1).start(0, self._settings)  # refuses what no draw of a start would change
        self._require_starts()
        self._runs = _core.SampledRuns(num_envs)
        self._generators: list[np.random.Generator] = []
        self._seen: Array = np.zeros((num_envs, len(self._desired)))  # newest features that were usable
        self._states: dict[str, NDArray[Any]] = {}
        self._over: Mask = np.zeros(num_envs, dtype=bool)  # episodes at whose end their environment is

    def reset(
        self, *, seed: int | np.integer[Any] | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start all episodes again, or those of ``options["reset_mask"]``.

        Parameters
        ----------
        seed
            Of all random numbers, those of environment i from seed + i, or one per environment; 0 or more.
        options
            ``reset_mask``: (num_envs,) of bool.

        Raises
        ------
        TypeError
            For a mask that is not of bool, and options that are no mapping.
        ValueError
            "seed: expected ..., got ..." for other seeds, another option, a mask of another shape, and "start_spread:
            expected ..., got ..." where no draw of a start gives an episode.
        """
        _require_options(options, ("reset_mask",))
        seeds = _seeds(seed, self.num_envs)
        if not self._generators:
            self._generators = [np.random.default_rng(each) for each in seeds]
        mask = np.ones(self.num_envs, dtype=bool)
        if options is not None and "reset_mask" in options:
            mask = np.asarray(options["reset_mask"])
            if mask.dtype != bool:
                raise TypeError(f"reset_mask: expected booleans, got an array of {mask.dtype}")
            if mask.shape != (self.num_envs,):
                raise ValueError(f"reset_mask: expected shape ({self.num_envs},), got {mask.shape}")
            if not self._states and not mask.all():
                raise ValueError("reset_mask: expected all environments at the first reset")
        for index in np.flatnonzero(mask):
            if seeds[index] is not None:
                self._generators[index] = np.random.default_rng(seeds[index])
        self._begin(mask)
        return self._observed(), self._info()

    def step(self, actions: ArrayLike) -> tuple[Array, Array, Mask, Mask, dict[str, Any]]:
        """Take one servo tick with (num_envs, 6) actions.

        Returns
        -------
        tuple
            Observations, rewards, terminated, truncated, and infos with ``time`` [s]. Without autoreset an episode
            that has ended repeats its flags, with reward 0.

        Raises
        ------
        ResetNeeded
            Before the first reset.
        ValueError
            "actions: expected ..., got ..." for another shape, NaN, and what are no real numbers.
        """
        return self._advanced(_actions("actions", actions, (self.num_envs, 6)))

    def _advanced(self, actions: Array) -> tuple[Array, Array, Mask, Mask, dict[str, Any]]:
        """Take one servo tick with actions that are checked."""
        if not self._states:
            raise gym.error.ResetNeeded("call reset before step")
        wanted = np.minimum(np.maximum(actions, -1.0), 1.0) * self.action_scale
        if self._servo is not None:
            wanted = _following(self._servo, wanted, self._states, self._tick)
        before = self._over
        away = self._desired - self._seen
        error = np.sqrt(np.add.reduce(away * away, axis=1) / away.shape[1]) / self._error_unit
        self._runs.command(wanted)
        self._read()
        over = ~self._states["running"]
        if self._mode == "next_step":
            over &= ~before  # these begin again in this step
        truncated = over & self._states["at_end"]
        terminated = over & ~truncated
        left = np.maximum(self._duration - self._states["time"], 0.0)
        rewards = np.where(before, 0.0, -self._tick * error - np.where(terminated, _FAILURE * left, 0.0))
        self._over = over
        info: dict[str, Any] = {}
        if self._mode == "next_step" and before.any():
            self._begin(before)
        elif self._mode == "same_step" and over.any():
            info = self._final(over)
            self._begin(over)
        return self._observed(), rewards, terminated, truncated, {**self._info(), **info}

    def _begin(self, mask: Mask) -> None:
        waiting, draws = np.flatnonzero(mask), np.full(self.num_envs, _DRAWS)
        while len(waiting):
            for index in waiting:
                draws[index] = self._draw(self._runs, int(index), self._generators[index], int(draws[index]))
            self._read()
            waiting = waiting[~self._states["running"][waiting]]
        self._over = self._over & ~mask

    def _draw(self, runs: _core.SampledRuns, place: int, random: np.random.Generator, draws: int) -> int:
        """Start a run at a place with a seed and a start that the core takes, and return how many draws are left.

        A run that is over then ends before its first image.
        """
        why = "runs end before an image of the target arrives"
        for left in range(draws - 1, -1, -1):
            self._settings["seed"] = int(random.integers(2**63))
            self._settings["simulation.start.pose"] = self._start + self._spread * random.uniform(-1.0, 1.0, 6)
            try:
                runs.start(place, self._settings)
            except ValueError as error:
                why = str(error)
            else:
                return left
        raise ValueError(
            f"start_spread: expected starts from which runs go on and see the target, got none in {_DRAWS} draws "
            f"({why}); choose a smaller start_spread, or a scenario with the target in view from its start"
        )

    def _require_starts(self) -> None:
        """Refuse a scenario none of whose starts gives an episode, before a training begins."""
        runs, random, draws = _core.SampledRuns(1), np.random.default_rng(self.scenario.seed), _DRAWS
        while True:
            draws = self._draw(runs, 0, random, draws)
            if runs.rows()["running"][0]:
                return

    def _read(self) -> None:
        self._states = self._runs.rows()
        features = self._states["features"]
        self._seen = np.where(np.isnan(features), self._seen, features)

    def _observed(self) -> Array:
        quaternion = self._states["quaternion"]
        sign = np.where(quaternion[:, :1] < 0.0, -1.0, 1.0)
        parts = [self._desired - self._seen, self._states["position"], sign * quaternion, self._states["twist"]]
        return np.concatenate(parts, axis=1)

    def _info(self) -> dict[str, Any]:
        return {"time": self._states["time"], "_time": np.ones(self.num_envs, dtype=bool)}

    def _final(self, over: Mask) -> dict[str, Any]:
        observations = np.full(self.num_envs, None, dtype=object)
        observed, states = self._observed(), self._info()
        for index in np.flatnonzero(over):
            observations[index] = observed[index]
        final = {name: (values.copy() if not name.startswith("_") else over) for name, values in states.items()}
        return {"final_obs": observations, "_final_obs": over, "final_info": final, "_final_info": over}


class HexapodEnv(_Uncopied, gym.Env):  # type: ignore[misc]
    """One run of a scenario as a Gymnasium environment; `gymnasium` describes it."""

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own form)

    def __init__(self, scenario: Scenario, **options: Any) -> None:
        self._one = HexapodVectorEnv(scenario, 1, autoreset="disabled", **options)
        self.observation_space = self._one.single_observation_space
        self.action_space = self._one.single_action_space
        self.render_mode = None

    @property
    def action_scale(self) -> Array:
        """What an action of 1 is, (6,) [N; N m] or [m/s; rad/s]."""
        return self._one.action_scale

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode, from a seed that is 0 or more; there are no options."""
        _require_options(options, ())
        (seed,) = _seeds(seed, 1)
        super().reset(seed=seed)
        observed, info = self._one.reset(seed=int(self.np_random.integers(2**31)))
        return observed[0], _first(info)

    def step(self, action: ArrayLike) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Take one servo tick with six numbers."""
        given = _actions("action", action, (6,))
        observed, rewards, terminated, truncated, info = self._one._advanced(given[None])
        return observed[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), _first(info)


def gymnasium(
    scenario: Scenario,
    num_envs: int | None = None,
    *,
    action: Literal["wrench", "twist"] = "wrench",
    action_scale: ArrayLike | None = None,
    start_spread: ArrayLike = 0.0,
    autoreset: Literal["next_step", "same_step", "disabled"] = "next_step",
) -> Any:
    """Return a scenario's plant as a Gymnasium environment: plant, camera, sensors and actuators, without its law.

    A step is one servo tick (``simulation.step``) in sampled mode; an episode that lasts ``simulation.duration`` is
    truncated, and one that ends as a run does (divergence, a target behind the camera, a lost feature or a leg limit
    where they stop runs) is terminated. Plants are those of `hexservo.simulate` with a custom controller, bit for bit.

    Parameters
    ----------
    scenario
        Its law does not act.
    num_envs
        Number of environments of a vector environment, which run on one thread; None: a single environment.
    action
        Six numbers from -1 to 1, times `action_scale`; larger ones are clipped. "wrench": what acts beyond the
        estimated weight [N; N m], in B. "twist": a velocity in B [m/s; rad/s] for a servo that, with the estimated
        inertia and Coriolis terms at the measured pose, takes away a tenth of the difference from the measured twist
        in a tick.
    action_scale
        (6,) or one number, not negative; a 0 locks its axis, and not all are 0. None: the largest wrench of the legs
        at home, along each axis, or 0.1 m/s and 0.5 rad/s.
    start_spread
        (6,) or one number [m; rad]: an episode starts at the scenario's start plus a displacement in B, uniform
        within plus and minus it. One from which the run cannot go on, or ends before the target is seen, is drawn
        again, up to 100 times.
    autoreset
        Gymnasium's `AutoresetMode` of the vector environment; a single one has none, and stepped after the end of its
        episode it repeats the flags of the end, with reward 0.

    Returns
    -------
    HexapodVectorEnv or HexapodEnv
        Observation, as the controller's sensors give it: desired minus seen features (8,) [px], the newest that are
        usable, both rectified with the camera that the controller assumes; position (3,) in B [m]; quaternion (4,)
        with w >= 0; twist (6,) in B [m/s; rad/s]. Reward: ``-T_c e/e_0`` with the servo period, the RMS of the seen
        feature error at the action and that at home (1 px where the goal is the image from home, or the camera is
        as_printed); an episode that fails costs 10 for each second that is left. Infos: ``time`` [s].

    Raises
    ------
    ImportError
        Without Gymnasium; the extra ``gymnasium`` installs it.
    TypeError
        For anything but a `Scenario`, and a number of environments that is no integer.
    ValueError
        For values that are not as above, for `autoreset` without `num_envs`, for a scenario whose machine takes
        positions, where no start of 100 gives an episode, and what the core refuses.
    """
    if num_envs is None:
        if autoreset != "next_step":
            raise ValueError(f"autoreset: expected num_envs beside it, got {autoreset!r} for a single environment")
        return HexapodEnv(scenario, action=action, action_scale=action_scale, start_spread=start_spread)
    return HexapodVectorEnv(
        scenario,
        num_envs,
        action=action,
        action_scale=action_scale,
        start_spread=start_spread,
        autoreset=autoreset,
    )


def _points(numbers: Array) -> Array:
    return numbers.reshape(-1, 2)


def _rectified(settings: Settings, pixels: Array) -> Array:
    """Return the features that the controller takes for pixels of the camera, (2p,) [px]."""
    return np.asarray(settings.assumed_camera.features(_points(pixels))).ravel()


def _seeds(seed: Any, count: int) -> list[int | None]:
    """Return the seed of each environment; None: none is given."""
    if seed is None:
        return [None] * count
    given = [int(seed) + index for index in range(count)] if _is_seed(seed) else seed
    several = isinstance(given, list | tuple | np.ndarray) and len(given) == count
    if not several or not all(each is None or _is_seed(each) for each in given):
        more = f" or {count}" if count > 1 else ""
        raise ValueError(f"seed: expected one number{more}, whole and not negative, got {seed!r:.60}")
    return [None if each is None else int(each) for each in given]


def _is_seed(value: object) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and bool(value >= 0)


def _first(info: dict[str, Any]) -> dict[str, Any]:
    return {name: values[0] for name, values in info.items() if not name.startswith("_")}


def _require_options(options: object, known: tuple[str, ...]) -> None:
    if options is None:
        return
    if not isinstance(options, Mapping):
        raise wrong_type("options", "a dict or None", options)
    if unknown := [key for key in options if key not in known]:
        raise ValueError(f"options: expected {' or '.join(known) or 'none'}, got {', '.join(map(str, unknown))}")


def _actions(name: str, given: ArrayLike, shape: tuple[int, ...]) -> Array:
    numbers = real_numbers(given)
    if numbers is None:
        raise ValueError(f"{name}: expected real numbers of shape {shape}, got {given!r:.60}")
    if numbers.shape != shape:
        raise ValueError(f"{name}: expected shape {shape}, got {numbers.shape}")
    if np.isnan(numbers).any():
        raise ValueError(f"{name}: expected numbers, got NaN")
    return numbers


def _six(name: str, numbers: ArrayLike) -> Array:
    found = real_numbers(numbers)
    if found is None or found.shape not in ((), (1,), (6,)) or not (np.isfinite(found) & (found >= 0.0)).all():
        raise ValueError(f"{name}: expected one or 6 finite numbers that are not negative, got {numbers!r}")
    return np.broadcast_to(found, (6,)).copy()


def _wrench_scale(scene: Scene) -> Array:
    force = float(scene.settings["robot.force_limit"])
    return np.asarray(np.abs(scene.hexapod.wrench_map(scene.home.position, scene.home.quaternion)).sum(axis=1) * force)


def _following(probe: _core.Probe, wanted: Array, states: dict[str, NDArray[Any]], tick: float) -> Array:
    """Return the wrenches (n, 6) [N; N m] of the velocity servo, beyond the weight: the estimate's at the states.

    All of the inertia, since a centre of mass off the origin couples force and rotation.
    """
    acceleration = (wanted - states["twist"]) * (_SHARE / tick)
    inertial, coriolis, _ = probe.estimated_wrenches(states["quaternion"], states["twist"], acceleration)
    return np.asarray(inertial + coriolis)
