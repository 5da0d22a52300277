"""Published frames, captures and hand-written cases, decoded by the package and by the reference.

The expected values are literals: printed in the manual (MT0101P, revision 2020.A), or shown by the
vendor's MT Manager for frames of real devices. `decode` and `scan` read the bytes twice, with the package
and with `reference`, and fail where the two differ; so a literal checks both. The captures and the list of
published frames are not part of the repository; the tests that read them skip where they are absent.
"""

from __future__ import annotations

import csv
import itertools
import math
import random
import re
import struct
from typing import Any

import numpy as np
import pytest

import reference
import streams
import xbus
from conftest import coarse, counter, differences, facts, facts_of, fine, shared, trigger
from reference import DAY, Damage, Frame, Reference, array, number, same_bits
from reference_mtdata import MTDATA
from streams import frame, mtdata2, packet, real
from xbus import _core

SAT_INFO = packet(0x7020, bytes(8))

# A frame with a good checksum that no device sends: accepted only in step.
STRANGE = frame(0xB2, b"\1\2\3")
WAKE_UP = frame(0x3E)


def decode(data: bytes) -> Reference:
    """Decodes a log with the package and with the reference, and asserts that they agree."""
    log = reference.decode(data)
    assert differences(facts(xbus.read_log(data)), facts_of(log)) == []
    return log


def scan(data: bytes, limit: int = reference.LONGEST) -> tuple[list[Frame], list[Damage], int]:
    """Returns frames, damage and checksum errors. Package and reference agree."""
    frames, damage, checksum_errors = reference.scan(data, limit)
    reader = _core.Reader(np.frombuffer(data, np.uint8), limit=limit, strict=False, wanted=None)
    while reader.advance(len(data) + 1):
        pass
    log = xbus.Log(reader.take())
    assert log.damage.tolist() == [tuple(stretch) for stretch in damage]
    assert (log.stats.frames, log.stats.checksum_errors) == (len(frames), checksum_errors)
    return frames, damage, checksum_errors


# ---------------------------------------------------------------------------------------------
# Numbers
# ---------------------------------------------------------------------------------------------

FLOAT32, FP1220, FP1632, FLOAT64 = range(4)


@pytest.mark.parametrize(
    ("precision", "raw", "value"),
    [
        (FLOAT32, "41 1C F5 C3", 9.8100004196167),
        (FLOAT64, "3F EA AE 0F C0 00 00 00", 0.833747744560242),
        (FP1220, "00 10 00 00", 1.0),
        (FP1220, "FF F0 47 35", -0.98261547088623),
        (FP1220, "FF FD C8 86", -0.13854408264160),
        (FP1220, "07 3B 35 C8", 115.70063018798828),
        (FP1220, "80 00 00 00", -2048.0),
        (FP1220, "7F FF FF FF", 2047.99999904632568),
        (FP1632, "00 00 00 00 00 01", 1.0),
        (FP1632, "00 00 00 00 FF FF", -1.0),
        (FP1632, "80 00 00 00 FF FF", -0.5),
        (FP1632, "00 00 00 01 00 01", 1.00000000023283064),
        (FP1632, "60 00 00 00 00 18", 24.375),
        (FP1632, "AD F0 52 98 00 39", 57.67944828234613),
        (FP1632, "64 A6 8A A8 00 1F", 31.393166223541),
        (FP1632, "3A D0 1E FC 00 79", 121.229738174938),
        (FP1632, "B7 0B 3C EB 00 38", 56.715015227673575),
        (FP1632, "F6 3F CA F0 FF FF", -0.038089100271463),
        (FP1632, "FF E3 E0 C4 FF FF", -0.000429107807576),
        (FP1632, "00 00 00 00 80 00", -32768.0),
        (FP1632, "FF FF FF FF 7F FF", 32767.99999999976717),
    ],
)
def test_number(precision: int, raw: str, value: float) -> None:
    """The four formats of Table 17; the fixed-point ones are exact in a double."""
    assert number(bytes.fromhex(raw), precision) == pytest.approx(value, rel=0, abs=1e-12)


def test_number_preserves_every_bit() -> None:
    """The bits of a NaN are preserved; fixed-point numbers round-trip."""
    for raw in ("7FC00001", "FF800001", "7F800000", "80000000"):
        value = number(bytes.fromhex(raw), FLOAT32)
        assert isinstance(value, reference.Float32)
        assert value.bits == int(raw, 16)
    for raw in ("7FF0000000000001", "FFF8000000000000", "7FF0000000000000"):
        assert struct.pack(">d", number(bytes.fromhex(raw), FLOAT64)).hex() == raw.lower()
    rng = random.Random(0)
    for precision, width in ((FP1220, 4), (FP1632, 6)):
        for _ in range(200):
            raw_bytes = rng.randbytes(width)
            assert streams.number(number(raw_bytes, precision), precision) == raw_bytes


# ---------------------------------------------------------------------------------------------
# Published frames
# ---------------------------------------------------------------------------------------------

