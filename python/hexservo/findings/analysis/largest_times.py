"""Slowest camera with which the task itself still settles, found by runs (docs/analysis/largest_start.md)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hexservo.findings.analysis.settling_runs import SettlingRuns, Tried, first_overload
from hexservo.findings.analysis.tried import ROUNDS, bordering, outwards, quarters
from hexservo.run.leg_limits import LimitUse
from hexservo.scenario.laws import LAWS, laws_with
from hexservo.scenario.parameters import frame_period, timeout_room
from hexservo.scenario.scenario import Scenario

_TICKS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 200, 300, 500)  # periods and latencies of the first round


@dataclass(frozen=True, eq=False)
class Timing:
    """Period or latency of the camera, with the other one constant."""

    what: str  # period | latency
    prediction: str  # none | encoder
    other: float  # [s], the one that is held
    own: float  # [s], of the scenario
    tried: Tried  # by time [s]
    settles_later: bool | None  # whether `fails_at` settles in a longer run; None where there was none
    beyond: dict[float, LimitUse]  # by time [s], of those that fail for a leg beyond a limit alone
    overloads: dict[float, LimitUse]  # by time [s], of those that settle with forces beyond the legs' limit
    timeout: float | None  # longest time that `camera.timeout` has room for [s]; None: it ends no search
    reseeded: tuple[bool, ...]  # whether `fails_at` settles with each of some other seeds; empty: nothing is random

    @property
    def settles_to(self) -> float | None:
        """Largest time [s] up to which everything that was tried settles, from `own` on, or from 0 where that fails.

        None where `own` and the smallest fail.
        """
        return bordering(outwards(self.tried, self.own))[0]

    @property
    def fails_at(self) -> float | None:
        """Smallest time [s] that was seen to fail, above `own` where that settles; None where none was."""
        return bordering(outwards(self.tried, self.own))[1]

    @property
    def fails_below(self) -> float | None:
        """Largest time [s] that was seen to fail below one that settles, `own`; None where none was."""
        if not self.tried.get(self.own, False):
            return None
        return max((time for time, good in self.tried.items() if time < self.own and not good), default=None)

    @property
    def settles_again(self) -> float | None:
        """Largest time [s] above `fails_at` that was seen to settle; None where none was."""
        failed = self.fails_at
        larger = (time for time, good in self.tried.items() if good and failed is not None and time > failed)
        return max(larger, default=None)

    @property
    def overloaded_from(self) -> float | None:
        """Smallest time [s] that settles with forces beyond the legs' limit, up to `settles_to`; None for none."""
        return None if self.settles_to is None else first_overload(self.overloads, self.settles_to)

    @property
    def limited_by(self) -> str | None:
        """What fails first, `error` or the kind of the legs' limit; None where nothing was seen to fail."""
        if self.fails_at is None:
            return None
        return self.beyond[self.fails_at].limit.kind if self.fails_at in self.beyond else "error"


def camera_times(scenario: Scenario, trial: SettlingRuns) -> tuple[tuple[Timing, ...], str]:
    """Try periods and latencies for the task itself, in the sampled loop."""
    assumed, changes = "", {}
    if not scenario.sampled:
        assumed = f"sampled every {1e3 * scenario.simulation.step:.3g} ms"
        changes["simulation.mode"] = "sampled"
        if scenario.controller.law in laws_with("switching") and scenario.controller.switching.kind == "sign":
            assumed += " with implicit switching"
            changes["controller.switching.kind"] = "implicit"
        assumed += ", "
    sampled = trial.scenario.updated(changes) if changes else trial.scenario
    predictions = [sampled.camera.prediction]
    if predictions == ["none"] and scenario.controller.law in LAWS:  # the others predict the target
        predictions.append("encoder")
    found = []
    for prediction in predictions:
        base = sampled.updated({"camera.prediction": prediction})
        for what in ("period", "latency"):
            other = base.camera.latency if what == "period" else frame_period(base)
            found.append(_timing(base, what, other, trial))
    return tuple(found), assumed


def _timing(base: Scenario, what: str, other: float, trial: SettlingRuns) -> Timing:
    """Try one time of the camera: a grid, then between the last that settles and the first that fails, in ticks."""
    step = base.simulation.step
    own = round((frame_period(base) if what == "period" else base.camera.latency) / step)
    tried: dict[int, bool] = {}
    beyond: dict[float, LimitUse] = {}
    overloads: dict[float, LimitUse] = {}

    def run(ticks: list[int]) -> None:
        new = sorted(set(ticks) - set(tried))
        if new:
            ends = trial.ends({f"camera.{what}": np.array([tick * step for tick in new])}, base)
            for k, tick in enumerate(new):
                if ends.ran[k]:
                    tried[tick] = bool(ends.settled[k])
                if (use := ends.beyond[k]) is not None:
                    beyond[tick * step] = use
                if (more := ends.overloads[k]) is not None:
                    overloads[tick * step] = more

    # A run of less than two periods shows nothing of them, and one shorter than the latency has no image.
    longest = base.simulation.duration / (2.0 if what == "period" else 1.0)
    shown = [tick for tick in _TICKS if tick * step < longest] or [1]
    timeout = None
    if (room := timeout_room(base)) is not None and own + room < shown[-1]:
        shown = [*(tick for tick in shown if tick < own + room), own + room]
        timeout = (own + room) * step
    run([own, *shown] if what == "period" else [0, own, *shown])
    for _ in range(ROUNDS):
        run(quarters(outwards(tried, own)))
    times = {tick * step: good for tick, good in tried.items()}
    found = Timing(what, base.camera.prediction, other, own * step, times, None, beyond, overloads, timeout, ())
    if found.fails_at is None:
        return found
    (reseeded,) = trial.reseeded({f"camera.{what}": np.array([found.fails_at])}, base)
    found = replace(found, reseeded=reseeded)
    if found.fails_at in beyond or trial.duration == trial.longer:
        return found
    longer = base.updated({"simulation.duration": trial.longer})
    settled = trial.ends({f"camera.{what}": np.array([found.fails_at])}, longer).settled
    return replace(found, settles_later=bool(settled[0]))
