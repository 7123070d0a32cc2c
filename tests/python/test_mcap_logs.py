"""Logs in MCAP: the same log as from CSV, compressed or not; damaged and wrong files are refused with a message."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.identification import mcap_log
from hexservo.findings.identification.log import Log
from recorded_machines import Drive, record, wandering
from test_identification import try_delays

writing = pytest.importorskip("mcap.writer", reason="the extra mcap is not installed", exc_type=ImportError)
SEED = 20270115
START = 1_790_000_000_000_000_000  # [ns] when the record began, by the clock of the computer
TICKS, PERIOD = 60, 0.02
Message = tuple[str, int, Any]  # topic, time of the log [ns], content
NUMBERS = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]


def written(path: Path, messages: Iterable[Message], compression: str = "ZSTD", encoding: str = "json") -> Path:
    """Write messages; a content that is bytes is written as it is."""
    with path.open("wb") as file:
        writer = writing.Writer(file, compression=writing.CompressionType[compression], chunk_size=2000)
        writer.start()
        channels: dict[str, int] = {}
        for topic, time, content in messages:
            if topic not in channels:
                schema = writer.register_schema("numbers", "jsonschema", b'{"type": "object"}')
                channels[topic] = writer.register_channel(topic, encoding, schema)
            data = content if isinstance(content, bytes) else json.dumps(content).encode()
            writer.add_message(channels[topic], log_time=time, publish_time=time, data=data)
        writer.finish()
    return path


def nanoseconds(seconds: float) -> int:
    return START + round(seconds * 1e9)


def a_log() -> Log:
    random = np.random.default_rng(SEED)
    print(f"seed {SEED}")
    commands = 0.2 + wandering(random, TICKS, PERIOD, 1e-3, 0.1)
    return record(commands, PERIOD, [Drive(4.0, 0.8, 1)] * 6, 1e-6, random)


def ticks_of(log: Log, late: float = 1e-3) -> list[Message]:
    """Messages of a program that reads the joints at a tick and gives the command `late` after it."""
    messages: list[Message] = [("/other", START, b"not JSON")]
    for tick in range(TICKS):
        joints = {"positions": log.joints[tick].tolist()}
        messages.append(("/joints", nanoseconds(log.time[tick]), joints))
        command = {"positions": log.commands[tick].tolist()}
        messages.append(("/commands", nanoseconds(log.time[tick] + late), command))
    return messages


def frames_of(count: int, stamped: bool) -> list[Message]:
    messages: list[Message] = []
    for index in range(count):
        exposure = START * 1e-9 + 0.1 + index / 30
        content: dict[str, Any] = {"features": [float(index), 1.0, None if index == 3 else 2.0, 3.0]}
        if stamped:
            content["exposure"] = exposure
        messages.append(("/features", nanoseconds(0.15 + index / 30), content))
    return messages


@pytest.mark.parametrize("compression", ["NONE", "LZ4", "ZSTD"])
def test_a_log_is_that_which_was_written(tmp_path: Path, compression: str) -> None:
    log = a_log()
    messages = [*ticks_of(log), *frames_of(20, stamped=True)]
    np.random.default_rng(SEED).shuffle(messages)  # files of several writers are not in order
    found = hs.read_log(written(tmp_path / "log.mcap", messages, compression))
    np.testing.assert_array_equal(found.commands, log.commands)
    np.testing.assert_array_equal(found.joints, log.joints)
    np.testing.assert_allclose(found.time, log.time, rtol=0, atol=1e-9)
    assert found.period == pytest.approx(PERIOD, rel=1e-9)
    assert found.frames is not None
    assert found.frames.seen.tolist() == [[True, index != 3] for index in range(20)]
    assert found.frames.exposure is not None
    # seconds since 1970 as a double have steps of 2.4e-7 s
    np.testing.assert_allclose(found.frames.arrival - found.frames.exposure, 0.05, rtol=0, atol=5e-7)
    np.testing.assert_allclose(found.frames.arrival, 0.15 + np.arange(20) / 30, rtol=0, atol=1e-9)


def test_frames_before_and_after_the_ticks_are_left_out(tmp_path: Path) -> None:
    """A recorder that is started before the machine's program, and stopped after it."""
    frames = [(topic, time - 5 * 10**8, content) for topic, time, content in frames_of(90, stamped=False)]
    found = hs.read_log(written(tmp_path / "log.mcap", [*ticks_of(a_log()), *frames]))
    assert found.frames is not None
    arrival = found.frames.arrival
    assert -PERIOD <= arrival[0] < 1 / 30
    assert (TICKS - 1) * PERIOD - 1 / 30 < arrival[-1] <= TICKS * PERIOD


