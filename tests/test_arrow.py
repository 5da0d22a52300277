"""Tables: names, types, nulls and metadata; and which columns are not copied."""

from __future__ import annotations

import datetime
import gc
import random
import struct
import subprocess
import sys
import textwrap
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import streams
import xbus
from conftest import OWN_CAPTURES, counter, damaged_streams, fine
from streams import mtdata2, packet, real
from xbus.export import tables

pa = pytest.importorskip("pyarrow")

UTC = struct.pack(">IHBBBBBB", 5, 2025, 7, 13, 9, 21, 34, 7)
SATELLITES = struct.pack(">IBBBB", 1000, 2, 0, 0, 0) + bytes([0, 5, 22, 20, 6, 24, 39, 16])

#: Four samples, none with all quantities.
DATA = b"".join(
    [
        mtdata2(
            *(counter(1), fine(100), real(0x2010, 1, 0, 0, 0)),
            *(real(0x2014, 0, 1, 0, 0), real(0x4022, 1, 2, 3)),
        ),
        mtdata2(
            real(0x2020, 11, 21, 31, 12, 22, 32, 13, 23, 33),
            *(packet(0x1010, UTC), real(0x5042, 52.5, 6.75)),
        ),
        mtdata2(
            *(fine(200), packet(0x7020, SATELLITES)),
            *(packet(0x3013, b"\0\1\x86\xa4"), packet(0x1010, bytes(12))),
        ),
        mtdata2(
            *(counter(4), real(0x4020, 4, 5, 6), real(0x4022, 7, 8, 9)),
            *(packet(0xE040, b"\xb0"), real(0xD016, 1, 2, 3)),
        ),
    ]
)

# Column, type, unit, coordinates, precision, data identifier, values.
WIDE = """
    sample                  int64   -           -    -        -       0 1 2 3
    time                    double  s           -    -        -       0.01 - 0.02 -
    utc                     time    -           -    -        -       - 2025-07-13T09:21:34.000000005 - -
    packet_counter          uint16  -           -    -        0x1020  1 - - 4
    sample_time_fine        uint32  0.1+ms      -    -        0x1060  100 - 200 -
    quaternion_q0           float   -           ENU  Float32  0x2010  1 - - -
    quaternion_q1           float   -           ENU  Float32  0x2010  0 - - -
    quaternion_q2           float   -           ENU  Float32  0x2010  0 - - -
    quaternion_q3           float   -           ENU  Float32  0x2010  0 - - -
    quaternion_q0           float   -           NED  Float32  0x2014  0 - - -
    quaternion_q1           float   -           NED  Float32  0x2014  1 - - -
    quaternion_q2           float   -           NED  Float32  0x2014  0 - - -
    quaternion_q3           float   -           NED  Float32  0x2014  0 - - -
    acceleration_x          double  m/s2        -    -        0x4020  1 - - 7
    acceleration_y          double  m/s2        -    -        0x4020  2 - - 8
    acceleration_z          double  m/s2        -    -        0x4020  3 - - 9
    rotation_matrix_m11     float   -           ENU  Float32  0x2020  - 11 - -
    rotation_matrix_m12     float   -           ENU  Float32  0x2020  - 12 - -
    rotation_matrix_m13     float   -           ENU  Float32  0x2020  - 13 - -
    rotation_matrix_m21     float   -           ENU  Float32  0x2020  - 21 - -
    rotation_matrix_m22     float   -           ENU  Float32  0x2020  - 22 - -
    rotation_matrix_m23     float   -           ENU  Float32  0x2020  - 23 - -
    rotation_matrix_m31     float   -           ENU  Float32  0x2020  - 31 - -
    rotation_matrix_m32     float   -           ENU  Float32  0x2020  - 32 - -
    rotation_matrix_m33     float   -           ENU  Float32  0x2020  - 33 - -
    utc_time                time    -           -    -        0x1010  - 2025-07-13T09:21:34.000000005 - -
    lat_lon_lat             double  deg         -    Fp1632   0x5042  - 52.5 - -
    lat_lon_lon             double  deg         -    Fp1632   0x5042  - 6.75 - -
    gnss_sat_info_itow      double  s           -    -        0x7020  - - 1 -
    gnss_sat_info_numSvs    uint8   -           -    -        0x7020  - - 2 -
    gnss_sat_info_res1      uint8   -           -    -        0x7020  - - 0 -
    gnss_sat_info_res2      uint8   -           -    -        0x7020  - - 0 -
    gnss_sat_info_res3      uint8   -           -    -        0x7020  - - 0 -
    baro_pressure           uint32  Pa          -    -        0x3013  - - 100004 -
    rssi                    int8    dBm         -    -        0xE040  - - - -80
    velocity_xyz_x          double  m/s         NED  Fp1632   0xD016  - - - 1
    velocity_xyz_y          double  m/s         NED  Fp1632   0xD016  - - - 2
    velocity_xyz_z          double  m/s         NED  Fp1632   0xD016  - - - 3
"""


