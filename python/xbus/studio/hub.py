"""The devices that the studio has open. Pages come and go; the hub stays."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Container
from itertools import count
from pathlib import Path

from xbus.describe.failures import port_failure
from xbus.device import find_ports
from xbus.errors import XbusError
from xbus.protocol.tables import PRODUCTS
from xbus.studio.replaying import REPLAY, source_label
from xbus.studio.station import SIMULATED, Station, key_of
from xbus.studio.view import RecordForm

__all__ = ["Hub", "HubError", "virtual_sources"]


class HubError(Exception):
    """Something could not be done; the text is one sentence with the remedy."""


class Hub:
    """Devices by the name of their port.

    Args:
        folder: Folder for recordings.

    Attributes:
        record_form: What was entered for the next recording.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.record_form = RecordForm()
        self._lock = threading.Lock()
        self._stations: dict[str, Station] = {}
        self._opening: set[str] = set()
        #: The names of all ports that were opened, by key.
        self._sources: dict[str, str] = {}

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
                raise HubError(f"{source_label(source)} is being opened; wait a moment")
            self._opening.add(source)
        try:
            station = Station(source, baudrate)
        except XbusError as error:
            raise HubError(str(error)) from error
        except OSError as error:
            if not source.startswith(REPLAY):
                raise HubError(port_failure(source, error)) from error
            reason = error.strerror or str(error)
            raise HubError(f"cannot replay {source_label(source)}: {reason}") from error
        except ValueError as error:
            action = "replay" if source.startswith(REPLAY) else "open"
            raise HubError(f"cannot {action} {source_label(source)}: {error}") from error
        finally:
            with self._lock:
                self._opening.discard(source)
        with self._lock:
            station.key = _unused(station.key, {each.key for each in self._stations.values()})
            self._stations[source] = station
            self._sources[station.key] = source
        return station

    def titled(self) -> dict[str, tuple[Station, str]]:
        """Returns the open devices and their titles by port.

        The same title is followed by the port, and that of a replay by its file.
        """
        titles = {source: (station, station.title) for source, station in self.stations.items()}
        count = Counter(title for _, title in titles.values())
        return {
            source: (
                station,
                f"{title}, {source_label(source)}"
                if count[title] > 1 or station.replaying is not None
                else title,
            )
            for source, (station, title) in titles.items()
        }

    def source_of(self, key: str) -> str | None:
        """Returns the name of the port with a key, open or not; None if this computer has none."""
        with self._lock:
            if key in self._sources:
                return self._sources[key]
        present = [*virtual_sources(), *(port.device for port in find_ports())]
        return next((source for source in present if key_of(source) == key), None)

    def close(self, source: str) -> str | None:
        """Closes a device; a recording is ended in order.

        Returns:
            The sentence about a recording that ended early, or None.
        """
        with self._lock:
            station = self._stations.pop(source, None)
        recording = None if station is None else station.close()
        return None if recording is None else recording.problem

    def close_all(self) -> list[str]:
        """Closes all devices, and returns the sentences about recordings that ended early."""
        return [problem for source in self.stations if (problem := self.close(source))]


def _unused(key: str, used: Container[str]) -> str:
    """Returns a key that no other device has: names that differ in a few characters give the same one."""
    key = key or "device"
    return next(
        name
        for number in count(1)
        if (name := key if number == 1 else f"{key}-{number}") not in used
    )


def virtual_sources() -> list[str]:
    """Returns the names of the virtual devices."""
    return [f"{SIMULATED}{product.name}" for product in PRODUCTS.values()]
