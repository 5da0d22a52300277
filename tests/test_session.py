"""The session: what it sends, how it handles received bytes, and its state. No port, no clock."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import xbus
from conftest import clock_streams, exchanges, shared
from xbus import (
    DecodeError,
    DeviceError,
    Sample,
    Session,
    StateError,
    _core,
    encode_frame,
    encode_sample,
)
from xbus.device.channel import Channel
from xbus.device.events import Notice, Refusal, Reply, SessionEvent
from xbus.protocol import (
    Alignment,
    AlignmentRotation,
    FilterProfile,
    HardwareVersion,
    IccCommand,
    IccReply,
    IccResult,
    IccStatus,
    LatLonAlt,
    OptionFlag,
    OptionFlags,
    Output,
    PortConfig,
    ResetCode,
    Selftest,
    State,
    StringOutput,
    StringType,
)
from xbus.protocol.products import support
from xbus.protocol.tables import MESSAGES, QUANTITIES
from xbus.wire.codec import LONGEST_LIVE, ScannedItem

REQUESTS = [row for row in MESSAGES.values() if row.direction == "to device"]
ANSWERED = [row for row in REQUESTS if row.reply is not None]
#: Of these, the ones whose reply has a known length.
KNOWN = [
    request
    for request in ANSWERED
    if all(row.lengths is not None for row in MESSAGES.values() if row.mid == request.reply)
]
EXCHANGES = exchanges()
SAMPLE = encode_sample({"packet_counter": 7, "acceleration": [0, 0, 9.81]})


class SessionOfItems(Session):
    """A session of a program that scans the stream itself: `handle` has all that arrives."""

    def __init__(self, *, bid: int = 0xFF) -> None:
        super().__init__(bid=bid)
        self._own = _core.Scanner(LONGEST_LIVE, 0)

    def receive(self, data: bytes) -> list[SessionEvent]:
        return self._handled(self._own.feed(data, last=False))

    def quiet(self) -> list[SessionEvent]:
        return self._handled(self._own.feed(b"", last=True))

    def _handled(self, items: list[ScannedItem]) -> list[SessionEvent]:
        return [event for item in items if (event := self.handle(item)) is not None]


class SessionOfChannel(Session):
    """A session behind a channel: `handle` has the messages, and the samples wait in the acquisition."""

    def __init__(self, *, bid: int = 0xFF) -> None:
        super().__init__(bid=bid)
        self._acquisition = _core.Acquisition(None, bid=bid, epoch=0)
        link: Any = SimpleNamespace(acquisition=self._acquisition, trouble=None, refusal=None)
        self._channel = Channel(link)
        self._channel.session = self
        self._found: list[tuple[int, SessionEvent]] = []

    def handle(self, item: ScannedItem) -> SessionEvent | None:
        event = super().handle(item)
        if event is not None:
            self._found.append((item.offset, event))
        return event

    def receive(self, data: bytes) -> list[SessionEvent]:
        self._acquisition.push(data, 0.0)
        return self._events_in_order()

    def quiet(self) -> list[SessionEvent]:
        self._acquisition.interrupt()
        return self._events_in_order()

    def _events_in_order(self) -> list[SessionEvent]:
        self._channel.handle_events()
        found, self._found = self._found, []
        while (received := self._acquisition.take_sample()) is not None:
            found.append((received.offset, Sample.of(received)))
        return [event for _, event in sorted(found, key=lambda item: item[0])]


#: What hands the received bytes to a session.
ENTRIES = [Session, SessionOfItems, SessionOfChannel]


def idle_session(state: State = State.CONFIG, product: str | None = None) -> Session:
    """Returns a session that receives nothing."""
    return prepared(Session(), state, product)


def prepared(host: Session, state: State, product: str | None) -> Session:
    host.state = state
    host.identify(None if product is None else support(product))
    return host


NewSession: TypeAlias = Callable[..., Session]


@pytest.fixture(params=ENTRIES)
def session(request: pytest.FixtureRequest) -> NewSession:
    """Makes sessions with one of the entry points."""

    def new(state: State = State.CONFIG, product: str | None = None, bid: int = 0xFF) -> Session:
        return prepared(request.param(bid=bid), state, product)

    return new


def value_for(name: str) -> Any:
    """Returns a valid value of the message."""
    values = {
        "SetPeriod": 1152, "SetBaudrate": 0x02, "SetNoRotation": 6, "SetSyncSettings": (), "SetUTCTime":
        xbus.protocol.UtcTime(0, 2026, 11, 22, 9, 30, 0), "SetOptionFlags": OptionFlags(),
        "SetFilterProfile": 39, "SetFilterProfileModern": "General", "SetGnssLeverArm":
        xbus.protocol.GnssLeverArm(0, 0, 1), "SetLatLonAlt": LatLonAlt(52, 6, 0), "SetLocationID": 1,
        "SetExtOutputMode": 0, "SetPortConfig": (PortConfig.from_word(0x10002),) * 3,
        "SetStringOutputType": StringOutput(StringType(0)), "ReqEmts": b"\x00\xff",
        "SetAlignmentRotation": AlignmentRotation(Alignment.ROT_LOCAL, (1, 0, 0, 0)),
        "SetGnssReceiverSettings": xbus.protocol.GnssReceiverSettings(3, 2, 4), "SetTransmitDelay": 590,
        "SetCanConfig": xbus.protocol.CanConfig(0), "SetCanOutputConfig": (), "SetOutputConfiguration": (),
        "ForwardGnssData": b"\xd3", "SetProcessingFlags": 0, "SetGravityMagnitude": 9.8, "SetHeading": 0,
        "SetAmd": 0, "ResetOrientation": 1, "AdjustUTCTime": 1, "SetGnssPlatform": 0, "SetOutputMode": 2,
        "SetOutputSettings": 0, "SetOutputSkipFactor": 0, "SetInitialHeading": 0, "SetErrorMode": 1,
        "SetTransmitDelayAck": 590, "IccCommand": 3, "ReqAlignmentRotation": 0,
    }  # fmt: skip
    if name in values:
        return values[name]
    return None if MESSAGES[name].kind == "empty" else b"\0" * min(MESSAGES[name].lengths or (1,))


# Exchanges

#: MT Manager pads a name with spaces, and then with uninitialized memory.
FILLED_UP = "FA FF 64 41"


@pytest.mark.parametrize("product", EXCHANGES)
def test_published_exchanges(session: NewSession, product: str) -> None:
    """The session sends the same bytes, and accepts replies in any pieces and with samples in between."""
    host = session(State.CONFIG, product)
    lines = EXCHANGES[product]
    for sent, came in zip(lines[::2], lines[1::2], strict=True):
        request, answer = bytes.fromhex(sent), bytes.fromhex(came)
        name = command_of(request, product)
        value = xbus.protocol.decode(name, request[4:-1])
        if not sent.startswith(FILLED_UP):
            assert host.request(name, value) == request
            assert_answered(host, name, answer)
        for cut in range(len(answer)):
            other = session(State(MESSAGES[name].states[0]), product)
            other.request(name, value)
            assert_answered(other, name, answer, cut)


def command_of(request: bytes, product: str) -> str:
    """Returns the command of a frame, among those that the product supports."""
    known = support(product).messages
    length = len(request) - 5
    rows = [row for row in REQUESTS if row.mid == request[2] and row.name in known]
    return next((row.name for row in rows if length in (row.lengths or ())), rows[-1].name)


def assert_answered(host: Session, command: str, answer: bytes, cut: int = 0) -> Reply:
    """Asserts that a reply in two pieces, with samples before and after, is accepted."""
    assert host.pending == command
    events = host.receive(SAMPLE + answer[:cut])
    events += host.receive(answer[cut:] + SAMPLE)
    (reply,) = (event for event in events if isinstance(event, Reply))
    assert (reply.command, reply.payload) == (command, answer[4:-1])
    assert (reply.value is None) == (not reply.payload)
    assert sum(isinstance(event, Sample) for event in events) == 2
    assert host.pending is None
    return reply


# Other published replies of devices: command, value, frame, reply, decoded value.
ANSWERS: list[tuple[str, Any, str, str, Any]] = [
    ("IccCommand", IccCommand.STOP, "FA FF 74 01 01 8B", "FA FF 75 07 01 40 80 3A 85 02 00 03",
     IccReply(IccCommand.STOP, IccResult(4.007143497467041, 2, IccStatus(0)))),
    ("SetOptionFlags", OptionFlags(OptionFlag.DISABLE_AUTO_STORE, OptionFlag.DISABLE_AUTO_MEASUREMENT),
     "FA FF 48 08 00 00 00 01 00 00 00 02 AE", "FA FF 49 00 B8", None),
    ("SetNoRotation", 6, "FA FF 22 02 00 06 D7", "FA FF 23 00 DE", None),
    ("ResetOrientation", ResetCode.ALIGNMENT, "FA FF A4 02 00 04 57", "FA FF A5 00 5C", None),
    ("RunSelftest", None, "FA FF 24 00 DD", "FA FF 25 02 01 FF DA", Selftest(0x1FF)),
    ("ReqHardwareVersion", None, "FA FF 1E 00 E3", "FA FF 1F 02 02 00 DE", HardwareVersion(2, 0)),
    ("ReqOptionFlags", None, "FA FF 48 00 B9", "FA FF 49 04 00 00 00 10 A4", OptionFlag.ENABLE_AHS),
    # The payload of a reply to a setting is decoded like the reply to the request.
    ("SetOptionFlags", OptionFlags(OptionFlag.ENABLE_AHS), "FA FF 48 08 00 00 00 10 00 00 00 00 A1",
     "FA FF 49 04 00 00 00 10 A4", OptionFlag.ENABLE_AHS),
    ("ReqFilterProfile", None, "FA FF 64 00 9D", "FA FF 65 02 0F 27 64", FilterProfile(15, 39)),
    ("ReqFilterProfile", None, "FA FF 64 00 9D",
     "FA FF 65 0A 52 6F 62 75 73 74 2F 56 52 55 E7", "Robust/VRU"),
]  # fmt: skip


@pytest.mark.parametrize(("command", "value", "sent", "came", "expected"), ANSWERS)
def test_answers(
    session: NewSession, command: str, value: Any, sent: str, came: str, expected: Any
) -> None:
    answer = bytes.fromhex(came)
    for cut in range(len(answer)):
        host = session(State.CONFIG if "config" in MESSAGES[command].states else State.MEASUREMENT)
        assert host.request(command, value) == bytes.fromhex(sent)
        assert assert_answered(host, command, answer, cut).value == expected


# States


@pytest.mark.parametrize("state", list(State))
@pytest.mark.parametrize("row", REQUESTS, ids=lambda host: host.name)
def test_commands_are_sent_only_in_their_states(
    row: xbus.protocol.tables.MessageRow, state: State
) -> None:
    host = idle_session(state)
    allowed = state in row.states or row.name in ("GoToConfig", "Reset")
    allowed |= (state, row.name) == (State.UNKNOWN, "ReqDID")
    if allowed:
        frame = host.request(row.name, value_for(row.name))
        assert frame[2] == row.mid
        assert host.pending == (None if row.reply is None else row.name)
    else:
        with pytest.raises(StateError, match=f"{row.name} is valid in") as caught:
            host.request(row.name, value_for(row.name))
        assert (caught.value.command, caught.value.state) == (row.name, state)
        assert host.pending is None


# state, received message, new state
CHANGES = [
    (State.UNKNOWN, SAMPLE, State.MEASUREMENT),
    (State.WAKEUP, SAMPLE, State.MEASUREMENT),
    (State.CONFIG, SAMPLE, State.CONFIG),
    (State.MEASUREMENT, SAMPLE, State.MEASUREMENT),
    *((state, encode_frame(0x3E), State.WAKEUP) for state in State),
    *((state, encode_frame(0x31), State.CONFIG) for state in State),
    *((state, encode_frame(0x11), State.MEASUREMENT) for state in State),
    *((state, encode_frame(0x41), State.UNKNOWN) for state in State),
    (State.UNKNOWN, encode_frame(0x43, b"\0\0\1\x91no fix"), State.UNKNOWN),
]


@pytest.mark.parametrize(("before", "comes", "after"), CHANGES)
def test_received_messages_change_the_state(
    session: NewSession, before: State, comes: bytes, after: State
) -> None:
    host = session(before)
    host.receive(comes)
    assert host.state == after


def test_wake_up_is_answered_once_and_leads_to_config(session: NewSession) -> None:
    host = session(State.UNKNOWN)
    assert host.receive(encode_frame(0x3E)) == [Notice("WakeUp", None, b"", 0xFF, 0x3E)]
    assert host.request("WakeUpAck") == bytes.fromhex("FA FF 3F 00 C2")
    assert (host.state, host.pending) == (State.CONFIG, None)


@pytest.mark.parametrize(
    ("came", "state"),
    [("FA FF 01 04 03 60 08 A6 EB", State.CONFIG), ("FA FF 42 01 04 BA", State.MEASUREMENT)],
)
def test_the_reply_to_req_did_shows_the_state(session: NewSession, came: str, state: State) -> None:
    host = session(State.UNKNOWN)
    host.request("ReqDID")
    host.receive(bytes.fromhex(came))
    assert host.state == state


@pytest.mark.parametrize("row", ANSWERED, ids=lambda host: host.name)
def test_an_abandoned_command_leaves_a_correct_state(
    session: NewSession,
    row: xbus.protocol.tables.MessageRow,
) -> None:
    state = State(row.states[0])
    host = session(state)
    host.request(row.name, value_for(row.name))
    host.abandon()
    changes = row.name in ("GoToConfig", "GoToMeasurement", "Reset")
    assert (host.pending, host.state) == (None, State.UNKNOWN if changes else state)
    host.request("GoToConfig")
    host.receive(encode_frame(0x31))
    assert host.state == State.CONFIG


def test_one_command_at_a_time() -> None:
    host = idle_session()
    host.request("ReqDID")
    with pytest.raises(StateError, match="ReqDID is not answered yet"):
        host.request("ReqFWRev")


# Products


def test_unknown_commands_are_rejected() -> None:
    for name in ("DeviceID", "MTData2", "SetNothing"):
        with pytest.raises(ValueError, match="there is no command"):
            idle_session().request(name)


# product, command, value, error message
REFUSED: list[tuple[str, str, Any, str]] = [
    ("MTi-1", "SetOutputConfiguration", [Output(0x2010, 100)], "the MTi-1 has no output quaternion"),
    ("MTi-3", "SetOutputConfiguration", [Output(0x4020, 400)],
     "cannot send acceleration at 400 Hz; the nearest rate is 100"),
    ("MTi-630", "SetOutputConfiguration", [Output(0x4020, 150)],
     "the nearest rates are 100 and 200 Hz"),
    ("MTi-630", "SetOutputConfiguration", [Output(0x9990, 100)], "no output 0x9990"),
    ("MTi-630", "SetOutputConfiguration", [Output(0x4020, 1)] * 33, "33 entries, and the message holds 32"),
    ("MTi-630", "SetOptionFlags", OptionFlags(OptionFlag.ENABLE_BEIDOU), "no option flag ENABLE_BEIDOU"),
    ("MTi-3", "SetSyncSettings", [xbus.protocol.SyncSetting(3, 2)], "no sync function"),
    ("MTi-630", "SetSyncSettings", [xbus.protocol.SyncSetting(8, 7)], "SEND_LATEST on IN1, IN2, SOFTWARE"),
    ("MTi-300", "SetFilterProfile", 50, "no filter profile 50; it has 39 general"),
    ("MTi-620", "SetFilterProfileModern", "Robust/NorthReference", "no filter profile 'NorthReference'"),
    ("MTi-300", "SetBaudrate", 0x0D, "does not support 4000000 baud"),
    ("MTi-300", "SetStringOutputType", StringOutput(StringType.GPGGA), "no string GPGGA"),
    ("MTi-300", "SetStringOutputType", StringOutput(StringType.HEHDT, 10), "takes the rate by SetPeriod"),
    ("MTi-630", "SetStringOutputType", StringOutput(StringType.HEHDT), "takes the rate with the types"),
    ("MTi-630", "SetOutputConfiguration", [Output(0x201C, 100)], "0x201C: the coordinate bits of quaternion"),
    ("MTi-630", "SetNoRotation", 0, "the duration must be from 1 to 65535 s"),
    ("MTi-630", "ResetOrientation", 2, "2 is not one of STORE 0, HEADING 1"),
    ("MTi-630", "SetCanConfig", xbus.protocol.CanConfig(0x55), "no CAN baud rate has the code 85"),
    ("MTi-630", "SetPortConfig", [PortConfig(1, 0x55)] * 3, "does not support code 85 baud"),
    ("MTi-300", "SetLatLonAlt", LatLonAlt(0, 0, float("inf")), "alt cannot be inf: it must be a finite"),
    ("MTi-300", "SetAlignmentRotation", AlignmentRotation(2, (1, 0, 0, 0)), "2 is not one of ROT_SENSOR 0"),
    ("MTi-300", "SetUTCTime", xbus.protocol.UtcTime(0, 2026, 2, 29, 0, 0, 0), "there is no 2026-02-29"),
    ("MTi-300", "SetTransmitDelay", 100, "from 590 to 65535"),
    ("MTi-680G", "SetInitialHeading", 181.0, "from -180 to 180 degrees"),
    ("MTi-300", "SetLatLonAlt", LatLonAlt(91, 0, 0), "lat must be from -90 to 90"),
    ("MTi-300", "SetAlignmentRotation", AlignmentRotation(0, (1, 1, 0, 0)), "length 1.414"),
]  # fmt: skip


@pytest.mark.parametrize(("product", "command", "value", "error"), REFUSED)
def test_unsupported_commands_are_not_sent(
    product: str, command: str, value: Any, error: str
) -> None:
    host = idle_session(State(MESSAGES[command].states[-1]), product)
    with pytest.raises(ValueError, match=error):
        host.request(command, value)
    assert host.pending is None


# Faults during every command


@pytest.mark.parametrize("row", ANSWERED, ids=lambda host: host.name)
def test_an_error_is_the_answer(session: NewSession, row: xbus.protocol.tables.MessageRow) -> None:
    host = session(State(row.states[0]))
    host.request(row.name, value_for(row.name))
    (refusal,) = host.receive(SAMPLE + encode_frame(0x42, b"\x21"))[1:]
    assert isinstance(refusal, Refusal)
    assert isinstance(refusal.error, DeviceError)
    assert (refusal.error.code, refusal.error.command) == (0x21, row.name)
    assert "parameter is invalid" in str(refusal.error)
    assert (host.pending, host.state) == (None, State(row.states[0]))


@pytest.mark.parametrize("row", KNOWN, ids=lambda row: row.name)
def test_an_answer_of_the_wrong_length(
    session: NewSession, row: xbus.protocol.tables.MessageRow
) -> None:
    rows = [reply for reply in MESSAGES.values() if reply.mid == row.reply]
    assert row.reply is not None
    wrong = next(n for n in range(300) if not any(n in (row.lengths or ()) for row in rows))
    host = session(State(row.states[0]))
    host.request(row.name, value_for(row.name))
    events = host.receive(encode_frame(row.reply, bytes(wrong))) + host.quiet()
    (refusal,) = events
    assert isinstance(refusal, Refusal)
    assert isinstance(refusal.error, DecodeError)
    assert refusal.error.command == row.name
    assert row.name in str(refusal.error)
    assert host.pending is None


@pytest.mark.parametrize("row", KNOWN, ids=lambda row: row.name)
def test_garbage_does_not_hide_the_answer(
    session: NewSession, row: xbus.protocol.tables.MessageRow
) -> None:
    assert row.reply is not None
    length = min(next(reply.lengths or () for reply in MESSAGES.values() if reply.mid == row.reply))
    answer = encode_frame(row.reply, b"M" * length)
    host = session(State(row.states[0]))
    host.request(row.name, value_for(row.name))
    events = host.receive(b"\xfa\xff\x36\x20\x99\xfa" + answer + SAMPLE) + host.quiet()
    assert [type(event) for event in events][-1] is Sample
    assert any(isinstance(event, (Reply, Refusal)) for event in events)
    assert host.pending is None


def test_stream_errors_do_not_answer_a_command(session: NewSession) -> None:
    host = session(State.MEASUREMENT)
    host.request("SetNoRotation", 3)
    (notice,) = host.receive(bytes.fromhex("FA FF 42 01 29 95"))
    assert isinstance(notice, Notice)
    assert (notice.name, notice.value.code, host.pending) == ("Error", 41, "SetNoRotation")


@pytest.mark.parametrize("name", ["ReqBaudrate", "ReqLatLonAlt", "ReqLocationID", "ReqUTCTime"])
def test_an_empty_answer_to_a_request_is_none(session: NewSession, name: str) -> None:
    host = session()
    host.request(name)
    (refusal,) = host.receive(encode_frame(MESSAGES[name].reply or 0))
    assert isinstance(refusal, Refusal)
    assert "the payload is empty" in str(refusal.error)


@pytest.mark.parametrize(
    "name", ["ReqOutputConfiguration", "ReqSyncSettings", "ReqCanOutputConfig"]
)
def test_an_empty_list_is_a_list(session: NewSession, name: str) -> None:
    host = session()
    host.request(name)
    (reply,) = host.receive(encode_frame(MESSAGES[name].reply or 0))
    assert isinstance(reply, Reply)
    assert reply.value == ()


def test_an_error_without_a_code(session: NewSession) -> None:
    host = session()
    host.request("ReqDID")
    (refusal,) = host.receive(encode_frame(0x42) + SAMPLE)[:1]
    assert isinstance(refusal, Refusal)
    assert isinstance(refusal.error, DecodeError)


def test_code_40_keeps_its_four_bytes(session: NewSession) -> None:
    host = session()
    host.request("ReqDID")
    (refusal,) = host.receive(encode_frame(0x42, bytes.fromhex("28 00000008")))
    assert isinstance(refusal, Refusal)
    assert "00 00 00 08" in str(refusal.error)


# Bus identifiers

# addressed, sender, accepted
BUS = [
    (0xFF, 0xFF, True),
    (0xFF, 0x01, True),
    (0xFF, 0x05, True),
    (0x01, 0x01, True),
    (0x01, 0xFF, True),
    (0x01, 0x02, False),
    (0x05, 0x05, True),
    (0x05, 0x04, False),
]


@pytest.mark.parametrize(("bid", "sender", "heard"), BUS)
def test_bus_identifiers(session: NewSession, bid: int, sender: int, heard: bool) -> None:
    host = session(bid=bid)
    assert host.request("ReqDID")[1] == bid
    events = host.receive(encode_frame(0x01, bytes.fromhex("036008A6"), bid=sender))
    assert bool(events) == heard


@pytest.mark.parametrize("bid", [0, 32, 254, -1])
def test_invalid_bus_identifiers_are_rejected(bid: int) -> None:
    with pytest.raises(ValueError, match="1 to 31"):
        Session(bid=bid)


# All published frames


def test_the_session_sends_the_published_host_frames() -> None:
    """Every published request is encoded from its decoded value."""
    lines = shared("spec/frames.txt").read_text(encoding="utf-8").splitlines()
    count = 0
    for line in lines:
        raw = bytes.fromhex(line.split("#")[0])
        rows = [row for row in REQUESTS if raw[2:3] == bytes([row.mid])]
        if not rows or "Config.FilterProfile" in line:  # the latter is padded by MT Manager
            continue
        payload = raw[4:-1]
        name = next(row.name for row in rows if row.lengths and len(payload) in row.lengths)
        if name == "SetFilterProfileModern" and len(payload) == 2:
            name = "SetFilterProfile"
        value = xbus.protocol.decode(name, payload)
        host = idle_session(State(MESSAGES[name].states[0]))
        assert host.request(name, value) == raw, line
        count += 1
    assert count > 30


# ---------------------------------------------------------------------------------------------
# Times of samples
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("entry", ENTRIES)
@given(data=clock_streams(), cuts=st.lists(st.integers(1, 60), min_size=1))
def test_live_samples_have_the_times_of_a_log(
    entry: type[Session], data: bytes, cuts: list[int]
) -> None:
    """The clock is the same: wraps, coarse times, triggers, the GNSS receiver, restarts, several devices."""
    live, samples, at = entry(), [], 0
    for size in itertools.cycle(cuts):
        samples += [item for item in live.receive(data[at : at + size]) if isinstance(item, Sample)]
        at += size
        if at >= len(data):
            break
    samples += [item for item in live.quiet() if isinstance(item, Sample)]
    log = xbus.read_log(data)
    # A payload without packets is not a sample of a log.
    times = [sample.time for sample in samples if sample.payload]
    np.testing.assert_array_equal(times, log.time)
    assert all(np.isnan(sample.time) for sample in samples if not sample.payload)
    late = {int(at) for key in log if QUANTITIES[log[key].name].clock in ("trigger", "receiver")
            for at in log[key].sample}  # fmt: skip
    assert [sample.leads for sample in samples if sample.payload] == [
        index not in late for index in range(len(log))
    ]
