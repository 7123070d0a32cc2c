"""Diagnosis of a failed run: each suspected cause is removed from the scenario, one at a time, and the run repeated."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hexservo.findings.diagnosis.causes import CAUSES
from hexservo.findings.diagnosis.criterion import Judgement, Record
from hexservo.findings.diagnosis.environment import faultless
from hexservo.findings.diagnosis.evidence import OF_THE_SCENARIO, Signature, signature_of
from hexservo.findings.diagnosis.findings import Diagnosis, Finding, Remedy
from hexservo.findings.diagnosis.gains import by_bandwidth
from hexservo.findings.diagnosis.growth import growth_time
from hexservo.findings.diagnosis.model import Case, Removal
from hexservo.findings.diagnosis.ranking import Trial, judged, make_cases, pairs, rank, study
from hexservo.findings.diagnosis.runs import Run, record_of, run_all
from hexservo.findings.diagnosis.words import criteria_met, how, misses, warnings_of
from hexservo.run.result import Result, require_run

__all__ = ["Diagnosis", "Finding", "Remedy", "diagnose"]

_LIKELY = 0.3  # score from which on a cause gets a remedy
_REMEDIES = 3  # causes that get one, at most
_OTHERWISE = 0.3  # difference in severity between a run and the same run repeated


def diagnose(result: Result) -> Diagnosis:
    """Find the cause of a failed run, with evidence and remedies, if one explains it (docs/diagnosis/).

    A run fails that does not complete, that is not settled (the metric ``settling_time``, with the scenario's
    ``metrics.band`` and ``metrics.dwell``), whose legs leave their stroke, or whose legs still drift. First it is asked
    whether the legs can reach the goal at all. For each cause that the scenario may have, the scenario is then run
    again without it, and each cause whose removal cures the run is put alone into a scenario without other faults: it
    is named if it fails there too. Nothing is proved. Takes about fifty runs.

    Parameters
    ----------
    result
        Of `simulate`. A run with a custom controller is judged from its recorded signals alone.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C, also while something runs.
    TypeError
        For anything but a `Result`.
    ValueError
        Where the data are not those of a run (see `Result.save`).
    """
    require_run(result)
    if result.outcome == "interrupted":
        return Diagnosis(result, None, ())
    record = record_of(result)
    before = judged(result.scenario, record)
    warnings = warnings_of(result, before)
    if not before.failed:
        criteria = criteria_met(result, record, before)
        return Diagnosis(result, False, criteria, warnings=warnings, record=record, judgement=before)
    case = make_cases([result.scenario])[0]
    failed = Diagnosis(
        result,
        True,
        misses(result, record, before),
        warnings=warnings,
        obstacle=case.obstacle,
        record=record,
        judgement=before,
    )
    if not result.by_law:
        findings, absent = _by_looks(case, record, before)
        return replace(failed, causes=findings, absent=absent)
    one = study([case], [before])[0]
    trials = rank(one)
    repeated = run_all([Run(case.scenario)])[0]
    if repeated is not None and abs(judged(case.scenario, repeated).severity - before.severity) > _OTHERWISE:
        warnings += ("Repeated, the run ends otherwise: rounding decides, and the numbers may be off.",)
    remedies = _remedies(case, trials)
    findings = tuple(
        _finding(case, trial, signature_of(trial.cause.key, case, record, before), remedies.get(trial.cause.key))
        for trial in trials
    )
    present = {finding.cause for finding in findings}
    together = () if case.obstacle is not None else pairs(one, trials)
    explained = case.obstacle is not None or bool(together) or any(trial.named for trial in trials)
    return replace(
        failed,
        causes=findings,
        together=together,
        controls=one.controls,
        warnings=warnings,
        absent=tuple(cause.title for cause in CAUSES if cause.key not in present),
        cured=trials[0].record if trials and trials[0].named else None,
        faultless=None if explained else _passes_without_faults(case),
    )


# ---- Parts of it ----------------------------------------------------------------------------------------------------


def _passes_without_faults(case: Case) -> bool | None:
    """Return whether a case passes with devices without faults and ordinary settings of the law; None: refused."""
    changes = faultless(case.scenario)
    record = run_all([Run(case.scenario, changes)])[0]
    return None if record is None else not judged(case.scenario, record, Removal("", changes)).failed


def _remedies(case: Case, trials: list[Trial]) -> dict[str, Remedy]:
    """Run the remedies against the most likely causes, and keep for each the first that works, or the best."""
    likely = [trial for trial in trials if trial.named or trial.score >= _LIKELY][:_REMEDIES]
    offered = [
        (trial, remedy) for trial in likely for remedy in trial.cause.remedies(case, trial.removal, trial.record)
    ]
    new = [remedy for trial, remedy in offered if remedy is not trial.removal]
    found = iter(run_all([Run(case.scenario, remedy.changes) for remedy in new]))
    best: dict[str, tuple[float, Remedy]] = {}
    for trial, remedy in offered:
        record = trial.record if remedy is trial.removal else next(found)
        if record is None:
            continue
        after = judged(case.scenario, record, remedy)
        severity = after.severity if after.failed else 0.0
        key = trial.cause.key
        if key not in best or severity < best[key][0]:
            best[key] = (severity, _as_remedy(case, remedy, record, after))
    return {key: remedy for key, (_, remedy) in best.items()}


def _as_remedy(case: Case, removal: Removal, record: Record, after: Judgement) -> Remedy:
    band = float(removal.changes.get("metrics.band", case.scenario.metrics.band))
    drifts = not after.failed and np.ptp(case.scenario.uncertainty.depth) > 0.0
    return Remedy(
        removal.words,
        by_bandwidth(case.scenario, removal.changes),
        not after.failed,
        record.outcome,
        after.error * band,
        record.metrics["peak_leg_excursion"],
        record.drift,
        record.metrics["settling_time"] if record.settled else math.nan,
        growth_time(case.scenario.updated(removal.changes)) if drifts else math.nan,
    )


def _finding(case: Case, trial: Trial, signature: Signature, remedy: Remedy | None) -> Finding:
    without = _as_remedy(case, trial.removal, trial.record, trial.judgement)
    outcome = how(without, case.scenario)
    evidence = [f"With {without.words} the run {outcome}; {trial.cure:.0%} of the failure is gone."]
    if trial.alone:
        evidence.append("Alone, in a scenario without other faults, it also makes the run fail.")
    if signature.sentence:
        evidence.append(signature.sentence)
    return Finding(
        trial.cause.key,
        trial.cause.title,
        trial.named,
        trial.score,
        trial.cure,
        trial.alone,
        signature.strength,
        tuple(evidence),
        without,
        remedy,
    )


def _by_looks(case: Case, record: Record, before: Judgement) -> tuple[tuple[Finding, ...], tuple[str, ...]]:
    """Diagnose from the recorded signals alone: a custom controller may have a state, so it is not run again."""
    findings, absent = [], []
    for cause in CAUSES:
        signature = signature_of(cause.key, case, record, before)
        of_the_law = cause.kind == "law" or cause.key in ("wrong_sign", "false_equilibrium")
        if of_the_law or cause.key in OF_THE_SCENARIO or not cause.removals(case) or signature.strength is None:
            absent.append(cause.title)
            continue
        evidence = (signature.sentence,) if signature.sentence else ()
        strength = signature.strength
        findings.append(Finding(cause.key, cause.title, False, strength, None, None, strength, evidence, None, None))
    return tuple(sorted(findings, key=lambda finding: -finding.score)), tuple(absent)
