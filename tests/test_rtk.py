"""Corrections: RTCM frames to the receiver of a virtual device, and from a caster on this machine.

`LocalCaster` is the caster: it sends what a test requires, and records the requests.
"""

from __future__ import annotations

import base64
import http.server
import socket
import socketserver
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from queue import Queue
from typing import Any

import pynmeagps
import pyrtcm
import pytest
from hypothesis import given
from hypothesis import strategies as st

import xbus
from conftest import AlteredDevice
from streams import frame
from xbus import Device, DeviceError, Scanner, SimulatedDevice, StateError, XbusTimeout, connect
from xbus.device import Sample
from xbus.export.valid import has_fix
from xbus.protocol.ids import MessageId
from xbus.protocol.tables import QUANTITIES
from xbus.rtk import (
    Caster,
    CasterError,
    Fix,
    Forwarder,
    Mountpoint,
    Position,
    read_source_table,
)
from xbus.rtk.forward import MAX_UNANSWERED
from xbus.rtk.rtcm import rtcm_frames
from xbus.sim import serving


def rtcm(payload: bytes) -> bytes:
    """An RTCM 3 frame."""
    body = b"\xd3" + len(payload).to_bytes(2, "big") + payload
    crc: int = pyrtcm.calc_crc24q(body)
    return body + crc.to_bytes(3, "big")


#: A message 1005 as a base station sent it; a proprietary one, with bytes that look like starts; a long one.
STATION = bytes.fromhex("D300133ED7D30202980EDEEF34B4BD62AC0941986F33360B98")
PROPRIETARY = rtcm(bytes.fromhex("FE8001D30013D3D3FAFF24B562"))
LONG = rtcm(bytes.fromhex("FE80") + bytes(range(256)) * 3)
FRAMES = [STATION, PROPRIETARY, LONG]

NMEA = b"$GPGGA,120000.00,5214.3856,N,00650.2794,E,1,09,1.1,45.2,M,42.8,M,,*5E\r\n"
UBX = bytes.fromhex("B5620A0400000E34")
DAMAGED = STATION[:9] + b"\x00" + STATION[10:]
FALSE_START = bytes.fromhex("D30040")
JUNK = [NMEA, UBX, DAMAGED, FALSE_START, b"noise", b"\x00" * 40, frame(0x30)]


def opened(product: str = "MTi-680G", **options: Any) -> tuple[Device, AlteredDevice]:
    sim = AlteredDevice(product, **options)
    device = connect(sim)
    with device.configure():
        pass
    sim.written.clear()
    return device, sim


def replace_answers(sim: AlteredDevice, *answers: bytes | None) -> None:
    """Replaces the next answers to ForwardGnssData; None leaves one as it is."""
    instead = list(answers)
    ack = frame(MessageId.ForwardGnssDataAck)

    def alter(data: bytes) -> bytes:
        if instead and ack in data and (other := instead.pop(0)) is not None:
            return data.replace(ack, other)
        return data

    sim.alter = alter


def payloads(sim: AlteredDevice) -> list[bytes]:
    """Returns the payloads that the receiver was sent."""
    scanner = Scanner()
    found = [*scanner.feed(b"".join(sim.written)), *scanner.close()]
    assert {message.name for message in found if isinstance(message, xbus.Message)} <= {
        "ForwardGnssData"
    }
    return [message.payload for message in found if isinstance(message, xbus.Message)]


# Frames


@pytest.mark.parametrize("size", [1, 2, 3, 7, 100, 10_000])
def test_frames_are_found_in_any_chunks(size: int) -> None:
    data = b"".join(FRAMES)
    chunks = [data[at : at + size] for at in range(0, len(data), size)]
    assert list(rtcm_frames(chunks)) == FRAMES


@given(st.lists(st.sampled_from([*JUNK, *FRAMES])))
def test_nothing_else_is_a_frame(pieces: list[bytes]) -> None:
    assert list(rtcm_frames(pieces)) == [piece for piece in pieces if piece in FRAMES]


def test_a_false_start_loses_no_frame() -> None:
    data = [b"noise", FALSE_START, *FRAMES * 3]
    assert list(rtcm_frames(data)) == FRAMES * 3


