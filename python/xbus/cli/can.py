"""``xbus can``: files for the CAN output of the 600-series."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from xbus.cli.can_options import ids_option
from xbus.cli.export_target import check_output, writing
from xbus.cli.inputs import label
from xbus.cli.printing import print_line

if TYPE_CHECKING:
    from xbus.can.ids import DeviceIds

__all__ = ["can"]


@click.group(epilog="Example: xbus can dbc -o mti600.dbc")
def can() -> None:
    """Writes files for the CAN output of MTi-600 devices.

    xbus info, decode and report read CAN captures.
    """


@can.command(epilog="Example: xbus can dbc -o mti600.dbc")
@click.option(
    "-o", "out", metavar="OUT", help="File to write. Without it, the text goes to standard output."
)
@ids_option
def dbc(out: str | None, ids: Sequence[DeviceIds] | None) -> None:
    """Writes a DBC file, with which other software decodes the frames.

    It has all messages whose layout is known, in SI units and degrees. The exponent of DeltaV selects the
    signals: x_17 is that of 400 Hz. With --ids, the messages have the identifiers of the devices; those of
    several devices have the number of the device behind their names.

    An existing OUT is replaced, and a failed run leaves no partial file. --ids requires the extra: pip
    install "xbus-mti[can]".
    """
    from xbus.can.dbc import dbc_text

    if out is not None:
        check_output([], out)
    text = dbc_text(ids)
    if out is None:
        print_line(text.rstrip("\n"))
        return
    from xbus.export.replacing import replacing

    with writing(out), replacing(out) as file:
        file.write(text.replace("\n", "\r\n").encode())  # as CANdb++ writes it
    messages = sum(line.startswith("BO_ ") for line in text.splitlines())
    click.echo(f"{label(out)}: {messages} messages", err=True)
