"""``xbus decode``."""

from __future__ import annotations

import bz2
import gzip
import json
import lzma
import os
import struct
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.feather
import pyarrow.parquet
import pytest
import zstandard

import xbus
from conftest import counter, fine, shared
from streams import mtdata2, packet
from test_cli import FIELD, WALK, run, sentence, shell
from xbus import MessageId, encode_frame, encode_packet, encode_sample

SUFFIXES = [".parquet", ".csv", ".arrow", ".feather", ".npz"]
TABLES = SUFFIXES[:-1]
COMPRESSORS: dict[str, Callable[[bytes], bytes]] = {
    ".gz": gzip.compress,
    ".zst": zstandard.compress,
    ".xz": lzma.compress,
    ".bz2": bz2.compress,
}


@pytest.fixture(autouse=True)
def _empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def decoded(*args: str, stdin: bytes | None = None) -> str:
    """Returns the stderr of a decode that succeeds."""
    result = run("decode", *args, stdin=stdin)
    assert (result.exit_code, result.stdout) == (0, ""), result.stderr
    return result.stderr


def table(path: str, schema: pa.Schema) -> pa.Table:
    """Returns the table in a file; the schema gives the types of a CSV, which has none."""
    match Path(path).suffix.lower():
        case ".parquet":
            return pyarrow.parquet.read_table(path)
        case ".csv":
            options = pyarrow.csv.ConvertOptions(column_types=schema)
            return pyarrow.csv.read_csv(path, convert_options=options).cast(schema)
        case _:
            return pyarrow.feather.read_table(path)


def same(one: pa.Table, other: pa.Table) -> bool:
    """Returns whether two tables are equal, with NaN equal to NaN."""
    with np.errstate(invalid="ignore"):
        return one.schema.equals(other.schema) and all(
            a.null_count == b.null_count and str(a.to_pylist()) == str(b.to_pylist())
            for a, b in zip(one.columns, other.columns, strict=True)
        )


def files() -> list[str]:
    """Returns the names of all files in the folder, including hidden ones."""
    return sorted(path.name for path in Path().iterdir())


# Round trips


@pytest.mark.parametrize("log", [WALK, FIELD], ids=["walk", "field"])
@pytest.mark.parametrize("suffix", TABLES)
def test_table(log: str, suffix: str) -> None:
    expected = xbus.read_log(log).to_arrow()
    decoded(log, "-o", f"out{suffix}")
    assert files() == [f"out{suffix}"]
    found = table(f"out{suffix}", expected.schema)
    assert same(found, expected)
    if suffix != ".csv":
        assert found.schema.field("acceleration_x").metadata[b"unit"] == b"m/s2"


def test_numbers_equal_the_columns() -> None:
    """The expected numbers come from the columns, not from another table."""
    log = xbus.read_log(FIELD)
    decoded(FIELD, "-o", "out.parquet")
    found = pyarrow.parquet.read_table("out.parquet")
    column = log["acceleration"]
    for at, name in enumerate(column.fields):
        values = found[f"acceleration_{name}"].combine_chunks()
        present = values.is_valid().to_numpy(zero_copy_only=False)
        assert np.array_equal(np.flatnonzero(present), column.sample)
        assert np.array_equal(values.drop_null().to_numpy(), column.values[:, at])
    assert np.array_equal(found["time"].to_numpy(), log.time)


def test_npz() -> None:
    log = xbus.read_log(FIELD)
    decoded(FIELD, "-o", "out.npz")
    log.to_npz("expected.npz")
    with np.load("out.npz") as found, np.load("expected.npz") as expected:
        assert found.files == expected.files
        assert all(found[file].tobytes() == expected[file].tobytes() for file in found.files)
        assert np.array_equal(found["acceleration"], log["acceleration"].values)
        assert np.array_equal(found["acceleration.sample"], log["acceleration"].sample)


