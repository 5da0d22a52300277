"""The settings of a device as one value: read, written as TOML, compared, and applied.

A table has a row for each setting: the commands that read and set it, and how it is written in a file. What
is read, compared and applied goes by that table.
"""

from __future__ import annotations

import contextlib
import difflib
import inspect
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as attribute
from enum import IntEnum, IntFlag
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from xbus.codec import data_id_of
from xbus.device.checks import check
from xbus.device.output import check_fits
from xbus.errors import ApplyError, DeviceError, XbusError
from xbus.ids import Coordinates, Precision
from xbus.protocol import values as v
from xbus.protocol.messages import LAYOUTS
from xbus.protocol.products import Support, find_product, support

if TYPE_CHECKING:
    from xbus.device.device import Device

__all__ = [
    "Applied",
    "Change",
    "Plan",
    "Settings",
    "apply_settings",
    "compared",
    "plan",
    "read_settings",
]

# How values are written in a file


class Form(NamedTuple):
    """How a value is written: to what TOML has, and back; ``read`` raises ValueError."""

    write: Callable[[Any], Any]
    read: Callable[[Any], Any]


def _of_type(kind: type, words: str) -> Callable[[Any], Any]:
    def read(plain: Any) -> Any:
        if isinstance(plain, bool) != (kind is bool) or not isinstance(plain, kind):
            raise ValueError(f"{_toml(plain)} is not {words}")
        return plain

    return read


_read_whole = _of_type(int, "a whole number")
_read_text = _of_type(str, "text in quotes")
_read_list = _of_type(list, "a list")
_read_table = _of_type(dict, "a table, { key = value }")


def _read_real(plain: Any) -> float:
    if isinstance(plain, bool) or not isinstance(plain, int | float):
        raise ValueError(f"{_toml(plain)} is not a number")  # noqa: TRY004 - the text is wrong, not the call
    return float(plain)


WHOLE = Form(int, _read_whole)
TRUTH = Form(bool, _of_type(bool, "true or false"))
DOUBLE = Form(float, _read_real)
#: No more digits than it takes to tell it from other numbers of its width.
SINGLE = Form(lambda it: float(str(np.float32(it))), _read_real)


def _name(member: Any) -> str:
    return str(member.name) if isinstance(member, v.StringType) else str(member.name).lower()


def _member(kind: type[IntEnum] | type[IntFlag], plain: Any) -> Any:
    """The member of this name, in whichever case, or of this number."""
    if isinstance(plain, int) and not isinstance(plain, bool):
        return v.known(kind, plain) if issubclass(kind, IntEnum) else kind(plain)
    members = {name.lower(): it for name, it in kind.__members__.items()}
    if not isinstance(plain, str) or plain.lower() not in members:
        names = ", ".join(map(_name, kind.__members__.values()))
        raise ValueError(f"{_toml(plain)} is none of {names}")
    return members[plain.lower()]


def _choice(kind: type[IntEnum]) -> Form:
    return Form(
        lambda it: _name(it) if isinstance(it, kind) else int(it),
        lambda plain: _member(kind, plain),
    )


def _flags(kind: type[IntFlag]) -> Form:
    def write(flags: IntFlag) -> list[Any]:
        rest = int(flags) & ~sum(flags)
        return [*map(_name, flags), *([rest] if rest else [])]

    def read(plain: Any) -> IntFlag:
        found = kind(0)
        for it in _read_list(plain):
            found |= _member(kind, it)
        return found

    return Form(write, read)


def _record(make: Callable[..., Any], **forms: Form) -> Form:
    """A table; a field that has its default is left out."""
    parameters = inspect.signature(make).parameters

    def write(value: Any) -> dict[str, Any]:
        fields = {name: getattr(value, name) for name in forms}
        return {
            name: forms[name].write(it)
            for name, it in fields.items()
            if parameters[name].default is inspect.Parameter.empty or it != parameters[name].default
        }

    def read(plain: Any) -> Any:
        given = {}
        for name, it in _read_table(plain).items():
            if name not in forms:
                raise ValueError(f"there is no {name}; there are {', '.join(forms)}")
            try:
                given[name] = forms[name].read(it)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
        needed = [it for it in forms if parameters[it].default is inspect.Parameter.empty]
        if missing := [it for it in needed if it not in given]:
            raise ValueError(f"{', '.join(missing)} must be there")
        return make(**given)

    return Form(write, read)


