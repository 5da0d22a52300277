"""``xbus decode -o night/``: a folder of files that other software reads as one table."""

from __future__ import annotations

import struct
from datetime import UTC, datetime, timedelta
from pathlib import Path

import dask
import dask.dataframe as dd
import duckdb
import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.csv
import pyarrow.dataset
import pyarrow.parquet as pq
import pytest

import xbus
from conftest import counter, fine
from streams import mtdata2, packet, real
from test_cli import WALK, run, sentence
from test_decode_parts import LOGS, PART
from test_table_file import assert_identical
from xbus.cli import decoding
from xbus.log import dataset, table_file
from xbus.log.arrivals import Arrivals

#: When the night begins: samples are ten minutes apart.
EVENING = datetime(2026, 11, 22, 22, 30, tzinfo=UTC)


@pytest.fixture(autouse=True)
def _small_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(decoding, "PART", PART)


def utc(time: datetime) -> bytes:
    """UtcTime, valid."""
    return packet(0x1010, struct.pack(">IHBBBBBB", 0, *time.timetuple()[:6], 7))


def night(known: range = range(12), bid: int = 1) -> bytes:
    """Twelve samples, ten minutes apart; UTC is known in some of them. A second device has none."""
    samples = []
    for i in range(12):
        stamp = utc(EVENING + timedelta(minutes=10 * i)) if i in known else b""
        samples.append(mtdata2(counter(i), fine(6_000_000 * i), stamp, real(0x4020, i, 0, 0)))
        samples.append(mtdata2(counter(i), fine(77 + 6_000_000 * i), bid=2))
    return b"".join(samples)


def files(folder: str = "night") -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in Path(folder).rglob("part-*"))


def table(folder: str = "night") -> pa.Table:
    """The files of a dataset in the order of their samples, each read by itself."""
    tables = [pq.ParquetFile(Path(folder) / name).read() for name in files(folder)]
    assert all(found.schema.equals(tables[0].schema, check_metadata=True) for found in tables)
    return pa.concat_tables(sorted(tables, key=lambda found: found["sample"][0].as_py()))


