"""Acquisition and recording in Rust: nothing is lost while Python is busy, and every loss is counted."""

from __future__ import annotations

import errno
import os
import resource
import signal
import struct
import subprocess
import sys
import tempfile
import termios
import threading
import time
import tty
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st

import streams
import xbus
from conftest import counter, damaged_streams, read
from streams import packet
from xbus._core import Acquisition, Cancel, ScannedDamage, ScannedFrame, ScannedString

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs pseudo-terminals")

#: Seconds after which a test fails.
LONG = 30.0
#: Maximum number of bytes that a pseudo-terminal buffers.
PTY = 25_000


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    """The descriptor of one side of a pseudo-terminal, and the name of the other side."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    yield ours, os.ttyname(theirs)
    os.close(theirs)
    os.close(ours)


def send(fd: int, data: bytes) -> subprocess.Popen[bytes]:
    """Starts a process that writes the data as fast as the other side reads them."""
    code = (
        "import os, sys\n"
        "data = memoryview(sys.stdin.buffer.read())\n"
        "while data: data = data[os.write(1, data):]\n"
    )
    command = [sys.executable, "-c", code]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=fd)  # noqa: S603
    assert process.stdin is not None
    process.stdin.write(data)
    process.stdin.close()
    return process


def hold_the_lock_while(process: subprocess.Popen[bytes]) -> None:
    """Blocks other Python threads with an operation on integers that takes a second or more."""
    digits = 1_000_000
    began = time.monotonic()
    while process.poll() is None or time.monotonic() < began + 1:
        pow(3, digits)
        digits += digits // 2


def take(acquisition: Acquisition, count: int) -> bytes:
    """Returns the frames of this number of samples, which are adjacent in the stream."""
    deadline, frames, arrival = time.monotonic() + LONG, b"", 0.0
    for _ in range(count):
        while (sample := acquisition.take_sample()) is None:
            assert time.monotonic() < deadline
            assert acquisition.wait(LONG, samples=1)
        assert sample.offset == len(frames)
        assert sample.arrival >= arrival
        arrival = sample.arrival
        frames += xbus.encode_frame(0x36, sample.payload, bid=sample.bid)
    return frames


def test_nothing_is_lost_while_python_holds_its_lock(pty: tuple[int, str], tmp_path: Path) -> None:
    ours, name = pty
    data = streams.hr(60_000)
    with serial.Serial(name, 115200, timeout=0) as port:
        acquisition = Acquisition(port.fileno())
        recorder = acquisition.record(tmp_path / "log.mtb", head=streams.frame(0x0D))
        process = send(ours, data)
        hold_the_lock_while(process)
        waiting = acquisition.waiting.samples
        assert waiting * 27 > len(data) - PTY, "it came while no other thread could run"
        assert take(acquisition, 60_000) == data
        report = recorder.stop()
        acquisition.close()
    stats = acquisition.stats(time.monotonic())
    counts = stats["counts"]
    assert [counts[name] for name in ("bytes", "frames", "samples")] == [len(data), 60_000, 60_000]
    assert (counts["skipped_bytes"], counts["losses"]) == (0, {"samples": 0, "gaps": 0})
    assert counts["quantities"][0x1060] == 60_000
    assert counts["quantities"][0x4040] + counts["quantities"][0x8040] == 60_000
    assert stats["dropped"] == {"samples": 0, "strings": 0, "messages": 0}
    assert (stats["queued"], stats["unread"]) == (0, 0)
    assert stats["overruns"] is None
    assert report == {
        "files": [tmp_path / "log.mtb"],
        "bytes": len(data),
        "frames": 60_000,
        "samples": 60_000,
        "message_counts": {},
        "strings": 0,
        "queued_bytes": 0,
        "active": False,
        "error": None,
    }
    assert (tmp_path / "log.mtb").read_bytes() == streams.frame(0x0D) + data


def test_the_port_is_unchanged(pty: tuple[int, str]) -> None:
    ours, name = pty
    with serial.Serial(name, 115200, timeout=0) as port:
        blocking, settings = os.get_blocking(port.fileno()), termios.tcgetattr(port.fileno())
        acquisition = Acquisition(port.fileno())
        port.write(b"to the device")
        assert os.read(ours, 100) == b"to the device"
        assert os.get_blocking(port.fileno()) == blocking
        acquisition.close()
        assert termios.tcgetattr(port.fileno()) == settings
        os.write(ours, b"to the host")
        port.timeout = LONG
        assert port.read(11) == b"to the host", "the owner of the port reads the bytes"


def test_times(tmp_path: Path) -> None:
    acquisition = Acquisition(None)
    before = time.time_ns()
    recorder = acquisition.record(tmp_path / "log.mtb", rotate_bytes=10_000)
    data = streams.ahrs(400)
    for at in range(0, len(data), 1000):
        acquisition.push(data[at : at + 1000])
    recorder.stop()
    after = time.time_ns()
    logs = sorted(tmp_path.glob("*.mtb"), key=lambda path: (len(path.name), path.name))
    assert [log.name for log in logs] == ["log.mtb", "log-0001.mtb", "log-0002.mtb", "log-0003.mtb"]
    assert b"".join(log.read_bytes() for log in logs) == data
    for log in logs:
        assert xbus.read_log(log).stats.skipped_bytes == 0
        times = Path(f"{log}.times").read_bytes()
        header = struct.unpack_from("<8sIIq", times)
        assert header == (b"XBUSTIME", 1, 16, acquisition.epoch)
        records = np.frombuffer(times[24:], [("position", "<u8"), ("arrival", "<i8")])
        assert records["position"][-1] == log.stat().st_size
        assert np.all(np.diff(records["position"].astype("i8")) > 0)
        slack = 50_000_000  # the clock may be set a little while this runs
        assert (
            before - slack <= records["arrival"].min() <= records["arrival"].max() <= after + slack
        )


def test_arrivals_use_the_monotonic_clock() -> None:
    acquisition = Acquisition(None)
    data = streams.ahrs(2)
    before = time.monotonic_ns()
    acquisition.push(data[:100])
    acquisition.push(data[100:])
    after = time.monotonic_ns()
    one, other = acquisition.take_sample(), acquisition.take_sample()
    assert one is not None
    assert other is not None
    assert before / 1e9 <= one.arrival <= other.arrival <= after / 1e9
    assert before <= acquisition.stats(after / 1e9)["last_arrival"] <= after
    assert acquisition.waiting.last_sample == acquisition.waiting.last_arrival == other.arrival


def test_a_sample_arrives_with_its_last_byte() -> None:
    acquisition = Acquisition(None, epoch=5_000_000_000)
    data = streams.ahrs(3)
    for at, byte in enumerate(data):
        acquisition.push(bytes([byte]), at / 1000)
    arrivals = []
    while (sample := acquisition.take_sample()) is not None:
        arrivals.append(sample.arrival)
    assert arrivals == [0.087, 0.175, 0.263]
    assert acquisition.epoch == 5_000_000_000
    assert acquisition.waiting.last_arrival == 0.263


def test_arrivals_never_decrease() -> None:
    acquisition = Acquisition(None)
    for arrival in (2.0, 1.0, 3.0):
        acquisition.push(streams.ahrs(1), arrival)
    samples = [acquisition.take_sample() for _ in range(3)]
    assert [sample.arrival for sample in samples if sample is not None] == [2.0, 2.0, 3.0]


def numbered(count: int) -> list[bytes]:
    """Returns samples of 16 bytes."""
    return [streams.mtdata2(counter(at), packet(0x9990, bytes(3))) for at in range(count)]


def test_full_lanes_drop_the_oldest() -> None:
    acquisition = Acquisition(None, bound=160)
    string = xbus.encode_string("HCMTW", {"temperature": 25.0})
    for at, sample in enumerate(numbered(100)):
        acquisition.push(sample + string + streams.frame(0x43, bytes([at]) * 9))
    stats, waiting = acquisition.stats(0.0), acquisition.waiting
    kept = {"samples": waiting.samples, "strings": waiting.strings}
    assert kept == {"samples": 10, "strings": 160 // len(string)}
    assert stats["dropped"]["samples"] == waiting.dropped_samples == 90
    assert stats["dropped"]["strings"] == 100 - kept["strings"]
    samples = []
    while (taken := acquisition.take_sample()) is not None:
        samples.append(xbus.Sample(taken.payload)["packet_counter"])
    assert samples == list(range(90, 100))
    messages = [item for item in acquisition.take_events().items if item is not None]
    assert [item.payload[0] for item in messages if isinstance(item, ScannedFrame)] == list(
        range(100 - len(messages), 100)
    )
    assert stats["dropped"]["messages"] == 100 - len(messages)
    assert len(messages) == 5, "a mark of data before each is an entry, too"
    counts = stats["counts"]
    assert (counts["samples"], counts["messages"], counts["strings"]) == (100, 100, {"HCMTW": 100})
    assert acquisition.stats(0.0)["dropped"] == stats["dropped"]


def test_a_lane_keeps_its_newest_entry_of_any_size() -> None:
    acquisition = Acquisition(None, bound=1)
    acquisition.push(streams.ahrs(3))
    sample = acquisition.take_sample()
    assert sample is not None
    assert sample.offset == 176
    assert acquisition.take_sample() is None


def test_what_is_cleared_is_not_dropped() -> None:
    acquisition = Acquisition(None)
    acquisition.push(streams.ahrs(3) + xbus.encode_string("HEHDT", {"heading": 1.0}))
    assert acquisition.clear_data() == 4
    assert acquisition.clear_data() == 0
    stats = acquisition.stats(0.0)
    assert stats["dropped"] == {"samples": 0, "strings": 0, "messages": 0}
    assert (stats["queued"], stats["unread"], stats["counts"]["samples"]) == (0, 0, 3)
    assert acquisition.take_sample() is None
    assert acquisition.take_string() is None


def test_half_a_frame_waits() -> None:
    """A message inside it is found early, once, and does not change what the whole is."""
    inner = streams.frame(0x31)
    sample = streams.frame(0x36, packet(0x9990, inner + bytes(7)))
    acquisition = Acquisition(None)
    acquisition.push(sample[:13], 1.0)
    assert acquisition.take_events().items == []
    (early,) = acquisition.take_events(early=True).items
    assert isinstance(early, ScannedFrame)
    assert (early.mid, early.offset) == (0x31, sample.index(inner))
    assert acquisition.take_events(early=True).items == []
    assert acquisition.take_sample() is None
    acquisition.push(sample[13:], 9.0)
    whole = acquisition.take_sample()
    assert whole is not None
    assert (xbus.encode_frame(0x36, whole.payload), whole.arrival) == (sample, 9.0)
    assert acquisition.take_events(early=True).items == [None]
    counts = acquisition.stats(9.0)["counts"]
    assert (counts["messages"], counts["samples"], counts["skipped_bytes"]) == (0, 1, 0)


def test_an_interrupted_frame_is_damage() -> None:
    acquisition = Acquisition(None)
    data = streams.ahrs(2)
    acquisition.push(data[:50])
    acquisition.interrupt()
    acquisition.push(data[88:])
    (damage, mark) = acquisition.take_events().items
    assert isinstance(damage, ScannedDamage)
    assert (damage.offset, damage.length, mark) == (0, 50, None)
    sample = acquisition.take_sample()
    assert sample is not None
    assert sample.offset == 50


def test_everything_in_order() -> None:
    acquisition = Acquisition(None)
    string = xbus.encode_string("HEHDT", {"heading": 1.0})
    pieces = [streams.ahrs(1), b"??", streams.frame(0x3E), string, streams.ahrs(1)]
    acquisition.push(b"".join(pieces))
    items = acquisition.take_all()
    assert items is not None
    kinds = [ScannedFrame, ScannedDamage, ScannedFrame, ScannedString, ScannedFrame]
    assert [type(item) for item in items] == kinds
    assert [item.offset for item in items] == [0, 88, 90, 95, 95 + len(string)]
    assert acquisition.take_all() == []
    assert acquisition.waiting.events_added > 0
    acquisition.end("over")
    assert acquisition.take_all() is None


def test_frames_of_another_device_are_only_counted() -> None:
    acquisition = Acquisition(None, bid=2)
    for bid in (1, 2, 3, 0xFF):
        acquisition.push(streams.mtdata2(counter(bid), bid=bid) + streams.frame(0x3E, bid=bid))
    samples = [acquisition.take_sample() for _ in range(3)]
    assert [None if sample is None else sample.bid for sample in samples] == [2, 0xFF, None]
    messages = [
        item.bid for item in acquisition.take_events().items if isinstance(item, ScannedFrame)
    ]
    assert (messages, acquisition.bid) == ([2, 0xFF], 2)
    counts = acquisition.stats(0.0)["counts"]
    assert (counts["samples"], counts["messages"]) == (4, 4)


def wait_for(acquisition: Acquisition, event: Callable[[], object], **need: Any) -> object:
    """Returns what a waiting thread returns while something happens."""
    ended: list[object] = []
    waiter = threading.Thread(target=lambda: ended.append(acquisition.wait(LONG, **need)))
    began = time.monotonic()
    waiter.start()
    event()
    waiter.join()
    assert time.monotonic() < began + LONG / 2
    return ended[0]


def test_a_fork_does_not_affect_the_threads(pty: tuple[int, str], tmp_path: Path) -> None:
    ours, name = pty
    with serial.Serial(name, timeout=0) as port:
        acquisition = Acquisition(port.fileno())
        acquisition.record(tmp_path / "log.mtb")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # forking with threads warns
            child = os.fork()
        if child == 0:
            del acquisition
            os._exit(0)
        assert os.waitpid(child, 0) == (child, 0)
        data = streams.ahrs(10)
        os.write(ours, data)
        assert take(acquisition, 10) == data
        acquisition.close()
    assert (tmp_path / "log.mtb").read_bytes() == data


@given(damaged_streams(), st.integers(1, 300))
def test_statistics_match_a_log(data: bytes, size: int) -> None:
    acquisition = Acquisition(None)
    for at in range(0, len(data), size):
        acquisition.push(data[at : at + size])
    acquisition.end("the stream was used up")
    counts = acquisition.stats(time.monotonic())["counts"]
    log = read(data, limit=8185)
    assert counts["strings"] == log.strings.counts
    assert counts["losses"] == {"samples": log.stats.lost_samples, "gaps": log.stats.gaps}
    for name in vars(log.stats).keys() - {"strings", "lost_samples", "gaps"}:
        assert counts[name] == getattr(log.stats, name), name
    assert sum(counts["strings"].values()) == log.stats.strings
    packets = Counter[int]()
    for key in log:
        packets[log[key].data_id & 0xFFF0] += len(log[key])
    for data_id, unknown in log.unknown.items():
        packets[data_id & 0xFFF0] += len(unknown)
    assert counts["quantities"] == packets


def without_string_messages(logs: list[bytes]) -> list[bytes]:
    """Removes the message that each file begins with after EM1000 was enabled: the last one about strings."""
    bodies, head = [], b""
    for log in logs:
        assert log.startswith(head)
        body = log[len(head) :]
        bodies.append(body)
        for message in read(body, limit=8185).messages:
            if message.mid == 0x8F and len(message.payload) in (2, 6):
                types = int.from_bytes(
                    message.payload[: 2 if len(message.payload) == 2 else 4], "big"
                )
                if head or types & xbus.StringType.EM1000:
                    length = len(message.payload) + (7 if body[message.offset + 3] == 0xFF else 5)
                    head = body[message.offset : message.offset + length]
    return bodies


@given(
    damaged_streams(), st.integers(1, 300), st.integers(0, 100), st.integers(1, 2000), st.booleans()
)
def test_recordings_hold_every_byte_in_whole_frames(
    data: bytes, size: int, skipped: int, rotate: int, ends: bool
) -> None:
    """For any input and any rotation the joined files are the input, from a frame on.

    A recording that is stopped ends with the last decided byte; with the stream, it ends with the last byte.
    """
    with tempfile.TemporaryDirectory() as folder:
        acquisition = Acquisition(None)
        acquisition.push(data[:skipped])
        before = acquisition.stats(0.0)["counts"]["frames"]
        recorder = acquisition.record(
            Path(folder, "log.mtb"), rotate_bytes=rotate, flush=0, times=False
        )
        for at in range(skipped, len(data), size):
            acquisition.push(data[at : at + size])
        if ends:
            acquisition.end("over")
        frames = acquisition.stats(0.0)["counts"]["frames"] - before
        report = recorder.stop()
        assert (report["error"], report["frames"]) == (None, frames)
        acquisition.push(data)
        acquisition.end("over")
        logs = without_string_messages([Path(item).read_bytes() for item in report["files"]])
    joined = b"".join(logs)
    assert len(joined) == report["bytes"]
    if ends:
        assert data.endswith(joined)
        assert len(joined) >= len(data) - skipped
    else:
        assert joined in data
        # The rest is one incomplete frame or string, which may look like several.
        rest = data[data.rindex(joined) + len(joined) :]
        assert len(rest) <= 8192
        found = read(joined + rest, limit=8185).stats
        assert found.frames >= frames
    found_frames = sum(read(log, limit=8185).stats.frames for log in logs)
    assert found_frames >= read(joined, limit=8185).stats.frames
    assert found_frames >= frames


def test_a_recording_that_is_stopped_ends_with_a_whole_frame(tmp_path: Path) -> None:
    data = streams.ahrs(3)
    acquisition = Acquisition(None)
    acquisition.push(data[:44])
    recorder = acquisition.record(tmp_path / "one.mtb")
    acquisition.push(data[44:200])
    assert recorder.stop()["active"] is False
    assert acquisition.recording is None
    recorder = acquisition.record(tmp_path / "two.mtb")
    acquisition.push(data[200:260])
    acquisition.end("over")
    report = recorder.stop()
    assert (report["bytes"], report["frames"]) == (260 - 176, 0)
    assert (tmp_path / "one.mtb").read_bytes() == data[:176]
    assert (tmp_path / "two.mtb").read_bytes() == data[176:260]


def test_a_wait_ends_when_samples_arrive(pty: tuple[int, str]) -> None:
    ours, name = pty
    data = streams.ahrs(2)
    with serial.Serial(name, timeout=0) as port:
        acquisition = Acquisition(port.fileno())
        assert not acquisition.wait(0.01, samples=1)
        assert wait_for(acquisition, lambda: os.write(ours, data), samples=2) is True
        assert acquisition.waiting.samples == 2
        acquisition.close()


def test_a_wait_is_for_one_kind() -> None:
    """It ends with the first of what it is for, and with nothing else."""
    acquisition = Acquisition(None)
    string = xbus.encode_string("HEHDT", {"heading": 1.0})
    seen = acquisition.take_events().added
    assert not acquisition.wait(0, samples=1, strings=True, events=seen)
    acquisition.push(string)
    assert acquisition.wait(0, strings=True)
    assert not acquisition.wait(0.01, samples=1)
    assert acquisition.wait(0, events=seen), "a mark that data has come"
    seen = acquisition.take_events().added
    acquisition.push(string)
    assert not acquisition.wait(0, events=seen), "the next string is no event"
    acquisition.push(streams.frame(0x3E))
    assert acquisition.wait(0, events=seen)
    assert not acquisition.wait(0)
    assert acquisition.waiting.strings == 2


def test_a_wait_ends_on_close(pty: tuple[int, str]) -> None:
    _, name = pty
    with serial.Serial(name, timeout=0) as port:
        acquisition = Acquisition(port.fileno())
        assert wait_for(acquisition, acquisition.close) is True
        assert acquisition.ended == "it was closed"


def test_a_wait_ends_when_it_is_cancelled() -> None:
    acquisition, cancel = Acquisition(None), Cancel()
    assert not cancel.is_set
    assert (
        wait_for(acquisition, lambda: acquisition.cancel(cancel), samples=1, cancel=cancel) is True
    )
    assert cancel.is_set
    assert acquisition.ended is None
    assert acquisition.wait(LONG, samples=1, cancel=cancel)
    assert not acquisition.wait(0, samples=1, cancel=Cancel())


def test_a_wait_ends_when_the_port_is_gone() -> None:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    with serial.Serial(os.ttyname(theirs), timeout=0) as port:
        os.close(theirs)
        acquisition = Acquisition(port.fileno())
        assert wait_for(acquisition, lambda: os.close(ours), samples=1) is True
        assert acquisition.ended == "the port is gone: unplugged, or closed on the other side"


def test_what_waits_can_be_taken_after_the_end() -> None:
    acquisition = Acquisition(None)
    data = streams.ahrs(2)
    acquisition.push(data[:100])
    acquisition.end("the pump failed")
    acquisition.end("for another reason")
    assert not acquisition.push(data)
    sample = acquisition.take_sample()
    assert sample is not None
    assert xbus.encode_frame(0x36, sample.payload) == data[:88]
    (_, damage) = acquisition.take_events().items
    assert isinstance(damage, ScannedDamage)
    assert (damage.offset, damage.length) == (88, 12)
    assert acquisition.take_sample() is None
    assert acquisition.take_all() is None
    assert acquisition.ended == "the pump failed"
    assert acquisition.wait(LONG, samples=5), "no more will come"
    acquisition.resume()
    with pytest.raises(RuntimeError, match="the stream has not ended"):
        acquisition.resume()
    assert acquisition.push(data[:88])
    again = acquisition.take_sample()
    assert again is not None
    assert again.offset == 100


def test_time_outs() -> None:
    acquisition = Acquisition(None)
    began = time.monotonic()
    assert not acquisition.wait(0.05, samples=1)
    acquisition.push(streams.ahrs(1))
    assert not acquisition.wait(0.05, samples=2)
    assert 0.1 <= time.monotonic() - began < LONG / 2
    for timeout in (-1.0, float("nan")):
        with pytest.raises(ValueError, match="timeout must be a number of seconds, not"):
            acquisition.wait(timeout)


def test_a_wait_for_more_than_fits_ends_when_the_lane_is_full() -> None:
    acquisition = Acquisition(None, bound=880)
    ended: list[bool] = []
    waiter = threading.Thread(target=lambda: ended.append(acquisition.wait(LONG, samples=100)))
    waiter.start()
    while waiter.is_alive():  # the wait may begin when the lane is full already
        acquisition.push(streams.ahrs(11))
    assert ended == [True]
    assert acquisition.waiting.samples == 10


def test_another_port_can_follow(tmp_path: Path) -> None:
    acquisition = Acquisition(None)
    recorder = acquisition.record(tmp_path / "log.mtb")
    data = streams.ahrs(10)
    for turn in range(3):
        theirs, ours = os.pipe()
        if acquisition.ended is None:
            acquisition.end("not yet a port")
        acquisition.open(theirs)
        with pytest.raises(RuntimeError, match="a port is being read"):
            acquisition.open(theirs)
        os.close(theirs)
        os.write(ours, data)
        os.close(ours)
        assert acquisition.wait(LONG, samples=10)
        samples = [acquisition.take_sample() for _ in range(10)]
        offsets = [sample.offset for sample in samples if sample is not None]
        assert offsets == [880 * turn + 88 * at for at in range(10)]
        assert acquisition.wait(LONG, samples=1)
        assert acquisition.take_sample() is None
        assert acquisition.ended is not None
    assert acquisition.stats(0.0)["counts"]["samples"] == 30
    acquisition.close()
    assert (tmp_path / "log.mtb").read_bytes() == data * 3
    report = recorder.state
    assert (report["active"], report["frames"]) == (False, 30)


def test_invalid_arguments_are_rejected(tmp_path: Path) -> None:
    acquisition = Acquisition(None)
    with pytest.raises(FileNotFoundError) as failed:
        acquisition.record(tmp_path / "no" / "log.mtb")
    assert failed.value.filename == str(tmp_path / "no" / "log.mtb")
    with pytest.raises(ValueError, match="must be greater than 0"):
        acquisition.record(tmp_path / "log.mtb", rotate_bytes=0)
    with pytest.raises(ValueError, match="flush must be a number of seconds, not NaN"):
        acquisition.record(tmp_path / "log.mtb", flush=float("nan"))
    assert acquisition.recording is None
    acquisition.record(tmp_path / "log.mtb")
    with pytest.raises(RuntimeError, match="a recording is in progress"):
        acquisition.record(tmp_path / "log.mtb")
    with pytest.raises(OSError, match="Bad file descriptor") as bad:
        Acquisition(-1)
    assert bad.value.errno == errno.EBADF


# In separate processes


def run(code: str, *arguments: str, fd: int) -> subprocess.Popen[bytes]:
    """Starts a process that runs this code with a descriptor as input, and waits until it is ready.

    Its output has no buffer: `communicate` would not return what `readline` has read ahead.
    """
    command = [sys.executable, "-c", code, *arguments]
    process = subprocess.Popen(command, stdin=fd, stdout=subprocess.PIPE, bufsize=0)  # noqa: S603
    assert process.stdout is not None
    assert process.stdout.readline() == b"ready\n"
    return process


RECORD = """
import sys
from xbus._core import Acquisition
acquisition = Acquisition(0)
acquisition.record(sys.argv[1], flush=0.01)
print("ready", flush=True)
acquisition.wait(1000, samples=1 << 30)
"""


@pytest.mark.parametrize("packets", [1000, 5003, 9001])
def test_a_killed_recording_is_a_valid_log(
    pty: tuple[int, str], tmp_path: Path, packets: int
) -> None:
    ours, name = pty
    data = streams.ahrs(12_000)
    cut = packets * 88 + packets % 88
    with serial.Serial(name, timeout=0) as port:
        process = run(RECORD, str(tmp_path / "log.mtb"), fd=port.fileno())
        sent = send(ours, data[:cut])
        assert sent.wait(LONG) == 0
        deadline = time.monotonic() + LONG
        while (size := (tmp_path / "log.mtb").stat().st_size) < cut - PTY:
            assert time.monotonic() < deadline
        process.kill()
        process.communicate(timeout=LONG)
    recorded = (tmp_path / "log.mtb").read_bytes()
    assert len(recorded) >= size
    assert data.startswith(recorded)
    log = xbus.read_log(tmp_path / "log.mtb")
    assert (len(log), log.stats.skipped_bytes) == divmod(len(recorded), 88)


FULL = """
import resource, sys
from xbus._core import Acquisition
resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
acquisition = Acquisition(None)
recorder = acquisition.record(sys.argv[1], head=sys.stdin.buffer.read(21))
print("ready", flush=True)
acquisition.push(sys.stdin.buffer.read())
report = recorder.stop()
print(report["bytes"], report["frames"], report["active"], report["error"])
"""


def test_a_full_disk_ends_the_recording_after_a_whole_frame(tmp_path: Path) -> None:
    head, data = streams.frame(0x0D, bytes(16)), streams.ahrs(1000)
    (tmp_path / "input").write_bytes(head + data)
    with (tmp_path / "input").open("rb") as file:
        process = run(FULL, str(tmp_path / "log.mtb"), fd=file.fileno())
    output, _ = process.communicate(timeout=LONG)
    whole = (50_000 - 21) // 88
    printed = output.decode()
    assert printed.startswith(f"{whole * 88} {whole} False {tmp_path / 'log.mtb'}: File too large")
    assert printed.endswith("the recording ends with the last whole frame\n")
    assert (tmp_path / "log.mtb").read_bytes() == head + data[: whole * 88]


WAIT = """
import sys
from xbus._core import Acquisition
acquisition = Acquisition(0)
try:
    print("ready", flush=True)
    acquisition.wait(1000, samples=1)
except KeyboardInterrupt:
    print("heard", flush=True)
"""


def test_ctrl_c_interrupts_a_wait(pty: tuple[int, str]) -> None:
    _, name = pty
    with serial.Serial(name, timeout=0) as port:
        process = run(WAIT, fd=port.fileno())
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=LONG)
    assert output == b"heard\n"


def test_the_reader_uses_little_cpu_time(pty: tuple[int, str]) -> None:
    """A thread with a busy loop would use a whole processor."""
    _, name = pty
    with serial.Serial(name, timeout=0) as port:
        acquisition = Acquisition(port.fileno())
        before = resource.getrusage(resource.RUSAGE_SELF)
        acquisition.wait(0.3, samples=1)
        after = resource.getrusage(resource.RUSAGE_SELF)
        acquisition.close()
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 0.15