def value(text: str, kind: str) -> Any:
    if text == "-":
        return None
    if kind == "time":
        return np.datetime64(text, "ns")
    return float(text) if kind in ("float", "double") else int(text)


def test_wide_table() -> None:
    """One row for each sample, one column for each component, null if the sample lacks the quantity."""
    table = xbus.read_log(DATA).to_arrow()
    rows = [line.split() for line in WIDE.strip().splitlines()]
    assert len(table.column_names) == len(rows)
    for field, (name, kind, unit, system, precision, data_id, *values) in zip(
        table.schema, rows, strict=True
    ):
        if name.startswith("quaternion"):
            name = name.replace("quaternion", f"quaternion_{system.lower()}")
        assert field.name == name
        assert str(field.type) == ("timestamp[ns, tz=UTC]" if kind == "time" else kind), name
        assert field.nullable == (name != "sample"), name
        entries = {
            "unit": unit.replace("+", " "),
            "coordinates": system,
            "precision": precision,
            "data_id": data_id,
        }
        expected = {key: text for key, text in entries.items() if text != "-"}
        metadata = {key.decode(): text.decode() for key, text in (field.metadata or {}).items()}
        assert metadata == expected, name
        column = table[name]
        if kind == "time":
            column = column.cast(pa.int64())
            expected_values = [
                None if item == "-" else value(item, kind).astype("i8").item() for item in values
            ]
        else:
            expected_values = [value(item, kind) for item in values]
        assert column.to_pylist() == expected_values, name


def test_full_columns_are_not_nullable() -> None:
    """Only the time is nullable, because a device may leave out the stamp."""
    log = xbus.read_log(streams.ahrs(50))
    table = log.to_arrow()
    assert {item.name for item in table.schema if item.nullable} == {"time"}
    assert sum(itercolumn.null_count for itercolumn in table.itercolumns()) == 0
    assert table["quaternion_q3"].to_pylist() == log["quaternion"].values[:, 3].tolist()
    assert table["time"].to_pylist() == log.time.tolist()


def test_one_quantity() -> None:
    """One row for each packet, even if a message has two of the quantity."""
    log = xbus.read_log(DATA)
    table = log.to_arrow("acceleration")
    assert table.to_pylist() == [
        {"sample": 0, "time": 0.01, "acceleration_x": 1, "acceleration_y": 2, "acceleration_z": 3},
        {"sample": 3, "time": None, "acceleration_x": 4, "acceleration_y": 5, "acceleration_z": 6},
        {"sample": 3, "time": None, "acceleration_x": 7, "acceleration_y": 8, "acceleration_z": 9},
    ]
    assert [item.nullable for item in table.schema] == [False, True, False, False, False]
    assert table.schema.field("acceleration_x").metadata == {
        b"unit": b"m/s2",
        b"data_id": b"0x4020",
    }
    ned = log.to_arrow(("quaternion", "NED"))
    assert ned.column_names == [
        "sample",
        "time",
        "quaternion_q0",
        "quaternion_q1",
        "quaternion_q2",
        "quaternion_q3",
    ]
    assert ned.schema.field("quaternion_q0").metadata[b"coordinates"] == b"NED"
    utc = log.to_arrow("utc_time")
    assert utc["utc_time"].null_count == 1
    pressure = log.to_arrow("baro_pressure").to_pylist()
    assert pressure == [{"sample": 2, "time": 0.02, "baro_pressure": 100004}]


