"""Recordings: every received byte, in files with the layout of MT Manager's."""

from __future__ import annotations

import contextlib
import time

from xbus import _core
from xbus.can.recorder import CanRecorder
from xbus.device.channel import Channel
from xbus.device.commands import Commands
from xbus.device.string_output import UNFRAMED_STRINGS
from xbus.errors import DeviceError, StateError, XbusTimeout
from xbus.protocol.ids import MessageId
from xbus.wire.codec import encode_frame

__all__ = ["Recording", "heard_head", "recording_head"]

#: Bytes of the Configuration message with the date and time of the host (Tables 13 and 14).
_DATE_AND_TIME = slice(16, 32)


def recording_head(channel: Channel) -> bytes:
    """Returns the frames that start a file, read from a device in Config State.

    Args:
        channel: The channel. Configuration is required; not every device has the other messages, and a file
            is readable without them.
    """
    head = _configuration_frame(channel.command("ReqConfiguration", None).payload)
    with contextlib.suppress(DeviceError, StateError, XbusTimeout):
        strings = channel.command("ReqStringOutputType", None)
        # A reader of the file parses these strings only if this message enables them.
        if strings.value.types & UNFRAMED_STRINGS:
            head += encode_frame(MessageId.ReqStringOutputTypeAck, strings.payload)
    with contextlib.suppress(DeviceError, StateError, XbusTimeout):
        head += encode_frame(MessageId.EmtsData, Commands(channel).req_emts())
    return head


def heard_head(channel: Channel) -> bytes:
    """Returns the frames that start a file, of those that the device has sent by itself.

    Args:
        channel: The channel of a port that was opened only to listen.
    """
    channel.handle_events()
    heard = dict(channel.heard)
    head = heard.pop(MessageId.Configuration, b"")
    return head + b"".join(heard.values())


def _configuration_frame(payload: bytes) -> bytes:
    """Returns a Configuration message with date and local time, as the vendor's software writes it."""
    now = time.time()
    stamp = time.strftime("%Y%m%d%H%M%S", time.localtime(now)) + f"{int(now % 1 * 100):02}"
    filled = bytearray(payload)
    filled[_DATE_AND_TIME] = stamp.encode("ascii")
    return encode_frame(MessageId.Configuration, bytes(filled))


class Recording:
    """A recording started by `Device.record`; a context manager that stops it.

    It runs until it is stopped, the device is closed, or an `error` ends it.
    """

    def __init__(self, recorder: _core.Recorder | CanRecorder) -> None:
        self._recorder = recorder
        self._is_stopped = False

    @property
    def files(self) -> list[str]:
        """Paths of the files; the last one is being written."""
        return [str(path) for path in self._recorder.state["files"]]

    @property
    def bytes(self) -> int:
        """Received bytes in the files."""
        return int(self._recorder.state["bytes"])

    @property
    def frames(self) -> int:
        """Received frames in the files."""
        return int(self._recorder.state["frames"])

    @property
    def samples(self) -> int:
        """Received samples in the files."""
        return int(self._recorder.state["samples"])

    @property
    def strings(self) -> int:
        """Received strings in the files."""
        return int(self._recorder.state["strings"])

    @property
    def message_counts(self) -> dict[int, int]:
        """Number of received messages in the files that are not samples, by message identifier."""
        return dict(self._recorder.state["message_counts"])

    @property
    def queued_bytes(self) -> int:
        """Received bytes that are not written yet."""
        return int(self._recorder.state["queued_bytes"])

    @property
    def error(self) -> str | None:
        """Why the recording ended early, or None. The files are valid up to their end in any case."""
        error = self._recorder.state["error"]
        return None if error is None else str(error)

    @property
    def is_active(self) -> bool:
        """Whether the recording is running."""
        return bool(self._recorder.state["active"])

    def stop(self) -> None:
        """Writes the remaining bytes, and closes the file.

        Raises:
            OSError: The recording ended early, for example because the disk was full.
        """
        if not self._is_stopped:
            self._is_stopped = True
            self._recorder.stop()
            if self.error is not None:
                raise OSError(f"the recording ended early: {self.error}")

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def __repr__(self) -> str:
        return f"<Recording {', '.join(self.files)}: {self.bytes:,} bytes>"
