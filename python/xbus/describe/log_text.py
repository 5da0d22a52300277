"""A `LogSummary` as rows of text, for ``xbus info`` and reports."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from xbus.describe.log_summary import DeviceSummary, LogSummary
from xbus.describe.text import finite, recording_date
from xbus.formatting import (
    describe_damage,
    describe_losses,
    device_name,
    format_count,
    printable,
)
from xbus.log.identity import Identity
from xbus.protocol.configuration import Configuration
from xbus.protocol.undecoded import NO_ORIENTATION, describe_undecoded
from xbus.protocol.values import PERIOD_TICKS

__all__ = ["format_utc", "log_rows", "quantity_rows"]

#: Restarts that are listed one by one.
MAX_RESTARTS = 4
#: Share of the nominal rate below which both rates are stated.
MUCH_LOST = 0.95


def log_rows(summary: LogSummary) -> Iterator[tuple[str, str]]:
    """Yields title and text of each row about the log as a whole."""
    stats, configuration = summary.stats, summary.identity.configuration
    is_capture = summary.capture_findings is not None
    if is_capture:
        yield "frames", f"{stats.frames:,} of MTi devices"
    else:
        yield "size", f"{stats.bytes:,} bytes"
    yield "device", ", ".join(_device(summary))
    if summary.other_devices:
        others = ", ".join(map(device_name, summary.other_devices))
        yield (
            "",
            f"messages with the same BID name other devices: {others}; the file may join several recordings",
        )
    if configuration is not None and (date := recording_date(configuration)):
        yield "recorded", f"{date} by the clock of the recording computer"
    if summary.utc:
        yield "UTC", " to ".join(map(format_utc, summary.utc))
    elif summary.utc_rows:
        yield "UTC", "sent, but never marked as valid"
    devices = summary.devices
    if finite(summary.duration) is not None:
        restarts = "" if len(devices) > 1 else "".join(map(_restarts, devices))
        yield "duration", f"{summary.duration:,.2f} s{restarts}"
    elif finite(summary.start) is not None:
        count = len(summary.runs.rows) - len(devices)
        restarted = f"; restarted {format_count(count, 'time')}" if count else ""
        yield "duration", f"not known: no run has two time stamps{restarted}"
    elif stats.samples and summary.has_counter:
        yield (
            "duration",
            "not known: the samples have no time stamps;"
            f" {_rate_option(configuration)} derives them from the packet counter",
        )
    elif stats.samples:
        yield "duration", "not known: the samples have neither time stamps nor a packet counter"
    if len(devices) > 1:
        for device in devices:
            yield f"BID {device.bid}", _device_samples(device)
    yield "samples", f"{stats.samples:,}"
    if summary.has_counter or not summary.trackers:
        losses = describe_losses(stats.lost_samples, stats.gaps, has_counter=summary.has_counter)
        yield "losses", losses
    if is_capture:
        return
    damage = describe_damage(stats.skipped_bytes, len(summary.damage))
    share = f", {100 * stats.skipped_bytes / max(stats.bytes, 1):.2g} % of the bytes"
    yield "damage", damage + share if summary.damage else damage
    if stats.malformed:
        yield "malformed", f"{stats.malformed:,}: the packets do not fill the message"
    messages = ", ".join(f"{name} {count:,}" for name, count in summary.messages.items())
    yield "messages", messages or "none but samples"
    if summary.undecoded:
        yield "undecoded", describe_undecoded(summary.undecoded)
    if summary.trackers:
        yield "trackers", "; ".join(_trackers(summary))
        yield "", NO_ORIENTATION
    if summary.strings:
        yield "strings", ", ".join(f"{name} {count:,}" for name, count in summary.strings.items())


def _trackers(summary: LogSummary) -> Iterator[str]:
    for tracker in summary.trackers:
        losses = describe_losses(tracker.lost_samples, tracker.gaps, has_counter=True)
        yield f"{tracker.device_id} {format_count(tracker.rows, 'row')}, {losses}"


def _device(summary: LogSummary) -> Iterator[str]:
    if (count := len(summary.devices)) > 1:
        yield f"{count} devices on a bus"
        return
    yield from _identity(summary.identity)


def _identity(identity: Identity) -> Iterator[str]:
    if identity.product_code is None and identity.device_id is None:
        yield "not named in this log"
    if identity.product_code is not None:
        yield printable(identity.product_code)
    if identity.device_id is not None:
        yield f"id {device_name(identity.device_id)}"
    if identity.firmware is not None:
        build = identity.firmware.build
        yield f"firmware {identity.firmware}" + ("" if build is None else f" build {build}")


def _rate_option(configuration: Configuration | None) -> str:
    """Returns the option that gives times to a log of MTData without time stamps.

    The Configuration has the rate. With an output skip factor it is not known, because no source says whether
    the packet counter counts the skipped samples.
    """
    if configuration is None or not configuration.data_length or configuration.output_skip_factor:
        return "--rate HZ"
    period = configuration.sampling_period
    return f"--rate {PERIOD_TICKS / period:.10g}" if period else "--rate HZ"


def _device_samples(device: DeviceSummary) -> str:
    """Returns identity, samples, duration and rate of one of several devices."""
    samples = format_count(device.samples, "sample")
    if finite(device.duration) is not None:
        samples += f" in {device.duration:,.2f} s"
    parts = [*_identity(device.identity), samples]
    if rate := _rate(device.rate, device.nominal_rate):
        parts.append(f"{rate} Hz")
    if device.lost:
        parts.append(f"{device.lost:,} lost")
    return ", ".join(parts) + _restarts(device)


def _restarts(device: DeviceSummary) -> str:
    """Returns how often a device restarted, and after how many seconds that were recorded."""
    if len(device.restarts) > MAX_RESTARTS:
        return f", restarted {len(device.restarts):,} times"
    seconds = [f"{time:,.1f}" for time in device.restarts]
    if not seconds:
        return ""
    if len(seconds) == 1:
        return f", restarted once, after {seconds[0]} s"
    return f", restarted {len(seconds)} times, after {', '.join(seconds[:-1])} and {seconds[-1]} s"


def quantity_rows(summary: LogSummary) -> Iterator[tuple[str, ...]]:
    """Yields the header of the table of quantities, then one row per quantity."""
    yield "quantity", "coord.", "rows", "rate/Hz", "precision", "unit"
    for quantity in summary.quantities:
        coordinates, precision = quantity.coordinates or "", quantity.precision or ""
        rows, rate = f"{quantity.rows:,}", _rate(quantity.rate, quantity.nominal_rate)
        yield quantity.name, coordinates, rows, rate, precision, quantity.unit


def _rate(rate: float, nominal: float) -> str:
    """Returns a mean rate, with the nominal one if it is much higher."""
    if finite(rate) is None:
        return ""
    return f"{rate:,.1f} of {nominal:,.4g}" if rate < MUCH_LOST * nominal else f"{rate:,.1f}"


def format_utc(time: np.datetime64) -> str:
    """Returns a time to the millisecond: ``"2026-11-22 09:29:59.000"``."""
    return str(time.astype("datetime64[ms]")).replace("T", " ")
