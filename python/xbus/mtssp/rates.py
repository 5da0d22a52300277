"""How long transfers take, and which rates a bus allows."""

from __future__ import annotations

from xbus.protocol.mtssp import OPCODES, SPI_HEADER, Opcode

__all__ = ["highest_rate", "i2c_bits", "spi_bits"]

#: Bits of a byte on I²C: eight and the acknowledge.
I2C_BYTE = 9


def i2c_bits(*lengths: int) -> int:
    """Returns the bits of an I²C transfer, in periods of the clock.

    Args:
        lengths: Bytes that are written and read, in turn, without the address that precedes each: ``(1, 4)``.

    >>> i2c_bits(1, 4)
    66
    """
    starts_and_stop = len(lengths) + 1
    return starts_and_stop + I2C_BYTE * (len(lengths) + sum(lengths))


def spi_bits(size: int) -> int:
    """Returns the bits of an SPI transfer.

    Args:
        size: Bytes of the data, without the opcode and the bytes after it.

    >>> spi_bits(4)
    64
    """
    return 8 * (len(SPI_HEADER) + size)


def highest_rate(size: int, speed: int, bus: str) -> float:
    """Returns the messages per second that a bus can carry, if it does nothing else.

    Each message takes two transfers: the status of the pipes, and the message. Pauses between transfers,
    clock stretching and the time of the computer come on top, so plan with half of this rate.

    Args:
        size: Bytes of the message: payload and 3, or 5 for a payload of 255 bytes or more.
        speed: Clock in Hz.
        bus: ``"i2c"`` or ``"spi"``.

    >>> round(highest_rate(46, 400_000, "i2c"))
    784
    """
    status = OPCODES[Opcode.PIPE_STATUS].size or 0
    if bus == "i2c":
        return speed / (i2c_bits(1, status) + i2c_bits(1, size))
    return speed / (spi_bits(status) + spi_bits(size))
