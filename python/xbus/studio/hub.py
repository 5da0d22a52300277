"""The devices that the studio has open. Pages come and go; the hub stays."""

from __future__ import annotations

import threading
from pathlib import Path

from xbus.describe.failures import port_failure
from xbus.errors import XbusError
from xbus.protocol.tables import PRODUCTS
from xbus.studio.station import SIMULATED, Station

__all__ = ["Hub", "HubError", "virtual_sources"]


class HubError(Exception):
    """Something could not be done; the text is one sentence with the remedy."""


class Hub:
    """Devices by the name of their port.

    Args:
        folder: Folder for recordings.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lock = threading.Lock()
        self._stations: dict[str, Station] = {}
        self._opening: set[str] = set()

    @property
    def stations(self) -> dict[str, Station]:
        """The open devices, by the name of their port, in the order in which they were opened."""
        with self._lock:
            return dict(self._stations)

    def open(self, source: str, baudrate: int | None = None) -> Station:
        """Opens a device, or returns the one that is open already.

        Args:
            source: A port, or ``sim:PRODUCT``.
            baudrate: Bits per second; None to try the usual rates.

        Raises:
            HubError: It cannot be opened.
        """
        with self._lock:
            if (station := self._stations.get(source)) is not None:
                return station
            if source in self._opening:
                raise HubError(f"{source} is being opened; wait a moment")
            self._opening.add(source)
        try:
            station = Station(source, baudrate)
        except XbusError as error:
            raise HubError(str(error)) from error
        except OSError as error:
            raise HubError(port_failure(source, error)) from error
        except ValueError as error:
            raise HubError(f"cannot open {source}: {error}") from error
        finally:
            with self._lock:
                self._opening.discard(source)
        with self._lock:
            self._stations[source] = station
        return station

    def close(self, source: str) -> None:
        """Closes a device; a recording is ended in order."""
        with self._lock:
            station = self._stations.pop(source, None)
        if station is not None:
            station.close()

    def close_all(self) -> None:
        """Closes all devices."""
        for source in self.stations:
            self.close(source)


def virtual_sources() -> list[str]:
    """Returns the names of the virtual devices."""
    return [f"{SIMULATED}{product.name}" for product in PRODUCTS.values()]
