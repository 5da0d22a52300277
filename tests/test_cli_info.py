"""``xbus info``."""

from __future__ import annotations

import dataclasses
import json
import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import xbus
from conftest import counter, damaged_streams, fine, shared, sound_streams
from streams import frame, packet
from test_cli import FIELD, WALK, run, sentence
from xbus import MessageId, encode_frame
from xbus.cli.info_text import info_text
from xbus.describe.json_text import json_pieces
from xbus.describe.log_summary import LogSummary


def facts_of(data: bytes, block: int = 1 << 20) -> LogSummary:
    return LogSummary(xbus.iter_log(data, block_bytes=block))


def text_of(summary: LogSummary) -> str:
    """Returns the summary as JSON."""
    return "".join(json_pieces(summary.to_dict("")))


def output_of(data: bytes, tmp_path: Path) -> dict[str, Any]:
    """Returns the JSON object of a log with these bytes."""
    path = tmp_path / "log.mtb"
    path.write_bytes(data)
    result = run("info", "--json", str(path))
    assert (result.exit_code, result.stderr) == (0, "")
    return only(result.stdout)


def only(text: str) -> dict[str, Any]:
    """Returns the one object of a JSON list; NaN is not JSON and fails."""

    def never(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    (output,) = json.loads(text, parse_constant=never)
    assert isinstance(output, dict)
    return output


def sample(*packets: bytes) -> bytes:
    return encode_frame(MessageId.MTData2, b"".join(packets))


# The page

FIELD_PAGE = """\
size      166,910 bytes
device    not named in this log, firmware 1.12.0 build 30
UTC       2026-11-22 09:30:00.000 to 2026-11-22 09:30:09.990
duration  9.99 s
samples   1,016
losses    23 samples lost in 12 gaps
damage    1,816 bytes of damage in 12 places, 1.1 % of the bytes
messages  FirmwareRev 1, Error 1

quantity            coord.   rows  rate/Hz  precision  unit
packet_counter              1,016    101.6
sample_time_fine            1,016    101.6             0.1 ms
utc_time                    1,016    101.6
quaternion          ENU       978     97.8  Float32
euler_angles        ENU       978     97.8  Float32    deg
acceleration                  978     97.8  Float32    m/s2
rate_of_turn                  978     97.8  Float32    rad/s
magnetic_field                978     97.8  Float32    a.u.
lat_lon                       978     97.8  Fp1632     deg
altitude_ellipsoid            978     97.8  Fp1632     m
velocity_xyz        ENU       978     97.8  Fp1632     m/s
status_word                   978     97.8
baro_pressure                  98      9.8             Pa
temperature                    10      1.0  Float32    degC
gnss_pvt_data                  38      3.9

gaps
after/s  lost  next sample
   0.21     1           22
   1.08     1          112
   1.95     1          201
   2.26     1          233
   2.86    12          294
... and 7 smaller; --json lists all

damage
checksum 9, no preamble 2, truncated 1
offset  bytes  reason
     0     83  no preamble
 3,713    227  checksum
18,537    163  checksum
33,168    162  checksum
38,506    163  checksum
... and 7 more; --json lists all

errors and warnings
after 4.90 s: Error 41: more data than the baud rate can carry
"""


def test_page_of_a_damaged_log() -> None:
    result = run("info", FIELD)
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.stdout == f"{FIELD}\n{FIELD_PAGE}"


def test_page_of_a_sound_log() -> None:
    head, _, rest = run("info", WALK).stdout.partition("\n\n")
    assert head.splitlines() == [
        WALK,
        "size      169,069 bytes",
        "device    MTi-680G-8A1G6, id 008000A1B2, firmware 1.12.0 build 30",
        "recorded  2026-11-22 09:29:59.00 by the clock of the recording computer",
        "UTC       2026-11-22 09:30:00.000 to 2026-11-22 09:30:09.990",
        "duration  9.99 s",
        "samples   1,040",
        "losses    no samples lost",
        "damage    no damage",
        "messages  Configuration 1, FirmwareRev 1",
    ]
    assert "\n\n" not in rest


def test_several_logs_have_a_page_each() -> None:
    result = run("info", WALK, FIELD)
    assert result.exit_code == 0
    first, second = run("info", WALK).stdout, run("info", FIELD).stdout
    assert result.stdout == f"{first}\n{second}\n"


def test_an_unreadable_log_does_not_hide_the_others(tmp_path: Path) -> None:
    text = tmp_path / "notes.txt"
    text.write_text("acceleration: fast")
    result = run("info", "nowhere.mtb", WALK, str(text))
    assert result.exit_code == 1
    assert result.stdout.startswith(f"{WALK}\nsize ")
    first, second = result.stderr.splitlines()
    assert first.startswith("xbus: cannot read nowhere.mtb: ")
    assert second.startswith(f"xbus: no Xbus frame in {text}: ")
    result = run("info", "--json", "nowhere.mtb", WALK, str(text))
    assert result.exit_code == 1
    nowhere, walk, notes = json.loads(result.stdout)
    assert nowhere == {"file": "nowhere.mtb", "error": first.removeprefix("xbus: ")}
    assert notes == {"file": str(text), "error": second.removeprefix("xbus: ")}
    assert walk == only(run("info", "--json", WALK).stdout)


def test_standard_input() -> None:
    result = run("info", "-", stdin=Path(FIELD).read_bytes())
    assert result.exit_code == 0
    assert result.stdout == f"standard input\n{FIELD_PAGE}"
    assert sentence(run("info", "-", stdin=b"")).startswith(
        "no Xbus frame in standard input: the input is empty"
    )


@given(damaged_streams())
def test_page_has_80_columns(data: bytes) -> None:
    facts = facts_of(data)
    if facts.stats.frames:
        assert max(map(len, info_text("log.mtb", facts).splitlines())) <= 80


# JSON


def test_json_is_complete(tmp_path: Path) -> None:
    log = xbus.read_log(FIELD)
    output = only(run("info", "--json", FIELD).stdout)
    stats = dataclasses.asdict(log.stats)
    listed = ("messages", "strings", "gaps")
    assert {key: output[key] for key in stats if key not in listed} == {
        key: value for key, value in stats.items() if key not in listed
    }
    assert output["file"] == FIELD
    assert [tuple(item.values()) for item in output["damage"]] == log.damage.tolist()
    assert len(output["gaps"]) == stats["gaps"]
    assert sum(item["lost"] for item in output["gaps"]) == stats["lost_samples"]
    for item in output["gaps"]:
        assert item["time_s"] == round(log.time[item["sample"]], 6)
    assert output["start_s"] == round(log.time.min(), 6)
    assert output["duration_s"] == 9.99
    assert output["messages"] == {"FirmwareRev": 1, "Error": 1}
    assert output["strings"] == {}
    assert [item["name"] for item in output["quantities"]] == list(log)
    for item in output["quantities"]:
        column = log[item["name"]]
        assert item == {
            "name": column.name,
            "coordinates": column.coordinates,
            "data_id": f"0x{column.data_id:04X}",
            "rows": len(column),
            "rate_hz": round(column.rate, 6),
            "nominal_rate_hz": column.nominal_rate,
            "precision": column.precision,
            "unit": column.unit,
        }
    (error,) = log.messages.named("Error")
    assert output["events"] == [
        {
            "offset": error.offset,
            "sample": error.sample,
            "time_s": round(log.time[error.sample - 1], 6),
            "recorded_s": round(log.time[error.sample - 1] - log.time[0], 6),
            "name": "Error",
            "code": 41,
            "text": "more data than the baud rate can carry",
            "detail": None,
        }
    ]
    assert output["device"] == {
        "product_code": None,
        "device_id": None,
        "firmware": "1.12.0",
        "firmware_build": 30,
        "firmware_source": 0x12345,
    }
    assert output["utc"] == {
        "first": "2026-11-22T09:30:00.000000000Z",
        "last": "2026-11-22T09:30:09.990000000Z",
        "rows": 1016,
        "valid": 1016,
    }
    assert (output["recorded"], output["configuration"], output["unknown"]) == (None, None, [])


def test_json_of_a_log_that_names_its_device() -> None:
    output = only(run("info", "--json", WALK).stdout)
    assert output["device"]["product_code"] == "MTi-680G-8A1G6"
    assert output["device"]["device_id"] == "008000A1B2"
    assert output["recorded"] == "2026-11-22 09:29:59.00"
    assert output["configuration"] == {
        "sampling_period": None,
        "output_skip_factor": None,
        "date": "20261122",
        "time": "09295900",
        "devices": 1,
        "filter_profile": 0,
        "output_mode": None,
        "output_settings": None,
        "data_length": 0,
        "filter_type": None,
        "filter_version": [0, 0],
    }


def test_two_devices_with_the_same_bid(tmp_path: Path) -> None:
    names = [xbus.encode_frame(0x01, bytes([3, 0x80, 0, number])) for number in (1, 2)]
    sample = xbus.encode_sample({"temperature": 20.0})
    path = tmp_path / "joined.mtb"
    path.write_bytes(names[0] + sample + names[1] + sample)
    text = " ".join(run("info", str(path)).stdout.split())
    assert "device id 03800001 messages with the same BID name other devices: 03800002; the" in text
    assert only(run("info", "--json", str(path)).stdout)["other_devices"] == ["03800002"]
    assert only(run("info", "--json", WALK).stdout)["other_devices"] == []


@given(damaged_streams(), st.integers(1, 500))
def test_parts_make_no_difference(data: bytes, block: int) -> None:
    """The summary of parts equals that of the whole log, so a log need not fit into memory."""
    log, whole, parts = xbus.read_log(data), facts_of(data), facts_of(data, block)
    assert text_of(parts) == text_of(whole)
    assert parts.stats == log.stats
    assert len(parts.gaps) == log.stats.gaps
    assert parts.gaps.rows["lost"].sum() == log.stats.lost_samples
    assert parts.identity == log.identity
    assert json.loads(text_of(parts))["damage"] == [
        dict(zip(log.damage.dtype.names or (), row, strict=True)) for row in log.damage.tolist()
    ]
    assert parts.reasons == Counter(log.damage["reason"].tolist())
    assert sum(parts.messages.values()) == len(log.messages)
    assert {key: count for key, (count, _) in parts.unknown.items()} == {
        key: len(packets) for key, packets in log.unknown.items()
    }
    assert [(quantity.name, quantity.coordinates) for quantity in parts.quantities] == [
        (item.name, item.coordinates) for item in log.values()
    ]
    for known, column in zip(parts.quantities, log.values(), strict=True):
        assert known.rows == len(column)
        assert (known.precision, known.data_id) == (column.precision, column.data_id)
        assert (
            known.rate == column.rate or math.isnan(known.rate) is math.isnan(column.rate) is True
        )
    assert repr(parts.duration) == repr(log.duration)


@given(sound_streams())
def test_nothing_is_damaged_in_a_sound_stream(data: bytes) -> None:
    assert len(facts_of(data).damage) == 0


# Gaps


def counted(*counts: int) -> bytes:
    """Returns samples with these counters, 10 ms apart."""
    return b"".join(sample(counter(count), fine(100 * count)) for count in counts)


RESTART = encode_frame(MessageId.GoToMeasurementAck)


@pytest.mark.parametrize("block", [1, 40, 1 << 20])
@pytest.mark.parametrize(
    ("data", "gaps"),
    [
        (counted(5, 6, 7), []),
        (counted(5, 8, 9, 11), [(1, 2), (3, 1)]),
        (counted(65534, 65535, 1), [(2, 1)]),
        (counted(5, 6) + RESTART + counted(200, 201, 203), [(4, 1)]),
        (RESTART + counted(5, 9), [(1, 3)]),
        (counted(5) + RESTART, []),
    ],
)
def test_gaps(data: bytes, gaps: list[tuple[int, int]], block: int) -> None:
    facts = facts_of(data, block)
    assert facts.gaps.rows[["sample", "lost"]].tolist() == gaps
    assert facts.stats.gaps == len(gaps)


def test_each_device_has_a_separate_counter() -> None:
    one, other = (encode_frame(0x36, counter(3), bid=bid) for bid in (2, 3))
    far = encode_frame(0x36, counter(9), bid=3)
    assert facts_of(one + other + one + far).gaps.rows["lost"].tolist() == [5]


def test_the_largest_gaps_are_shown() -> None:
    counts = np.cumsum([1, 2, 3, 2, 2, 9, 2, 7, 2, 5, 4])
    text = info_text("x", facts_of(counted(*counts.tolist())))
    rows = text.partition("\ngaps\n")[2].splitlines()
    assert [row.split()[1] for row in rows[1:6]] == ["2", "8", "6", "4", "3"]
    assert rows[6] == "... and 5 smaller; --json lists all"


# Messages of a device


def test_errors_and_warnings_in_words(tmp_path: Path) -> None:
    warning = (403).to_bytes(4, "big")
    data = counted(1, 2)
    data += encode_frame(MessageId.Error, b"\x28\x00\x00\x00\x06") * 3
    data += encode_frame(MessageId.Warning, warning + b"receiver is \x1b[31mgone\0")
    data += encode_frame(MessageId.Warning, (999).to_bytes(4, "big")) + counted(3)
    events = output_of(encode_frame(MessageId.Error, b"\x04") + data, tmp_path)["events"]
    assert [
        (event["name"], event["code"], event["time_s"], event["sample"]) for event in events
    ] == [
        ("Error", 4, None, 0),
        *[("Error", 40, 0.02, 2)] * 3,
        ("Warning", 403, 0.02, 2),
        ("Warning", 999, 0.02, 2),
    ]
    assert events[1]["text"] == "device error: a firmware update may help"
    assert events[1]["detail"] == "00 00 00 06"
    assert events[4]["text"].endswith("(receiver is \\x1b[31mgone)")
    assert events[5]["text"] == "a code that xbus does not know"
    text = run("info", str(tmp_path / "log.mtb")).stdout
    shown = " ".join(text.partition("errors and warnings\n")[2].split())
    assert shown == (
        "at the start: Error 4: the message is invalid here, or this device does not know it "
        "after 0.01 s, 3 times: Error 40: device error: a firmware update may help "
        "(detail 00 00 00 06) "
        "after 0.01 s: Warning 403: communication with the GNSS receiver failed "
        "(receiver is \\x1b[31mgone) "
        "after 0.01 s: Warning 999: a code that xbus does not know"
    )


def test_unknown_identifiers_and_malformed_samples(tmp_path: Path) -> None:
    data = counted(1) + sample(packet(0xC2A0, b"12345"), packet(0x4020, b"no")) + counted(2)
    data += frame(0x36, b"\x40\x20\x0c") + counted(3)
    output = output_of(data, tmp_path)
    assert output["unknown"] == [
        {"data_id": "0xC2A0", "packets": 1, "bytes": 5},
        {"data_id": "0x4020", "packets": 1, "bytes": 2},
    ]
    assert output["malformed"] == output["messages"]["MTData2"] == 1
    text = run("info", str(tmp_path / "log.mtb")).stdout
    assert "malformed 1: the packets do not fill the message\n" in text
    _, _, rows = text.partition("\nunknown data identifiers\n")
    assert rows.splitlines() == [
        "id      packets  bytes",
        "0xC2A0        1      5",
        "0x4020        1      2",
    ]


def test_utc_without_the_valid_flag_is_ignored(tmp_path: Path) -> None:
    def utc(valid: int, month: int = 7, second: int = 7) -> bytes:
        date = (2025).to_bytes(2, "big") + bytes([month, 13, 9, 21, second, valid])
        return sample(packet(0x1010, bytes(4) + date))

    output = output_of(utc(0) + utc(3), tmp_path)
    assert output["utc"] == {"first": None, "last": None, "rows": 2, "valid": 0}
    assert (
        "UTC       sent, but never marked as valid\n"
        in run("info", str(tmp_path / "log.mtb")).stdout
    )
    output = output_of(utc(0, second=1) + utc(7) + utc(0x37, second=9) + utc(7, month=13), tmp_path)
    assert output["utc"] == {
        "first": "2025-07-13T09:21:07.000000000Z",
        "last": "2025-07-13T09:21:09.000000000Z",
        "rows": 4,
        "valid": 2,
    }


def test_a_log_without_samples(tmp_path: Path) -> None:
    output = output_of(encode_frame(0x32, bytes(40)) * 3, tmp_path)
    assert (output["samples"], output["messages"]) == (0, {"MTData": 3})
    assert (output["duration_s"], output["start_s"], output["utc"]) == (None, None, None)
    text = run("info", str(tmp_path / "log.mtb")).stdout
    assert "samples   0\n" in text
    assert "messages  MTData 3\n" in text


@pytest.mark.parametrize(
    ("restarts", "text"),
    [
        (0, "no run has two time stamps"),
        (1, "no run has two time stamps; restarted 1 time"),
        (9, "no run has two time stamps; restarted 9 times"),
    ],
)
def test_a_duration_needs_two_time_stamps(restarts: int, text: str) -> None:
    sent = sample(counter(1), fine(100))
    data = sent + (frame(MessageId.WakeUp, b"") + sent) * restarts
    page = " ".join(info_text("x", facts_of(data)).split())
    assert f"duration not known: {text} samples" in page


def test_a_log_without_counter_and_time(tmp_path: Path) -> None:
    output = output_of(sample(packet(0x3010, bytes(4))) * 2, tmp_path)
    assert output["quantities"][0]["rate_hz"] is None
    assert (
        "losses    no packet counter to detect losses\n"
        in run("info", str(tmp_path / "log.mtb")).stdout
    )


@pytest.mark.parametrize("name", [f"mtig710-{i}" for i in range(1, 6)])
def test_published_recordings(name: str) -> None:
    path = str(shared(f"captures/{name}/raw.bin"))
    output = only(run("info", "--json", path).stdout)
    assert (output["samples"], output["lost_samples"], output["damage"]) == (100, 0, [])
    assert output["utc"]["first"].startswith("2019-01-20T13:47:2")
    assert "device    not named in this log\n" in run("info", path).stdout
