"""CAN output configurations: parsed from rates by quantity, and compared with what a bus carries."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from xbus.can.ids import EXTENDED, DeviceIds, device_ids
from xbus.device.output_configuration import instants_per_second
from xbus.protocol.can import CAN_MESSAGES, CanMessage, can_message, can_messages, frame_bits
from xbus.protocol.tables import Product
from xbus.protocol.values import CAN_BAUD_CODES, CAN_EVERY, EVERY, CanDataId, CanOutput

__all__ = [
    "CanConfiguration",
    "bus_load",
    "can_baud_code",
    "check_bus_load",
    "check_can_outputs",
    "check_can_products",
    "parse_can_configuration",
]

#: A CAN output configuration: rates in Hz by quantity or message, or a list of `CanOutput`. A rate of None
#: requests the highest or, for time stamps and status, every group.
CanConfiguration = Mapping[Any, int | None] | Iterable[CanOutput]

#: A device sends its position in one of these forms (MT1604P, section 6.8.2).
POSITIONS = (
    (CanDataId.LAT_LON, CanDataId.ALTITUDE_ELLIPSOID),
    (CanDataId.POSITION_ECEF_X, CanDataId.POSITION_ECEF_Y, CanDataId.POSITION_ECEF_Z),
)
#: Bits of a CAN identifier.
STANDARD_BITS, EXTENDED_BITS = 11, 29
#: Bytes of a message whose layout is not known.
LONGEST = 8
#: Groups per second of a device that sends nothing with a rate.
STAMPS_RATE = 100


def parse_can_configuration(
    configuration: CanConfiguration, ids: DeviceIds | None = None
) -> tuple[CanOutput, ...]:
    """Returns the outputs of a configuration, in the order of their codes.

    Args:
        configuration: The outputs.
        ids: CAN identifiers of the device, as in `xbus.read_can`.

    Raises:
        ValueError: There is no such quantity, a rate is not valid, a message has no identifier, or one is in
            the configuration twice.

    >>> parse_can_configuration({"sample_time_fine": None, "acceleration": 100}, ids=0x100)[1]
    CanOutput(data_id=<CanDataId.ACCELERATION: 52>, extended=False, can_id=308, frequency=100)
    """
    if not isinstance(configuration, Mapping):
        outputs = tuple(configuration)
        for output in outputs:
            can_message(int(output.data_id))
        return outputs
    [device] = device_ids(ids)
    identifiers = {row.code: key for key, row in device.items()}
    rates: dict[int, int | None] = {}
    for name, rate in configuration.items():
        for row in can_messages(name):
            if row.code in rates:
                raise ValueError(f"{row.name} is in the CAN output configuration twice; remove one")
            if row.code not in identifiers:
                raise ValueError(f"{row.name} has no CAN identifier in ids; add one")
            rates[row.code] = _checked_rate(row, rate)
    return tuple(
        CanOutput(
            CanDataId(code),
            bool(identifiers[code] & EXTENDED),
            identifiers[code] & ~EXTENDED,
            CAN_EVERY if rate is None else rate,
        )
        for code, rate in sorted(rates.items())
    )


def _checked_rate(row: CanMessage, rate: int | None) -> int | None:
    if rate is None:
        return None
    if isinstance(rate, bool) or rate not in range(CAN_EVERY):
        raise ValueError(f"{row.name}: a rate is a whole number of Hz, not {rate!r}")
    _check_rate(row, rate)
    return int(rate)


def _check_rate(row: CanMessage, rate: int) -> None:
    if row.max_rate is not None and rate > row.max_rate:
        raise ValueError(f"{row.name} has at most {row.max_rate} Hz, not {rate}")


def check_can_outputs(outputs: Iterable[CanOutput]) -> None:
    """Checks the identifiers and rates of outputs. Messages that are not known have any rate.

    Raises:
        ValueError: An identifier has too many bits or is that of two outputs, a rate is too high, or two
            outputs exclude each other.
    """
    outputs = list(outputs)
    codes = {output.data_id for output in outputs}
    if all(codes.intersection(form) for form in POSITIONS):
        raise ValueError(
            "the position is sent as LatLong and AltitudeEllipsoid or as PositionEcef, not both; choose one"
        )
    names: dict[tuple[bool, int], str] = {}
    for output in outputs:
        row = CAN_MESSAGES.get(int(output.data_id))
        name = f"message 0x{int(output.data_id):02X}" if row is None else row.name
        other = names.setdefault((output.extended, output.can_id), name)
        if other is not name:
            raise ValueError(
                f"the CAN identifier 0x{output.can_id:X} is both {other} and {name}; give each its own"
            )
        bits = EXTENDED_BITS if output.extended else STANDARD_BITS
        if output.can_id >> bits:
            remedy = "" if output.extended else ", or set extended"
            raise ValueError(
                f"{name}: the CAN identifier 0x{output.can_id:X} has more than {bits} bits; use at most"
                f" 0x{(1 << bits) - 1:X}{remedy}"
            )
        if output.frequency > CAN_EVERY and output.frequency != EVERY:
            raise ValueError(
                f"{name}: a rate on CAN is at most {CAN_EVERY - 1} Hz, not {output.frequency}"
            )
        if row is not None and output.rate is not None:
            _check_rate(row, output.rate)


def bus_load(outputs: Iterable[CanOutput], baudrate: int) -> float:
    """Returns the share of a bus that outputs take at most; the device drops frames above 1.

    Args:
        outputs: The outputs.
        baudrate: Bits per second of the bus.

    >>> outputs = parse_can_configuration(dict.fromkeys(["quaternion", "delta_q", "lat_lon"], 400))
    >>> f"{bus_load(outputs, 250_000):.1%}"
    '64.8%'
    """
    outputs = list(outputs)
    rates = [output.rate or CAN_MESSAGES[output.data_id].max_rate for output in outputs]
    rated = [rate for rate in rates if rate is not None]
    groups = instants_per_second(rated) if rated else STAMPS_RATE
    bits = sum(
        (groups if rate is None else rate)
        * frame_bits(CAN_MESSAGES[output.data_id].size or LONGEST, is_extended=output.extended)
        for output, rate in zip(outputs, rates, strict=True)
    )
    return bits / baudrate


def check_can_products(outputs: Iterable[CanOutput], product: Product) -> None:
    """Checks that a product has outputs; messages that are not known are left out.

    Raises:
        ValueError: It lacks one.
    """
    for output in outputs:
        row = CAN_MESSAGES.get(int(output.data_id))
        if row is not None and product.number not in row.products:
            raise ValueError(f"the {product.name} does not have {row.name} on CAN; remove it")


def check_bus_load(outputs: Iterable[CanOutput], baud_code: int) -> None:
    """Checks that a bus with the bit rate of a code carries outputs.

    Raises:
        ValueError: It does not; the message names a sufficient bit rate.
    """
    outputs = list(outputs)
    if (baudrate := CAN_BAUD_CODES.get(baud_code)) is None:
        raise ValueError(
            f"the device has the unknown bit rate code {baud_code} for CAN; give baudrate="
        )
    load = bus_load(outputs, baudrate)
    if load <= 1:
        return
    sufficient = [rate for rate in sorted(CAN_BAUD_CODES.values()) if rate >= load * baudrate]
    advice = f"use at least {sufficient[0]:,} bit/s, or lower" if sufficient else "lower"
    raise ValueError(
        f"these outputs take up to {load:.0%} of a CAN bus with {baudrate:,} bit/s; {advice} the rates"
    )


def can_baud_code(baudrate: int) -> int:
    """Returns the code of a bit rate.

    Raises:
        ValueError: An MTi does not have this bit rate.
    """
    for code, rate in CAN_BAUD_CODES.items():
        if rate == baudrate:
            return code
    rates = ", ".join(f"{rate:,}" for rate in sorted(CAN_BAUD_CODES.values()))
    raise ValueError(f"CAN has no {baudrate:,} bit/s; choose from {rates}")
