"""The sampled loop at rest as one matrix over a pattern of its clocks: spectral radius and unstable modes.

Independent of the robot: the matrices may have any number of axes. `docs/analysis/camera_rate.md` has the formulas.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from math import lcm
from typing import Literal, TypeVar

import numpy as np

from hexservo.scenario.arrays import Array, Complex

BORDER = 1.0 + 1e-8
"""A spectral radius beyond it counts as unstable: closer to 1 rounding and finite differences decide."""

_NOTHING = 1e-6  # of a mode, at most, is left at the end of a pattern: at which frequency it decays is of no account

_LARGEST = 95  # numbers of a pattern's state up to which its eigenvalues are cheap (BLAS stays on one thread)


_States = TypeVar("_States", Array, Complex)


@dataclass(frozen=True)
class Clock:
    """When the camera exposes and when its frames arrive, in servo ticks."""

    period: int  # between two exposures, >= 1
    latency: int  # from an exposure to its first use, >= 0


@dataclass(frozen=True, eq=False)
class Actuation:
    """From the commanded wrench to the acting one, for n axes; the default does nothing.

    Leg forces are represented by their wrenches at the pose of rest.
    """

    through_legs: bool = False  # the command becomes leg forces at the pose of its tick
    delay: int = 0  # [ticks]
    left: float = 0.0  # of a difference, by the lag, at the end of a tick: 0 without lag
    left_on_average: float = 0.0  # the same, mean over the tick
    stiffness: Array | None = None  # (n, n) d(H f)/dx, where `through_legs`
    held: tuple[Array, Array] | None = None  # (2n, 2n), (2n, n): plant over a tick under held leg forces


@dataclass(frozen=True, eq=False)
class SampledLoop:
    """A plant at rest and a law, both linear, between the clocks of camera, sensors and servo.

    With x the displacement from rest, v its rate, f what is known of the frame in use, s the state of the law, and
    the sensors' pose and rate in place of x and v where they differ:

        command = gain (frame f + pose x) + twist v - s        s <- decay s + gain (drive_frame f + drive_pose x)
                                                                    + drive_twist v
        x <- x + T v + T^2/2 a,  v <- v + T a,  a = acceleration (acting wrench)

    Disturbances d are constant and part of the state: `disturbance` is the wrench of each beside the acting one, and
    `target` the displacement that each gives to the target, by which a pose has to be displaced to see the same image.

    f is x at the exposure (n,), less that displacement, and where it has 2n numbers then also the sensors' error there:
    by how far their pose is from the one that has the exposed image before a target that stays.
    """

    tick: float  # T, servo period [s]
    acceleration: Array  # (n, n) of a wrench
    frame: Array  # (n, n) or (n, 2n)
    pose: Array  # (n, n)
    twist: Array  # (n, n)
    axes: tuple[int, ...] = ()  # on which the states of the law act
    decay: Array = field(default_factory=lambda: np.zeros(0))  # (m,)
    drive_frame: Array = field(default_factory=lambda: np.zeros((0, 0)))  # (m, n) or (m, 2n)
    drive_pose: Array = field(default_factory=lambda: np.zeros((0, 0)))  # (m, n)
    drive_twist: Array = field(default_factory=lambda: np.zeros((0, 0)))  # (m, n)
    reading: int = 1  # ticks between two readings of the joint sensors
    differences: bool = False  # the sensors' rate is the difference of two readings over their time
    actuation: Actuation = field(default_factory=Actuation)
    gain: float = 1.0  # factor on the proportional gains
    disturbance: Array | None = None  # (n, k) wrench of each of k disturbances; None: k = 0
    target: Array | None = None  # (n, k) displacement of the target by each of the disturbances; None: 0
    by_eigenvalues: bool = False  # how growing modes are found with any number of frames under way
    _powers: dict[tuple[str, int], Array] = field(default_factory=dict, init=False, repr=False)

    # --- the state of a tick: x, v | s | sensors' x, v | commands under way, lag | frame in use -------------------
    @property
    def _sensing(self) -> bool:
        return self.reading > 1 or self.differences

    @cached_property
    def _parts(self) -> dict[str, slice]:
        n = len(self.acceleration)
        sizes = {
            "x": n,
            "v": n,
            "s": len(self.axes),
            "x_seen": n if self._sensing else 0,
            "v_seen": n if self._sensing else 0,
            "commands": n * self.actuation.delay,
            "lag": n if self.actuation.left > 0.0 else 0,
            "d": 0 if self.disturbance is None else self.disturbance.shape[1],
            "f": self.frame.shape[1],
        }
        ends = np.cumsum([0, *sizes.values()])
        return {name: slice(int(a), int(b)) for name, a, b in zip(sizes, ends[:-1], ends[1:], strict=True)}

    @property
    def size(self) -> int:
        """Size of the state at a tick, without the frames in transit."""
        return int(self._parts["f"].stop)

    @property
    def has_devices(self) -> bool:
        """Whether sensors or actuators do more than give the pose and hold the wrench."""
        return self._sensing or self.actuation.through_legs

    @property
    def few(self) -> int:
        """Frames under way up to which growing modes are found from the eigenvalues; beyond it they are counted.

        They cannot be counted if the joint sensors have a separate period, and are not `by_eigenvalues`.
        """
        return max(1, (_LARGEST - self.size) // int(self.frame.shape[1]))

    def _read(self) -> Array:
        """Return the map of the state by a reading of the joint sensors."""
        change = np.eye(self.size)
        if self._sensing:
            at = self._parts
            change[at["v_seen"]] = change[at["v"]]
            if self.differences:
                change[at["v_seen"]] = (np.eye(self.size)[at["x"]] - np.eye(self.size)[at["x_seen"]]) / (
                    self.reading * self.tick
                )
            change[at["x_seen"]] = np.eye(self.size)[at["x"]]
        return change

    def _act(self) -> Array:
        """Return the map of the state by law, actuators and plant in one tick."""
        at, unit = self._parts, np.eye(self.size)
        n = len(self.acceleration)
        x, v, s, f = unit[at["x"]], unit[at["v"]], unit[at["s"]], unit[at["f"]]
        seen = (unit[at["x_seen"]], unit[at["v_seen"]]) if self._sensing else (x, v)

        change = np.zeros_like(unit)
        change[at["f"]] = f
        change[at["x_seen"]], change[at["v_seen"]] = unit[at["x_seen"]], unit[at["v_seen"]]
        command = self.gain * (self.frame @ f + self.pose @ seen[0]) + self.twist @ seen[1]
        if self.axes:
            command[list(self.axes)] -= s
            change[at["s"]] = self.decay[:, None] * s + self.drive_twist @ seen[1]
            change[at["s"]] += self.gain * (self.drive_frame @ f + self.drive_pose @ seen[0])

        a = self.actuation
        if a.through_legs and a.stiffness is not None:
            command = command - a.stiffness @ seen[0]  # as leg forces: H at the controller's pose
        arrived = command
        if a.delay > 0:
            under_way = unit[at["commands"]]
            arrived = under_way[:n]  # the oldest comes first
            change[at["commands"]] = np.vstack([under_way[n:], command])
        acting = arrived
        if a.left > 0.0:
            missing = unit[at["lag"]] - arrived
            acting = arrived + a.left_on_average * missing
            change[at["lag"]] = arrived + a.left * missing
        if self.disturbance is not None:
            acting = acting + self.disturbance @ unit[at["d"]]
            change[at["d"]] = unit[at["d"]]
        state = slice(0, 2 * n)
        if a.held is not None:
            change[state] = a.held[0] @ unit[state] + a.held[1] @ acting
        else:
            if a.through_legs and a.stiffness is not None:
                acting = acting + a.stiffness @ x  # as a wrench: H at the true pose
            rate = self.acceleration @ acting
            change[at["x"]] = x + self.tick * v + 0.5 * self.tick**2 * rate
            change[at["v"]] = v + self.tick * rate
        return change

    # --- from tick to tick: always after the reading of a tick, before the law's turn -----------------------------
    def _power(self, of: Literal["pauses", "reads", "readings"], count: int) -> Array:
        """Return the map of the state over ticks without a reading, with one at each, or over whole readings."""
        known = self._powers
        if (of, count) not in known:
            if count == 0:
                known[of, count] = np.eye(self.size)
            elif count > 1:  # by halves, whose own halves are soon known
                known[of, count] = self._power(of, count // 2) @ self._power(of, count - count // 2)
            elif of == "pauses":
                known[of, count] = self._act()
            else:
                known[of, count] = self._read() @ self._power("pauses", 1 if of == "reads" else self.reading)
        return known[of, count]

    def _passage(self, start: int, stop: int) -> Array:
        """Return the map of the state from one tick to another."""
        if self.reading == 1:
            return self._power("reads", stop - start)
        first = -(-start // self.reading) * self.reading  # the next reading, or one that is just over
        if stop < first:
            return self._power("pauses", stop - start)
        change = self._power("pauses", first - start)
        if first > start:
            change = self._read() @ change
        readings, rest = divmod(stop - first, self.reading)
        return self._power("pauses", rest) @ self._power("readings", readings) @ change

    def _exposed(self) -> Array:
        """Return the content of a frame exposed now, (f, state)."""
        at, unit = self._parts, np.eye(self.size)
        x = unit[at["x"]]
        seen_from = x if self.target is None else x - self.target @ unit[at["d"]]
        if self.frame.shape[1] == len(x):
            return seen_from
        return np.vstack([seen_from, (unit[at["x_seen"]] if self._sensing else x) - seen_from])

    def pattern(self, clock: Clock) -> Array:
        """Monodromy matrix: the state over the least pattern of all clocks, with the frames under way.

        It begins at an exposure. The state is that of a tick, then the frames under way, the oldest first.
        """
        return self._walk(clock, np.eye(self.size + self.frame.shape[1] * (clock.latency // clock.period)))

    def _walk(self, clock: Clock, states: _States, visit: Callable[[_States], None] | None = None) -> _States:
        """Return states (m, k) at a pattern's start as they are at its end; `visit` gets those of each tick between."""
        size, wide = self.size, self.frame.shape[1]
        at = self._parts["f"]
        rest = clock.latency % clock.period

        def move(start: int, stop: int) -> None:
            if visit is None:
                states[:size] = self._passage(start, stop) @ states[:size]
                return
            for tick in range(start, stop):
                visit(states[:size].copy())
                states[:size] = self._passage(tick, tick + 1) @ states[:size]

        for begin in range(0, lcm(clock.period, self.reading), clock.period):
            states = np.vstack([states, self._exposed() @ states[:size]])
            move(begin, begin + rest)
            states[at] = states[size : size + wide]  # the frame that is due
            states = np.delete(states, slice(size, size + wide), axis=0)
            move(begin + rest, begin + clock.period)
        return states

    def resting_at(self, clock: Clock) -> Array:
        """Return the states of the pattern for a platform at rest at a displacement, seen in all frames, (m, n).

        Commands under way and states of the law are those of the pose of rest.
        """
        n, at = len(self.acceleration), self._parts
        states = np.zeros((self.size + self.frame.shape[1] * (clock.latency // clock.period), n))
        places = [at["x"].start, *range(at["f"].start, len(states), self.frame.shape[1])]
        for begin in [*places, at["x_seen"].start] if self._sensing else places:
            states[begin : begin + n] = np.eye(n)
        return states

    def driven(self, clock: Clock) -> tuple[Array, Array]:
        """Return the pattern without the disturbances in its state, and what constant ones add to that, (m, k)."""
        whole = self.pattern(clock)
        inputs = np.zeros(len(whole), dtype=bool)
        inputs[self._parts["d"]] = True
        return whole[np.ix_(~inputs, ~inputs)], whole[np.ix_(~inputs, inputs)]

    def seconds(self, clock: Clock) -> float:
        """Duration of the pattern [s]."""
        return lcm(clock.period, self.reading) * self.tick

    # --- modes that are known to stay -----------------------------------------------------------------------------
    def _balance(self) -> Array:
        """Return command and change of the law's state, (n + m, n + m), where (x, s) stay."""
        n, m = len(self.acceleration), len(self.axes)
        balance = np.zeros((n + m, n + m))
        balance[:n, :n] = self.gain * (self.frame[:, :n] + self.pose)
        balance[list(self.axes), range(n, n + m)] -= 1.0
        if m:
            balance[n:, :n] = self.gain * (self.drive_frame[:, :n] + self.drive_pose)
            balance[range(n, n + m), range(n, n + m)] += self.decay - 1.0
        return balance

    @cached_property
    def resting(self) -> Array:
        """Neutral modes: displacements and states of the law that the loop does not change, (n + m, k); mostly k = 0.

        They belong to the eigenvalue 1 whatever the clocks are: where the image has no stiffness, or where a state of
        the law learns from the rate alone and therefore is a spring towards the start.
        """
        balance = self._balance()
        rows = np.abs(balance).max(axis=1)
        balance = balance[rows > 0.0] / rows[rows > 0.0][:, None]
        columns = np.maximum(np.abs(balance).max(axis=0, initial=0.0), 1e-300)
        columns[columns < 1e-12] = 1.0
        _, sizes, directions = np.linalg.svd(balance / columns)
        rank = int(np.sum(sizes > 1e-9 * max(float(sizes.max(initial=0.0)), 1e-300)))
        return np.asarray(directions[rank:].T / columns[:, None])

    def _staying(self, clock: Clock) -> Array:
        """Return `resting` as states of the pattern."""
        still = self.resting
        n, at = len(self.acceleration), self._parts
        states = self.resting_at(clock) @ still[:n]
        states[at["s"]] = still[n:]
        if self.actuation.through_legs and self.actuation.stiffness is not None:
            force = -self.actuation.stiffness @ still[:n]
            for k in range(self.actuation.delay):
                states[at["commands"].start + k * n : at["commands"].start + (k + 1) * n] = force
            if self.actuation.left > 0.0:
                states[at["lag"]] = force
        return states

    # --- verdicts -------------------------------------------------------------------------------------------------
    def _reduced(self, clock: Clock) -> tuple[Array, Array]:
        """Return the pattern without the modes of `resting`, and the states that it acts on, one a column."""
        whole = self.pattern(clock)
        basis = np.eye(len(whole))
        staying = self._staying(clock)
        if staying.shape[1]:
            # What the pattern does to the states modulo those that stay.
            full, _ = np.linalg.qr(staying, mode="complete")
            basis = full[:, staying.shape[1] :]
            whole = basis.T @ whole @ basis
        return whole, basis

    def multipliers(self, clock: Clock) -> Complex:
        """Eigenvalues of the pattern without the modes of `resting`, largest first."""
        values = np.linalg.eigvals(self._reduced(clock)[0]).astype(complex)
        return np.asarray(values[np.argsort(-np.abs(values), kind="stable")])

    def modes(self, clock: Clock) -> tuple[Complex, Array]:
        """Return `multipliers`, and the angle [rad] by which each mode turns over the pattern, whole turns included.

        A multiplier has the angle less whole turns alone: what oscillates faster than half the frame rate has an alias.
        The displacement of a mode is multiplier^(t/pattern) times what repeats with the pattern; of that the largest
        harmonic is added, by kinetic energy. It makes no difference for modes of which nothing is left at the end.
        """
        whole, basis = self._reduced(clock)
        values, vectors = np.linalg.eig(whole)
        order = np.argsort(-np.abs(values), kind="stable")
        values, vectors = values[order].astype(complex), vectors[:, order]
        angles = np.angle(values)
        left = np.abs(values) > _NOTHING
        rates: list[Complex] = []
        # Of the rates, which the modes of `resting` do not have.
        self._walk(clock, basis @ vectors[:, left].astype(complex), lambda state: rates.append(state[self._parts["v"]]))
        ticks = np.arange(len(rates))[:, None]
        logarithms = np.log(np.abs(values[left])) + 1j * angles[left]
        repeating = np.array(rates) * np.exp(-logarithms * ticks / len(ticks))[:, None, :]
        harmonics = np.fft.fft(repeating, axis=0)
        energy = np.abs(np.sum(harmonics.conj() * np.linalg.solve(self.acceleration, harmonics), axis=1))
        turns = np.fft.fftfreq(len(ticks), 1.0 / len(ticks))[:, None]
        ratio = np.exp((logarithms + 2j * np.pi * turns) / len(ticks))  # of two displacements a tick apart
        energy /= np.maximum(np.abs(ratio - 1.0) / np.maximum(np.abs(ratio + 1.0), 1e-9), 1e-150) ** 2
        angles[left] += 2.0 * np.pi * turns[np.argmax(energy, axis=0), 0]
        return values, angles

    def motion(self, clock: Clock, multiplier: complex) -> Complex:
        """Return the displacement (n,) at the pattern's start of the mode whose multiplier is nearest, of length 1."""
        whole, basis = self._reduced(clock)
        values, vectors = np.linalg.eig(whole)
        mode = basis @ vectors[:, int(np.argmin(np.abs(values - multiplier)))]
        shape = mode[self._parts["x"]].astype(complex)
        return np.asarray(shape / max(float(np.linalg.norm(shape)), 1e-300))

    def growing(self, clock: Clock) -> int:
        """Count the modes that grow: multipliers beyond `BORDER`."""
        if self.reading == 1 and not self.by_eigenvalues and clock.latency // clock.period > self.few:
            return self._counted(clock)
        return int(np.sum(np.abs(self.multipliers(clock)) > BORDER))

    def _counted(self, clock: Clock) -> int:
        """Count the eigenvalues beyond `BORDER` by the argument principle, without a matrix of all frames in transit.

        With M for a period in which the due frame is known to be zero, N for what that frame adds and X for what an
        exposure sees, the eigenvalues z fulfil det(z I - M - z^-q N X) = 0 at q frames under way.
        """
        under_way, rest = divmod(clock.latency, clock.period)
        at = self._parts["f"]
        before, after = self._passage(0, rest), self._passage(rest, clock.period)
        cleared = before.copy()
        cleared[at] = 0.0
        known, added = after @ cleared, after[:, at] @ self._exposed()
        if rest == 0:  # the frame in use is replaced at once: nothing depends on it
            known, added = np.delete(known, at, 0), np.delete(added, at, 0)
            known, added = np.delete(known, at, 1), np.delete(added, at, 1)
        size = len(known)
        seen = np.flatnonzero(added.any(axis=0))
        added = added[:, seen]

        def determinant(angle: Array) -> tuple[Array, Array]:
            z = BORDER * np.exp(1j * angle)
            matrices = np.empty((len(z), size, size), dtype=complex)
            matrices[:] = -known
            matrices[:, range(size), range(size)] += z[:, None]
            matrices[:, :, seen] -= (z ** float(-under_way))[:, None, None] * added
            sign, logarithm = np.linalg.slogdet(matrices)
            return np.asarray(np.angle(sign)), np.asarray(logarithm)

        # Fine about z = 1, where slow modes are, and fine enough elsewhere for the winding of z^-q.
        fine = np.geomspace(1e-10, np.pi, 160)
        even = np.linspace(0.0, np.pi, 128 + 3 * under_way)
        angle = np.unique(np.concatenate([fine, even]))
        phase, size_of = determinant(angle)
        for _ in range(40):
            steep = np.abs(np.diff(size_of)) > 1.0
            steep |= np.abs(np.angle(np.exp(1j * np.diff(phase)))) > 0.7
            # Several zeros near each other may turn the phase by a whole turn in one step: neighbours tell.
            near = steep.copy()
            near[1:] |= steep[:-1]
            near[:-1] |= steep[1:]
            wide = np.flatnonzero(near)
            if not steep.any():
                break
            between = 0.5 * (angle[wide] + angle[wide + 1])
            more = determinant(between)
            angle = np.insert(angle, wide + 1, between)
            phase, size_of = np.insert(phase, wide + 1, more[0]), np.insert(size_of, wide + 1, more[1])
        turns = float(np.sum(np.angle(np.exp(1j * np.diff(phase)))) / np.pi)  # of the whole circle
        return size - round(turns)
