"""The settings of a device as one value: written as TOML, read from it, and compared."""

from __future__ import annotations

import contextlib
import difflib
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from dataclasses import field as attribute
from typing import Any, NamedTuple

from xbus.device.settings.toml import ROTATIONS, ROWS, TEXT, entry, name_of, toml
from xbus.protocol import values as v
from xbus.protocol.messages import LAYOUTS
from xbus.protocol.products import find_product, support

__all__ = ["Change", "Settings"]

#: Lines of a list that are looked at for its entries, each of them with all before it: no device has as many.
LOOKED_AT = 100


@dataclass(frozen=True)
class Settings:
    """The settings of a device. None: the product does not have it, or it is to stay as it is.

    The initial heading is not among them: it can be set and not be read.

    Attributes:
        product: Name of the product.
        output_configuration: Lines, with the rates in effect.
        filter_profile: Name, on the 600-series names joined by ``/``; a number where it has no name.
        option_flags: The flags that are set.
        rot_sensor: q0, q1, q2, q3.
        rot_local: q0, q1, q2, q3.
        sync_settings: What the synchronization lines do.
        location_id: The user's number.
        string_output_type: Strings that take the place of MTData2.
        period: Sampling period of strings, 1/115200 s (10- and 100-series).
        output_skip_factor: Strings left out between two (10- and 100-series).
        lat_lon_alt: The stored place: degrees, degrees, metres.
        gnss_lever_arm: From the device to the antenna, m.
        gnss_platform: Dynamic model of the GNSS receiver.
        gnss_receiver_settings: How the device talks to its receiver.
        can_config: CAN transceiver.
        can_output_config: What is sent on the CAN bus.
        ext_output_mode: Extended output mode.
        transmit_delay: In ticks of 1/29.4912 MHz.
        error_mode: 0 to 3.
        port_config: The three ports of the 600-series.
        baudrate: Bits per second, for information, on products without ``port_config``.
        lines: Where each came from in a file: the line of the key, and that of each entry.

    >>> import xbus
    >>> settings = xbus.connect("sim:MTi-630").settings()
    >>> settings.filter_profile, settings.location_id
    ('Responsive/NorthReference', 0)
    >>> Settings.from_toml(settings.to_toml()) == settings
    True
    """

    product: str | None = None
    output_configuration: tuple[v.Output, ...] | None = None
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
    lines: Mapping[str, Sequence[int]] = attribute(default_factory=dict, compare=False, repr=False)

    def to_toml(self) -> str:
        """The settings as text, in the words of the manual, with a comment above each.

        >>> print(Settings(location_id=7).to_toml(), end="")
        # Settings of an Xsens MTi. What is left out, or put behind a #, stays as it is.
        <BLANKLINE>
        # The user's number, 0 to 65535
        location_id = 7
        """
        name = self.product or "Xsens MTi"
        parts = [f"# Settings of an {name}. What is left out, or put behind a #, stays as it is.\n"]
        if self.product is not None:
            parts.append(f"product = {toml(self.product)}\n")
        there = _there(self.product)
        for key, row in ROWS.items():
            if (value := getattr(self, key)) is not None:
                note = f"\n# {row.note.format_map(there)}\n" if row.note else ""
                parts.append(f"{note}{entry(key, value)}\n")
        return "".join(parts)

    @classmethod
    def from_toml(cls, text: str) -> Settings:
        """The settings that a text describes.

        Raises:
            ValueError: It is no TOML, or a key or value means nothing; the message says in which line.

        >>> Settings.from_toml('location_id = "seven"')
        Traceback (most recent call last):
        ValueError: line 1, location_id: "seven" is not a whole number
        """
        try:
            table = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise ValueError(_located(str(error), text)) from None
        except RecursionError:
            raise ValueError("it is nested deeper than any setting") from None
        found: dict[str, Any] = {}
        lines: dict[str, Sequence[int]] = {}
        for key, plain in table.items():
            lines[key] = _lines(text, key, plain)
            if key == "product":
                found[key] = _at(lines[key], key, TEXT.read, plain)
            elif key not in ROWS:
                line = f"line {lines[key][0]}, {key}: "
                near = difflib.get_close_matches(key, ROWS, n=1)
                hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(ROWS)}"
                raise ValueError(f"{line}no setting is called so; {hint}")
            else:
                found[key] = _read(key, plain, lines[key])
        return cls(**found, lines=lines)

    def diff(self, other: Settings) -> tuple[Change, ...]:
        """What is otherwise in ``other``; what is None there is left out.

        >>> Settings(location_id=1).diff(Settings(location_id=2))
        (Change(name='location_id', before=1, after=2),)
        """
        return tuple(
            Change(key, getattr(self, key), wanted)
            for key in ROWS
            if (wanted := getattr(other, key)) is not None and wanted != getattr(self, key)
        )


