"""MTSSP: messages, transfers and pipes of the 1-series, byte by byte."""

from __future__ import annotations

import ctypes
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import xbus
from xbus import DecodeError, MessageId
from xbus.mtssp import (
    ADDRESSES,
    OPCODES,
    DataReady,
    I2cBus,
    Opcode,
    PipeStatus,
    ProtocolInfo,
    SpiBus,
    expand,
    highest_rate,
    i2c_request,
    reduce,
    spi_data,
    spi_request,
)
from xbus.mtssp.codec import problem_of
from xbus.protocol.mtssp import PIPE_OVERFLOW, SPI_HEADER
from xbus.protocol.tables import MESSAGES
from xbus.sim import I2cMessage

SPEC = Path(__file__).parent / "spec" / "mtssp.txt"
ROWS = [
    [cell.strip() for cell in line.split("|")]
    for line in SPEC.read_text().splitlines()
    if line and line[0] != "#"
]


def rows(kind: str) -> list[list[str]]:
    found = [row[1:-1] for row in ROWS if row[0] == kind]
    assert found
    return found


class RecordedI2c:
    """An I²C bus that answers as recorded."""

    def __init__(self, reply: bytes = b"") -> None:
        self.written: list[bytes] = []
        self.reply = reply

    def i2c_rdwr(self, *messages: I2cMessage) -> None:
        for message in messages:
            assert message.addr == 0x6B
            if message.flags:
                assert message.len == len(self.reply)
                ctypes.memmove(message.buf, self.reply, message.len)
            else:
                self.written.append(bytes(message))


class RecordedSpi:
    """An SPI bus that answers as recorded."""

    mode = max_speed_hz = 0

    def __init__(self, received: bytes) -> None:
        self.sent = b""
        self.received = received

    def xfer2(self, values: list[int]) -> list[int]:
        self.sent = bytes(values)
        return list(self.received)


@pytest.mark.parametrize(("message", "name", "payload"), rows("message"))
def test_messages_both_ways(message: str, name: str, payload: str) -> None:
    frame = xbus.encode_frame(MESSAGES[name].mid, bytes.fromhex(payload))
    assert reduce(frame) == bytes.fromhex(message)
    assert expand(bytes.fromhex(message)) == frame
    scanner = xbus.Scanner()
    (found,) = scanner.feed(expand(bytes.fromhex(message))) + scanner.close()
    assert isinstance(found, xbus.Message)
    assert (found.name, found.payload.hex().upper()) == (name, payload)


@pytest.mark.parametrize(("sent", "opcode", "data"), rows("i2c write"))
def test_what_is_written_on_i2c(sent: str, opcode: str, data: str) -> None:
    code = code_of(opcode)
    assert i2c_request(code, bytes.fromhex(data)) == bytes.fromhex(sent)
    bus = RecordedI2c()
    I2cBus(bus, message=I2cMessage).write(code, bytes.fromhex(data))
    assert bus.written == [bytes.fromhex(sent)]