def test_chunks_are_read_only_when_needed() -> None:
    asked: list[int] = []

    def chunks() -> Iterator[bytes]:
        for at, chunk in enumerate(FRAMES):
            asked.append(at)
            yield chunk

    found = rtcm_frames(chunks())
    for at in range(len(FRAMES)):
        assert next(found) == FRAMES[at]
        assert asked[-1] == at


# Forwarding


def test_only_rtcm_reaches_the_receiver() -> None:
    device, sim = opened()
    mixed = [frame for piece in JUNK for frame in (piece, *FRAMES)]
    forwarder = device.forward_gnss([*mixed, b"\x00" * 100])
    assert payloads(sim) == FRAMES * len(JUNK)
    assert forwarder.messages == len(FRAMES) * len(JUNK)
    assert forwarder.bytes == sum(map(len, FRAMES)) * len(JUNK)
    assert forwarder.unanswered == 0


def test_the_status_changes_from_none_to_float_to_fixed_and_back() -> None:
    device, _ = opened()
    fix = Fix()
    seen: list[tuple[str | None, str | None]] = []

    def look(seconds: float) -> None:
        until = device.link.clock() + seconds
        while device.link.clock() < until:
            fix.update(device.read_sample())
            if not seen or seen[-1] != (fix.type, fix.rtk):
                seen.append((fix.type, fix.rtk))

    def corrections() -> Iterator[bytes]:
        for _ in range(15):
            look(1)
            yield STATION

    device.forward_gnss(corrections())
    look(15)
    assert seen == [
        ("none", "none"),
        ("yes", "none"),
        ("yes", "float"),
        ("yes", "fixed"),
        ("yes", "none"),
    ]


def test_no_sample_is_lost_while_forwarding() -> None:
    device, _ = opened()
    device.discard()
    before = device.stats
    counters: list[int] = []

    def corrections() -> Iterator[bytes]:
        for at in range(50):
            if at % 2:
                counters.append(device.read_sample()["packet_counter"])
            yield STATION

    device.forward_gnss(corrections())
    counters += [device.read_sample()["packet_counter"] for _ in range(50)]
    assert counters == list(range(counters[0], counters[0] + len(counters)))
    after = device.stats
    assert (after.lost_samples, after.dropped_samples) == (before.lost_samples, 0)


def test_products_without_rtk_are_rejected() -> None:
    device, sim = opened("MTi-670")
    with pytest.raises(StateError, match=r"the MTi-670 does not support ForwardGnssData.*MTi-680G"):
        device.forward_gnss(FRAMES)
    assert sim.written == []


def test_config_state_is_rejected() -> None:
    device, _ = opened()
    with device.configure(), pytest.raises(StateError, match="go_to_measurement"):
        device.forward_gnss(FRAMES)


def test_error_messages_of_the_device_are_raised() -> None:
    device, sim = opened()
    replace_answers(sim, None, frame(MessageId.Error, b"\x21"))
    forwarder = Forwarder(device)
    with pytest.raises(DeviceError) as caught:
        forwarder.forward(FRAMES)
    assert (caught.value.code, caught.value.command) == (33, "ForwardGnssData")
    forwarder.forward([LONG])
    assert payloads(sim) == FRAMES


def test_lost_answers_are_counted_and_silence_is_raised() -> None:
    device, sim = opened()
    replace_answers(sim, *[b""] * (MAX_UNANSWERED - 1), None, *[b""] * (MAX_UNANSWERED - 1))
    forwarder = device.forward_gnss([STATION] * (2 * MAX_UNANSWERED))
    assert forwarder.messages == 2 * MAX_UNANSWERED
    assert forwarder.unanswered == 2 * (MAX_UNANSWERED - 1)
    replace_answers(sim, *[b""] * MAX_UNANSWERED)
    with pytest.raises(XbusTimeout):
        forwarder.forward([STATION] * MAX_UNANSWERED)


# Status


def sample(**values: Any) -> Sample:
    packets = [xbus.encode_packet(name, value) for name, value in values.items()]
    return Sample(b"".join(packets))


