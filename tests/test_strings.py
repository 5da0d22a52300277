"""String outputs: section 5.3.5, SetStringOutputType.

The sentences are the manual's masks filled in, and public ones of such devices where there are any.
The values of standard strings are compared with pynmeagps, an independent NMEA 0183 parser.
"""

from __future__ import annotations

import datetime
import math
import random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import streams
import xbus
from conftest import SEEDS, damaged_streams, differences, edited, edits, facts, facts_of
from reference import decode
from xbus import Scanner, String, StringType, encode_string, parse_string
from xbus.protocol.strings import STRING_FIELDS

#: The type of a string, its text, and its values.
SENTENCES: list[tuple[str, str, dict[str, Any]]] = [
    ("HCHDM", "$HCHDM,123.45,M*18", {"heading": 123.45}),
    ("HCHDG", "$HCHDG,98.3,0.1,E,12.6,W*56", {"heading": 98.3, "deviation": 0.1, "variation": -12.6}),
    ("TSS2", ":12345  0000H 0123 -0456F", {"heading": 123.45, "heave": 0.0, "roll": 1.23, "pitch": -4.56}),
    ("PHTRO", "$PHTRO,10.37,P,177.62,T*65", {"pitch": -10.37, "roll": 177.62}),
    ("PRDID", "$PRDID,-04.56,001.23,123.45", {"pitch": -4.56, "roll": 1.23, "heading": 123.45}),
    (
        "PSONCMS",
        "$PSONCMS,0.0905,0.4217,0.9020,-0.0196,-1.7685,0.3861,-9.6648,-0.0116,0.0065,-0.0080,0.0581,0.3846,"
        "0.7421,33.1*76",
        {
            "quaternion_q0": 0.0905, "quaternion_q1": 0.4217, "quaternion_q2": 0.9020,
            "quaternion_q3": -0.0196,
            "acceleration_x": -1.7685, "acceleration_y": 0.3861, "acceleration_z": -9.6648,
            "rate_of_turn_x": -0.0116, "rate_of_turn_y": 0.0065, "rate_of_turn_z": -0.0080,
            "magnetic_field_x": 0.0581, "magnetic_field_y": 0.3846, "magnetic_field_z": 0.7421,
            "temperature": 33.1,
        },
    ),
    ("HCMTW", "$HCMTW,33.1,C*19", {"temperature": 33.1}),
    ("HEHDT", "$HEHDT,123.45,T*1E", {"heading": 123.45, "heading_type": "T"}),
    ("HEROT", "$HEROT,-10.3,A*34", {"rate_of_turn": -10.3, "status": "A"}),
    (
        "GPGGA",
        "$GPGGA,091507.00,5214.4043,N,00650.3034,E,1,09,1.1,45.2,M,42.8,M,,*54",
        {
            "time": datetime.time(9, 15, 7), "lat": 52 + 14.4043 / 60, "lon": 6 + 50.3034 / 60, "quality": 1,
            "satellites": 9, "hdop": 1.1, "height_msl": 45.2, "geoid_separation": 42.8, "dgps_age": None,
            "dgps_station": None,
        },
    ),
    (
        "PTCF",
        "$PTCF,123.4,T, 001.2,-04.6, 000.1, 000.2*40",
        {"heading": 123.4, "roll": 1.2, "pitch": -4.6, "roll_rate": 0.1, "pitch_rate": 0.2},
    ),
    (
        "XSVEL",
        "$XSVEL, 000.1235,-000.4321, 000.0100*4B",
        {"velocity_x": 0.1235, "velocity_y": -0.4321, "velocity_z": 0.01},
    ),
    (
        "GPZDA",
        "$GPZDA,091507.00,13,07,2025,00,00*6C",
        {
            "time": datetime.time(9, 15, 7), "date": datetime.date(2025, 7, 13), "zone_hours": 0.0,
            "zone_minutes": 0.0,
        },
    ),
    (
        "GPRMC",
        "$GPRMC,091507,A,5214.40,N,00650.30,E,000.4,123.4,130725,002.5,E,*53",
        {
            "time": datetime.time(9, 15, 7), "status": "A", "lat": 52 + 14.40 / 60, "lon": 6 + 50.30 / 60,
            "speed": 0.4, "course": 123.4, "date": datetime.date(2025, 7, 13), "variation": 2.5, "mode": None,
        },
    ),
]  # fmt: skip
#: Roll 1.23, pitch -4.56, heave 0, heading 123.45: all of it little-endian.
EM1000 = bytes.fromhex("00 90 7B 00 38 FE 00 00 39 30")
WIRES = [(name, text.encode() + b"\r\n", values) for name, text, values in SENTENCES]
WIRES.append(("EM1000", EM1000, {"roll": 1.23, "pitch": -4.56, "heave": 0.0, "heading": 123.45}))
SAMPLE = xbus.encode_sample({"packet_counter": 7, "sample_time_fine": 100})


