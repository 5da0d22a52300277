"""``xbus decode``: a log as a table in a file."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from xbus.cli.export_target import check, summary, writing
from xbus.cli.failure import Failure
from xbus.cli.inputs import Input, label, no_frame, strings_option, task
from xbus.cli.printing import hint, print_json
from xbus.cli.progress import Progress
from xbus.describe.formatting import format_count

if TYPE_CHECKING:
    from xbus.log.log import Log
    from xbus.protocol.keys import EntryKey

__all__ = ["decode"]

#: What writes a table as each kind of file, in `xbus.log.export`; an npz is no table.
WRITERS = {
    ".parquet": "parquet",
    ".csv": "csv",
    ".arrow": "feather",
    ".feather": "feather",
    ".npz": None,
}


def _out(ctx: click.Context, param: click.Parameter, value: str) -> str:  # noqa: ARG001 - click's
    """A path whose suffix says what to write."""
    if _suffix(value) not in WRITERS:
        raise click.BadParameter(f"{value!r} must end in one of {', '.join(WRITERS)}")
    return value


def _key(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    value: str | None,
) -> EntryKey | None:
    """A quantity by name, or by name and coordinates, as a log takes it; or a string output by name."""
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
            f"no quantity is called {name!r}; {hint(name, QUANTITIES, 'quantities')}"
        )
    if not colon:
        return name
    systems = Coordinates.__members__ if QUANTITIES[name].coordinates else {}
    if not systems:
        raise click.BadParameter(f"{name} has no coordinates; leave out {colon + coordinates!r}")
    if coordinates.upper() not in systems:
        raise click.BadParameter(f"{name} comes in {', '.join(systems)}, not {coordinates!r}")
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
    help="What to write: .parquet, .csv, .arrow, .feather or .npz.",
)
@click.option(
    "--quantity",
    "key",
    callback=_key,
    metavar="NAME",
    help="Only this quantity, a row a packet, without nulls: acceleration, or quaternion:NED; or the"
    " strings of a type: HEHDT.",
)
@strings_option
@click.option("--strict", is_flag=True, help="Fail at the first damage instead of skipping it.")
@click.option("-q", "--quiet", is_flag=True, help="No progress and no summary on stderr.")
@click.option("--json", "as_json", is_flag=True, help="The summary as a JSON object on stdout.")
def decode(
    files: tuple[str, ...],
    out: str,
    key: EntryKey | None,
    strings: tuple[str, ...],
    strict: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Writes a log as one table: Parquet, CSV, Arrow or npz.

    Several FILEs are one recording that was split, joined in the given order; - is standard input.

    The table has a row for each sample and the columns sample, time in seconds on the device clock,
    and acceleration_x and so on, in the units that xbus quantities lists. What a sample lacks is null.
    Satellites are a table of their own: --quantity gnss_sat_info; so are the strings of each type.

    An .npz holds an array for each quantity instead, with NAME.sample and NAME.time beside it; with
    --quantity only that one. OUT replaces what is there, and appears whole or not at all.
    """
    check(files, out)
    if _suffix(out) != ".npz":
        from xbus.extras import require

        require("pyarrow", "arrow", f"to write {_suffix(out)} files")
    with Progress(task(files[0]), shown=not quiet) as progress:
        log = _read(files, key, strings=strings, strict=strict, progress=progress)
        table = _table(log, key, ", ".join(map(label, files)), is_npz=_suffix(out) == ".npz")
        progress.update(f"writing {label(os.path.basename(out))}")  # noqa: PTH119
        rows, columns = _write(log, table, key, out)
    if as_json:
        print_json(_facts(files, out, key, log, rows, columns))
    if not quiet:
        shape = f"{format_count(rows, 'row')}, {format_count(columns, 'column')}"
        click.echo(f"{label(out)}: {shape}; {summary(log)}", err=True)


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
            what, _, _ = str(error).partition(";")
            joined = f", which is {source.place(error.offset)}" if len(files) > 1 else ""
            names = ", ".join(map(label, files))
            raise Failure(f"{names}: {what}{joined}; leave out --strict to read on") from error
    if not len(log) and not len(log.messages) and not log.stats.strings:
        raise no_frame(files, log.stats.bytes)
    return log


def _write(log: Log, table: Any, key: EntryKey | None, out: str) -> tuple[int, int]:
    """Writes OUT; its rows and columns, of an npz samples and quantities."""
    writer = WRITERS[_suffix(out)]
    if writer is None and isinstance(key, str) and _is_string(key):
        from xbus.log import export

        strings = log.strings.table(key)
        with writing(out):
            export.npz({key: strings}, out)
        return len(strings), len(strings.dtype.names or ())
    if writer is None:
        with writing(out):
            log.to_npz(out)
        return len(log), len(log.keys())
    from pyarrow import RecordBatchReader

    from xbus.log import export

    reader = RecordBatchReader.from_stream(table)
    columns = len(reader.schema)
    with writing(out):
        getattr(export, writer)(reader, out)
    rows = len(table.satellites) if key == "gnss_sat_info" else len(table)
    return rows, columns


def _table(log: Log, key: EntryKey | None, names: str, *, is_npz: bool) -> Any:
    """What is written: the log, the column of a quantity, or the table of a type of string."""
    if key is None:
        if not len(log) and not is_npz and log.strings.counts:
            found = ", ".join(it or "others" for it in log.strings.counts)
            raise Failure(f"{names} holds no sample but strings: {found}; name one with --quantity")
        return log
    name = key if isinstance(key, str) else key[0]
    if _is_string(key):
        if name not in log.strings.counts:
            raise Failure(f"no {name} in {names}; xbus info lists what is there")
        return None if is_npz else log.strings.to_arrow(name)
    systems = [it for it in log if isinstance(it, tuple) and it[0] == name]
    if systems and isinstance(key, str):
        choices = " or ".join(map(":".join, systems))
        raise Failure(f"{names} has {name} in several coordinates; ask for --quantity {choices}")
    if key not in log:
        asked = key if isinstance(key, str) else ":".join(key)
        raise Failure(f"no {asked} in {names}; xbus info lists what is there")
    return log[key]


def _is_string(key: EntryKey) -> bool:
    from xbus.protocol.values import StringType

    return key in StringType.__members__


def _facts(
    files: Sequence[str], out: str, key: EntryKey | None, log: Log, rows: int, columns: int
) -> dict[str, Any]:
    """The summary for programs."""
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
    }
