"""Checks of USB devices and of ModemManager, on Linux."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from xbus.device.ports import FTDI, is_xsens
from xbus.doctor.finding import Finding
from xbus.doctor.machine import Machine

__all__ = ["INSTALL_RULES", "UDEV_RULES", "check_modem_manager", "check_usb", "has_modem_manager"]

#: Rules that let users open the ports of Xsens devices, keep ModemManager away and set latency timers.
UDEV_RULES = Path(__file__).with_name("70-xsens.rules")
#: The command that installs them.
INSTALL_RULES = (
    f"xbus doctor --udev-rules | sudo tee /etc/udev/rules.d/{UDEV_RULES.name}"
    " && sudo udevadm control --reload && sudo udevadm trigger"
)
RULES = ("/etc/udev/rules.d", "/run/udev/rules.d", "/usr/lib/udev/rules.d", "/lib/udev/rules.d")


def check_usb(machine: Machine) -> Iterator[Finding]:
    """Checks that each Xsens device has a driver, and each serial adapter a file in /dev."""
    for device in sorted(machine.at("/sys/bus/usb/devices").glob("*")):
        vendor, product = (_number(device / name) for name in ("idVendor", "idProduct"))
        if is_xsens(vendor, product) and not any(device.glob("*/tty*")):
            driver = "ftdi_sio" if vendor == FTDI else "xsens_mt"
            yield Finding(
                "driver",
                "problem",
                f"the USB device {vendor:04x}:{product:04x} of Xsens has no serial port: no driver uses it",
                f"sudo modprobe {driver}; if the kernel lacks this driver, install one that has it",
            )
    for adapter in sorted(machine.usb_serial.glob("*")):
        if not machine.at(f"/dev/{adapter.name}").exists():
            yield Finding(
                "driver",
                "problem",
                f"the kernel has the port {adapter.name}, but /dev/{adapter.name} does not exist here",
                f"start the container with --device /dev/{adapter.name}",
            )


def _number(path: Path) -> int | None:
    try:
        return int(path.read_text(), 16)
    except (OSError, ValueError):
        return None


def has_modem_manager(machine: Machine) -> bool | None:
    """Returns whether ModemManager runs; None where processes are not listed."""
    names = [name for _, name in machine.processes()]
    return "ModemManager" in names if names else None


def check_modem_manager(machine: Machine) -> Iterator[Finding]:
    """Checks that ModemManager does not run, or that udev rules keep it away from Xsens devices."""
    runs = has_modem_manager(machine)
    if runs is None:
        return
    if not runs:
        yield Finding("ModemManager", "ok", "ModemManager does not run")
    elif _is_kept_away(machine):
        yield Finding("ModemManager", "ok", "ModemManager runs, and ignores Xsens devices")
    else:
        yield Finding(
            "ModemManager",
            "warning",
            "ModemManager runs, and may send data to a device that was just plugged in",
            INSTALL_RULES,
        )


def _is_kept_away(machine: Machine) -> bool:
    texts = [
        machine.read(f"{folder}/{path.name}") or ""
        for folder in RULES
        for path in machine.at(folder).glob("*.rules")
    ]
    return any("2639" in text and "ID_MM_DEVICE_IGNORE" in text for text in texts)
