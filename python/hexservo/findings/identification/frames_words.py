"""Clock and noise of the camera as sentences and a table (docs/identification.md)."""

from __future__ import annotations

import math
from dataclasses import asdict

from hexservo.findings.evidence import Column, Section, Table, Verdict
from hexservo.findings.identification.drives import GOOD
from hexservo.findings.identification.drives_words import at_most, with_interval
from hexservo.findings.identification.frames import SEEN, CameraFit
from hexservo.findings.identification.frames_outliers import NoOutliers, Outliers
from hexservo.findings.identification.interval import Interval
from hexservo.findings.identification.predicted_images import MOST_LATENCY
from hexservo.scenario.wording import number

_TITLE = "Camera"
_UNKNOWN = "not determined"
_BETWEEN_TICKS = "motion of the joints between ticks that are long for it"


def section(found: CameraFit) -> Section:
    """Return the findings as sentences and a table."""
    data = asdict(found)
    if found.open:
        return Section("camera", _TITLE, [f"Nothing was found of the camera: {found.open}."], data=data)
    rows = [
        ("period", with_interval(None if found.period is None else found.period.times(1e3)), "ms"),
        ("latency", with_interval(None if found.latency is None else found.latency.times(1e3)), "ms"),
        ("a frame is later by at most", _jitter(found), "ms"),
        ("exposure times are late by", with_interval(found.stamps and found.stamps.times(1e3)), "ms"),
        ("frames that did not arrive", with_interval(found.dropout and found.dropout.times(100)), "%"),
        *([("points that frames lack", number(100 * found.lost_points), "%")] if found.incomplete else []),
        ("noise of a coordinate", with_interval(found.noise) if found.noise_is_of_camera else _UNKNOWN, "px"),
        *([("pixels are rounded to", number(found.rounding), "px")] if found.of_rounding > SEEN else []),
        *_rows_of_outliers(found.outliers),
        ("predicted of the part kept apart", None if found.explained is None else number(100 * found.explained), "%"),
        *_rows_of_the_target(found),
    ]
    table = Table(
        "Camera; in brackets 95 % intervals",
        (Column("quantity"), Column("value"), Column("unit")),
        rows,
        page="docs/identification.md",
    )
    known = found.latency_is_known and found.period is not None and (found.explained or 0.0) >= GOOD
    good = known and not doubts(found)
    verdict: Verdict = "bad" if not found.explains else "good" if good else "warning"
    return Section(
        "camera",
        _TITLE,
        [
            *_of_outliers(found),
            *_sentences(found),
            *_of_rounding(found),
            *_of_repeated(found),
            *_of_overwritten(found),
        ],
        (table,),
        verdict,
        data,
    )


def _sentences(found: CameraFit) -> list[str]:
    latency = found.latency
    if not found.explains and found.explained is not None:
        return [
            f"Joints and target predict {at_most(found.explained)} of the motion of the image in the part kept apart: "
            "the image is not of this model, and no key of the camera is taken over. Likely reasons: another order of "
            "the points than the target's; y up in place of down, or pixels that are not those of the scenario's "
            "camera (camera.axes, focal_pixels, principal_point); another place of the camera (camera.mount) or of the "
            "target; the order or the sign of the legs; an image that moves by little more than its noise."
        ]
    if latency is not None and found.at_edge:
        return [*_at_edge(found), *_without_period(found)]
    if latency is None or not found.latency_is_known:
        return [
            *_without_period(found),
            f"The log does not tell the latency of the camera, which may be anything from 0 to "
            f"{1e3 * MOST_LATENCY:.0f} ms: the platform has to move while frames are taken.",
            *doubts(found),
        ]
    words = [
        f"A frame arrives {number(1e3 * latency.value)} ms after it was taken ({number(1e3 * latency.low)} to "
        f"{number(1e3 * latency.high)} ms)"
        + (", by its exposure times." if found.stamps is not None else ", by the motion of joints and image.")
    ]
    if found.stragglers:
        words.append(
            f"{found.stragglers} of {found.frames} frames arrived far from when the others do, and are left out of "
            "latency and jitter."
        )
    if found.stamps is None and found.jitter is not None:
        as_of = (
            f"as of frames that arrive up to {number(1e3 * found.jitter)} ms later than the earliest; the noise is "
            "that of an image at rest."
            if found.jitter_is_known
            else f"as of {_not_late(found)}, or of frames that arrive later than others: the log does not tell which."
        )
        words.append(f"The image is off by more where it moves faster, {as_of}")
    return [*words, *_without_period(found), _of_the_target(found), *doubts(found)]