@pytest.mark.parametrize(("name", "wire", "values"), WIRES, ids=[wire[0] for wire in WIRES])
def test_strings_round_trip(name: str, wire: bytes, values: dict[str, Any]) -> None:
    string = parse_string(wire)
    assert string.type is StringType[name]
    assert string.name == name
    assert string.values == values
    assert list(string.values) == list(string.units)
    assert encode_string(name, values) == wire
    assert encode_string(string.type, string.values) == wire
    if name != "EM1000":
        assert parse_string(wire.strip()) == String(string.type, wire.strip())
        assert parse_string(string.text).values == values


@pytest.mark.parametrize(("name", "wire", "values"), WIRES, ids=[wire[0] for wire in WIRES])
def test_strings_are_found_among_frames(name: str, wire: bytes, values: dict[str, Any]) -> None:
    """A string is found wherever the input is cut, and neither the string nor adjacent frames are damage."""
    stream = wire + SAMPLE + wire + wire + SAMPLE + SAMPLE + wire
    log = xbus.read_log(stream, strict=True, strings=[name])
    assert [string.data for string in log.strings] == [wire] * 4
    assert [string.type for string in log.strings] == [StringType[name]] * 4
    assert log.strings.sample.tolist() == [0, 1, 1, 3]
    assert [stream[a:b] for a, b in zip(log.strings.offset, log.strings.end, strict=True)] == [
        wire
    ] * 4
    assert log.stats.strings == 4
    assert len(log) == 3
    assert log.stats.skipped_bytes == len(log.damage) == 0
    expected = Scanner(strings=[name]).feed(stream)
    for cut in range(len(stream)):
        scanner = Scanner(strings=[name])
        found = scanner.feed(stream[:cut]) + scanner.feed(stream[cut:]) + scanner.close()
        assert found == [*expected, *Scanner().close()]


def test_a_public_sentence_with_fewer_digits() -> None:
    assert parse_string("$HCHDM,093.8,M*2B").values == {"heading": 93.8}


@pytest.mark.parametrize(
    ("text", "name", "value"),
    [
        ("$HEROT,-10.3,T*21", "valid", True),  # as the vendor's parser requires
        ("$HEROT,-10.3,V*23", "valid", False),
        ("$GPRMC,091507,V,,,,,,,130725,,,*2A", "valid", False),
        ("$GPGGA,091507.00,,,,,0,00,,,M,,M,,*44", "valid", False),
        ("$GPGGA,091507.00,,,,,2,00,,,M,,M,,*46", "valid", True),
        ("$HEHDT,123.45,T*1E", "valid", None),
        ("$HEHDT,,T*01", "heading", None),
        ("$HEHDT,123.45,M*07", "heading_type", "M"),
        ("$PHTRO,,,10.00,B*4C", "pitch", None),
        ("$PHTRO,,,10.00,B*4C", "roll", -10.0),
        (":           H           F", "heading", None),
        ("$PRDID,, ,123.4", "roll", None),
        ("$PTCF,,T,      ,-04.6,,*76", "roll", None),
        ("$GPZDA,246000.00,30,02,2025,00,00*62", "time", None),
        ("$GPZDA,246000.00,30,02,2025,00,00*62", "date", None),
        ("$GPZDA,235959.999,29,02,2024,00,00*57", "time", datetime.time(23, 59, 59, 999_000)),
        ("$GPRMC,091507,A,5214.40,S,00650.30,W,000.4,,060180,,*5A", "date", datetime.date(1980, 1, 6)),
        ("$GPRMC,091507,A,5214.40,S,00650.30,W,000.4,,060180,,*5A", "course", None),
        ("$GPRMC,091507,A,5214.40,S,00650.30,W,000.4,,060180,,*5A", "lat", -(52 + 14.4 / 60)),
        ("$GPRMC,091507,A,5214.40,S,00650.30,W,000.4,,060180,,*5A", "lon", -(6 + 50.3 / 60)),
        ("$GPRMC,091507,A,5214.40,S,00650.30,W,000.4,,060180,,,D*32", "mode", "D"),
        ("$XSVEL,-000.1000, 1.5,.25*5E", "velocity_z", 0.25),
    ],
)  # fmt: skip
def test_field_values(text: str, name: str, value: Any) -> None:
    body = text[1:].split("*")[0]
    if "*" in text:
        text = streams.sentence(body).decode().strip()
    string = parse_string(text)
    assert (string.valid if name == "valid" else string.values[name]) == value


