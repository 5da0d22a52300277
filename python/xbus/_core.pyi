"""The compiled core: an internal module. Users call the packages beside it, which call this."""

import os
from collections.abc import Callable, Sequence
from typing import Any, Literal, final, overload

import numpy as np
import numpy.typing as npt

__all__ = [
    "CAN_ERROR",
    "CAN_EXTENDED",
    "CAN_REMOTE",
    "EXTENDED_HEADER_SIZE",
    "PACKET_HEADER",
    "UTC_VALID",
    "Acquisition",
    "ArrowStream",
    "Batch",
    "BatchIterator",
    "Block",
    "BlockDecoder",
    "CanPart",
    "CanReader",
    "Cancel",
    "Chunk",
    "ClockStep",
    "Column",
    "DamageArrays",
    "EncodedFrames",
    "Events",
    "GapArrays",
    "HostClock",
    "MessageArrays",
    "MessageFile",
    "MtDataOutputs",
    "MtDataPlace",
    "MtDataSample",
    "Packet",
    "Part",
    "Reader",
    "ReceivedSample",
    "ReceivedString",
    "Recorder",
    "RequestScanner",
    "RestartArrays",
    "SampleClock",
    "ScannedDamage",
    "ScannedFrame",
    "ScannedString",
    "Scanner",
    "Shape",
    "StringArrays",
    "TableFile",
    "Waiting",
    "__version__",
    "can_messages",
    "can_quantities",
    "can_sample",
    "configuration",
    "damage_reasons",
    "device_id",
    "device_of",
    "encode_frame",
    "encode_mtdata",
    "encode_packet",
    "encode_samples",
    "frame_size",
    "is_sample",
    "keep_freed_memory",
    "legacy_products",
    "message_name",
    "messages",
    "mtdata_items",
    "mtdata_layout",
    "mtdata_packets",
    "mtdata_quantities",
    "mtssp",
    "packet_headers",
    "packet_numbers",
    "packets",
    "product_code",
    "products",
    "quantities",
    "result_codes",
    "status_flags",
    "strings",
    "tracker_ids",
]

__version__: str
#: Bytes of a frame before the payload, in the extended form (section 5.1).
EXTENDED_HEADER_SIZE: int
#: Bytes of a packet before its data (section 5.3.6).
PACKET_HEADER: int
#: The bits that mark date, time and UTC as valid (Tables 25 and 35). Higher bits may also be set.
UTC_VALID: int
#: The bits of a CAN identifier that mark 29 bits, a remote frame and an error frame, as in SocketCAN.
CAN_EXTENDED: int
CAN_REMOTE: int
CAN_ERROR: int

def quantities() -> list[dict[str, Any]]:
    """The data identifiers, row by row: see `xbus.protocol.tables.Quantity`."""

def can_quantities() -> list[dict[str, Any]]:
    """The quantities that only CAN has, row by row: see `xbus.protocol.tables.Quantity`."""

def mtdata_quantities() -> list[dict[str, Any]]:
    """The quantities that only MTData has, row by row: see `xbus.protocol.tables.Quantity`."""

def mtdata_items() -> list[dict[str, Any]]:
    """The items of MTData, row by row: see `xbus.protocol.mtdata.MtDataItem`."""

def can_messages() -> list[dict[str, Any]]:
    """The CAN messages, row by row: see `xbus.protocol.can.CanMessage`."""

def mtssp() -> dict[str, Any]:
    """The numbers of MTSSP by name: see `xbus.protocol.mtssp`."""

def messages() -> list[dict[str, Any]]:
    """The messages, row by row: see `xbus.protocol.tables.MessageRow`."""

def products() -> list[dict[str, Any]]:
    """The products, row by row: see `xbus.protocol.tables.Product`."""

def legacy_products() -> list[dict[str, Any]]:
    """The products before those of the manual, row by row: see `xbus.protocol.tables.Product`."""

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

def keep_freed_memory() -> None:
    """Makes the process keep freed memory, for work part by part.

    Otherwise the first touch of fresh memory is paid for in every part. No effect without glibc.
    """

def encode_frame(bid: int, mid: int, payload: bytes) -> bytes:
    """Returns the frame of a message.

    Raises:
        ValueError: The payload has more than 65535 bytes.
    """

def encode_packet(
    quantity: str,
    precision: str | None,
    coordinates: str | None,
    numbers: npt.NDArray[Any],
) -> bytes:
    """Returns the packet of a quantity.

    Args:
        quantity: Its name.
        precision: Name of a `Precision`; None for Float32, and for quantities of integers.
        coordinates: Name of a `Coordinates`; None for ENU, and for quantities without coordinates.
        numbers: A float32, float64, int64 or uint64 array ``(k,)``, in the order of the wire.

    Raises:
        TypeError: An array of another type.
        ValueError: No such quantity, or numbers that do not fit it.
    """

def encode_samples(packets: list[tuple[int, npt.NDArray[Any]]], bid: int) -> EncodedFrames:
    """Returns the frames of MTData2 messages that all have the same packets.

    Args:
        packets: For each packet its data identifier with format bits, and an array ``(n,)`` or ``(n, k)``
            of a type that `encode_packet` takes, with one row for each message.
        bid: Bus identifier.

    Raises:
        TypeError: An array of another type.
        ValueError: No such data identifier, or numbers that do not fit it.
    """

def mtdata_layout(mode: int, settings: int) -> list[MtDataPlace]:
    """Returns the items of an MTData payload, in the order of the wire: see `xbus.wire.mtdata.mtdata_layout`.

    Raises:
        OverflowError: ``mode`` does not fit 16 bits, or ``settings`` 32.
        ValueError: No source gives the layout of these settings.
    """

@final
class MtDataPlace:
    """Where an item is in an MTData payload."""

    @property
    def data_id(self) -> int:
        """Data identifier of the same numbers in MTData2, with format bits."""
    @property
    def name(self) -> str:
        """Name of its quantity."""
    @property
    def precision(self) -> str | None:
        """Name of its `Precision`; None for integers."""
    @property
    def coordinates(self) -> str | None:
        """Name of its `Coordinates`; None for a quantity without."""
    @property
    def start(self) -> int:
        """Where it begins in the payload."""
    @property
    def size(self) -> int:
        """Its bytes."""