def doubts(found: CameraFit) -> list[str]:
    """Return what the scenario that is identified does not have of the camera."""
    if not found.explains or found.at_edge:
        return []
    words, stamps = [], found.stamps
    if found.lost_points > SEEN:
        words.append(
            f"{found.incomplete} of {found.frames - found.repeated} frames that arrived lack points, together "
            f"{number(100 * found.lost_points)} % of all; the fit has the others. The scenario has no such loss of "
            "single points: `camera.dropout` is that of whole frames."
        )
    if stamps is not None and found.stamps_are_wrong and found.latency_is_known:
        words.append(
            f"The exposure times do not agree with the joints: frames were taken {number(1e3 * abs(stamps.value))} ms "
            f"{'before' if stamps.value > 0 else 'after'} what they state."
        )
    if isinstance(found.outliers, Outliers) and not found.outliers.are_known:
        reason = (
            "they stay for several frames, and those of the model come by themselves"
            if found.outliers.last
            else "one does not determine how often they come"
        )
        words.append(
            f"The scenario has no such wrong detections: {reason}. The keys `camera.outlier_probability` and "
            "`camera.outlier_size` are left as they are."
        )
    if found.target_is_apparent:
        words.append(
            f"The place where the target is seen moves the image by {number(found.target_pixels)} px (RMS), and no key "
            "has it. Check the place and the size of the target (target.points), the focal length (camera.focal_length "
            "or camera.focal_pixels) and the camera's mount (camera.mount): a displaced target stands for any of these."
        )
    if not found.noise_is_white and found.noise_is_of_camera and found.rounding_is_most:
        words.append(
            f"What the fit leaves of the image is correlated over {number(found.correlated)} frames, and rounding of "
            f"the pixels to {number(found.rounding)} px explains {number(100 * found.of_rounding)} % of it: an image "
            "that moves by less is off by the same in one frame after the other. The log does not tell a finer noise. "
            f"{_left(found)}"
        )
    elif not found.noise_is_white and found.noise_is_of_camera:  # the rounding of joints at rest is correlated, too
        words.append(
            f"What the fit leaves of the image is correlated over {number(found.correlated)} frames: it is more than "
            "noise, such as a wrong size of the target, focal length, lens or mount, and the noise and its interval "
            f"are too large. {_left(found)}"
        )
    elif not found.noise_is_of_camera:
        words.append(
            f"{_by_joints(found).capitalize()} {'may explain' if found.ticks_are_coarse else 'explains'} "
            f"{number(100 * found.of_joints)} % of what the fit leaves of the image across its motion, and the rest "
            f"does not tell the noise of the camera. {_left(found)}"
        )
    elif not found.jitter_is_known:
        words.append(
            "The scatter of the latency is not determined: the joints are not read often enough to tell it from motion "
            "between ticks. Record exposure times, or more ticks a second. The key `camera.latency_jitter` is left as "
            "it is."
        )
    return words


def _left(found: CameraFit) -> str:
    """Return which keys are left where what the fit leaves does not tell them."""
    if found.jitter_is_known:
        return "The key `camera.noise` is left as it is."
    return "The keys `camera.noise` and `camera.latency_jitter` are left as they are."


def _not_late(found: CameraFit) -> str:
    """Return what else moves the image where no jitter is known."""
    reasons = [] if found.noise_is_white else ["rounding" if found.rounding_is_most else "a wrong calibration"]
    if not found.noise_is_of_camera:
        reasons.append(_by_joints(found))
    elif found.jitter_of_ticks:
        reasons.append(_BETWEEN_TICKS)
    return ", ".join(reasons)


