"""Targets that a law follows farther behind than the band; of the law `tracking` see `check_tracking`."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hexservo.findings.analysis.scene import Scene
from hexservo.findings.check_target import leaves_reach
from hexservo.findings.target_loop import left_of_target
from hexservo.findings.target_path import moving_keys
from hexservo.scenario.wording import number


def of_following(scene: Scene) -> Iterator[str]:
    """Yield a sentence for a target of which a law leaves more than the band in the second half of a run.

    Small motions are left larger in runs, by stiction of the switching term, and so are those that reach the
    limits of legs or drives. Of a law that no linear loop describes see `check_hold`.
    """
    keys = moving_keys(scene.scenario)
    if not keys or not scene.has_points or scene.scenario.controller.traits.output == "pose":
        return
    left = left_of_target(scene)
    if left is None or leaves_reach(scene) is not None:
        return
    late = slice(len(left.followed) // 2, None)
    followed, still = (float(np.abs(features[late]).max()) for features in (left.followed, left.still))
    if followed <= scene.band:
        return
    worse = (
        f", where a platform that stands still would have {number(still, 2)} px: the loop amplifies such a motion"
        if followed > still
        else ""
    )
    yield left_behind(scene, followed, f"by its linear loop, beside noise{worse}", faster=not worse)


def left_behind(scene: Scene, left: float, how: str, *, faster: bool) -> str:
    """Return a sentence for what a law leaves of a motion of the target [px], and what leaves less."""
    keys = moving_keys(scene.scenario)
    return (
        f"{' and '.join(keys)}: {scene.scenario.controller.law} leaves up to about {number(left, 2)} px of such "
        f"a motion of the target {how}. metrics.band is {number(scene.band)} px: "
        f"{'a law of higher bandwidth, ' if faster else ''}a shorter camera.period or latency, or a slower motion "
        "leaves less"
    )
