"""I²C and SPI as a host uses them for MTSSP: smbus2, spidev, pyftdi, or an object with the same methods."""

from __future__ import annotations

import errno
from typing import Any, Protocol

from xbus.errors import BusError, DecodeError
from xbus.extras import require
from xbus.mtssp.codec import i2c_request, spi_data, spi_request
from xbus.protocol.mtssp import (
    ADDRESSES,
    DEFAULT_ADDRESS,
    MAX_SPI_HZ,
    SPI_MODE,
)

__all__ = [
    "Bus",
    "FtdiI2cBus",
    "FtdiSpiBus",
    "I2cBus",
    "SpiBus",
    "check_address",
    "check_speed",
]

#: What a line that nothing drives reads as.
IDLE_LEVELS = (0x00, 0xFF)
#: What to check on each bus.
I2C_CHECKS = "check wiring, power, pull-ups and address, and that PSEL0 and PSEL1 select I²C"
I2C_ADVICE = (
    f"{I2C_CHECKS}; a Raspberry Pi 1 to 4 needs the overlay i2c-gpio, because its controller fails when"
    " a device holds the clock"
)
FTDI_I2C_ADVICE = f"{I2C_CHECKS}, and that a wire connects AD7 to AD0 of the adapter"
SPI_ADVICE = (
    f"check wiring and power, that PSEL0 and PSEL1 select SPI, mode {SPI_MODE}, and a clock of at most"
    f" {MAX_SPI_HZ:,} Hz"
)


class Bus(Protocol):
    """A bus with one module, for `xbus.connect`: implement it for adapters that xbus does not know.

    Attributes:
        name: Name for messages to users.
        advice: What to check if transfers fail.
    """

    name: str
    advice: str

    def read(self, opcode: int, size: int) -> bytes:
        """Reads ``size`` bytes in one transfer.

        Raises:
            OSError: The transfer failed.
        """

    def write(self, opcode: int, data: bytes) -> None:
        """Writes bytes in one transfer.

        Raises:
            OSError: The transfer failed.
        """

    def close(self) -> None:
        """Closes the bus, if this object opened it."""


class I2cBus:
    """A module on an I²C bus of Linux.

    Args:
        bus: An open `smbus2.SMBus`, or an object with its method ``i2c_rdwr``, such as `xbus.sim.SimI2c`.
        address: Address of the module.
        name: Name for messages to users; None: made of the address.
        message: What makes the messages for ``i2c_rdwr``; None: `smbus2.i2c_msg`.

    Raises:
        ValueError: No module can have the address.
        ImportError: The extra ``i2c`` is not installed.
    """

    advice = I2C_ADVICE

    def __init__(
        self,
        bus: Any,
        address: int = DEFAULT_ADDRESS,
        *,
        name: str | None = None,
        message: Any = None,
    ) -> None:
        self._bus, self._address = bus, check_address(address)
        self.name = name or f"i2c:@0x{address:02x}"
        if message is None:
            message = require("smbus2", "i2c", "to use I²C").i2c_msg
        self._message = message

    def read(self, opcode: int, size: int) -> bytes:
        """Writes the opcode and, after a repeated start, reads."""
        reply = self._message.read(self._address, size)
        self._transfer(self._message.write(self._address, i2c_request(opcode)), reply)
        return bytes(reply)

    def write(self, opcode: int, data: bytes) -> None:
        """Writes opcode and data."""
        self._transfer(self._message.write(self._address, i2c_request(opcode, data)))

    def _transfer(self, *messages: Any) -> None:
        self._bus.i2c_rdwr(*messages)

    def close(self) -> None:
        """Closes the bus."""
        self._bus.close()


