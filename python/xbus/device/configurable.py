"""What the functions that configure a device need of `Device`, so that they do not import it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Protocol

from xbus.device.commands import Commands
from xbus.device.events import Reply
from xbus.device.session import Session
from xbus.protocol.products import Support
from xbus.protocol.values import Output
from xbus.wire.link import Link

__all__ = ["Configurable"]


class Configurable(Protocol):
    """A device that answers commands: `Device`, whose documentation describes the members."""

    commands: Commands
    output_configuration: tuple[Output, ...] | None

    @property
    def product_code(self) -> str | None:
        """Product code; None until the identity is read."""

    @property
    def link(self) -> Link:
        """The port."""

    @property
    def session(self) -> Session:
        """The protocol state."""

    @property
    def support(self) -> Support | None:
        """What the product supports; None until the identity is read."""

    def command(self, name: str, value: Any = None) -> Reply:
        """Sends a command and returns the reply."""

    def wake_up(self) -> None:
        """Waits for WakeUp and answers it."""

    def find_baudrate(self, baudrates: Iterable[int | None]) -> None:
        """Tries baud rates until it hears the device."""
