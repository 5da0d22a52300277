"""The inputs of commands that read recordings: the argument and the options that all of them share."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypedDict

import click

from xbus.cli.failure import Failure
from xbus.cli.inputs import Input, label, legacy_option, strings_option
from xbus.cli.number_type import NumberRange
from xbus.cli.rate_use import RateUse
from xbus.cli.recordings import (
    Recording,
    joined_recordings,
    one_recording,
    several_recordings,
)

if TYPE_CHECKING:
    from xbus.cli.progress import ShowsProgress

__all__ = ["InputOptions", "LogOptions", "input_options"]


#: The options, the last one first: decorators apply from the bottom.
OPTIONS = (
    click.option(
        "--allow-restart",
        is_flag=True,
        help="Join pieces although the device restarted between them. Not needed for the files of xbus "
        "record.",
    ),
    click.option(
        "--hex",
        "is_hex",
        is_flag=True,
        help="The input is text with the bytes in hex, as copied from MT Manager, a terminal or xxd.",
    ),
    legacy_option,
    strings_option,
    click.option(
        "--rate",
        type=NumberRange(min=0, min_open=True),
        metavar="HZ",
        help="Rate of the packet counter: gives a time to samples without time stamps.",
    ),
    click.option(
        "--bid",
        type=click.IntRange(0, 255),
        metavar="N",
        help="Read only the device with this bus identifier; 1 and 255 are the same device.",
    ),
)


class LogOptions(TypedDict):
    """Options of `read_log` and `iter_log`."""

    bid: int | None
    rate: float | None
    strings: Sequence[str]
    legacy: Sequence[tuple[int, int]]


@dataclass(frozen=True)
class InputOptions:
    """What to read, and how.

    Attributes:
        names: Files, folders, patterns and URLs.
        bid: The only device to read, or None.
        rate: Rate of the packet counter in Hz, or None.
        strings: String types to parse, as in `read_log`.
        legacy: Settings of MTData, as in `read_log`.
        is_hex: Whether the files are text with the bytes in hex.
        allow_restart: As in `read_log`.
    """

    names: tuple[str, ...]
    bid: int | None
    rate: float | None
    strings: tuple[str, ...]
    legacy: Sequence[tuple[int, int]]
    is_hex: bool
    allow_restart: bool

    @property
    def for_log(self) -> LogOptions:
        """The options for `read_log` and `iter_log`."""
        return {
            "bid": self.bid,
            "rate": self.rate,
            "strings": self.strings,
            "legacy": self.legacy,
        }

    def recordings(self) -> list[Recording]:
        """Returns the recordings, as `several_recordings`."""
        return several_recordings(self.names, allow_restart=self.allow_restart, is_hex=self.is_hex)

    def recording(self, remedy: str = "add --out-dir DIR") -> Recording:
        """Returns the only recording, as `one_recording`."""
        return one_recording(
            self.names, allow_restart=self.allow_restart, is_hex=self.is_hex, remedy=remedy
        )

    def joined_recordings(self) -> list[Recording]:
        """Returns the recordings, as `joined_recordings`."""
        return joined_recordings(self.names, allow_restart=self.allow_restart, is_hex=self.is_hex)

    @contextmanager
    def checked_rate(self, recording: Recording) -> Iterator[RateUse]:
        """Yields what counts the samples to which --rate gives a time; a note says if there are none."""
        use = RateUse(self.rate)
        yield use
        if use.note is not None:
            recording.notes.append(f"{recording.heading}: {use.note}")

    @contextmanager
    def opened(
        self, files: Sequence[str], progress: ShowsProgress | None = None
    ) -> Iterator[Input]:
        """Opens the files of a recording.

        Args:
            files: Paths or URLs.
            progress: The progress bar to update.

        Raises:
            Failure: A file cannot be read, or the recording has no samples of the device.
        """
        from xbus.log.log import MissingDeviceError

        with Input(files, progress, is_hex=self.is_hex) as source:
            try:
                yield source
            except MissingDeviceError as error:
                raise Failure(f"{', '.join(map(label, files))}: {error}") from error


def input_options(metavar: str = "IN...") -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Returns a decorator that adds the argument and the options.

    The command receives them as `InputOptions` with the name ``inputs``.

    Args:
        metavar: The argument in help texts.
    """
    return functools.partial(_with_inputs, metavar)


def _with_inputs(metavar: str, command: Callable[..., None]) -> Callable[..., None]:

    @functools.wraps(command)
    def with_inputs(
        names: tuple[str, ...],
        bid: int | None,
        rate: float | None,
        strings: tuple[str, ...],
        legacy: Sequence[tuple[int, int]],
        is_hex: bool,
        allow_restart: bool,
        **options: Any,
    ) -> None:
        inputs = InputOptions(names, bid, rate, strings, legacy, is_hex, allow_restart)
        command(inputs=inputs, **options)

    decorated: Callable[..., None] = with_inputs
    for option in OPTIONS:
        decorated = option(decorated)
    argument = click.argument(
        "names", type=click.Path(readable=False), metavar=metavar, nargs=-1, required=True
    )
    return argument(decorated)
