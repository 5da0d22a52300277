"""Virtual I²C and SPI buses, with the methods of smbus2 and spidev, and a virtual 1-series module."""

from __future__ import annotations

import ctypes
import errno
import os
import threading
from collections.abc import Sequence
from typing import Any

from xbus.mtssp.rates import i2c_bits, spi_bits
from xbus.protocol.mtssp import DEFAULT_ADDRESS, MAX_SPI_HZ, SPI_HEADER, SPI_MODE, Opcode
from xbus.sim.bus_faults import BusFaults, Fate
from xbus.sim.device import SimulatedDevice
from xbus.sim.module import PIPE_BYTES, Module

__all__ = ["I2cMessage", "SimI2c", "SimSpi"]

#: The flag of a message that reads, in Linux.
READ = 1
#: Seconds after which a controller gives up waiting for the clock, as in Linux.
CLOCK_TIMEOUT = 0.035
#: The longest message of an I²C transfer, and of an SPI transfer with spidev's default buffer.
MAX_I2C_BYTES, MAX_SPI_BYTES = 8192, 4096


class I2cMessage:
    """A message for `SimI2c.i2c_rdwr`, like `smbus2.i2c_msg`, where smbus2 is not installed.

    Args:
        addr: Address.
        flags: 1 to read, 0 to write.
        data: The bytes to write, or as many as to read.
    """

    def __init__(self, addr: int, flags: int, data: bytes) -> None:
        self.addr, self.flags, self.len = addr, flags, len(data)
        self.buf = ctypes.create_string_buffer(data, max(len(data), 1))

    @classmethod
    def read(cls, address: int, length: int) -> I2cMessage:
        """Returns a message that reads."""
        return cls(address, READ, bytes(length))

    @classmethod
    def write(cls, address: int, buf: Sequence[int]) -> I2cMessage:
        """Returns a message that writes."""
        return cls(address, 0, bytes(buf))

    def __bytes__(self) -> bytes:
        return self.buf.raw[: self.len]


class _SimBus:
    """What both buses have: the module behind them."""

    def __init__(self, module: Module) -> None:
        self._module = module
        self._is_open = True
        # As in the driver of a bus, a transfer ends before the next one begins; a thread that reads the pin
        # and one that sends a command use the same device.
        self._using = threading.RLock()

    @property
    def device(self) -> SimulatedDevice:
        """The device."""
        return self._module.device

    @property
    def is_live(self) -> bool:
        """Whether the time of the device is that of the computer."""
        return self._module.is_live

    @property
    def faults(self) -> BusFaults:
        """The faults, which can be replaced at any time."""
        return self._module.faults

    @faults.setter
    def faults(self, faults: BusFaults) -> None:
        self._module.faults = faults

    @property
    def drdy(self) -> bool:
        """Whether the pin DRDY is high."""
        with self._using:
            return self._module.drdy

    def reset(self) -> None:
        """Pulls the pin nRST low for a moment: the device starts again."""
        with self._using:
            self.device.power_cycle()

    def close(self) -> None:
        """Closes the bus; the device continues."""
        self._is_open = False

    def _begin(self) -> Fate:
        if not self._is_open:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        return self._module.begin()

    def _reply(self, size: int, fate: Fate) -> bytes:
        """Returns what the host reads of the selected opcode."""
        module = self._module
        if fate is Fate.GARBAGE and module.opcode == Opcode.PIPE_STATUS:
            return b"\xff" * size
        data = module.fates.seen(module.read(size))
        if fate is Fate.SHORT:
            return module.fates.cut(data)
        module.end_read(size)
        return data


