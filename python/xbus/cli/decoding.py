"""Decodes one recording to a file: the work of ``xbus decode``."""

from __future__ import annotations

import contextlib
import functools
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from xbus.cli.argument_options import with_argument_options
from xbus.cli.batch import Job
from xbus.cli.between import CutRecording
from xbus.cli.can_options import CanOptions
from xbus.cli.dataset_options import Dataset, check_folder, foreign_files
from xbus.cli.export_formats import EXPORTS, FormatOptions, suffix_of
from xbus.cli.export_target import check_output, quality_text, restart_count, writing
from xbus.cli.failure import Failure, cannot
from xbus.cli.input_options import InputOptions
from xbus.cli.inputs import Input, label, no_frame, reading_task
from xbus.cli.progress import ShowsProgress
from xbus.cli.resampling import resampled
from xbus.cli.stored import Stored, stored
from xbus.cli.undecoded import check_decoded, tracker_of, undecoded_lines
from xbus.formatting import format_count

if TYPE_CHECKING:
    from xbus.cli.decoded_totals import DecodedTotals
    from xbus.cli.input_options import LogOptions
    from xbus.cli.rate_use import RateUse
    from xbus.describe.log_summary import LogSummary
    from xbus.export.format import Format
    from xbus.log.log import Log
    from xbus.log.moments import Between
    from xbus.log.parts import LogPart, Part
    from xbus.log.table_file import FileFormat
    from xbus.log.trackers import Tracker
    from xbus.protocol.keys import EntryKey

__all__ = ["FORMATS", "SUFFIXES", "Decoding", "is_string"]

#: The formats of tables, by suffix. An npz file is not a table.
FORMATS: dict[str, FileFormat] = {
    ".parquet": "parquet",
    ".csv": "csv",
    ".arrow": "arrow",
    ".feather": "arrow",
}
#: The suffixes of output files, the default first.
SUFFIXES = (*FORMATS, ".npz", *EXPORTS)
#: Bytes of input that a thread decodes at a time.
PART = 4 << 20


def is_string(key: EntryKey) -> bool:
    """Returns whether this is the name of a string type, and not the key of a quantity."""
    from xbus.protocol.values import StringType

    return key in StringType.__members__


@contextlib.contextmanager
def reading(names: str) -> Iterator[None]:
    """Converts the errors of an input that changes, cannot be read or is no recording to a Failure."""
    from xbus.log.log import MissingDeviceError
    from xbus.log.parts import LogChangedError
    from xbus.log.pieces import PiecesError

    try:
        yield
    except PiecesError as error:
        raise Failure(str(error)) from error
    except MissingDeviceError as error:
        raise Failure(f"{names}: {error}") from error
    except LogChangedError as error:
        remedy = (
            "decode copies"
            if ", " in names
            else f"decode what it has now with xbus decode - < {names}"
        )
        raise Failure(
            f"{names} changed while it was decoded; wait until it is complete, or {remedy}"
        ) from error
    except OSError as error:
        name = label(error.filename) if error.filename else names
        raise cannot(f"read {name}", error) from error


def _without_samples(names: str, strings: Iterable[str]) -> Failure:
    if found := ", ".join(strings):
        return Failure(
            f"{names} has no samples, only strings: {found}; write them to .nmea, or those of one type to "
            "a table with --quantity"
        )
    return Failure(f"{names} has no samples; xbus info lists the content")


def _written(counts: Mapping[str, int]) -> str:
    return ", ".join(format_count(count, name) for name, count in counts.items())


