"""The settings of a device that several pages show and change."""

from __future__ import annotations

import contextlib
import threading
import time
from typing import NamedTuple

from xbus.device import Applied, Device, Settings
from xbus.device.baudrate import restart
from xbus.device.settings import Plan, apply_plan, plan_settings, read_settings
from xbus.errors import XbusError, XbusTimeout
from xbus.protocol.values import PortProtocol
from xbus.studio.exchange import Exchange

__all__ = ["DeviceSettings", "Reading", "SettingsChanged"]


class SettingsChanged(ValueError):  # noqa: N818 - the name is clear without a suffix
    """The device no longer has the settings that a page started from. Nothing was sent."""


class Reading(NamedTuple):
    """The settings that a device reported.

    Attributes:
        settings: All its settings.
        time: When they were read, in seconds since 1970.
        settings_sent: `Exchange.settings_sent` then.
    """

    settings: Settings
    time: float
    settings_sent: int


class DeviceSettings:
    """Reads and changes the settings of a device, for one page at a time.

    Args:
        device: The device.
        exchange: The messages between studio and device.
        check_baudrate: Whether the line must carry what the device would send.

    Attributes:
        reading: The last reading, by any page; None before the first one.
    """

    def __init__(self, device: Device, exchange: Exchange, *, check_baudrate: bool) -> None:
        self.device = device
        self.reading: Reading | None = None
        self._exchange = exchange
        self._check_baudrate = check_baudrate
        self._changing = threading.RLock()

    @property
    def is_outdated(self) -> bool:
        """Whether something that is not a page of settings may have changed them since the last reading."""
        if self.reading is None or not self._changing.acquire(blocking=False):
            return False  # a page is changing them
        self._changing.release()
        return self.reading.settings_sent != self._exchange.settings_sent

    def read(self) -> Reading:
        """Reads all settings.

        Raises:
            XbusError: The device does not answer, or is gone.
        """
        with self._changing, self.device.configure():
            return self._read()

    def plan(self, settings: Settings, before: Settings) -> Plan:
        """Returns what would change on a device that has the settings ``before``. Nothing is sent.

        Of settings for another product, those that the device cannot have are left out.
        """

        def plan(*, force: bool) -> Plan:
            return plan_settings(
                self.device,
                settings,
                before=before,
                check_baudrate=self._check_baudrate,
                force=force,
            )

        planned = plan(force=False)
        return plan(force=True) if planned.is_other_product else planned

    def apply(self, settings: Settings, before: Settings) -> Applied:
        """Changes settings, and reads all of them again.

        Args:
            settings: The settings that the device should have.
            before: The settings that it has, as the page shows them.

        Raises:
            SettingsChanged: The device has other settings than ``before``; `reading` has them.
            ValueError: Something cannot be applied. Nothing was sent.
            XbusError: The device refused a setting, does not answer, or is gone.
        """
        with self._changing, self.device.configure():
            present = self._read().settings
            if present != before:
                names = ", ".join(change.name for change in before.diff(present)) or "settings"
                raise SettingsChanged(
                    f"{names} changed on the device meanwhile, nothing was sent; look at the changes, and"
                    " apply again"
                )
            plan = self.plan(settings, present)
            if plan.problems:
                raise ValueError("\n".join(plan.problems))
            try:
                applied = apply_plan(self.device, plan)
            except XbusError:
                with contextlib.suppress(XbusError):  # the first error says what was applied
                    self._read()
                raise
            self._read()
            return applied

    def restart(self) -> None:
        """Restarts the device, so that ports and CAN change, and reads the settings again.

        Raises:
            XbusError: The device does not come back.
        """
        with self._changing, self.device.configure():
            link, rates = self.device.link, self._rates_after_restart()
            try:
                restart(self.device, next(iter(rates), link.baudrate))
            except XbusTimeout:
                # Several ports have several rates, and which one this is cannot be asked.
                self.device.find_baudrate([*rates, link.baudrate])
                self.device.go_to_config()
            self._read()

    def _rates_after_restart(self) -> list[int]:
        """Returns the baud rates that the port can have after a restart, the most probable first."""
        now = self.device.link.baudrate
        if now is None:
            return []
        settings = read_settings(self.device)
        ports = settings.port_config
        rates = (
            [settings.baudrate]
            if ports is None
            else [port.baudrate for port in ports if port.protocol == PortProtocol.XBUS]
        )
        return sorted({rate for rate in rates if rate is not None}, key=lambda rate: rate != now)

    def restore_factory_settings(self) -> None:
        """Restores the factory defaults, restarts the device, and reads the settings again.

        Raises:
            XbusError: The device does not come back.
        """
        with self._changing, self.device.configure():
            self.device.restore_factory_settings()
            self._read()

    def set_baudrate(self, baudrate: int) -> None:
        """Changes the baud rate of device and port, and reads the settings again.

        Raises:
            ValueError: The product does not have the rate. Nothing was sent.
            XbusError: The device does not come back.
        """
        with self._changing, self.device.configure():
            self.device.set_baudrate(baudrate)
            self._read()

    def _read(self) -> Reading:
        sent = (
            self._exchange.settings_sent
        )  # before reading: what is sent meanwhile may come too late
        self.reading = Reading(read_settings(self.device), time.time(), sent)
        return self.reading
