"""``xbus serve``: a WebSocket client gets what the MCAP file has."""

from __future__ import annotations

import asyncio
import json
import math
import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xbus
from test_cli import WALK, run
from xbus.export.ros.live import LiveMessages
from xbus.export.ros.mcap import Mcap
from xbus.export.ros.stamps import TimeBase

pytest.importorskip("foxglove")
reader = pytest.importorskip("mcap.reader")
websocket = pytest.importorskip("tornado.websocket")
httpclient = pytest.importorskip("tornado.httpclient")

from xbus.cli import websocket_relay  # noqa: E402 - after the checks
from xbus.cli.foxglove_sink import FoxgloveSink  # noqa: E402

#: A message: its topic, its time in ns, and its bytes.
Message = tuple[str, int, bytes]


def part() -> xbus.Log:
    """A part of a recording with fewer messages than the server keeps for a client."""
    return xbus.split_log(WALK, block_bytes=8000)[1].read()


def of_file(log: xbus.Log, path: Path, style: Any = "rep") -> list[Message]:
    log.to_mcap(path, ros_style=style, compression="none")
    with path.open("rb") as file:
        return [
            (channel.topic, message.log_time, message.data)
            for _, channel, message in reader.make_reader(file).iter_messages()
        ]


class Client:
    """A WebSocket client that has subscribed to all topics of a server."""

    def __init__(self, connection: Any, topics: dict[int, str]) -> None:
        self.connection, self._topics = connection, topics
        self.received: list[Message] = []

    @classmethod
    async def connected(cls, sink: FoxgloveSink) -> Client:
        request = httpclient.HTTPRequest(f"ws://127.0.0.1:{sink.port}")
        connection = await websocket.websocket_connect(request, subprotocols=["foxglove.sdk.v1"])
        topics: dict[int, str] = {}
        while len(topics) < len(sink._channels):
            message = await connection.read_message()
            if isinstance(message, str) and (text := json.loads(message))["op"] == "advertise":
                topics |= {channel["id"]: channel["topic"] for channel in text["channels"]}
                assert all(channel["encoding"] == "cdr" for channel in text["channels"])
        wanted = [{"id": number, "channelId": number} for number in topics]
        count = len(sink.subscriptions)
        await connection.write_message(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        while [*sink.subscriptions.values()][count:] != [set(topics.values())]:
            await asyncio.sleep(0.01)
        return cls(connection, topics)

    async def receive(self, count: float = math.inf) -> None:
        """Receives messages until there are as many, or until the server ends the connection."""
        while len(self.received) < count:
            message = await self.connection.read_message()
            if message is None:
                return
            if isinstance(message, bytes) and message[0] == 1:
                number, stamp = struct.unpack_from("<IQ", message, 1)
                self.received.append((self._topics[number], stamp, message[13:]))


async def served(sink: FoxgloveSink, log: xbus.Log, messages: LiveMessages) -> list[Message]:
    """Serves a log, and returns the messages that a client received."""
    client = await Client.connected(sink)
    sink._messages = messages
    before = sink._sent
    sink.write(log)
    await client.receive(sink._sent - before)
    client.connection.close()
    await client.receive()  # until the connection is closed
    return client.received


@pytest.mark.parametrize("style", ["rep", "driver"])
def test_a_client_receives_the_messages_of_the_file(style: Any, tmp_path: Path) -> None:
    log = part()

    def messages() -> LiveMessages:
        times = TimeBase()
        times.add(log)
        return LiveMessages(Mcap(style), times)

    sink = FoxgloveSink(messages(), "127.0.0.1", 0, "walk")
    sink.write(log)  # so that the channels exist
    received = asyncio.run(asyncio.wait_for(served(sink, log, messages()), 30))
    sink.close()
    assert sorted(received) == sorted(of_file(log, tmp_path / "log.mcap", style))
    assert "1 client" in str(sink)


class KeptMessages(LiveMessages):
    """Keeps the messages that it makes."""

    def __init__(self) -> None:
        super().__init__(Mcap())
        self.all: list[Message] = []

    def of(self, block: Any) -> Iterator[tuple[Any, Any, Any]]:
        for schema, channel, message in super().of(block):
            self.all.append((channel.topic, message.log_time, message.data))
            yield schema, channel, message


@pytest.mark.parametrize("is_late", [False, True])
def test_a_slow_client_loses_its_own_data_and_the_loss_is_counted(
    is_late: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in {"LIMIT": 1 << 16, "SYSTEM_BUFFER": 1 << 13, "CLOSING": 0.3}.items():
        monkeypatch.setattr(websocket_relay, name, value)
    sink = FoxgloveSink(KeptMessages(), "127.0.0.1", 0, "walk")
    parts = [part.read() for part in xbus.split_log(WALK, block_bytes=2000)][:25]
    for part in parts:
        sink.write(part)  # so that the channels exist
    messages = KeptMessages()

    async def serve() -> tuple[Client, Client]:
        fast, slow = await Client.connected(sink), await Client.connected(sink)
        sink._messages = messages
        for part in parts:
            await asyncio.to_thread(sink.write, part)
            await fast.receive(len(messages.all))
        # The slow client begins to read when all is sent, or even after the server has ended.
        closing = asyncio.create_task(asyncio.to_thread(sink.close))
        if is_late:
            await closing
        await asyncio.gather(closing, fast.receive(), slow.receive())
        fast.connection.close()
        slow.connection.close()
        return fast, slow

    fast, slow = asyncio.run(asyncio.wait_for(serve(), 60))
    assert fast.received == messages.all
    assert 0 < len(slow.received) < len(messages.all)
    assert len(slow.received) + sink.lost == len(messages.all)
    # It lost the oldest of those that waited, and if it is late all that still waited.
    assert (slow.received[-1] == messages.all[-1]) != is_late
    position = iter(messages.all)
    assert all(message in position for message in slow.received)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("is too slow and loses messages")
    assert str(sink).endswith(f"2 clients, {sink.lost:,} messages lost by 1 too slow")


def test_an_answer_waits_until_the_server_knows_the_channel(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without this, one of seven clients that subscribed at once did not receive the first topic."""
    monkeypatch.setattr(websocket_relay, "PATIENCE", 0.1)

    async def delay() -> float:
        clock = asyncio.get_running_loop().time
        times: list[float] = []

        async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            times.append(clock())
            writer.write(b"head\r\n\r\n")
            await reader.readexactly(1)
            times.append(clock())
            writer.close()

        server = await asyncio.start_server(answer, "127.0.0.1", 0)
        target = server.sockets[0].getsockname()[1]
        relay = await asyncio.to_thread(websocket_relay.WebSocketRelay, "127.0.0.1", 0, target)
        reader, writer = await asyncio.open_connection("127.0.0.1", relay.port)
        await reader.readuntil(b"\r\n\r\n")
        writer.write(b"!")
        await reader.read()
        writer.close()
        await asyncio.to_thread(relay.close)
        server.close()
        return times[1] - times[0]

    assert asyncio.run(asyncio.wait_for(delay(), 30)) >= 0.1


def test_messages_of_a_device_have_the_time_of_the_host() -> None:
    log = xbus.read_log(b"".join(xbus.encode_sample({"temperature": t}) for t in (1.0, 2.0)))
    found = list(LiveMessages(Mcap()).of(log))
    assert [channel.topic for _, channel, _ in found] == ["/temperature"] * 2
    times = np.array([message.log_time for _, _, message in found]) / 1e9
    assert np.abs(times - time.time()).max() < 600
    nothing = xbus.read_log(xbus.encode_sample({"packet_counter": 1}))
    assert list(LiveMessages(Mcap()).of(nothing)) == []


def test_a_virtual_device_is_served_and_recorded(tmp_path: Path) -> None:
    out = tmp_path / "out.mtb"
    arguments = ["--port", "0", "--host", "0.0.0.0", "--duration", "0.5", "--record", str(out)]  # noqa: S104
    result = run("serve", "sim:MTi-630", *arguments)
    assert result.exit_code == 0, result.stderr
    assert "every computer that reaches 0.0.0.0 can read the data" in result.stderr
    assert "serving ws://0.0.0.0:" in result.stderr
    log = xbus.read_log(out)
    assert f"{len(log)} samples recorded in {out}" in result.stderr
    assert len(log) > 20


def test_a_port_in_use() -> None:
    with socket.create_server(("127.0.0.1", 0)) as own:
        result = run("serve", WALK, "--port", str(own.getsockname()[1]))
    assert result.exit_code == 1
    assert "Address already in use" in result.stderr
    assert "choose another --port" in result.stderr


def test_wrong_calls() -> None:
    result = run("serve", WALK, "--record", "out.mtb")
    assert result.exit_code == 2
    assert "is a recording; --record is for a port" in result.stderr
