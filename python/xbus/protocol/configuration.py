"""The Configuration message and the firmware revision, as values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from xbus import _core

__all__ = ["Configuration", "Firmware"]


class Firmware(NamedTuple):
    """A firmware revision (Table 4); build and scm are None if it comes from a Configuration.

    >>> import xbus
    >>> firmware = xbus.read_log("tests/captures/walk.mtb").configuration.firmware
    >>> str(firmware), firmware >= (1, 8, 0)
    ('1.12.0', True)
    """

    major: int
    minor: int
    revision: int
    build: int | None = None
    scm: int | None = None

    def __str__(self) -> str:
        return f"{self.major}.{self.minor}.{self.revision}"


@dataclass(frozen=True)
class Configuration:
    """The Configuration message (Tables 13 and 14).

    Attributes:
        device_id: Device identifier.
        product_code: Product code; None if the message has none.
        sampling_period: In 1/115200 s; None on devices with 8-byte identifiers.
        output_skip_factor: None on devices with 8-byte identifiers.
        date: ``YYYYMMDD`` as the recording host has set it, or None.
        time: ``HHMMSSHH`` as the recording host has set it, or None; the last two are hundredths.
        devices: Number of devices on the bus.
        filter_profile: Number of the filter profile.
        firmware: Firmware revision.
        output_mode: Output mode of the older MTData; None on devices with 8-byte identifiers.
        output_settings: Output settings of the older MTData; None on devices with 8-byte identifiers.
        filter_type: Letter of the kind of filter, or None.
        filter_version: Major and minor version of the filter.
        data_length: Bytes of the payload of MTData; 0 if the device does not send it.

    >>> import xbus
    >>> configuration = xbus.read_log("tests/captures/walk.mtb").configuration
    >>> configuration.product_code, f"{configuration.device_id:08X}", configuration.date
    ('MTi-680G-8A1G6', '8000A1B2', '20261122')
    """

    device_id: int
    product_code: str | None
    sampling_period: int | None
    output_skip_factor: int | None
    date: str | None
    time: str | None
    devices: int
    filter_profile: int
    firmware: Firmware
    output_mode: int | None = None
    output_settings: int | None = None
    filter_type: str | None = None
    filter_version: tuple[int, int] = (0, 0)
    data_length: int = 0

    @classmethod
    def read(cls, payload: bytes) -> Configuration | None:
        """Decodes a payload of 118 bytes; returns None for a shorter one."""
        if (fields := _core.configuration(payload)) is None:
            return None
        firmware, filter_version = Firmware(*fields["firmware"]), tuple(fields["filter_version"])
        return cls(**{**fields, "firmware": firmware, "filter_version": filter_version})
