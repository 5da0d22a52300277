"""CAN of the 600-series: single frames, captures as logs, the DBC file, damaged and foreign traffic."""

from __future__ import annotations

import pickle
import re
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import xbus
from xbus.can import CAN_MESSAGES, EXTENDED, CanLog, can_message
from xbus.can.dbc import FILE, dbc_text, make_dbc
from xbus.protocol.tables import CAN_QUANTITIES, QUANTITIES

can = pytest.importorskip("can")

SPEC = Path(__file__).parent / "spec" / "can.txt"
ROWS = [re.split(r"\s+", line) for line in SPEC.read_text().splitlines() if line and line[0] != "#"]

#: Code, data, and the values of the signals.
VECTORS = [
    (0x34, "000000000000", (0, 0, 0)),
    (0x34, "000100000000", (0.00390625, 0, 0)),
    (0x34, "0000000009CF", (0, 0, 9.80859375)),
    (0x34, "FF0000000000", (-1, 0, 0)),
    (0x34, "0180FDC009CF", (1.5, -2.25, 9.80859375)),
    (0x34, "640064006400", (100, 100, 100)),
    (0x34, "9C009C009C00", (-100, -100, -100)),
    (0x34, "7FFF7FFF7FFF", (127.99609375, 127.99609375, 127.99609375)),
    (0x34, "800080008000", (-128, -128, -128)),
    (0x32, "000000000200", (0, 0, 1)),
    (0x32, "00000000FE00", (0, 0, -1)),
    (0x32, "460046004600", (35, 35, 35)),
    (0x32, "0033FF800500", (0.099609375, -0.25, 2.5)),
    (0x32, "BA00BA00BA00", (-35, -35, -35)),
    (0x22, "2D0000000000", (90, 0, 0)),
    (0x22, "0000E9800000", (0, -45, 0)),
    (0x22, "00000000A600", (0, 0, -180)),
    (0x22, "0640FE60D300", (12.5, -3.25, -90)),
    (0x22, "000000005A00", (0, 0, 180)),
    (0x76, "050000000000", (20, 0, 0)),
    (0x76, "FB0000000000", (-20, 0, 0)),
    (0x76, "7D007D007D00", (500, 500, 500)),
    (0x76, "06E0FFB00004", (27.5, -1.25, 0.0625)),
    (0x76, "830083008300", (-500, -500, -500)),
    (0x06, "1234", (4660,)),
    (0x05, "000F4240", (100.0,)),
    (0x11, "01800007", (0x01800007,)),
    (0x01, "01", (1,)),
    (0x21, "7FFF000000008001", (1, 0, 0, -1)),
    (0x33, "7FFF0021FFBE0010", (1, 33 / 32767, -66 / 32767, 16 / 32767)),
    (0x31, "0C8EFF7D004211", (3214 / 2**17, -131 / 2**17, 66 / 2**17, 17)),
    (0x31, "0323FFDF00100F", (803 / 2**15, -33 / 2**15, 16 / 2**15, 15)),
    (0x31, "09CFFF80004008", (9.80859375, -0.5, 0.25, 8)),
    (0x35, "0180FDC00020", (1.5, -2.25, 0.125)),
    (0x41, "02000100FD00", (0.5, 0.25, -0.75)),
    (0x51, "1980", (25.5,)),
    (0x51, "F5C0", (-10.25,)),
    (0x52, "C0E6B74F", (0xC0E6B74F / 2**15,)),
    (0x61, "02000400FA00", (1, 2, -3)),
    (0x62, "01000200FD00", (1, 2, -3)),
    (0x71, "343D90E4036B4DF9", (0x343D90E4 / 2**24, 0x036B4DF9 / 2**23)),
    (0x71, "DE219653B46535A8", (-0x21DE69AD / 2**24, -0x4B9ACA58 / 2**23)),
    (0x72, "FFFF8000", (-1,)),
    (0x74, "071E4440", (466500.25,)),
    (0x75, "B37383E0", (-5016700.125,)),
    (0x07, "140B1C11283B04D2", (20, 11, 28, 17, 40, 59, 0.1234)),
    (0x79, "030E010712", (3, 14, 1, 7, 18)),
    (0x7A, "009800620079005C", (1.52, 0.98, 1.21, 0.92)),
]
DOPS = ("pdop", "tdop", "vdop", "hdop")
#: Messages whose numbers a log has.
SAMPLED = [row for row in CAN_MESSAGES.values() if row.quantity]


