"""Columns as arrays, keys of every form, tables of several quantities, and read-only arrays."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xbus
from conftest import counter, fine
from streams import mtdata2, packet, random_log, real
from test_arrivals import DATA, GOOD, written
from test_pickle import MIXED, WALK, again
from xbus import Coordinates, DataId, Message, Precision, Scanner
from xbus.protocol.keys import QuantityKey, resolve_key
from xbus.wire.struct import Struct

LOG = xbus.read_log(WALK)

# ---------------------------------------------------------------------------------------------
# Columns as arrays
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", list(LOG))
def test_a_column_is_the_array_of_its_values(key: Any) -> None:
    column = LOG[key]
    values = column.values
    assert (column.shape, column.dtype, len(column)) == (values.shape, values.dtype, len(values))
    assert np.asarray(column) is values
    assert np.array(column) is not values
    assert np.array_equal(np.array(column, copy=True), values)
    for index in (0, -1, slice(2, 9, 3), [3, 1], np.arange(len(values)) % 2 == 0, ...):
        assert np.array_equal(column[index], values[index])
    assert all(np.array_equal(one, other) for one, other in zip(column, values, strict=True))
    with pytest.raises(IndexError):
        column[len(column)]


def test_numpy_computes_with_columns() -> None:
    column = LOG["acceleration"]
    assert np.mean(column) == column.values.mean()
    assert np.array_equal(np.linalg.norm(column, axis=1), np.linalg.norm(column.values, axis=1))
    assert np.array_equal(np.sqrt(LOG["temperature"]), np.sqrt(LOG["temperature"].values))
    assert np.asarray(column, np.float64).dtype == np.float64
    assert np.array_equal(np.ones(3) * column, column.values)
    with pytest.raises(ValueError, match="copy"):
        np.array(column, np.float64, copy=False)


def test_components_by_name() -> None:
    """The names of `fields`, for vectors, matrices and structs alike."""
    vector = LOG["acceleration"]
    assert np.array_equal(vector["z"], vector.values[:, 2])
    matrix = xbus.read_log(xbus.encode_sample({"rotation_matrix": np.arange(9).reshape(3, 3)}))["rotation_matrix"]  # fmt: skip # noqa: E501
    assert [matrix[name].item() for name in matrix.fields] == list(range(9))
    assert matrix["m23"].tolist() == matrix.values[:, 1, 2].tolist() == [5]
    struct = xbus.read_log(MIXED)["utc_time"]
    assert struct["year"].tolist() == [2025]
    assert struct[["year", "month"]].dtype.names == ("year", "month")
    for column, name in (
        (vector, "lat"),
        (matrix, "x"),
        (struct, "lat"),
        (LOG["temperature"], "temperature"),
    ):
        with pytest.raises(KeyError, match=f"{column.name} has no {name!r}; it has"):
            column[name]


def test_values_of_samples_and_columns_agree() -> None:
    """Of whatever can be sent; for structs, also the scaled fields, units and satellites."""
    found = set()
    for seed in range(20):
        for message in Scanner(0xFFFF).feed(random_log(random.Random(seed), 60)):
            if not isinstance(message, Message) or message.name != "MTData2":
                continue
            sample = xbus.Sample(message.payload)
            log = xbus.read_log(sample.frame)
            if not log:
                continue  # malformed
            assert list(sample) == list(log)
            for key, column in log.items():
                found.add(column.name)
                value, row = sample[key], column[-1]
                if not isinstance(value, Struct):
                    assert np.array_equal(value, row, equal_nan=True)
                    continue
                assert tuple(value) == column.fields
                assert tuple(value.values()) == row.item()
                assert value.units == column.units
                scaled = column.scaled[-1].item()
                assert np.array_equal(list(value.scaled.values()), scaled, equal_nan=True)
                if column.name == "gnss_sat_info":
                    satellites = [tuple(satellite.values()) for satellite in value.satellites]
                    assert satellites == column.satellites[column.offsets[-2] :].tolist()
    assert {"gnss_pvt_data", "utc_time", "gnss_sat_info", "raw_acc_gyr_mag_temp"} <= found


def test_structs_can_be_encoded() -> None:
    for packets in (
        xbus.Sample(item.payload)
        for item in Scanner(0xFFFF).feed(MIXED)
        if isinstance(item, Message)
    ):
        for key, value in packets.items():
            if isinstance(value, Struct):
                numbers = (value, value.satellites) if key == "gnss_sat_info" else value
                assert xbus.encode_packet(key, numbers) in packets.payload


# ---------------------------------------------------------------------------------------------
# pandas, polars and pyarrow
# ---------------------------------------------------------------------------------------------


def test_pandas() -> None:
    pd = pytest.importorskip("pandas")
    column = LOG["acceleration"]
    assert column.to_pandas().equals(LOG.to_pandas("acceleration"))
    assert list(column.to_pandas().columns) == [
        "sample",
        "time",
        *(f"acceleration_{item}" for item in "xyz"),
    ]
    frame = pd.DataFrame(column, columns=column.fields)
    assert np.array_equal(frame["y"], column["y"])
    assert np.array_equal(pd.Series(LOG["temperature"]), LOG["temperature"].values)
    assert np.array_equal(pd.DataFrame({"t": LOG["temperature"]})["t"], LOG["temperature"].values)


def test_polars_and_pyarrow() -> None:
    pl, pa = pytest.importorskip("polars"), pytest.importorskip("pyarrow")
    column = LOG["acceleration"]
    assert pl.DataFrame(column).equals(column.to_polars())
    assert pa.table(column).equals(column.to_arrow())
    assert column.to_arrow().equals(LOG.to_arrow("acceleration"))
    assert pl.Series("t", LOG["temperature"].values).to_list() == list(LOG["temperature"])


@pytest.mark.parametrize(
    ("keys", "columns"),
    [
        (["temperature"], ["temperature"]),
        (["acceleration", "packet_counter"], [*(f"acceleration_{item}" for item in "xyz"), "packet_counter"]),
        ([DataId.PacketCounter, "packet_counter", 0x1020], ["packet_counter"]),
        (iter(["temperature"]), ["temperature"]),
        ([], []),
    ],
)  # fmt: skip
def test_tables_of_several_quantities(keys: Any, columns: list[str], tmp_path: Path) -> None:
    """A row per sample, and the same numbers as in the table of all of them."""
    pytest.importorskip("pyarrow")
    keys = list(keys)
    table, wide = LOG.to_arrow(keys), LOG.to_arrow()
    names = ["sample", "time", *columns]
    assert table.column_names == names
    assert table.equals(wide.select(names))
    assert LOG.to_pandas(keys).equals(LOG.to_pandas()[names])
    assert LOG.to_polars(keys).equals(LOG.to_polars().select(names))
    for write in (LOG.to_parquet, LOG.to_csv, LOG.to_feather):
        write(tmp_path / "some", keys)
        some = (tmp_path / "some").read_bytes()
        write(tmp_path / "some", iter(keys))
        assert (tmp_path / "some").read_bytes() == some
    LOG.to_npz(tmp_path / "some.npz", keys)
    with np.load(tmp_path / "some.npz") as arrays:
        stems = {LOG[key].name for key in keys}
        utc = {"utc"} & ({"utc"} if stems & {"utc_time", "gnss_pvt_data"} else set())
        assert set(arrays) == {"time", "packet_counter.unwrapped"} | utc | {
            stem + end for stem in stems for end in ("", ".sample", ".time")
        }


def test_tables_of_what_is_not_there(tmp_path: Path) -> None:
    for keys in ("gps_dop", ["acceleration", "gps_dop"], [("quaternion", "NWU")]):
        for write in (LOG.to_csv, LOG.to_parquet, LOG.to_feather, LOG.to_npz):
            with pytest.raises(KeyError, match="in this log"):
                write(tmp_path / "none", keys)
        with pytest.raises(KeyError, match="in this log"):
            LOG.to_arrow(keys)
    assert list(tmp_path.iterdir()) == []


# ---------------------------------------------------------------------------------------------
# Keys
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "resolved"),
    [
        ("acceleration", ("acceleration", None, None)),
        (DataId.Acceleration, ("acceleration", None, None)),
        (("acceleration",), ("acceleration", None, None)),
        (0x4022, ("acceleration", None, "Fp1632")),
        (0x2014, ("quaternion", "NED", None)),
        (0x2017, ("quaternion", "NED", "Float64")),
        (0x3013, ("baro_pressure", None, None)),
        (0x4024, ("acceleration", None, None)),
        (("quaternion", "NED"), ("quaternion", "NED", None)),
        (("quaternion", Coordinates.NED), ("quaternion", "NED", None)),
        ((DataId.Quaternion, Coordinates.ENU), ("quaternion", "ENU", None)),
        ((DataId.Quaternion, Precision.Float32), ("quaternion", None, "Float32")),
        ((DataId.Quaternion, "Fp1632", Coordinates.NWU), ("quaternion", "NWU", "Fp1632")),
        (("quaternion", Coordinates.NWU, Precision.Fp1632), ("quaternion", "NWU", "Fp1632")),
    ],
)  # fmt: skip
def test_keys(key: Any, resolved: tuple[str, str | None, str | None]) -> None:
    assert resolve_key(key) == QuantityKey(*resolved)
    name, coordinates, precision = resolved
    named = (name, *(item for item in (coordinates, precision) if item))
    assert resolve_key(named) == resolve_key(key)


@pytest.mark.parametrize(
    "key",
    [("quaternion", 4), ("quaternion", None), ((), "NED"), True, Coordinates.NED, None, (), 1.0, ["x"]],
)  # fmt: skip
def test_what_is_no_key(key: Any) -> None:
    with pytest.raises((TypeError, ValueError)):
        resolve_key(key)
    assert key not in LOG


def both(data: bytes) -> Iterator[Mapping[Any, Any]]:
    """The log of one message, and the sample that it is."""
    log = xbus.read_log(data)
    yield log
    yield xbus.Sample(data[4:-1])


def test_in_and_brackets_agree() -> None:
    """In logs and samples, whatever the form of the key: it is in what has it, and in nothing else."""
    keys = [
        "quaternion", "acceleration", DataId.Quaternion, 0x2010, 0x2014, 0x2012, "nothing", 0x7770,
        *(("quaternion", Coordinate) for Coordinate in (*Coordinates, *Precision, "UFO")),
        *((DataId.Quaternion, Coordinate) for Coordinate in (*Coordinates, *Precision, "NED")),
        *((DataId.Acceleration, Coordinate) for Coordinate in (*Coordinates, *Precision)),
    ]  # fmt: skip
    one = mtdata2(real(0x2014, 0, 1, 0, 0), real(0x4021, 1, 2, 3))
    two = mtdata2(real(0x2014, 0, 1, 0, 0), real(0x2012, 1, 0, 0, 0))
    for data in (one, two, mtdata2(counter(1), fine(2), packet(0x7770, b"?"))):
        for mapping in both(data):
            assert isinstance(mapping, Mapping)
            found = []
            for key in keys:
                if key in mapping:
                    found.append(key)
                    assert mapping.get(key) is not None
                    assert np.array_equal(mapping[key], mapping.get(key, "nothing"))
                else:
                    assert mapping.get(key) is None
                    with pytest.raises(KeyError):
                        mapping[key]
            assert all(key in mapping for key in mapping)
            assert list(mapping.keys()) == list(mapping)
            assert len(mapping.items()) == len(mapping.values()) == len(list(mapping))
            if data is one:
                assert found[:3] == ["quaternion", "acceleration", DataId.Quaternion]
                assert (DataId.Quaternion, Precision.Fp1632) not in found
            if data is two:
                assert "quaternion" not in found
                assert 0x2014 in found
                assert (DataId.Quaternion, Precision.Fp1632) in found


def test_the_length_of_a_log_is_that_of_its_samples() -> None:
    """And of its views, that of its quantities."""
    log = xbus.read_log(MIXED)
    assert (len(log), len(log.keys()), len(list(log))) == (5, 9, 9)
    assert [key for key, _ in log.items()] == list(log)
    assert [column.name for column in log.values()] == [log[key].name for key in log]
    assert dict(log) == dict(log.items())
    assert not xbus.read_log(xbus.encode_string("HEHDT", {"heading": 1}))
    assert xbus.read_log(mtdata2(packet(0x7770, b"?")))


# ---------------------------------------------------------------------------------------------
# Read-only
# ---------------------------------------------------------------------------------------------


def arrays(thing: Any, path: str = "log", depth: int = 4) -> Iterator[tuple[str, np.ndarray]]:
    """Every array that can be reached by public attributes, keys and calls without arguments."""
    if isinstance(thing, np.ndarray):
        yield path, thing
    elif isinstance(thing, Mapping) and depth:
        for key, value in thing.items():
            yield from arrays(value, f"{path}[{key!r}]", depth - 1)
    if not type(thing).__module__.startswith("xbus") or not depth:
        return
    for name in dir(type(thing)):
        if name.startswith(("_", "to_")):
            continue
        try:
            value = getattr(thing, name)
        except AttributeError:
            continue  # a column without satellites
        if not callable(value):
            yield from arrays(value, f"{path}.{name}", depth - 1)
    for name, value in vars(thing).items() if hasattr(thing, "__dict__") else ():
        if not name.startswith("_"):
            yield from arrays(value, f"{path}.{name}", depth - 1)


def test_arrays_are_read_only(tmp_path: Path) -> None:
    strings = xbus.encode_string("HEHDT", {"heading": 1})
    whole = [
        xbus.read_log(MIXED),
        xbus.read_log(written(tmp_path, DATA + strings, GOOD)),
        xbus.read_log(random_log(random.Random(2), 60)),
    ]
    parts = [*xbus.iter_log(MIXED, block_bytes=60)]
    copies = again(whole)
    found = set()
    for log in (*whole, *parts, *copies):
        for path, array in arrays(log):
            found.add(path)
            assert not array.flags.writeable, path
            if array.size and array.dtype.names is None:
                with pytest.raises(ValueError, match="read-only"):
                    array.flat[0] = array.flat[0]
        for column in (*log.values(), *again(list(log.values()))):
            assert not np.asarray(column).flags.writeable
            if len(column):
                assert not column[:1].flags.writeable
        for name in filter(None, log.strings.counts):
            assert not log.strings.table(name).flags.writeable
    expected = {"log.offset", "log.bid", "log.time", "log.host_time", "log.utc", "log.packet_counter",
                "log.damage",
                "log.messages.offset", "log.messages.sample", "log.messages.mid", "log.messages.bid",
                "log.strings.offset", "log.strings.sample", "log.strings.end", "log.strings.host_time",
                "log['acceleration'].values", "log['acceleration'].sample", "log['acceleration'].time",
                "log['acceleration'].scaled", "log['utc_time'].scaled", "log['utc_time'].datetime",
                "log['gnss_sat_info'].satellites", "log['gnss_sat_info'].offsets",
                "log['status_word'].flags['filter_valid']", "log.unknown[30576].sample"}  # fmt: skip
    assert expected <= found
