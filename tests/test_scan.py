"""Logs as LazyFrames and as record batches: the table of `read_log`, and only what is needed is decoded."""

from __future__ import annotations

import gc
import io
import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import duckdb
import polars as pl
import pyarrow.dataset as ds
import pytest
from hypothesis import given
from hypothesis import strategies as st
from polars.testing import assert_frame_equal

import streams
import xbus
from conftest import OWN_CAPTURES, damaged_streams
from streams import frame, mtdata2, packet, real
from test_shape import MAKERS, same
from xbus import XbusError, log_batches, scan_log

WALK = OWN_CAPTURES / "walk.mtb"
ENGINES: tuple[Literal["in-memory", "streaming"], ...] = ("in-memory", "streaming")


@pytest.fixture(autouse=True)
def end_of_reading() -> Iterator[None]:
    """Waits for threads that still read a part when a query has all it needs."""
    before = {*threading.enumerate()}
    yield
    new = {*threading.enumerate()} - before
    if threads := [one for one in new if one.name.startswith("xbus_")]:
        gc.collect()
        for thread in threads:
            thread.join(10)


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, list[str] | None]]:
    """The first sample of each part that was read, and the quantities that were asked for."""
    found: list[tuple[int, list[str] | None]] = []
    read = xbus.LogPart.read

    def noted(part: xbus.LogPart, *, quantities: list[str] | None = None) -> xbus.Log:
        found.append((part.first_sample, quantities))
        return read(part, quantities=quantities)

    monkeypatch.setattr(xbus.LogPart, "read", noted)
    return found


# The law


@given(damaged_streams(30), st.integers(1, 2000), st.booleans(), st.integers(1, 2))
def test_batches_of_a_log_are_its_table(data: bytes, block: int, raw: bool, threads: int) -> None:
    reader = log_batches(data, block_bytes=block, raw=raw, threads=threads)
    assert same(reader.read_all(), xbus.read_log(data).to_arrow(raw=raw))


@given(damaged_streams(30), st.integers(1, 2000), st.booleans(), st.sampled_from(ENGINES))
def test_a_lazy_frame_is_the_table(
    data: bytes, block: int, raw: bool, engine: Literal["in-memory", "streaming"]
) -> None:
    lazy = scan_log(data, block_bytes=block, raw=raw)
    table = xbus.read_log(data).to_polars(raw=raw)
    assert lazy.collect_schema() == table.schema
    assert_frame_equal(lazy.collect(engine=engine), table, check_exact=True)


@pytest.mark.parametrize("make", MAKERS)
def test_columns_that_come_late_or_change(make: Callable[[], bytes]) -> None:
    data = make()
    log = xbus.read_log(data)
    assert same(log_batches(data, block_bytes=300).read_all(), log.to_arrow())
    assert_frame_equal(scan_log(data, block_bytes=300).collect(), log.to_polars(), check_exact=True)


@pytest.mark.parametrize("make", MAKERS)
def test_each_column_alone(make: Callable[[], bytes]) -> None:
    """With the quantities of one column, the column is what it is beside all others."""
    data = make()
    table = xbus.read_log(data).to_polars()
    lazy = scan_log(data, block_bytes=2000)
    for name in table.columns:
        assert_frame_equal(lazy.select(name).collect(), table.select(name), check_exact=True)