def wrong(body: str) -> bytes:
    return streams.sentence(body)


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (b"", "begins with $, : or 00 90, not with nothing"),
        (b"HCHDM,093.8,M*2B", "not with 48 43 48 44"),
        (b"$HCHDM,093.8,M*2C\r\n", "the checksum is 2C, but the characters give 2B"),
        (b"$HCHDM,093.8,M*2B7\r\n", "the checksum is 2B7"),
        (b"$HCHDM,093.8,M\r\n",
         "the end is missing: a sentence ends with * and two hex digits, not ',093.8,M'"),
        (b"$HCHDM,093.8,M*2", "the end is missing"),
        (b"$HCHDM,09\x003.8,M*2B\r\n", "byte 9 is 0x00; a string has printable characters only"),
        (b"$HCHDM,09$HCHDM,093.8,M*2B\r\n", "byte 9 is 0x24"),
        (b"$HCHDM," + b"0" * 300 + b",M*2B\r\n", "at most 255 bytes, not 314"),
        (b":12345  0000H 0123 -0456\r\n", "TSS2 has 25 characters, not 24"),
        (b":1234x  0000H 0123 -0456F\r\n", "TSS2, heading: '1234x' is not a number"),
        (b":12345  0000Q 0123 -0456F\r\n", "'Q' stands where H does"),
        (EM1000[:-1], "EM1000 has 10 bytes, not 9"),
        (EM1000 + b"\0", "EM1000 has 10 bytes, not 11"),
        (wrong("HCHDM,093.8,T"), "HCHDM, the letter after it: 'T' stands where M does"),
        (wrong("HCHDM,x,M"), "HCHDM, heading: 'x' is not a number"),
        (wrong("HCHDM,nan,M"), "'nan' is not a number"),
        (wrong("HCHDM,1_0,M"), "'1_0' is not a number"),
        (wrong("HCHDM,093.8"), "HCHDM ends before the letter after it"),
        (wrong("HCHDM,093.8,M,1"), "HCHDM has 2 fields, not 3"),
        (wrong("HCHDG,98.3,0.1,N,12.6,W"), "HCHDG, deviation: 'N' is neither E nor W"),
        (wrong("GPGGA,091507,9014.4043,N,,,1,09,1.1,45.2,M,42.8,M,,"), "9014.4043 is beyond 90 degrees"),
        (wrong("GPGGA,091507,5260.0000,N,,,1,09,1.1,45.2,M,42.8,M,,"), "5260.0000,N is not an angle"),
        (wrong("GPGGA,091507,5214.4043,X,,,1,09,1.1,45.2,M,42.8,M,,"), "5214.4043,X is not an angle"),
        (wrong("GPGGA,9h,,,,,1,09,1.1,45.2,M,42.8,M,,"), "GPGGA, time: '9h' is not a time of day"),
        (wrong("GPGGA,091507,,,,,-1,09,1.1,45.2,M,42.8,M,,"), "GPGGA, quality: '-1' is not a whole number"),
        (wrong("GPZDA,091507.00,13,Jul,2025,00,00"), "GPZDA, date: '13,Jul,2025' is not a date"),
        (b"$PRDID,1,2\r\n", "PRDID ends before heading"),
        (b":12345X 0000H 0123X-0456F", "TSS2: the characters do not match :DDDDD SMHHHHQMRRRRSMPPPPE"),
        (b":+1.34  0000H 0123 -0456F", "TSS2: the characters do not match"),
        (bytes.fromhex("00 90 20 4E 00 00 00 00 00 00"), "EM1000: roll is at most 180, pitch 90"),
        (wrong("GPZDA,091507.00,12,1,2025,00,00"), "GPZDA, date: '12,1,2025' is not a date"),
        (wrong("GPRMC,091507,A,,,,,,,13072025,,,"), "GPRMC, date: '13072025' is not a date"),
    ],
)  # fmt: skip
def test_bad_strings_raise_one_sentence(data: bytes, problem: str) -> None:
    with pytest.raises(xbus.DecodeError) as caught:
        parse_string(data)
    assert problem in str(caught.value)
    assert "\n" not in str(caught.value)
    assert 0 <= caught.value.offset <= len(data)


