"""Logs of older devices, whose MTData has the layout of OutputMode and OutputSettings.

`expected` decodes each message by itself with the codec of single messages: the slow twin of the log decoder.
"""

from __future__ import annotations

import io
import json
import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import xbus
from test_cli import run, sentence
from xbus import MessageId, _core, encode_frame
from xbus.log.legacy import legacy_outputs
from xbus.protocol.tables import COLUMN_QUANTITIES
from xbus.wire.mtdata import decode_mtdata, encode_mtdata, mtdata_layout

SENSORS = (0x0006, 0x0000_0001)
EULER = (0x0004, 0x0000_0005)
#: Everything of an MTi-G, in each number format.
EVERYTHING = [(0x1837, 0x8000_0005 | precision << 8) for precision in range(4)]


def messages(
    output: tuple[int, int], count: int, *, start: int = 0, seed: int = 1, bid: int = 0xFF
) -> bytes:
    """Messages with random numbers; the counter counts."""
    random = np.random.default_rng(seed)
    arrays: list[Any] = []
    for item in _core.mtdata_layout(*output):
        row = COLUMN_QUANTITIES[item.name]
        if item.name == "packet_counter":
            arrays.append((start + np.arange(count)) % 65536)
        elif item.name == "sample_time_fine":
            arrays.append(100 * (start + np.arange(count)))
        elif row.kind == "real":
            arrays.append(random.normal(size=(count, row.numbers)))
        elif row.kind == "struct":
            arrays.append(random.integers(0, 100, (count, len(row.fields))))
        else:
            shape = (count, *row.shape)
            arrays.append(random.integers(0, 100, shape))
    return _core.encode_mtdata(*output, arrays, bid).data


def configuration(
    *outputs: tuple[int, int], master: int = 0x0150_0618, lengths: list[int] | None = None
) -> bytes:
    """A Configuration with a period of 10 ms, and an entry for each device."""
    sizes = lengths or [mtdata_layout(*output).size for output in outputs]
    payload = struct.pack(">IHH88xH", master, 1152, 0, len(outputs))
    for number, (output, size) in enumerate(zip(outputs, sizes, strict=True)):
        device = master if len(outputs) == 1 else 0x0030_0000 + number
        payload += struct.pack(">IHHIH3B3B", device, size, *output, 0, 1, 2, 3, 0, 1, 0)
    return encode_frame(MessageId.Configuration, payload)


def replies(output: tuple[int, int], *, bid: int = 0xFF) -> bytes:
    mode, bits = struct.pack(">H", output[0]), struct.pack(">I", output[1])
    frames = [(MessageId.ReqOutputModeAck, mode), (MessageId.ReqOutputSettingsAck, bits)]
    return b"".join(encode_frame(mid, payload, bid=bid) for mid, payload in frames)


def expected(data: bytes, output: tuple[int, int]) -> Iterator[dict[Any, Any]]:
    """The values of each message."""
    scanner = xbus.Scanner()
    for message in [*scanner.feed(data), *scanner.close()]:
        if isinstance(message, xbus.Message) and message.mid == MessageId.MTData:
            yield dict(decode_mtdata(message.payload, *output).items())


def check(log: xbus.Log, data: bytes, output: tuple[int, int]) -> None:
    rows = list(expected(data, output))
    assert len(log) == len(rows)
    for name, column in log.items():
        assert isinstance(name, str)
        for row, value in zip(rows, column.values, strict=True):
            if isinstance(row[name], dict):
                assert dict(zip(column.fields, value.item(), strict=True)) == row[name]
            else:
                np.testing.assert_array_equal(value, row[name])


@pytest.mark.parametrize(
    "output", [SENSORS, EULER, (0x4000, 0x0100_0001), (0x0200, 2), *EVERYTHING]
)
def test_a_log_is_its_messages(output: tuple[int, int]) -> None:
    data = messages(output, 300)
    log = xbus.read_log(data, legacy=output)
    assert list(log) == list(dict.fromkeys(item.name for item in mtdata_layout(*output).items))
    assert (log.stats.unfit, log.stats.messages, log.stats.skipped_bytes) == (0, 0, 0)
    check(log, data, output)


