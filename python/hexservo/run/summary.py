"""The summary of a run in sentences."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexservo.run.leg_limits import leg_limits
from hexservo.run.leg_motion import singular_passage_sentence
from hexservo.run.metrics import metrics, readable, unsettled
from hexservo.scenario.wording import number

if TYPE_CHECKING:
    from hexservo.run.result import Result

__all__ = ["summary_sentences"]


def summary_sentences(result: Result) -> list[str]:
    """Return how a run ended, whether it settled, its remaining error, and how near the legs came to their limits."""
    return [_outcome(result), _settling(result), _residual(result), *_legs(result)]


def _outcome(result: Result) -> str:
    law = f"the law {result.controller}" if result.by_law else f"the function {result.controller}"
    if result.outcome == "completed":
        return (
            f"The run completed: {result.end_time:.4g} s in {result.scenario.simulation.mode} mode, "
            f"controlled by {law}."
        )
    # the detail has the time of the event, a step after the last good sample
    return (
        f"The run of {result.scenario.simulation.duration:.4g} s ended early ({result.outcome.replace('_', ' ')}): "
        f"{result.detail}. It was controlled by {law}."
    )


def _settling(result: Result) -> str:
    values, measured = metrics(result), result.scenario.metrics
    settled = values["settling_time"]
    if settled != settled:
        return f"The features did not settle: {unsettled(values, measured)}."
    if result.outcome != "completed":
        return f"Until then the features had been within {measured.band:g} px since {settled:.4g} s."
    if settled == 0:
        return f"All features stayed within {measured.band:g} px from the start."
    return f"All features are within {measured.band:g} px of their goals from {settled:.4g} s on."


def _residual(result: Result) -> str:
    values = metrics(result)
    text = f"The largest feature error at the end is {number(values['final_error'])} px"
    rms = values["rms_error"]
    start = result.scenario.metrics.rms_start
    return text + (f"; from {start:g} s on their RMS is {number(rms)} px." if rms == rms else ".")


def _legs(result: Result) -> list[str]:
    """Compare the peaks of the legs with what is allowed."""
    values = metrics(result)
    sentences = []
    for limit in leg_limits(result.scenario):
        found, shown = readable(limit.metric, values[limit.metric], result.scenario.robot)
        share = values[limit.metric] / limit.value
        if share <= 1:
            verdict = f"{1 - share:.0%} of it is left"
        else:
            verdict = f"that is {share - 1:.0%} too much" if share < 3 else f"that is {number(share)} times as much"
        sentences.append(f"The largest {limit.of_leg} is {found} {shown} of the {limit.text} allowed; {verdict}.")
    passage = singular_passage_sentence(result)
    return sentences if passage is None else [*sentences, passage]