# Frame, then its quantities with the digits that MT Manager or the manual printed, or where nothing
# was printed (MTi-630, the altitude of the MTi-680) as worked out from the bytes.
MTDATA2_FRAMES: dict[str, tuple[str, dict[str, Any]]] = {
    "manual, section 6": (
        "FA FF 36 31 10 20 02 DF C5 10 60 04 00 45 9D A0 40 20 0C BE DC 9A FA 3F 54 9F 37 41 1C BB "
        "70 80 20 0C BB AA 5C 80 3B 8C 55 01 BB 81 33 00 E0 20 04 00 00 00 81 45",
        {
            "packet_counter": 57285,
            "sample_time_fine": 4562336,
            "acceleration": "-0.43087 0.83055 9.79576",
            "rate_of_turn": "-0.0051990 0.0042826 -0.0039428",
            "status_word": 0x81,
        },
    ),
    "MTi-300, quaternion": (
        "FA FF 36 26 10 20 02 46 82 10 60 04 01 C4 FC 3E 20 10 10 3F 71 CE 6C BE A5 6B CF 3C 61 3B "
        "D8 BD 69 1D 25 E0 20 04 00 40 00 03 12",
        {
            "packet_counter": 18050,
            "sample_time_fine": 29686846,
            "quaternion": "0.94455600 -0.32308814 0.01374718 -0.05691256",
            "status_word": 0b00000000010000000000000000000011,
        },
    ),
    "MTi-300, clipping": (
        "FA FF 36 8B 10 20 02 FB 85 10 60 04 01 A4 98 DE 20 10 10 3F 2A 14 63 BE D7 EF A7 3C DE E5 "
        "08 3F 1D CE C9 40 20 0C C1 F2 46 C3 C1 EC E0 76 C2 8F 85 3F 40 10 0C BD 93 2C CC BD 92 0A "
        "16 BE 3A 6E EC 40 30 0C 42 51 94 64 C2 7B 5A 5A C1 CC C0 AE 80 20 0C 40 85 4D 6D C1 25 55 "
        "9E C0 90 8E 1F 80 30 10 3F 7F F8 98 3B AA 9E E5 BC 53 9E C0 BB B9 06 0C C0 20 0C 3E DC 74 "
        "39 BE 75 2B 48 3F AF 9A 3F 30 10 04 00 01 86 DE E0 20 04 00 48 14 01 8E",
        {
            "packet_counter": 64389,
            "sample_time_fine": 27564254,
            "quaternion": "0.66437358 -0.42175028 0.02720882 0.61643654",
            "acceleration": "-30.28455162 -29.60960007 -71.76024628",
            "delta_v": "-0.07186279 -0.07130830 -0.18206376",
            "free_acceleration": "52.39491272 -62.83823395 -25.59408188",
            "rate_of_turn": "4.16570139 -10.33340263 -4.51734877",
            "delta_q": "0.99988699 0.00520693 -0.01291627 -0.00564647",
            "magnetic_field": "0.43057421 -0.23942292 1.37189472",
            "baro_pressure": 100062,
            "status_word": 0b00000000010010000001010000000001,
        },
    ),
    "MTi-300, everything": (
        "FA FF 36 92 10 20 02 91 8D 10 60 04 01 36 3F A6 20 10 10 3F 35 E0 42 3F 31 CD 15 BD 9F 49 "
        "DB BD A9 38 CF 40 20 0C BD 63 5A 90 41 1D 08 D4 3E 5F AA 50 40 10 0C B9 11 68 00 3C C9 01 "
        "00 3A 0F 7D 00 40 30 0C BC 3B 29 80 3C 35 FC 00 3C A4 6E 00 80 20 0C 3C AE A2 41 BB 56 D8 "
        "00 BA D5 AC 01 80 30 10 3F 80 00 00 37 DF 88 01 B6 89 80 00 B6 08 C0 00 C0 20 0C BE FB FB "
        "F2 3F 33 C4 85 BF A0 A2 C1 08 10 04 42 16 80 00 30 10 04 00 01 86 E1 E0 20 04 00 40 00 03 "
        "DD",
        {
            "packet_counter": 37261,
            "sample_time_fine": 20332454,
            "quaternion": "0.71045315 0.69453555 -0.07777759 -0.08262789",
            "acceleration": "-0.05550629 9.81465530 0.21842313",
            "delta_v": "-0.00013867 0.02453661 0.00054736",
            "free_acceleration": "-0.01142347 0.01110744 0.02007198",
            "rate_of_turn": "0.02131760 -0.00327826 -0.00163019",
            "delta_q": "1.00000000 0.00002665 -0.00000410 -0.00000204",
            "magnetic_field": "-0.49215657 0.70221740 -1.25496686",
            "temperature": "37.62500000",
            "baro_pressure": 100065,
            "status_word": 0b00000000010000000000000000000011,
        },
    ),
    "MTi-300, all four formats": (
        "FA FF 36 51 10 20 02 3B DD 20 31 0C FF F0 47 35 FF FD C8 86 07 3B 35 C8 80 32 18 00 00 00 "
        "01 00 01 FF E3 E0 C4 FF FF FF EC 25 95 FF FF FF F4 64 E8 FF FF C0 23 18 3F EA AE 0F C0 00 "
        "00 00 BF DB C9 A7 60 00 00 00 3F F9 E2 06 20 00 00 00 08 10 04 41 DB 80 00 AC",
        {
            "packet_counter": 15325,
            "euler_angles": "-0.9826155 -0.1385441 115.7006302",
            "delta_q": "1.000000000233 -0.000429107808 -0.000302935718 -0.000177090988",
            "magnetic_field": "0.833747744560242 -0.434182971715927 1.617681622505188",
            "temperature": "27.4375000",
        },
    ),
    "MTi-300, format bits on an integer": (
        "FA FF 36 37 10 20 02 FE 78 20 10 10 3F 25 0C 01 BB CC 0D D7 BB 22 74 0C 3F 43 AF 57 C0 21 "
        "0C 00 0F 64 22 FF FB D6 22 00 1C 80 03 08 12 06 60 00 00 00 00 18 30 13 04 00 01 8D 25 46",
        {
            "packet_counter": 65144,
            "quaternion": "0.6447144 -0.00622723 -0.00247884 0.7643942",
            "magnetic_field": "0.9619465 -0.2602215 1.7812529",
            "temperature": "24.375000000000",
            "baro_pressure": 101669,
        },
    ),
    "MTi-300, rotation matrix, Float32": (
        "FA FF 36 27 20 20 24 BE 60 AC 04 BF 79 BE 2E 3C 46 F8 07 3F 79 B2 54 BE 60 E3 40 BC A5 71 "
        "AF 3C B7 3F AE 3B F2 F1 0C 3F 7F ED D0 C8",
        {
            "rotation_matrix": "-0.21940619 -0.97555816 0.01214410 0.97537732 -0.21961689 "
            "-0.02019581 0.02236923 0.00741399 0.99972248"
        },
    ),
    "MTi-300, rotation matrix, Fp1220": (
        "FA FF 36 27 20 21 24 FF FC 48 7F FF F0 70 56 00 00 2F 46 00 0F 8E FC FF FC 47 BA FF FF B1 "
        "30 00 00 57 A5 00 00 1B A9 00 0F FE F8 1A",
        {
            "rotation_matrix": "-0.23230076 -0.97257423 0.01154137 0.97240829 -0.23248863 "
            "-0.01924133 0.02139759 0.00675297 0.99974823"
        },
    ),
    "MTi-300, rotation matrix, Fp1632": (
        "FA FF 36 39 20 22 36 C3 6A 0B 00 FF FF 07 49 CF 00 FF FF 02 CF 0A 28 00 00 F8 AB B7 00 00 "
        "00 C3 5E C2 00 FF FF FB 36 FE C0 FF FF 05 50 6C 38 00 00 01 98 8A 4A 00 00 FF F0 9E 00 00 "
        "00 A9",
        {
            "rotation_matrix": "-0.23666316 -0.97153002 0.01097167 0.97137016 -0.23683536 "
            "-0.01869209 0.02075840 0.00623383 0.99976528"
        },
    ),
    "MTi-300, rotation matrix, Float64": (
        "FA FF 36 4B 20 23 48 BF CE 05 ED 00 00 00 00 BF EF 1B 07 E0 00 00 00 3F 84 CB 89 A0 00 00 "
        "00 3F EF 19 F2 A0 00 00 00 BF CE 0A B9 00 00 00 00 BF 91 7A 31 00 00 00 00 3F 93 6D DC 00 "
        "00 00 00 3F 78 06 49 80 00 00 00 3F EF FE 62 80 00 00 00 3C",
        {
            "rotation_matrix": "-0.23455584 -0.97204965 0.01015384 0.97191745 -0.23470223 "
            "-0.01706769 0.01897377 0.00586537 0.99980283"
        },
    ),
    "MTi-300, rebuilt, with pressure": (
        "FA FF 36 8B 10 20 02 A6 55 10 60 04 00 57 47 2E 20 10 10 3F 7F 7D C4 BC 10 10 7D 3B A1 57 "
        "70 BD 7E C6 56 40 20 0C BD A2 1A F8 BE 2A 8E 96 41 1D 27 A2 40 10 0C B9 4F C8 00 B9 DA 24 "
        "00 3C C9 28 80 40 30 0C 3C 02 C8 9C 3C 35 F6 C8 3C DB 0C 00 80 20 0C BB B1 7D 81 BB 96 32 "
        "00 3C 01 E8 41 80 30 10 3F 80 00 00 B6 E3 30 01 B6 C0 40 00 37 26 48 00 C0 20 0C BE 99 9C "
        "24 3F B6 1B 56 3F 16 6A EB 30 10 04 00 01 86 DE E0 20 04 00 40 00 03 8B",
        {
            "packet_counter": 42581,
            "sample_time_fine": 5719854,
            "quaternion": "0.99801278 -0.00879299 0.00492375 -0.06220087",
            "acceleration": "-0.07915300 -0.16655955 9.82217598",
            "delta_v": "-0.00019816 -0.00041607 0.02455544",
            "free_acceleration": "0.00798240 0.01110620 0.02673912",
            "rate_of_turn": "-0.00541657 -0.00458360 0.00792891",
            "delta_q": "1.00000000 -0.00000677 -0.00000573 0.00000991",
            "magnetic_field": "-0.30001938 1.42270923 0.58756894",
            "baro_pressure": 100062,
            "status_word": 0b00000000010000000000000000000011,
        },
    ),
    "MTi-300, rebuilt, without pressure": (
        "FA FF 36 84 10 20 02 A6 51 10 60 04 00 57 46 CA 20 10 10 3F 7F 7D AF BC 10 17 8D 3B A1 5D "
        "51 BD 7E DC 78 40 20 0C BD 9A 97 A6 BE 26 F9 BF 41 1C B2 E4 40 10 0C B9 46 44 00 B9 D5 9C "
        "00 3C C8 93 10 40 30 0C 3C 3F EE 14 3C 5F 69 B0 BA F2 80 00 80 20 0C BB 70 6E 03 BB C2 3D "
        "00 BB D4 99 03 80 30 10 3F 80 00 00 B6 99 E0 01 B6 F8 A0 00 B7 08 10 00 C0 20 0C BE 91 DC "
        "FF 3F B6 6C 36 3F 18 71 68 E0 20 04 00 40 00 03 9B",
        {
            "packet_counter": 42577,
            "sample_time_fine": 5719754,
            "quaternion": "0.99801153 -0.00879468 0.00492445 -0.06222197",
            "acceleration": "-0.07548456 -0.16306208 9.79367447",
            "delta_v": "-0.00018908 -0.00040743 0.02448419",
            "free_acceleration": "0.01171448 0.01363604 -0.00185013",
            "rate_of_turn": "-0.00366867 -0.00592768 -0.00648797",
            "delta_q": "1.00000000 -0.00000459 -0.00000741 -0.00000811",
            "magnetic_field": "-0.28488919 1.42517734 0.59548044",
            "status_word": 0b00000000010000000000000000000011,
        },
    ),
    "MTi-300, rebuilt, without field": (
        "FA FF 36 75 10 20 02 8D 90 10 60 04 00 54 DB F1 20 10 10 3F 7F 89 11 BC 11 1D FA 3B A0 CE "
        "F0 BD 73 25 73 40 20 0C BD DC F9 D0 BE 3C 86 19 41 1D 0B 47 40 10 0C B9 8D B0 00 B9 F1 48 "
        "00 3C C9 04 30 40 30 0C BC B9 89 2E BB 09 8C 00 3C A7 08 00 80 20 0C BA 63 BC 01 BC 04 D6 "
        "3F BB 6D E3 FE 80 30 10 3F 80 00 01 B5 91 C0 00 B7 2A 08 00 B6 98 40 00 E0 20 04 00 40 00 "
        "03 77",
        {
            "packet_counter": 36240,
            "sample_time_fine": 5561329,
            "quaternion": "0.99818522 -0.00885724 0.00490748 -0.05936189",
            "acceleration": "-0.10789835 -0.18410529 9.81525326",
            "delta_v": "-0.00027025 -0.00046021 0.02453813",
            "free_acceleration": "-0.02264842 -0.00209880 0.02038956",
            "rate_of_turn": "-0.00086874 -0.00810772 -0.00362992",
            "delta_q": "1.00000012 -0.00000109 -0.00001013 -0.00000454",
            "status_word": 0b00000000010000000000000000000011,
        },
    ),
    "MTi-630, status last": (
        "FA FF 36 4E 10 60 04 02 53 35 CB 20 10 10 3F 7F FA 66 BB 40 34 B8 3C 49 96 2D 3B 5A 1F 82 "
        "80 20 0C 39 FF 91 01 BA EC DD 81 BA 86 53 80 40 20 0C BE 64 DB 99 BC E7 FF 83 41 1D C2 CF "
        "C0 20 0C BE 90 48 80 3F 67 32 04 BF 54 89 04 E0 20 04 00 00 00 03 C9",
        {"sample_time_fine": 39007691, "status_word": 3},
    ),
    "MTi-630, counter last": (
        "FA FF 36 26 20 10 10 3E FC 23 42 3F 00 E0 28 BF 01 8F A7 3E FE EE B1 10 60 04 00 0A F8 4C "
        "E0 20 04 00 00 00 02 10 20 02 1B C5 D4",
        {"sample_time_fine": 718924, "status_word": 2, "packet_counter": 7109},
    ),
    "MTi-630, Euler angles": (
        "FA FF 36 16 10 60 04 09 3A 7C B7 20 30 0C BF 49 1A 52 BE C3 6A 10 C3 2E E2 EF 3E",
        {"sample_time_fine": 154827959, "euler_angles": "-0.7855579 -0.3816686 -174.8864594"},
    ),
    "MTi-680, position and velocity in Fp1632": (
        "FA FF 36 4F 10 20 02 0B 0A 10 60 04 00 C5 50 98 20 30 0C 43 33 EE EA BF 93 44 FA C0 15 E3 "
        "57 E0 20 04 00 00 00 02 50 42 0C 64 A6 8A A8 00 1F 3A D0 1E FC 00 79 50 22 06 B7 0B 3C EB "
        "00 38 D0 12 12 FA 7C 28 88 FF FF 03 85 F5 88 00 00 F4 DD EB 10 FF FF AF",
        {
            "packet_counter": 2826,
            "sample_time_fine": 12931224,
            "euler_angles": "179.9332581 -1.1505425 -2.3420007",
            "status_word": 2,
            "lat_lon": "31.393166223541 121.229738174938",
            "altitude_ellipsoid": "56.715015227674",
            "velocity_xyz": "-0.021542994305 0.013762803748 -0.043488796800",
        },
    ),
}