def test_satellites() -> None:
    """One row for each satellite, with the fields of its message."""
    info = struct.pack(">IBBBB", 1250, 1, 0, 0, 0) + bytes([1, 120, 7, 1])
    empty = packet(0x7020, struct.pack(">IBBBB", 1100, 0, 0, 0, 0))
    data = DATA + mtdata2(empty, fine(250)) + mtdata2(packet(0x7020, info), fine(300))
    table = xbus.read_log(data).to_arrow("gnss_sat_info")
    names = ["sample", "time", "itow", "numSvs", "gnssId", "svId", "cno", "flags"]
    assert table.drop_columns(["res1", "res2", "res3"]).column_names == names
    assert [tuple(row[name] for name in names) for row in table.to_pylist()] == [
        (2, 0.02, 1.0, 2, 0, 5, 22, 20),
        (2, 0.02, 1.0, 2, 6, 24, 39, 16),
        (5, 0.03, 1.25, 1, 1, 120, 7, 1),
    ]
    assert table.schema.field("itow").metadata == {b"data_id": b"0x7020", b"unit": b"s"}
    assert table.schema.field("cno").metadata == {b"data_id": b"0x7020", b"unit": b"dBHz"}
    assert table.schema.field("gnssId").metadata == {b"data_id": b"0x7020"}


def test_columns_of_a_part() -> None:
    """Samples are counted from the beginning of the log."""
    part = list(xbus.iter_log(DATA, block_bytes=1))[3]
    assert part.to_arrow()["sample"].to_pylist() == [3]
    assert part.to_arrow("acceleration")["sample"].to_pylist() == [3, 3]


def test_tables_of_selected_quantities() -> None:
    log = xbus.read_log(DATA, quantities=[("quaternion", "NED"), "rssi"])
    assert log.to_arrow().column_names == [
        "sample", "time", "quaternion_q0", "quaternion_q1", "quaternion_q2", "quaternion_q3", "rssi",
    ]  # fmt: skip
    assert xbus.read_log(DATA, quantities=[]).to_arrow().column_names == ["sample", "time"]
    assert len(xbus.read_log(DATA, quantities=[]).to_arrow()) == 4


def test_an_empty_log() -> None:
    table = xbus.read_log(b"").to_arrow()
    assert (table.column_names, table.num_rows) == (["sample", "time"], 0)
    assert [str(item.type) for item in table.schema] == ["int64", "double"]


def test_what_is_not_there() -> None:
    with pytest.raises(KeyError, match="no 'gnss_pvt_data' in this log"):
        xbus.read_log(DATA).to_arrow("gnss_pvt_data")
    with pytest.raises(KeyError, match="several coordinate systems"):
        xbus.read_log(DATA).to_arrow("quaternion")


def columns_of(log: xbus.Log, *, raw: bool) -> dict[str, tuple[xbus.Column, Any]]:
    """Returns the columns of the wide table by name, from numpy arrays, except dates and time."""
    found: dict[str, tuple[xbus.Column, Any]] = {}
    names = [key if isinstance(key, str) else key[0] for key in log]
    for key in log:
        column = log[key]
        stem = column.name
        if names.count(stem) > 1:
            stem += f"_{str(column.coordinates).lower()}"
        values = column.values
        if values.dtype.names:
            if column.name != "utc_time":
                records = values if raw else column.scaled
                found |= {f"{stem}_{field}": (column, records[field]) for field in column.fields}
        elif column.fields:
            flat = values.reshape(len(values), -1)
            found |= {f"{stem}_{it}": (column, flat[:, i]) for i, it in enumerate(column.fields)}
        else:
            found[stem] = (column, values)
    return found


