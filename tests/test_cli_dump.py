"""``xbus dump``."""

from __future__ import annotations

import json
import math
import os
import pty
import random
import re
import signal
import struct
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import xbus
from conftest import coarse, counter, damaged_streams, fine, shared, trigger
from streams import frame, packet, random_frames
from test_cli import FIELD, PROGRAM, WALK, run, sentence, start
from test_cli_sim import simulated
from test_recording import LONG
from xbus import DataId, MessageId, SimulatedDevice, encode_frame, encode_packet
from xbus.cli import dump as command
from xbus.cli.dump_lines import KEPT, DumpFormatter
from xbus.protocol.products import DEFAULT_BAUDRATE
from xbus.sim.link import SimLink


def lines_of(data: bytes, *, pieces: list[int] | None = None, as_json: bool = False) -> list[str]:
    """Returns the lines of a stream that arrives in pieces of these sizes, followed by the rest."""
    formatter = DumpFormatter([], with_hex=True, as_json=as_json)
    lines = []
    for size in pieces or []:
        lines += formatter.feed(data[:size])
        data = data[size:]
    return lines + formatter.feed(data) + formatter.close()


def words_of(message: bytes) -> str:
    """Returns the text between the name and the hex in the line of one message."""
    (line,) = lines_of(message)
    return line[26:].partition("  | ")[0].partition("  ")[2]


def packet_words(*packets: bytes) -> str:
    return words_of(encode_frame(MessageId.MTData2, b"".join(packets)))


def dumped(*args: str) -> list[dict[str, Any]]:
    result = run("dump", "--json", *args)
    assert (result.exit_code, result.stderr) == (0, "")
    return [json.loads(line) for line in result.stdout.splitlines()]


# Lines


def test_lines_of_a_recording() -> None:
    result = run("dump", WALK)
    assert (result.exit_code, result.stderr) == (0, "")
    lines = result.stdout.splitlines()
    assert len(lines) == 1042
    assert lines[0].startswith(
        "         0                Configuration  MTi-680G-8A1G6, 008000A1B2, firmware 1.12.0, "
        "recorded 2026-11-22 09:29:59.00, filter profile 0  | FA FF 0D 76 80 00 A1 B2 00"
    )
    assert lines[1] == (
        "       123                FirmwareRev  firmware 1.12.0 build 30 source 74565  | "
        "FA FF 13 0B 01 0C 00 00 00 00 1E 00 01 23 45 4F"
    )
    assert lines[2].startswith(
        "       139   429491.7296  MTData2  packet_counter 65001; "
        "sample_time_fine 4294917296 (0.1 ms); utc_time 2026-11-22 09:30:00.000000000 valid=7; "
        "quaternion q0=0.9999995 q1=-0.0006474857 q2=-0.0005534405 q3=0.0005239618; "
        "euler_angles roll=-0.07422965 pitch=-0.06338071 yaw=0.06008269 deg; "
        "acceleration x=0.02657363 y=-0.02500427 z=9.808026 m/s2; "
    )
    assert "; lat_lon (Fp1632) lat=52.2404 lon=6.83820000011 deg; " in lines[2]
    assert "; status_word 0x09800006 filter_valid gnss_fix filter_mode=3 rtk_status=1; " in lines[2]
    assert "; baro_pressure 100262 Pa; temperature 31.5 degC  | FA FF 36 AC 10 20 02" in lines[2]
    plain = run("dump", "--no-hex", WALK).stdout.splitlines()
    assert plain == [line.partition("  | ")[0] for line in lines]


def test_damage_has_its_own_lines() -> None:
    lines = run("dump", FIELD).stdout.splitlines()
    assert lines[0] == "         0                damage  83 bytes: no preamble"
    damage = [line for line in lines if "  damage  " in line]
    assert len(damage) == 12
    assert damage[1] == "      3713                damage  227 bytes: checksum"
    log = xbus.read_log(FIELD)
    shown = [item for item in dumped(FIELD) if "reason" in item]
    assert [tuple(item.values()) for item in shown] == log.damage.tolist()
    assert list(shown[0]) == ["offset", "length", "reason"]


