"""Logs of machines from MCAP files with messages in JSON (docs/identification.md has the topics)."""

from __future__ import annotations

import io
import json
import math
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hexservo.scenario.arrays import Array
from hexservo.scenario.rules import MOST_POINTS
from hexservo.scenario.yaml import ScenarioError

if TYPE_CHECKING:
    from mcap.records import Chunk, McapRecord

__all__ = ["COMMANDS", "FEATURES", "JOINTS", "MAX_CHUNK", "MAX_MESSAGE", "Recorded", "period_of", "read_mcap"]

COMMANDS, JOINTS, FEATURES = "/commands", "/joints", "/features"
MAX_CHUNK = 64_000_000  # bytes of a chunk after decompression, and of any other record
MAX_MESSAGE = 100_000  # bytes of a message of these topics
_MOST_TIME = 1e12  # [s]
# Footer and magic, after which the library stops reading: closes what is read of a chunk.
_CLOSING = struct.pack("<BQQQI", 2, 20, 0, 0, 0) + b"\x89MCAP0\r\n"


@dataclass(frozen=True, eq=False)
class Recorded:
    """What a file has: n ticks, and m frames."""

    time: Array  # (n,) of the readings of the joints [s]
    period: float  # [s]
    commands: Array  # (n, 6)
    joints: Array  # (n, 6)
    features: Array | None  # (m, 2p) [px]; NaN of points that are lost
    arrival: Array  # (m,) [s]
    exposure: Array | None  # (m,) [s]


@dataclass
class _Message:
    """One message: its own time where it has one, else when it was logged."""

    logged: int  # [ns]
    time: float | None  # [s]
    numbers: list[float]
    exposure: float | None  # [s]


def period_of(time: Array) -> float:
    """Return the usual time between ticks (n,) [s]: the median over half of the record, without ticks that are late."""
    half = len(time) // 2
    return float(np.median(time[half:] - time[: len(time) - half])) / half if half else 0.0


def read_mcap(path: Path, source: str, *, most_bytes: int, most_rows: int) -> Recorded:
    """Read the log of a machine from an MCAP file, uncompressed or compressed by lz4 or zstd.

    Parameters
    ----------
    path
        A regular file.
    source
        Its name for messages.
    most_bytes, most_rows
        After decompression, and messages of a topic.

    Raises
    ------
    ScenarioError
        Where the package `mcap` is missing, for a damaged file, and for the first message that is not as expected.
    OSError
        For a file that cannot be opened.
    """
    try:
        import mcap  # noqa: F401
    except ImportError:
        raise ScenarioError(
            "expected the package mcap for a file of this kind, which the extra 'mcap' installs: "
            "pip install 'hexservo[mcap]'; a CSV file needs none",
            source,
        ) from None
    messages: dict[str, list[_Message]] = {COMMANDS: [], JOINTS: [], FEATURES: []}
    with path.open("rb") as file:
        for topic, logged, data in _of_topics(_records(file, source, most_bytes), source):
            kept = messages[topic]
            if len(kept) == most_rows:
                raise ScenarioError(f"{topic}: expected at most {most_rows} messages, got more", source)
            kept.append(_parsed(topic, len(kept) + 1, logged, data, source))
    missing = [topic for topic in (COMMANDS, JOINTS) if not messages[topic]]
    if missing:
        raise ScenarioError(
            f"expected the topics {COMMANDS} and {JOINTS}, and {FEATURES} of an image, with messages in JSON, "
            f"got none of {', '.join(missing)}",
            source,
        )
    return _joined(messages[COMMANDS], messages[JOINTS], messages[FEATURES], source)


# ---- The container --------------------------------------------------------------------------------------------------


