"""``xbus decode``: writes a log as a table."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from xbus.cli.export_target import check_output, quality_text, writing
from xbus.cli.failure import Failure
from xbus.cli.inputs import Input, label, no_frame, reading_task, strings_option
from xbus.cli.printing import print_json, suggestion
from xbus.cli.progress import Progress
from xbus.cli.resampling import check_resampling, resampled
from xbus.cli.undecoded import check_decoded, tracker_of, undecoded_lines
from xbus.formatting import format_count

if TYPE_CHECKING:
    from xbus.log.log import Log
    from xbus.protocol.keys import EntryKey

__all__ = ["decode"]

#: Functions of `xbus.log.export` that write a table, by suffix. An npz file is not a table.
WRITERS = {
    ".parquet": "parquet",
    ".csv": "csv",
    ".arrow": "feather",
    ".feather": "feather",
    ".npz": None,
}


def _out(ctx: click.Context, param: click.Parameter, value: str) -> str:  # noqa: ARG001 - click's
    """Returns a path with a known suffix."""
    if _suffix(value) not in WRITERS:
        raise click.BadParameter(f"{value!r} must end in one of {', '.join(WRITERS)}")
    return value


def _key(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    value: str | None,
) -> EntryKey | None:
    """Returns the key of a quantity (name, or name and coordinates), or the name of a string type."""
    if value is None:
        return None
    from xbus.protocol.ids import Coordinates
    from xbus.protocol.tables import QUANTITIES
    from xbus.protocol.values import StringType

    name, colon, coordinates = value.partition(":")
    if value in StringType.__members__:
        return value
    if name not in QUANTITIES:
        raise click.BadParameter(
            f"no quantity is called {name!r}; {suggestion(name, QUANTITIES, 'quantities')}"
        )
    if not colon:
        return name
    systems = Coordinates.__members__ if QUANTITIES[name].coordinates else {}
    if not systems:
        raise click.BadParameter(f"{name} has no coordinates; remove {colon + coordinates!r}")
    if coordinates.upper() not in systems:
        raise click.BadParameter(
            f"{name} has coordinates {', '.join(systems)}, not {coordinates!r}"
        )
    return name, coordinates.upper()


@click.command(epilog="Example: xbus decode walk.mtb -o walk.parquet")
@click.argument(
    "files", type=click.Path(readable=False), metavar="FILE...", nargs=-1, required=True
)
@click.option(
    "-o",
    "out",
    callback=_out,
    metavar="OUT",
    required=True,
    help="File to write: .parquet, .csv, .arrow, .feather or .npz.",
)
@click.option(
    "--quantity",
    "key",
    callback=_key,
    metavar="NAME",
    help="Write only this quantity, one row per packet, without nulls: acceleration or quaternion:NED; or "
    "the strings of a type: HEHDT.",
)
@click.option(
    "--rate-out",
    type=click.FloatRange(min=0, min_open=True),
    metavar="HZ",
    help="Resample to one row every 1/HZ seconds: interpolated; null across gaps.",
)
@click.option(
    "--max-gap",
    type=click.FloatRange(min=0),
    metavar="SECONDS",
    help="With --rate-out, the longest gap to interpolate across.  [default: 2.5 steps of each quantity]",
)
@click.option(
    "--tracker",
    metavar="ID",
    help="Write only this Awinda tracker: packet counter and magnetic field. xbus info lists them.",
)
@strings_option
@click.option("--strict", is_flag=True, help="Fail at the first damage.")
@click.option("-q", "--quiet", is_flag=True, help="Show no progress and no summary on stderr.")
@click.option(
    "--json", "as_json", is_flag=True, help="Print the summary as a JSON object on stdout."
)
def decode(
    files: tuple[str, ...],
    out: str,
    key: EntryKey | None,
    rate_out: float | None,
    max_gap: float | None,
    tracker: str | None,
    strings: tuple[str, ...],
    strict: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Writes a log as one table: Parquet, CSV, Arrow or npz.

    Several FILEs are joined in the given order, as pieces of one recording; - is standard input.

    The table has one row per sample. The columns are sample, time in seconds on the device clock, and the
    quantities (acceleration_x, ...) in the units that xbus quantities lists. Missing values are null.
    Satellites (--quantity gnss_sat_info) and the strings of each type are separate tables.

    An .npz file contains an array for each quantity, with NAME.sample and NAME.time. An existing OUT is
    replaced, and a failed run leaves no partial file.
    """
    check_output(files, out)
    check_resampling(key, rate_out, max_gap)
    if tracker and (key or rate_out):
        raise click.UsageError("--tracker excludes --quantity and --rate-out")
    if _suffix(out) != ".npz":
        from xbus.extras import require

        require("pyarrow", "arrow", f"to write {_suffix(out)} files")
    with Progress(reading_task(files[0]), shown=not quiet) as progress:
        log = _read(files, key, strings=strings, strict=strict, progress=progress)
        names = ", ".join(map(label, files))
        check_decoded(log, names)
        table = _table(log, key, names, is_npz=_suffix(out) == ".npz")
        if rate_out is not None:
            table = resampled(log, key, rate_out, max_gap, names)
        if tracker is not None:
            table = tracker_of(log, tracker, names)
        progress.update(f"writing {label(os.path.basename(out))}")  # noqa: PTH119
        rows, columns = _write(log, table, key, out)
    if as_json:
        print_json(_summary_dict(files, out, key, log, rows, columns))
    if not quiet:
        shape = f"{format_count(rows, 'row')}, {format_count(columns, 'column')}"
        click.echo(f"{label(out)}: {shape}; {quality_text(log)}", err=True)
        for line in undecoded_lines(log):
            click.echo(line, err=True)