@given(damaged_streams())
def test_frames_and_damage_are_the_whole_input(data: bytes) -> None:
    """The frames and damage, joined, equal the input byte by byte."""
    at = 0
    for line in lines_of(data, as_json=True):
        item = json.loads(line)
        assert item["offset"] == at
        if "reason" in item:
            at += item["length"]
        else:
            raw = bytes.fromhex(item["frame"] if "frame" in item else item["bytes"])
            assert data[at : at + len(raw)] == raw
            at += len(raw)
    assert at == len(data)
    lines = lines_of(data)
    assert b"".join(bytes.fromhex(line.partition("  | ")[2]) for line in lines) == b"".join(
        bytes.fromhex(item.get("frame", item.get("bytes", "")))
        for item in map(json.loads, lines_of(data, as_json=True))
    )


@given(damaged_streams(), st.lists(st.integers(0, 300), max_size=20))
def test_chunking_does_not_matter(data: bytes, pieces: list[int]) -> None:
    assert lines_of(data, pieces=pieces) == lines_of(data)


def test_memory_is_bounded() -> None:
    """The longest frames wait for the frame behind them; noise follows."""
    ack = encode_frame(MessageId.GoToConfigAck)
    frames = [*[frame(mid, bytes(65535)) for mid in (0x36, 0x07, 0xF1)] * 5, ack]
    formatter = DumpFormatter([], with_hex=True, as_json=False)
    lines = []
    data = b"".join([*frames, bytes(500_000), ack])
    for at in range(0, len(data), 9999):
        lines += formatter.feed(data[at : at + 9999])
        assert len(formatter._kept) <= KEPT
    *hexes, damage, _ = [line.partition("  | ")[2] for line in lines + formatter.close()]
    assert [bytes.fromhex(item) for item in hexes] == frames
    assert damage == ""


def test_an_unusual_frame_is_shown_as_received() -> None:
    """A short payload may have an extended length."""
    data = frame(0x36, packet(0x3010, bytes(4)), extended=True)
    (line,) = lines_of(data)
    assert line.endswith(f"| {data.hex(' ').upper()}")
    assert data[3] == 0xFF


def test_bus_identifiers() -> None:
    assert words_of(encode_frame(MessageId.GoToConfigAck)) == ""
    assert words_of(encode_frame(MessageId.GoToConfigAck, bid=1)) == "(BID 1)"


# Messages in words


@pytest.mark.parametrize(
    ("mid", "payload", "words"),
    [
        (MessageId.DeviceID, "03 70 03 F8", "037003F8"),
        (MessageId.DeviceID, "00 00 00 00 80 00 5B F5", "0080005BF5"),
        (MessageId.ProductCode, b"MTi-630-8A1G6       ".hex(), "MTi-630-8A1G6"),
        (MessageId.FirmwareRev, "01 08 02", "firmware 1.8.2"),
        (MessageId.Error, "04", "4: the message is invalid here, or this device does not know it"),
        (
            MessageId.Error,
            "28 00 00 00 06",
            "40: device error: a firmware update may help (detail 00 00 00 06)",
        ),
        (MessageId.Error, "", "without a code"),
        (MessageId.Error, "C8", "200: a code that xbus does not know"),
        (
            MessageId.Warning,
            "00 00 01 93" + b"lost \x07 \xff it".hex(),
            "403: communication with the GNSS receiver failed (lost \\x07 \\xff it)",
        ),
        (MessageId.GoToMeasurementAck, "", ""),
        (0x50, "01 02", ""),
        (MessageId.ReqPeriodAck, "04 80", "1152"),
        (MessageId.SetPeriodAck, "", ""),
        (MessageId.InitBusResults, "03 70 03 F8", "037003F8"),
        (MessageId.UTCTime, "", ""),
        (
            MessageId.ReqOutputConfigurationAck,
            "20 14 00 64 E0 20 FF FF",
            "data_id=Quaternion|NED,frequency=100 data_id=StatusWord,frequency=65535",
        ),
        (MessageId.ReqOutputConfigurationAck, "00 00 00 00", "none"),
        (MessageId.ReqLatLonAltAck, "40 4A 00" + 21 * " 00", "lat=52 lon=0 alt=0"),
        (MessageId.ReqFilterProfileAckModern, b"General\x1b[2J".hex(), "General\\x1b[2J"),
        (
            MessageId.IccCommandAck,
            "01 41 1D 00 00 03 03",
            "command=stop ddt=9.8125 dimension=3 status=disturbed|not_enough_data",
        ),
        (MessageId.ReqOptionFlagsAck, "00 00 80 10", "enable_ahs|0x8000"),
        (MessageId.SelftestResults, "01", "malformed: the payload has 1 bytes, not 2"),
        (MessageId.EmtsData, 300 * "55", "300 bytes"),
    ],
)
def test_messages_in_words(mid: int, payload: str, words: str) -> None:
    # Between two other frames, so that any frame counts as a message.
    around = encode_frame(MessageId.GoToConfigAck)
    message = encode_frame(mid, bytes.fromhex(payload))
    line = lines_of(around + message + around)[1]
    assert line[26:].partition("  | ")[0].partition("  ")[2] == words
    shown = json.loads(lines_of(around + message + around, as_json=True)[1])
    assert (shown["mid"], shown["frame"]) == (mid, message.hex().upper())
    assert shown["text"] in words
    if mid in (MessageId.Error, MessageId.Warning):
        code = "" if shown["code"] is None else f"{shown['code']}: "
        assert words.startswith(f"{code}{shown['text']}")


