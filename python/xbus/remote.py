"""Files at URLs, read in ranges of bytes with fsspec."""

from __future__ import annotations

import contextlib
import errno
import io
import os
from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias

from xbus.extras import require

__all__ = ["SHORTER", "RemoteFile", "Url", "Version", "matching_urls", "remote_version"]

#: What is wrong with a file that ends before its end.
SHORTER = "the file has become shorter while it was read"
#: Bytes of the first request of a file of which it is not known how much is read. Each one doubles the next.
FIRST = 1 << 18
#: Most bytes of one request.
LARGEST = 8 << 20
#: Bytes behind a range that its last request includes, because they decide where a frame ends.
MARGIN = 1 << 14
#: Bytes of a request behind them.
MORE = 1 << 16
#: What changes with the content of a file, as different file systems name it, the best first.
TAGS = (
    *("ETag", "etag", "generation", "sha", "CRC", "mtime", "LastModified", "last_modified"),
    *("Last-Modified", "modify", "modificationTime", "created"),
)

#: The errors of S3 whose reason the error of the system does not give: number and reason by code. That of an
#: answer to HEAD is its status.
S3_ERRORS = {
    "NoSuchBucket": (errno.ENOENT, "the bucket does not exist"),
    "InvalidAccessKeyId": (errno.EACCES, "the server does not know the access key"),
    "SignatureDoesNotMatch": (errno.EACCES, "the secret key is not that of the access key"),
    "ExpiredToken": (errno.EACCES, "the credentials have expired"),
    "PermanentRedirect": (errno.ENOENT, "the bucket is in another region or at another endpoint"),
    "301": (errno.ENOENT, "the bucket is in another region or at another endpoint"),
}
#: Statuses that may have a code.
WITHOUT_CODE = ("400", "403")

#: What changes when a file does: its size, and an identifier of its content or the time of its last change.
Version: TypeAlias = tuple[int | None, str | None]


class Url(str):
    """A URL with the options of its file system, such as ``{"anon": True}``."""

    __slots__ = ("storage_options",)

    storage_options: Mapping[str, Any]

    def __new__(cls, url: str, storage_options: Mapping[str, Any] | None = None) -> Url:
        """Creates a URL; the options are those of `fsspec.open`."""
        new = super().__new__(cls, url)
        new.storage_options = dict(storage_options or {})
        return new

    def __reduce__(self) -> tuple[type[Url], tuple[str, Mapping[str, Any]]]:
        return Url, (str(self), self.storage_options)


class RemoteFile:
    """A file at a URL as a binary file object. It requests ranges of bytes as they are read.

    Args:
        url: A URL that fsspec knows.
        start: Byte offset at which it stands.
        end: Byte offset up to which it will be read, apart from a few bytes; None if that is not known. To
            read on costs small requests.
        ranges_only: Whether a server that sends only whole files is an error. Otherwise such a file is read
            from front to back.

    Attributes:
        name: The URL.

    Raises:
        ImportError: A library for the URL is not installed.
        OSError: The file cannot be opened.
    """

    def __init__(
        self, url: str, start: int = 0, end: int | None = None, *, ranges_only: bool = False
    ) -> None:
        with _errors(url):
            self._system, self._path = _locate(url)
            self._file = self._system.open(self._path, "rb", cache_type="none")
        self.name, self._end, self._ranges_only = url, end, ranges_only
        self._position = start
        self._bytes = memoryview(b"")  # at the position
        self._request = FIRST
        self._sends_ranges = True
        #: A file that the server sends only whole, and the position in it.
        self._stream: Any = None
        self._stream_position = 0

    def read(self, size: int = -1, /) -> bytes:
        """Returns at most ``size`` bytes; none at the end."""
        if size < 0:
            return b"".join(iter(lambda: self.read(LARGEST), b""))
        if size and not self._bytes:
            with _errors(self.name):
                self._bytes = memoryview(self._range(self._position, self._request_size()))
        data = bytes(self._bytes[:size])
        self._bytes = self._bytes[size:]
        self._position += len(data)
        return data

    def tell(self) -> int:
        """Returns the byte offset at which the file stands."""
        return self._position

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        """Goes to a byte offset and returns it."""
        if whence == os.SEEK_END:
            with _errors(self.name):
                size = self._size()
                offset += self._file.seek(0, os.SEEK_END) if size is None else size
        elif whence == os.SEEK_CUR:
            offset += self._position
        if 0 <= (within := offset - self._position) < len(self._bytes):
            self._bytes = self._bytes[within:]
        else:
            self._bytes, self._request = self._bytes[:0], FIRST
        self._position = offset
        return offset

    def close(self) -> None:
        """Closes the file."""
        self._file.close()

    def _size(self) -> int | None:
        """Returns the size of the file when it was opened, or None."""
        if isinstance(self._file, io.BytesIO):
            return self._file.getbuffer().nbytes
        return getattr(self._file, "size", None)

    def _request_size(self) -> int:
        if self._end is not None:
            left = self._end + MARGIN - self._position
            return min(left, LARGEST) if left > 0 else MORE
        size, self._request = self._request, min(2 * self._request, LARGEST)
        return size

    def _range(self, start: int, size: int) -> bytes:
        if isinstance(self._file, io.BytesIO):  # in memory, with one position for all users
            return bytes(self._file.getbuffer()[start : start + size])
        if (end := self._size()) is not None:
            size = min(size, end - start)
        if size <= 0:
            return b""
        data = self._requested(start, size)
        if not data and end is not None:
            raise OSError(errno.EIO, SHORTER)
        return data

    def _requested(self, start: int, size: int) -> bytes:
        if self._sends_ranges:
            try:
                self._file.seek(start)
                return self._file.read(size)  # type: ignore[no-any-return]
            except ValueError as error:  # fsspec raises this if the server sends only whole files
                if self._ranges_only:
                    reason = (
                        "the server does not send ranges of bytes; copy the file from there first"
                    )
                    raise OSError(errno.EOPNOTSUPP, reason) from error
                self._sends_ranges = False
        return self._streamed(start, size)

    def _streamed(self, start: int, size: int) -> bytes:
        """Returns bytes of a file that is read from front to back, and again to go back."""
        if self._stream is None or start < self._stream_position:
            self._stream = self._system.open(self._path, "rb", block_size=0)
            self._stream_position = 0
        while True:
            skipped = start - self._stream_position
            data: bytes = self._stream.read(min(skipped or size, LARGEST))
            self._stream_position += len(data)
            if not skipped or not data:
                return data


