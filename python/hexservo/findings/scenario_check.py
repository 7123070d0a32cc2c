"""The check of a scenario: doubtful settings, what has no effect, and what its run comes to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hexservo.findings.check import notes, unlikely
from hexservo.findings.evidence import as_data
from hexservo.findings.other_seeds import NAMED, OtherSeeds, with_other_seeds
from hexservo.run.display import lines_below
from hexservo.run.metrics import metrics, run_settles, since_settling, unsettled
from hexservo.run.simulation import simulate, uninterrupted
from hexservo.run.summary import ending
from hexservo.scenario.fields import described
from hexservo.scenario.scenario import require_scenario

if TYPE_CHECKING:
    from hexservo.run.result import Result
    from hexservo.scenario.scenario import Scenario

__all__ = ["Check", "check"]

_MOST_STEPS = 200_000  # of a run that is looked at


@described
@dataclass(frozen=True, eq=False, repr=False)
class Check:
    """What is doubtful in a valid scenario. Sentences begin with the key that they are about."""

    scenario: Scenario  # that was checked
    warnings: tuple[str, ...]  # legal but probably unintended settings, and what the run does not reach
    notes: tuple[str, ...]  # keys without effect, what a prior leaves of the pose, an unstable brake
    run: Result | None  # of the scenario as written; None: it has more than 200 000 steps
    others: OtherSeeds | None  # runs with other seeds; None: nothing is random, or there is no run

    @property
    def settled(self) -> str:
        """From when on the run is within the band, as "within 2 px after 0.353 s"; empty where it does not settle.

        Where it has noise, also how soon and how surely runs with other seeds are: unless one of them does not settle,
        of which a warning states how many do not.
        """
        if self.run is None or not run_settles(self.run):
            return ""
        measured = self.scenario.metrics
        own = f"within {measured.band:g} px {since_settling(metrics(self.run), measured)}"
        return ", ".join([own, *([self.others.words] if self.others is not None and self.others.words else [])])

    @property
    def unrun(self) -> str:
        """Why the scenario was not run; empty where it was."""
        return "it was not run, since it has more than 200 000 steps" if self.run is None else ""

    def to_dict(self) -> dict[str, Any]:
        """Return warnings, notes, and outcome and metrics of the run (null where it was left out) for strict JSON.

        Of the runs with other seeds these are seeds, outcomes and settling times.
        """
        run = self.run
        of_run = None if run is None else {"outcome": run.outcome, "stop_time": run.stop_time, "metrics": metrics(run)}
        found: dict[str, Any] = as_data(
            {"scenario": self.scenario.name, "warnings": self.warnings, "notes": self.notes, "run": of_run}
            | {"other_seeds": None if self.others is None else self.others.to_dict()}
        )
        return found

    def __repr__(self) -> str:
        """Return a line for each warning and note, and one for a run that settles."""
        lines = [f"Warning: {words}" for words in self.warnings] + [f"Note: {words}" for words in self.notes]
        lines += [f"The run is {self.settled}."] if self.settled else []
        lines += [f"{self.unrun.capitalize()}."] if self.unrun else []
        return lines_below(f'Check of "{self.scenario.name}"', lines or ["No warnings."], 5)


def check(scenario: Scenario) -> Check:
    """Check a scenario for settings that are legal and probably not meant; run it, and others near its goal.

    A scenario with noise is run with other seeds too.

    Parameters
    ----------
    scenario
        It is valid, or there were none: `load_scenario` lists what is not.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C, also while something runs.
    TypeError
        For anything but a `Scenario`.
    ValueError
        For a scenario that cannot run, as with a start beyond the legs that end a run.
    """
    require_scenario(scenario)
    steps = scenario.simulation.duration / scenario.simulation.step
    run = uninterrupted(simulate(scenario)) if steps <= _MOST_STEPS else None
    others = None if run is None else with_other_seeds(scenario)
    warnings = [*unlikely(scenario), *([] if run is None else _doubts_of(run, others))]
    return Check(scenario, tuple(warnings), tuple(notes(scenario)), run, others)


def _doubts_of(run: Result, others: OtherSeeds | None) -> list[str]:
    """Return a sentence for a run that ends early or does not settle, or one for each kind of limit that it exceeds.

    Limits are those of a run that settles: what else goes on with one that does not, is for `diagnose`. Of one that
    settles, the runs with other seeds have their sentences too.
    """
    chance = "" if others is None else others.settle_instead
    if run.outcome != "completed":
        return [f"simulation: the run ends early ({run.outcome.replace('_', ' ')}): {ending(run)}{chance}; {NAMED}"]
    if not run_settles(run):
        return [
            f"simulation: the run does not settle: {unsettled(metrics(run), run.scenario.metrics)}{chance}; {NAMED}"
        ]
    found = []
    for kind in dict.fromkeys(event.kind for event in run.events):
        first, *later = [event for event in run.events if event.kind == kind]
        more = f", and {len(later)} other{'s' if len(later) > 1 else ''} do so too" if later else ""
        found.append(f"simulation: in the run {first}{more}")
    return found + ([] if others is None else list(others.doubts({event.kind for event in run.events})))
