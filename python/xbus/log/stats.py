"""Counts of what was read."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Stats"]


@dataclass(frozen=True)
class Stats:
    """Counts of what was read.

    Attributes:
        bytes: Bytes of input.
        frames: Accepted frames.
        samples: MTData2 messages, and MTData messages of older devices. One of an Xbus Master has a sample of
            each tracker.
        messages: Other messages, malformed ones included.
        malformed: MTData2 messages whose packets do not fill them, and empty ones.
        unfit: MTData messages whose length does not fit the settings in force, or whose settings are not
            known: see ``legacy`` of `read_log`. They are in `Log.messages`.
        strings: String outputs.
        skipped_bytes: Bytes that belong to neither frame nor string.
        checksum_errors: Wrong checksums where a frame was expected.
        lost_samples: Samples that the packet counter skips.
        gaps: Places where samples are missing.

    >>> import xbus
    >>> stats = xbus.read_log("tests/captures/field.mtb").stats
    >>> stats.samples, stats.lost_samples, stats.gaps, stats.skipped_bytes
    (1016, 23, 12, 1816)
    """

    bytes: int
    frames: int
    samples: int
    messages: int
    malformed: int
    unfit: int
    strings: int
    skipped_bytes: int
    checksum_errors: int
    lost_samples: int
    gaps: int
