"""Certificate of a run: the theorem's assumptions along it, and its energy balance."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.certificate.batch import BatchCertificate, certify_batch
from hexservo.findings.certificate.energy import EnergyLedger, energy_ledger
from hexservo.findings.certificate.lyapunov import Lyapunov, lyapunov_of
from hexservo.findings.certificate.replay import Plant, Replay, replay
from hexservo.findings.certificate.uncertainty import Assumption, assumption_of, uncertainty_of
from hexservo.findings.display import Findings
from hexservo.findings.evidence import Section, as_data
from hexservo.run.result import Result
from hexservo.scenario.fields import described
from hexservo.scenario.laws import THEOREM_LAW
from hexservo.scenario.scenario import Scenario

__all__ = ["BatchCertificate", "Certificate", "certify", "certify_batch"]

_TITLES = {
    "lyapunov": "Lyapunov function along the run",
    "assumption": "Assumption of the stability theorem",
    "energy": "Energy ledger",
}


@described
@dataclass(frozen=True, eq=False, repr=False)
class Certificate(Findings):
    """Certificate of a finished run: a numerical check of one trajectory at its samples, not a proof."""

    scenario: Scenario  # of the run
    lyapunov: Lyapunov | None  # the function and its rate; None where `open_questions` has the reason
    assumption: Assumption | None  # k_v >= eta_Delta; likewise
    energy: EnergyLedger | None  # work of controller and errors; likewise
    # of the result from the run that was certified, by quantity, infinite of what is no number; empty: bit for bit
    differences: dict[str, float]
    only_rounding: bool  # whether all of them are within rounding
    remark: str  # the same in a sentence
    open_questions: dict[str, str] = field(default_factory=dict)  # section -> why it has no numbers

    def sections(self) -> tuple[Section, ...]:
        """Return the sections "lyapunov", "assumption" and "energy".

        None has the verdict good where the certified run differs from the result by more than rounding.
        """
        found = []
        for name, title in _TITLES.items():
            part, reason = getattr(self, name), self.open_questions.get(name, "")
            section = Section(name, title, [reason], data={"open": reason}) if part is None else part.section()
            if section.verdict == "good" and not self.only_rounding:
                sentences = [sentence for sentence in section.sentences if sentence != self.remark]
                section = replace(section, verdict="warning", sentences=[*sentences, self.remark])
            found.append(section)
        return tuple(found)

    def to_dict(self) -> dict[str, Any]:
        """Return verdicts, sentences and all numbers for strict JSON, by section, in SI units and pixels."""
        return {"differences": as_data(dict(self.differences))} | {
            section.name: section.to_dict() for section in self.sections()
        }


def certify(result: Result) -> Certificate:
    """Certify a run: Lyapunov function, assumption of the theorem, energy ledger (docs/certificate/).

    The scenario runs again with every step logged, and all that the result has is compared with it: its times, samples
    and weights, and how it ended.

    Lyapunov function and assumption are the theorem's, for the law `hybrid` in continuous mode; other runs have the
    energy ledger alone, and their sections give the reason.

    Parameters
    ----------
    result
        Of `simulate`, whatever its outcome: it is certified up to its last good sample.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C, also while the scenario runs.
    TypeError
        For anything but a `Result`.
    ValueError
        For a result without samples; for one of a custom controller without every step
        (``simulation.log_every`` above 1, or samples that were taken out); for
        a run too long for a log of every step with its weights (2 GiB).
    """
    run = replay(result)
    open_questions: dict[str, str] = {}
    assumption: Assumption | None = None
    lyapunov: Lyapunov | None = None
    if reason := _outside_theorem(run):
        open_questions |= {"lyapunov": reason, "assumption": reason}
    else:
        try:
            plant = Plant.of(run)
            uncertainty = uncertainty_of(run, plant)
            assumption = assumption_of(run, uncertainty)
            lyapunov = lyapunov_of(run, uncertainty, assumption)
        except ArithmeticError as error:
            open_questions |= dict.fromkeys(
                ("lyapunov", "assumption"), f"The uncertainty could not be computed: {error}."
            )
    energy: EnergyLedger | None = None
    if reason := _not_certified(run):
        open_questions["energy"] = reason
    elif len(run.time) < 2:
        open_questions["energy"] = "The run ended at its first sample: there is nothing to add up."
    else:
        try:
            energy = energy_ledger(run, Plant.of(run))
        except ArithmeticError as error:
            open_questions["energy"] = f"The energy balance could not be computed: {error}."
    return Certificate(
        scenario=result.scenario,
        lyapunov=lyapunov,
        assumption=assumption,
        energy=energy,
        differences=dict(run.differences),
        only_rounding=run.only_rounding,
        remark=run.remark,
        open_questions=open_questions,
    )


def _not_certified(run: Replay) -> str:
    """Return why the terms of the dynamics are not those that are certified; empty if they are."""
    if run.scenario.actuators.takes_positions:
        return (
            "Not certified: the legs of this machine follow positions (actuators.kind). "
            "The law commands where they go; no wrench of it does work on the platform."
        )
    scene = scene_of(run.scenario)
    reason = scene.unusual_body or scene.moving_target
    return f"Not certified: {reason[0].lower()}{reason[1:]}" if reason else ""


def _outside_theorem(run: Replay) -> str:
    """Return why the theorem does not apply to a run; empty if it does."""
    if run.own:
        return f"Does not apply: the controller is a custom function, and the theorem is about the law {THEOREM_LAW}."
    law = run.scenario.controller.law
    if law != THEOREM_LAW:
        return f"Does not apply: the theorem is of the law {THEOREM_LAW}, and this run's is {law}."
    if not run.continuous:
        ledger = "; what sampling and delay put into the platform is in the energy ledger"
        return (
            "Does not apply: the theorem is of continuous time, and this run is sampled"
            f"{'' if _not_certified(run) else ledger}."
        )
    if len(run.time) < 2:
        return "The run ended at its first sample."
    return _not_certified(run)
