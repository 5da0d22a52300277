"""A link that is lost, opened again and closed while several threads use it."""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable
from typing import NoReturn, Protocol

from xbus.errors import Disconnected
from xbus.wire.link import Link

__all__ = ["Connection", "abandon_in_fork"]


class Connection:
    """Notices that a link is gone, and opens it again.

    Args:
        link: The link.
        on_loss: Called when the link is lost, before `Disconnected` is raised.

    Attributes:
        is_lost: Whether the port is gone.
        losses: How often it was lost.
        is_closed: Whether the program has closed it.
    """

    def __init__(self, link: Link, on_loss: Callable[[], None]) -> None:
        self._link = link
        self._on_loss = on_loss
        self.is_lost = self.is_closed = self._is_abandoned = False
        self.losses = 0
        self._lock = threading.RLock()

    def open(self, command: str | None) -> int:
        """Opens the port again if it was lost. Returns how often that has happened, for `check`.

        Args:
            command: The command that needs it, for error messages.

        Raises:
            Disconnected: The port cannot be opened, or was closed.
        """
        self.refuse_closed(command)
        with self._lock:
            if self.is_lost:
                try:
                    self._link.reopen()
                except OSError as error:
                    self._lose(error, self.losses, command)
                self.is_lost = False
                if self.is_closed:  # meanwhile, by another thread
                    self._link.close()
                    self.refuse_closed(command)
            return self.losses

    def check(self, losses: int, command: str | None) -> None:
        """Checks that the port was neither lost nor closed since `open` returned a number.

        Raises:
            Disconnected: It was.
        """
        self.refuse_closed(command)
        if losses != self.losses:  # another thread has noticed, and may have opened it again
            self._raise(ConnectionResetError("the port was gone meanwhile"), command)
        if (reason := self._link.acquisition.ended) is not None:
            self._lose(ConnectionResetError(reason), losses, command)

    def write(self, data: bytes, losses: int, command: str) -> None:
        """Sends bytes.

        Args:
            data: The bytes.
            losses: The number that `open` returned.
            command: The command that sends them, for error messages.

        Raises:
            Disconnected: The port is gone.
        """
        try:
            self._link.write(data)
        except OSError as error:
            self._lose(error, losses, command)

    def close(self) -> None:
        """Closes the link. All that wait for it get `Disconnected`."""
        self.is_closed = True
        self._link.close()

    def abandon(self) -> None:
        """Gives up the link in a forked process: it belongs to the parent."""
        self._lock = threading.RLock()
        self.is_closed = self._is_abandoned = True
        self._link.abandon()

    def refuse_closed(self, command: str | None) -> None:
        """Raises Disconnected if the link was closed."""
        if self.is_closed:
            what = "belongs to the parent process" if self._is_abandoned else "was closed"
            raise Disconnected(f"{self._link.name} {what}; connect() opens it again", command)

    def _lose(self, error: OSError, losses: int, command: str | None) -> NoReturn:
        self.refuse_closed(command)
        with self._lock:
            # Another thread may have noticed, and have opened the port again.
            if not self.is_lost and losses == self.losses:
                self.is_lost = True
                self.losses += 1
                self._on_loss()
        self._raise(error, command)

    def _raise(self, error: OSError, command: str | None) -> NoReturn:
        what = f"during {command}" if command else "while listening"
        raise Disconnected(
            f"{self._link.name} was lost {what}: {error}; check the cable; the next command opens the port"
            " again",
            command,
        ) from error


class Abandonable(Protocol):
    """What a forked process gives up."""

    def abandon(self) -> None:
        """Gives up what belongs to the parent process."""


_ABANDONED_IN_FORK: weakref.WeakSet[Abandonable] = weakref.WeakSet()


def abandon_in_fork(owner: Abandonable) -> None:
    """Makes forked processes call ``owner.abandon()``, as long as it exists."""
    _ABANDONED_IN_FORK.add(owner)


def _abandon_all() -> None:
    for owner in list(_ABANDONED_IN_FORK):
        owner.abandon()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_abandon_all)
