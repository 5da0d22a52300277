"""Sphinx directives that fill pages from the package when they are built.

    ```{protocol} quantities
    ```

shows a table of the protocol; `Protocol` names them all.

    ```{commands} 5.3.1
    ```

shows the methods for the commands of a section of the manual, of `xbus.Device` or its `commands`.

    ```{help} decode
    ```

shows what ``xbus decode --help`` prints.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable
from typing import ClassVar, TypeAlias

import click
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from xbus import Coordinates, Device, Precision, encode_packet
from xbus.cli import main
from xbus.describe.table_text import (
    describe_layout,
    describe_lengths,
    describe_products,
    describe_raw_unit,
)
from xbus.describe.text import value_text
from xbus.device.commands import Commands
from xbus.protocol import EVERY, HardwareVersion, OptionFlag, Output, StringType
from xbus.protocol.mtdata import MTDATA_ITEMS, MtDataItem
from xbus.protocol.products import Support, support
from xbus.protocol.strings import STRING_FIELDS
from xbus.protocol.tables import (
    COLUMN_QUANTITIES,
    MESSAGES,
    MTDATA_QUANTITIES,
    PRODUCTS,
    QUANTITIES,
    RESULT_CODES,
    STATUS_FLAGS,
    Field,
    MessageRow,
    Quantity,
)
from xbus.protocol.values import BAUD_CODES

#: What a cell shows: text, or code where it is wrapped.
Cell: TypeAlias = str | nodes.Node
Rows = Iterable[tuple[Cell, ...]]


def code(text: str) -> Cell:
    return nodes.literal(text=text) if text else ""


def table(header: tuple[str, ...], rows: Rows) -> nodes.table:
    group = nodes.tgroup(cols=len(header))
    group += [nodes.colspec(colwidth=20) for _ in header]
    head, body = nodes.thead(), nodes.tbody()
    group += [head, body]
    head += row(header)
    body += [row(item) for item in rows]
    return nodes.table("", group, classes=["colwidths-auto", "wide"])


def row(cells: tuple[Cell, ...]) -> nodes.row:
    out = nodes.row()
    for cell in cells:
        inline = nodes.Text(cell) if isinstance(cell, str) else cell
        out += nodes.entry("", nodes.paragraph("", "", inline))
    return out


def names(quantity: Quantity) -> nodes.Node:
    """Returns the name in xbus, and that of the manual below it."""
    return nodes.inline("", "", code(quantity.name), nodes.Text(f" {quantity.manual}"))


def quantities() -> list[nodes.Node]:
    header = (
        "identifier",
        "name",
        "layout",
        "components",
        "unit",
        "axes",
        "coordinates",
        "products",
        "source",
    )
    rows = (
        (
            code(f"{quantity.id:04X}"),
            names(quantity),
            describe_layout(quantity),
            code(" ".join(quantity.components)),
            quantity.unit,
            quantity.axes or "",
            "yes" if quantity.coordinates else "",
            describe_products(quantity.products),
            quantity.source,
        )
        for quantity in QUANTITIES.values()
    )
    return [table(header, rows)]


def mtdata_items() -> list[nodes.Node]:
    """Returns the items of MTData, in the order of the wire."""

    def condition(item: MtDataItem) -> str:
        bits = [bit for bit in range(32) if item.mask >> bit & 1]
        return ", ".join(f"bit {bit} = {item.value >> bit & 1}" for bit in bits)

    rows = (
        (
            code(f"{item.mode:04X}" if item.mode else ""),
            condition(item),
            code(item.quantity),
            f"U2, {item.step} {COLUMN_QUANTITIES[item.quantity].unit}"
            if item.step
            else describe_layout(COLUMN_QUANTITIES[item.quantity]),
        )
        for item in MTDATA_ITEMS
    )
    return [table(("OutputMode", "OutputSettings", "quantity", "layout"), rows)]


def mtdata_quantities() -> list[nodes.Node]:
    """Returns the quantities that only MTData has."""
    rows = (
        (
            code(row.name),
            describe_layout(row),
            code(" ".join(row.components)),
            row.unit,
            row.axes or "",
            row.source,
        )
        for row in MTDATA_QUANTITIES.values()
    )
    header = ("name", "layout", "components", "unit", "axes", "source")
    return [table(header, rows)]


def formats() -> list[nodes.Node]:
    def size(precision: Precision) -> int:
        header = 3  # identifier and size
        return len(encode_packet(("temperature", precision.name), 0)) - header

    precisions = (
        (f"{precision:04b}", precision.name, f"{size(precision)} bytes") for precision in Precision
    )
    coordinates = ((f"{system:04b}", system.name, "") for system in Coordinates)
    return [table(("bits", "format", "a number takes"), [*precisions, *coordinates])]


def fields() -> list[nodes.Node]:
    out: list[nodes.Node] = []
    for quantity in (*QUANTITIES.values(), *MTDATA_QUANTITIES.values()):
        for title, list_ in (
            (quantity.name, quantity.fields),
            (f"{quantity.name}, each entry", quantity.entry),
        ):
            if list_:
                out += [nodes.rubric(text=title), field_table(list_)]
    return out


def field_table(rows: tuple[Field, ...]) -> nodes.table:
    def missing(field: Field) -> str:
        return "" if field.missing is None else f"{field.missing:#X}"

    header = ("field", "type", "unit", "raw count", "not provided")
    return table(
        header,
        (
            (
                code(field.name),
                code(field.type),
                field.unit,
                describe_raw_unit(field),
                code(missing(field)),
            )
            for field in rows
        ),
    )


def messages() -> list[nodes.Node]:
    header = (
        "MID",
        "name",
        "direction",
        "valid in",
        "payload",
        "bytes",
        "reply",
        "products",
        "status",
    )
    rows = (
        (
            code(f"{message.mid:02X}"),
            code(message.name),
            message.direction,
            ", ".join(message.states),
            message.payload,
            describe_lengths(message.lengths),
            code("" if message.reply is None else f"{message.reply:02X}"),
            describe_products(message.products),
            message.status,
        )
        for message in MESSAGES.values()
    )
    return [table(header, rows)]


def status() -> list[nodes.Node]:
    def bits(first: int, width: int) -> str:
        return str(first) if width == 1 else f"{first} to {first + width - 1}"

    rows = (
        (bits(status_flag.bit, status_flag.width), code(status_flag.name), status_flag.meaning)
        for status_flag in STATUS_FLAGS.values()
    )
    return [table(("bits", "name", "meaning"), rows)]


def codes() -> list[nodes.Node]:
    return [table(("code", "meaning"), ((str(key), text) for key, text in RESULT_CODES.items()))]


def products() -> list[nodes.Node]:
    rows = (
        (
            str(product.number),
            product.title,
            product.series,
            product.kind,
            f"{product.id_size} bytes",
        )
        for product in PRODUCTS.values()
    )
    return [table(("number", "product", "series", "computes", "identifier"), rows)]


# What products support


def rate(supported: Support, quantity: str) -> str:
    """Returns the highest rate of a quantity, ``only`` where it is the only one."""
    highest = supported.rates.get(quantity, 0)
    if highest == EVERY:
        return "each"
    only = " only" if highest > 1 and len(supported.rates_of(quantity)) == 1 else ""
    return f"{highest}{only}" if highest else ""


def rates() -> list[nodes.Node]:
    families: dict[tuple[str, ...], list[int]] = {}
    for product in PRODUCTS:
        column = tuple(rate(support(product), name) for name in QUANTITIES)
        families.setdefault(column, []).append(product)
    header = ("quantity", *(", ".join(map(str, family)) for family in families.values()))
    rows = ((code(name), *cells) for name, *cells in zip(QUANTITIES, *families, strict=True))
    return [table(header, (cells for cells in rows if any(cells[1:])))]


def hardware_rates() -> list[nodes.Node]:
    """Returns the table of rates that depend on the hardware version."""

    def cells(number: int, quantity: str) -> list[str]:
        versions = [None, *(HardwareVersion(value, 0) for value in (1, 2, 3))]
        return [rate(support(number, version), quantity) for version in versions]

    differing: dict[tuple[str, ...], list[int]] = {}
    for quantity in QUANTITIES:
        for number in PRODUCTS:
            rates = cells(number, quantity)
            if len(set(rates)) > 1:
                differing.setdefault((quantity, *rates), []).append(number)
    header = ("quantity", "products", "not known", "1", "2", "3")
    return [
        table(
            header,
            (
                (code(quantity), describe_products(numbers), *rates)
                for (quantity, *rates), numbers in differing.items()
            ),
        )
    ]


def sync() -> list[nodes.Node]:
    found: dict[tuple[int, str, str], list[int]] = {}
    for number in PRODUCTS:
        for function, lines in support(number).sync.items():
            key = (int(function), function.name, " ".join(line.name for line in lines))
            found.setdefault(key, []).append(number)
    rows = (
        (
            str(number),
            code(function),
            code(lines),
            describe_products(found[number, function, lines]),
        )
        for number, function, lines in sorted(found)
    )
    return [table(("number", "function", "lines", "products"), rows)]


def _bits(
    kind: type[OptionFlag | StringType], word: str, of: Callable[[Support], int]
) -> list[nodes.Node]:
    """Returns the bits of a kind, and the products that have each."""
    rows = (
        (
            code(f"{flag.value:04X}"),
            code(flag.name or ""),
            describe_products([number for number in PRODUCTS if of(support(number)) & flag]),
        )
        for flag in kind
    )
    return [table(("bit", word, "products"), rows)]


def option_flags() -> list[nodes.Node]:
    return _bits(OptionFlag, "flag", lambda support: support.option_flags)


def strings() -> list[nodes.Node]:
    return _bits(StringType, "string", lambda support: support.string_types)


def string_fields() -> list[nodes.Node]:
    rows = (
        (code(kind.name or ""), code(field.name), field.unit)
        for kind, layout in STRING_FIELDS.items()
        for field in layout.fields
        if field.name
    )
    return [table(("string", "field", "unit"), rows)]


def filter_profiles() -> list[nodes.Node]:
    found: dict[tuple[int, str], list[int]] = {}
    for number in PRODUCTS:
        for filter_profile in support(number).filter_profiles:
            found.setdefault((filter_profile.type, filter_profile.label), []).append(number)
    rows = (
        (str(kind), code(label), describe_products(found[kind, label])) for kind, label in found
    )
    return [table(("number", "profile", "products"), rows)]


def baudrates() -> list[nodes.Node]:
    every = sorted(set(BAUD_CODES.values()))
    rows = (
        (
            f"{baudrate:,}",
            describe_products(
                [number for number in PRODUCTS if baudrate in support(number).baudrates]
            ),
        )
        for baudrate in every
    )
    return [table(("bits per second", "products"), rows)]


def defaults() -> list[nodes.Node]:
    def text(output: Output) -> str:
        precision = "" if output.precision is None else f" {output.precision.name}"
        frequency = "" if output.frequency == EVERY else f" {output.frequency} Hz"
        return f"{output.quantity}{precision}{frequency}"

    found: dict[tuple[str, ...], list[int]] = {}
    for number in PRODUCTS:
        supported = support(number)
        values = (
            ", ".join(map(text, supported.output_configuration)),
            str(supported.filter_profile or ""),
            value_text(supported.sync_settings) if supported.sync_settings else "",
        )
        found.setdefault(values, []).append(number)
    rows = (
        (describe_products(numbers), outputs, code(profile), code(sync))
        for (outputs, profile, sync), numbers in found.items()
    )
    return [table(("products", "output configuration", "filter profile", "synchronization"), rows)]


def identities() -> list[nodes.Node]:
    def cells(supported: Support) -> tuple[Cell, ...]:
        product, identity = supported.product, supported.identity
        return (
            product.name,
            code(f"{identity.device_id:0{2 * product.id_size}X}"),
            code(identity.product_code),
            str(identity.firmware),
            str(identity.hardware),
        )

    header = ("product", "device identifier", "product code", "firmware", "hardware")
    return [table(header, (cells(support(product)) for product in PRODUCTS))]


# Commands

#: Messages to a device by what a method for them is called, without underscores.
REQUESTS = {
    message.name.lower(): message for message in MESSAGES.values() if message.direction != "to host"
}
#: The method that waits for WakeUp as well.
REQUESTS["wakeup"] = REQUESTS["wakeupack"]


def request_of(method: str) -> MessageRow | None:
    return REQUESTS.get(method.replace("_", ""))


def sections() -> dict[str, list[str]]:
    """Returns the methods for commands by the section of the manual, which comments in the source name."""
    found: dict[str, list[str]] = {"5.3.1": []}
    marks = re.compile(r"^    (?:# (5\.3\.\d)|def ([a-z]\w+))", re.MULTILINE)
    methods = found["5.3.1"]
    for number, method in marks.findall(inspect.getsource(Commands)):
        if number:
            methods = found.setdefault(number, [])
        else:
            methods.append(method)
    # Commands of `Device` itself follow the raw ones with the same MID.
    for name in vars(Device):
        row = request_of(name)
        if row is None or any(name in methods for methods in found.values()):
            continue
        for methods in found.values():
            same = [
                method
                for method in methods
                if (other := request_of(method)) and other.mid == row.mid
            ]
            if same:
                methods.insert(methods.index(same[-1]) + 1, name)
                break
        else:
            found["5.3.1"].append(name)  # the state messages
    return found


def owner_of(method: str) -> type[Device | Commands]:
    return Device if method in vars(Device) else Commands


def what_it_does(method: str) -> str:
    """Returns the first paragraphs of a docstring as one, without the message that they begin with."""
    text = inspect.getdoc(getattr(owner_of(method), method)) or ""
    text = re.split(r"\n(?:Args|Returns|Raises):", text)[0]
    text = re.sub(r"^\w+ \(0x[0-9A-F]{2}(?:, ([^)]*))?\)[:;.]?\s*", r"\1: ", text)
    text = " ".join(text.split()).strip(",: ")
    return text[:1].upper() + text[1:]


def variants(row: MessageRow) -> list[MessageRow]:
    """Returns the message, and its variants on some products under the same MID."""
    return [
        request for request in REQUESTS.values() if request.name in (row.name, f"{row.name}Modern")
    ]


def others() -> list[nodes.Node]:
    have = {
        row.name for section in sections().values() for name in section if (row := request_of(name))
    }
    rows = (
        (
            code(f"{message.mid:02X}"),
            code(message.name),
            message.payload,
            describe_products(message.products),
            message.status,
        )
        for message in MESSAGES.values()
        if message.direction != "to host" and message.name.removesuffix("Modern") not in have
    )
    return [table(("MID", "message", "payload", "products", "status"), rows)]


class Protocol(SphinxDirective):
    """``protocol NAME``."""

    required_arguments = 1
    tables: ClassVar[dict[str, Callable[[], list[nodes.Node]]]] = {
        item.__name__: item
        for item in (
            quantities,
            mtdata_items,
            mtdata_quantities,
            formats,
            fields,
            messages,
            status,
            codes,
            products,
            rates,
            hardware_rates,
            sync,
            option_flags,
            strings,
            string_fields,
            filter_profiles,
            baudrates,
            defaults,
            identities,
            others,
        )
    }

    def run(self) -> list[nodes.Node]:
        name = self.arguments[0]
        if name not in self.tables:
            raise self.error(f"no table {name!r}; there are {', '.join(self.tables)}")
        return self.tables[name]()


class CommandTable(SphinxDirective):
    """``commands SECTION``."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        methods = sections().get(self.arguments[0])
        if methods is None:
            raise self.error(f"no section {self.arguments[0]!r}; there are {', '.join(sections())}")
        header = ("method", "message", "MID", "valid in", "products", "gives", "what it does")
        return [table(header, map(self.cells, methods))]

    def cells(self, method: str) -> tuple[Cell, ...]:
        row = request_of(method)
        if row is None:
            raise self.error(f"{method} is not named like a message")
        numbers = {number for variant in variants(row) for number in variant.products}
        owner = owner_of(method)
        name = method if owner is Device else f"commands.{method}"
        target = "xbus.Device" if owner is Device else "xbus.device.Commands"
        gives = str(inspect.signature(getattr(owner, method)).return_annotation)
        return (
            self.text(f"{{py:meth}}`{name} <{target}.{method}>`"),
            code(row.name),
            code(f"{row.mid:02X}"),
            ", ".join(row.states),
            describe_products(sorted(numbers)),
            code("" if gives == "None" else gives.replace("v.", "")),
            self.text(what_it_does(method)),
        )

    def text(self, text: str) -> nodes.Node:
        return nodes.inline("", "", *self.parse_inline(text)[0])


class Help(SphinxDirective):
    """``help COMMAND``."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        context = click.Context(main, info_name="xbus", max_content_width=80)
        command = main.get_command(context, self.arguments[0])
        if command is None:
            raise self.error(f"no command {self.arguments[0]!r}")
        text = command.get_help(click.Context(command, context, command.name))
        return [nodes.literal_block(text, text, language="text")]


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("protocol", Protocol)
    app.add_directive("commands", CommandTable)
    app.add_directive("help", Help)
    # The tables change with the extension, not with the page.
    return {"parallel_read_safe": True, "parallel_write_safe": True}
