"""``xbus stream``: datagrams and LSL."""

from __future__ import annotations

import errno
import json
import math
import socket
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import xbus
from test_cli import WALK, run
from xbus.cli import nmea_stream
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


@pytest.mark.parametrize("block_bytes", [16, 1 << 20])
def test_json_names_coordinates_however_a_log_is_divided(block_bytes: int) -> None:
    samples: list[dict[Any, Any]] = [
        {("velocity_xyz", "ENU"): (1, 2, 3)},
        {("velocity_xyz", "NED"): (4, 5, 6)},
        {("velocity_xyz", "NED"): (7, 8, 9), ("velocity_xyz", "ENU"): (8, 7, -9)},
    ]
    data = b"".join(map(xbus.encode_sample, samples))
    parts = xbus.iter_log(data, block_bytes=block_bytes)
    rows = [row for part in parts for row in sample_dicts(part)]
    found = [{key: row[key] for key in row if key.startswith("velocity")} for row in rows]
    assert found == [
        {"velocity_xyz": {"x": 1, "y": 2, "z": 3, "coordinates": "ENU"}},
        {"velocity_xyz": {"x": 4, "y": 5, "z": 6, "coordinates": "NED"}},
        {
            "velocity_xyz": {"x": 8, "y": 7, "z": -9, "coordinates": "ENU"},
            "velocity_xyz_ned": {"x": 7, "y": 8, "z": 9, "coordinates": "NED"},
        },
    ]


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
    sink = UdpSink(f"udp://127.0.0.1:{port}")
    sink.write(xbus.read_log(WALK))
    sink.close()
    # All of them: the answer to a datagram, that nothing listens, arrives with a later one.
    assert str(sink) == "0 samples sent, 1,040 lost: Connection refused"


