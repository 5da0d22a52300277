"""Files of tables: what other libraries read back has the same bits."""

from __future__ import annotations

import io
import itertools
import math
import struct
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import numpy.typing as npt
import polars as pl
import pyarrow as pa
import pyarrow.csv
import pyarrow.feather
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import reference
from xbus import _core, encode_sample, read_log
from xbus.export.tables import stream_of
from xbus.log.in_order import in_order
from xbus.log.table_file import FileFormat, write_batches, write_table

#: Bits of floats: NaN with payloads and signs, zeros, infinities, subnormals, the largest, powers of ten.
NOT_FINITE = (0x7FF8000000000001, 0xFFF8000000000000, 0x7FF0000000000000, 0xFFF0000000000000)
FINITE = (1 << 63, 0, 1, 0x000FFFFFFFFFFFFF, 0x7FEFFFFFFFFFFFFF, 0x3FF0000000000000)
DOUBLES = np.array([*NOT_FINITE, *FINITE], np.uint64).view(np.float64)
POWERS = np.array([s * 10.0**e for e in range(-12, 25) for s in (1, -1, 1.5, 9.99999999)])
FLOATS = np.concatenate([DOUBLES, POWERS, POWERS - 1e-9 * np.abs(POWERS)])
INTEGERS = [np.dtype(f"{sign}{size}") for sign in "ui" for size in (1, 2, 4, 8)]

Columns = dict[str, npt.NDArray[Any]]


def masked(values: Any, kind: str) -> npt.NDArray[Any]:
    """Returns an array whose second value is null."""
    return np.ma.masked_array(np.array(values, kind), [False, True, False])


TABLES: dict[str, Columns] = {
    "doubles": {"x": FLOATS},
    "singles": {"x": np.array([*FLOATS[:4], *POWERS], np.float32)},
    "integers": {
        f"{dtype}": masked([np.iinfo(dtype).min, 0, np.iinfo(dtype).max], dtype.str)
        for dtype in INTEGERS
    },
    "times": {
        "stamp": np.array(["1677-09-21T00:12:44", "NaT", "2262-04-11T23:47:16"], "M8[ns]"),
        "near": np.array([-1, 0, 1_700_000_000_123_456_789], "M8[ns]"),
        "day": np.array(["1970-01-01", "NaT", "2024-02-29"], "M8[D]"),
        "clock": np.array([0, "NaT", 86_399_999_999], "m8[us]"),
    },
    "text": {"text": np.array(["", 'a "word"', "two\nlines, ü"])},
    "one row": {"sample": np.array([2**62])},
    "no rows": {"sample": np.empty(0, np.int64), "x": np.empty(0, np.float32)},
    'a "name", with a comma': {'a "name", with a comma': np.arange(3)},
    "more than a chunk": {
        "i": np.arange(2**18 + 5),
        "x": np.random.default_rng(1).standard_normal(2**18 + 5),
    },
}


@pytest.fixture(params=list(TABLES))
def table(request: pytest.FixtureRequest) -> _core.ArrowStream:
    return stream_of(
        (name, values, {"unit": "m"}) for name, values in TABLES[request.param].items()
    )


def read_all(table: Any) -> pa.Table:
    return pa.RecordBatchReader.from_stream(table).read_all()


def assert_identical(found: pa.Table, expected: pa.Table) -> None:
    """Compares bits where values are not null, unlike `pyarrow.Table.equals`."""
    assert found.column_names == expected.column_names
    for name in expected.column_names:
        one, other = (table[name].combine_chunks() for table in (found, expected))
        assert one.type == other.type
        assert one.is_null().equals(other.is_null())
        if pa.types.is_floating(one.type):
            assert reference.same_bits(*(np.asarray(array.drop_null()) for array in (one, other)))
        else:
            assert one.equals(other)


# ---------------------------------------------------------------------------------------------
# Round trips
# ---------------------------------------------------------------------------------------------


