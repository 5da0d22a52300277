"""The machine as the checks see it."""

from __future__ import annotations

import getpass
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from xbus.device.ports import SYSFS, Port, find_ports

__all__ = ["DISTRIBUTION", "Machine"]

#: Name of the distribution that installs the package `xbus`.
DISTRIBUTION = "xbus-mti"


def _version(distribution: str) -> str | None:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def _requirements() -> list[str] | None:
    try:
        return metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        return None


def _providers() -> list[str]:
    return sorted(set(metadata.packages_distributions().get("xbus", ())))


def _may_use(path: Path) -> bool:
    return os.access(path, os.R_OK | os.W_OK)


def _user() -> str:
    try:
        return getpass.getuser()
    except (ImportError, KeyError, OSError):  # a container can lack the account
        return ""


@dataclass(frozen=True)
class Machine:
    """The machine as the checks see it. Tests replace its parts.

    Attributes:
        root: The folder that stands for ``/``: files of Linux are read below it.
        find_ports: Returns the serial ports.
        may_use: Returns whether this process may read and write a file.
        user: Name of the user.
        version: Returns the version of an installed distribution; None if it is not installed.
        requirements: Returns the requirements of xbus as in its metadata; None without metadata, as in a
            checkout that is not installed.
        providers: Returns the names of the distributions that install a package `xbus`.
    """

    root: Path = Path("/")
    find_ports: Callable[[], Iterable[Port]] = find_ports
    may_use: Callable[[Path], bool] = _may_use
    user: Callable[[], str] = _user
    version: Callable[[str], str | None] = _version
    requirements: Callable[[], list[str] | None] = _requirements
    providers: Callable[[], list[str]] = _providers

    def at(self, path: str | Path) -> Path:
        """Returns an absolute path below the root."""
        return self.root / Path(path).relative_to(Path(path).anchor)

    def read(self, path: str | Path) -> str | None:
        """Returns the text of a file without white space at its ends; None if it cannot be read."""
        try:
            return self.at(path).read_text("utf-8", "replace").strip()
        except OSError:
            return None

    @property
    def usb_serial(self) -> Path:
        """The folder with the adapters that have a serial driver."""
        return self.at(SYSFS)

    def processes(self) -> Iterator[tuple[int, str]]:
        """Yields number and name of the processes, where the system lists them in ``/proc``."""
        for folder in _entries(self.at("/proc")):
            if folder.name.isdecimal() and (name := self.read(f"/proc/{folder.name}/comm")):
                yield int(folder.name), name

    def users_of(self, port: str) -> Iterator[tuple[int, str]]:
        """Yields number and name of the other processes that have a port open.

        Processes of other users are not visible to every user.
        """
        name = str(Path(port).resolve())
        for number, program in self.processes():
            if number != os.getpid() and any(
                _target(file) == name for file in _entries(self.at(f"/proc/{number}/fd"))
            ):
                yield number, program


def _entries(folder: Path) -> list[Path]:
    """Returns what is in a folder, sorted; empty if it cannot be read."""
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []


def _target(link: Path) -> str | None:
    try:
        return str(link.readlink())
    except OSError:  # the process has closed it, or ended
        return None