@pytest.mark.parametrize(("raw", "expected"), MTDATA2_FRAMES.values(), ids=MTDATA2_FRAMES)
def test_published_mtdata2(raw: str, expected: dict[str, Any]) -> None:
    """Every quantity, to the last digit that was printed."""
    log = decode(bytes.fromhex(raw))
    assert len(log.samples) == 1
    assert log.stats["skipped_bytes"] == 0
    values = {name: rows[0].values for (name, _), rows in log.columns.items()}
    assert set(expected) <= set(values)
    for name, wanted in expected.items():
        if isinstance(wanted, int):
            assert values[name] == wanted
            continue
        got = values[name] if isinstance(values[name], tuple) else (values[name],)
        for text, value in zip(wanted.split(), got, strict=True):
            # One unit of the last digit: some were printed from rounded numbers.
            assert value == pytest.approx(float(text), rel=0, abs=10.0 ** -len(text.split(".")[1]))


def test_published_gnss_pvt_data() -> None:
    """A GNSS message of an MTi-G-710 with a fix: Table 25 field by field, and what follows it."""
    raw = (
        "FA FF 36 7C 70 10 5E 02 F5 C9 2A 07 E3 01 14 0D 2F 18 37 00 00 00 05 0E E3 2A 24 03 01 0B "
        "00 07 15 22 E8 22 61 2F 55 00 01 3F 71 00 00 A9 2A 00 00 08 D3 00 00 08 18 FF FF FF E5 00 "
        "00 00 0A FF FF FF FE 00 00 00 1D 00 00 00 00 00 00 01 5E 00 E5 51 9A 00 02 00 00 00 9A 00 "
        "8B 00 44 00 70 00 53 00 37 00 3E 10 10 0C 0E E6 B2 80 07 E3 01 14 0D 2F 18 37 10 60 04 03 "
        "14 F2 54 10 20 02 A9 98 08"
    )
    log = decode(bytes.fromhex(raw))
    assert log.columns["gnss_pvt_data", None][0].values == {
        "itow": 49662250,
        "year": 2019,
        "month": 1,
        "day": 20,
        "hour": 13,
        "min": 47,
        "sec": 24,
        "valid": 0x37,
        "tAcc": 5,
        "nano": 249768484,
        "fixtype": 3,
        "flags": 1,
        "numSV": 11,
        "Reserved1": 0,
        "lon": 118825704,
        "lat": 576794453,
        "height": 81777,
        "hMSL": 43306,
        "hAcc": 2259,
        "vAcc": 2072,
        "velN": -27,
        "velE": 10,
        "velD": -2,
        "gSpeed": 29,
        "headMot": 0,
        "sAcc": 350,
        "headAcc": 15028634,
        "headVeh": 131072,
        "gdop": 154,
        "pdop": 139,
        "tdop": 68,
        "vdop": 112,
        "hdop": 83,
        "ndop": 55,
        "edop": 62,
    }
    utc = {"ns": 250000000, "year": 2019, "month": 1, "day": 20, "hour": 13, "minute": 47}
    assert log.columns["utc_time", None][0].values == utc | {"second": 24, "valid": 0x37}
    assert log.time == [5170.4404]
    assert log.packet_counter == [43416]


