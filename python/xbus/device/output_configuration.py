"""The output configuration in the user's words, and how many bytes a second it makes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any

from xbus.protocol.keys import Key
from xbus.protocol.products import Support
from xbus.protocol.tables import QUANTITIES
from xbus.protocol.values import EVERY, Output
from xbus.wire.codec import data_id_of

__all__ = [
    "BITS_PER_BYTE",
    "OutputConfiguration",
    "bytes_per_second",
    "check_outputs_fit",
    "overload_message",
    "parse_output_configuration",
]

#: An output configuration: rates in Hz by what is wanted, or lines as the message has them. A rate of
#: None asks for the highest.
OutputConfiguration = Mapping[Any, int | None] | Iterable[Output]

#: Preamble, BID, MID, length and checksum.
_FRAME = 5
#: Identifier and size of a packet.
_PACKET = 3
#: Satellites to reckon with; the packet has room for 61.
_SATELLITES = 40
#: How often a GNSS receiver delivers, Hz.
_GNSS_RATE = 4
#: How often a message comes that nothing but time stamps and status is asked for, Hz (Table 2).
_STAMPS_RATE = 100
#: Bits on the line for each byte: a start bit, eight, a stop bit.
BITS_PER_BYTE = 10


def parse_output_configuration(outputs: OutputConfiguration) -> tuple[Output, ...]:
    """The lines of an output configuration.

    Raises:
        ValueError: No such quantity, a rate that is no rate, or one identifier twice.

    >>> parse_output_configuration({"packet_counter": None, ("quaternion", "NED"): 100})
    (Output(data_id=4128, frequency=65535), Output(data_id=8212, frequency=100))
    """
    if isinstance(outputs, Mapping):
        lines = tuple(
            Output(data_id_of(key), EVERY if rate is None else _rate(key, rate))
            for key, rate in outputs.items()
        )
    else:
        lines = tuple(Output(*it) for it in outputs)
    for one, other in pairwise(sorted(it.data_id for it in lines)):
        if one == other:
            raise ValueError(f"{Output(one).quantity or hex(one)} is asked for twice")
    return lines


def _rate(key: Key, rate: float) -> int:
    if rate != int(rate) or not 0 <= rate <= EVERY:
        raise ValueError(f"{key!r}: a rate is a whole number of Hz, not {rate}")
    return int(rate)


def bytes_per_second(outputs: Iterable[Output], support: Support) -> int:
    """About how many bytes a second a device sends with these lines, in the rates that they have in effect.

    Everything that is due at the same time shares a message; high-rate and GNSS data have messages of
    their own, and time stamps and status come with each.
    """
    lines = [it for asked in outputs if (it := support.acknowledged(asked)) is not None]
    groups = {it: QUANTITIES[it.quantity or ""].group for it in lines}
    stamps = sum(_size(it) for it in lines if groups[it] == "Timestamp")
    status = sum(_size(it) for it in lines if groups[it] == "Status")
    measured = [it for it in lines if it.frequency != EVERY]
    apart = [it for it in measured if (it.quantity or "").endswith("_hr")]
    gnss = [it for it in lines if groups[it] == "GNSS"]
    together = [it for it in measured if it not in apart and it not in gnss]
    total = sum(it.frequency * (_FRAME + stamps + _size(it)) for it in apart)
    total += sum(_GNSS_RATE * (_FRAME + stamps + _size(it)) for it in gnss)
    total += sum(it.frequency * _size(it) for it in together)
    messages = _messages([it.frequency for it in together])
    if not measured and not gnss and lines:
        messages = _STAMPS_RATE
    return total + messages * (_FRAME + stamps + status)


def _messages(rates: list[int]) -> int:
    """In how many instants of a second at least one of these rates is due."""
    return len({tick / rate for rate in set(rates) for tick in range(rate)})


def _size(output: Output) -> int:
    row = QUANTITIES[output.quantity or ""]
    if row.kind == "real":
        return _PACKET + row.numbers * (4, 4, 6, 8)[output.data_id & 3]
    if row.kind == "list":
        head = sum(int(it.type[1]) for it in row.fields)
        return _PACKET + head + _SATELLITES * sum(int(it.type[1]) for it in row.entry)
    return _PACKET + (row.size or 8)


def check_outputs_fit(outputs: Iterable[Output], support: Support, baudrate: int) -> None:
    """Whether a serial line carries what these lines make.

    Raises:
        ValueError: It does not; the message says which baud rate, or what share of the rates, would do.
    """
    needed, room = bytes_per_second(outputs, support), baudrate // BITS_PER_BYTE
    if needed > room:
        problem = overload_message("outputs", needed, baudrate, support)
        raise ValueError(
            f"{problem}; at {baudrate:,} baud {room / needed:.0%} of the rates would fit"
        )


def overload_message(what: str, needed: int, baudrate: int, support: Support) -> str:
    """That a line does not carry so many bytes a second, and which baud rate would."""
    enough = [it for it in support.baudrates if it // BITS_PER_BYTE >= needed]
    advice = (
        f"{min(enough):,} baud would do (set_baudrate)"
        if enough
        else "no baud rate of this product would do"
    )
    return (
        f"these {what} make about {needed:,} bytes a second, and {baudrate:,} baud carry"
        f" {baudrate // BITS_PER_BYTE:,}; {advice}"
    )