# Packets in words


@pytest.mark.parametrize(
    ("key", "values", "words"),
    [
        ("packet_counter", 57285, "packet_counter 57285"),
        ("sample_time_coarse", 7, "sample_time_coarse 7 s"),
        (("temperature", "Fp1632"), 24.375, "temperature (Fp1632) 24.375 degC"),
        (("temperature", "Fp1220"), 2**-20, "temperature (Fp1220) 9.53674316e-07 degC"),
        ("temperature", 0.1, "temperature 0.1 degC"),
        (("temperature", "Float64"), 0.1, "temperature (Float64) 0.1 degC"),
        (("euler_angles", "NED"), [1, 2, 3], "euler_angles (NED) roll=1 pitch=2 yaw=3 deg"),
        (
            ("velocity_xyz", "NWU", "Float64"),
            [float("nan"), float("inf"), -0.0],
            "velocity_xyz (NWU, Float64) x=NaN y=inf z=-0 m/s",
        ),
        ("status_byte", 0x1B, "status_byte 0x1B selftest filter_valid no_rotation_update_status=3"),
        ("status_word", 0, "status_word 0x00000000"),
        ("raw_gyro_temp", [-256, 0, 1], "raw_gyro_temp x=-256 y=0 z=1 1/256 degC"),
        (
            "trigger_in1",
            {"line": 9, "polarity": 1, "timestamp": 1_500_000, "frame": 8},
            "trigger_in1 line=9 polarity=1 timestamp=1.5 s frame=8",
        ),
        (
            "gnss_sat_info",
            ((1500, 2, 0, 0, 0), [(0, 7, 31, 1), (6, 24, 0, 16)]),
            "gnss_sat_info itow=1.5 s numSvs=2 res1=0 res2=0 res3=0 "
            "[gnssId=0 svId=7 cno=31 dBHz flags=1] [gnssId=6 svId=24 cno=0 dBHz flags=16]",
        ),
    ],
)
def test_packets_in_words(key: Any, values: Any, words: str) -> None:
    assert packet_words(encode_packet(key, values)) == words


def test_rotation_matrix_in_words() -> None:
    words = packet_words(encode_packet("rotation_matrix", [[1, 2, 3], [4, 5, 6], [7, 8, 9]]))
    assert words == "rotation_matrix m11=1 m21=4 m31=7 m12=2 m22=5 m32=8 m13=3 m23=6 m33=9"


def test_receiver_in_words() -> None:
    log = xbus.read_log(WALK)
    row = log["gnss_pvt_data"].scaled[0]
    line = run("dump", "--no-hex", WALK).stdout.splitlines()[27]
    words = line.partition("gnss_pvt_data ")[2].partition(";")[0]
    assert words.startswith("itow=34200.0 s year=2026 month=11 day=22 hour=9 min=30 sec=0 valid=7 ")
    assert f" lat={row['lat']} deg " in words
    assert " headAcc=none " in words