class Decoding:
    """Decodes recordings with the same options.

    Args:
        inputs: How to read them.
        keys: The quantities, or one string type; none for all quantities.
        can: How to read CAN captures.
        strict: Fail at the first damage.
        rate: Rows per second to resample to, or None.
        max_gap: As for `Log.resample`.
        tracker: The Awinda tracker to write, or None.
        raw: Write fields of structs as integers, as on the wire.
        options: Options of the format.
        dataset: How to write a folder of files, or None for one file.
        between: Decode only the samples between two moments; None for all.
        threads: Number of threads.
    """

    def __init__(
        self,
        inputs: InputOptions,
        keys: Sequence[EntryKey],
        *,
        can: CanOptions,
        strict: bool,
        rate: float | None,
        max_gap: float | None,
        tracker: str | None,
        raw: bool,
        options: FormatOptions,
        dataset: Dataset | None,
        between: Between | None,
        threads: int,
    ) -> None:
        self._between = between
        self._options = options
        self._dataset = dataset
        self._threads, self._can = threads, can
        self._inputs, self._keys, self._strict, self._raw = inputs, list(keys), strict, raw
        self._rate, self._max_gap, self._tracker = rate, max_gap, tracker

    @property
    def _key(self) -> EntryKey | None:
        """The key if there is only one, whose table has a row per packet."""
        return self._keys[0] if len(self._keys) == 1 else None

    def decode(self, job: Job, progress: ShowsProgress) -> tuple[str, dict[str, Any]]:
        """Decodes a recording to a file.

        Returns:
            What was written as text, and as values for JSON.
        """
        files, out = job.recording.files, job.out
        assert out is not None  # noqa: S101 - jobs of this command write files
        if self._dataset is None:
            check_output(files, out, is_folder=self._options.writes_folder)
        else:
            check_folder(out)
        if self._can.check(self._inputs, files):
            return self._decode_capture(job, progress)
        with (
            self._inputs.opened(files, progress) as source,
            self._inputs.checked_rate(job.recording) as use,
        ):
            cut = None
            if self._between is not None:
                cut = CutRecording(self._between, self._inputs, job.recording, source, progress)
            if self._needs_whole_log(out):
                return self._decode_whole(source, cut, job, use, progress)
            with stored(source, files) if cut is None else cut.stored() as recording:
                return self._decode_stored(source, recording, job, use, progress)

    def _needs_whole_log(self, out: str) -> bool:
        """Returns whether the log cannot be decoded part by part."""
        suffix = self._options.suffix(out)
        if suffix in EXPORTS or self._dataset is not None:
            return False
        is_table = suffix in FORMATS and self._rate is None and self._tracker is None
        return not is_table or any(is_string(key) for key in self._keys)

    @property
    def _for_log(self) -> LogOptions:
        """The options for what is decoded. A cut has the wanted device only."""
        options = self._inputs.for_log
        return options if self._between is None else {**options, "bid": None}

    # Part by part

    def _decode_stored(
        self,
        source: Input,
        recording: Stored,
        job: Job,
        use: RateUse,
        progress: ShowsProgress,
    ) -> tuple[str, dict[str, Any]]:
        from xbus.cli.decoded_totals import DecodedTotals

        files, out = job.recording.files, job.out
        assert out is not None  # noqa: S101 - see `decode`
        names, size = ", ".join(map(label, files)), recording.size
        task = reading_task(files[0])
        if self._strict:
            self._check_damage(source, recording, files)
        with reading(names):
            parts = self._parts(recording, lambda done: progress.update(task, done, size))
        empty = parts[0].empty(quantities=self._quantities)
        file_format = self._format_of(out)
        is_empty = not any(part.samples for part in parts) or not (self._keys or len(empty.keys()))
        if is_empty:
            summary = self._summary_of_empty(source, recording, files)
            if file_format is None or file_format.needs_samples:
                self._check_keys(empty, names)
                raise _without_samples(names, summary.strings)
        self._check_keys(empty, names)
        totals = DecodedTotals(recording.times_fault)
        task = f"writing {label(os.path.basename(os.path.normpath(out)))}"  # noqa: PTH119

        def add(part: LogPart, log: Log) -> None:
            totals.add(log)
            use.add(log)
            progress.update(task, part.end, size)

        progress.update(task, 0, size)
        counts = self._write_parts(
            parts, out, file_format, names, read=add, reading=lambda: reading(names)
        )
        return self._result(totals, None, counts, quality_text(totals))

    def _write_parts(
        self, parts: Sequence[Part], out: str, file_format: Format | None, names: str, **how: Any
    ) -> dict[str, int]:
        """Writes parts, and returns `Writer.counts`; ``how`` is for `write_parts` and its siblings."""
        from xbus.export.format import ExportError
        from xbus.export.replacing import ForeignFilesError

        write = self._write_of(out, file_format)
        with writing(out):
            try:
                return write(parts, out, quantities=self._quantities, threads=self._threads, **how)
            except ExportError as error:
                raise Failure(f"{names}: {with_argument_options(str(error))}") from error
            except ForeignFilesError as error:
                raise foreign_files(out, error) from error

    def _format_of(self, out: str) -> Format | None:
        """Returns the format of OUT; None for tables."""
        return None if self._dataset else self._options.format_of(self._options.suffix(out))

    def _write_of(self, out: str, file_format: Format | None) -> Callable[..., dict[str, int]]:
        """Returns the function that writes parts."""
        from xbus.log.part_file import export_parts, write_parts

        if file_format is not None:
            return functools.partial(export_parts, file_format=file_format)
        how: dict[str, Any] = {"key": self._key, "raw": self._raw}
        if (dataset := self._dataset) is None:
            return functools.partial(write_parts, file_format=FORMATS[suffix_of(out)], **how)
        from xbus.log.dataset import write_dataset

        return functools.partial(
            write_dataset,
            file_format=FORMATS[dataset.suffix],
            suffix=dataset.suffix,
            size=dataset.size,
            by_hour=dataset.by_hour,
            **how,
        )

    def _summary_of_empty(
        self, source: Input, recording: Stored, files: Sequence[str]
    ) -> LogSummary:
        """Returns the content of a recording without samples, with memory for a part only.

        Raises:
            Failure: It has no frames, or nothing that is decoded.
        """
        from xbus.describe.log_summary import LogSummary
        from xbus.log.read import iter_log

        names = ", ".join(map(label, files))
        parts = iter_log(
            recording.source,
            block_bytes=PART,
            allow_restart=self._inputs.allow_restart,
            **self._for_log,
        )
        with reading(names):
            summary = LogSummary(parts)
        if not summary.stats.frames and not summary.stats.strings:
            raise no_frame(files, summary.stats.bytes, source.head)
        check_decoded(summary, names)
        return summary

    def _parts(self, recording: Stored, progress: Callable[[int], None]) -> list[LogPart]:
        """Returns parts whose tables are no larger than a chunk of the file, so that memory is bounded."""
        from xbus.log.part_file import chunk_rows

        def split(size: int) -> list[LogPart]:
            return recording.split(
                block_bytes=size,
                allow_restart=self._inputs.allow_restart,
                threads=self._threads,
                progress=progress,
                **self._for_log,
            )

        parts = split(PART)
        empty = parts[0].empty(quantities=self._quantities)
        if self._key is not None and self._key not in empty:
            return parts
        rows = chunk_rows(empty, self._key, raw=self._raw)
        most = max(part.samples for part in parts)
        return parts if most <= rows else split(max(PART * rows // most, 1))

    def _check_damage(self, source: Input, recording: Stored, files: Sequence[str]) -> None:
        """Raises the error of the first damage."""
        from xbus.log.read import iter_log

        with self._strictly(source, files):
            is_direct = source.total is not None and self._between is None
            whole = source if is_direct else recording.source
            for _ in iter_log(whole, strict=True, quantities=self._quantities, **self._for_log):
                pass

    # At once

    def _decode_whole(
        self,
        source: Input,
        cut: CutRecording | None,
        job: Job,
        use: RateUse,
        progress: ShowsProgress,
    ) -> tuple[str, dict[str, Any]]:
        files, out = job.recording.files, job.out
        assert out is not None  # noqa: S101 - see `decode`
        log = self._read(source, cut, files)
        use.add(log)
        names = ", ".join(map(label, files))
        if not self._keys or not len(log):
            # Else the samples may have other quantities than the chosen ones.
            check_decoded(log, names)
        table = self._table(log, names, is_npz=suffix_of(out) == ".npz")
        if self._rate is not None:
            table = resampled(log, self._keys, self._rate, self._max_gap, names)
        tracker = None
        if self._tracker is not None:
            table = tracker = tracker_of(log, self._tracker, names)
        # Before OUT appears, because a description of much damage can need more memory than there is.
        quality = quality_text(log, tracker)
        return self._result(log, tracker, self._write(log, table, out, progress), quality)

    def _decode_capture(self, job: Job, progress: ShowsProgress) -> tuple[str, dict[str, Any]]:
        files, out = job.recording.files, job.out
        assert out is not None  # noqa: S101 - see `decode`
        names = ", ".join(map(label, files))
        if any(map(is_string, self._keys)) or self._tracker is not None:
            raise Failure(
                f"{names} is a CAN capture, which has neither strings nor Awinda trackers"
            )
        if self._between is not None:
            raise Failure(f"{names} is a CAN capture, to which --between does not apply")
        if not self._needs_whole_log(out):
            return self._decode_capture_by_parts(job, progress, names)
        log, findings = self._can.read(self._inputs, files, progress, strict=self._strict)
        with self._inputs.checked_rate(job.recording) as use:
            use.add(log)
        self._check_keys(log, names)
        table = self._table(log, names, is_npz=suffix_of(out) == ".npz")
        if self._rate is not None:
            table = resampled(log, self._keys, self._rate, self._max_gap, names)
        counts = self._write(log, table, out, progress)
        return self._capture_result(log, counts, findings)

    def _decode_capture_by_parts(
        self, job: Job, progress: ShowsProgress, names: str
    ) -> tuple[str, dict[str, Any]]:
        from xbus.cli.decoded_totals import DecodedTotals

        files, out = job.recording.files, job.out
        assert out is not None  # noqa: S101 - see `decode`
        totals = DecodedTotals()
        with (
            self._can.stored(self._inputs, files, progress, strict=self._strict) as capture,
            self._inputs.checked_rate(job.recording) as use,
        ):
            self._check_keys(capture.parts[0].empty(quantities=self._quantities), names)

            def add(part: Part, log: Log) -> None:  # noqa: ARG001 - as `write_parts` calls it
                totals.add(log)
                use.add(log)

            counts = self._write_parts(capture.parts, out, self._format_of(out), names, read=add)
        return self._capture_result(totals, counts, capture.findings)

    @property
    def _quantities(self) -> list[EntryKey] | None:
        """The quantities to decode; None for all."""
        return [key for key in self._keys if not is_string(key)] if self._keys else None

    def _read(self, source: Input, cut: CutRecording | None, files: Sequence[str]) -> Log:
        from xbus.log.read import read_log

        with (
            self._strictly(source, files),
            contextlib.nullcontext() if cut is None else cut.reading(),
        ):
            log = read_log(
                source if cut is None else cut.source,
                strict=self._strict,
                quantities=self._quantities,
                **self._for_log,
            )
        if not len(log) and not len(log.messages) and not log.stats.strings:
            raise no_frame(files, log.stats.bytes, source.head)
        return log

    @contextlib.contextmanager
    def _strictly(self, source: Input, files: Sequence[str]) -> Iterator[None]:
        """Converts the error of damage to a Failure."""
        from xbus.errors import DecodeError

        try:
            yield
        except DecodeError as error:
            problem, _, _ = str(error).partition(";")
            where = f", which is {source.locate(error.offset)}" if len(files) > 1 else ""
            if self._between is not None:
                where = " of the part between these times"
            names = ", ".join(map(label, files))
            raise Failure(
                f"{names}: {problem}{where}; without --strict, damage is skipped"
            ) from error

    def _result(
        self,
        log: Log | DecodedTotals,
        tracker: Tracker | None,
        counts: Mapping[str, int],
        quality: str,
    ) -> tuple[str, dict[str, Any]]:
        """Returns the text and values of what was written; counts are as those of `Writer.counts`."""
        text = f"{_written(counts)}; {quality}"
        lines = [text, *undecoded_lines(log, tracker)]
        return "\n".join(lines), self._summary(log, counts)

    def _capture_result(
        self, log: Log | DecodedTotals, counts: Mapping[str, int], findings: Sequence[str]
    ) -> tuple[str, dict[str, Any]]:
        """Returns text and values as `_result`, of a CAN capture."""
        text = f"{_written(counts)}; {quality_text(log, is_capture=True)}"
        values = self._summary(log, counts) | {"findings": list(findings)}
        return "\n".join([text, *findings]), values

    def _write(self, log: Log, table: Any, out: str, progress: ShowsProgress) -> dict[str, int]:
        """Writes OUT and returns its rows and columns; for an npz file its samples and quantities."""
        from xbus.export import tables

        key = self._key
        task, size = f"writing {label(os.path.basename(out))}", log.stats.bytes  # noqa: PTH119
        progress.update(task, 0, size)
        expected, done = 0, 0

        def report(written: int) -> None:
            nonlocal done
            done += written
            progress.update(task, size * done // max(expected, 1), size)

        file_format = FORMATS.get(suffix_of(out))
        if file_format is None:
            arrays, rows, columns = self._arrays(log, table)
            expected = sum(array.nbytes for array in arrays.values())
            with writing(out):
                tables.npz(arrays, out, report)
            return {"row": rows, "column": columns}
        from xbus.log.table_file import write_table

        if isinstance(key, str) and is_string(key):
            expected, stream = log.strings.counts[key], log.strings.arrow_stream(key)
        else:
            expected = len(table.satellites) if key == "gnss_sat_info" else len(table)
            stream = table.arrow_stream(raw=True) if self._raw else table.arrow_stream()
        with writing(out):
            write_table(stream, out, file_format, threads=self._threads, written=report)
        return {"row": done, "column": len(stream.columns)}

    def _arrays(self, log: Log, table: Any) -> tuple[dict[str, Any], int, int]:
        """Returns the arrays of an npz file, and how many samples and quantities, or strings, these are."""
        from xbus.log.resample import Resampled
        from xbus.log.trackers import Tracker

        if isinstance(table, Resampled | Tracker):
            return table.npz_arrays(), len(table), len(table.keys())
        key = self._key
        if isinstance(key, str) and is_string(key):
            strings = log.strings.table(key)
            return {key: strings}, len(strings), len(strings.dtype.names or ())
        return log.npz_arrays(raw=self._raw), len(log), len(log.keys())

    def _table(self, log: Log, names: str, *, is_npz: bool) -> Any:
        """Returns what to write: the log, the column of a quantity, or None for strings."""
        if not self._keys:
            found = log.strings.counts
            if not len(log) and not (found and is_npz):
                raise _without_samples(names, [name or "others" for name in found])
            return log
        if any(is_string(key) for key in self._keys):
            if self._keys[0] not in log.strings.counts:
                raise Failure(f"no {self._keys[0]} in {names}; xbus info lists the content")
            return None
        self._check_keys(log, names)
        return log if self._key is None else log[self._key]

    def _check_keys(self, log: Log, names: str) -> None:
        """Checks that a log has the chosen quantities.

        Raises:
            Failure: It lacks one, or has it in several coordinate systems.
        """
        for key in self._keys:
            name = key if isinstance(key, str) else key[0]
            systems = [found for found in log if isinstance(found, tuple) and found[0] == name]
            if systems and isinstance(key, str):
                choices = " or ".join(map(":".join, systems))
                raise Failure(
                    f"{names} has {name} in several coordinates; choose --quantity {choices}"
                )
            if key not in log:
                text = key if isinstance(key, str) else ":".join(key)
                raise Failure(f"no {text} in {names}; xbus info lists the content")

    def _summary(self, log: Log | DecodedTotals, counts: Mapping[str, int]) -> dict[str, Any]:
        """Returns the summary for JSON."""
        from xbus.describe.text import known_digits

        stats = log.stats
        keys = [key if isinstance(key, str) else ":".join(key) for key in self._keys]
        return {
            "quantities": keys or None,
            **{f"{name}s".replace(" ", "_"): count for name, count in counts.items()},
            "duration_s": known_digits(log.duration),
            "bytes": stats.bytes,
            "frames": stats.frames,
            "samples": stats.samples,
            "strings": stats.strings,
            "restarts": restart_count(log),
            "lost_samples": stats.lost_samples,
            "gaps": stats.gaps,
            "skipped_bytes": stats.skipped_bytes,
            "damage": len(log.damage),
            "malformed": stats.malformed,
            "unfit": stats.unfit,
            "undecoded": [item.to_dict() for item in log.undecoded],
        }
