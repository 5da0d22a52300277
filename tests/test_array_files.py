"""MATLAB files, HDF5 files and Excel workbooks, read by the libraries of other people."""

from __future__ import annotations

import io
import re
import struct
import sys
from pathlib import Path
from typing import Any

import h5py
import mat73
import numpy as np
import openpyxl
import pytest
import scipy.io

import reference
import xbus
from conftest import counter, fine
from streams import mtdata2, packet
from test_cli import WALK, run, sentence
from test_decode_parts import LOGS, PART, times_of
from xbus.cli import decoding
from xbus.export import columns, excel, matlab
from xbus.export.excel import Excel
from xbus.export.forgiving import ForgivingFile
from xbus.export.format import Format, export
from xbus.export.hdf5 import Hdf5, Hdf5File
from xbus.export.matlab import Matlab
from xbus.protocol.tables import QUANTITIES

#: Logs with vectors, structs, satellites, mixed coordinates, several devices, gaps and damage.
NAMES = ("walk", "two devices", "late columns", "with position", "random 1")


@pytest.fixture(autouse=True)
def _small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(decoding, "PART", PART)
    monkeypatch.setattr(columns, "BLOCK", 100)


def read_hdf5(path: str) -> dict[str, Any]:
    def content(node: Any) -> Any:
        return (
            {name: content(node[name]) for name in node}
            if isinstance(node, h5py.Group)
            else node[:]
        )

    with h5py.File(path) as file:
        found: dict[str, Any] = content(file)
        return found


def read_mat(path: str) -> dict[str, Any]:
    found: dict[str, Any] = scipy.io.loadmat(path, simplify_cells=True, mat_dtype=False)
    return found


READERS = {
    "h5": (".h5", Hdf5(), read_hdf5),
    "mat 5": (".mat", Matlab(), read_mat),
    "mat 7.3": (".mat", Matlab(), mat73.loadmat),
}  # fmt: skip


def same(found: Any, expected: Any) -> bool:
    """Compares bits and types. One number is read from MATLAB files without its type, and none as nothing."""
    one, other = (np.asarray(values).squeeze() for values in (found, expected))
    if not other.size:
        return one.size == 0
    if isinstance(found, int | float):
        one = one.astype(other.dtype)
    return one.dtype == other.dtype and reference.same_bits(one.reshape(other.shape), other)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", READERS)
