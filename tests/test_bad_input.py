"""Damaged files, files of other formats, and readers that misbehave.

Hostile bytes are tested in the folder ``attacks``.
"""

from __future__ import annotations

import io
import os
import socket
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import reference
import streams
import xbus
from conftest import OWN_CAPTURES, counter, differences, facts, facts_of, fine, read
from streams import frame, mtdata2, real
from test_cli import run

READERS: list[Callable[[Any], Any]] = [
    xbus.read_log,
    lambda source: list(xbus.iter_log(source, block_bytes=1000)),
]
both = pytest.mark.parametrize("reader", READERS, ids=["read_log", "iter_log"])

WALK = (OWN_CAPTURES / "walk.mtb").read_bytes()

# ---------------------------------------------------------------------------------------------
# Damaged recordings
# ---------------------------------------------------------------------------------------------

SOUND = [mtdata2(counter(i), fine(25 * i), real(0x4020, i, 0, 9.81)) for i in range(6)]
SIZE = len(SOUND[0])


@pytest.mark.parametrize("end", range(3 * SIZE, 5 * SIZE))
def test_truncated(end: int) -> None:
    """Only the last message is lost, and its offset is reported."""
    log = xbus.read_log(b"".join(SOUND)[:end])
    whole, rest = divmod(end, SIZE)
    assert log["acceleration"].values[:, 0].tolist() == list(range(whole))
    assert log.damage.tolist() == ([(whole * SIZE, rest, "truncated")] if rest else [])