@pytest.mark.parametrize(
    ("name", "values", "problem"),
    [
        ("HCHDM", {"heading": math.inf}, "HCHDM, heading: cannot encode inf"),
        ("HCHDM", {"heading": "north"}, "HCHDM, heading: cannot encode 'north'"),
        ("HCHDM", {"course": 1.0}, "HCHDM has no course; it has heading"),
        ("EM1000", {"roll": 400.0}, "EM1000: a value does not fit"),
        ("EM1000", {"roll": 181.0}, "EM1000: a value does not fit: roll is at most 180, pitch 90"),
        ("TSS2", {"heading": -12.5}, "TSS2: a value does not fit: the characters do not match"),
        (
            "TSS2",
            {"heading": 1234.5},
            "TSS2: a value does not fit: the characters do not match",
        ),
        ("PRDID", {"heading": math.inf}, "PRDID, heading: cannot encode inf"),
        ("TSS2", {"roll": math.inf}, "TSS2, roll: cannot encode inf"),
        ("GPGGA", {"lat": 91.0}, "GPGGA, lat: cannot encode 91.0"),
        ("GPGGA", {"time": 12.5}, "GPGGA, time: cannot encode 12.5"),
        ("GPGGA", {"dgps_station": "a\n$"}, "a field has printable characters only"),
        ("GPGGA", {"dgps_station": "1,2"}, "a field has printable characters only"),
        ("GPGSV", {}, "no string is called 'GPGSV'; there are HCHDM, "),
    ],
)
def test_invalid_values_are_not_encoded(name: str, values: dict[str, Any], problem: str) -> None:
    with pytest.raises(ValueError, match=r"^[^\n]*$") as caught:
        encode_string(name, values)
    assert problem in str(caught.value)


def test_unknown_string_names_are_rejected() -> None:
    for wrong_name in (1, None, b"HEHDT"):
        with pytest.raises(TypeError, match="a string type is a StringType or its name"):
            encode_string(wrong_name)  # type: ignore[arg-type]
    for many in (StringType.HEHDT | StringType.HEROT, StringType(0)):
        with pytest.raises(ValueError, match="expected one string type, not"):
            encode_string(many)
    with pytest.raises(ValueError, match="0x8100 has bits that are not string types"):
        xbus.read_log(b"", strings=StringType.HEHDT | 0x8000)
    assert encode_string("HEHDT", {"heading": np.float32("nan")}) == encode_string("HEHDT")


def test_texts_are_complete_in_tables() -> None:
    wires = [encode_string("GPGGA", {"dgps_station": name}) for name in ("0120", "12345678", "")]
    table = xbus.read_log(b"".join(wires)).strings.table("GPGGA")
    assert table["dgps_station"].tolist() == ["0120", "12345678", ""]


