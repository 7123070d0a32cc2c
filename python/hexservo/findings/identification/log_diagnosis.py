"""Diagnosis of a log: what the log itself shows of the goal, and the run of the identified model."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

from hexservo.findings.diagnosis.findings import Diagnosis
from hexservo.findings.display import Findings
from hexservo.findings.evidence import Section, Verdict
from hexservo.findings.identification import Identification
from hexservo.findings.identification.frames_words import doubts
from hexservo.findings.identification.log_end import LogEnd
from hexservo.scenario.wording import number


@dataclass(frozen=True, eq=False, repr=False)
class LogDiagnosis(Findings):
    """The diagnosis of a run of the identified model, beside the log that the model is of."""

    identification: Identification
    model: Diagnosis  # of a run of `Identification.as_logged`

    @property
    def failed(self) -> bool | None:
        """Whether the identified model fails; None where it passes and is not of the machine: that decides nothing."""
        return None if self.identification.doubtful and not self.model.failed else self.model.failed

    @property
    def lacks_a_fault(self) -> bool:
        """Whether the machine rests off its goal and the identified model passes."""
        end = self.identification.end
        return self.model.failed is False and isinstance(end, LogEnd) and end.rests and not end.settled

    def sections(self) -> tuple[Section, ...]:
        """Return the only section: what the log shows, what is doubtful of the model, and its diagnosis."""
        return (_section(self),)

    def to_dict(self) -> dict[str, Any]:
        """Return verdict, sentences, and the numbers of the model's run and of the log, for strict JSON."""
        return _section(self).to_dict()

    def numbers(self) -> dict[str, Any]:
        """Return the numbers of the model's run, and of the log."""
        end = self.identification.end
        ends = {**asdict(end), "settled": end.settled} if isinstance(end, LogEnd) else None
        doubtful = [{"name": part.name, "sentences": list(part.sentences)} for part in self.identification.doubtful]
        of_log = {"log": ends, "faults": self.identification.faults, "doubtful": doubtful}
        return {**self.model.numbers(), "failed": self.failed, **of_log}


def _section(found: LogDiagnosis) -> Section:
    """Return what the log shows, what is doubtful of the model, and the diagnosis of the model's run."""
    of_model = found.model.section()
    doubtful = found.identification.doubtful
    sentences = list(of_model.sentences)
    if of_model.verdict == "good":
        sentences = [f"The identified model passes: {'; '.join(found.model.criteria)}."]
    elif sentences:
        sentences[0] = f"Of a run of the identified model: {sentences[0]}"
    words = [_of_log(found)]
    if doubtful:
        titles = " and ".join(f'"{part.title}"' for part in doubtful)
        words.append(f"The model is not that of this machine (see {titles}), and its run decides nothing about it.")
    elif found.identification.camera is not None:
        words += doubts(found.identification.camera)
    if faults := found.identification.faults:
        keys = ", ".join(f"{key}={value:g}" for key, value in faults.items())
        words.append(f"The run of the identified model has that error: {keys}.")
    return replace(
        of_model, sentences=[*words, *sentences], verdict=_verdict(found, of_model.verdict), data=found.numbers()
    )


def _verdict(found: LogDiagnosis, of_model: Verdict) -> Verdict:
    end = found.identification.end
    if of_model not in ("good", "warning"):
        return of_model
    if found.identification.doubtful:
        return "open"
    if found.lacks_a_fault:
        return "warning"
    return of_model if isinstance(end, LogEnd) and end.settled else "open"


def _of_log(found: LogDiagnosis) -> str:
    end, passes = found.identification.end, found.model.failed is False
    if isinstance(end, str):
        return f"{end}: it does not tell whether the machine reaches its goal."
    median = f"{number(end.error)} px from the goal, in the median of its last images"
    band = f"the band of {number(end.band)} px"
    fault = "the machine has a fault that the model lacks"
    if end.settled:
        noise = f" and the {number(end.noise_error)} px that noise may add" if end.error > end.band else ""
        return f"The log settles: it is {median}, within {band}{noise}."
    if not end.rests:
        more = f", and as the model passes, {fault}" if passes else ""
        beyond = f"outside {band}" if end.error > end.band + end.noise_error else f"and swings by more than {band}"
        return (
            f"The log ends in motion, {median}, {beyond}. One of jumps, for identification, is not expected "
            f"to settle; if it is of the loop with this goal, the loop does not settle{more}."
        )
    more = f" The identified model does: {fault}, unless the log is of another goal or of no loop." if passes else ""
    return f"The log does not settle: it rests {median}, outside {band}.{more}"