def test_the_table_is_that_of_the_documents() -> None:
    at = 0
    found = []
    for row in CAN_MESSAGES.values():
        at = 0
        for signal in row.signals:
            counts = (
                "2^e" if row.kind == "scaled" and signal.name != "exponent" else signal.per_unit
            )
            found.append(
                [
                    f"{row.code:02X}", row.name, str(row.size), signal.name, str(at), signal.type,
                    str(counts), signal.unit or ("m/s" if counts == "2^e" else "-"),
                ]
            )  # fmt: skip
            at += signal.size
    assert found == ROWS
    assert [row.name for row in CAN_MESSAGES.values() if not row.signals] == [
        "RotationMatrix",
        "Latitude",
        "Longitude",
    ]


@pytest.mark.parametrize(("code", "data", "values"), VECTORS)
def test_published_frames_in_both_directions(
    code: int, data: str, values: tuple[float, ...]
) -> None:
    row, names = CAN_MESSAGES[code], [signal.name for signal in CAN_MESSAGES[code].signals]
    assert row.decode(bytes.fromhex(data)) == dict(zip(names, values, strict=True))
    assert row.encode(dict(zip(names, values, strict=True))).hex().upper() == data


@st.composite
def frames(draw: st.DrawFn, exponents: tuple[int, int] = (0, 30)) -> tuple[int, bytes]:
    """A message with a layout, and any data that it can have."""
    row = draw(st.sampled_from([row for row in CAN_MESSAGES.values() if row.signals]))
    data = draw(st.binary(min_size=row.size, max_size=row.size))
    if row.kind == "scaled":
        data = data[:-1] + bytes([draw(st.integers(*exponents))])
    return row.code, data


@given(frames())
def test_every_frame_survives_a_round_trip(frame: tuple[int, bytes]) -> None:
    code, data = frame
    row = CAN_MESSAGES[code]
    assert row.encode(row.decode(data)) == data


@pytest.mark.parametrize(
    ("values", "data"),
    [
        ({"x": 1e9, "y": -1e9, "z": 0.0}, "7fff80000000"),
        ({"x": 0.6 / 256, "y": 0.4 / 256, "z": -0.6 / 256}, "00010000ffff"),
    ],
)
def test_values_are_rounded_and_limited(values: dict[str, float], data: str) -> None:
    assert CAN_MESSAGES[0x34].encode(values).hex() == data


@pytest.mark.parametrize(
    ("act", "error"),
    [
        (lambda: CAN_MESSAGES[0x34].decode(bytes(5)), "Acceleration has 6 bytes, not 5"),
        (lambda: CAN_MESSAGES[0x31].decode(b"\xff" * 7), "exponent 255; it is at most 30"),
        (lambda: CAN_MESSAGES[0x23].decode(bytes(8)), "no source gives the layout of RotationMatrix"),
        (lambda: CAN_MESSAGES[0x51].encode({}), "has the signals temperature, not "),
        (lambda: CAN_MESSAGES[0x51].encode({"temperature": np.nan}), "is not a finite number"),
        (lambda: can_message("accel"), "no CAN message is called 'accel'; choose from Error"),
        (lambda: can_message(0x99), "no CAN message is called 0x99"),
        (lambda: xbus.encode_sample({"gnss_receiver_dop": dict.fromkeys(DOPS, 1)}),
         "gnss_receiver_dop has no packet; only CAN has it"),
        (lambda: read([], {"SampleTime": 5, "GroupCounter": 5}), "005 is both SampleTime and GroupCounter"),
        (lambda: read([], [0, {"Error": 0x34}]), "034 is Acceleration of device 1 and Error of device 2"),
        (lambda: read([], 0x790), "leads beyond the identifiers of 11 bits"),
        (lambda: read([], {"Error": 1 << 29}), "is no CAN identifier"),
        (lambda: read([], []), "ids is an empty list"),
        (lambda: xbus.read_can([], rate=-1), "rate must be a positive number"),
        (lambda: xbus.read_can(SPEC), "can.txt is no CAN capture; its suffix must be one of"),
        (lambda: xbus.read_can(([0.0], [5], [4], np.zeros((2, 8), np.uint8))), "must be of shape"),
        (lambda: xbus.read_can(([np.nan], [5], [4], np.zeros((1, 8), np.uint8))), "must be finite"),
        (lambda: xbus.read_can([], channel=1), "the capture has no channel 1"),
    ],
)  # fmt: skip
def test_wrong_arguments(act: Any, error: str) -> None:
    with pytest.raises(ValueError, match=re.escape(error)):
        act()


