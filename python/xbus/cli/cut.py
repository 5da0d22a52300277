"""``xbus cut`` and ``xbus split``: parts of a recording, byte for byte."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import click

from xbus.cli.decoding import SUFFIXES
from xbus.cli.export_formats import suffix_of
from xbus.cli.export_target import check_output, writing
from xbus.cli.failure import Failure
from xbus.cli.input_options import InputOptions, input_options
from xbus.cli.inputs import STDIN, label, reading_task
from xbus.cli.moments import Content, arrivals_of, bounds_of, moment, time_errors
from xbus.cli.progress import Progress
from xbus.cli.recordings import Recording
from xbus.cli.rotation import rotation_limits
from xbus.files import local_name, suffix_of_compression, uncompressed_name
from xbus.formatting import format_count, format_size

if TYPE_CHECKING:
    from xbus.log.arrivals import Arrivals
    from xbus.log.cutting import Chunk
    from xbus.log.log import Log
    from xbus.log.moments import Moment
    from xbus.log.source import Readable

__all__ = ["cut", "split"]

ONE_BY_ONE = "cut each by itself"


def _out(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    value: str,
) -> str:
    """Returns a path whose suffix does not promise another format than that of recordings."""
    if suffix := suffix_of_compression(value):
        raise click.BadParameter(
            f"the file is not compressed; omit {suffix}, and compress it later"
        )
    suffix = suffix_of(value)
    if suffix in (*SUFFIXES, ".html", ".htm"):
        command = "xbus decode" if suffix in SUFFIXES else "xbus report"
        raise click.BadParameter(
            f"the part is a recording, such as part.mtb, and no {suffix} file; {command} part.mtb -o {value} "
            "then writes that"
        )
    return value


@click.command(epilog="Example: xbus cut walk.mtb --from 60 --to 120 -o part.mtb")
@input_options()
@click.option(
    "--from",
    "start",
    callback=moment,
    metavar="TIME",
    help="First moment: seconds since the first sample, or UTC (2026-11-22T09:30:00). Default: the start.",
)
@click.option(
    "--to",
    "end",
    callback=moment,
    metavar="TIME",
    help="Moment to end before. Default: the end.",
)
@click.option("-o", "out", callback=_out, metavar="OUT", required=True, help="File to write.")
@click.option("-q", "--quiet", is_flag=True, help="Show no progress and no summary on stderr.")
def cut(
    inputs: InputOptions,
    start: Moment | None,
    end: Moment | None,
    out: str,
    quiet: bool,
) -> None:
    """Cuts a part out of a recording.

    OUT has whole frames, byte for byte, with the Configuration of the device at the start. It begins with the
    first sample at or after --from, and ends before the first sample at or after --to. With --bid, OUT has
    only the frames of this device, and times are those of this device. If the arrivals are known, OUT.times
    has those of OUT.

    IN is a file, a folder, a pattern ("*.mtb"), a URL, or - for standard input; the pieces of one recording
    are joined. The recording is read in parts and need not fit into memory.
    """
    from xbus.cli.piece_file import piece_file
    from xbus.log.cutting import cut as cut_bytes

    if start is None and end is None:
        raise click.UsageError("a part needs --from, --to, or both")
    recording = inputs.recording(remedy=ONE_BY_ONE)
    files = recording.files
    check_output(files, out)
    recording.show_notes()
    content = Content(inputs)
    with Progress(reading_task(files[0]), shown=not quiet) as progress, time_errors(recording):
        bounds = bounds_of((start, end), content, inputs, recording, progress)
        with (
            inputs.opened(files, progress) as source,
            inputs.checked_rate(recording) as use,
            content.checked(source, files),
        ):
            arrivals = arrivals_of(source)
            chunks = cut_bytes(
                source,
                lambda tee: use.watch(content.parts(tee)),
                *bounds,
                bid=inputs.bid,
                arrivals=arrivals,
            )
            with piece_file(out, arrivals) as piece:
                for chunk in chunks:
                    piece.write(chunk)
                if not piece.size:
                    content.check()
                    raise Failure(f"{recording.heading} has no samples between these times")
    recording.show_notes()
    if not quiet:
        click.echo(f"{label(out)}: {format_size(piece.size)}", err=True)


@click.command(epilog="Example: xbus split night.mtb --time 1h --out-dir hours")
@input_options()
@click.option("--size", metavar="SIZE", help="Start a new file at this size: 100MB, 2GB.")
@click.option("--time", metavar="TIME", help="Start a new file after this time: 90s, 30min, 1h.")
@click.option("--device", "by_device", is_flag=True, help="Write a file for each device on a bus.")
@click.option(
    "--out-dir",
    metavar="DIR",
    required=True,
    help="Folder to write to. It is created if necessary.",
)
@click.option("-q", "--quiet", is_flag=True, help="Show no progress and no summary on stderr.")
def split(
    inputs: InputOptions,
    size: str | None,
    time: str | None,
    by_device: bool,
    out_dir: str,
    quiet: bool,
) -> None:
    """Splits a recording by size, time or device.

    The files have whole frames, byte for byte. By size and time they are walk.mtb, walk-0001.mtb, ..., each
    with the Configuration of the device at the start, and other commands join them again. By device they are
    walk-bid1.mtb, ..., each with what identifies the device, and leave out strings and damage, which name no
    device. If the arrivals are known, each file has a side file with its own (walk-0001.mtb.times).

    IN is a file, a folder, a pattern ("*.mtb"), a URL, or - for standard input; the pieces of one recording
    are joined. The recording is read in parts and need not fit into memory.
    """
    from xbus.log import cutting

    if sum((size is not None, time is not None, by_device)) != 1:
        raise click.UsageError("choose one of --size, --time and --device")
    if by_device and inputs.bid is not None:
        raise click.UsageError(
            "--device writes a file for each device; xbus cut --bid --from 0 writes that of one"
        )
    limit = _limit(size, time)
    recording = inputs.recording(remedy="split each by itself")
    files = recording.files
    recording.show_notes()
    with writing(out_dir):
        os.makedirs(out_dir, exist_ok=True)  # noqa: PTH103 - pathlib is slow to import

    content = Content(inputs)

    def parts(source: Readable) -> Iterator[Log]:
        return use.watch(content.parts(source))

    with Progress(reading_task(files[0]), shown=not quiet) as progress, time_errors(recording):
        if by_device:
            if STDIN in files:
                raise Failure(
                    "--device reads a recording twice, and standard input can be read once; save it to a file"
                )
            with inputs.opened(files, progress) as source:
                heads = cutting.device_heads(content.parts(source))
        with (
            inputs.opened(files, progress) as source,
            inputs.checked_rate(recording) as use,
            content.checked(source, files),
        ):
            arrivals = arrivals_of(source)
            if by_device:
                chunks = cutting.split_by_device(source, parts, heads)
            elif "rotate_bytes" in limit:
                chunks = cutting.split_by_size(source, parts, limit["rotate_bytes"], bid=inputs.bid)
            else:
                chunks = cutting.split_by_time(
                    source, parts, limit["rotate_seconds"], bid=inputs.bid
                )
            written = _write(chunks, recording, out_dir, arrivals, content, by_device=by_device)
    recording.show_notes()
    if not quiet:
        last = f" to {label(written[-1])}" if len(written) > 1 else ""
        click.echo(f"{label(written[0])}{last}: {format_count(len(written), 'file')}", err=True)


def _limit(size: str | None, time: str | None) -> dict[str, Any]:
    """Returns the size or time of a piece."""
    for name, value, key in (("--size", size, "rotate_bytes"), ("--time", time, "rotate_seconds")):
        if value is not None:
            limit = rotation_limits(value)
            if key not in limit:
                raise click.UsageError(f"{name}: {value!r} has the unit of the other option")
            return limit
    return {}


def _write(
    chunks: Iterator[Chunk],
    recording: Recording,
    folder: str,
    arrivals: Arrivals | None,
    content: Content,
    *,
    by_device: bool,
) -> list[str]:
    """Writes each piece to a file, and returns the names.

    Raises:
        ValueError: Nothing was found in the recording.
    """
    from xbus.cli.piece_file import PieceFile, piece_file
    from xbus.log.pieces import name_of_piece

    path = _out_path(recording, folder)
    _check_folder(recording.files, path, by_device=by_device)
    outs: list[str] = []
    opened: dict[int, PieceFile] = {}
    with _complete(outs), contextlib.ExitStack() as files:
        for chunk in chunks:
            piece = chunk.piece
            if piece not in opened:
                if opened and not by_device:
                    content.check()
                    files.close()  # the previous piece is complete
                    opened.clear()
                out = _path_of_device(path, piece) if by_device else name_of_piece(path, len(outs))
                check_output(recording.files, out)
                outs.append(out)
                opened[piece] = files.enter_context(piece_file(out, arrivals))
            opened[piece].write(chunk)
        content.check()
    return outs


@contextlib.contextmanager
def _complete(outs: Sequence[str]) -> Iterator[None]:
    """Removes the files, none of which existed before, after an error."""
    from xbus.log.arrivals import side_files

    try:
        yield
    except BaseException:
        for out in outs:
            for name in (out, *side_files(out)):
                with contextlib.suppress(OSError):
                    os.remove(name)  # noqa: PTH107 - pathlib is slow to import
        raise


def _out_path(recording: Recording, folder: str) -> str:
    """Returns the path of the first piece, which has the name of the recording."""
    name = os.path.basename(local_name(recording.files[0]))  # noqa: PTH119
    name = "standard-input.mtb" if name == STDIN else name
    return os.path.join(folder, uncompressed_name(name))  # noqa: PTH118


def _path_of_device(path: str, bid: int) -> str:
    stem, suffix = os.path.splitext(path)  # noqa: PTH122
    return f"{stem}-bid{bid}{suffix}"


def _check_folder(files: Sequence[str], path: str, *, by_device: bool) -> None:
    """Raises Failure if the folder has pieces already that readers would add to those of this run."""
    from xbus.log.pieces import piece_name

    folder = os.path.dirname(path)  # noqa: PTH120
    inputs = {os.path.abspath(local_name(name)) for name in files}  # noqa: PTH100
    found = []
    for name in sorted(os.listdir(folder or ".")):  # noqa: PTH208
        other = os.path.join(folder, name)  # noqa: PTH118
        of_device = re.sub(r"-bid[0-9]+(?=(\.[^.]*)?$)", "", other)
        is_piece = of_device == path != other if by_device else piece_name(other).recording == path
        if is_piece and os.path.abspath(other) not in inputs:  # noqa: PTH100
            found.append(other)
    if found:
        raise Failure(
            f"there are files of an earlier run, such as {label(found[-1])}; delete them, or choose another "
            "--out-dir"
        )
