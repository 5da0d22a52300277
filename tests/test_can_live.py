"""The MTi-600 on a CAN bus, live: grouping, blocks, losses, recordings, and that nothing can be sent."""

from __future__ import annotations

import asyncio
import pickle
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import xbus
from test_can import CODES, GOOD, SUFFIXES, arrays, can, group, read
from test_can_parts import OFFSETS, Frame, buses
from xbus import _core
from xbus.can.address import parse_address
from xbus.can.ids import core_entries, device_ids
from xbus.device.can_sample import CanSample
from xbus.device.sample import Sample
from xbus.device.stats import live_stats


def acquisition(ids: Any = None, **options: Any) -> _core.Acquisition:
    return _core.Acquisition.can(core_entries(device_ids(ids)), epoch=0, **options)


def push(stream: _core.Acquisition, sent: Sequence[Frame], cuts: Sequence[int]) -> None:
    """Pushes frames in chunks of these sizes, and ends the stream."""
    columns = arrays([(key | (1 << 31 if key > 0x7FF else 0), data) for key, data in sent])
    at = 0
    for cut in [*cuts, len(sent)]:
        times, ids, sizes, data = (np.ascontiguousarray(rows[at : at + cut]) for rows in columns)
        assert stream.push_can(times, ids, sizes, data) is not None
        at += cut
    stream.end("over")


def samples_of(stream: _core.Acquisition) -> list[Sample]:
    return [CanSample.of(received) for received in iter(stream.take_sample, None)]


@given(buses(), st.lists(st.integers(0, 30), max_size=30), st.integers(1, 20))
def test_live_samples_are_those_of_a_capture(sent: list[Frame], cuts: list[int], size: int) -> None:
    """Whatever the chunks are: samples, blocks, times, losses and host times."""
    log = read(sent, OFFSETS)
    stream = acquisition(OFFSETS)
    push(stream, sent, cuts)
    stats = live_stats(stream.stats(0), 0)
    samples = samples_of(stream)
    again = acquisition(OFFSETS)
    push(again, sent, cuts)
    decoder, blocks = again.block_decoder(), []
    while (block := again.take_block(decoder, min(size, again.waiting.samples))) and len(
        block.part
    ):
        blocks.append(block)
    assert len(samples) == len(log) == sum(len(block.part) for block in blocks)
    assert (stats.samples, stats.lost_samples) == (len(log), log.stats.lost_samples)
    assert stats.frames == log.stats.frames
    assert stats.errors == len(log.traffic.events)
    assert stats.quantities == {
        (key if isinstance(key, str) else key[0]): len(column) for key, column in log.items()
    }
    for bid in set(log.bid.tolist()):
        of_log, of_stream = np.flatnonzero(log.bid == bid), [s for s in samples if s.bid == bid]
        times = np.concatenate([block.part.time[block.part.bid == bid] for block in blocks])
        np.testing.assert_array_equal(times, log.time[of_log])
        for place, sample in zip(of_log.tolist(), of_stream, strict=True):
            assert sample.offset == log.offset[place]
            np.testing.assert_array_equal(sample.time, log.time[place])
            np.testing.assert_allclose(sample.host_time, log.host_time[place], atol=1e-9)
            rows = {key: np.flatnonzero(column.sample == place) for key, column in log.items()}
            assert set(sample) == {key for key, found in rows.items() if len(found)}
            for key in sample:
                value = log[key].values[rows[key][0]]
                np.testing.assert_array_equal(
                    tuple(sample[key].values()) if isinstance(sample[key], dict) else sample[key],
                    value.item() if value.dtype.fields else value,
                )