def tracker_ids(payload: bytes) -> list[int]:
    """Returns the identifiers of the trackers that a Configuration lists, by BID from 1 on.

    Empty if it is not the Configuration of an Xbus Master that sends MTData.
    """

@final
class MtDataOutputs:
    """The settings of MTData in force in a stream of messages, with the rules of a log."""

    def __new__(cls, legacy: list[tuple[int, int]]) -> MtDataOutputs:
        """Starts with the settings of the caller: see `xbus.log.legacy.legacy_outputs`."""
    def message(self, bid: int, mid: int, payload: bytes) -> bool:
        """Handles a message other than MTData. Returns whether it changes the settings in force."""
    def output(self, bid: int) -> tuple[int, int] | None:
        """Returns OutputMode and OutputSettings of a device, if both are known."""
    def devices_of(self, bid: int) -> list[int]:
        """Returns the BIDs that messages of this BID are about: an Xbus Master speaks for its trackers."""
    def samples(self, bid: int, payload: bytes) -> list[MtDataSample] | None:
        """Returns the samples of an MTData message; None if it does not fit the settings in force.

        There is one, or with an Xbus Master one of each tracker.
        """

@final
class MtDataSample:
    """A sample of an MTData message."""

    @property
    def bid(self) -> int:
        """Bus identifier of the device."""
    @property
    def packets(self) -> list[Packet]:
        """Its items, as the packets that they would be in MTData2."""
    @property
    def stamps(self) -> bytes:
        """An MTData2 payload with those of them from which `SampleClock.sample` takes the time."""

def mtdata_packets(payload: bytes, mode: int, settings: int) -> list[Packet]:
    """Returns the items of an MTData payload, as the packets that they would be in MTData2.

    Raises:
        OverflowError: As `mtdata_layout`.
        ValueError: As `mtdata_layout`, or the payload does not have the length of these settings.
    """

def encode_mtdata(
    mode: int, settings: int, arrays: list[npt.NDArray[Any]], bid: int
) -> EncodedFrames:
    """Returns the frames of MTData messages.

    Args:
        mode: OutputMode.
        settings: OutputSettings.
        arrays: For each item of `mtdata_layout` an array ``(n,)`` or ``(n, k)`` of a type that
            `encode_packet` takes, with one row for each message.
        bid: Bus identifier.

    Raises:
        OverflowError: As `mtdata_layout`.
        TypeError: An array of another type.
        ValueError: As `mtdata_layout`, or numbers that do not fit an item.
    """

@final
class EncodedFrames:
    """Frames, one after another."""

    @property
    def data(self) -> bytes:
        """All frames, joined."""
    @property
    def ends(self) -> npt.NDArray[np.uint64]:
        """Where each frame ends in ``data``, ``(n,)``."""

def packets(payload: bytes) -> list[Packet]:
    """Returns the packets of an MTData2 payload, up to one that runs past its end."""

def packet_headers(payload: bytes) -> bytes:
    """Returns the identifier (2 bytes), size (1) and whether the tables explain it (1) of each packet."""

def packet_numbers(data_id: int, data: bytes) -> Any:
    """Returns the numbers of one packet.

    Returns:
        An array ``(k,)`` for a vector of real numbers, float32 or float64; a list of numbers otherwise.

    Raises:
        ValueError: The tables do not explain a packet of this identifier and size.
    """

@final
class Packet:
    """One packet of an MTData2 message."""

    @property
    def data_id(self) -> int:
        """Data identifier as received."""
    @property
    def name(self) -> str | None:
        """Name of the quantity; None for a packet that the tables do not explain."""
    @property
    def precision(self) -> str | None:
        """Name of the `Precision` of real numbers; None for others."""
    @property
    def coordinates(self) -> str | None:
        """Name of the `Coordinates`; None for quantities without."""
    @property
    def numbers(self) -> list[Any] | bytes:
        """Numbers in the order of the wire; the bytes of a packet that the tables do not explain."""

def configuration(payload: bytes) -> dict[str, Any] | None:
    """The fields of a Configuration payload, or None: see `xbus.protocol.configuration.Configuration`."""

def device_id(payload: bytes) -> int | None:
    """The device identifier of a DeviceID payload, or None."""

