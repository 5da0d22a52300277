"""Inputs that are not what their names say: hex text without --hex, and compressed data."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import xbus
from test_cli import WALK, run, sentence

DATA = Path(WALK).read_bytes()
COMMANDS = {
    "info": ["info"],
    "decode": ["decode", "-o", "out.npz"],
    "report": ["report", "-o", "out.html"],
    "dump": ["dump", "--mid", "Error"],
    "cut": ["cut", "--from", "1", "-o", "out.mtb"],
    "cut by UTC": ["cut", "--from", "2026-01-01", "-o", "out.mtb"],
    "split by size": ["split", "--size", "1kB", "--out-dir", "out"],
    "split by device": ["split", "--device", "--out-dir", "out"],
}
commands = pytest.mark.parametrize("command", COMMANDS)


def zstd(data: bytes) -> bytes:
    import zstandard

    return zstandard.ZstdCompressor().compress(data)


COMPRESS: dict[str, Callable[[bytes], bytes]] = {
    "gz": gzip.compress,
    "xz": lzma.compress,
    "bz2": bz2.compress,
    "zst": zstd,
}
compressions = pytest.mark.parametrize("kind", COMPRESS)


@pytest.fixture(autouse=True)
def _scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


# Text


@commands
@pytest.mark.parametrize(
    "text",
    [
        DATA[:2000].hex(" ").encode(),
        DATA[:9000].hex().encode(),
        "Received:\r\n".encode("utf-16") + DATA[:500].hex(" ").encode("utf-16-le"),
    ],
    ids=["bytes", "one line", "UTF-16"],
)
def test_hex_text_is_recognised(command: str, text: bytes) -> None:
    Path("x.txt").write_bytes(text)
    result = run(*COMMANDS[command], "x.txt")
    assert result.exit_code == 1
    size = f"none in {len(text):,} bytes"
    error = (
        f"xbus: no Xbus frame in x.txt: {size}, which look like hex text; add --hex to read that"
    )
    assert result.stderr.splitlines() == [error]
    assert [path.name for path in Path().rglob("*") if path.is_file()] == ["x.txt"]


@commands
@pytest.mark.parametrize("data", [b"", b"Time,AccX\n1,2\n", b"fa la la", b"12 34 56", bytes(5000)])
def test_other_inputs_without_a_frame(command: str, data: bytes) -> None:
    Path("x.txt").write_bytes(data)
    result = run(*COMMANDS[command], "x.txt")
    assert result.exit_code == 1
    assert "not exported text" in result.stderr
    assert "--hex" not in result.stderr


# Compressed data


@compressions
def test_standard_input_is_decompressed(kind: str) -> None:
    data = COMPRESS[kind](DATA)
    assert "samples   1,040" in run("info", "-", stdin=data).stdout
    assert run("cut", "-", "--from", "0", "-o", "out.mtb", stdin=data).exit_code == 0
    assert Path("out.mtb").read_bytes() == DATA
    text = sentence(run("info", "-", stdin=data[: len(data) // 2]))
    assert text.startswith("cannot read standard input: the compressed data is damaged")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes")
@compressions
def test_a_pipe_is_decompressed(kind: str) -> None:
    os.mkfifo("pipe")
    data = COMPRESS[kind](DATA)

    def write() -> None:
        with Path("pipe").open("wb", buffering=0) as file:
            file.write(data[:1])  # too few to decide
            file.write(data[1:])

    writer = threading.Thread(target=write)
    writer.start()
    assert "samples   1,040" in run("info", "pipe").stdout
    writer.join()


@compressions
def test_a_file_with_another_suffix_is_decompressed(kind: str) -> None:
    Path("walk.mtb").write_bytes(COMPRESS[kind](DATA))
    whole = xbus.read_log(DATA)
    assert xbus.read_log("walk.mtb") == whole
    assert sum(map(len, xbus.iter_log("walk.mtb", block_bytes=20_000))) == len(whole)
    parts = xbus.split_log("walk.mtb", block_bytes=20_000)
    assert sum(len(part.read()) for part in parts) == len(whole)
    assert len(xbus.read_log("walk.mtb", between=(2, 5))) == 312
    Path("walk-0001.mtb").write_bytes(b"")
    assert len(xbus.read_log(["walk.mtb", "walk-0001.mtb"])) == len(whole)
    for command in ("info", "dump"):
        assert run(command, "walk.mtb").stdout == run(command, "-", stdin=DATA).stdout.replace(
            "standard input", "walk.mtb"
        )


@compressions
def test_compressed_bytes_are_refused(kind: str) -> None:
    data = COMPRESS[kind](DATA)
    Path("file").write_bytes(data)
    error = (
        f"the bytes are compressed \\({kind}\\); decompress them, or pass the path of their file"
    )
    with Path("file").open("rb") as file:
        for source in (data, np.frombuffer(data, np.uint8), io.BytesIO(data), file):
            with pytest.raises(ValueError, match=error):
                xbus.read_log(source)
            with pytest.raises(ValueError, match=error):
                next(xbus.iter_log(source))
            with pytest.raises(ValueError, match=error):
                xbus.read_log([source, DATA])


def test_a_missing_library(monkeypatch: pytest.MonkeyPatch) -> None:
    data = zstd(DATA)
    monkeypatch.setitem(sys.modules, "zstandard", None)
    assert 'pip install "xbus-mti[zstd]"' in sentence(run("info", "-", stdin=data))
