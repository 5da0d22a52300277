"""Waits of several threads and tasks on one device: each gets what it needs, in time, and all of them end."""

from __future__ import annotations

import asyncio
import gc
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xbus
from xbus import Device, Disconnected, SimulatedDevice, XbusTimeout, connect
from xbus.device.reader import ASYNC_WAITS
from xbus.protocol.values import State
from xbus.sim import serving

#: Seconds by which a loaded machine may be late. The faults that these tests are for took seconds more.
LATE = 1.0
#: Seconds after which a test fails.
LONG = 20.0

OUTPUTS = {"packet_counter": None, "sample_time_fine": None, "acceleration": 100}


@pytest.fixture
def port() -> Iterator[str]:
    sim = SimulatedDevice("MTi-630")
    sim.advance(1)
    with serving(sim) as name:
        yield name


@pytest.fixture
def device(port: str) -> Iterator[Device]:
    with connect(port) as opened:
        with opened.configure(OUTPUTS):
            pass
        yield opened


class Outcome:
    """What a function returns or raises in a thread, and when."""

    def __init__(self, function: Callable[[], Any]) -> None:
        self.value: Any = None
        self.error: BaseException | None = None
        self.at = 0.0
        self._function = function
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self.value = self._function()
        except BaseException as error:
            self.error = error
        self.at = time.monotonic()

    def join(self) -> Outcome:
        self._thread.join(LONG)
        assert not self._thread.is_alive(), "the wait has not ended"
        return self


