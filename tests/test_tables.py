"""The tables of the package, compared with the specification beside the repository."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from typing import Any

import pytest

import reference
from conftest import shared
from xbus import Coordinates, DataId, MessageId, Precision
from xbus.protocol.tables import (
    MESSAGES,
    PRODUCTS,
    QUANTITIES,
    RESULT_CODES,
    STATUS_FLAGS,
    Quantity,
)


def rows(path: str) -> Iterator[dict[str, str]]:
    """Returns the rows of a table beside the repository."""
    with shared(path).open(newline="") as file:
        yield from csv.DictReader(file)


# ---------------------------------------------------------------------------------------------
# Data identifiers
# ---------------------------------------------------------------------------------------------

#: Kept as unknown packets on purpose: blobs, other product lines, layouts that are disputed.
OPAQUE = {0x8840, 0x88A0, 0xA080, 0xC820, 0xC830, 0xC840, 0xCA30, 0xCA40}

#: Units that the list spells differently.
OTHER_UNITS = {"-": "", "count": "", "packets": "", "bits": "", "ADC": "", "device ticks": ""}

NUMBER = {
    "U1": "u1",
    "U2": "u2",
    "U4": "u4",
    "U8": "u8",
    "I1": "i1",
    "I2": "i2",
    "I4": "i4",
    "F4": "f4",
}


def sizes(quantity: Quantity) -> list[int]:
    """Returns the sizes of a packet in bytes, by precision or kind."""
    if quantity.kind == "real":
        return [quantity.numbers * value for value in (4, 4, 6, 8)]
    if quantity.kind == "id":
        return [4, 8]
    return [quantity.size or 0]


def test_data_identifiers_match_the_list() -> None:
    listed = {int(row["base_id"], 16) for row in rows("spec/data_ids.csv")}
    assert {quantity.id for quantity in QUANTITIES.values()} == listed - OPAQUE


def test_quantities() -> None:
    """Name, group, layout, unit, precision, coordinates and products of every row of the list."""
    by_id = {quantity.id: quantity for quantity in QUANTITIES.values()}
    for row in rows("spec/data_ids.csv"):
        quantity = by_id.get(int(row["base_id"], 16))
        if quantity is None:
            continue
        legacy = "legacy" in row["name"]
        assert quantity.manual == row["name"].split(" ")[0]
        assert quantity.name.replace("_", "") == quantity.manual.lower()
        assert (quantity.kind == "real") == (row["precision"] == "y"), quantity
        assert quantity.coordinates == (row["coord"] == "y"), quantity
        if quantity.kind == "list":
            assert row["size_bytes"] == "8+4*N"
        else:
            listed = sorted({int(part) for part in row["size_bytes"].split("/")})
            assert sorted(set(sizes(quantity))) == listed, quantity
        if quantity.kind not in ("struct", "list"):
            assert quantity.unit == OTHER_UNITS.get(row["unit"], row["unit"]), quantity
        numbers = re.match(r"([UI]\d)\b", row["payload_layout"])
        if quantity.kind in NUMBER.values() and numbers:
            assert quantity.kind == NUMBER[numbers[1]], quantity
        products = {
            int(item)
            for item in re.findall(r"\b\d+\b", re.sub(r"\(.*\)|G-700", "", row["products"]))
        }
        if not legacy and row["in_seed"] == "y":
            assert set(quantity.products) == products, quantity


def test_quantities_match_the_reference() -> None:
    """The reference has an independent copy of the manual's tables."""
    tables: dict[int, tuple[Any, ...]] = {
        **reference.REALS,
        **reference.NUMBERS,
        **reference.STRUCTS,
    }
    names = {base: row[0] for base, row in tables.items()}
    names |= {reference.DEVICE_ID_PACKET: "device_id", reference.GNSS_SAT_INFO: "gnss_sat_info"}
    assert {quantity.id: quantity.name for quantity in QUANTITIES.values()} == names
    for base, (_, count) in reference.REALS.items():
        quantity = QUANTITIES[names[base]]
        assert (quantity.kind, quantity.numbers, len(quantity.components) or 1) == (
            "real",
            count,
            count,
        )
    for base, (_, layout, fields) in reference.STRUCTS.items():
        types = [reference.DTYPES[item] for item in layout]
        expected = list(zip(fields.lower().split(), types, strict=True))
        assert [
            (field.name.lower(), field.type) for field in QUANTITIES[names[base]].fields
        ] == expected
    info = QUANTITIES["gnss_sat_info"]
    assert " ".join(field.name for field in info.fields) == reference.SAT_INFO_FIELDS
    assert " ".join(item.name for item in info.entry) == reference.SATELLITE_FIELDS
    assert {quantity.id for quantity in QUANTITIES.values() if quantity.coordinates} == set(
        reference.ROTATES
    )


