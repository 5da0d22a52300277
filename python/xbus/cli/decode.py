"""``xbus decode``: writes logs as tables."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from xbus.cli import batch
from xbus.cli.can_options import CanOptions, can_options
from xbus.cli.dataset_options import Dataset, check_folder, dataset_options, is_folder
from xbus.cli.decoding import FORMATS, SUFFIXES, Decoding, is_string
from xbus.cli.export_formats import EXPORTS, FormatOptions, format_options, suffix_of
from xbus.cli.export_target import check_output
from xbus.cli.input_options import InputOptions, input_options
from xbus.cli.inputs import label, reading_task
from xbus.cli.memory import memory_option, workers_within
from xbus.cli.moments import moment
from xbus.cli.number_type import NumberRange
from xbus.cli.printing import print_json, suggestion
from xbus.cli.progress import Progress
from xbus.cli.resampling import check_resampling

if TYPE_CHECKING:
    from xbus.log.moments import Between
    from xbus.protocol.keys import EntryKey

__all__ = ["decode"]


def _out(
    ctx: click.Context,
    param: click.Parameter,  # noqa: ARG001 - click's signature
    value: str | None,
) -> str | None:
    """Returns a path with a known suffix, or that of a folder."""
    if value is not None and ctx.params.get("rosbag2"):
        return value.rstrip("/" + os.sep) or value
    if value is None or is_folder(value) or suffix_of(value) in SUFFIXES:
        return value
    if os.path.isdir(value) and not os.path.samefile(value, os.curdir):  # noqa: PTH112, PTH121 - pathlib is slow to import
        raise click.BadParameter(
            f"{value!r} is a folder; {os.path.join(value, '')!r} writes a table to several files in it"  # noqa: PTH118
        )
    raise click.BadParameter(f"{value!r} must end in one of {', '.join(SUFFIXES)}, or in /")


def _keys(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    values: tuple[str, ...],
) -> list[EntryKey]:
    """Returns the keys of quantities, or the name of a string type, each once."""
    keys = list(dict.fromkeys(map(_key, values)))
    if len(keys) > 1:
        for key in keys:
            if is_string(key) or key == "gnss_sat_info":
                raise click.BadParameter(f"{key} is a table by itself; decode it in a separate run")
    return keys


def _key(value: str) -> EntryKey:
    """Returns the key of a quantity (name, or name and coordinates), or the name of a string type."""
    from xbus.protocol.ids import Coordinates
    from xbus.protocol.tables import COLUMN_QUANTITIES
    from xbus.protocol.values import StringType

    name, colon, coordinates = value.partition(":")
    if value in StringType.__members__:
        return value
    if name not in COLUMN_QUANTITIES:
        raise click.BadParameter(
            f"no quantity is called {name!r}; {suggestion(name, COLUMN_QUANTITIES, 'quantities')}"
        )
    if not colon:
        return name
    systems = Coordinates.__members__ if COLUMN_QUANTITIES[name].coordinates else {}
    if not systems:
        raise click.BadParameter(f"{name} has no coordinates; remove {colon + coordinates!r}")
    if coordinates.upper() not in systems:
        raise click.BadParameter(
            f"{name} has coordinates {', '.join(systems)}, not {coordinates!r}"
        )
    return name, coordinates.upper()


def _between(
    ctx: click.Context, param: click.Parameter, values: tuple[str, str] | None
) -> Between | None:
    """Returns two moments; None for the start and the end."""
    from xbus.log.moments import check_order

    if values is None:
        return None
    start = None if values[0] == "start" else moment(ctx, param, values[0])
    end = None if values[1] == "end" else moment(ctx, param, values[1])
    try:
        check_order((start, end))
    except ValueError as error:
        raise click.BadParameter(str(error)) from error
    return start, end


@click.command(epilog="Example: xbus decode walk.mtb -o walk.parquet")
@input_options()
@can_options
@click.option(
    "-o",
    "out",
    callback=_out,
    metavar="OUT",
    help="File to write. Its suffix determines the format: a table (.parquet, .csv, .arrow, .feather), .npz, "
    ".mat, .h5, .xlsx, .gpx, .kml, .geojson, .mcap, .rrd (rerun), .sto (OpenSim), .txt (MT Manager) or "
    ".nmea. If OUT ends in /, a folder of tables.",
)
@dataset_options
@batch.batch_options
@click.option(
    "--suffix",
    type=click.Choice(SUFFIXES),
    default=SUFFIXES[0],
    show_default=True,
    metavar="SUFFIX",
    help="Suffix of the files in --out-dir or a folder, which determines their format.",
)
@click.option(
    "--quantity",
    "keys",
    callback=_keys,
    multiple=True,
    metavar="NAME",
    help="Write only this quantity: acceleration or quaternion:NED; repeatable. A single one has one row per "
    "packet, without nulls. Or the strings of a type: HEHDT.",
)
@click.option(
    "--between",
    nargs=2,
    callback=_between,
    metavar="FROM TO",
    help="Write only the samples at or after FROM and before TO: seconds since the first sample, UTC "
    "(2026-11-22T09:30:00), start or end.",
)
@click.option(
    "--rate-out",
    type=NumberRange(min=0, min_open=True),
    metavar="HZ",
    help="Resample to one row every 1/HZ seconds: interpolated; null across gaps.",
)
@click.option(
    "--max-gap",
    type=NumberRange(min=0),
    metavar="SECONDS",
    help="With --rate-out, the longest gap to interpolate across.  [default: 2.5 steps of each quantity]",
)
@click.option(
    "--tracker",
    metavar="ID",
    help="Write only this Awinda tracker: packet counter and magnetic field. xbus info lists them.",
)
@click.option(
    "--raw",
    is_flag=True,
    help="Write fields of structs, such as gnss_pvt_data_lat, as integers, as on the wire.",
)
@format_options
@memory_option
@click.option("--strict", is_flag=True, help="Fail at the first damage.")
@click.option("-q", "--quiet", is_flag=True, help="Show no progress and no summary on stderr.")
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print the summary on stdout: a JSON object, or a list of them with --out-dir.",
)
def decode(
    inputs: InputOptions,
    can: CanOptions,
    out: str | None,
    out_dir: str | None,
    skip_existing: bool,
    jobs: int | None,
    suffix: str,
    partition_by: str | None,
    partition_size: int,
    keys: list[EntryKey],
    between: Between | None,
    rate_out: float | None,
    max_gap: float | None,
    tracker: str | None,
    raw: bool,
    options: FormatOptions,
    memory: int,
    strict: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Writes logs as tables, or in the formats of other software.

    IN is a file, a folder, a pattern ("*.mtb"), a URL, or - for standard input. Compressed input (gzip,
    xz, bzip2, Zstandard) is decompressed. The pieces of one recording (walk.mtb, walk-0001.mtb, ...) are
    joined in their order. Different recordings are never joined: --out-dir writes one file for each.

    The table has one row per sample. The columns are sample, time in seconds on the device clock, and the
    quantities (acceleration_x, ...) in the units that xbus quantities lists. Missing values are null.
    Satellites (--quantity gnss_sat_info) and the strings of each type are separate tables.

    An OUT that ends in / is a folder with files of one table, which polars, DuckDB, Arrow and dask read
    together: part-0000.parquet, ..., each of about --partition-size. With --out-dir and --partition-by or
    --partition-size, each recording becomes such a folder.

    IN can also be a CAN capture of an MTi-600: .asc, .blf, .trc, .mf4, .log of candump, or .csv of
    python-can. A sample is then a group of frames.

    Tables are written part by part: a log may be larger than memory. Standard input, URLs, compressed files,
    CAN captures and what is --between two moments are first copied to a temporary file (TMPDIR).

    An .npz file contains an array NAME for each quantity, with NAME.sample and NAME.time; fields of structs
    are in their units. An existing OUT is replaced, and a failed run leaves no partial file. A folder is
    replaced only if xbus wrote its files.
    """
    from xbus.log.memory import keep_freed_memory

    batch.check_targets(out, out_dir)
    check_resampling(keys, rate_out, max_gap)
    if tracker and (keys or rate_out):
        raise click.UsageError("--tracker excludes --quantity and --rate-out")
    if raw and (rate_out or tracker):
        raise click.UsageError("--raw excludes --rate-out and --tracker")
    if options.writes_folder and _is_default("suffix"):
        suffix = options.suffix("")
    dataset = _dataset(out, Dataset(suffix, partition_size, partition_by is not None))
    target = suffix if out is None or dataset else options.suffix(out)
    options.check(target)
    if dataset is not None:
        if target not in FORMATS:
            raise click.UsageError(f"a folder has tables: {', '.join(FORMATS)}, not {target}")
        if rate_out or tracker or any(map(is_string, keys)):
            raise click.UsageError(
                "--rate-out, --tracker and strings are written to one file, not to a folder"
            )
    if target in EXPORTS:
        for name, value in {"--raw": raw, "--rate-out": rate_out, "--tracker": tracker}.items():
            if value:
                raise click.UsageError(f"{name} applies to tables and .npz, not to {target}")
        if any(map(is_string, keys)):
            raise click.UsageError(f"strings are written to tables and .npz, not to {target}")
    if tracker and inputs.rate is not None:
        click.echo("xbus: --rate has no effect: the table of a tracker has no times", err=True)
        inputs = replace(inputs, rate=None)
    keep_freed_memory()  # for the encoder; tables of CAN captures and whole logs are not read in parts
    recordings = inputs.recordings() if out_dir is not None else [inputs.recording()]
    workers = workers_within(memory, len(recordings), jobs)
    decoding = Decoding(
        inputs,
        keys,
        can=can,
        strict=strict,
        rate=rate_out,
        max_gap=max_gap,
        tracker=tracker,
        raw=raw,
        options=options,
        dataset=dataset,
        between=between,
        threads=workers.threads,
    )
    if out_dir is not None:
        outcomes = batch.run(
            batch.plan(recordings, out_dir, _end(suffix, options, dataset)),
            decoding.decode,
            workers=workers.jobs,
            skip_existing=skip_existing,
            quiet=quiet,
        )
        batch.finish(outcomes, quiet=quiet, as_json=as_json)
        return
    assert out is not None  # noqa: S101 - see `check_targets`
    [recording] = recordings
    if dataset is not None:
        check_folder(out)
    else:
        check_output(recording.files, out, is_folder=options.writes_folder)
    recording.show_notes()
    with Progress(reading_task(recording.files[0]), shown=not quiet) as progress:
        text, summary = decoding.decode(batch.Job(recording, out), progress)
    recording.show_notes()
    if as_json:
        print_json({"files": recording.files, "out": out} | summary)
    if not quiet:
        click.echo(f"{label(out)}: {text}", err=True)


def _end(suffix: str, options: FormatOptions, dataset: Dataset | None) -> str:
    """Returns what the names of the outputs in --out-dir end with."""
    if dataset is not None:
        return os.sep
    return "" if options.writes_folder else suffix


def _is_default(name: str) -> bool:
    """Returns whether an option is not on the command line."""
    source = click.get_current_context().get_parameter_source(name)
    return source != ParameterSource.COMMANDLINE


def _dataset(out: str | None, options: Dataset) -> Dataset | None:
    """Returns how to write a folder for each recording; None if each is written to a file."""
    given = [
        "--" + name.replace("_", "-")
        for name in ("partition_by", "partition_size")
        if not _is_default(name)
    ]
    if out is None:
        return options if given else None
    if is_folder(out):
        return options
    if given:
        raise click.UsageError(f"{given[0]} needs a folder, such as -o {suffix_of(out)[1:]}/")
    return None