@given(damaged_streams(30), st.booleans())
def test_tables_match_numpy(data: bytes, raw: bool) -> None:
    """Every cell of the wide table equals the last numpy row of its sample, bit by bit."""
    log = xbus.read_log(data)
    table = log.to_arrow(raw=raw)
    table.validate(full=True)
    assert table.num_rows == len(log)
    columns = columns_of(log, raw=raw)
    others = {"sample", "time", "bid", "utc", "utc_time"}
    if "bid" in table.column_names:
        devices = np.where(log.bid == 0xFF, 1, log.bid)
        bids = np.asarray(table["bid"])
        assert np.where(bids == 0xFF, 1, bids).tolist() == devices.tolist()
    if "utc" in table.column_names:
        assert np.array_equal(
            np.asarray(table["utc"].cast(pa.timestamp("ns"))), log.utc, equal_nan=True
        )
    assert set(table.column_names) - others == set(columns)
    for name, (column, values) in columns.items():
        array = table[name].combine_chunks()
        dense = np.asarray(array.is_valid())
        filled = np.unique(column.sample)
        if column.dtype.names and values.dtype == np.float64:
            # Null where the device does not provide the field.
            rows = np.searchsorted(column.sample, filled, side="right") - 1
            filled = filled[~np.isnan(values[rows])]
        assert np.flatnonzero(dense).tolist() == filled.tolist()
        last = np.searchsorted(column.sample, np.flatnonzero(dense), side="right") - 1
        found = np.asarray(array.drop_null())
        assert found.dtype == values.dtype
        assert np.ascontiguousarray(found).tobytes() == values[last].tobytes()
    for key in log:
        one = log.to_arrow(key)
        one.validate(full=True)
        column = log[key]
        if column.name == "gnss_sat_info":
            assert one.num_rows == len(column.satellites)
        else:
            assert one["sample"].to_pylist() == column.sample.tolist()


@pytest.mark.parametrize("rows", [2**18 - 1, 2**18, 2**18 + 1, 2**19 + 3])
def test_batches(rows: int) -> None:
    """Tables are built in batches, and no row is lost at their boundaries."""
    log = xbus.read_log(streams.hr(rows))
    reader = pa.RecordBatchReader.from_stream(log)
    sizes = [len(item) for item in reader]
    assert sum(sizes) == rows
    assert len(sizes) > rows // 2**18 - (rows % 2**18 == 0)
    table = log.to_arrow()
    assert np.array_equal(np.asarray(table["sample"]), np.arange(rows))
    assert np.array_equal(np.asarray(table["time"]), log.time)
    assert np.array_equal(np.asarray(table["sample_time_fine"]), log["sample_time_fine"].values)
    for name in ("acceleration_hr", "rate_of_turn_hr"):
        column = log[name]
        array = table[f"{name}_y"].combine_chunks()
        assert np.array_equal(np.flatnonzero(np.asarray(array.is_valid())), column.sample)
        assert np.array_equal(np.asarray(array.drop_null()), column.values[:, 1])
        one = log.to_arrow(name)
        assert np.array_equal(np.asarray(one[f"{name}_z"]), column.values[:, 2])
        assert np.array_equal(np.asarray(one["sample"]), column.sample)


# ---------------------------------------------------------------------------------------------
# Without a copy
# ---------------------------------------------------------------------------------------------


def address(array: Any) -> int:
    """Returns the address of the first number of an Arrow array."""
    (chunk,) = array.chunks
    first: int = chunk.buffers()[1].address
    return first + int(chunk.offset) * int(chunk.type.bit_width) // 8


@pytest.mark.parametrize(
    "key", ["temperature", "baro_pressure", "status_word", "packet_counter", "altitude_ellipsoid"]
)
def test_scalars_are_not_copied(key: str) -> None:
    """The table shares the memory of the column."""
    log = xbus.read_log(OWN_CAPTURES / "walk.mtb")
    values = log[key].values
    assert address(log.to_arrow(key)[key]) == values.__array_interface__["data"][0]


def test_full_scalars_of_the_wide_table_are_not_copied() -> None:
    log = xbus.read_log(streams.ahrs(1000))
    table = log.to_arrow()
    for key in ("packet_counter", "sample_time_fine", "status_word"):
        assert address(table[key]) == log[key].values.__array_interface__["data"][0]


def test_tables_outlive_the_log() -> None:
    log = xbus.read_log(OWN_CAPTURES / "walk.mtb")
    expected = log["status_word"].values.tolist(), log["baro_pressure"].values.tolist()
    table, one = log.to_arrow(), log.to_arrow("baro_pressure")
    stream = pa.RecordBatchReader.from_stream(log)
    del log
    gc.collect()
    trash = [bytes(100_000) for _ in range(100)]
    assert table["status_word"].drop_null().to_pylist() == expected[0]
    assert one["baro_pressure"].to_pylist() == expected[1]
    assert stream.read_all().equals(table)
    del trash