def test_notebooks_for_mtdata2_work() -> None:
    data = configuration((0x1836, 0x0000_0005)) + messages((0x1836, 0x0000_0005), 50)
    log = xbus.read_log(data)
    assert log["acceleration"].values.shape == (50, 3)
    assert log["euler_angles"].fields == ("roll", "pitch", "yaw")
    assert (log["euler_angles"].coordinates, log["baro_pressure"].unit) == ("NWU", "Pa")
    assert log["baro_pressure"].values.dtype == np.uint32
    assert log.device_id == 0x0150_0618
    assert log.to_pandas(["lat_lon", "velocity_xyz"]).shape == (50, 7)
    assert log.stats.lost_samples == 0


def test_losses_by_the_counter() -> None:
    data = configuration(SENSORS) + messages(SENSORS, 50) + messages(SENSORS, 50, start=60)
    log = xbus.read_log(data)
    assert (log.stats.lost_samples, log.stats.gaps) == (10, 1)
    wrapping = configuration(SENSORS) + messages(SENSORS, 50, start=65530)
    assert xbus.read_log(wrapping).packet_counter[-1] == 65579


def test_times_from_sample_time_fine_or_a_rate() -> None:
    stamped = (0x0004, 0x0200_0001)
    log = xbus.read_log(messages(stamped, 100), legacy=stamped)
    assert (log.time[0], log.duration) == (0, 0.99)
    log = xbus.read_log(messages(SENSORS, 100), legacy=SENSORS, rate=50)
    assert (log.time[0], log.duration) == (0, 1.98)


#: How a log has its settings.
SOURCES = {
    "Configuration": configuration(SENSORS),
    "replies": replies(SENSORS),
    "acknowledged requests": bytes.fromhex("FAFFD002000629FAFFD10030FAFFD204000000012AFAFFD3002E"),
}


@pytest.mark.parametrize("head", SOURCES.values(), ids=SOURCES)
def test_settings_in_the_log(head: bytes) -> None:
    data = head + messages(SENSORS, 100)
    log = xbus.read_log(data, legacy=EULER)  # the log says more than the caller
    assert (len(log), log.stats.unfit) == (100, 0)
    check(log, messages(SENSORS, 100), SENSORS)


def test_requests_that_are_refused_have_no_effect() -> None:
    refused = encode_frame(MessageId.SetOutputSettings, b"\0\0\0\5") + encode_frame(0x42, b"\3")
    log = xbus.read_log(configuration(SENSORS) + refused + messages(SENSORS, 10))
    assert len(log) == 10


def test_a_data_length_of_0_says_that_the_device_sends_mtdata2() -> None:
    stale = configuration((0x0036, 3), lengths=[0])
    data = stale + messages(SENSORS, 10) + xbus.encode_sample({"temperature": 20.0})
    log = xbus.read_log(data)
    assert (len(log), log.stats.unfit) == (1, 10)
    assert len(xbus.read_log(data, legacy=SENSORS)) == 11


def test_settings_that_change_are_followed() -> None:
    data = configuration(SENSORS) + messages(SENSORS, 40) + replies(EULER) + messages(EULER, 30)
    log = xbus.read_log(data)
    assert (len(log["acceleration"]), len(log["euler_angles"]), len(log)) == (40, 30, 70)
    assert log["euler_angles"].sample.tolist() == list(range(40, 70))


def test_an_acknowledgement_without_its_request_leaves_the_settings_unknown(tmp_path: Path) -> None:
    """A log of only what the device sent: the lengths still fit, but the values are others."""
    before, after = (0x0004, 0x0000_0000), (0x0001, 0x0100_0000)
    assert mtdata_layout(*before).size == mtdata_layout(*after).size
    set_mode = encode_frame(MessageId.SetOutputMode, struct.pack(">H", after[0]))
    set_form = encode_frame(MessageId.SetOutputSettings, struct.pack(">I", after[1]))
    mode_ack = encode_frame(MessageId.SetOutputModeAck)
    form_ack = encode_frame(MessageId.SetOutputSettingsAck)
    data = configuration(before) + messages(before, 5) + mode_ack + form_ack + messages(after, 3)
    assert (len(log := xbus.read_log(data)), log.stats.unfit) == (5, 3)
    assert len(xbus.read_log(data, legacy=after)["gyro_temperature"]) == 3
    log = xbus.read_log(data + configuration(after) + messages(after, 4))
    assert (len(log["quaternion"]), len(log["temperature"]), log.stats.unfit) == (5, 4, 3)
    path = tmp_path / "old.mtb"
    path.write_bytes(data + configuration(after) + messages(after, 400))
    assert run("split", str(path), "--size", "1kB", "--out-dir", str(tmp_path / "x")).exit_code == 0
    pieces = [xbus.read_log(piece) for piece in sorted((tmp_path / "x").iterdir())]
    assert sum(map(len, pieces)) == 405
    assert sum(piece.stats.unfit for piece in pieces) == 3
    # A request that is repeated is acknowledged twice.
    changed = set_mode * 2 + mode_ack * 2 + set_form * 2 + form_ack * 2
    log = xbus.read_log(configuration(before) + changed + messages(after, 3))
    assert (list(log), log.stats.unfit) == (["temperature", "gyro_temperature"], 0)