@pytest.mark.parametrize(
    "act",
    [
        lambda: read([], "0x100"),
        lambda: xbus.read_can(b"LOGG"),
        lambda: xbus.read_can([b""]),
        lambda: xbus.read_can(([0.0], [5.0], [4], np.zeros((1, 8), np.uint8))),
    ],
)
def test_arguments_of_a_wrong_type(act: Any) -> None:
    with pytest.raises(TypeError):
        act()


# Logs


def arrays(sent: Sequence[tuple[int, bytes]], step: float = 1e-4) -> tuple[Any, Any, Any, Any]:
    """Frames as the arrays that `read_can` takes."""
    data = np.zeros((len(sent), 8), np.uint8)
    for row, (_, content) in zip(data, sent, strict=True):
        row[: len(content)] = list(content[:8])
    ids = np.array([key for key, _ in sent], np.uint32)
    return np.arange(len(sent)) * step, ids, np.array([len(c) for _, c in sent], np.uint8), data


def read(sent: Sequence[tuple[int, bytes]], ids: Any = None, **options: Any) -> CanLog:
    return xbus.read_can(arrays(sent), ids, **options)


def group(number: int, *codes: int, offset: int = 0, seed: int = 0) -> list[tuple[int, bytes]]:
    """A group at 400 Hz with SampleTime, GroupCounter and random data of these codes."""
    random = np.random.default_rng([number, seed])
    sent = [(5, (25 * number).to_bytes(4, "big")), (6, (number % 65536).to_bytes(2, "big"))]
    for code in codes:
        data = random.bytes(CAN_MESSAGES[code].size)
        sent.append((code, data[:-1] + b"\x0f" if code == 0x31 else data))
    return [(offset + code, data) for code, data in sent]


def expected(code: int, data: bytes) -> Any:
    """The row of a column, by the simple decoder."""
    row = CAN_MESSAGES[code]
    values = row.decode(data)
    match row.kind:
        case "integer":
            return int.from_bytes(data[: row.size], "big")
        case "scaled":
            return [values[axis] for axis in "xyz"]
        case "utc":
            ns = round(values["tenth_ms"] * 1e9)
            year = values["year"] + (2000 if values["year"] < 70 else 1900)
            fields = [values[name] for name in ("month", "day", "hour", "minute", "second")]
            return (min(ns, 2**32 - 1), year, *fields, 7)
        case "record":
            return tuple(
                round(value * signal.per_unit)
                for value, signal in zip(values.values(), row.signals, strict=True)
            )
    numbers = list(values.values())
    return numbers if len(numbers) > 1 else numbers[0]


