"""A WebSocket server for Foxglove."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from xbus.cli.failure import Failure
from xbus.extras import require
from xbus.formatting import format_count

if TYPE_CHECKING:
    from xbus.export.ros.live import LiveMessages
    from xbus.log.log import Log

__all__ = ["FoxgloveSink"]


class FoxgloveSink:
    """Serves messages of ROS 2.

    The server keeps a limited number of messages for each client: a slow one loses the oldest.

    Args:
        messages: Makes the messages.
        host: Address to listen on.
        port: TCP port.
        name: What clients show.

    Raises:
        ImportError: The extra ``foxglove`` is not installed.
        Failure: The server cannot listen.
    """

    def __init__(self, messages: LiveMessages, host: str, port: int, name: str) -> None:
        self._foxglove = require("foxglove", "foxglove", "to serve Foxglove")
        self._messages = messages
        self._context = self._foxglove.Context()
        self._channels: dict[str, Any] = {}
        self._sent = 0
        #: The topics that each client has subscribed to, by its number.
        self.subscriptions: dict[int, set[str]] = {}
        try:
            self._server = self._foxglove.start_server(
                name=f"xbus {name}",
                host=host,
                port=port,
                server_listener=_listener(self._foxglove, self.subscriptions),
                context=self._context,
            )
        except RuntimeError as error:
            raise Failure(
                f"cannot listen on {host}:{port}: {str(error).removeprefix('FoxgloveError: ')}; choose "
                "another --port, or close the program that uses it"
            ) from error

    @property
    def port(self) -> int:
        """The TCP port."""
        return int(self._server.port)

    def write(self, block: Log) -> None:
        """Serves the samples of a block."""
        for schema, channel, message in self._messages.of(block):
            if channel.topic not in self._channels:
                definition = self._foxglove.Schema(
                    name=schema.name, encoding=schema.encoding, data=schema.data
                )
                self._channels[channel.topic] = self._foxglove.Channel(
                    channel.topic,
                    schema=definition,
                    message_encoding=channel.message_encoding,
                    context=self._context,
                    metadata=channel.metadata,
                )
            self._channels[channel.topic].log(message.data, log_time=message.log_time)
            self._sent += 1

    def note(self, text: str, *, is_bad: bool) -> None:
        """Shows an event to all clients, and prints it."""
        levels = self._foxglove.StatusLevel
        self._server.publish_status(text, levels.Warning if is_bad else levels.Info)
        click.echo(f"xbus: {text}", err=True)

    def close(self) -> None:
        """Stops the server."""
        self._server.stop()

    def __str__(self) -> str:
        topics = format_count(len(self._channels), "topic")
        clients = format_count(len(self.subscriptions), "client")
        return f"{format_count(self._sent, 'message')} on {topics}, {clients}"


def _listener(foxglove: Any, subscriptions: dict[int, set[str]]) -> Any:
    """Returns a listener that notes what clients subscribe to. The server calls it in another thread."""

    class Listener(foxglove.ServerListener):  # type: ignore[misc]
        def on_subscribe(self, client: Any, channel: Any) -> None:
            subscriptions.setdefault(client.id, set()).add(channel.topic)

    return Listener()
