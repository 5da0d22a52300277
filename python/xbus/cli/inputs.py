"""What commands read: files, one after the other, or standard input."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import stat
import sys
from collections.abc import Iterator, Sequence
from typing import IO, TYPE_CHECKING

import click

from xbus.cli.failure import Failure, cannot
from xbus.cli.progress import Progress

if TYPE_CHECKING:
    from xbus.log.arrivals import Arrivals

__all__ = ["Input", "label", "no_frame", "strings_option", "task"]

#: Stands for standard input.
STDIN = "-"
#: Seconds of waiting for a pipe between which Ctrl-C is heard.
HEARING = 0.2


def label(name: str) -> str:
    """A file's name, printable."""
    return "standard input" if name == STDIN else click.format_filename(name)


def task(name: str) -> str:
    """What is being done, for a bar that has little room."""
    return f"reading {label(os.path.basename(name))}"  # noqa: PTH119 - pathlib is slow to import


def _strings(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    values: tuple[str, ...],
) -> tuple[str, ...]:
    from xbus.protocol.values import StringType

    for it in values:
        if it not in StringType.__members__:
            names = ", ".join(StringType.__members__)
            raise click.BadParameter(f"no string is called {it!r}; there are {names}")
        if it != StringType.EM1000.name:
            raise click.BadParameter(f"{it} is found in any case; --string is for EM1000")
    return values


#: How commands are told of strings that nothing but their length tells from noise.
strings_option = click.option(
    "--string",
    "strings",
    multiple=True,
    callback=_strings,
    metavar="NAME",
    help="Look for this string, too: EM1000, which nothing but its length tells from noise.",
)


def no_frame(names: Sequence[str], size: int) -> Failure:
    """These inputs hold no Xbus frame."""
    what = "it is empty" if size == 0 else f"nothing in its {size:,} bytes is one"
    return Failure(
        f"no Xbus frame in {', '.join(map(label, names))}: {what}; xbus reads .mtb files and raw "
        "bytes from the port, not exported text"
    )


class Input:
    """Files as one binary reader, joined in the given order, so that a split recording is whole.

    All of them are looked at first: a wrong name shows before hours of reading.

    Args:
        names: Paths; ``-`` is standard input.
        progress: Is told how far reading is.

    Attributes:
        total: Bytes of all files, None where one is a pipe.

    Raises:
        Failure: One of them cannot be read.
    """

    def __init__(self, names: Sequence[str], progress: Progress | None = None) -> None:
        self._names, self._sizes = list(names), [_size(it) for it in names]
        self.total = None if None in self._sizes else sum(it or 0 for it in self._sizes)
        self._progress = progress
        self._waiting = list(names)
        self._file: IO[bytes] | None = None
        self._can_wait = False
        self._position = 0
        #: Where each file that was opened begins, and its name.
        self._starts: list[tuple[int, str]] = []

    def __enter__(self) -> Input:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def __length_hint__(self) -> int:
        """Bytes of all files, 0 where nobody knows: how much room a reader should make."""
        return self.total or 0

    def arrivals(self) -> Arrivals | None:
        """When the bytes of these files arrived, by their side files; None where nobody knows."""
        from xbus.log.arrivals import arrivals_of, joined

        known = zip(self._names, self._sizes, strict=True)
        return joined((None if size is None else arrivals_of(it), size or 0) for it, size in known)

    def _close(self) -> None:
        if self._file is not None and self._starts[-1][1] != STDIN:
            self._file.close()
        self._file = None

    def read(self, size: int = -1, /) -> bytes:
        """At most ``size`` bytes, of a pipe those that are there; none at the end of the last file."""
        while True:
            if self._file is None:
                if not self._waiting:
                    return b""
                self.open_next()
            if data := self.read_here(size):
                return data
            self._close()

    def open_next(self) -> None:
        """Opens the next file."""
        name = self._waiting.pop(0)
        with _reading(name):
            self._file = _opened(name)
            self._can_wait = os.name == "posix" and not self.is_regular and _has_number(self._file)
        self._starts.append((self._position, name))

    def read_here(self, size: int = -1) -> bytes:
        """At most ``size`` bytes of the present file; none at its end."""
        assert self._file is not None  # noqa: S101 - see `open_next`
        name = self._starts[-1][1]
        with _reading(name):
            # One system call: what a pipe holds, without waiting for more. None: it does not block.
            while (data := self._read_now(size)) is None:
                pass
        self._position += len(data)
        if self._progress:
            self._progress.update(task(name), self._position, self.total)
        return data

    def _read_now(self, size: int) -> bytes | None:
        assert self._file is not None  # noqa: S101 - see `open_next`
        if self._can_wait:
            # A signal that comes just before a read that blocks would be heard after it only.
            while not select.select([self._file], [], [], HEARING)[0]:
                pass
        return self._file.read(size)

    def rewind_if_cut(self) -> bool:
        """Goes back to the beginning of a file that has become shorter than what was read of it."""
        assert self._file is not None  # noqa: S101 - see `open_next`
        if not self.is_regular or os.fstat(self._file.fileno()).st_size >= self._file.tell():
            return False
        self._file.seek(0)
        return True

    @property
    def is_regular(self) -> bool:
        """Whether the present file is one that can grow, and no pipe."""
        with contextlib.suppress(OSError):
            return self._file is not None and stat.S_ISREG(os.fstat(self._file.fileno()).st_mode)
        return False

    def place(self, offset: int) -> str:
        """The file of a byte, and where in it the byte is."""
        start, name = [it for it in self._starts if it[0] <= offset][-1]
        return f"byte {offset - start} of {label(name)}"


def _size(name: str) -> int | None:
    """Bytes of a file that can be read, None of a pipe."""
    if name == STDIN:
        if sys.stdin is None:
            raise Failure("standard input is closed; name a file")
        return None
    with _reading(name):
        status = os.stat(name)  # noqa: PTH116 - pathlib is slow to import
        if stat.S_ISDIR(status.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if not stat.S_ISREG(status.st_mode):
            return None  # opening a pipe twice would end it
        _opened(name).close()
        return status.st_size


def _opened(name: str) -> IO[bytes]:
    if name == STDIN:
        raw: IO[bytes] = getattr(sys.stdin.buffer, "raw", sys.stdin.buffer)
        return raw
    return open(name, "rb", buffering=0)  # noqa: PTH123 - closed by Input


def _has_number(file: IO[bytes]) -> bool:
    """Whether it is a file of the system, and no stand-in."""
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
