"""What a law that estimates a pose remembers of a run, and its rebuilt steps do not (docs/certificate/energy.md)."""

from __future__ import annotations

import numpy as np

from hexservo.findings.certificate.replay import Replay
from hexservo.scenario.arrays import Array
from hexservo.scenario.laws import laws_with

_FIT = 1e-4  # of the depth, or rad: the first fit of a pose without a memory ends at a step below it
_BETWEEN = 2.0  # times the largest difference at the samples, in the stages between them


def remembers(run: Replay) -> bool:
    """Return whether the law acts inside the steps and starts its search for a pose where the one before ended."""
    law = run.scenario.controller.law
    return not run.own and run.continuous and law in laws_with("points", "prior")


def forgotten(run: Replay) -> Array:
    """Return by how much the law's wrench in a rebuilt step may differ from that of the run, (n - 1, 6) [N; N m].

    A pose is found in two fits, the first of which measures the noise and so the prior's share. The search of a run
    starts where the one before ended; a rebuilt step has no such memory, and its first fit ends where a step is below
    `_FIT`. The difference is `_BETWEEN` times the largest one of the samples' wrenches from those of the law without a
    memory, but of poses at most `_FIT` apart: what is larger has another reason. Zero where no law `remembers`, and
    without a prior, where the fit is the same from everywhere.
    """
    count, scenario = len(run.time), run.scenario
    if not remembers(run) or not np.any(scenario.controller.gains.prior):
        return np.zeros((count - 1, 6))
    depth = run.probe.measured_depth(run.depth)
    law = run.probe.law(run.features, depth, run.position, run.quaternion, run.twist, None)
    difference = np.nan_to_num(np.abs(run.wrench - law.wrench)).max(axis=0)
    unit = np.ones((count - 1, 6))
    unit[:, :3] = np.abs(run.depth[1:]).mean(axis=1)[:, None]
    most = _FIT * np.broadcast_to(scenario.controller.gains.kp, 6) * unit
    return np.asarray(_BETWEEN * np.minimum(difference, most))
