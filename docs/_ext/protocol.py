"""What the pages take from the package when they are built.

    ```{protocol} quantities
    ```

shows a table of the protocol: quantities, formats, fields, messages, status, codes or products.

    ```{help} decode
    ```

shows what ``xbus decode --help`` prints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import ClassVar

import click
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from xbus import Coordinates, Precision, encode_packet
from xbus.cli import main
from xbus.cli.tables import _layout, _lengths, _products  # the words of ``xbus items``
from xbus.tables import MESSAGES, PRODUCTS, QUANTITIES, RESULT_CODES, STATUS_FLAGS, Field

#: What a cell shows: text, or code where it is wrapped.
Cell = str | nodes.Node
Rows = Iterable[tuple[Cell, ...]]


def code(text: str) -> Cell:
    return nodes.literal(text=text) if text else ""


def table(header: tuple[str, ...], rows: Rows) -> nodes.table:
    group = nodes.tgroup(cols=len(header))
    group += [nodes.colspec(colwidth=20) for _ in header]
    head, body = nodes.thead(), nodes.tbody()
    group += [head, body]
    head += row(header)
    body += [row(it) for it in rows]
    return nodes.table("", group, classes=["colwidths-auto"])


def row(cells: tuple[Cell, ...]) -> nodes.row:
    out = nodes.row()
    for cell in cells:
        inline = nodes.Text(cell) if isinstance(cell, str) else cell
        out += nodes.entry("", nodes.paragraph("", "", inline))
    return out


def quantities() -> list[nodes.Node]:
    header = (
        "identifier",
        "name",
        "manual",
        "carries",
        "components",
        "unit",
        "coordinates",
        "products",
        "source",
    )
    rows = (
        (
            code(f"{it.id:04X}"),
            code(it.name),
            it.manual,
            _layout(it),
            code(" ".join(it.components)),
            it.unit,
            "yes" if it.coordinates else "",
            _products(it.products),
            it.source,
        )
        for it in QUANTITIES.values()
    )
    return [table(header, rows)]


def formats() -> list[nodes.Node]:
    def size(it: Precision) -> int:
        header = 3  # identifier and size
        return len(encode_packet(("temperature", it.name), 0)) - header

    precisions = ((f"{it:04b}", it.name, f"{size(it)} bytes") for it in Precision)
    coordinates = ((f"{it:04b}", it.name, "") for it in Coordinates)
    return [table(("bits", "format", "a number takes"), [*precisions, *coordinates])]


def fields() -> list[nodes.Node]:
    out: list[nodes.Node] = []
    for it in QUANTITIES.values():
        for title, list_ in ((it.name, it.fields), (f"{it.name}, each entry", it.entry)):
            if list_:
                out += [nodes.rubric(text=title), field_table(list_)]
    return out


def field_table(rows: tuple[Field, ...]) -> nodes.table:
    def missing(it: Field) -> str:
        return "" if it.missing is None else f"{it.missing:#X}"

    header = ("field", "type", "one count is", "unit", "not provided")
    return table(
        header,
        (
            (code(it.name), code(it.type), f"{it.scale:g}", it.unit, code(missing(it)))
            for it in rows
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
            code(f"{it.mid:02X}"),
            code(it.name),
            it.direction,
            ", ".join(it.states),
            it.payload,
            _lengths(it.lengths),
            code("" if it.reply is None else f"{it.reply:02X}"),
            _products(it.products),
            it.status,
        )
        for it in MESSAGES
    )
    return [table(header, rows)]


def status() -> list[nodes.Node]:
    def bits(first: int, width: int) -> str:
        return str(first) if width == 1 else f"{first} to {first + width - 1}"

    rows = ((bits(it.bit, it.width), code(it.name), it.meaning) for it in STATUS_FLAGS)
    return [table(("bits", "name", "meaning"), rows)]


def codes() -> list[nodes.Node]:
    return [table(("code", "meaning"), ((str(key), text) for key, text in RESULT_CODES.items()))]


def products() -> list[nodes.Node]:
    rows = ((str(it.number), it.title, it.series) for it in PRODUCTS.values())
    return [table(("number", "product", "series"), rows)]


class Protocol(SphinxDirective):
    """``protocol NAME``."""

    required_arguments = 1
    tables: ClassVar[dict[str, Callable[[], list[nodes.Node]]]] = {
        it.__name__: it for it in (quantities, formats, fields, messages, status, codes, products)
    }

    def run(self) -> list[nodes.Node]:
        name = self.arguments[0]
        if name not in self.tables:
            raise self.error(f"no table {name!r}; there are {', '.join(self.tables)}")
        return self.tables[name]()


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
    app.add_directive("help", Help)
    # The tables change with the extension, not with the page.
    return {"parallel_read_safe": True, "parallel_write_safe": True}