def _with_baudrate(form: Form, rates: Mapping[int, int]) -> Form:
    """With ``baudrate`` in bits per second for ``baud_code``, where that says the same."""
    codes = {rate: code for code, rate in reversed(list(rates.items()))}

    def write(value: Any) -> dict[str, Any]:
        code = value.baud_code
        if codes.get(rates.get(code, 0)) != code:
            plain: dict[str, Any] = form.write(value)
            return plain
        return {
            "baudrate" if name == "baud_code" else name: rates[code] if name == "baud_code" else it
            for name, it in form.write(value).items()
        }

    def read(plain: Any) -> Any:
        table = dict(_read_table(plain))
        if "baudrate" in table:
            rate = _read_whole(table.pop("baudrate"))
            if rate not in codes:
                there = ", ".join(map(str, sorted(codes)))
                raise ValueError(f"baudrate: {rate} is none of {there}")
            table["baud_code"] = codes[rate]
        elif "baud_code" not in table:
            raise ValueError("baudrate must be there")
        return form.read(table)

    return Form(write, read)


def _several(form: Form) -> Form:
    return Form(
        lambda them: [form.write(it) for it in them],
        lambda plain: tuple(form.read(it) for it in _read_list(plain)),
    )


def _write_output(it: v.Output) -> dict[str, Any]:
    formats = {}
    if isinstance(it.coordinates, Coordinates):
        formats["coordinates"] = it.coordinates.name
    if it.precision is not None:
        formats["precision"] = it.precision.name
    frequency = {} if it.frequency == v.EVERY else {"frequency": it.frequency}
    name = it.quantity
    if name is None or data_id_of((name, *formats.values())) != it.data_id:
        return {"data_id": it.data_id, **frequency}
    return {"quantity": name, **formats, **frequency}


def _read_output(plain: Any) -> v.Output:
    table = dict(_read_table(plain))
    frequency = _read_whole(table.pop("frequency", v.EVERY))
    if "data_id" in table:
        data_id = _read_whole(table.pop("data_id"))
    elif "quantity" in table:
        words = [_read_text(table.pop("quantity"))]
        for key, kind in (("coordinates", Coordinates), ("precision", Precision)):
            if key in table:
                word = _read_text(table.pop(key))
                if word not in kind.__members__:
                    raise ValueError(f"{key}: {word!r} is none of {', '.join(kind.__members__)}")
                words.append(word)
        data_id = data_id_of(tuple(words))
    else:
        raise ValueError("quantity must be there")
    if table:
        keys = "quantity, coordinates, precision, frequency"
        raise ValueError(f"there is no {next(iter(table))}; there are {keys}")
    return v.Output(data_id, frequency)


def _read_quaternion(plain: Any) -> tuple[float, ...]:
    numbers = tuple(map(_read_real, _read_list(plain)))
    if len(numbers) != 4:
        raise ValueError(f"{_toml(plain)} is not q0, q1, q2, q3")
    return numbers


def _read_profile(plain: Any) -> int | str:
    if isinstance(plain, bool) or not isinstance(plain, int | str):
        raise ValueError(f"{_toml(plain)} is neither name nor number")  # noqa: TRY004
    return plain


OUTPUTS = Form(
    _several(Form(_write_output, _read_output)).write,
    _several(Form(_write_output, _read_output)).read,
)
ROTATION = Form(lambda it: [SINGLE.write(q) for q in it], _read_quaternion)
PROFILE = Form(lambda it: it, _read_profile)
PORTS = _several(
    _with_baudrate(
        _record(
            v.PortConfig,
            protocol=_choice(v.PortProtocol),
            baud_code=WHOLE,
            flow_control=TRUTH,
            two_stop_bits=TRUTH,
            parity=TRUTH,
            parity_even=TRUTH,
            reserved=WHOLE,
        ),
        v.BAUD_CODES,
    )
)
SYNC = _several(
    _record(
        v.SyncSetting,
        function=_choice(v.SyncFunction),
        line=_choice(v.SyncLine),
        polarity=_choice(v.Polarity),
        trigger_once=TRUTH,
        skip_first=WHOLE,
        skip_factor=WHOLE,
        pulse_width=WHOLE,
        offset=WHOLE,
    )
)
CAN = _with_baudrate(
    _record(v.CanConfig, baud_code=WHOLE, enabled=TRUTH, reserved=WHOLE), v.CAN_BAUD_CODES
)
CAN_OUTPUTS = _several(
    _record(
        v.CanOutput,
        data_id=_choice(v.CanDataId),
        extended=TRUTH,
        can_id=WHOLE,
        frequency=WHOLE,
    )
)
RECEIVER = _with_baudrate(
    _record(
        v.GnssReceiverSettings,
        receiver=_choice(v.GnssReceiver),
        baud_code=WHOLE,
        rate=WHOLE,
        options=WHOLE,
    ),
    v.BAUD_CODES,
)

