"""Files: Parquet, CSV, Arrow and npz. Files are written atomically."""

from __future__ import annotations

import io
import os
import stat
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import reference
import streams
import xbus
from conftest import OWN_CAPTURES, counter, fine
from streams import mtdata2, packet, real
from test_arrow import DATA, SATELLITES
from xbus.export.replacing import replacing

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")
pytest.importorskip("pyarrow.csv")

LOGS = {
    "mixed": DATA,
    "walk": (OWN_CAPTURES / "walk.mtb").read_bytes(),
    "field": (OWN_CAPTURES / "field.mtb").read_bytes(),
    "more than a batch": streams.hr(2**18 + 5),
    "empty": b"",
}


@pytest.fixture(params=list(LOGS))
def log(request: pytest.FixtureRequest) -> xbus.Log:
    return xbus.read_log(LOGS[request.param])


# ---------------------------------------------------------------------------------------------
# Round trips
# ---------------------------------------------------------------------------------------------


def test_parquet(log: xbus.Log, tmp_path: Path) -> None:
    """The table round-trips, including metadata."""
    log.to_parquet(tmp_path / "log.parquet")
    table = pq.read_table(tmp_path / "log.parquet")
    expected = log.to_arrow()
    assert table.equals(expected, check_metadata=False)
    for one, other in zip(table.schema, expected.schema, strict=True):
        assert (other.metadata or {}).items() <= (one.metadata or {}).items()


def test_parquet_statistics_exist_for_filter_columns(tmp_path: Path) -> None:
    log = xbus.read_log(LOGS["walk"])
    log.to_parquet(tmp_path / "log.parquet")
    group = pq.read_metadata(tmp_path / "log.parquet").row_group(0)
    columns = {index.path_in_schema: index for index in map(group.column, range(group.num_columns))}
    kept = [name for name, chunk in columns.items() if chunk.statistics]
    assert kept == ["sample", "time", "utc", "utc_time"]
    assert columns["time"].statistics.min == np.nanmin(log.time)
    assert columns["time"].statistics.max == np.nanmax(log.time)


def test_feather(log: xbus.Log, tmp_path: Path) -> None:
    log.to_feather(tmp_path / "log.arrow")
    with pa.ipc.open_file(tmp_path / "log.arrow") as file:
        assert file.read_all().equals(log.to_arrow(), check_metadata=True)


def test_csv(log: xbus.Log, tmp_path: Path) -> None:
    """A header, then one line for each sample, as pyarrow writes them: nulls are empty fields."""
    log.to_csv(str(tmp_path / "log.csv"))
    expected = io.BytesIO()
    pa.csv.write_csv(log.to_arrow(), expected)
    assert (tmp_path / "log.csv").read_bytes() == expected.getvalue()


def test_utc_in_csv(tmp_path: Path) -> None:
    xbus.read_log(DATA).to_csv(tmp_path / "log.csv", "utc_time")
    lines = (tmp_path / "log.csv").read_text().splitlines()
    assert lines == ['"sample","time","utc_time"', "1,,2025-07-13 09:21:34.000000005Z", "2,0.02,"]


def test_npz(log: xbus.Log, tmp_path: Path) -> None:
    """One array for each quantity, without pickles, and arrays of its samples and times."""
    log.to_npz(tmp_path / "log.npz", raw=True)
    with np.load(tmp_path / "log.npz", allow_pickle=False) as file:
        found = {name: file[name] for name in file.files}
    assert np.array_equal(found.pop("time"), log.time, equal_nan=True)
    assert np.array_equal(found.pop("packet_counter.unwrapped"), log.packet_counter)
    if "utc" in found:
        assert np.array_equal(found.pop("utc"), log.utc, equal_nan=True)
    for key in log:
        column = log[key]
        stem = key if isinstance(key, str) else f"{key[0]}_{key[1].lower()}"
        assert reference.same_bits(found.pop(stem), column.values)
        assert np.array_equal(found.pop(f"{stem}.sample"), column.sample)
        assert np.array_equal(found.pop(f"{stem}.time"), column.time, equal_nan=True)
        if column.name == "gnss_sat_info":
            assert reference.same_bits(found.pop(f"{stem}.satellites"), column.satellites)
            assert np.array_equal(found.pop(f"{stem}.offsets"), column.offsets)
    assert found == {}


def test_npz_names(tmp_path: Path) -> None:
    xbus.read_log(DATA).to_npz(tmp_path / "log.npz")
    with np.load(tmp_path / "log.npz") as file:
        assert {"quaternion_enu", "quaternion_ned", "acceleration", "gnss_sat_info"} <= set(
            file.files
        )
        assert file["acceleration"].shape == (3, 3)


