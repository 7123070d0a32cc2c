"""The summary of a run in sentences."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hexservo.run.goal_distance import goal_distance
from hexservo.run.leg_limits import leg_limits
from hexservo.run.leg_motion import singular_passage
from hexservo.run.metrics import left_and_band, metrics, shown_number, since_settling, stayed_within, unsettled
from hexservo.run.unseen_points import edge_on_sentence, unseen_sentence
from hexservo.scenario.pixels import points_outside
from hexservo.scenario.wording import apart, number, percent_above, percent_below, quantity

if TYPE_CHECKING:
    from hexservo.run.result import Result


_HIDDEN = 0.1  # share of what shift or rotation moves the image by, below which the two nearly cancel in it
_MISFIT = 0.01  # [px], from which a pose has not the goal image but one that is near


def summary_sentences(result: Result) -> list[str]:
    """Return how a run ended, whether it settled, its remaining error, and how near the legs came to their limits.

    Where the law has not acted, the second sentence has the reason.
    """
    unseen = without_image(result)
    return [
        _outcome(result),
        *([] if unseen is None else [unseen]),
        *image_sentences(result),
        _settling(result),
        _residual(result),
        *([] if (far := goal_distance_sentence(result)) is None else [far]),
        *_legs(result),
    ]


def image_sentences(result: Result) -> list[str]:
    """Return which points leave the image, unless the law never acts for want of one, and where they are edge-on."""
    outside = unseen_sentence(result) if without_image(result) is None else None
    return [sentence for sentence in (outside, edge_on_sentence(result)) if sentence is not None]


def _outcome(result: Result) -> str:
    law = f"the law {result.controller}" if result.by_law else f"the function {result.controller}"
    if result.outcome == "completed":
        return (
            f"The run completed: {result.end_time:.4g} s in {result.scenario.simulation.mode} mode, "
            f"controlled by {law}."
        )
    return (
        f"The run of {result.scenario.simulation.duration:.4g} s ended early ({result.outcome.replace('_', ' ')}): "
        f"{ending(result)}. It was controlled by {law}."
    )


def ending(result: Result) -> str:
    """Return how a run ended, and when (`Result.stop_time`); of a leg that ended it also its value and its limit."""
    event = result.stop_event
    return result.detail if event is None else f"{result.detail} ({' of '.join(event.shown)})"


def without_image(result: Result) -> str | None:
    """Return why the law has not acted in a run: no frame came, or one of the points is in none; else None.

    The reasons are those that scenario and samples show; a point that noise moves across the border counts by its true
    place.
    """
    scenario, camera = result.scenario, result.scenario.camera
    if not scenario.sampled or not result.by_law:
        return None
    if camera.dropout == 1.0:
        why = "every frame was lost (camera.dropout: 1)"
    elif camera.latency >= result.end_time:
        why = f"no frame arrived in {quantity(result.stop_time, 's')} (camera.latency: {quantity(camera.latency, 's')})"
    else:
        never = np.flatnonzero(points_outside(scenario, result.features).all(axis=0)) + 1
        if not len(never):
            return None
        points = f"point{'s' if len(never) > 1 else ''} {', '.join(map(str, never))}"
        why = f"{points} {'are' if len(never) > 1 else 'is'} outside of the camera's image at every sample"
    return f"The law did not act: {why}. Until each point has been seen once, the safe output holds the platform."


def _settling(result: Result) -> str:
    values, measured = metrics(result), result.scenario.metrics
    settled = values["settling_time"]
    if settled != settled:
        return f"The features did not settle: {unsettled(values, measured)}."
    if result.outcome != "completed":
        return f"Until then the features had been within {measured.band:g} px {since_settling(values, measured)}."
    if stayed_within(settled, values["peak_error"], measured.band):
        return f"All features stayed within {measured.band:g} px from the start."
    return f"All features are within {measured.band:g} px of their goals {since_settling(values, measured)}."


def _residual(result: Result) -> str:
    values = metrics(result)
    left, _ = left_and_band(values, result.scenario.metrics)
    text = f"The largest feature error at the end is {left} px"
    rms = values["rms_error"]
    if rms == rms:
        text += f"; from {result.scenario.metrics.rms_start:g} s on their RMS is {shown_number(rms, 'px')} px"
    return text.replace("<", "less than ") + "."


def goal_distance_sentence(result: Result, *, if_hidden: bool = False) -> str | None:
    """Return `goal_distance` as a sentence; None where it has no meaning.

    Parameters
    ----------
    result
        The run.
    if_hidden
        Only where the shift or the rotation alone takes the image out of `metrics.band`, and the image error is less
        than a tenth of what it moves it by.
    """
    found = goal_distance(result)
    if found is None:
        return None
    hidden = metrics(result)["final_error"] < _HIDDEN * found.motion
    if if_hidden and not (hidden and found.motion > result.scenario.metrics.band):
        return None
    ways = ((found.shift, "m"), (found.angle, "rad"))
    shift, angle = (f"less than 1 n{unit}" if value < 1e-9 else quantity(value, unit) for value, unit in ways)
    pose = "the pose with the goal image"
    if found.misfit > _MISFIT:
        pose = f"the pose whose image is nearest to the goal's, {number(found.misfit, 2)} px off"
    words = f"At the end the platform is {shift} and {angle} from {pose}"
    return f"{words}; in the image the two nearly cancel." if hidden else f"{words}."


def _legs(result: Result) -> list[str]:
    """Compare the peaks of the legs with what is allowed."""
    values, stop = metrics(result), result.stop_event
    sentences = []
    for limit in leg_limits(result.scenario):
        if stop is not None and stop.kind == limit.kind:  # how the run ended has the value; metrics are of before
            continue
        unit, scale = limit.shown_unit
        found, allowed = apart(values[limit.metric] * scale, limit.value * scale)
        share = values[limit.metric] / limit.value
        if share <= 1:
            verdict = f"{percent_below(1 - share)} of it is left"
        elif share < 3:
            verdict = f"that is {percent_above(share - 1)} too much"
        else:
            verdict = f"that is {number(share)} times as much"
        sentences.append(f"The largest {limit.of_leg} is {found} {unit} of the {allowed} {unit} allowed; {verdict}.")
    passage = singular_passage_sentence(result)
    return sentences if passage is None else [*sentences, passage]


def singular_passage_sentence(result: Result) -> str | None:
    """Return `singular_passage` as a sentence; None: the legs pass none."""
    time = singular_passage(result)
    if time is None:
        return None
    return f"By t = {time:.4g} s the legs have passed a singular pose: no machine moves as the run does from there on."
