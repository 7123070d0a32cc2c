"""Readings of the joints that a driver repeats, where its encoders are read more seldom than the ticks are."""

from __future__ import annotations

import numpy as np

from hexservo.findings.identification.log import FEWEST, RESOLVED, Log
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.yaml import ScenarioError

_CLEAR = 2.5  # steps of rounding: a leg that moves by more from one tick to the next was not about to stop
_OF_LEGS = 0.5  # share of the legs that do so before and after a run of equal readings, for it to be no rest


def fresh_readings(joints: Array) -> Mask:
    """Return at which ticks (n,) the joints were read: the others repeat the tick before, of all legs.

    Noise changes every reading, and equal ones are then repeated. Rounded readings, and those without noise, are equal
    at a rest as well: legs come to rest one after the other and by small steps. So readings are repeated where half of
    the legs that move at all stop at once and go on at once, by more than two steps of rounding, as by noise. In a log
    with such readings, the last ones before any leg goes on, or the log ends, may be repeated: as many as usually in a
    row. All others count.

    Parameters
    ----------
    joints
        (n, 6) as logged [m; rad].
    """
    readings = np.round(joints, RESOLVED)
    readings = readings[:, np.ptp(readings, axis=0) > 0.0]
    steps = np.abs(np.diff(readings, axis=0))
    whole = ~(steps > 0.0).any(axis=1)
    fresh = np.ones(len(joints), dtype=bool)
    runs = np.flatnonzero(np.diff(np.concatenate([[False], whole, [False]]).astype(int))).reshape(-1, 2)
    if not readings.shape[1] or not len(runs):
        return fresh
    clear = steps > _CLEAR * np.array([np.diff(np.unique(leg)).min() for leg in readings.T])  # steps of rounding
    go = np.concatenate([[False], clear.mean(axis=1) >= _OF_LEGS, [False]])
    at_once = go[runs[:, 0]] & go[runs[:, 1] + 1]  # by the changes before and after a run
    if at_once.any():
        longest = int(np.median(np.diff(runs[at_once], axis=1)))
        any_went = np.append(clear.any(axis=1), True)[runs[:, 1]]  # or the log ends, and they may
        for (first, end), whole_run in zip(runs[any_went], at_once[any_went], strict=True):
            fresh[(first if whole_run else max(first, end - longest)) + 1 : end + 1] = False
    return fresh


def require_readings(log: Log, source: str | None = None) -> None:
    """Refuse a log with few readings of the joints, however many ticks repeat them.

    Parameters
    ----------
    log
        Measured coordinates of the legs.
    source
        File of the log, for messages.

    Raises
    ------
    ScenarioError
        Fewer than 50 readings.
    """
    fresh = fresh_readings(log.joints)
    if (count := int(fresh.sum())) < FEWEST:
        raise ScenarioError(
            f"joints: expected at least {FEWEST} readings, got {count}: the other {len(fresh) - count} ticks repeat "
            "the one before, of all legs; read the encoders at every tick, or record for longer",
            source,
        )