def _records(file: io.BufferedReader, source: str, most_bytes: int) -> Iterator[McapRecord]:
    """Yield the records of a file and of its chunks, of bounded size."""
    from mcap.exceptions import McapError
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader

    left = most_bytes
    limits: dict[str, Any] = {"validate_crcs": True, "record_size_limit": MAX_CHUNK}
    try:
        for record in StreamReader(file, emit_chunks=True, **limits).records:
            if not isinstance(record, Chunk):
                yield record
                continue
            data = _unpacked(record)
            left -= len(data)
            if left < 0:
                raise ScenarioError(f"expected at most {most_bytes} bytes after decompression, got more", source)
            yield from StreamReader(io.BytesIO(data + _CLOSING), skip_magic=True, record_size_limit=MAX_CHUNK).records
    except ScenarioError:
        raise
    # What the library and the decompressors raise for bytes that are not as they should be.
    except (McapError, ValueError, struct.error, LookupError, OverflowError, RuntimeError, MemoryError) as error:
        raise ScenarioError(
            f"expected an MCAP file that is whole, got one that cannot be read from byte {file.tell()} on "
            f"({type(error).__name__}); `mcap recover` of the MCAP tools keeps what is left of it",
            source,
        ) from None


def _unpacked(chunk: Chunk) -> bytes:
    """Return the records of a chunk, whose length and checksum are as stated."""
    import zlib

    if chunk.uncompressed_size > MAX_CHUNK:
        raise ValueError("chunk too large")
    if chunk.compression == "zstd":
        import zstandard

        try:
            reader = zstandard.ZstdDecompressor(max_window_size=2**27).stream_reader(chunk.data)
            data = reader.read(chunk.uncompressed_size + 1)
        except zstandard.ZstdError as error:
            raise ValueError(str(error)) from None
    elif chunk.compression == "lz4":
        import lz4.frame

        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=chunk.uncompressed_size + 1)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError("unknown compression")
    if len(data) != chunk.uncompressed_size or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("checksum or length")
    return bytes(data)


def _of_topics(records: Iterator[McapRecord], source: str) -> Iterator[tuple[str, int, bytes]]:
    """Yield topic, time [ns] and bytes of the messages that a log is made of."""
    from mcap.records import Channel, Message

    topics: dict[int, str | None] = {}  # of each channel, None for those of other topics
    for record in records:
        if isinstance(record, Channel):
            used = record.topic in (COMMANDS, JOINTS, FEATURES)
            if used and record.message_encoding != "json":
                raise ScenarioError(f"{record.topic}: expected messages in JSON, got a different encoding", source)
            topics[record.id] = record.topic if used else None
        elif isinstance(record, Message):
            if record.channel_id not in topics:
                raise ScenarioError("expected an MCAP file that is whole, got a message without its channel", source)
            if (topic := topics[record.channel_id]) is not None:
                yield topic, record.log_time, record.data


# ---- Messages -------------------------------------------------------------------------------------------------------


def _parsed(topic: str, count: int, logged: int, data: bytes, source: str) -> _Message:
    """Return the numbers of a message; the file may be the wrong one, so nothing of it is quoted."""
    where = f"{topic}, message {count}"
    if len(data) > MAX_MESSAGE:
        raise ScenarioError(f"{where}: expected at most {MAX_MESSAGE} bytes, got {len(data)}", source)
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise ScenarioError(f"{where}: expected a JSON object, got something else ({len(data)} bytes)", source)
    values: Any = content.get("features" if topic == FEATURES else "positions")
    if topic == FEATURES:
        wanted = f'"features": a list of 2 numbers for each of 1 to {MOST_POINTS} points'
        fits = isinstance(values, list) and len(values) % 2 == 0 and 2 <= len(values) <= 2 * MOST_POINTS
    else:
        wanted = '"positions": a list of 6 numbers'
        fits = isinstance(values, list) and len(values) == 6
    lost = math.nan if topic == FEATURES else None  # a point that the frame does not show is null
    numbers = [lost if value is None else _number(value) for value in values] if fits else [None]
    if any(number is None for number in numbers):
        raise ScenarioError(f"{where}: expected {wanted}, got something else", source)
    times: list[float | None] = []
    for key in ("time", "exposure"):
        times.append(_number(content[key]) if key in content else None)
        if key in content and (times[-1] is None or abs(times[-1]) > _MOST_TIME):
            raise ScenarioError(f'{where}: expected "{key}": seconds, got something else', source)
    return _Message(logged, times[0], [number for number in numbers if number is not None], times[1])


