"""What the run of a scenario comes to, as ``hexservo check`` states it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexservo.run.metrics import is_settled, metrics, since_settling, unsettled
from hexservo.run.simulation import simulate
from hexservo.run.summary import ending

if TYPE_CHECKING:
    from hexservo.run.result import Result
    from hexservo.scenario.scenario import Scenario

_MOST_STEPS = 1_000_000
_NAMED = "hexservo diagnose names the cause"


def run_to_check(scenario: Scenario) -> Result | None:
    """Return the run of a scenario; None where it has more than a million steps, which take a second and more."""
    steps = scenario.simulation.duration / scenario.simulation.step
    return simulate(scenario) if steps <= _MOST_STEPS else None


def doubts_of_run(run: Result) -> list[str]:
    """Return a sentence for a run that ends early or does not settle, or one for each kind of limit that it exceeds.

    Limits are those of a run that settles: what else goes on with one that does not, is for `diagnose`.
    """
    if run.outcome != "completed":
        return [f"simulation: the run ends early ({run.outcome.replace('_', ' ')}): {ending(run)}; {_NAMED}"]
    if not _settled(run):
        return [f"simulation: the run does not settle: {unsettled(metrics(run), run.scenario.metrics)}; {_NAMED}"]
    found = []
    for kind in dict.fromkeys(event.kind for event in run.events):
        first, *others = [event for event in run.events if event.kind == kind]
        more = f", and {len(others)} other{'s' if len(others) > 1 else ''} do so too" if others else ""
        found.append(f"simulation: in the run {first}{more}")
    return found


def settled_words(run: Result) -> str:
    """Return from when on a run is within the band, as "within 2 px after 0.353 s"; empty where it does not settle."""
    if not _settled(run):
        return ""
    measured = run.scenario.metrics
    return f"within {measured.band:g} px {since_settling(metrics(run), measured)}"


def _settled(run: Result) -> bool:
    return bool(is_settled(run.outcome, metrics(run)["settling_time"]))