def test_unknown_packets_and_malformed_samples() -> None:
    assert packet_words(packet(0xC2A0, b"abc")) == "0xC2A0 unknown, 3 bytes"
    around = encode_frame(MessageId.GoToConfigAck)
    bad = frame(0x36, packet(0x3010, bytes(4)) + b"\x40\x20\x0c")
    line = lines_of(around + bad + around)[1]
    assert (
        "MTData2  baro_pressure 0 Pa; malformed: the packets do not fill the message  | FA" in line
    )
    shown = json.loads(lines_of(around + bad + around, as_json=True)[1])
    assert shown["malformed"] is True
    empty = lines_of(around + frame(0x36, b"") + around)[1]
    assert "MTData2  malformed: the packets do not fill the message  | " in empty


@given(st.integers(0, 2**32 - 1))
def test_any_message_of_a_device_has_a_description(seed: int) -> None:
    for random_frame in random_frames(random.Random(seed), 20):
        lines_of(random_frame)
        for line in lines_of(random_frame, as_json=True):
            json.loads(line, parse_constant=pytest.fail)


# Time


def test_time_equals_that_of_the_log() -> None:
    """Times are unwrapped; a coarse time gives the manual's big time stamp."""
    for path in (FIELD, str(shared("captures/mtig710-5/raw.bin"))):
        log = xbus.read_log(path)
        times = [item["time_s"] for item in dumped("--mid", "MTData2", path)]
        assert times == log.time.tolist()


@given(st.integers(0, 2**32 - 1))
def test_every_sample_has_the_time_of_the_log(seed: int) -> None:
    data = b"".join(random_frames(random.Random(seed), 30))
    log = xbus.read_log(data)
    shown = [json.loads(line) for line in lines_of(data, as_json=True)]
    times = {item["offset"]: item["time_s"] for item in shown if "packets" in item}
    expected = [None if math.isnan(time) else time for time in log.time.tolist()]
    assert [times[offset] for offset in log.offset.tolist()] == expected


def test_time_does_not_wrap() -> None:
    samples = (fine(2**32 - 1), fine(0))
    first, second = lines_of(b"".join(encode_frame(MessageId.MTData2, item) for item in samples))
    assert "  429496.7295  MTData2" in first
    assert "  429496.7296  MTData2" in second


def test_stamps() -> None:
    def line(*packets: bytes) -> str:
        return lines_of(encode_frame(MessageId.MTData2, b"".join(packets)))[0]

    assert line(fine(12_345)).startswith("         0        1.2345  MTData2  ")
    assert line(fine(12_345), coarse(7)).startswith("         0        7.2345  MTData2  ")
    assert line(coarse(7)).startswith("         0        7.0000  MTData2  ")
    assert line(trigger(5_000)).startswith("         0        0.0050  MTData2  ")
    for item in (counter(1), b""):
        assert line(item).startswith("         0                MTData2  ")


# JSON


def test_json_is_exact() -> None:
    """Reals are exact to the last bit and integers are raw, as in the columns."""
    log = xbus.read_log(FIELD)
    shown = [item for item in dumped(FIELD) if item.get("packets")]
    assert [item["offset"] for item in shown] == log.offset.tolist()
    for name in log:
        assert isinstance(name, str)
        column = log[name]
        rows = [
            (at, item)
            for at, sample in enumerate(shown)
            for item in sample["packets"]
            if item["name"] == name
        ]
        assert [at for at, _ in rows] == column.sample.tolist()
        names = column.values.dtype.names or column.fields
        for (_, item), value in zip(rows, column.values.tolist(), strict=True):
            expected = dict(zip(names, value, strict=True)) if names else value
            assert item["values"] == expected
            assert (item["unit"], item["coordinates"]) == (column.unit, column.coordinates)
            assert (item["precision"], item["data_id"]) == (
                column.precision,
                f"0x{column.data_id:04X}",
            )


