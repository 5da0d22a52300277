"""``xbus quantities`` and ``xbus messages``: the protocol tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import click

from xbus.cli.failure import Failure
from xbus.cli.printing import print_json_rows, print_table

if TYPE_CHECKING:
    from xbus.protocol.tables import MessageRow, Quantity

    Row = TypeVar("Row", Quantity, MessageRow)

__all__ = ["messages", "quantities"]


@click.command(epilog="Example: xbus quantities gnss")
@click.argument("text", required=False, default="")
@click.option(
    "--json", "as_json", is_flag=True, help="Print a JSON list with the fields of structs."
)
def quantities(text: str, as_json: bool) -> None:
    """Lists the quantities and their data identifiers.

    TEXT selects the rows that contain it. The last digit of an identifier is 0 here; a device uses it for
    precision and coordinates. The axes are those of the sensor, those of the local frame (east, north, up
    unless the coordinates say otherwise), or fixed to the Earth; "sensor to local" is a rotation from the
    first to the second.
    """
    from xbus.describe.table_text import describe_layout, describe_products
    from xbus.protocol.tables import QUANTITIES

    def cells(row: Quantity) -> list[str]:
        systems = "ENU NED NWU" if row.coordinates else ""
        about = [
            describe_layout(row),
            row.unit,
            row.axes or "",
            systems,
            describe_products(row.products),
            row.source,
        ]
        return [f"0x{row.id:04X}", row.name, row.manual, *about]

    head = ["id", "name", "manual", "layout", "unit", "axes", "coordinates", "products", "source"]
    optional = ["manual", "products", "source"]
    _print_rows(head, QUANTITIES.values(), cells, text, optional, as_json=as_json)


@click.command(epilog="Example: xbus messages baud")
@click.argument("text", required=False, default="")
@click.option(
    "--json", "as_json", is_flag=True, help="Print a JSON list with all lengths and products."
)
def messages(text: str, as_json: bool) -> None:
    """Lists the messages and their identifiers (MID).

    TEXT selects the rows that contain it. The length is the payload size in bytes; the reply is the MID of
    the answer.
    """
    from xbus.describe.table_text import describe_lengths, describe_products
    from xbus.protocol.tables import MESSAGES

    def cells(row: MessageRow) -> list[str]:
        reply = "" if row.reply is None else f"0x{row.reply:02X}"
        about = [
            describe_lengths(row.lengths),
            row.payload,
            describe_products(row.products),
            row.status,
        ]
        return [f"0x{row.mid:02X}", row.name, row.direction, " ".join(row.states), reply, *about]

    head = [
        "mid",
        "name",
        "direction",
        "states",
        "reply",
        "length",
        "payload",
        "products",
        "status",
    ]
    optional = ["states", "products", "status"]
    _print_rows(head, MESSAGES.values(), cells, text, optional, as_json=as_json)


def _print_rows(
    head: Sequence[str],
    rows: Iterable[Row],
    cells: Callable[[Row], list[str]],
    text: str,
    optional: Sequence[str],
    *,
    as_json: bool,
) -> None:
    """Prints the rows with ``text`` in a cell, ignoring case."""
    found = [row for row in rows if any(text.lower() in cell.lower() for cell in cells(row))]
    if not found:
        raise Failure(f"no row of the table contains {text!r}; omit TEXT to print all rows")
    if as_json:
        print_json_rows([_plain(row) for row in found])
    else:
        print_table(head, [cells(row) for row in found], optional=optional)


def _plain(value: Any) -> Any:
    """Converts rows at any depth to dicts."""
    if hasattr(value, "_asdict"):
        return {name: _plain(field) for name, field in value._asdict().items()}
    return [_plain(entry) for entry in value] if isinstance(value, tuple | list) else value
