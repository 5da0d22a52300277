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

import numpy as np
import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st

import streams
import xbus
from conftest import damaged_streams, read
from xbus._core import Acquisition, Received

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


def take(acquisition: Acquisition, size: int) -> bytes:
    """Returns this number of contiguous bytes."""
    data = b""
    while len(data) < size:
        taken = acquisition.read(LONG)
        assert taken is not None
        assert taken.data, "nothing came"
        assert taken.offset == len(data)
        assert taken.ends[-1] == len(taken.data)
        assert np.all(np.diff(taken.ends) > 0)
        assert np.all(np.diff(taken.arrivals) >= 0)
        data += taken.data
    return data


def test_nothing_is_lost_while_python_holds_its_lock(pty: tuple[int, str], tmp_path: Path) -> None:
    ours, name = pty
    data = streams.hr(60_000)
    with serial.Serial(name, 115200, timeout=0) as port:
        acquisition = Acquisition(port.fileno())
        acquisition.record(tmp_path / "log.mtb", head=streams.frame(0x0D))
        process = send(ours, data)
        hold_the_lock_while(process)
        queued = acquisition.stats()["queued_bytes"]
        assert queued > len(data) - PTY, "it came while no other thread could run"
        assert take(acquisition, len(data)) == data
        report = acquisition.stop_recording()
        acquisition.close()
    stats = acquisition.stats()
    counted = [
        stats[name] for name in ("bytes", "samples", "skipped_bytes", "dropped_bytes", "gaps")
    ]
    assert counted == [len(data), 60_000, 0, 0, 0]
    assert stats["quantities"][0x1060] == 60_000
    assert stats["quantities"][0x4040] + stats["quantities"][0x8040] == 60_000
    assert stats["overruns"] is None
    assert report == {
        "files": [tmp_path / "log.mtb"],
        "bytes": len(data),
        "frames": 60_000,
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
    acquisition.record(tmp_path / "log.mtb", rotate_bytes=10_000)
    data = streams.ahrs(400)
    for at in range(0, len(data), 1000):
        acquisition.push(data[at : at + 1000])
    acquisition.stop_recording()
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
    before = time.monotonic_ns()
    acquisition.push(b"one")
    acquisition.push(b"and two")
    after = time.monotonic_ns()
    taken = acquisition.read(0)
    assert taken is not None
    assert (taken.offset, taken.data, taken.ends.tolist()) == (0, b"oneand two", [3, 10])
    assert before <= taken.arrivals[0] <= taken.arrivals[1] <= after
    assert acquisition.stats()["last_arrival"] == taken.arrivals[1]


def test_a_full_queue_drops_the_oldest() -> None:
    acquisition = Acquisition(None, bound=1000)
    for byte in range(100):
        acquisition.push(bytes([byte]) * 100)
    taken = acquisition.read(0)
    assert taken is not None
    assert taken.offset == 9000
    assert taken.data == b"".join(bytes([byte]) * 100 for byte in range(90, 100))
    stats = acquisition.stats()
    assert (stats["dropped_bytes"], stats["most_queued_bytes"], stats["queued_bytes"]) == (
        9000,
        1000,
        0,
    )


def wait_for(acquisition: Acquisition, event: Callable[[], object]) -> object:
    """Returns what a waiting thread reads while something happens."""
    came: list[object] = []
    reader = threading.Thread(target=lambda: came.append(acquisition.read(LONG)))
    began = time.monotonic()
    reader.start()
    event()
    reader.join()
    assert time.monotonic() < began + LONG / 2
    return came[0]


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
        os.write(ours, b"still here")
        assert take(acquisition, 10) == b"still here"
        acquisition.close()
    assert (tmp_path / "log.mtb").read_bytes() == b"still here"


@given(damaged_streams(), st.integers(1, 300))
def test_statistics_match_a_log(data: bytes, size: int) -> None:
    acquisition = Acquisition(None)
    for at in range(0, len(data), size):
        acquisition.push(data[at : at + size])
    acquisition.end("the stream was used up")
    stats = acquisition.stats()
    log = read(data, limit=8185)
    for name, count in vars(log.stats).items():
        assert (sum(stats[name].values()) if name == "strings" else stats[name]) == count, name
    assert stats["strings"] == log.strings.counts
    packets = Counter[int]()
    for key in log:
        packets[log[key].data_id & 0xFFF0] += len(log[key])
    for data_id, unknown in log.unknown.items():
        packets[data_id & 0xFFF0] += len(unknown)
    assert stats["quantities"] == packets


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


@given(damaged_streams(), st.integers(1, 300), st.integers(0, 100), st.integers(1, 2000))
def test_recordings_hold_every_byte_in_whole_frames(
    data: bytes, size: int, skipped: int, rotate: int
) -> None:
    """For any input and any rotation the joined files are the input, from a frame on."""
    with tempfile.TemporaryDirectory() as folder:
        acquisition = Acquisition(None)
        acquisition.push(data[:skipped])
        acquisition.record(Path(folder, "log.mtb"), rotate_bytes=rotate, flush=0, times=False)
        for at in range(skipped, len(data), size):
            acquisition.push(data[at : at + size])
        report = acquisition.stop_recording()
        assert report is not None
        assert report["error"] is None
        logs = without_string_messages([Path(item).read_bytes() for item in report["files"]])
    joined = b"".join(logs)
    assert len(joined) == report["bytes"]
    assert data.endswith(joined)
    assert len(joined) >= len(data) - skipped
    frames = sum(read(log, limit=8185).stats.frames for log in logs)
    assert frames >= read(joined, limit=8185).stats.frames


def test_a_wait_ends_when_bytes_come(pty: tuple[int, str]) -> None:
    ours, name = pty
    with serial.Serial(name, timeout=0) as port:
        acquisition = Acquisition(port.fileno())
        came = wait_for(acquisition, lambda: os.write(ours, b"x"))
        assert isinstance(came, Received)
        assert (came.offset, came.data) == (0, b"x")
        acquisition.close()


def test_a_wait_ends_on_close(pty: tuple[int, str]) -> None:
    _, name = pty
    with serial.Serial(name, timeout=0) as port:
        acquisition = Acquisition(port.fileno())
        assert wait_for(acquisition, acquisition.close) is None
        assert acquisition.ended == "it was closed"


def test_a_wait_ends_when_the_port_is_gone() -> None:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    with serial.Serial(os.ttyname(theirs), timeout=0) as port:
        os.close(theirs)
        acquisition = Acquisition(port.fileno())
        assert wait_for(acquisition, lambda: os.close(ours)) is None
        assert acquisition.ended == "the port is gone: unplugged, or closed on the other side"


def test_queued_bytes_can_be_read_after_the_end() -> None:
    acquisition = Acquisition(None)
    acquisition.push(b"the last")
    acquisition.end("the pump failed")
    acquisition.end("for another reason")
    assert not acquisition.push(b"too late")
    taken = acquisition.read()
    assert taken is not None
    assert taken.data == b"the last"
    assert acquisition.read() is None
    assert acquisition.ended == "the pump failed"


def test_time_outs() -> None:
    acquisition = Acquisition(None)
    taken = acquisition.read(0.01)
    assert taken is not None
    assert taken.data == b""
    assert len(taken.ends) == len(taken.arrivals) == 0
    acquisition.push(b"abc")
    taken = acquisition.read(0.01, least=4)
    assert taken is not None
    assert taken.data == b"abc", "what there is when the time is up"
    with pytest.raises(ValueError, match="timeout must be a number of seconds, not -1"):
        acquisition.read(-1.0)


def test_another_port_can_follow(tmp_path: Path) -> None:
    acquisition = Acquisition(None)
    acquisition.record(tmp_path / "log.mtb")
    data = streams.ahrs(10)
    for _ in range(3):
        theirs, ours = os.pipe()
        if acquisition.ended is None:
            acquisition.end("not yet a port")
        acquisition.open(theirs)
        with pytest.raises(RuntimeError, match="a port is being read"):
            acquisition.open(theirs)
        os.close(theirs)
        os.write(ours, data)
        os.close(ours)
        taken = acquisition.read(LONG)
        assert taken is not None
        assert taken.data == data
        assert acquisition.read(LONG) is None
    assert acquisition.stats()["samples"] == 30
    acquisition.close()
    assert (tmp_path / "log.mtb").read_bytes() == data * 3
    report = acquisition.recording
    assert report is not None
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
    assert acquisition.stop_recording() is None
    acquisition.record(tmp_path / "log.mtb")
    with pytest.raises(RuntimeError, match="a recording is in progress"):
        acquisition.record(tmp_path / "log.mtb")
    with pytest.raises(OSError, match="Bad file descriptor") as bad:
        Acquisition(-1)
    assert bad.value.errno == errno.EBADF


# In separate processes


def run(code: str, *arguments: str, fd: int) -> subprocess.Popen[str]:
    """Starts a process that runs this code with a descriptor as input, and waits until it is ready."""
    command = [sys.executable, "-c", code, *arguments]
    process = subprocess.Popen(command, stdin=fd, stdout=subprocess.PIPE, text=True)  # noqa: S603
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


RECORD = """
import sys
from xbus._core import Acquisition
acquisition = Acquisition(0)
acquisition.record(sys.argv[1], flush=0.01)
print("ready", flush=True)
acquisition.read(least=1 << 30)
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
acquisition.record(sys.argv[1], head=sys.stdin.buffer.read(21))
print("ready", flush=True)
acquisition.push(sys.stdin.buffer.read())
report = acquisition.stop_recording()
print(report["bytes"], report["frames"], report["active"], report["error"])
"""


def test_a_full_disk_ends_the_recording_after_a_whole_frame(tmp_path: Path) -> None:
    head, data = streams.frame(0x0D, bytes(16)), streams.ahrs(1000)
    (tmp_path / "input").write_bytes(head + data)
    with (tmp_path / "input").open("rb") as file:
        process = run(FULL, str(tmp_path / "log.mtb"), fd=file.fileno())
    output, _ = process.communicate(timeout=LONG)
    whole = (50_000 - 21) // 88
    assert output.startswith(f"{whole * 88} {whole} False {tmp_path / 'log.mtb'}: File too large")
    assert output.endswith("the recording ends with the last whole frame\n")
    assert (tmp_path / "log.mtb").read_bytes() == head + data[: whole * 88]


WAIT = """
import sys
from xbus._core import Acquisition
acquisition = Acquisition(0)
try:
    print("ready", flush=True)
    acquisition.read()
except KeyboardInterrupt:
    print("heard", flush=True)
"""


def test_ctrl_c_interrupts_a_wait(pty: tuple[int, str]) -> None:
    _, name = pty
    with serial.Serial(name, timeout=0) as port:
        process = run(WAIT, fd=port.fileno())
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=LONG)
    assert output == "heard\n"


def test_the_reader_uses_little_cpu_time(pty: tuple[int, str]) -> None:
    """A thread with a busy loop would use a whole processor."""
    _, name = pty
    with serial.Serial(name, timeout=0) as port:
        acquisition = Acquisition(port.fileno())
        before = resource.getrusage(resource.RUSAGE_SELF)
        acquisition.read(0.3)
        after = resource.getrusage(resource.RUSAGE_SELF)
        acquisition.close()
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 0.15
