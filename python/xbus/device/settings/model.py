"""The settings of a device as one value: written as TOML, read from it, and compared."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from xbus.device.settings.converters import TEXT, member_name
from xbus.device.settings.table import SETTINGS, format_setting, value_on_wire, with_fields
from xbus.device.settings.toml import format_value, line_numbers, parse, shortened
from xbus.protocol import values as v
from xbus.protocol.products import find_product, support

__all__ = ["Change", "Settings"]

#: Maximum number of problems in one error.
MAX_PROBLEMS = 20


@dataclass(frozen=True)
class Settings:
    """The settings of a device. None: the product does not have the setting, or it is to stay as it is.

    Values are rounded to the precision of their message, float32 for most real numbers, so they equal what
    a device returns. The initial heading is not a setting here, because it cannot be read.

    Raises:
        ValueError: A value does not fit the message of its setting.

    Attributes:
        product: Name of the product.
        output_configuration: Outputs, with the rates in effect; also given as rates in Hz by quantity, as
            `Device.set_output_configuration` takes them.
        output_mode: Items of MTData, which legacy devices send.
        output_settings: Their form.
        filter_profile: Name, on the 600-series names joined by ``/``; a number if it has no name.
        option_flags: The flags that are set.
        rot_sensor: q0, q1, q2, q3.
        rot_local: q0, q1, q2, q3.
        sync_settings: Functions of the synchronization lines.
        location_id: A number that the user chose.
        string_output_type: Strings that replace MTData2.
        period: Sampling period of strings, in 1/115200 s (10- and 100-series).
        output_skip_factor: Strings skipped between two (10- and 100-series).
        lat_lon_alt: Stored position: degrees, degrees, metres.
        gnss_lever_arm: From the device to the antenna, in m.
        gnss_platform: Dynamic model of the GNSS receiver.
        gnss_receiver_settings: How the device communicates with its receiver.
        can_config: CAN transceiver.
        can_output_config: Outputs on the CAN bus.
        ext_output_mode: Extended output mode.
        transmit_delay: In ticks of 1/29.4912 MHz.
        error_mode: 0 to 3.
        port_config: The three ports of the 600-series.
        baudrate: Bits per second, for information, on products without ``port_config``.
        lines: Where the settings are in a file: the line of the key, and that of each entry of a list.

    >>> import xbus
    >>> settings = xbus.connect("sim:MTi-630").settings()
    >>> settings.filter_profile, settings.location_id
    ('Responsive/NorthReference', 0)
    >>> Settings.from_toml(settings.to_toml()) == settings
    True
    """

    product: str | None = None
    output_configuration: tuple[v.Output, ...] | None = None
    output_mode: v.OutputMode | None = None
    output_settings: v.OutputSettings | None = None
    filter_profile: int | str | None = None
    option_flags: v.OptionFlag | None = None
    rot_sensor: tuple[float, float, float, float] | None = None
    rot_local: tuple[float, float, float, float] | None = None
    sync_settings: tuple[v.SyncSetting, ...] | None = None
    location_id: int | None = None
    string_output_type: v.StringOutput | None = None
    period: int | None = None
    output_skip_factor: int | None = None
    lat_lon_alt: v.LatLonAlt | None = None
    gnss_lever_arm: v.GnssLeverArm | None = None
    gnss_platform: v.GnssPlatform | int | None = None
    gnss_receiver_settings: v.GnssReceiverSettings | None = None
    can_config: v.CanConfig | None = None
    can_output_config: tuple[v.CanOutput, ...] | None = None
    ext_output_mode: v.ExtOutputMode | None = None
    transmit_delay: int | None = None
    error_mode: int | None = None
    port_config: tuple[v.PortConfig, ...] | None = None
    baudrate: int | None = None
    lines: Mapping[str, Sequence[int]] = field(default_factory=dict, compare=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.product, str | None):
            raise ValueError(f"product: {self.product!r} is not text")  # noqa: TRY004 - as for the settings
        for name in SETTINGS:
            if (value := getattr(self, name)) is not None:
                try:
                    object.__setattr__(self, name, value_on_wire(name, with_fields(name, value)))
                except (TypeError, ValueError) as error:  # TypeError: a key that is no quantity
                    raise ValueError(f"{name}: {error}") from None

    def to_toml(self) -> str:
        """Returns the settings as TOML, with the names of the manual and a comment above each setting.

        Raises:
            ValueError: Text contains a lone surrogate, which TOML cannot represent.

        >>> print(Settings(location_id=7).to_toml(), end="")
        # Settings of an Xsens MTi. A setting that is left out, or commented out, stays as it is.
        <BLANKLINE>
        # A number of your choice, 0 to 65535
        location_id = 7
        """
        product = self.product or ""
        title = f"Settings of an {product if product.isprintable() and product else 'Xsens MTi'}"
        parts = [f"# {title}. A setting that is left out, or commented out, stays as it is.\n"]
        if self.product is not None:
            parts.append(f"product = {format_value(self.product)}\n")
        choices = _choices(self.product)
        for name, setting in SETTINGS.items():
            if (value := getattr(self, name)) is not None:
                comment = setting.comment.format_map(choices)
                parts.append(f"\n# {comment}\n" if comment else "")
                parts.append(f"{format_setting(name, value)}\n")
        return "".join(parts)

    @classmethod
    def from_toml(cls, text: str) -> Settings:
        """Returns the settings in TOML text.

        Raises:
            ValueError: The text is not TOML, or keys or values are wrong: one line for each, with its line
                in the text, up to 20.

        >>> Settings.from_toml('location_id = "seven"')
        Traceback (most recent call last):
        ValueError: line 1, location_id: "seven" is not a whole number
        """
        table = parse(text)
        lines = line_numbers(text)
        values: dict[str, Any] = {}
        problems: list[str] = []
        for name, found in table.items():
            try:
                values[name] = _read(name, found, lines[name])
            except ValueError as error:
                problems += str(error).splitlines()
        if problems:
            more = len(problems) - MAX_PROBLEMS
            rest = [f"and {more} more problems"] if more > 0 else []
            raise ValueError("\n".join(problems[:MAX_PROBLEMS] + rest))
        return cls(**values, lines=lines)

    def diff(self, other: Settings) -> tuple[Change, ...]:
        """Returns the settings that differ in `other`. A setting that is None there is left out.

        >>> Settings(location_id=1).diff(Settings(location_id=2))
        (Change(name='location_id', before=1, after=2),)
        """
        return tuple(
            Change(name, getattr(self, name), wanted)
            for name in SETTINGS
            if (wanted := getattr(other, name)) is not None and wanted != getattr(self, name)
        )


class Change(NamedTuple):
    """One setting that changes. As text: the lines of a file that are removed and added.

    Attributes:
        name: An attribute of `Settings`.
        before: The old value; None if there was none.
        after: The new value.
    """

    name: str
    before: Any
    after: Any

    def __str__(self) -> str:
        before = [] if self.before is None else format_setting(self.name, self.before).splitlines()
        after = format_setting(self.name, self.after).splitlines()
        lines = [line for line in difflib.ndiff(before, after) if line[0] in "+-"]
        if len(before) > 1 and len(after) > 1:
            lines.insert(0, f"  {self.name}")
        return "\n".join(lines)


def _choices(product: str | None) -> Mapping[str, str]:
    """Returns what a product offers, for the comments of a file."""
    try:
        known = support(find_product(product or ""))
    except ValueError:
        names = ("filter_profiles", "option_flags", "string_types", "output_modes")
        return dict.fromkeys(names, "see the manual")
    return {
        "filter_profiles": ", ".join(profile.label for profile in known.filter_profiles),
        "option_flags": ", ".join(map(member_name, known.option_flags)),
        "string_types": ", ".join(map(member_name, known.string_types)),
        "output_modes": ", ".join(map(member_name, known.output_modes)),
    }


def _located(line: int, name: str, read: Callable[[Any], Any], found: Any) -> Any:
    try:
        return read(found)
    except ValueError as error:
        raise ValueError(f"line {line}, {name}: {error}") from None


def _read(name: str, found: Any, lines: Sequence[int]) -> Any:
    """Returns the value of a setting, as in its message.

    Raises:
        ValueError: The value is wrong; for a list, one line for each wrong entry.
    """
    if name == "product":
        return _located(lines[0], name, TEXT.read, found)
    if name not in SETTINGS:
        near = difflib.get_close_matches(shortened(name), SETTINGS, n=1)
        hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(SETTINGS)}"
        where = f"line {lines[0]}, {shortened(name)}"
        raise ValueError(f"{where}: there is no setting of this name; {hint}")
    read = SETTINGS[name].converter.read
    if isinstance(found, list):
        # Entry by entry, so that the message names the line of the entry.
        wrong: dict[str, None] = {}  # ordered, and each once
        for line, entry in zip(lines[1:], found, strict=False):
            try:
                _located(line, name, read, [entry])
            except ValueError as error:
                wrong[str(error)] = None
        if wrong:
            raise ValueError("\n".join(wrong))
    return _located(lines[0], name, lambda found: value_on_wire(name, read(found)), found)