@given(st.lists(frames(), max_size=40), st.sampled_from([0, 0x100, 0x19FF0000]))
def test_a_log_has_what_the_simple_decoder_gives(
    sent: list[tuple[int, bytes]], offset: int
) -> None:
    """One row for each frame, in order, whatever the groups are."""
    log = read([(offset + code, data) for code, data in sent], offset)
    assert log.traffic.frames == len(sent)
    for row in SAMPLED:
        own = [expected(code, data) for code, data in sent if code == row.code]
        if not own:
            continue
        assert row.quantity is not None
        column = log[row.quantity]
        if row.kind == "component":
            found = column.values[:, "XYZ".index(row.name[-1])]
            assert found[np.isfinite(found)].tolist() == own
        else:
            assert column.values.tolist() == own
    assert log.traffic.decoded + len(log.traffic.events) == len(sent)


CODES = (0x11, 0x21, 0x31, 0x34, 0x71, 0x76)


@given(
    st.lists(st.booleans(), min_size=4, max_size=120),
    st.integers(1, 3),
    st.randoms(use_true_random=False),
)
def test_groups_of_several_devices_stay_together(
    kept: list[bool], devices: int, random: Any
) -> None:
    """Devices send at once, in the order of the bus, and frames behind the header are lost."""
    numbers = range(20)
    offsets = [0, 0x100, 0x19FF0000][:devices]
    lost = iter(kept * 100)
    sent: list[tuple[int, bytes]] = []
    rows: dict[int, list[list[int]]] = {offset: [] for offset in offsets}
    for number in numbers:
        queues = []
        for offset in offsets:
            codes = [code for code in CODES if next(lost)]
            queues.append(group(number, *codes, offset=offset, seed=offset))
            rows[offset].append(codes)
        while any(queues):
            queue = random.choice([queue for queue in queues if queue])
            sent.append(queue.pop(0))
    log = read(sent, offsets)
    assert len(log) == len(numbers) * devices
    assert log.traffic.findings == ()
    for bid, offset in enumerate(offsets, 1):
        own = log.device(bid)
        assert own.packet_counter.tolist() == list(numbers)
        np.testing.assert_array_equal(own.time, np.arange(20) * 0.0025)
        for code in CODES:
            name = CAN_MESSAGES[code].quantity
            places = [number for number in numbers if code in rows[offset][number]]
            assert name is not None
            assert own.get(name) is None if not places else own[name].sample.tolist() == places


def test_a_log_of_can_has_all_that_a_log_has(tmp_path: Path) -> None:
    sent = [frame for n in range(100) if n not in (10, 11, 50) for frame in group(n, *CODES, 0x07)]
    sent = [(key, bytes.fromhex("140B1C11283B04D2") if key == 7 else data) for key, data in sent]
    log = xbus.read_can(arrays(sorted_groups(sent)))
    assert repr(log).startswith("<Log 97 samples, 0.25 s, 9 quantities, 3 samples lost in 2 gaps>")
    assert log.stats.lost_samples == 3
    assert log.gaps["sample"].tolist() == [10, 48]
    assert log.utc[0] == np.datetime64("2020-11-28T17:40:59.1234")
    assert log["quaternion"].coordinates == "ENU"
    assert log["acceleration"].precision == "Float32"
    assert log["acceleration"].rate == pytest.approx(97 / 0.25, rel=0.03)
    assert log[("quaternion", "ENU")] == log["quaternion"]
    assert pickle.loads(pickle.dumps(log)) == log  # noqa: S301
    assert pickle.loads(pickle.dumps(log["delta_v"])) == log["delta_v"]  # noqa: S301
    table = log.to_arrow()
    assert table["acceleration_x"].to_pylist() == log["acceleration"]["x"].tolist()
    log.to_parquet(tmp_path / "log.parquet")
    assert len(log.resample(100, "acceleration")) == 25