@overload
def device_of(bid: int) -> int: ...
@overload
def device_of(bid: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """The bus identifier by which a device is counted: 1 for FF, which is the same device."""

def frame_size(head: bytes) -> int | None:
    """Bytes of the frame that begins with these, checksum included; None if the header is incomplete."""

def is_sample(payload: bytes) -> bool:
    """Whether an MTData2 payload has packets, and they fill it."""

def product_code(payload: bytes) -> str | None:
    """The text of a ProductCode payload, or None."""

@final
class SampleClock:
    """The clocks of devices: times of samples by the rules by which a log has them."""

    def __new__(cls, rate: float | None = None) -> SampleClock:
        """Creates the clocks.

        Args:
            rate: Rate of the packet counter in Hz, which gives a time to samples without time stamps.
        """
    def message(self, bid: int, mid: int, payload: bytes) -> None:
        """Handles a message that is not a sample: it may name the device, or start a new run."""
    def sample(self, bid: int, payload: bytes) -> tuple[float, bool]:
        """The time of the next sample, and whether it leads the clock.

        Returns:
            Seconds on the device clock, unwrapped, NaN without a time stamp; and False for samples of the
            GNSS receiver and of triggers, which come later than they were taken.
        """

@final
class Scanner:
    """Finds the frames and strings of an input that is pushed in pieces."""

    def __new__(cls, limit: int, strings: int = 0) -> Scanner:
        """Creates a scanner at the beginning of an input.

        Args:
            limit: Longest payload of a frame, in bytes.
            strings: Bits of `StringType` of the strings to look for that have no checksum.
        """
    def feed(self, data: bytes, last: bool) -> list[ScannedFrame | ScannedString | ScannedDamage]:
        """Returns all that can be decided with these bytes, in order.

        Args:
            data: The next bytes of the input.
            last: Whether the input ends with them.
        """

@final
class RequestScanner:
    """Finds the requests in the bytes of a host, by their checksums alone. Input is pushed in pieces."""

    def __new__(cls, limit: int) -> RequestScanner:
        """Creates a scanner that skips headers with more than ``limit`` bytes of payload."""
    def feed(self, data: bytes, last: bool) -> list[ScannedFrame]:
        """Returns the requests that ``data`` completes.

        Args:
            data: The next bytes.
            last: Whether no byte that completes a frame follows: incomplete frames are skipped.
        """
    @property
    def is_waiting(self) -> bool:
        """Whether a frame has begun that is not complete."""

@final
class ScannedFrame:
    """A frame that a scanner found."""

    @property
    def offset(self) -> int:
        """Where it begins, in bytes from the start of the input."""
    @property
    def bid(self) -> int:
        """Bus identifier."""
    @property
    def mid(self) -> int:
        """Message identifier."""
    @property
    def payload(self) -> bytes:
        """Its data."""

@final
class ScannedString:
    """A string output that a scanner found."""

    @property
    def offset(self) -> int:
        """Where it begins, in bytes from the start of the input."""
    @property
    def place(self) -> int | None:
        """Its index in `strings`; None for one that the manual does not list."""
    @property
    def data(self) -> bytes:
        """Its bytes, including the end of its line."""

@final
class ScannedDamage:
    """A stretch of bytes that is neither frame nor string."""

    @property
    def offset(self) -> int:
        """Where it begins, in bytes from the start of the input."""
    @property
    def length(self) -> int:
        """Its bytes."""
    @property
    def reason(self) -> str:
        """One of `damage_reasons`: what was wrong where it begins."""

@final
class HostClock:
    """Maps device time to host time: see `xbus.HostClock`."""

    def __new__(cls, state: bytes | None = None) -> HostClock:
        """Creates a clock without samples, or the one whose state `pickle` saved."""
    def __reduce__(self) -> tuple[type[HostClock], tuple[bytes]]: ...
    def copy(self) -> HostClock:
        """Returns an independent copy."""
    def update(self, time: float, arrival: int, leads: bool) -> float:
        """Adds a sample and returns its host time, in seconds since 1970.

        Args:
            time: Seconds on the device clock.
            arrival: Nanoseconds since 1970.
            leads: Whether the sample moves the clock.
        """
    def update_many(
        self,
        time: npt.NDArray[np.float64],
        arrival: npt.NDArray[np.int64],
        leads: npt.NDArray[np.bool_],
    ) -> npt.NDArray[np.float64]:
        """Adds samples, in contiguous arrays ``(n,)``, and returns their host times ``(n,)``."""
    def host_time(self, time: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Returns the host times ``(n,)`` of device times ``(n,)``, a contiguous array."""
    @property
    def offset(self) -> float:
        """Host time minus device time at the newest sample, in seconds."""
    @property
    def drift(self) -> float:
        """Seconds per second that the host's clock gains."""
    @property
    def residual(self) -> float:
        """Mean seconds by which samples arrive later than the line."""
    @property
    def since(self) -> float:
        """Device time at which the fit began, in seconds."""
    @property
    def fits(self) -> int:
        """Number of fits."""
    @property
    def steps(self) -> list[ClockStep]:
        """The last steps."""

@final
class ClockStep:
    """A step of one of the clocks."""

    @property
    def time(self) -> float:
        """Device time of the first sample after it, in seconds."""
    @property
    def arrival(self) -> int:
        """Arrival of that sample, in ns since 1970."""
    @property
    def reason(self) -> str:
        """What happened, in words."""

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
        rate: float | None = None,
        threads: int = 1,
        values: bool = True,
        fast: bool = True,
        legacy: list[tuple[int, int]] = ...,
        state: bytes | None = None,
        check: Callable[[bytes], None] | None = None,
    ) -> Reader:
        """Opens a log.

        Args:
            source: Bytes, a uint8 array, a path, or an object with a method ``read``.
            limit: Longest payload of a frame, in bytes.
            strict: Raise at the first damage.
            wanted: Quantities to keep, with a coordinate system or None for all of them; None for all
                quantities.
            strings: See `Scanner`.
            part_bytes: Approximate bytes of input in a part. Decides how much memory columns reserve.
            rate: Rate of the packet counter in Hz, from which samples without time stamps get their time.
            threads: Number of threads for arrays and files.
            values: Keep values. Otherwise only rows are counted, which is enough for `Shape.add`.
            fast: Use the fast path. False is for tests.
            legacy: Settings of MTData that the caller knows: see `xbus.log.legacy.legacy_outputs`.
            state: `state` of another reader, which goes on from there; None for the start. A file object
                stands there already.
            check: Called with the first bytes of a file object or pipe, when they are read. What it raises
                is passed on.

        Raises:
            OSError: The file cannot be opened.
            ValueError: No such quantity, or a state of another version of xbus.
        """
    @property
    def can_split(self) -> bool:
        """Whether a part can end here from which another reader goes on: not in the middle of damage."""
    @property
    def state(self) -> bytes | None:
        """What the reader remembers after `take`; None if a part cannot end here (`can_split`)."""
    @property
    def total(self) -> int | None:
        """Bytes of input; None if that is not known."""
    @property
    def position(self) -> int:
        """Bytes of input that have been read."""
    def advance(self, size: int) -> bool:
        """Reads about ``size`` bytes more, without the GIL; returns whether any are left.

        Raises:
            DecodeError: Damage, in strict mode.
            OSError: The file cannot be read. An exception of the source's ``read`` is passed on.
        """
    def take(self) -> Part:
        """Returns what has been read since the last call."""
    def take_last(self, shape: Shape | None = None) -> Part:
        """Returns what has been read since the last call. The reader cannot be used afterwards.

        Its times are computed when they are needed; `take` computes them for the next part.

        Args:
            shape: Shape of the whole log, or None if the part stays as it is.

        Raises:
            ValueError: The log of this shape has no such columns.
        """

@final
class Shape:
    """The columns of a log without their values, which give each part the columns of its whole log."""

    def __new__(cls, state: bytes | None = None) -> Shape:
        """Creates the shape of an empty log, or restores the one whose state `pickle` saved.

        Raises:
            ValueError: Another version of xbus saved the state, or it is damaged.
        """
    def __reduce__(self) -> tuple[type[Shape], tuple[bytes]]: ...
    def __eq__(self, value: object, /) -> bool: ...
    def add(self, part: Part) -> None:
        """Adds the part that follows those that were added before."""
    def of_wanted(self, wanted: list[tuple[str, str | None]]) -> Shape:
        """Returns the shape with these quantities, and those that clocks and counters need."""
    def of_device(self, device: Shape) -> Shape:
        """Returns the shape of one device, whose samples alone have the shape ``device``."""
    def empty(self) -> Part:
        """Returns a part without samples, with the columns of the log."""

@final
class CanReader:
    """Groups CAN frames to samples, and decodes them. The samples do not depend on how frames are divided.

    Args:
        entries: Identifier, bus identifier of the device, and code of each message.
        rate: Groups per second of devices without SampleTime, in Hz.

    Raises:
        ValueError: An identifier is out of range or stands for two messages, or a code does not exist.
    """

    def __new__(
        cls, entries: Sequence[tuple[int, int, int]], rate: float | None = None
    ) -> CanReader: ...
    def push(
        self,
        times: npt.NDArray[np.float64],
        ids: npt.NDArray[np.uint32],
        sizes: npt.NDArray[np.uint8],
        data: npt.NDArray[np.uint8],
        *,
        end: bool,
    ) -> CanPart:
        """Adds frames, and returns the samples that are complete.

        A sample is complete when the next one of its device begins, and all samples that began before it are.

        Args:
            times: When each frame was received, in seconds, ``(n,)``.
            ids: The identifier of each, ``(n,)``, with the marks of `CAN_EXTENDED` and the others.
            sizes: Bytes of data of each, ``(n,)``.
            data: The data, ``(n, 8)``, contiguous.
            end: Whether no frames follow: all samples are complete.

        Raises:
            ValueError: The arrays do not fit together.
        """

def can_sample(payload: bytes, bid: int, offset: int) -> Part:
    """Returns a part with one sample of a CAN bus: see `Acquisition.can` for its payload.

    Raises:
        ValueError: The payload is not of frames.
    """

@final
class CanPart:
    """Samples of CAN frames, from `CanReader.push`."""

    @property
    def part(self) -> Part: ...
    @property
    def verdicts(self) -> npt.NDArray[np.uint8]:
        """What became of each new frame, ``(n,)``: see `xbus.can.traffic.Verdict`."""
    @property
    def received(self) -> npt.NDArray[np.float64]:
        """When the first frame of each sample was received, in seconds, ``(m,)``."""

@final
class Part:
    """A part of a log, or all of it. Arrays are read-only."""

    def __new__(cls, state: bytes) -> Part:
        """Restores the part whose state `pickle` saved.

        Raises:
            ValueError: Another version of xbus saved the state, or it is damaged.
        """
    def __reduce__(self) -> tuple[type[Part], tuple[bytes]]: ...
    def shaped(self, shape: Shape) -> Part:
        """Returns the part with the columns of its log: those that it lacks have no rows.

        Raises:
            ValueError: The part has a column that the log does not have.
        """
    def of_device(self, bid: int, first: int, shape: Shape | None = None) -> Part:
        """Returns the samples and messages of one device.

        Args:
            bid: BID of the device.
            first: Index of its first sample.
            shape: As for `Reader.take`.
        """
    def only(self, column: Column) -> Part:
        """Returns the same samples and times with one of the columns, and nothing else."""
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
        """Counts: see `xbus.Stats`."""
    @property
    def damage(self) -> DamageArrays:
        """The damage that ends in this part."""
    @property
    def messages(self) -> MessageArrays:
        """The messages that are not samples."""
    @property
    def strings(self) -> StringArrays:
        """The string outputs."""
    @property
    def time(self) -> npt.NDArray[np.float64]:
        """Seconds on the device clock, unwrapped, ``(n,)``; NaN for samples without a time stamp."""
    @property
    def time_span(self) -> tuple[float, float, int, bool]:
        """The earliest and the latest time, how many samples have one, and whether all have and they ascend.

        The times are NaN if no sample has one.
        """
    @property
    def gaps(self) -> GapArrays:
        """The places where samples are missing, by the packet counters."""
    @property
    def restarts(self) -> RestartArrays:
        """The first sample of each run of a device, other than its first run."""
    @property
    def has_counter(self) -> bool:
        """Whether a sample has a packet counter, without which losses are not known."""
    @property
    def utc(self) -> npt.NDArray[np.int64] | None:
        """Valid UTC of each sample in ns since 1970, ``(n,)``, or -2^63; None if no column has UTC."""
    @property
    def packet_counter(self) -> npt.NDArray[np.int64]:
        """The packet counter, unwrapped, ``(n,)``; -1 for samples without one."""
    @property
    def offset(self) -> npt.NDArray[np.int64]:
        """Where the frame of each sample begins, in bytes from the start of the input, ``(n,)``."""
    @property
    def end(self) -> npt.NDArray[np.int64]:
        """Where the frame of each sample ends, in bytes from the start of the input, ``(n,)``."""
    @property
    def bid(self) -> npt.NDArray[np.uint8]:
        """Bus identifier of each sample, ``(n,)``."""
    @property
    def devices(self) -> list[tuple[int, int]]:
        """The BID of the first sample of each device, and its number of samples, in the order of these."""

@final
class DamageArrays:
    """Stretches of bytes that are neither frame nor string. Arrays are read-only."""

    @property
    def offset(self) -> npt.NDArray[np.int64]:
        """Where each begins, in bytes from the start of the input, ``(n,)``."""
    @property
    def length(self) -> npt.NDArray[np.int64]:
        """Bytes of each, ``(n,)``."""
    @property
    def reason(self) -> npt.NDArray[np.uint8]:
        """Index in `damage_reasons` of each, ``(n,)``."""

@final
class GapArrays:
    """Places where samples are missing. Arrays are read-only."""

    @property
    def sample(self) -> npt.NDArray[np.int64]:
        """Index of the sample after each, ``(n,)``."""
    @property
    def lost(self) -> npt.NDArray[np.int64]:
        """Samples that are missing at each, ``(n,)``."""
    @property
    def bid(self) -> npt.NDArray[np.uint8]:
        """Bus identifier of the device, ``(n,)``."""

@final
class RestartArrays:
    """Places where a device starts a new run. Arrays are read-only."""

    @property
    def sample(self) -> npt.NDArray[np.int64]:
        """Index of the next sample of any device, ``(n,)``."""
    @property
    def bid(self) -> npt.NDArray[np.uint8]:
        """Bus identifier of the device, ``(n,)``."""

@final
class MessageArrays:
    """Messages that are not samples. Arrays are read-only."""

    @property
    def mid(self) -> npt.NDArray[np.uint8]:
        """Message identifiers, ``(n,)``."""
    @property
    def bid(self) -> npt.NDArray[np.uint8]:
        """Bus identifiers, ``(n,)``."""
    @property
    def offset(self) -> npt.NDArray[np.int64]:
        """Where each frame begins, in bytes from the start of the input, ``(n,)``."""
    @property
    def sample(self) -> npt.NDArray[np.int64]:
        """Index of the next sample, ``(n,)``."""
    @property
    def ends(self) -> npt.NDArray[np.uint64]:
        """Where each payload ends in ``payloads``, ``(n,)``."""
    @property
    def payloads(self) -> npt.NDArray[np.uint8]:
        """All payloads, joined."""

@final
class StringArrays:
    """String outputs. Arrays are read-only."""

    @property
    def place(self) -> npt.NDArray[np.uint8]:
        """Index in `strings` of each, 255 for one that the manual does not list, ``(n,)``."""
    @property
    def offset(self) -> npt.NDArray[np.int64]:
        """Where each begins, in bytes from the start of the input, ``(n,)``."""
    @property
    def sample(self) -> npt.NDArray[np.int64]:
        """Index of the next sample, ``(n,)``."""
    @property
    def ends(self) -> npt.NDArray[np.uint64]:
        """Where each ends in ``data``, ``(n,)``."""
    @property
    def data(self) -> npt.NDArray[np.uint8]:
        """All strings, joined."""

@final
class Column:
    """A column of a part. Arrays are read-only."""

    def __len__(self) -> int:
        """Number of rows."""
    @property
    def name(self) -> str | None:
        """Name of the quantity; None for an identifier that the tables do not explain."""
    @property
    def coordinates(self) -> Literal["ENU", "NED", "NWU"] | None:
        """Coordinate system; None for quantities without."""
    @property
    def data_id(self) -> int:
        """Data identifier as received; the base identifier if packets had several."""
    @property
    def precision(self) -> Literal["Float32", "Fp1220", "Fp1632", "Float64"] | None:
        """Precision of real numbers; None for others and if packets had several."""
    @property
    def values(self) -> npt.NDArray[Any]:
        """The numbers, in one dimension and in the order of the wire; records and raw packets as uint8."""
    @property
    def entries(self) -> npt.NDArray[np.uint8]:
        """The entries of a list quantity as bytes, those of all rows joined."""
    @property
    def ends(self) -> npt.NDArray[np.uint64] | None:
        """Where each raw packet ends in ``values``, ``(n,)``; None for other columns."""
    @property
    def nanoseconds(self) -> npt.NDArray[np.int64] | None:
        """UtcTime and GnssPvtData in ns since 1970, ``(n,)``; the least int64 for a date that does not exist.

        None for other columns.
        """
    @property
    def sample(self) -> npt.NDArray[np.int64]:
        """Index of the sample of each row, ``(n,)``."""

@final
class Acquisition:
    """Receives a stream of bytes in its own thread, without the GIL; scans, counts, queues and records it.

    The thread reads a duplicate of a descriptor. The original stays as it is, and can be used for writing and
    for settings, but must not be read. The port is free again once the stream has ended: after `close`, or
    after it was unplugged.

    Samples, strings and events (messages and damage) wait in three lanes until they are taken. When a lane is
    full its oldest entries are dropped and counted in ``stats``; counts and recordings are complete in any
    case. Bytes that may be part of an incomplete frame wait for the rest of it.

    Arrivals are seconds on the clock of the stream: that of `time.monotonic` for a port. All methods may be
    called from any thread. In a forked process the stream has ended.
    """

    def __new__(
        cls,
        fd: int | None,
        *,
        bid: int = 255,
        bound: int = 24_000_000,
        strings: int = 0,
        epoch: int | None = None,
    ) -> Acquisition:
        """Starts to read.

        Args:
            fd: A descriptor; None for a stream that is passed to `push`.
            bid: Bus identifier of the device whose frames are handed out, 255 for all. All are counted.
            bound: Most bytes in each lane; the default is 60 s at 4 Mbaud.
            strings: See `Scanner`.
            epoch: Nanoseconds to add to an arrival for ns since 1970; None for the clock `time.monotonic`.

        Raises:
            OSError: The descriptor cannot be read, or ports of this system have none.
        """
    def open(self, fd: int) -> None:
        """Continues with another descriptor after the end, in the same lanes, counts and recording.

        Raises:
            OSError: The descriptor cannot be read.
            RuntimeError: The stream has not ended.
        """
    def push(self, data: bytes, arrival: float | None = None) -> bool:
        """Adds bytes that arrived at ``arrival``, or now; returns False if the stream has ended."""
    @staticmethod
    def can(
        entries: Sequence[tuple[int, int, int]],
        *,
        rate: float | None = None,
        bid: int = 255,
        bound: int = 24_000_000,
        epoch: int | None = None,
    ) -> Acquisition:
        """Returns an acquisition of the frames of a CAN bus, which `push_can` adds, instead of bytes.

        The payload of a sample has nine bytes for each frame: the code of the message, and its data with
        padding. Its arrival is that of its first frame.

        Args:
            entries: Identifier, bus identifier of the device, and code of each message.
            rate: Groups per second of devices without SampleTime, in Hz.
            bid: The device whose samples are handed out, 255 for all. All are counted.
            bound: As for a stream of bytes.
            epoch: As for a stream of bytes.

        Raises:
            ValueError: An identifier is out of range or stands for two messages, or a code does not exist.
        """
    @property
    def is_can(self) -> bool:
        """Whether it receives the frames of a CAN bus."""
    def push_can(
        self,
        times: npt.NDArray[np.float64],
        ids: npt.NDArray[np.uint32],
        sizes: npt.NDArray[np.uint8],
        data: npt.NDArray[np.uint8],
        now: float | None = None,
    ) -> tuple[npt.NDArray[np.uint8], int] | None:
        """Adds frames of a CAN bus.

        Args:
            times: When each was received, in seconds since 1970, ``(n,)``.
            ids: As for `CanReader.push`, like the next two.
            sizes: Bytes of data of each, ``(n,)``.
            data: The data, ``(n, 8)``, contiguous.
            now: When they arrive, on the clock of the stream; None for now.

        Returns:
            What became of each frame, as in `xbus.can.traffic.Verdict`, and the number of samples that are
            complete with them. None if the stream has ended.

        Raises:
            ValueError: The arrays do not fit together.
        """
    def give_outputs(self, legacy: list[tuple[int, int]]) -> None:
        """Decodes MTData with settings of the caller until the stream has others: see `MtDataOutputs`."""
    def note_request(self, bid: int, mid: int, payload: bytes) -> None:
        """Handles a request before it is sent: its acknowledgement may change the layout of MTData."""
    def resume(self) -> None:
        """Continues after the end with what is pushed, in the same lanes, counts and recording.

        Raises:
            RuntimeError: The stream has not ended.
        """
    def count_bus(self, *, overruns: int = 0, transfer_errors: int = 0) -> None:
        """Adds to the counts of an I²C or SPI bus, which are None in ``stats`` before the first call."""
    def interrupt(self) -> None:
        """Decides the bytes of an incomplete frame, of which no more will come: they are damage."""
    def end(self, reason: str) -> None:
        """Ends the stream; what waits can still be taken."""
    @property
    def ended(self) -> str | None:
        """Why the stream has ended; None if it has not."""
    @property
    def epoch(self) -> int:
        """Nanoseconds to add to an arrival for ns since 1970; the same for all of the stream."""
    @property
    def bid(self) -> int:
        """Bus identifier of the device whose frames are handed out; 255 for all."""
    def wait(
        self,
        timeout: float,
        *,
        samples: int | None = None,
        strings: bool = False,
        events: int | None = None,
        cancel: Cancel | None = None,
    ) -> bool:
        """Waits, without the GIL, for one of what the arguments name, or for the end of the stream.

        Any number of threads may wait; each is woken for what it needs.

        Args:
            timeout: Most seconds to wait.
            samples: Wait until this number of samples waits to be taken, or as many as fit. With more than
                one they may arrive a millisecond later, which costs less CPU time.
            strings: Wait until a string waits to be taken.
            events: Wait until more events were added than this number: see `take_events`.
            cancel: `cancel` with the same object ends the wait.

        Returns:
            Whether the wait ended before its time.

        Raises:
            ValueError: The timeout is not a number of seconds.
        """
    def cancel(self, cancel: Cancel) -> None:
        """Ends all waits with this object, those to come included."""
    @property
    def waiting(self) -> Waiting:
        """What waits to be taken."""
    def take_sample(self) -> ReceivedSample | None:
        """Takes the oldest sample; None if none waits."""
    def take_string(self) -> ReceivedString | None:
        """Takes the oldest string; None if none waits."""
    def take_events(self, *, early: bool = False) -> Events:
        """Takes all messages that are not samples, and all damage.

        Args:
            early: Whether to return also messages among the bytes that may still be part of a longer frame.
                Each message is returned once.
        """
    def mark_data(self) -> None:
        """Adds an event before the next sample or string, as happens after each message."""
    def block_decoder(self, wanted: list[tuple[str, str | None]] | None = None) -> BlockDecoder:
        """Returns a decoder for `take_block`, which counts samples from its first block on.

        Args:
            wanted: Quantities to keep, as for `Reader`.

        Raises:
            ValueError: No such quantity.
        """
    def take_block(self, decoder: BlockDecoder, samples: int | None = None) -> Block | None:
        """Takes and decodes samples and the strings between them, without the GIL.

        Args:
            decoder: The decoder of the blocks before.
            samples: How many; None if fewer wait. Without a number, all that wait.
        """
    def take_all(self) -> list[ScannedFrame | ScannedString | ScannedDamage] | None:
        """Takes everything that waits, in order; None once nothing waits and the stream has ended."""
    def clear_data(self) -> int:
        """Removes the samples and strings that wait; returns their number. They do not count as dropped."""
    def stats(self, now: float) -> dict[str, Any]:
        """Returns counts of all that was received, and the state of the lanes.

        Args:
            now: The time on the clock of the stream.

        Returns:
            ``counts``, a dict with ``bytes``, ``frames``, ``samples``, ``messages``, ``malformed``,
            ``checksum_errors`` and ``skipped_bytes`` as in `xbus.Stats`; ``mids``, messages by their
            identifier; ``losses``, a dict with ``samples`` and ``gaps``; ``strings``, strings by name, empty
            for those that the manual does not list; ``quantities``, packets by data identifier without
            format bits; ``errors`` and ``warnings``, the number of these messages, and ``last_error``, the
            last of them in words or None.
            ``rates``, a dict with ``quantities``, ``strings`` and ``mids`` in Hz, over the last two seconds.
            ``queued``, bytes that wait, and ``unread``, samples that wait; ``dropped``, a dict with the
            ``samples``, ``strings`` and ``messages`` that were dropped unread; ``last_arrival`` in ns, or
            None; ``overruns``, how often the driver or its chip had no room for a byte, None if the system
            does not count them.
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
    ) -> Recorder:
        """Records every byte from now on, beginning with the frame that is incomplete now.

        A full disk, or a disk that is too slow for longer than the queue can hold, ends the recording with
        an error in `Recorder.state`; the file is readable to its end in any case.

        Args:
            path: The first file; ``log.mtb`` is followed by ``log-0001.mtb`` and so on.
            head: Whole frames that each file begins with.
            flush: Most seconds until received bytes are written.
            fsync: Make the disk store the bytes each time, so that they survive a power cut.
            rotate_bytes: Start another file at the end of the frame with which one has this many bytes.
            rotate_seconds: Start another file at the end of the frame with which one has lasted so long.
            times: Write a file ``path + ".times"``: a header of 24 bytes (``"XBUSTIME"``; as u32 the version,
                1, and the size of a record, 16; `epoch` as i64), then records ``("<u8", "<i8")``: a number of
                bytes of the log, and when they had arrived, in ns since 1970. At most one in 10 ms, and the
                last.
            overwrite: Replace existing files. If False, numbers that exist are skipped.
            bound: Most bytes that wait for the disk.

        Raises:
            OSError: The file cannot be created, or its head does not fit.
            FileExistsError: The file exists and is not empty.
            RuntimeError: A recording is in progress.
            ValueError: A number is out of range.
        """
    @property
    def recording(self) -> Recorder | None:
        """The recording in progress; None if there is none."""
    def close(self) -> None:
        """Ends the stream, its thread and the recording. What waits can still be taken."""

@final
class Recorder:
    """A recording of an `Acquisition`, also after it has ended."""

    @property
    def state(self) -> dict[str, Any]:
        """Its state.

        Keys: ``files``; received ``bytes``, ``frames``, ``samples`` and ``strings`` that are in them, and
        ``message_counts`` of other messages by message identifier; ``queued_bytes``; ``active``; ``error``,
        why it failed, or None.
        """
    def stop(self) -> dict[str, Any]:
        """Ends it with the last whole frame, and returns its last state. A forked process does nothing."""

@final
class Cancel:
    """Ends waits of `Acquisition.wait`."""

    def __new__(cls) -> Cancel: ...
    @property
    def is_set(self) -> bool:
        """Whether it was used."""

@final
class Waiting:
    """What waits to be taken from an `Acquisition`."""

    @property
    def samples(self) -> int:
        """Number of samples."""
    @property
    def strings(self) -> int:
        """Number of strings."""
    @property
    def events_added(self) -> int:
        """Number of events that were ever added."""
    @property
    def last_sample(self) -> float | None:
        """When the newest sample arrived, taken or not; None before the first."""
    @property
    def last_arrival(self) -> float | None:
        """When the newest bytes arrived; None before the first."""
    @property
    def dropped_samples(self) -> int:
        """Number of samples dropped unread."""

@final
class Events:
    """Messages and damage from an `Acquisition`."""

    @property
    def items(self) -> list[ScannedFrame | ScannedDamage | None]:
        """The events in order; None stands for the first sample or string after a message."""
    @property
    def added(self) -> int:
        """Number of events that were ever added."""

@final
class ReceivedSample:
    """A sample from an `Acquisition`."""

    @property
    def offset(self) -> int:
        """Where its frame begins, in bytes from the start of the stream."""
    @property
    def bid(self) -> int:
        """Bus identifier."""
    @property
    def payload(self) -> bytes:
        """Its packets, or items of MTData."""
    @property
    def output(self) -> tuple[int, int] | None:
        """OutputMode and OutputSettings of MTData; None for MTData2."""
    @property
    def time(self) -> float:
        """Seconds on the device clock, unwrapped; NaN without a time stamp."""
    @property
    def leads(self) -> bool:
        """Whether it arrived when it was measured."""
    @property
    def arrival(self) -> float:
        """When its last byte arrived, in seconds on the clock of the stream."""
    @property
    def host_time(self) -> float:
        """When it was measured, in seconds since 1970 on the clock of the host; NaN if that is not known."""

@final
class ReceivedString:
    """A string from an `Acquisition`."""

    @property
    def offset(self) -> int:
        """Where it begins, in bytes from the start of the stream."""
    @property
    def place(self) -> int | None:
        """Its index in `strings`; None for one that the manual does not list."""
    @property
    def data(self) -> bytes:
        """Its bytes, including the end of its line."""
    @property
    def arrival(self) -> float:
        """When its last byte arrived, in seconds on the clock of the stream."""

@final
class BlockDecoder:
    """Decodes the blocks of an `Acquisition`, which makes it."""

@final
class Block:
    """Samples of an `Acquisition`, and the strings between them. Arrays are read-only."""

    @property
    def part(self) -> Part:
        """The samples and strings as a part of a log."""
    @property
    def host_time(self) -> npt.NDArray[np.float64]:
        """Seconds since 1970 of each sample, NaN if not known, ``(n,)``."""
    @property
    def string_time(self) -> npt.NDArray[np.float64]:
        """Seconds since 1970 at which each string arrived, ``(n,)``."""
    @property
    def clocks(self) -> list[tuple[int, HostClock]]:
        """The clock of the host for each device, by bus identifier."""

@final
class ArrowStream:
    """A table whose batches are made when a consumer of the Arrow C stream interface asks for them."""

    @staticmethod
    def wide(
        part: Part,
        columns: list[Column] | None = None,
        host: npt.NDArray[np.float64] | None = None,
        raw: bool = False,
    ) -> ArrowStream:
        """Returns a table with one row for each sample.

        Args:
            part: The part of a log.
            columns: Columns of this part; None for all.
            host: Host times of all samples, seconds since 1970, ``(n,)``: a column ``host_time``.
            raw: Fields of records as integers, as on the wire, instead of in their units.

        Raises:
            ValueError: Columns of another part, or not one host time for each sample.
        """
    @staticmethod
    def rows(
        column: Column, host: npt.NDArray[np.float64] | None = None, raw: bool = False
    ) -> ArrowStream:
        """Returns a table with one row for each row of a column; for each entry of a list column.

        Args:
            column: The column.
            host: As in `wide`.
            raw: As in `wide`.
        """
    @staticmethod
    def arrays(columns: Sequence[dict[str, Any]]) -> ArrowStream:
        """Returns a table of arrays, which are copied.

        Args:
            columns: The columns, all of the same length, each with ``name``; ``kind``; ``values``; ``mask``,
                True where a value is null, or None; and ``metadata``, a dict of str. The kind is
                ``"number"``, ``"datetime"`` (int64, nanoseconds since 1970), ``"date"`` (int32, days since
                1970), ``"time"`` (int64, microseconds since midnight) or ``"text"`` (a list of str or None).

        Raises:
            TypeError: An array does not have the type of its kind.
            ValueError: Arrays of different lengths.
        """
    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """Returns the stream, in a capsule."""
    @property
    def row_count(self) -> int:
        """Number of rows."""
    @property
    def columns(self) -> list[str]:
        """Names of the columns."""
    def select(self, names: list[str]) -> ArrowStream:
        """Returns the table with only these of its columns, in the order of the table.

        Raises:
            TypeError: It is no table of a log.
            ValueError: It has no column of one of the names.
        """
    def write(self, arrays: list[npt.NDArray[Any]]) -> None:
        """Writes all columns, which must be numbers, to arrays. Rows that are null stay as they are there.

        Args:
            arrays: An array ``(n,)`` for each column, of its type.

        Raises:
            TypeError: It is no table of a log; or an array is no array of numbers with one dimension, is not
                contiguous or read-only, or shares memory with another one.
            ValueError: Arrays of other lengths or types, or another number of them.
        """
    def batches(self) -> BatchIterator:
        """Returns the batches of the table; each is made when it is asked for."""

@final
class Batch:
    """Rows of a table."""

    def __len__(self) -> int: ...
    def rows(self, first: int, end: int) -> Batch:
        """Returns the rows from ``first`` up to but without ``end``, without a copy.

        Raises:
            ValueError: Rows that do not exist.
        """

@final
class BatchIterator:
    """The batches of a table, one by one."""

    def __iter__(self) -> BatchIterator: ...
    def __next__(self) -> Batch: ...

@final
class TableFile:
    """Makes a file of a table. The caller writes the bytes: of the start, each chunk, and the end.

    Args:
        file_format: The format of the file.
        table: A table with the columns of the file; its rows are not used.

    Raises:
        ValueError: The format does not have the type of a column.
    """

    def __new__(
        cls, file_format: Literal["parquet", "csv", "arrow"], table: ArrowStream
    ) -> TableFile: ...
    @property
    def chunk_rows(self) -> int:
        """Number of rows that a chunk should have: 262,144, or fewer if the table has many columns."""
    def start(self) -> npt.NDArray[np.uint8]:
        """Returns the bytes with which the file begins."""
    def encode(self, batches: Sequence[Batch]) -> Chunk:
        """Returns a chunk with the rows of these batches. Several threads may call it at once.

        Raises:
            ValueError: A batch has other columns than the file.
        """
    def append(self, chunk: Chunk) -> npt.NDArray[np.uint8]:
        """Returns the bytes of the next chunk of the file.

        Raises:
            ValueError: The chunk was appended already, or is of another format.
        """
    def finish(self) -> npt.NDArray[np.uint8]:
        """Returns the bytes with which the file ends. No chunk may follow."""

@final
class Chunk:
    """Rows that are encoded for a file."""

    def __len__(self) -> int: ...

@final
class MessageFile:
    """Makes an MCAP file of messages of ROS 2. The caller writes the bytes.

    Args:
        compression: How chunks are compressed.
        metadata: Metadata records: the name and entries of each.
    """

    def __new__(
        cls,
        compression: Literal["zstd", "lz4", "none"],
        metadata: Sequence[tuple[str, dict[str, str]]],
    ) -> MessageFile: ...
    def declare(self, name: str, schema: str, definition: str, metadata: dict[str, str]) -> int:
        """Adds a topic and returns its number. The file has the topic if it has messages.

        Args:
            name: Its name.
            schema: The type of its messages.
            definition: The definition of the type, in the language of ROS 2 (``ros2msg``).
            metadata: What else readers may want to know.
        """
    @property
    def counts(self) -> list[int]:
        """Number of messages of each topic so far."""
    def write(
        self,
        first: int,
        stamps: npt.NDArray[np.int64],
        log_times: npt.NDArray[np.uint64],
        rows: Sequence[
            tuple[
                int,
                npt.NDArray[np.int64],
                bytes,
                int | None,
                npt.NDArray[np.uint8],
                npt.NDArray[np.uint64] | None,
            ]
        ],
    ) -> npt.NDArray[np.uint8]:
        """Writes the messages of some samples, sample by sample in the order of ``rows``.

        A message is a head with the time stamp of its sample, and a body.

        Args:
            first: Index of the first sample.
            stamps: Time stamp of each sample, ``(N,)``, ns since 1970.
            log_times: The time by which readers order messages, ``(N,)``, ns since 1970.
            rows: For each topic its number; the samples of its messages, ``(n,)``, rising; their head; where
                the head has the time stamp, or None; the bodies, joined; where each one ends, or None if all
                have one size.

        Returns:
            The bytes with which the file continues.

        Raises:
            ValueError: The rows of a topic do not fit, or the format cannot hold the messages.
        """
    def finish(self) -> npt.NDArray[np.uint8]:
        """Returns the bytes with which the file ends. No message may follow."""