@pytest.mark.parametrize(("sent", "reply", "opcode"), rows("i2c read"))
def test_what_is_read_on_i2c(sent: str, reply: str, opcode: str) -> None:
    bus = RecordedI2c(bytes.fromhex(reply))
    found = I2cBus(bus, message=I2cMessage).read(code_of(opcode), len(reply) // 2)
    assert (found.hex().upper(), bus.written) == (reply, [bytes.fromhex(sent)])


@pytest.mark.parametrize(("mosi", "miso", "opcode", "written", "read"), rows("spi"))
def test_transfers_on_spi(mosi: str, miso: str, opcode: str, written: str, read: str) -> None:
    spi = RecordedSpi(bytes.fromhex(miso))
    bus, code = SpiBus(spi), code_of(opcode)
    if written:
        bus.write(code, bytes.fromhex(written))
    else:
        assert bus.read(code, len(read) // 2) == bytes.fromhex(read)
        assert spi_data(bytes.fromhex(miso)) == bytes.fromhex(read)
    assert spi.sent == bytes.fromhex(mosi)
    assert spi_request(code, bytes.fromhex(written), read=len(read) // 2) == bytes.fromhex(mosi)
    assert (spi.mode, spi.max_speed_hz) == (3, 1_000_000)


def code_of(name: str) -> Opcode:
    (code,) = [code for code, row in OPCODES.items() if row.name == name]
    return code


def test_the_tables() -> None:
    assert [(row.code, row.name, row.is_read, row.size) for row in OPCODES.values()] == [
        (1, "ProtocolInfo", True, 2),
        (2, "ConfigureProtocol", False, 1),
        (3, "ControlPipe", False, None),
        (4, "PipeStatus", True, 4),
        (5, "NotificationPipe", True, None),
        (6, "MeasurementPipe", True, None),
    ]
    assert {name: bit.value for name, bit in DataReady.__members__.items()} == {
        "IDLE_HIGH": 1, "OPEN_DRAIN": 2, "NOTIFICATIONS": 4, "MEASUREMENTS": 8,
    }  # fmt: skip
    assert [hex(address) for address in ADDRESSES] == [
        "0x1d", "0x1e", "0x28", "0x29", "0x68", "0x69", "0x6a", "0x6b",
    ]  # fmt: skip
    assert bytes.fromhex("FAFFFFFF") == SPI_HEADER
    assert PIPE_OVERFLOW == 0x29


def test_status_and_information() -> None:
    assert PipeStatus.parse(bytes.fromhex("10002E00")) == (16, 46)
    assert PipeStatus.parse(bytes.fromhex("00002500")) == (0, 37)
    assert PipeStatus(16, 46).encode() == bytes.fromhex("10002E00")
    assert ProtocolInfo.parse(b"\x01\x0c") == (1, DataReady.NOTIFICATIONS | DataReady.MEASUREMENTS)
    assert ProtocolInfo(1, DataReady.IDLE_HIGH).encode() == b"\x01\x01"


def test_the_samples_of_the_sheets() -> None:
    messages = [bytes.fromhex(row[0]) for row in rows("message") if row[1] == "MTData2"]
    log = xbus.read_log(b"".join(map(expand, messages)))
    assert log["packet_counter"].values.tolist() == [4660, 20924]
    assert log["sample_time_fine"].values.tolist() == [11259375, 2181551]
    assert log["status_word"].values.tolist() == [0x87, 0x87]
    assert log["acceleration"].values.tolist() == [[0.5, -0.25, 9.8125]]
    expected = [[0.0003544688, -2.640486e-05, 0.02455454]]
    np.testing.assert_allclose(log["delta_v"].values, expected, rtol=1e-6)
    expected = [[1.00000012, -7.07432673e-06, 4.42937016e-06, 2.3599714e-06]]
    np.testing.assert_allclose(log["delta_q"].values, expected, rtol=1e-6)


def test_a_packet_of_a_real_trace() -> None:
    packet = bytes.fromhex("8030103F7FFF4ABB4E81D8B9E7DEC13B5E5C0C")
    log = xbus.read_log(xbus.encode_frame(MessageId.MTData2, packet))
    expected = [[0.99998915, -0.0031510498, -0.00044225718, 0.0033929376]]
    np.testing.assert_allclose(log["delta_q"].values, expected, rtol=1e-6)
    assert np.linalg.norm(log["delta_q"].values) == pytest.approx(1, abs=1e-7)


def test_a_real_trace_of_a_frame_sent_as_it_is() -> None:
    """The preamble is no opcode: the device answers its header, and then no message."""
    received = bytes.fromhex("FAFFFFFF030047")
    assert spi_data(received) == bytes.fromhex("030047")
    with pytest.raises(DecodeError, match="its checksum is 47, but its bytes have the checksum FE"):
        expand(spi_data(received))


@given(
    mid=st.integers(0, 255),
    payload=st.one_of(st.binary(max_size=600), st.binary(min_size=250, max_size=260)),
    bid=st.integers(0, 255),
)
def test_any_message_both_ways(mid: int, payload: bytes, bid: int) -> None:
    message = reduce(xbus.encode_frame(mid, payload, bid=bid))
    assert expand(message) == xbus.encode_frame(mid, payload)
    assert reduce(expand(message)) == message


@given(
    st.binary(max_size=12) | st.binary(min_size=255, max_size=300).map(lambda d: b"\x36\xff" + d)
)
def test_problems_are_those_of_the_scanner(message: bytes) -> None:
    """The scanner finds a frame exactly where the codec sees no problem."""
    scanner = xbus.Scanner(0xFFFF)
    found = scanner.feed(b"\xfa\xff" + message) + scanner.close()
    is_frame = len(found) == 1 and isinstance(found[0], xbus.Message)
    assert is_frame == (problem_of(message) is None)


@pytest.mark.parametrize(
    ("message", "problem"),
    [
        ("", "a message has at least 3 bytes, not 0"),
        ("3000", "a message has at least 3 bytes, not 2"),
        ("3001D1", "its length field says 4 bytes, but there are 3"),
        ("3000D100", "its length field says 3 bytes, but there are 4"),
        (
            "36FF0003000000C5",
            "it has the long length field, which is for 255 bytes and more, with 3",
        ),
        ("3000D2", "its checksum is D2, but its bytes have the checksum D1; read it again"),
    ],
)
def test_damaged_messages(message: str, problem: str) -> None:
    with pytest.raises(DecodeError, match=re.escape(problem)):
        expand(bytes.fromhex(message))


@pytest.mark.parametrize(
    ("frame", "problem"),
    [
        ("", "a frame begins with FA, not with nothing"),
        ("FBFF3000D1", "a frame begins with FA, not with FB"),
        ("FAFF3000D2", "its checksum is D2, but its bytes have the checksum D1"),
        ("FAFF", "a message has at least 3 bytes"),
    ],
)
def test_what_is_no_frame(frame: str, problem: str) -> None:
    with pytest.raises(ValueError, match=re.escape(problem)):
        reduce(bytes.fromhex(frame))


@pytest.mark.parametrize(
    ("status", "problem"),
    [
        (
            "FFFFFFFF",
            "the pipe status is FF FF FF FF: a notification of 65,535 bytes, but a message has 3 to",
        ),
        ("00000200", "the pipe status is 00 00 02 00: a measurement of 2 bytes"),
        ("00000608", "a measurement of 2,054 bytes, but a message has 3 to 2,053"),
        ("0000", "PipeStatus has 4 bytes, not 2"),
    ],
)
def test_implausible_status(status: str, problem: str) -> None:
    with pytest.raises(DecodeError, match=re.escape(problem)):
        PipeStatus.parse(bytes.fromhex(status))


@pytest.mark.parametrize("bad", [0x00, 0x6C, 0x7F])
def test_addresses_that_no_device_has(bad: int) -> None:
    with pytest.raises(ValueError, match=f"no MTi has the I²C address 0x{bad:02X}; the pins"):
        I2cBus(RecordedI2c(), bad, message=I2cMessage)


def test_a_clock_that_is_too_fast() -> None:
    with pytest.raises(ValueError, match="the speed must be from 1 to 2,000,000 Hz, not 2,000,001"):
        SpiBus(RecordedSpi(b""), 2_000_001)


def test_rates() -> None:
    # A status and a message of 46 bytes: 66 and 444 periods of the clock on I²C, 64 and 400 on SPI.
    assert highest_rate(46, 400_000, "i2c") == 400_000 / (66 + 444)
    assert highest_rate(46, 2_000_000, "spi") == 2_000_000 / (64 + 400)