#: Field, type, scale, unit: Table 25 of the manual, with the errata of FACTS 3.7.
PVT = """
    itow       u4  0.001  s       height    i4  0.001  m        headAcc  u4  1e-05  deg
    year       u2  1      -       hMSL      i4  0.001  m        headVeh  i4  1e-05  deg
    month      u1  1      -       hAcc      u4  0.001  m        gdop     u2  0.01   -
    day        u1  1      -       vAcc      u4  0.001  m        pdop     u2  0.01   -
    hour       u1  1      -       velN      i4  0.001  m/s      tdop     u2  0.01   -
    min        u1  1      -       velE      i4  0.001  m/s      vdop     u2  0.01   -
    sec        u1  1      -       velD      i4  0.001  m/s      hdop     u2  0.01   -
    valid      u1  1      -       gSpeed    i4  0.001  m/s      ndop     u2  0.01   -
    tAcc       u4  1e-09  s       headMot   i4  1e-05  deg      edop     u2  0.01   -
    nano       i4  1e-09  s       sAcc      u4  0.001  m/s      fixtype  u1  1      -
    lon        i4  1e-07  deg     flags     u1  1      -        numSV    u1  1      -
    lat        i4  1e-07  deg     Reserved1 u1  1      -
"""


def test_table_25() -> None:
    words = PVT.split()
    expected = {
        name: (kind, float(scale), unit.strip("-"))
        for name, kind, scale, unit in zip(*[iter(words)] * 4, strict=True)
    }
    found = {
        field.name: (field.type, field.scale, field.unit)
        for field in QUANTITIES["gnss_pvt_data"].fields
    }
    assert found == expected


def test_table_17() -> None:
    """Precisions and coordinate systems, by their bits."""
    assert {item.name: item.value for item in Precision} == {
        "Float32": 0,
        "Fp1220": 1,
        "Fp1632": 2,
        "Float64": 3,
    }
    assert {Coordinate.name: Coordinate.value for Coordinate in Coordinates} == {
        "ENU": 0x0,
        "NED": 0x4,
        "NWU": 0x8,
    }


def test_table_27() -> None:
    """The bits of StatusWord match the manual, and its text contains the words."""
    flags = {
        status_flag.name: (status_flag.bit, status_flag.width)
        for status_flag in STATUS_FLAGS.values()
    }
    assert {name: bits for name, bits in flags.items() if bits[1] > 1} == {
        "no_rotation_update_status": (3, 2),
        "filter_mode": (23, 3),
        "rtk_status": (27, 2),
    }
    assert flags["selftest"] == (0, 1)
    assert flags["filter_valid"] == (1, 1)
    assert flags["gnss_fix"] == (2, 1)
    assert flags["clipping"] == (19, 1)
    assert flags["have_gnss_time_pulse"] == (26, 1)


# ---------------------------------------------------------------------------------------------
# Messages
# ---------------------------------------------------------------------------------------------


def names(text: str) -> set[str]:
    """The names in a cell: ``Req/SetHeading (reserved, legacy)`` has two."""
    modern = "Modern" if "(modern)" in text else ""
    text = re.sub(r"\s*\(.*?\)", "", text).replace("Goto", "GoTo")
    if text.startswith("Req/Set"):
        return {"Req" + text[7:], "Set" + text[7:]}
    first, _, second = text.partition(" / ")
    if second == "SetAck":
        second = f"Set{first}Ack"
    return {first + modern, second} - {""}


def lengths(text: str) -> set[int]:
    """``0 2 6`` or ``0..120 step 12``."""
    if found := re.fullmatch(r"(\d+)\.\.(\d+)(?: step (\d+))?", text):
        first, last, step = (int(group or 1) for group in found.groups())
        return set(range(first, last + 1, step))
    return {int(part) for part in text.split()}