def sorted_groups(sent: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
    """The frames in the order of the bus: each group by identifier."""
    starts = [at for at, (key, _) in enumerate(sent) if key == 5] + [len(sent)]
    return [frame for a, b in pairwise(starts) for frame in sorted(sent[a:b])]


def test_frames_in_another_order_than_the_bus_sends() -> None:
    """Groups then begin with SampleTime: of a gateway, or of a device that does not sort."""
    sent = [frame for n in range(50) for frame in [*group(n), *group(n, 0x34, 0x21, 0x11)[2:]]]
    log = read(sent)
    assert len(log) == 50
    assert all(len(column) == 50 for column in log.values())
    assert log.traffic.findings == ()


def test_a_group_whose_header_was_lost_is_a_sample() -> None:
    groups = [group(n, 0x11, 0x34) if n % 2 else group(n, 0x21, 0x34) for n in range(20)]
    del groups[11][:2]  # 11 after 34
    log = read([frame for own in groups for frame in own])
    assert len(log) == 20
    assert log["status_word"].sample.tolist() == list(range(1, 20, 2))
    assert log["acceleration"].sample.tolist() == list(range(20))


def test_identifiers_of_its_own_in_another_order() -> None:
    """The lowest identifier comes first, and SampleTime last."""
    ids = {"acceleration": 0x10, "Quaternion": EXTENDED | 0x11, "sample_time_fine": 0x7FF}
    sent = [
        (ids[name], group(n, 0x34, 0x21)[at][1])
        for n in range(20)
        for name, at in (("acceleration", 2), ("Quaternion", 3), ("sample_time_fine", 0))
    ]
    sent.sort(key=lambda frame: 0)
    log = read([sent[3 * n + k] for n in range(20) for k in (1, 0, 2)], ids)
    assert [len(column) for column in log.values()] == [20] * 3
    np.testing.assert_array_equal(log["acceleration"].time, np.arange(20) * 0.0025)


def test_counters_and_times_wrap() -> None:
    def frames_of(number: int) -> list[tuple[int, bytes]]:
        ticks = (2**32 - 1000 + 100 * number) % 2**32
        return [(5, ticks.to_bytes(4, "big")), (6, ((65530 + number) % 65536).to_bytes(2, "big"))]

    log = read([frame for n in range(20) for frame in frames_of(n)])
    assert log.packet_counter.tolist() == list(range(65530, 65550))
    np.testing.assert_allclose(np.diff(log.time), 0.01, rtol=1e-6)
    assert log.stats.lost_samples == 0


#: Places of the frames of `group(n, 0x34)`.
TIME, COUNTER, REST, ALL = (0,), (1,), (2,), (0, 1, 2)


@pytest.mark.parametrize(
    ("missing", "lost", "gaps"),
    [
        ({10: ALL}, 1, [10]),
        ({10: COUNTER}, 0, []),
        ({10: COUNTER, 11: COUNTER}, 0, []),
        ({10: COUNTER, 11: ALL}, 1, [11]),
        ({10: ALL, 11: COUNTER}, 1, [11]),
        ({10: COUNTER, 20: ALL}, 1, [20]),
        ({10: (*COUNTER, *REST)}, 0, []),
        # The frames that are left are part of the group before, or could be.
        ({10: (*TIME, *COUNTER)}, 1, [11]),
        # A counter that is sent less often counts all groups.
        ({n: COUNTER for n in range(30) if n % 10}, 0, []),
        ({n: COUNTER if n != 15 else ALL for n in range(30) if n % 10}, 1, [19]),
    ],
)  # fmt: skip
def test_a_lost_counter_is_no_lost_sample(
    missing: dict[int, tuple[int, ...]], lost: int, gaps: list[int]
) -> None:
    log = read(
        [
            frame
            for n in range(30)
            for place, frame in enumerate(group(n, 0x34))
            if place not in missing.get(n, ())
        ]
    )
    assert log.stats.lost_samples == lost
    assert log.gaps["sample"].tolist() == gaps


def test_host_times_are_those_of_the_capture() -> None:
    sent = [frame for n in range(400) for frame in group(n, 0x34)]
    time, *rest = arrays(sent)
    time = 1.8e9 + np.repeat(np.arange(400) * 0.0025, 3)
    log = xbus.read_can((time, *rest))
    np.testing.assert_allclose(log.host_time, time[::3], atol=1e-6)
    assert log.host_clock is not None
    untimed = xbus.read_can((time, *rest), {"GroupCounter": 6, "Acceleration": 0x34})
    np.testing.assert_array_equal(untimed.host_time, time[1::3])
    assert np.isnan(untimed.time).all()
    rated = xbus.read_can((time, *rest), {"GroupCounter": 6, "Acceleration": 0x34}, rate=400)
    np.testing.assert_allclose(rated.time, np.arange(400) / 400)


# Traffic that is not as it should be

GOOD = [frame for n in range(100) for frame in group(n, 0x34)]
REMOTE, ERROR = 1 << 30, 1 << 29


@pytest.mark.parametrize(
    ("sent", "finding", "undecoded"),
    [
        (GOOD, None, 0),
        ([*GOOD, (0x34, bytes(4))],
         "1 frame of Acceleration (034) with 4 bytes instead of 6: not decoded; if another node", 1),
        ([*GOOD, *group(100)[:2], (0x34, bytes(8))],
         "1 frame of Acceleration (034) with 8 bytes instead of 6: the rest is ignored; if another node", 0),
        ([*GOOD, (0x31, b"\x7f" * 7)], "1 frame of DeltaV (031) with an exponent above 30", 1),
        ([*GOOD, (0x23, bytes(8))], "1 frame of RotationMatrix (023): not decoded, because no source", 1),
        ([*GOOD, (0x123, bytes(8))] * 2,
         "2 frames with 1 identifier of no known device: 123 (2); if an MTi has one of them", 0),
        ([*GOOD, (ERROR, bytes(8))] * 2, "2 error frames: the bus is disturbed; check the terminations", 2),
        ([*GOOD, (REMOTE | 0x34, b"")], "1 remote frame: skipped; an MTi does not answer them", 1),
        ([*GOOD, (1, b"\1"), (1, b"\1")],
         "device 1 reports 2 times that its output buffer overflowed: frames are missing", 0),
        ([*GOOD, (2, b"\7")], "device 1 sends Warning 7 1 time; the code is not documented", 0),
        ([frame for frame in GOOD if frame[0] != 5], "device 1 sends no SampleTime: its samples have no", 0),
        ([frame for frame in GOOD if frame[0] != 6], "device 1 sends no GroupCounter", 0),
        ([*GOOD, *group(100, 0x34)[1:]], "1 sample of 101 of device 1 without SampleTime", 0),
        ([*GOOD, *group(100, 0x73, 0x75)], "1 row of position_ecef without all three components", 0),
        ([frame for n in range(100) for frame in (*group(n, 0x34), *group(n + 5000, 0x34))],
         "two devices use the identifiers of device 1", 0),
        ([frame for n in range(100) for pair in zip(*[group(n, 0x34)] * 2, strict=True) for frame in pair],
         "two devices use the identifiers of device 1", 0),
        ([(EXTENDED | 0x19FF0000 + key, data) for key, data in GOOD],
         "they fit an MTi with the offset 0x19FF0000; try ids=0x19FF0000", 0),
        ([(EXTENDED | key, data) for key, data in GOOD],
         "they fit an MTi with the offset 0x80000000; try ids=0x80000000", 0),
        ([(0x200 + key, data) for key, data in GOOD], "the offset 0x200; try ids=0x200", 0),
    ],
)  # fmt: skip
def test_what_is_unusual_is_counted_and_said(
    sent: list[tuple[int, bytes]], finding: str | None, undecoded: int
) -> None:
    log = read(sent)
    traffic = log.traffic
    assert traffic.findings == () if finding is None else finding in "\n".join(traffic.findings)
    assert ("finding" in repr(log)) == bool(traffic.findings)
    assert len(traffic.undecoded) == undecoded
    # Nothing is lost: each frame is a row of a column, or counted elsewhere.
    rows = sum(
        np.isfinite(column.values).sum() if name == "position_ecef" else len(column)
        for name, column in log.items()
    )
    counted = undecoded + len(traffic.events) + sum(traffic.unknown.values())
    assert rows == traffic.decoded
    assert rows + counted == len(sent)
    # A suggestion works.
    if finding is not None and (ids := re.search(r"ids=(\w+)", finding)):
        assert len(read(sent, int(ids[1], 0))) == 100


@given(
    st.lists(
        st.tuples(
            st.one_of(st.sampled_from([*CAN_MESSAGES]), st.integers(0, 2**32 - 1)),
            st.binary(max_size=12),
        ),
        max_size=60,
    )
)
def test_any_traffic_is_read(sent: list[tuple[int, bytes]]) -> None:
    log = read(sent)
    traffic = log.traffic
    counted = len(traffic.undecoded) + len(traffic.events) + sum(traffic.unknown.values())
    assert traffic.decoded + counted == len(sent)
    assert len(log.offset) == len(log)
    assert list(log.offset) == sorted(log.offset)
    assert repr(log)


def test_strict_raises_at_the_first_frame_that_is_not_decoded() -> None:
    with pytest.raises(
        xbus.DecodeError, match=r"frame 300 \(034, 4 bytes\) cannot be decoded: short"
    ) as error:
        read([*GOOD, (0x34, bytes(4)), *GOOD], strict=True)
    assert error.value.offset == 300
    assert len(read([*GOOD, (0x123, b"")], strict=True)) == 100


# Files

SUFFIXES = ["asc", "blf", "log", "trc", "csv", "mf4"]


def messages(sent: Sequence[tuple[int, bytes]]) -> list[Any]:
    return [
        can.Message(
            timestamp=1.7e9 + at / 1000, arbitration_id=key & ~EXTENDED, data=data,
            is_extended_id=key > 0x7FF, channel=0,
        )
        for at, (key, data) in enumerate(sent)
    ]  # fmt: skip


def write(path: Path, sent: Sequence[tuple[int, bytes]]) -> Path:
    with can.Logger(path) as logger:
        for message in messages(sent):
            logger(message)
    return path


TWO = [
    frame
    for n in range(30)
    for offset in (0, EXTENDED | 0x1000)
    for frame in group(n, *CODES, offset=offset)
]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_captures_of_other_software(tmp_path: Path, suffix: str) -> None:
    if suffix == "mf4":
        pytest.importorskip("asammdf")
    path = write(tmp_path / f"drive.{suffix}", TWO)
    log, again = xbus.read_can(path, [0, 0x1000]), read(TWO, [0, 0x1000])
    assert log.traffic.findings == ()
    assert list(log) == list(again)
    for key, column in log.items():
        np.testing.assert_array_equal(column.values, again[key].values)
        np.testing.assert_array_equal(column.sample, again[key].sample)
    # Text formats have microseconds, and .trc and .asc a date in the local time zone.
    np.testing.assert_allclose(
        np.diff(log.host_time), np.diff(log.host_time[::2]).mean() / 2, atol=0.1
    )
    assert log.host_time[0] == pytest.approx(1.7e9, abs=86400)


def test_messages_of_python_can_are_read() -> None:
    sent = messages(GOOD)
    assert xbus.read_can(iter(sent))["acceleration"] == xbus.read_can(sent)["acceleration"]
    for at, message in enumerate(sent):
        message.channel = "can1" if at >= 150 else "can0"
    log = xbus.read_can(sent)
    assert "2 channels (can0, can1), which are read as one bus" in log.traffic.findings[0]
    assert len(xbus.read_can(sent, channel="can1")) == 50


def test_an_error_frame_of_candump_has_no_channel(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    path.write_text(
        "(1.0) can0 005#00000000\n(1.1) can0 20000088#0000000000000000\n(1.2) can0 005#000003E8\n"
    )
    log = xbus.read_can(path, channel="can0")
    assert (len(log), log.traffic.frames) == (2, 2)
    first, *_ = xbus.read_can(path).traffic.findings
    assert first.startswith("1 error frame: the bus is disturbed")
    with pytest.raises(ValueError, match=r"it has can0$"):
        xbus.read_can(path, channel="can1")


@pytest.mark.parametrize("size", [0, 40, 100, 144, 160, 4000, -100, -1])
def test_a_truncated_blf(tmp_path: Path, size: int) -> None:
    """What is left is read, and a sentence says what is missing."""
    path = write(tmp_path / "drive.blf", [frame for n in range(2000) for frame in group(n, 0x34)])
    path.write_bytes(path.read_bytes()[:size])
    if 0 <= size < 72:
        with pytest.raises(
            ValueError, match=r"drive\.blf is no \.blf capture: .*; check how it was made"
        ):
            xbus.read_can(path)
        return
    log = xbus.read_can(path)
    assert len(log) <= 2000
    assert "truncated" in log.traffic.findings[0]


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("content", [b"", b"\xff" * 100, b"(1.0) can0 034#0180\n(2.0) can0 0zz#"])
def test_files_that_are_no_captures(tmp_path: Path, suffix: str, content: bytes) -> None:
    """They raise a ValueError, or have no samples and a sentence, or none at all."""
    path = tmp_path / f"drive.{suffix}"
    path.write_bytes(content)
    try:
        log = xbus.read_can(path)
    except ValueError as error:
        assert f"drive.{suffix} is no .{suffix} capture" in str(error)  # noqa: PT017
    else:
        assert len(log) == 0


def test_a_missing_capture_keeps_its_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        xbus.read_can(tmp_path / "none.blf")


# The DBC file

cantools = pytest.importorskip("cantools.database")
DBC = cantools.load_string(dbc_text(), "dbc", strict=True)


@given(frames(exponents=(8, 17)))
def test_cantools_with_our_dbc_agrees_with_our_decoder(frame: tuple[int, bytes]) -> None:
    code, data = frame
    values = {
        name.partition("_")[0] if code == 0x31 else name: value
        for name, value in DBC.decode_message(code, data, decode_choices=False).items()
    }
    own = CAN_MESSAGES[code].decode(data)
    assert values.keys() == own.keys()
    for name, value in own.items():
        assert values[name] == pytest.approx(value, rel=1e-15, abs=0)
    assert DBC.encode_message(code, DBC.decode_message(code, data), strict=False) == data


def test_the_dbc_of_the_package_is_that_of_the_table() -> None:
    def rows(text: str) -> list[tuple[object, ...]]:
        found: list[tuple[object, ...]] = []
        for m in cantools.load_string(text, "dbc").messages:
            found.append((m.frame_id, m.is_extended_frame, m.name, m.length, m.comment, m.senders))
            for s in m.signals:
                found.append((s.name, s.start, s.length, s.byte_order, s.is_signed, s.receivers))
                found.append((s.scale, s.offset, s.unit, s.minimum, s.maximum))
                found.append((s.is_multiplexer, s.multiplexer_ids, s.multiplexer_signal))
        return found

    if rows(made := make_dbc()) != rows(dbc_text()):
        FILE.write_text(made, "ascii", newline="\n")
        pytest.fail(f"{FILE.name} was written again; run the test once more")


def test_the_dbc_of_the_package_needs_no_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cantools.database", None)
    assert dbc_text().count("\nBO_ ") == 26
    with pytest.raises(ImportError, match=r"xbus-mti\[can\]"):
        dbc_text(0x100)


def test_the_dbc_has_every_message_with_a_layout() -> None:
    assert [message.frame_id for message in DBC.messages] == [
        row.code for row in CAN_MESSAGES.values() if row.signals
    ]
    two = cantools.load_string(dbc_text([0x100, {"Acceleration": EXTENDED | 0x34}]), "dbc")
    assert two.get_message_by_name("Quaternion_1").frame_id == 0x121
    second = two.get_message_by_name("Acceleration_2")
    assert (second.frame_id, second.is_extended_frame) == (0x34, True)


def test_quantities_that_only_can_has_are_no_packets() -> None:
    assert not CAN_QUANTITIES.keys() & QUANTITIES.keys()
    ids = {row.id for row in QUANTITIES.values()}
    assert not {row.id for row in CAN_QUANTITIES.values()} & ids