def _by_joints(found: CameraFit) -> str:
    """Return what of the joints is unknown, and moves the image that they predict."""
    return _BETWEEN_TICKS if found.ticks_are_coarse else "the noise of the joints"


def _jitter(found: CameraFit) -> str | None:
    if not found.jitter_is_known:
        return _UNKNOWN
    return None if found.jitter is None else number(1e3 * found.jitter)


def _of_repeated(found: CameraFit) -> list[str]:
    if not found.repeated:
        return []
    return [
        f"{found.repeated} of {found.frames} frames repeat the one before, equal in every coordinate: they do "
        "not count, and the period is that of the others."
    ]


def _of_overwritten(found: CameraFit) -> list[str]:
    if not found.overwritten or found.period is None:
        return []
    return [
        f"The camera takes a frame every {number(1e3 * found.period.value)} ms, more often than the log has lines: "
        f"{found.overwritten} frames arrived before another one of the same line, which has the newest. A scenario has "
        "one frame a tick at most."
    ]


def _of_outliers(found: CameraFit) -> list[str]:
    outliers = found.outliers
    if not isinstance(outliers, Outliers) or not found.explains:
        return []
    return [
        f"{outliers.frames} of {outliers.searched} frames have a point that is more than {number(outliers.farther)} px "
        "from where joints and target place it, unlike the others: a wrong detection. These frames do not count in the "
        "fit and its noise. A controller leaves such points out by `camera.gate` [px], if that is above what noise "
        "and motion of the target do."
    ]


def _of_rounding(found: CameraFit) -> list[str]:
    if found.noise is None or found.of_rounding <= SEEN or not found.explains:
        return []
    words = f"The pixels of the log are rounded to {number(found.rounding)} px: the key is `camera.quantisation`"
    if not found.noise_is_white:
        return [f"{words}."]
    scatter = math.hypot(found.noise.value, found.rounding / math.sqrt(12.0))
    return [
        f"{words}, and {number(found.noise.value)} px of noise beside it scatter a coordinate by {number(scatter)} px."
    ]


def _rows_of_outliers(outliers: Outliers | NoOutliers | None) -> list[tuple[str, str | None, str]]:
    if not isinstance(outliers, Outliers):
        return []
    return [
        ("points that are wrong detections", with_interval(outliers.probability.times(100)), "%"),
        ("these are off by, standard deviation", with_interval(outliers.size), "px"),
    ]


def _without_period(found: CameraFit) -> list[str]:
    if found.period is not None:
        return []
    return [
        "The times of the frames do not tell their period: their jitter is as long as it is, or the rate changes. The "
        "keys `camera.period` and `camera.dropout` are left as they are."
    ]


def _rows_of_the_target(found: CameraFit) -> list[tuple[str, str | None, str]]:
    names = [f"target displaced along {axis}" for axis in "xyz"] + [f"target turned about {axis}" for axis in "xyz"]
    around = [Interval.around(*pair) for pair in zip(found.target, found.target_deviations, strict=True)]
    return [
        (name, with_interval(one.times(1e3)), unit)
        for name, one, unit in zip(names, around, 3 * ["mm"] + 3 * ["mrad"], strict=True)
    ]


def _at_edge(found: CameraFit) -> list[str]:
    stamps, kept = found.stamps, "the keys `camera.latency` and `camera.noise` are left as they are"
    if stamps is None:
        words = (
            f"A frame arrives at least {1e3 * MOST_LATENCY:.0f} ms after it was taken, at the edge of what is "
            f"searched: {kept}."
        )
    else:
        words = (
            f"The exposure times do not agree with the joints: frames were taken at least "
            f"{number(1e3 * abs(stamps.value))} ms {'before' if stamps.value > 0 else 'after'} what they state, at the "
            "edge of what is searched. Are they of the same clock as the joints? Until then "
            f"{kept}."
        )
    return [words, _of_the_target(found)]


def _of_the_target(found: CameraFit) -> str:
    shift = found.target
    return (
        f"The target is {number(1e3 * float((shift[:3] ** 2).sum() ** 0.5))} mm and "
        f"{number(1e3 * float((shift[3:] ** 2).sum() ** 0.5))} mrad from where the scenario has it."
    )
