"""Legs that take positions: limits and motors that are legal and probably unintended."""

from __future__ import annotations

from collections.abc import Iterator

from hexservo.findings.analysis.scene import Scene
from hexservo.findings.check_sag import of_sag
from hexservo.findings.check_way import of_way
from hexservo.scenario.wording import quantity


def of_positions(scene: Scene) -> Iterator[str]:
    """Yield a sentence for each problem of a scenario whose legs take positions; nothing for others."""
    scenario = scene.scenario
    if scenario.sampled and scenario.actuators.kind != "force":
        yield from _of_speed(scene)
        yield from of_way(scene)
        yield from of_sag(scene)


def _of_speed(scene: Scene) -> Iterator[str]:
    """Find a limit of the leg speed that is reported alone, below the one that legs and commands keep to."""
    scenario, rate = scene.scenario, scene.units.rate
    limit, kept = scenario.robot.speed_limit, scenario.actuators.position.speed_limit
    acts = scenario.actuators.kind == "position" or scenario.controller.traits.output == "pose"
    if not acts or limit is None or (kept is not None and kept <= limit):
        return
    more = (
        "is null, so that nothing keeps them below it" if kept is None else f"lets them go up to {quantity(kept, rate)}"
    )
    yield (
        f"robot.speed_limit: {quantity(limit, rate)} is the speed of a leg from which a run is reported or ended, but "
        f"actuators.position.speed_limit, to which legs that take positions keep, {more}; set both to "
        f"{quantity(limit, rate)}"
    )