# ---------------------------------------------------------------------------------------------
# Others
# ---------------------------------------------------------------------------------------------


def test_capsules() -> None:
    """Log and Column support the Arrow C stream interface repeatedly."""
    log = xbus.read_log(DATA)
    assert pa.table(log).equals(log.to_arrow())
    assert pa.table(log).equals(log.to_arrow())
    assert pa.table(log["acceleration"]).equals(log.to_arrow("acceleration"))
    assert pa.table(log["gnss_sat_info"]).equals(log.to_arrow("gnss_sat_info"))
    capsule = log.__arrow_c_stream__()
    assert '"arrow_array_stream"' in repr(capsule)
    assert '"arrow_array_stream"' in repr(log.__arrow_c_stream__(None))
    del capsule  # unused


def test_pandas() -> None:
    pytest.importorskip("pandas")
    log = xbus.read_log(DATA)
    frame = log.to_pandas()
    assert frame.columns.tolist() == log.to_arrow().column_names
    assert frame["acceleration_x"].tolist()[::3] == [1.0, 7.0]
    assert frame["acceleration_x"].isna().tolist() == [False, True, True, False]
    assert frame["utc_time"][1].isoformat() == "2025-07-13T09:21:34.000000005+00:00"
    assert frame["utc_time"].isna().tolist() == [True, False, True, True]
    assert log.to_pandas("acceleration")["acceleration_z"].tolist() == [3.0, 6.0, 9.0]
    assert xbus.read_log(b"").to_pandas().shape == (0, 2)
    ticks = 2**63 + 1  # no float64 holds it
    wide = xbus.read_log(DATA + xbus.encode_sample({"sample_time64": ticks})).to_pandas()
    assert wide["sample_time64"].isna().sum() == len(wide) - 1
    assert int(wide["sample_time64"].iloc[-1]) == ticks  # numpy would compare as float64


@given(damaged_streams(30), st.booleans())
def test_pandas_matches_pyarrow(data: bytes, raw: bool) -> None:
    """A frame has what pyarrow makes of the same table, bit by bit."""
    pd = pytest.importorskip("pandas")
    log = xbus.read_log(data)
    for keys in (None, *log):
        expected = tables.pandas_from_arrow(log.to_arrow(keys, raw=raw))
        pd.testing.assert_frame_equal(log.to_pandas(keys, raw=raw), expected, check_exact=True)


@pytest.mark.parametrize("rows", [2**12 - 1, 2**12, 2**12 + 1, 500_000])
def test_long_frames(rows: int) -> None:
    """No row is lost at the boundaries of blocks, and no column where memory of others ends."""
    pd = pytest.importorskip("pandas")
    data = streams.hr(rows - 1)
    payload = data[-len(streams.hr(1)) :][4:-1]
    log = xbus.read_log(data + streams.frame(0x36, payload, bid=2))
    frame = log.to_pandas()
    assert len(frame) == rows
    assert "bid" in frame
    assert (frame.memory_usage().sum() > tables.PIECE) == (rows > 2**13)
    pd.testing.assert_frame_equal(frame, tables.pandas_from_arrow(log.to_arrow()), check_exact=True)
    column = log["acceleration_hr"].to_pandas()
    assert column["acceleration_hr_z"].tolist() == log["acceleration_hr"].values[:, 2].tolist()


def test_frames_may_be_changed() -> None:
    pytest.importorskip("pandas")
    log = xbus.read_log(streams.ahrs(1000))
    frame, expected = log.to_pandas(), log.to_pandas()
    for name in frame.columns:
        before = {other: frame[other].copy() for other in frame.columns if other != name}
        frame.loc[3:5, name] = 1
        assert frame[name].tolist()[3:6] == [1, 1, 1]
        assert all(frame[other].equals(values) for other, values in before.items())
    assert log.to_pandas().equals(expected)