def test_published_gnss_sat_info() -> None:
    """The 28 satellites of Table 26 in a message of an MTi-G-710."""
    raw = (
        "FA FF 36 9D 70 20 78 02 F5 DA BE 1C 00 00 00 00 05 16 14 00 08 1D 1F 00 0A 0B 1C 00 0B 00 "
        "11 00 0D 1C 1E 00 0F 15 14 00 11 11 14 00 12 00 11 00 14 16 1C 00 18 1C 1F 00 1C 0A 13 00 "
        "1E 16 1C 01 78 00 01 01 7C 00 01 01 7E 00 01 05 03 12 14 05 04 00 21 05 05 00 21 06 01 16 "
        "14 06 06 0C 1C 06 07 27 1F 06 08 1F 1F 06 09 24 1F 06 0A 24 1F 06 10 00 21 06 11 20 1F 06 "
        "12 00 11 06 18 00 10 10 10 0C 2C B4 17 80 07 E3 01 14 0D 2F 1C 37 10 70 04 00 00 14 36 10 "
        "60 04 03 15 A2 1C 10 20 02 AB 2E E5"
    )
    log = decode(bytes.fromhex(raw))
    info = log.columns["gnss_sat_info", None][0].values
    assert (info["itow"], info["numSvs"], len(info["satellites"])) == (49666750, 28, 28)
    assert info["satellites"][0] == (0, 5, 22, 0x14)
    assert info["satellites"][12] == (1, 120, 0, 1)
    assert info["satellites"][27] == (6, 24, 0, 16)
    assert log.time == [5174.9404]
    flat, offsets = reference.satellites(log)
    assert flat.dtype.names == ("gnssId", "svId", "cno", "flags")
    assert (len(flat), offsets.tolist()) == (28, [0, 28])


OTHER_FRAMES: dict[str, tuple[int, str]] = {
    "FA FF 3E 00 C3": (0x3E, ""),
    "FA FF 31 00 D0": (0x31, ""),
    "FA FF 01 04 03 60 08 A6 EB": (0x01, "036008A6"),
    "FA FF 03 04 03 70 03 F8 8C": (0x03, "037003F8"),
    "FA FF 13 0B 01 08 02 00 00 00 25 00 01 15 34 69": (0x13, "0108020000002500011534"),
    "FA FF 42 01 29 95": (0x42, "29"),
    "FA FF C1 08 10 20 FF FF 10 60 FF FF 9C": (0xC1, "1020FFFF1060FFFF"),
    "FA FF 75 07 01 40 80 3A 85 02 00 03": (0x75, "0140803A850200"),
    "FA FF 8D 00 74": (0x8D, ""),
    "FA FF ED 00 14": (0xED, ""),
    "FA FF 05 02 04 80 76": (0x05, "0480"),
}


def test_published_messages() -> None:
    """Messages of devices are plausible: they are found between garbage, and returned in order."""
    log = decode(b"\x11".join(bytes.fromhex(raw) for raw in OTHER_FRAMES))
    expected = [(mid, bytes.fromhex(payload)) for mid, payload in OTHER_FRAMES.values()]
    assert [(message.mid, message.payload) for message in log.messages] == expected
    assert log.stats["skipped_bytes"] == len(OTHER_FRAMES) - 1


def published() -> list[tuple[str, bytes]]:
    """The list of published frames: kind (CAP, REB, DOC or HOST) and bytes."""
    found = []
    for line in shared("spec/frames.txt").read_text().splitlines():
        if line.startswith("FA"):
            raw, comment = line.split("#", 1)
            found.append((comment.split("]")[0].strip(" ["), bytes.fromhex(raw)))
    return found


def test_published_frames_are_found_back_to_back() -> None:
    """All published frames in a row are found, including those of a host: they are in step."""
    frames = [raw for _, raw in published()]
    assert len(frames) > 90
    log = decode(b"".join(frames))
    assert [frame(f.mid, f.payload) for f in log.frames] == frames
    assert not log.damage


def test_published_device_frames_are_found_in_garbage() -> None:
    """Frames from a device with a known length are found between garbage."""
    garbage = b"\x00\xfa\xff"
    count = 0
    for kind, raw in published():
        found = scan(raw)[0][0]
        sent_by_device = found.mid == 0x36 or reference.LENGTHS.get(found.mid)
        frames, damage, _ = scan(garbage + raw + garbage)
        if kind != "HOST" and sent_by_device:
            assert [f.offset for f in frames] == [len(garbage)], raw.hex(" ")
            assert [stretch.length for stretch in damage] == [3, 3]
            count += 1
        elif found.mid not in reference.LENGTHS:
            assert frames == []
    assert count > 40


# ---------------------------------------------------------------------------------------------
# Captures of a real device
# ---------------------------------------------------------------------------------------------

CAPTURES = [f"mtig710-{i}" for i in range(1, 6)]
PRECISIONS = dict(zip(CAPTURES, (0, 1, 2, 3, 0), strict=True))

# Names of quantities in the other decoder, if they differ by more than case.
OTHER_NAMES = {
    "AltitudeEllipsoid": "altitude_ellipsoid",
    "BaroPressure": "baro_pressure",
    "DeltaQ": "delta_q",
    "DeltaV": "delta_v",
    "EulerAngles": "euler_angles",
    "FreeAcceleration": "free_acceleration",
    "GNSSPVTData": "gnss_pvt_data",
    "GNSSSatInfo": "gnss_sat_info",
    "LatLon": "lat_lon",
    "MagneticField": "magnetic_field",
    "PacketCounter": "packet_counter",
    "PositionECEF": "position_ecef",
    "RateOfTurn": "rate_of_turn",
    "RotationMatrix": "rotation_matrix",
    "SampleTimeCoarse": "sample_time_coarse",
    "SampleTimeFine": "sample_time_fine",
    "StatusByte": "status_byte",
    "StatusWord": "status_word",
    "UTCTime": "utc_time",
    "VelocityXYZ": "velocity_xyz",
}


def golden_numbers(name: str, text: str) -> list[float] | str:
    """Returns what the other decoder printed for one quantity."""
    if name == "utc_time":
        return text
    if name.startswith("status"):
        return [int(text, 2)]
    if text.startswith("&{"):
        return [float(x.replace("3DFix", "3")) for x in re.findall(r":(\S+?)[ }]", text)]
    return [float(text)]


def our_numbers(name: str, values: Any) -> list[float] | str:
    """Returns the same from the reference."""
    if name == "utc_time":
        date = "{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}".format(**values)
        return f"{date}.{values['ns']:09}".rstrip("0").rstrip(".") + "Z"
    if isinstance(values, dict):
        return [float(v) for v in values.values() if not isinstance(v, list)]
    return list(map(float, values)) if isinstance(values, tuple) else [float(values)]


@pytest.mark.parametrize("capture", CAPTURES)
def test_capture(capture: str) -> None:
    """100 frames without damage have exactly the numbers that another decoder printed."""
    raw = shared(f"captures/{capture}/raw.bin").read_bytes()
    golden = shared(f"captures/{capture}/decoded.golden").read_text()
    log = decode(raw)
    assert log.stats == {
        "bytes": len(raw),
        "frames": 100,
        "samples": 100,
        **dict.fromkeys(
            ["messages", "malformed", "unfit", "strings", "skipped_bytes", "checksum_errors"], 0
        ),
        **dict.fromkeys(["lost_samples", "gaps"], 0),
    }
    assert not log.unknown

    packets = {(row.sample, name): row for (name, _), rows in log.columns.items() for row in rows}
    compared = 0
    for sample, block in enumerate(golden.split("MTData2\n")[1:]):
        lines = [line.strip() for line in block.strip().splitlines()]
        for theirs, text in zip(lines[::2], lines[1::2], strict=True):
            name = OTHER_NAMES.get(theirs, theirs.lower())
            row = packets[sample, name]
            assert our_numbers(name, row.values) == golden_numbers(name, text), (sample, name)
            if row.data_id & 0xFFF0 in reference.REALS:
                assert row.data_id & 0x3 == PRECISIONS[capture]
            compared += 1
    assert compared == len(packets)