# The settings


class Row(NamedTuple):
    """A setting: its commands are ``Req`` and ``Set`` and this name; how it is written; what it is."""

    message: str
    form: Form
    note: str


#: In the order of the file, by attribute of `Settings`; `ORDER` is that in which they are applied.
ROWS: dict[str, Row] = {
    "output_configuration": Row(
        "OutputConfiguration",
        OUTPUTS,
        "What is measured, in the order of the message. frequency in Hz; without it, the highest, or with"
        " every message",
    ),
    "filter_profile": Row("FilterProfile", PROFILE, "Filter profile, one of: {filter_profiles}"),
    "option_flags": Row(
        "OptionFlags", _flags(v.OptionFlag), "Option flags that are set, of: {option_flags}"
    ),
    "rot_sensor": Row(
        "AlignmentRotation", ROTATION, "Alignment: output = RotLocal q RotSensor; q0, q1, q2, q3"
    ),
    "rot_local": Row("AlignmentRotation", ROTATION, ""),
    "sync_settings": Row(
        "SyncSettings",
        SYNC,
        "Synchronization: functions and lines. pulse_width and offset in 0.1 ms (of"
        " clock_bias_estimation, in ms)",
    ),
    "location_id": Row("LocationID", WHOLE, "The user's number, 0 to 65535"),
    "string_output_type": Row(
        "StringOutputType",
        _record(v.StringOutput, types=_flags(v.StringType), frequency=WHOLE),
        "Strings in the place of samples, of: {string_types}",
    ),
    "period": Row(
        "Period", WHOLE, "Rate of strings: 115200 / period / (output_skip_factor + 1) Hz"
    ),
    "output_skip_factor": Row("OutputSkipFactor", WHOLE, ""),
    "lat_lon_alt": Row(
        "LatLonAlt",
        _record(v.LatLonAlt, lat=DOUBLE, lon=DOUBLE, alt=DOUBLE),
        "The stored place, for gravity and declination: degrees, degrees, metres",
    ),
    "gnss_lever_arm": Row(
        "GnssLeverArm",
        _record(v.GnssLeverArm, x=SINGLE, y=SINGLE, z=SINGLE),
        "From the device to the antenna, metres, in the axes of the device",
    ),
    "gnss_platform": Row(
        "GnssPlatform", _choice(v.GnssPlatform), "Dynamic model of the GNSS receiver"
    ),
    "gnss_receiver_settings": Row(
        "GnssReceiverSettings", RECEIVER, "How the device talks to its GNSS receiver; rate in Hz"
    ),
    "can_config": Row("CanConfig", CAN, "CAN transceiver; takes effect at the next reset"),
    "can_output_config": Row(
        "CanOutputConfig", CAN_OUTPUTS, "What is sent on the CAN bus; frequency in Hz"
    ),
    "ext_output_mode": Row(
        "ExtOutputMode",
        _flags(v.ExtOutputMode),
        "Extended output mode, of: alternative_uart, usb_low_latency",
    ),
    "transmit_delay": Row(
        "TransmitDelay", WHOLE, "Between a request and its answer on RS485, in 1/29.4912 MHz"
    ),
    "error_mode": Row(
        "ErrorMode", WHOLE, "Errors: 0 ignore, 1 count, 2 count and report, 3 report and stop"
    ),
    "port_config": Row(
        "PortConfig",
        PORTS,
        "Ports: RS232, UART, RS232 that takes corrections; takes effect at the next reset",
    ),
    "baudrate": Row(
        "Baudrate", WHOLE, "Baud rate, for information: applying leaves it; set_baudrate changes it"
    ),
}