class Change(NamedTuple):
    """One setting that changes; as text, the lines of a file that go and come.

    Attributes:
        name: Which, an attribute of `Settings`.
        before: What it was; None where it was not there.
        after: What it is to be.
    """

    name: str
    before: Any
    after: Any

    def __str__(self) -> str:
        before = [] if self.before is None else entry(self.name, self.before).splitlines()
        after = entry(self.name, self.after).splitlines()
        lines = [it for it in difflib.ndiff(before, after) if it[0] in "+-"]
        if len(before) > 1 and len(after) > 1:
            lines.insert(0, f"  {self.name}")
        return "\n".join(lines)


# Text


def _there(product: str | None) -> Mapping[str, str]:
    """What a product has, for comments."""
    try:
        known = support(find_product(product or ""))
    except ValueError:
        return dict.fromkeys(("filter_profiles", "option_flags", "string_types"), "see the manual")
    return {
        "filter_profiles": ", ".join(it.label for it in known.filter_profiles),
        "option_flags": ", ".join(map(name_of, known.option_flags)),
        "string_types": ", ".join(map(name_of, known.string_types)),
    }


def _located(error: str, text: str) -> str:
    """What tomllib says, with the line in front."""
    what, _, where = error.rpartition(" (at ")
    found = re.match(r"line (\d+)", where)
    line = int(found[1]) if found else max(1, len(text.splitlines()))
    return f"line {line}: {what[0].lower()}{what[1:]}; this is no TOML"


def _lines(text: str, key: str, plain: Any) -> list[int]:
    """The line of a key, and of each entry of its list; far down, that of the key."""
    lines = text.splitlines()
    pattern = re.compile(rf"\s*\[*\s*[\"']?{re.escape(key)}[\"']?\s*[\].=]")
    begins = [at for at, line in enumerate(lines) if pattern.match(line)] or [0]
    first = begins[0]
    if not isinstance(plain, list):
        return [first + 1]
    if len(begins) > 1:  # [[key]] for each
        return [first + 1, *(it + 1 for it in begins)]
    found = [first + 1]
    for end in range(first + 1, min(len(lines), first + LOOKED_AT) + 1):
        if len(found) > len(plain):
            break
        # What is there up to this line, with the list closed here, or where it is closed.
        for closing in ("\n]", ""):
            with contextlib.suppress(tomllib.TOMLDecodeError):
                so_far = tomllib.loads("\n".join(lines[first:end]) + closing).get(key, ())
                found += [end] * (len(so_far) + 1 - len(found))
    return found + found[:1] * (len(plain) + 1 - len(found))


def _at(lines: Sequence[int], key: str, read: Callable[[Any], Any], it: Any) -> Any:
    """What is read, or an error that says where."""
    try:
        return read(it)
    except ValueError as error:
        raise ValueError(f"line {lines[0]}, {key}: {error}") from None


def _read(key: str, plain: Any, lines: Sequence[int]) -> Any:
    """The value of a setting, as it arrives at the device."""
    form = ROWS[key].form
    if isinstance(plain, list) and plain and isinstance(plain[0], dict):
        for line, it in zip(lines[1:], plain, strict=True):  # the first that is wrong says its line
            _at([line], key, form.read, [it])
    return _at(lines, key, lambda it: _on_the_wire(key, form.read(it)), plain)


def _on_the_wire(key: str, value: Any) -> Any:
    """The same, in the numbers that the message has room for."""
    if key in ("filter_profile", "baudrate"):
        return value
    message = ROWS[key].message
    layout = LAYOUTS.get(f"Req{message}Ack") or LAYOUTS[message]
    if key in ROTATIONS:
        rotation = v.AlignmentRotation(ROTATIONS[key], value)
        return layout.decode(layout.encode(rotation)).quaternion
    return layout.decode(layout.encode(value))
