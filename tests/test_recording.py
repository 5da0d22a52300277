"""Recordings of devices: the files hold every received byte, whatever happens to the program."""

from __future__ import annotations

import os
import random
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xbus
from xbus import Device, Faults, SimulatedDevice
from xbus.protocol import State
from xbus.sim import PtyServer, serve, serving

#: Seconds after which a test fails.
LONG = 60.0
FASTEST = {
    "packet_counter": None,
    "sample_time_fine": None,
    "acceleration_hr": 2000,
    "rate_of_turn_hr": 1600,
}

posix = pytest.mark.skipif(os.name != "posix", reason="needs pseudo-terminals and signals")


def noted(device: SimulatedDevice) -> bytearray:
    """Returns a buffer that collects everything that the device sends."""
    sent = bytearray()
    read = device.read

    def note(*args: Any, **options: Any) -> bytes:
        data = read(*args, **options)
        sent.extend(data)
        return data

    device.read = note  # type: ignore[method-assign]
    return sent


@contextmanager
def measuring(how: str) -> Iterator[tuple[Device, bytearray]]:
    """Yields a device at its highest rates, in this process or behind a port, and what it sends."""
    virtual = SimulatedDevice("MTi-680G")
    sent = noted(virtual)
    if how == "in process":
        with xbus.connect(virtual) as device, device.configure(FASTEST, check_baudrate=False):
            pass
        with xbus.connect(virtual) as device:
            yield device, sent
    else:
        with serving(virtual, tcp=how == "tcp") as port, xbus.connect(port) as device:
            with device.configure(FASTEST, check_baudrate=False):
                pass
            yield device, sent


HOW = ["in process", pytest.param("pty", marks=posix), "tcp"]


def parted(path: Path | str) -> tuple[bytes, bytes]:
    """Splits a file into its head and the received bytes."""
    data = Path(path).read_bytes()
    scanner = xbus.Scanner()
    first, second = scanner.feed(data)[:2]
    assert isinstance(first, xbus.Message)
    assert isinstance(second, xbus.Message)
    assert [first.name, second.name] == ["Configuration", "EmtsData"]
    head = xbus.encode_frame(first.mid, first.payload) + xbus.encode_frame(
        second.mid, second.payload
    )
    assert data.startswith(head)
    return head, data[len(head) :]


def wait_until(condition: Callable[[], object]) -> None:
    never, deadline = threading.Event(), time.monotonic() + LONG
    while not condition():
        assert time.monotonic() < deadline
        never.wait(0.002)


# Content of the files


@pytest.mark.parametrize("how", HOW)
def test_the_file_holds_every_received_byte(tmp_path: Path, how: str) -> None:
    path = tmp_path / "log.mtb"
    with measuring(how) as (device, sent):
        with device.record(path) as recording:
            device.discard()
            read = sum(len(next(device.blocks(samples=500))) for _ in range(3))
        assert recording.files == [str(path)]
        assert not recording.is_active
        stats = device.stats
        assert (stats.dropped_samples, stats.dropped_messages) == (0, 0)
    _, body = parted(path)
    assert recording.bytes == len(body)
    assert body.startswith(xbus.encode_frame(0x11)), "it begins while the device waits for it"
    assert body in sent
    assert sent.endswith(body) or how != "in process", "behind a port it goes on sending"
    log = xbus.read_log(path)
    assert len(log) >= read == 1500
    assert (log.stats.lost_samples, log.stats.skipped_bytes) == (0, 0)
    assert (log.product_code, log.device_id) == ("MTi-680G-8A1G6", device.device_id)


def test_the_file_holds_the_recording_date(tmp_path: Path) -> None:
    before = datetime.now() - timedelta(seconds=1)
    with xbus.connect("sim:MTi-300") as device, device.record(tmp_path / "log.mtb"):
        next(device.blocks(samples=10))
    message = xbus.read_log(tmp_path / "log.mtb").messages[0]
    when = datetime.strptime(message.payload[16:30].decode(), "%Y%m%d%H%M%S")
    assert before <= when <= datetime.now()
    assert message.payload[30:32].isdigit()


