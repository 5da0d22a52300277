"""The settings of a device: the command of each, and how it stands in a file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from xbus.device.output_configuration import parse_output_configuration
from xbus.device.settings import converters
from xbus.device.settings.converters import Converter
from xbus.device.settings.toml import format_value
from xbus.protocol import values as v
from xbus.protocol.layout import Layout
from xbus.protocol.messages import LAYOUTS

__all__ = ["ROTATIONS", "SETTINGS", "Setting", "format_setting", "value_on_wire", "with_fields"]


class Setting(NamedTuple):
    """One setting.

    Attributes:
        message: Name of its messages, without ``Req`` and ``Set``.
        converter: How a file writes its value.
        comment: The comment above it in a file; empty if the comment before covers it.
    """

    message: str
    converter: Converter
    comment: str


#: By attribute of `Settings`, in the order of a file.
SETTINGS: dict[str, Setting] = {
    "output_configuration": Setting(
        "OutputConfiguration",
        converters.OUTPUT_CONFIGURATION,
        "Outputs, in the order of the message. frequency in Hz; without it, the highest, or every message",
    ),
    "output_mode": Setting(
        "OutputMode", converters.OUTPUT_MODE, "MTData: its items, of: {output_modes}"
    ),
    "output_settings": Setting(
        "OutputSettings", converters.OUTPUT_SETTINGS, "MTData: the form of its items"
    ),
    "filter_profile": Setting(
        "FilterProfile", converters.FILTER_PROFILE, "Filter profile, one of: {filter_profiles}"
    ),
    "option_flags": Setting(
        "OptionFlags", converters.OPTION_FLAGS, "Option flags that are set, of: {option_flags}"
    ),
    "rot_sensor": Setting(
        "AlignmentRotation",
        converters.ROTATION,
        "Alignment: output = RotLocal q RotSensor; q0, q1, q2, q3",
    ),
    "rot_local": Setting("AlignmentRotation", converters.ROTATION, ""),
    "sync_settings": Setting(
        "SyncSettings",
        converters.SYNC_SETTINGS,
        "Synchronization: functions and lines. pulse_width and offset in 0.1 ms (of clock_bias_estimation,"
        " in ms)",
    ),
    "location_id": Setting("LocationID", converters.INTEGER, "A number of your choice, 0 to 65535"),
    "string_output_type": Setting(
        "StringOutputType",
        converters.STRING_OUTPUT_TYPE,
        "Strings that replace samples, of: {string_types}",
    ),
    "period": Setting(
        "Period",
        converters.INTEGER,
        "Rate of strings and MTData: 115200 / period / (output_skip_factor + 1) Hz",
    ),
    "output_skip_factor": Setting("OutputSkipFactor", converters.INTEGER, ""),
    "lat_lon_alt": Setting(
        "LatLonAlt",
        converters.LAT_LON_ALT,
        "Stored position, for gravity and declination: degrees, degrees, metres",
    ),
    "gnss_lever_arm": Setting(
        "GnssLeverArm",
        converters.GNSS_LEVER_ARM,
        "From the device to the antenna, metres, in the axes of the device",
    ),
    "gnss_platform": Setting(
        "GnssPlatform", converters.GNSS_PLATFORM, "Dynamic model of the GNSS receiver"
    ),
    "gnss_receiver_settings": Setting(
        "GnssReceiverSettings",
        converters.GNSS_RECEIVER_SETTINGS,
        "How the device communicates with its GNSS receiver; rate in Hz",
    ),
    "can_config": Setting(
        "CanConfig", converters.CAN_CONFIG, "CAN transceiver; takes effect at the next reset"
    ),
    "can_output_config": Setting(
        "CanOutputConfig", converters.CAN_OUTPUT_CONFIG, "Outputs on the CAN bus; frequency in Hz"
    ),
    "ext_output_mode": Setting(
        "ExtOutputMode",
        converters.EXT_OUTPUT_MODE,
        "Extended output mode, of: alternative_uart, usb_low_latency; analog_euler_angles of an MTi or MTx",
    ),
    "transmit_delay": Setting(
        "TransmitDelay",
        converters.INTEGER,
        "Delay between request and answer on RS485, in 1/29.4912 MHz",
    ),
    "error_mode": Setting(
        "ErrorMode",
        converters.INTEGER,
        "Errors: 0 ignore, 1 count, 2 count and report, 3 report and stop",
    ),
    "port_config": Setting(
        "PortConfig",
        converters.PORT_CONFIG,
        "Ports: RS232, UART, RS232 for corrections; takes effect at the next reset",
    ),
    "baudrate": Setting(
        "Baudrate",
        converters.INTEGER,
        "Baud rate, for information: applying a file does not change it",
    ),
}

ROTATIONS = {"rot_sensor": v.Alignment.ROT_SENSOR, "rot_local": v.Alignment.ROT_LOCAL}


def format_setting(name: str, value: Any) -> str:
    """Returns ``name = value`` as TOML, with one line per entry of a list of tables.

    >>> print(format_setting("output_configuration", (v.Output(0x4020, 100),)))
    output_configuration = [
      { quantity = "acceleration", precision = "Float32", frequency = 100 },
    ]
    """
    plain = SETTINGS[name].converter.write(value)
    if plain and isinstance(plain, list) and isinstance(plain[0], dict):
        return "\n".join([f"{name} = [", *(f"  {format_value(entry)}," for entry in plain), "]"])
    return f"{name} = {format_value(plain)}"


#: Settings whose messages are laid out differently by each product.
_WITHOUT_LAYOUT = ("filter_profile", "baudrate")


def with_fields(name: str, value: Any) -> Any:
    """Returns the value of a setting as a record of named fields, if it is a plain tuple of them.

    Rates by quantity are returned as outputs.

    Raises:
        ValueError: The tuple has more or fewer values than the record has fields, or a quantity or rate is
            not valid.

    >>> with_fields("gnss_lever_arm", (0.1, 0.25, 1))
    GnssLeverArm(x=0.1, y=0.25, z=1)
    """
    if name == "output_configuration" and isinstance(value, Mapping):
        return parse_output_configuration(value)
    if type(value) is not tuple or name in ROTATIONS or name in _WITHOUT_LAYOUT:
        return value
    layout = _layout(name)
    if layout.several:
        return value
    if len(value) != len(layout.fields):
        raise ValueError(f"{value!r} does not have the fields {', '.join(layout.fields)}")
    return layout.make(*value)


def value_on_wire(name: str, value: Any) -> Any:
    """Returns the value of a setting with the precision that its message has.

    Most real numbers are float32 on the wire, so a device returns 0.1 as 0.10000000149011612.

    Raises:
        ValueError: The message cannot hold the value.

    >>> value_on_wire("gnss_lever_arm", v.GnssLeverArm(0.1, 0.25, 1))
    GnssLeverArm(x=0.10000000149011612, y=0.25, z=1.0)
    """
    if name in _WITHOUT_LAYOUT:  # not rounded
        return SETTINGS[name].converter.read(value)
    layout = _layout(name)
    if name in ROTATIONS:
        rotation = v.AlignmentRotation(ROTATIONS[name], value)
        return layout.decode(layout.encode(rotation)).quaternion
    return layout.decode(layout.encode(value))


def _layout(name: str) -> Layout:
    message = SETTINGS[name].message
    return LAYOUTS.get(f"Req{message}Ack") or LAYOUTS[message]
