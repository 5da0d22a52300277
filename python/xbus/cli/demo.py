"""``xbus demo``: a tour of xbus with a virtual device."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from xbus.cli.failure import cannot
from xbus.cli.inputs import label
from xbus.cli.number_type import NumberRange
from xbus.cli.printing import align, bold, print_line

if TYPE_CHECKING:
    from xbus.log.column import Column
    from xbus.log.log import Log

__all__ = ["demo"]

#: Quantities to output at their highest rates, if the product has them.
QUANTITIES = (
    "packet_counter",
    "sample_time_fine",
    "utc_time",
    "quaternion",
    "acceleration",
    "rate_of_turn",
    "acceleration_hr",
    "rate_of_turn_hr",
    "magnetic_field",
    "baro_pressure",
    "lat_lon",
    "altitude_ellipsoid",
    "velocity_xyz",
    "gnss_pvt_data",
    "status_word",
)
#: Quantities that Float32 would resolve only to metres.
PRECISE = ("lat_lon", "altitude_ellipsoid")
#: Quantities to plot.
PLOTTED = ("acceleration_hr", "rate_of_turn_hr")
#: Width of a text plot, and its characters for terminals with and without Unicode.
WIDTH = 56
BARS, ASCII_BARS = "▁▂▃▄▅▆▇█", "_.-~=+*#"
#: Time after power-up when a virtual receiver certainly has a fix, in seconds.
FIX_TIME = 5.0


@click.command(epilog="Example: xbus demo --folder /tmp/demo")
@click.option(
    "--folder",
    type=click.Path(),
    default="xbus-demo",
    show_default=True,
    metavar="DIR",
    help="Folder for the files.",
)
@click.option(
    "--seconds",
    type=NumberRange(0.5, 3600),
    default=3,
    show_default=True,
    metavar="S",
    help="Duration of the recording.",
)
@click.option(
    "--product",
    default="MTi-680G",
    show_default=True,
    metavar="NAME",
    help="Product of the virtual device.",
)
def demo(folder: str, seconds: float, product: str) -> None:
    """Records, decodes and plots data of a virtual device.

    Configures a virtual device to send many quantities at their highest rates, records and decodes them,
    writes the table to a Parquet file, and prints a summary. Plots to a PNG file if matplotlib is installed
    (extra plot), else to the terminal.
    """
    from xbus.cli.info_text import info_text
    from xbus.describe.log_summary import LogSummary
    from xbus.log.read import iter_log, read_log

    path = Path(folder, "demo.mtb")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _record(path, seconds, product)
        print_line(
            "\n" + info_text(label(str(path)), LogSummary(iter_log(path))) + "\n", flush=True
        )
        log = read_log(path)
        table = path.with_suffix(".parquet")
        log.to_parquet(table)
        files = [path, table]
        if (plot := _plot(log, path)) is not None:
            files.append(plot)
        else:
            print_line("\n".join(_curves(log)) + "\n")
    except BrokenPipeError:  # the reader of the output has seen enough
        raise
    except OSError as error:
        raise cannot(f"write to {label(error.filename or folder)}", error) from error
    print_line("\n".join(f"wrote {label(str(file))}" for file in files))


def _record(path: Path, seconds: float, product: str) -> None:
    """Records a virtual device that a thread serves on a port."""
    from xbus.device import connect
    from xbus.sim import SimulatedDevice, serving

    try:
        virtual = SimulatedDevice(product, noise=1)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    virtual.advance(FIX_TIME)
    virtual.read()
    with serving(virtual, tcp=not hasattr(os, "openpty")) as port, connect(port) as device:
        with device.configure():
            print_line(f"connected:  {device.product_code}, virtual, on {port}", flush=True)
            assert device.support is not None  # noqa: S101 - the virtual products are all known
            names = [name for name in QUANTITIES if device.support.rates_of(name)]
            rates = {(name, "Fp1632") if name in PRECISE else name: None for name in names}
            # This port is not a serial line and has no baud rate.
            outputs = device.set_output_configuration(rates, check_baudrate=False)
            print_line(f"configured: {len(outputs)} quantities at their highest rates", flush=True)
        with device.record(path, overwrite=True) as recording:
            time.sleep(seconds)  # the recording runs in the background
    print_line(f"recorded:   {recording.bytes:,} bytes in {seconds:g} s", flush=True)


def _plotted(log: Log) -> list[Column]:
    return [log[name] for name in PLOTTED if name in log]


def _plot(log: Log, path: Path) -> Path | None:
    """Writes the plot and returns its path; None without matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return None
    names = [column.name for column in _plotted(log)]
    figure = Figure(figsize=(9, 3 * len(names)), layout="constrained")
    log.plot(names, ax=figure.subplots(len(names), squeeze=False))
    plot = path.with_suffix(".png")
    figure.savefig(plot, dpi=150)
    return plot


def _curves(log: Log) -> Iterator[str]:
    """Yields the plot as lines of text."""
    import numpy as np

    encoding = getattr(sys.stdout, "encoding", None) or "ascii"
    bars = BARS if BARS.encode(encoding, "ignore").decode(encoding) == BARS else ASCII_BARS
    for column in _plotted(log):
        yield bold(f"{column.name}, {column.unit}")
        rows = []
        for name, values in zip(column.fields, column.values.T, strict=True):
            parts = np.array_split(values, min(WIDTH, len(values)))
            means = [float(part.mean()) for part in parts]
            low, high = min(means), max(means)
            scale = (len(bars) - 1) / ((high - low) or 1)
            curve = "".join(bars[round((mean - low) * scale)] for mean in means)
            rows.append((name, f"{low:.2f}", curve, f"{high:.2f}"))
        yield from align(rows, right=(1, 3))
