"""CAN captures as arrays: files of other software, messages of python-can, or arrays."""

from __future__ import annotations

import contextlib
import gzip
import io
import os
import struct
import warnings
from array import array
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.captures import BINARY, CAPTURE_SUFFIXES, HEAD_SIZE, capture_format, has_frame
from xbus.extras import require
from xbus.files import local_name, naming, suffix_of_compression, uncompressed_name

__all__ = ["Capture", "FrameArrays", "Frames", "read_frames"]

#: The readers of python-can by suffix.
READERS = {
    ".asc": "ASCReader",
    ".blf": "BLFReader",
    ".log": "CanutilsLogReader",
    ".trc": "TRCReader",
    ".csv": "CSVReader",
    ".mf4": "MF4Reader",
}
DATA_SIZE = 8
STANDARD_IDS = 1 << 11
EXTENDED_IDS = 1 << 29
#: Messages that are read at a time.
BLOCK = 1 << 12
FLAGS = _core.CAN_EXTENDED | _core.CAN_REMOTE | _core.CAN_ERROR


class Frames(NamedTuple):
    """The frames of a capture, in order.

    Attributes:
        time: When each was received, in seconds, ``(n,)`` float64; since 1970 if the capture has the date.
        ids: The identifier of each, ``(n,)`` uint32. Bit 31 marks 29 bits, bit 30 a remote frame, and bit 29
            an error frame, as in SocketCAN.
        sizes: Bytes of data of each, ``(n,)`` uint8.
        data: The data, ``(n, 8)`` uint8, filled with zeros.
        channels: The channel of each as a place in `channel_names`, ``(n,)``; None if there is one.
        channel_names: The channels that occur; empty for frames without one.
        fault: What is wrong with the capture, or None.
    """

    time: npt.NDArray[np.float64]
    ids: npt.NDArray[np.uint32]
    sizes: npt.NDArray[np.uint8]
    data: npt.NDArray[np.uint8]
    channels: npt.NDArray[np.uint16] | None = None
    channel_names: tuple[str, ...] = ()
    fault: str | None = None

    def chosen(self, which: slice | npt.NDArray[np.bool_]) -> Frames:
        """Returns some of the frames, without their channels."""
        return Frames(
            self.time[which],
            self.ids[which],
            self.sizes[which],
            self.data[which],
            fault=self.fault,
        )


#: A path, an iterable of ``can.Message``, or the arrays ``(time, ids, sizes, data)`` as in `Frames`.
Capture = str | os.PathLike[str] | Iterable[Any] | tuple[Any, Any, Any, Any]


def read_frames(source: Capture, block: int | None = None) -> Iterator[Frames]:
    """Yields the frames of a capture, in blocks. At least one is yielded; the last one has the fault.

    Args:
        source: The capture.
        block: Maximum number of frames in a block; None for all frames at once.

    Raises:
        ImportError: The extra ``can`` is not installed.
        OSError: The file cannot be read.
        TypeError: The source is of the wrong type.
        ValueError: The file is no capture, or the arrays do not fit together.
    """
    if isinstance(source, str | os.PathLike):
        return _read_file(os.fsdecode(source), block)
    if isinstance(source, tuple) and len(source) == len(("time", "ids", "sizes", "data")):
        return _blocks_of(_of_arrays(*source), block)
    if isinstance(source, bytes | bytearray | memoryview) or not isinstance(source, Iterable):
        raise TypeError(
            "a CAN capture is a path, an iterable of can.Message, or (timestamps, ids, dlcs, data), not "
            f"{type(source).__name__}"
        )
    return _of_messages(iter(source), block)


def _blocks_of(frames: Frames, block: int | None) -> Iterator[Frames]:
    size = block or max(len(frames.ids), 1)
    for start in range(0, max(len(frames.ids), 1), size):
        yield frames.chosen(slice(start, start + size))