def test_parquet(table: _core.ArrowStream, tmp_path: Path) -> None:
    path = tmp_path / "x.parquet"
    write_table(table, path, "parquet")
    found, expected = pq.read_table(path), read_all(table)
    assert_identical(found, expected)
    assert all(field.metadata[b"unit"] == b"m" for field in found.schema)
    assert_identical(pl.read_parquet(path).to_arrow().cast(expected.schema), expected)
    if "clock" not in expected.column_names:  # DuckDB has no time of day in UTC
        duck = read_all(duckdb.read_parquet(str(path)))
        assert_identical(duck.cast(expected.schema), expected)


def test_arrow(table: _core.ArrowStream, tmp_path: Path) -> None:
    path = tmp_path / "x.arrow"
    write_table(table, path, "arrow")
    assert_identical(pyarrow.feather.read_table(path), read_all(table))
    assert pyarrow.feather.read_table(path).schema.equals(
        read_all(table).schema, check_metadata=True
    )


def test_csv_is_that_of_pyarrow(table: _core.ArrowStream, tmp_path: Path) -> None:
    write_table(table, tmp_path / "x.csv", "csv")
    expected = io.BytesIO()
    pyarrow.csv.write_csv(read_all(table), expected)
    assert (tmp_path / "x.csv").read_bytes() == expected.getvalue()


@pytest.mark.parametrize("kind", ["<d", "<f"])
@given(data=st.data())
def test_floats_in_csv(kind: str, data: st.DataObject) -> None:
    """The text of any float is that of pyarrow, and reads back as the same float."""
    floats = st.floats(width=64 if kind == "<d" else 32, allow_nan=False)
    values = data.draw(st.lists(floats, min_size=1))
    array = np.array(values, kind)
    table = stream_of([("x", array, {})])
    lines = csv_of(table).decode().splitlines()[1:]
    expected = io.BytesIO()
    pyarrow.csv.write_csv(read_all(table), expected)
    assert lines == expected.getvalue().decode().splitlines()[1:]
    assert b"".join(struct.pack(kind, float(line)) for line in lines) == array.tobytes()


def csv_of(table: _core.ArrowStream) -> bytes:
    out = io.BytesIO()
    with ThreadPoolExecutor(1) as pool:
        rows = list(write_batches(_core.TableFile("csv", table), table.batches(), out, pool, 1))
    assert sum(rows) == out.getvalue().count(b"\n") - 1
    return out.getvalue()


@pytest.mark.parametrize("file_format", ["parquet", "csv", "arrow"])
def test_a_table_without_columns(file_format: FileFormat, tmp_path: Path) -> None:
    path = tmp_path / f"x.{file_format}"
    write_table(stream_of([]), path, file_format)
    match file_format:
        case "parquet":
            assert pq.read_table(path).shape == (0, 0)
        case "arrow":
            assert pyarrow.feather.read_table(path).shape == (0, 0)
        case "csv":
            assert path.read_bytes() == b"\n"


# ---------------------------------------------------------------------------------------------
# Chunks
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("file_format", ["parquet", "csv", "arrow"])
def test_threads_do_not_change_the_file(file_format: FileFormat, tmp_path: Path) -> None:
    table = stream_of((name, values, {}) for name, values in TABLES["more than a chunk"].items())
    files = []
    for threads in (1, 3):
        path = tmp_path / f"{threads}.{file_format}"
        written: list[int] = []
        write_table(table, path, file_format, threads=threads, written=written.append)
        assert written == [2**18, 5]
        files.append(path.read_bytes())
    assert files[0] == files[1]