@pytest.mark.parametrize("name", ["OUT.CSV", "a.b.Parquet", "folder.txt/out.arrow"])
def test_names_of_outputs(name: str) -> None:
    Path("folder.txt").mkdir()
    decoded(WALK, "-o", name)
    assert Path(name).stat().st_size > 1000


# One quantity


@pytest.mark.parametrize("suffix", TABLES)
@pytest.mark.parametrize("name", ["baro_pressure", "gnss_pvt_data", "quaternion", "utc_time"])
def test_quantity(name: str, suffix: str) -> None:
    expected = xbus.read_log(FIELD).to_arrow(name)
    output = decoded(FIELD, "--quantity", name, "-o", f"out{suffix}")
    found = table(f"out{suffix}", expected.schema)
    assert same(found, expected)
    nulls = {field: found[field].null_count for field in found.column_names}
    # The accuracy of the heading is not provided.
    expected_nulls = {"gnss_pvt_data_headAcc": 38} if name == "gnss_pvt_data" else {}
    assert {field: count for field, count in nulls.items() if count} == expected_nulls
    assert output.startswith(
        f"out{suffix}: {len(expected):,} rows, {len(expected.schema)} columns; "
    )


@pytest.mark.parametrize("options", [[], ["--raw"]])
def test_structs_in_npz(options: list[str]) -> None:
    """They have the numbers of tables; only raw ones are integers."""
    log = xbus.read_log(FIELD)
    decoded(FIELD, "-o", "out.npz", *options)
    with np.load("out.npz") as found:
        values = found["gnss_pvt_data"]
        expected = log.to_arrow("gnss_pvt_data", raw=bool(options))
        for name in values.dtype.names:
            column = expected[f"gnss_pvt_data_{name}"].to_numpy()
            assert np.array_equal(values[name], column, equal_nan=name == "headAcc"), name
        assert np.array_equal(found["utc"], log.utc)
        if options:
            assert np.array_equal(found["utc_time"], log["utc_time"].values)
        else:
            assert np.array_equal(found["utc_time"], log["utc_time"].datetime)
            assert float(values["lat"][0]) == pytest.approx(52.22, abs=0.1)


def test_npz_of_a_bus() -> None:
    """UTC that the device does not mark as valid is unknown, and each sample has its BID."""
    row = struct.pack(">IHBBBBBB", 0, 2020, 1, 1, 0, 0, 0, 0)
    frames = [mtdata2(packet(0x1010, row), bid=bid) for bid in (1, 2)]
    Path("bus.mtb").write_bytes(b"".join(frames))
    decoded("bus.mtb", "-o", "out.npz")
    with np.load("out.npz") as found:
        assert np.isnat(found["utc_time"]).all()
        assert found["bid"].tolist() == [1, 2]


def test_quantity_in_npz() -> None:
    decoded(FIELD, "--quantity", "baro_pressure", "-o", "out.npz")
    with np.load("out.npz") as found:
        quantities = {file.partition(".")[0] for file in found.files}
        assert quantities == {"time", "packet_counter", "baro_pressure"}
        assert np.array_equal(found["baro_pressure"], xbus.read_log(FIELD)["baro_pressure"].values)
        assert np.array_equal(found["time"], xbus.read_log(FIELD).time)


def mixed() -> None:
    """Writes mixed.mtb: quaternions in two coordinate systems."""
    packets = [
        counter(at) + encode_packet(("quaternion", system), [at, 0, 0, 0])
        for at, system in enumerate(("ENU", "NED", "NED"))
    ]
    data = b"".join(encode_frame(MessageId.MTData2, packet) for packet in packets)
    Path("mixed.mtb").write_bytes(data)


def test_quantity_in_several_coordinates() -> None:
    mixed()
    output = decoded("mixed.mtb", "--quantity", "quaternion:ned", "-o", "out.parquet")
    assert output.startswith("out.parquet: 2 rows, ")
    assert pyarrow.parquet.read_table("out.parquet")["sample"].to_pylist() == [1, 2]
    assert sentence(run("decode", "mixed.mtb", "--quantity", "quaternion", "-o", "no.csv")) == (
        "mixed.mtb has quaternion in several coordinates; "
        "choose --quantity quaternion:ENU or quaternion:NED"
    )
    decoded("mixed.mtb", "--quantity", "quaternion:NED", "-o", "out.npz")
    with np.load("out.npz") as found:
        assert found["quaternion"][:, 0].tolist() == [1, 2]
    assert files() == ["mixed.mtb", "out.npz", "out.parquet"]