def test_a_sample_is_a_mapping() -> None:
    stream = acquisition()
    push(stream, [*group(1, 0x07, 0x21, 0x34, 0x79), *group(2)], [])
    sample, last = samples_of(stream)
    log = read([*group(1, 0x07, 0x21, 0x34, 0x79), *group(2)])
    assert list(sample) == list(log)
    assert "quaternion" in sample
    assert ("quaternion", "ENU") in sample
    assert ("quaternion", "NED") not in sample
    assert sample["packet_counter"] == 1
    assert sample["acceleration"].dtype == np.float32
    assert sample["utc_time"]["year"] == log["utc_time"].values["year"][0]
    assert sample["gnss_receiver_status"].units["fixtype"] == ""
    assert sample.data_id("acceleration") == log["acceleration"].data_id
    assert last.get("acceleration") is None
    assert sample.unknown == {}
    assert pickle.loads(pickle.dumps(sample)) == sample  # noqa: S301
    with pytest.raises(AttributeError, match="a sample of CAN has no Xbus frame"):
        _ = sample.frame
    with pytest.raises(ValueError, match="nine bytes for each frame"):
        _core.can_sample(b"\5\0", 1, 0)


def test_a_full_queue_drops_the_oldest() -> None:
    stream = acquisition(bound=2000)
    push(stream, GOOD, [])
    stats = live_stats(stream.stats(0), 0)
    assert stats.samples == 100
    assert stats.dropped_samples + stats.unread_samples == 100
    assert samples_of(stream)[-1]["packet_counter"] == 99
    assert stats.dropped_samples > 20


def test_only_one_of_several_devices() -> None:
    stream = acquisition([0, 0x100], bid=2)
    push(stream, [*GOOD, *((0x100 + key, data) for key, data in GOOD)], [7, 11])
    samples = samples_of(stream)
    assert ({sample.bid for sample in samples}, len(samples)) == ({2}, 100)


# On a bus


class Sender:
    """Sends frames on a virtual bus, as a device does. Those of one call have the same time."""

    def __init__(self, channel: str) -> None:
        self.address = f"can:virtual:{channel}"
        self._bus = can.Bus(interface="virtual", channel=channel, preserve_timestamps=True)
        self.sent: list[Frame] = []

    def send(self, frames: Sequence[Frame]) -> None:
        now = time.time()
        for key, data in frames:
            self._bus.send(
                can.Message(
                    timestamp=now,
                    arbitration_id=key & 0x1FFFFFFF,
                    data=data,
                    is_extended_id=key > 0x7FF,
                    is_error_frame=bool(key >> 29 & 1) and not key >> 31,
                )
            )
        self.sent += frames

    def close(self) -> None:
        self._bus.shutdown()


@pytest.fixture
def sender(request: pytest.FixtureRequest) -> Iterator[Sender]:
    found = Sender(request.node.name)
    yield found
    found.close()


def groups(count: int, *codes: int, offset: int = 0) -> list[Frame]:
    return [frame for n in range(count) for frame in group(n, *codes, offset=offset)]


def test_samples_blocks_and_stats(sender: Sender) -> None:
    with xbus.connect(sender.address, listen=True) as device:
        sender.send(groups(100, *CODES))
        assert [device.read_sample()["packet_counter"] for _ in range(10)] == list(range(10))
        block = next(device.blocks(samples=50, quantities=["acceleration"]))
        assert list(block) == ["acceleration"]
        np.testing.assert_array_equal(block.packet_counter, np.arange(10, 60))
        log = read(groups(100, *CODES))
        np.testing.assert_array_equal(block["acceleration"], log["acceleration"][10:60])
        assert block.host_time[0] == pytest.approx(device.read_sample().host_time, abs=1)

        async def rest() -> list[int]:
            found = []
            async for sample in device:
                found.append(sample["packet_counter"])
                if len(found) == 30:
                    break
            return found

        assert asyncio.run(rest()) == list(range(61, 91))
        assert device.stats.lost_samples == 0
        assert device.state == xbus.protocol.State.MEASUREMENT
        assert repr(device).startswith(f"<Device {sender.address} at 250000 baud")


def test_losses_are_counted(sender: Sender) -> None:
    with xbus.connect(sender.address, listen=True) as device:
        sender.send([*groups(20, 0x34), (1, b"\1"), (2, b"\7"), (1 << 29, bytes(8)), (0x7F0, b"")])
        sender.send([frame for n in range(25, 40) for frame in group(n, 0x34)])
        samples = [device.read_sample() for _ in range(34)]
        assert samples[20]["packet_counter"] == 25
        stats = device.stats
        assert (stats.lost_samples, stats.gaps) == (5, 1)
        assert (stats.errors, stats.warnings) == (1, 1)
        assert stats.last_error == "CAN Warning 7: an undocumented code"
        found = "\n".join(device.findings)
        assert "1 error frame: the bus is disturbed" in found
        assert "device 1 reports 1 time that its output buffer overflowed" in found
        assert "1 frame with 1 identifier of no known device: 7F0 (1)" in found


