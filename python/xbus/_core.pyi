"""The compiled core. What users call is in the modules beside it; this is what those call."""

import os
from typing import Any, Literal, final

import numpy as np
import numpy.typing as npt

__all__ = [
    "Acquisition",
    "ArrowStream",
    "Column",
    "Decoder",
    "HostClock",
    "Part",
    "Reader",
    "Scanner",
    "__version__",
    "configuration",
    "damage_reasons",
    "device_id",
    "encode_frame",
    "encode_packet",
    "encode_samples",
    "message_name",
    "messages",
    "packets",
    "product_code",
    "products",
    "quantities",
    "result_codes",
    "status_flags",
    "strings",
]

__version__: str

def quantities() -> list[dict[str, Any]]:
    """The data identifiers, row by row: see `xbus.protocol.tables.Quantity`."""

def messages() -> list[dict[str, Any]]:
    """The messages, row by row: see `xbus.protocol.tables.MessageRow`."""

def products() -> list[dict[str, Any]]:
    """The products, row by row: see `xbus.protocol.tables.Product`."""

def status_flags() -> list[dict[str, Any]]:
    """The fields of the status word, row by row: see `xbus.protocol.tables.StatusFlag`."""

def strings() -> list[tuple[str, bytes]]:
    """The string outputs, in the order of their bits: name, and how it begins."""

def result_codes() -> list[tuple[int, str]]:
    """What the numbers in Error and Warning messages mean."""

def damage_reasons() -> list[str]:
    """Why bytes were refused, in the order of their numbers."""

def message_name(mid: int, length: int) -> str | None:
    """The manual's name of a message with a payload of this length, or None."""

def encode_frame(bid: int, mid: int, payload: bytes) -> bytes:
    """The frame that carries this message. Raises ValueError from 65536 bytes of payload on."""

def encode_packet(
    name: str,
    precision: str | None,
    coordinates: str | None,
    numbers: npt.NDArray[Any],
) -> bytes:
    """The packet that carries these numbers: a float32, float64, int64 or uint64 array ``(k,)``.

    Raises ValueError for what the encoder refuses, TypeError for another array.
    """

def encode_samples(
    packets: list[tuple[int, npt.NDArray[Any]]], bid: int
) -> tuple[bytes, npt.NDArray[np.uint64]]:
    """The frames of MTData2 messages that all have these packets, in one piece, and where each ends.

    A packet is a data identifier with its format bits and an array of the types that `encode_packet`
    takes, ``(n,)`` or ``(n, k)``: a row for each message. Raises as `encode_packet` does.
    """

def packets(
    payload: bytes,
) -> list[tuple[int, str | None, str | None, str | None, list[float | int] | bytes]]:
    """The packets of an MTData2 payload, up to one that runs past its end.

    Each is (data identifier, name, precision, coordinates, numbers in the order of the wire); one that
    the tables cannot explain has None for a name and its bytes for numbers.
    """

def configuration(payload: bytes) -> dict[str, Any] | None:
    """The fields of a Configuration payload, or None: see `xbus.protocol.configuration.Configuration`."""

def device_id(payload: bytes) -> int | None:
    """The device identifier of a DeviceID payload, or None."""

def product_code(payload: bytes) -> str | None:
    """The text of a ProductCode payload, or None."""

@final
class Scanner:
    """Bytes to messages, for input that comes in pieces."""

    def __new__(cls, limit: int, strings: int = 0) -> Scanner:
        """``strings`` are bits of `StringType`: those to look for that only their length tells from noise."""
    def feed(
        self, data: bytes, last: bool
    ) -> tuple[
        list[tuple[int, int, int, bytes] | tuple[int, int | None, bytes]],
        list[tuple[int, int, str]],
    ]:
        """What can be told now: messages (offset, bid, mid, payload) and strings, in order; and damage.

        A string is (offset, its place in `strings` or None, bytes), damage (offset, length, reason).
        """

