"""MCAP files and folders of rosbag2 as a user makes them, opened by software of other people."""

from __future__ import annotations

import errno
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

import streams
import xbus
from conftest import counter
from ros_messages import messages
from streams import mtdata2, real
from test_cli import WALK, run

#: Messages of WALK, and topics that have one for every inertial sample.
MESSAGES = 14_270
EACH = ("/imu/data", "/imu/mag", "/filter/velocity", "/tf")


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_a_file(compression: str) -> None:
    result = run("decode", WALK, "-o", "walk.mcap", "--compression", compression)
    assert result.exit_code == 0, result.stderr
    assert f"{MESSAGES:,} messages, 18 topics" in result.stderr
    with Path("walk.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == MESSAGES
        used = {chunk.compression for chunk in summary.chunk_indexes}
        assert used == {"" if compression == "none" else compression}
        assert all(chunk.message_index_offsets for chunk in summary.chunk_indexes)
    times = [message.time for message in messages("walk.mcap")]
    assert times == sorted(times)
    assert len(times) == MESSAGES


@pytest.mark.parametrize("version", [Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY])
def test_rosbags_reads_a_folder_and_a_file(version: Stores) -> None:
    result = run("decode", WALK, "-o", "walk", "--rosbag2")
    assert result.exit_code == 0, result.stderr
    assert sorted(path.name for path in Path("walk").iterdir()) == ["metadata.yaml", "walk_0.mcap"]
    with Reader("walk") as bag:
        assert (bag.message_count, bag.ros_distro) == (MESSAGES, None)
        first, last = bag.start_time, bag.end_time
    log = xbus.read_log(WALK)
    for path in ("walk", "walk/walk_0.mcap"):
        with AnyReader([Path(path)], default_typestore=get_typestore(version)) as reader:
            assert (reader.message_count, reader.start_time) == (MESSAGES, first)
            assert reader.end_time == last
            found = {connection.topic: 0 for connection in reader.connections}
            accelerations = []
            for connection, _, data in reader.messages():
                found[connection.topic] += 1
                if connection.topic == "/imu/data" or found[connection.topic] == 1:
                    message: Any = reader.deserialize(data, connection.msgtype)
                if connection.topic == "/imu/data":
                    acceleration = message.linear_acceleration
                    accelerations.append([acceleration.x, acceleration.y, acceleration.z])
            assert sum(found.values()) == MESSAGES
            assert [found[topic] for topic in EACH] == [len(log["acceleration"])] * len(EACH)
            # To the bit: float64 holds every float32.
            assert accelerations == log["acceleration"].values.tolist()


def test_the_folder_has_the_file_of_to_mcap() -> None:
    log = xbus.read_log(WALK)
    log.to_rosbag2("bag", ros_style="driver", topic_prefix="imu1", compression="lz4")
    log.to_mcap("one.mcap", ros_style="driver", topic_prefix="/imu1/", compression="lz4")
    assert Path("bag/bag_0.mcap").read_bytes() == Path("one.mcap").read_bytes()
    topics = {message.topic for message in messages("one.mcap")}
    assert {topic for topic in topics if not topic.startswith("/imu1/")} == {"/tf"}


def test_rerun_reads_every_topic() -> None:
    pytest.importorskip("rerun")
    xbus.read_log(WALK, between=(0, 0.5)).to_mcap("walk.mcap")
    command = [sys.executable, "-m", "rerun"]
    convert = [*command, "mcap", "convert", "walk.mcap", "-o", "walk.rrd"]
    subprocess.run(convert, check=True, capture_output=True)  # noqa: S603
    show = [*command, "rrd", "print", "walk.rrd"]
    shown = subprocess.run(show, check=True, capture_output=True, text=True).stdout  # noqa: S603
    topics = {message.topic for message in messages("walk.mcap")}
    assert len(topics) == 18
    assert topics <= set(re.findall(r"/[a-z_]+(?:/[a-z_]+)?", shown))


def test_each_of_several_devices_has_topics_and_frames() -> None:
    data = b"".join(
        mtdata2(counter(i), real(0x2010, 1, 0, 0, 0), bid=bid)
        for i in range(3)
        for bid in (0xFF, 2, 3)
    )
    Path("log.mtb").write_bytes(data)
    assert (
        run("decode", "log.mtb", "-o", "out", "--rosbag2", "--topic-prefix", "/car").exit_code == 0
    )
    found = messages("out/out_0.mcap")
    assert [message.topic for message in found if message.topic.endswith("/data")] == [
        "/car/imu/data",
        "/car/device_2/imu/data",
        "/car/device_3/imu/data",
    ] * 3
    frames = {message.topic: message.frame for message in found if message.topic.endswith("/data")}
    assert list(frames.values()) == ["imu_link", "imu_link_2", "imu_link_3"]
    children = [m.content.transforms[0].child_frame_id for m in found if m.topic == "/tf"]
    assert children == ["imu_link", "imu_link_2", "imu_link_3"] * 3
    with Reader("out") as bag:
        assert bag.topics["/tf"].msgcount == 9
    # One of them alone keeps its names.
    assert run("decode", "log.mtb", "-o", "one.mcap", "--bid", "3").exit_code == 0
    assert messages("one.mcap")[0].topic == "/device_3/imu/data"


def test_chosen_quantities_keep_the_times_of_all() -> None:
    assert run("decode", WALK, "-o", "a.mcap", "--quantity", "acceleration").exit_code == 0
    found = messages("a.mcap")
    assert {message.topic for message in found} == {"/imu/acceleration", "/imu/data"}
    whole = xbus.read_log(WALK)
    whole.to_mcap("b.mcap")
    assert [m[1:] for m in found if m.topic == "/imu/acceleration"] == [
        m[1:] for m in messages("b.mcap") if m.topic == "/imu/acceleration"
    ]


def test_many_recordings() -> None:
    for name in ("a", "b"):
        Path(f"{name}.mtb").write_bytes(streams.ahrs(3))
    result = run("decode", "a.mtb", "b.mtb", "--out-dir", "bags", "--rosbag2")
    assert result.exit_code == 0, result.stderr
    for name in ("a", "b"):
        with Reader(f"bags/{name}") as bag:
            assert bag.message_count > 0


#: Wrong calls, and a part of the message.
WRONG = {
    "for another format": (
        ["-o", "a.csv", "--ros-style", "rep"],
        "--ros-style applies to .mcap, not to .csv",
    ),
    "a folder of another format": (
        ["--out-dir", "a", "--rosbag2", "--suffix", ".csv"],
        "--rosbag2 applies to .mcap, not to .csv",
    ),
    "conversion in the driver's style": (
        ["-o", "a.mcap", "--ros-style", "driver", "--mag-norm", "49e-6"],
        "the driver style converts nothing; --keep-coordinates and --mag-norm apply to the style rep",
    ),
    "a prefix": (
        ["-o", "a.mcap", "--topic-prefix", "/imu 1"],
        "--topic-prefix '/imu 1' is no name of ROS",
    ),
    "a frame id": (["-o", "a.mcap", "--frame-id", ""], "--frame-id '' is no name of ROS"),
    "a field in microtesla": (
        ["-o", "a.mcap", "--mag-norm", "49"],
        "--mag-norm is in tesla, such as 49e-6, not 49.0",
    ),
    "resampling": (
        ["-o", "a", "--rosbag2", "--rate-out", "10"],
        "--rate-out applies to tables and .npz, not to .mcap",
    ),
    "strings": (
        ["-o", "a.mcap", "--quantity", "HEHDT"],
        "strings are written to tables and .npz, not to .mcap",
    ),
    "no name": (["-o", "", "--rosbag2"], "OUT is empty"),
    "no suffix": (["-o", "a"], "must end in one of"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_calls(name: str) -> None:
    arguments, message = WRONG[name]
    result = run("decode", WALK, *arguments)
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.split())
    assert list(Path().iterdir()) == []


def test_a_log_without_messages() -> None:
    Path("log.mtb").write_bytes(mtdata2(counter(1)))
    result = run("decode", "log.mtb", "-o", "a.mcap")
    assert result.exit_code == 1
    assert result.stderr == (
        "xbus: log.mtb: no quantity of the log is one that the ROS messages of the driver have\n"
    )
    assert not Path("a.mcap").exists()


def test_something_exists_where_the_folder_should_be() -> None:
    Path("bag").mkdir()
    (Path("bag") / "precious").touch()
    result = run("decode", WALK, "-o", "bag", "--rosbag2")
    assert result.exit_code == 1
    assert result.stderr.startswith("xbus: cannot write bag: File exists")
    with pytest.raises(FileExistsError):
        xbus.read_log(WALK).to_rosbag2("bag")
    assert [path.name for path in Path("bag").iterdir()] == ["precious"]


def test_a_failure_leaves_no_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> str:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("xbus.export.ros.mcap.metadata_text", full)
    result = run("decode", WALK, "-o", "bag", "--rosbag2")
    assert result.exit_code == 1
    assert "No space left on device" in result.stderr
    assert list(Path().iterdir()) == []