@pytest.mark.parametrize("count", [tables.MOST_ARRAYS, tables.MOST_ARRAYS + 1, 200])
def test_columns_can_be_added(count: int) -> None:
    """pandas warns if a frame has too many arrays, and warnings are errors here."""
    pytest.importorskip("pandas")
    log = xbus.read_log(streams.random_log(random.Random(1), 600))
    keys = list(log)
    while len(log.to_arrow(keys).column_names) > count:
        keys.pop()
    frame = log.to_pandas(keys)
    assert len(frame.columns) > count - 15
    for number in range(tables.MOST_ARRAYS):
        frame[f"another_{number}"] = number
    assert frame["another_9"].sum() == 9 * len(frame)


def test_arrays_for_a_table() -> None:
    log = xbus.read_log(streams.ahrs(3))
    stream = log.arrow_stream(["packet_counter", "acceleration"]).select(
        ["acceleration_y", "packet_counter"]
    )
    assert (stream.columns, stream.row_count) == (["packet_counter", "acceleration_y"], 3)
    for names in (["acceleration_x"], ["packet_counter", "speed"]):
        with pytest.raises(ValueError, match=f"no column .{names[-1]}"):
            stream.select(names)
    counters, numbers = np.zeros(3, np.uint16), np.zeros(3, np.float32)
    stream.write([counters, numbers])
    assert counters.tolist() == log["packet_counter"].values.tolist()
    assert numbers.tolist() == log["acceleration"].values[:, 1].tolist()
    others: list[list[Any]] = [
        [counters],
        [numbers, counters],
        [counters[:2], numbers[:2]],
        [counters, numbers.astype(float)],
    ]
    for arrays in others:
        with pytest.raises(ValueError, match="memory for"):
            stream.write(arrays)
    with pytest.raises(TypeError, match="no array of numbers"):
        stream.write([counters, [1.0, 2.0, 3.0]])  # type: ignore[list-item]
    numbers.flags.writeable = False
    with pytest.raises(TypeError, match="not writeable"):
        stream.write([counters, numbers])
    resampled = log.resample(10).arrow_stream()
    for call in (lambda: resampled.select(["time"]), lambda: resampled.write([])):
        with pytest.raises(TypeError, match="table of a log"):
            call()


def test_polars() -> None:
    pl = pytest.importorskip("polars")
    log = xbus.read_log(DATA)
    frame = log.to_polars()
    assert frame.columns == log.to_arrow().column_names
    assert frame["baro_pressure"].to_list() == [None, None, 100004, None]
    assert frame["utc_time"].dtype == pl.Datetime("ns", "UTC")
    assert frame["utc_time"][1] == datetime.datetime(2025, 7, 13, 9, 21, 34, tzinfo=datetime.UTC)
    assert log.to_polars("acceleration")["acceleration_x"].to_list() == [1, 4, 7]
    column = log["acceleration"]
    assert pl.DataFrame(column).equals(column.to_polars())
    assert column.to_polars().equals(log.to_polars("acceleration"))
    assert xbus.read_log(b"").to_polars().shape == (0, 2)


def test_polars_needs_no_pyarrow() -> None:
    """The interface consists of C structs and needs no library."""
    pytest.importorskip("polars")
    program = """
        import sys
        sys.modules["pyarrow"] = None
        import polars, xbus
        log = xbus.read_log(sys.argv[1])
        frame = log.to_polars()
        print(frame.shape, frame["acceleration_x"].null_count(), polars.DataFrame(log["temperature"]).shape)
    """
    path = str(OWN_CAPTURES / "walk.mtb")
    command = [sys.executable, "-c", textwrap.dedent(program), path]
    result = subprocess.run(command, check=True, capture_output=True, text=True)  # noqa: S603
    assert result.stdout.split("\n")[0] == "(1040, 66) 40 (10, 3)"


def test_duckdb() -> None:
    """DuckDB finds a log by the name of a variable."""
    duckdb = pytest.importorskip("duckdb")
    log = xbus.read_log(DATA)
    acceleration = log["acceleration"]
    with duckdb.connect() as db:
        found = db.sql(
            "select count(*), count(acceleration_x), sum(acceleration_x) from log"
        ).fetchall()
        assert found == [(4, 2, 8.0)]
        assert db.sql("select sample, acceleration_y from acceleration").fetchall() == [
            (0, 2.0),
            (3, 5.0),
            (3, 8.0),
        ]
    assert (len(log), len(acceleration)) == (4, 3)