def test_json_of_satellites_and_unknown() -> None:
    path = str(shared("captures/mtig710-5/raw.bin"))
    column = xbus.read_log(path)["gnss_sat_info"]
    packets = [item for sample in dumped(path) for item in sample["packets"]]
    found = [item["values"] for item in packets if item["name"] == "gnss_sat_info"]
    assert [item["numSvs"] for item in found] == column.values["numSvs"].tolist()
    rows = [tuple(row.values()) for item in found for row in item["satellites"]]
    assert rows == [tuple(satellite) for satellite in column.satellites.tolist()]
    raw = encode_frame(MessageId.MTData2, packet(0xC2A0, b"\x01\xff"))
    assert json.loads(lines_of(raw, as_json=True)[0])["packets"] == [
        {"data_id": "0xC2A0", "name": None, "data": "01FF"}
    ]
    infinite = encode_frame(
        MessageId.MTData2, encode_packet("lat_lon", [float("nan"), float("-inf")])
    )
    (shown,) = json.loads(lines_of(infinite, as_json=True)[0])["packets"]
    assert shown["values"] == {"lat": None, "lon": None}


def test_json_without_hex() -> None:
    assert all("frame" not in item for item in dumped("--no-hex", WALK))
    assert all("frame" in item for item in dumped(WALK))


# Filters


@pytest.mark.parametrize("mid", ["0x42", "66", "Error", "error"])
def test_filter(mid: str) -> None:
    (shown,) = dumped("--mid", mid, FIELD)
    assert (shown["name"], shown["code"]) == ("Error", 41)


def test_filters_add_up() -> None:
    lines = run("dump", "--mid", "error", "--mid", "0x13", FIELD).stdout.splitlines()
    assert [line.split()[1] for line in lines] == ["FirmwareRev", "Error"]
    result = run("dump", "--mid", "WakeUp", FIELD)
    assert (result.exit_code, result.output) == (0, "")


def test_filter_by_name_distinguishes_requests_from_settings() -> None:
    data = encode_frame(0x18) + encode_frame(0x18, b"\x02")
    for wanted, count in (("ReqBaudrate", 1), ("SetBaudrate", 1), (0x18, 2)):
        formatter = DumpFormatter([wanted], with_hex=False, as_json=False)
        assert len(formatter.feed(data) + formatter.close()) == count


# Growing files and pipes


def test_follow_prints_messages_as_a_file_grows(tmp_path: Path) -> None:
    data = Path(WALK).read_bytes()
    log = tmp_path / "log.mtb"
    log.write_bytes(data[:300])
    with log.open("ab", buffering=0) as writer, start("dump", "--follow", str(log)) as child:
        assert child.stdout is not None
        heads = [child.stdout.readline().split()[:2] for _ in range(2)]
        assert heads == [[b"0", b"Configuration"], [b"123", b"FirmwareRev"]]
        # Only a part of the third message was in the file until now.
        writer.write(data[300:400])
        assert child.stdout.readline().split()[::2][:2] == [b"139", b"MTData2"]
        writer.write(data[400:])
        whole = [child.stdout.readline() for _ in range(1042 - 3)]
        assert b"MTData2" in whole[-1]
        child.send_signal(signal.SIGINT)
        rest, shown = child.communicate()
    assert (child.returncode, rest, shown) == (130, b"", b"")


def test_follow_reads_a_truncated_file_from_its_start(tmp_path: Path) -> None:
    data = Path(WALK).read_bytes()
    log = tmp_path / "log.mtb"
    log.write_bytes(data[:139])
    with start("dump", "--follow", "--json", "--no-hex", str(log)) as child:
        assert child.stdout is not None
        assert child.stderr is not None
        assert [json.loads(child.stdout.readline())["offset"] for _ in range(2)] == [0, 123]
        log.write_bytes(data[123:139])
        assert child.stderr.readline().endswith(b" was truncated; reading from its start\n")
        assert json.loads(child.stdout.readline())["name"] == "FirmwareRev"
        child.send_signal(signal.SIGINT)
        assert child.wait() == 130


@pytest.mark.parametrize("options", [[], ["--follow"]])
def test_a_pipe_is_dumped_as_it_arrives(options: list[str], tmp_path: Path) -> None:
    data = Path(WALK).read_bytes()
    os.mkfifo(tmp_path / "port")
    with (
        start("dump", *options, str(tmp_path / "port")) as child,
        (tmp_path / "port").open("wb", buffering=0) as writer,
    ):
        assert child.stdout is not None
        writer.write(data[:139])
        assert [child.stdout.readline().split()[0] for _ in range(2)] == [b"0", b"123"]
        writer.write(data[139:400])
        assert child.stdout.readline().split()[0] == b"139"
        writer.close()
        rest, shown = child.communicate()
        assert rest.splitlines()[-1].endswith(b"truncated")
    assert (child.returncode, shown) == (0, b"")


