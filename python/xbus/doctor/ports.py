"""Checks of the serial ports, which are not opened."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from xbus.device.link import MIN_LATENCY
from xbus.device.ports import Port, latency_timer
from xbus.doctor.finding import Finding
from xbus.doctor.machine import Machine
from xbus.doctor.usb import INSTALL_RULES

__all__ = ["PortState", "check_ports", "port_states"]


class PortState(NamedTuple):
    """A serial port, as far as it is known without opening it.

    Attributes:
        port: Its names.
        may_use: Whether this process may read and write it; None if the system does not say.
        group: The group that may use it; None if no group may, or the system has none.
        latency_timer: Latency timer of an FTDI adapter in ms; None if there is none.
        users: Number and name of other processes that have it open.
    """

    port: Port
    may_use: bool | None
    group: str | None
    latency_timer: int | None
    users: list[tuple[int, str]]


def port_states(machine: Machine) -> list[PortState]:
    """Returns the serial ports of the machine, Xsens ports first."""
    return [_state(machine, port) for port in machine.find_ports()]


def _state(machine: Machine, port: Port) -> PortState:
    name = port.device
    file = machine.at(name)
    if not file.exists():  # COM3
        return PortState(port, None, None, None, [])
    return PortState(
        port,
        machine.may_use(file),
        _group(machine, file),
        latency_timer(name, machine.usb_serial),
        list(machine.users_of(name)),
    )


def check_ports(machine: Machine, states: list[PortState]) -> Iterator[Finding]:
    """Checks that there is a port, and that this user can open each and gets its bytes at once."""
    if not states:
        remedy = "connect the device; without one, use the virtual port sim:MTi-630"
        if "microsoft" in (machine.read("/proc/version") or "").lower():
            remedy = (
                "attach the device to WSL with usbipd, in Windows: usbipd attach --wsl --busid ID"
            )
        yield Finding("ports", "warning", "no serial port was found", remedy)
    for state in states:
        findings = list(_check_port(machine, state))
        yield from findings or [Finding("ports", "ok", f"{state.port.device} is ready to use")]


def _check_port(machine: Machine, state: PortState) -> Iterator[Finding]:
    name, timer = state.port.device, state.latency_timer
    if state.may_use is False:
        yield Finding(
            "ports",
            "problem",
            f"{machine.user() or 'this user'} may not open {name}",
            _permit(machine, state),
        )
    for number, program in state.users:
        yield Finding(
            "ports", "problem", f"{program}, process {number}, has {name} open", f"close {program}"
        )
    if timer is not None and timer > MIN_LATENCY:
        yield Finding(
            "ports",
            "warning",
            f"the adapter of {name} holds bytes back for {timer} ms, until a program asks for low latency as"
            " xbus does",
            INSTALL_RULES,
        )


def _permit(machine: Machine, state: PortState) -> str:
    """Returns how the user gets permission to open a port."""
    if state.group is None:
        return INSTALL_RULES
    if machine.user() in _members(machine, state.group):
        return f"log out and in again: the group {state.group} counts from then on"
    return f'sudo usermod -aG {state.group} "$USER", then log out and in again'


def _groups(machine: Machine) -> Iterator[list[str]]:
    """Yields the fields of ``/etc/group``: name, password, number, members."""
    for line in (machine.read("/etc/group") or "").splitlines():
        if len(fields := line.split(":")) == 4:
            yield fields


def _group(machine: Machine, file: Path) -> str | None:
    """Returns the name of the group that may read and write a file; None if no ordinary group may."""
    status = file.stat()
    if status.st_gid == 0 or status.st_mode & 0o060 != 0o060:
        return None
    number = str(status.st_gid)
    return next((fields[0] for fields in _groups(machine) if fields[2] == number), None)


def _members(machine: Machine, group: str) -> list[str]:
    return [
        user for fields in _groups(machine) if fields[0] == group for user in fields[3].split(",")
    ]
