"""Keys that a log gives as a table (docs/identification.md)."""

from __future__ import annotations

from typing import Any

from hexservo.findings.evidence import Column, Section, Table, Verdict
from hexservo.findings.identification.changes import Changes
from hexservo.scenario.wording import number

_TIMEOUT = "camera.timeout"  # a key only where that of the machine is too short


def section(found: Changes) -> Section:
    """Return what the scenario of the machine has now, and had before."""
    rows = [[key, _became(found, key), _text(found.given[key])] for key in found.identified]
    verdicts = set(found.verdicts.values())
    verdict: Verdict = "bad" if "bad" in verdicts else "good" if verdicts == {"good"} else "warning"
    if (_TIMEOUT in found.identified or found.milliseconds is not None) and verdict == "good":
        verdict = "warning"
    rows += [[key, _left(found, key), _text(found.given[key])] for key in dict.fromkeys([*found.open, *found.rounded])]
    table = Table(
        "Keys of the scenario",
        (Column("key"), Column("identified"), Column("given")),
        rows,
        page="docs/identification.md",
    )
    return Section(
        "keys",
        "The scenario",
        [*_of_milliseconds(found), _sentence(found, verdict), *_of_timeout(found), *_of_faults(found)],
        (table,),
        verdict,
        {"changes": dict(found.identified), "rounded": dict(found.rounded), "faults": dict(found.faults)},
    )


def _sentence(found: Changes, verdict: Verdict) -> str:
    if verdict == "good":
        sees = "moves and sees" if "Camera" in found.verdicts else "moves"
        return f"The scenario with these keys {sees} as the log does; law and gains are those that were given."
    doubtful = [title for title, one in found.verdicts.items() if one != "good"]
    if not doubtful and _TIMEOUT not in found.identified:
        return "The scenario with these keys moves as the log does if its times are in seconds."
    if not doubtful:
        return "The scenario with these keys moves and sees as the log does, with a longer timeout than the machine's."
    parts = " and ".join(f'"{title}"' for title in doubtful)
    return (
        f"See {parts} before you rely on this scenario: what the log does not determine, or what no model predicts, "
        "is that of the scenario that was given, as law and gains are."
    )


def _of_milliseconds(found: Changes) -> list[str]:
    if found.milliseconds is None:
        return []
    bandwidth, given, length = found.milliseconds
    return [
        f"Are the times of the log in ms? As seconds it has {number(length)} s, and drives of {number(bandwidth)} Hz, "
        f"{number(given / bandwidth)} times slower than those that were given (actuators.position.bandwidth, "
        f"{number(given)} Hz). If so, divide the times by 1000, arrival and exposure too."
    ]


def _of_timeout(found: Changes) -> list[str]:
    if _TIMEOUT not in found.identified:
        return []
    given, least = (number(1e3 * one[_TIMEOUT]) for one in (found.given, found.identified))
    return [
        f"The `camera.timeout` of {given} ms conflicts with what was measured: period, latency and its scatter leave "
        f"images up to {least} ms old, which would count as lost. The scenario has {least} ms, the least that has room "
        "for them. Change the key to what the machine should wait, or make the camera faster."
    ]


def _of_faults(found: Changes) -> list[str]:
    if not found.faults:
        return []
    keys = ", ".join(f"{key}={_text(value)}" for key, value in found.faults.items())
    return [
        f"Correct the exposure times of the machine first: `hexservo diagnose` of this log simulates their error "
        f"({keys}), and this scenario is without it."
    ]


def _became(found: Changes, key: str) -> str:
    """Return a value that was identified, with the time that it was rounded from where four digits show it."""
    value = found.identified[key]
    if key not in found.times or f"{found.times[key]:.4g}" == f"{value:.4g}":
        return _text(value)
    return f"{_text(value)} ({found.times[key]:.4g} before rounding)"


def _left(found: Changes, key: str) -> str:
    """Return what becomes of a key that the log does not give."""
    words = ["not determined"] if key in found.open else []
    if key not in found.rounded:
        return f"{_text(found.given[key])} ({', '.join(words)})"
    return f"{_text(found.rounded[key])} ({', '.join([*words, 'whole ticks'])})"


def _text(value: Any) -> str:
    return "none" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