def _of_arrays(time: Any, ids: Any, sizes: Any, data: Any) -> Frames:
    times = np.ascontiguousarray(time, np.float64)
    count = len(times)
    if times.ndim != 1 or not np.isfinite(times).all():
        raise ValueError("timestamps must be finite numbers of seconds, one for each frame")
    numbers, lengths, rows = np.asarray(ids), np.asarray(sizes), np.asarray(data)
    if (
        numbers.shape != (count,)
        or lengths.shape != (count,)
        or rows.ndim != 2
        or len(rows) != count
    ):
        raise ValueError(
            f"timestamps, ids and dlcs must be of shape (n,) and data of shape (n, 8), not {times.shape}, "
            f"{numbers.shape}, {lengths.shape} and {rows.shape}"
        )
    if numbers.dtype.kind not in "iu" or lengths.dtype.kind not in "iu" or rows.dtype != np.uint8:
        raise TypeError("ids and dlcs must be integers, and data must be uint8")
    if count and (numbers.min() < 0 or numbers.max() >= 1 << 32):
        raise ValueError(
            "an identifier has 11 or 29 bits, and bits 29 to 31 are marks as in SocketCAN"
        )
    if count and (lengths.min() < 0 or lengths.max() > np.iinfo(np.uint8).max):
        raise ValueError("a frame has at most 64 bytes of data")
    own = numbers.astype(np.uint32)
    own[(own & ~np.uint32(FLAGS)) >= STANDARD_IDS] |= np.uint32(_core.CAN_EXTENDED)
    return Frames(times, own, lengths.astype(np.uint8), _eight(rows))


