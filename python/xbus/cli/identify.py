"""``xbus identify``: the device on a port, and the result of its self-test."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from xbus.cli.connection import baudrate_option, connect_device
from xbus.cli.failure import Failure
from xbus.cli.printing import align, print_json, print_line
from xbus.errors import DeviceError, StateError, XbusTimeout
from xbus.formatting import device_name, printable

if TYPE_CHECKING:
    from xbus.device import Device
    from xbus.protocol.values import Selftest

__all__ = ["identify"]

#: Components of every product, by the prefix of their flags.
SENSORS = {"ACC": "accelerometer", "GYR": "gyroscope", "MAG": "magnetometer"}


@click.command(epilog="Example: xbus identify /dev/ttyUSB0 --json")
@click.argument("port")
@baudrate_option
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object.")
def identify(port: str, baudrate: int | None, as_json: bool) -> None:
    """Identifies a device and runs its self-test.

    A device that measures stops for a moment. The exit status is 1 if a component fails its self-test.

    PORT is a serial port, a pyserial URL (socket://HOST:PORT), a bus (i2c:/dev/i2c-1, spi:/dev/spidev0.0), or
    sim:PRODUCT for a virtual device.
    """
    with connect_device(port, baudrate) as device, device.configure():
        components, reason = _selftest(device)
        hardware = device.hardware_version
        facts: dict[str, Any] = {
            "port": device.link.name,
            "baudrate": device.link.baudrate,
            "product": None if device.product is None else device.product.title,
            "product_code": device.product_code,
            "device_id": None if device.device_id is None else device_name(device.device_id),
            "firmware": None if device.firmware is None else str(device.firmware),
            "build": None if device.firmware is None else device.firmware.build,
            "hardware": None if hardware is None else f"{hardware.major}.{hardware.minor}",
            "selftest": components,
        }
    failed = [
        name.replace("_", " ") for name, passed in (components or {}).items() if passed is False
    ]
    if as_json:
        print_json(facts)
    else:
        code = facts["product_code"]
        rate = "" if facts["baudrate"] is None else f" at {facts['baudrate']:,} baud"
        build = "" if facts["build"] is None else f" build {facts['build']}"
        rows = [
            ("port", facts["port"] + rate),
            ("product", facts["product"] or "unknown"),
            ("code", "none" if code is None else printable(code)),
            ("id", facts["device_id"] or "unknown"),
            ("firmware", "unknown" if facts["firmware"] is None else facts["firmware"] + build),
            ("hardware", facts["hardware"] or "unknown"),
            ("self-test", reason or ("failed" if failed else "passed")),
            *(
                (f"  {name.replace('_', ' ')}", "passed" if passed else "failed")
                for name, passed in (components or {}).items()
                if passed is not None
            ),
        ]
        print_line("\n".join(align(rows)))
    if failed:
        raise Failure(
            f"the self-test of {facts['port']} failed: {', '.join(failed)}; keep the device still and try"
            " again"
        )


def _selftest(device: Device) -> tuple[dict[str, bool | None] | None, str | None]:
    """Returns whether each component passed, or None and the reason why there is no result."""
    try:
        return _components(device.commands.run_selftest()), None
    except (DeviceError, StateError, XbusTimeout) as error:
        return None, f"no result: {error}"


def _components(result: Selftest) -> dict[str, bool | None]:
    """Returns whether each component passed; None if the flag is not set, as for a missing component."""
    found: dict[str, bool | None] = {}
    for flag in type(result):
        sensor, _, axis = str(flag.name).partition("_")
        passed = bool(result & flag)
        if sensor in SENSORS:
            found[f"{SENSORS[sensor]}_{axis.lower()}"] = passed
        else:
            found[sensor.lower()] = passed or None
    return found