def _suffix(path: str) -> str:
    return os.path.splitext(path)[1].lower()  # noqa: PTH122 - pathlib is slow to import


def _read(
    files: Sequence[str],
    key: EntryKey | None,
    *,
    strings: Sequence[str],
    strict: bool,
    progress: Progress,
) -> Log:
    from xbus.errors import DecodeError
    from xbus.log.read import read_log

    quantities = None if key is None else [] if _is_string(key) else [key]
    with Input(files, progress) as source:
        try:
            log = read_log(source, strict=strict, quantities=quantities, strings=strings)
        except DecodeError as error:
            problem, _, _ = str(error).partition(";")
            where = f", which is {source.locate(error.offset)}" if len(files) > 1 else ""
            names = ", ".join(map(label, files))
            raise Failure(
                f"{names}: {problem}{where}; without --strict, damage is skipped"
            ) from error
    if not len(log) and not len(log.messages) and not log.stats.strings:
        raise no_frame(files, log.stats.bytes)
    return log


def _write(log: Log, table: Any, key: EntryKey | None, out: str) -> tuple[int, int]:
    """Writes OUT and returns its rows and columns; for an npz file its samples and quantities."""
    writer = WRITERS[_suffix(out)]
    if writer is None and isinstance(key, str) and _is_string(key):
        from xbus.log import export

        strings = log.strings.table(key)
        with writing(out):
            export.npz({key: strings}, out)
        return len(strings), len(strings.dtype.names or ())
    if writer is None:
        from xbus.log.resample import Resampled
        from xbus.log.trackers import Tracker

        content = table if isinstance(table, Resampled | Tracker) else log
        with writing(out):
            content.to_npz(out)
        return len(content), len(content.keys())
    from pyarrow import RecordBatchReader

    from xbus.log import export

    reader = RecordBatchReader.from_stream(table)
    columns = len(reader.schema)
    with writing(out):
        getattr(export, writer)(reader, out)
    rows = len(table.satellites) if key == "gnss_sat_info" else len(table)
    return rows, columns


def _table(log: Log, key: EntryKey | None, names: str, *, is_npz: bool) -> Any:
    """Returns what to write: the log, the column of a quantity, or the table of a string type."""
    if key is None:
        if not len(log) and not is_npz and log.strings.counts:
            found = ", ".join(name or "others" for name in log.strings.counts)
            raise Failure(
                f"{names} has no samples, only strings: {found}; choose a type with --quantity"
            )
        return log
    name = key if isinstance(key, str) else key[0]
    if _is_string(key):
        if name not in log.strings.counts:
            raise Failure(f"no {name} in {names}; xbus info lists the content")
        return None if is_npz else log.strings.to_arrow(name)
    systems = [found for found in log if isinstance(found, tuple) and found[0] == name]
    if systems and isinstance(key, str):
        choices = " or ".join(map(":".join, systems))
        raise Failure(f"{names} has {name} in several coordinates; choose --quantity {choices}")
    if key not in log:
        text = key if isinstance(key, str) else ":".join(key)
        raise Failure(f"no {text} in {names}; xbus info lists the content")
    return log[key]


def _is_string(key: EntryKey) -> bool:
    from xbus.protocol.values import StringType

    return key in StringType.__members__


def _summary_dict(
    files: Sequence[str], out: str, key: EntryKey | None, log: Log, rows: int, columns: int
) -> dict[str, Any]:
    """Returns the summary for JSON."""
    stats = log.stats
    return {
        "files": list(files),
        "out": out,
        "quantity": key if key is None or isinstance(key, str) else ":".join(key),
        "rows": rows,
        "columns": columns,
        "duration_s": log.duration if math.isfinite(log.duration) else None,
        "bytes": stats.bytes,
        "frames": stats.frames,
        "samples": stats.samples,
        "strings": stats.strings,
        "lost_samples": stats.lost_samples,
        "gaps": stats.gaps,
        "skipped_bytes": stats.skipped_bytes,
        "damage": len(log.damage),
        "malformed": stats.malformed,
        "undecoded": [item.to_dict() for item in log.undecoded],
    }
