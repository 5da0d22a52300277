"""NMEA text, read back by pynmeagps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pynmeagps import ERR_RAISE, NMEAReader

import xbus
from test_cli import WALK, run, sentence
from test_maps import UTC, moving, pvt
from xbus import MessageId, encode_frame, encode_sample, encode_string
from xbus.export.format import export
from xbus.export.nmea import Nmea
from xbus.log.part_file import export_parts

WALK_BYTES = Path(WALK).read_bytes()
LOG = xbus.read_log(WALK_BYTES)
STRINGS = [encode_string("HEHDT", {"heading": float(at)}) for at in range(5)]


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def read() -> list[Any]:
    with Path("out.nmea").open("rb") as file:
        return [message for _, message in NMEAReader(file, quitonerror=ERR_RAISE)]


def made(log: xbus.Log, **options: Any) -> dict[str, list[Any]]:
    """The sentences by type, without the first one."""
    log.to_nmea("out.nmea", **options)
    mark, *messages = read()
    assert mark.text == "made by xbus from MTData2"
    found: dict[str, list[Any]] = {}
    for message in messages:
        found.setdefault(message.identity, []).append(message)
    return found


def test_strings_are_kept_in_order() -> None:
    """Between samples too; only the end of the line may change."""
    data = STRINGS[0] + moving(0) + STRINGS[1].rstrip() + b"\n" + b"".join(STRINGS[2:])
    xbus.read_log(data).to_nmea("out.nmea")
    assert Path("out.nmea").read_bytes() == b"".join(STRINGS)
    assert [message.headingT for message in read()] == [0, 1, 2, 3, 4]


def test_a_recording_of_strings_alone() -> None:
    Path("log.txt").write_bytes(b"".join(STRINGS))
    assert "out.nmea: 5 sentences" in run("decode", "log.txt", "-o", "out.nmea").stderr
    assert Path("out.nmea").read_bytes() == b"".join(STRINGS)


def test_binary_strings_are_left_out() -> None:
    binary = encode_string("EM1000", {"heading": 10.0, "pitch": 1.0})
    Path("log.bin").write_bytes(STRINGS[0] + binary)
    result = run("decode", "log.bin", "-o", "out.nmea", "--string", "EM1000")
    assert "1 sentence, 1 omitted binary string" in result.stderr
    Path("log.bin").write_bytes(binary)
    result = run("decode", "log.bin", "-o", "out.nmea", "--string", "EM1000")
    assert "no strings that are text" in sentence(result)


def test_sentences_of_the_receiver() -> None:
    found = made(LOG)
    rows = LOG["gnss_pvt_data"].scaled
    assert {name: len(messages) for name, messages in found.items()} == dict.fromkeys(
        ("GPGGA", "GPRMC", "HEHDT", "GPZDA"), len(rows)
    )
    for row, gga, rmc in zip(rows, found["GPGGA"], found["GPRMC"], strict=True):
        assert (gga.lat, gga.lon, gga.alt) == pytest.approx(
            (row["lat"], row["lon"], row["hMSL"]), abs=1e-9
        )
        assert (rmc.lat, rmc.lon, gga.HDOP) == pytest.approx(
            (row["lat"], row["lon"], row["hdop"]), abs=1e-9
        )
        assert gga.sep == pytest.approx(row["height"] - row["hMSL"])
        assert rmc.spd == pytest.approx(row["gSpeed"] * 3600 / 1852, abs=6e-4)
        assert (gga.quality, gga.numSV, rmc.status) == (4, row["numSV"], "A")
    assert str(found["GPRMC"][0].date) == "2026-11-22"
    yaw = LOG["euler_angles"]["yaw"]
    sample = LOG["euler_angles"].sample
    before = np.searchsorted(sample, LOG["gnss_pvt_data"].sample) - 1
    headings = [message.headingT for message in found["HEHDT"]]
    np.testing.assert_allclose(headings, (90 - yaw[before]) % 360, atol=0.02)


def test_sentences_of_the_filter() -> None:
    utc = UTC | {"ns": 0}
    log = xbus.read_log(moving(0, utc_time=utc) + moving(1, altitude_ellipsoid=83.0))
    found = made(log)
    assert sorted(found) == ["GPZDA", "INGGA", "INRMC"]
    assert [(m.lat, m.alt, m.sep, m.quality) for m in found["INGGA"]] == [
        (52, 40.5, "", 1),
        (52, 40.5, 42.5, 1),
    ]
    assert [str(m.time) for m in found["INGGA"]] == ["04:05:06", ""]
    assert len(found["GPZDA"]) == 1


def test_the_fix_and_the_time_count_also_if_only_positions_are_chosen() -> None:
    samples = [moving(at, status_word=0b110 if at else 0, utc_time=UTC) for at in range(3)]
    Path("log.mtb").write_bytes(b"".join(samples))
    for chosen in ([], ["--quantity", "lat_lon"]):
        assert run("decode", "log.mtb", "-o", "out.nmea", *chosen).exit_code == 0
        found = [message for message in read() if message.msgID == "GGA"]
        assert [(m.quality, bool(m.lat), bool(m.time)) for m in found] == [
            (0, False, True),
            (1, True, True),
            (1, True, True),
        ]


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"lat": 52.21234567e7}, "5212.7407420,N,00000.0000000,E"),
        ({"lat": -0.5e7, "lon": -179.99999999e7}, "0030.0000000,S,18000.0000000,W"),
        ({"lat": 0.9999999e7}, "0059.9999940,N,00000.0000000,E"),
        ({"sec": 59, "nano": 996_000_000, "minute": 59}, "GGA,050000.00,"),
        ({"sec": 0, "nano": -230_787}, "GGA,040000.00,"),
        ({"sec": 59, "nano": 994_000_000}, "GGA,040059.99,"),
        ({"hour": 23, "min": 59, "sec": 59, "nano": 999_000_000}, "RMC,000000.00,A"),
        ({"hour": 23, "min": 59, "sec": 59, "nano": 999_000_000}, ",040226,,*"),
        (
            {"hour": 23, "min": 59, "sec": 59, "nano": 999_000_000},
            "ZDA,000000.00,04,02,2026,00,00*",
        ),
        ({"headMot": 359.999e5}, ",0.000,0.00,030226"),
        ({"flags": 0}, "GGA,040000.00,,,,,0,11,,,M,,M,,*"),
        ({"flags": 0}, "RMC,040000.00,V,,,,,,,030226,,*"),
        ({"fixtype": 5}, "GGA,040000.00,,,,,0,11,,,M,,M,,*"),
        ({"lat": 91e7}, "GGA,040000.00,,,,,0,11,,,M,,M,,*"),
        ({"fixtype": 1}, ",E,6,11,0.65,"),
        ({"flags": 3}, ",E,2,11,0.65,"),
        ({"flags": 0x41}, ",E,5,11,0.65,"),
        ({"flags": 0x81}, ",E,4,11,0.65,"),
        ({"valid": 3}, "GGA,,0000.0"),
        ({"valid": 3}, "RMC,,A,0000.0000000,N,00000.0000000,E,0.000,0.00,,,*"),
    ],
    ids=str,
)
def test_fields(fields: dict[str, float], expected: str) -> None:
    fields = {{"minute": "min"}.get(name, name): value for name, value in fields.items()}
    xbus.read_log(pvt(0, {"sec": 0, "nano": 0} | fields)).to_nmea("out.nmea")
    text = Path("out.nmea").read_text()
    assert expected in text
    assert len(read()) == text.count("\n")


def test_heading_without_position() -> None:
    data = b"".join(
        encode_sample({"utc_time": UTC, ("euler_angles", "NED"): [0, 0, yaw]})
        for yaw in (45, -0.001, -90)
    )
    found = made(xbus.read_log(data))
    assert [m.headingT for m in found["HEHDT"]] == [45, 0, 270]
    assert len(found["GPZDA"]) == 3


def test_an_old_heading_is_left_out() -> None:
    """One that is older than a second, or was measured before a restart."""

    def north(seconds: float) -> bytes:
        ticks = round(seconds * 10_000)
        return encode_sample({"sample_time_fine": ticks, "euler_angles": [0.0, 0.0, 90.0]})

    def fix(seconds: float | None) -> bytes:
        stamp = {} if seconds is None else {"sample_time_fine": round(seconds * 10_000)}
        return encode_sample(stamp | {"lat_lon": (52.0, 4.0)})

    def headings(*samples: bytes) -> list[float]:
        xbus.read_log(b"".join(samples)).to_nmea("out.nmea")
        return [message.headingT for message in read() if message.identity == "HEHDT"]

    assert headings(north(1.0), fix(1.0), fix(2.0), fix(2.0001)) == [0, 0]
    # The age of a sample without a stamp is unknown: only the next sample has the heading.
    assert headings(north(1.0), fix(None), fix(None)) == [0]
    wake_up = xbus.encode_frame(0x3E, b"")
    assert headings(north(1.0), wake_up, fix(1.1), north(1.2), fix(1.3)) == [0]


def test_the_parts_of_a_log_give_the_same_bytes() -> None:
    turning = [encode_sample({"quaternion": [1, 0, 0, at / 100]}) for at in range(100)]
    positions = [pvt(at, {"flags": at % 7 > 0}) for at in range(100)]
    data = b"".join(a + b for a, b in zip(turning, positions, strict=True))
    strings = data + b"".join(STRINGS)
    for source, sentences in ((data, 400), (strings, len(STRINGS)), (WALK_BYTES, 160)):
        log, parts = xbus.read_log(source), xbus.split_log(source, block_bytes=400)
        counts = export(Nmea(), log, [log], "whole")
        assert counts == {"sentence": sentences}
        assert export_parts(parts, "parts", Nmea()) == counts
        assert Path("whole").read_bytes() == Path("parts").read_bytes()


@pytest.mark.parametrize(
    ("data", "arguments", "message"),
    [
        (bytes(100), [], "no Xbus frame in log.mtb: none in 100 bytes"),
        (b"", [], "no Xbus frame in log.mtb: the input is empty"),
        (
            encode_frame(MessageId.MTData, bytes(40)),
            [],
            "nothing was decoded: 1 message MTData (0x32)",
        ),
        (encode_sample({"temperature": 1.0}), [], "no strings, and no position or orientation"),
        (moving(0), ["--source", "gnss"], "no strings, and no gnss to make sentences from"),
        (
            moving(0, 1) + moving(0, 2),
            [],
            "sentences do not name a device; choose one with --bid: 1, 2",
        ),
    ],
    ids=["no frame", "no byte", "not decoded", "nothing", "no receiver", "two devices"],
)
def test_refusals(data: bytes, arguments: list[str], message: str) -> None:
    Path("log.mtb").write_bytes(data)
    assert message in sentence(run("decode", "log.mtb", "-o", "out.nmea", *arguments))
    assert not Path("out.nmea").exists()
