"""Recordings: every byte that comes, in files laid out as MT Manager's are."""

from __future__ import annotations

import time
from types import TracebackType

from xbus import _core
from xbus.protocol.ids import MessageId
from xbus.wire.codec import encode_frame

__all__ = ["Recording", "configuration_frame"]

#: Where the Configuration message has the date and the time of the host (Tables 13 and 14).
_DATE_AND_TIME = slice(16, 32)


def configuration_frame(payload: bytes) -> bytes:
    """Configuration for the head of a file: with date and local time, as the vendor's software has it."""
    now = time.time()
    stamp = time.strftime("%Y%m%d%H%M%S", time.localtime(now)) + f"{int(now % 1 * 100):02}"
    filled = bytearray(payload)
    filled[_DATE_AND_TIME] = stamp.encode("ascii")
    return encode_frame(MessageId.Configuration, bytes(filled))


class Recording:
    """A recording that `Device.record` has begun; a context manager that stops it.

    It goes on by itself, whatever the program does meanwhile, until it is stopped, the device is closed, or
    `error` says why not.
    """

    def __init__(self, acquisition: _core.Acquisition) -> None:
        self._acquisition = acquisition
        self._ended: dict[str, object] | None = None

    def _facts(self) -> dict[str, object]:
        if self._ended is not None:
            return self._ended
        return self._acquisition.recording or {}

    @property
    def files(self) -> list[str]:
        """The files, the one that is being written last."""
        files = self._facts().get("files", [])
        assert isinstance(files, list)  # noqa: S101 - see `_core.Acquisition.recording`
        return files

    @property
    def bytes(self) -> int:
        """Bytes received that are in the files."""
        return int(str(self._facts().get("bytes", 0)))

    @property
    def frames(self) -> int:
        """Frames received that are in the files."""
        return int(str(self._facts().get("frames", 0)))

    @property
    def queued_bytes(self) -> int:
        """Bytes received that wait for the disk."""
        return int(str(self._facts().get("queued_bytes", 0)))

    @property
    def error(self) -> str | None:
        """Why it ended by itself, or None. The files are good to their end in any case."""
        error = self._facts().get("error")
        return None if error is None else str(error)

    @property
    def is_active(self) -> bool:
        """Whether it goes on."""
        return bool(self._facts().get("active", False)) and self._ended is None

    def stop(self) -> None:
        """Writes what has come, and closes the file.

        Raises:
            OSError: It had ended by itself: a full disk, for example.
        """
        if self._ended is None:
            self._ended = self._acquisition.stop_recording() or {}
            if self.error is not None:
                raise OSError(f"the recording ended too early: {self.error}")

    def __enter__(self) -> Recording:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.stop()

    def __repr__(self) -> str:
        return f"<Recording {', '.join(self.files)}: {self.bytes:,} bytes>"
