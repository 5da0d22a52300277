"""``xbus demo``: all of it once, on a virtual device."""

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
from xbus.cli.printing import align, bold, print_line

if TYPE_CHECKING:
    from xbus.log.column import Column
    from xbus.log.log import Log

__all__ = ["demo"]

#: What is asked for, at the highest rate, of what the product has.
WANTED = (
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
#: Reals of 32 bits would tell metres apart only.
FINE = ("lat_lon", "altitude_ellipsoid")
#: What is drawn.
DRAWN = ("acceleration_hr", "rate_of_turn_hr")
#: Characters in a curve, and those it is made of; the latter where the terminal has no such ones.
WIDTH = 56
BARS, PLAIN_BARS = "▁▂▃▄▅▆▇█", "_.-~=+*#"
#: Seconds from power-up to when a virtual receiver has its first fix, and some more.
FIXED = 5.0


@click.command(epilog="Example: xbus demo --folder /tmp/demo")
@click.option(
    "--folder",
    type=click.Path(),
    default="xbus-demo",
    show_default=True,
    metavar="DIR",
    help="Where the files go.",
)
@click.option(
    "--seconds",
    type=click.FloatRange(0.5, 3600),
    default=3,
    show_default=True,
    metavar="S",
    help="How long to record.",
)
@click.option(
    "--product", default="MTi-680G", show_default=True, metavar="NAME", help="Which virtual device."
)
def demo(folder: str, seconds: float, product: str) -> None:
    """From connecting to a picture, with a virtual device.

    It is configured to send all that it can as fast as it can, on a port like that of a real one; that is
    recorded, decoded, summarised and drawn. The table is Parquet where pyarrow is installed (the extra
    arrow), else an npz. The picture is a PNG where matplotlib is installed (the extra plot), else a few
    lines on the terminal.
    """
    from xbus.cli.page import page
    from xbus.describe.log_summary import LogSummary
    from xbus.log.read import iter_log, read_log

    path = Path(folder, "demo.mtb")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _record(path, seconds, product)
        print_line("\n" + page(label(str(path)), LogSummary(iter_log(path))) + "\n", now=True)
        log = read_log(path)
        files = [path, _table(log, path)]
        if (picture := _picture(log, path)) is not None:
            files.append(picture)
        else:
            print_line("\n".join(_curves(log)) + "\n")
    except OSError as error:
        raise cannot(f"write to {label(error.filename or folder)}", error) from error
    print_line("\n".join(f"written: {label(str(it))}" for it in files))


def _record(path: Path, seconds: float, product: str) -> None:
    """Records a virtual device, which a thread serves as a program of its own would."""
    from xbus.device import connect
    from xbus.sim import SimulatedDevice, serving

    try:
        virtual = SimulatedDevice(product, noise=1)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    virtual.advance(FIXED)
    virtual.read()
    with serving(virtual, tcp=not hasattr(os, "openpty")) as port, connect(port) as device:
        with device.configure():
            print_line(f"connected:  {device.product_code}, virtual, on {port}", now=True)
            assert device.support is not None  # noqa: S101 - the virtual products are all known
            names = [it for it in WANTED if device.support.rates_of(it)]
            wanted = {(it, "Fp1632") if it in FINE else it: None for it in names}
            # There is no line with a baud rate behind this port.
            outputs = device.set_output_configuration(wanted, check_baudrate=False)
            print_line(f"configured: {len(outputs)} quantities at their highest rates", now=True)
        with device.record(path, overwrite=True) as recording:
            time.sleep(seconds)  # the recording goes on by itself
    print_line(f"recorded:   {recording.bytes:,} bytes in {seconds:g} s", now=True)


def _table(log: Log, path: Path) -> Path:
    """The file with the numbers."""
    try:
        table = path.with_suffix(".parquet")
        log.to_parquet(table)
    except ImportError:
        table = path.with_suffix(".npz")
        log.to_npz(table)
    return table


def _drawn(log: Log) -> list[Column]:
    return [log[it] for it in DRAWN if it in log]


def _picture(log: Log, path: Path) -> Path | None:
    """The file with the picture, where matplotlib is installed."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return None
    columns = _drawn(log)
    figure = Figure(figsize=(9, 3 * len(columns)), layout="constrained")
    for axes, column in zip(
        figure.subplots(len(columns), squeeze=False)[:, 0], columns, strict=True
    ):
        axes.plot(column.time - log.time[0], column.values, linewidth=0.8, label=column.fields)
        axes.set(ylabel=f"{column.name}, {column.unit}", xlabel="time, s")
        axes.legend(loc="upper right")
    picture = path.with_suffix(".png")
    figure.savefig(picture, dpi=150)
    return picture


def _curves(log: Log) -> Iterator[str]:
    """The picture in lines of text."""
    import numpy as np

    encoding = getattr(sys.stdout, "encoding", None) or "ascii"
    bars = BARS if BARS.encode(encoding, "ignore").decode(encoding) == BARS else PLAIN_BARS
    for column in _drawn(log):
        yield bold(f"{column.name}, {column.unit}")
        rows = []
        for name, values in zip(column.fields, column.values.T, strict=True):
            means = [float(it.mean()) for it in np.array_split(values, min(WIDTH, len(values)))]
            low, high = min(means), max(means)
            scale = (len(bars) - 1) / ((high - low) or 1)
            curve = "".join(bars[round((it - low) * scale)] for it in means)
            rows.append((name, f"{low:.2f}", curve, f"{high:.2f}"))
        yield from align(rows, right=(1, 3))
