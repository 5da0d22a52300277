"""Single frames and packets: round trips of encoding and decoding, and `Scanner` on chunked bytes."""

from __future__ import annotations

import math
import random
import struct
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import reference
import streams
import xbus
from conftest import SEEDS, damaged_streams, shared
from streams import frame, mtdata2, packet, real
from xbus import Column, MessageId, Scanner, encode_frame, encode_packet, encode_sample
from xbus.protocol.tables import QUANTITIES, Quantity
from xbus.wire.codec import Damage

# ---------------------------------------------------------------------------------------------
# Frames
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mid", "payload", "wire"),
    [
        (MessageId.ReqDID, "", "FA FF 00 00 01"),
        (MessageId.GoToConfig, "", "FA FF 30 00 D1"),
        (MessageId.GoToMeasurement, "", "FA FF 10 00 F1"),
        (MessageId.SetBaudrate, "80", "FA FF 18 01 80 68"),
        (MessageId.SetFilterProfile, "00 02", "FA FF 64 02 00 02 99"),
        (0x36, "10 20 02 DF C5", "FA FF 36 05 10 20 02 DF C5 F0"),
    ],
)
def test_encode_frame(mid: int, payload: str, wire: str) -> None:
    """Section 5.1: the sum of all bytes after the preamble is zero."""
    assert encode_frame(mid, bytes.fromhex(payload)).hex(" ").upper() == wire


@pytest.mark.parametrize(
    ("length", "header"),
    [
        (0, "FA FF 91 00"),
        (1, "FA FF 91 01"),
        (254, "FA FF 91 FE"),
        (255, "FA FF 91 FF 00 FF"),
        (256, "FA FF 91 FF 01 00"),
        (8185, "FA FF 91 FF 1F F9"),
        (65535, "FA FF 91 FF FF FF"),
    ],
)
def test_lengths(length: int, header: str) -> None:
    """The extended form is for 255 bytes and more."""
    payload = random.Random(length).randbytes(length)
    wire = encode_frame(0x91, payload)
    start = bytes.fromhex(header)
    assert wire[: len(start)] == start
    assert wire[len(start) : -1] == payload
    assert sum(wire[1:]) % 256 == 0
    assert xbus.read_log(wire).messages[0].payload == payload
    assert wire == frame(0x91, payload)


def test_payloads_beyond_16_bits_are_rejected() -> None:
    text = "a payload of 65536 bytes does not fit into a frame; its length has 16 bits"
    with pytest.raises(ValueError, match=text):
        encode_frame(0x91, bytes(65536))


@pytest.mark.parametrize("bid", [0, 1, 31, 0xFA, 0xFE, 0xFF])
def test_bus_identifiers(bid: int) -> None:
    assert encode_frame(0x30, bid=bid)[:4] == bytes([0xFA, bid, 0x30, 0])


@pytest.mark.parametrize(("mid", "bid"), [(256, 0xFF), (-1, 0xFF), (0x30, 256), (0x30, -1)])
def test_values_outside_a_byte_are_rejected(mid: int, bid: int) -> None:
    with pytest.raises(OverflowError):
        encode_frame(mid, bid=bid)


@given(st.integers(0, 255), st.binary(max_size=300), st.integers(0, 255))
def test_frames_round_trip(mid: int, payload: bytes, bid: int) -> None:
    """A single frame is always in step: it begins and ends where the input does."""
    scanner = Scanner()
    found = scanner.feed(encode_frame(mid, payload, bid=bid)) + scanner.close()
    assert [
        (item.mid, item.bid, item.payload) for item in found if isinstance(item, xbus.Message)
    ] == [(mid, bid, payload)]
    assert len(found) == 1


# ---------------------------------------------------------------------------------------------
# Packets: decoding and encoding gives the same bytes
# ---------------------------------------------------------------------------------------------


def contents(column: Column) -> Any:
    """Returns the argument of `encode_packet` for the first row of a column."""
    if column.name == "gnss_sat_info":
        return column.values[0], column.satellites
    return column.values[0]


def key_of(column: Column) -> tuple[str, ...]:
    return (column.name, *(item for item in (column.precision, column.coordinates) if item))


def canonical(quantity: Quantity, precision: int, system: int) -> int:
    """Returns the identifier that the encoder writes."""
    is_real = quantity.kind == "real"
    return quantity.id | (precision if is_real else 0) | (system if quantity.coordinates else 0)