@pytest.mark.parametrize("start", range(1, 2 * SIZE))
def test_starts_in_the_middle(start: int) -> None:
    """A recording that starts within a message loses that message only."""
    log = xbus.read_log(b"".join(SOUND)[start:])
    lost = -(-start // SIZE)
    assert log["acceleration"].values[:, 0].tolist() == list(range(lost, 6))
    assert log.stats.skipped_bytes == lost * SIZE - start
    assert log.stats.lost_samples == 0  # the counter cannot know


@pytest.mark.parametrize("size", range(40))
@pytest.mark.parametrize("garbage", [b"\0", b"\xfa", b"\xff", b"Xsens"])
def test_garbage_between(garbage: bytes, size: int) -> None:
    """Garbage of any length is skipped; the vendor's recorder writes five letters at the start."""
    noise = (garbage * 40)[:size]
    log = xbus.read_log(noise + noise.join(SOUND))
    assert log["acceleration"].values[:, 0].tolist() == list(range(6))
    assert log.stats.skipped_bytes == 6 * size
    assert len(log.damage) == (6 if size else 0)


@pytest.mark.parametrize("at", range(SIZE))
def test_a_lost_byte_loses_one_message(at: int) -> None:
    """One message is lost, and the counter reports it."""
    log = xbus.read_log(b"".join([*SOUND[:3], SOUND[3][:at] + SOUND[3][at + 1 :], *SOUND[4:]]))
    assert log["acceleration"].values[:, 0].tolist() == [0, 1, 2, 4, 5]
    assert (log.stats.lost_samples, log.stats.gaps) == (1, 1)
    assert log.stats.skipped_bytes == SIZE - 1


def test_swapped_blocks() -> None:
    """Blocks in the wrong order are all read, and the counter reports the jumps."""
    data = WALK[:20_000] + WALK[60_000:80_000] + WALK[40_000:60_000]
    log = xbus.read_log(data)
    assert differences(facts(log), facts_of(reference.decode(data))) == []
    assert len(log) > 350
    assert log.stats.gaps >= 1


# ---------------------------------------------------------------------------------------------
# Other files
# ---------------------------------------------------------------------------------------------


@both
def test_a_missing_file_raises_filenotfounderror(
    reader: Callable[[Any], Any], tmp_path: Path
) -> None:
    """Python's own error is raised, with the name of the file."""
    path = tmp_path / "no.mtb"
    for source in (path, str(path)):
        with pytest.raises(FileNotFoundError) as caught:
            reader(source)
        assert caught.value.filename == str(path)


@both
def test_directory(reader: Callable[[Any], Any], tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError) as caught:
        reader(tmp_path)
    assert caught.value.filename == str(tmp_path)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root reads everything")
def test_no_rights(tmp_path: Path) -> None:
    path = tmp_path / "secret.mtb"
    path.touch(0o000)
    with pytest.raises(PermissionError) as caught:
        xbus.read_log(path)
    assert caught.value.filename == str(path)


def test_empty(tmp_path: Path) -> None:
    path = tmp_path / "empty.mtb"
    path.touch()
    log = xbus.read_log(path)
    assert (len(log), len(log.messages), len(log.damage), log.stats.bytes) == (0, 0, 0, 0)
    assert [len(item) for item in xbus.iter_log(path)] == [0]


def png() -> bytes:
    """Returns a picture of noise."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        )

    rows = b"".join(b"\0" + bytes((x * y * 37) % 256 for x in range(256)) for y in range(256))
    head = struct.pack(">IIBBBBB", 256, 256, 8, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )


OTHER_FILES = {
    "PNG": png(),
    "text": Path(reference.__file__).read_bytes(),
    "lines": b"$GPGGA,091507.00,5214.4043,N,00650.3034,E,1,09,1.1,45.2,M,42.8,M,,\r\n" * 100,
    "zip": zlib.compress(WALK),
    "hex dump": WALK[:2000].hex(" ").encode(),
    "one byte": b"\xfa",
    "UTF-16": "FA FF 30 00 D1".encode("utf-16"),
}


@pytest.mark.parametrize("data", OTHER_FILES.values(), ids=OTHER_FILES)
@both
def test_other_files_are_all_damage(
    reader: Callable[[Any], Any], data: bytes, tmp_path: Path
) -> None:
    """Another format gives an empty log, all of it damage; the caller decides whether that is an error."""
    path = tmp_path / "what.mtb"
    path.write_bytes(data)
    found = reader(path)
    parts = found if isinstance(found, list) else [found]
    output = facts(*parts)
    assert differences(output, facts_of(reference.decode(data))) == []
    assert output["stats"]["samples"] == 0
    assert output["stats"]["skipped_bytes"] >= len(data) - 20
    assert "0 samples" in repr(xbus.read_log(path))


@pytest.mark.parametrize(
    "source",
    [None, 3, 3.5, {"a": 1}, object(), xbus.read_log, b"".join],
    ids=lambda item: type(item).__name__,
)
@both
def test_other_types_raise_typeerror(reader: Callable[[Any], Any], source: Any) -> None:
    with pytest.raises(TypeError) as caught:
        reader(source)
    assert (
        "a log is read from a path, bytes, a uint8 array or a binary file object, "
        f"not {type(source).__name__}" in str(caught.value)
    )


@pytest.mark.parametrize(
    ("dtype", "shape"),
    [("i1", (10,)), ("u2", (10,)), ("f8", (10,)), ("?", (10,)), ("u1", (2, 5)), ("u1", ())],
)
def test_other_arrays_raise_typeerror(dtype: str, shape: tuple[int, ...]) -> None:
    np = pytest.importorskip("numpy")
    with pytest.raises(TypeError, match="an array of bytes must be uint8 with one dimension"):
        xbus.read_log(np.zeros(shape, dtype))


# ---------------------------------------------------------------------------------------------
# Files that change while they are read
# ---------------------------------------------------------------------------------------------


def test_a_file_cut_short(tmp_path: Path) -> None:
    """If another program truncates the file between two parts, the log ends there: the file is not mapped."""
    path = tmp_path / "log.mtb"
    data = streams.ahrs(40_000)
    path.write_bytes(data)
    parts = xbus.iter_log(path, block_bytes=10_000)
    first = [next(parts), next(parts)]
    os.truncate(path, 30_000)
    rest = list(parts)
    output = facts(*first, *rest)
    got = output["stats"]["bytes"]
    assert 30_000 <= got < len(data)
    assert differences(output, facts(read(data[:got]))) == []


def test_a_file_cut_to_nothing(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    path.write_bytes(streams.ahrs(40_000))
    parts = xbus.iter_log(path, block_bytes=10_000)
    next(parts)
    path.write_bytes(b"")
    assert sum(len(part) for part in parts) < 40_000


def test_a_file_that_grows(tmp_path: Path) -> None:
    """While a recorder appends to the file, the reader reads what is there."""
    path = tmp_path / "log.mtb"
    data = streams.ahrs(40_000)
    path.write_bytes(data[:2_000_000])
    parts = xbus.iter_log(path, block_bytes=100_000)
    first = [next(parts)]
    with path.open("ab") as file:
        file.write(data[2_000_000:])
    output = facts(*first, *parts)
    assert output["stats"]["bytes"] == len(data)
    assert differences(output, facts(read(data))) == []


def test_a_replaced_file_is_read_to_its_end(tmp_path: Path) -> None:
    """The open file is read to its end, not the one that replaced it."""
    path, other = tmp_path / "log.mtb", tmp_path / "other.mtb"
    data = streams.ahrs(40_000)
    path.write_bytes(data)
    other.write_bytes(b"something else")
    parts = xbus.iter_log(path, block_bytes=100_000)
    first = next(parts)
    other.replace(path)
    assert len(first) + sum(len(part) for part in parts) == 40_000


# ---------------------------------------------------------------------------------------------
# Readers that misbehave
# ---------------------------------------------------------------------------------------------


class Reader:
    """Returns these answers in turn, and raises those that are exceptions."""

    def __init__(self, *answers: Any) -> None:
        self.answers = list(answers)

    def read(self, size: int = -1, /) -> Any:
        answer = self.answers.pop(0) if self.answers else b""
        if isinstance(answer, BaseException):
            raise answer
        return answer(size) if callable(answer) else answer


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        ("text", "read() must return bytes; open the file in binary mode"),
        (None, "read() must return bytes; open the file in binary mode"),
        (7, "read() must return bytes; open the file in binary mode"),
        ([1, 2], "read() must return bytes; open the file in binary mode"),
        (lambda size: bytes(size + 1), "read() returned more bytes than requested"),
    ],
)
@both
def test_wrong_results_of_read_raise_typeerror(
    reader: Callable[[Any], Any], answer: Any, text: str
) -> None:
    """The error comes at once, and after sound bytes."""
    for answers in ([answer], [SOUND[0], answer]):
        with pytest.raises(TypeError) as caught:
            reader(Reader(*answers))
        assert str(caught.value) == text


@both
def test_text_mode(reader: Callable[[Any], Any], tmp_path: Path) -> None:
    """The most common mistake has an error message with the remedy."""
    path = tmp_path / "log.mtb"
    path.write_bytes(frame(0x30)[:1] * 0 + b"only ASCII")
    with path.open() as file, pytest.raises(TypeError, match="open the file in binary mode"):
        reader(file)
    with pytest.raises(TypeError, match="open the file in binary mode"):
        reader(io.StringIO("text"))


class Unheard(Exception):  # noqa: N818 - a name for this test
    """An error that only the reader raises."""


@pytest.mark.parametrize(
    "error", [OSError(5, "Input/output error"), Unheard("lost"), KeyboardInterrupt()]
)
@both
def test_errors_of_the_reader_are_passed_on(
    reader: Callable[[Any], Any], error: BaseException
) -> None:
    """The same exception is raised, not one that wraps it."""
    for answers in ([error], [SOUND[0], error]):
        with pytest.raises(type(error)) as caught:
            reader(Reader(*answers))
        assert caught.value is error


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="Linux only")
@pytest.mark.parametrize(
    "read_file",
    [
        lambda path: xbus.read_log(path, threads=1),
        lambda path: xbus.read_log(path, threads=2),
        lambda path: xbus.read_log([path, path], threads=2),
        lambda path: xbus.read_log(path, between=(0, 1)),
        lambda path: list(xbus.iter_log(path)),
        xbus.split_log,
    ],
)
def test_an_error_of_reading_names_the_file(read_file: Callable[[str], Any]) -> None:
    """Memory at address 0 cannot be read, but this file can be opened."""
    with pytest.raises(OSError, match=r"Input/output error: '/proc/self/mem'"):
        read_file("/proc/self/mem")


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="Linux only")
def test_an_error_of_reading_names_the_capture(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    path.symlink_to("/proc/self/mem")
    with pytest.raises(OSError, match=rf"Input/output error: '{path}'"):
        xbus.read_can(path)


def test_parts_before_an_error_are_returned() -> None:
    """Whole parts are returned before the error is raised."""
    file = io.BytesIO((b"".join(SOUND) * 500)[:20_000])

    def some(size: int) -> bytes:
        if data := file.read(size):
            return data
        raise OSError("gone")

    parts = xbus.iter_log(Reader(*[some] * 100), block_bytes=10_000)
    assert len(next(parts)) > 200
    with pytest.raises(OSError, match="gone"):
        next(parts)


def test_closed_file(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    path.write_bytes(SOUND[0])
    with path.open("rb") as file:
        pass
    with pytest.raises(ValueError, match="closed file"):
        xbus.read_log(file)


def test_a_file_open_for_writing(tmp_path: Path) -> None:
    with (tmp_path / "log.mtb").open("wb") as file, pytest.raises(io.UnsupportedOperation):
        xbus.read_log(file)


def test_short_reads_are_not_the_end() -> None:
    """Only an empty result ends the input."""
    log = xbus.read_log(Reader(*[bytes([item]) for item in SOUND[0]], *SOUND[1:]))
    assert len(log) == 6
    assert len(xbus.read_log(Reader(SOUND[0], b"", SOUND[1]))) == 1


def test_a_reader_may_read_another_log() -> None:
    """The reader is re-entrant: read() of the source reads another log."""
    inner: list[int] = []

    def some(size: int) -> bytes:
        inner.append(len(xbus.read_log(SOUND[0] * 3)))
        return SOUND[0] if len(inner) == 1 else b""

    assert len(xbus.read_log(Reader(some, some))) == 1
    assert inner == [3, 3]


# ---------------------------------------------------------------------------------------------
# Paths that are no files
# ---------------------------------------------------------------------------------------------


def listening(path: Path) -> socket.socket:
    """Returns a socket with a path."""
    one = socket.socket(socket.AF_UNIX)
    one.bind(str(path))
    return one


@both
@pytest.mark.skipif(os.name != "posix", reason="no such paths here")
def test_folders_sockets_and_devices(
    reader: Callable[[Any], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They have no content, or no end; the error says so, and the command adds the remedy."""
    monkeypatch.chdir(tmp_path)
    Path("folder.gz").mkdir()
    with listening(Path("socket")):
        for path, error, sentence in (
            ("/dev/zero", "a device, not a recording", "xbus record writes what a device sends"),
            ("socket", "a socket, not a recording", "name a file or a pipe"),
            ("folder.gz", "Is a directory", ""),
        ):
            with pytest.raises(OSError, match=error):
                reader(path)
            for command in (
                ["info"],
                ["decode", "-o", "x.csv"],
                ["dump"],
                ["report", "-o", "x.html"],
            ):
                if not Path(path).is_dir():
                    result = run(*command, path)
                    assert result.exit_code == 1
                    assert result.stderr.startswith(
                        f"xbus: cannot read {path}: {error}; {sentence}"
                    )
                    assert result.stderr.count("\n") == 1
    result = run("info", "/dev/null")
    assert (result.exit_code, result.stderr.count("\n")) == (1, 1)
    assert "no Xbus frame in /dev/null: the input is empty" in result.stderr
    assert not Path("x.csv").exists()