def test_message_identifiers_match_the_list() -> None:
    listed: dict[int, set[str]] = {}
    for row in rows("spec/messages.csv"):
        listed.setdefault(int(row["hex"], 16), set()).update(names(row["name"]))
    found: dict[int, set[str]] = {}
    for message in MESSAGES.values():
        found.setdefault(message.mid, set()).add(message.name)
    assert found == listed


def test_messages_of_devices() -> None:
    """Directions, and the lengths that make a frame plausible."""
    listed: dict[int, set[int]] = {}
    for row in rows("spec/messages.csv"):
        if "mt->host" in row["direction"]:
            listed.setdefault(int(row["hex"], 16), set()).update(lengths(row["lengths"]))
    listed[MessageId.MTData] = set(range(1, 2049))  # the list has no lengths of it
    to_host = [message for message in MESSAGES.values() if message.direction != "to device"]
    assert {item.mid for item in to_host} == set(listed)
    assert {item.mid: set(item.lengths or ()) for item in to_host} == listed
    assert {mid: set(sizes) for mid, sizes in reference.LENGTHS.items()} | {0x36: set()} == listed


def test_replies() -> None:
    for row in rows("spec/messages.csv"):
        mid, ack = int(row["hex"], 16), row["ack_mid"]
        replies = {message.reply for message in MESSAGES.values() if message.mid == mid}
        assert replies == {int(ack, 16) if ack.startswith("0x") else None}, row


def test_states() -> None:
    for row in rows("spec/messages.csv"):
        mid, text = int(row["hex"], 16), row["states"]
        if "measurement" not in text and "config" not in text and "wakeup" not in text:
            continue
        expected = tuple(name for name in ("wakeup", "config", "measurement") if name in text)
        assert {message.states for message in MESSAGES.values() if message.mid == mid} == {
            expected
        }, row


def test_products_of_messages() -> None:
    """The product rows of section 5.3, if the text has them or the paired message has."""
    for row in rows("spec/messages.csv"):
        if "series" in row["products"]:
            continue
        text = re.sub(r"\(.*\)", "", row["products"])
        listed = {int(item) for item in re.findall(r"\b\d+\b", text)} & set(PRODUCTS)
        # InitBus was seen on an MTi-300 only, but the vendor's software sends it to every MTi.
        every = text.startswith("all") or row["name"].startswith("InitBus")
        expected = set(PRODUCTS) if every else listed
        for message in MESSAGES.values():
            if message.name in names(row["name"]):
                assert set(message.products) == expected, row


def test_replies_are_messages_to_the_host() -> None:
    directions = {message.mid: message.direction for message in MESSAGES.values()}
    for message in MESSAGES.values():
        if message.reply is not None and message.name != "WakeUp":
            assert directions[message.reply] in ("to host", "both"), message
    assert (
        next(message for message in MESSAGES.values() if message.name == "WakeUp").reply
        == MessageId.WakeUpAck
    )


def test_products() -> None:
    """The sixteen of the manual's section 3."""
    assert sorted(PRODUCTS) == [1, 2, 3, 7, 10, 20, 30, 100, 200, 300, 610, 620, 630, 670, 680, 710]
    assert {product.series for product in PRODUCTS.values()} == {
        "1-series",
        "10-series",
        "100-series",
        "600-series",
    }
    assert (PRODUCTS[680].name, PRODUCTS[710].name) == ("MTi-680G", "MTi-G-710")


@pytest.mark.parametrize(
    ("code", "word"),
    [(3, "period"), (4, "message"), (30, "timer"), (32, "baud"), (33, "parameter"), (40, "device"),
     (41, "baud rate"), (49, "profile"), (401, "GNSS"), (404, "calibrat")],
)  # fmt: skip
def test_result_codes(code: int, word: str) -> None:
    """Table 5 and FACTS 10."""
    assert word.lower() in RESULT_CODES[code].lower()


# ---------------------------------------------------------------------------------------------
# Enums
# ---------------------------------------------------------------------------------------------


def test_enums() -> None:
    """Members of the enums are the rows of the tables, whose integers they are."""
    assert {item.name: int(item) for item in DataId} == {
        quantity.manual: quantity.id for quantity in QUANTITIES.values()
    }
    members = {name: int(mid) for name, mid in MessageId.__members__.items()}
    assert members == {message.name: message.mid for message in MESSAGES.values()}
    assert (MessageId.GoToConfig, MessageId.MTData2, DataId.Quaternion) == (0x30, 0x36, 0x2010)
    assert MessageId(0x30).name == "GoToConfig"