def assert_round_trips(wire: bytes) -> None:
    """Asserts the round trip by name and by identifier."""
    log = xbus.read_log(mtdata2(wire))
    (key,) = log
    column = log[key]
    assert encode_packet(key_of(column), contents(column)) == wire
    assert encode_packet(column.data_id, contents(column)) == wire


@given(
    SEEDS,
    st.sampled_from(list(QUANTITIES.values())),
    st.integers(0, 3),
    st.sampled_from((0x0, 0x4, 0x8)),
)
def test_packets_round_trip(seed: int, quantity: Quantity, precision: int, system: int) -> None:
    """All quantities in all formats with any bits: NaNs, infinities, the limits of fixed point."""
    data_id = canonical(quantity, precision, system)
    rng = random.Random(seed)
    if quantity.kind == "real":
        numbers = (streams.random_number(rng, precision) for _ in range(quantity.numbers))
        wire = packet(data_id, b"".join(numbers))
    else:
        wire = streams.random_packet(rng, quantity.id)
        wire = packet(data_id, wire[3:])
    assert_round_trips(wire)


@pytest.mark.parametrize("name", QUANTITIES)
@pytest.mark.parametrize("fill", [0x00, 0x01, 0x7F, 0x80, 0xFF])
def test_packets_of_every_quantity_round_trip(name: str, fill: int) -> None:
    """The same without random choice of the quantity."""
    quantity = QUANTITIES[name]
    for precision, width in enumerate((4, 4, 6, 8)):
        data_id = canonical(quantity, precision, 0x4)
        if quantity.kind == "real":
            assert_round_trips(packet(data_id, bytes([fill]) * width * quantity.numbers))
        elif quantity.kind == "id":
            assert_round_trips(packet(data_id, bytes([fill]) * (8 if precision else 4)))
        elif quantity.kind == "list":
            head = bytes([fill] * 4) + bytes([precision]) + bytes([fill] * 3)
            assert_round_trips(packet(data_id, head + bytes([fill]) * 4 * precision))
        else:
            assert quantity.size is not None
            assert_round_trips(packet(data_id, bytes([fill]) * quantity.size))


@pytest.mark.parametrize(
    ("data_id", "raw"),
    [(0x0810, "7FC00001"), (0x0810, "7F800001"), (0x0810, "FFC12345"), (0x0810, "FF800000"),
     (0x0813, "7FF8000000000001"), (0x0813, "7FF0000000000001"), (0x0813, "FFF0000000000000")],
)  # fmt: skip
def test_bits_of_nan(data_id: int, raw: str) -> None:
    assert_round_trips(packet(data_id, bytes.fromhex(raw)))


def test_samples_round_trip() -> None:
    """A whole message keeps the order of its packets; a quantity may occur twice."""
    packets: list[tuple[Any, Any]] = [
        ("packet_counter", 65535),
        (("quaternion", "NED", "Fp1632"), [1, 0, -0.5, 0.25]),
        ("acceleration", [0.5, -0.25, 9.75]),
        (("acceleration", "Float64"), [0.1, 0.2, 0.3]),
        ("status_word", 0xFFFFFFFF),
    ]
    wire = encode_sample(packets, bid=7)
    assert wire == mtdata2(
        packet(0x1020, b"\xff\xff"),
        real(0x2016, 1, 0, -0.5, 0.25),
        real(0x4020, 0.5, -0.25, 9.75),
        real(0x4023, 0.1, 0.2, 0.3),
        packet(0xE020, b"\xff\xff\xff\xff"),
        bid=7,
    )
    assert encode_sample(dict(packets)) == encode_sample(packets)


def is_canonical(wire: bytes) -> bool:
    """Returns whether the encoder would write exactly these bytes: an MTData2 message of known packets."""
    found = reference.scan(wire)[0]
    tiles = reference.packets(found[0].payload) if found and found[0].mid == 0x36 else None
    if tiles is None or len(found) > 1:
        return False
    by_id = {quantity.id: quantity for quantity in QUANTITIES.values()}
    for data_id, _ in tiles:
        quantity = by_id.get(data_id & 0xFFF0)
        if quantity is None or canonical(quantity, data_id & 3, data_id & 0xC) != data_id:
            return False
    return True