def test_the_receiver_reports_more_than_the_status_word() -> None:
    outputs = {"gnss_pvt_data": None, "lat_lon": 4, "altitude_ellipsoid": 4}
    with connect(SimulatedDevice("MTi-680G", trajectory="still")) as device:
        with device.configure(outputs):
            pass
        fix, types, fixes = Fix(), [], []

        def corrections() -> Iterator[bytes]:
            for _ in range(100):
                fix.update(device.read_sample())
                types.append(fix.type)
                fixes.append(fix.rtk)
                yield STATION

        device.forward_gnss(corrections())
    assert list(dict.fromkeys(types)) == ["none", "3D"]
    assert list(dict.fromkeys(fix for fix in fixes if fix)) == ["none", "float", "fixed"]
    at = fix.position
    assert at is not None
    assert (at.lat, at.lon) == pytest.approx((52.23976, 6.83799), abs=1e-3)
    assert at.sep == pytest.approx(xbus.geometry.earth.GEOID_SEPARATION, abs=0.01)
    assert at.satellites
    assert at.hdop


def test_positions_match_the_scaled_column() -> None:
    device = connect(SimulatedDevice("MTi-680G"))
    with device.configure({"gnss_pvt_data": None, "acceleration": 100}):
        pass
    fix, found, frames = Fix(), [], b""
    for received in islice(device, 4000):
        frames += received.frame
        if "gnss_pvt_data" in received:
            fix.update(received)
            if fix.position is not None:
                found.append(fix.position)
    scaled = xbus.read_log(frames)["gnss_pvt_data"].scaled[-len(found) :]
    assert len(found) > 40
    assert [position.lat for position in found] == scaled["lat"].tolist()
    assert [position.lon for position in found] == scaled["lon"].tolist()
    assert [position.alt for position in found] == scaled["hMSL"].tolist()
    assert [position.hdop for position in found] == scaled["hdop"].tolist()


def test_the_filter_position_is_used_without_a_receiver() -> None:
    fix = Fix()
    fix.update(sample(lat_lon=(52.5, 6.5), altitude_ellipsoid=80.0))
    assert fix.position == Position(52.5, 6.5, 80.0)
    assert fix.is_valid
    fix.update(sample(lat_lon=(1.0, 1.0), status_word=0x0))
    fix.update(sample(lat_lon=(1.0, 1.0), status_word=0x4))  # a fix, and the filter is not valid
    assert not fix.is_valid
    for place in ((float("nan"), 1.0), (91.0, 1.0), (0.0, 0.0)):
        fix.update(sample(lat_lon=place, status_word=0x6))
    assert (fix.position.lat, fix.type, fix.rtk) == (52.5, "yes", "none")
    fix.update(sample(lat_lon=(1.0, 1.0), status_word=0x6))
    assert fix.position.lat == 1.0
    fix.update(sample(status_word=0x1800_0004))
    assert fix.rtk == "3"


@pytest.mark.parametrize("kind", range(7))
@pytest.mark.parametrize("flags", [0x00, 0x01, 0x82, 0x83])
def test_a_position_is_valid_as_in_the_exports(kind: int, flags: int) -> None:
    """The type of fix alone is not enough: the receiver must mark the position as good."""
    pvt = {field.name: 0 for field in QUANTITIES["gnss_pvt_data"].fields}
    pvt |= {"fixtype": kind, "flags": flags, "lat": 520_000_000, "lon": 60_000_000}
    is_valid = kind in (2, 3, 4) and flags & 1 == 1
    fix = Fix()
    fix.update({"gnss_pvt_data": pvt})
    assert (fix.is_valid, fix.position is not None) == (is_valid, is_valid)
    block = xbus.read_log(xbus.encode_sample({"gnss_pvt_data": pvt}))
    assert has_fix(block["gnss_pvt_data"].values).tolist() == [is_valid]
    from_block = Fix()
    from_block.update_from_block(block)
    assert from_block.position == fix.position


# The caster


class LocalCaster(socketserver.ThreadingTCPServer):
    """An NTRIP caster with one mountpoint, BASE.

    Attributes:
        style: 1 for ICY, 2 for HTTP, "chunked" for HTTP in chunks, "garbage" for neither, "silent" to
            disconnect without an answer, "reset" to reset the connection without an answer, "table" to
            answer every request with the source table.
        account: Required user and password, or None.
        sends: Data that each connection receives in turn, repeated; `PAUSE` is the pause between two.
        once: Whether to disconnect when each was sent a few times.
        requests: The requests, as text.
        gga: Positions received after the request.
        asked: Number of connections.
    """

    allow_reuse_address = True
    daemon_threads = True
    PAUSE = 0.05

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Visit)
        self.style: int | str = 2
        self.account: tuple[str, str] | None = None
        self.sends = list(FRAMES)
        self.once = False
        self.requests: list[str] = []
        self.gga: Queue[bytes] = Queue()
        self.done = threading.Event()

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self.server_address[1]}"