@pytest.mark.parametrize("capture", CAPTURES)
def test_capture_clock(capture: str) -> None:
    """The clock continues between the GNSS samples, which are up to 60 ms behind their neighbours."""
    log = decode(shared(f"captures/{capture}/raw.bin").read_bytes())
    gnss = {r.sample for name in reference.GNSS for r in log.columns.get((name, None), [])}
    assert len(gnss) in (4, 5, 6, 7)
    steady = [time for sample, time in enumerate(log.time) if sample not in gnss]
    assert all(0 < b - a < 0.011 for a, b in itertools.pairwise(steady))
    assert all(0 < log.time[s - 1] - log.time[s] < 0.06 for s in gnss if s - 1 not in gnss)
    first = log.packet_counter[0]
    assert log.packet_counter == list(range(first, first + 100))
    for row in log.columns.get(("sample_time_coarse", None), []):
        assert row.values == int(log.time[row.sample])


def test_capture_rotation_matrix() -> None:
    """The matrix, rows first, matches the quaternion of the same sample (section 5.3.6)."""
    log = decode(shared("captures/mtig710-5/raw.bin").read_bytes())
    matrix = array(log, ("rotation_matrix", "ENU"))
    q0, q1, q2, q3 = array(log, ("quaternion", "ENU")).astype("f8").T
    assert matrix.shape == (92, 3, 3)
    assert (q0 * q1 * q2 * q3 != 0).all()
    expected = np.array(
        [
            [q0**2 + q1**2 - q2**2 - q3**2, 2 * (q1 * q2 - q0 * q3), 2 * (q1 * q3 + q0 * q2)],
            [2 * (q1 * q2 + q0 * q3), q0**2 - q1**2 + q2**2 - q3**2, 2 * (q2 * q3 - q0 * q1)],
            [2 * (q1 * q3 - q0 * q2), 2 * (q2 * q3 + q0 * q1), q0**2 - q1**2 - q2**2 + q3**2],
        ]
    ).transpose(2, 0, 1)
    assert np.abs(matrix - expected).max() < 1e-6


# ---------------------------------------------------------------------------------------------
# The tables, against those they were copied from
# ---------------------------------------------------------------------------------------------


def test_lengths() -> None:
    """Every message that a device sends, with the lengths that are known."""
    expected: dict[int, set[int]] = {}
    with shared("spec/messages.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            mid = int(row["hex"], 16)
            if "mt->host" not in row["direction"] or mid == 0x36:
                continue
            lengths = expected.setdefault(mid, set())
            if found := re.fullmatch(r"(\d+)\.\.(\d+)(?: step (\d+))?", row["lengths"]):
                first, last, step = (int(x or 1) for x in found.groups())
                lengths.update(range(first, last + 1, step))
            else:
                lengths.update(map(int, row["lengths"].split()))
    expected[MTDATA] = set(range(1, 2049))  # the list has no lengths of it
    assert {mid: set(sizes) for mid, sizes in reference.LENGTHS.items()} == expected


def test_quantities() -> None:
    """Every identifier whose layout is known, its name and its size in all precisions."""
    opaque = {0x8840, 0x88A0, 0xA080, 0xC820, 0xC830, 0xC840, 0xCA30, 0xCA40}
    seen = set()
    with shared("spec/data_ids.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            data_id = int(row["base_id"], 16)
            if data_id in opaque:
                assert not reference.known(data_id)
                continue
            seen.add(data_id)
            assert reference.known(data_id)
            if data_id == 0x7020:
                assert row["size_bytes"] == "8+4*N"
                continue
            sizes = [int(size) for size in row["size_bytes"].split("/")]
            for i, size in enumerate(sizes):
                packet = reference.read(
                    data_id | (i if row["precision"] == "y" else 0), bytes(size)
                )
                assert packet is not None, row["name"]
                (name, coordinates), _ = packet
                assert name.replace("_", "") == row["name"].split(" ")[0].lower()
                assert (coordinates is not None) == (row["coord"] == "y")
            for wrong in {0, 1, *(size + 1 for size in sizes)} - set(sizes):
                assert reference.read(data_id, bytes(wrong)) is None
    tables = (reference.REALS, reference.NUMBERS, reference.STRUCTS, (0xE080, 0x7020))
    assert seen == {base for table in tables for base in table}


# ---------------------------------------------------------------------------------------------
# Scanning
# ---------------------------------------------------------------------------------------------

GOOD = mtdata2(counter(1), fine(100))


def offsets(data: bytes, limit: int = 65535) -> list[int]:
    """Where the frames of `data` begin."""
    return [f.offset for f in scan(data, limit)[0]]


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"", []),
        (b"\0\0\0", [Damage(0, 3, "no preamble")]),
        (b"\xfa", [Damage(0, 1, "truncated")]),
        (b"\xfa\xff\x36\xff\x01", [Damage(0, 5, "truncated")]),
        (b"\xfa\xff\x36\x05\x00", [Damage(0, 5, "truncated")]),
        (b"\xfa\xff\x36\xff\x20\x00", [Damage(0, 6, "too long")]),
        (b"\xfa\xff\x3e\x00\xc4" + WAKE_UP, [Damage(0, 5, "checksum")]),
        (STRANGE + b"\0", [Damage(0, len(STRANGE) + 1, "implausible")]),
        (b"\0" + STRANGE, [Damage(0, 1 + len(STRANGE), "no preamble")]),
        (WAKE_UP + b"\0" + STRANGE, [Damage(5, 1 + len(STRANGE), "no preamble")]),
        (b"\0" + WAKE_UP + b"\xfa", [Damage(0, 1, "no preamble"), Damage(6, 1, "truncated")]),
        (b"\xfa" + WAKE_UP + b"\0", [Damage(0, 1, "truncated"), Damage(6, 1, "no preamble")]),
    ],
)
def test_damage(data: bytes, expected: list[Damage]) -> None:
    """Each stretch between frames is one row, with the reason from the byte where a frame was due."""
    _, found, checksum_errors = scan(data, limit=8185)
    assert found == expected
    assert checksum_errors == sum(stretch.reason == "checksum" for stretch in expected)


def test_in_step() -> None:
    """A frame that no device sends is accepted only between intact neighbours."""
    size = len(STRANGE)
    assert offsets(STRANGE) == [0]
    assert offsets(STRANGE + STRANGE) == [0, size]
    assert offsets(STRANGE + WAKE_UP) == [0, size]
    assert offsets(WAKE_UP + STRANGE + WAKE_UP) == [0, 5, 5 + size]
    assert offsets(WAKE_UP + STRANGE + b"\xfa" + WAKE_UP) == [0, 6 + size]
    assert offsets(WAKE_UP + b"\0" + STRANGE + WAKE_UP) == [0, 6 + size]
    assert offsets(STRANGE + b"\xfa\xff\x3e") == []
    # The next frame may be unknown too, but must be within the limit.
    long = frame(0xB2, bytes(300))
    assert offsets(STRANGE + long + WAKE_UP) == [0, size, size + len(long)]
    assert offsets(STRANGE + long + WAKE_UP, limit=299) == [size + len(long)]


@pytest.mark.parametrize(
    ("raw", "believed"),
    [
        (frame(0x01, bytes(4)), True),
        (frame(0x01, bytes(5)), False),
        (frame(0x0D, bytes(118)), True),
        (frame(0x91, bytes(255)), True),
        (frame(0x91, bytes(254)), False),
        (frame(0x30), False),  # a host's
        (frame(0x3F), False),  # a host's, though it is an acknowledgement
        (frame(0x32, bytes(54)), True),  # of any settings
        (frame(0x32), False),
        (frame(0x3E, bid=1), True),
        (frame(0x3E, bid=31), True),
        (frame(0x3E, bid=0), False),
        (frame(0x3E, bid=32), False),
        (frame(0x3E, extended=True), True),
        (mtdata2(), False),
        (mtdata2(counter(1), bid=32), False),
        (mtdata2(packet(0x7770, b"")), True),
        (mtdata2(packet(0x7770, bytes(255))), True),
        (mtdata2(counter(1), b"\x10"), False),
        (mtdata2(counter(1), b"\x10\x20\x02\x00"), False),
        (mtdata2(packet(0x102F, bytes(2))), True),  # format bits do not matter to integers
        (mtdata2(packet(0x1020, bytes(4))), False),
        (mtdata2(packet(0x402C, bytes(12))), True),  # nor coordinates to what does not rotate
        (mtdata2(packet(0x4021, bytes(12))), True),
        (mtdata2(packet(0x4022, bytes(12))), False),
        (mtdata2(packet(0x4023, bytes(24))), True),
        (mtdata2(packet(0x2018, bytes(16))), True),
        (mtdata2(packet(0x201C, bytes(16))), False),
        (mtdata2(packet(0xD01C, bytes(12))), False),
        (mtdata2(packet(0x4030, bytes(12))), True),
        (mtdata2(packet(0xE080, bytes(4)), packet(0xE080, bytes(8))), True),
        (mtdata2(packet(0xE080, bytes(6))), False),
        (mtdata2(packet(0x7020, bytes(4) + b"\1\0\0\0" + bytes(4))), True),
        (mtdata2(packet(0x7020, bytes(4) + b"\2\0\0\0" + bytes(4))), False),
        (mtdata2(packet(0x7020, bytes(7))), False),
        (mtdata2(packet(0x7010, bytes(93))), False),
    ],
)
def test_plausible(raw: bytes, believed: bool) -> None:
    """A plausible frame is found in garbage; another frame only if it is in step."""
    assert offsets(raw) == [0]
    assert offsets(b"\0" + raw + b"\0") == ([1] if believed else [])


