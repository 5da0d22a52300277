"""``xbus items`` and ``xbus messages``: the protocol's tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import click

from xbus.cli.failure import Failure
from xbus.cli.printing import print_json_rows, print_table

if TYPE_CHECKING:
    from xbus.protocol.tables import Field, MessageRow, Quantity

    Row = TypeVar("Row", Quantity, MessageRow)

__all__ = ["items", "messages"]


@click.command(epilog="Example: xbus items gnss")
@click.argument("text", required=False, default="")
@click.option("--json", "as_json", is_flag=True, help="A JSON list, with the fields of structs.")
def items(text: str, as_json: bool) -> None:
    """The data identifiers, each a quantity.

    With TEXT, those that have it in some cell. The last digit of each is 0 here; a device puts the
    precision and the coordinates there.
    """
    from xbus.protocol.tables import QUANTITIES

    def cells(it: Quantity) -> list[str]:
        systems = "ENU NED NWU" if it.coordinates else ""
        about = [_layout(it), it.unit, systems, _products(it.products), it.source]
        return [f"0x{it.id:04X}", it.name, it.manual, *about]

    head = ["id", "name", "manual", "layout", "unit", "coordinates", "products", "source"]
    spare = ["manual", "products", "source"]
    _show(head, QUANTITIES.values(), cells, text, spare, as_json=as_json)


@click.command(epilog="Example: xbus messages baud")
@click.argument("text", required=False, default="")
@click.option("--json", "as_json", is_flag=True, help="A JSON list, with all lengths and products.")
def messages(text: str, as_json: bool) -> None:
    """The messages and their identifiers.

    With TEXT, those that have it in some cell. The length is in bytes of payload; a reply is the MID
    that answers.
    """
    from xbus.protocol.tables import MESSAGES

    def cells(it: MessageRow) -> list[str]:
        reply = "" if it.reply is None else f"0x{it.reply:02X}"
        about = [_lengths(it.lengths), it.payload, _products(it.products), it.status]
        return [f"0x{it.mid:02X}", it.name, it.direction, " ".join(it.states), reply, *about]

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
    spare = ["states", "products", "status"]
    _show(head, MESSAGES.values(), cells, text, spare, as_json=as_json)


def _show(
    head: Sequence[str],
    rows: Iterable[Row],
    cells: Callable[[Row], list[str]],
    text: str,
    spare: Sequence[str],
    *,
    as_json: bool,
) -> None:
    """Prints the rows that have the text in some cell, in whichever case."""
    shown = [it for it in rows if any(text.lower() in cell.lower() for cell in cells(it))]
    if not shown:
        raise Failure(
            f"nothing in the table has {text!r} in it; leave it out to see the whole table"
        )
    if as_json:
        print_json_rows([_plain(it) for it in shown])
    else:
        print_table(head, [cells(it) for it in shown], spare=spare)


def _plain(value: Any) -> Any:
    """Rows as dicts, in any depth."""
    if hasattr(value, "_asdict"):
        return {key: _plain(it) for key, it in value._asdict().items()}
    return [_plain(it) for it in value] if isinstance(value, tuple | list) else value


def _layout(row: Quantity) -> str:
    """What a packet holds, in words."""
    match row.kind:
        case "struct":
            return f"{len(row.fields)} fields, {row.size} bytes"
        case "list":
            return f"{_bytes(row.fields)} bytes and {_bytes(row.entry)} each"
        case "id":
            return "u4 or u8"
    return f"{row.numbers} {row.kind}" if row.numbers > 1 else row.kind


def _bytes(fields: Iterable[Field]) -> int:
    return sum(int(it.type[1:]) for it in fields)


def _lengths(lengths: Sequence[int] | None) -> str:
    if lengths is None:
        return "any"
    if len(lengths) < 4:
        return ", ".join(map(str, lengths))
    step = lengths[1] - lengths[0]
    steps = f" by {step}" if step > 1 else ""
    return f"{lengths[0]} to {lengths[-1]}{steps}"


def _products(numbers: Sequence[int]) -> str:
    """The products with these numbers, by series where all of it is among them."""
    from xbus.protocol.tables import PRODUCTS

    if len(numbers) == len(PRODUCTS):
        return "all"
    series: dict[str, list[int]] = {}
    for it in PRODUCTS.values():
        series.setdefault(it.series, []).append(it.number)
    parts: list[str] = []
    for name, members in series.items():
        those = [it for it in members if it in numbers]
        parts += [name] if those == members else [str(it) for it in those]
    return " ".join(parts)
