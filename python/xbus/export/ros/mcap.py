"""MCAP files of ROS 2, alone or in a folder of rosbag2."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import BinaryIO, Literal

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.export.format import ExportError, Format, Survey, Writer
from xbus.export.part import Part
from xbus.export.replacing import new_folder, replacing
from xbus.export.ros.cdr import DOUBLES, Layout
from xbus.export.ros.definitions import HASHES, TF_DEPTH, TOPIC_DEPTH, definition_of, qos
from xbus.export.ros.measured import ENU, ORIENTED, Measured, columns_of, system_of
from xbus.export.ros.rosbag2 import Written, WrittenTopic, metadata_text
from xbus.export.ros.stamps import TIME_QUANTITIES, TimeBase
from xbus.export.ros.topics import TOPICS, Frames, Style, Topic
from xbus.export.valid import STATUS
from xbus.protocol.keys import EntryKey
from xbus.protocol.tables import device_of

__all__ = ["Mcap", "McapWriter", "topics_of"]

#: A name of a topic without the slashes, and a frame id.
NAME = r"[A-Za-z_][A-Za-z0-9_]*"
PREFIX = re.compile(rf"(/?{NAME}(/{NAME})*/?)?")
FRAME = re.compile(rf"{NAME}(/{NAME})*")
#: Samples whose messages are in memory at a time.
BATCH = 1 << 14
#: What the core takes as the messages of a topic.
MessageRows = tuple[
    int,
    npt.NDArray[np.int64],
    bytes,
    int | None,
    npt.NDArray[np.uint8],
    npt.NDArray[np.uint64] | None,
]
#: The BID of a stand-alone device, whose topics have no prefix.
ALONE = 1
TF = "/tf"


@dataclass(frozen=True)
class Mcap(Format):
    """Messages of ROS 2 in an MCAP file, or in a folder of rosbag2.

    Attributes:
        ros_style: ``"rep"`` for messages that follow REP-103, 105 and 145, or ``"driver"`` for those that the
            vendor's ROS 2 driver publishes.
        frame_id: Frame id of the sensor.
        topic_prefix: What the names of topics begin with.
        keep_coordinates: Keep NED and NWU, instead of converting them to ENU.
        mag_norm: Tesla of one unit of the magnetic field, or None to keep the unit of the sensor.
        compression: How chunks are compressed.
        rosbag2: Write a folder with the file and its ``metadata.yaml``.
        times: The times of the log, which the first pass finds.
    """

    ros_style: Literal["rep", "driver"] = "rep"
    frame_id: str = "imu_link"
    topic_prefix: str = ""
    keep_coordinates: bool = False
    mag_norm: float | None = None
    compression: Literal["zstd", "lz4", "none"] = "zstd"
    rosbag2: bool = False
    times: TimeBase | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        if self._is_driver and (self.keep_coordinates or self.mag_norm is not None):
            raise ValueError(
                "the driver style converts nothing; keep_coordinates and mag_norm apply to the style rep"
            )
        if self.ros_style not in {"rep", "driver"}:
            raise ValueError(f"ros_style is 'rep' or 'driver', not {self.ros_style!r}")
        if not PREFIX.fullmatch(self.topic_prefix):
            raise ValueError(
                f"topic_prefix {self.topic_prefix!r} is no name of ROS; use letters, digits, _ and /"
            )
        if not FRAME.fullmatch(self.frame_id):
            raise ValueError(
                f"frame_id {self.frame_id!r} is no name of ROS; use letters, digits, _ and /"
            )
        if self.mag_norm is not None and not 0 < self.mag_norm < 1:
            raise ValueError(f"mag_norm is in tesla, such as 49e-6, not {self.mag_norm}")

    @property
    def _is_driver(self) -> bool:
        return self.ros_style == "driver"

    @property
    def style(self) -> Style:
        """How measurements become messages."""
        return Style(self._is_driver, self.mag_norm)

    @property
    def converts(self) -> bool:
        """Whether coordinates are converted to ENU."""
        return not (self._is_driver or self.keep_coordinates)

    def quantities(self, shape: Part) -> Sequence[EntryKey]:
        """See `Format.quantities`."""
        topics = topics_of(shape)
        if self.keep_coordinates and len(systems := _systems(shape, *ORIENTED)) > 1:
            raise ExportError(
                f"coordinates can be kept if the log has one system, not {' and '.join(sorted(systems))}; "
                "choose quantities of one, or convert all to ENU"
            )
        names = {name for topic in topics for group in topic.needs for name in group}
        names.add("sample_time_coarse")
        keys: list[EntryKey] = [
            key for key in shape if (key if isinstance(key, str) else key[0]) in names
        ]
        # Times, and which positions have a fix, do not depend on what is chosen.
        return [*keys, *(name for name in (*TIME_QUANTITIES, *STATUS) if name not in keys)]

    def survey(self, shape: Part) -> Survey:  # noqa: ARG002 - as in the base class
        """See `Format.survey`."""
        return _Survey(self)

    @contextmanager
    def open(self, path: str | os.PathLike[str], shape: Part) -> Iterator[Writer]:
        """See `Format.open`."""
        if not self.rosbag2:
            with replacing(path) as out:
                writer = McapWriter(self, out, shape)
                yield writer
                writer.close()
            return
        with new_folder(path) as (folder, name):
            file = f"{name}_0.mcap"
            with (folder / file).open("xb") as out:
                writer = McapWriter(self, out, shape)
                yield writer
                writer.close()
            text = metadata_text(file, writer.written)
            (folder / "metadata.yaml").write_text(text, encoding="utf-8")


class _Survey:
    """Finds the times of a log."""

    quantities: Sequence[EntryKey] = TIME_QUANTITIES

    def __init__(self, file_format: Mcap) -> None:
        self._format, self._times = file_format, TimeBase()

    def add(self, part: Part) -> None:
        self._times.add(part)

    @property
    def format(self) -> Mcap:
        return replace(self._format, times=self._times)


def topics_of(shape: Part) -> list[Topic]:
    """Returns the topics of which a log with these columns can have messages.

    Raises:
        ExportError: There are none.
    """
    if found := [topic for topic in TOPICS if topic.is_in(shape)]:
        return found
    raise ExportError("no quantity of the log is one that the ROS messages of the driver have")


def _systems(shape: Part, *names: str) -> set[str]:
    """Returns the coordinate systems of quantities."""
    return {system_of(column) for name in names for column in columns_of(shape, name)}


def _suffix(systems: set[str]) -> str:
    """Returns what frame ids end with: nothing for ENU, and ``_ned`` for NED (REP-145)."""
    others = systems - {ENU}
    return f"_{min(others).lower()}" if others else ""


class McapWriter:
    """Writes the messages of parts to a file.

    Args:
        file_format: The format, with the times of the log.
        out: The file.
        shape: As in `Format.open`.
    """

    def __init__(self, file_format: Mcap, out: BinaryIO, shape: Part) -> None:
        assert file_format.times is not None  # noqa: S101 - the first pass has found them
        self._format, self._out = file_format, out
        self._topics = topics_of(shape)
        self._times = file_format.times.second_pass()
        keeps = file_format.keep_coordinates
        self._suffix = _suffix(_systems(shape, *ORIENTED)) if keeps else ""
        self._free_suffix = _suffix(_systems(shape, "free_acceleration")) if keeps else ""
        self._file = _core.MessageFile(file_format.compression, [("xbus", self._about())])
        #: The number of each topic in the file and the layout of its messages, by device.
        self._devices: dict[int, list[tuple[int, Layout]]] = {}
        self._names: list[tuple[str, Topic]] = []
        self._first: int | None = None
        self._last = 0

    def _about(self) -> dict[str, str]:
        """Returns what a reader has to know and messages do not say."""
        file_format = self._format
        norm = file_format.mag_norm
        return {
            "ros_style": file_format.ros_style,
            "time_base": self._times.base,
            "coordinates": ENU if file_format.converts else "as recorded",
            "magnetic_field": "normalised: 1 is the norm at calibration"
            if norm is None
            else f"tesla: {norm} of 1",
        }

    @property
    def counts(self) -> dict[str, int]:
        """See `Writer.counts`."""
        topics = self.written.topics
        return {"message": sum(topic.messages for topic in topics), "topic": len(topics)}

    @property
    def written(self) -> Written:
        """What the file contains."""
        topics: dict[str, WrittenTopic] = {}
        for (name, topic), count in zip(self._names, self._file.counts, strict=True):
            before = topics[name].messages if name in topics else 0
            topics[name] = WrittenTopic(name, ros_name(topic), qos_of(topic), before + count)
        found = [topic for topic in topics.values() if topic.messages]
        return Written(found, self._first or 0, self._last)

    def write(self, part: Part) -> None:
        """See `Writer.write`."""
        stamps = self._times.stamps(part)
        devices = device_of(part.bid)
        for first in range(0, len(part), BATCH):
            samples = range(first, min(first + BATCH, len(part)))
            batch = slice(samples.start, samples.stop)
            measured, ordered = stamps.measured[batch], stamps.ordered[batch]
            rows = list(self._rows(part, samples, devices[batch]))
            data = self._file.write(first, measured, ordered, rows)
            self._out.write(data.data)
            for row in rows:
                begin, end = ordered[row[1][[0, -1]] - first].tolist()
                self._first = begin if self._first is None else min(self._first, begin)
                self._last = max(self._last, end)

    def _rows(
        self, part: Part, samples: range, devices: npt.NDArray[np.uint8]
    ) -> Iterator[MessageRows]:
        """Yields the messages of each topic of each device."""
        file_format = self._format
        found = np.unique(devices).tolist()
        for device in found:
            measured = Measured(
                part,
                converts=file_format.converts,
                is_driver=file_format.style.is_driver,
                samples=samples,
                only=devices == device if len(found) > 1 else None,
            )
            for topic, (number, layout) in zip(self._topics, self._of_device(device), strict=True):
                # A device may send infinite numbers and NaN: so do the messages.
                with np.errstate(invalid="ignore", over="ignore"):
                    sample, values, ends = topic.bodies(measured, file_format.style, layout)
                if not len(sample):
                    continue
                if values.dtype == DOUBLES:
                    # Which bits a computed NaN has depends on its place in an array.
                    values[np.isnan(values)] = np.nan
                yield number, sample, *layout.head, values.reshape(-1).view(np.uint8), ends

    def _of_device(self, device: int) -> list[tuple[int, Layout]]:
        if device not in self._devices:
            frames = self._frames(device)
            self._devices[device] = [
                (self._declare(device, topic), topic.layout(frames)) for topic in self._topics
            ]
        return self._devices[device]

    def _frames(self, device: int) -> Frames:
        number = "" if device == ALONE else f"_{device}"
        sensor, world = f"{self._format.frame_id}{number}{self._suffix}", f"world{self._suffix}"
        if self._format.style.is_driver:
            return Frames(sensor, world, sensor, sensor, sensor, sensor)
        free = f"world{self._free_suffix}"
        return Frames(sensor, world, world, free, "earth", f"gnss_link{number}")

    def _declare(self, device: int, topic: Topic) -> int:
        prefix = self._format.topic_prefix.strip("/")
        parts = [prefix] if prefix else []
        parts += [] if device == ALONE else [f"device_{device}"]
        # All transforms are on one topic: readers look for them there.
        name = TF if topic.name == TF else "/".join(["", *parts]) + topic.name
        self._names.append((name, topic))
        return self._file.declare(
            name,
            ros_name(topic),
            definition_of(topic.type),
            {
                "offered_qos_profiles": qos_of(topic),
                "topic_type_hash": f"RIHS01_{HASHES[topic.type]}",
            },
        )

    def close(self) -> None:
        """Writes the end of the file."""
        if not sum(self._file.counts):
            raise ExportError("no sample of the log has a value that a ROS message can hold")
        self._out.write(self._file.finish().data)


def ros_name(topic: Topic) -> str:
    """Returns the type of a topic as ROS 2 writes it: ``sensor_msgs/msg/Imu``."""
    return topic.type.replace("/", "/msg/")


def qos_of(topic: Topic) -> str:
    """Returns the quality of service of a topic."""
    return qos(TF_DEPTH if topic.name == TF else TOPIC_DEPTH)