@pytest.mark.parametrize("name", ["delta_q", "quaternion:NED"])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_quantity_that_the_log_lacks_is_an_error(name: str, suffix: str) -> None:
    output = sentence(run("decode", WALK, "--quantity", name, "-o", f"out{suffix}"))
    assert output == f"no {name} in {WALK}; xbus info lists the content"
    assert files() == []


def test_satellites_have_a_separate_table() -> None:
    path = str(shared("captures/mtig710-5/raw.bin"))
    column = xbus.read_log(path)["gnss_sat_info"]
    output = decoded(path, "--quantity", "gnss_sat_info", "-o", "out.parquet")
    found = pyarrow.parquet.read_table("out.parquet")
    assert len(found) == len(column.satellites) > len(column)
    assert output.startswith(f"out.parquet: {len(found)} rows, ")


def test_several_quantities() -> None:
    log = xbus.read_log(FIELD)
    options = ["--quantity", "rate_of_turn", "--quantity", "acceleration"]
    decoded(FIELD, *options, "-o", "out.parquet")
    found = pyarrow.parquet.read_table("out.parquet")
    axes = ["_x", "_y", "_z"]
    names = [name + axis for name in ("rate_of_turn", "acceleration") for axis in axes]
    assert sorted(found.column_names) == sorted(["sample", "time", *names])
    assert found["acceleration_z"].drop_null().to_pylist() == log["acceleration"]["z"].tolist()
    decoded(FIELD, *options, *options, "-o", "out.npz")
    with np.load("out.npz") as arrays:
        assert {"acceleration", "rate_of_turn"} < set(arrays.files)
    result = run("decode", FIELD, *options, "--quantity", "gnss_sat_info", "-o", "x.csv")
    assert (result.exit_code, "is a table by itself" in result.stderr) == (2, True)


# Several files


@pytest.mark.parametrize("cuts", [(1,), (5000, 5001), (60_000, 60_000, 100_003)])
def test_a_split_recording_decodes_as_the_whole(cuts: tuple[int, ...]) -> None:
    """A frame that is cut between two files is decoded."""
    data = Path(WALK).read_bytes()
    bounds = [0, *cuts, len(data)]
    names = []
    for at, (start, end) in enumerate(pairwise(bounds)):
        names.append(f"part{at}.mtb")
        Path(names[-1]).write_bytes(data[start:end])
    output = decoded(*names, "-o", "joined.parquet")
    assert "1,040 rows, 66 columns; 9.99 s, no samples lost, no damage\n" in output
    decoded(WALK, "-o", "whole.parquet")
    assert Path("joined.parquet").read_bytes() == Path("whole.parquet").read_bytes()


def rotated(folder: Path = Path()) -> list[str]:
    """Records 10 s into four files and returns their names as the shell sorts them."""
    result = run(
        "record", "sim:MTi-630", "-o", str(folder / "night.mtb"), "--duration", "10", "--rotate", "3s",
        "--output", "acceleration=100", "--output", "packet_counter", "--output", "sample_time_fine",
    )  # fmt: skip
    assert result.exit_code == 0
    names = sorted(str(path) for path in folder.glob("night*.mtb"))
    assert names[0].endswith("night-0001.mtb")
    return names


def test_rotated_recording() -> None:
    names = rotated()
    output = decoded(*names, "-o", "night.parquet")
    found = pyarrow.parquet.read_table("night.parquet")
    time = found["time"].to_numpy()
    assert (np.diff(time) > 0).all()
    assert len(found) == 1000
    assert ", no samples lost, no damage" in output
    (summary,) = json.loads(run("info", "--json", *names).stdout)
    assert (summary["samples"], summary["file"]) == (1000, "night.mtb")
    assert summary["files"] == ["night.mtb", *names[:-1]]
    assert run("info", *names).stdout.startswith("night.mtb to night-0003.mtb\n")