def test_a_length_that_does_not_fit_is_counted_and_kept() -> None:
    data = configuration(SENSORS) + messages(SENSORS, 5) + messages(EULER, 3) + messages(SENSORS, 4)
    log = xbus.read_log(data)
    assert (len(log), log.stats.unfit, log.stats.messages) == (9, 3, 4)
    kept = log.messages.with_mids(MessageId.MTData)
    assert [len(message.payload) for message in kept] == [14, 14, 14]
    assert (
        "MTData (0x32), 42 bytes: no OutputMode and OutputSettings for 14 bytes; 0004:00000105 or"
        in str(log.undecoded[0])
    )
    with pytest.raises(
        xbus.DecodeError, match="it has 14 bytes, and with the settings in force 54"
    ):
        xbus.read_log(data, strict=True)


def test_a_log_without_settings_names_the_remedy(tmp_path: Path) -> None:
    path = tmp_path / "old.bin"
    path.write_bytes(messages(SENSORS, 20))
    text = " ".join(run("info", str(path)).stdout.split())
    assert (
        "20 messages MTData (0x32), 1.1 kB: no OutputMode and OutputSettings for 54 bytes" in text
    )
    assert "0006:00000001" in text
    result = run("decode", str(path), "-o", str(tmp_path / "x.csv"))
    assert "nothing was decoded" in sentence(result)
    assert "--legacy" in sentence(result)
    with pytest.raises(xbus.DecodeError, match="pass them as legacy"):
        xbus.read_log(path, strict=True)


@pytest.mark.parametrize(
    ("legacy", "error", "says"),
    [
        ((0x10000, 0), ValueError, "do not fit"),
        ((6, -1), ValueError, "do not fit"),
        ((0x8000, 0), ValueError, "MT9"),
        ([(6, 1)] * 32, ValueError, "at most 31 trackers"),
        ("0006:00000001", TypeError, "legacy is a pair"),
        ([6, 1], TypeError, "legacy is a pair"),
        ((6, 1, 2), TypeError, "legacy is a pair"),
    ],
)
def test_wrong_settings_are_refused(legacy: Any, error: type[Exception], says: str) -> None:
    with pytest.raises(error, match=says):
        xbus.read_log(b"", legacy=legacy)


@pytest.mark.parametrize("text", ["0006", "6:x", "0006:000000001", "10006:1", "8000:0", "-6:1"])
def test_wrong_options_are_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "old.bin"
    path.write_bytes(messages(SENSORS, 1))
    assert run("info", str(path), "--legacy", text).exit_code == 2


# Parts


def long_log() -> bytes:
    """Settings that change, an Xbus Master, damage, and MTData2 between them."""
    sample = xbus.encode_sample({"packet_counter": 7, "temperature": 20.0})
    two = [(0x0006, 0), (0x0004, 4)]
    size = 2 + sum(mtdata_layout(*output).size for output in two)
    random = np.random.default_rng(5)
    shared = b"".join(
        encode_frame(MessageId.MTData, struct.pack(">H", at) + random.bytes(size - 2))
        for at in range(200)
    )
    data = bytearray(
        messages(SENSORS, 300)
        + configuration(SENSORS)
        + messages(SENSORS, 400)
        + sample * 20
        + replies(EULER)
        + messages(EULER, 300)
        + configuration(*two, master=0x0110_0001)
        + shared
        + replies((0x0002, 0), bid=2)
        + shared
        + configuration(SENSORS)
        + messages(SENSORS, 200)
    )
    for at in random.integers(0, len(data), 60).tolist():
        data[at] ^= 0x20
    return bytes(data)


