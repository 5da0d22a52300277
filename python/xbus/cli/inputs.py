"""Inputs of commands: files, one after the other, or standard input."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import re
import select
import stat
import sys
from collections.abc import Iterator, Sequence
from typing import IO, TYPE_CHECKING

import click

from xbus.captures import CaptureError, is_capture
from xbus.cli.failure import Failure, cannot, no_capture
from xbus.cli.progress import ShowsProgress
from xbus.describe.names import file_label
from xbus.files import (
    MAGIC_SIZE,
    check_is_recording,
    compression_of,
    decompressed,
    is_magic_start,
    is_plain,
    is_url,
    local_name,
    open_file,
    suffix_of_compression,
)
from xbus.remote import SHORTER

if TYPE_CHECKING:
    from xbus.log.arrivals import Arrivals

__all__ = [
    "Input",
    "check_port_options",
    "is_recording",
    "label",
    "legacy_option",
    "no_frame",
    "reading_task",
    "strings_option",
]

#: The name of standard input.
STDIN = "-"
#: Bytes at the start of an input that show whether it is text.
HEAD = 4096
#: The first byte of every frame.
PREAMBLE = 0xFA
#: Interval in seconds at which a reader of a pipe checks for Ctrl-C.
SIGNAL_INTERVAL = 0.2


def label(name: str) -> str:
    """Returns a printable file name."""
    if name == STDIN:
        return "standard input"
    return file_label(name)


def is_recording(name: str) -> bool:
    """Returns whether a name is that of a file and not of a port."""
    try:
        return stat.S_ISREG(os.stat(name).st_mode)  # noqa: PTH116 - pathlib is slow to import
    except (OSError, ValueError):
        return False


def check_port_options(name: str, **options: object) -> None:
    """Rejects options that only a port has, for a recording.

    Args:
        name: The recording.
        options: The options by name; those that were not given are None or False.

    Raises:
        UsageError: One was given.
    """
    for option, value in options.items():
        if value is not None and value is not False:
            raise click.UsageError(f"{label(name)} is a recording; --{option} is for a port")


def reading_task(name: str) -> str:
    """Returns the text of a progress bar."""
    return f"reading {label(os.path.basename(name))}"  # noqa: PTH119 - pathlib is slow to import


def _strings(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    values: tuple[str, ...],
) -> tuple[str, ...]:
    from xbus.protocol.values import StringType

    for value in values:
        if value not in StringType.__members__:
            names = ", ".join(StringType.__members__)
            raise click.BadParameter(f"no string is called {value!r}; choose from {names}")
        if value != StringType.EM1000.name:
            raise click.BadParameter(f"{value} is always parsed; --string is only for EM1000")
    return values


#: The option for a string type that is not parsed by default.
strings_option = click.option(
    "--string",
    "strings",
    multiple=True,
    callback=_strings,
    metavar="NAME",
    help="Also parse this string type. Needed only for EM1000, which has no checksum and no terminator.",
)


def _legacy(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    values: tuple[str, ...],
) -> list[tuple[int, int]]:
    from xbus.log.legacy import legacy_outputs

    pairs = []
    for value in values:
        if not (found := re.fullmatch(r"([0-9A-Fa-f]{1,4}):([0-9A-Fa-f]{1,8})", value)):
            raise click.BadParameter(
                f"{value!r} is not OutputMode:OutputSettings in hex, such as 0006:00000001"
            )
        pairs.append((int(found[1], 16), int(found[2], 16)))
    try:
        return legacy_outputs(pairs)
    except ValueError as error:
        raise click.BadParameter(str(error)) from error


#: The option for the settings of a log with MTData that does not have them.
legacy_option = click.option(
    "--legacy",
    multiple=True,
    callback=_legacy,
    metavar="MODE:SETTINGS",
    help="OutputMode and OutputSettings, in hex, of the MTData of an older device, if the log does not have "
    "them. Repeat it for each tracker of an Xbus Master.",
)


def no_frame(names: Sequence[str], size: int, head: bytes = b"") -> Failure:
    """Returns the failure of inputs without an Xbus frame.

    Args:
        names: The inputs.
        size: Their size in bytes.
        head: The first bytes.
    """
    problem = "the input is empty" if size == 0 else f"none in {size:,} bytes"
    if _is_hex_text(head):
        return Failure(
            f"no Xbus frame in {', '.join(map(label, names))}: {problem}, which look like hex text; add "
            "--hex to read that"
        )
    if any(map(is_capture, names)):
        return no_capture(", ".join(map(label, names)))
    return Failure(
        f"no Xbus frame in {', '.join(map(label, names))}: {problem}; xbus reads .mtb files and raw "
        "bytes from the port, not exported text"
    )


def _is_hex_text(head: bytes) -> bool:
    """Returns whether the start of a file is text that contains the start of a frame in hex."""
    from xbus.wire.hextext import from_hex

    # The last line may be cut.
    lines = _text(head).splitlines(keepends=True)
    try:
        data = from_hex("".join(lines[:-1] if len(lines) > 1 else lines))
    except ValueError:
        # A line that is longer than the head may end within a byte.
        try:
            data = from_hex(_text(head)[:-1])
        except ValueError:
            return False
    return PREAMBLE in data


def _text(data: bytes) -> str:
    """Returns the text in a file. Notepad and PowerShell mark UTF-16 at its start."""
    encoding = "utf-16" if data.startswith((b"\xff\xfe", b"\xfe\xff")) else "utf-8"
    return data.decode(encoding, "replace")


class Input:
    """The pieces of a recording as one binary reader.

    All local files are opened once at the start: a wrong name is reported before hours of reading.

    Args:
        names: Paths or URLs, in order; ``-`` is standard input.
        progress: The progress bar to update.
        is_hex: Whether the files are text with the bytes in hex.

    Attributes:
        total: Size of all files in bytes, None if one is a pipe, compressed or remote.
        head: The first bytes that were read, at most `HEAD`.

    Raises:
        Failure: A file cannot be read.
    """

    def __init__(
        self, names: Sequence[str], progress: ShowsProgress | None = None, *, is_hex: bool = False
    ) -> None:
        self._names, self._sizes = list(names), [_size(name) for name in names]
        self.total = None if None in self._sizes else sum(size or 0 for size in self._sizes)
        self._progress, self._is_hex = progress, is_hex
        if is_hex:
            self.total = None
        self.head = b""
        self._unopened = list(names)
        self._file: IO[bytes] | None = None
        self._can_select = False
        #: Whether the first bytes of the current file may show that it is compressed.
        self._may_be_compressed = False
        self._position = 0
        #: The position at which each file starts, from the first to the current one, and its name.
        self._starts: list[tuple[int, str]] = []

    def __enter__(self) -> Input:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def __length_hint__(self) -> int:
        """Size of all files in bytes, 0 if unknown; a reader allocates its buffer with it."""
        return self.total or 0

    def arrivals(self) -> Arrivals | None:
        """Returns the arrival times of the bytes from the side files; None if a file has none."""
        from xbus.log.arrivals import arrivals_of, joined

        return None if self._is_hex else joined(map(arrivals_of, self._names))

    def _close(self) -> None:
        if self._file is not None and (self._is_hex or self._starts[-1][1] != STDIN):
            self._file.close()
        self._file = None

    def read(self, size: int = -1, /) -> bytes:
        """Returns at most ``size`` bytes, from a pipe the available ones; none after the last file."""
        while True:
            if self._file is None:
                if not self._unopened:
                    return b""
                self.open_next()
            if data := self.read_current(size):
                return data
            self._check_size()
            self._close()

    def _check_size(self) -> None:
        """Raises Failure if one of several files has become shorter: the next one does not continue it."""
        start, name = self._starts[-1]
        size = self._sizes[len(self._starts) - 1] or 0
        if len(self._names) > 1 and not self._is_hex and self._position - start < size:
            raise cannot(f"read {label(name)}", OSError(errno.EIO, SHORTER))

    def open_next(self) -> None:
        """Opens the next file."""
        name = self._unopened.pop(0)
        # First, because Ctrl-C can close the file at any moment after it is open.
        self._starts.append((self._position, name))
        with _reading(name):
            self._file = _open_hex(name) if self._is_hex else _open(name)
            is_stream = name == STDIN or (is_plain(name) and not self.is_regular)
            self._may_be_compressed = is_stream and not self._is_hex
            is_pipe = is_stream and os.name == "posix" and not self.is_regular
            self._can_select = is_pipe and _has_descriptor(self._file)

    def read_current(self, size: int = -1) -> bytes:
        """Returns at most ``size`` bytes of the current file; none at its end."""
        assert self._file is not None  # noqa: S101 - see `open_next`
        name = self._starts[-1][1]
        with _reading(name):
            # One system call returns what a pipe holds. A non-blocking file returns None.
            while (data := self._read_once(size)) is None:
                pass
        if not self._is_hex:
            if self._position == self._starts[-1][0]:
                _check_head(data, name)
            self.head += data[: HEAD - len(self.head)]
        self._position += len(data)
        self._show_progress()
        return data

    def _show_progress(self) -> None:
        if self._progress:
            name = self._starts[-1][1]
            self._progress.update(reading_task(name), self._position, self.total)

    def _read_once(self, size: int) -> bytes | None:
        assert self._file is not None  # noqa: S101 - see `open_next`
        if self._can_select:
            # Python handles a signal that arrives just before a blocking read only after it.
            while not select.select([self._file], [], [], SIGNAL_INTERVAL)[0]:
                self._show_progress()  # which ends a job that another thread stops
        data = self._file.read(size)
        if data and self._may_be_compressed and not 0 <= size < MAGIC_SIZE:
            return self._decompressed(data, size)
        return data

    def _decompressed(self, head: bytes, size: int) -> bytes:
        """Returns the first bytes of the current stream, which is decompressed if these show compression."""
        assert self._file is not None  # noqa: S101 - see `open_next`
        self._may_be_compressed = False
        while is_magic_start(head) and (more := self._read_once(MAGIC_SIZE - len(head))):
            head += more
        suffix = compression_of(head)
        if not suffix:
            return head
        # Its buffers may hold bytes while the stream has none.
        self._can_select = False
        name = self._starts[-1][1]
        stream = _Stream(head, self._file, is_owned=name != STDIN)
        self._file = decompressed(stream, suffix, label(name))
        return self._file.read(size)

    def rewind_if_truncated(self) -> bool:
        """Returns to the start of a file that is now shorter than what was read, and whether it was."""
        assert self._file is not None  # noqa: S101 - see `open_next`
        if not self.is_regular or os.fstat(self._file.fileno()).st_size >= self._file.tell():
            return False
        self._file.seek(0)
        return True

    @property
    def size(self) -> int:
        """Number of bytes that were read."""
        return self._position

    @property
    def is_regular(self) -> bool:
        """Whether the current file is a regular file, which can grow."""
        with contextlib.suppress(AttributeError, OSError):  # not a file of the operating system
            return self._file is not None and stat.S_ISREG(os.fstat(self._file.fileno()).st_mode)
        return False

    def locate(self, offset: int) -> str:
        """Returns the file of a byte and the offset in it, as text."""
        start, name = [entry for entry in self._starts if entry[0] <= offset][-1]
        return f"byte {offset - start} of {label(name)}"


class _Stream:
    """A stream with the bytes that were read from it before."""

    def __init__(self, head: bytes, rest: IO[bytes], *, is_owned: bool) -> None:
        self._head, self._rest, self._is_owned = head, rest, is_owned

    def read(self, size: int = -1, /) -> bytes:
        """Returns at most ``size`` bytes; none at the end."""
        if self._head:
            size = len(self._head) if size < 0 else size
            data, self._head = self._head[:size], self._head[size:]
            return data
        while (more := self._rest.read(size)) is None:
            pass
        return more

    def close(self) -> None:
        """Closes the stream, unless it is standard input."""
        if self._is_owned:
            self._rest.close()


def _check_head(head: bytes, name: str) -> None:
    """Checks the first bytes of a file, as the readers of logs do, which do not know its name."""
    from xbus.log.source import check_head

    try:
        check_head(head, label(name))
    except CaptureError as error:
        raise no_capture(label(name)) from error
    except ValueError as error:
        raise Failure(f"cannot read {label(name)}: {error}") from error


def _size(name: str) -> int | None:
    """Returns the size of the content of a readable file in bytes; None if it is not known."""
    if name == STDIN:
        if sys.stdin is None:
            raise Failure("standard input is closed; name a file")
        return None
    if not is_plain(name):
        return None
    with _reading(name):
        check_is_recording(local_name(name))
        status = os.stat(local_name(name))  # noqa: PTH116 - pathlib is slow to import
        if not stat.S_ISREG(status.st_mode):
            return None  # a pipe that is opened twice would end
        _open(name).close()
        return status.st_size


def _open(name: str) -> IO[bytes]:
    if name == STDIN:
        raw: IO[bytes] = getattr(sys.stdin.buffer, "raw", sys.stdin.buffer)
        return raw
    return _open_pipe(name) or open_file(name)


def _open_pipe(name: str) -> IO[bytes] | None:
    """Opens a named pipe without waiting for its writer, so that Ctrl-C is handled; None for other files."""
    if os.name != "posix" or is_url(name) or suffix_of_compression(name):
        return None
    path = local_name(name)
    with contextlib.suppress(OSError):  # `open_file` reports it
        if not stat.S_ISFIFO(os.stat(path).st_mode):  # noqa: PTH116
            return None
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        os.set_blocking(descriptor, True)
        return open(descriptor, "rb", buffering=0)  # noqa: PTH123
    return None


def _open_hex(name: str) -> IO[bytes]:
    """Opens a text with bytes in hex."""
    from xbus.wire.hextext import from_hex

    file = _open(name)
    text = bytearray()
    while data := file.read(1 << 20):
        text += data
    if name != STDIN:
        file.close()
    try:
        return io.BytesIO(from_hex(_text(bytes(text))))
    except ValueError as error:
        raise Failure(f"cannot read {label(name)}: {error}") from error


def _has_descriptor(file: IO[bytes]) -> bool:
    """Returns whether this is a file of the operating system."""
    try:
        return file.fileno() >= 0
    except OSError:
        return False


@contextlib.contextmanager
def _reading(name: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise cannot(f"read {label(name)}", error) from error
