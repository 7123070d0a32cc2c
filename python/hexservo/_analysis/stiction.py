"""The errors that the switching term holds: the stiction set of K_v (docs/analysis/stiction.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from hexservo._analysis._goal import Goals, find_goals
from hexservo._analysis._rest import Extremes, RestLaw, RestSet, confirmed, extremes
from hexservo._analysis._scene import Array, Scene, moved, scene_of
from hexservo._analysis._stiction_runs import Runs, run
from hexservo._analysis._words import number
from hexservo._evidence import Cell, Column, Curves, Item, Line, Section, Table
from hexservo._scenario import Fuzzy, Scenario

__all__ = ["Case", "Stiction", "analyse"]

PAGE = "docs/analysis/stiction.md"
_SETTLED = 2.0  # [px], the threshold of the settling time
_AXES = ("force along x", "force along y", "force along z", "moment about x", "moment about y", "moment about z")

_SHORT = ("along x", "along y", "along z", "about x", "about y", "about z")

Kind: TypeAlias = Literal["set", "creep", "integrated", "none", "open"]


@dataclass(frozen=True, eq=False)
class Case:
    """The set for one reading of the law."""

    name: str
    rest: RestSet
    ends: Extremes | None  # None: no pose within the stroke is held
    # [px]: the largest image error of a pose at which the core's law and legs were checked; None where none was found
    confirmed: float | None


@dataclass(frozen=True, eq=False)
class Stiction:
    """Where the switching term holds the platform, and what short runs show."""

    scene: Scene
    kind: Kind
    reason: str  # why it is of that kind, in a sentence
    kv: Array  # (6,) [N; N m]; zeros for a law without
    gravity_error: Array  # delta_G G-bar, (6,) [N; N m]
    cases: tuple[Case, ...] = ()
    around_home: Case | None = None  # the set that the runs are compared with
    runs: tuple[Runs, ...] = ()
    creep_times: Array | None = None  # (6,) [s], of the six directions, slowest first
    straight_way: Array | None = None  # (6,) [N; N m], what the fuzzy systems take up on the straight way to the goal
    prior_error: float | None = None  # [px], of the pose that an integrating law goes to

    def section(self) -> Section:
        """Put the findings in words and tables."""
        return Section(
            name="stiction",
            title="The errors that the switching term holds",
            sentences=self._sentences(),
            items=self._items(),
            verdict=self._verdict(),
            data=self._data(),
        )

    @property
    def focal_pixels(self) -> float:
        """f [px]."""
        return float(self.scene.camera.focal_pixels)

    def _verdict(self) -> Literal["good", "warning", "bad", "open"]:
        if self.kind == "none":
            return "good"
        error = self.prior_error
        if self.cases:
            ends = self.cases[0].ends
            if ends is None:
                return "bad"
            error = ends.largest
        if error is None:
            return "open"
        return "warning" if error > _SETTLED else "good"

    def _sentences(self) -> list[str]:
        if self.kind in ("none", "open", "integrated"):
            words = [self.reason]
            if self.prior_error is not None:
                words.append(
                    f"There the image is {number(self.prior_error)} px off: the prior, which expects the start, "
                    "outweighs what the image hardly shows."
                )
            return words
        words = [self._of_the_set(self.cases[0])]
        if self.reason:
            words.append(self.reason)
        for case in self.cases[1:]:
            if case.ends is not None:
                words.append(f"{case.name}: up to {number(case.ends.largest)} px.")
            else:
                words.append(f"{case.name}: no pose within the stroke.")
        words += [self._of_runs(runs) for runs in self.runs]
        return words

    def _of_the_set(self, case: Case) -> str:
        ends = case.ends
        if ends is None:
            worst = int(np.argmax(np.abs(self.gravity_error) - self.kv))
            excess = (
                f": the gravity error of {number(abs(self.gravity_error[worst]))} N is beyond K_v "
                f"({number(self.kv[worst])} N)"
                if abs(self.gravity_error[worst]) > self.kv[worst]
                else ""
            )
            return f"No pose within the stroke near the goal is an equilibrium{excess}."
        if (case.rest.high == case.rest.low).all():
            return f"The equilibrium near the goal is a point, with an image error of {number(ends.largest)} px."
        axes, legs = case.rest.limits_at(ends.displacements[0])
        limits = [f"K_v ({', '.join(_SHORT[axis] for axis in np.flatnonzero(axes))})"] if axes.any() else []
        limits += (
            [f"the stroke of the legs {', '.join(str(leg + 1) for leg in np.flatnonzero(legs))}"] if legs.any() else []
        )
        text = (
            f"K_v holds the platform with image errors of up to {number(ends.largest)} px in a coordinate "
            f"({number(ends.rms)} px RMS), {number(1e6 * ends.largest / self.focal_pixels)} urad at the focal length; "
            f"what ends the set there is {' and '.join(limits)}. Its optical axis is up to {number(1e6 * ends.turn)} urad "
            "from where the goal has it."
        )
        if case.confirmed is not None:
            text += (
                f" At a pose with {number(case.confirmed)} px the law itself is within K_v, and every leg within its "
                "stroke."
            )
        return text

    def _of_runs(self, runs: Runs) -> str:
        counted = runs.counted
        with_fuzzy = "with" if runs.fuzzy else "without"
        bound = runs.bound
        if not counted.any():
            return (
                f"Of {len(counted) - 1} runs of {number(runs.duration)} s {with_fuzzy} fuzzy systems none came to rest."
            )
        inside = int((runs.final_share[counted] <= 1.0).sum())
        largest = float(runs.final_error[counted].max())
        own = (
            f"; the scenario's own goal is {number(runs.final_error[0])} px away after this time"
            if runs.completed[0]
            else ""
        )
        return (
            f"Of {len(counted) - 1} runs of {number(runs.duration)} s {with_fuzzy} fuzzy systems to goals near the start "
            f"{int(counted.sum())} came to rest, {inside} of them within K_v, with up to {number(largest)} px: "
            f"{largest / bound:.0%} of the {number(bound)} px that the set has there"
            + (", what the fuzzy systems took up included" if runs.fuzzy else "")
            + f"{own}."
        )

    def _items(self) -> list[Item]:
        items: list[Item] = []
        if self.cases:
            items += [self._case_table(), self._axis_table()]
        if self.runs:
            items += [self._run_table(), self._run_curves()]
        return items

    def _case_table(self) -> Table:
        rows: list[Sequence[Cell]] = []
        for case in self.cases:
            ends = case.ends
            if ends is None:
                rows.append([case.name, *[None] * 8])
                continue
            rows.append(
                [
                    case.name,
                    ends.largest,
                    ends.rms,
                    1e6 * ends.largest / self.focal_pixels,
                    1e3 * ends.turn,
                    case.confirmed,
                    *(1e3 * float(np.abs(part).max()) for part in (ends.pose[:2], ends.pose[2:3], ends.pose[3:])),
                ]
            )
        return Table(
            title="What K_v holds around the goal",
            columns=(
                Column("case"),
                Column("largest coordinate", "px", ".3g"),
                Column("RMS", "px", ".3g"),
                Column("at the focal length", "urad", ".4g"),
                Column("optical axis", "mrad", ".3g"),
                Column("checked pose", "px", ".3g"),
                Column("across", "mm", ".3g"),
                Column("along z", "mm", ".3g"),
                Column("turned", "mrad", ".3g"),
            ),
            rows=rows,
            note="Linear programs over the box of K_v and the stroke of the legs, linearised at the pose nearest to home "
            "that shows the goal image within 0.1 px; tau_f = 0 but where said. Checked pose: where the law itself and "
            "the legs were evaluated.",
            page=PAGE,
        )

    def _axis_table(self) -> Table:
        zero = np.zeros(6)
        way = zero if self.straight_way is None else self.straight_way
        rows = [
            (
                name,
                "N" if axis < 3 else "N m",
                float(self.kv[axis]),
                float(self.gravity_error[axis]),
                float(way[axis]),
                max(
                    (float(np.abs(runs.fuzzy_output[runs.counted, axis]).max(initial=0.0)) for runs in self.runs),
                    default=None,
                ),
            )
            for axis, name in enumerate(_AXES)
        ]
        return Table(
            title="What acts on a platform at rest, by axis",
            columns=(
                Column("axis"),
                Column("unit"),
                Column("K_v", format=".3g"),
                Column("gravity error", format=".3g"),
                Column("fuzzy systems, straight way", format=".3g"),
                Column("fuzzy systems, largest in the runs", format=".3g"),
            ),
            rows=rows,
            note="Straight way: what one rule takes up between home and the goal, displacement/Psi.",
            page=PAGE,
        )

    def _run_table(self) -> Table:
        rows: list[Sequence[Cell]] = []
        for runs in self.runs:
            counted = runs.counted
            inside = runs.start_share <= 1.0
            for name, which in (("inside", counted & inside), ("outside", counted & ~inside)):
                rows.append(
                    [
                        "on" if runs.fuzzy else "off",
                        name,
                        int(which.sum()),
                        *(
                            [
                                float(values[which].max())
                                for values in (runs.start_error, runs.final_error, runs.final_share)
                            ]
                            if which.any()
                            else [None] * 3
                        ),
                    ]
                )
        return Table(
            title="Runs to goals near the start",
            columns=(
                Column("fuzzy systems"),
                Column("started"),
                Column("at rest"),
                Column("largest error at the start", "px", ".3g"),
                Column("largest error at the end", "px", ".3g"),
                Column("largest share of K_v at the end", format=".3g"),
            ),
            rows=rows,
            note="Inside: the law's wrench at the start is within K_v. Share: largest |w_j - tau_f,j|/k_v,j.",
            page=PAGE,
        )

    def _run_curves(self) -> Curves:
        lines = [
            Line(
                f"fuzzy systems {'on' if runs.fuzzy else 'off'}",
                runs.start_error[runs.counted],
                runs.final_error[runs.counted],
                "points",
            )
            for runs in self.runs
        ]
        widest = max(float(line.x.max(initial=0.0)) for line in lines)
        for runs in self.runs:
            name = "largest of the set" + (", with what the fuzzy systems took up" if runs.fuzzy else "")
            lines.append(Line(name, np.array([0.0, widest]), np.full(2, runs.bound), "dashed"))
        return Curves(
            title="Where runs come to rest",
            x_label="largest error at the start [px]",
            y_label="largest error at the end [px]",
            lines=lines,
            page=PAGE,
        )

    def _data(self) -> dict[str, object]:
        return {
            "kind": self.kind,
            "reason": self.reason,
            "kv": self.kv,
            "gravity_error": self.gravity_error,
            "creep_times": self.creep_times,
            "fuzzy_straight_way": self.straight_way,
            "prior_error": self.prior_error,
            "cases": [
                {
                    "name": case.name,
                    "equilibrium": case.ends is not None,
                    "largest_error": None if case.ends is None else case.ends.largest,
                    "rms_error": None if case.ends is None else case.ends.rms,
                    "angle_at_focal_length": None if case.ends is None else case.ends.largest / self.focal_pixels,
                    "optical_axis_turn": None if case.ends is None else case.ends.turn,
                    "confirmed_error": case.confirmed,
                    "pose": None if case.ends is None else case.ends.pose,
                }
                for case in self.cases
            ],
            "around_home": None
            if self.around_home is None or self.around_home.ends is None
            else self.around_home.ends.largest,
            "runs": [
                {
                    "fuzzy": runs.fuzzy,
                    "duration": runs.duration,
                    "bound": runs.bound,
                    "counted": runs.counted,
                    "start_error": runs.start_error,
                    "final_error": runs.final_error,
                    "start_share": runs.start_share,
                    "final_share": runs.final_share,
                }
                for runs in self.runs
            ],
        }


def analyse(scenario: Scenario) -> Stiction:
    """Find the poses where the switching term holds the platform, and compare with short runs.

    Applies to `hybrid`, and to `composite` where its fuzzy systems do not integrate, with `sign`, `implicit` or
    `implicit_coupled`. Other cases are told in words.
    """
    scene = scene_of(scenario)
    kind, reason = _kind(scenario)
    nothing = np.zeros(6)
    if kind in ("none", "open"):
        return Stiction(scene, kind, reason, nothing, nothing)
    goals = find_goals(scene)
    assert goals is not None  # a camera without points is open
    law = RestLaw(scene)
    block = getattr(scenario.controller, scenario.controller.law)
    kv = np.array(np.broadcast_to(np.asarray(block.kv, dtype=float), 6))
    if kind == "integrated":
        return Stiction(scene, kind, reason, kv, law.gravity_error, prior_error=_prior_error(scene, goals))
    box = kv if kind == "set" else nothing
    cases = [_case(scene, law, goals, "J-hat, with the depth error", -box, box)]
    if np.any(np.asarray(scenario.uncertainty.depth) != 0):
        cases.append(_case(scene, RestLaw(scene, exact_depth=True), goals, "J, depths known", -box, box))
    way = None
    if scenario.controller.law == "hybrid" and block.fuzzy.enabled:
        way = _straight_way(block.fuzzy, goals)
        low, high = np.minimum(way, 0.0) - box, np.maximum(way, 0.0) + box
        cases.append(_case(scene, law, goals, "J-hat, with what the fuzzy systems take up", low, high))
    if kind == "creep":
        times = _creep_times(cases[0].rest, kv, scenario.controller.switching.width)
        return Stiction(
            scene,
            kind,
            reason + _in_creep_words(times, scenario.simulation.duration),
            kv,
            law.gravity_error,
            tuple(cases),
            creep_times=times,
            straight_way=way,
        )
    home = _around_home(scene, law, box)
    runs: tuple[Runs, ...] = ()
    if home.ends is not None and (kv > 0).all():
        settings = [False, True] if block.fuzzy.enabled else [False]
        runs = tuple(run(scene, law, home.rest, home.ends, kv, fuzzy) for fuzzy in settings)
    return Stiction(scene, kind, reason, kv, law.gravity_error, tuple(cases), home, runs, straight_way=way)


def _kind(scenario: Scenario) -> tuple[Kind, str]:
    """Say which question a law poses."""
    law = scenario.controller.law
    if law not in ("hybrid", "composite"):
        return "none", f"The law {law} has no switching term: nothing holds the platform off its equilibrium."
    if scenario.camera.convention == "as_printed":
        return "open", "Open: a camera as printed has no points in space, so the set has no poses."
    block = getattr(scenario.controller, law)
    switching = scenario.controller.switching
    smooth = switching.kind in ("tanh", "saturation")
    if law == "composite" and block.fuzzy.enabled:
        drive = np.broadcast_to(np.asarray(block.drive, dtype=float), 6)
        fuzzy = block.fuzzy
        restrained = (
            np.any(np.asarray(fuzzy.leakage) > 0)
            or np.any(np.asarray(fuzzy.dead_zone) > 0)
            or fuzzy.weight_limit is not None
        )
        if (drive > 0).all() and not restrained:
            return "integrated", (
                "There is no stiction set: the pose error e drives the fuzzy systems until they overcome K_v, so the "
                "platform creeps or slips on until e = 0."
            )
        if (drive > 0).any():
            return "open", (
                "Open: the pose error drives the fuzzy systems only in part of the axes, or leakage, dead zone or limit "
                "of the weights bound what they take up; the set is then not that of K_v alone."
            )
    if smooth:
        return "creep", (
            f"There is no stiction set: {switching.kind} is zero at rest, so within K_v the platform creeps, with "
            f"K_v/width as viscous damping"
        )
    kv = np.broadcast_to(np.asarray(block.kv, dtype=float), 6)
    if (kv == 0).all():
        return "set", "K_v = 0: the set is a point, where the law's wrench makes up for the gravity error."
    if switching.kind == "sign":
        return "set", ""
    return "set", f"With {switching.kind} a platform in the set is at rest exactly."


def _case(scene: Scene, law: RestLaw, goals: Goals, name: str, low: Array, high: Array) -> Case:
    point = (high == low).all()  # then it is the goal itself, but for a gravity error
    rest = RestSet.at(scene, law, (goals.best if point else goals.nearest).view, low, high)
    ends = extremes(rest)
    if ends is None:
        return Case(name, rest, None, None)
    found = confirmed(scene, law, rest, ends.displacements[0]) if (high > low).all() else None
    return Case(name, rest, ends, None if found is None else found[1])


def _around_home(scene: Scene, law: RestLaw, box: Array) -> Case:
    home = scene.view(scene.home)
    rest = RestSet.at(scene, law.aimed_at(home.features), home, -box, box)
    return Case("around home", rest, extremes(rest), None)


def _straight_way(fuzzy: Fuzzy, goals: Goals) -> Array:
    """What one rule that fires alone takes up between home and the goal: displacement/Psi, within the limit."""
    way = goals.nearest.displacement / np.broadcast_to(np.asarray(fuzzy.adaptation), 6)
    if fuzzy.weight_limit is not None:
        limit = np.asarray(fuzzy.weight_limit)
        way = np.clip(way, -limit, limit)
    return np.asarray(way, dtype=float)


def _creep_times(rest: RestSet, kv: Array, width: float) -> Array:
    """Time constants of (K_v/width) d-dot = -A d, (6,) [s], slowest first; infinite or NaN where it does not decay."""
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = np.linalg.eigvals(width * rest.stiffness / kv[:, None]).real if (kv > 0).all() else np.full(6, np.nan)
        return np.sort(np.where(rates > 0, 1.0 / rates, np.inf))[::-1]


def _in_creep_words(times: Array, duration: float) -> str:
    slow = times[times > duration]
    if not np.isfinite(times).all():
        return "; in some direction it does not come back by itself."
    return f"; the slowest direction takes {number(times[0])} s by 1/e, " + (
        f"{len(slow)} of 6 longer than the run." if len(slow) else "all less than the run."
    )


def _prior_error(scene: Scene, goals: Goals) -> float | None:
    """Give the image error where the pose error e of `composite` vanishes [px], near the goal; None if not found."""
    from scipy.optimize import root

    changes = {"kp": 0.0, "kd": 0.0, "kt": 1.0}  # the law's wrench is then e
    only_e = Scene(scene.scenario.updated({f"controller.composite.{key}": value for key, value in changes.items()}))
    law = RestLaw(only_e)

    def error(x: Array) -> Array:
        return law.wrench(moved(goals.nearest.view.pose, x)) - law.gravity_error

    try:
        found = root(error, np.zeros(6), options={"xtol": 1e-12})
    except ValueError:  # a step behind the camera or to a singular pose
        return None
    if np.abs(error(found.x)).max() > 1e-9:
        return None
    view = scene.view(moved(goals.nearest.view.pose, found.x))
    return float(np.abs(scene.desired - view.features).max())
