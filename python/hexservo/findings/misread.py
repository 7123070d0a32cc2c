"""Goal images whose numbers probably mean another image: an order of the points, or how pixels count."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.reach import reach_of_start_and_goal
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.target_path import moving_keys
from hexservo.scenario.goal_readings import Reading, best_readings
from hexservo.scenario.pixels import points_outside

# Rotation of a goal from home [rad]: more is seldom asked for, and another order of points rotates it by more.
_TURNED = np.deg2rad(30.0)


@lru_cache(maxsize=8)  # several sentences of a check ask
def readings_of_goal(scene: Scene) -> tuple[Reading, ...]:
    """Return the readings that give a goal image a pose within reach, where as it stands it has none.

    None for a target in motion, and for a goal that is nearly in the attitude of home and in the image: it is
    beyond the stroke, and read rightly.
    """
    goals = None if moving_keys(scene.scenario) else find_goals(scene)
    if goals is None:
        return ()
    reach = reach_of_start_and_goal(scene.scenario)
    if goals.reachable and reach.goal_within is not False:
        return ()
    turned = float(np.linalg.norm(goals.best.displacement[3:]))
    if goals.reachable and turned < _TURNED and not points_outside(scene.scenario, scene.desired).any():
        return ()
    return tuple(best_readings(scene.scenario))
