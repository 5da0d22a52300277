"""The Measurement State of a virtual device."""

from __future__ import annotations

import struct
from collections.abc import Callable
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING, Protocol

import numpy as np

from xbus.protocol.ids import DataId
from xbus.protocol.tables import QUANTITIES, STATUS_FLAGS
from xbus.protocol.values import (
    ON_DEMAND,
    PERIOD_TICKS,
    IccCommand,
    IccReply,
    ResetCode,
    SyncFunction,
    SyncLine,
)
from xbus.sim.clock import SECOND
from xbus.sim.procedures import icc_result, is_still, reset
from xbus.sim.stream import Stream
from xbus.sim.strings import StringStream
from xbus.sim.sync import delay_of, reference_period
from xbus.wire.codec import encode_sample

if TYPE_CHECKING:
    from xbus.sim.unit import Unit

__all__ = ["Measurement", "status_word"]

#: Shortest time in ns between two messages with a status word: a momentary flag is in one of them only.
SHORTEST_INTERVAL = SECOND // 2000
#: A tick of SampleTimeFine, in ns.
TICK = SECOND // 10_000
#: States of the no-rotation update in the status word.
NO_ROTATION_DONE, NO_ROTATION_FAILED, NO_ROTATION_RUNNING = 0, 2, 3
#: The lines whose events are sent as data, on the 600-series.
TRIGGERS = {SyncLine.IN1: DataId.TriggerIn1, SyncLine.IN2: DataId.TriggerIn2}
#: Quantities that carry status flags.
STATUS_QUANTITIES = ("status_word", "status_byte")


def status_word(**fields: int) -> int:
    """Returns the status word with these fields (Table 27)."""
    return sum(int(value) << STATUS_FLAGS[name].bit for name, value in fields.items())


class Source(Protocol):
    """A source of samples: a `Stream`, strings, or a recording."""

    def take(self, until: float, status: int) -> list[tuple[float, bytes]]:
        """Returns the frames sent since the last call, each with its time."""

    def latest(self, now: float, status: int) -> list[bytes]:
        """Returns the newest sample, or strings."""