def test_a_command_times_out_in_time_beside_many_readers(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = threading.Event()

    def read() -> int:
        count = 0
        while not done.is_set():
            device.read_sample()
            count += 1
        return count

    readers = [Outcome(read) for _ in range(8)]
    monkeypatch.setattr(device.link, "write", lambda data: None)
    began = time.monotonic()
    with pytest.raises(XbusTimeout, match="no answer to SetNoRotation") as timeout:
        device.commands.set_no_rotation(2)
    took = time.monotonic() - began
    done.set()
    assert timeout.value.waited <= took < timeout.value.waited + LATE
    assert sum(reader.join().value for reader in readers) > 20
    assert device.stats.dropped_samples == 0


def test_several_readers_share_the_samples(device: Device) -> None:
    first = device.read_sample()["packet_counter"]

    def read() -> list[int]:
        return [device.read_sample()["packet_counter"] for _ in range(20)]

    readers = [Outcome(read) for _ in range(4)]
    counters = sorted(counter for reader in readers for counter in reader.join().value)
    assert counters == list(range(first + 1, first + 81))


def test_a_silent_device_is_reported_in_time(device: Device) -> None:
    with device.configure({}):
        pass
    began = time.monotonic()
    waits = [
        Outcome(lambda: device.read_sample(0.5)),
        Outcome(lambda: device.read_string(0.5)),
        Outcome(lambda: next(device.blocks(samples=10, timeout=0.5))),
        Outcome(lambda: next(device.blocks(seconds=0.1, timeout=0.4))),
    ]
    for wait in waits:
        assert isinstance(wait.join().error, XbusTimeout)
        assert 0.5 <= wait.at - began < 0.5 + LATE


def test_closing_ends_every_wait(device: Device) -> None:
    with device.configure({}):
        pass

    async def iterate() -> None:
        async for _ in device:
            raise AssertionError

    waits = [
        Outcome(lambda: device.read_sample(LONG)),
        Outcome(lambda: device.read_string(LONG)),
        Outcome(lambda: next(device.blocks(samples=10, timeout=LONG))),
        Outcome(lambda: next(device.blocks(seconds=LONG))),
        Outcome(lambda: device.listen(LONG)),
        Outcome(lambda: device.wake_up(LONG)),
        Outcome(lambda: asyncio.run(iterate())),
    ]
    time.sleep(0.1)  # most of them wait by now; those that do not end just the same
    device.close()
    closed_at = time.monotonic()
    for wait in waits:
        assert isinstance(wait.join().error, Disconnected), wait.error
        assert "was closed" in str(wait.error)
        assert wait.at - closed_at < LATE
    with pytest.raises(Disconnected, match="was closed"):
        device.go_to_config()


@pytest.mark.parametrize("size", [{"samples": 500}, {"seconds": 5.0}])
def test_a_cancelled_block_returns_at_once_and_loses_nothing(
    device: Device, size: dict[str, Any]
) -> None:
    first = device.read_sample()["packet_counter"]

    async def cancel() -> float:
        waiting = asyncio.ensure_future(anext(device.blocks(**size)))
        await asyncio.sleep(0.3)
        waiting.cancel()
        began = time.monotonic()
        with pytest.raises(asyncio.CancelledError):
            await waiting
        return began

    began = asyncio.run(cancel())
    assert time.monotonic() - began < LATE
    assert device.stats.unread_samples >= 10
    counters = [device.read_sample()["packet_counter"] for _ in range(50)]
    assert counters == list(range(first + 1, first + 51))
    assert device.stats.dropped_samples == 0


def test_cancelled_waits_leave_their_threads(device: Device) -> None:
    """More of them than threads that may wait: the next wait begins at once."""

    async def run() -> int:
        for _ in range(ASYNC_WAITS + 1):
            waiting = asyncio.ensure_future(anext(device.blocks(samples=100_000)))
            await asyncio.sleep(0.01)
            waiting.cancel()
            with pytest.raises(asyncio.CancelledError):
                await waiting
        return len(await asyncio.wait_for(anext(device.blocks(samples=10)), 10 * 0.01 + LATE))

    assert asyncio.run(run()) == 10


def test_other_tasks_run_while_many_samples_wait() -> None:
    sim = SimulatedDevice("MTi-630")
    sim.advance(1)
    device = connect(sim)
    with device.configure(OUTPUTS):
        pass
    device.link.pause(30)

    async def run() -> int:
        turns = 0

        async def count() -> None:
            nonlocal turns
            while True:
                turns += 1
                await asyncio.sleep(0)

        counting = asyncio.ensure_future(count())
        read = 0
        async for _ in device:
            read += 1
            if read == 2000:
                counting.cancel()
                return turns
        raise AssertionError

    assert asyncio.run(run()) >= 10


@pytest.mark.skipif(os.name != "posix", reason="needs signals of POSIX")
@pytest.mark.parametrize(
    "wait",
    [
        lambda device: device.read_sample(LONG),
        lambda device: next(device.blocks(seconds=LONG)),
        lambda device: device.listen(LONG),
    ],
)
def test_ctrl_c_ends_a_wait(device: Device, wait: Callable[[Device], object]) -> None:
    with device.configure({}):
        pass
    timer = threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        wait(device)
    timer.join()
    assert time.monotonic() - began < 0.2 + LATE
    device.go_to_config()


def test_a_reader_waits_while_another_thread_configures(device: Device) -> None:
    done = threading.Event()

    def read() -> list[int]:
        counters = []
        while not done.is_set():
            counters.append(device.read_sample()["packet_counter"])
        return counters

    reader = Outcome(read)
    for number in range(3):
        with device.configure() as cfg:
            cfg.commands.set_location_id(number)
    device.read_sample()
    done.set()
    assert reader.join().error is None
    with device.configure() as cfg:
        cfg.discard()
        with pytest.raises(xbus.StateError, match="Config State"):
            cfg.read_sample()


def test_a_recording_leaves_unread_samples(device: Device, tmp_path: Path) -> None:
    first = device.read_sample()["packet_counter"]
    device.listen(0.2)
    unread, outdated = device.stats.unread_samples, device.stats.outdated
    assert unread > 10
    with device.record(tmp_path / "log.mtb"):
        counters = [device.read_sample()["packet_counter"] for _ in range(unread)]
    assert counters == list(range(first + 1, first + 1 + unread))
    assert (device.stats.outdated, device.stats.dropped_samples) == (outdated, 0)


def test_samples_from_before_new_settings_are_counted(device: Device) -> None:
    while device.stats.unread_samples <= 10:
        device.listen(0.05)
    unread, outdated = device.stats.unread_samples, device.stats.outdated
    with device.configure({"packet_counter": None, "magnetic_field": 100}):
        pass
    assert device.stats.outdated >= outdated + unread
    assert list(device.read_sample()) == ["packet_counter", "magnetic_field"]
    assert device.stats.dropped_samples == 0


def test_what_a_slow_reader_misses_is_counted_once() -> None:
    sim = SimulatedDevice("MTi-630")
    sim.advance(1)
    device = connect(sim, queue_seconds=0.1)  # 40 kB
    with device.configure(OUTPUTS):
        pass
    before = device.stats
    device.read_sample()
    device.link.pause(60)
    stats = device.stats
    assert stats.dropped_samples > 1000
    unread = [device.read_sample()["packet_counter"] for _ in range(stats.unread_samples)]
    assert np.unique(np.diff(unread)).tolist() == [1]
    assert 1 + len(unread) + stats.dropped_samples == stats.samples - before.samples
    assert (stats.lost_samples, stats.gaps) == (before.lost_samples, before.gaps)
    with pytest.raises(ValueError, match="5000 samples do not fit into the queue"):
        next(device.blocks(samples=5000))


def test_counts_never_decrease_and_rates_are_never_negative() -> None:
    sim = SimulatedDevice("MTi-300", baudrate=115200)
    sim.advance(1)
    device = connect(sim)
    with device.configure({"packet_counter": None, "acceleration": 100}):
        pass
    seen = [device.stats]
    for rate in (460800, 115200):
        device.read_sample()
        device.go_to_config()
        device.set_baudrate(rate)
        seen.append(device.stats)
        device.go_to_measurement()
        for _ in range(100):
            device.read_sample()
            seen.append(device.stats)
    for before, after in pairwise(seen):
        for name in ("bytes", "frames", "samples", "messages", "skipped_bytes", "lost_samples"):
            assert getattr(after, name) >= getattr(before, name), name
        assert all(rate >= 0 for rate in after.rates.values())


def test_rates_do_not_depend_on_who_asks() -> None:
    sims = [SimulatedDevice("MTi-630", seed=1) for _ in range(2)]
    often, seldom = (connect(sim) for sim in sims)
    for device in (often, seldom):
        with device.configure(OUTPUTS):
            pass
    for _ in range(500):
        often.read_sample()
        seldom.read_sample()
        rates = often.stats.rates
    assert rates == seldom.stats.rates
    assert rates["acceleration"] == pytest.approx(100, rel=0.01)
    often.link.pause(0)
    with often.configure({}):
        pass
    often.listen(5)
    assert set(often.stats.rates.values()) == {0.0}


# Clean-up


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs /proc")
def test_url_devices_that_are_dropped_are_freed() -> None:
    sim = SimulatedDevice("MTi-630")
    sim.advance(1)
    with serving(sim, tcp=True) as url:
        connect(url).close()
        before = threading.active_count(), _open_files()
        for _ in range(3):
            device = connect(url)
            device.read_sample()
            del device
            gc.collect()
        # The threads and the server notice a little later.
        until = time.monotonic() + LONG
        while (threading.active_count(), _open_files()) > before and time.monotonic() < until:
            time.sleep(0.01)
        assert threading.active_count() <= before[0]
        assert _open_files() <= before[1]


def _open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("tcp", [False, True])
def test_a_fork_leaves_the_connection_to_its_parent(tcp: bool, tmp_path: Path) -> None:
    sim = SimulatedDevice("MTi-630")
    sim.advance(1)
    with serving(sim, tcp=tcp) as port, connect(port) as device:
        recording = device.record(tmp_path / "log.mtb")
        reader = Outcome(lambda: [device.read_sample() for _ in range(100)])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # forking with threads warns
            child = os.fork()
        if child == 0:
            status = 1
            try:
                for use in (device.read_sample, device.go_to_config, device.commands.req_did):
                    with pytest.raises(Disconnected, match="belongs to the parent process"):
                        use()
                recording.stop()
                device.close()
                del device, recording
                gc.collect()
                status = 0
            finally:
                os._exit(status)
        assert os.waitpid(child, 0) == (child, 0)
        assert reader.join().error is None
        device.read_sample()
        recording.stop()
    log = xbus.read_log(tmp_path / "log.mtb")
    assert len(log) > 20  # those of the connection before the recording are not in it
    assert (log.stats.lost_samples, log.stats.skipped_bytes) == (0, 0)


@pytest.mark.parametrize("tcp", [False, True])
def test_an_interpreter_exits_with_an_open_device(tcp: bool, tmp_path: Path) -> None:
    """A reader thread waits, a recording runs, and nothing is closed."""
    code = (
        "import sys, threading, xbus\n"
        "device = xbus.connect(sys.argv[1])\n"
        "recording = device.record(sys.argv[2])\n"
        "threading.Thread(target=lambda: [_ for _ in device], daemon=True).start()\n"
        "device.listen(0.5)\n"
    )
    sim = SimulatedDevice("MTi-630")
    sim.advance(1)
    path = tmp_path / "log.mtb"
    with serving(sim, tcp=tcp) as port:
        command = [sys.executable, "-c", code, port, str(path)]
        subprocess.run(command, check=True, timeout=LONG)  # noqa: S603
    assert len(xbus.read_log(path)) >= 10


def test_threads_that_configure_at_a_time_share_config_state(device: Device) -> None:
    second_may_end, second_is_in = threading.Event(), threading.Event()

    def configure() -> int:
        with device.configure() as cfg:
            second_is_in.set()
            assert second_may_end.wait(LONG)
            return cfg.commands.req_did()

    with device.configure():
        second = Outcome(configure)
        assert second_is_in.wait(LONG)
    states = [device.state]  # the second thread is not done
    reader = Outcome(device.read_sample)
    second_may_end.set()
    assert second.join().value == device.device_id
    assert reader.join().error is None
    assert [*states, device.state] == [State.CONFIG, State.MEASUREMENT]
    device.go_to_config()
    device.discard()
    assert isinstance(Outcome(device.read_sample).join().error, xbus.StateError)


def test_finding_the_state_waits_for_the_command_of_another_thread(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    with device.configure({}):
        pass
    device.session.forget()
    monkeypatch.setattr(device.link, "write", lambda data: None)
    command = Outcome(device.go_to_config)
    configure = Outcome(lambda: device.configure().__enter__())
    assert isinstance(command.join().error, XbusTimeout)
    assert isinstance(configure.join().error, XbusTimeout)


def test_a_command_beside_a_reader_that_reconnects_ends(tmp_path: Path) -> None:
    name = tmp_path / "imu"
    with serving(SimulatedDevice("MTi-630"), link=name):
        device = connect(str(name), 115_200, reconnect=True)
        reader = Outcome(lambda: list(device))
    assert not name.exists()
    until = time.monotonic() + 1
    while time.monotonic() < until:
        command = Outcome(lambda: device.command("ReqFWRev")).join()
        assert isinstance(command.error, Disconnected | xbus.StateError)
    device.close()
    assert isinstance(reader.join().error, Disconnected)


def test_closing_during_a_write_is_disconnected(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = device.link._port  # type: ignore[attr-defined]

    def write(data: bytes) -> None:
        Outcome(device.close).join()
        os.write(port.fd, data)  # the descriptor is None

    monkeypatch.setattr(port, "write", write)
    with pytest.raises(Disconnected, match="was closed; connect"):
        device.go_to_config()


def test_closing_while_the_port_is_opened_again_closes_it(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    reopen = device.link.reopen

    def close_and_reopen() -> None:
        Outcome(device.close).join()
        reopen()

    monkeypatch.setattr(device.link, "reopen", close_and_reopen)
    device.link.acquisition.end("unplugged")
    with pytest.raises(Disconnected):
        device.listen(1)
    with pytest.raises(Disconnected, match="was closed; connect"):
        device.go_to_config()
    assert device.link.acquisition.ended
    assert not device.link._port.is_open  # type: ignore[attr-defined]


def test_async_reading_of_a_closed_device_is_disconnected(device: Device) -> None:
    async def read() -> None:
        samples = aiter(device)
        await anext(samples)
        device.close()
        device.discard()
        with pytest.raises(Disconnected, match="was closed; connect"):
            await anext(samples)
        with pytest.raises(Disconnected, match="was closed; connect"):
            await anext(device.blocks(samples=10**6))

    asyncio.run(read())


def test_the_answer_of_an_interrupted_command_answers_no_other(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    device.go_to_config()
    write = device.link.write

    def interrupt(data: bytes) -> None:
        write(data)
        time.sleep(0.2)
        Outcome(lambda: device.state).join()  # another thread handles the answer
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(device.link, "write", interrupt)
        with pytest.raises(KeyboardInterrupt):
            device.command("ReqDID")
    before = [notice.name for notice in device.notices]
    device.command("ReqDID")
    device.listen(0.2)
    assert [notice.name for notice in device.notices] == before
