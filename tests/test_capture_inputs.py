"""CAN captures that are given to readers of logs, and logs that are given to readers of captures."""

from __future__ import annotations

import contextlib
import gzip
import io
import os
import pickle
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xbus
import xbus.dask
from test_can import SUFFIXES, TWO, write
from test_cli import WALK, run, sentence
from xbus.can.captures import READERS
from xbus.captures import CAPTURE_SUFFIXES, CaptureError, is_capture

DATA = Path(WALK).read_bytes()
NAMES = [f"drive.{suffix}" for suffix in SUFFIXES]
LOG_READERS: dict[str, Callable[[Any], Any]] = {
    "read_log": xbus.read_log,
    "read_log with between": lambda source: xbus.read_log(source, between=(1, 2)),
    "read_log with several threads": lambda source: xbus.read_log(source, threads=3),
    "iter_log": lambda source: next(xbus.iter_log(source)),
    "split_log": xbus.split_log,
    "scan_log": xbus.scan_log,
    "log_batches": xbus.log_batches,
    "dask": xbus.dask.read_logs,
    "report": lambda source: xbus.report.write_report(source, "drive.html"),
    "replay": xbus.sim.Replay,
}


class Unseekable:
    """A file object that can only be read, in small pieces."""

    def __init__(self, data: bytes) -> None:
        self._file = io.BytesIO(data)

    def read(self, size: int = -1) -> bytes:
        return self._file.read(min(size, 200))


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captures")
    for name in NAMES:
        if name.endswith("mf4"):
            pytest.importorskip("asammdf")
        write(folder / name, TWO)
    return folder


@pytest.fixture(autouse=True)
def _in_the_folder(captures: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(captures)


@contextlib.contextmanager
def refused(name: str) -> Any:
    with pytest.raises(CaptureError) as caught:
        yield
    assert str(caught.value) == (
        f"{name} is a CAN capture and no Xbus log; read it with xbus.read_can"
    )
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)  # noqa: S301


def test_the_formats_are_those_that_are_read() -> None:
    assert set(READERS) == set(CAPTURE_SUFFIXES) == {f".{suffix}" for suffix in SUFFIXES}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("reader", LOG_READERS)
def test_readers_of_logs_refuse_captures(reader: str, name: str) -> None:
    with refused(name):
        LOG_READERS[reader](name)


@pytest.mark.parametrize("name", NAMES)
def test_every_source_is_refused(name: str) -> None:
    data = Path(name).read_bytes()
    for source in (data, bytearray(data), np.frombuffer(data, np.uint8), io.BytesIO(data)):
        with refused("the input"):
            xbus.read_log(source)
        with refused("the input"):
            next(xbus.iter_log(source))
    with refused("the input"):
        xbus.read_log(Unseekable(data))
    with Path(name).open("rb") as file, refused(name):
        xbus.read_log(file)
    Path("odd.gz").write_bytes(gzip.compress(data))
    Path("odd.mtb").write_bytes(data)
    for odd in ("odd.gz", "odd.mtb", Path("odd.mtb")):
        for read in (xbus.read_log, xbus.split_log):
            with refused(str(odd)):
                read(odd)
        with refused(str(odd)):
            xbus.read_log([WALK, odd])


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes")
def test_a_pipe_is_refused() -> None:
    os.mkfifo("pipe")
    writer = threading.Thread(
        target=lambda: Path("pipe").write_bytes(Path("drive.blf").read_bytes())
    )
    writer.start()
    with refused("pipe"):
        xbus.read_log("pipe")
    writer.join()


@pytest.mark.parametrize("name", ["walk.asc", "walk.blf", "walk.log", "walk.trc", "walk.csv"])
@pytest.mark.parametrize(
    "start",
    [b"", b"(1.0) ", b"; date ", b"LOGGING\r\n", b"date Mon Nov 30\n", b"(1.0) can0 005#00\n"],
)
def test_a_log_with_an_odd_name_is_read(name: str, start: bytes) -> None:
    """Damage at its start makes it no capture."""
    Path(name).write_bytes(start + DATA)
    log = xbus.read_log(name)
    assert (len(log), log.stats.skipped_bytes) == (1040, len(start))
    assert sum(part.samples for part in xbus.split_log(name)) == 1040
    assert not is_capture(name)
    assert "1,040" in run("info", name).stdout
    with pytest.raises(
        ValueError, match=rf"^{name} is an Xbus log and no CAN capture; read it with xbus.read_log"
    ):
        xbus.read_can(name)


def test_read_can_refuses_logs() -> None:
    Path("walk.mtb.gz").write_bytes(gzip.compress(DATA))
    for name in (WALK, "walk.mtb.gz"):
        with pytest.raises(ValueError, match="is an Xbus log and no CAN capture"):
            xbus.read_can(name)


@pytest.mark.parametrize("name", NAMES)
def test_a_capture_with_another_name_is_read(name: str) -> None:
    Path("drive.bin").write_bytes(Path(name).read_bytes())
    assert len(xbus.read_can("drive.bin", [0, 0x1000])) == 60
    assert run("info", "drive.bin").stdout == run("info", name).stdout.replace(name, "drive.bin")


def test_compressed_captures() -> None:
    Path("drive.log.gz").write_bytes(gzip.compress(Path("drive.log").read_bytes()))
    assert len(xbus.read_can("drive.log.gz", [0, 0x1000])) == 60
    Path("drive.blf.gz").write_bytes(gzip.compress(Path("drive.blf").read_bytes()))
    with pytest.raises(
        ValueError, match=r"blf.gz: a .blf capture is not read from a compressed file; decompress"
    ):
        xbus.read_can("drive.blf.gz")
    Path("drive.log.xz").touch()
    with pytest.raises(
        ValueError, match=r"drive.log.xz: a CAN capture is not read from .xz; decompress it"
    ):
        xbus.read_can("drive.log.xz")


@pytest.mark.parametrize("command", ["info", "dump", "decode", "cut"])
def test_commands_refuse_captures_that_are_no_files(command: str) -> None:
    options = {"decode": ["-o", "out.csv"], "cut": ["--from", "1", "-o", "out.mtb"]}.get(
        command, []
    )
    result = run(command, "-", *options, stdin=Path("drive.blf").read_bytes())
    assert sentence(result) == (
        "standard input is a CAN capture; xbus info, decode and report read files of those"
    )


@pytest.mark.parametrize(
    "args",
    [
        ["dump", "drive.log"],
        ["cut", "drive.log", "--from", "1", "-o", "out.mtb"],
        ["monitor", "drive.log", "--once", "1"],
        ["sim", "--replay", "drive.log"],
    ],
)
def test_commands_for_logs_refuse_captures(args: list[str]) -> None:
    assert sentence(run(*args)) == (
        "drive.log is a CAN capture; xbus info, decode and report read files of those"
    )