@pytest.mark.parametrize("kind", list(StringType))
def test_missing_values_are_empty_fields(kind: StringType) -> None:
    """Missing values are empty fields, except in TSS2 and EM1000, whose fields have fixed positions."""
    wire = encode_string(kind)
    values = parse_string(wire).values
    assert xbus.read_log(wire, strict=True, strings=[kind]).strings[0].values == values
    if kind in (StringType.TSS2, StringType.EM1000):
        assert set(values.values()) == {0.0}
    else:
        assert {value for value in values.values() if value is not None} <= {"T", "A", "V"}
    nans = {
        field.name: math.nan
        for field in STRING_FIELDS[kind].fields
        if field.form.dtype == "f8" and field.name
    }
    assert encode_string(kind, nans) == wire


# ---------------------------------------------------------------------------------------------
# Round trips of values
# ---------------------------------------------------------------------------------------------

#: Values of a field, by how it is written.
RANGES: dict[str, st.SearchStrategy[Any]] = {
    "heading": st.floats(0, 359.9), "lat": st.floats(-90, 90), "lon": st.floats(-180, 180),
    "quality": st.integers(0, 9), "satellites": st.integers(0, 99), "status": st.sampled_from("AV"),
    "heading_type": st.sampled_from("TGM"), "time": st.times(), "mode": st.sampled_from("ADN"),
    "date": st.dates(datetime.date(1980, 1, 1), datetime.date(2079, 12, 31)), "dgps_station": st.just("0120"),
    "heave": st.integers(-999, 999).map(float), "pitch": st.floats(-90, 90), "roll": st.floats(-99, 99),
    "zone_hours": st.integers(-13, 13).map(float), "zone_minutes": st.integers(0, 59).map(float),
}  # fmt: skip


@st.composite
def string_values(draw: st.DrawFn) -> tuple[StringType, dict[str, Any]]:
    kind = draw(st.sampled_from(list(StringType)))
    values = {}
    for field in STRING_FIELDS[kind].fields:
        if field.name and draw(st.integers(0, 5)):
            values[field.name] = draw(RANGES.get(field.name, st.floats(-300, 300)))
    return kind, values


@given(string_values())
def test_encoded_values_round_trip(string: tuple[StringType, dict[str, Any]]) -> None:
    """Values agree to the last encoded digit; encoding them again gives the same bytes."""
    kind, values = string
    wire = encode_string(kind, values)
    assert len(wire) <= STRING_FIELDS[kind].length + 8
    found = parse_string(wire).values
    assert encode_string(kind, found) == wire
    for name, value in values.items():
        if isinstance(value, float):
            assert found[name] == pytest.approx(
                value, abs=0.051 if name not in ("lat", "lon") else 1e-4
            )
        elif not isinstance(value, datetime.time):
            assert found[name] == value
        else:
            fraction = 10_000 if kind is not StringType.GPRMC else 1_000_000
            assert found[name] == value.replace(
                microsecond=value.microsecond // fraction * fraction
            )


@given(st.floats(-90, 90), st.floats(-180, 180))
def test_minutes_are_never_sixty(lat: float, lon: float) -> None:
    values = parse_string(encode_string("GPRMC", {"lat": lat, "lon": lon})).values
    assert (values["lat"], values["lon"]) == pytest.approx((lat, lon), abs=0.005 / 60 + 1e-9)


#: The names of the fields in pynmeagps; None if it represents the value in another way.
PEER = {
    "HCHDM": {"heading": "headingM"},
    "HCHDG": {
        "heading": "headingM", "deviation": "deviation deviationEW", "variation": "variation variationEW",
    },
    "HCMTW": {"temperature": "temp"},
    "HEHDT": {"heading": "headingT"},
    "HEROT": {"rate_of_turn": "rot"},
    "GPGGA": {
        "lat": "lat", "lon": "lon", "quality": "quality", "satellites": "numSV", "hdop": "HDOP",
        "height_msl": "alt", "geoid_separation": "sep", "time": "time",
    },
    "GPZDA": {"time": "time"},
    "GPRMC": {
        "lat": "lat", "lon": "lon", "speed": "spd", "course": "cog", "status": "status", "date": "date",
        "variation": "mv mvEW", "time": "time",
    },
}  # fmt: skip