def test_connect_waits_for_a_device(sender: Sender) -> None:
    with pytest.raises(xbus.XbusTimeout, match="check that CAN is switched on in the device"):
        xbus.connect(sender.address)


def test_connect_says_which_offset_fits(sender: Sender, monkeypatch: pytest.MonkeyPatch) -> None:
    # The bus is silent unless frames come after it was opened.
    original = can.Bus

    def opened(*args: Any, **options: Any) -> Any:
        bus = original(*args, **options)
        sender.send([*groups(5, *CODES, offset=0x100), *[(1 << 29, bytes(8))] * disturbed])
        return bus

    monkeypatch.setattr(can, "Bus", opened)
    disturbed = 0
    with pytest.raises(
        xbus.XbusTimeout, match=r"they fit an MTi with the offset 0x100; try ids=0x100"
    ):
        xbus.connect(sender.address)
    with xbus.connect(sender.address + "?ids=0x100") as device:
        assert device.read_sample().bid == 1
    disturbed = 3
    with pytest.raises(
        xbus.XbusTimeout, match=r"3 error frames: probably the bit rate of the bus is not 500,000"
    ):
        xbus.connect(sender.address, 500_000)


REFUSED: list[Callable[[xbus.Device], object]] = [
    lambda device: device.go_to_config(),
    lambda device: device.go_to_measurement(),
    lambda device: device.reset(),
    lambda device: device.configure().__enter__(),
    lambda device: device.commands.req_did(),
    lambda device: device.command("ReqFWRev"),
    lambda device: device.send(b"\0"),
    lambda device: device.settings(),
    lambda device: device.apply(xbus.Settings(location_id=7)),
    lambda device: device.set_output_configuration({"acceleration": 100}),
    lambda device: device.set_can_output_configuration({"acceleration": 100}),
    lambda device: device.set_strings(["HEHDT"], 100),
    lambda device: device.set_baudrate(115200),
    lambda device: device.restore_communication(0.1),
]


def test_nothing_can_be_sent(sender: Sender) -> None:
    with xbus.connect(sender.address, listen=True) as device:
        for act in REFUSED:
            with pytest.raises(
                xbus.StateError,
                match="was not sent: an MTi-600 sends on CAN, and cannot be configured",
            ):
                act(device)
        with pytest.raises(OSError, match="1 bytes were not sent"):
            device.link.write(b"\0")


@pytest.mark.parametrize(
    ("address", "error", "text"),
    [
        ("can:virtual", ValueError, "is no address of a CAN bus; write can:socketcan:can0"),
        ("can:nope:x", ValueError, "python-can has no interface 'nope'; it has canalystii"),
        ("can:virtual:x?ids=9x", ValueError, "'9x' is no identifier"),
        ("can:virtual:x?ids=5&ids=6", ValueError, "007 is Warning of device 1 and Error of device 2"),
        ("can:virtual:x?bitrate=0", ValueError, "a bit rate is a positive number, not 0"),
        ("can:virtual:x?rate=-1", ValueError, "rate must be a positive number of Hz"),
        ("can:virtual:x?rate", ValueError, "can:virtual:x?rate"),
        ("can:socketcan:none0", OSError, "sudo ip link set none0 up type can bitrate 250000"),
        ("can:pcan:PCAN_USBBUS1", OSError, "check the name of the channel, and that its driver"),
    ],
)  # fmt: skip
def test_a_bus_that_cannot_be_opened(address: str, error: type[Exception], text: str) -> None:
    with pytest.raises(error) as raised:
        xbus.connect(address)
    assert text in str(raised.value)


def test_options_of_an_address() -> None:
    address = parse_address(
        "can:slcan:/dev/ttyACM0@115200?ids=SampleTime=0x10,Acceleration=0x11&rate=50&sleep_after_open=0.5&fd=false&x=y"
    )
    assert (address.interface, address.channel) == ("slcan", "/dev/ttyACM0@115200")
    assert address.ids == [{"SampleTime": 0x10, "Acceleration": 0x11}]
    assert (address.bitrate, address.rate) == (250_000, 50)
    assert address.options == {"sleep_after_open": 0.5, "fd": False, "x": "y"}