def test_a_false_start_hides_nothing() -> None:
    """Preambles before a frame do not hide the frame, whatever length they claim."""
    for start in (b"\xfa", b"\xfa\xfa\xfa", b"\xfa\xff\x36\xff\x00\x10", b"\xfa\xff\x36\x20"):
        assert offsets(start + GOOD + GOOD) == [len(start), len(start) + len(GOOD)]


def test_extended_length() -> None:
    """Any length is accepted, up to the limit."""
    for size in (0, 1, 254, 255, 8185):
        raw = frame(0x7B, bytes(size), extended=True)
        assert raw[3] == 0xFF
        assert offsets(raw) == [0]
        assert offsets(raw, limit=size) == [0]
        if size:
            assert scan(raw, limit=size - 1)[1][0].reason == "too long"
    assert len(frame(0x7B, bytes(254))) == 254 + 5
    assert len(frame(0x7B, bytes(255))) == 255 + 7


def test_undamaged_streams_are_read_completely() -> None:
    """Every frame of an intact stream is found; a cut anywhere loses only the last frame."""
    for trial in range(300):
        rng = random.Random(trial)
        frames = streams.random_frames(rng)
        found, damage, _ = scan(b"".join(frames))
        assert damage == []
        assert [f.offset for f in found] == [sum(map(len, frames[:i])) for i in range(len(frames))]


def test_damage_accounts_for_every_byte() -> None:
    """Frames and damage cover the input without gaps; two stretches of damage are never adjacent."""
    for trial in range(300):
        rng = random.Random(trial)
        data = streams.damage(streams.random_log(rng), rng, flips=2e-3, drops=2e-3, bursts=1e-3)
        log = decode(data)
        found = [(stretch.offset, stretch.length) for stretch in log.damage]
        whole = [(f.offset, end - f.offset) for f in log.frames for end in [frame_end(data, f)]]
        at = 0
        for offset, length in sorted(found + whole):
            assert offset == at
            at += length
        assert at == len(data)
        assert not {o + n for o, n in found} & {o for o, _ in found}
        assert log.stats["skipped_bytes"] + sum(n for _, n in whole) == len(data)
        assert len(log.samples) + len(log.messages) == len(log.frames)


def frame_end(data: bytes, found: reference.Frame) -> int:
    """Returns where a frame ends."""
    return found.offset + (7 if data[found.offset + 3] == 0xFF else 5) + len(found.payload)


def test_hostile_input() -> None:
    """Nothing is found in hostile input, and the reason is correct."""
    assert scan(streams.zeros(100)) == ([], [Damage(0, 100, "no preamble")], 0)
    assert scan(streams.only_fa(1000)) == ([], [Damage(0, 1000, "checksum")], 1)
    assert scan(streams.lying(1000)) == ([], [Damage(0, 1000, "truncated")], 0)
    assert scan(streams.lying(1000), 8185) == ([], [Damage(0, 1000, "too long")], 0)
    assert scan(streams.claims(10_000, 8185)) == ([], [Damage(0, 10_000, "checksum")], 1)
    assert len(streams.claims(10_000, 65535)) == 10_000


# ---------------------------------------------------------------------------------------------
# Samples and messages
# ---------------------------------------------------------------------------------------------


def test_columns() -> None:
    """A quantity in two coordinate systems is two columns, in two precisions it is one."""
    log = decode(
        mtdata2(real(0x2010, 1, 0, 0, 0), real(0x2014, 0, 1, 0, 0), real(0x4022, 1, 2, 3))
        + frame(0x42, b"\4")
        + mtdata2(real(0x2016, 0, 0, 1, 0), real(0x4020, 4, 5, 6), real(0x4020, 7, 8, 9), bid=2)
    )
    assert log.samples == [(0, 0xFF), (70, 2)]
    assert log.columns == {
        ("quaternion", "ENU"): [(0, 0x2010, (1, 0, 0, 0))],
        ("quaternion", "NED"): [(0, 0x2014, (0, 1, 0, 0)), (1, 0x2016, (0, 0, 1, 0))],
        ("acceleration", None): [
            (0, 0x4022, (1, 2, 3)),
            (1, 0x4020, (4, 5, 6)),
            (1, 0x4020, (7, 8, 9)),
        ],
    }
    assert log.messages == [(0x42, 0xFF, b"\4", 64, 1)]
    acceleration = array(log, ("acceleration", None))
    assert same_bits(acceleration, np.array([[1, 2, 3], [4, 5, 6], [7, 8, 9]], "f8"))
    assert array(log, ("quaternion", "ENU")).dtype == "f4"
    assert array(log, ("quaternion", "NED")).dtype == "f8"


def test_unknown() -> None:
    """Unknown identifiers and sizes are kept as received, and are not used as stamps."""
    log = decode(
        mtdata2(packet(0x7772, b"abc"), packet(0x1060, b"\0\0\1"), packet(0x1021, b"\0\1"))
    )
    assert log.unknown == {0x7772: [(0, b"abc")], 0x1060: [(0, b"\0\0\1")]}
    assert log.columns == {("packet_counter", None): [(0, 0x1021, 1)]}
    assert math.isnan(log.time[0])
    assert log.packet_counter == [1]


def test_malformed() -> None:
    """An MTData2 message that is empty or malformed is a message, not a sample, if it is in step."""
    data = GOOD + mtdata2() + GOOD + mtdata2(counter(2), b"\x40\x20") + GOOD
    log = decode(data)
    assert [(m.mid, len(m.payload), m.sample) for m in log.messages] == [(0x36, 0, 1), (0x36, 7, 2)]
    assert (log.stats["malformed"], log.stats["messages"], log.stats["samples"]) == (2, 2, 3)
    assert decode(GOOD + mtdata2() + b"\0").stats["malformed"] == 0


def test_integers() -> None:
    """Signs and widths of the fixed layouts."""
    log = decode(
        mtdata2(
            packet(0xE040, b"\xc8"),
            packet(0xA010, struct.pack(">9Hh", *range(1, 10), -256)),
            packet(0xA020, struct.pack(">3h", -1, 0, 1)),
            packet(0x10A0, b"\xff" * 8),
            packet(0x1080, b"\0\1\0\2"),
            packet(0xE080, b"\0\0\0\0\x80\0\x40\xd2"),
            packet(0xA090, struct.pack(">10f", *range(10))),
            trigger(290637743),
        )
    )
    values = {name: rows[0].values for (name, _), rows in log.columns.items()}
    assert values["rssi"] == -56
    assert list(values["raw_acc_gyr_mag_temp"].values()) == [*range(1, 10), -256]
    assert values["raw_gyro_temp"] == (-1, 0, 1)
    assert values["sample_time64"] == 2**64 - 1
    assert values["frame_range"] == (1, 2)
    assert values["device_id"] == 0x800040D2
    assert values["trigger_in1"] == {"line": 9, "polarity": 1, "timestamp": 290637743, "frame": 0}
    types = {name: array(log, (name, None)).dtype for name in values}
    assert (types["rssi"].str, types["raw_gyro_temp"].str) == ("|i1", "<i2")
    assert types["sample_time64"].str == "<u8"
    assert array(log, ("raw_float_acc_gyr_mag_temp", None)).shape == (1, 10)
    assert types["raw_acc_gyr_mag_temp"]["temp"] == "i2"


