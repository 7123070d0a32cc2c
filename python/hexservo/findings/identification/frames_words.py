"""Clock and noise of the camera as sentences and a table (docs/identification.md)."""

from __future__ import annotations

from dataclasses import asdict

from hexservo.findings.evidence import Column, Section, Table
from hexservo.findings.identification.drives_words import with_interval
from hexservo.findings.identification.frames import MOST_LATENCY, CameraFit
from hexservo.scenario.wording import number

__all__ = ["section"]

PAGE = "docs/identification.md"
_TITLE = "Camera"
_GOOD = 0.95  # share of the image motion kept apart that a model should predict


def section(found: CameraFit) -> Section:
    """Return the findings as sentences and a table."""
    data = asdict(found)
    if found.open:
        return Section("camera", _TITLE, [f"Nothing was found of the camera: {found.open}."], data=data)
    rows = [
        ("period", with_interval(None if found.period is None else found.period.times(1e3)), "ms"),
        ("latency", with_interval(None if found.latency is None else found.latency.times(1e3)), "ms"),
        ("a frame is later by at most", None if found.jitter is None else number(1e3 * found.jitter), "ms"),
        ("exposure times are late by", with_interval(found.stamps and found.stamps.times(1e3)), "ms"),
        ("frames that did not arrive", number(100 * found.dropout), "%"),
        ("noise of a coordinate", with_interval(found.noise), "px"),
        ("predicted of the part kept apart", number(100 * found.explained), "%"),
    ]
    table = Table("Camera, with 95 % intervals", (Column("quantity"), Column("value"), Column("unit")), rows, page=PAGE)
    good = found.latency_is_known and found.explained >= _GOOD
    return Section("camera", _TITLE, _sentences(found), (table,), "good" if good else "warning", data)


def _sentences(found: CameraFit) -> list[str]:
    latency = found.latency
    if latency is None or not found.latency_is_known:
        return [
            f"The log does not tell the latency of the camera, which may be anything from 0 to "
            f"{1e3 * MOST_LATENCY:.0f} ms: the platform has to move while frames are taken."
        ]
    words = [
        f"A frame arrives {number(1e3 * latency.value)} ms after it was taken ({number(1e3 * latency.low)} to "
        f"{number(1e3 * latency.high)} ms)"
        + (", by its exposure times." if found.stamps is not None else ", by the motion of joints and image.")
    ]
    stamps = found.stamps
    if stamps is not None and (stamps.low > 0.0 or stamps.high < 0.0):
        words.append(
            f"The exposure times do not agree with the joints: frames were taken {number(1e3 * abs(stamps.value))} ms "
            f"{'before' if stamps.value > 0 else 'after'} what they state."
        )
    if found.stragglers:
        words.append(
            f"{found.stragglers} of {found.frames} frames arrived far from when the others do, and are left out of "
            "latency and jitter."
        )
    shift = found.target
    words.append(
        f"The target is {number(1e3 * float((shift[:3] ** 2).sum() ** 0.5))} mm and "
        f"{number(1e3 * float((shift[3:] ** 2).sum() ** 0.5))} mrad from where the scenario has it."
    )
    return words