@final
class HostClock:
    """Maps device time to host time: see `xbus.HostClock`."""

    def __new__(cls) -> HostClock: ...
    def copy(self) -> HostClock:
        """The same clock, which goes on by itself."""
    def update(self, time: float, arrival: int, leads: bool) -> float:
        """Takes in a sample (seconds; ns since 1970); its host time in seconds since 1970."""
    def update_many(
        self,
        time: npt.NDArray[np.float64],
        arrival: npt.NDArray[np.int64],
        leads: npt.NDArray[np.bool_],
    ) -> npt.NDArray[np.float64]:
        """Takes in samples, in contiguous arrays of one length; their host times."""
    def host_time(self, time: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Host times of device times, in a contiguous array."""
    @property
    def offset(self) -> float:
        """Host time less device time at the newest sample, in seconds."""
    @property
    def drift(self) -> float:
        """What the host's clock gains, in seconds per second."""
    @property
    def residual(self) -> float:
        """Mean seconds by which samples arrive later than the line."""
    @property
    def since(self) -> float:
        """Device time at which the fit began, in seconds."""
    @property
    def fits(self) -> int:
        """How many fits there were."""
    @property
    def steps(self) -> list[tuple[float, int, str]]:
        """The last steps: device time, arrival in ns, reason."""

@final
class Reader:
    """Reads a log step by step."""

    def __new__(
        cls,
        source: object,
        *,
        limit: int,
        strict: bool,
        wanted: list[tuple[str, str | None]] | None,
        strings: int = 0,
        part_bytes: int | None = None,
        fast: bool = True,
    ) -> Reader:
        """``source`` is a uint8 array, a path, or an object with a method ``read``.

        ``strings``: see `Scanner`. ``part_bytes`` is how much of it goes into a part, about; it decides how
        much room columns get.

        Raises OSError for a file that cannot be opened, ValueError for a quantity that does not exist.
        """
    @property
    def total(self) -> int | None:
        """Bytes of input, where that is known."""
    @property
    def position(self) -> int:
        """Bytes of input that have been read."""
    def advance(self, size: int) -> bool:
        """Reads about so many bytes more, without holding the interpreter; whether any are left.

        Raises DecodeError where strict, OSError, and whatever the source's ``read`` raises.
        """
    def take(self) -> Part:
        """What has been read since the last time."""

@final
class Decoder:
    """Decodes a log that is handed over piece by piece."""

    def __new__(
        cls, limit: int, wanted: list[tuple[str, str | None]] | None, strings: int = 0
    ) -> Decoder:
        """No frame may carry more than ``limit`` bytes of payload. ``strings``: see `Scanner`.

        Raises ValueError for a quantity that does not exist.
        """
    def feed(self, data: bytes) -> None:
        """Decodes what can be told with these bytes, without holding the interpreter."""
    def take(self) -> Part:
        """What has been decoded since the last time."""

@final
class Part:
    """A part of a log, or all of it. Arrays are read-only."""

    def __len__(self) -> int:
        """Number of samples."""
    @property
    def first(self) -> int:
        """Index of the first sample."""
    @property
    def columns(self) -> list[Column]:
        """The columns that have rows, in the order in which they were first seen."""
    @property
    def stats(self) -> dict[str, int]:
        """What was counted: see `xbus.log.Stats`."""
    @property
    def damage(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.uint8]]:
        """The damage that ends in this part: offset, length, place in `damage_reasons`."""
    @property
    def messages(
        self,
    ) -> tuple[
        npt.NDArray[np.uint8],
        npt.NDArray[np.uint8],
        npt.NDArray[np.int64],
        npt.NDArray[np.int64],
        npt.NDArray[np.uint64],
        npt.NDArray[np.uint8],
    ]:
        """The other messages: mid, bid, offset, sample, end of each payload, all payloads."""
    @property
    def strings(
        self,
    ) -> tuple[
        npt.NDArray[np.uint8],
        npt.NDArray[np.int64],
        npt.NDArray[np.int64],
        npt.NDArray[np.uint64],
        npt.NDArray[np.uint8],
    ]:
        """The string outputs: place in `strings` or 255, offset, sample, end of each, all bytes."""
    @property
    def time(self) -> npt.NDArray[np.float64]:
        """Per sample: seconds on the device clock, unwrapped; NaN where it carries none."""
    @property
    def packet_counter(self) -> npt.NDArray[np.int64]:
        """Per sample: the packet counter, unwrapped; -1 where it carries none."""
    @property
    def offset(self) -> npt.NDArray[np.int64]:
        """Per sample: where its frame begins, in bytes."""
    @property
    def end(self) -> npt.NDArray[np.int64]:
        """Per sample: where its frame ends, in bytes."""
    @property
    def bid(self) -> npt.NDArray[np.uint8]:
        """Per sample: the bus identifier of its frame."""