@pytest.mark.parametrize("name", LOGS)
@pytest.mark.parametrize(
    ("options", "key"),
    [
        ([], None),
        (["--partition-by", "hour"], None),
        (["--partition-by", "hour", "--quantity", "acceleration"], "acceleration"),
        (["--partition-by", "hour", "--quantity", "gnss_sat_info"], "gnss_sat_info"),
        (["--partition-by", "hour", "--quantity", "packet_counter", "--raw"], "packet_counter"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_a_dataset_is_the_table_of_the_log(name: str, options: list[str], key: str | None) -> None:
    Path("log.mtb").write_bytes(LOGS[name])
    single = [text for text in options if text not in ("--partition-by", "hour")]
    expected = run("decode", "log.mtb", "-o", "log.parquet", *single)
    result = run("decode", "log.mtb", "-o", "night/", *options)
    assert result.exit_code == expected.exit_code
    if result.exit_code == 0:
        assert_identical(table(), pq.read_table("log.parquet"))
        assert f"{len(files())} part" in result.stderr
    else:
        assert (result.stderr, files()) == (expected.stderr, [])


@pytest.mark.filterwarnings("ignore:The inplace keyword")  # of dask with pandas 3
def test_other_software_reads_one_table() -> None:
    """Every reader finds the rows in the order of the log, and the date and hour of each."""
    data = night()
    Path("log.mtb").write_bytes(data)
    assert run("decode", "log.mtb", "-o", "night/", "--partition-by", "hour").exit_code == 0
    assert files() == [
        "date=2026-11-22/hour=22/part-0000.parquet",
        "date=2026-11-22/hour=23/part-0000.parquet",
        "date=2026-11-23/hour=00/part-0000.parquet",
    ]
    expected = xbus.read_log(data).to_arrow()
    pattern = "night/**/*.parquet"
    for source in (pattern, "night/"):
        frame = pl.scan_parquet(source, hive_partitioning=True).collect()
        assert frame["hour"].to_list() == [22] * 6 + [23] * 12 + [0] * 6
        assert frame.drop("date", "hour").equals(pl.DataFrame(expected))
    query = f"from read_parquet('{pattern}', hive_partitioning=true)"
    with duckdb.connect() as database:
        rows = database.execute(f"select sample {query}").fetchall()
        late = database.execute(f"select sample {query} where date = date '2026-11-23'").fetchall()
    assert (rows, late) == ([(i,) for i in range(24)], [(i,) for i in range(18, 24)])
    found = pyarrow.dataset.dataset("night", partitioning="hive").to_table()
    assert_identical(found.select(expected.column_names), expected)
    with dask.config.set(scheduler="synchronous"):
        frames = dd.read_parquet("night")
        assert frames["sample"].compute().tolist() == expected["sample"].to_pylist()


@pytest.mark.parametrize(
    ("data", "times", "expected"),
    [
        (night(), False, {"22": 6, "23": 12, "00": 6}),
        (night(range(7, 9)), False, {"22": 6, "23": 12, "00": 6}),
        (night(range(0)), False, {"0000": 12, "0001": 12}),
        (night(range(0)), True, {"23": 12, "00": 12}),
        (night() + night(), False, {"22": 12, "23": 24, "00": 12}),
        (night(range(6)) + night(range(0)), False, {"22": 6, "23": 12, "00": 14, "01": 12, "02": 4}),
    ],
    ids=["UTC", "UTC for a while", "no UTC", "arrivals", "a restart", "a restart without UTC"],
)  # fmt: skip
def test_the_hour_of_a_sample(data: bytes, times: bool, expected: dict[str, int]) -> None:
    Path("log.mtb").write_bytes(data)
    if times:  # the first samples arrive at 23:00
        end = np.arange(1, 13) * len(data) // 12
        arrived = np.datetime64("2026-11-22T23:00", "ns") + np.arange(12) * np.timedelta64(600, "s")
        arrivals = Arrivals(end, arrived.astype(np.int64), len(data))
        Path("log.mtb.times").write_bytes(b"".join(arrivals.blocks()))
    assert run("decode", "log.mtb", "-o", "night/", "--partition-by", "hour").exit_code == 0
    counts: dict[str, int] = {}
    for name in files():
        hour = Path(name).parent.name.removeprefix("hour=")
        counts[hour] = counts.get(hour, 0) + pq.ParquetFile(Path("night") / name).metadata.num_rows
    assert counts == expected


@pytest.mark.parametrize("suffix", [".parquet", ".csv", ".arrow"])
def test_files_of_a_size(suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dataset, "chunks", lambda batches, _: table_file.chunks(batches, 150))
    Path("log.mtb").write_bytes(LOGS["late columns"])
    size = ["--partition-size", "0.001KB"]
    result = run("decode", "log.mtb", "-o", "night/", "--suffix", suffix, *size)
    assert result.stderr.startswith("night/: 624 rows, 39 columns, 5 parts;")
    assert run("decode", "log.mtb", "-o", f"one{suffix}").exit_code == 0
    if suffix == ".csv":
        head, *rows = Path("one.csv").read_text().splitlines()
        several = [Path("night", name).read_text().splitlines() for name in files()]
        assert {lines[0] for lines in several} == {head}
        assert [row for lines in several for row in lines[1:]] == rows
    else:
        scan = pl.scan_parquet if suffix == ".parquet" else pl.scan_ipc
        found, expected = (scan(f"{name}{suffix}").collect() for name in ("night/*", "one"))
        assert found.equals(expected)


def test_a_batch_writes_a_folder_for_each_recording() -> None:
    Path("in").mkdir()
    for name in ("a", "b"):
        Path(f"in/{name}.mtb").write_bytes(LOGS["walk"])
    batch = ["decode", "in", "--out-dir", "out", "--partition-by", "hour"]
    assert run(*batch).exit_code == 0
    assert files("out") == [
        f"{name}/date=2026-11-22/hour=09/part-0000.parquet" for name in ("a", "b")
    ]
    assert "2 skipped" in run(*batch, "--skip-existing").stderr


def test_only_a_dataset_is_replaced() -> None:
    decode = ["decode", WALK, "-o", "night/"]
    Path("night").mkdir()
    assert run(*decode).exit_code == 0
    assert run(*decode, "--partition-by", "hour").exit_code == 0
    assert files() == ["date=2026-11-22/hour=09/part-0000.parquet"]
    Path("night/date=2026-11-22/notes.txt").write_text("mine")
    assert sentence(run(*decode)) == (
        "night/ is not replaced, because it has files that xbus did not write, such as "
        "date=2026-11-22/notes.txt; move them, or choose another folder"
    )
    assert [path.name for path in Path().iterdir()] == ["night"]


def test_the_working_directory_is_not_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    Path("night").mkdir()
    monkeypatch.chdir("night")
    assert sentence(run("decode", WALK, "-o", "./")) == (
        "./ is the working directory, which cannot be replaced; choose another folder"
    )
    assert list(Path().iterdir()) == []


def test_a_failure_leaves_the_folder_of_before(monkeypatch: pytest.MonkeyPatch) -> None:
    Path("log.mtb").write_bytes(night())
    decode = ["decode", "log.mtb", "-o", "night/", "--partition-by", "hour"]
    assert run(*decode).exit_code == 0
    before = files()
    monkeypatch.setattr(dataset, "MOST_FILES", 2)
    assert sentence(run(*decode)).endswith(
        "more than 2 files; choose a larger --partition-size, or omit --partition-by"
    )
    assert (files(), sorted(path.name for path in Path().iterdir())) == (
        before,
        ["log.mtb", "night"],
    )


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["-o", "one.parquet", "--partition-by", "hour"], 2, "--partition-by needs a folder, such as -o"),
        (["-o", "night/", "--suffix", ".npz"], 2, "a folder has tables: .parquet,"),
        (["-o", "night/", "--rate-out", "10"], 2, "are written to one file, not to a folder"),
        (["-o", "night/", "--quantity", "GPGGA"], 2, "are written to one file, not to a folder"),
        (["-o", ".."], 2, "'..' is a folder; '../' writes a table to several files in it"),
        (["-o", "no/night/"], 1, "cannot write no/night/: No such file or directory"),
        (["-o", "log.mtb/"], 1, "cannot write log.mtb/: Not a directory"),
        (["-o", "night/", "--partition-by", "hour"], 1, "hours are not known; add --rate, or omit"),
    ],
)  # fmt: skip
def test_wrong_calls(arguments: list[str], status: int, message: str) -> None:
    Path("log.mtb").write_bytes(b"".join(mtdata2(counter(i)) for i in range(9)))
    result = run("decode", "log.mtb", *arguments)
    assert result.exit_code == status
    assert message in " ".join(result.stderr.replace("\n", " ").split())
    assert [path.name for path in Path().iterdir()] == ["log.mtb"]