def content(*logs: xbus.Log) -> dict[str, Any]:
    """Everything of a log, or of its parts."""
    arrays: dict[str, list[npt.NDArray[Any]]] = {}
    counts: Counter[str] = Counter()
    for log in logs:
        for key, column in log.items():
            name = f"{key} {column.coordinates}"
            arrays.setdefault(name, []).append(column.values)
            arrays.setdefault(f"samples of {name}", []).append(column.sample)
        own: dict[str, npt.NDArray[Any]] = {
            "offset": log.offset,
            "counter": log.packet_counter,
            "bid": log.bid,
            "mids": np.asarray(log.messages.mid),
            "time": log.time,
        }
        for name, array in own.items():
            arrays.setdefault(name, []).append(array)
        counts.update({"samples": len(log), **vars(log.stats)})
    joined = {name: np.concatenate(parts) for name, parts in arrays.items()}
    return {**counts, **{name: (one.dtype, one.tobytes()) for name, one in joined.items()}}


def test_parts_are_the_whole(tmp_path: Path) -> None:
    data, legacy = long_log(), (0x0006, 1)
    whole = content(xbus.read_log(data, threads=1, legacy=legacy))
    for size in (777, 20_000):
        assert content(*xbus.iter_log(data, block_bytes=size, legacy=legacy)) == whole
        parts = xbus.split_log(data, block_bytes=size, legacy=legacy)
        assert content(*(part.read() for part in parts)) == whole
    path = tmp_path / "long.bin"
    path.write_bytes(data * 80)  # several blocks for each thread
    single = xbus.read_log(path, threads=1, legacy=legacy)
    assert single.stats.bytes > 2 * (2 << 20)
    assert content(xbus.read_log(path, threads=2, legacy=legacy)) == content(single)


def test_tables_of_parts_are_those_of_the_log() -> None:
    import pyarrow as pa

    data = long_log()
    table = xbus.read_log(data, legacy=SENSORS).to_arrow()
    batches = xbus.log_batches(data, block_bytes=9000, legacy=SENSORS)
    joined = pa.Table.from_batches(batches, batches.schema)
    assert joined.schema == table.schema
    assert repr(joined.to_pydict()) == repr(table.to_pydict())  # also NaN
    frame = xbus.scan_log(data, block_bytes=9000, legacy=SENSORS).collect()
    assert frame.columns == table.column_names
    assert len(frame) == len(table)


@settings(max_examples=30, deadline=None)
@given(
    st.sampled_from([0x0001, 0x0006, 0x0007, 0x0808, 0x1830, 0x4000, 0x0200, 0x1A3F]),
    st.integers(0, 0xFFFF_FFFF),
    st.integers(0, 2**32),
)
def test_random_settings(mode: int, bits: int, seed: int) -> None:
    try:
        size = mtdata_layout(mode, bits).size
    except ValueError:
        return
    data = messages((mode, bits), 12, seed=seed)
    log = xbus.read_log(configuration((mode, bits)) + data)
    assert log.stats.unfit == 0
    assert size > 0
    # Where a quantity is selected twice, the column has both rows.
    names = [item.name for item in mtdata_layout(mode, bits).items]
    assert {name: len(column) for name, column in log.items()} == {
        name: 12 * names.count(name) for name in names
    }
    if len(set(names)) == len(names):
        check(log, data, (mode, bits))


@given(st.binary(max_size=400), st.integers(0, 0xFFFF), st.integers(0, 0xFFFF_FFFF))
def test_any_bytes_are_a_log(noise: bytes, mode: int, bits: int) -> None:
    try:
        legacy_outputs((mode, bits))
    except ValueError:
        return
    # The first byte keeps the noise from being taken for a compressed file.
    data = b"\0" + noise + encode_frame(MessageId.MTData, noise) + messages(SENSORS, 3)
    log = xbus.read_log(data, legacy=(mode, bits))
    assert log.stats.bytes == len(data)
    assert len(log.to_arrow()) == len(log)


# Xbus Master