def test_row_groups_are_equal_whatever_the_batches_are(tmp_path: Path) -> None:
    table = stream_of([("x", np.arange(600_000), {})])
    [whole] = table.batches()
    ends = [0, 1, 7, 100_000, 262_144, 262_145, 599_999, 600_000]
    batches = [whole.rows(first, end) for first, end in itertools.pairwise(ends)]
    path = tmp_path / "x.parquet"
    with path.open("wb") as out, ThreadPoolExecutor(2) as pool:
        list(write_batches(_core.TableFile("parquet", table), batches, out, pool, 2))
    metadata = pq.read_metadata(path)
    rows = [metadata.row_group(i).num_rows for i in range(metadata.num_row_groups)]
    assert rows == [2**18, 2**18, 600_000 - 2**19]
    assert pq.read_table(path)["x"].to_numpy().tolist() == list(range(600_000))


def parquet_of(columns: Columns, path: Path, ends: list[int]) -> pa.Table:
    """Writes columns without nulls in batches that end at these rows, and returns the table."""
    table = stream_of((name, values, {}) for name, values in columns.items())
    [whole] = table.batches()
    batches = [whole.rows(first, end) for first, end in itertools.pairwise([0, *ends])]
    with path.open("wb") as out, ThreadPoolExecutor(1) as pool:
        list(write_batches(_core.TableFile("parquet", table), batches, out, pool, 1))
    return read_all(table)


@pytest.mark.parametrize("rows", [1, 63, 64, 2**17 - 1, 2**17, 2**17 + 1, 2**18 - 1, 2**18])
def test_numbers_without_nulls_may_have_any_number_of_pages_and_batches(
    tmp_path: Path, rows: int
) -> None:
    rng = np.random.default_rng(rows)
    values = rng.standard_normal(rows)
    columns: Columns = {
        "double": values,
        "single": values.astype(np.float32),
        "counter": np.arange(rows).astype(np.uint16),
        "time": 0.01 * np.arange(rows),
        "any": rng.integers(-(2**63), 2**63 - 1, rows),
    }
    ends = [end for end in (1, 5, 70_000, 131_073) if end < rows] + [rows]
    expected = parquet_of(columns, tmp_path / "x.parquet", ends)
    assert_identical(pq.read_table(tmp_path / "x.parquet"), expected)
    assert_identical(pl.read_parquet(tmp_path / "x.parquet").to_arrow(), expected)