@pytest.mark.parametrize("before", [0.3, 2.0])
def test_frames_and_readings_before_the_first_command_are_left_out(tmp_path: Path, before: float) -> None:
    """Of a program that reads the joints twice at its start, and of a camera that runs before it."""
    log = a_log()
    early: list[Message] = [
        ("/joints", nanoseconds(-before - time), {"positions": log.joints[0].tolist()}) for time in (0.0, 0.013)
    ]
    frames = [(topic, time - round(before * 1e9), content) for topic, time, content in frames_of(90, stamped=False)]
    found = hs.read_log(written(tmp_path / "log.mcap", [*early, *ticks_of(log), *frames]))
    # the last reading before the first command is the tick of it
    np.testing.assert_array_equal(found.joints, log.joints)
    assert found.period == pytest.approx(PERIOD, rel=1e-9)
    assert found.frames is not None
    assert found.time[0] - PERIOD <= found.frames.arrival[0] < found.time[0] + 1 / 30


def test_a_command_holds_until_the_next_one(tmp_path: Path) -> None:
    """Commands that come seldom, and a machine that is read before the first one."""
    log = a_log()
    messages = [m for m in ticks_of(log) if m[0] != "/commands"]
    given = {10: 0.1, 25: 0.2, 40: 0.3}  # tick: command
    messages += [
        ("/commands", nanoseconds(tick * PERIOD + 2e-3), {"positions": [value] * 6}) for tick, value in given.items()
    ]
    found = hs.read_log(written(tmp_path / "log.mcap", messages))
    assert len(found.time) == TICKS - 10
    np.testing.assert_array_equal(found.commands[:, 0], [0.1] * 15 + [0.2] * 15 + [0.3] * 20)
    np.testing.assert_array_equal(found.joints, log.joints[10:])


def test_times_of_the_messages_replace_those_of_the_log(tmp_path: Path) -> None:
    log = a_log()
    messages = []
    for topic, time, content in ticks_of(log, late=0.0):
        if topic != "/other":
            content["time"] = (time - START) * 1e-9
            messages.append((topic, 7, content))
    found = hs.read_log(written(tmp_path / "log.mcap", messages))
    np.testing.assert_array_equal(found.commands, log.commands)
    np.testing.assert_allclose(found.time, log.time, rtol=0, atol=1e-9)
    for _, _, content in messages:
        content["time"] += START * 1e-9
    since_1970 = hs.read_log(written(tmp_path / "since_1970.mcap", messages))
    np.testing.assert_allclose(since_1970.time, log.time, rtol=0, atol=2.4e-7)  # steps of such a double
    assert since_1970.period == pytest.approx(PERIOD, rel=1e-15)
    del messages[5][2]["time"]
    with pytest.raises(hs.ScenarioError, match="in all messages or in none, got it in 119 of 120"):
        hs.read_log(written(tmp_path / "mixed.mcap", messages))