@pytest.mark.parametrize("name", PEER)
def test_pynmeagps_reads_the_same(name: str) -> None:
    pynmeagps = pytest.importorskip("pynmeagps")
    wires = [wire for string, wire, _ in WIRES if string == name]
    random.seed(0)
    device = xbus.SimulatedDevice(680, trajectory="drive", noise=1.0, time_to_fix=0.0)
    wires += [item.data for item in strings_of(device, [StringType[name]], 20, 2.0)]
    assert len(wires) > 30
    for wire in wires:
        peer, own = pynmeagps.NMEAReader.parse(wire), parse_string(wire).values
        for field, attributes in PEER[name].items():
            number, *letter = (getattr(peer, part) for part in attributes.split())
            if letter:
                number = number if number == "" or letter[0] == "E" else -number
            value = own[field]
            if isinstance(value, float):
                assert number == pytest.approx(value, abs=1e-9), wire
            else:
                assert number == ("" if value is None else value), wire
        if name == "GPZDA":
            assert (peer.year, peer.month, peer.day) == own["date"].timetuple()[:3]


# ---------------------------------------------------------------------------------------------
# Streams
# ---------------------------------------------------------------------------------------------


@st.composite
def mixed_streams(draw: st.DrawFn) -> bytes:
    """Draws alternating frames and strings, some of them damaged."""
    rng = random.Random(draw(SEEDS))
    pieces = streams.random_frames(rng, draw(st.integers(0, 10)))
    pieces += [streams.random_string(rng) for _ in range(draw(st.integers(0, 20)))]
    rng.shuffle(pieces)
    return edited(b"".join(pieces), draw(st.lists(edits(), max_size=4)))


@given(mixed_streams(), st.booleans())
def test_the_reference_decodes_the_same(stream: bytes, named: bool) -> None:
    strings = ["EM1000"] if named else []
    expected = facts_of(decode(stream, named=StringType.EM1000 if named else 0))
    log = xbus.read_log(stream, strings=strings)
    assert differences(facts(log), expected) == []
    parts = xbus.iter_log(stream, block_bytes=40, strings=strings)
    assert differences(facts(*parts), expected) == []


@given(damaged_streams(), st.integers(0, 100))
def test_every_byte_is_in_a_frame_a_string_or_damage(stream: bytes, seed: int) -> None:
    stream += streams.random_string(random.Random(seed))
    log = xbus.read_log(stream)
    scanner = Scanner(65535)
    end = 0
    for item in scanner.feed(stream) + scanner.close():
        assert item.offset == end
        if isinstance(item, xbus.Message):
            # Preamble, BID, MID, length and checksum; in extended form the length has two bytes more.
            end += len(item.payload) + (7 if stream[item.offset + 3] == 0xFF else 5)
        else:
            end += len(item.data) if isinstance(item, String) else item.length
    assert end == len(stream)
    found = [item for item in Scanner(65535).feed(stream) if isinstance(item, String)]
    assert [string.sample for string in log.strings][: len(found)] == [
        item.sample for item in found
    ]


