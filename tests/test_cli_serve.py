"""``xbus serve``: a WebSocket client gets what the MCAP file has."""

from __future__ import annotations

import asyncio
import json
import socket
import struct
import time
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

from xbus.cli.foxglove_sink import FoxgloveSink  # noqa: E402 - after the checks

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


async def served(sink: FoxgloveSink, log: xbus.Log, messages: LiveMessages) -> list[Message]:
    """Subscribes to all topics, serves a log, and returns the messages that the client received."""
    request = httpclient.HTTPRequest(f"ws://127.0.0.1:{sink.port}")
    client = await websocket.websocket_connect(request, subprotocols=["foxglove.sdk.v1"])
    topics: dict[int, str] = {}
    while len(topics) < len(sink._channels):
        message = await client.read_message()
        if isinstance(message, str) and (text := json.loads(message))["op"] == "advertise":
            topics |= {channel["id"]: channel["topic"] for channel in text["channels"]}
            assert all(channel["encoding"] == "cdr" for channel in text["channels"])
    wanted = [{"id": number, "channelId": number} for number in topics]
    await client.write_message(json.dumps({"op": "subscribe", "subscriptions": wanted}))
    while list(sink.subscriptions.values()) != [set(topics.values())]:
        await asyncio.sleep(0.01)
    sink._messages = messages
    before = sink._sent
    sink.write(log)
    received: list[Message] = []
    while len(received) < sink._sent - before:
        message = await client.read_message()
        if isinstance(message, bytes) and message[0] == 1:
            number, stamp = struct.unpack_from("<IQ", message, 1)
            received.append((topics[number], stamp, message[13:]))
    client.close()
    return received


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
