"""Gains that pull to the goal too slowly for the run, or not at all."""

from __future__ import annotations

from collections.abc import Iterator

from hexservo.findings.analysis.scene import Scene
from hexservo.findings.home_loop import least_image_error
from hexservo.scenario.fitted import auto_of, chosen_keys
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import below, quantity

_LEFT = 0.5  # of the image error at the start: a run that leaves more by its linear loop is too short for the gains
_ALL = 1.0 - 1e-6  # what a loop leaves in which nothing pulls: the differences that linearise it are not exact


def of_slow(scene: Scene) -> Iterator[str]:
    """Yield a sentence for gains with which the run leaves most of the image error at the start.

    By the linear loop at home (`least_image_error`); of gains by `auto` alone see the bandwidth (`of_gains`), and of a
    law whose output is a pose its own.

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
    left = least_image_error(scene)
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


def _remedy(scenario: Scenario, key: str) -> str:
    if auto_of(scenario).bandwidth is None:
        return f"{key}.auto.bandwidth fits gains to the machine"
    return f"null for {' and '.join(f'{key}.{name}' for name in chosen_keys(scenario))} leaves them to {key}.auto"
