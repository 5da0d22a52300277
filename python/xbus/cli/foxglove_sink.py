"""A WebSocket server for Foxglove."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from xbus.cli.failure import Failure
from xbus.cli.websocket_relay import WebSocketRelay
from xbus.extras import require
from xbus.formatting import format_count

if TYPE_CHECKING:
    from xbus.export.ros.live import LiveMessages
    from xbus.log.log import Log

__all__ = ["FoxgloveSink"]

#: Messages that the server of the SDK keeps until the relay takes them: those of many seconds, because it
#: does not count what it drops.
BACKLOG = 1 << 16


class FoxgloveSink:
    """Serves messages of ROS 2. A slow client loses its oldest messages, which `WebSocketRelay` counts.

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
        #: The slow clients of which a line was printed.
        self._slow: set[str] = set()
        self._server = self._foxglove.start_server(
            name=f"xbus {name}",
            port=0,
            server_listener=_listener(self._foxglove, self.subscriptions),
            context=self._context,
            message_backlog_size=BACKLOG,
        )
        try:
            self._relay = WebSocketRelay(host, port, self._server.port)
        except OSError as error:
            self._server.stop()
            raise Failure(
                f"cannot listen on {host}:{port}: {error.strerror or error}; choose another --port, or close "
                "the program that uses it"
            ) from error

    @property
    def port(self) -> int:
        """The TCP port."""
        return self._relay.port

    @property
    def lost(self) -> int:
        """Number of messages that slow clients lost."""
        return self._relay.lost[0]

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
        for name in self._relay.losses().keys() - self._slow:
            self._slow.add(name)
            click.echo(f"xbus: client {name} is too slow and loses messages", err=True)

    def note(self, text: str, *, is_bad: bool) -> None:
        """Shows an event to all clients, and prints it."""
        levels = self._foxglove.StatusLevel
        self._server.publish_status(text, levels.Warning if is_bad else levels.Info)
        click.echo(f"xbus: {text}", err=True)

    def close(self) -> None:
        """Stops the server."""
        self._relay.settle()
        self._server.stop()
        self._relay.close()

    def __str__(self) -> str:
        topics = format_count(len(self._channels), "topic")
        clients = format_count(len(self.subscriptions), "client")
        text = f"{format_count(self._sent, 'message')} on {topics}, {clients}"
        lost, slow = self._relay.lost
        return text + (f", {format_count(lost, 'message')} lost by {slow} too slow" if lost else "")


def _listener(foxglove: Any, subscriptions: dict[int, set[str]]) -> Any:
    """Returns a listener that notes what clients subscribe to. The server calls it in another thread."""

    class Listener(foxglove.ServerListener):  # type: ignore[misc]
        def on_subscribe(self, client: Any, channel: Any) -> None:
            subscriptions.setdefault(client.id, set()).add(channel.topic)

    return Listener()
