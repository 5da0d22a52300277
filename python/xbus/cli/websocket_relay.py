"""A relay between a WebSocket server and its clients, which counts what slow clients lose."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from collections import deque
from collections.abc import Iterator
from typing import Any

__all__ = ["WebSocketRelay"]

#: Bytes that wait for a client before it loses its oldest messages.
LIMIT = 1 << 20
#: Bytes that are handed to the system at a time, and that the system keeps for a client.
BATCH, SYSTEM_BUFFER = 1 << 16, 1 << 18
#: The longest head of a response of HTTP.
HEAD = 1 << 16
#: Seconds that clients have at the end to take what waits for them, and seconds without data after which
#: everything has arrived.
CLOSING, QUIET = 1.0, 0.05
#: Seconds that the data of a client waits. The server advertises a new channel before it knows it, and
#: ignores a subscription that comes in between: the client would never receive the channel.
PATIENCE = 0.02
#: The first byte of a whole binary frame (RFC 6455), and that of its payload for a message of a channel.
BINARY, MESSAGE = 0x82, 1
#: Values of the length in a frame for which 2 and 8 bytes follow that are the length.
LENGTH_2, LENGTH_8 = 126, 127


class _Client:
    """What waits for a client.

    Attributes:
        name: Its address.
        lost: Number of messages that it has lost.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.lost = 0
        self._waiting: deque[bytes] = deque()
        self._size = 0
        #: What is handed to the system.
        self._batch: list[bytes] = []
        self._has_news = asyncio.Event()
        self._is_complete = False

    @property
    def is_empty(self) -> bool:
        """Whether the system has taken everything."""
        return not self._waiting and not self._batch

    def put(self, frame: bytes) -> None:
        """Adds a frame. The oldest messages are lost if too much waits.

        Raises:
            ConnectionError: Too much waits that is no message of a channel and may not be lost.
        """
        self._waiting.append(frame)
        self._size += len(frame)
        while self._size > LIMIT:
            oldest = next((at for at, one in enumerate(self._waiting) if _is_message(one)), None)
            if oldest is None:
                raise ConnectionAbortedError
            self._size -= len(self._waiting[oldest])
            del self._waiting[oldest]
            self.lost += 1
        self._has_news.set()

    def end(self) -> None:
        """Ends `send` when nothing waits."""
        self._is_complete = True
        self._has_news.set()

    async def send(self, writer: asyncio.StreamWriter) -> None:
        """Sends what waits, until the end."""
        while True:
            while not self._waiting:
                if self._is_complete:
                    return
                self._has_news.clear()
                await self._has_news.wait()
            size = 0
            while self._waiting and size < BATCH:
                self._batch.append(self._waiting.popleft())
                size += len(self._batch[-1])
            self._size -= size
            writer.write(b"".join(self._batch))
            await writer.drain()
            self._batch.clear()

    def lose_rest(self, unsent: int) -> None:
        """Counts messages as lost that wait, and those of which bytes at the end were not sent."""
        rest = [*self._waiting]
        for frame in reversed(self._batch):
            if unsent <= 0:
                break
            rest.append(frame)
            unsent -= len(frame)
        self.lost += sum(map(_is_message, rest))
        self._waiting.clear()
        self._batch.clear()