def test_rotation_by_size(tmp_path: Path) -> None:
    with measuring("in process") as (device, sent):
        with device.record(tmp_path / "log.mtb", rotate_bytes=20_000) as recording:
            next(device.blocks(samples=3000))
        bodies = []
        for file in recording.files:
            head, body = parted(file)
            assert head == parted(tmp_path / "log.mtb")[0]
            assert len(head) + len(body) < 20_000 + 100
            bodies.append(body)
            assert xbus.read_log(file).stats.skipped_bytes == 0
    assert [Path(file).name for file in recording.files[:3]] == [
        "log.mtb",
        "log-0001.mtb",
        "log-0002.mtb",
    ]
    assert len(bodies) > 3
    assert sent.endswith(b"".join(bodies))


@posix
def test_rotation_by_time(tmp_path: Path) -> None:
    with (
        measuring("pty") as (device, sent),
        device.record(tmp_path / "log.mtb", rotate_seconds=0.1) as recording,
    ):
        wait_until(lambda: len(recording.files) >= 3)
    assert b"".join(parted(file)[1] for file in recording.files) in sent
    for file in recording.files[:-1]:
        assert 0.05 < xbus.read_log(file).duration < 1


@posix
def test_times_beside_the_file(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    before = time.time_ns()
    with measuring("pty") as (device, _):
        with device.record(path):
            next(device.blocks(samples=1000))
        epoch = device.link.acquisition.epoch
    after = time.time_ns()
    times = (tmp_path / "log.mtb.times").read_bytes()
    assert struct.unpack_from("<8sIIq", times) == (b"XBUSTIME", 1, 16, epoch)
    records = np.frombuffer(times[24:], [("position", "<u8"), ("arrival", "<i8")])
    assert len(records) > 5
    assert records["position"][-1] == path.stat().st_size
    assert np.all(np.diff(records["position"].astype("i8")) > 0)
    assert np.all(np.diff(records["arrival"]) >= 0)
    slack = 50_000_000  # the clock may be set a little while this runs
    assert before - slack <= records["arrival"][0] <= records["arrival"][-1] <= after + slack


def test_no_times(tmp_path: Path) -> None:
    with xbus.connect("sim:MTi-3") as device, device.record(tmp_path / "log.mtb", times=False):
        next(device.blocks(samples=10))
    assert [path.name for path in tmp_path.iterdir()] == ["log.mtb"]


# During a recording


def test_commands_work_while_recording(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    with measuring("in process") as (device, sent), device.record(path):
        for _ in range(3):
            next(device.blocks(samples=100))
            with device.configure():
                device.commands.req_output_configuration()
        next(device.blocks(samples=100))
    log = xbus.read_log(path)
    names = [message.name for message in log.messages]
    assert names.count("GoToConfigAck") == names.count("GoToMeasurementAck") - 1 == 3
    assert log.stats.skipped_bytes == 0
    assert sent.endswith(parted(path)[1])


def test_only_one_recording_at_a_time(tmp_path: Path) -> None:
    with xbus.connect("sim:MTi-630") as device:
        with device.record(tmp_path / "one.mtb") as recording:
            with pytest.raises(RuntimeError, match="a recording is in progress"):
                device.record(tmp_path / "two.mtb")
            assert recording.is_active
            assert device.state == State.MEASUREMENT
            device.discard()
            next(device.blocks(samples=10))
        with device.record(tmp_path / "two.mtb"):
            device.discard()
            next(device.blocks(samples=10))
    assert len(xbus.read_log(tmp_path / "one.mtb")) >= 10
    assert len(xbus.read_log(tmp_path / "two.mtb")) >= 10


@posix
def test_recording_needs_no_reader(tmp_path: Path) -> None:
    with measuring("pty") as (device, sent):
        with device.record(tmp_path / "log.mtb", flush=0.01) as recording:
            wait_until(lambda: recording.bytes > 30_000)
        stats = device.stats
        assert stats.unread_samples > 30_000 // 40, "they wait for a reader"
        assert (stats.dropped_samples, stats.dropped_messages) == (0, 0)
    assert parted(tmp_path / "log.mtb")[1] in sent


def test_a_recording_leaves_the_unread_samples(tmp_path: Path) -> None:
    with xbus.connect("sim:MTi-630") as device:
        device.listen(1)
        before = device.stats
        assert before.unread_samples == before.samples > 90
        with device.record(tmp_path / "log.mtb"):
            assert device.stats.unread_samples >= before.unread_samples
            counters = [device.read_sample()["packet_counter"] for _ in range(before.samples)]
            assert np.unique(np.diff(counters)).tolist() == [1]
        assert device.stats.dropped_samples == device.stats.outdated == 0


def test_closing_the_device_ends_the_recording(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    virtual = SimulatedDevice("MTi-630")
    sent = noted(virtual)
    device = xbus.connect(virtual)
    recording = device.record(path)
    next(device.blocks(samples=10))
    device.close()
    assert not recording.is_active
    assert recording.error is None
    recording.stop()
    recording.stop()
    _, body = parted(path)
    assert sent.endswith(body)
    assert recording.bytes == len(body)


@posix
def test_recording_continues_after_a_reconnect(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    virtual = SimulatedDevice("MTi-680G")
    sent = noted(virtual)
    done = threading.Event()
    with PtyServer(virtual, link=tmp_path / "port") as server:
        thread = threading.Thread(target=serve, args=(server, done.is_set))
        thread.start()
        try:
            with xbus.connect(str(tmp_path / "port"), reconnect=True) as device:
                with device.record(path):
                    next(device.blocks(samples=100))
                    virtual.faults = Faults(unplug=(virtual.time, 0.5))
                    while not any(notice.name == "Reconnected" for notice in device.notices):
                        next(device.blocks(samples=10))
                    next(device.blocks(samples=50))
                assert device.stats.samples > 150
        finally:
            done.set()
            thread.join()
    log = xbus.read_log(path)
    assert len(log) > 100  # some came before the recording
    assert sum(message.name == "GoToMeasurementAck" for message in log.messages) >= 2
    assert log.stats.skipped_bytes < 100
    assert len(parted(path)[1]) < len(sent)


# Faults


def test_files_that_cannot_be_created(tmp_path: Path) -> None:
    (tmp_path / "closed").mkdir(mode=0o500)
    wrong: dict[str, type[OSError]] = {"no/log.mtb": FileNotFoundError, ".": IsADirectoryError}
    if hasattr(os, "geteuid") and os.geteuid() != 0:
        wrong["closed/log.mtb"] = PermissionError
    with xbus.connect("sim:MTi-630") as device:
        for name, error in wrong.items():
            with pytest.raises(error):
                device.record(tmp_path / name)
        assert device.state == State.MEASUREMENT
        device.discard()
        with device.record(tmp_path / "log.mtb"):
            next(device.blocks(samples=10))
    assert len(xbus.read_log(tmp_path / "log.mtb")) >= 10


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_disk_that_is_already_full() -> None:
    with xbus.connect("sim:MTi-630") as device, pytest.raises(OSError, match="No space left"):
        device.record("/dev/full", times=False)


FULL = """
import resource, sys, xbus
resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
with xbus.connect("sim:MTi-630") as device:
    recording = device.record(sys.argv[1], times=False)
    while recording.is_active:
        next(device.blocks(samples=100))
    print(recording.bytes, recording.error)
    try:
        recording.stop()
    except OSError as error:
        print(error)
    recording.stop()
    print(next(device.blocks(samples=100))["packet_counter"].values.size)
"""


@posix
def test_a_disk_that_fills(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    command = [sys.executable, "-c", FULL, str(path)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, timeout=LONG, check=True)  # noqa: S603
    first, second, third = done.stdout.splitlines()
    _, body = parted(path)
    size, _, error = first.partition(" ")
    assert int(size) == len(body)
    assert error.startswith(f"{path}: File too large")
    assert second == f"the recording ended early: {error}"
    assert third == "100", "the device continues"
    log = xbus.read_log(path)
    assert (log.stats.lost_samples, log.stats.skipped_bytes) == (0, 0)
    assert 49_900 < path.stat().st_size <= 50_000


KILLED = """
import sys, threading, xbus
from xbus.sim import PtyServer, serve, serving
with serving(xbus.SimulatedDevice("MTi-680G")) as port, xbus.connect(port) as device:
    with device.configure({"packet_counter": None, "acceleration_hr": 2000}, check_baudrate=False):
        device.record(sys.argv[1], flush=0.02)
    threading.Event().wait()
"""


@posix
@pytest.mark.parametrize("seed", range(4))
def test_killed(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "log.mtb"
    enough = random.Random(seed).randrange(2_000, 60_000)
    with subprocess.Popen([sys.executable, "-c", KILLED, str(path)]) as process:  # noqa: S603
        try:
            wait_until(lambda: path.exists() and path.stat().st_size > enough)
            size = path.stat().st_size
        finally:
            process.kill()
    assert path.stat().st_size >= size
    parted(path)
    log = xbus.read_log(path)
    assert len(log) > (enough - 1500) / 30
    assert log.stats.lost_samples == 0
    cut = log.stats.skipped_bytes
    assert cut < 30, "at most the last frame is not whole"
    assert log.damage["offset"].tolist() == ([path.stat().st_size - cut] if cut else [])


def test_existing_recordings_are_not_overwritten(tmp_path: Path) -> None:
    """Empty files are overwritten; a number that is in use is skipped."""
    path = tmp_path / "log.mtb"
    path.touch()
    taken = tmp_path / "log-0001.mtb"
    taken.write_bytes(b"yesterday's")
    with xbus.connect("sim:MTi-3") as device:
        with device.record(path, rotate_bytes=2000) as recording:
            while len(recording.files) < 3:
                device.read_sample()
        names = [Path(file).name for file in recording.files]
        assert names == ["log.mtb", *(f"log-{i:04}.mtb" for i in range(2, len(names) + 1))]
        assert taken.read_bytes() == b"yesterday's"
        before = path.read_bytes()
        with pytest.raises(FileExistsError):
            device.record(path)
        assert path.read_bytes() == before
        with device.record(path, overwrite=True, rotate_bytes=2000) as recording:
            while len(recording.files) < 2:
                device.read_sample()
        assert taken.read_bytes() != b"yesterday's"
        with device.record(os.devnull, times=False):
            device.read_sample()


@pytest.mark.skipif(os.name != "posix", reason="other systems do not remove open files")
def test_a_failed_recording_does_not_control_the_next_one(tmp_path: Path) -> None:
    device = xbus.connect("sim:MTi-630")
    (tmp_path / "a").mkdir()
    failed = device.record(tmp_path / "a/log.mtb", flush=0, times=False)
    device.listen(1)
    (tmp_path / "a/log.mtb").unlink()
    while failed.is_active:
        device.listen(0.1)
    following = device.record(tmp_path / "b.mtb")
    device.listen(1)
    assert (failed.is_active, failed.files) == (False, [str(tmp_path / "a/log.mtb")])
    assert "was removed while it was being written" in str(failed.error)
    with pytest.raises(OSError, match="was removed"):
        failed.stop()
    assert following.is_active
    following.stop()
    assert len(xbus.read_log(tmp_path / "b.mtb")) >= 100
