"""Sends samples as UDP datagrams."""

from __future__ import annotations

import contextlib
import json
import os
import socket
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import click

from xbus.cli.failure import Failure
from xbus.formatting import format_count

if TYPE_CHECKING:
    from xbus.log.log import Log

__all__ = ["UdpSink", "json_lines", "udp_address"]


def udp_address(url: str) -> tuple[str, int]:
    """Returns host and port of an URL.

    Raises:
        BadParameter: It is not ``udp://HOST:PORT``.

    >>> udp_address("udp://localhost:5005")
    ('localhost', 5005)
    """
    parts = urlsplit(url)
    host, port = None, None
    with contextlib.suppress(ValueError):
        host, port = parts.hostname, parts.port
    if parts.scheme != "udp" or not host or not port or parts.path not in ("", "/"):
        raise click.BadParameter(f"{url!r} is not udp://HOST:PORT, such as udp://127.0.0.1:5005")
    return host, port


def json_lines(block: Log) -> Iterator[bytes]:
    """Yields each sample as a line of JSON."""
    from xbus.describe.rows import sample_dicts

    for sample in sample_dicts(block):
        yield json.dumps(sample, allow_nan=False).encode() + b"\n"


class UdpSink:
    """Sends datagrams and never waits: what the network does not take at once is lost and counted.

    Args:
        url: Where to send them, as in `udp_address`.
        noun: What a datagram holds, in the singular.
        encode: Returns the datagrams of a block.

    Raises:
        Failure: The host is not known.
    """

    def __init__(
        self,
        url: str,
        noun: str = "sample",
        encode: Callable[[Log], Iterable[bytes]] = json_lines,
    ) -> None:
        host, port = udp_address(url)
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
        except OSError as error:
            raise Failure(
                f"cannot resolve {host}: {error.strerror}; check the address after --to"
            ) from error
        family, kind, protocol, _, address = found[0]
        self._socket = socket.socket(family, kind, protocol)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        self._socket.setblocking(False)
        try:
            # A connected socket reports that nothing listens on the port.
            self._socket.connect(address)
        except OSError as error:
            self._socket.close()
            raise Failure(
                f"cannot reach {host}: {error.strerror}; check the address after --to"
            ) from error
        self._noun, self._encode = noun, encode
        self._sent = self._lost = 0
        self._reason = ""

    @property
    def offered(self) -> int:
        """Number of datagrams, sent or lost."""
        return self._sent + self._lost

    def write(self, block: Log) -> None:
        """Sends the datagrams of a block."""
        for data in self._encode(block):
            self._send(data)

    def _send(self, data: bytes) -> None:
        try:
            try:
                self._socket.send(data)
            except ConnectionRefusedError as error:
                # This is the answer to the previous datagram; the system has not sent this one.
                self._lose_previous(error)
                self._socket.send(data)
        except OSError as error:
            # The queue is full, nothing listens on the port, the datagram is too long, or there is no route.
            self._lost += 1
            self._reason = error.strerror or str(error)
        else:
            self._sent += 1

    def _lose_previous(self, error: OSError) -> None:
        """Counts the datagram that was sent last as lost."""
        self._reason = error.strerror or str(error)
        if self._sent:
            self._sent -= 1
            self._lost += 1

    def note(self, text: str, *, is_bad: bool) -> None:  # noqa: ARG002 - as in `Sink`
        """Prints an event: datagrams have samples only."""
        click.echo(f"xbus: {text}", err=True)

    def close(self) -> None:
        """Closes the socket."""
        if number := self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            self._lose_previous(OSError(number, os.strerror(number)))
        self._socket.close()

    def __str__(self) -> str:
        lost = f", {self._lost:,} lost: {self._reason}" if self._lost else ""
        return f"{format_count(self._sent, self._noun)} sent{lost}"
