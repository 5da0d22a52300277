"""How commands end: with one sentence if they fail, and quietly on Ctrl-C or a broken pipe."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from typing import IO, Any, NoReturn

import click

from xbus.captures import CaptureError
from xbus.describe.failures import file_failure
from xbus.describe.names import file_label
from xbus.errors import XbusError

__all__ = ["Failure", "cannot", "failure_of", "handle_errors", "no_capture", "stop_requested"]


class Failure(click.ClickException):
    """A command failed. The message is one sentence: what failed, where, and the remedy."""

    exit_code = 1

    def show(self, file: IO[Any] | None = None) -> None:
        """Prints the sentence to stderr."""
        click.echo(f"xbus: {self.format_message()}", file=file, err=True)


def cannot(action: str, error: OSError) -> Failure:
    """Returns the failure of an action, such as "read walk.mtb", because of an error of the system."""
    return Failure(file_failure(action, error))


def no_capture(names: str) -> Failure:
    """Returns the failure of a CAN capture that a command does not read, or not from a stream."""
    return Failure(f"{names} is a CAN capture; xbus info, decode and report read files of those")


def failure_of(error: Exception) -> Failure | None:
    """Returns the failure for an error that is not a fault of the program; None for other errors."""
    match error:
        case Failure():
            return error
        case CaptureError():
            return no_capture(file_label(error.name))
        case ImportError() | XbusError():
            return Failure(str(error))
        case MemoryError() | RuntimeError() if _is_lack_of_memory(error):
            return Failure(
                "not enough memory; close other programs, or raise the limit (ulimit -v)"
            )
        case OSError():
            return cannot(f"write to {error.filename or 'standard output'}", error)
    return None


def _is_lack_of_memory(error: Exception) -> bool:
    return isinstance(error, MemoryError) or str(error) == "can't start new thread"


@contextlib.contextmanager
def handle_errors() -> Iterator[None]:
    """Converts exceptions to messages and exit status."""
    # File names and text from a device can contain characters that the encoding of the terminal lacks.
    with contextlib.suppress(AttributeError, ValueError):
        sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    try:
        with _exit_on_signals():
            yield
            if sys.stdout is not None:
                sys.stdout.flush()
    except BrokenPipeError:
        _discard_output()
        raise click.exceptions.Exit(0) from None  # the reader has seen enough
    except KeyboardInterrupt:
        _discard_output()
        raise click.exceptions.Exit(128 + signal.SIGINT) from None
    except Exception as error:
        # Errors of inputs and of OUT are handled where they are used.
        failure = failure_of(error)
        if failure is None or failure is error:
            raise
        if isinstance(error, OSError):
            _discard_output()
        raise failure from error


@contextlib.contextmanager
def _exit_on_signals() -> Iterator[None]:
    """Raises SystemExit on SIGTERM and SIGHUP, so that incomplete files are removed."""

    def leave(number: int, _: object) -> NoReturn:
        raise SystemExit(128 + number)

    known = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    is_main = threading.current_thread() is threading.main_thread()
    handled = [number for number in known if is_main and signal.getsignal(number) is signal.SIG_DFL]
    for number in handled:
        signal.signal(number, leave)
    try:
        yield
    finally:
        for number in handled:
            signal.signal(number, signal.SIG_DFL)


@contextlib.contextmanager
def stop_requested() -> Iterator[Callable[[], bool]]:
    """Yields a function that returns whether Ctrl-C or SIGTERM was received.

    For commands that run until they are stopped.
    """
    received: list[int] = []
    # A script starts background processes with SIGINT ignored.
    signals = (signal.SIGINT, signal.SIGTERM)
    handled = [number for number in signals if signal.getsignal(number) != signal.SIG_IGN]
    before = [
        signal.signal(number, lambda number, _: received.append(number)) for number in handled
    ]
    try:
        yield lambda: bool(received)
    finally:
        for number, handler in zip(handled, before, strict=True):
            signal.signal(number, handler)


def _discard_output() -> None:
    """Redirects stdout to the null device; otherwise Python reports the unwritten output when it exits."""
    with contextlib.suppress(AttributeError, OSError, ValueError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, sys.stdout.fileno())
        os.close(null)
