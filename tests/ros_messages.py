"""Reads ROS 2 messages with software of other people: `mcap` finds them, `rosbags` decodes them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from xbus.export.ros.definitions import DEFINITIONS, HASHES

__all__ = ["Message", "approximately", "first", "messages", "store", "values"]


class Message(NamedTuple):
    """A message: its topic, its type, the time by which it is ordered, and its bytes."""

    topic: str
    type: str
    time: int
    data: bytes

    @property
    def content(self) -> Any:
        """The message as rosbags decodes it."""
        return store().deserialize_cdr(self.data, self.type)

    @property
    def stamp(self) -> int:
        """The time stamp of the header in ns."""
        stamp = self.content.header.stamp
        return int(stamp.sec) * 10**9 + int(stamp.nanosec)

    @property
    def frame(self) -> str:
        """The frame id of the header."""
        frame: str = self.content.header.frame_id
        return frame


@cache
def store(version: Stores = Stores.ROS2_HUMBLE) -> Typestore:
    """The types of a version of ROS, and those that it does not have."""
    found = get_typestore(version)
    for name in HASHES:
        ros = name.replace("/", "/msg/")
        if ros not in found.types:
            found.register(get_types_from_msg(DEFINITIONS[name], ros))
    return found


def messages(path: Path | str) -> list[Message]:
    """Returns the messages of a file, in their order."""
    return list(_messages(Path(path)))


def _messages(path: Path) -> Iterator[Message]:
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            yield Message(channel.topic, schema.name, message.log_time, message.data)


def approximately(expected: list[Any]) -> list[Any]:
    """Returns what values equal that differ from these by at most 1e-12."""
    return [
        pytest.approx(value, rel=1e-12, abs=1e-12) if isinstance(value, float) else value
        for value in expected
    ]


def first(found: list[Message], topic: str) -> Message:
    """Returns the first message of a topic."""
    return next(message for message in found if message.topic == topic)


def values(content: Any) -> list[Any]:
    """Returns all numbers and texts of a message but its header, in their order."""
    if isinstance(content, np.ndarray | list):
        return [number for value in content for number in values(value)]
    if not hasattr(content, "__dataclass_fields__"):
        return [content]
    names = [name for name in content.__dataclass_fields__ if name not in ("header", "__msgtype__")]
    return [number for name in names for number in values(getattr(content, name))]
