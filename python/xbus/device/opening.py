"""Opening the port of a device."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import serial

from xbus.device.device import Device
from xbus.device.link import CAN_SCHEME, check_bid, open_can, open_link
from xbus.device.ports import find_ports
from xbus.log.legacy import Legacy, legacy_outputs
from xbus.protocol.products import DEFAULT_BAUDRATE
from xbus.protocol.values import StringType
from xbus.wire.strings import mask_of

if TYPE_CHECKING:
    from xbus.mtssp.bus import Bus
    from xbus.sim.buses import SimI2c, SimSpi
    from xbus.sim.device import SimulatedDevice

__all__ = ["connect", "restore_communication"]

#: Baud rates in the order in which the vendor's software tries them.
BAUDRATES = (115_200, 2_000_000, 921_600, 460_800, 230_400, 57_600, 38_400, 19_200, 9_600)
#: Bytes per second at 4 Mbaud, the highest rate.
MAX_BYTES_PER_SECOND = 400_000
#: Maximum length of the queue in seconds at that rate, which takes a gigabyte.
MAX_QUEUE_SECONDS = 2500


def connect(
    port: str | serial.SerialBase | SimulatedDevice | SimI2c | SimSpi | Bus | None = None,
    baudrate: int | None = None,
    *,
    bid: int = 0xFF,
    listen: bool = False,
    reconnect: bool = False,
    queue_seconds: float = 60.0,
    strings: Iterable[StringType | str] = (),
    legacy: Legacy | None = None,
) -> Device:
    """Opens the port of a device, and finds out its state without changing it.

    Listens first, and sends a request only if nothing is heard.

    Args:
        port: Name of a serial port, a pyserial URL (``socket://host:port``, ``rfc2217://...``), a
            pyserial object, a `SimulatedDevice`, or ``"sim:MTi-630"`` for one, also with options:
            ``"sim:MTi-630?noise=1&seed=2"``. ``"can:socketcan:can0"`` for the MTi-600 devices on a CAN
            bus, through any interface of python-can: ``can:INTERFACE:CHANNEL``, with the options
            ``?bitrate=500000``, ``&ids=0x100`` for each device (as ``xbus decode --ids``), ``&rate=100`` as
            in `xbus.read_can`, and those of python-can. CAN is read only. For the 1-series on I²C and SPI
            ``"i2c:/dev/i2c-1@0x6b"``, ``"spi:/dev/spidev0.0"``, ``"ftdi-i2c:URL@0x6b"``, ``"ftdi-spi:URL"``,
            or a bus of `xbus.mtssp` or `xbus.sim`. None: the one port of this machine with the USB
            identifiers of Xsens.
        baudrate: Bits per second. None: tries the rates that devices use, one after the other; on a CAN bus
            250,000.
        bid: Bus identifier of the device; 0xFF and 1 are the same device. On a CAN bus, the place of the
            device in ``ids``, from 1, and 0xFF for all.
        listen: Whether nothing may ever be sent: for a line that is only tapped, or a device that another
            program has configured. Commands then raise `StateError`. With `baudrate`, and on a port that has
            none, a silent device is no error: it may be switched on later.
        reconnect: Whether to wait for a device that is unplugged while its samples are read, and to bring it
            back into Measurement State; `Device.notices` then has the gap. The device is recognised by its
            identifier, if that has been read. Otherwise `Disconnected` is raised at once.
        queue_seconds: Seconds for which a program may read nothing and lose nothing, at 4 Mbaud; longer at a
            lower rate. Older data is dropped and counted.
        strings: Strings that only their length distinguishes from noise, to be found from the start:
            ``["EM1000"]``. All others are always found; so is EM1000 after the device was asked for its
            strings.
        legacy: OutputMode and OutputSettings of MTData, the output of legacy devices, as for `read_log`.
            Needed only with `listen`: otherwise the device is asked when its first sample is read.

    Returns:
        The open device, which is also a context manager that closes the port.

    Raises:
        XbusTimeout: Nothing was heard.
        OSError: The port cannot be opened.
        ImportError: The extra for this port is not installed.
        ValueError: No port was given, and none or several have the USB identifiers of Xsens; or no string
            type has a given name.

    >>> import xbus
    >>> xbus.connect("sim:MTi-680G")
    <Device sim:MTi-680G at 115200 baud, MTi-680G-8A1G6, measurement>
    """
    if not 0 < queue_seconds <= MAX_QUEUE_SECONDS:
        raise ValueError(
            f"queue_seconds must be from 0 to {MAX_QUEUE_SECONDS}, not {queue_seconds}"
        )
    outputs = legacy_outputs(legacy)
    bound, mask = int(queue_seconds * MAX_BYTES_PER_SECOND), mask_of(strings)
    port = _only_port() if port is None else port
    if isinstance(port, str) and port.startswith(CAN_SCHEME):
        return _connect_can(
            port, baudrate, bid=bid, bound=bound, listen=listen, reconnect=reconnect
        )
    link = open_link(port, baudrate or DEFAULT_BAUDRATE, bid=bid, bound=bound, strings=mask)
    if baudrate is not None and link.baudrate is None:
        link.close()
        raise ValueError(f"{link.name} has no baud rate; leave it out (no --baudrate)")
    device = Device(link, listen=listen, reconnect=reconnect)
    rates: tuple[int | None, ...]
    rates = BAUDRATES if link.is_line else (link.baudrate,)
    if listen and (baudrate or not link.is_line):
        link.acquisition.give_outputs(outputs)
        return device
    try:
        device.find_baudrate((baudrate,) if baudrate else rates, restart=True)
        if outputs:
            link.acquisition.give_outputs(outputs)
    except BaseException:
        device.close()
        raise
    return device


def _connect_can(
    port: str, bitrate: int | None, *, bid: int, bound: int, listen: bool, reconnect: bool
) -> Device:
    check_bid(bid)
    link = open_can(port, bitrate, bid=bid, bound=bound)
    device = Device(link, listen=True, reconnect=reconnect)
    if not listen:
        try:
            link.wait_for_device()
        except BaseException:
            device.close()
            raise
    return device


def restore_communication(
    port: str | serial.SerialBase | SimulatedDevice, timeout: float = 30.0, *, bid: int = 0xFF
) -> Device:
    """Opens the port of a device that does not answer, and recovers it: see `Device.restore_communication`.

    Args:
        port: As for `connect`.
        timeout: Seconds in which the device must be powered off and on.
        bid: As for `connect`.

    Returns:
        The open device, in Config State.

    Raises:
        XbusTimeout: No device woke up.
        OSError: The port cannot be opened.

    >>> import xbus
    >>> mti = xbus.SimulatedDevice("MTi-300", baudrate=460800)
    >>> mti.power_cycle()
    >>> xbus.restore_communication(mti)
    <Device sim:MTi-300 at 115200 baud, product not read yet, config>
    """
    device = Device(open_link(port, DEFAULT_BAUDRATE, bid=bid))
    try:
        device.restore_communication(timeout)
    except BaseException:
        device.close()
        raise
    return device


def _only_port() -> str:
    ports = find_ports()
    likely = [port.device for port in ports if port.likely]
    if len(likely) == 1:
        return likely[0]
    count = "several ports have" if likely else "no port has"
    names = [repr(name) for name in likely or [port.device for port in ports]]
    choices = " or ".join([*names, "'sim:MTi-630' (a virtual device)"])
    raise ValueError(f"{count} the USB identifiers of Xsens; pass {choices}")
