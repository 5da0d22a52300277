"""What is counted while a log is read."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Stats"]


@dataclass(frozen=True)
class Stats:
    """What was counted while reading.

    Attributes:
        bytes: Bytes of input.
        frames: Accepted frames.
        samples: MTData2 messages.
        messages: Other messages, malformed ones included.
        malformed: MTData2 messages that their packets do not tile, and empty ones.
        strings: String outputs.
        skipped_bytes: Bytes that belong to neither frame nor string.
        checksum_errors: Candidates refused by their checksum where a frame was due.
        lost_samples: Samples missing by the packet counter.
        gaps: Places where samples are missing.
    """

    bytes: int
    frames: int
    samples: int
    messages: int
    malformed: int
    strings: int
    skipped_bytes: int
    checksum_errors: int
    lost_samples: int
    gaps: int