@settings(max_examples=30)
@given(data=st.data())
def test_integers_without_nulls(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Other readers agree on differences of any size, also those that wrap, in blocks that are not full."""
    most = data.draw(st.sampled_from([0, 1, 9, 300, 2**63 - 1]))
    some = data.draw(st.lists(st.integers(-most, most), min_size=1, max_size=70))
    values = np.array(some * data.draw(st.sampled_from([1, 2, 5, 19])), np.int64)
    path = tmp_path_factory.mktemp("integers") / "x.parquet"
    columns: Columns = {f"{dtype}": values.astype(dtype) for dtype in INTEGERS}
    expected = parquet_of(columns, path, [len(values)])
    assert_identical(pq.read_table(path), expected)
    assert_identical(pl.read_parquet(path).to_arrow(), expected)
    assert_identical(read_all(duckdb.read_parquet(str(path))), expected)


def test_floats_that_are_never_null_keep_the_bits_of_any_nan(tmp_path: Path) -> None:
    singles = np.array([0x7FC00001, 0xFFC12345, 0x80000000], np.uint32).view(np.float32)
    log = read_log(b"".join(encode_sample({"acceleration": np.repeat(x, 3)}) for x in singles))
    path = tmp_path / "x.parquet"
    write_table(log.arrow_stream(), path, "parquet")
    found = pq.read_table(path)["acceleration_x"]
    assert not pq.read_schema(path).field("acceleration_x").nullable
    assert reference.same_bits(found.to_numpy(), singles)


def test_a_chunk_of_a_wide_table_has_fewer_rows() -> None:
    narrow, wide = (
        _core.TableFile("parquet", stream_of((f"x{i}", np.empty(1), {}) for i in range(columns)))
        for columns in (4, 512)
    )
    assert (narrow.chunk_rows, wide.chunk_rows) == (2**18, 2**12)


def test_statistics_of_times_are_those_that_readers_know(tmp_path: Path) -> None:
    times = {"sample": np.arange(4), "time": np.array([0.5, np.nan, -1, 2]), "x": np.ones(4)}
    write_table(stream_of((*pair, {}) for pair in times.items()), tmp_path / "x.parquet", "parquet")
    group = pq.read_metadata(tmp_path / "x.parquet").row_group(0)
    found = [group.column(i).statistics for i in range(3)]
    assert [(one.min, one.max, one.null_count) for one in found[:2]] == [(0, 3, 0), (-1, 2, 1)]
    assert found[2] is None


@pytest.mark.parametrize(
    ("time", "least", "greatest"),
    [([3.5, -2, 9], -2, 9), ([-1.5, -3.5, -1], -3.5, -1), ([0.0, -0.0, 0.0], -0.0, 0.0)],
)
def test_statistics_of_times_that_all_samples_have(
    tmp_path: Path, time: list[float], least: float, greatest: float
) -> None:
    """The log has no nulls, so the numbers are encoded and counted without the crate."""
    columns: Columns = {
        "sample": np.array([7, 5, 6]),
        "time": np.array(time),
        "utc": np.array([5, -3, 4], "M8[ns]"),
    }
    expected = parquet_of(columns, tmp_path / "x.parquet", [2, 3])
    assert_identical(pq.read_table(tmp_path / "x.parquet"), expected)
    group = pq.read_metadata(tmp_path / "x.parquet").row_group(0)
    found = [group.column(i).statistics for i in range(3)]
    assert [(one.min, one.max) for one in found[:2]] == [(5, 7), (least, greatest)]
    assert math.copysign(1, found[1].min) == math.copysign(1, least)
    assert (found[2].min_raw, found[2].max_raw) == (-3, 5)
    assert [one.null_count for one in found] == [0, 0, 0]


@pytest.mark.parametrize(
    ("work", "message"),
    [
        (lambda file, other: file.encode(list(other.batches())), "the columns of a batch are"),
        (
            lambda file, other: file.append(_core.TableFile("csv", other).encode([])),
            "of another format",
        ),
        (lambda file, other: next(other.batches()).rows(1, 4), "rows 1 to 4 of 3"),
    ],
    ids=["other columns", "other format", "rows that do not exist"],
)
def test_wrong_calls(work: Any, message: str) -> None:
    file = _core.TableFile("parquet", stream_of([("x", np.arange(3), {})]))
    with pytest.raises(ValueError, match=message):
        work(file, stream_of([("y", np.arange(3), {})]))


def test_a_chunk_is_appended_once() -> None:
    table = stream_of([("x", np.arange(3), {})])
    file = _core.TableFile("csv", table)
    chunk = file.encode(list(table.batches()))
    assert bytes(file.append(chunk)) == b"0\n1\n2\n"
    with pytest.raises(ValueError, match="appended already"):
        file.append(chunk)


def test_arrays_of_different_lengths() -> None:
    with pytest.raises(ValueError, match="row count"):
        stream_of([("x", np.arange(3), {}), ("y", np.arange(4), {})])


def test_in_order_takes_no_more_than_it_needs() -> None:
    """At most two results wait, and an error of the third is raised after the first two."""
    taken = []

    def items() -> Any:
        for item in range(9):
            taken.append(item)
            yield item

    def half(item: int) -> float:
        return 4 / (2 - item)

    with ThreadPoolExecutor(2) as pool:
        results = in_order(pool, half, items(), 2)
        assert next(results) == 2
        assert taken == [0, 1, 2]
        assert next(results) == 4
        with pytest.raises(ZeroDivisionError):
            next(results)
        assert taken == [0, 1, 2, 3, 4]


def test_floats_of_the_table_are_what_they_seem() -> None:
    assert math.isnan(FLOATS[0])
    assert math.copysign(1, FLOATS[4]) == -1
