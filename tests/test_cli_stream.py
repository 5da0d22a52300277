"""``xbus stream``: datagrams and LSL."""

from __future__ import annotations

import json
import math
import socket
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import xbus
from test_cli import WALK, run
from xbus.cli.udp_sink import UdpSink
from xbus.describe.rows import sample_dicts

Receiver = tuple[socket.socket, str]


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    """A socket that receives datagrams, and its URL."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        own.bind(("127.0.0.1", 0))
        own.setblocking(False)
        yield own, f"udp://127.0.0.1:{own.getsockname()[1]}"


def received(own: socket.socket) -> list[bytes]:
    datagrams = []
    while True:
        try:
            datagrams.append(own.recv(1 << 16))
        except BlockingIOError:
            return datagrams


def refuse_constant(name: str) -> Any:
    raise AssertionError(f"{name} is not JSON")


def test_a_recording_as_lines_of_json(receiver: Receiver) -> None:
    own, url = receiver
    result = run("stream", WALK, "--to", url, "--speed", "1000000", "--duration", "0.5")
    assert result.exit_code == 0, result.stderr
    lines = received(own)
    assert all(line.endswith(b"}\n") and line.count(b"\n") == 1 for line in lines)
    rows = [json.loads(line, parse_constant=refuse_constant) for line in lines]
    assert f"{len(rows)} samples sent; no samples lost" in result.stderr
    log = xbus.read_log(WALK)
    assert rows == list(sample_dicts(log))[: len(rows)]
    acceleration = [list(row["acceleration"].values()) for row in rows if "acceleration" in row]
    np.testing.assert_array_equal(
        np.array(acceleration, np.float32), log["acceleration"].values[: len(acceleration)]
    )
    assert rows[0]["utc"] == "2026-11-22T09:30:00.000000Z"
    # The duration is one of the recording, whatever the speed; the last block may end later.
    assert 0.5 <= rows[-1]["time"] - rows[0]["time"] < 1


def test_numbers_that_json_does_not_have_are_null() -> None:
    samples: list[dict[str, Any]] = [
        {"acceleration": (math.nan, math.inf, 1.0)},
        {"temperature": math.nan},
    ]
    log = xbus.read_log(b"".join(map(xbus.encode_sample, samples)))
    first, second = sample_dicts(log)
    assert first["acceleration"] == {"x": None, "y": None, "z": 1.0}
    assert (second["temperature"], second["time"], second["utc"]) == (None, None, None)


def test_a_virtual_device(receiver: Receiver) -> None:
    own, url = receiver
    result = run("stream", "sim:MTi-630", "--to", url, "--duration", "0.5")
    assert result.exit_code == 0, result.stderr
    samples = [json.loads(line)["sample"] for line in received(own)]
    assert samples == list(range(len(samples)))
    assert len(samples) >= 40


def test_a_receiver_that_is_gone_loses_its_data_and_the_loss_is_counted() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.bind(("127.0.0.1", 0))
        port = own.getsockname()[1]
    sink = UdpSink(f"udp://127.0.0.1:{port}", "json")
    sink.write(xbus.read_log(WALK))
    sink.close()
    # All of them: the answer to a datagram, that nothing listens, arrives with a later one.
    assert str(sink) == "0 samples sent, 1,040 lost: Connection refused"


def test_sentences_of_the_device(receiver: Receiver, tmp_path: Any) -> None:
    own, url = receiver
    sentence = xbus.encode_string("HEHDT", {"heading": 12.5})
    path = tmp_path / "strings.mtb"
    path.write_bytes(sentence + xbus.encode_sample({"temperature": 1.0}) + sentence)
    result = run("stream", str(path), "--to", url, "--format", "nmea")
    assert result.exit_code == 0, result.stderr
    assert received(own) == [sentence, sentence]
    result = run("stream", WALK, "--to", url, "--format", "nmea", "--duration", "0.1")
    assert result.exit_code == 1
    assert result.stderr.endswith("set its string output, or use --format json\n")


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["--to", "tcp://localhost:1"], 2, "is not udp://HOST:PORT"),
        (["--to", "udp://localhost"], 2, "is not udp://HOST:PORT"),
        (["--to", "lsl", "--format", "json"], 2, "--format is for udp://"),
        (["--to", "udp://nohost.invalid:1"], 1, "cannot resolve nohost.invalid"),
        (["--to", "udp://localhost:1", "--baudrate", "9600"], 2, "--baudrate is for a port"),
    ],
)
def test_wrong_calls(arguments: list[str], status: int, message: str) -> None:
    result = run("stream", WALK, *arguments)
    assert result.exit_code == status
    assert message in result.stderr


def test_a_stream_of_lsl(monkeypatch: pytest.MonkeyPatch) -> None:
    pylsl = pytest.importorskip("pylsl")
    from xbus.cli.lsl_sink import LslSink

    log = xbus.read_log(WALK)
    sink = LslSink("walk", 0x1234)
    outlets: dict[str, Any] = {}
    create = sink._outlet
    monkeypatch.setattr(
        sink, "_outlet", lambda name, column: outlets.setdefault(name, create(name, column))
    )
    sink.write(log)
    info = outlets["acceleration"].get_info()
    assert info.name() == "00001234 acceleration"
    channels = info.desc().child("channels")
    assert channels.child("channel").child_value("label") == "x"
    assert channels.child("channel").child_value("unit") == "m/s2"
    if not (found := pylsl.resolve_byprop("source_id", info.source_id(), timeout=5)):
        pytest.skip("the network of this computer does not resolve streams")
    inlet = pylsl.StreamInlet(found[0])
    inlet.open_stream(timeout=10)
    sink.write(log)
    chunk, stamps = inlet.pull_chunk(timeout=10, max_samples=1000)
    np.testing.assert_array_equal(np.array(chunk, np.float32), log["acceleration"].values)
    np.testing.assert_allclose(np.diff(stamps), np.diff(log["acceleration"].time), atol=1e-6)
    assert pylsl.local_clock() - stamps[-1] < 60
    sink.close()
