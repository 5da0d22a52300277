"""The DBC file of the 600-series, written by cantools from the table of messages."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from xbus.can.ids import EXTENDED, Ids, device_ids
from xbus.extras import require
from xbus.protocol.can import CanMessage, CanSignal

__all__ = ["FILE", "dbc_text", "make_dbc"]

#: The file for a device with the identifiers of its factory settings. `make_dbc` wrote it.
FILE = Path(__file__).with_name("mti600.dbc")
#: The exponents of DeltaV that a device sends: by its rate, from 1 to 400 Hz.
EXPONENTS = range(8, 18)
#: The node that receives all signals.
RECEIVER = "Host"
COMMENTS = {
    "Error": "Code 1: the output buffer overflowed, frames are missing.",
    "SampleTime": "Ticks of 0.1 ms on the device clock; wraps at 2^32. Not microseconds.",
    "GroupCounter": "Counts the groups of frames, modulo 65536. Independent of the PacketCounter of Xbus.",
    "UtcTime": "Sent only while the receiver has the time. Years are 2000 + year.",
    "StatusWord": "The bits are those of StatusWord of Xbus.",
    "Quaternion": "One count is 1/32767, not 2^-15.",
    "DeltaV": "One count is 2^-exponent m/s. The exponent depends on the rate and selects the signals.",
    "BaroPressure": "Without a sign.",
}


def dbc_text(ids: Ids | None = None) -> str:
    """Returns a DBC file that decodes the CAN output of MTi-600 devices.

    That for the identifiers of the factory settings is a part of the package; others are written by cantools.
    Signals have the units of `xbus.can.CanSignal`. The exponent of DeltaV selects one of ten sets of signals
    (``x_17`` at 400 Hz), because a DBC file has no other way to scale a signal by another one. Messages of
    several devices have the number of the device behind their names.

    Args:
        ids: Identifiers of the devices, as in `xbus.read_can`.

    Raises:
        ImportError: There are ``ids``, and the extra ``can`` is not installed.
        TypeError: The identifiers are of the wrong type.
        ValueError: An identifier is out of range or used twice.

    >>> print(next(line for line in dbc_text().splitlines() if "SG_ pressure" in line).strip())
    SG_ pressure : 7|32@0+ (3.0517578125e-05,0) [30000.0|125000.0] "Pa"  Host
    """
    return FILE.read_text("ascii") if ids is None else make_dbc(ids)


def make_dbc(ids: Ids | None = None) -> str:
    """Returns a DBC file, as `dbc_text`, from the table of messages."""
    library = require("cantools.database", "can", "to write a DBC file for these identifiers")
    devices = device_ids(ids)
    messages = []
    for number, device in enumerate(devices, 1):
        suffix = f"_{number}" if len(devices) > 1 else ""
        sender = f"MTi{suffix}"
        messages += [
            _message(library, key, row, row.name + suffix, sender)
            for key, row in device.items()
            if row.signals
        ]
    nodes = [
        library.can.Node(name)
        for name in [*dict.fromkeys(m.senders[0] for m in messages), RECEIVER]
    ]
    database = library.can.Database(messages=messages, nodes=nodes, version="xbus")
    text: str = database.as_dbc_string(sort_signals=None)
    return text.replace("\r\n", "\n")


def _message(library: Any, key: int, row: CanMessage, name: str, sender: str) -> Any:
    return library.can.Message(
        frame_id=key & ~EXTENDED,
        is_extended_frame=bool(key & EXTENDED),
        name=name,
        length=row.size,
        signals=list(_signals(library, row)),
        senders=[sender],
        comment=COMMENTS.get(row.name),
    )


def _signals(library: Any, row: CanMessage) -> Iterator[Any]:
    at = 0
    for signal in row.signals:
        if row.kind == "scaled" and signal.name != "exponent":
            for exponent in EXPONENTS:
                scaled = signal._replace(
                    name=f"{signal.name}_{exponent}",
                    per_unit=1 << exponent,
                    unit="m/s",
                    min=signal.min / (1 << exponent),
                    max=signal.max / (1 << exponent),
                )
                yield _signal(
                    library, scaled, at, multiplexer_ids=[exponent], multiplexer_signal="exponent"
                )
        else:
            yield _signal(library, signal, at, is_multiplexer=signal.name == "exponent")
        at += signal.size


def _signal(library: Any, signal: CanSignal, at: int, **options: Any) -> Any:
    conversion = library.conversion.BaseConversion.factory(
        scale=1 if signal.per_unit == 1 else 1 / signal.per_unit, offset=0
    )
    return library.can.Signal(
        name=signal.name,
        start=8 * at + 7,
        length=8 * signal.size,
        byte_order="big_endian",
        is_signed=signal.is_signed,
        conversion=conversion,
        minimum=signal.min,
        maximum=signal.max,
        unit=signal.unit or None,
        receivers=[RECEIVER],
        **options,
    )