def _number(value: object) -> float | None:
    """Return a finite number of JSON, or None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value) if math.isfinite(value) else None
    except OverflowError:
        return None


# ---- From messages to ticks -----------------------------------------------------------------------------------------


def _joined(
    commands: Sequence[_Message], joints: Sequence[_Message], features: Sequence[_Message], source: str
) -> Recorded:
    """Return the log with a tick at every reading of the joints, and with the newest command until the next one."""
    every = [*commands, *joints, *features]
    own = sum(message.time is not None for message in every)
    if own not in (0, len(every)):
        raise ScenarioError(f'expected "time" in all messages or in none, got it in {own} of {len(every)}', source)
    start = 0 if own else min(message.logged for message in joints)  # [ns]

    def ordered(messages: Sequence[_Message]) -> tuple[list[_Message], Array]:
        times = np.array([(m.logged - start) * 1e-9 if m.time is None else m.time for m in messages])
        order = np.argsort(times, kind="stable")
        return [messages[place] for place in order], times[order]

    commands, commanded = ordered(commands)
    joints, time = ordered(joints)
    # Ticks before the first command are left out before anything is made of the times: a program that starts may read
    # the joints now and then.
    first = int(np.searchsorted(time[1:], commanded[0], side="right"))
    joints, time = joints[first:], time[first:]
    period = period_of(time)
    # of each tick, the newest before the next one
    newest = np.searchsorted(commanded, np.append(time[1:], time[-1] + period), side="left") - 1
    if newest[0] < 0:
        raise ScenarioError(f"expected commands during the record of {JOINTS}, got none before its end", source)
    positions = np.array([message.numbers for message in commands])
    measured = np.array([message.numbers for message in joints])
    shown, arrival, exposure = _frames(*_during(time, period, *ordered(features), source), start * 1e-9, source)
    return Recorded(time, period, positions[newest], measured, shown, arrival, exposure)


def _during(
    time: Array, period: float, features: list[_Message], arrival: Array, source: str
) -> tuple[list[_Message], Array]:
    """Return the frames that arrived between the first and the last of the ticks: a recorder may have more of them."""
    inside = np.flatnonzero((arrival >= time[0] - period) & (arrival <= time[-1] + period))
    if features and not len(inside):
        raise ScenarioError(
            f"{FEATURES}: expected messages between the first of {COMMANDS} and the last of {JOINTS}, got "
            f"{len(features)} before or after them; "
            'are their times of another clock? Give "time" of one clock in all messages',
            source,
        )
    return [features[place] for place in inside], arrival[inside]


def _frames(
    features: Sequence[_Message], arrival: Array, start: float, source: str
) -> tuple[Array | None, Array, Array | None]:
    if not features:
        return None, arrival, None
    widths = {len(message.numbers) for message in features}
    if len(widths) != 1:
        raise ScenarioError(f"{FEATURES}: expected the same number of points in all messages, got others", source)
    stamped = sum(message.exposure is not None for message in features)
    if stamped not in (0, len(features)):
        count = f"{stamped} of {len(features)}"
        raise ScenarioError(f'{FEATURES}: expected "exposure" in all messages or in none, got it in {count}', source)
    pixels = np.array([message.numbers for message in features])
    if not np.isfinite(pixels).any():
        return None, arrival, None
    exposure = np.array([message.exposure for message in features], dtype=float) - start if stamped else None
    return pixels, arrival, exposure