def test_arrays(kind: str, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    suffix, file_format, read = READERS[kind]
    if kind == "mat 7.3":
        monkeypatch.setattr(matlab, "LIMIT", 0)
    Path("log.mtb").write_bytes(LOGS[name])
    Path("log.mtb.times").write_bytes(times_of(LOGS[name]))
    log = xbus.read_log("log.mtb")
    export(file_format, log, [log], f"whole{suffix}")
    assert run("decode", "log.mtb", "-o", f"parts{suffix}").exit_code == 0
    assert Path(f"parts{suffix}").read_bytes() == Path(f"whole{suffix}").read_bytes()
    found = read(f"parts{suffix}")
    samples = found["samples"]
    for item in ("time", "packet_counter", "bid", "host_time"):
        assert same(samples[item], getattr(log, item)), item
    if "utc" in samples:
        utc = (np.atleast_1d(samples["utc"]) * 1e3).round().astype("datetime64[ms]")
        assert np.array_equal(utc, log.utc.astype("datetime64[ms]"), equal_nan=True)
    for key in log:
        column = log[key]
        quantity = found[key if isinstance(key, str) else f"{key[0]}_{key[1].lower()}"]
        assert same(quantity["sample"], column.sample)
        assert same(quantity["time"], column.time)
        fields = column.scaled.dtype.names
        if fields:
            for name in fields:
                assert same(quantity["values"][name], column.scaled[name]), (key, name)
        else:
            assert same(quantity["values"], column.values), key
        if column.name == "gnss_sat_info":
            satellites = quantity["satellites"]
            assert same(satellites["cno"], column.satellites["cno"])
            assert same(satellites["sample"], np.repeat(column.sample, np.diff(column.offsets)))
        if kind != "h5" and fields:
            assert quantity.get("unit", {}) == {name: u for name, u in column.units.items() if u}


def test_what_describes_a_quantity(monkeypatch: pytest.MonkeyPatch) -> None:
    log = xbus.read_log(WALK)
    log.to_hdf5("walk.h5")
    with h5py.File("walk.h5") as file:
        assert dict(file["euler_angles"].attrs) == {
            "fields": "roll, pitch, yaw", "coordinates": "ENU", "precision": "Float32", "data_id": "0x2030",
        }  # fmt: skip
        assert file["euler_angles/values"].attrs["unit"] == "deg"
        assert file["gnss_pvt_data/values/lat"].attrs["unit"] == "deg"
    log.to_mat("walk.mat")
    monkeypatch.setattr(matlab, "LIMIT", 0)
    log.to_mat("large.mat")
    for found in (read_mat("walk.mat"), mat73.loadmat("large.mat")):
        angles = found["euler_angles"]
        assert [str(angles[name]) for name in ("fields", "coordinates", "unit")] == [
            "roll, pitch, yaw", "ENU", "deg",
        ]  # fmt: skip
        assert found["gnss_pvt_data"]["unit"]["lat"] == "deg"
    assert Path("walk.mat").read_bytes()[:19] == b"MATLAB 5.0 MAT-file"
    head = Path("large.mat").read_bytes()[:520]
    assert (head[:19], head[124:128]) == (b"MATLAB 7.3 MAT-file", b"\x00\x02IM")
    assert head[512:] == b"\x89HDF\r\n\x1a\n"


def test_names_are_those_of_matlab() -> None:
    for name, row in QUANTITIES.items():
        for text in (f"{name}_ned", *(field.name for field in row.fields)):
            assert re.fullmatch("[A-Za-z][A-Za-z0-9_]{0,62}", text)


# Excel


def rows_of(path: str) -> list[tuple[Any, ...]]:
    book = openpyxl.load_workbook(path, read_only=True)
    try:
        return list(book["samples"].iter_rows(values_only=True))
    finally:
        book.close()


def test_a_workbook_is_the_table_of_the_samples() -> None:
    Path("log.mtb").write_bytes(LOGS["with position"][:40_000])
    Path("log.mtb.times").write_bytes(times_of(LOGS["with position"][:40_000]))
    log = xbus.read_log("log.mtb")
    assert run("decode", "log.mtb", "-o", "log.xlsx").exit_code == 0
    log.to_excel("whole.xlsx")
    assert Path("log.xlsx").read_bytes() == Path("whole.xlsx").read_bytes()
    names, units, *rows = rows_of("log.xlsx")
    assert len(rows) == len(log)
    table = dict(zip(names, zip(*rows, strict=True), strict=True))
    unit = dict(zip(names, units, strict=True))
    for at, date in enumerate(table["utc"]):
        expected = log.utc[at].astype("datetime64[ms]").item()
        assert (date is None) == (expected is None)
        assert date is None or abs((date - expected).total_seconds()) < 0.001
    known = ~np.isnan(log.host_time)
    arrived = np.array(table["host_time"], "datetime64[ms]")
    assert np.array_equal(~np.isnat(arrived), known)
    assert np.abs(arrived[known].astype(float) / 1e3 - log.host_time[known]).max() < 0.001
    assert (unit["time"], unit["acceleration_x"], unit["utc"]) == ("s", "m/s2", "UTC")
    for key in ("acceleration", "quaternion"):
        column = log[key]
        for at, field in enumerate(column.fields):
            cells = np.array(table[f"{key}_{field}"], float)
            assert np.array_equal(cells[column.sample].astype("f4"), column.values[:, at])
            assert np.isnan(np.delete(cells, column.sample)).all()


def test_what_is_no_number_of_excel() -> None:
    values = [1.5, float("inf"), float("nan"), -float("inf"), None]
    samples = [
        mtdata2(counter(i), fine(i), *([] if value is None else [packet(0x0810, struct.pack(">f", value))]))
        for i, value in enumerate(values)
    ]  # fmt: skip
    xbus.read_log(b"".join(samples)).to_excel("log.xlsx")
    names, _, *rows = rows_of("log.xlsx")
    assert [row[names.index("temperature")] for row in rows] == [1.5, "inf", None, "-inf", None]


def test_more_rows_than_a_sheet_has(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Excel, "most_samples", 1039)
    text = "1,040 samples are more than the 1,039 that the format can hold; choose a part with --between"
    assert text in sentence(run("decode", WALK, "-o", "walk.xlsx"))
    with pytest.raises(
        ValueError, match=r"more than the 1,039 .*; choose a part with between=, or"
    ):
        xbus.read_log(WALK).to_excel("walk.xlsx")
    assert run("decode", WALK, "-o", "walk.xlsx", "--between", "0", "1").exit_code == 0
    assert excel.MOST_ROWS == 2**20


# Failures


class FullFile(io.BytesIO):
    """A file on a disk with room for some bytes only."""

    def write(self, data: Any) -> int:
        if self.tell() + len(data) > 20_000:
            raise OSError(28, "No space left on device")
        return super().write(data)


@pytest.mark.parametrize("for_matlab", [False, True])
def test_hdf5_survives_a_full_disk(for_matlab: bool) -> None:
    log = xbus.read_log(WALK)
    groups = columns.groups_of(log)
    blocks = columns.Blocks(groups)
    written = [*blocks.add(log), blocks.rest()] * 20

    def write() -> None:
        with Hdf5File(ForgivingFile(FullFile()), groups, for_matlab=for_matlab) as file:
            for block in written:
                file.append(block)

    with pytest.raises(OSError, match="No space left"):
        write()


@pytest.mark.parametrize(
    ("suffix", "module", "extra"),
    [
        (".mat", "scipy.io", "matlab"),
        (".mat", "h5py", "matlab"),
        (".h5", "h5py", "hdf5"),
        (".xlsx", "xlsxwriter", "excel"),
    ],
)
def test_a_missing_extra(
    suffix: str, module: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    shown = sentence(run("decode", WALK, "-o", f"walk{suffix}"))
    assert f'{module} is needed: pip install "xbus-mti[{extra}]"' in shown
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize("file_format", [Hdf5(), Matlab(), Excel()])
def test_devices_are_refused(file_format: Format) -> None:
    log = xbus.read_log(WALK)
    with pytest.raises(ValueError, match="/dev/null is no regular file"):
        export(file_format, log, [log], "/dev/null")