class WebSocketRelay:
    """Listens for WebSocket clients and connects each of them to a server on this computer.

    The server sends as if all clients were fast. What a client does not take in time waits here, and beyond
    `LIMIT` bytes its oldest messages are lost and counted. Only messages of channels are lost, as Foxglove's
    protocol defines them; all other frames are passed on in order.

    Args:
        host: Address to listen on.
        port: TCP port; 0 for any free one.
        target: TCP port of the server on this computer.

    Raises:
        OSError: The address cannot be used.
    """

    def __init__(self, host: str, port: int, target: int) -> None:
        self._target = target
        family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        self._socket = socket.create_server(address[:2], family=family)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SYSTEM_BUFFER)
        #: Number of messages that clients lost that are gone, and number of these clients.
        self._lost = self._slow = 0
        self._clients: dict[_Client, asyncio.Task[None]] = {}
        self._received_at = 0.0
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(
            target=self._loop.run_forever, name="xbus relay", daemon=True
        )
        self._thread.start()
        self._server = self._run(asyncio.start_server(self._connected, sock=self._socket))

    def _run(self, coroutine: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result()

    @property
    def port(self) -> int:
        """The TCP port on which it listens."""
        return int(self._socket.getsockname()[1])

    def losses(self) -> dict[str, int]:
        """Returns the number of messages that each present client has lost, by its address."""
        return {client.name: client.lost for client in list(self._clients) if client.lost}

    @property
    def lost(self) -> tuple[int, int]:
        """Number of messages that clients have lost, and number of these clients."""
        present = self.losses()
        return self._lost + sum(present.values()), self._slow + len(present)

    def settle(self) -> None:
        """Waits until all has arrived and clients have taken it, but at most `CLOSING` seconds."""
        self._run(self._settle())

    async def _settle(self) -> None:
        loop = self._loop
        end = loop.time() + CLOSING
        while loop.time() < end and not (
            loop.time() - self._received_at > QUIET
            and all(client.is_empty for client in self._clients)
        ):
            await asyncio.sleep(QUIET / 5)

    def close(self) -> None:
        """Disconnects the clients, those after a while that do not take what the server has sent."""
        self._run(self._close())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _close(self) -> None:
        self._server.close()
        if tasks := list(self._clients.values()):
            _, pending = await asyncio.wait(tasks, timeout=CLOSING)
            for task in pending:
                task.cancel()
            await asyncio.gather(*pending, return_exceptions=True)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        host, port, *_ = writer.get_extra_info("peername")
        client = _Client(f"[{host}]:{port}" if ":" in host else f"{host}:{port}")
        task = asyncio.current_task()
        assert task is not None  # noqa: S101 - see `asyncio.start_server`
        self._clients[client] = task
        try:
            with contextlib.suppress(OSError, asyncio.IncompleteReadError, asyncio.CancelledError):
                await self._relay(client, reader, writer)
        finally:
            writer.transport.abort()
            del self._clients[client]
            self._lost += client.lost
            self._slow += client.lost > 0

    async def _relay(
        self, client: _Client, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        # `drain` waits until the system has all.
        writer.transport.set_write_buffer_limits(0)
        source, sink = await asyncio.open_connection("127.0.0.1", self._target, limit=HEAD)
        copying = asyncio.ensure_future(_copy(reader, sink))
        receiving = asyncio.ensure_future(self._receive(client, source))
        sending = asyncio.ensure_future(client.send(writer))
        tasks = copying, receiving, sending
        try:
            # The end of either side ends the connection.
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            if receiving.done() and not receiving.exception():
                await sending
        except asyncio.CancelledError:
            client.lose_rest(writer.transport.get_write_buffer_size())
            raise
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            sink.transport.abort()

    async def _receive(self, client: _Client, source: asyncio.StreamReader) -> None:
        """Receives the head of the response and the frames of the server."""
        client.put(await source.readuntil(b"\r\n\r\n"))
        rest = b""
        while data := await source.read(1 << 20):
            self._received_at = self._loop.time()
            rest += data
            end = 0
            for start, end in _frames(rest):
                client.put(rest[start:end])
            rest = rest[end:]
        client.end()


async def _copy(reader: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
    """Passes on what a client sends; it is little, and the server waits for it."""
    while data := await reader.read(BATCH):
        await asyncio.sleep(PATIENCE)
        sink.write(data)
        await sink.drain()


def _is_message(frame: bytes) -> bool:
    """Returns whether a frame is a message of a channel: one without which a client understands the rest."""
    return frame[0] == BINARY and frame[_head_size(frame) : _head_size(frame) + 1] == bytes(
        [MESSAGE]
    )


def _head_size(frame: bytes) -> int:
    return {LENGTH_2: 4, LENGTH_8: 10}.get(frame[1], 2)


def _frames(data: bytes) -> Iterator[tuple[int, int]]:
    """Yields start and end of each whole frame. Servers do not mask frames."""
    start = 0
    while len(data) - start >= 2:
        length, head = data[start + 1], 2
        if length >= LENGTH_2:
            head = 4 if length == LENGTH_2 else 10
            length = int.from_bytes(data[start + 2 : start + head], "big")
            if len(data) < start + head:
                return
        end = start + head + length
        if end > len(data):
            return
        yield start, end
        start = end