_ROTATIONS = {"rot_sensor": v.Alignment.ROT_SENSOR, "rot_local": v.Alignment.ROT_LOCAL}
#: What is applied last: what changes who answers, and at which rate.
LAST = ("option_flags", "port_config")


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
            parts.append(f"product = {_toml(self.product)}\n")
        there = _there(self.product)
        for key, row in ROWS.items():
            if (value := getattr(self, key)) is not None:
                note = f"\n# {row.note.format_map(there)}\n" if row.note else ""
                parts.append(f"{note}{_entry(key, value)}\n")
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
        found: dict[str, Any] = {}
        lines: dict[str, Sequence[int]] = {}
        for key, plain in table.items():
            lines[key] = _lines(text, key, plain)
            if key == "product":
                found[key] = _at(lines[key], key, _read_text, plain)
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
        before = [] if self.before is None else _entry(self.name, self.before).splitlines()
        after = _entry(self.name, self.after).splitlines()
        lines = [it for it in difflib.ndiff(before, after) if it[0] in "+-"]
        if len(before) > 1 and len(after) > 1:
            lines.insert(0, f"  {self.name}")
        return "\n".join(lines)


# Text


def _toml(plain: Any) -> str:
    match plain:
        case bool():
            return str(plain).lower()
        case str():
            escaped = plain.replace("\\", "\\\\").replace('"', '\\"')
            return '"' + "".join(_escaped(it) for it in escaped) + '"'
        case dict():
            inside = ", ".join(f"{key} = {_toml(it)}" for key, it in plain.items())
            return f"{{ {inside} }}" if inside else "{}"
        case list():
            return f"[{', '.join(map(_toml, plain))}]"
    return str(plain)


def _escaped(letter: str) -> str:
    return letter if letter.isprintable() else f"\\U{ord(letter):08X}"


def _entry(key: str, value: Any) -> str:
    """``key = value``, a list of tables with a line each."""
    plain = ROWS[key].form.write(value)
    if plain and isinstance(plain, list) and isinstance(plain[0], dict):
        return "\n".join([f"{key} = [", *(f"  {_toml(it)}," for it in plain), "]"])
    return f"{key} = {_toml(plain)}"


def _there(product: str | None) -> Mapping[str, str]:
    """What a product has, for comments."""
    try:
        known = support(find_product(product or ""))
    except ValueError:
        return dict.fromkeys(("filter_profiles", "option_flags", "string_types"), "see the manual")
    return {
        "filter_profiles": ", ".join(it.label for it in known.filter_profiles),
        "option_flags": ", ".join(map(_name, known.option_flags)),
        "string_types": ", ".join(map(_name, known.string_types)),
    }


def _located(error: str, text: str) -> str:
    """What tomllib says, with the line in front."""
    what, _, where = error.rpartition(" (at ")
    found = re.match(r"line (\d+)", where)
    line = int(found[1]) if found else max(1, len(text.splitlines()))
    return f"line {line}: {what[0].lower()}{what[1:]}; this is no TOML"


def _lines(text: str, key: str, plain: Any) -> list[int]:
    """The line of a key, and of each entry of its list."""
    lines = text.splitlines()
    pattern = re.compile(rf"\s*\[*\s*[\"']?{re.escape(key)}[\"']?\s*[\].=]")
    begins = [at for at, line in enumerate(lines) if pattern.match(line)] or [0]
    first = begins[0]
    if not isinstance(plain, list):
        return [first + 1]
    if len(begins) > 1:  # [[key]] for each
        return [first + 1, *(it + 1 for it in begins)]
    found = [first + 1]
    for end in range(first + 1, len(lines) + 1):
        # What is there up to this line, with the list closed here, or where it is closed.
        for closing in ("\n]", ""):
            with contextlib.suppress(tomllib.TOMLDecodeError):
                so_far = tomllib.loads("\n".join(lines[first:end]) + closing).get(key, ())
                found += [end] * (len(so_far) + 1 - len(found))
    return found + [found[-1]] * (len(plain) + 1 - len(found))


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
    if key in _ROTATIONS:
        rotation = v.AlignmentRotation(_ROTATIONS[key], value)
        return layout.decode(layout.encode(rotation)).quaternion
    return layout.decode(layout.encode(value))