class Measurement:
    """One stay in the Measurement State.

    Args:
        unit: The device.

    Attributes:
        rot_sensor: RotSensor in effect; orientation resets change it.
        rot_local: RotLocal in effect; orientation resets change it.
        icc_since: Start of the representative motion in ns; None outside a representative motion.
    """

    def __init__(self, unit: Unit) -> None:
        settings = unit.settings
        self.rot_sensor = settings.rot_sensor.quaternion
        self.rot_local = settings.rot_local.quaternion
        self.icc_since: int | None = None
        self._updating_since: int | None = None
        self._unit = unit
        #: Whether samples are sent on request only.
        self._on_request = any(
            setting.function == SyncFunction.SEND_LATEST for setting in settings.sync_settings
        )
        self._source = self._make_source()
        self._taken = unit.clock.now
        #: Flags that are set in the next status word only.
        self._momentary = 0
        #: Headers of the packets that carry status flags.
        self._status_headers = [
            struct.pack(">HB", output.data_id, QUANTITIES[output.quantity].size)
            for output in settings.output_configuration
            if output.quantity in STATUS_QUANTITIES and not settings.string_output_type.types
        ]
        self.set_momentary_flag("filter_input_start")

    def _make_source(self) -> Source:
        unit, now = self._unit, self._unit.clock.now / SECOND
        if unit.settings.string_output_type.types:
            # Strings replace MTData2.
            return self._make_strings(now)
        if unit.world.replay is not None:
            return unit.world.replay.play(now)
        return Stream(
            unit.settings.output_configuration,
            sensors=unit.sensors(),
            base_rate=unit.support.base_rate,
            synchronous_hr=unit.product.series in ("10-series", "100-series"),
            fine_wrap=unit.product.fine_wrap,
            fine_start=-(unit.powered_at // TICK),
            start=now,
            bid=unit.bid,
            device_id=unit.identity.device_id,
            location_id=unit.settings.location_id,
        )

    def _make_strings(self, now: float) -> StringStream:
        settings, unit = self._unit.settings, self._unit
        rate: Fraction | None
        if settings.string_output_type.frequency is not None:
            rate = Fraction(settings.string_output_type.frequency)
        elif settings.output_skip_factor == ON_DEMAND:
            rate = None
        else:
            rate = Fraction(PERIOD_TICKS, settings.period * (settings.output_skip_factor + 1))
        self._on_request = self._on_request or rate is None
        return StringStream(settings.string_output_type.types, rate, unit.sensors(), now)

    # Samples

    def take(self, until: int) -> list[tuple[float, bytes]]:
        """Returns the frames sent without request up to a time in ns, each with its time in seconds."""
        if self._on_request:
            return []
        frames: list[tuple[float, bytes]] = []
        while self._momentary and self._taken < until:
            interval = self._taken // SHORTEST_INTERVAL + 1
            self._taken = min(interval * SHORTEST_INTERVAL, until)
            status = self._unit.status() | self._momentary
            frames += (new := self._source.take(self._taken / SECOND, status))
            self._clear_sent_flags([frame for _, frame in new])
        if self._taken < until:
            self._taken = until
            frames += self._source.take(until / SECOND, self._unit.status())
        return frames

    def send_latest(self) -> None:
        """Sends the newest sample, if samples are sent on request only."""
        if not self._on_request:
            return
        status = self._unit.status() | self._momentary
        frames = self._source.latest(self._unit.clock.now / SECOND, status)
        self._clear_sent_flags(frames)
        for frame in frames:
            self._unit.send(frame)

    def set_momentary_flag(self, name: str) -> None:
        """Sets a flag of the status word in the next message that carries it."""
        if self._status_headers:
            self._momentary |= status_word(**{name: 1})

    def _clear_sent_flags(self, frames: list[bytes]) -> None:
        """Clears the momentary flags if a frame carried them."""
        if any(header in frame for header in self._status_headers for frame in frames):
            self._momentary = 0

    def sensors_changed(self) -> None:
        """Replaces the sensors, after a change of settings, fix or RTK status."""
        if isinstance(self._source, Stream | StringStream):
            self._source.sensors = self._unit.sensors()

    # Edges at the sync inputs

    def edge(self, line: int, *, rising: bool) -> None:
        """Handles an edge at a line: each setting that it triggers acts after its delay."""
        for setting in self._unit.sync_inputs.edge(line, rising=rising):
            match setting.function:
                case SyncFunction.CLOCK_BIAS_ESTIMATION:
                    self._unit.sync_inputs.reference(setting, self._unit.clock.now)
                    # Without another pulse until then, the status changes at this time.
                    self._after(2 * reference_period(setting), lambda: None)
                case SyncFunction.SEND_LATEST:
                    self._after(delay_of(setting), self.send_latest)
                case SyncFunction.TRIGGER_INDICATION:
                    self._after(delay_of(setting), partial(self._indicate, line, rising=rising))

    def _after(self, delay: int, action: Callable[[], None]) -> None:
        """Schedules an action after a delay in ns; it does not run if this measurement ends before."""

        def act() -> None:
            if self._unit.measurement is self:
                action()

        self._unit.clock.at(self._unit.clock.now + delay, act)

    def _indicate(self, line: int, *, rising: bool) -> None:
        if self._unit.product.series != "600-series":
            self.set_momentary_flag("sync_in_marker")
            return
        data_id = TRIGGERS[SyncLine(line)]
        if data_id in (output.data_id for output in self._unit.settings.output_configuration):
            microseconds = (self._unit.clock.now - self._unit.powered_at) // 1000
            trigger = {
                "line": line,
                "polarity": rising,
                "timestamp": microseconds % 2**32,
                "frame": 0,
            }
            # The message has no packet counter, and the counter does not count it.
            self._unit.send(encode_sample({int(data_id): trigger}, bid=self._unit.bid))

    # Procedures

    def reset_orientation(self, code: ResetCode) -> None:
        """Resets the orientation (Table 33)."""
        now = np.array([self._unit.clock.now / SECOND])
        orientation = self._unit.world.trajectory.at(now).orientation[0]
        self.rot_sensor, self.rot_local = reset(code, orientation, self.rot_sensor, self.rot_local)
        self.sensors_changed()

    def update_no_rotation(self, seconds: int) -> None:
        """Starts a no-rotation update, which fails if the device moves."""
        start = self._unit.clock.now
        self._updating_since = start
        self._unit.no_rotation = NO_ROTATION_RUNNING

        def end() -> None:
            if self._updating_since == start:
                still = is_still(self._unit.world.trajectory, start, self._unit.clock.now)
                self._unit.no_rotation = NO_ROTATION_DONE if still else NO_ROTATION_FAILED
                self._updating_since = None

        self._after(seconds * SECOND, end)

    def icc(self, command: IccCommand) -> IccReply | None:
        """Runs a command of in-run compass calibration (Table 36); returns None if it is not possible now."""
        now = self._unit.clock.now
        match command:
            case IccCommand.START:
                self.icc_since = now
                return IccReply(command)
            case IccCommand.STATE:
                return IccReply(command, active=self.icc_since is not None)
            case IccCommand.STOP if self.icc_since is not None:
                since, self.icc_since = self.icc_since, None
                return IccReply(command, icc_result(self._unit.world.trajectory, since, now))
        return None

    def end(self) -> None:
        """Ends the measurement."""
        if self._updating_since is not None:
            self._unit.no_rotation = NO_ROTATION_FAILED
