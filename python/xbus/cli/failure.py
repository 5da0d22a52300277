"""How commands end: one sentence when the work failed, nothing on a broken pipe or Ctrl-C."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from typing import IO, Any, NoReturn

import click

from xbus.errors import XbusError

__all__ = ["Failure", "cannot", "guarded", "stop_requested"]

#: What to do about it.
ADVICE = {
    errno.ENOENT: "check the path",
    errno.ENOTDIR: "check the path",
    errno.EISDIR: "name files, such as DIR/*.mtb",
    errno.EACCES: "ask for the permission, or work on a copy",
    errno.EPERM: "ask for the permission, or work on a copy",
    errno.EROFS: "choose another folder",
    errno.ENOSPC: "free some room, or write to another disk",
    errno.EDQUOT: "free some room, or write to another disk",
    errno.EFBIG: "raise the limit (ulimit -f), or write fewer quantities",
    errno.EBADF: "redirect it to a file, or to /dev/null",
}


class Failure(click.ClickException):
    """The work failed; the message is one sentence that says what, where and what to do."""

    exit_code = 1

    def show(self, file: IO[Any] | None = None) -> None:
        """Prints the sentence on stderr."""
        click.echo(f"xbus: {self.format_message()}", file=file, err=True)


def cannot(what: str, error: OSError) -> Failure:
    """The failure to do ``what`` ("read walk.mtb") because of what the system said."""
    advice = ADVICE.get(error.errno or 0, "try again, or check the disk")
    return Failure(f"cannot {what}: {error.strerror or error}; {advice}")


@contextlib.contextmanager
def guarded() -> Iterator[None]:
    """Turns what goes wrong inside into how a command ends."""
    # A file name or a device's text may hold what the terminal's encoding does not.
    with contextlib.suppress(AttributeError, ValueError):
        sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    try:
        with _terminable():
            yield
            if sys.stdout is not None:
                sys.stdout.flush()
    except BrokenPipeError:
        _hush()
        raise click.exceptions.Exit(0) from None  # who reads has seen enough
    except KeyboardInterrupt:
        _hush()
        raise click.exceptions.Exit(128 + signal.SIGINT) from None
    except (ImportError, XbusError) as error:
        raise Failure(str(error)) from error
    except MemoryError as error:
        raise Failure(
            "there is not enough memory; decode one --quantity at a time, or split the log"
        ) from error
    except OSError as error:
        # Inputs and OUT have been dealt with where they are used.
        _hush()
        raise cannot(f"write to {error.filename or 'standard output'}", error) from error


@contextlib.contextmanager
def _terminable() -> Iterator[None]:
    """Ends in order on SIGTERM and SIGHUP, so that no half-written file stays behind."""

    def leave(number: int, _: object) -> NoReturn:
        raise SystemExit(128 + number)

    known = [getattr(signal, it) for it in ("SIGTERM", "SIGHUP") if hasattr(signal, it)]
    main_thread = threading.current_thread() is threading.main_thread()
    ours = [it for it in known if main_thread and signal.getsignal(it) is signal.SIG_DFL]
    for it in ours:
        signal.signal(it, leave)
    try:
        yield
    finally:
        for it in ours:
            signal.signal(it, signal.SIG_DFL)


@contextlib.contextmanager
def stop_requested() -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C or SIGTERM has come, for commands of which it is the way to end, and no failure."""
    numbers: list[int] = []
    # Who is started in the background by a script is not meant to hear Ctrl-C.
    ours = [it for it in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(it) != signal.SIG_IGN]
    before = [signal.signal(it, lambda number, _: numbers.append(number)) for it in ours]
    try:
        yield lambda: bool(numbers)
    finally:
        for number, handler in zip(ours, before, strict=True):
            signal.signal(number, handler)


def _hush() -> None:
    """What is still to be written goes nowhere: else Python complains about it when it ends."""
    with contextlib.suppress(AttributeError, OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
