"""MTData of older devices, one message at a time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from xbus import _core, encode_frame
from xbus.protocol.mtdata import MTDATA_ITEMS
from xbus.protocol.tables import COLUMN_QUANTITIES, MTDATA_QUANTITIES, QUANTITIES
from xbus.wire.mtdata import decode_mtdata, encode_mtdata, mtdata_layout

SENSORS = {
    "acceleration": [0.5, -0.25, 9.8125],
    "rate_of_turn": [0.125, -0.0625, 0.03125],
    "magnetic_field": [0.5, 0.25, -0.75],
}
EULER = {"euler_angles": [10.5, -20.25, 179.5], "packet_counter": 4660}

#: Complete frames: OutputMode, OutputSettings, bytes, values. The first three are from devices: two of
#: them from an MTi-G, with rebuilt header and checksum. The others follow the layout of the vendor's library.
FRAMES: dict[str, tuple[int, int, str, dict[str, Any]]] = {
    "a device without magnetometer": (
        0x0006,
        0x00000044,
        "FAFF3224BEABE371BDE9D2C0411D110DB9D691F0BC019057BB07A335BF124C383FF51185C2E53D09E0",
        {
            "acceleration": [-0.3357196, -0.1141715, 9.816663],
            "rate_of_turn": [-0.0004092599, -0.007907948, -0.002069664],
            "euler_angles": [-0.5714755, 1.914597, -114.6192],
        },
    ),
    "an MTi-G": (
        0x0006,
        0x00000001,
        "FAFF32363D618499BD2559AD411D13ED3B1B5260BAC11234BB7F213FBE3A38CC3E49C10CBEA3FCDA3E8BAD87BB5302CB3BF3D3BABF7647"
        "E04B3341",
        {
            "acceleration": [0.0550581, -0.04036872, 9.817365],
            "rate_of_turn": [0.002370022, -0.001473016, -0.003892973],
            "magnetic_field": [-0.1818573, 0.1970255, -0.3202885],
            "quaternion": [0.2728083, -0.003219771, 0.007441011, -0.9620342],
            "packet_counter": 19251,
        },
    ),
    "its next message": (
        0x0006,
        0x00000001,
        "FAFF32363DA6C684BD576F7E411D096D3C082A01BC07803C3A6094CBBE3A15783E4A3450BEA4556A3E8BAE07BB5529D13BF1A408BF7647"
        "D54B34CE",
        {
            "acceleration": [0.08143333, -0.05259656, 9.814801],
            "rate_of_turn": [0.008310796, -0.00827032, 0.0008567094],
            "magnetic_field": [-0.1817225, 0.1974652, -0.3209642],
            "quaternion": [0.2728121, -0.003252615, 0.00737429, -0.9620336],
            "packet_counter": 19252,
        },
    ),
    "factory settings": (
        0x0004,
        0x00000001,
        "FAFF32123F0000003F0000003F0000003F00000012347B",
        {"quaternion": [0.5, 0.5, 0.5, 0.5], "packet_counter": 4660},
    ),
    "Euler angles": (0x0004, 0x00000005, "FAFF320E41280000C1A20000433380001234B9", EULER),
    "Euler angles, Fp1220": (0x0004, 0x00000105, "FAFF320E00A80000FEBC00000B3800001234D6", EULER),
    "Euler angles, Fp1632": (
        0x0004,
        0x00000205,
        "FAFF321480000000000AC0000000FFEB8000000000B312340E",
        EULER,
    ),
    "Euler angles, Float64": (
        0x0004,
        0x00000305,
        "FAFF321A4025000000000000C03440000000000040667000000000001234C0",
        EULER,
    ),
    "matrix, column by column": (
        0x0006,
        0x00000009,
        "FAFF324A3F000000BE800000411D00003E000000BD8000003D0000003F0000003E800000BF400000000000003F80000000000000BF8000"
        "00000000000000000000000000000000003F8000001234F3",
        SENSORS | {"rotation_matrix": [[0, -1, 0], [1, 0, 0], [0, 0, 1]], "packet_counter": 4660},
    ),
    "raw": (
        0x4000,
        0x00000001,
        "FAFF3216800080E8AFC87FBC7FC67FD07530791888B819101234A6",
        {
            "raw_acc_gyr_mag_temp": {
                "accX": 32768,
                "accY": 33000,
                "accZ": 45000,
                "gyrX": 32700,
                "gyrY": 32710,
                "gyrZ": 32720,
                "magX": 30000,
                "magY": 31000,
                "magZ": 35000,
                "Temp": 6416,
            },
            "packet_counter": 4660,
        },
    ),
    "everything of an MTi-G, NED": (
        0x1836,
        0x80000C05,
        "FAFF3277C5E603149AA0B01F234439041371C2000168B9FFFFFF6A000000E1FFFFFFF4000009C400000FA00000003C0A3F000000BE8000"
        "00411D00003E000000BD8000003D0000003F0000003E800000BF4000003F80000040000000404000004251000040DC0000423600003FC0"
        "0000C01000003E000000071234F7",
        {
            "baro_pressure": 101324,
            "pressure_age": 3,
            "gps_pvt_data": {
                "itow": 345678000,
                "lat": 522404921,
                "lon": 68383170,
                "height": 92345,
                "velN": -150,
                "velE": 225,
                "velD": -12,
                "hAcc": 2500,
                "vAcc": 4000,
                "sAcc": 60,
            },
            "gnss_age": 10,
            **SENSORS,
            "euler_angles": [1, 2, 3],
            "lat_lon": [52.25, 6.875],
            "altitude_ellipsoid": 45.5,
            "velocity_xyz": [1.5, -2.25, 0.125],
            "status_byte": 7,
            "packet_counter": 4660,
        },
    ),
    "pressure without GPS": (
        0x1000,
        0x00080001,
        "FAFF3205C5E6031234D6",
        {"baro_pressure": 101324, "pressure_age": 3, "packet_counter": 4660},
    ),
    "detailed status": (
        0x0804,
        0x00000081,
        "FAFF32163F80000000000000000000000000000000400003123471",
        {"quaternion": [1, 0, 0, 0], "status_word": 0x400003, "packet_counter": 4660},
    ),
    "the first analog input": (
        0x0008,
        0x00000801,
        "FAFF3204123412343F",
        {"analog_in1": 4660, "packet_counter": 4660},
    ),
}


@pytest.mark.parametrize(("mode", "settings", "text", "values"), FRAMES.values(), ids=FRAMES)
def test_published_frames_both_ways(
    mode: int, settings: int, text: str, values: dict[str, Any]
) -> None:
    frame = bytes.fromhex(text)
    payload = frame[4:-1]
    assert mtdata_layout(mode, settings).size == len(payload)

    decoded = decode_mtdata(payload, mode, settings)

    assert list(decoded) == list(values)
    for name, value in values.items():
        if isinstance(value, dict):
            assert decoded[name] == value
        else:  # printed with 7 digits
            np.testing.assert_allclose(decoded[name], value, rtol=1e-6)
    assert encode_mtdata(decoded, mode, settings) == frame


def test_a_message_that_starts_with_its_sensors_and_has_no_magnetic_field() -> None:
    """The author of the dump left out the magnetic field of a longer message."""
    payload = bytes.fromhex(
        "3F0FF6F9BE8E582B411CBABE3C0BDCAABD7F6409BC4BB4F6BFE5EE64C0479B9EC2BA88E6 038B"
    )
    values = decode_mtdata(payload, 0x0006, 0x00000045)
    np.testing.assert_allclose(
        np.concatenate([values["acceleration"], values["rate_of_turn"], values["euler_angles"]]),
        [0.5623623, -0.2780164, 9.795591, 0.008536497, -0.06235126, -0.01243328, -1.796338, -3.118873,
         -93.26738],
        rtol=1e-6,
    )  # fmt: skip
    assert values["packet_counter"] == 907


@pytest.mark.parametrize(
    ("settings", "text", "value"),
    [
        (0x0100, "00100000", 1),
        (0x0100, "FFF04735", -0.98261547088623046875),
        (0x0200, "000000000001", 1),
        (0x0200, "00000000FFFF", -1),
        (0x0200, "80000000FFFF", -0.5),
        (0x0200, "600000000018", 24.375),
    ],
)
def test_fixed_point_numbers_both_ways(settings: int, text: str, value: float) -> None:
    temperature = 0x0001
    payload = bytes.fromhex(text)
    assert decode_mtdata(payload, temperature, settings)["temperature"] == value
    frame = encode_mtdata({"temperature": value}, temperature, settings)
    assert frame[4:-1] == payload


@pytest.mark.parametrize(
    ("word", "celsius"), [(0x1910, 25.0625), (0xE6F0, -25.0625), (0x0080, 0.5), (0xFF80, -0.5)]
)
def test_raw_temperatures_of_the_manual(word: int, celsius: float) -> None:
    values = decode_mtdata(bytes(18) + word.to_bytes(2, "big"), 0x4000, 0)
    assert values["raw_acc_gyr_mag_temp"].scaled["Temp"] == celsius


@pytest.mark.parametrize(
    ("mode", "settings", "size"),
    [
        (0x0006, 0x00000001, 54),
        (0x0006, 0x00000044, 36),
        (0x0006, 0x00000009, 74),
        (0x080F, 0x80000005, 59),
        (0x4000, 0x00000001, 22),
        (0x4000, 0x01000001, 28),
        (0x0004, 0x00000105, 14),
        (0x1836, 0x80000C05, 119),
        (0x0837, 0x00000046, 77),
        (0x0200, 0x00000000, 13 + 13 * 4),
        (0x0200, 0x00000300, 13 + 13 * 8),
        (0x0001, 0x01000200, 4 * 6),
        (0x0000, 0x02000003, 2 + 12 + 4),
    ],
)
def test_lengths_of_settings_seen_with_devices(mode: int, settings: int, size: int) -> None:
    assert mtdata_layout(mode, settings).size == size


def test_coordinates_are_those_of_bit_31() -> None:
    items = {item.name: item for item in mtdata_layout(0x0024, 0x80000000).items}
    assert items["quaternion"].coordinates == items["velocity_xyz"].coordinates == "NED"
    items = {item.name: item for item in mtdata_layout(0x0024, 0x00000000).items}
    assert items["quaternion"].coordinates == items["velocity_xyz"].coordinates == "NWU"


@pytest.mark.parametrize(
    ("mode", "settings", "says"),
    [
        (0x8000, 0x00000000, "MT9"),
        (0x0004, 0x0000000C, "bits 2 and 3"),
        (0x0010, 0x00004000, "bits 14 to 16"),
        (0x0020, 0x00020000, "bits 17 and 18"),
    ],
)
def test_layouts_that_nobody_knows_are_refused(mode: int, settings: int, says: str) -> None:
    with pytest.raises(ValueError, match=says) as refused:
        mtdata_layout(mode, settings)
    assert f"{mode:04X}:{settings:08X}" in str(refused.value)
    # What is not selected needs no form.
    assert mtdata_layout(0x0000, settings).size == 0


def test_a_payload_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="0006:00000001 has 54 bytes, not 53"):
        decode_mtdata(bytes(53), 0x0006, 0x00000001)


def test_values_that_are_missing_or_do_not_fit_are_refused() -> None:
    with pytest.raises(KeyError, match="0004:00000001 needs packet_counter"):
        encode_mtdata({"quaternion": [1, 0, 0, 0]}, 0x0004, 0x00000001)
    with pytest.raises(ValueError, match="packet_counter"):
        encode_mtdata({"packet_counter": 65536}, 0x0000, 0x00000001)
    with pytest.raises(ValueError, match="quaternion"):
        encode_mtdata({"quaternion": [1, 0, 0]}, 0x0004, 0x00000000)
    with pytest.raises(ValueError, match="baro_pressure"):
        encode_mtdata({"baro_pressure": 131072, "pressure_age": 0}, 0x1000, 0x00080000)


def test_the_pressure_is_rounded_to_steps_of_2_pa() -> None:
    frame = encode_mtdata({"baro_pressure": 101325.0, "pressure_age": 255}, 0x1000, 0x00080000)
    assert decode_mtdata(frame[4:-1], 0x1000, 0x00080000)["baro_pressure"] == 101326


def test_batches_are_the_messages_one_by_one() -> None:
    counters, angles = np.arange(5), np.linspace(0, 90, 15).reshape(5, 3)
    frames = _core.encode_mtdata(0x0004, 0x00000205, [angles, counters], 1)
    each = [
        encode_mtdata({"euler_angles": angles[at], "packet_counter": at}, 0x0004, 0x0205, bid=1)
        for at in range(5)
    ]
    assert frames.data == b"".join(each)
    assert frames.ends.tolist() == np.cumsum([len(frame) for frame in each]).tolist()


def test_settings_that_select_nothing_give_an_empty_message() -> None:
    assert encode_mtdata({}, 0, 0) == encode_frame(0x32)
    assert list(decode_mtdata(b"", 0, 0)) == []


def test_quantities_that_only_mtdata_has_are_no_packets() -> None:
    others = set(COLUMN_QUANTITIES) - set(MTDATA_QUANTITIES)
    assert not others & set(MTDATA_QUANTITIES)
    ids = {row.id for name, row in COLUMN_QUANTITIES.items() if name in others}
    assert not ids & {row.id for row in MTDATA_QUANTITIES.values()}
    with pytest.raises(ValueError, match="gps_pvt_data has no packet; only MTData has it"):
        _core.encode_packet("gps_pvt_data", None, None, np.zeros(10, int))
    assert {item.quantity for item in MTDATA_ITEMS} <= set(QUANTITIES) | set(MTDATA_QUANTITIES)