@final
class Column:
    """A column of a part. Arrays are read-only."""

    def __len__(self) -> int:
        """Number of rows."""
    @property
    def name(self) -> str | None:
        """Name of the quantity; None for an identifier that the tables cannot explain."""
    @property
    def coordinates(self) -> Literal["ENU", "NED", "NWU"] | None:
        """Coordinate system."""
    @property
    def data_id(self) -> int:
        """Data identifier as received; the base identifier where several were."""
    @property
    def precision(self) -> Literal["Float32", "Fp1220", "Fp1632", "Float64"] | None:
        """Precision of reals, if it is one."""
    @property
    def values(self) -> npt.NDArray[Any]:
        """The numbers, in one dimension and in the order of the wire; records and raw packets as uint8."""
    @property
    def entries(self) -> npt.NDArray[np.uint8]:
        """The entries of a list quantity, all of them, as bytes."""
    @property
    def ends(self) -> npt.NDArray[np.uint64] | None:
        """Where each raw packet ends in ``values``; None for other columns."""
    @property
    def nanoseconds(self) -> npt.NDArray[np.int64] | None:
        """UtcTime and GnssPvtData in ns since 1970; the least integer where there is no such date."""
    @property
    def sample(self) -> npt.NDArray[np.int64]:
        """Which sample each row belongs to."""