def remote_version(url: str) -> Version:
    """Returns what changes when the file at a URL does, from the server and from no cache.

    Raises:
        ImportError: A library for the URL is not installed.
        OSError: The file cannot be accessed.
    """
    with _errors(url):
        system, path = _locate(url)
        system.invalidate_cache(path)
        info = system.info(path)
        if info.get("type") == "directory":
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    tag = next((f"{name} {info[name]}" for name in TAGS if info.get(name)), None)
    return info.get("size"), tag


def matching_urls(pattern: str) -> list[str]:
    """Returns the URLs that match a pattern with ``*``, in order; the pattern itself if it has none.

    Raises:
        ImportError: A library for the URL is not installed.
        OSError: The folder cannot be listed.
    """
    if "*" not in pattern:
        return [pattern]
    with _errors(pattern):
        system, path = _locate(pattern)
        system.invalidate_cache()
        names = sorted(system.glob(path))
        if not names:
            _check_bucket(system, path)
    options = getattr(pattern, "storage_options", None)
    return [Url(system.unstrip_protocol(name), options) for name in names]


def _locate(url: str) -> tuple[Any, str]:
    """Returns the file system of a URL, and the path in it."""
    fsspec = require("fsspec", "fsspec", "to read from a URL")
    try:
        return fsspec.core.url_to_fs(str(url), **getattr(url, "storage_options", {}))  # type: ignore[no-any-return]
    except ImportError as error:
        protocol = url.partition("://")[0]
        raise ImportError(
            f'to read {url}, a library is missing ({error}): pip install "fsspec[{protocol}]"'
        ) from error
    except ValueError as error:  # an unknown protocol
        raise OSError(errno.EPROTONOSUPPORT, str(error)) from error


def _check_bucket(system: Any, path: str) -> None:
    """Raises FileNotFoundError if the bucket of a path does not exist, where no file matches a pattern."""
    try:
        system.info(path)
    except FileNotFoundError as error:
        if _s3_code(error) == "NoSuchBucket":
            raise


@contextlib.contextmanager
def _errors(url: str) -> Iterator[None]:
    """Converts the errors of all file systems to OSError with a reason and the URL."""
    try:
        yield
    except (ImportError, MemoryError):
        raise
    except Exception as error:
        if _s3_code(error) in WITHOUT_CODE:
            error = _error_of_get(url) or error
        number, reason = _reason(error)
        raise OSError(number, reason, str(url)) from error


def _s3_code(error: BaseException) -> str | None:
    """Returns the code of an error of S3; None for other errors."""
    response = getattr(error.__cause__, "response", None)
    return response.get("Error", {}).get("Code") if isinstance(response, dict) else None


def _error_of_get(url: str) -> Exception | None:
    """Returns the error of a request for a byte, which has a code where that for the size has none."""
    system, path = _locate(url)
    try:
        system.cat_file(path, start=0, end=1)
    except Exception as error:
        return error
    return None


def _reason(error: BaseException) -> tuple[int, str]:
    """Returns the number and the text of an error."""
    if (found := S3_ERRORS.get(_s3_code(error) or "")) is not None:
        return found
    cause = error.__cause__
    if type(error) is FileNotFoundError and cause is not None:
        # fsspec reports any failure of a web server in this way.
        status = getattr(cause, "status", 404)
        if status in (401, 403):
            return errno.EACCES, os.strerror(errno.EACCES)
        if status != 404 or (
            isinstance(cause, OSError) and cause.errno not in (None, errno.ENOENT)
        ):
            return _reason(cause)
    for kind, number in (
        (FileNotFoundError, errno.ENOENT),
        (PermissionError, errno.EACCES),
        (IsADirectoryError, errno.EISDIR),
    ):
        if isinstance(error, kind):
            return number, os.strerror(number)
    if isinstance(error, OSError) and error.errno is not None and error.strerror:
        return error.errno, str(error.strerror).rstrip(".")
    return errno.EIO, str(error).strip().rstrip(".") or type(error).__name__