@pytest.mark.parametrize(
    "key", ["acceleration", "gnss_sat_info", "utc_time", ("quaternion", "NED")]
)
def test_one_quantity(key: Any, tmp_path: Path) -> None:
    """The same table as `to_arrow` with a key."""
    log = xbus.read_log(DATA)
    expected = log.to_arrow(key)
    log.to_parquet(tmp_path / "log.parquet", key)
    assert pq.read_table(tmp_path / "log.parquet").equals(expected)
    log.to_feather(tmp_path / "log.arrow", key)
    with pa.ipc.open_file(tmp_path / "log.arrow") as file:
        assert file.read_all().equals(expected)
    log.to_csv(tmp_path / "log.csv", key)
    assert len((tmp_path / "log.csv").read_text().splitlines()) == 1 + expected.num_rows


def test_parquet_preserves_every_bit(tmp_path: Path) -> None:
    """All kinds of NaN, infinities, and the limits of integers."""
    numbers = [
        packet(0x0810, bytes.fromhex(name))
        for name in ("7FC00001", "FFC00000", "FF800000", "80000000")
    ]
    log = xbus.read_log(
        b"".join(mtdata2(number, packet(0x10A0, b"\xff" * 8)) for number in numbers)
    )
    log.to_parquet(tmp_path / "log.parquet")
    table = pq.read_table(tmp_path / "log.parquet")
    temperature = np.asarray(table["temperature"])
    assert reference.same_bits(temperature, log["temperature"].values)
    assert table["sample_time64"].to_pylist() == [2**64 - 1] * 4
    assert table["temperature"].null_count == 0


# ---------------------------------------------------------------------------------------------
# Atomic writes
# ---------------------------------------------------------------------------------------------

WRITERS: dict[str, Callable[[xbus.Log, Any], None]] = {
    "to_parquet": lambda log, path: log.to_parquet(path),
    "to_csv": lambda log, path: log.to_csv(path),
    "to_feather": lambda log, path: log.to_feather(path),
    "to_npz": lambda log, path: log.to_npz(path),
}