# Recordings


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_recording_is_what_was_received(sender: Sender, tmp_path: Path, suffix: str) -> None:
    if suffix == "mf4":
        pytest.importorskip("asammdf")
    path = tmp_path / f"drive.{suffix}"
    with xbus.connect(sender.address + "?ids=0&ids=0x19FF0000", listen=True) as device:
        with device.record(path) as recording:
            sender.send(groups(40, *CODES))
            sender.send(groups(40, 0x34, offset=0x19FF0000))
            samples = [device.read_sample() for _ in range(78)]
        with pytest.raises(FileExistsError):
            device.record(path)
    assert recording.files == [str(path)]
    assert (recording.samples, recording.frames) == (78, 40 * 8 + 40 * 3)
    assert recording.error is None
    assert recording.bytes == path.stat().st_size
    log = xbus.read_can(path, [0, 0x19FF0000])
    assert log.traffic.findings == ()
    for bid in (1, 2):
        own, live = log.device(bid), [sample for sample in samples if sample.bid == bid]
        assert own.packet_counter[:-1].tolist() == [s["packet_counter"] for s in live]
        np.testing.assert_array_equal(own["acceleration"][:-1], [s["acceleration"] for s in live])
        np.testing.assert_array_equal(own.time[:-1], [s.time for s in live])
        if suffix not in ("trc", "asc"):  # these have a date in local time
            np.testing.assert_allclose(own.host_time[:-1], [s.host_time for s in live], atol=2e-5)


def test_a_rotated_recording(sender: Sender, tmp_path: Path) -> None:
    with xbus.connect(sender.address, listen=True) as device:
        with device.record(tmp_path / "drive.log", rotate_bytes=4000) as recording:
            sender.send(groups(100, *CODES))
            for _ in range(99):
                device.read_sample()
        names = [Path(path).name for path in recording.files]
        assert names[:2] == ["drive.log", "drive-0001.log"]
        assert len(names) > 5
    pieces = [xbus.read_can(path) for path in recording.files]
    assert np.concatenate([piece.packet_counter for piece in pieces]).tolist() == list(range(100))
    assert all(np.isfinite(piece.time).all() for piece in pieces)


def test_a_recording_that_was_not_closed_can_be_read(sender: Sender, tmp_path: Path) -> None:
    """Up to the last flush, or in a .blf file the last container."""
    with xbus.connect(sender.address, listen=True) as device:
        for suffix in ("log", "asc", "csv", "trc", "blf"):
            path = tmp_path / f"drive.{suffix}"
            recording = device.record(path, flush=0)
            sender.send(groups(400, *CODES))
            for _ in range(398):
                device.read_sample()
            device.link.wait(0.01)
            cut = tmp_path / f"cut.{suffix}"
            while not cut.exists() or cut.stat().st_size < 1000:
                cut.write_bytes(path.read_bytes())
            assert len(xbus.read_can(cut)) > 10
            recording.stop()


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"path": "drive.mtb"}, "a CAN bus is recorded as .asc, .blf, .log, .trc, .csv, .mf4"),
        ({"path": "drive.blf", "rotate_bytes": 0}, "rotate_bytes must be greater than 0"),
    ],
)
def test_recordings_that_are_refused(sender: Sender, options: Any, text: str) -> None:
    with (
        xbus.connect(sender.address, listen=True) as device,
        pytest.raises(ValueError, match=text),
    ):
        device.record(**options)


def test_a_disk_that_is_full(sender: Sender, tmp_path: Path) -> None:
    (tmp_path / "drive.log").symlink_to("/dev/full")
    with xbus.connect(sender.address, listen=True) as device:
        recording = device.record(tmp_path / "drive.log", flush=0)
        while recording.is_active:
            sender.send(groups(20, *CODES))
            device.read_sample()
        with pytest.raises(OSError, match=r"the recording ended early: .*No space left on device"):
            recording.stop()