@final
class Acquisition:
    """A stream of bytes that is taken in by a thread without the interpreter, counted, queued, recorded.

    The thread reads a duplicate of a descriptor. Nothing about the original is changed, and it can be
    used for writing and for settings, but nobody else may read it. The port is free again once the
    stream has ended: after `close`, or after it was unplugged.

    What came waits in a queue until `read` takes it. When the queue is full the oldest pieces go, and are
    counted in ``dropped_bytes``; what is counted and recorded misses nothing.

    Arrivals are nanoseconds on the host's steady clock: on Unix that of `time.monotonic_ns`.
    """

    def __new__(cls, fd: int | None, *, bound: int = 24_000_000, strings: int = 0) -> Acquisition:
        """Begins to read.

        Args:
            fd: A descriptor, or None where there is none: then `push` what comes.
            bound: Most bytes in the queue; the default is 60 s at 4 Mbaud.
            strings: See `Scanner`.

        Raises:
            OSError: It cannot be read, or this system's ports have no descriptors.
        """
    def open(self, fd: int) -> None:
        """Goes on with another descriptor after the end, in the same queue, counts and recording.

        Raises:
            OSError: It cannot be read.
            RuntimeError: The stream has not ended.
        """
    def read(
        self, timeout: float | None = None, *, least: int = 1
    ) -> tuple[int, bytes, npt.NDArray[np.int64], npt.NDArray[np.int64]] | None:
        """Takes all that is queued; waits, without the interpreter, until there is enough.

        Args:
            timeout: Most seconds to wait; None for no limit. After it what there is is taken.
            least: How many bytes to wait for. More than half the queue's bound are not waited for. With more
                than one they may come a millisecond later, for less of the processor.

        Returns:
            Position of the first byte in the stream; the bytes; where each of the pieces in which they came
            ends in them ``(n,)``; when each had come, in ns ``(n,)``. A position behind the end of what was
            taken before says that the queue was full. None once the stream has ended and the queue is
            empty: `ended` says why.

        Raises:
            ValueError: The timeout is no number of seconds.
        """
    def push(self, data: bytes) -> bool:
        """Takes in bytes that have come just now; False if the stream has ended."""
    def resume(self) -> None:
        """Goes on after an end with what is pushed, in the same queue, counts and recording.

        Raises:
            RuntimeError: The stream has not ended.
        """
    def end(self, reason: str) -> None:
        """Ends the stream for a reason; what is queued can still be read."""
    @property
    def ended(self) -> str | None:
        """Why the stream has ended, or None."""
    @property
    def epoch(self) -> int:
        """What to add to an arrival for nanoseconds since 1970; the same for all of the stream."""
    def stats(self) -> dict[str, Any]:
        """What was counted of all that came, and how it goes.

        Keys: ``bytes``, ``frames``, ``samples``, ``messages``, ``malformed``, ``checksum_errors``,
        ``skipped_bytes``, ``lost_samples`` and ``gaps`` as in `xbus.log.Stats`; ``strings``, strings by name,
        empty for those that the manual does not list; ``quantities``, packets by data identifier with its
        format bits zero; ``errors`` and ``warnings``, how many came, and
        ``last_error``, the last of both in words or None; ``queued_bytes``, ``most_queued_bytes``,
        ``dropped_bytes`` of the queue; ``overruns``, how often the driver or its chip had no room for what
        came, None where nobody counts; ``last_arrival`` in ns, or None.
        """
    def record(
        self,
        path: str | os.PathLike[str],
        head: bytes = ...,
        flush: float = 0.5,
        fsync: bool = False,
        rotate_bytes: int | None = None,
        rotate_seconds: float | None = None,
        times: bool = True,
        *,
        overwrite: bool = False,
        bound: int = 24_000_000,
    ) -> None:
        """Records every byte from now on, beginning with the frame that is under way.

        A full disk, or one that is too slow for longer than its queue is deep, ends the recording with an
        error in `recording`; the file is good to its end in any case.

        Args:
            path: The first file; ``log.mtb`` is followed by ``log-0001.mtb`` and so on.
            head: Whole frames that each file begins with; nothing unless given.
            flush: Most seconds until what has come is written.
            fsync: Make the disk have it each time, so that it survives a power cut.
            rotate_bytes: Begin another file at the end of the frame with which one has so many bytes.
            rotate_seconds: The same by time.
            times: Write a file ``path + ".times"``: 24 bytes of header (``"XBUSTIME"``; as u32 the version,
                1, and the bytes of a record, 16; `epoch` as i64), then records ``("<u8", "<i8")``: so many
                bytes of the log had come by then, in ns since 1970. At most one in 10 ms, and the last.
            overwrite: Replace what is there. If not, a number that is taken is left out.
            bound: Most bytes that may wait for the disk.

        Raises:
            OSError: The file cannot be made, or its head does not fit.
            FileExistsError: It is there, and not empty.
            RuntimeError: A recording is under way.
            ValueError: A number makes no sense.
        """
    @property
    def recording(self) -> dict[str, Any] | None:
        """How the recording goes, or went until it is stopped; None if there is none.

        Keys: ``files``; ``bytes`` and ``frames`` received that are in them; ``queued_bytes``; ``active``;
        ``error``, why it ended by itself, or None.
        """
    def stop_recording(self) -> dict[str, Any] | None:
        """Writes what is queued, ends the recording, and says how it went, as `recording` does."""
    def close(self) -> None:
        """Ends the stream, its thread and the recording. What is queued can still be read."""

@final
class ArrowStream:
    """A table that is made, batch by batch, when a consumer of the Arrow C stream interface asks."""

    @staticmethod
    def wide(
        part: Part,
        columns: list[Column] | None = None,
        host: npt.NDArray[np.float64] | None = None,
    ) -> ArrowStream:
        """One row for each sample, these columns (or all) side by side.

        ``host`` has the host times of all samples. Raises ValueError if these are more or fewer.
        """
    @staticmethod
    def rows(column: Column, host: npt.NDArray[np.float64] | None = None) -> ArrowStream:
        """One row for each row of the column; for each entry, where it is a list. ``host`` as in `wide`."""
    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """The stream, in a capsule."""
