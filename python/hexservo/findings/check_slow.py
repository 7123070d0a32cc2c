"""Gains that pull to the goal too slowly for the run, or not at all."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hexservo.findings.analysis.scene import Scene
from hexservo.findings.home_loop import image_errors, largest_motion
from hexservo.scenario.fitted import auto_of, chosen_keys
from hexservo.scenario.laws import laws_with
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import below, number, quantity

_LEFT = 0.5  # of the image error at the start: a run that leaves more by its linear loop is too short for the gains
_ALL = 1.0 - 1e-6  # what a loop leaves in which nothing pulls: the differences that linearise it are not exact


def of_slow(scene: Scene) -> Iterator[str]:
    """Yield a sentence for gains with which the run leaves most of the image error at the start.

    By the linear loop at home (`image_errors`): the fuzzy systems may pull to the goal, or to the start, and the less
    of both with and without their adaptation counts. And for fuzzy systems whose adaptation leaves more than the band
    at its end; of gains by `auto` alone see the bandwidth (`of_gains`), and of a law whose output is a pose its own.

    Raises
    ------
    NoRestError
        The law cannot be evaluated at home.
    """
    scenario = scene.scenario
    if scenario.controller.traits.output == "pose":
        return
    if auto_of(scenario).bandwidth is not None and not chosen_keys(scenario):  # all gains are fitted
        return
    errors = image_errors(scene)
    left = float(np.min(errors))
    key = f"controller.{scenario.controller.law}"
    if left > _ALL:
        yield (
            f"{key}: nothing pulls to the goal: by the linear loop of these gains the image error at the start stays; "
            f"{_remedy(scenario, key)}"
        )
    elif left > _LEFT:
        yield (
            f"{key}: the gains are too slow for the run of {quantity(scenario.simulation.duration, 's')}: by their "
            f"linear loop {below(100.0 * left, 3)} % of the image error at the start is left at its end; "
            f"{_remedy(scenario, key)}"
        )
    else:
        yield from _of_adaptation(scene, key, errors)


def _of_adaptation(scene: Scene, key: str, errors: list[float]) -> Iterator[str]:
    """Find weights that take up what they push against too slowly for the run: without adaptation it would settle.

    An adaptation A to the pose error e and, at the rate Lambda, to its integral leaves a mode of about
    Lambda A/(K_t + A), however fast the spring is. Where the motion is beyond the range of the fuzzy inputs, weights
    take up less than the linear loop does, and nothing is judged.
    """
    if scene.scenario.controller.law not in laws_with("memory", "pose_error"):
        return
    start = np.abs(scene.desired - scene.view(scene.start).features)[scene.machine.weights > 0.0].max()
    alone, adapting = errors[0], errors[-1]
    if alone * start > scene.band or not adapting * start > scene.band:
        return
    fuzzy = scene.scenario.controller.gains.fuzzy
    scales = np.append(np.broadcast_to(fuzzy.error_scale, 6), np.broadcast_to(fuzzy.rate_scale, 6))
    if (scales * largest_motion(scene) > 1.0).any():
        return
    yield (
        f"{key}.drive: the fuzzy systems adapt too slowly for the run of "
        f"{quantity(scene.scenario.simulation.duration, 's')}: by the linear loop of these gains about "
        f"{number(float(adapting * start), 2)} px of the image error at the start are left at its end, and "
        f"metrics.band is {number(scene.band)} px; {_remedy(scene.scenario, key)}"
    )


def _remedy(scenario: Scenario, key: str) -> str:
    if auto_of(scenario).bandwidth is None:
        return f"{key}.auto.bandwidth fits gains to the machine"
    return f"null for {' and '.join(f'{key}.{name}' for name in chosen_keys(scenario))} leaves them to {key}.auto"