def test_an_xbus_master() -> None:
    """Two quaternions behind a counter, as the vendor's library lays them out."""
    frame = bytes.fromhex(
        "FAFF322212343F8000000000000000000000000000003F0000003F0000003F0000003F000000AC"
    )
    outputs = [(0x0004, 0), (0x0004, 0)]
    trackers = [[1.0, 0, 0, 0], [0.5] * 4]
    payloads = [
        encode_mtdata({"quaternion": q}, *output)[4:-1]
        for q, output in zip(trackers, outputs, strict=True)
    ]
    assert encode_frame(MessageId.MTData, b"\x12\x34" + b"".join(payloads)) == frame
    for log in (
        xbus.read_log(frame * 3, legacy=outputs),
        xbus.read_log(configuration(*outputs, master=0x0110_0001) + frame * 3),
    ):
        assert (len(log), log.bid.tolist()) == (6, [1, 2] * 3)
        assert log["packet_counter"].values.tolist() == [4660] * 6
        first, second = log.device(1), log.device(2)
        assert first["quaternion"].values[0].tolist() == [1, 0, 0, 0]
        assert second["quaternion"].values[0].tolist() == [0.5] * 4
    assert [device.device_id for device in log.devices] == [0x0030_0000, 0x0030_0001]


def test_info_about_an_xbus_master_and_the_rate_in_its_configuration(tmp_path: Path) -> None:
    outputs, sizes = [(0x0004, 0), (0x0004, 0)], [16, 16]
    frames = encode_frame(MessageId.MTData, bytes(34)) * 3
    path = tmp_path / "master.mtb"
    path.write_bytes(configuration(*outputs, master=0x0110_0001, lengths=sizes) + frames)
    text = " ".join(run("info", str(path)).stdout.split())
    assert "BID 1 id 00300000, 3 samples BID 2 id 00300001, 3 samples" in text
    assert "--rate 100 derives them from the packet counter" in text
    assert "join several recordings" not in text


# The command line


@pytest.fixture
def old(tmp_path: Path) -> str:
    path = tmp_path / "old.bin"
    path.write_bytes(messages(SENSORS, 200) + replies(EULER) + messages(EULER, 200, start=200))
    return str(path)


def test_commands_take_the_settings(old: str, tmp_path: Path) -> None:
    legacy = ("--legacy", "0006:00000001")
    assert "acceleration" in run("info", old, *legacy).stdout
    table = tmp_path / "old.csv"
    assert run("decode", old, "-o", str(table), *legacy).exit_code == 0
    assert len(table.read_text().splitlines()) == 401
    lines = run("dump", old, "--no-hex", *legacy).stdout.splitlines()
    assert "acceleration x=" in lines[0]
    assert "euler_angles (NWU) roll=" in lines[-1]
    [first, *_] = run("dump", old, "--json", *legacy).stdout.splitlines()
    assert json.loads(first)["packets"][-1]["name"] == "packet_counter"
    assert "no OutputMode" in run("dump", old, "--no-hex").stdout.splitlines()[0]
    page = tmp_path / "old.html"
    assert run("report", old, "-o", str(page), *legacy).exit_code == 0
    shown = run("monitor", old, "--once", "1", "--json", "--speed", "1000", *legacy)
    assert shown.exit_code == 0


def test_a_cut_keeps_the_settings(tmp_path: Path) -> None:
    """They are in force where the cut starts, and the message with them is before it."""
    stamped, others = (0x0004, 0x0200_0001), (0x0004, 0x0200_0005)
    data = configuration(stamped) + messages(stamped, 300) + replies(others)
    path, out = tmp_path / "old.mtb", tmp_path / "cut.mtb"
    path.write_bytes(data + messages(others, 300, start=300))
    assert run("cut", str(path), "-o", str(out), "--from", "4", "--to", "5").exit_code == 0
    log = xbus.read_log(out)
    assert (len(log), log.stats.unfit, list(log)) == (
        100, 0, ["euler_angles", "packet_counter", "sample_time_fine"],
    )  # fmt: skip
    assert len(xbus.read_log(path, between=(4, 5))) == 100


def test_a_file_object_is_read_in_parts() -> None:
    data = configuration(SENSORS) + messages(SENSORS, 100)
    assert sum(map(len, xbus.iter_log(io.BytesIO(data), block_bytes=500))) == 100