TABLE = (
    b"CAS;caster.example;2101;Example;Nobody;0;NLD;52.2;6.8;0.0.0.0;0;misc\r\n"
    b"NET;EXAMPLE;Nobody;N;N;none;none;none;none\r\n"
    b"STR;BASE;Enschede;RTCM 3.2;1005(1),1077(1);2;GPS+GLO;NONE;NLD;52.24;6.85;1;0;none;none;N;N;0;\r\n"
    b"STR;OTHER;;RTCM 3.3;;;;;;nan;north\r\n"
    b"ENDSOURCETABLE\r\n"
)


class _Visit(socketserver.StreamRequestHandler):
    server: LocalCaster

    def handle(self) -> None:
        caster = self.server
        request = b"".join(iter(self.rfile.readline, b"\r\n")).decode()
        caster.requests.append(request)
        if caster.style == "silent":
            return
        if caster.style == "reset":
            at_once = struct.pack("ii", 1, 0)
            self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, at_once)
            return
        if caster.style == "garbage":
            self.wfile.write(b"SSH-2.0-OpenSSH_9.2p1 Debian\r\n")
            return
        http = caster.style not in (1, "table")
        if caster.account is not None:
            credentials = base64.b64encode(":".join(caster.account).encode()).decode()
            if f"Authorization: Basic {credentials}\r\n" not in request:
                self.wfile.write(b"HTTP/1.1 401 Unauthorized\r\nConnection: close\r\n\r\n")
                return
        if request.startswith("GET / ") or caster.style == "table":
            self._table(http)
            return
        if not request.startswith("GET /BASE "):
            self._refuse(http)
            return
        self.wfile.write(self._head(http))
        self._stream()

    def _refuse(self, http: bool) -> None:
        if http:
            self.wfile.write(b"HTTP/1.1 404 Not Found\r\nConnection: close\r\n\r\n")
        else:
            self._table(http)

    def _table(self, http: bool) -> None:
        """The source table; some casters keep the connection open after it."""
        head = b"HTTP/1.1 200 OK" if http else b"SOURCETABLE 200 OK"
        kind = b"gnss/sourcetable" if http else b"text/plain"
        self.wfile.write(b"%b\r\nContent-Type: %b\r\n\r\n" % (head, kind) + TABLE)
        if http:
            self.server.done.wait(20)

    def _head(self, http: bool) -> bytes:
        if not http:
            return b"ICY 200 OK\r\n\r\n"
        more = b"Transfer-Encoding: chunked\r\n" if self.server.style == "chunked" else b""
        return b"HTTP/1.1 200 OK\r\nContent-Type: gnss/data\r\n" + more + b"\r\n"

    def _stream(self) -> None:
        caster, lines = self.server, b""
        self.connection.settimeout(caster.PAUSE)
        left = 4 if caster.once else 1 << 30
        while left and not caster.done.is_set():
            for data in caster.sends:
                try:
                    received = self.connection.recv(1000)
                except TimeoutError:
                    received = None
                except ConnectionError:
                    return
                if received == b"":
                    return
                lines += received or b""
                *whole, lines = lines.split(b"\r\n")
                for chunk in whole:
                    caster.gga.put(chunk + b"\r\n")
                if caster.style == "chunked":
                    data = b"%x\r\n%b\r\n" % (len(data), data)
                try:
                    self.wfile.write(data)
                except OSError:
                    return
            left -= 1
            if not caster.sends and caster.done.wait(caster.PAUSE):
                return


