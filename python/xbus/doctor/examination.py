"""All checks, and the facts that a bug report needs."""

from __future__ import annotations

import platform
import re
import struct
import sys
from dataclasses import dataclass
from pathlib import Path

from xbus._core import __version__
from xbus.doctor.finding import Finding, Verdict, worst
from xbus.doctor.libraries import Library, check_installation, check_libraries, extras, required
from xbus.doctor.machine import DISTRIBUTION, Machine
from xbus.doctor.ports import PortState, check_ports, port_states
from xbus.doctor.usb import check_modem_manager, check_usb, has_modem_manager

__all__ = ["Examination", "examine"]


@dataclass(frozen=True)
class Examination:
    """What `examine` found.

    Attributes:
        xbus: Versions of the installed package (None if it runs from a checkout) and of its extension module,
            and the folder of the package.
        python: Version, implementation, bits and program of Python.
        system: Name and release of the system, machine, distribution of Linux, and C library.
        libraries: The libraries without which xbus does not run.
        extras: The libraries of each extra.
        ports: The serial ports, Xsens ports first.
        modem_manager: Whether ModemManager runs; None if the system does not say.
        findings: The results of the checks.
    """

    xbus: dict[str, str | None]
    python: dict[str, str | int]
    system: dict[str, str | None]
    libraries: list[Library]
    extras: dict[str, list[Library]]
    ports: list[PortState]
    modem_manager: bool | None
    findings: list[Finding]

    @property
    def verdict(self) -> Verdict:
        """The worst verdict of the findings."""
        return worst(self.findings)


def examine(machine: Machine | None = None) -> Examination:
    """Runs all checks. No port is opened, and nothing is changed.

    Args:
        machine: What to examine; None: this machine.
    """
    machine = machine or Machine()
    states = port_states(machine)
    return Examination(
        xbus={
            "version": machine.version(DISTRIBUTION),
            "core": __version__,
            "folder": _short(Path(__file__).parents[1]),
        },
        python={
            "version": platform.python_version(),
            "implementation": platform.python_implementation(),
            "bits": 8 * struct.calcsize("P"),
            "executable": _short(Path(sys.executable)),
        },
        system={
            "system": platform.system(),
            "release": platform.release(),
            "machine": platform.machine(),
            "distribution": _distribution(machine),
            "libc": " ".join(platform.libc_ver()).strip() or None,
        },
        libraries=required(machine),
        extras=extras(machine),
        ports=states,
        modem_manager=has_modem_manager(machine),
        findings=[
            *check_installation(machine),
            *check_libraries(machine),
            *check_usb(machine),
            *check_ports(machine, states),
            *check_modem_manager(machine),
        ],
    )


def _short(path: Path) -> str:
    """Returns a path that does not name the user."""
    try:
        return str("~" / path.relative_to(Path.home()))
    except (RuntimeError, ValueError):  # the user has no home, or the path is elsewhere
        return str(path)


def _distribution(machine: Machine) -> str | None:
    """Returns name and version of the distribution of Linux."""
    text = machine.read("/etc/os-release") or machine.read("/usr/lib/os-release") or ""
    found = re.search(r'^PRETTY_NAME="?([^"\n]*)', text, re.MULTILINE)
    return found and found[1]