@given(st.sampled_from(WIRES[:-1]), st.lists(edits(), min_size=1, max_size=2))
def test_parser_and_scanner_agree(row: tuple[str, bytes, Any], changes: list[Any]) -> None:
    """A text that parses alone is a string in a stream; otherwise the text or its fields are invalid."""
    text = edited(row[1], changes)
    found = Scanner().feed(text) + Scanner().close()
    is_string = [item for item in found if isinstance(item, String)] == [
        String(StringType[row[0]], text, 0, 0)
    ]
    try:
        parsed = parse_string(text)
    except xbus.DecodeError as error:
        problem = str(error)
        assert row[0] in problem or not is_string
    else:
        assert is_string or not text.endswith(b"\n") or parsed.type is not StringType[row[0]]


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"$HCHDM,093.8,M*2C\r\n", "checksum"),
        (b"$HCHDM,093.8,M*2B", "truncated"),
        (b"$HCHDM,09", "truncated"),
        (b"$HCHDM,093.8,M\r\n", "no preamble"),
        (b"$HCHDM,0\x0093.8,M*2B\r\n", "no preamble"),
        (b"$HCHDM," + b"0" * 300 + b",M*00\r\n", "too long"),
        (b":12345  0000H 0123 -0456F", "truncated"),
        (EM1000, "no preamble"),
    ],
)
def test_a_bad_string_is_damage(data: bytes, reason: str) -> None:
    """Adjacent frames and strings are not affected."""
    log = xbus.read_log(SAMPLE + data)
    assert log.damage.tolist() == [(len(SAMPLE), len(data), reason)]
    assert log.stats.checksum_errors == (reason == "checksum")
    good = b"$HEHDT,123.45,T*1E\r\n"
    log = xbus.read_log(SAMPLE + good + data + good + SAMPLE)
    assert [string.data for string in log.strings] == [good, good]
    assert len(log) == 2
    assert log.stats.skipped_bytes == len(data)


def test_unlisted_strings_are_not_damage() -> None:
    """An unlisted string is kept, and pynmeagps can parse the text."""
    wire = streams.sentence("GPGSV,1,1,01,05,40,083,46")
    log = xbus.read_log(SAMPLE + wire + SAMPLE, strict=True)
    (string,) = log.strings
    assert (string.type, string.data, string.values, string.units) == (None, wire, {}, {})
    assert (string.name, str(string)) == ("GPGSV", wire.decode().strip())
    assert string.valid is None
    assert log.strings.counts == {"": 1}
    assert "others: 1" in repr(log.strings)
    pynmeagps = pytest.importorskip("pynmeagps")
    assert pynmeagps.NMEAReader.parse(string.data).svid_01 == 5


def test_an_unknown_frame_between_strings() -> None:
    """Strings count as neighbours like frames: a frame that begins after a string is in step."""
    strange, string = xbus.encode_frame(0xB2, b"\1\2"), b"$HEHDT,123.45,T*1E\r\n"
    log = xbus.read_log(string + strange + string, strict=True)
    assert [message.mid for message in log.messages] == [0xB2]


def test_em1000_is_found_only_where_enabled() -> None:
    stream = EM1000 * 3 + SAMPLE + EM1000
    assert len(xbus.read_log(stream).strings) == 0
    assert len(xbus.read_log(stream, strings=[StringType.EM1000]).strings) == 4
    for payload in (b"\0\x20", b"\0\0\0\x20\0\x0a"):
        enabled = xbus.encode_frame(0x8F, payload)
        log = xbus.read_log(EM1000 + enabled + stream)
        assert log.stats.strings == 4
        assert log.damage["length"].tolist() == [10]
        off = xbus.encode_frame(0x8F, bytes(len(payload)))
        assert xbus.read_log(enabled + off + stream).stats.strings == 0
        ack = xbus.encode_frame(0x8F)
        assert xbus.read_log(enabled + ack + stream).stats.strings == 4


def test_em1000_in_a_truncated_stream() -> None:
    """A truncated EM1000 string does not affect the others."""
    for cut in range(1, 10):
        log = xbus.read_log(EM1000 * 2 + EM1000[:cut] + EM1000 * 2, strings=["EM1000"])
        assert log.stats.strings == 4, cut


def test_em1000_is_rarely_found_in_noise() -> None:
    noise = np.random.default_rng(0).integers(0, 256, 1_000_000, np.uint8)
    assert xbus.read_log(noise, strings=["EM1000"]).stats.strings < 4


# ---------------------------------------------------------------------------------------------
# Log.strings
# ---------------------------------------------------------------------------------------------


@pytest.fixture
def mixed() -> bytes:
    """A second at 400 Hz, each sample with a heading, every tenth with all other strings."""
    stream = []
    for i in range(400):
        stream.append(xbus.encode_sample({"packet_counter": i, "sample_time_fine": 25 * i}))
        stream.append(encode_string("HEHDT", {"heading": i / 10}))
        if i % 10 == 0:
            stream += [wire for _, wire, _ in WIRES[:-1]]
    return b"".join(stream)


