"""The shape of a log: all parts have the columns of the whole log, so that their tables are one table."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

import streams
import xbus
from conftest import OWN_CAPTURES, damaged_streams
from streams import frame, mtdata2, packet
from xbus import split_log
from xbus.log import MissingDeviceError

FLOAT32 = bytes(12)
FP1632 = bytes(18)


def same(one: pa.Table, other: pa.Table) -> bool:
    """Returns whether two tables are equal to the bit, with the metadata of their fields."""
    return one.schema.equals(other.schema, check_metadata=True) and _content(one) == _content(other)


def _content(table: pa.Table) -> list[Any]:
    columns = (column.combine_chunks() for column in table.columns)
    return [
        (column.null_count, [value.as_py() for value in column.is_valid()], _bytes(column))
        for column in columns
    ]


def _bytes(column: pa.Array) -> bytes:
    """Returns the bits of the values, those of nulls as zeros."""
    import pyarrow.compute as pc

    width = column.type.bit_width
    integers = column.view(
        {8: pa.uint8(), 16: pa.uint16(), 32: pa.uint32(), 64: pa.uint64()}[width]
    )
    return bytes(pc.fill_null(integers, 0).to_numpy(zero_copy_only=False).tobytes())


def table_of(
    parts: list[xbus.LogPart], keys: Any = None, quantities: Any = None, *, raw: bool = False
) -> pa.Table:
    """Joins the tables of the parts, which works only if all have one schema."""
    logs = [part.read(quantities=quantities) for part in parts]
    return joined(parts[0].empty(quantities=quantities), logs, keys, raw=raw)


def joined(shape: xbus.Log, logs: list[xbus.Log], keys: Any = None, *, raw: bool) -> pa.Table:
    schema = shape.to_arrow(keys, raw=raw).schema
    tables = [log.to_arrow(keys, raw=raw) for log in logs]
    assert all(table.schema.equals(schema, check_metadata=True) for table in tables)
    return pa.concat_tables([schema.empty_table(), *tables])


@given(damaged_streams(30), st.integers(1, 2000), st.booleans())
def test_tables_of_parts_are_the_table_of_the_log(data: bytes, block: int, raw: bool) -> None:
    log = xbus.read_log(data)
    parts = split_log(data, block_bytes=block)
    shape, logs = parts[0].empty(), [part.read() for part in parts]
    for key in (None, *log):
        assert same(joined(shape, logs, key, raw=raw), log.to_arrow(key, raw=raw))


def late_column() -> bytes:
    few = mtdata2(packet(0x4020, FLOAT32))
    return few * 50 + mtdata2(packet(0x4020, FLOAT32), packet(0x0810, bytes(4))) + few * 50


def later_precision() -> bytes:
    return mtdata2(packet(0x4020, FLOAT32)) * 50 + mtdata2(packet(0x4022, FP1632)) * 50


def other_coordinates() -> bytes:
    return mtdata2(packet(0x2010, bytes(16))) * 50 + mtdata2(packet(0x2014, bytes(16))) * 50


def second_device() -> bytes:
    first, second = mtdata2(packet(0x4020, FLOAT32)), mtdata2(packet(0x4022, FP1632), bid=7)
    return first * 50 + second * 50 + mtdata2(packet(0x4020, FLOAT32), bid=1) * 50


def unknown_identifier() -> bytes:
    return mtdata2(packet(0x4020, FLOAT32)) * 50 + mtdata2(packet(0x7770, bytes(3))) * 50


def messages_only() -> bytes:
    return frame(0x3E) * 50


MAKERS = [
    late_column,
    later_precision,
    other_coordinates,
    second_device,
    unknown_identifier,
    messages_only,
    lambda: streams.gnssins(500),
    lambda: streams.dirty(500),
]


@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize("block", [100, 1000, 1 << 20])
def test_schemas(make: Callable[[], bytes], block: int) -> None:
    data = make()
    parts = split_log(data, block_bytes=block)
    parts = pickle.loads(pickle.dumps(parts))  # noqa: S301
    assert same(table_of(parts), xbus.read_log(data).to_arrow())


@pytest.mark.parametrize("bid", [1, 7])
def test_one_device(bid: int) -> None:
    data = second_device()
    parts = split_log(data, block_bytes=300, bid=bid)
    device = xbus.read_log(data, bid=bid)
    assert same(table_of(parts), device.to_arrow())
    assert sum(part.samples for part in parts) == len(device)
    assert parts[-1].first_sample + parts[-1].samples == len(device)


def test_missing_device() -> None:
    with pytest.raises(MissingDeviceError, match="BID 255, 7"):
        split_log(second_device(), bid=3)


def test_missing_device_with_two_bids() -> None:
    """BID FF and 1 are the same device, also in different parts."""
    data = b"".join(
        mtdata2(streams.real(0x4020, i, 0, 0), bid=bid) for bid in (255, 1) for i in range(50)
    )
    with pytest.raises(MissingDeviceError, match=r"BID 255$"):
        split_log(data, bid=3, block_bytes=100)


def test_chosen_quantities() -> None:
    data = streams.gnssins(500)
    parts = split_log(data, block_bytes=5000)
    chosen = ["acceleration", "gnss_pvt_data"]
    expected = xbus.read_log(data, quantities=chosen).to_arrow()
    assert same(table_of(parts, quantities=chosen), expected)
    assert same(table_of(parts, chosen), xbus.read_log(data).to_arrow(chosen))


@pytest.mark.parametrize("name", ["walk.mtb", "field.mtb"])
def test_captures(name: str) -> None:
    path = OWN_CAPTURES / name
    parts = split_log(path, block_bytes=3000)
    assert same(table_of(parts), xbus.read_log(path).to_arrow())


def test_host_times_of_parts_without_arrivals(tmp_path: Path) -> None:
    """The side file ends before the log: later parts have the column too, without values."""
    path = tmp_path / "log.mtb"
    with xbus.connect("sim:MTi-630") as device:
        with device.configure({"sample_time_fine": None, "acceleration": 100}):
            pass
        with device.record(path):
            for _ in range(300):
                device.read_sample()
    path.write_bytes(
        mtdata2(packet(0x4020, FLOAT32))[:4] * 300 + path.read_bytes() + path.read_bytes()
    )
    parts = split_log(path, block_bytes=2000)
    expected = xbus.read_log(path).to_arrow()
    assert same(table_of(parts), expected)


def test_changed_log(tmp_path: Path) -> None:
    """A file of the same size and time of change with other quantities is detected too."""
    import os

    path = tmp_path / "log.mtb"
    path.write_bytes(mtdata2(packet(0x4020, FLOAT32)) * 100)
    part = split_log(path)[0]
    status = path.stat()
    path.write_bytes(mtdata2(packet(0x8020, FLOAT32)) * 100)
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    with pytest.raises(xbus.XbusError, match=r"log\.mtb has changed since it was split"):
        part.read()
