"""The inputs from which logs are read."""

from __future__ import annotations

import io
import operator
import os
from collections.abc import Iterable, Mapping
from typing import Any, BinaryIO, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from xbus.captures import HEAD_SIZE, check_no_capture
from xbus.errors import XbusError
from xbus.files import (
    check_is_recording,
    compression_of,
    is_plain,
    is_url,
    local_name,
    naming,
    open_file,
    suffix_of_compression,
)
from xbus.protocol.keys import Key, resolve_key
from xbus.protocol.tables import MASTER
from xbus.remote import RemoteFile, Url

__all__ = [
    "LogChangedError",
    "QuantityFilter",
    "Readable",
    "Source",
    "array_of",
    "check_bid",
    "check_head",
    "input_name",
    "open_binary",
    "open_range",
    "open_source",
    "quantity_filter",
    "size_hint",
    "skip",
    "with_storage_options",
]

#: The quantities to keep: the name of each, and its coordinate system or None for any.
QuantityFilter = list[tuple[str, str | None]]


class LogChangedError(XbusError):
    """The input of a log changed while it was read, or since it was split."""


@runtime_checkable
class Readable(Protocol):
    """A binary file object."""

    def read(self, size: int = ..., /) -> bytes:
        """Returns at most ``size`` bytes; none at the end."""
        ...


#: The input of a log: a path or URL, an object that holds bytes, or a binary file object.
Source = str | os.PathLike[str] | bytes | bytearray | memoryview | npt.NDArray[np.uint8] | Readable

#: Bytes that are skipped at once in a file object that cannot seek.
SKIPPED = 1 << 20
#: The longest payload of a 16-bit length. Logs have messages that are longer than the manual allows.
LONGEST = 0xFFFF


def size_hint(opened: object) -> int | None:
    """Returns the size of a file object if known, so that columns are allocated once.

    Args:
        opened: What the core can read. It knows the size of paths and arrays.
    """
    if isinstance(opened, str | bytes | list | np.ndarray):
        return None
    if hint := operator.length_hint(opened):
        return hint
    try:
        return os.fstat(opened.fileno()).st_size  # type: ignore[attr-defined]
    except (AttributeError, OSError):
        return None


def quantity_filter(quantities: Iterable[Key] | None) -> QuantityFilter | None:
    """Returns the quantities to keep, or None for all of them.

    Raises:
        TypeError: One name instead of a list, or an element is no `Key`.
        ValueError: A quantity that does not exist, or a key with a precision.
    """
    if quantities is None:
        return None
    if isinstance(quantities, str | int):
        raise TypeError(f"quantities must be a list of keys, such as [{quantities!r}]")
    resolved = []
    for key in quantities:
        name, coordinates, precision = resolve_key(key)
        if precision is not None:
            raise ValueError(f"{key!r}: all precisions of a quantity are one column; leave it out")
        resolved.append((name, coordinates))
    return resolved


def check_bid(bid: int | None) -> None:
    """Checks a bus identifier; None stands for all devices.

    Raises:
        TypeError: It is no integer.
        ValueError: It is not from 0 to 255.
    """
    if bid is not None and not 0 <= operator.index(bid) <= MASTER:
        raise ValueError(
            f"bid must be from 0 to {MASTER}, not {bid}; Log.device also takes a device identifier"
        )


def with_storage_options(source: Any, options: Mapping[str, Any] | None) -> Any:
    """Returns a source, or several, whose URLs have these options of their file systems."""
    if options is None:
        return source
    if isinstance(source, list | tuple):
        return [with_storage_options(one, options) for one in source]
    return Url(source, options) if isinstance(source, str) and is_url(source) else source