class SimI2c(_SimBus):
    """A virtual I²C bus with a 1-series device, and the methods of `smbus2.SMBus` that MTSSP uses.

    Test code for `smbus2` with it: it takes the place of ``SMBus(1)``.

    What real devices do is not documented everywhere. Here, a pipe has 2048 bytes; while its overflow is not
    read, more messages are dropped without another report; reads of an empty pipe and unknown opcodes return
    zeros; a message is removed when it was read to its end in one transfer; a device that starts does not
    answer, and its pipes are empty.

    Args:
        device: Product, ``"MTi-3"``, or a device of the 1-series without a baud rate.
        address: Address of the device.
        frequency: Clock in Hz, which determines the device time that transfers take; None: none.
        faults: Faults of the bus.
        pipe_bytes: Bytes of each pipe.
        live: Whether the time of the device is that of the computer, so that programs can wait as usual.
            Otherwise it advances with transfers and `SimulatedDevice.advance`.

    Attributes:
        address: Address of the device.

    Raises:
        ValueError: The device is not of the 1-series, or has a baud rate or faults of a line.

    Example:
        >>> from xbus.sim import I2cMessage, SimI2c
        >>> bus = SimI2c("MTi-3")
        >>> bus.device.advance(0.1)
        >>> bus.drdy
        True
        >>> status, wake_up = I2cMessage.read(0x6B, 4), I2cMessage.read(0x6B, 3)
        >>> bus.i2c_rdwr(I2cMessage.write(0x6B, [0x04]), status)
        >>> bus.i2c_rdwr(I2cMessage.write(0x6B, [0x05]), wake_up)
        >>> bytes(status).hex(), bytes(wake_up).hex()
        ('03000000', '3e00c3')
    """

    def __init__(
        self,
        device: str | SimulatedDevice,
        *,
        address: int = DEFAULT_ADDRESS,
        frequency: int | None = 400_000,
        faults: BusFaults | None = None,
        pipe_bytes: int = PIPE_BYTES,
        live: bool = False,
    ) -> None:
        super().__init__(Module(device, faults=faults, pipe_bytes=pipe_bytes, live=live))
        self.address, self._frequency = address, frequency

    def i2c_rdwr(self, *messages: Any) -> None:
        """Runs one transfer: the messages with repeated starts between them.

        Args:
            messages: `smbus2.i2c_msg`, or objects with its attributes.

        Raises:
            OSError: As in Linux: EREMOTEIO without an acknowledge, ETIMEDOUT if the clock was held too long.
        """
        if any(message.len > MAX_I2C_BYTES for message in messages):
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        with self._using:
            self._transfer(messages)

    def _transfer(self, messages: Sequence[Any]) -> None:
        fate = self._begin()
        if any(message.addr != self.address for message in messages):
            fate = Fate.NACK
        if fate is Fate.NACK:
            self._spend(i2c_bits(0))
            raise OSError(errno.EREMOTEIO, os.strerror(errno.EREMOTEIO))
        if fate is Fate.TIMEOUT:
            self._module.spend(CLOCK_TIMEOUT)
            raise OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))
        for message in messages:
            if message.flags & READ:
                ctypes.memmove(message.buf, self._reply(message.len, fate), message.len)
            elif data := bytes(message):
                self._module.select(data[0])
                if len(data) > 1:
                    self._module.write(data[1:])
        self._spend(i2c_bits(*[message.len for message in messages]))

    def _spend(self, bits: int) -> None:
        if self._frequency is not None:
            self._module.spend(bits / self._frequency)


class SimSpi(_SimBus):
    """A virtual SPI bus with a 1-series device, and what MTSSP uses of `spidev.SpiDev`.

    Test code for `spidev` with it. In another mode than 3, or with a clock above 2 MHz, it reads FF, and the
    device understands nothing. What is assumed about devices is as in `SimI2c`.

    Args:
        device: As for `SimI2c`.
        faults: As for `SimI2c`.
        pipe_bytes: As for `SimI2c`.
        live: As for `SimI2c`.

    Attributes:
        mode: SPI mode. As in spidev it is 0 at first.
        max_speed_hz: Clock in Hz, which determines the device time that transfers take.
        bits_per_word: Bits of a word; 8.
        lsbfirst: Whether the least significant bit is first; False.

    Raises:
        ValueError: As for `SimI2c`.

    Example:
        >>> from xbus.sim import SimSpi
        >>> spi = SimSpi("MTi-3")
        >>> spi.mode, spi.max_speed_hz = 3, 1_000_000
        >>> spi.device.advance(0.1)
        >>> bytes(spi.xfer2([0x04, 0xFF, 0xFF, 0xFF, 0, 0, 0, 0])).hex(" ")
        'fa ff ff ff 03 00 00 00'
    """

    def __init__(
        self,
        device: str | SimulatedDevice,
        *,
        faults: BusFaults | None = None,
        pipe_bytes: int = PIPE_BYTES,
        live: bool = False,
    ) -> None:
        super().__init__(Module(device, faults=faults, pipe_bytes=pipe_bytes, live=live))
        self.mode = 0
        self.max_speed_hz = 500_000
        self.bits_per_word = 8
        self.lsbfirst = False

    def xfer2(self, values: Sequence[int]) -> list[int]:
        """Runs one transfer, and returns what was received, a value for each that was sent.

        Raises:
            OverflowError: The transfer is longer than spidev's default buffer of 4096 bytes.
        """
        if len(values) > MAX_SPI_BYTES:
            raise OverflowError(f"Argument list size exceeds {MAX_SPI_BYTES} bytes.")
        with self._using:
            return list(self._transfer(bytes(values)))

    def _transfer(self, sent: bytes) -> bytes:
        fate = self._begin()
        header = len(SPI_HEADER)
        understood = (
            (self.mode, self.bits_per_word, self.lsbfirst) == (SPI_MODE, 8, False)
            and self.max_speed_hz <= MAX_SPI_HZ
            and fate is not Fate.NACK
        )
        received = b"\xff" * len(sent)
        if understood and sent:
            self._module.select(sent[0])
            size = max(len(sent) - header, 0)
            received = self._module.fates.seen(SPI_HEADER)[: len(sent)]
            if self._module.is_write:
                self._module.write(sent[header:])
                received += self._module.fates.seen(bytes(size))
            else:
                received += self._reply(size, fate)
        self._module.spend(spi_bits(len(sent) - header) / self.max_speed_hz)
        return received