def test_a_missing_piece_is_reported() -> None:
    names = rotated()
    Path("night-0001.mtb").unlink()
    output = decoded(*names[1:], "-o", "night.parquet")
    assert output.startswith("xbus: night-0001.mtb is missing\nnight.parquet: ")
    lost = 1000 - len(pyarrow.parquet.read_table("night.parquet"))
    assert f"{lost} samples lost in 1 gap" in output
    assert lost > 290


def different(*args: str) -> str:
    """Returns the reason why inputs are not one recording."""
    result = run("decode", *args, "-o", "never.csv")
    assert (result.exit_code, files().count("never.csv")) == (2, 0)
    output = " ".join(result.stderr.split())
    assert "these are different recordings: " in output
    assert output.endswith("add --out-dir DIR") or "add --out-dir DIR, or --allow-restart" in output
    return output.partition("these are different recordings: ")[2].partition(";")[0]


def test_different_recordings_are_not_joined() -> None:
    for name, product in (("a.mtb", "MTi-630"), ("b.mtb", "MTi-680G"), ("c.mtb", "MTi-630")):
        run("record", f"sim:{product}", "-o", name, "--duration", "2")
    assert "b.mtb does not continue a.mtb, because it is from device " in different(
        "a.mtb", "b.mtb"
    )
    assert "the clock goes back from 2." in different("a.mtb", "c.mtb")
    different("*.mtb")
    different(".")
    mixed()
    assert "mixed.mtb does not continue " in different(WALK, "mixed.mtb")


def test_allow_restart() -> None:
    for name in ("a.mtb", "b.mtb"):
        run("record", "sim:MTi-630", "-o", name, "--duration", "2")
    rows = len(xbus.read_log("a.mtb")) + len(xbus.read_log("b.mtb"))
    output = decoded("a.mtb", "b.mtb", "--allow-restart", "-o", "out.csv")
    assert output.startswith(f"xbus: the device restarted before b.mtb\nout.csv: {rows:,} rows")


def test_standard_input_is_a_whole_recording() -> None:
    result = run("decode", "-", WALK, "-o", "out.csv", stdin=b"")
    assert result.exit_code == 2
    assert "cannot be joined with other inputs" in result.stderr


def test_a_wrong_name_is_reported_before_reading() -> None:
    output = sentence(run("decode", WALK, "nowhere.mtb", "-o", "out.csv"))
    assert output.startswith("cannot read nowhere.mtb: ")


# Kinds of inputs


