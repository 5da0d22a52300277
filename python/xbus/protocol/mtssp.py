"""The numbers of MTSSP, the protocol of the 1-series on I²C and SPI, as the extension declares them."""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import NamedTuple

from xbus import _core

__all__ = [
    "ADDRESSES",
    "DEFAULT_ADDRESS",
    "DEFAULT_DATA_READY",
    "MAX_I2C_HZ",
    "MAX_INPUT",
    "MAX_OUTPUT",
    "MAX_SPI_HZ",
    "OPCODES",
    "PIPE_OVERFLOW",
    "SPI_HEADER",
    "SPI_MODE",
    "DataReady",
    "Opcode",
    "OpcodeRow",
]

_TABLE = _core.mtssp()
#: The I²C address for each level of the pins ADD2 to ADD0, as a number.
ADDRESSES = tuple(_TABLE["addresses"])
#: The address if the pins are not connected: they are pulled up.
DEFAULT_ADDRESS: int = ADDRESSES[-1]
#: What a module sends on SPI before the data.
SPI_HEADER: bytes = _TABLE["spi_header"]
#: SPI mode.
SPI_MODE: int = _TABLE["spi_mode"]
#: The fastest clock of SPI, in Hz.
MAX_SPI_HZ: int = _TABLE["max_spi_hz"]
#: The fastest clock of I²C, in Hz.
MAX_I2C_HZ: int = _TABLE["max_i2c_hz"]
#: Bytes of a message to a module.
MAX_INPUT: int = _TABLE["max_input"]
#: Bytes of a message from a module.
MAX_OUTPUT: int = _TABLE["max_output"]
#: Code of the Error that reports a full pipe.
PIPE_OVERFLOW: int = _TABLE["pipe_overflow"]

_BITS = {name: 1 << bit for bit, name in enumerate(_TABLE["data_ready_bits"])}
_CODES = {row["name"]: row["code"] for row in _TABLE["opcodes"]}


class Opcode(IntEnum):
    """The first byte of a transfer."""

    PROTOCOL_INFO = _CODES["ProtocolInfo"]
    CONFIGURE_PROTOCOL = _CODES["ConfigureProtocol"]
    CONTROL_PIPE = _CODES["ControlPipe"]
    PIPE_STATUS = _CODES["PipeStatus"]
    NOTIFICATION_PIPE = _CODES["NotificationPipe"]
    MEASUREMENT_PIPE = _CODES["MeasurementPipe"]


class OpcodeRow(NamedTuple):
    """An opcode.

    Attributes:
        code: Its code.
        name: The vendor's name.
        is_read: Whether the module sends the data.
        size: Bytes of the data; None if it is a message.
    """

    code: int
    name: str
    is_read: bool
    size: int | None


#: Every opcode by its code.
OPCODES = {Opcode(row["code"]): OpcodeRow(**row) for row in _TABLE["opcodes"]}


class DataReady(IntFlag):
    """The data-ready configuration: the level of the pin DRDY, and what makes it active."""

    IDLE_HIGH = _BITS["IDLE_HIGH"]
    OPEN_DRAIN = _BITS["OPEN_DRAIN"]
    NOTIFICATIONS = _BITS["NOTIFICATIONS"]
    MEASUREMENTS = _BITS["MEASUREMENTS"]


#: High while either pipe has a message. Modules behave so after power-up, as far as is known.
DEFAULT_DATA_READY = DataReady.NOTIFICATIONS | DataReady.MEASUREMENTS