def test_published_messages_round_trip() -> None:
    """Every published MTData2 message is encoded from its decoded values."""
    done = 0
    for line in shared("spec/frames.txt").read_text().splitlines():
        wire = bytes.fromhex(line.split("#")[0])
        if not wire or not is_canonical(wire):
            continue
        payload = reference.scan(wire)[0][0].payload
        again = b""
        for data_id, data in reference.packets(payload) or []:
            log = xbus.read_log(mtdata2(packet(data_id, data)))
            (key,) = log
            again += encode_packet(data_id, contents(log[key]))
        assert encode_frame(0x36, again) == wire, line
        done += 1
    assert done > 15


# ---------------------------------------------------------------------------------------------
# Numbers into fixed point
# ---------------------------------------------------------------------------------------------

ONE_1220, ONE_1632 = 2**-20, 2**-32


@pytest.mark.parametrize(
    ("precision", "value", "data"),
    [
        ("Fp1220", 1.0, "00 10 00 00"),
        ("Fp1220", -2048.0, "80 00 00 00"),
        ("Fp1220", 115.70063018798828, "07 3B 35 C8"),
        ("Fp1632", 1.0, "00 00 00 00 00 01"),
        ("Fp1632", -0.5, "80 00 00 00 FF FF"),
        ("Fp1632", 24.375, "60 00 00 00 00 18"),
        ("Fp1632", -32768.0, "00 00 00 00 80 00"),
        # Half is rounded away from zero.
        ("Fp1220", 0.5 * ONE_1220, "00 00 00 01"),
        ("Fp1220", -0.5 * ONE_1220, "FF FF FF FF"),
        ("Fp1220", 1.5 * ONE_1220, "00 00 00 02"),
        ("Fp1220", 2.5 * ONE_1220, "00 00 00 03"),
        ("Fp1220", -2.5 * ONE_1220, "FF FF FF FD"),
        ("Fp1220", 0.49 * ONE_1220, "00 00 00 00"),
        ("Fp1632", 0.5 * ONE_1632, "00 00 00 01 00 00"),
        ("Fp1632", -0.5 * ONE_1632, "FF FF FF FF FF FF"),
        ("Fp1632", 2.5 * ONE_1632, "00 00 00 03 00 00"),
        # Values out of range saturate.
        ("Fp1220", 2048.0, "7F FF FF FF"),
        ("Fp1220", 2048 - 0.6 * ONE_1220, "7F FF FF FF"),
        ("Fp1220", 2048 - 0.4 * ONE_1220, "7F FF FF FF"),
        ("Fp1220", 1e300, "7F FF FF FF"),
        ("Fp1220", math.inf, "7F FF FF FF"),
        ("Fp1220", -2049.0, "80 00 00 00"),
        ("Fp1220", -math.inf, "80 00 00 00"),
        ("Fp1632", 32768.0, "FF FF FF FF 7F FF"),
        ("Fp1632", 32768 - 0.25 * ONE_1632, "FF FF FF FF 7F FF"),
        ("Fp1632", math.inf, "FF FF FF FF 7F FF"),
        ("Fp1632", -1e300, "00 00 00 00 80 00"),
        ("Fp1632", -math.inf, "00 00 00 00 80 00"),
        ("Float32", 9.81, "41 1C F5 C3"),
        ("Float32", 1e39, "7F 80 00 00"),
        ("Float64", 0.1, "3F B9 99 99 99 99 99 9A"),
    ],
)
def test_rounding(precision: str, value: float, data: str) -> None:
    """Section 5.3.5, "Definition output formats": half away from zero; out of range it saturates."""
    wire = encode_packet(("temperature", precision), value)
    assert wire[3:].hex(" ").upper() == data


def rounded(value: float, bits: int, width: int) -> int:
    """Rounds half away from zero and saturates, in exact arithmetic."""
    scaled = Fraction(value) * 2**bits
    whole: int = math.floor(abs(scaled) + Fraction(1, 2)) * (1 if scaled >= 0 else -1)
    end = 1 << width - 1
    return max(-end, min(end - 1, whole))


@given(st.floats(-40_000, 40_000) | st.floats(allow_nan=False, allow_infinity=False))
def test_any_number_is_rounded_correctly(value: float) -> None:
    fp1220 = encode_packet(("temperature", "Fp1220"), value)[3:]
    assert int.from_bytes(fp1220, "big", signed=True) == rounded(value, 20, 32)
    fp1632 = encode_packet(("temperature", "Fp1632"), value)[3:]
    integer = int.from_bytes(fp1632[4:] + fp1632[:4], "big", signed=True)
    assert integer == rounded(value, 32, 48)


