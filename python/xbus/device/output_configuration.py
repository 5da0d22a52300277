"""Output configurations: parsed from rates by quantity, and compared with what a serial line carries."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any

from xbus.protocol.ids import Precision
from xbus.protocol.keys import Key
from xbus.protocol.products import Support
from xbus.protocol.tables import QUANTITIES
from xbus.protocol.values import BITS_PER_BYTE, EVERY, Output
from xbus.wire.codec import data_id_of

__all__ = [
    "OutputConfiguration",
    "bytes_per_second",
    "check_outputs_fit",
    "instants_per_second",
    "overload_message",
    "parse_output_configuration",
]

#: An output configuration: rates in Hz by quantity, or a list of `Output`. A rate of None requests the
#: highest.
OutputConfiguration = Mapping[Any, int | None] | Iterable[Output]

#: Bytes of a frame without its payload: preamble, BID, MID, length and checksum.
_FRAME_BYTES = 5
#: Bytes of a packet without its data: identifier and size.
_PACKET_BYTES = 3
#: Satellites assumed in a list of satellites, which has room for 61.
_SATELLITES = 40
#: Rate of a GNSS receiver, in Hz.
_GNSS_RATE = 4
#: Rate of messages that contain nothing but time stamps and status, in Hz (Table 2).
_STAMPS_RATE = 100


def parse_output_configuration(configuration: OutputConfiguration) -> tuple[Output, ...]:
    """Returns the outputs of a configuration, in its order.

    Raises:
        ValueError: There is no such quantity, a rate is not valid, or an identifier occurs twice.

    >>> parse_output_configuration({"packet_counter": None, ("quaternion", "NED"): 100})
    (Output(data_id=4128, frequency=65535), Output(data_id=8212, frequency=100))
    """
    if isinstance(configuration, Mapping):
        outputs = tuple(
            Output(data_id_of(key), EVERY if rate is None else _checked_rate(key, rate))
            for key, rate in configuration.items()
        )
    else:
        outputs = tuple(Output(*output) for output in configuration)
    for first, second in pairwise(sorted(output.data_id for output in outputs)):
        if first == second:
            name = Output(first).quantity or hex(first)
            raise ValueError(f"{name} is in the output configuration twice; remove one")
    return outputs


def _checked_rate(key: Key, rate: Any) -> int:
    if isinstance(rate, bool) or rate not in range(EVERY + 1):
        raise ValueError(f"{key!r}: a rate is a whole number of Hz, not {rate!r}")
    return int(rate)


def bytes_per_second(outputs: Iterable[Output], support: Support) -> int:
    """Returns about how many bytes per second a device sends with these outputs, at the rates in effect.

    All outputs that are due at the same time share a message. High-rate and GNSS data have messages of their
    own, and every message repeats time stamps and status.
    """
    active = [known for output in outputs if (known := support.acknowledged(output)) is not None]
    groups = {output: QUANTITIES[output.quantity or ""].group for output in active}
    stamps = sum(_packet_bytes(output) for output in active if groups[output] == "Timestamp")
    status = sum(_packet_bytes(output) for output in active if groups[output] == "Status")
    with_rate = [output for output in active if output.frequency != EVERY]
    high_rate = [output for output in with_rate if (output.quantity or "").endswith("_hr")]
    gnss = [output for output in active if groups[output] == "GNSS"]
    shared = [output for output in with_rate if output not in high_rate and output not in gnss]
    total = sum(
        output.frequency * (_FRAME_BYTES + stamps + _packet_bytes(output)) for output in high_rate
    )
    total += sum(_GNSS_RATE * (_FRAME_BYTES + stamps + _packet_bytes(output)) for output in gnss)
    total += sum(output.frequency * _packet_bytes(output) for output in shared)
    messages = instants_per_second([output.frequency for output in shared])
    if not with_rate and not gnss and active:
        messages = _STAMPS_RATE
    return total + messages * (_FRAME_BYTES + stamps + status)


def instants_per_second(rates: Iterable[int]) -> int:
    """Returns the number of instants of a second at which at least one of these rates is due."""
    return len({tick / rate for rate in set(rates) for tick in range(rate)})


def _packet_bytes(output: Output) -> int:
    row = QUANTITIES[output.quantity or ""]
    if row.kind == "real":
        return _PACKET_BYTES + row.numbers * Precision(output.precision or 0).size
    if row.kind == "list":
        head = sum(int(field.type[1]) for field in row.fields)
        entry = sum(int(field.type[1]) for field in row.entry)
        return _PACKET_BYTES + head + _SATELLITES * entry
    return _PACKET_BYTES + (row.size or 8)


def check_outputs_fit(outputs: Iterable[Output], support: Support, baudrate: int) -> None:
    """Checks that a serial line carries these outputs.

    Raises:
        ValueError: It does not; the message names a sufficient baud rate, and the share of the rates that
            fits.
    """
    needed, capacity = bytes_per_second(outputs, support), baudrate // BITS_PER_BYTE
    if needed > capacity:
        problem = overload_message("outputs", needed, baudrate, support)
        raise ValueError(
            f"{problem}; at {baudrate:,} baud {capacity / needed:.0%} of the rates would fit"
        )


def overload_message(what: str, needed: int, baudrate: int, support: Support) -> str:
    """Returns that a line does not carry `needed` bytes per second, and which baud rate would."""
    sufficient = [rate for rate in support.baudrates if rate // BITS_PER_BYTE >= needed]
    advice = (
        f"use at least {min(sufficient):,} baud (xbus baudrate sets it)"
        if sufficient
        else "no baud rate of this product is sufficient"
    )
    return (
        f"these {what} make about {needed:,} bytes per second, and {baudrate:,} baud carry"
        f" {baudrate // BITS_PER_BYTE:,}; {advice}"
    )
