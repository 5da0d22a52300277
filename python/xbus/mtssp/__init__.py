"""MTSSP, the protocol of the 1-series on I²C and SPI: reduced messages, buses, and rates."""

from xbus.errors import BusError
from xbus.mtssp.bus import Bus, FtdiI2cBus, FtdiSpiBus, I2cBus, SpiBus
from xbus.mtssp.codec import (
    PipeStatus,
    ProtocolInfo,
    expand,
    i2c_request,
    reduce,
    spi_data,
    spi_request,
)
from xbus.mtssp.rates import highest_rate
from xbus.protocol.mtssp import ADDRESSES, OPCODES, DataReady, Opcode

__all__ = [
    "ADDRESSES",
    "OPCODES",
    "Bus",
    "BusError",
    "DataReady",
    "FtdiI2cBus",
    "FtdiSpiBus",
    "I2cBus",
    "Opcode",
    "PipeStatus",
    "ProtocolInfo",
    "SpiBus",
    "expand",
    "highest_rate",
    "i2c_request",
    "reduce",
    "spi_data",
    "spi_request",
]