@pytest.mark.parametrize("suffix", [".gz", ".zst", ".xz", ".bz2"])
def test_compressed_input(suffix: str) -> None:
    data = Path(WALK).read_bytes()
    packed = COMPRESSORS[suffix](data)
    Path("walk.mtb" + suffix).write_bytes(packed)
    decoded("walk.mtb" + suffix, "-o", "out.parquet")
    decoded(WALK, "-o", "whole.parquet")
    assert Path("out.parquet").read_bytes() == Path("whole.parquet").read_bytes()
    assert xbus.read_log("walk.mtb" + suffix) == xbus.read_log(WALK)
    # The first half is no log without a message.
    Path("half.mtb" + suffix).write_bytes(packed[: len(packed) // 2])
    for damaged in (packed[: len(packed) // 2], b"no compressed data" * 9):
        Path("bad.mtb" + suffix).write_bytes(damaged)
        output = sentence(run("decode", "bad.mtb" + suffix, "-o", "never.csv"))
        assert output.startswith(f"cannot read bad.mtb{suffix}: the compressed data is damaged (")
        with pytest.raises(OSError, match="compressed data is damaged"):
            xbus.read_log("bad.mtb" + suffix)


def test_compressed_pieces() -> None:
    data = Path(WALK).read_bytes()
    Path("walk.mtb.gz").write_bytes(gzip.compress(data[:50_000]))
    Path("walk-0001.mtb").write_bytes(data[50_000:90_000])
    Path("walk-0002.mtb.xz").write_bytes(lzma.compress(data[90_000:]))
    decoded(".", "-o", "out.parquet")
    decoded(WALK, "-o", "whole.parquet")
    assert Path("out.parquet").read_bytes() == Path("whole.parquet").read_bytes()


def test_urls() -> None:
    Path("with space.mtb").write_bytes(Path(WALK).read_bytes())
    url = Path("with space.mtb").resolve().as_uri()
    assert "1,040 rows" in decoded(url, "-o", "out.csv")
    assert len(xbus.read_log(url)) == 1040
    fsspec.filesystem("memory").pipe("/log.mtb.gz", gzip.compress(Path(WALK).read_bytes()))
    assert "1,040 rows" in decoded("memory://log.mtb.gz", "-o", "out.csv")
    output = sentence(run("decode", "memory://nowhere.mtb", "-o", "out.csv"))
    assert output.startswith("cannot read memory://nowhere.mtb: ")
    assert "1,040 rows" in decoded("memory://*.mtb.gz", "-o", "out.csv")
    output = sentence(run("decode", "memory://*.log", "-o", "out.csv"))
    assert output == "no file matches memory://*.log; check the pattern"


def test_folders_and_patterns() -> None:
    Path("logs").mkdir()
    Path("logs/walk.MTB").write_bytes(Path(WALK).read_bytes())
    Path("logs/walk.MTB.times").write_bytes(b"")
    Path("logs/notes.txt").write_text("nothing")
    for name in ("logs", "logs/*.MTB", "log?/*.MTB*", "**/*.MTB"):
        assert "1,040 rows" in decoded(name, "-o", "out.csv")
    assert sentence(run("decode", "*.bin", "-o", "x.csv")) == (
        "no file matches *.bin; check the pattern"
    )
    Path("empty").mkdir()
    assert sentence(run("decode", "empty", "-o", "x.csv")).startswith(
        "no .mtb file in the folder empty; name the files, such as empty/*.bin"
    )
    Path("empty/night").mkdir()
    Path("empty/night/walk.mtb").touch()
    assert sentence(run("decode", "empty", "-o", "x.csv")).endswith("such as empty/**/*.mtb")
    Path("log[1].mtb").write_bytes(Path(WALK).read_bytes())
    assert "1,040 rows" in decoded("log[1].mtb", "-o", "out.csv")


# Strict


def test_strict() -> None:
    decoded(WALK, "--strict", "-o", "out.csv")
    output = sentence(run("decode", FIELD, "--strict", "-o", "never.csv"))
    assert (
        output == f"{FIELD}: no frame at byte 0 (no preamble); without --strict, damage is skipped"
    )
    data = Path(WALK).read_bytes()
    Path("walk.mtb").write_bytes(data[:60_000])
    Path("walk-0001.mtb").write_bytes(data[60_000:] + b"!")
    output = sentence(run("decode", "walk-0001.mtb", "walk.mtb", "--strict", "-o", "never.csv"))
    assert output == (
        "walk.mtb, walk-0001.mtb: no frame at byte 169069 (no preamble), which is byte 109069 of "
        "walk-0001.mtb; without --strict, damage is skipped"
    )
    assert files() == ["out.csv", "walk-0001.mtb", "walk.mtb"]


# The summary


def test_summary() -> None:
    assert decoded(WALK, "-o", "out.csv") == (
        "out.csv: 1,040 rows, 66 columns; 9.99 s, no samples lost, no damage\n"
    )
    assert decoded(FIELD, "-o", "out.npz") == (
        "out.npz: 1,016 rows, 15 columns; 9.99 s, 23 samples lost in 12 gaps, "
        "1,816 bytes of damage in 12 places\n"
    )
    data = b"".join(encode_frame(MessageId.MTData2, counter(value)) for value in (1, 3))
    Path("one.mtb").write_bytes(b"!" + data)
    assert decoded("one.mtb", "-o", "out.csv") == (
        "out.csv: 2 rows, 3 columns; no time stamps (--rate HZ derives them from the packet counter), "
        "1 sample lost in 1 gap, 1 byte of damage in 1 place\n"
    )
    assert decoded(WALK, "-q", "-o", "out.csv") == ""


def test_summary_as_json() -> None:
    result = run("decode", FIELD, "--json", "--quiet", "--quantity", "temperature", "-o", "out.csv")
    assert (result.exit_code, result.stderr) == (0, "")
    assert json.loads(result.stdout) == {
        "files": [FIELD],
        "out": "out.csv",
        "quantities": ["temperature"],
        "rows": 10,
        "columns": 3,
        "duration_s": 9.99,
        "restarts": 0,
        "bytes": 166910,
        "frames": 1018,
        "strings": 0,
        "samples": 1016,
        "lost_samples": 23,
        "gaps": 12,
        "skipped_bytes": 1816,
        "damage": 12,
        "malformed": 0,
        "unfit": 0,
        "undecoded": [],
    }
    Path("still.mtb").write_bytes(encode_sample({"temperature": 20.0}))
    result = run("decode", "still.mtb", "--json", "-o", "out.csv")
    assert json.loads(result.stdout)["duration_s"] is None


# Outputs that cannot be written


@pytest.mark.parametrize("kind", ["same", "other spelling", "symbolic link", "hard link", "second"])
def test_the_input_is_not_overwritten(kind: str) -> None:
    data = Path(WALK).read_bytes()
    Path("log.csv").write_bytes(data)
    Path("folder").mkdir()
    Path("soft.csv").symlink_to("log.csv")
    os.link("log.csv", "hard.csv")
    Path("walk.csv").write_bytes(data[:60_000])
    Path("walk-0001.csv").write_bytes(data[60_000:])
    inputs, out = {
        "same": (["log.csv"], "log.csv"),
        "other spelling": (["log.csv"], "folder/../log.csv"),
        "symbolic link": (["log.csv"], "soft.csv"),
        "hard link": (["hard.csv"], "log.csv"),
        "second": (["walk.csv", "walk-0001.csv"], "walk-0001.csv"),
    }[kind]
    result = run("decode", *inputs, "-o", out)
    assert result.exit_code == 2
    assert "OUT is the input" in result.stderr
    assert Path("log.csv").read_bytes() == data


def test_an_existing_file_is_replaced_and_keeps_its_mode() -> None:
    Path("out.csv").write_text("old")
    Path("out.csv").chmod(0o640)
    decoded(WALK, "-o", "out.csv")
    assert Path("out.csv").read_text().startswith('"sample","time"')
    assert Path("out.csv").stat().st_mode & 0o777 == 0o640
    assert files() == ["out.csv"]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_failed_write_keeps_the_existing_file(suffix: str) -> None:
    out = Path(f"out{suffix}")
    out.write_text("what was there")
    code, output = shell('ulimit -f 8; exec "$@"', "decode", WALK, "-o", str(out))
    assert code == 1
    assert output == (
        f"xbus: cannot write {out}: File too large; "
        "raise the limit (ulimit -f), or write fewer quantities\n"
    )
    assert files() == [out.name]
    assert out.read_text() == "what was there"


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_full_device_is_reported(suffix: str) -> None:
    """A device is written directly, without a temporary file."""
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full")
    Path(f"full{suffix}").symlink_to("/dev/full")
    output = sentence(run("decode", WALK, "-o", f"full{suffix}"))
    assert output.startswith(f"cannot write full{suffix}: No space left on device; free some space")
    assert files() == [f"full{suffix}"]


def test_no_such_folder() -> None:
    """The error comes before anything is read."""
    output = sentence(run("decode", "-", "-o", "nowhere/out.csv", stdin=b"no frame"))
    assert output == "cannot write nowhere/out.csv: No such file or directory; check the path"


def test_out_is_a_folder() -> None:
    Path("out.csv").mkdir()
    output = sentence(run("decode", "-", "-o", "out.csv", stdin=b"no frame"))
    assert output.startswith("cannot write out.csv: Is a directory; ")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_no_permission() -> None:
    Path("locked").mkdir(0o500)
    output = sentence(run("decode", "-", "-o", "locked/out.csv", stdin=b"no frame"))
    assert output.startswith("cannot write locked/out.csv: Permission denied; ")


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("options", [[], ["--quantity", "acceleration"], ["--rate-out", "10"]])
def test_no_extra_is_needed(
    suffix: str, options: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    decoded(WALK, "-o", f"out{suffix}", *options)
    assert Path(f"out{suffix}").stat().st_size > 1000


def test_not_enough_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    def out_of_memory(*_: Any, **__: Any) -> None:
        raise MemoryError

    monkeypatch.setattr("xbus.log.part_file.write_parts", out_of_memory)
    shown = sentence(run("decode", WALK, "-o", "out.csv"))
    assert shown == "not enough memory; close other programs, or raise the limit (ulimit -v)"


@pytest.mark.parametrize("out", ["out.csv", "out.npz"])
def test_a_log_without_samples_is_not_decoded(out: str) -> None:
    Path("still.mtb").write_bytes(encode_frame(MessageId.GoToConfigAck))
    shown = sentence(run("decode", "still.mtb", "-o", out))
    assert shown == "still.mtb has no samples; xbus info lists the content"
    assert not Path(out).exists()


def test_the_summary_counts_restarts() -> None:
    run_ = b"".join(
        encode_frame(MessageId.MTData2, fine(100 * at)) for at in range(100, 0, -1)[::-1]
    )
    wake_up = encode_frame(MessageId.WakeUp)
    Path("a.mtb").write_bytes(run_ + wake_up + run_)
    assert "1.98 s, restarted once, " in decoded("a.mtb", "-o", "a.csv")
    Path("b.mtb").write_bytes((run_ + wake_up) * 3)
    result = run("decode", "b.mtb", "-o", "b.csv", "--json")
    assert "restarted 2 times" in result.stderr
    assert json.loads(result.stdout)["restarts"] == 2


def test_one_sample_has_a_time() -> None:
    """Only the duration is not known."""
    Path("a.mtb").write_bytes(encode_frame(MessageId.MTData2, fine(100)))
    assert "no time stamps" not in decoded("a.mtb", "-o", "a.csv")


def test_an_unknown_protocol() -> None:
    pytest.importorskip("fsspec")
    shown = sentence(run("decode", "foo://x.mtb", "-o", "a.csv"))
    assert shown == "cannot read foo://x.mtb: Protocol not known: foo; check the URL"


@pytest.mark.parametrize("option", ["--rate", "--rate-out", "--max-gap"])
@pytest.mark.parametrize("number", ["nan", "inf"])
def test_numbers_are_finite(option: str, number: str) -> None:
    result = run("decode", WALK, "-o", "a.csv", option, number)
    assert result.exit_code == 2
    assert f"{number} is not a finite number" in result.stderr


def test_time_is_unwrapped() -> None:
    data = b"".join(
        encode_frame(MessageId.MTData2, fine(item)) for item in (2**32 - 10_000, 2**32 - 1, 9_999)
    )
    Path("wrap.mtb").write_bytes(data)
    decoded("wrap.mtb", "-o", "out.parquet")
    times = pyarrow.parquet.read_table("out.parquet")["time"].to_pylist()
    assert times == [429495.7296, 429496.7295, 429497.7295]


def test_without_a_counter_losses_are_unknown(tmp_path: Path) -> None:
    Path("a.mtb").write_bytes(xbus.encode_sample({"temperature": 20.0}) * 3)
    assert "no packet counter to detect losses" in decoded("a.mtb", "-o", "a.csv")