# From and to a device


def read_settings(device: Device) -> Settings:
    """All settings of a device that is in Config State; see `Device.settings`."""
    known = device.support
    product = known.product.name if known else device.product_code
    found = {key: _ask(device, key) for key in ROWS if known is None or _has(known, key)}
    if found.get("port_config") is not None:
        found["baudrate"] = None  # each port has its own
    return Settings(product=product, **found)


def _has(known: Support, key: str) -> bool:
    if key == "filter_profile":
        return bool(known.filter_profiles)
    return f"Req{ROWS[key].message}" in known.messages


def _ask(device: Device, key: str) -> Any:
    """A setting; None where the firmware does not know it."""
    try:
        if key in _ROTATIONS:
            return device.req_alignment_rotation(_ROTATIONS[key]).quaternion
        if key == "baudrate":
            return device.req_baudrate()
        value = device.command(f"Req{ROWS[key].message}").value
    except DeviceError as error:
        if error.code == v.ErrorCode.MESSAGE:
            return None
        raise
    if isinstance(value, v.FilterProfile):
        return _label(value.profile, device.support)
    return value


def _label(profile: int | str, known: Support | None) -> int | str:
    """The name of a filter profile, as the product writes it."""
    if known is not None and "SetFilterProfileModern" not in known.messages:
        for it in known.filter_profiles:
            if profile == it.type or str(profile).lower() == it.label.lower():
                return it.label
    return profile


class Plan(NamedTuple):
    """What has to be done so that a device has some settings.

    Attributes:
        before: What it has.
        changes: What would be set, in this order.
        impossible: What cannot be, and why: a sentence each.
    """

    before: Settings
    changes: tuple[Change, ...]
    impossible: tuple[str, ...]


@dataclass(frozen=True)
class Applied:
    """What was applied, or would be.

    Attributes:
        changes: What was set, each read back; of a dry run, what would be.
        rounded: Where the device has made something else of it: asked for, and in effect.
    """

    changes: tuple[Change, ...]
    rounded: tuple[Change, ...] = ()

    @property
    def needs_reset(self) -> bool:
        """Whether something takes effect at the next reset only."""
        return any(it.name in ("port_config", "can_config") for it in self.changes)


def plan(device: Device, settings: Settings, *, check_baudrate: bool = True) -> Plan:
    """What `apply_settings` would do; nothing is set. The device is in Config State."""
    before = read_settings(device)
    changes, impossible = [], []
    for change in _in_order(_differences(before, settings, device.support)):
        try:
            _check(device, change, settings, check_baudrate=check_baudrate)
            changes.append(change)
        except ValueError as error:
            impossible.append(str(error))
    return Plan(before, tuple(changes), tuple(impossible))


def compared(device: Device, settings: Settings) -> tuple[Change, ...]:
    """What is otherwise than on a device that is in Config State."""
    return _differences(read_settings(device), settings, device.support)


def _differences(before: Settings, settings: Settings, known: Support | None) -> tuple[Change, ...]:
    changes = before.diff(_effective(settings, known))
    return tuple(it for it in changes if not _is_in_effect(it, known))


def _is_in_effect(change: Change, known: Support | None) -> bool:
    """Whether these outputs would change nothing: of some quantities nobody can choose the rate."""
    if change.name != "output_configuration" or known is None:
        return False
    made = (
        known.acknowledged(it) if len(known.rates_of(it.quantity or "")) == 1 else it
        for it in change.after
    )
    return bool(tuple(made) == change.before)


def _effective(settings: Settings, known: Support | None) -> Settings:
    """The same in the words of the product, so that equal means equal."""
    if known is None:
        return settings
    changed: dict[str, Any] = {}
    if settings.filter_profile is not None:
        changed["filter_profile"] = _label(settings.filter_profile, known)
    if settings.output_configuration is not None:
        changed["output_configuration"] = tuple(
            known.acknowledged(it) or it if it.frequency in (0, v.EVERY) else it
            for it in settings.output_configuration
        )
    return replace(settings, **changed)