@given(st.floats(width=32))
def test_any_number_in_float32(value: float) -> None:
    assert encode_packet("temperature", value)[3:] == struct.pack(">f", value)


# ---------------------------------------------------------------------------------------------
# Accepted and rejected values
# ---------------------------------------------------------------------------------------------

WIRE = real(0x4020, 1, 2, 3)


@pytest.mark.parametrize(
    ("key", "values", "wire"),
    [
        ("acceleration", [1, 2, 3], WIRE),
        ("acceleration", (1.0, 2, 3), WIRE),
        ("acceleration", np.array([1, 2, 3], "i2"), WIRE),
        ("acceleration", np.array([1, 2, 3], ">f4"), WIRE),
        ("acceleration", np.array([[1], [2], [3]], "f2"), WIRE),
        ("acceleration", np.arange(7)[1::2].astype("f8") // 2 + 1, WIRE),
        (("acceleration",), [1, 2, 3], WIRE),
        (("acceleration", "Float32"), [1, 2, 3], WIRE),
        (0x4020, [1, 2, 3], WIRE),
        (xbus.DataId.Acceleration, [1, 2, 3], WIRE),
        (xbus.DataId.Acceleration | xbus.Precision.Float64, [1, 2, 3], real(0x4023, 1, 2, 3)),
        (("quaternion", "Fp1220", "NWU"), [1, 0, 0, 0], real(0x2019, 1, 0, 0, 0)),
        (("quaternion", "NWU", "Fp1220"), [1, 0, 0, 0], real(0x2019, 1, 0, 0, 0)),
        (("quaternion", "ENU"), [1, 0, 0, 0], real(0x2010, 1, 0, 0, 0)),
        ("rotation_matrix", [[11, 12, 13], [21, 22, 23], [31, 32, 33]],
         real(0x2020, 11, 21, 31, 12, 22, 32, 13, 23, 33)),
        ("rotation_matrix", [11, 12, 13, 21, 22, 23, 31, 32, 33],
         real(0x2020, 11, 21, 31, 12, 22, 32, 13, 23, 33)),
        ("packet_counter", 65535.0, packet(0x1020, b"\xff\xff")),
        ("packet_counter", [7], packet(0x1020, b"\0\7")),
        ("packet_counter", np.uint64(7), packet(0x1020, b"\0\7")),
        ("sample_time64", 2**64 - 1, packet(0x10A0, b"\xff" * 8)),
        ("rssi", -128, packet(0xE040, b"\x80")),
        ("device_id", np.uint32(1), packet(0xE080, b"\0\0\0\1")),
        ("device_id", np.uint64(1), packet(0xE080, bytes(7) + b"\1")),
        ("utc_time", [1, 2025, 7, 13, 9, 21, 34, 7],
         packet(0x1010, bytes.fromhex("00000001 07E9 07 0D 09 15 22 07"))),
        ("trigger_in1", {"frame": 4, "timestamp": 3, "polarity": 2, "line": 1},
         packet(0x4810, bytes.fromhex("01 02 00000003 0004"))),
        ("gnss_sat_info", ([1000, 1, 0, 0, 0], [(1, 2, 3, 4)]),
         packet(0x7020, bytes.fromhex("000003E8 01 000000 01020304"))),
        ("gnss_sat_info", ([1000, 0, 0, 0, 0], []), packet(0x7020, bytes.fromhex("000003E8 00 000000"))),
    ],
)  # fmt: skip
def test_accepted(key: Any, values: Any, wire: bytes) -> None:
    assert encode_packet(key, values).hex(" ") == wire.hex(" ")


@pytest.mark.parametrize(
    ("key", "values", "text"),
    [
        ("accelleration", 1, "no quantity is called 'accelleration'; did you mean 'acceleration'?"),
        (("accelleration", "NED"), 1, "no quantity is called 'accelleration'"),
        (0x7770, 1, "no quantity has the data identifier 0x7770"),
        (("acceleration", "NED"), [1, 2, 3], "acceleration has no coordinates"),
        (("quaternion", "UFO"), [1, 0, 0, 0], "a format is a coordinate system (ENU, NED, NWU)"),
        (("quaternion", "NED", "ENU"), [1, 0, 0, 0], "at most one coordinate system and one precision"),
        (("quaternion", "Fp1220", "Fp1632"), [1, 0, 0, 0], "at most one coordinate system and one precision"),
        (("packet_counter", "Float32"), 1, "packet_counter has no precision"),
        ("acceleration", [1, 2], "acceleration takes 3 numbers, not 2"),
        ("acceleration", 1, "acceleration takes 3 numbers, not 1"),
        ("temperature", [], "temperature takes 1 numbers, not 0"),
        ("packet_counter", 65536, "packet_counter: 65536 is outside U2 (0 to 65535)"),
        ("packet_counter", -1, "packet_counter: -1 is outside U2 (0 to 65535)"),
        ("packet_counter", 1.5, "packet_counter: 1.5 is outside the integers"),
        ("packet_counter", math.nan, "packet_counter: NaN is outside the integers"),
        ("packet_counter", math.inf, "packet_counter: inf is outside the integers"),
        ("rssi", 128, "rssi: 128 is outside I1 (-128 to 127)"),
        ("sample_time64", -1, "is outside U8"),
        ("sample_time64", 1e20, "is outside U8"),
        (("temperature", "Fp1220"), math.nan, "temperature: Fp1220 has no NaN; use Float32 or Float64"),
        (("temperature", "Fp1632"), math.nan, "temperature: Fp1632 has no NaN; use Float32 or Float64"),
        (("acceleration", "Fp1220"), [1, math.nan, 2], "acceleration: Fp1220 has no NaN"),
        ("trigger_in1", {"line": 1}, "a record needs exactly the fields line, polarity, timestamp, frame"),
        ("trigger_in1", [1, 2, 3], "trigger_in1 takes 4 numbers, not 3"),
        ("trigger_in1", [256, 2, 3, 4], "line: 256 is outside U1 (0 to 255)"),
        ("gnss_sat_info", ([1000, 2, 0, 0, 0], [(1, 2, 3, 4)]), "gnss_sat_info takes 13 numbers, not 9"),
        ("gnss_sat_info", ([1000, 62, 0, 0, 0], [(1, 2, 3, 4)] * 62),
         "gnss_sat_info: 256 bytes do not fit into a packet; its size has 8 bits"),
        ("temperature", "warm", "packets hold numbers, not"),
        ("temperature", None, "packets hold numbers, not object"),
        ("temperature", 1j, "packets hold numbers, not complex128"),
    ],
)  # fmt: skip
def test_refused(key: Any, values: Any, text: str) -> None:
    """The error names the fault and the remedy in one sentence."""
    with pytest.raises(ValueError) as caught:
        encode_packet(key, values)
    assert text in str(caught.value)


@pytest.mark.parametrize("data_id", [0x201C, 0xD01F])
def test_undefined_coordinates_are_preserved(data_id: int) -> None:
    with pytest.raises(ValueError):
        encode_packet(data_id, [1, 0, 0, 0][: 4 if data_id < 0x3000 else 3])


def test_samples_beyond_16_bits_are_rejected() -> None:
    with pytest.raises(ValueError, match="does not fit into a frame"):
        encode_sample([("acceleration", [1, 2, 3])] * 5000)


# ---------------------------------------------------------------------------------------------
# Scanner
# ---------------------------------------------------------------------------------------------


def scanned(pieces: list[bytes], limit: int = 8185) -> list[Any]:
    scanner = Scanner(limit)
    return [item for piece in pieces for item in scanner.feed(piece)] + scanner.close()


def cut(data: bytes, seed: int) -> list[bytes]:
    """Returns the bytes in pieces of any size, including empty ones."""
    rng = random.Random(seed)
    marks = sorted(rng.randint(0, len(data)) for _ in range(rng.choice((0, 1, 5, 50))))
    return [data[a:b] for a, b in zip([0, *marks], [*marks, len(data)], strict=True)]


def expected_items(data: bytes, limit: int) -> list[tuple[Any, ...]]:
    """Returns damage, messages and strings in order; the index of the sample is last."""
    frames, strings, damage, _ = reference.find(data, limit)
    found: list[tuple[Any, ...]] = []
    sample = 0
    things: list[Any] = [*frames, *strings, *damage]
    for thing in sorted(things, key=lambda thing: int(thing.offset)):
        match thing:
            case reference.Frame():
                found.append((thing.mid, thing.bid, thing.payload, thing.offset, sample))
                sample += thing.mid == 0x36 and reference.packets(thing.payload) is not None
            case reference.String():
                found.append((thing.name, thing.data, thing.offset, sample))
            case _:
                found.append(tuple(thing))
    return found


def expected_item(item: Any) -> tuple[Any, ...]:
    match item:
        case xbus.Message():
            return (item.mid, item.bid, item.payload, item.offset, item.sample)
        case xbus.String():
            return (
                None if item.type is None else item.type.name,
                item.data,
                item.offset,
                item.sample,
            )
    return tuple(item)


#: After a malformed MTData2 message, which is not a sample.
@example(frame(0x36, b"\x40\x20\x0c") + mtdata2(packet(0x1020, b"\0\1")) + frame(0x3E), 0, 254)
@given(damaged_streams(20), SEEDS, st.sampled_from((20, 254, 300, 8185, 65535)))
def test_chunking_does_not_matter(data: bytes, seed: int, limit: int) -> None:
    """Any chunking gives the same messages and the same damage, in order."""
    expected = expected_items(data, limit)
    for pieces in ([data], [bytes([item]) for item in data], cut(data, seed)):
        found = scanned(pieces, limit)
        assert [expected_item(item) for item in found] == expected


def test_messages_are_named() -> None:
    found = scanned([frame(0x30) + mtdata2(packet(0x1020, b"\0\1")) + frame(0x9D)])
    assert [(item.name, item.sample) for item in found] == [
        ("GoToConfig", 0),
        ("MTData2", 0),
        ("0x9D", 1),
    ]


@pytest.mark.parametrize(
    "raw", [frame(0x3E), mtdata2(real(0x4020, 1, 2, 3)), frame(0x91, bytes(300))]
)
def test_plausible_frames_do_not_wait(raw: bytes) -> None:
    """A frame is returned with its last byte, even after damage."""
    for before in (b"", b"\0", b"\0\xfa\xff\x77\x05", frame(0x3E)):
        scanner = Scanner()
        scanner.feed(before)
        assert not [item for item in scanner.feed(raw[:-1]) if not isinstance(item, Damage)]
        assert scanner.feed(raw[-1:])[-1].offset == len(before)


def test_implausible_frames_wait_for_the_next() -> None:
    """A frame that no device sends is accepted when another frame or the end of the input follows."""
    strange = frame(0xB2, b"?")
    scanner = Scanner()
    assert scanner.feed(strange) == []
    assert [item.offset for item in scanner.feed(frame(0x3E))] == [0, 6]
    assert scanner.feed(strange) == []
    assert [item.offset for item in scanner.close()] == [11]


def test_offsets_count_from_the_beginning() -> None:
    scanner = Scanner()
    for i in range(50):
        assert [item.offset for item in scanner.feed(frame(0x3E))] == [5 * i]


def test_false_headers_delay_only_the_claimed_bytes() -> None:
    """An implausible header is rejected as early as possible."""
    wake_up = frame(0x3E)
    scanner = Scanner()
    # No device sends this message, so after other damage it is rejected without waiting.
    assert scanner.feed(b"\0\xfa\xff\x77\xff\x1f\x00") == []
    assert [item.offset for item in scanner.feed(wake_up)] == [0, 7]
    # MTData2 of 100 bytes: rejected at its first packet, which has the wrong size.
    scanner = Scanner()
    assert scanner.feed(b"\0\xfa\xff\x36\x64\x40\x20") == []
    assert [item.offset for item in scanner.feed(b"\x0d" + bytes(13) + wake_up)] == [0, 21]
    # EmtsData may have 1000 bytes: only the claimed bytes are delayed.
    scanner = Scanner()
    assert scanner.feed(b"\0\xfa\xff\x91\xff\x03\xe8") == []
    assert scanner.feed(wake_up * 200) == []
    assert len(scanner.feed(wake_up)) == 1 + 201


def test_close_ends_the_input() -> None:
    scanner = Scanner()
    assert scanner.feed(b"\xfa\xff\x3e") == []
    assert scanner.close() == [Damage(0, 3, "truncated")]
    assert Scanner().close() == []


@pytest.mark.parametrize(
    "data", [bytearray(b"\xfa\xff\x3e\0\xc3"), memoryview(b"\xfa\xff\x3e\0\xc3")]
)
def test_bytes_of_any_kind(data: Any) -> None:
    found = Scanner().feed(data)
    assert [
        item for item in found if not isinstance(item, xbus.Message) or item.name != "WakeUp"
    ] == []
    assert len(found) == 1


@pytest.mark.parametrize("limit", [-1, 65536])
def test_limits(limit: int) -> None:
    with pytest.raises(ValueError, match=f"limit must be from 0 to 65535 bytes, not {limit}"):
        Scanner(limit)
