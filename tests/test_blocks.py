"""Blocks of columns, as they come from a device."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import xbus
from xbus import Device, SimulatedDevice, StateError, XbusTimeout, connect, encode_frame
from xbus.protocol import State

OUTPUTS = {
    "packet_counter": None,
    "sample_time_fine": None,
    "acceleration": 100,
    "magnetic_field": 20,
}


def measuring(outputs: Any = OUTPUTS, product: str = "MTi-630") -> Device:
    device = connect(SimulatedDevice(product))
    with device.configure(outputs, check_baudrate=False):
        pass
    return device


@pytest.mark.parametrize("size", [1, 7, 100])
def test_blocks_joined_are_the_log(size: int) -> None:
    """The same samples, read one by one from a twin and made a log at once."""
    twin = measuring()
    log = xbus.read_log(b"".join(twin.read_sample().frame for _ in range(700)))
    blocks = [
        block
        for block, _ in zip(measuring().blocks(samples=size), range(700 // size), strict=False)
    ]
    assert sum(map(len, blocks)) == 700
    assert np.array_equal(np.concatenate([block.time for block in blocks]), log.time)
    assert np.array_equal(
        np.concatenate([block.packet_counter for block in blocks]), log.packet_counter
    )
    for key in log:
        parts = [block[key] for block in blocks if key in block]
        assert np.array_equal(np.concatenate([part.values for part in parts]), log[key].values)
        assert np.array_equal(np.concatenate([part.sample for part in parts]), log[key].sample)


def test_host_time_of_a_virtual_device_is_its_own_time() -> None:
    """No transport, no drift: late is only what the link's steps make late; the clock sees through it."""
    device = measuring()
    blocks = [block for block, _ in zip(device.blocks(samples=100), range(30), strict=False)]
    host = np.concatenate([block.host_time for block in blocks])
    time = np.concatenate([block.time for block in blocks])
    assert np.isfinite(host).all()
    assert (np.diff(host) >= 0).all()
    assert np.ptp((host - time)[1000:]) < 1e-3


def test_samples_have_the_times_of_blocks() -> None:
    one, other = measuring(), measuring()
    blocks = [block for _, block in zip(range(10), other.blocks(samples=50), strict=False)]
    samples = [sample for _, sample in zip(range(500), one, strict=False)]
    assert [sample.time for sample in samples] == np.concatenate(
        [block.time for block in blocks]
    ).tolist()
    assert [sample.host_time for sample in samples] == np.concatenate(
        [block.host_time for block in blocks]
    ).tolist()


def test_a_sample_without_a_stamp_has_no_time() -> None:
    sample = measuring({"acceleration": 10}).read_sample()
    assert np.isnan([sample.time, sample.host_time]).all()
    assert np.isnan([xbus.Sample(b"").time, xbus.Sample(b"").host_time]).all()


def test_what_waits_longer_than_a_minute_is_not_lost() -> None:
    """A program that computes for long finds all samples."""
    device = measuring()
    sim = SimulatedDevice("MTi-630")
    sim.advance(70)
    data = sim.read()
    log = xbus.read_log(data)
    assert len(log) > 6000
    device.discard()
    before = device.stats
    for at in range(0, len(data), 4096):
        device.link.acquisition.push(data[at : at + 4096], device.link.clock())
    after = device.stats
    messages = sum(len(encode_frame(item.mid, item.payload)) for item in log.messages)
    device.listen(0)
    assert after.queued_bytes == len(data)
    assert device.stats.queued_bytes == len(data) - messages
    read = [device.read_sample()["packet_counter"] for _ in range(len(log))]
    assert read == log.packet_counter.tolist()
    stats = device.stats
    assert (stats.unread_samples, stats.queued_bytes, stats.dropped_samples) == (0, 0, 0)
    assert stats.samples - before.samples == len(log)


def test_an_answer_behind_much_that_waits_is_in_time() -> None:
    """A command leaves the unread samples, and does not wait for a reader."""
    device = measuring()
    device.discard()
    frame = device.read_sample().frame
    device.link.acquisition.push(frame * 10_000, device.link.clock())
    began = device.link.clock()
    device.go_to_config()
    assert device.state == State.CONFIG
    assert device.link.clock() - began < 0.1
    assert device.stats.unread_samples >= 10_000
    assert [device.read_sample().frame for _ in range(10_000)] == [frame] * 10_000


def test_an_answer_that_never_comes_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many samples come meanwhile."""
    device = measuring()
    monkeypatch.setattr(device.link, "write", lambda _: None)
    with pytest.raises(XbusTimeout, match="no answer to GoToConfig"):
        device.go_to_config()


def test_blocks_by_time() -> None:
    device = measuring()
    sizes = [len(block) for block, _ in zip(device.blocks(seconds=0.25), range(20), strict=False)]
    assert sum(sizes) == pytest.approx(20 * 25, abs=3)
    assert set(sizes) <= {24, 25, 26}


def test_quantities_can_be_chosen() -> None:
    block = next(measuring().blocks(samples=10, quantities=["acceleration"]))
    assert list(block) == ["acceleration"]


def test_the_clock_wraps_as_that_of_the_product() -> None:
    """One day on the 100-series, known from the identity that `configure` read."""
    device = measuring(product="MTi-300")
    stamps = [864_000_000 - 100, 0]
    frames = [xbus.encode_sample({"sample_time_fine": stamp}) for stamp in stamps]
    device.discard()
    device.link.acquisition.push(b"".join(frames), device.link.clock())
    block = next(device.blocks(samples=2))
    assert block.time.tolist() == [86_399.99, 86_400.0]


@pytest.mark.parametrize(
    ("arguments", "kind", "says"),
    [
        ({}, TypeError, "either in seconds or in samples"),
        ({"seconds": 1, "samples": 1}, TypeError, "either in seconds or in samples"),
        ({"samples": 0}, ValueError, "must be positive, not 0"),
        ({"seconds": -1}, ValueError, "must be positive, not -1"),
        ({"samples": 1, "quantities": ["nothing"]}, ValueError, "no quantity is called"),
    ],
)
def test_blocks_that_cannot_be(arguments: Any, kind: type[Exception], says: str) -> None:
    with pytest.raises(kind, match=says):
        measuring().blocks(**arguments)


def test_silence() -> None:
    device = measuring({})
    with pytest.raises(XbusTimeout, match="no sample from sim:MTi-630 within 2 s"):
        next(device.blocks(samples=1, timeout=2))


def test_config_state() -> None:
    device = measuring()
    device.go_to_config()
    with pytest.raises(StateError, match="the device is in Config State"):
        for _ in device.blocks(samples=1000):
            pass
