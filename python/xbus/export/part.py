"""What an export reads of a log: the whole log, or its parts in order.

`xbus.log.log.Log` has all of this. The protocols are here because a log uses exports and not the reverse.
"""

from __future__ import annotations

from collections.abc import Iterator, KeysView, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from xbus.formatting import device_name
from xbus.protocol.configuration import Firmware
from xbus.protocol.keys import EntryKey, Key
from xbus.wire.message import Message
from xbus.wire.strings import String

__all__ = ["Part", "PartColumn", "PartDevice", "PartMessages", "device_label"]


class PartColumn(Protocol):
    """The values of a quantity; see `xbus.log.column.Column`."""

    name: str
    unit: str
    coordinates: str | None
    precision: str | None
    data_id: int

    def __len__(self) -> int: ...
    def __getitem__(self, index: Any) -> Any: ...

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the components or fields."""
        ...

    @property
    def values(self) -> npt.NDArray[Any]:
        """One row for each packet."""
        ...

    @property
    def scaled(self) -> npt.NDArray[Any]:
        """The fields of a struct in their units."""
        ...

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each field of `scaled` for a struct; empty for counts, dates and bits."""
        ...

    @property
    def satellites(self) -> npt.NDArray[Any]:
        """The satellites of ``gnss_sat_info``, one row for each."""
        ...

    @property
    def offsets(self) -> npt.NDArray[np.int64]:
        """Index into `satellites` at which each row begins, and their number at the end."""
        ...

    @property
    def sample(self) -> npt.NDArray[np.int64]:
        """Index of the sample of each row, from the start of the recording."""
        ...

    @property
    def time(self) -> npt.NDArray[np.float64]:
        """Seconds on the device clock."""
        ...

    @property
    def datetime(self) -> npt.NDArray[np.datetime64]:
        """Dates in ns; NaT for an impossible one."""
        ...


class PartDevice(Protocol):
    """A device that sent samples; see `xbus.log.log.LogDevice`."""

    @property
    def bid(self) -> int:
        """Bus identifier."""
        ...

    @property
    def device_id(self) -> int | None:
        """Device identifier, if it is known."""
        ...

    @property
    def product_code(self) -> str | None:
        """Product code, if it is known."""
        ...

    @property
    def firmware(self) -> Firmware | None:
        """Firmware revision, if it is known."""
        ...


class PartMessages(Protocol):
    """The messages that are not samples; see `xbus.log.messages.Messages`."""

    def with_mids(self, *mids: int) -> Iterator[Message]:
        """Yields the messages with one of these message identifiers."""
        ...


class Part(Protocol):
    """A log, or a part of one; see `xbus.log.log.Log`. Its length is the number of samples."""

    first_sample: int

    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[EntryKey]: ...
    def __contains__(self, key: object) -> bool: ...
    def __getitem__(self, key: Key) -> PartColumn: ...

    def keys(self) -> KeysView[EntryKey]:
        """Returns the key of each quantity."""
        ...

    @property
    def time(self) -> npt.NDArray[np.float64]:
        """Seconds on the device clock of each sample; NaN if it has no time stamp."""
        ...

    @property
    def has_host_time(self) -> bool:
        """Whether a sample of the whole log has a host time."""
        ...

    @property
    def host_time(self) -> npt.NDArray[np.float64]:
        """Seconds since 1970 on the clock of the recording computer; NaN if unknown."""
        ...

    @property
    def utc(self) -> npt.NDArray[np.datetime64]:
        """UTC of each sample in ns; NaT if unknown."""
        ...

    @property
    def packet_counter(self) -> npt.NDArray[np.int64]:
        """Packet counter of each sample, unwrapped; -1 for a sample without one."""
        ...

    @property
    def bid(self) -> npt.NDArray[np.uint8]:
        """Bus identifier of each sample."""
        ...

    @property
    def runs(self) -> npt.NDArray[Any]:
        """The runs of the devices; in a part, they start at its first sample."""
        ...

    @property
    def restarts(self) -> npt.NDArray[np.int64]:
        """Indices of the samples with which a device begins again."""
        ...

    @property
    def gaps(self) -> npt.NDArray[Any]:
        """Places where samples are missing: a structured array of sample, lost and bid."""
        ...

    @property
    def devices(self) -> Sequence[PartDevice]:
        """The devices that sent samples."""
        ...

    @property
    def offset(self) -> npt.NDArray[np.int64]:
        """Byte offset in the input at which the frame of each sample begins."""
        ...

    @property
    def damage(self) -> npt.NDArray[Any]:
        """Bytes that are neither frame nor string: a structured array of offset, length and reason."""
        ...

    @property
    def messages(self) -> PartMessages:
        """The messages that are not samples, in order."""
        ...

    @property
    def strings(self) -> Sequence[String]:
        """The strings, in order."""
        ...


def device_label(device: PartDevice) -> str:
    """Returns the identifier of a device, or its BID if that is all that is known."""
    return f"BID{device.bid}" if device.device_id is None else device_name(device.device_id)
