"""CAN captures as inputs of commands, and the options that only they have."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from xbus.captures import is_capture
from xbus.cli.failure import Failure, cannot
from xbus.cli.input_options import InputOptions
from xbus.cli.inputs import label, reading_task
from xbus.cli.progress import ShowsProgress

if TYPE_CHECKING:
    from xbus.can.ids import DeviceIds
    from xbus.can.stored import StoredCapture
    from xbus.log.log import Log

__all__ = ["CanOptions", "can_options", "ids_option"]


def _ids(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    values: tuple[str, ...],
) -> list[DeviceIds] | None:
    """Returns the identifiers of each device; None if none are given."""
    if not values:
        return None
    from xbus.can.ids import device_ids, parse_ids

    try:
        ids = list(map(parse_ids, values))
        device_ids(ids)
    except ValueError as error:
        raise click.BadParameter(str(error)) from error
    return ids


ids_option = click.option(
    "--ids",
    callback=_ids,
    multiple=True,
    metavar="IDS",
    help="CAN identifiers of a device: an offset to the default ones (0x100), or those of its messages "
    "(SampleTime=0x10,Acceleration=0x11). Repeat for several devices. Above 0x7FF they have 29 bits.",
)


@dataclass(frozen=True)
class CanOptions:
    """How to read CAN captures.

    Attributes:
        ids: Identifiers of the devices, as in `xbus.read_can`.
        channel: The only channel to read, or None.
    """

    ids: Sequence[DeviceIds] | None
    channel: str | None

    def check(self, inputs: InputOptions, files: Sequence[str]) -> bool:
        """Returns whether the files of a recording are CAN captures.

        Raises:
            UsageError: An option does not apply to them.
        """
        if inputs.is_hex or not any(map(is_capture, files)):
            if self.ids is not None or self.channel is not None:
                raise click.UsageError("--ids and --channel apply to CAN captures only")
            return False
        if inputs.strings:
            raise click.UsageError("--string does not apply to CAN captures")
        if inputs.legacy:
            raise click.UsageError("--legacy does not apply to CAN captures")
        return True

    def read(
        self,
        inputs: InputOptions,
        files: Sequence[str],
        progress: ShowsProgress,
        *,
        strict: bool = False,
    ) -> tuple[Log, tuple[str, ...]]:
        """Returns the log of a capture, and what is unusual in it.

        Raises:
            Failure: The capture cannot be read, or has no samples.
        """
        from xbus.can import read_can

        [name] = files
        progress.update(reading_task(name))
        with _reading(name):
            log = read_can(name, self.ids, channel=self.channel, rate=inputs.rate, strict=strict)
            self._check_samples(name, len(log), log.traffic.findings)
            return (log if inputs.bid is None else log.device(inputs.bid)), log.traffic.findings

    def parts(
        self, inputs: InputOptions, files: Sequence[str], progress: ShowsProgress, found: list[str]
    ) -> Iterator[Log]:
        """Yields the parts of a capture of any size, and adds what is unusual to `found` in the end.

        Raises:
            Failure: The capture cannot be read, or has no samples.
        """
        with self.stored(inputs, files, progress) as capture:
            found.extend(capture.findings)
            for part in capture.parts:
                yield part.read()

    @contextlib.contextmanager
    def stored(
        self,
        inputs: InputOptions,
        files: Sequence[str],
        progress: ShowsProgress,
        *,
        strict: bool = False,
    ) -> Iterator[StoredCapture]:
        """Yields the parts of a capture of any size, which are in a temporary file meanwhile.

        Raises:
            Failure: The capture cannot be read, or has no samples.
        """
        from xbus.can import iter_can
        from xbus.can.stored import StoredCapture

        [name] = files
        task = reading_task(name)
        progress.update(task)
        with _reading(name):
            logs = iter_can(name, self.ids, channel=self.channel, rate=inputs.rate, strict=strict)
            capture = StoredCapture(logs, bid=inputs.bid)
        with capture:
            self._check_samples(name, sum(part.samples for part in capture.parts), capture.findings)
            yield capture

    @staticmethod
    def _check_samples(name: str, samples: int, findings: Sequence[str]) -> None:
        if not samples:
            seen = "; ".join(findings) or "the capture has no frames"
            raise Failure(f"{label(name)} has no samples of an MTi: {seen}")


@contextlib.contextmanager
def _reading(name: str) -> Iterator[None]:
    """Converts the errors of a capture that cannot be read to a Failure."""
    from xbus.errors import DecodeError

    try:
        yield
    except OSError as error:
        raise cannot(f"read {label(name)}", error) from error
    except DecodeError as error:
        raise Failure(
            f"{label(name)}: {error}; without --strict, such frames are skipped"
        ) from error
    except ValueError as error:
        raise Failure(f"{label(name)}: {error}") from error


def can_options(command: Callable[..., None]) -> Callable[..., None]:
    """Adds the options to a command, which receives them as `CanOptions` with the name ``can``."""

    @functools.wraps(command)
    def with_can(ids: list[DeviceIds] | None, channel: str | None, **options: Any) -> None:
        command(can=CanOptions(ids, channel), **options)

    channel = click.option(
        "--channel", metavar="NAME", help="Read only this channel of a CAN capture."
    )
    decorated: Callable[..., None] = ids_option(channel(with_can))
    return decorated
