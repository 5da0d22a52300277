"""The link to a virtual device on a virtual I²C or SPI bus."""

from __future__ import annotations

from typing import Any
from urllib.parse import parse_qsl

from xbus.errors import BusError
from xbus.mtssp.bus import Bus, I2cBus, SpiBus
from xbus.mtssp.host import Clock, Host
from xbus.sim.bus_faults import BusFaults
from xbus.sim.buses import I2cMessage, SimI2c, SimSpi
from xbus.sim.device import SimulatedDevice
from xbus.sim.link import SimLink
from xbus.sim.options import parse_options

__all__ = ["BUSES", "BusSimLink", "bus_of", "host_bus"]

#: The virtual buses by name.
BUSES: dict[str, type[SimI2c | SimSpi]] = {"i2c": SimI2c, "spi": SimSpi}


class BusSimLink(SimLink):
    """A `xbus.wire.link.Link` to a virtual device on a bus in this process.

    The device's time advances while the host waits for it, and with each transfer.

    Args:
        bus: The bus.
        bid: As for `SimLink`.
        bound: As for `SimLink`.
    """

    is_line = False

    def __init__(self, bus: SimI2c | SimSpi, *, bid: int = 0xFF, bound: int = 24_000_000) -> None:
        self._bus = host_bus(bus)
        super().__init__(bus.device, bid=bid, bound=bound)
        self.name, self.baudrate = self._bus.name, None

    def restart(self) -> None:
        """Begins a new acquisition."""
        super().restart()
        self._host = Host(self._bus, self.acquisition, Clock(self.clock, self.pause))

    def _receive(self) -> bool:
        try:
            return self._host.receive()
        except BusError as error:
            self.acquisition.end(str(error))
            return True

    def write(self, data: bytes) -> None:
        """Sends frames to the device."""
        self._host.send(data)

    def reopen(self) -> None:
        """Continues after transfers have failed.

        Raises:
            BusError: They still fail.
        """
        self._host.begin()
        if self.acquisition.ended is not None:
            self.acquisition.resume()


def host_bus(bus: SimI2c | SimSpi) -> Bus:
    """Returns the host's side of a virtual bus."""
    name = f"sim:{bus.device.product.name}?bus="
    if isinstance(bus, SimI2c):
        return I2cBus(bus, bus.address, name=f"{name}i2c", message=I2cMessage)
    return SpiBus(bus, name=f"{name}spi")


def bus_of(name: str, *, live: bool = False, **defaults: Any) -> SimI2c | SimSpi | None:
    """Returns the bus of the virtual device that a port name describes; None without the option ``bus``.

    Args:
        name: ``sim:PRODUCT?bus=i2c`` or ``bus=spi``, with other options as for `device_of`; ``fault`` is one
            of `BusFaults`.
        live: As for `SimI2c`.
        **defaults: Arguments of `SimulatedDevice` that the options replace.

    Raises:
        ValueError: No such product, bus, option or fault, or a product without these buses.

    >>> bus_of("sim:MTi-3?bus=spi&fault=drop=0.1").faults.drop
    0.1
    """
    product, _, query = name.removeprefix("sim:").partition("?")
    pairs = parse_qsl(query, keep_blank_values=True)
    kinds = [value for option, value in pairs if option == "bus"]
    if not kinds:
        return None
    if len(kinds) > 1 or kinds[0] not in BUSES:
        raise ValueError(f"bus must be {' or '.join(BUSES)}, once, not {' and '.join(kinds)}")
    options = parse_options(pair for pair in pairs if pair[0] not in ("bus", "fault"))
    faults = BusFaults.parse(
        (value for option, value in pairs if option == "fault"), options.get("seed", 0)
    )
    device = SimulatedDevice(product, **(defaults | options))
    return BUSES[kinds[0]](device, faults=faults, live=live)
