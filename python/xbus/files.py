"""Opens files by name: plain or compressed, local or at a URL."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import stat
from collections.abc import Callable, Iterator
from typing import Any, BinaryIO, TypeAlias

from xbus.extras import require
from xbus.remote import RemoteFile, Version, remote_version

__all__ = [
    "COMPRESSIONS",
    "MAGIC_SIZE",
    "RECORDING_SUFFIX",
    "check_is_recording",
    "compression_of",
    "content_size",
    "decompressed",
    "file_version",
    "is_magic_start",
    "is_plain",
    "is_url",
    "local_name",
    "naming",
    "open_file",
    "suffix_of_compression",
    "uncompressed_name",
]

#: Suffix of the recordings of a device.
RECORDING_SUFFIX = ".mtb"
#: Suffixes of compressed files.
COMPRESSIONS = (".gz", ".zst", ".xz", ".bz2")
#: The first bytes of compressed data. The digit after ``BZh`` is the size of its blocks.
MAGIC = {
    b"\x1f\x8b\x08": ".gz",
    b"\x28\xb5\x2f\xfd": ".zst",
    b"\xfd7zXZ\x00": ".xz",
    **{b"BZh%d1AY&SY" % digit: ".bz2" for digit in range(1, 10)},
}
#: Number of bytes that show whether data are compressed.
MAGIC_SIZE = max(map(len, MAGIC))
#: Bytes of compressed input that are read at once.
CHUNK = 1 << 16
#: Bytes to decompress at a time.
BLOCK = 1 << 20


def suffix_of_compression(name: str) -> str:
    """Returns the suffix of a compressed file, such as ``".gz"``; empty for other files."""
    return next((suffix for suffix in COMPRESSIONS if name.lower().endswith(suffix)), "")


def uncompressed_name(name: str) -> str:
    """Returns a name without the suffix of a compression.

    >>> uncompressed_name("walk.mtb.gz"), uncompressed_name("walk.mtb")
    ('walk.mtb', 'walk.mtb')
    """
    return name[: len(name) - len(suffix_of_compression(name))]


def is_url(name: str) -> bool:
    """Returns whether this is a URL that names no local file."""
    return "://" in local_name(name)


def local_name(name: str) -> str:
    """Returns the path in a ``file://`` URL; other names unchanged."""
    if not name.lower().startswith("file://"):
        return name
    # Imported here, as are the decompressors: `xbus --help` must not wait for these.
    from urllib.parse import urlsplit
    from urllib.request import url2pathname

    parts = urlsplit(name)
    host = "" if parts.netloc in ("", "localhost") else f"//{parts.netloc}"
    return url2pathname(host + parts.path)


def compression_of(head: bytes) -> str:
    """Returns the suffix of compressed data by the first `MAGIC_SIZE` bytes; empty for other data.

    >>> compression_of(bytes.fromhex("1f8b0800")), compression_of(bytes.fromhex("faff3600cb"))
    ('.gz', '')
    """
    return next((suffix for magic, suffix in MAGIC.items() if head.startswith(magic)), "")


def is_magic_start(head: bytes) -> bool:
    """Returns whether more bytes are needed to decide whether data are compressed."""
    return any(len(head) < len(magic) and magic.startswith(head) for magic in MAGIC)


def is_plain(name: str) -> bool:
    """Returns whether this is the path of a file that is not compressed.

    Compressed files are known by the suffix and, if they are regular files, by their first bytes.
    """
    if is_url(name) or suffix_of_compression(name):
        return False
    path = local_name(name)
    try:
        # To open a pipe would wait for its writer.
        if not stat.S_ISREG(os.stat(path).st_mode):  # noqa: PTH116
            return True
        with open(path, "rb", buffering=0) as file:  # noqa: PTH123
            return not compression_of(file.read(MAGIC_SIZE))
    except (OSError, ValueError):
        return True  # reading it reports the error


def check_is_recording(path: str) -> None:
    """Checks that a path can be read to an end: a file, a pipe or the null device.

    Raises:
        OSError: There is no such file, or it is a folder, a socket or a device.
    """
    mode = os.stat(path).st_mode  # noqa: PTH116
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), path)
    if stat.S_ISSOCK(mode):
        raise OSError(errno.ENXIO, "a socket, not a recording", path)
    if stat.S_ISCHR(mode) and not os.path.samefile(path, os.devnull):  # noqa: PTH121
        raise OSError(errno.ENODEV, "a device, not a recording", path)


def open_file(name: str, *, is_regular: bool = False) -> BinaryIO:
    """Opens a file to read its content, decompressed if it is compressed: see `is_plain`.

    Args:
        name: Path or URL.
        is_regular: Refuse what is no regular file, such as a pipe, which could have no writer and no end.

    Raises:
        ImportError: A library for the URL or the compression is not installed.
        OSError: The file cannot be opened, or it is a folder, a socket or a device.
    """
    path = local_name(name)
    raw: Any = RemoteFile(path) if is_url(path) else _open_local(path, is_regular=is_regular)
    try:
        suffix = suffix_of_compression(path)
        if not suffix and not is_url(path) and raw.seekable():
            suffix = compression_of(raw.read(MAGIC_SIZE))
            raw.seek(0)
        return decompressed(raw, suffix, name) if suffix else raw
    except BaseException:
        raw.close()
        raise