def test_identify_takes_it(tmp_path: Path, paper: hs.Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    try_delays(monkeypatch, 0, 1)
    random = np.random.default_rng(SEED)
    commands = 0.18 + wandering(random, 300, PERIOD, 1e-3, 0.2)
    log = record(commands, PERIOD, [Drive(4.0, 0.8, 1)] * 6, 1e-7, random)
    messages: list[Message] = []
    for tick in range(300):
        messages.append(("/joints", nanoseconds(log.time[tick]), {"positions": log.joints[tick].tolist()}))
        messages.append(("/commands", nanoseconds(log.time[tick]), {"positions": log.commands[tick].tolist()}))
    found = hs.identify(written(tmp_path / "LOG.MCAP", messages), paper)
    assert found.scenario.actuators.position.bandwidth == pytest.approx(4.0, rel=1e-3)
    assert found.scenario.actuators.delay == pytest.approx(0.02)


# ---- Files that are refused -----------------------------------------------------------------------------------------


def replaced(number: int, change: Callable[[Message], Message]) -> list[Message]:
    messages = ticks_of(a_log())
    messages[number] = change(messages[number])
    return messages


WRONG = {
    "null": (None, "message 1: expected a JSON object"),
    "text": (b"secret", "message 1: expected a JSON object"),
    "deep": (b"[" * 90_000, "message 1: expected a JSON object"),
    "long": (b'{"positions": [' + b"1," * 60_000 + b"1]}", "expected at most 100000 bytes, got 120018"),
    "five": ({"positions": NUMBERS[:5]}, "a list of 6 numbers"),
    "none": ({"position": NUMBERS}, "a list of 6 numbers"),
    "truth": ({"positions": [*NUMBERS[:5], True]}, "a list of 6 numbers"),
    "words": ({"positions": [*NUMBERS[:5], "secret"]}, "a list of 6 numbers"),
    "lost": ({"positions": [*NUMBERS[:5], None]}, "a list of 6 numbers"),
    "infinite": (b'{"positions": [1, 2, 3, 4, 5, Infinity]}', "a list of 6 numbers"),
    "huge": (b'{"positions": [1, 2, 3, 4, 5, 1' + b"0" * 400 + b"]}", "a list of 6 numbers"),
    "digits": (b'{"positions": [1, 2, 3, 4, 5, 1' + b"0" * 5000 + b"]}", "expected a JSON object"),
    "time": ({"positions": NUMBERS, "time": "now"}, '"time": seconds'),
    "ages": ({"positions": NUMBERS, "time": 1e300}, '"time": seconds'),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_message_is_refused_with_its_place(tmp_path: Path, name: str) -> None:
    content, words = WRONG[name]
    messages = replaced(1, lambda message: (message[0], message[1], content))
    with pytest.raises(hs.ScenarioError) as caught:
        hs.read_log(written(tmp_path / "log.mcap", messages))
    assert words in str(caught.value)
    assert "/joints" in str(caught.value)
    assert "secret" not in str(caught.value)


def test_other_files_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(messages: list[Message], words: str, **options: str) -> None:
        with pytest.raises(hs.ScenarioError, match=words):
            hs.read_log(written(tmp_path / "log.mcap", messages, **options))

    log = a_log()
    ticks = ticks_of(log)
    refused([m for m in ticks if m[0] != "/joints"], "got none of /joints")
    refused([], "got none of /commands, /joints")
    refused(ticks, "/joints: expected messages in JSON, got a different encoding", encoding="cdr")
    refused(ticks[:41], "at least 50 ticks, got 20")
    late = [(topic, time + (10**10 if topic == "/commands" else 0), content) for topic, time, content in ticks]
    refused(late, "got none before its end")
    gap = [(topic, time + (10**7 if tick > 60 else 0), content) for tick, (topic, time, content) in enumerate(ticks)]
    refused(gap, "resample the log")
    frames = frames_of(5, stamped=True)
    refused([*ticks, *frames, *frames_of(1, stamped=False)], '"exposure" in all messages or in none, got it in 5 of 6')
    refused([*ticks, *frames, ("/features", START, {"features": [1.0, 2.0]})], "the same number of points")
    refused([*ticks, ("/features", START, {"features": [1.0] * 34})], "1 to 16 points")
    refused([*ticks, ("/features", START, {"features": [1.0]})], "1 to 16 points")
    early = [(topic, time - 10**11, content) for topic, time, content in frames]
    refused([*ticks, *early], "/features: expected messages between the first of /commands .*, got 5 before or after")
    monkeypatch.setattr("hexservo.findings.identification.log.MAX_ROWS", 59)
    refused(ticks, "expected at most 59 messages")
    monkeypatch.setattr("hexservo.findings.identification.log.MAX_ROWS", 60)
    monkeypatch.setattr("hexservo.findings.identification.log.MAX_BYTES", 100_000)
    refused([*ticks, *[("/other", START, b" " * 5000)] * 40], "at most 100000 bytes after decompression")


def test_a_chunk_that_unpacks_to_more_than_it_states_is_not_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """64 MB of zeros are a few kB; what the chunk states is not trusted, and its limit holds."""
    from mcap.records import Chunk

    for compression in ("ZSTD", "LZ4"):
        path = written(tmp_path / "log.mcap", [("/joints", START, b" " * 3_000_000)], compression)
        assert path.stat().st_size < 20_000
        for size in (10, 2**62):
            with monkeypatch.context() as patch:

                def lying(stream: Any, size: int = size, original: Any = Chunk.read) -> Chunk:
                    chunk: Chunk = original(stream)
                    chunk.uncompressed_size = size
                    return chunk

                patch.setattr(Chunk, "read", staticmethod(lying))
                with pytest.raises(hs.ScenarioError, match="an MCAP file that is whole"):
                    hs.read_log(path)
    assert mcap_log.MAX_CHUNK < 1e8


def test_damaged_files_are_refused_or_read_whole(tmp_path: Path) -> None:
    """Bytes that are changed, cut off or inserted: the log of before, or a message; never another exception."""
    random = np.random.default_rng(SEED)
    print(f"seed {SEED}")
    log = a_log()
    path = tmp_path / "log.mcap"
    refusals = 0
    for compression in ("NONE", "LZ4", "ZSTD"):
        whole = written(path, ticks_of(log), compression).read_bytes()
        for trial in range(150):
            data = bytearray(whole)
            place = int(random.integers(len(data)))
            if trial % 3 == 0:
                del data[place:]
            elif trial % 3 == 1:
                for index in random.integers(len(data), size=int(random.integers(1, 5))):
                    data[index] = int(random.integers(256))
            else:
                data[place:place] = random.bytes(int(random.integers(1, 30)))
            path.write_bytes(data)
            try:
                found = hs.read_log(path)
            except hs.ScenarioError:
                refusals += 1
            else:
                np.testing.assert_array_equal(found.joints, log.joints)
    assert refusals > 300  # checksums: what is not refused was damaged outside of the messages
    for wrong in (b"", b"\x89MCAP0\r\n", b"time,command_1\n", bytes(random.bytes(5000))):
        path.write_bytes(wrong)
        with pytest.raises(hs.ScenarioError, match="an MCAP file that is whole"):
            hs.read_log(path)


def test_without_the_package_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "log.mcap", ticks_of(a_log()))
    for name in [name for name in sys.modules if name == "mcap" or name.startswith("mcap.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "mcap", None)
    with pytest.raises(hs.ScenarioError, match=r"pip install 'hexservo\[mcap\]'"):
        hs.read_log(path)