def _in_order(changes: Iterable[Change]) -> list[Change]:
    """The safe order: what changes who answers, and at which rate, comes last."""

    def place(change: Change) -> int:
        # While this flag is set nothing is stored.
        if change.name == "option_flags" and change.before and _stores_again(change):
            return -1
        return LAST.index(change.name) + 1 if change.name in LAST else 0

    return sorted(changes, key=place)


def _stores_again(change: Change) -> bool:
    flag = int(v.OptionFlag.DISABLE_AUTO_STORE)
    return bool(int(change.before) & ~int(change.after) & flag)


def _check(device: Device, change: Change, settings: Settings, *, check_baudrate: bool) -> None:
    """Whether the product can do it.

    Raises:
        ValueError: It cannot; the message says in which line.
    """
    key, value, known = change.name, change.after, device.support
    lines = settings.lines.get(key, ())
    head = f"line {lines[0]}, {key}: " if lines else f"{key}: "
    product = known.product.name if known else device.product_code or "device"
    if change.before is None:
        raise ValueError(f"{head}the {product} does not have it")
    if key == "period" and value not in v.PERIODS:
        # The device would make a skip factor of it, which is a setting of its own.
        least, most = v.PERIODS[0], v.PERIODS[-1]
        raise ValueError(
            f"{head}it must be from {least} to {most}, not {value}; output_skip_factor makes strings rarer"
        )
    if key == "baudrate":
        raise ValueError(f"{head}applying does not change it; set_baudrate({value}) does")
    try:
        name, sent = _message(change, known)
        if isinstance(sent, tuple) and not hasattr(sent, "_fields"):
            for line, it in zip(lines[1:], sent, strict=False):
                head = f"line {line}, {key}: "
                check(name, (it,), known)
            head = f"line {lines[0]}, {key}: " if lines else head
        device.session.validate(name, sent)
        if key == "output_configuration" and known and check_baudrate and device.link.is_line:
            check_fits(sent, known, device.link.baudrate)
    except ValueError as error:
        raise ValueError(f"{head}{error}") from None


def _message(change: Change, known: Support | None) -> tuple[str, Any]:
    """Name and value of the message that makes the change."""
    key, value = change.name, change.after
    if key in _ROTATIONS:
        value = v.AlignmentRotation(_ROTATIONS[key], value)
    elif key == "option_flags":
        value = v.OptionFlags(
            v.OptionFlag(int(value) & ~int(change.before)),
            v.OptionFlag(int(change.before) & ~int(value)),
        )
    elif key == "filter_profile" and known is not None:
        if "SetFilterProfileModern" in known.messages:
            return "SetFilterProfileModern", str(value)
        numbers = {it.label: it.type for it in known.filter_profiles}
        if isinstance(value, str) and value not in numbers:
            raise ValueError(
                f"the {known.product.name} has no filter profile {value!r}; it has {', '.join(numbers)}"
            )
        value = numbers.get(value, value)
    return f"Set{ROWS[key].message}", value


def apply_settings(
    device: Device, settings: Settings, *, dry_run: bool = False, check_baudrate: bool = True
) -> Applied:
    """Sets what differs on a device that is in Config State; see `Device.apply`."""
    planned = plan(device, settings, check_baudrate=check_baudrate)
    if planned.impossible:
        raise ValueError("\n".join(planned.impossible))
    if dry_run:
        return Applied(planned.changes)
    rounded: list[Change] = []
    for done, change in enumerate(planned.changes):
        parts = planned.changes[:done], change, planned.changes[done + 1 :], planned.before
        try:
            name, value = _message(change, device.support)
            device.command(name, value)
            found = _ask(device, change.name)
        except XbusError as error:
            raise ApplyError(
                str(error), *parts, is_open=not isinstance(error, DeviceError)
            ) from error
        except BaseException as error:  # Ctrl-C
            error.add_note(str(ApplyError("interrupted", *parts, is_open=True)))
            raise
        if found == change.before:
            text = f"the device acknowledged {change.name} and kept what it had"
            raise ApplyError(text, *parts, is_open=False)
        if found != change.after:
            rounded.append(Change(change.name, change.after, found))
        if change.name == "output_configuration":
            device.outputs = found
    return Applied(planned.changes, tuple(rounded))