def _open_local(path: str, *, is_regular: bool) -> BinaryIO:
    if not is_regular:
        check_is_recording(path)
        return _NamedFile(path)

    def opener(path: str, flags: int) -> int:
        # Without O_NONBLOCK, to open a pipe waits for its writer.
        return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))

    file = _NamedFile(path, opener=opener)
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError(errno.EINVAL, "not a regular file", path)
    return file


@contextlib.contextmanager
def naming(name: str) -> Iterator[None]:
    """Adds the name of a file to errors of the system that have none, as those of reading."""
    try:
        yield
    except OSError as error:
        if error.errno is not None and error.filename is None:
            error.filename = name
        raise


class _NamedFile(io.FileIO):
    """A local file whose errors name it when it is read, not only when it is opened."""

    def read(self, size: int | None = -1, /) -> Any:
        with naming(os.fsdecode(self.name)):
            return super().read(size)

    def readinto(self, buffer: Any, /) -> Any:
        with naming(os.fsdecode(self.name)):
            return super().readinto(buffer)


def content_size(path: str, limit: int | None = None) -> int:
    """Returns the size of the content of a local file in bytes, for which a compressed one is decompressed.

    Args:
        path: The file.
        limit: Size from which on it is not decompressed further; None for no limit.

    Raises:
        ImportError: The library for the compression is not installed.
        OSError: The file cannot be read.
    """
    if is_plain(path):
        return os.stat(path).st_size  # noqa: PTH116
    size, file = 0, open_file(path)
    try:
        while (limit is None or size < limit) and (data := file.read(BLOCK)):
            size += len(data)
    finally:
        file.close()
    return size


def decompressed(raw: Any, suffix: str, name: str) -> BinaryIO:
    """Returns a file object that decompresses another one and owns it.

    Args:
        raw: The compressed file.
        suffix: One of `COMPRESSIONS`.
        name: Its name, for messages.

    Raises:
        ImportError: The library for the compression is not installed.
    """
    return _Decompressed(_reader(raw, suffix), raw, name)  # type: ignore[return-value]


def file_version(name: str) -> Version:
    """Returns what changes when a file does: its size, and the time of the last change or an identifier.

    Raises:
        ImportError: A library for the URL is not installed.
        OSError: The file cannot be accessed, or is a folder.
        TypeError: It is a pipe or a device.
    """
    path = local_name(name)
    if is_url(path):
        return remote_version(path)
    status = os.stat(path)  # noqa: PTH116 - pathlib is slow to import
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), name)
    if not stat.S_ISREG(status.st_mode):
        raise TypeError(
            f"{name} is no regular file and can be read only once; copy it to one, or use iter_log"
        )
    return status.st_size, str(status.st_mtime_ns)


def _reader(raw: BinaryIO, suffix: str) -> _Read:
    """Returns the function that decompresses a file. It returns what one read of a pipe yields."""
    match suffix:
        case ".gz":
            import gzip

            return gzip.GzipFile(fileobj=raw).read1
        case ".xz":
            import lzma

            return lzma.LZMAFile(raw).read1
        case ".bz2":
            import bz2

            return bz2.BZ2File(raw).read1
        case _:
            return _Zstandard(raw).read


#: Returns at most this number of bytes; none at the end.
_Read: TypeAlias = Callable[[int], bytes]


class _Zstandard:
    """Decompresses the frames of a Zstandard file. Unlike the library's reader, it detects a missing end."""

    def __init__(self, raw: BinaryIO) -> None:
        library = require("zstandard", "zstd", "to read .zst files")
        self._error: type[Exception] = library.ZstdError
        self._decompressor = library.ZstdDecompressor()
        self._raw = raw
        self._frame: Any = None
        self._decompressed = memoryview(b"")

    def read(self, size: int) -> bytes:
        """Returns at most ``size`` bytes; none at the end."""
        while not self._decompressed:
            compressed = self._raw.read(CHUNK)
            if not compressed:
                if self._frame is not None:
                    raise EOFError("the file ends before the compressed data does")
                break
            try:
                self._decompressed = memoryview(b"".join(self._feed(compressed)))
            except self._error as error:
                raise EOFError(str(error)) from error
        data, self._decompressed = self._decompressed[:size], self._decompressed[size:]
        return bytes(data)

    def _feed(self, compressed: bytes) -> Iterator[bytes]:
        while compressed:
            if self._frame is None:
                self._frame = self._decompressor.decompressobj()
            yield self._frame.decompress(compressed)
            compressed = b""
            if self._frame.eof:
                compressed, self._frame = self._frame.unused_data, None


class _Decompressed:
    """A file as its decompressor reads it, with errors of the decompressor as OSError."""

    def __init__(self, read: _Read, raw: BinaryIO, name: str) -> None:
        self._read, self._raw, self.name = read, raw, name

    def read(self, size: int = -1, /) -> bytes:
        """Returns at most ``size`` bytes, from a pipe what it yields; none at the end."""
        import lzma
        import zlib

        if size < 0:
            return b"".join(iter(lambda: self.read(CHUNK), b""))
        reason: Exception
        try:
            return self._read(size)
        except (EOFError, zlib.error, lzma.LZMAError) as error:
            reason = error
        except OSError as error:
            if error.errno is not None:
                raise
            reason = error
        raise OSError(errno.EILSEQ, f"the compressed data is damaged ({reason})", self.name)

    def close(self) -> None:
        """Closes the file."""
        self._raw.close()

    def __del__(self) -> None:
        self.close()