@contextmanager
def serving_caster() -> Iterator[LocalCaster]:
    with LocalCaster() as caster:
        thread = threading.Thread(target=caster.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield caster
        finally:
            caster.done.set()
            caster.shutdown()
            thread.join()


@pytest.fixture
def local() -> Iterator[LocalCaster]:
    with serving_caster() as caster:
        yield caster


@pytest.mark.parametrize("style", [1, 2, "chunked"])
@pytest.mark.parametrize("ntrip", [1, 2])
def test_frames_arrive_from_both_kinds_of_caster(
    local: LocalCaster, style: int | str, ntrip: int
) -> None:
    local.style = style
    local.sends = [NMEA, STATION, b"\x00" * 9, UBX, PROPRIETARY]
    with Caster(local.address, "BASE", ntrip=ntrip) as caster:
        assert caster.state == "idle"
        found = [received for received, _ in zip(caster, range(6), strict=False)]
        assert caster.state == "streaming"
    assert set(found) == {STATION, PROPRIETARY}
    assert len(local.requests) == 1
    assert ("Ntrip-Version: Ntrip/2.0" in local.requests[0]) == (ntrip == 2)


def test_user_and_password(local: LocalCaster) -> None:
    local.account = ("me", "secret")
    with Caster(local.address, "BASE", user="me", password="secret") as caster:  # noqa: S106
        assert next(iter(caster)) in FRAMES
    with (
        Caster(f"http://{local.address}/", "BASE", user="me") as caster,
        pytest.raises(CasterError, match="does not let that user in"),
    ):
        caster.read(10)


def problem(address: str, mountpoint: str = "BASE", **options: Any) -> str:
    """Returns the error of a caster that sends no corrections, without its address."""
    with Caster(address, mountpoint, **options) as caster, pytest.raises(CasterError) as caught:
        caster.read(10)
    return str(caught.value).replace(address, "CASTER")


def test_casters_that_send_no_corrections(local: LocalCaster) -> None:
    """A wrong mountpoint, a source table, no answer, another server: each has a distinct error."""
    found = {"mountpoint": problem(local.address, "NOWHERE")}
    for style in (1, "table", "silent", "reset", "garbage"):
        local.style = style
        found[str(style)] = problem(local.address, "NOWHERE" if style == 1 else "BASE")
    assert found == {
        "mountpoint": "CASTER has no mountpoint NOWHERE; xbus ntrip --list prints those that it has",
        "1": "CASTER has no mountpoint NOWHERE; it has BASE, OTHER",
        "table": (
            "CASTER lists BASE, but answers with its source table instead of corrections; the base station"
            " may be off, or the account may not include it"
        ),
        "silent": (
            "CASTER hangs up without an answer; check the port, and whether the address needs https://"
        ),
        "reset": (
            "CASTER hangs up without an answer; check the port, and whether the address needs https://"
        ),
        "garbage": "the server at CASTER is not an NTRIP caster",
    }


@pytest.mark.parametrize("sends", [[], [STATION]])
def test_a_caster_that_disconnects_after_its_answer(local: LocalCaster, sends: list[bytes]) -> None:
    local.once, local.sends = True, sends
    start = time.monotonic()
    with Caster(local.address, "BASE") as caster:
        while caster.state != "lost":
            caster.read(0.05)
        before = "" if sends else " before the first correction"
        assert caster.problem == f"{local.address} has hung up{before}"
    assert time.monotonic() - start < 15


def test_no_caster_at_the_address(local: LocalCaster) -> None:
    with serving_caster() as gone:
        address = gone.address
    with Caster(address, "BASE") as caster, pytest.raises(CasterError) as caught:
        caster.read(10)
    assert str(caught.value) == f"cannot reach {address}: Connection refused"
    with Caster("no.such.host.invalid", "BASE") as caster, pytest.raises(CasterError) as caught:
        caster.read(30)
    assert str(caught.value).startswith("cannot reach no.such.host.invalid:2101: ")


def test_positions_are_sent(local: LocalCaster) -> None:
    there = [Position(52.25, -6.5, 45.2, 42.8, 9, 1.1)]
    places: list[Position] = []
    with Caster(
        local.address, "BASE", gga=1, position=lambda: places[0] if places else None
    ) as caster:
        assert caster.read(0.2) == b""
        assert caster.state == "no position"
        assert local.requests == []
        places += there
        for frame_, _ in zip(caster, range(12), strict=False):
            assert frame_ in FRAMES
        found = pynmeagps.NMEAReader.parse(local.gga.get(timeout=10))
        assert found.identity == "GPGGA"
        assert (found.lat, found.lon, found.alt, found.sep) == (52.25, -6.5, 45.2, 42.8)
        assert (found.numSV, found.HDOP) == (9, 1.1)
        assert caster.gga_sent > 0
    assert "Ntrip-GGA: $GPGGA," in local.requests[0]


#: The longest values of every field, and usual values with rounding errors of binary arithmetic.
EXTREMES = [
    Position(-89.999999999, -179.999999999, -1234.5678, -106.98765, 99, 99.99),
    Position(52.1, 6.1, 12345.6789, 42.800000000000004, 12, 1.1500000000000001),
    Position(0.0, 0.0, 0.0, 0.0, 250, 655.35),
]


def sentence_of(local: LocalCaster, position: Position) -> str:
    """The GGA that a caster gets for a position."""
    with Caster(local.address, "BASE", gga=1, position=lambda: position) as caster:
        next(iter(caster))
        return local.gga.get(timeout=10).decode()


@pytest.mark.parametrize("position", EXTREMES)
def test_a_gga_sentence_has_at_most_82_characters(local: LocalCaster, position: Position) -> None:
    sentence = sentence_of(local, position)
    assert len(sentence) <= 82
    found = pynmeagps.NMEAReader.parse(sentence.encode())
    assert found.lat == pytest.approx(position.lat, abs=2e-7)
    assert found.lon == pytest.approx(position.lon, abs=2e-7)
    assert found.alt == pytest.approx(position.alt, abs=0.0051)
    assert found.sep == pytest.approx(position.sep, abs=0.051)
    assert all(len(field.partition(".")[2]) <= 2 for field in sentence.split(",")[7:11])


def test_impossible_heights_do_not_lengthen_the_sentence(local: LocalCaster) -> None:
    sentence = sentence_of(local, Position(-89.99, -179.99, -2147483.648, -4294967.3, 99, 655.35))
    assert len(sentence) <= 82


def test_missing_values_are_empty_in_the_sentence(local: LocalCaster) -> None:
    fields = sentence_of(local, Position(52.25, -6.5, 45.2)).split(",")
    assert fields[7:14] == ["", "", "45.2", "M", "0.0", "M", ""]
    assert fields[14].startswith("*")


def test_a_lost_connection_is_reopened(local: LocalCaster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("xbus.rtk.caster.FIRST_PAUSE", 0.01)
    local.once = True
    local.sends = [STATION]
    states = set()
    with Caster(local.address, "BASE") as caster:
        while len(local.requests) < 3:
            caster.read(0.05)
            states.add((caster.state, caster.problem is not None))
    assert {("streaming", False), ("connecting", True)} <= states


def test_a_silent_connection_is_reopened(
    local: LocalCaster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("xbus.rtk.caster.TIMEOUT", 0.1)
    monkeypatch.setattr("xbus.rtk.caster.FIRST_PAUSE", 0.01)
    local.sends = []
    with Caster(local.address, "BASE") as caster:
        while len(local.requests) < 3:
            assert caster.read(0.05) == b""
        local.sends = [STATION]
        assert next(iter(caster)) == STATION


def test_pauses_double(local: LocalCaster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("xbus.rtk.caster.FIRST_PAUSE", 0.01)
    with Caster(local.address, "BASE") as caster:
        assert next(iter(caster)) in FRAMES
        local.account = ("nobody", "knows")
        local.done.set()
        pauses: list[float] = []
        while len(pauses) < 4:
            caster.read(0.01)
            if caster._pause not in pauses:
                pauses.append(caster._pause)
        assert pauses == [0.01, 0.02, 0.04, 0.08]
        assert caster.problem is not None
        local.done.clear()
        local.account = None
        assert next(iter(caster)) in FRAMES
        assert caster._pause == 0.01


def test_endless_junk_counts_as_silence(
    local: LocalCaster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("xbus.rtk.caster.NO_CORRECTION_TIMEOUT", 0.5)
    local.sends = [b"noise" * 20]
    with Caster(local.address, "BASE") as caster:
        while caster.state != "lost":
            caster.read(0.05)


def test_from_a_caster_to_a_device(local: LocalCaster) -> None:
    device, sim = opened()
    local.sends = FRAMES
    with Caster(local.address, "BASE") as caster:
        chunks = (received for received, _ in zip(caster, range(5), strict=False))
        assert device.forward_gnss(chunks).messages == 5
    assert set(payloads(sim)) <= set(FRAMES)


def test_close_ends_a_read_in_another_thread(local: LocalCaster) -> None:
    local.sends = []
    with Caster(local.address, "BASE") as caster:
        found: list[bytes] = []
        thread = threading.Thread(target=lambda: found.extend(caster))
        thread.start()
        while not local.requests:
            thread.join(0.01)
    thread.join(5)
    assert not thread.is_alive()
    assert found == []
    assert caster.read(1) == b""


# The source table


@pytest.mark.parametrize("style", [1, 2])
def test_the_source_table(local: LocalCaster, style: int) -> None:
    local.style = style
    local.account = ("me", "secret")
    table = read_source_table(local.address, user="me", password="secret")  # noqa: S106
    assert table == [
        Mountpoint(
            "BASE", "Enschede", "RTCM 3.2", "1005(1),1077(1)", "GPS+GLO", "NLD", 52.24, 6.85, True
        ),
        Mountpoint("OTHER", "", "RTCM 3.3", "", "", "", None, None, False),
    ]
    with pytest.raises(CasterError, match="does not let that user in"):
        read_source_table(local.address)


@pytest.mark.parametrize(
    ("style", "message"),
    [("silent", "hangs up"), ("reset", "hangs up"), ("garbage", "is not an NTRIP caster")],
)
def test_a_missing_source_table_is_an_error(local: LocalCaster, style: str, message: str) -> None:
    local.style = style
    with pytest.raises(CasterError, match=message):
        read_source_table(local.address)


def test_a_web_server_has_no_source_table() -> None:
    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            with pytest.raises(CasterError, match="is not an NTRIP caster"):
                read_source_table(f"127.0.0.1:{server.server_address[1]}")
        finally:
            server.shutdown()
            thread.join()


def test_no_caster_for_a_source_table() -> None:
    with serving_caster() as gone:
        address = gone.address
    with pytest.raises(CasterError, match=f"cannot reach {address}: Connection refused"):
        read_source_table(address)


@pytest.mark.parametrize("text", ["a\r\nHost: b", "a\n", "\ra", "a\x00"])
@pytest.mark.parametrize("name", ["url", "mountpoint", "user", "password"])
def test_line_breaks_are_rejected(name: str, text: str) -> None:
    arguments: dict[str, Any] = {"url": "caster.example", "mountpoint": "BASE", name: text}
    with pytest.raises(ValueError, match="has a line break or another control character"):
        Caster(**arguments)
    if name != "mountpoint":
        arguments.pop("mountpoint")
        with pytest.raises(ValueError, match="has a line break or another control character"):
            read_source_table(**arguments)


def test_a_mountpoint_has_no_spaces() -> None:
    with pytest.raises(ValueError, match="it has a space"):
        Caster("caster.example", "A HTTP/1.1")


def test_a_password_in_an_address_is_neither_used_nor_shown() -> None:
    with pytest.raises(ValueError, match="give user name and password separately") as failed:
        Caster("http://me:secret@caster.example", "BASE")
    assert "secret" not in str(failed.value)


@pytest.mark.parametrize(
    "url", ["", "http://", "ftp://host", "host:port", "host/BASE", "host:99999"]
)
def test_invalid_addresses_are_rejected(url: str) -> None:
    with pytest.raises(ValueError, match="is not the address of a caster"):
        Caster(url, "BASE")


@pytest.mark.parametrize(
    ("url", "host"),
    [("a.b", "a.b:2101"), ("a:80", "a:80"), ("http://a/", "a:2101"), ("https://a", "a:443")],
)
def test_addresses(url: str, host: str) -> None:
    assert Caster(url, "BASE").host == host


def test_pygnssutils_loggers_are_silent(
    local: LocalCaster, capfd: pytest.CaptureFixture[str]
) -> None:
    local.account = ("me", "secret")
    with Caster(local.address, "BASE") as caster, pytest.raises(CasterError):
        caster.read(10)
    assert capfd.readouterr() == ("", "")


def test_samples_are_read_in_another_thread(local: LocalCaster) -> None:
    device = SimulatedDevice("MTi-680G")
    with (
        serving(device) as port,
        connect(port) as connected,
        Caster(local.address, "BASE") as caster,
    ):
        thread = threading.Thread(target=connected.forward_gnss, args=(caster,))
        thread.start()
        counters = [connected.read_sample()["packet_counter"] for _ in range(100)]
        caster.close()
        thread.join(5)
        assert not thread.is_alive()
    assert counters == list(range(counters[0], counters[0] + 100))
