"""A recording in progress: what it receives, when it must end, and its summary."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from xbus.cli.failure import Failure
from xbus.cli.inputs import label
from xbus.formatting import describe_losses, format_count, format_size
from xbus.protocol.undecoded import output_mids, output_name, undecoded_output
from xbus.wire.link import line_rate

if TYPE_CHECKING:
    from xbus.device import Device
    from xbus.device.recording import Recording
    from xbus.device.stats import LiveStats
    from xbus.watch.corrections import Corrections

__all__ = ["RecordingJob", "Report"]

#: Silence to report, in seconds; the lowest rate is 1 Hz.
MAX_SILENCE = 5.0

#: Reports an event of a recording: a text, and whether it is a problem.
Report = Callable[[str, bool], None]


class RecordingJob:
    """A recording of a device, for as long as a command runs.

    Args:
        device: The device.
        recording: Its recording, which has started.
        before: The counts at its start.
        duration: Seconds after which it is over; None for no limit.
        reconnect: Whether it continues when a lost port is back.
        is_listening: Whether the port was opened only to listen, so that silence is no error.
        corrections: The corrections that are forwarded meanwhile, or None.
    """

    def __init__(
        self,
        device: Device,
        recording: Recording,
        before: LiveStats,
        *,
        duration: float | None,
        reconnect: bool,
        is_listening: bool,
        corrections: Corrections | None,
    ) -> None:
        self.device, self.recording, self.before = device, recording, before
        self.reconnect, self.corrections = reconnect, corrections
        self._duration = duration or math.inf
        self._is_listening = is_listening
        self._began = device.link.clock()
        self._at_last_bytes = self._at_last_output = (self._began, before)
        self._is_silent = self._has_no_output = False

    @property
    def elapsed(self) -> float:
        """Seconds since the start, on the clock of the link."""
        return self.device.link.clock() - self._began

    @property
    def left(self) -> float:
        """Seconds until the recording is over."""
        return self._duration - self.elapsed

    @property
    def is_over(self) -> bool:
        """Whether the duration has passed."""
        return self.left <= 0

    @property
    def lost_port(self) -> str | None:
        """Why the port is gone; None if it is there."""
        reason = self.device.link.acquisition.ended
        return None if reason is None else f"{self.device.link.name}: {reason}"

    def check(self, report: Report) -> None:
        """Reports what is new, such as a pause of the device.

        Raises:
            Failure: The recording ended early, or the device sends nothing.
        """
        if self.recording.error is not None:
            raise self.failure(self.recording.error)
        if self.corrections is not None:
            for text, is_bad in self.corrections.news():
                report(text, is_bad)
        if self.lost_port is None:
            self._check_silence(report)
        else:
            self.resume()

    def resume(self) -> None:
        """Measures silence from now on, after the port was lost."""
        now, stats = self.device.link.clock(), self.device.stats
        self._at_last_bytes = self._at_last_output = (now, stats)
        self._is_silent = self._has_no_output = False

    def _check_silence(self, report: Report) -> None:
        link, stats = self.device.link, self.device.stats
        now = link.clock()
        since, last = self._at_last_bytes
        if stats.bytes > last.bytes:
            self._at_last_bytes, self._is_silent = (now, stats), False
        elif now - since >= MAX_SILENCE and not self._is_silent:
            self._is_silent = True
            if not (self._is_listening or self.received(stats)):
                raise Failure(
                    f"{link.name} sends nothing: it waits for a trigger, or has no outputs; xbus config dump"
                    f" {link.name} shows the output configuration"
                )
            report(f"no data for {MAX_SILENCE:g} s; the recording continues", True)
        since, last = self._at_last_output
        if _decoded(stats) > _decoded(last):
            self._at_last_output, self._has_no_output = (now, stats), False
        elif (
            now - since >= MAX_SILENCE
            and now - self._at_last_bytes[0] < MAX_SILENCE / 2  # not about to be reported as silent
            and not self._has_no_output
        ):
            self._has_no_output = True
            what = self._describe_arrivals(last, stats)
            report(f"no sample for {MAX_SILENCE:g} s, but {what}; the recording continues", True)

    def _describe_arrivals(self, before: LiveStats, stats: LiveStats) -> str:
        """Returns what has arrived, other than samples and strings, and how to change that."""
        counts = {
            mid: count - before.message_counts.get(mid, 0)
            for mid, count in stats.message_counts.items()
        }
        mids = [mid for mid, count in counts.items() if count]
        parts, advice = [], ""
        if outputs := output_mids(mids):
            for mid in outputs:
                what = undecoded_output(mid).removeprefix("message ")
                parts.append(f"{format_count(counts[mid], 'message')} {what}")
            if not self._is_listening:
                advice = "; --output or --config sets outputs that replace it"
        elif mids:
            parts.append(format_count(sum(counts.values()), "other message"))
        if skipped := stats.skipped_bytes - before.skipped_bytes:
            parts.append(f"{format_count(skipped, 'byte')} without a message")
            if not mids and (rate := line_rate(self.device.link)) is not None:
                advice = (
                    f"; {rate} baud is probably not the rate of the device: leave --baudrate out"
                )
        return ", ".join(parts or ["incomplete messages"]) + advice

    def received(self, stats: LiveStats) -> int:
        """Returns the number of samples, strings and other outputs since the start."""
        before = self.before
        undecoded = sum(_undecoded(stats).values()) - sum(_undecoded(before).values())
        return _decoded(stats) - _decoded(before) + undecoded

    def received_noun(self, stats: LiveStats) -> str:
        """Returns what most of that is: samples, strings or messages."""
        if stats.samples > self.before.samples:
            return "samples"
        return "strings" if _decoded(stats) > _decoded(self.before) else "messages"

    def failure(self, reason: str) -> Failure:
        """Stops the recording, and returns the failure that ended it, with a summary of what was written."""
        with contextlib.suppress(OSError):
            self.recording.stop()
        return Failure(f"{reason}; {self.summary()}")

    def finish(self) -> str:
        """Stops the recording, and returns its summary.

        Raises:
            Failure: The recording ended early.
        """
        try:
            self.recording.stop()
        except OSError as error:
            raise self.failure(str(self.recording.error)) from error
        return self.summary()

    def summary(self) -> str:
        """Returns a line about the recording: files, duration, counts and losses."""
        stats, files = self.device.stats, self.recording.files
        names = label(files[0]) + (f" to {label(files[-1])}" if len(files) > 1 else "")
        parts = [format_count(self.recording.samples, "sample")]
        if strings := self.recording.strings:
            parts.append(format_count(strings, "string"))
        counts = self.recording.message_counts
        parts += [
            f"{format_count(counts[mid], 'message')} {output_name(mid)}"
            for mid in output_mids(counts)
        ]
        if self.corrections is not None:
            parts.append(f"{format_count(self.corrections.forwarder.messages, 'correction')} sent")
        parts.append(format_size(self.recording.bytes))
        return f"{names}: {self.elapsed:,.1f} s, {', '.join(parts)}; {self.losses(stats)}"

    def losses(self, stats: LiveStats) -> str:
        """Returns losses and damage since the start."""
        before = self.before
        parts = []
        lost, gaps = stats.lost_samples - before.lost_samples, stats.gaps - before.gaps
        if lost:
            parts.append(describe_losses(lost, gaps, has_counter=True))
        if skipped := stats.skipped_bytes - before.skipped_bytes:
            parts.append(f"{format_count(skipped, 'byte')} damaged")
        if overruns := (stats.overruns or 0) - (before.overruns or 0):
            where = "driver" if stats.transfer_errors is None else "device"
            parts.append(f"{format_count(overruns, 'overrun')} in the {where}")
        if errors := stats.errors - before.errors:
            parts.append(
                f"{format_count(errors, 'error')} from the device, the last: {stats.last_error}"
            )
        if parts:
            return ", ".join(parts)
        counters = [totals.quantities.get("packet_counter", 0) for totals in (before, stats)]
        return describe_losses(0, 0, has_counter=counters[0] < counters[1])


def _decoded(stats: LiveStats) -> int:
    """Returns the number of samples and strings."""
    return stats.samples + sum(stats.strings.values())


def _undecoded(stats: LiveStats) -> dict[int, int]:
    """Returns the number of other outputs by message identifier."""
    return {mid: stats.message_counts[mid] for mid in output_mids(stats.message_counts)}