def test_standard_input() -> None:
    result = run("dump", "-", stdin=Path(FIELD).read_bytes())
    assert result.exit_code == 0
    assert result.stdout == run("dump", FIELD).stdout
    # --follow ends with the pipe, too.
    assert run("dump", "--follow", "-", stdin=Path(FIELD).read_bytes()).stdout == result.stdout
    assert sentence(run("dump", "-", stdin=b"")).startswith("no Xbus frame in standard input")


# Ports


def test_a_port_is_followed_to_its_end() -> None:
    """Shows all bytes, from the middle of a frame on, until the device is unplugged; nothing is sent."""
    with simulated() as (port, sim):
        with start("dump", "--follow", "--json", port) as child:
            assert child.stdout is not None
            out = b"".join(child.stdout.readline() for _ in range(30))
            sim.send_signal(signal.SIGINT)
            sim.wait(LONG)
            rest, shown = child.communicate()
            out += rest
        assert child.returncode == 1
        lines = [json.loads(line) for line in out.splitlines()]
        samples = [line for line in lines if line.get("name") == "MTData2"]
        damaged = sum(line["length"] for line in lines if "reason" in line)
        totals = f"{len(samples)} samples, 0 other messages"
        totals += f", {damaged} bytes damaged" if damaged else ""
        assert shown.decode().splitlines() == [
            f"xbus: {port}: {totals}",
            f"xbus: {port} is gone: unplugged, or closed on the other side; check the cable",
        ]
        assert len(samples) > 20
        # The frames are whole and adjacent, byte by byte.
        ends = [sample["offset"] + len(sample["frame"]) // 2 for sample in samples]
        assert ends[:-1] == [sample["offset"] for sample in samples[1:]]
        # There is no answer among them, since nothing was sent.
        assert {line["name"] for line in lines if "name" in line} == {"MTData2"}


@pytest.mark.parametrize("polls", [0, 10, 60, 600])
def test_an_incomplete_frame_waits_for_its_rest(
    monkeypatch: pytest.MonkeyPatch, polls: int
) -> None:
    """A pause of up to 3 s inside a frame loses nothing. Nothing is sent."""
    error = encode_frame(MessageId.Error, b"\x1e")
    comes = [error[:5], *[b""] * polls, error[5:] + error, b"", error[:3]]

    def read(sim: SimulatedDevice, baudrate: int | None = None) -> bytes:
        if not comes:
            sim.unplug()
            return b""
        return comes.pop(0)

    def write(sim: SimulatedDevice, data: bytes, baudrate: int | None = None) -> None:
        raise AssertionError(data)

    monkeypatch.setattr(SimulatedDevice, "read", read)
    monkeypatch.setattr(SimulatedDevice, "write", write)
    result = run("dump", "--follow", "--no-hex", "sim:MTi-3")
    assert [line.split()[:2] for line in result.stdout.splitlines()] == [
        ["0", "Error"],
        ["6", "Error"],
        ["12", "damage"],
    ]
    assert (result.exit_code, result.stderr.splitlines()) == (
        1,
        [
            "xbus: sim:MTi-3: 0 samples, 2 other messages, 3 bytes damaged",
            "xbus: sim:MTi-3 is gone: sim:MTi-3 was unplugged; check the cable",
        ],
    )


def test_help_names_the_default_baudrate() -> None:
    assert f"Default: {DEFAULT_BAUDRATE}, the rate" in run("dump", "--help").stdout


def test_a_port_is_dumped_at_its_baud_rate_until_ctrl_c() -> None:
    began = time.monotonic()
    with simulated("--baudrate", "230400") as (port, _):
        with start("dump", "--follow", "--baudrate", "230400", port) as child:
            assert child.stdout is not None
            out = b"".join(child.stdout.readline() for _ in range(3))
            child.send_signal(signal.SIGINT)
            rest, shown = child.communicate()
        samples = (out + rest).count(b"  MTData2  ")
        assert samples >= 2
        assert child.returncode == 130
        pattern = rf"xbus: {port}: ([0-9]+) samples, 0 other messages(, [0-9]+ bytes damaged)?\n"
        totals = re.fullmatch(pattern, shown.decode())
        assert totals is not None
        # Some may have arrived since the last line, but no more than the device has sent.
        assert samples <= int(totals[1]) <= (time.monotonic() - began) * 100 + 1


def test_a_virtual_device_is_a_port() -> None:
    with start("dump", "--follow", "--mid", "MTData2", "--no-hex", "sim:MTi-3") as child:
        assert child.stdout is not None
        assert child.stdout.readline().split()[2:4] == [b"MTData2", b"packet_counter"]
        assert child.stderr is not None
        child.stdout.close()
        assert child.wait() == 0
        # A reader that has seen enough, such as head, needs no totals.
        assert child.stderr.read() == b""


def test_dropped_messages_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader that is too slow gets a message about the gaps: shown and lost samples are all samples."""

    class Slow(SimLink):
        def wait(self, timeout: float, **_: Any) -> bool:
            self.pause(1.0)  # a second of samples comes at once
            if self.clock() > 5:
                self.device.unplug()
            return super().wait(0)

    def open_port(port: str, baudrate: int) -> Slow:
        return Slow(port, bound=500)

    monkeypatch.setattr(command, "open_port", open_port)
    result = run("dump", "--follow", "--mid", "MTData2", "sim:MTi-3")
    *losses, totals, gone = result.stderr.splitlines()
    pattern = r"xbus: ([0-9]+) messages lost: the reader of the output is too slow"
    lost = [int(re.fullmatch(pattern, line)[1]) for line in losses]  # type: ignore[index]
    assert len(lost) >= 4
    shown = len(result.stdout.splitlines())
    assert shown >= 4
    assert totals == f"xbus: sim:MTi-3: {shown + sum(lost)} samples, 1 other message"
    assert gone.endswith("was unplugged; check the cable")


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["sim:MTi-630"], "sim:MTi-630 is a port and has no end; add --follow to print"),
        (["socket://127.0.0.1:1"], "is a port"),
        ([WALK, "--baudrate", "9600"], "is not a port and has no --baudrate"),
        (["-", "--follow", "--baudrate", "9600"], "standard input is not a port"),
        (["sim:nonsense", "--follow"], "sim:nonsense is not a port"),
    ],
)
def test_ports_and_files_are_distinguished(args: list[str], words: str) -> None:
    result = run("dump", *args)
    assert result.exit_code == 2
    assert words in " ".join(result.output.split())


def test_a_terminal_is_a_port() -> None:
    master, slave = pty.openpty()
    try:
        result = run("dump", os.ttyname(slave))
    finally:
        os.close(slave)
        os.close(master)
    assert result.exit_code == 2
    assert "add --follow to print messages until Ctrl-C" in " ".join(result.output.split())
    # Other devices of the system are files.
    assert sentence(run("dump", os.devnull)).startswith(
        "no Xbus frame in /dev/null: the input is empty"
    )


def test_a_port_that_cannot_be_opened() -> None:
    assert sentence(run("dump", "--follow", "socket://127.0.0.1:1")).startswith(
        "cannot open socket:"
    )


def test_block_size_does_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = run("dump", FIELD).stdout
    monkeypatch.setattr(command, "BLOCK", 777)
    assert run("dump", FIELD).stdout == whole


def test_a_log_may_hold_very_long_frames() -> None:
    """Real logs hold frames far beyond the limit of a live port."""
    long = struct.pack(">H", DataId.BaroPressure) + b"\x04" + bytes(4)
    data = frame(0x36, long * 3000)
    (line,) = lines_of(data)
    assert line.count("baro_pressure") == 3000


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_not_the_fault_of_the_port() -> None:
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(  # noqa: S603
            [*PROGRAM, "dump", "--follow", "sim:MTi-630"],
            stdout=full,
            stderr=subprocess.PIPE,
            check=False,
        )
    assert b"No space left on device" in done.stderr
    assert b"plugged" not in done.stderr
