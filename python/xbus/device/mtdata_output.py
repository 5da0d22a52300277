"""The output of devices that send MTData: mode, settings and rate for a choice of quantities."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from xbus import _core
from xbus.device.output_configuration import OutputConfiguration, overload_message
from xbus.device.string_output import frequency_of, period_and_skip_factor
from xbus.protocol.ids import Coordinates, Precision
from xbus.protocol.keys import Key, QuantityKey, key_of, resolve_key
from xbus.protocol.mtdata import MTDATA_ITEMS, MtDataItem
from xbus.protocol.products import Support
from xbus.protocol.tables import COLUMN_QUANTITIES
from xbus.protocol.values import BITS_PER_BYTE, EVERY, PERIODS, Output, OutputMode, OutputSettings

__all__ = ["MtDataPlan", "check_mtdata_fits", "mtdata_outputs", "plan_mtdata"]

#: Bytes of a frame without its payload.
_FRAME_BYTES = 5
#: Groups of quantities that come with each message, and have no rate.
_WITHOUT_RATE = ("Timestamp", "Status")


@dataclass(frozen=True)
class MtDataPlan:
    """The settings for a choice of quantities.

    Attributes:
        mode: The items.
        settings: Their form.
        period: Sampling period in 1/115200 s.
        skip_factor: Messages skipped between two.
    """

    mode: OutputMode
    settings: OutputSettings
    period: int
    skip_factor: int

    @property
    def messages(self) -> list[tuple[str, Any]]:
        """Name and value of each message, in the order in which they are sent."""
        return [
            ("SetOutputMode", self.mode),
            ("SetOutputSettings", self.settings),
            ("SetPeriod", self.period),
            ("SetOutputSkipFactor", self.skip_factor),
        ]

    @property
    def size(self) -> int:
        """Bytes of a payload."""
        items = _core.mtdata_layout(int(self.mode), int(self.settings))
        return sum(item.size for item in items)


def mtdata_outputs(plan: MtDataPlan) -> tuple[Output, ...]:
    """Returns the outputs in effect, in the order of the message; all have one rate, rounded to whole Hz.

    Outputs on request have the rate 0.

    >>> mtdata_outputs(MtDataPlan(OutputMode.CALIBRATED, OutputSettings(magnetic_field=False), 1152, 1))
    (Output(data_id=16416, frequency=50), Output(data_id=32800, frequency=50), \
Output(data_id=4128, frequency=65535))
    """
    rate = frequency_of(plan.period, plan.skip_factor) or 0.0
    items = _core.mtdata_layout(int(plan.mode), int(plan.settings))
    return tuple(
        Output(item.data_id, round(rate) if _has_rate(item.name) else EVERY) for item in items
    )


def _has_rate(name: str) -> bool:
    return COLUMN_QUANTITIES[name].group not in _WITHOUT_RATE


def plan_mtdata(configuration: OutputConfiguration, support: Support) -> MtDataPlan:
    """Returns the settings for an output configuration.

    Args:
        configuration: Rates in Hz by quantity, or a list of `Output`: see `Device.set_output_configuration`.
        support: What the product supports.

    Raises:
        ValueError: MTData cannot hold these outputs; the message says why, and what it can hold.
    """
    wanted = _parse(configuration)
    names = {key.name for key, _ in wanted}
    rows = [row for row in MTDATA_ITEMS if OutputMode(row.mode) in support.output_modes]
    product = support.product.name
    known = dict.fromkeys(row.quantity for row in rows)
    if missing := [name for name in names if name not in known]:
        raise ValueError(f"the {product} has no output {missing[0]}; it has {', '.join(known)}")
    chosen = [row for row in rows if row.quantity in names]
    settings = _settings_of(chosen, product)
    mode = 0
    for row in chosen:
        mode |= row.mode
    # An item of a chosen group that is not wanted is left out by its bit, if no chosen item needs the bit.
    needed = {row.mask for row in chosen}
    for row in rows:
        can_be_left_out = row.value == 0 and _is_bit(row.mask) and row.mask not in needed
        if row.mode & mode and row.quantity not in names and can_be_left_out:
            settings |= row.mask
    settings |= _format_bits(wanted, product)
    period, skip_factor = _rate_of(wanted, product)
    return MtDataPlan(OutputMode(mode), OutputSettings.from_word(settings), period, skip_factor)


def _parse(configuration: OutputConfiguration) -> list[tuple[QuantityKey, int | None]]:
    """Returns the keys with their rates; None for the highest."""
    pairs: list[tuple[QuantityKey, int | None]]
    if isinstance(configuration, Mapping):
        pairs = [(resolve_key(key), _rate(key, rate)) for key, rate in configuration.items()]
    else:
        outputs = (Output(*output) for output in configuration)
        pairs = [(key_of(data_id), _rate(data_id, rate)) for data_id, rate in outputs]
    names = [key.name for key, _ in pairs]
    if twice := [name for name in names if names.count(name) > 1]:
        raise ValueError(f"{twice[0]} is in the output configuration twice; remove one")
    return pairs


def _rate(key: Key, rate: Any) -> int | None:
    if rate is None or rate in (0, EVERY):
        return None
    if isinstance(rate, bool) or rate not in range(EVERY):
        raise ValueError(f"{key!r}: a rate is a whole number of Hz, not {rate!r}")
    return int(rate)


def _settings_of(chosen: Iterable[MtDataItem], product: str) -> int:
    """Returns the bits that these items need.

    Raises:
        ValueError: Two of them exclude each other.
    """
    settings = mask = 0
    by_mask: dict[int, str] = {}
    for row in chosen:
        if row.mask & mask and settings & row.mask != row.value:
            raise ValueError(
                f"the {product} sends {by_mask[row.mask]} or {row.quantity}, not both; choose one"
            )
        settings, mask = settings | row.value, mask | row.mask
        by_mask[row.mask] = row.quantity
    return settings


def _is_bit(mask: int) -> bool:
    return mask > 0 and mask & (mask - 1) == 0


def _format_bits(wanted: Iterable[tuple[QuantityKey, int | None]], product: str) -> int:
    """Returns the bits of number format and coordinates.

    Raises:
        ValueError: The quantities have different ones, or a system that MTData does not have.
    """
    precisions = {key.precision for key, _ in wanted} - {None}
    if len(precisions) > 1:
        names = " and ".join(sorted(map(str, precisions)))
        raise ValueError(
            f"the {product} sends all real numbers in one precision, not in {names}; choose one"
        )
    systems = {key.coordinates for key, _ in wanted} - {None}
    if systems - {"NED", "NWU"}:
        raise ValueError(f"the {product} has the coordinates NWU and NED, not ENU")
    if len(systems) > 1:
        raise ValueError(
            f"the {product} sends orientation and velocity in one coordinate system; choose NED or NWU"
        )
    form = OutputSettings(
        packet_counter=False,
        precision=Precision[precisions.pop() or "Float32"] if precisions else Precision.Float32,
        coordinates=Coordinates[systems.pop() or "NWU"] if systems else Coordinates.NWU,
    )
    return int(form)


def _rate_of(wanted: Iterable[tuple[QuantityKey, int | None]], product: str) -> tuple[int, int]:
    """Returns period and skip factor.

    Raises:
        ValueError: The quantities have different rates, or there are no period and skip factor for it.
    """
    rates = {key.name: rate for key, rate in wanted if rate is not None and _has_rate(key.name)}
    if len(set(rates.values())) > 1:
        each = ", ".join(f"{name} at {rate} Hz" for name, rate in rates.items())
        raise ValueError(
            f"the {product} sends all quantities in one message, at one rate, not {each}; choose one rate"
        )
    if not rates:
        return PERIODS[0], 0
    return period_and_skip_factor(next(iter(rates.values())))


def check_mtdata_fits(plan: MtDataPlan, support: Support, baudrate: int) -> None:
    """Checks that a serial line carries these outputs.

    Raises:
        ValueError: It does not; the message names a sufficient baud rate.
    """
    rate = frequency_of(plan.period, plan.skip_factor) or 0.0
    needed = round(rate * (_FRAME_BYTES + plan.size))
    if needed > baudrate // BITS_PER_BYTE:
        raise ValueError(overload_message("outputs", needed, baudrate, support))