def test_each_column_of_a_recording_with_host_times(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    with xbus.connect("sim:MTi-680G") as device:
        outputs = {
            "sample_time_fine": None,
            "acceleration": 100,
            "gnss_pvt_data": 4,
            "utc_time": 10,
        }
        with device.configure(outputs):
            pass
        with device.record(path):
            for _ in range(300):
                device.read_sample()
    table = xbus.read_log(path).to_polars()
    assert {"host_time", "utc"} <= set(table.columns)
    lazy = scan_log(path, block_bytes=2000)
    for name in table.columns:
        assert_frame_equal(lazy.select(name).collect(), table.select(name), check_exact=True)


def test_one_device_and_a_rate() -> None:
    data = b"".join(
        mtdata2(packet(0x1020, (i // 2).to_bytes(2, "big")), real(0x4020, i, 0, 0), bid=i % 2 + 1)
        for i in range(1000)
    )
    log = xbus.read_log(data, bid=2, rate=50)
    assert_frame_equal(scan_log(data, block_bytes=900, bid=2, rate=50).collect(), log.to_polars())
    assert same(log_batches(data, block_bytes=900, bid=2, rate=50).read_all(), log.to_arrow())
    both = (
        scan_log(data, block_bytes=900)
        .filter(pl.col("bid") == 2)
        .select("acceleration_x")
        .collect()
    )
    assert both["acceleration_x"].to_list() == list(range(1, 1000, 2))


# What is read


@pytest.mark.parametrize(
    ("columns", "quantities"),
    [
        (["acceleration_x", "acceleration_z"], ["acceleration"]),
        (["sample", "time"], []),
        (["baro_pressure", "quaternion_q0"], ["baro_pressure", "quaternion"]),
        (["utc"], ["utc_time", "gnss_pvt_data"]),
    ],
)
def test_only_needed_quantities_are_decoded(
    columns: list[str], quantities: list[str], reads: list[tuple[int, list[str] | None]]
) -> None:
    table = xbus.read_log(WALK).to_polars().select(columns)
    for engine in ENGINES:
        reads.clear()
        lazy = scan_log(WALK, block_bytes=20_000)
        assert not reads
        assert_frame_equal(lazy.select(columns).collect(engine=engine), table)
        assert len(reads) > 3
        assert all(set(asked or ()) == set(quantities) for _, asked in reads)


def test_both_coordinate_systems_keep_their_names(
    reads: list[tuple[int, list[str] | None]],
) -> None:
    ned, enu = real(0x2014, 1, 0, 0, 0), real(0x2010, 0, 1, 0, 0)
    data = b"".join(mtdata2(one, real(0x4020, 1, 2, 3)) for one in (ned, enu) * 20)
    lazy = scan_log(data, block_bytes=300).select(pl.col("quaternion_ned_q0").sum())
    assert lazy.collect().item() == 20
    assert {tuple(asked or ()) for _, asked in reads} == {("quaternion",)}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("predicate", "is_skipping"),
    [
        (pl.col("sample") < 100, True),
        (pl.lit(100) > pl.col("sample"), True),
        (pl.col("sample") == 7, True),
        (pl.col("sample").is_between(300, 350), True),
        ((pl.col("sample") >= 900) & (pl.col("acceleration_x") > 0), True),
        ((pl.col("acceleration_x") > 0) & (pl.col("time") <= 429493.5), True),
        (pl.col("time").is_between(429493, 429494, closed="none"), True),
        (pl.col("time") > 429498, True),
        (pl.col("time") > 1e9, True),
        ((pl.col("sample") < 100) | (pl.col("sample") > 900), False),
        (pl.col("sample") * 2 < 100, False),
        (pl.col("sample") != 100, False),
        (pl.col("time") < float("nan"), False),
        (pl.col("acceleration_x") > 1, False),
        (pl.col("time").is_null(), False),
    ],
)
def test_predicates(
    predicate: pl.Expr,
    is_skipping: bool,
    engine: Literal["in-memory", "streaming"],
    reads: list[tuple[int, list[str] | None]],
) -> None:
    lazy = scan_log(WALK, block_bytes=10_000)
    table = xbus.read_log(WALK).to_polars()
    query = lazy.filter(predicate).select("sample", "acceleration_z")
    expected = table.filter(predicate).select("sample", "acceleration_z")
    assert_frame_equal(query.collect(engine=engine), expected)
    parts = len(xbus.split_log(WALK, block_bytes=10_000))
    assert (len(reads) < parts) == is_skipping


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("rows", [0, 1, 130, 400, 5000])
def test_rows(
    rows: int, engine: Literal["in-memory", "streaming"], reads: list[tuple[int, list[str] | None]]
) -> None:
    lazy = scan_log(WALK, block_bytes=10_000)
    table = xbus.read_log(WALK).to_polars()
    assert_frame_equal(lazy.head(rows).collect(engine=engine), table.head(rows))
    assert all(first < rows for first, _ in reads)
    positive = pl.col("acceleration_x") > 0
    assert_frame_equal(
        lazy.head(rows).filter(positive).collect(engine=engine), table.head(rows).filter(positive)
    )
    assert_frame_equal(
        lazy.filter(positive).head(rows).collect(engine=engine), table.filter(positive).head(rows)
    )


@pytest.mark.parametrize("engine", ENGINES)
def test_a_row_index_needs_no_column(engine: Literal["in-memory", "streaming"]) -> None:
    lazy = scan_log(WALK, block_bytes=20_000)
    table = lazy.collect().lazy()
    queries: list[Callable[[pl.LazyFrame], pl.LazyFrame]] = [
        lambda frame: frame.with_row_index("row").select("row"),
        lambda frame: frame.with_row_index("row").filter(pl.col("row") > 1000).select("row"),
        lambda frame: frame.with_row_index("row").select(pl.len()),
        lambda frame: frame.select(pl.int_range(pl.len())),
        lambda frame: frame.head(200).with_row_index("row").select(pl.col("row").sum()),
    ]
    for query in queries:
        assert_frame_equal(query(lazy).collect(engine=engine), query(table).collect())


def test_a_consumer_that_stops_reads_no_more(reads: list[tuple[int, list[str] | None]]) -> None:
    reader = log_batches(WALK, block_bytes=1000, threads=2)
    reader.read_next_batch()
    reader.close()
    assert len(reads) <= 4


# Engines


def test_duckdb() -> None:
    batches = log_batches(WALK, block_bytes=20_000)
    query = "SELECT count(*), count(baro_pressure), round(avg(acceleration_z), 2) FROM batches"
    relation = duckdb.sql(query)
    assert relation is not None
    assert relation.fetchall() == [(1040, 100, 9.81)]
    del batches


def test_duckdb_reads_what_a_query_of_a_lazy_frame_needs(
    reads: list[tuple[int, list[str] | None]],
) -> None:
    lazy = scan_log(WALK, block_bytes=10_000)
    table = xbus.read_log(WALK).to_polars().filter(pl.col("sample") < 100)
    relation = duckdb.sql("SELECT count(*), max(acceleration_z) FROM lazy WHERE sample < 100")
    assert relation is not None
    for _ in range(2):
        reads.clear()
        assert relation.fetchall() == [(100, table["acceleration_z"].max())]
        assert reads
        assert all(first < 100 and asked == ["acceleration"] for first, asked in reads)
    del lazy


def test_duckdb_reports_a_file_that_has_changed(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    path.write_bytes(streams.ahrs(1000))
    lazy, batches = scan_log(path, block_bytes=10_000), log_batches(path, block_bytes=10_000)
    path.write_bytes(streams.ahrs(999))
    for name in ("lazy", "batches"):
        with pytest.raises(
            duckdb.Error, match=r"log\.mtb has changed since it was split; split it"
        ):
            duckdb.execute(f"SELECT sum(acceleration_x) FROM {name}").fetchall()  # noqa: S608
    del lazy, batches


def test_a_dataset(tmp_path: Path) -> None:
    reader = log_batches(WALK, block_bytes=20_000)
    ds.write_dataset(reader, tmp_path / "walk", format="parquet", preserve_order=True)
    assert ds.dataset(tmp_path / "walk").to_table().equals(xbus.read_log(WALK).to_arrow())


def test_chosen_quantities(reads: list[tuple[int, list[str] | None]]) -> None:
    table = log_batches(WALK, quantities=iter(["acceleration", "baro_pressure"])).read_all()
    assert same(table, xbus.read_log(WALK, quantities=["acceleration", "baro_pressure"]).to_arrow())
    assert all(asked == ["acceleration", "baro_pressure"] for _, asked in reads)


# Bad input


@pytest.mark.parametrize(
    "data", [b"", b"\xfa", bytes(3000), frame(0x3E) * 9, mtdata2(packet(0x7770, b"abc")) * 9]
)
def test_inputs_without_known_values(data: bytes) -> None:
    assert same(log_batches(data, block_bytes=100).read_all(), xbus.read_log(data).to_arrow())
    assert_frame_equal(scan_log(data, block_bytes=100).collect(), xbus.read_log(data).to_polars())


@pytest.mark.parametrize("scan", [scan_log, log_batches])
@pytest.mark.parametrize(
    ("source", "options", "kind", "message"),
    [
        (io.BytesIO(), {}, TypeError, "a log is split from a path, a URL or bytes; a file object"),
        ("pipe", {}, TypeError, "is no regular file and can be read only once"),
        ("nowhere.mtb", {}, FileNotFoundError, "No such file or directory: 'nowhere.mtb'"),
        (".", {}, IsADirectoryError, "Is a directory: '.'"),
        (b"", {"block_bytes": 0}, ValueError, "block_bytes must be at least 1, not 0"),
        (b"", {"threads": 0}, ValueError, "threads must be at least 1, not 0"),
        (b"", {"bid": 3}, ValueError, "no samples"),
    ],
)
def test_wrong_calls(
    scan: Callable[..., Any],
    source: Any,
    options: dict[str, Any],
    kind: type[Exception],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    with pytest.raises(kind, match=message):
        scan(source, **options)


def test_a_quantity_that_does_not_exist() -> None:
    with pytest.raises(ValueError, match="aceleration"):
        log_batches("nowhere.mtb", quantities=["aceleration"])
    with pytest.raises(TypeError, match="quantities must be a list"):
        log_batches("nowhere.mtb", quantities="acceleration")


@pytest.mark.parametrize("engine", ENGINES)
def test_a_file_that_changes_between_the_passes(
    engine: Literal["in-memory", "streaming"], tmp_path: Path
) -> None:
    path = tmp_path / "log.mtb"
    path.write_bytes(streams.ahrs(1000))
    lazy, batches = scan_log(path, block_bytes=10_000), log_batches(path, block_bytes=10_000)
    path.write_bytes(streams.ahrs(999))
    with pytest.raises(XbusError, match=r"log\.mtb has changed since it was split; split it again"):
        lazy.collect(engine=engine)
    with pytest.raises(XbusError, match=r"log\.mtb has changed since it was split; split it again"):
        batches.read_all()
    path.unlink()
    with pytest.raises(FileNotFoundError, match=r"log\.mtb"):
        lazy.collect(engine=engine)
