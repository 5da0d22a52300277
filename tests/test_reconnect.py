"""Devices that go away and come back."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import numpy as np
import pytest

import xbus
from xbus import Device, Disconnected, Faults, SimulatedDevice, connect
from xbus.device.events import Notice
from xbus.protocol import State
from xbus.sim import PtyServer, serving

OUTPUTS = {"packet_counter": None, "sample_time_fine": None, "acceleration": 100}


def measuring(sim: SimulatedDevice, *, reconnect: bool) -> Device:
    device = connect(sim, reconnect=reconnect)
    with device.configure(OUTPUTS):
        pass
    return device


def gaps(device: Device) -> list[float]:
    return [
        notice.value
        for notice in device.notices
        if isinstance(notice, Notice) and notice.name == "Reconnected"
    ]


@pytest.mark.parametrize("away", [0.5, 30.0])
def test_samples_go_on_when_the_plug_is_in_again(away: float) -> None:
    device = measuring(
        SimulatedDevice("MTi-630", faults=Faults(unplug=(10.0, away))), reconnect=True
    )
    times = [device.read_sample()["sample_time_fine"] / 10_000 for _ in range(2000)]
    steps = np.diff(times)
    assert np.count_nonzero(steps > 0.011) == 1
    (gap,) = gaps(device)
    assert away <= gap <= away + 1
    assert steps.max() == pytest.approx(gap, abs=1)
    assert device.state == State.MEASUREMENT


def test_blocks_go_on(tmp_path: Path) -> None:
    """And so does the recording, in the same file."""
    device = measuring(
        SimulatedDevice("MTi-630", faults=Faults(unplug=(10.0, 2.0))), reconnect=True
    )
    with device.record(tmp_path / "log.mtb") as recording:
        sizes = [
            len(block) for block, _ in zip(device.blocks(samples=100), range(15), strict=False)
        ]
    assert sizes == [100] * 15
    assert recording.error is None
    assert len(gaps(device)) == 1


def test_without_it_the_exception_comes_at_once() -> None:
    device = measuring(
        SimulatedDevice("MTi-630", faults=Faults(unplug=(10.0, 1.0))), reconnect=False
    )
    given = count()
    with pytest.raises(Disconnected, match="while listening"):
        any(next(given) < 0 for _ in device)
    assert next(given) > 500  # all that had come was given before
    device.link.pause(1)
    device.go_to_config()


def test_another_device_is_not_taken_for_it() -> None:
    """Somebody plugs in another one first: it is left as it was."""
    sim = SimulatedDevice("MTi-630")
    other = SimulatedDevice("MTi-620")
    other.advance(1)
    device = measuring(sim, reconnect=True)
    device.read_sample()
    sim.unplug()
    link = device.link
    waited: list[float] = []

    def pause(seconds: float) -> None:
        waited.append(seconds)
        link.device.advance(seconds)  # type: ignore[attr-defined]
        if len(waited) == 3:
            link.device = other  # type: ignore[attr-defined]
        if len(waited) == 6:
            sim.plug()
            link.device = sim  # type: ignore[attr-defined]

    link.pause = pause  # type: ignore[method-assign]
    device.read_sample()
    assert (other.state, sim.state) == (State.MEASUREMENT, State.MEASUREMENT)
    assert len(gaps(device)) == 1


def test_commands_are_not_repeated() -> None:
    device = measuring(SimulatedDevice("MTi-630"), reconnect=True)
    device.link.device.unplug()  # type: ignore[attr-defined]
    with pytest.raises(Disconnected, match="was lost during IccCommand"):
        device.commands.icc_command(3)


@pytest.fixture
def server(tmp_path: Path) -> Iterator[PtyServer]:
    sim = SimulatedDevice("MTi-630")
    sim.advance(1)
    with PtyServer(sim, link=tmp_path / "mti") as it:
        yield it


def test_on_a_pty_that_is_another_one_afterwards(server: PtyServer) -> None:
    done = threading.Event()

    def run() -> None:
        while not done.is_set():
            server.step()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        assert server.port is not None
        with connect(server.port, reconnect=True) as device:
            with device.configure(OUTPUTS):
                pass
            server.device.faults = Faults(unplug=(server.device.time, 0.5))
            while not gaps(device):
                device.read_sample()
            assert "acceleration" in device.read_sample()
            assert device.state == State.MEASUREMENT
    finally:
        done.set()
        thread.join()


def test_a_recording_of_a_url_goes_on(tmp_path: Path) -> None:
    """The connection is made anew; queue, counts and file are the same."""
    sim = SimulatedDevice("MTi-630")
    with serving(sim, tcp=True) as port, connect(port, reconnect=True) as device:
        with device.configure(OUTPUTS):
            pass
        acquisition = device.link.acquisition
        with device.record(tmp_path / "log.mtb") as recording:
            for _ in range(50):
                device.read_sample()
            sim.unplug()
            while not acquisition.ended:
                pass
            sim.plug()
            while not gaps(device):
                device.read_sample()
            for _ in range(50):
                device.read_sample()
        assert recording.error is None
        assert device.link.acquisition is acquisition
        assert device.stats.samples >= 100
    log = xbus.read_log(tmp_path / "log.mtb")
    assert len(log) >= 100  # the gap may be counted before its first sample is read
    assert log.stats.skipped_bytes < 100


def test_a_plug_that_bounces() -> None:
    """Lost again while it comes back, it is brought into the state in which it was lost at first."""
    sim = SimulatedDevice("MTi-630")
    device = measuring(sim, reconnect=True)
    device.read_sample()
    sim.unplug()
    link, answered = device.link, []
    write, pause = link.write, link.pause

    def bounce(data: bytes) -> None:
        write(data)
        answered.append(data[2])
        if answered.count(0x00) == 1 and data[2] == 0x00:  # ReqDID
            sim.unplug()

    def wait(seconds: float) -> None:
        pause(seconds)
        sim.plug()

    link.write = bounce  # type: ignore[method-assign]
    link.pause = wait  # type: ignore[method-assign]
    for _ in range(50):
        device.read_sample()
    assert answered.count(0x00) == 2
    assert (sim.state, device.state) == (State.MEASUREMENT, State.MEASUREMENT)
