"""Live counts of a device's stream."""

from __future__ import annotations

import pytest

from xbus import Device, Faults, SimulatedDevice, connect
from xbus.sim.link import SimLink

OUTPUTS = {"packet_counter": None, "acceleration": 100, "magnetic_field": 50, "status_word": None}


def measuring(faults: Faults | None = None) -> Device:
    device = connect(SimulatedDevice("MTi-630", faults=faults))
    with device.configure(OUTPUTS):
        pass
    return device


def test_what_is_counted() -> None:
    device = measuring()
    before = device.stats
    for _ in range(1000):
        device.read_sample()
    after = device.stats
    assert after.samples - before.samples in (1000, 1001)
    assert after.quantities["magnetic_field"] - before.quantities.get("magnetic_field", 0) in (
        500,
        501,
    )
    assert (
        after.lost_samples,
        after.skipped_bytes,
        after.checksum_errors,
        after.dropped_samples,
        after.dropped_strings,
        after.dropped_messages,
        after.unread_samples,
    ) == (0, 0, 0, 0, 0, 0, after.samples - before.samples - 1000)
    assert after.rates["acceleration"] == pytest.approx(100, rel=0.01)
    assert after.rates["magnetic_field"] == pytest.approx(50, rel=0.01)
    assert (after.overruns, after.errors, after.last_error) == (None, 0, None)


def test_damage_is_counted() -> None:
    device = measuring(Faults(drop=1e-3, seed=2))
    read = sum(1 for _ in zip(range(2000), device, strict=False))
    stats = device.stats
    assert read == 2000
    assert stats.lost_samples > 20
    assert stats.skipped_bytes > 20 * 20
    assert 0 < stats.gaps <= stats.lost_samples


def test_unread_samples_are_counted() -> None:
    """The oldest are dropped, and counted."""
    device = Device(SimLink(SimulatedDevice("MTi-630"), bound=100 * 16))
    with device.configure({"packet_counter": None, "status_word": None, "temperature": 100}):
        pass
    first = device.read_sample()["packet_counter"]
    device.listen(5)
    stats = device.stats
    assert stats.unread_samples * 17 <= stats.queued_bytes <= 1600
    assert device.read_sample()["packet_counter"] - first == 1 + stats.dropped_samples
    assert stats.dropped_samples > 400
    assert stats.dropped_samples + stats.unread_samples + stats.outdated + 1 == stats.samples
    assert (stats.lost_samples, stats.gaps, stats.dropped_messages) == (0, 0, 0)


def test_device_errors_are_counted() -> None:
    """Too much for 9600 baud: samples are lost in the device, which says so."""
    device = connect(SimulatedDevice("MTi-300", baudrate=9600))
    with device.configure({"packet_counter": None, "acceleration": 400}, check_baudrate=False):
        pass
    for _ in range(500):
        device.read_sample()
    stats = device.stats
    assert stats.lost_samples > 100
    assert stats.errors > 0
    assert "41" in (stats.last_error or "")
    assert any(notice.name == "Error" and notice.value.code == 41 for notice in device.notices)
