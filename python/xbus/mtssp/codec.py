"""MTSSP: reduced messages, transfers and status, as bytes."""

from __future__ import annotations

import struct
from typing import NamedTuple

from xbus._core import EXTENDED_HEADER_SIZE
from xbus.errors import DecodeError
from xbus.protocol.mtssp import MAX_OUTPUT, OPCODES, SPI_HEADER, DataReady, Opcode
from xbus.protocol.tables import MASTER, PREAMBLE

__all__ = [
    "PREFIX",
    "PipeStatus",
    "ProtocolInfo",
    "expand",
    "i2c_request",
    "problem_of",
    "reduce",
    "spi_data",
    "spi_request",
]

#: The bytes of a frame that a reduced message lacks.
PREFIX = bytes([PREAMBLE, MASTER])
#: Bytes of a reduced message before the payload, in both forms, and of its checksum.
HEADER, EXTENDED_HEADER, CHECKSUM = 2, EXTENDED_HEADER_SIZE - len(PREFIX), 1
#: The length that announces the extended form.
EXTENDED = 0xFF
#: Bytes of any value after the opcode on SPI, and one that is sent while the module sends data.
FILL, IDLE = b"\xff\xff\xff", b"\x00"


def reduce(frame: bytes) -> bytes:
    """Returns the reduced message of a frame: from the MID to the checksum.

    The checksum is that of the bus identifier 0xFF, whatever the frame has.

    Raises:
        ValueError: The bytes are not one whole frame.

    >>> reduce(bytes.fromhex("FA FF 30 00 D1")).hex(" ").upper()
    '30 00 D1'
    """
    if len(frame) < len(PREFIX) or frame[0] != PREAMBLE:
        raise ValueError(
            f"a frame begins with {PREAMBLE:02X}, not with {frame[:1].hex().upper() or 'nothing'}"
        )
    message = frame[len(PREFIX) : -CHECKSUM] + bytes([(frame[-1] + frame[1] - MASTER) & 0xFF])
    if (problem := problem_of(message)) is not None:
        raise ValueError(f"not a whole frame: {problem}")
    return message


def expand(message: bytes) -> bytes:
    """Returns the frame of a reduced message, with the bus identifier 0xFF.

    Raises:
        DecodeError: The length or the checksum is wrong.

    >>> expand(bytes.fromhex("3E 00 C3")).hex(" ").upper()
    'FA FF 3E 00 C3'
    """
    if (problem := problem_of(message)) is not None:
        raise DecodeError(f"not a message: {problem}; read it again, or lower the bus speed", 0)
    return PREFIX + message


def problem_of(message: bytes) -> str | None:
    """Returns why bytes are not a whole reduced message with a correct checksum, or None."""
    smallest = HEADER + CHECKSUM
    if len(message) < smallest:
        return f"a message has at least {smallest} bytes, not {len(message)}"
    header, length = HEADER, message[1]
    if length == EXTENDED and len(message) >= EXTENDED_HEADER:
        header, length = EXTENDED_HEADER, int.from_bytes(message[HEADER:EXTENDED_HEADER], "big")
        if length < EXTENDED:
            return f"it has the long length field, which is for {EXTENDED} bytes and more, with {length}"
    if len(message) != (size := header + length + CHECKSUM):
        return f"its length field says {size:,} bytes, but there are {len(message):,}"
    if total := (MASTER + sum(message)) & 0xFF:
        right = (message[-1] - total) & 0xFF
        return f"its checksum is {message[-1]:02X}, but its bytes have the checksum {right:02X}"
    return None


class PipeStatus(NamedTuple):
    """The sizes of the next messages in the pipes; 0 if a pipe is empty.

    Attributes:
        notification: Bytes of the next notification: an answer, an error, WakeUp.
        measurement: Bytes of the next measurement, an MTData2 message.

    >>> PipeStatus.parse(bytes.fromhex("10 00 2E 00"))
    PipeStatus(notification=16, measurement=46)
    """

    notification: int
    measurement: int

    @classmethod
    def parse(cls, data: bytes) -> PipeStatus:
        """Returns the status of four bytes, little-endian.

        Raises:
            DecodeError: There are not four bytes, or no message has such a size.
        """
        _check_size(Opcode.PIPE_STATUS, data)
        status = cls(*struct.unpack("<HH", data))
        for name, size in status._asdict().items():
            if size and not HEADER + CHECKSUM <= size <= MAX_OUTPUT:
                raise DecodeError(
                    f"the pipe status is {data.hex(' ').upper()}: a {name} of {size:,} bytes, but a message"
                    f" has {HEADER + CHECKSUM} to {MAX_OUTPUT:,}",
                    0,
                )
        return status

    def encode(self) -> bytes:
        """Returns the four bytes."""
        return struct.pack("<HH", *self)


class ProtocolInfo(NamedTuple):
    """The protocol of a module.

    Attributes:
        version: Its version. No document gives the number.
        data_ready: The data-ready configuration.

    >>> ProtocolInfo.parse(bytes.fromhex("01 0C")).data_ready
    <DataReady.NOTIFICATIONS|MEASUREMENTS: 12>
    """

    version: int
    data_ready: DataReady

    @classmethod
    def parse(cls, data: bytes) -> ProtocolInfo:
        """Returns the information of two bytes.

        Raises:
            DecodeError: There are not two bytes.
        """
        _check_size(Opcode.PROTOCOL_INFO, data)
        return cls(data[0], DataReady(data[1]))

    def encode(self) -> bytes:
        """Returns the two bytes."""
        return bytes(self)


def _check_size(opcode: Opcode, data: bytes) -> None:
    row = OPCODES[opcode]
    if len(data) != row.size:
        raise DecodeError(f"{row.name} has {row.size} bytes, not {len(data)}", 0)


def i2c_request(opcode: int, data: bytes = b"") -> bytes:
    """Returns the bytes to write on I²C, after the address: to write data, or before a read.

    >>> i2c_request(Opcode.CONTROL_PIPE, bytes.fromhex("30 00 D1")).hex(" ").upper()
    '03 30 00 D1'
    """
    return bytes([opcode]) + data


def spi_request(opcode: int, data: bytes = b"", *, read: int = 0) -> bytes:
    """Returns the bytes to send on SPI in one transfer.

    Args:
        opcode: The opcode.
        data: Data to write.
        read: Number of bytes to read instead.

    >>> spi_request(Opcode.PIPE_STATUS, read=4).hex(" ").upper()
    '04 FF FF FF 00 00 00 00'
    """
    return bytes([opcode]) + FILL + data + IDLE * read


def spi_data(received: bytes) -> bytes:
    """Returns the data of what was received on SPI in one transfer.

    Raises:
        DecodeError: It does not begin as a module does.

    >>> spi_data(bytes.fromhex("FA FF FF FF 10 00 2E 00")).hex(" ").upper()
    '10 00 2E 00'
    """
    header = received[: len(SPI_HEADER)]
    if header != SPI_HEADER:
        raise DecodeError(
            f"the transfer begins with {header.hex(' ').upper()}, not with {SPI_HEADER.hex(' ').upper()}",
            0,
        )
    return received[len(SPI_HEADER) :]
