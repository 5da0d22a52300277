"""``xbus quantities`` and ``xbus messages``: the protocol tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import click

from xbus.cli.failure import Failure
from xbus.cli.printing import print_json_rows, print_line, print_table

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

    TEXT selects the rows that contain it, also in the name of a field. The fields of the structs among them
    follow, with their units in tables and the value of one raw count. The last digit of an identifier is 0
    here; a device uses it for precision and coordinates. The axes are those of the sensor, those of the local
    frame (east, north, up unless the coordinates say otherwise), or fixed to the Earth; "sensor to local" is
    a rotation from the first to the second.
    """
    from xbus.describe.table_text import describe_layout, describe_products
    from xbus.protocol.tables import QUANTITIES

    def names(row: Quantity) -> list[str]:
        return [field.name for field in (*row.fields, *row.entry)]

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
    found = _found(QUANTITIES.values(), lambda row: [*cells(row), *names(row)], text)
    _print_rows(head, found, cells, optional, as_json=as_json)
    if text and not as_json:
        _print_fields(found)


def _print_fields(quantities: Iterable[Quantity]) -> None:
    """Prints the fields of structs."""
    from xbus.describe.table_text import describe_raw_unit

    rows = [
        (
            row.name,
            field.name,
            field.type,
            field.unit,
            describe_raw_unit(field),
            "" if field.missing is None else f"{field.missing:#X}",
        )
        for row in quantities
        for field in (*row.fields, *row.entry)
    ]
    if rows:
        print_line("")
        print_table(
            ("quantity", "field", "type", "unit", "raw count", "not provided"), rows, optional=()
        )


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
    _print_rows(head, _found(MESSAGES.values(), cells, text), cells, optional, as_json=as_json)


def _found(rows: Iterable[Row], texts: Callable[[Row], list[str]], text: str) -> list[Row]:
    """Returns the rows with ``text`` in one of their texts, ignoring case."""
    found = [row for row in rows if any(text.lower() in cell.lower() for cell in texts(row))]
    if not found:
        raise Failure(f"no row of the table contains {text!r}; omit TEXT to print all rows")
    return found


def _print_rows(
    head: Sequence[str],
    rows: Sequence[Row],
    cells: Callable[[Row], list[str]],
    optional: Sequence[str],
    *,
    as_json: bool,
) -> None:
    if as_json:
        print_json_rows([_plain(row) for row in rows])
    else:
        print_table(head, [cells(row) for row in rows], optional=optional)


def _plain(value: Any) -> Any:
    """Converts rows at any depth to dicts."""
    if hasattr(value, "_asdict"):
        return {name: _plain(field) for name, field in value._asdict().items()}
    return [_plain(entry) for entry in value] if isinstance(value, tuple | list) else value
