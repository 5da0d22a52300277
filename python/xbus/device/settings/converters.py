"""Converts the value of each setting to its form in a TOML file, and back."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from enum import IntEnum, IntFlag
from typing import Any, NamedTuple

import numpy as np

from xbus.device.settings.toml import format_value, shortened
from xbus.protocol import values as v
from xbus.protocol.ids import Coordinates, Precision
from xbus.wire.codec import data_id_of

__all__ = [
    "CAN_CONFIG",
    "CAN_OUTPUT_CONFIG",
    "EXT_OUTPUT_MODE",
    "FILTER_PROFILE",
    "GNSS_LEVER_ARM",
    "GNSS_PLATFORM",
    "GNSS_RECEIVER_SETTINGS",
    "INTEGER",
    "LAT_LON_ALT",
    "OPTION_FLAGS",
    "OUTPUT_CONFIGURATION",
    "OUTPUT_MODE",
    "OUTPUT_SETTINGS",
    "PORT_CONFIG",
    "ROTATION",
    "STRING_OUTPUT_TYPE",
    "SYNC_SETTINGS",
    "TEXT",
    "Converter",
    "member_name",
]

#: Longest text and widest integer of any setting. The limits keep error messages short.
MAX_CHARACTERS, MAX_BITS = 100, 64


class Converter(NamedTuple):
    """Converts values of one kind.

    Attributes:
        write: Returns a value as bool, int, float, str, list or dict, which TOML has.
        read: Returns the value of such an object; raises ValueError.
    """

    write: Callable[[Any], Any]
    read: Callable[[Any], Any]


def _wrong(found: Any, expected: str) -> ValueError:
    return ValueError(f"{shortened(format_value(found))} is not {expected}")


# Plain values


def _reader(kind: type, name: str) -> Callable[[Any], Any]:
    def read(found: Any) -> Any:
        # A bool is an int in Python, and not in TOML.
        if isinstance(found, bool) != (kind is bool) or not isinstance(found, kind):
            raise _wrong(found, name)
        return found

    return read


_read_list = _reader(list, "a list")
_read_table = _reader(dict, "a table, { key = value }")
_read_any_integer = _reader(int, "a whole number")
_read_any_text = _reader(str, "text in quotes")


def _read_integer(found: Any) -> int:
    number: int = _read_any_integer(found)
    if number.bit_length() > MAX_BITS:
        raise ValueError(f"a number of {number.bit_length()} bits is too large for any setting")
    return number


def _read_text(found: Any) -> str:
    text: str = _read_any_text(found)
    if len(text) > MAX_CHARACTERS:
        raise ValueError(f"text of {len(text)} characters is too long for any setting")
    return text


def _read_float(found: Any) -> float:
    if isinstance(found, bool) or not isinstance(found, int | float):
        raise _wrong(found, "a number")
    try:
        number = float(found)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError("the number must be finite")
    return number


TEXT = Converter(str, _read_text)
INTEGER = Converter(int, _read_integer)
BOOLEAN = Converter(bool, _reader(bool, "true or false"))
FLOAT64 = Converter(float, _read_float)
#: Written with the fewest digits that identify a float32.
FLOAT32 = Converter(lambda number: float(str(np.float32(number))), _read_float)


# Enumerations and flags


def member_name(member: Any) -> str:
    """Returns the name of a flag or enum member as files have it: lower case, except for strings."""
    return str(member.name) if isinstance(member, v.StringType) else str(member.name).lower()


def _read_member(kind: type[IntEnum] | type[IntFlag], found: Any) -> Any:
    """Returns the member with this name, in any case, or with this number."""
    if isinstance(found, int) and not isinstance(found, bool):
        number = _read_integer(found)
        return v.known(kind, number) if issubclass(kind, IntEnum) else kind(number)
    members = {name.lower(): member for name, member in kind.__members__.items()}
    if not isinstance(found, str) or found.lower() not in members:
        names = ", ".join(map(member_name, kind.__members__.values()))
        raise ValueError(f"{shortened(format_value(found))} is not one of {names}")
    return members[found.lower()]


def _choice(kind: type[IntEnum]) -> Converter:
    return Converter(
        lambda value: member_name(value) if isinstance(value, kind) else int(value),
        lambda found: _read_member(kind, found),
    )


def _format(kind: type[IntEnum]) -> Converter:
    """Returns the converter of precisions and coordinates, whose names are written as they are."""
    return Converter(lambda value: str(value.name), lambda found: _read_member(kind, found))


def _flags(kind: type[IntFlag]) -> Converter:
    """Returns the converter of flags: a list of names, with bits without a name as one number."""

    def write(flags: IntFlag) -> list[Any]:
        unnamed = int(flags) & ~sum(flags)
        return [*map(member_name, flags), *([unnamed] if unnamed else [])]

    def read(found: Any) -> IntFlag:
        flags = kind(0)
        for entry in _read_list(found):
            flags |= _read_member(kind, entry)
        return flags

    return Converter(write, read)


# Tables and lists


def _table(make: Callable[..., Any], **fields: Converter) -> Converter:
    """Returns the converter of a record: a table. A field that has its default value is not written."""
    parameters = inspect.signature(make).parameters
    required = [name for name in fields if parameters[name].default is inspect.Parameter.empty]

    def write(value: Any) -> dict[str, Any]:
        items = {name: getattr(value, name) for name in fields}
        return {
            name: fields[name].write(item)
            for name, item in items.items()
            if name in required or item != parameters[name].default
        }

    def read(found: Any) -> Any:
        values = {}
        for name, item in _read_table(found).items():
            if name not in fields:
                raise _unknown_field(name, fields)
            try:
                values[name] = fields[name].read(item)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
        if missing := [name for name in required if name not in values]:
            raise _missing_field(", ".join(missing))
        return make(**values)

    return Converter(write, read)


def _unknown_field(name: str, fields: Mapping[str, Any]) -> ValueError:
    return ValueError(f"there is no field {shortened(name)}; the fields are {', '.join(fields)}")


def _missing_field(name: str) -> ValueError:
    return ValueError(f"{name} is missing")


def _with_baudrate(table: Converter, rates: Mapping[int, int]) -> Converter:
    """Returns the same table with ``baudrate`` in bits per second in place of ``baud_code``.

    A code that is not the usual one of its rate keeps its name, so that it survives being written and read.
    """
    codes = v.usual_codes(rates)

    def write(value: Any) -> dict[str, Any]:
        fields: dict[str, Any] = table.write(value)
        rate = v.usual_rate(value.baud_code, rates)
        if rate is None:
            return fields
        return {
            "baudrate" if name == "baud_code" else name: rate if name == "baud_code" else item
            for name, item in fields.items()
        }

    def read(found: Any) -> Any:
        fields = dict(_read_table(found))
        if "baudrate" in fields:
            rate = _read_integer(fields.pop("baudrate"))
            if rate not in codes:
                known = ", ".join(map(str, sorted(codes)))
                raise ValueError(f"baudrate: {rate} is not one of {known}")
            fields["baud_code"] = codes[rate]
        elif "baud_code" not in fields:
            raise _missing_field("baudrate")
        return table.read(fields)

    return Converter(write, read)


def _list(entry: Converter) -> Converter:
    return Converter(
        lambda values: [entry.write(value) for value in values],
        lambda found: tuple(entry.read(item) for item in _read_list(found)),
    )


# Forms that only one setting has


def _write_output(output: v.Output) -> dict[str, Any]:
    formats = {}
    if isinstance(output.coordinates, Coordinates):
        formats["coordinates"] = output.coordinates.name
    if output.precision is not None:
        formats["precision"] = output.precision.name
    frequency = {} if output.frequency == v.EVERY else {"frequency": output.frequency}
    name = output.quantity
    if name is None or data_id_of((name, *formats.values())) != output.data_id:
        return {"data_id": output.data_id, **frequency}
    return {"quantity": name, **formats, **frequency}


_OUTPUT_FIELDS: dict[str, Any] = {
    "quantity": None,
    "coordinates": Coordinates,
    "precision": Precision,
    "frequency": None,
}


def _read_output(found: Any) -> v.Output:
    fields = dict(_read_table(found))
    frequency = _read_integer(fields.pop("frequency", v.EVERY))
    if "data_id" in fields:
        data_id = _read_integer(fields.pop("data_id"))
    elif "quantity" in fields:
        key = [_read_text(fields.pop("quantity"))]
        for name in ("coordinates", "precision"):
            if name in fields:
                format_ = _read_text(fields.pop(name))
                members = _OUTPUT_FIELDS[name].__members__
                if format_ not in members:
                    raise ValueError(f"{name}: {format_!r} is not one of {', '.join(members)}")
                key.append(format_)
        data_id = data_id_of(tuple(key))
    else:
        raise _missing_field("quantity")
    if fields:
        raise _unknown_field(next(iter(fields)), _OUTPUT_FIELDS)
    return v.Output(data_id, frequency)


def _read_rotation(found: Any) -> tuple[float, ...]:
    numbers = tuple(map(_read_float, _read_list(found)))
    if len(numbers) != 4:
        raise _wrong(found, "q0, q1, q2, q3")
    return numbers


def _read_profile(found: Any) -> int | str:
    if isinstance(found, str):
        return _read_text(found)
    if isinstance(found, int) and not isinstance(found, bool):
        return _read_integer(found)
    raise _wrong(found, "a name or a number")


OUTPUT_CONFIGURATION = _list(Converter(_write_output, _read_output))
ROTATION = Converter(
    lambda quaternion: [FLOAT32.write(number) for number in quaternion], _read_rotation
)
FILTER_PROFILE = Converter(lambda profile: profile, _read_profile)
OPTION_FLAGS = _flags(v.OptionFlag)
EXT_OUTPUT_MODE = _flags(v.ExtOutputMode)
OUTPUT_MODE = _flags(v.OutputMode)
OUTPUT_SETTINGS = _table(
    v.OutputSettings,
    packet_counter=BOOLEAN,
    utc_time=BOOLEAN,
    orientation=_choice(v.OrientationForm),
    acceleration=BOOLEAN,
    rate_of_turn=BOOLEAN,
    magnetic_field=BOOLEAN,
    status_word=BOOLEAN,
    precision=_format(Precision),
    analog_in1=BOOLEAN,
    analog_in2=BOOLEAN,
    gps=BOOLEAN,
    gyro_temperature=BOOLEAN,
    sample_time_fine=BOOLEAN,
    coordinates=_format(Coordinates),
    reserved=INTEGER,
)
GNSS_PLATFORM = _choice(v.GnssPlatform)
STRING_OUTPUT_TYPE = _table(v.StringOutput, types=_flags(v.StringType), frequency=INTEGER)
LAT_LON_ALT = _table(v.LatLonAlt, lat=FLOAT64, lon=FLOAT64, alt=FLOAT64)
GNSS_LEVER_ARM = _table(v.GnssLeverArm, x=FLOAT32, y=FLOAT32, z=FLOAT32)
SYNC_SETTINGS = _list(
    _table(
        v.SyncSetting,
        function=_choice(v.SyncFunction),
        line=_choice(v.SyncLine),
        polarity=_choice(v.Polarity),
        trigger_once=BOOLEAN,
        skip_first=INTEGER,
        skip_factor=INTEGER,
        pulse_width=INTEGER,
        offset=INTEGER,
    )
)
PORT_CONFIG = _list(
    _with_baudrate(
        _table(
            v.PortConfig,
            protocol=_choice(v.PortProtocol),
            baud_code=INTEGER,
            flow_control=BOOLEAN,
            two_stop_bits=BOOLEAN,
            parity=BOOLEAN,
            parity_even=BOOLEAN,
            reserved=INTEGER,
        ),
        v.BAUD_CODES,
    )
)
CAN_CONFIG = _with_baudrate(
    _table(v.CanConfig, baud_code=INTEGER, enabled=BOOLEAN, reserved=INTEGER), v.CAN_BAUD_CODES
)
CAN_OUTPUT_CONFIG = _list(
    _table(
        v.CanOutput,
        data_id=_choice(v.CanDataId),
        extended=BOOLEAN,
        can_id=INTEGER,
        frequency=INTEGER,
    )
)
GNSS_RECEIVER_SETTINGS = _with_baudrate(
    _table(
        v.GnssReceiverSettings,
        receiver=_choice(v.GnssReceiver),
        baud_code=INTEGER,
        rate=INTEGER,
        options=INTEGER,
    ),
    v.BAUD_CODES,
)