def open_source(source: Source) -> str | bytes | npt.NDArray[np.uint8] | Readable:
    """Returns what the core can read: bytes, an array, a path, or an object with a method ``read``.

    Bytes never change and are read in place. The core copies an array block by block as it reads it: other
    threads and processes may write to it.

    Raises:
        ImportError: A library for a URL or a compressed file is not installed.
        OSError: A file cannot be opened.
        TypeError: The source is of the wrong type.
        ValueError: Bytes or a file object with compressed data, or a CAN capture. The first bytes of what
            can be read only once are not known here; see `check_head`.
    """
    if isinstance(source, str | os.PathLike):
        path = os.fspath(source)
        name = os.fsdecode(path)
        if not is_plain(name):
            return open_file(name)
        check_is_recording(local_name(name))
        _check_file(local_name(name))
        return local_name(name)
    if isinstance(source, bytes | Readable):
        head = source[:HEAD_SIZE] if isinstance(source, bytes) else _head(source)
        check_head(head, input_name(source))
        return source
    if isinstance(source, np.ndarray):
        if source.dtype != np.uint8 or source.ndim != 1:
            raise TypeError(
                f"an array of bytes must be uint8 with one dimension, not {source.dtype} with "
                f"shape {source.shape}"
            )
        return _checked(np.ascontiguousarray(source))
    try:
        view = memoryview(source)
        view = (view if view.c_contiguous else memoryview(view.tobytes())).cast("B")
    except TypeError:
        raise TypeError(
            "a log is read from a path, bytes, a uint8 array or a binary file object, not "
            f"{type(source).__name__}"
        ) from None
    return _checked(np.frombuffer(view, np.uint8)) if len(view) else np.empty(0, np.uint8)


def _checked(data: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    check_head(data[:HEAD_SIZE].tobytes(), input_name(data))
    return data


def _check_file(path: str) -> None:
    """Checks the first bytes of a file, unless it is a pipe, which can be read once."""
    if os.path.isfile(path):  # noqa: PTH113 - pathlib is slow to import
        with naming(path), open(path, "rb", buffering=0) as file:  # noqa: PTH123
            check_head(file.read(HEAD_SIZE), path)


def _head(file: Readable) -> bytes:
    """Returns the next bytes of a file object, which stays where it is; none if it cannot seek."""
    if not (hasattr(file, "seekable") and file.seekable()):
        return b""
    place = file.tell()  # type: ignore[attr-defined]
    head = file.read(HEAD_SIZE)
    file.seek(place)  # type: ignore[attr-defined]
    return head if isinstance(head, bytes) else b""  # the core refuses text


def input_name(source: object) -> str:
    """Returns the name of an input for messages."""
    name = source if isinstance(source, str | os.PathLike) else getattr(source, "name", None)
    return str(os.fsdecode(name)) if isinstance(name, str | bytes | os.PathLike) else "the input"


def check_head(head: bytes, name: str) -> None:
    """Checks the first bytes of an input.

    Raises:
        ValueError: They are compressed or of a CAN capture: a log would have nothing but damage.
    """
    if suffix := compression_of(head):
        raise ValueError(
            f"the bytes are compressed ({suffix[1:]}); decompress them, or pass the path of their file"
        )
    check_no_capture(head, name)


def open_binary(source: Source) -> BinaryIO | Readable:
    """Returns a file object at the start of a source; the same object if the source is one.

    Errors are those of `open_source`.
    """
    if isinstance(source, str | os.PathLike):
        return open_file(os.fsdecode(os.fspath(source)))
    opened = open_source(source)
    return opened if isinstance(opened, Readable) else io.BytesIO(array_of(source).data)


def open_range(source: Source, start: int, end: int | None) -> BinaryIO | Readable:
    """Returns a file object at ``start`` of a source that is read up to ``end``, or a little more.

    Of a file at a URL only these bytes are requested; its server must support that. Errors are those of
    `open_source`.
    """
    name = os.fsdecode(source) if isinstance(source, str | os.PathLike) else ""
    if is_url(name) and not suffix_of_compression(name):
        return RemoteFile(name, start, end, ranges_only=True)
    file = open_binary(source)
    skip(file, start)
    return file


def skip(file: BinaryIO | Readable, size: int) -> None:
    """Goes forward in a file object. What cannot seek is read."""
    if hasattr(file, "seek"):
        file.seek(size, os.SEEK_CUR)
        return
    while size and (data := file.read(min(size, SKIPPED))):
        size -= len(data)


def array_of(source: Source) -> npt.NDArray[np.uint8]:
    """Returns a source that is neither a path nor a file object as an array."""
    opened = open_source(source)
    if isinstance(opened, bytes):
        return np.frombuffer(opened, np.uint8)
    assert isinstance(opened, np.ndarray)  # noqa: S101 - see above
    return opened
