"""How settings are written in a file: a table of them, and what TOML has for their values."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from enum import IntEnum, IntFlag
from typing import Any, NamedTuple

import numpy as np

from xbus.protocol import values as v
from xbus.protocol.ids import Coordinates, Precision
from xbus.wire.codec import data_id_of

__all__ = ["ROTATIONS", "ROWS", "TEXT", "Form", "Row", "entry", "name_of", "toml"]


def toml(plain: Any) -> str:
    """A value as TOML has it, on one line."""
    match plain:
        case bool():
            return str(plain).lower()
        case str():
            escaped = plain.replace("\\", "\\\\").replace('"', '\\"')
            return '"' + "".join(_escaped(it) for it in escaped) + '"'
        case dict():
            inside = ", ".join(f"{key} = {toml(it)}" for key, it in plain.items())
            return f"{{ {inside} }}" if inside else "{}"
        case list():
            return f"[{', '.join(map(toml, plain))}]"
    return str(plain)


def _escaped(letter: str) -> str:
    return letter if letter.isprintable() else f"\\U{ord(letter):08X}"


def entry(key: str, value: Any) -> str:
    """``key = value``, a list of tables with a line each."""
    plain = ROWS[key].form.write(value)
    if plain and isinstance(plain, list) and isinstance(plain[0], dict):
        return "\n".join([f"{key} = [", *(f"  {toml(it)}," for it in plain), "]"])
    return f"{key} = {toml(plain)}"


# Values


class Form(NamedTuple):
    """How a value is written: to what TOML has, and back; ``read`` raises ValueError."""

    write: Callable[[Any], Any]
    read: Callable[[Any], Any]


def _of_type(kind: type, words: str) -> Callable[[Any], Any]:
    def read(plain: Any) -> Any:
        if isinstance(plain, bool) != (kind is bool) or not isinstance(plain, kind):
            raise ValueError(f"{toml(plain)} is not {words}")
        return plain

    return read


_read_whole = _of_type(int, "a whole number")
_read_text = _of_type(str, "text in quotes")
_read_list = _of_type(list, "a list")
_read_table = _of_type(dict, "a table, { key = value }")


def _read_real(plain: Any) -> float:
    if isinstance(plain, bool) or not isinstance(plain, int | float):
        raise ValueError(f"{toml(plain)} is not a number")  # noqa: TRY004 - the text is wrong, not the call
    try:
        number = float(plain)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError("it must be a number that is finite")
    return number


TEXT = Form(str, _read_text)
WHOLE = Form(int, _read_whole)
TRUTH = Form(bool, _of_type(bool, "true or false"))
DOUBLE = Form(float, _read_real)
#: No more digits than it takes to tell it from other numbers of its width.
SINGLE = Form(lambda it: float(str(np.float32(it))), _read_real)


def name_of(member: Any) -> str:
    """The manual's name of a flag or of one of several: in small letters, but for strings."""
    return str(member.name) if isinstance(member, v.StringType) else str(member.name).lower()


def _member(kind: type[IntEnum] | type[IntFlag], plain: Any) -> Any:
    """The member of this name, in whichever case, or of this number."""
    if isinstance(plain, int) and not isinstance(plain, bool):
        return v.known(kind, plain) if issubclass(kind, IntEnum) else kind(plain)
    members = {name.lower(): it for name, it in kind.__members__.items()}
    if not isinstance(plain, str) or plain.lower() not in members:
        names = ", ".join(map(name_of, kind.__members__.values()))
        raise ValueError(f"{toml(plain)} is none of {names}")
    return members[plain.lower()]


def _choice(kind: type[IntEnum]) -> Form:
    return Form(
        lambda it: name_of(it) if isinstance(it, kind) else int(it),
        lambda plain: _member(kind, plain),
    )


def _flags(kind: type[IntFlag]) -> Form:
    def write(flags: IntFlag) -> list[Any]:
        rest = int(flags) & ~sum(flags)
        return [*map(name_of, flags), *([rest] if rest else [])]

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
        raise ValueError(f"{toml(plain)} is not q0, q1, q2, q3")
    return numbers


def _read_profile(plain: Any) -> int | str:
    if isinstance(plain, bool) or not isinstance(plain, int | str):
        raise ValueError(f"{toml(plain)} is neither name nor number")  # noqa: TRY004
    return plain


OUTPUTS = _several(Form(_write_output, _read_output))
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

# Settings


class Row(NamedTuple):
    """A setting: its commands are ``Req`` and ``Set`` and this name; how it is written; what it is."""

    message: str
    form: Form
    note: str


#: By attribute of `Settings`, in the order of the file.
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

ROTATIONS = {"rot_sensor": v.Alignment.ROT_SENSOR, "rot_local": v.Alignment.ROT_LOCAL}
