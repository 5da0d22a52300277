"""ROS 2: what messages say, and when. Files and commands are in `test_ros_files`."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from pynmeagps import NMEAReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import xbus
from conftest import counter, fine, shared
from ros_messages import Message, approximately, first, messages, store, values
from streams import mtdata2, packet, real
from test_cli import run
from xbus import encode_packet
from xbus.export.ros.cdr import Layout
from xbus.export.ros.definitions import DEFINITIONS, HASHES, definition_of
from xbus.export.ros.topics import TOPICS, Frames
from xbus.geometry.quaternion import rotate
from xbus.protocol.tables import QUANTITIES

ROOT = math.sqrt(0.5)
#: 2024-02-29T23:59:58.25, valid and not.
UTC = bytes.fromhex("0ee6b28007e8021d173b3a")
VALID, INVALID = packet(0x1010, UTC + b"\x07"), packet(0x1010, UTC + b"\x03")
STAMP = 1_709_251_198_250_000_000


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def written(data: bytes, **options: Any) -> list[Message]:
    """Returns the messages of a log."""
    xbus.read_log(data).to_mcap("out.mcap", compression="none", **options)
    return messages("out.mcap")


# Types


@pytest.mark.parametrize("name", HASHES)
def test_definitions_have_the_hashes_of_ros(name: str) -> None:
    ros, expected = name.replace("/", "/msg/"), f"RIHS01_{HASHES[name]}"
    own = get_typestore(Stores.EMPTY)
    own.register(get_types_from_msg(definition_of(name), ros))
    assert own.hash_rihs01(ros) == expected
    for version in (Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY):
        assert store(version).hash_rihs01(ros) == expected


def test_every_topic_has_a_type() -> None:
    assert {topic.type for topic in TOPICS} == set(HASHES) <= set(DEFINITIONS)


@given(frame=st.from_regex(r"[a-z]{1,12}", fullmatch=True), seed=st.integers(0, 2**32 - 1))
def test_bytes_are_those_that_rosbags_writes(frame: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    for topic in TOPICS:
        layout: Layout = topic.layout(Frames(*[frame] * 6))
        body = layout.bodies(1)
        for field in body.dtype.names or ():
            if field == "length":
                body[field] = 1
            elif field != "source":
                body[field] = rng.integers(0, 2, body[field].shape)  # flags are 0 or 1
        data = layout.head.data + body.tobytes() + (b"\0" if topic.name == "/nmea" else b"")
        kind = topic.type.replace("/", "/msg/")
        assert bytes(store().serialize_cdr(store().deserialize_cdr(data, kind), kind)) == data


# The driver's messages


def test_messages_of_the_driver() -> None:
    golden = json.loads(shared("spec/golden_ros2.json").read_text())
    compared = 0
    for sample in golden.values():
        found = written(bytes.fromhex(sample["xbus"]), ros_style="driver")
        expected = [
            Message(message["topic"], message["type"], 0, bytes.fromhex(message["cdr"]))
            for message in sample["messages"]
        ]
        assert [message[:2] for message in found] == [message[:2] for message in expected]
        for message, other in zip(found, expected, strict=True):
            assert values(message.content) == approximately(values(other.content))
            if message.topic not in ("/status", "/tf"):
                assert message.frame == other.frame
                if isinstance(sample["stamp"], list):
                    assert message.stamp == other.stamp
            compared += 1
    assert compared >= len(golden)


#: The vendor's code takes the quaternion of a matrix from the diagonal, and does not normalise it.
ROUNDED_SINE, LENGTH = 2 * float(np.float32(0.8)), 2 * math.sqrt(2 + 2 * float(np.float32(0.6)))
INERTIAL = real(0x4020, 1, 2, 3), real(0x8020, 4, 5, 6)
#: What packets of a sample become in the driver's style: topic, and numbers of its first message.
DRIVER: dict[str, tuple[bytes, str, list[Any]]] = {
    "no orientation": (
        b"".join(INERTIAL),
        "/imu/data",
        [0, 0, 0, 1, -1, *[0] * 8, 4, 5, 6, *[0] * 9, 1, 2, 3, *[0] * 9],
    ),
    "no rate of turn": (
        real(0x2010, 0.5, 0.5, 0.5, -0.5) + INERTIAL[0],
        "/imu/data",
        [0.5, 0.5, -0.5, 0.5, *[0] * 9, 0, 0, 0, -1, *[0] * 8, 1, 2, 3, *[0] * 9],
    ),
    "orientation as it is": (real(0x2017, 0.8, 0, 0, 0.6), "/filter/quaternion", [0, 0, 0.6, 0.8]),
    "euler angles in degrees": (real(0x2030, 10, -20, 30), "/filter/euler", [10, -20, 30]),
    "a matrix": (
        real(0x2023, 0, 1, 0, -1, 0, 0, 0, 0, 1),
        "/filter/quaternion",
        [0, 0, ROOT, ROOT],
    ),
    "a matrix that float32 rounds": (
        real(0x2020, 0.6, 0.8, 0, -0.8, 0.6, 0, 0, 0, 1),
        "/filter/quaternion",
        [0, 0, ROUNDED_SINE / LENGTH, LENGTH / 4],
    ),
    "a matrix of half a turn": (
        real(0x2020, 1, 0, 0, 0, -1, 0, 0, 0, -1),
        "/filter/quaternion",
        [-1, 0, 0, 0],
    ),
    "a quaternion before a matrix": (
        real(0x2020, 1, 0, 0, 0, 1, 0, 0, 0, 1) + real(0x2010, 0, 1, 0, 0),
        "/filter/quaternion",
        [1, 0, 0, 0],
    ),
    "the angles of a quaternion": (real(0x2013, ROOT, 0, 0, ROOT), "/filter/euler", [0, 0, 90]),
    "the last of two packets": (
        real(0x4020, 9, 9, 9) + real(0x4020, 1, 2, 3),
        "/imu/acceleration",
        [1, 2, 3],
    ),
    "the magnetic field": (
        real(0xC020, 0.25, -0.5, 0.75),
        "/imu/mag",
        [0.25, -0.5, 0.75, *[0] * 9],
    ),
    "ticks": (fine(1_234_567), "/imu/time_ref", [123, 456_700_000, ""]),
    "ticks and seconds": (
        fine(98_765) + packet(0x1070, bytes([0, 0, 0, 42])),
        "/imu/time_ref",
        [42, 876_500_000, ""],
    ),
    "utc that is not valid": (INVALID, "/imu/utctime", [STAMP // 10**9, 250_000_000, ""]),
    "pressure": (packet(0x3010, (101_325).to_bytes(4, "big")), "/pressure", [101_325, 0]),
    "a status byte": (packet(0xE010, b"\x7f"), "/status", [1, 1, 1, 3, 1, 1, *[0] * 15]),
    "a status word": (
        packet(0xE020, bytes.fromhex("1f6fff7f")),
        "/status",
        [1, 1, 1, 3, 1, 1, *[1] * 9, 1, 1, 1, 6, 1, 3],
    ),
    "velocity": (real(0xD014, 1, 2, 3) + INERTIAL[1], "/filter/twist", [1, 2, 3, 4, 5, 6]),
    "a position": (
        real(0x5040, 52.5, 6.75) + real(0x5020, 47.5),
        "/filter/positionlla",
        [52.5, 6.75, 47.5],
    ),
    "a pose": (
        real(0x5040, 52.5, 6.75) + real(0x5020, 47.5) + real(0x2010, 1, 0, 0, 0),
        "/gnss_pose",
        [52.5, 6.75, 47.5, 0, 0, 0, 1],
    ),
}


@pytest.mark.parametrize("name", DRIVER)
def test_driver(name: str) -> None:
    packets, topic, expected = DRIVER[name]
    found = first(written(mtdata2(packets), ros_style="driver"), topic)
    assert values(found.content) == pytest.approx(expected, abs=1e-12)


def test_the_decoder_of_mcap_reads_every_message() -> None:
    xbus.read_log(
        mtdata2(*INERTIAL, real(0x2010, 1, 0, 0, 0), pvt(), packet(0xE010, b"\x07"), VALID)
    ).to_mcap("a.mcap")
    with Path("a.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = {
            channel.topic: message for _, channel, _, message in reader.iter_decoded_messages()
        }
    assert found["/imu/data"].linear_acceleration.z == 3
    assert found["/tf"].transforms[0].child_frame_id == "imu_link"
    assert found["/gnss"].status.status == 2
    assert found["/status"].gnss_fix is True
    assert found["/nmea"].sentence.startswith("$GPGGA,")


# The style of the REPs

NED, NWU = real(0x2017, 0.8, 0, 0, 0.6), real(0x201B, 0.8, 0, 0, 0.6)
#: Topic, frame id and numbers of the first message, with options.
REP: dict[str, tuple[bytes, dict[str, Any], str, str, list[float]]] = {
    # The vendor's own conversion of the same quaternion gives these numbers.
    "ned to enu": (NED, {}, "/filter/quaternion", "world", [0.7 * 2 * ROOT, 0.1 * 2 * ROOT, 0, 0]),
    "nwu to enu": (NWU, {}, "/filter/quaternion", "world", [0, 0, 0.7 * 2 * ROOT, 0.1 * 2 * ROOT]),
    "ned kept": (
        NED,
        {"keep_coordinates": True},
        "/filter/quaternion",
        "world_ned",
        [0, 0, 0.6, 0.8],
    ),
    "ned kept, sensor": (
        NED + INERTIAL[0],
        {"keep_coordinates": True},
        "/imu/acceleration",
        "imu_link_ned",
        [1, 2, 3],
    ),
    "enu kept": (
        real(0x2013, 1, 0, 0, 0),
        {"keep_coordinates": True},
        "/filter/quaternion",
        "world",
        [0, 0, 0, 1],
    ),
    "velocity from ned": (real(0xD014, 1, 2, 3), {}, "/filter/velocity", "world", [2, 1, -3]),
    "velocity from nwu": (real(0xD018, 1, 2, 3), {}, "/filter/velocity", "world", [-2, 1, 3]),
    "velocity kept": (
        real(0xD018, 1, 2, 3),
        {"keep_coordinates": True},
        "/filter/velocity",
        "world_nwu",
        [1, 2, 3],
    ),
    "free acceleration": (
        NED + real(0x4030, 1, 2, 3),
        {},
        "/filter/free_acceleration",
        "world",
        [1, 2, 3],
    ),
    "free acceleration kept": (
        NED + real(0x4030, 1, 2, 3),
        {"keep_coordinates": True},
        "/filter/free_acceleration",
        "world",
        [1, 2, 3],
    ),
    "free acceleration in ned": (
        real(0x4034, 1, 2, 3),
        {},
        "/filter/free_acceleration",
        "world",
        [2, 1, -3],
    ),
    "angles in radians": (
        real(0x2033, 0, 0, 90),
        {},
        "/filter/euler",
        "world",
        [0, 0, math.pi / 2],
    ),
    # North in NED is yaw 0, in ENU it is 90 degrees; upside down.
    "angles from ned": (real(0x2037, 180, 0, 0), {}, "/filter/euler", "world", [0, 0, math.pi / 2]),
    "magnetic field in tesla": (
        real(0xC020, 0.5, 0, -1),
        {"mag_norm": 5e-5},
        "/imu/mag",
        "imu_link",
        [2.5e-5, 0, -5e-5, *[0] * 9],
    ),
    "rates in the local frame": (
        real(0xD010, 1, 2, 3) + INERTIAL[1] + real(0x2013, ROOT, 0, 0, ROOT),
        {},
        "/filter/twist",
        "world",
        [1, 2, 3, -5, 4, 6],
    ),
    "another frame id": (
        INERTIAL[0],
        {"frame_id": "imu1/link"},
        "/imu/acceleration",
        "imu1/link",
        [1, 2, 3],
    ),
}


@pytest.mark.parametrize("name", REP)
def test_rep(name: str) -> None:
    packets, options, topic, frame, expected = REP[name]
    found = first(written(mtdata2(packets), **options), topic)
    assert found.frame == frame
    assert values(found.content) == pytest.approx(expected, abs=1e-12)


def test_a_pose_is_in_the_frame_of_the_earth() -> None:
    # At latitude 0, longitude 90, east is -x, north is z and up is y.
    position = real(0x5043, 0, 90) + real(0x5020, 100)
    pose = first(written(mtdata2(position, real(0x2013, 1, 0, 0, 0))), "/gnss_pose")
    content = pose.content.pose
    assert pose.frame == "earth"
    assert values(content.position) == pytest.approx([0, 6_378_237, 0], abs=1e-6)
    x, y, z, w = values(content.orientation)
    q = np.array([[w, x, y, z]])
    turned = [rotate(q, axis)[0].round(12).tolist() for axis in np.eye(3)]
    assert turned == [[-1, 0, 0], [0, 0, 1], [0, 1, 0]]
    kept, converted = (
        first(written(mtdata2(position, NED), keep_coordinates=keeps), "/gnss_pose").data
        for keeps in (True, False)
    )
    assert kept == converted


@pytest.mark.parametrize("style", ["rep", "driver"])
def test_a_position_without_a_fix_is_not_published(style: Any) -> None:
    """The driver publishes the zeros that the filter has without one."""
    orientation, height = real(0x2013, 1, 0, 0, 0), real(0x5020, 100)
    positions = {
        "a fix": (real(0x5043, 52, 7), 0b110),
        "zero": (real(0x5043, 0, 0), 0b110),
        "no GNSS": (real(0x5043, 52, 7), 0b010),
        "not valid": (real(0x5043, 52, 7), 0b100),
        "no place": (real(0x5043, 91, 7), 0b110),
    }
    data = b"".join(
        mtdata2(
            counter(at), position, height, orientation, packet(0xE020, status.to_bytes(4, "big"))
        )
        for at, (position, status) in enumerate(positions.values())
    )
    found = [message.topic for message in written(data, ros_style=style)]
    expected = len(positions) if style == "driver" else 1
    assert found.count("/filter/positionlla") == found.count("/gnss_pose") == expected
    assert found.count("/status") == len(positions)
    # Of which positions there is a fix does not depend on what is chosen.
    names = ["lat_lon", "altitude_ellipsoid"]
    Path("log.mtb").write_bytes(data)
    chosen = [argument for name in names for argument in ("--quantity", name)]
    assert run("decode", "log.mtb", "-o", "out.mcap", "--ros-style", style, *chosen).exit_code == 0
    assert [message.topic for message in messages("out.mcap")] == ["/filter/positionlla"] * expected


def test_the_transform_is_that_of_the_orientation() -> None:
    [transform] = first(written(mtdata2(NED)), "/tf").content.transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("world", "imu_link")
    assert values(transform.transform) == pytest.approx([0, 0, 0, 1.4 * ROOT, 0.2 * ROOT, 0, 0])


#: The 40th of the 13th month; the year 2100, beyond the seconds of messages.
IMPOSSIBLE = packet(0x1010, bytes.fromhex("0000000507e70d2819010107"))
LATE = packet(0x1010, bytes.fromhex("000000050834010101010107"))


@pytest.mark.parametrize(
    "wrong", [INVALID, IMPOSSIBLE, LATE], ids=["invalid", "impossible", "late"]
)
def test_utc_that_is_not_valid_is_not_published(wrong: bytes) -> None:
    found = written(mtdata2(wrong, *INERTIAL) + mtdata2(VALID, *INERTIAL))
    [reference] = [message for message in found if message.topic == "/imu/utctime"]
    assert values(reference.content.time_ref) == [STAMP // 10**9, 250_000_000]


def test_several_coordinate_systems() -> None:
    data = mtdata2(NED) + mtdata2(real(0x2013, 1, 0, 0, 0))
    found = [message for message in written(data) if message.topic == "/filter/quaternion"]
    assert [values(message.content)[0] for message in found] == pytest.approx([1.4 * ROOT, 0])
    with pytest.raises(ValueError, match="one system, not ENU and NED; choose quantities of one"):
        written(data, keep_coordinates=True)
    kept = [
        message for message in written(data, ros_style="driver") if "quaternion" in message.topic
    ]
    assert [values(message.content)[3] for message in kept] == pytest.approx([0.8, 1])


# The receiver


def pvt(fixtype: int = 3, flags: int = 0x83, **fields: int) -> bytes:
    """A PVT of the receiver."""
    row = {"year": 2024, "month": 2, "day": 29, "hour": 12, "min": 34, "sec": 56, "valid": 7}
    row |= {"fixtype": fixtype, "flags": flags, "numSV": 14, "lat": 522_123_456, "lon": -68_934_567}
    row |= {"height": 47_500, "hMSL": 4_250, "hAcc": 14, "vAcc": 14, "hdop": 80} | fields
    names = [field.name for field in QUANTITIES["gnss_pvt_data"].fields]
    return encode_packet("gnss_pvt_data", [row.get(name, 0) for name in names])


#: Fix type, flags and accuracy; status and type of covariance in the style of the REPs and in the driver's.
FIXES = [
    (0, 0x00, 14, (-1, 0), (-1, 2)),
    (1, 0x01, 14, (-1, 0), (-1, 2)),  # dead reckoning alone
    (2, 0x01, 14, (0, 2), (0, 2)),
    (3, 0x01, 14, (0, 2), (0, 2)),
    (3, 0x00, 14, (-1, 0), (0, 2)),  # a fix that is not valid
    (3, 0x03, 14, (1, 2), (0, 2)),  # with corrections
    (3, 0x43, 14, (2, 2), (0, 2)),  # RTK, floating
    (4, 0x83, 14, (2, 2), (0, 2)),  # RTK, fixed
    (3, 0x01, 0xFFFFFFFF, (0, 0), (0, 2)),  # accuracy not known
    (5, 0x01, 14, (-1, 0), (-1, 2)),  # time alone
]


@pytest.mark.parametrize(("fixtype", "flags", "accuracy", "rep", "driver"), FIXES)
def test_fixes(
    fixtype: int, flags: int, accuracy: int, rep: tuple[int, int], driver: tuple[int, int]
) -> None:
    data = mtdata2(pvt(fixtype, flags, hAcc=accuracy, vAcc=accuracy))
    for style, (status, covariance_type) in {"rep": rep, "driver": driver}.items():
        fix = first(written(data, ros_style=style), "/gnss").content
        assert (fix.status.status, fix.position_covariance_type) == (status, covariance_type)
        has_position = style == "driver" or status >= 0
        assert math.isnan(fix.latitude) is not has_position
        if has_position:
            position = [fix.latitude, fix.longitude, fix.altitude]
            assert position == pytest.approx([52.2123456, -6.8934567, 47.5], abs=1e-12)
        variance = (accuracy * 1e-3) ** 2 if covariance_type else 0
        expected = np.diag([variance] * 3).reshape(-1)
        assert list(fix.position_covariance) == pytest.approx(expected.tolist(), rel=1e-12)


#: PVT and status word; time and quality of the sentence in the style of the REPs and in the driver's.
SENTENCES = [
    (pvt(flags=0x83), 2 << 27, ("123456.00", 4), ("123456.00", 4)),
    (pvt(flags=0x43), 1 << 27, ("123456.00", 5), ("123456.00", 5)),
    (pvt(flags=0x03), 4, ("123456.00", 2), ("123456.00", 1)),
    (pvt(1, 0x01), 4, ("123456.00", 0), ("123456.00", 6)),
    (pvt(flags=1, sec=0, nano=-4_000_000), 0, ("123400.00", 1), ("1234-0.00", 0)),
    (pvt(flags=1, sec=59, nano=996_000_000), 4, ("123500.00", 1), ("123460.00", 1)),
    (pvt(flags=1, valid=3), 4, ("", 1), ("123456.00", 1)),
    (pvt(0, 0, valid=0), 0, ("", 0), ("123456.00", 0)),
]
PLACE, HEIGHTS = "5212.74074,N,00653.60740,W", "14,0.8,4.25,M,43.25,M"


@pytest.mark.parametrize(("packets", "status", "rep", "driver"), SENTENCES, ids=range(8))
def test_sentences(
    packets: bytes, status: int, rep: tuple[str, int], driver: tuple[str, int]
) -> None:
    data = mtdata2(packets, packet(0xE020, status.to_bytes(4, "big")))
    time, quality = driver
    sentence = first(written(data, ros_style="driver"), "/nmea").content.sentence
    assert sentence.startswith(f"$GPGGA,{time},{PLACE},{quality},{HEIGHTS},0,0*")
    time, quality = rep
    sentence = first(written(data), "/nmea").content.sentence
    fix = f"{PLACE},{quality},{HEIGHTS},," if quality else ",,,,0,14,,,M,,M,,"
    assert sentence.startswith(f"$GPGGA,{time},{fix}*")
    parsed = NMEAReader.parse(sentence)  # raises for a wrong checksum
    assert (parsed.numSV, parsed.quality) == (14, quality)


def test_the_driver_needs_a_status_for_a_sentence() -> None:
    topics = {message.topic for message in written(mtdata2(pvt()), ros_style="driver")}
    assert topics == {"/gnss"}