def test_every_column_has_an_array() -> None:
    """Every column has an array with one row for each packet, equal to itself bit by bit."""
    for trial in range(50):
        log = decode(streams.random_log(random.Random(trial)))
        for key, rows in log.columns.items():
            values = array(log, key)
            assert len(values) == len(rows) == len(reference.samples_of(log, key))
            assert same_bits(values, values.copy())
            assert len(values) < 2 or not same_bits(values, values[1:])


def test_nan_bits() -> None:
    """Float32 columns carry the bits of a NaN."""
    log = decode(mtdata2(packet(0x0810, bytes.fromhex("7FA00001"))))
    values = array(log, ("temperature", None))
    assert values.view("u4")[0] == 0x7FA00001
    assert not same_bits(values, np.array([np.nan], "f4"))


# ---------------------------------------------------------------------------------------------
# Time
# ---------------------------------------------------------------------------------------------

NAMED_DAY = frame(0x01, bytes.fromhex("037003F8"))
NAMED_ALL_BITS = frame(0x01, bytes.fromhex("00000000800040D2"))
LAST = 2**32 - 1


def ticks(*frames: bytes) -> list[float]:
    """The times of samples, in ticks of 0.1 ms."""
    return [round(time * 1e4, 3) for time in decode(b"".join(frames)).time]


def stamped(*values: int) -> list[bytes]:
    """Samples with these SampleTimeFine."""
    return [mtdata2(fine(value)) for value in values]


