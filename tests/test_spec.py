"""What the manual prints, and what devices are known to have sent: each line a test of both directions.

The tables in ``tests/spec`` are read by the Rust tests as well. The list beside the repository is longer.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import reference
import xbus
from conftest import differences, facts, facts_of, read, shared
from xbus import MessageId, Scanner, encode_frame, encode_packet, encode_sample

SPEC = Path(__file__).parent / "spec"


def lines(path: Path) -> list[str]:
    return [
        line for line in path.read_text(encoding="utf-8").splitlines() if line and line[0] != "#"
    ]


# ---------------------------------------------------------------------------------------------
# The manual's own examples
# ---------------------------------------------------------------------------------------------

OUTPUTS = """1020 FFFF 1060 FFFF 2010 0064 4020 0190 8020 0190 C020 0064 E020 FFFF
             5042 0064 5022 0064 D012 0064"""

# Message, payload, wire: sections 5.1 and 5.3, and the dialogue of section 6.
EXAMPLES = [
    ("ReqDID", "", "FA FF 00 00 01"),
    ("ReqBaudrate", "", "FA FF 18 00 E9"),
    ("SetBaudrateAck", "", "FA FF 19 00 E8"),
    ("SetOptionFlags", "00000001 00000002", "FA FF 48 08 00 00 00 01 00 00 00 02 AE"),
    ("SetOptionFlags", "00000010 00000000", "FA FF 48 08 00 00 00 10 00 00 00 00 A1"),
    ("SetStringOutputType", "0000", "FA FF 8E 02 00 00 71"),
    ("IccCommandAck", "01 40803A85 02 00", "FA FF 75 07 01 40 80 3A 85 02 00 03"),
    ("GoToConfig", "", "FA FF 30 00 D1"),
    ("GoToConfigAck", "", "FA FF 31 00 D0"),
    ("SetOutputConfiguration", OUTPUTS,
     "FA FF C0 28 10 20 FF FF 10 60 FF FF 20 10 00 64 40 20 01 90 80 20 01 90 C0 20 00 64 E0 20 FF "
     "FF 50 42 00 64 50 22 00 64 D0 12 00 64 73"),
    ("SetOutputConfigurationAck", OUTPUTS,
     "FA FF C1 28 10 20 FF FF 10 60 FF FF 20 10 00 64 40 20 01 90 80 20 01 90 C0 20 00 64 E0 20 FF "
     "FF 50 42 00 64 50 22 00 64 D0 12 00 64 72"),
    ("SetBaudrate", "80", "FA FF 18 01 80 68"),
    ("SetFilterProfile", "0002", "FA FF 64 02 00 02 99"),
    ("SetFilterProfileAck", "", "FA FF 65 00 9C"),
    ("GoToMeasurement", "", "FA FF 10 00 F1"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "payload", "wire"), EXAMPLES, ids=[example[0] for example in EXAMPLES]
)
def test_examples_of_the_manual(name: str, payload: str, wire: str) -> None:
    """Encoded, and found again in every way of cutting it up."""
    raw, data = bytes.fromhex(wire), bytes.fromhex(payload)
    assert encode_frame(MessageId[name], data) == raw
    for cut in range(len(raw)):
        scanner = Scanner()
        (found,) = scanner.feed(raw[:cut]) + scanner.feed(raw[cut:]) + scanner.close()
        assert isinstance(found, xbus.Message)
        assert (found.mid, found.payload, found.bid, found.offset) == (
            MessageId[name],
            data,
            0xFF,
            0,
        )


def test_mtdata2_of_section_6() -> None:
    """Decoded to the digits that it is worth, and encoded from them."""
    wire = bytes.fromhex(
        "FA FF 36 31 10 20 02 DF C5 10 60 04 00 45 9D A0 40 20 0C BE DC 9A FA 3F 54 9F 37 41 1C BB 70 "
        "80 20 0C BB AA 5C 80 3B 8C 55 01 BB 81 33 00 E0 20 04 00 00 00 81 45"
    )
    log = xbus.read_log(wire)
    assert log["packet_counter"].values.tolist() == [57285]
    assert log["sample_time_fine"].values.tolist() == [4562336]
    acceleration, rate_of_turn = [-0.43087, 0.83055, 9.79576], [-0.0051990, 0.0042826, -0.0039428]
    assert log["acceleration"].values[0] == pytest.approx(acceleration, abs=5e-6)
    assert log["rate_of_turn"].values[0] == pytest.approx(rate_of_turn, abs=5e-8)
    assert log["status_word"].values.tolist() == [0x81]
    assert log.time.tolist() == [456.2336]
    assert encode_sample({key: log[key].values[0] for key in log}) == wire


def test_numbers_of_section_5() -> None:
    """5.1.1: 1275 is 04FB, 9.81 is 411CF5C3."""
    assert encode_packet("packet_counter", 1275)[3:].hex() == "04fb"
    assert encode_packet("temperature", 9.81)[3:].hex() == "411cf5c3"


# ---------------------------------------------------------------------------------------------
# Tables that the Rust tests read too
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("line", lines(SPEC / "frames.txt"))
def test_frames(line: str) -> None:
    """Name, MID, payload, wire."""
    name, mid, payload, wire = re.split(r"\s{2,}", line.strip())
    raw, data = bytes.fromhex(wire), bytes.fromhex(payload.strip("-"))
    assert encode_frame(int(mid, 16), data) == raw
    scanner = Scanner()
    messages = [item for byte in raw for item in scanner.feed(bytes([byte]))] + scanner.close()
    (message,) = messages
    assert isinstance(message, xbus.Message)
    assert message[:1] + message[2:5] == (int(mid, 16), 0xFF, data, 0)
    assert MessageId[name] == int(mid, 16)


def numbers(column: xbus.Column) -> list[Any]:
    """The numbers of the first row, in the order of the wire."""
    row = column.values[0]
    if column.name == "rotation_matrix":
        row = row.T
    rows = [row, *column.satellites] if column.name == "gnss_sat_info" else [row]
    return [
        item
        for row in rows
        for item in (row.item() if row.dtype.names else row.reshape(-1).tolist())
    ]


@pytest.mark.parametrize("line", lines(SPEC / "items.txt"))
def test_items(line: str) -> None:
    """Identifier, quantity, precision, coordinates, data, numbers."""
    data_id, name, precision, coordinates, data, expected = (
        part.strip() for part in line.split("|")
    )
    raw = bytes.fromhex(data)
    wire = bytes.fromhex(data_id) + bytes([len(raw)]) + raw
    log = xbus.read_log(encode_frame(MessageId.MTData2, wire))
    column = log[name]
    assert (column.precision or "-", column.coordinates or "-") == (precision, coordinates)
    assert column.data_id == int(data_id, 16)
    found = numbers(column)
    single = precision == "Float32" or name.startswith("raw_float")
    for text, value in zip(expected.split(), found, strict=True):
        wanted: Any = float(text) if "." in text or "e" in text or "inf" in text else int(text)
        assert value == (np.float32(wanted) if single else wanted)
        assert str(np.signbit(value)) == str(text.startswith("-"))
    key = tuple(item for item in (name, precision, coordinates) if item != "-")
    again = encode_packet(
        key, column.values[0] if name != "gnss_sat_info" else (column.values[0], column.satellites)
    )
    assert again[2:] == wire[2:]
    assert (again == wire) == (name != "baro_pressure" or data_id == "3010")


# ---------------------------------------------------------------------------------------------
# All that is published
# ---------------------------------------------------------------------------------------------


def published() -> list[tuple[str, bytes]]:
    """Line and frame."""
    found = [(line, bytes.fromhex(line.split("#")[0])) for line in lines(shared("spec/frames.txt"))]
    assert len(found) > 90
    return found


def test_published_frames_one_by_one() -> None:
    """Each is read as the oracle reads it, and encoded from what was read."""
    for line, raw in published():
        log = xbus.read_log(raw)
        assert differences(facts(log), facts_of(reference.decode(raw))) == [], line
        assert log.stats.frames == 1, line
        scanner = Scanner(65535)
        (message,) = scanner.feed(raw) + scanner.close()
        assert isinstance(message, xbus.Message)
        assert encode_frame(message.mid, message.payload, bid=message.bid) == raw, line


def test_published_frames_together() -> None:
    """In a row they are one sound log, those of a host included."""
    frames = [raw for _, raw in published()]
    data = b"".join(frames)
    mtig = 0x0006, 0x00000001  # calibrated data, a quaternion and the counter
    log = xbus.read_log(data, strict=True, legacy=mtig)
    assert (log.stats.frames, log.stats.unfit) == (len(frames), 0)
    log = xbus.read_log(data)
    assert (log.stats.frames, log.stats.unfit) == (len(frames), 2)
    assert differences(facts(log), facts_of(reference.decode(data))) == []
    assert differences(facts(read(data * 20)), facts_of(reference.decode(data * 20))) == []


def test_published_frames_have_the_names_of_the_manual() -> None:
    """Every message that the list names is known by that MID."""
    for line, raw in published():
        found = [message for message in xbus.read_log(raw).messages if message.mid != 0x36]
        assert all(not item.name.startswith("0x") for item in found), line
