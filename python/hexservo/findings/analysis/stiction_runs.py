"""Short runs to goals near the start: the poses at which K_v actually holds the platform."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.rest import RestLaw
from hexservo.findings.analysis.scene import AT_HOME, AT_REST, Scene
from hexservo.findings.analysis.stiction_set import Extremes, RestSet
from hexservo.run.batch import simulate_batch, whole
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.parameters import gains_of

COUNT = 64  # goals, the scenario's own the first
_DURATION = 2.0  # [s], at most
_STEPS = 4000  # at most
_CHATTER = 5.0  # times what the switching term changes the speed in a step, is called rest
_BORDER = 1.01  # times K_v: viscous damping lets a platform end on the border of the set, where it comes to rest slowly
_LEAVING = 0.05  # of K_v: a platform that this accelerates has to be found to move by the end of a run
_DAMPED = 0.02  # of K_v: most that viscous damping may hold at rest
_SHARES = (0.3, 0.6, 0.9)  # of the way to an extreme of the set


@dataclass(frozen=True, eq=False)
class Runs:
    """Runs of the scenario's law from home to goals near it."""

    fuzzy: bool  # whether the fuzzy systems were on
    duration: float  # [s]
    completed: Mask  # (n,)
    too_short: bool  # for a platform that is accelerated by 5 % of K_v to move faster than the chatter
    # (n,) as slow at the end as the chatter of the switching term; no leg more than a stroke from its length at the
    # goal, as in the set; and not the scenario's own goal
    slow: Mask
    counted: Mask  # (n,) of these, at rest within K_v: compared with the set around home; none if too short
    start_error: Array  # (n,) [px], largest coordinate
    final_error: Array  # (n,) [px]
    start_share: Array  # (n,) largest |w_j|/k_v,j at the start; NaN where every k_v,j is 0
    final_share: Array  # (n,) largest |w_j - tau_f,j|/k_v,j at the end
    fuzzy_output: Array  # (n, 6) [N; N m] at the end
    bound: float  # [px], largest error of the set around home, with K_v widened by the largest tau_f,j of what counts


def run(scene: Scene, law: RestLaw, rest: RestSet, ends: Extremes, kv: Array, fuzzy: bool) -> Runs:
    """Run the scenario's law to its own goal and to 63 goals near home, without noise, faults, border and base motion.

    Half of the goals are seen from 30, 60 and 90 % of the way to extremes of the set around home, so that most of
    these platforms are held where they start; the others from random displacements of up to half the stroke or span,
    most of them outside of the set.

    Parameters
    ----------
    scene, law
        Of the scenario.
    rest, ends
        The set around home, for a goal at home, and its extremes.
    kv
        K_v, (6,) [N; N m].
    fuzzy
        Whether the fuzzy systems are on.
    """
    scenario = scene.scenario
    wanted = min(scenario.simulation.duration, _DURATION) / scenario.simulation.step
    steps = max(1, min(_STEPS, round(wanted)))
    duration = steps * scenario.simulation.step
    name = scenario.controller.law
    changes: dict[str, Any] = {
        **AT_HOME,
        "simulation.duration": duration,
        "simulation.log_every": 1,
        f"controller.{name}.fuzzy.enabled": fuzzy,
    }
    if scenario.sampled:
        quiet = dict.fromkeys(("noise", "quantisation", "dropout", "outlier_probability"), 0.0)
        changes |= {f"camera.{key}": value for key, value in quiet.items()}
        changes |= {**AT_REST, "sensors.noise": 0.0, "camera.image_size": None}
    moved = scene.home.moved(_displacements(rest, ends))
    goals = np.vstack([scene.desired, scene.image(moved)[0]])
    batch = whole(simulate_batch(scenario.updated(changes), {"target.desired_features": goals}, threads=2))

    home = scene.view(scene.home)
    settings = scene.settings
    inertia = np.concatenate([np.full(3, settings["robot.mass"]), np.diag(settings["robot.inertia"])])
    speed = np.abs(batch.samples["twist"])
    laws = [law.aimed_at(goal) for goal in goals]
    poses = Poses(batch.samples["position"], batch.samples["quaternion"])
    start = np.array([aimed.wrench(scene.home) for aimed in laws])
    tau = np.array(batch.samples["fuzzy_output"])
    final = np.full((len(goals), 6), np.nan)
    completed = np.asarray(batch.outcome == "completed")
    for k in np.flatnonzero(completed):
        final[k] = laws[k].wrench(poses[k]) - tau[k]
    still = _CHATTER * scenario.simulation.step * kv / inertia
    if scenario.controller.traits.viscous:
        with np.errstate(divide="ignore"):
            still = np.minimum(still, _DAMPED * kv / gains_of(settings).kd)
    at_rest = np.asarray((speed <= still).all(axis=1))
    aims = Poses.joined(scene.home, moved)  # that of the first is not used
    near = np.abs(scene.leg_travel(poses) - scene.leg_travel(aims)).max(axis=1) <= scene.stroke
    slow = completed & at_rest & near
    slow[0] = False
    too_short = steps < _CHATTER / _LEAVING
    final_share = _share(final, kv)
    counted = slow & (final_share <= _BORDER) & (not too_short)  # beyond K_v a platform turns, it does not rest
    taken = np.abs(tau[counted]).max(axis=0, initial=0.0)
    widened = replace(rest, low=rest.low - taken, high=rest.high + taken)
    rows = np.vstack([rest.view.jacobian, -rest.view.jacobian])
    reached = widened.farthest(rows)
    assert reached is not None  # it holds the set that has the goal itself
    return Runs(
        fuzzy=fuzzy,
        duration=duration,
        completed=completed,
        too_short=too_short,
        slow=slow,
        counted=counted,
        start_error=np.abs(goals - home.features).max(axis=1),
        final_error=np.abs(batch.samples["feature_error"]).max(axis=1),
        start_share=_share(start, kv),
        final_share=final_share,
        fuzzy_output=tau,
        bound=float(np.abs(rest.error - reached @ rest.view.jacobian.T).max()),
    )


def _share(wrench: Array, kv: Array) -> Array:
    acts = kv > 0
    return np.abs(wrench[:, acts] / kv[acts]).max(axis=1) if acts.any() else np.full(len(wrench), np.nan)


def _displacements(rest: RestSet, ends: Extremes) -> Array:
    """Return the displacements of the goals from home, (63, 6) [m; rad]."""
    random = np.random.default_rng(0)
    vertices = ends.displacements
    held = [vertices[k % len(vertices)] * _SHARES[k % len(_SHARES)] for k in range(COUNT // 2)]
    free: list[Array] = []
    while len(free) < COUNT - 1 - len(held):
        d = random.normal(size=6) * np.repeat([1.0, 1.0 / rest.radius], 3)
        most = min(rest.stroke / np.abs(rest.leg_rates @ d).max(), float((rest.span / np.abs(d)).min()))
        free.append(d * random.uniform(0.1, 0.5) * most)
    return np.array(held + free)