def test_a_mixed_stream_loses_nothing(mixed: bytes) -> None:
    log = xbus.read_log(mixed, strict=True)
    assert len(log) == 400
    assert log.stats.strings == 400 + 40 * len(WIRES[:-1]) == len(log.strings)
    assert log.stats.skipped_bytes == log.stats.lost_samples == 0
    assert log.strings.counts["HEHDT"] == 440
    assert log.strings.counts["GPGGA"] == 40
    assert "960 strings" in repr(log) or f"{len(log.strings)} strings" in repr(log)
    assert log.strings[-1].values["heading"] == 39.9
    assert [string.offset for string in log.strings[:2]] == log.strings.offset[:2].tolist()
    with pytest.raises(IndexError):
        log.strings[len(log.strings)]


def test_a_table_of_strings(mixed: bytes) -> None:
    log = xbus.read_log(mixed)
    table = log.strings.table("HEHDT")
    assert table["heading"].dtype == np.float64
    own = table["sample"] == np.arange(len(table))  # noqa: F841
    assert table["heading"][table["heading"] != 123.45].tolist() == [i / 10 for i in range(400)]
    assert [log.strings[i].type for i in table["index"]] == [StringType.HEHDT] * 440
    assert np.isnan(table["host_time"]).all()
    gga = log.strings.table(StringType.GPGGA)
    assert gga["time"][0] == np.timedelta64((9 * 60 + 15) * 60 + 7, "s")
    assert np.isnan(gga["dgps_age"]).all()
    assert set(gga["dgps_station"]) == {""}
    assert log.strings.table("GPZDA")["date"][0] == np.datetime64("2025-07-13")
    assert len(log.strings.table("EM1000")) == 0
    assert [item.data for item in log.strings.named("GPZDA", "GPRMC")[:2]] == [
        wire[1] for wire in WIRES[12:14]
    ]
    with pytest.raises(ValueError, match="no string is called 'GPGSV'"):
        log.strings.table("GPGSV")


def test_strings_with_invalid_fields_are_null_rows() -> None:
    odd = streams.sentence("HEHDT,12,T,13")
    log = xbus.read_log(odd + encode_string("HEHDT", {"heading": 1.0}), strict=True)
    with pytest.raises(ValueError, match="HEHDT has 2 fields, not 3"):
        _ = log.strings[0].values
    table = log.strings.table("HEHDT")
    assert np.isnan(table["heading"]).tolist() == [True, False]
    assert table["heading_type"].tolist() == ["", "T"]


def test_strings_as_arrow(mixed: bytes) -> None:
    pa = pytest.importorskip("pyarrow")
    table = xbus.read_log(mixed).strings.to_arrow("GPGGA")
    assert table.num_rows == 40
    assert table.schema.field("lat").metadata == {b"unit": b"deg"}
    assert table["dgps_station"].null_count == table["dgps_age"].null_count == 40
    assert table["time"].type == pa.time64("us")
    assert table["time"][0].as_py() == datetime.time(9, 15, 7)
    empty = xbus.read_log(encode_string("GPGGA")).strings.to_arrow("GPGGA")
    assert empty["time"].null_count == empty["lat"].null_count == 1
    assert table["host_time"].type == pa.float64()


def test_parts_contain_their_strings(mixed: bytes) -> None:
    parts = list(xbus.iter_log(mixed, block_bytes=1000))
    assert len(parts) > 20
    assert [string.data for part in parts for string in part.strings] == [
        string.data for string in xbus.read_log(mixed).strings
    ]


def strings_of(
    device: xbus.SimulatedDevice, kinds: list[StringType], rate: float, seconds: float
) -> list[String]:
    """Returns what a virtual device sends when these strings are enabled."""
    with xbus.connect(device, strings=kinds) as connected:
        with connected.configure():
            connected.set_strings(kinds, rate, check_baudrate=False)
        count = round(rate * seconds) * len(kinds)
        return [connected.read_string() for _ in range(count)]