def _eight(rows: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Returns the first eight bytes of each row, filled with zeros."""
    if rows.shape[1] == DATA_SIZE:
        return np.ascontiguousarray(rows)
    padded = np.zeros((len(rows), DATA_SIZE), np.uint8)
    padded[:, : rows.shape[1]] = rows[:, :DATA_SIZE]
    return padded


class FrameArrays:
    """Messages of python-can as arrays, which grow message by message.

    Args:
        names: The channels by name, and their places; it is extended.
    """

    def __init__(self, names: dict[Any, int]) -> None:
        self._names = names
        self._times, self._ids, self._sizes = array("d"), array("I"), array("B")
        self._channels, self._data = array("H"), bytearray()

    def __len__(self) -> int:
        return len(self._ids)

    def add(self, message: Any) -> None:
        """Adds a message."""
        key = message.arbitration_id & (EXTENDED_IDS - 1)
        key |= _core.CAN_EXTENDED if message.is_extended_id else 0
        key |= _core.CAN_REMOTE if message.is_remote_frame else 0
        key |= _core.CAN_ERROR if message.is_error_frame else 0
        content = bytes(message.data)
        self._times.append(message.timestamp)
        self._ids.append(key)
        self._sizes.append(len(content))
        self._data += content[:DATA_SIZE].ljust(DATA_SIZE, b"\0")
        place = min(len(self._names), np.iinfo(np.uint16).max)
        self._channels.append(self._names.setdefault(message.channel, place))

    def frames(self, fault: str | None = None) -> Frames:
        """Returns the frames."""
        return Frames(
            np.array(self._times, np.float64),
            np.array(self._ids, np.uint32),
            np.array(self._sizes, np.uint8),
            np.frombuffer(bytes(self._data), np.uint8).reshape(-1, DATA_SIZE),
            np.array(self._channels, np.uint16) if len(self._names) > 1 else None,
            tuple("" if name is None else str(name) for name in self._names),
            fault,
        )


def _of_messages(messages: Iterator[Any], block: int | None) -> Iterator[Frames]:
    """Yields messages of python-can in blocks; the fault is the error that ends them."""
    names = dict[Any, int]()
    arrays, before, fault = FrameArrays(names), 0, None
    while True:
        try:
            message = next(messages)
        except StopIteration:
            break
        except (OSError, MemoryError):
            raise
        except Exception as error:  # of a reader of other people, on a damaged file
            text = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
            fault = (
                f"the capture cannot be read beyond frame {before + len(arrays):,} ({text}): it is damaged "
                "or truncated; the frames before are decoded"
            )
            break
        if not hasattr(message, "arbitration_id"):
            raise TypeError(f"a CAN capture has can.Message objects, not {type(message).__name__}")
        arrays.add(message)
        if len(arrays) == block:
            yield arrays.frames()
            arrays, before = FrameArrays(names), before + len(arrays)
    yield arrays.frames(fault)


def _read_file(path: str, block: int | None) -> Iterator[Frames]:
    with naming(path), contextlib.ExitStack() as files:
        file: Any = files.enter_context(_open(path))
        suffix = _suffix_of(file.peek(HEAD_SIZE), path)
        can = require("can", "can", "to read CAN captures")
        if suffix == ".mf4":
            require("asammdf", "can", "to read MF4 files")
        # The times of an ASC file count from its date, as those of the other formats.
        options = {"relative_timestamp": False} if suffix == ".asc" else {}
        fault = _blf_fault(file) if suffix == ".blf" else None
        if suffix not in BINARY:
            file = files.enter_context(io.TextIOWrapper(file, "utf-8", "replace"))
        try:
            with _without_warnings():
                messages = iter(getattr(can, READERS[suffix])(file, **options))
            for frames in _of_messages(_quietly(messages), block):
                yield frames._replace(fault=frames.fault or fault)
        except (OSError, MemoryError):
            raise
        except Exception as error:
            raise ValueError(
                f"{path} is no {suffix} capture: {error or type(error).__name__}; check how it was made"
            ) from error


def _open(path: str) -> Any:
    name = local_name(path)
    match suffix_of_compression(name):
        case "":
            return open(name, "rb")  # noqa: PTH123
        case ".gz":
            return gzip.open(name)
        case suffix:
            raise ValueError(f"{path}: a CAN capture is not read from {suffix}; decompress it")


def _suffix_of(head: bytes, path: str) -> str:
    """Returns the suffix of the format of a file, by its first bytes, or else by its name.

    Raises:
        ValueError: It is no capture, or a compressed one of a format that is not text.
    """
    suffix = capture_format(head)
    if not suffix and has_frame(head):
        raise ValueError(f"{path} is an Xbus log and no CAN capture; read it with xbus.read_log")
    name = uncompressed_name(path)
    suffix = suffix or os.path.splitext(name)[1].lower()  # noqa: PTH122
    if suffix not in CAPTURE_SUFFIXES:
        raise ValueError(
            f"{path} is no CAN capture; its suffix must be one of {', '.join(CAPTURE_SUFFIXES)}"
        )
    if suffix in BINARY and name != path:
        raise ValueError(
            f"{path}: a {suffix} capture is not read from a compressed file; decompress it"
        )
    return suffix


@contextlib.contextmanager
def _without_warnings() -> Iterator[None]:
    """Ignores the warnings of the libraries about the file."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _quietly(messages: Iterator[Any]) -> Iterator[Any]:
    """Yields messages, some thousand at a time, because ignoring warnings takes longer than to read one."""
    while True:
        found, error = [], None
        with _without_warnings():
            try:
                for message in islice(messages, BLOCK):
                    found.append(message)  # noqa: PERF402 - those before an error are kept
            except Exception as caught:  # the messages before it are good
                error = caught
        yield from found
        if error is not None:
            raise error
        if len(found) < BLOCK:
            return


#: The header of a BLF file up to the size that it declares.
BLF_HEAD = struct.Struct("<4sL8xQ")
#: The header of an object: signature, size and version of the header, size and type of the object.
BLF_OBJECT = struct.Struct("<4sHHLL")


def _blf_fault(file: BinaryIO) -> str | None:
    """Returns what is wrong with a BLF file whose end is missing, which its reader does not report."""
    try:
        return _missing_end(file)
    finally:
        file.seek(0)


def _missing_end(file: BinaryIO) -> str | None:
    head = file.read(BLF_HEAD.size)
    if len(head) < BLF_HEAD.size:
        return None  # the reader reports it
    signature, size, declared = BLF_HEAD.unpack(head)
    end = file.seek(0, os.SEEK_END)
    at = size
    while signature == b"LOGG" and at < end:
        file.seek(at)
        head = file.read(BLF_OBJECT.size)
        if len(head) < BLF_OBJECT.size:
            return (
                f"the BLF file is truncated: {len(head)} bytes follow its last whole object, and later "
                "frames are missing; copy the file again"
            )
        mark, _, _, length, _ = BLF_OBJECT.unpack(head)
        if mark != b"LOBJ" or length < BLF_OBJECT.size:
            return None  # the reader reports it
        if at + length > end:
            return (
                f"the BLF file is truncated: its last object has {end - at:,} of {length:,} bytes, and "
                "later frames are missing; copy the file again, after the recorder has closed it"
            )
        at += length + length % 4
    if signature == b"LOGG" and end < declared:
        return (
            f"the BLF file is truncated: it has {end:,} of the {declared:,} bytes that its header "
            "declares, and later frames are missing; copy the file again"
        )
    return None
