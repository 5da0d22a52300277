"""The times of ROS messages: one time base for a file, from UTC, the host or the device."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from mcap.reader import make_reader

import xbus
from conftest import counter, fine
from ros_messages import messages
from streams import mtdata2, real
from xbus import MessageId, encode_frame, encode_packet
from xbus.export.ros.mcap import Mcap
from xbus.log.part_file import export_parts
from xbus.protocol.tables import QUANTITIES

#: 2024-02-29T23:59:58.
START = 1_709_251_198
WAKE_UP = encode_frame(MessageId.WakeUp, bid=1)


def sample(ticks: int | None, utc: float | None = None, *, valid: int = 7, bid: int = 1) -> bytes:
    """A sample with device time in ticks of 0.1 ms, UTC in seconds after `START`, and an acceleration."""
    packets = [] if ticks is None else [fine(ticks)]
    if utc is not None:
        packets.append(utc_time(START * 10**9 + round(utc * 1e9), valid))
    return mtdata2(*packets, real(0x4020, 0, 0, 9.81), bid=bid)


def utc_time(nanoseconds: int, valid: int) -> bytes:
    moment = np.datetime64(nanoseconds, "ns")
    year, month, day = map(int, str(moment.astype("M8[D]")).split("-"))
    second = nanoseconds // 10**9 % 86_400
    clock = [second // 3600, second // 60 % 60, second % 60]
    return encode_packet("utc_time", [nanoseconds % 10**9, year, month, day, *clock, valid])


def fix(ticks: int, utc: float, *, valid: int = 7, bid: int = 1) -> bytes:
    """A sample of the GNSS receiver."""
    fields = {"year": 2024, "month": 2, "day": 29, "hour": 23, "min": 59, "sec": 58, "valid": valid}
    fields |= {"nano": round(utc * 1e9), "fixtype": 3, "flags": 1}
    names = [field.name for field in QUANTITIES["gnss_pvt_data"].fields]
    pvt = encode_packet("gnss_pvt_data", [fields.get(name, 0) for name in names])
    return mtdata2(fine(ticks), pvt, bid=bid)


class Case(NamedTuple):
    """Samples, the time base of the file, and the expected stamps in seconds after `START`, or after 1970.

    Attributes:
        order: The times by which messages are ordered, where they differ.
    """

    samples: list[bytes]
    base: str
    stamps: list[float]
    order: list[float] | None = None


CASES = {
    "utc in every sample": Case([sample(100, 0.5), sample(200, 0.51)], "utc", [0.5, 0.51]),
    "utc in some samples": Case(
        [sample(100, 0.5), sample(200), sample(300, 0.53), sample(400)],
        "utc",
        [0.5, 0.51, 0.53, 0.54],
    ),
    "utc becomes valid late": Case(
        [sample(100, -900, valid=3), sample(200), sample(300, 0.5), sample(400, 0.51)],
        "utc",
        [0.48, 0.49, 0.5, 0.51],
    ),
    "utc is lost": Case(
        [sample(100, 0.5), sample(200, 0.51, valid=3), sample(300)], "utc", [0.5, 0.51, 0.52]
    ),
    "a wrong utc": Case(
        [sample(100, 0.5), sample(200, 0.51), sample(300, 4e8), sample(400), sample(500, 0.54)],
        "utc",
        [0.5, 0.51, 4e8, 0.53, 0.54],
        [0.5, 0.51, 0.52, 0.53, 0.54],
    ),
    "a wrong utc at first": Case(
        [sample(100, 60), sample(200), sample(300, 0.52), sample(400, 0.53)],
        "utc",
        [60, 0.51, 0.52, 0.53],
        [0.5, 0.51, 0.52, 0.53],
    ),
    "utc that is corrected": Case(
        [sample(100, 0.5), sample(200, 0.51), sample(300, 60), sample(400, 60.01), sample(500)],
        "utc",
        [0.5, 0.51, 60, 60.01, 60.02],
        [0.5, 0.51, 0.52, 60.01, 60.02],
    ),
    "utc without device time": Case([sample(None, 0.5), sample(None, 0.6)], "utc", [0.5, 0.6]),
    "utc in samples without device time only": Case(
        [sample(100), sample(None, 0.5), WAKE_UP, sample(200), sample(300)],
        "utc",
        [0.5, 0.5, 0.5, 0.51],
    ),
    "no time in some samples": Case(
        [sample(None), sample(100, 0.5), sample(None), sample(200)], "utc", [0.5, 0.5, 0.5, 0.51]
    ),
    "utc never valid": Case(
        [sample(10_100, 0.5, valid=3), sample(10_200, 0.6, valid=0)], "device", [1.01, 1.02]
    ),
    "utc before 1970, and beyond 2038": Case(
        [sample(100, -START - 1), sample(200, 2**31 - START)], "device", [0.01, 0.02]
    ),
    "no time at all": Case([sample(None), sample(None)], "none", [0, 0]),
    "a restart, with utc": Case(
        [sample(900, 0.5), WAKE_UP, sample(100, 60), sample(200)], "utc", [0.5, 60, 60.01]
    ),
    "a restart, without": Case(
        [sample(900), sample(1000), WAKE_UP, sample(100), sample(200)],
        "device",
        [0.09, 0.1, 0.1, 0.11],
    ),
    "utc after a restart only": Case(
        [sample(900), sample(1000), WAKE_UP, sample(100), sample(200, 0.5)],
        "utc",
        [0.48, 0.49, 0.49, 0.5],
    ),
    "utc before a restart only": Case(
        [sample(900, 0.5), sample(1000), WAKE_UP, sample(100), sample(200)],
        "utc",
        [0.5, 0.51, 0.51, 0.52],
    ),
    "a clock that drifts, and a restart": Case(
        [sample(0, 0), sample(36_000_000, 3600.18), WAKE_UP, sample(100), sample(200)],
        "utc",
        [0, 3600.18, 3600.18, 3600.19],
    ),
    "a clock that drifts, and another device without utc": Case(
        [
            sample(0, 0),
            sample(36_000_000, 3600.18),
            sample(None, bid=2),
            sample(7000, bid=2),
            sample(36_000_100, 3600.19),
            sample(7100, bid=2),
        ],
        "utc",
        [0, 3600.18, 3600.18, 3600.18, 3600.19, 3600.19],
    ),
    "utc before and after a run without": Case(
        [sample(900, 0.5), WAKE_UP, sample(100), sample(200), WAKE_UP, sample(100, 60)],
        "utc",
        [0.5, 0.5, 0.51, 60],
    ),
    "utc of one device": Case(
        [sample(100, 0.5), sample(70_000, bid=2), sample(200, 0.51), sample(70_100, bid=2)],
        "utc",
        [0.5, 0.5, 0.51, 0.51],
    ),
    "a device without time at first": Case(
        [
            sample(None, bid=2),
            sample(100, 0.5),
            sample(70_000, bid=2),
            sample(200, 0.51),
            sample(70_100, bid=2),
        ],
        "utc",
        [0.5, 0.5, 0.5, 0.51, 0.51],
    ),
    "utc of the second device": Case(
        [sample(70_000, bid=2), sample(100, 0.5), sample(70_100, bid=2), sample(200)],
        "utc",
        [0.5, 0.5, 0.51, 0.51],
    ),
    "utc of the receiver, late": Case(
        [sample(1000), sample(1100), fix(1050, 0.5), sample(1200)],
        "utc",
        [0.495, 0.505, 0.5, 0.515],
        [0.495, 0.505, 0.505, 0.515],
    ),
    "an arbitrary time of the receiver": Case(
        [sample(1000), fix(900_000, 0.5, valid=0), sample(1100)], "device", [0.1, 0.1, 0.11]
    ),
    "a receiver without other samples": Case([fix(1000, 0.5), fix(1100, 0.51)], "utc", [0.5, 0.51]),
    "a gap": Case([sample(100, 0.5), sample(90_100)], "utc", [0.5, 9.5]),
}


def base_of(path: str) -> str:
    with Path(path).open("rb") as file:
        [record] = make_reader(file).iter_metadata()
    assert record.name == "xbus"
    return record.metadata["time_base"]


@pytest.mark.parametrize("name", CASES)
def test_times(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    case = CASES[name]
    data = b"".join(case.samples)
    xbus.read_log(data).to_mcap("whole.mcap")
    # A part of so few bytes has one sample.
    export_parts(xbus.split_log(data, block_bytes=1), "parts.mcap", Mcap())
    monkeypatch.setattr("xbus.export.ros.mcap.BATCH", 2)
    xbus.read_log(data).to_mcap("batches.mcap")
    for other in ("parts.mcap", "batches.mcap"):
        assert Path(other).read_bytes() == Path("whole.mcap").read_bytes()
    assert base_of("whole.mcap") == case.base
    topics = ("/imu/acceleration", "/device_2/imu/acceleration", "/gnss")
    found = [message for message in messages("whole.mcap") if message.topic in topics]
    start = START * 10**9 if case.base == "utc" else 0
    assert [message.stamp - start for message in found] == nanoseconds(case.stamps)
    assert [message.time - start for message in found] == nanoseconds(case.order or case.stamps)


def nanoseconds(seconds: list[float]) -> list[int]:
    return [round(second * 1e9) for second in seconds]


def test_times_of_the_host(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    samples = [mtdata2(counter(i), fine(100 * i), real(0x4020, 0, 0, 9.81)) for i in range(50)]
    Path("log.mtb").write_bytes(b"".join(samples))
    ends = np.cumsum([len(one) for one in samples])
    # The last ten are not known: they follow from the device.
    records = np.empty(40, [("end", "<u8"), ("arrival", "<i8")])
    records["end"], records["arrival"] = ends[:40], START * 10**9 + 10**7 * np.arange(40)
    head = b"XBUSTIME" + np.array([1, 16], "<u4").tobytes() + np.array([0], "<i8").tobytes()
    Path("log.mtb.times").write_bytes(head + records.tobytes())
    log = xbus.read_log("log.mtb")
    log.to_mcap("out.mcap")
    assert base_of("out.mcap") == "host"
    stamps = [message.stamp for message in messages("out.mcap") if message.topic == "/imu/data"]
    assert np.flatnonzero(np.isfinite(log.host_time)).tolist() == list(range(40))
    assert stamps[:40] == np.rint(log.host_time[:40] * 1e9).astype(np.int64).tolist()
    assert np.diff(stamps).tolist() == pytest.approx([10**7] * 49, abs=1000)