FULL_DISK = """
    import resource, sys
    import xbus
    path, how = sys.argv[1:]
    log = xbus.read_log(sys.stdin.buffer)
    getattr(log, how)(path + ".sound")  # loads everything, and shows that the write works
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
    try:
        getattr(log, how)(path)
    except OSError as error:
        print(error)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="limits are those of POSIX")
@pytest.mark.parametrize("how", WRITERS)
@pytest.mark.parametrize("before", [b"what was there", None])
def test_a_full_disk(how: str, before: bytes | None, tmp_path: Path) -> None:
    """If the write fails, the existing file is unchanged and no other file remains."""
    path = tmp_path / "log"
    if before is not None:
        path.write_bytes(before)
    program = [sys.executable, "-c", textwrap.dedent(FULL_DISK), str(path), how]
    result = subprocess.run(program, input=LOGS["walk"], check=True, capture_output=True)  # noqa: S603
    assert b"File too large" in result.stdout, result.stderr
    sound = tmp_path / "log.sound"
    assert sound.stat().st_size > 20_000
    assert set(tmp_path.iterdir()) == {sound, path} - ({path} if before is None else set())
    assert before is None or path.read_bytes() == before


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError, OSError])
@pytest.mark.parametrize("before", [b"what was there", None])
def test_an_interruption(error: type[BaseException], before: bytes | None, tmp_path: Path) -> None:
    path = tmp_path / "log.bin"
    if before is not None:
        path.write_bytes(before)

    def write() -> None:
        with replacing(path) as out:
            out.write(b"half of it")
            out.flush()
            assert len(list(tmp_path.iterdir())) == (1 if before is None else 2)
            assert before is None or path.read_bytes() == before
            raise error

    with pytest.raises(error):
        write()
    assert list(tmp_path.iterdir()) == ([] if before is None else [path])
    assert before is None or path.read_bytes() == before


@pytest.mark.parametrize("how", WRITERS)
def test_replacing(how: str, tmp_path: Path) -> None:
    """The existing file is replaced, its permissions are kept, and no other file remains."""
    path = tmp_path / "log"
    path.write_bytes(b"what was there")
    path.chmod(0o640)
    WRITERS[how](xbus.read_log(DATA), path)
    assert path.stat().st_size > 500
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(sys.platform == "win32", reason="rights are those of POSIX")
def test_rights_of_a_new_file(tmp_path: Path) -> None:
    old = os.umask(0o027)
    try:
        xbus.read_log(DATA).to_npz(tmp_path / "log")
    finally:
        os.umask(old)
    assert stat.S_IMODE((tmp_path / "log").stat().st_mode) == 0o640


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")
def test_through_a_link(tmp_path: Path) -> None:
    """The link is kept, and its target is replaced."""
    (tmp_path / "there").mkdir()
    target, link = tmp_path / "there" / "log.csv", tmp_path / "link.csv"
    link.symlink_to(target)
    for _ in range(2):  # to nothing, and to a file
        xbus.read_log(DATA).to_csv(link, "acceleration")
        assert link.is_symlink()
        assert target.read_text().startswith('"sample"')
    assert len(list(tmp_path.rglob("*"))) == 3


@pytest.mark.parametrize("how", WRITERS)
def test_no_such_directory(how: str, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        WRITERS[how](xbus.read_log(DATA), tmp_path / "no" / "log")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("how", WRITERS)
def test_a_directory(how: str, tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError):
        WRITERS[how](xbus.read_log(DATA), tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/dev/null").exists(), reason="no such device here")
@pytest.mark.parametrize("how", ["to_csv", "to_parquet", "to_feather"])
def test_devices_are_written_directly(how: str) -> None:
    """A device file is not replaced."""
    WRITERS[how](xbus.read_log(DATA), "/dev/null")
    assert Path("/dev/null").is_char_device()


def test_a_missing_quantity_is_an_error(tmp_path: Path) -> None:
    """The error is raised before anything is written."""
    log = xbus.read_log(DATA)
    for write in (log.to_parquet, log.to_csv, log.to_feather):
        with pytest.raises(KeyError):
            write(tmp_path / "log", "no such quantity")
    assert list(tmp_path.iterdir()) == []


# ---------------------------------------------------------------------------------------------
# Missing packages
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("how", "missing", "text"),
    [
        (
            "to_arrow",
            "pyarrow",
            'to make Arrow tables, pyarrow is needed: pip install "xbus-mti[arrow]"',
        ),
        (
            "to_pandas",
            "pandas",
            'to make pandas DataFrames, pandas is needed: pip install "xbus-mti[pandas]"',
        ),
        (
            "to_polars",
            "polars",
            'to make polars DataFrames, polars is needed: pip install "xbus-mti[polars]"',
        ),
    ],
)
def test_a_missing_extra(
    monkeypatch: pytest.MonkeyPatch, how: str, missing: str, text: str
) -> None:
    """The error is one sentence that names the extra."""
    log = xbus.read_log(DATA)
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(ImportError) as caught:
        getattr(log, how)()
    assert str(caught.value) == text


def test_a_url_without_fsspec(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(ImportError) as caught:
        xbus.read_log("s3://bucket/log.mtb")
    assert (
        str(caught.value) == 'to read from a URL, fsspec is needed: pip install "xbus-mti[fsspec]"'
    )


def test_files_need_no_extra(tmp_path: Path) -> None:
    """A log can be read, inspected and written to every kind of file with numpy alone."""
    program = """
        import sys
        for name in ("pyarrow", "pandas", "polars", "fsspec", "duckdb"):
            sys.modules[name] = None
        import xbus
        log = xbus.read_log(sys.argv[1])
        for how in ("to_parquet", "to_csv", "to_feather", "to_npz"):
            getattr(log, how)(sys.argv[2] + how)
        log.resample(10).to_parquet(sys.argv[2] + "resampled")
        assert repr(log) and log._repr_html_() and log["acceleration"]._repr_html_()
        print(len(log))
    """
    arguments = [str(OWN_CAPTURES / "walk.mtb"), f"{tmp_path}/"]
    command = [sys.executable, "-c", textwrap.dedent(program), *arguments]
    result = subprocess.run(command, check=True, capture_output=True, text=True)  # noqa: S603
    assert result.stdout == "1040\n"
    assert {path.name for path in tmp_path.iterdir()} == {*WRITERS, "resampled"}
    assert pq.read_table(tmp_path / "to_parquet").num_rows == 1040


def test_parts_share_one_schema(tmp_path: Path) -> None:
    """The parts of a log have one schema, so that files from several machines can be joined."""
    data = b"".join(mtdata2(counter(i), fine(i), real(0x4020, i, 0, 0)) for i in range(100))
    data += mtdata2(packet(0x7020, SATELLITES))
    for i, part in enumerate(xbus.iter_log(data, block_bytes=1000)):
        part.to_parquet(tmp_path / f"{i:03}.parquet", "acceleration")
    files = sorted(tmp_path.iterdir())
    assert len(files) > 3
    joined = pa.concat_tables([pq.read_table(file) for file in files])
    assert joined.equals(xbus.read_log(data).to_arrow("acceleration"))
