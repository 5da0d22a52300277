"""Formats of other software: what all of them have in common.

A new format in `EXPORTS` is tested here without a change.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import xbus
from test_cli import WALK, run
from test_decode_parts import LOGS, PART
from test_rerun import rrd_rows
from xbus.cli import decoding
from xbus.cli.argument_options import with_argument_options
from xbus.cli.export_formats import EXPORTS, FormatOptions
from xbus.export.format import ExportError, Format, export


@pytest.fixture(autouse=True)
def _small_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(decoding, "PART", PART)


#: How to read the files whose bytes differ although their content does not: those of rerun have random
#: identifiers, and a chunk for each part. The order of entities has no meaning, nor has that of rows with the
#: same time.
READERS: dict[str, Callable[[Path], Any]] = {
    ".rrd": lambda path: {name: sorted(map(repr, rows)) for name, rows in rrd_rows(path).items()}
}
#: A file is in the files of a folder, or one.
Content = dict[str, Any]


def content(folder: Path) -> Content:
    """The files in a folder, with their content."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    read = {path: READERS.get(path.suffix, Path.read_bytes) for path in files}
    return {str(path.relative_to(folder)): read[path](path) for path in files}


def format_of(suffix: str) -> Format:
    found = FormatOptions().format_of(suffix)
    assert found is not None
    return found


@pytest.mark.parametrize("name", LOGS)
@pytest.mark.parametrize("suffix", EXPORTS)
def test_the_parts_of_a_log_give_the_file_of_the_whole_log(suffix: str, name: str) -> None:
    log = xbus.read_log(LOGS[name])
    Path("log.mtb").write_bytes(LOGS[name])
    for folder in ("whole", "parts"):
        Path(folder).mkdir()
    result = run("decode", "log.mtb", "-o", f"parts/out{suffix}")
    if result.exit_code == 1:
        with pytest.raises(ExportError) as refused:
            export(format_of(suffix), log, [log], f"whole/out{suffix}")
        assert result.stderr == f"xbus: log.mtb: {with_argument_options(str(refused.value))}\n"
        assert content(Path("whole")) == content(Path("parts")) == {}
        return
    assert result.exit_code == 0, result.stderr
    counts = export(format_of(suffix), log, [log], f"whole/out{suffix}")
    assert content(Path("parts")) == content(Path("whole")) != {}
    assert all(f"{count:,} {noun}" in result.stderr for noun, count in counts.items())


@pytest.mark.parametrize("suffix", EXPORTS)
def test_quantities_of_one_coordinate_system(suffix: str) -> None:
    """Those of the other one are not in the file."""
    stamps = [{"packet_counter": at, "sample_time_fine": 100 * at} for at in range(100)]
    data = b"".join(
        xbus.encode_sample(stamp | {("quaternion", system): (1.0, 0.0, 0.0, 0.0)})
        for stamp, system in zip(stamps, ["NED", "ENU"] * 50, strict=True)
    )
    Path("log.mtb").write_bytes(data)
    for folder in ("whole", "parts"):
        Path(folder).mkdir()
    result = run("decode", "log.mtb", "--quantity", "quaternion:NED", "-o", f"parts/out{suffix}")
    log = xbus.read_log(data, quantities=[("quaternion", "NED")])
    assert len(log["quaternion"]) == 50
    with contextlib.suppress(ExportError):
        export(format_of(suffix), log, [log], f"whole/out{suffix}")
    assert (result.exit_code == 0) == bool(content(Path("whole")))
    assert content(Path("parts")) == content(Path("whole"))


@pytest.mark.parametrize("name", LOGS)
def test_the_shape_of_a_log_has_its_devices(name: str) -> None:
    parts = xbus.split_log(LOGS[name], block_bytes=PART)
    devices = xbus.read_log(LOGS[name]).devices
    assert parts[0].empty().devices == devices
    for device in devices:
        parts = xbus.split_log(LOGS[name], block_bytes=PART, bid=device.bid)
        assert parts[-1].empty().devices == xbus.read_log(LOGS[name], bid=device.bid).devices


@pytest.mark.parametrize("suffix", EXPORTS)
def test_a_failure_leaves_the_file_of_before(suffix: str) -> None:
    log = xbus.read_log(LOGS["walk"])
    export(format_of(suffix), log, [log], f"out{suffix}")
    before = content(Path())

    def broken() -> xbus.Log:
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space"):
        export(format_of(suffix), log, (broken() for _ in range(1)), f"out{suffix}")
    assert content(Path()) == before


@pytest.mark.parametrize(
    "arguments",
    [["--raw"], ["--rate-out", "10"], ["--tracker", "1"]],
    ids=lambda arguments: arguments[0],
)
def test_options_of_tables_are_refused(arguments: list[str]) -> None:
    result = run("decode", WALK, "-o", "out.gpx", *arguments)
    assert result.exit_code == 2
    assert f"{arguments[0]} applies to tables and .npz, not to .gpx" in result.stderr
    assert content(Path()) == {}
