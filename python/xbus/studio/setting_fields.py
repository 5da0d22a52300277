"""The fields of each setting for a form: kind, unit, range, choices and what they mean, from the tables."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, is_dataclass
from enum import IntEnum, IntFlag
from functools import cache
from itertools import product
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

from xbus.device import Settings
from xbus.device.commands import Commands
from xbus.device.settings.table import SETTINGS
from xbus.protocol import values as v
from xbus.protocol.can import CAN_MESSAGES
from xbus.protocol.layout import kinds_of
from xbus.protocol.products import Support
from xbus.protocol.tables import MESSAGES, MessageField, MessageRow

__all__ = [
    "TABS",
    "Field",
    "choices",
    "command_help",
    "entry_kind",
    "fields_of",
    "flags",
    "help_of",
    "is_record",
    "label",
    "message_choices",
    "profiles",
    "title",
]

#: The settings of each tab; outputs and baud rate have other tabs.
TABS: dict[str, tuple[str, ...]] = {
    "Filter": (
        "filter_profile",
        "option_flags",
        "rot_sensor",
        "rot_local",
        "lat_lon_alt",
        "location_id",
    ),
    "Synchronization": ("sync_settings",),
    "Strings and ports": (
        "string_output_type",
        "period",
        "output_skip_factor",
        "port_config",
        "ext_output_mode",
        "transmit_delay",
        "error_mode",
    ),
    "CAN": ("can_config", "can_output_config"),
    "GNSS": ("gnss_lever_arm", "gnss_platform", "gnss_receiver_settings"),
    "MTData": ("output_mode", "output_settings"),
}
#: Titles of the settings whose name says too little.
TITLES = {
    "rot_sensor": "Alignment of the sensor: RotSensor",
    "rot_local": "Alignment of the local frame: RotLocal",
    "lat_lon_alt": "Stored position",
    "sync_settings": "Functions and lines",
    "string_output_type": "Strings: NMEA and others",
    "port_config": "Ports",
    "can_config": "CAN transceiver",
    "can_output_config": "Outputs on the CAN bus",
    "output_mode": "Items of MTData",
    "output_settings": "Form of the items",
}
#: Words that are written in capitals.
ACRONYMS = (
    "ahs",
    "beidou",
    "can",
    "gnss",
    "gps",
    "id",
    "mtdata",
    "nmea",
    "rtcm",
    "usb",
    "utc",
    "zru",
)


def label(name: str) -> str:
    """Returns a name in words.

    >>> label("can_output_config"), label("ENABLE_AHS"), label("baud_code")
    ('CAN output config', 'enable AHS', 'baud rate')
    """
    words = name.lower().replace("baud_code", "baud_rate").split("_")
    return " ".join(
        word.upper() if word in ACRONYMS or re.search("[0-9]", word) else word for word in words
    )


def title(name: str) -> str:
    """Returns the title of a setting.

    >>> title("gnss_lever_arm"), title("port_config")
    ('GNSS lever arm', 'Ports')
    """
    words = label(name)
    return TITLES.get(name, words[0].upper() + words[1:])


class Field(NamedTuple):
    """A field of a setting.

    Attributes:
        name: Its attribute; that of the setting if the setting is one value.
        kind: `bool`, `int`, `float`, or a class of enumerations or flags.
        unit: Unit of a number; empty if it has none.
        range: Values that are valid, in words; empty if the tables do not say.
        help: What it is, and the manual's table.
    """

    name: str
    kind: Any
    unit: str
    range: str
    help: str

    @property
    def hint(self) -> str:
        """Range and unit in words."""
        return " ".join(part for part in (self.range, self.unit) if part)


def entry_kind(name: str) -> tuple[Any, bool]:
    """Returns the class of the value of a setting, and whether the setting is a list of such values.

    >>> entry_kind("sync_settings"), entry_kind("location_id")
    ((<class 'xbus.protocol.values.SyncSetting'>, True), (<class 'int'>, False))
    """
    kind = get_args(get_type_hints(Settings)[name])[0]
    if get_origin(kind) is tuple:
        return get_args(kind)[0], True
    return kind, False


@cache
def fields_of(name: str) -> tuple[Field, ...]:
    """Returns the fields of a setting, or of one entry of its list. A setting that is one value has one.

    >>> [field.name for field in fields_of("gnss_receiver_settings")]
    ['receiver', 'baud_code', 'rate', 'options']
    """
    kind, _ = entry_kind(name)
    rows = {field.name: field for form in _message(name).forms for field in form}
    if not is_record(name):
        row = next(iter(rows.values())) if len(rows) == 1 else None
        return (_field(name, kind, row, ""),)
    kinds = {**_numbers_of(kind), **kinds_of(kind)}
    texts = _attribute_texts(kind)
    summary = _plain(inspect.getdoc(kind) or "")
    return tuple(
        _field(each, kinds[each], rows.get(each), texts.get(each) or summary)
        for each in kinds
        if each != "reserved"
    )


def is_record(name: str) -> bool:
    """Returns whether a setting, or an entry of its list, has several fields."""
    kind, _ = entry_kind(name)
    return is_dataclass(kind) or hasattr(kind, "_fields")


def _message(name: str) -> MessageRow:
    return MESSAGES[f"Set{SETTINGS[name].message}"]


def _numbers_of(kind: type) -> dict[str, Any]:
    """Returns the kinds of the fields of a class, in their order: float, or else int."""
    hints = get_type_hints(kind)
    names = [each.name for each in fields(kind)] if is_dataclass(kind) else kind._fields  # type: ignore[attr-defined]
    return {name: float if hints[name] is float else int for name in names}


def _field(name: str, kind: Any, row: MessageField | None, text: str) -> Field:
    note = "" if row is None else row.note
    is_citation = note.startswith("Table")
    limits = "" if is_citation else note
    if not limits and row is not None and kind is int:
        bits = 8 * int(row.type[1:])
        limits = f"0 to {(1 << bits) - 1}"
    help_text = f"{text} ({note})" if is_citation and note not in text else text
    return Field(name, kind, "" if row is None else row.unit, limits, help_text.strip())


def _attribute_texts(kind: type) -> dict[str, str]:
    """Returns the descriptions of the attributes in the documentation of a class."""
    _, _, attributes = (inspect.getdoc(kind) or "").partition("Attributes:\n")
    found = re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", attributes, re.MULTILINE)
    return {name: _plain(text) for name, text in found}


def help_of(name: str) -> str:
    """Returns what a setting does, and where the manual describes it.

    >>> help_of("location_id")
    'A number of your choice, 0 to 65535. SetLocationID (0x84): a number of your choice, 0 to 65535.'
    """
    message = SETTINGS[name].message
    texts = [command_help(f"{verb}{message}") for verb in ("Set", "Req")]
    whole = [text for text in texts if " as in " not in text]
    command = next((text for text in whole if "Table" in text), whole[0])
    comment = re.sub(r",? (one )?of: .*", "", SETTINGS[name].comment)
    return f"{comment}. {command}" if comment else command


def command_help(name: str) -> str:
    """Returns what a command does, and where the manual describes it; an empty text if it has no method.

    >>> command_help("ReqGnssPlatform")
    'ReqGnssPlatform (0x76): the dynamic model of the GNSS receiver (Table 31).'
    """
    snake = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name).lower()
    command = getattr(Commands, snake, None)
    return _plain(inspect.getdoc(command) or "") if command is not None else ""


def _plain(text: str) -> str:
    """Returns the first paragraph of a documentation without its markup."""
    return " ".join(text.partition("\n\n")[0].replace("`", "").split())


#: Valid values by setting and field, and their names.
_Choices = Callable[[Support, Any], dict[int, str]]


def _names(members: Iterable[IntEnum]) -> dict[int, str]:
    return {
        int(member): label(member.name) if member.name.isupper() else member.name
        for member in members
    }


def _sync_lines(support: Support, entry: v.SyncSetting) -> dict[int, str]:
    lines = {int(function): lines for function, lines in support.sync.items()}
    return _names(lines.get(int(entry.function), ()))


def _baudrates(support: Support, _: Any) -> dict[int, str]:
    return {v.baud_code(rate): f"{rate:,} baud" for rate in support.baudrates}


def _can_messages(support: Support, _: Any) -> dict[int, str]:
    number = support.product.number
    return {code: row.name for code, row in CAN_MESSAGES.items() if number in row.products}


_CHOICES: dict[tuple[str, str], _Choices] = {
    ("sync_settings", "function"): lambda support, _: _names(support.sync),
    ("sync_settings", "line"): _sync_lines,
    ("baudrate", "code"): _baudrates,
    ("port_config", "baud_code"): _baudrates,
    ("gnss_receiver_settings", "baud_code"): _baudrates,
    ("can_config", "baud_code"): lambda *_: {
        code: f"{rate:,} bit/s" for code, rate in v.CAN_BAUD_CODES.items()
    },
    ("can_output_config", "data_id"): _can_messages,
}


def choices(name: str, field: Field, support: Support, entry: Any) -> Mapping[int, str] | None:
    """Returns the values of a field that a product has, with their names; None for a field of any number.

    Args:
        name: The setting.
        field: The field.
        support: What the product supports.
        entry: The value, or the entry of a list, with the field.
    """
    if (known := _CHOICES.get((name, field.name))) is not None:
        return known(support, entry)
    return _names(field.kind) if issubclass(field.kind, IntEnum) else None


def message_choices(message: str, field: str, support: Support) -> Mapping[int, str] | None:
    """Returns the numbers of a field of a message that a product has, with their names; None without names.

    >>> from xbus.protocol.products import support
    >>> message_choices("SetBaudrate", "code", support("MTi-3"))[2]
    '115,200 baud'
    """
    settings = [name for name, row in SETTINGS.items() if f"Set{row.message}" == message]
    known = _CHOICES.get((settings[0], field)) if settings else None
    return None if known is None else known(support, None)


_FLAGS: dict[str, Callable[[Support], IntFlag]] = {
    "option_flags": lambda support: support.option_flags,
    "types": lambda support: support.string_types,
    "output_mode": lambda support: support.output_modes,
    "ext_output_mode": lambda support: (
        ~v.ExtOutputMode(0) if support.is_legacy else ~v.ExtOutputMode.ANALOG_EULER_ANGLES
    ),
}


def flags(field: Field, support: Support) -> Iterable[IntFlag]:
    """Returns the flags of a field that a product has."""
    allowed = _FLAGS[field.name](support)
    return [flag for flag in field.kind if flag in allowed]


def profiles(support: Support) -> list[str]:
    """Returns the filter profiles of a product, on the 600-series the combinations of names.

    >>> from xbus.protocol.products import support
    >>> profiles(support("MTi-620"))
    ['Responsive/VRU', 'Responsive/VRUAHS', 'Robust/VRU', 'Robust/VRUAHS']
    """
    kinds: dict[int, list[str]] = {}
    for profile in support.filter_profiles:
        kinds.setdefault(profile.type, []).append(profile.label)
    if all(len(labels) == 1 for labels in kinds.values()):
        return [profile.label for profile in support.filter_profiles]
    return ["/".join(names) for names in product(*kinds.values())]