@pytest.mark.parametrize(
    ("name", "values", "expected"),
    [
        # Unknown device: the value before a step back decides.
        (b"", [100, 125, 150], [100, 125, 150]),
        (b"", [DAY - 25, 0, 25], [DAY - 25, DAY, DAY + 25]),
        (b"", [DAY, 0], [DAY, 0]),
        (b"", [3 * 10**9, 0], [3 * 10**9, 2**32]),
        (b"", [LAST - 24, 0, 25], [LAST - 24, LAST + 1, LAST + 26]),
        (b"", [1000, 900, 1025], [1000, 900, 1025]),
        (b"", [0, LAST], [0, LAST]),
        (b"", [DAY - 25, 0, DAY - 50, 25], [DAY - 25, DAY, 2 * DAY - 50, 2 * DAY + 25]),
        # Up to half the range is forward, more is back.
        (b"", [DAY // 2 + 100, 100], [DAY // 2 + 100, DAY + 100]),
        (b"", [DAY // 2 + 100, 101], [DAY // 2 + 100, 101]),
        (NAMED_ALL_BITS, [2**31 + 5, 5], [2**31 + 5, 2**32 + 5]),
        (NAMED_ALL_BITS, [2**31 + 5, 6], [2**31 + 5, 6]),
        # Nothing steps back below zero.
        (NAMED_ALL_BITS, [5, LAST], [5, LAST]),
        (NAMED_DAY, [100, DAY - 100], [100, DAY - 100]),
        # Known device.
        (NAMED_DAY, [DAY - 25, 0, DAY - 50, 25], [DAY - 25, DAY, DAY - 50, DAY + 25]),
        (NAMED_ALL_BITS, [DAY - 25, 0, 25], [DAY - 25, 0, 25]),
        (NAMED_ALL_BITS, [LAST, 0, LAST - 5, 9], [LAST, LAST + 1, LAST - 5, LAST + 10]),
    ],
)
def test_unwrapping(name: bytes, values: list[int], expected: list[int]) -> None:
    """SampleTimeFine wraps after a day or after 2^32 ticks (section 5.3.6)."""
    assert ticks(name, *stamped(*values)) == expected


@pytest.mark.parametrize(
    ("naming", "modulus"),
    [
        (frame(0x01, bytes.fromhex("036008A6")), DAY),
        (frame(0x01, bytes.fromhex("077010E6")), DAY),
        (frame(0x01, bytes.fromhex("03887B6D")), 2**32),
        (frame(0x01, bytes.fromhex("03D00001")), 2**32),
        (frame(0x01, bytes.fromhex("0B400001")), None),
        (frame(0x01, bytes.fromhex("00000000800040D2")), 2**32),
        (frame(0x01, bytes.fromhex("0368248C00000000")), DAY),
        (frame(0x03, bytes.fromhex("037003F8")), DAY),
        (frame(0x03, bytes.fromhex("037003F8037003F9")), None),
        (frame(0x0D, bytes.fromhex("037003F804800000").ljust(118, b"\0")), DAY),
        (frame(0x0D, bytes.fromhex("0788132200000000").ljust(118, b"\0")), 2**32),
        (frame(0x0D, bytes.fromhex("800040D200000000").ljust(118, b"\0")), 2**32),
        (frame(0x0D, bytes.fromhex("00000000800040D2").ljust(118, b"\0")), 2**32),
        (frame(0x0D, bytes(118)), None),
        (frame(0x13, bytes(11)), None),
    ],
)
def test_identity_messages_select_the_wrap(naming: bytes, modulus: int | None) -> None:
    """Identifiers of all families, as the messages carry them."""
    assert reference.modulus_of_message(scan(naming)[0][0]) == modulus


@pytest.mark.parametrize(
    ("code", "modulus"),
    [
        ("MTi-1-2A8G4", 2**32),
        ("MTi-8", 2**32),
        ("MTi-30-2A5G4", DAY),
        ("MTi-300-2A5G4", DAY),
        ("MTi-28A53G35", DAY),
        ("MTi-320-8A1G6", 2**32),
        ("MTi-330", 2**32),
        ("MTi-G-700-2A5G4", DAY),
        ("MTi-G-710-2A5G4", DAY),
        ("MTi-680G-8A1G6", 2**32),
        ("MTi-630R", 2**32),
        ("MTi-700", None),
        ("MTi-G", None),
        ("MTi-", None),
        ("Avior-OEM", 2**32),
        ("Sirius-AHRS", 2**32),
        ("MTw2-3A7G6", None),
        ("", None),
    ],
)
def test_product_codes(code: str, modulus: int | None) -> None:
    """Product codes, padded with spaces as they are sent."""
    assert reference.modulus_of_product(code.ljust(20).encode()) == modulus


def test_identity_applies_to_later_samples() -> None:
    """The last earlier message of the same device applies."""
    back = stamped(DAY - 25, 0)
    assert ticks(*back, NAMED_ALL_BITS) == [DAY - 25, DAY]
    assert ticks(NAMED_ALL_BITS, *back) == [DAY - 25, 0]
    assert ticks(NAMED_ALL_BITS, NAMED_DAY, *back) == [DAY - 25, DAY]
    assert ticks(NAMED_ALL_BITS, frame(0x01, bytes(4)), *back) == [DAY - 25, 0]
    assert ticks(frame(0x01, bytes.fromhex("03887B6D"), bid=1), *back) == [DAY - 25, 0]
    assert ticks(frame(0x01, bytes.fromhex("03887B6D"), bid=2), *back) == [DAY - 25, DAY]


def test_devices_have_separate_clocks() -> None:
    """FF and 1 are the same device, any other is another."""
    data = [mtdata2(fine(DAY - 25), counter(65535)), mtdata2(fine(5), counter(7), bid=2)]
    data += [mtdata2(fine(0), counter(0), bid=1), mtdata2(fine(30), counter(8), bid=2)]
    log = decode(b"".join(data))
    assert ticks(*data) == [DAY - 25, 5, DAY, 30]
    assert log.packet_counter == [65535, 7, 65536, 8]
    assert log.stats["gaps"] == 0


def test_gnss_samples_do_not_move_the_clock() -> None:
    """GNSS samples are delayed, and without a fix their time is arbitrary."""
    assert ticks(*stamped(1000), mtdata2(SAT_INFO, fine(550)), *stamped(1025)) == [1000, 550, 1025]
    assert ticks(*stamped(DAY - 50), mtdata2(SAT_INFO, fine(DAY - 500)), *stamped(25)) == [
        DAY - 50,
        DAY - 500,
        DAY + 25,
    ]
    late = mtdata2(fine(DAY - 400), SAT_INFO)
    assert ticks(NAMED_DAY, *stamped(DAY - 25, 25), late, *stamped(50)) == [
        DAY - 25,
        DAY + 25,
        DAY - 400,
        DAY + 50,
    ]
    # Before any other sample the value is used unchanged; the next sample starts the clock.
    assert ticks(mtdata2(SAT_INFO, fine(DAY - 5)), *stamped(3)) == [DAY - 5, 3]
    assert ticks(mtdata2(packet(0x7010, bytes(94)), fine(9)), *stamped(3)) == [9, 3]
    # A packet of the wrong size is not a GNSS packet.
    assert ticks(*stamped(DAY - 25), mtdata2(packet(0x7010, bytes(9)), fine(0)), *stamped(25)) == [
        DAY - 25,
        DAY,
        DAY + 25,
    ]


def test_coarse_time() -> None:
    """With SampleTimeCoarse the manual's big timestamp applies, and sets the clock."""
    assert ticks(mtdata2(coarse(5174), fine(51747668))) == [51747668]
    # Two days on: the fine time wrapped twice.
    two_days = 2 * DAY + 12_345
    sample = mtdata2(coarse(two_days // 10_000), fine(12_345))
    assert ticks(sample, *stamped(12_370)) == [two_days, two_days + 25]
    assert ticks(NAMED_DAY, sample, *stamped(12_370)) == [two_days, two_days + 25]
    assert ticks(NAMED_ALL_BITS, sample, *stamped(12_370)) == [two_days, 12_370]
    # A coarse time that does not match the fine time is reported, but does not change the clock.
    odd = mtdata2(coarse(77), fine(1025))
    assert ticks(*stamped(1000), odd, *stamped(1050)) == [1000, 771_025, 1050]
    # A coarse time behind the fine time matches no number of wraps.
    behind = mtdata2(coarse(0), fine(DAY + 5))
    assert ticks(behind, *stamped(DAY + 30)) == [5, DAY + 30]
    # Without a fine time it is in seconds.
    assert ticks(*stamped(1000), mtdata2(coarse(77)), *stamped(1025)) == [1000, 770_000, 1025]
    # In a GNSS sample it does not change the clock.
    gnss = mtdata2(coarse(86_400), fine(0), SAT_INFO)
    assert ticks(*stamped(1000), gnss, *stamped(1025)) == [1000, DAY, 1025]


def test_trigger_time() -> None:
    """A TriggerIn sample has its time stamp in microseconds of the same clock."""
    log = decode(b"".join([*stamped(2906348), mtdata2(trigger(290637743)), *stamped(2906373)]))
    assert log.time == [290.6348, 290.637743, 290.6373]
    assert ticks(mtdata2(trigger(123))) == [1.23]
    # It wraps every 2^32 microseconds: here between the two, then after both.
    wrap = 2**32 // 100
    assert ticks(*stamped(wrap - 10), mtdata2(trigger(4)))[1] == pytest.approx(2**32 / 100 + 0.04)
    assert ticks(*stamped(wrap + 10), mtdata2(trigger(2**32 - 96)))[1] == wrap
    assert ticks(*stamped(10), mtdata2(trigger(2**32 - 100)))[1] == pytest.approx(wrap - 0.04)
    # SampleTimeFine takes precedence; of several triggers the last one applies.
    assert ticks(mtdata2(trigger(123), fine(55))) == [55]
    assert ticks(mtdata2(trigger(100), trigger(200, 0x4820))) == [2]
    # It does not change the clock.
    assert ticks(mtdata2(trigger(2**32 - 100)), *stamped(10)) == [pytest.approx(wrap - 0.04), 10]


def test_no_time() -> None:
    """A sample without a stamp has no time; the last of two stamps applies."""
    assert math.isnan(decode(mtdata2(real(0x4040, 1, 2, 3))).time[0])
    assert ticks(mtdata2(fine(5), fine(9))) == [9]


# ---------------------------------------------------------------------------------------------
# Counter
# ---------------------------------------------------------------------------------------------


def counted(*frames: bytes) -> tuple[list[int], int, int]:
    """Unwrapped counters, gaps, lost samples."""
    log = decode(b"".join(frames))
    return log.packet_counter, log.stats["gaps"], log.stats["lost_samples"]


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([5, 6, 7], ([5, 6, 7], 0, 0)),
        ([65534, 65535, 0, 1], ([65534, 65535, 65536, 65537], 0, 0)),
        ([5, 8, 9], ([5, 8, 9], 1, 2)),
        ([65534, 1, 3], ([65534, 65537, 65539], 2, 3)),
        ([5, 4, 5, 5, 6], ([5, 4, 5, 5, 6], 0, 0)),
        ([0, 32767], ([0, 32767], 1, 32766)),
        ([40000, 7232], ([40000, 7232], 0, 0)),  # just half: back
        ([65535, 0, 65535], ([65535, 65536, 65535], 0, 0)),
    ],
)
def test_counter(values: list[int], expected: tuple[list[int], int, int]) -> None:
    """PacketCounter is unwrapped, and skipped values are lost samples (section 5.3.6)."""
    assert counted(*(mtdata2(counter(value)) for value in values)) == expected


@pytest.mark.parametrize("mid", [0x11, 0x41, 0x3E])
def test_counter_restarts(mid: int) -> None:
    """No sample counts as lost between two measurements."""
    first, jump, gap = (mtdata2(counter(value)) for value in (5, 100, 102))
    none = mtdata2(fine(1))
    assert counted(first, frame(mid), none, jump, gap) == ([5, -1, 100, 102], 1, 1)
    assert counted(first, frame(mid, bid=1), jump) == ([5, 100], 0, 0)
    assert counted(first, frame(mid, bid=2), jump) == ([5, 100], 1, 94)
    assert counted(first, frame(0x31), jump) == ([5, 100], 1, 94)
    assert counted(frame(mid), first, jump) == ([5, 100], 1, 94)


def test_no_counter() -> None:
    """A sample without a counter is no loss; the last of two counters applies."""
    five, six = mtdata2(counter(5)), mtdata2(counter(6))
    assert counted(five, mtdata2(trigger(1)), six) == ([5, -1, 6], 0, 0)
    assert counted(mtdata2(counter(9), counter(5)), six) == ([5, 6], 0, 0)


# ---------------------------------------------------------------------------------------------
# Streams
# ---------------------------------------------------------------------------------------------


def test_streams() -> None:
    """The streams of the benchmarks have the documented content, and are the same every time."""
    n = 200
    assert len(streams.ahrs(n)) == 88 * n
    assert len(streams.hr(n)) == 27 * n
    for make in (streams.ahrs, streams.hr, streams.gnssins):
        data = make(n)
        assert data == make(n) != make(n, seed=99)
        assert data[:1000] != make(n, seed=99)[:1000]
        log = decode(data)
        assert (len(log.samples), log.damage, log.unknown) == (n, [], {})
        assert log.stats["gaps"] == 0
        assert make(0) == b""
    log = decode(streams.gnssins(n))
    assert len(log.columns["gnss_pvt_data", None]) == n // 25
    quaternion = array(log, ("quaternion", "ENU"))
    assert np.abs(np.linalg.norm(quaternion, axis=1) - 1).max() < 1e-6
    assert array(log, ("lat_lon", None))[:, 0] == pytest.approx(52.24, abs=0.01)
    assert array(log, ("utc_time", None))["second"].max() < 60


def test_dirty() -> None:
    """Most frames survive the damage, and the counter shows the lost samples."""
    n = 2000
    data = streams.dirty(n, 7)
    assert data == streams.dirty(n, 7)
    log = decode(data)
    assert 0.7 * n < len(log.samples) < 0.95 * n
    assert log.stats["lost_samples"] == pytest.approx(n - len(log.samples), abs=5)
    assert {stretch.reason for stretch in log.damage} >= {"checksum", "no preamble"}
    assert streams.damage(data, random.Random(1), 0, 0, 0) == data
