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
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.extras import require

__all__ = ["CAPTURE_SUFFIXES", "Capture", "Frames", "read_frames"]

#: The readers of python-can by suffix.
READERS = {
    ".asc": "ASCReader",
    ".blf": "BLFReader",
    ".log": "CanutilsLogReader",
    ".trc": "TRCReader",
    ".csv": "CSVReader",
    ".mf4": "MF4Reader",
}
#: The suffixes of captures. A file ``.log`` or ``.csv`` may also be something else.
CAPTURE_SUFFIXES = tuple(READERS)
#: Those of files that are not text.
BINARY = (".blf", ".mf4")
DATA_SIZE = 8
STANDARD_IDS = 1 << 11
EXTENDED_IDS = 1 << 29
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
        channel_names: The channels that occur.
        fault: What is wrong with the capture, or None.
    """

    time: npt.NDArray[np.float64]
    ids: npt.NDArray[np.uint32]
    sizes: npt.NDArray[np.uint8]
    data: npt.NDArray[np.uint8]
    channels: npt.NDArray[np.uint16] | None = None
    channel_names: tuple[str, ...] = ()
    fault: str | None = None


#: A path, an iterable of ``can.Message``, or the arrays ``(time, ids, sizes, data)`` as in `Frames`.
Capture = str | os.PathLike[str] | Iterable[Any] | tuple[Any, Any, Any, Any]


def read_frames(source: Capture) -> Frames:
    """Returns the frames of a capture.

    Raises:
        ImportError: The extra ``can`` is not installed.
        OSError: The file cannot be read.
        TypeError: The source is of the wrong type.
        ValueError: The file is no capture, or the arrays do not fit together.
    """
    if isinstance(source, str | os.PathLike):
        return _read_file(os.fsdecode(source))
    if isinstance(source, tuple) and len(source) == len(("time", "ids", "sizes", "data")):
        return _of_arrays(*source)
    if isinstance(source, bytes | bytearray | memoryview) or not isinstance(source, Iterable):
        raise TypeError(
            "a CAN capture is a path, an iterable of can.Message, or (timestamps, ids, dlcs, data), not "
            f"{type(source).__name__}"
        )
    return _of_messages(iter(source))


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


def _of_messages(messages: Iterator[Any]) -> Frames:
    """Reads messages of python-can; the fault is the error that ends them."""
    times, ids, sizes, channels = array("d"), array("I"), array("B"), array("H")
    data, names = bytearray(), dict[Any, int]()
    fault = None
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
                f"the capture cannot be read beyond frame {len(times):,} ({text}): it is damaged or "
                "truncated; the frames before are decoded"
            )
            break
        if not hasattr(message, "arbitration_id"):
            raise TypeError(f"a CAN capture has can.Message objects, not {type(message).__name__}")
        key = message.arbitration_id & (EXTENDED_IDS - 1)
        key |= _core.CAN_EXTENDED if message.is_extended_id else 0
        key |= _core.CAN_REMOTE if message.is_remote_frame else 0
        key |= _core.CAN_ERROR if message.is_error_frame else 0
        content = bytes(message.data)
        times.append(message.timestamp)
        ids.append(key)
        sizes.append(len(content))
        data += content[:DATA_SIZE].ljust(DATA_SIZE, b"\0")
        channels.append(names.setdefault(message.channel, min(len(names), np.iinfo(np.uint16).max)))
    return Frames(
        np.array(times, np.float64),
        np.array(ids, np.uint32),
        np.array(sizes, np.uint8),
        np.frombuffer(bytes(data), np.uint8).reshape(-1, DATA_SIZE),
        np.array(channels, np.uint16) if len(names) > 1 else None,
        tuple(map(str, names)),
        fault,
    )


def _read_file(path: str) -> Frames:
    can = require("can", "can", "to read CAN captures")
    is_gzip = path.lower().endswith(".gz")
    suffix = os.path.splitext(path[: -len(".gz")] if is_gzip else path)[1].lower()  # noqa: PTH122
    if suffix not in READERS or (is_gzip and suffix in BINARY):
        raise ValueError(
            f"{path} is no CAN capture; its suffix must be one of {', '.join(CAPTURE_SUFFIXES)}"
        )
    if suffix == ".mf4":
        require("asammdf", "can", "to read MF4 files")
    # The times of an ASC file count from its date, as those of the other formats.
    options = {"relative_timestamp": False} if suffix == ".asc" else {}
    with contextlib.ExitStack() as files, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the libraries, about the file
        file: Any = files.enter_context(gzip.open(path) if is_gzip else open(path, "rb"))  # noqa: PTH123, SIM115
        fault = _blf_fault(file) if suffix == ".blf" else None
        if suffix not in BINARY:
            file = files.enter_context(io.TextIOWrapper(file, "utf-8", "replace"))
        try:
            reader = getattr(can, READERS[suffix])(file, **options)
            frames = _of_messages(iter(reader))
        except (OSError, MemoryError):
            raise
        except Exception as error:
            raise ValueError(
                f"{path} is no {suffix} capture: {error or type(error).__name__}; check how it was made"
            ) from error
    return frames._replace(fault=frames.fault or fault)


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