class SpiBus:
    """A module on an SPI bus of Linux.

    Args:
        spi: An open `spidev.SpiDev`, or an object with its attributes and its method ``xfer2``, such as
            `xbus.sim.SimSpi`. Its mode is set.
        speed: Clock in Hz.
        name: Name for messages to users.

    Raises:
        ValueError: The module is not that fast.
    """

    advice = SPI_ADVICE

    def __init__(self, spi: Any, speed: int = 1_000_000, *, name: str = "spi:") -> None:
        self._spi, self.name = spi, name
        spi.mode = SPI_MODE
        spi.max_speed_hz = check_speed(speed, MAX_SPI_HZ)

    def read(self, opcode: int, size: int) -> bytes:
        """Sends the opcode, and reads behind the header."""
        return self._transfer(spi_request(opcode, read=size))

    def write(self, opcode: int, data: bytes) -> None:
        """Sends opcode and data."""
        self._transfer(spi_request(opcode, data))

    def _transfer(self, request: bytes) -> bytes:
        received = bytes(self._spi.xfer2(list(request)))
        return _data(received, len(request))

    def close(self) -> None:
        """Closes the bus."""
        self._spi.close()


class FtdiI2cBus:
    """A module on the I²C bus of an FTDI adapter.

    Args:
        controller: A configured `pyftdi.i2c.I2cController`.
        address: Address of the module.
        name: Name for messages to users.

    Raises:
        ValueError: No module can have the address.
    """

    advice = FTDI_I2C_ADVICE

    def __init__(self, controller: Any, address: int, *, name: str) -> None:
        self._controller, self._address, self.name = controller, check_address(address), name
        self._port = controller.get_port(address)

    def read(self, opcode: int, size: int) -> bytes:
        """Writes the opcode and, after a repeated start, reads."""
        return bytes(self._port.exchange(i2c_request(opcode), size))

    def write(self, opcode: int, data: bytes) -> None:
        """Writes opcode and data."""
        self._port.write(i2c_request(opcode, data))

    def close(self) -> None:
        """Releases the adapter."""
        self._controller.close()


class FtdiSpiBus:
    """A module on the SPI bus of an FTDI adapter. Mode 3 needs a chip of the H series.

    Args:
        controller: A configured `pyftdi.spi.SpiController`.
        cs: Number of the chip select.
        speed: Clock in Hz.
        name: Name for messages to users.

    Raises:
        ValueError: The module is not that fast.
    """

    advice = SPI_ADVICE

    def __init__(self, controller: Any, cs: int, speed: int, *, name: str) -> None:
        self._controller, self.name = controller, name
        speed = check_speed(speed, MAX_SPI_HZ)
        self._port = controller.get_port(cs=cs, freq=speed, mode=SPI_MODE)

    def read(self, opcode: int, size: int) -> bytes:
        """Sends the opcode, and reads behind the header."""
        return self._transfer(spi_request(opcode, read=size))

    def write(self, opcode: int, data: bytes) -> None:
        """Sends opcode and data."""
        self._transfer(spi_request(opcode, data))

    def _transfer(self, request: bytes) -> bytes:
        received = bytes(self._port.exchange(request, duplex=True))
        return _data(received, len(request))

    def close(self) -> None:
        """Releases the adapter."""
        self._controller.close()


def _data(received: bytes, size: int) -> bytes:
    """Returns the data of an SPI transfer of this size."""
    if len(received) != size:
        raise BusError(errno.EIO, f"{len(received)} bytes of {size} were received")
    if received[0] in IDLE_LEVELS and received.count(received[0]) == size:
        raise BusError(
            errno.EIO,
            f"nothing but {received[0]:02X} was received, as from a line that nothing drives",
        )
    try:
        return spi_data(received)
    except DecodeError as error:
        raise BusError(errno.EIO, str(error)) from error


def check_address(address: int) -> int:
    """Returns an I²C address.

    Raises:
        ValueError: No module can have it.
    """
    if address not in ADDRESSES:
        known = ", ".join(f"0x{value:02X}" for value in ADDRESSES)
        raise ValueError(
            f"no MTi has the I²C address 0x{address:02X}; the pins ADD2 to ADD0 give {known}"
        )
    return address


def check_speed(speed: int, highest: int) -> int:
    """Returns a clock in Hz.

    Raises:
        ValueError: The module is not that fast.
    """
    if not 1 <= speed <= highest:
        raise ValueError(f"the speed must be from 1 to {highest:,} Hz, not {speed:,}")
    return speed
