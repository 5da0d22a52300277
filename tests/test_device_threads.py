"""A device that is used by several threads, and by an event loop."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator

import numpy as np
import pytest

import xbus
from xbus import Device, SimulatedDevice, connect
from xbus.protocol import IccCommand
from xbus.sim import serving


@pytest.fixture(params=["in process", "pty"])
def device(request: pytest.FixtureRequest) -> Iterator[Device]:
    sim = SimulatedDevice("MTi-630")
    sim.advance(1)
    if request.param == "in process":
        with connect(sim) as opened:
            yield opened
    else:
        with serving(sim) as port, connect(port) as opened:
            yield opened


def test_commands_while_another_thread_reads(device: Device) -> None:
    counters: list[int] = []
    failed: list[BaseException] = []
    done = threading.Event()

    def read() -> None:
        try:
            while not done.is_set():
                counters.append(device.read_sample()["packet_counter"])
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=read)
    thread.start()
    try:
        for _ in range(20):
            assert device.commands.icc_command(IccCommand.STATE).active is False
        device.commands.set_no_rotation(2)
    finally:
        done.set()
        thread.join()
    assert failed == []
    assert np.unique(np.diff(counters)).tolist() in ([], [1])


def test_two_threads_with_commands(device: Device) -> None:
    device.go_to_config()
    expected = device.commands.req_did()
    found: list[int] = []

    def ask() -> None:
        found.extend(device.commands.req_did() for _ in range(20))

    threads = [threading.Thread(target=ask) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [expected] * 60


def test_async_iteration(device: Device) -> None:
    async def counters() -> list[int]:
        found = []
        async for sample in device:
            found.append(sample["packet_counter"])
            if len(found) == 30:
                return found
        raise AssertionError

    found = asyncio.run(counters())
    assert np.unique(np.diff(found)).tolist() == [1]


def test_async_blocks(device: Device) -> None:
    async def sizes() -> list[int]:
        found = []
        async for block in device.blocks(samples=10):
            assert isinstance(block, xbus.Log)
            found.append(len(block))
            if len(found) == 3:
                return found
        raise AssertionError

    assert asyncio.run(sizes()) == [10, 10, 10]


def test_a_cancelled_wait_leaves_the_device_usable(device: Device) -> None:
    device.go_to_config()
    device.set_output_configuration({})
    device.go_to_measurement()

    async def wait() -> None:
        async for _ in device:
            raise AssertionError

    async def impatient() -> None:
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(wait(), 0.05)

    asyncio.run(impatient())
    device.go_to_config()
    assert device.commands.req_output_configuration() == ()
