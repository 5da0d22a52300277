"""The ``metadata.yaml`` of rosbag2."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import NamedTuple

__all__ = ["Written", "WrittenTopic", "metadata_text"]

#: The version that Humble writes. Later versions of ROS read it too.
VERSION = 5


class WrittenTopic(NamedTuple):
    """A topic: its name, type, quality of service and number of messages."""

    name: str
    type: str
    qos: str
    messages: int


class Written(NamedTuple):
    """What a file contains.

    Attributes:
        topics: The topics that have messages.
        first: Time of the first message, in ns since 1970.
        last: Time of the last one.
    """

    topics: Sequence[WrittenTopic]
    first: int
    last: int


def metadata_text(file: str, written: Written) -> str:
    """Returns the text of ``metadata.yaml`` for a folder with one MCAP file.

    Args:
        file: The name of the file.
        written: What the file contains.
    """
    duration, count = written.last - written.first, sum(topic.messages for topic in written.topics)
    topics = "\n".join(map(_topic, written.topics))
    # JSON strings are strings of YAML.
    name = json.dumps(file)
    return f"""rosbag2_bagfile_information:
  version: {VERSION}
  storage_identifier: mcap
  duration:
    nanoseconds: {duration}
  starting_time:
    nanoseconds_since_epoch: {written.first}
  message_count: {count}
  topics_with_message_count:
{topics}
  compression_format: ""
  compression_mode: ""
  relative_file_paths:
    - {name}
  files:
    - path: {name}
      starting_time:
        nanoseconds_since_epoch: {written.first}
      duration:
        nanoseconds: {duration}
      message_count: {count}
"""


def _topic(topic: WrittenTopic) -> str:
    return f"""    - topic_metadata:
        name: {json.dumps(topic.name)}
        type: {topic.type}
        serialization_format: cdr
        offered_qos_profiles: {json.dumps(topic.qos)}
      message_count: {topic.messages}"""