def test_a_datagram_that_the_system_does_not_take_is_lost_and_counted(
    receiver: Receiver, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Full:
        def send(self, data: bytes) -> None:
            raise BlockingIOError(errno.EAGAIN, "try again")

    _, url = receiver
    sink = UdpSink(url)
    log = xbus.read_log(WALK)
    sink.write(log)
    with monkeypatch.context() as patch:
        patch.setattr(sink, "_socket", Full())
        sink.write(log)
    sink.close()
    assert str(sink) == "1,040 samples sent, 1,040 lost: try again"


def test_sentences_of_the_device(receiver: Receiver, tmp_path: Any) -> None:
    own, url = receiver
    sentence = xbus.encode_string("HEHDT", {"heading": 12.5})
    path = tmp_path / "strings.mtb"
    path.write_bytes(sentence + xbus.encode_sample({"temperature": 1.0}) + sentence)
    result = run("stream", str(path), "--to", url, "--format", "nmea")
    assert result.exit_code == 0, result.stderr
    assert received(own) == [sentence, sentence]


def nmea_of(*datagrams: bytes) -> list[Any]:
    """The sentences of datagrams, read by pynmeagps; each datagram has one."""
    pynmeagps = pytest.importorskip("pynmeagps")
    return [
        pynmeagps.NMEAReader.parse(datagram, validate=pynmeagps.VALCKSUM) for datagram in datagrams
    ]


def test_sentences_made_from_a_recording_are_those_of_its_file(
    receiver: Receiver, tmp_path: Any
) -> None:
    own, url = receiver
    result = run("stream", WALK, "--to", url, "--format", "nmea", "--speed", "1000000")
    assert result.exit_code == 0, result.stderr
    assert "no strings are sent; sentences are made from MTData2" in result.stderr
    datagrams = received(own)
    xbus.read_log(WALK).to_nmea(tmp_path / "walk.nmea")
    assert b"".join(datagrams) == (tmp_path / "walk.nmea").read_bytes()
    mark, gga, *_ = nmea_of(*datagrams)
    assert mark.text == "made by xbus from MTData2"
    assert gga.identity == "GPGGA"


def test_sentences_made_from_a_device(receiver: Receiver, monkeypatch: pytest.MonkeyPatch) -> None:
    own, url = receiver
    monkeypatch.setattr(nmea_stream, "WAIT", 0.5)
    result = run("stream", "sim:MTi-680G", "--to", url, "--format", "nmea", "--duration", "1.5")
    assert result.exit_code == 0, result.stderr
    found = {message.identity for message in nmea_of(*received(own))}
    # As it is delivered, the device sends neither positions nor UTC.
    assert found == {"GNTXT", "HEHDT"}


def test_nothing_to_make_sentences_from(receiver: Receiver, tmp_path: Any) -> None:
    own, url = receiver
    path = tmp_path / "log.mtb"
    path.write_bytes(xbus.encode_sample({"temperature": 1.0}))
    result = run("stream", str(path), "--to", url, "--format", "nmea")
    assert result.exit_code == 1
    assert "no position or orientation to make sentences from" in result.stderr
    data = [xbus.encode_sample({"euler_angles": [0.0, 0.0, 90.0 * bid]}, bid=bid) for bid in (1, 2)]
    path.write_bytes(b"".join(data))
    result = run("stream", str(path), "--to", url, "--format", "nmea")
    assert result.exit_code == 1
    assert "sentences do not name a device; choose one with --bid: 1, 2" in result.stderr
    received(own)
    result = run("stream", str(path), "--to", url, "--format", "nmea", "--bid", "2")
    assert result.exit_code == 0, result.stderr
    assert [message.headingT for message in nmea_of(*received(own)[1:])] == [270]


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


@pytest.fixture
def lsl() -> Any:
    return pytest.importorskip("pylsl")


def test_what_lsl_says_about_a_stream(lsl: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from xbus.cli.lsl_sink import LslSink

    sink = LslSink("walk", 0x1234)
    outlets: dict[str, Any] = {}
    create = sink._outlet
    monkeypatch.setattr(
        sink,
        "_outlet",
        lambda device, name, column: outlets.setdefault(name, create(device, name, column)),
    )
    sink.write(xbus.read_log(WALK))
    info = outlets["acceleration"].get_info()
    assert info.name() == "00001234 acceleration"
    channel = info.desc().child("channels").child("channel")
    labels, units = [], []
    for _ in range(info.channel_count()):
        labels.append(channel.child_value("label"))
        units.append(channel.child_value("unit"))
        channel = channel.next_sibling()
    assert labels == ["x", "y", "z", "counter"]
    assert units == ["m/s2"] * 3 + [""]
    sink.close()
    assert str(sink) == "1,040 samples sent in 15 streams"


class KeptRows:
    """An outlet of LSL that keeps what it gets."""

    def __init__(self, coordinates: str | None) -> None:
        self.coordinates = coordinates
        self.rows: list[list[float]] = []
        self.stamps: list[float] = []

    def push_chunk(self, rows: list[list[float]], stamps: list[float]) -> None:
        self.rows += rows
        self.stamps += stamps


@pytest.mark.parametrize("block_bytes", [64, 1 << 20])
def test_each_device_and_coordinate_system_has_streams_of_its_own(
    block_bytes: int, lsl: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from xbus.cli.lsl_sink import LslSink

    def sample(at: int, bid: int, system: str) -> bytes:
        time = {"packet_counter": at, "sample_time_fine": 100 * at + 5_000_000 * bid}
        velocity = {("velocity_xyz", system): (at, bid, 0.5)}
        return xbus.encode_sample(time | {"temperature": 10 * bid + at} | velocity, bid=bid)

    identifier = xbus.encode_frame(xbus.MessageId.DeviceID, (0x00B42D4B).to_bytes(4, "big"), bid=1)
    data = identifier + b"".join(
        sample(at, 1, "ENU") + sample(at, 2, "ENU" if at < 6 else "NED") for at in range(10)
    )
    sink = LslSink("bus.mtb", None)
    outlets: dict[str, KeptRows] = {}
    monkeypatch.setattr(
        sink,
        "_outlet",
        lambda device, name, column: outlets.setdefault(
            f"{device} {name}", KeptRows(column.coordinates)
        ),
    )
    for part in xbus.iter_log(data, block_bytes=block_bytes):
        sink.write(part)
    prefixes = {1: "00B42D4B", 2: "bus.mtb BID 2"}
    for bid, prefix in prefixes.items():
        rows = [[10 * bid + at, at] for at in range(10)]
        assert outlets[f"{prefix} temperature"].rows == rows
        first = 10 if bid == 1 else 6
        velocity = outlets[f"{prefix} velocity_xyz"]
        assert velocity.coordinates == "ENU"
        assert velocity.rows == [[at, bid, 0.5, at] for at in range(first)]
    ned = outlets[f"{prefixes[2]} velocity_xyz_ned"]
    assert ned.coordinates == "NED"
    assert ned.rows == [[at, 2, 0.5, at - 6] for at in range(6, 10)]
    assert str(sink) == "20 samples sent in 9 streams"
    if block_bytes > len(data):
        # Each device has a separate clock; the last sample of both is due now.
        ends = [outlets[f"{prefix} temperature"].stamps for prefix in prefixes.values()]
        assert ends[0][-1] == pytest.approx(ends[1][-1], abs=0.1)
        assert np.diff(ends[1]) == pytest.approx([0.01] * 9, abs=1e-6)


#: A receiver: one inlet reads all the time, the other one keeps 100 samples and is read at the end.
RECEIVER = """
import json, sys
import pylsl

found = pylsl.resolve_byprop("source_id", sys.argv[1], timeout=5)
if not found:
    sys.exit("no stream")
fast, slow = pylsl.StreamInlet(found[0]), pylsl.StreamInlet(found[0], max_buflen=1)
for inlet in (fast, slow):
    inlet.open_stream(timeout=10)
print("open", flush=True)
count, rows, stamps = int(input()), [], []
while len(rows) < count:
    more, times = fast.pull_chunk(timeout=10.0, max_samples=1000)
    rows, stamps = rows + more, stamps + times
last = slow.pull_sample(timeout=10.0)[0]
counters = [last[-1]]
while counters[-1] != rows[-1][-1]:
    counters.append(slow.pull_sample(timeout=10.0)[0][-1])
print(json.dumps({"rows": rows, "stamps": stamps, "slow": counters}), flush=True)
"""


def test_a_slow_client_of_lsl_can_count_what_it_loses(lsl: Any) -> None:
    """In another process, by the library that all clients of LSL use."""
    from xbus.cli.lsl_sink import LslSink

    log = xbus.read_log(WALK)
    column = log["acceleration"]
    sink = LslSink("walk", 0x1234)
    sink.write(log)  # so that the streams exist
    receiver = subprocess.Popen(  # noqa: S603
        [sys.executable, "-c", RECEIVER, "xbus-00001234-acceleration"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    with receiver:
        assert receiver.stdin is not None
        assert receiver.stdout is not None
        if receiver.stdout.readline() != "open\n":
            pytest.skip("the network of this computer does not resolve streams")
        sink.write(log)
        print(len(column), file=receiver.stdin, flush=True)
        found = json.loads(receiver.stdout.readline())
    rows, stamps = np.array(found["rows"]), np.array(found["stamps"])
    np.testing.assert_array_equal(rows[:, :3].astype(np.float32), column.values)
    np.testing.assert_array_equal(rows[:, 3], np.arange(len(column)) + len(column))
    np.testing.assert_allclose(np.diff(stamps), np.diff(column.time), atol=1e-6)
    assert lsl.local_clock() - stamps[-1] < 60
    # The slow inlet has lost samples, and the counter says how many.
    slow = np.array([rows[0, 3] - 1, *found["slow"]])
    lost = np.diff(slow) - 1
    assert lost.sum() > 0
    assert len(found["slow"]) + lost.sum() == len(column)
    sink.close()
